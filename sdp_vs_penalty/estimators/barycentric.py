"""The paper's parameters: (m, c, I about the centre of mass) of each link, in box bounds.

Gaz et al. (RA-L 2019) search in p = (m, cx, cy, cz, Ixx, ..., Izz), in which the torque is not
linear; everything else here works in standard parameters theta. This file holds the way between
them, with derivatives, and what the paper's box means in theta.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty import inertia
from sdp_vs_penalty.constraints import BarycentricBound
from sdp_vs_penalty.estimators.estimator import Array, Task

#: The authors' box for friction and offset parameters [N m, N m s / rad] (bounds of their one-step
#: identification). Widened where a parameter must be larger to make the measured torque.
JOINT_PARAMETER_RANGE = 100.0

_MOMENTS = (0, 2, 5)
#: Row and column of each inertia entry, and what m c_i c_j adds to J: J_e = I_e + sum_k S_ke m c_i c_j.
_ROWS, _COLUMNS = np.array([0, 0, 1, 0, 1, 2]), np.array([0, 1, 1, 2, 2, 2])
_STEINER = np.array(
    [
        [0.0, 0.0, 1.0, 0.0, 0.0, 1.0],  # xx adds to yy and zz
        [0.0, -1.0, 0.0, 0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0, 0.0, 0.0, 1.0],  # yy
        [0.0, 0.0, 0.0, -1.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, -1.0, 0.0],
        [1.0, 0.0, 1.0, 0.0, 0.0, 0.0],  # zz
    ]
)


def _mass_times_barycentric() -> Array:
    """(6, 10, 10), symmetric: m I_e = m J_e - sum_k S_ke h_i h_j, h = m c."""
    forms = np.zeros((6, 10, 10))
    for e in range(6):
        forms[e, 0, 4 + e] = 1.0
        forms[e, 1 + _ROWS, 1 + _COLUMNS] = -_STEINER[:, e]
    return 0.5 * (forms + forms.transpose(0, 2, 1))


#: m I_e = theta^T MASS_TIMES_BARYCENTRIC[e] theta for the ten standard parameters theta of a link.
MASS_TIMES_BARYCENTRIC = _mass_times_barycentric()


@dataclass(frozen=True)
class BarycentricPart:
    """m (upper - I_e) >= 0 and m (I_e - lower) >= 0 in x = theta / theta_scale: quadratic in x.

    Multiplied by the mass, a bound on I has no pole at m = 0, and m >= 0 is demanded elsewhere.
    """

    indices: NDArray[np.intp]  # (k, 10) of the link in x
    forms: Array  # (k, 10, 10) in scaled variables: F = u^T form u + slope u_0, u = x[indices]
    slopes: Array  # (k,)
    width: int
    cone: str = "nonnegative"

    @classmethod
    def of(
        cls, bounds: Sequence[BarycentricBound], theta_scale: Array, reference: Array
    ) -> BarycentricPart:
        indices, forms, slopes = [], [], []
        for bound in bounds:
            link = reference[bound.indices]
            moment = float(link[[4, 6, 9]].sum())
            for sign, limit in ((1.0, bound.lower), (-1.0, bound.upper)):
                implied = sign > 0.0 and bound.entry in _MOMENTS and limit <= 0.0
                if not np.isfinite(limit) or implied:  # P(theta) >= 0 contains I_xx >= 0
                    continue
                d, size = theta_scale[bound.indices], link[0] * (moment + abs(limit))
                indices.append(bound.indices)
                forms.append(sign * MASS_TIMES_BARYCENTRIC[bound.entry] * np.outer(d, d) / size)
                slopes.append(-sign * limit * d[0] / size)
        return cls(
            np.array(indices, np.intp).reshape(-1, 10),
            np.array(forms).reshape(-1, 10, 10),
            np.array(slopes),
            len(theta_scale),
        )

    def values(self, x: Array) -> Array:
        u = x[self.indices]
        return np.einsum("ki,kij,kj->k", u, self.forms, u) + self.slopes * u[:, 0]

    def jacobian(self, x: Array) -> Array:
        out = np.zeros((len(self.indices), self.width))
        slope = 2.0 * np.einsum("kij,kj->ki", self.forms, x[self.indices])
        slope[:, 0] += self.slopes
        out[np.arange(len(out))[:, None], self.indices] = slope
        return out

    def second(self, multiplier: Array) -> Array:
        out = np.zeros((self.width, self.width))
        for k in np.flatnonzero(multiplier):
            out[np.ix_(self.indices[k], self.indices[k])] += 2.0 * multiplier[k] * self.forms[k]
        return out


@dataclass(frozen=True)
class BarycentricBox:
    """Bounds of p (p,): each link's ten barycentric parameters in place of theta's, the rest as is."""

    lower: Array
    upper: Array
    links: NDArray[np.intp]  # (n, 10)

    def random(self, rng: np.random.Generator) -> Array:
        """Uniform inside the box."""
        return rng.uniform(self.lower, self.upper)

    def theta(self, p: Array) -> Array:
        """Standard parameters of p: h = m c, J = I + m (c.c 1 - c c^T)."""
        out = p.copy()
        if len(self.links):
            local = p[self.links]
            c = local[:, 1:4].copy()
            local[:, 1:4] *= local[:, :1]
            local[:, 4:] += (local[:, 1 + _ROWS] * c[:, _COLUMNS]) @ _STEINER
            out[self.links] = local
        return out

    def pull_back(self, p: Array, gradient: Array) -> Array:
        """(d theta / d p)^T gradient."""
        out = gradient.copy()
        if len(self.links):
            local, g = p[self.links], gradient[self.links]
            m, c, g_h = local[:, :1], local[:, 1:4], g[:, 1:4]
            by_product = g[:, 4:] @ _STEINER.T  # d / d(m c_i c_j), each pair once
            g[:, 0] += np.sum(g_h * c, axis=1)
            g[:, 0] += np.sum(by_product * c[:, _ROWS] * c[:, _COLUMNS], axis=1)
            across = m * by_product
            g_c = m * g_h
            for k, (i, j) in enumerate(zip(_ROWS, _COLUMNS, strict=True)):
                g_c[:, i] += across[:, k] * c[:, j]
                g_c[:, j] += across[:, k] * c[:, i]
            g[:, 1:4] = g_c
            out[self.links] = g
        return out

    def p(self, theta: Array) -> Array:
        """p of standard parameters, put inside the box (a massless link: its middle)."""
        out = theta.copy()
        if len(self.links):
            out[self.links] = inertia.barycentric_from_standard(theta[self.links])
        middle = 0.5 * (self.lower + self.upper)
        return np.clip(np.where(np.isfinite(out), out, middle), self.lower, self.upper)


def barycentric_box(task: Task) -> BarycentricBox:
    """The problem's box; where it is open, what the problem implies (Task.bound).

    Centres of mass: |c| <= largest |m c| / largest m; moments and products of inertia: the largest
    moment about the frame. Joint parameters: their sign, and max(100, |tau| / |Y_k|) in SI units,
    where |tau| / |Y_k| is the size at which parameter k alone makes all the measured torque.
    """
    norms = task.data.column_norms
    alone = np.zeros(len(norms))
    np.divide(np.sqrt(task.data.tau_squared), norms, out=alone, where=norms > 0.0)
    upper = np.minimum(np.maximum(JOINT_PARAMETER_RANGE, alone), task.bound)
    lower = np.maximum(-upper, [parameter.lower for parameter in task.model.parameters])
    for link, indices in enumerate(task.links):
        bound, box = task.bound[indices], task.box[link]
        implied = np.concatenate([bound[:1], bound[1:4] / max(bound[0], 1e-300), bound[4:]])
        low = -implied
        low[0] = 0.0
        low[[4, 6, 9]] = 0.0
        lower[indices] = np.where(np.isfinite(box[:, 0]), box[:, 0], low)
        upper[indices] = np.where(np.isfinite(box[:, 1]), box[:, 1], implied)
    return BarycentricBox(lower, upper, task.links)
