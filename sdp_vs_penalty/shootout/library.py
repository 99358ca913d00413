"""The library of instances: identification SDPs as files that any solver reads, with
proofs beside them.

Each instance is a folder with the problem in three formats (CBF, sparse SDPA where its
cones allow that, NumPy arrays), a JSON that says how a file's optimum becomes the loss,
between which proved bounds that lies, and how its variables become the parameters that
are judged, and a proof that `verify` checks in rational arithmetic. index.csv lists them
all with sizes and SHA-256. The folder benchopt is a benchmark of benchopt on them. The
same version writes the same bytes on the same machine.
"""

import hashlib
import io
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas

from sdp_vs_penalty.estimators.estimator import Progress
from sdp_vs_penalty.exporters.sdp import export_sdp
from sdp_vs_penalty.files import write_bytes, write_text
from sdp_vs_penalty.shootout.catalogue import Entry
from sdp_vs_penalty.shootout.instances import Instance
from sdp_vs_penalty.shootout.judge import proved
from sdp_vs_penalty.shootout.runner import Shootout
from sdp_vs_penalty.solvers.conic import ConicProblem
from sdp_vs_penalty.solvers.proof import Proof, write_proof
from sdp_vs_penalty.solvers.rewrite import linear_objective

#: The data card and the citation that go with a library are files beside this one.
_HERE = Path(__file__).parent


def write_library(
    folder: Path, entries: Sequence[Entry], progress: Progress
) -> list[dict[str, Any]]:
    """Write instances as files, with their index, data card and benchmark.

    Parameters
    ----------
    progress : callable
        Called with the number of instances written so far.
    """
    rows = []
    for k, item in enumerate(entries):
        progress(f"{k} of {len(entries)}: {item.name}")
        rows.append(write_instance(folder / item.folder, item, item.make()))
    table = pandas.DataFrame(rows or {"name": []})
    write_text(folder / "index.csv", table.to_csv(index=False, lineterminator="\n"))
    n_proved = sum(row["status"] != "not proved" for row in rows)
    card = (_HERE / "card.md").read_text("utf-8")
    write_text(folder / "README.md", card.format(count=len(rows), proved=n_proved))
    for path in sorted((_HERE / "benchopt").rglob("*.txt")):
        place = path.relative_to(_HERE).with_suffix("")
        write_text(folder / place, path.read_text("utf-8"))
    write_text(folder / "CITATION.cff", (_HERE / "citation.cff").read_text("utf-8"))
    return rows


def write_instance(folder: Path, item: Entry, instance: Instance) -> dict[str, Any]:
    """Write the files of one instance: the problem in two or three formats, and its
    proof.

    Parameters
    ----------
    item : Entry
        Its name, group and sentence.

    Returns
    -------
    dict
        Its row of index.csv: name, status, sizes, and SHA-256 of each file.
    """
    status, proof = proved(instance)
    sdp = instance.sdp
    interval: tuple[str, str] | None = None
    if proof is not None:
        write_proof(proof, folder / "proof.json")
        if status == "optimum proved":
            interval = (proof["lower"], proof["upper"])
    names = ["problem.cbf"]
    # The sparse SDPA format (dat-s) has no exponential cones.
    if not any(c.kind == "exp" for c in sdp.conic.cones):
        names.append("problem.dat-s")
    loss = 0.0 if proof is None or interval is None else _loss(instance, proof)
    about = {
        "name": item.name,
        "about": item.sentence,
        "set": item.set,
        "formulation": instance.formulation,
        "hash": instance.hash,
        "parameters": [p.name for p in instance.task.model.parameters],
        "interior": None if instance.interior is None else instance.interior.tolist(),
        # Of what `shootout judge` says: the error of an objective is relative to this,
        # a violation to its constraint's size at the interior point, or least_size.
        "relative_to": max(loss, instance.least_loss),
        "least_size": instance.least_size,
    }
    sums = {}
    for name in names:
        written = export_sdp(sdp, folder / name, interval, status=status, **about)
        sums[name] = written["sha256"]
    # In the text files the quadratic objective is a linear one with a second-order cone.
    linear_problem = linear_objective(sdp.conic).problem
    arrays = _npz(sdp.conic)
    write_bytes(folder / "problem.npz", arrays)
    sums["problem.npz"] = hashlib.sha256(arrays).hexdigest()
    cones = Counter(cone.kind for cone in linear_problem.cones)
    return {
        **{name: getattr(item, name) for name in ("name", "group", "folder", "set")},
        "hash": instance.hash,
        "status": status,
        **_interval_cells(instance, status, interval),
        "parameters": len(instance.task.bound),
        "variables": len(linear_problem.q),
        "rows": len(linear_problem.b),
        "nonzeros": int(linear_problem.A.nnz),
        "cones": " ".join(f"{k}:{v}" for k, v in cones.items()),
        "sentence": item.sentence,
        **{
            f"sha256 problem.{x}": sums.get(f"problem.{x}", "")
            for x in ("cbf", "dat-s", "npz")
        },
    }


def _loss(instance: Instance, proof: Proof) -> float:
    """Return the loss at the theta that a proof of an optimum names."""
    return instance.data.loss(np.array(proof["theta"], float))


def _interval_cells(
    instance: Instance, status: str, interval: tuple[str, str] | None
) -> dict[str, str]:
    """Return the cells of index.csv on the proved interval of the optimum.

    Parameters
    ----------
    status : str
        "optimum proved", "proved infeasible" or "not proved".
    interval : (str, str), optional
        Lower and upper end as rational numbers.

    Returns
    -------
    dict
        "difficulty", "lower", "upper", and "relative_gap", the interval's width over
        the objective; the last three are "" if nothing is proved.
    """
    if interval is None:
        return {"difficulty": status, "lower": "", "upper": "", "relative_gap": ""}
    low, high = map(float, interval)
    # The objective is never negative.
    gap = (high - low) / max(high, 1e-12 * instance.data.tau_squared)
    # Accuracies from loose to tight. A problem is easy if its interval is as narrow as
    # the tightest one, and medium if it is as narrow as the next.
    _, medium, easy = Shootout.accuracies
    difficulty = "hard"
    if gap <= easy:
        difficulty = "easy"
    elif gap <= medium:
        difficulty = "medium"
    return {
        "difficulty": difficulty,
        "lower": interval[0],
        "upper": interval[1],
        "relative_gap": f"{gap:.1e}",
    }


def _npz(problem: ConicProblem) -> bytes:
    """Return a conic problem as the bytes of an .npz file with P, c, b, A and the cones.

    The problem is: minimise x^T P x / 2 + c^T x (P by its upper triangle) subject to
    b - A x in a product of cones, matrices as svec; the library's README.md explains it.
    """
    file = io.BytesIO()
    arrays: dict[str, Any] = {"c": problem.q, "b": problem.b}
    for name, matrix in (("P", problem.P.tocoo()), ("A", problem.A.tocoo())):
        arrays |= {
            f"{name}_row": matrix.row,
            f"{name}_column": matrix.col,
            f"{name}_value": matrix.data,
            f"{name}_shape": np.array(matrix.shape),
        }
    arrays |= {
        f"cone_{x}s": np.array([getattr(c, x) for c in problem.cones])
        for x in ("kind", "size")
    }
    np.savez_compressed(file, **arrays)
    return file.getvalue()
