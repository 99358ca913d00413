"""Which physical effect a model misses: `diagnose.diagnose` finds it, `adding.add` adds it."""
