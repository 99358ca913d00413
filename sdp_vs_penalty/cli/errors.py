"""What the command line says of an error, and its exit code."""

from __future__ import annotations

import re

import typer

from sdp_vs_penalty.errors import InputError


def explain(error: BaseException) -> tuple[str, int]:
    """One sentence about an error and the exit code that it deserves."""
    if isinstance(error, KeyboardInterrupt | typer.Abort):
        return "interrupted; existing files are unchanged.", 130
    if isinstance(error, InputError):
        return str(error), 2
    if isinstance(error, MemoryError):
        return "not enough memory: use fewer or shorter runs.", 2
    if hasattr(error, "format_message") and hasattr(error, "exit_code"):  # typer's usage errors
        context = getattr(error, "ctx", None)
        verb = "sdp-vs-penalty" if context is None else context.command_path
        return f"{_plain(error.format_message())}; see `{verb} --help`.", int(error.exit_code)
    what = f"{type(error).__name__}: {error}"
    return f"internal error ({what}): run again with --debug and report it.", 1


def _plain(message: str) -> str:
    """A usage error without the words of the library that converts the values."""
    message = " ".join(message.split()).rstrip(".?").replace("Value error, ", "")
    for kind, words in (("integer", "a whole number"), ("number", "a number")):
        message = re.sub(rf"Input should be a valid {kind}\b.*", f"{words} is needed", message)
    return message.replace("Input should be", "it must be")
