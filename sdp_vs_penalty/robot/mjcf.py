"""Read a robot from an MJCF file through MuJoCo's own reader (extra [engines]): hinges
and slides, several of one body, mimic joints by equality, armature, damping, friction
loss and the gains of position actuators."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sdp_vs_penalty.errors import InputError, missing_extra
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.joint import (
    Follower,
    HeldJoint,
    Joint,
    hold_followers,
    resolve_mimic_joints,
)
from sdp_vs_penalty.robot.robot import Robot, check_held
from sdp_vs_penalty.robot.urdf import joint_motion


def load_mjcf(
    path: str | Path,
    gravity: Sequence[float] | None = None,
    held: Mapping[str, float] | None = None,
) -> tuple[Robot, Array, dict[str, float]]:
    """The robot of an MJCF file, its nominal links, and nominal values of its joints.

    Parameters
    ----------
    path : of the file; what it includes lies beside it
    gravity : in the base frame [m/s^2]; None: the file's
    held : joints that stand still at these positions [rad, m]

    Returns
    -------
    robot : joints depth first; a body without joints belongs to its parent, what is
        fixed to the world is dropped; joints of an equality follow
    links : (links, 10) standard parameters about the link frames
    values : of parameters by name: armature I_a1 [kg m^2], damping f_v1 [N m s/rad],
        friction loss f_c1 [N m], gains of position actuators kp1, kd1

    Raises
    ------
    InputError
        A file that MuJoCo does not read, a free or ball joint, a loop, no joint at all.
    """
    model = _compiled(path)
    still = dict(held or {})
    constants, followers = _equalities(path, model)
    placed = tuple[HeldJoint, ...]()
    if still:
        driven = load_mjcf(path, gravity)[0].joint_names
        places = check_held(driven, still)
        placed = tuple(HeldJoint(driven[k], still[driven[k]], k) for k in places)
    still = hold_followers(still | constants, followers)
    tree, links, massless = _tree(path, model, still)
    moving = {joint.name for joint in tree}
    joints, mechanism = resolve_mimic_joints(
        tree, {n: f for n, f in followers.items() if n in moving}, massless
    )
    down = tuple(map(float, model.opt.gravity if gravity is None else gravity))
    name = model.names.partition(b"\0")[0].decode() or Path(path).stem
    robot = Robot(name, joints, down, None, mechanism, placed)
    kept = [x for k, x in enumerate(links) if k not in massless]
    return robot, np.array(kept), _values(model, robot.joint_names)


def _compiled(path: str | Path) -> Any:
    """MuJoCo's model of a file."""
    try:
        import mujoco
    except ImportError as error:
        raise missing_extra("MJCF files need", "engines") from error
    try:
        return mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        what = (str(error).splitlines() or ["no reason given"])[0][:200]
        raise InputError(
            f"MuJoCo does not read it ({what})", "correct it", path
        ) from error


def _name(model: Any, kind: str, index: int) -> str:
    """A joint's name, or one by its number."""
    found: str = getattr(model, kind)(index).name
    return found or f"{kind}{index + 1}"


def _equalities(
    path: str | Path, model: Any
) -> tuple[dict[str, float], dict[str, Follower]]:
    """Joints that an equality holds, and those that it makes followers."""
    import mujoco

    constants = dict[str, float]()
    followers = dict[str, Follower]()
    for k in range(model.neq):
        if not model.eq_active0[k]:
            continue
        if int(model.eq_type[k]) != int(mujoco.mjtEq.mjEQ_JOINT):
            what = "an equality other than of joints, as of a closed loop"
            raise InputError(
                what, "cut the loop, for only trees can be identified", path
            )
        first = int(model.eq_obj1id[k])
        second = int(model.eq_obj2id[k])
        course = model.eq_data[k, :5]
        name = _name(model, "joint", first)
        start = float(model.qpos0[model.jnt_qposadr[first]])
        if second < 0:
            constants[name] = start + float(course[0])
            continue
        if np.any(course[2:]):
            what = f"joint {name!r} follows another one by a curve"
            raise InputError(what, "make its polycoef a straight line", path)
        leader = float(model.qpos0[model.jnt_qposadr[second]])
        offset = start + float(course[0] - course[1] * leader)
        followers[name] = _name(model, "joint", second), float(course[1]), offset
    return constants, followers


