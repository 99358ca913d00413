"""The arms whose logs are corrupted: five real ones, and any number simulated by
Pinocchio alone.

The simulated torque is pinocchio.rnea on links that the library never sees, plus
viscous and sign(dq) Coulomb friction and white noise: nothing of it shares code with
the library. Arms called "drawn" are drawn whole from the number in their name, those
called "small" with two or three joints; their joints dip at slow speed, differ by side,
turn rotors behind gears and ripple.
"""

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from challenge.worlds.motion import waves
from scipy import ndimage

from corruptions.kinds import Corruption, Spoil, corruptions
from sdp_vs_penalty import compare, identify, load_measurements, load_problem
from sdp_vs_penalty.data.datasets import converted
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.robot._pinocchio import pin
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.inertia import from_pseudo_inertia
from sdp_vs_penalty.simulation.worlds.world import inverse_dynamics


@dataclass(frozen=True)
class Arm:
    """A problem, the run that is spoiled, and a clean run that what is identified is
    judged on.

    others : clean runs that the check must be silent about, beside the one that is
    spoiled.
    """

    problem: Problem
    train: Measurements
    test: Measurements
    others: tuple[Measurements, ...] = ()

    @cached_property
    def clean(self) -> Estimate:
        return identify(self.problem, self.train)

    def harm(self, estimate: Estimate) -> float:
        """Held-out error over the clean model's: root mean square of the joints'
        ratios."""
        errors = compare(estimate, self.test)[0].mse
        least = compare(self.clean, self.test)[0].mse
        return float(np.sqrt(np.mean(errors / least)))

    def corruptions(self) -> list[Corruption]:
        """The general ones, and those that need to know what the arm weighs."""
        n = self.train.n
        return [*corruptions(n), *self._of_the_weight(sorted({1 % n, n // 2}))]

    def _of_the_weight(self, joints: list[int]) -> Iterator[Corruption]:
        theta = self.clean.theta
        rigid = self.clean.model.rigid_indices
        weight = self._torque(theta, still=True)
        own = self._torque(theta)
        loaded = theta.copy()
        other = theta.copy()
        place = np.array([0.05, 0.02, 0.08, 1.0])
        loaded[rigid[-10:]] += 2.0 * from_pseudo_inertia(np.outer(place, place))
        other[rigid] = self.problem.nominal(self.clean.model)[rigid] * 0.7
        load = self._torque(loaded) - own
        exchange = self._torque(other) - own
        late = 1.0 * (np.arange(len(weight)) > 0.55 * len(weight))[:, None]
        one = [((j,), np.eye(self.train.n)[j]) for j in joints]
        for share in (1.0, 0.9):
            for which, mask in (*one, ((), np.ones(self.train.n))):
                how = (
                    f"{100 * share:g} %",
                    ("gravity removed",),
                    _less(share * weight * mask),
                )
                yield Corruption("gravity removed", which, *how)
        both = ("load step", "change within the run")
        yield Corruption("load picked up", (), "2 kg", both, _less(-late * load))
        # No number makes one arm of the other: where only the weight that changes is seen,
        # that is a step, and both sentences say to cut the run there.
        cut = (*both, "torque step")
        yield Corruption("two arms in one file", (), "", cut, _less(-late * exchange))
        apart = ("another load", "another arm")
        yield Corruption(
            "tool in one of two runs", (), "2 kg", apart, _less(-load), beside=True
        )

    def _torque(self, theta: Array, still: bool = False) -> Array:
        """A model's torque (N, n) at the training run's samples."""
        t = self.train.t
        q = self.train.q
        dq = np.zeros_like(q) if still else _rate(q, t)
        ddq = np.zeros_like(q) if still else _rate(dq, t)
        model = self.clean.model
        rigid = np.isin(np.arange(len(theta)), model.rigid_indices)
        return model.torque(np.where(rigid, theta, 0.0), Motion(t, q, dq, ddq))


def _less(torque: Array) -> Spoil:
    return lambda run: replace(run, tau=run.tau - torque)


def _rate(x: Array, t: Array) -> Array:
    """(N, n) slopes of a smoothed signal."""
    window = np.hanning(11)[1:-1]
    smooth = ndimage.convolve1d(x, window / window.sum(), axis=0, mode="nearest")
    return np.asarray(np.gradient(smooth, t, axis=0))


def arm(name: str, data: Path) -> Arm:
    """panda, ur10e, tx40, ur10, emps (from ``data``), sim5, or drawn or small and a
    number."""
    if name == "sim5":
        return simulated(name, FIVE, 2)
    for word, (fewest, most) in DRAWN.items():
        if name.startswith(word):
            seed = int(name.removeprefix(word))
            return simulated(name, drawn(seed, fewest, most), seed)
    return real(name, data)


def _parted(problem: Problem, run: Measurements, middle: float) -> Arm:
    """One run, which is spoiled up to the middle [s]."""
    train = run.window(*(0.0, middle))
    test = run.window(*(middle, np.inf))
    return Arm(problem, train, test, (run,))


def real(name: str, data: Path) -> Arm:
    """Positions and torques alone, of one long run or of several. emps : a prismatic
    axis, whose force is the control voltage times the drive's gain; ur10 : of Salerno,
    17.6 s."""
    if name == "ur10":
        problem = load_problem(data / "ur10_salerno/robot.urdf")
        path = data / "ur10_salerno/train.csv"
        run = load_measurements(path, joints=6, names=problem.robot.joint_names)
        return _parted(problem, run, 12.0)
    problem = load_problem(name)
    found = converted(name, data / name)
    runs = {k: replace(run, dq=None, commanded={}) for k, run in found.items()}
    if name == "panda":  # every fifth row
        run = runs["exciting"]
        return _parted(problem, run.rows(np.arange(0, len(run.t), 5)), 14.0)
    if name == "tx40":  # every tenth row of the first 9 s
        return _parted(problem, runs["exciting"].rows(np.arange(0, 45_000, 10)), 6.0)
    if name == "ur10e":
        names = (
            "02_12-50sec_12harm",
            "02_19_14harm50sec",
            "02_19_15harm50sec",
            "02_19_14harm50secLoad",
        )
        train, test, *others = (
            runs[f"ur-20_{x}"] for x in (*names, "01_17-ptp_10_points")
        )
        return Arm(problem, train, test.window(0.0, 20.0), (test, *others))
    train, test = runs.values()
    return Arm(problem, train, test, (test,))


# mass, centre of mass, axis, origin and kind of each joint's link; metres and
# kilograms.
FIVE = (
    ("revolute", "0 0 1", "0 0 0.2", 12.0, "0.1 0.02 0.1"),
    ("revolute", "0 1 0", "0.2 0 0.2", 7.0, "0.18 -0.03 0.02"),
    ("prismatic", "1 0 0", "0.3 0 0", 4.0, "0.05 0.02 0.03"),
    ("revolute", "0 0 1", "0.25 0 0", 2.2, "0.1 0.02 0.03"),
    ("revolute", "0 1 0", "0.2 0 0", 1.4, "0.09 0.02 -0.02"),
)
Axis = tuple[str, str, str, float, str]
#: Fewest and most joints of drawn arms, by the first part of their name.
DRAWN = {"drawn": (4, 7), "small": (2, 3)}


def urdf(name: str, axes: tuple[Axis, ...]) -> str:
    """The arm as a URDF file, its links solid balls of 7 cm about their centres of
    mass."""
    parts = ['<link name="l0"/>']
    for k, (kind, axis, origin, mass, com) in enumerate(axes, start=1):
        i = 0.4 * mass * 0.07**2
        limit = 0.4 if kind == "prismatic" else 3.0
        parts.append(
            f'<link name="l{k}"><inertial><origin xyz="{com}"/><mass'
            f' value="{mass}"/><inertia ixx="{i}" iyy="{1.3 * i}" izz="{0.8 * i}"'
            f' ixy="{0.1 * i}" ixz="0" iyz="0"/></inertial></link><joint name="j{k}"'
            f' type="{kind}"><parent link="l{k - 1}"/><child link="l{k}"/><origin'
            f' xyz="{origin}"/><axis xyz="{axis}"/><limit lower="{-limit}"'
            f' upper="{limit}" velocity="3" effort="400"/></joint>'
        )
    return f'<robot name="{name}">{"".join(parts)}</robot>'


def drawn(seed: int, fewest: int, most: int) -> tuple[Axis, ...]:
    """So many joints; geometry and masses of a size that arms have."""
    rng = np.random.default_rng([seed, 99])
    axes = []
    say = lambda v: " ".join(f"{x:.4g}" for x in v)  # noqa: E731
    for k in range(int(rng.integers(fewest, most + 1))):
        kind = "prismatic" if rng.random() < 0.12 else "revolute"
        axis, along = (
            np.eye(3)[rng.integers(3)] * rng.choice([-1.0, 1.0]) for _ in range(2)
        )
        origin = rng.uniform(0.15, 0.4) * 0.9**k * along
        com = 0.4 * origin + rng.uniform(-0.05, 0.05, 3)
        mass = 14.0 * 0.65**k * rng.uniform(0.7, 1.3)
        axes.append((kind, say(axis), say(origin), mass, say(com)))
    return tuple(axes)


def believed(name: str, axes: tuple[Axis, ...]) -> Problem:
    """The problem of the arm's URDF file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{name}.urdf"
        path.write_text(urdf(name, axes))
        return load_problem(path)


def true_model(axes: tuple[Axis, ...], rng: np.random.Generator) -> Any:
    """Pinocchio's model; links differ from the URDF's inertials by up to 30 % and some
    centimetres."""
    model = pin.buildModelFromXML(urdf("true", axes))
    for inertia in list(model.inertias)[1:]:
        inertia.mass *= rng.uniform(0.7, 1.3)
        inertia.lever = inertia.lever + rng.normal(size=3) * 0.02
    return model


def simulated(name: str, axes: tuple[Axis, ...], seed: int) -> Arm:
    """Two runs of the true model, one held out; 200 Hz, 20 s, position steps of 1e-5."""
    real = name.startswith(tuple(DRAWN))
    train = _simulate(axes, np.random.default_rng([seed, 0]), seed, real)
    test = _simulate(axes, np.random.default_rng([seed, 1]), seed, real)
    return Arm(believed(name, axes), train, test, (test,))


def _simulate(
    axes: tuple[Axis, ...], rng: np.random.Generator, seed: int, real: bool
) -> Measurements:
    machine = np.random.default_rng(seed)
    n = len(axes)
    model = true_model(axes, machine)
    size = np.array([30.0 * 0.7**k for k in range(n)])
    viscous, coulomb = machine.uniform(0.05, 0.12, (2, n)) * size
    t = np.arange(0.0, 20.0, 0.005)
    reach = np.array([0.12 if a[0] == "prismatic" else 0.7 for a in axes])
    shares, phases = rng.uniform(
        [[0.3], [-np.pi]], [[1.0], [np.pi]], (5, 2, n)
    ).swapaxes(0, 1)
    k = np.arange(1, 6).astype(float)[:, None]
    q, dq, ddq = waves(reach / np.sqrt(k) * shares, 2.0 * np.pi * 0.1 * k, phases)(t)
    q += np.where(reach > 0.5, rng.uniform(-0.4, 0.4, n), 0.0)
    tau = inverse_dynamics(model, q, dq, ddq)
    if real:  # of the machine, not of the run
        own = np.random.default_rng([seed, 5])
        speed = dq.std(axis=0)
        side = np.where(dq > 0.0, 1.0, own.uniform(0.85, 1.15, n)) - 1.0
        tau += (
            coulomb * np.sign(dq) * (side + 0.2 * np.exp(-((dq / (0.1 * speed)) ** 2)))
        )
        tau += (
            own.uniform(0.1, 1.5)
            * np.diag(pin.crba(model, model.createData(), q[0]))
            * ddq
        )
        ripple = own.uniform(0.0, 0.01) * tau.std(axis=0)
        tau += ripple * np.sin(40.0 * q / speed + own.uniform(-np.pi, np.pi, n))
    tau += viscous * dq + coulomb * np.sign(dq)
    tau += 0.01 * tau.std(axis=0) * rng.normal(size=tau.shape)
    return Measurements(t, np.round(q / 1e-5) * 1e-5, tau, None, None, ("simulated",))
