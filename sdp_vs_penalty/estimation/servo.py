"""A log without torque: what its servos' law, its gains and a known scale make of it.

The laws are effects, linear in their gains: 0 = Y theta - kp e + kd dq ...,
homogeneous, so that motion shows everything up to one factor, which a known parameter
sets in the end (known_load.py). Before that come the law, the ratios of the gains, the
delay, and the motion that the law makes of the command alone, attached as instruments
(regression/instruments.py) to one convex problem.

The law and the delay T of its command come from each joint's own equation, divided by
its gain: e = q_cmd(t - T) - q = (load + damping + ...) / kp holds no scale, every
coefficient is free, and what least squares leave is in rad. The terms of all laws, and
the command's derivatives (Taylor's series in T about the last T), are compressed
together: each law at each delay is a small problem.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count
from typing import Any

import numpy as np
import scipy

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects import effect_types
from sdp_vs_penalty.effects.effect import Block, Effect, Motion, Parameter
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.effects.servo import LATEST
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation import constants as c
from sdp_vs_penalty.estimation.drive_torque import with_simulated_motion
from sdp_vs_penalty.estimation.known_load import fit_up_to_scale
from sdp_vs_penalty.estimation.sensitivity import prior_deviation, with_sensitivities
from sdp_vs_penalty.estimation.shapes import estimate_shapes, with_shapes
from sdp_vs_penalty.estimators import DEFAULT_METHOD, make_estimator
from sdp_vs_penalty.estimators.estimator import Progress, Task, make_task
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.linalg import column_space, deviations, min_norm_lstsq
from sdp_vs_penalty.regression.regression import Regression, compress, compress_cells
from sdp_vs_penalty.robot.arrays import Array, at_least_tiny
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.signals.filtered import FilteredRuns
from sdp_vs_penalty.signals.phases import phase_folds
from sdp_vs_penalty.signals.preprocessing import Preprocessing
from sdp_vs_penalty.signals.spectrum import highest_harmonic

#: The laws, those with fewer gains first, and their effects.
LAWS = {
    name + more: effects + also
    for name, effects in (
        ("PD", ("servo_position",)),
        ("PID", ("servo_position", "servo_integral")),
        ("cascade", ("servo_position", "servo_integral", "servo_velocity_loop")),
    )
    for more, also in (("", ()), (" with feed-forward", ("servo_feedforward",)))
}


class _Terms(Effect):
    """Of each joint what the laws are made of: the command, its two derivatives and its
    integral at t - T, and position, velocity and integral."""

    name = "servo_terms"
    count = 7
    equation = explanation = reference = ""

    def __init__(self, robot: Robot, T: float) -> None:
        super().__init__(robot)
        self.T = T

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        names = [
            (f"term{m}_{j}", j + 1) for j in self.joints for m in range(self.count)
        ]
        return tuple(
            Parameter(
                name,
                "",
                self.name,
                joint,
            )
            for name, joint in names
        )

    def blocks(self, motion: Motion) -> list[Block]:
        command = motion.logged_command
        t = motion.t - self.T
        rate = command.velocity(t)
        terms = (
            command.position(t),
            rate,
            np.gradient(rate, motion.t, axis=0),
            command.integral(t),
        )
        columns = np.stack([*terms, motion.q, motion.dq, motion.integral], axis=2)
        indices = np.arange(self.count)
        return [
            Block(
                j,
                indices + self.count * j,
                columns[:, j],
            )
            for j in self.joints
        ]


def _law(name: str, d: float) -> Array:
    """(7, 1 + m) the error e, and the m terms that it is made of, in the columns of
    _Terms, of a command that is d [s] later than those."""
    h = 0.5 * d * d
    terms = [
        [1.0, -d, h, 0.0, -1.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0],
    ]
    gains = {
        "servo_integral": [-d, h, 0.0, 1.0, 0.0, 0.0, -1.0],
        "servo_velocity_loop": [0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0],
        "servo_feedforward": [0.0, 1.0, -d, 0.0, 0.0, 0.0, 0.0],
    }
    return np.array([*terms, *(gains[e] for e in LAWS[name] if e in gains)]).T


#: One joint's terms beside its load, compressed: (r, 7) of all rows, and of each fold
#: what training says, those trained on and those tested.
_Joint = tuple[Array, list[tuple[Array, Array]]]


def find_law(
    load: Sequence[Effect],
    runs: FilteredRuns,
    names: Sequence[str],
    delay: float | None,
) -> tuple[str, float, dict[str, float]]:
    """A servo's law, and its delay.

    Of the laws whose held-out error is within one standard error of the least, by
    folds, or within what a law of friction gets wrong, the one with the fewest gains.
    Friction may turn over several velocities meanwhile.

    Parameters
    ----------
    load : sequence of Effect
        What the drives work against.
    runs : FilteredRuns
        Without torque.
    names : sequence of str
        The laws to choose from.
    delay : float or None
        Where it is known [s]. Else it is as small as none unless without it much more
        is left of motion left out.

    Returns
    -------
    str
        The law.
    float
        Its delay [s].
    dict of str to float
        Held-out error of each law over that of the best.
    """
    wide: list[Effect] = []
    for e in load:
        free = "v_s" in e.shapes and "v_s" not in e.given
        wide += [e.with_shape(v_s=v) for v in c.TURNS] if free else [e]
    if not any(e.name == "torque_offset" for e in load):
        wide.append(effect_types()["torque_offset"](load[0].robot))
    about = delay or 0.0
    first = _joints(wide, runs, about)
    joints = first
    while True:
        extra = dict.fromkeys(names, 0.0)
        if delay is None:
            extra = {name: _extra_delay(joints, name, about) for name in names}
        scores = {name: _score(joints, name, extra[name]) for name in names}
        name, best = _fewest_gains(scores)
        total = about + extra[name]
        if abs(extra[name]) < 0.95 * c.DELAY_REACH or total > 0.95 * LATEST:
            break
        about = total
        joints = _joints(wide, runs, about)
    if delay is None:
        without = float(np.mean(_score(first, name, 0.0) - scores[name]))
        total = total if without > np.log(c.FEWER_GAINS) else 0.0
    ratios = {
        k: float(np.exp(0.5 * np.mean(score - scores[best])))
        for k, score in scores.items()
    }
    return name, total, ratios


def _fewest_gains(scores: Mapping[str, Array]) -> tuple[str, str]:
    """Of laws in the order of their gains the first that is as good as the best, and
    the best; scores : logarithms of held-out errors, by law."""
    best = min(scores, key=lambda name: float(scores[name].mean()))
    for name, score in scores.items():
        more = score - scores[best]
        standard_error = more.std(ddof=1) / np.sqrt(len(more))
        if more.mean() <= max(2.0 * np.log(c.FEWER_GAINS), standard_error):
            return name, best
    return best, best


def _joints(
    load: Sequence[Effect],
    runs: FilteredRuns,
    T: float,
) -> list[_Joint]:
    """Of each joint, about a delay T."""
    robot = load[0].robot
    model = Model(
        robot,
        (*load, _Terms(robot, T)),
        allow_duplicates=True,
    )
    split = phase_folds(runs.measurements, runs.settings, c.SHAPE_FOLDS)
    cells = compress_cells(runs, model, split)
    out = []
    for joint in range(robot.n):
        of_block = {
            f.block: f.triangle[:, :-1] for f in cells.factors if f.joint == joint
        }
        folds = []
        for fold in range(c.SHAPE_FOLDS):
            train = [of_block[b] for b in split.training(fold) if b in of_block]
            test = [of_block[b] for b in split.tested(fold) if b in of_block]
            if train and test:
                folds.append(_project_out_load(np.vstack(train), np.vstack(test)))
        rows = np.vstack(list(of_block.values()))
        out.append((_project_out_load(rows, rows)[0], folds))
    return out


def _project_out_load(train: Array, test: Array) -> tuple[Array, Array]:
    """(r, 7), (s, 7) terms beside the load of rows (r, k + 7), (s, k + 7), by the first
    ones' fit."""
    U, V = column_space(train[:, : -_Terms.count])
    projections = U.T @ train[:, -_Terms.count :]
    remaining = np.asarray(
        np.linalg.qr(train[:, -_Terms.count :] - U @ projections, mode="r")
    )
    return remaining, test[:, -_Terms.count :] - test[:, : -_Terms.count] @ (
        V @ projections
    )


