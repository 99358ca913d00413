"""The problems of the shootout: what one is, in which form solvers get it, and those there are, by name.

An instance is of a simulated or measured robot, or of a random serial chain. All are deterministic, and
which exist is known without building one. The library is what `shootout --export` writes; the catalogue
is the part of it that the shootout runs on by itself. Ill-conditioned ones take a standard instance,
such as the simulated Panda with a minimum thickness, and change one thing that users do, or data do to
them.
"""

import hashlib
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache, partial
from itertools import product
from typing import Any, Self

import numpy as np
from scipy import sparse

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.pose import PoseOptions, pose
from sdp_vs_penalty.estimators.estimator import Task
from sdp_vs_penalty.estimators.lmi_sdp import LmiSdpThickness
from sdp_vs_penalty.estimators.sdp_fit import essential, interior_point
from sdp_vs_penalty.problem.load import load_problem
from sdp_vs_penalty.problem.problem import CentreOfMassCone, Problem, open_box
from sdp_vs_penalty.problem.published import measured_runs, real_data_folder
from sdp_vs_penalty.regression.regression import LeastSquares
from sdp_vs_penalty.robot import constraint as build
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.constraint import Alike, Constraint, ConstraintSet
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.simulation.experiments import experiment
from sdp_vs_penalty.solvers.identification import (
    SdpProblem,
    conic_problem,
    least_squares_sdp,
    plain_rows,
    scaled,
)
from sdp_vs_penalty.solvers.objective import Entropy, Objective

_CHAIN_SEED = 20191015


@dataclass(frozen=True)
class Instance:
    """minimise objective(theta) over task.constraints.convex, |theta_k| <= task.bound.

    task : data, constraints and bounds in the instance's own units; what it calls nonconvex is empty.
    formulation : "residual" is ours, centred and scaled; "gram", "gram in float32" and "rows" are what
        users write (:func:`unscaled_sdp`).
    """

    task: Task
    objective: Objective
    formulation: str = "residual"
    name: str = ""

    def having(self, convex: Iterable[Constraint] | None = None, **data: Any) -> Self:
        """With other constraints, or other entries of the data."""
        rows = replace(self.data, **data)
        kept = self.constraints if convex is None else ConstraintSet(tuple(convex))
        objective = replace(self.objective, least_squares=rows)
        return replace(self, task=replace(self.task, data=rows, constraints=kept), objective=objective)

    @property
    def constraints(self) -> ConstraintSet:
        return self.task.constraints

    @property
    def data(self) -> LeastSquares:
        """The least-squares part of the objective."""
        return self.objective.least_squares

    @cached_property
    def interior(self) -> Array | None:
        """A strictly feasible theta, or None where the constraints exclude each other."""
        try:
            return interior_point(self.task, self.constraints)
        except InputError:
            return None

    @cached_property
    def sent(self) -> list[Constraint]:
        """The constraints that solvers get: ours without redundant ones, users' all of them."""
        if self.formulation == "residual":
            return essential(self.constraints, self.objective)
        return list(self.constraints.convex)

    @cached_property
    def sdp(self) -> SdpProblem:
        """The problem as it is posed to conic solvers."""
        if self.formulation != "residual":
            return unscaled_sdp(self.data, self.sent, self.formulation)
        centre = self.task.nominal if self.interior is None else self.interior
        least = 1e-6 * self.data.tau_squared
        return least_squares_sdp(
            self.objective, self.sent, centre, self.task.bound, centre, least_loss=least
        )

    @cached_property
    def hash(self) -> str:
        """Sixteen hexadecimal digits of the problem and the form it is posed in: of objective and
        constraints at three points, to the six digits that all libraries of linear algebra share."""
        data, bound, entropy = self.data, self.task.bound, self.objective.entropy
        numbers = [data.tau_squared, bound.sum()]
        numbers += [] if entropy is None else [entropy.weight, entropy.nominal.sum()]
        for x in np.random.default_rng(0).uniform(-1.0, 1.0, (3, len(bound))) * bound:
            numbers += [data.loss(x), *(c.value(x).sum() for c in self.constraints.convex)]
        families = [f"{c.family} {c.name} {c.cone}" for c in self.constraints.convex]
        told = [self.formulation, self.name, *families, *(f"{x:.6g}" for x in numbers)]
        return hashlib.sha256("\n".join(told).encode()).hexdigest()[:16]


