"""Errors that a user is meant to see: data, of which one sentence is made."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Self

#: Characters of a sentence about an error.
_LONGEST = 1500


def printable(text: object) -> str:
    r"""Return a text as one line without control characters.

    Control characters, line ends and bytes of a file name that are no text are written
    as Python escapes.

    Returns
    -------
    str
        One line that cannot move a terminal's cursor.

    Examples
    --------
    >>> printable("a\x1b[2J\nb\udcff")
    'a\\x1b[2J\\nb\\xff'
    """
    plain = str(text)
    if plain.isprintable():
        return plain
    return "".join(c if c.isprintable() else _escaped(c) for c in plain)


def _escaped(character: str) -> str:
    r"""Write a character as a Python escape; a byte of a file name (PEP 383) as \xNN."""
    number = ord(character)
    if 0xDC80 <= number <= 0xDCFF:  # how Python keeps a byte of a name (PEP 383)
        return f"\\x{number - 0xDC00:02x}"
    return character.encode("unicode_escape").decode()


def command_line(words: Iterable[object]) -> str:
    r"""Quote words for a shell, in one printable line that can be pasted.

    Parameters
    ----------
    words : iterable
        Program and arguments; a path that begins with a dash gets "./" before it.

    Examples
    --------
    >>> command_line(["check", "my run.csv", "$(reboot)", "a\nb"])
    "check 'my run.csv' '$(reboot)' $'a\\x0ab'"
    """
    return " ".join(map(_shell_word, words))


def _shell_word(word: object) -> str:
    """Quote a word for a shell; if it holds control characters, as $'...' with
    escapes.
    """
    import shlex

    text = str(word)
    if isinstance(word, os.PathLike) and text.startswith("-"):
        text = f"./{text}"  # a file, and no option
    if text.isprintable():
        return shlex.quote(text)
    # Bash, zsh and POSIX.1-2024 read escapes in $'...', other bytes one by one.
    content = text.encode("utf-8", "surrogateescape")
    return f"$'{''.join(map(_shell_byte, content))}'"


def _shell_byte(byte: int) -> str:
    r"""Write a byte inside of $'...': a printable character as it is, another one as
    \xNN.
    """
    if 0x20 <= byte < 0x7F and byte not in b"\\'":
        return chr(byte)
    return f"\\x{byte:02x}"


class InputError(ValueError):
    """What the user gave cannot be used.

    Its text is one sentence, "where: what: remedy (command).", which the command line
    prints before it exits with code 2.

    Parameters
    ----------
    what : str
        What is wrong.
    remedy : str
        What to do about it.
    where : str or Path, optional
        The file, row, field or option.
    command : str
        The command or option that does it.

    Examples
    --------
    >>> str(InputError("row 3 is empty", "delete it", "run.csv"))
    'run.csv: row 3 is empty: delete it.'
    """

    def __init__(
        self, what: str, remedy: str = "", where: Any = None, command: str = ""
    ) -> None:
        """Compose the sentence, at most 1500 characters long.

        Parameters
        ----------
        what : str
            What is wrong, as a clause.
        remedy : str
            What the user can do about it.
        where : str or Path, optional
            The file, row, field or option.
        command : str
            The command or option that does it.
        """
        self.what = what
        self.remedy = remedy
        self.where = where
        self.command = command
        super().__init__(self._sentence(command))

    def _sentence(self, command: str) -> str:
        """Return the sentence with a command or without."""
        text = self.what if self.where is None else f"{self.where}: {self.what}"
        if self.remedy:
            text += f": {self.remedy}{f' ({command})' if command else ''}."
        text = printable(text)  # names out of a broken file may hold anything
        return text if len(text) <= _LONGEST else f"{text[:_LONGEST]} ..."

    @property
    def without_command(self) -> str:
        """The sentence for a reader without a command line."""
        return self._sentence("")

    def within(self, where: Any) -> Self:
        """Return the same error with its place extended by what contains it.

        For an error at a field, ``where`` is the file that holds the field.
        """
        outer = type(self).__new__(type(self))
        outer.__dict__.update(self.__dict__)
        outer.where = where if self.where is None else f"{where}: {self.where}"
        outer.args = (outer._sentence(outer.command),)
        return outer


class RepairableError(InputError):
    """Measurements that cannot be used as they are, and that `check --fix` can repair.

    - ``apply``: the words of `--apply` that the repair needs, if any.
    - ``is_known``: whether the repair is known before the check has compared several.
    """

    def __init__(
        self,
        what: str,
        remedy: str = "",
        where: Any = None,
        apply: tuple[str, ...] = (),
        is_known: bool = True,
    ) -> None:
        """Compose the sentence of an InputError, and keep what `check --fix` needs.

        - ``apply``: words for the option `--apply`, without which the repair is not
          made.
        - ``is_known``: False where only the check tells which repair is right.
        """
        super().__init__(what, remedy, where)
        self.apply = apply
        self.is_known = is_known


class Terminated(KeyboardInterrupt):
    """The system asks this process to end (SIGTERM)."""


class Remark(UserWarning):
    """What the user should know of the data and need not act on; the command line
    prints it."""


class ColumnsRemark(Remark):
    """What the columns of a file were taken for.

    Parameters
    ----------
    sentence : str
        What was taken for what, and the command that repeats it.
    rows : tuple of str
        The first rows as they were read, a line a channel.
    rename, torques : mapping
        The file's columns by our names, as they were taken; and those of each other set
        of torques of the same joints, by its name.
    """

    def __init__(
        self,
        sentence: str,
        rows: tuple[str, ...] = (),
        rename: Mapping[str, str] | None = None,
        torques: Mapping[str, Mapping[str, str]] | None = None,
    ) -> None:
        """Store the sentence, the first rows as they were read, and what was taken."""
        super().__init__(sentence)
        self.rows = rows
        self.rename = dict(rename or {})
        self.torques = dict(torques or {})


class Infeasible(InputError):  # noqa: N818 (the field's word)
    """The constraints admit no parameters. told : as of InputError.

    - ``families``: those that exclude each other.
    - ``proof``: the problem without data and the multipliers that prove it (Farkas),
      where they do: then nothing satisfies all constraints; without, they leave no room
      at best.
    """

    def __init__(
        self,
        *arguments: Any,
        families: Sequence[str] = (),
        proof: tuple[Any, Any] | None = None,
    ) -> None:
        """Compose the sentence of an InputError, and keep the proof of infeasibility.

        Parameters
        ----------
        *arguments : Any
            Those of InputError: what, remedy, where.
        families : sequence of str
            Families of constraints that exclude each other.
        proof : tuple, optional
            The problem without data, and multipliers that prove infeasibility (Farkas).
        """
        super().__init__(*arguments)
        self.families = tuple(families)
        self.proof = proof


class MissingJoints(InputError):  # noqa: N818 (what is missing)
    """A log that lacks joints of the robot; joints : their names."""

    def __init__(self, joints: Sequence[str], where: Any) -> None:
        """Name the joints without a column, and how to hold them if they did not
        move.
        """
        self.joints = tuple(joints)
        is_or_are = "is" if len(joints) == 1 else "are"
        held = ",".join(f"{name}=0" for name in joints)
        it_or_them = "it" if len(joints) == 1 else "them"
        what = f"{', '.join(joints)} {is_or_are} in no column"
        remedy = f"where nothing moves there, hold {it_or_them}"
        super().__init__(what, remedy, where, f"--hold {command_line([held])}")


def require_known(
    kind: str, name: object, known: Iterable[object], where: Any = None
) -> None:
    """Raise InputError for a name that does not exist, and suggest the most similar
    one.

    Parameters
    ----------
    kind : str
        What the names are, for the sentence.
    name : object
        The name to look up.
    where : Any
        Place of the name: a file or a field.

    Examples
    --------
    >>> require_known("table", "VI", ["IV", "VIII"])
    Traceback (most recent call last):
    sdp_vs_penalty.errors.InputError: table 'VI' is unknown: did you mean VIII? There are: IV, VIII.
    """
    all_names = list(known)
    if name in all_names:
        return
    import difflib

    texts = [str(known_name) for known_name in all_names]
    similar = difflib.get_close_matches(str(name), texts, 1)
    guess = f"did you mean {similar[0]}? There are" if similar else "there are"
    raise InputError(
        f"{kind} {name!r} is unknown".strip(), f"{guess}: {', '.join(texts)}", where
    )


def unreadable(error: Exception, where: Any) -> InputError:
    """Return the error for a file that the operating system does not let us read.

    Returns
    -------
    InputError
        One sentence that names the reason.
    """
    why = getattr(error, "strerror", None) or error
    return InputError(
        f"cannot be read ({why})", "check its name and your right to read it", where
    )


def other_robot(
    joints: int,
    expected: int,
    where: Any,
    choose: str = "problem",
    names: Sequence[str] = (),
) -> InputError:
    """Return the error for data or a model with another number of joints than the
    robot.

    Parameters
    ----------
    joints : int
        Number of joints of the data or model.
    expected : int
        Number of joints of the robot.
    choose : str
        What the user should choose instead.
    names : sequence of str
        Names of the robot's joints. If as many of them as are missing sound like a
        gripper or a wheel, the sentence proposes to hold these.

    Examples
    --------
    >>> str(other_robot(1, 7, "run.csv"))
    'run.csv: 1 joint, the robot has 7: choose the problem that belongs to it.'
    """
    have = f"{joints} joint{'' if joints == 1 else 's'}"
    remedy, command = f"choose the {choose} that belongs to it", ""
    words_of_tools = "finger|grip|knuckle|jaw|claw|hand|wheel|caster|drive|thumb"
    tools = [name for name in names if re.search(words_of_tools, name, re.IGNORECASE)]
    n_missing = expected - joints
    if 0 < n_missing == len(tools):
        command = f"--hold {command_line([','.join(f'{name}=0' for name in tools)])}"
        remedy += f", or hold {' and '.join(tools)}, if they did not move"
    elif n_missing > 0 and names:
        command = "--hold NAME=0"
        remedy += f", or hold what did not move of {', '.join(names)}"
    return InputError(f"{have}, the robot has {expected}", remedy, where, command)


def install_command(extra: str) -> str:
    """Return the command that installs an optional part, from the package or a
    checkout."""
    return (
        f"pip install 'sdp-vs-penalty[{extra}]' (in a checkout: pip install"
        f" '.[{extra}]')"
    )


def missing_extra(what: str, extra: str) -> InputError:
    """Return the error for a verb whose optional part is not installed.

    Parameters
    ----------
    what : str
        What needs the part, as the beginning of the sentence ("Plots need").

    Returns
    -------
    InputError
        One sentence with the command that installs it.
    """
    return InputError(f"{what} the extra [{extra}]", install_command(extra))


def quote_value(value: object) -> str:
    """Return a value as an error message shows it: one line of at most 60
    characters.
    """
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:57]}..."
