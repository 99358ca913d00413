"""A file in a folder is a registration: the modules of a package, and the classes that
they define."""

import inspect
from collections.abc import Callable, Iterable, Iterator
from importlib import import_module
from pkgutil import iter_modules
from types import ModuleType
from typing import Any

from sdp_vs_penalty.errors import InputError, require_known


def modules(package: str, path: Iterable[str], mark: str = "") -> Iterator[ModuleType]:
    """The modules of a package (its __name__ and __path__) that define ``mark``."""
    homes = (import_module(f"{package}.{module.name}") for module in iter_modules(path))
    return (home for home in homes if not mark or hasattr(home, mark))


def classes(package: str, path: Iterable[str], base: type) -> dict[str, Any]:
    """The subclasses of ``base`` that have a name, by it. Raises InputError where two
    have the same."""
    return by_word(
        (value.name, value)
        for home in modules(package, path)
        for _, value in inspect.getmembers(home, inspect.isclass)
        if issubclass(value, base) and hasattr(value, "name")
    )


def load_class(
    kind: str,
    package: str,
    path: Iterable[str],
    base: type,
    name: str,
    all_classes: Callable[[], dict[str, Any]],
) -> Any:
    """The subclass of ``base`` called ``name``, without an import of any other file
    where it is in the file of that name; else that of ``all_classes`` one. Raises InputError
    where there is none."""
    file = name.replace("-", "_")
    if any(module.name == file for module in iter_modules(path)):
        for x in vars(import_module(f"{package}.{file}")).values():
            if (
                inspect.isclass(x)
                and issubclass(x, base)
                and getattr(x, "name", None) == name
            ):
                return x
    require_known(kind, name, all_classes())
    return all_classes()[name]


def by_word(pairs: Iterable[tuple[Any, Any]], word: str = "name") -> dict[Any, Any]:
    """Classes or modules by what each alone must have, in its order."""
    out: dict[Any, Any] = {}
    for value, thing in pairs:
        if out.setdefault(value, thing) is not thing:
            names = " and ".join(
                getattr(x, "__name__", str(x)) for x in (out[value], thing)
            )
            raise InputError(
                f"{names} have the same {word}, {value!r}", "give each its own"
            )
    return dict(sorted(out.items()))


def lazy_exports(package: str, **homes: str) -> Callable[[str], Any]:
    """A package's ``__getattr__`` for the names that others use, by the module that has
    them; imported when it is asked for, so that nobody pays for what he does not use.
    """
    module_of = {
        name: module for module, names in homes.items() for name in names.split()
    }

    def attribute(name: str) -> Any:
        if name not in module_of:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(f"{package}.{module_of[name]}"), name)

    return attribute


def summary_line(thing: Any) -> str:
    """The first sentence of a docstring, on one line: up to the first line that ends in
    a full stop, or to the first empty line."""
    sentence = []
    for line in (inspect.getdoc(thing) or "").splitlines():
        if not line:
            break
        sentence.append(line)
        if line.endswith("."):
            break
    return " ".join(sentence)
