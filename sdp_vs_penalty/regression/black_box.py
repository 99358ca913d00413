"""Gravity torques and inertia matrices of a robot whose dynamics can be asked for but not seen.

A manufacturer's library answers g(q) and M(q) at any configuration. Both are linear in the standard
parameters, so that their values at many configurations determine the base parameters: the reverse
engineering of Gaz, Flacco, De Luca (ICRA 2014, 2016) and of Gaz et al. 2019, sec. III.
"""

from __future__ import annotations

import hashlib
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from sdp_vs_penalty.data.formats.npz import numeric_arrays
from sdp_vs_penalty.effects.model import Model
from sdp_vs_penalty.errors import InputError, other_robot
from sdp_vs_penalty.regression.regression import Factor, Regression, TimeBlock, triangular
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.robot.robot import Robot

_ARRAYS = ("q", "gravity", "mass_matrix")
#: A library prints a few digits: M(q) may differ from its transpose by this share of its size.
_ASYMMETRY = 1e-3


@dataclass(frozen=True)
class BlackBox:
    """What a black box answered at K configurations.

    q (K, n) rad or m; gravity (K, n) joint torques at rest, N m or N; mass_matrix (K, n, n)
    symmetric joint-space inertia, kg m^2; names : where the answers come from.
    """

    q: Array
    gravity: Array
    mass_matrix: Array
    names: tuple[str, ...] = ("black box",)

    @property
    def n(self) -> int:
        return int(self.q.shape[1])

    @property
    def samples(self) -> int:
        return len(self.q)

    @cached_property
    def data_hash(self) -> str:
        """SHA-256 over the numbers."""
        digest = hashlib.sha256()
        for a in (self.q, self.gravity, self.mass_matrix):
            digest.update(repr(a.shape).encode())
            digest.update(np.ascontiguousarray(a, dtype="<f8").tobytes())
        return digest.hexdigest()

    @classmethod
    def of_links(cls, robot: Robot, links: ArrayLike, q: ArrayLike, name: str = "simulated") -> BlackBox:
        """The answers that links (n, 10), standard parameters, would give at q (K, n)."""
        q = np.asarray(q, float)
        rest = np.zeros_like(q)
        gravity = robot.inverse_dynamics(links, q, rest, rest)
        return cls(q, gravity, robot.mass_matrices(links, q), (name,))


def is_black_box(path: str | Path) -> bool:
    """Whether a file holds a black box's answers rather than a measured run."""
    if Path(path).suffix != ".npz" or not (Path(path).is_file() and zipfile.is_zipfile(path)):
        return False
    try:
        with zipfile.ZipFile(path) as archive:
            return "mass_matrix.npy" in archive.namelist()
    except (zipfile.BadZipFile, NotImplementedError, ValueError, OSError):
        return False  # whoever reads it as measurements says what is wrong


def load_black_box(path: str | Path, joints: int | None = None) -> BlackBox:
    """Read an .npz file with arrays q (K, n), gravity (K, n) and mass_matrix (K, n, n).

    Raises InputError where an array is missing, has another shape, or holds no finite numbers, and
    where the inertia matrices are not symmetric.
    """
    path = Path(path)
    arrays = numeric_arrays(path)
    missing = [name for name in _ARRAYS if name not in arrays]
    if missing:
        raise InputError(
            f"array {missing[0]} is missing",
            "give q (K, n), gravity (K, n) and mass_matrix (K, n, n)",
            path,
        )
    q, gravity, mass_matrix = (arrays[name] for name in _ARRAYS)
    if q.ndim != 2 or not q.size:
        raise InputError(f"array q has shape {q.shape}", "give one row a configuration", path)
    count, n = q.shape
    for name, a, shape in (
        ("gravity", gravity, (count, n)),
        ("mass_matrix", mass_matrix, (count, n, n)),
    ):
        if a.shape != shape:
            raise InputError(f"array {name} has shape {a.shape}", f"with this q give it {shape}", path)
    for name, a in (("q", q), ("gravity", gravity), ("mass_matrix", mass_matrix)):
        bad = np.argwhere(~np.isfinite(a))
        if len(bad):
            raise InputError(
                f"array {name}, configuration {bad[0][0] + 1}: not a finite number",
                "leave that configuration out",
                path,
            )
    if joints is not None and n != joints:
        raise other_robot(n, joints, path)
    difference = np.abs(mass_matrix - np.swapaxes(mass_matrix, 1, 2)).max(axis=(1, 2))
    worst = int(np.argmax(difference))
    if difference[worst] > _ASYMMETRY * np.abs(mass_matrix).max():
        raise InputError(
            f"array mass_matrix, configuration {worst + 1}: not symmetric",
            "give M(q) in full",
            path,
        )
    return BlackBox(q, gravity, mass_matrix, (path.name,))


