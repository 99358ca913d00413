"""An effect joins a model, and everything is identified again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from sdp_vs_penalty.data.files import Source, as_measurements, training_runs
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.diagnosis.constants import IMPLAUSIBLE_SIGMAS
from sdp_vs_penalty.diagnosis.finding import Finding, Retune
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.diagnosis.held_out import estimator_beside, task_beside
from sdp_vs_penalty.diagnosis.library import Candidate, Library
from sdp_vs_penalty.diagnosis.linear_fit import ScoredEffect
from sdp_vs_penalty.diagnosis.passing.cause import beside_spans
from sdp_vs_penalty.diagnosis.search import Search
from sdp_vs_penalty.diagnosis.sizes_in_model import with_intervals_of_search
from sdp_vs_penalty.diagnosis.white_rows import diagnosis_rows, whiten_rows
from sdp_vs_penalty.effects import EXAMPLES, parse_effects
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.build_problem import PoseOptions
from sdp_vs_penalty.estimation.certificate import Certificate
from sdp_vs_penalty.estimation.estimate import Estimate, as_estimate
from sdp_vs_penalty.estimation.identify import (
    certify,
    certify_beside,
    estimate_parameters,
    on_bounds,
    versions,
)
from sdp_vs_penalty.estimation.model_file import Details
from sdp_vs_penalty.estimation.sensitivity import (
    fit_constants_jointly,
    free_constants,
    sensitivities,
)
from sdp_vs_penalty.estimation.shapes import (
    ConstantKey,
    ShapeEstimate,
    constants_at_ends,
    with_shapes,
)
from sdp_vs_penalty.estimation.sources import parameter_sources
from sdp_vs_penalty.estimation.uncertainty import Uncertainty, beside_held
from sdp_vs_penalty.estimators.estimator import (
    Estimator,
    Progress,
    Task,
    fitted,
    no_progress,
    require_proof,
)
from sdp_vs_penalty.regression.base_parameters import BaseParameters, base_rows
from sdp_vs_penalty.regression.regression import compress
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.filtered import FilteredRuns
from sdp_vs_penalty.signals.motion import MotionRecord, record_motion


def add(
    estimate: Estimate | str | Path,
    effects: str | Diagnosis | Sequence[Finding | Retune | str],
    measurements: Source,
    *,
    frozen: bool = False,
    seed: int = 0,
    progress: Progress = no_progress,
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
        (``coulomb_friction:7@v_s=0.08``). Intervals of findings include what the
        search says of their sizes; those of effects that are named do not.
    measurements : path, arrays, DataFrame, Measurements, list of these
        The runs to identify it from; with a diagnosis without the spans in which it says
        that something acts for a part of the time.
    frozen : bool
        Keep all other parameters. The same happens with the findings of a frozen
        diagnosis, and wherever the model has a payload or gets one: refitted links
        would absorb it. Findings about a frozen model's own effects are left out;
        identify it again for these.
    progress : callable
        Hears where the computation stands, a short text each time.

    Returns
    -------
    Estimate
        The extended model, with a certificate of its own. It has no verdict yet.

    Raises
    ------
    InputError
        For an effect that the model has already, without a new constant for it, or for
        one that cannot act.
    """
    estimate = as_estimate(estimate, "add(estimate=...)")
    measurements = as_measurements(
        training_runs(measurements),
        names=estimate.problem.channel_names,
        what="add(measurements=...)",
    )
    estimate.require_joints(measurements)
    measurements.require_torque("add")
    if isinstance(effects, Diagnosis):
        frozen = frozen or effects.frozen
        measurements = beside_spans(measurements, effects.left_out)
    added, retuned = _read_effects(estimate, effects, frozen)
    frozen = frozen or any(e.frozen_only for e in (*estimate.model.effects, *added))
    filtered = FilteredRuns.filtering(measurements, estimate.preprocessing)
    progress("estimating shape constants")
    new = estimate_constants(estimate, added, measurements, frozen)
    _refuse_duplicates(estimate, new)
    if frozen:
        extended = _add_frozen(estimate, new, filtered, seed, progress)
    else:
        again = _Again(estimate, filtered, seed, progress)
        to_estimate = [e for e in added if not all_given(e)]
        all_effects = [*_own(estimate, retuned), *new]
        extended = again.identified_jointly(all_effects, to_estimate)
    searched = _searched_constants(added, _findings_of(effects))
    searched |= set(estimate.report.at_ends or ()) - {change.key for change in retuned}
    at_ends = tuple(k for k in constants_at_ends(extended.model) if k in searched)
    extended = replace(extended, report=replace(extended.report, at_ends=at_ends))
    extended = with_intervals_of_search(extended, _findings_of(effects))
    if noise := estimate.provenance.get("noise"):
        extended.provenance["noise"] = noise
    return extended


