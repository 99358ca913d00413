"""The authors' Panda log: a folder with four text files, one number a line, sample-major:
q1 ... q7 of the first sample, then of the second."""

from pathlib import Path

from sdp_vs_penalty.data.formats.csv import log_of_table
from sdp_vs_penalty.data.formats.text_table import TextTable
from sdp_vs_penalty.data.log import Log, log_of_arrays
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.robot.arrays import Array

SUFFIXES: tuple[str, ...] = ()
FOLDER = "exciting_traj_*.txt"

#: How the authors' files are called, by the channel group that they hold.
_FILES = {"t": "time", "q": "positions", "dq": "velocity", "tau": "torques"}


def read(folder: Path) -> Log:
    """Read the files "exciting_traj_*.txt" of a folder; raise InputError where one is
    missing, or its count of numbers does not fit the others."""
    columns = dict[str, Array]()
    for key, name in _FILES.items():
        path = folder / f"exciting_traj_{name}.txt"
        if not path.exists():
            what = f"{path.name} is missing, and a folder is read as the authors' Panda log"
            raise InputError(what, "name the file of the run", folder)
        log = log_of_table(
            TextTable(path, decimals=(".",), names=("#1",), kinds=("number",))
        )
        columns[key] = log.read(["#1"]).columns["#1"]
    count = len(columns["t"])
    if count == 0:
        raise InputError("the log is empty", "name a folder with samples", folder)
    for key in ("q", "dq", "tau"):
        n_numbers = len(columns[key])
        if n_numbers % count or n_numbers != columns["q"].size:
            what = f"{n_numbers} numbers of {key} do not fit {count} instants"
            raise InputError(what, "fetch it again", folder)
        columns[key] = columns[key].reshape(count, -1)
    return log_of_arrays(folder, columns)
