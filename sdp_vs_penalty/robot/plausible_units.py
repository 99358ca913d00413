"""Robots whose numbers are in other units: mm, g, g mm^2, or a mixture of these.

Exporters of CAD programs write such files. Each rule compares a number with what arms
that people build can have, by factors of a thousand: nothing in between is judged.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

#: Longest distance between two joints [m], heaviest link [kg].
_LONGEST = 20.0
_HEAVIEST = 3000.0
#: A centre of mass is so many times farther away than the farthest joint, and more than
#: this [m].
_FAR = 30.0
_AWAY = 3.0
#: Radius of gyration over the size of the robot's longest link, or of its centre of mass.
_SPREAD = 10.0
#: Units of moments of inertia, by how many of them are a kg m^2.
_INERTIA_UNITS = {1e3: "g m^2", 1e6: "kg mm^2", 1e9: "g mm^2"}
#: Lightest arm whose dynamics a drive could show [kg].
_LIGHTEST = 1e-3


@dataclass(frozen=True)
class LinkSizes:
    """name; mass [kg]; com : distance of the centre of mass from the link frame [m];
    inertia : largest principal moment about the centre of mass [kg m^2]."""

    name: str
    mass: float
    com: float
    inertia: float


@dataclass(frozen=True)
class OddUnit:
    """quantity : lengths, masses, centres of mass or inertias; factor : by which they
    are too large; links : which; what, remedy : in words."""

    quantity: str
    factor: float
    links: tuple[str, ...]
    what: str
    remedy: str


def odd_units(links: Sequence[LinkSizes], longest: float) -> Iterator[OddUnit]:
    """What is in another unit.

    Parameters
    ----------
    links : of one robot
    longest : distance between joints [m]

    Yields
    ------
    OddUnit
        One a quantity: lengths, masses, centres of mass, inertias.
    """
    known = [x for x in links if x.mass > 0.0 and np.isfinite(x.mass)]
    scale = 1.0
    if longest > _LONGEST:
        scale = 1e-3
        yield _odd("lengths", 1e3, (), f"joints are {longest:.4g} m apart", "mm")
    size = max(longest * scale, 0.05)
    in_grams = [x for x in known if x.mass > _HEAVIEST or _looks_like_grams(x, known)]
    if in_grams:
        heaviest = max(x.mass for x in in_grams)
        how = f"a link weighs {heaviest:.4g} kg"
        yield _odd("masses", 1e3, _names(in_grams), how, "g")
    yield from _odd_centres(known, size)
    yield from _odd_inertias(known, size, bool(in_grams))
    yield from _odd_total(known)


def _names(links: Sequence[LinkSizes]) -> tuple[str, ...]:
    return tuple(link.name for link in links)


def _odd_centres(links: Sequence[LinkSizes], size: float) -> Iterator[OddUnit]:
    """Centres of mass too far from their frames for a robot of this size [m]."""
    far = [x for x in links if x.com > max(_FAR * size, _AWAY)]
    if far:
        farthest = max(x.com for x in far)
        how = f"a centre of mass is {farthest:.4g} m from its link's frame"
        yield _odd("centres of mass", 1e3, _names(far), how, "mm")


def _odd_inertias(
    links: Sequence[LinkSizes],
    size: float,
    are_masses_in_grams: bool,
) -> Iterator[OddUnit]:
    """Inertias that spread a link's mass wider than a robot of this size [m] is."""
    wide = [x for x in links if _radius(x) > max(_SPREAD * size, 1.0)]
    if not wide:
        return
    radii = [_radius(x) for x in wide]
    excess = float(np.median(radii)) / (0.3 * size)
    factor = min((1e3, 1e6, 1e9), key=lambda f: abs(np.log(excess**2 / f)))
    factor *= 1e3 if are_masses_in_grams else 1.0
    unit = _INERTIA_UNITS.get(factor, "another unit")
    how = f"the mass of a link is spread over {max(radii):.4g} m (radius of gyration)"
    yield _odd("inertias", factor, _names(wide), how, unit)


def _odd_total(links: Sequence[LinkSizes]) -> Iterator[OddUnit]:
    """Links that are lighter together than any drive shows."""
    total = sum(x.mass for x in links)
    if links and total < _LIGHTEST:
        how = f"all links together weigh {total:.3g} kg: no drive shows such masses."
        remedy = "check the unit of the masses (kg)"
        yield OddUnit("masses", total, _names(links), how, remedy)


def _looks_like_grams(link: LinkSizes, links: Sequence[LinkSizes]) -> bool:
    """Whether an arm weighs tons and its moments of inertia are a thousand times too
    large with it: each link more than 100 kg."""
    return min(x.mass for x in links) > 100.0 and sum(x.mass for x in links) > 3000.0


def _radius(link: LinkSizes) -> float:
    return float(np.sqrt(max(link.inertia, 0.0) / link.mass))


def _odd(
    quantity: str,
    factor: float,
    links: tuple[str, ...],
    how: str,
    unit: str,
) -> OddUnit:
    where = f" ({', '.join(links)})" if links else ""
    what = f"the {quantity}{where} look like {unit}, {factor:g} times too large: {how}."
    return OddUnit(
        quantity,
        factor,
        links,
        what,
        f"divide the {quantity} by {factor:g}",
    )
