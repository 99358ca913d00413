"""What an arm says of the channels of a log: which share of a torque its dynamics leave
unexplained, whatever its masses, its friction and the torque's unit are."""

from dataclasses import dataclass

import numpy as np

from sdp_vs_penalty.data.stretches.gaps import stray_rows
from sdp_vs_penalty.robot.arrays import Array, Mask, nonzero_or_one
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.threads import on_one_thread

#: At most so many rows are differentiated.
_ROWS = 30_000
#: About so many of these rows are fitted.
_ROWS_FITTED = 2_000
#: Parts of a log that are left out in turn; the rows of one part err together.
N_PARTS = 10
#: Share of its spread by which the joint that moves most moves within the window of the
#: derivatives: a twentieth of a period of a swing.
_MOVED = 0.4
#: Registers have more bits than this.
_LEAST_BIT = 6
#: Rows of the narrowest window.
_NARROWEST = 5
#: Rows of the shortest log that is judged.
_SHORTEST = 100
#: A channel that varies by less than this share of its size is constant: sums of its values
#: are rounded to about as much.
_ROUNDING = 1e-12


@dataclass(frozen=True)
class ChannelFit:
    """What the arm leaves of the torques of a log, in parts that it was not fitted to."""

    #: Root mean square of what is left over that of the torque around its mean [-].
    share: float
    #: Power that friction takes, over the torques' spread: negative where torques count
    #: the other way.
    friction: float
    #: The torques over those that the nominal links need; 0 where none are known.
    size: float = 0.0


@on_one_thread
def fit_arm(
    robot: Robot,
    t: Array,
    q: Array,
    tau: Array,
    links: Array | None = None,
    *,
    each_in_its_unit: bool = False,
) -> ChannelFit | None:
    """Fit an arm's ten parameters a link, friction and zeros to the torques of a log.

    Masses and frictions are of any size, so that the unit of the torques (N, n) does not
    matter. Of nominal links (n, 10) one factor each is fitted: in a wrong unit of positions
    any links explain much, the arm's do not. Rows beside a gap of the clock t (N,) [s] are
    left out, for derivatives reach over it; so are rows of another clock. A torque that is
    constant shows nothing and is left out. None for a log that is too short, in which
    nothing moves, or in which all torques are constant.

    Parameters
    ----------
    q : (N, n) array
        Positions [rad or m].
    each_in_its_unit : bool
        Whether each joint's torque has a unit of its own, such as a share of its rating: its
        masses and frictions are then fitted apart.
    """
    whole = np.isfinite(np.hstack([q, tau])).all(axis=1) & ~stray_rows(t)
    t, q, tau = (x[whole][:_ROWS] for x in (t, q, tau))
    if len(q) < _SHORTEST:
        return None
    is_loaded = _varies(tau)
    filtered = _filtered_rows(t, q, tau) if is_loaded.any() else None
    if filtered is None:
        return None
    q, dq, ddq, tau = filtered
    usual_speed = nonzero_or_one(np.std(dq, axis=0))
    count, n = tau.shape
    rigid = np.asarray(robot.regressor(q, dq, ddq)).reshape(count, n, -1)
    if links is not None:
        of_links = rigid.reshape(count, n, *links.shape)
        rigid = np.asarray(np.einsum("knlp,lp->knl", of_links, links))
    friction = np.tanh(10.0 * dq / usual_speed)
    laws = np.stack([ddq, np.ones_like(dq), dq, friction])  # of each joint alone
    of_one_joint = np.einsum("kij,jl->ijkl", laws, np.eye(n)).reshape(count, n, -1)
    tau, rigid, of_one_joint = (x[:, is_loaded] for x in (tau, rigid, of_one_joint))
    spreads = nonzero_or_one(np.std(tau, axis=0))
    columns = np.concatenate([rigid, of_one_joint], axis=2) / spreads[:, None]
    scale = nonzero_or_one(np.linalg.norm(columns, axis=(0, 1)))
    rows = np.concatenate([columns / scale, (tau / spreads)[:, :, None]], axis=2)
    joints = np.split(rows, tau.shape[1], axis=1) if each_in_its_unit else [rows]
    errors, solutions = zip(*map(_errors_of_left_out, joints), strict=True)
    share = min(float(np.sqrt(np.mean(np.concatenate(errors) ** 2))), 1.0)
    if each_in_its_unit:
        return ChannelFit(share, friction=0.0)
    theta = solutions[0] / scale
    of_friction = slice(-2 * n, None)
    speeds = (dq / usual_speed)[:, is_loaded]
    power = of_one_joint[:, :, of_friction] @ theta[of_friction] * speeds
    needed = float(np.linalg.norm(rigid.sum(axis=2) / spreads))
    factors_of_links = theta[: rigid.shape[2]]
    size = float(np.linalg.norm(rigid @ factors_of_links / spreads))
    is_known = links is not None and needed > 0.0
    return ChannelFit(
        share, float(np.mean(power / spreads)), size / needed if is_known else 0.0
    )


