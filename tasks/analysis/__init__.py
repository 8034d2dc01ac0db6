"""What a study shows: how good predictions are, whose fault a transfer gap is, and where an ensemble hallucinates.

Paper, "Results". Arrays in, arrays out. What can't be computed says why in its place: see
:class:`tasks.analysis.uncertainty.Estimate`.
"""
