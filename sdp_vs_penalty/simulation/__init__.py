"""Known truth: simulated runs, hidden effects, physics engines, the challenge of the diagnosis."""
