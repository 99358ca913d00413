"""The verb ``add``: an effect joins the model, and everything is identified again."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sdp_vs_penalty.data.files import Source, as_measurements
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.diagnosis.constants import IMPLAUSIBLE_SIGMAS
from sdp_vs_penalty.diagnosis.findings import Diagnosis, Finding, Retune
from sdp_vs_penalty.diagnosis.held_out import estimator_beside, task_beside
from sdp_vs_penalty.diagnosis.library import Candidate, Library
from sdp_vs_penalty.diagnosis.linear_fit import ScoredEffect
from sdp_vs_penalty.diagnosis.search import Search
from sdp_vs_penalty.diagnosis.white_rows import diagnosis_rows, whiten_rows
from sdp_vs_penalty.effects import parse_effects
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.build_problem import PoseOptions, independent_gains
from sdp_vs_penalty.estimation.certificate import Certificate
from sdp_vs_penalty.estimation.estimate import Estimate, as_estimate
from sdp_vs_penalty.estimation.identify import (
    certify,
    certify_beside,
    estimate_parameters,
    on_bounds,
    parameter_sources,
    versions,
)
from sdp_vs_penalty.estimation.sensitivity import (
    fit_constants_jointly,
    free_constants,
    sensitivities,
)
from sdp_vs_penalty.estimation.shapes import ShapeEstimate, with_shapes
from sdp_vs_penalty.estimation.uncertainty import Uncertainty, beside_held
from sdp_vs_penalty.estimators.estimator import (
    Estimator,
    Progress,
    Task,
    no_progress,
)
from sdp_vs_penalty.regression.base_parameters import BaseParameters, base_rows
from sdp_vs_penalty.regression.regression import compress
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.filtered import FilteredRuns
from sdp_vs_penalty.signals.motion import record_motion


def add(
    estimate: Estimate | str | Path,
    effects: str | Diagnosis | Sequence[Finding | Retune | str],
    measurements: Source,
    *,
    frozen: bool = False,
    seed: int = 0,
    progress: Progress = no_progress,
    gain_uncertainty: float | None = None,
) -> Estimate:
    """Extend a model by effects, and identify it again.

    The model's own method and its problem's constraints apply. A shape constant without
    a value is estimated, joint by joint.

    Parameters
    ----------
    estimate : Estimate, str or Path
        The model to extend, or its model.json.
    effects : str, Diagnosis, or sequence of Finding, Retune or str
        ``name[:joints][@shape=value]``, several separated by commas, or what
        :func:`diagnose` found: all of it, or some of its findings. An effect that the
        model has already takes the new shape constants
        (``coulomb_friction:7@v_s=0.08``).
    measurements : path, arrays, DataFrame, Measurements, list of these
        The runs to identify it from.
    frozen : bool
        Keep all other parameters. The same happens with the findings of a frozen
        diagnosis, and wherever the model has a payload or gets one: refitted links
        would absorb it. Findings about a frozen model's own effects are left out;
        identify it again for these.
    seed : int
        Of the method.
    progress : callable
        Hears where the computation stands, a short text each time.
    gain_uncertainty : float, optional
        Relative standard deviation of the torque channels' gains; default: the model's.

    Returns
    -------
    Estimate
        The extended model, with a certificate of its own.

    Raises
    ------
    InputError
        For an effect that the model has already, without a new constant for it, or for
        one that cannot act.
    """
    estimate = as_estimate(estimate, "add(estimate=...)")
    measurements = as_measurements(
        measurements,
        names=estimate.robot.joint_names,
        what="add(measurements=...)",
    )
    estimate.require_joints(measurements)
    measurements.require_torque("add")
    if isinstance(effects, Diagnosis):
        frozen = frozen or effects.frozen
    texts = _written(effects, estimate)
    new_effects = parse_effects(texts, estimate.robot)
    if not new_effects:
        raise InputError(
            "No effect to add", "name one, such as presliding_hysteresis:7"
        )
    added, retuned = _retunes(estimate, new_effects, frozen)
    if frozen and isinstance(effects, Diagnosis):
        added = _without_held(estimate, added)
    # Refuses what is there already; what may come several times is known by its
    # constants only.
    once = [e for e in added if not e.several]
    Model(estimate.robot, (*estimate.model.effects, *once))
    frozen = frozen or any(e.frozen_only for e in (*estimate.model.effects, *added))
    gain_errors = estimate.uncertainty.gain_errors
    if gain_uncertainty is not None:
        gain_errors = independent_gains(gain_uncertainty, estimate.robot.n)
    filtered = FilteredRuns.of(measurements, estimate.preprocessing)
    progress("estimating shape constants")
    new = estimate_constants(estimate, added, measurements, frozen)
    # Refuses constants that are there already.
    Model(estimate.robot, (*estimate.model.effects, *new))
    if frozen:
        made = _add_frozen(estimate, new, filtered, seed, progress, gain_errors)
    else:
        again = _Again(estimate, filtered, gain_errors, seed, progress)
        to_estimate = [e for e in added if not all_given(e)]
        made = again.identified_jointly([*_own(estimate, retuned), *new], to_estimate)
    return _with_noise_of(estimate, made)


def _written(
    effects: str | Diagnosis | Sequence[Finding | Retune | str], estimate: Estimate
) -> str:
    """Effects as they are written, separated by commas; of a diagnosis all of it."""
    if isinstance(effects, str):
        return effects
    if isinstance(effects, Diagnosis):
        curves = [c.effect(estimate.robot).text for c in effects.curves]
        effects = (*effects.retuned, *effects.beside_curves, *curves)
    return ",".join(e if isinstance(e, str) else e.text for e in effects)


def _without_held(estimate: Estimate, added: Sequence[Effect]) -> list[Effect]:
    """Effects that a held model does not have: what has changed of its own ones only
    identifying them again takes in."""
    there = {(e.name, j) for e in estimate.model.effects for j in e.joints}
    new = [e for e in added if e.several or not there & {(e.name, j) for j in e.joints}]
    if not new:
        raise InputError(
            "All these effects are the held model's own",
            "identify it again on these runs",
        )
    return new


@dataclass(frozen=True)
class _Again:
    """A model that is identified again, with other effects, by its own method."""

    estimate: Estimate
    runs: FilteredRuns
    gain_errors: Array
    seed: int
    progress: Progress

    def identified(self, effects: Sequence[Effect]) -> Estimate:
        """The model with some effects."""
        options = PoseOptions(
            effects=effects,
            weighting=self.estimate.weighting,
            gain_uncertainty=self.gain_errors,
            seed=self.seed,
        )
        return estimate_parameters(
            self.estimate.problem,
            self.runs,
            self.estimate.estimator,
            options,
            progress=self.progress,
        )

    def identified_jointly(
        self,
        effects: Sequence[Effect],
        to_estimate: Sequence[Effect],
    ) -> Estimate:
        """The same where shape constants of effects and the model's own may move each
        other: at their joint optimum."""
        extended = self.identified(effects)
        together = joint_optimum_of_constants(extended, to_estimate, self.runs)
        if together is None:
            return extended
        model, shapes = together
        extended = self.identified(model.effects)
        details = {
            **extended.details,
            "shapes": [s.to_dict() for s in shapes],
        }
        return replace(extended, details=details)


def _with_noise_of(estimate: Estimate, made: Estimate) -> Estimate:
    """A model that grew from another one, with the noise floor that that one keeps."""
    if noise := estimate.provenance.get("noise"):
        made.provenance["noise"] = noise
    return made


def _retunes(
    estimate: Estimate,
    new_effects: Sequence[Effect],
    frozen: bool,
) -> tuple[list[Effect], list[ShapeEstimate]]:
    """The effects that are new to the model, and the constants of those that it has
    already."""
    there = {
        (e.name, j): e
        for e in estimate.model.effects
        for j in e.joints
        if not e.several
    }
    new = list[Effect]()
    retuned = list[ShapeEstimate]()
    for effect in new_effects:
        present = [there.get((effect.name, j)) for j in effect.joints]
        if frozen or not effect.given or not all(present):
            new.append(effect)
            continue
        for joint, old in zip(effect.joints, present, strict=True):
            assert old is not None
            for key in effect.given:
                change = ShapeEstimate(
                    effect=effect.name,
                    joint=joint,
                    shape=key,
                    before=old.shape[key],
                    after=effect.shape[key],
                    std=0.0,
                    gain=0.0,
                    at_end=False,
                )
                retuned.append(change)
    return new, retuned


def _own(estimate: Estimate, retuned: Sequence[ShapeEstimate]) -> list[Effect]:
    """The model's own effects: constants that `identify` estimated are estimated again
    beside what is new; those that are retuned are what they are told to be."""
    estimated = {
        (s["effect"], s["joint"] - 1, s["shape"])
        for s in estimate.details.get("shapes", ())
    }
    estimated -= {(r.effect, r.joint, r.shape) for r in retuned}
    out = []
    for effect in with_shapes(estimate.model.effects, retuned):
        keys = [
            k
            for k in effect.shapes
            if all((effect.name, j, k) in estimated for j in effect.joints)
        ]
        out.append(effect.with_free_shapes(keys) if keys else effect)
    return out


def _add_frozen(
    estimate: Estimate,
    new: Sequence[Effect],
    runs: FilteredRuns,
    seed: int,
    progress: Progress,
    gain_errors: Array,
) -> Estimate:
    """The estimate with new effects, fitted alone to what the model leaves, under their
    own constraints."""
    fit = _fit_new_effects(estimate, new, runs, seed, progress)
    theta = np.concatenate([estimate.theta, fit.theta])
    problem = estimate.problem
    base = base_rows(problem, fit.model_of_new)
    sources = parameter_sources(
        fit.task,
        fit.theta,
        base,
        fit.estimator.undetermined_by,
    )
    old = estimate.details
    details = {
        "undetermined": {**old.get("undetermined", {}), **sources["undetermined"]},
        "base_parameters": [
            *old.get("base_parameters", []),
            *sources["base_parameters"],
        ],
        "on_bounds": on_bounds(problem.constraints(fit.model), theta),
    }
    provenance = {
        **estimate.provenance,
        "seed": seed,
        "data_hash": runs.measurements.data_hash,
        "runs": list(runs.measurements.names),
        "samples": runs.measurements.samples,
        "versions": versions(),
        "verdict": None,  # that of the smaller model is not this one's
    }
    known_motion = estimate.training_motion
    new_motion = record_motion(runs)
    training_motion = None
    if known_motion is not None and new_motion is not None:
        training_motion = known_motion.joined(new_motion)
    return replace(
        estimate,
        model=fit.model,
        theta=theta,
        uncertainty=_uncertainty_beside(estimate, fit, runs, base, gain_errors),
        certificate=certify_beside(estimate, fit.model, theta, fit.certificate),
        details=details,
        provenance=provenance,
        training_motion=training_motion,
    )


@dataclass(frozen=True)
class _FitBeside:
    """New effects fitted beside a model that is kept.

    model : with both; model_of_new : the new effects alone; theta (p,) : theirs.
    """

    model: Model
    model_of_new: Model
    task: Task
    estimator: Estimator
    theta: Array
    certificate: Certificate


def _fit_new_effects(
    estimate: Estimate,
    new: Sequence[Effect],
    runs: FilteredRuns,
    seed: int,
    progress: Progress,
) -> _FitBeside:
    """New effects fitted to what a model leaves; twice where columns refer to torque, of
    which theirs is a part."""
    model_of_new = Model(
        estimate.robot,
        tuple(new),
        gains=estimate.model.gains,
    )
    model = replace(
        estimate.model,
        effects=(*estimate.model.effects, *new),
        reference=None,
    )
    known = estimate.model.reference
    if known is None:
        known = estimate.theta
    estimator = estimator_beside(estimate)
    theta = np.zeros(len(model_of_new.parameters))
    for _ in range(2 if model.needs_reference else 1):
        if model.needs_reference:
            model = replace(model, reference=np.append(known, theta))
        progress("compressing the measurements")
        left = compress(runs, model).given_first(estimate.theta)
        task = task_beside(estimate, model_of_new, left, seed, progress)
        progress("estimating the new effects")
        theta, certificate = certify(task, estimator.fit(task))
    return _FitBeside(model, model_of_new, task, estimator, theta, certificate)


def _uncertainty_beside(
    estimate: Estimate,
    fit: _FitBeside,
    runs: FilteredRuns,
    base: BaseParameters,
    gain_errors: Array,
) -> Uncertainty:
    """Of all parameters: intervals of new effects hold the errors of their shape
    constants and of the parameters that were kept."""
    model = fit.model
    betas = [fit.theta[k] for k in fit.model_of_new.indices]
    constants = sensitivities(fit.model_of_new.effects, betas)
    reference = model.reference
    if reference is not None:
        n_constants = sum(len(e.parameters) for e in constants)
        reference = np.append(reference, np.zeros(n_constants))
    wide = Model(
        model.robot,
        (*model.effects, *constants),
        reference,
        model.gains,
    )
    return beside_held(
        fit.task,
        compress(runs, wide),
        (estimate.theta, estimate.uncertainty),
        base_rows(estimate.problem, estimate.model),
        fit.theta,
        base,
        gain_errors,
    )


# The shape constants of what joins, and of the model's own beside them.


def _given_constants(effect: Effect) -> frozenset[str]:
    """The shape constants that are not searched: given ones, and those that the effect
    has and its class has not, which say what it acts on, as its joints do."""
    return effect.given | (set(effect.shape) - set(type(effect).shapes))


def all_given(effect: Effect) -> bool:
    """Whether nothing is left to estimate of an effect's shape constants."""
    clock = {key for key, shape in effect.shapes.items() if shape.role == "clock"}
    return _given_constants(effect) >= clock.union(effect.searched)


