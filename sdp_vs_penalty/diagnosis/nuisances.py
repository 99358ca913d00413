"""Small errors of friction laws that are tolerated beside effects. Each is columns with
a small prior, so that it can explain a little and not much.

No law is exact (Kennedy, O'Hagan, J. R. Statist. Soc. B 2001). Beside an effect that
makes the torque c on a joint, a fit has

    sum_i a_i c g_i + sum_s a_s dc/ds,    a ~ N(0, diag(d)^2),
    g = t, v, |v|, v^2, q, q^2, q v

with time t and the joint's velocity v and position q in units of their largest
magnitude, s the effect's free shape constants, and c itself where the effect acts on
several joints. The standard deviations d are such that all of these are expected to
make 4 % of the squares that the effect makes beyond the model. Other effects have to
show beyond that.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from sdp_vs_penalty.diagnosis.constants import EVIDENCE_TO_DISTINGUISH, LAW_TOLERANCE
from sdp_vs_penalty.diagnosis.library import Nuisance
from sdp_vs_penalty.diagnosis.linear_fit import ScoredEffect, Term, WhiteFit
from sdp_vs_penalty.diagnosis.white_rows import WhiteData, spread_columns
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.estimation.sensitivity import ShapeSensitivity, free_constants
from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one

#: Functions g by which a law's torque may be wrong: t, v, |v|, v^2, q, q^2, q v.
N_FACTORS = 7


def share_of_one_misfit(effect: Effect) -> float:
    """Return the share of what an effect explains that one of its misfits is expected
    to make.

    All misfits, N_FACTORS and the free shape constants, make 4 % (LAW_TOLERANCE).
    """
    return LAW_TOLERANCE / (N_FACTORS + len(free_constants(effect)))


def law_misfit_columns(
    data: WhiteData, effect: Effect, beta: Array
) -> dict[int, Array]:
    """Return white columns of torque by which an effect's law may be wrong.

    They are the effect's torque times t, v, |v|, v^2, q, q^2 and q v (time, velocity
    and position, over their largest magnitudes), and its derivatives by the free shape
    constants. No law of friction, for example, holds exactly over all velocities.

    Parameters
    ----------
    beta
        (k,) its parameters, in SI units.

    Returns
    -------
    dict of int to (M, columns) array
        By joint (from 0) on which it makes torque.
    """
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
        factors = [t, v, np.abs(v), v**2, q, q**2, q * v]
        if len(joints) > 1:
            factors.append(np.ones(len(v)))  # the joints' sizes may differ
        by_factors = [torque[j] * g for g in factors]
        columns = np.column_stack([*by_factors, by_constants[j]])
        out[j] = data.white(columns, j)
    return out


def _in_units_of_largest(x: Array) -> Array:
    """Divide x (N,) by its largest magnitude; an array of zeros stays."""
    return x / nonzero_or_one(np.abs(x).max())


class Nuisances:
    """The nuisances of a search: small errors that its fits tolerate beside effects.

    These are errors of effects' laws.
    """

    def __init__(self, data: WhiteData, bare: WhiteFit) -> None:
        """Prepare the nuisances of a search.

        Parameters
        ----------
        bare
            The fit of the model alone.
        """
        self.data = data
        self.bare = bare
        self._misfits: dict[str, list[tuple[int, Array, Array]]] = {}

    def with_law_misfits(self, terms: Sequence[ScoredEffect]) -> list[Term]:
        """Return the effects, and the misfits of their laws.

        Misfits are nuisances for what a law gets wrong. They are added for an effect if
        4 % (LAW_TOLERANCE) of its evidence is more than 6: an error of its law could
        then look like another effect.
        """
        out: list[Term] = [*terms]
        for t in terms:
            if LAW_TOLERANCE * t.evidence > EVIDENCE_TO_DISTINGUISH:
                out += self.law_misfits(t)
        return out

    def law_misfits(self, term: ScoredEffect) -> list[Nuisance]:
        """Return one nuisance a joint: columns by which an effect's law may be wrong.

        The prior lets all columns of a joint together explain 4 % (LAW_TOLERANCE) of
        the squares that the effect explains: with E, a column's share of these, and S,
        the column's squares, its standard deviation is sqrt(E / S). The list is empty
        for a re-estimated shape constant of the model.
        """
        if term.form.replaces_own_constant:
            return []
        if term.text not in self._misfits:
            columns = law_misfit_columns(self.data, term.form.effect, term.beta)
            self._misfits[term.text] = [
                (j, z, self._squares_beyond_model({j: z})) for j, z in columns.items()
            ]
        expected_squares = LAW_TOLERANCE * np.maximum(term.squares, 1e-200)  # (n,)
        out = []
        for j, z, squares in self._misfits[term.text]:
            expected_of_column = expected_squares[j] / len(squares)
            nuisance = Nuisance(
                text=f"misfit of {term.text} on {j}",
                columns={j: z},
                deviations=np.sqrt(expected_of_column / squares),
            )
            out.append(nuisance)
        return out

    def _squares_beyond_model(self, columns: dict[int, Array]) -> Array:
        """Return the sums of squares (k,) of white columns beyond the model's columns.

        The fit divides rows by its levels; these are undone, so that the squares are in
        units of the noise variance.
        """
        remaining = self.bare.residual_of(self.bare.scaled(columns))
        remaining = remaining * self.bare.level[:, None, None]
        return np.maximum(np.sum(remaining**2, axis=(0, 1)), 1e-200)
