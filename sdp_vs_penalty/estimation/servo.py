"""A log without torque: which law drives the servos, how late its command is, and what sets the scale.

The laws are effects, linear in their gains, and least squares with them are homogeneous: what motion
shows, it shows up to one factor, which a known parameter sets. The law is the one with the least
held-out error, counted in shares of the drives' torque; a delay T enters the command's columns, and
kp e(t - T) = kp e - kp T dq_cmd says how far off it is. The motion that the law then makes of the
command alone is attached to the measurements: instruments, which the noise of positions does not bias.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects import effect_types
from sdp_vs_penalty.effects.effect import Block, Effect, Motion, Parameter
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.shapes import estimate_shapes, with_shapes
from sdp_vs_penalty.estimation.simulated_motion import with_simulated_motion
from sdp_vs_penalty.estimators import DEFAULT_METHOD, make_estimator
from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.estimators.task import make_task
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.regression import Regression, compress, compress_cells
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.phases import phase_folds
from sdp_vs_penalty.signals.preprocessing import Preprocessing
from sdp_vs_penalty.signals.runs import sample_rate
from sdp_vs_penalty.signals.spectrum import highest_harmonic

#: The laws by name, the plainer first, and their effects.
LAWS = {
    "PD": ("servo_position",),
    "PID": ("servo_position", "servo_integral"),
    "cascade": ("servo_position", "servo_integral", "servo_velocity_loop"),
}
_AHEAD = "servo_feedforward"
#: A law with more gains has to lower the held-out error to this share, and by so many standard errors
#: over the folds: one that is right lowers it several times, others by what friction's laws get wrong.
_LESS, _SURE = 0.9, 2.0
_FOLDS, _LATEST = 5, 0.1
#: Steps in which the delay is found, its change [s] at which it has been, and that of a slope [s].
_DELAYS, _ARRIVED, _SLOPE = 6, 1e-4, 1e-3
#: Cut-off of the states over the highest harmonic of the command.
_HARMONICS = 5.0
#: A parameter counts as determined where others leave this share of its column.
_DETERMINED = 1e-5
#: Simulations of the command, each by the model that the last one's instruments gave.
_SIMULATIONS = 2


@dataclass(frozen=True)
class ServoLog:
    """model : with the law's effects and the given parameters; measurements : with the motion that the
    law makes of the command (None of it where instruments were not wanted); details : plain JSON."""

    model: Model
    measurements: Measurements
    details: dict[str, Any]


@dataclass(frozen=True)
class _Search:
    problem: Problem
    settings: Preprocessing
    weighting: str
    load: tuple[Effect, ...]
    known: dict[str, float]
    progress: Progress
    told: dict[str, Any] = field(default_factory=dict)

    def model(self, names: Sequence[str], delay: float) -> Model:
        """The load with the servo effects of these names."""
        kinds, robot = effect_types(), self.problem.robot
        drives = tuple(kinds[name](robot, T=float(f"{delay:.6g}")) for name in names)
        return Model(robot, (*self.load, *drives), gains=self.problem.gains, known=self.known)

    def theta(self, data: Measurements, model: Model) -> Array:
        """Of the certified default method."""
        task = make_task(self.problem, model, compress(data, model, self.settings), self.weighting)
        return model.with_known(make_estimator(DEFAULT_METHOD).fit(task).theta)


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
) -> ServoLog:
    """What stands for the torque in a log without one.

    effects : the model's; where servo effects are among them, the law is given, with its delay where
    that is; settings : resolved; known : parameters by name, which set the scale.
    Raises InputError for a log without commands, and for a scale that is none.
    """
    if "qcmd" not in data.groups:
        raise InputError(
            "this log holds neither torque nor commands", "log tau1..taun or qcmd1..qcmdn", data.names[0]
        )
    drives = [e for e in effects if e.forward == "drive"]
    load = tuple(e for e in effects if e.forward != "drive")
    if not drives:  # kd and viscous friction have one column: kd is their sum
        load = tuple(e for e in load if e.name != "viscous_friction")
    gains = {name: x for name, x in known.items() if name[:2] in ("kp", "kd", "ki", "kh", "kc")}
    search = _Search(problem, settings, weighting, load, dict(gains), progress)
    if not gains:
        search.known.update(_nominal_gain(search, data))
    names = tuple(e.name for e in drives)
    delay = next((e.shape["T"] for e in drives if "T" in e.given), None)
    law = "as given"
    progress("choosing the servo law")
    error: dict[str, float] = {}
    if not drives:
        law, found, error = _chosen(search, data, delay)
        names = LAWS[law]
    else:
        found = _delay(search, data, names, 0.0) if delay is None else delay
    shapes = estimate_shapes(search.model(names, max(found, 0.0)), data, settings, weighting)
    settled = with_shapes(search.model(names, max(found, 0.0)).effects, shapes)
    search = replace(search, load=tuple(e for e in settled if e.forward != "drive"))
    others = {name: x for name, x in known.items() if name not in gains}
    for k in range(_SIMULATIONS if instruments or others else 0):
        progress(f"simulating the command, pass {k + 1}")
        if not drives and found < -_sample(data):  # ahead of it rather than late
            names, law, delay = (*LAWS[law], _AHEAD), f"{law} with feed-forward", 0.0
        found = max(found, 0.0)
        model = search.model(names, found)
        theta = search.theta(data, model)
        _rescale(search, model, theta, others, data)
        if not instruments:
            continue
        model = search.model(names, found)
        data = with_simulated_motion(data, model, _scaled(model, theta))
        if delay is None:
            found = _delay(search, data, names, found)
    found = max(found, 0.0)
    details = {"law": law, "delay": found, "held_out": error, "shapes": [s.to_dict() for s in shapes]}
    details |= {"scale": _scale_said(known, search.known), "known": search.known}
    return ServoLog(search.model(names, found), data, details)


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


def _scaled(model: Model, theta: Array) -> Array:
    """theta in the scale of the model's known gains: all torque is proportional to it."""
    names = [p.name for p in model.parameters]
    name, value = next(iter(model.known.items()))
    return model.with_known(theta * (value / theta[names.index(name)]))


