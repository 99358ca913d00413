# %% [markdown]
# # A student's day: one's own effect, method and solver, and computed torque
#
# You write a paper on an arm. You want a model and what the data decide, residuals as a
# table, your own law of friction, your own method and solver beside ours, computed
# torque by the model against the file's robot, and models to draw from in MuJoCo. Here
# the arm is simulated, so the truth is known: a spring in the shoulder is hidden.

# %%
from dataclasses import dataclass
from typing import ClassVar

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd

from sdp_vs_penalty import compare, diagnose, identify, load_problem, register, simulate
from sdp_vs_penalty.effects.effect import JointEffect
from sdp_vs_penalty.effects.shape import POSITION, ShapeConstant
from sdp_vs_penalty.estimators.estimator import Estimator, Fit
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdp
from sdp_vs_penalty.solvers.conic import svec, unsvec
from sdp_vs_penalty.solvers.solver import Solver

urdf = "docs/my_arm.urdf"  # run from the checkout's folder
runs = simulate(urdf, "joint_spring:2", level=20.0, seed=1, link_error=0.15)
model = identify(urdf, runs.train)
print(model.certificate)

# %% [markdown]
# ## Morning: what do the data decide?
#
# The model holds one mass a link. The data allow more: each range below holds every
# consistent model that fits, whatever the prior.

# %%

for link in (2, 3):
    print(model.range(f"m{link}"), "True:", runs.truth["links"][f"m{link}"])

# %% [markdown]
# ## Residuals in a table
#
# What the torque holds that the model lacks, row by row, on a run that it has not seen.
# The shoulder's residual bends over its position: something there is not in the model.

# %%
table = compare(model, runs.test)[0].signals.to_frame()
print(table.groupby(pd.cut(table.q2, 6), observed=True).residual2.agg(["mean", "std"]))

# %% [markdown]
# ## An effect of one's own
#
# Say that you suspect a rubber buffer, which stiffens with its travel. An effect is a
# class with one column a joint, `tau = k_r column`. Registered, it competes with the
# library in every diagnosis, and models with it are saved and loaded.


# %%
@register
class RubberBuffer(JointEffect):
    """A buffer of rubber."""

    equation = "k_r q_0 sinh(q / q_0)"
    explanation = "A spring that stiffens with the distance from zero, as rubber does."
    reference = "Ogden, Non-Linear Elastic Deformations, 1984"
    symbol = "k_r"
    units = ("N*m/rad", "N/m")
    shapes = {
        "q_0": ShapeConstant(0.5, POSITION, grid=(0.25, 0.5, 1.0), bounds=(0.1, 4.0))
    }

    def column(self, motion, joint):
        """Return q_0 sinh(q / q_0) (N,) [rad]."""
        return self.shape["q_0"] * np.sinh(motion.q[:, joint] / self.shape["q_0"])


found = diagnose(model, runs.train, runs.test)
print(found)

# %%
rigid = ",".join(runs.truth["model_effects"])
models = {
    "no spring": model,
    "rubber": identify(urdf, runs.train, effects=f"{rigid},rubber_buffer:2@q_0=0.5"),
    "linear": identify(urdf, runs.train, effects=f"{rigid},joint_spring:2"),
}
rivals = compare(models, runs.test)
print(rivals.to_frame()["error [N m or N]"].unstack("model").round(4))

# %% [markdown]
# ## A method of one's own
#
# An estimator sees compressed data and constraints. Ridge regression is ten lines; like
# every method it is judged: are its links possible?


# %%
@register
@dataclass(frozen=True)
class Ridge(Estimator):
    """Least squares pulled to the nominal parameters."""

    name: ClassVar[str] = "ridge"
    description: ClassVar[str] = "least squares pulled to the nominal parameters"

    weight: float = 1e-3  # of the pull, relative to the torque

    def fit(self, task):
        """Minimise |R theta - rho|^2 + |D (theta - nominal)|^2."""
        data = task.data
        pull = self.weight * np.sqrt(data.tau_squared) / np.maximum(task.bound, 1e-9)
        rows = np.vstack([data.R, np.diag(pull)])
        right = np.concatenate([data.rho, pull * task.nominal])
        theta = np.linalg.lstsq(rows, right, rcond=None)[0]
        return Fit(theta, task.problem)


effects = f"{rigid},joint_spring:2"
methods = ["lmi-sdp", "ols", "ridge"]
fits = {name: identify(urdf, runs.train, name, effects=effects) for name in methods}
for name, fit in fits.items():
    print(f"{name:8s} worst violation {fit.certificate.worst:.2g}")

# %% [markdown]
# ## A solver of one's own
#
# Operator splitting (ADMM) in twenty lines. It solves the same SDP as the others, and
# calls an answer optimal only where both residuals are small: a solver that always says
# "solved" would call an empty set optimal, and `testing.contracts` would say so. Nobody
# has to believe it: the certificate bounds how far it is from the optimum.


