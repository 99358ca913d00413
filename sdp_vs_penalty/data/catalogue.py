"""The public measurements that can be fetched: where they are, which version, what they are."""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from sdp_vs_penalty.errors import unknown

#: Where GitHub serves single files of a commit.
GITHUB = "https://raw.githubusercontent.com"


@dataclass(frozen=True)
class RemoteFile:
    """One file of a repository: its path there, its SHA-256, its name in the cache; rows : the first and
    the last one (from 1) that hold samples, where others do not."""

    path: str
    sha256: str
    name: str
    rows: tuple[int, int] | None = None


@dataclass(frozen=True)
class Dataset:
    """Measurements that their authors publish.

    source : GitHub owner/name; commit : which version; problem : whose robot it is.
    """

    name: str
    title: str
    problem: str
    licence: str
    source: str
    commit: str
    files: tuple[RemoteFile, ...]

    def address(self, file: RemoteFile, base: str = GITHUB) -> str:
        return f"{base}/{self.source}/{self.commit}/{file.path}"


def _file(path: str, sha256: str, name: str = "", rows: Sequence[int] = ()) -> RemoteFile:
    span = (rows[0], rows[1]) if rows else None
    return RemoteFile(path, sha256, name or PurePosixPath(path).name, span)


#: Every data set by name, from datasets.toml.
DATASETS = {
    name: Dataset(name, **{**data, "files": tuple(_file(**f) for f in data["files"])})
    for name, data in tomllib.loads(Path(__file__).with_name("datasets.toml").read_text()).items()
}


def dataset(name: str) -> Dataset:
    if name not in DATASETS:
        raise unknown("dataset", name, DATASETS)
    return DATASETS[name]
