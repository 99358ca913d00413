"""The verb ``export``: a model in another format, judged as that format holds it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from sdp_vs_penalty import formatting
from sdp_vs_penalty.arguments import checked_arguments
from sdp_vs_penalty.data.files import Source, as_measurements
from sdp_vs_penalty.diagnosis.adding import identify_with
from sdp_vs_penalty.diagnosis.comparison import Comparison, compare, compare_filtered
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.diagnosis.open_findings import describe_loss, verdict_on_file
from sdp_vs_penalty.effects import parse_effects
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.estimate import Estimate, as_estimate
from sdp_vs_penalty.estimation.outcome import OfferOutcome
from sdp_vs_penalty.estimation.verdict import Verdict
from sdp_vs_penalty.exporters import export as exporting
from sdp_vs_penalty.signals.filtered import FilteredRuns


@checked_arguments
def export(
    estimate: Estimate | str | Path,
    out: str | Path,
    urdf: str | Path | None = None,
    *,
    mjcf: str | Path | None = None,
    force: bool = False,
    flange: tuple[float, float, float] = (0.0, 0.0, 0.0),
    measurements: Source = None,
    test: Source = None,
    refit: bool = False,
) -> tuple[str, ...]:
    """Write a model in the format that the file's name chooses.

    Parameters
    ----------
    estimate : Estimate, str or Path
        The model, or its model.json.
    out : str or Path
        The file to write; `sdp-vs-penalty list exports` names all formats.
    urdf : str or Path, optional
        The user's own URDF file, whose inertials, damping and friction are replaced and
        whose every other byte is kept; for ``out`` with the suffix .urdf only.
    mjcf : str or Path, optional
        The user's own MJCF file, whose inertials, armature, damping, dry friction and
        springs are replaced; actuators, meshes and every other byte are kept. For
        ``out`` with the suffix .xml only.
    force : bool
        Export a link whose mass lies farther out than its body reaches all the same.
    flange : tuple of float
        Where the flange lies in the frame of the last link's parameters [m], for a
        payload: the link of a URDF; behind the last joint of a DH table.
    measurements : path, arrays, DataFrame, Measurements, list of these, optional
        Runs on which a file is judged that cannot hold all effects: a copy of the model
        without them is compared with these runs, and that verdict stands in the file.
    test : path, arrays, DataFrame, Measurements, list of these, optional
        Runs that judge in place of ``measurements``.
    refit : bool
        For such a file, identify the model again from ``measurements`` without those
        effects, and write that model where it errs less on the runs that judge.

    Returns
    -------
    tuple of str
        The effects that the format has no place for; the .json holds them.

    Raises
    ------
    InputError
        For another suffix, an inconsistent or implausible inertial, or a file of another
        robot.
    """
    model = as_estimate(estimate, "export(estimate=...)")
    verdict = None
    lost: tuple[str, ...] = ()
    if refit and measurements is None:
        remedy = "name the runs to identify from: export(measurements=...)"
        raise InputError("export(refit=True)", remedy)
    if measurements is not None or test is not None:
        judging = _filtered(model, measurements if test is None else test)
        training = _filtered(model, measurements) if refit else None
        (whole,) = compare(model, judging)
        held = judge_as_exported(model, out, judging, whole, training=training)
        if held is not None:
            verdict = held.verdict
            if held.is_refitted:
                model, lost = held.model, held.lost
    return exporting.write_model(
        model,
        out,
        urdf,
        mjcf=mjcf,
        force=force,
        flange=flange,
        judged=verdict,
        identified_without=lost,
    )


def _filtered(model: Estimate, source: Source) -> FilteredRuns:
    """Read runs, and filter them as the model's were."""
    runs = as_measurements(source, names=model.problem.channel_names)
    return FilteredRuns.filtering(runs, model.preprocessing.resolve(runs))


@dataclass(frozen=True)
class AsExported:
    """What a file of `export` holds of a model that it cannot hold all of, judged."""

    #: Effects that the file has no place for.
    lost: tuple[str, ...]
    #: The model without them, or identified again.
    model: Estimate
    #: Its errors on the runs.
    comparison: Comparison
    #: How they differ from those of the whole model.
    outcome: OfferOutcome
    #: The verdict on it.
    verdict: Verdict
    #: Whether it was identified again.
    is_refitted: bool = False
    #: The nearest laws that the file holds, in place of what it has no place for.
    laws_in_place: tuple[Effect, ...] = ()


