"""What the data allow, as a table: least and greatest value of named functions of a model."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sdp_vs_penalty.arguments import checked_arguments, require_in_range
from sdp_vs_penalty.data.files import Source, as_measurements, windowed
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.parsing import time_windows
from sdp_vs_penalty.data.recorded import NamedRuns
from sdp_vs_penalty.errors import InputError, require_known
from sdp_vs_penalty.estimation.build_problem import EstimationProblem
from sdp_vs_penalty.estimation.constants import LEVEL
from sdp_vs_penalty.estimation.estimate import Estimate, as_estimate
from sdp_vs_penalty.estimation.proofs import posed_again
from sdp_vs_penalty.estimation.verdict import noise_level
from sdp_vs_penalty.estimators.estimator import Progress, no_progress
from sdp_vs_penalty.ranges.allowed import FAR, KINDS, AllowedSet, allowed_set
from sdp_vs_penalty.ranges.centres import inertias, ratios
from sdp_vs_penalty.ranges.ends import End, EndSearch, RangeEnd
from sdp_vs_penalty.ranges.functions import (
    TOTAL,
    Function,
    coefficients,
    functions_by_name,
)
from sdp_vs_penalty.records import JsonRecord
from sdp_vs_penalty.results.record import Record, Summary
from sdp_vs_penalty.results.table import Table
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.threads import on_one_thread

if TYPE_CHECKING:
    import pandas

#: What a range is of by default.
DEFAULT = ("masses",)


@dataclass(frozen=True)
class Range(JsonRecord):
    """Least and greatest value of one function over all consistent models that fit."""

    #: Name of the function, such as "m4".
    name: str
    #: Unit of its values.
    unit: str
    #: Least value under all constraints.
    least: RangeEnd
    #: Greatest value under all constraints.
    greatest: RangeEnd
    #: The model's own value.
    value: float = np.nan
    #: Value of the robot's file.
    nominal: float = np.nan
    #: Least and greatest value where the model may err as much unseen as seen; None
    #: where the residual is noise, or the noise is not known.
    with_model_error: tuple[float, float] | None = None
    #: Least and greatest value under fewer kinds of constraints, by the last kind:
    #: "consistency" alone, then with "bodies", with "bounds", and with "total".
    under: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    @property
    def relative_length(self) -> float:
        """Greatest minus least value, over the size of the model's value."""
        size = max(abs(self.value), np.finfo(float).tiny)
        return (self.greatest.value - self.least.value) / size

    @property
    def text(self) -> str:
        """Least and greatest value as one text."""
        return f"{_end_text(self.least)} to {_end_text(self.greatest)}"

    @property
    def sentence(self) -> str:
        """What is known of the function: its range, what decides each end, and the range
        where the model may err."""
        if self.with_model_error is None:
            return self._narrow_sentence
        wide = _pair(self.with_model_error)
        return f"{self._narrow_sentence} With the model's error: {wide} {self.unit}."

    @property
    def _narrow_sentence(self) -> str:
        """What is known where the model is right: the range, and what decides it."""
        below, above = self.least, self.greatest
        lower = _end_text(below)
        upper = f"{_end_text(above)} {self.unit}"
        if np.isinf(below.value) and np.isinf(above.value):
            return f"Nothing limits {self.name} on either side ({above.reason})."
        if np.isinf(above.value):
            least = f"{lower} {self.unit} ({below.reason})"
            return f"{self.name} is at least {least}; above, {_OPEN}."
        if np.isinf(below.value):
            return f"{self.name} is at most {upper} ({above.reason}); below, {_OPEN}."
        if below.reason == above.reason:
            return f"{self.name} lies between {lower} and {upper} ({below.reason})."
        return (
            f"{self.name} lies between {lower} ({below.reason}) and {upper}"
            f" ({above.reason})."
        )

    def __str__(self) -> str:
        """Return the sentence."""
        return self.sentence


