"""The arm in 3D: ellipsoids of the links, moved with a run; a simulated arm beside the measured one."""

import json
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from nicegui import ui
from scipy.spatial.transform import Rotation

from sdp_vs_penalty.page.controls import button, chart, note, tag
from sdp_vs_penalty.page.summary import ModelStep
from sdp_vs_penalty.page.view import View
from sdp_vs_penalty.reports.plots import COLOURS, MEASURED

#: The colour is full where the error is so many times its noise floor, or where that is not known its
#: own root mean square.
_FULL = 4.0
#: The camera's direction, and its angle of view [deg].
_TOWARDS = np.array([0.58, -0.63, 0.52]) / np.linalg.norm([0.58, -0.63, 0.52])
_ANGLE = 14.0
#: Names, colours and solidity of an arm alone, and of the measured one beside the simulated one: those
#: of their curves.
_LOOKS = {1: [("link", "#0072b2", 0.75)], 2: [("measured", MEASURED, 0.45), ("link", COLOURS[0], 0.75)]}


def chart_and_arm(
    view: View,
    options: Mapping[str, Any],
    label: str,
    about: Mapping[str, Any],
    said: str,
    arms: int = 1,
) -> tuple[Any, Callable[..., None]]:
    """A chart over time (``options``, with ``label`` as its text) and beside it :func:`draw_arm`, where
    there are links to be drawn; returns the chart, and what to call with a recording."""
    with tag("div", style="pair"):
        drawn = chart(options, label).classes("timed")
        move = draw_arm(view, about, said, arms) if about["bodies"] else lambda *_: None
    return drawn, move


def draw_arm(view: View, about: Mapping[str, Any], said: str, arms: int = 1) -> Callable[..., None]:
    """The scene and its clock, of ``arms`` arms in one place; returns what to call with a recording: its
    name, its t, tf and poses, and the errors (F, n), 0 to 1, that colour the first arm's links, if any.

    about : of a model (summary.py). workbench.js moves what is drawn here once: a group a joint, in it
    the links that it carries.
    """
    joints, bodies = about["joints"], about["bodies"]

    def clicked(event: Any) -> None:
        for hit in event.hits:
            name, _, link = hit.object_name.partition("-")
            if name in ("link", "measured") and link.isdigit():
                view.look(joint=min(int(link), len(view.session.robot["joints"]) - 1))
                return

    reach = sum(float(np.linalg.norm(j["at"])) for j in joints) or 0.5
    with tag("div", style="arm") as frame:
        with ui.scene(
            width=360,
            height=330,
            grid=False,
            background_color="#f8f9fb",
            on_click=clicked,
            camera=ui.scene.perspective_camera(fov=_ANGLE),
        ) as scene:
            shapes = view.session.robot["drawn"]["shapes"]
            groups = [g for look in _LOOKS[arms] for g in _one_arm(scene, about, shapes, reach, *look)]
        frame.props["data-arm"] = scene.id
        scene.props["role"] = "img"
        scene.props["aria-label"] = f"The arm in 3D: {said}"
        with tag("div", style="row"):
            play = f"arms[{scene.id}]?.play()"
            button("Play", lambda: ui.run_javascript(play), f"play-{arms}", data_play="")
            tag(
                "input", type="range", min="0", max="1000", value="0", data_key=f"time-{arms}",
                data_time=scene.id, aria_label="Time in the run",
            )  # fmt: skip
            tag("span", "0.0 s", "soft", data_clock="")
        note(f"Ellipsoids of uniform density; {said}. Click a link to see its joint.")

    there = [""]

    def load(name: str, read: Mapping[str, Any], errors: Any = None) -> None:
        if there[0] == name:
            return
        there[0] = name
        # Places and unit quaternions (x, y, z, w): (F, k, 7).
        turned = Rotation.from_matrix(read["poses"][..., :3, :3].reshape(-1, 3, 3)).as_quat()
        turned = turned.reshape(*read["poses"].shape[:2], 4)
        placed = np.concatenate([read["poses"][..., :3, 3], turned], axis=-1)
        moves = {
            "groups": [g.id for g in groups],
            "t": np.round(read["tf"] - read["t"][0], 3).tolist(),
            "poses": np.round(placed, 4).tolist(),
            "errors": [[0.0]] * len(read["tf"]) if errors is None else errors.tolist(),
        }
        scene.move_camera(**_camera(read["poses"][:, : len(joints)], bodies, reach), duration=0.0)
        ui.run_javascript(f"(arms[{scene.id}] ??= new Arm({scene.id})).load({json.dumps(moves)})")

    return load


