"""Everyday situations of a log, each a kind with its right answer: what users do and
what their controllers and loggers do.

Pinocchio and NumPy alone: nothing here shares code with what is judged. Each situation
is a function of a drawn arm and its recordings; its docstring is what happened.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from bench.truth import Truth, write_log

Array = NDArray[np.float64]
RATE = 100.0
SECONDS = 15.0
GRAVITY = np.array([0.0, 0.0, -9.81])


@dataclass
class Run:
    """One recording, before anything is done to it: (N,) s, (N, n) states, torques."""

    t: Array
    q: Array
    dq: Array
    ddq: Array
    tau: Array
    more: dict[str, Array] = field(default_factory=dict)

    def columns(self) -> dict[str, Array]:
        """Return what a logger writes: t, q, tau, and more channels by their names."""
        named = {"t": self.t}
        for name, values in (("q", self.q), ("tau", self.tau)):
            named |= {f"{name}{j + 1}": x for j, x in enumerate(values.T)}
        return named | self.more


@dataclass
class Arm:
    """A drawn arm of three joints, whose true links no file tells."""

    rng: np.random.Generator
    prismatic: bool = False

    def __post_init__(self) -> None:
        """Draw links, friction and noise."""
        draw = self.rng.uniform
        masses = np.array([4.0, 3.0, 1.5]) * draw(0.7, 1.4, 3)
        lengths = np.array([0.2, 0.4, 0.3]) * draw(0.8, 1.2, 3)
        coms = [
            (0.01, 0.0, 0.5 * lengths[0]),
            (0.5 * lengths[1], 0.02 * draw(), 0.0),
            (0.5 * lengths[2], 0.0, 0.02 * draw()),
        ]
        axes = ("0 0 1", "0 1 0", "0 1 0")
        kinds = ("prismatic" if self.prismatic else "revolute", "revolute", "revolute")
        places = ("0 0 0.3", f"0 0 {lengths[0]:.4f}", f"{lengths[1]:.4f} 0 0")
        parts = ['<link name="l0"/>']
        for k in range(3):
            m, c = masses[k], coms[k]
            i = m * lengths[k] ** 2 / 10.0
            reach = 0.4 if kinds[k] == "prismatic" else 3.0
            parts.append(
                f'<link name="l{k + 1}"><inertial><origin xyz="{c[0]:.4f} {c[1]:.4f}'
                f' {c[2]:.4f}"/><mass value="{m:.4f}"/><inertia ixx="{i:.5f}"'
                f' iyy="{1.3 * i:.5f}" izz="{0.9 * i:.5f}" ixy="0" ixz="0" iyz="0"/>'
                f'</inertial></link><joint name="j{k + 1}" type="{kinds[k]}"><parent'
                f' link="l{k}"/><child link="l{k + 1}"/><origin xyz="{places[k]}"/><axis'
                f' xyz="{axes[k]}"/><limit lower="{-reach}" upper="{reach}"'
                ' velocity="4" effort="90"/></joint>'
            )
        self.urdf = f'<robot name="arm3">{"".join(parts)}</robot>'
        self.model = pin.buildModelFromXML(self.urdf)
        for inertia in list(self.model.inertias)[1:]:
            inertia.mass *= draw(1.1, 1.3)
            inertia.lever = inertia.lever + 0.01 * self.rng.normal(size=3)
        size = np.array([8.0, 20.0, 6.0])
        self.coulomb = 0.06 * size * draw(0.7, 1.4, 3)
        self.viscous = 0.06 * size * draw(0.7, 1.4, 3)
        self.rotor = np.array([0.08, 0.1, 0.03]) * draw(0.5, 1.5, 3)
        self.noise = 0.004 * size

    def motion(self, gravity: Array = GRAVITY, seconds: float = SECONDS) -> Run:
        """Draw a motion of five harmonics of .12 Hz at most 1.2 rad from its centre."""
        t = np.arange(0.0, seconds, 1.0 / RATE)
        reach = np.array([0.25 if self.prismatic else 1.0, 1.0, 1.0])
        w = 2.0 * np.pi * 0.12 * np.arange(1, 6)[:, None]
        size = reach * self.rng.uniform(0.3, 1.0, (5, 3)) / np.arange(1, 6)[:, None]
        angle = w * t[:, None, None] + self.rng.uniform(-np.pi, np.pi, (5, 3))
        q = (size * np.sin(angle)).sum(1) + 0.3 * reach * self.rng.uniform(-1, 1, 3)
        dq = (size * w * np.cos(angle)).sum(1)
        ddq = -(size * w**2 * np.sin(angle)).sum(1)
        return self.along(t, q, dq, ddq, gravity)

    def along(
        self, t: Array, q: Array, dq: Array, ddq: Array, gravity: Array = GRAVITY
    ) -> Run:
        """Return a motion with its torque, noise of torque and encoder steps."""
        tau = self.rigid(q, dq, ddq, gravity) + self.friction(dq) + self.rotor * ddq
        tau += self.noise * self.rng.normal(size=tau.shape)
        return Run(t, np.round(q / 2e-5) * 2e-5, dq, ddq, tau)

    def rigid(
        self, q: Array, dq: Array, ddq: Array, gravity: Array = GRAVITY, tool: float = 0
    ) -> Array:
        """Return the torque (N, n) of the links, with a tool of so many kg or without."""
        model = pin.Model(self.model)
        model.gravity.linear = gravity
        if tool:
            at_tool = pin.SE3(np.eye(3), np.array([0.35, 0.03, 0.04]))
            model.appendBodyToJoint(3, pin.Inertia.FromSphere(tool, 0.05), at_tool)
        data = model.createData()
        rows = zip(q, dq, ddq, strict=True)
        return np.array([pin.rnea(model, data, *row) for row in rows])

    def load(self, run: Run, mass: float, still: bool = False) -> Array:
        """Return the torque (N, n) of a tool, of its weight alone if still."""
        moving = 0.0 if still else 1.0
        states = run.q, moving * run.dq, moving * run.ddq
        return self.rigid(*states, tool=mass) - self.rigid(*states)

    def weight(self, q: Array, gravity: Array = GRAVITY) -> Array:
        """Return the torque (N, n) of gravity."""
        return self.rigid(q, 0.0 * q, 0.0 * q, gravity)

    def friction(self, dq: Array, width: float = 0.01) -> Array:
        """Return viscous and dry friction (N, n), which turns round within a width."""
        return self.coulomb * np.tanh(dq / width) + self.viscous * dq


#: A situation: changes the runs in place, and returns what is right to say.
Situation = Callable[[Arm, list[Run]], Truth]
SITUATIONS: dict[str, Situation] = {}


def situation(make: Situation) -> Situation:
    """Register a situation by its name."""
    SITUATIONS[make.__name__] = make
    return make


def each(runs: list[Run], change: Callable[[Run], None]) -> None:
    """Do the same to every run; the last one is kept to judge with."""
    for run in runs:
        change(run)


@situation
def clean(arm: Arm, runs: list[Run]) -> Truth:
    """Nothing."""
    return Truth("", silent=True)


@situation
def friction_law(arm: Arm, runs: list[Run]) -> Truth:
    """Dry friction turns round within .08 rad/s, not at once."""

    def change(run: Run) -> None:
        run.tau += arm.friction(run.dq, 0.08) - arm.friction(run.dq)

    each(runs, change)
    return Truth("coulomb.*v_s|re-estimate", silent=True)


@situation
def tool_weight_subtracted(arm: Arm, runs: list[Run]) -> Truth:
    """The controller subtracts the weight of the .6 kg tool that it carries."""

    def change(run: Run) -> None:
        run.tau += arm.load(run, 0.6) - arm.load(run, 0.6, still=True)

    each(runs, change)
    return Truth(r"tool|load|weight|gravity.*(subtract|remov|compensat)")


@situation
def friction_overcompensated(arm: Arm, runs: list[Run]) -> Truth:
    """The controller subtracts 1.1 times the friction."""

    def change(run: Run) -> None:
        run.tau -= 1.1 * arm.friction(run.dq)

    each(runs, change)
    return Truth("friction.*(compensat|subtract|negative)|negative friction")


@situation
def friction_compensated(arm: Arm, runs: list[Run]) -> Truth:
    """The controller subtracts the friction; nothing is wrong with that."""

    def change(run: Run) -> None:
        run.tau -= arm.friction(run.dq)

    each(runs, change)
    return Truth("friction.*(compensat|subtract|without)|no friction", silent=True)


@situation
def gravity_subtracted(arm: Arm, runs: list[Run]) -> Truth:
    """The controller subtracts the weight of all links."""

    def change(run: Run) -> None:
        run.tau -= arm.weight(run.q)

    each(runs, change)
    return Truth("gravity")


@situation
def reversed_rows(arm: Arm, runs: list[Run]) -> Truth:
    """The rows are in reverse order."""

    def change(run: Run) -> None:
        run.q, run.tau = run.q[::-1].copy(), run.tau[::-1].copy()

    each(runs, change)
    return Truth("revers|backward")


@situation
def reversal_forbidden(arm: Arm, runs: list[Run]) -> Truth:
    """Friction is subtracted 1.1 times, and the log has its own velocities."""
    friction_overcompensated(arm, runs)

    def change(run: Run) -> None:
        dq = run.dq + 1e-3 * arm.rng.normal(size=run.dq.shape)
        run.more |= {f"dq{j + 1}": x for j, x in enumerate(dq.T)}

    each(runs, change)
    return Truth("friction.*(compensat|subtract|negative)|negative friction")


@situation
def servo_off(arm: Arm, runs: list[Run]) -> Truth:
    """The drive of joint 3 is off in the second half: no torque, it moves on by hand."""

    def change(run: Run) -> None:
        run.tau[len(run.t) // 2 :, 2] = 0.0

    each(runs[:-1], change)
    return Truth("off|no torque|zero torque", joints=(3,))


@situation
def noise_free_periodic(arm: Arm, runs: list[Run]) -> Truth:
    """A simulator's log: no noise, and the motion has a period."""

    def change(run: Run) -> None:
        t = np.arange(0.0, 20.0, 1.0 / RATE)
        w = 2.0 * np.pi / 10.0 * np.arange(1, 4)[:, None]
        angle = w * t[:, None, None] + arm.rng.uniform(-np.pi, np.pi, (3, 3))
        size = 0.5 / np.arange(1, 4)[:, None]
        q = (size * np.sin(angle)).sum(1)
        dq = (size * w * np.cos(angle)).sum(1)
        ddq = -(size * w**2 * np.sin(angle)).sum(1)
        tau = arm.rigid(q, dq, ddq) + arm.friction(dq) + arm.rotor * ddq
        run.__init__(t, q, dq, ddq, tau)  # type: ignore[misc]

    each(runs, change)
    return Truth("noise|simulat|period", silent=True)


