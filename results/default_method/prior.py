"""Make prior.md again: python results/default_method/prior.py [--draws 20]

What the default's prior buys on poor motion, and what each other method gains by the same
one. Simulated: the draws of the setting "poor excitation" of table "monte_carlo". The
default's prior is no sum of squares, which least squares and the penalty minimise: they
get its expansion to second order about the nominal robot, and so does the SDP beside them.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from sdp_vs_penalty import Measurements, identify, load_problem
from sdp_vs_penalty.estimation.constants import ROUNDING
from sdp_vs_penalty.estimators import LmiSdp, LmiSdpThickness, Penalty
from sdp_vs_penalty.estimators.estimator import (
    Estimator,
    Task,
    make_task,
    sample_variance,
)
from sdp_vs_penalty.estimators.ols import Ols
from sdp_vs_penalty.paper.tables.monte_carlo import SETTINGS, Setting, Truth, truth_of
from sdp_vs_penalty.regression.evidence import relative_error
from sdp_vs_penalty.regression.regression import compress
from sdp_vs_penalty.results.table import markdown_lines
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.signals.filtered import FilteredRuns
from sdp_vs_penalty.simulation.experiments import simulate

Array = NDArray[np.float64]
HERE = Path(__file__).parent
BY_NAME = {setting.name: setting for setting in SETTINGS}
POOR, RICH = BY_NAME["poor excitation"], BY_NAME["coloured noise, encoder steps"]
WEIGHT = LmiSdp().entropy
#: A share of the nominal link's inertia below which a link has none in some direction.
AT_LIMIT = 1e-6
#: Poses in which the answer to torque is compared.
POSES = 30
#: What a file's placeholders say of every link: a sphere of 1 kg and 5 cm at its joint.
PLACEHOLDER = np.array([1.0, 0, 0, 0, 1e-3, 0, 1e-3, 0, 0, 1e-3])
#: How far a CAD model is off: entries of the deformation of each link's pseudo-inertia.
CAD = 0.05
#: Methods by whether they get the prior: as they are, and by its squares.
WITHOUT_PRIOR: dict[str, Estimator] = {
    "weighted least squares": Ols(),
    "penalty": Penalty(),
    "SDP with thickness": LmiSdpThickness(),
    "SDP of the default": LmiSdp(entropy=0.0),
}
BY_SQUARES: dict[str, Estimator] = {
    "weighted least squares": Ols(),
    "penalty": Penalty(joint_prior=1.0),
    "penalty, no minimum thickness": Penalty(thickness=0.0, joint_prior=1.0),
    "SDP with thickness": LmiSdpThickness(),
    "SDP of the default": LmiSdp(entropy=0.0),
}


def with_squares(task: Task) -> Task:
    """Return the task with w/2 |L^-1 (P(theta) - P0) L^-T|^2 of every link as rows, P0 =
    L L^T: the second-order expansion of the default's prior."""
    rows, values = [], []
    for link, nominal in zip(task.links, task.prior_inertias, strict=True):
        root = np.linalg.inv(np.linalg.cholesky(nominal))
        of_link = np.zeros((16, task.data.R.shape[1]))
        moved = root @ inertia.PSEUDO_INERTIA_BASIS @ root.T
        of_link[:, link] = moved.reshape(10, 16).T
        rows.append(of_link)
        values.append(np.eye(4).ravel())
    weight = 0.5 * WEIGHT * sample_variance(task)
    data = task.data.with_observations(np.vstack(rows), np.concatenate(values), weight)
    return replace(task, data=data)


def drawn_run(truth: Truth, number: int) -> Measurements:
    """Return a draw's log."""
    return simulate(truth.trajectory, truth.torque, truth.sensor, [number, 7])


def task_of(truth: Truth, number: int) -> Task:
    """Return a draw as the methods get it."""
    problem = load_problem("panda")
    run = drawn_run(truth, number)
    filtered = FilteredRuns.filtering(run, problem.preprocessing.resolve(run))
    rows = compress(filtered, truth.model)
    return make_task(problem, truth.model, rows, "noise", seed=number)


