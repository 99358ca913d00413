"""A plain greedy BIC over the hypotheses of `check` and `diagnose`: the baseline.

D = sum_j N_j log(RSS_j / TSS_j) of rows that a second-order autoregression whitens; a
hypothesis has to lower D by log N for each number that it has. The best one of all is
taken, again and again. Nothing here is priced, coarsened, held out or calibrated: a
hypothesis is sure if it lowers the BIC by 10, and those within 6 of it are its rivals.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.judge import Claim
from sdp_vs_penalty import identify, load_measurements, load_problem
from sdp_vs_penalty.data.measurements import Measurements, concatenate
from sdp_vs_penalty.diagnosis.candidates import list_candidates
from sdp_vs_penalty.diagnosis.white_rows import (
    diagnosis_rows,
    model_columns,
    whiten_rows,
)
from sdp_vs_penalty.effects import effect_in_words
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.problem.problem import Problem

Array = NDArray[np.float64]
SURE = 10.0
RIVALS = 6.0
MOST = 5
#: Seconds of the log on which changes of the log are tried [s].
PART = 12.0


@dataclass(frozen=True)
class Change:
    """A change of the log, in words, with how many numbers it has."""

    text: str
    joints: tuple[int, ...]
    numbers: int
    of_run: Callable[[Measurements], Measurements]

    def of(self, runs: Measurements) -> Measurements:
        """Change every run."""
        return concatenate([self.of_run(run) for run in runs.runs()])


def changes(n: int) -> Iterator[Change]:
    """Yield what may have been done to a log of n joints, undone."""
    for j in range(n):
        one = np.where(np.arange(n) == j, -1.0, 1.0)
        at = (j + 1,)
        yield Change("torque sign", at, 0, _by(tau=one))
        yield Change("joint sign", at, 0, _by(tau=one, q=one))
        yield Change("position sign", at, 0, _by(q=one))
        for degrees in (-90, -45, -20, -10, -5, 5, 10, 20, 45, 90, 180):
            zero = np.where(np.arange(n) == j, np.radians(degrees), 0.0)
            yield Change("joint zero", at, 1, lambda r, z=zero: replace(r, q=r.q + z))
        for gain in (0.01, 0.1, 0.5, 0.7, 0.8, 0.9, 1.1, 1.25, 1.5, 2.0, 10.0):
            each = np.where(np.arange(n) == j, gain, 1.0)
            yield Change("torque gain", at, 1, _by(tau=each))
        for ratio in (0.5, 2.0 / 3.0, 1.5, 2.0):
            each = np.where(np.arange(n) == j, ratio, 1.0)
            yield Change("gear ratio", at, 1, _by(q=each, tau=1.0 / each))
        for late in (-0.02, -0.01, 0.01, 0.02, 0.04):
            yield Change("channel delay", at, 1, _sooner(late, [j]))
    for i, j in combinations(range(n), 2):
        order = np.arange(n)
        order[[i, j]] = j, i
        at = (i + 1, j + 1)
        swapped = lambda r, o=order, w=("tau",): replace(  # noqa: E731
            r, **{x: getattr(r, x)[:, o] for x in w}
        )
        yield Change("torque order", at, 0, swapped)
        yield Change("position order", at, 0, lambda r, s=swapped: s(r, w=("q",)))
        yield Change("joint order", at, 0, lambda r, s=swapped: s(r, w=("q", "tau")))
    for late in (-0.02, -0.01, -0.005, 0.005, 0.01, 0.02, 0.04):
        word = "delay: late" if late > 0.0 else "delay: early"
        yield Change(word, (), 1, _sooner(late, range(n)))
    for factor in (0.5, 0.77, 0.9, 1.1, 1.3, 2.0):
        yield Change("clock", (), 1, lambda r, f=factor: replace(r, t=r.t * f, dq=None))
    yield Change(
        "time reversed",
        (),
        0,
        lambda r: replace(r, q=r.q[::-1].copy(), tau=r.tau[::-1].copy(), dq=None),
    )
    yield Change("degrees", (), 0, _by(q=np.full(n, np.pi / 180.0)))


def _by(q: Any = 1.0, tau: Any = 1.0) -> Callable[[Measurements], Measurements]:
    return lambda r: replace(r, q=r.q * q, tau=r.tau * tau, dq=None)


def _sooner(late: float, joints: Any) -> Callable[[Measurements], Measurements]:
    def change(r: Measurements) -> Measurements:
        tau = r.tau.copy()
        for j in joints:
            tau[:, j] = np.interp(r.t + late, r.t, r.tau[:, j])
        return replace(r, tau=tau)

    return change


def whitened(X: Array, y: Array) -> tuple[Array, Array]:
    """Whiten columns (n, M, p) and torque (n, M) of each joint by the second-order
    autoregression of what least squares leave.
    """
    out_X, out_y = [], []
    for columns, torque in zip(X, y, strict=True):
        left = torque - columns @ np.linalg.lstsq(columns, torque, rcond=1e-9)[0]
        past = np.column_stack([left[1:-1], left[:-2]])
        a, b = np.linalg.lstsq(past, left[2:], rcond=None)[0]
        out_X.append(columns[2:] - a * columns[1:-1] - b * columns[:-2])
        out_y.append(torque[2:] - a * torque[1:-1] - b * torque[:-2])
    return np.array(out_X), np.array(out_y)


@dataclass(frozen=True)
class Fitted:
    """A fit of all joints together, each weighted by its own residual."""

    #: D.
    deviance: float
    #: (n, M) weighted residual.
    left: Array
    #: (n M, r) orthonormal weighted columns.
    basis: Array
    #: (n,) residual of each joint, by which it is weighted.
    level: Array


def fit(X: Array, y: Array) -> Fitted:
    """Fit columns (n, M, p) to torque (n, M)."""
    n, M, p = X.shape
    level = y.std(axis=1)
    for _ in range(3):
        rows = (X / level[:, None, None]).reshape(n * M, p)
        scale = np.linalg.norm(rows, axis=0)
        q, r = np.linalg.qr(rows[:, scale > 0.0] / scale[scale > 0.0])
        basis = q[:, np.abs(np.diag(r)) > 1e-6]
        target = (y / level[:, None]).ravel()
        left = (target - basis @ (basis.T @ target)).reshape(n, M) * level[:, None]
        level = np.maximum(left.std(axis=1), 1e-9 * y.std(axis=1) + 1e-300)
    D = M * np.log(level**2 / np.maximum(np.mean(y**2, axis=1), 1e-300)).sum()
    return Fitted(float(D), left / level[:, None], basis, level)


def deviance_of(model: Any, run: Measurements) -> tuple[float, int]:
    """Return D a row of a log with the model's own columns, and the number of rows."""
    rows = diagnosis_rows(run, model, model.preprocessing.resolve(run))
    X, y = whitened(model_columns(rows, model), rows.torque.T)
    return fit(X, y).deviance / y.size, y.size


