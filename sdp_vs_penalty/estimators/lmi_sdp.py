"""The convex estimator: least squares subject to linear matrix inequalities, in one step.

    minimise |R theta - rho|^2 + residual_norm^2   subject to   P_i(theta) >= 0, bounds, signs

(Sousa, Cortesao, IJRR 2014, with the 4x4 pseudo-inertia of Wensing et al. 2018, which contains the
triangle inequalities). Plain, its optimum makes rods of most links. Three convex remedies: a body that a
link's mass must lie in, an entropic pull towards the problem's nominal robot, and a minimum thickness.
The default is the first two (results/default_method.md).
"""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from sdp_vs_penalty.estimators.estimator import Estimator, Fit, Task, sample_variance, with_joint_prior
from sdp_vs_penalty.estimators.sdp_fit import PosedSdp
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.constraint import ConstraintSet
from sdp_vs_penalty.solvers.objective import Entropy, Objective


@dataclass(frozen=True)
class LmiSdp(Estimator):
    """body : whether each link's mass must lie inside of its body (:class:`~robot.body.Body`).

    thickness : smallest radius of gyration of a link in any direction [m]; 0 for none.
    entropy : weight of the Bregman divergence from the nominal robot, in units of the residual
        variance of one filtered torque row (0: none). By default about one independent measurement a
        link: filtered rows repeat each other 2.3 to 4.5 times.
    joint_prior : weight, in the same unit, of the pull of friction, offsets and other joint parameters
        to zero; one that alone would make all of its joint's torque costs one row (0: none). Where a
        joint does not reverse, only this keeps Coulomb friction and offset from growing against each
        other.
    total_spread : relative standard deviation of the total mass that a file or bounds state, which
        counts like ``entropy`` rows (0: no prior on it): the divergence alone lets masses follow
        moments.
    solver : one of solvers/; None: our own (solvers/primal_dual.py) where its answer is certified, else
        Clarabel; accuracy : what it is asked for.
    """

    name = "lmi-sdp"
    table_place: ClassVar[int | None] = 4
    description = (
        "one-step torque SDP whose links fit their bodies, entropic prior at the nominal robot (the "
        "default)"
    )

    body: bool = True
    thickness: float = 0.0
    entropy: float = 3.0
    joint_prior: float = 1.0
    total_spread: float = 0.2
    solver: str | None = None
    accuracy: float = 1e-10

    def fit(self, task: Task) -> Fit:
        objective, constraints = self.posed(task)
        return PosedSdp(task, objective, constraints, self.solver).fit(objective, self.accuracy)

    @property
    def rest(self) -> str:
        return "prior" if self.entropy > 0.0 else "bounds"

    def posed(self, task: Task) -> tuple[Objective, ConstraintSet]:
        """What is minimised, subject to what."""
        constraints = task.constraints.plus(task.minimum_thickness(self.thickness))
        if self.body:
            constraints = constraints.plus(task.bodies)
        data = with_joint_prior(task, self.joint_prior).data
        if self.total_spread > 0.0 and self.entropy > 0.0 and task.total:
            masses = np.zeros((1, data.R.shape[1]))
            masses[0, task.links[:, 0]] = 1.0 / (self.total_spread * task.total)
            weight = self.entropy * sample_variance(task)
            data = data.observing(masses, np.array([1.0 / self.total_spread]), weight)
        pull = None
        if self.entropy > 0.0 and len(task.links):
            nominal = inertia.pseudo_inertia(task.prior_links)
            pull = Entropy(self.entropy * sample_variance(task), task.pseudo_inertias, nominal)
        return Objective(data, pull), constraints


@dataclass(frozen=True)
class LmiSdpThickness(LmiSdp):
    name = "lmi-sdp-thickness"
    table_place: ClassVar[int | None] = None
    description = "one-step torque SDP with minimum thickness, without bodies or a prior on the links"
    body: bool = False
    thickness: float = 0.02  # costs about 1 % of the Panda's loss
    entropy: float = 0.0


@dataclass(frozen=True)
class LmiSdpPlain(LmiSdp):
    name = "lmi-sdp-plain"
    table_place: ClassVar[int | None] = 5
    description = "one-step torque SDP without minimum thickness: links degenerate to rods"
    body: bool = False
    entropy: float = 0.0
    joint_prior: float = 0.0


@dataclass(frozen=True)
class LmiSdpEntropic(LmiSdp):
    name = "lmi-sdp-entropic"
    table_place: ClassVar[int | None] = 6
    description = (
        "one-step torque SDP with an entropic pull towards the problem's nominal robot and no bodies"
    )
    body: bool = False
    entropy: float = 1.0


@dataclass(frozen=True)
class LmiSdpTwoStep(Estimator):
    """Sousa and Cortesao's chain (IJRR 2014), each step a feasible set and a distance:

    beta'   nearest feasible base parameters to the OLS estimate, Euclidean in the symbols;
    beta*   the torque SDP with pseudo-inertias only;
    beta*e  the torque SDP with centre-of-mass and mass bounds as well;
    delta   standard parameters with base parameters beta*e (their eq. 49).
    """

    name = "lmi-sdp-two-step"
    description = "Sousa and Cortesao's chain: beta', beta*, beta*e, delta"

    solver: str = "clarabel"
    accuracy: float = 1e-10

    def fit(self, task: Task) -> Fit:
        # beta' and beta* are subject to physics. Families that only bound the feasible set stay: without
        # them it is open to infinity.
        kept = ("pseudo-inertia", "sign", "range", "trace", "bounding ellipsoid", "mass")
        physics = task.constraints.with_families(kept.__contains__)
        distance, torque = Objective(task.base_distance), Objective(task.data)
        steps = (distance, physics), (torque, physics), (torque, task.constraints)
        nearest, best, bounded = (
            PosedSdp(task, objective, constraints, self.solver).fit(objective, self.accuracy)
            for objective, constraints in steps
        )
        names = ("beta_prime", "beta_star", "beta_star_e")
        pairs = zip(names, (nearest, best, bounded), strict=True)
        chain = {name: (task.base @ fit.theta).tolist() for name, fit in pairs}
        details = {**bounded.details, **chain, "loss_beta_prime": task.data.loss(nearest.theta)}
        return replace(bounded, details=details)