@situation
def static_poses(arm: Arm, runs: list[Run]) -> Truth:
    """One row a pose, 3.5 s apart."""

    def change(run: Run) -> None:
        q = arm.rng.uniform(-1.3, 1.3, (80, 3))
        still = 0.0 * q
        tau = arm.weight(q) + arm.noise * arm.rng.normal(size=q.shape)
        run.__init__(3.5 * np.arange(80.0), q, still, still, tau)  # type: ignore[misc]

    each(runs, change)
    return Truth("static|pose|still|low sample rate|too few", refuses=True, silent=True)


@situation
def one_way_motion(arm: Arm, runs: list[Run]) -> Truth:
    """Every joint turns one way, at nearly constant speed, for 4 s."""

    def change(run: Run) -> None:
        t = np.arange(0.0, 4.0, 1.0 / RATE)
        w = arm.rng.uniform(0.3, 0.6, 3)
        q = -1.0 + w * t[:, None] + 0.05 * np.sin(3.0 * t[:, None])
        dq = w + 0.15 * np.cos(3.0 * t[:, None])
        fresh = arm.along(t, q, dq, -0.45 * np.sin(3.0 * t[:, None]) + 0.0 * q)
        run.__init__(*(vars(fresh)[x] for x in ("t", "q", "dq", "ddq", "tau")))  # type: ignore[misc]

    each(runs, change)
    return Truth("excit|one way|direction|turn", refuses=True, silent=True)


