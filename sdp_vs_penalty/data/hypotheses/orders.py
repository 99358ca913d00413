"""Which of several columns without names is which channel: hypotheses that the values weigh.

A clock and a counter of rows rise steadily and stand at an end. The others are k columns
of each of n joints, channel by channel or joint by joint. Velocities are the derivative of
positions; torques are among the rest.
"""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np

from sdp_vs_penalty.data.log import ROWS_JUDGED
from sdp_vs_penalty.robot.arrays import Array, Arrays

#: Steps of a clock are so many times the usual one, in nine of ten.
_USUAL_STEPS = 0.5, 1.5
#: A step of so many usual ones is a leap, and such a share of the rows is nearly all.
_LEAP, _NEARLY_ALL = 1e3, 0.9
#: Squared correlation of steps and velocities from which one is the other's derivative,
#: and what noise leaves of it.
_IS_DERIVATIVE, _NOISE = 0.8, 1e-3
#: Share of its spread by which a channel moves within the steps that are compared.
_MOVED = 0.1
#: How usual other orders than q, dq, tau are, columns that are none of these, and torques
#: that are the derivative of velocities.
_OTHER_ORDER, _UNUSED, _ACCELERATION = 0.3, 0.1, 0.01
#: Of more columns a joint nothing tells which is which.
_MOST_COLUMNS = 8


@dataclass(frozen=True)
class Layout:
    """One answer to what columns without names are."""

    #: The file's names by ours.
    names: dict[str, str]
    #: Its odds, but for a factor that all answers share.
    weight: float

    @property
    def is_supported(self) -> bool:
        """Whether the values alone speak for it: it leaves out no block of columns, or
        has velocities that are the positions' derivative."""
        return self.weight > _UNUSED


