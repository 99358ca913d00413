"""Inverse dynamics as one C header without dependencies, for a controller's real-time loop."""

from __future__ import annotations

import re

from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.export.compact import PLAIN, torque_lines
from sdp_vs_penalty.export.content import Content

_TEMPLATE = """\
/* Joint torques of {robot}, identified by {method}; written by sdp-vs-penalty.

   void {name}_torque(q, dq, ddq, tau): joints in order {joints}, in rad or m, N m or N.
   tau = M(q) ddq + C(q, dq) dq + g(q) + armature ddq + damping dq + friction tanh(dq / width) + offset
   by recursive Newton-Euler (Luh, Walker, Paul 1980), constants written in. C99, no library but libm.
   Not in this file: {left}. */
#ifndef {guard}_H
#define {guard}_H
#include <math.h>
#define {guard}_N {n}

static void {name}_torque(const double q[], const double dq[], const double ddq[], double tau[]) {{
  (void)q, (void)dq, (void)ddq;
{lines}
}}
#endif
"""


def make_c_header(estimate: Estimate) -> tuple[bytes, tuple[str, ...]]:
    """The header, and the written form of the effects that it leaves out.

    Raises InputError for an impossible link, and for joints that follow others.
    """
    robot, model = estimate.robot, estimate.model
    if robot.mechanism is not None or model.gains is not None:
        raise InputError(
            "the header has no place for joints that follow others, or gains", "write .json"
        )
    Content.of(estimate)  # refuses what no simulator or controller should be given
    left = tuple(effect.brief for effect in model.effects if effect.name not in PLAIN)
    name = re.sub(r"\W", "_", robot.name) or "robot"
    name = name if name.isascii() and not name[0].isdigit() else "robot"
    made = [statement for line in torque_lines(estimate) for statement in line.split("; ")]
    used = set(re.findall(r"\w+", " ".join(made)))
    states = [
        f"{x}{i + 1} = {of}[{i}]"
        for x, of in zip("qva", ("q", "dq", "ddq"), strict=True)
        for i in range(robot.n)
    ]
    needed = [state for state in states if state.partition(" ")[0] in used]
    lines = [f"  const double {statement};" for statement in (*needed, *made)]
    lines += [f"  tau[{i}] = tau{i + 1};" for i in range(robot.n)]
    text = _TEMPLATE.format(
        robot=_comment(robot.name),
        method=_comment(estimate.method),
        name=name,
        joints=_comment(", ".join(robot.joint_names)),
        left=_comment(", ".join(left) or "nothing"),
        guard=name.upper(),
        n=robot.n,
        lines="\n".join(lines),
    )
    return text.encode(), left


def _comment(text: str) -> str:
    """Text that cannot end the comment it stands in."""
    return re.sub(r"[^\x20-\x7e]|\*/|/\*", "?", text)