@situation
def gear_ratio(arm: Arm, runs: list[Run]) -> Truth:
    """Joint 2's ratio is 1.5 times off: its angle too large, its torque too small."""

    def change(run: Run) -> None:
        run.q[:, 1] *= 1.5
        run.tau[:, 1] /= 1.5

    each(runs, change)
    return Truth("ratio|gear", joints=(2,))


def shifted(run: Run, seconds: float, joints: slice = slice(None)) -> None:
    """Shift torques in time: later for positive seconds."""
    for j in range(3)[joints]:
        run.tau[:, j] = np.interp(run.t - seconds, run.t, run.tau[:, j])


@situation
def torque_early(arm: Arm, runs: list[Run]) -> Truth:
    """The log has the command, 8 ms before the drives make it."""
    each(runs, lambda run: shifted(run, -0.008))
    return Truth("early|ahead|lead|latency|delay|filter")


@situation
def torque_late(arm: Arm, runs: list[Run]) -> Truth:
    """All torques are 12 ms late."""
    each(runs, lambda run: shifted(run, 0.012))
    return Truth("late|delay|filter")


@situation
def one_torque_late(arm: Arm, runs: list[Run]) -> Truth:
    """Joint 2's torque is 30 ms late."""
    each(runs, lambda run: shifted(run, 0.03, slice(1, 2)))
    return Truth("late|delay|filter", joints=(2,))


