"""Plug-ins of other packages: effects, estimators, solvers, formats and exports."""

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
