"""From measurements to a certified estimate, and how well the data determine it."""
