"""Inverse dynamics as one C header without dependencies, for a controller's real-time loop."""

from __future__ import annotations

import re

import numpy as np

from sdp_vs_penalty.effects.effect import Array
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.export.content import Content, number

_TEMPLATE = """\
/* Joint torques of @ROBOT@, identified by @METHOD@; written by sdp-vs-penalty.

   void @NAME@_torque(q, dq, ddq, tau): joints in order @JOINTS@, in rad or m, N m or N.
   tau = M(q) ddq + C(q, dq) dq + g(q) + armature ddq + damping dq + friction tanh(dq / width) + offset
   by recursive Newton-Euler (Luh, Walker, Paul 1980). C99, no allocation, no libraries but libm.
   Not in this file: @LEFT@. */
#ifndef @GUARD@_H
#define @GUARD@_H
#include <math.h>
#define @GUARD@_N @N@

static void @NAME@_turn(const double r[9], const double v[3], double out[3], int back) {
  for (int i = 0; i < 3; i++)
    out[i] = back ? r[i] * v[0] + r[3 + i] * v[1] + r[6 + i] * v[2]
                  : r[3 * i] * v[0] + r[3 * i + 1] * v[1] + r[3 * i + 2] * v[2];
}
static void @NAME@_add_cross(const double a[3], const double b[3], double out[3]) {
  out[0] += a[1] * b[2] - a[2] * b[1];
  out[1] += a[2] * b[0] - a[0] * b[2];
  out[2] += a[0] * b[1] - a[1] * b[0];
}

static void @NAME@_torque(const double q[], const double dq[], const double ddq[], double tau[]) {
  /* Parent (-1: base), prismatic or not, axis, rotation (by rows) and origin in the parent. */
  static const int parent[@N@] = @PARENT@, slides[@N@] = @SLIDES@;
  static const double axis[@N@][3] = @AXIS@, turn[@N@][9] = @TURN@, origin[@N@][3] = @ORIGIN@;
  /* m, m c, Ixx Ixy Iyy Ixz Iyz Izz about the joint's frame. */
  static const double link[@N@][10] = @LINKS@;
  static const double armature[@N@] = @ARMATURE@, damping[@N@] = @DAMPING@;
  static const double friction[@N@] = @FRICTION@, width[@N@] = @WIDTH@, offset[@N@] = @OFFSET@;
  double r[@N@][9], p[@N@][3], w[@N@][3], dw[@N@][3], a[@N@][3], f[@N@][3], m[@N@][3];
  for (int i = 0; i < @N@; i++) {
    const double *k = axis[i], *b = link[i];
    double c = slides[i] ? 1.0 : cos(q[i]), s = slides[i] ? 0.0 : sin(q[i]), e[9], t[3], u[3], h[3];
    const double skew[9] = {0, -k[2], k[1], k[2], 0, -k[0], -k[1], k[0], 0};
    for (int x = 0; x < 3; x++)
      for (int y = 0; y < 3; y++)
        e[3 * x + y] = (x == y ? c : 0.0) + s * skew[3 * x + y] + (1.0 - c) * k[x] * k[y];
    for (int x = 0; x < 3; x++)
      for (int y = 0; y < 3; y++) {
        const double *o = turn[i] + 3 * x;
        r[i][3 * x + y] = o[0] * e[y] + o[1] * e[3 + y] + o[2] * e[6 + y];
      }
    @NAME@_turn(turn[i], k, t, 0);
    for (int x = 0; x < 3; x++) p[i][x] = origin[i][x] + (slides[i] ? q[i] * t[x] : 0.0);
    const double none[3] = {0, 0, 0}, up[3] = @UP@;
    const double *wp = parent[i] < 0 ? none : w[parent[i]], *dwp = parent[i] < 0 ? none : dw[parent[i]];
    const double *ap = parent[i] < 0 ? up : a[parent[i]];
    for (int x = 0; x < 3; x++) t[x] = ap[x], u[x] = 0.0;
    @NAME@_add_cross(dwp, p[i], t);
    @NAME@_add_cross(wp, p[i], u);
    @NAME@_add_cross(wp, u, t);
    @NAME@_turn(r[i], t, a[i], 1);
    @NAME@_turn(r[i], wp, w[i], 1);
    @NAME@_turn(r[i], dwp, dw[i], 1);
    for (int x = 0; x < 3; x++) t[x] = k[x] * dq[i], h[x] = slides[i] ? 2.0 * w[i][x] : w[i][x];
    @NAME@_add_cross(h, t, slides[i] ? a[i] : dw[i]);
    for (int x = 0; x < 3; x++) {
      if (slides[i]) a[i][x] += k[x] * ddq[i];
      else dw[i][x] += k[x] * ddq[i], w[i][x] += t[x];
    }
    const double inertia[9] = {b[4], b[5], b[7], b[5], b[6], b[8], b[7], b[8], b[9]};
    for (int x = 0; x < 3; x++) f[i][x] = b[0] * a[i][x], u[x] = 0.0;
    @NAME@_add_cross(dw[i], b + 1, f[i]);
    @NAME@_add_cross(w[i], b + 1, u);
    @NAME@_add_cross(w[i], u, f[i]);
    @NAME@_turn(inertia, dw[i], m[i], 0);
    @NAME@_turn(inertia, w[i], t, 0);
    @NAME@_add_cross(w[i], t, m[i]);
    @NAME@_add_cross(b + 1, a[i], m[i]);
  }
  for (int i = @N@ - 1; i >= 0; i--) {
    const double *half = slides[i] ? f[i] : m[i];
    tau[i] = axis[i][0] * half[0] + axis[i][1] * half[1] + axis[i][2] * half[2] + armature[i] * ddq[i]
             + damping[i] * dq[i] + friction[i] * tanh(dq[i] / width[i]) + offset[i];
    if (parent[i] >= 0) {
      double g[3], t[3];
      @NAME@_turn(r[i], f[i], g, 0);
      @NAME@_turn(r[i], m[i], t, 0);
      @NAME@_add_cross(p[i], g, t);
      for (int x = 0; x < 3; x++) f[parent[i]][x] += g[x], m[parent[i]][x] += t[x];
    }
  }
}
#endif
"""


