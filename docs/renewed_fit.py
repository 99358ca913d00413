"""A certified fit that follows an arm: blocks of new samples, older ones fade.

    fit = RenewedFit(load_problem("panda"), first)  # Measurements of one exciting motion
    theta = fit.renew(block)  # Measurements of new samples

Blocks overlap by 2 / state_cutoff + 2 / torque_cutoff seconds, which the filters reach to
either side.
"""

from dataclasses import replace

import numpy as np

from sdp_vs_penalty.estimators import LmiSdp, PosedSdp, make_task
from sdp_vs_penalty.estimators.estimator import sample_variance
from sdp_vs_penalty.regression.regression import LeastSquares, compress
from sdp_vs_penalty.signals import FilteredRuns


class RenewedFit:
    """The optimum of all rows so far; each starts from the central path of the last."""

    def __init__(self, problem, first):
        self.model = problem.model()
        runs = FilteredRuns.filtering(first, problem.preprocessing)
        self.settings = runs.settings
        self.task = make_task(problem, self.model, compress(runs, self.model))
        self.posed = PosedSdp(self.task, LmiSdp().posed(self.task))
        self.data, self.fit = self.task.data, self.posed.fit()

    def renew(self, block, fade=0.99):
        """Return theta (p,) with a block's rows; older rows count ``fade``."""
        task = self.task
        runs = FilteredRuns.filtering(block, self.settings)
        new = compress(runs, self.model).least_squares(task.weights)
        squared = fade * self.data.tau_squared + new.tau_squared
        rows = [self.rows(self.data, fade), self.rows(new, 1.0)]
        self.data = LeastSquares.stacked(rows, self.data.rows + new.rows, squared)
        with_prior = self.data.with_prior(task.joint_scale, sample_variance(task))
        problem = replace(self.posed.problem, least_squares=with_prior)
        self.fit = self.posed.with_problem(problem).fit(accuracy=1e-9, near=self.fit)
        return self.fit.theta  # certified: self.fit.gap

    def rows(self, part, weight):
        """Return compressed rows and torque as one weighted block."""
        last = [0.0 * self.task.bound, part.residual_norm]
        return np.sqrt(weight) * np.block([[part.R, part.rho[:, None]], last])
