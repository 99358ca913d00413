"""Joints elsewhere than the kinematics say."""

import operator
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
    _length_like_a_radian,
    _with_zero,
    odds_against_one_of,
)
from sdp_vs_penalty.checks.likelihood import At, Likelihood
from sdp_vs_penalty.checks.repair import LogTransform


class Place(Transformation):
    """Joints that are elsewhere than the robot's kinematics say. Encoders that count
    from another zero: what is to be added to one joint's position [rad], of prismatic
    joints in lengths of the arm; and joints farther apart or nearer, along the line
    between them [m]."""

    name = "zero"

    def propose(
        self, log: Likelihood, now: LogTransform, fit: ArmFit
    ) -> Iterator[LogTransform]:
        """Yield the repair ``now`` with each joint at another place: its distance from
        the joint before, or its encoder's zero, changed by a first-order step or by
        quarter turns.

        Parameters
        ----------
        log : Likelihood
            Rows that repairs are judged on.
        fit : ArmFit
            The arm fitted to the rows under ``now``.

        Returns
        -------
        iterator of LogTransform
            Repairs to fit arms to, with all corrections of ``now``.
        """
        try_turns = bool(fit.is_poorly_explained.any())
        candidates = [*_distances(log, now), *_zeros(log, now, try_turns)]
        if not candidates:
            return
        values = np.array([candidate.value for candidate in candidates])
        units = np.array([candidate.unit for candidate in candidates])
        # The change of each length or zero that lowers the residual most, to first order.
        steps, spreads = log.on_third_of_rows.first_order_steps(
            now,
            [candidate.repair_with for candidate in candidates],
            values,
            _DIFFERENCE * units,
        )
        largest = _FIRST_ORDER * units
        changes = np.clip(steps, -largest, largest).tolist()
        # Without a finite standard deviation the motion does not show the number.
        for k in np.flatnonzero(np.isfinite(spreads)).tolist():
            candidate = candidates[k]
            for change in (changes[k], *candidate.turns):
                yield candidate.repair_with(candidate.value + change)

    def list_faults(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        """Yield a fault for each link length and each encoder's zero that a repair
        changes.

        Parameters
        ----------
        log : Likelihood
            Rows that repairs are judged on.
        repair : LogTransform
            A complete repair, with faults of any kinds.

        Returns
        -------
        iterator of Fault
            With the words for the user.
        """
        for j in np.flatnonzero(repair.longer).tolist():
            yield _link_length(log, repair, j)
        for j in np.flatnonzero(repair.zero).tolist():
            yield _encoder_offset(log, repair, j)


#: Step of the difference quotient, and the largest change for which a first-order step
#: is trusted, in units of a number (a radian, or a length that matters as much) [-].
_DIFFERENCE = 0.01
_FIRST_ORDER = 0.7
#: Search radius of an angle [rad], and of a length in lengths of _length_like_a_radian.
_SEARCH_RADIUS = 0.35
#: Lengths are known better than angles by this factor [-].
_LENGTH_OVER_ANGLE = 0.25
#: Zeros of joints that are set a quarter of a turn off, or more [rad].
QUARTERS = -np.pi / 2, np.pi / 2, np.pi


@dataclass(frozen=True)
class _Candidate:
    """A length or a zero that may be another one."""

    #: Present value [m, rad].
    value: float
    #: Function of another value that returns the repair with it.
    repair_with: At
    #: A radian, or a length that matters to torques as much [m].
    unit: float
    #: Changes that are tried beside the first-order one [rad].
    turns: tuple[float, ...] = ()


def _distances(log: Likelihood, now: LogTransform) -> Iterator[_Candidate]:
    """Yield the distance of each joint from the one before, where they are apart."""
    for j, joint in enumerate(log.problem.robot.joints):
        if j and joint.placement[:3, 3].any():
            yield _Candidate(
                value=now.longer[j],
                repair_with=partial(now.with_entries, "longer", (j,)),
                unit=_length_like_a_radian(log),
            )


def _zeros(log: Likelihood, now: LogTransform, try_turns: bool) -> Iterator[_Candidate]:
    """Yield the encoder's zero of each joint that moves, as a number to be changed.

    A revolute first joint is left out: its zero is the mounting about its axis.
    try_turns : whether revolute zeros are also tried a quarter or half of a turn off.
    """
    for j in log.joints:
        is_revolute = j in log.revolute
        if j == 0 and is_revolute:
            continue
        yield _Candidate(
            value=now.zero[j],
            repair_with=partial(_with_zero, log, now, j),
            unit=1.0 if is_revolute else _length_like_a_radian(log),
            turns=QUARTERS if is_revolute and try_turns else (),
        )


def _link_length(log: Likelihood, repair: LogTransform, j: int) -> Fault:
    """Return the fault that joint j is farther from the joint before, or nearer to it,
    than the kinematics say."""
    length = _length_like_a_radian(log)
    longer = repair.longer[j]  # [m]
    where = "farther from" if longer > 0.0 else "nearer to"
    size = FaultSize(
        value=longer,
        repair_with=partial(repair.with_entries, "longer", (j,)),
        tolerance=_LENGTH_OVER_ANGLE * c.CALIBRATED * length,
        search_radius=_SEARCH_RADIUS * length,
        in_words=_metres,
    )
    return Fault(
        kind="link length",
        severity="warning",
        joints=(j,),
        what=f"joint {j + 1} is {_metres(abs(longer))} {where} joint {j} than in the robot's"
        " kinematics.",
        remedy="correct the kinematics, or choose the problem of the robot that was"
        " logged",
        removal=size,
        log_odds_against=odds_against_one_of(log.n),
        is_repairable=False,
    )


def _encoder_offset(log: Likelihood, repair: LogTransform, j: int) -> Fault:
    """Return the fault that joint j's encoder counts from another zero than the
    kinematics.

    The repair adds an offset to the position; the zero is away by minus that offset.
    """
    offset = repair.zero[j]  # [rad, m]
    is_revolute = j in log.revolute
    length = _length_like_a_radian(log)
    size = FaultSize(
        value=offset,
        repair_with=partial(_with_zero, log, repair, j),
        tolerance=(1.0 if is_revolute else _LENGTH_OVER_ANGLE * length) * c.CALIBRATED,
        search_radius=_SEARCH_RADIUS if is_revolute else _SEARCH_RADIUS * length,
        in_words=_minus_degrees if is_revolute else _minus_metres,
        number_told=operator.neg,
        round_values=(*QUARTERS, -np.pi) if is_revolute else (),
    )
    unit = log.problem.robot.position_units[j]
    return Fault(
        kind="encoder offset",
        severity="warning",
        joints=(j,),
        what=f"the zero of joint {j + 1} is {size.in_words(offset)} away from the robot's"
        " kinematics.",
        remedy=f"add {offset:+.5g} {unit} to q{j + 1}",
        removal=size,
        log_odds_against=odds_against_one_of(log.n),
        figures={"shifts": [offset]},
    )


def _metres(length: float) -> str:
    """Return a length [m] in words: "0.25 m"."""
    return f"{length:.4g} m"


def _minus_degrees(offset: float) -> str:
    """Return in words how far an encoder's zero is off, minus the ``offset`` [rad] that
    the repair adds."""
    return _degrees(-offset)


def _minus_metres(offset: float) -> str:
    """Return in words how far an encoder's zero is off, minus the ``offset`` [m] that
    the repair adds."""
    return _metres(-offset)
