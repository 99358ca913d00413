"""The compiled interior-point method (native/): small cones, one block of data."""

from __future__ import annotations

import ctypes
import time
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.compiled import MODULE, VARIABLE, core
from sdp_vs_penalty.solvers.conic import Cone, ConicProblem, Solution, svec, unsvec
from sdp_vs_penalty.solvers.rewrite import NotApplicableError

NAME = "native"
EXTRA = "the folder native/ of the repository"
REQUIRES = ("package", MODULE)
CONES = frozenset({"quadratic", "zero", "nonnegative", "soc", "psd", "exp"})

#: Order of the largest matrix it takes, a second-order cone's arrow included.
ORDER = 4
ITERATIONS = 60
_NONNEGATIVE, _PSD, _SECONDORDER = range(3)


def options(accuracy: float) -> dict[str, Any]:
    """What it is told."""
    return {"tolerance": accuracy, "iterations": ITERATIONS}


def licence() -> str | None:
    """Why it must not run here: switched off."""
    return f"it is switched off: unset {VARIABLE}" if core() is None else None


def structured(linear: Array, bound: Array) -> Any:
    """A compiled problem without blocks yet; |theta_k| <= bound_k (p,)."""
    module = core()
    assert module is not None
    return module.Structured(linear, bound, *_lapack())


@cache
def _lapack() -> tuple[int, int, int]:
    """Addresses of LAPACK's dpotrf and dpotrs and BLAS's dsyrk in SciPy's own copies."""
    from scipy.linalg import cython_blas, cython_lapack

    get = ctypes.pythonapi.PyCapsule_GetPointer
    get.restype, get.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    name = ctypes.pythonapi.PyCapsule_GetName
    name.restype, name.argtypes = ctypes.c_char_p, [ctypes.py_object]

    def address(module: Any, routine: str) -> int:
        capsule = module.__pyx_capi__[routine]
        return int(get(capsule, name(capsule)))

    return (
        address(cython_lapack, "dpotrf"),
        address(cython_lapack, "dpotrs"),
        address(cython_blas, "dsyrk"),
    )


def solve(problem: ConicProblem, accuracy: float = 1e-9) -> Solution:
    """Solve to the accuracy asked for (relative gap); NotApplicableError for larger cones."""
    start = time.perf_counter()
    read = _Read.of(problem)
    ready = time.perf_counter()
    theta, multipliers = np.zeros(read.p), np.zeros((read.core.blocks, ORDER, ORDER))
    # Accuracy is relative to 1 + the objective, as other solvers': 1 stands where the data have a floor.
    steps, converged, gap = read.core.solve(
        read.R, read.rho, 1.0, np.zeros(read.p), 1.0, accuracy, ITERATIONS, theta, multipliers
    )
    seconds = time.perf_counter() - ready
    claims = "optimal" if converged else "inaccurate" if gap < 1e-6 else "failed"
    x, z = read.back(theta, multipliers)
    return Solution(x, z, claims, said(converged, gap), steps, ready - start, seconds)


def said(converged: bool, gap: float) -> str:
    return "converged" if converged else f"stopped at a relative gap of {gap:.1e}"


@dataclass(frozen=True)
class _Cones:
    """What is read block by block: kind (0 nonnegative, 1 psd, 2 second-order), order, first row.

    Of a log det the first column of its logarithms and its weight, else -1 and 0.
    """

    kind: NDArray[np.int64]
    order: NDArray[np.int64]
    first: NDArray[np.int64]
    logs: NDArray[np.int64]
    weight: Array


