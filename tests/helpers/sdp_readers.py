"""A reader of CBF files, independent of the writer, and programs that solve a .dat-s."""

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from scipy import sparse

from sdp_vs_penalty.solvers import Cone, ConicProblem
from sdp_vs_penalty.solvers.conic import CBF_NAMES


def read_cbf(path):
    """The problem of a CBF file as :func:`cbf_text` writes it: free variables, affine
    cones, scalar ones first."""
    sections = {}
    name = ""
    for text in Path(path).read_text().splitlines():
        if text.startswith("#") or not text.strip():
            name = "" if not text.strip() else name
        elif name:
            sections[name].append(text.split())
        else:
            name = text.strip()
            sections[name] = []
    m = int(sections["VAR"][0][0])
    assert sections["VAR"][1] == ["F", str(m)]
    assert sections["OBJSENSE"] == [["MIN"]]
    kinds = {v: k for k, v in CBF_NAMES.items()}
    cones = [Cone(kinds[k], int(n)) for k, n in sections.get("CON", [["0"]])[1:]]
    psd = [Cone("psd", int(line[0])) for line in sections.get("PSDCON", [["0"]])[1:]]
    place = []
    start = 0
    for cone in cones:
        rows = np.arange(start, start + cone.rows)
        place.append(rows[::-1] if cone.kind == "exp" else rows)
        start += cone.rows
    home = np.concatenate([np.zeros(0, np.intp), *place]).astype(np.intp)
    starts = start + np.cumsum([0, *(c.rows for c in psd)])
    A = sparse.lil_matrix((int(starts[-1]), m))
    b = np.zeros(int(starts[-1]))
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
    return ConicProblem(
        sparse.csc_matrix((m, m)), q, sparse.csc_matrix(A), b, (*cones, *psd)
    )


#: Programs that read a.dat-s, and where they print the optimum.
PROGRAMS = {
    "csdp": ("csdp a.dat-s", r"Dual objective value: (\S+)"),
    "sdpa": ("sdpa -ds a.dat-s -o answer -numThreads 1", r"objValPrimal = (\S+)"),
}

PACKAGES = {"csdp": "coinor-csdp", "sdpa": "sdpa"}


def outside_optimum(program, folder):
    """What an installed program says is the optimum of a.dat-s in the folder."""
    if shutil.which(program) is None:
        pytest.skip(
            f"the program {program} is not installed (Debian: {PACKAGES[program]})"
        )
    command, printed = PROGRAMS[program]
    done = subprocess.run(
        command.split(), cwd=folder, capture_output=True, text=True, check=False
    )
    text = done.stdout + "".join(p.read_text() for p in folder.glob("answer"))
    return float(re.findall(printed, text)[-1])


def _psd_row(i, j):
    low = min(i, j)
    high = max(i, j)
    return high * (high + 1) // 2 + low, 1.0 if low == high else float(np.sqrt(2.0))
