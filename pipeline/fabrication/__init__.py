"""Fabrication's files: what a kit's folder holds."""
