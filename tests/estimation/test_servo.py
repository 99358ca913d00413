"""Logs without torque: the servo's law, its delay, the scale, and instruments against
noise.

The truth is a slide with a position servo, integrated in tests/helpers/servo_log.py.
"""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from recorded import refusal
from servo_log import COULOMB, EFFECTS, KD, KP, MASS, OFFSET, VISCOUS, log, write_slide

import sdp_vs_penalty as sdp
from sdp_vs_penalty.cli import printing
from sdp_vs_penalty.data import Runs, concatenate
from sdp_vs_penalty.estimation import driven, verify_proof_file
from sdp_vs_penalty.estimation.estimate import estimate_of_file
from sdp_vs_penalty.estimation.gains import drive_gains
from sdp_vs_penalty.page import JobRequest, summary
from sdp_vs_penalty.problem.load import with_bounds
from sdp_vs_penalty.render.words import caveats
from sdp_vs_penalty.signals import Preprocessing


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return write_slide(tmp_path_factory.mktemp("servo"))


@pytest.fixture(scope="module")
def found(arm):
    return sdp.identify(arm, log(), effects=EFFECTS, known={"m1": MASS}, check=False)


def value(estimate, name):
    return float(
        estimate.theta[[p.name for p in estimate.model.parameters].index(name)]
    )


@pytest.mark.long
def test_a_known_mass_gives_the_gains_and_friction(found, tmp_path):
    assert found.details["servo"]["law"] == "PD"
    assert found.details["servo"]["delay"] == pytest.approx(0.0, abs=5e-4)
    assert found.details["servo"]["motion"][0] < 1e-3
    assert found.certificate.worst == 0.0
    # The mass is the given one, not the one that the prior on links would have.
    assert found.certificate.gap < 1e-3
    assert value(found, "m1") == pytest.approx(MASS, rel=0.01)
    assert value(found, "kp1") == pytest.approx(KP, rel=0.02)
    assert value(found, "kd1") == pytest.approx(KD + VISCOUS, rel=0.02)  # seen as a sum
    assert value(found, "f_c1") == pytest.approx(COULOMB, rel=0.05)
    assert value(found, "f_o1") == pytest.approx(OFFSET, rel=0.05)
    found.save(tmp_path / "model.json")
    again = sdp.load_estimate(tmp_path / "model.json")
    assert_array_equal(again.theta, found.theta)
    (shown,) = sdp.compare(again, log())
    assert shown.relative_error_percent < 3.0
    other = log(seed=3).window(0.0, 2.5)
    told = sdp.follow(found, other, drive="servo")
    assert float(told.free[0].rms[0]) < 1e-3


@pytest.mark.parametrize(
    ("known", "load", "times", "said"),
    [
        pytest.param({"kp1": 2.0 * KP}, 0.0, 2.0, "kp1 = 1000", marks=pytest.mark.long),
        ({}, 1.5, 1.0, "a load of 1.5 kg"),
        ({}, 0.0, None, "unknown: all torques, masses and gains share"),
    ],
)
def test_what_sets_the_scale(arm, known, load, times, said):
    loads = [(log(seed=5, load=load), load)] if load else []
    found = sdp.identify(
        arm, log(), effects=EFFECTS, known=known, known_loads=loads, check=False
    )
    assert found.details["servo"]["scale"].startswith(said)
    gain = value(found, "kp1")
    mass = value(found, "m1")
    assert gain / mass == pytest.approx(KP / MASS, rel=0.02)
    assert times is None or mass == pytest.approx(times * MASS, rel=0.03)
    sources = dict(
        zip([p.name for p in found.model.parameters], found.sources, strict=True)
    )
    assert all((sources[k], value(found, k)) == ("given", v) for k, v in known.items())
    assert not load or found.certificate.gap < 1e-7