def fits(
    task: Task, truth: Array, rng: np.random.Generator
) -> dict[tuple[str, str], Array]:
    """Return theta of every method, by prior and name; truth (n, 10): the true links, from
    which those of a CAD model are drawn."""
    found = {("none", k): m.fit(task).theta for k, m in WITHOUT_PRIOR.items()}
    squares = with_squares(task)
    found |= {("its squares", k): m.fit(squares).theta for k, m in BY_SQUARES.items()}
    found["as it is", "SDP of the default"] = LmiSdp().fit(task).theta
    for factor in (0.5, 2.0):
        heavy = replace(task, prior=factor * task.prior_links)
        key = f"of masses and inertias times {factor:g}", "SDP of the default"
        found[key] = LmiSdp().fit(heavy).theta
    alike = replace(task, prior=np.tile(PLACEHOLDER, (len(task.prior_links), 1)))
    found["of spheres of 1 kg at the joints", "SDP of the default"] = (
        LmiSdp().fit(alike).theta
    )
    drawn = inertia.deformed(truth, CAD, rng)
    found["of a CAD model, masses 10 % off", "SDP of the default"] = (
        LmiSdp().fit(replace(task, prior=drawn)).theta
    )
    return found


def links_at_limit(links: Array, nominal: Array) -> int:
    """Return how many links lie on the limit of what can exist, or beyond it: the least
    eigenvalue of P0^-1 P is 0 to rounding. links (n, 10), nominal P0 (n, 4, 4)."""
    pairs = zip(links, nominal, strict=True)
    least = [
        eigh(inertia.pseudo_inertia(link), p, eigvals_only=True)[0] for link, p in pairs
    ]
    return int((np.array(least) < AT_LIMIT).sum())


def mass_matrix_error(links: Array, truth: Truth) -> float:
    """Return the RMS over poses of the logarithms of the eigenvalues of M_true^-1 M [%]:
    twice and half the inertia err alike; infinite where a mass matrix is not positive."""
    robot = load_problem("panda").robot
    q = robot.random_configurations(POSES, 1)
    both = (robot.mass_matrices(x.ravel(), q) for x in (links, truth.links))
    values = np.array(
        [eigh(m, exact, eigvals_only=True) for m, exact in zip(*both, strict=True)]
    )
    if values.min() <= 0.0:
        return np.inf
    return 100 * float(np.sqrt(np.mean(np.log(values) ** 2)))


def determined(setting: Setting, draws: int) -> str:
    """Return how many base parameters `identify` says the data determine, in words."""
    truth = truth_of("panda", setting)
    models = [
        identify("panda", drawn_run(truth, number), check=False)
        for number in range(draws)
    ]
    counts = sorted({model.n_base_from_data for model in models})
    return f"{' or '.join(map(str, counts))} of {models[0].n_base}"


def half_width(values: Array) -> float:
    """Return half the width of the 95 % interval of a mean over the draws."""
    return float(1.96 * np.std(values, ddof=1) / np.sqrt(len(values)))


