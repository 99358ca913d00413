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
from typing import Any, NamedTuple

import numpy as np
import scipy

from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects import standard_effect
from sdp_vs_penalty.effects.effect import Block, Effect, Motion, Parameter
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.effects.servo import LATEST, LAWS, law_of_terms
from sdp_vs_penalty.effects.velocity_friction import LEAD, lead_of_friction
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation import constants as c
from sdp_vs_penalty.estimation.drive_torque import with_simulated_motion
from sdp_vs_penalty.estimation.known_load import fit_up_to_scale
from sdp_vs_penalty.estimation.model_file import LoopFields, LoopGain
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
from sdp_vs_penalty.signals.phases import PhaseFolds, phase_folds
from sdp_vs_penalty.signals.preprocessing import Preprocessing
from sdp_vs_penalty.signals.runs import sample_rate
from sdp_vs_penalty.signals.spectrum import highest_harmonic, least_error_cutoff


class _Terms(Effect):
    """Of each joint what the laws are made of: the command, its two derivatives and its
    integral at t - T, and position, velocity and integral."""

    name = "servo_terms"
    count = 7
    equation = explanation = reference = ""

    def __init__(self, robot: Robot, T: float) -> None:
        """Take the robot and the delay T [s] of the command."""
        super().__init__(robot)
        self.T = T

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """Return seven parameters a joint, for example term0_2: term 0 of joint 2 (from
        0)."""
        return tuple(
            Parameter(f"term{term}_{joint}", unit="", effect=self.name, joint=joint + 1)
            for joint in self.joints
            for term in range(self.count)
        )

    def blocks(self, motion: Motion) -> list[Block]:
        """Return the columns of the terms from which every servo law is built.

        Each joint has (N, 7): the command, its first and second derivative and its
        integral at t - T; then position, velocity and integral of the position, as
        measured.
        """
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
        return [Block(j, indices + self.count * j, columns[:, j]) for j in self.joints]


class _JointTerms(NamedTuple):
    """One joint's servo terms, of which the load's columns explain nothing."""

    #: (r, 7) terms of all rows, compressed.
    terms: Array
    #: For each fold of the motion the terms that are trained on and those that are
    #: tested, (r, 7) and (s, 7); the load's coefficients are those of training.
    folds: list[tuple[Array, Array]]


@dataclass(frozen=True)
class ServoLaw:
    """A servo's law as chosen from a log."""

    #: Name of the law, a key of LAWS.
    name: str
    #: Delay of the command [s].
    delay: float
    #: Whether dry friction turns round before or after the velocity does.
    has_lead: bool
    #: Error of each law on motion left out, over that of the best law [-].
    held_out: dict[str, float]


def find_law(
    load: Sequence[Effect],
    runs: FilteredRuns,
    names: Sequence[str],
    delay: float | None,
) -> ServoLaw:
    """Choose a servo's law and its delay from a log without torque.

    Among the laws whose held-out error is within one standard error of the smallest (or
    within what a wrong law of friction causes), the one with the fewest gains is
    chosen. The delay is found by steps: Taylor's series of the command reaches
    DELAY_REACH, so that terms are compressed again about a delay that lies beyond. A
    delay that lowers the held-out error too little is zero. Laws are compared with a
    lead of the dry friction in the load: without it, a feed-forward or a delay would
    stand for the lead.

    Parameters
    ----------
    load : sequence of Effect
        Effects against which the drives work. Coulomb friction gets columns for several
        velocities over which its sign changes, and one for its lead.
    names : sequence of str
        Laws to choose from, keys of LAWS, those with fewer gains first.
    delay : float or None
        Delay of the command [s] where it is known; None: estimate it.

    Returns
    -------
    ServoLaw
        The law, its delay, and the held-out errors.
    """
    wide_load = _with_several_turns(load)
    split = phase_folds(runs.measurements, runs.settings, c.SHAPE_FOLDS)
    delay_of_terms = delay or 0.0  # [s]; each law adds its extra delay
    cells = _cells(wide_load, runs, split, delay_of_terms)
    terms = _loadless_terms(cells, split)
    first_terms = terms
    while True:
        extra = dict.fromkeys(names, 0.0)
        if delay is None:
            extra = {name: _extra_delay(terms, name, delay_of_terms) for name in names}
        scores = {name: _held_out_score(terms, name, extra[name]) for name in names}
        chosen, best = _fewest_gains(scores)
        total_delay = delay_of_terms + extra[chosen]
        # The end of the series' reach (5 % off): the delay may lie beyond.
        is_inside = abs(extra[chosen]) < 0.95 * c.DELAY_REACH
        if is_inside or total_delay > 0.95 * LATEST:
            break
        delay_of_terms = total_delay
        cells = _cells(wide_load, runs, split, delay_of_terms)
        terms = _loadless_terms(cells, split)
    if delay is None:
        without_delay = _held_out_score(first_terms, chosen, 0.0)
        rise = float(np.mean(without_delay - scores[chosen]))
        if rise <= np.log(c.FEWER_GAINS):
            total_delay = 0.0
    # Scores are logarithms of squares: half of a difference is that of the errors.
    error_ratios = {
        name: float(np.exp(0.5 * np.mean(score - scores[best])))
        for name, score in scores.items()
    }
    has_lead = _has_lead(
        cells,
        split,
        law=chosen,
        score=scores[chosen],
        delay_of_terms=delay_of_terms,
        is_delay_open=delay is None,
    )
    return ServoLaw(chosen, total_delay, has_lead, error_ratios)


