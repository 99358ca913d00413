"""From the end of a search to a diagnosis: sizes, findings, verdict, what is left, what
happened once.

Sizes are least squares on white rows beside the model, all other findings and what is
tolerated of a mounting. Their covariance is the sandwich A^-1 S A^-1 with a column for
each shape constant (:mod:`~sdp_vs_penalty.estimation.sensitivity`) and S over the
clusters of rows that make it largest, at least that of independent rows; the gains of
the torque channels and a model that is held fixed are in doubt.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from sdp_vs_penalty import formatting
from sdp_vs_penalty.diagnosis.constants import (
    ABSORBED,
    EVIDENCE_TO_ADD,
    IMPLAUSIBLE_SIGMAS,
    UNCERTAIN,
)
from sdp_vs_penalty.diagnosis.curves.curve import CURVE
from sdp_vs_penalty.diagnosis.curves.measure import Measured
from sdp_vs_penalty.diagnosis.findings import (
    REASONS,
    Diagnosis,
    Finding,
    Invisible,
    Remaining,
    Retune,
    size_with_interval,
)
from sdp_vs_penalty.diagnosis.held_out import HeldOut, lowers
from sdp_vs_penalty.diagnosis.remaining import (
    Remainder,
    events,
    least_squares_refit,
    outliers,
    remainder,
)
from sdp_vs_penalty.diagnosis.score import ScoredEffect, WhiteFit
from sdp_vs_penalty.diagnosis.search import Search
from sdp_vs_penalty.diagnosis.whitening import (
    Moved,
    WhiteData,
    cluster_sums,
    model_columns,
    spread_columns,
)
from sdp_vs_penalty.effects import effect_types
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.sensitivity import prior_deviation
from sdp_vs_penalty.estimation.shapes import ShapeEstimate
from sdp_vs_penalty.estimation.verdict import MOSTLY_NEW
from sdp_vs_penalty.formatting import plain_unit
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.signals.noise import RESIDUAL, SPECTRUM, SPECTRUM_KNOWN
from sdp_vs_penalty.signals.standstill import STILL


@dataclass(frozen=True)
class SearchOutcome:
    """What a search came to: first : the model as it was given; estimate : with the
    constants of its own that explain most; shapes : those constants; search : the
    findings beside it, in order; left : by these; held_out : of all candidates, of
    which ``offered`` are the constants, and then the findings."""

    first: Estimate
    estimate: Estimate
    shapes: tuple[ShapeEstimate, ...]
    search: Search
    left: Remainder
    held_out: HeldOut
    offered: tuple[int, ...]
    curves: tuple[Measured, ...] = ()


def what_is_left(
    search: Search, outlier_mask: NDArray[np.bool_] | None = None
) -> Remainder:
    """Of the rows beside all terms of a search; outlier_mask (M, n) : its outliers, if they are
    known."""
    data = search.data
    fit = search.fit
    residual = least_squares_refit(data, [t.form.effect for t in search.terms])[1]
    if outlier_mask is None:
        outlier_mask = outliers(data, (fit.residual * fit.level[:, None]).T, residual)
    return remainder(data, fit, residual, outlier_mask)


def conclude(
    outcome: SearchOutcome, gain_errors: Array, new_share: float | None, seed: int
) -> Diagnosis:
    """The diagnosis. gain_errors (n, e) : a factor of the covariance of the torque
    channels' gains; new_share : of the test run's motion; seed : of the draws of a
    curve's band."""
    search = outcome.search
    data = outcome.search.data
    rows = data.rows
    noise = data.noise
    left = outcome.left
    residual = outcome.left.residual
    nameless = {j: float(left.beyond[j]) for j in left.joints_unexplained}
    unnamed = {*nameless, *(c.joint for c in outcome.curves)}
    happened = events(data, outcome.left.outlier_rows, residual, sorted(unnamed))
    held_out = outcome.held_out
    offered = outcome.offered
    n_own = len(offered) - len(search.terms)
    errors = np.array(
        [held_out.errors(offered[:k]) for k in range(n_own, len(offered) + 1)]
    )
    doubt = torque_errors(data, outcome.estimate, gain_errors)
    moved = data.constant_error_columns(
        [t.form.effect for t in search.terms], [t.beta for t in search.terms]
    )
    near = search.score.fit([*search.terms, *search.tolerances.values()], search.fit)
    sizes = [size_of_term(search, t, near, doubt, moved) for t in search.terms]
    findings = [
        _finding(
            *both,
            reasons_for_doubt(outcome, *both, errors[k : k + 2]),
            errors[k : k + 2],
        )
        for k, both in enumerate(zip(search.terms, sizes, strict=True))
    ]
    # Data left out have the last word on those that are sure, too, as a whole.
    sure = [
        *offered[:n_own],
        *(
            k
            for k, f in zip(offered[n_own:], findings, strict=True)
            if f.torque_is_certain
        ),
    ]
    harmful_together = set(sure).difference(held_out.drop_harmful(sure))
    for i, k in enumerate(offered[n_own:]):
        if k in harmful_together:
            why = *findings[i].remarks, REASONS["alone"]
            findings[i] = replace(findings[i], confidence="weak", remarks=why)
    retuned = tuple(
        retune(
            replace(s, std=constant_std(search, moved, s)),
            outcome.estimate.robot,
            held_out.errors([i for i in offered if i != k]),
            errors[-1],
            k in harmful_together,
        )
        for k, s in zip(offered, outcome.shapes, strict=False)
    )
    floor = noise.floor if data.known else np.zeros(data.n)
    curves = tuple(
        c.to_curve(seed + k, float(floor[c.joint]))
        for k, c in enumerate(outcome.curves)
    )
    known: Literal["effect_missing", "nothing_missing"]
    known = "effect_missing" if findings else "nothing_missing"
    return Diagnosis(
        "unknown_effect" if unnamed else known,
        tuple(findings),
        noise.floor,
        invisible_effects(search),
        tuple(happened),
        noise.source,
        left.in_sample_excess_variance,
        errors[-1],
        rows.cutoff,
        remarks(data, residual, held_out.source, new_share),
        held_out.errors(()),
        held_out.source,
        data.frozen,
        new_share,
        retuned,
        curves,
        tuple(Remaining(j + 1, size) for j, size in sorted(nameless.items())),
    )


