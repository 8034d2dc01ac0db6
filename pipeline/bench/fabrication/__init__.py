"""Kits as files: everything in a kit's folder."""
