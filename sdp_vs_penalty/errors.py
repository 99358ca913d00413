"""The one exception a user is meant to see."""


class InputError(ValueError):
    """What the user gave cannot be used.

    The message is one sentence: the file, the row or field, what is wrong, what to do. The command
    line prints it and exits with code 2.
    """


def install_command(extra: str) -> str:
    """What installs an optional part, for those who have the package and for those with a checkout."""
    return f"pip install 'sdp-vs-penalty[{extra}]' (in a checkout: pip install '.[{extra}]')"


def missing_extra(what: str, extra: str) -> InputError:
    """The error of a verb whose optional part is not installed; ``what`` needs it."""
    return InputError(f"{what} the extra [{extra}]: {install_command(extra)}.")


def given(value: object) -> str:
    """A value as a message shows it: short, on one line."""
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:57]}..."
