"""The body of a link: an ellipsoid outside of which it has no mass, and the source from
which it is known."""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from sdp_vs_penalty.errors import InputError, require_known
from sdp_vs_penalty.records import JsonRecord
from sdp_vs_penalty.robot.arrays import Array, check_finite

#: What a body can be known from, the best first.
SOURCES = ("geometry", "bounds", "inertial", "kinematics")
#: Sources that show no body: it is a guess, which data may reject.
GUESSES = ("inertial", "kinematics")
#: Relative excess of the squared distances from an enclosing ellipsoid's centre.
_EXCESS = 1e-2
#: Beyond this excess the inverse is rounding.
_LARGEST_EXCESS = 1.0 / float(np.finfo(float).eps)


@dataclass(frozen=True)
class Body(JsonRecord):
    """{x : sum_k (axes[:, k] . (x - centre))^2 / half_axes[k]^2 <= 1} in the link frame
    [m]."""

    #: (3,) centre [m].
    centre: Array
    #: (3,) half axes [m], all positive.
    half_axes: Array
    #: (3, 3) orthonormal columns, the directions of the half axes.
    axes: Array
    #: What the body is known from, one of :data:`SOURCES`.
    source: str
    #: Volume of the link's geometry itself [m^3]; None where there is none.
    volume: float | None = None
    #: Factor by which data enlarged a guess [-].
    enlarged: float = 1.0

    def __post_init__(self) -> None:
        """Raise InputError for arrays of other shapes, half axes that are not positive,
        axes (3, 3) that are not orthonormal, or an unknown source."""
        for name, shape in (("centre", (3,)), ("half_axes", (3,)), ("axes", (3, 3))):
            check_finite(f"a body's {name}", getattr(self, name), shape)
        if not np.all(self.half_axes > 0.0):
            raise InputError("a half axis of a body is not above 0", "correct it")
        if not np.allclose(self.axes.T @ self.axes, np.eye(3), atol=1e-6):
            raise InputError("the axes of a body are not orthonormal", "normalise them")
        require_known("body source", self.source, SOURCES)

    @property
    def is_guess(self) -> bool:
        """Whether neither a shape nor bounds show the body."""
        return self.source in GUESSES

    def larger(self, factor: float) -> Self:
        """Return the body with its half axes times ``factor``."""
        return replace(
            self, half_axes=factor * self.half_axes, enlarged=factor * self.enlarged
        )

    @property
    def quadric(self) -> Array:
        """Q (4, 4) with (x, 1)^T Q (x, 1) = 1 at the centre and 0 on the ellipsoid's
        surface.
        """
        d = (self.axes / self.half_axes**2) @ self.axes.T
        row = (d @ self.centre)[:, None]
        return np.block([[-d, row], [row.T, 1.0 - self.centre @ row]])

    @property
    def reach(self) -> float:
        """Largest half axis [m], which bounds the radius of gyration of a mass inside."""
        return float(self.half_axes.max())


def around(
    points: ArrayLike,
    source: str,
    margin: float = 1.0,
    layer: float = 0.0,
    volume: float | None = None,
) -> Body:
    """Return the ellipsoid of about smallest volume that contains points, enlarged.

    Parameters
    ----------
    points : (k, 3) array
        Points in the link frame [m].
    source : str
        Origin of the points, one of :data:`SOURCES`.
    margin : float
        Factor of the half axes.
    layer : float
        Length that is then added to the half axes [m].
    volume : float, optional
        Volume of the link's geometry [m^3].

    Notes
    -----
    Khachiyan's ascent on the weights of the lifted points (Todd, Minimum-Volume
    Ellipsoids, SIAM 2016, ch. 3) over the extremes of the cloud, then enlarged until
    all points are inside.
    """
    cloud = np.asarray(points, float)
    # Extreme points of the cloud in many directions. The directions are taken in chunks
    # to limit the memory, for a cloud may have many points.
    chunks = np.array_split(directions(), 20)
    extremes = cloud[np.unique([np.argmax(cloud @ d.T, axis=0) for d in chunks])]
    # The smallest ellipsoid in 3 dimensions: 3 times the weighted second moment has the
    # squared half axes as eigenvalues.
    weights = _weights_of_least_ellipsoid(extremes.tobytes())
    centre = weights @ extremes
    second = (extremes * weights[:, None]).T @ extremes - np.outer(centre, centre)
    squared_half_axes, axes = np.linalg.eigh(3.0 * second)
    half_axes = np.sqrt(np.maximum(squared_half_axes, 0.0))
    half_axes = np.maximum(half_axes, 1e-3 * half_axes.max())  # a flat cloud
    largest_distance = np.linalg.norm((cloud - centre) @ axes / half_axes, axis=1).max()
    return Body(
        centre,
        half_axes=margin * max(largest_distance, 1.0) * half_axes + layer,
        axes=axes,
        source=source,
        volume=volume,
    )


@lru_cache(256)
def _weights_of_least_ellipsoid(point_bytes: bytes) -> Array:
    """Return weights (k,) of points whose weighted moments are those of the smallest
    ellipsoid.

    The points (k, 3) are given as bytes, so that results can be cached: a robot is read
    many times. Khachiyan's ascent, to a relative excess of _EXCESS.
    """
    points = np.frombuffer(point_bytes).reshape(-1, 3)
    lifted = np.column_stack([points, np.ones(len(points))])
    weights = np.full(len(lifted), 1.0 / len(lifted))
    inverse = np.linalg.pinv(lifted.T @ lifted / len(lifted))  # of the moment
    distance = np.sum(lifted @ inverse * lifted, axis=1)
    # All distances are at most 4, the order of the lifted points, at the optimum. The
    # number of steps grows as 4 / _EXCESS. For points near a line, rounding spoils the
    # inverse earlier: the distances explode, and the loop ends.
    for _ in range(round(5 * 4 / _EXCESS)):
        excess = distance.max()
        if not 4.0 * (1.0 + _EXCESS) < excess < _LARGEST_EXCESS:
            break
        # The first of the points that are equally far, so that rounding does not choose.
        farthest = int(np.argmax(distance > (1.0 - 1e-6) * excess))
        step = (excess - 4.0) / (4.0 * (excess - 1.0))
        weights *= 1.0 - step
        weights[farthest] += step
        # The moment changes by a matrix of rank one (Sherman, Morrison).
        push = inverse @ lifted[farthest]
        share = step / (1.0 - step + step * excess)
        inverse = (inverse - (share * push)[:, None] * push) / (1.0 - step)
        distance = (distance - share * (lifted @ push) ** 2) / (1.0 - step)
    weights.setflags(write=False)
    return weights


def balls(centres: ArrayLike, radius: float) -> Array:
    """Return the extreme points of balls along the coordinate axes, in place of the
    balls.

    Of k centres (k, 3) [m] and a radius [m] there are (6 k, 3) points [m].
    """
    axes = np.eye(3)
    ends = radius * np.concatenate([axes, -axes])
    points = [np.asarray(centre, float) + ends for centre in np.atleast_2d(centres)]
    return np.concatenate(points)


def directions(count: int = 400) -> Array:
    """Return unit vectors spread evenly over the sphere, by the golden angle.

    Parameters
    ----------
    count : int
        Number of vectors. The default finds the extremes of a cloud to 1 % of its size.
    """
    k = np.arange(count) + 0.5
    z = 1.0 - 2.0 * k / count
    angle = np.pi * (1.0 + 5.0**0.5) * k
    radius = np.sqrt(1.0 - z**2)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), z])
