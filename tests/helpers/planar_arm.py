"""A planar arm of two links whose equations stand here.

They share no code with the library: two links in closed form, with friction of both
joints.
"""

import numpy as np

MASSES, LENGTH, CENTRE, SPIN = (4.0, 3.0), 0.4, 0.25, 0.04
URDF = f"""<robot name="planar"><link name="base"/>
<link name="upper"><inertial><mass value="{MASSES[0]}"/><origin xyz="{CENTRE} 0 0"/>
<inertia ixx=".02" iyy="{SPIN}" izz="{SPIN}" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="lower"><inertial><mass value="{MASSES[1]}"/><origin xyz="{CENTRE} 0 0"/>
<inertia ixx=".02" iyy="{SPIN}" izz="{SPIN}" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
<axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="90" velocity="9"/></joint>
<joint name="elbow" type="revolute"><parent link="upper"/><child link="lower"/>
<origin xyz="{LENGTH} 0 0"/>
<axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="90" velocity="9"/></joint>
</robot>"""


def links_torque(q, dq, ddq):
    """Torque (N, 2) of two links in a horizontal plane: Lagrange's equations."""
    m1, m2 = MASSES
    coupling = m2 * LENGTH * CENTRE
    first = m1 * CENTRE**2 + m2 * LENGTH**2 + m2 * CENTRE**2 + 2.0 * SPIN
    second = m2 * CENTRE**2 + SPIN
    cos, sin = np.cos(q[:, 1]), np.sin(q[:, 1])
    m12 = second + coupling * cos
    return np.column_stack(
        [
            (first + 2.0 * coupling * cos) * ddq[:, 0]
            + m12 * ddq[:, 1]
            - coupling * sin * (2.0 * dq[:, 0] * dq[:, 1] + dq[:, 1] ** 2),
            m12 * ddq[:, 0] + second * ddq[:, 1] + coupling * sin * dq[:, 0] ** 2,
        ]
    )


def swings(seed):
    """24 s of five sines a joint at 500 Hz: t (N,), q, dq, ddq (N, 2)."""
    rng = np.random.default_rng(seed)
    t = np.arange(0.0, 24.0, 0.002)
    q, dq, ddq = (np.zeros((len(t), 2)) for _ in range(3))
    for j in range(2):
        w = 2.0 * np.pi * rng.uniform(0.1, 0.8, 5)
        a, phase = rng.uniform(0.5, 1.0, 5) / w / 2.0, rng.uniform(0.0, 6.0, 5)
        waves = np.outer(t, w) + phase
        q[:, j], dq[:, j] = np.sin(waves) @ a, np.cos(waves) @ (a * w)
        ddq[:, j] = np.sin(waves) @ (-a * w * w)
    return t, q, dq, ddq


def friction(dq):
    """Torque (N, 2) of dry and viscous friction."""
    return np.tanh(dq / 0.01) * (0.8, 0.4) + dq * (0.5, 0.3)


def noise(seed, shape):
    """White noise of the torque channels, in N m."""
    return np.random.default_rng(seed + 1000).normal(0.0, 0.05, shape)
