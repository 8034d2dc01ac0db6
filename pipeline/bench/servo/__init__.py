"""The servo player: plays a timeline on a servo controller over a serial port. The only ``import serial``.

servo_controller.py says what a controller must do; maestro.py implements Pololu's. To support another one, add a file
beside it and open it in ``Connection.open`` (play.py). Every command passes through limits.py. player.py holds the
playing loop and the safe shutdown, calibrate.py the dialogue that measures servos, log.py the record of a run.
"""
