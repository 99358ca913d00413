"""Results kept on the disk by the content that they were computed from: numbers, settings
and the sources that compute.

What is computed again from the same content is read instead, in this run and in later
ones, whatever was stopped in between. The folder is $SDP_VS_PENALTY_CACHE, else
sdp-vs-penalty in the user's cache folder; an empty variable keeps nothing. Files are JSON
with all digits, or .npz archives of arrays; one that is damaged is computed again.
"""

import hashlib
import json
import os
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from typing import Any, cast
from zipfile import BadZipFile

import numpy as np

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimators.estimator import Task
from sdp_vs_penalty.files import write_text, writing
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.constraint import group_cones

#: The variable that names the folder.
VARIABLE = "SDP_VS_PENALTY_CACHE"
#: The folders whose sources an estimate depends on.
_COMPUTING = ("robot", "effects", "regression", "solvers", "estimators", "estimation")
#: What JSON holds.
Plain = Any


def remembered(
    kind: str, content: Iterable[object], compute: Callable[[], Plain]
) -> Any:
    """Return what ``compute`` returns, read from the disk if it was computed before.

    Parameters
    ----------
    kind : str
        What is computed; the file's name begins with it.
    content : iterable
        Everything that the result depends on (see :func:`content_key`).
    compute : callable
        Returns what JSON can hold.

    Returns
    -------
    Any
        The result, as JSON gives it back.
    """
    folder = memo_folder()
    if folder is None:
        return _plain(compute())
    path = folder / f"{kind}-{content_key(content)}.json"
    try:
        return json.loads(path.read_text("utf-8"))
    except (OSError, ValueError):
        result = _plain(compute())
    # Not forced onto the disk: what a power cut damages is computed again, and so is
    # what cannot be kept.
    with suppress(InputError):
        write_text(path, json.dumps(result), lasting=False)
    return result


def remembered_arrays(
    kind: str, content: Iterable[object], compute: Callable[[], Mapping[str, Array]]
) -> dict[str, Array]:
    """Return the arrays of ``compute``, read from the disk if they were computed
    before.

    Parameters
    ----------
    kind : str
        What is computed; the file's name begins with it.
    content : iterable
        Everything that the result depends on (see :func:`content_key`).
    compute : callable
        Returns arrays of numbers by name.

    Returns
    -------
    dict of str to array
        In the order in which they were computed.
    """
    folder = memo_folder()
    if folder is None:
        return dict(compute())
    path = folder / f"{kind}-{content_key(content)}.npz"
    try:
        with np.load(path, allow_pickle=False) as held:
            return {name: held[name] for name in held.files}
    except (OSError, ValueError, EOFError, BadZipFile):
        arrays = dict(compute())
    with suppress(InputError), writing(path, lasting=False) as file:
        np.savez(file, **cast(Any, arrays))
    return arrays


def memo_folder() -> Path | None:
    """Return the folder of cached results; None if nothing is to be cached."""
    named = os.environ.get(VARIABLE)
    if named is not None:
        return Path(named) if named else None
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(home) / "sdp-vs-penalty"


def _plain(result: Any) -> Plain:
    """Return the result as JSON gives it back.

    So a first run has the same types as one that reads the result.
    """
    return json.loads(json.dumps(result, default=float))


def content_key(content: Iterable[object]) -> str:
    """Return a hash of numbers, texts, arrays, dataclasses, and lists and mappings of
    these.

    Parameters
    ----------
    content : iterable
        What is hashed, in this order.

    Raises
    ------
    TypeError
        For a value of any other type: left out of the key, it could give a wrong
        result.
    """
    pieces: list[bytes] = []
    for part in content:
        _collect(part, pieces)
    hasher = hashlib.sha256()
    for piece in pieces:
        hasher.update(len(piece).to_bytes(8, "little"))
        hasher.update(piece)
    return hasher.hexdigest()[:32]


def _collect(value: Any, pieces: list[bytes]) -> None:
    """Append bytes that represent a value, with its type and size, for a hash.

    Values that differ yield other bytes. Raises TypeError for a value that is no
    number, text, array, dataclass, list or mapping.
    """
    # The most frequent kinds come first: to ask for a dataclass or a mapping is slow.
    if value is None or isinstance(value, str | bool | int | float | np.number):
        pieces.append(f"{type(value).__name__} {value!r}".encode())
    elif isinstance(value, np.ndarray):
        pieces.append(f"{value.dtype} {value.shape}".encode())
        pieces.append(np.ascontiguousarray(value).tobytes())
    elif isinstance(value, tuple | list):
        pieces.append(f"list {len(value)}".encode())
        for item in value:
            _collect(item, pieces)
    elif isinstance(value, Mapping):
        pieces.append(f"mapping {len(value)}".encode())
        for name, item in value.items():
            _collect(name, pieces)
            _collect(item, pieces)
    elif is_dataclass(value) and not isinstance(value, type):
        pieces.append(type(value).__qualname__.encode())
        for field in fields(value):
            _collect(getattr(value, field.name), pieces)
    else:
        raise TypeError(f"{type(value).__name__} is no content of a key")


def task_content(task: Task) -> tuple[object, ...]:
    """Return everything that an estimate depends on, for :func:`content_key`.

    Parameters
    ----------
    task : Task
        The data and constraints of an estimator.
    """
    constraints = task.constraints
    named = [(c.family, c.name) for c in (*constraints.convex, *task.bodies)]
    return (
        task.data,
        # Side by side: one array instead of a hundred.
        constraints.groups,
        constraints.nonconvex,
        group_cones(task.bodies),
        named,
        task.bound,
        task.nominal,
        task.box,
        task.independent,
        task.seed,
        task.joint_scale,
        task.prior,
        task.total,
        task.weights,
        task.model.robot.to_dict(),
        task.model.parameters,
        task.model.known,
    )


@cache
def program_version() -> str:
    """Return a hash of all sources of this program, and of the notes of its tables."""
    home = Path(__file__).parents[1]
    paths = sorted([*home.rglob("*.py"), *home.rglob("*.md")])
    return content_key(path.read_text(encoding="utf-8") for path in paths)


@cache
def source_version() -> str:
    """Return a hash of the sources that an estimate depends on."""
    home = Path(__file__).parents[1]
    sources = (path for name in _COMPUTING for path in (home / name).rglob("*.py"))
    return content_key(path.read_text("utf-8") for path in sorted(sources))
