"""A run whose columns are read and whose units are being decided: what the steps of
reading hand on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from sdp_vs_penalty.data.columns import OUR_CLOCK, Choice
from sdp_vs_penalty.data.hypotheses.channels import Recognition
from sdp_vs_penalty.data.log import ROWS_JUDGED, Log
from sdp_vs_penalty.robot.arrays import Array, Arrays, Indices
from sdp_vs_penalty.robot.robot import Robot

#: Name of the group that holds a set of columns which competes as the torques.
RIVAL = "torques: {}"
#: Usual steps of a clock under our name [s].
_USUAL_STEPS = (2e-5, 0.1)
#: A joint that moves by less does not move [rad, m].
_AT_REST = 1e-3


@dataclass(frozen=True)
class Draft:
    """A run whose units are being decided."""

    #: The file's columns.
    log: Log
    #: What of the file to take.
    choice: Choice
    #: Which column is which channel, in which unit and why, as far as it is decided.
    recognition: Recognition
    #: Names of the file's columns by channel group, in the joints' order.
    groups: Mapping[str, Sequence[str]]
    #: (N,) columns or (N, n) and (n, N) blocks by the file's names.
    columns: Arrays
    #: (N,) stamps of the file's clock, in its unit; None without one, and where a rate is
    #: chosen in its place.
    stamps: Array | None
    #: (N,) number in the file of each row; None where row k is number k + 2.
    rows: Indices | None
    #: (N,) stamps, in the clock's unit until all is in SI [s].
    t: Array = field(default_factory=lambda: np.zeros(0))
    #: (N, n) channels by group, in the file's units until all is in SI.
    blocks: dict[str, Array] = field(default_factory=dict)
    #: Whether commanded positions follow the measured ones as they are written.
    is_command_in_unit_of_q: bool = False
    #: (N,) number of each row's episode; None where the clock goes on.
    episode: Indices | None = None

    @property
    def robot(self) -> Robot | None:
        """The robot whose arm may decide: none where names mean what they say, or where it
        has another number of joints."""
        robot = getattr(self.choice.joints, "robot", None)
        is_of_robot = robot is not None and robot.n == self.blocks["q"].shape[1]
        return robot if is_of_robot and not self.choice.as_written else None

    @property
    def rival_torques(self) -> dict[str, Array]:
        """(N, n) blocks of the sets of columns that compete as the torques, by their name."""
        names = {x: RIVAL.format(x) for x in self.recognition.torques}
        return {x: self.blocks[y] for x, y in names.items() if y in self.blocks}

    @property
    def seconds(self) -> Array:
        """(N,) stamps [s] in the unit of the clock that is decided so far."""
        scale = self.recognition.scale
        return self.t * (scale.get("t", 1.0) if self.choice.rate is None else 1.0)

    def with_unit_of_clock(self) -> Draft:
        """Decide the unit of a clock that nothing says, by its steps, the velocities and how
        fast joints move."""
        recognition, t = self.recognition, self.t
        is_open = self.choice.rate is None and "t" in recognition.inferred
        if not is_open or len(t) < 2:
            return self
        kind = recognition.inferred["t"]
        if kind == OUR_CLOCK:
            step = np.median(np.diff(t[:ROWS_JUDGED]))
            if not step > 0.0 or _USUAL_STEPS[0] <= step <= _USUAL_STEPS[1]:
                return self
        from sdp_vs_penalty.data.hypotheses import weighing as w

        if kind == OUR_CLOCK and (dated := w.unit_of_dates(t)):
            return replace(self, recognition=recognition.with_unit("t", dated))

        part = slice(ROWS_JUDGED)
        motion = [
            block[part] * recognition.factors(x, block.shape[1])
            for x in ("q", "dq")
            if (block := self.blocks.get(x)) is not None
        ]
        of_velocities = w.rate_from_velocities(*motion) if len(motion) == 2 else None
        with np.errstate(all="ignore"):  # steps of numbers that are none
            ways = np.nan_to_num(np.abs(np.diff(motion[0], axis=0)))
        # The logger of CLOCK writes seconds or milliseconds; an arm at rest has no speed.
        is_at_rest = np.ptp(motion[0], axis=0).max(initial=0.0) < _AT_REST
        way = 0.0 if kind == w.CLOCK or is_at_rest else float(np.max(ways.mean(axis=0)))
        unit = w.unit_of_clock(t[part], of_velocities, way, kind=kind)
        if kind != w.CLOCK and unit.answer == "s" and "t" not in recognition.units:
            return self
        return replace(self, recognition=recognition.with_unit("t", unit))
