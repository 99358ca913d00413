"""What a conic solver declares, and how any of them is asked.

A subclass of :class:`Solver` in a file of this folder is its registration: it says what
the solver takes and is told, and runs it on a problem of that form. Rewriting the
problem, reading the answer back and finding out what is installed are here, once.
"""

import importlib.util
import shutil
import subprocess
from abc import ABC, abstractmethod
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from importlib import metadata
from typing import Any, ClassVar

import numpy as np
import scipy

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.plugins import summary_line
from sdp_vs_penalty.robot.arrays import Array
from sdp_vs_penalty.solvers.conic import Cone, ConicProblem, Solution
from sdp_vs_penalty.solvers.rewrite import full_matrices, suited

#: Stands in :attr:`Solver.default_options` for the accuracy that is asked for.
ACCURACY = "accuracy"
#: All kinds of cones, and a quadratic objective.
EVERYTHING = frozenset({"quadratic", "zero", "nonnegative", "soc", "psd", "exp"})
#: What SDPA's phases claim of our problem, which is the (P) of its manual; so do
#: the phases that its wheel returns.
SDPA_CLAIMS = {
    "pdOPT": "optimal",
    # pdINF: primal or dual is infeasible, or both; CVXPY reads it as here.
    **dict.fromkeys(("pINF_dFEAS", "dUNBD", "pdINF"), "infeasible"),
    **dict.fromkeys(("pdFEAS", "pFEAS", "dFEAS"), "inaccurate"),
    **dict.fromkeys(("pFEAS_dINF", "pUNBD"), "unbounded"),
}


def flat(values: Any, size: int) -> Array:
    """Return a solver's numbers as a flat array.

    Parameters
    ----------
    size : int
        How many there should be.

    Returns
    -------
    (size,)
        NaN if the solver returned none.
    """
    if values is None:
        return np.full(size, np.nan)
    return np.array(values, float).ravel()


def tiny_problem(exponential: bool) -> ConicProblem:
    """Return a problem of two variables with a cone of each kind, an exponential one on
    demand: minimise x1 + x2.
    """
    cones = (Cone("nonnegative", 2), Cone("soc", 3), Cone("psd", 2), Cone("exp", 3))
    # b - A x lies in these cones, with x (2,):
    minus_A = [
        [[1, 0], [0, 1]],  # x >= 0
        [[0, 0], [1, 0], [0, 1]],  # |x| <= 9
        [[1, 0], [0, 0], [0, 1]],  # [[x1, s], [s, x2]] >= 0, s = 1 / sqrt 2
        [[1, 0], [0, 0], [0, 1]],  # exp(x1) <= x2 + 9
    ]
    A = scipy.sparse.csc_matrix(-np.vstack(minus_A).astype(float))
    b = np.array([0.0, 0.0, 9.0, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 1.0, 9.0])
    rows = len(b) if exponential else 8
    return ConicProblem(
        scipy.sparse.csc_matrix((2, 2)),
        q=np.ones(2),
        A=A[:rows],
        b=b[:rows],
        cones=cones if exponential else cones[:3],
    )


