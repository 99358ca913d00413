"""The data, compressed: triangular factors that merge, base parameters, black boxes."""
