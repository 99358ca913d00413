"""Take a model elsewhere: simulators, controllers, tables."""

import re
import warnings
from collections.abc import Sequence
from pathlib import Path

from sdp_vs_penalty.effects import effect_in_words
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.errors import InputError, Remark, printable
from sdp_vs_penalty.estimation.carried import doubts_of_bodies
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.estimation.verdict import Verdict
from sdp_vs_penalty.exporters import EXPORTS
from sdp_vs_penalty.exporters.content import Options, verdict_line
from sdp_vs_penalty.exporters.held import is_held, left_out
from sdp_vs_penalty.exporters.interface import ExportFormat
from sdp_vs_penalty.files import write_bytes

#: Files that a controller or a simulator takes.
FILES_TO_TAKE = ("model.h", "robot.urdf", "robot.xml")


def format_of(out: str | Path) -> ExportFormat:
    """Return the format that a file's name chooses; the longest matching suffix wins.

    Returns
    -------
    ExportFormat
        A module of this folder.

    Raises
    ------
    InputError
        If no format has this suffix.
    """
    name = Path(out).name.lower()
    endings = [ending for ending in EXPORTS.all() if name.endswith(ending)]
    if not endings:
        known = ", ".join(
            f"{ending} ({file_format.ABOUT})"
            for ending, file_format in EXPORTS.all().items()
        )
        raise InputError("unknown suffix", f"choose one of {known}", out)
    return EXPORTS.all()[max(endings, key=len)]


def write_model(
    estimate: Estimate,
    out: str | Path,
    urdf: str | Path | None = None,
    *,
    mjcf: str | Path | None = None,
    force: bool = False,
    flange: tuple[float, float, float] = (0.0, 0.0, 0.0),
    judged: Verdict | None = None,
    identified_without: Sequence[str] = (),
) -> tuple[str, ...]:
    """Write a model in the format that the file's name chooses, and return the effects
    left out.

    Parameters are those of :func:`sdp_vs_penalty.export`, but the model is loaded
    already; ``judged`` is the verdict on the model without the effects that the file
    cannot hold, and ``identified_without`` names those of them that the model was
    identified again without.
    """
    out = Path(out)
    file_format = format_of(out)
    own_file = _own_file(file_format, out, {"URDF": urdf, "MJCF": mjcf})
    options = Options(own_file, force, flange, tuple(identified_without))
    content, omitted = file_format.write(estimate, options)
    lost = tuple(dict.fromkeys((*identified_without, *omitted)))
    if own_file is None:  # the user's own file gets no comment: its other bytes stay
        verdict = verdict_line(estimate)
        if lost and hasattr(file_format, "HOLDS"):
            verdict = exported_verdict(lost, judged)
        line = " ".join(filter(None, (verdict, friction_at_rest(estimate, out))))
        content = _with_verdict(content, out.suffix.lower(), line)
    if getattr(file_format, "BODIES", True):
        for doubt in doubts_of_bodies(estimate):
            warnings.warn(f"{out}: {doubt}", Remark, stacklevel=2)
    write_bytes(out, content)
    return lost


def _own_file(
    file_format: ExportFormat, out: Path, path_by_kind: dict[str, str | Path | None]
) -> str | Path | None:
    """Return the user's own file, a "URDF" or an "MJCF"; None without one.

    Raises InputError for two, or where the format does not edit such a file.
    """
    given_files = {
        kind: path for kind, path in path_by_kind.items() if path is not None
    }
    if not given_files:
        return None
    if len(given_files) > 1:
        raise InputError(
            f"{' and '.join(given_files)} are two files", "name one of them"
        )
    ((kind, path),) = given_files.items()
    if getattr(file_format, "EDITS", "") != kind:
        ending = {"URDF": ".urdf", "MJCF": ".xml"}[kind]
        what = f"an edited {kind} must end in {ending}"
        raise InputError(what, f"rename it, or leave the {kind} out", out)
    return path


def friction_at_rest(estimate: Estimate, out: str | Path) -> str:
    """Say how a simulator's dry friction differs from the model's near standstill.

    A simulator holds a joint at rest up to the friction F. The model's torque is
    F tanh(dq / v_s): a drive torque of F / 2 lets it creep at v_s atanh(1/2).

    Returns
    -------
    str
        The sentence; "" for formats without dry friction of a simulator, and models
        without Coulomb friction.
    """
    joints = {
        joint
        for effect in estimate.model.effects
        if effect.simulator_field == "friction"
        for joint in effect.joints
    }
    if not joints or "friction" not in getattr(format_of(out), "HOLDS", ()):
        return ""
    width = max(estimate.model.sign_width[joint] for joint in joints)
    return (
        "Near standstill: a simulator's dry friction holds a joint at rest; the model's,"
        f" here and in `simulate`, turns round within about {width:.2g} rad/s or m/s, so"
        " that a joint creeps."
    )


def as_exported(estimate: Estimate, out: str | Path) -> Estimate | None:
    """Return the model as a file of this name holds it.

    Returns
    -------
    Estimate or None
        A copy without the effects that the format has no place for. None for formats
        that hold no model of the torque (tables, payloads).
    """
    fields = getattr(format_of(out), "HOLDS", None)
    if fields is None:
        return None
    return estimate.with_effects(lambda effect: is_held(effect, estimate, fields))


def files_without_place(effect: Effect, estimate: Estimate) -> tuple[str, ...]:
    """Return which of FILES_TO_TAKE have no place for an effect beside a model."""
    return tuple(
        name for name in FILES_TO_TAKE if not has_place(effect, estimate, name)
    )


def has_place(effect: Effect, estimate: Estimate, out: str | Path) -> bool:
    """Whether a file of this name has a place for an effect beside a model."""
    return is_held(effect, estimate, getattr(format_of(out), "HOLDS", ()))


def effects_left_out(estimate: Estimate, out: str | Path) -> tuple[str, ...]:
    """Return the effects of a model that a file of this name has no place for; none for
    formats that hold no model of the torque."""
    fields = getattr(format_of(out), "HOLDS", None)
    return () if fields is None else left_out(estimate, fields)


def exported_verdict(lost: Sequence[str], judged: Verdict | None) -> str:
    """Return the sentence on a file that lacks some effects, with the verdict on it.

    Parameters
    ----------
    lost : sequence of str
        The effects that it lacks.
    judged : Verdict or None
        Verdict on the model without them.
    """
    lacks = f"without {', '.join(map(effect_in_words, lost))}"
    if judged is None:
        return f"Not judged as exported, {lacks}: `sdp-vs-penalty export --data` judges it."
    return f"As exported, {lacks}. {judged.brief()}"


def _with_verdict(content: bytes, suffix: str, line: str) -> bytes:
    """Put the verdict as a comment of ASCII at the head of a file, if its format has
    comments.

    A .json file has a field for it instead; tables stay as they are.
    """
    line = re.sub(r"[^\x20-\x7e]", "?", printable(line))
    if suffix in (".urdf", ".xml", ".sdf"):
        comment = f"<!-- {re.sub('-(?=-)', '- ', line)} -->\n".encode()
        is_declared = content.startswith(b"<?xml")
        start = content.find(b"?>\n") + 3 if is_declared else 0
        return content[:start] + comment + content[start:]
    if suffix == ".h":
        comment = f"/* {line.replace('*/', '* /')} */\n".encode()
        return comment + content
    if suffix == ".script":
        return f"# {line}\n".encode() + content
    return content
