"""How often 95 % intervals hold the truth: simulated runs, one row a situation.

    python benchmarks/interval_coverage.py [--replications 200] [--only WORD] [--out results/coverage]

The truth is simulated here: rigid bodies by Pinocchio, friction and noise by the formulas below, which
share nothing with the library's effects. Regressors are computed once, torque noise is drawn anew; what
is then judged is the library's own: :func:`of_regression`, the SDP, :func:`add`. Writes .csv and .md.
"""

from __future__ import annotations

import argparse
import csv
import io
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from challenge.judge import wilson
from numpy.typing import NDArray
from scipy import signal

from sdp_vs_penalty import add, identify
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.estimation.certify import certify
from sdp_vs_penalty.estimation.intervals import Interval
from sdp_vs_penalty.estimation.known_load import independent_gains
from sdp_vs_penalty.estimation.uncertainty import (
    Uncertainty,
    beside_held,
    of_regression,
)
from sdp_vs_penalty.estimators import DEFAULT_METHOD, make_estimator
from sdp_vs_penalty.estimators.task import joint_weights, make_task
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.problem.load import load_problem
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.base_parameters import base_rows
from sdp_vs_penalty.regression.regression import Factor, Regression, compress
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.trajectory import random_trajectory
from sdp_vs_penalty.signals.preprocessing import RunFilter
from sdp_vs_penalty.signals.runs import stretches

Array = NDArray[np.float64]
ARMS = {"two_link": "two_link", "my_arm": str(Path(__file__).parents[1] / "docs" / "my_arm.urdf")}
EFFECTS = "rigid_body,viscous_friction,coulomb_friction,torque_offset"
#: Standard deviation of the noise over that of a joint's torque.
NOISE = 0.05
RATE = 200.0  # Hz
STRIBECK = 0.6  # of the torque's deviation
VELOCITIES, EXPONENTS = (0.05, 0.15), (1.0, 2.0)  # rad/s; of Stribeck's curve, drawn anew each time
LOAD = (1.2, (0.03, -0.02, 0.08), 4e-3)  # kg, m, kg m^2
GAIN_ERROR = 0.01
#: Times as many replications of a payload: at 200, coverage of 95 % is seen as 91.5 % one time in fifty.
_PAYLOADS = 3


def coulomb(v: Array, width: float = 0.01) -> Array:
    return np.tanh(v / width)


@dataclass(frozen=True)
class World:
    """A simulated arm: friction (n, 3) viscous, Coulomb, offset; extra : torque (N, n) of velocities."""

    problem: Problem
    friction: Array
    extra: Callable[[Array], Array] | None = None
    load: Array | None = None
    width: float = 0.01  # rad/s over which Coulomb friction turns

    @property
    def model(self) -> Model:
        return self.problem.model(EFFECTS)

    @property
    def theta(self) -> Array:
        return np.concatenate([self.problem.nominal_links.ravel(), self.friction.T.ravel()])

    def run(self, seconds: float, seed: int) -> Measurements:
        """Without noise."""
        trajectory = random_trajectory(self.problem.robot, seed=seed, duration=seconds)
        t = np.arange(0.0, seconds, 1.0 / RATE)
        q, dq, ddq = trajectory.states(t)
        links = self.problem.nominal_links.copy()
        if self.load is not None:
            links[-1] += self.load
        tau = self.problem.robot.inverse_dynamics(links, q, dq, ddq)
        viscous, dry, offset = self.friction.T
        tau = tau + viscous * dq + dry * coulomb(dq, self.width) + offset
        if self.extra is not None:
            tau = tau + self.extra(dq)
        return Measurements(t, q, tau, names=(f"{seconds:g} s",))


def world(arm: str, **more: object) -> World:
    problem = load_problem(ARMS[arm])
    n = problem.robot.n
    friction = np.column_stack([np.linspace(0.4, 0.6, n), np.linspace(0.7, 0.9, n), np.full(n, 0.3)])
    return World(problem, friction, **more)  # type: ignore[arg-type]


def white(shape: tuple[int, int], rng: np.random.Generator) -> Array:
    return rng.normal(size=shape)


def slow(shape: tuple[int, int], rng: np.random.Generator) -> Array:
    """AR(1) with the coefficient 0.98 a sample, unit variance, begun long before."""
    noise = rng.normal(size=(shape[0] + 500, shape[1]))
    return np.asarray(signal.lfilter([np.sqrt(1 - 0.98**2)], [1.0, -0.98], noise, axis=0)[500:])