# %%
@register
class Splitting(Solver):
    """ADMM with dense matrices, for small problems."""

    name = "splitting"
    requires = ("package", "numpy")
    cones = frozenset({"quadratic", "zero", "nonnegative", "psd"})
    default_options: ClassVar = {"eps": "accuracy", "steps": 100_000}
    status_meaning: ClassVar = {"solved": "optimal"}  # else: failed

    def run(self, problem, options):
        """Alternate between x and the slack s = b - A x in the cones."""
        upper, A, b = problem.P.toarray(), problem.A.toarray(), problem.b
        P, q = upper + np.triu(upper, 1).T, problem.q
        scale = np.linalg.norm(P) / np.linalg.norm(A.T @ A)
        inverse = np.linalg.pinv(P + scale * A.T @ A)
        smallest = options["eps"] * (1.0 + np.array([abs(b).max(), abs(q).max()]))
        s, u = np.zeros((2, len(b)))
        status, steps = "out of steps", 0
        while status != "solved" and steps < options["steps"]:
            steps += 1
            x = inverse @ (scale * A.T @ (b - s - u) - q)
            s = self.onto_cones(b - A @ x - u, problem.cones)
            primal = A @ x + s - b
            u += primal
            dual = P @ x + q + scale * A.T @ u
            if np.all([abs(primal).max(), abs(dual).max()] <= smallest):
                status = "solved"
        return self.make_solution(x, scale * u, status, steps)

    @staticmethod
    def onto_cones(y, cones):
        """Return the nearest point of the cones."""
        out, first = np.zeros_like(y), 0
        for cone in cones:
            part = slice(first, first + cone.rows)
            if cone.kind == "nonnegative":
                out[part] = np.maximum(y[part], 0.0)
            elif cone.kind == "psd":
                value, vector = np.linalg.eigh(unsvec(y[part], cone.size))
                out[part] = svec(vector * np.maximum(value, 0.0) @ vector.T)
            first += cone.rows
        return out


for solver in ("clarabel", "splitting"):
    method = LmiSdp(solver=solver, entropy=0.0, accuracy=1e-6)
    fit = identify(urdf, runs.train, method, effects=effects)
    print(f"{solver:12s} gap {fit.certificate.gap:.1e}")

# %% [markdown]
# ## Computed torque
#
# Does the model pay? The true arm follows a motion under one weak PD loop, in two ways:
# feedforward of a model's torque at the reference, and computed torque, the model at the
# measured state with the loop's acceleration. Most of what the file lacks is friction,
# so its links stand beside our friction too: what is left then is the links' share.

# %%
import pinocchio as pin

world, spring = runs.world, runs.truth["effects"][0]["size"]
memory = world.built.createData()


def acceleration(q, dq, tau):
    """Return the true arm's acceleration [rad/s^2], by Pinocchio, not by our model."""
    friction = world.coulomb * np.tanh(dq / world.dry.width) + world.viscous * dq
    passive = friction + world.offset + np.array([0.0, spring * q[1], 0.0])
    return pin.aba(world.built, memory, q, dq, tau - passive)


def reference(t):
    """Return position, velocity and acceleration of the motion."""
    phase = 1.3 * t + np.array([0.0, 1.0, 2.0])
    return 0.8 * np.sin(phase), 1.04 * np.cos(phase), -1.352 * np.sin(phase)


def tracking_error(torque, is_computed=False, dt=1e-3):
    """Return the RMS of the error [mrad] of each joint over 10 s."""
    q, dq, _ = reference(0.0)
    errors = []
    for t in np.arange(0.0, 10.0, dt):
        goal, goal_velocity, goal_acceleration = reference(t)
        e, de = goal - q, goal_velocity - dq
        if is_computed:
            tau = torque(q, dq, goal_acceleration + 100.0 * e + 20.0 * de)
        else:
            tau = torque(goal, goal_velocity, goal_acceleration) + 20.0 * e + 1.0 * de
        dq = dq + dt * acceleration(q, dq, tau)
        q = q + dt * dq
        errors.append(reference(t + dt)[0] - q)
    return 1e3 * np.sqrt(np.mean(np.square(errors), axis=0))


def by_model(estimate):
    """Return the torque of a model, fast enough for a loop of 1 kHz."""
    arm = estimate.controller()

    def torque(q, dq, ddq):
        arm.update(q, dq, ddq)
        return arm.torque

    return torque


best = fits["lmi-sdp"]
theta = best.theta.copy()
theta[best.model.rigid_indices] = load_problem(urdf).nominal_links.ravel()
file = pin.buildModelFromUrdf(urdf)
memory_of_file = file.createData()
torques = {
    "file's links": lambda *state: pin.rnea(file, memory_of_file, *state),
    "file's links, our friction and spring": by_model(best.with_theta(theta)),
    "model, no spring": by_model(model),
    "model with spring": by_model(best),
}
tracking = pd.DataFrame(
    {f"feedforward: {name}": tracking_error(torque) for name, torque in torques.items()}
    | {
        f"computed torque: {name}": tracking_error(torque, is_computed=True)
        for name, torque in torques.items()
    }
)
tracking.index = ["joint 1", "joint 2", "joint 3"]
tracking.T.plot.barh(logx=True, figsize=(9, 5), xlabel="RMS tracking error [mrad]")
plt.show()
# %%
print(tracking.T.round(2).to_string())

# %% [markdown]
# ## Evening: a family of models for MuJoCo
#
# For a robust controller or domain randomisation one model is not enough. Samples are
# consistent models that all fit; eight of them become MuJoCo models. What the data
# know hardly moves; what they do not know is spread over your bounds, so state some
# that you believe: here each mass within half and twice the file's.

# %%
from sdp_vs_penalty.ranges import find_samples

bounds = "m1=2:8,m2=1.5:6,m3=0.75:3"
bounded = identify(urdf, runs.train, effects=effects, bounds=bounds)
samples = find_samples(bounded, 200)
print(samples)
drawn = [bounded.with_theta(theta).to_mjspec().compile() for theta in samples.theta[:8]]
bodies = pd.DataFrame([model.body_mass[1:] for model in drawn]).add_prefix(
    "mass of body "
)
print(bodies.describe().loc[["min", "max"]].round(2))
