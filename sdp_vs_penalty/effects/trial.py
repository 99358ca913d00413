"""A trial of an effect that somebody else wrote: its columns along a short motion, before
anything rests on them. What breaks is one sentence that names the attribute."""

import numpy as np

from sdp_vs_penalty.effects import EFFECTS
from sdp_vs_penalty.effects.effect import Effect
from sdp_vs_penalty.effects.motion import Command, CurrentModel, Motion
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.formatting import words
from sdp_vs_penalty.robot.robot import Robot

#: Fields of a motion that an effect gets, by the need that it declares.
_FIELDS_BY_NEED = {
    "needs_links": ("current",),
    "needs_torque": ("torque", "current"),
    "needs_temperature": ("temperature",),
    "needs_command": ("command", "position_integral"),
    "needs_motors": ("motors",),
}
#: Class attributes without which an effect cannot be shown.
_WORDS = ("equation", "explanation", "reference")
#: Rows of the trial's motion.
_ROWS = 50


def try_effect(kind: type[Effect], robot: Robot) -> None:
    """Try an effect's class on a robot.

    Parameters
    ----------
    kind : type
        The effect.
    robot : Robot
        Any robot with links.

    Raises
    ------
    InputError
        For a missing word, a parameter's symbol that another effect has, columns that
        cannot be computed from what the effect declares that it needs, and columns of
        another length than the motion.
    """
    lacks = [w for w in _WORDS if not isinstance(getattr(kind, w, None), str)]
    if lacks:
        texts = "; ".join(f'{word} = "..."' for word in lacks)
        raise InputError(f"{_title(kind)} has no {words(lacks)}", f"write {texts}")
    try:
        effect = kind(robot)
        names = {p.name for p in effect.parameters}
    except (AttributeError, TypeError, ValueError) as error:
        raise _broken(kind, "its parameters", error) from error
    symbol = getattr(kind, "symbol", None)
    for other in EFFECTS.of_folder.values():
        if symbol is None or getattr(other, "symbol", None) != symbol or other is kind:
            continue
        taken = names & {p.name for p in other(robot).parameters}
        if taken:
            raise InputError(
                f"{_title(kind)}: symbol {symbol!r} is that of {other.name}, so both"
                f" would have a parameter {min(taken)}",
                "give it another symbol",
            )
    _require_columns(effect, _motion(robot))


def _require_columns(effect: Effect, full: Motion) -> None:
    """Raise InputError unless an effect has columns of the length of a motion, from those
    of its fields that it declares to need."""
    kind = type(effect)
    declared = [need for need in _FIELDS_BY_NEED if getattr(effect, need)]
    try:
        blocks = effect.blocks(_with_fields(full, declared))
    except Exception as error:
        for need in _FIELDS_BY_NEED:
            if need not in declared and _runs(effect, full, [*declared, need]):
                raise InputError(
                    f"{_title(kind)}: its columns need what it does not declare",
                    f"write {need} = True in the class",
                ) from error
        raise _broken(kind, "its columns", error) from error
    for block in blocks:
        shape = np.shape(block.columns)
        if shape != (len(full.t), len(block.parameters)):
            raise InputError(
                f"{_title(kind)}: columns of joint {block.joint + 1} have the shape"
                f" {shape} for {len(full.t)} instants and {len(block.parameters)}"
                " parameters",
                "return (N,), or (N, k) for k parameters a joint",
            )
    used = {int(k) for block in blocks for k in block.parameters}
    if used and max(used) >= len(effect.parameters):
        raise InputError(
            f"{_title(kind)}: {max(used) + 1} columns, but {len(effect.parameters)}"
            " parameters",
            "return as many columns as parameter_names_and_units has names",
        )


def _runs(effect: Effect, full: Motion, needs: list[str]) -> bool:
    """Return whether an effect has columns of a motion with the fields of these needs."""
    try:
        effect.blocks(_with_fields(full, needs))
    except Exception:
        return False
    return True


def _with_fields(full: Motion, needs: list[str]) -> Motion:
    """Return a motion with its states and the fields of some needs."""
    kept = {field for need in needs for field in _FIELDS_BY_NEED[need]}
    fields = {field: getattr(full, field) for field in kept}
    return Motion(full.t, full.q, full.dq, full.ddq, **fields)


def _motion(robot: Robot) -> Motion:
    """Return sines of all joints with every field that an effect may ask for."""
    t = np.linspace(0.0, 1.0, _ROWS)
    wave = 2.0 * t[:, None] + np.arange(robot.n)
    q, dq, ddq = np.sin(wave), 2.0 * np.cos(wave), -4.0 * np.sin(wave)
    links = np.tile(
        [1.0, 0.1, 0.0, 0.1, 0.1, 0.0, 0.1, 0.0, 0.0, 0.1], (robot.links, 1)
    )
    return Motion(
        t,
        q,
        dq,
        ddq,
        torque=dq + q,
        current=CurrentModel(robot, links),
        temperature=25.0 + q,
        motors=ddq,
        command=Command(t, q, dq, ddq, np.cumsum(q, axis=0)),
        position_integral=np.cumsum(q, axis=0),
    )


def _broken(kind: type[Effect], what: str, error: Exception) -> InputError:
    """Return the sentence of an effect whose code raised an error."""
    return InputError(
        f"{_title(kind)}: {what} cannot be computed ({type(error).__name__}: {error})",
        "correct the class; `sdp_vs_penalty.testing.contracts` tries all of it",
    )


def _title(kind: type[Effect]) -> str:
    """Return the name of a class, for a sentence."""
    return f"effect {kind.__name__}"
