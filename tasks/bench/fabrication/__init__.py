"""Fabrication: from a design to a robot on the bench. Millimetres, microseconds and grams where a name says so."""
