"""Worlds of MuJoCo whose arm, effect and sizes are drawn, and what the program says.

    python results/bench/red_team.py [--worlds 58] [--seed SEED] [--logs FOLDER]

Of each thirteen worlds four have no effect. A world that is in red_team.csv is not judged
again, so that a run that was stopped goes on. Writes red_team.csv and red_team.md.
"""

import argparse
import json
import os
import re
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
HERE = Path(__file__).parent
sys.path[0] = str(HERE.parent)

import mujoco
import numpy as np
import pandas

from bench import judge
from bench.mujoco_worlds import ARMS, World, simulate
from bench.truth import Truth
from sdp_vs_penalty import add, compare
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.constants import NORMAL_95
from sdp_vs_penalty.estimation.estimate import load_estimate
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.paper.provenance import write_note
from sdp_vs_penalty.results.table import markdown_lines

SEED = 20261129
NAMES = "elbow", "scara", "panda", "desk"
#: Within this width [rad/s] dry friction turns round.
WIDTH = 0.02


#: What names the effect of a kind of worlds (regular expressions).
RIGHT = {
    "spring": "spring",
    "stribeck": "stribeck|stiction",
    "ripple": "ripple|gear error",
    "one_sided": "asymmetric",
    "places": "position.dependent friction",
    "late": "delay|late|filter",
    "early": "delay|early|ahead|lead|latency|later than",
    "bump": "force|contact|disturb|push|event|load",
    "tilt": "tilt|gravity|mount",
}


@dataclass(frozen=True)
class Drawn:
    """A world, what `add` calls its effect, and that effect's size or delay."""

    world: World
    #: As `add` takes it; empty where nothing is hidden, or where it has no name.
    text: str = ""
    size: float | None = None
    #: Seconds by which torques are logged late (below 0: early).
    delay: float | None = None


