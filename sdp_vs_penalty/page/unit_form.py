"""The form in which a person says the unit of a channel, or its gains: what was typed in
it, and what is wrong with that before anything is read."""

import re
from dataclasses import dataclass

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.hypotheses.renaming import factors_and_zeros
from sdp_vs_penalty.errors import InputError

#: What the button that reads torques by the form says, and the step that leads there.
NAME_UNIT = "Say the unit, or the drive gains"


@dataclass
class UnitForm:
    """What was typed of one channel; it stays until another robot is chosen."""

    #: Number of gains that may be typed.
    n: int
    #: What the gains are called: "gain", or "factor".
    by: str
    #: The gains, as they were typed.
    gains: str = ""
    #: The unit that was chosen; "" for gains.
    unit: str = ""

    @property
    def words(self) -> list[str]:
        """The gains that were typed."""
        return re.findall(r"[^\s,;:]+", self.gains)

    @property
    def scale(self) -> str:
        """The unit, or the gains, as `convert --scale` takes them."""
        return self.unit or ":".join(self.words)

    @property
    def problem(self) -> str:
        """What is wrong with the gains, for the person who typed them; "" for nothing."""
        words = self.words
        if self.unit:
            return ""
        if not words:
            return f"Type the {self.by}s, or choose a unit."
        for k, word in enumerate(words, start=1):
            try:
                factors_and_zeros("tau1", word, 1)
            except InputError:
                return f"{formatting.sentence(self.by)} {k} is “{word}”: type a number but zero."
        if len(words) in (1, self.n):
            return ""
        counted = f"{len(words)} of {formatting.count(self.n, self.by)}"
        if len(words) > self.n:
            return f"{len(words)} {self.by}s for {formatting.count(self.n, 'joint')}."
        missing = range(len(words) + 1, self.n + 1)
        verb = "is" if len(missing) == 1 else "are"
        return f"{counted}: {formatting.joints(missing)} {verb} missing."
