"""Known truth: simulated runs, hidden effects, physics engines."""
