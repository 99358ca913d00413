"""Read a robot from an MJCF file through MuJoCo's own reader (extra [engines]): hinges
and slides, several of one body, mimic joints by equality, armature, damping, friction
loss and the gains of position actuators.

MuJoCo parses in a process of its own: a broken file ends that process.
"""

import json
import os
import re
import tempfile
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.errors import InputError, missing_extra
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.isolated import Arrays, ParserEndedError, parse_isolated
from sdp_vs_penalty.robot.joint import (
    Follower,
    HeldJoint,
    Joint,
    hold_followers,
    resolve_mimic_joints,
)
from sdp_vs_penalty.robot.robot import Robot, check_held
from sdp_vs_penalty.robot.rotation import joint_motion, rotation_of_quaternion
from sdp_vs_penalty.robot.urdf import not_read

#: The arrays of MuJoCo's model that are needed, by its own names.
_ARRAYS = (
    "actuator_biasprm",
    "actuator_biastype",
    "actuator_gainprm",
    "actuator_gear",
    "actuator_trnid",
    "actuator_trntype",
    "body_inertia",
    "body_ipos",
    "body_iquat",
    "body_jntadr",
    "body_jntnum",
    "body_mass",
    "body_parentid",
    "body_pos",
    "body_quat",
    "dof_armature",
    "dof_damping",
    "dof_frictionloss",
    "eq_active0",
    "eq_data",
    "eq_obj1id",
    "eq_obj2id",
    "eq_type",
    "jnt_actfrclimited",
    "jnt_actfrcrange",
    "jnt_axis",
    "jnt_dofadr",
    "jnt_limited",
    "jnt_pos",
    "jnt_qposadr",
    "jnt_range",
    "jnt_type",
    "qpos0",
)
#: Size of a file for which :func:`memory_for` allows 2 GB: meshes may lie anywhere,
#: hence one limit for all.
_N_BYTES = 2**26
_NEEDS_MEMORY = "MuJoCo needs more than 2 GB of memory for it"
_MESHES_REMEDY = "write an <inertial> into each body: their meshes are then not read"
#: Fields of MuJoCo's model by which a tendon pulls without a drive.
_PULLS = ("tendon_stiffness", "tendon_damping", "tendon_frictionloss", "tendon_limited")
#: MuJoCo's numbers of kinds (mjtJoint, mjtEq, mjtTrn, mjtBias).
_SLIDE = 2
_HINGE = 3
_KINDS = {_SLIDE: "prismatic", _HINGE: "revolute"}
_JOINT_EQUALITY = 2
_JOINT_TRANSMISSION = 0
_AFFINE_BIAS = 1


@dataclass(frozen=True)
class MujocoModel:
    """What MuJoCo's compiler makes of a file."""

    #: Path of the file.
    path: Path
    #: Name of the model; "" where it has none.
    name: str
    #: (3,) gravity in the world frame [m/s^2].
    gravity: tuple[float, float, float]
    #: Names of all joints in MuJoCo's order.
    joint_names: tuple[str, ...]
    #: Names of all bodies, the world's first; "" where one has none.
    body_names: tuple[str, ...]
    #: What each equality of the model couples, in words.
    equalities: tuple[str, ...]
    #: Tendons that pull on joints by themselves, in words.
    tendons: tuple[str, ...]
    #: Arrays of the model by the names of MuJoCo's fields of mjModel.
    arrays: Arrays

    def row(self, field: str, index: int) -> Array:
        """Return one row of a field of MuJoCo's model."""
        return self.arrays[field][index]

    def number(self, field: str, index: int) -> float:
        """Return one number of a field of MuJoCo's model."""
        return float(np.ravel(self.arrays[field][index])[0])

    def integer(self, field: str, index: int) -> int:
        """Return one integer of a field of MuJoCo's model."""
        return int(self.number(field, index))

    def start(self, joint: int) -> float:
        """Return the position of a joint in the file's reference configuration [rad,
        m].
        """
        return self.number("qpos0", self.integer("jnt_qposadr", joint))


