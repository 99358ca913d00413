"""How often 95 % intervals hold the truth where everything varies that varies in life.

    python results/coverage_in_life/coverage_in_life.py [--draws 160] [--seed 0] [--out FILE]

Each draw has a robot of its own (2 to 4 joints, some of which slide), links that are
not the prior's centre, friction, a random motion of 14 s, torque noise (white or slow,
0.5 to 5 %), and an encoder (quantised, white noise). *Planned*: the robot moves as
planned. *Closed loop*: a PID controller with feed-forward sees the encoder, so that its
noise, and a slow disturbance of 0.5 to 2 % of the torque, come back in both channels.
Arms are those of `results/corruptions`; friction, controller and channels those of
`results/challenge`, which share nothing with the library. What is judged is
`identify` as users call it, shape constants, filters and prior included; a run that it
refuses is not counted.
"""

import argparse
import os
import sys
from dataclasses import replace
from pathlib import Path

os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
if __name__ == "__main__":  # for this process and its workers
    sys.path[0] = str(Path(__file__).parents[1])

import numpy as np
from challenge.cases import USUAL
from challenge.judge import share
from challenge.worlds.conditions import Channel, Conditions, RatedArm, SensorNoise, Site
from challenge.worlds.motion import driven
from challenge.worlds.runs import arm_of, draw_motion, draw_world, log_run
from corruptions.arms import believed, drawn, true_model

from sdp_vs_penalty import identify
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.regression.base_parameters import base_rows
from sdp_vs_penalty.results.table import markdown_lines

TURN = (
    0.04,
    0.06,
)  # rad/s over which dry friction turns round, of slides half of that in m/s
# rad, of the encoder
QUANTUM = 2.0 * np.pi / 2**17
JITTER = 2e-5
#: Remembers 250 samples: of the log half a second, of a disturbance half of that.
WHITE = SensorNoise(colour=0.0)
SLOW = SensorNoise(colour=0.996)


def measured(
    arm: RatedArm, closed: bool, rng: np.random.Generator
) -> tuple[Site, Measurements]:
    """The true robot, and its run as planned or in a closed loop."""
    noise = WHITE if rng.random() < 0.5 else SLOW
    kind = str(rng.choice(["periodic", "aperiodic"]))
    usual = Conditions(width=TURN, channel=Channel(step=QUANTUM), duration=14.0)
    world = draw_world(replace(usual, noise=noise, motion=kind), rng, arm=arm)
    motion = draw_motion(world, 0, rng)
    size = world.torque(motion).std(axis=0)
    jitter = JITTER * arm.unit_speed * rng.normal(size=motion.q.shape)
    pull = np.zeros_like(motion.q)
    if closed:
        pull = SLOW.draw(len(motion.t), rng.uniform(0.005, 0.02) * size, rng)
        motion = driven(world, motion, pull, jitter)
    world = replace(world, noise=rng.uniform(0.005, 0.05) * size)
    return world, log_run(world, motion, rng, [pull], jitter).run


def draw(seed: int, closed: bool) -> dict[str, tuple[float, float]]:
    """Share of the intervals that hold the truth, and their median width, by quantity;
    of a run that is refused nothing."""
    rng = np.random.default_rng([seed, 77])
    axes = drawn(seed, 2, 4)
    model = true_model(axes, rng)
    n = len(axes)
    # N m, of dry friction, and of viscous friction at 1 rad/s.
    friction = np.array([2.5 * 0.7**k for k in range(n)])
    world, run = measured(
        replace(arm_of(model), coulomb=friction, viscous=friction), closed, rng
    )
    links = np.concatenate(
        [body.toDynamicParameters() for body in list(model.inertias)[1:]]
    )
    rubs = np.concatenate([world.viscous, world.coulomb, world.offset])
    try:
        estimate = identify(problem := believed("drawn", axes), run, effects=USUAL)
    except InputError:
        return {}
    base = base_rows(estimate.model, problem.independent).rows[: -3 * n]
    own = estimate.uncertainty
    out = {}
    for name, truth, intervals in (
        ("base parameters", base @ np.append(links, rubs), own.base[: len(base)]),
        ("friction", rubs, own.standard[-3 * n :]),
    ):
        pairs = [
            (x, i) for x, i in zip(truth, intervals, strict=True) if np.isfinite(i.std)
        ]
        held = float(np.mean([i.lower <= x <= i.upper for x, i in pairs]))
        out[name] = held, float(np.median([i.upper - i.lower for _, i in pairs]))
    return out


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--draws", type=int, default=160, help="of each situation")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("results", "coverage_in_life", "coverage_in_life.md"),
    )
    chosen = parser.parse_args()
    seeds = range(chosen.seed, chosen.seed + chosen.draws)
    rows = []
    for word in ("planned", "closed loop"):
        draws = [found for k in seeds if (found := draw(k, word == "closed loop"))]
        for name in draws[0]:
            held, widths = np.transpose([found[name] for found in draws])
            rows.append(
                [word, name, *share(held.sum(), len(draws)), f"{np.median(widths):.2g}"]
            )
    head = ["situation", "quantity", "draws", "coverage", "Wilson 95 %", "median width"]
    about = (__doc__ or "").split("\n\n")[2]
    call = (
        f"    python results/coverage_in_life/coverage_in_life.py --draws {chosen.draws} --seed"
        f" {chosen.seed}"
    )
    text = [
        "# Coverage of 95 % intervals, in life",
        "",
        *about.splitlines(),
        "",
        call,
        "",
    ]
    text += [*markdown_lines(head, rows), ""]
    write_text(chosen.out, "\n".join(text))
    print("\n".join(text))


if __name__ == "__main__":
    main()
