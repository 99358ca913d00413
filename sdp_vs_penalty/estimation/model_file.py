"""What a model.json holds: one record, whose types are the schema of the file.

The file is checked once, when it is read; everything behind relies on it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Literal

import numpy as np

from sdp_vs_penalty.effects.effect import EffectEntry
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.certificate import Certificate
from sdp_vs_penalty.estimation.shapes import ShapeEstimate
from sdp_vs_penalty.estimation.uncertainty import Interval, Uncertainty
from sdp_vs_penalty.estimation.verdict import NoiseFloor, Verdict
from sdp_vs_penalty.estimators import ESTIMATORS
from sdp_vs_penalty.files import require_format
from sdp_vs_penalty.problem.problem import ProblemFields
from sdp_vs_penalty.records import JsonRecord, from_json
from sdp_vs_penalty.results.issue import StoredIssue
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot
from sdp_vs_penalty.signals.motion import MotionRecord
from sdp_vs_penalty.signals.preprocessing import Preprocessing

#: What determines a parameter.
Source = Literal["data", "prior", "bounds", "given"]


@dataclass(frozen=True)
class ParameterEntry(Interval):
    """One parameter of the model: its interval, and where it belongs."""

    #: Value that the robot's file states; NaN where it has none.
    nominal: float = np.nan
    #: What determines the value.
    source: Source = "data"
    #: Name of the effect that the parameter belongs to.
    effect: str = ""
    #: Joint of the parameter, from 1; None for a parameter of the whole robot.
    joint: int | None = None

    def __post_init__(self) -> None:
        """Raise InputError for a value that is not finite."""
        if not np.isfinite(self.value):
            raise InputError("the value is not finite", "identify the model again")

    @property
    def interval(self) -> Interval:
        """What the data say of the parameter, alone."""
        return Interval(**{f.name: getattr(self, f.name) for f in fields(Interval)})


@dataclass(frozen=True)
class CovarianceBlock(JsonRecord):
    """Covariance of the parameters that the data determine, for other programs."""

    #: Names of the parameters.
    parameters: tuple[str, ...]
    #: (k, k) covariance, in the order of the names.
    matrix: Array


@dataclass(frozen=True)
class BaseEntry:
    """Where the value of a base parameter is from."""

    name: str
    value: float
    nominal: float = np.nan
    source: Source = "data"


@dataclass(frozen=True)
class LoopGain:
    """A gain of a servo's control loop."""

    value: float
    std: float
    unit: str


@dataclass(frozen=True)
class LoopFields:
    """The control loop beside a logged torque."""

    #: Delay of the command [s].
    delay: float
    #: Gains by name.
    gains: Mapping[str, LoopGain]
    #: (n,) share of each joint's squared torque that the law explains [-].
    share: tuple[float, ...]


@dataclass(frozen=True)
class ChannelGains:
    """Gains of the torque channels, from known loads: one a joint."""

    gain: tuple[float, ...]
    std: tuple[float, ...]


@dataclass(frozen=True)
class ServoFields:
    """The servo law that stands for a torque that was not logged."""

    #: Name of the law, a key of LAWS, or "as given".
    law: str
    #: Delay of the command [s].
    delay: float
    #: Origin of the model's scale, in words.
    scale: str
    #: Relative standard deviation of the scale [-].
    scale_error: float = 0.0
    #: Error of each law on motion left out, over that of the best law [-].
    held_out: Mapping[str, float] | None = None
    #: (n,) root mean square difference of simulated and measured positions [rad, m].
    motion: tuple[float, ...] = ()
    #: Joints, from 1, whose drive runs into its limit.
    limited: tuple[int, ...] = ()
    #: (n,) standard deviation of the torque's error [N m, N]; None where it is not
    #: known.
    torque_error: tuple[float | None, ...] = ()
    #: Values of the parameters that set the scale, by name.
    known: Mapping[str, float] | None = None
    #: Shape constants that were estimated.
    shapes: tuple[ShapeEstimate, ...] = ()


@dataclass(frozen=True)
class Recipe(JsonRecord):
    """How a log was prepared: what poses its problem again, by the names of
    :class:`~sdp_vs_penalty.estimation.build_problem.PoseOptions`."""

    effects: tuple[EffectEntry, ...] | None
    known: Mapping[str, float]
    instruments: str | None


@dataclass(frozen=True)
class Details(JsonRecord):
    """What method and posing report of an estimate.

    The method's own figures are plain JSON, beside the fields in a file.
    """

    #: Figures of the method, by name; nothing reads them again.
    of_method: Mapping[str, Any] = field(default_factory=dict)
    #: Bounds that the estimate lies on, in words; None without an optimisation.
    on_bounds: tuple[str, ...] | None = None
    #: What determines the parameters that the data do not, by their names.
    undetermined: Mapping[str, Source] = field(default_factory=dict)
    #: Where base parameters are from.
    base_parameters: tuple[BaseEntry, ...] = ()
    #: The servo's loop, beside a logged torque.
    loop: LoopFields | None = None
    #: Shape constants that were estimated.
    shapes: tuple[ShapeEstimate, ...] = ()
    #: The servo law, without a logged torque.
    servo: ServoFields | None = None
    #: How the log was prepared.
    recipe: Recipe | None = None
    #: Gains of the torque channels.
    gains: ChannelGains | None = None
    #: Shape constants of effects that were added, which lie at an end of their range:
    #: effect, joint from 0, name; None for a model to which nothing was added.
    at_ends: tuple[tuple[str, int, str], ...] | None = None

    @classmethod
    def upgraded(cls, data: Mapping[str, Any]) -> Mapping[str, Any]:
        """Gather what is no field as figures of the method."""
        names = {f.name for f in fields(cls)}
        return {**data, "of_method": {k: x for k, x in data.items() if k not in names}}

    def as_written(self) -> dict[str, Any]:
        """Return the figures of the method beside the fields that have a value."""
        stated = {k: x for k, x in vars(self).items() if x is not None}
        return stated.pop("of_method") | stated