@dataclass(frozen=True)
class PlacedBody:
    """A body of an MJCF file, and the joint that it moves with."""

    #: Its name; "" where it has none.
    name: str
    #: Names of its own joints; () where it is fixed to its parent.
    joints: tuple[str, ...]
    #: Index of the moving joint that carries it, among those of the robot's tree; -1
    #: for the world.
    carrier: int
    #: Its pose (4, 4) in the moved frame of that joint.
    pose: Array
    #: Its standard parameters (10,) about its own frame.
    inertial: Array


def load_mjcf(
    path: str | Path,
    gravity: Sequence[float] | None = None,
    held: Mapping[str, float] | None = None,
) -> tuple[Robot, Array, dict[str, float], str]:
    """Read the robot of an MJCF file, its nominal links, nominal values of its joints, and
    what is left out.

    A body without joints belongs to its parent; what is fixed to the world is dropped.
    Joints of an equality follow one another.

    Parameters
    ----------
    path : str or Path
        The file; files that it includes lie beside it.
    gravity : (3,) sequence of float, optional
        Gravity in the base frame [m/s^2]; default: the file's.
    held : mapping of str to float, optional
        Joints that stand still, and their positions [rad, m].

    Returns
    -------
    robot : Robot
        The robot, its joints depth first.
    links : (links, 10) array
        Standard parameters about the link frames.
    values : dict
        Parameters by name: armature I_a1 [kg m^2], damping f_v1 [N m s/rad], friction
        loss f_c1 [N m], gains of position actuators kp1 [N m/rad], kd1 [N m s/rad].
    couplings : str
        Which tendons between joints are left out; "" for none.

    Raises
    ------
    InputError
        For a file that MuJoCo does not read, a free or ball joint, a loop, or no joint
        at all.
    """
    model, robot, links, _ = _load(path, gravity, held)
    values = _values(model, robot.joint_names)
    return robot, links, values, not_read(model.tendons)


def load_bodies(
    path: str | Path, held: Mapping[str, float] | None = None
) -> tuple[Robot, list[PlacedBody]]:
    """Read the robot of an MJCF file, and the bodies of the file in its order, parents
    first.

    Parameters
    ----------
    held : mapping of str to float, optional
        Joints that stand still, and their positions [rad, m].

    Raises
    ------
    InputError
        As :func:`load_mjcf`.
    """
    _, robot, _, bodies = _load(path, None, held)
    return robot, bodies


def _load(
    path: str | Path, gravity: Sequence[float] | None, held: Mapping[str, float] | None
) -> tuple[MujocoModel, Robot, Array, list[PlacedBody]]:
    """Return MuJoCo's model of a file, the robot, its links' standard parameters (links,
    10), and where the file's bodies lie; see :func:`load_mjcf`."""
    model = _compiled(Path(path))
    held_positions = dict(held or {})
    constants, followers = _equalities(model)
    placed = tuple[HeldJoint, ...]()
    if held_positions:
        robot, _, _ = _robot_of(model, constants, followers, gravity)
        driven = robot.joint_names
        places = check_held(driven, held_positions)
        placed = tuple(
            HeldJoint(driven[k], held_positions[driven[k]], k) for k in places
        )
    held_joints = hold_followers(held_positions | constants, followers)
    return model, *_robot_of(model, held_joints, followers, gravity, placed)


