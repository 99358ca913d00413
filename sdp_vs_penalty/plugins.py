"""Plug-ins: a file in a folder of this package, an entry point of another package, or
what :func:`sdp_vs_penalty.register` was given. All three are one thing afterwards."""

import inspect
from collections.abc import Callable, Iterable, Iterator
from functools import cache, cached_property
from importlib import import_module
from pkgutil import iter_modules
from types import ModuleType
from typing import Any, Generic, TypeVar

from sdp_vs_penalty.errors import InputError, require_known

P = TypeVar("P")


def modules(package: str) -> Iterator[ModuleType]:
    """Import the modules of a package, one by one in alphabetical order."""
    for module in iter_modules(import_module(package).__path__):
        yield import_module(f"{package}.{module.name}")


class Registry(Generic[P]):
    """The plug-ins of one kind, by name: classes with a base, or modules with a mark.

    A package of others names each plug-in as an entry point of the group that is called
    like our folder, "sdp_vs_penalty.effects".
    """

    def __init__(self, kind: str, package: str, base: type | str) -> None:
        """Prepare the registry of a folder; nothing is imported yet.

        Parameters
        ----------
        kind : str
            What the plug-ins are, for sentences: "effect".
        package : str
            Dotted name of the folder, and of the group of entry points.
        base : type or str
            Base class of the plug-ins, which have a ``name``. Or the attribute that
            marks a module as a plug-in; a mark that is a text is its name, else the
            module's own.
        """
        self.kind = kind
        self.package = package
        self.base = base
        self._registered: list[P] = []

    def accepts(self, value: Any) -> bool:
        """Tell whether a value is a plug-in of this kind; a class has to be public and
        to have a ``name``."""
        is_class = inspect.isclass(value)
        if isinstance(self.base, str):
            return not is_class and hasattr(value, self.base)
        is_ours = is_class and issubclass(value, self.base) and hasattr(value, "name")
        return is_ours and not value.__name__.startswith("_")

    def name_of(self, plugin: P) -> str:
        """Return the name by which users choose a plug-in."""
        mark = "name" if isinstance(self.base, type) else self.base
        name = getattr(plugin, mark)
        if isinstance(name, str):
            return name
        return str(getattr(plugin, "__name__", "")).rpartition(".")[2]

    def register(self, plugin: P) -> None:
        """Add a plug-in to those of this process; InputError for a name that is taken.

        A class that was defined again, as in a notebook, takes the place of its older
        self.
        """
        older = [p for p in self._registered if _place(p) == _place(plugin)]
        others = [p for p in self._registered if p not in older]
        all_but_older = [p for p in self.all().values() if p not in older]
        by_word((self.name_of(p), p) for p in (*all_but_older, plugin))
        self._registered = [*others, plugin]
        vars(self).pop("_all", None)

    def forget(self) -> None:
        """Look for the plug-ins of the folder and of other packages again."""
        for cached in ("_all", "_files", "of_folder"):
            vars(self).pop(cached, None)
        installed_entry_points.cache_clear()

    def all(self) -> dict[str, P]:
        """Return all plug-ins in alphabetical order of their names.

        Raises InputError for two of one name, and for an entry point that cannot be
        imported or is no plug-in of this kind.
        """
        return self._all

    @cached_property
    def _all(self) -> dict[str, P]:
        """What :meth:`all` returns."""
        found = (*self.of_folder.values(), *self._of_packages(), *self._registered)
        return by_word((self.name_of(p), p) for p in found)

    @cached_property
    def of_folder(self) -> dict[str, P]:
        """The plug-ins of our folder, by name."""
        found: Iterable[Any] = modules(self.package)
        if isinstance(self.base, type):
            found = (value for home in found for value in vars(home).values())
        return by_word((self.name_of(x), x) for x in found if self.accepts(x))

    def _of_packages(self) -> Iterator[P]:
        """Import the plug-ins that other packages name as entry points."""
        for point in installed_entry_points().select(group=self.package):
            where = f"entry point {point.name} = {point.value}"
            remedy = f"repair or uninstall the package {_distribution(point)}"
            try:
                plugin = point.load()
            except Exception as error:
                raise InputError(f"{where}: {error}", remedy) from error
            if not self.accepts(plugin):
                raise InputError(f"{where} is no {self.kind}", remedy)
            yield plugin

    @cached_property
    def _files(self) -> frozenset[str]:
        """Names of the files in our folder, without endings."""
        home = import_module(self.package)
        return frozenset(module.name for module in iter_modules(home.__path__))

    def find(self, name: str) -> P | None:
        """Return the plug-in with a name; None if there is none.

        The file ``torque_offset.py`` is imported alone for "torque-offset"; only if it
        does not have the plug-in are all files imported, and other packages at last.
        """
        file = name.replace("-", "_")
        if file in self._files:
            home = import_module(f"{self.package}.{file}")
            for value in (home, *vars(home).values()):
                if self.accepts(value) and self.name_of(value) == name:
                    return value  # type: ignore[no-any-return]
        return self.of_folder.get(name) or self.all().get(name)

    def get(self, name: str, provider: str = "") -> P:
        """Return the plug-in with a name.

        Parameters
        ----------
        provider : str
            The package that brought it when a file was written (:meth:`provider`).

        Raises
        ------
        InputError
            Where no plug-in has this name.
        """
        plugin = self.find(name)
        if plugin is not None:
            return plugin
        if provider:
            raise InputError(
                f"{self.kind} {name} is a plug-in of {provider}, which is not installed",
                "install it, name its file with --plugin, or import it and call"
                " sdp_vs_penalty.register",
            )
        require_known(self.kind, name, self.all())
        return self.all()[name]

    def has(self, plugin: P) -> bool:
        """Tell whether a plug-in is the one that its name stands for."""
        return self.find(self.name_of(plugin)) is plugin

    def provider(self, name: str) -> str:
        """Return the package that brings a plug-in, with its version: "theirs 1.0"; the
        module of one that was registered by hand, or read from a file; "" for ours, and
        for a name that is unknown."""
        plugin: Any = self.find(name)
        # A plug-in is a class, or a module.
        module = getattr(plugin, "__module__", getattr(plugin, "__name__", ""))
        is_ours = module.startswith(f"{self.package}.")
        if plugin is None or is_ours:
            return ""
        for entry_point in installed_entry_points().select(group=self.package):
            if entry_point.load() is plugin:
                return _distribution(entry_point)
        return str(module)


def _place(plugin: Any) -> tuple[str, str]:
    """Return where a class or module is defined."""
    return getattr(plugin, "__module__", ""), plugin.__name__


@cache
def installed_entry_points() -> Any:
    """Read the entry points of all installed packages, once."""
    from importlib.metadata import entry_points  # 50 ms

    return entry_points()


def _distribution(point: Any) -> str:
    """Return name and version of the package that has an entry point."""
    return f"{point.dist.name} {point.dist.version}" if point.dist else point.value


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
            names = " and ".join(map(_named_with_home, (first, plugin)))
            raise InputError(
                f"{names} have the same {word}, {value!r}",
                "give each its own, or leave out one of them",
            )
    return dict(sorted(plugins.items()))


def _named_with_home(plugin: Any) -> str:
    """Return the name of a plug-in, and the module or file in which it stands."""
    name = getattr(plugin, "__name__", str(plugin))
    home = getattr(plugin, "__module__", "")
    return f"{name} of {home}" if home else name


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