def unscaled_sdp(data: LeastSquares, constraints: Sequence[Constraint], formulation: str) -> SdpProblem:
    """The problem as users write it, without a centre, without scales of parameters or cones:

    gram   minimise theta^T (R^T R) theta - 2 rho^T R theta, whose constant rho^T rho is left out;
           "gram in float32" sums R^T R and R^T rho in single precision
    rows   minimise |z|^2 subject to R theta - z = rho
    """
    (r, p), offset = data.R.shape, data.residual_norm**2
    R, rho, groups = data.R, data.rho, list[Alike]()
    if formulation == "rows":
        groups = [plain_rows("zero", np.hstack([R, -np.eye(r)]), -rho)]
        P, q = sparse.diags(np.repeat([0.0, 2.0], [p, r])).tocsc(), np.zeros(p + r)
    else:
        single = formulation.endswith("float32")
        R, rho = (x.astype(np.float32 if single else float) for x in (R, rho))
        offset += float(data.rho @ data.rho)
        P = sparse.csc_matrix(np.triu(2.0 * (R.T @ R).astype(float)))
        q = -2.0 * (R.T @ rho).astype(float)
    more, placed = scaled(constraints, np.zeros(p), np.ones(p), None, first=r if groups else 0)
    conic = conic_problem([*groups, *more], P, q)
    return SdpProblem(conic, np.zeros(p), np.ones(p), 1.0, placed, offset)


def in_units(instance: Instance, mass: float, length: float) -> Instance:
    """The same problem with masses in ``mass`` kg and lengths in ``length`` m (seconds stay).

    Torques become tau / (mass length^2); parameters, bounds and constraint rows follow their units.
    """
    task, data, entropy = instance.task, instance.data, instance.objective.entropy
    m, l = 1.0 / mass, 1.0 / length  # noqa: E741
    torque, corner = m * l**2, np.sqrt(m) * np.array([l, l, l, 1.0])
    factor = np.full(len(task.bound), torque)
    factor[task.links] = [m, *[m * l] * 3, *[m * l**2] * 6]
    R, rho, left = torque * data.R / factor, torque * data.rho, torque * data.residual_norm
    square = torque**2 * data.tau_squared
    changed = replace(data, R=R, rho=rho, residual_norm=left, tau_squared=square)
    row_units = {"centre of mass": m * l, "centre of mass cone": m * l, "trace": m * l**2}
    row_units |= dict.fromkeys(("mass", "total mass", "bounding ellipsoid", "body"), m)

    def convert(c: Constraint) -> Constraint:
        local = factor[c.indices].reshape(-1, *[1] * c.constant.ndim)
        scale = np.outer(corner, corner) if c.cone == "psd" else row_units.get(c.family, torque)
        return replace(c, constant=c.constant * scale, coefficients=c.coefficients * scale / local)

    convex = tuple(convert(c) for c in task.constraints.convex)
    scaled = {"bound": task.bound * factor, "nominal": task.nominal * factor}
    moved = replace(task, data=changed, constraints=ConstraintSet(convex), **scaled)
    if entropy is not None:
        nominal = entropy.nominal * np.outer(corner, corner)
        entropy = Entropy(entropy.weight * torque**2, moved.pseudo_inertias, nominal)
    return replace(instance, task=moved, objective=Objective(changed, entropy))


def recorded(robot: str, source: str, step: str, shape: str, stop: float = np.inf) -> Instance:
    """From a robot's simulated experiment, or its real measurements up to ``stop`` [s].

    source : "simulated" or "measured". InputError where the measurements are absent."""
    return posed(_task(robot, source, stop), step, shape)


def posed(task: Task, step: str, shape: str) -> Instance:
    """One-step (torque) or two-step (base parameters) form of a task, with a demand on shape."""
    demands = task.minimum_thickness(LmiSdpThickness.thickness) if shape == "gyration" else []
    demands = shape_cones(task) if shape == "cones" else demands
    task = replace(task, constraints=ConstraintSet((*task.constraints.convex, *demands)))
    data, entropy = task.data if step == "one-step" else task.base_distance, None
    if shape == "regulariser":
        spread = max(data.loss(task.ols), 1e-6 * data.tau_squared) / max(data.rows, 1)
        nominal = inertia.pseudo_inertia(task.nominal[task.links])
        entropy = Entropy(spread, task.pseudo_inertias, nominal)
    return Instance(replace(task, data=data), Objective(data, entropy))