class Draw:
    """Draws what a world has: an arm, a joint, and sizes beside that joint's friction."""

    def __init__(self, number: int, seed: int) -> None:
        self.rng = np.random.default_rng([seed, number])
        self.arm = NAMES[number % len(NAMES)]
        model = mujoco.MjModel.from_xml_path(str(ARMS / f"{self.arm}.urdf"))
        self.joint = int(self.rng.integers(1, model.nv))
        self.friction = float(model.dof_frictionloss[self.joint])
        self.reach = float(np.minimum(0.35 * np.ptp(model.jnt_range, axis=1), 1.0)[1])

    def share(self, low: float, high: float) -> float:
        """Return a torque: the joint's dry friction, times a drawn factor."""
        return self.friction * float(self.rng.uniform(low, high))

    def clean(self) -> Drawn:
        """Draw a world with nothing but a width of friction that the model lacks."""
        width = float(self.rng.choice([0.01, 0.02, 0.05, 0.1]))
        truth = Truth("", silent=True)
        return Drawn(World(truth, "Nothing.", width=width, arm=self.arm))

    def _on_joint(
        self, right: str, text: str, size: float, law: Callable[[Any, Any], Any]
    ) -> Drawn:
        j = self.joint
        truth = Truth(right, (j + 1,))
        name, _, constants = text.partition("@")
        text = f"{name}:{j + 1}{constants and '@'}{constants}"

        def extra(q: Any, v: Any) -> Any:
            return np.eye(len(q))[j] * law(q[j], v[j])

        story = f"{text}, {size:.3g}"
        return Drawn(World(truth, story, extra, arm=self.arm), text, size)

    def spring(self) -> Drawn:
        """Draw a joint spring."""
        k = self.share(0.6, 1.5)
        return self._on_joint(RIGHT["spring"], "joint_spring", k, lambda q, _: k * q)

    def stribeck(self) -> Drawn:
        """Draw more friction at low speed."""
        a, vs = self.share(0.4, 1.0), float(self.rng.uniform(0.07, 0.15))
        text = f"stribeck_friction@vs={vs:.4g}@delta=2"
        return self._on_joint(
            RIGHT["stribeck"],
            text,
            a,
            lambda _, v: a * np.exp(-((v / vs) ** 2)) * np.tanh(v / WIDTH),
        )

    def ripple(self) -> Drawn:
        """Draw a torque with some waves per turn."""
        a, k = self.share(0.2, 0.5), int(self.rng.integers(5, 20))
        text = f"torque_ripple@k={k}"
        return self._on_joint(RIGHT["ripple"], text, a, lambda q, _: a * np.sin(k * q))

    def one_sided(self) -> Drawn:
        """Draw viscous friction that differs between directions."""
        a = self.share(0.3, 0.8)
        text = "asymmetric_viscous_friction"
        return self._on_joint(RIGHT["one_sided"], text, a, lambda _, v: a * abs(v))

    def places(self) -> Drawn:
        """Draw dry friction that depends on position."""
        a, k = self.share(0.3, 0.7), int(self.rng.integers(2, 5))
        text = f"position_dependent_friction@k={k}@waves=1"
        return self._on_joint(
            RIGHT["places"],
            text,
            a,
            lambda q, v: a * np.sin(k * q) * np.tanh(v / WIDTH),
        )

    def late(self) -> Drawn:
        """Draw a log whose torques are late, by 1 to 15 ms."""
        ms = int(self.rng.integers(1, 16))
        truth = Truth(RIGHT["late"])
        world = World(truth, f"{ms} ms late.", late=1e-3 * ms, arm=self.arm)
        return Drawn(world, f"global_delay@T={1e-3 * ms}", delay=1e-3 * ms)

    def early(self) -> Drawn:
        """Draw drives that act 1 to 15 ms after the command, which is logged."""
        ms = int(self.rng.integers(1, 16))
        truth = Truth(RIGHT["early"])
        late = 1e-3 * ms
        world = World(
            truth, f"{ms} ms early.", latency=late, stiffness=100.0, arm=self.arm
        )
        return Drawn(world, f"global_delay@T={-1e-3 * ms}", delay=-1e-3 * ms)

    def bump(self) -> Drawn:
        """Draw a push of 33 N for one second in one run."""
        return Drawn(
            World(Truth(RIGHT["bump"]), "33 N for 1 s.", bump=True, arm=self.arm)
        )

    def tilt(self) -> Drawn:
        """Draw a base that leans by 1 to 4 degrees."""
        angle = np.deg2rad(self.rng.uniform(1.0, 4.0))
        round_z = self.rng.uniform(-np.pi, np.pi)
        side = np.sin(angle)
        down = (side * np.cos(round_z), side * np.sin(round_z), -np.cos(angle))
        story = f"The base leans by {np.rad2deg(angle):.2g} degrees."
        truth = Truth(RIGHT["tilt"])
        return Drawn(World(truth, story, gravity=down, arm=self.arm), "base_tilt")


#: Kinds of worlds, in turn.
KINDS: tuple[Callable[[Draw], Drawn], ...] = (
    Draw.clean,
    Draw.spring,
    Draw.stribeck,
    Draw.clean,
    Draw.late,
    Draw.ripple,
    Draw.early,
    Draw.clean,
    Draw.one_sided,
    Draw.places,
    Draw.bump,
    Draw.clean,
    Draw.tilt,
)


@dataclass(frozen=True)
class Row:
    """What came of a world."""

    number: int
    kind: str
    arm: str
    story: str
    outcome: str
    #: Whether the first sure claim, or the first of all where none is sure, is right.
    first: str
    false_check: str
    false_diagnose: str
    #: A sure claim of a filter or delay that nobody made.
    ghost: str
    contradiction: str
    #: The joints' largest ratio of errors on fresh motion with what `add` adds.
    largest_ratio: str
    #: Of the error that the true effect removes on fresh motion, what `add` removes.
    removed: str
    #: Estimate, half the 95 % interval and truth of the size.
    size: str
    #: Estimated and true delay [ms].
    delay: str
    said: str
    seconds: float