@situation
def torques_swapped(arm: Arm, runs: list[Run]) -> Truth:
    """The torques of joints 2 and 3 have changed places."""

    def change(run: Run) -> None:
        run.tau = run.tau[:, [0, 2, 1]]

    each(runs, change)
    return Truth("order|swap|belongs to", joints=(2, 3))


@situation
def joints_swapped(arm: Arm, runs: list[Run]) -> Truth:
    """Joints 2 and 3 have changed places, angles and torques."""

    def change(run: Run) -> None:
        run.q, run.tau = run.q[:, [0, 2, 1]], run.tau[:, [0, 2, 1]]

    each(runs, change)
    return Truth("order|swap|belongs to", joints=(2, 3))


@situation
def torque_sign(arm: Arm, runs: list[Run]) -> Truth:
    """Joint 3's torque has the wrong sign."""

    def change(run: Run) -> None:
        run.tau[:, 2] *= -1.0

    each(runs, change)
    return Truth("sign", joints=(3,))


@situation
def joint_sign(arm: Arm, runs: list[Run]) -> Truth:
    """Joint 2 counts the other way round, angle and torque."""

    def change(run: Run) -> None:
        run.q[:, 1] *= -1.0
        run.tau[:, 1] *= -1.0

    each(runs, change)
    return Truth("sign", joints=(2,))


@situation
def all_signs(arm: Arm, runs: list[Run]) -> Truth:
    """All torques have the wrong sign: of the arm on its load."""

    def change(run: Run) -> None:
        run.tau *= -1.0

    each(runs, change)
    return Truth("sign|negative")


@situation
def torque_unit(arm: Arm, runs: list[Run]) -> Truth:
    """Joint 3's torque is in N cm."""

    def change(run: Run) -> None:
        run.tau[:, 2] *= 100.0

    each(runs, change)
    return Truth("unit|gain|N cm", joints=(3,))


@situation
def motor_side(arm: Arm, runs: list[Run]) -> Truth:
    """All torques are those of the motors, before gears of 1:100."""

    def change(run: Run) -> None:
        run.tau /= 100.0

    each(runs, change)
    return Truth("motor|gear|unit|100|current")


@situation
def degrees(arm: Arm, runs: list[Run]) -> Truth:
    """Positions are in degrees."""

    def change(run: Run) -> None:
        run.q = np.degrees(run.q)

    each(runs, change)
    return Truth("degree")


@situation
def percent(arm: Arm, runs: list[Run]) -> Truth:
    """Positions are in -100 to 100 % of each joint's range."""

    def change(run: Run) -> None:
        run.q = run.q / 3.0 * 100.0

    each(runs, change)
    return Truth("percent|%.*range|range.*%|-100")


@situation
def zero(arm: Arm, runs: list[Run]) -> Truth:
    """Joint 2's encoder stands 20 degrees off."""

    def change(run: Run) -> None:
        run.q[:, 1] += np.radians(20.0)

    each(runs, change)
    return Truth("zero|encoder offset|mount|gravity direction", joints=(2,))


@situation
def clock(arm: Arm, runs: list[Run]) -> Truth:
    """The logger's clock runs 1.3 times too fast."""

    def change(run: Run) -> None:
        run.t = 1.3 * run.t

    each(runs, change)
    return Truth("clock|time|rate")


@situation
def milliseconds(arm: Arm, runs: list[Run]) -> Truth:
    """Time is in milliseconds."""

    def change(run: Run) -> None:
        run.t = 1e3 * run.t

    each(runs, change)
    return Truth("milli|time unit|ms", refuses=True)


