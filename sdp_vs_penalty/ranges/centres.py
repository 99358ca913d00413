"""Ranges of what is not linear in theta: centres of mass, and inertias about them.

A centre of mass is a ratio c = h / m of two linear functions. Its least value is the root v of

    f(v) = least value of (h - v m),

which is concave and falls: Newton's method on it takes v to the ratio at the witness, along
the central path. Where the mass may be zero, no value of c is excluded.

An inertia about the centre of mass is I_e = J_e - h^T Q_e h / m, with Steiner's form Q_e. For
every point u of the link

    I_e = L_u - m (c - u)^T Q_e (c - u),      L_u = J_e - 2 u^T Q_e h + m u^T Q_e u  (linear)

For a moment Q_e >= 0, so that I_aa = min over u of L_u is concave. Its greatest value is
exact, by Schur's complement [[J_aa - t, h_b, h_c], [h_b, m, 0], [h_c, 0, m]] >= 0. Least moments
and products are not convex: with the centre within delta of u, |(c - u)^T Q_e (c - u)| is at most
q = delta^T |Q_e| delta, which gives the outer bounds least (L_u - q m) and greatest (L_u + q m);
and 0 <= I_aa, |I_ab| <= I_cc / 2 hold for every consistent link.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.ranges.allowed import AllowedSet
from sdp_vs_penalty.ranges.ends import End, EndSearch, RangeEnd
from sdp_vs_penalty.robot import constraint as build
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array

#: A mass that may be as small as this share of its greatest value may be zero [-].
_NO_MASS = 1e-6
#: Entries of a link that are moments: Ixx, Iyy, Izz.
_MOMENTS = (4, 6, 9)


#: Open ends: that of the least value by 1.0, that of the greatest one by -1.0.
OPEN = {sign: RangeEnd(-sign * np.inf, "open") for sign in (1.0, -1.0)}


def ratios(
    search: EndSearch,
    numerators: Sequence[Array],
    masses: Sequence[tuple[End, End]],
    denominators: Sequence[Array],
) -> list[tuple[RangeEnd, RangeEnd]]:
    """Return the least and the greatest value of h^T theta / m^T theta; both ends are
    open where the mass m^T theta may be zero.

    Parameters
    ----------
    numerators, denominators : sequences of (p,) arrays
        Coefficients h and m of each ratio.
    masses : sequence of (End, End)
        Least and greatest value of each m.
    """
    # Where the mass may be zero, no value of the ratio is excluded.
    with_mass = [
        k for k, (low, high) in enumerate(masses) if low.value > _NO_MASS * high.value
    ]
    ends = search.least_ends(
        [sign * numerators[k] for k in with_mass for sign in (1.0, -1.0)],
        [denominators[k] for k in with_mass for _ in range(2)],
    )
    ranges = [(OPEN[1.0], OPEN[-1.0])] * len(masses)
    for k, low, high in zip(with_mass, ends[::2], ends[1::2], strict=True):
        h, m = numerators[k], denominators[k]
        least_mass = masses[k][0].value
        below = _ratio(low, h, m, least_mass)
        above = _ratio(high, -h, m, least_mass)  # minus the greatest value
        ranges[k] = below, replace(above, value=-above.value, attained=-above.attained)
    return ranges


def _ratio(end: End, h: Array, m: Array, least_mass: float) -> RangeEnd:
    """Return the least value of the ratio h^T theta / m^T theta.

    ``end`` is the certified least value of g^T theta with g = h - v m, which is about
    zero where v is the least ratio; ``least_mass`` > 0 is the least m^T theta.
    """
    v = float((h - end.g) @ m) / float(m @ m)
    # h^T theta - v m^T theta >= lowest: the ratio is at least v + lowest / (m^T theta).
    return RangeEnd(
        v + min(end.lowest, 0.0) / least_mass,
        end.decided_by,
        end.limited_by,
        attained=float(h @ end.witness) / float(m @ end.witness),
    )


def inertias(
    search: EndSearch,
    link: Array,
    entries: Sequence[int],
    centre: Sequence[tuple[RangeEnd, RangeEnd]],
) -> list[tuple[RangeEnd, RangeEnd]]:
    """Return the range (least, greatest) of inertias I_e about a link's centre of mass.

    The greatest value of a moment is exact. The other ends are outer bounds: the tighter
    one of the bound by the centre's box (:func:`_outer`) and of what holds for every
    consistent link, 0 <= I_aa and |I_ab| <= I_cc / 2.

    Parameters
    ----------
    link : (10,) array of int
        Places of the link's parameters in theta.
    entries : sequence of int
        e, from 4 to 9: Ixx, Ixy, Iyy, Ixz, Iyz, Izz.
    centre : sequence of 3 (RangeEnd, RangeEnd)
        Ranges of the three coordinates of the centre of mass.
    """
    greatest = {e: greatest_moment(search, link, e) for e in _MOMENTS}
    ranges = []
    for e in entries:
        low, high = _outer(search, link, e, centre)
        if e in _MOMENTS:
            zero = RangeEnd(0.0, "consistency", is_outer=True)
            ranges.append((max(low, zero, key=_value), greatest[e]))
            continue
        # A product I_ab; c is the axis across both a and b, numbers 0 to 2.
        a, b = inertia._ROWS[e - 4], inertia._COLUMNS[e - 4]
        moment = greatest[_MOMENTS[3 - a - b]]
        half = RangeEnd(0.5 * moment.value, moment.decided_by, moment.limited_by, True)
        minus = replace(half, value=-half.value)
        ranges.append((max(low, minus, key=_value), min(high, half, key=_value)))
    return ranges


def _value(end: RangeEnd) -> float:
    """Return the value of an end, by which ends are compared."""
    return end.value


def _outer(
    search: EndSearch,
    link: Array,
    entry: int,
    centre: Sequence[tuple[RangeEnd, RangeEnd]],
) -> tuple[RangeEnd, RangeEnd]:
    """Return outer bounds of an inertia I_e about a link's centre of mass c.

    With u the middle of the box in which c lies, I_e = L_u - m (c - u)^T Q_e (c - u), L_u
    linear in theta. The last term is at most q m, so the bounds are the least value of
    L_u - q m and the greatest one of L_u + q m. Both are open if the box is unbounded.
    """
    ends = np.array([[low.value, high.value] for low, high in centre])
    if not np.all(np.isfinite(ends)):
        return OPEN[1.0], OPEN[-1.0]
    Q = inertia.STEINER_FORMS[entry - 4]
    u = ends.mean(axis=1)
    delta = 0.5 * (ends[:, 1] - ends[:, 0])
    q = float(delta @ np.abs(Q) @ delta)
    # Coefficients of L_u and of q m; the link's parameters are m, h = m c, and J.
    linear = np.zeros(len(search.allowed.bound))
    linear[link[0]] = u @ Q @ u
    linear[link[1:4]] = -2.0 * Q @ u
    linear[link[entry]] = 1.0
    uncertain = np.zeros_like(linear)
    uncertain[link[0]] = q
    # The greatest value of L_u + q m is minus the least one of -L_u - q m.
    low, high = (
        RangeEnd(end.lowest, end.decided_by, end.limited_by, is_outer=True)
        for end in search.least_ends([linear - uncertain, -linear - uncertain])
    )
    return low, replace(high, value=-high.value)


def greatest_moment(search: EndSearch, link: Array, entry: int) -> RangeEnd:
    """Return the greatest moment of inertia I_aa about a link's centre of mass.

    It is the greatest t with [[J_aa - t, h_b, h_c], [h_b, m, 0], [h_c, 0, m]] >= 0
    (Schur's complement), t a further parameter, so that the value is exact.

    Parameters
    ----------
    link : (10,) array of int
        Places of the link's parameters in theta.
    entry : int
        Of the moment, 4, 6 or 9.
    """
    with_t = _with_moment_parameter(search.allowed, link, entry)
    minus_t = -np.eye(len(with_t.bound))[-1]
    (end,) = EndSearch(with_t, search.extra_rise).least_ends([minus_t])
    attained = float(end.witness[-1])
    return RangeEnd(-end.lowest, end.decided_by, end.limited_by, attained=attained)


def _with_moment_parameter(allowed: AllowedSet, link: Array, entry: int) -> AllowedSet:
    """Return the set of (theta, t), with a parameter t behind the p others that is at most
    the moment I_aa of a link: Schur's matrix of :func:`greatest_moment` is >= 0."""
    p = len(allowed.bound)
    # The axes b and c across a are those that Steiner's form of I_aa has on its diagonal.
    across = np.flatnonzero(np.diagonal(inertia.STEINER_FORMS[entry - 4]))
    h_b, h_c = link[1 + across]
    # Coefficients (3, 3) of J_aa, h_b, h_c, m and t in Schur's matrix.
    matrices = np.zeros((5, 3, 3))
    matrices[0, 0, 0] = 1.0
    matrices[1, [0, 1], [1, 0]] = 1.0
    matrices[2, [0, 2], [2, 0]] = 1.0
    matrices[3, [1, 2], [1, 2]] = 1.0
    matrices[4, 0, 0] = -1.0
    largest = allowed.bound[link[entry]]
    places = [link[entry], h_b, h_c, link[0], p]
    zero = np.zeros((3, 3))
    schur = build.linear("moment", "a link", places, matrices, zero, cone="psd")
    least = build.linear("moment", "least", [p], [[1.0]], [largest])

    def with_moment(theta: Array) -> Array:
        """Return (theta, t) with half of the moment at theta (p,), strictly inside."""
        h = theta[[h_b, h_c]]
        return np.append(theta, 0.5 * (theta[link[entry]] - h @ h / theta[link[0]]))

    ball = replace(
        allowed.ball,
        A=np.pad(allowed.ball.A, ((0, 0), (0, 1))),
        spread=lambda rows: allowed.ball.spread(rows[:, :p]),
    )
    return replace(
        allowed,
        ball=ball,
        constraints=allowed.constraints.plus([schur, least]),
        bound=np.append(allowed.bound, largest),
        interior=with_moment(allowed.interior),
        fit=with_moment(allowed.fit),
    )
