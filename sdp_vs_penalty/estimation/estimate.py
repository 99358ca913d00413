"""The result of an identification: parameters with a certificate, saved as one
self-contained file."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections.abc import Callable, Mapping, MutableMapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from sdp_vs_penalty import formatting
from sdp_vs_penalty.arguments import checked_arguments
from sdp_vs_penalty.colours import AFTER, NEUTRAL
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.effects import EFFECTS, make_effect, standard_effect
from sdp_vs_penalty.effects.effect import Effect, Motion
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.errors import InputError, other_robot, quote_value
from sdp_vs_penalty.estimation.certificate import Certificate
from sdp_vs_penalty.estimation.constants import NORMAL_95
from sdp_vs_penalty.estimation.link_figures import (
    certificate_without_data,
    certified_content,
)
from sdp_vs_penalty.estimation.model_file import (
    FORMAT,
    BaseEntry,
    CovarianceBlock,
    Details,
    ModelFile,
    ParameterEntry,
)
from sdp_vs_penalty.estimation.shapes import constants_in_words
from sdp_vs_penalty.estimation.uncertainty import (
    Interval,
    Uncertainty,
    independent_gains,
)
from sdp_vs_penalty.estimation.verdict import Verdict, doubts_in_words
from sdp_vs_penalty.estimators import ESTIMATORS
from sdp_vs_penalty.estimators.estimator import Estimator
from sdp_vs_penalty.files import read_json, write_text
from sdp_vs_penalty.plugins import lazy_exports
from sdp_vs_penalty.problem.constants import FAR_MASS
from sdp_vs_penalty.problem.problem import Problem, ProblemFields
from sdp_vs_penalty.records import from_json, to_json
from sdp_vs_penalty.regression.base_parameters import base_rows
from sdp_vs_penalty.results.facts import fact
from sdp_vs_penalty.results.issue import StoredIssue
from sdp_vs_penalty.results.record import Record, Summary
from sdp_vs_penalty.results.table import Table
from sdp_vs_penalty.robot.arrays import Array, as_plain_array, check_finite, wrong_shape
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.signals.motion import MotionRecord
from sdp_vs_penalty.signals.preprocessing import Preprocessing
from sdp_vs_penalty.solvers import SOLVERS

if TYPE_CHECKING:
    import pandas


#: Exporters are plug-ins of a later folder: found by name when a model is asked for
#: one.
_SIMULATORS = lazy_exports(
    "sdp_vs_penalty.exporters", simulators="to_pinocchio to_mjspec"
)
#: What a nominal link without a file's inertial is drawn to, by its origin.
_DRAWN_TO = {
    "bounds": "its bounds",
    "geometry": "its shapes",
    "kinematics": "lengths and torque limits",
}
#: Ranges are of a later folder, frames of a later file.
_RANGES = lazy_exports("sdp_vs_penalty.ranges", table="find_ranges")
#: The control loop is of a later folder.
_ONLINE = lazy_exports("sdp_vs_penalty.online", arm="ArmModel")
_FRAMES = lazy_exports(
    "sdp_vs_penalty.estimation", frames="links_frame base_frame covariance_frame"
)


@dataclass(frozen=True)
class Training:
    """What a model was identified from, while the program runs: no file and no other
    process has it."""

    #: The EstimationProblem.
    posed: Any

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle and copy as None: another process poses its data anew."""
        return type(None), ()


