"""Conic solvers, one small file each; a file with NAME and solve() is its registration."""

from __future__ import annotations

import importlib
import pkgutil
from types import ModuleType

from sdp_vs_penalty.errors import InputError


def solver_modules() -> dict[str, ModuleType]:
    """Every solver of the library by name; whether it is installed shows when it is called."""
    found = {}
    for module in pkgutil.iter_modules(__path__):
        home = importlib.import_module(f"{__name__}.{module.name}")
        if hasattr(home, "NAME"):
            found[home.NAME] = home
    return dict(sorted(found.items()))


def solver(name: str) -> ModuleType:
    modules = solver_modules()
    if name not in modules:
        raise InputError(f"solver {name!r} is unknown; there are: {', '.join(modules)}.")
    return modules[name]
