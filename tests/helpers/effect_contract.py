"""Robots and motions to try effects on; units are those of the columns, and columns the
torque of the hidden world, signed.

Robots have joints of one kind only where shape constants are at work: one constant for
rad and m at once has no unit. The worlds state the torque of an effect a second time,
in code that shares nothing with the columns (``tests/simulation/test_challenge.py``
looks). Forms that no world draws stand here.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from random_robots import link_parameters, sines, tree
from scipy.signal import butter, sosfiltfilt

from sdp_vs_penalty import Problem, load_problem
from sdp_vs_penalty.diagnosis import size_of
from sdp_vs_penalty.effects import (
    CurrentModel,
    Effect,
    Motion,
    effect_types,
    parse_effects,
)
from sdp_vs_penalty.effects.motion import Command
from sdp_vs_penalty.robot import Joint, Robot, random_trajectory
from sdp_vs_penalty.simulation import (
    MAKERS,
    DryFriction,
    Hidden,
    TrueMotion,
    World,
    at_joint,
    experiment,
    shifted,
    true_world,
)

Array = NDArray[np.float64]


@cache
def robots() -> dict[str, Robot]:
    """A tree with both kinds of joints; an arm and a gantry with one kind; single
    joints."""

    def all_of(kind: str, robot: Robot) -> Robot:
        return replace(robot, joints=tuple(replace(j, kind=kind) for j in robot.joints))

    chain = tree(np.random.default_rng(1), 3, branched=False, link_frames=True)
    one = tree(np.random.default_rng(5), 1)
    return {
        "tree": tree(np.random.default_rng(5), 5),
        "arm": all_of("revolute", chain),
        "gantry": all_of("prismatic", chain),
        "single": all_of("revolute", one),
        "slide": all_of("prismatic", one),
    }


def steady_motion(robot: Robot, rows: int = 60, seed: int = 0) -> Motion:
    """A motion without reversals and far from standstill, with a current model.

    |dq| stays beyond 0.3 rad/s, where every smoothed sign is one, so that nothing but the declared
    shape constants has the unit of a velocity.
    """
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 0.01 * (rows - 1), rows)
    v = (0.8 + 0.7 * np.arange(robot.n)) * rng.choice([-1.0, 1.0], robot.n)
    a = rng.uniform(-0.2, 0.2, robot.n)
    phase = rng.uniform(0, 6, robot.n)
    wave = 3.0 * t[:, None] + phase
    q = rng.normal(size=robot.n) + np.outer(t, v) + a * np.sin(wave) / 3.0
    dq, ddq = v + a * np.cos(wave), -3.0 * a * np.sin(wave)
    links = np.array([link_parameters(rng, 0.4) for _ in robot.joints])
    torque = robot.inverse_dynamics(links, q, dq, ddq) + 0.5 * np.sign(dq) + 0.1 * dq
    warm = 20.0 + 300.0 * np.outer(t, 1.0 + np.arange(robot.n))
    moved = Motion(
        t,
        q,
        dq,
        ddq,
        torque,
        CurrentModel(robot, links),
        temperature=warm,
        motors=1.2 * ddq,
    )
    return told(moved)


def to_and_fro(robot: Robot) -> Motion:
    """Six seconds of sines with reversals, and a current model."""
    moved = sines(np.random.default_rng(3), robot.n, np.arange(0.0, 6.0, 0.01), 0.1, 5)
    current = steady_motion(robot).current
    torque = (
        robot.inverse_dynamics(current.links, moved.q, moved.dq, moved.ddq)
        + 0.3 * moved.dq
    )
    seen = {
        "temperature": 25.0 + 3.0 * moved.q,
        "motors": 1.1 * moved.ddq,
        "sign_width": 0.02,
    }
    return told(replace(moved, torque=torque, current=current, **seen))


def told(motion: Motion) -> Motion:
    """With a command: positions and integrals of about the motion's own size."""
    q, dq, ddq = (1.3 * x for x in (motion.q, motion.dq, motion.ddq))
    sums = np.cumsum(motion.q, axis=0) * (motion.t[1] - motion.t[0])
    return replace(
        motion,
        command=Command(motion.t, q, dq, ddq, 1.7 * sums),
        position_integral=sums,
    )