@dataclass(frozen=True, repr=False)
class Ranges(Record, JsonRecord):
    """Ranges of a model's functions, and what they rest on."""

    #: Name of the problem.
    problem: str
    #: Probability with which a range is to hold the truth, of each by itself.
    level: float
    #: The ranges, in the order in which they were asked for.
    ranges: tuple[Range, ...]
    #: Share of the residual's squares that noise does not explain; None: not known.
    structure_share: float | None = None
    #: Mass [kg] and distance [m] beyond which no link is taken to be.
    far_limits: tuple[float, float] = (np.inf, np.inf)

    def __getitem__(self, name: str) -> Range:
        """Return the range of a name."""
        return {r.name: r for r in self.ranges}[name]

    @property
    def widest(self) -> Range | None:
        """The range of a mass whose length is largest beside its value, the total's not
        among them; None without one."""
        masses = [r for r in self.ranges if r.unit == "kg" and r.name != TOTAL]
        return max(masses, key=lambda r: r.relative_length, default=None)

    def _summary(self) -> Summary:
        """Return the title and the (label, text) lines of the printed summary."""
        lines = [(r.name, f"{r.text} {r.unit}") for r in self.ranges]
        return f"Ranges: {self.problem}, {100 * self.level:g} %", lines

    def table(self) -> Table:
        """Return one row a function: the model's value, the range, what decides it."""
        has_error = any(r.with_model_error for r in self.ranges)
        kinds = [k for k in KINDS if any(k in r.under for r in self.ranges)]
        headings = ["", "unit", "model", "nominal", "least", "greatest"]
        headings += ["with model error"] * has_error
        headings += [_UNDER[kind] for kind in kinds]
        headings += ["least decided by", "greatest decided by"]
        rows = []
        for r in self.ranges:
            row = [r.name, r.unit, _text(r.value), _text(r.nominal)]
            row += [_end_text(r.least), _end_text(r.greatest)]
            if has_error:
                row.append(_pair(r.with_model_error))
            row += [_pair(r.under.get(kind)) for kind in kinds]
            rows.append([*row, r.least.reason, r.greatest.reason])
        width = len(headings)
        return Table(
            headings,
            rows,
            words=(0, 1, width - 2, width - 1),
            title="Least and greatest value that these data allow, whatever the prior",
            notes=self.notes(),
        )

    _table = table  # as notebooks show it

    def notes(self) -> list[str]:
        """Return what the table rests on, a sentence each."""
        mass, distance = self.far_limits
        notes = [
            f"Every consistent model that fits these data has a value in its range, with"
            f" {100 * self.level:g} % probability for each range by itself. Each end is"
            " certified by a proof; a model that fits attains it, but where it is marked."
        ]
        if self._has_open_end:
            notes.append(
                "Open: nothing limits the end. A change of the links that no torque shows"
                " keeps them consistent however often it is made, or a centre is that of"
                " a mass that may be zero."
            )
        if any(FAR in e.limited_by for r in self.ranges for e in (r.least, r.greatest)):
            notes.append(
                "Far limit: the end holds as long as no link has more than"
                f" {mass:g} kg, or mass beyond {distance:.3g} m of its frame."
            )
        if any(e.is_outer for r in self.ranges for e in (r.least, r.greatest)):
            notes.append(
                "An end behind ~ is an outer bound: the true end may lie inside."
            )
        share = self.structure_share
        if share is None:
            notes.append(
                "The noise is not known: the model's own error may widen ranges."
            )
        elif share > 0.0:
            notes.append(
                f"Noise does not explain {100 * share:.0f} % of the residual's squares. With"
                " model error: the torque may err as much where the model can hide it as"
                " it does where one sees it. That is a definition, not a probability."
            )
        return notes

    @property
    def _has_open_end(self) -> bool:
        """Whether the table has an end that is open."""
        values = list[float]()
        for r in self.ranges:
            values += [r.least.value, r.greatest.value, *(r.with_model_error or ())]
            for ends in r.under.values():
                values += ends
        return bool(np.isinf(values).any())

    def to_frame(self) -> pandas.DataFrame:
        """Return a DataFrame with one row a function."""
        import pandas

        rows = []
        for r in self.ranges:
            least, greatest = r.with_model_error or (np.nan, np.nan)
            row = {
                "name": r.name,
                "unit": r.unit,
                "value": r.value,
                "nominal": r.nominal,
                "least": r.least.value,
                "greatest": r.greatest.value,
                "least decided by": r.least.reason,
                "greatest decided by": r.greatest.reason,
                "least with model error": least,
                "greatest with model error": greatest,
            }
            row |= {f"least, {kind}": ends[0] for kind, ends in r.under.items()}
            row |= {f"greatest, {kind}": ends[1] for kind, ends in r.under.items()}
            rows.append(row)
        return pandas.DataFrame(rows).set_index("name")