@dataclass(frozen=True)
class ProvenanceFields:
    """Those entries of a provenance that the package reads again."""

    #: Hash of the training runs.
    data_hash: str
    #: Names of the training runs.
    runs: tuple[str, ...]
    #: Number of rows of all training runs.
    samples: int
    #: Versions of the packages that took part, by name.
    versions: Mapping[str, str]
    #: Packages, with their versions, of the plug-ins that it needs, by their names.
    plugins: Mapping[str, str] = field(default_factory=dict)
    #: Seed of random choices.
    seed: int | None = None
    #: Verdict on the training runs, or on those that the model was judged on.
    verdict: Verdict | None = None
    #: Noise floor of the training runs.
    noise: NoiseFloor | None = None
    #: Words of the command line after --data: files, and a window.
    data: tuple[str, ...] = ()
    #: The same words for the runs that the model was judged on.
    judged_data: tuple[str, ...] = ()
    #: Whether the runs passed the check; None if a version did not say it.
    checked: bool | None = None
    #: What the check found, by the runs' hashes.
    checks: Mapping[str, tuple[StoredIssue, ...]] | None = None
    #: Unit of the training runs' torques where they are none, such as "A".
    torque_unit: str = ""


#: Of model.json; a file with a larger number was written by a newer version of this
#: package. Format 1 did not keep the bounds under which a model was identified, and
#: nothing can bring them back.
FORMAT = 2


@dataclass(frozen=True)
class ModelFile(JsonRecord):
    """All of a model.json."""

    #: Format of the file.
    format: int
    #: Bounds and prior of the problem.
    problem: ProblemFields
    #: Name of the estimator.
    method: str
    #: Settings of the estimator, and how joints were weighted.
    settings: Mapping[str, Any]
    #: Parameters of the model.
    parameters: tuple[ParameterEntry, ...]
    #: Violations of constraints, and the distance to the optimum.
    certificate: Certificate
    #: The robot of the model.
    robot: Robot
    #: Effects of the model, in its order.
    effects: tuple[EffectEntry, ...]
    #: Filters, resolved.
    preprocessing: Preprocessing
    #: What the training runs say of the parameters, less the intervals above.
    uncertainty: Uncertainty
    #: What method and posing report.
    details: Details
    #: Where the model is from, as plain JSON; ProvenanceFields are read again.
    provenance: Mapping[str, Any]
    #: Values of known parameters, by name.
    known: Mapping[str, float] = field(default_factory=dict)
    #: Parameters that torque-dependent effects refer to; None without any.
    reference: Array | None = None
    #: Covariance for other programs; it follows from the uncertainty.
    covariance: CovarianceBlock | None = None
    #: Path of the training motion, where that was recorded.
    training_motion: MotionRecord | None = None

    @classmethod
    def upgraded(cls, data: Mapping[str, Any]) -> Mapping[str, Any]:
        """Raise InputError for a file of another format."""
        require_format(
            data,
            FORMAT,
            oldest=FORMAT,
            older="which did not keep the bounds of the model's problem",
            remedy="identify again",
        )
        return data

    def __post_init__(self) -> None:
        """Raise InputError for parts that are of another type, or belong to another
        robot."""
        _require(ProvenanceFields, self.provenance, "provenance")
        _require(_Weighting, self.settings, "settings")
        # A method that is not installed here is not known: its settings stay unchecked.
        kind = ESTIMATORS.find(self.method)
        if kind is not None:
            _require(kind, self.settings, "settings")
        self._check_joints()

    def _check_joints(self) -> None:
        """Raise InputError for arrays with another number of joints than the robot."""
        n = self.robot.n
        provenance = from_json(ProvenanceFields, self.provenance)
        noise, verdict = provenance.noise, provenance.verdict
        servo, loop = self.details.servo, self.details.loop
        gains = self.details.gains
        lists: dict[str, Any] = {
            "uncertainty.torque_noise": self.uncertainty.torque_noise,
            "provenance.noise.floor": noise and noise.floor,
            "provenance.verdict.error_over_noise": verdict and verdict.error_over_noise,
            "details.servo.motion": servo and (servo.motion or None),
            "details.loop.share": loop and loop.share,
            "details.gains.gain": gains and gains.gain,
            "details.gains.std": gains and gains.std,
        }
        sizes = {name: np.size(x) for name, x in lists.items() if x is not None}
        if self.training_motion is not None:
            # Of positions and velocities: 2 n.
            sizes["training_motion.centre"] = self.training_motion.centre.size - n
        for name, size in sizes.items():
            if size != n:
                raise InputError(
                    f"not as many numbers as the robot has joints, {n}",
                    "write the file anew",
                    f"field {name}",
                )


@dataclass(frozen=True)
class _Weighting:
    """How joints were weighted."""

    weighting: Literal["noise", "none"] = "noise"


def _require(kind: type[Any], data: Mapping[str, Any], name: str) -> None:
    """Raise InputError unless the fields of a record are of its types."""
    try:
        from_json(kind, data)
    except InputError as error:
        where = str(error.where or "").removeprefix("field ")
        path = f"field {name}.{where}".rstrip(".")
        raise InputError(error.what, error.remedy, path) from error