@pytest.mark.long
def test_equal_bounds_set_the_scale(arm):
    problem = with_bounds(sdp.load_problem(arm), f"m1={MASS}:{MASS}")
    found = sdp.identify(problem, log(), effects=EFFECTS, check=False)
    assert found.details["servo"]["scale"] == "m1 = 3"
    assert value(found, "m1") == MASS
    assert value(found, "kp1") == pytest.approx(KP, rel=0.02)
    assert found.certificate.worst == 0.0


@pytest.mark.parametrize(
    ("effects", "known", "words"),
    [
        ("servo_position@d=0.001", {"m1": MASS}, ["nothing to move", "rigid_body"]),
        pytest.param(
            EFFECTS,
            {"m1": MASS, "nonsense": 1.0},
            ["nonsense", "unknown"],
            marks=pytest.mark.long,
        ),
        pytest.param(
            EFFECTS, {"kt3": 1.0}, ["kt3", "no such joint"], marks=pytest.mark.long
        ),
    ],
)
def test_what_is_no_scale_is_refused(arm, effects, known, words):
    asked = {"effects": effects, "known": known, "check": False}
    refusal(lambda: sdp.identify(arm, log(), **asked), *words)


@pytest.mark.long
def test_a_motor_constant_sets_the_scale(arm):
    run = log(torque=True)
    groups = {"q": run.q, "qcmd": run.commanded["qcmd"], "current": run.tau / 2.5}

    def identify(**options):
        log = sdp.Measurements.from_channels(run.t, groups, ("run",))
        return sdp.identify(arm, log, effects=EFFECTS, known={"kt1": 2.5}, **options)

    found = identify(check=False)
    assert found.details["servo"]["scale"] == "kt1 = 2.5"
    assert value(found, "kp1") == pytest.approx(KP, rel=0.02)
    assert value(found, "m1") == pytest.approx(MASS, rel=0.02)
    groups["current"] = -groups["current"]
    refusal(identify, "current1 is not what this servo makes of its error")


def test_the_law_is_chosen_and_its_delay_found(arm):
    pid = sdp.identify(
        arm, log(ki=700.0, delay=0.03), effects=EFFECTS, known={"m1": MASS}, check=False
    )
    assert pid.details["servo"]["law"] == "PID"
    assert pid.details["servo"]["delay"] == pytest.approx(0.03, abs=2e-3)
    assert value(pid, "ki1") == pytest.approx(700.0, rel=0.05)
    ahead = sdp.follow(
        pid, log(ki=700.0, delay=0.03, seed=3).window(0.0, 4.0), drive="servo"
    )
    assert float(ahead.free[0].rms[0]) < 3e-3


@pytest.mark.long
def test_a_cascade_is_chosen(arm):
    loop = sdp.identify(
        arm, log(ki=1000.0, kh=80.0), effects=EFFECTS, known={"m1": MASS}, check=False
    )
    assert loop.details["servo"]["law"] == "cascade"
    assert value(loop, "kh1") == pytest.approx(80.0, rel=0.05)


@pytest.mark.parametrize("lead", [pytest.param(0.0, marks=pytest.mark.long), 0.01])
def test_friction_that_turns_before_the_velocity_is_no_delay_of_the_servo(arm, lead):
    """A simulator's soft friction turns early: law, delay and gains stay right."""
    found = sdp.identify(arm, log(lead=lead), known={"kp1": KP}, check=False)
    names = [p.name for p in found.model.parameters]
    assert ("f_e1" in names) == (lead > 0.0)
    assert found.details["servo"]["law"] == "PD"
    assert found.details["servo"]["delay"] == pytest.approx(0.0, abs=5e-4)
    assert value(found, "kd1") == pytest.approx(KD + VISCOUS, rel=0.01)
    assert value(found, "m1") == pytest.approx(MASS, rel=0.02)


def test_a_drive_at_its_limit_is_named_and_its_gains_left_open(arm):
    """The law demands up to 20 N, the drive makes 8."""
    limited = sdp.identify(arm, log(limit=8.0), known={"m1": MASS}, check=False)
    assert {gain.spread for gain in drive_gains(limited)} == {"not determined"}
    assert any("Drives at their torque limit: joint 1." in x for x in caveats(limited))