def judged(motion: str, setting: Setting, draws: int) -> list[list[str]]:
    """Return the rows of a setting: one a method and prior. motion: its word."""
    truth = truth_of("panda", setting)
    unseen = truth.unseen.least_squares()
    rigid = truth.model.rigid_indices
    errors: dict[tuple[str, str], list[float]] = {}
    exist: dict[tuple[str, str], int] = {}
    at_limit: dict[tuple[str, str], list[int]] = {}
    of_matrices: dict[tuple[str, str], list[float]] = {}
    for number in range(draws):
        task = task_of(truth, number)
        rng = np.random.default_rng([number, 11])
        for key, theta in fits(task, truth.links, rng).items():
            error = relative_error(unseen.loss(theta), unseen.tau_squared)
            errors.setdefault(key, []).append(float(error))
            links = theta[rigid].reshape(-1, 10)
            margins = inertia.consistency_margin(links)
            limits = links_at_limit(links, task.prior_inertias)
            at_limit.setdefault(key, []).append(limits)
            of_matrices.setdefault(key, []).append(mass_matrix_error(links, truth))
            exist[key] = exist.get(key, 0) + int(margins.min() >= -ROUNDING)
    default = np.array(errors["as it is", "SDP of the default"])
    matrices_of_default = np.array(of_matrices["as it is", "SDP of the default"])
    cells = []
    for (prior, name), of_method in errors.items():
        n_worse = int((np.array(of_method) > default).sum())
        more = np.array(of_method) - default
        of_method_matrices = np.array(of_matrices[prior, name])
        is_known = bool(np.isfinite(of_method_matrices).all())
        cells.append(
            [
                motion,
                name,
                prior,
                f"{np.mean(of_method):#.3g}",
                f"{half_width(np.array(of_method)):#.2g}",
                f"{np.mean(more):+.2g}",
                f"{half_width(more):.2g}",
                str(n_worse),
                str(exist[prior, name]),
                f"{np.mean(at_limit[prior, name]):.1f}",
                *of_matrix(of_method_matrices, matrices_of_default, is_known),
            ]
        )
    return cells


def of_matrix(errors: Array, of_default: Array, is_known: bool) -> list[str]:
    """Return the three cells of the mass matrix: its error [%], how much more that is than
    the default's, and half the width of that interval."""
    if not is_known:
        return ["-", "-", "-"]
    apart = errors - of_default
    return [
        f"{np.mean(errors):.2g}",
        f"{np.mean(apart):+.1g}",
        f"{half_width(apart):.1g}",
    ]


def main() -> None:
    """Fit every draw, and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--draws", type=int, default=20)
    count = parser.parse_args().draws
    heads = ["motion", "method", "prior", "error [%]", "+- [%]"]
    heads += ["minus the default's [points]"]
    heads += ["+- [points]", "worse", "all links exist"]
    heads += ["links at the limit", "error of the mass matrix [%]"]
    heads += ["mass matrix minus the default's [points]"]
    heads += ["+- of the mass matrix [points]"]
    text = [
        "# What the default's prior buys",
        "",
        f"Simulated: {count} draws of a Panda that moves little (0.3 of its amplitude for 7"
        f" s; the data determine {determined(POOR, 5)} base parameters), and {count} that"
        f" move much (14 s at the whole amplitude; {determined(RICH, 5)}), as in"
        " `results/tables/table_monte_carlo.md`. What `identify` says of the first five is"
        " counted. Error: RMS of the torques of all"
        " joints together on three random motions, over their RMS, mean over the draws with"
        " its 95 % interval; then what a method errs more than the default in the same"
        " draws, in how many of them it does, and in how many all links can exist. Then how"
        " many of the seven links lie on the limit of what can exist, or beyond it (no"
        " inertia about some axis), and how wrong the mass matrix is, with which a simulator"
        " or computed torque answers: RMS over 30 poses of the logarithms of the eigenvalues"
        " of M_true^-1 M, so that twice and half err alike; `-` where it is not positive in"
        " some pose. The masses of the nominal robot are 10 to 252 % off; alone it errs by"
        " 21.5 %."
        f" The CAD model: the true links, each strained and shifted by {CAD:.0%} at random"
        " (masses are 10 % off, RMS)."
        " The prior's squares: its expansion to second order, which least squares"
        " and the penalty can minimise. By"
        " `python results/default_method/prior.py`.",
        "",
        *markdown_lines(
            heads, [*judged("little", POOR, count), *judged("rich", RICH, count)]
        ),
        "",
    ]
    (HERE / "prior.md").write_text("\n".join(text))


if __name__ == "__main__":
    main()
