"""Logs of a slide with a position servo: its command, its position, and the torque that
nobody logs."""

from functools import cache
from math import tanh

import numpy as np

from sdp_vs_penalty import Measurements

URDF = """<robot name="slide"><link name="base"/><link name="cart"><inertial><mass value="2"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="x" type="prismatic"><parent link="base"/><child link="cart"/><axis xyz="1 0 0"/>
<limit lower="-2" upper="2" effort="500" velocity="9"/></joint></robot>"""
EFFECTS = "rigid_body,viscous_friction,coulomb_friction@v_s=0.05,torque_offset"
MASS = 3.0
KP = 500.0
KD = 40.0
VISCOUS = 4.0
COULOMB = 2.0
OFFSET = 1.0


def command(t, seed):
    rng = np.random.default_rng(seed)
    q = np.zeros_like(t)
    for k in range(1, 6):
        a, b = 0.2 * rng.normal(size=2) / k
        q += a * np.sin(1.3 * k * t) + b * (np.cos(1.3 * k * t) - 1.0)
    return q * (1.0 - np.exp(-t))


@cache
def log(
    noise=0.0,
    ki=0.0,
    kh=0.0,
    delay=0.0,
    seed=0,
    torque=False,
    load=0.0,
    lead=0.0,
    limit=np.inf,
):
    """20 s at 100 Hz; steps of 0.5 ms; load [kg]; friction turns ``lead`` [s] early;
    limit [N] of the drive."""
    h = 5e-4
    t = np.arange(0.0, 20.0, h)
    told = command(t, seed)
    late = command(np.maximum(t - delay, 0.0), seed)
    # Steps of Python's own floats take a third of the time of NumPy's.
    positions, drives = [], []
    x = start = float(told[0])
    v = 0.0
    sums = OFFSET / ki if ki else 0.0
    a = 0.0
    for aim in late.tolist():
        positions.append(x)
        sums += h * (aim - x)
        drive = KP * (aim - x) - KD * v + ki * sums - kh * (x - start)
        drive = min(max(drive, -limit), limit)
        drives.append(drive)
        dry = COULOMB * tanh((v + lead * a) / 0.05)
        a = (drive - VISCOUS * v - dry - OFFSET) / (MASS + load)
        v += h * a
        x += h * v
    q, tau = np.array(positions), np.array(drives)
    rng = np.random.default_rng(seed + 1)
    logged = q[::20] + noise * rng.normal(size=len(t[::20]))
    groups = {"q": logged[:, None], "qcmd": told[::20, None]}
    groups |= {"tau": tau[::20, None]} if torque else {}
    return Measurements.from_channels(t[::20], groups, (f"run{seed}",))


def write_slide(folder):
    """The path of slide.urdf."""
    (folder / "slide.urdf").write_text(URDF)
    return str(folder / "slide.urdf")
