"""Hostile files, names, formats and surroundings against the command line."""