def part_of(run: Measurements) -> Measurements:
    """Return the begin of each run, on which changes of the log are tried."""
    parts = [r.window(r.t[0], r.t[0] + PART) for r in run.runs()]
    return concatenate(parts)


def best_change(
    model: Any, run: Measurements
) -> tuple[float, Change | None, list[Change]]:
    """Return by how much the best change of the log lowers the BIC, and its rivals."""
    part = part_of(run)
    before, size = deviance_of(model, part)
    gains: list[tuple[float, Change]] = []
    for change in changes(run.n):
        try:
            D, _ = deviance_of(model, change.of(part))
        except (InputError, ValueError, np.linalg.LinAlgError):
            continue
        rows = size * run.samples / part.samples
        gains.append((rows * (before - D) - change.numbers * np.log(rows), change))
    if not gains:
        return -np.inf, None, []
    gains.sort(key=lambda pair: -pair[0])
    best = gains[0][0]
    return best, gains[0][1], [c for g, c in gains[1:] if g > best - RIVALS]


def best_effects(model: Any, run: Measurements) -> Iterator[tuple[float, Any, list]]:
    """Yield greedily the effects that lower the BIC most, each with its rivals."""
    settings = model.preprocessing.resolve(run)
    data = whiten_rows(diagnosis_rows(run, model, settings), model)
    library = list_candidates(data)
    X, y = data.X, data.y
    taken: set[Any] = set()
    for _ in range(MOST):
        fitted = fit(X, y)
        left, basis, level = fitted.left, fitted.basis, fitted.level
        n, M = y.shape
        scored = []
        for batch in library.batches:
            for f, form in enumerate(batch.forms):
                if form.key in taken:
                    continue
                Z = np.zeros((n, M, form.n_coefficients))
                for j, columns in batch.columns(f).items():
                    Z[j] = columns / level[j]
                Z = Z.reshape(n * M, -1)
                own = (Z**2).sum(0)
                Z = Z - basis @ (basis.T @ Z)
                if not np.any((Z**2).sum(0) > 1e-3 * own + 1e-12):
                    continue
                beta = np.linalg.lstsq(Z, left.ravel(), rcond=1e-6)[0]
                after = ((left.ravel() - Z @ beta).reshape(n, M) ** 2).mean(1)
                drop = -M * np.log(after / (left**2).mean(1)).sum()
                numbers = form.n_coefficients + form.n_constants
                scored.append((drop - numbers * np.log(n * M), form, batch, f))
        if not scored:
            return
        scored.sort(key=lambda entry: -entry[0])
        gain, form, batch, f = scored[0]
        if gain <= SURE:
            return
        rivals = {
            s[1].key[0] for s in scored if s[0] > gain - RIVALS and s[1].key != form.key
        }
        yield gain, form, sorted(rivals)
        taken.add(form.key)
        Z = np.zeros((n, M, form.n_coefficients))
        for j, columns in batch.columns(f).items():
            Z[j] = columns
        X = np.concatenate([X, Z], axis=2)


