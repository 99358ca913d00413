"""Something pulls at the last link."""

from collections.abc import Iterable

from sdp_vs_penalty.effects.effect import Array, Effect, Motion


class ExternalWrench(Effect):
    name = "external_wrench"
    equation = "-J(q)^T (F, M)"
    explanation = (
        "A force and a moment that stay constant in the world act on the last link, at its joint's "
        "origin: a cable or a balancer that pulls, a tool that rests on something."
    )
    reference = "Siciliano et al., Robotics: Modelling, Planning and Control, sec. 7.1"
    whole_robot = True
    signless = smooth = True
    sized_by = slice(0, 3)  # the force

    def named(self, joint: int) -> Iterable[tuple[str, str]]:
        return [(f"{x}_{axis}", unit) for x, unit in (("F", "N"), ("M", "N*m")) for axis in "xyz"]

    def torques(self, motion: Motion) -> Array:
        return -self.robot.jacobians(motion.q, self.robot.link_joints[-1]).swapaxes(1, 2)
