"""Draw docs/story.gif: the demo's arm moves, and its errors shrink when the hidden
effect is found.

    python docs/tools/draw_animation.py [FILE]

Runs the demo, then draws what it has written. Needs the extras [report] and [plot].
"""

from __future__ import annotations

import io
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from sdp_vs_penalty import compare, load_estimate
from sdp_vs_penalty.colours import AFTER, BEFORE, PALETTE
from sdp_vs_penalty.diagnosis.comparison import Comparison
from sdp_vs_penalty.effects import effect_name
from sdp_vs_penalty.reports.demo import demo

ROOT = Path(__file__).parents[2]

#: Seconds of the test run that are shown: first with one model, then with the other.
SHOWN = (3.0, 11.0)
#: Frames a second of the picture, frames of one pass over these seconds, and frames in
#: which the bars shrink.
RATE = 10
PASS = 40
SHRINKS = 12
#: Colours of the joint that lacks something, and of the arm.
TROUBLE = PALETTE[1]
ARM = "#404040"
#: From the joint in trouble to its name [m].
LABEL = (-0.1, 0.0, 0.08)
#: Size [inch] and resolution [pixels an inch], and colours of the palette.
SIZE = (9.0, 3.6)
RESOLUTION = 140
COLOURS = 48


@dataclass(frozen=True)
class Story:
    """What the demo left: both models on the test run, and the joint that lacks
    something (from 0)."""

    before: Comparison
    after: Comparison
    joint: int
    finding: str

    @classmethod
    def of(cls, folder: Path) -> Story:
        """Read the demo's folder."""
        models = {
            name: load_estimate(folder / f"{name}.json") for name in ("model", "better")
        }
        before, after = compare(models, folder / "test.csv")
        known = {effect.name for effect in models["model"].model.effects}
        added = [e for e in models["better"].model.effects if e.name not in known]
        (effect,) = added
        (joint,) = effect.joints
        return cls(before, after, joint, effect_name(effect.name))

    def errors(self, share: float) -> np.ndarray:
        """(n,) error over noise on the way from before (0) to after (1), on a log
        scale."""
        assert self.before.noise_floor is not None
        first = self.before.rmse / self.before.noise_floor
        last = self.after.rmse / self.before.noise_floor
        return np.asarray(first ** (1.0 - share) * last**share)


def draw(story: Story) -> list[Image.Image]:
    """All frames."""
    import matplotlib as mpl

    mpl.use("Agg")
    arm = positions_of(story)
    return [draw_frame(story, arm, k) for k in range(2 * PASS)]


def positions_of(story: Story) -> np.ndarray:
    """(PASS, L + 1, 3) where the joints are [m], from the base on."""
    signals = story.before.signals
    robot = story.before.estimate.model.robot
    t = np.linspace(*SHOWN, PASS) + signals.t[0]
    q = np.column_stack([np.interp(t, signals.t, column) for column in signals.q.T])
    (state,) = robot.tree_state(q)
    origins = robot.poses(state)[:, :, :3, 3]
    base = np.zeros((PASS, 1, 3))
    return np.concatenate([base, origins], axis=1)


def draw_frame(story: Story, arm: np.ndarray, k: int) -> Image.Image:
    """One frame: the arm, the joint's error over time, each joint's error over noise."""
    import matplotlib.pyplot as plt

    share = float(np.clip((k - PASS) / SHRINKS, 0.0, 1.0))
    figure = plt.figure(figsize=SIZE, dpi=RESOLUTION)
    place = figure.add_axes((-0.03, 0.0, 0.32, 0.86), projection="3d")
    draw_arm(place, arm[k % PASS], story.joint)
    draw_error(figure.add_axes((0.345, 0.17, 0.28, 0.58)), story, k)
    draw_bars(figure.add_axes((0.71, 0.17, 0.27, 0.58)), story, share)
    verb, sentence = text_of(story, k)
    figure.text(0.02, 0.91, verb, fontsize=14, weight="bold", color="#202020")
    figure.text(0.14, 0.91, sentence, fontsize=14, color="#202020")
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=RESOLUTION)
    plt.close(figure)
    return Image.open(buffer).convert("RGB")