@situation
def torque_gain(arm: Arm, runs: list[Run]) -> Truth:
    """Joint 3's torque is 1.25 times too large."""

    def change(run: Run) -> None:
        run.tau[:, 2] *= 1.25

    each(runs, change)
    return Truth("gain|unit|N m/A|current", joints=(3,))


@situation
def wall(arm: Arm, runs: list[Run]) -> Truth:
    """The arm hangs on a wall, and its file stands it on the floor."""
    mounted(arm, runs, 0.0)
    return Truth("gravity|mount|tilt")


@situation
def wall_upright_gravity(arm: Arm, runs: list[Run]) -> Truth:
    """On the wall, and the controller subtracts the weight of an upright arm."""
    mounted(arm, runs, 1.0)
    return Truth("gravity|mount|tilt")


def mounted(arm: Arm, runs: list[Run], subtracted: float) -> None:
    """Mount the arm on a wall; the controller may subtract an upright arm's weight."""

    def change(run: Run) -> None:
        upright = arm.weight(run.q)
        run.tau += arm.weight(run.q, np.array([-9.81, 0.0, 0.0])) - upright
        run.tau -= subtracted * upright

    each(runs, change)


@situation
def limited_channel(arm: Arm, runs: list[Run]) -> Truth:
    """Joint 2's channel ends at 60 % of the torque that the drive makes."""

    def change(run: Run) -> None:
        top = 0.6 * np.abs(run.tau[:, 1]).max()
        run.tau[:, 1] = np.clip(run.tau[:, 1], -top, top)

    each(runs[:-1], change)
    return Truth("limit|clip|satur|frozen torque", joints=(2,), refuses=True)


@situation
def load_in_one_run(arm: Arm, runs: list[Run]) -> Truth:
    """The second run carries 1.5 kg."""
    runs[1].tau += arm.load(runs[1], 1.5)
    return Truth("load|payload|another arm|change within the run")


@situation
def force_for_a_time(arm: Arm, runs: list[Run]) -> Truth:
    """Somebody pushes the flange with 25 N for 1.5 s of the first run."""
    run = runs[0]
    data = arm.model.createData()
    rows = (run.t > 6.0) & (run.t < 7.5)
    push = np.array([10.0, 20.0, 12.0])
    for k in np.flatnonzero(rows):
        pin.computeJointJacobians(arm.model, data, run.q[k])
        pin.updateFramePlacements(arm.model, data)
        J = pin.getJointJacobian(arm.model, data, 3, pin.LOCAL_WORLD_ALIGNED)
        lever = data.oMi[3].rotation @ np.array([0.3, 0.0, 0.0])
        run.tau[k] -= (J[:3] - pin.skew(lever) @ J[3:]).T @ push
    return Truth("force|contact|push|disturb|event|torque step|constant")


@situation
def model_made(arm: Arm, runs: list[Run]) -> Truth:
    """The torques are a controller's model: no noise, and no friction."""

    def change(run: Run) -> None:
        run.tau = arm.rigid(run.q, run.dq, run.ddq)

    each(runs, change)
    return Truth("model|no noise|no friction|computed", silent=True)


@situation
def parallelogram(arm: Arm, runs: list[Run]) -> Truth:
    """Joint 3's motor sits on the base: its angle is q2 + q3, torques accordingly."""

    def change(run: Run) -> None:
        run.q[:, 2] += run.q[:, 1]
        run.tau[:, 1] -= run.tau[:, 2]

    each(runs, change)
    return Truth("coupl|motor|parallel", joints=(2, 3))


@situation
def millimetres(arm: Arm, runs: list[Run]) -> Truth:
    """The first axis is linear and logged in millimetres."""

    def change(run: Run) -> None:
        run.q[:, 0] *= 1e3

    each(runs, change)
    return Truth("milli|mm|position unit|1000", joints=(1,), refuses=True)


@situation
def held_joint(arm: Arm, runs: list[Run]) -> Truth:
    """Joint 3 is held by its brake; its encoder rattles between two steps."""

    def change(run: Run) -> None:
        q, dq, ddq = run.q.copy(), run.dq.copy(), run.ddq.copy()
        q[:, 2], dq[:, 2], ddq[:, 2] = 0.4, 0.0, 0.0
        fresh = arm.along(run.t, q, dq, ddq)
        run.q, run.tau = fresh.q, fresh.tau
        run.q[:, 2] += 4e-4 * np.round(0.4 * arm.rng.normal(size=len(run.t)))

    each(runs, change)
    return Truth("held|idle|stand|still|frozen", joints=(3,), silent=True)


