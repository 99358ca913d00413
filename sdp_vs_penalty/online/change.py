"""When a payload was picked up or put down: a Bayesian search of the last seconds.

The stretch since the last change is kept as its matrix G and its seconds T
(:mod:`~sdp_vs_penalty.online.information`), and so are its first parts up to instants
``CHANGE_STEP`` apart. What came after an instant is their difference. With the evidence
K of a payload a change at that instant is judged by

    bare before:       ln K(after),
    a payload before:  max(0, ln K(after)) - (ln K(all) - ln K(before)),

the likelihood of the data after it with another payload, or none, over that with the
same payload as before (Adams, MacKay, Bayesian Online Changepoint Detection, 2007).
One call judges one instant. A change is suspected where this exceeds
``CHANGE_EVIDENCE``, and believed if it still does ``CHANGE_WAIT`` later. Its instant
t0 is where the parameters x0 of before and x1 of after explain most, the maximum of

    integral from t0 of (|e - Y x0|^2 - |e - Y x1|^2) / (2 sigma^2 tau) dt.
"""

from dataclasses import dataclass

import numpy as np

from sdp_vs_penalty.online import constants as c
from sdp_vs_penalty.online.information import (
    SIZE,
    WIDTH,
    PayloadPrior,
    Posterior,
    weight_of,
)
from sdp_vs_penalty.robot.arrays import Array


@dataclass(frozen=True)
class DetectedChange:
    """A change of the payload that is believed."""

    #: Likeliest instant of the change [s].
    time: float
    #: Lower end of the instant's 95 % interval [s].
    lower: float
    #: Upper end of the instant's 95 % interval [s].
    upper: float
    #: Natural logarithm of its odds against no change.
    evidence: float
    #: Whether a payload is carried after it.
    is_carrying: bool


