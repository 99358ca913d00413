"""A problem from its name, a URDF file, or its folder: problem.toml, and the tables
that it names.

And the verb ``convert``: measurements of another program, for the robot of a problem.
"""

import json
import os
import re
import tomllib
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.arguments import checked_arguments
from sdp_vs_penalty.data.files import read_run, save, without_spans
from sdp_vs_penalty.data.hypotheses.renaming import scaled
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.parsing import numbers, pairs
from sdp_vs_penalty.errors import InputError, Remark, quote_value
from sdp_vs_penalty.files import problems_folder, read_table, read_toml, write_text
from sdp_vs_penalty.formatting import given_options
from sdp_vs_penalty.problem import constants as c
from sdp_vs_penalty.problem.bodies import link_bodies, plausible_links
from sdp_vs_penalty.problem.problem import CentreOfMassCone, Problem, entries, open_box
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.inertia import why_impossible
from sdp_vs_penalty.robot.joint import parse_held, parse_mechanism, parse_transmission
from sdp_vs_penalty.robot.model_files import described_robot
from sdp_vs_penalty.robot.plausible_units import odd_limits
from sdp_vs_penalty.robot.robot import STANDARD_GRAVITY, Robot
from sdp_vs_penalty.robot.robot_file import RobotFile, load_robot
from sdp_vs_penalty.signals.preprocessing import Preprocessing

#: Every field of a problem.toml: each holds what its example does. Numbers in a list
#: are one a joint beside a DH table, but for the vector of gravity and the two ends of
#: a mass.
EXAMPLE = Path(__file__).with_name("example.toml").read_text(encoding="utf-8")
_FIELDS = tomllib.loads(EXAMPLE)
_NEEDED = re.findall(r"^(\w+) = .*# needed", EXAMPLE, re.MULTILINE)


def check_fields(
    data: Mapping[str, Any], fields: Mapping[str, Any] = _FIELDS, section: str = ""
) -> None:
    """Check the fields of a TOML section before anything is built from them.

    Parameters
    ----------
    fields : mapping
        Example value of each known field, which says its kind.
    section : str
        Name of the section; "" for the top level.

    Raises
    ------
    InputError
        For a field that is unknown, missing or of another kind; it names section and
        field.
    """
    where = section or "the top level"
    for key in data:
        if key not in fields:
            raise InputError(
                f"{key!r} is unknown in {where}", f"choose from {', '.join(fields)}"
            )
    for key, like in fields.items():
        if key not in data:
            if key == "kinematics":
                what = "the section [kinematics] is missing"
                raise InputError(what, "give the robot's DH table or its URDF")
            if key in _NEEDED and "urdf" not in data:
                raise InputError(f"the field {key!r} is missing in {where}", "add it")
            continue
        is_list = isinstance(like, list)
        example = like[0] if is_list else like
        if not isinstance(example, dict):
            _check(f"{section} {key}".lstrip(), data[key], key, like, data)
            continue
        head = f"[[{key}]]" if is_list else f"[{key}]"
        parts = data[key] if is_list else [data[key]]
        if not (isinstance(parts, list) and all(isinstance(x, dict) for x in parts)):
            what = f"{key} is no {'list of sections' if is_list else 'section'}"
            raise InputError(what, f"write {head} above its fields")
        for part in parts:
            check_fields(part, example, head)


def _check(
    label: str, value: Any, key: str, like: Any, part: Mapping[str, Any]
) -> None:
    """Raise InputError for a value of another kind or length than its example ``like``.

    ``label`` names the field in messages; ``part`` is the section with all its fields.
    """
    hint = f"write {key} = {json.dumps(like)}"
    is_list = isinstance(like, list)
    example = like[0] if is_list else like
    word = {str: "text", int: "whole number", float: "number"}[type(example)]
    if is_list and not isinstance(value, list):
        raise InputError(f"{label} is {_shown(value)}, not a list of {word}s", hint)
    kinds = (float, int) if type(example) is float else (type(example),)
    for k, entry in enumerate(value if is_list else [value], start=1):
        if type(entry) not in kinds:
            where = f"{label}: entry {k}" if is_list else label
            raise InputError(f"{where} is {_shown(entry)}, not a {word}", hint)
    # gravity and total_mass are as long as their examples; other lists have one entry a
    # joint if the section has a DH table (field "a").
    needed = like if key in ("gravity", "total_mass") else part.get("a")
    if is_list and isinstance(needed, list) and len(value) != len(needed):
        what = f"{label} has {len(value)} entries, {len(needed)} are needed"
        raise InputError(what, hint if needed is like else "one per joint, as in a")


