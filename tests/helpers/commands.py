"""Commands, run in this process."""

import pytest

from sdp_vs_penalty.cli.main import main


def run_cli(*words: object) -> int:
    """The exit code of a command."""
    with pytest.raises(SystemExit) as code:
        main([str(word) for word in words])
    assert isinstance(code.value.code, int)
    return code.value.code
