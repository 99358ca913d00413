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
    """Yield the quantities of a robot's links that are in another unit than SI.

    Parameters
    ----------
    links : sequence of LinkSizes
        Links of one robot.
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
    if longest > _LONGEST:
        scale = 1e-3
        yield _odd(
            "lengths",
            factor=1e3,
            links=(),
            how=f"joints are {longest:.4g} m apart",
            unit="mm",
        )
    size = max(longest * scale, 0.05)
    are_all_in_grams = _looks_like_grams(known)
    in_grams = [x for x in known if x.mass > _HEAVIEST or are_all_in_grams]
    if in_grams:
        heaviest = max(x.mass for x in in_grams)
        how = f"a link weighs {heaviest:.4g} kg"
        yield _odd("masses", factor=1e3, links=_names(in_grams), how=how, unit="g")
    yield from _odd_centres(known, size)
    yield from _odd_inertias(known, size, bool(in_grams))
    yield from _odd_total(known)


def _names(links: Sequence[LinkSizes]) -> tuple[str, ...]:
    """Return the names of links."""
    return tuple(link.name for link in links)


def _odd_centres(links: Sequence[LinkSizes], size: float) -> Iterator[OddUnit]:
    """Yield centres of mass that are too far from their frames for a robot of ``size``
    [m].
    """
    far = [x for x in links if x.com > max(_FAR * size, _AWAY)]
    if far:
        farthest = max(x.com for x in far)
        how = f"a centre of mass is {farthest:.4g} m from its link's frame"
        yield _odd("centres of mass", factor=1e3, links=_names(far), how=how, unit="mm")


def _odd_inertias(
    links: Sequence[LinkSizes],
    size: float,
    are_masses_in_grams: bool,
) -> Iterator[OddUnit]:
    """Yield inertias whose radius of gyration is too large for a robot of ``size`` [m]."""
    wide = [x for x in links if _radius(x) > max(_SPREAD * size, 1.0)]
    if not wide:
        return
    radii = [_radius(x) for x in wide]
    # A usual link has a radius of gyration of 0.3 times the size. Inertias grow with
    # its square: the nearest power of 1000 is by how much they are too large.
    excess = float(np.median(radii)) / (0.3 * size)
    factor = min((1e3, 1e6, 1e9), key=lambda f: abs(np.log(excess**2 / f)))
    factor *= 1e3 if are_masses_in_grams else 1.0
    unit = _INERTIA_UNITS.get(factor, "another unit")
    how = f"the mass of a link is spread over {max(radii):.4g} m (radius of gyration)"
    yield _odd("inertias", factor, links=_names(wide), how=how, unit=unit)


def _odd_total(links: Sequence[LinkSizes]) -> Iterator[OddUnit]:
    """Yield one remark if all links together weigh less than _LIGHTEST [kg], which no
    drive's torque could show; its factor is the sum of the masses [kg]."""
    total = sum(x.mass for x in links)
    if links and total < _LIGHTEST:
        how = f"all links together weigh {total:.3g} kg: no drive shows such masses."
        remedy = "check the unit of the masses (kg)"
        yield OddUnit(
            "masses", factor=total, links=_names(links), what=how, remedy=remedy
        )


def _looks_like_grams(links: Sequence[LinkSizes]) -> bool:
    """Return whether all links weigh more than 100 kg, and together more than 3 t.

    Then the inertias are a thousand times too large as well.
    """
    masses = [x.mass for x in links]
    return bool(masses) and min(masses) > 100.0 and sum(masses) > 3000.0


def _radius(link: LinkSizes) -> float:
    """Return the radius of gyration of a link [m]."""
    return float(np.sqrt(max(link.inertia, 0.0) / link.mass))


def _odd(
    quantity: str,
    factor: float,
    links: tuple[str, ...],
    how: str,
    unit: str,
) -> OddUnit:
    """Return an OddUnit with its sentences.

    ``factor``: by which the quantity is too large; ``how``: what shows it; ``unit``: in
    which it seems to be.
    """
    where = f" ({', '.join(links)})" if links else ""
    what = f"the {quantity}{where} look like {unit}, {factor:g} times too large: {how}."
    return OddUnit(
        quantity,
        factor,
        links,
        what,
        remedy=f"divide the {quantity} by {factor:g}",
    )
