"""Robots whose numbers are in other units: mm, cm, g, kg cm^2, or a mixture of these.

Exporters of CAD programs write such files. Each rule compares a number with what arms
that people build can have. Where two units fit the number, the remark names both.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from sdp_vs_penalty.robot.inertia import DENSEST
from sdp_vs_penalty.robot.joint import Joint

#: Longest distance between two joints [m], heaviest link [kg].
LONGEST = 20.0
_HEAVIEST = 3000.0
#: A centre of mass is in another unit if it is farther from its frame than so many times
#: the robot's size, and than this distance [m].
_FAR = 30.0
_AWAY = 3.0
#: An inertia is in another unit if its radius of gyration is so many times the robot's
#: size.
_SPREAD = 10.0
#: A link weighs less than so many times the median of the others, even a base beside a
#: wrist.
_OUTWEIGHS = 300.0
#: Units of lengths, by how many of them are a metre.
_LENGTH_UNITS = {1e2: "cm", 1e3: "mm"}
#: Units of moments of inertia, by how many of them are a kg m^2: those of masses in kg,
#: those of masses in g.
_KILOGRAM_INERTIAS = {1e4: "kg cm^2", 1e6: "kg mm^2"}
_GRAM_INERTIAS = {1e3: "g m^2", 1e7: "g cm^2", 1e9: "g mm^2"}
#: The largest distance between two joints of an arm lies between these [m].
_SHORTEST_ARM = 0.1
_LONGEST_ARM = 3.0
#: A usual link's inertia, estimated from the robot's size, is right within this factor.
_INERTIA_ERROR = 30.0
#: A limit of a revolute joint between these numbers is in degrees: the first is two turns
#: in radians, and numbers above the second stand for "no limit".
_RANGE_IN_DEGREES = 12.6, 1440.0
#: Largest limit of a rail in mm; larger numbers stand for "no limit".
_LONGEST_IN_MM = 1e4
#: The same for speeds. Small drives reach 40 rad/s, motors without a gear 100: a lower
#: speed is in degrees only if the positions of the file are.
_SPEED_IN_DEGREES = 100.0, 1440.0
_SPEED_BESIDE_DEGREES = 12.6, 1440.0
#: If all limits are smaller than this [rad], radians were read as degrees.
_RANGE_READ_AS_DEGREES = 0.12
#: Lightest arm whose dynamics a drive could show [kg].
_LIGHTEST = 1e-3


@dataclass(frozen=True)
class LinkSizes:
    """Sizes of a link, by which its units are judged."""

    #: Name of the link.
    name: str
    #: Mass [kg].
    mass: float
    #: Distance of the centre of mass from the link frame [m].
    com: float
    #: Largest principal moment about the centre of mass [kg m^2].
    inertia: float


@dataclass(frozen=True)
class OddUnit:
    """A quantity of a robot's links that is in another unit than SI."""

    #: "lengths", "masses", "centres of mass" or "inertias".
    quantity: str
    #: Factor by which they are too large in the likeliest unit; None if no unit fits.
    factor: float | None
    #: Names of the links that have it.
    links: tuple[str, ...]
    #: What is wrong, in words.
    what: str
    #: What to do, in words.
    remedy: str


def odd_units(links: Sequence[LinkSizes], longest: float) -> Iterator[OddUnit]:
    """Yield the quantities of a robot's links that are in another unit than SI.

    Parameters
    ----------
    longest : float
        Largest distance between joints [m].

    Yields
    ------
    OddUnit
        One for each of lengths, masses, centres of mass and inertias that is
        implausible.
    """
    known = [x for x in links if x.mass > 0.0 and np.isfinite(x.mass)]
    scale = 1.0
    lengths: Sequence[float] = ()
    if longest > LONGEST:
        units = _length_units(longest, _SHORTEST_ARM, _LONGEST_ARM)
        lengths = list(units)
        scale = 1.0 / lengths[0]
        evidence = f"joints are {longest:.4g} m apart"
        yield _odd("lengths", links=(), evidence=evidence, units=units)
    size = max(longest * scale, 0.05)
    masses = [x.mass for x in known]
    total = sum(masses)
    # Then the inertias are a thousand times too large as well.
    are_all_in_grams = min(masses, default=0.0) > 100.0 and total > 3000.0
    # Where lengths are in another unit, masses may be too: no metal is so dense.
    heaviest = _HEAVIEST if scale == 1.0 else min(_HEAVIEST, DENSEST * size**3)
    in_grams = [
        x
        for x in known
        if x.mass > heaviest or are_all_in_grams or _outweighs(x, known)
    ]
    if in_grams:
        evidence = f"a link weighs {max(x.mass for x in in_grams):.4g} kg"
        yield _odd(
            "masses", links=_names(in_grams), evidence=evidence, units={1e3: "g"}
        )
    centres = list(_odd_centres(known, size))
    yield from centres
    if centres and centres[0].factor is not None:
        lengths = lengths or [centres[0].factor]
    yield from _odd_inertias(known, size, bool(in_grams), lengths)
    if known and total < _LIGHTEST:
        evidence = (
            f"all links together weigh {total:.3g} kg: no drive shows such masses."
        )
        remedy = "check the unit of the masses (kg)"
        names = _names(known)
        yield OddUnit("masses", factor=total, links=names, what=evidence, remedy=remedy)


