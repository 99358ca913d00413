"""The page's charts, which are the report's figures, and the arm in 3D: ellipsoids of
the links, moved with a run, a simulated arm beside the measured one."""

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from nicegui import ui
from scipy.spatial.transform import Rotation

from sdp_vs_penalty.diagnosis.comparison import Signals
from sdp_vs_penalty.diagnosis.curves.curve import Curve
from sdp_vs_penalty.diagnosis.findings import Finding
from sdp_vs_penalty.diagnosis.where_it_fails import Failures
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.estimation.constants import NORMAL_95
from sdp_vs_penalty.page.controls import button, chart, note, tag
from sdp_vs_penalty.page.session import ModelStep, Session
from sdp_vs_penalty.page.view import View
from sdp_vs_penalty.render import charts as plots
from sdp_vs_penalty.render.charts import COLOURS, MEASURED, POINTS, Curves, Figure
from sdp_vs_penalty.render.pieces import shades
from sdp_vs_penalty.render.words import cause_of


def torque_chart(
    run: Curves,
    joint: int,
    units: Sequence[str],
    span: tuple[float, float] | None = None,
    stretches: Sequence[tuple[float, float, str]] = (),
) -> dict[str, Any]:
    """Measured and modelled torque of one joint (from 0), and below it what is left.

    span : the seconds to look at; a long run shows more detail there; stretches : where
    the error is large, by cause.
    """
    t = run.t - run.t[0]
    cut = slice(None)
    if span is not None:
        edge = 0.25 * (span[1] - span[0])  # so that curves leave the picture
        low, high = np.searchsorted(t, (span[0] - edge, span[1] + edge))
        cut = slice(min(low, len(t) - 1), max(high, low + 1))
    part = Curves(
        t[cut], run.torque[cut], {name: m[cut] for name, m in run.modelled.items()}
    )
    plot = plots.torque_figure([part], joint, units[joint], side_by_side=False)
    plot.update_layout(shapes=shades(stretches))
    if span is not None:
        plot.update_axes("x", range=list(span))
    return ready(plot, 420)


def data_chart(read: Mapping[str, Any], units: Sequence[str]) -> dict[str, Any]:
    """Positions, velocities and torques of all joints on one time axis; what the check
    would put in place of a measured value, as crosses."""
    shown = [
        "q",
        "dq",
        *["torque"] * bool(np.any(read["torque"])),
    ]  # a log may hold none
    plot = Figure(rows=len(shown), gap=0.08)
    t = read["t"] - read["t"][0]
    for row, name in enumerate(shown):
        for j in range(len(units)):
            colour = COLOURS[j % len(COLOURS)]
            named = {"name": f"joint {j + 1}", "legendgroup": f"{j}"}
            look: dict[str, Any] = {
                "line": {"color": colour, "width": 1.2},
                "showlegend": row == 0,
            }
            plot.add("scatter", row, x=t, y=read[name][:, j], **look, **named)
            there = read.get(f"repaired_{name}")
            if there is not None and (rows := np.isfinite(there[:, j])).any():
                named["name"] += ", repaired"
                look = {
                    "marker": {"symbol": "x", "size": 5, "color": colour},
                    "showlegend": False,
                }
                plot.add(
                    "scatter",
                    row,
                    x=t[rows],
                    y=there[rows, j],
                    mode="markers",
                    **look,
                    **named,
                )
    kinds = "/".join(dict.fromkeys("m" if unit == "N" else "rad" for unit in units))
    titles = (
        f"q [{kinds}]",
        f"dq [{kinds}/s]",
        f"tau [{'/'.join(dict.fromkeys(units))}]",
    )
    for row, title in enumerate(titles[: len(shown)]):
        plot.update_axes("y", row, title=title)
    plot.update_axes("x", len(shown) - 1, title="time [s]")
    return ready(plot, 460)


