"""Arms that MuJoCo drives under a controller, each with its right answer.

MuJoCo and NumPy alone make the logs. Friction is tanh(v / w), viscous, and a rotor's
inertia; the controller is a computed torque of the nominal links with PD feedback. The
links differ from the URDF by a fifth.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

from bench.truth import Truth, write_log

Array = NDArray[np.float64]
ARMS = Path(__file__).parents[1] / "challenge" / "worlds"
STEP = 5e-4
EVERY = 8
SECONDS = 14.0


@dataclass(frozen=True)
class World:
    """What a world has besides links, friction and rotors, and what is right of it."""

    truth: Truth
    story: str
    #: Extra torque (n,) of positions and velocities on the joints.
    extra: Callable[[Array, Array], Array] | None = None
    #: Velocity over which dry friction turns round [rad/s].
    width: float = 0.02
    #: Whether a contact pushes the flange in the first run.
    bump: bool = False
    #: What the torque sensors make of torques (N, n).
    sensor: Callable[[Array], Array] = lambda tau: tau
    #: Seconds by which the drives act after the command, which is what is logged.
    latency: float = 0.0
    #: Of the controller [1/s^2]; the less, the more latency it bears.
    stiffness: float = 900.0
    #: Seconds by which the log has torques late.
    late: float = 0.0
    #: The direction of gravity over 9.81 m/s^2, which the URDF does not know.
    gravity: tuple[float, float, float] = (0.0, 0.0, -1.0)
    arm: str = "panda"


def _on(j: int, law: Callable[[Array, Array], Array]) -> Callable[..., Array]:
    return lambda q, v: np.eye(len(q))[j] * law(q, v)[j]


def _bent(tau: Array) -> Array:
    out = tau.copy()
    out[:, 1] -= 1.3e-3 * tau[:, 1] * np.abs(tau[:, 1])
    return out


WORLDS: dict[str, World] = {
    "clean": World(Truth("", silent=True), "Nothing."),
    "clean_elbow": World(Truth("", silent=True), "Nothing.", arm="elbow"),
    "friction_law": World(
        Truth("coulomb.*v_s|re-estimate", silent=True),
        "Dry friction turns round within .1 rad/s.",
        width=0.1,
    ),
    "bump": World(
        Truth("force|contact|disturb|push|event|load"),
        "33 N on the flange from 6 to 7 s of the first run.",
        bump=True,
    ),
    "spring": World(
        Truth("spring", joints=(2,)),
        "A spring of 6 N m/rad on joint 2.",
        _on(1, lambda q, v: 6.0 * q),
    ),
    "stribeck": World(
        Truth("stribeck|stiction", joints=(4,)),
        "Joint 4 rubs 1.2 N m more below .1 rad/s.",
        _on(3, lambda q, v: 1.2 * np.exp(-((v / 0.1) ** 2)) * np.tanh(v / 0.02)),
    ),
    "bent_sensor": World(
        Truth("no effect|curve|gain|sensor", joints=(2,), silent=True),
        "Joint 2's sensor reads tau - .0013 tau |tau|.",
        sensor=_bent,
    ),
    "latency": World(
        Truth("early|ahead|lead|latency|delay|filter"),
        "The drives act 6 ms after the command that is logged.",
        latency=0.006,
    ),
}


def make(name: str, seed: int, folder: Path) -> None:
    """Simulate one of WORLDS and write its log."""
    simulate(WORLDS[name], np.random.default_rng([seed, *name.encode()]), folder)


def simulate(world: World, rng: np.random.Generator, folder: Path) -> None:
    """Simulate a world's three runs, the last to judge with, and write them."""
    path = ARMS / f"{world.arm}.urdf"
    nominal = mujoco.MjModel.from_xml_path(str(path))
    true = mujoco.MjModel.from_xml_path(str(path))
    for model in (nominal, true):
        model.opt.timestep = STEP
        model.jnt_limited[:] = False
    n = true.nv
    coulomb = true.dof_frictionloss * rng.uniform(0.8, 1.3, n)
    viscous = true.dof_damping * rng.uniform(0.8, 1.3, n)
    true.body_mass[1:] *= rng.uniform(0.85, 1.2, n)
    true.body_ipos[1:] += 0.008 * rng.normal(size=(n, 3))
    data = mujoco.MjData(nominal)
    data.qpos[:] = nominal.jnt_range.mean(1)
    mujoco.mj_forward(nominal, data)
    full = np.zeros((n, n))
    mujoco.mj_fullM(nominal, data, full)
    rotor = np.diag(full) * 0.3 + 0.02
    for model in (nominal, true):
        model.dof_frictionloss[:] = 0.0
        model.dof_damping[:] = 0.0
        model.dof_armature[:] = rotor
    true.opt.gravity[:] = 9.81 * np.array(world.gravity)
    mujoco.mj_setConst(true, mujoco.MjData(true))
    runs = []
    for k in range(3):
        pushed = replace(world, bump=world.bump and k == 0)
        runs.append(_run(pushed, nominal, true, coulomb, viscous, rng))
    write_log(folder, path.read_text("utf-8"), runs, world.truth, world.story)


