"""Options of the verbs, a line each: of one verb at the end of its docstring, of
several in SHARED; and words of the command line to plain values."""

import argparse
import inspect
import json
import re
import textwrap
from collections.abc import Callable, Sequence
from enum import StrEnum
from pathlib import Path
from types import UnionType
from typing import Any, get_args, get_origin, get_type_hints

from sdp_vs_penalty.errors import InputError, require_known

#: Flags, or an argument's name; limits; an example of a value; then what it is, for
#: --help and the page.
SHARED = """
problem: Built-in name, folder with a problem.toml, or URDF file.
model model.json: Model written by `identify` or `add`.
models model.json ...: Models written by `identify` or `add`.
--data RUN.csv ...: Measured runs, also without --data behind the problem or model: .csv, .npz, .mat,
    .parquet, .mcap, .bag; a folder or pattern of these; a.csv+b.csv is one run.
--test TEST.csv: Run for the held-out error only.
--frozen: Keep the model fixed (needed for payloads).
--window START:STOP: Part of each run to use, in seconds from its start; or A:B,C:D.
--test-window START:STOP: Part of the test run to use, in seconds from its start.
--seed >=0: Random seed.
--gain-uncertainty >=0.0 <=0.999 0.01: Relative standard deviation of the torque channels' gains; widens
    the intervals.
--gravity x,y,z: Gravity in the base frame, in m/s^2.
--hold finger_joint=0: Joints that stand still [rad, m]; their links belong to their parents.
--json out.json: JSON file for the figures.
--verbose, -v: All tables.
--method: Method, of `sdp-vs-penalty list methods`.
--effects a,b,c: Effects, of `sdp-vs-penalty list effects`; default: the problem's.
--known m3=2.5,kp2=600: Parameters of known value (names: model.json); they set the scale of a log
    without torque.
--jobs >=1: Number of processes.
--scheduler tcp://HOST:PORT: Dask scheduler; default: this computer.
--no-check: No data check before the work.
--as-written: Names mean what they say, ours SI, whatever values and the arm tell of units and clock.
--filters 5,8: Filters of states and torque [Hz]; default: chosen.
--bounds m2=1:5,c2x=-0.1:0.1: Bounds of links [kg, m, kg m^2], in place of the problem's; total=:20: of
    all.
--known-load LOAD.csv:KG: Run with a load of this mass on the last link; determines the torque channels'
    gains.
--instruments command|none: Instruments against noise of positions: the command (without torque the
    motion simulated from it), or none. Default: command where no torque was logged.
--out: Folder to write into.
"""


#: How much effort tables and figures may take.
Budget = StrEnum("Budget", "quick single paper")


def _parsed_option_lines(lines: str) -> dict[str, Any]:
    """Parse lines that describe options, such as "--jobs >=1: Number of processes."

    Returns
    -------
    dict
        By name of the parameter: its flags, an example of a value, its help text, and
        its lower and upper limit (None for no limit).
    """
    options = {}
    joined = re.sub(r"\n +", " ", lines)  # indented lines continue the one before
    for line in joined.strip().splitlines():
        head, _, text = line.partition(": ")
        words = head.split()
        first = words[0].rstrip(",").partition("/")[0]  # --browser/--no-browser
        is_option = first.startswith("-")
        flags = list[str]()
        limits = dict[str, float]()
        example = list[str]()
        for word in words if is_option else words[1:]:
            if is_option and word.startswith("-"):
                flags.append(word.rstrip(",").partition("/")[0])
            elif word[:2] in (">=", "<="):
                limits[word[:2]] = json.loads(word[2:])
            else:
                example.append(word)
        name = first.removeprefix("--").replace("-", "_")
        low_and_high = limits.get(">="), limits.get("<=")
        options[name] = flags, " ".join(example), text, low_and_high
    return options


def _value(kind: type, low: float | None, high: float | None) -> Callable[[str], Any]:
    """Return a function that converts a word to a value within limits, for argparse.

    Parameters
    ----------
    kind : type
        str, int, float, Path or a StrEnum, whose words are the allowed ones.
    """

    def convert(word: str) -> Any:
        if issubclass(kind, StrEnum) and word not in list(kind):
            choices = ", ".join(repr(str(x)) for x in kind)
            raise argparse.ArgumentTypeError(f"{word!r} is not one of {choices}")
        try:
            value = kind(word)
        except ValueError:
            needed = "a whole number" if kind is int else "a number"
            raise argparse.ArgumentTypeError(f"{needed} is needed") from None
        if low is not None and not value >= low:
            raise argparse.ArgumentTypeError(f"it must be at least {low:g}")
        if high is not None and not value <= high:
            raise argparse.ArgumentTypeError(f"it must be at most {high:g}")
        return value

    return convert


