"""What certified ranges cost, and whether they keep what they promise.

    python results/ranges/ranges.py [--quick] [--draws 200] [--out FOLDER] [SECTION ...]

Sections, one CSV file each:
- ends: 40 linear functions of five arms, beside CVXPY with Clarabel on the same set
  written down a second time; each end's own certified gap, and the exact proof of one;
- cost: processor time of ranges in units of one fit of `identify`;
- coverage: how often 95 % ranges hold the truth, on simulated worlds whose motion and
  model are exact and whose torque noise is white or remembers;
- band: share of a real Panda's unseen torque within the band;
- samples: 1000 consistent models of the Panda, and R^ against the number of steps;
- excite: length of a named range before, as predicted for the motion chosen for it and for
  the worst candidate, and after each was simulated.
"""

import argparse
import csv
import json
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path

os.environ |= dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"
)

import numpy as np
import scipy

from sdp_vs_penalty import Estimate, Measurements, add, diagnose, identify, load_problem
from sdp_vs_penalty.data.measurements import concatenate
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.estimation.build_problem import PoseOptions, build_problem
from sdp_vs_penalty.estimators import make_estimator
from sdp_vs_penalty.problem import measured_runs
from sdp_vs_penalty.ranges import EndSearch, allowed_set
from sdp_vs_penalty.ranges.allowed import KINDS
from sdp_vs_penalty.ranges.band import torque_band
from sdp_vs_penalty.ranges.functions import all_functions, functions_by_name
from sdp_vs_penalty.ranges.samples import PRIORS, sample_models
from sdp_vs_penalty.ranges.shortening import compare_motions
from sdp_vs_penalty.ranges.table import ranges_of, training_of
from sdp_vs_penalty.robot.trajectory import random_trajectory
from sdp_vs_penalty.simulation.experiments import experiment
from sdp_vs_penalty.solvers import verify_proof

HERE = Path(__file__).parent
ARMS = ("panda", "ur10e", "tx40", "emps", "two_link")
#: Tolerances that Clarabel is asked for, the first that it reaches.
TOLERANCES = (1e-12, 1e-10, 1e-8)
TOLERANCE_NAMES = ("tol_gap_abs", "tol_gap_rel", "tol_feas")
#: Torque noise over each joint's root mean square, and how much it remembers of the last
#: sample at 200 Hz: nothing, or for a tenth of a second.
NOISE = 0.02
COLOURS = {"white": 0.0, "AR": 0.95}
WORLDS = ("four_r", "panda", "ur10e")
#: s: the Panda's motion repeats after so long; it stands still at first.
PERIOD, STANDSTILL, FOLDS = 13.334, 1.1, 5
#: Worlds and length [s] of the motions of the section excite.
EXCITED, SECONDS = ("four_r", "panda"), 6.0
Rows = Iterator[dict[str, object]]


def model_of(name: str) -> tuple[Estimate, Measurements]:
    """Return a model of an arm's first measured run, of the 2R of a simulated one, and
    the run."""
    problem = load_problem(name)
    if name == "two_link":
        run = experiment(problem).training_run()
    else:
        run = next(iter(measured_runs(name).values()))
    return identify(problem, run, check=False), run