def judge_as_exported(
    model: Estimate,
    out: str | Path,
    runs: FilteredRuns,
    whole: Comparison,
    findings: Diagnosis | None = None,
    training: FilteredRuns | None = None,
) -> AsExported | None:
    """Judge a model without the effects that a file of this name cannot hold.

    Parameters
    ----------
    runs : FilteredRuns
        The runs that judge.
    whole : Comparison
        All of the model on these runs, which names the noise.
    findings : Diagnosis, optional
        What a diagnosis of the model, or of one that it grew from, found.
    training : FilteredRuns, optional
        Runs from which it is identified again, where it errs less then.

    Returns
    -------
    AsExported or None
        None for files that hold all of the model, or no model of the torque.
    """
    lost = exporting.effects_left_out(model, out)
    held = exporting.as_exported(model, out)
    if held is None or not lost:
        return None
    name = Path(out).name
    (compared,) = compare_filtered({name: held}, runs, noise=whole.noise)
    judged = _judged_beside(whole, compared, lost, findings)
    if training is None:
        return judged
    return refit_as_exported(judged, (), training, runs, whole, findings)


def refit_as_exported(
    held: AsExported,
    laws: Sequence[Effect],
    training: FilteredRuns,
    judged: FilteredRuns,
    whole: Comparison,
    findings: Diagnosis | None = None,
) -> AsExported:
    """Identify a model again without what a file cannot hold.

    Parameters
    ----------
    held : AsExported
        The model without what the file cannot hold.
    laws : sequence of Effect
        What it holds in place of that (:func:`laws_in_place`).
    training, judged : FilteredRuns
        The runs that the model is identified from, and those that it is judged on.
    whole : Comparison
        All of the model on the runs that it is judged on.
    findings : Diagnosis, optional
        What a diagnosis of the model, or of one that it grew from, found.

    Returns
    -------
    AsExported
        The model that was identified again where it errs less, else ``held``.
    """
    again = identify_with(held.model, (*held.model.model.effects, *laws), training)
    name = held.comparison.name
    (compared,) = compare_filtered({name: again}, judged, noise=whole.noise)
    if not compared.errors.size < held.comparison.errors.size:
        return held
    judged_again = _judged_beside(whole, compared, held.lost, findings)
    provenance = {**again.provenance, "verdict": judged_again.verdict.to_dict()}
    again = replace(again, provenance=provenance)
    return replace(
        judged_again, model=again, is_refitted=True, laws_in_place=tuple(laws)
    )


def _judged_beside(
    whole: Comparison,
    compared: Comparison,
    lost: tuple[str, ...],
    findings: Diagnosis | None,
) -> AsExported:
    """Judge what a file holds of a model, beside the whole model on the same runs."""
    units = [formatting.plain_unit(unit) for unit in whole.estimate.torque_units]
    outcome = OfferOutcome(whole.rmse, compared.rmse, whole.noise_floor, units)
    loss = describe_loss(outcome)
    verdict = verdict_on_file(compared.verdict, loss, findings, whole.estimate)
    return AsExported(lost, compared.estimate, compared, outcome, verdict)


def laws_in_place(
    model: Estimate, held: AsExported, out: str | Path, findings: Diagnosis | None
) -> tuple[Effect, ...]:
    """Return the nearest law that a file of this name holds in place of each finding of a
    model that it has no place for, where one is known and the model does not have it."""
    lost = [x for x in model.model.effects if x not in held.model.model.effects]
    present = {(e.name, j) for e in held.model.model.effects for j in e.joints}
    laws = []
    for finding in () if findings is None else findings.effects:
        is_lost = any(
            x.name == finding.effect and {*finding.joints} <= {*x.joints} for x in lost
        )
        if not (is_lost and finding.held_law):
            continue
        (law,) = parse_effects(finding.held_law, held.model.robot)
        joints = {(law.name, joint) for joint in law.joints}
        if joints.isdisjoint(present) and exporting.has_place(law, held.model, out):
            laws.append(law)
            present |= joints
    return tuple(laws)
