"""Logs of servo-driven arms from MuJoCo, without torque: what `identify` makes of them.

    python benchmarks/servo.py --seeds 0:24 [--out servo.json]

Six-joint arms of random links, built and simulated by MuJoCo alone: it shares nothing with the
package's dynamics. Soft and stiff loops (PD, PID, cascade with an integrating velocity loop), commands
that act late, positions of 12 bits or of fine encoders, logged at 50 to 500 Hz. One gain is told
(--known); judged are the law's name, gains, intervals, the certificate and the torque on another motion.
Seeds below 1000 are for development.
"""

import argparse
import json
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pandas

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.diagnosis.comparison import predicted
from sdp_vs_penalty.effects import parse_effects
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.estimation.drive_torque import plant
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.identify import identify
from sdp_vs_penalty.signals.preprocessing import filtered_torque

LAWS = ("pd", "pid", "cascade")
#: Lengths of the links [m], masses [kg].
LENGTH, MASS = (0.1, 0.25, 0.22, 0.1, 0.09, 0.08), (2.5, 2.0, 1.5, 0.8, 0.6, 0.4)
#: Reflected inertia of the motors [kg m^2].
ROTOR = np.array([2e-2, 2e-2, 2e-2, 4e-3, 4e-3, 2e-3])
STEP, SECONDS = 5e-4, 20.0
#: Time constant of MuJoCo's friction constraint [s]: its least, and its usual one. Friction has the sign
#: of dq + b ddq, b = 0.95 / 2 of it: with the usual one it turns round 9.5 ms before the velocity does.
#: No joint knows its future: commands seem to act up to 1 ms later than they do.
STIFF, USUAL = 2.0 * STEP, 0.02


@dataclass(frozen=True)
class Case:
    """One arm with its servos: gains (6,) in N m, rad, s; delay [s]; rate [Hz]; bits of the encoders;
    friction : its time constant [s]."""

    seed: int
    urdf: str
    law: str
    kp: np.ndarray
    kd: np.ndarray
    ki: np.ndarray
    kh: np.ndarray
    viscous: np.ndarray
    coulomb: np.ndarray
    delay: float
    rate: int
    bits: int
    friction: float


def arm(rng: np.random.Generator) -> str:
    """A URDF of six links, axes z y y x y x, whose masses lie about half-way along them."""
    parts = ['<robot name="servo_arm"><link name="l0"/>']
    at, axes = 0.03, ("0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0")
    for k, (length, mass) in enumerate(zip(LENGTH, MASS, strict=True), start=1):
        m = mass * rng.uniform(0.7, 1.4)
        c = np.array([0.0, 0.0, 0.5 * length]) + rng.uniform(-0.025, 0.025, 3)
        a, b, d = np.sqrt(rng.uniform(0.5, 1.3, 3)) * np.array([0.04, 0.05, 0.04])
        ixx, iyy, izz = m * np.array([b * b + d * d, a * a + d * d, a * a + b * b]) / 3.0
        parts.append(
            f'<link name="l{k}"><inertial><origin xyz="{c[0]} {c[1]} {c[2]}"/><mass value="{m}"/>'
            f'<inertia ixx="{ixx}" iyy="{iyy}" izz="{izz}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="j{k}" type="revolute"><parent link="l{k - 1}"/><child link="l{k}"/>'
            f'<origin xyz="0 0 {at}"/><axis xyz="{axes[k - 1]}"/>'
            '<limit lower="-3" upper="3" effort="100" velocity="20"/></joint>'
        )
        at = length
    return "".join(parts) + "</robot>"


def model_of(urdf: str, viscous: np.ndarray, coulomb: np.ndarray, reacts: float) -> mujoco.MjModel:
    """The arm in MuJoCo, with friction of a time constant [s]."""
    spec = mujoco.MjSpec.from_string(urdf)
    spec.option.timestep = STEP
    model = spec.compile()
    model.dof_damping[:], model.dof_frictionloss[:], model.dof_armature[:] = viscous, coulomb, ROTOR
    model.dof_solref[:, 0] = reacts
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    return model


