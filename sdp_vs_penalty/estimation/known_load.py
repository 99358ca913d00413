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

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sdp_vs_penalty.data.files import Source, as_measurements
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects import effect_types
from sdp_vs_penalty.effects.effect import Parameter
from sdp_vs_penalty.effects.links import Payload
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.effects.servo import Servo
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation import constants as c
from sdp_vs_penalty.estimation.drive_torque import with_drive_torque
from sdp_vs_penalty.estimation.uncertainty import Sandwich, stretched
from sdp_vs_penalty.estimators.estimator import joint_weights, white_variance
from sdp_vs_penalty.problem.problem import Problem
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


def _loaded(
    loads: Sequence[tuple[Source, float]], robot: Robot
) -> Iterator[tuple[Measurements, float]]:
    """The runs with a load, read, each with its mass [kg]; InputError for a mass that
    is none."""
    for source, mass in loads:
        if not 0.0 < mass < np.inf:
            raise InputError(
                f"a known load of {mass:g} kg",
                "give the mass that was on the last link",
            )
        runs = as_measurements(
            source,
            robot.n,
            robot.joint_names,
            "identify(known_loads=...)",
        )
        yield runs, float(mass)


def gains_from_loads(
    model: Model,
    runs: FilteredRuns,
    loads: Sequence[tuple[Source, float]],
    prior: float,
) -> tuple[Array, Array]:
    """The gains that make loads weigh what they weigh: what each torque channel reads
    over the true torque.

    Parameters
    ----------
    model : Model
        Of the robot without load.
    runs : FilteredRuns
        Without load.
    loads : sequence of (run, mass)
        Further runs, each with the mass [kg] of a body on the last link.
    prior : float
        Standard deviation of the gains' relative errors before the loads are known; 0
        for the usual one.

    Returns
    -------
    (n,) array
        Gains.
    (n, r) array
        A factor of the covariance of their relative errors.

    Raises
    ------
    InputError
        For a mass that is none.
    """
    payload = Payload(model.robot)
    bare = replace(model.reference_free, gains=None)
    with_load = replace(bare, effects=(*bare.effects, payload))
    loaded = _loaded(loads, model.robot)
    parts = [(compress(runs, bare), 0.0)]
    parts += [
        (compress(FilteredRuns.of(x, runs.settings), with_load), mass)
        for x, mass in loaded
    ]
    p = len(bare.parameters)
    n = model.robot.n
    load = [
        mass * reach
        for _, mass in parts[1:]
        for reach in (*[c.LOAD_REACH] * 3, *[c.LOAD_REACH**2] * 6)
    ]
    scale = np.concatenate(
        [
            np.full(p, np.inf),
            load,
            np.full(n, prior or c.GAIN_PRIOR),
        ]
    )
    log_gain = np.zeros(n)
    weights = np.ones(n)
    x = np.zeros(len(scale))
    for step in range(50):
        linear = _linearised(parts, p, x, log_gain)
        data = linear.least_squares(weights)
        strength = max(
            white_variance(data, linear.oversampling),
            1e-18 * data.tau_squared / data.rows,
        )
        bounded = data.with_prior(scale, strength)
        x = min_norm_lstsq(bounded.R, bounded.rho)
        moved = x[-n:] - log_gain
        log_gain = log_gain + np.clip(moved, -0.5, 0.5)
        if step < 3:
            weights = joint_weights(linear, x)
        elif np.abs(moved).max() < 1e-9:
            break
    known = Sandwich(_linearised(parts, p, x, log_gain), weights, scale)
    std = known.half_widths(np.eye(len(scale))[-n:]) / c.NORMAL_95
    return np.exp(log_gain), stretched(known.factor[-n:], std)


