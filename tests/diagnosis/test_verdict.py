"""What is left is told from noise, on the rows that are evidence."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from sdp_vs_penalty.diagnosis import HeldOut, Judged, reasons_for_doubt, remainder
from sdp_vs_penalty.diagnosis.conclude import least_help_of
from sdp_vs_penalty.diagnosis.doubts import Doubt
from sdp_vs_penalty.diagnosis.held_out import (
    ErrorChange,
    HeldOutSplit,
    JudgedRows,
    change_of,
    rows_by_stretch,
)
from sdp_vs_penalty.diagnosis.sizes import TorqueMade
from sdp_vs_penalty.signals import REPETITION

FLOOR = np.array([0.2, 3.0])
#: What is given, what is concluded, and why.
CASES = json.loads((Path(__file__).parents[1] / "data" / "verdicts.json").read_text())


def left(size, seed=0):
    """Data, fit, residual and events of two joints; on joint 1 a wave of this size
    beyond the noise."""
    rng = np.random.default_rng(seed)
    M = 1200
    white = rng.normal(size=(M, 2))
    white[:, 0] += size * np.sin(0.1 * np.arange(M))
    level = np.array([0.7, 1.4])
    Q = np.linalg.qr(rng.normal(size=(2 * M, 7)))[0].reshape(2, M, 7)
    fit = SimpleNamespace(
        residual=(white / level).T, level=level, leverage=np.sum(Q**2, axis=2)
    )
    keep = np.ones((M, 2), bool)
    none = np.zeros((M, 2))
    rows = SimpleNamespace(
        keep=keep, still=none, slides=keep.copy(), torque=10.0 * FLOOR * white
    )
    rows.encoder_error = none.copy()
    noise = SimpleNamespace(
        worth=np.ones((M, 2)),
        floor=FLOOR,
        source=REPETITION,
        degrees=np.full(2, 1000.0),
    )
    data = SimpleNamespace(rows=rows, noise=noise, noise_is_known=True)
    return data, fit, FLOOR * white, np.zeros((M, 2), bool)


@pytest.mark.parametrize(
    ("size", "change", "matters"),
    [
        (size, change, (*matters,))
        for size, change, matters, *_ in CASES["beyond the noise"]
    ],
)
def test_what_is_beyond_the_noise_matters(size, change, matters):
    data, fit, residual, none = left(size)
    data.noise_is_known = change.get("known", True)
    data.noise.degrees[:] = change.get("degrees", 1000.0)
    data.rows.slides[:, 0] = change.get("slides", True)
    data.rows.encoder_error[:, 0] = change.get("steps", 0.0)
    found = remainder(data, fit, residual, none)
    assert found.joints_unexplained == matters
    assert (
        found.joints_above_noise == (0,) or "degrees" not in change
    )  # a curve may show it all the same
    if not change:
        assert found.in_sample_excess_variance[0] == pytest.approx(
            size**2 / 2.0, abs=0.15
        )
    if matters:
        assert found.beyond[0] == pytest.approx(FLOOR[0] * size / np.sqrt(2.0), rel=0.1)


def test_events_are_left_out():
    data, fit, residual, ignore = left(0.0)
    fit.residual[0, :20] += 1e3
    ignore[:20, 0] = True
    assert remainder(data, fit, residual, ignore).joints_unexplained == ()


class Told(HeldOut):
    """Errors by a rule of the effects that are chosen, in the place of fits, whose every
    change has one spread."""

    def __init__(self, rule, spread=0.0):
        super().__init__(None, False, (), "folds")
        self.rule = rule
        self.spread = spread

    def change(self, before, after, judged, fitted=None):
        logs = [np.log(self.rule(frozenset(x))).sum() for x in (before, after)]
        return ErrorChange(logs[1] - logs[0], self.spread)

    def errors_by_recording(self, chosen):
        """One recording, unless the rule returns a row of errors for each."""
        return np.atleast_2d(self.rule(frozenset(chosen))).astype(float)

    def _is_told_by_sliding(self, judged):
        return True


@pytest.mark.parametrize(
    ("rule", "least_help", "kept"),
    [
        (lambda c: [1.0 - 0.3 * (0 in c), 1.0 + 0.05 * (1 in c)], {}, [0]),
        (lambda c: [1.0 - 0.3 * (0 in c), 1.0 + 0.01 * (1 in c)], {}, [0, 1]),
        (
            lambda c: [1.0 - 0.3 * (0 in c), 1.0 - 0.005 * (1 in c)],
            {0: 0.01, 1: 0.01},
            [0],
        ),  # the noise is a guess
        (
            lambda c: [1.0 - 0.005 * (0 in c), 1.0 - 0.005 * (1 in c)],
            {1: 0.01},
            [0],
        ),  # only the size of one may be zero
        (
            lambda c: [1.1 if c == {0} else 1.0 - 0.1 * len(c)],
            {},
            [0, 1],
        ),  # beside a later one
        (
            lambda c: [1.0 - 0.7 * (0 in c), 1.0 + 0.04 * (0 in c)],
            {},
            [0, 1],
        ),  # repaid elsewhere
        (
            lambda c: [1.0 - 0.1 * bool(c) + 0.1 * (1 in c)],
            {},
            [0],
        ),  # the least useful one goes
    ],
)
def test_what_raises_errors_beside_all_others_is_not_offered(rule, least_help, kept):
    assert Told(rule).drop_harmful(range(2), least_help) == kept


@pytest.mark.parametrize(
    ("here", "elsewhere", "doubted", "kept"),
    [
        (1.02, 0.7, {}, [0, 1]),
        (1.02, 1.0, {}, [0]),
        (0.99, 1.0, {}, [0, 1]),
        pytest.param(0.99, 0.99, {1}, [0], id="help within its spread"),
        pytest.param(0.99, 0.9, {1}, [0, 1], id="help beyond it on one of both"),
        pytest.param(1.01, 0.9, {1}, [0], id="help on one of both"),
    ],
)
def test_what_is_doubted_has_to_help_on_both_motions(here, elsewhere, doubted, kept):
    held_out = Told(
        lambda c: [(1.0 - 0.3 * (0 in c)) * (here if 1 in c else 1.0)], spread=0.02
    )
    held_out.make_second = lambda: Told(lambda c: [elsewhere if 1 in c else 1.0])
    assert held_out.drop_harmful(range(2), {}, doubted) == kept


def test_help_has_a_spread_between_stretches():
    """Two joints' errors fall by a tenth in every stretch, or in one of eight."""
    before = np.ones((8, 2))
    everywhere = change_of(before, 0.81 * before)
    assert everywhere.rise == pytest.approx(2.0 * np.log(0.9))
    assert everywhere.spread < 1e-9
    once = before.copy()
    once[3] = 0.1
    assert -change_of(before, once).rise < change_of(before, once).spread
    assert np.isinf(change_of(before[:1], once[:1]).spread)


