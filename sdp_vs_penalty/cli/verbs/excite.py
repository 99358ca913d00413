from pathlib import Path
from typing import Any

from sdp_vs_penalty.cli import console


def verb(
    problem: str,
    out: Path,
    duration: float | None = None,
    iterations: int | None = None,
    separate: str | None = None,
    level: float = 1.0,
    payload: bool = False,
    for_: str | None = None,
    data: list[Path] | None = None,
    joints: str | None = None,
    urdf: Path | None = None,
    seed: int = 0,
    hold: str | None = None,
) -> None:
    """Design an exciting trajectory within the robot's limits, the run that tells two effects apart,
    the one that weighs a load, or the one that shortens a parameter's range.

    Collisions are checked with --separate and --urdf only.

    Example: sdp-vs-penalty excite panda --out trajectory.csv

    problem PROBLEM|model.json: Built-in name, folder with a problem.toml, or URDF file. With --separate,
        --payload or --for: a model.
    --out trajectory.csv: File to write: t, q, dq, ddq at 1 kHz.
    --duration: Duration of the motion, in seconds; default: 21, with --payload 2.
    --iterations >=1: Maximum iterations; default: 60, with --separate 200.
    --separate A,B: Two effects that the run is to tell apart, as `add` takes them; one: from nothing.
    --level: With --separate: RMS of each effect over the noise, on the default excitation.
    --payload: A motion of the wrist that weighs a load at the flange.
    --for NAME: The random motion that shortens this parameter's range most, such as m4, as predicted.
    --data RUN.csv ...: With --for: the measurements so far; default: those of the model.
    --joints J+J: With --payload: joints that move, such as 5+6; default: the last three.
    --urdf ARM.urdf: With --separate: shapes for the check of self-collision.
    """
    default_duration = 2.0 if payload and not separate else 21.0
    default_iterations = 200 if separate else 60
    settings: dict[str, Any] = {
        "duration": duration or default_duration,
        "iterations": iterations or default_iterations,
        "seed": seed,
    }
    if separate is not None:
        return _separate(Path(problem), separate, out, urdf, level=level, **settings)
    if payload:
        return _payload(Path(problem), joints, out, **settings)
    if for_ is not None:
        del settings["iterations"]  # motions are drawn and compared
        return _shorten(Path(problem), for_, data, out, **settings)
    from sdp_vs_penalty.cli.runs import problem_from_options
    from sdp_vs_penalty.estimation.excitation import excite

    with console.progress("excitation") as progress:
        robot = problem_from_options(problem, hold=hold) if hold else problem
        excitation = excite(robot, progress=progress, **settings)
    excitation.save(out)
    console.say(
        f"condition number of the base regressor: {excitation.history[0]:.1f} at the start, "
        f"{excitation.condition:.1f} after {len(excitation.history) - 1} iterations"
    )
    console.paragraph(f"Self-collision is not checked: {_LOOK}")
    console.written(out)


#: What is said of a motion whose collisions nobody has checked.
_LOOK = "look at the motion before it is run."


def _payload(model: Path, joints: str | None, out: Path, **settings: Any) -> None:
    """Design a motion that weighs a load, write it, and print how precisely it does.

    joints : numbers from 1 of the joints that move, such as "5+6".
    """
    import numpy as np

    from sdp_vs_penalty.errors import InputError
    from sdp_vs_penalty.estimation.estimate import load_estimate
    from sdp_vs_penalty.estimation.excitation import payload_run, save_trajectory

    estimate = load_estimate(model)
    try:
        moving = (
            None if joints is None else [int(word) - 1 for word in joints.split("+")]
        )
    except ValueError:
        raise InputError(
            f"--joints {joints!r} names no joints", "write 5+6+7"
        ) from None
    with console.progress("weighing") as progress:
        excitation = payload_run(estimate, joints=moving, progress=progress, **settings)
    save_trajectory(excitation.trajectory, out)
    # The largest of each kind: of the mass, three first moments, six inertias.
    first_of_kind = (0, 1, 4)
    designed_std = np.maximum.reduceat(excitation.deviation, first_of_kind)
    random_std = np.maximum.reduceat(excitation.started, first_of_kind)
    names = {
        "mass": "kg",
        "mass times centre of mass": "kg m",
        "inertia about the flange": "kg m^2",
    }
    for (name, unit), designed, random in zip(
        names.items(), designed_std, random_std, strict=True
    ):
        console.say(
            f"{name}: +- {designed:.2g} {unit} ({random:.2g} on a random motion)"
        )
    console.paragraph(
        f"Standard deviations of a load after {settings['duration']:g} s, the largest"
        " of three or six, from the noise of the model's data; the model and the gains"
        " of its channels count as exact. The other joints stand in the middle of"
        f" their ranges. Self-collision is not checked: {_LOOK}"
    )
    console.written(out)


