"""The authors' Panda log: a folder with four text files, one number a line,
sample-major."""

from pathlib import Path

from sdp_vs_penalty.data.formats import csv
from sdp_vs_penalty.data.formats.columns import Choice
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError

SUFFIXES = ()
FOLDER = "exciting_traj_*.txt"
#: How the authors' files are called, by the channel group that they hold.
_FILES = {"t": "time", "q": "positions", "dq": "velocity", "tau": "torques"}


def read(folder: Path, choice: Choice) -> Measurements:
    """Read the run that the paper's authors published of the Panda: a folder with a
    text file for each of time, positions, velocities and torques, one number a line.

    The numbers of a sample's joints follow each other: q1 ... q7 of the first sample,
    then of the second.

    Parameters
    ----------
    folder : Path
        The folder that holds the files "exciting_traj_*.txt".
    choice : Choice
        Not used: the files name no columns.

    Returns
    -------
    Measurements
        The run in SI units, one row a sample.

    Raises
    ------
    InputError
        A file is missing, or its count of numbers does not fit the others.
    """
    columns = {}
    for key, name in _FILES.items():
        path = folder / f"exciting_traj_{name}.txt"
        if not path.exists():
            what = (
                f"{path.name} is missing, and a folder is read as the authors'"
                " Panda log"
            )
            raise InputError(what, "name the file of the run", folder)
        columns[key] = csv.numbers(path, 1)[:, 0]
    t = columns.pop("t")
    if len(t) == 0:
        raise InputError("the log is empty", "name a folder with samples", folder)
    for key, values in columns.items():
        if len(values) % len(t) or len(values) != len(columns["q"]):
            what = f"{len(values)} numbers of {key} do not fit {len(t)} instants"
            raise InputError(what, "fetch it again", folder)
    q = columns["q"].reshape(len(t), -1)
    dq = columns["dq"].reshape(len(t), -1)
    tau = columns["tau"].reshape(len(t), -1)
    return Measurements(t=t, q=q, tau=tau, dq=dq, names=(folder.name,))