_OPEN = "nothing limits it"
#: Headings of the columns under fewer constraints.
_UNDER = {
    "consistency": "consistency alone",
    "bodies": "and bodies",
    "bounds": "and bounds",
    "total": "and total",
}


def _text(value: float) -> str:
    """Return a value as text: four digits, "0" for rounding of zero, "open" for an
    infinite one, "" for one that is not known (NaN)."""
    if np.isnan(value):
        return ""
    if np.isinf(value):
        return "open"
    return "0" if abs(value) < 1e-6 else f"{value:.4g}"


def _end_text(end: RangeEnd) -> str:
    """Return an end as text, an outer bound behind a tilde."""
    mark = "~" if end.is_outer and np.isfinite(end.value) else ""
    return mark + _text(end.value)


def _pair(ends: tuple[float, float] | None) -> str:
    """Return least and greatest value as one text; "" without them."""
    return "" if ends is None else f"{_text(ends[0])} to {_text(ends[1])}"


@on_one_thread
@checked_arguments
def find_ranges(
    model: Estimate | str | Path,
    data: Source | None = None,
    functions: Sequence[str] = DEFAULT,
    *,
    level: float = LEVEL,
    kinds: Sequence[str] = (),
    progress: Progress = no_progress,
) -> Ranges:
    """Return between which values functions of a model's parameters can lie at all, by
    data and physical consistency, whatever the prior.

    Parameters
    ----------
    model : Estimate, str or Path
        A model, or its file: effects, filters and constraints.
    data : path, arrays, Measurements, optional
        Default: those that the model was identified from, which the program holds or
        whose files are still there.
    functions : sequence of str
        Names such as "m4", "c4x", "I4xx", "total mass" and each parameter's, or
        "masses", "centres", "inertias", "moments", "parameters", "base".
    level : float
        Probability with which each range by itself is to hold the truth.
    kinds : sequence of str
        Kinds of constraints under which each range is shown as well, each with those
        before it: "consistency", "bodies", "bounds", "total".
    progress : callable
        Hears where the computation stands.

    Returns
    -------
    Ranges
        With a certified end on both sides of each function, and what decides it.

    Raises
    ------
    InputError
        For an unknown function, and where the model's own data are gone and no others
        are named.

    Examples
    --------
    >>> from sdp_vs_penalty import find_ranges, identify, simulate
    >>> model = identify("two_link", simulate("two_link", seed=1).train)
    >>> mass = find_ranges(model)["m2"]
    >>> bool(mass.least.value <= model.links[1, 0] <= mass.greatest.value)
    True
    """
    require_in_range("find_ranges(level=...)", level, 0.5, 0.9999)
    for kind in kinds:
        require_known("kind of constraints", kind, KINDS)
    estimate = as_estimate(model, "find_ranges(model=...)")
    progress("posing the problem")
    posed, floor = training_of(estimate, data)
    progress("what the data allow")
    allowed = allowed_set(posed, estimate.theta, floor, level)
    return ranges_of(posed, estimate.theta, allowed, functions, kinds, progress)


def find_end(
    model: Estimate | str | Path,
    function: str,
    side: str,
    data: Source | None = None,
    *,
    level: float = LEVEL,
) -> End:
    """Return one end of a linear function's range, with its witness and its proof.

    Parameters
    ----------
    function : str
        Such as "m4"; a centre of mass or an inertia about it is not linear.
    side : {"least", "greatest"}
        Which of the two ends.

    Returns
    -------
    End
        ``witness`` (p,) is a consistent model that fits; ``proof`` is what `verify`
        accepts.

    Raises
    ------
    InputError
        For an unknown or nonlinear function, and as :func:`find_ranges` does.
    """
    require_known("end", side, ("least", "greatest"))
    estimate = as_estimate(model, "find_end(model=...)")
    posed, floor = training_of(estimate, data)
    g = coefficients(posed.problem, posed.task.model, function)
    allowed = allowed_set(posed, estimate.theta, floor, level)
    ((least, greatest),) = EndSearch(allowed).least_and_greatest([g])
    return least if side == "least" else greatest


