"""The public measurements that can be fetched: where they are, which version, what they
are."""

import tomllib
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from sdp_vs_penalty.errors import require_known
from sdp_vs_penalty.records import JsonRecord

#: Where GitHub serves single files of a commit.
GITHUB = "https://raw.githubusercontent.com"


@dataclass(frozen=True)
class RemoteFile(JsonRecord):
    """One file of a repository."""

    #: Path of the file in the repository.
    path: str
    #: SHA-256 of its bytes, as hexadecimal digits.
    sha256: str
    #: Its name in the cache; "" where it is the last part of ``path``.
    cached: str = ""
    #: First and last row (from 1) with samples; None where all rows have them.
    rows: tuple[int, int] | None = None

    @property
    def name(self) -> str:
        """Name of the file in the cache."""
        return self.cached or PurePosixPath(self.path).name


@dataclass(frozen=True)
class Dataset(JsonRecord):
    """Measurements that their authors publish."""

    #: Name by which the commands know the data set.
    name: str
    #: What was measured on which robot, in one line.
    title: str
    #: Name of the problem that holds the robot.
    problem: str
    #: Licence under which the authors publish it.
    licence: str
    #: Repository at GitHub, "owner/name".
    source: str
    #: Commit of the repository to which the files belong.
    commit: str
    #: Files that the data set needs.
    files: tuple[RemoteFile, ...]
    #: The authors' gain of each joint from motor current to joint torque [N m/A].
    drive_gains: tuple[float, ...] = ()

    def address(self, file: RemoteFile, base: str = GITHUB) -> str:
        """Build the address of the pinned version of a file, at GitHub or at another
        server ``base`` with its layout."""
        return f"{base}/{self.source}/{self.commit}/{file.path}"


#: Every data set by name, from datasets.toml.
DATASETS = {
    name: Dataset.from_dict({"name": name, **data})
    for name, data in tomllib.loads(
        Path(__file__).with_name("datasets.toml").read_text("utf-8")
    ).items()
}


def dataset(name: str) -> Dataset:
    """Find a public data set by its name.

    Parameters
    ----------
    name : str
        Name as `sdp-vs-penalty list datasets` shows it.

    Returns
    -------
    Dataset
        Its files, commit and licence.

    Raises
    ------
    InputError
        There is no data set of this name.
    """
    require_known("dataset", name, DATASETS)
    return DATASETS[name]


def raw_file_of(path: Path) -> str | None:
    """Return the name of the public data set that a raw file is of; None for another
    file."""
    for dataset in DATASETS.values():
        if path.name in (PurePosixPath(file.path).name for file in dataset.files):
            return dataset.name
    return None