@situation
def pause(arm: Arm, runs: list[Run]) -> Truth:
    """The logger paused for a minute in the middle."""

    def change(run: Run) -> None:
        run.t = run.t + 60.0 * (run.t > 0.5 * run.t[-1])

    each(runs, change)
    return Truth("pause|gap|jump|stretch|clock step", silent=True)


@situation
def coarse_stamps(arm: Arm, runs: list[Run]) -> Truth:
    """Stamps are rounded to 50 ms; rows come evenly."""

    def change(run: Run) -> None:
        run.t = np.floor(run.t / 0.05) * 0.05

    each(runs, change)
    return Truth("stamp|round|clock", silent=True)


@situation
def rows_twice(arm: Arm, runs: list[Run]) -> Truth:
    """The file holds the recording twice, one after the other."""

    def change(run: Run) -> None:
        run.q, run.tau = np.tile(run.q, (2, 1)), np.tile(run.tau, (2, 1))
        run.t = np.arange(len(run.q)) / RATE

    each(runs[:1], change)
    return Truth("twice|repeat", refuses=True)


@situation
def friction_warms(arm: Arm, runs: list[Run]) -> Truth:
    """Joint 2's viscous friction falls by 2 % a kelvin, 20 to 40 degrees C."""
    for k, run in enumerate(runs):
        warm = 20.0 + 20.0 * (1.0 - np.exp(-(run.t + 18.0 * k) / 25.0))
        run.tau[:, 1] -= 2.0 * 0.02 * (warm - 20.0) * arm.viscous[1] * run.dq[:, 1]
        run.tau[:, 1] += arm.viscous[1] * run.dq[:, 1]
        run.more["temp2"] = np.round(warm, 1)
        for name in ("temp1", "temp3"):
            run.more[name] = np.full(len(run.t), 20.0)
    return Truth("warm|temperature|drift", joints=(2,))


@situation
def spring(arm: Arm, runs: list[Run]) -> Truth:
    """A spring of 8 N m/rad on joint 2."""

    def change(run: Run) -> None:
        run.tau[:, 1] += 8.0 * run.q[:, 1]

    each(runs, change)
    return Truth("spring", joints=(2,))


@situation
def stribeck(arm: Arm, runs: list[Run]) -> Truth:
    """Joint 2 rubs 60 % more below .08 rad/s."""

    def change(run: Run) -> None:
        more = 0.6 * arm.coulomb[1] * np.exp(-((run.dq[:, 1] / 0.08) ** 2))
        run.tau[:, 1] += more * np.tanh(run.dq[:, 1] / 0.01)

    each(runs, change)
    return Truth("stribeck|stiction|friction", joints=(2,))


@situation
def bristles(arm: Arm, runs: list[Run]) -> Truth:
    """Joint 1's friction turns round over 6 mrad of travel (Dahl)."""

    def change(run: Run) -> None:
        fine = np.arange(run.t[0], run.t[-1], 1e-3)
        dq = np.interp(fine, run.t, run.dq[:, 0])
        z = np.zeros(len(fine))
        for k in range(1, len(fine)):
            z[k] = (z[k - 1] + dq[k] * 1e-3 / 6e-3) / (1.0 + abs(dq[k]) * 1e-3 / 6e-3)
        held = np.interp(run.t, fine, z) - np.tanh(run.dq[:, 0] / 0.01)
        run.tau[:, 0] += arm.coulomb[0] * held

    each(runs, change)
    return Truth("presliding|maxwell|bristle|hysteresis", joints=(1,))


def make(name: str, seed: int, folder: Path) -> None:
    """Write a situation's robot, recordings and truth: two runs, and one to judge with."""
    rng = np.random.default_rng([seed, *name.encode()])
    arm = Arm(rng, prismatic=name == "millimetres")
    runs = [arm.motion() for _ in range(3)]
    truth = SITUATIONS[name](arm, runs)
    story = re.sub(r"\s+", " ", str(SITUATIONS[name].__doc__))
    write_log(folder, arm.urdf, [r.columns() for r in runs], truth, story)
