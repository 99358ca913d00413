"""Which joint of a robot is which joint of a file, where both name them, perhaps with
other words around the names."""

from collections.abc import Iterator, Sequence
from typing import TypeAlias

from sdp_vs_penalty.data.formats.column_names import split_tokens

Tokens: TypeAlias = tuple[str, ...]
#: What stands around a joint's name: before and behind it in the robot, then in the file.
Frame: TypeAlias = tuple[Tokens, Tokens, Tokens, Tokens]


def match_joints(
    joints: Sequence[str], names_in_file: Sequence[str], *, by_numbers: bool = False
) -> dict[str, str]:
    """Find the file's name of each of the robot's joints.

    Names are compared without marks and capital letters. All names of the robot may have
    the same words around them, and so may all names of the file:
    "ur_elbow_joint" is "left/elbow" where "ur_wrist_joint" is "left/wrist". The words that
    match most joints are taken, of these the fewest.

    >>> match_joints(["turn_joint", "tilt_joint"], ["arm/tilt", "arm/turn"])
    {'turn_joint': 'arm/turn', 'tilt_joint': 'arm/tilt'}

    Parameters
    ----------
    joints : Sequence[str]
        Names of the robot's joints.
    names_in_file : Sequence[str]
        Names of the file's joints.
    by_numbers : bool
        Whether a number is name enough: "axis 2" for "joint_2".

    Returns
    -------
    dict[str, str]
        The file's name by the robot's, for the joints that match. Empty where different
        words match as many joints, as those of two arms do.
    """
    by_letters = {"".join(_tokens(name)): name for name in names_in_file}
    as_they_are = {
        joint: by_letters[letters]
        for joint in joints
        if (letters := "".join(_tokens(joint))) in by_letters
    }
    if as_they_are:
        return as_they_are
    file_by_tokens = {_tokens(name): name for name in names_in_file}
    robot_tokens = {joint: _tokens(joint) for joint in joints}
    frames = {
        frame
        for tokens in robot_tokens.values()
        for other in file_by_tokens
        for frame in _frames(tokens, other, by_numbers)
    }
    best = dict[str, str]()
    best_rank = (0, 0)
    is_clear = True
    for frame in frames:
        matches = {
            joint: file_by_tokens[framed]
            for joint, tokens in robot_tokens.items()
            if (framed := _reframed(tokens, frame)) in file_by_tokens
        }
        rank = (len(matches), -sum(map(len, frame)))
        if rank > best_rank:
            best, best_rank, is_clear = matches, rank, True
        elif rank == best_rank and matches != best:
            is_clear = False
    return best if is_clear else {}


def _tokens(name: str) -> Tokens:
    """Split a name into words and numbers, "01" as "1"."""
    return tuple(
        str(int(x)) if x.isdecimal() and x.isascii() else x for x in split_tokens(name)
    )


def _frames(tokens: Tokens, other: Tokens, by_numbers: bool) -> Iterator[Frame]:
    """Yield what stands around each run of tokens that a robot's and a file's name
    share, and that is not a part of a longer one. A run holds a word, unless numbers are
    name enough."""
    for k in range(len(tokens)):
        for j in range(len(other)):
            if tokens[k] != other[j] or (k and j and tokens[k - 1] == other[j - 1]):
                continue
            n = 1
            while tokens[k + n : k + n + 1] == other[j + n : j + n + 1] != ():
                n += 1
            if by_numbers or any(token.isalpha() for token in tokens[k : k + n]):
                yield tokens[:k], tokens[k + n :], other[:j], other[j + n :]


def _reframed(tokens: Tokens, frame: Frame) -> Tokens | None:
    """Put a joint's tokens into the file's frame; None where they are not in the
    robot's."""
    before, behind, file_before, file_behind = frame
    n_core = len(tokens) - len(before) - len(behind)
    is_framed = (
        tokens[: len(before)] == before and tokens[len(before) + n_core :] == behind
    )
    if n_core < 1 or not is_framed:
        return None
    return (*file_before, *tokens[len(before) : len(before) + n_core], *file_behind)