def _has_lead(
    cells: Regression,
    split: PhaseFolds,
    *,
    law: str,
    score: Array,
    delay_of_terms: float,
    is_delay_open: bool,
) -> bool:
    """Decide whether the dry friction turns round before or after the velocity does.

    It does where the lead's columns lower the law's held-out error by more than LEAD,
    and by more than two standard errors.

    Parameters
    ----------
    law : str
        Name of the law.
    score : (folds,) array
        The law's held-out score with the lead's columns (:func:`_held_out_score`).
    delay_of_terms : float
        Delay of the command in the compressed terms [s].
    is_delay_open : bool
        Whether the delay is found anew without the lead's columns.
    """
    is_lead = np.array([p.effect == LEAD for p in cells.parameters])
    if not is_lead.any():
        return False
    terms = _loadless_terms(cells.keeping(~is_lead), split)
    extra = _extra_delay(terms, law, delay_of_terms) if is_delay_open else 0.0
    rise = _held_out_score(terms, law, extra) - score
    standard_error = float(rise.std(ddof=1)) / np.sqrt(len(rise))
    return float(rise.mean()) > max(2.0 * np.log(c.LEAD), 2.0 * standard_error)


def _with_several_turns(load: Sequence[Effect]) -> list[Effect]:
    """Return the load with friction at several velocities v_s of its change of sign.

    These are TURNS [rad/s, m/s], for effects whose v_s the user did not give. A
    constant torque is added if the load has none.
    """
    effects: list[Effect] = []
    for effect in load:
        is_open = "v_s" in effect.shapes and "v_s" not in effect.given
        if is_open:
            effects += [effect.with_shape(v_s=v) for v in c.TURNS]
        else:
            effects.append(effect)
    if not any(effect.simulator_field == "offset" for effect in load):
        effects.append(standard_effect("offset")(load[0].robot))
    lead = lead_of_friction(effects)
    return effects if lead is None else [*effects, lead]


def _fewest_gains(scores: Mapping[str, Array]) -> tuple[str, str]:
    """Return the first law that is as good as the best one, and the best one.

    ``scores`` holds for each law, in the order of their gains, the logarithm of its
    squared held-out error on each fold (folds,).
    """
    best = min(scores, key=lambda name: float(scores[name].mean()))
    for name, score in scores.items():
        rise = score - scores[best]
        standard_error = rise.std(ddof=1) / np.sqrt(len(rise))
        # Scores are of squared errors, FEWER_GAINS of errors: hence the factor 2.
        if rise.mean() <= max(2.0 * np.log(c.FEWER_GAINS), standard_error):
            return name, best
    return best, best


