"""The `check` command that is printed: it carries what the user has given."""

import re
from dataclasses import replace
from pathlib import Path

import pytest
from arms import THREE, write_urdf
from judged import likely_issue
from small_runs import small_run

from sdp_vs_penalty import diagnose, identify, load_problem
from sdp_vs_penalty.checks.gate import explanations_in_a_line
from sdp_vs_penalty.data import save
from sdp_vs_penalty.problem import ProblemFields
from sdp_vs_penalty.problem.check_command import CheckCommand


def test_a_single_run_is_copied_beside_it():
    command = CheckCommand(problem="panda", runs=["logs/a.csv"])
    expected = "check panda --data logs/a.csv --fix logs/a_fixed.csv"
    assert command.repair_words == expected.split()


def test_several_runs_are_copied_into_a_folder_beside_them():
    command = CheckCommand(problem="panda", runs=["logs/a.csv", "logs/b.csv"])
    assert command.repair_words[-2:] == ["--fix", "logs/fixed"]


def test_held_joints_and_words_to_apply_are_carried():
    command = CheckCommand(problem="arm.urdf", runs=["a.csv"], hold="gripper=0")
    words = command.applying(["sign:tau3"]).repair_words
    assert " ".join(words).endswith(
        "--hold gripper=0 --fix a_fixed.csv --apply sign:tau3"
    )


@pytest.mark.parametrize(
    ("gravity", "words"),
    [("9.81,0,0", ["--gravity", "9.81,0,0"]), ("-9.81,0,0", ["--gravity=-9.81,0,0"])],
)
def test_a_gravity_that_begins_with_a_minus_is_one_word(gravity, words):
    command = CheckCommand(problem="panda", runs=["a.csv"], gravity=gravity)
    assert command.options == words


def test_the_gravity_of_a_problem_on_its_side_is_carried(two_link):
    problem = two_link.with_gravity((9.81, 0.0, 0.0))
    assert CheckCommand.for_runs(problem, ["a.csv"]).gravity == "9.81,0,0"
    assert CheckCommand.for_runs(two_link, ["a.csv"]).gravity is None


def test_a_model_names_the_file_that_its_robot_is_from(tmp_path, monkeypatch):
    """The printed command runs where the user is; without the file it names the arm."""
    monkeypatch.chdir(tmp_path)
    write_urdf(Path("robot.urdf"), "another_name", THREE)
    problem = load_problem("robot.urdf")
    kept = ProblemFields.from_problem(problem).problem(problem.robot)
    assert CheckCommand.for_runs(kept, ["a.csv"]).problem == "robot.urdf"
    Path("robot.urdf").rename("other.urdf")
    command = CheckCommand.for_runs(kept, ["a.csv"])
    assert command.problem == f"{problem.name}.urdf"


def test_the_line_about_explanations_names_the_command_that_tries_them():
    sign = "torque sign", "warning", "joint 2", "sign:tau2"
    issue = likely_issue(*sign, nature="explanation")
    command = CheckCommand(problem="arm.urdf", runs=["my run.csv"], hold="gripper=0")
    line = explanations_in_a_line(command, [("my run.csv", issue)])
    expected = (
        "`sdp-vs-penalty check arm.urdf --data 'my run.csv' --hold gripper=0"
        " --fix 'my run_fixed.csv' --apply sign:tau2`"
    )
    assert expected in line


@pytest.mark.long
def test_a_hint_in_python_names_the_files_that_were_passed(tmp_path, monkeypatch):
    """With their folders; measurements that are no files have no command."""
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "my logs"
    folder.mkdir()
    write_urdf(folder / "arm.urdf", "another_name", THREE)
    problem = load_problem("my logs/arm.urdf")
    run = small_run(problem)
    turned = replace(run, tau=run.tau * [1.0, -1.0, 1.0])
    save(turned, folder / "run.csv")
    words = (
        "`sdp-vs-penalty check 'my logs/arm.urdf' --data 'my logs/run.csv'"
        " --fix 'my logs/run_fixed.csv' --apply sign:tau2` tries the repair"
    )
    for robot in ("my logs/arm.urdf", problem):
        with pytest.warns(UserWarning, match=re.escape(words)):
            model = identify(robot, "my logs/run.csv", "ols")
    with pytest.warns(UserWarning, match=re.escape(words)):
        diagnose(model, "my logs/run.csv")
    with pytest.warns(UserWarning, match=r"taken as it is; `check` says more"):
        identify(problem, turned, "ols")