def _finding(
    term: ScoredEffect, known: Size, weak: Mapping[str, str], errors: Array
) -> Finding:
    """errors (2, n) : held out, before and after it."""
    effect = term.form.effect
    size, std = size_of(effect, known.beta, known.covariance)
    joints = () if effect.whole_robot else tuple(j + 1 for j in effect.joints)
    rivals = tuple(
        dict.fromkeys(_rival_name(effect, r.form.effect) for r in term.rivals)
    )
    curve = (CURVE,) if "curve" in weak else ()
    return Finding(
        effect.name,
        joints,
        dict(effect.shape),
        size,
        effect.parameters[effect.sized_by][0].unit,
        std,
        {p.name: float(b) for p, b in zip(effect.parameters, known.beta, strict=True)},
        "weak" if weak else "confident",
        (*rivals, *curve),
        errors[0],
        errors[1],
        sentence(effect, size, std, rivals),
        effect.text,
        term.evidence,
        tuple(weak.values()),
        effect.constants,
    )


def reasons_for_doubt(
    outcome: SearchOutcome, term: ScoredEffect, known: Size, errors: Array
) -> dict[str, str]:
    """Why a finding is weak, with what is said of it; errors (2, n) : held out, before
    and after it."""
    search = outcome.search
    effect = term.form.effect
    on = sorted(term.joints)
    # An exponent's error changes the number, and hardly the torque.
    size, std = size_of(effect, known.beta, known.covariance_given_constants)
    rows = search.data.rows
    left = outcome.left
    plausible = effect.plausible
    torque = np.mean((spread_columns(rows, effect) @ known.beta) ** 2, axis=1)
    looks_like = effect.looks_like(size, rows.seen(effect.joints[0]))
    gained = errors[0] ** 2 - errors[1] ** 2
    # On its joints, or in all: a wrong gain shows on those that it keeps from a fit.
    explained = max(float(np.sum(np.maximum(gained[on], 0.0))), float(np.sum(gained)))
    beyond = np.sum(left.beyond[on] ** 2) if search.data.known else 0.0
    holds = {
        "rivals": bool(term.rivals),
        "uncertain": (
            not std < UNCERTAIN * abs(size)
        ),  # nothing is known of a size of zero
        "small": not term.evidence > 2.0 * EVIDENCE_TO_ADD,
        "not_held_out": not lowers(errors[0, on], errors[1, on]),
        "more_left": explained < beyond,
        "shared": _shared(search, term) > 1.0 - UNCERTAIN,
        "implausible": (
            bool(np.any(torque > np.mean(rows.torque**2, axis=0)))
            or (
                plausible is not None
                and np.sqrt(np.mean((known.beta / plausible) ** 2)) > IMPLAUSIBLE_SIGMAS
            )
        ),
        "looks_like": bool(looks_like),
        "curve": any(term in o.replaced for o in outcome.curves),
    }
    reasons = {**REASONS, "looks_like": looks_like}
    return {name: reasons[name] for name, true in holds.items() if true}


