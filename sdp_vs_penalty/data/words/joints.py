"""Which joint of a robot is which joint of a file, where both name them, perhaps with
other words around the names."""

import re
from collections.abc import Iterator, Sequence
from typing import TypeAlias

from sdp_vs_penalty.data.words import table
from sdp_vs_penalty.data.words.tokens import n_common, split_tokens

Tokens: TypeAlias = tuple[str, ...]
#: What stands around a joint's name: before and behind it in the robot, then in the file.
Frame: TypeAlias = tuple[Tokens, Tokens, Tokens, Tokens]


#: How a robot's joint is called in a name, before letters that count it.
_HIDDEN = "robotjoint"


def hide_joints(
    names: Sequence[str], joints: Sequence[str]
) -> tuple[dict[str, str], dict[str, str]]:
    """Replace the name of a robot's joint in columns' names by a word without a meaning:
    a joint "torque_motor" says nothing of torque.

    A column may lack what all joints begin or end with: "wrist_1" for
    "left_wrist_1_joint". Returns the new names by the old ones, for the columns that name
    a joint, and the joints by their words.
    """
    full = [split_tokens(joint) for joint in joints]
    # Without the words that all begin with; then without those that all end with.
    short = [x[min(n_common(full), len(x) - 1) :] for x in full]
    turned = [x[::-1] for x in short]
    core = [x[min(n_common(turned), len(x) - 1) :][::-1] for x in turned]
    joint_of, forms = dict[str, str](), list[tuple[int, str, re.Pattern[str]]]()
    for k, joint in enumerate(joints):
        word = _HIDDEN + str(k).translate(str.maketrans("0123456789", "abcdefghij"))
        joint_of[word] = joint
        for form in (full, short, core):
            if len(joints) > 1 and all(any(map(str.isalpha, x)) for x in form):
                text = r"[\W_]*".join(map(re.escape, form[k]))
                pattern = re.compile(rf"(?i)(?<![^\W_]){text}(?![^\W_])")
                forms.append((-len(form[k]), word, pattern))
    # The longest form first: a short one may be a part of it.
    forms.sort(key=lambda x: x[0])
    hidden = dict[str, str]()
    for name in names:
        found = ((x, word) for _, word, x in forms if x.search(name))
        if match := next(found, None):
            # "rail_force" is a joint's force, as "joint_force" is.
            hidden[name] = match[0].sub(f" {match[1]} joint ", name, count=1)
    return hidden, joint_of


def families_of_joints(names: Sequence[str], joints: Sequence[str]) -> list[list[str]]:
    """Collect columns that differ by the name of a joint alone, one of each of two joints or
    more, in their order."""
    hidden, joint_of = hide_joints(names, joints)
    found = dict[str, dict[str, str]]()
    for name, text in hidden.items():
        word = next(x for x in joint_of if f" {x} " in text)
        found.setdefault(text.replace(word, "*"), {})[word] = name
    whole = [x for x in found.values() if len(x) == len(joints) > 1]
    return [[x[word] for word in joint_of] for x in whole]


def match_joints(
    joints: Sequence[str], names_in_file: Sequence[str], *, by_numbers: bool = False
) -> dict[str, str]:
    """Find the file's name of each of the robot's joints that match.

    Names are compared without marks and capital letters. All names of the robot may have
    the same words around them, and so may all names of the file:
    "ur_elbow_joint" is "left/elbow" where "ur_wrist_joint" is "left/wrist". The words that
    match most joints are taken, of these the fewest. With ``by_numbers`` a number is name
    enough: "axis 2" for "joint_2". Empty where different words match as many joints, as
    those of two arms do.

    >>> match_joints(["turn_joint", "tilt_joint"], ["arm/tilt", "arm/turn"])
    {'turn_joint': 'arm/turn', 'tilt_joint': 'arm/tilt'}
    """
    by_letters = {"".join(_tokens(name)): name for name in names_in_file}
    as_they_are = {
        joint: by_letters[letters]
        for joint in joints
        if (letters := "".join(_tokens(joint))) in by_letters
    }
    if as_they_are:
        return as_they_are
    in_file = {_tokens(name): name for name in names_in_file}
    in_robot = {joint: _tokens(joint) for joint in joints}
    frames = {
        frame
        for tokens in in_robot.values()
        for other in in_file
        for frame in _frames(tokens, other, by_numbers)
    }
    best, best_rank, is_clear = dict[str, str](), (0, 0), True
    for frame in frames:
        matches = {
            joint: in_file[framed]
            for joint, tokens in in_robot.items()
            if (framed := _reframed(tokens, frame)) in in_file
        }
        rank = (len(matches), -sum(map(len, frame)))
        if rank > best_rank:
            best, best_rank, is_clear = matches, rank, True
        elif rank == best_rank and matches != best:
            is_clear = False
    return best if is_clear else {}


def in_order_of(
    joints: Sequence[str] | None, names_in_file: Sequence[str]
) -> tuple[dict[str, str], bool]:
    """Put the file's names of joints in the robot's order, by the robot's names, and tell
    whether they match.

    They match where all joints of the robot, or all of the file, are among the others;
    otherwise letters of axes are in the order of these, and the order of the file stays.
    """
    found = match_joints(joints or (), names_in_file, by_numbers=True)
    if found and len(found) in (len(joints or ()), len(names_in_file)):
        return found, True
    letters: str = table()["axis_letters"]
    names = list(names_in_file)
    is_by_letter = len(names) > 1 and {x.lower() for x in names} <= {*letters}
    if is_by_letter:
        names.sort(key=lambda x: letters.index(x.lower()))
    is_known = is_by_letter or not (joints and names)
    return {name: name for name in names}, is_known


def joints_of_heading(lines: Sequence[str], joints: Sequence[str], n: int) -> list[str]:
    """Return the robot's n joints in the order in which one of the lines above a table names
    all of them, "# joints: elbow, shoulder, wrist"; none where no line does."""
    for line in lines if len(joints) == n > 1 else ():
        words = re.findall(r"[^\W\d][\w/.-]*", line)
        names = {y: x for x, y in match_joints(joints, words).items()}
        in_file = [names[x] for x in words if x in names]
        if len(in_file) == n == len({*in_file}):
            return in_file
    return []


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
    end = len(tokens) - len(behind)
    core = tokens[len(before) : end]
    is_framed = tokens[: len(before)] == before and tokens[end:] == behind
    return (*file_before, *core, *file_behind) if is_framed and core else None
