"""Gravity torques and inertia matrices of a robot whose dynamics can be asked for but
not seen.

A manufacturer's library answers g(q) and M(q) at any configuration. Both are linear in
the standard parameters, so that their values at many configurations determine the base
parameters: the reverse engineering of Gaz, Flacco, De Luca (ICRA 2014, 2016) and of Gaz
et al. 2019, sec. III.
"""

from __future__ import annotations

import zipfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdp_vs_penalty.data.store import digest
from sdp_vs_penalty.effects import standard_effect
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.errors import InputError, other_robot
from sdp_vs_penalty.regression.regression import Factor, Regression, triangular
from sdp_vs_penalty.robot.arrays import Array, wrong_shape
from sdp_vs_penalty.robot.robot import Robot


@dataclass(frozen=True)
class BlackBox:
    """What a black box answered at K configurations."""

    #: (K, n) configurations [rad or m].
    q: Array
    #: (K, n) joint torques at rest [N m or N].
    gravity: Array
    #: (K, n, n) symmetric joint-space inertia [kg m^2].
    mass_matrix: Array
    #: Where the answers come from.
    names: tuple[str, ...] = ("black box",)

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.q.shape[1])

    @property
    def samples(self) -> int:
        """Number of configurations."""
        return len(self.q)

    @cached_property
    def data_hash(self) -> str:
        """SHA-256 over the numbers."""
        return digest((self.q, self.gravity, self.mass_matrix))

    @classmethod
    def from_links(cls, robot: Robot, links: ArrayLike, q: ArrayLike) -> BlackBox:
        """Return the answers that known links would give.

        - ``robot``: Robot with n joints.
        - ``links``: (links, 10) standard parameters.
        - ``q``: (K, n) configurations [rad, m].
        """
        q = np.asarray(q, float)
        zero = np.zeros_like(q)
        gravity = robot.inverse_dynamics(links, q, zero, zero)
        return cls(q, gravity, robot.mass_matrices(links, q), ("simulated",))


def load_answers(source: Any, joints: int | None = None) -> BlackBox | None:
    """Read a black box's answers from an .npz file.

    Returns None for anything else, such as measured runs.

    Parameters
    ----------
    source : path or list of path
        File with the arrays q (K, n), gravity (K, n), mass_matrix (K, n, n).

    Raises
    ------
    InputError
        If an array is missing, has another shape or is not finite, if mass matrices are
        not symmetric, or if such a file is one of several.
    """
    paths = list(source) if isinstance(source, list | tuple) else [source]
    answers = [
        Path(x) for x in paths if isinstance(x, str | Path) and _holds_answers(Path(x))
    ]
    if not answers:
        return None
    path = answers[0]
    if len(paths) > 1:
        raise InputError(
            f"a black box is identified from one file, not {len(paths)}",
            "name one",
            path,
        )
    from sdp_vs_penalty.data.formats.npz import numeric_arrays

    arrays = numeric_arrays(path)
    _check_shapes(arrays, path)
    q = arrays["q"]
    if joints is not None and q.shape[1] != joints:
        raise other_robot(q.shape[1], joints, path)
    matrices = arrays["mass_matrix"]
    transposed = np.swapaxes(matrices, 1, 2)
    difference = np.abs(matrices - transposed).max(axis=(1, 2))
    worst = int(np.argmax(difference))
    # A library prints a few digits.
    if difference[worst] > 1e-3 * np.abs(matrices).max():
        what = f"array mass_matrix, configuration {worst + 1}: not symmetric"
        raise InputError(what, "give M(q) in full", path)
    return BlackBox(q, arrays["gravity"], matrices, (path.name,))


def _holds_answers(path: Path) -> bool:
    """Return whether a file is an .npz with mass matrices.

    False for a damaged file: whoever reads it as measurements says what is wrong.
    """
    with suppress(zipfile.BadZipFile, NotImplementedError, ValueError, OSError):
        if path.suffix == ".npz" and path.is_file():
            with zipfile.ZipFile(path) as archive:
                return "mass_matrix.npy" in archive.namelist()
    return False