def _robot_of(
    model: MujocoModel,
    fixed_positions: Mapping[str, float],
    followers: Mapping[str, Follower],
    gravity: Sequence[float] | None,
    held: tuple[HeldJoint, ...] = (),
) -> tuple[Robot, Array, list[PlacedBody]]:
    """Return the robot, its links (links, 10) and bodies; the joints named in
    ``fixed_positions`` are fixed there [rad, m]."""
    tree, places = _tree(model, fixed_positions)
    links = [np.zeros(10) for _ in tree]
    for place in places:
        if place.carrier >= 0:
            links[place.carrier] += inertia.transform(place.pose) @ place.inertial
    massless = tuple(k for k, link in enumerate(links) if not link.any())
    massless = massless if len(massless) < len(links) else ()
    moving = {joint.name for joint in tree}
    moving_followers = {name: f for name, f in followers.items() if name in moving}
    joints, mechanism = resolve_mimic_joints(tree, moving_followers, massless)
    down = model.gravity
    if gravity is not None:
        x, y, z = map(float, gravity)
        down = (x, y, z)
    name = model.name or model.path.stem
    robot = Robot(
        name, joints, gravity=down, transmission=None, mechanism=mechanism, held=held
    )
    with_mass = np.array([x for k, x in enumerate(links) if k not in massless])
    return robot, with_mass, places


def _compiled(path: Path) -> MujocoModel:
    """Compile an MJCF file by MuJoCo in a child process, since a broken file can end it.

    Raises InputError for a file that MuJoCo does not read.
    """
    try:
        # MuJoCo writes its log file into the folder in which it works.
        with tempfile.TemporaryDirectory() as folder:
            (answer,) = parse_isolated(
                model_arrays,
                path.absolute(),
                folder,
                library="mujoco",
                seconds=60.0,  # hulls of large meshes
                n_bytes=_N_BYTES,
            )
    except InputError as error:
        raise InputError(error.what, error.remedy, path) from error
    except MemoryError as error:
        raise InputError(_NEEDS_MEMORY, _MESHES_REMEDY, path) from error
    except ImportError as error:
        raise missing_extra("MJCF files need", "engines") from error
    except ParserEndedError as error:
        what = f"MuJoCo does not read it ({error})"
        raise InputError(what, "correct it", path) from error
    arrays = dict(answer)
    x, y, z = arrays.pop("gravity").tolist()
    names = json.loads(arrays.pop("names").astype(np.uint8).tobytes())
    # A joint without a name is called by its number.
    joint_names = [text or f"joint{k}" for k, text in enumerate(names["joints"], 1)]
    return MujocoModel(
        path,
        name=names["model"],
        gravity=(x, y, z),
        joint_names=tuple(joint_names),
        body_names=tuple(names["bodies"]),
        equalities=tuple(names["equalities"]),
        tendons=tuple(names["tendons"]),
        arrays=arrays,
    )


def model_arrays(path: str, folder: str) -> Iterator[Arrays]:
    """Yield the fields of a compiled MuJoCo model as arrays, and its names as one more.

    It runs in a child process, which a broken file can end. Only arrays of numbers pass
    from it to the parent process, so names pass as the bytes of a JSON text.

    Parameters
    ----------
    path : str
        An MJCF file, from the root of the file system.
    folder : str
        Folder to work in, where MuJoCo may write its log.

    Yields
    ------
    dict of str to array
        "gravity" (3,) [m/s^2]; the fields of MuJoCo's ``mjModel`` that are read, such
        as "body_mass" [kg]; "names" (bytes,), JSON with "model", "joints", "bodies", "tendons" that
        pull, and "equalities": what each of them couples.

    Raises
    ------
    InputError
        MuJoCo does not read the file.
    MemoryError
        The meshes of bodies without an <inertial> are too large.
    """
    import mujoco

    os.chdir(folder)
    spec: Any = None
    try:
        spec = mujoco.MjSpec.from_file(path)
        _drop_shapes(spec)
        model = spec.compile()
    except ValueError as error:
        raise _refusal(str(error), spec) from error
    fields = {name: np.array(getattr(model, name), float) for name in _ARRAYS}
    names = {
        "model": _name_of_model(model),
        "joints": [model.joint(k).name for k in range(model.njnt)],
        "bodies": [model.body(k).name for k in range(model.nbody)],
        "equalities": [_equality_words(model, k) for k in range(model.neq)],
        "tendons": [
            f"tendon {model.tendon(k).name!r}"
            for k in range(model.ntendon)
            if any(np.any(getattr(model, x)[k]) for x in _PULLS)
        ],
    }
    name_bytes = np.array([*json.dumps(names).encode()], float)
    yield {"gravity": np.array(model.opt.gravity, float), "names": name_bytes, **fields}


