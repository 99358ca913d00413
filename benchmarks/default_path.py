"""Measure the default path: time beside fresh CVXPY, a thousand resamples, cost against links.

    python benchmarks/default_path.py [--draws 1000] [--out results/shootout/default_path.md]

Uses the real Panda run where it is (SDP_VS_PENALTY_DATA), else the simulated one. Of repeated times the
fastest counts, and processor time is given beside wall time, because machines are shared.
"""

from __future__ import annotations

import argparse
import os
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

os.environ.setdefault("OMP_NUM_THREADS", "1")

import bootstrap

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimators.lmi_sdp import essential, solve_sdp
from sdp_vs_penalty.estimators.task import joint_weights, make_task
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.parallel import Workers
from sdp_vs_penalty.problem.load import load_problem
from sdp_vs_penalty.regression.regression import LeastSquares, compress
from sdp_vs_penalty.shootout import regular
from sdp_vs_penalty.shootout.instance import Instance, in_units
from sdp_vs_penalty.simulation.experiment import experiment
from sdp_vs_penalty.solvers import clarabel
from sdp_vs_penalty.solvers.identification import least_squares_sdp
from sdp_vs_penalty.solvers.objective import Objective

UNITS = {"kg m": (1.0, 1.0), "g mm": (1e-3, 1e-3), "t km": (1e3, 1e3)}


def measured_panda() -> tuple[str, Instance, list[LeastSquares]]:
    """The Panda with a minimum thickness and its time blocks, measured if possible."""
    problem = load_problem("panda")
    try:
        run, effects, source = regular.measurements(problem, 14.0), None, "measured"
    except InputError:
        described = experiment(problem)
        run, effects, source = (
            described.training_run(0).window(0.0, 14.0),
            described.effects,
            "simulated",
        )
    model = problem.model(effects)
    regression = compress(run, model, problem.preprocessing.resolve(run))
    weights = joint_weights(regression, make_task(problem, model, regression, "none").ols)
    task = make_task(problem, model, regression)
    instance = regular.posed("panda", task, "one-step", "gyration")
    return source, instance, bootstrap.block_data(regression, weights)


def conic_and_solve(instance: Instance) -> None:
    """From compressed data to Clarabel's answer: the conic form, set-up, solve."""
    interior = instance.interior
    least = 1e-6 * instance.data.tau_squared
    sdp = least_squares_sdp(
        instance.objective, instance.sent, interior, instance.task.bound, interior, least_loss=least
    )
    clarabel.solve(sdp.conic, 1e-10)


def certified(instance: Instance) -> None:
    """The whole default path: conic form, solve, proof, again where the gap is loose."""
    solve_sdp(instance.task, instance.objective, instance.constraints, "clarabel", 1e-10)


def fresh_cvxpy(instance: Instance, data: LeastSquares) -> str:
    """The same problem as a user writes it, a new CVXPY problem each time, solved by Clarabel."""
    import cvxpy as cp

    theta = cp.Variable(data.R.shape[1])
    constraints = []
    for c in essential(instance.constraints, instance.objective):
        d = len(c.constant)
        flat = c.coefficients.reshape(len(c.indices), -1).T @ theta[c.indices] + c.constant.ravel()
        if c.cone == "psd":
            constraints.append(cp.reshape(flat, (d, d), order="C") >> 0)
        elif c.cone == "soc":
            constraints.append(cp.SOC(flat[0], flat[1:]))
        else:
            constraints.append(flat >= 0)
    problem = cp.Problem(cp.Minimize(cp.sum_squares(data.R @ theta - data.rho)), constraints)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        problem.solve(solver=cp.CLARABEL)
    return str(problem.status)


def timed(work: Callable[[], object], repeats: int) -> tuple[float, float]:
    """Fastest wall and processor time [s]."""
    wall, processor = [], []
    work()
    for _ in range(repeats):
        t, c = time.perf_counter(), time.process_time()
        work()
        wall.append(time.perf_counter() - t)
        processor.append(time.process_time() - c)
    return min(wall), min(processor)


