"""What is alike in all logs of one recorder, and told by the arm of some of them."""

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Recorder:
    """Facts of the program that wrote a log, which the arm's torques have told."""

    #: Names of the log's columns: logs with the same ones are of one recorder.
    columns: tuple[str, ...] = ()
    #: Unit of positions, in words; "" where the arm has told none.
    unit: str = ""
    #: The file's names by ours, where the arm has confirmed them; empty where names say them.
    order: tuple[tuple[str, str], ...] = ()
    #: Whether torques are registers with a sign bit.
    has_sign_bit: bool = False
    #: Name of the run that has told it.
    run: str = field(default="", compare=False)

    @property
    def is_told(self) -> bool:
        """Whether the arm has told anything."""
        return bool(self.unit or self.order or self.has_sign_bit)

    def contradiction(self, other: "Recorder") -> str:
        """Return in which fact another log of this recorder differs, as a clause; "" where
        it does not."""
        if self.unit and self.unit != other.unit:
            unit = f"in {other.unit}" if other.unit else "as written"
            return f"q is taken {unit}, that of {self.run} in {self.unit}"
        if self.order and self.order != other.order:
            return f"columns are in another order than those of {self.run}"
        if self.has_sign_bit and not other.has_sign_bit:
            return f"torques have no sign bit, those of {self.run} have one"
        return ""