def identify_with(
    estimate: Estimate, effects: Sequence[Effect], runs: FilteredRuns
) -> Estimate:
    """Identify a model again with these effects as its only ones, by its own method and
    constraints; constants that `identify` had estimated are estimated again."""
    again = _Again(estimate, runs, seed=0, progress=no_progress)
    return again.identified(_reopened(effects, estimate.report.shapes))


def _searched_constants(
    added: Sequence[Effect], findings: Sequence[Finding]
) -> set[ConstantKey]:
    """Return the shape constants of added effects that a search has chosen: those of a
    finding, and those without a value in the text of an effect."""
    found = {(f.effect, number - 1) for f in findings for number in f.joints}
    return {
        (effect.name, joint, name)
        for effect in added
        for joint in effect.joints
        for name in effect.searched
        if (effect.name, joint) in found or name not in _given_constants(effect)
    }


def _findings_of(
    effects: str | Diagnosis | Sequence[Finding | Retune | str],
) -> list[Finding]:
    """Return the findings among the effects that :func:`add` takes."""
    if isinstance(effects, Diagnosis):
        return list(effects.beside_curves)
    return [e for e in effects if isinstance(e, Finding)]


def _read_effects(
    estimate: Estimate,
    effects: str | Diagnosis | Sequence[Finding | Retune | str],
    frozen: bool,
) -> tuple[list[Effect], list[ShapeEstimate]]:
    """Separate what is to be added to a model: new effects, and new values of shape
    constants (such as a Stribeck velocity) of effects that it has.

    If the model's parameters stay fixed (``frozen``), constants of its effects do, too.

    Raises
    ------
    InputError
        There is no effect, nor any span to leave out; an effect is unknown, or the
        model has it already.
    """
    new_effects = parse_effects(_written(effects, estimate), estimate.robot)
    leaves_spans_out = isinstance(effects, Diagnosis) and bool(effects.left_out)
    if not new_effects and (frozen or not leaves_spans_out):
        raise InputError("No effect to add", f"name one, such as {EXAMPLES[0]}")
    added, retuned = _retunes(estimate, new_effects, frozen)
    if frozen and isinstance(effects, Diagnosis):
        added = _without_held(estimate, added)
    # Effects that may come several times on a joint are duplicates only if their shape
    # constants are equal, which are estimated later.
    _refuse_duplicates(estimate, [e for e in added if not e.several])
    return added, retuned


def _refuse_duplicates(estimate: Estimate, new: Sequence[Effect]) -> None:
    """Raise InputError if a model already has one of the new effects on one of its
    joints.
    """
    # A model refuses an effect that comes twice.
    Model(estimate.robot, (*estimate.model.effects, *new))


def _written(
    effects: str | Diagnosis | Sequence[Finding | Retune | str], estimate: Estimate
) -> str:
    """Write effects as one text with commas, ``name[:joints][@shape=value]`` each.

    Of a diagnosis these are its re-estimated constants, the findings that no measured
    curve replaces, and the curves.
    """
    if isinstance(effects, str):
        return effects
    if isinstance(effects, Diagnosis):
        curves = [c.effect(estimate.robot).text for c in effects.curves]
        effects = (*effects.retuned, *effects.beside_curves, *curves)
    return ",".join(e if isinstance(e, str) else e.text for e in effects)