def estimate_constants(
    estimate: Estimate,
    new_effects: Sequence[Effect],
    measurements: Measurements,
    frozen: bool,
) -> list[Effect]:
    """The effects with all constants that were not given estimated, one effect a joint
    where so."""
    out: list[Effect] = []
    search: Search | None = None
    for effect in new_effects:
        if all_given(effect):
            out.append(effect)
            continue
        if search is None:
            settings = estimate.preprocessing.resolve(measurements)
            rows = diagnosis_rows(measurements, estimate, settings)
            search = Search(whiten_rows(rows, estimate, frozen), Library())
        joints = (
            [None]
            if effect.whole_robot
            else effect.joints[:1]
            if effect.joins
            else effect.joints
        )
        out += [_shaped(search, effect, joint) for joint in joints]
    return out


def _shaped(
    search: Search,
    effect: Effect,
    joint: int | None,
) -> Effect:
    """One joint's effect with the shape that scores most; given ones stay."""
    fixed = _given_constants(effect)
    start = min(float(s.motion.t[0]) for s in search.data.rows.segments)
    constants_given = {key: effect.shape[key] for key in fixed}
    forms = [
        Candidate((effect.name, joint), one)
        for one in effect.candidates(effect.robot, joint, start, **constants_given)
    ]
    best = dict[tuple[Hashable, ...], ScoredEffect]()
    for term in sorted(
        (search.evidence_of(search.fit, form) for form in forms),
        key=lambda t: t.evidence,
    ):
        best[term.form.discrete_choice] = term
    best_terms = (
        search.refined(
            search.fit,
            term,
            fixed,
        )
        for term in best.values()
    )
    return max(best_terms, key=lambda t: t.evidence).form.effect


