"""Effects in plain words: their names, and what one of a fitted size is on the arm."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import asin, degrees, hypot, radians, sqrt

from sdp_vs_penalty import formatting
from sdp_vs_penalty.effects import EFFECTS
from sdp_vs_penalty.effects.written import WrittenEffect, read_effect
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.robot import STANDARD_GRAVITY

#: Half a 95 % interval, relative to the size, from which a sentence says the interval.
WIDE = 0.3
#: How a sentence of :func:`on_the_arm` begins.
ON_THE_ARM = "On the arm: "
#: Parameters of a joint's misplacement.
_PLACE = re.compile(r"(?P<kind>slip|turn)_[xyz](?P<joint>\d+)")


def effect_name(name: str) -> str:
    """Name of an effect as it stands within a sentence.

    Parameters
    ----------
    name : str
        The effect's name in commands and files.

    Examples
    --------
    >>> effect_name("joint_spring"), effect_name("presliding_hysteresis")
    ('joint spring', 'pre-sliding hysteresis')
    """
    kind = EFFECTS.find(name)
    return name.replace("_", " ") if kind is None else kind.in_words


def effect_in_words(text: str) -> str:
    """Translate an effect from its written form into words of a sentence.

    Parameters
    ----------
    text : str
        Name, joints and shape constants, such as "joint_spring:4".

    Returns
    -------
    str
        Words for a sentence; the text itself where it is no written effect.

    Examples
    --------
    >>> effect_in_words("joint_spring:4"), effect_in_words("base_tilt")
    ('joint spring on joint 4', 'base tilt')
    >>> effect_in_words("stribeck_friction:1@vs=0.0436203@law=dip")
    'Stribeck friction on joint 1 (vs 0.0436, law dip)'
    """
    written = _read(text)
    return text if written is None else written_in_words(written)


def written_in_words(written: WrittenEffect) -> str:
    """Say an effect with its joints and shape constants in words of a sentence."""
    words = effect_name(written.name)
    if written.joints:
        words += f" on {formatting.joints(written.joints)}"
    if written.constants:
        values = [f"{key} {_short(value)}" for key, value in written.constants.items()]
        words += f" ({', '.join(values)})"
    return words


def effects_in_words(texts: Sequence[str]) -> str:
    """Effects as they are written for a command, in words, each once with all its joints.

    Parameters
    ----------
    texts : sequence of str
        Names with joints and shape constants.

    Examples
    --------
    >>> effects_in_words(["stiction:3@d=0.1", "base_tilt", "stiction:4@d=0.2"])
    'stiction on joints 3 and 4 and base tilt'
    """
    joints_by_name: dict[str, set[int]] = {}
    for text in texts:
        written = _read(text)
        name = written.name if written else text
        joints_by_name.setdefault(name, set()).update(written.joints if written else ())
    words = list[str]()
    for name, joints in joints_by_name.items():
        where = f" on {formatting.joints(sorted(joints))}" if joints else ""
        words.append(effect_name(name) + where)
    return formatting.words(words) if words else ""


def _read(text: str) -> WrittenEffect | None:
    """Return the parts of a written effect, or None for another text."""
    try:
        written = read_effect(text)
    except InputError:
        return None
    return written if written.name.isidentifier() else None


def _short(value: str) -> str:
    """Round the value of a shape constant to three digits; a word stays as it is."""
    try:
        return formatting.number(float(value))
    except ValueError:
        return value


@dataclass(frozen=True)
class FittedEffect:
    """An effect with the size that a fit gives it."""

    #: Name of the effect in commands and files.
    name: str
    #: Numbers of the joints, from 1; empty for the whole robot.
    joints: Sequence[int]
    #: Size of the effect, in ``unit``.
    size: float
    #: Unit of the size, such as "N*m".
    unit: str
    #: Fitted values by the parameters' names, in SI units.
    parameters: Mapping[str, float]
    #: Shape constants by name, in SI units.
    shape: Mapping[str, float]
    #: Significant digits of the size.
    digits: int = 2
    #: Half the 95 % interval of the size, in ``unit``; 0 where it is not known.
    half_width: float = 0.0
    #: Unit of the joint's torque, as sentences have it; "": N m, or N if it slides.
    torque_unit: str = ""


class _Sign:
    """A number that chooses between two words in a format string:
    f"{sign:more|less}"."""

    def __init__(self, value: float) -> None:
        """Keep the number whose sign chooses."""
        self.value = value

    def __format__(self, words: str) -> str:
        """Return the first of two words, "more|less", for a number from 0 on, else the
        second."""
        positive, _, negative = words.partition("|")
        return positive if self.value >= 0.0 else negative


def on_the_arm(fitted: FittedEffect) -> str:
    """Explain to a mechanical engineer what a fitted effect means on the arm.

    Returns
    -------
    str
        A sentence that begins with "On the arm:".

    Examples
    --------
    >>> spring = FittedEffect("joint_spring", (4,), 3.1, "N*m/rad", {"k_s4": 3.1}, {})
    >>> on_the_arm(spring)[:62]
    'On the arm: joint 4 is pulled back as by a spring of 3.1 N m/r'
    """
    kind = EFFECTS.find(fitted.name)
    default = f"{{joint}} has {effect_name(fitted.name)} of {{size}}"
    sentence = (kind and kind.on_the_arm) or default
    if kind and fitted.torque_unit not in ("", "N m", "N"):
        sentence = kind.on_the_arm_unscaled or sentence
    return f"{ON_THE_ARM}{sentence.format(**_fields(fitted))}."


def _fields(fitted: FittedEffect) -> dict[str, object]:
    """Return what fills the placeholders of an effect's sentence ``on_the_arm``.

    Example: {"joint": "joint 4", "size": "3.1 N m/rad", "travel": "0.5°", ...}. All
    placeholders are computed, although a sentence uses only some of them.
    """

    def with_unit(value: float) -> str:
        """Format a number with the digits and the unit of the effect's size."""
        return f"{formatting.number(value, fitted.digits)} {unit}".rstrip()

    def with_interval(in_words: Callable[[float], str]) -> str:
        """Say the size, or a multiple of it, and of a rough one its interval."""
        text = in_words(size)
        if fitted.half_width <= WIDE * size:
            return text
        ends = (size - fitted.half_width, size + fitted.half_width)
        low, high = (re.split("[ °]", in_words(x))[0] for x in ends)
        return f"about {text} ({low} to {high})"

    size = abs(fitted.size)
    unit = formatting.plain_unit(fitted.unit)
    # A prismatic joint is known by the unit: forces in place of torques.
    is_slide = fitted.unit in ("N", "m", "kg", "m/N")
    is_slide |= fitted.unit.startswith(("N/", "N*s", "N*("))
    # The joint (from 1) whose motion acts on this one; 0 for the neighbour.
    source = fitted.shape.get("i", 0.0)
    torque = fitted.torque_unit or ("N" if is_slide else "N m")
    return {
        "joint": formatting.joints(fitted.joints) if fitted.joints else "the arm",
        "other": f"joint {source:.0f}" if source else "the joint beside it",
        "size": with_interval(with_unit),
        "twice": with_interval(lambda x: with_unit(2.0 * x)),
        "signed": with_unit(fitted.size),
        "sign": _Sign(fitted.size),
        "share": with_interval(lambda x: formatting.percent(x, fitted.digits)),
        "time": with_interval(lambda x: formatting.milli(x, "s", 2)),
        "length": with_interval(lambda x: length_or_angle(x, is_slide)),
        "torque": torque,
        "travel": length_or_angle(fitted.shape.get("d", 0.0), is_slide),
        "place": _place(fitted.shape, is_slide),
        "alpha": formatting.number(fitted.shape.get("alpha", 1.0), 2),
        "per_degree": ""
        if is_slide
        else f" ({formatting.number(radians(size), 2)} {torque} for each degree)",
        "waves": _waves(fitted.shape.get("k", 0.0), is_slide),
        "tilt": _tilt(fitted.parameters),
        "towards": _direction(fitted.parameters),
        "slip": _largest_slip(fitted.parameters),
    }


