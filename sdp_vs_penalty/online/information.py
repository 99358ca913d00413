"""What the data of a stretch tell of a payload: information, evidence, estimate.

With residual e = tau - tau_arm and columns Y (n, 10) of the payload, a stretch of T
seconds is kept as

    G = integral of [Y, e]^T S^-1 [Y, e] dt,      S = diag(sigma_j^2).

Residuals of a model are no white noise. With a correlation time of tau seconds, T
seconds are worth 1 + T / tau independent instants, so the information is

    Lambda = (1 / T + 1 / tau) G.

Friction and offsets drift, and both raise torques as a payload does. So columns N (n,
2n) of drift stand beside [Y, e]: joint j has an offset and a share of its friction, each
over its standard deviation. The drift b ~ N(0, 1) of a stretch is integrated out
(Schur complement): with w = 1 / T + 1 / tau and the blocks of G,

    w G_YY - w G_YN (1 + w G_NN)^-1 w G_NY   takes the place of   w G_YY.

A payload is then believed, and weighed, only beyond what such a drift explains.

The evidence for a payload against none is the Gaussian Bayes factor under the prior
P^-1 (MacKay, Information Theory, Inference, and Learning Algorithms, 2003, ch. 28):

    ln K = eta^T (Lambda + P)^-1 eta / 2 - ln det(1 + P^-1 Lambda) / 2.

Parameters are scaled: lengths count in the payload's plausible reach.
"""

import numpy as np
import scipy

from sdp_vs_penalty.online import constants as c
from sdp_vs_penalty.robot.arrays import Array

#: Ten parameters of a payload; the residual beside their columns. Columns of drift
#: follow.
SIZE = 10
WIDTH = 11


class PayloadPrior:
    """What is known of a payload before it is measured: the standard deviation ``mass``
    [kg], and how far its mass lies at most from the last link's frame, ``reach`` [m].
    """

    def __init__(
        self, mass: float = c.PAYLOAD_MASS, reach: float = c.PAYLOAD_REACH
    ) -> None:
        """Set the scales and the prior information (inverse covariance) of a payload.

        A payload has ten parameters: mass m, m c (3), inertia (6). Divided by ``scale``
        = (1, r, r, r, r^2, ...) with the reach r, all are masses [kg] of standard
        deviation ``mass`` [kg]. So the information is I / mass^2, and its log
        determinant is -20 ln(mass).
        """
        self.mass = mass
        self.reach = reach
        powers = [0.0] + [1.0] * 3 + [2.0] * 6  # of a length: m, m c, inertia
        #: (10,) from scaled parameters to kg, kg m, kg m^2.
        self.scale = reach ** np.array(powers)
        self.information = np.eye(SIZE) / mass**2
        self.log_det = -2.0 * SIZE * np.log(mass)


def weight_of(seconds: float, correlation: float) -> float:
    """Return the weight 1 / T + 1 / tau [1/s] of a stretch of length T [s] whose
    residuals are correlated over the time tau [s]."""
    return 1.0 / max(seconds, 1e-9) + 1.0 / correlation


