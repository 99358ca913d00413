"""A log without torque: what its servos' law, its gains and a known scale make of it.

The laws are effects, linear in their gains: 0 = Y theta - kp e + kd dq ..., homogeneous, so that motion
shows everything up to one factor, which a known parameter sets. Three steps, none of which sees what is
known: the law and its delay (servo_law.py), the ratios of the gains (:func:`_balanced`), and the motion
that the law makes of the command alone, attached to the measurements as instruments, which the noise of
positions does not bias. What is then posed is one convex problem (regression/instruments.py).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.sources import Source, as_measurements
from sdp_vs_penalty.effects import effect_types
from sdp_vs_penalty.effects.effect import Block, Effect, Motion, Parameter
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.effects.payload import Payload
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.servo_law import LAWS, Law, find_law
from sdp_vs_penalty.estimation.shapes import ShapeEstimate, estimate_shapes, with_shapes
from sdp_vs_penalty.estimation.simulated_motion import with_simulated_motion
from sdp_vs_penalty.estimators import DEFAULT_METHOD, make_estimator
from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.estimators.task import joint_weights, make_task
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.regression import Regression, compress
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.preprocessing import Preprocessing
from sdp_vs_penalty.signals.spectrum import highest_harmonic

#: Cut-off of the states over the highest harmonic of the command.
_HARMONICS = 5.0
#: Simulations of the command at most, each by the model that the last one's instruments gave, until the
#: law is the same and its delay moves by less than this [s].
_SIMULATIONS, _SAME = 3, 1e-3
#: A parameter counts as determined where others leave this share of its column.
_DETERMINED = 1e-5
#: Steps to the delay with the links that joints share, the largest delay and the width of its slope [s].
_DELAYS, _LATEST, _SLOPE = 2, 0.1, 1e-3
#: Passes in which joints are weighted by what a load leaves.
_WEIGHTINGS = 3
#: Velocities over which dry friction may turn round while the law is sought [rad/s, m/s]; doublings of
#: the widest one of its law that are tried: a simulator's friction is that soft.
_TURNS, _BEYOND = (0.01, 0.05, 0.25), 3
#: Steps of ln kp, their largest, and the one at which they have arrived; directions of unit columns
#: below this are none.
_STEPS, _LARGEST, _ARRIVED, _RANK = 30, 1.0, 1e-4, 1e-9


@dataclass(frozen=True)
class ServoLog:
    """model : with the law's effects and the given parameters; measurements : with the motion that the
    law makes of the command (None of it where instruments were not wanted); details : plain JSON;
    scale_error : relative standard deviation of the scale that loads set."""

    model: Model
    measurements: Measurements
    details: dict[str, Any]
    scale_error: float = 0.0


def parsed_known(text: str) -> dict[str, float]:
    """Known parameters, "kp2=600,kd2=20".

    >>> parsed_known("kp2=600")
    {'kp2': 600.0}
    """
    found = {}
    for item in filter(None, text.split(",")):
        name, _, value = item.partition("=")
        try:
            found[name.strip()] = float(value)
        except ValueError:
            raise InputError(f"--known {item!r}", "write a parameter and its value, kp2=600") from None
        if not 0.0 < abs(found[name.strip()]) < np.inf:
            raise InputError(f"--known {item!r} is no scale", "give a value that is not zero")
    return found


def servo_filters(settings: Preprocessing, data: Measurements) -> Preprocessing:
    """Filters for a log without torque, where none are given: noise of positions is in every column, and
    the command says, free of noise, how fast the motion is. Resolved."""
    if settings.state_cutoff is None and "qcmd" in data.groups:
        told = [replace(run, q=run.commanded["qcmd"]) for run in data.runs()]
        cutoff = _HARMONICS * max(highest_harmonic(run) for run in told)
        settings = replace(settings, state_cutoff=cutoff)
    return settings.resolve(data)


def servo_log(
    problem: Problem,
    effects: Sequence[Effect],
    data: Measurements,
    settings: Preprocessing,
    known: Mapping[str, float],
    weighting: str,
    progress: Progress,
    instruments: bool = True,
    chosen: bool = True,
    loads: Sequence[tuple[Source, float]] = (),
) -> ServoLog:
    """What stands for the torque in a log without one.

    effects : the model's; where servo effects are among them, the law is given, with its delay where
    that is; settings : resolved; known : parameters by name, which set the scale; chosen : whether the
    effects were asked for: if not, rotors turn with the joints as well; loads : further runs, each with
    the mass [kg] that the last link carried, which set the scale.
    Raises InputError for a log without commands, and for a scale that is none.
    """
    if "qcmd" not in data.groups:
        raise InputError(
            "this log holds neither torque nor commands", "log tau1..taun or qcmd1..qcmdn", data.names[0]
        )
    load, drives = _parts(problem, effects, chosen)
    scale: Mapping[str, float] = {}
    measured, shapes = data, list[ShapeEstimate]()
    law: Law | None = None
    for k in range(1 + _SIMULATIONS * instruments):
        progress(f"choosing the servo law, pass {k + 1}")
        before, law = law, _law(load, drives, data, settings, law.delay if law else 0.0)
        names = LAWS[law.name] if not drives else tuple(e.name for e in drives)
        model = _with_drives(problem, load, names, law.delay)
        progress("balancing the gains")
        if k == 0:
            free = _gauge(model, _balanced(problem, model, compress(measured, model, settings)))
            shapes = estimate_shapes(free, measured, settings, weighting, beyond=_BEYOND)
            settled = with_shapes(model.effects, shapes)
            load = tuple(e for e in settled if e.forward != "drive")
            model = replace(model, effects=settled)
        regression = compress(measured, model, settings)
        theta = _balanced(problem, model, regression)
        scale = _scale(problem, model, regression, theta, known)
        model = replace(model, known=dict(scale), reference=theta * _factor(model, theta, scale))
        for _ in range(0 if any("T" in e.given for e in drives) else _DELAYS):
            late = law.delay + _lateness(problem, model, data, settings, weighting)
            law = replace(law, delay=float(np.clip(late, 0.0, _LATEST)))
            model = _with_drives(problem, load, names, law.delay)
            theta = _balanced(problem, model, compress(measured, model, settings))
            model = replace(model, known=dict(scale), reference=theta * _factor(model, theta, scale))
        if k > 0 and before and abs(law.delay - before.delay) < _SAME and law.name == before.name:
            break
        if k < _SIMULATIONS * instruments:
            progress("simulating the command")
            task = make_task(problem, model, compress(data, model, settings), weighting)
            fitted = model.with_known(make_estimator(DEFAULT_METHOD).fit(task).theta)
            data = with_simulated_motion(data, model, fitted)
    assert law is not None
    details: dict[str, Any] = {}
    error = 0.0
    if loads:
        factor, error = _weighed(model, loads, settings)
        scale = {name: factor * x for name, x in scale.items()}
        model = replace(model, known=scale, reference=factor * np.asarray(model.reference))
    details |= {"law": "as given" if drives else law.name, "delay": law.delay, "held_out": law.errors}
    details |= {"shapes": [s.to_dict() for s in shapes], "known": dict(scale)}
    said = [f"a load of {mass:g} kg" for _, mass in loads]
    said += [f"{name} = {x:g}" for name, x in known.items()]
    return ServoLog(model, data, details | {"scale": ", ".join(said) or _no_scale(scale)}, error)


def with_instruments(
    problem: Problem,
    effects: Sequence[Effect],
    data: Measurements,
    settings: Preprocessing,
    weighting: str,
) -> Measurements:
    """A log with torque, and the motion that its servos make of the command: that needs no scale."""
    groups = {name: block for name, block in data.groups.items() if name not in ("tau", "tauff")}
    silent = Measurements.of(data.t, groups, data.names, data.run)
    made = servo_log(problem, effects, silent, settings, {}, weighting, no_progress).measurements
    return replace(data, commanded=made.commanded)


def _parts(
    problem: Problem, effects: Sequence[Effect], chosen: bool
) -> tuple[tuple[Effect, ...], list[Effect]]:
    """The load, and the servo effects that are given."""
    drives = [e for e in effects if e.forward == "drive"]
    load = [e for e in effects if e.forward != "drive"]
    if not drives:  # kd and viscous friction have one column: kd is their sum
        load = [e for e in load if e.name != "viscous_friction"]
    if not chosen and "rotor_inertia" not in {e.name for e in load} and problem.robot.n > 1:
        # A drive has a rotor. A single joint's cannot be told from what it moves.
        load.append(effect_types()["rotor_inertia"](problem.robot))
    return tuple(load), drives


class _Late(Effect):
    """What a command that acts a second later would change of the drives' torque: d(Y theta)/dT."""

    name = "late_command"
    equation = explanation = reference = ""
    whole_robot = True
    signless = True

    def __init__(self, model: Model, theta: Array) -> None:
        super().__init__(model.robot)
        own = zip(model.effects, model.indices, strict=True)
        self.drives = [(e, theta[k]) for e, k in own if e.forward == "drive" and e.needs_command]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        return (Parameter("late", "s", self.name, 0),)

    def blocks(self, motion: Motion) -> list[Block]:
        columns = np.zeros((self.robot.n, len(motion.t)))
        for effect, theta in self.drives:
            for step in (_SLOPE, -_SLOPE):
                for block in effect.with_shape(T=effect.shape["T"] + step).blocks(motion):
                    columns[block.joint] += block.columns @ theta[block.parameters] / (2.0 * step)
        return [Block(j, np.array([0]), column[:, None]) for j, column in enumerate(columns)]


