"""SIMD inside numba: vectors of float32, one robot per lane."""