def _linearised(
    parts: Sequence[tuple[Regression, float]],
    p: int,
    x: Array,
    log_gain: Array,
) -> Regression:
    """Runs without and with loads [kg] about x and the gains, linear in x: theta (p,),
    nine parameters a load, ln g (n,)."""
    factors = list[Factor]()
    blocks = list[TimeBlock]()
    run = 0
    size = len(x)
    n = len(log_gain)
    for k, (regression, mass) in enumerate(parts):
        first = len(blocks)
        blocks += [(of + run, start, stop) for of, start, stop in regression.blocks]
        run = 1 + max(k for k, *_ in blocks)
        for f in regression.factors:
            columns = np.exp(log_gain[f.joint]) * f.triangle[:, :-1]
            known = f.indices == p  # the load's mass comes first of its ten parameters
            weighs = columns[:, known].sum(axis=1) * mass
            indices = f.indices[~known]
            indices = np.where(
                indices > p,
                indices - 1 + 9 * (k - 1),
                indices,
            )
            slope = columns[:, ~known] @ x[indices] + weighs
            rows = np.zeros(
                (len(columns), size + 1)
            )  # the same columns for each run of a joint
            rows[:, indices], rows[:, size - n + f.joint] = columns[:, ~known], slope
            rows[:, -1] = f.triangle[:, -1] - weighs + slope * log_gain[f.joint]
            factors.append(
                Factor(
                    f.joint,
                    f.block + first,
                    np.arange(size),
                    rows,
                    f.rows,
                )
            )
    unknowns = tuple(
        Parameter(
            f"x{k}",
            "-",
            "known_load",
            0,
        )
        for k in range(size)
    )
    return Regression(
        unknowns,
        n,
        tuple(blocks),
        tuple(factors),
        parts[0][0].oversampling,
    )


def fit_up_to_scale(problem: Problem, model: Model, regression: Regression) -> Array:
    """theta (p,) that minimises sum_j |e_j - L_j psi / kp_j|^2 / s_j^2, up to a factor:
    that which makes the links weigh what the problem says.

    e_j is joint j's error, L_j all other columns, s_j what L_j leaves of e_j with
    coefficients of its own. Solved in ln kp, psi eliminated (variable projection;
    Golub, Pereyra, SIAM J. Numer. Anal. 1973): it converged from any start in all cases
    tried. Raises InputError where no joint follows its command.
    """
    p = regression.p
    gains = np.array(model.error_gains)
    links = model.rigid_indices
    nominal = problem.nominal(model)
    other_parameters = np.setdiff1d(np.arange(p), gains)
    white = [
        _in_units_of_error(f, at, other_parameters, p)
        for f, at in zip(regression.per_joint, gains, strict=True)
    ]
    rows = np.vstack(white)
    owner = np.repeat(np.arange(len(gains)), [len(x) for x in white])
    e = -rows[np.arange(len(rows)), gains[owner]]
    L = rows[:, other_parameters]
    pulls = [np.linalg.norm(of_joint[:, links] @ nominal[links]) for of_joint in white]
    pushes = [
        np.linalg.norm(of_joint[:, at])
        for of_joint, at in zip(white, gains, strict=True)
    ]
    start = np.maximum(np.divide(pulls, pushes), 1e-6)
    is_own = owner[:, None] == np.arange(len(gains))

    def fitted(x: Array) -> tuple[Array, Array, Array]:
        """psi, what remains, and its change with ln kp (Kaufman, BIT 1975)."""
        columns = L / (start * np.exp(x))[owner, None]
        U, V = column_space(columns)
        psi = V @ (U.T @ e)
        slopes = (columns @ psi)[:, None] * is_own
        return psi, e - U @ (U.T @ e), slopes - U @ (U.T @ slopes)

    far = np.full(len(gains), np.log(Servo.range))
    best, _, _ = least_squares(
        lambda x: fitted(x)[1:],
        0.0 * far,
        (-far, far),
        xtol=1e-8,
        ftol=1e-8,
        steps=100 * len(gains),
    )
    theta = np.empty(p)
    theta[gains] = start * np.exp(best)
    theta[other_parameters] = fitted(best)[0]
    # As the links should weigh, by the torque that they make.
    L_links = rows[:, links]
    link_energy = L_links @ theta[links]
    stated = L_links @ nominal[links]
    size = float(link_energy @ stated) / nonzero_or_one(link_energy @ link_energy)
    return theta * (size if size > 0.0 else 1.0)


