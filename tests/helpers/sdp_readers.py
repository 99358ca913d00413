"""Readers of the two SDP file formats, independent of the writers: what is exported comes back."""

from pathlib import Path

import numpy as np
from scipy import sparse

from sdp_vs_penalty import InputError
from sdp_vs_penalty.solvers import Cone, ConicProblem
from sdp_vs_penalty.solvers.conic_files import CBF_NAMES


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
    kinds = {v: k for k, v in CBF_NAMES.items()}
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
