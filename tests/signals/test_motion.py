"""The record of a training motion: small, and near everything that it was made from."""

import json

import numpy as np
import pytest
from periodic_runs import JOINTS, SETTINGS, run_of

from sdp_vs_penalty import load_measurements, load_problem
from sdp_vs_penalty.data import concatenate
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.signals import motion
from sdp_vs_penalty.signals.motion import MotionRecord, record_motion


def share(train: Measurements, judged: Measurements) -> float:
    record = record_motion(train, SETTINGS)
    kept = MotionRecord.from_dict(json.loads(json.dumps(record.to_dict())))
    found = kept.new_share_of(judged, SETTINGS)
    assert found is not None
    return found


def test_what_has_been_trained_on_is_not_new():
    """Off the samples, at another rate, a period later; with a stand before it, of which only the
    sudden start is new."""
    once = run_of(10, 11.0)
    assert share(once, once) == 0.0
    assert share(once, run_of(11, 9.0, 0.3137)) == 0.0
    assert share(once, run_of(12, 9.0, 9.63 + 0.3137, dt=3.1e-3)) == 0.0
    assert share(once, run_of(13, 8.0, 1.0, still=4.0)) < 0.05
    assert share(run_of(14, 9.0, 1.0, still=4.0), run_of(15, 7.0, 1.1)) < 0.05
    both = concatenate([run_of(20, 9.0), once])
    assert share(both, run_of(16, 9.0, 0.9)) == 0.0


def test_other_motion_is_new():
    once = run_of(10, 11.0)
    assert share(once, run_of(20, 11.0)) > 0.9
    assert share(run_of(10, 5.0), run_of(11, 4.0, 5.2)) > 0.9
    assert share(run_of(10, 6.0), run_of(11, 6.0, 3.0)) == pytest.approx(
        3.0 / 4.7, abs=0.02
    )  # without 0.65 s at either end
    moved = run_of(11, 9.0)
    moved.q[:, 3] += 0.5  # the joint that stands, elsewhere
    assert share(once, moved) == 1.0
    slower = run_of(11, 11.0, period=20.0)  # the same positions, half as fast
    assert share(once, slower) > 0.8


@pytest.mark.real_data
def test_the_panda_repeats_itself_after_a_period(data_folder):
    """14.2-20.9 s are 0.9-7.6 s again; what lies between them is another motion."""
    problem = load_problem("panda")
    run = load_measurements(data_folder / "panda")
    settings = problem.preprocessing.resolve(run)
    for train, judged, new in (((0, 14), (14.2, 20.9), 0.0), ((0, 7.6), (8, 13.2), 1.0)):
        record = record_motion(run.window(*train), settings)
        assert record.new_share_of(run.window(*judged), settings) == pytest.approx(new, abs=0.01)


def test_the_record_is_bounded(monkeypatch):
    """Periods add nothing; much motion is kept more coarsely, and stays known, or not at all."""
    one, ten = (record_motion(run_of(10, s), SETTINGS) for s in (11.0, 96.0))
    assert ten.points < 1.5 * one.points
    rng = np.random.default_rng(3)
    wild = run_of(10, 120.0)
    smooth = np.convolve(rng.normal(size=len(wild.t) + 200), np.hanning(201), "valid")
    wild.q[:, 0] = smooth / smooth.std()
    monkeypatch.setattr(motion, "_MOST", 14_000)
    record = record_motion(wild, SETTINGS)
    assert 2 * JOINTS * record.points <= 14_000
    assert record.distance > motion.DISTANCE
    assert record.new_share_of(wild, SETTINGS) == 0.0
    monkeypatch.setattr(motion, "_MOST", 100)
    assert record_motion(wild, SETTINGS) is None