def layouts(
    columns: Arrays,
    n_joints: int | None,
    known: Collection[str] = (),
    t: Array | None = None,
) -> list[Layout]:
    """Return what columns (N,) without names can be by their values, the likeliest first.

    Parameters
    ----------
    n_joints : int or None
        The robot's joints; None where they are not known.
    known : collection of str
        Those of q, dq and tau that other columns are.
    t : (N,) array, optional
        The clock that another column is.
    """
    judged = {x: np.ravel(y)[:ROWS_JUDGED] for x, y in columns.items()}
    rows = _steady_rows([*judged.values()] if t is None else [np.ravel(t)])
    columns = {x: y[rows] for x, y in judged.items()}
    t = None if t is None else np.ravel(t)[rows]
    found = list[Layout]()
    for clock, names in _with_clock(columns, is_known=t is not None):
        stamps = columns[clock] if clock else t
        # Without a robot each joint has three columns, or two.
        width = len(names)
        counts = [width // k for k in (3, 2) if width % k == 0]
        for n in [n_joints] if n_joints else counts:
            if width == 0 or width % n:
                continue
            for layout in _of_joints(columns, names, n, known, stamps):
                # A counter of rows is none: velocities tell the rate.
                is_clock = clock is not None and not counts_rows(columns[clock])
                t_of = {"t": clock} if clock and is_clock else {}
                found.append(Layout({**t_of, **layout.names}, layout.weight))
    return sorted(found, key=lambda x: -x.weight)


def _steady_rows(columns: Sequence[Array]) -> slice:
    """Return the rows that values are judged by: of the first and the last column (N,) the
    longest stretch in which one of them never falls nor leaps, if that is nearly all rows;
    else all.

    Rows at the ends are often no samples: a recorder starts, or stops, inside a packet.
    """
    for values in (columns[0], columns[-1]) if columns else ():
        values = values[:ROWS_JUDGED]
        with np.errstate(over="ignore", invalid="ignore"):
            steps = np.diff(values)
        rising = steps[steps > 0.0]
        if not len(rising):
            continue
        is_steady = (steps >= 0.0) & (steps < _LEAP * np.median(rising))
        edges = np.flatnonzero(np.concatenate([[True], ~is_steady, [True]]))
        longest = int(np.argmax(np.diff(edges)))
        first, end = edges[longest : longest + 2].tolist()
        if end - first > _NEARLY_ALL * len(values):
            return slice(first, end)
    return slice(None)


def _with_clock(
    columns: Arrays, *, is_known: bool
) -> Iterator[tuple[str | None, list[str]]]:
    """Yield each column that may be the clock, None without one, and the columns of joints:
    those between a clock and a counter of rows at the ends."""
    names = list(columns)
    rising = {x for x in names if rises(columns[x])}
    ends = [
        names[:before] + names[len(names) - behind :]
        for before in (0, 1, 2)
        for behind in (0, 1, 2)
        if before + behind < min(3, len(names))
    ]
    ends = [x for x in ends if {*x} <= rising]
    most = max(map(len, ends), default=0)
    for outer in (x for x in ends if len(x) == most):
        clocks = [x for x in outer if not counts_rows(columns[x])] or outer
        inner = [x for x in names if x not in outer]
        yield clocks[0] if clocks and not is_known else None, inner


def rises(values: Array) -> bool:
    """Tell whether a column (N,) never falls, and rises mostly by the same step."""
    steps = np.diff(values)
    rising = steps[steps > 0.0]
    if len(rising) < 2 or not np.all(steps >= 0.0):
        return False
    least, most = np.multiply(_USUAL_STEPS, np.median(rising))
    return bool(np.mean((rising > least) & (rising < most)) > 0.9)


def counts_rows(values: Array) -> bool:
    """Tell whether a column (N,) counts rows, of which few were lost or come twice."""
    steps = np.diff(values)
    is_one = np.count_nonzero(steps == 1.0) > _NEARLY_ALL * len(steps)
    return bool(is_one and np.all(steps >= 0.0))


def _of_joints(
    columns: Arrays,
    names: Sequence[str],
    n: int,
    known: Collection[str],
    t: Array | None,
) -> Iterator[Layout]:
    """Yield what k columns of each of n joints can be, group by group or joint by joint."""
    k = len(names) // n
    if k > _MOST_COLUMNS:
        return
    places = np.arange(k * n)
    arrangements = [(places.reshape(k, n), 1.0), (places.reshape(n, k).T, _OTHER_ORDER)]
    arrangements = arrangements if min(k, n) > 1 else arrangements[:1]
    wanted = [x for x in ("q", "dq", "tau") if x not in known]
    without = [x for x in wanted if x != "dq"]
    found = list[tuple[list[list[str]], float, dict[tuple[int, int], float]]]()
    for rows, usual in arrangements:
        theirs = [[names[j] for j in row] for row in rows]
        blocks = [np.column_stack([columns[x] for x in row]) for row in theirs]
        shares = {
            (a, b): share
            for a, b in permutations(range(k), 2)
            if (share := _share_of_derivative(blocks[a], blocks[b], t)) > _IS_DERIVATIVE
        }
        found.append((theirs, usual, shares))
    # Each joint of a block that is no velocity would be a derivative by chance alone.
    best = max((x for *_, shares in found for x in shares.values()), default=0.0)
    by_chance = (1.0 - best + _NOISE) ** n if best else 1.0
    for theirs, usual, shares in found:
        for groups in (wanted, without):
            for chosen in permutations(range(k), len(groups)):
                of_group = dict(zip(groups, chosen, strict=True))
                # Place k, behind all columns, is that of a group without columns.
                q, dq, tau = (of_group.get(x, k) for x in ("q", "dq", "tau"))
                velocities = {b for a, b in shares if a == q} - {tau} or {k}
                if dq not in velocities or any(b == q for _, b in shares):
                    continue
                weight = usual * _UNUSED ** (k - len(chosen))
                weight *= 1.0 if [*chosen] == sorted(chosen) else _OTHER_ORDER
                weight *= _ACCELERATION if (dq, tau) in shares else 1.0
                weight /= 1.0 - shares.get((q, dq), 0.0) + _NOISE
                weight *= 1.0 if (q, dq) in shares or "dq" in known else by_chance
                named = {
                    f"{group}{j}": name
                    for group, place in of_group.items()
                    for j, name in enumerate(theirs[place], 1)
                }
                yield Layout(named, weight)


def _share_of_derivative(q: Array, dq: Array, t: Array | None) -> float:
    """Return the squared correlation of steps of channels q (N, n), each several rows long,
    with the integral of others over them: the median over the joints that move."""
    t = np.arange(float(len(q))) if t is None else np.ravel(t)[: len(q)]
    whole = np.isfinite(np.column_stack([t, q, dq])).all(axis=1)
    t, q, dq = t[whole], q[whole], dq[whole]
    if len(q) < 4:
        return 0.0
    if np.median(np.diff(t)) == 0.0:  # it is rounded to more than a row
        t = np.arange(float(len(t)))
    way = 0.5 * (dq[1:] + dq[:-1]) * np.diff(t)[:, None]
    way = np.vstack([np.zeros_like(dq[:1]), np.cumsum(way, axis=0)])
    moving = int(np.argmax(np.std(q, axis=0)))
    width = 1
    while 8 * width < len(q):
        moved = np.abs(q[width:, moving] - q[:-width, moving])
        if np.quantile(moved, 0.9) >= _MOVED * np.std(q[:, moving]):
            break
        width *= 2
    spans, steps, ways = (x[width:] - x[:-width] for x in (t, q, way))
    is_whole = spans < 2.0 * np.median(spans)  # no step over a gap
    steps, ways = steps[is_whole], ways[is_whole]
    ss, ww, sw = (np.sum(x, axis=0) for x in (steps**2, ways**2, steps * ways))
    moves = (ss > 0.0) & (ww > 0.0)
    shares = np.where(sw > 0.0, sw**2, 0.0)[moves] / (ss * ww)[moves]
    return float(np.median(shares)) if len(shares) else 0.0
