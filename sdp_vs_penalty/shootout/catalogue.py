"""The instances that there are, by name: which exist is known without building one.

All can be raced, judged and exported. Two sets are declared, by the hashes of names, so
that nobody chooses: "drawn", on which settings may be tuned, and "untouched", on which
nobody may, of instances that no shootout ran before the sets were declared. Instances
that are handed out as a bare conic form are a set of their own, "conic form".
Ill-conditioned ones take a standard instance, such as the simulated Panda with a minimum
thickness, and change one thing that users do, or data do to them.
"""

import hashlib
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, lru_cache, partial
from itertools import product

import numpy as np

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.problem.published import real_data_folder
from sdp_vs_penalty.robot import constraint as build
from sdp_vs_penalty.shootout.instances import (
    Instance,
    chain_task,
    exactly_squarable,
    in_units,
    instance_of_task,
    principal_rows,
    recorded,
)

Change = Callable[[Instance], Instance]


#: Units of mass [kg] and length [m].
GRAM_MILLIMETRE = 1e-3, 1e-3
POUND_INCH = 0.45359237, 0.0254


def in_unit(mass: float, length: float) -> Change:
    """Return a change of an instance to other units of mass [kg] and length [m]."""
    return lambda made: in_units(made, mass, length)


def as_gram(mass: float, length: float) -> Change:
    """Return a change of an instance to its bare quadratic form theta^T G theta, in units
    of mass [kg] and length [m]."""

    def change(instance: Instance) -> Instance:
        """Return the instance whose Gram matrix doubles hold without rounding."""
        converted = in_units(instance, mass, length)
        return replace(
            converted.with_data(exactly_squarable(converted.data)), formulation="gram"
        )

    return change


def unscaled(instance: Instance) -> Instance:
    """Return the instance as plain rows z = R theta - rho, without centre and scales."""
    return replace(instance, formulation="rows")


