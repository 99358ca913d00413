"""What `diagnose`, `add` and `challenge` print."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from rich import box
from rich.markup import escape
from rich.table import Table

from sdp_vs_penalty.cli.console import out
from sdp_vs_penalty.diagnosis.findings import EFFECT_MISSING, NOTHING_MISSING, Diagnosis, Finding
from sdp_vs_penalty.diagnosis.where_it_fails import BANDS, JointFailure

Array = NDArray[np.float64]

_VERDICTS = {
    EFFECT_MISSING: "[bold]An effect is missing[/bold], and the library explains what can be seen.",
    NOTHING_MISSING: "[bold]Nothing is missing[/bold] that these measurements could show.",
}
_UNKNOWN = (
    "[bold]Something unknown is missing[/bold]: repeatable error remains that no effect of the library "
    "explains."
)


def diagnosis(result: Diagnosis, units: Sequence[str], add: Callable[[Sequence[Finding]], str]) -> None:
    """The verdict, the ladder of effects with the falling error, and what can never be seen.

    add : from the first few findings to the command that adds them.
    """
    out.print(_VERDICTS.get(result.verdict, _UNKNOWN))
    if result.effects:
        kinds = ", ".join(dict.fromkeys(units))
        band = f"{result.band_hz:.3g} Hz \\[{kinds}]"
        how = "fitted anew at each step, without constraints"
        out.print(f"[italic]Held-out RMSE of each joint below {band}, {how}")
        shown = _worth_showing(result.effects)
        out.print(_ladder(result, shown, len(units)))
        said: set[str] = set()
        for k, finding in enumerate(shown, start=1):
            head, _, physics = finding.explanation.partition(". ")
            rest = "" if finding.effect in said else f". {physics}"
            if rest == "" and finding.indistinguishable_from:
                rest = f". Not told from {', '.join(finding.indistinguishable_from)}."
            said.add(finding.effect)
            out.print(f"{k}. {head}{rest}", markup=False)
        if len(shown) < len(result.effects):
            rest = ", ".join(f.text.partition("@")[0] for f in result.effects[len(shown) :])
            out.print(f"and, every one of them weak: {rest}", markup=False)
        out.print(f"to add them: {add(shown)}", markup=False, soft_wrap=True)
        if any(f.confidence == "weak" for f in result.effects):
            out.print(
                "weak: something else explains it about as well, its size is uncertain by more than a "
                "fifth, the gain is small, or the error does not fall on data left out.",
                markup=False,
            )
    share = ", ".join(f"{100 * max(x, 0.0):.0f} %" for x in result.unexplained)
    out.print(f"unexplained variance over the noise's, joint by joint: {share}", markup=False)
    for event in result.events:
        out.print(
            f"event on joint {event.joint + 1}: {event.t_start:.2f} s to {event.t_end:.2f} s"
            + ("" if event.frequency is None else f", a hum of {event.frequency:.3g} Hz"),
            markup=False,
        )
    if result.invisible:
        hidden: dict[str, list[str]] = {}
        for i in result.invisible:
            hidden.setdefault(i.effect, []).append("+".join(map(str, i.joints)))
        names = ", ".join(f"{k}:{'+'.join(v)}" if v[0] else k for k, v in hidden.items())
        out.print(f"invisible here, absorbed by the model's own parameters: {names}", markup=False)
    for remark in result.remarks:
        out.print(remark, markup=False)


def _worth_showing(effects: Sequence[Finding]) -> Sequence[Finding]:
    """The ladder without the weak findings at its end, but for the first two of them."""
    last = max((k for k, f in enumerate(effects) if f.confidence == "confident"), default=-1)
    return effects[: last + 3]


def _ladder(result: Diagnosis, shown: Sequence[Finding], joints: int) -> Table:
    """One row a step, numbered like the sentences below it: narrow enough for seven joints."""
    table = _plain_table(["with", *(str(j + 1) for j in range(joints)), ""])
    table.add_row("the model", *_cells(result.effects[0].held_out_rmse_before), "")
    for k, f in enumerate(shown, start=1):
        table.add_row(f"+ {k}.", *_cells(f.held_out_rmse_after), f.confidence)
    known = result.noise_source == "repetition"
    table.add_row("noise" if known else "noise?", *_cells(result.noise_floor), "")
    return table


def _cells(values: Array) -> list[str]:
    return [f"{v:.4f}" for v in values]


def before_after(
    before: Array, after: Array, floor: Array | None, units: Sequence[str], what: str
) -> None:
    """RMSE of each joint before and after an effect was added."""
    table = Table(title=f"RMSE on {what}", title_justify="left", box=box.SIMPLE_HEAD, show_edge=False)
    known = [] if floor is None else ["noise floor"]
    for heading in ("joint", "before", "after", "change", *known):
        table.add_column(heading, justify="right")
    for j, unit in enumerate(units):
        change = 100.0 * (after[j] / before[j] - 1.0) if before[j] > 0.0 else 0.0
        table.add_row(
            f"{j + 1} [{escape(unit)}]",
            f"{before[j]:.4f}",
            f"{after[j]:.4f}",
            f"{change:+.1f} %",
            *([] if floor is None else [f"{floor[j]:.4f}"]),
        )
    out.print(table)
    if floor is None:
        out.print("No motion repeats there: the noise floor is unknown.", markup=False)


def where_it_fails(failures: Sequence[JointFailure], units: Sequence[str], model: str) -> None:
    """The section "where the model fails" of compare: what the residual depends on."""
    names = list(failures[0].shares)
    joints = ["", *(str(f.joint) for f in failures)]
    what = "held-out share of the residual's variance explained by ... \\[%]"
    out.print(f"[italic]Where {escape(model)} fails: {what}")
    table = _plain_table(joints)
    for name in names:
        table.add_row(name, *(f"{100 * f.shares[name]:.0f}" for f in failures))
    out.print(table)
    out.print("[italic]and what it looks like")
    table = _plain_table(joints)
    table.add_row("RMSE", *(f"{f.rmse:.3g}" for f in failures))
    table.add_row(
        "noise, no drift", *("-" if f.noise_floor is None else f"{f.noise_floor:.2g}" for f in failures)
    )
    table.add_row(
        "explainable [%]",
        *("-" if f.explainable is None else f"{100 * f.explainable:.0f}" for f in failures),
    )
    table.add_row("lift at reversals", *(_short(f.reversal_lift) for f in failures))
    table.add_row("after - before", *(_short(f.reversal_asymmetry) for f in failures))
    for k, (low, high) in enumerate(pairwise(BANDS)):
        if any(f.bands[k] > 0.0 for f in failures):
            label = f"{low:g}-{high:g} Hz [%]" if np.isfinite(high) else f"above {low:g} Hz [%]"
            table.add_row(label, *(f"{100 * f.bands[k]:.0f}" for f in failures))
    for f in failures:
        table.add_row(f"correlation {f.joint}", *(f"{c:+.2f}" for c in f.correlation))
    out.print(table)
    for f in failures:
        if f.orders:
            words = ", ".join(f"{k} ({a:.2g} {units[f.joint - 1]}, {r:.0f}x)" for k, a, r in f.orders)
            out.print(f"joint {f.joint}, waves per revolution at the full rate: {words}", markup=False)


def _short(x: float) -> str:
    return f"{x:.2f}" if np.isfinite(x) else "-"


def _plain_table(headings: Sequence[str]) -> Table:
    table = Table(box=box.SIMPLE_HEAD, show_edge=False, padding=(0, 1, 0, 0))
    for k, heading in enumerate(headings):
        table.add_column(heading, justify="left" if k == 0 else "right", no_wrap=True)
    return table