def wide_columns(effect: Effect, motion: Motion) -> Array:
    """(n, N, p) all columns, zero where a joint has none."""
    out = np.zeros((effect.robot.n, len(motion.t), len(effect.parameters)))
    for block in effect.blocks(motion):
        out[block.joint][:, block.parameters] += block.columns
    return out


#: Of a form that is searched on a joint in more sizes than these, so many are tried.
SIZES_TRIED = 12


def some_of_each_form(effects: list[Effect]) -> list[Effect]:
    """Of each form, its smallest and largest shape constants and some between them.

    Effects have one form if they act on the same joints and make the same choices.
    """
    forms: dict[Any, list[Effect]] = {}
    for effect in effects:
        choices = [effect.shape[k] for k, s in effect.shapes.items() if s.choices]
        forms.setdefault((effect.joints, *choices), []).append(effect)
    tried = []
    for form in forms.values():
        count = min(len(form), SIZES_TRIED)
        tried += [form[k] for k in np.linspace(0, len(form) - 1, count).astype(int)]
    return tried


def variants(name: str, robot: Robot) -> list[Effect]:
    """The effect on all joints as it is by default, and on each with what a search
    begins with."""
    kind = effect_types()[name]
    searched = [
        effect
        for joint in ([None] if kind.whole_robot else range(robot.n))
        for effect in some_of_each_form(kind.candidates(robot, joint))
    ]
    if (
        name == "measured_curve"
    ):  # measured, not searched: over what is more than a joint's own signal
        kinds = [j.kind for j in robot.joints]
        other = 2 + kinds[1:].index(kinds[0]) if kinds[0] in kinds[1:] else 0
        over = [f"x={w}@xj=1@xi={other}@xc=-2" for w in ("q", "dq") if other]
        ends = "@xlow=-0.4@xhigh=0.9@v1=-1@v2=2"
        texts = [f"{name}:1@{x}{ends}" for x in over]
        searched = list(parse_effects(texts, robot))
    return [kind(robot), *searched]


def unit_scale(unit: str, base: dict[str, float], constants: dict[str, float]) -> float:
    """By what a number in this unit is multiplied if the base units are."""
    if unit == "-":
        return 1.0
    newton = base["kg"] * base["m"] / base["s"] ** 2
    known = {
        **base,
        "N": newton,
        "rad": 1.0,
        "turn": 1.0,
        "K": 1.0,
        "Hz": 1.0 / base["s"],
        **constants,
    }
    return float(
        eval(unit.replace("^", "**"), {"__builtins__": {}}, known)
    )  # units are our own words


def in_other_units(robot: Robot, base: dict[str, float]) -> Robot:
    """The same robot where a length of 1 m reads base["m"], and so on."""

    def moved(pose: Array) -> Array:
        out = np.array(pose)
        out[:3, 3] *= base["m"]
        return out

    def joint(j: Joint) -> Joint:
        return replace(j, placement=moved(j.placement), link_frame=moved(j.link_frame))

    x, y, z = np.array(robot.gravity) * base["m"] / base["s"] ** 2
    return Robot(robot.name, tuple(joint(j) for j in robot.joints), (x, y, z))


