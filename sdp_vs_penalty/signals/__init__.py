"""Filters, derivatives, noise: from samples to rows that every column passes like the torque."""