def _lateness(
    problem: Problem, model: Model, data: Measurements, settings: Preprocessing, weighting: str
) -> float:
    """How much later than the model says the command acts [s]: one Gauss-Newton step, with links that
    the joints share."""
    theta = model.with_known(np.asarray(model.reference))
    effects = (*model.effects, _Late(model, theta))
    wide = replace(model, effects=effects, reference=np.append(np.asarray(model.reference), 0.0))
    return float(make_task(problem, wide, compress(data, wide, settings), weighting).ols[-1])


def _with_drives(problem: Problem, load: Sequence[Effect], names: Sequence[str], delay: float) -> Model:
    """The load with the servo effects of these names."""
    kinds = effect_types()
    drives = [kinds[name](problem.robot, T=float(f"{delay:.6g}")) for name in names]
    if "servo_integral" in names and not any(e.name == "torque_offset" for e in load):
        load = (*load, kinds["torque_offset"](problem.robot))  # where the integral began
    return Model(problem.robot, (*load, *drives), gains=problem.gains)


def _law(
    load: Sequence[Effect],
    drives: Sequence[Effect],
    data: Measurements,
    settings: Preprocessing,
    about: float,
) -> Law:
    """The law and its delay; friction may turn round over several velocities meanwhile."""
    wide: list[Effect] = []
    for e in load:
        free = "v_s" in e.shapes and "v_s" not in e.given
        wide += [e.with_shape(v_s=v) for v in _TURNS] if free else [e]
    if not any(e.name == "torque_offset" for e in load):
        wide.append(effect_types()["torque_offset"](load[0].robot))
    names = tuple(LAWS)
    if drives:
        own = {e.name for e in drives}
        names = tuple(name for name, law in LAWS.items() if set(law) == own) or names[-1:]
    delay = next((e.shape["T"] for e in drives if "T" in e.given), None)
    return find_law(wide, data, settings, names, delay, about)


