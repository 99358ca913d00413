"""Plug-ins of other packages: effects, estimators, solvers, formats and exports."""

import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, TypeVar

from sdp_vs_penalty.data.formats import FORMATS
from sdp_vs_penalty.effects import EFFECTS
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimators import ESTIMATORS
from sdp_vs_penalty.exporters import EXPORTS
from sdp_vs_penalty.plugins import Registry
from sdp_vs_penalty.solvers import SOLVERS

Plugin = TypeVar("Plugin", bound=type | ModuleType)
#: All kinds of plug-ins.
REGISTRIES: tuple[Registry[Any], ...] = (EFFECTS, ESTIMATORS, SOLVERS, FORMATS, EXPORTS)


def register(plugin: Plugin) -> Plugin:
    """Add an effect, estimator, solver, format or export of your own to this process.

    A package names its plug-ins as entry points instead, which every process and every
    command finds: the group is ``sdp_vs_penalty.effects``, ``.estimators``,
    ``.solvers``, ``.data.formats`` or ``.exporters``.

    Parameters
    ----------
    plugin : type or module
        A subclass of Effect, Estimator or Solver. Or a module with what a format of
        measurements has (``SUFFIXES``, ``read``) or one of export (``ENDING``,
        ``write``).

    Returns
    -------
    type or module
        The plug-in, so that ``register`` decorates a class.

    Raises
    ------
    InputError
        For anything else, and for a name that another plug-in has.
    """
    registry_of(plugin).register(plugin)
    return plugin


def register_file(path: Path) -> None:
    """Run a file of Python, and register every plug-in that it holds: the option
    ``--plugin`` of the command line.

    Parameters
    ----------
    path : Path
        The file; models name what it brings by the file's name without ``.py``.

    Raises
    ------
    InputError
        Where the file cannot be imported, or holds no plug-in, or an effect in it is
        broken.
    """
    name, file = path.stem, path.resolve()
    if not (path.suffix == ".py" and name.isidentifier()):
        remedy = "call it by letters, digits and underscores, as my_effects.py"
        raise InputError("not the name of a module of Python", remedy, path)
    if not file.is_file():
        raise InputError("no such file", "name a file of Python", path)
    # Workers that are not forked import it by its name.
    sys.path.append(str(file.parent))
    try:
        home = import_module(name)
    except Exception as error:
        what = f"{type(error).__name__}: {error}"
        raise InputError(what, "correct it: it has to run as it is", path) from error
    if Path(getattr(home, "__file__", None) or "").resolve() != file:
        remedy = "give the file another name"
        raise InputError(f"Python has another module {name}", remedy, path)
    own = (x for x in vars(home).values() if getattr(x, "__module__", "") == name)
    plugins = [x for x in (home, *own) if any(r.accepts(x) for r in REGISTRIES)]
    if not plugins:
        remedy = (
            "define a subclass of Effect, Estimator or Solver with a name, or SUFFIXES"
            " and read (format), or ENDING and write (export)"
        )
        raise InputError("no plug-in in it", remedy, path)
    for plugin in plugins:
        register(plugin)
        if EFFECTS.accepts(plugin):
            from sdp_vs_penalty.effects import trial
            from sdp_vs_penalty.problem.load import load_problem

            try:
                trial.try_effect(plugin, load_problem("panda").robot)
            except InputError as error:
                raise error.within(path) from error


def registry_of(plugin: Any) -> Registry[Any]:
    """Return the registry of a plug-in's kind; InputError for what is no plug-in."""
    for registry in REGISTRIES:
        if registry.accepts(plugin):
            return registry
    raise InputError(
        f"{plugin!r} is no plug-in",
        "register a subclass of Effect, Estimator or Solver with its name, or a module"
        " with SUFFIXES (format) or ENDING (export)",
    )
