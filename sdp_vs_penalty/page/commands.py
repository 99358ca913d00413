"""The commands that make what a session made, to be run where its files are."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from sdp_vs_penalty.errors import command_line

if TYPE_CHECKING:
    from sdp_vs_penalty.page.model_step import ModelStep


def commands_of(
    robot: Mapping[str, Any],
    runs: Sequence[Mapping[str, Any]],
    history: Sequence[ModelStep],
    made_by: Sequence[str] | None,
    seed: int,
    options: Mapping[str, str],
    has_check: bool,
) -> list[str]:
    """Return the command lines that repeat a session's work.

    They are `simulate` if the runs were simulated, `identify` unless the first model
    was opened from a file, and `add` for each further model.

    Parameters
    ----------
    made_by : sequence of str, optional
        Arguments of the command that simulated the runs.
    has_check : bool
        Whether the data check came before identification.
    """
    if not history:
        return []
    source = robot["file"] or robot["source"]
    first = history[0]
    data = data_words(runs)
    commands: list[list[str]] = []
    if made_by:
        commands.append(["simulate", source, *made_by])
    name = first.opened or "model1.json"
    if not first.opened:
        words = ["--method", first.method, "--effects", ",".join(first.effects)]
        words += ["--seed", str(seed)]
        if not has_check:
            words.append("--no-check")
        words += _option_words(robot["gravity"], options)
        commands.append(["identify", source, *data, *words, "--out", name])
    for k, model in enumerate(history[1:], start=2):
        added = ",".join(model.added)
        frozen = ["--frozen"] if model.frozen else []
        words = [name, added, *data, "--seed", str(seed), *frozen]
        name = f"model{k}.json"
        commands.append(["add", *words, "--out", name])
    return [command_line(["sdp-vs-penalty", *words]) for words in commands]


def data_words(runs: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the arguments ``--data`` with the training runs, and ``--window`` if
    needed.

    A single run that is split needs the time windows [s] of its training part.
    """
    names = [run["name"] for run in runs if run["use"] in ("train", "split")]
    words = ["--data", *names]
    if len(runs) == 1 and runs[0]["use"] == "split":
        windows = [f"{a!r}:{b!r}" for a, b in runs[0]["split"]["train"]]
        words += ["--window", ",".join(windows)]
    return words


def _option_words(
    gravity: Sequence[float] | None, options: Mapping[str, str]
) -> list[str]:
    """Return the arguments ``--gravity`` and those for the options that were filled
    in.
    """
    words = []
    if gravity:
        words += ["--gravity", ",".join(f"{g:g}" for g in gravity)]
    for name, value in options.items():
        words += [f"--{name.replace('_', '-')}", value]
    return words