@dataclass(frozen=True)
class _Read:
    """A conic problem with the residual as variables of its own, read as what it was written from."""

    problem: ConicProblem
    p: int
    R: Array
    rho: Array
    cones: _Cones
    core: Any

    @classmethod
    def of(cls, problem: ConicProblem) -> _Read:
        A, cones, width = problem.A.tocsr(), problem.cones, len(problem.q)
        equal = cones[0].size if cones and cones[0].kind == "zero" else 0
        found = _cones(problem, A, equal)
        p = width - equal - 14 * int(np.sum(found.logs >= 0))
        top = slice(A.indptr[0], A.indptr[equal])
        columns = A.indices[top]
        P = problem.P.diagonal()
        fits = (
            p >= 0
            and problem.P.nnz == np.count_nonzero(P)
            and not P[:p].any()
            and np.all(P[p : p + equal] == 2.0)
            and np.array_equal(columns[columns >= p], p + np.arange(equal))
            and np.all(A.data[top][columns >= p] == -1.0)
        )
        if not fits:
            raise NotApplicableError("native takes |R theta - rho|^2 and small cones only")
        R = np.zeros((equal, width))
        R[np.repeat(np.arange(equal), np.diff(A.indptr[: equal + 1])), columns] = A.data[top]
        core = structured(np.array(problem.q[:p], float), np.full(p, np.inf))
        starts, columns = A.indptr.astype(np.int64), A.indices.astype(np.int64)
        core.read(starts, columns, A.data, problem.b, found.kind, found.order, found.first, found.weight)
        return cls(problem, p, np.ascontiguousarray(R[:, :p]), problem.b[:equal].copy(), found, core)

    def back(self, theta: Array, multipliers: Array) -> tuple[Array, Array]:
        """x and z of the conic problem: residual, logarithms, and what the short form does without."""
        problem = self.problem
        x, z = np.zeros(len(problem.q)), np.zeros(len(problem.b))
        x[: self.p] = theta
        equal = len(self.rho)
        x[self.p : self.p + equal] = self.R @ theta - self.rho
        z[:equal] = 2.0 * x[self.p : self.p + equal]
        slack = problem.b - problem.A @ x
        c, block = self.cones, 0
        for kind, d, start, logs, weight in zip(c.kind, c.order, c.first, c.logs, c.weight, strict=True):
            if kind == _NONNEGATIVE:
                z[start : start + d] = multipliers[block : block + d, 0, 0]
                block += int(d)
                continue
            Z = multipliers[block, :d, :d]
            block += 1
            if logs >= 0:
                P = unsvec(slack[start : start + 10], 4)
                _with_logarithms(x, z, P, Z, int(start), int(logs), float(weight))
            elif kind == _SECONDORDER:
                z[start : start + d] = np.concatenate([[np.trace(Z)], 2.0 * Z[0, 1:]])
            else:
                z[start : start + d * (d + 1) // 2] = svec(Z)
        return x, z


def _cones(problem: ConicProblem, A: Any, equal: int) -> _Cones:
    """NotApplicableError for cones that are none of these."""
    rows: list[tuple[int, int, int, int, float]] = []
    order, start = iter(problem.cones[1:] if equal else problem.cones), equal
    for cone in order:
        if cone.kind == "psd" and cone.size == 8:
            following = [next(order, Cone("", 0)).kind for _ in range(4)]
            first, end = A.indptr[start + 36 : start + 38]
            logs = int(A.indices[first]) if end == first + 1 else -1
            weights = -problem.q[logs : logs + 4]
            if following != ["exp"] * 4 or logs < 0 or weights[0] <= 0.0 or np.ptp(weights) > 0.0:
                raise NotApplicableError("native takes exp only as the log det of a 4x4 matrix")
            rows.append((_PSD, 4, start, logs, float(weights[0])))
            start += 36 + 12
            continue
        kind = {"nonnegative": _NONNEGATIVE, "psd": _PSD, "soc": _SECONDORDER}.get(cone.kind)
        if kind is None or (kind != _NONNEGATIVE and cone.size > ORDER):
            raise NotApplicableError(f"native takes no cone {cone.kind} of size {cone.size}")
        rows.append((kind, cone.size, start, -1, 0.0))
        start += cone.rows
    columns = list(zip(*rows, strict=True)) or [(), (), (), (), ()]
    whole = [np.array(column, np.int64) for column in columns[:4]]
    return _Cones(whole[0], whole[1], whole[2], whole[3], np.array(columns[4], float))


def _with_logarithms(
    x: Array, z: Array, P: Array, Z: Array, start: int, logs: int, weight: float
) -> None:
    """Fill in [[P, L], [L^T, D]] >= 0 with D = diag L, and exp(t) <= D.

    At the optimum P = L D^-1 L^T and t = log D; the dual is N Z N^T with N = [1; -D^-1 L^T].
    """
    try:
        root = np.linalg.cholesky(P)
    except np.linalg.LinAlgError:
        x[:], z[:] = np.nan, np.nan
        return
    lower = root * np.diagonal(root)
    D = np.diagonal(lower)
    x[logs - 10 : logs] = [lower[i, j] for j in range(4) for i in range(j, 4)]
    x[logs : logs + 4] = np.log(D)
    null = np.vstack([np.eye(4), -(lower / D).T])
    z[start : start + 36] = svec(null @ Z @ null.T)
    exps = np.column_stack([np.full(4, -weight), weight * (np.log(D) - 1.0), weight / D])
    z[start + 36 : start + 48] = exps.ravel()
