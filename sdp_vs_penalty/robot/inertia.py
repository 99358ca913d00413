"""The ten standard inertial parameters of a link, and when they are physically
consistent.

THE parameter order, used everywhere in this package (it is Pinocchio's):

    theta = (m, m cx, m cy, m cz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz)

with the moments of inertia about the origin of the link frame [kg, kg m, kg m^2]. URDF
files and the tables of Gaz et al. write inertias as Ixx Ixy Ixz Iyy Iyz Izz and about
the centre of mass: they are converted at the border by the functions below.

The pseudo-inertia of a link (Wensing, Kim, Slotine, RA-L 2018, eq. 9) is the 4x4 matrix

    P(theta) = [[Sigma, m c], [(m c)^T, m]],     Sigma = 1/2 tr(I) 1 - I,

linear in theta. P > 0 holds exactly if some mass distribution of positive density has
these parameters: m > 0, and the inertia about the centre of mass is positive definite
and satisfies the triangle inequalities (Traversaro, Brossette, Escande, Nori, IROS
2016).
"""

import numpy as np
from numpy.typing import ArrayLike

from sdp_vs_penalty.robot.arrays import Array

#: The parameter order of one link.
PARAMETERS = ("m", "mx", "my", "mz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz")
UNITS = tuple(
    "kg" if p == "m" else "kg*m" if p.startswith("m") else "kg*m^2" for p in PARAMETERS
)

#: Smallest eigenvalue of a pseudo-inertia, relative to its trace, that still counts as
#: consistent: what rounding leaves of an exact zero (a rod, a point mass) after a
#: change of frames.
ROUNDING = 1e-12
#: Root mean square distance of the mass from any plane of a link that is drawn, because
#: its numbers say a point or a line [m].
_THINNEST = 1e-3

#: (row, column) of each of the six inertia entries, in the parameter order.
_ENTRIES = tuple(
    tuple(map("xyz".index, p.removeprefix("I")))
    for p in PARAMETERS
    if p.startswith("I")
)


def _forms() -> tuple[Array, Array]:
    """Return PSEUDO_INERTIA_BASIS (10, 4, 4) and STEINER_FORMS (6, 3, 3).

    The pseudo-inertia P of a body is the sum of its ten standard parameters (mass,
    first moments, six inertia entries) times the basis. The Steiner forms S_e give
    entry e of the inertia of a point mass 1 at c: c^T S_e c. Both are made of the dyads
    (e_i e_j^T + e_j e_i^T) / 2 of the six inertia entries (i, j).
    """
    unit = np.eye(3)
    i, j = np.transpose(_ENTRIES)
    is_moment = i == j
    pairs = unit[i][:, :, None] * unit[j][:, None]
    dyads = 0.5 * (pairs + pairs.swapaxes(1, 2))
    trace = is_moment[:, None, None] * unit
    # An off-diagonal entry stands twice in the matrix: its two dyads' sum.
    multiplicity = np.where(is_moment, 1.0, 2.0)[:, None, None]
    basis = np.zeros((10, 4, 4))
    basis[0, 3, 3] = 1.0
    basis[1:4, :3, 3] = unit
    basis[1:4, 3, :3] = unit
    basis[4:, :3, :3] = 0.5 * trace - multiplicity * dyads
    return basis, trace - dyads


#: P(theta) = sum_k theta_k PSEUDO_INERTIA_BASIS[k], (10, 4, 4); and Q (6, 3, 3),
#: symmetric, with c^T Q_e c the entry e of c.c 1 - c c^T, in our order (Steiner): about
#: the centre of mass I_e = J_e - m c^T Q_e c = J_e - h^T Q_e h / m with h = m c.
PSEUDO_INERTIA_BASIS, STEINER_FORMS = _forms()

#: Row and column of each entry, and (6, 6) what an entry of c c^T adds to those of
#: c.c 1 - c c^T.
_ROWS, _COLUMNS = np.transpose(_ENTRIES)
_STEINER_OF_PRODUCTS = np.where(_ROWS == _COLUMNS, 1.0, 2.0)[:, None] * (
    STEINER_FORMS[:, _ROWS, _COLUMNS].T
)


def parameter_names(link: int) -> tuple[str, ...]:
    """Return the names of a link's ten parameters: m3, mx3, ..., Izz3 of link 3 (from
    1)."""
    return tuple(f"{name}{link}" for name in PARAMETERS)


