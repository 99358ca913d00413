"""Make this folder again: python results/closed_loop/make.py [--draws 5] [--jobs 2]

Draws that closed_loop.csv has are not made again: what was stopped goes on. Every seed
comes from the number of a draw. Needs MuJoCo (extra [engines]).
"""

import argparse
import os
import sys
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.paper.provenance import ONE_THREAD, write_note

os.environ.update(ONE_THREAD)
HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

import pandas

from closed_loop.judge import PARTS, Draw, rows_of
from closed_loop.report import report

TABLE = HERE / "closed_loop.csv"


def made(number: int, part: str) -> list[dict[str, Any]]:
    """Return the rows of a part of a draw, in a process of its own."""
    return rows_of(Draw(number), part)


def main() -> None:
    """Make what is missing, and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=5)
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    rows = pandas.read_csv(TABLE) if TABLE.exists() else pandas.DataFrame()
    done = set() if rows.empty else set(zip(rows["draw"], rows["part"], strict=True))
    wanted = [(k, part) for k in range(given.draws) for part in PARTS]
    with ProcessPoolExecutor(given.jobs) as pool:
        jobs = [pool.submit(made, *key) for key in wanted if key not in done]
        for job in as_completed(jobs):
            rows = pandas.concat([rows, pandas.DataFrame(job.result())])
            rows = rows.sort_values(["draw", "part"], kind="stable")
            rows.to_csv(TABLE, index=False, float_format="%.6g")
            print(f"{len(rows)} rows", flush=True)
    rows = pandas.read_csv(TABLE, keep_default_na=True)
    write_text(HERE / "closed_loop.md", report(rows))
    command = ["results/closed_loop/make.py", "--draws", str(given.draws)]
    write_note(HERE, [command], float(rows["seconds"].sum()))


if __name__ == "__main__":
    main()
