"""An identification SDP as a file for any solver: sparse SDPA (.dat-s) or conic benchmark format (.cbf).

Both formats hold a linear objective; SDPA's holds matrix inequalities only. The problem is rewritten
exactly (:mod:`solvers.rewrite`) and read back by :func:`read_sdpa` and :func:`read_cbf`. Numbers are
written with 17 digits, so that nothing is lost.

Sources: the SDPA format as in Borchers, SDPLIB (Optim. Methods Softw. 1999); H. A. Friberg, CBF
format reference, version 3.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.solvers.conic import Cone, ConicProblem
from sdp_vs_penalty.solvers.identification import least_squares_sdp
from sdp_vs_penalty.solvers.rewrite import linear_matrix_inequalities, linear_objective

Array = NDArray[np.float64]

_CBF_NAMES = {"zero": "L=", "nonnegative": "L+", "soc": "Q", "exp": "EXP"}


def export_sdp(problem: ConicProblem, path: str | Path) -> None:
    """Write the problem in the format of the file's ending, .dat-s or .cbf.

    Raises InputError for another ending, or where the format lacks one of the problem's cones.
    """
    name = Path(path).name
    if name.endswith(".dat-s"):
        if any(c.kind == "exp" for c in problem.cones):
            raise InputError(
                f"{path}: the SDPA format has no exponential cone, which the entropic regulariser "
                "needs; write a .cbf file instead."
            )
        write_text(path, sdpa_text(linear_matrix_inequalities(problem).problem))
    elif name.endswith(".cbf"):
        write_text(path, cbf_text(linear_objective(problem).problem))
    else:
        raise InputError(f"{path}: name the file .dat-s (sparse SDPA) or .cbf (conic benchmark format).")


def posed(
    problem: str, data: Sequence[Path], method: str = "lmi-sdp", effects: str | None = None
) -> ConicProblem:
    """The conic form of identifying a problem from measured runs, centred and scaled.

    Raises InputError where the method solves no one-step SDP, or the input cannot be used.
    """
    from sdp_vs_penalty.estimators import make_estimator, make_task
    from sdp_vs_penalty.estimators.lmi_sdp import LmiSdp, essential, interior_point
    from sdp_vs_penalty.measurements import load_measurements
    from sdp_vs_penalty.problem import load_problem
    from sdp_vs_penalty.regression import compress

    estimator = make_estimator(method)
    if not isinstance(estimator, LmiSdp):
        raise InputError(
            f"method {method} is not one SDP: take lmi-sdp, lmi-sdp-plain or lmi-sdp-entropic."
        )
    robot = load_problem(problem)
    names = [joint.name for joint in robot.robot.joints]
    measurements = load_measurements(*data, joints=robot.robot.n, names=names)
    model = robot.model(effects)
    regression = compress(measurements, model, robot.preprocessing.resolve(measurements))
    task = make_task(robot, model, regression)
    objective, constraints = estimator.posed(task)
    interior = interior_point(task, constraints)
    sent = essential(constraints, objective)
    least = 1e-6 * objective.least_squares.tau_squared
    return least_squares_sdp(objective, sent, interior, task.bound, interior, least_loss=least).conic


def sdpa_text(problem: ConicProblem) -> str:
    """Sparse SDPA: minimise c^T x subject to sum_i x_i F_i - F_0 >= 0, blocks in order of the cones."""
    sizes = [-c.size if c.kind == "nonnegative" else c.size for c in problem.cones]
    lines = [
        '"physically consistent identification of robot dynamics, by sdp-vs-penalty"',
        f"{len(problem.q)} = mDIM",
        f"{len(sizes)} = nBLOCK",
        " ".join(str(s) for s in sizes),
        " ".join(f"{x:.17g}" for x in problem.q),
    ]
    block, i, j, factor = _entries(problem.cones)
    constant = -problem.b * factor
    for row in np.flatnonzero(constant):
        lines.append(f"0 {block[row]} {i[row]} {j[row]} {constant[row]:.17g}")
    matrix = sparse.csc_matrix(problem.A)
    for k in range(matrix.shape[1]):
        for at in range(matrix.indptr[k], matrix.indptr[k + 1]):
            row = matrix.indices[at]
            value = -matrix.data[at] * factor[row]
            if value != 0.0:
                lines.append(f"{k + 1} {block[row]} {i[row]} {j[row]} {value:.17g}")
    return "\n".join(lines) + "\n"


def read_sdpa(path: str | Path) -> ConicProblem:
    """The problem of a sparse SDPA file; raises InputError naming the line that is not one."""
    try:
        lines = Path(path).read_text().splitlines()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from error
    body = [(n, s) for n, s in enumerate(lines, start=1) if s.strip() and s[0] not in '"*']
    try:
        variables, blocks = int(body[0][1].split()[0]), int(body[1][1].split()[0])
        sizes = [int(word) for word in _numbers(body[2][1])]
        q = np.array([float(word) for word in _numbers(body[3][1])])
        if len(sizes) != blocks or len(q) != variables:
            raise ValueError
    except (ValueError, IndexError):
        raise InputError(
            f"{path}: the four lines of the header of an SDPA file are not there."
        ) from None
    cones = tuple(Cone("nonnegative" if s < 0 else "psd", abs(s)) for s in sizes)
    starts = np.cumsum([0, *(c.rows for c in cones)])
    b = np.zeros(starts[-1])
    rows, columns, values = [], [], []
    for number, text in body[4:]:
        try:
            k, block, i, j = (int(word) for word in text.split()[:4])
            value = float(text.split()[4])
            low, high = min(i, j) - 1, max(i, j) - 1
            cone = cones[block - 1]
            if not (0 <= k <= variables and block >= 1 and low >= 0 and high < cone.size):
                raise ValueError
        except (ValueError, IndexError):
            raise InputError(
                f"{path}: line {number} is not `matrix block row column value` within the sizes."
            ) from None
        if cone.kind == "nonnegative":
            row = starts[block - 1] + low
        else:
            row = starts[block - 1] + high * (high + 1) // 2 + low
            value *= 1.0 if low == high else np.sqrt(2.0)
        if k == 0:
            b[row] -= value
        else:
            rows.append(row)
            columns.append(k - 1)
            values.append(-value)
    A = sparse.csc_matrix((values, (rows, columns)), (len(b), variables))
    return ConicProblem(sparse.csc_matrix((variables, variables)), q, A, b, cones)


def _numbers(text: str) -> list[str]:
    """SDPA allows commas, braces and parentheses between numbers."""
    return text.translate(str.maketrans(",(){}", "     ")).split()


def _entries(cones: tuple[Cone, ...]) -> tuple[Array, Array, Array, Array]:
    """For each row its block, row and column (from 1) and the factor that turns svec into entries."""
    block, i, j, factor = [], [], [], []
    for number, cone in enumerate(cones, start=1):
        if cone.kind == "psd":
            column, row = np.tril_indices(cone.size)
            weight = np.where(row == column, 1.0, 1.0 / np.sqrt(2.0))
        else:
            row = column = np.arange(cone.size)
            weight = np.ones(cone.size)
        block.append(np.full(len(row), number))
        i.append(row + 1)
        j.append(column + 1)
        factor.append(weight)
    return tuple(np.concatenate(x) for x in (block, i, j, factor))  # type: ignore[return-value]


def cbf_text(problem: ConicProblem) -> str:
    """CBF: free variables x, affine cones by rows of (h - G x), psd cones by HCOORD and DCOORD."""
    scalar, psd = _split(problem)
    matrix = sparse.csr_matrix(problem.A)
    lines = [
        "VER",
        "3",
        "",
        "OBJSENSE",
        "MIN",
        "",
        "VAR",
        f"{len(problem.q)} 1",
        f"F {len(problem.q)}",
        "",
    ]
    if psd:
        lines += ["PSDCON", str(len(psd)), *(str(cone.size) for _, cone in psd), ""]
    rows, cones = [], []
    for start, cone in scalar:
        order = np.arange(start, start + cone.rows)
        rows.append(order[::-1] if cone.kind == "exp" else order)  # CBF: (t, s, r), t >= s exp(r / s)
        cones.append(f"{_CBF_NAMES[cone.kind]} {cone.rows}")
    order = np.concatenate([np.zeros(0, np.intp), *rows]).astype(np.intp)
    if cones:
        lines += ["CON", f"{len(order)} {len(cones)}", *cones, ""]
    objective = np.flatnonzero(problem.q)
    lines += _section("OBJACOORD", (f"{k} {problem.q[k]:.17g}" for k in objective))
    if psd:
        lines += _section("HCOORD", _psd_coordinates(psd, matrix))
    part = (-matrix[order]).tocoo()
    lines += _section(
        "ACOORD", (f"{r} {c} {v:.17g}" for r, c, v in zip(part.row, part.col, part.data, strict=True))
    )
    right = problem.b[order]
    lines += _section("BCOORD", (f"{k} {right[k]:.17g}" for k in np.flatnonzero(right)))
    if psd:
        lines += _section("DCOORD", _psd_constants(psd, problem.b))
    return "\n".join(lines) + "\n"


def _split(problem: ConicProblem) -> tuple[list[tuple[int, Cone]], list[tuple[int, Cone]]]:
    starts = np.cumsum([0, *(c.rows for c in problem.cones)]).tolist()
    both = list(zip(starts[:-1], problem.cones, strict=True))
    return [p for p in both if p[1].kind != "psd"], [p for p in both if p[1].kind == "psd"]


def _section(name: str, rows: Iterator[str]) -> list[str]:
    found = list(rows)
    return [name, str(len(found)), *found, ""] if found else []


def _psd_coordinates(psd: list[tuple[int, Cone]], matrix: sparse.csr_matrix) -> Iterator[str]:
    for number, (start, cone) in enumerate(psd):
        column, row = np.tril_indices(cone.size)
        part = (-matrix[start : start + cone.rows]).tocoo()
        for k, variable, value in zip(part.row, part.col, part.data, strict=True):
            i, j = column[k], row[k]  # the lower triangle: i >= j
            entry = value if i == j else value / np.sqrt(2.0)
            yield f"{number} {variable} {i} {j} {entry:.17g}"


def _psd_constants(psd: list[tuple[int, Cone]], b: Array) -> Iterator[str]:
    for number, (start, cone) in enumerate(psd):
        column, row = np.tril_indices(cone.size)
        for k in np.flatnonzero(b[start : start + cone.rows]):
            value = b[start + k] if column[k] == row[k] else b[start + k] / np.sqrt(2.0)
            yield f"{number} {column[k]} {row[k]} {value:.17g}"


def read_cbf(path: str | Path) -> ConicProblem:
    """The problem of a CBF file as :func:`cbf_text` writes it: free variables, affine cones.

    Cones come scalar first, then psd. Raises InputError naming the section that cannot be used.
    """
    try:
        words = Path(path).read_text().splitlines()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from error
    sections: dict[str, list[list[str]]] = {}
    name = ""
    for text in words:
        if text.startswith("#") or not text.strip():
            name = "" if not text.strip() else name
        elif name:
            sections[name].append(text.split())
        else:
            name = text.strip()
            sections[name] = []
    try:
        return _cbf_problem(sections)
    except (KeyError, ValueError, IndexError) as error:
        raise InputError(f"{path}: not a CBF file of this form ({error}).") from None


def _cbf_problem(sections: dict[str, list[list[str]]]) -> ConicProblem:
    m = int(sections["VAR"][0][0])
    if sections["VAR"][1] != ["F", str(m)] or sections["OBJSENSE"] != [["MIN"]]:
        raise ValueError("only free variables and MIN are read")
    kinds = {v: k for k, v in _CBF_NAMES.items()}
    cones = [Cone(kinds[k], int(n)) for k, n in sections.get("CON", [["0"]])[1:]]
    psd = [Cone("psd", int(line[0])) for line in sections.get("PSDCON", [["0"]])[1:]]
    place, start = [], 0
    for cone in cones:
        rows = np.arange(start, start + cone.rows)
        place.append(rows[::-1] if cone.kind == "exp" else rows)
        start += cone.rows
    home = np.concatenate([np.zeros(0, np.intp), *place]).astype(np.intp)
    starts = start + np.cumsum([0, *(c.rows for c in psd)])
    A, b = sparse.lil_matrix((int(starts[-1]), m)), np.zeros(int(starts[-1]))
    q = np.zeros(m)
    for k, value in sections.get("OBJACOORD", [[]])[1:]:
        q[int(k)] = float(value)
    for row, column, value in sections.get("ACOORD", [[]])[1:]:
        A[home[int(row)], int(column)] = -float(value)
    for row, value in sections.get("BCOORD", [[]])[1:]:
        b[home[int(row)]] = float(value)
    for block, variable, i, j, value in sections.get("HCOORD", [[]])[1:]:
        at, weight = _psd_row(int(i), int(j))
        A[int(starts[int(block)]) + at, int(variable)] = -float(value) * weight
    for block, i, j, value in sections.get("DCOORD", [[]])[1:]:
        at, weight = _psd_row(int(i), int(j))
        b[int(starts[int(block)]) + at] = float(value) * weight
    return ConicProblem(sparse.csc_matrix((m, m)), q, sparse.csc_matrix(A), b, (*cones, *psd))


def _psd_row(i: int, j: int) -> tuple[int, float]:
    low, high = min(i, j), max(i, j)
    return high * (high + 1) // 2 + low, 1.0 if low == high else float(np.sqrt(2.0))