def case(seed: int, friction: float = STIFF) -> Case:
    """Of a seed: its arm, law and log; gains by the natural frequency of each joint alone."""
    rng = np.random.default_rng([seed, 1])
    urdf = arm(rng)
    weak = np.array([1.0, 1.0, 0.8, 0.15, 0.12, 0.08])
    viscous, coulomb = 0.3 * weak * rng.uniform(0.5, 1.5, 6), 0.3 * weak * rng.uniform(0.5, 1.5, 6)
    model = model_of(urdf, viscous, coulomb, friction)
    data, mass = mujoco.MjData(model), np.zeros((6, 6))
    data.qpos[:] = [0.0, 0.5, 0.8, 0.0, 0.5, 0.0]
    mujoco.mj_forward(model, data)
    mujoco.mj_fullM(model, data, mass)
    law = LAWS[seed % 3]
    hertz = rng.uniform(2.0, 3.0) if seed // 3 % 2 == 0 else rng.uniform(5.0, 8.0)
    w = 2.0 * np.pi * hertz * rng.uniform(0.8, 1.25, 6)
    inertia = np.diag(mass)
    kp, kd = w**2 * inertia, 2.0 * rng.uniform(0.6, 1.0, 6) * w * inertia
    kh = kd * rng.uniform(1.0, 3.0, 6) if law == "cascade" else np.zeros(6)
    ki = kp * rng.uniform(0.5, 1.5, 6) if law == "pid" else kh * kp / kd
    delay = 0.0 if seed // 6 % 2 == 0 else round(rng.uniform(0.004, 0.02), 3)
    log = int(rng.choice([50, 100, 200, 500])), int(rng.choice([12, 18]))
    return Case(seed, urdf, law, kp, kd, ki, kh, viscous, coulomb, delay, *log, friction)


def command(seed: int, t: np.ndarray) -> np.ndarray:
    """(N, 6) sums of five sines a joint, from rest."""
    rng = np.random.default_rng([seed, 2])
    q = np.tile([0.0, 0.3, 0.6, 0.0, 0.4, 0.0], (len(t), 1))
    for j in range(6):
        for k in range(1, 6):
            a, b = rng.normal(size=2) * 0.35 / k
            wave = 2.0 * np.pi * 0.2 * k * t
            q[:, j] += (a * np.sin(wave) + b * (np.cos(wave) - 1.0)) * (1.0 - np.exp(-t))
    return q


def simulate(c: Case, motion: int) -> dict[str, np.ndarray]:
    """A run of a case: t, q, qcmd as logged; torque, dq and q as they were."""
    rng = np.random.default_rng([c.seed, motion, 3])
    model = model_of(c.urdf, c.viscous, c.coulomb, c.friction)
    data = mujoco.MjData(model)
    t = np.arange(0.0, SECONDS, STEP)
    told = command(1000 * c.seed + motion, t)
    late = command(1000 * c.seed + motion, np.maximum(t - c.delay, 0.0))
    data.qpos[:] = told[0]
    mujoco.mj_forward(model, data)
    # The integral begins where it holds the arm.
    both, start = data.qfrc_bias * c.ki.any(), data.qpos.copy()
    q, dq, tau = np.empty((3, len(t), 6))
    for k in range(len(t)):
        e = late[k] - data.qpos
        both += STEP * c.ki * e
        torque = c.kp * e - c.kd * data.qvel + both - c.kh * (data.qpos - start)
        q[k], dq[k], tau[k] = data.qpos, data.qvel, torque
        data.qfrc_applied[:] = torque
        mujoco.mj_step(model, data)
    every = round(1.0 / c.rate / STEP)
    step, true = 2.0 * np.pi / 2**c.bits, q[::every]
    logged = true + rng.normal(0.0, 2e-5, true.shape) if c.bits == 18 else step * np.round(true / step)
    known = {"true_q": true, "dq": dq[::every], "tau": tau[::every]}
    return {"t": t[::every], "q": logged, "qcmd": told[::every], **known}


