"""How often the diagnosis is right: cases, their run, the report."""