def ends(given: argparse.Namespace) -> Rows:
    """Yield an arm a row: the worst difference to CVXPY and Clarabel."""
    import cvxpy as cp

    for arm in ARMS:
        model, run = model_of(arm)
        posed, floor = training_of(model, run)
        allowed = allowed_set(posed, model.theta, floor)
        known = set(model.model.known_values)
        chosen = [
            f
            for f in all_functions(posed.problem, model.model)
            if f.g is not None and not known & set(np.flatnonzero(f.g).tolist())
        ]
        rng = np.random.default_rng(0)
        picked = sorted(rng.permutation(len(chosen))[: 8 if given.quick else 40])
        functions = [chosen[k] for k in picked]
        pairs = EndSearch(allowed).least_and_greatest([f.g for f in functions])
        p = len(allowed.bound)
        scaled = cp.Variable(p)
        theta = cp.multiply(allowed.bound, scaled)
        demands = []
        for c in allowed.constraints.convex:
            flat = c.coefficients.reshape(len(c.indices), -1)
            if c.cone == "psd":
                terms = zip(c.indices.tolist(), c.coefficients, strict=True)
                value = c.constant + sum(theta[k] * F for k, F in terms)
                demands.append(value >> 0)
                continue
            value = c.constant + flat.T @ theta[c.indices]
            in_cone = value >= 0 if c.cone != "soc" else cp.norm(value[1:]) <= value[0]
            demands.append(in_cone)
        g, one_over_radius = cp.Parameter(p), cp.Parameter(nonneg=True)
        ball = allowed.ball
        in_ball = cp.norm(one_over_radius * (ball.A @ theta - ball.a)) <= 1.0
        problem = cp.Problem(cp.Minimize(g @ theta), [*demands, in_ball])
        worst = certified = 0.0
        failed = 0
        for pair in pairs:
            width = abs(pair[1].value - pair[0].value)
            for end in pair:
                g.value = end.g
                one_over_radius.value = 1.0 / np.sqrt(allowed.limit(end.rise))
                unit = max(width, end.size)
                certified = max(certified, end.gap / unit)
                for tolerance in TOLERANCES:
                    settings = dict.fromkeys(TOLERANCE_NAMES, tolerance)
                    try:
                        problem.solve(solver=cp.CLARABEL, **settings)
                    except cp.SolverError:
                        continue  # the status is still that of the end before
                    if problem.status == "optimal":
                        break
                else:
                    failed += 1
                    continue
                worst = max(worst, abs(problem.value - end.lowest) / unit)
        verify_proof.check(pairs[0][0].proof(functions[0].name))
        yield {
            "arm": arm,
            "functions": len(functions),
            "worst difference to Clarabel": f"{worst:.1e}",
            "ends that Clarabel does not call optimal": failed,
            "worst certified gap": f"{certified:.1e}",
            "proof": f"accepted ({functions[0].name})",
        }


def cost(given: argparse.Namespace) -> Rows:
    """Yield what sets of functions cost in fits of the default method."""
    model, run = model_of("panda")
    posed, floor = training_of(model, run)
    estimator = make_estimator("lmi-sdp")
    times = []
    for _ in range(9):
        fresh = build_problem(
            posed.problem, posed.runs, PoseOptions(model.model.effects)
        ).task
        begin = time.process_time()
        estimator.fit(fresh)
        times.append(time.process_time() - begin)
    fit = float(np.median(times))

    def linear(names: list[str]) -> Callable[[], object]:
        def run() -> object:
            allowed = allowed_set(posed, model.theta, floor)
            functions = functions_by_name(posed.problem, model.model, names)
            return EndSearch(allowed).least_and_greatest([f.g for f in functions])

        return run

    tasks: dict[str, Callable[[], object]] = {
        "7 masses and the total": linear(["masses"]),
        "71: masses, total, centres, inertias about the frame": lambda: ranges_of(
            posed,
            model.theta,
            allowed_set(posed, model.theta),
            ["masses", "centres", "inertias"],
        ),
        "the same, with model error": lambda: ranges_of(
            posed,
            model.theta,
            allowed_set(posed, model.theta, floor),
            ["masses", "centres", "inertias"],
        ),
        "masses under four sets of constraints, with model error": lambda: ranges_of(
            posed,
            model.theta,
            allowed_set(posed, model.theta, floor),
            ["masses"],
            kinds=KINDS[:-1],
        ),
    }
    for name, task in tasks.items():
        task()
        begin = time.process_time()
        task()
        seconds = time.process_time() - begin
        yield {"functions": name, "s": f"{seconds:.2f}", "fits": f"{seconds / fit:.0f}"}


def world(name: str):
    """Return problem, model, truth (p,), and a clean run of a simulated world."""
    source = HERE / "four_r.urdf" if name == "four_r" else name
    problem = load_problem(source)
    effects = "rigid_body,viscous_friction,coulomb_friction@v_s=0.02,torque_offset"
    model = problem.model(effects)
    truth = problem.nominal(model)
    places = model.rigid_indices
    truth[places] = experiment(problem).links.ravel()
    joints = np.setdiff1d(np.arange(len(truth)), places)
    rng = np.random.default_rng(3)
    truth[joints] = rng.uniform(0.1, 0.5, len(joints))
    trajectory = random_trajectory(problem.robot, seed=1)
    t = np.arange(0.0, 20.0, 0.005)
    q, dq, ddq = trajectory.states(t)
    torque = model.torque(truth, Motion(t, q, dq, ddq))
    return problem, model, truth, (t, q, torque)


