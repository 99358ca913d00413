"""How often the diagnosis is right: cases in worlds of their own, their run, the
report."""
