"""The verdict on a model, in the header of what leaves."""

from __future__ import annotations

import re

from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.verdict import NOT_JUDGED
from sdp_vs_penalty.exporters.content import servo_gains

_XML = frozenset({".urdf", ".xml", ".sdf"})


def verdict_line(estimate: Estimate) -> str:
    """The verdict that a model came with and its servos' gains, in printable ASCII, on one line."""
    said = NOT_JUDGED if estimate.verdict is None else estimate.verdict.brief()
    if gains := servo_gains(estimate):
        said = f"{said} {gains}"
    return re.sub(r"[^\x20-\x7e]", "?", said)


def with_verdict(made: bytes, suffix: str, estimate: Estimate) -> bytes:
    """A file with the verdict as a comment at its head, where its format has comments (.json holds it as
    a field; tables of numbers stay as they are)."""
    said = verdict_line(estimate)
    if suffix in _XML:
        comment = f"<!-- {said.replace('--', '- -')} -->".encode()
        start = re.match(rb"\s*(<\?xml.*?\?>)?", made, re.DOTALL)
        at = start.end() if start is not None else 0
        return made[:at] + (b"\n" if at else b"") + comment + (b"" if at else b"\n") + made[at:]
    if suffix == ".h":
        return f"/* {said.replace('*/', '* /')} */\n".encode() + made
    if suffix == ".script":
        return f"# {said}\n".encode() + made
    return made
