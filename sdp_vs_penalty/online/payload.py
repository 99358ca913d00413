"""A payload from a stream of positions and torques, in the control loop."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.files import Source, as_measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.constants import NORMAL_95
from sdp_vs_penalty.estimation.estimate import Estimate, as_estimate
from sdp_vs_penalty.online import constants as c
from sdp_vs_penalty.online.arm import ArmModel
from sdp_vs_penalty.online.change import ChangeDetector, DetectedChange
from sdp_vs_penalty.online.information import SIZE, WIDTH, PayloadPrior, Posterior
from sdp_vs_penalty.online.noise import ResidualNoise
from sdp_vs_penalty.online.projection import ConeProjection
from sdp_vs_penalty.online.smoothing import SmoothingFilter
from sdp_vs_penalty.results.record import Shown, Summary
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.inertia import barycentric_from_standard, inertia_matrix


@dataclass(frozen=True, repr=False)
class PayloadNow(Shown):
    """The payload of the last link: the physically consistent one nearest to the data."""

    #: Instant of the estimate [s]: the filters' delay before the last sample.
    time: float
    #: (10,) standard parameters in the last link's frame, physically consistent.
    theta: Array
    #: Mass [kg].
    mass: float
    #: Standard deviation of the mass, with the gains' uncertainty [kg].
    mass_std: float
    #: (3,) centre of mass in the last link's frame [m].
    com: Array
    #: (3,) standard deviation of the centre of mass [m].
    com_std: Array
    #: (3, 3) inertia about the centre of mass [kg m^2].
    inertia: Array
    #: Certified bound on how much nearer to the data another consistent payload could
    #: be, in half squared standard deviations.
    gap: float

    @property
    def mass_interval(self) -> tuple[float, float]:
        """95 % interval of the mass [kg], its lower end at least 0."""
        half = NORMAL_95 * self.mass_std
        return max(self.mass - half, 0.0), self.mass + half

    def _summary(self) -> Summary:
        """Return the title and the (label, text) lines of the printed summary."""
        com = ", ".join(f"{x:.3f}" for x in self.com)
        return f"Payload at {self.time:.2f} s: {_mass_text(self)}", [
            ("centre of mass", f"{com} m in the last link's frame"),
            ("gap", f"{self.gap:.1e} (certified)"),
        ]


@dataclass(frozen=True, repr=False)
class PayloadChange(Shown):
    """A payload was picked up, put down, or is another one."""

    #: "picked up", "put down" or "changed to".
    kind: str
    #: Likeliest instant of the change [s].
    time: float
    #: 95 % interval of the instant [s].
    time_interval: tuple[float, float]
    #: Instant of the sample at which the change was believed [s].
    detected: float
    #: Mass after the change (of "put down": before it), as known when it was believed
    #: [kg].
    mass: float
    #: Standard deviation of that mass [kg].
    mass_std: float
    #: Natural logarithm of the odds against no change, before any prior.
    evidence: float

    def __str__(self) -> str:
        """Return kind, mass with its 95 % half-width, and time of the change."""
        return f"{self.kind} {_mass_text(self)} at {self.time:.2f} s"

    def _summary(self) -> Summary:
        """Return the title and the (label, text) lines of the printed summary."""
        lower, upper = self.time_interval
        return str(self), [
            ("instant", f"{lower:.2f} to {upper:.2f} s (95 %)"),
            ("believed", f"at {self.detected:.2f} s"),
        ]


def _mass_text(known: PayloadNow | PayloadChange) -> str:
    """Return a mass with its 95 % half-width as text."""
    half = NORMAL_95 * known.mass_std
    return f"{known.mass:.2f} ± {formatting.number(half, 1)} kg"


class PayloadEstimator:
    """Mass, centre of mass and inertia of a payload from a stream of samples.

    Recursive in information form on ten numbers, with forgetting; projected onto the
    physically consistent payloads at 100 Hz, with a certificate; slow drift of offsets
    and friction is tracked beside it. A change of the payload is detected, dated and
    reported once. :meth:`update` takes one sample in the control loop.

    Parameters
    ----------
    estimate : Estimate or str
        Model of the arm without a payload, or the path of its model.json.
    noise : ResidualNoise
        Noise of the model's residuals, as :meth:`calibrated` measures it.
    rate : float
        Rate of the samples [Hz].
    delay : float
        Delay of the filters [s], at most 0.05: results are those of that long ago.
    prior : PayloadPrior, optional
        What is known of a payload before it is measured.
    drift : float
        Time over which offsets and friction change by DRIFT_SHARE of friction [s]; 0:
        they stay. Torques of that size are not taken for a payload, and intervals of
        masses include them.

    Raises
    ------
    InputError
        For an effect that does not run in the loop, or another delay.

    References
    ----------
    Traversaro, Brossette, Escande, Nori, IROS 2016 (physical consistency); Adams,
    MacKay, 2007 (changes).
    """

    def __init__(
        self,
        estimate: Estimate | str,
        noise: ResidualNoise,
        rate: float,
        *,
        delay: float = c.MAX_DELAY,
        prior: PayloadPrior | None = None,
        drift: float = c.DRIFT,
    ) -> None:
        """Check the parameters of the class and allocate the arrays of :meth:`update`.

        All arrays are allocated here, since a control loop must not wait for memory.
        ``noise`` describes the residual torque (measured minus the arm's model) without
        a payload; ``delay`` is that of the smoothing filters [s].
        """
        arm_estimate = as_estimate(estimate, "PayloadEstimator(estimate=...)")
        if not 0.0 < rate < np.inf:
            raise InputError(f"a rate of {rate:g} Hz", "give the samples a second")
        n = arm_estimate.robot.n
        if noise.std.shape != (n,):
            raise InputError(
                f"noise of {len(noise.std)} joints, a robot of {n}",
                "calibrate on runs of this robot",
            )
        self.period = 1.0 / rate
        self.arm = ArmModel(arm_estimate.model, arm_estimate.theta)
        self._prior = PayloadPrior() if prior is None else prior
        self._filter = SmoothingFilter(2 * n, self.period, delay)
        self.delay = self._filter.delay
        self._detector = ChangeDetector(
            self._prior, 2 * n, noise.correlation, self.period, self.delay
        )
        self._posterior = Posterior(self._prior, 2 * n)
        self._projection = ConeProjection()
        # A projection takes about ten Newton steps: they are spread over its period.
        self._steps_per_update = max(1, round(10.0 * self.period / c.PROJECTION_PERIOD))
        self._updates_per_projection = max(1, round(c.PROJECTION_PERIOD / self.period))
        self._updates_of_projection = self._updates_per_projection
        self.noise = noise
        self._gain_errors = arm_estimate.uncertainty.gain_errors
        # Drift: the share of a residual that offsets take over each cycle.
        self._learning = self.period / drift if drift else 0.0
        self.drift_offset = np.zeros(n)
        self.drift_friction = np.zeros(n)
        # Samples (2n,) are positions, then torques.
        self._n = n
        self._time: float | None = None  # s, of the last sample
        self._next_tick = 0.0  # s, on the regular clock
        self._last_sample = np.zeros(2 * n)
        self._newest_sample = np.zeros(2 * n)
        self._sample = np.zeros(2 * n)  # interpolated at the next tick
        self._smoothed = np.zeros((3, 2 * n))  # value, rate, acceleration
        # Payload columns, residual and drift's columns [Y, e, N], and the same over
        # the noise's variance.
        width = WIDTH + 2 * n
        self._rows = np.zeros((n, width))
        self._weighted = np.zeros((n, width))
        # N = [diag(offsets' drift), diag(friction's drift)], one standard deviation.
        self._drift_share = c.DRIFT_SHARE if drift else 0.0
        offset_drift = self._drift_share * self.arm.dry_friction
        self._rows[:, WIDTH : WIDTH + n] = np.diag(offset_drift)
        self._friction_drift = self._rows.reshape(-1)[WIDTH + n :: width + 1]
        # Noise of the residuals, and what raises it (see _weigh).
        self._variance = (noise.inflation * noise.std) ** 2
        self._acceleration = noise.acceleration
        self._excess = 1.0
        self._settling = float(np.exp(-self.period / noise.correlation))
        self._dry_variance = self.arm.dry_friction**2
        self._friction_size = self._dry_variance + self._variance
        self._weight = np.zeros(n)
        self._weight_column = self._weight[:, None]
        self._part = np.zeros(n)  # work space
        self._resting = np.zeros(n)  # s at rest
        self._unsettled = np.zeros(n)
        self._load = np.zeros(n)  # torque of the payload
        self._is_resting = np.zeros(n, bool)
        self._is_moving = np.zeros(n, bool)
        self._mass_weight = np.zeros(n)
        # The last certified projection.
        self._published = np.zeros(SIZE)
        self._gap = 0.0
        self._is_published = False

    @classmethod
    def calibrated(
        cls,
        estimate: Estimate | str,
        without_payload: Source,
        rate: float,
        *,
        delay: float = c.MAX_DELAY,
        prior: PayloadPrior | None = None,
        drift: float = c.DRIFT,
    ) -> Self:
        """Return an estimator whose noise is measured on runs without a payload.

        Parameters
        ----------
        estimate : Estimate or path
            Model of the arm without a payload, as of the class.
        without_payload : path, arrays, DataFrame or Measurements
            Runs from which the estimate was not identified, ten seconds or more.
        rate : float
            Sampling rate of the loop [Hz].
        delay : float
            Delay of the filters [s].
        prior : PayloadPrior, optional
            What is known of a payload before it is measured.
        drift : float
            Time over which offsets and friction change [s]; 0: they stay.

        Returns
        -------
        PayloadEstimator
            Ready for the first sample.

        Raises
        ------
        InputError
            For runs of another robot, runs that are too short, or joints that hardly
            move.
        """
        arm_estimate = as_estimate(
            estimate, "PayloadEstimator.calibrated(estimate=...)"
        )
        runs = as_measurements(
            without_payload,
            arm_estimate.robot.n,
            arm_estimate.problem.channel_names,
            "PayloadEstimator.calibrated(without_payload=...)",
        )
        prior = PayloadPrior() if prior is None else prior
        noise = ResidualNoise.measure(arm_estimate, runs, delay, prior)
        return cls(arm_estimate, noise, rate, delay=delay, prior=prior, drift=drift)

    @property
    def is_carrying(self) -> bool:
        """Whether a payload is carried, as far as is known."""
        return self._detector.is_carrying

    def update(self, t: float, q: Array, tau: Array) -> PayloadChange | None:
        """Process one sample in the control loop.

        Parameters
        ----------
        t : float
            Instant of the sample [s].
        q : (n,) array
            Positions of the joints [rad, m].
        tau : (n,) array
            Torques of the joints [N m, N].

        Returns
        -------
        PayloadChange or None
            A change of the payload that this sample confirms.

        Raises
        ------
        InputError
            For other shapes, numbers that are not finite, or a clock that runs back.
        """
        if len(q) != self._n or len(tau) != self._n:
            raise InputError(
                f"a sample of {len(q)} positions and {len(tau)} torques",
                f"give {self._n} joints, in the model's order",
            )
        np.copyto(self._newest_sample[: self._n], q)
        np.copyto(self._newest_sample[self._n :], tau)
        # A sum is finite only if all its terms are: one test, no allocation.
        if not np.isfinite(self._newest_sample.sum() + t):
            raise InputError(
                f"a sample at {t:g} s is not finite", "leave samples out that are none"
            )
        change = None
        # At the first sample, and after a gap, the filters start anew.
        if self._time is None or t - self._time > 2.0 * self.delay:
            self._filter.clear()
            np.copyto(self._last_sample, self._newest_sample)
            self._time = t
            self._next_tick = t
        if t < self._time:
            raise InputError(
                f"the clock runs back from {self._time:g} to {t:g} s",
                "give samples in order",
            )
        # Samples may jitter: interpolate them on a regular clock, up to t with
        # rounding.
        while self._next_tick <= t + 1e-3 * self.period:
            self._interpolate(t)
            change = self._tick(self._next_tick - self.delay) or change
            self._next_tick += self.period
        self._time = t
        np.copyto(self._last_sample, self._newest_sample)
        return change

    def _interpolate(self, t: float) -> None:
        """Write the sample at the next tick of the regular clock to ``_sample``.

        It is interpolated linearly between the last sample and the newest one, at ``t``
        [s].
        """
        assert self._time is not None
        span = t - self._time
        share = 1.0 if span <= 0.0 else min((self._next_tick - self._time) / span, 1.0)
        np.subtract(self._newest_sample, self._last_sample, out=self._sample)
        self._sample *= share
        self._sample += self._last_sample

    def _tick(self, time: float) -> PayloadChange | None:
        """Process one instant of the regular clock; return a confirmed change of
        payload.

        Steps: smooth the sample, compute the arm's torque, form the residual e and the
        payload's columns Y, weight them by the noise, add them to the detector of
        changes, track drift, and project the payload onto the physically consistent
        ones. The smoothed states are those of ``time`` [s], the filters' delay ago.
        Returns None while the filters fill or without a confirmed change.
        """
        if not self._filter.push(self._sample, self._smoothed):
            return None
        # Of the 2n smoothed channels the first n are positions, the others torques.
        n = self._n
        position, velocity, acceleration = self._smoothed[:, :n]
        torque = self._smoothed[0, n:]
        self.arm.update(position, velocity, acceleration)
        # rows (n, 11 + 2n) = [Y, e, N]: scaled payload columns Y (n, 10), residual e
        # (n,), columns of drift N (n, 2n).
        rows = self._rows
        np.multiply(self.arm.friction, self._drift_share, out=self._friction_drift)
        np.multiply(self.arm.columns, self._prior.scale, out=rows[:, :SIZE])
        # e = torque - arm's torque - drifted offset - drifted share of friction.
        residual = rows[:, SIZE]
        np.subtract(torque, self.arm.torque, out=residual)
        residual -= self.drift_offset
        np.multiply(self.drift_friction, self.arm.friction, out=self._part)
        residual -= self._part
        self._weigh(velocity, acceleration)
        np.multiply(rows, self._weight_column, out=self._weighted)
        self._detector.add(rows, self._weighted, self.period, time)
        if self._learning:
            self._follow_drift(residual)
        is_projecting = False
        if self.is_carrying:
            # Information of each joint on the mass (column 0), for errors of gains.
            np.multiply(rows[:, 0], self._weighted[:, 0], out=self._part)
            self._mass_weight += self._part
            is_projecting = self._project()
        # A fast loop projects in one cycle and judges changes in another: that bounds
        # its longest cycle.
        is_fast = self._steps_per_update == 1
        change = self._detector.search(may_judge=not (is_fast and is_projecting))
        return None if change is None else self._believe(change)

    def _weigh(self, velocity: Array, acceleration: Array) -> None:
        """Compute each joint's weight (n,), the inverse variance of its residual
        torque.

            variance = (s^2 + f^2 u + (LOAD_FRICTION tau_payload)^2)
                       x (1 + t_rest / tau)

        - s: calibrated noise.
        - f u: dry friction. It is unknown at rest and where the filter's window holds a
          reversal (u = 1), and settles over the travel SETTLING_TRAVEL.
        - LOAD_FRICTION: share of a payload's torque that gears lose.
        - x >= 1: squared acceleration over that of the calibration. It decays within the
          correlation time tau [s].
        - t_rest: seconds at rest, which bring no new information.
        """
        # ``part`` and ``weight`` are work space (n,): a cycle allocates nothing.
        part = self._part
        weight = self._weight
        # x = max((a / a_calibrated)^2, x decaying to 1).
        np.abs(acceleration, out=part)
        np.divide(part, self._acceleration, out=weight)
        jolt = float(weight.max()) ** 2
        self._excess = max(1.0 + (self._excess - 1.0) * self._settling, jolt)
        # At rest: |v| < REST_SPEED + delay |a|; t_rest = s since then.
        part *= self.delay
        part += c.REST_SPEED
        np.abs(velocity, out=weight)
        np.less(weight, part, out=self._is_resting)
        self._resting += self.period
        self._resting *= self._is_resting
        # u: 1 at rest, then exp(-travel / SETTLING_TRAVEL).
        weight *= -self.period / c.SETTLING_TRAVEL
        np.exp(weight, out=weight)
        self._unsettled *= weight
        np.maximum(self._unsettled, self._is_resting, out=self._unsettled)
        # s^2 + f^2 u + (LOAD_FRICTION tau_payload)^2.
        np.multiply(self._dry_variance, self._unsettled, out=weight)
        weight += self._variance
        if self.is_carrying:
            np.dot(self._rows[:, :SIZE], self._posterior.mean, out=self._load)
            np.multiply(self._load, c.LOAD_FRICTION, out=part)
            part *= part
            weight += part
        # Times x (1 + t_rest / tau).
        np.divide(self._resting, self.noise.correlation, out=part)
        part += 1.0
        part *= self._excess
        weight *= part
        np.reciprocal(weight, out=weight)

    def _follow_drift(self, residual: Array) -> None:
        """Adapt offsets and friction slowly to residuals that no payload explains.

        Each cycle moves the offset (n,) by period / drift times the residual (n,),
        while the joint moves. A residual counts one standard deviation at most, so that
        a new payload is not taken for drift.
        """
        # The unexplained torque, clipped to one standard deviation.
        if self.is_carrying:
            np.subtract(residual, self._load, out=self._part)
        else:
            np.copyto(self._part, residual)
        np.clip(self._part, -self.noise.std, self.noise.std, out=self._part)
        self._part *= self._learning  # period / drift time
        np.logical_not(self._is_resting, out=self._is_moving)
        self._part *= self._is_moving
        self.drift_offset += self._part
        # Friction's relative drift: a gradient step, over friction's square + variance.
        self._part *= self.arm.friction
        self._part /= self._friction_size
        self.drift_friction += self._part

    def _project(self) -> bool:
        """Make a few Newton steps of the projection onto physically consistent
        payloads; return whether any was made.

        A projection takes several cycles of the loop, and begins PROJECTION_PERIOD
        after the last one began, with the newest estimate. Once its gap is certified
        (at most PROJECTION_GAP) its result is published. One cycle of each period is
        free of steps, also where a projection takes longer.
        """
        projection = self._projection
        self._updates_of_projection += 1
        is_due = self._updates_of_projection >= self._updates_per_projection
        if projection.is_done:
            if not is_due:
                return False
            self._updates_of_projection = 0
            self._detector.posterior(self._posterior)
            projection.start(self._posterior.precision, self._posterior.mean)
        elif is_due and self._updates_per_projection > 1:
            self._updates_of_projection = 0
            return False
        else:
            projection.step()
        for _ in range(self._steps_per_update - 1):
            if projection.step():
                break
        if projection.is_done and projection.gap <= c.PROJECTION_GAP:
            np.copyto(self._published, projection.theta)
            self._gap = projection.gap
            self._is_published = True
        return True

    def _believe(self, found: DetectedChange) -> PayloadChange | None:
        """Accept a detected change of payload and return it for the user.

        If a payload was picked up whose mass could be zero (its 95 % interval reaches
        zero), the change is refused: None. Else data from before the change are
        dropped. If the payload was put down, the reported mass is that of the payload
        before, NaN if it was not known yet.
        """
        was_carrying = self.is_carrying
        payload_before = self.payload
        self._detector.posterior_after(found, self._posterior)
        mean, std = self._mass(self._posterior)
        if found.is_carrying and mean - NORMAL_95 * std <= 0.0:
            return None
        self._detector.accept(found)
        self._projection.forget()
        self._is_published = False
        self._mass_weight[:] = 0.0
        kind = "changed to" if was_carrying else "picked up"
        if not found.is_carrying:
            kind = "put down"
            mean = np.nan if payload_before is None else payload_before.mass
            std = np.nan if payload_before is None else payload_before.mass_std
        return PayloadChange(
            kind=kind,
            time=found.time,
            time_interval=(found.lower, found.upper),
            detected=self._next_tick,
            mass=mean,
            mass_std=std,
            evidence=found.evidence,
        )

    def _mass(self, posterior: Posterior) -> tuple[float, float]:
        """Return mean and standard deviation [kg] of the mass, errors of the gains
        included.
        """
        mean = float(posterior.mean[0])
        variance = float(posterior.covariance()[0, 0]) + (mean * self._gain_std()) ** 2
        return mean, float(np.sqrt(variance))

    def _gain_std(self) -> float:
        """Return the relative standard deviation of the mass that errors of the gains
        cause.

        It is that of the gains' mean, with each joint's share in the mass as its
        weight.
        """
        weight = self._mass_weight
        errors = self._gain_errors
        if errors.size == 0:
            return 0.0
        total = float(weight.sum())
        share = weight / total if total > 0.0 else np.full(self._n, 1.0 / self._n)
        return float(np.linalg.norm(share @ errors))

    @property
    def payload(self) -> PayloadNow | None:
        """Payload that is carried now, at the time that the filters speak of.

        None without a payload, and until the first certified projection after a change.
        The standard deviations come from the estimate before the projection.
        """
        if not (self.is_carrying and self._is_published):
            return None
        self._detector.posterior(self._posterior)
        covariance = self._posterior.covariance()
        scale = self._prior.scale
        theta = self._published * scale
        mass = float(theta[0])
        _, mass_std = self._mass(self._posterior)
        barycentric = barycentric_from_standard(theta)
        com = barycentric[1:4]
        # Jacobian of the centre of mass h / m by the scaled parameters m, h / reach.
        jacobian = np.zeros((3, SIZE))
        jacobian[:, 0] = -com / mass
        jacobian[:, 1:4] = np.eye(3) * self._prior.reach / mass
        # Variances (3,): the diagonal of J C J^T.
        com_variance = np.einsum("ij,jk,ik->i", jacobian, covariance, jacobian)
        return PayloadNow(
            # The last tick, less the filters' delay.
            time=self._next_tick - self.period - self.delay,
            theta=theta,
            mass=mass,
            mass_std=mass_std,
            com=com,
            com_std=np.sqrt(com_variance),
            inertia=inertia_matrix(barycentric[4:]),
            gap=self._gap,
        )