def coverage(given: argparse.Namespace) -> Rows:
    """Yield a world and a noise a row: how often ranges hold the truth.

    Draws are kept in a file beside the results, from which a later call goes on.
    """
    kept = given.out / "coverage.jsonl"
    done = {}
    if kept.exists():
        lines = map(json.loads, kept.read_text(encoding="utf-8").splitlines())
        done = {line["key"]: line["ends"] for line in lines}
    for name in given.worlds:
        problem, model, truth, (t, q, torque) = world(name)
        size = NOISE * np.sqrt(np.mean(torque**2, axis=0))
        masses = functions_by_name(problem, model, ["masses"])
        base = functions_by_name(problem, model, ["base"])[:12]
        joints = [
            f
            for f in functions_by_name(problem, model, ["parameters"])
            if f.name.startswith(("f_v", "f_c"))
        ][:8]
        groups = {"masses": masses, "base parameters": base, "friction": joints}
        functions = [f.g for group in groups.values() for f in group]
        true = np.array([g @ truth for g in functions])
        for colour, memory in COLOURS.items():
            held, lengths = [], []
            for draw in range(8 if given.quick else given.draws):
                key = f"{name} {colour} {draw}"
                if key not in done:
                    rng = np.random.default_rng([draw, 17])
                    white = rng.standard_normal((len(t) + 500, problem.robot.n))
                    noise = scipy.signal.lfilter([1.0], [1.0, -memory], white, axis=0)
                    noise = noise[500:] * size * np.sqrt(1.0 - memory**2)
                    run = Measurements(t, q, torque + noise)
                    posed = build_problem(problem, run, PoseOptions(model.effects))
                    theta = make_estimator("lmi-sdp").fit(posed.task).theta
                    found = EndSearch(allowed_set(posed, theta)).least_and_greatest(
                        functions
                    )
                    done[key] = [[low.value, high.value] for low, high in found]
                    with kept.open("a", encoding="utf-8") as file:
                        file.write(json.dumps({"key": key, "ends": done[key]}) + "\n")
                low, high = np.array(done[key]).T
                margin = 1e-9 * (1.0 + np.abs(true))
                held.append((low - margin <= true) & (true <= high + margin))
                lengths.append(high - low)
            start = 0
            for group, members in groups.items():
                part = slice(start, start + len(members))
                start += len(members)
                share = np.array(held)[:, part].mean(axis=1)
                half = 1.96 * share.std(ddof=1) / np.sqrt(len(share))
                relative = np.mean(lengths, axis=0)[part] / np.maximum(
                    np.abs(true[part]), 1e-3
                )
                yield {
                    "world": name,
                    "noise": colour,
                    "functions": f"{len(members)} {group}",
                    "draws": len(share),
                    "coverage [%]": f"{100 * share.mean():.1f} +- {100 * half:.1f}",
                    "mean length over value": f"{np.median(relative):.3g}",
                }


def band(given: argparse.Namespace) -> Rows:
    """Yield a fold of the Panda's motion and a joint a row: samples within the band."""
    (whole,) = measured_runs("panda").values()
    since = whole.t - whole.t[0] - STANDSTILL
    phase = (since % PERIOD) // (PERIOD / FOLDS)
    for fold in range(1 if given.quick else FOLDS):
        train, unseen = (
            stretches(whole, (since >= 0.0) & chosen)
            for chosen in (phase != fold, phase == fold)
        )
        model = identify("panda", train, noise_from=whole, check=False)
        effects = diagnose(model, train, check=False).helpful
        if effects:
            laws = add(model, list(effects), train).model.effects
            how = {"effects": laws, "noise_from": whole, "check": False}
            model = identify("panda", train, **how)
        found = torque_band(model, unseen)
        rms = np.sqrt(np.mean(found.measured**2, axis=0))
        halves = found.half_width, found.half_width_with_error
        narrow, wide = (np.sqrt(np.mean(x**2, axis=0)) for x in halves)
        for j in range(len(rms)):
            yield {
                "fold": fold + 1,
                "effects found": len(effects),
                "joint": j + 1,
                "torque, RMS [N m]": f"{rms[j]:.3g}",
                "half width, RMS [N m]": f"{narrow[j]:.3g}",
                "with model error": f"{wide[j]:.3g}",
                "inside [%]": f"{100 * found.inside(False)[j]:.1f}",
                "inside with model error [%]": f"{100 * found.inside()[j]:.1f}",
            }


def stretches(run: Measurements, chosen: np.ndarray) -> Measurements:
    """Return the chosen samples' stretches of more than two seconds, each as a run."""
    samples = np.flatnonzero(chosen)
    parts = np.split(samples, np.flatnonzero(np.diff(samples) > 1) + 1)
    long = [p for p in parts if run.t[p[-1]] - run.t[p[0]] > 2.0]
    return concatenate([Measurements(run.t[p], run.q[p], run.tau[p]) for p in long])


