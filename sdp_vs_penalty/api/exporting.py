"""The verb ``export``: a model in another format, judged as that format holds it."""

from pathlib import Path

from sdp_vs_penalty.arguments import checked_arguments
from sdp_vs_penalty.data.files import Source, as_measurements
from sdp_vs_penalty.diagnosis.comparison import compare
from sdp_vs_penalty.estimation.estimate import Estimate, as_estimate
from sdp_vs_penalty.estimation.verdict import Verdict, changes
from sdp_vs_penalty.exporters import export as exporting


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
    judged = judge_as_exported(model, out, measurements)
    verdict = None if judged is None else judged[0]
    return exporting.write_model(
        model, out, urdf, mjcf=mjcf, force=force, flange=flange, judged=verdict
    )


def judge_as_exported(
    model: Estimate, out: str | Path, measurements: Source, noise_from: Source = None
) -> tuple[Verdict, str] | None:
    """Judge a model, on runs, without the effects that a file of this name cannot hold.

    Parameters
    ----------
    noise_from : the same, optional
        The recordings of which the measurements are windows.

    Returns
    -------
    (Verdict, str) or None
        The verdict, and how each joint's error changes, in words ("" if it does not).
        None without measurements, and for formats that hold no model of the torque.
    """
    if measurements is None:
        return None
    held = exporting.as_exported(model, out)
    if held is None:
        return None
    runs = as_measurements(measurements, names=model.problem.channel_names)
    whole, part = compare(
        {"model": model, "as exported": held}, runs, noise_from=noise_from
    )
    return part.verdict, changes(
        whole.rmse, part.rmse, part.noise_floor, part.estimate.torque_units
    )