@dataclass(frozen=True, repr=False, eq=False)
class Estimate(Record):
    """The identified parameters of a model, and how they came about.

    Two estimates are equal only if they are the same object; :attr:`identity` compares
    what they predict.

    Parameters
    ----------
    problem : Problem
        The bounds and the prior that held in the identification.
    model : Model
        The robot and its effects.
    theta : (p,) array
        A value for each of the model's parameters, each in its own unit.
    uncertainty : Uncertainty
        What the training runs say of the parameters: covariance and intervals.
    method : str
        The estimator's name.
    certificate : Certificate
        Violations of constraints, and the distance to the optimum.
    preprocessing : Preprocessing
        The filters, resolved.
    settings : dict
        Those of the method.
    report : Details
        What else the method and the posing report.
    provenance : dict or Provenance
        Versions, hash of the data, seed, verdict on the training runs, their noise.
    training_motion : MotionRecord, optional
        The path of the motion that it was identified from, where that was recorded.
    training : Training, optional
        What it was identified from, while the program runs.
    """

    #: The bounds and the prior that held in the identification.
    problem: Problem
    #: The robot and its effects.
    model: Model
    #: (p,) A value for each of the model's parameters, each in its own unit.
    theta: Array
    #: What the training runs say of the parameters: covariance and intervals.
    uncertainty: Uncertainty
    #: The estimator's name.
    method: str
    #: Violations of constraints, and the distance to the optimum.
    certificate: Certificate
    #: The filters, resolved.
    preprocessing: Preprocessing
    #: The settings of the method.
    settings: dict[str, Any]
    #: What else the method and the posing report.
    report: Details
    #: Versions, hash of the data, seed, verdict on the training runs, their noise.
    provenance: MutableMapping[str, Any]
    #: The path of the motion that it was identified from, where that was recorded.
    training_motion: MotionRecord | None = None
    #: What it was identified from, while the program runs; None for a file's model.
    training: Training | None = None

    def __post_init__(self) -> None:
        """Keep theta from being changed, and bind the certificate to it.

        A certificate of other values (``dataclasses.replace``) is not kept: what can be
        certified without data is certified anew, and the verdict on data is dropped.
        """
        theta = np.array(self.theta, float)
        theta.setflags(write=False)
        content = certified_content(self.problem, self.model, theta)
        certificate = self.certificate
        if not certificate.certifies:
            certificate = replace(certificate, certifies=content)
        elif certificate.certifies != content:
            certificate = certificate_without_data(self.problem, self.model, theta)
            known = {k: x for k, x in self.provenance.items() if k != "verdict"}
            object.__setattr__(self, "provenance", known)
        object.__setattr__(self, "theta", theta)
        object.__setattr__(self, "certificate", certificate)

    def with_theta(self, theta: ArrayLike) -> Estimate:
        """Return the model with other values of its parameters, certified anew.

        No data gave these values: violations and the links' figures are certified, and
        there is no loss, no distance to an optimum, no interval and no verdict.

        Parameters
        ----------
        theta : (p,) array
            A value for each of the model's parameters, each in its own unit.

        Returns
        -------
        Estimate
            With "given" as the source of each parameter.

        Raises
        ------
        InputError
            For anything but p finite numbers.
        """
        values = as_plain_array("with_theta(theta=...)", theta)
        p = len(self.model.parameters)
        if values.shape != (p,):
            raise wrong_shape("with_theta(theta=...)", values.shape, (p,), "parameter")
        check_finite("with_theta(theta=...)", values, (p,))
        base = base_rows(self.model, self.problem.independent)
        base_values = (base.rows @ values).tolist()
        old = self.uncertainty
        uncertainty = replace(
            old,
            standard=_given_intervals(old.standard, values.tolist()),
            base=_given_intervals(old.base, base_values),
        )
        entries = self.report.base_parameters
        report = replace(
            self.report,
            undetermined={q.name: "given" for q in self.model.parameters},
            base_parameters=tuple(
                replace(entry, value=value, source="given")
                for entry, value in zip(entries, base_values, strict=bool(entries))
            ),
            on_bounds=(),
        )
        known = {k: x for k, x in self.provenance.items() if k != "verdict"}
        return replace(
            self,
            theta=values,
            uncertainty=uncertainty,
            report=report,
            provenance=known,
            certificate=certificate_without_data(self.problem, self.model, values),
        )

    def with_gain_uncertainty(self, uncertainty: float | Array) -> Estimate:
        """Return the model with wider intervals: the gains of its torque channels are
        known less well, and so is all that is added to it or found beside it.

        Parameters
        ----------
        uncertainty : float or (n, e) array
            Relative standard deviation of each gain (0.01: known to a per cent), or a
            factor of their covariance.

        Raises
        ------
        InputError
            For a standard deviation outside of [0, 1).
        """
        errors = independent_gains(uncertainty, self.robot.n)
        base = base_rows(self.model, self.problem.independent).rows
        return replace(
            self, uncertainty=self.uncertainty.with_gain_errors(errors, base)
        )

    def with_effects(self, holds: Callable[[Effect], bool]) -> Estimate:
        """Return the model with some of its effects alone, those that ``holds`` accepts,
        and what is known of their parameters; nothing is identified again."""
        parts = [part for part in self.model.parts if holds(part[0])]
        index = np.sort(np.concatenate([indices for _, indices in parts]))
        names = {self.model.parameters[k].name for k in index}
        reference = self.model.reference
        model = replace(
            self.model,
            effects=tuple(effect for effect, _ in parts),
            reference=None if reference is None else reference[index],
            known={name: x for name, x in self.model.known.items() if name in names},
        )
        uncertainty = replace(
            self.uncertainty,
            standard=tuple(self.uncertainty.standard[k] for k in index),
            base=(),
            spread=self.uncertainty.spread[index],
            gain_response=self.uncertainty.gain_response[index],
        )
        theta = self.theta[index]
        return replace(self, model=model, theta=theta, uncertainty=uncertainty)

    @property
    def robot(self) -> Robot:
        """Robot of the model."""
        return self.model.robot

    @property
    def links(self) -> Array:
        """(links, 10) standard parameters of the links: m [kg], m c [kg m], inertia [kg
        m^2].
        """
        return self.theta[self.model.rigid_indices].reshape(-1, 10)

    @property
    def covariance(self) -> Array:
        """(p, p) covariance of theta; NaN rows and columns where the data do not
        determine it.
        """
        return self.uncertainty.covariance

    @property
    def details(self) -> dict[str, Any]:
        """The report as plain JSON, as a model.json holds it."""
        return self.report.to_dict()

    @property
    def torque_units(self) -> tuple[str, ...]:
        """(n,) "N*m" or "N" of each joint; what the training runs' torques are in where
        they are none, such as "A"."""
        unit = self.provenance.get("torque_unit", "")
        return (unit,) * self.robot.n if unit else self.robot.torque_units

    @property
    def sources(self) -> tuple[str, ...]:
        """(p,) what determines each parameter: "data", "prior", "bounds" or "given"."""
        undetermined = self.report.undetermined
        return tuple(undetermined.get(p.name, "data") for p in self.model.parameters)

    def range(self, function: str, level: float = 0.95, data: Any = None) -> Any:
        """Return the least and the greatest value of a function that data and physical
        consistency allow, whatever the prior.

        Parameters
        ----------
        function : str
            "m4", "c4x", "I4xx", "total mass", or a parameter's name.
        level : float
            Probability with which the range is to hold the truth.
        data : path, arrays, Measurements, optional
            Measurements; default: those that the model was identified from, as long as
            the program runs.

        Returns
        -------
        Range
            Certified ends, and what decides each
            (:class:`~sdp_vs_penalty.ranges.table.Range`).

        Raises
        ------
        InputError
            For an unknown function, and for a model from a file without data.
        """
        return _RANGES("find_ranges")(self, data, [function], level=level)[function]

    def value_text(self, index: int) -> str:
        """Write a parameter with its unit and 95 % interval, "0.31 ± 0.02 N m/rad (95
        %)"; where the data do not determine it, with what does.

        Parameters
        ----------
        index
            Of the parameter in theta, from 0.
        """
        unit = formatting.plain_unit(self.uncertainty.standard[index].unit)
        value = f"{self.theta[index]:.4g}"
        source = self.sources[index]
        half_width = NORMAL_95 * self.uncertainty.std[index]
        if source != "data":
            return f"{value} {unit} (not from the data: {source})"
        if np.isnan(half_width):
            return f"{value} {unit} (its interval is unknown)"
        return f"{value} ± {half_width:.2g} {unit} (95 %)"

    @property
    def held_by_bounds(self) -> list[tuple[str, str]]:
        """Lines (label, text) on bounds that decide in place of the data, on shape
        constants at an end of their range, and on guessed bodies that the data enlarged,
        for the user."""
        lines = []
        assumed = {
            f"mass of link {k}"
            for k, ends in enumerate(self.problem.assumed_masses, start=1)
            if ends.any()
        }
        on_bounds = self.report.on_bounds or ()
        if stated := [bound for bound in on_bounds if bound not in assumed]:
            advice = f"{', '.join(stated)}: widen the bounds, or measure more"
            lines.append(("on their bounds", advice))
        if wide := [bound for bound in on_bounds if bound in assumed]:
            advice = (
                f"{', '.join(wide)}: nothing narrower holds them; state"
                " bounds (--bounds), or take a method with a prior (lmi-sdp)"
            )
            lines.append(("at our widest limits", advice))
        if at_ends := self.constants_at_ends:
            lines.append(("constants", at_ends))
        enlarged = [
            f"link {k} ({body.enlarged:g} times)"
            for k, body in enumerate(self.problem.link_bodies, start=1)
            if body.enlarged > 1.0
        ]
        if enlarged:
            contradicted = (
                "the data contradict where the robot's file suggests that mass lies;"
                f" enlarged: {', '.join(enlarged)}"
            )
            lines.append(("guessed bodies", contradicted))
        return lines

    @property
    def constants_at_ends(self) -> str:
        """Which estimated shape constants lie at an end of the range in which they were
        looked for, and what that means; "" where none does."""
        keys = {s.key for s in self.report.shapes if s.at_end}
        keys.update(self.report.at_ends or ())
        lines = constants_in_words(self.model, keys)
        if not lines:
            return ""
        return (
            f"{'; '.join(lines)}: at an end of the range that was searched; the data"
            " bound it on one side only, and another law may explain as much"
        )

    @property
    def determined_by_data(self) -> list[tuple[str, str]]:
        """Lines (label, text) on which parameters the data determine, for the user.

        Base parameters are the combinations of standard parameters that the torque
        depends on. The first line counts those that the data determine; the second
        names the others and their source (prior or bounds). If one that the data
        determine has no standard deviation, there is one line that says so. Empty for a
        model without base parameters.
        """
        base = self.report.base_parameters
        if not base:
            return []
        std_by_name = {x.name: x.std for x in self.uncertainty.base}  # NaN: unknown
        n_without_std = sum(
            entry.source == "data" and bool(np.isnan(std_by_name.get(entry.name, 0.0)))
            for entry in base
        )
        if n_without_std:
            text = (
                f"nothing is known of the intervals: {n_without_std} of {len(base)}"
                " base parameters have none"
            )
            return [("determined by the data", text)]
        undetermined = {
            entry.name: entry.source
            for entry in base
            if entry.source not in ("data", "given")
        }
        text = (
            f"{self.n_base_from_data} of {self.n_base} base parameters,"
            f" {self.n_from_data} of {self.n_parameters} standard"
        )
        lines = [("determined by the data", text)]
        if undetermined:
            names = f"{', '.join(undetermined)}; see `source` in the file"
            source = next(iter(undetermined.values()))  # one method: one source
            lines.append((f"from the {source}", names))
        return lines

    @property
    def unweighed(self) -> str:
        """A sentence on links whose mass the data do not determine; "" without such
        links.

        It says where their masses come from (a prior, bounds), and lists those that
        differ from the nominal mass by more than the factor FAR_MASS.
        """
        # Ten parameters a link, the mass first. Lists hold numbers of links, from 0.
        mass_indices = self.model.rigid_indices[::10]
        masses = self.links[:, 0]
        sources = [self.sources[k] for k in mass_indices]
        undetermined = [
            link
            for link, source in enumerate(sources)
            if source not in ("data", "given")
        ]
        if not undetermined:
            return ""
        nominal = self.nominal[mass_indices]
        with_nominal = [i for i in undetermined if nominal[i] > 0.0]
        far_from_nominal = [
            i
            for i in with_nominal
            if not 1.0 / FAR_MASS < masses[i] / nominal[i] < FAR_MASS
        ]
        plural = "s" if len(undetermined) > 1 else ""
        numbers = formatting.words([i + 1 for i in undetermined])
        source = sources[undetermined[0]]  # one method has one source
        explanation = (
            f"the data do not determine the mass of link{plural} {numbers}, only sums"
            f" with others; the value comes from the {source} (`ranges` says what else it"
            " can be)"
        )
        origins = self.problem.nominal_from or ()
        drawn = {_DRAWN_TO.get(origins[i], "") for i in undetermined if origins} - {""}
        if drawn:
            explanation += (
                f"; a nominal link that no file states is a guess, drawn to"
                f" {formatting.words(sorted(drawn))}"
            )
        if not far_from_nominal:
            return f"{explanation}."
        masses_in_words = [
            f"{masses[i]:.3g} kg for {nominal[i]:.3g} (link {i + 1})"
            for i in far_from_nominal
        ]
        return f"{explanation}; far from nominal: {formatting.words(masses_in_words)}."

    @property
    def verdict(self) -> Verdict | None:
        """Verdict on the model when it was identified or extended; None if it was not
        judged.
        """
        stored = self.provenance.get("verdict")
        return None if stored is None else Verdict.from_dict(stored)

    def with_gravity(self, gravity: Sequence[float]) -> Estimate:
        """Return the same parameters for a base that is mounted in another direction.

        Parameters
        ----------
        gravity : (3,) sequence of float
            Gravity vector in the base frame [m/s^2].

        Returns
        -------
        Estimate
            With torque and base parameters of the new mounting.
        """
        problem = self.problem.with_gravity(gravity)
        effects = [
            make_effect(effect.entry, problem.robot) for effect in self.model.effects
        ]
        model = dataclasses.replace(
            self.model, robot=problem.robot, effects=tuple(effects)
        )
        # The check has judged the runs under the former direction.
        provenance = {**self.provenance, "checks": {}}
        return dataclasses.replace(
            self, problem=problem, model=model, provenance=provenance
        )

    @property
    def issues_by_run(self) -> Mapping[str, tuple[StoredIssue, ...]]:
        """What the check found in the training runs, by the runs' hashes."""
        checks = self.provenance.get("checks") or {}
        return from_json(dict[str, tuple[StoredIssue, ...]], checks)

    @property
    def nominal(self) -> Array:
        """(p,) nominal parameters of the links [kg, kg m, kg m^2]; NaN for other
        effects.
        """
        of_links = self.model.rigid_indices
        nominal = np.full(len(self.theta), np.nan)
        nominal[of_links] = self.problem.nominal(self.model)[of_links]
        return nominal

    @property
    def identity(self) -> str:
        """SHA-256 (hex) of everything on which the model's torque depends.

        It covers robot, effects, reference (the parameters of the current model),
        gains, and the parameters' names and values.
        """
        gains = self.problem.gains
        body = {
            "robot": self.robot.to_dict(),
            "effects": [e.entry.to_dict() for e in self.model.effects],
            "reference": (
                None if self.model.reference is None else self.model.reference.tolist()
            ),
            "gains": None if gains is None else list(gains),
            "names": [p.name for p in self.model.parameters],
            "values": self.theta.tolist(),
        }
        return hashlib.sha256(json.dumps(body, sort_keys=True).encode()).hexdigest()

    @fact("", digits=9)
    def n_parameters(self) -> int:
        """Number of the model's parameters."""
        return len(self.theta)

    @fact("", digits=9, name="n parameters from data")
    def n_from_data(self) -> int:
        """Number of parameters that the data determine; prior or bounds determine the
        others.
        """
        return self.sources.count("data")

    @fact("", digits=9, name="n base parameters")
    def n_base(self) -> int:
        """Number of base parameters, the combinations that torques depend on."""
        return len(self.report.base_parameters)

    @fact("", digits=9, name="n base parameters from data")
    def n_base_from_data(self) -> int:
        """Number of base parameters that the data determine, or that are given; prior or
        bounds determine the others.
        """
        base = self.report.base_parameters
        return sum(entry.source in ("data", "given") for entry in base)

    @fact("kg")
    def total_mass(self) -> float | None:
        """Sum of the links' masses [kg]; None for a model without links."""
        return float(self.links[:, 0].sum()) if len(self.links) else None

    def links_frame(self) -> pandas.DataFrame:
        """Return a DataFrame with one row a link; units stand in the columns' names.

        Columns: mass, centre of mass, inertia about it, nominal mass, smallest
        thickness, and what determines the mass.
        """
        return _FRAMES("links_frame")(self)

    def base_frame(self) -> pandas.DataFrame:
        """Return a DataFrame with one row a base parameter.

        Columns: full expression ("Izz1 + Iyy2 + 0.0998 m3"), value, 95 % interval,
        verdict and unit.
        """
        return _FRAMES("base_frame")(self)

    def covariance_frame(self, base: bool = False) -> pandas.DataFrame:
        """Return the covariance as a DataFrame with labelled rows and columns.

        Parameters
        ----------
        base : bool
            True for the b base parameters, False for all p parameters.

        Returns
        -------
        DataFrame
            (p, p) or (b, b); NaN for parameters that the data do not determine.
        """
        return _FRAMES("covariance_frame")(self, base)

    def to_pinocchio(self) -> Any:
        """Return the links, armature and friction as a Pinocchio Model.

        Returns
        -------
        pinocchio.Model
            Made by :func:`~sdp_vs_penalty.exporters.simulators.to_pinocchio`, with what it leaves
            out.
        """
        return _SIMULATORS("to_pinocchio")(self)

    def to_mjspec(self) -> Any:
        """Return the model as MuJoCo's MjSpec.

        Returns
        -------
        mujoco.MjSpec
            Made by :func:`~sdp_vs_penalty.exporters.simulators.to_mjspec`, to be edited
            further. A warning names the effects that it cannot hold.
        """
        return _SIMULATORS("to_mjspec")(self)

    @property
    def weighting(self) -> str:
        """How the joints' rows were weighted: "noise" or "none"."""
        return str(self.settings.get("weighting", "noise"))

    @property
    def estimator(self) -> Estimator:
        """Estimator of the method, with the settings of the identification."""
        plugins = self.provenance.get("plugins", {})
        default = ESTIMATORS.get(self.method, plugins.get(self.method, ""))()
        fields = {f.name for f in dataclasses.fields(default)}  # type: ignore[arg-type]
        settings = {
            name: value for name, value in self.settings.items() if name in fields
        }
        return dataclasses.replace(default, **settings)  # type: ignore[type-var]

    def torque(self, motion: Motion) -> Array:
        """Return the modelled torque of a motion.

        Parameters
        ----------
        motion : Motion
            Positions, velocities and accelerations at N instants.

        Returns
        -------
        (N, n) array
            Torque of each joint [N m, N].

        Raises
        ------
        InputError
            For anything but a Motion, such as a data frame.
        """
        if not isinstance(motion, Motion):
            what = f"torque(motion={type(motion).__name__}) takes a Motion"
            raise InputError(what, "give arrays of states to predict(q, dq, ddq)")
        return self.model.torque(self.theta, motion)

    def predict(
        self, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike, t: ArrayLike | None = None
    ) -> Array:
        """Return the modelled torque at states.

        Parameters
        ----------
        q, dq, ddq : (N, n) array
            Positions [rad, m], velocities and accelerations of the joints.
        t : (N,) array, optional
            Instants [s], needed where an effect depends on time or on earlier motion.

        Returns
        -------
        (N, n) array
            Torque of each joint [N m, N].

        Raises
        ------
        InputError
            For arrays of other shapes, and where t is needed.
        """
        n = self.robot.n
        named = {"q": q, "dq": dq, "ddq": ddq}
        states = [
            np.atleast_2d(as_plain_array(f"predict({name}=...)", x))
            for name, x in named.items()
        ]
        for name, x in zip(named, states, strict=True):
            if x.shape != states[0].shape or x.shape[1:] != (n,):
                raise wrong_shape(f"predict({name}=...)", x.shape, ("N", n), "state")
        count = len(states[0])
        if t is None:
            self._require_no_time()
            t = np.zeros(count)
        times = as_plain_array("predict(t=...)", t)
        if times.shape != (count,):
            what = f"predict(t=...): shape {times.shape}, but q has {count} rows"
            raise InputError(what, "give one time a row")
        return self.torque(Motion(times, states[0], states[1], states[2]))

    def controller(self) -> Any:
        """Return the model for a control loop: one state at a time, without allocation,
        about ten times as fast as :meth:`predict`.

        Returns
        -------
        ArmModel
            ``update(q, dq, ddq)`` takes one state (n,); then ``torque`` (n,) [N m, N] is
            the model's (:class:`~sdp_vs_penalty.online.arm.ArmModel`).

        Raises
        ------
        InputError
            For a model without links, and with an effect that needs more than one state.
        """
        return _ONLINE("ArmModel")(self.model, self.theta)

    def _require_no_time(self) -> None:
        """Raise InputError if an effect depends on time or on earlier motion."""
        for effect in self.model.effects:
            has_clock = any(s.role == "clock" for s in effect.shapes.values())
            if effect.has_memory or has_clock:
                what = f"predict(): {effect.name} depends on time"
                raise InputError(what, "pass t, (N,) in seconds")

    def plot(self, axes: Any = None) -> Any:
        """Draw link masses and the other effects' parameters with 95 % intervals.

        Parameters that the prior or the bounds determine are hatched.

        Parameters
        ----------
        axes : sequence of matplotlib Axes, optional
            One for each effect; default: a new figure.

        Returns
        -------
        sequence of matplotlib Axes
            The axes with the drawing.

        Raises
        ------
        InputError
            Where matplotlib is missing (extra [plot]).
        """
        table = self.to_frame()
        mass = table.index.str.fullmatch("m[0-9]+")
        by_effect = table[
            (table["effect"] != standard_effect("links").name) | mass
        ].groupby("effect", sort=False)
        size = (3.0 * len(by_effect), 2.6)
        panels = np.atleast_1d(
            formatting.axes(axes, 1, len(by_effect), figsize=size, layout="constrained")
        )
        for panel, (effect, parameters) in zip(panels, by_effect, strict=False):
            bars = panel.bar(
                parameters.index,
                parameters["value"],
                yerr=NORMAL_95 * parameters["std"].astype(float).fillna(0.0),
                capsize=2,
                color=AFTER,
            )
            for bar, source in zip(bars, parameters["source"], strict=True):
                if source != "data":  # the prior's or a bound's: not measured
                    bar.set(hatch="//", facecolor=NEUTRAL, alpha=0.5)
            panel.set(title=effect, ylabel=f"[{parameters['unit'].iloc[0]}]")
            panel.tick_params(axis="x", labelrotation=90)
        return panels

    def _summary(self) -> Summary:
        """Return the title and the (label, text) lines of the printed summary."""
        title = (
            f"Estimate: {self.problem.name}, {self.method}, {len(self.theta)}"
            " parameters"
        )
        names = dict.fromkeys(effect.name for effect in self.model.effects)
        samples = self.provenance["samples"]
        runs = ", ".join(self.provenance["runs"])
        violation, _, gap, *_ = self.certificate.summary()
        lines = [
            ("effects", ", ".join(names)),
            ("data", f"{samples} samples of {runs}"),
            violation,
            gap,
            ("from the data", f"{self.n_from_data} of {self.n_parameters} parameters"),
        ]
        if self.unweighed:
            lines.append(("masses", self.unweighed))
        if self.constants_at_ends:
            lines.append(("constants", self.constants_at_ends))
        return title, lines

    def _table(self) -> Table:
        """Return the printed table: one row a parameter with its 95 % interval."""
        rows = []
        for x in self.entries:
            # NaN marks an unknown interval and a parameter without a nominal value.
            half = "" if np.isnan(x.std) else f" ± {NORMAL_95 * x.std:.2g}"
            nominal = "" if np.isnan(x.nominal) else f"{x.nominal:.4g}"
            value = f"{x.value:.4g}{half}"
            rows.append((x.name, value, nominal, x.source, x.unit, x.effect))
        headings = ("parameter", "value ± 95 %", "nominal", "from", "unit", "effect")
        # Columns of words (by number) are aligned to the left.
        return Table(headings, rows, words=(0, 3, 4, 5))

    def to_frame(self) -> pandas.DataFrame:
        """Return a DataFrame of the parameters, indexed by name.

        Columns: value, std, ends of the 95 % interval, verdict, nominal value, source,
        unit, effect, joint.
        """
        import pandas

        return pandas.DataFrame(to_json(self.entries)).set_index("name")

    def as_written(self) -> ModelFile:
        """Return the record of model.json.

        The covariance holds only parameters with a known standard deviation (not NaN),
        with their names.
        """
        # Rows and columns of the covariance that are finite.
        with_std = np.flatnonzero(~np.isnan(self.uncertainty.std))
        covariance = self.uncertainty.covariance[np.ix_(with_std, with_std)]
        names = [p.name for p in self.model.parameters]
        # The package of each plug-in, "" for our own and for one that is not installed;
        # of these the file from which the model was read may name it.
        providers = {e.name: EFFECTS.provider(e.name) for e in self.model.effects}
        providers[self.method] = ESTIMATORS.provider(self.method)
        if isinstance(solver := self.settings.get("solver"), str):
            providers[solver] = SOLVERS.provider(solver)
        stated = self.provenance.get("plugins", {})
        plugins = {
            name: provider or stated[name]
            for name, provider in providers.items()
            if provider or name in stated
        }
        return ModelFile(
            format=FORMAT,
            problem=ProblemFields.from_problem(self.problem),
            method=self.method,
            settings=self.settings,
            parameters=self.entries,
            certificate=self.certificate,
            robot=self.robot,
            effects=tuple(e.entry for e in self.model.effects),
            preprocessing=self.preprocessing,
            uncertainty=self.uncertainty,
            details=self.report,
            provenance={**self.provenance, **({"plugins": plugins} if plugins else {})},
            known=dict(self.model.known),
            reference=self.model.reference,
            covariance=CovarianceBlock(tuple(names[k] for k in with_std), covariance),
            training_motion=self.training_motion,
        )

    @property
    def entries(self) -> tuple[ParameterEntry, ...]:
        """What is known of each parameter."""
        return tuple(
            ParameterEntry(
                **vars(interval) | {"value": float(value)},
                nominal=float(nominal),
                source=source,  # type: ignore[arg-type]
                effect=parameter.effect,
                joint=parameter.joint,
            )
            for parameter, value, interval, nominal, source in zip(
                self.model.parameters,
                self.theta,
                self.uncertainty.standard,
                self.nominal,
                self.sources,
                strict=True,
            )
        )

    @property
    def base_entries(self) -> tuple[ParameterEntry, ...]:
        """One entry a base parameter: value and interval, with the nominal value and the
        source that the report has; NaN and "data" where it has none."""
        report_by_name = {entry.name: entry for entry in self.report.base_parameters}
        not_in_report = BaseEntry("", np.nan)
        entries = []
        for interval in self.uncertainty.base:
            reported = report_by_name.get(interval.name, not_in_report)
            entries.append(
                ParameterEntry(
                    **vars(interval), nominal=reported.nominal, source=reported.source
                )
            )
        return tuple(entries)

    def require_joints(
        self, measurements: Measurements, what: str = "measurements"
    ) -> None:
        """Raise InputError unless the measurements have as many joints as the robot.

        ``what`` names the measurements in the message.
        """
        if measurements.n != self.robot.n:
            raise other_robot(measurements.n, self.robot.n, what, "model")

    def save(self, path: str | Path) -> None:
        """Write model.json atomically, with one field, or one record of a list, on each
        line; InputError for a model with an effect that no reader would find.
        """
        for effect in self.model.effects:
            kind = type(effect)
            if not EFFECTS.has(kind):
                raise InputError(
                    f"effect {effect.name} is not registered, so that no model.json with it"
                    " can be read",
                    f"call sdp_vs_penalty.register({kind.__name__}) before",
                    path,
                )
        fields = []
        for name, value in self.to_dict().items():
            text = json.dumps(value)
            is_list_of_records = (
                isinstance(value, list) and value and isinstance(value[0], dict)
            )
            if is_list_of_records:
                text = "[\n  " + ",\n  ".join(map(json.dumps, value)) + "\n ]"
            fields.append(f' "{name}": {text}')
        write_text(path, "{\n" + ",\n".join(fields) + "\n}\n")


