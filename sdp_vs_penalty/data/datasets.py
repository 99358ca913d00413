"""Public measurements: fetched from where their authors publish them, written as
RUN.csv files.

Nothing of them is part of this package. Each file is pinned to a commit and to its
SHA-256, and kept in the user's cache in the authors' own format; what this program
reads is converted beside it.
"""

import os
import tomllib
import warnings
from pathlib import Path

import numpy as np
import scipy

from sdp_vs_penalty import formatting
from sdp_vs_penalty.arguments import checked_arguments
from sdp_vs_penalty.data.catalogue import DATASETS, GITHUB, Dataset, dataset
from sdp_vs_penalty.data.files import save
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.errors import InputError, Remark
from sdp_vs_penalty.files import (
    LARGEST_RUN,
    problems_folder,
    read_bytes,
    require_writable,
    write_bytes,
)
from sdp_vs_penalty.robot.joint import Transmission, parse_transmission

#: Names a folder with the files that need not be downloaded again, one folder a data
#: set.
DATA_VARIABLE = "SDP_VS_PENALTY_DATA"
#: Names an address with the same layout to download from instead (a mirror behind a
#: firewall).
MIRROR_VARIABLE = "SDP_VS_PENALTY_MIRROR"


def cache_folder() -> Path:
    """Return the folder of the user's cache in which downloaded data sets are kept."""
    import pooch

    return Path(pooch.os_cache("sdp-vs-penalty"))


@checked_arguments
def fetch(
    name: str, folder: str | Path | None = None, base: str | None = None
) -> list[Path]:
    """Download a data set once and write its runs.

    Parameters
    ----------
    name : str
        One of `sdp-vs-penalty list datasets`.
    folder : str or Path, optional
        Where to keep it; default: the user's cache.
    base : str, optional
        An address with GitHub's layout of raw files; default: SDP_VS_PENALTY_MIRROR,
        else GitHub.

    Returns
    -------
    list of Path
        The RUN.csv files, one a run.

    Raises
    ------
    InputError
        Where a file cannot be downloaded, or is not the one that was pinned.
    """
    chosen = dataset(name)
    root = cache_folder() if folder is None else Path(folder)
    require_writable(root / name, may_be_folder=True)
    download(chosen, root / name, base or os.environ.get(MIRROR_VARIABLE) or GITHUB)
    for path, rows in ((root / name / file.name, file.rows) for file in chosen.files):
        if rows is not None:
            sentence = (
                f"only rows {rows[0]} to {rows[1]} are used: the others hold no samples"
            )
            warnings.warn(f"{path}: {sentence}", Remark, stacklevel=2)
    paths = []
    for run, measurements in converted(name, root / name).items():
        path = root / name / "runs" / f"{run}.csv"
        save(measurements, path)
        paths.append(path)
    return paths


def converted(name: str, folder: str | Path) -> dict[str, Measurements]:
    """Convert a data set's raw files to runs at the joints.

    Parameters
    ----------
    name : str
        Name of the data set.
    folder : str | Path
        Folder with its authors' files.

    Returns
    -------
    dict[str, Measurements]
        One run for each recording, by its name, in SI units.
    """
    runs = _CONVERTERS[name](Path(folder))
    problem_file = problems_folder() / dataset(name).problem / "problem.toml"
    problem = tomllib.loads(problem_file.read_text(encoding="utf-8"))
    section = problem.get("transmission")
    if section is None:
        return runs
    transmission = parse_transmission(**section)
    return {name: to_joints(run, transmission) for name, run in runs.items()}


def to_joints(measurements: Measurements, transmission: Transmission) -> Measurements:
    """Convert runs that were logged at the motors to the joint side.

    With the motors' positions q_m = A q + b: q = A^-1 (q_m - b) and tau = A^T tau_m.
    Channels that the transmission declares as logged at the joints stay on that side.

    Parameters
    ----------
    measurements : Measurements
        Positions and torques of motors [rad, N m], (N, n) each.
    transmission : Transmission
        A (n, n), b (n,), and for each channel whether it was logged at the motor or at
        the joint.

    Returns
    -------
    Measurements
        The runs at the joints; temperatures and other groups stay as they are.

    Raises
    ------
    InputError
        The runs have another number of channels than the transmission.
    """
    m = measurements
    if m.n != transmission.n:
        count = formatting.count
        what = (
            f"the file has {count(m.n, 'joint')}, the transmission"
            f" {count(transmission.n, 'motor')}"
        )
        raise InputError(what, "name a log with one column a motor", m.names[0])
    groups = m.groups
    for name in groups.keys() & {"q", "dq", "qcmd", "dqcmd"}:
        groups[name] = transmission.joint_positions(
            groups[name], rates=name.startswith("dq")
        )
    for name in groups.keys() & {"tau", "tauff"}:
        groups[name] = transmission.joint_torques(groups[name])
    return m.with_channels(m.t, groups)


