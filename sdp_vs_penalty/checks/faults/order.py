"""Channels of other joints."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

from sdp_vs_penalty.checks.arm_fit import ArmFit
from sdp_vs_penalty.checks.faults.fault import (
    Fault,
    Transformation,
    odds_against_one_of,
)
from sdp_vs_penalty.checks.issue import joints_text
from sdp_vs_penalty.checks.likelihood import Likelihood
from sdp_vs_penalty.checks.repair import LogTransform


class Exchange(Transformation):
    """Channels of other joints: positions, torques, or both exchanged."""

    name = "order"

    def propose(
        self, log: Likelihood, now: LogTransform, fit: ArmFit
    ) -> Iterator[LogTransform]:
        """Yield the repair ``now`` with the channels of two moving joints exchanged,
        for each pair: of their torques and, if one is poorly explained, of positions
        and of both.

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
        for a, b in combinations(log.joints, 2):
            yield now.with_swap(a, b, "tau_order")
            if fit.is_poorly_explained[a] or fit.is_poorly_explained[b]:
                yield now.with_swap(a, b, "order")
                yield now.with_swap(a, b, "order", "tau_order")

    def list_faults(self, log: Likelihood, repair: LogTransform) -> Iterator[Fault]:
        """Yield a fault for the joints whose channels a repair exchanges: one about
        both channels where positions and torques have the same order, else one about
        each.

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
        if repair.order == repair.tau_order:
            yield from _swapped(log, repair, BOTH)
            return
        yield from _swapped(log, repair, POSITIONS)
        yield from _swapped(log, repair, TORQUES)


@dataclass(frozen=True)
class _Channels:
    """Channels that may be exchanged between joints."""

    #: Kind of the issue.
    kind: str
    #: Name of the channels, in words.
    words: str
    #: Names of the channels' columns in a file.
    columns: str
    #: Fields of a repair that hold the channels' order.
    entries: tuple[str, ...]


POSITIONS = _Channels("position order", "the positions", "q and dq", ("order",))
TORQUES = _Channels("torque order", "the torques", "tau", ("tau_order",))
BOTH = _Channels(
    "joint order", "positions and torques", "q, dq and tau", ("order", "tau_order")
)


def _swapped(
    log: Likelihood, repair: LogTransform, channels: _Channels
) -> Iterator[Fault]:
    """Yield the fault that joints have each other's channels; nothing where each has
    its own.

    An exchange of m joints is m - 1 swaps of two, and each swap costs the prior odds
    against one of all pairs.
    """
    order = getattr(repair, channels.entries[0])
    changed = tuple(j for j, k in enumerate(order) if j != k)
    if not changed:
        return
    which = ""
    if len(changed) > 2:
        places = [f"column {order[j] + 1} is joint {j + 1}'s" for j in changed]
        which = f": {', '.join(places)}"
    n_pairs = log.n * (log.n - 1) // 2
    n_swaps = len(changed) - 1
    yield Fault(
        kind=channels.kind,
        severity="warning",
        joints=changed,
        what=f"{channels.words} of {joints_text(changed)} are swapped{which}.",
        remedy=f"rename the columns of {channels.columns}",
        removal=repair.with_defaults(*channels.entries),
        log_odds_against=n_swaps * odds_against_one_of(n_pairs),
    )