def _cells(
    load: Sequence[Effect], runs: FilteredRuns, split: PhaseFolds, T: float
) -> Regression:
    """Compress the load and the servo terms, delayed by T [s], by joint and fold.

    The load's columns are the first ones, the seven terms of each joint the last.
    Blocks are the parts of the motion from which the folds are made.
    """
    robot = load[0].robot
    model = Model(robot, (*load, _Terms(robot, T)), allow_duplicates=True)
    return compress_cells(runs, model, split)


def _loadless_terms(cells: Regression, split: PhaseFolds) -> list[_JointTerms]:
    """Project the load out of each joint's servo terms.

    A servo's law relates its seven terms (command, position, their derivatives and
    integrals) and the load's torque. Least squares removes the load's columns, so that
    laws can be compared by the terms alone.
    """
    terms_of_joints = []
    for joint in range(cells.joints):
        # Rows (r, k + 7) of each block: k columns of the load, 7 terms; the torque (the
        # last column) is zero in such a log.
        rows_of_block = {
            f.block: f.triangle[:, :-1] for f in cells.factors if f.joint == joint
        }
        folds = []
        for fold in range(c.SHAPE_FOLDS):
            blocks_of_training = split.training(fold)
            blocks_of_test = split.tested(fold)
            train = [rows_of_block[b] for b in blocks_of_training if b in rows_of_block]
            test = [rows_of_block[b] for b in blocks_of_test if b in rows_of_block]
            if train and test:
                folds.append(_project_out_load(np.vstack(train), np.vstack(test)))
        all_rows = np.vstack(list(rows_of_block.values()))
        all_terms, _ = _project_out_load(all_rows, all_rows)
        terms_of_joints.append(_JointTerms(all_terms, folds))
    return terms_of_joints


def _project_out_load(train: Array, test: Array) -> tuple[Array, Array]:
    """Remove the load from the terms of training and test rows.

    The rows (r, k + 7) and (s, k + 7) hold k columns of the load and 7 terms. The
    load's coefficients are fitted to the training rows. Returns (r, 7) and (s, 7).
    """
    train_load, train_terms = np.hsplit(train, [-_Terms.count])
    test_load, test_terms = np.hsplit(test, [-_Terms.count])
    U, V = column_space(train_load)
    projections = U.T @ train_terms
    remaining_terms = np.linalg.qr(train_terms - U @ projections, mode="r")
    return np.asarray(remaining_terms), test_terms - test_load @ (V @ projections)


def _residual_combination(terms: Array, law: Array) -> Array:
    """Return (7,) c for which terms (r, 7) times c is the residual of the law's fit.

    A law (7, 1 + m) has the control error as column 0. Its fit explains that error by
    the law's other m columns, by least squares.
    """
    columns = terms @ law[:, 1:]
    error = terms @ law[:, 0]
    gains = np.linalg.lstsq(columns, error)[0]
    return law[:, 0] - law[:, 1:] @ gains


def _extra_delay(
    joints: Sequence[_JointTerms], name: str, delay_of_terms: float
) -> float:
    """Return the delay [s], beyond that of the terms, with the smallest residual of a
    law.

    The result lies within the reach of Taylor's series of the command, and the sum of
    both delays between 0 and LATEST. ``name`` is the law's.
    """

    def log_residual(delay: float) -> float:
        """Return the sum over joints of the logarithm of the squared residual."""
        law = law_of_terms(name, delay)
        losses = [
            np.sum((joint.terms @ _residual_combination(joint.terms, law)) ** 2)
            for joint in joints
        ]
        return float(np.sum(np.log(at_least_tiny(losses))))

    smallest = max(-c.DELAY_REACH, -delay_of_terms)
    largest = min(c.DELAY_REACH, LATEST - delay_of_terms)
    minimum = scipy.optimize.minimize_scalar(
        log_residual, bounds=(smallest, largest), method="bounded"
    )
    return float(minimum.x)


def _held_out_score(joints: Sequence[_JointTerms], name: str, delay: float) -> Array:
    """Return (folds,) the logarithm of a law's squared held-out error, mean over
    joints.

    The law is fitted to the training terms of each fold and judged on its test terms.
    ``delay`` [s] counts from the delay of the terms.
    """
    law = law_of_terms(name, delay)
    squared_errors = [
        [
            np.sum((test @ _residual_combination(train, law)) ** 2)
            for train, test in joint.folds
        ]
        for joint in joints
    ]
    return np.mean(np.log(at_least_tiny(squared_errors)), axis=0)