def pseudo_inertia(theta: ArrayLike) -> Array:
    """Return the pseudo-inertia matrices (..., 4, 4) of standard parameters (..., 10):
    second moments of the homogeneous coordinates (x, y, z, 1).

    The parameters are m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz about the link frame
    [kg, kg m, kg m^2].
    """
    return np.tensordot(np.asarray(theta, float), PSEUDO_INERTIA_BASIS, axes=(-1, 0))


def from_pseudo_inertia(matrix: ArrayLike) -> Array:
    """Return the standard parameters of symmetric pseudo-inertia matrices (..., 4, 4).

    Returns
    -------
    (..., 10) array
        Standard parameters about the same frame.
    """
    p = np.asarray(matrix, float)
    trace = np.trace(p[..., :3, :3], axis1=-2, axis2=-1)
    moments = inertia_entries(trace[..., None, None] * np.eye(3) - p[..., :3, :3])
    return np.concatenate([p[..., 3, 3, None], p[..., :3, 3], moments], axis=-1)


def deformed(theta: ArrayLike, size: float, rng: np.random.Generator) -> Array:
    """Return links (n, 10) after a random change of shape that keeps them possible.

    P' = (1 + s n')^2 T P T^T, T = [[1 + s N, s r n], [0, 1]]: each point x of a link
    moves to (1 + s N) x + s r n, and its mass grows. N (3, 3), n (3,) and n' are standard
    normal, s is the size, r the root mean square distance of the mass from the frame [m].
    """
    P = pseudo_inertia(theta)
    out = np.empty_like(P)
    for link, matrix in enumerate(P):
        mass = max(matrix[3, 3], np.finfo(float).tiny)
        radius = np.sqrt(np.trace(matrix[:3, :3]) / mass)
        change = np.eye(4)
        change[:3] += size * rng.normal(size=(3, 4)) * [1.0, 1.0, 1.0, radius]
        out[link] = (1.0 + size * rng.normal()) ** 2 * change @ matrix @ change.T
    return from_pseudo_inertia(out)


def inertia_matrix(entries: ArrayLike) -> Array:
    """Return the symmetric inertia matrices (..., 3, 3) [kg m^2] of six entries.

    Parameters
    ----------
    entries : (..., 6) array
        Ixx, Ixy, Iyy, Ixz, Iyz, Izz [kg m^2].
    """
    e = np.asarray(entries, float)
    out = np.empty((*e.shape[:-1], 3, 3))
    for k, (i, j) in enumerate(_ENTRIES):
        out[..., i, j] = out[..., j, i] = e[..., k]
    return out


def inertia_entries(matrix: ArrayLike) -> Array:
    """Return the six entries of symmetric inertia matrices (..., 3, 3) [kg m^2].

    Returns
    -------
    (..., 6) array
        Ixx, Ixy, Iyy, Ixz, Iyz, Izz [kg m^2].
    """
    m = np.asarray(matrix, float)
    return np.stack([m[..., i, j] for i, j in _ENTRIES], axis=-1)


def standard_from_barycentric(p: ArrayLike) -> Array:
    """Convert parameters about the centre of mass to standard parameters.

    The convention of Gaz et al. (RA-L 2019), with the inertia entries in our order.

    Parameters
    ----------
    p : (..., 10) m, cx, cy, cz, and the six entries of the inertia about the centre of
        mass [kg, m, kg m^2]

    Returns
    -------
    Array
        (..., 10) about the link frame.

    Examples
    --------
    >>> standard_from_barycentric([2.0, 0.0, 0.0, 0.5, 0.1, 0.0, 0.1, 0.0, 0.0, 0.02])
    array([2.  , 0.  , 0.  , 1.  , 0.6 , 0.  , 0.6 , 0.  , 0.  , 0.02])
    """
    barycentric = np.asarray(p, float)
    mass = barycentric[..., :1]
    centre = barycentric[..., 1:4]
    products = centre[..., _ROWS] * centre[..., _COLUMNS]
    out = barycentric.copy()
    out[..., 1:4] *= mass
    out[..., 4:] += mass * (products @ _STEINER_OF_PRODUCTS)
    return out


