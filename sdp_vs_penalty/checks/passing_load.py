"""A load that the last link carries for a part of the time.

An arm that picks a load up, or puts it down, has the torque

    tau(t) = Y(t) theta + g(t) Y_last(t) phi,

theta (s,) the arm's parameters; phi (10,) those of the load: mass [kg], first moments
(3) [kg m], inertia (6) [kg m^2]; Y (n, s) and Y_last (n, 10) the regressors of the arm
and of its last link; g(t) one while the load is carried, else zero.

Such a load resembles a gain or a zero that changes when it comes or goes. A zero of the
last joint that changes by d turns the last link's first moments about the joint's axis:
a load makes the same change exactly. Of a joint before it the change of the weight is
alike where the motion is slow.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sdp_vs_penalty.checks.constants import PARTS
from sdp_vs_penalty.checks.likelihood import Likelihood
from sdp_vs_penalty.checks.repair import LogTransform
from sdp_vs_penalty.checks.run_log import RunLog
from sdp_vs_penalty.regression.normal_equations import Normal, NormalEquations, solve
from sdp_vs_penalty.robot.arrays import Array

#: Parameters of one rigid link: mass, first moments (3), inertia (6).
PARAMETERS_OF_LOAD = 10


@dataclass(frozen=True)
class PassingLoad:
    """A load that R runs tell of, carried from one of their parts to another."""

    #: (R PARTS, n) errors on parts left out in turn, over the mean energy of a part of
    #: the run.
    errors: Array
    #: (R PARTS, 10) parameters of the load, fitted without each part.
    parameters: Array
    #: The load in words, with the time in which it is carried [s].
    what: str


def has_load_columns(log: Likelihood) -> bool:
    """Whether the arm has rigid links, whose last one may carry a load."""
    return log.data.shared is not None and bool(len(log.data.shared.rigid_indices))


def load_columns(log: Likelihood, repair: LogTransform) -> Array:
    """Return the torque (n, M, 10) per unit of each parameter of a load on the last
    link [N m or N]; 0 where a joint's torque is not used.
    """
    assert log.data.shared is not None
    of_last_link = log.data.shared.rigid_indices[-PARAMETERS_OF_LOAD:]
    columns = log.columns(repair.arm_part)[:, :, of_last_link]
    return np.asarray(log.torque_mask(repair)[:, :, None] * columns)


def fit_passing_load(
    runs: Sequence[RunLog], weights: Array, others: Normal | None
) -> PassingLoad:
    """Fit a load that is carried for one stretch of several runs.

    Each run has PARTS parts; the stretch begins and ends between parts. Of all
    stretches it is the one that leaves the smallest weighted squared residual
    sum_rj w_rj |e_rj|^2 in all rows. Then each part is left out in turn.

    Parameters
    ----------
    runs : sequence of R RunLog
        In the order of time.
    weights : (R, n) array
        Weights of the joints' rows in each run; 0 for a joint that does not move.
    others : (gram (s, s), cross (s,)), optional
        Normal equations of further runs of the arm, without the load.
    """
    columns = [load_columns(run.log, run.repair) for run in runs]
    first, end = _likeliest_stretch(runs, columns, weights, others)
    carried = [
        _in_stretch(load, first - k * PARTS, end - k * PARTS)
        for k, load in enumerate(columns)
    ]
    normals = []
    for run, load, of_run in zip(runs, carried, weights, strict=True):
        grams, n_own = run.log.gram_matrices(run.repair, 1, load)
        gram, cross = NormalEquations.eliminating(grams, n_own).normal(of_run)
        normals.append((gram[0], cross[0]))
    errors = []
    parameters = []
    for k, (run, load) in enumerate(zip(runs, carried, strict=True)):
        rest = _sum(normals[:k] + normals[k + 1 :], others)
        arms, of_run = run.log.jackknife_errors(
            run.repair, weights[k], further_columns=load, others=rest
        )
        errors.append(of_run)
        parameters.append(arms[:, -PARAMETERS_OF_LOAD:])
    return PassingLoad(
        errors=np.concatenate(errors),
        parameters=np.concatenate(parameters),
        what=_in_words(runs, first, end),
    )


def _likeliest_stretch(
    runs: Sequence[RunLog],
    columns: Sequence[Array],
    weights: Array,
    others: Normal | None,
) -> tuple[int, int]:
    """Return the parts, from the first to before the end, in which a load explains the
    rows best; parts are numbered through all R runs, from 0 to R PARTS - 1.

    columns : of each run, the load's (n, M, 10). The stretch of all parts is left out:
    such a load belongs to the last link.
    """
    grams_of_runs = []  # (PARTS, n, w, w) with a load and without, and own columns
    for run, load in zip(runs, columns, strict=True):
        with_load, n_own = run.log.gram_matrices(run.repair, PARTS, load)
        without = with_load.copy()
        is_load = slice(-1 - PARAMETERS_OF_LOAD, -1)  # the torque is last
        without[..., is_load, :] = 0.0
        without[..., :, is_load] = 0.0
        grams_of_runs.append((with_load, without, n_own))
    n_parts = len(runs) * PARTS
    best = (np.inf, 0, n_parts)
    for first in range(n_parts):
        ends = np.arange(first + 1, n_parts + (first > 0))
        part = np.arange(n_parts)
        is_carried = (part >= first) & (part < ends[:, None])  # (ends, R PARTS)
        energy = np.zeros(len(ends))
        normals = []
        for k, (with_load, without, n_own) in enumerate(grams_of_runs):
            of_run = weights[k]
            on = is_carried[:, k * PARTS : (k + 1) * PARTS].astype(float)
            grams = np.tensordot(on, with_load, 1)
            grams += np.tensordot(1.0 - on, without, 1)
            equations = NormalEquations.eliminating(grams, n_own)
            energy += equations.energy @ of_run
            normals.append(equations.normal(of_run))
        gram, cross = _sum(normals, others)
        arms = solve(gram, cross[..., None])[..., 0]
        left = energy - np.sum(arms * cross, axis=-1)
        likeliest = int(np.argmin(left))
        best = min(best, (float(left[likeliest]), first, int(ends[likeliest])))
    return best[1:]


def _in_stretch(load: Array, first: int, end: int) -> Array:
    """Return a load's columns (n, M, 10), 0 outside the parts from ``first`` to before
    ``end`` of a run (which may lie outside it)."""
    edges = _edges_of_parts(load.shape[1])
    first, end = np.clip([first, end], 0, PARTS).tolist()
    carried = np.zeros_like(load)
    rows = slice(edges[first], edges[end])
    carried[:, rows] = load[:, rows]
    return carried


def _edges_of_parts(n_rows: int) -> list[int]:
    """Return the first row of each of PARTS parts of a run, and its number of rows."""
    edges: list[int] = np.linspace(0, n_rows, PARTS + 1).astype(int).tolist()
    return edges


def _sum(normals: Sequence[Normal], others: Normal | None) -> Normal:
    """Return the sum of normal equations (..., s + 10) of runs with a load and of others
    (s) without one.
    """
    gram = np.sum([one for one, _ in normals], axis=0)
    cross = np.sum([one for _, one in normals], axis=0)
    if others is not None:
        s = len(others[1])
        gram[..., :s, :s] += others[0]
        cross[..., :s] += others[1]
    return gram, cross


def _in_words(runs: Sequence[RunLog], first: int, end: int) -> str:
    """Say when the last link carries a load, by each run's clock [s]; parts of one run
    have one clock. What begins or ends with the rows has no "from" or "until".
    """
    load = "a load on the last link"
    if all(run.is_part for run in runs):
        since = f" from t = {_instant(runs, first):.4g} s" if first > 0 else ""
        is_to_the_end = end == len(runs) * PARTS
        until = "" if is_to_the_end else f" until t = {_instant(runs, end):.4g} s"
        return load + since + until
    places = []
    for k, run in enumerate(runs):
        begin = k * PARTS
        if first >= begin + PARTS or end <= begin:
            continue
        place = f"in {run.name}"
        if first > begin:
            place += f" from t = {_instant(runs, first):.4g} s"
        if end < begin + PARTS:
            place += f" until t = {_instant(runs, end):.4g} s"
        places.append(place)
    return f"{load} {' and '.join(places)}"


def _instant(runs: Sequence[RunLog], part: int) -> float:
    """Return the time [s] at which a part begins, by the clock of its run."""
    times = runs[part // PARTS].log.data.motion.t
    return float(times[_edges_of_parts(len(times))[part % PARTS]])