def servo_filters(settings: Preprocessing, data: Measurements) -> Preprocessing:
    """Return the filter settings for a log without torque, resolved.

    The noise of the positions is in every column of such a log. The states' cut-off is
    at least COMMAND_HARMONICS times the highest harmonic of the command, which has no
    noise.

    Parameters
    ----------
    settings : Preprocessing
        Settings of the user or the problem.

    Returns
    -------
    Preprocessing
        Settings with all cut-off frequencies.
    """
    if settings.state_cutoff is None and "qcmd" in data.groups:
        commanded_runs = [replace(run, q=run.commanded["qcmd"]) for run in data.runs()]
        harmonic = max(highest_harmonic(run) for run in commanded_runs)
        lowest = c.COMMAND_HARMONICS * harmonic
        torque = settings.torque_cutoff or 1.6 * lowest
        runs = list(data.runs())
        highest = min(sample_rate(run) for run in runs) / 10.0
        state = least_error_cutoff(runs, min(lowest, highest), torque, highest)
        settings = replace(settings, state_cutoff=state, torque_cutoff=torque)
    return settings.resolve(data)


@dataclass(frozen=True)
class _Loop:
    """A log without torque, and what its model is made of."""

    #: Robot, bounds and nominal links.
    problem: Problem
    #: The filtered log.
    runs: FilteredRuns
    #: Weight of the joints' rows: "noise" or "none".
    weighting: str
    #: Effects against which the drives work.
    load: tuple[Effect, ...]
    #: Effects of the servos' law.
    drives: Sequence[Effect]
    #: Whether the drives' delay is open, to be fitted.
    open_delay: bool

    def fitted_at_delay(self, delay: float) -> tuple[Model, Array]:
        """Fit load and drives for a command that acts after ``delay`` [s].

        Motion determines all parameters up to a common factor, which is set so that the
        links weigh what the problem states. Returns the model, whose strongest position
        gain is fixed at its fitted value, and theta (p,).
        """
        robot = self.problem.robot
        delayed_drives = [e.with_shape(T=float(f"{delay:.6g}")) for e in self.drives]
        has_offset = any(e.simulator_field == "offset" for e in self.load)
        # A servo's integral may begin anywhere: beside a constant.
        begins_anywhere = any(drive.has_constant_part for drive in delayed_drives)
        offset: list[Effect] = []
        if begins_anywhere and not has_offset:
            offset = [standard_effect("offset")(robot)]
        model = Model(
            robot, (*self.load, *offset, *delayed_drives), gains=self.problem.gains
        )
        theta = fit_up_to_scale(self.problem, model, compress(self.runs, model))
        strongest = max(model.error_gains, key=lambda k: float(theta[k]))
        gain = {model.parameters[strongest].name: float(theta[strongest])}
        # Equal bounds hold at any scale.
        known = gain | (dict(self.problem.known) if len(model.rigid_indices) else {})
        return replace(model, known=known, reference=theta), theta

    def task(self, model: Model, rows: FilteredRuns) -> Task:
        """Build the optimisation problem of a model whose scale is fixed.

        ``rows`` is the log, with instruments (a simulated motion) where there are some.
        """
        return make_task(
            self.problem,
            model,
            regression=compress(rows, model),
            weighting=self.weighting,
        )

    def with_better_delay(self, model: Model, rows: FilteredRuns) -> Model:
        """Return the model after one Gauss-Newton step of the delay; the same if it is
        fixed.

        Here joints share the parameters of their links, unlike in find_law.
        """
        if not self.open_delay:
            return model
        assert model.reference is not None
        # One more parameter, the last: the delay, in units of its prior deviation.
        wide = with_sensitivities(
            model, model.reference, lambda e: e.simulator_field == "servo"
        )
        drive = next(e for e in model.effects if e.simulator_field == "servo")
        step = float(self.task(wide, rows).ols[-1]) * prior_deviation(drive, "T")
        delay = float(np.clip(drive.shape["T"] + step, 0.0, LATEST))
        better, _ = self.fitted_at_delay(delay)
        return better

    def simulated(self, model: Model, rows: FilteredRuns) -> tuple[FilteredRuns, Array]:
        """Attach the motion that the model makes of the command, as instruments.

        The model's parameters are fitted to ``rows``. Returns the log with the
        simulated motion, and (n,) the root mean square difference of simulated and
        measured positions [rad, m].
        """
        fit = make_estimator(DEFAULT_METHOD).fit(self.task(model, rows))
        theta = model.with_known(fit.theta)
        # A wrong model may fly away: infinities are no fault.
        with np.errstate(over="ignore", invalid="ignore"):
            measurements = with_simulated_motion(self.runs.measurements, model, theta)
            difference = measurements.commanded["qsim"] - measurements.q
            distance = np.sqrt(np.mean(difference**2, axis=0))
        return FilteredRuns.filtering(measurements, self.runs.settings), distance


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
    """Identify the servos of a log without torque, up to a common scale of all
    parameters.

    The servos' law then stands for the torque. If the model has servo effects, the law
    is given, and so is its delay if the effects state one. known_load.py sets the
    scale.

    Parameters
    ----------
    problem : Problem
        Robot, bounds and nominal links.
    weighting : {"noise", "none"}
        Weight the joints' rows by their noise, or equally.
    progress : callable
        Receives a line of text at each stage.
    instruments : bool
        Whether regressor columns are computed on a simulated motion, free of noise.
    chosen : bool
        Whether the user chose the effects; if not, rotor inertia is added.

    Returns
    -------
    Model
        With the effects of the law, up to a factor.
    FilteredRuns
        With the simulated motion where instruments are used.
    dict
        Joints with a limited drive, law, delay [s], held-out errors, shape constants,
        distance of the simulated motion.

    Raises
    ------
    InputError
        For a log without commands.
    """
    if "qcmd" not in runs.measurements.groups:
        what = "this log holds neither torque nor commands"
        raise InputError(
            what, "log tau1..taun or qcmd1..qcmdn", runs.measurements.names[0]
        )
    # 1. What the drives move, and by which law.
    drives = [e for e in effects if e.forward == "drive"]
    load = _load_of(problem, effects, has_law=bool(drives), chosen=chosen)
    if not load:
        moved = (standard_effect(field).name for field in ("links", "friction"))
        raise InputError(
            f"effects {', '.join(e.text for e in effects)}: the drives have nothing to"
            " move",
            f"name it too: {','.join((*moved, drives[0].text))}",
        )
    given_delay = _given_delay(drives)
    names = _laws_of(drives) if drives else tuple(LAWS)
    progress("choosing the servo law")
    law = find_law(load, runs, names, given_delay)
    lead = lead_of_friction(load)
    if law.has_lead and not chosen and lead is not None:
        load.append(lead)
    # 2. Gains at the law's delay.
    progress("balancing the gains")
    loop = _Loop(
        problem,
        runs,
        weighting,
        load=tuple(load),
        drives=drives or [effect(problem.robot) for effect in LAWS[law.name]],
        open_delay=given_delay is None and law.delay > 0.0,
    )
    model, theta = loop.fitted_at_delay(law.delay)
    # 3. The load's shape constants with the gains fixed: gain times control error is
    # then the torque.
    gains = {model.parameters[k].name: float(theta[k]) for k in model.error_gains}
    shapes = estimate_shapes(
        replace(model, known=gains), runs, weighting, widest=c.TURNS[-1]
    )
    # 4. All again with these constants, on a motion free of noise.
    loop = replace(loop, load=with_shapes(load, shapes))
    model, _ = loop.fitted_at_delay(law.delay)
    model, rows, distance = _refined(loop, model, instruments, progress)
    delay = model.effects[-1].shape["T"]
    _, theta = loop.fitted_at_delay(delay)
    details = {
        "limited": tuple(find_limited_drives(model, theta, runs)),
        "law": "as given" if drives else law.name,
        "delay": delay,
        "held_out": law.held_out,
        "shapes": tuple(shapes),
        "motion": tuple(distance.tolist()),
    }
    return model, rows, details


