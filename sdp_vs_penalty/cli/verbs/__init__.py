"""One verb a file: its options, and what it prints; the work is done elsewhere."""
