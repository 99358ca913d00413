"""The arm in 3D: ellipsoids of the links, moved with a run and coloured by the error of their torque."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from nicegui import ui
from scipy.spatial.transform import Rotation

from sdp_vs_penalty.page.controls import button, tag
from sdp_vs_penalty.page.summary import Rung
from sdp_vs_penalty.page.view import View

#: The colour is full where the error is so many times its noise floor, or where that is not known its
#: own root mean square.
_FULL = 4.0
#: The camera's distance in radii of what it sees, at 75 degrees.
_AWAY = 1.4


def draw_arm(view: View, model: Rung) -> Any:
    """The scene and its clock; returns what to call when another run is looked at.

    workbench.js moves what is drawn here once: a group a joint, in it the links that it carries.
    """
    joints, bodies = model.about["joints"], model.about["bodies"]
    reach = sum(float(np.linalg.norm(j["at"])) for j in joints) or 0.5
    with tag("div", style="arm"):
        with ui.scene(
            width=360,
            height=330,
            grid=False,
            background_color="#f8f9fb",
            on_click=_clicked(view, bodies),
        ) as scene:
            groups = [scene.group() for _ in joints]
            for joint in joints:
                length = float(np.linalg.norm(joint["at"]))
                if length > 1e-6:
                    with scene if joint["parent"] < 0 else groups[joint["parent"]]:
                        scene.line([0.0, 0.0, 0.0], joint["at"]).material("#888888")
            for k, group in enumerate(groups):
                with group:
                    scene.sphere(0.02 * reach, 12, 8).material("#888888")
                    for body in (b for b in bodies if b["joint"] == k):
                        place = np.array(body["place"])
                        ball = scene.sphere(1.0, 24, 16).scale(*body["half"])
                        ball.material("#0072b2", 0.75).with_name(f"link-{body['link']}")
                        ball.move(*place[:3, 3]).rotate_R(place[:3, :3].tolist())
        scene.props["role"] = "img"
        scene.props["aria-label"] = "The arm, links as inertia ellipsoids coloured by torque error"
        with tag("div", style="row"):
            button("Play", lambda: ui.run_javascript("arm.play()"), "play", data_play="")
            tag(
                "input", type="range", min="0", max="1000", value="0", data_key="time", data_time="",
                aria_label="Time in the run",
            )  # fmt: skip
            tag("span", "0.0 s", "soft", data_clock="")
        tag("p", "Ellipsoids of uniform density; redder: larger torque error. Click a link to see its "
            "joint.", "soft")  # fmt: skip

    def follow() -> None:
        read = view.session.recording(model, view.run)
        centre, radius = _around(read["poses"], bodies)
        camera = centre + _AWAY * radius * np.array([0.58, -0.63, 0.52])
        (x, y, z), (a, b, c) = camera.tolist(), centre.tolist()
        scene.move_camera(x, y, z, a, b, c, duration=0.0)
        moves = {
            "scene": scene.id,
            "groups": [g.id for g in groups],
            "links": [[b["joint"], f"link-{b['link']}"] for b in bodies],
            "t": np.round(read["tf"] - read["t"][0], 3).tolist(),
            "poses": np.round(_quaternions(read["poses"]), 4).tolist(),
            "errors": _errors(model, read).tolist(),
        }
        ui.run_javascript(f"arm.load({json.dumps(moves)})")

    return follow


def _around(poses: Any, bodies: list[dict[str, Any]]) -> tuple[Any, float]:
    """Centre and radius of a ball around base, joints and links in all poses (F, k, 4, 4) of a run."""
    joints = poses[..., :3, 3].reshape(-1, 3)
    points, sizes = [np.zeros((1, 3)), joints], [np.zeros(1 + len(joints))]
    for body in bodies:
        points.append((poses[:, body["joint"]] @ np.array(body["place"]))[:, :3, 3])
        sizes.append(np.full(len(poses), max(body["half"])))
    places = np.vstack(points)
    centre = 0.5 * (places.min(axis=0) + places.max(axis=0))
    return centre, float(np.max(np.linalg.norm(places - centre, axis=1) + np.concatenate(sizes)))


def _clicked(view: View, bodies: list[dict[str, Any]]) -> Any:
    def handle(event: Any) -> None:
        for hit in event.hits:
            if hit.object_name.startswith("link-"):
                joints = len(view.session.robot["joints"]) if view.session.robot else 1
                view.look(joint=min(int(hit.object_name[5:]), joints - 1))
                return

    return handle


def _errors(model: Rung, read: dict[str, Any]) -> Any:
    """(F, n) torque errors at the instants of the poses, 0 to 1."""
    left = np.abs(read["torque"] - read["modelled"])
    own = np.sqrt(np.mean(left**2, axis=0))
    floors = zip(model.comparison["noise_floor"], own, strict=True)
    scale = _FULL * np.array([max(f or x, 1e-12) for f, x in floors])
    at = np.searchsorted(read["t"], read["tf"]).clip(0, len(left) - 1)
    return np.round(np.clip(left[at] / scale, 0.0, 1.0), 2)


def _quaternions(poses: Any) -> Any:
    """(F, k, 7) places and unit quaternions (x, y, z, w) of poses (F, k, 4, 4)."""
    turned = Rotation.from_matrix(poses[..., :3, :3].reshape(-1, 3, 3)).as_quat()
    return np.concatenate([poses[..., :3, 3], turned.reshape(*poses.shape[:2], 4)], axis=-1)