def _given_intervals(
    intervals: Sequence[Interval], values: Sequence[float]
) -> tuple[Interval, ...]:
    """Return the intervals' names and units with values that no data gave: the standard
    deviations are unknown. Without intervals there are none."""
    if not intervals:
        return ()
    pairs = zip(intervals, values, strict=True)
    return tuple(Interval(old.name, old.unit, value) for old, value in pairs)


@checked_arguments
def load_estimate(path: str | Path) -> Estimate:
    """Read an Estimate from a model.json.

    Parameters
    ----------
    path : str or Path
        The file, as :meth:`Estimate.save` wrote it.

    Returns
    -------
    Estimate
        It predicts the same torques as the saved one, to the last bit.

    Raises
    ------
    InputError
        For a file that is no model.json, is incomplete, or comes from a newer version,
        or from an earlier one, which did not keep the problem.
    """
    return read_json(path, "model.json", "format", estimate_of_file)


def estimate_of_file(data: Mapping[str, Any]) -> Estimate:
    """Return the Estimate of the JSON of a model.json; InputError, with the path of the
    field, for a damaged one."""
    file = ModelFile.from_dict(data)
    problem = file.problem.problem(file.robot)
    plugins = file.provenance.get("plugins", {})
    effects = tuple(
        make_effect(e, problem.robot, plugins.get(e.effect, "")) for e in file.effects
    )
    model = Model(
        problem.robot, effects, file.reference, problem.gains, known=file.known
    )
    model.require_known("field known")
    entries = {entry.name: entry for entry in file.parameters}
    names = [parameter.name for parameter in model.parameters]
    for name in names:
        if name not in entries:
            what = f"there is no entry for the parameter {name}"
            raise InputError(what, "write the file anew", "field parameters")
    if file.reference is not None and file.reference.shape != (len(names),):
        what = f"not one number for each of {len(names)} parameters"
        raise InputError(what, "write the file anew", "field reference")
    return Estimate(
        problem=problem,
        model=model,
        theta=np.array([entries[name].value for name in names]),
        uncertainty=replace(
            file.uncertainty, standard=tuple(entries[name].interval for name in names)
        ),
        method=file.method,
        certificate=file.certificate,
        preprocessing=file.preprocessing,
        settings=dict(file.settings),
        report=file.details,
        provenance=_provenance_of_file(file.provenance),
        training_motion=file.training_motion,
    )