def asked_span(event: Any) -> tuple[float, float] | bool | None:
    """What a plotly_relayout event asks for: a stretch of time, everything (None), or
    neither (False).

    >>> asked_span({"xaxis2.range[0]": 1, "xaxis2.range[1]": 2.5})
    (1.0, 2.5)
    """
    for axis in ("xaxis", "xaxis2") if isinstance(event, dict) else ():
        if event.get(f"{axis}.autorange"):
            return None
        ends = [event.get(f"{axis}.range[{k}]") for k in (0, 1)]
        if all(isinstance(end, int | float) for end in ends):
            return float(ends[0]), float(ends[1])
    return False


def missing_chart(
    curve: Curve, units: Sequence[str], read: Mapping[str, Any]
) -> dict[str, Any]:
    """A measured curve with its band, and where the rows of a recording lie."""
    motion = Motion(read["t"], read["q"], read["dq"], read["ddq"], read["modelled"])
    warm = any(v.startswith("temp") for v in curve.of)  # a recording holds none
    return ready(plots.missing_figure(curve, units, [] if warm else [motion]), 260)


def failing_stretches(
    model: ModelStep, run: str, j: int, start: float
) -> list[tuple[float, float, str]]:
    """Where joint j (from 0) fails on a run, in its seconds since ``start``, and the
    cause."""
    if not model.failures:
        return []
    name = run.partition(", ")[0]
    return [
        (s["start"] - start, s["stop"] - start, s["cause"])
        for s in model.failures[j]["stretches"]
        if s["run"].startswith(name)
    ]


def finding_chart(session: Session, finding: Finding) -> dict[str, Any] | None:
    """The error of a finding's joint against its cause: before, after everything sure
    was added, and what that models; None where the runs are too short to say a cause."""
    step = session.diagnosed
    if not step.failures or not step.pictures:
        return None
    read = session.arrays(step.pictures)
    before, after = [
        Signals(read["t"], read["q"], read["dq"], read["measured"], read[name])
        for name in ("before", "after")
    ]
    joint = finding.main_joint
    failures = Failures.from_dict({"units": (), "joints": step.failures})
    units = session.robot["units"]
    plot = plots.cause_figure(
        before,
        after if finding.torque_is_certain else None,
        joint=joint,
        cause=cause_of(failures, joint),
        units=units,
        position_units=["m" if unit == "N" else "rad" for unit in units],
        floor=step.comparison["noise_floor"],
    )
    return ready(plot, 240)


#: Signals that an error is drawn against, and their names.
SIGNALS = {
    "q": "position",
    "dq": "velocity",
    "ddq": "acceleration",
    "torque": "measured torque",
    "t": "time",
}


def residual_chart(
    reads: Sequence[Mapping[str, Any]],
    joint: int,
    signal: str,
    unit: str,
    floor: float | None,
    span: tuple[float, float] | None = None,
) -> dict[str, Any]:
    """What one or two models leave of a joint's torque against one of SIGNALS, the last
    one's reversals ringed; span : only these seconds of the run; in the band 95 % of
    noise lies."""
    read = reads[-1]
    t = reads[-1]["t"] - reads[-1]["t"][0]
    cut = slice(None) if span is None else slice(*np.searchsorted(t, span))
    if len(t[cut]) < 2:
        cut = slice(None)
    x = np.asarray(t if signal == "t" else read[signal][:, joint])[cut]
    *first, last = (
        (r["torque"][:, joint] - r["modelled"][:, joint])[cut] for r in reads
    )
    dq = read["dq"][cut, joint]
    keep = np.unique(np.linspace(0, len(dq) - 1, POINTS).astype(int))
    turns = np.flatnonzero(np.sign(dq[1:]) != np.sign(dq[:-1]))[:POINTS]
    looks = [  # in the colours of the torque's figure
        *(
            (keep, y, "error of the first model", {"size": 3, "color": COLOURS[0]})
            for y in first
        ),
        (keep, last, "error", {"size": 3, "color": COLOURS[len(first)]}),
        (
            turns,
            last,
            "reversals",
            {"size": 8, "symbol": "circle-open", "color": COLOURS[2]},
        ),
    ]
    plot = Figure()
    for rows, y, name, marker in looks:
        plot.add(
            "scatter", x=x[rows], y=y[rows], mode="markers", name=name, marker=marker
        )
    if floor is not None:
        place = {"type": "rect", "xref": "paper", "x0": 0, "x1": 1, "yref": "y"}
        look = {
            "layer": "below",
            "fillcolor": "rgba(128,128,128,0.15)",
            "line": {"width": 0},
        }
        plot.update_layout(
            shapes=[
                {**place, **look, "y0": -NORMAL_95 * floor, "y1": NORMAL_95 * floor}
            ]
        )
    way = "m" if unit == "N" else "rad"
    units = {"q": way, "dq": f"{way}/s", "ddq": f"{way}/s^2", "torque": unit, "t": "s"}
    plot.update_axes("x", title=f"{SIGNALS[signal]} [{units[signal]}]")
    plot.update_axes("y", title=f"error of joint {joint + 1} [{unit}]")
    return ready(plot, 320)


