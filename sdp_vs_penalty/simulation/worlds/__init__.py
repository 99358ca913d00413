"""Simulated robots that share nothing with the library that is judged by them.

Equations are taken from the literature, dynamics from Pinocchio. Nothing here imports
effects, signals or regression; ``tests/simulation/test_challenge.py`` looks.
"""