def _shown(value: Any) -> str:
    """Return a value as TOML writes it, at most 40 characters."""
    return (
        "a section" if isinstance(value, dict) else json.dumps(value, default=str)[:40]
    )


def _from_toml(
    folder: Path, held: Mapping[str, float], data: Mapping[str, Any]
) -> Problem:
    """Build the problem of a folder from the content ``data`` of its problem.toml.

    ``held`` are joints that stand still, by name, and their positions [rad, m].
    """
    check_fields(data)
    mechanism = data.get("mechanism", {})
    held_joints = parse_held(mechanism.get("held", ())) | dict(held)
    if mechanism and not {"joints", "held"} & set(mechanism):
        remedy = 'write joints = ["q1", ...] or held = ["finger_joint=0"]'
        raise InputError("[mechanism] says nothing of joints", remedy)
    parts = _robot_of(folder, data["kinematics"], held_joints)
    if "joints" in mechanism:
        parts = _with_mechanism(parts, mechanism)
    robot = parts.robot
    if "transmission" in data:
        robot = replace(robot, transmission=parse_transmission(**data["transmission"]))
    has_file = "urdf" in data["kinematics"]
    if not has_file:
        robot = robot.with_constant_joints(held_joints)
    if data.get("links", robot.links) != robot.links:
        what = f"links = {data['links']}, the kinematics have {robot.links}"
        raise InputError(what, "correct links, or leave it out")
    problem = _with_bounds_of(folder, data, robot)
    bodies = link_bodies(robot, problem.centre_boxes, parts.links, parts.geometry)
    drawn = parts.links if has_file else _ellipsoids_in_the_box(problem)
    nominal, sources = plausible_links(robot, drawn, bodies)
    if not has_file:
        sources = tuple("bounds" if x == "inertial" else x for x in sources)
    problem = replace(
        problem, nominal_links=nominal, bodies=bodies, nominal_from=sources
    )
    # Links that no file states are within their bounds.
    stated = np.array([x == "inertial" for x in problem.nominal_from or ()], bool)
    links = np.where(stated[:, None], problem.nominal_links, problem.prior_links)
    return replace(problem, nominal_links=links)


def _robot_of(
    folder: Path, kinematics: Mapping[str, Any], held: Mapping[str, float]
) -> RobotFile:
    """Build the robot of the section [kinematics] of a problem.toml.

    The section names a URDF file in ``folder``, or holds a DH table (a, alpha, d, one
    entry a joint). ``held`` are positions [rad, m] at which joints are fixed. A DH
    table has no links or shapes: those are zeros, and None.
    """
    x, y, z = map(float, kinematics.get("gravity", STANDARD_GRAVITY))
    gravity = (x, y, z)
    if "urdf" in kinematics:
        return load_robot(folder / kinematics["urdf"], gravity, held)
    fields = [k for k in ("lower", "upper", "velocity", "effort") if k in kinematics]
    limits = [
        {field: float(kinematics[field][joint]) for field in fields}
        for joint in range(len(kinematics["a"]))
    ]
    robot = Robot.from_dh(
        folder.name,
        a=kinematics["a"],
        alpha=[np.pi * x for x in kinematics["alpha_over_pi"]],
        d=kinematics["d"],
        convention=kinematics["convention"],
        gravity=gravity,
        limits=limits,
    )
    return RobotFile(robot, np.zeros((robot.links, 10)))


def _with_mechanism(parts: RobotFile, mechanism: Mapping[str, Any]) -> RobotFile:
    """Return the robot with dependent joints, as the section [mechanism] says.

    A dependent joint follows others linearly, such as in a parallelogram. Massless
    links are left out, so links and shapes are those of the remaining joints.
    """
    robot = parts.robot
    if robot.mechanism is not None:
        what = "the URDF has mimic joints of its own"
        raise InputError(what, "leave out [mechanism]")
    massless = [int(k) for k in mechanism.get("massless", ())]
    joints, followers = parse_mechanism(robot.tree, mechanism["joints"], massless)
    robot = replace(robot, joints=joints, mechanism=followers, transmission=None)
    shapes = parts.geometry and [parts.geometry[k] for k in robot.link_joints]
    return RobotFile(robot, parts.links[list(robot.link_joints)], shapes)


