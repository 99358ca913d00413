"""Figures 8 to 10, of the 2R: drawn from its parameters, its torques, its internal
wrenches."""

from typing import Any

import numpy as np

from sdp_vs_penalty.formatting import plain_unit
from sdp_vs_penalty.paper.figures import style
from sdp_vs_penalty.paper.figures.style import (
    draw_torques,
    label_joints,
    legend_below,
    new_figure,
)
from sdp_vs_penalty.paper.tables.study import Study
from sdp_vs_penalty.paper.tables.wrenches import COMPONENTS, wrench_study
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.problem.published import published_links
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array

PROBLEM = "two_link"


def figure_8(study: Study) -> Any:
    """Draw the 2R from its parameters: shapes, frames, centres of mass, inertia
    ellipsoids.

    Parameters
    ----------
    study : Study
        The 2R's data sets and estimates.

    Returns
    -------
    matplotlib.figure.Figure
        The arm in 3D, and a section of each link.
    """
    problem = study.problem
    figure, axes = new_figure(1, 3, 4.2, width_ratios=(1.4, 1, 1))
    # The first panel becomes three-dimensional.
    position = axes[0, 0].get_subplotspec()
    axes[0, 0].remove()
    _robot(figure.add_subplot(position, projection="3d"), problem)
    estimates = {
        "p_real": (study.experiment.links, style.BLACK, "-", "o"),
        "p_hat (published)": (published_links(problem, "p_hat"), style.RED, "--", "s"),
        "lmi-sdp": (study.links("lmi-sdp", study.simulated), style.BLUE, "-.", "^"),
    }
    # Link 1 is drawn in x and y, link 2 in x and z.
    for link, (axis, plane) in enumerate(
        zip(axes[0, 1:], ((0, 1), (0, 2)), strict=True)
    ):
        _section(axis, problem, link, plane)
        for name, (links, color, line, marker) in estimates.items():
            look = {"color": color, "linestyle": line}
            axis.plot(*_ellipse(links[link], plane), linewidth=1.3, **look)
            c = links[link, 1:4] / links[link, 0]
            axis.plot(*c[list(plane)], marker=marker, markersize=4, label=name, **look)
    legend_below(figure, axes[0, 1])
    figure.suptitle(
        "The 2R from its parameters. Sections: link shapes, and where a centre of mass"
        " can be (grey);\ncentres of mass, and uniform ellipsoids with the same mass"
        " and inertia (cut off at the frame)"
    )
    return figure


def radius_profile(problem: Problem, link: int) -> tuple[int, Array, Array]:
    """Return the radius of a link's shape along its axis.

    Parameters
    ----------
    problem : Problem
        Its cones for centres of mass describe the shapes.
    link : int
        Index of the link, from 0.

    Returns
    -------
    tuple of (int, (k,) array, (k,) array)
        Index of the axis in the link's frame (0 is x), positions along it [m], and the
        radius there [m].
    """
    cones = [c for c in problem.cones if c.link == link + 1]
    along = "xyz".index(cones[0].axis)
    low, high = problem.box[link, 1 + along]
    x = np.linspace(low, high, 60)
    radius = np.min([c.radius + c.slope * x for c in cones], axis=0)
    return along, x, np.maximum(radius, 0.0)


#: The pose that is drawn [rad], and from where it is seen [degrees].
_POSE = (0.6, 0.7)
_VIEW = {"elev": 18, "azim": -65}
#: Length of a frame's axes [m]; x, y, z as everywhere in robotics: red, green, blue.
_AXIS_LENGTH = 0.25
_AXIS_COLORS = {"x": style.RED, "y": style.GREEN, "z": style.BLUE}