def find_limited_drives(model: Model, theta: Array, runs: FilteredRuns) -> list[int]:
    """Return the joints (from 1) whose drive makes less torque than its law demands.

    A drive with a torque limit follows its law up to the limit. The load's torque, less
    the demanded one, is then minus what the demand exceeds the limit by. The drive is
    limited if that explains LIMIT_EXPLAINS of the squared residual.

    Parameters
    ----------
    theta : (p,) array
        Parameters, up to a common factor.

    Returns
    -------
    list of int
        Joints; empty if no drive is limited.
    """
    free_model = replace(model, known={})
    n = model.robot.n
    demands: list[list[Array]] = [[] for _ in range(n)]  # torque by the drive's law
    missing: list[list[Array]] = [[] for _ in range(n)]  # load's torque less the demand
    for run in runs.runs:
        for rows in run.rows(free_model):
            for joint, part in enumerate(rows.columns):
                is_drive = model.drives[part.indices]
                torques = part.columns * theta[part.indices]
                demands[joint].append(-torques[:, is_drive].sum(axis=1))
                missing[joint].append(torques.sum(axis=1))
    return [
        joint + 1
        for joint in range(n)
        if _is_limited(np.concatenate(demands[joint]), np.concatenate(missing[joint]))
    ]


def _is_limited(demand: Array, missing: Array) -> bool:
    """Decide whether a drive's torque is limited, from the torque (N,) that its law
    demands, and the torque (N,) of the load less that demand.

    For each of LIMIT_LEVELS as a share of the largest demand, the missing torque is
    compared with minus what the demand exceeds this limit by.
    """
    squared = float(missing @ missing)
    if squared == 0.0:
        return False
    largest = np.quantile(np.abs(demand), 0.999)
    for level in c.LIMIT_LEVELS:
        size = np.maximum(np.abs(demand) - level * largest, 0.0)
        excess = np.sign(demand) * size
        squared_excess = float(excess @ excess)
        is_above = size > 0.0
        if not is_above.any() or is_above.all():
            continue
        squared_above = float(np.mean(missing[is_above] ** 2))
        squared_below = float(np.mean(missing[~is_above] ** 2))
        # The noise of a coarse encoder is the same at all demands.
        if squared_above < c.LIMIT_RATIO**2 * squared_below:
            continue
        product = float(excess @ missing)
        missing_share = -product / squared_excess
        explained = product**2 / (squared_excess * squared)
        if missing_share >= c.LIMIT_MISSING and explained >= c.LIMIT_EXPLAINS:
            return True
    return False