def judged(number: int, seed: int, logs: Path) -> Row:
    """Make a world unless it is there, and judge what is said of it."""
    kind = KINDS[number % len(KINDS)]
    draw = Draw(number, seed)
    drawn = kind(draw)
    folder = logs / f"{seed}-{number}"
    if not (folder / "truth.json").exists():
        simulate(drawn.world, draw.rng, folder)
    row = judge.judge("red team", folder, judge.said_of)
    claims = [x for x in row.said.split("; ") if x and not x.startswith("as well")]
    sure = [x for x in claims if not x.startswith("(possible)")]
    truth = drawn.world.truth
    first = (sure or claims or [""])[0]
    named = bool(truth.right) and judge.matches(truth.right, first)
    false = f"{row.false_check}; {row.false_diagnose}"
    effects = _sure_effects(folder)
    return Row(
        number,
        kind.__name__,
        draw.arm,
        drawn.world.story,
        row.outcome,
        str(named) if truth.right else "",
        row.false_check,
        row.false_diagnose,
        str(judge.matches("filter|delay|late|early", false)),
        row.contradiction,
        row.largest_ratio,
        _removed(drawn, folder, bool(row.mean_ratio)),
        _size(drawn, effects),
        _delay(drawn, effects),
        row.said,
        row.seconds,
    )


def _sure_effects(folder: Path) -> list[dict[str, Any]]:
    path = folder / "findings.json"
    if not path.exists():
        return []
    found = json.loads(path.read_text("utf-8"))["effects"]
    return [x for x in found if x["rating"] != "weak"]


def _size(drawn: Drawn, effects: Sequence[dict[str, Any]]) -> str:
    name = drawn.text.partition(":")[0]
    for x in effects if drawn.size else ():
        if x["effect"] == name and x["joints"] == list(drawn.world.truth.joints):
            half = NORMAL_95 * x["std"]
            return f"{abs(x['size']):.4g} ± {half:.2g} for {drawn.size:.4g}"
    return ""


def _delay(drawn: Drawn, effects: Sequence[dict[str, Any]]) -> str:
    for x in effects if drawn.delay else ():
        if x["effect"] == "global_delay":
            half = NORMAL_95 * x["std"]
            return f"{1e3 * x['size']:.4g} ± {1e3 * half:.2g} for {1e3 * drawn.delay:g}"
    return ""


def _removed(drawn: Drawn, folder: Path, added: bool) -> str:
    """Return the share of the true effect's gain on fresh motion; 0 if nothing is
    added."""
    if not drawn.text or not (folder / "model.json").exists():
        return "0" if drawn.text else ""
    fresh = str(folder / "fresh.csv")
    runs = sorted(map(str, folder.glob("run*.csv")))
    model = load_estimate(folder / "model.json")
    joints = [j - 1 for j in drawn.world.truth.joints] or slice(None)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            best = compare(add(model, drawn.text, runs), fresh)[0].rmse[joints].sum()
        except InputError as error:
            return f"not added: {error}"[:60]
        bare = compare(model, fresh)[0].rmse[joints].sum()
        if not added:
            return "0"
        mine = load_estimate(folder / "added.json")
        left = compare(mine, fresh)[0].rmse[joints].sum()
    return f"{(bare - left) / (bare - best):.3g}"