def _one_arm(
    scene: Any,
    about: Mapping[str, Any],
    shapes: Sequence[Mapping[str, Any]],
    reach: float,
    name: str,
    colour: str,
    solid: float,
) -> list[Any]:
    """Joints and links of an arm, in a group a joint; shapes : of its URDF (summary.py)."""
    groups = [scene.group() for _ in about["joints"]]
    for joint in about["joints"]:
        if float(np.linalg.norm(joint["at"])) > 1e-6:
            with scene if joint["parent"] < 0 else groups[joint["parent"]]:
                middle = [0.5 * x for x in joint["at"]]
                rod = scene.quadratic_bezier_tube([0.0] * 3, middle, joint["at"], 1, 0.02 * reach)
                rod.material("#888888")
    for k, group in enumerate(groups):
        with group:
            scene.sphere(0.02 * reach, 12, 8).material("#888888")
            for shape in (s for s in shapes if s["joint"] == k):
                scene.stl(f"data:model/stl;base64,{shape['stl']}").material("#888888", 0.35 * solid)
            for body in (b for b in about["bodies"] if b["joint"] == k):
                place = np.array(body["place"])
                ball = scene.sphere(1.0, 24, 16).scale(*body["half"])
                ball.material(colour, solid).with_name(f"{name}-{body['link']}")
                ball.move(*place[:3, 3]).rotate_R(place[:3, :3].tolist())
    return groups


def _camera(poses: Any, bodies: list[dict[str, Any]], reach: float) -> dict[str, float]:
    """Where a camera stands and what it looks at, so that base, joints and links of all poses
    (F, k, 4, 4) fill its picture: the arguments of NiceGUI's ``move_camera``.

    reach : of the arm [m]; half axes above half of it are of links that the data hardly determine, and
    may leave the picture."""
    places = [np.zeros((1, 3)), poses[..., :3, 3].reshape(-1, 3)]
    for body in bodies:
        frames = poses[:, body["joint"]] @ np.array(body["place"])
        ends = np.minimum(body["half"], 0.5 * reach) * frames[:, :3, :3]
        for sign in (1.0, -1.0):
            places.append((frames[:, :3, 3, None] + sign * ends).swapaxes(1, 2).reshape(-1, 3))
    right = np.cross([0.0, 0.0, 1.0], _TOWARDS)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(_TOWARDS, right), _TOWARDS])  # across, up, towards the camera
    seen = np.concatenate(places) @ axes.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    centre = 0.5 * (low + high) @ axes
    away = 0.5 * (high - low)[2] + 0.5 * max((high - low)[:2]) / np.tan(0.5 * np.deg2rad(_ANGLE))
    both = zip("xyz", centre + away * _TOWARDS, centre, strict=True)
    return {
        name: float(x) for axis, eye, at in both for name, x in ((axis, eye), (f"look_at_{axis}", at))
    }


def torque_errors(model: ModelStep, read: Mapping[str, Any]) -> Any:
    """(F, n) torque errors at the instants of the poses, 0 to 1."""
    left = np.abs(read["torque"] - read["modelled"])
    own = np.sqrt(np.mean(left**2, axis=0))
    floors = zip(model.comparison["noise_floor"], own, strict=True)
    scale = _FULL * np.array([max(f or x, 1e-12) for f, x in floors])
    at = np.searchsorted(read["t"], read["tf"]).clip(0, len(left) - 1)
    return np.round(np.clip(left[at] / scale, 0.0, 1.0), 2)
