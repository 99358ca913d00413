"""Logs of a pendulum with a drive, integrated here: its motion follows its torque."""

import numpy as np

from sdp_vs_penalty import Measurements

#: The description that the logs are checked with; true are 1.2 times its mass.
URDF = """<robot name="pendulum"><link name="base"/>
<link name="rod"><inertial><origin xyz="0.25 0 0"/><mass value="2"/>
<inertia ixx="0.002" ixy="0" ixz="0" iyy="0.04" iyz="0" izz="0.04"/></inertial></link>
<joint name="hinge" type="revolute"><parent link="base"/><child link="rod"/><axis xyz="0 1 0"/>
<limit lower="-6.2" upper="6.2" velocity="20" effort="{effort}"/></joint></robot>"""
_MASS, _X = 2.4, 0.25
_INERTIA = 0.21
_STEP = 5e-4


def swing(torque, seconds=12.0, rate=200, seed=0):
    """A log of the pendulum under ``torque(t, q, dq)`` [N m], with noise of 1e-5 rad."""
    rng = np.random.default_rng(seed)
    q, dq = 1.2, 0.0
    every = round(1.0 / (rate * _STEP))
    rows = []
    for k in range(round(seconds / _STEP)):
        tau = torque(k * _STEP, q, dq)
        if k % every == 0:
            rows.append((k * _STEP, q + 1e-5 * rng.normal(), tau))
        # Gravity is along -z; a turn about y by q takes (x, 0) to height -x sin q.
        weight = 9.81 * _MASS * (-_X * np.cos(q))
        friction = 0.05 * dq + 0.3 * np.tanh(dq / 0.05)
        dq += _STEP * (tau - weight - friction) / _INERTIA
        q += _STEP * dq
    t, q_logged, tau_logged = np.array(rows).T
    return Measurements(t, q_logged[:, None], tau_logged[:, None])
