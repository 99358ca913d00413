"""Who reads the files of dynamics that are exported, and the torque that each makes."""

import ctypes
import re
import shutil
import subprocess

import numpy as np
import pytest
import random_robots
from arms import urdfdom_torque
from lxml import etree

from sdp_vs_penalty import Estimate
from sdp_vs_penalty.effects import Model, parse_effects
from sdp_vs_penalty.estimation import Certificate, Interval, Uncertainty
from sdp_vs_penalty.estimation.model_file import Details
from sdp_vs_penalty.robot import load_urdf
from sdp_vs_penalty.signals import Preprocessing


def of_the_file(path, robot, dq, ddq):
    """Damping, dry friction and (Drake's) rotors that a URDF writes."""
    root = etree.parse(str(path)).getroot()
    joints = root.findall("joint")
    rotors = np.zeros(robot.n)
    for own in root.findall("transmission"):
        at = robot.joint_names.index(own.find("joint").get("name"))
        rotors[at] = float(
            own.find("actuator/{http://drake.mit.edu}rotor_inertia").get("value")
        )
    written = {j.get("name"): j.find("dynamics") for j in joints}
    rows = [
        [float(written[j.name].get(key)) for key in ("damping", "friction")]
        for j in robot.joints
    ]
    damping, friction = np.array(rows).T
    return damping * dq + friction * np.tanh(dq / 0.01) + rotors * ddq


def by_urdfdom(path, robot, q, dq, ddq):
    return urdfdom_torque(path, robot, q, dq, ddq) + of_the_file(path, robot, dq, ddq)


def by_our_reader(path, robot, q, dq, ddq):
    ours, links = load_urdf(path, robot.gravity)
    order = [[j.name for j in ours.joints].index(j.name) for j in robot.joints]
    back = np.argsort(order)
    made = ours.inverse_dynamics(links.ravel(), q[:, back], dq[:, back], ddq[:, back])
    return made[:, order] + of_the_file(path, robot, dq, ddq)


def mujoco_torque(model, motion, at=slice(None), held=()):
    """(N, n) by MuJoCo's inverse dynamics at some degrees of freedom; friction and
    equalities, which are constraints there, make none.

    held : pairs of a joint and its position.
    """
    import mujoco

    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    data = mujoco.MjData(model)
    for name, position in held:
        data.qpos[model.joint(name).qposadr[0]] = position
    made = []
    for data.qpos[at], data.qvel[at], data.qacc[at] in zip(*motion, strict=True):
        mujoco.mj_inverse(model, data)
        made.append(data.qfrc_inverse[at].copy())
    return np.array(made)


def by_mujoco(path, robot, q, dq, ddq, held=()):
    """Links, armature and damping; dry friction is a soft constraint there, so that only
    its size is taken."""
    mujoco = pytest.importorskip("mujoco", minversion="3.0")
    model = mujoco.MjModel.from_xml_path(str(path))
    at = [model.joint(j.name).dofadr[0] for j in robot.joints]
    for j in robot.joints:
        if np.isfinite(j.effort):
            assert model.actuator(j.name).ctrlrange.tolist() == [-j.effort, j.effort]
    dry = model.dof_frictionloss[at] * np.tanh(dq / 0.01)
    return mujoco_torque(model, (q, dq, ddq), at, held) + dry


def by_c(path, robot, q, dq, ddq):
    if shutil.which("cc") is None:
        pytest.skip("no C compiler")
    (function,) = re.findall(r"static inline void (\w+_torque)\(", path.read_text())
    assert function == f"{re.sub(r'[^a-zA-Z0-9]', '_', robot.name)}_torque"
    source = path.with_suffix(".c")
    library = path.with_suffix(".so")
    source.write_text(
        f'#include "{path.name}"\nvoid torque(double *q, double *v, double *a, double'
        f" *t) {{ {function}(q, v, a, t); }}"
    )
    # Twice as fast to compile as -O2, which test_written_formats compiles with.
    strict = [
        "-std=c99",
        "-Wall",
        "-Wextra",
        "-Werror",
        "-pedantic-errors",
        "-Og",
        "-shared",
        "-fPIC",
    ]
    subprocess.run(["cc", *strict, str(source), "-o", str(library), "-lm"], check=True)
    loaded = ctypes.CDLL(str(library))
    out = np.zeros_like(q)
    for row in zip(q, dq, ddq, out, strict=True):
        loaded.torque(
            *(np.ascontiguousarray(x).ctypes.data_as(ctypes.c_void_p) for x in row)
        )
    return out


