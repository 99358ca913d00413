"""Arms that nothing of the check was chosen on: other kinematics, other imperfections, other windows.

Two halves: DEVELOPED were looked at while the check was mended, JUDGES once, when it was done.

The simulated ones are moved by Pinocchio on links, lengths and a payload that the library never sees.
Friction is Stribeck's with another size to either side, rotors turn behind gears, torques carry noise
whose power falls with frequency and a ripple with the motor's angle; sensors add white noise. Those
called "drawn" are drawn whole from the number in their name, with geared rotors and friction that bends
before it slides; those called "geared" are moved by MuJoCo (geared_arms.py).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from corruption_arms import Arm, Axis, arm_of, panda_run, tx40_run, ur10e_run, urdf
from corruption_kinds import rows
from numpy.typing import NDArray

from sdp_vs_penalty import load_problem
from sdp_vs_penalty.data.measurements import Measurements

Array = NDArray[np.float64]

DEVELOPED = (
    "scara4", "seven", "ur10e b", "tx40 b", "gantry5", "desk6", "polar3", "ur10e c", "tx40 c", "drawn1",
    "drawn2", "drawn31", "drawn32", "drawn33", "panda b", "ur10e d", "geared1", "geared2", "geared3",
    "drawn51", "drawn52", "panda c", "ur10e e", "geared41", "geared42", "drawn71", "drawn72", "panda d",
    "ur10e f", "geared71", "geared72",
)  # fmt: skip
JUDGES = ("drawn91", "drawn92", "panda e", "ur10e g", "geared91", "geared92")


@dataclass(frozen=True)
class Machine:
    """What is simulated: kind, axis, origin, mass and centre of mass of each link, and how it errs.

    payload [kg] sits at the last link; geometry, inertials: relative errors of what the library is
    told; friction and ripple as shares of a joint's torque; noise likewise; rotor : inertia behind the
    gear, as a share of the arm's own; travel [rad, m] over which friction bends before it slides.
    """

    axes: tuple[Axis, ...]
    seed: int
    payload: float = 0.0
    geometry: float = 0.005
    inertials: float = 0.15
    friction: float = 0.2
    ripple: float = 0.005
    noise: float = 0.01
    rotor: float = 0.1
    travel: float = 0.0


SCARA = (
    ("revolute", "0 0 1", "0 0 0.3", 7.0, "0.14 0.01 0.05"),
    ("revolute", "0 0 1", "0.325 0 0.05", 5.0, "0.12 -0.01 0.03"),
    ("prismatic", "0 0 1", "0.275 0 0", 1.8, "0.01 0.01 -0.1"),
    ("revolute", "0 0 1", "0 0 -0.1", 0.8, "0.04 0.02 -0.03"),
)
SEVEN = (
    ("revolute", "0 0 1", "0 0 0.32", 5.3, "0.02 0.01 0.09"),
    ("revolute", "0 1 0", "0.08 0 0", 4.5, "0.01 0.1 0.02"),
    ("revolute", "1 0 0", "0 0.19 0", 3.7, "0.18 0.01 0.02"),
    ("revolute", "0 1 0", "0.4 -0.04 0", 2.5, "0.03 -0.05 0.01"),
    ("revolute", "1 0 0", "0 -0.125 0", 2.0, "0.14 0.02 0.01"),
    ("revolute", "0 1 0", "0.275 0.03 0", 1.6, "0.02 0.06 0.01"),
    ("revolute", "1 0 0", "0.1 0.1 0", 0.6, "0.06 0.02 0.03"),
)
GANTRY = (
    ("prismatic", "1 0 0", "0 0 1.5", 30.0, "0.05 0.3 0.1"),
    ("prismatic", "0 0 1", "0.1 0.4 0", 12.0, "0.02 0.05 -0.2"),
    ("revolute", "0 0 1", "0 0 -0.5", 4.0, "0.06 0.03 -0.05"),
    ("revolute", "1 0 0", "0 0.05 -0.15", 2.5, "0.02 0.04 -0.08"),
    ("revolute", "0 1 0", "0 0 -0.2", 1.5, "0.04 0.01 -0.06"),
)
DESK = (
    ("revolute", "0 0 1", "0 0 0.16", 4.2, "0.01 0.02 0.04"),
    ("revolute", "0 -1 0", "0 0.12 0", 8.4, "0.02 0.03 0.21"),
    ("revolute", "0 -1 0", "0 -0.09 0.43", 2.6, "0.01 0.02 0.18"),
    ("revolute", "0 -1 0", "0 0 0.37", 1.4, "0.01 0.05 0.01"),
    ("revolute", "0 0 1", "0 0.11 0", 1.3, "0.02 0.01 0.05"),
    ("revolute", "0 -1 0", "0 0 0.1", 0.5, "0.02 0.05 0.03"),
)
POLAR = (
    ("revolute", "0 0 1", "0 0 0.5", 20.0, "0.05 0.03 0.1"),
    ("revolute", "0 1 0", "0 0 0.3", 14.0, "0.2 0.02 0.03"),
    ("prismatic", "1 0 0", "0.5 0 0", 8.0, "0.3 0.02 0.01"),
)
MACHINES = {
    "scara4": Machine(SCARA, 11, payload=1.0),
    "seven": Machine(SEVEN, 12, payload=1.5, friction=0.15, geometry=0.01),
    "gantry5": Machine(GANTRY, 21, geometry=0.01, friction=0.25, inertials=0.2),
    "desk6": Machine(DESK, 22, payload=2.0, friction=0.3, noise=0.015),
    "polar3": Machine(POLAR, 23, friction=0.15, ripple=0.01, inertials=0.1),
}


def drawn(seed: int) -> Machine:
    """Four to seven joints; geometry, masses and imperfections of a size that arms have."""
    rng = np.random.default_rng([seed, 99])
    axes: list[Axis] = []
    for k in range(int(rng.integers(4, 8))):
        kind = "prismatic" if rng.random() < 0.12 else "revolute"
        axis, along = (np.eye(3)[rng.integers(3)] * rng.choice([-1.0, 1.0]) for _ in range(2))
        origin = rng.uniform(0.15, 0.4) * 0.9**k * along
        com = 0.4 * origin + rng.uniform(-0.05, 0.05, 3)
        mass = 14.0 * 0.65**k * rng.uniform(0.7, 1.3)
        axes.append((kind, *(" ".join(f"{x:.4g}" for x in v) for v in (axis, origin)), mass,
                     " ".join(f"{x:.4g}" for x in com)))  # fmt: skip
    return Machine(
        tuple(axes), seed, rng.choice([0.0, 1.5]), rng.choice([0.002, 0.01]), rng.uniform(0.05, 0.2),
        rng.uniform(0.1, 0.4), rng.uniform(0.0, 0.01), rng.uniform(0.003, 0.015),
        rng.uniform(0.1, 1.5), rng.choice([0.0, 3e-4, 2e-3]),
    )  # fmt: skip


def unseen(data: Path, names: tuple[str, ...]) -> list[Arm]:
    """The arms of these names; real ones from ``data``."""
    real = {
        "ur10e b": lambda: ur10e_window(data, "ur10e b", (22.0, 45.0), (0.0, 18.0)),
        "ur10e c": lambda: ur10e_window(data, "ur10e c", (0.0, 20.0), (25.0, 45.0), ("19_14", "12-50")),
        "tx40 b": lambda: tx40_window(data, "tx40 b", (15_000, 45_000), (0, 15_000), 10),
        "tx40 c": lambda: tx40_window(data, "tx40 c", (7_500, 36_000), (36_000, 45_000), 8),
        "ur10e d": lambda: ur10e_window(data, "ur10e d", (5.0, 30.0), (20.0, 40.0), ("19_15", "12-50")),
        "ur10e e": lambda: ur10e_window(data, "ur10e e", (3.0, 33.0), (5.0, 30.0), ("19_14", "19_15")),
        "panda c": lambda: panda_window(data, "panda c", (6.0, 21.0), (0.0, 6.0)),
        "ur10e f": lambda: ur10e_window(data, "ur10e f", (20.0, 45.0), (0.0, 20.0), ("19_15", "19_14")),
        "panda d": lambda: panda_window(data, "panda d", (4.5, 19.5), (0.0, 4.5)),
        "ur10e g": lambda: ur10e_window(data, "ur10e g", (10.0, 35.0), (5.0, 25.0), ("12-50", "19_15")),
        "panda e": lambda: panda_window(data, "panda e", (9.0, 24.0), (0.0, 9.0)),
        "panda b": lambda: panda_window(data, "panda b", (15.0, 30.0), (0.0, 14.0)),
    }
    return [real[name]() if name in real else _machine(name) for name in names]


def _machine(name: str) -> Arm:
    machine = MACHINES.get(name) or drawn(int(name.removeprefix("drawn")))
    return arm_of(name, machine.axes, machine.seed, partial(_simulate, machine))


def panda_window(data: Path, name: str, train: tuple[float, float], test: tuple[float, float]) -> Arm:
    first, second = (panda_run(data).window(*span).runs()[0] for span in (train, test))
    return Arm(name, load_problem("panda"), first, second, (second,))


_UR10E = {
    "12-50": "ur-20_02_12-50sec_12harm", "19_14": "ur-20_02_19_14harm50sec",
    "19_15": "ur-20_02_19_15harm50sec",
}  # fmt: skip


def ur10e_window(
    data: Path, name: str, train: tuple[float, float], test: tuple[float, float],
    days: tuple[str, str] = ("12-50", "19_14"),
) -> Arm:  # fmt: skip
    """Trained on one recording, judged on another."""
    runs = []
    for day, span in zip(days, (train, test), strict=True):
        runs.append(ur10e_run(data, _UR10E[day]).window(*span).runs()[0])
    return Arm(name, load_problem("ur10e"), runs[0], runs[1], (runs[1],))


def tx40_window(
    data: Path, name: str, train: tuple[int, int], test: tuple[int, int], stride: int
) -> Arm:
    run = tx40_run(data)
    first, second = (rows(run, np.arange(*span, stride)) for span in (train, test))
    return Arm(name, load_problem("tx40"), first, second)


def _simulate(machine: Machine, rng: np.random.Generator) -> Measurements:
    import pinocchio as pin

    truth = np.random.default_rng(machine.seed)
    model = pin.buildModelFromXML(urdf("true", machine.axes))
    for k in range(1, model.njoints):
        model.jointPlacements[k].translation *= 1.0 + machine.geometry * truth.normal(size=3)
        inertia = model.inertias[k]
        inertia.mass *= 1.0 + machine.inertials * truth.uniform(-1.0, 1.0)
        inertia.lever = inertia.lever * (1.0 + machine.inertials * truth.normal(size=3))
    load = pin.Inertia(machine.payload, np.array([0.03, 0.01, 0.06]), 1e-3 * machine.payload * np.eye(3))
    model.inertias[model.njoints - 1] += load
    t = np.arange(0.0, 20.0, 0.004)
    q, dq, ddq = _motion(t, [axis[0] == "prismatic" for axis in machine.axes], rng)
    data = model.createData()
    tau = np.array([pin.rnea(model, data, *state) for state in zip(q, dq, ddq, strict=True)])
    n, size, speed = len(machine.axes), tau.std(axis=0), dq.std(axis=0)
    # What the joint is made for: friction and rotor go with the torque that it has to give, not with
    # that of this run, and are the machine's, not the run's.
    rated = machine.friction * _rated(machine, model, pin)
    slow = np.exp(-((dq / (0.1 * speed)) ** 2))
    coulomb = rated * np.where(dq > 0.0, 1.0, truth.uniform(0.85, 1.15, n))
    slides = _bent(q, machine.travel) if machine.travel else np.tanh(dq / (0.01 * speed))
    tau += coulomb * slides * (1.0 + 0.2 * slow)
    tau += rated * truth.uniform(0.2, 0.6, n) * dq / speed + 0.1 * rated * truth.normal(size=n)
    tau += machine.rotor * np.diag(pin.crba(model, data, q[0])) * ddq
    tau += machine.ripple * size * np.sin(q / speed * 40.0 + truth.uniform(-np.pi, np.pi, n))
    white = rng.normal(size=tau.shape)
    slow_noise = np.cumsum(0.05 * rng.normal(size=tau.shape), axis=0)
    slow_noise -= np.linspace(0.0, 1.0, len(t))[:, None] * slow_noise[-1]
    tau += machine.noise * size * (white + 0.5 * slow_noise / slow_noise.std(axis=0))
    q = np.round((q + 1e-5 * rng.normal(size=q.shape)) / 2e-5) * 2e-5
    return Measurements(t, q, tau, None, None, ("simulated",))


def _bent(q: Array, travel: float) -> Array:
    """(N, n) bristles that bend over ``travel`` and then slide along."""
    z = np.zeros_like(q)
    for k, step in enumerate(np.diff(q, axis=0), start=1):
        way = np.sign(step)
        z[k] = way + (z[k - 1] - way) * np.exp(-np.abs(step) / travel)
    return z


def _rated(machine: Machine, model: object, pin: object) -> Array:
    """(n,) root mean square torque on a motion that is the same for every run of the machine."""
    t = np.arange(0.0, 10.0, 0.05)
    prismatic = [axis[0] == "prismatic" for axis in machine.axes]
    states = _motion(t, prismatic, np.random.default_rng(machine.seed))
    data = model.createData()  # type: ignore[attr-defined]
    tau = [pin.rnea(model, data, *state) for state in zip(*states, strict=True)]  # type: ignore[attr-defined]
    return np.asarray(np.std(tau, axis=0))


def _motion(t: Array, prismatic: list[bool], rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Six harmonics of 0.08 Hz about a drawn pose."""
    q, dq, ddq = mixture(t, np.where(prismatic, 0.1, 0.6), 6, 0.08, 0.2, rng)
    return q + np.where(prismatic, 0.0, rng.uniform(-0.5, 0.5, len(prismatic))), dq, ddq


def mixture(
    t: Array, reach: Array, count: int, hertz: float, least: float, rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """So many harmonics of a frequency, another mixture for each joint of its share from ``least`` to 1
    of its reach (n,)."""
    n = len(reach)
    q, dq, ddq = (np.zeros((len(t), n)) for _ in range(3))
    for harmonic in range(1, count + 1):
        w = 2.0 * np.pi * hertz * harmonic
        a, phase = reach * harmonic**-0.7 * rng.uniform(least, 1.0, n), rng.uniform(-np.pi, np.pi, n)
        q += a * np.sin(w * t[:, None] + phase)
        dq += a * w * np.cos(w * t[:, None] + phase)
        ddq -= a * w**2 * np.sin(w * t[:, None] + phase)
    return q, dq, ddq