def _load_of(
    problem: Problem, effects: Sequence[Effect], *, has_law: bool, chosen: bool
) -> list[Effect]:
    """Return the effects against which the drives work.

    Without a given law, viscous friction is left out: its column is that of the damping
    gain kd. Rotor inertia is added unless the user chose the effects (``chosen``) or
    the robot has a single joint, whose rotor acts like its link.
    """
    load = [e for e in effects if e.forward != "drive"]
    if not has_law:  # kd and viscous friction have one column: kd is their sum
        load = [e for e in load if e.simulator_field != "damping"]
    has_rotors = any(e.simulator_field == "armature" for e in load)
    # A drive has a rotor. A single joint's cannot be told from what it moves.
    if not chosen and not has_rotors and problem.robot.n > 1:
        load.append(standard_effect("armature")(problem.robot))
    return load


def _given_delay(drives: Sequence[Effect]) -> float | None:
    """Return the delay [s] that the user gave for the drives' effects; None without
    one.
    """
    for effect in drives:
        if "T" in effect.given:
            return effect.shape["T"]
    return None


def _laws_of(drives: Sequence[Effect]) -> tuple[str, ...]:
    """Return the names of the laws that consist of exactly these servo effects.

    Without such a law the result is the last of LAWS, the one with most gains.
    """
    kinds = {type(drive) for drive in drives}
    same = tuple(name for name, law in LAWS.items() if set(law) == kinds)
    return same or tuple(LAWS)[-1:]