def _robot(axis: Any, problem: Problem) -> None:
    """Draw the 2R in three dimensions: the shape of each link, its frame, and the base
    frame."""
    (poses,) = problem.robot.poses(np.array([_POSE]))
    frames = [np.eye(4)]
    for pose, joint in zip(poses, problem.robot.joints, strict=True):
        frames.append(pose @ joint.link_frame)
    for link, frame in enumerate(frames[1:]):
        surface = _surface(problem, link, frame)
        axis.plot_surface(*surface, color="#cccccc", alpha=0.5, linewidth=0)
    for number, frame in enumerate(frames):
        origin = frame[:3, 3]
        for k, (letter, color) in enumerate(_AXIS_COLORS.items()):
            end = origin + _AXIS_LENGTH * frame[:3, k]
            axis.plot(*np.column_stack([origin, end]), color=color, linewidth=1.2)
            axis.text(*end, f"${letter}_{number}$", fontsize=7, color=color)
    axis.set_box_aspect((1, 1, 1.6))
    axis.set(xlim=(-0.6, 0.6), ylim=(-0.6, 0.6), zlim=(0.0, 1.92))
    across = [-0.5, 0.0, 0.5]
    axis.set(xticks=across, yticks=across, zticks=[0.0, 0.5, 1.0, 1.5])
    axis.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    axis.view_init(**_VIEW)


def _surface(problem: Problem, link: int, frame: Array) -> Array:
    """Return the surface of a link's shape, circles along its axis.

    frame : (4, 4) pose of the link in the base. Returns points (3, k, k) in the base
    [m].
    """
    along, x, radius = radius_profile(problem, link)
    angle = np.linspace(0.0, 2.0 * np.pi, len(x))
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = np.zeros((len(x), len(x), 3))
    points[:, :, along] = x[:, None]
    across = [a for a in range(3) if a != along]
    points[:, :, across] = radius[:, None, None] * circle
    moved = points @ frame[:3, :3].T + frame[:3, 3]
    return np.moveaxis(moved, 2, 0)


def _section(axis: Any, problem: Problem, link: int, plane: tuple[int, int]) -> None:
    """Draw a section of a link's shape in its frame, with a margin of half its size
    around it.

    ``plane`` holds the indices of the two axes drawn, such as (0, 1) for x and y. The
    section is the link's radius on both sides of its axis. Ellipsoids larger than the
    margin are cut off.
    """
    along, x, radius = radius_profile(problem, link)
    edge = np.column_stack(
        [np.concatenate([x, x[::-1]]), np.concatenate([radius, -radius[::-1]])]
    )
    edge = edge if plane[0] == along else edge[:, ::-1]
    axis.fill(*edge.T, color=style.GREY, alpha=0.3, linewidth=0)
    axis.set_aspect("equal")
    axis.set_title(f"link {link + 1}, section in its frame")
    axis.set_xlabel(f"$c_{{{link + 1}{'xyz'[plane[0]]}}}$ [m]")
    axis.set_ylabel(f"$c_{{{link + 1}{'xyz'[plane[1]]}}}$ [m]")
    margin = 0.5 * float(np.ptp(edge, axis=0).max())
    low = edge.min(axis=0) - margin
    high = edge.max(axis=0) + margin
    axis.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))


def _ellipse(link: Array, plane: tuple[int, int]) -> Array:
    """Return the outline (2, 100) [m] of a link's uniform ellipsoid, seen along the third
    axis; ``plane`` holds the indices of the two axes that are seen.

    If no body of positive density has these parameters, the moments' absolute values
    are drawn.
    """
    moments, directions = np.linalg.eigh(inertia.second_moment(link))
    # A uniform ellipsoid with half axes a has second moments a^2 / 5.
    shape = (directions * 5.0 * np.abs(moments)) @ directions.T
    sizes, axes = np.linalg.eigh(shape[np.ix_(plane, plane)])
    centre = link[1:4] / link[0] if link[0] != 0.0 else np.zeros(3)
    angle = np.linspace(0.0, 2.0 * np.pi, 100)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    return centre[list(plane), None] + axes * np.sqrt(np.maximum(sizes, 0.0)) @ circle


