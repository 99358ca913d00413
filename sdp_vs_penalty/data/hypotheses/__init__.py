"""What each column of a log is: hypotheses with priors from names, units and metadata,
weighed by one function."""
