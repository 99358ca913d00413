"""The commands that make what a session made, to be run where its files are."""

from collections.abc import Mapping, Sequence
from typing import Any

from sdp_vs_penalty.page.run_issues import RunIssues


def commands_of(session: RunIssues) -> list[list[str]]:
    """Return the words of the command lines that repeat a session's work, one a step.

    They are what made the runs, `identify` unless the first model was opened from a
    file, and for each further model the `diagnose` that names its effects and `add`;
    `compare` judges the models on the run that is kept for testing.
    """
    commands = [[*words] for words in session.prepared]
    history, runs, robot = session.history, session.runs, session.robot
    if not history:
        return commands
    first = history[0]
    data = data_words(runs)
    test = test_words(runs)
    name = first.opened or "model1.json"
    names = [name]

    def identify_words(effects: Sequence[str], out: str) -> list[str]:
        """Return the words of the `identify` that makes a model with these effects as its
        file ``out``."""
        words = ["--method", first.method, "--effects", ",".join(effects)]
        if session.meaningless:
            words.append("--no-check")
        given = {"hold": robot["hold"], **session.options}
        if robot["gravity"] != robot["own_gravity"]:
            given["gravity"] = ",".join(f"{g:g}" for g in robot["gravity"])
        for option, value in given.items():
            words += option_words(option, value) if value else []
        source = robot["file"] or robot["source"]
        return ["identify", source, *data, *words, "--out", out]

    if not first.opened:
        commands.append(identify_words(first.effects, name))
    # A model that was kept is the last of those that the commands before it made.
    n_made = max(1, sum(words[0] in ("identify", "add") for words in session.prepared))
    for k, model in enumerate(history[1:], start=n_made + 1):
        frozen = ["--frozen"] if model.frozen else []
        how = [*data, *test, *frozen]
        what = [",".join(model.added)]
        if model.findings_added is not None:
            found = f"findings{k - 1}.json"
            commands.append(["diagnose", name, *how, "--json", found])
            what = ["--from", found]
            if not isinstance(model.findings_added, str):
                what += ["--only", ",".join(map(str, model.findings_added))]
            elif model.findings_added == "helpful":
                what.append("--helpful")
        words = [name, *what, *data, *(test if len(what) > 1 else ())]
        name = f"model{k}.json"
        names.append(name)
        commands.append(["add", *words, *frozen, "--out", name])
    for file, record in history[-1].exported.items():
        if file not in session.taken or not record.get(
            "model"
        ):  # none in older projects
            continue
        if not record["in_place"]:
            commands.append(["export", name, "--out", file, "--refit", *data, *test])
        else:
            commands.append(identify_words(record["effects"], f"for-{file}.json"))
            commands.append(["export", f"for-{file}.json", "--out", file])
    if history[-1].findings is not None:
        frozen = ["--frozen"] if history[-1].findings.frozen else []
        found = f"findings{n_made + len(history) - 1}.json"
        commands.append(["diagnose", name, *data, *test, *frozen, "--json", found])
    if test:
        judged = ["--data", *test[1:2]]
        if "--test-window" in test:
            judged += ["--window", test[-1]]
        commands.append(["compare", *names, *judged])
    return commands


def data_words(runs: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the arguments ``--data`` with the training runs, and ``--window`` if
    needed.

    A single run that is split needs the time windows [s] of its training part.
    """
    names = [run["in_commands"] for run in runs if run["use"] in ("train", "split")]
    words = ["--data", *names]
    if len(runs) == 1 and runs[0]["use"] == "split":
        words += ["--window", _windows(runs[0], "train")]
    return words


def test_words(runs: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the arguments ``--test`` with the run that models are judged on, and its
    windows; none where the page judges on several runs, or on those of training."""
    if len(runs) == 1 and runs[0]["use"] == "split":
        windows = _windows(runs[0], "test")
        return ["--test", runs[0]["in_commands"], "--test-window", windows]
    tested = [run["in_commands"] for run in runs if run["use"] == "test"]
    return ["--test", *tested] if len(tested) == 1 else []


def _windows(run: Mapping[str, Any], side: str) -> str:
    """Write the windows [s] of one side of a split run, as ``--window`` takes them."""
    return ",".join(f"{a!r}:{b!r}" for a, b in run["split"][side])


def option_words(name: str, value: str) -> list[str]:
    """Return an option as words of a command; a flag has the value "yes", and a value
    that begins with a minus sign would be read as an option."""
    option = f"--{name.replace('_', '-')}"
    if value == "yes":
        return [option]
    return [f"{option}={value}"] if value.startswith("-") else [option, value]
