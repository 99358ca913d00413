"""Effects of the arm that act on several joints at once, and so resemble a fault of the log:
a constant force on the last link, gears that couple two joints.

What one joint's own motion makes is in its own columns; a load that all runs carry is in
the last link's parameters. Which effect it is, a diagnosis judges.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np

from sdp_vs_penalty.race.constants import COULOMB_WIDTHS
from sdp_vs_penalty.race.evidence import Evidence, Fit
from sdp_vs_penalty.race.fault import prior_of_one_of
from sdp_vs_penalty.race.records import Further, Hypothesis

#: Standard deviation beforehand of a force [N] and of its moment [N m].
_FORCE, _MOMENT = 30.0, 6.0
#: Standard deviation of a coupling's torque over that of the joint [-].
_COUPLING = 0.3
#: Parameters of a link, and how many of them make its weight.
_PARAMETERS_OF_A_LINK, _STATIC = 10, 4


def propose(evidence: Evidence, fit: Fit) -> Iterator[Hypothesis]:
    """Yield a force on the last link, and a coupling of each joint with each
    neighbour."""
    log, now = evidence.log, fit.chain
    model = log.data.shared
    if model is None or not len(model.rigid_indices):
        return
    # A force F at the point r acts as the weight of a mass there would under a gravity
    # along F: it is linear in F_k and r_i F_k.
    static = model.rigid_indices[-_PARAMETERS_OF_A_LINK:][:_STATIC]
    columns = [
        log.columns(replace(now, gravity=tuple(axis)), 0.0, 0.0)[:, :, static]
        for axis in np.eye(3).tolist()
    ]
    sd = np.tile([_FORCE, _MOMENT, _MOMENT, _MOMENT], 3)
    force = Further(np.concatenate(columns, axis=2), sd)
    what = "a constant force on the last link"
    yield Hypothesis("force", (), prior_of_one_of(1), now, further=force, effect=what)
    # The motor of joint b turns with joint a as well: a part of its torque acts on a,
    # and the friction and inertia of the sum on both.
    motion, torque = log.motion(now), log.torques(now)
    links = log.raw(now) @ fit.links
    for pair in pairwise(range(log.n)):
        for a, b in (pair, pair[::-1]):
            dq, ddq = motion.dq[:, b], motion.ddq[:, b]
            laws = [dq, ddq, *(np.tanh(dq / width) for width in COULOMB_WIDTHS)]
            of_a = np.column_stack([links[b], *laws])
            size = np.sqrt(np.mean(of_a**2, axis=0))
            sd = _COUPLING * np.sqrt(np.mean(torque[a] ** 2)) / np.maximum(size, 1e-12)
            of_all = np.zeros((log.n, *of_a.shape))
            of_all[a] = of_a
            what = f"gears that couple joints {pair[0] + 1} and {pair[1] + 1}"
            yield Hypothesis(
                kind="coupling",
                joints=(a, b),
                log_prior=prior_of_one_of(2 * log.n),
                chain=now,
                further=Further(of_all, np.maximum(sd, 1e-12)),
                effect=what,
            )