@pytest.mark.parametrize(
    ("rule", "floor", "kept"),
    [
        # What raises one joint's error, and no other effect repays it.
        (lambda c: [1.0 - 0.7 * (0 in c), 1.0 + 0.06 * (1 in c)], 0.0, [0]),
        (lambda c: [1.0 - 0.7 * (0 in c), 1.0 + 0.04 * (1 in c)], 0.0, [0, 1]),
        # It is repaid by what the same effect does to another joint,
        (lambda c: [1.0 - 0.7 * (1 in c), 1.0 + 0.06 * (1 in c)], 0.0, [0, 1]),
        # but not in another recording, or in the rows fitted to.
        (lambda c: [[1.0 - 0.7 * (0 in c)], [1.0 + 0.06 * (0 in c)]], 0.0, [1]),
        # Each by itself lowers what both together raise.
        (lambda c: [1.0 + 0.2 * bool(c) - 0.02 * len(c)], 0.0, []),
        # What stays within the noise has not risen.
        (lambda c: [1.0 - 0.7 * (0 in c), 1.0 + 0.06 * (1 in c)], 1.02, [0, 1]),
    ],
)
def test_what_raises_one_joints_error_by_a_twentieth_goes(rule, floor, kept):
    """Folds of the training motion do not excuse it."""
    held_out = Told(rule)
    held_out.make_second = lambda: Told(lambda c: [1.0 - 0.5 * len(c)] * 2)
    assert held_out.drop_harmful_to_a_joint([0, 1], np.full(1, floor)) == kept


