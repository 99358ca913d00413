# %% [markdown]
# # Which solver can be believed?
#
# The same semidefinite programs go to several solvers. None of their words is taken:
# the optimum of each program lies in an interval that was proved beforehand, and every
# answer is judged by it. A solver that claims success and is wrong is the one to fear.

# %%
import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

from sdp_vs_penalty.colours import PALETTE
from sdp_vs_penalty.shootout import runner
from sdp_vs_penalty.shootout.judge import classes

setup = runner.Shootout(
    Path(tempfile.mkdtemp()) / "shootout",
    solvers=["lmi-sdp", "clarabel", "scs", "cvxopt", "penalty"],
    problems=[
        "two_link simulated one-step gyration",
        "panda simulated 14 s one-step plain",
        "panda units g mm",
        "panda infeasible 1e-3",
    ],
    accuracies=(1e-6,),
    time_limit=5.0,
)
runs = runner.run(setup).results.runs

# %% [markdown]
# Each cell says what became of an answer. A "false_claim" is one that the proof
# refutes; "far" is one that met the solver's own tolerance, but
# violates a constraint, or its objective is far.

# %%
judged = runs.assign(judged=classes(runs, 1e-6))
judged.pivot(index="problem", columns="solver", values="judged")

# %% [markdown]
# ## Error and time
#
# The error of the objective against the proved interval, over the processor time. Below
# the dotted line the accuracy is reached that was asked for.

# %%
figure, axis = plt.subplots(figsize=(8, 4))
for colour, (solver, part) in zip(PALETTE, runs.groupby("solver"), strict=False):
    error = part["objective_error"].clip(lower=1e-16)
    axis.loglog(part["seconds"], error, "o", ms=9, color=colour, label=solver)
axis.axhline(1e-6, color="black", ls=":")
axis.set(xlabel="time [s]", ylabel="relative error of the objective")
axis.legend(frameon=False)
axis.grid(alpha=0.3)
plt.show()

# %% [markdown]
# `sdp-vs-penalty shootout --quick` runs more of them, and `shootout --export FOLDER`
# writes the programs with their proofs, so that any solver can be tried.
