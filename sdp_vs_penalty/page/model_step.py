"""One model of a session's history, judged."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.diagnosis.where_it_fails import JointFailure, dependences

#: The signal that shows what a cause of where_it_fails.py explains.
SHOWN_BY = {
    "position": "q",
    "velocity": "dq",
    "acceleration": "ddq",
    "load": "torque",
    "time": "t",
    "high speed": "dq",
    "reversal": "dq",
    "standstill": "dq",
    "waves per turn": "q",
    "modelled torque": "modelled",
    "torque rate": "torque_rate",
    "torque curvature": "torque_curvature",
}


@dataclass(frozen=True)
class ModelStep:
    """One model of a session's history, judged: what ``summary`` of jobs.py says.

    file : its model.json, beside it the .npz of each run's torques; runs : names of
    those, training runs first, a part of a run by its seconds; judged_on : the runs
    behind comparison and failures (as `compare --json` writes them); judged, about :
    what ``judged_row`` and :func:`about` say; label, added : what it is called and the
    effects added to the step below, with the others held where frozen; opened : the
    file that a person brought, if any; servo : whether it knows the servos of a log
    without torque; findings : what it lacks, if it was diagnosed, and what `add` calls
    its curves; pictures : the file of what the cards of its diagnosis draw.
    """

    file: str
    runs: list[str]
    judged_on: list[str]
    method: str
    effects: list[str]
    comparison: dict[str, Any]
    failures: list[dict[str, Any]]
    judged: list[str]
    about: dict[str, Any]
    on_bounds: list[str]
    seconds: float
    label: str = ""
    added: tuple[str, ...] = ()
    frozen: bool = False
    opened: str = ""
    servo: bool = False
    findings: Diagnosis | None = None
    curve_texts: Sequence[str] = ()
    pictures: str = ""

    def signal_of(self, j: int, default: str) -> str:
        """Return the signal that best shows what a joint's error depends on.

        That is the one of the cause that explains most of the error on held-out data.

        Parameters
        ----------
        j : int
            Index of the joint, from 0.
        default : str
            Signal to return if the model's failures are unknown or have no such cause.
        """
        if not self.failures:
            return default
        strongest = dependences(JointFailure.from_dict(self.failures[j]), 1)
        cause = strongest[0][0] if strongest else ""
        return SHOWN_BY.get(cause, default)

    @staticmethod
    def joint_number(j: int) -> int:
        """Return the number that people see of the joint with index j: it counts
        from 1.
        """
        return j + 1
