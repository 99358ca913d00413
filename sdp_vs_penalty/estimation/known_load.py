"""Gains, of torque channels or of servos, from what is known: a load that was weighed,
or a parameter.

Torque from motor currents is true up to a gain a joint, and every inertial parameter
scales with it. Between joints the gains follow from the links that they share; the one
common scale needs something known: the mass of a load in further runs (Gautier, Briot,
ASME J. Dynamic Systems 2014). With channel j reading g_j times the true torque,

    tau_j = g_j Y_j theta                                 without the load,
    tau_j = g_j (Y_j theta + Y_L,j (m, psi))              with it, m known, psi its nine others,

is solved for theta, psi and ln g by Gauss-Newton on the compressed runs, with weak
priors: gains are within ``GAIN_PRIOR`` of one, and the load lies within ``LOAD_REACH``
of the last link's frame.

A log without torque shows its gains' ratios, not their scale. Least squares of 0 = L
theta - kp e shrink everything; divided by the gain, e = L theta / kp, they do not:
:func:`fit_up_to_scale` solves that for all joints together, the start of the convex problem
that is posed (:mod:`~sdp_vs_penalty.regression.instruments`).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from sdp_vs_penalty.data.files import Source, as_measurements
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects import standard_effect
from sdp_vs_penalty.effects.effect import Parameter
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.effects.servo import Servo
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation import constants as c
from sdp_vs_penalty.estimation.drive_torque import with_drive_torque
from sdp_vs_penalty.estimation.uncertainty import Sandwich, stretched
from sdp_vs_penalty.estimators.estimator import joint_weights, white_variance
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.evidence import jackknifed
from sdp_vs_penalty.regression.linalg import (
    column_space,
    least_squares,
    min_norm_lstsq,
    partialled,
)
from sdp_vs_penalty.regression.regression import Factor, Regression, TimeBlock, compress
from sdp_vs_penalty.robot.arrays import Array, at_least_tiny, nonzero_or_one
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.signals.filtered import FilteredRun, FilteredRuns
from sdp_vs_penalty.signals.preprocessing import Preprocessing

#: Runs with a load, and its mass [kg].
KnownLoads: TypeAlias = Sequence[tuple[Source, float]]


def _loaded(loads: KnownLoads, robot: Robot) -> Iterator[tuple[Measurements, float]]:
    """Read the runs with a known load; yield each with its mass [kg].

    Raises InputError for a mass that is not positive and finite.
    """
    for source, mass in loads:
        if not 0.0 < mass < np.inf:
            raise InputError(
                f"a known load of {mass:g} kg",
                "give the mass that was on the last link",
            )
        runs = as_measurements(
            source, robot.n, robot.joint_names, "identify(known_loads=...)"
        )
        yield runs, float(mass)


def gains_from_loads(
    model: Model, runs: FilteredRuns, loads: KnownLoads, prior: float
) -> tuple[Array, Array]:
    """Estimate the gains of the torque channels from runs with known masses.

    A channel reads gain times the true torque. A load of known mass on the last link
    makes a known torque, which determines the gain. The problem is linear in all
    unknowns about the present gains: Gauss-Newton iterations.

    Parameters
    ----------
    model : Model
        Model of the robot without load.
    loads : sequence of (run, mass)
        Runs with a body on the last link, and its mass [kg].
    prior : float
        Prior standard deviation of the gains' relative errors; 0: GAIN_PRIOR.

    Returns
    -------
    (n,) array
        Gains of the torque channels, reading over true torque [-].
    (n, r) array
        Factor of the covariance of the gains' relative errors.

    Raises
    ------
    InputError
        For a mass that is not positive and finite.
    """
    # 1. The rows of all runs, each with its load's mass. What is known is in true units,
    # the channels' torques are not.
    bare = replace(model.reference_free, gains=None, known={})
    payload = standard_effect("payload")(model.robot)
    with_load = replace(bare, effects=(*bare.effects, payload))
    parts = [(compress(runs, bare), 0.0)]
    for run, mass in _loaded(loads, model.robot):
        loaded = FilteredRuns.filtering(run, runs.settings)
        parts.append((compress(loaded, with_load), mass))
    p = len(bare.parameters)
    n = model.robot.n
    # 2. Prior standard deviations of the unknowns x (s,): infinite for the robot's
    # parameters; of each load's three first moments [kg m] and six moments of inertia
    # [kg m^2]; of the logarithms ln g of the gains.
    reaches = [c.LOAD_REACH] * 3 + [c.LOAD_REACH**2] * 6
    std_of_loads = [mass * reach for _, mass in parts[1:] for reach in reaches]
    prior_std = np.concatenate(
        [np.full(p, np.inf), std_of_loads, np.full(n, prior or c.GAIN_PRIOR)]
    )
    # 3. Gauss-Newton steps.
    log_gain = np.zeros(n)
    weights = np.ones(n)
    x = np.zeros(len(prior_std))
    most_steps = 50
    for step in range(most_steps):
        linear = _linearised(parts, p, x, log_gain)
        data = linear.least_squares(weights)
        # Rounding counts as noise, so that exact data leave the prior a weight.
        strength = max(
            white_variance(data, linear.oversampling),
            1e-18 * data.tau_squared / data.rows,
        )
        with_prior = data.with_prior(prior_std, strength)
        x = min_norm_lstsq(with_prior.R, with_prior.rho)
        # The last n unknowns are ln g. Short steps keep the linearisation valid.
        change = x[-n:] - log_gain
        log_gain = log_gain + np.clip(change, -0.5, 0.5)
        # Three steps find the weights; then they stay, so that the steps converge.
        if step < 3:
            weights = joint_weights(linear, x)
        elif np.abs(change).max() < 1e-9:
            break
    sandwich = Sandwich(_linearised(parts, p, x, log_gain), weights, prior_std)
    contrasts_of_gains = np.eye(len(prior_std))[-n:]
    std = sandwich.half_widths(contrasts_of_gains) / c.NORMAL_95
    return np.exp(log_gain), stretched(sandwich.factor[-n:], std)


def _linearised(
    parts: Sequence[tuple[Regression, float]], p: int, x: Array, log_gain: Array
) -> Regression:
    """Linearise the torque equations of all runs about the present unknowns.

    A channel of gain g reads g (Y theta + Y_load x_load). The unknowns (s,) are theta
    (p,), nine parameters of each load (all but its known mass), and ln g (n,).

    Parameters
    ----------
    parts : sequence of (Regression, float)
        Compressed rows of the runs without load (mass 0), then those of each load, with
        its mass [kg].
    p : int
        Number of parameters theta.
    x, log_gain : (s,), (n,) arrays
        The present unknowns, and those of them that are ln g.
    """
    factors = list[Factor]()
    blocks = list[TimeBlock]()
    first_run = 0
    size = len(x)
    for part, (regression, mass) in enumerate(parts):
        # Number the blocks and runs of all parts consecutively.
        first_block = len(blocks)
        blocks += [
            (first_run + run, start, stop) for run, start, stop in regression.blocks
        ]
        first_run = 1 + max(run for run, *_ in blocks)
        for factor in regression.factors:
            # Part 0 has no load; the others' loads have nine unknowns each, behind theta.
            first_of_load = p + 9 * (part - 1)
            rows = _linearised_rows(factor, mass, p, first_of_load, x, log_gain)
            factors.append(
                Factor(
                    factor.joint,
                    block=factor.block + first_block,
                    indices=np.arange(size),
                    triangle=rows,
                    rows=factor.rows,
                )
            )
    unknowns = tuple(Parameter(f"x{k}", "-", "known_load", 0) for k in range(size))
    return Regression(
        unknowns,
        joints=len(log_gain),
        blocks=tuple(blocks),
        factors=tuple(factors),
        oversampling=parts[0][0].oversampling,
    )


def _linearised_rows(
    factor: Factor, mass: float, p: int, first_of_load: int, x: Array, log_gain: Array
) -> Array:
    """Return the rows (r, s + 1) of one joint in all s unknowns, the torque last, from
    its triangle [Y, Y_load, tau].

    ``first_of_load`` is the place of the load's nine unknowns; the other arguments are
    those of :func:`_linearised`.
    """
    size = len(x)
    columns = np.exp(log_gain[factor.joint]) * factor.triangle[:, :-1]
    is_mass = factor.indices == p  # the first of the load's ten parameters
    torque_of_mass = columns[:, is_mass].sum(axis=1) * mass
    indices = factor.indices[~is_mass]
    indices = np.where(indices > p, indices - (p + 1) + first_of_load, indices)
    # Modelled torque of the channel, which is its derivative by ln g as well.
    slope = columns[:, ~is_mass] @ x[indices] + torque_of_mass
    # All unknowns, so that every run of a joint has the same columns.
    rows = np.zeros((len(columns), size + 1))
    rows[:, indices] = columns[:, ~is_mass]
    rows[:, size - len(log_gain) + factor.joint] = slope
    torque = factor.triangle[:, -1] - torque_of_mass
    rows[:, -1] = torque + slope * log_gain[factor.joint]
    return rows


def fit_up_to_scale(problem: Problem, model: Model, regression: Regression) -> Array:
    """Fit load and servo gains of a log without torque, up to a common factor.

    A servo's torque is kp_j times the control error e_j of joint j, and balances the
    load L_j psi (all other columns and parameters). So e_j = L_j psi / kp_j, and

        sum_j |e_j - L_j psi / kp_j|^2 / s_j^2

    is minimised, where s_j is the residual of e_j when each joint is fitted alone. The
    variables are ln kp; psi is eliminated (variable projection; Golub, Pereyra, SIAM J.
    Numer. Anal. 1973). It converged from any start in all cases tried. The common
    factor is chosen so that the links make the torque of the nominal links.

    Parameters
    ----------
    problem : Problem
        Robot with its nominal links.
    model : Model
        Load and drives; ``model.error_gains`` are the indices of the gains kp.
    regression : Regression
        Rows in the model's columns.

    Raises
    ------
    InputError
        For a joint that does not move, or whose error is zero.
    """
    # 1. Rows e and L of all joints, divided by the joints' noise s_j.
    p = regression.p
    gains = np.array(model.error_gains)
    links = model.rigid_indices
    nominal_links = problem.prior_links.ravel()[: len(links)]
    other_parameters = np.setdiff1d(np.arange(p), gains)
    rows_of_joint = [
        _in_units_of_error(factor, gain, other_parameters, p)
        for factor, gain in zip(regression.per_joint, gains, strict=True)
    ]
    rows = np.vstack(rows_of_joint)
    joint_of_row = np.repeat(np.arange(len(gains)), [len(x) for x in rows_of_joint])
    # The column of kp_j is minus the error of joint j.
    e = -rows[np.arange(len(rows)), gains[joint_of_row]]
    L = rows[:, other_parameters]
    # 2. First gains: the nominal links' torque over the error, joint by joint.
    link_torques = [
        np.linalg.norm(rows_j[:, links] @ nominal_links) for rows_j in rows_of_joint
    ]
    errors = [
        np.linalg.norm(rows_j[:, gain])
        for rows_j, gain in zip(rows_of_joint, gains, strict=True)
    ]
    start = np.maximum(np.divide(link_torques, errors), 1e-6)
    is_joint = joint_of_row[:, None] == np.arange(len(gains))

    def fitted(x: Array) -> tuple[Array, Array, Array]:
        """Return psi, the residual, and its Jacobian by ln kp (Kaufman, BIT 1975)."""
        columns = L / (start * np.exp(x))[joint_of_row, None]
        U, V = column_space(columns)
        psi = V @ (U.T @ e)
        slopes = (columns @ psi)[:, None] * is_joint
        return psi, e - U @ (U.T @ e), slopes - U @ (U.T @ slopes)

    def residual_and_jacobian(x: Array) -> tuple[Array, Array]:
        """Return the residual of e and its Jacobian by x = ln kp - ln start."""
        _, residual, jacobian = fitted(x)
        return residual, jacobian

    # 3. x = ln(kp / start) by least squares, within a factor Servo.range of the start.
    end = np.full(len(gains), np.log(Servo.range))
    best, _, _ = least_squares(
        residual_and_jacobian,
        np.zeros_like(end),
        (-end, end),
        xtol=1e-8,
        ftol=1e-8,
        steps=100 * len(gains),
    )
    theta = np.empty(p)
    theta[gains] = start * np.exp(best)
    theta[other_parameters] = fitted(best)[0]
    # 4. The factor: least squares of the nominal links' torque in that of the fitted
    # ones.
    link_columns = rows[:, links]
    fitted_torque = link_columns @ theta[links]
    nominal_torque = link_columns @ nominal_links
    squared = nonzero_or_one(fitted_torque @ fitted_torque)
    size = float(fitted_torque @ nominal_torque) / squared
    return theta * (size if size > 0.0 else 1.0)


def _in_units_of_error(
    factor: Factor, error_index: int, other_parameters: Array, p: int
) -> Array:
    """Return a joint's rows (r, p) divided by s, the noise of its servo's control
    error.

    s is the root mean square of the error after least squares in the load's columns.
    ``error_index`` is the error's column, ``other_parameters`` those of all columns but
    the errors. Raises InputError for a joint whose error is zero.
    """
    rows = np.zeros((len(factor.triangle), p))
    rows[:, factor.indices] = factor.triangle[:, :-1]
    error = rows[:, error_index]
    residual = np.linalg.norm(partialled(rows[:, other_parameters], error))
    total = np.linalg.norm(error)
    # At least the rounding of the error, so that exact data can be divided by it.
    s = max(float(residual), 1e-9 * float(total)) / np.sqrt(max(factor.rows, 1))
    if s == 0.0:
        joint = factor.joint + 1
        what = f"joint {joint} does not move, or follows its command without error"
        raise InputError(what, "check the columns qcmd1..qcmdn")
    return rows / s


_SCALES = (
    "give a gain (kp2=600), a parameter that motion shows alone (m1 of a slide, mx6),"
    " or a load"
)


#: Motor constants among known values: of current [N m/A], of voltage [N m/V].
_MOTOR = re.compile(r"(kt|ku)(\d+)")


def with_scale(
    problem: Problem,
    model: Model,
    runs: FilteredRuns,
    known: Mapping[str, float],
    loads: KnownLoads,
) -> tuple[Model, dict[str, Any]]:
    """Set the scale of a model of a log without torque.

    Parameters
    ----------
    problem : Problem
        Robot with its nominal links.
    model : Model
        Model up to a factor, its strongest gain fixed.
    known : mapping of str to float
        Known parameters by name, or motor constants kt1 [N m/A] and ku1 [N m/V].
    loads : sequence of (run, mass)
        Runs with a known mass [kg] on the last link.

    Returns
    -------
    Model
        The model in SI units, no longer up to a factor.
    dict
        "known": parameters that are now fixed; "scale": its origin in words;
        "scale_error": relative standard deviation.

    Raises
    ------
    InputError
        For known values that set no scale.
    """
    theta = model.reference
    assert theta is not None
    motors = _motor_constants(model.robot.n, known)
    values = {name: x for name, x in known.items() if not _MOTOR.fullmatch(name)}
    replace(model, known=values).require_known("--known")
    # The first of these sets the scale: loads, motor constants, known parameters.
    factor, error = 1.0, 0.0
    if loads:
        factor, error = _factor_of_loads(problem, model, runs, loads)
    elif motors:
        factor = _factor_of_motors(model, theta, runs, motors)
    elif values:
        unfixed = replace(model, known={})
        factor = _factor_of_known(model, compress(runs, unfixed), theta, values)
    fixed = values
    if loads or motors or not values:  # the values do not fix the strongest gain
        scaled_gain = {name: factor * x for name, x in model.known.items()}
        fixed = {**scaled_gain, **values}
    origins = [f"a load of {mass:g} kg" for _, mass in loads]
    origins += [f"{name} = {x:g}" for name, x in known.items()]
    if not origins:
        gain = ", ".join(f"{name} = {x:.4g}" for name, x in model.known.items())
        origins = [
            f"unknown: all torques, masses and gains share one factor ({gain} if links"
            " weigh as stated)"
        ]
    details = {"known": fixed, "scale": ", ".join(origins), "scale_error": error}
    return replace(model, known=fixed, reference=factor * theta), details


def _motor_constants(
    n: int, known: Mapping[str, float]
) -> dict[tuple[str, int], float]:
    """Select the motor constants kt (current) and ku (voltage) among known values.

    Returns values by channel ("current" or "voltage") and joint, from 0.
    """
    channels = {"kt": "current", "ku": "voltage"}
    motors = {}
    for name, value in known.items():
        if found := _MOTOR.fullmatch(name):
            joint = int(found[2]) - 1
            if not 0 <= joint < n:
                raise InputError(f"--known {name}: there is no such joint", _SCALES)
            motors[channels[found[1]], joint] = value
    return motors


def _factor_of_known(
    model: Model, regression: Regression, theta: Array, known: Mapping[str, float]
) -> float:
    """Return the factor on theta (p,) that gives a known parameter its value.

    Without a logged torque, theta is known up to this factor. The first parameter sets
    it that the data determine by itself, and not only in sums with others: without one
    InputError. ``known`` maps names to values [SI].
    """
    names = [p.name for p in model.parameters]
    is_load = ~model.drives  # parameters of links and friction, not of servos
    data = regression.keeping(is_load).least_squares()
    # Share of each column that no other parameter can make; 1 for a servo's gain.
    share = np.ones(len(names))
    norms = nonzero_or_one(data.column_norms)
    share[is_load] = data.own_torque / norms
    for name, value in known.items():
        k = names.index(name)
        if share[k] > c.SCALE_TOLD and theta[k] != 0.0 and value != 0.0:
            return float(value / theta[k])
    text = ", ".join(f"{name}={value:g}" for name, value in known.items())
    what = f"--known {text}: motion shows it only in sums with others, or it is zero"
    raise InputError(f"{what}, so it sets no scale", _SCALES)


def _factor_of_motors(
    model: Model,
    theta: Array,
    runs: FilteredRuns,
    motors: Mapping[tuple[str, int], float],
) -> float:
    """Return the factor on theta (p,) that motor constants imply.

    With it the drives' torque is the constant times the logged current or voltage.
    Several motors' factors are averaged geometrically. Raises InputError for a missing
    column, and for one that is not correlated with the drive's torque.

    Parameters
    ----------
    motors : dict
        Constants [N m/A, N m/V] by channel and joint, from 0.
    """
    data = runs.measurements
    bare = replace(model, known={})

    def filtered(all_runs: Measurements, joint: int) -> Array:
        """Return the filtered torque of one joint in all runs (M,), without constant
        (an integral may begin anywhere in each run) and velocity (the gain kd holds
        viscous friction, which is no torque of the drive)."""
        torques = []
        for run in all_runs.runs():
            rows = FilteredRun(run, runs.settings).all_rows(bare)
            constant = np.ones(len(rows.torque))
            others = np.stack([constant, rows.motion.dq[:, joint]], axis=1)
            torques.append(partialled(others, rows.torque[:, joint]))
        return np.concatenate(torques)

    factors = []
    with_torque = with_drive_torque(model, theta, data)
    for (channel, joint), constant in motors.items():
        if channel not in data.groups:
            what = f"a motor's constant needs the column {channel}{joint + 1}"
            raise InputError(what, "log it", data.names[0])
        motor_log = replace(with_torque, tau=constant * data.groups[channel])
        of_motor = filtered(motor_log, joint)
        of_drive = filtered(with_torque, joint)
        product = float(of_motor @ of_drive)
        norms = np.linalg.norm(of_motor) * np.linalg.norm(of_drive)
        if product < c.MOTOR_ALIKE * norms:
            what = f"{channel}{joint + 1} is not what this servo makes of its error"
            raise InputError(what, "check its sign and joint")
        factors.append(float(of_motor @ of_motor) / product)
    return float(np.exp(np.mean(np.log(factors))))


@dataclass(frozen=True)
class _LoadedRun:
    """Rows of runs with a known mass [kg] on the last link.

    Their columns are those of the model, then ten of the load (its mass first) and an
    offset of each joint's torque.
    """

    rows: Regression
    mass: float

    @classmethod
    def compressed(
        cls, model: Model, runs: Measurements, mass: float, settings: Preprocessing
    ) -> _LoadedRun:
        """Compress runs with a known mass in the columns of a model and a load."""
        robot = model.robot
        drives = [e for e in model.effects if e.forward == "drive"]
        begins_anywhere = any(drive.has_constant_part for drive in drives)
        offset = [standard_effect("offset")(robot)] if begins_anywhere else []
        wide = Model(
            robot,
            (*model.effects, standard_effect("payload")(robot), *offset),
            gains=model.gains,
            allow_duplicates=True,
        )
        return cls(compress(FilteredRuns.filtering(runs, settings), wide), mass)

    def without_block(self, block: int) -> _LoadedRun:
        """Return the runs without the rows of one block."""
        others = [b for b in range(len(self.rows.blocks)) if b != block]
        return replace(self, rows=self.rows.select(others))

    def factor(self, theta: Array) -> tuple[float, float]:
        """Return the factor on theta (p,) that the mass implies, and its information.

        The factor is the known mass over the one that theta leaves; the information is
        the inverse variance of its relative error for independent noise. Raises
        InputError for runs that do not show the load.
        """
        # Fit load and offset to what the arm's torque leaves, twice: the first fit
        # gives the joints' weights. Parameter 0 is the load's mass.
        remaining = self.rows.given_first(theta)
        unweighted = remaining.least_squares()
        first = min_norm_lstsq(unweighted.R, unweighted.rho)
        data = remaining.least_squares(joint_weights(remaining, first))
        x = min_norm_lstsq(data.R, data.rho)
        fitted_mass = x[0]
        torque_of_mass = data.own_torque[0]  # that no other parameter can make, a kg
        is_shown = torque_of_mass > c.SCALE_TOLD * data.column_norms[0]
        if not is_shown or fitted_mass <= 0.0:
            what = f"--known-load: these runs do not show {self.mass:g} kg"
            raise InputError(what, "move the joints that lift the load")
        variance = remaining.oversampling * data.loss(x) / max(data.rows, 1)
        squared_torque = fitted_mass**2 * torque_of_mass**2
        return self.mass / fitted_mass, squared_torque / at_least_tiny(variance)


def _mean_factor(loaded: Sequence[_LoadedRun], theta: Array) -> tuple[float, float]:
    """Return the factor on theta (p,) that all known loads imply, and its relative
    standard deviation for independent noise.

    Factors are averaged with their information (inverse variance) as weights.
    """
    factors = []
    information = []
    for one in loaded:
        factor, its_information = one.factor(theta)
        factors.append(factor)
        information.append(its_information)
    mean = float(np.average(factors, weights=information))
    return mean, float(np.sum(information) ** -0.5)


def _factor_of_loads(
    problem: Problem, model: Model, runs: FilteredRuns, loads: KnownLoads
) -> tuple[float, float]:
    """Return the factor on theta (p,) that known loads imply, and its relative standard
    deviation.

    Without a logged torque, theta is known up to this factor. The deviation is that of
    the scaled position gain which fixes the model's scale. Errors of the model are no
    independent noise, so it is a jackknife: over blocks of the loaded runs, and over
    blocks of the training runs, from which theta is fitted again. Both variances add up.
    It is at least the one for independent noise.

    Parameters
    ----------
    problem : Problem
        Robot with its nominal links.
    model : Model
        Model up to a factor; its strongest gain is its first known value.
    loads : sequence of (run, mass)
        Runs with a known mass [kg] on the last link.
    """
    theta = model.reference
    assert theta is not None
    loaded = [
        _LoadedRun.compressed(model, measurements, mass, runs.settings)
        for measurements, mass in _loaded(loads, model.robot)
    ]
    factor, std_of_noise = _mean_factor(loaded, theta)
    variance = _variance_by_loaded_runs(loaded, theta)
    scaled_gains = _gains_without_a_block(problem, model, runs, loaded)
    _, std_of_scaled_gain = jackknifed(np.array(scaled_gains))
    fixed_gain = next(iter(model.known.values()))
    variance += (float(std_of_scaled_gain) / fixed_gain) ** 2
    return factor, max(std_of_noise, float(np.sqrt(variance)) / factor)


def _variance_by_loaded_runs(loaded: Sequence[_LoadedRun], theta: Array) -> float:
    """Return the jackknife variance of the loads' mean factor on theta (p,), over the
    blocks of each loaded run in turn."""
    variance = 0.0
    for k, one in enumerate(loaded):
        factors = []
        for block in range(len(one.rows.blocks)):
            fewer = [*loaded[:k], one.without_block(block), *loaded[k + 1 :]]
            factors.append(_mean_factor(fewer, theta)[0])
        _, std_of_factor = jackknifed(np.array(factors))
        variance += float(std_of_factor) ** 2
    return variance


def _gains_without_a_block(
    problem: Problem, model: Model, runs: FilteredRuns, loaded: Sequence[_LoadedRun]
) -> list[float]:
    """Return the scaled gain that fixes the model's scale, fitted without each block of
    the training runs.
    """
    names = [parameter.name for parameter in model.parameters]
    place = names.index(next(iter(model.known)))
    measured = runs.measurements
    # Instruments (a simulated motion) would have to be made again without each block.
    commanded = {k: x for k, x in measured.commanded.items() if k != "qsim"}
    rows = FilteredRuns.filtering(replace(measured, commanded=commanded), runs.settings)
    up_to_scale = replace(model, known={}, reference=None)
    training = compress(rows, up_to_scale)
    n_blocks = len(training.blocks)
    gains = []
    for block in range(n_blocks):
        others = [b for b in range(n_blocks) if b != block]
        theta = fit_up_to_scale(problem, up_to_scale, training.select(others))
        factor, _ = _mean_factor(loaded, theta)
        gains.append(factor * float(theta[place]))
    return gains