def shape_cones(task: Task) -> list[Constraint]:
    """|c across z| <= r + |slope| c_z for each link: a centre of mass in a cone, as the 2R has.

    The cone opens along z from the nominal centre's plane, wide enough to hold it.
    """
    out = []
    for k, indices in enumerate(task.links):
        m, mx, my, mz = task.nominal[indices[:4]]
        centre, slope = np.array([mx, my, mz]) / m, 0.3
        radius = 1.2 * float(np.hypot(*centre[:2])) + 0.02 - slope * min(centre[2], 0.0)
        out.append(CentreOfMassCone(k + 1, "z", radius, slope).constraint(indices))
    return out


@lru_cache(maxsize=8)
def _task(robot: str, source: str, stop: float) -> Task:
    problem, effects = load_problem(robot), None
    if source == "measured":
        if not (runs := list(measured_runs(robot).values())):
            what = f"The measurements of {robot} are absent"
            raise InputError(what, "name their folder in SDP_VS_PENALTY_DATA")
        run = replace(runs[0], dq=None)
    else:
        described = experiment(problem)
        run, effects = described.training_run(seed=0), described.effects
    task = pose(problem, _part(run, problem, stop), PoseOptions(effects)).task
    return replace(task, constraints=ConstraintSet(task.constraints.convex))


def _part(run: Measurements, problem: Problem, stop: float) -> Measurements:
    """The first ``stop`` seconds; of one or two, so many seconds of rows in which the robot moves."""
    if stop >= 5.0:
        return run.window(0.0, stop)
    moved = np.abs(run.q - run.q[0]).max(axis=1) > 0.2 * np.ptp(run.q, axis=0).max()
    begin = float(run.t[np.argmax(moved)] - run.t[0])
    settings = problem.preprocessing.resolve(run)
    assert settings.state_cutoff is not None
    assert settings.torque_cutoff is not None
    # The filters' kernels reach two periods of their cut-off beyond each row.
    reach = 2.0 / settings.state_cutoff + 2.0 / settings.torque_cutoff
    return run.window(begin, begin + stop + 2.0 * reach)


def chain_problem(n: int, draw: int = 0) -> Problem:
    """Twist +-90 degrees or 0, link lengths of 0.15-0.45 m, nominal links as balls."""
    rng = np.random.default_rng([_CHAIN_SEED, n, *[draw] * (draw > 0)])
    a, twist, d = rng.uniform(0.0, 0.3, n), rng.choice([-0.5, 0.0, 0.5], n), rng.uniform(0.05, 0.3, n)
    robot = Robot.from_dh(f"chain{n}", a.tolist(), (np.pi * twist).tolist(), d.tolist(), "modified")
    balls = np.zeros((n, 10))
    balls[:, 0] = 2.0
    balls[:, [4, 6, 9]] = 0.4 * 2.0 * (0.4 * np.array(robot.link_reach())[:, None]) ** 2
    links = inertia.standard_from_barycentric(balls)
    title = f"random serial chain of {n} links"
    return Problem(robot.name, title, robot, open_box(n), links, torque_side="link")


def chain_task(n: int, draw: int = 0) -> Task:
    """Random states, torque of thin random links with friction and white noise, 1 % of each joint's.

    draw : another arm of the same size, with another motion.
    """
    rng = np.random.default_rng([_CHAIN_SEED + 1, n, *[draw] * (draw > 0)])
    problem, samples = chain_problem(n, draw), 60
    model = problem.model()
    q = problem.robot.random_configurations(samples, _CHAIN_SEED)
    dq, ddq = rng.normal(size=(samples, n)), 3.0 * rng.normal(size=(samples, n))
    motion = Motion(np.linspace(0.0, 1.0, samples), q, dq, ddq)
    theta = np.concatenate([thin_links(rng, problem).ravel(), rng.uniform(0.1, 0.5, 3 * n)])
    columns = model.columns(motion)
    torque = np.column_stack([c.columns @ theta[c.indices] for c in columns])
    stack = [np.column_stack([c.wide(len(theta)), t]) for c, t in zip(columns, torque.T, strict=True)]
    for wide in stack:
        wide /= 0.01 * float(np.sqrt(np.mean(wide[:, -1] ** 2)))
        wide[:, -1] += rng.normal(size=samples)
    data, convex = LeastSquares.stacked(stack, n * samples), problem.constraints(model).convex
    known = problem.parameter_bound(model), problem.nominal(model), problem.box
    return Task(model, data, ConstraintSet(convex), *known)


