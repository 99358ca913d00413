"""Diagnosis by one criterion."""
