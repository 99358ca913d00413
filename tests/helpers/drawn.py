"""Hypothesis, which draws cases; where it is not installed, tests of drawn cases are
skipped."""

import pytest

try:
    from hypothesis import HealthCheck, example, given, settings
    from hypothesis import strategies as st
except ImportError:
    from unittest.mock import MagicMock

    st = HealthCheck = MagicMock()

    def given(*_, **__):
        return pytest.mark.skip(
            reason="hypothesis is not installed: pip install '.[test]'"
        )

    def example(*_, **__):
        return lambda test: test

    settings = example
else:
    # Drawn cases are the same each time, however long one takes.
    settings.register_profile("same", max_examples=20, deadline=None, derandomize=True)
    settings.load_profile("same")

__all__ = ["HealthCheck", "example", "given", "seeds", "settings", "st"]

#: Any seed of a random generator.
seeds = st.integers(0, 2**32 - 1)