def test_a_drive_within_its_limit_is_not_named(found):
    assert found.details["servo"]["limited"] == []
    assert not any("torque limit" in x for x in caveats(found))


@pytest.mark.long
@pytest.mark.parametrize("torque", [False, True])
def test_instruments_take_the_bias_of_noise_away(arm, torque):
    """Positions to millimetres, through a filter that lets much of their noise pass,
    with torque and without: the mass that least squares give is wrong by many times
    what it is with instruments."""
    wide = Preprocessing(6.0, 8.0) if torque else Preprocessing(state_cutoff=5.2)
    known = {} if torque else {"kp1": KP}
    errors = {"command": [], "none": []}
    for how, own in errors.items():
        for s in (1, 2, 3) if torque else (1, 2):
            run = log(3e-3 if torque else 2e-3, seed=s, torque=torque)
            asked = {"known": known, "instruments": how, "preprocessing": wide}
            own.append(
                value(sdp.identify(arm, run, effects=EFFECTS, **asked), "m1") / MASS
                - 1.0
            )
    with_them = np.abs(np.mean(errors["command"]))
    without = np.abs(np.mean(errors["none"]))
    assert with_them < (0.02 if torque else 0.05)
    assert without > 3.0 * with_them


def test_neither_torque_nor_command_is_refused(arm):
    run = log()
    silent = sdp.Measurements.from_channels(
        run.t, {"q": run.q, "current": run.q}, ("run",)
    )
    refusal(
        lambda: sdp.identify(arm, silent, effects=EFFECTS, check=False),
        "neither torque nor commands",
    )
    with_torque = sdp.Measurements.from_channels(
        run.t, {"q": run.q, "tau": run.q}, ("run",)
    )
    plain = sdp.identify(arm, with_torque, effects=EFFECTS, check=False)
    refusal(
        lambda: sdp.cross_validate(arm, silent, effects=EFFECTS),
        "neither torque nor commands",
    )
    refusal(lambda: driven(plain, run), "no servo that would stand for it")


def test_beside_a_torque_the_loop_is_told_and_the_load_does_not_feel_it(arm, capsys):
    run = log(1e-4, ki=700.0, delay=0.02, torque=True)
    loop = f"{EFFECTS},servo_position,servo_integral"
    found = sdp.identify(arm, run, effects=loop, check=False)
    plain = sdp.identify(arm, run, effects=EFFECTS, check=False)
    assert_array_equal(found.theta, plain.theta)
    told = found.details["loop"]
    assert told["delay"] == pytest.approx(0.02, abs=1e-3)
    assert min(told["share"]) > 0.999
    for name, true in {"kp1": KP, "kd1": KD, "ki1": 700.0}.items():
        gain = told["gains"][name]
        assert gain["value"] == pytest.approx(
            true, abs=max(4.0 * gain["std"], 0.01 * true)
        )
    printing.estimate(found, None, 0.0)
    assert "of the joints' logged torque" in capsys.readouterr().out
    folds = [
        sdp.cross_validate(arm, run, effects=x).relative_error_percent
        for x in (loop, EFFECTS)
    ]
    assert folds[0] == folds[1]
    silent = sdp.Measurements.from_channels(
        run.t, {"q": run.q, "tau": run.tau}, ("run",)
    )
    refusal(
        lambda: sdp.identify(arm, silent, effects=loop, check=False),
        "needs the command",
    )


