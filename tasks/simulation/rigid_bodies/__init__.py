"""Robots whose links fuse into rigid bodies or collide, in the batch engine, with the bits of the reference engine.

Scalar code, in blocks of one lane: what collides, and in which order, differs from robot to robot and step to step.
Swinging links that pass through one another are left to the lanes of tasks/simulation/trees/step.py, which are faster.
"""
