# %% [markdown]
# # Your own robot: what do the runs decide?
#
# You have a URDF and a few runs. Which masses and inertias do the runs tell, which ones
# stay as the URDF had them, and is anything missing? Here the runs are simulated, with
# a spring hidden in the shoulder.

# %%
import matplotlib.pyplot as plt
import numpy as np

from sdp_vs_penalty import add, compare, diagnose, export, identify, simulate

urdf = "docs/my_arm.urdf"  # run from the checkout's folder
runs = simulate(urdf, "joint_spring:2", level=20.0, seed=1)
model = identify(urdf, runs.train)
print(model.certificate)

# %% [markdown]
# ## What the runs decide
#
# The certificate says that the estimate is optimal for its objective. The intervals say
# how well the data know each parameter. Grey bars are parameters that the runs do not
# tell: the prior chose them, near the URDF.

# %%
model.plot()
plt.show()
# %%
frame = model.to_frame()
frame.head(12).round(4)

# %% [markdown]
# ## Is anything missing?
#
# The model is judged on a run that it has not seen.

# %%
before = compare(model, runs.test)
print(before[0].verdict)

# %%
found = diagnose(model, runs.train, runs.test)
found

# %%
better = add(model, found, runs.train)
after = compare({"before": model, "after": better}, runs.test)
after.plot()
plt.show()
# %% [markdown]
# The picture that convinces: the torque error of the shoulder against its position,
# before and after.

# %%
figure, axes = plt.subplots(1, 2, sharey=True, figsize=(9, 3.2))
for axis, comparison in zip(axes, after, strict=True):
    comparison.plot(joint=2, against="position", axes=axis)
plt.show()

# %% [markdown]
# ## Take it away
#
# The URDF gets the identified links. Pinocchio computes the same torque from it.

# %%
import tempfile
from pathlib import Path

import pinocchio as pin

path = Path(tempfile.mkdtemp()) / "identified.urdf"
export(better, path, urdf=urdf)
robot = pin.buildModelFromUrdf(str(path))
rng = np.random.default_rng(0)
q, dq, ddq = rng.normal(size=(3, robot.nq))
by_pinocchio = pin.rnea(robot, robot.createData(), q, dq, ddq)
by_model = better.robot.inverse_dynamics(better.links, q[None], dq[None], ddq[None])[0]
print("largest difference [N m]:", np.abs(by_pinocchio - by_model).max())
