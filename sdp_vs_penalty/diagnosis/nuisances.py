"""What a law and a mounting get wrong: columns beside terms, of which little is
expected.

Nobody mounts an arm exactly: what a term explains has to show beside placements of the
joints that are off by as much as their effect says is plausible, unless that is what
the term says.

No law is exact (Kennedy, O'Hagan, J. R. Statist. Soc. B 2001). Beside a term that makes
the torque c of a joint a fit has

    sum_i a_i c g_i + sum_s a_s dc/ds,    a ~ N(0, diag(d)^2),    g = t, v, |v|, v^2, q, q^2, q v

with the time t and the joint's velocity v and position q in units of their largest, s
its free shape constants, and c by itself where the term acts on several joints.
Together they are expected to make, beyond the model, 4 % of the squares that the term
makes there. What is found besides has to show beyond that.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property

import numpy as np

from sdp_vs_penalty.diagnosis.constants import EVIDENCE_TO_DISTINGUISH, LAW_TOLERANCE
from sdp_vs_penalty.diagnosis.events import hum_lines
from sdp_vs_penalty.diagnosis.library import Candidate, Nuisance
from sdp_vs_penalty.diagnosis.linear_fit import ScoredEffect, Term, WhiteFit
from sdp_vs_penalty.diagnosis.refit import least_squares_refit
from sdp_vs_penalty.diagnosis.rules import Rules
from sdp_vs_penalty.diagnosis.white_rows import WhiteData, spread_columns
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.estimation.sensitivity import ShapeSensitivity, free_constants
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one
from sdp_vs_penalty.signals.segments import SegmentedRuns

#: How far from a spectrum's line its frequency may be [Hz], and into how many steps that
#: is divided: periods of five seconds tell no more, whole runs do.
_NEAR_LINE = 0.1
_NEAR_STEPS = 40


def law_misfit_columns(
    data: WhiteData,
    effect: Effect,
    beta: Array,
) -> dict[int, Array]:
    """(M, k) white columns of what the law of an effect with parameters beta may get
    wrong, by joint whose torque it changes."""
    rows = data.rows
    torque = spread_columns(rows, effect) @ beta
    by_constants = np.zeros((*torque.shape, 0))
    if free_constants(effect):
        by_constants = spread_columns(rows, ShapeSensitivity(effect, beta))
    joints = np.flatnonzero(torque.any(axis=1)).tolist()
    out = dict[int, Array]()
    for j in joints:
        t = _in_units_of_largest(rows.t - rows.t.mean())
        v = _in_units_of_largest(rows.dq[:, j])
        q = _in_units_of_largest(rows.q[:, j] - rows.q[:, j].mean())
        factors = [
            t,
            v,
            np.abs(v),
            v**2,
            q,
            q**2,
            q * v,
        ]
        if len(joints) > 1:
            factors.append(np.ones(len(v)))
        columns = np.column_stack(
            [
                *(torque[j] * g for g in factors),
                by_constants[j],
            ]
        )
        out[j] = data.white(columns, j)
    return out


def _in_units_of_largest(x: Array) -> Array:
    """(N,) divided by its largest magnitude."""
    return np.asarray(x / nonzero_or_one(np.abs(x).max()))


def find_frequencies(data: WhiteData) -> dict[int, list[float]]:
    """By joint the frequencies [Hz] of its hums, of joints that have any."""
    rows = data.rows
    residual = rows.residual
    if not data.noise.repeats:  # the model is fitted to it at other parameters
        residual = least_squares_refit(data, [])[1]
    return {
        j: [
            _refined(
                f,
                rows,
                residual[:, j],
            )
            for f in lines
        ]
        for j, lines in hum_lines(data, residual).items()
    }


def hums(data: WhiteData, frequencies: Mapping[int, Sequence[float]]) -> list[Nuisance]:
    """By joint the waves of its hums, of any phase in each run.

    A wave may be as large as all that the model leaves.
    """
    rows = data.rows
    out = []
    for j, lines in frequencies.items():
        waves = []
        for f in lines:
            angle = 2.0 * np.pi * f * rows.t
            for run in np.unique(rows.run):
                inside = rows.run == run
                waves += [
                    inside * np.sin(angle),
                    inside * np.cos(angle),
                ]
        size = float(np.std(rows.residual[:, j]))
        columns = data.white(np.column_stack(waves), j)
        deviations = np.full(len(waves), max(size, 1e-200))
        out.append(Nuisance(f"hum on {j}", {j: columns}, deviations))
    return out


def _refined(frequency: float, rows: SegmentedRuns, residual: Array) -> float:
    """The frequency [Hz] near one of a short spectrum's at which a residual (M,) has most
    power in whole runs."""
    near = frequency + np.linspace(-_NEAR_LINE, _NEAR_LINE, 2 * _NEAR_STEPS + 1)
    power = np.zeros(len(near))
    for run in np.unique(rows.run):
        inside = rows.run == run
        turned = np.exp(-2j * np.pi * np.outer(near, rows.t[inside]))
        power += np.abs(turned @ residual[inside]) ** 2
    return float(near[np.argmax(power)])


class Nuisances:
    """What stands beside terms in a fit, on some rows and with some candidates.

    bare : the model alone; columns : of a candidate, white, by joint.
    """

    def __init__(
        self,
        data: WhiteData,
        bare: WhiteFit,
        candidates: Sequence[Candidate],
        columns: Callable[[Candidate], dict[int, Array]],
        rules: Rules,
    ) -> None:
        self.data = data
        self.bare = bare
        self.rules = rules
        self._candidates = candidates
        self._columns = columns
        self._misfits: dict[str, list[tuple[int, Array, Array]]] = {}

    def with_law_misfits(self, terms: Sequence[ScoredEffect]) -> list[Term]:
        """Terms, what the laws of those that explain much may get wrong, and hums."""
        out: list[Term] = [*terms, *self.hums]
        for t in terms:
            if LAW_TOLERANCE * t.evidence > EVIDENCE_TO_DISTINGUISH:
                out += self.law_misfits(t)
        return out

    def around(
        self,
        term: ScoredEffect,
        others: Sequence[ScoredEffect],
    ) -> list[Term]:
        """Beside what a term has to show: others, what their laws get wrong, and what is
        tolerated of a mounting."""
        tolerated = self.mounting_tolerances_beside(term, others)
        return [*self.with_law_misfits(others), *tolerated]

    def mounting_tolerances_beside(
        self,
        term: ScoredEffect,
        others: Sequence[ScoredEffect],
    ) -> list[Nuisance]:
        """As much of what is in every machine as is plausible, where no term says it."""
        named = {
            term.form.effect.form_of,
            term.key[0],
            *(t.key[0] for t in others),
        }
        return [m for name, m in self.mounting_tolerances.items() if name not in named]

    @cached_property
    def mounting_tolerances(self) -> dict[str, Nuisance]:
        """By effect what is tolerated of it in every machine."""
        if not self.rules.mounting_tolerances:
            return {}
        return {
            f.key[0]: Nuisance(f"misfit of {f.key[0]}", self._columns(f), f.plausible)
            for f in self._candidates
            if f.effect.tolerance
        }

    @cached_property
    def hums(self) -> list[Nuisance]:
        """Waves of the lines that stand in the torque's spectrum: no constant of the
        model is estimated anew for what happens beside it."""
        return hums(self.data, self.frequencies)

    @cached_property
    def frequencies(self) -> dict[int, list[float]]:
        """By joint those of its hums [Hz]; a search beside another model keeps them."""
        found = find_frequencies(self.data)
        return found if found and self.rules.hums_first else {}

    def law_misfits(self, term: ScoredEffect) -> list[Nuisance]:
        """What a term's law may get wrong, joint by joint.

        There is none of another constant of the model's own effect.
        """
        if term.form.replaces_own_constant or not self.rules.law_misfits:
            return []
        if term.text not in self._misfits:
            columns = law_misfit_columns(self.data, term.form.effect, term.beta)
            self._misfits[term.text] = [
                (j, z, self._squares_beyond_model({j: z})) for j, z in columns.items()
            ]
        expected = LAW_TOLERANCE * np.maximum(term.squares, 1e-200)
        return [
            Nuisance(
                text=f"misfit of {term.text} on {j}",
                columns={j: z},
                deviations=np.sqrt(expected[j] / len(squares) / squares),
            )
            for j, z, squares in self._misfits[term.text]
        ]

    def _squares_beyond_model(self, columns: dict[int, Array]) -> Array:
        """(k,) squares of what the model leaves of white columns."""
        left = self.bare.residual_of(self.bare.scaled(columns))
        left = left * self.bare.level[:, None, None]
        return np.maximum(np.sum(left**2, axis=(0, 1)), 1e-200)
