"""A weighed load gives the torque channels' gains, and gains that are known badly widen
intervals."""

from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from unchecked import identify

from sdp_vs_penalty import Measurements, add, diagnose, load_estimate, load_problem
from sdp_vs_penalty.problem import measured_runs
from sdp_vs_penalty.robot import inertia, random_trajectory

GAIN = np.array([0.92, 1.07, 0.9])
LOAD = inertia.standard_from_barycentric(
    [1.5, 0.05, -0.02, 0.1, 0.004, 0, 0.003, 0, 0, 0.005]
)


@pytest.fixture(scope="module")
def arm():
    return load_problem(str(Path(__file__).parents[2] / "docs" / "my_arm.urdf"))


def measured(arm, seed, load, gain=GAIN):
    """Torque channels that read ``gain`` times the truth, with ``load`` times LOAD on
    the flange. Their noise is 2 % of the bare arm's torque: no load makes them louder.
    """
    t = np.arange(0.0, 20.0, 0.01)
    q, dq, ddq = random_trajectory(arm.robot, seed=seed, duration=20.0).states(t)
    friction = 0.5 * dq + 0.8 * np.tanh(dq / 0.01) + 0.2
    bare = arm.nominal_links
    loaded = bare.copy()
    loaded[-1] += load * LOAD
    bare_torque = arm.robot.inverse_dynamics(bare, q, dq, ddq) + friction
    tau = arm.robot.inverse_dynamics(loaded, q, dq, ddq) + friction
    noise = np.random.default_rng(seed).normal(size=tau.shape)
    return Measurements(
        t,
        q,
        gain * (tau + 0.02 * bare_torque.std(axis=0) * noise),
        names=(f"run {seed}",),
    )


@pytest.fixture(scope="module")
def weighed(arm):
    """The arm, with gains from one known load, and with gains from two."""
    loads = [(measured(arm, 2, 1.0), 1.5), (measured(arm, 4, 2.0), 3.0)]
    return [
        identify(arm, measured(arm, 1, 0.0), "ols", known_loads=loads[:k])
        for k in (0, 1, 2)
    ]


def gains(estimate):
    """Gains of the joints' channels, and their standard deviations."""
    return (np.array(estimate.details["gains"][x]) for x in ("gain", "std"))


def test_a_known_load_gives_gains_and_links(arm, weighed):
    gain, std = gains(weighed[1])
    assert np.all(np.abs(gain - GAIN) < 4.0 * std)
    assert np.all(std < 0.1 * GAIN)
    truth = arm.nominal_links.ravel()
    for interval, true in zip(weighed[1].uncertainty.standard, truth, strict=False):
        if np.isfinite(interval.std):
            assert abs(interval.value - true) < 4.0 * interval.std, interval


def test_two_known_loads_give_finer_gains(weighed):
    (_, std), (both, finer) = map(gains, weighed[1:])
    assert np.all(np.abs(both - GAIN) < 4.0 * finer)
    assert np.all(finer < 0.8 * std)


@pytest.mark.long
def test_a_known_load_weighs_another_load(arm, weighed, tmp_path):
    other = measured(arm, 3, 0.6)  # 0.9 kg
    weighed[1].save(tmp_path / "model.json")
    kept = load_estimate(tmp_path / "model.json")
    with_load = add(kept, "payload", other)
    mass = with_load.uncertainty.standard[len(kept.theta)]
    assert mass.name == "payload_m"
    assert mass.lower < 0.9 < mass.upper
    assert mass.std < 0.05
    found = diagnose(kept, other, frozen=True).effects
    assert [f.effect for f in found] == ["payload"]
    assert abs(found[0].size - 0.9) < 4.0 * found[0].std
    in_doubt = kept.with_gain_uncertainty(0.1)
    (doubted,) = diagnose(in_doubt, other, frozen=True).effects
    assert doubted.std > 1.5 * found[0].std
    # As the channels stand, the same load weighs something else, and its interval does
    # not know.
    naive = add(weighed[0], "payload", other).uncertainty.standard[len(kept.theta)]
    assert not naive.lower < 0.9 < naive.upper


def test_gains_known_to_a_per_cent_widen_the_intervals(arm, tmp_path):
    """All gains 1 % too high make a load 1 % heavier; the stated spread is that of
    independent ones."""
    loaded = measured(arm, 3, 1.0, np.ones(3))
    estimate = identify(arm, measured(arm, 1, 0.0, np.ones(3)), "ols")
    plain = add(estimate, "payload", loaded)
    wide = add(estimate.with_gain_uncertainty(0.01), "payload", loaded)
    k = len(estimate.theta)
    added = np.sqrt(
        wide.uncertainty.standard[k].std ** 2 - plain.uncertainty.standard[k].std ** 2
    )  # kg
    assert 0.003 < added < 0.05
    # The response to all gains together is the parameters themselves.
    together = wide.uncertainty.gain_response.sum(axis=1)
    assert together[k] == pytest.approx(wide.theta[k], rel=0.05)
    friction = [
        i for i, p in enumerate(estimate.model.parameters) if p.name.startswith("f_")
    ]
    assert_allclose(together[friction], estimate.theta[friction], rtol=1e-6)
    # The parameters that are kept know it as well, and so does whoever reads the file.
    assert np.all(wide.uncertainty.std[friction] > plain.uncertainty.std[friction])
    wide.save(tmp_path / "wide.json")
    again = load_estimate(tmp_path / "wide.json")
    assert_array_equal(again.covariance, wide.covariance)
    assert_allclose(
        np.sqrt(np.diagonal(wide.covariance)), wide.uncertainty.std, rtol=1e-9
    )


@pytest.mark.long
@pytest.mark.real_data
def test_the_load_of_the_real_ur10e():
    """Gains from one loaded run weigh the same load in another run: 2.805 kg, where the
    authors' drive gains make it 2.34 and 2.48."""
    runs = {r.names[0][9:]: r for r in measured_runs("ur10e").values()}
    for first, second in (("14", "15"), ("15", "14")):
        loads = [(runs[f"19_{first}harm50secLoad"], 2.805)]
        estimate = identify(
            "ur10e", runs[f"19_{first}harm50sec"], "ols", known_loads=loads
        )
        found = add(estimate, "payload", runs[f"19_{second}harm50secLoad"])
        mass = found.uncertainty.standard[len(estimate.theta)]
        assert mass.lower < 2.805 < mass.upper
        assert mass.std < 0.1