def figure_9(study: Study) -> Any:
    """Draw the true torques of the 2R, and those with links estimated by SDP and
    penalty.

    Parameters
    ----------
    study : Study
        The 2R's data sets and estimates.

    Returns
    -------
    matplotlib.figure.Figure
        For each joint the torque, and its error in thousandths.
    """
    robot = study.problem.robot
    x = study.experiment
    data = study.simulated
    # The true torques, every 20 ms.
    t = np.arange(0.0, x.trajectory.duration, 0.02)
    states = x.trajectory.states(t)
    true = robot.inverse_dynamics(x.links.ravel(), *states)
    figure, axes = new_figure(robot.n, 2, 4.2, sharex=True, width_ratios=(3, 2))
    links = {
        method: study.links(method, data).ravel() for method in ("lmi-sdp", "penalty")
    }
    torque_by_method = {
        method: robot.inverse_dynamics(links_of_method, *states)
        for method, links_of_method in links.items()
    }
    draw_torques(axes, t, true, "p_real", torque_by_method, scale=1e3)
    worst = [
        f"{method} {1e3 * np.abs(x - true).max():.1f} mN m"
        for method, x in torque_by_method.items()
    ]
    # Certified distances of the losses from their lower bounds, for the title.
    gap_by_method = {
        method: study.estimated(method, data).certificate.gap
        for method in torque_by_method
    }
    gaps = [
        f"{method} {abs(gap):.0e}"
        for method, gap in gap_by_method.items()
        if gap is not None
    ]
    for axis in axes[:, 1]:
        axis.set_ylabel("error [mN m]")
    label_joints(axes, robot.torque_units, "torque")
    legend_below(figure, axes[0, 0])
    figure.suptitle(
        "2R, identified from one noisy simulated run: largest torque errors"
        f" {', '.join(worst)};\ncertified gaps {', '.join(gaps)} of the loss"
    )
    return figure


def figure_10(study: Study) -> Any:
    """Draw the internal wrenches of the 2R: true, feasible, unfeasible, and all
    possible ones.

    All parameters make the same torques; a band shows the certified interval of all
    feasible ones.

    Parameters
    ----------
    study : Study
        The 2R's data sets and estimates.

    Returns
    -------
    matplotlib.figure.Figure
        One row for each component of force and moment, one column for each joint.
    """
    w = study.once(wrench_study)
    n = study.problem.robot.n
    figure, axes = new_figure(len(COMPONENTS), n, 8.6, sharex=True)
    # Three of the parameters that make the same torques but cannot exist, of each kind.
    unfeasible = [*w.boxed[:3], *w.unbounded[:3]]
    # From back to front.
    lines = (
        ([*w.feasible.values(), *w.penalty_runs], _FEASIBLE),
        (unfeasible, _UNFEASIBLE),
        ([w.true], _TRUE),
    )
    # Component k of the wrench at joint j.
    for k, j in np.ndindex(axes.shape):
        axis = axes[k, j]
        bounds = w.intervals
        axis.fill_between(
            w.t, bounds.lower_bound[:, j, k], bounds.upper_bound[:, j, k], **_POSSIBLE
        )
        for wrenches, look in lines:
            for values in wrenches:
                axis.plot(w.t, values[:, j, k], **look)
        # Unfeasible wrenches may leave the interval by orders of magnitude.
        low, high = bounds.lower[:, j, k].min(), bounds.upper[:, j, k].max()
        room = 0.3 * (high - low)
        axis.set_ylim(low - room, high + room)
        component, unit = [*COMPONENTS.items()][k]
        symbol = f"${component[0]}_{component[1]}$"
        if component == "nz":
            symbol += " = torque"
        axis.set_ylabel(f"{symbol} [{plain_unit(unit)}]")
    for j in range(n):
        axes[0, j].set_title(f"joint {j + 1}")
        axes[-1, j].set_xlabel("time [s]")
    legend_below(figure, axes[0, 0])
    worst = max((float(np.abs(v).max()) for v in unfeasible), default=0.0)
    figure.suptitle(
        "Internal wrenches of the 2R in the joint frames; unfeasible parameters make"
        f" the same torques and leave the\npanels (largest here {worst:.0f} N or N m; without"
        " bounds there is no largest)"
    )
    return figure


#: How the wrenches of Fig. 10 look.
_POSSIBLE: dict[str, Any] = {
    "color": style.SKY,
    "alpha": 0.45,
    "linewidth": 0,
    "label": "all feasible with equal torques (certified)",
}
_FEASIBLE: dict[str, Any] = {
    "color": style.ORANGE,
    "linewidth": 0.6,
    "label": "feasible estimates",
}
_UNFEASIBLE: dict[str, Any] = {
    "color": style.RED,
    "linewidth": 0.8,
    "linestyle": ":",
    "label": "unfeasible",
}
_TRUE: dict[str, Any] = {"color": style.BLACK, "linewidth": 1.4, "label": "p_real"}