def judge(c: Case, instruments: str) -> dict[str, Any]:
    """What identify makes of a case's first run, beside what it is; torque on the second one."""
    first, second = simulate(c, 0), simulate(c, 1)
    run = Measurements.of(first["t"], {k: first[k] for k in ("q", "qcmd")}, (f"seed {c.seed}",))
    effects = "rigid_body,coulomb_friction,torque_offset,rotor_inertia"
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "arm.urdf"
        file.write_text(c.urdf)
        begin = time.process_time()
        found = identify(
            str(file), run, effects=effects, known={"kp2": c.kp[1]}, instruments=instruments
        )
        seconds = time.process_time() - begin
    at = {p.name: k for k, p in enumerate(found.model.parameters)}
    errors, inside = {}, []
    for symbol, true in {"kp": c.kp, "kd": c.kd + c.viscous, "ki": c.ki, "kh": c.kh}.items():
        for j in range(6):
            k = at.get(f"{symbol}{j + 1}")
            if k is None or not true[j] or (symbol, j) == ("kp", 1):
                continue
            errors[f"{symbol}{j + 1}"] = float(found.theta[k] / true[j] - 1.0)
            spread = 1.96 * found.standard_deviations[k]
            inside.append(bool(abs(found.theta[k] - true[j]) <= spread))
    law = str(found.details["servo"]["law"])
    return {
        "seed": c.seed, "law": c.law, "found": law, "right": law.lower() == c.law, "delay": c.delay,
        "found_delay": found.details["servo"]["delay"], "rate": c.rate, "bits": c.bits, "errors": errors,
        "inside": inside, "torque_percent": unseen(c, second, found), "seconds": seconds,
        "gap": found.certificate.gap, "violation": found.certificate.worst,
    }  # fmt: skip


def unseen(c: Case, run: dict[str, np.ndarray], found: Estimate) -> float:
    """Error of torque on the second run [%]: links, dry friction and the whole damping, kd with it."""
    body, at = plant(found), {p.name: k for k, p in enumerate(found.model.parameters)}
    damping = found.theta[[at[f"kd{j + 1}"] for j in range(6)]]
    (viscous,) = parse_effects("viscous_friction", found.robot)
    model = Model(found.robot, (*body.model.effects, viscous))
    torque = run["tau"] + c.kd * run["dq"]
    if "ki1" in at:  # where the integral began is in the offsets
        torque = torque - torque.mean(axis=0)
    rows = filtered_torque(Measurements(run["t"], run["true_q"], torque), model, found.preprocessing)
    theta = np.append(body.theta, damping)
    left = predicted(rows, theta) - rows.torque
    if "ki1" in at:
        left = left - left.mean(axis=0)
    return float(100.0 * np.linalg.norm(left) / np.linalg.norm(rows.torque))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", default="0:12", help="first:stop")
    parser.add_argument("--instruments", default="command")
    parser.add_argument("--friction", type=float, default=STIFF, help=f"{USUAL}: as MuJoCo has it")
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args()
    cases = []
    for seed in range(*map(int, asked.seeds.split(":"))):
        cases.append(one := judge(case(seed, asked.friction), asked.instruments))
        gain = 100 * max(one["errors"].values(), key=abs)
        print(
            f"{seed}: {one['law']} -> {one['found']}, {one['rate']} Hz, {one['bits']} bits, delay "
            f"{1e3 * one['delay']:.0f} -> {1e3 * one['found_delay']:.1f} ms, worst gain "
            f"{gain:+.1f} %, torque {one['torque_percent']:.2f} %, {one['seconds']:.1f} s CPU",
            flush=True,
        )
    each = pandas.DataFrame(cases)
    errors = pandas.json_normalize(each["errors"]).abs()
    worst = errors.T.groupby(errors.columns.str[-1]).max().fillna(0.0)  # (joints, cases)
    summary = {
        "cases": len(each),
        "law right": float(each["right"].mean()),
        "joints with all gains within 5 %": float((worst <= 0.05).to_numpy().mean()),
        "intervals that hold": float(each["inside"].explode().mean()),
        "torque on unseen motion within 5 %": float((each["torque_percent"] <= 5.0).mean()),
        "median torque error [%]": float(each["torque_percent"].median()),
        "largest gap": float(each["gap"].max()),
        "constraints hold": bool((each["violation"] == 0.0).all()),
        "median seconds CPU": float(each["seconds"].median()),
    }
    print(json.dumps(summary, indent=1))
    if asked.out is not None:
        asked.out.write_text(json.dumps({"summary": summary, "cases": cases}, indent=1) + "\n")


if __name__ == "__main__":
    main()
