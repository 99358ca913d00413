# %% [markdown]
# # A payload: how heavy, where, and since when?
#
# An arm was identified with empty hands. Now it carries something. Ten numbers describe
# the payload: its mass, its first moments and its inertia. Links held fixed, the torque
# tells them; the semidefinite program keeps them those of a body that can exist.

# %%
import matplotlib.pyplot as plt
import numpy as np

from sdp_vs_penalty import PayloadEstimator, add, compare, identify, simulate

urdf = "docs/my_arm.urdf"  # run from the checkout's folder
empty = simulate(urdf, seed=2)
loaded = simulate(urdf, "payload", level=600.0, seed=2)
true = loaded.truth["effects"][0]
model = identify(urdf, empty.train)

# %% [markdown]
# ## From a log
#
# `add` keeps the links and fits the payload alone.

# %%
carrying = add(model, "payload", loaded.train)
frame = carrying.to_frame()
frame[frame["effect"] == "payload"][["value", "lower", "upper", "unit"]].round(4)

# %%
value = frame["value"]
com = [value[f"payload_m{axis}"] / value["payload_m"] for axis in "xyz"]
print(f"true mass {true['size']:.4f} kg, identified {value['payload_m']:.4f} kg")
print("true centre of mass  ", np.round(true["details"]["com"], 4), "m")
print("identified           ", np.round(com, 4), "m")

# %% [markdown]
# The model without the payload fails on the loaded run, the one with it does not.

# %%
compare({"empty hands": model, "with payload": carrying}, loaded.test).plot()
plt.show()
# %% [markdown]
# ## In the control loop
#
# The estimator takes one sample at a time. It says when a payload came, and keeps its
# mass with an interval. Here the arm moves with empty hands for six seconds. The log
# pauses for one second, and then the arm carries the payload.

# %%
estimator = PayloadEstimator.calibrated(model, empty.test, rate=1000.0)
before, after = empty.train[0].window(0.0, 6.0), loaded.test
masses = []
for run, begin, end in ((before, 0.0, 6.0), (after, 7.0, 14.0)):
    time = run.t - run.t[0] + begin
    for t, q, tau in zip(time[time < end], run.q, run.tau, strict=False):
        change = estimator.update(t, q, tau)
        if change:
            print(change)
        if estimator.payload:
            masses.append((estimator.payload.time, *estimator.payload.mass_interval))

# %%
at, lower, upper = np.array(masses).T
figure, axis = plt.subplots(figsize=(8, 3))
axis.fill_between(at, lower, upper, color="#0072b2", alpha=0.3, label="95 % interval")
axis.axhline(true["size"], color="black", lw=1, ls=":", label="true mass")
axis.axvspan(6.0, 7.0, color="#d55e00", alpha=0.2, label="picked up")
axis.set(
    xlim=(0, 14), ylim=(0, 2 * true["size"]), xlabel="time [s]", ylabel="mass [kg]"
)
axis.legend(frameon=False)
plt.show()