def download(chosen: Dataset, folder: Path, base: str = GITHUB) -> None:
    """Download every file of a data set that is not there yet, and check its SHA-256.

    Parameters
    ----------
    folder : Path
        Where its files go; those where SDP_VS_PENALTY_DATA points are copied.
    base : str
        The address of the server.

    Raises
    ------
    InputError
        A file that cannot be downloaded, or is another one than was pinned.
    """
    import pooch

    pooch.get_logger().setLevel("WARNING")
    _copy_known_files(chosen, folder)
    for file in chosen.files:
        address = chosen.address(file, base)
        loader = pooch.HTTPDownloader(timeout=30)
        try:
            pooch.retrieve(
                address, f"sha256:{file.sha256}", file.name, folder, downloader=loader
            )
        except OSError as error:  # every error of requests is one
            missing = ", ".join(
                f.name for f in chosen.files if not (folder / f.name).exists()
            )
            what = f"cannot be downloaded ({type(error).__name__})"
            remedy = f"check the network, or put {missing} into {folder}"
            raise InputError(what, remedy, address) from error
        except ValueError as error:
            what = "not the file that was published (its SHA-256 differs)"
            remedy = (
                f"try again later, or put the right file into {folder} as {file.name}"
            )
            raise InputError(what, remedy, address) from error


def _copy_known_files(chosen: Dataset, folder: Path) -> None:
    """Copy a data set's files from the folder that SDP_VS_PENALTY_DATA names, so that
    they are not downloaded."""
    known_folder = os.environ.get(DATA_VARIABLE)
    if not known_folder:
        return
    for file in chosen.files:
        known_file = Path(known_folder) / chosen.name / file.name
        if known_file.is_file() and not (folder / file.name).exists():
            write_bytes(folder / file.name, read_bytes(known_file, LARGEST_RUN))


def _panda_runs(folder: Path) -> dict[str, Measurements]:
    """Read the Panda's run: four text files of the authors' logger, one number a
    line, those of the seven joints of a sample one after the other."""
    names = ("time", "positions", "torques", "velocity")
    t, *blocks = (np.loadtxt(folder / f"exciting_traj_{name}.txt") for name in names)
    q, tau, dq = (block.reshape(-1, 7) for block in blocks)
    return {"exciting": Measurements(t, q, tau, dq, names=(folder.name,))}


def _ur10e_runs(folder: Path) -> dict[str, Measurements]:
    """Read the UR10e's runs: tables of 31 columns without a header.

    The columns are t, q (6), dq (6), actual current (6), desired current (6) and
    desired torque (6). The torque here is the actual current times the authors' drive
    gains.
    """
    runs = {}
    known = dataset("ur10e")
    for file in known.files:
        first, last = file.rows or (1, None)
        part = {"skiprows": first - 1, "max_rows": last and last - first + 1}
        rows = np.loadtxt(folder / file.name, delimiter=",", encoding="latin1", **part)  # type: ignore[call-overload]
        current = rows[:, 13:19]  # actual [A]
        name = Path(file.name).stem
        runs[name] = Measurements(
            t=rows[:, 0],
            q=rows[:, 1:7],
            dq=rows[:, 7:13],
            tau=current * np.array(known.drive_gains),
            names=(name,),
        )
    return runs


def _emps_runs(folder: Path) -> dict[str, Measurements]:
    """Read the runs of EMPS, a prismatic axis: position and command [m], control
    voltage [V].

    The force [N] is the voltage times the drive's gain [N/V], which the file holds.
    """

    runs = {}
    for file, name in zip(DATASETS["emps"].files, ("tracking", "pulses"), strict=True):
        data = scipy.io.loadmat(folder / file.name)
        force = float(data["gtau"].item()) * data["vir"]
        groups = {
            "q": data["qm"],
            "tau": force,
            "qcmd": data["qg"],
            "voltage": data["vir"],
        }
        runs[name] = Measurements.from_channels(data["t"].ravel(), groups, (name,))
    return runs


def _tx40_runs(folder: Path) -> dict[str, Measurements]:
    """Read the TX40's run: positions [rad] and torques [N m] of its six motors at 5
    kHz, one file each, with a header and one column a motor."""
    positions, torques = DATASETS["tx40"].files
    q = np.loadtxt(folder / positions.name, delimiter=",", skiprows=1)
    tau = np.loadtxt(folder / torques.name, delimiter=",", skiprows=1)
    sampling_rate_hz = 5000.0
    t = np.arange(len(q)) / sampling_rate_hz
    return {"exciting": Measurements(t, q, tau, names=("exciting",))}


_CONVERTERS = {
    "panda": _panda_runs,
    "ur10e": _ur10e_runs,
    "emps": _emps_runs,
    "tx40": _tx40_runs,
}
