"""Recorded studies, read back: their tables, their champions, and a folder with all of them to take along."""