def thin_links(rng: np.random.Generator, problem: Problem) -> Array:
    """(n, 10) links of 1-4 kg whose mass lies near a rod: constraints that bind."""
    out = []
    for reach in problem.robot.link_reach():
        mass = rng.uniform(1.0, 4.0)
        centre = rng.uniform(-0.2, 0.2, 3) * reach
        frame, _ = np.linalg.qr(rng.normal(size=(3, 3)))
        gyration = reach * np.array([0.3, 0.05, 0.02]) * rng.uniform(0.5, 1.0, 3)
        second = mass * (frame * gyration**2) @ frame.T + mass * np.outer(centre, centre)
        corner = (mass * centre)[:, None]
        out.append(inertia.from_pseudo_inertia(np.block([[second, corner], [corner.T, mass]])))
    return np.array(out)


Change = Callable[[Instance], Instance]


def posed_as(formulation: str, unit: float = 1.0) -> Change:
    """In units of so many kg and m, in one of the formulations of an instance."""
    return lambda made: replace(in_units(made, unit, unit), formulation=formulation)


def unidentifiable(made: Instance) -> Instance:
    """No bounds on size: the set of optima is unbounded; the certificate holds within |theta| <= B."""
    open_families = ("trace", "range", "bounding ellipsoid", "total mass", "minimum thickness")
    kept = [c for c in made.constraints.convex if c.family not in open_families]
    wide = made.having(
        build.linear("mass", c.name, c.indices, [[1.0]], [0.0]) if c.family == "mass" else c
        for c in kept
    )
    return replace(wide, task=replace(wide.task, bound=1e3 * made.task.bound))


def total_mass_at_least(shift: float) -> Change:
    """The lower bound on the total mass ``shift`` (relative) above what the links may weigh together."""

    def change(made: Instance) -> Instance:
        rows = [(c.constant, c.coefficients[0]) for c in made.constraints.convex if c.family == "mass"]
        upper = sum(float(min(-c0[c1 < 0] / c1[c1 < 0])) for c0, c1 in rows)
        masses = made.task.links[:, 0]
        least = (1.0 + shift) * upper
        demand = build.linear("total mass", "robot", masses, np.ones((len(masses), 1)), [-least])
        kept = [c for c in made.constraints.convex if c.family != "total mass"]
        return made.having((*kept, demand))

    return change


def rounded(made: Instance) -> Instance:
    """The factor in single precision; what is solved and certified is the problem that this leaves."""
    R, rho = (x.astype(np.float32).astype(float) for x in (made.data.R, made.data.rho))
    return made.having(R=R, rho=rho)


def too_thick(made: Instance) -> Instance:
    """Radii of gyration that the bounds on the moments exclude."""
    kept = [c for c in made.constraints.convex if c.family != "minimum thickness"]
    return made.having((*kept, *made.task.minimum_thickness(3.0)))


