"""Transformations of a log, one class each; `search.py` lists those that are tried."""
