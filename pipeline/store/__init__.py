"""A content-addressed store of artifacts: items, manifests, tables, atomic writes and provenance."""
