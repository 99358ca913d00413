"""What a finding's rating says: an effect may be sure while its law is not, and a size
that is not told from zero is never sure."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import sdp_vs_penalty as sdp
from sdp_vs_penalty.api.diagnosis import _beside_check
from sdp_vs_penalty.api.remedies import next_remedy
from sdp_vs_penalty.checks.certainty import likely
from sdp_vs_penalty.checks.issue import make_explanation
from sdp_vs_penalty.data import datasets
from sdp_vs_penalty.diagnosis import (
    Diagnosis,
    Finding,
    effect_of,
    largest_sums,
    size_in_model,
    size_of,
    std_of_both,
)
from sdp_vs_penalty.diagnosis.diagnosis_data import ErrorWith
from sdp_vs_penalty.diagnosis.doubts import Doubt
from sdp_vs_penalty.diagnosis.finding import Retune
from sdp_vs_penalty.diagnosis.own_constants import retune
from sdp_vs_penalty.diagnosis.passing.cause import PassingCause, PassingLaw, Span
from sdp_vs_penalty.effects import effect_types
from sdp_vs_penalty.effects.written import read_effect
from sdp_vs_penalty.estimation import ShapeEstimate
from sdp_vs_penalty.render.diagnosis_words import helped_by, main_cause, place_in_files
from sdp_vs_penalty.render.words import (
    describe_advice,
    describe_diagnosis,
    errors_that_rise,
    parts_of,
)
from sdp_vs_penalty.results import Certainty
from sdp_vs_penalty.signals import REPETITION


def finding(effect, joint, *rivals, **changes):
    """A finding about one joint (from 1); a near-tie where it has rivals."""
    known = {
        "effect": effect,
        "joints": (joint,),
        "shape": {},
        "size": 1.0,
        "unit": "N m",
        "std": 0.1,
        "parameters": {},
        "rivals": tuple(map(read_effect, rivals)),
        "main_joint": joint,
        "physics": "",
        "text": f"{effect}:{joint}",
        "gain": 50.0,
        "doubts": (Doubt("rivals"),) if rivals else (),
    }
    return Finding(**known | changes)


def diagnosis(*findings, before=2.0, after=1.0):
    """Of a run whose noise is known; errors before and after each finding alone are
    numbers, or (7,), ``after`` by the effect's name too [N m or N]."""
    errors = [
        after.get(f.effect, 1.0) if isinstance(after, dict) else after for f in findings
    ]
    return Diagnosis(
        verdict="effect_missing",
        effects=findings,
        noise_floor=np.ones(7),
        invisible=(),
        noise_source=REPETITION,
        unexplained=np.zeros(7),
        band_hz=8.0,
        remarks=(),
        held_out_rmse_before=np.full(7, before),
        held_out_source="test",
        frozen=False,
        errors_with=tuple(
            ErrorWith((f.text,), np.full(7, error))
            for f, error in zip(findings, errors, strict=True)
        ),
    )


def with_more_errors(found, *errors):
    """A diagnosis in which more selections were judged."""
    return replace(found, errors_with=(*found.errors_with, *errors))


def test_a_set_of_what_is_added_has_its_errors_once_in_whatever_order():
    found = diagnosis().with_errors({("a", "b"): np.ones(7), ("a",): np.ones(7)})
    found = found.with_errors({("b", "a"): np.zeros(7)})
    assert [x.effects for x in found.errors_with] == [("b", "a"), ("a",)]
    np.testing.assert_equal(found.error_with(["a", "b"]), np.zeros(7))
    np.testing.assert_equal(found.error_with(["a"]), np.ones(7))


@pytest.mark.parametrize(
    ("effect", "rivals", "is_certain"),
    [
        ("presliding_hysteresis", (), True),
        ("presliding_hysteresis", ("maxwell_slip",), True),
        ("maxwell_slip", ("presliding_hysteresis:7@d=0.002",), True),
        ("presliding_hysteresis", ("stiction",), True),
        ("presliding_hysteresis", ("external_wrench", "maxwell_slip"), False),
        ("joint_spring", ("base_tilt",), False),
    ],
)
def test_an_effect_is_certain_where_only_its_law_is_open(effect, rivals, is_certain):
    assert finding(effect, 7, *rivals).effect_is_certain == is_certain


@pytest.mark.parametrize(
    ("reasons", "effect", "torque"),
    [
        ("rivals", True, True),
        ("uncertain", True, True),
        ("more_left", False, True),
        ("insignificant", False, True),
        ("looks_like", False, False),
        ("insignificant no_torque", False, False),
        ("at_end", False, False),
        ("small", False, False),
        ("small_here", False, True),
        ("stand_in", False, False),
        ("rivals small", False, False),
        ("alone", False, False),
        ("rivals sticks helps", False, True),
        ("sticks helps log", False, False),
    ],
)
def test_an_effect_or_its_torque_may_be_certain_and_name_or_size_not(
    reasons, effect, torque
):
    helps, names = "helps" in reasons, reasons.replace("helps", "").split()
    doubts = {"doubts": tuple(map(Doubt, names))}
    doubted = finding("joint_spring", 2, helps=helps, **doubts)
    assert (doubted.effect_is_certain, doubted.torque_is_certain) == (effect, torque)


def test_a_doubt_of_another_version_is_read_and_its_finding_is_not_added():
    doubts = (Doubt("rivals"), Doubt("by_itself"))
    weak = finding("joint_spring", 2, doubts=doubts, helps=True)
    saved = diagnosis(finding("backlash", 1), weak).to_dict()
    read = Diagnosis.from_dict(saved)
    assert [f.text for f in read.helpful] == [read.effects[0].text]
    said = describe_diagnosis(read, ["N m"] * 7).findings[1].doubt
    assert "another version of this program doubted it ('by_itself')" in said


