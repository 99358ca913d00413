"""The ratios of servos' gains to the links that they move: a robust first solution.

Of 0 = L theta - kp e the least squares shrink theta, and with it everything; divided by the gain,
e = L theta / kp, they do not. So that is what is solved here, for all joints together: the loss has
the gains inside, and what it finds is the start of the convex problem that is posed
(:mod:`~sdp_vs_penalty.regression.instruments`).
"""

from __future__ import annotations

import numpy as np

from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.effects.servo import Servo
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.bounded_least_squares import least_squares
from sdp_vs_penalty.regression.partial import partialled, visible
from sdp_vs_penalty.regression.regression import Regression
from sdp_vs_penalty.robot.arrays import Array


def balanced(problem: Problem, model: Model, regression: Regression) -> Array:
    """theta (p,) that minimises sum_j |e_j - L_j psi / kp_j|^2 / s_j^2, up to a factor: that which makes
    the links weigh what the problem says.

    e_j is joint j's error, L_j all other columns, s_j what L_j leaves of e_j with coefficients of its
    own. Solved in ln kp, psi eliminated (variable projection; Golub, Pereyra, SIAM J. Numer. Anal.
    1973): it converged from any start in all cases tried. Raises InputError where no joint follows its
    command.
    """
    p, gains = regression.p, np.array(model.error_gains)
    links, nominal = model.rigid_indices, problem.nominal(model)
    rest = np.setdiff1d(np.arange(p), gains)
    errors, loads, of_links = list[Array](), list[Array](), list[Array]()
    for f, at in zip(regression.per_joint, gains, strict=True):
        wide = np.zeros((len(f.triangle), p))
        wide[:, f.indices] = f.triangle[:, :-1]
        e, own = -wide[:, at], wide[:, rest]
        left, whole = np.linalg.norm(partialled(own, e)), np.linalg.norm(e)
        s = max(float(left), 1e-9 * float(whole)) / np.sqrt(max(f.rows, 1))
        if s == 0.0:
            raise InputError(
                f"joint {f.joint + 1} does not move, or follows its command without error",
                "check the columns qcmd1..qcmdn",
            )
        errors.append(e / s)
        loads.append(own / s)
        of_links.append(wide[:, links] / s)
    e, owner = np.concatenate(errors), np.repeat(np.arange(len(gains)), [len(e) for e in errors])
    L, L_links = np.vstack(loads), np.vstack(of_links)
    pulls = [np.linalg.norm(own @ nominal[links]) for own in of_links]
    start = np.maximum([w / np.linalg.norm(x) for w, x in zip(pulls, errors, strict=True)], 1e-6)

    def fitted(x: Array) -> tuple[Array, Array, Array]:
        """psi, what remains, and its change with ln kp (Kaufman, BIT 1975)."""
        columns = L / (start * np.exp(x))[owner, None]
        U, V = visible(columns)
        psi = V @ (U.T @ e)
        slopes = (columns @ psi)[:, None] * (owner[:, None] == np.arange(len(gains)))
        return psi, e - U @ (U.T @ e), slopes - U @ (U.T @ slopes)

    far = np.full(len(gains), np.log(Servo.range))
    best, _, _ = least_squares(
        lambda x: fitted(x)[1:], 0.0 * far, (-far, far), xtol=1e-8, ftol=1e-8, steps=100 * len(gains)
    )
    theta = np.empty(p)
    theta[gains], theta[rest] = start * np.exp(best), fitted(best)[0]
    # As the links should weigh, by the torque that they make.
    told, stated = L_links @ theta[links], L_links @ nominal[links]
    size = float(told @ stated) / max(float(told @ told), 1e-300)
    return theta * (size if size > 0.0 else 1.0)
