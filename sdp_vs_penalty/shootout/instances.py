"""The instances by name, deterministic: which exist is known without building one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.problem.real_data import real_data_folder
from sdp_vs_penalty.shootout import hostile, regular
from sdp_vs_penalty.shootout.instance import Instance

GROUPS = ("panda", "two_link", "ur10e", "chains", "hostile")


@dataclass(frozen=True)
class Entry:
    """name, group and how to build it; quick : part of --quick; measured : needs real data."""

    name: str
    group: str
    build: Callable[[], Instance]
    quick: bool = False
    measured: bool = False


def catalogue() -> dict[str, Entry]:
    """Every instance of the shootout, measured ones included, by name."""
    entries: list[Entry] = []
    for step in ("one-step", "two-step"):
        for shape in ("plain", "gyration", "regulariser"):
            name = f"two_link {step} {shape}"
            build = partial(regular.simulated, name, "two_link", "two_link", step, shape)
            entries.append(Entry(name, "two_link", build, shape == "gyration"))
        for shape in regular.SHAPES:
            for source, stop in (
                ("simulated", 14.0),
                ("simulated", 1.0),
                ("measured", 14.0),
                ("measured", 1.0),
            ):
                if stop == 1.0 and step == "two-step" and shape != "gyration":
                    continue
                name = f"panda {source} {stop:g} s {step} {shape}"
                quick = (
                    source == "simulated" and stop == 14.0 and step == "one-step" and shape != "cones"
                )
                maker = regular.simulated if source == "simulated" else regular.measured
                build = partial(maker, name, "panda", "panda", step, shape, stop)
                entries.append(Entry(name, "panda", build, quick, source == "measured"))
    for step in ("one-step", "two-step"):
        name = f"ur10e simulated {step} gyration"
        build = partial(regular.simulated, name, "ur10e", "ur10e", step, "gyration")
        entries.append(Entry(name, "ur10e", build))
    name = "ur10e measured one-step gyration"
    build = partial(regular.measured, name, "ur10e", "ur10e", "one-step", "gyration")
    entries.append(Entry(name, "ur10e", build, measured=True))
    for n in (2, 7, 14, 30, 60):
        name = f"chain of {n} links"
        entries.append(Entry(name, "chains", partial(regular.chain, name, n), n <= 7))
    for name, make in hostile.BUILDERS.items():
        entries.append(Entry(name, "hostile", partial(make, name), name in hostile.QUICK))
    return {entry.name: entry for entry in entries}


def selected(groups: list[str], quick: bool = False) -> tuple[list[Entry], list[Entry]]:
    """The entries of these groups or names, and of them those whose measurements are absent.

    Raises InputError for a group that does not exist.
    """
    entries = catalogue()
    for group in groups:
        if group not in GROUPS and group not in entries:
            raise InputError(
                f"--problems {group!r} is unknown",
                f"choose from {', '.join(GROUPS)} and the names of `sdp-vs-penalty shootout --list`",
            )
    chosen = [
        e for e in entries.values() if (e.group in groups and (e.quick or not quick)) or e.name in groups
    ]
    here = real_data_folder() is not None
    return [e for e in chosen if here or not e.measured], [e for e in chosen if e.measured and not here]


@lru_cache(maxsize=4)
def instance(name: str) -> Instance:
    """Build an instance; the last few are kept."""
    entries = catalogue()
    if name not in entries:
        raise InputError(f"instance {name!r} is unknown", "see `sdp-vs-penalty shootout --list`")
    return entries[name].build()