def _refusal(message: str, spec: Any) -> Exception:
    """Return the error of a file that MuJoCo does not read, from MuJoCo's ``message``.

    Where an inertia is wrong it names the body and the correction; ``spec`` is MuJoCo's
    specification of the file, None if it was not parsed.
    """
    reason, *further_lines = message.splitlines() or ["no reason given"]
    if "unknown exception" in reason:  # as it calls C++'s bad_alloc
        return MemoryError()
    where, remedy = "", "correct it"
    named = re.search("Element name '([^']+)'", " ".join(further_lines))
    body = None
    if spec is not None and named and "inertia" in reason:
        body = spec.body(named[1])
    if body is not None:
        where = f", body {body.name!r}"
        if np.isfinite(body.fullinertia).all() and "inertia must" in reason:
            remedy = (
                "correct it: fullinertia is Ixx Iyy Izz Ixy Ixz Iyz, and a URDF's order is"
                " another one, Ixx Ixy Ixz Iyy Iyz Izz"
            )
        elif "A + B" in reason:
            diagonal = " ".join(f"{x:g}" for x in body.inertia)
            remedy = (
                f"correct its diaginertia, {diagonal}: no principal moment of a body is larger"
                " than the sum of the other two"
            )
    return InputError(f"MuJoCo does not read it ({reason[:200]}{where})", remedy)


def _equality_words(model: Any, k: int) -> str:
    """Return what equality k of MuJoCo's model couples, such as "connect of 'rod' and
    'crank'"."""
    import mujoco

    kind = mujoco.mjtEq(model.eq_type[k]).name.removeprefix("mjEQ_").lower()
    objects = {
        "joint": mujoco.mjtObj.mjOBJ_JOINT,
        "tendon": mujoco.mjtObj.mjOBJ_TENDON,
    }.get(kind, model.eq_objtype[k])
    names = [
        repr(mujoco.mj_id2name(model, objects, int(i)) or f"number {i}")
        for i in (model.eq_obj1id[k], model.eq_obj2id[k])
        if i >= 0
    ]
    return f"{kind} of {' and '.join(names)}"


def _drop_shapes(spec: Any) -> None:
    """Remove from MuJoCo's specification the shapes of bodies whose <inertial> it
    takes, and the files that no other body needs: they may be missing, or large.

    Nothing is removed from a file with tendons, which may run around shapes.
    """
    import mujoco

    takes_shapes = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    if spec.compiler.inertiafromgeom == takes_shapes or len(spec.tendons):
        return
    for element in (*spec.sensors, *spec.pairs, *spec.skins, *spec.keys):
        spec.delete(element)
    for body in list(spec.bodies):
        if body.explicitinertial or body.name == "world":
            for geom in list(body.geoms):
                spec.delete(geom)
    _keep(spec, spec.meshes, {geom.meshname for geom in spec.geoms})
    _keep(spec, spec.materials, {geom.material for geom in spec.geoms})
    _keep(spec, spec.hfields, {geom.hfieldname for geom in spec.geoms})
    textures = {name for material in spec.materials for name in material.textures}
    _keep(spec, spec.textures, textures)


def _keep(spec: Any, elements: Iterable[Any], names: Collection[str]) -> None:
    """Remove from MuJoCo's specification those elements that have none of the names."""
    for element in list(elements):
        if element.name not in names:
            spec.delete(element)