def test_rivals_of_older_findings_which_are_texts_are_read():
    """Those of what acts for a time too; that a curve explains more, a doubt says."""
    curve = (Doubt("rivals"), Doubt("curve"))
    rivals = ("backlash:3@w=0.01", "base_tilt")
    found = diagnosis(finding("backlash", 2, *rivals, doubts=curve))
    span = (Span("run1", 1.0, 2.0),)
    cause = PassingCause(
        "load", 7, 1.0, 0.1, "kg", (), (), span, 0.9, 50.0, (PassingLaw("force", 3),)
    )
    found = replace(found, passing=(cause,))
    older = found.to_dict()
    (first,), (passing,) = older["effects"], older["passing"]
    del first["rivals"]
    first["indistinguishable_from"] = [*rivals, "measured_curve"]
    passing["rivals"] = ["force:3"]
    read = Diagnosis.from_dict(older)
    assert read.to_dict() == found.to_dict()
    words = "backlash on joint 3 (w 0.01); base tilt; measured curve"
    assert read.effects[0].rivals_in_words == words
    assert read.passing[0].sentence.endswith(
        "; a constant force on link 3 would explain as much"
    )


def test_errors_of_older_findings_are_read_as_the_ladder():
    """Each finding had the errors before and after it joined those before it."""
    tilt, spring = finding("base_tilt", 3, joints=()), finding("joint_spring", 2)
    with_tilt, with_both = np.full(7, 1.5), np.full(7, 1.0)
    with_tilt[2] = 0.5
    found = replace(
        diagnosis(tilt, spring),
        errors_with=(
            ErrorWith((tilt.text,), with_tilt),
            ErrorWith((tilt.text, spring.text), with_both),
        ),
    )
    steps = [found.held_out_rmse_before.tolist(), with_tilt.tolist()]
    steps.append(with_both.tolist())
    assert [errors.tolist() for errors in found.ladder] == steps
    older = found.to_dict()
    del older["errors_with"]
    older["held_out_rmse"] = steps[-1]
    for k, entry in enumerate(older["effects"]):
        del entry["main_joint"]
        before, after = steps[k : k + 2]
        entry |= {"held_out_rmse_before": before, "held_out_rmse_after": after}
    read = Diagnosis.from_dict(older)
    assert [errors.tolist() for errors in read.ladder] == steps
    assert [f.main_joint for f in read.effects] == [3, 2]
    assert [x.tolist() for x in read.errors_of(read.effects[1])] == steps[1:]


def test_a_size_whose_interval_holds_zero_is_not_called_sure():
    """The evidence does not count it for the finding."""
    helps = finding("joint_spring", 2, std=0.7, helps=True)
    found = diagnosis(finding("backlash", 1), helps)
    assert found.remedies[0].change.words == "add backlash on joint 1"
    assert found.offers[1].change.words == (
        "add backlash on joint 1 and joint spring on joint 2"
    )
    known, unknown = (
        words.evidence for words in describe_diagnosis(found, ["N m"] * 7).findings
    )
    size, not_told = (
        "Size 1 ± 0.2 N m (95 %): known to 20 %.",
        "Its size is not told from zero.",
    )
    assert (size, True) in known
    assert (not_told, False) in unknown
    assert not any(text == not_told for text, _ in known)
    assert not any(text.startswith("Size ") for text, _ in unknown)
    assert any(text.startswith("That a torque ") for text, _ in known)
    assert not any(text.startswith("That a torque ") for text, _ in unknown)


def test_what_is_confident_is_read_first_and_what_is_within_the_noise_last():
    """Whatever the evidence; the numbers of `add` stay those of the list."""
    doubted = finding("joint_spring", 1, "backlash", gain=900.0)
    small = finding("stiction", 3, gain=800.0)
    sure = finding("backlash", 2)
    said = diagnosis(doubted, small, sure, before=[3.0, 3.0, *[2.0] * 5])
    assert [f.number for f in said.offers.in_order_of_reading] == [3, 1, 2]
    assert main_cause(said).startswith("Joint 2 errs: backlash (confident)")
    assert said.offers.main.change.words == "add backlash on joint 2"
    assert "Some error is left: stiction" in main_cause(diagnosis(small))


def test_a_near_tie_is_added_with_the_constants_that_are_confident():
    """Alone it left the rest to a second diagnosis, which did not find it again."""
    tie = finding("stribeck_friction", 3, "torque_gain")
    shape = ShapeEstimate("coulomb_friction", 3, "v_s", 0.01, 0.02)
    fall = {"rmse_before": 0.2, "rmse_after": 0.1, "explanation": "it is wider"}
    constant = Retune(**vars(shape), **fall)
    errors = (ErrorWith((tie.text, constant.text), np.full(7, 1.0)),)
    found = with_more_errors(diagnosis(tie, before=3.0), *errors)
    found = replace(found, retuned=(constant,))
    assert found.offers.main_finding == tie
    assert found.offers.main.change.arguments["findings"] == "helpful"