class Posterior:
    """Estimate and evidence of a payload from information, in preallocated arrays.

    ``mean`` (10,) holds the scaled parameters, :meth:`covariance` gives their
    covariance (10, 10).
    """

    def __init__(self, prior: PayloadPrior, n_drifts: int) -> None:
        """Allocate the normal equations of a payload's ten parameters x.

        ``n_drifts`` d offsets and shares of friction are integrated out of the data.

        ``precision`` Lambda (10, 10) and ``linear`` b (10,) define Lambda x = b;
        ``mean`` (10,) is the solution x. ``_factor`` holds the Cholesky factor of
        Lambda, ``_diagonal`` is a view of its diagonal. Matrices are in column order
        for LAPACK.
        """
        self._prior = prior
        self.precision = np.zeros((SIZE, SIZE), order="F")
        self._factor = np.zeros((SIZE, SIZE), order="F")
        # Every 11th entry of a (10, 10) matrix in one row is on its diagonal.
        self._diagonal = self._factor.T.reshape(-1)[:: SIZE + 1]
        self._work_vector = np.zeros(SIZE)
        self.linear = np.zeros(SIZE)
        self.mean = np.zeros(SIZE)
        self._work_matrix = np.zeros((WIDTH, WIDTH))
        # Information of the drifts (d, d), and of drifts and [Y, e] (d, 11).
        self._drift = np.zeros((n_drifts, n_drifts), order="F")
        self._drift_diagonal = self._drift.T.reshape(-1)[:: n_drifts + 1]
        self._cross = np.zeros((n_drifts, WIDTH), order="F")
        self._explained = np.zeros((WIDTH, WIDTH))

    def clear(self) -> None:
        """Reset to the prior: precision = prior information, linear term = 0."""
        np.copyto(self.precision, self._prior.information)
        self.linear[:] = 0.0

    def add(self, matrix: Array, weight: float) -> None:
        """Add the data of a stretch, less what a drift in this stretch explains.

        Parameters
        ----------
        matrix : (11 + d, 11 + d) array
            Integral of [Y, e, N]^T [Y, e, N] / sigma^2 over the stretch [s].
        weight : float
            Weight of the stretch [1/s].

        Returns
        -------
        None
            ``precision`` and ``linear`` are updated.
        """
        # Lambda += weight Y^T Y, b += weight Y^T e, by work space without allocation.
        np.multiply(matrix[:WIDTH, :WIDTH], weight, out=self._work_matrix)
        self._explain_by_drift(matrix, weight)
        self._work_matrix -= self._explained
        self.add_again()

    def add_again(self) -> None:
        """Add the stretch of the last :meth:`add` once more, after :meth:`clear`.

        Returns
        -------
        None
            ``precision`` and ``linear`` are updated.
        """
        self.precision += self._work_matrix[:SIZE, :SIZE]
        self.linear += self._work_matrix[:SIZE, SIZE]

    def _explain_by_drift(self, matrix: Array, weight: float) -> None:
        """Write the part of a stretch's information that a drift explains to
        ``_explained`` (11, 11).

        With the information C (d, 11) of drifts and [Y, e], and L L^T = 1 + D of the
        drifts alone, it is Z^T Z with L Z = C. ``matrix`` and ``weight`` [1/s] are
        those of :meth:`add`.
        """
        np.multiply(matrix[WIDTH:, WIDTH:], weight, out=self._drift)
        self._drift_diagonal += 1.0
        scipy.linalg.lapack.dpotrf(self._drift, lower=1, clean=0, overwrite_a=1)
        np.multiply(matrix[WIDTH:, :WIDTH], weight, out=self._cross)
        # Not LAPACK's dtrtrs: OpenBLAS wakes all its threads for it, however small.
        scipy.linalg.blas.dtrsm(1.0, self._drift, self._cross, lower=1, overwrite_b=1)
        np.dot(self._cross.T, self._cross, out=self._explained)

    def solve(self) -> float:
        """Compute ``mean`` (10,) = Lambda^-1 b; return ln of the evidence of a payload.

        The evidence is the likelihood with a payload over that without, a Gaussian
        Bayes factor: |Lambda_0|^1/2 |Lambda|^-1/2 exp(b^T Lambda^-1 b / 2), with
        precision Lambda, prior precision Lambda_0 and linear term b. Lambda is
        factorised by Cholesky (LAPACK dpotrf), so that ln |Lambda| / 2 is the sum of
        the logarithms of the factor's diagonal.
        """
        np.copyto(self._factor, self.precision)
        scipy.linalg.lapack.dpotrf(self._factor, lower=1, clean=0, overwrite_a=1)
        np.copyto(self.mean, self.linear)
        scipy.linalg.lapack.dpotrs(self._factor, self.mean, lower=1, overwrite_b=1)
        np.log(self._diagonal, out=self._work_vector)
        half_log_det = float(self._work_vector.sum())
        fit = 0.5 * float(np.dot(self.linear, self.mean))
        return fit - half_log_det + 0.5 * self._prior.log_det

    def covariance(self) -> Array:
        """Return the covariance (10, 10) of the payload's scaled parameters.

        It is the inverse of the precision, by its Cholesky factor from the last
        :meth:`solve`.
        """
        return scipy.linalg.lapack.dpotrs(self._factor, np.eye(SIZE), lower=1)[0]