def _name_of_model(model: object) -> str:
    """Return the model's name, the first in MuJoCo's zero-terminated list of names."""
    names: bytes = model.names  # type: ignore[attr-defined]
    return names.partition(b"\0")[0].decode(errors="replace")


def _equalities(model: MujocoModel) -> tuple[dict[str, float], dict[str, Follower]]:
    """Return the joints that an equality holds still, and the joints that follow
    others.

    MuJoCo's equality of joints is q_1 - start_1 = c_0 + c_1 (q_2 - start_2) + ..., with
    the coefficients c_0 to c_4 in ``eq_data``. Without a second joint, joint 1 stands
    still. The first dict maps names to positions [rad, m], the second to (leader,
    slope, offset). Raises InputError for other equalities, such as of a closed loop,
    and for curves.
    """
    constants = dict[str, float]()
    followers = dict[str, Follower]()
    for k in range(len(model.arrays["eq_type"])):
        if not model.integer("eq_active0", k):
            continue
        if model.integer("eq_type", k) != _JOINT_EQUALITY:
            what = f"an equality that is no mimic joint: a {model.equalities[k]}, as of a closed loop"
            remedy = "cut the loop, for only trees can be identified"
            raise InputError(what, remedy, model.path)
        first = model.integer("eq_obj1id", k)
        second = model.integer("eq_obj2id", k)
        course = model.row("eq_data", k)[:5]
        name = model.joint_names[first]
        if second < 0:
            constants[name] = model.start(first) + float(course[0])
            continue
        if np.any(course[2:]):
            what = f"joint {name!r} follows another one by a curve"
            raise InputError(what, "make its polycoef a straight line", model.path)
        constant, slope = course[:2].tolist()
        offset = model.start(first) + constant - slope * model.start(second)
        followers[name] = model.joint_names[second], slope, offset
    return constants, followers


def _tree(
    model: MujocoModel, fixed_positions: Mapping[str, float]
) -> tuple[list[Joint], list[PlacedBody]]:
    """Return the moving joints depth first, and where each body lies.

    ``fixed_positions`` are those of fixed joints [rad, m]. A body with several joints
    belongs to the last; the links of the others are massless.
    """
    joints = list[Joint]()
    world = PlacedBody("", (), -1, np.eye(4), np.zeros(10))
    bodies = [world]
    for body in range(1, len(model.arrays["body_parentid"])):
        parent = model.integer("body_parentid", body)
        pose_in_parent = _pose(
            model.row("body_pos", body), model.row("body_quat", body)
        )
        carrier = bodies[parent].carrier
        pose = bodies[parent].pose @ pose_in_parent
        names = list[str]()
        first = model.integer("body_jntadr", body)
        for j in range(first, first + model.integer("body_jntnum", body)):
            names.append(model.joint_names[j])
            kind = _kind_of(model, j)
            anchor, from_anchor = np.eye(4), np.eye(4)
            anchor[:3, 3] = model.row("jnt_pos", j)
            from_anchor[:3, 3] = -anchor[:3, 3]
            joint = _joint(model, j, kind, carrier, pose @ anchor)
            # The file draws bodies at the joint's reference position, ours is zero.
            to_zero = -model.start(j)
            if joint.name in fixed_positions:
                motion = joint_motion(joint, fixed_positions[joint.name] + to_zero)
                pose = pose @ anchor @ motion @ from_anchor
                continue
            placement = joint.placement @ joint_motion(joint, to_zero)
            joints.append(_joint(model, j, kind, carrier, placement))
            carrier = len(joints) - 1
            pose = from_anchor
        inertial = _inertial(model, body)
        name = model.body_names[body]
        bodies.append(PlacedBody(name, tuple(names), carrier, pose, inertial))
    if not joints:
        what = "no moving joint, so nothing to identify"
        raise InputError(what, "name another file", model.path)
    return joints, bodies[1:]


