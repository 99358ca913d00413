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
    """What is in another unit, of links and the longest distance between joints [m]."""
    known = [x for x in links if x.mass > 0.0 and np.isfinite(x.mass)]
    scale = 1.0
    if longest > _LONGEST:
        scale = 1e-3
        yield _odd("lengths", 1e3, (), f"joints are {longest:.4g} m apart", "mm")
    size = max(longest * scale, 0.05)
    in_grams = [x for x in known if x.mass > _HEAVIEST or _looks_like_grams(x, known)]
    if in_grams:
        most = max(x.mass for x in in_grams)
        names = tuple(x.name for x in in_grams)
        yield _odd("masses", 1e3, names, f"a link weighs {most:.4g} kg", "g")
    far = [x for x in known if x.com > max(_FAR * size, _AWAY)]
    if far:
        most = max(x.com for x in far)
        names = tuple(x.name for x in far)
        how = f"a centre of mass is {most:.4g} m from its link's frame"
        yield _odd("centres of mass", 1e3, names, how, "mm")
    wide = [(x, _radius(x)) for x in known]
    wide = [(x, r) for x, r in wide if r > max(_SPREAD * size, 1.0)]
    if wide:
        most = max(r for _, r in wide)
        names = tuple(x.name for x, _ in wide)
        typical = float(np.median([r for _, r in wide])) / (0.3 * size)
        factor = min((1e3, 1e6, 1e9), key=lambda f: abs(np.log(typical**2 / f)))
        factor *= 1e3 if in_grams else 1.0
        unit = _INERTIA_UNITS.get(factor, "another unit")
        how = f"the mass of a link is spread over {most:.4g} m (radius of gyration)"
        yield _odd("inertias", factor, names, how, unit)
    total = sum(x.mass for x in known)
    if known and total < _LIGHTEST:
        yield OddUnit(
            "masses",
            total,
            tuple(x.name for x in known),
            f"all links together weigh {total:.3g} kg: no drive shows such masses.",
            "check the unit of the masses (kg)",
        )


def _looks_like_grams(link: LinkSizes, links: Sequence[LinkSizes]) -> bool:
    """Whether an arm weighs tons and its moments of inertia are a thousand times too
    large with it: each link more than 100 kg."""
    return min(x.mass for x in links) > 100.0 and sum(x.mass for x in links) > 3000.0


def _radius(link: LinkSizes) -> float:
    return float(np.sqrt(max(link.inertia, 0.0) / link.mass))


def _odd(
    quantity: str, factor: float, links: tuple[str, ...], how: str, unit: str
) -> OddUnit:
    where = f" ({', '.join(links)})" if links else ""
    what = f"the {quantity}{where} look like {unit}, {factor:g} times too large: {how}."
    return OddUnit(
        quantity, factor, links, what, f"divide the {quantity} by {factor:g}"
    )
