"""One step of a mechanism with dry friction, its sticking and sliding solved for, not stepped over.

    K dq+ = push - sum_i c_i p_i tanh(c_i dq+ / w_i)

for p_i >= 0 has one solution (the left side plus the friction is monotone). Widths w may be far below
what velocity changes within the step: w -> 0 is Coulomb's law with sticking (Moreau 1988; Stewart,
Trinkle 1996).
"""

from dataclasses import dataclass

import numpy as np

from sdp_vs_penalty.effects.effect import Array

#: Widths beyond which a contact slides to the last bit, Newton steps of a whole step and of one contact.
_SLIDES, _STEPS, _INNER = 20.0, 12, 9
#: Miss of a step, relative to its velocities, that is rounding.
_ARRIVED = 1e-11


@dataclass(frozen=True)
class Contacts:
    """directions (m, n) along which there may be dry friction, widths (m,) over which it turns round."""

    directions: Array
    widths: Array


def dry_step(matrix: Array, push: Array, before: Array, impulse: Array, contacts: Contacts) -> Array:
    """(W, n) velocities after a step.

    matrix : (W, n, n) K; push : (W, n) [N m s]; before : (W, n) velocities before the step; impulse :
    (W, m) p. What is negative of p (no friction) acts as the velocity before the step says.
    """
    c, w = contacts.directions, contacts.widths
    past = before @ c.T
    odd = np.minimum(impulse, 0.0)
    push = push - (odd * np.tanh(past / w)) @ c
    p = impulse - odd
    right = np.concatenate([push[:, :, None], np.broadcast_to(c.T, (len(push), *c.T.shape))], axis=2)
    solved = np.linalg.solve(matrix, right)
    free, response = solved[:, :, 0], solved[:, :, 1:]
    y0, coupling = free @ c.T, c @ response
    way = np.sign(past)
    friction = p * way
    y = y0 - np.einsum("kij,kj->ki", coupling, friction)
    open_rows = np.flatnonzero(np.any((y * way <= _SLIDES * w) & (p > 0.0), axis=1))
    if len(open_rows):
        friction[open_rows] = _solved(
            y0[open_rows], coupling[open_rows], p[open_rows], past[open_rows], w
        )
    return free - np.einsum("kij,kj->ki", response, friction)


def _solved(y0: Array, coupling: Array, p: Array, past: Array, w: Array) -> Array:
    """(W, m) friction impulses f with y = y0 - G f, f = p tanh(y / w).

    Newton on x = y + g f, g = diag G: y and f are both Lipschitz functions of x, whatever w. Where that
    has not arrived after some steps it goes in circles, which half steps leave.
    """
    g = np.einsum("kii->ki", coupling)
    x = np.where(np.abs(y0) > g * p, y0, past)
    scale = np.abs(y0).max(axis=1) + w.min()
    x = _newton(x, y0, coupling, p, w, scale, 1.0)
    miss = x - g * (f := _friction(x, g, p, w)) + np.einsum("kij,kj->ki", coupling, f) - y0
    rest = np.flatnonzero(np.abs(miss).max(axis=1) > _ARRIVED * scale)
    if len(rest):
        x[rest] = _newton(x[rest], y0[rest], coupling[rest], p[rest], w, scale[rest], 0.25)
        f = _friction(x, g, p, w)
    return np.clip(f, -p, p)


def _friction(x: Array, g: Array, p: Array, w: Array | float) -> Array:
    return (x - _resolvent(x, g * p, w)) / g


def _newton(
    x: Array, y0: Array, coupling: Array, p: Array, w: Array, scale: Array, share: float
) -> Array:
    """(W, m) x after Newton's steps, of which this share is taken."""
    m = len(w)
    g = np.einsum("kii->ki", coupling)
    for _ in range(round(_STEPS / share**3)):
        y = _resolvent(x, g * p, w)
        miss = y + np.einsum("kij,kj->ki", coupling, (x - y) / g) - y0
        if np.all(np.abs(miss).max(axis=1) <= _ARRIVED * scale):
            break
        # dy/dx
        rate = 1.0 / (1.0 + g * p / (w * np.cosh(np.minimum(np.abs(y) / w, 300.0)) ** 2))
        jacobian = coupling * ((1.0 - rate) / g)[:, None, :]
        jacobian[:, range(m), range(m)] += rate + 1e-14
        x = x - share * np.linalg.solve(jacobian, miss[:, :, None])[:, :, 0]
    return x


def _resolvent(x: Array, c: Array, w: Array | float) -> Array:
    """y with y + c tanh(y / w) = x. Concave for x > 0, so that Newton from below arrives from below."""
    size, steepest = np.abs(x), c / w
    y = np.maximum(size - c, size / (1.0 + steepest))
    for _ in range(_INNER):
        th = np.tanh(y / w)
        y = y + (size - y - c * th) / (1.0 + steepest * (1.0 - th * th))
    return np.copysign(y, x)