class ChangeDetector:
    """Search for the instant of a change, in preallocated arrays."""

    def __init__(
        self,
        prior: PayloadPrior,
        n_drifts: int,
        correlation: float,
        period: float,
        delay: float,
    ) -> None:
        """Allocate a ring buffer of snapshots of the data, CHANGE_STEP seconds apart.

        A snapshot holds the information (11 + d, 11 + d) gathered since the last
        change, at an instant at which the payload may have changed. The ring reaches
        CHANGE_REACH seconds back.

        ``prior`` is that of a payload, and d = ``n_drifts`` offsets and shares of
        friction may drift. The residual torque has the correlation time ``correlation``
        [s], the control loop the period ``period`` [s], and the filters the delay
        ``delay`` [s]. The weight of data falls to exp(-1) after FORGETTING [s].
        """
        self.is_carrying = False
        width = WIDTH + n_drifts
        # The stretch since the last change: G, fading, and T [s].
        self._total = np.zeros((width, width))
        self._total_seconds = 0.0
        self._correlation = correlation  # time of a residual [s]
        # A ring of snapshots of the total: instants at which a change may have
        # happened.
        self._stride = max(1, round(c.CHANGE_STEP / period))  # calls a snapshot
        step = self._stride * period  # s between two snapshots
        self._fade = float(np.exp(-c.CHANGE_STEPS_PER_FADE * step / c.FORGETTING))
        self._steps_to_fade = c.CHANGE_STEPS_PER_FADE
        self._half_step = 0.5 * step
        self._n_slots = max(4, round(c.CHANGE_REACH / step))
        self._matrices = np.zeros((self._n_slots, width, width))
        self._seconds = np.zeros(self._n_slots)
        self._times = np.zeros(self._n_slots)
        self._count = 0  # slots that hold a snapshot
        self._next_slot = 0
        self._calls_to_snapshot = 0
        # Snapshots within the filters' delay of a change mix before and after.
        self._n_mixed = int(np.ceil(delay / step + 0.5))
        # Judging: some snapshots a call, so that each is judged about every 0.1 s.
        self._judged_per_call = max(
            1, round(self._n_slots * period / c.CHANGE_JUDGED_EVERY)
        )
        self._next_judged = 0  # counted back from the newest snapshot
        # A suspicion is judged again after a wait.
        self._suspected_slot: int | None = None
        self._suspected_time = 0.0
        self._wait = max(1, round(c.CHANGE_WAIT / period))  # calls
        self._waited = 0
        # Work space, so that a call allocates nothing.
        self._outer = np.zeros((WIDTH, WIDTH))
        self._scratch = np.zeros((width, width))
        self._posterior = Posterior(prior, n_drifts)

    def add(self, rows: Array, weighted: Array, period: float, time: float) -> None:
        """Add the rows A (n, 11 + d) of one call of the loop to the stretch: A' S^-1 A
        dt, and its period dt.

        Every ``_stride`` calls a snapshot of what was gathered before is kept.

        Parameters
        ----------
        rows : (n, 11 + d) array
            A = [Y, e, N]: payload columns, residual and columns of drift of each joint.
        weighted : (n, 11 + d) array
            S^-1 A, the rows over the variance of each joint's noise.
        period : float
            Period dt of the loop [s].
        time : float
            Instant of the rows [s], which names the snapshot.
        """
        if self._calls_to_snapshot == 0:
            self._keep(time)
            self._calls_to_snapshot = self._stride
        self._calls_to_snapshot -= 1
        added = self._scratch  # overwritten: a call allocates nothing
        np.dot(rows.T, weighted, out=added)
        added *= period
        self._total += added
        self._total_seconds += period

    def _keep(self, time: float) -> None:
        """Store a snapshot of the data up to ``time`` [s], a candidate for a change's
        instant.

        Every CHANGE_STEPS_PER_FADE snapshots all data fade first by one factor, so that
        old data count less. The snapshot overwrites the oldest one of the ring buffer
        once it is full.
        """
        self._steps_to_fade -= 1
        if self._steps_to_fade == 0:
            self._steps_to_fade = c.CHANGE_STEPS_PER_FADE
            self._total *= self._fade
            self._total_seconds *= self._fade
            self._matrices *= self._fade
            self._seconds *= self._fade
        place = self._next_slot
        np.copyto(self._matrices[place], self._total)
        self._seconds[place] = self._total_seconds
        self._times[place] = time
        self._next_slot = (place + 1) % self._n_slots
        self._count = min(self._count + 1, self._n_slots)

    def search(self, *, may_judge: bool = True) -> DetectedChange | None:
        """Judge the next few snapshots for a change of payload; return a confirmed one.

        Nothing is judged in a call without ``may_judge``; a suspect waits on.

        Snapshots are instants at which the payload may have changed. If the evidence
        (ln of odds) at one exceeds CHANGE_EVIDENCE, it becomes the suspect. The suspect
        is judged again after a wait of CHANGE_WAIT seconds, since a bump is over by
        then, and confirmed if its evidence still exceeds CHANGE_EVIDENCE. Meanwhile,
        and without a confirmed change, the result is None. Snapshots are judged from
        the newest to the oldest, a few a call, to bound the time of a call.
        """
        # First: a suspect waits, and is then judged a second time.
        if self._suspected_slot is not None:
            self._waited += 1
            if self._waited < self._wait or not may_judge:
                return None
            place = self._suspected_slot
            self._suspected_slot = None
            if self._times[place] != self._suspected_time:
                # The ring buffer has overwritten it: take the oldest snapshot instead.
                place = self._next_slot
            evidence = self._judge(place)
            return self._locate(place) if evidence > c.CHANGE_EVIDENCE else None
        # Else: look for a suspect.
        if not may_judge:
            return None
        for _ in range(self._judged_per_call):
            if self._count == 0:
                return None
            # Slots wrap round; ``_next_judged`` counts back from the newest snapshot.
            place = (self._next_slot - 1 - self._next_judged) % self._n_slots
            self._next_judged = (self._next_judged + 1) % self._count
            if self._judge(place) > c.CHANGE_EVIDENCE:
                self._suspected_slot = place
                self._suspected_time = float(self._times[place])
                self._waited = 0
                return None
        return None

    def _judge(self, place: int) -> float:
        """Return the evidence (ln of odds) of a change at the snapshot in slot
        ``place``.

        With K the evidence for a payload (Bayes factor) and "after" the data that came
        after the snapshot, it is

            without payload before:  ln K(after),
            with payload before:     max(0, ln K(after)) - (ln K(all) - ln K(before)).

        -inf if less than CHANGE_SHORTEST seconds came after it.
        """
        if self._total_seconds - self._seconds[place] < c.CHANGE_SHORTEST:
            return -np.inf
        if not self.is_carrying:
            return self._after(place)
        posterior = self._posterior
        evidence_before = self._before(place)
        # The data before are in the posterior; with those after, it has all.
        self._add_after(place, posterior)
        evidence_of_all = posterior.solve()
        # The data after alone, which were the last to be added.
        posterior.clear()
        posterior.add_again()
        # 0 is the evidence of no payload after the change.
        evidence_after = max(posterior.solve(), 0.0)
        return evidence_after - (evidence_of_all - evidence_before)

    def _locate(self, place: int) -> DetectedChange | None:
        """Find the most likely instant of a change near the snapshot in slot ``place``.

        With payloads x0 before and x1 after, the log likelihood of a change at t0 is,
        up to a constant,

            integral up to t0 of (|Y x1 - e|^2 - |Y x0 - e|^2) / (2 sigma^2 tau) dt.

        x0 and x1 depend on t0 in turn, so two rounds are made. Returns None if no
        payload is carried before and after, or if the evidence is below
        CHANGE_EVIDENCE.
        """
        newest_first = (self._next_slot - 1 - np.arange(self._count)) % self._n_slots
        slots = newest_first[::-1]  # the oldest snapshot first
        # (x, -1) with the payload's parameters x: Y x - e is [Y, e] times it.
        vector_before = np.zeros(WIDTH)
        vector_before[SIZE] = -1.0
        vector_after = vector_before.copy()
        for _ in range(2):
            is_carrying = self._after(place) > 0.0
            vector_after[:SIZE] = self._posterior.mean if is_carrying else 0.0
            if self.is_carrying:
                self._before(place)
                vector_before[:SIZE] = self._posterior.mean
            np.outer(vector_after, vector_after, out=self._outer)
            self._outer -= np.outer(vector_before, vector_before)
            # ln likelihood of a change at each snapshot, up to a constant: what came
            # before it is explained by the old payload.
            score = np.tensordot(self._matrices[slots, :WIDTH, :WIDTH], self._outer, 2)
            score *= 0.5 / self._correlation
            place = int(slots[np.argmax(score)])
        if not (is_carrying or self.is_carrying):
            return None
        evidence = self._judge(place)
        if evidence <= c.CHANGE_EVIDENCE:
            return None
        # 95 % of the probability over the instants.
        probability = np.exp(score - score.max())
        cumulative = np.cumsum(probability) / probability.sum()
        times = self._times[slots]
        lower = times[np.searchsorted(cumulative, 0.025)] - self._half_step
        upper = times[np.searchsorted(cumulative, 0.975)] + self._half_step
        return DetectedChange(
            time=float(self._times[place]),
            lower=float(lower),
            upper=float(upper),
            evidence=evidence,
            is_carrying=is_carrying,
        )

    def _before(self, place: int) -> float:
        """Solve for the payload from the data before the snapshot in slot ``place``;
        return ln of its evidence.

        ``_posterior.mean`` (10,) holds the payload.
        """
        self._posterior.clear()
        self._add(self._matrices[place], self._seconds[place], self._posterior)
        return self._posterior.solve()

    def _after(self, place: int) -> float:
        """Solve for the payload after the snapshot in slot ``place``; return ln of its
        evidence.

        ``_posterior.mean`` (10,) holds the payload.
        """
        self._posterior.clear()
        self._add_after(place, self._posterior)
        return self._posterior.solve()

    def _add_after(self, place: int, out: Posterior) -> None:
        """Add the data after the snapshot in slot ``place`` to ``out``, unsolved: all
        data less those up to the snapshot."""
        np.subtract(self._total, self._matrices[place], out=self._scratch)
        self._add(self._scratch, self._total_seconds - self._seconds[place], out)

    def _add(self, matrix: Array, seconds: float, out: Posterior) -> None:
        """Add the data of a stretch of so many seconds to ``out``, unsolved."""
        out.add(matrix, weight_of(seconds, self._correlation))

    def posterior_after(self, change: DetectedChange, out: Posterior) -> None:
        """Solve for the payload after a change.

        Parameters
        ----------
        change : DetectedChange
            A change that :meth:`search` has returned.
        """
        out.clear()
        self._add_after(self._place(change), out)
        out.solve()

    def _place(self, change: DetectedChange) -> int:
        """Return the ring buffer's slot at which the data after a change begin.

        Filters mix the time before and after a change within their delay. So the slot
        lies ``_n_mixed`` snapshots after the change, or is the newest if there are
        fewer.
        """
        place = int(np.flatnonzero(self._times == change.time)[0])
        n_newer = (self._next_slot - 1 - place) % self._n_slots  # the ring wraps round
        return (place + min(self._n_mixed, n_newer)) % self._n_slots

    def accept(self, change: DetectedChange) -> None:
        """Remove the data from before a change, and begin a new stretch of data.

        Parameters
        ----------
        change : DetectedChange
            A change that :meth:`search` has returned.

        Returns
        -------
        None
            The stretch and the snapshots hold the data after the change alone.
        """
        place = self._place(change)
        matrix = self._matrices[place].copy()
        seconds = float(self._seconds[place])
        self._total -= matrix
        self._total_seconds -= seconds
        self._matrices -= matrix
        self._seconds -= seconds
        # Snapshots that are newer than ``place``; older ones lie before the change.
        self._count = (self._next_slot - place - 1) % self._n_slots
        self._next_judged = 0
        self._suspected_slot = None
        self.is_carrying = change.is_carrying

    def posterior(self, out: Posterior) -> None:
        """Solve for the payload from all data since the last change.

        Returns
        -------
        None
            ``out.mean`` (10,) holds the payload's scaled parameters.
        """
        out.clear()
        self._add(self._total, self._total_seconds, out)
        out.solve()
