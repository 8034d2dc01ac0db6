"""Inference of residual networks on a CPU, alone and coupled with an engine's steps."""