def text_of(story: Story, k: int) -> tuple[str, str]:
    """What the frame says: the verb of the command line, and what came of it."""
    joint = story.joint + 1
    if k < PASS // 2:
        error = story.before.errors.words(joint)
        return "identify", f"every link can exist, but joint {joint} errs {error}"
    if k < PASS:
        return "diagnose", f"what is missing: {story.finding} on joint {joint}"
    error = story.after.errors.words(joint)
    return "add", f"joint {joint} now errs {error}, on motion never seen"


def draw_arm(axes: Any, points: np.ndarray, joint: int) -> None:
    """The arm as a line from joint to joint; the joint in trouble has a colour."""
    x, y, z = points.T
    place = joint + 1
    axes.plot(x, y, z, color=ARM, lw=5, solid_capstyle="round")
    axes.scatter(x[1:place], y[1:place], z[1:place], color=ARM, s=36, depthshade=False)
    axes.scatter(*points[place], color=TROUBLE, s=110, depthshade=False)
    axes.text(*(points[place] + LABEL), f"joint {place}", color=TROUBLE, fontsize=10)
    axes.set(xlim=(-0.8, 0.8), ylim=(-0.8, 0.8), zlim=(0.0, 1.1))
    axes.view_init(elev=16, azim=-50)
    axes.set_axis_off()
    axes.set_box_aspect((1.0, 1.0, 0.69), zoom=1.5)


def draw_error(axes: Any, story: Story, k: int) -> None:
    """The error of the joint over time, up to now: first before, then after."""
    j = story.joint
    signals = story.before.signals
    t = signals.t - signals.t[0]
    now = SHOWN[0] + (SHOWN[1] - SHOWN[0]) * (k % PASS + 1) / PASS
    begun = t >= SHOWN[0]
    grey = begun & ((t < now) | (k >= PASS))
    blue = begun & (t < now) & (k >= PASS)
    before = story.before.signals.residual[:, j]
    after = story.after.signals.residual[:, j]
    axes.plot(t[grey], before[grey], color=BEFORE, lw=1.2)
    axes.plot(t[blue], after[blue], color=AFTER, lw=1.4)
    limit = 1.15 * np.abs(before[begun & (t < SHOWN[1])]).max()
    axes.set(xlim=SHOWN, ylim=(-limit, limit), xlabel="time [s]")
    axes.set_title(f"Error of joint {j + 1} [N m]", fontsize=10, loc="left")
    tidy(axes)


def draw_bars(axes: Any, story: Story, share: float) -> None:
    """Error over noise of each joint, on a log scale."""
    errors = story.errors(share)
    joints = np.arange(1, len(errors) + 1)
    colours = [BEFORE if share == 0.0 else AFTER] * len(errors)
    axes.bar(joints, errors, color=colours, width=0.7)
    axes.axhline(1.0, color="#202020", lw=1.0, ls=":")
    axes.set(yscale="log", ylim=(0.5, 30.0), xlabel="joint")
    axes.set_yticks([1, 2, 5, 10, 20], ["1", "2", "5", "10", "20"])
    axes.set_xticks(joints)
    axes.minorticks_off()
    axes.set_title("Error over noise, times", fontsize=10, loc="left")
    tidy(axes)


def tidy(axes: Any) -> None:
    """Two lines instead of a box, small figures."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=9)


def save(frames: list[Image.Image], path: Path) -> None:
    """Write a picture that repeats, and rests on its last frame."""
    palette = frames[-1].quantize(COLOURS)
    shown = [
        frame.quantize(COLOURS, palette=palette, dither=Image.Dither.NONE)
        for frame in frames
    ]
    durations = [1000 // RATE] * (len(shown) - 1) + [3000]
    shown[0].save(
        path,
        save_all=True,
        append_images=shown[1:],
        duration=durations,
        loop=0,
        optimize=True,
    )


if __name__ == "__main__":
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs" / "story.gif"
    with tempfile.TemporaryDirectory() as work:
        demo(work)
        save(draw(Story.of(Path(work))), target)