def _in_units_of_error(
    factor: Factor,
    error: int,
    other_parameters: Array,
    p: int,
) -> Array:
    """(r, p) a joint's rows over s_j; error : the place of its error's column. Raises
    InputError for a joint whose error is zero."""
    wide = np.zeros((len(factor.triangle), p))
    wide[:, factor.indices] = factor.triangle[:, :-1]
    left = np.linalg.norm(partialled(wide[:, other_parameters], wide[:, error]))
    total = np.linalg.norm(wide[:, error])
    s = max(float(left), 1e-9 * float(total)) / np.sqrt(max(factor.rows, 1))
    if s == 0.0:
        joint = factor.joint + 1
        what = f"joint {joint} does not move, or follows its command without error"
        raise InputError(what, "check the columns qcmd1..qcmdn")
    return np.asarray(wide / s)


_SCALES = (
    "give a gain (kp2=600), a parameter that motion shows alone (m1 of a slide, mx6),"
    " or a load"
)


def with_scale(
    model: Model,
    runs: FilteredRuns,
    known: Mapping[str, float],
    loads: Sequence[tuple[Source, float]],
) -> tuple[Model, dict[str, Any]]:
    """A model of a log without torque in true units.

    Parameters
    ----------
    model : Model
        Up to a factor, its strongest gain given.
    runs : FilteredRuns
        Without torque.
    known : mapping of str to float
        Parameters by name, or constants of motors, kt1 [N m/A] and ku1 [N m/V].
    loads : sequence of (run, mass)
        Further runs, each with the mass [kg] on the last link.

    Returns
    -------
    Model
        In true units.
    dict
        Plain JSON: the parameters that are given then, the scale in words, and its
        relative standard deviation.

    Raises
    ------
    InputError
        For what sets no scale.
    """
    theta = model.reference
    factor = 1.0
    error = 0.0
    stated = dict(known) or dict(model.known)
    assert theta is not None
    motors = _motor_constants(model.robot.n, known)
    if motors:
        factor = _factor_of_motors(model, theta, runs, motors)
    elif known:
        factor = _factor_of_known(model, compress(runs, model), theta, known)
    if loads:
        factor, error = _factor_of_loads(model, theta, loads, runs.settings)
    if loads or motors:
        stated = {name: factor * x for name, x in model.known.items()}
    known_words = [f"a load of {mass:g} kg" for _, mass in loads]
    known_words += [f"{name} = {x:g}" for name, x in known.items()]
    gain = ", ".join(f"{name} = {x:.4g}" for name, x in model.known.items())
    none = (
        f"unknown: all torques, masses and gains share one factor ({gain} if links"
        " weigh as stated)"
    )
    details = {
        "known": stated,
        "scale": ", ".join(known_words) or none,
        "scale_error": error,
    }
    return replace(model, known=stated, reference=factor * theta), details


def _motor_constants(
    n: int, known: Mapping[str, float]
) -> dict[tuple[str, int], float]:
    """Of known values those of n motors' constants, by the channel and joint (from 0)
    that they belong to."""
    motors = {}
    for key, channel in (("kt", "current"), ("ku", "voltage")):
        for joint in range(n):
            value = known.get(f"{key}{joint + 1}")
            if value is not None:
                motors[channel, joint] = value
    return motors


