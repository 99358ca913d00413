"""Transmissions: how motors turn with joints, and how channels logged at motors become those of joints.

Motor positions are a linear function of joint positions, q_m = A q + b. Power is the same on both sides,
so that torques go the other way, tau = A^T tau_m. A row of A with several entries is a motor that drives
through the gears of other joints: a coupled wrist, a differential, a parallelogram.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files.plain import Plain
from sdp_vs_penalty.robot.arrays import Array

#: The sides on which a channel can be logged.
SIDES = ("motor", "joint")
_TERM = re.compile(r"\s*([+-])?\s*(\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+)?\s*\*?\s*(?:q([1-9]\d{0,2}))?")


@dataclass(frozen=True)
class Transmission(Plain):
    """q_m = matrix q + offset, tau = matrix^T tau_m.

    matrix : (n, n), a row a motor, in motor units per joint unit; offset : (n,) [rad, m]; positions,
    torques : n words each, "motor" or "joint": the side on which logs have that channel.
    Raises InputError where the joints do not follow from the motors, or a word is neither.
    """

    matrix: Array
    offset: Array
    positions: tuple[str, ...]
    torques: tuple[str, ...]

    def __post_init__(self) -> None:
        n = len(self.matrix)
        if self.matrix.shape != (n, n) or self.offset.shape != (n,):
            raise InputError("transmission: motors and joints differ in number", "write one sum a motor")
        if not (np.all(np.isfinite(self.matrix)) and np.all(np.isfinite(self.offset))):
            raise InputError("transmission: a ratio or an offset is not finite", "correct it")
        for name, sides in (("positions", self.positions), ("torques", self.torques)):
            if len(sides) != n or not set(sides) <= set(SIDES):
                what = f"transmission: {name} does not fit {n} motors"
                raise InputError(what, "write motor or joint for each")
        rows = np.linalg.norm(self.matrix, axis=1)
        mixed = (self._position_rows, self._torque_rows)
        # Condition number from which the joints do not follow from the motors.
        if not np.all(rows > 0.0) or any(np.linalg.cond(m) > 1e9 for m in mixed):
            what = "transmission: the joints do not follow from the motors"
            raise InputError(what, "give independent motors")

    @property
    def n(self) -> int:
        """How many joints, and channels."""
        return len(self.matrix)

    @property
    def _position_rows(self) -> Array:
        """S of channels = S q + (offset where they are a motor's)."""
        at_motor = np.array(self.positions) == "motor"
        return np.where(at_motor[:, None], self.matrix, np.eye(self.n))

    @property
    def _torque_rows(self) -> Array:
        """T of channels = T tau_m."""
        at_motor = np.array(self.torques) == "motor"
        return np.where(at_motor[:, None], np.eye(self.n), self.matrix.T)

    def joint_positions(self, channels: ArrayLike, rates: bool = False) -> Array:
        """(N, n) joint positions from logged channels (N, n); rates : these are velocities, so that no
        offset counts."""
        at_motor = np.array(self.positions) == "motor"
        offset = np.where(at_motor & (not rates), self.offset, 0.0)
        return np.asarray(np.linalg.solve(self._position_rows, (np.asarray(channels) - offset).T).T)

    def joint_torques(self, channels: ArrayLike) -> Array:
        """(N, n) joint torques from logged channels (N, n)."""
        motors = np.linalg.solve(self._torque_rows, np.asarray(channels, float).T)
        return np.asarray((self.matrix.T @ motors).T)


def parse_transmission(
    motors: Sequence[str], positions: Sequence[str] = ("motor",), torques: Sequence[str] = ("motor",)
) -> Transmission:
    """A transmission from each motor's position as a formula of the joints': "32 q5 + 32 q6 - 0.1".

    positions, torques : the side of each channel, or one word for all of them. Raises InputError.

    >>> parse_transmission(["50q1", "q1 - 2*q2 + 0.5"]).matrix
    array([[50.,  0.],
           [ 1., -2.]])
    """
    n = len(motors)
    rows = [parse_formula(text, n) for text in motors]
    sides = [tuple(s) * n if len(s) == 1 else tuple(s) for s in (positions, torques)]
    matrix = np.array([row[:n] for row in rows]).reshape(n, n)
    return Transmission(matrix, np.array([row[n] for row in rows]), *sides)


def parse_formula(text: str, n: int) -> Array:
    """(n + 1,) ratios and the constant of a sum like "32 q5 + 32 q6 - 0.1". Raises InputError."""
    out, place = np.zeros(n + 1), 0
    while place < len(text.rstrip()):
        match = _TERM.match(text, place)
        sign, number, joint = match.groups() if match else (None, None, None)
        if match is None or (number is None and joint is None) or (place > 0 and sign is None):
            raise InputError(f"{text[:60]!r} is no sum of joints", "write one like 32 q5 + 32 q6 - 0.1")
        if joint is not None and int(joint) > n:
            what = f"{text[:60]!r} names joint {joint}, there are {n}"
            raise InputError(what, f"choose from q1 to q{n}")
        value = float(number or 1.0) * (-1.0 if sign == "-" else 1.0)
        out[n if joint is None else int(joint) - 1] += value
        place = match.end()
    return out
