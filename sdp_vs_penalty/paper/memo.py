"""Results kept on the disk by the content that they were computed from: numbers, settings
and the sources that compute. Estimates are computed once, whichever table or run asks first.

What is computed again from the same content is read instead, in this run and in later
ones, whatever was stopped in between. The folder is $SDP_VS_PENALTY_CACHE, else
sdp-vs-penalty in the user's cache folder; an empty variable keeps nothing. Files are JSON
with all digits; one that is damaged is computed again.
"""

import hashlib
import json
import os
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.certificate import Certificate
from sdp_vs_penalty.estimation.identify import certify
from sdp_vs_penalty.estimators.estimator import Estimator, Fit, Task
from sdp_vs_penalty.estimators.penalty_paper import (
    PenalisedLoss,
    PenaltyPaper,
    Stopping,
    anneal_and_search,
    search_locally,
)
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.robot.arrays import Array

#: The variable that names the folder.
VARIABLE = "SDP_VS_PENALTY_CACHE"
#: The folders whose sources an estimate depends on.
_COMPUTING = ("robot", "effects", "regression", "solvers", "estimators", "estimation")
#: What JSON holds.
Plain = Any


def load_or_compute(
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


def memo_folder() -> Path | None:
    """Return the folder of cached results; None if nothing is to be cached."""
    named = os.environ.get(VARIABLE)
    if named is not None:
        return Path(named) if named else None
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(home) / "sdp-vs-penalty"


def _plain(result: Any) -> Plain:
    """Return the result as JSON gives it back, arrays as lists.

    So a first run has the same types as one that reads the result.
    """
    return json.loads(json.dumps(result, default=lambda array: array.tolist()))


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
    not_hashed = ("model", "progress")  # the model's content is hashed below
    parts = [getattr(task, f.name) for f in fields(task) if f.name not in not_hashed]
    model = task.model
    return (*parts, model.robot.to_dict(), model.parameters, model.known)


@cache
def program_version() -> str:
    """Return a hash of all sources of this program, and of the notes of its tables."""
    home = Path(__file__).parents[1]
    paths = sorted([*home.rglob("*.py"), *home.rglob("*.md")])
    return content_key(path.read_text(encoding="utf-8") for path in paths)


@cache
def source_version() -> str:
    """Return a hash of the sources that a kept estimate depends on, this file's among
    them: it says in which shape one is kept."""
    home = Path(__file__).parents[1]
    computing = [path for name in _COMPUTING for path in (home / name).rglob("*.py")]
    sources = sorted([Path(__file__), *computing])
    return content_key(path.read_text("utf-8") for path in sources)


#: To be raised where annealing, local search or the penalised loss change their numbers,
#: or where these are kept in another shape: runs of hours are kept beyond changes of
#: other sources.
ANNEALING_VERSION = 2
#: Every fit is timed so many times after a first one; the median counts.
REPEATS = 3
#: A run of so many seconds is timed once.
LONG_ENOUGH = 10.0


@dataclass(frozen=True)
class Result:
    """One method on one data set."""

    #: (p,) parameters as certified.
    theta: Array
    #: Its certificate.
    certificate: Certificate
    #: What the method says of its runs.
    details: dict[str, Any]


@dataclass(frozen=True)
class Remembered(Estimator):
    """An estimator whose fits are kept on the disk: theta alone, without multipliers."""

    name = "remembered"
    description = "an estimate that is read where it was computed before"
    estimator: Estimator

    def fit(self, task: Task) -> Fit:
        """Read the estimate from the disk, or compute it."""
        theta = np.array(_estimate(self.estimator, task)["fit_theta"])
        return Fit(theta, task.problem)


def estimate_once(estimator: Estimator, task: Task) -> Result:
    """Return an estimator's certified estimate, read from the disk if it is there.

    Parameters
    ----------
    estimator : Estimator
        Its settings are part of the cached file's key.
    """
    plain = _estimate(estimator, task)
    return Result(
        np.array(plain["theta"]), Certificate(**plain["certificate"]), plain["details"]
    )


def _estimate(estimator: Estimator, task: Task) -> dict[str, Any]:
    """Return the estimate as JSON; the key holds the sources, the settings and the
    task.
    """
    content = (source_version(), estimator.name, estimator, *task_content(task))
    return load_or_compute("estimate", content, partial(_estimated, estimator, task))


def _estimated(estimator: Estimator, task: Task) -> dict[str, Any]:
    """Compute and certify an estimate; return it as JSON."""
    fresh = replace(task)  # without what an earlier method has left in its cache
    if isinstance(estimator, PenaltyPaper):
        fit = estimator.fit_with(fresh, anneal_once)
    else:
        fit = estimator.fit(fresh)
    theta, certificate = certify(task, fit)
    return {
        "theta": theta,
        "certificate": asdict(certificate),
        "details": fit.details,
        "fit_theta": fit.theta,
    }


def fit_seconds(estimator: Estimator, task: Task) -> float:
    """Return the processor time of a fit [s], by one rule for every method: the median of
    REPEATS runs after a first one that does not count, nothing read from the disk.

    Beyond LONG_ENOUGH the first counts: there what only a first run pays for is nothing.
    """
    _, first = timed(estimator, task)
    if first > LONG_ENOUGH:
        return first
    return float(np.median([timed(estimator, task)[1] for _ in range(REPEATS)]))


def timed(estimator: Estimator, task: Task) -> tuple[Fit, float]:
    """Return one fit and its processor time [s], nothing read from the disk."""
    fresh = replace(task)  # without what an earlier fit has left in its cache
    begin = time.process_time()
    fit = estimator.fit(fresh)
    return fit, time.process_time() - begin


def anneal_once(
    loss: PenalisedLoss, weight: float, u: Array, budget: int, rng: np.random.Generator
) -> tuple[Array, int]:
    """Run one step of annealing and local search from u (d,) in [0, 1]^d, or read its
    result from the disk: the best point and the number of evaluations.

    Parameters
    ----------
    budget : int
        Largest number of loss evaluations.
    """
    state = rng.bit_generator.state
    compute = partial(anneal_and_search, loss, weight, u, budget, rng)
    return _search_once("annealing", loss, (weight, u, budget, state), compute)


def search_locally_once(
    loss: PenalisedLoss, weight: float, u: Array, budget: int, stopping: Stopping
) -> tuple[Array, int]:
    """Run :func:`search_locally` from u (d,) in [0, 1]^d, or read its result from the
    disk, as :func:`anneal_once` does."""
    compute = partial(search_locally, loss, weight, u, budget, stopping)
    return _search_once("local-search", loss, (weight, u, budget, stopping), compute)


def _search_once(
    kind: str,
    loss: PenalisedLoss,
    settings: tuple[object, ...],
    search: Callable[[], tuple[Array, int]],
) -> tuple[Array, int]:
    """Return what a search returns, kept by the loss and the search's settings."""
    content = (
        ANNEALING_VERSION,
        scipy.__version__,
        *(loss.data, loss.box.lower, loss.box.upper, loss.box.links),
        *(loss.fixed, loss.free, [vars(demand) for demand in loss.demands]),
        *settings,
    )
    u, n_evaluations = load_or_compute(kind, content, search)
    return np.array(u), int(n_evaluations)