def _fitted(terms: Array, law: Array) -> Array:
    """(7,) the error and what least squares make of it, in the columns of the terms (r,
    7)."""
    return np.asarray(
        law[:, 0]
        - law[:, 1:] @ np.linalg.lstsq(terms @ law[:, 1:], terms @ law[:, 0])[0]
    )


def _extra_delay(
    joints: Sequence[_Joint],
    name: str,
    about: float,
) -> float:
    """The delay [s] of a law beyond that of the terms with which least remains of all
    joints."""

    def left(later: float) -> float:
        law = _law(name, later)
        losses = [np.sum((rows @ _fitted(rows, law)) ** 2) for rows, _ in joints]
        return float(np.sum(np.log(at_least_tiny(losses))))

    ends = max(-c.DELAY_REACH, -about), min(c.DELAY_REACH, LATEST - about)
    return float(scipy.optimize.minimize_scalar(left, bounds=ends, method="bounded").x)


def _score(
    joints: Sequence[_Joint],
    name: str,
    delay: float,
) -> Array:
    """(folds,) mean over the joints of ln of the squared held-out error."""
    law = _law(name, delay)
    left = [
        [np.sum((test @ _fitted(train, law)) ** 2) for train, test in folds]
        for _, folds in joints
    ]
    return np.asarray(np.mean(np.log(at_least_tiny(left)), axis=0))


