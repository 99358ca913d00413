"""Effects as lines of C, traced from the columns that they compute with NumPy.

An effect states its law once, as columns of the motion. Here the same code runs on a
motion whose signals are names of C variables instead of numbers: each operation of
NumPy becomes the text of its C counterpart. An effect whose columns need more than q,
dq, ddq and the links' load at one instant has no closed form, and is left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any, cast

import numpy as np

from sdp_vs_penalty.effects.effect import Effect, Motion
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.exporters.content import number
from sdp_vs_penalty.robot.arrays import Array


class NoClosedFormError(Exception):
    """The columns of an effect need what C code of one instant does not have."""


#: How operations of NumPy are written in C.
_OPERATIONS: dict[Any, str] = {
    np.add: "({} + {})",
    np.subtract: "({} - {})",
    np.multiply: "{} * {}",
    np.divide: "{} / {}",
    np.negative: "(-{})",
    np.power: "pow({}, {})",
    np.square: "pow({}, 2.0)",
    np.absolute: "fabs({})",
    np.exp: "exp({})",
    np.log: "log({})",
    np.sinh: "sinh({})",
    np.cosh: "cosh({})",
    np.sqrt: "sqrt({})",
    np.tanh: "tanh({})",
    np.arctan: "atan({})",
    np.cos: "cos({})",
    np.sin: "sin({})",
    np.hypot: "hypot({}, {})",
    np.maximum: "fmax({}, {})",
    np.minimum: "fmin({}, {})",
}


class Expressions(np.lib.mixins.NDArrayOperatorsMixin):
    """Columns (1, k) of C expressions, which NumPy's functions take as an array."""

    def __init__(self, *texts: str) -> None:
        """Keep the C code of k columns."""
        self.texts = texts

    @property
    def shape(self) -> tuple[int, int]:
        """One row, k columns."""
        return 1, len(self.texts)

    def __len__(self) -> int:
        """The number of rows."""
        return 1

    def reshape(self, *shape: int) -> Expressions:
        """Return the columns as they are: they have one row in every shape."""
        return self

    def __array_ufunc__(
        self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any
    ) -> Expressions:
        """Write an operation of NumPy on columns as C."""
        if method != "__call__" or options or ufunc not in _OPERATIONS:
            raise NoClosedFormError(ufunc.__name__)
        operands = [_texts(x) for x in inputs]
        n_columns = max(len(texts) for texts in operands)
        rows = [texts * (n_columns // len(texts)) for texts in operands]
        if ufunc is np.divide:  # a / b * c is not a / (b * c)
            rows[1] = tuple(f"({b})" if " " in b else b for b in rows[1])
        form = _OPERATIONS[ufunc]
        return Expressions(*(form.format(*row) for row in zip(*rows, strict=True)))

    def __array_function__(
        self, function: Callable[..., Any], types: Any, args: Any, kwargs: Any
    ) -> Expressions:
        """Stack columns side by side; no other function of arrays has a C
        counterpart."""
        if function is not np.column_stack:
            raise NoClosedFormError(function.__name__)
        (columns,) = args
        return Expressions(*(text for x in columns for text in _texts(x)))

    def __array__(self, *args: Any, **options: Any) -> Array:
        """Refuse: code has no values."""
        raise NoClosedFormError("values")


def _texts(columns: Any) -> tuple[str, ...]:
    """Return the C code of columns: of expressions, or of numbers (1, k)."""
    if isinstance(columns, Expressions):
        return columns.texts
    return tuple(number(x) for x in np.atleast_1d(columns).ravel())


@dataclass(frozen=True)
class _Signal:
    """A C array with an entry a joint, read as NumPy reads the columns of (N, n)."""

    #: Name of the array.
    name: str

    def __getitem__(self, key: tuple[slice, int]) -> Expressions:
        """Return the entry of one joint (from 0), for ``signal[:, joint]``."""
        _, joint = key
        return Expressions(f"{self.name}[{joint}]")

    def __array__(self, *args: Any, **options: Any) -> Array:
        """Refuse: a variable has no values."""
        raise NoClosedFormError(self.name)


class _TracedMotion:
    """A motion at one instant ``t``, whose signals are variables of the C header."""

    t = np.zeros(1)
    q = _Signal("q")
    dq = _Signal("dq")
    ddq = _Signal("ddq")
    link_torque = _Signal("load")
    within = None

    def __init__(self, sign_width: Sequence[float]) -> None:
        """Keep the velocities (n,) [rad/s, m/s] over which the model's signs turn."""
        self.sign_width = sign_width

    def __getattr__(self, name: str) -> Any:
        """Refuse what the header does not have: a current model, a command, a past."""
        raise NoClosedFormError(name)

    def width(self, joint: int) -> float:
        """Return the velocity over which a joint's sign turns [rad/s, m/s]."""
        return self.sign_width[joint]

    def sign(self, joint: int, width: float | None = None) -> Any:
        """Return tanh(dq / width) of a joint, from 0."""
        return np.tanh(self.dq[:, joint] / (width or self.width(joint)))  # type: ignore[operator]

    def sign_ahead(self, joint: int, lead: float) -> Any:
        """Return tanh((dq + lead ddq) / width) of a joint, from 0."""
        velocity = self.dq[:, joint] + lead * self.ddq[:, joint]  # type: ignore[operator]
        return np.tanh(velocity / self.width(joint))

    def sign_along(self, ratios: Array, width: float | None = None) -> Any:
        """Return the smooth sign of a combination of velocities, ratios (n,)."""
        joints = np.flatnonzero(ratios).tolist()
        terms = [ratios[j] * self.dq[:, j] for j in joints]  # type: ignore[operator]
        velocity = reduce(np.add, terms)
        return np.tanh(velocity / (width or max(self.width(j) for j in joints)))


def has_closed_form(effect: Effect, estimate: Estimate) -> bool:
    """Return whether C code of one instant can compute an effect's torque."""
    return bool(_terms(effect, np.zeros(len(effect.parameters)), estimate))


def _terms(effect: Effect, theta: Array, estimate: Estimate) -> list[tuple[int, str]]:
    """Return the joints (from 0) on which an effect with parameters theta (k,) acts, and
    the C code of its torque there; nothing for an effect without a closed form."""
    if effect.has_memory or effect.follows_clock or effect.needs_torque:
        return []
    motion = cast(Motion, _TracedMotion(estimate.model.sign_width))
    try:
        blocks = effect.blocks(motion)
    except NoClosedFormError:
        return []
    out = []
    for block in blocks:
        columns = zip(block.parameters, _texts(block.columns), strict=True)
        products = [f"{number(theta[p])} * {column}" for p, column in columns]
        out.append((block.joint, " + ".join(products)))
    return out


def formulas(estimate: Estimate) -> Iterator[str]:
    """Yield a line of C for each effect of the model and each joint that it acts on.

    Effects without a closed form are left out.
    """
    for effect, indices in estimate.model.parts:
        for joint, term in _terms(effect, estimate.theta[indices], estimate):
            yield f"tau[{joint}] += {term}; /* {effect.name} */"