def check_units_are_those_of_the_columns(name: str) -> None:
    """Rewrite the whole problem in other units of mass, length and time: a column in
    the new units must be the old one times torque / parameter, with shape constants
    converted by their own unit."""
    for base in ({"kg": 1.0, "m": 1.0, "s": 0.7}, {"kg": 1.9, "m": 1.6, "s": 1.3}):
        for which, robot in robots().items():
            position = np.array([unit_scale(u, base, {}) for u in robot.position_units])
            torque = np.array([unit_scale(u, base, {}) for u in robot.torque_units])
            motion = steady_motion(robot)
            new = _rewritten(
                motion, in_other_units(robot, base), base, position, torque
            )
            for effect in variants(name, robot):
                if not effect.parameters or (which == "tree" and effect.shapes):
                    continue
                kind = effect.robot.joints[effect.joints[0]].kind
                shape = {
                    key: value * unit_scale(effect.shapes[key].unit_on(kind), base, {})
                    for key, value in effect.shape.items()
                }
                joints = (
                    None if effect.asked_joints is None else list(effect.asked_joints)
                )
                rewritten = type(effect)(new.current.robot, joints, **shape)
                # A unit may hold an exponent, which is a number by itself.
                numbers = {
                    k: v
                    for k, v in effect.shape.items()
                    if effect.shapes[k].unit == "-"
                }
                scale = np.array(
                    [unit_scale(p.unit, base, numbers) for p in effect.parameters]
                )
                expected = wide_columns(effect, motion) * torque[:, None, None] / scale
                found = wide_columns(rewritten, new)
                atol = 1e-9 * np.abs(expected).max()
                wrong = [
                    f"{p.name} [{p.unit}]"
                    for p, a, b in zip(
                        effect.parameters, expected.T, found.T, strict=True
                    )
                    if not np.allclose(b, a, 1e-7, atol)
                ]
                assert not wrong, (
                    f"{effect.text} on {which}: torque over column is not in the unit"
                    f" declared of {', '.join(wrong)} (or a shape constant's unit is"
                    " wrong)"
                )


def _rewritten(
    motion: Motion, robot: Robot, base: dict[str, float], position: Array, torque: Array
) -> Motion:
    s = base["s"]
    m = base["m"]
    kg = base["kg"]
    links = motion.model_links * kg * np.array([1, m, m, m, *[m * m] * 6])

    def moved(x: Motion | Command) -> tuple[Array, Array, Array, Array]:
        return x.t * s, x.q * position, x.dq * position / s, x.ddq * position / s**2

    return Motion(
        *moved(motion),
        motion.model_torque * torque,
        CurrentModel(robot, links),
        sign_width=motion.sign_width * position[0] / s,
        temperature=motion.temperature,
        command=Command(
            *moved(motion.logged_command),
            motion.logged_command.position_integral * position * s,
        ),
        position_integral=motion.integral * position * s,
        motors=motion.motor_acceleration * position / s**2,
    )


#: Of the torque: what sampling, and columns that are of first order in their parameter,
#: may cost.
ACCURACY = 0.01
#: Draws a joint: together they meet every form and every sign that a world draws.
DRAWS = 3
#: Sizes over those at which worlds begin, where a half is too small for the time
#: between two samples.
SIZES = {"torque_filter": 5.0}
#: Flanks yield a little in the worlds; sharp forms stand below, one with rates of what
#: changes within a sample.
YIELDS = 0.25
STEPS = 0.02
#: Seconds of the motion that are compared: bristles have settled, and the way back to
#: rest is left out.
BEGIN = 2.0
END = 15.5


@cache
def worlds() -> dict[str, tuple[Problem, World, Array]]:
    """A seven-joint arm, and one with a prismatic joint between two revolute ones;
    their true links."""
    urdf = Path(__file__).parent / "slide_arm.urdf"
    problems = {"panda": load_problem("panda"), "slide_arm": load_problem(urdf)}
    setups = {k: experiment(p) for k, p in problems.items()}
    return {
        k: (p, true_world(p, setups[k], seed=3), setups[k].links)
        for k, p in problems.items()
    }


@dataclass(frozen=True)
class SharedWorld(World):
    """A true robot that keeps the rigid-body torque (N, n) of the motion that its cases
    share."""

    motion: TrueMotion | None = None
    torque_of_motion: Array | None = None

    def rigid(self, motion: TrueMotion, model: Any = None) -> Array:
        if motion is self.motion and model is None:
            return self.torque_of_motion
        return super().rigid(motion, model)