def _without_held(estimate: Estimate, added: Sequence[Effect]) -> list[Effect]:
    """Return those effects that a model with fixed parameters does not have already.

    Changes of its own effects would need an identification of all parameters.

    Raises
    ------
    InputError
        The model has all of the effects.
    """
    of_model = {(e.name, j) for e in estimate.model.effects for j in e.joints}
    new = [
        e for e in added if e.several or not of_model & {(e.name, j) for j in e.joints}
    ]
    if not new:
        raise InputError(
            "All these effects are the held model's own",
            "identify it again on these runs",
        )
    return new


@dataclass(frozen=True)
class _Again:
    """Identifies a model again with other effects, by its own method and constraints."""

    #: The model to identify again.
    estimate: Estimate
    #: The filtered runs to fit.
    runs: FilteredRuns
    #: Seed of the method's random choices.
    seed: int
    #: Called with a short text at each step.
    progress: Progress

    def identified(self, effects: Sequence[Effect]) -> Estimate:
        """Identify all parameters of the model anew, with these effects as its only
        effects.
        """
        options = replace(
            PoseOptions.of_model(self.estimate),
            effects=effects,
            seed=self.seed,
            progress=self.progress,
        )
        again = estimate_parameters(
            self.estimate.problem, self.runs, self.estimate.estimator, options
        )
        known = self.estimate.provenance
        if known["runs"] == again.provenance["runs"]:  # and so are their doubts
            again.provenance["checks"] = known.get("checks", {})
        return again

    def identified_jointly(
        self, effects: Sequence[Effect], to_estimate: Sequence[Effect]
    ) -> Estimate:
        """Identify the model with these effects, and optimise shape constants jointly.

        Shape constants are non-linear constants of effects, such as a Stribeck
        velocity. If those of the model change beside the added ones, the model is
        identified a second time with the joint optimum of all.

        Parameters
        ----------
        effects
            All effects of the extended model.
        to_estimate
            Those of them whose shape constants were not given and are estimated.
        """
        extended = self.identified(effects)
        together = joint_optimum_of_constants(extended, to_estimate, self.runs)
        if together is None:
            return extended
        model, shapes = together
        extended = self.identified(model.effects)
        return replace(extended, report=replace(extended.report, shapes=tuple(shapes)))


