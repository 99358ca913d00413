"""Conic solvers, one small file each; a file with NAME and solve() is its registration.

NAME : on the command line; EXTRA : what installs it (None: the core installation); REQUIRES : the
("package", module) or ("program", command) without which it is absent; CONES : what it takes, after
rewriting where it lacks quadratic objectives, equalities or second-order cones; options(accuracy), what
the solver is told. Where they are needed: warm_up(), what a first call pays for; licence(), why it
must not run; SYSTEM_PACKAGE, Debian's name of a program's package; VARIANTS, further parameter
sets of its manual, the third argument of solve() and options(). What solve() asks for by default is the
finest that a loop around it may ask.
"""

import importlib
import importlib.util
import shutil
import subprocess
from functools import cache
from importlib import metadata
from types import ModuleType

from sdp_vs_penalty.errors import InputError, unknown
from sdp_vs_penalty.plugins import marked, surface


@cache
def solver_modules() -> dict[str, ModuleType]:
    """Every solver of the library by name; :func:`absent` says which are not installed."""
    return marked(__name__, __path__)


def solver(name: str) -> ModuleType:
    """The module of a solver; InputError where it is unknown or absent, saying what installs it."""
    modules = solver_modules()
    if name not in modules:
        raise unknown("solver", name, modules)
    reason = absent(modules[name])
    if reason is not None:
        raise InputError(f"solver {name} cannot be used here", reason)
    return modules[name]


def absent(module: ModuleType) -> str | None:
    """Why a solver cannot be used on this machine and what to do, or None where it can."""
    kind, what = module.REQUIRES
    missing = shutil.which(what) is None if kind == "program" else importlib.util.find_spec(what) is None
    if missing:
        return f"the {kind} {what} is not installed (source: {installed_by(module)})"
    if hasattr(module, "licence"):
        reason: str | None = module.licence()
        return reason
    return None


def warm_up(module: ModuleType) -> None:
    """Pay for what a solver's first call costs once; nothing where it is absent."""
    if absent(module) is not None:
        return
    if hasattr(module, "warm_up"):
        module.warm_up()
    elif module.REQUIRES[0] == "package":
        importlib.import_module(module.REQUIRES[1])


def installed_by(module: ModuleType) -> str:
    """The extra, or the words, that say where a solver comes from."""
    if module.EXTRA is None:
        return "the core installation"
    return str(module.EXTRA) if " " in module.EXTRA else f"the extra [{module.EXTRA}]"


def version(module: ModuleType) -> str:
    """The installed version of what a solver requires; empty where a program does not say."""
    kind, what = module.REQUIRES
    if kind == "package":
        homes = metadata.packages_distributions().get(what, [what])
        return metadata.version(homes[0])
    package = getattr(module, "SYSTEM_PACKAGE", what)
    try:
        done = subprocess.run(
            ["dpkg-query", "-W", "-f", "${Version}", package],
            capture_output=True,
            text=True,
            check=False,
        )
    except OSError:
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""


__getattr__ = surface(
    __name__,
    {
        "Cone": "conic",
        "ConicProblem": "conic",
        "Entropy": "objective",
        "Objective": "objective",
        "Solution": "conic",
        "largest_margin": "identification",
        "least_squares_sdp": "identification",
        "lower_bound": "certificate",
        "repair": "certificate",
    },
)
