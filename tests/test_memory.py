"""Memory goes back after long recordings, and costs short ones no time."""

import gc
import weakref

import pytest

from sdp_vs_penalty.memory import LONG_RECORDING, give_back_memory


class Node:
    """Refers to itself, so that only a collection frees it."""

    def __init__(self):
        self.itself = self


@pytest.mark.parametrize(
    ("samples", "is_free"), [(LONG_RECORDING, True), (LONG_RECORDING - 1, False)]
)
def test_garbage_of_long_recordings_is_freed(samples, is_free):
    gc.disable()
    try:
        node = weakref.ref(Node())
        give_back_memory(samples)
        assert (node() is None) == is_free
    finally:
        gc.enable()
