"""The sections of the report about the parameters: intervals, consistency, the arm as a picture."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty.estimation.intervals import Interval, counts
from sdp_vs_penalty.report.plots import COLOURS, MEASURED
from sdp_vs_penalty.report.section import Material, Section, figure, number, table, text
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.robot import Robot

Array = NDArray[np.float64]


def parameters(material: Material) -> Section:
    """Base and standard parameters with intervals and verdicts."""
    known = material.last.uncertainty
    base, standard = counts(known.base), counts(known.standard)
    runs = ", ".join(map(str, material.last.provenance.get("runs", []))) or "unknown runs"
    body = text(
        f"Values and 95 % intervals are those of {material.last_name}, from the runs that it was "
        f"identified from ({runs}). They hold the noise, the model's own errors as far as these runs "
        "show them and the errors of estimated shape constants; where the estimate satisfies "
        f"constraints, so do they. Of {len(known.base)} base "
        f"parameters (the combinations that torques determine) {base['identifiable']} are "
        f"identifiable, {base['weakly']} weakly, {base['not seen']} not; of {len(known.standard)} "
        f"standard parameters {standard['identifiable']}, {standard['weakly']} and "
        f"{standard['not seen']}. Parameters that are not from the data have values of the "
        "prior (the nominal robot) or of the bounds, not measured ones."
    )
    heads = ("parameter", "verdict", "from", "value", "low", "high", "nominal", "unit")
    last = material.last
    base_said = {b["name"]: (b["source"], b["nominal"]) for b in last.details.get("base_parameters", [])}
    said = {
        p.name: (source, nominal)
        for p, source, nominal in zip(last.model.parameters, last.sources, last.nominal, strict=True)
    }
    body += table(
        heads, [_row(i, *base_said.get(i.name, ("", np.nan))) for i in known.base], numbers_from=3
    )
    inner = table(heads, [_row(i, *said[i.name]) for i in known.standard], numbers_from=3)
    body += f"<details><summary>Standard parameters</summary>{inner}</details>"
    return Section("parameters", "Parameters", body)


def _row(i: Interval, source: str, nominal: float) -> tuple[str, ...]:
    known = "" if np.isnan(nominal) else number(nominal)
    return i.name, i.verdict, source, number(i.value), number(i.low), number(i.high), known, i.unit


def arm(material: Material) -> Section:
    """Every link's inertia ellipsoid on the arm's skeleton in the runs' mean pose, and its margins."""
    estimate = material.last
    if not len(estimate.model.rigid_indices):
        return Section("arm", "Links", text("This model has no rigid_body effect."))
    robot, links = estimate.robot, estimate.links
    plot = _picture(robot, links, joint_poses(robot, material.measurements.q.mean(axis=0)))
    caption = (
        "Uniform ellipsoids with the identified masses and inertias, in the runs' mean pose. An "
        "ellipsoid that leaves the picture belongs to a link that these data hardly determine. Zero "
        "thickness (a rod or a sheet) is unphysical."
    )
    return Section("arm", "Links on the arm", figure(plot, caption, 520) + _margins(robot, links))


