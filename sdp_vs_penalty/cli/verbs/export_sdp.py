from pathlib import Path

from sdp_vs_penalty.cli import console


def verb(
    problem: str,
    data: list[Path],
    out: Path,
    method: str | None = None,
    effects: str | None = None,
    gravity: str | None = None,
    filters: str | None = None,
    bounds: str | None = None,
    hold: str | None = None,
    window: str | None = None,
    known_load: list[str] | None = None,
    known: str | None = None,
    instruments: str | None = None,
) -> None:
    """Write the SDP that `identify` solves as a file for another solver, and FILE.json beside it.

    The JSON holds offset and scale, with which the file's optimum becomes the objective, the proved
    interval of that, and centre and theta_scale, with which the file's variables become the parameters.
    Example: sdp-vs-penalty export-sdp panda --data run1.csv --out panda.cbf

    --out FILE: File to write: .dat-s (sparse SDPA) or .cbf.
    --method: Method: lmi-sdp or lmi-sdp-thickness, -plain, -entropic; default: lmi-sdp, or
        lmi-sdp-thickness for .dat-s, which has no exponential cones.
    """
    from sdp_vs_penalty.cli.runs import (
        NamedRuns,
        problem_from_options,
        read_and_hold,
        runs_from_options,
    )
    from sdp_vs_penalty.estimation.build_problem import PoseOptions
    from sdp_vs_penalty.exporters.sdp import write_posed

    with console.progress("reading the measurements") as progress:
        chosen = PoseOptions.from_texts(
            effects=effects,
            known_loads=known_load,
            known=known,
            instruments=instruments,
            progress=progress,
        )
        robot, (_, runs), _ = read_and_hold(
            lambda held: problem_from_options(problem, gravity, bounds, filters, held),
            hold,
            lambda robot: runs_from_options(robot, NamedRuns(data, window)),
        )
        summary = write_posed(robot, runs, out, method, chosen)
    console.written(
        out,
        f"{summary['method']}: {summary['variables']} variables, {summary['rows']} rows",
    )
    console.written(
        f"{out}.json",
        f"the least objective lies in [{summary['lower']!r}, {summary['upper']!r}]",
    )
