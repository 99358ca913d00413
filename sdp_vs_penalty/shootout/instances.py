"""The instances by name, deterministic: which exist is known without building one.

The library is what `shootout --export` writes; the catalogue is the part of it that the shootout runs on
by itself.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
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
#: Names of the catalogue, and of them those of --quick.
_CATALOGUE = (
    r"two_link simulated (one|two)-step (plain|gyration|regulariser)|"
    r"panda (simulated|measured) (14 s .*|1 s (one-step .*|two-step gyration))|"
    r"ur10e (simulated (one|two)|measured one)-step gyration|"
    rf"chain of (2|7|14|30|60) links gyration 0|panda ({'|'.join(ill_conditioned.CHANGES)})"
)
_QUICK = (
    r"two_link .* gyration|panda simulated 14 s one-step (plain|gyration|regulariser)|"
    r"chain of [27] links .*|panda (gram g mm|float32 gram|infeasible 1e-3|noise-free)"
)


@dataclass(frozen=True)
class Entry:
    """name, group and how to make the instance; sentence : what it is, in the library ("": not one of
    it); measured : needs real data."""

    name: str
    group: str
    make: Callable[[], Instance]
    sentence: str
    measured: bool = False

    @property
    def folder(self) -> str:
        return f"{self.group}/{re.sub(r'[^a-z0-9]+', '-', self.name.lower()).strip('-')}"

    @property
    def quick(self) -> bool:
        """Whether it is part of --quick."""
        return re.fullmatch(_QUICK, self.name) is not None


def everything() -> list[Entry]:
    """Every instance, measured ones included, in a fixed order."""
    return [*_robots(), *_chains(), *_changed()]


def library() -> list[Entry]:
    """Those that are exported."""
    return [entry for entry in everything() if entry.sentence]


def catalogue() -> dict[str, Entry]:
    """Those that the shootout runs on by itself, by name."""
    return {e.name: e for e in everything() if re.fullmatch(_CATALOGUE, e.name)}


def _robots() -> Iterator[Entry]:
    """Simulated and measured robots in every formulation."""
    for robot in ("two_link", "panda", "ur10e", "emps", "tx40"):
        sources = ("simulated",) if robot == "two_link" else ("simulated", "measured")
        stops = (14.0, 7.0, 3.0, 1.0) if robot == "panda" else (np.inf,)
        for source, stop, step, shape in product(sources, stops, _STEPS, _SHAPES):
            seconds = f" {stop:g} s" if np.isfinite(stop) else ""
            said = f"{robot}, {source}{seconds}: least {_STEPS[step]}; {_SHAPES[shape]}."
            name = f"{robot} {source}{seconds} {step} {shape}"
            make = partial(standard.recorded, name, robot, source, step, shape, stop)
            yield Entry(name, robot, make, said, source == "measured")


def _chains() -> Iterator[Entry]:
    """Random serial arms: every size once in every shape, small ones twice more."""
    for n in (2, 3, 4, 5, 6, 7, 8, 10, 12, 14, 20, 30, 40, 60):
        for shape, demand in _SHAPES.items():
            if n > 14 and shape in ("plain", "cones"):
                continue
            for draw in range(3 if n <= 8 and shape in ("plain", "gyration") else 1):
                said = f"A random arm of {n} revolute joints from 60 random states; {demand}."
                name = f"chain of {n} links {shape} {draw}"
                yield Entry(name, "chains", partial(_chain, name, n, shape, draw), said)


def _chain(name: str, n: int, shape: str = "gyration", draw: int = 0) -> Instance:
    return standard.posed(name, standard.chain_task(n, draw=draw), "one-step", shape)


def _changed() -> Iterator[Entry]:
    """Regular instances with one thing changed that users or data do."""
    simulated = partial(standard.recorded, source="simulated", step="one-step", shape="gyration")
    bases: dict[str, Callable[[str], Instance]] = {
        "two_link": partial(simulated, robot="two_link"),
        "panda": partial(simulated, robot="panda", stop=14.0),
        "ur10e": partial(simulated, robot="ur10e"),
        "chain of 7 links": partial(_chain, n=7),
        "chain of 14 links": partial(_chain, n=14),
    }
    for (robot, base), (change, (make, words)) in product(
        bases.items(), ill_conditioned.CHANGES.items()
    ):
        if (change, robot) != ("rank-deficient", "two_link"):  # its factor has no more rows than twenty
            said = words and f"{robot} with links at least 2 cm thick, {words}."
            name = f"{robot} {change}"
            yield Entry(name, "ill-conditioned", partial(_changed_one, make, base, name), said)


def _changed_one(change: ill_conditioned.Change, base: Callable[[str], Instance], name: str) -> Instance:
    return change(base(name))


def selected(
    groups: Sequence[str], entries: Iterable[Entry], quick: bool = False
) -> tuple[list[Entry], list[Entry]]:
    """Of the entries those of these groups or names, and of them those whose measurements are absent.

    Raises InputError for a group that does not exist.
    """
    there = list(entries)
    known = list(dict.fromkeys(e.group for e in there))
    for group in groups:
        if group not in known and all(group != e.name for e in there):
            raise InputError(
                f"--problems {group!r} is unknown",
                f"choose from {', '.join(known)} and the names of `sdp-vs-penalty shootout --list`",
            )
    chosen = [e for e in there if (e.group in groups and (e.quick or not quick)) or e.name in groups]
    here = real_data_folder() is not None
    return [e for e in chosen if here or not e.measured], [e for e in chosen if e.measured and not here]


@lru_cache(maxsize=4)
def instance(name: str) -> Instance:
    """Build an instance; the last few are kept."""
    entries = {e.name: e for e in everything()}
    if name not in entries:
        raise InputError(f"instance {name!r} is unknown", "see `sdp-vs-penalty shootout --list`")
    return entries[name].make()
