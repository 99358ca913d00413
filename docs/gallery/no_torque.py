# %% [markdown]
# # No torque in the log: is a hobby arm lost?
#
# Hobby servos take positions and report positions. Nobody measures a torque. But a
# servo pushes with kp times its position error, so what it was commanded and where it
# was stand for a torque, up to one scale. A known load sets it.
#
# The arm is simulated with Pinocchio's forward dynamics: 100 samples a second, encoders
# of 12 bits, and links heavier than its maker says.

# %%
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pinocchio as pin

from sdp_vs_penalty import compare, identify

urdf = "docs/my_arm.urdf"  # run from the checkout's folder
KP = np.array([160.0, 300.0, 110.0])  # N m/rad
KV = np.array([9.0, 16.0, 5.0])  # N m s/rad
DRY = np.array([0.5, 0.8, 0.3])  # N m
STEP = 1e-3  # s
COUNT = 2 * np.pi / 4096  # rad


def true_arm(load):
    """The arm as it is: heavier than the URDF, with a load [kg] at its end."""
    robot = pin.buildModelFromUrdf(urdf)
    for k, factor in enumerate((1.0, 1.3, 1.2), start=1):
        robot.inertias[k] = pin.Inertia(
            factor * robot.inertias[k].mass,
            robot.inertias[k].lever,
            robot.inertias[k].inertia,
        )
    robot.inertias[3] += pin.Inertia(load, np.array([0.3, 0.0, 0.0]), 1e-4 * np.eye(3))
    return robot


def follow(load, seed, seconds=20.0):
    """The log: time, where the joints were, and where they were commanded to be."""
    robot = true_arm(load)
    data = robot.createData()
    rng = np.random.default_rng(seed)
    sines, cosines = 0.35 * rng.normal(size=(2, 5, 3)) / np.arange(1, 6)[:, None]
    q = v = np.zeros(3)
    log = []
    for k in range(int(seconds / STEP)):
        t = k * STEP
        wave = 2 * np.pi * 0.15 * t * np.arange(1, 6)[:, None]
        command = (1 - np.exp(-t)) * np.sum(
            sines * np.sin(wave) + cosines * (np.cos(wave) - 1), axis=0
        )
        if k % 10 == 0:
            log.append([t, *(COUNT * np.round(q / COUNT)), *command])
        torque = KP * (command - q) - KV * v - DRY * np.tanh(v / 0.01)
        v = v + STEP * pin.aba(robot, data, q, v, torque)
        q = q + STEP * v
    return pd.DataFrame(log, columns=["t", "q1", "q2", "q3", "qcmd1", "qcmd2", "qcmd3"])


empty = follow(0.0, seed=1)
loaded = follow(0.5, seed=2)
unseen = follow(0.0, seed=3)

# %% [markdown]
# ## Identify
#
# The second run carried 0.5 kg. The servo's law is chosen by its error on motion left
# out.

# %%
model = identify(urdf, empty, known_loads=[(loaded, 0.5)])
frame = model.to_frame()
gains = frame[frame.index.str.startswith("kp")][["value", "lower", "upper", "unit"]]
gains.assign(true=KP).round(1)

# %% [markdown]
# ## Does it predict?
#
# On a motion that it has not seen, the torque that the position error stands for
# against the model's.

# %%
(judged,) = compare(model, unseen)
print(judged.verdict)
figure, axes = plt.subplots(3, 1, sharex=True, figsize=(9, 6))
for j, axis in enumerate(axes):
    axis.plot(judged.signals.t, judged.signals.measured[:, j], color="black", lw=1)
    axis.plot(
        judged.signals.t, judged.signals.modelled[:, j], color="#0072b2", lw=1, ls="--"
    )
    axis.set_ylabel(f"joint {j + 1} [N m]")
axes[0].legend(
    ["by the position error", "modelled"],
    frameon=False,
    ncols=2,
    loc="lower left",
    bbox_to_anchor=(0.0, 1.0),
)
axes[-1].set_xlabel("time [s]")
plt.show()