def ready(plot: Figure, height: int) -> dict[str, Any]:
    """Plain JSON; to be zoomed in time only."""
    plots.styled(plot, height).update_layout(
        margin={"l": 66, "r": 8, "t": 34, "b": 42}, dragmode="zoom"
    )
    plot.update_layout(template={"layout": {"yaxis": {"fixedrange": True}}})
    data: dict[str, Any] = json.loads(plot.to_json())
    return {**data, "config": {"displayModeBar": False, "responsive": True}}


def chart_and_arm(
    view: View, label: str, about: Mapping[str, Any], caption: str, arms: int = 1
) -> tuple[Any, Callable[..., None]]:
    """A chart over time, still empty, with ``label`` as its text, and beside it, where
    there are links to be drawn, the scene and its clock, of ``arms`` arms in one place.
    Returns the chart, and what to call with a recording: its name, its t, tf and poses,
    and the errors (F, n), 0 to 1, that colour the first arm's links, if any.

    about : of a model (jobs.py). workbench.js moves what is drawn here once: a group a
    joint, in it the links that it carries.
    """

    def clicked(event: Any) -> None:
        for hit in event.hits:
            name, _, link = hit.object_name.partition("-")
            if name in ("link", "measured") and link.isdigit():
                view.select(joint=min(int(link), len(view.session.robot["joints"]) - 1))
                return

    # of the camera's view [deg]; which recording is loaded
    angle = 14.0
    there = [""]
    with tag("div", style="pair"):
        drawn = chart({}, label).classes("timed")
        if not about["bodies"]:
            return drawn, lambda *_: None
        with tag("div", style="arm") as frame:
            look = {
                "width": 360,
                "height": 330,
                "grid": False,
                "background_color": "#f8f9fb",
            }
            camera = ui.scene.perspective_camera(fov=angle)
            with ui.scene(**look, on_click=clicked, camera=camera) as scene:  # type: ignore[arg-type]
                # The measured one beside the simulated one, in the colours of their
                # curves.
                drawn_arms = [("measured", MEASURED, 0.45), ("link", COLOURS[0], 0.75)][
                    -arms:
                ]
                groups = [
                    g
                    for drawn_arm in drawn_arms
                    for g in _one_arm(scene, about, drawn_arm)
                ]
            frame.props["data-arm"] = scene.id
            scene.props.update(
                {"role": "img", "aria-label": f"The arm in 3D: {caption}"}
            )
            with tag("div", style="row"):
                play = f"arms[{scene.id}]?.play()"
                button(
                    "Play",
                    lambda: ui.run_javascript(play),
                    f"play-{arms}",
                    data_play="",
                )
                bar = {"type": "range", "min": "0", "max": "1000", "value": "0"}
                how = {"data_key": f"time-{arms}", "data_time": scene.id}
                tag("input", "", "", **bar, **how, aria_label="Time in the run")
                tag("span", "0.0 s", "soft", data_clock="")
            note(
                f"Ellipsoids of uniform density; {caption}. Click a link to see its joint."
            )

    def load(name: str, read: Mapping[str, Any], errors: Any = None) -> None:
        if there == [name]:
            return
        there[:] = [name]
        poses = read["poses"]  # as places and unit quaternions (x, y, z, w): (F, k, 7)
        turned = Rotation.from_matrix(poses[..., :3, :3].reshape(-1, 3, 3)).as_quat()
        placed = np.dstack([poses[..., :3, 3], turned.reshape(*poses.shape[:2], 4)])
        moves = {
            "groups": [g.id for g in groups],
            "t": np.round(read["tf"] - read["t"][0], 3).tolist(),
            "poses": np.round(placed, 4).tolist(),
            "errors": [[0.0]] * len(read["tf"]) if errors is None else errors.tolist(),
        }
        scene.move_camera(
            **_camera(poses[:, : len(about["joints"])], about, angle), duration=0.0
        )
        ui.run_javascript(
            f"(arms[{scene.id}] ??= new Arm({scene.id})).load({json.dumps(moves)})"
        )

    return drawn, load


