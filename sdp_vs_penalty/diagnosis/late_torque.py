"""Effects that delay torque (a delay, a filter of the torque channel): columns that are
computed from the torque of the model and of the effects found.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.diagnosis.constants import EVIDENCE_TO_ADD
from sdp_vs_penalty.diagnosis.library import Key
from sdp_vs_penalty.diagnosis.linear_fit import ScoredEffect, WhiteFit
from sdp_vs_penalty.diagnosis.own_constants import with_constants
from sdp_vs_penalty.diagnosis.refit import least_squares_refit
from sdp_vs_penalty.diagnosis.search import Search
from sdp_vs_penalty.diagnosis.white_rows import (
    ConstantErrors,
    whiten_with_noise,
    with_estimate,
)
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.estimation.certificate import NOT_CERTIFIED
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.sensitivity import prior_deviation, with_moved_constant
from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.robot.arrays import Array

#: Steps by which the model's constants follow the findings.
_STEPS = 3


def refer_columns_to_current_model(
    search: Search, progress: Progress = no_progress
) -> Search:
    """Continue a search with columns computed from the torque that the findings have
    changed.

    A delay or a filter acts on all torque, also on that of the findings. Its columns
    are therefore computed from the torque of the model, refitted beside the findings,
    plus the findings' torque. A second law of a joint's friction waits as well, until the
    constants of the model's own friction (the velocity over which it reverses) are
    re-estimated. Search and columns alternate (a Gauss-Newton iteration) until a set of
    findings comes back.

    Parameters
    ----------
    progress
        Called with a short text whenever an effect is added.

    Returns
    -------
    Search
        The continued search; the given one if neither a finding nor the model delays
        torque, and no law waits.
    """
    known_sets = list[set[Key]]()  # (effect, joint) of the findings of each round
    best = None  # the round with the lowest criterion
    lowest = np.inf
    first_library = search.library
    data = search.data
    if search.terms and not delays_torque(search):
        search = look_for_delays(search, progress)
    while delays_torque(search) or search.has_waiting:
        keys = {t.key for t in search.terms}
        if keys in known_sets:
            break
        known_sets.append(keys)
        # New columns of the findings and, once, of all candidates: these are screened
        # on a grid of constants, and the torque changes little from round to round.
        if search.has_waiting:
            search = beside_constants(search, data.estimate, search.all_constants)
        search = refer_once(search)
        if search.library is first_library:
            search.library = first_library.with_current_columns(search.data, data)
        # In new columns findings may lose their evidence, and other effects gain some.
        all_joints = frozenset(range(search.data.n))
        search.terms = search.drop_weak(search.terms, on=all_joints)
        search.run(progress)
        criterion = search.criterion
        has_improved = criterion < lowest - EVIDENCE_TO_ADD
        if criterion < lowest:
            best = search
            lowest = criterion
        if not has_improved:
            break
    return search if best is None else best


def look_for_delays(search: Search, progress: Progress = no_progress) -> Search:
    """Search for delays once more, in columns that include the findings' torque.

    A causal filter beside pre-sliding friction, for example, does not show in the
    torque of a model whose friction jumps at a reversal: it delays the torque of the
    findings.

    Parameters
    ----------
    search
        A search whose findings contain no delay. It is returned if no delaying
        candidate has enough evidence.
    progress
        Called with a short text whenever an effect is added.
    """
    referred = refer_once(search)
    referred.library = search.library.only(
        lambda form: _is_delay(form.effect), referred.data
    )
    if referred.best_addition() is None:
        return search
    referred.library = search.library.with_current_columns(referred.data, search.data)
    referred.run(progress)
    return referred


def _is_delay(effect: Effect) -> bool:
    """Return whether an effect delays torque.

    Its columns are computed from the joint torque, and depend on the torque's past.
    """
    return effect.needs_torque and effect.has_memory


def delays_torque(search: Search) -> bool:
    """Return whether a finding, or an effect of the model, delays the torque of
    findings.

    False without findings: all delayed torque is then the model's own, whose columns
    contain the delay already.
    """
    effects = [t.form.effect for t in search.terms]
    effects += search.data.estimate.model.effects
    return bool(search.terms) and any(map(_is_delay, effects))


def refer_once(search: Search) -> Search:
    """Recompute the search's columns once, from the torque of model and findings
    together.

    The parameters of both are first fitted together by least squares, since a model
    fitted without the findings has absorbed a part of their torque. Without this step
    14 % of the size of a backlash went missing.
    """
    data = search.data
    theta, _ = least_squares_refit(data, [t.form.effect for t in search.terms])
    # The model's parameters come first, then those of each finding.
    widths = [t.form.n_coefficients for t in search.terms]
    n_of_model = data.X.shape[2]
    starts = n_of_model + np.cumsum([0, *widths])[:-1]  # of the findings
    own_theta, *thetas = np.split(theta, starts)
    estimate = data.estimate
    if not data.frozen:
        estimate = replace(estimate, theta=own_theta, certificate=NOT_CERTIFIED)
    return beside_model(search, estimate, thetas=thetas)


def beside_constants(
    search: Search, first: Estimate, constants: Sequence[ScoredEffect]
) -> Search:
    """Return the search beside a model with re-estimated constants.

    The findings' columns use the velocity over which the model's friction reverses. So the
    constants are estimated beside the findings, by Gauss-Newton steps.
    """
    out = copy(search)
    out.constants = tuple(constants)
    out.terms = [t for t in search.terms if not t.form.replaces_own_constant]
    out.is_referred = True
    out.has_waiting = False
    for number in range(_STEPS + 1):
        out = beside_model(out, with_constants(first, out.constants))
        moving = [own for own in out.constants if out.is_refined(own.form)]
        if number == _STEPS or not moving:
            break
        out = refer_once(out)
        effects = [t.form.effect for t in out.terms]
        betas = [t.beta for t in out.terms]
        for error in out.data.constant_error_columns(effects, betas):
            effect = error[0].effect
            key = effect.name, *effect.joints
            out.constants = tuple(
                _with_constants_stepped(out.fit, own, error)
                if own in moving and own.key == key
                else own
                for own in out.constants
            )
    return out


def _with_constants_stepped(
    fit: WhiteFit, own: ScoredEffect, error: ConstantErrors
) -> ScoredEffect:
    """Return one of the model's effects with its constants moved by a Gauss-Newton step,
    by a factor of two at most.

    error : derivatives of the torque by the constants, and their white columns.
    """
    derivatives, columns = error
    left = fit.residual_of(fit.scaled(columns))  # (n, M, constants)
    both = ((0, 1), (0, 1))
    gram = np.tensordot(left, left, both) + np.eye(left.shape[2])
    steps = np.linalg.solve(gram, np.tensordot(left, fit.residual, both))
    effect = own.form.effect
    shape = {}
    for name, step in zip(derivatives.keys, steps.tolist(), strict=True):
        present = effect.shape[name]
        value = with_moved_constant(
            effect, name, step * prior_deviation(effect, name)
        ).shape[name]
        low, high = own.form.bounds(name) or (0.0, np.inf)
        inside = np.clip(value, max(low, 0.5 * present), min(high, 2.0 * present))
        shape[name] = float(f"{inside:.6g}")
    return replace(own, form=own.form.with_shape(**shape))


def beside_model(
    search: Search, estimate: Estimate, thetas: Sequence[Array] = ()
) -> Search:
    """Return the search with the same findings, recomputed beside another model.

    Parameters
    ----------
    search
        The search; its library of candidates keeps the old columns.
    thetas
        Parameters of each finding in SI units. Default: those of the search.

    Returns
    -------
    Search
        Its rows and columns belong to the other model. Columns that are computed from a
        torque (those of a delay) are computed from that of the model and of the
        findings whose columns need none.
    """
    data = search.data
    parameters = thetas or [t.beta for t in search.terms]
    pairs = list(zip(search.terms, parameters, strict=True))
    # Torque that effects compute from torque (a delay) is no part of the reference.
    in_reference = [
        (t.form.effect, b) for t, b in pairs if not t.form.effect.needs_torque
    ]
    rows = with_estimate(data.rows, estimate, in_reference)
    data = whiten_with_noise(rows, data.noise, estimate, data.frozen, like=data)
    out = Search(data, search.library, like=search)
    out.barred = {*search.barred}
    out.constants = search.constants
    out.is_referred = search.is_referred
    out.terms = [replace(t, columns=out.columns(t.form)) for t in search.terms]
    out.fit = out.score.fit(out.terms)
    return out
