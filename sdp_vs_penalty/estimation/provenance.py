"""How a model came about, by name; some of it is worked out when it is first read."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping, MutableMapping
from typing import Any

#: In place of an entry that nobody has read yet.
_UNREAD = object()


class Provenance(MutableMapping[str, Any]):
    """Plain JSON by name, of which some entries are worked out when one of them is first
    read, by whichever thread.

    It is read and changed like a dictionary; ``dict(provenance)`` is one. What the
    function that works them out needs (a recording behind its filters) is kept until
    then, and no longer.
    """

    def __init__(self, entries: Mapping[str, Any]) -> None:
        """Begin with entries that are known; their order is kept."""
        self._entries = dict(entries)
        self._make: Callable[[], Mapping[str, Any]] | None = None
        self._lock = threading.Lock()

    def work_out_later(
        self, names: tuple[str, ...], make: Callable[[], Mapping[str, Any]]
    ) -> None:
        """Add entries that ``make`` returns, by name, when one of them is first read.

        Parameters
        ----------
        names : tuple of str
            Their names. An entry that is set or deleted meanwhile stays as it is.
        make : callable
            It is called once, and forgotten then.
        """
        self._entries.update(dict.fromkeys(names, _UNREAD))
        self._make = make

    def __getitem__(self, name: str) -> Any:
        """Return an entry; work out all unread ones if nobody has read it yet."""
        if self._entries[name] is _UNREAD:
            with self._lock:
                if self._make is not None:  # no other thread has worked them out
                    for made, value in self._make().items():
                        if self._entries.get(made) is _UNREAD:
                            self._entries[made] = value
                    self._make = None
        return self._entries[name]

    def __setitem__(self, name: str, value: Any) -> None:
        """Set an entry."""
        self._entries[name] = value

    def __delitem__(self, name: str) -> None:
        """Delete an entry."""
        del self._entries[name]

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names of all entries."""
        return iter(self._entries)

    def __len__(self) -> int:
        """Return the number of entries."""
        return len(self._entries)

    def __repr__(self) -> str:
        """Return all entries, as those of a dictionary."""
        return repr(dict(self))

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle and copy with all entries worked out: another process has no
        recording."""
        return Provenance, (dict(self),)
