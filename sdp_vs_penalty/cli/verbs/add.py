from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from sdp_vs_penalty.cli import console
from sdp_vs_penalty.errors import InputError

if TYPE_CHECKING:
    from sdp_vs_penalty.diagnosis.comparison import Comparison
    from sdp_vs_penalty.diagnosis.findings import Diagnosis
    from sdp_vs_penalty.effects.effect import Effect
    from sdp_vs_penalty.estimation.estimate import Estimate


def verb(
    model: Path,
    data: list[Path],
    out: Path,
    effect: str | None = None,
    from_: Path | None = None,
    helpful: bool = False,
    confident: bool = False,
    only: str | None = None,
    test: Path | None = None,
    frozen: bool = False,
    gravity: str | None = None,
    window: str | None = None,
    test_window: str | None = None,
    seed: int = 0,
    gain_uncertainty: float | None = None,
    as_written: bool = False,
) -> None:
    """Add effects to a model and identify it again, under all constraints.

    The effects are named, or come from a diagnosis: --from findings.json.
    Example: sdp-vs-penalty add model.json joint_spring:4 --data run.csv --out model2.json

    --out model2.json: File to write the model to.
    effect EFFECT[:joints][@shape=value]: Effects, separated by commas.
    --from findings.json: Effects found by `diagnose --json`.
    --helpful: Findings that help on data left out, also where name or size is in doubt.
    --confident: Of these the ones whose name is confident.
    --only 1,3: Numbers of the findings to add; nothing else is added.
    """
    from sdp_vs_penalty.checks.gate import consented
    from sdp_vs_penalty.cli import printing
    from sdp_vs_penalty.cli.next_step import free_name
    from sdp_vs_penalty.cli.runs import (
        NamedRuns,
        model_from_options,
        named_test,
        runs_for,
    )
    from sdp_vs_penalty.data.files import training_runs
    from sdp_vs_penalty.diagnosis.adding import add as run
    from sdp_vs_penalty.diagnosis.comparison import compare
    from sdp_vs_penalty.diagnosis.passing.cause import beside_spans

    effects = _effects(effect, from_, helpful, confident, only)
    diagnosis = None if isinstance(effects, str) else effects
    named = NamedRuns(training_runs(data), window, as_written)
    tested = named_test(test, test_window, as_written=as_written)
    estimate = model_from_options(model, gravity, gain_uncertainty)
    with console.progress("reading the measurements") as progress:
        runs = runs_for(estimate, named, tested)
        bigger = run(
            estimate, effects, runs.train, frozen=frozen, seed=seed, progress=progress
        )
        models = {"before": estimate, "after": bigger}
        train, judged = runs.train, runs.judge
        acting: Sequence[str] = ()
        if diagnosis is not None:
            train = beside_spans(train, diagnosis.left_out)
            if train is not runs.train:
                acting = diagnosis.acting_for_a_time
            spans = diagnosis.left_out if test is None else diagnosis.left_out_of_test
            judged = beside_spans(judged, spans)
        before, after = compare(models, judged, noise_from=runs.judged_recordings)
        what = "the training data" if test is None else str(test)
        if diagnosis is not None:
            if test is not None:
                on_training = compare(models, train)
                _refuse_harm(on_training[0], on_training[1], "the training data")
            _refuse_harm(before, after, what)
        bigger.provenance.update(
            {
                "data": named.words,
                "checked": not consented(estimate, runs.train),
                "verdict": after.verdict.to_dict(),
                "judged_data": (tested or named).words,
            }
        )
        bigger.save(out)
    printing.before_after(before, after, estimate.torque_units, what)
    _say_changes(diagnosis, estimate, bigger, acting, helpful)
    printing.certificate(bigger)
    console.written(out)
    mounting = [] if gravity is None else ["--gravity", gravity]
    options = [*(tested or named).words, *mounting, "--out", free_name("report.html")]
    console.next_step(["report", model, out, "--data", *options])


def _refuse_harm(before: "Comparison", after: "Comparison", what: str) -> None:
    """Raise InputError if findings make a joint's error much larger than they make any
    other's smaller.

    Errors are RMS on some runs (``what``, in words), where the joint slides; one that
    noise explains does not count.
    """
    import numpy as np

    from sdp_vs_penalty import formatting
    from sdp_vs_penalty.diagnosis.constants import MAX_JOINT_HARM

    errors = after.errors_sliding
    ratios = np.nan_to_num(errors.rmse / before.errors_sliding.rmse, nan=1.0)
    rises = np.where(errors.exceeds_noise, ratios, 1.0)
    joint = int(rises.argmax())
    harm = float(rises[joint])
    # The largest benefit is 1 / ratios.min().
    if harm > 1.0 + MAX_JOINT_HARM and harm * ratios.min() > 1.0:
        raise InputError(
            f"not added: with these findings joint {joint + 1} errs by"
            f" {formatting.percent(harm - 1.0, 2)} more on {what} while it slides",
            "choose findings with --only, or name an effect yourself",
        )


