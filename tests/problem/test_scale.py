"""Arms of any size: the lower bounds of masses fit the links, and an arm ten times
larger or smaller gets the same verdict and the same relative error."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from arms import Axis, write_urdf
from dynamics_files import mujoco_torque
from numpy.testing import assert_allclose

import sdp_vs_penalty as sdp

BASE = (
    Axis("revolute", "0 0 1", "0 0 0.3", 0.5, "0.02 0.01 0.1"),
    Axis("revolute", "0 1 0", "0 0 0.2", 0.4, "0.2 0.01 0.02"),
    Axis("revolute", "0 1 0", "0.4 0 0", 0.2, "0.15 0.01 0.01"),
)


def scaled(axis, length):
    """Of one material: masses go with the cube, moments with the fifth power."""
    places = [
        [length * float(word) for word in str(x).split()]
        for x in (axis.origin, axis.com)
    ]
    ball = 0.4 * axis.mass * 0.08**2 * length**5
    moments = [ball, 0.0, ball, 0.0, 0.0, ball]
    return replace(
        axis,
        origin=places[0],
        com=places[1],
        mass=axis.mass * length**3,
        moments=moments,
    )


def mujoco_torques(axes, motion):
    """(N, n) by MuJoCo's inverse dynamics, which shares nothing with the project."""
    mujoco = pytest.importorskip("mujoco")
    bodies = ""
    for axis in axes:
        origin, com = (_numbers(x) for x in (axis.origin, axis.com))
        xx, xy, yy, xz, yz, zz = axis.moments
        moments = _numbers([xx, yy, zz, xy, xz, yz])
        bodies += (
            f'<body pos="{origin}"><joint axis="{axis.axis}"/><inertial pos="{com}"'
            f' mass="{axis.mass}" fullinertia="{moments}"/>'
        )
    tail = "</body>" * len(axes)
    text = f"<mujoco><worldbody>{bodies}{tail}</worldbody></mujoco>"
    return mujoco_torque(mujoco.MjModel.from_xml_string(text), motion)


def _numbers(values):
    return values if isinstance(values, str) else " ".join(map(str, values))


def run_of(axes, seed):
    """Twenty seconds with friction of 2 % of the weights and noise of 1 % of it."""
    rng = np.random.default_rng(seed)
    n = len(axes)
    t = np.arange(0.0, 20.0, 0.01)
    q, dq, ddq = np.zeros((3, len(t), n))
    for frequency in (0.1, 0.2, 0.3, 0.5, 0.7):
        w = 2.0 * np.pi * frequency
        phase = rng.uniform(-3.0, 3.0, n)
        a = rng.uniform(0.1, 0.4, n)
        q += a * np.sin(w * t[:, None] + phase)
        dq += a * w * np.cos(w * t[:, None] + phase)
        ddq -= a * w**2 * np.sin(w * t[:, None] + phase)
    tau = mujoco_torques(axes, (q, dq, ddq))
    # What holds the arm stretched out goes with the fourth power of the length.
    size = np.cumsum(weights(axes)[::-1])[::-1]
    tau += 0.01 * size * (np.sign(dq) + dq)
    tau += 0.01 * np.sqrt(np.mean(tau**2, axis=0)) * rng.normal(size=tau.shape)
    return sdp.Measurements(t, q, tau)


def weights(axes):
    """(n,) weight of each link times a usual length of it [N m]."""
    lengths = [sum(abs(float(x)) for x in _numbers(axis.com).split()) for axis in axes]
    return 9.81 * np.array([axis.mass for axis in axes]) * lengths


def identified(stated, axes):
    """The model of an arm of these axes, whose file states others, and its comparison
    on another run."""
    with TemporaryDirectory() as folder:
        path = write_urdf(Path(folder) / "arm.urdf", "arm", stated)
        estimate = sdp.identify(path, run_of(axes, 1), check=False)
        return estimate, sdp.compare(estimate, run_of(axes, 2))[0]


@cache
def judged(length):
    """The verdict on another run, its relative error, and masses over the true ones."""
    axes = [scaled(axis, length) for axis in BASE]
    estimate, comparison = identified(axes, axes)
    masses = estimate.links[:, 0] / estimate.problem.nominal_links[:, 0]
    verdict = str(comparison.verdict).partition(".")[0]
    return verdict, comparison.relative_error_percent, masses


@pytest.mark.parametrize("length", [0.1, 1.0, 10.0])
def test_the_verdict_does_not_depend_on_the_size(length):
    assert judged(length)[0] == "Good"


@pytest.mark.parametrize("length", [0.1, 10.0])
def test_the_relative_error_does_not_depend_on_the_size(length):
    assert judged(length)[1] == pytest.approx(judged(1.0)[1], rel=0.05)


@pytest.mark.parametrize("length", [0.1, 1.0, 10.0])
def test_masses_are_right_at_any_size(length):
    assert_allclose(judged(length)[2], 1.0, atol=0.03)


def test_light_links_may_be_lighter_than_ten_grams(tmp_path):
    axes = [
        replace(axis, mass=m) for axis, m in zip(BASE, (3e-3, 0.02, 5.0), strict=True)
    ]
    problem = sdp.load_problem(write_urdf(tmp_path / "arm.urdf", "arm", axes))
    assert_allclose(problem.box[:, 0, 0], [1e-3, 0.02 / 3.0, 0.01])


#: An arm of a hand's size.
SMALL = (
    Axis("revolute", "0 0 1", "0 0 0.03", 0.032, "0.003 0.002 0.012"),
    Axis("revolute", "0 1 0", "0 0 0.02", 0.022, "0.028 0.001 0.002"),
    Axis("revolute", "0 1 0", "0.06 0 0", 0.009, "0.024 -0.002 0.001"),
    Axis("revolute", "1 0 0", "0.05 0 0", 0.0024, "0.006 0.003 0.002"),
)


@cache
def small_arm():
    """The verdict on another run, and the masses; those of the URDF are up to a fourth
    wrong."""
    axes = []
    for axis in SMALL:
        radius = 0.9 * np.linalg.norm([float(x) for x in str(axis.com).split()])
        ball = 0.4 * axis.mass * (radius + 0.004) ** 2
        moments = [ball, 0.0, 0.9 * ball, 0.0, 0.0, 0.7 * ball]
        axes.append(replace(axis, moments=moments))
    wrong = [
        replace(axis, mass=axis.mass * x)
        for axis, x in zip(axes, (1.25, 0.8, 1.15, 0.9), strict=True)
    ]
    estimate, comparison = identified(wrong, axes)
    return str(comparison.verdict).partition(".")[0], estimate.links[:, 0]


def test_an_arm_with_links_of_a_few_grams_is_good():
    assert small_arm()[0] == "Good"


def test_masses_of_a_few_grams_are_near_the_truth():
    """Those of the first link do not show in the torque."""
    true_masses = [axis.mass for axis in SMALL]
    assert_allclose(small_arm()[1][1:], true_masses[1:], rtol=0.2)
