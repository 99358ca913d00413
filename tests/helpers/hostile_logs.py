"""Logs in which numbers are absurd, the same for the same seed."""

from dataclasses import replace

import numpy as np
from small_runs import small_run

from sdp_vs_penalty import Measurements, load_problem

#: Numbers that overflow, underflow or are none; and odd ones that a reader lets pass.
WILD = (0.0, -0.0, 5e-324, 1e-300, 1e-160, 1e16, 1e100, 1e160, 1e300, np.inf, -np.inf, np.nan)
ODD = (0.0, -0.0, 5e-324, 1e-160, 1e-31, 1e-29, 1e-15, 1e3, 1e6, 9e8, -9e8)


@np.errstate(all="ignore")
def hostile_log(seed: int) -> Measurements:
    """A small run in which one to four things are absurd: numbers, stamps, gaps, constant channels."""
    rng = np.random.default_rng(seed)
    run = small_run(load_problem("two_link"), seconds=float(rng.uniform(1.0, 6.0)), seed=seed % 7)
    wild = rng.random() < 0.5
    for _ in range(int(rng.integers(1, 5))):
        name = str(rng.choice(["t", "q", "dq", "tau"]))
        values = getattr(run, name)
        if values is None:
            continue
        values = values.copy()
        begin = int(rng.integers(len(values)))
        rows = slice(begin, begin + int(rng.choice([1, 1, 3, 50, len(values)])))
        deed = int(rng.integers(5))
        if deed == 0:
            values[rows] = rng.choice(WILD if wild else ODD)
        elif deed == 1:
            factors = [0.0, 1e-300, 1e-12, 1e12, 1e150, 1e300] if wild else [0.0, 1e-29, 1e-9, 1e3, 1e7]
            values *= float(rng.choice(factors))
        elif deed == 2:
            values[rows] = values[begin]
        elif deed == 3:
            values[rows] = np.sort(values[rows], axis=0)[::-1]
        else:
            values = values + rng.choice([1e9, 1e15, -1e300] if wild else [1e-12, 1.0, -1e8])
        run = replace(run, **{name: values})
    return run