def _picture(robot: Robot, links: Array, poses: list[Array]) -> Any:
    """The skeleton and an ellipsoid a link."""
    from plotly.graph_objects import Figure, Mesh3d, Scatter3d

    plot = Figure()
    link = {carrier: place for place, carrier in enumerate(robot.link_joints)}
    for i, joint in enumerate(robot.tree):
        begin = np.zeros(3) if joint.parent < 0 else poses[joint.parent][:3, 3]
        x, y, z = np.stack([begin, poses[i][:3, 3]]).T
        plot.add_trace(
            Scatter3d(
                x=x,
                y=y,
                z=z,
                mode="lines+markers",
                line={"color": MEASURED, "width": 6},
                marker={"size": 3, "color": MEASURED},
                showlegend=False,
                hoverinfo="skip",
            )
        )
        shape = ellipsoid(links[link[i]]) if i in link else None
        if shape is None:
            continue
        frame = poses[i] @ joint.link_frame
        x, y, z = frame[:3, :3] @ shape + frame[:3, 3:]
        plot.add_trace(
            Mesh3d(
                x=x,
                y=y,
                z=z,
                alphahull=0,
                color=COLOURS[i % len(COLOURS)],
                opacity=0.5,
                name=f"link {link[i] + 1}",
                showlegend=True,
            )
        )
    axis = {"title": "", "gridcolor": "rgba(128,128,128,0.3)", "backgroundcolor": "rgba(0,0,0,0)"}
    # The picture is as large as the arm: an ellipsoid that leaves it belongs to a link whose mass
    # and inertia are not those of one body of that size.
    joints = np.array([np.zeros(3), *(pose[:3, 3] for pose in poses)])
    room = 0.25 * max(float(np.ptp(joints, axis=0).max()), 0.2)
    low, high = joints.min(axis=0) - room, joints.max(axis=0) + room
    axes = {
        f"{name}axis": {**axis, "range": [float(a), float(b)]}
        for name, a, b in zip("xyz", low, high, strict=True)
    }
    camera = {"eye": {"x": 1.3, "y": 1.3, "z": 0.6}}
    ratio = dict(zip("xyz", (1.2 * (high - low) / (high - low).max()).tolist(), strict=True))
    plot.update_layout(scene={"aspectmode": "manual", "aspectratio": ratio, "camera": camera, **axes})
    return plot


def _margins(robot: Robot, links: Array) -> str:
    """Mass, centre of mass and what is left until no body is possible, a row a link."""
    rows = []
    thick, triangle = inertia.thickness(links), inertia.triangle_margin(links)
    margins = inertia.consistency_margin(links)
    for i, link in enumerate(links):
        com = link[1:4] / link[0] if link[0] > 0.0 else np.full(3, np.nan)
        rows.append(
            (
                f"{i + 1} ({robot.tree[robot.link_joints[i]].name})",
                number(link[0]),
                ", ".join(number(c, 3) for c in com),
                number(triangle[i], 3),
                number(margins[i], 3),
                f"{1e3 * thick[i]:.1f}",
            )
        )
    heads = (
        "link",
        "mass [kg]",
        "centre of mass [m]",
        "triangle [kg m2]",
        "pseudo-inertia",
        "thickness [mm]",
    )
    return table(heads, rows)


def ellipsoid(link: Array, fineness: int = 14) -> Array | None:
    """(3, k) points on the uniform solid ellipsoid with these standard parameters, in the link frame.

    Its half axes are sqrt(5 eigenvalues of Sigma_c / m). None for a link without mass or thickness.
    """
    mass = link[0]
    if mass <= 0.0:
        return None
    pseudo, com = inertia.pseudo_inertia(link), link[1:4] / mass
    spread = pseudo[:3, :3] / mass - np.outer(com, com)
    values, axes = np.linalg.eigh(spread)
    if values[0] <= 0.0:
        return None
    u, v = np.meshgrid(np.linspace(0.0, np.pi, fineness), np.linspace(0.0, 2.0 * np.pi, 2 * fineness))
    ball = np.stack([np.sin(u) * np.cos(v), np.sin(u) * np.sin(v), np.cos(u)]).reshape(3, -1)
    return np.asarray(axes @ (np.sqrt(5.0 * values)[:, None] * ball) + com[:, None], float)


def joint_poses(robot: Robot, q: Array) -> list[Array]:
    """(4, 4) pose of each joint frame, moved by its joint, in the base; q (n,)."""
    out: list[Array] = []
    for joint, value in zip(robot.tree, robot.tree_state(q)[0][0], strict=True):
        move = np.eye(4)
        if joint.kind == "prismatic":
            move[:3, 3] = value * joint.axis
        else:
            x, y, z = joint.axis
            k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
            move[:3, :3] += np.sin(value) * k + (1.0 - np.cos(value)) * (k @ k)
        parent = np.eye(4) if joint.parent < 0 else out[joint.parent]
        out.append(parent @ joint.placement @ move)
    return out
