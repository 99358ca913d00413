"""The one exception a user is meant to see."""


class InputError(ValueError):
    """What the user gave cannot be used.

    The message is one sentence: the file, the row or field, what is wrong, what to do. The command
    line prints it and exits with code 2.
    """