@dataclass(frozen=True)
class Prepared:
    """A run whose columns are orthogonalised once: other torques cost a product."""

    run: Measurements
    model: Model
    problem: Problem

    @cached_property
    def regression(self) -> Regression:
        return compress(self.run, self.model, self.settings)

    @cached_property
    def settings(self):  # type: ignore[no-untyped-def]
        return self.problem.preprocessing.resolve(self.run)

    @cached_property
    def parts(self) -> list[tuple[Factor, Array, Array, Array]]:
        """Of each factor: Q and R of its columns, and its rows of the filtered torque."""
        from sdp_vs_penalty.signals.preprocessing import filtered_torque

        rows = filtered_torque(self.run, self.model, self.settings)
        t, blocks = rows.motion.t, self.regression.blocks
        out = []
        for f in self.regression.factors:
            stops = [b.stop for b in blocks]
            owner = np.clip(np.searchsorted(stops, t, side="right"), 0, len(blocks) - 1)
            mine = np.flatnonzero(owner == f.block)
            q, r = np.linalg.qr(rows.columns[f.joint].columns[mine])
            out.append((f, q, r, mine))
        return out

    @cached_property
    def filter(self) -> tuple[RunFilter, object, NDArray[np.int64]]:
        from sdp_vs_penalty.signals.preprocessing import filtered_torque

        filters = RunFilter(self.run, self.settings)
        part = next(iter(stretches(self.run)))
        t = filtered_torque(self.run, self.model, self.settings).motion.t
        return filters, part, np.round((t - self.run.t[0]) / filters.dt).astype(np.int64)

    def with_torque(self, tau: Array) -> Regression:
        """What compress gives of the same run with this torque (N, n)."""
        filters, part, at = self.filter
        torque = filters.torque(replace(part, tau=tau), at)  # type: ignore[type-var, arg-type]
        factors = []
        for f, q, r, mine in self.parts:
            y = torque[mine, f.joint]
            rho = q.T @ y
            rest = np.sqrt(max(float(y @ y - rho @ rho), 0.0))
            triangle = np.block([[r, rho[:, None]], [np.zeros((1, r.shape[1])), np.array([[rest]])]])
            factors.append(replace(f, triangle=triangle))
        return replace(self.regression, factors=tuple(factors))


@dataclass
class Tally:
    """Shares of the intervals that held the truth, replication by replication."""

    row: str
    quantity: str
    right: bool
    shares: list[float]
    widths: list[float]

    def add(self, truth: Array, intervals: list[Interval]) -> None:
        pairs = [(x, i) for x, i in zip(truth, intervals, strict=True) if np.isfinite(i.std)]
        self.shares.append(float(np.mean([i.low <= x <= i.high for x, i in pairs])))
        self.widths.append(float(np.median([i.high - i.low for _, i in pairs])))

    def interval(self) -> tuple[float, float]:
        """Wilson's 95 % interval of the coverage; intervals of one replication count as one."""
        n = len(self.shares)
        return wilson(float(np.sum(self.shares)), n)


def parameters(
    name: str, place: World, seconds: float, noise: Callable[..., Array], count: int, right: bool = True
) -> Iterator[Tally]:
    """Base, standard and friction parameters by least squares and by the default SDP."""
    run = place.run(seconds, 3)
    ready, model, problem = Prepared(run, place.model, place.problem), place.model, place.problem
    rows = base_rows(problem, model).rows
    theta, links = place.theta, len(model.rigid_indices)
    others = len(theta) - links
    what = ["base, OLS", "standard, OLS", "friction, OLS"]
    what += ["base, SDP", "standard, SDP", "friction, SDP"]
    tallies = {q: Tally(name, q, right, [], []) for q in what}
    estimator = make_estimator(DEFAULT_METHOD)
    deviation = NOISE * run.tau.std(axis=0)
    for k in range(count):
        rng = np.random.default_rng([k, 11])
        data = ready.with_torque(run.tau + deviation * noise(run.tau.shape, rng))
        task = make_task(problem, model, data)
        sdp, _ = certify(task, estimator.fit(task))
        for method, known in (
            ("OLS", of_regression(problem, model, data)),
            ("SDP", of_regression(problem, model, data, sdp, constrained=True)),
        ):
            rigid = slice(0, len(rows) - others)  # a wrong law has no true parameters of the right one
            tallies[f"base, {method}"].add((rows @ theta)[rigid], list(known.base[rigid]))
            tallies[f"standard, {method}"].add(theta[:links], list(known.standard[:links]))
            tallies[f"friction, {method}"].add(theta[links:], list(known.standard[links:]))
    shown = what if right else [q for q in what if not q.startswith("friction")]
    yield from (tallies[q] for q in shown)


