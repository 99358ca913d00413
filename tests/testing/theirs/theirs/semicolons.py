"""One row a sample, numbers apart by semicolons: t, then q, then tau of all joints."""

from pathlib import Path

import numpy as np

from sdp_vs_penalty.data.log import Log, log_of_arrays
from sdp_vs_penalty.errors import InputError

SUFFIXES = (".semicolons",)


def read(path: Path) -> Log:
    """Read the columns of a run."""
    try:
        lines = path.read_text("utf-8").splitlines()
        rows = np.array([[float(x) for x in line.split(";")] for line in lines])
    except ValueError as error:
        raise InputError(str(error), "write numbers and semicolons", path) from error
    n = (rows.shape[-1] - 1) // 2
    if n < 1 or rows.shape[-1] != 1 + 2 * n:
        raise InputError("a row is not t, q, tau", "write 1 + 2 n numbers", path)
    columns = {"t": rows[:, 0], "q": rows[:, 1 : 1 + n], "tau": rows[:, 1 + n :]}
    return log_of_arrays(path, columns)