def single(instance: Instance) -> list[str]:
    rows = {
        "conic form, set-up and solve": timed(lambda: conic_and_solve(instance), 60),
        "the same with its proof (default path)": timed(lambda: certified(instance), 60),
        "fresh CVXPY problem with Clarabel": timed(lambda: fresh_cvxpy(instance, instance.data), 30),
    }
    last = rows["fresh CVXPY problem with Clarabel"][1]
    lines = ["| what | wall [ms] | processor [ms] | CVXPY takes |", "| --- | --- | --- | --- |"]
    for name, (wall, processor) in rows.items():
        lines.append(f"| {name} | {1e3 * wall:.1f} | {1e3 * processor:.1f} | {last / processor:.1f}x |")
    return lines


def resamples(instance: Instance, blocks: Sequence[LeastSquares], draws: int, jobs: int) -> list[str]:
    """Ours, certified, on all cores; the loop over fresh CVXPY on the first tenth of the same draws."""
    start = time.perf_counter()
    found = bootstrap.bootstrap(instance.task, blocks, draws, 0, Workers(jobs), jobs)
    ours = (time.perf_counter() - start) / draws
    loop = max(draws // 10, 5)
    start = time.perf_counter()
    claims = [
        fresh_cvxpy(instance, bootstrap.joined(blocks, bootstrap.draw_counts(len(blocks), k, 0)))
        for k in range(loop)
    ]
    theirs = (time.perf_counter() - start) / loop
    lines = [
        f"{draws} draws, certified, on {jobs} cores: {1e3 * ours:.1f} ms each; a loop over fresh CVXPY "
        f"problems ({loop} of the same draws, {claims.count('optimal')} called optimal, none certified):"
        f" {1e3 * theirs:.1f} ms each, {theirs / ours:.1f} times as long.",
        "",
        "| units | draws | solved again | gap > 1e-8 | largest gap | median gap |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for name, (mass, length) in UNITS.items():
        if name != "kg m":
            moved = [_moved(instance, b, mass, length) for b in blocks]
            whole = in_units(instance, mass, length)
            found = bootstrap.bootstrap(whole.task, moved, draws, 0, Workers(jobs), jobs)
        loose = int(np.sum(found.gap > 1e-8))
        lines.append(
            f"| {name} | {draws} | {found.again} | {loose} | {found.gap.max():.1e} | "
            f"{np.median(found.gap):.1e} |"
        )
    return lines


def _moved(instance: Instance, block: LeastSquares, mass: float, length: float) -> LeastSquares:
    alone = replace(instance, task=replace(instance.task, data=block), objective=Objective(block))
    return in_units(alone, mass, length).data


def growth(links: Sequence[int]) -> list[str]:
    """Cost of one solve against the number of links, and the exponent of a power law through it."""
    lines = ["| links | parameters | processor [ms] |", "| --- | --- | --- |"]
    seconds = []
    for n in links:
        task = regular.chain_task(n)
        instance = regular.posed(f"chain {n}", task, "one-step", "gyration")
        _ = instance.interior, instance.sent
        _, processor = timed(lambda instance=instance: conic_and_solve(instance), 9)  # type: ignore[misc]
        seconds.append(processor)
        lines.append(f"| {n} | {len(task.bound)} | {1e3 * processor:.0f} |")
    slope, offset = np.polyfit(np.log(links), np.log(seconds), 1)
    residual = np.log(seconds) - slope * np.log(links) - offset
    return [
        *lines,
        "",
        f"Least-squares fit of log t = {slope:.2f} log n {offset:+.2f}: exponent {slope:.2f}, residuals "
        f"within {100 * np.abs(np.expm1(residual)).max():.0f} %.",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--draws", type=int, default=1000)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--links", default="14,20,30,42,60")
    parser.add_argument("--out", type=Path, default=Path("results/shootout/default_path.md"))
    chosen = parser.parse_args()
    source, instance, blocks = measured_panda()
    text = [
        "# The default path in figures",
        "",
        f"Panda, {source}, 14 s in {len(blocks)} blocks, minimum thickness 20 mm. Made by "
        "`python benchmarks/default_path.py`.",
        "",
        "## One solve",
        "",
        *single(instance),
        "",
        "## Block bootstrap",
        "",
        *resamples(instance, blocks, chosen.draws, chosen.jobs),
        "",
        "## Cost against the number of links",
        "",
        "Conic form, set-up and one solve to 1e-10 of random serial chains.",
        "",
        *growth([int(word) for word in chosen.links.split(",")]),
        "",
    ]
    write_text(chosen.out, "\n".join(text))
    print("\n".join(text))


if __name__ == "__main__":
    main()
