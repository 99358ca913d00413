from pathlib import Path

from sdp_vs_penalty.cli import console
from sdp_vs_penalty.formatting import given_options


def verb(
    problem: str,
    data: list[Path],
    method: str = "lmi-sdp",
    effects: str | None = None,
    folds: int = 5,
    gravity: str | None = None,
    hold: str | None = None,
    json_: Path | None = None,
    seed: int = 0,
    known: str | None = None,
    jobs: int = 1,
    scheduler: str | None = None,
) -> None:
    """Judge a method on unseen motion: each fold leaves out a stretch and all its repetitions.

    Example: sdp-vs-penalty cross-validate panda --data run.csv --method lmi-sdp-entropic

    --folds >=2: Stretches that each motion is cut into.
    """
    from sdp_vs_penalty.cli.next_step import free_name
    from sdp_vs_penalty.cli.runs import NamedRuns, problem_from_options, read_and_hold
    from sdp_vs_penalty.data.files import load_measurements
    from sdp_vs_penalty.data.measurements import Measurements
    from sdp_vs_penalty.estimation.build_problem import parsed_known
    from sdp_vs_penalty.estimation.resampling import cross_validate
    from sdp_vs_penalty.parallel import Workers
    from sdp_vs_penalty.problem.problem import Problem

    def read(problem_with_holds: Problem) -> list[Measurements]:
        """Return all runs together, for the problem with its joints held."""
        joints = problem_with_holds.channel_names
        return [load_measurements(*data, joints=len(joints), names=joints)]

    with console.progress("reading the measurements") as progress:
        robot, (runs,), hold = read_and_hold(
            lambda held: problem_from_options(problem, gravity, hold=held), hold, read
        )
        result = cross_validate(
            robot,
            runs,
            method,
            effects=effects,
            folds=folds,
            seed=seed,
            known=parsed_known(known),
            workers=Workers(jobs, scheduler),
            progress=progress,
        )
    console.say(result.verdict, style="bold")
    console.paragraph(result.split_sentence)
    console.table(result.table(robot.robot.torque_units))
    settings = {
        "--method": method,
        "--effects": effects,
        "--gravity": gravity,
        "--hold": hold,
        "--known": known,
        "--out": str(free_name("model.json")),
    }
    console.save_json(json_, result.to_dict())
    console.next_step(
        [
            "identify",
            problem,
            "--data",
            *NamedRuns(data).words,
            *given_options(settings),
        ]
    )