def _sample(data: Measurements) -> float:
    """The log's time step [s]."""
    return float(max(1.0 / sample_rate(run) for run in data.runs()))


class _Late(Effect):
    """What a command that acts a second later would change of the drives' torque: d(Y theta)/dT."""

    name = "late_command"
    equation = explanation = reference = ""
    whole_robot = True
    signless = True

    def __init__(self, model: Model, theta: Array) -> None:
        super().__init__(model.robot)
        self.drives = [
            (effect, theta[k])
            for effect, k in zip(model.effects, model.indices, strict=True)
            if effect.forward == "drive" and effect.needs_command
        ]

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


def _delay(search: _Search, data: Measurements, law: Sequence[str], delay: float) -> float:
    """How much later than logged the commands act [s], by Gauss-Newton steps; below zero, how far they
    are ahead."""
    model, step = search.model(law, delay), 0.0
    regression = compress(data, model, search.settings)
    theta = model.with_known(make_task(search.problem, model, regression, search.weighting).ols)
    for _ in range(_DELAYS):
        wide = replace(model, effects=(*model.effects, _Late(model, theta)))
        regression = compress(data, wide, search.settings)
        *rest, step = make_task(search.problem, wide, regression, search.weighting).ols
        theta, before = model.with_known(np.array(rest)), delay
        delay = float(np.clip(before + step, 0.0, _LATEST))
        if abs(delay - before) < _ARRIVED:
            break
        model = search.model(law, delay)
    if delay <= 0.0:
        return min(before + step, 0.0)
    return delay if delay > 0.5 * _sample(data) else 0.0  # a log tells no finer


