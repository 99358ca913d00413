"""The run that tells two effects apart, for ten pairs: python benchmarks/separation.py

Simulated: a Panda identified from its simulated exciting run, with its noise. For each pair `separate`
(what `excite --separate` calls) designs a run of 20 s. Its power is the squared distance of the two
hypotheses over that of the default excitation of the same length. At the length that it says is needed
for 95 % right decisions, noise is drawn anew, the torque made by either effect in turn at its stated
size in the direction that the other makes best, and least squares of both models decide. Writes
results/separation.md.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.diagnosis.score import orthonormal
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.estimation.identify import identify
from sdp_vs_penalty.estimation.separation import RIGHT, Hypotheses, separate
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.problem.load import load_problem
from sdp_vs_penalty.simulation.experiment import experiment

Array = NDArray[np.float64]
OUT = Path(__file__).parents[1] / "results" / "separation.md"
PAIRS = (
    "torque_ripple:4@k=2,joint_spring:4",
    "torque_ripple:2@k=1,joint_elasticity:2",
    "torque_gain:2,joint_elasticity:2",
    "stribeck_friction:5,power_law_friction:5@alpha=2",
    "presliding_hysteresis:3,sigmoid_friction:3",
    "load_dependent_friction:2,position_dependent_friction:2@k=1",
    "load_dependent_friction:4,load_dependent_hysteresis:4",
    "asymmetric_viscous_friction:1,power_law_friction:1@alpha=2",
    "joint_zero_error:4,joint_elasticity:4",
    "torque_delay:6,rotor_inertia:6",
)
DURATION, ITERATIONS, DRAWS, SEED = 20.0, 150, 200, 0


def white(hypotheses: Hypotheses, motion: Motion) -> tuple[Array, Array, Array]:
    """Columns of the model and of the two effects, sized, in noise standard deviations."""
    e = hypotheses.estimate
    base = np.zeros((e.robot.n, len(motion.t), len(e.model.parameters)))
    for j, c in enumerate(e.model.columns(motion)):
        base[j][:, c.indices] = c.columns
    X = (base / hypotheses.noise[:, None, None]).reshape(-1, base.shape[2])
    found = []
    for effect, scale in zip(hypotheses.effects, hypotheses.scale, strict=True):
        own = np.zeros((e.robot.n, len(motion.t), len(effect.parameters)))
        for block in effect.blocks(motion):
            own[block.joint][:, block.parameters] += block.columns
        found.append((own / hypotheses.noise[:, None, None]).reshape(len(X), -1) * scale)
    return X, found[0], found[1]


def decided_rightly(hypotheses: Hypotheses, motion: Motion, seconds: float, seed: int) -> float:
    """Share of right decisions at a length: noise of a motion repeated that often is as much smaller."""
    X, A, B = white(hypotheses, motion)
    span = motion.t[-1] + motion.t[1]
    rows_per_sample = hypotheses.row_rate * (motion.t[1] - motion.t[0])
    smaller = 1.0 / np.sqrt(rows_per_sample * seconds / span)
    rng, right = np.random.default_rng(seed), 0
    bases = [orthonormal(np.hstack([X, own])) for own in (A, B)]
    for truth, (own, other) in enumerate(((A, bases[1]), (B, bases[0]))):
        left = own - other @ (other.T @ own)
        _, vectors = np.linalg.eigh(left.T @ left)
        torque = own @ vectors[:, 0]
        for _ in range(DRAWS // 2):
            y = torque + smaller * rng.normal(size=len(torque))
            # What each model explains: more is a smaller sum of squares.
            explained = [float(np.sum((Q.T @ y) ** 2)) for Q in bases]
            price = smaller**2 * np.log(max(hypotheses.row_rate * seconds, 2.0))
            scores = [s - price * own.shape[1] for s, own in zip(explained, (A, B), strict=True)]
            right += int(np.argmax(scores) == truth)
    return right / (2 * (DRAWS // 2))


def main() -> None:
    problem = load_problem("panda")
    estimate = identify(problem, experiment(problem).training_run(), "ols")
    lines = [
        "# The run that tells two effects apart",
        "",
        "Simulated, by `python benchmarks/separation.py`: a Panda, each effect with a root mean square",
        f"of one noise standard deviation on the default excitation; runs of {DURATION:g} s,",
        f"{ITERATIONS} changes tried. Power: squared distance of the two hypotheses over that of the",
        f"default excitation of the same length. Seconds: for {100 * RIGHT:.0f} % right decisions,",
        f"stated. Right: of {DRAWS} simulated decisions at that length, the designed run repeated.",
        "",
        "| pair | power over default | seconds, default | seconds, designed | right |",
        "| --- | ---: | ---: | ---: | ---: |",
    ]
    for pair in PAIRS:
        found = separate(estimate, pair, duration=DURATION, level=1.0, iterations=ITERATIONS, seed=SEED)
        hypotheses = Hypotheses.of(estimate, pair, 1.0)
        motion = hypotheses.motion(found.trajectory.states, DURATION)
        if not np.isfinite(found.seconds):
            lines.append(f"| {pair} | never: the model's own parameters make one of them | | | |")
            continue
        right = decided_rightly(hypotheses, motion, found.seconds, SEED)
        power = found.delta2 / max(found.default_delta2, 1e-300)
        row = (
            f"| {pair} | {power:.3g} | {found.default_seconds:.3g} | {found.seconds:.3g} | {right:.3f} |"
        )
        lines.append(row)
        print(row, flush=True)
    write_text(OUT, "\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
