"""Effects as users and files write them: ``name[:joints][@constant=value]``."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from sdp_vs_penalty.errors import InputError


@dataclass(frozen=True)
class WrittenEffect:
    """The parts of an effect's written form, such as
    "presliding_hysteresis:5+7@d=0.003"."""

    #: Name of the effect, as `list effects` has it.
    name: str
    #: Numbers of the joints, from 1; none: all joints, or those of the robot as a whole.
    joints: tuple[int, ...] = ()
    #: Shape constants as they are written, by name.
    constants: Mapping[str, str] = field(default_factory=dict)

    @property
    def text(self) -> str:
        """The written form."""
        joints = ":" * bool(self.joints) + "+".join(map(str, self.joints))
        constants = (f"@{key}={value}" for key, value in self.constants.items())
        return "".join([self.name, joints, *constants])


def read_effect(text: str) -> WrittenEffect:
    """Return the parts of an effect's written form; InputError for any other text."""
    head, *constants = text.strip().split("@")
    name, _, joints_text = head.partition(":")
    if name.isdecimal():  # "3" of "torque_offset:1,3": a comma separates effects
        raise InputError(
            f"effect {name!r} is a number",
            "join the joints of an effect by +, like torque_offset:1+3",
        )
    try:
        joints = tuple(int(word) for word in joints_text.split("+") if joints_text)
    except ValueError:
        raise InputError(
            f"effect {text!r}: {joints_text!r} are no joints",
            f"write numbers from 1 joined by +, like {name}:5+7",
        ) from None
    pairs = (item.partition("=") for item in constants)
    return WrittenEffect(name, joints, {key.strip(): value for key, _, value in pairs})