def _one_arm(scene: Any, about: Mapping[str, Any], look: tuple[str, str, float]) -> Any:
    """Joints and links of an arm, a group a joint; look : name, colour and solidity of
    its links."""
    (name, colour, solid), thin = look, 0.02 * _reach(about)
    groups = [scene.group() for _ in about["joints"]]
    for joint, group in zip(about["joints"], groups, strict=True):
        with scene if joint["parent"] < 0 else groups[joint["parent"]]:
            if np.linalg.norm(joint["at"]) > 1e-6:
                middle = [0.5 * x for x in joint["at"]]
                scene.quadratic_bezier_tube(
                    [0.0] * 3, middle, joint["at"], 1, thin
                ).material("#888888")
        with group:
            scene.sphere(thin, 12, 8).material("#888888")
    for body in about["bodies"]:
        with groups[body["joint"]]:
            place = np.array(body["place"])
            ball = (
                scene.sphere(1.0, 24, 16).scale(*body["half"]).material(colour, solid)
            )
            ball.with_name(f"{name}-{body['link']}").move(*place[:3, 3]).rotate_R(
                place[:3, :3].tolist()
            )
    return groups


def _reach(about: Mapping[str, Any]) -> float:
    """Of the arm [m], stretched out."""
    return sum(float(np.linalg.norm(j["at"])) for j in about["joints"]) or 0.5


def _camera(poses: Any, about: Mapping[str, Any], angle: float) -> dict[str, float]:
    """Where a camera stands and what it looks at, so that base and links of all poses
    (F, k, 4, 4) fill its picture, ``angle`` degrees high: the arguments of NiceGUI's
    ``move_camera``."""
    centres = [
        poses[:, body["joint"]] @ np.array(body["place"]) for body in about["bodies"]
    ]
    places = np.concatenate(
        [np.zeros((1, 3)), *(x[..., :3, 3] for x in (*centres, *poses.swapaxes(0, 1)))]
    )
    centre = 0.5 * (places.min(axis=0) + places.max(axis=0))
    radius = np.linalg.norm(places - centre, axis=1).max() + 0.1 * _reach(
        about
    )  # and a link's own
    direction = np.array([0.58, -0.63, 0.52]) / np.linalg.norm([0.58, -0.63, 0.52])
    eye = centre + radius / np.sin(0.5 * np.deg2rad(angle)) * direction
    names = "x", "y", "z", "look_at_x", "look_at_y", "look_at_z"
    return dict(zip(names, [*eye.tolist(), *centre.tolist()], strict=True))


def torque_errors(model: ModelStep, read: Mapping[str, Any]) -> Any:
    """(F, n) torque errors at the instants of the poses, 0 to 1: four times the noise
    floor, or where that is not known the error's own root mean square."""
    left = np.abs(read["torque"] - read["modelled"])
    rms = np.sqrt(np.mean(left**2, axis=0))
    floors = zip(model.comparison["noise_floor"], rms, strict=True)
    scale = 4.0 * np.array([max(f or x, 1e-12) for f, x in floors])
    at = np.searchsorted(read["t"], read["tf"]).clip(0, len(left) - 1)
    return np.round(np.clip(left[at] / scale, 0.0, 1.0), 2)
