"""Driving: servo timelines to a real controller over a serial port. The only ``import serial``.

interface.py says what a controller can do; maestro.py is Pololu's. A bus servo or an Arduino is one more file beside
it, opened by ``open_driver`` in command.py. limits.py holds the one last function that every command goes through,
player.py the loop and its way out, log.py what was sent and when.
"""