def _tree(
    path: str | Path, model: Any, still: Mapping[str, float]
) -> tuple[list[Joint], list[Array], tuple[int, ...]]:
    """The moving joints depth first, the link of each (10,), and which have no mass.

    Of a body with several joints each but the last carries a link without mass.
    """
    import mujoco

    kinds = {
        int(mujoco.mjtJoint.mjJNT_HINGE): "revolute",
        int(mujoco.mjtJoint.mjJNT_SLIDE): "prismatic",
    }
    joints = list[Joint]()
    links = list[Array]()
    # Of each body the joint that carries it and its pose in that joint's moved frame.
    carriers = [-1]
    poses = [np.eye(4)]
    for body in range(1, model.nbody):
        parent = int(model.body_parentid[body])
        at = _pose(model.body_pos[body], model.body_quat[body])
        carrier = carriers[parent]
        pose = poses[parent] @ at
        for j in range(
            model.body_jntadr[body], model.body_jntadr[body] + model.body_jntnum[body]
        ):
            if int(model.jnt_type[j]) not in kinds:
                what = f"joint {_name(model, 'joint', j)!r} is free, or a ball"
                raise InputError(
                    what, "fix a floating base; give a ball three hinges", path
                )
            anchor = np.eye(4)
            back = np.eye(4)
            anchor[:3, 3], back[:3, 3] = model.jnt_pos[j], -model.jnt_pos[j]
            joint = _joint(
                model, int(j), kinds[int(model.jnt_type[j])], carrier, pose @ anchor
            )
            start = -float(model.qpos0[model.jnt_qposadr[j]])
            if joint.name in still:
                pose = (
                    pose
                    @ anchor
                    @ joint_motion(joint, still[joint.name] + start)
                    @ back
                )
                continue
            begun = joint.placement @ joint_motion(joint, start)
            joints.append(_joint(model, int(j), joint.kind, carrier, begun))
            links.append(np.zeros(10))
            carrier = len(joints) - 1
            pose = back
        carriers.append(carrier)
        poses.append(pose)
        if carrier >= 0:
            links[carrier] += inertia.transform(pose) @ _inertial(model, body)
    if not joints:
        raise InputError(
            "no moving joint, so nothing to identify", "name another file", path
        )
    massless = tuple(k for k, link in enumerate(links) if not link.any())
    return joints, links, massless if len(massless) < len(links) else ()


def _joint(model: Any, j: int, kind: str, parent: int, placement: Array) -> Joint:
    """One moving joint."""
    lower, upper = model.jnt_range[j] if model.jnt_limited[j] else (-np.inf, np.inf)
    effort = np.inf
    if model.jnt_actfrclimited[j]:
        effort = float(np.abs(model.jnt_actfrcrange[j]).max())
    axis = np.array(model.jnt_axis[j]) / np.linalg.norm(model.jnt_axis[j])
    limits = float(lower), float(upper), np.inf, effort
    return Joint(
        _name(model, "joint", j), kind, parent, placement, axis, np.eye(4), *limits
    )


def _inertial(model: Any, body: int) -> Array:
    """(10,) standard parameters of a body about its frame."""
    about_com = np.diag(model.body_inertia[body])
    link = np.zeros(10)
    link[0] = model.body_mass[body]
    link[4:] = inertia.inertia_entries(about_com)
    at = _pose(model.body_ipos[body], model.body_iquat[body])
    return inertia.transform(at) @ link


def _pose(position: Array, quaternion: Array) -> Array:
    """(4, 4) of a position [m] and a unit quaternion w, x, y, z."""
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    out = np.eye(4)
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    out[:3, :3] += 2.0 * w * k + 2.0 * k @ k
    out[:3, 3] = position
    return out


def _values(model: Any, names: Sequence[str]) -> dict[str, float]:
    """Nominal values of joints' parameters by their names; none where they are zero."""
    import mujoco

    found: dict[str, float] = {}
    places = {_name(model, "joint", j): j for j in range(model.njnt)}
    for k, name in enumerate(names, start=1):
        dof = model.jnt_dofadr[places[name]]
        found |= {
            f"I_a{k}": float(model.dof_armature[dof]),
            f"f_v{k}": float(np.ravel(model.dof_damping[dof])[0]),
            f"f_c{k}": float(model.dof_frictionloss[dof]),
        }
    numbers = {places[name]: k for k, name in enumerate(names, start=1)}
    for a in range(model.nu):
        on_joint = int(model.actuator_trntype[a]) == int(mujoco.mjtTrn.mjTRN_JOINT)
        is_servo = int(model.actuator_biastype[a]) == int(mujoco.mjtBias.mjBIAS_AFFINE)
        number = numbers.get(int(model.actuator_trnid[a, 0]))
        if on_joint and is_servo and number is not None:
            gear = float(model.actuator_gear[a, 0])
            gain = model.actuator_gainprm[a]
            bias = model.actuator_biasprm[a]
            found[f"kp{number}"] = gear**2 * float(gain[0])
            found[f"kd{number}"] = -(gear**2) * float(bias[2])
    return {name: value for name, value in found.items() if value != 0.0}
