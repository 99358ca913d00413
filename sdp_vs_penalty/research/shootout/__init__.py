"""Solvers against instances of identification, every answer judged by our own
certificate."""
