"""Step 1: which robot."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sdp_vs_penalty import show
from sdp_vs_penalty.page.controls import button, details, drop, tag, text_field
from sdp_vs_penalty.page.session import Session
from sdp_vs_penalty.page.step import Step, Verdict
from sdp_vs_penalty.page.uploads import ROBOT_SUFFIXES

if TYPE_CHECKING:
    from sdp_vs_penalty.page.view import View


def _depends(session: Session) -> Any:
    robot = session.robot
    return robot and (robot["source"], robot["title"], robot["gravity"])


def _draw(view: View) -> None:
    session, robot = view.session, view.session.robot
    chosen = "" if robot is None else robot["source"]
    with tag("div", style="tiles", role="group", aria_label="Built-in robots"):
        for problem in view.catalogue["problems"]:
            name = problem["name"]
            on = name == chosen
            made = button(
                "",
                lambda name=name: session.choose_robot(name),  # type: ignore[misc]
                f"robot-{name}",
                "tile on" if on else "tile",
                aria_pressed="true" if on else "false",
            )
            with made:
                tag("strong", name)
                tag("span", problem["title"])
        for file in view.folder_files(ROBOT_SUFFIXES):
            on = str(file) == chosen
            made = button(
                "",
                lambda file=file: session.choose_robot(str(file), file.name),  # type: ignore[misc]
                f"robot-{file.name}",
                "tile on" if on else "tile",
                aria_pressed="true" if on else "false",
            )
            with made:
                tag("strong", file.name)
                tag("span", "from your folder")
    drop("Your robot's URDF", "drop a file here, or choose one", "robot", ROBOT_SUFFIXES, False)
    with details("Or go on with a saved session", "open-session"):
        drop("Your session.zip", "drop a file here, or choose one", "session", (".zip",), False)
    if robot is not None and robot["file"]:
        tag("p", f"{robot['file']}: {robot['name']}, {robot['title']}", "chosen")
    if robot is not None:
        tag("p", _joints(robot), "soft")
        (gravity,) = view.forms.get("robot", [None])
        if gravity is not None:
            now = ",".join(f"{g:g}" for g in robot["gravity"] or robot["own_gravity"])
            text_field(gravity.help, now, session.mount, "gravity", gravity.example)


def _joints(robot: dict[str, Any]) -> str:
    """Names in order, and the unit of the torque: one for all where it is the same."""
    if len(set(robot["units"])) == 1:
        return f"Joints in order: {', '.join(robot['joints'])}; torques in {robot['units'][0]}."
    both = zip(robot["joints"], robot["units"], strict=True)
    return f"Joints in order: {', '.join(f'{name} [{unit}]' for name, unit in both)}."


def _verdict(session: Session) -> Verdict | None:
    robot = session.robot
    if robot is None:
        return None
    return Verdict("good", f"{robot['file'] or robot['name']} has {show.count(robot['n'], 'joint')}.")


ROBOT = Step("robot", "Robot", "", lambda session: True, _depends, _draw, _verdict)
