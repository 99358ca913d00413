"""The sections of the report about the parameters: intervals, consistency, the arm as a picture."""

from typing import Any

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.estimation.constants import NORMAL_95
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.uncertainty import Interval, counts
from sdp_vs_penalty.exporters.friction_table import friction_curves
from sdp_vs_penalty.exporters.links import LINK_HEADS, link_rows, seen
from sdp_vs_penalty.formatting import number
from sdp_vs_penalty.reports.markup import Material, figure, table, text
from sdp_vs_penalty.reports.plots import COLOURS, MEASURED, Figure, friction_figure, trace
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot


def parameters(material: Material) -> str:
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
    last = material.last
    base_said = {b["name"]: (b["source"], b["nominal"]) for b in last.details.get("base_parameters", [])}
    rows = [cells(i, *base_said.get(i.name, ())) for i in known.base]
    body += table(HEADS, rows, numbers_from=3)
    inner = table(HEADS, standard_rows(last), numbers_from=3)
    return f"{body}<details><summary>Standard parameters</summary>{inner}</details>"


#: What :func:`cells` says of a parameter.
HEADS = ("parameter", "verdict", "from", "value", "low", "high", "nominal", "unit")


def standard_rows(estimate: Estimate) -> list[tuple[str, ...]]:
    """Every parameter of a model as text, in the order of HEADS."""
    known = estimate.uncertainty.standard, estimate.sources, estimate.nominal
    return [cells(*of) for of in zip(*known, strict=True)]


def cells(i: Interval, source: str = "", nominal: float = np.nan) -> tuple[str, ...]:
    """A parameter, the ends of its 95 % interval, what determined it and its nominal value, as text."""
    figures = (number(seen(x), 4) for x in (i.value, i.lower, i.upper, nominal))
    return i.name, i.verdict, source, *figures, formatting.plain_unit(i.unit)


def caveats(estimate: Estimate) -> list[str]:
    """What to know before parameters are read, a sentence each; the verdict judges the links."""
    sources, said = estimate.sources, []
    if law := estimate.details.get("servo"):
        told = f"the servos' law ({law['law']}) stands for it. Scale: {law['scale']}."
        said.append(f"No torque was logged: {told}")
    if others := [source for source in sources if source != "data"]:
        told = f"{len(others)} of {len(sources)} standard parameters are from the {others[0]}"
        said.append(f"{told}, not from the data: do not read them one by one.")
    return said


def arm(material: Material) -> str:
    """Every link's inertia ellipsoid on the arm's skeleton in the runs' mean pose, and its margins."""
    estimate = material.last
    if not len(estimate.model.rigid_indices):
        return text("This model has no rigid_body effect.")
    robot, links = estimate.robot, estimate.links
    (poses,) = robot.poses(robot.tree_state(material.measurements.q.mean(axis=0))[0])
    caption = (
        "Uniform ellipsoids with the identified masses and inertias, in the runs' mean pose. An "
        "ellipsoid that leaves the picture belongs to a link that these data hardly determine. Zero "
        "thickness (a rod or a sheet) is unphysical."
    )
    body = text(" ".join(caveats(estimate))) + table(LINK_HEADS, link_rows(estimate))
    return body + figure(_picture(robot, links, poses), caption, 460)


def friction(material: Material) -> str:
    """Friction by velocity with its band, a figure a joint."""
    body = text("Torque of all effects that follow the velocity alone; shaded: 95 % intervals.")
    if not (curves := friction_curves(material.last)):
        return text("The model has no friction that follows the velocity alone.")
    for c, unit in zip(curves, material.last.robot.torque_units, strict=True):
        plot = friction_figure(c.velocity, c.torque, NORMAL_95 * c.std, c.joint, unit)
        body += figure(plot, "", 250)
    return body


def _picture(robot: Robot, links: Array, poses: Array) -> Figure:
    """The skeleton and an ellipsoid a link."""
    plot, look = Figure(), dict[str, Any]()
    link = {carrier: place for place, carrier in enumerate(robot.link_joints)}
    for i, joint in enumerate(robot.tree):
        begin = np.zeros(3) if joint.parent < 0 else poses[joint.parent][:3, 3]
        x, y, z = np.stack([begin, poses[i][:3, 3]]).T
        look = {"mode": "lines+markers", "showlegend": False, "hoverinfo": "skip"}
        look |= {"line": {"color": MEASURED, "width": 6}, "marker": {"size": 3, "color": MEASURED}}
        plot.add(trace("scatter3d", x=x, y=y, z=z, **look))
        shape = ellipsoid(links[link[i]]) if i in link else None
        if shape is None:
            continue
        frame = poses[i] @ joint.link_frame
        x, y, z = frame[:3, :3] @ shape + frame[:3, 3:]
        look = {"alphahull": 0, "color": COLOURS[i % len(COLOURS)], "opacity": 0.5, "showlegend": True}
        plot.add(trace("mesh3d", x=x, y=y, z=z, name=f"link {link[i] + 1}", **look))
    axis = {"title": "", "gridcolor": "rgba(128,128,128,0.3)", "backgroundcolor": "rgba(0,0,0,0)"}
    # The picture is as large as the arm: an ellipsoid that leaves it belongs to a link whose mass
    # and inertia are not those of one body of that size.
    joints = np.array([np.zeros(3), *(pose[:3, 3] for pose in poses)])
    room = 0.25 * max(float(np.ptp(joints, axis=0).max()), 0.2)
    low, high = joints.min(axis=0) - room, joints.max(axis=0) + room
    ends = zip("xyz", low.tolist(), high.tolist(), strict=True)
    axes = {f"{name}axis": {**axis, "range": [a, b]} for name, a, b in ends}
    camera = {"eye": {"x": 1.3, "y": 1.3, "z": 0.6}}
    ratio = dict(zip("xyz", (1.2 * (high - low) / (high - low).max()).tolist(), strict=True))
    plot.update_layout(scene={"aspectmode": "manual", "aspectratio": ratio, "camera": camera, **axes})
    return plot


def ellipsoid(link: Array, fineness: int = 14) -> Array | None:
    """(3, k) points on the uniform solid ellipsoid with these standard parameters, in the link frame;
    None for a link without mass or thickness."""
    if (body := half_axes(link)) is None:
        return None
    half, axes, com = body
    u, v = np.meshgrid(np.linspace(0.0, np.pi, fineness), np.linspace(0.0, 2.0 * np.pi, 2 * fineness))
    ball = np.stack([np.sin(u) * np.cos(v), np.sin(u) * np.sin(v), np.cos(u)]).reshape(3, -1)
    return np.asarray(axes @ (half[:, None] * ball) + com[:, None], float)


def half_axes(link: Array) -> tuple[Array, Array, Array] | None:
    """Half axes (3,) [m] of that ellipsoid, sqrt(5 eigenvalues of Sigma_c / m), their directions (3, 3)
    as columns, right-handed, and its centre (3,)."""
    mass = link[0]
    if mass <= 0.0:
        return None
    pseudo, com = inertia.pseudo_inertia(link), link[1:4] / mass
    spread = pseudo[:3, :3] / mass - np.outer(com, com)
    values, axes = np.linalg.eigh(spread)
    if values[0] <= 0.0:
        return None
    return np.sqrt(5.0 * values), axes * np.sign(np.linalg.det(axes)), com
