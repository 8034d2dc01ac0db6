"""Robots whose links fuse into rigid bodies or collide with each other, in the batch engine: one robot after the other."""