def servo_filters(settings: Preprocessing, data: Measurements) -> Preprocessing:
    """Filters for a log without torque, resolved. Noise of positions is in every column
    there: the states' cut-off begins where the command, free of noise, says how fast
    the motion is, and rises as far as the positions show a sharper one.

    Parameters
    ----------
    settings : Preprocessing
        As a user or a problem gives them.
    data : Measurements
        Without torque.

    Returns
    -------
    Preprocessing
        For such a log.
    """
    lowest_cutoff = None
    if settings.state_cutoff is None and "qcmd" in data.groups:
        commanded_runs = [replace(run, q=run.commanded["qcmd"]) for run in data.runs()]
        lowest_cutoff = c.COMMAND_HARMONICS * max(
            highest_harmonic(run) for run in commanded_runs
        )
    return settings.resolve(data, lowest_cutoff)


@dataclass(frozen=True)
class _Loop:
    """A log without torque and what its model is made of: the load's effects and the
    drives', and whether their delay is open."""

    problem: Problem
    runs: FilteredRuns
    weighting: str
    load: tuple[Effect, ...]
    drives: Sequence[Effect]
    open_delay: bool

    def fitted_at_delay(self, delay: float) -> tuple[Model, Array]:
        """The model whose commands act late by ``delay`` [s], up to a factor, in which
        links weigh as stated, and what it fits best (p,), its reference; its strongest
        position gain is given."""
        robot = self.problem.robot
        delayed_drives = [e.with_shape(T=float(f"{delay:.6g}")) for e in self.drives]
        began = {"servo_integral", "torque_offset"} & {
            e.name for e in (*self.load, *delayed_drives)
        }
        offset = [effect_types()["torque_offset"](robot)] * (
            began == {"servo_integral"}
        )
        model = Model(
            robot,
            (*self.load, *offset, *delayed_drives),
            gains=self.problem.gains,
        )
        theta = fit_up_to_scale(self.problem, model, compress(self.runs, model))
        strongest = max(model.error_gains, key=lambda k: float(theta[k]))
        gain = {model.parameters[strongest].name: float(theta[strongest])}
        return replace(model, known=gain, reference=theta), theta

    def task(self, model: Model, rows: FilteredRuns) -> Task:
        """The problem of a balanced model; rows : the log, with instruments where there
        are some."""
        return make_task(
            self.problem,
            model,
            compress(rows, model),
            self.weighting,
        )

    def with_better_delay(self, model: Model, rows: FilteredRuns) -> Model:
        """A step of Gauss and Newton of the delay, in which joints share their links,
        if it is open."""
        if not self.open_delay:
            return model
        assert model.reference is not None
        wide = with_sensitivities(
            model,
            model.reference,
            lambda e: bool(e.position_gains),
        )
        drive = next(e for e in model.effects if e.position_gains)
        step = float(self.task(wide, rows).ols[-1]) * prior_deviation(drive, "T")
        return self.fitted_at_delay(
            float(np.clip(drive.shape["T"] + step, 0.0, LATEST))
        )[0]

    def simulated(
        self,
        model: Model,
        rows: FilteredRuns,
    ) -> tuple[FilteredRuns, Array]:
        """The log with the motion that the model fitted to ``rows`` makes of the
        command, and how far (n,) that is from the measured one, root mean square [rad,
        m]."""
        theta = model.with_known(
            make_estimator(DEFAULT_METHOD).fit(self.task(model, rows)).theta
        )
        with np.errstate(over="ignore", invalid="ignore"):  # a wrong model may fly away
            measurements = with_simulated_motion(self.runs.measurements, model, theta)
            apart = np.sqrt(
                np.mean((measurements.commanded["qsim"] - measurements.q) ** 2, axis=0)
            )
        return FilteredRuns.of(measurements, self.runs.settings), apart


