"""One page that shows the tables with the links drawn: an ellipsoid a link on the arm, for
every published and identified column."""

from collections.abc import Sequence
from dataclasses import replace
from html import escape
from pathlib import Path
from string import Template

import numpy as np

from sdp_vs_penalty.estimation.link_figures import consistent
from sdp_vs_penalty.paper.tables.study import Data, Study
from sdp_vs_penalty.paper.tables.table import StudyTable
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot

#: Width and height of a picture, and the share of it that is kept clear at its edges.
WIDTH = 250.0
HEIGHT = 380.0
CLEAR = 0.12
#: From where the arm is seen [rad]: about the vertical, and above the horizontal.
AZIMUTH = -1.05
ELEVATION = 0.3
#: The pose that is drawn of an arm with seven joints [rad]; of others, mid-range.
SEVEN_JOINTS = (0.0, -0.5, 0.0, -2.0, 0.0, 1.6, 0.8)
#: Methods that are drawn beside the columns of the tables.
ALSO_DRAWN = ("ols",)


def links_page(tables: Sequence[StudyTable], study: Study) -> str:
    """Return an HTML page with the links of every column drawn on the arm, and the
    tables.

    Parameters
    ----------
    tables : sequence of StudyTable
        Tables shown below the pictures.
    study : Study
        Its published and estimated links are drawn.

    Returns
    -------
    str
        A document that loads no other file.
    """
    drawn = links_by_title(study)
    pose = drawn_pose(study.problem.robot)
    pictures = "".join(
        _figure(title, links, study.problem.robot, pose)
        for title, links in drawn.items()
    )
    template = Template(Path(__file__).with_name("links_page.html").read_text("utf-8"))
    return template.substitute(
        title=escape(f"Links of {study.problem.title}"),
        sentence=escape(study.sentence),
        pictures=pictures,
        contents="".join(
            f'<a href="#table_{table.name}">{escape(table.name)}</a>'
            for table in tables
        ),
        tables="".join(map(_section, tables)),
    )


def links_by_title(study: Study) -> dict[str, Array]:
    """Return the links to draw, by the title of the picture.

    Returns
    -------
    dict of str to (n, 10) array
        Standard parameters [kg, kg m, kg m^2].
    """
    out = {
        f"{name}, as published": links for name, links in study.published_links.items()
    }
    for data in reversed(study.whole):
        for method in (*ALSO_DRAWN, "penalty", "lmi-sdp"):
            out[_title(method, data)] = study.links(method, data)
    return out


def _title(method: str, data: Data) -> str:
    """Return the title of a picture, such as "SDP, measured run"."""
    names = {"ols": "least squares", "penalty": "penalty", "lmi-sdp": "SDP"}
    return f"{names[method]}, {data.label} run"


def drawn_pose(robot: Robot) -> Array:
    """Return the joint positions of the picture: a natural pose for an arm of seven
    joints, else the middle of each joint's range.

    Returns
    -------
    (n,) array
        Positions [rad, m]; 0.4 for a joint without limits, so that the arm is bent.
    """
    if robot.n == len(SEVEN_JOINTS):
        return np.array(SEVEN_JOINTS)
    middle = [0.5 * (joint.lower + joint.upper) for joint in robot.joints]
    return np.where(np.isfinite(middle), middle, 0.4)


def view() -> Array:
    """Return the projection (2, 3) of a point in the base frame to the picture: its
    rows are the unit vectors to the right and up.

    The camera stands at AZIMUTH about the vertical and ELEVATION [rad] above the
    horizon; ``towards`` is the horizontal direction from the arm to it.
    """
    right = np.array([np.cos(AZIMUTH), np.sin(AZIMUTH), 0.0])
    towards = np.array([np.sin(AZIMUTH), -np.cos(AZIMUTH), 0.0])
    up = -np.sin(ELEVATION) * towards
    up[2] = np.cos(ELEVATION)
    return np.stack([right, up])


def skeleton(robot: Robot, poses: Array) -> Array:
    """Return the points (1 + 2 n, 3) [m] of the arm's skeleton: base, joints and the
    frames of their links.

    Parameters
    ----------
    poses : (n, 4, 4) array
        Pose of each joint in the base.
    """
    points = [np.zeros(3)]
    for joint, pose in zip(robot.joints, poses, strict=True):
        points.append(pose[:3, 3])
        points.append((pose @ joint.link_frame)[:3, 3])
    return np.array(points)


def outline(link: Array, projection: Array) -> tuple[Array, Array, bool]:
    """Return the outline of a link's uniform ellipsoid as it is seen.

    Parameters
    ----------
    link : (10,) array
        Standard parameters [kg, kg m, kg m^2].
    projection : (2, 3) array
        From the link's frame to the picture.

    Returns
    -------
    centre : (2,) array
        Centre of the ellipse, from the frame's origin [m].
    axes : (2, 2) array
        Its half axes as columns [m].
    exists : bool
        Whether a body of positive density has these parameters. If none has, the
        moments' absolute values are drawn.
    """
    moments, directions = np.linalg.eigh(inertia.second_moment(link))
    exists = bool(consistent(link[None]))
    # A uniform ellipsoid with half axes a has second moments a^2 / 5.
    shape = (directions * 5.0 * np.abs(moments)) @ directions.T
    sizes, axes = np.linalg.eigh(projection @ shape @ projection.T)
    com = link[1:4] / link[0] if link[0] != 0.0 else np.zeros(3)
    return projection @ com, axes * np.sqrt(np.maximum(sizes, 0.0)), exists