def _with_bounds_of(folder: Path, data: Mapping[str, Any], robot: Robot) -> Problem:
    """Return the problem that the sections of a problem.toml (``data``) state.

    Bounds come from tables of the parameters in ``folder``, the total mass and cones of
    the centre of mass. Nominal links (links, 10) are still zero.
    """
    bounds = data.get("bounds", {})
    box = open_box(robot.links)
    for table in bounds.get("tables", ()):
        _fill_box(box, folder / table)
    low, high = map(float, bounds.get("total_mass", Problem.total_mass))
    base = data.get("base_parameters", {}).get("independent")
    effects = data.get("effects")
    cones = map(CentreOfMassCone.from_dict, data.get("centre_of_mass_cone", ()))
    return Problem(
        name=folder.name,
        title=data["title"],
        robot=robot,
        box=box,
        nominal_links=np.zeros((robot.links, 10)),
        total_mass=(low, high),
        cones=tuple(cones),
        torque_side=data.get("torque_side", Problem.torque_side),
        preprocessing=Preprocessing(**data.get("preprocessing", {})),
        independent=None if base is None else tuple(base),
        folder=folder,
        effects=None if effects is None else tuple(effects),
    )


def _ellipsoids_in_the_box(problem: Problem) -> Array:
    """Return (links, 10) nominal parameters: solid ellipsoids in the centre-of-mass
    boxes.

    The mean of the total-mass bounds is shared in proportion to the boxes' surfaces.
    Half axes are those of the box, at least 6 cm. Without an upper bound of the total
    mass all are zero, and :func:`plausible_links` draws links later.
    """
    links = problem.robot.links
    least_total, most_total = problem.total_mass
    if not np.isfinite(most_total):
        return np.zeros((links, 10))
    com = np.minimum(problem.link_sizes[1], problem.robot.link_reach()[:, None])
    box = problem.box[:, 1:4]
    box = np.where(np.isfinite(box), box, np.stack([-com, com], axis=2))
    smallest_half_axis = 0.06  # m
    half_axes = np.maximum(0.5 * (box[..., 1] - box[..., 0]), smallest_half_axis)
    centre = box.mean(axis=2)
    # On the axis of a cone, half way into the box, a centre is inside of the cone.
    for cone in problem.cones:
        centre[cone.link - 1, ~cone.along] = 0.0
    # a b + b c + c a: proportional to the surface of the box.
    surface = np.sum(half_axes * np.roll(half_axes, 1, axis=1), axis=1)
    mass = 0.5 * (least_total + most_total) * surface / surface.sum()
    # Clearly inside the bounds of the mass: 1 g above the lower, 10 % below the upper.
    mass = np.clip(mass, problem.box[:, 0, 0] + 1e-3, 0.9 * problem.box[:, 0, 1])
    # A solid ellipsoid: Ixx = m (b^2 + c^2) / 5. Entries 4, 6, 9 are Ixx, Iyy, Izz.
    second = mass[:, None] * half_axes**2 / 5.0
    moments = second.sum(axis=1, keepdims=True) - second
    out = np.column_stack([mass, centre, np.zeros((links, 6))])
    out[:, [4, 6, 9]] = moments
    return inertia.standard_from_barycentric(out)


def _fill_box(box: Array, path: Path) -> None:
    """Read bounds from a CSV file with the columns parameter, lower, upper.

    ``box`` (links, 10, 2) receives them. Parameters are named m1, c1x, I1xx and so on.
    Raises InputError with the row's number for an unknown name, a missing number or a
    lower bound above the upper one.
    """
    place_by_name = entries(len(box))
    # Row 1 of the file is its header.
    for number, row in enumerate(read_table(path), start=2):
        name = row.get("parameter") or ""
        try:
            place = place_by_name[name]
            lower = float(row["lower"])
            upper = float(row["upper"])
            if np.isnan([lower, upper]).any():
                raise ValueError
        except (ValueError, KeyError, TypeError):
            what = (
                f"row {number}: {name!r} has no bounds, or is no parameter of a link of"
                " this robot"
            )
            remedy = (
                "write m1, c1x or I1xx under parameter, and numbers under lower and"
                " upper"
            )
            raise InputError(what, remedy, path) from None
        if not lower <= upper:
            what = (
                f"row {number}: {name} has its lower bound {lower:g} above its upper"
                f" {upper:g}"
            )
            raise InputError(what, "swap them", path)
        box[place] = lower, upper


