"""Where and why: an error after reversals is named so, joint by joint, and its stretches lie there."""

from dataclasses import replace

import numpy as np
from random_robots import repeating_run

from sdp_vs_penalty import identify, where_it_fails
from sdp_vs_penalty.diagnosis.where_it_fails import REVERSAL


def test_an_error_after_reversals_is_seen_there(two_link):
    run = repeating_run(two_link, 0, noise=0.05)
    velocity = np.gradient(run.q[:, 1], run.t)
    turns = np.flatnonzero(np.sign(velocity[1:]) != np.sign(velocity[:-1]))
    late = np.zeros(len(run.t))
    for k in turns:  # what a bent asperity does: it takes 0.3 s to follow
        after = run.t - run.t[k]
        late += np.where((after >= 0.0) & (after < 0.3), -np.sign(velocity[k + 1]), 0.0)
    tau = run.tau.copy()
    tau[:, 1] += 2.0 * late
    model = identify(two_link, run)
    first, second = where_it_fails(model, replace(run, tau=tau))
    assert second.held_out_shares[REVERSAL] > 0.4
    assert max(second.held_out_shares, key=lambda name: second.held_out_shares[name]) == REVERSAL
    assert first.held_out_shares[REVERSAL] < 0.1
    near = [s for s in second.stretches if s.cause == REVERSAL]
    assert len(near) >= 3
    instants = run.t[turns]
    assert all(np.min(np.abs(instants - 0.5 * (s.start + s.stop))) < 0.5 for s in near)
    assert not any(s.cause == REVERSAL for s in first.stretches)
