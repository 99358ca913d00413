"""What the command line prints: tables and summaries on stdout, progress on stderr."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich import box
from rich.console import Console
from rich.markup import escape
from rich.table import Table

if TYPE_CHECKING:
    from sdp_vs_penalty.diagnosis.comparison import Comparison
    from sdp_vs_penalty.estimation.estimate import Estimate

out = Console(highlight=False)
err = Console(stderr=True, highlight=False)


@contextmanager
def progress(start: str) -> Iterator[Callable[[str], None]]:
    """A line on stderr that says where a long computation stands; silent where nobody watches."""
    if not err.is_terminal:
        yield lambda _: None
        return
    with err.status(escape(start)) as status:
        yield lambda text: status.update(escape(text))


def titled_table(title: str) -> Table:
    """An empty table below its title, which is printed now: rich breaks it at the table's width."""
    out.print(f"[italic]{escape(title)}[/italic]", soft_wrap=True)
    return Table(box=box.SIMPLE_HEAD, show_edge=False)


def listing(title: str, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """A table whose first column is never wrapped: it holds the names to type."""
    table = titled_table(title)
    for k, heading in enumerate(headings):
        table.add_column(heading, no_wrap=k == 0, overflow="fold")
    for row in rows:
        table.add_row(*(escape(cell) for cell in row))
    out.print(table)


def details(headings: Sequence[str], row: Sequence[str]) -> None:
    """Everything about one thing that can be chosen, a line each."""
    grid = Table.grid(padding=(0, 2))
    grid.add_column(no_wrap=True)
    for heading, cell in zip(headings, row, strict=True):
        if cell:
            grid.add_row(heading, escape(cell))
    out.print(grid)


def estimate_summary(estimate: Estimate, fit: Comparison | None, seconds: float) -> None:
    """What was identified, how good it is, and what the certificate says of it.

    fit : against the measurements that it came from; None for a black box's answers.
    """
    samples, runs = estimate.provenance["samples"], len(estimate.provenance["runs"])
    out.print(
        f"[bold]{escape(estimate.problem.name)}[/bold] by [bold]{estimate.method}[/bold] from {samples} "
        f"samples in {runs} run(s), {len(estimate.theta)} parameters, {seconds:.1f} s"
    )
    certificate(estimate)
    if fit is not None:
        comparison_tables([fit], estimate.robot.torque_units, title="Fit to these measurements")


def certificate(estimate: Estimate) -> None:
    """What the certificate says, a line each, and which bounds the estimate lies on."""
    lines = estimate.certificate.summary()
    bounds = estimate.details.get("on_bounds") or []
    if bounds:
        lines.append(("on their bounds", ", ".join(bounds) + ": widen them, or measure more"))
    grid = Table.grid(padding=(0, 2))
    for name, text in lines:
        grid.add_row(name, escape(text))
    out.print(grid)


def comparison_tables(
    results: Sequence[Comparison], units: Sequence[str], title: str = "Measured against modelled"
) -> None:
    """One row a joint: RMSE beside the noise floor; R^2 of a single model; the totals below.

    Several models are columns [1], [2], ... so that figures stay readable in a narrow terminal.
    """
    band, several = results[0].band_hz, len(results) > 1
    table = titled_table(f"{title}, below {band:.3g} Hz")
    table.add_column("joint", justify="right")
    table.add_column("unit")
    for k in range(len(results)):
        table.add_column(rf"RMSE \[{k + 1}]" if several else "RMSE", justify="right", no_wrap=True)
    if not several:
        table.add_column("R2", justify="right")
    floor = results[0].noise_floor
    table.add_column("noise floor", justify="right")
    for j, unit in enumerate(units):
        cells = [str(j + 1), unit, *(f"{result.rmse[j]:.4g}" for result in results)]
        if not several:
            cells.append(f"{results[0].r2[j]:.4f}")
        cells.append("-" if floor is None else f"{floor[j]:.4g}")
        table.add_row(*cells)
    out.print(table)
    for k, result in enumerate(results):
        which = rf"\[{k + 1}] {escape(result.name)}: " if several else ""
        out.print(f"{which}relative error {result.relative_error_percent:.3f} %")
    if floor is None:
        out.print("No motion repeats in these runs: the noise floor is unknown.")
