"""Which physical effect a model misses: `diagnose.diagnose` is the verb, `adding.add` adds what it finds."""