class Parser(argparse.ArgumentParser):
    """Of one verb, typed by its signature, told by its docstring; options : by
    parameter, as argparse holds them. Raises InputError for words that are none."""

    def __init__(self, name: str, verb: Callable[..., None]) -> None:
        """Make the parser of a verb from its signature and its docstring.

        The docstring holds the description, "Example: ..." and a line for each option;
        options that several verbs share are described in SHARED.
        """
        text, _, tail = inspect.cleandoc(verb.__doc__ or "").partition("Example: ")
        #: A call of the verb that works.
        self.example, _, lines = tail.partition("\n")
        super().__init__(
            f"sdp-vs-penalty {name}",
            description="\n\n".join(
                map(textwrap.fill, text.replace("%", "%%").split("\n\n"))
            ),
            epilog=f"Example:\n  {self.example}".replace("%", "%%"),
            formatter_class=argparse.RawDescriptionHelpFormatter,
            allow_abbrev=False,
        )
        option_lines = _parsed_option_lines(SHARED) | _parsed_option_lines(
            inspect.cleandoc(lines)
        )
        kinds = get_type_hints(verb)
        #: Whether at least one run must be named.
        self.needs_runs = False
        self.options = {
            p.name: self._declared(p, kinds[p.name], *option_lines[p.name.rstrip("_")])
            for p in inspect.signature(verb).parameters.values()
        }
        self.add_argument(
            "--quiet", "-q", action="store_true", help="Nothing but remarks and errors."
        )
        self.add_argument(
            "--plugin",
            action="append",
            default=[],
            type=Path,
            metavar="my_effects.py",
            help="File of Python that is run, and whose effects, methods, solvers or "
            "formats are used; several: --plugin a.py b.py.",
        )
        if "json_" not in self.options:
            self.add_argument(
                "--json",
                dest="json_",
                type=Path,
                metavar="out.json",
                help="JSON file for what is printed: sentences, tables, files, the "
                "next command.",
            )
        some = [o for o in self.options.values() if not o.option_strings]
        # Behind the one problem or model, words are runs, as those of --data.
        data = self.options.get("data")
        takes_one = len(some) == 1 and some[0].nargs is None
        if data is not None and takes_one:
            self.add_argument(
                "runs", nargs="*", default=[], type=Path, help=argparse.SUPPRESS
            )
            self.needs_runs, data.required = data.required, False
        words = [f"{o.metavar}{' ...' * (o.nargs in ('+', '*'))}" for o in some]
        self.usage = " ".join([self.prog, *words, "[OPTIONS]"]).replace("%", "%%")

    def _declared(
        self,
        p: inspect.Parameter,
        kind: Any,
        flags: Any,
        metavar: str,
        text: str,
        limits: Any,
    ) -> argparse.Action:
        """Declare one parameter of the verb to argparse; ``limits`` are the smallest
        and the largest value of a number, None for none.

        Parameters
        ----------
        kind : type
            Its type hint; a list takes several values, ``| None`` is dropped.
        flags : list of str
            Its flags; none for a positional argument.
        """
        if isinstance(kind, UnionType):  # "... | None"
            kind = get_args(kind)[0]
        several = get_origin(kind) is list
        if several:
            kind = get_args(kind)[0]
        required = p.default is p.empty
        default = None if required else p.default
        text = text.replace("%", "%%")
        if kind is bool:
            yes_or_no: Any = argparse.BooleanOptionalAction if default else "store_true"
            return self.add_argument(
                *flags, dest=p.name, action=yes_or_no, default=default, help=text
            )
        settings: dict[str, Any] = {"type": _value(kind, *limits), "default": default}
        if issubclass(kind, StrEnum):
            metavar = "|".join(kind)
            settings["choices"] = list(kind)  # for the shell's completion
        settings["metavar"] = metavar.removesuffix(" ...") or p.name.strip("_").upper()
        if not flags:
            if several:
                settings["nargs"] = "+" if required else "*"
            else:
                settings["nargs"] = None if required else "?"
            return self.add_argument(p.name, help=text, **settings)
        if several and "..." in metavar:
            # Of --data RUN.csv ... all words up to the next option.
            settings |= {"action": "extend", "nargs": "+"}
        elif several:
            settings["action"] = "append"
        if required:
            text += " (required)"
        elif default is not None:
            text += f" (default: {default})"
        return self.add_argument(
            *flags, dest=p.name, required=required, help=text, **settings
        )

    def parse_words(self, words: Sequence[str]) -> dict[str, Any]:
        """Parse the words after a verb.

        Parameters
        ----------
        words : sequence of str
            Positional values and options, in any order.

        Returns
        -------
        dict
            Values by the verb's parameters, with ``quiet``, ``plugin`` and ``json_``
            for every verb.
        """
        known = [flag for option in self._actions for flag in option.option_strings]
        for flag in (word.partition("=")[0] for word in words if word.startswith("--")):
            if flag != "--help":
                require_known("option", flag, known, self.prog.partition(" ")[2])
        joined: list[str] = []
        for word in words:  # what begins like a number is a value: --gravity -9.81,0,0
            if re.match(r"-[\d.]", word) and joined and joined[-1] in known:
                joined[-1] += f"={word}"
            elif word.endswith(".py") and joined[-2:-1] == ["--plugin"]:
                joined += ["--plugin", word]  # --plugin a.py b.py
            else:
                joined.append(word)
        values = vars(self.parse_intermixed_args(joined))
        if runs := values.pop("runs", []):
            values["data"] = [*(values["data"] or []), *runs]
        if self.needs_runs and not values["data"]:
            self.error("no measured run is named (--data)")
        return values

    def error(self, message: str) -> Any:
        """Raise InputError for words that argparse cannot parse, instead of exiting."""
        raise InputError(message, f"such as `{self.example}`; see `{self.prog} --help`")
