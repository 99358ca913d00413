"""Which robot."""

from __future__ import annotations

from functools import partial
from typing import Any

from sdp_vs_penalty.checks.urdf import HEADS
from sdp_vs_penalty.page.controls import button, details, drop, note, table, tag, text_field, tile
from sdp_vs_penalty.page.part import Part
from sdp_vs_penalty.page.session import Session
from sdp_vs_penalty.page.uploads import ROBOT_SUFFIXES
from sdp_vs_penalty.page.view import View


def _depends(session: Session) -> Any:
    robot = session.robot
    found = session.answers.get("check_urdf")
    return robot and (robot["source"], robot["title"], robot["gravity"], found, bool(session.runs))


def _draw(view: View) -> None:
    session, robot = view.session, view.session.robot
    if robot is None:
        _choose(view)
        return
    file = f"{robot['file']}: " if robot["file"] else ""
    tag("p", f"{file}{robot['name']}, {robot['title']}", "chosen")
    note(f"{_joints(robot)} {robot['known']}")
    (gravity,) = view.forms.get("robot", [None])
    if gravity is not None:
        now = ",".join(f"{g:g}" for g in robot["gravity"] or robot["own_gravity"])
        with tag("div", style="pick"):
            text_field(gravity.help, now, session.mount, "gravity", gravity.example)
    if robot["source"].lower().endswith(ROBOT_SUFFIXES):
        _inertials(view)
    with details("Another robot", "another-robot"):
        _choose(view)


def _choose(view: View) -> None:
    """The built-in robots, those of the folder, and a place to drop one."""
    session, robot = view.session, view.session.robot
    with tag("div", style="row"):
        button("Show me", session.show_me, "show-me", "primary" if robot is None else "")
        note("The whole job on a simulated arm with something hidden, in about a minute.")
    with tag("div", style="tiles", role="group", aria_label="Built-in robots"):
        for problem in view.catalogue["problems"]:
            name = problem["name"]
            _tile(view, name, name, problem["title"])
        for folder in view.folder_problems():
            _tile(view, str(folder), folder.name, "with the bounds and filters of its problem.toml")
        for file in view.folder_files(ROBOT_SUFFIXES):
            _tile(view, str(file), file.name, "from your folder", file.name)
    drop("Your robot's URDF", "drop a file here, or choose one", "robot", ROBOT_SUFFIXES, False)


def _inertials(view: View) -> None:
    """Whether the bodies that a URDF writes can exist."""
    session, found = view.session, view.session.answers.get("check_urdf")
    ask = partial(session.ask, "check_urdf", "Checking the inertials", view.download)
    button("Check the file's inertials", ask, "check-urdf")
    if found is None or session.robot is None or found["urdf"] != session.robot["source"]:
        return
    for k, said in enumerate(found["said"]):
        level = "good" if found["possible"] else "bad"
        tag("p", said, "finding" if k else f"verdict {level}")
    with details("Every link: mass and margins (negative: violated)", "inertials"):
        table(HEADS, found["rows"], "Inertials of the links", "numbers")


def _tile(view: View, source: str, name: str, said: str, file: str | None = None) -> None:
    """A robot to choose by its name or path; file : its shown name where it is a URDF."""
    on = view.session.robot is not None and view.session.robot["source"] == source
    choose, pressed = partial(view.session.choose_robot, source, file), "true" if on else "false"
    tile(name, said, choose, f"robot-{name}", "on" if on else "", aria_pressed=pressed)


def _joints(robot: dict[str, Any]) -> str:
    """Names in order, and the unit of the torque: one for all where it is the same."""
    if len(set(robot["units"])) == 1:
        return f"Joints in order: {', '.join(robot['joints'])}; torques in {robot['units'][0]}."
    both = zip(robot["joints"], robot["units"], strict=True)
    return f"Joints in order: {', '.join(f'{name} [{unit}]' for name, unit in both)}."


ROBOT = Part("robot", "Robot", lambda session: True, _depends, _draw)