@cache
def setting(
    which: str, width: float, fine: float, rate: float, has_torque: bool
) -> tuple[SharedWorld, TrueMotion, Motion]:
    """A robot whose dry friction turns over a width [rad/s, m/s], 17 s of its motion at
    the rate ``fine`` [1/s], and every so many of its samples as columns see them, at
    ``rate`` [1/s], with a torque or without."""
    problem, world, links = worlds()[which]
    robot = problem.robot
    trajectory = random_trajectory(robot, 5, 17.0, frequency=2.0 * np.pi / 13.3)
    t = np.arange(0.0, 17.0, 1.0 / fine)
    true = TrueMotion(t, *trajectory.states(t))
    parts = {field.name: getattr(world, field.name) for field in fields(world)}
    parts["dry"] = DryFriction(np.full(robot.n, width))
    sharp = SharedWorld(**parts, motion=true, torque_of_motion=world.rigid(true))
    rows = slice(None, None, int(fine / rate))
    motion = Motion(
        t[rows],
        true.q[rows],
        true.dq[rows],
        true.ddq[rows],
        sharp.torque(true)[rows] if has_torque else None,
        CurrentModel(robot, links),
        sign_width=width,
        temperature=sharp.temperature(t[rows]),
    )
    return sharp, true, motion


@dataclass(frozen=True)
class Case:
    """One hidden effect: its torque (n, N); columns (n, N, k) of the effect with the
    true shape; plain (n, N, m) columns of the effects that it refines, where it counts
    time from elsewhere."""

    where: str
    hidden: Hidden
    effect: Effect
    torque: Array
    columns: Array
    plain: Array

    @property
    def fitted(self) -> tuple[Array, float]:
        """Parameters of least squares, and the share of the torque that they leave."""
        wide = np.concatenate([self.columns, self.plain], axis=2).reshape(
            self.torque.size, -1
        )
        theta, *_ = np.linalg.lstsq(wide, self.torque.ravel())
        left = self.torque.ravel() - wide @ theta
        share = float(np.linalg.norm(left) / np.linalg.norm(self.torque))
        return theta[: self.columns.shape[2]], share