class Solver(ABC):
    """A conic solver of others, named on the command line."""

    #: Its name on the command line.
    name: ClassVar[str]
    #: What installs it: an extra of this package, or words; None: the core installation.
    extra: ClassVar[str | None] = None
    #: ("package", module) or ("program", command) without which it is absent.
    requires: tuple[str, str]
    #: Debian's name of a program, where it is not the command's.
    system_package: ClassVar[str] = ""
    #: Name of the package's distribution, where it is not the module's.
    distribution: ClassVar[str] = ""
    #: Kinds of cones that it takes; others are rewritten.
    cones: ClassVar[frozenset[str]] = EVERYTHING
    #: Order of the kinds of cones, where it wants one.
    order: ClassVar[tuple[str, ...]] = ()
    #: Whether a psd cone's rows are all entries of the matrix instead of svec's.
    full_matrices: ClassVar[bool] = False
    #: What is passed for an accuracy, by the names of its documentation; all else is as
    #: its authors ship it.
    default_options: ClassVar[Mapping[str, Any]]
    #: What we change of that for identification.
    tuned_options: ClassVar[Mapping[str, Any]] = {}
    #: What each status of its claims, in the words of a Solution; others are "failed".
    status_meaning: ClassVar[Mapping[str, str]] = {}

    @abstractmethod
    def run(self, problem: ConicProblem, options: Mapping[str, Any]) -> Solution:
        """Solve a problem by the package or program; every subclass defines this.

        Parameters
        ----------
        problem : ConicProblem
            Rewritten to :attr:`cones`, :attr:`order` and :attr:`full_matrices`.
        options : mapping
            Options by the solver's own names, as :meth:`options` makes them.

        Returns
        -------
        Solution
            Variables, multipliers, and the meaning of the solver's status.
        """

    def options(self, accuracy: float, tuned: bool = True) -> dict[str, Any]:
        """Return the solver's options for an accuracy.

        Parameters
        ----------
        accuracy : float
            Relative accuracy of gap and feasibility.
        tuned : bool
            Whether :attr:`tuned_options` are among them.

        Returns
        -------
        dict
            Options by the solver's own names.
        """
        options = {
            name: accuracy if value is ACCURACY else value
            for name, value in self.default_options.items()
        }
        if tuned:
            options |= self.tuned_options
        return options

    def solve(
        self, problem: ConicProblem, accuracy: float, tuned: bool = True
    ) -> Solution:
        """Rewrite a problem for the solver, solve it, and bring the solution back.

        Parameters
        ----------
        problem : ConicProblem
            With any cones; it is rewritten for the solver.
        accuracy : float
            Relative accuracy of gap and feasibility.
        tuned : bool
            Whether with :attr:`tuned_options`, or as its authors ship it.

        Returns
        -------
        Solution
            Of the problem before it was rewritten.

        Raises
        ------
        NotApplicableError
            For cones that the solver lacks and that cannot be rewritten.
        """
        form = suited(problem, self.cones, self.order)
        form = form.then(full_matrices) if self.full_matrices else form
        answer = self.run(form.problem, self.options(accuracy, tuned))
        x, z = form.back(answer.x, answer.z)
        return replace(answer, x=x, z=z)

    def solve_for_user(self, problem: ConicProblem, accuracy: float) -> Solution:
        """Solve a problem for a command, with errors as sentences for users.

        Parameters
        ----------
        problem : ConicProblem
            With any cones; it is rewritten for the solver.
        accuracy : float
            Relative accuracy of gap and feasibility.

        Returns
        -------
        Solution
            Of the problem before it was rewritten.

        Raises
        ------
        InputError
            If a signal has ended the solver's program.
        """
        try:
            return self.solve(problem, accuracy)
        except (ChildProcessError, TimeoutError) as error:
            raise InputError(
                f"solver {self.name}: {error}",
                "choose another solver, or install it anew",
            ) from error

    def make_solution(
        self, x: Array, z: Array, status: str, iterations: float, more: str = ""
    ) -> Solution:
        """Return a Solution with the meaning of the solver's status: variables x (m,),
        multipliers z (r,), and the status, a key of :attr:`status_meaning` (others mean
        "failed"), with ``more`` words of the solver.
        """
        meaning = self.status_meaning.get(status, "failed")
        return Solution(
            x,
            z,
            claims=meaning,
            status=f"{status} {more}".rstrip(),
            iterations=int(iterations),
        )

    @property
    def absent(self) -> str:
        """Why the solver cannot be used on this machine and what to do, "" if it can."""
        kind, name = self.requires
        if kind == "program":
            is_installed = shutil.which(name) is not None
        else:
            is_installed = importlib.util.find_spec(name) is not None
        if is_installed:
            return ""
        return f"the {kind} {name} is not installed (source: {self.source})"

    @property
    def source(self) -> str:
        """Where the solver comes from: an extra, a system package, or words."""
        kind, what = self.requires
        if kind == "program":
            return f"a system package: {self.system_package or what}"
        if self.extra is None:
            return "the core installation"
        return self.extra if " " in self.extra else f"the extra [{self.extra}]"

    @property
    def description(self) -> str:
        """First sentence of the class's docstring."""
        return summary_line(type(self))

    def warm_up(self) -> None:
        """Solve a tiny problem with a cone of each kind that the package takes, so that
        the next solution's time holds no import, library or compiled code of the first.
        A program pays in every run: it is not called.
        """
        if self.requires[0] == "package":
            self.solve(tiny_problem("exp" in self.cones), accuracy=1e-4)

    def version(self) -> str:
        """Return the installed version of the package or program, "" if unknown."""
        kind, what = self.requires
        if kind == "package":
            with suppress(metadata.PackageNotFoundError):
                return metadata.version(self.distribution or what)
            return ""
        command = ["dpkg-query", "-W", "-f", "${Version}", self.system_package or what]
        try:
            done = subprocess.run(command, capture_output=True, text=True, check=False)
        except OSError:
            return ""
        return done.stdout.strip() if done.returncode == 0 else ""