def barycentric_from_standard(theta: ArrayLike) -> Array:
    """Convert standard parameters to parameters about the centre of mass.

    Parameters
    ----------
    theta : (..., 10) m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz about the link frame
        [kg, kg m, kg m^2]

    Returns
    -------
    Array
        (..., 10) as :func:`standard_from_barycentric` takes them; NaN for the centre and
        the inertia of no mass.
    """
    mass, h, about_frame = np.split(np.asarray(theta, float), [1, 4], axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        c = h / mass
    steiner = np.einsum("...i,eij,...j->...e", c, STEINER_FORMS, c)
    return np.concatenate([mass, c, about_frame - mass * steiner], axis=-1)


def transform(placement: ArrayLike) -> Array:
    """Return the matrix that maps standard parameters from a frame B to a frame A.

    The pseudo-inertia is a second moment of homogeneous coordinates, hence P_A = X P_B
    X^T.

    Parameters
    ----------
    placement : (4, 4) array
        X = A_X_B, the pose of B in A.
    """
    x = np.asarray(placement, float)
    return from_pseudo_inertia(x @ PSEUDO_INERTIA_BASIS @ x.T).T


def consistency_margin(theta: ArrayLike) -> Array:
    """Return the smallest eigenvalue of the pseudo-inertia; nonnegative if a body can
    exist.

    Parameters
    ----------
    theta : (..., 10) array
        Standard parameters about the link frame [kg, kg m, kg m^2].
    """
    return np.asarray(np.linalg.eigvalsh(pseudo_inertia(theta))[..., 0], float)


#: Moments of inertia up to this are zero [kg m^2]: simulators refuse such bodies.
_ZERO_MOMENT = 1e-12


def why_impossible(theta: ArrayLike) -> str:
    """Say why no body has a link's inertial parameters.

    Parameters
    ----------
    theta : (10,) array_like
        Standard parameters [kg, kg m, kg m^2]; all zeros stand for no inertial.

    Returns
    -------
    str
        Such as "negative mass" or "triangle inequality violated"; "" for a body that
        can exist. Rounding errors of a moment are relative to those about the link's
        origin.
    """
    parameters = np.asarray(theta, float)
    mass = float(parameters[0])
    if mass < 0.0:
        return "negative mass"
    if mass == 0.0:
        return "moment of inertia without mass" if parameters.any() else ""
    com = parameters[1:4] / mass
    of_centre = mass * (com @ com * np.eye(3) - np.outer(com, com))  # Steiner
    moments = np.linalg.eigvalsh(inertia_matrix(parameters[4:]) - of_centre)
    to_origin = 2.0 * mass * float(com @ com)
    tolerance = -ROUNDING * (abs(float(moments.sum())) + to_origin)
    if moments[0] < tolerance:
        return "negative moment of inertia"
    if moments[0] + moments[1] - moments[2] < tolerance:
        return "triangle inequality violated"
    return "zero moment of inertia" if moments[0] <= _ZERO_MOMENT else ""


def thickness(theta: ArrayLike) -> Array:
    """Return the largest radius r [m] with Sigma_c >= m r^2 1; negative where the link
    is inconsistent.

    Sigma_c is the second moment about the centre of mass: a link whose mass lies on a
    line or in a plane has r = 0, a uniform ball of radius R has r = R / sqrt(5).

    Parameters
    ----------
    theta : (..., 10) array
        Standard parameters about the link frame [kg, kg m, kg m^2].
    """
    smallest = np.linalg.eigvalsh(second_moment(theta))[..., 0]
    return np.sign(smallest) * np.sqrt(np.abs(smallest))


def gyration(theta: ArrayLike) -> Array:
    """Return the radius of gyration sqrt(tr(Sigma_c) / m) [m] about the centre of mass.

    It is zero for a point mass and for no mass, half the distance of two equal masses,
    and sqrt(3/5) R for a uniform ball of radius R.

    Parameters
    ----------
    theta : (..., 10) array
        Standard parameters about the link frame [kg, kg m, kg m^2].
    """
    squared = np.trace(second_moment(theta), axis1=-2, axis2=-1)
    return np.sqrt(np.maximum(squared, 0.0))


#: Smallest mass [kg] and radius [m] that a link is taken to have.
_SMALLEST_MASS = 0.1
_SMALLEST_RADIUS = 0.05


def link_sizes(links: Array) -> Array:
    """Return how large the parameters of each link are.

    Parameters
    ----------
    links : (links, 10) array
        Nominal standard parameters [kg, kg m, kg m^2].

    Returns
    -------
    (links, 10) array
        Mass [kg], and that mass times the radius of gyration about the joint [kg m] and
        its square [kg m^2].
    """
    mass = np.maximum(links[:, 0], _SMALLEST_MASS)
    # The trace of an inertia is twice the second moment of the mass.
    moment = np.trace(inertia_matrix(links[:, 4:]), axis1=-2, axis2=-1) / 2.0
    radius = np.sqrt(np.maximum(moment, 0.0) / mass)
    radius = np.maximum(radius, _SMALLEST_RADIUS)
    sizes = [mass, *(mass * radius,) * 3, *(mass * radius**2,) * 6]
    return np.column_stack(sizes)


def second_moment(theta: ArrayLike) -> Array:
    """Return the second moment about the centre of mass, over the mass.

    It is the mean of x x^T; its eigenvalues are a fifth of a uniform ellipsoid's
    squared half axes.

    Parameters
    ----------
    theta : (..., 10) array
        Standard parameters about the link frame [kg, kg m, kg m^2].

    Returns
    -------
    (..., 3, 3) array
        Sigma_c / m [m^2]; zeros for no mass.
    """
    p = pseudo_inertia(theta)
    mass = p[..., 3, 3, None, None]
    h = p[..., :3, 3, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        central = p[..., :3, :3] / mass - h * np.swapaxes(h, -1, -2) / mass**2
    return np.where(np.isfinite(central), central, 0.0)


#: Density of osmium, the densest material [kg/m^3] (Arblaster, Platinum Metals Review
#: 1995).
DENSEST = 22590.0


def least_density(theta: ArrayLike) -> Array:
    """Return the least density that a body of this mass and inertia must have somewhere.

    Of all bodies with a mass m, a central second moment m S and a density of at most
    rho, the uniform ellipsoid is the smallest: its half axes are sqrt(5 s_i), with the
    eigenvalues s_i of S. So rho >= m / (4/3 pi 5^(3/2) sqrt(det S)).

    Parameters
    ----------
    theta : (..., 10) array
        Standard parameters about the link frame [kg, kg m, kg m^2].

    Returns
    -------
    (...) array
        [kg/m^3]; infinite for a flat body, 0 without mass.
    """
    mass = np.asarray(theta, float)[..., 0]
    spread = np.maximum(np.linalg.eigvalsh(second_moment(theta)), 0.0)
    volume = 4.0 / 3.0 * np.pi * np.prod(np.sqrt(5.0 * spread), axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        density = mass / volume
    return np.where(mass > 0.0, density, 0.0)


def nearest_inertia(
    about_com: Array, mass: float, thinnest: float | None = None
) -> Array:
    """Return the consistent inertia that is nearest to a symmetric matrix (3, 3)
    [kg m^2] by the Frobenius norm.

    Consistent inertias are I = tr(S) 1 - S with the second moment of the mass S >= 0.
    They are invariant to rotation, so the projection keeps the principal axes and acts
    on the principal moments, D = (s2 + s3, s1 + s3, s1 + s2) with s >= 0 (Lewis, SIAM
    J. Optimization 1996, for spectral sets in general).

    Parameters
    ----------
    mass : float
        Mass [kg]. With a positive one the result is strictly consistent.
    thinnest : float, optional
        Root mean square distance of the mass from any plane, at least [m]; default: 0,
        and a millimetre where a moment would be zero, which simulators refuse.
    """
    from scipy.optimize import nnls  # takes a while to import

    moments, axes = np.linalg.eigh(0.5 * (about_com + about_com.T))
    second, _ = nnls(1.0 - np.eye(3), moments)  # D = (1 - I) s
    # As far inside as it takes to survive being written as text and read again.
    second = second + 4.0 * ROUNDING * second.sum()
    if thinnest is None:
        has_zero_moment = second.sum() - second.max() <= _ZERO_MOMENT
        thinnest = _THINNEST if has_zero_moment else 0.0
    second = np.maximum(second, mass * thinnest**2)
    return (axes * (second.sum() - second)) @ axes.T