def _balanced(problem: Problem, model: Model, regression: Regression) -> Array:
    """theta (p,) that minimises sum_j |e_j - L_j psi / kp_j|^2 / s_j^2, up to a factor: that which makes
    the links weigh what the problem says.

    e_j is joint j's error, L_j all other columns, s_j what L_j leaves of e_j with coefficients of its
    own. Gauss-Newton in ln kp with psi eliminated (variable projection; Golub, Pereyra, SIAM J. Numer.
    Anal. 1973) and Levenberg's damping: convergent from any start in all cases tried. Raises InputError
    where no joint follows its command.
    """
    p, gains = regression.p, np.array(model.error_gains)
    links, nominal = model.rigid_indices, problem.nominal(model)
    rest = np.setdiff1d(np.arange(p), gains)
    errors, loads, of_links = list[Array](), list[Array](), list[Array]()
    for f, at in zip(regression.per_joint, gains, strict=True):
        wide = np.zeros((len(f.triangle), p))
        wide[:, f.indices] = f.triangle[:, :-1]
        e, own = -wide[:, at], wide[:, rest]
        left = e - own @ (_inverse(own) @ e)
        s = max(float(np.linalg.norm(left)), 1e-9 * float(np.linalg.norm(e))) / np.sqrt(max(f.rows, 1))
        if s == 0.0:
            raise InputError(
                f"joint {f.joint + 1} does not move, or follows its command without error",
                "check the columns qcmd1..qcmdn",
            )
        errors.append(e / s)
        loads.append(own / s)
        of_links.append(wide[:, links] / s)

    def fitted(ln_kp: Array) -> tuple[Array, Array, Array, float]:
        columns = np.vstack([own / np.exp(x) for own, x in zip(loads, ln_kp, strict=True)])
        inverse, e = _inverse(columns), np.concatenate(errors)
        psi = inverse @ e
        left = e - columns @ psi
        slopes = [np.where(owner == j, -(columns @ psi), 0.0) for j in range(len(errors))]
        beside = np.column_stack([x - columns @ (inverse @ x) for x in slopes])
        return psi, beside, left, float(left @ left)

    owner = np.repeat(np.arange(len(errors)), [len(e) for e in errors])
    both = zip(of_links, errors, strict=True)
    ln_kp = np.log(
        [max(float(np.linalg.norm(w @ nominal[links]) / np.linalg.norm(e)), 1e-6) for w, e in both]
    )
    (psi, beside, left, loss), damping = fitted(ln_kp), 1e-3
    for _ in range(_STEPS):
        H, g = beside.T @ beside, beside.T @ left
        step = np.clip(
            np.linalg.solve(H + damping * np.diag(np.diag(H) + 1e-12), g), -_LARGEST, _LARGEST
        )
        found = fitted(ln_kp + step)
        if found[-1] > loss * (1.0 + 1e-12):
            damping *= 10.0
            if damping > 1e6:
                break
            continue
        ln_kp, damping = ln_kp + step, max(0.1 * damping, 1e-9)
        psi, beside, left, loss = found
        if np.max(np.abs(step)) < _ARRIVED:
            break
    theta = np.empty(p)
    theta[gains], theta[rest] = np.exp(ln_kp), psi
    # As the links should weigh, by the torque that they make.
    told, stated = (
        np.concatenate([own @ x for own in of_links]) for x in (theta[links], nominal[links])
    )
    size = float(told @ stated) / max(float(told @ told), 1e-300)
    return theta * (size if size > 0.0 else 1.0)


