"""What an outsider finds: stock CVXPY with Clarabel and SCS, and CSDP, on exported files.

    SDP_VS_PENALTY_DATA=... python results/shootout/outsider.py

Nothing of the package is imported: the command line exports instances that a seed draws from
those of runs.csv, and judges the answers in the end. In between this file reads problem.npz
and problem.dat-s, solves them, and evaluates the objective at each answer with rational
numbers. outsider.md compares both, row by row, with what runs.csv says of the same solver
asked for the same accuracy.
"""

import csv
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from fractions import Fraction
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cvxpy
import numpy as np
from scipy import sparse

HERE = Path(__file__).parent
SEED, COUNT = 93, 12
#: What every solver is asked for: Clarabel's and CSDP's default.
ACCURACY = 1e-8
#: The table's limit of processor time, and after which SCS gives up here [s].
LIMIT, PATIENCE = 5.0, 60.0
#: Options by CVXPY's name of the solver, and its name in runs.csv.
THROUGH_CVXPY: dict[str, tuple[str, dict[str, Any]]] = {
    "CLARABEL": ("clarabel", {}),
    "SCS": ("scs", {"eps": ACCURACY, "time_limit_secs": PATIENCE}),
}
CLAIMS = {
    "optimal": "optimal",
    "infeasible": "infeasible",
    "unbounded": "unbounded",
    "optimal_inaccurate": "inaccurate",
    "infeasible_inaccurate": "inaccurate",
    "unbounded_inaccurate": "inaccurate",
}
#: CSDP's exit codes: its dual is the problem of the file.
CSDP_CLAIMS = {0: "optimal", 1: "unbounded", 2: "infeasible", 3: "inaccurate"}
#: What the file of answers holds of each.
GIVEN = ("problem", "solver", "hash", "accuracy", "seconds", "claimed", "status", "x")
PREFIX = "outsider's "
#: Of rows that both ended at the table's limit of time: there is no verdict to compare.
NOT_COUNTED = "not counted"
Row = dict[str, Any]


def command(*words: str) -> None:
    """Run the command line of the package, as anybody would."""
    subprocess.run([sys.executable, "-m", "sdp_vs_penalty", *words], check=True)


def rows_of(path: Path) -> list[dict[str, str]]:
    """Read a CSV file."""
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def matrix(arrays: Any, name: str) -> sparse.csc_matrix:
    """Return P or A of problem.npz."""
    cells = [arrays[f"{name}_{part}"] for part in ("value", "row", "column", "shape")]
    return sparse.csc_matrix((cells[0], (cells[1], cells[2])), cells[3])


