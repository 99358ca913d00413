"""Linear algebra on one thread.

Matrices here have a hundred columns. Threads of BLAS cost more than they bring: where
cores are busy they wait for each other.
"""

import os
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")


def on_one_thread(verb: Callable[P, T]) -> Callable[P, T]:
    """Decorate a verb: BLAS has one thread while it runs, and as many as before then.

    Where the variable OPENBLAS_NUM_THREADS says how many, that holds.
    """

    @wraps(verb)
    def alone(*args: P.args, **kwargs: P.kwargs) -> T:
        if "OPENBLAS_NUM_THREADS" in os.environ:
            return verb(*args, **kwargs)
        import scipy.linalg  # noqa: F401  # SciPy's own BLAS can be limited once it is there
        from threadpoolctl import threadpool_limits

        with threadpool_limits(1, "blas"):
            return verb(*args, **kwargs)

    return alone