def _refined(
    loop: _Loop, model: Model, instruments: bool, progress: Progress
) -> tuple[Model, FilteredRuns, Array]:
    """Alternate steps of the servos' delay and simulations of the closed loop.

    The simulated motion is an instrument: it follows the command but has no sensor
    noise. The alternation ends when the simulated motion gets no closer to the measured
    one. Returns the model, the log with the instruments with which it was fitted, and
    (n,) the distance of the simulated motion from the measured one [rad, m]. Without
    ``instruments``: one step of the delay, the log as it is, and an empty (0,)
    distance.
    """
    smallest = np.inf  # mean logarithm of the joints' distances
    used = loop.runs  # with the instruments of the best model
    rows = loop.runs  # with the newest instruments
    motion = np.zeros(0)
    if not instruments:
        return loop.with_better_delay(model, rows), rows, motion
    # Motions whose distances differ by less than this factor's logarithm are the same.
    tolerance = np.log(c.FEWER_GAINS)
    for k in count(1):
        better = loop.with_better_delay(model, rows)
        progress(f"simulating the command, pass {k}")
        simulated, distance = loop.simulated(better, rows)
        log_distance = float(np.mean(np.log(at_least_tiny(distance))))
        is_worse = not log_distance < smallest + tolerance  # NaN, too, is worse
        if is_worse:
            break
        model = better
        used = rows
        rows = simulated
        motion = distance
        is_unchanged = log_distance > smallest - tolerance
        if is_unchanged:
            break
        smallest = log_distance
    return model, used, motion


def loop_beside_torque(
    drives: Sequence[Effect], data: Measurements, settings: Preprocessing
) -> LoopFields:
    """Fit a servo's law to a logged torque, to see whether the loop is as stated.

    Least squares of the torque, joint by joint, in the columns of the law and a
    constant (an integral may begin anywhere). A delay that is not given is the one that
    fits best, or zero if that fits no better.

    Parameters
    ----------
    data : Measurements
        Log with torque and commands.

    Returns
    -------
    LoopFields
        Delay and gains of the law, and the share of each joint's squared torque that it
        explains.

    Raises
    ------
    InputError
        For a log without commands.
    """
    if "qcmd" not in data.groups:
        raise InputError(
            "a servo's law needs the command", "log qcmd1..qcmdn", data.names[0]
        )
    robot = drives[0].robot
    turned = replace(data, tau=-data.tau)  # a drive's torque counts negative
    offset = standard_effect("offset")(robot)
    runs = FilteredRuns.filtering(turned, settings)

    def fitted(delay: float) -> tuple[Model, Regression, Array]:
        """Return model, compressed rows and least-squares parameters for a delay [s]."""
        delayed_drives = [e.with_shape(T=delay) for e in drives]
        model = Model(robot, (*delayed_drives, offset))
        rows = compress(runs, model)
        data_of_all = rows.least_squares()
        return model, rows, min_norm_lstsq(data_of_all.R, data_of_all.rho)

    def log_residual(delay: float) -> float:
        """Return the sum over joints of the logarithm of the squared residual."""
        _, rows, theta = fitted(delay)
        return float(np.sum(np.log(at_least_tiny(rows.joint_losses(theta)))))

    delay = _given_delay(drives)
    if delay is None:
        minimum = scipy.optimize.minimize_scalar(
            log_residual, bounds=(0.0, LATEST), method="bounded"
        )
        delay = float(minimum.x)
        if not log_residual(delay) < log_residual(0.0):
            delay = 0.0
    model, rows, theta = fitted(delay)
    losses = rows.joint_losses(theta)
    # The constant torque alone, without the law: what the law's share is compared with.
    data_of_all = rows.least_squares()
    columns_of_constant = np.where(model.drives, 0.0, data_of_all.R)
    constant = min_norm_lstsq(columns_of_constant, data_of_all.rho)
    constant = np.where(model.drives, 0.0, constant)
    losses_of_constant = rows.joint_losses(constant)
    noise = np.sqrt(rows.oversampling * losses / np.maximum(rows.joint_rows(), 1))
    std = deviations(data_of_all.R)
    gains = {
        parameter.name: LoopGain(
            float(theta[k]), float(std[k] * noise[parameter.joint - 1]), parameter.unit
        )
        for k, parameter in enumerate(model.parameters)
        if model.drives[k]
    }
    shares = 1.0 - losses / at_least_tiny(losses_of_constant)
    return LoopFields(delay, gains, tuple(shares.tolist()))
