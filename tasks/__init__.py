"""The science: what one unit of work computes. No files, no Ray, no MLflow; arrays in, arrays out."""