def training_of(
    estimate: Estimate, data: Source | None
) -> tuple[EstimationProblem, Array | None]:
    """Return the identification problem of a model and data, and the noise floor (n,)
    [N m, N] of the data, None where it is not known.

    Without ``data`` they are those that the model was identified from: held by the
    program, or read from their files. Raises InputError where neither is there.
    """
    training = estimate.training
    if data is None and training is not None:
        posed = training.posed
        if posed.task.model is estimate.model:
            return posed, _floor_of(estimate)
    runs = _recorded_runs(estimate) if data is None else _runs_of(estimate, data)
    posed = posed_again(estimate, runs)
    if posed is None or posed.runs is None:
        what = "these data have no torque, and the model does not say what replaced it"
        raise InputError(what, "identify the model from them first")
    is_own = posed.measurements.data_hash == estimate.provenance.get("data_hash")
    if is_own and estimate.provenance.get("noise"):
        return posed, _floor_of(estimate)
    return posed, noise_level(posed.problem, posed.runs)[0]


def _recorded_runs(estimate: Estimate) -> Measurements:
    """Read the runs that a model was identified from, from the files that it names, and
    cut them to its window of time."""
    recorded = NamedRuns.recorded(estimate.provenance.get("data") or ())
    if recorded is None:
        raise InputError(
            "ranges need the measurements: the model names no files of them that"
            " are still there",
            "name them (data=..., --data)",
        )
    runs = _runs_of(estimate, list(recorded.files), as_written=recorded.as_written)
    return windowed(runs, time_windows(recorded.window))


def _runs_of(
    estimate: Estimate, data: Source, as_written: bool = False
) -> Measurements:
    """Read runs of a model's robot; with ``as_written`` the files' names of columns and
    units count, whatever the values suggest."""
    robot = estimate.robot
    return as_measurements(
        data, robot.n, robot.joint_names, "find_ranges(data=...)", as_written=as_written
    )


def _floor_of(estimate: Estimate) -> Array | None:
    """Return the noise floor (n,) [N m, N] of a model's own data, None unless the model
    has it for all joints."""
    floor = (estimate.provenance.get("noise") or {}).get("floor")
    if floor is None or any(x is None for x in floor):
        return None
    return np.asarray(floor, float)


def ranges_of(
    posed: EstimationProblem,
    theta: Array,
    allowed: AllowedSet,
    names: Sequence[str] = DEFAULT,
    kinds: Sequence[str] = (),
    progress: Progress = no_progress,
) -> Ranges:
    """Return the ranges of functions of a model.

    Parameters
    ----------
    posed : EstimationProblem
        The identification problem of the data.
    theta : (p,) array
        Parameters of the identified model.
    allowed : AllowedSet
        What data and constraints allow.
    names : sequence of str
        Functions, or words for groups of them (:mod:`~ranges.functions`).
    kinds : iterable of str
        Kinds of constraints, of KINDS, under which each range is shown as well: each
        with those before it.
    """
    task = posed.task
    functions = functions_by_name(posed.problem, task.model, names)
    ends = _ends(allowed, functions)
    progress("with the model's error, and under fewer constraints")
    values = [(least.value, greatest.value) for least, greatest in ends]
    structure = allowed.ball.structure
    with_error = None
    if structure > 0.0:
        with_error = _widened_to_hold(values, _ends(allowed, functions, structure))
    # From the most constraints to the fewest: each set holds the one before it.
    values_by_kind = dict[str, list[tuple[float, float]]]()
    for kind in sorted(kinds, key=KINDS.index, reverse=True):
        larger = allowed.with_kinds(KINDS[: KINDS.index(kind) + 1])
        values = _widened_to_hold(values, _ends(larger, functions))
        values_by_kind[kind] = values
    nominal = posed.problem.nominal(task.model)
    mass, distance = posed.problem.link_defaults.max(axis=0).tolist()
    return Ranges(
        problem=posed.problem.name,
        level=allowed.level,
        ranges=tuple(
            Range(
                name=f.name,
                unit=f.unit,
                least=ends[k][0],
                greatest=ends[k][1],
                value=f.value(theta, task.links),
                nominal=f.value(nominal, task.links),
                with_model_error=None if with_error is None else with_error[k],
                under={kind: values_by_kind[kind][k] for kind in kinds},
            )
            for k, f in enumerate(functions)
        ),
        structure_share=(
            None if allowed.floor is None else structure / allowed.ball.loss_ls
        ),
        far_limits=(mass, distance),
    )


