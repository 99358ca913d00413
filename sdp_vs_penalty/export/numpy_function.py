"""The whole model as one Python file that needs nothing but NumPy.

The file is put together from this package's own source: the dynamics of plain_robot.py and the
classes of the model's effects with whatever functions they call. So an exported function is the
model, for every effect, not a second implementation of it.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from types import SimpleNamespace

import numpy as np

from sdp_vs_penalty.effects.effect import CurrentModel, Effect, Motion
from sdp_vs_penalty.effects.model import depends
from sdp_vs_penalty.effects.shape import Shape
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.export import plain_robot
from sdp_vs_penalty.export.compact import is_plain, plain_function
from sdp_vs_penalty.export.content import about
from sdp_vs_penalty.export.linked import linked, literal
from sdp_vs_penalty.robot.robot import Robot

_TEMPLATE = '''\
"""Joint torques of {robot}, identified by {method}; written by sdp-vs-penalty {version}.

    tau = torque(q, dq, ddq)        # (n,) or (N, n): rad or m, /s, /s^2 -> N m or N
    tau = torque(q, dq, ddq, t)     # t (N,) in s: needed by {timed}

Joints in order: {joints}.
Effects: {effects}.
Needs Python 3.10 or later and NumPy; nothing of sdp-vs-penalty.
"""

{imports}

{definitions}


{end}'''
_END = '''\
ROBOT = Robot(
    joints=(
{joint_lines}
    ),
    gravity={gravity},
)


def _given(kind, **own):
    made = kind.__new__(kind)
    vars(made).update(robot=ROBOT, **own)
    return made


#: Each effect with the place of its first parameter in THETA.
EFFECTS = (
{effect_lines}
)
#: The same of those that need the torque or the links of a current model, and that model.
LATE = (
{late_lines}
)
REFERENCE = {reference}
LINKS = {links}
#: Parameter values, in the order of NAMES.
THETA = np.array({theta})
NAMES = {names}
GAINS = np.array({gains})
SIGN_WIDTH = {sign_width}
NEEDS_TIME = {needs_time}


def torque(q, dq, ddq, t=None, temperature=None):
    """Modelled joint torques, of the shape of q. Samples of one call are one motion, in order.

    temperature (n,) or (N, n) in degrees Celsius: where friction follows it.
    """
    q, dq, ddq = (np.asarray(x, float) for x in (q, dq, ddq))
    if t is None:
        if NEEDS_TIME:
            raise ValueError("pass t: " + ", ".join(NEEDS_TIME) + " depend(s) on time")
        t = np.zeros(q.size // ROBOT.n)
    states = [np.reshape(x, (-1, ROBOT.n)) for x in (q, dq, ddq)]
    warm = None if temperature is None else np.broadcast_to(temperature, states[0].shape)
    t = np.atleast_1d(np.asarray(t, float))
    motion = Motion(t, *states, sign_width=SIGN_WIDTH, temperature=warm)
    step = {step}  # columns are many times as large as the torque
    parts = (motion.part(slice(k, k + step)) for k in range(0, max(len(t), 1), step))
    return np.concatenate([_torque(part) for part in parts]).reshape(q.shape)


def _torque(motion):
    blocks = [(k, block) for effect, k in EFFECTS for block in effect.blocks(motion)]
    if LATE:
        known = _sum(blocks, REFERENCE, motion)
        motion = replace(motion, torque=known, current=CurrentModel(ROBOT, LINKS))
        blocks += [(k, block) for effect, k in LATE for block in effect.blocks(motion)]
    return GAINS * _sum(blocks, THETA, motion)


def _sum(blocks, theta, motion):
    out = np.zeros_like(motion.q)
    for k, block in blocks:
        out[:, block.joint] += block.columns @ theta[k + block.parameters]
    return out
'''


def make_function(estimate: Estimate) -> bytes:
    """Source of a module with ``torque(q, dq, ddq, t=None)``, equal to ``estimate.torque``: expressions
    (compact.py) where they hold the whole model, else its own classes.

    Raises InputError for an effect that needs more than NumPy.
    """
    model, robot = estimate.model, estimate.robot
    if robot.mechanism is not None:
        raise InputError(
            "the function has no place for joints that follow others", "write .json or .urdf instead"
        )
    if is_plain(estimate):
        return plain_function(estimate)
    lines: dict[bool, list[str]] = {False: [], True: []}
    for e, places in zip(model.effects, model.indices, strict=True):
        line = f"    (_given({type(e).__name__}, {_own(e)}), {places[0] if len(places) else 0}),"
        lines[depends(e)].append(line)
    reference, links = model.reference, np.zeros((robot.links, 10))
    if reference is not None and len(model.rigid_indices):
        links = reference[model.rigid_indices].reshape(-1, 10)
    timed = sorted({e.name for e in model.effects if _needs_time(e)})
    joints = [
        f"        SimpleNamespace(kind={j.kind!r}, parent={j.parent}, placement={literal(j.placement)}, "
        f"axis={literal(j.axis)}, link_frame={literal(j.link_frame)}),"
        for j in robot.joints
    ]
    told = about(estimate)
    end = _END.format(
        **told,
        joint_lines="\n".join(joints),
        gravity=tuple(float(g) for g in robot.gravity),
        effect_lines="\n".join(lines[False]),
        late_lines="\n".join(lines[True]),
        reference=literal(reference),
        links=literal(links),
        gains=list(model.gains or (1.0,) * robot.n),
        sign_width=model.sign_width,
        needs_time=timed,
        step="max(len(t), 1)" if any(e.has_memory for e in model.effects) else 8192,
    )
    known = {"np": np, "replace": replace, "SimpleNamespace": SimpleNamespace, "Robot": Robot}
    known |= {"Motion": Motion, "CurrentModel": CurrentModel, "Shape": Shape}
    known |= {type(e).__name__: type(e) for e in model.effects}
    imports, definitions = linked(end, known, {Robot: plain_robot.Robot}, without=["parameters"])
    text = _TEMPLATE.format(
        **told,
        timed=", ".join(timed) or "no effect of this model",
        imports=imports,
        definitions=definitions,
        end=end,
    )
    return text.encode()


def _own(effect: Effect) -> str:
    """What an effect knows beside its robot, as keywords."""
    kind, rest = type(effect), ("robot", "given", "asked_joints")
    known = {k: x for k, x in vars(effect).items() if k not in rest}
    known = {k: x for k, x in known.items() if not isinstance(getattr(kind, k, 0), cached_property)}
    return ", ".join(f"{k}={literal(x)}" for k, x in known.items())


def _needs_time(effect: Effect) -> bool:
    """Whether the columns of an effect change when the same samples come at other instants."""
    robot = effect.robot
    rng = np.random.default_rng(0)
    q, dq, ddq, torque = rng.normal(size=(4, 6, robot.n))
    current = CurrentModel(robot, rng.normal(size=(robot.links, 10)))
    fast, slow = (
        effect.blocks(Motion(step * np.arange(6.0), q, dq, ddq, torque, current, temperature=q))
        for step in (0.1, 0.3)
    )
    return not all(np.array_equal(a.columns, b.columns) for a, b in zip(fast, slow, strict=True))