@pytest.mark.parametrize(
    ("rule", "elsewhere", "added"),
    [
        (lambda c: [1.0 - 0.3 * (0 in c), 1.0], 0.9, [0]),
        pytest.param(lambda c: [1.0 - 0.04 * (0 in c), 1.0], 0.97, [], id="too little"),
        pytest.param(lambda c: [1.0 - 0.04 * (0 in c), 1.0], 0.9, [0], id="elsewhere"),
        pytest.param(
            lambda c: [1.0 - 0.055 * (0 in c), 1.0], 0.95, [], id="within the spread"
        ),
        pytest.param(
            lambda c: [1.0 - 0.3 * (0 in c), 1.0], 1.01, [], id="nothing elsewhere"
        ),
        pytest.param(
            lambda c: [1.0 - 0.7 * (0 in c), 1.0 + 0.06 * (0 in c)],
            0.9,
            [],
            id="harm to a joint, whatever another gains",
        ),
        pytest.param(
            lambda c: [0.7 if len(c) == 2 else 1.0 + 0.1 * len(c)],
            0.9,
            [0, 1],
            id="two that help together alone",
        ),
        pytest.param(
            lambda c: [0.96 if len(c) == 2 else 1.0 + len(c)],
            0.97,
            [],
            id="two that cancel, and help by less than one should",
        ),
    ],
)
def test_what_is_in_doubt_is_added_where_it_helps_alone_or_in_pairs(
    rule, elsewhere, added
):
    held_out = Told(rule, spread=0.06)
    held_out.make_second = lambda: Told(lambda c: [elsewhere if c else 1.0])
    assert held_out.with_helpful([], [0, 1], np.zeros(1)) == added


@pytest.mark.parametrize(
    ("reasons", "least"),
    [
        ((), 0.01),
        (("rivals", "insignificant"), 0.01),
        (("sticks", "uncertain"), 0.05),
        (("sticks", "insignificant"), np.inf),
        (("at_end",), np.inf),
    ],
)
def test_the_more_a_torque_is_in_doubt_the_more_it_has_to_help(reasons, least):
    doubts = tuple(map(Doubt, reasons))
    finding = SimpleNamespace(
        doubts=doubts, has_open_torque=any(d.leaves_torque_open for d in doubts)
    )
    assert least_help_of(finding) == least


def test_a_torque_of_sliding_is_judged_where_joints_slide(monkeypatch):
    """Friction that sticks makes 5 N m of error in rows that say nothing of a spring,
    nor of friction that rubs at speed; of a Stribeck dip (the last) they alone do."""
    kinds = [("", False), ("turns", True), ("", True), ("", True)]
    effects = [
        SimpleNamespace(at_rest=at_rest, is_dry_friction=is_dry, parameters=[0])
        for at_rest, is_dry in kinds
    ]
    #: Squared error of the rows, and norms of the effects' columns and the torque.
    regressions = {
        "all": (25.0, [1.0, 1.0, 1.0, 1.0, 9.0]),
        "sliding": (1.0, [0.1, 0.9, 0.8, 0.1, 7.0]),
    }

    def of_rows(rows):
        squares, norms = regressions[rows]
        return SimpleNamespace(
            column_norms=lambda: np.array([norms]), squares=squares, rows=rows
        )

    one_row = JudgedRows(np.ones((1, 1, 6)), np.ones((1, 3, 1)))
    split = HeldOutSplit(
        tuple(effects), of_rows("all"), of_rows("sliding"), (one_row,), False
    )
    held_out = HeldOut(None, False, [split], "test")
    fitted = []

    def squares_of_fit(self, chosen, sliding, fitted_by):
        fitted.append(split.fitted_rows(sliding).rows)
        rows = split.train, split.sliding, split.sliding
        return np.array([[[x.squares ** len(chosen)] for x in rows]])

    monkeypatch.setattr(HeldOut, "_squares", squares_of_fit)
    rises = [held_out.change([], [0], k).rise for k in range(4)]
    np.testing.assert_allclose(np.exp(rises), [1.0, 5.0, 1.0, 5.0])
    assert fitted[::2] == fitted[1::2] == ["sliding", "all", "sliding", "all"]


