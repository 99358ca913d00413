"""Measurements: the type, its files (one file a format in formats/), public data sets."""
