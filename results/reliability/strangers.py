"""Logs of arms that no threshold was set on, each with its right answer: Pinocchio,
MuJoCo and NumPy alone.

Arms of three to seven joints are drawn; Panda, UR10e and iiwa have their kinematics, and
drawn links. What the model of the check lacks is the point: laws of friction, springs,
ripple, warming, hysteresis, coloured noise, coarse encoders, a drive's few milliseconds.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

Array = NDArray[np.float64]
Rng = np.random.Generator
DOWN = np.array([0.0, 0.0, -9.81])
#: Origins "x y z", "roll pitch yaw" of the joints of arms that are made (all about z).
H = "1.5707963"
KNOWN = {
    "panda": [
        ("0 0 .333", "0 0 0"),
        ("0 0 0", f"-{H} 0 0"),
        ("0 -.316 0", f"{H} 0 0"),
        (".0825 0 0", f"{H} 0 0"),
        ("-.0825 .384 0", f"-{H} 0 0"),
        ("0 0 0", f"{H} 0 0"),
        (".088 0 0", f"{H} 0 0"),
    ],
    "ur10e": [
        ("0 0 .1807", "0 0 0"),
        ("0 0 0", f"{H} 0 0"),
        ("-.6127 0 0", "0 0 0"),
        ("-.57155 0 .17415", "0 0 0"),
        ("0 -.11985 0", f"{H} 0 0"),
        ("0 .11655 0", f"-{H} 0 0"),
    ],
    "iiwa": [
        ("0 0 .1575", "0 0 0"),
        ("0 0 .2025", f"{H} 0 3.1415927"),
        ("0 .2045 0", f"{H} 0 3.1415927"),
        ("0 0 .2155", f"{H} 0 0"),
        ("0 .1845 0", f"-{H} 3.1415927 0"),
        ("0 0 .2155", f"{H} 0 0"),
        ("0 .081 0", f"-{H} 3.1415927 0"),
    ],
}
MASSES = {
    "panda": [3.0, 2.9, 3.2, 2.9, 3.3, 1.6, 1.2],
    "ur10e": [7.4, 13.1, 4.0, 2.1, 2.0, 0.6],
    "iiwa": [5.8, 6.4, 3.5, 3.5, 3.5, 1.8, 1.2],
}


@dataclass
class Run:
    """One recording: (N,) s, (N, n) states and torques."""

    t: Array
    q: Array
    dq: Array
    ddq: Array
    tau: Array


@dataclass
class Arm:
    """One machine: links and laws that no file tells."""

    name: str
    seed: int
    rng: Rng = field(init=False)

    def __post_init__(self) -> None:
        """Draw links, what they differ by from the URDF, friction and sensors."""
        rng = self.rng = np.random.default_rng([self.seed, *self.name.encode()])
        draw = rng.uniform
        self.origins = KNOWN.get(self.name) or list(_origins(rng))
        n = self.n = len(self.origins)
        self.slides = np.zeros(n, bool)
        self.axes = ["0 0 1"] * n
        if self.name not in KNOWN:
            self.slides[0] = draw() < 0.12
            turned = [str(rng.choice(["0 1 0", "0 1 0", "1 0 0", "0 0 1"]))] * (n - 1)
            for k in range(1, n - 1):
                turned[k] = str(rng.choice(["0 1 0", "1 0 0", "0 0 1"]))
            self.axes = ["0 0 1", *turned]
        masses = MASSES.get(self.name) or [9.0 * 0.68**k for k in range(n)]
        self.masses = np.array(masses) * draw(0.8, 1.25, n)
        self.urdf = self._urdf()
        self.model = pin.buildModelFromXML(self.urdf)
        for inertia in list(self.model.inertias)[1:]:
            inertia.mass *= draw(0.75, 1.3)
            inertia.lever = inertia.lever + 0.012 * rng.normal(size=3)
            inertia.inertia = inertia.inertia * draw(0.7, 1.4)
        self.rate = float(rng.choice([100.0, 125.0, 200.0, 250.0]))
        self.seconds = draw(12.0, 24.0)
        self.size, self.speed = np.ones(n), np.ones(n)
        plan = self._plan()
        rigid = self.rigid(plan.q, plan.dq, plan.ddq)
        size = rigid.std(0)
        self.size = np.maximum(size, 0.05 * size.max())
        self.speed = plan.dq.std(0)
        self.mirror = np.diag(self._inertia(plan.q[0]))
        self.coulomb = self.size * draw(0.03, 0.25) * draw(0.6, 1.5, n)
        self.viscous = self.size / self.speed * draw(0.02, 0.12) * draw(0.6, 1.5, n)
        self.rotor = self.mirror * draw(0.05, 1.2, n)
        self.width = self.speed * draw(0.005, 0.1)
        self.laws = [law for law in LAWS if draw() < 0.45]
        self.size_of_law = {law: draw(0.2, 1.0, n) for law in LAWS}
        self.phase = draw(-np.pi, np.pi, n)
        self.noise = self.size * 10 ** draw(-2.7, -1.5)
        self.colour = rng.choice([0.0, 0.0, 0.02, 0.08])
        self.step = 10 ** draw(-6.0, -3.7)
        self.late = rng.choice([0.0, 0.0, draw(0.001, 0.004)])
        self.by_mujoco = self.seed % 3 == 0

    def _urdf(self) -> str:
        """Return the URDF of nominal links, boxes about the line to the next joint."""
        rng = self.rng
        parts = ['<link name="l0"/>']
        for k, (place, turn) in enumerate(self.origins):
            after = self.origins[k + 1][0] if k + 1 < self.n else "0 0 .08"
            away = np.array([float(x) for x in after.split()])
            com = 0.45 * away + rng.uniform(-0.03, 0.03, 3)
            m, reach = self.masses[k], max(float(np.linalg.norm(away)), 0.1)
            i = m * reach**2 * rng.uniform(0.08, 0.15, 3)
            i = np.maximum(i, 0.6 * i.max())
            kind = "prismatic" if self.slides[k] else "revolute"
            limit = 0.5 if self.slides[k] else 3.0
            parts.append(
                f'<link name="l{k + 1}"><inertial><origin xyz="{com[0]:.4f}'
                f' {com[1]:.4f} {com[2]:.4f}"/><mass value="{m:.4f}"/><inertia'
                f' ixx="{i[0]:.6f}" iyy="{i[1]:.6f}" izz="{i[2]:.6f}" ixy="0" ixz="0"'
                f' iyz="0"/></inertial></link><joint name="j{k + 1}" type="{kind}">'
                f'<parent link="l{k}"/><child link="l{k + 1}"/><origin xyz="{place}"'
                f' rpy="{turn}"/><axis xyz="{self.axes[k]}"/><limit lower="{-limit}"'
                f' upper="{limit}" velocity="6" effort="600"/></joint>'
            )
        return f'<robot name="{self.name}">{"".join(parts)}</robot>'

    def _inertia(self, q: Array) -> Array:
        return np.array(pin.crba(self.model, self.model.createData(), q))

    def _plan(self) -> Run:
        """Draw a motion: harmonics of one base or none, or moves between points."""
        rng, n = self.rng, self.n
        t = np.arange(0.0, self.seconds, 1.0 / self.rate)
        reach = np.where(self.slides, 0.15, rng.uniform(0.5, 1.2, n))
        centre = 0.4 * reach * rng.uniform(-1.0, 1.0, n)
        if rng.random() < 0.25:
            q = _moves(t, n, rng)
            q = centre + reach * q
            dq = np.gradient(q, t, axis=0)
            return Run(t, q, dq, np.gradient(dq, t, axis=0), 0.0 * q)
        k = np.arange(1, 6)[:, None] * np.ones(n)
        w = 2.0 * np.pi * rng.uniform(0.08, 0.14) * k
        if rng.random() < 0.5:
            w = w * rng.uniform(0.7, 1.3, w.shape)
        size, phase = rng.uniform(0.3, 1.0, w.shape), rng.uniform(-3.2, 3.2, w.shape)
        size = size / np.sqrt(k)
        angle = w * t[:, None, None] + phase
        fit = reach / np.abs((size * np.sin(angle)).sum(1)).max(0)
        q = centre + fit * (size * np.sin(angle)).sum(1)
        dq = fit * (size * w * np.cos(angle)).sum(1)
        return Run(t, q, dq, -fit * (size * w**2 * np.sin(angle)).sum(1), 0.0 * q)

    def rigid(
        self, q: Array, dq: Array, ddq: Array, gravity: Array = DOWN, load: float = 0.0
    ) -> Array:
        """Return the torque (N, n) of the links, and of a load of so many kg."""
        model = pin.Model(self.model)
        model.gravity.linear = gravity
        if load:
            place = pin.SE3(np.eye(3), np.array([0.05, 0.04, 0.12]))
            model.appendBodyToJoint(self.n, pin.Inertia.FromSphere(load, 0.05), place)
        data = model.createData()
        return np.array(
            [pin.rnea(model, data, *x) for x in zip(q, dq, ddq, strict=True)]
        )

    def rub(self, q: Array, v: Array, t: Array, dynamic: Array | None = None) -> Array:
        """Return the torque (N, n) of joints alone, rotors left out."""
        sign = np.tanh(v / self.width)
        dry, oil = self.coulomb * sign, self.viscous * v
        more = np.zeros_like(v)
        for law in self.laws:
            more = more + self.size_of_law[law] * LAWS[law](self, q, v, t, dry, oil)
        if dynamic is not None and "load" in self.laws:
            of_load = np.abs(dynamic) / self.size
            more = more + 0.3 * self.size_of_law["load"] * of_load * dry
        return dry + oil + more

    def record(self) -> Run:
        """Record a motion, by MuJoCo under a controller or along the plan exactly."""
        plan = self._plan()
        run = self._driven(plan) if self.by_mujoco else self._along(plan)
        rng = self.rng
        white = rng.normal(size=run.tau.shape)
        if self.colour:
            keep = np.exp(-1.0 / (self.rate * self.colour))
            for k in range(1, len(white)):
                white[k] = keep * white[k - 1] + np.sqrt(1.0 - keep**2) * white[k]
        tau = run.tau + self.noise * white
        for j in range(self.n):
            tau[:, j] = np.interp(run.t - self.late, run.t, tau[:, j])
        q = np.round(run.q / self.step) * self.step
        return replace(run, q=q, tau=tau)

    def _along(self, plan: Run) -> Run:
        dynamic = self.rigid(plan.q, plan.dq, plan.ddq)
        tau = dynamic + self.rotor * plan.ddq
        tau = tau + self.rub(plan.q, plan.dq, plan.t[:, None], dynamic)
        if "hysteresis" in self.laws:
            bent = np.zeros(self.n)
            travel = 0.08 * self.size_of_law["hysteresis"]
            for k, step in enumerate(np.diff(plan.q, axis=0)):
                bent = np.clip(bent + step / travel, -1.0, 1.0)
                tau[k + 1] += 0.4 * self.coulomb * bent
        return replace(plan, tau=tau)

    def _driven(self, plan: Run) -> Run:
        true = mujoco.MjModel.from_xml_string(self.urdf)
        step = 1.0 / self.rate
        n_sub = int(np.ceil(step / 1e-3))
        true.opt.timestep = step / n_sub
        true.jnt_limited[:] = False
        true.dof_armature[:] = self.rotor
        for k in range(self.n):
            own = self.model.inertias[k + 1]
            true.body_mass[k + 1] = own.mass
            true.body_ipos[k + 1] = own.lever
            values, turn = np.linalg.eigh(own.inertia)
            turn[:, 0] *= np.sign(np.linalg.det(turn))
            true.body_inertia[k + 1] = values
            mujoco.mju_mat2Quat(true.body_iquat[k + 1], turn.ravel())
        mujoco.mj_setConst(true, mujoco.MjData(true))
        data = mujoco.MjData(true)
        data.qpos[:], data.qvel[:] = plan.q[0], plan.dq[0]
        mass = self.mirror + self.rotor
        ahead = self.rigid(plan.q, plan.dq, plan.ddq) * 0.97 + self.rotor * plan.ddq
        ahead = ahead + self.coulomb * np.tanh(plan.dq / self.width / 3.0)
        rows = []
        for k, t in enumerate(plan.t):
            error, slip = plan.q[k] - data.qpos, plan.dq[k] - data.qvel
            command = ahead[k] + mass * (400.0 * error + 40.0 * slip)
            rows.append((data.qpos.copy(), data.qvel.copy(), command))
            for _ in range(n_sub):
                rub = self.rub(data.qpos, data.qvel, np.array([t]))
                data.qfrc_applied[:] = command - rub
                mujoco.mj_step(true, data)
        q, dq, tau = (np.array(x) for x in zip(*rows, strict=True))
        # The command is held until the next row: half a row late.
        tau = 0.5 * (tau + np.vstack([tau[:1], tau[:-1]]))
        return Run(plan.t, q, dq, np.gradient(dq, plan.t, axis=0), tau)


def _origins(rng: Rng) -> Iterator[tuple[str, str]]:
    """Yield the origins of a drawn arm of three to seven joints."""
    for k in range(int(rng.integers(3, 8))):
        along = np.eye(3)[rng.integers(3)] if k else np.array([0.0, 0.0, 1.0])
        place = rng.uniform(0.12, 0.4) * 0.92**k * along
        yield " ".join(f"{x:.4f}" for x in place), "0 0 0"


def _moves(t: Array, n: int, rng: Rng) -> Array:
    """Return moves (N, n) between points within -1 to 1, each as fast as the last."""
    q = np.zeros((len(t), n))
    begin, at = 0.0, rng.uniform(-1.0, 1.0, n)
    while begin < t[-1]:
        long, rest = rng.uniform(1.0, 2.0), rng.uniform(0.0, 0.4)
        to = rng.uniform(-1.0, 1.0, n)
        x = np.clip((t - begin) / long, 0.0, 1.0)[:, None]
        now = at + (to - at) * (10.0 * x**3 - 15.0 * x**4 + 6.0 * x**5)
        q[t >= begin] = now[t >= begin]
        begin, at = begin + long + rest, to
    return q


#: Laws that the check's model lacks, of size one, by position, velocity, time, dry and
#: viscous friction.
LAWS: dict[str, Callable[[Arm, Array, Array, Array, Array, Array], Array]] = {
    "stribeck": lambda a, q, v, t, dry, oil: (
        0.6 * dry * np.exp(-((v / a.speed / 0.15) ** 2))
    ),
    "asymmetry": lambda a, q, v, t, dry, oil: 0.2 * np.abs(dry),
    "cubic": lambda a, q, v, t, dry, oil: (
        -0.3 * oil * np.minimum(np.abs(v / a.speed), 3.0) / 2
    ),
    "ripple": lambda a, q, v, t, dry, oil: 0.02 * a.size * np.sin(40.0 * q + a.phase),
    "spring": lambda a, q, v, t, dry, oil: (
        0.06 * a.size * q * (np.arange(a.n) == a.n // 2)
    ),
    "warming": lambda a, q, v, t, dry, oil: -0.3 * oil * (1.0 - np.exp(-t / 15.0)),
    "magnet": lambda a, q, v, t, dry, oil: 0.02 * a.size * np.sin(3.0 * q + a.phase),
    "load": lambda a, q, v, t, dry, oil: 0.0 * v,
    "hysteresis": lambda a, q, v, t, dry, oil: 0.0 * v,
}


@dataclass(frozen=True)
class Log:
    """What was done to recordings, and the kinds and joints (from 1) that name it."""

    change: str
    size: str
    kinds: tuple[str, ...]
    joints: tuple[int, ...]
    runs: tuple[Run, ...]


#: A change: of an arm, its runs (which it may change) and a joint; its size, the kinds
#: that name it, and the joints.
Change = Callable[[Arm, list[Run], int, Rng], tuple[str, str, tuple[int, ...]]]
CHANGES: dict[str, Change] = {}


def change(make: Change) -> Change:
    """Register a change by its name."""
    CHANGES[make.__name__] = make
    return make


def _times(runs: list[Run], j: int, q: float, tau: float) -> None:
    for run in runs:
        run.q[:, j] *= q
        run.tau[:, j] *= tau


def _other(arm: Arm, j: int, rng: Rng) -> int:
    return int((j + rng.integers(1, arm.n)) % arm.n)


def _late(run: Run, j: int, seconds: float) -> None:
    run.tau[:, j] = np.interp(run.t - seconds, run.t, run.tau[:, j])


@change
def torque_sign(arm: Arm, runs: list[Run], j: int, rng: Rng):
    _times(runs, j, 1.0, -1.0)
    return "", "torque sign", (j,)


@change
def joint_sign(arm: Arm, runs: list[Run], j: int, rng: Rng):
    _times(runs, j, -1.0, -1.0)
    return "", "joint sign", (j,)


@change
def position_sign(arm: Arm, runs: list[Run], j: int, rng: Rng):
    _times(runs, j, -1.0, 1.0)
    return "", "position sign", (j,)


@change
def all_signs(arm: Arm, runs: list[Run], j: int, rng: Rng):
    for k in range(arm.n):
        _times(runs, k, 1.0, -1.0)
    return "", "torque sign", ()


@change
def torques_swapped(arm: Arm, runs: list[Run], j: int, rng: Rng):
    k = _other(arm, j, rng)
    for run in runs:
        run.tau[:, [j, k]] = run.tau[:, [k, j]]
    return "", "torque order", (j, k)


@change
def joints_swapped(arm: Arm, runs: list[Run], j: int, rng: Rng):
    k = _other(arm, j, rng)
    for run in runs:
        run.tau[:, [j, k]] = run.tau[:, [k, j]]
        run.q[:, [j, k]] = run.q[:, [k, j]]
    return "", "joint order", (j, k)


@change
def positions_swapped(arm: Arm, runs: list[Run], j: int, rng: Rng):
    k = _other(arm, j, rng)
    for run in runs:
        run.q[:, [j, k]] = run.q[:, [k, j]]
    return "", "position order", (j, k)


@change
def torque_gain(arm: Arm, runs: list[Run], j: int, rng: Rng):
    gain = float(np.exp(rng.choice([-1.0, 1.0]) * rng.uniform(0.08, 0.9)))
    _times(runs, j, 1.0, gain)
    return f"{gain:.3g}", "torque gain|torque unit", (j,)


@change
def torque_unit(arm: Arm, runs: list[Run], j: int, rng: Rng):
    _times(runs, j, 1.0, 100.0)
    return "", "torque gain|torque unit", (j,)


@change
def gear_ratio(arm: Arm, runs: list[Run], j: int, rng: Rng):
    ratio = float(rng.choice([0.6, 0.75, 1.4, 1.6]))
    _times(runs, j, ratio, 1.0 / ratio)
    return f"{ratio:.3g}", "gear ratio", (j,)


@change
def torques_late(arm: Arm, runs: list[Run], j: int, rng: Rng):
    late = float(rng.choice([-1.0, 1.0, 1.0]) * rng.uniform(0.012, 0.06))
    for run in runs:
        for k in range(arm.n):
            _late(run, k, late)
    return f"{late:.3g}", "delay|torque filter", ()


@change
def torque_late(arm: Arm, runs: list[Run], j: int, rng: Rng):
    late = float(rng.uniform(0.012, 0.08))
    for run in runs:
        _late(run, j, late)
    return f"{late:.3g}", "channel delay|channel filter", (j,)


@change
def torque_filter(arm: Arm, runs: list[Run], j: int, rng: Rng):
    lag = float(rng.uniform(0.015, 0.12))
    for run in runs:
        keep, y = np.exp(-1.0 / (arm.rate * lag)), run.tau[:, j].copy()
        for k in range(1, len(y)):
            y[k] = keep * y[k - 1] + (1.0 - keep) * y[k]
        run.tau[:, j] = y
    return f"{lag:.3g}", "channel delay|channel filter", (j,)


@change
def zero(arm: Arm, runs: list[Run], j: int, rng: Rng):
    j = max(j, 1)
    turn = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.03, 0.6))
    turn = float(rng.choice([turn, turn, np.pi / 2, -np.pi / 2]))
    for run in runs:
        run.q[:, j] += turn
    return f"{turn:.3g}", "encoder offset", (j,)


@change
def mounting(arm: Arm, runs: list[Run], j: int, rng: Rng):
    g = rng.normal(size=3)
    g = [np.array([0.0, 9.81, 0.0]), -DOWN, 9.81 * g / np.linalg.norm(g)][
        rng.integers(3)
    ]
    for run in runs:
        still = 0.0 * run.q
        run.tau += arm.rigid(run.q, still, still, g) - arm.rigid(run.q, still, still)
    return "", "gravity direction|encoder offset", ()


@change
def weight_subtracted(arm: Arm, runs: list[Run], j: int, rng: Rng):
    for run in runs:
        run.tau -= arm.rigid(run.q, 0.0 * run.q, 0.0 * run.q)
    return "", "gravity removed", ()


@change
def friction_subtracted(arm: Arm, runs: list[Run], j: int, rng: Rng):
    for run in runs:
        run.tau -= 1.15 * arm.rub(run.q, run.dq, run.t[:, None])
    return "", "friction compensated", ()


@change
def clock(arm: Arm, runs: list[Run], j: int, rng: Rng):
    rate = float(rng.choice([0.5, 0.7, 0.8, 1.25, 1.5, 2.0]))
    for k, run in enumerate(runs):
        runs[k] = replace(run, t=run.t * rate)
    return f"{rate:.3g}", "clock rate", ()


@change
def backwards(arm: Arm, runs: list[Run], j: int, rng: Rng):
    for k, run in enumerate(runs):
        runs[k] = replace(run, q=run.q[::-1].copy(), tau=run.tau[::-1].copy())
    return "", "time reversed", ()


@change
def degrees(arm: Arm, runs: list[Run], j: int, rng: Rng):
    for run in runs:
        run.q[:, ~arm.slides] = np.degrees(run.q[:, ~arm.slides])
    return "", "positions in degrees|position range|position unit", ()


@change
def saturation(arm: Arm, runs: list[Run], j: int, rng: Rng):
    share = float(rng.uniform(0.4, 0.8))
    limit = share * max(np.abs(run.tau[:, j]).max() for run in runs)
    for run in runs:
        run.tau[:, j] = limit * np.tanh(run.tau[:, j] / limit)
    return f"{share:.3g}", "saturation|torque gain", (j,)


@change
def step(arm: Arm, runs: list[Run], j: int, rng: Rng):
    run, share = runs[0], float(rng.uniform(0.15, 1.2))
    run.tau[:, j] += share * arm.size[j] * (run.t > rng.uniform(0.35, 0.65) * run.t[-1])
    return f"{share:.3g}", "torque step|torque drift", (j,)


@change
def drift(arm: Arm, runs: list[Run], j: int, rng: Rng):
    share = float(rng.uniform(0.15, 1.2))
    for run in runs:
        run.tau[:, j] += share * arm.size[j] * run.t / run.t[-1]
    return f"{share:.3g}", "torque drift|torque step", (j,)


LOADS = "another load|another arm|change within the run"


@change
def load_in_a_run(arm: Arm, runs: list[Run], j: int, rng: Rng):
    run, mass = runs[-1], float(arm.masses.sum() * rng.uniform(0.01, 0.12))
    states = run.q, run.dq, run.ddq
    run.tau += arm.rigid(*states, load=mass) - arm.rigid(*states)
    return f"{mass:.3g}", LOADS, ()


@change
def gain_in_a_run(arm: Arm, runs: list[Run], j: int, rng: Rng):
    gain = float(np.exp(rng.choice([-1.0, 1.0]) * rng.uniform(0.07, 0.5)))
    _times(runs[-1:], j, 1.0, gain)
    return f"{gain:.3g}", "torque gain", (j,)


@change
def zero_in_a_run(arm: Arm, runs: list[Run], j: int, rng: Rng):
    turn = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.03, 0.3))
    runs[-1].q[:, j] += turn
    return f"{turn:.3g}", "encoder offset", (j,)


@change
def sign_in_a_run(arm: Arm, runs: list[Run], j: int, rng: Rng):
    _times(runs[-1:], j, 1.0, -1.0)
    return "", "torque sign", (j,)


@change
def delay_in_a_run(arm: Arm, runs: list[Run], j: int, rng: Rng):
    late = float(rng.uniform(0.025, 0.1))
    for k in range(arm.n):
        _late(runs[-1], k, late)
    return f"{late:.3g}", "delay", ()


@change
def motor_on_the_base(arm: Arm, runs: list[Run], j: int, rng: Rng):
    free = [k for k in range(1, arm.n) if not arm.slides[k - 1]]
    j, turn = int(rng.choice(free)), float(rng.choice([-1.0, 1.0]))
    for run in runs:
        run.q[:, j] += turn * run.q[:, j - 1]
        run.tau[:, j - 1] -= turn * run.tau[:, j]
    return f"{turn:g}", "motor on the base", (j,)


@change
def push(arm: Arm, runs: list[Run], j: int, rng: Rng):
    run, seconds = runs[0], float(rng.uniform(0.5, 3.0))
    force = rng.normal(size=3)
    force *= rng.uniform(0.05, 0.5) * 9.81 * arm.masses.sum() / np.linalg.norm(force)
    begin = rng.uniform(0.2, 0.7) * run.t[-1]
    data = arm.model.createData()
    for k in np.flatnonzero((run.t > begin) & (run.t < begin + seconds)):
        jacobian = pin.computeJointJacobian(arm.model, data, run.q[k], arm.n)[:3]
        run.tau[k] -= jacobian.T @ (data.oMi[arm.n].rotation.T @ force)
    return f"{seconds:.3g}", "passing force|one-off event", ()


#: Changes that are no fault of a log: effects of an arm, which resemble one.
@change
def force(arm: Arm, runs: list[Run], j: int, rng: Rng):
    push = 30.0 * rng.normal(size=3)
    data, last = arm.model.createData(), arm.n
    for run in runs:
        for k, q in enumerate(run.q):
            jacobian = pin.computeJointJacobian(arm.model, data, q, last)[:3]
            turn = data.oMi[last].rotation
            run.tau[k] += jacobian.T @ (turn.T @ push)
    return "", "", ()


@change
def coupling(arm: Arm, runs: list[Run], j: int, rng: Rng):
    j, ratio = min(j, arm.n - 2), float(rng.uniform(0.3, 1.0))
    for run in runs:
        run.tau[:, j] -= ratio * run.tau[:, j + 1]
    return f"{ratio:.3g}", "", ()


#: Facts of a file.
@change
def frozen_torque(arm: Arm, runs: list[Run], j: int, rng: Rng):
    run = runs[0]
    a = int(0.4 * len(run.t))
    run.tau[a : a + int(rng.uniform(0.8, 3.0) * arm.rate), j] = run.tau[a, j]
    return "", "frozen torque|stale channel|saturation", (j,)


@change
def frozen_position(arm: Arm, runs: list[Run], j: int, rng: Rng):
    run = runs[0]
    a = int(0.4 * len(run.t))
    run.q[a : a + int(rng.uniform(0.8, 3.0) * arm.rate), j] = run.q[a, j]
    return "", "frozen position|stale channel", (j,)


@change
def zeros(arm: Arm, runs: list[Run], j: int, rng: Rng):
    for k in rng.integers(50, len(runs[0].t) - 50, 5).tolist():
        runs[0].tau[k : k + int(rng.integers(1, 6)), j] = 0.0
    return "", "zeros|spikes|drive off", (j,)


@change
def spikes(arm: Arm, runs: list[Run], j: int, rng: Rng):
    for k in rng.integers(50, len(runs[0].t) - 50, 4).tolist():
        runs[0].q[k, j] += 1.0
    return "", "spikes|wrapped angle", (j,)


@change
def lost_rows(arm: Arm, runs: list[Run], j: int, rng: Rng):
    run, keep = runs[0], np.ones(len(runs[0].t), bool)
    for share in (0.2, 0.45, 0.7):
        a = int(share * len(keep))
        keep[a : a + int(0.5 * arm.rate)] = False
    t = run.t[: keep.sum()]
    runs[0] = Run(t, *(x[keep] for x in (run.q, run.dq, run.ddq, run.tau)))
    return "", "lost rows|one-off event", ()


@change
def packets_held(arm: Arm, runs: list[Run], j: int, rng: Rng):
    run = runs[0]
    for share in (0.25, 0.5, 0.75):
        a = int(share * len(run.t))
        rows = slice(a, a + int(0.3 * arm.rate))
        run.q[rows], run.tau[rows] = run.q[a], run.tau[a]
    return "", "frozen packets|frozen position|frozen torque", ()


@change
def rows_twice(arm: Arm, runs: list[Run], j: int, rng: Rng):
    run = runs[0]
    t = np.arange(2 * len(run.t)) / arm.rate
    runs[0] = Run(t, *(np.vstack([x, x]) for x in (run.q, run.dq, run.ddq, run.tau)))
    return "", "repeated run", ()


@change
def clock_jump(arm: Arm, runs: list[Run], j: int, rng: Rng):
    jump = float(rng.choice([-1.5, 1.5]))
    runs[0].t[len(runs[0].t) // 2 :] += jump
    return f"{jump}", "clock step|time runs backwards", ()


@change
def milliseconds(arm: Arm, runs: list[Run], j: int, rng: Rng):
    for k, run in enumerate(runs):
        runs[k] = replace(run, t=1e3 * run.t)
    return "", "time unit|static poses", ()


def logs_of(name: str, seed: int, count: int) -> Iterator[tuple[Arm, Log]]:
    """Yield logs of one machine, of one run or of two: those to which nothing was done,
    and so many with another change each."""
    arm = Arm(name, seed)
    recorded = [arm.record(), arm.record()]
    rng = np.random.default_rng([seed, 7])
    for runs in (recorded[:1], recorded):
        yield arm, Log("clean", "", (), (), tuple(runs))
    for word in rng.permutation([*CHANGES])[:count].tolist():
        runs = [replace(x, **_copies(x)) for x in recorded]
        if not word.endswith("_a_run") and rng.random() < 0.6:
            runs = runs[:1]
        size, kinds, joints = CHANGES[word](arm, runs, int(rng.integers(arm.n)), rng)
        kinds_ = tuple(x for x in kinds.split("|") if x)
        yield arm, Log(word, size, kinds_, tuple(j + 1 for j in joints), tuple(runs))


def _copies(run: Run) -> dict[str, Array]:
    return {name: values.copy() for name, values in vars(run).items()}


def write_urdf(arm: Arm, folder: Path) -> Path:
    """Write the URDF of nominal links."""
    path = folder / f"{arm.name}-{arm.seed}.urdf"
    path.write_text(arm.urdf, encoding="utf-8")
    return path