@pytest.fixture
def two_recordings(monkeypatch):
    """Errors of two joints on two folds of two recordings of five rows, one of which is
    left out on joint 2; and squared errors (10, 2) without and with effect 0."""
    keep = np.ones((10, 2), bool)
    keep[1, 1] = False
    slides = keep & (np.arange(10) % 5 != 2)[:, None]
    stretches, n_stretches = rows_by_stretch(
        SimpleNamespace(run=np.repeat([3, 7], 5), keep=keep)
    )
    assert n_stretches == 4
    counted = [np.flatnonzero(x[:, 0]).tolist() for x in stretches]
    assert counted == [[0, 1], [2], [3], [4], [5, 6], [7], [8], [9]]
    assert np.flatnonzero(stretches[0][:, 1]).tolist() == [0]
    fold = (np.arange(10) % 2)[:, None]
    rows_of_splits = [
        [
            *(x & (fold == f) for x in stretches),
            *(x & (fold == f) & slides for x in stretches),
            slides & (fold != f),
        ]
        for f in (0, 1)
    ]
    splits = [
        HeldOutSplit((), None, None, (JudgedRows.from_masks(None, rows),), False)
        for rows in rows_of_splits
    ]
    squares = np.random.default_rng(0).uniform(1.0, 2.0, (2, 10, 2))

    def sums(self, chosen, sliding, fitted=None):
        own = squares[len(chosen)]
        return np.array([[(own * x).sum(axis=0) for x in xs] for xs in rows_of_splits])

    monkeypatch.setattr(HeldOut, "_squares", sums)
    monkeypatch.setattr(HeldOut, "_acts_in_slow_rows", [True])
    held_out = HeldOut(None, False, splits, "folds", n_stretches)
    return held_out, squares, keep, slides


def test_errors_by_recording_are_of_all_its_stretches_and_folds(two_recordings):
    held_out, squares, _, slides = two_recordings
    for chosen in ([], [0]):
        own = np.where(slides, squares[len(chosen)], np.nan)
        parts = own[:5], own[5:], own  # each row is fitted to in one of two folds
        expected = [np.sqrt(np.nanmean(x, axis=0)) for x in parts]
        np.testing.assert_allclose(held_out.errors_by_recording(chosen), expected)


def test_a_change_has_a_spread_on_a_test_run_alone(two_recordings):
    held_out, squares, keep, _ = two_recordings
    before, after = (squares * keep).sum(axis=1)
    rises = 0.5 * np.log(after / before)
    on_folds = held_out.change([], [0], 0)
    assert on_folds.rise == pytest.approx(rises.sum())
    assert on_folds.spread == 0.0
    of_one = held_out.change([], [0], 0, joints=[1])
    assert of_one.rise == pytest.approx(rises[1])
    on_test = replace(held_out, source="test").change([], [0], 0)
    assert on_test.rise == on_folds.rise
    assert np.isfinite(on_test.spread)
    assert on_test.spread > 0.0


#: What is changed of a finding that nothing speaks against, and what then does.
DOUBTS = [(change, set(doubts)) for change, doubts, *_ in CASES["doubts"]]


@pytest.mark.parametrize(("change", "doubts"), DOUBTS)
def test_each_doubt_about_a_finding_has_a_ground_of_its_own(
    change, doubts, monkeypatch
):
    usual = {
        "rivals": (),
        "std": 0.19,
        "torque_std": 0.49,
        "J": 20.1,
        "looks_like": "",
        "at_rest": "",
        "stand_in": False,
    }
    case = SimpleNamespace(**{**usual, "replaced": False, **change})

    effect = SimpleNamespace(
        joints=(0,), resembles=(), is_stand_in=case.stand_in, at_rest=case.at_rest
    )
    effect.looks_like = lambda size, seen: case.looks_like
    form = SimpleNamespace(effect=effect)
    own = SimpleNamespace(form=form, joints={0}, evidence=case.J, rivals=case.rivals)
    rows = SimpleNamespace(coverage=lambda joint: None)
    search = SimpleNamespace(data=SimpleNamespace(rows=rows))
    curves = [SimpleNamespace(replaced=(own,) * case.replaced)]
    monkeypatch.setattr(
        "sdp_vs_penalty.diagnosis.confidence.size_of", lambda *_: (1.0, case.std)
    )
    size = SimpleNamespace(
        beta=np.array([1.9]),
        covariance=None,
        covariance_given_constants=None,
        torque=TorqueMade(0, 1.0, case.torque_std),
    )
    judged = Judged(search, own, size, curves)
    assert {doubt.reason for doubt in reasons_for_doubt(judged)} == doubts