def test_what_lowers_the_worst_joint_most_is_read_first():
    """A confident finding that lowers nothing by itself comes last, and has no button of
    its own."""
    errors = np.array([9.0, 4.0, 3.0, 3.0, 3.0, 3.0, 3.0])
    on_worst = errors - [4.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    likely = finding("joint_spring", 1, "backlash")
    other = errors - [0.0, 3.0, 0.0, 0.0, 0.0, 0.0, 0.0]
    second, useless = finding("backlash", 2), finding("stiction", 3)
    after = {"joint_spring": on_worst, "backlash": other, "stiction": 1.01 * errors}
    found = diagnosis(useless, second, likely, before=errors, after=after)
    texts = tuple(f.text for f in found.effects)
    found = with_more_errors(found, ErrorWith(texts, np.full(7, 1.0)))
    assert [f.effect for f in found.offers.in_order_of_reading] == [
        "joint_spring",
        "backlash",
        "stiction",
    ]
    assert found.offers.main == found.remedies[0]
    assert found.offers.main.change.arguments["findings"] == "helpful"


def test_what_is_advised_harms_no_joint_and_leaves_the_lowest_errors():
    """By the errors on data left out; of two that do as much the surer, smaller one."""
    tie = finding("joint_spring", 1, "backlash")
    other = finding("backlash", 2, "joint_spring")
    better, half, harm = np.full(7, 3.0), np.full(7, 3.0), np.zeros(7)
    better[:2], half[0], harm[2] = 1.0, 1.5, 1.0

    def advised(alone, together):
        errors = {(tie.text,): alone, (tie.text, other.text): together}
        errors[(other.text,)] = np.full(7, 3.0)
        found = diagnosis(tie, other, before=3.0).with_errors(errors)
        assert found.remedies[0] == found.offers.main
        return found.offers.main.change.arguments["findings"]

    assert advised(half, better) == "helpful"
    assert advised(half + harm, better) == "helpful"
    assert advised(half, better + harm) == [1]
    assert advised(half, half) == [1]


def test_nothing_is_advised_where_all_that_was_found_raises_an_error():
    """Terminal and report say which errors rise, and no command adds it; a finding that
    harms nothing and helps is advised alone."""
    tie = finding("joint_spring", 1, "backlash")
    other = finding("backlash", 2, "joint_spring")
    harm = np.full(7, 3.0)
    harm[[0, 4]] = 1.0, 6.0
    errors = {(x.text,): harm for x in (tie, other)}
    errors[(tie.text, other.text)] = harm
    found = diagnosis(tie, other, before=3.0).with_errors(errors)
    assert found.offers.main is None
    assert found.offers.choices == ()
    assert not any(offer.is_advisable for offer in found.offers)
    assert next_remedy(found.remedies) is None
    assert describe_advice(found) == ""
    words = describe_diagnosis(found, ["N m"] * 7)
    assert "Nothing found is advised to be added" in words.advice
    assert "joint 5's +100 %" in words.advice
    lower = np.full(7, 3.0)
    lower[1] = 1.0
    helped = found.with_errors({**errors, (other.text,): lower})
    assert helped.offers.main.change.arguments["effects"] == [other.text]
    assert next_remedy(helped.remedies) == helped.offers.main
    assert helped.offers.choices == (helped.offers.main,)


def test_what_lowers_no_error_is_not_counted_among_what_helps():
    """It was one of "the 5 that help": confident, while adding it changed nothing. Where
    the others do worse without it, it helps beside them and is counted."""
    before = np.full(7, 3.0)
    one, two, idle = (finding("backlash", joint) for joint in (1, 2, 3))
    errors = {(x.text,): before - 2.0 * np.eye(7)[j] for j, x in enumerate((one, two))}
    errors[(idle.text,)] = before
    found = diagnosis(one, two, idle, before=3.0).with_errors(errors)
    assert found.offers.selections_of_shown == [(one, two)]
    without = before - 2.0 * (np.eye(7)[0] + np.eye(7)[1])
    texts = tuple(x.text for x in found.helpful)
    errors |= {texts: without, texts[:2]: without}
    counted = found.with_errors(errors)
    assert counted.offers.helping == (one, two)
    assert counted.offers.main.change.arguments["effects"] == [one.text, two.text]
    assert counted.offers.main.change.arguments["findings"] == [1, 2]
    assert main_cause(counted) == (
        "Joint 1 errs: backlash (confident); also backlash on joint 2."
    )
    needed = found.with_errors({**errors, texts: 0.9 * without})
    assert needed.offers.helping == needed.helpful
    assert needed.offers.main.change.arguments["findings"] == "helpful"


def test_each_that_an_offer_counts_is_listed_once():
    """Its joint, its name, what it does, and how sure it is."""
    tie = finding("joint_spring", 1, "backlash")
    found = diagnosis(tie, finding("backlash", 2), before=3.0)
    shape = ShapeEstimate("coulomb_friction", 3, "v_s", 0.01, 0.02)
    fall = {"rmse_before": 0.2, "rmse_after": 0.1, "explanation": "it is wider"}
    found = replace(found, retuned=(Retune(**vars(shape), **fall),))
    (everything,) = (
        x for x in found.offers if x.change.arguments.get("findings") == "helpful"
    )
    parts = parts_of(everything, found)
    assert [part.title for part in parts] == [
        "Backlash, joint 2",
        "Joint spring, joint 1",
        "Coulomb friction, joint 3: v_s",
    ]
    assert parts[0].gain.startswith("joint 2's error: 3 → 1 ")
    assert [part.badge for part in parts] == ["confident", "near-tie", "confident"]


def test_what_is_sure_is_added_together():
    """Where its errors were computed; what may be another effect is left, and is in what
    helps."""
    one, two = finding("backlash", 1), finding("backlash", 2)
    found = diagnosis(one, two, finding("joint_spring", 3, "backlash"), before=3.0)
    assert found.offers.main.change.words == "add backlash on joint 1"
    texts = (one.text, two.text)
    errors = ErrorWith(texts, np.full(7, 1.0))
    change = with_more_errors(found, errors).offers.main.change
    assert change.words == "add backlash on joints 1 and 2"
    assert change.arguments == {"effects": [*texts], "findings": [1, 2]}
    pair = diagnosis(one, two, before=3.0)
    change = with_more_errors(pair, errors).offers.main.change
    assert change.arguments["findings"] == "helpful"
    shape = ShapeEstimate("coulomb_friction", 1, "v_s", 0.01, 0.02)
    fall = {"rmse_before": 0.2, "rmse_after": 0.1, "explanation": "it is wider"}
    constant = Retune(**vars(shape), **fall)
    texts = (one.text, two.text, constant.text)
    both = with_more_errors(pair, ErrorWith(texts, np.full(7, 1.0)))
    both = replace(both, retuned=(constant,))
    change = (
        both.offers.main.change
    )  # what counts is named, and its trifles are counted
    effects = "backlash on joints 1 and 2"
    assert change.words == f"add {effects} and 1 constant of the model at another value"
    (words,) = describe_diagnosis(both, ["N m"] * 7).constants
    assert words.brief_gain == "joint 1's error: 0.2 → 0.1 N m or N, -50 %"
    three = finding("stiction", 3), one, two
    three = with_more_errors(
        diagnosis(*three, before=3.0, after={"stiction": 3.0}), errors
    )
    assert three.offers.main.change.arguments["effects"] == [one.text, two.text]
    assert three.offers.main in three.offers


def test_a_constant_is_judged_beside_the_model_that_findings_are():
    """One error of a joint before, whatever is changed."""
    shape = ShapeEstimate("coulomb_friction", 3, "v_s", 0.01, 0.02)
    fall = {"rmse_before": 0.2, "rmse_after": 0.1, "explanation": "it is wider"}
    constant = Retune(**vars(shape), **fall)
    found = replace(diagnosis(finding("stiction", 3)), retuned=(constant,))
    assert (constant,) in found.offers.selections_of_one
    found = found.with_errors({(constant.text,): np.full(7, 1.5)})
    scaled = found.with_judged_errors(np.full(7, 4.0), np.full(7, 1.0))
    for judged, before, after in ((found, 2.0, 1.5), (scaled, 4.0, 3.0)):
        (own,) = judged.retuned
        assert (own.rmse_before, own.rmse_after) == (before, after)
        words = describe_diagnosis(judged, ["N m"] * 7)
        assert words.constants[0].brief_gain.endswith(", -25 %")
        assert "error on data left out: -25 %." in words.constants[0].sentences


def test_what_helps_beside_another_one_alone_says_which():
    """The error with both is lower than that of the model, and than with the other."""
    before = np.full(7, 2.0)
    first, second, third = (finding("stiction", joint) for joint in (1, 2, 3))
    found = diagnosis(first, second, third)
    alone = {(first.text,): 1.01 * before, (second.text,): before - np.eye(7)[1]}
    alone |= {(third.text,): before - np.eye(7)[2]}
    found = found.with_errors(alone)
    assert found.offers.selections_of_several[-2:] == [(first, second), (first, third)]
    pairs = {(first.text, second.text): alone[(second.text,)]}
    assert helped_by(found.with_errors(alone | pairs), first) == ""
    pairs |= {(first.text, third.text): before - np.eye(7)[2] - 0.5 * np.eye(7)[0]}
    found = found.with_errors(alone | pairs)
    assert helped_by(found, first) == (
        "helps beside stiction on joint 3, not by itself: with both joint 1's error is 1.5"
        " N m or N, and 2 N m or N without it"
    )
    assert helped_by(found, second) == ""
    words, *_ = describe_diagnosis(found, ["N m"] * 7).findings
    assert words.brief_gain == "with both, joint 1's error: 2 → 1.5 N m or N, -25 %"
    pair = found.offers.pair_of(first)
    assert (pair.title, pair.is_mutual) == ("Stiction on joints 1 and 3", False)
    assert pair.change.arguments["effects"] == [first.text, third.text]
    assert found.offers.pair_of(third) is None
    assert found.offers.shown_of(third) == (3, third)
    # The card shows the joint that its number is of, against what acts there.
    there = before - np.eye(7)[2] - 0.5 * np.eye(7)[2]
    both = pairs | {(first.text, third.text): there}
    elsewhere = found.with_errors(alone | both)
    assert elsewhere.offers.pair_of(first).joint == 3
    assert elsewhere.offers.shown_of(first) == (3, third)
    assert helped_by(found, first) in words.gain


def test_laws_of_friction_at_reversals_are_said_as_a_family():
    """Hidden stiction was called Maxwell slip that builds up from 0.0037 degrees on."""
    torque = {"torque_rms": 1.13, "torque_std": 0.05, "torque_unit": "N*m"}
    laws = "presliding_hysteresis", "stiction"
    found = finding("maxwell_slip", 4, *laws, shape={"d": 6e-5}, std=0.01, **torque)
    family = "joint 4 sticks or gives way at reversals"
    assert found.on_the_arm == (
        f"On the arm: {family}, 1.13 ± 0.098 N m RMS over these runs; which law makes it is"
        " open: Maxwell slip, pre-sliding hysteresis or stiction."
    )
    assert family in found.explanation.replace("Joint", "joint")
    assert found.effect_is_certain
    other = finding("maxwell_slip", 4, "joint_spring", shape={"d": 6e-5}, **torque)
    assert not other.family_in_words


@pytest.mark.parametrize(
    ("effect", "travel", "words"),
    [
        ("presliding_hysteresis", 0.0008, "or stiction: the same law over a shorter"),
        ("presliding_hysteresis", 0.008, ""),
        ("stiction", 0.0003, "or pre-sliding hysteresis: the same law over a longer"),
        ("stiction", 0.00001, ""),
        ("load_dependent_hysteresis", 0.0008, ""),
        ("maxwell_slip", 0.0008, ""),
    ],
)
def test_a_travel_that_both_names_of_a_law_have_is_called_by_both(
    effect, travel, words
):
    """A card said "and no other" of pre-sliding hysteresis where stiction was hidden."""
    found = finding(effect, 4, shape={"d": travel}, std=0.01)
    assert found.same_law_in_words == (f"{words} travel" if words else "")
    said, *_ = describe_diagnosis(diagnosis(found), ["N m"] * 7).findings
    evidence = " ".join(text for text, _ in said.evidence)
    assert ("That it is this effect and no other" in evidence) == (not words)
    assert words.partition(": ")[2] in said.sentences
    assert words in found.line
    assert words.partition(": ")[2] in found.explanation


def test_the_cause_of_the_whole_robot_names_no_joint():
    tilt = finding("base_tilt", 1, joints=())
    assert (
        main_cause(diagnosis(tilt, before=3.0))
        == "The robot errs: base tilt (confident)."
    )


def test_findings_that_cancel_are_one_with_its_sum():
    """An arm's joint 1 "rubs 12 N m less at standstill" and "sticks with up to 11 N m",
    while it errs by 1.5 N m."""
    is_open = {"doubts": (Doubt("uncertain"),)}
    rubs = finding("sigmoid_friction", 1, torque_rms=12.0, **is_open)
    sticks = finding("stiction", 1, torque_rms=11.0, **is_open)
    small = finding("stiction", 2, torque_rms=0.5, **is_open)
    found = diagnosis(rubs, sticks, small)
    first, second, third = describe_diagnosis(found, ["N m"] * 7).findings
    assert first.title == "Sigmoid friction on joint 1; stiction on joint 1"
    assert "friction of joint 1 changes with its velocity" in first.on_the_arm
    assert "law that is open" in first.on_the_arm
    assert first.size == ""
    assert second.title == first.title
    assert [group.title for group in found.offers.groups] == [first.title, third.title]
    assert third.title == "Stiction, joint 2"
    added = found.offers.offer_of(found.effects[0]).change.arguments
    assert added == {"effects": [rubs.text, sticks.text], "findings": [1, 2]}
    (alone,) = describe_diagnosis(diagnosis(rubs), ["N m"] * 7).findings
    assert alone.size


@pytest.mark.parametrize(
    ("torques", "joint", "n_in_sum"),
    [
        ((2.1, 2.1), 1, 2),
        # The joint errs by 2 N m: torques below that need not cancel.
        ((1.9, 1.9), 1, 1),
        ((None, None), 1, 1),
        # One alone cancels with all that is sure on its joint, two with each other.
        ((2.1, 1.9), 1, 2),
        ((2.1, 1.9), 2, 1),
        ((2.1, 2.1, 1.9), 1, 2),
    ],
)
def test_torques_beyond_the_joints_error_are_one_finding(torques, joint, n_in_sum):
    first, *others = torques
    is_open = {"doubts": (Doubt("uncertain"),)}
    loud = finding("sigmoid_friction", 1, torque_rms=first, **is_open)
    beside = [
        finding(effect, joint, torque_rms=rms, **is_open)
        for effect, rms in zip(("stiction", "joint_spring"), others, strict=False)
    ]
    found = diagnosis(loud, *beside)
    first, *others = found.offers.groups
    assert first.findings == (loud, *beside)[:n_in_sum]
    assert [group.findings for group in others] == [
        (f,) for f in beside[n_in_sum - 1 :]
    ]


def test_the_headline_names_effects_whose_law_or_name_is_open():
    found = diagnosis(
        finding("presliding_hysteresis", 4),
        finding("presliding_hysteresis", 7, "maxwell_slip"),
        finding("joint_spring", 2, "base_tilt"),
    )
    assert found.headline == (
        "Missing: pre-sliding hysteresis on joints 4 and 7; joint spring on joint 2, or"
        " what fits as well (1 confident and 2 near-tie findings)."
    )


def test_a_printed_diagnosis_names_findings_that_are_not_sure():
    doubt = {"doubts": (Doubt("small"),)}
    weak = [finding("backlash", joint, **doubt) for joint in (1, 3, 5)]
    found = diagnosis(
        finding("presliding_hysteresis", 4),
        finding("joint_spring", 2, "base_tilt"),
        *weak,
    )
    printed = str(found)
    lines = (
        "finding 1: Pre-sliding hysteresis, joint 4: 1 ± 0.2 N m (95 %)",
        "finding 2: Joint spring, joint 2 (near-tie): 1 ± 0.2 N m (95 %);"
        " fits as well: base tilt",
        "finding 3: Backlash, joint 1 (weak): 1 ± 0.2 N m (95 %)",
        "finding 4: Backlash, joint 3 (weak): 1 ± 0.2 N m (95 %)",
    )
    for line in lines:
        assert line in printed
    assert "finding 5" not in printed  # two weak ones at the end are enough


@pytest.mark.parametrize(
    ("joints", "ratings"),
    [((2,), ("confident", "near-tie")), ((), ("near-tie", "near-tie"))],
)
def test_what_the_check_explains_is_a_rival_on_its_joints(joints, ratings):
    """A step of one torque, or a filter of all: no finding there is sure of its name."""
    found = diagnosis(finding("joint_spring", 1), finding("backlash", 2))
    what = "The torque of joint 2 steps."
    beside = found.beside_explanation_of_log("torque step", what, joints)
    assert tuple(f.rating for f in beside.effects) == ratings
    assert [f.torque_is_certain for f in beside.effects] == [True, True]
    assert not beside.effects[1].effect_is_certain
    assert beside.effects[1].remarks == (
        "the check explains its torque as well, by a torque step: the torque of joint 2"
        " steps",
    )


@pytest.mark.parametrize(
    ("kind", "grade", "doubts", "rating"),
    [
        ("torque step", "likely", (), "near-tie"),
        ("torque step", "possible", (), "confident"),
        ("torque filter", "likely", (), "confident"),  # stated
        ("torque filter", "likely", (Doubt("small"),), "near-tie"),
    ],
)
def test_only_what_no_sure_finding_states_is_a_rival(kind, grade, doubts, rating):
    late = finding("torque_filter", 1, joints=(), doubts=doubts)
    issue = make_explanation(
        kind,
        "The torques step.",
        where="all channels",
        certainty=Certainty(grade, ""),
        remedy="",
        log_odds=30.0,
    )
    found = diagnosis(finding("joint_spring", 2), late)
    beside = _beside_check(found, {"run1.csv": [issue]})
    assert beside.effects[0].rating == rating


@pytest.mark.parametrize(
    ("fields", "doubtful"),
    [
        ({"log_odds": 30.0}, "on its joints"),
        ({"log_odds": 30.0, "arm_difference": "load"}, "on its joints"),
        ({"log_odds": 30.0, "arm_difference": "friction"}, "none"),
        ({}, "none"),  # no race has judged it
        ({"apply": "sign:tau1"}, "all"),
        ({"apply": "sign:tau1", "certainty": Certainty("possible", "")}, "none"),
        ({"apply": "unit:tau", "nature": "fact"}, "none"),
    ],
)
def test_an_issue_says_which_findings_it_makes_doubtful(fields, doubtful):
    likely_one = {"certainty": likely("an arm leaves less"), "remedy": "", **fields}
    issue = make_explanation("a kind", "something.", where="the log", **likely_one)
    assert issue.doubtful_findings == doubtful


def test_a_mounting_and_each_of_a_set_are_faults_of_the_log():
    """Where the base is turned, or a joint's sign, no finding is sure, and the set stands
    there with its probabilities."""
    sign = make_explanation(
        "joint sign",
        "joint 1 counts.",
        remedy="flip",
        where="the log",
        certainty=likely("as likely"),
        apply="sign:joint1",
        probability=0.3,
    )
    mount = make_explanation(
        "gravity direction",
        "gravity is up.",
        remedy="turn gravity",
        where="the log",
        certainty=likely("an arm leaves less"),
        log_odds=60.0,
        probability=0.7,
    )
    issue = replace(mount, gravity=(0.0, 0.0, 9.81), rivals=(sign,))
    beside = _beside_check(diagnosis(finding("backlash", 2)), {"run1.csv": [issue]})
    faults = beside.log_faults
    assert [(x.problem, x.probability) for x in faults] == [
        ("gravity is up.", 0.7),
        ("joint 1 counts.", 0.3),
    ]
    assert [x.rivals for x in faults] == [(faults[1].change,), (faults[0].change,)]
    assert beside.effects[0].rating == "weak"
    assert beside.headline.startswith("It looks as if gravity is up. Mend")


def test_adding_what_is_sure_takes_effects_whose_law_is_open():
    found = diagnosis(finding("presliding_hysteresis", 7, "maxwell_slip"))
    assert len(found.selected(helpful=True).effects) == 1


def model_with(*parts):
    """A model of effects with one parameter each: its value and standard deviation."""
    values = np.array([value for _, value, _ in parts])
    deviations = np.array([std for _, _, std in parts])
    return SimpleNamespace(
        theta=values,
        uncertainty=SimpleNamespace(covariance=np.diag(deviations**2)),
        model=SimpleNamespace(
            parts=[(effect, np.array([k])) for k, (effect, _, _) in enumerate(parts)]
        ),
    )


@pytest.fixture
def spring(two_link):
    return effect_types()["joint_spring"](two_link.robot, [0])


@pytest.mark.parametrize(
    ("size", "std", "rating", "torque_is_certain"),
    [
        (1.0, 0.1, "confident", True),
        (1.0, 0.3, "weak", True),
        (-6.6, 6.5, "weak", True),
    ],
)
def test_a_size_that_the_model_does_not_know_is_no_confident_finding(
    spring, size, std, rating, torque_is_certain
):
    """Its torque is certain all the same, since only its size is open."""
    sized = size_in_model(finding("joint_spring", 1), model_with((spring, size, std)))
    assert sized.rating == rating
    assert sized.torque_is_certain == torque_is_certain


@pytest.mark.parametrize(
    ("size", "doubts", "torque_is_certain"),
    [
        (1.0, ("sticks",), True),
        (0.1, ("sticks",), False),  # it may be zero, and its torque is in doubt
        (0.1, ("uncertain",), True),
        (1e-14, (), False),  # it is held at its bound
    ],
)
def test_what_may_be_zero_in_the_model_is_not_added_by_its_help_alone(
    spring, size, doubts, torque_is_certain
):
    searched = finding("joint_spring", 1, doubts=tuple(map(Doubt, doubts)), helps=True)
    sized = size_in_model(searched, model_with((spring, size, 0.1)))
    assert sized.torque_is_certain == torque_is_certain


def test_two_estimates_of_a_size_widen_its_interval(spring):
    """The search says 1.0 +- 0.1, the model 1.3 +- 0.05: what both lack differs."""
    searched = finding("joint_spring", 1, std_of_rows=0.1, size_in_search=1.0)
    std = std_of_both(1.3, 0.05, searched)
    assert std == pytest.approx(np.hypot(0.1, 0.3 / 1.96), rel=1e-3)


def test_the_tolerated_error_of_a_law_widens_an_interval(spring):
    searched = finding("joint_spring", 1, std_of_rows=0.1, std_of_law=0.3)
    assert std_of_both(1.0, 0.05, searched) == pytest.approx(np.hypot(0.1, 0.3))


@pytest.mark.parametrize(("std_of_law", "rating"), [(0.29, "confident"), (0.0, "weak")])
def test_a_law_that_is_tolerated_does_not_make_a_torque_uncertain(
    spring, std_of_law, rating
):
    searched = finding("joint_spring", 1, std_of_law=std_of_law)
    assert size_in_model(searched, model_with((spring, 1.0, 0.3))).rating == rating


def test_the_size_of_the_search_outlasts_that_of_the_model(spring):
    """A findings.json has the model's size; `add` still knows what the search said."""
    searched = finding("joint_spring", 1, std_of_rows=0.1, size_in_search=1.0)
    sized = size_in_model(searched, model_with((spring, 1.3, 0.05)))
    assert (sized.size, sized.std) == (1.3, pytest.approx(0.05))
    assert std_of_both(1.3, 0.05, sized) == std_of_both(1.3, 0.05, searched)


@pytest.mark.parametrize("seconds", [1, 8])
def test_errors_that_last_longer_than_a_cluster_widen_a_variance(seconds):
    """Errors of 1 s and 8 s in a log of 64 s, each row of which has the same column."""
    n_rows = 6400
    rng = np.random.default_rng(0)
    ratios = []
    for _ in range(100):
        errors = rng.normal(size=64 // seconds).repeat(100 * seconds)
        labels = np.arange(n_rows) // 128  # 50 clusters
        data = SimpleNamespace(clusters=(labels, labels))
        factor = largest_sums(data, np.ones((1, n_rows, 1)), errors[None])
        ratios.append(np.sum(errors) / np.sqrt(np.sum(factor**2)))
    assert np.mean(np.abs(ratios) < 1.96) > 0.9


@pytest.mark.parametrize(("law", "size"), [(1.0, 5.0), (2.0, 7.0)])
def test_each_of_two_laws_has_its_own_size(two_link, law, size):
    kind = effect_types()["maxwell_slip"]
    free, even = (kind(two_link.robot, [0], law=x) for x in (1.0, 2.0))
    parts = [
        (SimpleNamespace(**_as_one_parameter(free)), 5.0, 0.1),
        (SimpleNamespace(**_as_one_parameter(even)), 7.0, 0.1),
    ]
    held = effect_of(finding("maxwell_slip", 1, shape={"law": law}), model_with(*parts))
    assert held is not None
    assert parts[int(held[1][0])][1] == size


def test_a_law_that_a_model_lacks_has_no_size_in_it(two_link):
    even = effect_types()["maxwell_slip"](two_link.robot, [0], law=2.0)
    part = SimpleNamespace(**_as_one_parameter(even)), 7.0, 0.1
    missing = finding("maxwell_slip", 1, shape={"law": 1.0})
    assert effect_of(missing, model_with(part)) is None


def _as_one_parameter(effect):
    """What identifies an effect in a model."""
    names = ("name", "joints", "shape", "law_constants", "whole_robot")
    return {name: getattr(effect, name) for name in names}


@pytest.mark.long
@pytest.mark.real_data
def test_no_confident_size_of_the_real_wrist_may_be_zero(data_folder):
    """On the TX40 a friction of a power of speed had -6.6 +- 13 N m."""
    run = datasets.converted("tx40", data_folder / "tx40")["exciting"]
    train = run.window(0.0, 6.0)
    model = sdp.identify("tx40", train, check=False)
    found = sdp.diagnose(model, train, check=False)
    confident = [f for f in found.effects if f.rating == "confident"]
    assert confident
    assert all(f.std < 0.5 * abs(f.size) for f in confident)


def test_springs_side_by_side_are_as_strong_as_their_sum():
    """Maxwell slip of 1 + 0 + 0.6 N m; the deviations of its parts are 0.1 N m each."""
    robot = sdp.load_problem("two_link").robot
    effect = effect_types()["maxwell_slip"](robot, [1], d=0.002)
    size, std = size_of(effect, np.array([1.0, 0.0, 0.6]), 0.01 * np.eye(3))
    assert size == pytest.approx(1.6)
    assert std == pytest.approx(0.1 * 3.0**0.5)


def test_it_is_said_which_finding_raises_a_joints_error():
    """Findings are dropped for what they do to all joints together."""
    falls, rises = np.full(7, 1.0), np.full(7, 0.5)
    rises[5] = 1.02
    first, second = finding("joint_spring", 1), finding("joint_spring", 2)
    found = with_more_errors(
        diagnosis(first, second, after=falls),
        ErrorWith((first.text, second.text), rises),
    )
    assert errors_that_rise(found, found.effects[:1]) == ""
    assert errors_that_rise(found, []) == ""
    said = errors_that_rise(found, found.effects)
    assert said.startswith("A joint's error rises with finding 2. ")
    assert "evidence in the training runs" in said


@pytest.mark.parametrize(
    ("after", "doubts"),
    [(0.5, ()), (0.998, ("not_held_out",)), (2.8, ("raises",))],
    ids=["lowers", "leaves", "raises"],
)
def test_a_setting_that_does_not_lower_the_error_is_not_to_be_re_estimated(
    two_link, after, doubts
):
    change = ShapeEstimate("coulomb_friction", 2, "v_s", 0.01, 0.014, gain=30.0)
    found = retune(
        change, 1e-3, two_link.robot, np.array([1.0, 1.0]), np.array([1.0, after])
    )
    assert tuple(doubt.reason for doubt in found.doubts) == doubts
    assert found.torque_is_certain == (not doubts)


def test_a_size_that_may_be_zero_stands_nowhere():
    """A sigmoid friction of "1e-08 ± 19 N m, 0.0883 ± 13023 N m RMS"."""
    for torque in ({}, {"torque_rms": 0.0883, "torque_std": 6600.0}):
        found = finding("sigmoid_friction", 1, size=1e-8, std=10.0, **torque)
        assert found.size_text == "size open"
        assert "do not tell" in found.on_the_arm
        assert "1e-08" not in f"{found.line}{found.explanation}"


def test_what_no_file_holds_is_said_beside_the_offer_with_the_nearest_law_that_one_does():
    """A finding that all files hold, or of which no law is known, adds nothing to it."""
    files = ("model.h", "robot.urdf")
    lost = {"no_place_in": files, "held_law": "load_dependent_friction:2"}
    lacking = finding("presliding_hysteresis", 2, held_law_in=("model.h",), **lost)
    unknown = replace(lacking, held_law="", held_law_in=())
    everywhere = finding("joint_spring", 3)
    errors = (
        ErrorWith((lacking.text,), np.full(7, 1.0)),
        ErrorWith((lacking.held_law,), np.full(7, 1.25)),
    )
    found = replace(diagnosis(lacking, everywhere), errors_with=errors)
    said = place_in_files(found, [lacking.text])
    assert said == (
        "model.h and robot.urdf have no place for pre-sliding hysteresis on joint 2;"
        " model.h holds load dependent friction on joint 2, which gives 1.25 N m or N there"
        " instead of 1 N m or N."
    )
    assert place_in_files(Diagnosis.from_dict(found.to_dict()), [lacking.text]) == said
    both = place_in_files(found, [lacking.text, everywhere.text])
    assert both == said
    offer = found.offers.offer_of_held_law(lacking)
    assert offer == found.offers[-1]
    assert offer.change.words == "add load dependent friction on joint 2"
    assert offer.why.endswith("; model.h holds this law")
    assert found.offers.offer_of_held_law(everywhere) is None
    assert place_in_files(found, [everywhere.text]) == ""
    worse = replace(found, errors_with=(errors[0], ErrorWith(*_no_better(lacking))))
    for without_law in (worse, diagnosis(unknown)):
        text = place_in_files(without_law, [lacking.text])
        assert text == f"{said.partition(';')[0]}."


def _no_better(lacking):
    """The errors of the model, which the law of a finding leaves as they were."""
    return (lacking.held_law,), np.full(7, 2.0)


def test_of_a_torque_that_is_known_a_card_says_once_which_laws_may_make_it():
    known = {"torque_rms": 0.2, "torque_std": 0.01, "torque_unit": "N*m"}
    reasons = (Doubt("rivals"), Doubt("insignificant"))
    found = finding(
        "presliding_hysteresis", 2, "maxwell_slip", std=0.9, doubts=reasons, **known
    )
    (words,) = describe_diagnosis(diagnosis(found), ["N m"] * 7).findings
    assert words.on_the_arm.endswith(
        "joint 2 sticks or gives way at reversals, 0.2 ± 0.02 N m RMS over these runs; which law"
        " makes it is open: pre-sliding hysteresis or Maxwell slip."
    )
    evidence = [text for text, _ in words.evidence]
    for said in (words.sentences, " ".join([words.on_the_arm, *evidence])):
        assert said.count("Maxwell slip") == 1
        assert "from zero" not in said


def test_a_torque_that_is_known_is_the_one_statement_of_size():
    """The card said 1.57 N m RMS, and that the size is not told from zero; the joint erred
    by less than that in all."""
    known = {"torque_rms": 1.57, "torque_std": 0.4, "torque_unit": "N*m"}
    doubts = (Doubt("insignificant"),)
    found = finding("maxwell_slip", 5, std=0.9, doubts=doubts, **known)
    given = replace(diagnosis(found), held_out_rmse_before=np.full(7, 0.293))
    (words,) = describe_diagnosis(given, ["N m"] * 7).findings
    assert "RMS over these runs" in words.on_the_arm
    evidence = [text for text, _ in words.evidence]
    assert any(one.startswith("Joint 5 errs by 0.293 N m") for one in evidence)
    assert any("other parameters balance most of that" in one for one in evidence)
    assert "from zero" not in " ".join([words.sentences, *evidence])


def test_the_colour_of_a_badge_follows_what_to_do():
    """Its word follows what is known: a near-tie that helps is added, and is green."""
    helps = finding("joint_spring", 2, "backlash", helps=True)
    sure = finding("stiction", 1)
    found = diagnosis(helps, sure, after={"stiction": 3.0})  # it errs more with it
    of_findings = describe_diagnosis(found, ["N m"] * 7).findings
    assert [words.helps for words in of_findings] == [True, False]
    assert [words.badge for words in of_findings] == ["near-tie", "confident"]


def test_the_data_frame_has_the_errors_that_cards_and_offers_have():
    """Those of the model and of the model with this finding alone, not those after the
    findings before it."""
    spring = finding("joint_spring", 1, number=1)
    errors = (ErrorWith((spring.text,), np.full(7, 1.25)),)
    found = replace(diagnosis(spring), errors_with=errors)
    before, after = found.errors_of(found.effects[0])
    row = found.to_frame().iloc[0]
    assert row["error before [N m or N]"] == before[0] == 2.0
    assert row["error after [N m or N]"] == after[0] == 1.25