def length_or_angle(value: float, is_slide: bool) -> str:
    """Format a joint's position [rad or m] in the units of engineers: degrees, or
    millimetres if it is prismatic.

    Examples
    --------
    >>> length_or_angle(0.00873, False), length_or_angle(0.0012, True)
    ('0.5°', '1.2 mm')
    """
    if is_slide:
        return formatting.milli(value, "m", 2)
    return f"{formatting.number(degrees(value), 2)}°"


def _place(shape: Mapping[str, float], is_slide: bool) -> str:
    """Format where a joint touches its stop, from the shape constants q0 [rad, m] and
    side (1 above q0, 2 below it)."""
    side = "below" if shape.get("side") == 2.0 else "above"
    return f"{side} {length_or_angle(shape.get('q0', 0.0), is_slide)}"


def _waves(k: float, is_slide: bool) -> str:
    """Format how often a torque repeats in a turn, from its wave number k; nothing for
    a prismatic joint, or without waves."""
    if is_slide or not k:
        return ""
    return f", {formatting.number(k)} times per turn"


def _components(parameters: Mapping[str, float]) -> list[tuple[str, float]]:
    """List the components of a tilt (g_x ...) or a force (F_x ...) as pairs of axis and
    value."""
    return [
        (name.rpartition("_")[2], value)
        for name, value in parameters.items()
        if name.startswith(("g_", "F_"))
    ]


