"""The conic benchmark format (.cbf), version 3: H. A. Friberg, CBF format reference."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy import sparse

from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.solvers.conic import Cone, ConicProblem

CBF_NAMES = {"zero": "L=", "nonnegative": "L+", "soc": "Q", "exp": "EXP"}


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
        cones.append(f"{CBF_NAMES[cone.kind]} {cone.rows}")
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
