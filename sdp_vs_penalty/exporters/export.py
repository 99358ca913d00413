"""Take a model elsewhere: simulators, controllers, tables."""

import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from types import ModuleType

from sdp_vs_penalty import exporters
from sdp_vs_penalty.errors import InputError, printable
from sdp_vs_penalty.estimation.estimate import Estimate, as_estimate
from sdp_vs_penalty.estimation.verdict import Verdict
from sdp_vs_penalty.exporters.content import Options, verdict_line, with_effects
from sdp_vs_penalty.files import write_bytes
from sdp_vs_penalty.plugins import by_word, modules


@cache
def formats() -> dict[str, ModuleType]:
    """The modules that write files, by the ending of these files' names."""
    homes = modules(exporters.__name__, exporters.__path__, "ENDING")
    return by_word((home.ENDING, home) for home in homes)


def format_of(out: str | Path) -> ModuleType:
    """The module that writes files of this name. Raises InputError where there is none."""
    endings = [
        ending for ending in formats() if Path(out).name.lower().endswith(ending)
    ]
    if not endings:
        known = ", ".join(
            f"{ending} ({home.ABOUT})" for ending, home in formats().items()
        )
        raise InputError("unknown suffix", f"choose one of {known}", out)
    return formats()[max(endings, key=len)]


def export(
    estimate: Estimate | str | Path,
    out: str | Path,
    urdf: str | Path | None = None,
    *,
    force: bool = False,
    flange: tuple[float, float, float] = (0.0, 0.0, 0.0),
    judged: Verdict | None = None,
) -> tuple[str, ...]:
    """Write a model in the format that the file's name chooses; `sdp-vs-penalty list
    exports` names all.

    estimate : the model, or its model.json; out : the file to write.
    urdf : the user's own URDF file, whose inertials, damping and friction are replaced and whose every
        other byte is kept; for ``out`` with the suffix .urdf only.
    flange : where the flange lies in the last joint's frame [m], for a payload.
    force : a link whose mass lies farther out than its body reaches is exported all the same.
    judged : the verdict on :func:`as_exported`, where a file loses effects.
    Files with comments begin with the verdict on what they hold, .json has it as a field.
    Returns the effects that the format has no place for (they are in the .json).
    Raises InputError for another suffix, an inconsistent or implausible inertial, or a URDF of another
    robot.
    """
    estimate = as_estimate(estimate, "export(estimate=...)")
    out = Path(out)
    home = format_of(out)
    if urdf is not None and not getattr(home, "EDITS", False):
        raise InputError(
            "an edited URDF must end in .urdf", "rename it, or leave the URDF out", out
        )
    written: tuple[bytes, tuple[str, ...]] = home.write(
        estimate, Options(urdf, force, flange)
    )
    content, left_out = written
    if urdf is None:  # of the user's own file every other byte is kept
        said = verdict_line(estimate)
        if left_out and hasattr(home, "HOLDS"):
            said = exported_verdict(left_out, judged)
        content = _with_verdict(content, out.suffix.lower(), said)
    write_bytes(out, content)
    return left_out


def as_exported(estimate: Estimate, out: str | Path) -> Estimate | None:
    """The model that a file of this name holds: a copy without the effects that it has no
    place for. None for formats that hold no model of the torque (tables, payloads)."""
    held = getattr(format_of(out), "HOLDS", None)
    return None if held is None else with_effects(estimate, held)


def exported_verdict(left_out: Sequence[str], judged: Verdict | None) -> str:
    """What is said of a file that lacks effects, in printable ASCII."""
    lacks = f"without {', '.join(left_out)}"
    if judged is None:
        said = f"Not judged as exported, {lacks}: `sdp-vs-penalty export --data` judges it."
    else:
        said = f"As exported, {lacks}. {judged.brief()}"
    return re.sub(r"[^\x20-\x7e]", "?", said)


def _with_verdict(content: bytes, suffix: str, line: str) -> bytes:
    """A file with the verdict as a comment at its head, where its format has comments
    (.json holds it as a field; tables of numbers stay as they are)."""
    line = printable(line)
    if suffix in (".urdf", ".xml", ".sdf"):
        comment = f"<!-- {re.sub('-(?=-)', '- ', line)} -->\n".encode()
        declared = content.find(b"?>\n") + 3 if content.startswith(b"<?xml") else 0
        return content[:declared] + comment + content[declared:]
    head = {".h": f"/* {line.replace('*/', '* /')} */\n", ".script": f"# {line}\n"}.get(
        suffix, ""
    )
    return head.encode() + content
