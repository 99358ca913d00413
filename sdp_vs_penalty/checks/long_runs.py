"""A run too long to be judged at once: windows of it are judged, and it has one report."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.checks.issue import Issue, gravest_first
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.store import PART
from sdp_vs_penalty.race.constants import PARTS


def is_long(run: Measurements) -> bool:
    """Whether a run is so long that only windows of it are judged."""
    return run.samples > PARTS * PART


def windows_of(run: Measurements) -> list[Measurements]:
    """List the run itself, or four windows of PART samples spread evenly over a long
    run.

    A window's rows count from its first sample, which its name says.

    Returns
    -------
    list of Measurements
        The windows, or the run.
    """
    if not is_long(run):
        return [run]
    starts = np.linspace(0, run.samples - PART, PARTS // 2).astype(int).tolist()
    name = run.names[0]
    return [
        run.rows(slice(k, k + PART), f"{name} from sample {k + 1} on") for k in starts
    ]


def issues_of_run(windows: Sequence[tuple[str, Sequence[Issue]]]) -> list[Issue]:
    """List the issues of a run from the names and issues of its windows.

    An issue of several windows is listed once, in the words of the first of them where
    it is gravest, and offers no repair.

    Returns
    -------
    list of Issue
        Each kind and place once.
    """
    issues_by_kind: dict[tuple[str, str], list[tuple[Issue, str]]] = {}
    for name, issues in windows:
        for issue in issues:
            places = issues_by_kind.setdefault((issue.kind, issue.where), [])
            places.append((issue, name))
    return [_in_windows(places, len(windows)) for places in issues_by_kind.values()]


def _in_windows(places: Sequence[tuple[Issue, str]], n_windows: int) -> Issue:
    """Return one issue from its copies in several windows, each with the window's name:
    the gravest copy, with the number of windows that show it in front."""
    gravest, *_ = gravest_first([issue for issue, _ in places])
    issue, window = next(place for place in places if place[0] is gravest)
    which = f"Seen in {len(places)} of {n_windows} stretches; in {window}: "
    return replace(issue, what=which + issue.what, repair=None)
