"""How often 95 % intervals hold the truth where everything varies that varies in life.

    python benchmarks/coverage_in_life.py [--draws 160] [--seed 0] [--out results/coverage_in_life.md]

Each draw has a robot of its own (2 to 4 joints), links that are not the prior's centre, friction, a
random trajectory of 14 s, torque noise (white or slow, 0.5 to 5 %), and an encoder (quantised, white
noise). *Planned*: the robot moves as planned. *Closed loop*: a PD controller with feed-forward sees the
encoder, so that its noise, and a slow disturbance of 0.5 to 2 % of the torque, come back in both
channels. Rigid bodies by Pinocchio; friction, controller and channels by the formulas below.
What is judged is `identify` as users call it, shape constants, filters and prior included.

    python benchmarks/coverage_in_life.py --bias 50 [--out results/bias.md]

After BIRDy (Leboutet et al., Applied Sciences 2021): two of its arms' kind, one motion of each, so many
draws of the noise. In closed loop at two noises of the encoder, behind the filters that are chosen by
default and behind such as let noise through, the bias of each base parameter and friction constant is
told in standard deviations over the draws: of least squares without instruments and with the command.
"""

from __future__ import annotations

import argparse
import os
from itertools import product
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
from sdp_vs_penalty.problem.load import load_problem
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.base_parameters import base_rows
from sdp_vs_penalty.robot.trajectory import random_trajectory
from sdp_vs_penalty.shootout.standard_instances import chain_problem, thin_links
from sdp_vs_penalty.signals.preprocessing import Preprocessing

Array = NDArray[np.float64]
EFFECTS = "rigid_body,viscous_friction,coulomb_friction,torque_offset"
GIVEN = "rigid_body,viscous_friction,coulomb_friction@v_s=0.05,torque_offset"  # as they are simulated
SECONDS, STEP, EVERY = 14.0, 1e-3, 2  # s; s; logged samples
TURN = 0.05  # rad/s over which dry friction turns round
QUANTUM, JITTER = 2.0 * np.pi / 2**17, 2e-5  # rad, of the encoder
BANDWIDTH = 4.0  # Hz, of the position loop


def slow(rng: np.random.Generator, count: int, n: int) -> Array:
    """Noise of 0.5 s correlation and unit variance, (count, n)."""
    a = np.exp(-STEP / 0.5)
    noise = rng.normal(size=(count + 2000, n))
    return np.asarray(signal.lfilter([np.sqrt(1 - a**2)], [1.0, -a], noise, axis=0)[2000:])


def drive(
    problem: Problem,
    links: Array,
    friction: Array,
    plan: tuple[Array, ...],
    rng: np.random.Generator,
    jitter: float = JITTER,
) -> tuple[Array, Array]:
    """Measured positions and the motor's torque (N, n) of an arm under its controller."""
    q, dq, ddq = plan
    n, viscous, dry, offset = q.shape[1], *friction
    rigid = problem.robot.inverse_dynamics(links, q, dq, ddq)
    disturbance = rng.uniform(0.005, 0.02) * rigid.std(axis=0) * slow(rng, len(q), n)
    feed = rigid + viscous * dq + 0.7 * dry * np.tanh(dq / TURN) + offset
    terms = problem.robot.mass_and_bias(links)
    inertia = np.mean([np.diag(terms(x[None], 0 * x[None])[0][0]) for x in q[::1000]], axis=0)
    gain = inertia * (2.0 * np.pi * BANDWIDTH) ** 2
    damp = 2.0 * np.sqrt(gain * inertia)
    noise = jitter * rng.normal(size=q.shape)
    x, v = q[0].copy(), dq[0].copy()
    seen, motion = np.empty_like(q), np.empty((3, *q.shape))
    for k in range(len(q)):
        seen[k] = np.round((x + noise[k]) / QUANTUM) * QUANTUM
        torque = feed[k] + gain * (q[k] - seen[k]) + damp * (dq[k] - v)
        mass, bias = terms(x[None], v[None])
        lost = viscous * v + dry * np.tanh(v / TURN) + offset + disturbance[k]
        # Implicit in all that damps: the slope of dry friction is steep where it turns round.
        slope = damp + viscous + dry / TURN / np.cosh(np.clip(v / TURN, -20, 20)) ** 2
        change = np.linalg.solve(mass[0] + STEP * np.diag(slope), torque - bias[0] - lost)
        motion[:, k] = x, v + 0.5 * STEP * change, change
        v = v + STEP * change
        x = x + STEP * v
    # The torque that this motion takes: what the implicit steps applied in all, without their error.
    x, v = motion[0], motion[1]
    lost = viscous * v + dry * np.tanh(v / TURN) + offset + disturbance
    return seen, problem.robot.inverse_dynamics(links, *motion) + lost


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
        seen, (viscous, dry, offset) = np.round(noisy / QUANTUM) * QUANTUM, friction
        torque = problem.robot.inverse_dynamics(links, *plan) + viscous * plan[1] + offset
        torque = torque + dry * np.tanh(plan[1] / TURN)
    noise = rng.normal(size=torque.shape) if rng.random() < 0.5 else slow(rng, len(t), n)
    measured = torque + rng.uniform(0.005, 0.05) * torque.std(axis=0) * noise
    run = Measurements(t[::EVERY], seen[::EVERY], measured[::EVERY], names=(f"draw {seed}",))
    estimate = identify(problem, run, effects=EFFECTS)
    theta = np.concatenate([links.ravel(), friction.ravel()])
    rows = base_rows(problem, estimate.model).rows
    rigid = len(rows) - 3 * n
    out = {}
    for name, truth, intervals in (
        ("base parameters", (rows @ theta)[:rigid], estimate.uncertainty.base[:rigid]),
        ("friction", theta[-3 * n :], estimate.uncertainty.standard[-3 * n :]),
    ):
        pairs = [(x, i) for x, i in zip(truth, intervals, strict=True) if np.isfinite(i.std)]
        held = float(np.mean([i.lower <= x <= i.upper for x, i in pairs]))
        out[name] = held, float(np.median([i.upper - i.lower for _, i in pairs]))
    return out


