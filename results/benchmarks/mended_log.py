"""What `identify` makes of the logs of wrong_log.py, and of `check --fix` before it.

    python results/benchmarks/mended_log.py [--data DATA] [--out FOLDER]

A model of the wrong log, and one of the log that `check` mends. Both are judged as the
other tools are there: on the script's rows of the wrong log, and of the right one.
`--fix --apply` mends what a report names first. Writes mended_log.md.
"""

import argparse
import os
from pathlib import Path

import numpy as np
from wrong_log import MISTAKES, script_rows, write_page

from benchmarks.parts import Inputs
from benchmarks.rivals import cvxpy_script
from sdp_vs_penalty import Estimate, Measurements, Problem, check, identify
from sdp_vs_penalty.checks.fixing import fix_runs
from sdp_vs_penalty.errors import InputError

HERE = Path(__file__).parent


def error_on(model: Estimate, rows: cvxpy_script.Rows) -> str:
    """The model's relative error on rows [%]."""
    columns = cvxpy_script.columns(model.robot._model, *rows.states)
    apart = columns @ model.theta - rows.tau
    return f"{100.0 * np.linalg.norm(apart) / np.linalg.norm(rows.tau):.3g}"


def mended(problem: Problem, run: Measurements) -> tuple[str, Measurements | None]:
    """What `--apply` names, and the log that it mends; None where it refuses to."""
    reports = check(problem, run)
    words = [issue.apply for report in reports for issue in report.issues]
    words = [word for word in words if word]
    if not words:
        return "nothing", None
    try:
        (copy,) = fix_runs(problem, [run], reports, words[:1]).runs
    except InputError as error:
        return f"{words[0]}: {error.what}", None
    return words[0], copy


def main() -> None:
    """Identify every log, and write the table."""
    parser = argparse.ArgumentParser(usage=__doc__)
    data = os.environ.get("SDP_VS_PENALTY_DATA")
    parser.add_argument("--data", type=Path, default=data, required=data is None)
    parser.add_argument("--out", type=Path, default=HERE)
    options = parser.parse_args()
    inputs = Inputs(Path(options.data).resolve(), [1], 1, None)
    right = script_rows(inputs.run)
    table = []
    for mistake, change in MISTAKES.items():
        run = change(inputs.run)
        try:
            identify(inputs.problem, run)
            said = "identifies"
        except InputError as error:
            said = f"refuses: {error.what}"
        model = identify(inputs.problem, run, check=False)
        word, copy = mended(inputs.problem, run)
        after = (
            ""
            if copy is None
            else error_on(identify(inputs.problem, copy, check=False), right)
        )
        of_model = [error_on(model, rows) for rows in (script_rows(run), right)]
        table.append([mistake, *of_model, word, after, said])
        print(table[-1], flush=True)
    heads = [
        "mistake",
        "`identify`: error on the wrong log [%]",
        "on the right one [%]",
        "`check --fix --apply`",
        "`identify` of the mended log: error on the right one [%]",
        "`identify` with its check",
    ]
    about = (
        "The logs and the rows of [wrong_log.md](wrong_log.md)."
        " By `python results/benchmarks/mended_log.py`."
    )
    title = "What is made of a log with one mistake, and of the mended one"
    write_page(options.out / "mended_log.md", title, about, heads, table)


if __name__ == "__main__":
    main()
