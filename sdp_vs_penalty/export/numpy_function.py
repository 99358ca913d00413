"""The whole model as one Python file that needs nothing but NumPy.

The file is put together from this package's own source: the dynamics of plain_robot.py, Model, and
the classes of the model's effects with whatever functions they call. So an exported function is the
model, for every effect, not a second implementation of it.
"""

from __future__ import annotations

import ast
import inspect
import sys
import textwrap
from dataclasses import dataclass, field
from functools import cached_property
from types import FunctionType, ModuleType
from typing import Any

import numpy as np

from sdp_vs_penalty.effects import model as model_module
from sdp_vs_penalty.effects.effect import CurrentModel, Effect, Motion
from sdp_vs_penalty.errors import InputError
from sdp_vs_penalty.estimation.estimate import Estimate
from sdp_vs_penalty.export import plain_robot
from sdp_vs_penalty.export.compact import is_plain, plain_function
from sdp_vs_penalty.export.content import about
from sdp_vs_penalty.export.reachable import names, needed
from sdp_vs_penalty.robot.robot import Robot

_PACKAGE = "sdp_vs_penalty"
#: Of a model, what the file says instead of working it out, or of checking it.
_KNOWN = ("reference", "gains", "indices", "rigid_indices", "sign_width", "needs_reference")
_TEMPLATE = '''\
"""Joint torques of {robot}, identified by {method}; written by sdp-vs-penalty {version}.

    tau = torque(q, dq, ddq)        # (n,) or (N, n): rad or m, /s, /s^2 -> N m or N
    tau = torque(q, dq, ddq, t)     # t (N,) in s: needed by {timed}

Joints in order: {joints}.
Effects: {effects}.
Needs Python 3.10 or later and NumPy; nothing of sdp-vs-penalty.
"""

from __future__ import annotations

{imports}
import sys
import types

# Whoever loads this file by hand may not have registered it; dataclasses look their module up.
_BY_HAND = __name__ not in sys.modules
if _BY_HAND:
    sys.modules[__name__] = types.ModuleType(__name__)
    sys.modules[__name__].__dict__.update(globals())

{sources}


if _BY_HAND:
    del sys.modules[__name__]


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


EFFECTS = (
{effect_lines}
)
#: Parameter values, in the order of NAMES.
THETA = np.array({theta})
NAMES = {names}
MODEL = _given(Model, effects=EFFECTS, {known})
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
    motion = Motion(np.atleast_1d(np.asarray(t, float)), *states, temperature=warm)
    return MODEL.torque(THETA, motion).reshape(q.shape)
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
    bundle = _Bundle()
    for thing in vars(plain_robot).values():
        if getattr(thing, "__module__", None) == plain_robot.__name__:
            bundle.add(thing)
    for effect in model.effects:
        bundle.add(type(effect))
    bundle.add(Motion)
    bundle.add(model_module.Model)
    timed = sorted({e.name for e in model.effects if _needs_time(e)})
    joints = [
        f"        SimpleNamespace(kind={j.kind!r}, parent={j.parent}, placement={_array(j.placement)}, "
        f"axis={_array(j.axis)}, link_frame={_array(j.link_frame)}),"
        for j in robot.joints
    ]
    effects = [f"    _given({type(e).__name__}, {_own(e)})," for e in model.effects]
    known = ", ".join(f"{name}={_text(getattr(model, name))}" for name in _KNOWN)
    told = about(estimate)
    end = _END.format(
        **told,
        joint_lines="\n".join(joints),
        gravity=tuple(float(g) for g in robot.gravity),
        effect_lines="\n".join(effects),
        known=known,
        needs_time=timed,
    )
    given = [".parameters", *(f"Model.{name}" for name in _KNOWN)]
    sources, used = needed(bundle.sources, end, given)
    for name in sorted(used & bundle.foreign.keys()):
        raise InputError(
            f"{name} ({bundle.foreign[name]}) is needed by an effect of this model, not plain NumPy",
            "export it as .json",
        )
    text = _TEMPLATE.format(
        **told,
        timed=", ".join(timed) or "no effect of this model",
        imports="\n".join(sorted(x for x in bundle.imports if x.rpartition(" as ")[2] in used)),
        sources=sources,
        end=end,
    )
    return text.encode()


def _own(effect: Effect) -> str:
    """What an effect knows beside its robot, as keywords."""
    kind, rest = type(effect), ("robot", "given", "asked_joints")
    known = {k: x for k, x in vars(effect).items() if k not in rest}
    known = {k: x for k, x in known.items() if not isinstance(getattr(kind, k, 0), cached_property)}
    return ", ".join(f"{k}={_text(x)}" for k, x in known.items())


def _text(value: Any) -> str:
    if isinstance(value, tuple) and any(isinstance(x, np.ndarray) for x in value):
        return f"[{', '.join(map(_text, value))}]"
    if not isinstance(value, np.ndarray):
        return repr(value)
    whole = value.dtype.kind == "i"
    return f"np.array({value.tolist()!r}, int)" if whole else _array(value)


def _array(values: Any) -> str:
    return f"np.array({np.asarray(values, float).tolist()!r})"


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


@dataclass
class _Bundle:
    """Sources of classes and functions, each behind everything that it uses, and their imports."""

    sources: list[str] = field(default_factory=list)
    imports: set[str] = field(default_factory=set)
    #: What is no plain NumPy, by name: to be refused where it is truly needed.
    foreign: dict[str, str] = field(default_factory=dict)
    _known: dict[str, int] = field(default_factory=dict)

    def add(self, thing: Any) -> None:
        """Add a class or function of this package with its dependencies, once."""
        name = thing.__name__
        if self._known.setdefault(name, id(thing)) == id(thing) and name in self._done:
            return
        if self._known[name] != id(thing):
            raise InputError(
                f"{name} is the name of two things: the model cannot be written as one file",
                "rename one of them",
            )
        self._done.add(name)
        source = textwrap.dedent(inspect.getsource(thing))
        home = vars(sys.modules[thing.__module__])
        for used in names(source):
            if used in home and used != name:
                self._need(used, home[used], source)
        self.sources.append(source.rstrip())

    def __post_init__(self) -> None:
        self._done: set[str] = set()

    def _need(self, name: str, value: Any, source: str) -> None:
        if value is Robot:  # the plain one stands in
            return
        value = inspect.unwrap(value) if callable(value) else value  # a cached one
        home = getattr(value, "__module__", None) or ""
        if isinstance(value, ModuleType):
            self._module(name, value, source)
        elif isinstance(value, type | FunctionType) and home.startswith(_PACKAGE):
            self.add(value)
        elif isinstance(value, bool | int | float | str | tuple | type(None)):
            self._constant(name, repr(value))
        elif isinstance(value, np.ndarray):
            self._constant(name, _array(value))
        elif callable(value) and home.split(".")[0] in sys.stdlib_module_names:
            self.imports.add(f"from {home} import {value.__name__} as {name}")
        elif home.split(".")[0] not in ("numpy", "typing", "collections"):
            self.foreign[name] = home or type(value).__name__

    def _module(self, name: str, module: ModuleType, source: str) -> None:
        top = module.__name__.split(".")[0]
        if top == _PACKAGE:
            used = [
                node.attr
                for node in ast.walk(ast.parse(source))
                if isinstance(node, ast.Attribute)
                and isinstance(node.value, ast.Name)
                and node.value.id == name
            ]
            for attribute in used:
                self._attribute(name, attribute, getattr(module, attribute))
        elif top == "numpy" or top in sys.stdlib_module_names:
            self.imports.add(f"import {module.__name__} as {name}")
        else:
            self.foreign[name] = module.__name__

    def _attribute(self, module: str, name: str, value: Any) -> None:
        """Make ``module.name`` mean the bundled thing."""
        self.imports.add("from types import SimpleNamespace as SimpleNamespace")
        if module not in self._known:
            self._known[module] = 0
            self.sources.append(f"{module} = SimpleNamespace()")
        if isinstance(value, type | FunctionType):
            self.add(value)
            text = value.__name__
        else:
            text = _array(value) if isinstance(value, np.ndarray) else repr(value)
        line = f"{module}.{name} = {text}"
        if line not in self.sources:
            self.sources.append(line)

    def _constant(self, name: str, text: str) -> None:
        line = f"{name} = {text}"
        if line not in self.sources:
            if self._known.setdefault(name, hash(text)) != hash(text):
                raise InputError(
                    f"{name} means two things: the model cannot be written as one file",
                    "rename one of them",
                )
            self.sources.append(line)