def biases(arm: str, jitter: float, cutoff: float | None, draws: int) -> list[list[str]]:
    """Rows of the table: the median of |bias| / deviation, its shares up to one and from three, and the
    root mean square error over that of least squares."""
    problem, t = load_problem(arm), np.arange(0.0, SECONDS, STEP)
    n, model = problem.robot.n, problem.model(GIVEN)
    theta = problem.nominal(model)
    plan = random_trajectory(problem.robot, seed=1, duration=SECONDS).states(t)
    links = theta[model.rigid_indices].ravel()
    size = np.abs(problem.robot.inverse_dynamics(links, *plan)).max(axis=0)
    friction = np.array([0.05 * size, 0.05 * size, 0.01 * size])
    theta[-3 * n :] = friction.ravel()
    settings = Preprocessing(cutoff, cutoff)
    errors: dict[str, list[Array]] = {"none": [], "command": []}
    for seed in range(draws):
        rng = np.random.default_rng([seed, 9])
        seen, torque = drive(problem, links, friction, plan, rng, jitter)
        torque = torque + 0.01 * size * rng.normal(size=torque.shape)
        run = Measurements.of(t, {"q": seen, "tau": torque, "qcmd": plan[0]}, (f"draw {seed}",))
        for how, found in errors.items():
            estimate = identify(
                problem, run, "ols", effects=GIVEN, preprocessing=settings, instruments=how, check=False
            )
            found.append(base_rows(problem, estimate.model).rows @ (estimate.theta - theta))
    out = []
    plain = np.sqrt(np.mean(np.square(errors["none"]), axis=0))
    for how, found in errors.items():
        ratio = np.abs(np.mean(found, axis=0)) / np.std(found, axis=0, ddof=1)
        share = np.median(np.sqrt(np.mean(np.square(found), axis=0)) / plain)
        filters = "default" if cutoff is None else f"{cutoff:g} Hz"
        cells = (
            f"{np.median(ratio):.2f}",
            f"{ratio.max():.1f}",
            *(f"{100 * np.mean(x):.0f}" for x in (ratio <= 1.0, ratio >= 3.0)),
        )
        out.append([arm, f"{1e3 * jitter:g}", filters, how, *cells, f"{share:.2f}"])
    return out


def write_biases(draws: int, out: Path) -> None:
    """Both arms, two noises, two filters."""
    kinds = product(("tx40", "ur10e"), (1e-4, 1e-3), (None, 20.0))
    lines = [line for kind in kinds for line in biases(*kind, draws)]
    head = ["arm", "noise of positions [mrad]", "filters", "instruments", "median", "worst",
            "at most 1 [%]", "at least 3 [%]", "error over none"]  # fmt: skip
    call = f"    python benchmarks/coverage_in_life.py --bias {draws}"
    about = (__doc__ or "").split("\n\n")[4]
    title = "# Bias in closed loop, in standard deviations"
    write_text(
        out, "\n".join([title, "", *about.splitlines(), "", call, "", *markdown_table(head, lines), ""])
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--draws", type=int, default=160, help="of each situation")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--bias", type=int, default=0, help="draws; the table of biases instead")
    parser.add_argument("--out", type=Path)
    chosen = parser.parse_args()
    out = chosen.out or Path("results", "bias.md" if chosen.bias else "coverage_in_life.md")
    if chosen.bias:
        return write_biases(chosen.bias, out)
    seeds = range(chosen.seed, chosen.seed + chosen.draws)
    found = {
        word: [draw(k, word == "closed loop") for k in seeds] for word in ("planned", "closed loop")
    }
    lines = []
    for word, draws in found.items():
        for name in draws[0]:
            shares = [d[name][0] for d in draws]
            low, high = wilson(float(np.sum(shares)), len(shares))
            cells = f"{100 * np.mean(shares):.1f}", f"{100 * low:.1f} to {100 * high:.1f}"
            width = f"{np.median([d[name][1] for d in draws]):.2g}"
            lines.append([word, str(len(draws)), name, *cells, width])
    head = ["situation", "draws", "quantity", "coverage [%]", "Wilson 95 %", "median width"]
    about = (__doc__ or "").split("\n\n")[2]
    call = f"    python benchmarks/coverage_in_life.py --draws {chosen.draws} --seed {chosen.seed}"
    text = ["# Coverage of 95 % intervals, in life", "", *about.splitlines(), "", call, ""]
    text += [*markdown_table(head, lines), ""]
    write_text(out, "\n".join(text))
    print("\n".join(text))


if __name__ == "__main__":
    main()