def problem_names() -> list[str]:
    """Return the names of the built-in problems, sorted."""
    return sorted(p.parent.name for p in problems_folder().glob("*/problem.toml"))


def as_problem(source: str | Path | Problem, what: str = "problem") -> Problem:
    """Return a Problem from a Problem, a built-in name, a folder or a robot's file.

    Parameters
    ----------
    what : str
        What messages call the argument, such as "identify(problem=...)".

    Raises
    ------
    InputError
        As :func:`load_problem` does, or where the source is none of these.
    """
    if isinstance(source, Problem):
        return source
    if isinstance(source, str | Path):
        return load_problem(source)
    names = f"give a built-in name ({', '.join(problem_names())})"
    remedy = f"{names}, a folder with a problem.toml, a URDF file, or a Problem"
    raise InputError("no problem", remedy, what.replace("...", quote_value(source)))


@checked_arguments
def load_problem(
    source: str | Path,
    gravity: Sequence[float] | None = None,
    held: Mapping[str, float] | None = None,
) -> Problem:
    """Read what is known of a robot before anything is measured.

    Parameters
    ----------
    source : str or Path
        A built-in name, a folder with a problem.toml, a URDF, xacro, SDF or MJCF file,
        or a name of the package robot_descriptions.
    gravity : (3,) sequence of float, optional
        The gravity vector in the base frame [m/s^2], for a robot mounted otherwise.
    held : mapping of str to float, optional
        Joints that stand still, by name, and where [rad or m]. Their links become part
        of their parents.

    Returns
    -------
    Problem
        Robot, bounds, nominal links, effects and filters.

    Raises
    ------
    InputError
        Where there is no such problem, or its files contradict themselves.
    """
    path = Path(source)
    if str(source) in problem_names():
        path = problems_folder() / str(source)
    if os.path.isfile(path / "problem.toml"):  # False for what can be no name
        problem = read_toml(
            path / "problem.toml", partial(_from_toml, path, held or {})
        )
    elif os.path.isfile(path):
        problem = _from_robot_file(path, load_robot(path, held=held))
    elif re.fullmatch(r"[a-z0-9_]+_description", str(source)):
        return load_problem(described_robot(str(source)), gravity, held)
    else:
        remedy = (
            "name a folder with a problem.toml, a URDF file, or one of"
            f" {', '.join(problem_names())}"
        )
        raise InputError(f"problem {str(source)!r} does not exist", remedy)
    problem = replace(problem, source=source)
    return problem if gravity is None else problem.with_gravity(gravity)


def _from_robot_file(path: Path, file: RobotFile) -> Problem:
    """Build the problem of a robot's file, without a problem.toml.

    ``path`` is the user's file, ``file`` what it states. Bounds of the masses follow
    from the file's masses.
    """
    robot, links, values = file.robot, file.links, file.values
    # Servo gains are named k...; tell the user how to give them to `identify`.
    gains = [f"{n}={x:g}" for n, x in values.items() if n.startswith("k")]
    if gains:
        text = f"{path}: gains of position actuators, for a log without torque"
        warnings.warn(f"{text}: --known {','.join(gains)}", Remark, stacklevel=3)
    # Bounds of the masses [kg]; all other bounds stay open.
    masses = links[:, 0]
    box = open_box(robot.links, lowest_masses(masses))
    box[:, 0, 1] = np.maximum(c.DEFAULT_LINK_MASS[1], c.FAR_MASS * masses)
    bodies = link_bodies(robot, box[:, 1:4], links, file.geometry)
    nominal, sources = plausible_links(robot, links, bodies)
    for remark in _remarks_on(file):
        warnings.warn(f"{path}: {remark}", Remark, stacklevel=3)
    return Problem(
        name=robot.name,
        title=f"{robot.name} from {path.name}",
        robot=robot,
        box=box,
        nominal_links=nominal,
        bodies=bodies,
        nominal_from=sources,
        nominal_values=dict(values),
    )


