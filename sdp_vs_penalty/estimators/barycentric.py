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

from sdp_vs_penalty.estimators.estimator import Array, Task
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import or_one
from sdp_vs_penalty.robot.constraint import BarycentricBound

#: The authors' box for friction and offset parameters [N m, N m s / rad] (bounds of their one-step
#: identification). Widened where a parameter must be larger to make the measured torque.
JOINT_PARAMETER_RANGE = 100.0

#: Bounds that are not convex are met by this much (relative), more than the final repair moves.
_MARGIN = 1e-8
#: Q (6, 3, 3), symmetric: I_e = J_e - m c^T Q_e c = J_e - h^T Q_e h / m with h = m c (Steiner).
STEINER_FORMS = inertia.steiner_forms()


@dataclass(frozen=True)
class BarycentricPart:
    """m sign (I_e - limit) >= 0 for entries e of inertia about links' centres of mass, with m I_e =
    m J_e - h^T Q_e h: quadratic in x = theta / theta_scale, without a pole at m = 0."""

    indices: NDArray[np.intp]  # (k, 10) of the link in x
    forms: Array  # (k, 10, 10): F = u^T form u + slope u_0, u = x[indices]
    slopes: Array  # (k,)
    width: int
    cone: str = "nonnegative"

    @classmethod
    def of(
        cls, bounds: Sequence[BarycentricBound], theta_scale: Array, reference: Array
    ) -> BarycentricPart:
        """Of each finite end, a hair inside, and of about unit size at the reference (p,); without
        I_xx >= 0, which P(theta) >= 0 contains."""
        indices, forms, slopes = list[NDArray[np.intp]](), list[Array](), list[float]()
        for b in bounds:
            link, scale = reference[b.indices], theta_scale[b.indices]
            moment, itself = link[[4, 6, 9]].sum(), np.trace(STEINER_FORMS[b.entry]) > 0.0
            form = np.zeros((10, 10))
            form[0, 4 + b.entry] = form[4 + b.entry, 0] = 0.5
            form[1:4, 1:4] = -STEINER_FORMS[b.entry]
            for sign, end in ((1.0, b.lower), (-1.0, b.upper)):
                if np.isfinite(end) and not (itself and sign > 0.0 and end <= 0.0):
                    limit = end + sign * _MARGIN * (moment + abs(end))
                    factor = sign / (link[0] * (moment + abs(limit)))
                    indices.append(b.indices)
                    forms.append(form * factor * np.outer(scale, scale))
                    slopes.append(-factor * limit * scale[0])
        own = np.array(indices, np.intp).reshape(-1, 10), np.array(forms).reshape(-1, 10, 10)
        return cls(*own, np.array(slopes), len(theta_scale))

    def values(self, x: Array) -> Array:
        """F(x), (k,)."""
        u = x[self.indices]
        return np.einsum("ki,kij,kj->k", u, self.forms, u) + self.slopes * u[:, 0]

    def jacobian(self, x: Array) -> Array:
        """dF/dx, (k, p)."""
        out = np.zeros((len(self.indices), self.width))
        local = 2.0 * np.einsum("kij,kj->ki", self.forms, x[self.indices])
        local[:, 0] += self.slopes
        out[np.arange(len(out))[:, None], self.indices] = local
        return out


@dataclass(frozen=True)
class BarycentricBox:
    """Bounds of p (p,): each link's ten barycentric parameters in place of theta's, the rest as is."""

    lower: Array
    upper: Array
    links: NDArray[np.intp]  # (n, 10)

    def theta(self, p: Array) -> Array:
        """Standard parameters of p: h = m c, J = I + m (c.c 1 - c c^T)."""
        out = p.copy()
        out[self.links] = inertia.standard_from_barycentric(p[self.links])
        return out

    def pull_back(self, p: Array, gradient: Array) -> Array:
        """(d theta / d p)^T gradient."""
        out, c, g = gradient.copy(), p[self.links[:, 1:4]], gradient[self.links]
        across = np.einsum("ne,eij,nj->ni", g[:, 4:], STEINER_FORMS, c)  # half of d J / d(m c)
        out[self.links[:, 0]] += np.sum(c * (g[:, 1:4] + across), axis=1)
        out[self.links[:, 1:4]] = p[self.links[:, :1]] * (g[:, 1:4] + 2.0 * across)
        return out

    def p(self, theta: Array) -> Array:
        """p of standard parameters, put inside the box (a massless link: its middle)."""
        out = theta.copy()
        out[self.links] = inertia.barycentric_from_standard(theta[self.links])
        middle = 0.5 * (self.lower + self.upper)
        return np.clip(np.where(np.isfinite(out), out, middle), self.lower, self.upper)


def barycentric_box(task: Task) -> BarycentricBox:
    """The problem's box; where it is open, what the problem implies (Task.bound).

    Centres of mass: |c| <= largest |m c| / largest m; moments and products of inertia: the largest
    moment about the frame. Joint parameters: their sign, and max(100, |tau| / |Y_k|) in SI units,
    where |tau| / |Y_k| is the size at which parameter k alone makes all the measured torque.
    """
    norms, links = task.data.column_norms, task.links
    alone = np.where(norms > 0.0, np.sqrt(task.data.tau_squared), 0.0) / or_one(norms)
    upper = np.minimum(np.maximum(JOINT_PARAMETER_RANGE, alone), task.bound)
    lower = np.maximum(-upper, [parameter.lower for parameter in task.model.parameters])
    implied = task.bound[links]
    implied[:, 1:4] /= or_one(implied[:, :1])
    low, (least, most) = -implied, np.moveaxis(task.box[: len(links)], 2, 0)
    low[:, [0, 4, 6, 9]] = 0.0
    lower[links] = np.where(np.isfinite(least), least, low)
    upper[links] = np.where(np.isfinite(most), most, implied)
    return BarycentricBox(lower, upper, links)
