"""The verb ``add``, with a verdict on the extended model."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path

from sdp_vs_penalty.arguments import checked_arguments
from sdp_vs_penalty.data.files import Source, as_measurements, training_runs
from sdp_vs_penalty.data.recorded import words_of_source
from sdp_vs_penalty.diagnosis.adding import add as add_effects
from sdp_vs_penalty.diagnosis.comparison import compare
from sdp_vs_penalty.diagnosis.finding import Finding, Retune
from sdp_vs_penalty.diagnosis.findings import Diagnosis
from sdp_vs_penalty.diagnosis.passing.cause import beside_spans
from sdp_vs_penalty.estimation.estimate import Estimate, as_estimate
from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.threads import on_one_thread


@on_one_thread
@checked_arguments
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
        The runs to identify it from, and judge it on; with a diagnosis without the spans
        in which it says that something acts for a part of the time.
    frozen : bool
        Keep all other parameters. The same happens with the findings of a frozen
        diagnosis, and wherever the model has a payload or gets one: refitted links
        would absorb it. Findings about a frozen model's own effects are left out;
        identify it again for these.
    seed : int
        Seed of the method's random choices.
    progress : callable
        Hears where the computation stands, a short text each time.

    Returns
    -------
    Estimate
        The extended model, with a certificate of its own, and a verdict on these
        measurements; `compare` judges it on others.

    Raises
    ------
    InputError
        For an effect that the model has already, without a new constant for it, or for
        one that cannot act.
    """
    model = as_estimate(estimate, "add(estimate=...)")
    source = training_runs(measurements)
    runs = as_measurements(
        source, names=model.problem.channel_names, what="add(measurements=...)"
    )
    extended = add_effects(
        model, effects, runs, frozen=frozen, seed=seed, progress=progress
    )
    remark = extended.constants_at_ends
    if remark and remark != model.constants_at_ends:
        warnings.warn(remark, stacklevel=3)
    if isinstance(effects, Diagnosis):
        runs = beside_spans(runs, effects.left_out)
    progress("comparing measured with modelled")
    judged = compare(extended, runs)[0]
    words = words_of_source(source)
    extended.provenance.update(
        verdict=judged.verdict.to_dict(), data=words, judged_data=words
    )
    return extended
