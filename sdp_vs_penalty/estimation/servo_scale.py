"""The gains of a log without torque: their ratios, and the scale, which motion does not show.

Of 0 = L theta - kp e the least squares shrink theta, and with it everything; divided by the gain,
e = L theta / kp, they do not. So that is what :func:`balanced` solves, for all joints together, for the
start of the convex problem that is posed (:mod:`~sdp_vs_penalty.regression.instruments`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.data.files import Source, as_measurements
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects import effect_types
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.effects.payload import Payload
from sdp_vs_penalty.effects.servo import Servo
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.constants import MOTOR_ALIKE, SCALE_TOLD
from sdp_vs_penalty.estimation.drive_torque import with_drive_torque
from sdp_vs_penalty.estimators.estimator import joint_weights
from sdp_vs_penalty.problem.problem import Problem
from sdp_vs_penalty.regression.bounded_least_squares import least_squares
from sdp_vs_penalty.regression.partial import partialled, smallest, visible
from sdp_vs_penalty.regression.regression import Regression, compress
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.signals.preprocessing import Preprocessing, filtered_torque


def balanced(problem: Problem, model: Model, regression: Regression) -> Array:
    """theta (p,) that minimises sum_j |e_j - L_j psi / kp_j|^2 / s_j^2, up to a factor: that which makes
    the links weigh what the problem says.

    e_j is joint j's error, L_j all other columns, s_j what L_j leaves of e_j with coefficients of its
    own. Solved in ln kp, psi eliminated (variable projection; Golub, Pereyra, SIAM J. Numer. Anal.
    1973): it converged from any start in all cases tried. Raises InputError where no joint follows its
    command.
    """
    p, gains = regression.p, np.array(model.error_gains)
    links, nominal = model.rigid_indices, problem.nominal(model)
    rest = np.setdiff1d(np.arange(p), gains)
    errors, loads, of_links = list[Array](), list[Array](), list[Array]()
    for f, at in zip(regression.per_joint, gains, strict=True):
        wide = np.zeros((len(f.triangle), p))
        wide[:, f.indices] = f.triangle[:, :-1]
        e, own = -wide[:, at], wide[:, rest]
        left, whole = np.linalg.norm(partialled(own, e)), np.linalg.norm(e)
        s = max(float(left), 1e-9 * float(whole)) / np.sqrt(max(f.rows, 1))
        if s == 0.0:
            raise InputError(
                f"joint {f.joint + 1} does not move, or follows its command without error",
                "check the columns qcmd1..qcmdn",
            )
        errors.append(e / s)
        loads.append(own / s)
        of_links.append(wide[:, links] / s)
    e, owner = np.concatenate(errors), np.repeat(np.arange(len(gains)), [len(e) for e in errors])
    L, L_links = np.vstack(loads), np.vstack(of_links)
    pulls = [np.linalg.norm(own @ nominal[links]) for own in of_links]
    start = np.maximum([w / np.linalg.norm(x) for w, x in zip(pulls, errors, strict=True)], 1e-6)

    def fitted(x: Array) -> tuple[Array, Array, Array]:
        """psi, what remains, and its change with ln kp (Kaufman, BIT 1975)."""
        columns = L / (start * np.exp(x))[owner, None]
        U, V = visible(columns)
        psi = V @ (U.T @ e)
        slopes = (columns @ psi)[:, None] * (owner[:, None] == np.arange(len(gains)))
        return psi, e - U @ (U.T @ e), slopes - U @ (U.T @ slopes)

    far = np.full(len(gains), np.log(Servo.range))
    best, _, _ = least_squares(
        lambda x: fitted(x)[1:], 0.0 * far, (-far, far), xtol=1e-8, ftol=1e-8, steps=100 * len(gains)
    )
    theta = np.empty(p)
    theta[gains], theta[rest] = start * np.exp(best), fitted(best)[0]
    # As the links should weigh, by the torque that they make.
    told, stated = L_links @ theta[links], L_links @ nominal[links]
    size = float(told @ stated) / max(float(told @ told), 1e-300)
    return theta * (size if size > 0.0 else 1.0)


#: Constants of motors, and the columns that they are to be multiplied by: N m/A, N/A and N m/V, N/V.
_MOTORS = {"kt": "current", "ku": "voltage"}
_SCALES = "give a gain (kp2=600), a parameter that motion shows alone (m1 of a slide, mx6), or a load"


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


def factor_of_known(
    model: Model, regression: Regression, theta: Array, known: Mapping[str, float]
) -> float:
    """The factor on theta (p,) with which the first of the known parameters has its value.

    Raises InputError for what motion does not tell by itself.
    """
    names = [p.name for p in model.parameters]
    free = ~model.drives
    told, share = regression.keeping(free).least_squares(), np.ones(len(names))
    share[free] = told.own_torque / np.maximum(told.column_norms, 1e-300)
    for name in known:
        if name.startswith("total"):
            raise InputError(
                "--known total: the first link's mass makes no torque, so a total is no scale", _SCALES
            )
        if name not in names:
            raise InputError(f"--known {name}: the model has no such parameter", _SCALES)
        k = names.index(name)
        if share[k] <= SCALE_TOLD or theta[k] == 0.0:
            raise InputError(
                f"--known {name}: motion shows it only in sums with others, so it sets no scale", _SCALES
            )
    name, value = next(iter(known.items()))
    return float(value / theta[names.index(name)])


def constants_of_motors(known: Mapping[str, float], robot: Robot) -> dict[tuple[str, int], float]:
    """Which of the known parameters are constants of motors, kt1 [N m/A] or ku1 [N m/V], by column and
    joint from 0."""
    names = {f"{s}{j + 1}": (column, j) for s, column in _MOTORS.items() for j in range(robot.n)}
    return {names[name]: value for name, value in known.items() if name in names}


def factor_of_motors(
    model: Model,
    theta: Array,
    data: Measurements,
    motors: Mapping[tuple[str, int], float],
    settings: Preprocessing,
) -> float:
    """The factor on theta (p,) with which the drives' torque is the constants times what was logged.

    Least squares, both filtered, beside a constant (an integral may begin anywhere in each run) and the
    velocity: kd holds viscous friction, which is no torque of the drive. Raises InputError where the
    column is missing, or is not that servo's.
    """
    bare, shares = replace(model, known={}), []

    def filtered(whole: Measurements, joint: int) -> Array:
        parts = []
        for rows in (filtered_torque(run, bare, settings) for run in whole.runs()):
            x = rows.torque[:, joint]
            parts.append(partialled(np.column_stack([np.ones(len(x)), rows.motion.dq[:, joint]]), x))
        return np.concatenate(parts)

    made = with_drive_torque(model, theta, data)
    for (column, j), constant in motors.items():
        if column not in data.groups:
            raise InputError(
                f"a motor's constant needs the column {column}{j + 1}", "log it", data.names[0]
            )
        x, y = filtered(replace(made, tau=constant * data.groups[column]), j), filtered(made, j)
        across = float(x @ y)
        if across < MOTOR_ALIKE * np.linalg.norm(x) * np.linalg.norm(y):
            raise InputError(
                f"{column}{j + 1} is not what this servo makes of its error", "check its sign and joint"
            )
        shares.append(float(x @ x) / across)
    return float(np.exp(np.mean(np.log(shares))))


def factor_of_loads(
    model: Model, theta: Array, loads: Sequence[tuple[Source, float]], settings: Preprocessing
) -> tuple[float, float]:
    """The factor on theta (p,) with which the loads weigh what they weigh [kg], and its relative
    standard deviation. What the model leaves of a run with a load is the load, and where integrals
    began."""
    robot = model.robot
    own = (Payload(robot), effect_types()["torque_offset"](robot))
    wide = Model(robot, (*model.effects, *own), gains=model.gains, changes=True)
    found, information = list[float](), list[float]()
    for source, mass in loads:
        if not 0.0 < mass < np.inf:
            raise InputError(f"a known load of {mass:g} kg", "give the mass that was on the last link")
        runs = as_measurements(source, robot.n, robot.joint_names, "identify(known_loads=...)")
        left = compress(runs, wide, settings).beside(theta)
        data = left.least_squares()
        data = left.least_squares(joint_weights(left, smallest(data.R, data.rho)))
        x = smallest(data.R, data.rho)
        if data.own_torque[0] <= SCALE_TOLD * data.column_norms[0] or x[0] <= 0.0:
            raise InputError(
                f"--known-load: these runs do not show {mass:g} kg", "move the joints that lift the load"
            )
        variance = left.oversampling * data.loss(x) / max(data.rows, 1)
        found.append(mass / x[0])
        information.append(x[0] ** 2 * data.own_torque[0] ** 2 / max(variance, 1e-300))
    return float(np.average(found, weights=information)), float(np.sum(information) ** -0.5)


def words_of_scale(
    known: Mapping[str, float], loads: Sequence[tuple[Source, float]], gauge: Mapping[str, float]
) -> str:
    """What set the scale; gauge : the gain that stands for it where nothing is known."""
    said = [f"a load of {mass:g} kg" for _, mass in loads]
    said += [f"{name} = {x:g}" for name, x in known.items()]
    gain = ", ".join(f"{name} = {x:.4g}" for name, x in gauge.items())
    none = f"unknown: all torques, masses and gains share one factor ({gain} if links weigh as stated)"
    return ", ".join(said) or none