def _say_changes(
    diagnosis: "Diagnosis | None",
    estimate: "Estimate",
    bigger: "Estimate",
    acting: Sequence[str],
    helpful: bool,
) -> None:
    """Print what the bigger of two models has that the other has not.

    - ``diagnosis``: whose findings were added; None where effects were named.
    - ``acting``: what acts for a time, in words, where its spans were left out.
    - ``helpful``: whether only findings were added whose torque is certain.
    """
    from sdp_vs_penalty.effects import effect_in_words
    from sdp_vs_penalty.estimation.shapes import changed_constants_in_words
    from sdp_vs_penalty.render.diagnosis_words import weak_companions

    added = bigger.model.effects[len(estimate.model.effects) :]
    if added:
        named = "; ".join(effect_in_words(e.brief) for e in added)
        console.paragraph(f"added: {named}")
    if acting:
        passes = "; ".join(acting)
        console.paragraph(f"identified without the spans of what passes: {passes}")
    if diagnosis is not None and helpful:
        lines = weak_companions(diagnosis)
        for line in lines:
            reason = "added, since the error on data left out falls with it"
            console.paragraph(f"{reason}: {line}")
        if lines:
            console.paragraph(
                "To leave such findings out, name the others with --only."
            )
    if diagnosis is not None and diagnosis.frozen:
        _say_what_a_held_model_keeps(diagnosis, added)
    for line in changed_constants_in_words(estimate.model, bigger.model):
        console.say(f"re-estimated constant: {line}")
    _say_sizes(diagnosis, bigger, added)


def _say_what_a_held_model_keeps(
    diagnosis: "Diagnosis", added: "Sequence[Effect]"
) -> None:
    """Print findings that were not added, because the fixed model has their effect
    already.
    """
    from sdp_vs_penalty.effects import effect_in_words

    there = {
        (e.name, () if e.whole_robot else tuple(j + 1 for j in e.joints)) for e in added
    }
    for finding in diagnosis.beside_curves:
        if (finding.effect, finding.joints) not in there:
            why = "the held model has it: identify it again on runs like these"
            console.say(f"not added: {effect_in_words(finding.text)} ({why})")


def _say_sizes(
    diagnosis: "Diagnosis | None", model: "Estimate", added: "Sequence[Effect]"
) -> None:
    """Print what was added, each number with its interval: the sizes of findings, the
    parameters of effects that were named, mass and place of a payload.

    A finding that a measured curve replaces is not in the model.
    """
    from sdp_vs_penalty.diagnosis.sizes_in_model import size_in_model
    from sdp_vs_penalty.effects import effect_types
    from sdp_vs_penalty.estimation.carried import doubts_of_payload, payload_in_words

    for finding in () if diagnosis is None else diagnosis.beside_curves:
        if effect_types()[finding.effect].simulator_field != "payload":
            size = size_in_model(finding, model).size_text
            console.say(f"{finding.title}: {size}")
    for effect, indices in model.model.parts:
        if effect in added and effect.simulator_field == "payload":
            console.paragraph(payload_in_words(model))
            for doubt in doubts_of_payload(model):
                console.warn(doubt)
        elif effect in added and diagnosis is None:
            for k in indices:
                name = model.model.parameters[k].name
                console.say(f"{name}: {model.value_text(k)}")


def _effects(
    effect: str | None,
    findings: Path | None,
    helpful: bool,
    confident: bool,
    only: str | None,
) -> "str | Diagnosis":
    """Return what to add: the text of EFFECT, or the selected findings of a diagnosis.

    Raises InputError unless exactly one of both is given.
    """
    from sdp_vs_penalty.data.parsing import numbers
    from sdp_vs_penalty.diagnosis.findings import load_diagnosis

    if (effect is None) == (findings is None):
        raise InputError("Nothing to add", "name either EFFECT or --from findings.json")
    if findings is None:
        if helpful or confident or only is not None:
            raise InputError(
                "--helpful, --confident and --only select findings of a file",
                "name it with --from",
            )
        return effect or ""
    if helpful + confident + (only is not None) > 1:
        raise InputError(
            "--helpful, --confident and --only exclude each other",
            "leave all but one out",
        )
    diagnosis = load_diagnosis(findings)
    numbers_wanted = None if only is None else numbers("--only", only)
    try:
        chosen = diagnosis.selected(numbers_wanted, helpful, confident)
    except InputError as error:
        raise error.within(findings) from error
    for constant in () if only is None else diagnosis.retuned:
        why = "it has no number; to add it, name it as an effect"
        console.paragraph(f"not added: {constant.text} ({why})")
    return chosen