def _rival_name(effect: Effect, other: Effect) -> str:
    """The rival's name; with its joint, or its constants, where that alone would be the
    finding's."""
    if other.name == effect.name:
        return (
            other.text
            if other.joints == effect.joints
            else f"{other.name}:{other.joints[0] + 1}"
        )
    return other.name


def _shared(search: Search, term: ScoredEffect) -> float:
    """Of a term's energy beside the model's columns what other terms make."""
    energy_alone = search.score.fit([], search.fit).energy(term)
    energy_beside = search.score.fit(
        [t for t in search.terms if t != term], search.fit
    ).energy(term)
    return 1.0 - energy_beside / max(energy_alone, 1e-300)


def invisible_effects(search: Search) -> tuple[Invisible, ...]:
    """Candidates whose energy the model's own columns absorb, whatever their shape;
    what was found all the same has shown itself, and its standard deviation says how
    well."""
    if search.data.frozen:
        return ()
    fit = search.score.fit(())
    shares = dict[tuple[str, int | None], float]()
    for batch in search.library.batches:
        absorbed = search.score.absorbed(fit, batch)
        for form, share in zip(batch.forms, absorbed.tolist(), strict=True):
            shares[form.key] = min(shares.get(form.key, 1.0), share)
    return tuple(
        Invisible(name, () if joint is None else (joint + 1,), share)
        for (name, joint), share in shares.items()
        if share > 1.0 - ABSORBED and (name, joint) not in {t.key for t in search.terms}
    )


def remarks(
    data: WhiteData, residual: Array, held_out: str, new_share: float | None
) -> tuple[str, ...]:
    """Sentences about the diagnosis as a whole."""
    sentences = (
        _NOISE.get(data.noise.source),
        _standstill(data, residual),
        repeatability_warning(new_share),
        _FOLDS if held_out == "folds" else None,
    )
    return tuple(text for text in sentences if text)


#: What is said of a noise that no repetition shows, by its source; and of errors
#: without a test run.
_NOISE = {
    RESIDUAL: (
        "No motion repeats and the log shows no steady noise above the motion's band"
        " (too slow, smoothed before it was logged, or louder in motion), so noise and"
        " model error cannot be separated: the noise shown is the error itself. Record"
        " a run with more than one period."
    ),
    SPECTRUM: (
        "No motion repeats: the noise is that of the torque's spectrum above the"
        f" motion's band, {SPECTRUM_KNOWN}. Record a run with more than one period to"
        " know it better."
    ),
}
_FOLDS = (
    "Held-out errors come from folds by the phase of the motion: sizes from the other"
    " folds, the choice of effects and constants from all rows. A test run (--test)"
    " judges both."
)


