"""The front door: every verb takes what users have, shows itself in five lines, names
what was given."""

import re
import sys
from collections import Counter

import numpy as np
import pandas as pd
import pytest
from commands import python
from recorded import refusal
from small_runs import small_model, small_run, write_run

import sdp_vs_penalty as sdp
from sdp_vs_penalty.data import columns_of
from sdp_vs_penalty.effects import Motion, effect_types
from sdp_vs_penalty.results.record import Shown

ARRAYS = ("t", "q", "dq", "tau")


@pytest.fixture(scope="module")
def files(tmp_path_factory, two_link):
    folder = tmp_path_factory.mktemp("api")
    return [write_run(folder / f"run{k}.csv", two_link, seed=k) for k in (1, 2)]


@pytest.fixture(scope="module")
def estimate(files):
    return sdp.identify("two_link", files)


def forms(path):
    """One run in every form that a user may have it in."""
    run = sdp.load_measurements(path)
    return {
        "path": path,
        "text": str(path),
        "measurements": run,
        "arrays": {name: getattr(run, name) for name in ARRAYS},
        "lists": {name: getattr(run, name).tolist() for name in ARRAYS},
        "columns": columns_of(run),
        "frame": (
            pd.DataFrame(columns_of(run)).assign(
                note="text", day=pd.Timestamp("2026-01-01")
            )
        ),
        # pandas 2 reads the last bit right only where it is asked to.
        "csv as pandas reads it": pd.read_csv(path, float_precision="round_trip"),
    }


def test_identify_reads_checks_and_filters_once(two_link):
    once = {
        "as_problem",
        "load_and_check",
        "check_plausible",
        "filter_runs",
        "check_runs",
    }
    calls = Counter()

    def count(frame, event, argument):
        if event == "call" and frame.f_code.co_name in once:
            calls[frame.f_code.co_name] += 1

    sys.setprofile(count)
    try:
        sdp.identify(two_link, small_run(two_link))
    finally:
        sys.setprofile(None)
    assert calls == dict.fromkeys(once, 1)


def test_measurements_are_checked_first_unless_told_otherwise(two_link):
    """As the command line does: errors refuse, warnings warn, and consent is
    remembered."""
    run = small_run(two_link)
    dead = {"t": run.t, "q": run.q, "tau": np.where([True, False], run.tau, 0.25)}
    for verb in (sdp.identify, lambda problem, log: sdp.diagnose(small_model(), log)):
        refusal(
            lambda verb=verb: verb(two_link, dead),
            "tau2 is 0.25 N m in every row",
            "check=False",
        )
    estimate = sdp.identify(two_link, dead, "ols", check=False)
    assert estimate.provenance["checked"] is False
    assert sdp.diagnose(estimate, dead).verdict
    gapped = {name: np.delete(x, slice(150, 200), axis=0) for name, x in dead.items()}
    gapped["tau"] = np.delete(run.tau, slice(150, 200), axis=0)
    with pytest.warns(UserWarning, match="gap"):
        sdp.identify(two_link, gapped, "ols")


def test_the_import_is_lazy_and_lists_its_names():
    code = (
        "import sys, sdp_vs_penalty as s\nassert set(s.__all__) <= set(dir(s)),"
        " dir(s)\nprint({'numpy', 'scipy', 'pandas', 'pinocchio', 'cvxpy', 'typer'} &"
        " set(sys.modules))"
    )
    result = python("-c", code, check=True)
    assert result.stdout == "set()\n"
    for name in sdp.__all__:
        assert getattr(sdp, name) is not None
    with pytest.raises(AttributeError, match="nothing_of_this_name"):
        _ = sdp.nothing_of_this_name


def test_effect_classes_are_at_hand(two_link):
    for kind in effect_types().values():
        assert getattr(sdp.effects, kind.__name__) is kind
        assert kind.__name__ in dir(sdp.effects)
    spring = sdp.effects.JointSpring(two_link.robot, [1])
    assert two_link.model([spring]).effects == (spring,)