def said_of(folder: Path, robot: str) -> tuple[list[Claim], str, tuple[str, str]]:
    """Return the claims of the baseline on a log: changes of it, then effects."""
    nothing = ("", "")
    claims: list[Claim] = []
    try:
        problem = load_problem(folder / robot if (folder / robot).exists() else robot)
        runs = load_runs(problem, folder)
        model = identify(problem, runs, "ols", check=False)
        for _ in range(2):
            gain, change, rivals = best_change(model, runs)
            if change is None or gain <= SURE:
                break
            first = next(best_effects(model, runs), (0.0, None, []))
            if first[0] > gain:
                break
            also = sorted({r.text for r in rivals} - {change.text})
            words = (
                f"{change.text} (joints {change.joints}); as well: {', '.join(also)}"
            )
            claims.append(Claim("check", words, change.joints, True))
            runs = change.of(runs)
            model = identify(problem, runs, "ols", check=False)
        for _, form, others in best_effects(model, runs):
            joints = () if form.key[1] is None else (form.key[1] + 1,)
            words = form.effect.name.replace("_", " ") + ": "
            if form.replaces_own_constant:
                words = f"re-estimate {form.effect.text}".replace("_", " ") + ": "
                words = words.replace("v s", "v_s")
            words += effect_in_words(form.effect.text)
            words += "; as well: " + ", ".join(others).replace("_", " ")
            claims.append(Claim("diagnose", words, joints, True))
    except (InputError, ValueError, np.linalg.LinAlgError) as error:
        return claims, str(error), nothing
    return claims, "", nothing


def load_runs(problem: Problem, folder: Path) -> Measurements:
    """Read the recordings of a log."""
    robot = problem.robot
    paths = sorted(folder.glob("run*.csv"))
    read = [
        load_measurements(p, joints=robot.n, names=robot.joint_names) for p in paths
    ]
    return concatenate(read)
