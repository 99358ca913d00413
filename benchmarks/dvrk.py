"""The dVRK PSM by the metric of Wang et al. (RA-L 2019): python benchmarks/dvrk.py TRAIN.csv TEST.csv

TRAIN.csv, TEST.csv : their measured trajectories (WPI-AIM/dvrk_dynamics_identification), 200 Hz, no
header: q1..q7, dq1..dq7, tau1..tau7 in motor coordinates. Identified with the problem dvrk_psm, judged
as they judge: zero-phase Butterworth of order 6 (their "5.4 Hz" is 17 Hz in effect, because the angular
frequency is given where the filter wants a share of the Nyquist frequency), 200 samples cut at both
ends, the measured torque filtered and the prediction not, |tau - tau_hat| / |tau| of each joint over
the first period of 1 / 0.18 s. Acceleration is the five-point difference of the measured velocity.
With --diagnose, once more with what the diagnosis of TRAIN finds to be missing.
"""

from __future__ import annotations

import argparse

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from sdp_vs_penalty import add, diagnose, identify
from sdp_vs_penalty.data.headerless_tables import read_headerless
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.estimation.estimate import Estimate

Array = NDArray[np.float64]

RATE, CUT_OFF, ORDER, CUT, PERIOD = 200.0, 5.4, 6, 200, 1.0 / 0.18
#: The authors' own SDP (their Table III).
AUTHORS = (0.093, 0.178, 0.191, 0.134, 0.239, 0.213, 0.264)


def filtered(values: Array) -> Array:
    """(N, n) their zero-phase low-pass."""
    b, a = signal.butter(ORDER, CUT_OFF * 2.0 * np.pi / RATE)
    return np.asarray(signal.filtfilt(b, a, values, axis=0))


def relative_errors(estimate: Estimate, run: Measurements) -> Array:
    """(n,) |tau - tau_hat| / |tau| as they compute it."""
    assert run.dq is not None
    ddq_raw = np.gradient(run.dq, 1.0 / RATE, axis=0)
    far, near = run.dq[4:] - run.dq[:-4], run.dq[3:-1] - run.dq[1:-3]
    ddq_raw[2:-2] = (8.0 * near - far) * RATE / 12.0
    q, dq, ddq, tau = (filtered(x) for x in (run.q, run.dq, ddq_raw, run.tau))
    predicted = estimate.model.torque(estimate.theta, Motion(run.t, q, dq, ddq))
    window = slice(CUT, CUT + round(PERIOD * RATE))
    left = np.linalg.norm((tau - predicted)[window], axis=0)
    return np.asarray(left / np.linalg.norm(tau[window], axis=0))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("train")
    parser.add_argument("test")
    parser.add_argument("--effects", help="effects instead of the problem's")
    parser.add_argument("--diagnose", action="store_true", help="and with what TRAIN shows missing")
    given = parser.parse_args()
    train, test = (read_headerless(path, RATE) for path in (given.train, given.test))
    estimate = identify("dvrk_psm", train, effects=given.effects)
    table(estimate, test)
    if given.diagnose:
        found = diagnose(estimate, train)
        print(found)
        if found.effects or found.retuned or found.curves:
            table(add(estimate, found, train), test)


def table(estimate: Estimate, test: Measurements) -> None:
    """Prints each joint's error beside the authors'."""
    ours = relative_errors(estimate, test)
    print("joint   ours   Wang et al.")
    for j, (mine, theirs) in enumerate(zip(ours, AUTHORS, strict=True)):
        print(f"{j + 1}      {mine:.3f}  {theirs:.3f}")
    print(f"mean   {ours.mean():.4f}  {np.mean(AUTHORS):.4f}")


if __name__ == "__main__":
    main()
