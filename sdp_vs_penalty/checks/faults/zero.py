"""Joints elsewhere than the kinematics say."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial

import numpy as np

from sdp_vs_penalty.checks import constants as c
from sdp_vs_penalty.checks.arm_fit import ArmFit
from sdp_vs_penalty.checks.faults.fault import (
    Fault,
    FaultSize,
    Transformation,
    _degrees,
    _length,
    _shifted,
    choices,
)
from sdp_vs_penalty.checks.likelihood import At, Likelihood
from sdp_vs_penalty.checks.repair import LogTransform


class Place(Transformation):
    """Joints that are elsewhere than the robot's kinematics say. Encoders that count
    from another zero: what is to be added to one joint's position [rad], of prismatic
    joints in lengths of the arm; and joints farther apart or nearer, along the line
    between them [m]."""

    name = "zero"

    def proposals(
        self,
        log: Likelihood,
        now: LogTransform,
        score: ArmFit,
    ) -> Iterator[LogTransform]:
        """Propose repairs that correct one more fault of this kind than ``now`` does."""
        places = [
            *_distances(log, now),
            *_zeros(log, now, bool(score.poor.any())),
        ]
        if not places:
            return
        values = np.array([place.value for place in places])
        units = np.array([place.unit for place in places])
        ats = [place.at for place in places]
        steps, spreads = log.screen.first_order_steps(
            now,
            ats,
            values,
            0.01 * units,
        )
        nearest = np.clip(steps, -0.7 * units, 0.7 * units).tolist()
        # Of those without a finite spread nothing is seen.
        for k in np.flatnonzero(np.isfinite(spreads)).tolist():
            for change in (nearest[k], *places[k].turns):
                yield places[k].at(places[k].value + change)

    def elements(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        """Yield the faults of this kind that a repair corrects."""
        for j in np.flatnonzero(repair.longer).tolist():
            yield _link_length(log, repair, j)
        for j in np.flatnonzero(repair.zero).tolist():
            yield _encoder_offset(log, repair, j)


#: Zeros of joints that are set a quarter of a turn off, or more [rad].
QUARTERS = -np.pi / 2, np.pi / 2, np.pi


@dataclass(frozen=True)
class _Number:
    """A number whose best value is looked for: its present value, the repair with
    another one, what is large for it, and turns that are tried."""

    value: float
    at: At
    unit: float
    turns: tuple[float, ...] = ()


def _distances(log: Likelihood, now: LogTransform) -> Iterator[_Number]:
    """Of each joint from the one before, where they are apart."""
    for j, joint in enumerate(log.problem.robot.joints):
        if j and joint.placement[:3, 3].any():
            at = partial(now.with_entries, "longer", (j,))
            yield _Number(now.longer[j], at, _length(log))


def _zeros(
    log: Likelihood,
    now: LogTransform,
    is_poor: bool,
) -> Iterator[_Number]:
    """Of each joint that moves; the zero of a first joint that turns is the mounting
    about its axis."""
    for j in log.joints:
        turns = j in log.revolute
        if j == 0 and turns:
            continue
        at = partial(_shifted, log, now, j)
        unit = 1.0 if turns else _length(log)
        yield _Number(
            now.zero[j],
            at,
            unit,
            QUARTERS if turns and is_poor else (),
        )


def _link_length(log: Likelihood, repair: LogTransform, j: int) -> Fault:
    """Joint j farther from the one before, or nearer to it."""
    length = _length(log)
    metres = "{:.4g} m".format
    x = repair.longer[j]
    where = "farther from" if x > 0.0 else "nearer to"
    number = FaultSize(
        value=x,
        at=partial(repair.with_entries, "longer", (j,)),
        tolerance=0.25 * c.CALIBRATED * length,
        search_radius=0.35 * length,
        text=metres,
    )
    return Fault(
        kind="link length",
        severity="warning",
        joints=(j,),
        what=f"joint {j + 1} is {metres(abs(x))} {where} joint {j} than in the robot's"
        " kinematics.",
        remedy="correct the kinematics, or choose the problem of the robot that was"
        " logged",
        of=number,
        cost=choices(log.n),
        mends=False,
    )


def _encoder_offset(log: Likelihood, repair: LogTransform, j: int) -> Fault:
    """Joint j counts from another zero."""
    x = repair.zero[j]
    turns = j in log.revolute
    length = _length(log)
    number = FaultSize(
        value=x,
        at=partial(_shifted, log, repair, j),
        tolerance=(1.0 if turns else 0.25 * length) * c.CALIBRATED,
        search_radius=0.35 if turns else 0.35 * length,
        text=_angle_away if turns else _length_away,
        round_values=(*QUARTERS, -np.pi) if turns else (),
    )
    unit = log.problem.robot.position_units[j]
    return Fault(
        kind="encoder offset",
        severity="warning",
        joints=(j,),
        what=f"the zero of joint {j + 1} is {number.text(x)} away from the robot's"
        " kinematics.",
        remedy=f"add {x:+.5g} {unit} to q{j + 1}",
        of=number,
        cost=choices(log.n),
        figures={"shifts": [x]},
    )


def _angle_away(x: float) -> str:
    return _degrees(-x)


def _length_away(x: float) -> str:
    return f"{-x:.4g} m"
