"""Take a model elsewhere: simulators, controllers, tables."""

import re
from functools import cache
from pathlib import Path
from types import ModuleType

from sdp_vs_penalty import exporters
from sdp_vs_penalty.errors import InputError, printable
from sdp_vs_penalty.estimation.estimate import Estimate, as_estimate
from sdp_vs_penalty.exporters.content import Options, verdict_line
from sdp_vs_penalty.files import write_bytes
from sdp_vs_penalty.plugins import by_word, modules


@cache
def formats() -> dict[str, ModuleType]:
    """The modules that write files, by the ending of these files' names."""
    homes = modules(exporters.__name__, exporters.__path__, "ENDING")
    return by_word((home.ENDING, home) for home in homes)


def format_of(out: str | Path) -> ModuleType:
    """The module that writes files of this name. Raises InputError where there is none."""
    found = [ending for ending in formats() if Path(out).name.lower().endswith(ending)]
    if not found:
        known = ", ".join(
            f"{ending} ({home.ABOUT})" for ending, home in formats().items()
        )
        raise InputError("unknown suffix", f"choose one of {known}", out)
    return formats()[max(found, key=len)]


def export(
    estimate: Estimate | str | Path,
    out: str | Path,
    urdf: str | Path | None = None,
    *,
    force: bool = False,
    flange: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> tuple[str, ...]:
    """Write a model in the format that the file's name chooses; `sdp-vs-penalty list
    exports` names all.

    estimate : the model, or its model.json; out : the file to write.
    urdf : the user's own URDF file, whose inertials, damping and friction are replaced and whose every
        other byte is kept; for ``out`` with the suffix .urdf only.
    flange : where the flange lies in the last joint's frame [m], for a payload.
    force : a link whose mass lies farther out than its body reaches is exported all the same.
    Files with comments begin with the model's verdict, .json has it as a field.
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
    made, left_out = written
    # Of the user's own file every other byte is kept.
    write_bytes(
        out, _with_verdict(made, out.suffix.lower(), estimate) if urdf is None else made
    )
    return left_out


def _with_verdict(made: bytes, suffix: str, estimate: Estimate) -> bytes:
    """A file with the verdict as a comment at its head, where its format has comments
    (.json holds it as a field; tables of numbers stay as they are)."""
    said = printable(verdict_line(estimate))
    if suffix in (".urdf", ".xml", ".sdf"):
        comment = f"<!-- {re.sub('-(?=-)', '- ', said)} -->\n".encode()
        declared = made.find(b"?>\n") + 3 if made.startswith(b"<?xml") else 0
        return made[:declared] + comment + made[declared:]
    head = {".h": f"/* {said.replace('*/', '* /')} */\n", ".script": f"# {said}\n"}.get(
        suffix, ""
    )
    return head.encode() + made
