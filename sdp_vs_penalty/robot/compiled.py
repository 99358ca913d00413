"""The optional compiled core: where it is installed and not switched off."""

from __future__ import annotations

import importlib.util
import os
from functools import cache
from typing import Any

#: Set to "off" to do everything in Python, as if the core were not installed.
VARIABLE = "SDP_VS_PENALTY_NATIVE"
MODULE = "sdp_vs_penalty_native"


def core() -> Any | None:
    """The module sdp_vs_penalty_native, or None where it is absent or switched off."""
    return None if os.environ.get(VARIABLE, "").lower() == "off" else _module()


@cache
def _module() -> Any | None:
    found = importlib.util.find_spec(MODULE) is not None
    return importlib.import_module(MODULE) if found else None
