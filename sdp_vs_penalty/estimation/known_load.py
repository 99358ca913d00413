"""Gains of the torque channels from a load that was weighed.

Torque from motor currents is true up to a gain a joint, and every inertial parameter scales with it.
Between joints the gains follow from the links that they share; the one common scale needs something
known: the mass of a load in further runs (Gautier, Briot, ASME J. Dynamic Systems 2014). With channel j
reading g_j times the true torque,

    tau_j = g_j Y_j theta                                 without the load,
    tau_j = g_j (Y_j theta + Y_L,j (m, psi))              with it, m known, psi its nine others,

is solved for theta, psi and ln g by Gauss-Newton on the compressed runs, with weak priors: gains are
within ``GAIN_PRIOR`` of one, and the load lies within ``LOAD_REACH`` of the last link's frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sdp_vs_penalty.data.files import Source, as_measurements
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.effect import Parameter
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.effects.payload import Payload
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.constants import GAIN_PRIOR, LOAD_REACH, NORMAL_95
from sdp_vs_penalty.estimation.sandwich import sandwich, white_variance
from sdp_vs_penalty.regression.regression import Factor, Regression, TimeBlock, compress
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.preprocessing import Preprocessing


@dataclass(frozen=True)
class Gains:
    """gain (n,) : what each torque channel reads over the true torque; factor (n, r) : with the
    covariance of the gains' relative errors factor factor'."""

    gain: Array
    factor: Array

    @property
    def std(self) -> Array:
        """(n,) relative standard deviations."""
        return np.asarray(np.linalg.norm(self.factor, axis=1))

    def to_dict(self) -> dict[str, list[float]]:
        return {"gain": self.gain.tolist(), "std": (self.gain * self.std).tolist()}


def parsed_known_load(text: str) -> tuple[Path, float]:
    """FILE:MASS, the mass in kg.

    >>> parsed_known_load("load.csv:2.805")
    (PosixPath('load.csv'), 2.805)
    """
    name, _, mass = text.removeprefix("mass=").rpartition(":")
    try:
        if name:
            return Path(name), float(mass)
        raise ValueError(text)
    except ValueError:
        raise InputError(
            f"--known-load {text!r}", "write the run with the load and its mass in kg, load.csv:2.805"
        ) from None


def independent_gains(uncertainty: float | Array, joints: int) -> Array:
    """(n, n) factor of the covariance of gains known to ``uncertainty``, independent of each other; a
    factor (n, e) as it is. Raises InputError for a standard deviation that is none.
    """
    if isinstance(uncertainty, np.ndarray):
        return uncertainty
    if not 0.0 <= uncertainty < 1.0:
        raise InputError(
            f"gain_uncertainty {uncertainty:g}", "give a relative standard deviation, such as 0.01"
        )
    return uncertainty * np.eye(joints)


def gains_from_loads(
    model: Model,
    measurements: Measurements,
    loads: Sequence[tuple[Source, float]],
    settings: Preprocessing,
    prior: float,
) -> Gains:
    """The gains that make the loads weigh what they weigh.

    model : of the robot without load; loads : further runs, each with the mass [kg] of a body on the
    last link; settings : resolved; prior : standard deviation of the gains' relative errors before the
    loads are known, 0 for the usual one. Raises InputError for a mass that is none.
    """
    for _, mass in loads:
        if not 0.0 < mass < np.inf:
            raise InputError(f"a known load of {mass:g} kg", "give the mass that was on the last link")
    payload = Payload(model.robot)
    bare = replace(model.reference_free, gains=None)
    with_load = replace(bare, effects=(*bare.effects, payload))
    parts = [(compress(measurements, bare, settings), 0.0)]
    for source, mass in loads:
        what = "identify(known_loads=...)"
        runs = as_measurements(source, model.robot.n, model.robot.joint_names, what)
        parts.append((compress(runs, with_load, settings), float(mass)))
    p, n = len(bare.parameters), model.robot.n
    joined = _Joined(parts, p, n)
    log_gain, weights = np.zeros(n), np.ones(n)
    x = np.zeros(joined.size)
    scale = joined.prior(prior or GAIN_PRIOR)
    for step in range(50):
        linear = joined.linearised(x, log_gain)
        data = linear.least_squares(weights)
        strength = max(white_variance(data, linear.oversampling), 1e-18 * data.tau_squared / data.rows)
        bounded = data.with_prior(scale, strength)
        norms = np.where(bounded.column_norms > 0.0, bounded.column_norms, np.inf)
        x = np.linalg.lstsq(bounded.R / norms, bounded.rho, rcond=1e-10)[0] / norms
        moved = float(np.abs(x[-n:] - log_gain).max())
        log_gain = log_gain + np.clip(x[-n:] - log_gain, -0.5, 0.5)
        if step < 3:
            rows = np.maximum(linear.joint_rows(), 1)
            left = np.sqrt(linear.joint_losses(x) / rows)
            weights = left.max(initial=0.0) / np.maximum(left, 1e-9 * left.max(initial=1e-300))
        elif moved < 1e-9:
            break
    known = sandwich(joined.linearised(x, log_gain), weights, scale)
    rows = np.eye(joined.size)[-n:]
    std = known.half_widths(rows, 0.95) / NORMAL_95
    factor = known.factor[-n:]
    length = np.linalg.norm(factor, axis=1)
    stretch = np.where(np.isfinite(std) & (length > 0.0), std / np.where(length > 0.0, length, 1.0), 1.0)
    return Gains(np.exp(log_gain), factor * stretch[:, None])


class _Joined:
    """Compressed runs without and with loads: theta (p,), nine parameters a load, ln g (n,)."""

    def __init__(self, parts: Sequence[tuple[Regression, float]], p: int, n: int) -> None:
        self.parts, self.p, self.n = parts, p, n
        self.size = p + 9 * (len(parts) - 1) + n
        merged = [Parameter(f"x{k}", "-", "known_load", 0) for k in range(self.size)]
        self.parameters = tuple(merged)

    def prior(self, gain: float) -> Array:
        """(size,) standard deviations before the measurements; infinite for the robot's own."""
        scale = np.full(self.size, np.inf)
        for k, (_, mass) in enumerate(self.parts[1:]):
            own = self.p + 9 * k
            scale[own : own + 3] = mass * LOAD_REACH
            scale[own + 3 : own + 9] = mass * LOAD_REACH**2
        scale[-self.n :] = gain
        return scale

    def linearised(self, x: Array, log_gain: Array) -> Regression:
        """The rows about x and the gains: linear in all unknowns."""
        factors: list[Factor] = []
        blocks: list[TimeBlock] = []
        run = 0
        for k, (regression, mass) in enumerate(self.parts):
            first = len(blocks)
            blocks += [replace(b, run=b.run + run) for b in regression.blocks]
            run = 1 + max(b.run for b in blocks)
            for f in regression.factors:
                factors.append(self._linear(f, first, k, mass, x, log_gain))
        some = self.parts[0][0]
        return Regression(self.parameters, self.n, tuple(blocks), tuple(factors), some.oversampling)

    def _linear(
        self, f: Factor, first: int, part: int, mass: float, x: Array, log_gain: Array
    ) -> Factor:
        gain = np.exp(log_gain[f.joint])
        columns, torque = gain * f.triangle[:, :-1], f.triangle[:, -1]
        known = f.indices == self.p  # the load's mass comes first of its ten parameters
        torque = torque - columns[:, known].sum(axis=1) * mass
        columns, indices = columns[:, ~known], f.indices[~known]
        indices = np.where(indices > self.p, indices - 1 + 9 * (part - 1), indices)
        slope = columns @ x[indices] + gain * f.triangle[:, :-1][:, known].sum(axis=1) * mass
        rows = np.zeros((len(columns), self.size + 1))  # the same columns for each run of a joint
        rows[:, indices] = columns
        rows[:, self.size - self.n + f.joint] = slope
        rows[:, -1] = torque + slope * log_gain[f.joint]
        return Factor(f.joint, f.block + first, np.arange(self.size), rows, f.rows)