def _shorten(
    model: Path, function: str, data: list[Path] | None, out: Path, **settings: Any
) -> None:
    """Choose the motion that shortens the range of a parameter most, write it, and print
    what it would leave."""
    from sdp_vs_penalty.cli.runs import judging_runs
    from sdp_vs_penalty.estimation.estimate import load_estimate
    from sdp_vs_penalty.estimation.excitation import save_trajectory
    from sdp_vs_penalty.ranges.shortening import shortening_runs

    estimate = load_estimate(model)
    runs = judging_runs(estimate, data, None)
    measurements = None if runs is None else runs.train
    with console.progress("comparing motions") as progress:
        best, *others = shortening_runs(
            estimate, function, measurements, progress=progress, **settings
        )
    save_trajectory(best.trajectory, out)
    before, after = (f"{a:.4g} to {b:.4g}" for a, b in (best.before, best.predicted))
    console.say(
        f"{function}: {before} now; {after} with this motion measured too, predicted"
        f" ({100 * best.length:.0f} % of the length)"
    )
    console.paragraph(
        f"The best of {1 + len(others)} random motions; the worst leaves"
        f" {100 * others[-1].length:.0f} %. `ranges --next {function}` says what a scale"
        f" or a known load would leave. Self-collision is not checked: {_LOOK}"
    )
    console.written(out)


def _separate(
    model: Path, effects: str, out: Path, urdf: Path | None, **settings: Any
) -> None:
    """Design the motion that distinguishes two effects, and write it as CSV.

    - ``effects``: both, as `add` takes them.
    - ``urdf``: shapes for the check of self-collision.
    """
    from sdp_vs_penalty.estimation.constants import LEVEL
    from sdp_vs_penalty.estimation.estimate import load_estimate
    from sdp_vs_penalty.estimation.excitation import save_trajectory
    from sdp_vs_penalty.estimation.separation import separate
    from sdp_vs_penalty.robot.geometry import self_collision

    estimate = load_estimate(model)
    shapes = None if urdf is None else self_collision(urdf, estimate.robot.n)
    with console.progress("separating") as progress:
        separation = separate(
            estimate, effects, free=shapes, progress=progress, **settings
        )
    save_trajectory(separation.trajectory, out)
    default, power = separation.default, separation.power
    console.say(
        f"right decision after {settings['duration']:g} s:"
        f" {100 * default.right:.0f} % on the default excitation,"
        f" {100 * power.right:.0f} % on this one",
        style="bold",
    )
    needed = [
        f"{x.seconds:.3g} s" if x.seconds < 1e7 else "never" for x in (default, power)
    ]
    console.say(
        f"seconds for {100 * LEVEL:.0f} % right decisions: {' and '.join(needed)}"
    )
    console.say(
        "squared distance of the two, in noise variances:"
        f" {default.delta2:.3g} and {power.delta2:.3g}"
    )
    console.paragraph(
        f"Effects of {settings['level']:g} noise standard deviations (root mean square)"
        " on the default excitation; longer runs repeat the motion."
    )
    if shapes is None:
        why = (
            "no --urdf is named"
            if urdf is None
            else f"{urdf.name} has no collision shapes"
        )
        console.paragraph(f"Self-collision is not checked ({why}): {_LOOK}")
    console.written(out)
