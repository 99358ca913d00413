"""Memory that long recordings no longer need, given back to the system."""

import ctypes
import gc

#: Of shorter recordings the memory is not worth the time that it takes to free it.
LONG_RECORDING = 50_000


def give_back_memory(samples: int) -> None:
    """Free what nothing refers to, and give whole free pages back to the system.

    Arrays below some megabytes come from the C library's heap, which keeps them for
    later. What a check has used would count beside what a diagnosis needs.

    Parameters
    ----------
    samples : int
        Of the recording; below ``LONG_RECORDING`` nothing is done.
    """
    if samples < LONG_RECORDING:
        return
    gc.collect()
    # Of glibc alone; other C libraries do it by themselves, or cannot be asked.
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)
    if trim is not None:
        trim(0)
