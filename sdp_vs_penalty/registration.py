"""A file in a folder is a registration: the modules of a package, and the classes that they define."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from importlib import import_module
from pkgutil import iter_modules
from types import ModuleType
from typing import Any


def modules(package: str, path: Iterable[str], mark: str = "") -> Iterator[ModuleType]:
    """The modules of a package (its __name__ and __path__) that define ``mark``."""
    homes = (import_module(f"{package}.{module.name}") for module in iter_modules(path))
    return (home for home in homes if not mark or hasattr(home, mark))


def marked(package: str, path: Iterable[str], mark: str = "NAME") -> dict[Any, ModuleType]:
    """The modules that define ``mark``, by its value."""
    found = {getattr(home, mark): home for home in modules(package, path, mark)}
    return dict(sorted(found.items()))


def classes(package: str, path: Iterable[str], base: type) -> dict[str, Any]:
    """The subclasses of ``base`` that have a name, by it."""
    found = {
        value.name: value
        for home in modules(package, path)
        for value in vars(home).values()
        if isinstance(value, type) and issubclass(value, base) and hasattr(value, "name")
    }
    return dict(sorted(found.items()))