def member(kind: str, size: int, rows: cvxpy.Expression) -> Any:
    """Return the constraint that rows of b - A x lie in a cone, as README.md says."""
    if kind == "zero":
        return rows == 0
    if kind == "nonnegative":
        return rows >= 0
    if kind == "soc":
        return cvxpy.SOC(rows[0], rows[1:])
    if kind == "exp":
        return cvxpy.ExpCone(rows[0], rows[1], rows[2])
    unpack = np.zeros((size * size, size * (size + 1) // 2))
    column = 0
    for j in range(size):
        for i in range(j + 1):
            unpack[[i * size + j, j * size + i], column] = 1.0 if i == j else 2**-0.5
            column += 1
    square = cvxpy.reshape(unpack @ rows, (size, size), order="C")
    return 0.5 * (square + square.T) >> 0


def by_cvxpy(arrays: Any, solver: str, options: dict[str, Any]) -> Row:
    """Solve problem.npz by CVXPY."""
    upper = matrix(arrays, "P")
    P = upper + sparse.triu(upper, 1).T
    x = cvxpy.Variable(len(arrays["c"]))
    slack = arrays["b"] - matrix(arrays, "A") @ x
    constraints, first = [], 0
    for kind, size in zip(arrays["cone_kinds"], arrays["cone_sizes"], strict=True):
        count = size * (size + 1) // 2 if kind == "psd" else size
        constraints.append(member(kind, size, slack[first : first + count]))
        first += count
    objective = 0.5 * cvxpy.quad_form(x, P, assume_PSD=True) + arrays["c"] @ x
    problem = cvxpy.Problem(cvxpy.Minimize(objective), constraints)
    try:
        problem.solve(solver=solver, **options)
    except cvxpy.SolverError as error:
        return {"claimed": "failed", "status": str(error)}
    answer: Row = {"claimed": CLAIMS.get(problem.status, "failed")}
    answer["status"] = problem.status
    if x.value is not None and answer["claimed"] in ("optimal", "inaccurate"):
        answer["x"] = x.value.tolist()
    return answer


def by_csdp(path: Path) -> Row:
    """Solve problem.dat-s by CSDP, with its defaults."""
    solution = path.with_name("solution")
    done = subprocess.run(["csdp", path, solution], capture_output=True, check=False)
    claimed = CSDP_CLAIMS.get(done.returncode, "failed")
    answer: Row = {"claimed": claimed, "status": f"exit code {done.returncode}"}
    if claimed in ("optimal", "inaccurate"):
        answer["x"] = [float(word) for word in solution.open().readline().split()]
    return answer


def answers(library: Path) -> Iterator[Row]:
    """Solve every exported instance by every solver that takes its form."""
    for instance in rows_of(library / "index.csv"):
        place = library / instance["folder"]
        about = json.loads((place / "problem.cbf.json").read_text())
        arrays = np.load(place / "problem.npz")
        files = place / "problem.dat-s"
        solves = {
            name: lambda arrays=arrays, solver=solver, options=options: by_cvxpy(
                arrays, solver, options
            )
            for solver, (name, options) in THROUGH_CVXPY.items()
        }
        if files.exists():
            solves["csdp"] = lambda files=files: by_csdp(files)
        for name, solve in solves.items():
            begin = time.process_time()
            answer = solve()
            yield {
                "problem": instance["name"],
                "solver": f"{PREFIX}{name}",
                "hash": about["hash"],
                "accuracy": ACCURACY,
                "seconds": time.process_time() - begin,
                **answer,
                **evaluated(about, arrays, answer),
            }


def evaluated(about: Row, arrays: Any, answer: Row) -> Row:
    """The objective at an answer's parameters, by rational numbers, and its distance from the
    proved interval, relative to what the instance's JSON says that errors are relative to.

    The parameters are the first variables. Behind them stand residuals w = b - A x of the
    equalities, which a solver holds to its own accuracy: here they are exact.
    """
    kinds, sizes = arrays["cone_kinds"], arrays["cone_sizes"]
    if "x" not in answer or about["lower"] is None or "exp" in kinds:
        return {}
    x = [Fraction(value) for value in answer["x"][: len(about["centre"])]]
    if kinds[0] == "zero":
        rows = matrix(arrays, "A").tocsr()[: sizes[0], : len(x)].tocoo()
        residuals = [Fraction(float(value)) for value in arrays["b"][: sizes[0]]]
        for value, i, j in zip(rows.data, rows.row, rows.col, strict=True):
            residuals[i] -= Fraction(float(value)) * x[j]
        x += residuals
    upper = matrix(arrays, "P").tocoo()
    terms = [
        Fraction(float(value)) * x[i] * x[j] / (2 if i == j else 1)
        for value, i, j in zip(upper.data, upper.row, upper.col, strict=True)
    ]
    terms += [Fraction(float(c)) * v for c, v in zip(arrays["c"], x, strict=True)]
    value = Fraction(about["offset"]) + Fraction(about["scale"]) * sum(terms)
    ends = Fraction(about["lower"]) - value, value - Fraction(about["upper"])
    return {
        "objective": float(value),
        "objective_error": float(max(*ends, 0) / Fraction(about["relative_to"])),
        "interval": f"{about['lower']!r} to {about['upper']!r}",
        "loss_share": about["upper"] / about["relative_to"],
    }


def kind(row: Row, accuracy: float) -> str:
    """What a run is at an accuracy, by its figures in runs.csv: see summary.md."""
    if row["outcome"] != "claim":
        return str(row["outcome"])
    error = float(row["error"])
    if error <= 10.0 * accuracy:
        return "right"
    return "inaccurate" if error <= 1e-3 else "far or false"


def in_words(value: object, column: str) -> str:
    """A cell of the table in words."""
    if value is None:
        return "-"
    if isinstance(value, float) and column != "objective":
        return f"{value:.1e}"
    return str(value)


def compared(found: list[Row], judged: list[Row], table: dict[Any, Row]) -> list[Row]:
    """A row for each answer: the outsider's objective and verdict beside the table's."""
    verdicts = {(row["problem"], row["solver"]): row for row in judged}
    rows = []
    for answer in found:
        key = answer["problem"], answer["solver"]
        solver = answer["solver"].removeprefix(PREFIX)
        theirs, ours = verdicts[key], table[answer["problem"], solver]
        if float(answer["seconds"]) > LIMIT:
            theirs = theirs | {"outcome": "timeout"}
        at = [(kind(theirs, a), kind(ours, a)) for a in (1e-4, 1e-6, 1e-8)]
        rows.append(
            {
                "problem": answer["problem"],
                "solver": solver,
                "objective": answer.get("objective"),
                "proved interval": answer.get("interval"),
                "its error": answer.get("objective_error"),
                "error in the table": float(ours["objective_error"]),
                "error or violation": float(theirs["error"]),
                "in the table": float(ours["error"]),
                "loss over size": answer.get("loss_share"),
                "status": f"{answer['status']}; {ours['status']}",
                "verdict at 1e-4, 1e-6, 1e-8": ", ".join(one for one, _ in at),
                "of the table": ", ".join(other for _, other in at),
                "verdicts equal": "yes" if all(a == b for a, b in at) else "no",
            }
        )
        if ("timeout", "timeout") in at:
            rows[-1]["verdicts equal"] = NOT_COUNTED
    return rows


def markdown(rows: list[Row]) -> str:
    """Rows as a Markdown table."""
    cells = [list(rows[0]), ["---"] * len(rows[0])]
    cells += [[in_words(v, name) for name, v in row.items()] for row in rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in cells)


def missing(row: Row) -> str:
    """Which of two unequal runs misses the bar at the accuracy that was asked for."""
    of = {"the outsider's": "error or violation", "that of the table": "in the table"}
    return " and ".join(who for who, x in of.items() if row[x] > 10.0 * ACCURACY)


def versions() -> str:
    """The solvers' versions; that of CSDP as runs.csv has it."""
    ours = [f"{name} {version(name)}" for name in ("cvxpy", "clarabel", "scs")]
    csdp = {r["version"] for r in rows_of(HERE / "runs.csv") if r["solver"] == "csdp"}
    return ", ".join([*ours, *(f"csdp {number}" for number in csdp)])


def sentences(rows: list[Row]) -> list[str]:
    """What the rows say: equal verdicts, objectives, and whose accuracy the rest is."""
    within = 10.0 * ACCURACY
    known = [row for row in rows if row["its error"] is not None]
    n_equal = sum(row["verdicts equal"] == "yes" for row in rows)
    ended = [row for row in rows if row["verdicts equal"] == NOT_COUNTED]
    counted = len(rows) - len(ended)
    off = [row for row in known if row["its error"] > within]
    said = [
        f"{COUNT} instances of runs.csv, drawn by seed {SEED}; every solver asked for"
        f" {ACCURACY:g}, SCS also to give up after {PATIENCE:g} s, with all else as its authors"
        f" ship it. Right to an accuracy is within 10 times that. Verdicts are equal on"
        f" {n_equal} of {counted} rows. Versions: {versions()}. It solves the exported conic"
        " forms, so it says nothing of the table's rows cvxpy, which are formulas."
    ]
    said += [
        f"Not counted: {row['problem']}, {row['solver']}: more than {LIMIT:g} s of processor"
        f" time, the table's limit, by either route; what it says itself, and in the table:"
        f" {row['status']}."
        for row in ended
    ]
    said += [
        f"Unequal: {row['problem']}, {row['solver']}: error or violation"
        f" {row['error or violation']:.1e}, in the table {row['in the table']:.1e}; status"
        f" {row['status']}. Two formulations; {missing(row)} misses {within:g}."
        for row in rows
        if row["verdicts equal"] == "no"
    ]
    said.append(
        f"Objectives lie within {within:g} of the proved interval on {len(known) - len(off)}"
        f" of {len(known)} rows."
    )
    said += [
        f"Outside: {row['problem']}, {row['solver']}: {row['its error']:.1e}, in the table"
        f" {row['error in the table']:.1e}: the solver's accuracy, by either route."
        for row in off
    ]
    by_problem = {row["problem"]: row for row in known if row["loss over size"] < 0.1}
    for problem, row in by_problem.items():
        share = row["loss over size"]
        if share > ACCURACY:  # else the loss is zero
            errors = ", ".join(
                f"{row['solver']} {row['its error'] / share:.1e}"
                for row in known
                if row["problem"] == problem
            )
            said.append(
                f"{problem}: the loss is {share:.1e} of what errors are relative to, the"
                f" least that the instance resolves. Relative to the loss itself: {errors}."
                " A solver's accuracy is relative to the numbers of its form, not to what is"
                " left of them."
            )
    return said


def write(rows: list[Row]) -> None:
    """Write outsider.csv and outsider.md."""
    with (HERE / "outsider.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    about = str(__doc__).partition("\n\n")[0]
    said = "".join(f"- {sentence}\n" for sentence in sentences(rows))
    (HERE / "outsider.md").write_text(f"# {about}\n\n{said}\n{markdown(rows)}")


if __name__ == "__main__":
    table = {
        (row["problem"], row["solver"]): row
        for row in rows_of(HERE / "runs.csv")
        if float(row["accuracy"]) == ACCURACY
    }
    names = sorted({problem for problem, _ in table})
    drawn = np.random.default_rng(SEED).choice(names, COUNT, replace=False)
    with TemporaryDirectory() as folder:
        library, judged = Path(folder, "library"), Path(folder, "judged")
        command("shootout", "--problems", ",".join(drawn), "--export", str(library))
        found = list(answers(library))
        file = Path(folder, "answers.json")
        given = [{k: a[k] for k in GIVEN if k in a} for a in found]
        file.write_text(json.dumps({"answers": given}))
        command("shootout", "judge", str(file), "--out", str(judged))
        write(compared(found, rows_of(judged / "runs.csv"), table))
