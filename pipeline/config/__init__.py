"""Settings of a study: typed, loaded from YAML and the command line, and written out."""