def test_identify_and_compare_take_one_run_in_any_form(files):
    problem = sdp.load_problem("two_link")
    run = sdp.load_measurements(files[0])
    expected = sdp.identify(problem, run, "ols", check=False)
    rmse = sdp.compare(expected, sdp.load_measurements(files[1]))[0].rmse
    for (form, given), test in zip(
        forms(files[0]).items(), forms(files[1]).values(), strict=True
    ):
        found = sdp.identify("two_link", given, "ols", check=False)
        assert np.array_equal(found.theta, expected.theta), form
        assert found.provenance["data_hash"] == expected.provenance["data_hash"], form
        assert np.array_equal(sdp.compare(found, test)[0].rmse, rmse), form


def test_lists_mix_forms_and_keep_runs_apart(files, estimate):
    mixed = [files[0], forms(files[1])["frame"]]
    found = sdp.identify("two_link", mixed)
    assert np.array_equal(found.theta, estimate.theta)
    assert len(found.provenance["runs"]) == 2
    refusal(
        lambda: sdp.identify("two_link", [files[0], forms(files[0])["arrays"]]),
        "same samples",
    )


def test_models_are_estimates_or_files(files, estimate, tmp_path):
    path = tmp_path / "model.json"
    estimate.save(path)
    rmse = sdp.compare(estimate, files[0])[0].rmse
    for models, names in (
        (path, [str(path)]),
        ([estimate, path], ["1 (lmi-sdp)", str(path)]),
        ({"mine": path}, ["mine"]),
    ):
        found = sdp.compare(models, files[0])
        assert [c.name for c in found] == names
        assert all(np.array_equal(c.rmse, rmse) for c in found)
    fails = sdp.where_it_fails(path, files[0])
    assert fails[0].joint == 1
    heading, first, *_ = repr(fails).splitlines()
    assert heading.startswith("Where the model fails, the worst joints first")
    assert first.startswith("  joint ")
    assert list(fails.to_frame().index) == [f.joint for f in fails]
    assert fails._repr_html_().count("<tr><td>joint ") == len(fails)
    assert sdp.export(path, tmp_path / "robot.json") == ()
    assert (tmp_path / "robot.json").exists()


def test_predict_is_the_models_torque(estimate, two_link):
    run = small_run(two_link)
    rng = np.random.default_rng(0)
    dq, ddq = rng.normal(size=(2, *run.q.shape))
    expected = estimate.torque(Motion(run.t, run.q, dq, ddq))
    assert np.array_equal(estimate.predict(run.q, dq, ddq), expected)
    assert estimate.predict([0.1, 0.2], [0, 0], [0, 0]).shape == (1, 2)
    for arguments, words in (
        (([0.1], [0.0], [0.0]), "(N, 2)"),
        ((run.q, dq[:5], ddq), "predict(dq=...)"),
        ((run.q, dq, ddq, run.t[:4]), "predict(t=...)"),
    ):
        refusal(lambda given=arguments: estimate.predict(*given), words)
    memory = sdp.add(estimate, "presliding_hysteresis:1@d=0.01", run)
    refusal(lambda: memory.predict(run.q, dq, ddq), "pass t")
    assert np.array_equal(
        memory.predict(run.q, dq, ddq, run.t),
        memory.torque(Motion(run.t, run.q, dq, ddq)),
    )


