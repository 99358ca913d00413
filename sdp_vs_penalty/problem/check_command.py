"""The `check` command that a user is told to run: one place that knows its words."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

from sdp_vs_penalty.data.files import run_files
from sdp_vs_penalty.formatting import given_options
from sdp_vs_penalty.problem.load import problem_names
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.robot.robot import STANDARD_GRAVITY


@dataclass(frozen=True, kw_only=True)
class CheckCommand:
    """`check` of some runs, and of the options that its caller was given."""

    #: Built-in name, folder or robot's file.
    problem: str | Path
    #: Files of the runs.
    runs: Sequence[str | Path]
    #: Value of ``--hold`` on the command line; None where it was not used.
    hold: str | None = None
    #: Value of ``--gravity`` on the command line; None where it was not used.
    gravity: str | None = None
    #: Explanations to repair as well, by their words (``sign:tau3``).
    apply: Sequence[str] = ()
    #: What the runs' files call the joints, in the robot's order, which a command that
    #: knows no robot has to keep; empty where they do not name them.
    joints: Sequence[str] = ()

    @classmethod
    def for_runs(cls, problem: Problem, runs: Sequence[str | Path]) -> Self:
        """Return the command that checks runs of a loaded problem.

        A problem is named as it was loaded. One that was not, or whose file is not
        there, has its own name, with the ending of a robot's file unless it is built
        in. Gravity is an option where it is not the standard one.
        """
        name = problem.name if problem.source is None else str(problem.source)
        if name not in problem_names() and not Path(name).exists():
            name = f"{problem.name}.urdf"
        gravity = None
        if problem.robot.gravity != STANDARD_GRAVITY:
            gravity = ",".join(f"{g:g}" for g in problem.robot.gravity)
        return cls(problem=name, runs=runs, gravity=gravity)

    @classmethod
    def for_source(cls, problem: Problem, source: Any) -> Self | None:
        """Return the command that checks the runs that a caller passes; None where they
        are not all files.
        """
        parts = source if isinstance(source, list | tuple) else [source]
        if not all(isinstance(part, str | Path) for part in parts):
            return None
        return cls.for_runs(
            problem, [file for part in parts for file in run_files(part)]
        )

    def applying(self, words: Sequence[str]) -> Self:
        """Return the command that also applies repairs, by their names such as
        ``sign:tau3``."""
        return replace(self, apply=tuple(words))

    @property
    def options(self) -> list[str]:
        """Command-line words of the options that later commands need as well.

        They are the direction of gravity and the joints that are held fixed.
        """
        return given_options({"--gravity": self.gravity, "--hold": self.hold})

    @property
    def copy(self) -> Path:
        """Path of the repaired copy: a file beside a single run, a folder beside
        several.
        """
        first = Path(self.runs[0])
        is_single = len(self.runs) == 1
        return first.with_name(f"{first.stem}_fixed.csv" if is_single else "fixed")

    @property
    def words(self) -> list[str]:
        """Command-line words of the check, without the program's name.

        Example: check panda --data run.csv --gravity 0,0,-9.8
        """
        problem = str(self.problem)
        files = [
            f"./{x}" if x.startswith("-") else x
            for x in [problem, *map(str, self.runs)]
        ]
        return ["check", files[0], "--data", *files[1:], *self.options]

    @property
    def repair_words(self) -> list[str]:
        """Command-line words of the check that also writes a repaired copy of the runs.

        Example: check panda --data run.csv --fix run_fixed.csv --apply sign:tau3
        """
        apply = ["--apply", *self.apply] if self.apply else []
        return [*self.words, "--fix", str(self.copy), *apply]
