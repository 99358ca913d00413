"""Joints elsewhere than the kinematics say."""

from collections.abc import Iterator
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

    quarters = -np.pi / 2, np.pi / 2, np.pi

    def proposals(
        self, log: Likelihood, now: LogTransform, score: ArmFit
    ) -> Iterator[LogTransform]:
        joints = log.problem.robot.joints
        quarters = self.quarters if score.poor.any() else ()
        apart = [
            j for j, joint in enumerate(joints) if j and joint.placement[:3, 3].any()
        ]
        # The zero of a first joint that turns is the mounting about its axis.
        zeros = [j for j in log.joints if j or j not in log.revolute]
        turns = [*(False for _ in apart), *(j in log.revolute for j in zeros)]
        ats: list[At] = [partial(now.with_entries, "longer", (j,)) for j in apart]
        ats += [partial(_shifted, log, now, j) for j in zeros]
        values = [*(now.longer[j] for j in apart), *(now.zero[j] for j in zeros)]
        units = np.where(turns, 1.0, _length(log))
        steps, spreads = log.screen.first_order_steps(
            now, ats, np.array(values), 0.01 * units
        )
        first = np.clip(steps, -0.7 * units, 0.7 * units).tolist()
        for k in np.flatnonzero(
            np.isfinite(spreads)
        ).tolist():  # of the others nothing is seen
            for x in (first[k], *(quarters if turns[k] else ())):
                yield ats[k](values[k] + x)

    def elements(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        length = _length(log)
        metres = "{:.4g} m".format
        cost = choices(log.n)
        for j in np.flatnonzero(repair.longer).tolist():
            x = repair.longer[j]
            at = partial(repair.with_entries, "longer", (j,))
            how = (
                f"{metres(abs(x))} {'farther from' if x > 0.0 else 'nearer to'}"
                f" joint {j}"
            )
            what = f"joint {j + 1} is {how} than in the robot's kinematics."
            remedy = (
                "correct the kinematics, or choose the problem of the robot that was"
                " logged"
            )
            number = FaultSize(
                x, at, 0.25 * c.CALIBRATED * length, 0.35 * length, metres
            )
            yield Fault(
                "link length", "warning", (j,), what, remedy, number, cost, mends=False
            )
        for j in np.flatnonzero(repair.zero).tolist():
            x = repair.zero[j]
            turns = j in log.revolute
            back = partial(_shifted, log, repair, j)
            unit, text = (1.0, _degrees) if turns else (0.25 * length, metres)
            reach, snaps = (
                (0.35, (*self.quarters, -np.pi)) if turns else (0.35 * length, ())
            )
            away = lambda v, text=text: text(-v)  # noqa: E731
            number = FaultSize(x, back, unit * c.CALIBRATED, reach, away, snaps)
            severity = "warning"
            what = (
                f"the zero of joint {j + 1} is {away(x)} away from the robot's"
                " kinematics."
            )
            remedy = f"add {x:+.5g} {log.problem.robot.position_units[j]} to q{j + 1}"
            shift = {"shifts": [x]}
            yield Fault(
                "encoder offset",
                severity,
                (j,),
                what,
                remedy,
                number,
                cost,
                figures=shift,
            )
