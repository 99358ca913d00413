"""A payload in the control loop: time of an update, picks of the real UR10e, alarms.

    python results/picks/pick_runs.py [--data DATA] [--out FOLDER]

DATA holds the measurements as `sdp-vs-penalty fetch` leaves them (its subfolder ur10e).
A pick is a splice of two runs of one trajectory, without and with the load of 2.805 kg,
where the arm is at the same place. Gains and model come from the other trajectory, the
noise from a third; so nothing that is judged was used before. Writes picks.md.
"""

import argparse
import os
import time
from collections.abc import Sequence
from pathlib import Path

os.environ |= dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"
)

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty import Estimate, Measurements, PayloadEstimator, identify
from sdp_vs_penalty.effects import Motion
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.online import PayloadChange, ResidualNoise
from sdp_vs_penalty.problem import measured_runs
from sdp_vs_penalty.results.table import markdown_lines
from sdp_vs_penalty.robot import random_trajectory

#: kg: the authors' load.
LOAD = 2.805
#: The trajectories that were run with and without it, and the one for the noise.
PAIRS = ("19_14harm50sec", "19_15harm50sec")
CALIBRATION = "12-50sec_12harm"
#: s after a pick at which the mass is judged.
JUDGED = (0.5, 1.0, 2.0, 5.0)


def splice(before: Measurements, after: Measurements, at: float) -> Measurements:
    """One run until ``at`` seconds, then the other from where the arm is at the same
    place."""
    t_before = before.t - before.t[0]
    t_after = after.t - after.t[0]
    first = np.flatnonzero(t_before < at)
    near = np.flatnonzero(np.abs(t_after - at) < 4.0)
    distance = np.abs(after.q[near] - before.q[first[-1]]).max(axis=1)
    start = int(near[np.argmin(distance)])
    clock = t_after[start + 1 :] - t_after[start] + t_before[first[-1]]
    return Measurements(
        np.concatenate([t_before[first], clock]),
        np.vstack([before.q[first], after.q[start + 1 :]]),
        np.vstack([before.tau[first], after.tau[start + 1 :]]),
    )


def changes(
    estimator: PayloadEstimator, run: Measurements, marks: Sequence[float] = ()
) -> tuple[list[PayloadChange], list[tuple[float, float, float]]]:
    """All changes that a run brings to light; mass and its interval [kg] at the instants
    ``marks``, NaN where nothing is carried."""
    reported = []
    masses = []
    left = list(marks)
    for t, q, tau in zip(run.t, run.q, run.tau, strict=True):
        change = estimator.update(t, q, tau)
        if change is not None:
            reported.append(change)
        while left and t >= left[0]:
            left.pop(0)
            known = estimator.payload
            row = (np.nan,) * 3
            if known is not None:
                row = (known.mass, *known.mass_interval)
            masses.append(row)
    return reported, masses


def model_of(runs: dict[str, Measurements], name: str) -> Estimate:
    """The arm from one trajectory, its gains from the same one with the load."""
    loads = [(runs[f"{name}Load"], LOAD)]
    return identify("ur10e", runs[name], known_loads=loads, check=False)


