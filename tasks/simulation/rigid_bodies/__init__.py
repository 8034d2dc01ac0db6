"""The rigid-body engine: robots whose links fuse or collide, with the bits of the reference engine.

Scalar code, because the collisions and their order differ from robot to robot and from step to step. Swinging links
that pass through one another are left to the tree engine (tasks/simulation/trees), which is faster.
"""