def test_errors_name_what_was_given(estimate, two_link):
    run = {"t": [0.0, 1.0], "q": [[0, 0], [1, 1]], "tau": [[0, 1], [1, 2]]}
    late = {**run, "t": [1.0, 0.0]}
    bad_calls = [
        (
            lambda: sdp.identify(3, run),
            r"^identify\(problem=3\): no problem: give a built-in name",
        ),
        (
            lambda: sdp.identify("two_link", 3),
            r"^identify\(measurements=3\): no measurements: give",
        ),
        (
            lambda: sdp.identify("two_link", []),
            r"^identify\(measurements=...\): no run",
        ),
        (
            lambda: sdp.identify("two_link", {"t": [0, 1], "q": run["q"]}),
            r"no column tau \(columns: q, t\)",
        ),
        (
            lambda: sdp.identify("two_link", {**run, "dq2": [0.0, 1.0]}),
            "no column dq1, but dq2: give each joint a column",
        ),
        (
            lambda: sdp.identify("two_link", late),
            r"^run1: sample 2, column t: time runs backwards",
        ),
        (
            lambda: sdp.identify(two_link, small_run(two_link), weighting="x"),
            "^weighting 'x' is unknown",
        ),
        (lambda: sdp.compare(None, run), r"^compare\(models=None\): no model"),
        (lambda: sdp.compare([], run), "^No model to compare"),
        (lambda: sdp.diagnose("nowhere.json", run), r"^nowhere.json: cannot be read"),
        (lambda: sdp.diagnose(estimate, object()), r"^diagnose\(measurements=<object"),
        (lambda: sdp.add(estimate, "joint_spring:1", 2.5), r"^add\(measurements=2.5\)"),
        (lambda: sdp.check("two_link", {"a": 1}), "^run1: no column t or q or tau"),
        (lambda: sdp.excite(None), r"^excite\(problem=None\)"),
        (lambda: sdp.export(None, "x.urdf"), r"^export\(estimate=None\)"),
    ]
    for call, words in bad_calls:
        assert re.search(words, refusal(call)), words


def test_a_report_names_what_was_given():
    pytest.importorskip("plotly")
    assert refusal(lambda: sdp.report(4, {}, "x.html")).startswith("report(models=4)")


def test_everything_shows_itself_in_five_lines_and_prints_all(
    estimate, files, two_link, panda
):
    comparisons = sdp.compare(
        [estimate, estimate, estimate, estimate, estimate], files[0]
    )
    diagnosis = sdp.diagnose(estimate, files)
    things = {
        "two_link": estimate,
        "7: ": panda,
        "dq": sdp.load_measurements(*files),
        "fit against noise": comparisons[0],
        "Comparisons": comparisons,
        diagnosis.headline: diagnosis,
        "worst violation": estimate.certificate,
        "problem": sdp.check(two_link, files[0])[0],
        "spring": sdp.simulate("two_link", "joint_spring:1", "weak"),
    }
    for words, thing in things.items():
        text = repr(thing)
        assert text.count("\n") < 5
        assert all(len(line) <= 110 for line in text.splitlines()[1:]), text
        if type(thing).__str__ is Shown.__str__:
            printed = str(thing)
            assert all(len(line) <= 110 for line in printed.splitlines()[1:])
            unwrapped = " ".join(printed.split())
            _, entries = thing._summary()
            assert all(" ".join(whole.split()) in unwrapped for _, whole in entries)
        html = thing._repr_html_()
        assert html.startswith("<p>")
        assert not re.search(r"\bNone\b(?! of)|\bnan\b", f"{text} {html}")
        if words != "spring":
            assert words in text
    assert "&lt;b&gt;" in sdp.compare({"<b>": estimate}, files[0])._repr_html_()


def test_pictures_are_drawn(estimate, files):
    plt = pytest.importorskip("matplotlib.pyplot")
    plt.switch_backend("agg")
    comparisons = sdp.compare({"a": estimate, "b": estimate}, files[1])
    axes = comparisons.plot()
    heights = [bar.get_height() for bar in axes.patches]
    assert np.allclose(sorted(heights), sorted([*comparisons[0].rmse] * 2))
    ends = sorted((bar.get_x(), bar.get_x() + bar.get_width()) for bar in axes.patches)
    assert np.allclose(
        ends, [(0.6, 1.0), (1.0, 1.4), (1.6, 2.0), (2.0, 2.4)]
    )  # side by side
    one = comparisons[0].plot(joint=2, against="position")
    line = one.lines[0]
    assert np.array_equal(line.get_xdata(), comparisons[0].signals.q[:, 1])
    assert np.isclose(np.sqrt(np.mean(line.get_ydata() ** 2)), comparisons[0].rmse[1])
    refusal(lambda: comparisons[0].plot(joint=3), "from 1 to 2")
    refusal(
        lambda: comparisons[0].plot(joint=1, against="mood"),
        "time, position or velocity",
    )
    # A panel an effect, however many shape constants its joints have of their own.
    assert len(estimate.plot()) == len(
        {effect.name for effect in estimate.model.effects}
    )
    plt.close("all")