@cache
def hidden_cases(name: str) -> tuple[Case, ...]:
    """What worlds draw, wherever it makes a torque (an axis along gravity has no
    backlash), and the other forms."""
    kind = effect_types()[name]
    cases = []
    for which, (problem, world, _) in worlds().items():
        robot = problem.robot
        sharp = replace(world, dry=DryFriction(np.full(robot.n, _width(name))))
        if name == "transmission_friction" and which == "slide_arm":
            continue  # worlds hide it where neighbours turn
        for joint in [0] if kind.whole_robot else (robot.n // 2, robot.n - 1):
            drawn = [
                MAKERS[name](sharp, joint, np.random.default_rng([k, joint]))
                for k in range(DRAWS)
            ]
            drawn = [
                replace(one, size=one.size * SIZES.get(name, 0.5)) for one in drawn
            ]
            others = OTHER_FORMS.get(name, lambda w, j: [])(sharp, joint)
            for one in (replace(x, effect=name) for x in (*drawn, *others)):
                where = f"{which} joint {joint + 1} {one.shape}"
                case = _case(where, which, one)
                if np.abs(case.torque).max() > 1e-9:
                    cases.append(case)
    return tuple(cases)


def _width(name: str) -> float:
    """Over which dry friction turns: a sign is a sign, but a late one has a derivative."""
    return 0.3 if name in ("torque_delay", "global_delay", "torque_filter") else 1e-8


def _case(where: str, which: str, hidden: Hidden) -> Case:
    kind = effect_types()[hidden.effect]
    width = _width(kind.name)
    # Derivatives in time are differences; friction states are integrated in the world,
    # exact in columns.
    fine, rate = (
        (500.0, 250.0) if kind.has_memory or hidden.shift is not None else (100.0, 25.0)
    )
    sharp, true, motion = setting(which, width, fine, rate, kind.needs_torque)
    robot = worlds()[which][0].robot
    seen = slice(int(BEGIN * rate), int(END * rate))
    torque = hidden.torque(sharp, true)[:: int(fine / rate)][seen]

    def columns(kind: type[Effect], **shape: float) -> tuple[Effect, Array]:
        convention = {k: width for k, s in kind.shapes.items() if s.role == "estimated"}
        sized = (
            {kind.sized_shape: hidden.size} if kind.sized_shape in kind.shapes else {}
        )
        effect = kind(
            robot, list(hidden.joints) or None, **convention, **{**sized, **shape}
        )
        return effect, wide_columns(effect, motion)[:, seen]

    effect, own = columns(kind, **hidden.shape)
    plain = [columns(effect_types()[r])[1] for r in kind.refines if kind.follows_clock]
    none = np.zeros((*own.shape[:2], 0))
    return Case(
        where, hidden, effect, torque.T, own, np.concatenate([none, *plain], axis=2)
    )


def check_columns_are_the_hidden_torque(name: str) -> None:
    """In amount and sign: torque less columns times parameters is next to nothing, and
    where one number says how large the effect is, that of the parameters is the true
    one. On both kinds of joints, of every form: shape constants that are choices."""
    kind = effect_types()[name]
    met = set()
    forms = set()
    choices = {k: len(s.choices) for k, s in kind.shapes.items() if s.choices}
    for case in hidden_cases(name):
        forms.add(tuple(case.effect.shape[k] for k in choices))
        theta, share = case.fitted
        allowed = case.hidden.details.get(
            "allowed", YIELDS if name == "backlash" else ACCURACY
        )
        assert share < allowed, (
            f"{name}, {case.where}: {100 * share:.1f} % is not in the columns"
        )
        met |= {case.effect.robot.joints[j].kind for j in case.hidden.joints}
        if case.hidden.number is not None and kind.sized_by == slice(None):
            size, _ = size_of(case.effect, theta, np.zeros((len(theta),) * 2))
            true = case.hidden.number * case.hidden.size
            size = (
                size if len(theta) == 1 else np.copysign(size, true)
            )  # a wave has no sign
            np.testing.assert_allclose(
                size, true, rtol=max(allowed, 3.0 * ACCURACY), err_msg=case.where
            )
            if len(theta) == 1:
                demands = case.effect.constraints(np.arange(len(theta)))
                assert all(c.margin(theta) >= 0.0 for c in demands), (
                    "the truth itself is not possible"
                )
    wrist = name == "transmission_friction"  # they turn
    assert met == (
        set() if kind.whole_robot else {"revolute", *["prismatic"] * (not wrist)}
    )
    assert len(forms) == int(np.prod([*choices.values()])), (
        "the hidden worlds do not meet every form"
    )


def _laws(
    *forms: tuple[Callable[[TrueMotion, int], Array], float | None, dict[str, float]],
):
    """Of a joint's motion: its torque, the number behind it and its shape, form by
    form."""

    def made(w: World, j: int) -> list[Hidden]:
        return [
            at_joint(j, lambda w, m, x=law: x(m, j), number, **shape)
            for law, number, shape in forms
        ]

    return made


def _transmission(w: World, j: int) -> list[Hidden]:
    first = min(j, w.arm.n - 2)
    ratio = -2.0
    if not w.arm.rotary[first : first + 2].all():
        return []

    def change(law: float) -> Callable[[World, TrueMotion, float], Array]:
        def torque(w: World, m: TrueMotion, size: float) -> Array:
            x = m.dq if law == 1.0 else m.ddq
            force = size * (x[:, first] + ratio * x[:, first + 1])
            out = np.zeros_like(m.q)
            out[:, first], out[:, first + 1] = force, ratio * force
            return out

        return torque

    ratios = {f"c{first + 1}": 1.0, f"c{first + 2}": ratio}
    both = (first, first + 1)
    return [
        Hidden(both, change(law), 1.0, {**ratios, "law": law}, 0.5)
        for law in (1.0, 5.0)
    ]


def _both_ways(w: World, j: int) -> list[Hidden]:
    """A low-pass there and back, of all but the links' torque: by its transfer
    function."""

    def change(w: World, m: TrueMotion, size: float) -> Array:
        tau = w.torque(m) - w.rigid(m)
        wide = np.concatenate(
            [np.repeat(tau[:1], 4000, 0), tau, np.repeat(tau[-1:], 4000, 0)]
        )
        s = 2.0 * np.pi * np.fft.rfftfreq(len(wide), float(m.t[1] - m.t[0]))[:, None]
        passed = np.fft.irfft(
            np.fft.rfft(wide, axis=0) / (1.0 + (0.01 * s) ** 2), len(wide), axis=0
        )
        return np.asarray(size / 0.01 * (passed[4000:-4000] - tau))

    return [Hidden((), change, None, {"T": 0.01, "phase": 2.0}, 0.01)]


def _sharp_flanks(w: World, j: int) -> list[Hidden]:
    def change(w: World, m: TrueMotion, b: float) -> Array:
        q = m.q.copy()
        q[:, j] -= b * np.sign(w.rigid(m)[:, j])
        return np.asarray(w.rigid(replace(m, q=q)) - w.rigid(m))

    def shift(w: World, m: TrueMotion, b: float) -> Array:
        step = butter(4, 8.0 * (m.t[1] - m.t[0]), output="sos")  # below 4 Hz
        return np.asarray(-b * sosfiltfilt(step, np.sign(w.rigid(m)[:, j])))

    slow = replace(
        shifted(j, shift, 1.0, 2e-4), shape={"law": 2.0}, details={"allowed": STEPS}
    )
    return [Hidden((j,), change, 1.0, size=5e-4, details={"allowed": ACCURACY}), slow]


def _wave(m: TrueMotion, j: int) -> Array:
    q = m.q[:, j]
    return np.asarray(
        np.sign(m.dq[:, j]) * (np.cos(2.0 * q + 1.0) + 0.5 * np.sin(4.0 * q))
    )


def _dip(
    share: Callable[[Array], Array], law: float, delta: float
) -> tuple[Any, float, dict[str, float]]:
    def torque(m: TrueMotion, j: int) -> Array:
        return np.asarray(np.sign(m.dq[:, j]) * share(np.abs(m.dq[:, j]) / 0.1))

    return torque, 1.0, {"vs": 0.1, "delta": delta, "law": law}


def _rise(
    share: Callable[[Array], Array], law: float
) -> tuple[Any, float, dict[str, float]]:
    def torque(m: TrueMotion, j: int) -> Array:
        return np.asarray(share(m.dq[:, j]) - np.sign(m.dq[:, j]))

    return torque, 1.0, {"v0": 0.1, "law": law}


def _even_slip(m: TrueMotion, j: int) -> Array:
    out = np.zeros(len(m.t))
    z = np.zeros(3)
    for k, step in enumerate(np.diff(m.q[:, j]), start=1):
        z = np.clip(z + step / (0.002 * np.array([1.0, 4.0, 16.0])), -1.0, 1.0)
        out[k] = z.mean()
    return out


#: By effect what makes the forms that no world draws, of a world and a joint.
OTHER_FORMS: Mapping[str, Callable[[World, int], list[Hidden]]] = {
    "drift_offset": _laws((lambda m, j: m.t / 100.0, None, {"form": 1.0, "T": 60.0})),
    "drift_friction": _laws(
        (
            lambda m, j: m.t / 100.0 * np.sign(m.dq[:, j]),
            None,
            {"form": 1.0, "T": 60.0},
        ),
        (lambda m, j: m.t / 100.0 * m.dq[:, j], None, {"form": 3.0, "T": 60.0}),
    ),
    "backlash": _sharp_flanks,
    "maxwell_slip": _laws((_even_slip, 1.0, {"d": 0.002, "law": 2.0})),
    "transmission_friction": _transmission,
    "torque_filter": _both_ways,
    "warming_friction": _laws(
        (
            lambda m, j: np.exp(-m.t / 60.0) * np.sign(m.dq[:, j]),
            1.0,
            {"law": 1.0, "by": 2.0, "T": 60.0},
        ),
        (
            lambda m, j: np.exp(-m.t / 60.0) * m.dq[:, j],
            1.0,
            {"law": 2.0, "by": 2.0, "T": 60.0},
        ),
    ),
    "stribeck_friction": _laws(
        _dip(lambda x: np.exp(-x), 1.0, 1.0),
        _dip(lambda x: 1.0 / (1.0 + x), 2.0, 1.0),
        _dip(lambda x: 1.0 / (1.0 + x**2), 2.0, 2.0),
    ),
    "sigmoid_friction": _laws(
        _rise(lambda v: np.arctan2(v, 0.1) / (0.5 * np.pi), 2.0),
        _rise(lambda v: v / np.sqrt(v**2 + 0.01), 3.0),
    ),
    "position_dependent_friction": _laws((_wave, None, {"k": 2.0, "waves": 2.0})),
}
