"""The instances that there are, by name: which exist is known without building one.

The library is what `shootout --export` writes; the catalogue is the part of it that the
shootout runs on by itself. Ill-conditioned ones take a standard instance, such as the
simulated Panda with a minimum thickness, and change one thing that users do, or data do
to them.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import product

import numpy as np

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.problem.published import real_data_folder
from sdp_vs_penalty.robot import constraint as build
from sdp_vs_penalty.shootout.instances import (
    Instance,
    chain_task,
    in_units,
    posed,
    recorded,
)

Change = Callable[[Instance], Instance]


def posed_as(formulation: str, unit: float = 1.0) -> Change:
    """Return a change of an instance to other units and another formulation.

    Parameters
    ----------
    formulation : str
        "residual", "gram", "gram in float32" or "rows".
    unit : float
        Size of the new units of mass [kg] and length [m].

    Returns
    -------
    callable
        Maps an instance to the changed one.
    """
    return lambda made: replace(in_units(made, unit, unit), formulation=formulation)


def unidentifiable(instance: Instance) -> Instance:
    """Drop all bounds on the size of links, so that the set of optima is unbounded.

    Parameters
    ----------
    instance : Instance
        A regular instance.

    Returns
    -------
    Instance
        Its parameters are bounded a thousand times as wide, which the certificate
        needs.
    """
    dropped_families = (
        "trace",
        "range",
        "bounding ellipsoid",
        "total mass",
        "minimum thickness",
    )
    convex = []
    for c in instance.constraints.convex:
        if c.family in dropped_families:
            continue
        if c.family == "mass":  # masses stay positive only
            c = build.linear("mass", c.name, c.indices, [[1.0]], [0.0])
        convex.append(c)
    wide = instance.having(convex)
    return replace(wide, task=replace(wide.task, bound=1e3 * instance.task.bound))


def total_mass_at_least(shift: float) -> Change:
    """Return a change that demands a total mass near the limit of what is feasible.

    Parameters
    ----------
    shift : float
        The demanded mass is 1 + shift times the largest mass that the links may have
        together: a negative shift is nearly infeasible, a positive one infeasible.

    Returns
    -------
    callable
        Maps an instance to the changed one.
    """

    def change(instance: Instance) -> Instance:
        """Return the instance with the demand on its total mass."""
        # Rows c0 + c1 m >= 0 with c1 < 0 limit a mass m to -c0 / c1.
        largest_total = 0.0
        for c in instance.constraints.convex:
            if c.family != "mass":
                continue
            is_upper_limit = c.coefficients[0] < 0
            constants = c.constant[is_upper_limit]
            slopes = c.coefficients[0][is_upper_limit]
            largest_total += float(min(-constants / slopes))
        masses = instance.task.links[:, 0]
        smallest_mass = (1.0 + shift) * largest_total
        demand = build.linear(
            "total mass", "robot", masses, np.ones((len(masses), 1)), [-smallest_mass]
        )
        constraints_kept = [
            c for c in instance.constraints.convex if c.family != "total mass"
        ]
        return instance.having((*constraints_kept, demand))

    return change


def rounded(instance: Instance) -> Instance:
    """Round R and rho of the objective |R theta - rho|^2 to single precision.

    Parameters
    ----------
    instance : Instance
        A regular instance.

    Returns
    -------
    Instance
        Its optimum is that of the rounded data, and is proved for them.
    """
    R = instance.data.R.astype(np.float32).astype(float)
    rho = instance.data.rho.astype(np.float32).astype(float)
    return instance.having(R=R, rho=rho)


def too_thick(instance: Instance) -> Instance:
    """Demand thicker links than their bounds allow, so that nothing is feasible.

    Each link must have radii of gyration of 3 m.

    Parameters
    ----------
    instance : Instance
        A regular instance.

    Returns
    -------
    Instance
        Infeasible.
    """
    constraints_kept = [
        c for c in instance.constraints.convex if c.family != "minimum thickness"
    ]
    return instance.having((*constraints_kept, *instance.task.minimum_thickness(3.0)))


def rank_deficient(instance: Instance) -> Instance:
    """Keep about twenty rows of R in |R theta - rho|^2.

    Parameters
    ----------
    instance : Instance
        A regular instance.

    Returns
    -------
    Instance
        Its rows determine far fewer directions than there are parameters.
    """
    step = max(1, len(instance.data.R) // 20)
    return instance.having(R=instance.data.R[::step], rho=instance.data.rho[::step])


def noise_free(instance: Instance) -> Instance:
    """Replace the measured torque by that of the nominal robot, without noise.

    Parameters
    ----------
    instance : Instance
        A regular instance.

    Returns
    -------
    Instance
        The loss of its optimum is zero.
    """
    rho = instance.data.R @ instance.task.nominal
    return instance.having(rho=rho, residual_norm=0.0, tau_squared=float(rho @ rho))


#: One thing that users do, or data do to them, and how it is told in the library; the
#: last one is not in it: its file would have other numbers than its proof.
CHANGES: dict[str, tuple[Change, str]] = {
    "gram kg m": (posed_as("gram"), "as the bare quadratic form of the Gram matrix"),
    "gram g mm": (
        posed_as("gram", 1e-3),
        "as the bare quadratic form, in grams and millimetres",
    ),
    "gram t km": (
        posed_as("gram", 1e3),
        "as the bare quadratic form, in tons and kilometres",
    ),
    "units g mm": (posed_as("residual", 1e-3), "in grams and millimetres"),
    "units t km": (posed_as("residual", 1e3), "in tons and kilometres"),
    "no scaling": (posed_as("rows"), "without a centre and without scales"),
    "unidentifiable links": (
        unidentifiable,
        "without bounds on size: the optima are unbounded",
    ),
    "rank-deficient": (rank_deficient, "from twenty rows only"),
    "noise-free": (noise_free, "of exact torques: the optimum is zero"),
    "nearly infeasible 1e-3": (
        total_mass_at_least(-1e-3),
        "with masses within 0.1 % of the most that their bounds allow",
    ),
    "nearly infeasible 1e-6": (
        total_mass_at_least(-1e-6),
        "with masses within a millionth of the most that their bounds allow",
    ),
    "infeasible 1e-3": (
        total_mass_at_least(1e-3),
        "with 0.1 % more mass than the bounds allow",
    ),
    "infeasible 1e-6": (
        total_mass_at_least(1e-6),
        "with a millionth more mass than the bounds allow",
    ),
    "infeasible thickness": (too_thick, "with links thicker than their bounds allow"),
    "float32 data": (rounded, "from data rounded to single precision"),
    "float32 gram": (posed_as("gram in float32"), ""),
}

_SHAPES = {
    "plain": "physical consistency and the problem's bounds",
    "gyration": "links at least 2 cm thick",
    "regulariser": "an entropic pull to the nominal robot (exponential cones)",
    "cones": "centres of mass in second-order cones",
}
_STEPS = {
    "one-step": "torque error",
    "two-step": "distance of the base parameters from least squares",
}
#: Names of the catalogue, and of them those of --quick.
_CATALOGUE = (
    r"two_link simulated (one|two)-step (plain|gyration|regulariser)|"
    r"panda (simulated|measured) (14 s .*|1 s (one-step .*|two-step gyration))|"
    r"ur10e (simulated (one|two)|measured one)-step gyration|"
    rf"chain of (2|7|14|30|60) links gyration 0|panda ({'|'.join(CHANGES)})"
)
_QUICK = (
    r"two_link .* gyration|panda simulated 14 s one-step (plain|gyration|regulariser)|"
    r"chain of [27] links .*|panda (gram g mm|float32 gram|infeasible 1e-3|noise-free)"
)


@dataclass(frozen=True)
class Entry:
    """build : the instance, nameless; sentence : what it is, in the library ("": not
    one of it)."""

    name: str
    group: str
    build: Callable[[], Instance]
    sentence: str

    @property
    def measured(self) -> bool:
        """Whether the instance needs real measurements, which may be absent on this
        computer.
        """
        return " measured " in self.name

    def make(self) -> Instance:
        """Build the instance, and give it its name."""
        return replace(self.build(), name=self.name)

    @property
    def folder(self) -> str:
        """Folder of the instance in the library: its group and its name in plain
        letters, such as "panda/panda-simulated-14-s-one-step-plain".
        """
        plain_name = re.sub(r"[^a-z0-9]+", "-", self.name.lower()).strip("-")
        return f"{self.group}/{plain_name}"

    @property
    def quick(self) -> bool:
        """Whether a quick shootout (--quick) includes the instance."""
        return re.fullmatch(_QUICK, self.name) is not None


def everything() -> list[Entry]:
    """List every instance, measured ones included, in a fixed order."""
    return [*_robots(), *_chains(), *_changed()]


def library() -> list[Entry]:
    """List the instances that `shootout --export` writes as files."""
    return [entry for entry in everything() if entry.sentence]


def catalogue() -> dict[str, Entry]:
    """Return the instances that a shootout runs if no names are given, by name."""
    return {e.name: e for e in everything() if re.fullmatch(_CATALOGUE, e.name)}


def _robots() -> Iterator[Entry]:
    """Yield instances of known robots, simulated and measured.

    There is one for each step of the identification and each demand on the links'
    shapes; the Panda has four lengths of the run.
    """
    for robot in ("two_link", "panda", "ur10e", "emps", "tx40"):
        sources = ("simulated",) if robot == "two_link" else ("simulated", "measured")
        stops = (14.0, 7.0, 3.0, 1.0) if robot == "panda" else (np.inf,)
        for source, stop, step, shape in product(sources, stops, _STEPS, _SHAPES):
            seconds = f" {stop:g} s" if np.isfinite(stop) else ""
            description = (
                f"{robot}, {source}{seconds}: least {_STEPS[step]}; {_SHAPES[shape]}."
            )
            name = f"{robot} {source}{seconds} {step} {shape}"
            build = partial(recorded, robot, source, step, shape, stop)
            yield Entry(name, robot, build, description)


def _chains() -> Iterator[Entry]:
    """Yield instances of random serial arms of 2 to 60 links.

    Each size comes with each demand on the links' shapes ("plain" and "cones" up to 14
    links). Arms of up to 8 links have two more random draws for "plain" and "gyration".
    """
    for n in (2, 3, 4, 5, 6, 7, 8, 10, 12, 14, 20, 30, 40, 60):
        for shape, demand in _SHAPES.items():
            if n > 14 and shape in ("plain", "cones"):
                continue
            for draw in range(3 if n <= 8 and shape in ("plain", "gyration") else 1):
                description = (
                    f"A random arm of {n} revolute joints from 60 random states;"
                    f" {demand}."
                )
                name = f"chain of {n} links {shape} {draw}"
                yield Entry(
                    name, "chains", partial(_chain, n, shape, draw), description
                )


def _chain(n: int, shape: str = "gyration", draw: int = 0) -> Instance:
    """Build an instance of the draw-th random arm of n links that fits its torques in
    one step.

    ``shape`` is the demand on the links' shapes, as in :func:`posed`.
    """
    return posed(chain_task(n, draw), "one-step", shape)


def _changed() -> Iterator[Entry]:
    """Yield ill-conditioned instances: five regular ones, each with one change of
    CHANGES.

    CHANGES has by name the function that changes an instance, and the change in words.
    """
    simulated = partial(recorded, source="simulated", step="one-step", shape="gyration")
    bases: dict[str, Callable[[], Instance]] = {
        "two_link": partial(simulated, "two_link"),
        "panda": partial(simulated, "panda", stop=14.0),
        "ur10e": partial(simulated, "ur10e"),
        "chain of 7 links": partial(_chain, 7),
        "chain of 14 links": partial(_chain, 14),
    }
    for (robot, base), (change, (make, words)) in product(
        bases.items(), CHANGES.items()
    ):
        if (change, robot) == ("rank-deficient", "two_link"):
            continue  # its R has no more than twenty rows
        # The last change has no words, because the library leaves it out.
        sentence = words and f"{robot} with links at least 2 cm thick, {words}."
        # Defaults bind the loop's present values: the lambda is called later.
        build = lambda make=make, base=base: make(base())  # noqa: E731
        yield Entry(f"{robot} {change}", "ill-conditioned", build, sentence)


def selected(
    groups: Sequence[str] | None, entries: Iterable[Entry], quick: bool = False
) -> tuple[list[Entry], list[Entry]]:
    """Choose instances by group or by name.

    Parameters
    ----------
    groups : sequence of str, optional
        Names of groups or instances; by default all.
    entries : iterable of Entry
        Instances to choose from.
    quick : bool
        Whether a group stands for its instances of --quick only.

    Returns
    -------
    tuple of (list of Entry, list of Entry)
        The chosen instances, and those whose measurements this computer lacks.

    Raises
    ------
    InputError
        For an unknown group or name.
    """
    all_entries = list(entries)
    known = list(dict.fromkeys(entry.group for entry in all_entries))
    names = {entry.name for entry in all_entries}
    for group in groups or ():
        if group not in known and group not in names:
            what = f"--problems {group!r} is unknown"
            remedy = (
                f"choose from {', '.join(known)} and the names of `sdp-vs-penalty"
                " shootout --list`"
            )
            raise InputError(what, remedy)
    groups_chosen = groups or known
    chosen = []
    for entry in all_entries:
        is_of_group = entry.group in groups_chosen and (entry.quick or not quick)
        if is_of_group or entry.name in groups_chosen:
            chosen.append(entry)
    absent = [e for e in chosen if e.measured and real_data_folder() is None]
    return [e for e in chosen if e not in absent], absent


@lru_cache(maxsize=4)
def instance(name: str) -> Instance:
    """Build an instance by its name; the last four are cached.

    Parameters
    ----------
    name : str
        Name of an instance, such as "chain of 7 links gyration 0".

    Returns
    -------
    Instance
        The problem with its name.

    Raises
    ------
    InputError
        For an unknown name.
    """
    entries = {e.name: e for e in everything()}
    if name not in entries:
        raise InputError(
            f"instance {name!r} is unknown", "see `sdp-vs-penalty shootout --list`"
        )
    return entries[name].make()