def _tilt(parameters: Mapping[str, float]) -> str:
    """Format the angle by which the base is tilted: asin(g_across / 9.81).

    ``parameters`` are the components of gravity [m/s^2] perpendicular to the direction
    that the model assumes, such as {"g_x": 0.1, "g_y": 0.0}.
    """
    across = hypot(*(value for _, value in _components(parameters)))
    angle = degrees(asin(min(across / abs(STANDARD_GRAVITY[2]), 1.0)))
    return f"{formatting.number(angle, 2)}°"


def _direction(parameters: Mapping[str, float]) -> str:
    """Name the axes along which a tilt or a force points, the largest first: "+x and
    -z".

    Components below a third of the largest are left out.
    """
    components = sorted(_components(parameters), key=lambda part: -abs(part[1]))
    if not components:
        return "one side"
    largest = abs(components[0][1])
    named = [
        f"{'+' if value >= 0.0 else '-'}{axis}"
        for axis, value in components
        if abs(value) > largest / 3.0 or abs(value) == largest
    ]
    return formatting.words(named)


def _largest_slip(parameters: Mapping[str, float]) -> str:
    """Format the largest displacement and the largest rotation of any joint's mounting.

    A joint's displacement is the length of its components slip_x, slip_y and slip_z
    [m], its rotation that of turn_x, turn_y and turn_z [rad]. "little" without any.
    """
    # Sum of the squared components, by kind and joint.
    squares: dict[tuple[str, str], float] = {}
    for name, value in parameters.items():
        match = _PLACE.fullmatch(name)
        if match is not None:
            place = (match["kind"], match["joint"])
            squares[place] = squares.get(place, 0.0) + value**2
    displacements = [sqrt(x) for (kind, _), x in squares.items() if kind == "slip"]
    rotations = [sqrt(x) for (kind, _), x in squares.items() if kind == "turn"]
    largest = list[str]()
    if displacements:
        largest.append(length_or_angle(max(displacements), is_slide=True))
    if rotations:
        largest.append(length_or_angle(max(rotations), is_slide=False))
    return formatting.words(largest) if largest else "little"
