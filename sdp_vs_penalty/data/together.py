"""Runs that are given together, read by what the arm tells of any of them: one recorder has
one unit, one order of columns, one kind of register."""

import warnings
from collections.abc import Callable, Sequence

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.recorder import Recorder
from sdp_vs_penalty.errors import InputError, Remark

#: Reads the run at a place, from 0, by what is known of recorders.
ReadRun = Callable[[int, Sequence[Recorder]], Measurements]


def read_by_recorder(
    read: ReadRun, n_runs: int, known: Sequence[Recorder] = ()
) -> list[Measurements | InputError]:
    """Read runs, and those once more of which the arm tells less than of another one with
    the same columns: the strongest evidence decides for the whole recorder.

    A run whose values contradict it stays as it is, and a remark names it. An error stands
    for a run that cannot be read. ``known`` is what runs that were read before have told.
    """
    outcomes = [_attempt(read, place, known) for place in range(n_runs)]
    runs = [run for run, _ in outcomes if not isinstance(run, InputError)]
    facts = _agreed([*known, *(x for run in runs for x in run.recorders)])
    for place, (run, _) in enumerate(outcomes):
        if isinstance(run, InputError):
            is_open = bool({*facts} - {*known})
        else:
            is_open = any(_lacks(x, facts) for x in run.recorders)
        if is_open:
            outcomes[place] = _attempt(read, place, facts)
    for run, remarks in outcomes:
        for remark in remarks:
            warnings.warn(remark, stacklevel=3)
        if not isinstance(run, InputError):
            _name_contradiction(run, facts)
    return [run for run, _ in outcomes]


def require_runs(outcomes: Sequence[Measurements | InputError]) -> list[Measurements]:
    """Return runs that were read; raise the first error among them."""
    runs = list[Measurements]()
    for outcome in outcomes:
        if isinstance(outcome, InputError):
            raise outcome
        runs.append(outcome)
    return runs


def _attempt(
    read: ReadRun, place: int, recorders: Sequence[Recorder]
) -> tuple[Measurements | InputError, list[Warning]]:
    """Read a run; return it, or its error, with the remarks that the reader made."""
    with warnings.catch_warnings(record=True) as remarks:
        warnings.simplefilter("always")
        try:
            run: Measurements | InputError = read(place, recorders)
        except InputError as error:
            run = error
    return run, [x.message for x in remarks if isinstance(x.message, Warning)]


def _agreed(recorders: Sequence[Recorder]) -> list[Recorder]:
    """Return what the logs of each recorder tell together, without facts in which they
    contradict each other."""
    logs_by_columns = dict[tuple[str, ...], list[Recorder]]()
    for recorder in recorders:
        if recorder.is_told:
            logs_by_columns.setdefault(recorder.columns, []).append(recorder)
    together = list[Recorder]()
    for columns, logs in logs_by_columns.items():
        units = {x.unit for x in logs if x.unit}
        orders = {x.order for x in logs if x.order}
        together.append(
            Recorder(
                columns,
                units.pop() if len(units) == 1 else "",
                orders.pop() if len(orders) == 1 else (),
                any(x.has_sign_bit for x in logs),
                logs[0].run,
            )
        )
    return together


def _lacks(recorder: Recorder, facts: Sequence[Recorder]) -> bool:
    """Return whether more is known of a log's recorder than the log has told."""
    return any(
        x.columns == recorder.columns
        and (
            (x.unit and not recorder.unit)
            or (x.order and not recorder.order)
            or (x.has_sign_bit and not recorder.has_sign_bit)
        )
        for x in facts
    )


def _name_contradiction(run: Measurements, facts: Sequence[Recorder]) -> None:
    """Remark on a run that contradicts what other logs of its recorder have told."""
    for recorder in run.recorders:
        for fact in facts:
            clause = fact.contradiction(recorder)
            if fact.columns == recorder.columns and clause:
                what = f"{run.names[0]}: {clause}: the same columns, other values"
                warnings.warn(Remark(what), stacklevel=4)
