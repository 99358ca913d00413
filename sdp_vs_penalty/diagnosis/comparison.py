"""Measured against modelled torque: how large the error of each joint is, beside the noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.plausibility import check_plausible
from sdp_vs_penalty.diagnosis.rows import with_estimate
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.signals.noise import noise_floor
from sdp_vs_penalty.signals.preprocessing import Preprocessing, Rows, filtered_torque
from sdp_vs_penalty.signals.segments import segmented

if TYPE_CHECKING:
    import pandas

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Comparison:
    """One model against measurements, all joints in the same stated band.

    rmse [N m or N], mse, r2 (1 - mse / variance of the measured torque): (n,) each; noise_floor
    (n,) or None where no motion repeats; relative_error_percent: 100 |tau - tau_hat| / |tau| over
    all joints; band_hz: the low-pass that both sides passed.
    """

    name: str
    rmse: Array
    mse: Array
    r2: Array
    noise_floor: Array | None
    relative_error_percent: float
    band_hz: float

    def to_dict(self) -> dict[str, Any]:
        return {
            "model": self.name,
            "rmse": self.rmse.tolist(),
            "mse": self.mse.tolist(),
            "r2": [_number(x) for x in self.r2],
            "noise_floor": [None] * len(self.rmse)
            if self.noise_floor is None
            else self.noise_floor.tolist(),
            "relative_error_percent": _number(self.relative_error_percent),
            "band_hz": self.band_hz,
        }


def _number(x: float) -> float | None:
    """JSON knows no NaN: what is undefined (no torque at all) is null."""
    return float(x) if np.isfinite(x) else None


def compare(
    models: Estimate | Sequence[Estimate] | Mapping[str, Estimate],
    measurements: Measurements,
    preprocessing: Preprocessing | None = None,
    *,
    noise_from: Measurements | None = None,
) -> list[Comparison]:
    """Compare one or several models with the same measurements.

    All models are judged behind the same filters: those of the first model, or ``preprocessing``.
    noise_from : the runs whose repetition shows the noise floor (default: the measurements).
    Raises InputError where a model and the measurements have different numbers of joints.
    """
    if isinstance(models, Estimate):
        models = {models.method: models}
    elif not isinstance(models, Mapping):
        models = {f"{k + 1} ({m.method})": m for k, m in enumerate(models)}
    if not models:
        raise InputError("No model to compare: name at least one model.json.")
    settings = preprocessing or next(iter(models.values())).preprocessing
    settings = settings.resolve(measurements)
    assert settings.torque_cutoff is not None
    repeated = segmented(measurements if noise_from is None else noise_from, settings)
    out = []
    for name, model in models.items():
        if model.robot.n != measurements.n:
            raise InputError(
                f"model {name} is of a robot with {model.robot.n} joint(s), the measurements have "
                f"{measurements.n}: choose the model that belongs to them."
            )
        check_plausible(model.robot, measurements)
        runs = [filtered_torque(run, model.model, settings) for run in measurements.runs()]
        residuals = [rows.torque - predicted(rows, model.theta) for rows in runs]
        torque, error = (
            np.concatenate([rows.torque for rows in runs]),
            np.concatenate(residuals),
        )
        mse = np.mean(error**2, axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            r2 = np.where(torque.var(axis=0) > 0.0, 1.0 - mse / torque.var(axis=0), np.nan)
            relative = 100.0 * np.linalg.norm(error) / np.linalg.norm(torque)
        floor = noise_floor(with_estimate(repeated, model))
        out.append(
            Comparison(name, np.sqrt(mse), mse, r2, floor, float(relative), settings.torque_cutoff)
        )
    return out


def comparison_frame(comparisons: Sequence[Comparison]) -> pandas.DataFrame:
    """Comparisons side by side: one row a model and joint (from 1), for a notebook."""
    import pandas

    rows = [
        {
            "model": c.name,
            "joint": j + 1,
            "rmse": c.rmse[j],
            "r2": c.r2[j],
            "noise_floor": np.nan if c.noise_floor is None else c.noise_floor[j],
        }
        for c in comparisons
        for j in range(len(c.rmse))
    ]
    return pandas.DataFrame(rows).set_index(["model", "joint"])


def predicted(rows: Rows, theta: Array) -> Array:
    """Modelled torque (M, n) of filtered rows: the columns passed the same filter as the torque."""
    return np.column_stack([c.columns @ theta[c.indices] for c in rows.columns])