def unidentifiable(instance: Instance) -> Instance:
    """Drop all bounds on the size of links, so that the set of optima is unbounded.

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
    """Round R and rho of |R theta - rho|^2 to single precision.

    The optimum is that of the rounded data, and is proved for them.
    """
    data = principal_rows(instance.data)
    R = data.R.astype(np.float32).astype(float)
    rho = data.rho.astype(np.float32).astype(float)
    return instance.with_data(replace(data, R=R, rho=rho))


def too_thick(instance: Instance) -> Instance:
    """Demand thicker links than their bounds allow, so that nothing is feasible.

    Each link must have radii of gyration of 3 m.
    """
    constraints_kept = [
        c for c in instance.constraints.convex if c.family != "minimum thickness"
    ]
    return instance.having((*constraints_kept, *instance.task.minimum_thickness(3.0)))


def rank_deficient(instance: Instance) -> Instance:
    """Keep the twenty directions of theta that |R theta - rho|^2 shows best.

    They determine far fewer directions than there are parameters.
    """
    data = principal_rows(instance.data)
    return instance.with_data(replace(data, R=data.R[:20], rho=data.rho[:20]))


def noise_free(instance: Instance) -> Instance:
    """Replace the measured torque by that of the nominal robot, without noise.

    Returns
    -------
    Instance
        The loss of its optimum is zero.
    """
    rho = instance.data.R @ instance.task.nominal
    exact = replace(
        instance.data, rho=rho, residual_norm=0.0, tau_squared=float(rho @ rho)
    )
    return instance.with_data(exact)


#: One thing that users do, or data do to them, and what it is in the library.
CHANGES: dict[str, tuple[Change, str]] = {
    "gram kg m": (as_gram(1.0, 1.0), "as the bare quadratic form of the Gram matrix"),
    "gram g mm": (
        as_gram(*GRAM_MILLIMETRE),
        "as the bare quadratic form, in grams and millimetres",
    ),
    "gram lb in": (
        as_gram(*POUND_INCH),
        "as the bare quadratic form, in pounds and inches",
    ),
    "units g mm": (in_unit(*GRAM_MILLIMETRE), "in grams and millimetres"),
    "units lb in": (in_unit(*POUND_INCH), "in pounds and inches"),
    "no scaling": (unscaled, "without a centre and without scales"),
    "unidentifiable links": (
        unidentifiable,
        "without bounds on size: the optima are unbounded",
    ),
    "rank-deficient": (rank_deficient, "from twenty directions only"),
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
}
#: Changes of the form that is handed out; the others change the problem.
FORMS = ("gram kg m", "gram g mm", "gram lb in", "no scaling")

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
#: Links of each robot.
ROBOTS = {"two_link": 2, "panda": 7, "ur10e": 6, "emps": 1, "tx40": 6}
#: Names of the instances on which this package's solvers were tuned before there was a
#: declared set.
_TUNED_ON = (
    r"two_link simulated (one|two)-step (plain|gyration|regulariser)|"
    r"panda (simulated|measured) (14 s .*|1 s (one-step .*|two-step gyration))|"
    r"ur10e (simulated (one|two)|measured one)-step gyration|"
    rf"chain of (2|7|14|30|60) links gyration 0|panda ({'|'.join(CHANGES)})"
)
#: How many instances are drawn, and how many untouched: of each robot, and of random arms
#: of up to so many links. No robot has a quarter of a set.
_DRAWN: dict[str, tuple[int, int]] = dict.fromkeys(ROBOTS, (6, 4))
_DRAWN_ARMS = {8: (5, 3), 14: (3, 2), 60: (4, 2)}
_DRAWN_FORMS = 8
#: How many of each robot are quick, and of how many links at most.
_QUICK = 2, 7
NO_MEASUREMENTS = "its measurements are absent (SDP_VS_PENALTY_DATA)"


@dataclass(frozen=True)
class Entry:
    """An instance that exists, before it is built."""

    #: Name of the instance.
    name: str
    #: A robot, "chains", or "ill-conditioned".
    group: str
    #: Makes the instance, without its name.
    build: Callable[[], Instance]
    #: What it is, in the library.
    sentence: str
    #: Which arm it is about; every random arm is one.
    robot: str
    #: Number of links of the arm.
    links: int
    #: What else it can be selected by: its source, step, shape and change.
    families: tuple[str, ...]

    @property
    def measured(self) -> bool:
        """Whether the instance needs measurements that this computer may lack."""
        return "measured" in self.families

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
    def set(self) -> str:
        """The declared set that holds the instance, "" if none does."""
        return declared_sets()[0].get(self.name, "")

    @cached_property
    def tags(self) -> frozenset[str]:
        """All words by which the instance can be selected."""
        words = {self.group, self.robot, self.name, f"{self.links} links", self.set}
        if self.name in declared_sets()[1]:
            words.add("quick")
        return frozenset({*words, *self.families} - {""})


@cache
def everything() -> tuple[Entry, ...]:
    """List every instance, measured ones included, in a fixed order."""
    return (*_robots(), *_chains(), *_changed())


@cache
def declared_sets() -> tuple[dict[str, str], frozenset[str]]:
    """Return the set that an instance belongs to, by the instance's name, and the names of
    the instances of a quick shootout.

    A set is "drawn", "untouched" or "conic form". Of each robot, and of random arms of each
    size, it takes the instances with the least hash of their names, so that nobody
    chooses. Quick ones are the first drawn ones that are small and need no measurements.
    """
    n_quick, most_links = _QUICK
    by_hash = sorted(
        everything(), key=lambda e: hashlib.sha256(e.name.encode()).digest()
    )
    forms = [e for e in by_hash if e.families[-1] in FORMS][:_DRAWN_FORMS]
    sets = {e.name: "conic form" for e in forms}
    quick = [e.name for e in forms[:n_quick]]
    for stratum, n_drawn, n_untouched in _strata(by_hash):
        fresh = [e for e in stratum if not re.fullmatch(_TUNED_ON, e.name)]
        untouched = fresh[:n_untouched]
        drawn = [e for e in stratum if e not in untouched][:n_drawn]
        sets |= {e.name: "untouched" for e in untouched}
        sets |= {e.name: "drawn" for e in drawn}
        small = [e for e in drawn if e.links <= most_links and not e.measured]
        quick += [e.name for e in small[:n_quick]]
    return sets, frozenset(quick)


def _strata(entries: Sequence[Entry]) -> Iterator[tuple[list[Entry], int, int]]:
    """Yield groups of instances, with the number of drawn and of untouched ones.

    A group is a robot, or random arms of some size. It holds the instances as a user
    poses them, without the other forms.
    """
    posed = [e for e in entries if e.families[-1] not in FORMS]
    for robot, (n_drawn, n_untouched) in _DRAWN.items():
        yield [e for e in posed if e.robot == robot], n_drawn, n_untouched
    arms = [e for e in posed if e.robot not in ROBOTS]
    for most_links, (n_drawn, n_untouched) in _DRAWN_ARMS.items():
        yield [e for e in arms if e.links <= most_links], n_drawn, n_untouched
        arms = [e for e in arms if e.links > most_links]


def _robots() -> Iterator[Entry]:
    """Yield instances of known robots, simulated and measured.

    There is one for each step of the identification and each demand on the links'
    shapes; the Panda has four lengths of the run.
    """
    for robot, links in ROBOTS.items():
        sources = ("simulated",) if robot == "two_link" else ("simulated", "measured")
        stops = (14.0, 7.0, 3.0, 1.0) if robot == "panda" else (np.inf,)
        for source, stop, step, shape in product(sources, stops, _STEPS, _SHAPES):
            seconds = f" {stop:g} s" if np.isfinite(stop) else ""
            description = (
                f"{robot}, {source}{seconds}: least {_STEPS[step]}; {_SHAPES[shape]}."
            )
            name = f"{robot} {source}{seconds} {step} {shape}"
            make_instance = partial(recorded, robot, source, step, shape, stop)
            families = source, step, shape
            yield Entry(name, robot, make_instance, description, robot, links, families)


def _chains() -> Iterator[Entry]:
    """Yield instances of random serial arms of 2 to 60 links.

    Each size comes with each demand on the links' shapes ("plain" and "cones" up to 14
    links). Arms of up to 8 links have two more random draws for "plain" and "gyration".
    """
    for n in (2, 3, 4, 5, 6, 7, 8, 10, 12, 14, 20, 30, 40, 60):
        for shape, demand in _SHAPES.items():
            if n > 14 and shape in ("plain", "cones"):
                continue
            draws = 3 if n <= 8 and shape in ("plain", "gyration") else 1
            for draw in range(draws):
                description = (
                    f"A random arm of {n} revolute joints from 60 random states;"
                    f" {demand}."
                )
                yield Entry(
                    name=f"chain of {n} links {shape} {draw}",
                    group="chains",
                    build=partial(_chain, n, shape, draw),
                    sentence=description,
                    robot=f"chain of {n} links {draw}",
                    links=n,
                    families=("simulated", "one-step", shape),
                )


def _chain(n: int, shape: str = "gyration", draw: int = 0) -> Instance:
    """Build an instance of the draw-th random arm of n links that fits its torques in
    one step.

    ``shape`` is the demand on the links' shapes, as in :func:`instance_of_task`.
    """
    return instance_of_task(chain_task(n, draw), "one-step", shape)


def _changed() -> Iterator[Entry]:
    """Yield ill-conditioned instances: five regular ones, each with one change of
    CHANGES.

    CHANGES has by name the function that changes an instance, and the change in words.
    """
    simulated = partial(recorded, source="simulated", step="one-step", shape="gyration")
    bases: dict[str, tuple[Callable[[], Instance], int]] = {
        "two_link": (partial(simulated, "two_link"), 2),
        "panda": (partial(simulated, "panda", stop=14.0), 7),
        "ur10e": (partial(simulated, "ur10e"), 6),
        "chain of 7 links": (partial(_chain, 7), 7),
        "chain of 14 links": (partial(_chain, 14), 14),
    }
    pairs = product(bases.items(), CHANGES.items())
    for (robot, (base, links)), (change, (make, words)) in pairs:
        if (change, robot) == ("rank-deficient", "two_link"):
            continue  # its R has no more than twenty rows
        yield Entry(
            name=f"{robot} {change}",
            group="ill-conditioned",
            # Defaults bind the loop's present values: the lambda is called later.
            build=lambda make=make, base=base: make(base()),  # type: ignore[misc]
            sentence=f"{robot} with links at least 2 cm thick, {words}.",
            robot=f"{robot} 0" if robot.startswith("chain") else robot,
            links=links,
            families=("simulated", "one-step", "gyration", change),
        )


def selected(
    words: Sequence[str] | None, quick: bool = False
) -> tuple[list[Entry], list[Entry]]:
    """Choose instances by their tags or names.

    Parameters
    ----------
    words : sequence of str, optional
        Each a name, or tags joined by "+", such as "tx40+measured+6 links"; an instance
        counts if one of the words has it. By default the declared sets.
    quick : bool
        Whether only instances of --quick count, besides those that are named.

    Returns
    -------
    tuple of (list of Entry, list of Entry)
        The chosen instances, and those whose measurements this computer lacks.

    Raises
    ------
    InputError
        For a word that nothing has, a named instance whose measurements are absent, or
        if no instance is left.
    """
    if words is None:
        entries = [e for e in everything() if e.set]
    else:
        entries = [e for word in words for e in _instances_of(word)]
    names = set(words or ())
    if quick:
        entries = [e for e in entries if "quick" in e.tags or e.name in names]
    kept = list(dict.fromkeys(entries))
    lacks_measurements = real_data_folder() is None
    absent = [e for e in kept if e.measured and lacks_measurements]
    present = [e for e in kept if e not in absent]
    named_and_absent = [e.name for e in absent if e.name in names]
    if present and not named_and_absent:
        return present, absent
    if not absent:
        raise InputError("no instance is left", "choose more by --problems")
    what = "no instance is left without measurements"
    if named_and_absent:
        what = f"the measurements of {', '.join(named_and_absent)} are absent"
    raise InputError(what, "name the folder of measurements in SDP_VS_PENALTY_DATA")


def _instances_of(word: str) -> list[Entry]:
    """Return the instances that have a name, or all of the tags joined by "+"; InputError
    without any."""
    tags = {tag.strip() for tag in word.split("+")}
    having = [e for e in everything() if tags <= e.tags]
    if not having:
        what = f"no instance has {word!r} (--problems)"
        raise InputError(what, "see `sdp-vs-penalty shootout --list`")
    return having


@lru_cache(maxsize=16)
def instance(name: str) -> Instance:
    """Build an instance by its name; the last ones are cached, all of a quick shootout.

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
        No instance has this name.
    """
    entries = {e.name: e for e in everything()}
    if name not in entries:
        raise InputError(
            f"instance {name!r} is unknown", "see `sdp-vs-penalty shootout --list`"
        )
    return entries[name].make()
