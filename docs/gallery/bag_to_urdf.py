# %% [markdown]
# # From a ROS 2 bag to a URDF with true inertias
#
# A driver publishes `/joint_states`, `ros2 bag record` keeps it. Two commands turn the
# bag into a URDF whose links a simulator can trust. Here the bag is written from
# simulated runs, gripper joint and all.

# %%
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore

from sdp_vs_penalty import compare, load_estimate, simulate

urdf = "docs/my_arm.urdf"  # run from the checkout's folder
runs = simulate(urdf, seed=4)
store = get_typestore(Stores.ROS2_HUMBLE)
JointState = store.types["sensor_msgs/msg/JointState"]
Header = store.types["std_msgs/msg/Header"]
Time = store.types["builtin_interfaces/msg/Time"]


def record(run, folder):
    """Write a run as a bag of joint states, with a gripper that stays still."""
    names = ["turn", "shoulder", "elbow", "gripper"]
    with Writer(folder, version=9) as bag:
        topic = bag.add_connection(
            "/joint_states", JointState.__msgtype__, typestore=store
        )
        for t, q, tau in zip(run.t, run.q, run.tau, strict=True):
            stamp = int(1e9 * (1_700_000_000 + t))
            header = Header(Time(stamp // 10**9, stamp % 10**9), "")
            message = JointState(
                header, names, np.append(q, 0.0), np.zeros(0), np.append(tau, 0.0)
            )
            bag.write(
                topic, stamp, store.serialize_cdr(message, JointState.__msgtype__)
            )


folder = Path(tempfile.mkdtemp())
record(runs.train[0], folder / "run")
record(runs.test, folder / "test")

# %% [markdown]
# ## Two commands
#
# Joints are found by the URDF's names. The gripper is no joint of this URDF, and stays
# out.


# %%
def run(*words):
    """Run `sdp-vs-penalty` with these words, and show what it prints."""
    done = subprocess.run(
        [sys.executable, "-m", "sdp_vs_penalty", *words],
        capture_output=True,
        text=True,
        check=True,
    )
    print(done.stdout)


model = folder / "model.json"
run("identify", urdf, "--data", folder / "run", "--out", model)
run("export", model, "--urdf", urdf, "--out", folder / "identified.urdf")

# %% [markdown]
# ## Measured against modelled torque, on a bag that was not used

# %%
(judged,) = compare(load_estimate(model), folder / "test")
figure, axes = plt.subplots(3, 1, sharex=True, figsize=(9, 6))
for j, axis in enumerate(axes):
    axis.plot(judged.signals.t, judged.signals.measured[:, j], color="black", lw=1)
    axis.plot(
        judged.signals.t, judged.signals.modelled[:, j], color="#0072b2", lw=1, ls="--"
    )
    axis.set_ylabel(f"joint {j + 1} [N m]")
axes[0].legend(
    ["measured", "modelled"],
    frameon=False,
    ncols=2,
    loc="lower left",
    bbox_to_anchor=(0.0, 1.0),
)
axes[-1].set_xlabel("time [s]")
plt.show()
