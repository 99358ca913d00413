"""How often 95 % intervals hold the truth where everything varies that varies in life.

    python benchmarks/coverage_in_life.py [--draws 160] [--seed 0] [--out results/coverage_in_life.md]

Each draw has a robot of its own (2 to 4 joints), links that are not the prior's centre, friction, a
random trajectory of 14 s, torque noise (white or slow, 0.5 to 5 %), and an encoder (quantised, white
noise). *Planned*: the robot moves as planned. *Closed loop*: a PD controller with feed-forward sees the
encoder, so that its noise, and a slow disturbance of 0.5 to 2 % of the torque, come back in both
channels. Rigid bodies by Pinocchio; friction, controller and channels by the formulas below.
What is judged is `identify` as users call it, shape constants, filters and prior included.
"""

import argparse
import os
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from challenge.judge import wilson
from numpy.typing import NDArray
from scipy import signal

from sdp_vs_penalty import identify
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.formatting import markdown_table
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.base_parameters import base_rows
from sdp_vs_penalty.research.shootout.instances import chain_problem, thin_links
from sdp_vs_penalty.robot.trajectory import random_trajectory

Array = NDArray[np.float64]
EFFECTS = "rigid_body,viscous_friction,coulomb_friction,torque_offset"
SECONDS, STEP, EVERY = 14.0, 1e-3, 2  # s; s; logged samples
TURN = 0.05  # rad/s over which dry friction turns round
QUANTUM, JITTER = 2.0 * np.pi / 2**17, 2e-5  # rad, of the encoder
BANDWIDTH = 4.0  # Hz, of the position loop


def slow(rng: np.random.Generator, count: int, n: int) -> Array:
    """Noise of 0.5 s correlation and unit variance, (count, n)."""
    a = np.exp(-STEP / 0.5)
    noise = rng.normal(size=(count + 2000, n))
    return np.asarray(signal.lfilter([np.sqrt(1 - a**2)], [1.0, -a], noise, axis=0)[2000:])


def rubbed(friction: Array, v: Array, known: float = 1.0) -> Array:
    """Viscous friction, ``known`` of dry friction and the offset at velocities (..., n)."""
    viscous, dry, offset = friction
    return np.asarray(viscous * v + known * dry * np.tanh(v / TURN) + offset)


def drive(
    problem: Problem, links: Array, friction: Array, plan: tuple[Array, ...], rng: np.random.Generator
) -> tuple[Array, Array]:
    """Measured positions and the motor's torque (N, n) of an arm under its controller."""
    q, dq, ddq = plan
    viscous, dry, _ = friction
    rigid = problem.robot.inverse_dynamics(links, q, dq, ddq)
    disturbance = rng.uniform(0.005, 0.02) * rigid.std(axis=0) * slow(rng, *q.shape)
    feed = rigid + rubbed(friction, dq, 0.7)
    terms = problem.robot.mass_and_bias(links)
    inertia = np.mean([np.diag(terms(x[None], 0 * x[None])[0][0]) for x in q[::1000]], axis=0)
    gain = inertia * (2.0 * np.pi * BANDWIDTH) ** 2
    damp = 2.0 * np.sqrt(gain * inertia)
    noise = JITTER * rng.normal(size=q.shape)
    x, v = q[0].copy(), dq[0].copy()
    seen, motion = np.empty_like(q), np.empty((3, *q.shape))
    for k in range(len(q)):
        seen[k] = np.round((x + noise[k]) / QUANTUM) * QUANTUM
        torque = feed[k] + gain * (q[k] - seen[k]) + damp * (dq[k] - v)
        mass, bias = terms(x[None], v[None])
        # Implicit in all that damps: the slope of dry friction is steep where it turns round.
        slope = damp + viscous + dry / TURN / np.cosh(np.clip(v / TURN, -20, 20)) ** 2
        push = torque - bias[0] - rubbed(friction, v) - disturbance[k]
        change = np.linalg.solve(mass[0] + STEP * np.diag(slope), push)
        motion[:, k] = x, v + 0.5 * STEP * change, change
        v = v + STEP * change
        x = x + STEP * v
    # The torque that this motion takes: what the implicit steps applied in all, without their error.
    taken = problem.robot.inverse_dynamics(links, *motion) + rubbed(friction, motion[1])
    return seen, taken + disturbance


def draw(seed: int, closed: bool) -> dict[str, tuple[float, float]]:
    """Share of the intervals that hold the truth, and their median width over the truth, by quantity."""
    rng = np.random.default_rng([seed, 77])
    n = int(rng.integers(2, 5))
    problem = chain_problem(n, 1000 + seed)
    links = thin_links(rng, problem)
    friction = np.array([rng.uniform(0.1, 1.0, n), rng.uniform(0.3, 1.5, n), rng.uniform(-0.5, 0.5, n)])
    t = np.arange(0.0, SECONDS, STEP)
    plan = random_trajectory(problem.robot, seed=seed, duration=SECONDS).states(t)
    if closed:
        seen, torque = drive(problem, links, friction, plan, rng)
    else:
        noisy = plan[0] + JITTER * rng.normal(size=plan[0].shape)
        seen = np.round(noisy / QUANTUM) * QUANTUM
        torque = problem.robot.inverse_dynamics(links, *plan) + rubbed(friction, plan[1])
    noise = rng.normal(size=torque.shape) if rng.random() < 0.5 else slow(rng, len(t), n)
    measured = torque + rng.uniform(0.005, 0.05) * torque.std(axis=0) * noise
    run = Measurements(t[::EVERY], seen[::EVERY], measured[::EVERY], names=(f"draw {seed}",))
    estimate = identify(problem, run, effects=EFFECTS)
    base, own = base_rows(problem, estimate.model).rows[: -3 * n], estimate.uncertainty
    out = {}
    for name, truth, intervals in (
        ("base parameters", base @ np.append(links, friction), own.base[: len(base)]),
        ("friction", friction.ravel(), own.standard[-3 * n :]),
    ):
        pairs = [(x, i) for x, i in zip(truth, intervals, strict=True) if np.isfinite(i.std)]
        held = float(np.mean([i.lower <= x <= i.upper for x, i in pairs]))
        out[name] = held, float(np.median([i.upper - i.lower for _, i in pairs]))
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--draws", type=int, default=160, help="of each situation")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path("results", "coverage_in_life.md"))
    chosen = parser.parse_args()
    seeds, lines = range(chosen.seed, chosen.seed + chosen.draws), []
    for word in ("planned", "closed loop"):
        draws = [draw(k, word == "closed loop") for k in seeds]
        for name in draws[0]:
            shares, widths = zip(*(d[name] for d in draws), strict=True)
            ends = " to ".join(f"{100 * x:.1f}" for x in wilson(float(np.sum(shares)), len(shares)))
            cells = f"{100 * np.mean(shares):.1f}", ends, f"{np.median(widths):.2g}"
            lines.append([word, str(len(draws)), name, *cells])
    head = ["situation", "draws", "quantity", "coverage [%]", "Wilson 95 %", "median width"]
    about = (__doc__ or "").split("\n\n")[2]
    call = f"    python benchmarks/coverage_in_life.py --draws {chosen.draws} --seed {chosen.seed}"
    text = ["# Coverage of 95 % intervals, in life", "", *about.splitlines(), "", call, ""]
    text += [*markdown_table(head, lines), ""]
    write_text(chosen.out, "\n".join(text))
    print("\n".join(text))


if __name__ == "__main__":
    main()
