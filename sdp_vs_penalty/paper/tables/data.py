"""Data table: how much measured motion each method needs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.estimators.estimator import Estimator
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdp, LmiSdpEntropic, LmiSdpPlain
from sdp_vs_penalty.estimators.ols import Ols
from sdp_vs_penalty.estimators.penalty import Penalty
from sdp_vs_penalty.estimators.task import make_task
from sdp_vs_penalty.paper.tables.study import Data, Study, refit_others, sentence
from sdp_vs_penalty.paper.tables.table import Cell, Column, Table
from sdp_vs_penalty.regression.regression import Regression, compress

NAME = "data"
SLOW = True

Array = NDArray[np.float64]

#: One start of `penalty` stands for all; it has no prior on friction, unlike `lmi-sdp`.
_ESTIMATORS: dict[str, Estimator] = {
    "ols": Ols(),
    "lmi-sdp-plain": LmiSdpPlain(),
    "lmi-sdp-plain, joint prior": LmiSdpPlain(joint_prior=1.0),
    "lmi-sdp": LmiSdp(),
    "lmi-sdp-entropic": LmiSdpEntropic(),
    "penalty": Penalty(starts=1),
}
#: Lengths of the training windows [s]; the last is all of the real run's training part.
SECONDS = (1, 2, 4, 7, 14)
#: Windows of each length, evenly spread; blocks that the filters cut short are left out.
_WINDOWS = 6


@dataclass(frozen=True)
class _Errors:
    """Held-out errors [%] of one method over the windows: as estimated, and of the links alone."""

    whole: list[float]
    links: list[float]


def build(study: Study) -> Table:
    rows: list[tuple[Cell, ...]] = []
    for data in study.judged:
        seconds = round(float(data.train.t[-1] - data.train.t[0]))
        blocks = compress(data.train, data.model, data.preprocessing, blocks_per_run=seconds)
        for length in SECONDS:
            windows = training_windows(blocks, length)
            study.progress(f"{len(windows)} window(s) of {length} s, {data.label}")
            for method in _ESTIMATORS:
                errors = _errors(study, data, blocks, windows, method)
                rows.append(
                    (
                        data.label,
                        length,
                        len(windows),
                        method,
                        *_spread(errors.whole),
                        *_spread(errors.links),
                    )
                )
    names = ["data", "seconds", "windows", "method"]
    names += [f"error_percent_{which}" for which in ("median", "min", "max")]
    names += [f"links_error_percent_{which}" for which in ("median", "min", "max")]
    return Table(
        NAME,
        f"How much data each method needs: {study.problem.title}",
        sentence(study),
        tuple(Column(name, digits=3) for name in names),
        tuple(rows),
        (
            "error_percent: held-out relative torque error over all joints, on the same test part "
            "for every row (simulated validation trajectories, or the real run from 14.2 s on).",
            f"Windows of filtered rows, up to {_WINDOWS} of each length, evenly spread over the "
            "training part; the filters reach 0.65 s beyond a window, never into the test part.",
            "links_error_percent: the same with friction and offsets refitted on the test part: what is "
            "left is due to the links.",
            "Within a second or two some joints do not reverse: Coulomb friction and offset have the "
            "same column, the optimal set of lmi-sdp-plain (and of penalty) is flat, and which of its "
            "points comes out is chance (large spread). lmi-sdp and lmi-sdp-entropic pull friction "
            "to zero with the weight of one sample, 'joint prior' does that alone.",
            "No weight is tuned, on the test part or elsewhere: weight 1 means that the nominal robot "
            "counts like one filtered torque row a link, and a friction parameter that alone would make "
            "all of its joint's torque like one row. That a prior on friction is needed at all was seen "
            "on windows like these; its weight and scale are that definition, not the best found on "
            "them.",
        ),
    )


def training_windows(blocks: Regression, length: int) -> list[list[int]]:
    """Indices of ``length`` consecutive one-second blocks each; the longest window is the first one."""
    rows = np.zeros(len(blocks.blocks))
    for factor in blocks.factors:
        rows[factor.block] += factor.rows
    full = np.flatnonzero(rows >= 0.9 * np.median(rows))
    if length == SECONDS[-1]:
        return [list(range(min(length, len(blocks.blocks))))]
    last = int(full[-1]) + 1 - length
    first = int(full[0])
    if last < first:
        return []
    starts = np.unique(np.linspace(first, last, _WINDOWS).round().astype(int))
    return [list(range(start, start + length)) for start in starts]


def _errors(
    study: Study, data: Data, blocks: Regression, windows: list[list[int]], method: str
) -> _Errors:
    estimator, whole, links = _ESTIMATORS[method], [], []
    for window in windows:
        task = make_task(study.problem, data.model, blocks.select(window), seed=study.seed)
        theta = estimator.fit(task).theta
        whole.append(data.errors(theta)[1])
        links.append(data.errors(refit_others(data.test_regression, theta, data.model))[1])
    return _Errors(whole, links)


def _spread(values: list[float]) -> tuple[Cell, ...]:
    if not values:
        return (None, None, None)
    return (float(np.median(values)), min(values), max(values))