def joint_optimum_of_constants(
    extended: Estimate,
    added: Sequence[Effect],
    runs: FilteredRuns,
) -> tuple[Model, list[ShapeEstimate]] | None:
    """The model with its own estimated constants and those of what was ``added`` on the
    same joints at their joint optimum, and its own as `identify` states them; None
    where none of these moves."""
    shapes = list(map(ShapeEstimate.from_dict, extended.details.get("shapes", ())))
    new = {
        (e.name, j, key)
        for e in added
        if not (e.whole_robot or e.joins or e.several)
        for j in e.joints
        for key in free_constants(e)
        if key not in e.given
    }
    joints = {j for _, j, _ in new}
    own_constants = {
        (s.effect, s.joint, s.shape): s for s in shapes if s.joint in joints
    }
    keys_to_estimate = {
        key for key in new if key[1] in {j for _, j, _ in own_constants}
    }.union(own_constants)
    if not keys_to_estimate:
        return None
    best = fit_constants_jointly(
        extended.model,
        keys_to_estimate,
        lambda model: compress(runs, model),
        extended.weighting,
    )
    effects = best.model.effects
    std = best.std
    values = {
        (e.name, j, k): v for e in effects for k, v in e.shape.items() for j in e.joints
    }
    if not any(
        abs(np.log(values[k] / s.after)) > IMPLAUSIBLE_SIGMAS * std[k]
        for k, s in own_constants.items()
    ):
        return None
    out = [
        (
            replace(s, after=values[k], std=values[k] * std[k])
            if (k := (s.effect, s.joint, s.shape)) in own_constants
            else s
        )
        for s in shapes
    ]
    return best.model, out
