"""A log without torque: what its servos' law, its gains and a known scale make of it.

The laws are effects, linear in their gains: 0 = Y theta - kp e + kd dq ..., homogeneous, so that motion
shows everything up to one factor, which a known parameter sets in the end (servo_scale.py). Before that
come the law (servo_law.py), the ratios of the gains, the delay, and the motion that the law makes of the
command alone, attached as instruments (regression/instruments.py) to one convex problem.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from sdp_vs_penalty.data.files import Source
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects import effect_types
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.effects.servo import LATEST
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.constants import (
    COMMAND_HARMONICS,
    DELAY_STEPS,
    SAME_MOTION,
    SIMULATIONS,
    WIDER_TURNS,
)
from sdp_vs_penalty.estimation.drive_torque import with_simulated_motion
from sdp_vs_penalty.estimation.servo_law import LAWS, find_law
from sdp_vs_penalty.estimation.servo_scale import (
    balanced,
    constants_of_motors,
    factor_of_known,
    factor_of_loads,
    factor_of_motors,
    words_of_scale,
)
from sdp_vs_penalty.estimation.shape_constants import prior_deviation, with_sensitivities
from sdp_vs_penalty.estimation.shapes import ShapeEstimate, estimate_shapes, with_shapes
from sdp_vs_penalty.estimators import DEFAULT_METHOD, make_estimator
from sdp_vs_penalty.estimators.estimator import Progress, make_task, no_progress
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.regression import compress
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.signals.preprocessing import Preprocessing
from sdp_vs_penalty.signals.spectrum import highest_harmonic


@dataclass(frozen=True)
class ServoLog:
    """model : with the law's effects and the given parameters; measurements : with the motion that the
    law makes of the command (None of it where instruments were not wanted); details : plain JSON;
    scale_error : relative standard deviation of the scale that loads set."""

    model: Model
    measurements: Measurements
    details: dict[str, Any]
    scale_error: float = 0.0


def servo_filters(settings: Preprocessing, data: Measurements) -> Preprocessing:
    """Filters for a log without torque, where none are given: noise of positions is in every column, and
    the command says, free of noise, how fast the motion is. Resolved."""
    if settings.state_cutoff is None and "qcmd" in data.groups:
        told = [replace(run, q=run.commanded["qcmd"]) for run in data.runs()]
        cutoff = COMMAND_HARMONICS * max(highest_harmonic(run) for run in told)
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
    log = _Log(problem, data, settings, weighting)
    load, drives = _parts(problem, effects, chosen)
    given = next((e.shape["T"] for e in drives if "T" in e.given), None)
    names = tuple(LAWS)
    if drives:
        own = {e.name for e in drives}
        names = tuple(name for name, law in LAWS.items() if set(law) == own) or names[-1:]
    progress("choosing the servo law")
    law = find_law(load, data, settings, names, given)
    own_drives = drives or [effect_types()[name](problem.robot) for name in LAWS[law.name]]
    late = given is None and law.delay > 0.0
    progress("balancing the gains")
    shapes = log.shapes(log.balanced((*load, *own_drives), law.delay))
    load = tuple(with_shapes(load, shapes))
    model, least = log.balanced((*load, *own_drives), law.delay), np.inf
    rows, used, motion = data, data, np.zeros(0)
    for k in range(SIMULATIONS if instruments else 1):
        better = log.later(model, rows) if late else model
        if instruments:
            progress(f"simulating the command, pass {k + 1}")
            simulated, apart = log.simulated(better, rows)
            error = float(np.mean(np.log(np.maximum(apart, 1e-300))))
            before, least = least, min(error, least)
            if not error < before + np.log(SAME_MOTION):
                break
            used, rows, motion = rows, simulated, apart
        model = better
        if instruments and error > before - np.log(SAME_MOTION):
            break
    assert model.reference is not None
    scale, factor, error = dict(known) or dict(model.known), 1.0, 0.0
    if motors := constants_of_motors(known, problem.robot):
        factor = factor_of_motors(model, model.reference, data, motors, settings)
    elif known:
        factor = factor_of_known(model, compress(data, model, settings), model.reference, known)
    if loads:
        factor, error = factor_of_loads(model, model.reference, loads, settings)
    if loads or motors:
        scale = {name: factor * x for name, x in model.known.items()}
    details = {
        "law": "as given" if drives else law.name,
        "delay": model.effects[-1].shape["T"],
        "held_out": law.errors,
        "shapes": [s.to_dict() for s in shapes],
        "motion": motion.tolist(),
        "known": scale,
        "scale": words_of_scale(known, loads, model.known),
    }
    return ServoLog(
        replace(model, known=scale, reference=factor * model.reference), used, details, error
    )


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


@dataclass(frozen=True)
class _Log:
    """Measurements without torque, whose models have the scale in which links weigh as stated."""

    problem: Problem
    data: Measurements
    settings: Preprocessing
    weighting: str

    def balanced(self, effects: Sequence[Effect], delay: float) -> Model:
        """The model of a load and drives whose commands act late by ``delay`` [s]: its reference is what
        it fits best, its strongest position gain is given."""
        load = tuple(e for e in effects if e.forward != "drive")
        late = [e.with_shape(T=float(f"{delay:.6g}")) for e in effects if e.forward == "drive"]
        if {"servo_integral", "torque_offset"} & {e.name for e in (*load, *late)} == {"servo_integral"}:
            load = (*load, effect_types()["torque_offset"](self.problem.robot))  # where that began
        model = Model(self.problem.robot, (*load, *late), gains=self.problem.gains)
        theta = balanced(self.problem, model, compress(self.data, model, self.settings))
        strongest = max(model.error_gains, key=lambda k: float(theta[k]))
        name = model.parameters[strongest].name
        return replace(model, known={name: float(theta[strongest])}, reference=theta)

    def shapes(self, model: Model) -> list[ShapeEstimate]:
        """The open shape constants, where all position gains are given: errors stand for a torque."""
        assert model.reference is not None
        gains = {model.parameters[k].name: float(model.reference[k]) for k in model.error_gains}
        free = replace(model, known=gains)
        return estimate_shapes(free, self.data, self.settings, self.weighting, beyond=WIDER_TURNS)

    def later(self, model: Model, rows: Measurements) -> Model:
        """The model with a better delay of its command, by Gauss-Newton steps with links that the joints
        share."""
        for _ in range(DELAY_STEPS):
            assert model.reference is not None
            (drive,) = (e for e in model.effects if e.position_gains)
            wide = with_sensitivities(model, model.reference, lambda e: bool(e.position_gains))
            task = make_task(self.problem, wide, compress(rows, wide, self.settings), self.weighting)
            late = drive.shape["T"] + float(task.ols[-1]) * prior_deviation(drive, "T")
            model = self.balanced(model.effects, float(np.clip(late, 0.0, LATEST)))
        return model

    def simulated(self, model: Model, rows: Measurements) -> tuple[Measurements, Array]:
        """The motion that the model, fitted to the rows, makes of the command, and (n,) how far that is
        from the measured one in root mean square [rad, m]."""
        task = make_task(self.problem, model, compress(rows, model, self.settings), self.weighting)
        theta = model.with_known(make_estimator(DEFAULT_METHOD).fit(task).theta)
        with np.errstate(over="ignore", invalid="ignore"):  # a wrong model may fly away
            made = with_simulated_motion(self.data, model, theta)
            return made, np.sqrt(np.mean((made.commanded["qsim"] - made.q) ** 2, axis=0))
