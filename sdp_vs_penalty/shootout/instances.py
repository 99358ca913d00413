"""The instances by name, deterministic: which exist is known without building one.

The library is what `shootout --export` writes; the catalogue is what the shootout runs on by itself.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import product

import numpy as np

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.problem.published import real_data_folder
from sdp_vs_penalty.shootout import ill_conditioned
from sdp_vs_penalty.shootout import standard_instances as standard
from sdp_vs_penalty.shootout.instance import Instance

GROUPS = ("panda", "two_link", "ur10e", "chains", "ill-conditioned")

_SHAPES = {
    "plain": "physical consistency and the problem's bounds",
    "gyration": "links at least 2 cm thick",
    "regulariser": "an entropic pull to the nominal robot (exponential cones)",
    "cones": "centres of mass in second-order cones",
}
_STEPS = {"one-step": "torque error", "two-step": "distance of the base parameters from least squares"}


@dataclass(frozen=True)
class Entry:
    """name, group and how to build it; sentence : what it is, in the library; quick : part of --quick;
    measured : needs real data."""

    name: str
    group: str
    build: Callable[[], Instance]
    sentence: str = ""
    measured: bool = False
    quick: bool = False

    @property
    def folder(self) -> str:
        return f"{self.group}/{re.sub(r'[^a-z0-9]+', '-', self.name.lower()).strip('-')}"


def library() -> list[Entry]:
    """Every instance of the library, measured ones included, in a fixed order."""
    return [*_robots(), *_chains(), *_changed()]


def catalogue() -> dict[str, Entry]:
    """Every instance of the shootout, measured ones included, by name."""
    entries: list[Entry] = []
    for step, shape in product(_STEPS, ("plain", "gyration", "regulariser")):
        name = f"two_link {step} {shape}"
        build = partial(standard.simulated, name, "two_link", step, shape)
        entries.append(Entry(name, "two_link", build, quick=shape == "gyration"))
    for entry in _robots():
        if re.fullmatch(r"panda .* (14 s .*|1 s (one-step .*|two-step gyration))", entry.name):
            quick = entry.name.startswith("panda simulated 14 s one-step")
            entries.append(replace(entry, quick=quick and not entry.name.endswith("cones")))
        elif re.fullmatch("ur10e (simulated (one|two)|measured one)-step gyration", entry.name):
            entries.append(entry)
    for n in (2, 7, 14, 30, 60):
        name = f"chain of {n} links"
        entries.append(Entry(name, "chains", partial(_chain, name, n, "gyration", 0), quick=n <= 7))
    group, whole = ill_conditioned.GROUP, ill_conditioned.panda
    for change in ill_conditioned.CHANGES:
        base = partial(whole, 1.0) if change == "rank-deficient" else whole
        build = partial(ill_conditioned.changed, f"{group} {change}", change, base)
        quick = change in ("gram g mm", "float32 gram", "infeasible 1e-3", "noise-free")
        entries.append(Entry(f"{group} {change}", group, build, quick=quick))
    name = f"{group} raw rows"
    entries.append(Entry(name, group, partial(ill_conditioned.raw_rows, name)))
    return {entry.name: entry for entry in entries}


def _robots() -> Iterator[Entry]:
    """Simulated and measured robots in every formulation."""
    for robot in ("two_link", "panda", "ur10e", "emps", "tx40"):
        makers = {"simulated": standard.simulated, "measured": standard.measured}
        if robot == "two_link":
            del makers["measured"]
        stops = (14.0, 7.0, 3.0, 1.0) if robot == "panda" else (np.inf,)
        for source, stop, step, shape in product(makers, stops, _STEPS, _SHAPES):
            seconds = f" {stop:g} s" if np.isfinite(stop) else ""
            name = f"{robot} {source}{seconds} {step} {shape}"
            build = partial(makers[source], name, robot, step, shape, stop)
            said = f"{robot}, {source}{seconds}: least {_STEPS[step]}; {_SHAPES[shape]}."
            yield Entry(name, robot, build, said, source == "measured")


def _chains() -> Iterator[Entry]:
    """Random serial arms: every size once in every shape, small ones twice more."""
    for n in (2, 3, 4, 5, 6, 7, 8, 10, 12, 14, 20, 30, 40, 60):
        for shape, demand in _SHAPES.items():
            if n > 14 and shape in ("plain", "cones"):
                continue
            for draw in range(3 if n <= 8 and shape in ("plain", "gyration") else 1):
                name = f"chain of {n} links {shape} {draw}"
                said = f"A random arm of {n} revolute joints from 60 random states; {demand}."
                yield Entry(name, "chains", partial(_chain, name, n, shape, draw), said)


def _chain(name: str, n: int, shape: str, draw: int) -> Instance:
    return standard.posed(name, standard.chain_task(n, draw=draw), "one-step", shape)


def _changed() -> Iterator[Entry]:
    """Regular instances with one thing changed that users or data do."""
    bases: dict[str, Callable[[], Instance]] = {
        "two_link": partial(standard.simulated, "", "two_link", "one-step", "gyration"),
        "panda": partial(standard.simulated, "", "panda", "one-step", "gyration", 14.0),
        "ur10e": partial(standard.simulated, "", "ur10e", "one-step", "gyration"),
        "chain of 7 links": partial(_chain, "", 7, "gyration", 0),
        "chain of 14 links": partial(_chain, "", 14, "gyration", 0),
    }
    for robot, build in bases.items():
        for change, (_, words) in ill_conditioned.CHANGES.items():
            if not words:
                continue  # the numbers of another one
            if change == "rank-deficient" and robot == "two_link":
                continue  # its factor has no more rows than that
            name = f"{robot} {change}"
            said = f"{robot} with links at least 2 cm thick, {words}."
            make = partial(ill_conditioned.changed, name, change, build)
            yield Entry(name, ill_conditioned.GROUP, make, said)


def selected(
    groups: Sequence[str], entries: Iterable[Entry], quick: bool = False
) -> tuple[list[Entry], list[Entry]]:
    """Of the entries those of these groups or names, and of them those whose measurements are absent.

    Raises InputError for a group that does not exist.
    """
    everything = list(entries)
    known = list(dict.fromkeys(e.group for e in everything))
    for group in groups:
        if group not in known and all(group != e.name for e in everything):
            raise InputError(
                f"--problems {group!r} is unknown",
                f"choose from {', '.join(known)} and the names of `sdp-vs-penalty shootout --list`",
            )
    chosen = [
        e for e in everything if (e.group in groups and (e.quick or not quick)) or e.name in groups
    ]
    here = real_data_folder() is not None
    return [e for e in chosen if here or not e.measured], [e for e in chosen if e.measured and not here]


@lru_cache(maxsize=4)
def instance(name: str) -> Instance:
    """Build an instance; the last few are kept."""
    entries = {e.name: e for e in library()} | catalogue()
    if name not in entries:
        raise InputError(f"instance {name!r} is unknown", "see `sdp-vs-penalty shootout --list`")
    return entries[name].build()
