"""Memory that long recordings no longer need, given back to the system."""

import ctypes
import gc

#: Of shorter recordings the memory is not worth the time that it takes to free it.
LONG_RECORDING = 50_000


def give_back_memory(samples: int) -> None:
    """Free unused objects, and return free memory to the system.

    The C library keeps the memory of arrays below some megabytes for later. Without
    this, the memory that a check has used would count in addition to that of a
    diagnosis.

    Parameters
    ----------
    samples : int
        Length of the recording; below ``LONG_RECORDING`` nothing is done.
    """
    if samples < LONG_RECORDING:
        return
    gc.collect()
    # Of glibc alone; other C libraries do it by themselves, or cannot be asked.
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