def _check_shapes(arrays: Mapping[str, Array], path: Path) -> None:
    """Raise InputError unless q (K, n), gravity (K, n) and mass_matrix (K, n, n) are
    usable.

    K configurations of n joints; a message names the array that is missing, has another
    shape, or holds a number that is not finite.
    """
    # K configurations of n joints; the others follow from the shape of q.
    q = arrays.get("q", np.zeros(0))
    if q.ndim != 2 or not q.size:
        raise InputError(
            f"array q has shape {q.shape}", "give one row a configuration", path
        )
    matrices = arrays.get("mass_matrix", np.zeros((0, q.shape[1], q.shape[1])))
    if q.shape[1] not in matrices.shape[1:2] and q.shape[0] in matrices.shape[1:2]:
        error = wrong_shape("array q", q.shape, q.shape[::-1], "configuration")
        raise error.within(path)
    shapes: dict[str, tuple[int, ...]] = {
        "q": q.shape,
        "gravity": q.shape,
        "mass_matrix": (*q.shape, q.shape[1]),
    }
    for name, shape in shapes.items():
        if name not in arrays:
            remedy = "give q (K, n), gravity (K, n) and mass_matrix (K, n, n)"
            raise InputError(f"array {name} is missing", remedy, path)
        array = arrays[name]
        if array.shape != shape:
            error = wrong_shape(f"array {name}", array.shape, shape, "configuration")
            raise error.within(path)
        not_finite = np.argwhere(~np.isfinite(array))
        if len(not_finite):
            configuration = not_finite[0][0] + 1
            what = f"array {name}, configuration {configuration}: not a finite number"
            raise InputError(what, "leave that configuration out", path)


def compress_black_box(box: BlackBox, model: Model) -> Regression:
    """Compress gravity torques and inertia matrices to one factor a joint.

    Row i of M(q) (its entries j >= i) and of g(q) belong to joint i: M(q)_ij is the
    torque on joint i from a unit acceleration of joint j, without gravity.

    Parameters
    ----------
    model : Model
        Of the one effect rigid_body.

    Raises
    ------
    InputError
        For a model with other effects, which such answers do not contain.
    """
    if [effect.simulator_field for effect in model.effects] != ["links"]:
        raise InputError(
            "A black box answers gravity torque and inertia matrix only",
            f"identify the one effect {standard_effect('links').name}",
        )
    robot = model.robot
    zero = np.zeros_like(box.q)
    # Regressors (K, n, p) of gravity, and of a unit acceleration of each joint.
    gravity = robot.regressor(box.q, zero, zero)
    inertial = []
    for unit_acceleration in np.eye(robot.n):
        accelerated = robot.regressor(box.q, zero, zero + unit_acceleration)
        inertial.append(accelerated - gravity)
    factors = []
    for joint in range(robot.n):
        equations = [(gravity, box.gravity[:, joint])]
        for k in range(joint, robot.n):
            equations.append((inertial[k], box.mass_matrix[:, joint, k]))
        factors.append(_factor_of_joint(model, joint, equations))
    block = (0, 0.0, 0.0)
    return Regression(
        model.parameters,
        joints=robot.n,
        blocks=(block,),
        factors=tuple(factors),
        oversampling=1.0,
    )


def _factor_of_joint(
    model: Model, joint: int, equations: Sequence[tuple[Array, Array]]
) -> Factor:
    """Return a joint's factor: the triangle of all its equations Y theta = torque, without
    the torque of known parameters. ``equations`` are pairs of a regressor (K, n, p) and
    the joint's torque (K,)."""
    links = np.array(model.robot.subtree[joint], np.intp)
    # A joint carries the links behind it, with ten parameters each.
    indices = (10 * links[:, None] + np.arange(10)).ravel()
    known = model.with_known(np.zeros(len(model.parameters)))
    is_free = ~np.isin(np.arange(len(known)), list(model.known_values))
    stack = []
    for regressor, torque in equations:
        rows = regressor[:, joint, indices]
        known_torque = rows @ known[indices]
        free_rows = rows * is_free[indices]
        stack.append(np.column_stack([free_rows, torque - known_torque]))
    n_rows = sum(map(len, stack))
    return Factor(joint, 0, indices, triangular(stack), n_rows)