def _retunes(
    estimate: Estimate, new_effects: Sequence[Effect], frozen: bool
) -> tuple[list[Effect], list[ShapeEstimate]]:
    """Separate effects that are new to the model from new constants of its own effects.

    Parameters
    ----------
    new_effects
        The effects as they were written.
    frozen
        True: all effects count as new; a model held fixed keeps its constants.

    Returns
    -------
    list of Effect
        The effects that the model does not have on all of their joints, or that are
        written without a constant.
    list of ShapeEstimate
        For each constant of the model's effects that was given: its value before and
        after.
    """
    effects_by_key = {
        (e.name, j): e
        for e in estimate.model.effects
        for j in e.joints
        if not e.several
    }
    new = list[Effect]()
    retuned = list[ShapeEstimate]()
    for effect in new_effects:
        present = [effects_by_key.get((effect.name, j)) for j in effect.joints]
        if frozen or not effect.given or not all(present):
            new.append(effect)
            continue
        for joint, old in zip(effect.joints, present, strict=True):
            assert old is not None
            for key in effect.given:
                change = ShapeEstimate(
                    effect=effect.name,
                    joint=joint + 1,
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
    """Return the model's own effects with changed shape constants, ready for
    identification.

    Shape constants are non-linear constants, such as a Stribeck velocity. Those that
    `identify` had estimated are marked as free, and are estimated again beside new
    effects.

    Parameters
    ----------
    retuned
        Constants with new values, at which they stay fixed.
    """
    fixed = {r.key for r in retuned}
    estimated = [s for s in estimate.report.shapes if s.key not in fixed]
    return _reopened(with_shapes(estimate.model.effects, retuned), estimated)


def _reopened(
    effects: Sequence[Effect], estimated: Sequence[ShapeEstimate]
) -> list[Effect]:
    """Return effects with those of their shape constants free that were estimated."""
    free = {s.key for s in estimated}
    out = []
    for effect in effects:
        its_free = [
            shape
            for shape in effect.shapes
            if all((effect.name, j, shape) in free for j in effect.joints)
        ]
        out.append(effect.with_free_shapes(its_free) if its_free else effect)
    return out


def _add_frozen(
    estimate: Estimate,
    new: Sequence[Effect],
    runs: FilteredRuns,
    seed: int,
    progress: Progress,
) -> Estimate:
    """Add effects to a model whose parameters stay fixed.

    The effects are fitted to the residual torque of the model, under their own
    constraints.

    Parameters
    ----------
    progress
        Called with a text at each step.

    Returns
    -------
    Estimate
        The extended model. Certificate, report and provenance are of both together.
    """
    fit = _fit_new_effects(estimate, new, runs, seed, progress)
    theta = np.concatenate([estimate.theta, fit.theta])
    problem = estimate.problem
    # Which of the new parameters the data determine, beside the model's record of its
    # own.
    base = base_rows(fit.model_of_new, problem.independent)
    sources = parameter_sources(
        fit.task,
        fit.theta,
        base,
        fit.estimator.undetermined_by,
        nominal=fit.task.nominal,
    )
    old = estimate.report
    of_both = {
        "undetermined": {**old.undetermined, **sources["undetermined"]},
        "base_parameters": old.base_parameters + sources["base_parameters"],
    }
    bounds = on_bounds(problem.constraints(fit.model), theta)
    provenance = {
        **estimate.provenance,
        "seed": seed,
        "data_hash": runs.measurements.data_hash,
        "runs": list(runs.measurements.names),
        "samples": runs.measurements.samples,
        "versions": versions(),
        "verdict": None,  # that of the smaller model is not this one's
    }
    uncertainty = _uncertainty_beside(estimate, fit, runs, base)
    return replace(
        estimate,
        model=fit.model,
        theta=theta,
        uncertainty=uncertainty.agreeing_with_sources(**of_both),
        certificate=certify_beside(estimate, fit.model, theta, fit.certificate),
        report=Details(on_bounds=bounds, **of_both),
        provenance=provenance,
        training_motion=_joined_motion(estimate, runs),
    )


def _joined_motion(estimate: Estimate, runs: FilteredRuns) -> MotionRecord | None:
    """Join the records of the motion that a model was fitted to, and of new runs.

    None if one of the two is not recorded.
    """
    known_motion = estimate.training_motion
    new_motion = record_motion(runs)
    if known_motion is None or new_motion is None:
        return None
    return known_motion.joined(new_motion)


@dataclass(frozen=True)
class _FitBeside:
    """New effects fitted beside a model whose parameters stay fixed."""

    #: The model with the new effects.
    model: Model
    #: A model of the new effects alone.
    model_of_new: Model
    #: The data and constraints of the fit.
    task: Task
    #: The method of the fit.
    estimator: Estimator
    #: (p,) parameters of the new effects, in SI units.
    theta: Array
    #: The certificate of the fit.
    certificate: Certificate


def _fit_new_effects(
    estimate: Estimate,
    new: Sequence[Effect],
    runs: FilteredRuns,
    seed: int,
    progress: Progress,
) -> _FitBeside:
    """Fit new effects to the residual torque of a model whose parameters stay fixed.

    Some effects (a gain, a delay) have columns that are computed from the modelled
    torque, to which the new effects contribute. The fit is then done twice: the second
    time with the torque that the first one found.

    Parameters
    ----------
    progress
        Called with a text at each step.
    """
    model_of_new = Model(estimate.robot, tuple(new), gains=estimate.model.gains)
    model = replace(
        estimate.model, effects=(*estimate.model.effects, *new), reference=None
    )
    # The reference: parameters from which torque for such columns is computed.
    known = estimate.model.reference
    if known is None:
        known = estimate.theta
    estimator = estimator_beside(estimate)
    theta = np.zeros(len(model_of_new.parameters))
    for _ in range(2 if model.needs_reference else 1):
        if model.needs_reference:
            model = replace(model, reference=np.append(known, theta))
        progress("compressing the measurements")
        torque_left = compress(runs, model).given_first(estimate.theta)
        task = task_beside(estimate, model_of_new, torque_left, seed, progress)
        progress("estimating the new effects")
        fit = fitted(estimator, task)
        require_proof(estimator, fit)
        theta, certificate = certify(task, fit)
    return _FitBeside(model, model_of_new, task, estimator, theta, certificate)


def _uncertainty_beside(
    estimate: Estimate, fit: _FitBeside, runs: FilteredRuns, base: BaseParameters
) -> Uncertainty:
    """Compute the uncertainty of all parameters of a model with new effects.

    Intervals of the new effects include, to first order, the errors of their shape
    constants and of the model's parameters that were held fixed.

    Parameters
    ----------
    estimate
        The model that was held fixed.
    fit
        The new effects fitted to its residual torque.
    base
        Base parameters (identifiable combinations) of the new effects.
    """
    model = fit.model
    betas = [fit.theta[k] for k in fit.model_of_new.indices]
    constants = sensitivities(fit.model_of_new.effects, betas)
    reference = model.reference
    if reference is not None:
        n_constants = sum(len(e.parameters) for e in constants)
        reference = np.append(reference, np.zeros(n_constants))
    wide = Model(model.robot, (*model.effects, *constants), reference, model.gains)
    held = (estimate.theta, estimate.uncertainty)
    return beside_held(fit.task, compress(runs, wide), held, fit.theta, base)


# The shape constants of what joins, and of the model's own beside them.


def _given_constants(effect: Effect) -> frozenset[str]:
    """Return the names of an effect's shape constants that stay fixed in a search.

    These are the ones that were written with a value, and those that only this instance
    of the effect has: the latter say what it acts on, such as the ratios of a coupled
    pair.
    """
    return effect.given | (set(effect.shape) - set(type(effect).shapes))


def all_given(effect: Effect) -> bool:
    """Return whether all shape constants of an effect have values, so that none is
    estimated.

    Needed are the constants that a search may vary, and the start t0 of a clock.
    """
    starts_of_clock = {
        key for key, shape in effect.shapes.items() if shape.role == "clock"
    }
    needed = starts_of_clock.union(effect.searched)
    return needed <= _given_constants(effect)


def estimate_constants(
    estimate: Estimate,
    new_effects: Sequence[Effect],
    measurements: Measurements,
    frozen: bool,
) -> list[Effect]:
    """Estimate the shape constants (such as a Stribeck velocity) of effects that lack
    values.

    An effect that acts on each joint by itself becomes one effect for each joint, since
    its constants may differ. Each is estimated beside those before it, and beside those
    whose constants are given.

    Parameters
    ----------
    estimate
        The model to which the effects are added.
    new_effects
        The effects, some of whose constants have no value yet.
    measurements
        The runs to estimate from.
    frozen
        True: the model's parameters stay fixed.

    Returns
    -------
    list of Effect
        The effects with all constants.
    """
    known = [e for e in new_effects if all_given(e) or not _has_starts(e)]
    if len(known) == len(new_effects):  # nothing to estimate, and filtering takes long
        return [*new_effects]
    settings = estimate.preprocessing.resolve(measurements)
    rows = diagnosis_rows(measurements, estimate, settings)
    search = Search(whiten_rows(rows, estimate, frozen), Library())
    # What has its constants comes first: without it, others would stand for it.
    beside = [
        _shaped(search, e, j) for e in known if _has_starts(e) for j in _places(e)
    ]
    found: dict[int, list[Effect]] = {}
    for effect in new_effects:
        if effect in known:
            continue
        for joint in _places(effect):
            shaped = _shaped(search.with_terms(beside), effect, joint)
            beside.append(shaped)
            found.setdefault(id(effect), []).append(shaped.form.effect)
    return [one for e in new_effects for one in found.get(id(e), [e])]


def _has_starts(effect: Effect) -> bool:
    """Return whether a search has a start for an effect's constants. Others keep theirs:
    identify fits a drive's law beside the torque."""
    return bool(list(effect.starts(effect.robot, min(effect.joints, default=0))))


def _places(effect: Effect) -> Sequence[int | None]:
    """Return the joints (from 0) on each of which an effect has constants of its own:
    the first one for joints that share them, None for the whole robot."""
    if effect.whole_robot:
        return [None]
    return effect.joints[:1] if effect.joins else effect.joints


def _shaped(search: Search, effect: Effect, joint: int | None) -> ScoredEffect:
    """Return an effect with those shape constants that have the highest evidence.

    All starting values of the effect's class are scored as additions to what a search has
    chosen. The best start of each discrete variant is refined.

    Parameters
    ----------
    search
        Scores candidates (an effect on a joint with constants) by evidence.
    effect
        The effect; constants that were given keep their values.
    joint
        The joint (from 0); None for an effect on the whole robot.
    """
    fixed = _given_constants(effect)
    start = min(float(s.motion.t[0]) for s in search.data.rows.segments)
    constants_given = {key: effect.shape[key] for key in fixed}
    forms = [
        Candidate((effect.name, joint), one)
        for one in effect.candidates(effect.robot, joint, start, **constants_given)
    ]
    scored = [search.evidence_of(search.fit, form) for form in forms]
    scored.sort(key=lambda t: t.evidence)
    # Sorted by evidence: the last one of each law is its best.
    best_by_law = {t.form.discrete_choice: t for t in scored}
    refined = [search.refined(search.fit, t, fixed) for t in best_by_law.values()]
    return max(refined, key=lambda t: t.evidence)


def joint_optimum_of_constants(
    extended: Estimate, added: Sequence[Effect], runs: FilteredRuns
) -> tuple[Model, list[ShapeEstimate]] | None:
    """Estimate the shape constants of added effects and of the model's own, all
    together.

    Only constants on the same joints influence each other. Parameters and constants are
    fitted by least squares, and each constant of the model is compared with its present
    value.

    Parameters
    ----------
    extended
        The model with the added effects.
    added
        The added effects; constants that were given are not estimated.

    Returns
    -------
    (Model, list of ShapeEstimate) or None
        The model at the joint optimum, and its own constants as `identify` records
        them. None where no own constant changes by more than three standard deviations:
        the model then stays as it is.
    """
    shapes = extended.report.shapes
    free_of_added = _free_constants_of(added)
    joints_of_added = {joint for _, joint, _ in free_of_added}
    own_constants = {s.key: s for s in shapes if s.index in joints_of_added}
    joints_of_both = {joint for _, joint, _ in own_constants}
    keys_to_estimate = {key for key in free_of_added if key[1] in joints_of_both}
    keys_to_estimate.update(own_constants)
    if not keys_to_estimate:
        return None
    best = fit_constants_jointly(
        extended.model,
        keys_to_estimate,
        lambda model: compress(runs, model),
        extended.weighting,
    )
    values = _constants_of(best.model)
    std = best.std  # of each constant's logarithm
    has_changed = [
        abs(np.log(values[key] / s.after)) > IMPLAUSIBLE_SIGMAS * std[key]
        for key, s in own_constants.items()
    ]
    if not any(has_changed):
        return None
    out = list[ShapeEstimate]()
    for s in shapes:
        if s.key in own_constants:
            s = replace(s, after=values[s.key], std=values[s.key] * std[s.key])
        out.append(s)
    return best.model, out


def _free_constants_of(effects: Sequence[Effect]) -> set[ConstantKey]:
    """Return the keys (effect, joint from 0, constant) of the constants that may be
    estimated.

    Left out are constants that were given. So are effects on several joints at once,
    and those that may come several times on a joint: the key would not identify their
    constants.
    """
    out = set[ConstantKey]()
    for effect in effects:
        if effect.whole_robot or effect.joins or effect.several:
            continue
        free = set(free_constants(effect)) - effect.given
        out |= {(effect.name, j, shape) for j in effect.joints for shape in free}
    return out


def _constants_of(model: Model) -> dict[ConstantKey, float]:
    """Return the values of all shape constants of a model, in SI units, by (effect
    name, joint from 0, constant).
    """
    return {
        (effect.name, joint, shape): value
        for effect in model.effects
        for shape, value in effect.shape.items()
        for joint in effect.joints
    }
