"""A hobby arm with six position servos in MuJoCo, and logs of what it was commanded.

    python hobby_arm.py

Writes run.csv, loaded.csv (a load of 100 g), unseen.csv and hobby.urdf, the maker's file.
"""

import mujoco
import numpy as np

LENGTH = (0.06, 0.12, 0.11, 0.05, 0.05, 0.06)  # m
MASS = np.array([0.20, 0.16, 0.14, 0.08, 0.07, 0.08])  # kg, as the maker says
AXES = ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")
STEP = 5e-4  # s
COUNT = 2 * np.pi / 4096  # rad


def urdf(masses, shifts, load=0.0):
    """Boxes along z, their centres of mass shifted (6, 3) [m]; a load [kg] at the end of the last."""
    text, at = '<robot name="hobby"><link name="l0"/>', 0.03
    for k, (a, m, c) in enumerate(zip(LENGTH, masses, shifts, strict=True), start=1):
        i, j = m * (a**2 + 0.03**2) / 12, m * 0.03**2 / 6
        text += (
            f'<link name="l{k}"><inertial>'
            f'<origin xyz="{c[0]} {c[1]} {a / 2 + c[2]}"/><mass value="{m}"/>'
            f'<inertia ixx="{i}" iyy="{i}" izz="{j}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="j{k}" type="revolute"><parent link="l{k - 1}"/><child link="l{k}"/>'
            f'<origin xyz="0 0 {at}"/><axis xyz="{AXES[k - 1]}"/>'
            '<limit lower="-2.6" upper="2.6" effort="3" velocity="10"/></joint>'
        )
        at = a
    if load:
        text += (
            f'<link name="load"><inertial><mass value="{load}"/><inertia ixx="1e-5" iyy="1e-5"'
            ' izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial></link><joint name="hold" type="fixed">'
            '<parent link="l6"/><child link="load"/><origin xyz="0.01 0 0.08"/></joint>'
        )
    return text + "</robot>"


def servos(text, kp, kv, armature=0.0, damping=0.0, friction=0.0):
    """The arm in MuJoCo with a position servo a joint."""
    spec = mujoco.MjSpec.from_string(text)
    for joint, p, v in zip(spec.joints, kp, kv, strict=True):
        servo = spec.add_actuator(
            name=joint.name, target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT
        )
        servo.set_to_position(kp=p, kv=v)
    model = spec.compile()
    model.dof_armature[:] = armature
    model.dof_damping[:] = damping
    model.dof_frictionloss[:] = friction
    # Friction turns round with the velocity, not 10 ms before it.
    model.dof_solref[:, 0] = 2 * STEP
    return model


def command(seed, t):
    """(N, 6) sums of five sines a joint, from rest [rad]."""
    rng = np.random.default_rng(seed)
    q = np.tile([0.0, 0.4, 0.7, 0.0, 0.5, 0.0], (len(t), 1))
    for k in range(1, 6):
        a, b = 0.45 / k * rng.normal(size=(2, 6))
        wave = 2 * np.pi * 0.2 * k * t[:, None]
        q += (a * np.sin(wave) + b * (np.cos(wave) - 1)) * (1 - np.exp(-t[:, None]))
    return q


def follow(model, t, commanded):
    """(N, 6) where the servos bring the joints at the instants t of a command."""
    model.opt.timestep = STEP
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    data, q = mujoco.MjData(model), np.empty_like(commanded)
    every = round((t[1] - t[0]) / STEP)
    data.qpos[:] = commanded[0]
    for k in range(len(t)):
        q[k], ahead = data.qpos, commanded[min(k + 1, len(t) - 1)] - commanded[k]
        for part in range(every):
            data.ctrl[:] = commanded[k] + part / every * ahead
            mujoco.mj_step(model, data)
    return q


rng, size = np.random.default_rng(3), np.array([1.0, 1.0, 0.8, 0.3, 0.25, 0.2])
masses, shifts = MASS * rng.uniform(0.8, 1.5, 6), rng.uniform(-0.012, 0.012, (6, 3))
kp, kv = size * rng.uniform(6.0, 9.0, 6), size * rng.uniform(0.35, 0.6, 6)
own = {"armature": 0.006 * size, "damping": 0.03 * size, "friction": 0.05 * size}
t = np.arange(0.0, 20.0, 0.01)
names = [f"{x}{j}" for x in ("q", "qcmd") for j in range(1, 7)]

if __name__ == "__main__":
    for name, seed, load in (
        ("run.csv", 1, 0.0),
        ("loaded.csv", 5, 0.1),
        ("unseen.csv", 2, 0.0),
    ):
        commanded = command(seed, t)
        q = COUNT * np.round(
            follow(servos(urdf(masses, shifts, load), kp, kv, **own), t, commanded)
            / COUNT
        )
        columns = np.column_stack([t, q, commanded])
        np.savetxt(
            name, columns, "%.6f", ",", header=",".join(["t", *names]), comments=""
        )
    with open("hobby.urdf", "w") as file:
        file.write(urdf(MASS, np.zeros((6, 3))))
