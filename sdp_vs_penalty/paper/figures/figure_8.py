"""Figure 8: the 2R drawn from its parameters: shapes, frames, centres of mass, inertia ellipsoids."""

from __future__ import annotations

from typing import Any

import numpy as np

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.paper.figures.style import BLACK, BLUE, GREEN, GREY, RED, new_figure, title
from sdp_vs_penalty.paper.tables.study import Study
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.problem.published import published_links
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array

#: x, y, z as everywhere in robotics: red, green, blue; here from the same palette, and labelled.
_AXES = ((RED, "x"), (GREEN, "y"), (BLUE, "z"))


def draw(study: Study) -> Any:
    problem = study.problem
    figure, axes = new_figure(1, 3, 4.2, width_ratios=(1.4, 1, 1))
    position = axes[0, 0].get_subplotspec()
    axes[0, 0].remove()
    space = figure.add_subplot(position, projection="3d")
    _robot(space, problem)
    estimates = {
        "p_real": (study.experiment.links, {"color": BLACK, "linestyle": "-"}, "o"),
        "p_hat (published)": (published_links(problem, "p_hat"), {"color": RED, "linestyle": "--"}, "s"),
        "lmi-sdp": (study.links("lmi-sdp", study.simulated), {"color": BLUE, "linestyle": "-."}, "^"),
    }
    for link, (axis, plane) in enumerate(zip(axes[0, 1:], ((0, 1), (0, 2)), strict=True)):
        _section(axis, problem, link, plane)
        for name, (links, look, marker) in estimates.items():
            _ellipse(axis, links[link], plane, look)
            c = links[link, 1:4] / links[link, 0]
            axis.plot(*c[list(plane)], marker=marker, markersize=4, label=name, **look)
        _frame_the_shape(axis, problem, link, plane)
    handles, labels = axes[0, 1].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
    title(
        figure,
        "The 2R from its parameters. Sections: link shapes, and where a centre of mass can be (grey);\n"
        "centres of mass, and uniform ellipsoids with the same mass and inertia (cut off at the frame)",
    )
    return figure


def radius_profile(problem: Problem, link: int, slices: int = 60) -> tuple[int, Array, Array]:
    """Axis of a link's shape, positions along it (slices,) and its radius there (slices,) [m].

    Raises InputError for a shape without volume: no radius is positive anywhere in its range.
    """
    cones = [c for c in problem.cones if c.link == link]
    if not cones:
        raise InputError(
            f"link {link + 1}: the problem gives it no shape to draw",
            "give it bounds on its centre of mass",
        )
    along = cones[0].axis
    low, high = problem.box[link, 1 + along]
    x = np.linspace(low, high, slices)
    radius = np.min([c.radius + c.slope * x for c in cones], axis=0)
    if not (np.all(np.isfinite(x)) and high > low and radius.max() > 0.0):
        raise InputError(
            f"link {link + 1}: its shape has no volume (radius at most {radius.max():.3g} m "
            f"over {high - low:.3g} m)",
            "correct the cones and bounds of the centre of mass",
        )
    return along, x, np.maximum(radius, 0.0)


def _surface(problem: Problem, link: int) -> Array:
    """(slices, slices, 3) points of a link's shape in its frame."""
    along, x, radius = radius_profile(problem, link)
    across = [a for a in range(3) if a != along]
    angle = np.linspace(0.0, 2.0 * np.pi, len(x))
    points = np.zeros((len(x), len(x), 3))
    points[:, :, along] = x[:, None]
    points[:, :, across[0]] = radius[:, None] * np.cos(angle)
    points[:, :, across[1]] = radius[:, None] * np.sin(angle)
    return points


def _robot(axis: Any, problem: Problem) -> None:
    _frame(axis, np.eye(4), "0")
    # Pose that is drawn [rad].
    (poses,) = problem.robot.poses(np.array([(0.6, 0.7)]))
    for k, (joint, pose) in enumerate(zip(problem.robot.joints, poses, strict=True)):
        link_pose = pose @ joint.link_frame
        points = _surface(problem, k) @ link_pose[:3, :3].T + link_pose[:3, 3]
        axis.plot_surface(*np.moveaxis(points, 2, 0), color="#cccccc", alpha=0.5, linewidth=0)
        _frame(axis, link_pose, str(k + 1))
    axis.set_box_aspect((1, 1, 1.6))
    axis.set(xlim=(-0.6, 0.6), ylim=(-0.6, 0.6), zlim=(0.0, 1.92))
    axis.set(xticks=[-0.5, 0.0, 0.5], yticks=[-0.5, 0.0, 0.5], zticks=[0.0, 0.5, 1.0, 1.5])
    axis.set(xlabel="x [m]", ylabel="y [m]", zlabel="z [m]")
    axis.view_init(elev=18, azim=-65)


def _frame(axis: Any, pose: Array, name: str) -> None:
    for k, (color, letter) in enumerate(_AXES):
        end = pose[:3, 3] + 0.25 * pose[:3, k]
        axis.plot(*np.column_stack([pose[:3, 3], end]), color=color, linewidth=1.2)
        axis.text(*end, f"${letter}_{name}$", fontsize=7, color=color)


def _section(axis: Any, problem: Problem, link: int, plane: tuple[int, int]) -> None:
    along, x, radius = radius_profile(problem, link)
    edge = np.column_stack([np.concatenate([x, x[::-1]]), np.concatenate([radius, -radius[::-1]])])
    swap = plane[0] != along
    axis.fill(*(edge[:, ::-1] if swap else edge).T, color=GREY, alpha=0.3, linewidth=0)
    axis.set_aspect("equal")
    axis.set_title(f"link {link + 1}, section in its frame")
    axis.set_xlabel(f"$c_{{{link + 1}{'xyz'[plane[0]]}}}$ [m]")
    axis.set_ylabel(f"$c_{{{link + 1}{'xyz'[plane[1]]}}}$ [m]")


def _frame_the_shape(axis: Any, problem: Problem, link: int, plane: tuple[int, int]) -> None:
    """Show the link's shape and a margin of it: an ellipsoid that is larger is cut off, not the link."""
    along, x, radius = radius_profile(problem, link)
    ends = {along: (float(x.min()), float(x.max()))}
    widest = float(radius.max())
    spans = [ends.get(a, (-widest, widest)) for a in plane]
    margin = 0.5 * max(high - low for low, high in spans)
    for set_limits, (low, high) in zip((axis.set_xlim, axis.set_ylim), spans, strict=True):
        set_limits(low - margin, high + margin)


def _ellipse(axis: Any, link: Array, plane: tuple[int, int], look: dict[str, Any]) -> None:
    """Outline of the uniform ellipsoid with this mass and inertia, seen along the third axis."""
    p = inertia.pseudo_inertia(link)
    c = p[:3, 3] / p[3, 3]
    central = p[:3, :3] / p[3, 3] - np.outer(c, c)
    # A uniform ellipsoid with half axes a has second moments a^2 / 5; its shadow is that of 5 Sigma.
    values, vectors = np.linalg.eigh(5.0 * central[np.ix_(plane, plane)])
    angle = np.linspace(0.0, 2.0 * np.pi, 100)
    circle = np.sqrt(np.maximum(values, 0.0))[:, None] * np.vstack([np.cos(angle), np.sin(angle)])
    outline = vectors @ circle + c[list(plane)][:, None]
    axis.plot(*outline, linewidth=1.3, **look)
