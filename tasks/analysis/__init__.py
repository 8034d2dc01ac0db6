"""What a study shows: how good predictions are, whose fault a transfer gap is, and where an ensemble hallucinates.

Paper, "Results". Arrays in, rows out: each table is one file in ``tasks/analysis/tables``.
"""