def _standstill(data: WhiteData, residual: Array) -> str:
    """Where most of what is left (M, n) is of standstill."""
    keep = data.rows.keep
    moves = data.rows.keep & (data.rows.still <= STILL)
    all_energy = np.sum(residual**2 * keep, axis=0)
    moving = np.sum(residual**2 * moves, axis=0)
    mostly = [int(j) + 1 for j in np.flatnonzero(all_energy > 2.0 * moving)]
    if not mostly:
        return ""
    moving = np.sqrt(moving / np.maximum(moves.sum(axis=0), 1))
    values_in_words = ", ".join(f"{moving[j - 1]:.2g}" for j in mostly)
    return (
        f"Most of the error that is left on {formatting.joints(mostly)} is of"
        " standstill, where dry friction holds any torque up to its own: in motion it"
        f" is {values_in_words} N m or N."
    )


@dataclass(frozen=True)
class Size:
    """beta (k,) and covariance (k, k) of an effect's parameters; the latter of
    ``given`` constants."""

    beta: Array
    covariance: Array
    covariance_given_constants: Array


def constant_std(search: Search, moved: Sequence[Moved], s: ShapeEstimate) -> float:
    """Standard deviation of a constant of the model beside the findings; infinite where
    the rows do not bound it."""
    for change, columns in moved:
        effect = change.effect
        if (
            effect.name == s.effect
            and s.joint in effect.joints
            and s.shape in change.keys
        ):
            left = search.fit.residual_of(search.fit.scaled(columns))[
                :, :, change.keys.index(s.shape)
            ]
            information = float(np.sum(left**2))
            return (
                s.after * prior_deviation(effect, s.shape) / information**0.5
                if information > 1.0
                else np.inf
            )
    return np.inf


def size_of_term(
    search: Search,
    term: ScoredEffect,
    fit_with_tolerances: WhiteFit,
    errors: Array,
    moved: Sequence[Moved],
) -> Size:
    """fit_with_tolerances : a fit of all terms and all that is tolerated; errors (n, M, e) : a factor
    of the covariance of white rows' torque, from :func:`torque_errors`; moved : of
    :meth:`WhiteData.constant_error_columns`."""
    data = search.data
    k = term.form.n_coefficients
    others = [t for t in search.terms if t != term]
    fit = search.score.fit(
        [*others, *search.tolerated(term, others)], fit_with_tolerances
    )
    apart, known = search.score.partial_out(fit, term.form, term.columns)
    moving = [
        fit.residual_of(fit.scaled(z))
        for _, z in moved
        if not term.joints.isdisjoint(z)
    ]
    T = np.concatenate([apart, *moving], axis=2)
    prior = np.concatenate([known**-2.0, np.ones(T.shape[2] - k)])
    A = np.tensordot(T, T, axes=((0, 1), (0, 1))) + np.diag(prior)
    inverse = np.linalg.pinv(A, rcond=1e-12, hermitian=True)
    beta = term.beta
    left = fit.residual - T[:, :, :k] @ beta
    scores = np.sum(T * left[:, :, None], axis=0)[: len(data.clusters[0])]
    sums = cluster_sums(data.clusters, scores)
    # As many degrees of freedom as there are clusters, less those that the fit has
    # taken.
    scaled_sums = (u.T * np.sqrt(len(u) / max(len(u) - T.shape[2], 1.0)) for u in sums)
    inside = [max(scaled_sums, key=lambda u: float(np.sum(u**2)))]
    if errors.shape[2]:
        doubt = fit.residual_of(fit.scaled(dict(enumerate(errors))))
        inside.append(np.tensordot(T, doubt, axes=((0, 1), (0, 1))))
    through = inverse @ np.hstack(inside)
    covariance = through @ through.T
    smallest_covariance = inverse @ (A - np.diag(prior)) @ inverse
    variances = np.diagonal(covariance)
    grown = np.maximum(variances, np.diagonal(smallest_covariance)) / np.maximum(
        variances, 1e-300
    )
    covariance = covariance * np.sqrt(grown[:, None] * grown)
    covariance_given_constants = np.linalg.pinv(
        np.linalg.pinv(covariance, hermitian=True)[:k, :k], hermitian=True
    )
    return Size(beta, covariance[:k, :k], covariance_given_constants)


