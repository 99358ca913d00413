"""Clarabel under another name, asked for a tenth of the accuracy."""

from typing import Any

from sdp_vs_penalty.solvers.clarabel import Clarabel


class HalfHearted(Clarabel):
    """Clarabel, asked for a tenth of the accuracy."""

    name = "half-hearted"
    finest = 1e-9

    def options(self, accuracy: float, tuned: bool = True) -> dict[str, Any]:
        """Return Clarabel's options for ten times the tolerance."""
        return super().options(10.0 * accuracy, tuned)