def make_c_header(estimate: Estimate) -> tuple[bytes, tuple[str, ...]]:
    """The header, and the written form of the effects that it leaves out.

    Raises InputError for an impossible link, and for joints that follow others.
    """
    robot, content = estimate.robot, Content.of(estimate)
    if robot.mechanism is not None or estimate.model.gains is not None:
        raise InputError(
            "the header has no place for joints that follow others, or gains", "write .json"
        )
    offset = np.zeros(robot.n)
    for parameter, value in zip(estimate.model.parameters, estimate.theta, strict=True):
        if parameter.effect == "torque_offset":
            offset[parameter.joint - 1] += value
    left = tuple(text for text in content.others if text.partition(":")[0] != "torque_offset")
    name = re.sub(r"\W", "_", robot.name) or "robot"
    name = name if name.isascii() and not name[0].isdigit() else "robot"
    joints = robot.joints
    values = {
        "ROBOT": _comment(robot.name),
        "METHOD": _comment(estimate.method),
        "JOINTS": _comment(", ".join(robot.joint_names)),
        "LEFT": _comment(", ".join(left) or "nothing"),
        "GUARD": name.upper(),
        "NAME": name,
        "N": str(robot.n),
        "PARENT": _braces(np.array([j.parent for j in joints]), "d"),
        "SLIDES": _braces(np.array([j.kind == "prismatic" for j in joints], int), "d"),
        "AXIS": _braces(np.array([j.axis for j in joints], float)),
        "TURN": _braces(np.array([j.placement[:3, :3].ravel() for j in joints])),
        "ORIGIN": _braces(np.array([j.placement[:3, 3] for j in joints])),
        "LINKS": _braces(content.links),
        "ARMATURE": _braces(content.armature),
        "DAMPING": _braces(content.damping),
        "FRICTION": _braces(content.friction),
        "WIDTH": _braces(np.array(estimate.model.sign_width)),
        "OFFSET": _braces(offset),
        "UP": _braces(-np.array(robot.gravity)),
    }
    text = re.sub(r"@(\w+?)@", lambda m: values[m.group(1)], _TEMPLATE)
    return text.encode(), left


def _braces(values: Array, kind: str = "") -> str:
    if values.ndim > 1:
        return "{" + ", ".join(_braces(row, kind) for row in values) + "}"
    return "{" + ", ".join(format(int(x), "d") if kind else number(x) for x in values) + "}"


def _comment(text: str) -> str:
    """Text that cannot end the comment it stands in."""
    return re.sub(r"[^\x20-\x7e]|\*/|/\*|@", "?", text)
