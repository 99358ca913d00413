"""The arm in 3D beside a chart: ellipsoids of the links, moved with a run. workbench.js
moves what is drawn here once."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import scipy
from nicegui import ui

from sdp_vs_penalty.colours import AFTER
from sdp_vs_penalty.page.controls import button, chart, note, tag
from sdp_vs_penalty.page.view import View
from sdp_vs_penalty.robot.arrays import Array

#: The direction from which an arm is looked at, and the height of the view [deg].
_VIEW = np.array([0.58, -0.63, 0.52])
_ANGLE = 14.0
_BONES = "#888888"
#: Solidity of the links' meshes.
_SURFACE = 0.35
#: Of the joints' axes: a colour that no curve has.
_AXES = "#7c3aed"
#: Solidity of the links' ellipsoids.
_SOLIDITY = 0.75
#: Squares of the ground on each side.
_SQUARES = 10


def chart_and_arm(
    view: View,
    label: str,
    about: Mapping[str, Any],
    caption: str,
    scale: tuple[str, str] | None = None,
) -> tuple[Any, Callable[..., None]]:
    """Draw an empty chart over time and, to its right, the arm in 3D with a clock.

    Parameters
    ----------
    view : View
        The tab; a click on a link selects its joint there.
    label : str
        Text alternative of the chart.
    about : mapping
        "joints" and "bodies" (ellipsoids) of the arm; without bodies no scene is drawn.
    scale : tuple of str, optional
        What the first and the last colour of the links mean, if errors colour them.

    Returns
    -------
    chart, callable
        The callable shows a recording: its name, its arrays t, tf and poses, and
        optionally errors (F, n), 0 to 1, that colour the links.
    """
    with tag("div", style="pair"):
        with tag("div", style="body"):  # what is said of the chart stands below it
            drawn = chart({}, label).classes("timed")
        if not about["bodies"]:
            return drawn, lambda *_: None
        scene = ArmScene(view, about, caption, scale)
    return drawn, scene.load


class ArmScene:
    """A scene with its clock; one group for each joint with the links that it carries."""

    def __init__(
        self,
        view: View,
        about: Mapping[str, Any],
        caption: str,
        scale: tuple[str, str] | None,
        height: int = 330,
    ) -> None:
        """Draw the arm at rest, its clock, the scale of colours, and a note.

        Parameters are those of :func:`chart_and_arm`; height : of the picture [pixels].
        """
        self.view = view
        self.about = about
        self.loaded = ""
        with tag("div", style="arm") as frame:
            camera = ui.scene.perspective_camera(fov=_ANGLE)
            with ui.scene(
                width=360,
                height=height,
                grid=(ground_size(about), _SQUARES),
                background_color="#f8f9fb",
                on_click=self.select_link,
                camera=camera,
            ) as self.scene:
                self.groups = self._draw()
            frame.props["data-arm"] = self.scene.id
            self.scene.style(f"height: {height}px")
            text = f"The arm in 3D: {caption}"
            self.scene.props.update({"role": "img", "aria-label": text})
            self._draw_clock()
            if scale:
                _draw_scale(scale)
            has_meshes = bool(view.session.robot.get("meshes"))
            surfaces = "Grey: the URDF's meshes. " if has_meshes else ""
            note(
                f"{surfaces}Ellipsoids with each link's mass and inertia: {caption}."
                f" Violet: axes. A square: {ground_size(about) / _SQUARES:g} m."
            )

    def select_link(self, event: Any) -> None:
        """Select the joint of the link that was clicked; its object is named
        "link-<index>".
        """
        n_joints = len(self.view.session.robot["joints"])
        for hit in event.hits:
            name, _, link = hit.object_name.partition("-")
            if name == "link" and link.isdigit():
                self.view.select(joint=min(int(link), n_joints - 1))
                return

    def load(self, name: str, read: Mapping[str, Any], errors: Any = None) -> None:
        """Show the motion of another recording, unless it is shown already.

        Parameters
        ----------
        read : mapping
            t (M,) [s]; tf (F,) [s] and poses (F, joints, 4, 4).
        errors : (F, n) array, optional
            Torque errors, 0 to 1, that colour the links.
        """
        if self.loaded == name:
            return
        self.loaded = name
        poses = read["poses"]
        moves = {
            "groups": [group.id for group in self.groups],
            "t": np.round(read["tf"], 3).tolist(),
            "poses": np.round(_places_and_turns(poses), 4).tolist(),
            "errors": [[0.0]] * len(read["tf"]) if errors is None else errors.tolist(),
        }
        self.scene.move_camera(**camera_place(poses, self.about), duration=0.0)
        arm = f"arms[{self.scene.id}] ??= new Arm({self.scene.id})"
        ui.run_javascript(f"({arm}).load({json.dumps(moves)})")

    def _draw_clock(self) -> None:
        """Draw the play button, a bar to drag through the run, and the seconds."""
        play = f"arms[{self.scene.id}]?.play()"
        with tag("div", style="row"):
            run = lambda: ui.run_javascript(play)  # noqa: E731
            button("Play", run, "play", data_play="")
            tag(
                "input",
                type="range",
                min="0",
                max="1000",
                value="0",
                data_key="time",
                data_time=self.scene.id,
                aria_label="Time in the run",
            )
            tag("span", "0.0 s", "soft", data_clock="")

    def _draw(self) -> list[Any]:
        """Draw the joints and links of the arm; return a group for each joint.

        Each group holds what moves with its joint, so that the browser sets its pose
        only.
        """
        scene = self.scene
        joints = self.about["joints"]
        thin = 0.02 * reach(self.about)
        groups = [scene.group() for _ in joints]
        for joint, group in zip(joints, groups, strict=True):
            parent = scene if joint["parent"] < 0 else groups[joint["parent"]]
            with parent:
                if np.linalg.norm(joint["at"]) > 1e-6:
                    self._draw_bone(joint["at"], thin)
            with group:
                scene.sphere(thin, 12, 8).material(_BONES)
                self._draw_axis(joint["axis"], thin)
        for body in self.about["bodies"]:
            with groups[body["joint"]]:
                self._draw_link(body)
        for mesh in self.view.session.robot.get("meshes", ()):
            with groups[mesh["joint"]]:
                self._draw_mesh(mesh)
        return groups

    def _draw_mesh(self, mesh: Mapping[str, Any]) -> None:
        """Draw a link's surface from its mesh, transparent so that its ellipsoid
        shows.
        """
        place = np.array(mesh["place"])
        url = f"/s/{self.view.session.token}/take/{mesh['file']}"
        surface = self.scene.stl(url).material(_BONES, _SURFACE)
        surface.move(*place[:3, 3]).rotate_R(place[:3, :3].tolist())

    def _draw_bone(self, end: list[float], thin: float) -> None:
        """Draw a tube of radius ``thin`` [m] from a joint to the next one at ``end``
        [m].
        """
        self._draw_tube(np.zeros(3), np.array(end), thin, _BONES)

    def _draw_axis(self, axis: list[float], thin: float) -> None:
        """Draw a joint's axis as a thin stick, from -4 to 6 joint radii ``thin``
        [m].
        """
        start, end = np.outer([-4.0, 6.0], axis) * thin
        self._draw_tube(start, end, 0.2 * thin, _AXES)

    def _draw_tube(self, start: Array, end: Array, thin: float, colour: str) -> None:
        """Draw a straight tube of radius ``thin`` [m] between two points (3,) [m]."""
        begin, middle, stop = np.array([start, 0.5 * (start + end), end]).tolist()
        tube = self.scene.quadratic_bezier_tube(begin, middle, stop, 1, thin)
        tube.material(colour)

    def _draw_link(self, body: Mapping[str, Any]) -> None:
        """Draw a link as the ellipsoid of uniform density with the same mass and
        inertia.
        """
        place = np.array(body["place"])
        ball = self.scene.sphere(1.0, 24, 16).scale(*body["half"])
        ball.material(AFTER, _SOLIDITY)
        ball.with_name(f"link-{body['link']}")
        ball.move(*place[:3, 3]).rotate_R(place[:3, :3].tolist())


def _places_and_turns(poses: Array) -> Array:
    """Return the positions and orientations of k joints in F poses, (F, k, 7).

    poses (F, k, 4, 4) : homogeneous matrices. Each row of the result is x, y, z [m] and
    the unit quaternion x, y, z, w.
    """
    matrices = poses[..., :3, :3].reshape(-1, 3, 3)
    rotations = scipy.spatial.transform.Rotation.from_matrix(matrices)
    quaternions = rotations.as_quat().reshape(*poses.shape[:2], 4)
    return np.dstack([poses[..., :3, 3], quaternions])


def _draw_scale(ends: tuple[str, str]) -> None:
    """Draw the scale of the links' colours with the meaning of its two ends."""
    with tag("div", style="scale"):
        tag("span", ends[0])
        tag("i", aria_hidden="true")
        tag("span", ends[1])


