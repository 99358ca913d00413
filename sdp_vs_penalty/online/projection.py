"""The nearest physically consistent payload, with a proof that none is nearer.

    minimise  f(x) = (x - y)^T Lambda (x - y) / 2   subject to  X = P(x) >= 0,

with the pseudo-inertia P (4x4) of :mod:`~sdp_vs_penalty.robot.inertia`. For any
Z >= 0 and feasible x the optimum f* satisfies (Lagrange duality)

    f(x) - f* <= |Lambda (x - y) - P*(Z)|^2 / 2 in the norm Lambda^-1, + <Z, X>.

The right side is the gap that is certified; |x - x*|^2 in Lambda is at most twice it.
Newton steps follow the central path (Helmberg, Rendl, Vanderbei, Wolkowicz, SIAM J.
Optimization 1996), one a call of :meth:`ConeProjection.step`: a control loop spreads
them over its cycles.
"""

import numpy as np
import scipy

from sdp_vs_penalty.online import constants as c
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.inertia import PSEUDO_INERTIA_BASIS

_LOWER = np.tri(4, dtype=bool)
_BASIS = np.ascontiguousarray(PSEUDO_INERTIA_BASIS.reshape(10, 16))
#: (10, 16) from the entries of a symmetric matrix to its parameters.
_DUAL_BASIS = np.linalg.solve(_BASIS @ _BASIS.T, _BASIS)
_IDENTITY = np.eye(4)
#: Share of the way to the cone's boundary that a step goes.
_SHARE = 0.95
#: Complementarity from which the next projection of nearly the same payload starts,
#: away from the boundary.
_WARM_GAP = 3.0


class ConeProjection:
    """Projection onto physically consistent payloads, one Newton step a call.

    ``theta`` (10,) are the projected parameters, ``gap`` is a certified bound on f(x) -
    f*, and ``is_done`` says whether the gap is at most ``constants.PROJECTION_GAP``.
    """

    def __init__(self) -> None:
        """Allocate the arrays of the projection, so that a step allocates next to
        nothing.

        - ``theta`` (10,): the projected payload, in scaled parameters.
        - ``_x`` (10,): the present point, with the pseudo-inertia X = P(x) (4x4).
        - ``_Z`` (4x4): the multiplier of X >= 0.
        - ``_centre`` (10,): the estimate that is projected.
        - ``_precision`` (10, 10): the metric, inverse of the estimate's covariance.
        """
        self.theta = np.zeros(10)
        self.gap = np.inf
        self.is_done = True
        self.steps = 0
        self._precision = np.zeros((10, 10), order="F")
        self._factor = np.zeros((10, 10), order="F")
        self._hessian = np.zeros((10, 10))
        self._lapack = self._hessian.T  # the same numbers in LAPACK's order
        self._centre = np.zeros(10)
        self._x = np.zeros(10)
        self._slope = np.zeros(10)
        self._step = np.zeros(10)
        self._Z = np.zeros((4, 4))
        self._is_warm = False
        self._kronecker = np.zeros((4, 4, 4, 4))
        self._products = np.zeros((10, 16))

    def start(self, precision: Array, centre: Array) -> None:
        """Begin the projection of an estimate onto the physically consistent payloads.

        Parameters
        ----------
        precision : (10, 10) array
            Inverse of its covariance, the metric of the projection.
        centre : (10,) array
            Estimate, standard parameters over their scales.

        Returns
        -------
        None
            ``is_done`` is True at once if the estimate is consistent itself.
        """
        np.copyto(self._precision, precision)
        np.copyto(self._centre, centre)
        self.steps = 0
        matrix = _matrix(centre)
        if _is_definite(matrix):
            np.copyto(self.theta, centre)
            self.gap = 0.0
            self.is_done = True
            return
        np.copyto(self._factor, precision)
        scipy.linalg.lapack.dpotrf(self._factor, lower=1, clean=0, overwrite_a=1)
        # Warm start: from the last solution, moved off the cone's boundary.
        if self._is_warm:
            self._raise_last()
            self.gap = 0.0
            self.is_done = self._is_warm = False
            return
        # Start well inside the cone: eigenvalues of at least 3 % of the largest.
        smallest_share = 0.03
        values, vectors = np.linalg.eigh(matrix)
        floor = smallest_share * float(np.abs(values).max())
        raised = (vectors * np.maximum(values, floor)) @ vectors.T
        np.copyto(self._x, _parameters(raised))
        # Z balances the slope of f, as far as it lies along the same eigenvectors.
        slope = precision @ (self._x - centre)
        dual = _matrix_of_slope(slope)
        dual_values = np.maximum(np.diagonal(vectors.T @ dual @ vectors), 0.0)
        dual_floor = smallest_share * max(float(dual_values.max()), 1e-12)
        np.copyto(self._Z, (vectors * np.maximum(dual_values, dual_floor)) @ vectors.T)
        self.gap = 0.0
        self.is_done = False

    def forget(self) -> None:
        """Start the next projection anew, as for another payload."""
        self._is_warm = False

    def _raise_last(self) -> None:
        """Move the last solution off the cone's boundary, as a warm start.

        A multiple of the identity is added to X (4x4) and to its multiplier Z (4x4), so
        that each adds half of _WARM_GAP to the complementarity <X, Z>.
        """
        X = _matrix(self._x)
        lift = 0.5 * _WARM_GAP / max(float(np.trace(self._Z)), 1e-12)
        self._x += _parameters(lift * _IDENTITY)
        self._Z += 0.5 * _WARM_GAP / float(np.trace(X)) * _IDENTITY

    def step(self) -> bool:
        """Make one primal-dual Newton step; return True if the projection is finished.

        The projection minimises (x - y)^T Lambda (x - y) / 2 over payloads x (10,) with
        a positive semidefinite pseudo-inertia X = P(x) (4x4); Z (4x4) is its
        multiplier. It is finished when the certified gap is at most PROJECTION_GAP, or
        after PROJECTION_STEPS.
        """
        if self.is_done:
            return True
        # 1. Hessian: Lambda + P*(X^-1 P(.) Z), by the Kronecker product of X^-1 and Z.
        X = _matrix(self._x)
        Z = self._Z
        inverse = _inverse(X)
        np.multiply(inverse[:, None, :, None], Z[None, :, None, :], out=self._kronecker)
        np.dot(_BASIS, self._kronecker.reshape(16, 16), out=self._products)
        np.dot(self._products, _BASIS.T, out=self._hessian)
        # Only its lower triangle is read; both orders of a product are the same here.
        self._hessian += self._precision
        # 2. Target mu of the complementarity: a tenth of the present one, or more while
        # the dual slope is still far from balanced.
        complementarity = float(np.vdot(X, Z)) / 4.0
        imbalance = max(self.gap - 4.0 * complementarity, 0.0)
        target = 0.1 * max(complementarity, 0.1 * min(imbalance, 1e6))
        # 3. Newton step dx: Hessian dx = -Lambda (x - y) + P*(mu X^-1).
        np.subtract(self._x, self._centre, out=self._step)
        np.dot(self._precision, self._step, out=self._slope)
        self._slope *= -1.0
        self._slope += _BASIS @ (target * inverse).ravel()
        scipy.linalg.lapack.dpotrf(self._lapack, lower=1, clean=0, overwrite_a=1)
        np.copyto(self._step, self._slope)
        scipy.linalg.lapack.dpotrs(self._lapack, self._step, lower=1, overwrite_b=1)
        # 4. dZ = mu X^-1 - Z - sym(X^-1 dX Z); go as far as both stay in the cone.
        dX = _matrix(self._step)
        product = inverse @ dX @ Z
        dZ = target * inverse - Z - 0.5 * (product + product.T)
        primal_share = _length(X, dX)
        dual_share = _length(Z, dZ)
        self._x += primal_share * self._step
        self._Z += dual_share * dZ
        self.steps += 1
        self.gap = self._certified_gap()
        np.copyto(self.theta, self._x)
        self.is_done = self.gap <= c.PROJECTION_GAP or self.steps >= c.PROJECTION_STEPS
        self._is_warm = self.gap <= c.PROJECTION_GAP
        return self.is_done

    def _certified_gap(self) -> float:
        """Return a certified bound of f(x) - f*, the distance from the optimum.

        It is s^T Lambda^-1 s / 2 + <X, Z> with s = Lambda (x - y) - P*(Z), by duality.
        Infinite if X or Z is not positive definite.
        """
        X = _matrix(self._x)
        slack = self._precision @ (self._x - self._centre) - _BASIS @ self._Z.ravel()
        scaled = scipy.linalg.lapack.dpotrs(self._factor, slack, lower=1)[0]
        gap = 0.5 * float(slack @ scaled) + float(np.vdot(X, self._Z))
        if gap <= c.PROJECTION_GAP and not (_is_definite(X) and _is_definite(self._Z)):
            return float(np.inf)
        return gap