def samples(given: argparse.Namespace) -> Rows:
    """Yield a prior and a number of consistent models of the Panda a row: how far chains that
    begin near the set's boundary have forgotten it."""
    model, run = model_of("panda")
    posed, floor = training_of(model, run)
    allowed = allowed_set(posed, model.theta, floor)
    for prior in PRIORS:
        for count in (500, 1000) if given.quick else (500, 1000, 2000, 4000):
            begin = time.process_time()
            found = sample_models(allowed, count, seed=0, prior=prior)
            seconds = time.process_time() - begin
            margins = [allowed.constraints.margin(theta) for theta in found.theta]
            yield {
                "prior": prior,
                "models": len(found.theta),
                "consistent": sum(m >= 0.0 for m in margins),
                "steps of a chain": found.steps,
                "s": f"{seconds:.1f}",
                "effective, least": f"{found.effective.min():.0f}",
                "effective, median": f"{np.median(found.effective):.0f}",
                "split R^, largest": f"{found.r_hat.max():.3f}",
                "of": model.model.parameters[int(np.argmax(found.r_hat))].name,
                "split R^, median": f"{np.median(found.r_hat):.3f}",
            }


def excite(given: argparse.Namespace) -> Rows:
    """Yield a world and a motion a row: the length of the range of a mass, before, predicted
    and after the motion was simulated."""
    name = "m4"
    for arm in EXCITED:
        problem, model, truth, (t, q, torque) = world(arm)
        size = NOISE * np.sqrt(np.mean(torque**2, axis=0))
        rng = np.random.default_rng(5)

        def noisy(clean, size=size, rng=rng):
            return clean + rng.standard_normal(clean.shape) * size

        short = t < SECONDS
        train = Measurements(t[short], q[short], noisy(torque[short]))
        allowed, posed = allowed_by(problem, model, train)
        before, g = length_of(allowed, problem, model, name)
        motions = [
            random_trajectory(problem.robot, seed=k, duration=SECONDS)
            for k in range(100, 104 if given.quick else 124)
        ]
        ranked = compare_motions(allowed, posed, g, motions)
        for word, motion in (("chosen", ranked[0]), ("worst", ranked[-1])):
            since = np.arange(0.0, SECONDS, 0.005)
            states = motion.trajectory.states(since)
            clean = model.torque(truth, Motion(since, *states))
            after = []
            for _ in range(2 if given.quick else 20):
                further = Measurements(since, states[0], noisy(clean))
                both = concatenate([train, further])
                known, _ = allowed_by(problem, model, both)
                after.append(length_of(known, problem, model, name)[0])
            low, high = motion.predicted
            half = 1.96 * np.std(after, ddof=1) / np.sqrt(len(after))
            yield {
                "world": arm,
                "range of": name,
                "motion": f"{word} of {len(ranked)}",
                "length before [kg]": f"{before:.3g}",
                "predicted": f"{high - low:.3g}",
                "after": f"{np.mean(after):.3g} +- {half:.2g}",
                "draws": len(after),
            }


def allowed_by(problem, model, run: Measurements):
    """Return what a run allows, and its identification problem."""
    posed = build_problem(problem, run, PoseOptions(model.effects))
    theta = make_estimator("lmi-sdp").fit(posed.task).theta
    return allowed_set(posed, theta), posed


def length_of(allowed, problem, model, name: str):
    """Return the length of a function's range, and the function's coefficients (p,)."""
    (function,) = functions_by_name(problem, model, [name])
    ((low, high),) = EndSearch(allowed).least_and_greatest([function.g])
    return high.value - low.value, function.g


SECTIONS = {
    "ends": ends,
    "cost": cost,
    "coverage": coverage,
    "band": band,
    "samples": samples,
    "excite": excite,
}


def main() -> None:
    """Write the sections that are named, or all."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("sections", nargs="*", default=list(SECTIONS))
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--worlds", nargs="*", default=list(WORLDS))
    parser.add_argument("--out", type=Path, default=HERE)
    given = parser.parse_args()
    for name in given.sections:
        rows = []
        for row in SECTIONS[name](given):
            print(row, flush=True)
            rows.append(row)
        given.out.mkdir(parents=True, exist_ok=True)
        with (given.out / f"{name}.csv").open(
            "w", newline="", encoding="utf-8"
        ) as file:
            writer = csv.DictWriter(file, fieldnames=list(rows[0]))
            writer.writeheader()
            writer.writerows(rows)


if __name__ == "__main__":
    main()