def _provenance_of_file(provenance: Mapping[str, Any]) -> dict[str, Any]:
    """Return where a model is from; issues of its runs say what they leave in doubt."""
    issues_by_run = provenance.get("checks") or {}
    older = {"in_doubt": doubts_in_words(provenance.get("verdict"))}
    checks = {
        run: [{**older, **issue} for issue in issues]
        for run, issues in issues_by_run.items()
    }
    return {**provenance, **({"checks": checks} if checks else {})}


#: One Estimate or the path of a model.json; a sequence of these; or a mapping from
#: names to these.
Models: TypeAlias = Any


def as_estimate(source: Estimate | str | Path, what: str) -> Estimate:
    """Return an Estimate as it is, or read it from a model.json.

    Parameters
    ----------
    source : Estimate, str or Path
        The model, or its file.
    what : str
        Name of the argument in messages, such as "diagnose(estimate=...)".

    Raises
    ------
    InputError
        If it is neither, or the file cannot be used.
    """
    if isinstance(source, Estimate):
        return source
    if isinstance(source, str | Path):
        return load_estimate(source)
    what = what.replace("...", quote_value(source))
    raise InputError("no model", "give an Estimate or the path of a model.json", what)


def as_estimates(
    models: Models,
    what: str = "models",
    read: Callable[[Any, str], Estimate] = as_estimate,
) -> dict[str, Estimate]:
    """Return models by name: their file's path, or else the method.

    In a sequence models without a file are numbered: "1 (lmi-sdp)".

    Parameters
    ----------
    what : str
        Name of the argument in messages.
    read : callable
        Makes an Estimate of one model; the second argument is ``what``.

    Raises
    ------
    InputError
        For no model at all, and as ``read`` does.
    """
    named = dict[str, Estimate]()
    if isinstance(models, Mapping):
        named = {str(name): read(model, what) for name, model in models.items()}
    else:
        several = isinstance(models, list | tuple)
        for k, model in enumerate(models if several else [models], start=1):
            estimate = read(model, what)
            name = f"{k} ({estimate.method})" if several else estimate.method
            if isinstance(model, str | Path):
                name = str(model)
            named[name] = estimate
    if not named:
        raise InputError("No model to compare", "name at least one model.json")
    return named