def _factor_of_known(
    model: Model,
    regression: Regression,
    theta: Array,
    known: Mapping[str, float],
) -> float:
    """The factor on theta (p,) with which the first of the known parameters has its
    value."""
    names = [p.name for p in model.parameters]
    free = ~model.drives
    problem_of_free = regression.keeping(free).least_squares()
    share = np.ones(len(names))
    share[free] = problem_of_free.own_torque / nonzero_or_one(
        problem_of_free.column_norms
    )
    for name in known:
        wrong = "the model has no such parameter"
        if name.startswith("total"):
            wrong = "the first link's mass makes no torque, so a total is no scale"
        elif name in names:
            is_determined = (
                share[names.index(name)] > c.SCALE_TOLD
                and theta[names.index(name)] != 0.0
            )
            wrong = (
                ""
                if is_determined
                else "motion shows it only in sums with others, so it sets no scale"
            )
        if wrong:
            raise InputError(f"--known {name}: {wrong}", _SCALES)
    name, value = next(iter(known.items()))
    return float(value / theta[names.index(name)])


def _factor_of_motors(
    model: Model,
    theta: Array,
    runs: FilteredRuns,
    motors: Mapping[tuple[str, int], float],
) -> float:
    """The factor on theta (p,) with which the drives' torque is the constants times
    what was logged.

    Least squares, both filtered, beside a constant (an integral may begin anywhere in
    each run) and the velocity: kd holds viscous friction, which is no torque of the
    drive.
    """
    data = runs.measurements
    bare = replace(model, known={})
    shares = []

    def filtered(all_runs: Measurements, joint: int) -> Array:
        out = []
        for rows in (
            FilteredRun(run, runs.settings).all_rows(bare) for run in all_runs.runs()
        ):
            others = np.stack(
                [np.ones(len(rows.torque)), rows.motion.dq[:, joint]], axis=1
            )
            out.append(partialled(others, rows.torque[:, joint]))
        return np.concatenate(out)

    with_torque = with_drive_torque(model, theta, data)
    for (column, j), constant in motors.items():
        if column not in data.groups:
            what = f"a motor's constant needs the column {column}{j + 1}"
            raise InputError(what, "log it", data.names[0])
        x = filtered(replace(with_torque, tau=constant * data.groups[column]), j)
        y = filtered(with_torque, j)
        across = float(x @ y)
        if across < c.MOTOR_ALIKE * np.linalg.norm(x) * np.linalg.norm(y):
            what = f"{column}{j + 1} is not what this servo makes of its error"
            raise InputError(what, "check its sign and joint")
        shares.append(float(x @ x) / across)
    return float(np.exp(np.mean(np.log(shares))))


def _factor_of_loads(
    model: Model,
    theta: Array,
    loads: Sequence[tuple[Source, float]],
    settings: Preprocessing,
) -> tuple[float, float]:
    """The same of loads [kg], and its relative standard deviation; what is left is load
    and offsets."""
    robot = model.robot
    load_effects = (Payload(robot), effect_types()["torque_offset"](robot))
    wide = Model(
        robot,
        (*model.effects, *load_effects),
        gains=model.gains,
        allow_duplicates=True,
    )
    factors = list[float]()
    information = list[float]()
    for runs, mass in _loaded(loads, robot):
        left = compress(FilteredRuns.of(runs, settings), wide).given_first(theta)
        data = left.least_squares()
        data = left.least_squares(joint_weights(left, min_norm_lstsq(data.R, data.rho)))
        x = min_norm_lstsq(data.R, data.rho)
        if data.own_torque[0] <= c.SCALE_TOLD * data.column_norms[0] or x[0] <= 0.0:
            what = f"--known-load: these runs do not show {mass:g} kg"
            raise InputError(what, "move the joints that lift the load")
        variance = left.oversampling * data.loss(x) / max(data.rows, 1)
        factors.append(mass / x[0])
        information.append(
            x[0] ** 2 * data.own_torque[0] ** 2 / at_least_tiny(variance)
        )
    return float(np.average(factors, weights=information)), float(
        np.sum(information) ** -0.5
    )