def _matrix(theta: Array) -> Array:
    """Return the pseudo-inertia (4, 4) of scaled parameters theta (10,)."""
    return np.dot(theta, _BASIS).reshape(4, 4)


def _parameters(matrix: Array) -> Array:
    """Return the parameters (10,) of a pseudo-inertia (4, 4), the inverse of
    :func:`_matrix`.
    """
    return _DUAL_BASIS @ matrix.ravel()


def _matrix_of_slope(slope: Array) -> Array:
    """Return the symmetric Z (4, 4) whose adjoint P*(Z) is the slope (10,)."""
    return np.dot(slope, _DUAL_BASIS).reshape(4, 4)


def _is_definite(matrix: Array) -> bool:
    """Return whether a symmetric matrix is positive definite, by its Cholesky
    factorisation.
    """
    return bool(scipy.linalg.lapack.dpotrf(matrix, lower=1)[1] == 0)


def _length(matrix: Array, step: Array) -> float:
    """Return the share of a step that stays inside the cone, at most 1.

    matrix X and step dX are (4, 4). X + a dX stays positive definite for a < -1 / l,
    with l the smallest generalised eigenvalue of dX by X; _SHARE of that is taken.
    """
    lowest = float(scipy.linalg.lapack.dsygv(step, matrix, jobz="N")[0][0])
    return 1.0 if lowest >= -_SHARE else _SHARE / -lowest


def _inverse(matrix: Array) -> Array:
    """Return the inverse of a positive definite matrix (4, 4), by LAPACK."""
    lower = scipy.linalg.lapack.dpotri(
        scipy.linalg.lapack.dpotrf(matrix, lower=1)[0], lower=1
    )[0]
    return np.where(_LOWER, lower, lower.T)