def real_picks(runs: dict[str, Measurements]) -> list[tuple[str, str]]:
    """Masses within their intervals, instants and latencies of spliced picks, and false
    alarms of all runs without a load."""
    hits, errors, widths = np.zeros((3, 2, 10, len(JUDGED)))
    instants = list[float]()
    latencies = list[float]()
    n_extra = 0
    n_missed = 0
    alarms = 0
    seconds = 0.0
    for k, (trained, judged) in enumerate([PAIRS, PAIRS[::-1]]):
        estimate = model_of(runs, trained)
        noise = PayloadEstimator.calibrated(estimate, runs[CALIBRATION], 100.0).noise
        for m, at in enumerate(range(6, 46, 4)):
            run = splice(runs[judged], runs[f"{judged}Load"], at)
            marks = [at + x for x in JUDGED]
            estimator = PayloadEstimator(estimate, noise, 100.0)
            reported, masses = changes(estimator, run.window(0.0, at + 8.0), marks)
            mass, lower, upper = np.array(masses).T
            hits[k, m] = (lower <= LOAD) & (upper >= LOAD)
            errors[k, m], widths[k, m] = mass - LOAD, 0.5 * (upper - lower)
            n_missed += not reported
            n_extra += max(len(reported) - 1, 0)
            instants += [x.time - at for x in reported[:1]]
            latencies += [x.detected - at for x in reported[:1]]
        for name, run in runs.items():
            if name.endswith("Load") or name in (trained, CALIBRATION):
                continue
            reported, _ = changes(PayloadEstimator(estimate, noise, 100.0), run)
            alarms += len(reported)
            seconds += float(run.t[-1] - run.t[0])
    rows = []
    for j, after in enumerate(JUDGED):
        text = (
            f"{int(hits[:, :, j].sum())} of 20, error"
            f" {np.sqrt(np.nanmean(errors[:, :, j] ** 2)):.2f} kg RMS, interval ±"
            f" {np.nanmean(widths[:, :, j]):.2f} kg"
        )
        rows.append((f"mass within its interval {after:g} s after the pick", text))
    late = f"{1e3 * np.median(latencies):.0f} ms, at most {1e3 * max(latencies):.0f} ms"
    off = f"{1e3 * np.median(np.abs(instants)):.0f} ms median, at most"
    return [
        *rows,
        ("instant of the pick, error", f"{off} {1e3 * np.abs(instants).max():.0f} ms"),
        ("pick believed after", late),
        ("picks missed, further changes reported", f"{n_missed}, {n_extra} of 20"),
        ("false alarms without a load", f"{alarms} in {seconds:.0f} s"),
    ]


def simulated_update_times(estimate: Estimate) -> NDArray[np.float64]:
    """Time of each update at 1 kHz (3 runs, samples) [µs] while a load is picked up."""
    robot = estimate.robot
    t = np.arange(6000) * 1e-3
    trajectory = random_trajectory(robot, 3, 6.0)
    states = trajectory.states(t)
    tau = estimate.torque(Motion(t, *states))
    columns = robot.regressor(*states)[..., -10:]
    if estimate.model.gains is not None:
        columns = columns * np.array(estimate.model.gains)[:, None]
    payload = np.array([1.2, 0.02, 0.01, 0.12, 0.015, 0.0, 0.015, 0.0, 0.0, 0.002])
    tau += (t > 2.0)[:, None] * (columns @ payload)
    std = 0.01 * np.abs(tau).max(axis=0)
    tau += np.random.default_rng(0).normal(size=tau.shape) * std
    noise = ResidualNoise(std, 0.1, 1.0, np.abs(states[2]).max(axis=0))
    times = np.empty((3, len(t)))
    for repeat in range(len(times)):
        estimator = PayloadEstimator(estimate, noise, 1000.0)
        for k, sample in enumerate(zip(t, states[0], tau, strict=True)):
            begin = time.perf_counter()
            estimator.update(*sample)
            times[repeat, k] = 1e6 * (time.perf_counter() - begin)
    return times


def update_times(estimate: Estimate) -> list[tuple[str, str]]:
    """Time of an update at 1 kHz, simulated, and of the same work undisturbed: the
    shortest of three runs, update by update."""
    times = simulated_update_times(estimate)
    rows = []
    for name, of in (("all three runs", times), ("shortest of three", times.min(0))):
        cut = of[..., 200:]
        p50, p99 = np.percentile(cut, [50, 99])
        rows.append((f"update at 1 kHz, {name}", f"{p50:.0f} µs, p99 {p99:.0f} µs"))
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path)
    parser.add_argument("--out", type=Path, default=Path("results", "picks"))
    options = parser.parse_args()
    if options.data is not None:
        os.environ["SDP_VS_PENALTY_DATA"] = str(options.data)
    runs = {run.names[0][9:]: run for run in measured_runs("ur10e").values()}
    load = os.getloadavg()[0]
    rows = real_picks(runs) + update_times(model_of(runs, PAIRS[0]))
    rows.append(("load of the machine meanwhile", f"{load:.1f} on {os.cpu_count()}"))
    table = markdown_lines(("figure", "measured"), rows)
    text = "# A payload in the control loop\n\n" + "\n".join(table) + "\n"
    write_text(options.out / "picks.md", text)
    print(text)


if __name__ == "__main__":
    main()