def _widened_to_hold(
    inner: Sequence[tuple[float, float]], ends: Sequence[tuple[RangeEnd, RangeEnd]]
) -> list[tuple[float, float]]:
    """Return the values (least, greatest) of ``ends``, widened to hold those of a smaller
    set, ``inner``: two searches end near, not at, the true ends, so that the larger
    set's range may come out a little shorter."""
    return [
        (min(least.value, inner_least), max(greatest.value, inner_greatest))
        for (least, greatest), (inner_least, inner_greatest) in zip(
            ends, inner, strict=True
        )
    ]


def _ends(
    allowed: AllowedSet, functions: Sequence[Function], extra_rise: float = 0.0
) -> list[tuple[RangeEnd, RangeEnd]]:
    """Return least and greatest end of each function over a set, whose models may have
    ``extra_rise`` [(N m)^2] more loss.

    Functions about a link's centre of mass need the range of its mass, too.
    """
    search = EndSearch(allowed, extra_rise)
    model = allowed.task.model
    unit = np.eye(len(model.parameters))
    g_by_name = {f.name: f.g for f in functions if f.g is not None}
    places = [f.place for f in functions if f.place is not None]
    mass_names = {}
    for link in sorted({link for link, _ in places}):
        mass = allowed.task.links[link, 0]
        mass_names[link] = model.parameters[mass].name
        g_by_name.setdefault(mass_names[link], unit[mass])
    linear_ends = search.least_and_greatest(list(g_by_name.values()))
    ends_by_name = dict(zip(g_by_name, linear_ends, strict=True))
    mass_ends = {link: ends_by_name[name] for link, name in mass_names.items()}
    ends_by_place = _ends_about_centres(search, places, mass_ends)
    ends = []
    for f in functions:
        if f.place is None:
            least, greatest = ends_by_name[f.name]
            ends.append((RangeEnd.from_end(least), RangeEnd.from_end(greatest)))
        else:
            ends.append(ends_by_place[f.place])
    return ends


def _ends_about_centres(
    search: EndSearch,
    places: Sequence[tuple[int, int]],
    mass_ends: Mapping[int, tuple[End, End]],
) -> dict[tuple[int, int], tuple[RangeEnd, RangeEnd]]:
    """Return least and greatest end of coordinates of centres of mass, and of inertias
    about them.

    A coordinate is the ratio m c / m of two parameters; an inertia about the centre of
    mass needs the ranges of all three coordinates.

    Parameters
    ----------
    places : sequence of (link, entry)
        Link, and entry among its ten barycentric parameters, both from 0: entries 1 to
        3 are coordinates, those from 4 inertias.
    mass_ends : dict
        Least and greatest mass by link.

    Returns
    -------
    dict
        Ends by (link, entry).
    """
    indices = search.allowed.task.links  # (links, 10) places of the links' parameters
    unit = np.eye(len(search.allowed.task.model.parameters))
    entries = {k: [entry for link, entry in places if link == k] for k in mass_ends}
    coordinates = [
        (link, axis)
        for link in mass_ends
        for axis in (1, 2, 3)
        if axis in entries[link] or max(entries[link]) >= 4
    ]
    ends = ratios(
        search,
        numerators=[unit[indices[place]] for place in coordinates],
        masses=[mass_ends[link] for link, _ in coordinates],
        denominators=[unit[indices[link, 0]] for link, _ in coordinates],
    )
    ends_by_place = dict(zip(coordinates, ends, strict=True))
    for link in mass_ends:
        moments = [entry for entry in entries[link] if entry >= 4]
        if moments:
            centre = [ends_by_place[link, axis] for axis in (1, 2, 3)]
            ends = inertias(search, indices[link], moments, centre)
            moment_places = [(link, entry) for entry in moments]
            ends_by_place |= dict(zip(moment_places, ends, strict=True))
    return ends_by_place