def compress_black_box(box: BlackBox, model: Model) -> Regression:
    """Gravity rows and upper-triangle entries of M(q), reduced to one factor a joint.

    Row i of M(q) (its entries j >= i) and of g(q) belong to joint i: M(q)_ij is the torque on joint
    i from a unit acceleration of joint j, without gravity. Raises InputError for a model with
    effects other than the rigid body, which such answers do not contain.
    """
    if [effect.name for effect in model.effects] != ["rigid_body"]:
        raise InputError(
            "A black box answers gravity torque and inertia matrix only",
            "identify the one effect rigid_body",
        )
    robot, n = model.robot, model.robot.n
    rest = np.zeros_like(box.q)
    gravity = robot.regressor(box.q, rest, rest)
    parts: list[list[Array]] = [[] for _ in range(n)]
    columns = [
        (10 * np.array(links, np.intp)[:, None] + np.arange(10)).ravel().astype(np.intp)
        for links in robot.subtree
    ]

    def add(joint: int, rows: Array, values: Array) -> None:
        parts[joint].append(np.column_stack([rows[:, joint, columns[joint]], values]))

    for joint in range(n):
        add(joint, gravity, box.gravity[:, joint])
    for moved in range(n):
        unit = rest.copy()
        unit[:, moved] = 1.0
        inertial = robot.regressor(box.q, rest, unit) - gravity
        for joint in range(moved + 1):
            add(joint, inertial, box.mass_matrix[:, joint, moved])
    factors = tuple(
        Factor(joint, 0, columns[joint], triangular(stack), sum(len(rows) for rows in stack))
        for joint, stack in enumerate(parts)
    )
    return Regression(model.parameters, n, (TimeBlock(0, 0.0, 0.0),), factors, oversampling=1.0)


def load_configurations(path: str | Path, joints: int) -> Array:
    """(K, n) configurations [rad or m], one a line. Raises InputError for anything else."""
    try:
        q = np.loadtxt(path, ndmin=2)
    except (OSError, ValueError) as error:
        raise InputError(
            f"not a table of numbers ({error})", "give each line as many numbers", path
        ) from error
    if q.shape[1] != joints or not np.all(np.isfinite(q)):
        raise InputError(
            f"{q.shape[1]} numbers a line, or one that is not finite",
            f"give {joints} finite numbers a line",
            path,
        )
    return q


def as_black_box(source: Any, joints: int | None = None) -> BlackBox | None:
    """The black box in a path, or a list of one; None for anything else."""
    paths = source if isinstance(source, list | tuple) else [source]
    if not all(isinstance(path, str | Path) for path in paths):
        return None
    return load_answers(paths, joints)


def load_answers(paths: Sequence[str | Path], joints: int | None = None) -> BlackBox | None:
    """The black box in these files, or None where they are measured runs.

    Raises InputError where several files are given and one of them is a black box.
    """
    found = [path for path in paths if is_black_box(path)]
    if not found:
        return None
    if len(paths) > 1:
        raise InputError(
            f"a black box is identified from one file, not {len(paths)}", "name one", found[0]
        )
    return load_black_box(found[0], joints)