def ground_size(about: Mapping[str, Any]) -> int:
    """Return the side of the drawn ground [m]: twice the arm's reach, in full
    metres.
    """
    return int(np.ceil(2.0 * reach(about)))


def reach(about: Mapping[str, Any]) -> float:
    """Return the length of the arm stretched out [m]; 0.5 m if all joints coincide."""
    return sum(float(np.linalg.norm(j["at"])) for j in about["joints"]) or 0.5


def camera_place(poses: Array, about: Mapping[str, Any]) -> dict[str, float]:
    """Place the camera so that the base and all links stay in the picture.

    Parameters
    ----------
    poses : (F, k, 4, 4) array
        Poses of the arm's joints over a run.
    about : mapping
        "joints" and "bodies" (ellipsoids) of the arm.

    Returns
    -------
    dict
        Position of the camera and the point that it looks at [m]: the arguments of
        NiceGUI's ``move_camera``.
    """
    bodies = about["bodies"]
    centres = [poses[:, body["joint"]] @ np.array(body["place"]) for body in bodies]
    frames = [*centres, *poses.swapaxes(0, 1)]
    places = np.concatenate([np.zeros((1, 3)), *(f[..., :3, 3] for f in frames)])
    centre = 0.5 * (places.min(axis=0) + places.max(axis=0))
    distances = np.linalg.norm(places - centre, axis=1)
    radius = distances.max() + 0.1 * reach(about)  # room for the links' thickness
    distance = radius / np.sin(0.5 * np.deg2rad(_ANGLE))  # _ANGLE: height of the view
    eye = centre + distance * _VIEW / np.linalg.norm(_VIEW)
    names = [f"{of}{axis}" for of in ("", "look_at_") for axis in "xyz"]
    return dict(zip(names, [*eye.tolist(), *centre.tolist()], strict=True))