def by_sdf(path, robot, q, dq, ddq):
    """The links that SDF states, as a Pinocchio model built from its elements; damping
    and dry friction as it writes them."""
    pin = pytest.importorskip("pinocchio")
    (arm,) = etree.parse(str(path)).getroot().findall("model")
    links = {link.get("name"): link for link in arm.findall("link")}
    model = pin.Model()
    model.gravity.linear = np.array(robot.gravity)
    number_of = {"base_link": 0}
    order = []
    damping = np.zeros(robot.n)
    friction = np.zeros(robot.n)
    for joint in arm.findall("joint"):
        if joint.get("type") == "fixed":
            continue
        kinds = {
            "revolute": pin.JointModelRevoluteUnaligned,
            "prismatic": pin.JointModelPrismaticUnaligned,
        }
        link = links[joint.findtext("child")]
        parent = number_of[link.find("pose").get("relative_to")]
        moves = kinds[joint.get("type")](numbers(joint.findtext("axis/xyz")))
        place = pose_of(link.findtext("pose"))
        k = model.addJoint(parent, moves, place, joint.get("name"))
        number_of[joint.findtext("child")] = k
        mass = float(link.findtext("inertial/mass"))
        entries = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        xx, xy, xz, yy, yz, zz = (
            float(link.findtext(f"inertial/inertia/{e}")) for e in entries
        )
        about_com = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        centre = pose_of(link.findtext("inertial/pose")).translation
        model.appendBodyToJoint(
            k, pin.Inertia(mass, centre, about_com), pin.SE3.Identity()
        )
        at = robot.joint_names.index(joint.get("name"))
        order.append(at)
        damping[at] = float(joint.findtext("axis/dynamics/damping"))
        friction[at] = float(joint.findtext("axis/dynamics/friction"))
    data = model.createData()
    made = np.empty_like(q)
    for k in range(len(q)):
        made[k, order] = pin.rnea(model, data, q[k, order], dq[k, order], ddq[k, order])
    return made + damping * dq + friction * np.tanh(dq / 0.01)


def numbers(text):
    """Numbers between spaces."""
    return np.array(text.split(), float)


def pose_of(text):
    """x y z roll pitch yaw [m, rad] as a pose of Pinocchio."""
    import pinocchio as pin

    x, y, z, *rpy = numbers(text)
    return pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array([x, y, z]))


#: By ending: who reads the file, and what it has no place for.
READERS = {
    ".urdf": ((by_urdfdom, by_our_reader), ("rotor_inertia", "torque_offset")),
    ".drake.urdf": ((by_urdfdom, by_our_reader), ("torque_offset",)),
    ".sdf": ((by_sdf,), ("rotor_inertia", "torque_offset")),
    ".xml": ((by_mujoco,), ()),
    ".h": ((by_c,), ()),
}


FULL = "rigid_body,viscous_friction,coulomb_friction,rotor_inertia"


def estimate_of(robot, effects, seed, links=None):
    """An estimate with random consistent links and random positive other parameters; what
    friction by load refers to is another model.
    """
    rng = np.random.default_rng(seed)
    model = Model(robot, parse_effects(effects, robot))
    theta = rng.uniform(0.05, 2.0, len(model.parameters))
    if links is None:
        links = np.array(
            [random_robots.link_parameters(rng, 0.4) for _ in range(robot.n)]
        )
    theta[model.rigid_indices] = links.ravel()[: len(model.rigid_indices)]
    if model.needs_reference:
        model = Model(robot, model.effects, 0.8 * theta)
    p = len(theta)
    n = robot.n
    pairs = zip(model.parameters, theta.tolist(), strict=True)
    intervals = tuple(Interval(q.name, q.unit, x) for q, x in pairs)
    nothing = np.zeros((p, 0)), np.zeros((p, n)), np.zeros(n), np.zeros((n, 0))
    unknown = Uncertainty((), *nothing, standard=intervals)
    made = Certificate({}, 0.0)
    provenance = {"data_hash": "", "runs": [], "samples": 0, "versions": {}}
    settings = (Preprocessing(), {}, Details(), provenance)
    return Estimate(
        random_robots.bare(robot), model, theta, unknown, "by hand", made, *settings
    )
