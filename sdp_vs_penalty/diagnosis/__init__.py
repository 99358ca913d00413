"""Which physical effect a model misses: :func:`diagnose` is the verb."""

from sdp_vs_penalty.diagnosis.adding import add
from sdp_vs_penalty.diagnosis.diagnose import diagnose
from sdp_vs_penalty.diagnosis.findings import Diagnosis, Finding, Invisible

__all__ = ["Diagnosis", "Finding", "Invisible", "add", "diagnose"]