def _remarks_on(file: RobotFile) -> Iterator[str]:
    """Yield what is odd about a robot's file: links that cannot exist, limits in
    degrees, couplings that are left out.
    """
    robot, links = file.robot, file.links
    names_by_reason: dict[tuple[str, str], list[str]] = {}
    for k, link in zip(robot.link_joints, links, strict=True):
        why = why_impossible(link)
        if why:
            stands_in = "the nearest possible one" if link[0] > 0.0 else "a guess"
            names = names_by_reason.setdefault((why, stands_in), [])
            names.append(robot.tree[k].name)
    for (why, stands_in), names in names_by_reason.items():
        yield (
            f"{why} of the link behind {', '.join(names)}: no such body exists, and"
            f" {stands_in} stands for it (details: `check-urdf`)"
        )
    in_degrees = odd_limits(robot.joints)
    if in_degrees:
        yield in_degrees
    if file.couplings:
        yield file.couplings


def lowest_masses(nominal: Array) -> Array:
    """Return lower bounds of the masses of links with the nominal standard parameters
    (links, 10): a third of the nominal masses, at most 10 g.

    Returns
    -------
    (links,) array
        Masses [kg]; 10 g where no nominal mass is known.
    """
    largest_bound = c.DEFAULT_LINK_MASS[0]
    return np.where(
        nominal > 0.0, np.minimum(largest_bound, nominal / c.FAR_MASS), largest_bound
    )


def with_filters(problem: Problem, cutoffs: str | None) -> Problem:
    """Return the problem with other cut-off frequencies of the filters.

    Parameters
    ----------
    cutoffs : str or None
        "states,torque" [Hz]; None changes nothing.
    """
    if cutoffs is None:
        return problem
    state, torque = numbers("--filters", cutoffs, 2)
    settings = replace(problem.preprocessing, state_cutoff=state, torque_cutoff=torque)
    return replace(problem, preprocessing=settings)


def _end(value: float | None) -> str:
    """Return an end of a bound as --bounds has it; "" for an open one."""
    return "" if value is None else repr(float(value))


def with_bounds(
    problem: Problem,
    bounds: str | Mapping[str, tuple[float | None, float | None]] | None,
) -> Problem:
    """Return the problem with other bounds of parameters.

    Equal ends of a mass, or of a centre of mass in the joint's axes, are known values
    (:attr:`Problem.known`).

    Parameters
    ----------
    bounds : str, mapping or None
        "m2=1:5,c2x=-0.1:,total=:20" or {"m2": (1, 5), "c2x": (-0.1, None)} [kg, m, kg m^2],
        by the names of a ``bounds.csv``, and ``total``. An end that is left out is open (a
        mass has 0). None changes nothing.

    Raises
    ------
    InputError
        Where the text is another one, names no link, or swaps the ends.
    """
    if bounds is None:
        return problem
    if not isinstance(bounds, str):
        bounds = ",".join(
            f"{name}={_end(low)}:{_end(high)}" for name, (low, high) in bounds.items()
        )
    places = entries(problem.robot.links)
    box = problem.box.copy()
    total = problem.total_mass
    for name, ends in (pairs("--bounds", bounds) or {}).items():
        low, _, high = ends.partition(":")
        is_mass = name.startswith(("m", "total"))
        open_low = 0.0 if is_mass else -np.inf
        try:
            new = float(low or open_low), float(high or np.inf)
            if name == "total":
                total = new
            else:
                box[places[name]] = new
        except (ValueError, KeyError):
            remedy = "write NAME=LOWER:UPPER, of m1, c1x, I1xx, total"
            raise InputError(f"--bounds {name}={ends}", remedy) from None
    return replace(problem, box=box, total_mass=total)


def convert_options(
    problem: str | Path | Problem | None,
    topic: str | None,
    motors: str | Sequence[str] | bool,
    hold: str | None = None,
    *,
    joint_torque: bool = False,
) -> list[str]:
    """Return the words of a `convert` command for the options of these arguments.

    They are as :func:`convert` takes them, but ``hold`` is the text of --hold. A
    Problem has no word.
    """
    formulas = None
    if not isinstance(motors, bool):
        formulas = motors if isinstance(motors, str) else ",".join(motors)
    options = {
        "--problem": problem if isinstance(problem, str | Path) else None,
        "--hold": hold,
        "--topic": topic,
        "--motors": formulas,
    }
    words = given_options(options)
    if motors is True:
        words.append("--motor-side")
    if joint_torque:
        words.append("--joint-torque")
    return words