@pytest.mark.long
@pytest.mark.parametrize("scale", ["mass", "load", "torque"])
def test_a_proof_of_servos_is_made_of_its_log(arm, tmp_path, scale):
    """The law, its delay and the instruments are found again from what was asked."""
    path = tmp_path / "proof.json"
    run = log(1e-3, delay=0.02, torque=scale == "torque")
    sdp.identify(
        arm,
        run,
        effects="rigid_body,coulomb_friction",
        known={"m1": MASS} if scale == "mass" else {},
        known_loads=[(log(1e-3, delay=0.02, seed=5, load=1.5), 1.5)]
        if scale == "load"
        else (),
        instruments="command",
        proof=path,
        check=False,
    ).save(tmp_path / "model.json")
    model = sdp.load_estimate(tmp_path / "model.json")
    holds, said = verify_proof_file(path, model, run)
    assert holds
    assert "these measurements make its numbers" in said
    saved = model.to_dict()
    saved["details"]["recipe"] = {"known": {"m1": 5.0}, "effects": None}
    refusal(lambda: estimate_of_file(saved), "'instruments' is missing")
    saved["details"]["recipe"]["instruments"] = "none"
    other = estimate_of_file(saved)
    holds, said = verify_proof_file(path, other, run)
    assert not holds
    assert "these measurements make another problem" in said


def test_the_page_shows_the_torque_that_the_servos_make(found, tmp_path):
    test = log(seed=3)
    truth = log(seed=3, torque=True)
    both = concatenate([log(), test])
    given = Runs(log(), test, both, both)
    asked = type("AskedOfRuns", (JobRequest,), {"runs": given})(
        {"out": tmp_path / "model.json", "runs": [{"use": "train"}], "options": {}}
    )
    bounded = replace(
        found, report=replace(found.report, on_bounds=("mass of link 1",))
    )
    shown = summary(asked, bounded)
    assert shown["servo"]
    (on_bounds,) = shown["on_bounds"]
    assert "mass of link 1" in on_bounds
    with np.load(tmp_path / "model-1.npz") as read:  # the second of its runs
        t = read["t"]
        torque = read["torque"][:, 0]
        modelled = read["modelled"][:, 0]
    plant = truth.tau[:, 0] - VISCOUS * np.gradient(
        truth.q[:, 0], truth.t
    )  # kd holds both
    tau = np.interp(t, truth.t, plant)
    assert np.std(torque - tau) < 0.1 * np.std(tau)
    assert np.sqrt(np.mean((torque - modelled) ** 2)) == pytest.approx(
        shown["comparison"]["rmse"][0], rel=1e-3
    )


@pytest.mark.long
def test_folds_judge_the_links_by_the_drives(arm):
    """Friction that is left out of the model is the error that unseen motion shows."""
    whole = sdp.cross_validate(arm, log(), effects=EFFECTS, folds=3)
    assert whole.relative_error_percent < 3.0
    bare = EFFECTS.replace("coulomb_friction@v_s=0.05,", "")
    assert (
        sdp.cross_validate(arm, log(), effects=bare, folds=3).relative_error_percent
        > 10.0
    )


def test_what_encoders_leave_open_is_said(found, capsys):
    """kd and viscous friction make one torque; the slide's own is known."""
    printing.estimate(found, None, 0.0)
    shown = " ".join(capsys.readouterr().out.split())
    assert "do not tell a servo's damping gain kd from viscous friction" in shown
    assert "leave the drives' torque open" not in shown
    assert found.details["servo"]["torque_error"][0] < 0.02


@pytest.mark.parametrize(
    ("error", "said"), [(0.2, "by 39.2 %"), (None, "not determined")]
)
def test_a_torque_that_the_gains_do_not_determine_is_no_size(found, error, said):
    servo = replace(found.report.servo, torque_error=(error,))
    unsure = replace(found, report=replace(found.report, servo=servo))
    (sentence,) = [x for x in caveats(unsure) if "leave the drives' torque open" in x]
    assert said in sentence


@pytest.mark.long
def test_a_weighed_loads_interval_holds_the_gain(arm):
    """Positions to half a millimetre; the load's weight sets the scale."""
    run = log(5e-4, seed=1)
    loaded = log(5e-4, seed=5, load=1.5)
    model = sdp.identify(
        arm, run, effects=EFFECTS, known_loads=[(loaded, 1.5)], check=False
    )
    (gain,) = [g for g in drive_gains(model) if g.name == "kp1"]
    assert gain.half_width < 0.1 * KP
    assert gain.value == pytest.approx(KP, abs=gain.half_width)