def servo_log(
    problem: Problem,
    effects: Sequence[Effect],
    runs: FilteredRuns,
    weighting: str,
    progress: Progress,
    *,
    instruments: bool,
    chosen: bool,
) -> tuple[Model, FilteredRuns, dict[str, Any]]:
    """What stands for the torque in a log without one.

    Where servo effects are among the model's, the law is given, with its delay where
    that is. known_load.py sets the scale.

    Parameters
    ----------
    problem : Problem
        To identify.
    effects : sequence of Effect
        The model's.
    runs : FilteredRuns
        Without torque.
    weighting : {"noise", "none"}
        Of the joints' rows.
    progress : callable
        Hears where the computation stands.
    instruments : bool
        Whether columns are made of a simulated motion.
    chosen : bool
        Whether the effects were asked for; if not, rotors turn with the joints as well.

    Returns
    -------
    Model
        With the law's effects, up to a factor.
    FilteredRuns
        With the motion that the law makes of the command, where instruments are wanted.
    dict
        Plain JSON.

    Raises
    ------
    InputError
        For a log without commands.
    """
    if "qcmd" not in runs.measurements.groups:
        what = "this log holds neither torque nor commands"
        raise InputError(
            what,
            "log tau1..taun or qcmd1..qcmdn",
            runs.measurements.names[0],
        )
    drives = [e for e in effects if e.forward == "drive"]
    load = _load_of(problem, effects, has_law=bool(drives), chosen=chosen)
    given_delay = _given_delay(drives)
    names = _laws_of(drives) if drives else tuple(LAWS)
    progress("choosing the servo law")
    law, delay, errors = find_law(load, runs, names, given_delay)
    progress("balancing the gains")
    of_law = drives or [effect_types()[name](problem.robot) for name in LAWS[law]]
    moves_delay = given_delay is None and delay > 0.0
    loop = _Loop(problem, runs, weighting, tuple(load), of_law, moves_delay)
    # The load's shape constants beside given gains: errors stand for a torque then.
    model, theta = loop.fitted_at_delay(delay)
    gains = {model.parameters[k].name: float(theta[k]) for k in model.error_gains}
    shapes = estimate_shapes(
        replace(model, known=gains),
        runs,
        weighting,
        widest=c.TURNS[-1],
    )
    loop = replace(loop, load=with_shapes(load, shapes))
    model, _ = loop.fitted_at_delay(delay)
    model, rows, apart = _refined(loop, model, instruments, progress)
    details = {
        "law": "as given" if drives else law,
        "delay": model.effects[-1].shape["T"],
        "held_out": errors,
        "shapes": [s.to_dict() for s in shapes],
        "motion": apart.tolist(),
    }
    return model, rows, details


def _load_of(
    problem: Problem,
    effects: Sequence[Effect],
    *,
    has_law: bool,
    chosen: bool,
) -> list[Effect]:
    """The effects that drives work against; chosen : whether somebody asked for them."""
    load = [e for e in effects if e.forward != "drive"]
    if not has_law:  # kd and viscous friction have one column: kd is their sum
        load = [e for e in load if e.name != "viscous_friction"]
    has_rotors = any(e.name == "rotor_inertia" for e in load)
    # A drive has a rotor. A single joint's cannot be told from what it moves.
    if not chosen and not has_rotors and problem.robot.n > 1:
        load.append(effect_types()["rotor_inertia"](problem.robot))
    return load