@checked_arguments
def convert(
    source: str | Path,
    out: str | Path | None = None,
    *,
    problem: str | Path | Problem | None = None,
    joints: Sequence[str] | None = None,
    topic: str | None = None,
    rename: Mapping[str, str] | None = None,
    motors: str | Sequence[str] | bool = False,
    joint_torque: bool = False,
    rate: float | None = None,
    scale: Mapping[str, str] | None = None,
    cut: Sequence[tuple[float, float]] = (),
    options: Sequence[str] | None = None,
) -> Measurements:
    """Read measurements of another program, and write them in another format.

    Columns of common loggers are recognised without ``rename``.

    Parameters
    ----------
    source : str or Path
        A .csv, .npz, .mat, .parquet, .mcap or .bag file, or a ROS 2 bag's folder.
    out : str or Path, optional
        The file to write: .csv, .npz, .parquet or .mat. Default: nothing is written.
    problem : str, Path or Problem, optional
        The robot whose joint names choose the joints of a ROS bag.
    joints : sequence of str, optional
        These names, in place of the robot's.
    topic : str, optional
        The JointState topic, where a bag has several.
    rename : mapping of str to str, optional
        From t, q, dq, tau (or q1, ...) to the names of the file's columns or variables;
        ``{"q*": "actual_q_*"}`` names one a joint.
    motors : str, sequence of str, or bool
        For channels that were logged at the motors: each motor's position as a formula
        of the joints' ("32 q5 + 32 q6"), several separated by commas or in a sequence,
        or True for the transmission of ``problem``. The run is written on the joint
        side, which is what every other verb reads.
    joint_torque : bool
        Whether the torques are those of the joints already, and ``motors`` is of the
        positions alone.
    rate : float, optional
        Samples a second [Hz], in place of the file's clock. A table without header then
        has 3 n columns: q1..qn, dq1..dqn, tau1..taun.
    scale : mapping of str to str, optional
        What t, q, dq, tau are multiplied by: a unit (deg, ms, mNm), a number, or
        numbers joint by joint separated by colons, as drive gains are.
    cut : sequence of pairs of float
        Begin and end [s] of spans that are left out, by the clock of the run.
    options : sequence of str, optional
        Words of the printed command beside those for columns, units, joints and rate.
        Default: of the problem's path, the topic and the motors.

    Returns
    -------
    Measurements
        The run, in SI units, on the joint side.

    Raises
    ------
    InputError
        For a file that cannot be read, or columns that are missing.
    """
    if joints is None and problem is not None:
        joints = as_problem(problem, "convert(problem=...)").channel_names
    # Positions of the motors by those of the joints: formulas, or the problem's.
    transmission = None
    if not isinstance(motors, bool | str) and not motors:
        raise InputError("convert(motors): no formula", "write one a motor")
    if not isinstance(motors, bool):
        transmission = parse_transmission(
            motors.split(",") if isinstance(motors, str) else motors,
            torques=("joint",) if joint_torque else ("motor",),
        )
    elif motors and problem is not None:
        transmission = as_problem(problem).robot.transmission
        if transmission is not None:
            transmission = transmission.at_motors(joint_torque=joint_torque)
    if motors and transmission is None:
        remedy = (
            "name a problem that has one, or write each motor's position, such as 50"
            " q1,30 q2"
        )
        raise InputError("no transmission is known", remedy, "convert(motors=True)")
    if options is None:
        options = convert_options(problem, topic, motors, joint_torque=joint_torque)
    run = read_run(
        source,
        joints=None,
        names=joints,
        topic=topic,
        rename=rename,
        rate=rate,
        scale=scale,
        options=options,
    )
    if scale:
        run = scaled(run, scale)
    if transmission is not None:
        from sdp_vs_penalty.data.datasets import to_joints

        run = to_joints(run, transmission)
    run = without_spans(run, cut)
    if out is not None:
        save(run, out)
        if run.reading:
            write_text(columns_note(out), f"{run.reading}\n")
    return run


def columns_note(out: str | Path) -> Path:
    """Return the file beside a converted run that says what its columns were taken for."""
    return Path(out).with_name(f"{Path(out).stem}_columns.txt")