def torque_errors(data: WhiteData, estimate: Estimate, gain_errors: Array) -> Array:
    """(n, M, e) white rows of the torque that is in doubt before anything is searched.

    gain_errors (n, e) : a factor of the covariance of the channels' gains. A model that
    is held fixed brings its parameters' spread along, and what the same gains have made
    of them.
    """
    known = estimate.uncertainty
    rows = data.rows
    n = rows.n
    M = len(rows.t)
    if not data.frozen and not gain_errors.any():
        return np.zeros((n, M, 0))
    columns = model_columns(rows, estimate)
    parts = []
    for j in range(n):
        gains = -columns[j] @ known.gain_response
        gains[:, j] += rows.torque[:, j]
        part = gains @ gain_errors
        if data.frozen:
            part = np.hstack([part, -columns[j] @ known.spread])
        parts.append(data.white(part, j))
    return np.stack(parts)


def retune(
    s: ShapeEstimate,
    robot: Robot,
    before: Array,
    after: Array,
    is_harmful: bool = False,
) -> Retune:
    """before, after (n,) : held-out errors of all findings without the new constant,
    and with it; is_harmful : whether it does harm beside the sure findings alone."""
    shape = effect_types()[s.effect].shapes[s.shape]
    kind = robot.joints[s.joint].kind
    values = [shape.format_with_unit(v, kind) for v in (s.after, s.before)]
    unit = plain_unit(robot.torque_units[s.joint])
    errors = float(before[s.joint]), float(after[s.joint])
    explanation = (
        f"joint {s.joint + 1}: {s.effect} has {s.shape} = {values[0]}, not {values[1]}"
    )
    explanation += f"; held-out error {errors[0]:.3g} to {errors[1]:.3g} {unit}"
    remarks = ["it lies at the end of the range in which it was looked for"] * s.at_end
    remarks += [REASONS["alone"]] * is_harmful
    return Retune(
        s, "weak" if remarks else "confident", *errors, explanation, tuple(remarks)
    )


# In words.


def size_of(effect: Effect, beta: Array, covariance: Array) -> tuple[float, float]:
    """One number for the size of an effect, and its standard deviation.

    The parameter that the effect is sized by, with its sign; the norm where it is
    several.
    """
    b = beta[effect.sized_by]
    c = covariance[effect.sized_by, effect.sized_by]
    if len(b) == 1:
        return float(b[0]), float(max(c[0, 0], 0.0) ** 0.5)
    size = float(np.linalg.norm(b))
    if size == 0.0:
        return 0.0, float(np.sqrt(np.trace(c)))
    direction = b / size
    return size, float(max(float(direction @ c @ direction), 0.0) ** 0.5)


def sentence(effect: Effect, size: float, std: float, rivals: Sequence[str]) -> str:
    """What was found, in one or two sentences."""
    unit = effect.parameters[effect.sized_by][0].unit
    where = (
        "the whole robot"
        if effect.whole_robot
        else "joint " + "+".join(str(j + 1) for j in effect.joints)
    )
    amount = size_with_interval(size, std, unit)
    head = f"{effect.name} on {where}: {amount}"
    head += f" ({effect.constants})" if effect.constants else ""
    text = f"{head}. {effect.explanation} {effect.remark(size)}".rstrip()
    if rivals:
        text += f" Indistinguishable in these data from {', '.join(rivals)}."
    return text


def repeatability_warning(new_share: float | None) -> str | None:
    """One sentence where most of the judged motion is the training motion again, else
    None."""
    if new_share is None or new_share >= MOSTLY_NEW:
        return None
    percent = f"{100.0 * new_share:.0f}"
    return (
        f"{'None' if percent == '0' else f'Only {percent} %'} of the judged motion is"
        " new to the model: these errors show repeatability; judge on another motion"
        " to see how it generalises."
    )
