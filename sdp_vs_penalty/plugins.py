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
    """Import the modules of a package of this ``__name__`` and ``__path__``, one by one
    in alphabetical order; only those with an attribute ``mark``, "" for all."""
    homes = (import_module(f"{package}.{module.name}") for module in iter_modules(path))
    return (home for home in homes if not mark or hasattr(home, mark))


def classes(package: str, path: Iterable[str], base: type) -> dict[str, Any]:
    """Return the plug-in classes of a package of this ``__name__`` and ``__path__``, in
    alphabetical order of their names.

    Subclasses of ``base`` without a ``name`` are no plug-ins.

    Raises
    ------
    InputError
        If two classes have the same name.
    """
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
    """Return the plug-in class of a name, importing a single file if possible.

    The class ``torque-offset`` is looked for in ``torque_offset.py`` first. Only if it
    is not there are all files of the package imported.

    Parameters
    ----------
    kind : str
        What the plug-ins are, for the error message.
    all_classes : callable
        Returns all plug-ins by name, as :func:`classes` does.

    Raises
    ------
    InputError
        If no plug-in has this name.
    """
    file = name.replace("-", "_")
    if any(module.name == file for module in iter_modules(path)):
        for value in vars(import_module(f"{package}.{file}")).values():
            is_plugin = inspect.isclass(value) and issubclass(value, base)
            if is_plugin and getattr(value, "name", None) == name:
                return value
    require_known(kind, name, all_classes())
    return all_classes()[name]


def by_word(pairs: Iterable[tuple[Any, Any]], word: str = "name") -> dict[Any, Any]:
    """Index plug-ins by a word that is unique to each, such as its name.

    Parameters
    ----------
    word : str
        What the word is, for the error message.

    Returns
    -------
    dict
        The plug-ins in order of their words.

    Raises
    ------
    InputError
        If two plug-ins have the same word.
    """
    plugins: dict[Any, Any] = {}
    for value, plugin in pairs:
        first = plugins.setdefault(value, plugin)
        if first is not plugin:
            names = " and ".join(
                getattr(rival, "__name__", str(rival)) for rival in (first, plugin)
            )
            raise InputError(
                f"{names} have the same {word}, {value!r}", "give each its own"
            )
    return dict(sorted(plugins.items()))


def lazy_exports(package: str, **homes: str) -> Callable[[str], Any]:
    """Make a package's ``__getattr__`` that imports an exported name on first use.

    Parameters
    ----------
    **homes : str
        For each module of the package the names that it exports, separated by spaces.

    Returns
    -------
    callable
        To be assigned to ``__getattr__`` in the package's ``__init__``.
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
    """Return the summary of a module's, class's or function's docstring, on one line;
    "" without a docstring.

    The summary ends at the first line that ends with a full stop, or at an empty line.
    """
    sentence = []
    for line in (inspect.getdoc(thing) or "").splitlines():
        if not line:
            break
        sentence.append(line)
        if line.endswith("."):
            break
    return " ".join(sentence)