def _given_delay(drives: Sequence[Effect]) -> float | None:
    """The delay [s] that somebody gave a law's effects."""
    return next((e.shape["T"] for e in drives if "T" in e.given), None)


def _laws_of(drives: Sequence[Effect]) -> tuple[str, ...]:
    """The laws that have just these effects, else the last one."""
    drive_names = {e.name for e in drives}
    same = tuple(name for name, law in LAWS.items() if set(law) == drive_names)
    return same or tuple(LAWS)[-1:]


def _refined(
    loop: _Loop,
    model: Model,
    instruments: bool,
    progress: Progress,
) -> tuple[Model, FilteredRuns, Array]:
    """The model after as many passes as bring its simulation much nearer to the
    measured motion, the log with the instruments that it was fitted with, and how far
    (n,) they are from the motion; without instruments after one step of the delay, and
    (0,)."""
    lowest_loss = np.inf
    used = loop.runs
    rows = loop.runs
    motion = np.zeros(0)
    if not instruments:
        return loop.with_better_delay(model, rows), rows, motion
    for k in count(1):
        better = loop.with_better_delay(model, rows)
        progress(f"simulating the command, pass {k}")
        simulated, apart = loop.simulated(better, rows)
        error = float(np.mean(np.log(at_least_tiny(apart))))
        if not error < lowest_loss + np.log(c.FEWER_GAINS):
            break
        model = better
        used = rows
        rows = simulated
        motion = apart
        if error > lowest_loss - np.log(c.FEWER_GAINS):
            break
        lowest_loss = error
    return model, used, motion


def loop_beside_torque(
    drives: Sequence[Effect],
    data: Measurements,
    settings: Preprocessing,
) -> dict[str, Any]:
    """What a servo's law makes of the torque that was logged: whether the loop is what
    its makers say.

    drives : the law's effects. Least squares of the torque in their columns alone,
    joint by joint, beside a constant (an integral may begin anywhere); a delay that is
    not given is the best one. Returns plain JSON: gains with standard deviation and
    unit by name, the delay [s], and the share of each joint's torque that the law
    makes. Raises InputError for a log without commands.
    """
    if "qcmd" not in data.groups:
        raise InputError(
            "a servo's law needs the command",
            "log qcmd1..qcmdn",
            data.names[0],
        )
    robot = drives[0].robot
    turned = replace(data, tau=-data.tau)  # a drive's torque counts negative
    offset = effect_types()["torque_offset"](robot)
    runs = FilteredRuns.of(turned, settings)

    def fitted(delay: float) -> tuple[Model, Regression, Array]:
        model = Model(robot, (*(e.with_shape(T=delay) for e in drives), offset))
        rows = compress(runs, model)
        both = rows.least_squares()
        return model, rows, min_norm_lstsq(both.R, both.rho)

    def left(delay: float) -> float:
        _, rows, theta = fitted(delay)
        return float(np.sum(np.log(at_least_tiny(rows.joint_losses(theta)))))

    given_delay = _given_delay(drives)
    if given_delay is None:
        given_delay = float(
            scipy.optimize.minimize_scalar(
                left,
                bounds=(0.0, LATEST),
                method="bounded",
            ).x
        )
        given_delay = given_delay if left(given_delay) < left(0.0) else 0.0
    model, rows, theta = fitted(given_delay)
    losses = rows.joint_losses(theta)
    problem_of_all = rows.least_squares()
    unexplained = np.where(
        model.drives,
        0.0,
        min_norm_lstsq(
            np.where(model.drives, 0.0, problem_of_all.R), problem_of_all.rho
        ),
    )
    noise = np.sqrt(rows.oversampling * losses / np.maximum(rows.joint_rows(), 1))
    std = deviations(problem_of_all.R)
    return {
        "delay": given_delay,
        "gains": {
            p.name: {
                "value": float(x),
                "std": float(s * noise[p.joint - 1]),
                "unit": p.unit,
            }
            for p, x, s, drive in zip(
                model.parameters,
                theta,
                std,
                model.drives,
                strict=True,
            )
            if drive
        },
        "share": (
            1.0 - losses / at_least_tiny(rows.joint_losses(unexplained))
        ).tolist(),
    }
