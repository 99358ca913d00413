"""One array of NumPy's, with named fields or one column a channel."""

from pathlib import Path

import numpy as np

from sdp_vs_penalty.data.formats.limits import understood
from sdp_vs_penalty.data.formats.npz import columns_of_array
from sdp_vs_penalty.data.log import Log, log_of_arrays

SUFFIXES: tuple[str, ...] = (".npy",)


def read(path: Path) -> Log:
    """Read the fields of a structured array (N,), or the columns of a plain one."""
    remedy = "save its arrays with numpy.savez(path, t=..., q=..., tau=...)"
    with understood(path, ".npy file of numbers", remedy):
        array = np.load(path, allow_pickle=False)
    return log_of_arrays(path, columns_of_array(path, array))