def payload(
    name: str, noise: Callable[..., Array], gains: float, stated: float, count: int
) -> Iterator[Tally]:
    """The mass of a load, on a model held fixed that came from another run by the same channels."""
    mass, com, moment = LOAD
    load = inertia.standard_from_barycentric([mass, *com, moment, 0, moment, 0, 0, moment])
    bare = world("my_arm")
    loaded = replace(bare, load=load)
    problem, model = bare.problem, bare.model
    own = problem.model("payload")
    wide = Model(model.robot, (*model.effects, *own.effects))
    first = Prepared(bare.run(20.0, 3), model, problem)
    second = Prepared(loaded.run(20.0, 4), wide, problem)
    errors, base = independent_gains(stated, model.robot.n), base_rows(problem, own)
    tally = Tally(name, "payload, mass", stated >= gains, [], [])
    for k in range(count):
        rng = np.random.default_rng([k, 12])
        gain = 1.0 + gains * rng.normal(size=model.robot.n)
        taus = []
        for run in (first.run, second.run):
            deviation = NOISE * run.tau.std(axis=0)
            taus.append(gain * run.tau + deviation * noise(run.tau.shape, rng))
        before = of_regression(problem, model, first.with_torque(taus[0]), gain_errors=errors)
        theta = np.array([i.value for i in before.standard])
        data = second.with_torque(taus[1])
        left = data.beside(theta)
        part = np.linalg.lstsq(*_system(left, np.ones(left.joints)), rcond=1e-9)[0]
        part = np.linalg.lstsq(*_system(left, joint_weights(left, part)), rcond=1e-9)[0]
        held = (model, theta, before)
        known: Uncertainty = beside_held(
            problem, own, data, held, part, base, constrained=False, gain_errors=errors
        )
        tally.add(np.array([mass]), [known.standard[len(theta)]])
    yield tally


def _system(data: Regression, weights: Array) -> tuple[Array, Array]:
    whole = data.least_squares(weights)
    return whole.R, whole.rho


def stribeck(name: str, between: bool, width: float, count: int) -> Iterator[Tally]:
    """The size of Stribeck friction whose velocity and exponent :func:`add` finds in the same run, and
    the width over which friction turns.

    It tries the exponents 1 and 2; with ``between`` the true one lies between them.
    """
    plain = world("two_link", width=width)
    clean = plain.run(20.0, 3)
    size = STRIBECK * float(clean.tau[:, 1].std())
    deviation = NOISE * clean.tau.std(axis=0)
    velocity = random_trajectory(plain.problem.robot, seed=3, duration=20.0).states(clean.t)[1][:, 1]
    tally = Tally(name, "effect size, shape fitted", not between, [], [])
    for k in range(count):
        rng = np.random.default_rng([k, 13])
        vs = np.exp(rng.uniform(*np.log(VELOCITIES)))
        delta = rng.uniform(*EXPONENTS) if between else rng.choice(EXPONENTS)
        tau = clean.tau + deviation * white(clean.tau.shape, rng)
        tau[:, 1] += size * coulomb(velocity, width) * np.exp(-((np.abs(velocity) / vs) ** delta))
        noisy = replace(clean, tau=tau)
        before = identify(plain.problem, noisy, "ols", effects=EFFECTS)
        after = add(before, "stribeck_friction:2", noisy)
        tally.add(np.array([size]), [after.uncertainty.standard[-1]])
    yield tally


def wrong_friction(v: Array) -> Array:
    """What the model does not know: friction that falls at first and bends later."""
    return coulomb(v) * (0.5 * np.exp(-np.abs(v) / 0.15) + 0.2 * np.abs(v) ** 1.7)