def _kind_of(model: MujocoModel, j: int) -> str:
    """Return "revolute" or "prismatic" for joint j; InputError for a free or a ball
    joint.
    """
    number = model.integer("jnt_type", j)
    if number not in _KINDS:
        what = f"joint {model.joint_names[j]!r} is free, or a ball"
        remedy = "fix a floating base; give a ball three hinges"
        raise InputError(what, remedy, model.path)
    return _KINDS[number]


def _joint(
    model: MujocoModel, j: int, kind: str, parent: int, placement: Array
) -> Joint:
    """Return joint j of MuJoCo's model as ours.

    ``parent`` is the index of the joint that carries its body's parent, -1 for the
    world; ``placement`` (4, 4) is its pose in that joint's frame. Limits that the file
    does not give are infinite; MuJoCo has no limits of velocity.
    """
    lower = -np.inf
    upper = np.inf
    if model.integer("jnt_limited", j):
        lower, upper = model.row("jnt_range", j).tolist()
    effort = np.inf
    if model.integer("jnt_actfrclimited", j):
        effort = float(np.abs(model.row("jnt_actfrcrange", j)).max())
    axis = model.row("jnt_axis", j)
    return Joint(
        model.joint_names[j],
        kind,
        parent,
        placement,
        axis=axis / np.linalg.norm(axis),
        link_frame=np.eye(4),
        lower=lower,
        upper=upper,
        velocity=np.inf,
        effort=effort,
    )


def _inertial(model: MujocoModel, body: int) -> Array:
    """Return the standard parameters (10,) of a body about its frame."""
    link = np.zeros(10)
    link[0] = model.number("body_mass", body)
    about_com = np.diag(model.row("body_inertia", body))
    link[4:] = inertia.inertia_entries(about_com)
    pose = _pose(model.row("body_ipos", body), model.row("body_iquat", body))
    return inertia.transform(pose) @ link


def _pose(position: Array, quaternion: Array) -> Array:
    """Return the pose (4, 4) of a position [m] and a quaternion w, x, y, z."""
    pose = np.eye(4)
    pose[:3, :3] = rotation_of_quaternion(quaternion[1:], quaternion[0])
    pose[:3, 3] = position
    return pose


def _values(model: MujocoModel, names: Sequence[str]) -> dict[str, float]:
    """Return nonzero nominal parameters of joints by name: I_a1, f_v1, f_c1, kp1, kd1."""
    number_by_joint = {
        model.joint_names.index(name): number
        for number, name in enumerate(names, start=1)
    }
    values = dict[str, float]()
    for joint, number in number_by_joint.items():
        dof = model.integer("jnt_dofadr", joint)
        values[f"I_a{number}"] = model.number("dof_armature", dof)
        values[f"f_v{number}"] = model.number("dof_damping", dof)
        values[f"f_c{number}"] = model.number("dof_frictionloss", dof)
    values |= _servo_gains(model, number_by_joint)
    return {name: value for name, value in values.items() if value != 0.0}


def _servo_gains(
    model: MujocoModel, number_by_joint: Mapping[int, int]
) -> dict[str, float]:
    """Return gains kp [N m/rad] and kd [N m s/rad] of position actuators, by name."""
    gains = dict[str, float]()
    for a in range(len(model.arrays["actuator_trntype"])):
        is_on_joint = model.integer("actuator_trntype", a) == _JOINT_TRANSMISSION
        is_servo = model.integer("actuator_biastype", a) == _AFFINE_BIAS
        number = number_by_joint.get(model.integer("actuator_trnid", a))
        if not is_on_joint or not is_servo or number is None:
            continue
        # MuJoCo: force = gear * (gainprm[0] u + biasprm[1] gear q + biasprm[2] gear dq).
        gear = model.number("actuator_gear", a)
        stiffness = model.number("actuator_gainprm", a)
        damping = -float(model.row("actuator_biasprm", a)[2])
        gains[f"kp{number}"] = gear**2 * stiffness
        gains[f"kd{number}"] = gear**2 * damping
    return gains
