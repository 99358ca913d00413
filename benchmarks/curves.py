"""results/curves.md from challenges of simulated robots:

for class, cases, seed in results/curves.md:
    python benchmarks/challenge --classes CLASS --nuisance NUISANCES --seed SEED --cases CASES --out DIR
python benchmarks/curves.py DIR [DIR ...]
"""

from __future__ import annotations

import json
import sys
from collections import Counter
from pathlib import Path
from typing import Any

from challenge.report import (
    HEADINGS,
    curve_lines,
    effect_lines,
    shares,
)

from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.show import markdown_table

OUT = Path(__file__).parents[1] / "results" / "curves.md"
#: What stands there from this line on is written by hand, and stays.
NOTES = "\n## Notes"


def main() -> None:
    records: dict[str, Any] = {}
    for folder in sys.argv[1:]:
        records |= json.loads((Path(folder) / "challenge.json").read_text())["cases"]
    every = list(records.values())
    of = Counter((k.split("/")[0], k.split("/")[2]) for k in records)
    nuisances = sorted({k.split("/")[1] for k in records})
    lines = [
        "# Measured curves, new effects and wrists on simulated robots",
        "",
        "Made by `python benchmarks/curves.py` from cases of `python benchmarks/challenge "
        "--classes CLASS "
        f"--seed SEED --nuisance {','.join(nuisances)}`: "
        + ", ".join(f"{count} of {kind} (seed {seed})" for (kind, seed), count in sorted(of.items()))
        + ". Wilson's intervals, 95 %. Counted: where these data show what is hidden.",
        "",
        *markdown_table(HEADINGS, shares(every)),
        "",
        *curve_lines(every),
        *effect_lines(every),
    ]
    write_text(OUT, "\n".join(lines) + "".join(OUT.read_text().partition(NOTES)[1:]))


if __name__ == "__main__":
    main()
