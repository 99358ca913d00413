"""Verbs keep BLAS on one thread."""

import pytest
import scipy.linalg  # noqa: F401  # its BLAS is counted too
from threadpoolctl import threadpool_info, threadpool_limits

from sdp_vs_penalty.threads import on_one_thread


def n_threads():
    """The most threads of a BLAS that is loaded: some have one, whatever is asked."""
    pools = threadpool_info()
    return max(pool["num_threads"] for pool in pools if pool["user_api"] == "blas")


@pytest.mark.parametrize(("variable", "inside"), [(None, 1), ("2", 2)])
def test_a_verb_has_one_thread_unless_the_variable_says_more(
    monkeypatch, variable, inside
):
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    if variable is not None:
        monkeypatch.setenv("OPENBLAS_NUM_THREADS", variable)
    with threadpool_limits(2, "blas"):
        assert on_one_thread(n_threads)() == inside
        assert n_threads() == 2


def test_an_error_gives_the_threads_back(monkeypatch):
    monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
    with threadpool_limits(2, "blas"):
        with pytest.raises(ZeroDivisionError):
            on_one_thread(lambda: 1 / 0)()
        assert n_threads() == 2