def rows(count: int, word: str = "") -> Iterator[Tally]:
    """Those whose situation has the word."""
    slow_noise = "AR(1) 0.98 noise"
    made: list[tuple[str, Callable[..., Iterator[Tally]], tuple[object, ...]]] = []
    for arm in ARMS:
        place, wrong = world(arm), world(arm, extra=wrong_friction)
        made += [
            (f"{arm}, white noise, 20 s", parameters, (place, 20.0, white, count)),
            (f"{arm}, {slow_noise}, 40 s", parameters, (place, 40.0, slow, count)),
            (f"{arm}, white noise, 3 s", parameters, (place, 3.0, white, count)),
            (f"{arm}, misspecified friction", parameters, (wrong, 20.0, white, count, False)),
        ]
    # One interval a replication, where the rows above have a dozen.
    more = _PAYLOADS * count
    made += [
        ("my_arm, white noise", payload, (white, 0.0, 0.0, more)),
        (f"my_arm, {slow_noise}", payload, (slow, 0.0, 0.0, more)),
        ("my_arm, gains off by 1 %, stated", payload, (white, GAIN_ERROR, GAIN_ERROR, more)),
        ("my_arm, gains off by 1 %, not stated", payload, (white, GAIN_ERROR, 0.0, more)),
        ("two_link, Stribeck, exponent 1 or 2", stribeck, (False, 0.01, count)),
        ("two_link, Stribeck, turning over 0.025 rad/s", stribeck, (False, 0.025, count)),
        ("two_link, Stribeck, exponent between", stribeck, (True, 0.01, count)),
    ]
    for name, make, given in made:
        if word in name:
            yield from make(name, *given)


HEAD = ("situation", "quantity", "model", "coverage_percent", "wilson_low", "wilson_high",
        "replications", "median_width")  # fmt: skip


def table(tallies: list[Tally]) -> list[tuple[str, ...]]:
    out = []
    for t in tallies:
        low, high = t.interval()
        out.append(
            (
                t.row,
                t.quantity,
                "right" if t.right else "WRONG",
                *(f"{100.0 * x:.1f}" for x in (np.mean(t.shares), low, high)),
                str(len(t.shares)),
                f"{np.median(t.widths):.3g}",
            )
        )
    return out


def merged(old: Path, new: list[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """The rows of a table, those made again in their places, new ones behind."""
    with old.open(newline="") as file:
        kept = {r[:2]: r for r in map(tuple, list(csv.reader(file))[1:])}
    return list({**kept, **{r[:2]: r for r in new}}.values())


def written(lines: list[tuple[str, ...]], out: Path, count: int) -> None:
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([HEAD, *lines])
    write_text(out.with_suffix(".csv"), text.getvalue())
    judged = [float(r[3]) for r in lines if r[2] == "right"]
    inside = [x for x in judged if 92.0 <= x <= 97.0]
    made = [
        "# Coverage of 95 % intervals",
        "",
        f"Simulated: {count} replications a row ({_PAYLOADS * count} of a payload), fresh torque "
        f"noise of {100 * NOISE:g} % of each "
        f"joint's torque at {RATE:g} Hz. Of {len(judged)} rows with a right model {len(inside)} lie "
        "within 92 and 97 %. Rows whose model is WRONG are shown to say what intervals cannot know: "
        "their truth lies outside the model. Wilson intervals count a replication once, whatever the "
        "number of its parameters. OLS: least squares; SDP: the default method, intervals cut to the "
        "physical set.",
        "",
        f"    python benchmarks/interval_coverage.py --replications {count}",
        "",
        "About a quarter of an hour of processor time. Width: the median of the intervals' own, in "
        "their units.",
        "",
        "| situation | quantity | model | coverage [%] | Wilson 95 % | width |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    made += [f"| {r[0]} | {r[1]} | {r[2]} | {r[3]} | {r[4]} to {r[5]} | {r[7]} |" for r in lines]
    write_text(out.with_suffix(".md"), "\n".join(made) + "\n")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--replications", type=int, default=200)
    parser.add_argument("--only", default="", help="a word in the situation")
    parser.add_argument("--out", type=Path, default=Path("results/coverage"))
    given = parser.parse_args()
    lines = []
    for tally in rows(given.replications, given.only):
        lines += table([tally])
        print(*lines[-1], sep="  ", flush=True)
    if given.only:
        lines = merged(given.out.with_suffix(".csv"), lines)
    written(lines, given.out, given.replications)


if __name__ == "__main__":
    main()