def odd_limits(joints: Sequence[Joint]) -> str:
    """Say that the limits of a robot's revolute joints are in degrees, that radians were
    read as degrees, or that a rail's are in millimetres.

    Returns
    -------
    str
        A sentence with the joints' names and what to do; "" where half or more of the
        revolute joints have limits that can be in radians, and the others' are no whole
        numbers. A joint without a limit takes no part.
    """
    turning = [joint for joint in joints if joint.kind == "revolute"]
    ranges = {joint.name: max(-joint.lower, joint.upper) for joint in turning}
    speeds = {joint.name: joint.velocity for joint in turning}
    # A joint may turn often: its limits in radians are no whole numbers.
    whole = [x.name for x in turning if x.lower % 1.0 == x.upper % 1.0 == 0.0]
    positions = _in_degrees(ranges, *_RANGE_IN_DEGREES, whole)
    window = _SPEED_BESIDE_DEGREES if positions else _SPEED_IN_DEGREES
    what = {"positions": positions, "velocities": _in_degrees(speeds, *window)}
    found = [
        f"{quantity} ({', '.join(names)})" for quantity, names in what.items() if names
    ]
    rails = {x.name: max(-x.lower, x.upper) for x in joints if x.name not in ranges}
    in_mm = [x for x, reach in rails.items() if LONGEST < reach < _LONGEST_IN_MM]
    if in_mm:
        return (
            f"limits of {', '.join(in_mm)} reach {max(rails[x] for x in in_mm):g} m and"
            " look like millimetres: write metres"
        )
    finite = [x for x in ranges.values() if np.isfinite(x)]
    if len(finite) > 1 and max(finite) < _RANGE_READ_AS_DEGREES:
        return (
            f"no joint turns by more than {max(finite):.2g} rad: these look like radians that"
            ' are read as degrees (an MJCF has degrees unless it says <compiler angle="radian"/>)'
        )
    if not found:
        return ""
    return (
        f"limits of {' and '.join(found)} look like degrees: write radians (degrees"
        " times pi / 180)"
    )


def _in_degrees(
    limits: Mapping[str, float], least: float, most: float, whole: Sequence[str] = ()
) -> list[str]:
    """Return the names of the joints whose limit lies between ``least`` and ``most``: all
    of them if they are more than half of the joints with a limit up to ``most``, else
    only those whose limits are ``whole`` numbers.
    """
    finite = {name: limit for name, limit in limits.items() if limit <= most}
    found = [name for name, limit in finite.items() if limit > least]
    is_most = 2 * len(found) > len(finite)
    return [name for name in found if is_most or name in whole]


def _names(links: Sequence[LinkSizes]) -> tuple[str, ...]:
    """Return the names of links."""
    return tuple(link.name for link in links)


def _length_units(length: float, least: float, most: float) -> dict[float, str]:
    """Return the units in which ``length`` lies between ``least`` and ``most`` [m], mm
    first; mm if it lies there in none."""
    fits = {
        factor: unit
        for factor, unit in sorted(_LENGTH_UNITS.items(), reverse=True)
        if least <= length / factor <= most
    }
    return fits or {1e3: "mm"}


