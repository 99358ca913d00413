"""Names that a terminal, a shell or a file format could take for something else."""

import numpy as np

#: What a name is put together from; bytes that are no UTF-8 for names of files alone.
FRAGMENTS = (
    "\x1b[2J\x1b[31m",
    "\x1b]0;title\x07",
    "\x9b31m",
    "\nsdp-vs-penalty: all is well.",
    "\r\x08\x7f",
    "\u202egnp",
    "\u2028",
    "';touch PWNED;'",
    "$(touch PWNED)",
    "`touch PWNED`",
    "a b",
    '"',
    "\\",
    "-x",
    "--out",
    "[red]",
    "[bold]",
    "{0}",
    "%s%n",
    "&amp;<b",
    "]]>",
    "-->",
    "*",
    "_|_",
    "\\input{x}",
    "$x^2$",
    "# h",
    "naïve 機械",
    "e\u0301",
)
NO_TEXT = ("\udcff\udcfe", "\udc80")


def hostile_names(count, *, of_files, seed=0):
    """Names of one to four fragments. of_files : names that a folder can hold."""
    rng = np.random.default_rng(seed)
    fragments = (*FRAGMENTS, *NO_TEXT) if of_files else FRAGMENTS
    for _ in range(count):
        chosen = rng.integers(len(fragments), size=int(rng.integers(1, 5)))
        yield "x".join(["n", *(fragments[k] for k in chosen.tolist())])


def raw_controls(content):
    """Characters of an output that are neither printable nor line ends."""
    text = content.decode("utf-8", "surrogateescape")
    return [c for c in text if not c.isprintable() and c != "\n"]