def _inverse(columns: Array) -> Array:
    """The pseudo-inverse, columns of unit norm."""
    size = np.linalg.norm(columns, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    return np.asarray(np.linalg.pinv(columns / size, rcond=_RANK) / size[:, None])


def _gauge(model: Model, theta: Array) -> Model:
    """The model with all its position gains given: their errors stand for a torque."""
    gains = {model.parameters[k].name: float(theta[k]) for k in model.error_gains}
    return replace(model, known=gains)


def _scale(
    problem: Problem, model: Model, regression: Regression, theta: Array, known: Mapping[str, float]
) -> Mapping[str, float]:
    """What is known, checked; a position gain, if the links weigh as stated, where that is nothing."""
    names = [p.name for p in model.parameters]
    strongest = max(model.error_gains, key=lambda k: float(theta[k]))
    if not known:
        return {names[strongest]: float(theta[strongest])}
    for name in known:
        if name.startswith("total"):
            raise InputError(
                "--known total: the first link's mass makes no torque, so a total is no scale", _SCALES
            )
        if name not in names:
            raise InputError(f"--known {name}: the model has no such parameter", _SCALES)
    free = np.array([not model.drives[k] for k in range(len(names))])
    told = regression.keeping(free).least_squares()
    share = np.zeros(len(names))
    share[free] = told.own_torque / np.maximum(told.column_norms, 1e-300)
    for name in known:
        k = names.index(name)
        if (free[k] and share[k] <= _DETERMINED) or theta[k] == 0.0:
            raise InputError(
                f"--known {name}: motion shows it only in sums with others, so it sets no scale", _SCALES
            )
    return known


def _factor(model: Model, theta: Array, scale: Mapping[str, float]) -> float:
    """From theta to the scale of what is known."""
    names = [p.name for p in model.parameters]
    name, value = next(iter(scale.items()))
    return float(value / theta[names.index(name)])


_SCALES = "give a gain (kp2=600), a parameter that motion shows alone (m1 of a slide, mx6), or a load"


def _no_scale(scale: Mapping[str, float]) -> str:
    gain = ", ".join(f"{name} = {x:.4g}" for name, x in scale.items())
    return f"unknown: all torques, masses and gains share one factor ({gain} if links weigh as stated)"


def _weighed(
    model: Model, loads: Sequence[tuple[Source, float]], settings: Preprocessing
) -> tuple[float, float]:
    """The factor on all of a model's torques with which the loads weigh what they weigh, and its
    relative standard deviation. What the model leaves of a run with a load is the load, and where
    integrals began."""
    robot, theta = model.robot, model.with_known(np.asarray(model.reference))
    own = (Payload(robot), effect_types()["torque_offset"](robot))
    wide = Model(robot, (*model.effects, *own), gains=model.gains, changes=True)
    found, information = list[float](), list[float]()
    for source, mass in loads:
        if not 0.0 < mass < np.inf:
            raise InputError(f"a known load of {mass:g} kg", "give the mass that was on the last link")
        runs = as_measurements(source, robot.n, robot.joint_names, "identify(known_loads=...)")
        left = compress(runs, wide, settings).beside(theta)
        weights = np.ones(robot.n)
        for _ in range(_WEIGHTINGS):
            data = left.least_squares(weights)
            x = _inverse(data.R) @ data.rho
            weights = joint_weights(left, x)
        if data.own_torque[0] <= _DETERMINED * data.column_norms[0] or x[0] <= 0.0:
            raise InputError(
                f"--known-load: these runs do not show {mass:g} kg", "move the joints that lift the load"
            )
        variance = left.oversampling * data.loss(x) / max(data.rows, 1)
        found.append(mass / x[0])
        information.append(x[0] ** 2 * data.own_torque[0] ** 2 / max(variance, 1e-300))
    return float(np.average(found, weights=information)), float(np.sum(information) ** -0.5)