def _chosen(
    search: _Search, data: Measurements, delay: float | None
) -> tuple[str, float, dict[str, float]]:
    """The law, its delay [s], and the held-out error of each in shares of the drives' torque [%]."""
    split = phase_folds(data, search.settings, _FOLDS)
    errors: dict[str, Array] = {}
    late: dict[str, float] = {}
    for law, names in LAWS.items():
        late[law] = _delay(search, data, names, 0.0) if delay is None else delay
        model = search.model(names, max(late[law], 0.0))
        rows = compress_cells(data, model, search.settings, split)
        folds = [(rows.select(split.training(k)), rows.select(split.tested(k))) for k in range(_FOLDS)]
        errors[law] = np.array([_held_out(search, model, *parts) for parts in folds])
    best, *others = LAWS
    for law in others:
        gain = errors[best] - errors[law]
        least = max(-2.0 * np.log(_LESS), _SURE * gain.std(ddof=1) / np.sqrt(len(gain)))
        if gain.mean() > least:
            best = law
    shares = {law: float(100.0 * np.exp(0.5 * e.mean())) for law, e in errors.items()}
    return best, late[best], shares


def _held_out(search: _Search, model: Model, train: Regression, test: Regression) -> float:
    """ln of the squared error over the drives' squared torque, mean over the joints."""
    theta = model.with_known(make_task(search.problem, model, train, search.weighting).ols)
    drive = np.zeros(test.joints)
    for f in test.factors:
        part = f.triangle[:, :-1] @ np.where(model.drives, theta, 0.0)[f.indices]
        given = f.triangle[:, -1]  # what known gains make
        drive[f.joint] += float(np.sum((part - given) ** 2))
    return float(np.mean(np.log(test.joint_losses(theta) / np.maximum(drive, 1e-300))))


def _nominal_gain(search: _Search, data: Measurements) -> dict[str, float]:
    """A provisional scale: the best told kp if the links weighed what the problem says."""
    model = replace(search.model(LAWS["PD"], 0.0), known={})
    regression = compress(data, model, search.settings)
    task = make_task(search.problem, model, regression, "none")
    links = task.nominal[task.links].ravel()
    others = np.setdiff1d(np.arange(len(task.nominal)), task.links)
    R = task.data.R[:, others]
    size = np.where(np.linalg.norm(R, axis=0) > 0.0, np.linalg.norm(R, axis=0), 1.0)
    inverse = np.linalg.pinv(R / size, rcond=1e-9)
    theta = inverse @ (task.data.rho - task.data.R[:, task.links.ravel()] @ links) / size
    spread = np.linalg.norm(inverse, axis=1) / size
    names = [model.parameters[k].name for k in others]
    gains = [k for k, name in enumerate(names) if name.startswith("kp") and theta[k] > 0.0]
    if not gains:
        raise InputError("no joint follows its command", "check the columns qcmd1..qcmdn", data.names[0])
    best = max(gains, key=lambda k: theta[k] / spread[k])
    return {names[best]: float(theta[best])}


def _rescale(
    search: _Search, model: Model, theta: Array, others: Mapping[str, float], data: Measurements
) -> None:
    """The known gain that gives another known parameter its value."""
    names = [p.name for p in model.parameters]
    for name, value in others.items():
        if name.startswith("total"):
            raise InputError(
                "--known total: the first link's mass makes no torque, so a total is no scale", _SCALES
            )
        if name not in names:
            raise InputError(f"--known {name}: the model has no such parameter", _SCALES)
        k = names.index(name)
        told = compress(data, model, search.settings).least_squares()
        if told.own_torque[k] <= _DETERMINED * told.column_norms[k] or theta[k] == 0.0:
            raise InputError(
                f"--known {name}: motion shows it only in sums with others, so it sets no scale", _SCALES
            )
        for gain in search.known:
            search.known[gain] *= value / theta[k]


_SCALES = "give a gain (kp2=600), a parameter that motion shows alone (m1 of a slide, mx6), or a load"


def _scale_said(known: Mapping[str, float], gains: Mapping[str, float]) -> str:
    if known:
        return ", ".join(f"{name} = {x:g}" for name, x in known.items())
    gain = ", ".join(f"{name} = {x:.4g}" for name, x in gains.items())
    return f"unknown: all torques, masses and gains share one factor ({gain} if links weigh as stated)"
