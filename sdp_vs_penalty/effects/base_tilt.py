"""A base that is not level."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from sdp_vs_penalty.effects.effect import Array, Effect, Motion


class BaseTilt(Effect):
    name = "base_tilt"
    equation = "g_1 dID/dg_1 + g_2 dID/dg_2"
    explanation = (
        "The base is not mounted as the model says: gravity has components along the two directions "
        "across the assumed one (x and y of an upright base). 0.17 m/s^2 is one degree."
    )
    reference = "Luh, Walker, Paul, ASME J. Dynamic Systems 1980 (gravity as the base's acceleration)"
    needs_links = True
    whole_robot = True
    signless = True

    @property
    def across(self) -> Array:
        """(2, 3) the two directions across gravity: base axes where gravity points along one, otherwise
        those nearest to them."""
        gravity = np.array(self.robot.gravity) if any(self.robot.gravity) else np.array([0.0, 0.0, -1.0])
        down = gravity / np.linalg.norm(gravity)
        axes = np.delete(np.eye(3), int(np.argmax(np.abs(down))), axis=0)
        flat = axes - np.outer(axes @ down, down)
        u, _, vt = np.linalg.svd(flat, full_matrices=False)
        return np.asarray(u @ vt)  # the orthonormal pair nearest to the projected axes

    def named(self, joint: int) -> Iterable[tuple[str, str]]:
        straight = np.count_nonzero(self.robot.gravity) < 2
        names = ["xyz"[int(np.argmax(np.abs(a)))] for a in self.across] if straight else ["1", "2"]
        return [(f"g_{name}", "m/s^2") for name in names]

    def torques(self, motion: Motion) -> Array:
        rest = np.zeros_like(motion.q)
        columns = []
        for gravity in self.across:
            robot = replace(self.robot, gravity=(gravity[0], gravity[1], gravity[2]))
            columns.append(robot.inverse_dynamics(motion.model_links, motion.q, rest, rest))
        return np.stack(columns, axis=2)

    def remark(self, size: float) -> str:
        return f"Here: {np.degrees(size / 9.81):.2g} degrees."
