"""The figures of docs/benchmarks.md that no table has: the TX40 by its findings, the EMPS
without its torque.

    python results/public_benchmarks/public_benchmarks.py [tx40] [emps]

Needs SDP_VS_PENALTY_DATA. Writes public_benchmarks.csv; naming a part makes its rows alone.
"""

import csv
import sys
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from sdp_vs_penalty import Estimate, add, compare, diagnose, identify
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.problem import measured_runs

OUT = Path(__file__).with_name("public_benchmarks.csv")
COLUMNS = ("part", "case", "figure", "value", "unit")
#: s: the TX40 is learnt from what is before, and judged on what is behind.
CUT = 6.0
#: How many findings are added first.
FIRST = 8
COUPLED = "transmission_friction:5+6@law=viscous,transmission_friction:5+6@law=coulomb"
#: kg: what sets the scale of a log without torque.
MASS = 95.1089
LATE = (
    "rigid_body,viscous_friction,coulomb_friction,torque_offset,servo_position@d=0.001"
)
Row = tuple[str, str, str, float, str]


def tx40() -> Iterator[Row]:
    """Yield the error on unseen seconds: bare, with coupled friction, with findings."""
    (run,) = measured_runs("tx40").values()
    train, unseen = run.window(0.0, CUT), run.window(CUT, 1e9)

    def error(model: Estimate) -> float:
        return float(compare(model, unseen)[0].relative_error_percent)

    bare = identify("tx40", train, check=False)
    yield "tx40", "default effects", "error", error(bare), "%"
    yield "tx40", "coupled friction", "error", error(add(bare, COUPLED, train)), "%"
    found = list(diagnose(bare, train, check=False).effects)
    yield "tx40", "diagnosis", "findings", float(len(found)), ""
    first = add(bare, found[:FIRST], train)
    yield "tx40", f"first {FIRST} findings", "error", error(first), "%"
    yield "tx40", "all findings", "error", error(add(bare, found, train)), "%"


def emps() -> Iterator[Row]:
    """Yield what EMPS's servo says with its force hidden, with its law's delay and without."""
    tracking = measured_runs("emps")["tracking"]
    silent = replace(tracking, tau=np.zeros_like(tracking.tau), torque_logged=False)
    for name, effects in (("delay stated", LATE), ("no delay", None)):
        model = identify(
            "emps", silent, effects=effects, known={"m1": MASS}, check=False
        )
        for parameter, value in zip(model.model.parameters, model.theta, strict=True):
            if parameter.effect != "rigid_body":
                yield "emps", name, parameter.name, float(value), parameter.unit


PARTS = {"tx40": tx40, "emps": emps}

if __name__ == "__main__":
    chosen = sys.argv[1:] or list(PARTS)
    made = [tuple(map(str, row)) for part in chosen for row in PARTS[part]()]
    kept = []
    if OUT.exists():
        kept = [r for r in csv.reader(OUT.open()) if r[0] not in ("part", *chosen)]
    lines = [",".join(f'"{x}"' for x in row) for row in (COLUMNS, *kept, *made)]
    write_text(OUT, "\n".join(lines) + "\n")
    print(OUT.read_text())