def _run(
    world: World,
    nominal: mujoco.MjModel,
    true: mujoco.MjModel,
    coulomb: Array,
    viscous: Array,
    rng: np.random.Generator,
) -> dict[str, Array]:
    n = true.nv
    lower, upper = true.jnt_range.T
    half = np.minimum(0.35 * (upper - lower), 1.0)
    w = 2.0 * np.pi / SECONDS * rng.permuted(np.arange(1, 9))[:5, None]
    size, phase = rng.uniform(0.3, 1.0, (5, n)), rng.uniform(-np.pi, np.pi, (5, n))
    times = np.arange(0.0, SECONDS, STEP)
    angle = w * times[:, None, None] + phase
    fit = half / np.abs((size * np.sin(angle)).sum(1)).max(0)
    plan = 0.5 * (lower + upper) + fit * (size * np.sin(angle)).sum(1)
    speed = fit * (size * w * np.cos(angle)).sum(1)
    push = -fit * (size * w**2 * np.sin(angle)).sum(1)
    data, model_of_servo = mujoco.MjData(true), mujoco.MjData(nominal)
    data.qpos[:], data.qvel[:] = plan[0], speed[0]
    inertia = true.dof_armature / 0.3
    waiting = round(world.latency / STEP)
    commands: list[Array] = []
    states = []
    contact = rng.normal(size=3)
    contact *= 33.0 / np.linalg.norm(contact)
    for k, t in enumerate(times):
        model_of_servo.qpos[:], model_of_servo.qvel[:] = plan[k], speed[k]
        model_of_servo.qacc[:] = push[k]
        mujoco.mj_inverse(nominal, model_of_servo)
        error, slip = plan[k] - data.qpos, speed[k] - data.qvel
        feedback = world.stiffness * error + 2.0 * world.stiffness**0.5 * slip
        command = model_of_servo.qfrc_inverse + inertia * feedback
        command = command + coulomb * np.tanh(speed[k] / 0.05) + viscous * speed[k]
        commands.append(command)
        acting = commands[max(k - waiting, 0)]
        v = data.qvel.copy()
        states.append(data.qpos.copy())
        rub = coulomb * np.tanh(v / world.width) + viscous * v
        if world.extra:
            rub = rub + world.extra(data.qpos.copy(), v)
        data.qfrc_applied[:] = acting - rub
        acts = world.bump and 6.0 <= t < 7.0
        data.xfrc_applied[-1, :3] = contact if acts else 0.0
        mujoco.mj_step(true, data)
    rows = slice(0, None, EVERY)
    q = np.round(np.array(states)[rows] / 1e-6) * 1e-6
    late = np.maximum(np.arange(len(times)) - round(world.late / STEP), 0)
    tau = world.sensor(np.array(commands)[late][rows])
    tau = tau + 0.05 * coulomb * rng.normal(size=tau.shape)
    columns = {"t": times[rows]}
    for name, values in (("q", q), ("tau", tau)):
        columns |= {f"{name}{j + 1}": x for j, x in enumerate(values.T)}
    return columns