def _odd_centres(links: Sequence[LinkSizes], size: float) -> Iterator[OddUnit]:
    """Yield centres of mass that are too far from their frames for a robot of ``size``
    [m].
    """
    far = [x for x in links if x.com > max(_FAR * size, _AWAY)]
    if far:
        farthest = max(x.com for x in far)
        evidence = f"a centre of mass is {farthest:.4g} m from its link's frame"
        # The farthest centre of mass is at least a tenth of the robot's size away.
        units = _length_units(farthest, 0.1 * size, size)
        yield _odd("centres of mass", links=_names(far), evidence=evidence, units=units)


def _odd_inertias(
    links: Sequence[LinkSizes],
    size: float,
    are_masses_in_grams: bool,
    lengths: Sequence[float],
) -> Iterator[OddUnit]:
    """Yield inertias whose radius of gyration is too large for a robot of ``size`` [m].

    ``lengths``: how many of the file's units of length are a metre, for each unit that
    fits. Where an inertia's unit follows from those of mass and length, only that is
    named.
    """
    spread_out = [x for x in links if _radius(x) > max(_SPREAD * size, 1.0)]
    if not spread_out:
        return
    radii = [_radius(x) for x in spread_out]
    # A usual link has a radius of gyration of 0.3 times the size. Inertias grow with
    # its square; where masses are in g, a thousand times more.
    excess = (float(np.median(radii)) / (0.3 * size)) ** 2
    excess *= 1e3 if are_masses_in_grams else 1.0
    evidence = (
        f"the mass of a link is spread over {max(radii):.4g} m (radius of gyration)"
    )
    units = _inertia_units(excess, are_masses_in_grams)
    coherent = [(1e3 if are_masses_in_grams else 1.0) * x**2 for x in lengths]
    units = {x: units[x] for x in coherent if x in units} or units
    yield _odd("inertias", _names(spread_out), evidence, units)


def _inertia_units(excess: float, are_masses_in_grams: bool) -> dict[float, str]:
    """Return the units, the likeliest first, in which inertias are about ``excess`` times
    too large.

    A file has mostly one unit of mass, for masses and for inertias: units with the mass
    unit of the file come before the others, the nearest first.
    """
    same, other_units = _KILOGRAM_INERTIAS, _GRAM_INERTIAS
    if are_masses_in_grams:
        same, other_units = other_units, same
    fits: dict[float, str] = {}
    for units in (same, other_units):
        for factor in sorted(units, key=lambda f: abs(np.log(excess / f))):
            if abs(np.log(excess / factor)) <= np.log(_INERTIA_ERROR):
                fits[factor] = units[factor]
    return fits


def _outweighs(link: LinkSizes, links: Sequence[LinkSizes]) -> bool:
    """Return whether a link weighs more than 100 kg, and _OUTWEIGHS times the median of
    the others: its mass alone is in g."""
    others = [x.mass for x in links if x is not link]
    return bool(others) and link.mass > max(100.0, _OUTWEIGHS * np.median(others))


def _radius(link: LinkSizes) -> float:
    """Return the radius of gyration of a link [m]."""
    return float(np.sqrt(max(link.inertia, 0.0) / link.mass))


def _odd(
    quantity: str, links: tuple[str, ...], evidence: str, units: Mapping[float, str]
) -> OddUnit:
    """Return an OddUnit with its sentences; its factor is that of the likeliest unit,
    and None if no unit fits.

    ``evidence``: what shows it, in words; ``units``: those that the quantity may be in, the
    likeliest first, by how many of them are one SI unit.
    """
    where = f" ({', '.join(links)})" if links else ""
    factor = next(iter(units), None)
    if not units:
        what = f"the {quantity}{where} are in a unit that is not known: {evidence}."
        return OddUnit(
            quantity, factor, links, what, f"check the unit of the {quantity}"
        )
    names = " or ".join(units.values())
    factors = " or ".join(f"{value:g}" for value in units)
    what = f"the {quantity}{where} look like {names}, {factors} times too large: {evidence}."
    remedy = f"divide the {quantity} by {factors}"
    if len(units) > 1:
        choices = ", ".join(f"{value:g} for {name}" for value, name in units.items())
        remedy = (
            f"look up the unit, then divide the {quantity} by its factor: {choices}"
        )
    return OddUnit(quantity, factor, links, what, remedy)