def facts(rows: Sequence[Row]) -> Iterator[tuple[str, str]]:
    """Yield what the worlds show, each in words and figures."""
    false = [r for r in rows if r.false_check or r.false_diagnose]
    hidden = [r for r in rows if r.first]
    clean = [r for r in rows if not r.first]
    yield "worlds, and those with an effect", f"{len(rows)}; {len(hidden)}"
    yield "confident and false", str(len(false))
    wrong = [r for r in clean if r.false_diagnose]
    yield "false effects added to clean arms", f"{len(wrong)} of {len(clean)}"
    yield "ghost filters or delays, sure", str(sum(r.ghost == "True" for r in rows))
    others = [r for r in rows if r.kind not in {"late", "early"}]
    ghosts = sum("torque filter" in r.said or "torque delay" in r.said for r in others)
    yield "ghost filters or delays, weak ones too", f"{ghosts} of {len(others)}"
    right = sum(r.outcome == "right" for r in hidden)
    yield "named by a sure claim", f"{right} of {len(hidden)}"
    first = sum(_first_effect_is_right(r) for r in hidden)
    yield "first effect right, sure or not", f"{first} of {len(hidden)}"
    first = sum(r.first == "True" for r in hidden)
    yield "first sure claim right, constants count", f"{first} of {len(hidden)}"
    bumps = [r for r in rows if r.kind == "bump"]
    named = sum(r.outcome == "right" for r in bumps)
    yield "bumps named", f"{named} of {len(bumps)}"
    ratios = [float(r.largest_ratio) for r in rows if r.largest_ratio[:1].isdigit()]
    raised = sum(x > judge.RAISED for x in ratios)
    yield "a joint over 5 % worse on fresh motion", f"{raised} of {len(ratios)}"
    shares = [float(r.removed) for r in rows if re.match(r"-?\d", r.removed)]
    yield (
        "of what the true effect removes on fresh motion `add` removes, median",
        f"{np.median(shares):.2f} of {len(shares)}" if shares else "",
    )
    for word, cells in (
        ("sizes", [r.size for r in rows if r.size]),
        ("delays", [r.delay for r in rows if r.delay]),
    ):
        held = sum(map(_holds, cells))
        yield f"{word} in their 95 % interval", f"{held} of {len(cells)}"
    contradictions = sum(bool(r.contradiction) for r in rows)
    yield "contradictions of check and diagnose", str(contradictions)
    yield "CPU a world [s]", f"{np.mean([r.seconds for r in rows]):.1f}"


def _first_effect_is_right(row: Row) -> bool:
    """Whether the first effect that is said, sure or not, has the kind's name and is on
    a joint of its world."""
    said = [x for x in row.said.split("; ") if not x.startswith(("as well", "re-est"))]
    first = said[0] if said else ""
    place = re.search(r":(\d+)", row.story)
    named = judge.matches(RIGHT[row.kind], first)
    return named and (place is None or f"joint {place[1]}" in first)


def _holds(text: str) -> bool:
    estimate, half, truth = map(float, text.replace("±", "for").split("for"))
    return abs(estimate - truth) <= half


def markdown(rows: Sequence[Row], seed: int) -> str:
    """Write the figures, and each world that is not right."""
    lines = markdown_lines(["what", "figure"], [[*x] for x in facts(rows)])
    text = ["# Drawn worlds of MuJoCo", "", f"Seed {seed}.", "", *lines, ""]
    heads = [
        "world",
        "arm",
        "what it has",
        "outcome",
        "false",
        "removed",
        "size, delay",
    ]
    cells = [
        [
            f"{r.number} {r.kind}",
            r.arm,
            r.story,
            r.outcome,
            "; ".join(filter(None, (r.false_check, r.false_diagnose))),
            r.removed,
            r.size or r.delay,
        ]
        for r in rows
    ]
    return "\n".join([*text, *markdown_lines(heads, cells)]) + "\n"


def main() -> None:
    """Read the options and run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--worlds", type=int, default=58)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--logs", type=Path, default=HERE / "logs" / "red_team")
    parser.add_argument("--out", type=Path, default=HERE)
    options = parser.parse_args()
    table = options.out / "red_team.csv"
    rows = []
    if table.exists():
        frame = pandas.read_csv(table, keep_default_na=False, dtype=str)
        for values in frame.to_dict("records"):
            values |= {"number": int(values["number"])}
            values |= {"seconds": float(values["seconds"])}
            rows.append(Row(**values))
    known = {row.number for row in rows}
    for number in range(options.worlds):
        if number in known:
            continue
        rows.append(judged(number, options.seed, options.logs))
        print(*list(asdict(rows[-1]).values())[:14], sep=" | ", flush=True)
        frame = pandas.DataFrame([asdict(row) for row in rows])
        write_text(table, frame.to_csv(index=False, lineterminator="\n"))
        write_text(options.out / "red_team.md", markdown(rows, options.seed))
    write_note(
        options.out,
        [["results/bench/red_team.py", "--seed", str(options.seed)]],
        sum(row.seconds for row in rows),
        [["results/bench/make.py"], ["results/bench/make.py", "--engine", "greedy"]],
    )


if __name__ == "__main__":
    main()
