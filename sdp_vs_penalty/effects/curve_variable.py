"""What a measured curve can run over: a joint's signal, or two joints' in a ratio."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from sdp_vs_penalty.effects.effect import Array, Motion

#: What a curve can run over, in the order of the numbers that saved models have for it; "none" as the
#: second of a pair is no second variable.
WORDS = ("q", "dq", "ddq", "tau", "t", "sign(dq)", "abs(ddq)", "temp", "none")


@dataclass(frozen=True)
class Variable:
    """word : of WORDS, tau being the current model's torque; joint : from 0; other, ratio : the joint
    (-1: none) that is added in this ratio, to a position or velocity."""

    word: str
    joint: int = 0
    other: int = -1
    ratio: float = 1.0

    def along(self, motion: Motion) -> Array:
        """(N,) its values along a motion."""
        j = self.joint
        if self.word == "t":
            return motion.t
        if self.word == "temp":
            return motion.joint_temperature[:, j]
        if self.word == "tau":
            return motion.model_torque[:, j]
        if self.word == "sign(dq)":
            return motion.sign(j)
        if self.word == "abs(ddq)":
            return np.abs(motion.ddq[:, j])
        x = {"q": motion.q, "dq": motion.dq, "ddq": motion.ddq}[self.word]
        return np.asarray(x[:, j] if self.other < 0 else x[:, j] + self.ratio * x[:, self.other])

    @property
    def name(self) -> str:
        """As findings.json writes it.

        >>> [Variable("sign(dq)", 3).name, Variable("t").name, Variable("q", 4, 5, -2.0).name]
        ['sign(dq4)', 't', 'q5-2q6']
        """
        own = f"{self.word}{self.joint + 1}"
        if self.word == "t":
            return "t"
        if self.word.endswith(")"):
            return f"{self.word[:-1]}{self.joint + 1})"
        if self.other < 0:
            return own
        sign, size = "-" if self.ratio < 0.0 else "+", f"{abs(self.ratio):.6g}"
        return f"{own}{sign}{'' if size == '1' else size}{self.word}{self.other + 1}"

    @classmethod
    def parse(cls, text: str) -> Variable:
        """Inverse of :attr:`name`; ValueError where the text is none."""
        if text == "t":
            return cls("t")
        if found := re.fullmatch(r"(d?q)([1-9]\d*)([+-])([\d.]*)\1([1-9]\d*)", text):
            ratio = float(found[3] + (found[4] or "1"))
            return cls(found[1], int(found[2]) - 1, int(found[5]) - 1, ratio)
        found = re.fullmatch(r"([a-z(]+)([1-9]\d*)(\)?)", text)
        if not found or found[1] + found[3] not in set(WORDS) - {"t", "none"}:
            raise ValueError(f"{text!r} is no variable of a curve")
        return cls(found[1] + found[3], int(found[2]) - 1)

    def unit(self, torque_units: Sequence[str]) -> str:
        """From the units of the joints' torques; of a combination the first joint's."""
        position = "m" if torque_units[self.joint] == "N" else "rad"
        rates = {"q": position, "dq": f"{position}/s", "ddq": f"{position}/s^2", "t": "s", "temp": "K"}
        more = {"abs(ddq)": rates["ddq"], "tau": torque_units[self.joint]}
        return (rates | more).get(self.word, "-")