def _filtered_rows(
    t: Array, q: Array, tau: Array
) -> tuple[Array, Array, Array, Array] | None:
    """Return positions, velocities, accelerations and torques (K, n) in rows spread over a
    log, behind one smoothing filter; None where its rows are too few or nothing moves."""
    steps = np.diff(t)
    step = float(np.median(steps))
    does_move = _varies(q)
    if not step > 0.0 or not does_move.any():
        return None
    from scipy.signal import savgol_filter

    width = _rows_of_window(q)
    is_even = np.abs(steps - step) < 0.5 * step
    is_near_gap = np.convolve(~is_even, np.ones(2 * width), "same") > 0.5
    # The windows of the first and the last rows are not whole.
    rows = width + np.flatnonzero(~is_near_gap[width - 1 : -width])
    rows = rows[:: 1 + len(rows) // _ROWS_FITTED]
    if len(rows) < _SHORTEST:
        return None
    q, dq, ddq = (savgol_filter(q, width, 3, k, step, axis=0)[rows] for k in range(3))
    tau = savgol_filter(tau, width, 3, axis=0)[rows]
    # The filter's derivatives of a constant position are rounding errors.
    return q, does_move * dq, does_move * ddq, tau


def _rows_of_window(q: Array) -> int:
    """Return the rows over which positions (N, n) are differentiated: as many as the joint
    that moves most takes for a part of its swing."""
    spreads = np.std(q, axis=0)
    moving = int(np.argmax(spreads))
    width = _NARROWEST
    while width < len(q) // 8:
        moved = q[width - 1 :, moving] - q[: 1 - width, moving]
        if np.quantile(np.abs(moved), 0.9) >= _MOVED * spreads[moving]:
            break
        width += 2
    return width


def _errors_of_left_out(rows: Array) -> tuple[Array, Array]:
    """Fit rows (K, n, p + 1), p columns and the torque, without each of ten parts in turn;
    return the errors (K n,) in the parts left out, and the last solution (p,)."""
    parts = np.array_split(rows, N_PARTS)
    factors = [_triangular(list(part)) for part in parts]
    errors = list[Array]()
    for k, part in enumerate(parts):
        others = _triangular(factors[:k] + factors[k + 1 :])
        theta = np.linalg.lstsq(others[:, :-1], others[:, -1], rcond=1e-6)[0]
        errors.append(np.ravel(part[:, :, -1] - part[:, :, :-1] @ theta))
    return np.concatenate(errors), np.asarray(theta, float)


def _varies(channels: Array) -> Mask:
    """Return which of n channels (N, n) are not constant."""
    sizes = np.abs(channels).max(axis=0)
    return np.asarray(np.ptp(channels, axis=0) > _ROUNDING * sizes)


def _triangular(blocks: list[Array]) -> Array:
    """Return the triangular factor of blocks of rows, one below the other."""
    return np.asarray(np.linalg.qr(np.vstack(blocks), mode="r"))


def signed_register(values: Array) -> tuple[Array, int]:
    """Read columns (N, n) as registers of a servo, whose highest bit is the sign, if
    they hold whole numbers of a step and never are negative.

    Returns the values with signs, and the place of that bit; other columns as they are,
    and 0.
    """
    steps = np.diff(np.unique(values))
    if not len(steps) or not values.min() >= 0.0:
        return values, 0
    # Numbers of 32 bits are rounded: three digits of a step are known.
    step = float(f"{np.median(steps[steps < 1.5 * steps.min()]):.3g}")
    counts = np.round(values / step)
    bit = int(np.log2(counts.max()))
    is_lattice = np.abs(values / step - counts).max() < 0.01 and bit > _LEAST_BIT
    magnitudes = np.where(counts >= 2**bit, counts - 2**bit, -counts)
    return (step * magnitudes, bit) if is_lattice else (values, 0)
