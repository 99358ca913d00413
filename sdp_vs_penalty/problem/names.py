"""The names of a link's bounds in tables and files: m1, c1x, I1xx, as the paper prints them."""

from __future__ import annotations

#: A link's ten barycentric parameters, in our order.
_BARYCENTRIC = ("m{}", "c{}x", "c{}y", "c{}z", "I{}xx", "I{}xy", "I{}yy", "I{}xz", "I{}yz", "I{}zz")


def barycentric_names(link: int) -> tuple[str, ...]:
    """The names of a link's (from 1) mass, centre of mass and inertia about it, in our order."""
    return tuple(name.format(link) for name in _BARYCENTRIC)


def entries(links: int) -> dict[str, tuple[int, int]]:
    """Where each name stands in a problem's box: link (from 0) and entry."""
    return {
        name: (link, entry)
        for link in range(links)
        for entry, name in enumerate(barycentric_names(link + 1))
    }
