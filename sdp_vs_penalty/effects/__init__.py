"""The library of effects, by kind; :func:`effect_types` finds them."""

from collections.abc import Sequence
from functools import cache
from typing import Any

from sdp_vs_penalty.effects.effect import Effect, EffectEntry, SimulatorField
from sdp_vs_penalty.effects.written import read_effect
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.plugins import Registry, lazy_exports
from sdp_vs_penalty.robot.robot import Robot

_PARTS = {
    "Motion": "motion",
    "CurrentModel": "motion",
    "JointCoverage": "effect",
    "Model": "model",
    "FittedEffect": "plain_words",
    "effect_in_words": "plain_words",
    "effect_name": "plain_words",
    "effects_in_words": "plain_words",
    "on_the_arm": "plain_words",
}
DEFAULT_EFFECTS = (
    "rigid_body",
    "viscous_friction",
    "coulomb_friction",
    "torque_offset",
)


#: Effects as they are written, for sentences that ask for one or two.
EXAMPLES = ("torque_ripple:4@k=2", "joint_spring:4")
EFFECTS = Registry[type[Effect]]("effect", __name__, Effect)


def effect_types() -> dict[str, type[Effect]]:
    """Import all effects, by name; the rigid body comes first."""
    types = EFFECTS.all()
    return {"rigid_body": types["rigid_body"], **types}


def standard_effect(field: SimulatorField) -> type[Effect]:
    """Return the effect that a field of simulators' files stands for, such as dry
    friction for "friction"."""
    return _standard_effects()[field]


@cache
def _standard_effects() -> dict[str, type[Effect]]:
    """Our effects that simulators' files have a field for, by the field."""
    kinds = EFFECTS.of_folder.values()
    return {kind.simulator_field: kind for kind in kinds if kind.simulator_field}


def parse_effects(
    texts: str | Sequence[str | Effect], robot: Robot
) -> tuple[Effect, ...]:
    """Read effects from their written form ``name[:joints][@shape=value]``.

    In ``presliding_hysteresis:5+7@d=0.003`` joints count from 1 and are joined by +.
    Each shape constant has an @ of its own.

    Parameters
    ----------
    texts
        One text with commas, or several; an Effect among these stays as it is.
    """
    words = texts.split(",") if isinstance(texts, str) else list(texts)
    effects = list[Effect]()
    for word in words:
        if isinstance(word, Effect):
            effects.append(word)
        elif not isinstance(word, str):
            raise InputError(
                f"effect {word!r} is neither a name nor an Effect",
                "write it as a name, such as viscous_friction",
            )
        elif word.strip():
            effects.append(_parse_effect(word.strip(), robot))
    return tuple(effects)


def _parse_effect(text: str, robot: Robot) -> Effect:
    """Make the effect of a robot that a text states; InputError for any other text."""
    written = read_effect(text)
    kind = EFFECTS.get(written.name)
    # Joints count from 1 in the text, from 0 in the effect.
    joints = [joint - 1 for joint in written.joints] or None
    # An unknown constant is read as a number; the effect itself refuses it.
    shape: dict[str, float] = {}
    for key, value in written.constants.items():
        constant = kind.shapes.get(key)
        try:
            shape[key] = float(value) if constant is None else constant.parsed(value)
        except ValueError:
            words = constant.words if constant is not None else ()
            how = f"@{key}={'|'.join(words)}" if words else "@name=number"
            raise InputError(
                f"effect {text!r}", f"write a shape constant as {how}"
            ) from None
    return kind(robot, joints, **shape)


def make_effect(entry: EffectEntry, robot: Robot, provider: str = "") -> Effect:
    """Make the effect of a robot that an entry of a file states; ``provider`` is the
    package that brought it, where it is a plug-in's."""
    joints = None if entry.joints is None else [j - 1 for j in entry.joints]
    return EFFECTS.get(entry.effect, provider)(robot, joints, **entry.shape)


def __getattr__(name: str) -> Any:
    """Return an effect's class, such as ``effects.PreslidingHysteresis``, or a name of
    this folder's modules; both are imported when they are first used."""
    if name in _PARTS:
        return lazy_exports(__name__, **{_PARTS[name]: name})(name)
    for kind in EFFECTS.of_folder.values():
        if kind.__name__ == name:
            return kind
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """List the names of this module and of all effects' classes."""
    kinds = EFFECTS.of_folder.values()
    return sorted({*globals(), *(kind.__name__ for kind in kinds)})
