"""Columns are the torque of the hidden world, signed.

The worlds state the torque of an effect a second time,
in code that shares nothing with the columns (``tests/simulation/test_challenge.py``
looks). Forms that no world draws stand here.
"""

from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from sdp_vs_penalty import load_problem
from sdp_vs_penalty.diagnosis import size_of
from sdp_vs_penalty.effects import CurrentModel, Effect, Motion, effect_types
from sdp_vs_penalty.robot import random_trajectory
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
from sdp_vs_penalty.testing.effect_contract import wide_columns

Array = NDArray[np.float64]


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
def worlds():
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

    def rigid(self, motion, model=None):
        if motion is self.motion and model is None:
            return self.torque_of_motion
        return super().rigid(motion, model)


@cache
def setting(which, width, fine, rate, has_torque):
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
    def fitted(self):
        """Parameters of least squares, and the share of the torque that they leave."""
        wide = np.concatenate([self.columns, self.plain], axis=2).reshape(
            self.torque.size, -1
        )
        theta, *_ = np.linalg.lstsq(wide, self.torque.ravel())
        left = self.torque.ravel() - wide @ theta
        share = float(np.linalg.norm(left) / np.linalg.norm(self.torque))
        return theta[: self.columns.shape[2]], share


@cache
def hidden_cases(name):
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


def _width(name):
    """Over which dry friction turns: a sign is a sign, but a late one has a derivative."""
    return 0.3 if name in ("torque_delay", "global_delay", "torque_filter") else 1e-8


def _case(where, which, hidden):
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

    def columns(kind, **shape):
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


def check_columns_are_the_hidden_torque(name):
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
        if case.hidden.library_value is not None and kind.sized_by == slice(None):
            size, _ = size_of(case.effect, theta, np.zeros((len(theta),) * 2))
            true = case.hidden.library_value * case.hidden.size
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


def _laws(*forms):
    """Of a joint's motion: its torque, the number behind it and its shape, form by
    form."""

    def made(w, j):
        return [
            at_joint(j, lambda w, m, x=law: x(m, j), number, **shape)
            for law, number, shape in forms
        ]

    return made


def _transmission(w, j):
    first = min(j, w.arm.n - 2)
    ratio = -2.0
    if not w.arm.rotary[first : first + 2].all():
        return []

    def change(law):
        def torque(w, m, size):
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


def _both_ways(w, j):
    """A low-pass there and back, of all but the links' torque: by its transfer
    function."""

    def change(w, m, size):
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


def _sharp_flanks(w, j):
    def change(w, m, b):
        q = m.q.copy()
        q[:, j] -= b * np.sign(w.rigid(m)[:, j])
        return np.asarray(w.rigid(replace(m, q=q)) - w.rigid(m))

    def shift(w, m, b):
        step = butter(4, 8.0 * (m.t[1] - m.t[0]), output="sos")  # below 4 Hz
        return np.asarray(-b * sosfiltfilt(step, np.sign(w.rigid(m)[:, j])))

    slow = replace(
        shifted(j, shift, 1.0, 2e-4), shape={"law": 2.0}, details={"allowed": STEPS}
    )
    return [Hidden((j,), change, 1.0, size=5e-4, details={"allowed": ACCURACY}), slow]


def _wave(m, j):
    q = m.q[:, j]
    return np.asarray(
        np.sign(m.dq[:, j]) * (np.cos(2.0 * q + 1.0) + 0.5 * np.sin(4.0 * q))
    )


def _dip(share, law, delta):
    def torque(m, j):
        return np.asarray(np.sign(m.dq[:, j]) * share(np.abs(m.dq[:, j]) / 0.1))

    return torque, 1.0, {"vs": 0.1, "delta": delta, "law": law}


def _rise(share, law):
    def torque(m, j):
        return np.asarray(share(m.dq[:, j]) - np.sign(m.dq[:, j]))

    return torque, 1.0, {"v0": 0.1, "law": law}


def _even_slip(m, j):
    out = np.zeros(len(m.t))
    z = np.zeros(3)
    for k, step in enumerate(np.diff(m.q[:, j]), start=1):
        z = np.clip(z + step / (0.002 * np.array([1.0, 4.0, 16.0])), -1.0, 1.0)
        out[k] = z.mean()
    return out


#: By effect what makes the forms that no world draws, of a world and a joint.
OTHER_FORMS = {
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