def rank_deficient(made: Instance) -> Instance:
    """Some twenty rows of the factor: far fewer directions than parameters are seen."""
    step = max(1, len(made.data.R) // 20)
    return made.having(R=made.data.R[::step], rho=made.data.rho[::step])


def noise_free(made: Instance) -> Instance:
    """Torque of the nominal robot, exactly: the optimum is zero."""
    rho = made.data.R @ made.task.nominal
    return made.having(rho=rho, residual_norm=0.0, tau_squared=float(rho @ rho))


#: One thing that users do, or data do to them, and how it is told in the library; the last one is not in
#: it: its file would have other numbers than its proof.
CHANGES: dict[str, tuple[Change, str]] = {
    "gram kg m": (posed_as("gram"), "as the bare quadratic form of the Gram matrix"),
    "gram g mm": (posed_as("gram", 1e-3), "as the bare quadratic form, in grams and millimetres"),
    "gram t km": (posed_as("gram", 1e3), "as the bare quadratic form, in tons and kilometres"),
    "units g mm": (posed_as("residual", 1e-3), "in grams and millimetres"),
    "units t km": (posed_as("residual", 1e3), "in tons and kilometres"),
    "no scaling": (posed_as("rows"), "without a centre and without scales"),
    "unidentifiable links": (unidentifiable, "without bounds on size: the optima are unbounded"),
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
    "infeasible 1e-3": (total_mass_at_least(1e-3), "with 0.1 % more mass than the bounds allow"),
    "infeasible 1e-6": (total_mass_at_least(1e-6), "with a millionth more mass than the bounds allow"),
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
_STEPS = {"one-step": "torque error", "two-step": "distance of the base parameters from least squares"}
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
    """build : the instance, nameless; sentence : what it is, in the library ("": not one of it);
    measured : needs real data."""

    name: str
    group: str
    build: Callable[[], Instance]
    sentence: str
    measured: bool = False

    def make(self) -> Instance:
        """The instance, by its name."""
        return replace(self.build(), name=self.name)

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
            build = partial(recorded, robot, source, step, shape, stop)
            yield Entry(name, robot, build, said, source == "measured")


def _chains() -> Iterator[Entry]:
    """Random serial arms: every size once in every shape, small ones twice more."""
    for n in (2, 3, 4, 5, 6, 7, 8, 10, 12, 14, 20, 30, 40, 60):
        for shape, demand in _SHAPES.items():
            if n > 14 and shape in ("plain", "cones"):
                continue
            for draw in range(3 if n <= 8 and shape in ("plain", "gyration") else 1):
                said = f"A random arm of {n} revolute joints from 60 random states; {demand}."
                name = f"chain of {n} links {shape} {draw}"
                yield Entry(name, "chains", partial(_chain, n, shape, draw), said)


def _chain(n: int, shape: str = "gyration", draw: int = 0) -> Instance:
    return posed(chain_task(n, draw), "one-step", shape)


def _changed() -> Iterator[Entry]:
    """Regular instances with one thing changed that users or data do."""
    simulated = partial(recorded, source="simulated", step="one-step", shape="gyration")
    bases: dict[str, Callable[[], Instance]] = {
        "two_link": partial(simulated, "two_link"),
        "panda": partial(simulated, "panda", stop=14.0),
        "ur10e": partial(simulated, "ur10e"),
        "chain of 7 links": partial(_chain, 7),
        "chain of 14 links": partial(_chain, 14),
    }
    for (robot, base), (change, (make, words)) in product(bases.items(), CHANGES.items()):
        if (change, robot) != ("rank-deficient", "two_link"):  # its factor has no more rows than twenty
            said = words and f"{robot} with links at least 2 cm thick, {words}."
            build = lambda make=make, base=base: make(base())  # noqa: E731
            yield Entry(f"{robot} {change}", "ill-conditioned", build, said)


def selected(
    groups: Sequence[str] | None, entries: Iterable[Entry], quick: bool = False
) -> tuple[list[Entry], list[Entry]]:
    """Of the entries those of these groups or names (None: all), and of them those whose measurements
    are absent.

    Raises InputError for a group that does not exist.
    """
    there = list(entries)
    known = list(dict.fromkeys(e.group for e in there))
    for group in groups or ():
        if group not in known and all(group != e.name for e in there):
            what = f"--problems {group!r} is unknown"
            remedy = f"choose from {', '.join(known)} and the names of `sdp-vs-penalty shootout --list`"
            raise InputError(what, remedy)
    whole = groups or known
    chosen = [e for e in there if (e.group in whole and (e.quick or not quick)) or e.name in whole]
    absent = [e for e in chosen if e.measured and real_data_folder() is None]
    return [e for e in chosen if e not in absent], absent


@lru_cache(maxsize=4)
def instance(name: str) -> Instance:
    """Build an instance; the last few are kept."""
    entries = {e.name: e for e in everything()}
    if name not in entries:
        raise InputError(f"instance {name!r} is unknown", "see `sdp-vs-penalty shootout --list`")
    return entries[name].make()