def _figure(title: str, links: Array, robot: Robot, pose: Array) -> str:
    """Return a picture of the links (n, 10) on the arm as SVG, with its caption.

    Links that cannot exist are marked, and those larger than the picture are left out;
    the caption names both.
    """
    # The arm's skeleton as seen (k, 2) [m], and the scale that fits it into the picture.
    (poses,) = robot.poses(pose[None])
    joints = skeleton(robot, poses) @ view().T
    low = joints.min(axis=0)
    size = float((np.ptp(joints, axis=0) / [WIDTH, HEIGHT]).max())
    scale = (1.0 - 2.0 * CLEAR) / size
    middle = low + 0.5 * np.ptp(joints, axis=0)
    places = _on_paper(joints, middle, scale)
    ellipses = ""
    impossible = list[str]()
    too_large = list[str]()
    # An ellipse for each link that fits into the picture.
    for number, (link, carrier, joint_pose) in enumerate(
        zip(links, robot.joints, poses, strict=True), start=1
    ):
        frame = joint_pose @ carrier.link_frame
        centre, axes, exists = outline(link, view() @ frame[:3, :3])
        if not exists:
            impossible.append(str(number))
        if scale * np.linalg.norm(axes, axis=0).max() > HEIGHT:
            too_large.append(str(number))
            continue
        ellipses += _ellipse(
            _on_paper((centre + view() @ frame[:3, 3])[None], middle, scale)[0],
            scale * axes,
            f"link {number}: {link[0]:.3g} kg",
            "link" if exists else "impossible",
        )
    # The arm as a line with dots, and the caption.
    line = " ".join(f"{x:.1f},{y:.1f}" for x, y in places)
    dots = "".join(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3"/>' for x, y in places)
    verdict = "every link can exist"
    if impossible:
        verdict = f"{_links(impossible)} cannot exist"
    if too_large:
        verdict += f"; {_links(too_large)} larger than the picture"
    state = "bad" if impossible else "good"
    return (
        f'<figure><svg viewBox="0 0 {WIDTH:g} {HEIGHT:g}" role="img"'
        f' aria-label="{escape(title)}: {verdict}">'
        f'<polyline class="arm" points="{line}"/>{ellipses}'
        f'<g class="joints">{dots}</g></svg>'
        f"<figcaption><b>{escape(title)}</b><br>"
        f'<span class="{state}">{verdict}</span></figcaption></figure>'
    )


def _links(numbers: Sequence[str]) -> str:
    """Write the numbers of links, such as "links 2, 3"."""
    several = "s" if len(numbers) > 1 else ""
    return f"link{several} {', '.join(numbers)}"


def _on_paper(points: Array, middle: Array, scale: float) -> Array:
    """Return points (k, 2) [m] in the picture's coordinates, whose second axis points
    down.

    middle : (2,) the point in the middle of the picture; scale : picture units a metre.
    """
    moved = (points - middle) * scale
    return np.column_stack([0.5 * WIDTH + moved[:, 0], 0.5 * HEIGHT - moved[:, 1]])


def _ellipse(centre: Array, axes: Array, name: str, kind: str) -> str:
    """Return an SVG ellipse with a title.

    ``centre`` (2,) and the half axes, the columns of ``axes`` (2, 2) with the longer
    one last, are in picture units. ``kind`` is the CSS class. SVG turns clockwise, so
    the angle is negative.
    """
    lengths = np.linalg.norm(axes, axis=0)
    angle = -float(np.rad2deg(np.arctan2(axes[1, 1], axes[0, 1])))
    x, y = centre
    return (
        f'<ellipse class="{kind}" rx="{lengths[1]:.1f}" ry="{max(lengths[0], 0.8):.1f}"'
        f' transform="translate({x:.1f} {y:.1f}) rotate({angle:.1f})">'
        f"<title>{escape(name)}</title></ellipse>"
    )


def _section(table: StudyTable) -> str:
    """Return a table as an HTML section: title, headline, cells, caption and notes; all
    texts are escaped."""
    spaced = [name.replace("_", " ") for name in table.form.headings]  # lines may break
    notes = "".join(f"<li>{escape(note)}</li>" for note in table.notes)
    return (
        f'<section id="table_{escape(table.name)}"><h2>{escape(table.title)}</h2>'
        f"<p>{escape(table.headline)}</p>"
        f'<div class="wide">{replace(table.form, headings=spaced).html()}</div>'
        f"<details><summary>What each column is</summary><p>{escape(table.caption)}</p>"
        f"<ul>{notes}</ul></details></section>"
    )
