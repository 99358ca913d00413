"""The result of an identification: parameters with a certificate, saved as one self-contained file."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import platform
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sdp_vs_penalty import show
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects import effect_from_dict
from sdp_vs_penalty.effects.effect import Motion
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.show import parameter_rows, plot_parameters
from sdp_vs_penalty.files import write_text
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.show import Shown, Summary, Table
from sdp_vs_penalty.signals.preprocessing import Preprocessing
from sdp_vs_penalty.solvers.certificate import Certificate, lower_bound, repair
from sdp_vs_penalty.version import __version__

if TYPE_CHECKING:
    import pandas

    from sdp_vs_penalty.constraints.constraint import ConstraintSet
    from sdp_vs_penalty.estimators.estimator import Estimator, Fit, Task
    from sdp_vs_penalty.problem.problem import Problem
    from sdp_vs_penalty.regression.black_box import BlackBox
    from sdp_vs_penalty.regression.regression import LeastSquares, Regression

Array = NDArray[np.float64]

#: Of model.json; a file with a larger number was written by a newer version of this package.
FORMAT = 1

#: Random poses at which M(q) must be positive definite.
_POSES = 10_000


@dataclass(frozen=True, repr=False)
class Estimate(Shown):
    """theta (p,) of a model, with how it came about.

    covariance (p, p) : of the identifiable part of theta, NaN rows for what the data do not see.
    settings : those of the method; preprocessing : the resolved filters; provenance : versions,
    data hash, seed, problem.
    """

    problem: str
    model: Model
    theta: Array
    covariance: Array
    method: str
    certificate: Certificate
    preprocessing: Preprocessing
    settings: dict[str, Any]
    details: dict[str, Any]
    provenance: dict[str, Any]

    @property
    def robot(self) -> Robot:
        return self.model.robot

    @property
    def links(self) -> Array:
        """(n, 10) standard parameters of the links."""
        return self.theta[self.model.rigid_indices].reshape(-1, 10)

    @property
    def standard_deviations(self) -> Array:
        """(p,) of each parameter on its own; NaN where the data do not determine it."""
        return np.sqrt(np.diagonal(self.covariance))

    def torque(self, motion: Motion) -> Array:
        """Modelled torque (N, n) of a motion."""
        return self.model.torque(self.theta, motion)

    def predict(self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike, t: ArrayLike | None = None) -> Array:
        """Torque (N, n) [N m or N] at states q, dq, ddq, each (N, n) [rad, rad/s, rad/s^2; m].

        t : (N,) instants [s], needed where an effect depends on time or on earlier motion.
        Raises InputError for arrays of other shapes, and where t is needed.
        """
        names = ("q", "dq", "ddq")
        states = tuple(np.atleast_2d(np.asarray(x, float)) for x in (q, dq, ddq))
        for name, x in zip(names, states, strict=True):
            if x.shape != states[0].shape or x.shape[1:] != (self.robot.n,):
                raise InputError(
                    f"predict({name}=...): shape {np.shape(x)}, but q, dq and ddq must all be "
                    f"(N, {self.robot.n})."
                )
        if t is None:
            timed = [e.name for e in self.model.effects if e.has_memory or "t0" in e.shape]
            if timed:
                raise InputError(f"predict(): {timed[0]} depends on time: pass t, (N,) in seconds.")
            t = np.zeros(len(states[0]))
        times = np.asarray(t, float)
        if times.shape != (len(states[0]),):
            raise InputError(f"predict(t=...): shape {times.shape}, but q has {len(states[0])} rows.")
        return self.torque(Motion(times, states[0], states[1], states[2]))

    def plot(self, axes: Any = None) -> Any:
        """Draw link masses and the other effects' parameters, with two standard deviations.

        axes : one for each effect (default: a new figure); returns them.
        Raises InputError without matplotlib (extra [plot]).
        """
        return plot_parameters(self.model.parameters, self.theta, self.standard_deviations, axes)

    def _summary(self) -> Summary:
        title = f"Estimate: {self.problem}, {self.method}, {len(self.theta)} parameters"
        return title, [
            ("effects", ", ".join(e.name for e in self.model.effects)),
            ("data", f"{self.provenance['samples']} samples of {', '.join(self.provenance['runs'])}"),
            *self.certificate.summary()[::2][:2],
        ]

    def _table(self) -> Table:
        rows = parameter_rows(self.model.parameters, self.theta, self.standard_deviations)
        return ("parameter", "value", "unit", "effect"), rows

    def to_frame(self) -> pandas.DataFrame:
        """The parameters as a table, indexed by name: value, std, unit, effect, joint."""
        import pandas

        return pandas.DataFrame(self.to_dict()["parameters"]).set_index("name")

    def to_dict(self) -> dict[str, Any]:
        """What model.json holds."""
        parameters = [
            {
                "name": p.name,
                "value": float(value),
                "unit": p.unit,
                "std": None if np.isnan(std) else float(std),
                "effect": p.effect,
                "joint": p.joint,
            }
            for p, value, std in zip(
                self.model.parameters, self.theta, self.standard_deviations, strict=True
            )
        ]
        seen = np.flatnonzero(~np.isnan(np.diagonal(self.covariance)))
        return {
            "format": FORMAT,
            "problem": self.problem,
            "method": self.method,
            "settings": self.settings,
            "parameters": parameters,
            "certificate": self.certificate.to_dict(),
            "robot": self.robot.to_dict(),
            "effects": [e.to_dict() for e in self.model.effects],
            "reference": None if self.model.reference is None else self.model.reference.tolist(),
            "preprocessing": dataclasses.asdict(self.preprocessing),
            "covariance": {
                "parameters": [self.model.parameters[k].name for k in seen],
                "matrix": self.covariance[np.ix_(seen, seen)].tolist(),
            },
            "details": self.details,
            "provenance": self.provenance,
        }

    def require_joints(self, measurements: Measurements, what: str = "measurements") -> None:
        """Raises InputError unless the measurements have as many joints as the robot."""
        if measurements.n != self.robot.n:
            raise InputError(
                f"The {what} have {show.count(measurements.n, 'joint')}, the model's robot has "
                f"{self.robot.n}: choose the model that belongs to them."
            )

    def save(self, path: str | Path) -> None:
        """Write model.json, whole or not at all."""
        write_text(path, json.dumps(self.to_dict(), indent=1) + "\n")


def load_estimate(path: str | Path) -> Estimate:
    """Read the model.json at ``path``; the estimate predicts the same torques to the last bit.

    Raises InputError for a file that is not one, is incomplete, or comes from a newer version.
    """
    path = Path(path)
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}).") from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not a JSON file ({error}).") from error
    if not isinstance(data, dict) or "format" not in data:
        raise InputError(f"{path}: not a model.json of this program (no field 'format').")
    if not isinstance(data["format"], int) or data["format"] > FORMAT:
        raise InputError(
            f"{path}: written by a newer version (format {data['format']}, this one reads up to "
            f"{FORMAT}): upgrade sdp-vs-penalty."
        )
    try:
        return _from_dict(data)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except KeyError as error:
        raise InputError(f"{path}: the field {error.args[0]!r} is missing.") from error
    except (TypeError, ValueError, AttributeError, IndexError, OverflowError) as error:
        raise InputError(f"{path}: a field has the wrong content ({error}).") from error


def _from_dict(data: dict[str, Any]) -> Estimate:
    robot = Robot.from_dict(data["robot"])
    reference = data.get("reference")
    model = Model(
        robot,
        tuple(effect_from_dict(e, robot) for e in data["effects"]),
        None if reference is None else np.array(reference, float),
    )
    if reference is not None and len(reference) != len(model.parameters):
        raise ValueError("reference and parameters differ in length")
    names = [p.name for p in model.parameters]
    given = {p["name"]: float(p["value"]) for p in data["parameters"]}
    missing = [name for name in names if name not in given]
    if missing:
        raise KeyError(f"parameters: {missing[0]}")
    if not np.all(np.isfinite(list(given.values()))):
        raise ValueError("a parameter's value is not a finite number")
    p = len(names)
    covariance = np.full((p, p), np.nan)
    seen = [names.index(name) for name in data["covariance"]["parameters"]]
    covariance[np.ix_(seen, seen)] = np.array(data["covariance"]["matrix"], float).reshape(
        len(seen), len(seen)
    )
    return Estimate(
        data["problem"],
        model,
        np.array([given[name] for name in names]),
        covariance,
        data["method"],
        Certificate(**data["certificate"]),
        Preprocessing(**data["preprocessing"]),
        data["settings"],
        data["details"],
        data["provenance"],
    )


def build_estimate(
    problem: Problem,
    task: Task,
    estimator: Estimator,
    fit: Fit,
    regression: Regression,
    preprocessing: Preprocessing,
    measurements: Measurements | BlackBox,
    weighting: str,
) -> Estimate:
    """Certify a fit and put everything that made it into an Estimate."""
    theta, certificate = certify(task, fit)
    bounds = [] if fit.multipliers is None else on_bounds(fit.constraints, theta)
    settings = {
        **dataclasses.asdict(estimator),  # type: ignore[call-overload]
        "weighting": weighting,
    }
    provenance = {
        "seed": task.seed,
        "data_hash": measurements.data_hash,
        "runs": list(measurements.names),
        "samples": measurements.samples,
        "versions": versions(),
    }
    return Estimate(
        problem.name,
        task.model,
        theta,
        covariance(task.data, regression.oversampling),
        estimator.name,
        certificate,
        preprocessing,
        settings,
        {**{k: v for k, v in fit.details.items() if k != "interior"}, "on_bounds": bounds},
        provenance,
    )


def on_bounds(constraints: ConstraintSet, theta: Array) -> list[str]:
    """Masses, extents and ranges on their bounds: there the bound speaks, not the data."""
    found = []
    for c in constraints.convex:
        if c.family in ("mass", "bounding ellipsoid", "range"):
            size = np.abs(c.constant) + np.abs(c.coefficients.T) @ np.abs(theta[c.indices])
            if np.any(c.value(theta) <= 1e-6 * size):
                found.append(f"{c.family} of {c.name}")
    return found


def certify(task: Task, fit: Fit) -> tuple[Array, Certificate]:
    """The estimate, moved into the feasible set where the method promises that, and its certificate."""
    theta = fit.theta
    upper = lower = gap = None
    if fit.multipliers is not None and fit.interior is not None:
        theta = repair(fit.constraints, theta, fit.interior)
        upper = fit.objective.value(theta)
        lower = lower_bound(
            fit.objective, fit.constraints, fit.multipliers, theta, task.bound, fit.entropy_slopes
        )
        scale = max(fit.objective.least_squares.loss(theta), 1e-12 * task.data.tau_squared)
        gap = (upper - lower) / scale if scale > 0.0 else 0.0
    links = theta[task.links]
    return theta, Certificate(
        violations=fit.constraints.worst(theta),
        loss=task.data.loss(theta),
        upper=upper,
        lower=lower,
        gap=gap,
        positive_mass_matrices=positive_mass_matrices(task.model.robot, links) if len(links) else None,
        smallest_thickness=float(inertia.thickness(links).min()) if len(links) else None,
    )


def positive_mass_matrices(robot: Robot, links: Array, poses: int = _POSES, seed: int = 0) -> float:
    """Share of random poses at which the joint-space inertia matrix M(q) is positive definite."""
    matrices = robot.mass_matrices(links, robot.random_configurations(poses, seed))
    with contextlib.suppress(np.linalg.LinAlgError):  # ten times faster, where it is so everywhere
        np.linalg.cholesky(matrices)
        return 1.0
    return float(np.mean(np.linalg.eigvalsh(matrices)[:, 0] > 0.0))


def covariance(data: LeastSquares, oversampling: float) -> Array:
    """sigma^2 (R^T R)^-1 on what the data determine, NaN for every parameter that they do not.

    sigma^2 is the residual variance of unconstrained least squares; filtered rows repeat each
    other ``oversampling`` times.
    """
    p = data.R.shape[1]
    out = np.full((p, p), np.nan)
    norms = data.column_norms
    visible = np.flatnonzero(norms > 0.0)
    if not len(visible):
        return out
    u, s, vt = np.linalg.svd(data.R[:, visible] / norms[visible], full_matrices=False)
    good = s > 1e-9 * s[0]
    residual = data.rho - u[:, good] @ (u[:, good].T @ data.rho)
    loss = float(residual @ residual) + data.floor**2
    variance = loss / max(data.rows - oversampling * int(good.sum()), 1.0) * oversampling
    # A parameter is determined if its unit vector lies in the row space of R.
    inside = np.sum(vt[good] ** 2, axis=0) > 1.0 - 1e-9
    half = (vt[good] / s[good, None]) / norms[visible]
    full = variance * half.T @ half
    keep = visible[inside]
    out[np.ix_(keep, keep)] = full[np.ix_(inside, inside)]
    return out


def versions() -> dict[str, str]:
    """Versions of everything that a figure may depend on."""
    from importlib.metadata import PackageNotFoundError, version

    found = {"sdp_vs_penalty": __version__, "python": platform.python_version()}
    for name in ("numpy", "scipy", "pin", "clarabel", "cvxpy"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found
