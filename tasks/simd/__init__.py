"""SIMD inside numba: vectors of float32, one robot per lane. Importing it teaches numba the functions of lanes."""

from tasks.simd import vectors
