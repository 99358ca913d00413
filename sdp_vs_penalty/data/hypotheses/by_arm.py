"""What names leave open the arm decides, where the robot is known: the unit of positions,
which of several sets of channels is the torque, whether a register has a sign bit, and
whether columns are at all what their order or their letters suggest."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from sdp_vs_penalty import formatting
from sdp_vs_penalty.data.draft import Draft
from sdp_vs_penalty.data.hypotheses.arm import (
    N_PARTS,
    ChannelFit,
    fit_arm,
    signed_register,
)
from sdp_vs_penalty.data.hypotheses.channels import Recognition
from sdp_vs_penalty.data.hypotheses.recognition import is_current, with_torque
from sdp_vs_penalty.data.hypotheses.renaming import factors_and_zeros, one_or_each
from sdp_vs_penalty.data.hypotheses.weighing import (
    CERTAIN,
    DEGREES_OR_PERCENT,
    EXPLAINS_NONE,
    ColumnHypothesis,
    is_in_one_unit,
    rate_from_velocities,
    weigh,
    which_torque,
)
from sdp_vs_penalty.data.measurements import Measurements
from sdp_vs_penalty.data.plausibility import (
    ENCODER_ZERO,
    far_outside,
    is_in_ranges,
    radians_per_percent,
)
from sdp_vs_penalty.data.recorder import Recorder
from sdp_vs_penalty.data.stretches.gaps import stray_rows
from sdp_vs_penalty.data.words.tokens import group_of
from sdp_vs_penalty.data.words.units import (
    ENCODER_BITS,
    LENGTHS,
    UNITS,
    unit_of_factor,
    units_in_names,
)
from sdp_vs_penalty.robot.arrays import Array, Arrays
from sdp_vs_penalty.robot.robot import Robot

#: A unit stays possible up to these odds of gears in its place.
_POSSIBLE = 30.0
#: How usual units are that no name says, beside radians (1): degrees; per cent, of a
#: servo; turns, or counts of one size.
_DEGREES, _OF_SERVO, _RARE = 0.5, 0.5, 1e-2
#: Share of logs whose zeros put a joint outside its range.
_BESIDE_RANGE = 1e-2
#: Factors by which gears could change the scale of all joints, or of one, each with its
#: odds over the unit from which the unit is not certain. A unit that is not ten times as
#: likely as a far factor (0.1) is not certain: the log does not tell the size of angles.
_GEARS_OF_ALL = {0.6: 0.1, 0.75: 0.1, 0.91: 1.0, 1.1: 1.0, 1.33: 0.1, 1.7: 0.1}
_GEARS_OF_ONE = {0.6: 5.0, 1.7: 5.0}
_TURN = 2.0 * np.pi
#: Torques that are so many times what the nominal links need, or less, are in another unit.
_OTHER_SIZE = 4.0

#: How the sentence of a unit begins that is not certain.
_Q_MAY_BE = "q may be of motors behind gears, or in "

#: Of torques to which no arm can be fitted.
_NO_FIT = ChannelFit(share=1.0, friction=0.0)
#: Fits the arm to torques (N, n), by positions (N, n).
Fit = Callable[[Array, Array], ChannelFit | None]


@dataclass(frozen=True)
class _Unit:
    """A unit of positions: in SI they are scale times them, plus middle."""

    #: What the positions are in, in words.
    words: str
    #: How often positions are in it.
    prior: float
    #: (n,) SI units of one.
    scale: Array
    #: (n,) SI units of its zero.
    middle: Array
    #: Whether there are units of nearly that size, as of encoders: no arm tells them apart.
    is_of_any_size: bool = False

    def in_si(self, q: Array) -> Array:
        """Return positions (N, n) in SI, continued where they were cut at a turn."""
        with np.errstate(invalid="ignore"):  # infinite positions are refused elsewhere
            return np.unwrap(self.scale * q + self.middle, axis=0)

    def scale_words(self, robot: Robot) -> str:
        """Format the value of ``--scale q=`` that makes SI units of them."""
        words = list[str]()
        zeros = (-self.middle / self.scale).tolist()  # where scale q + middle is 0
        for joint, factor, zero in zip(
            robot.joints, self.scale.tolist(), zeros, strict=True
        ):
            # A factor is written as a unit of the joint's kind: 0.001 is mm or mrad.
            kind = "m mm" if joint.kind == "prismatic" else "rad"
            unit = unit_of_factor(factor, "q", kind) or f"{factor:.9g}"
            words.append(f"{unit}@{zero:g}" if zero else unit)
        return one_or_each(words)


def fit_of(
    robot: Robot | None,
    clock: Callable[[Array], Array],
    links: Array | None = None,
    *,
    each_in_its_unit: bool = False,
) -> Fit:
    """Return a function that fits the arm, or its nominal links, to torques (N, n) by
    positions (N, n). It returns None without a robot, or for another number of joints.

    clock : returns the stamps (N,) [s] of positions, whose speed may tell the clock's unit.
    each_in_its_unit : as :func:`fit_arm` has it.
    """

    def fit(q: Array, tau: Array) -> ChannelFit | None:
        is_of_robot = robot is not None and robot.n == q.shape[1] == tau.shape[1]
        if robot is None or not is_of_robot:
            return None
        stamps = clock(q)
        return fit_arm(robot, stamps, q, tau, links, each_in_its_unit=each_in_its_unit)

    return fit


def with_unit_of_positions(
    recognition: Recognition,
    blocks: dict[str, Array],
    robot: Robot,
    fit: Fit,
    apart: Fit,
    recorder: Recorder = Recorder(),  # noqa: B008 (a frozen record)
) -> tuple[Recognition, dict[str, Array]]:
    """Decide the unit of positions where it is open and one unit is certain; propose a
    unit, or gears, where it is not certain and positions are impossible as radians.

    The joints' ranges, what the arm leaves of the torques, and how usual a unit is decide.
    ``apart`` fits each joint's torque in a unit of its own.
    ``recorder`` : a unit that the arm has told of another log holds, unless values allow
    another one only.
    """
    q, tau = blocks["q"], blocks["tau"]
    is_impossible = bool(far_outside(robot, q))
    if not _is_unit_open(recognition, robot, q, is_impossible or bool(recorder.unit)):
        return recognition, blocks
    register, bit = signed_register(tau)
    torques = [tau, register] if bit else [tau]
    is_of_servo = (
        "q" in recognition.units
    )  # degrees or per cent: other units close the question
    weighed = _weighed_units(robot, q, torques, fit, is_of_servo, recorder.unit)
    if not weighed:
        return recognition, blocks
    *other_weights, largest = sorted(weight for weight, _, _ in weighed)
    _, of_best, best = max(weighed, key=lambda x: x[0])
    is_explained = min(x.share for _, x, _ in weighed) <= EXPLAINS_NONE
    is_of_recorder = best.words == recorder.unit
    is_open = is_explained or is_impossible or is_of_recorder
    if np.all(best.scale == 1.0) or not is_open:
        return recognition, blocks
    turning = _revolute(robot)
    lengths = np.delete(best.scale, turning)
    words = best.words + (", lengths in mm" if np.any(lengths != 1.0) else "")
    why = f"the arm leaves {formatting.percent(of_best.share, 2)} of the torques"
    if is_impossible:  # the same in all runs, so that it is said once
        why = "as radians they leave the joints' ranges"
    if is_of_recorder:
        why = f"as the arm tells of {recorder.run}, with the same columns"
        return _in_certain_unit(recognition, blocks, best, of_best.size, words, why)
    odds_of_gears = 0.0
    has_other_angles = np.any(best.scale[turning] != 1.0)
    if is_explained and has_other_angles:
        odds_of_gears = _odds_of_gears(best, of_best.share, q, torques, fit, turning)
    is_far_likelier = not other_weights or largest >= CERTAIN * other_weights[-1]
    is_certain = is_explained and is_far_likelier and odds_of_gears <= 1.0
    if is_certain and not best.is_of_any_size:
        return _in_certain_unit(recognition, blocks, best, of_best.size, words, why)
    may_ask = "q" in recognition.unsaid or recognition.has_our_names
    if not (is_impossible and may_ask):
        return recognition, blocks
    if odds_of_gears <= _POSSIBLE and (
        is_explained or _explains(apart(best.in_si(q), tau))
    ):
        sentences = (*recognition.said, f"{_Q_MAY_BE}{words}: {why}")
        scale = {"q": best.scale_words(robot)}
        return replace(recognition, said=sentences, possible_scale=scale), blocks
    if (
        recognition.unless_confirmed is not None
    ):  # gears of any ratio confirm no columns
        return recognition, blocks
    return _with_possible_gears(recognition, robot, q, tau, fit, apart), blocks


def _is_unit_open(
    recognition: Recognition, robot: Robot, q: Array, is_doubted: bool
) -> bool:
    """Tell whether nothing says the unit of positions q (N, n), and they are not radians by
    their size, or radians are doubted for another reason."""
    stated = recognition.units.get("q")
    is_stated = stated is not None and stated.answer != DEGREES_OR_PERCENT
    if is_stated or "q" in map(group_of, recognition.scale):
        return False
    # Smaller numbers may be turns, larger ones degrees.
    largest = np.abs(q[:, _revolute(robot)]).max(initial=0.0)
    is_of_radians = _LITTLE < largest < _TURN
    return is_doubted or ("q" in recognition.unsaid and not is_of_radians)


def _in_certain_unit(
    recognition: Recognition,
    blocks: dict[str, Array],
    unit: _Unit,
    size: float,
    words: str,
    why: str,
) -> tuple[Recognition, dict[str, Array]]:
    """Take positions in a unit, which the recognition names by ``words``; shift positions
    and commands where the unit's zero is not the joints'.

    ``size`` : the torques over those that the nominal links need, 0 where it is not known.
    """
    recognition = replace(recognition, unit_by_arm=unit.words)
    if "tau" in recognition.unsaid and size > 0.0:
        is_usual = max(size, 1.0 / size) < _OTHER_SIZE
        sentence = (
            f"tau {'in' if is_usual else 'hardly in'} N m, which no name says: they are"
            f" {size:.2g} times what the arm's nominal links need"
        )
        recognition = replace(recognition, said=(*recognition.said, sentence))
    recognition = recognition.with_unit("q", ColumnHypothesis(words, 1.0, why))
    recognition = recognition.with_factors("q", unit.scale.tolist())
    if not unit.middle.any():
        return recognition, blocks
    q = blocks["q"]
    middle = unit.middle / unit.scale
    moved = {
        x: block + middle
        for x, block in blocks.items()
        if x == "q" or (x == "qcmd" and is_in_one_unit(q, block))
    }
    return replace(recognition, is_of_arm=True), {**blocks, **moved}


#: Ratios that are tried for all joints at once: the step from one to the next, and how many.
_STEP_OF_COMMON_RATIO, _N_COMMON_RATIOS = 1.07, 25
#: Steps by which the best of them is then refined.
_STEPS_OF_RATIOS = (1.15, 1.04, 1.01)
#: A step is taken if the arm then leaves less than so many times what it left before.
_LESS = 0.99


def _explains(fit: ChannelFit | None) -> bool:
    """Tell whether an arm explains torques, or cannot be fitted to them."""
    return fit is None or fit.share <= EXPLAINS_NONE


def _with_possible_gears(
    recognition: Recognition, robot: Robot, q: Array, tau: Array, fit: Fit, apart: Fit
) -> Recognition:
    """Propose ``--motors`` with the likeliest gear ratios, if positions q (N, n) can be
    angles of motors and the robot declares no transmission."""
    if robot.transmission is not None:
        return recognition
    ratios, share = _likeliest_ratios(robot, q, tau, apart)
    if share > EXPLAINS_NONE:
        return recognition
    rounded = np.array([float(f"{x:.3g}") for x in ratios])
    # A gear multiplies its motor's torque: torques at the motors are that much too small
    # for the nominal links, torques at the joints are not.
    of_motors = _distance_to_nominal(fit(q / rounded, rounded * tau))
    of_joints = _distance_to_nominal(fit(q / rounded, tau))
    words = ",".join(f"{x:g} q{k}" for k, x in enumerate(rounded.tolist(), 1))
    options = ["--motors", words]
    if of_joints < of_motors:
        options.append("--joint-torque")
    sentence = (
        f"q may be of motors behind gears of {words}: outside the joints' ranges as radians,"
        f" and with these ratios the arm leaves {formatting.percent(share, 2)} of the"
        " torques (write the ratios of the data sheet: a joint that bears little hardly"
        " tells its own)"
    )
    return replace(
        recognition, said=(*recognition.said, sentence), possible_options=tuple(options)
    )


def _likeliest_ratios(
    robot: Robot, q: Array, tau: Array, apart: Fit
) -> tuple[Array, float]:
    """Search the gear ratios (n,), 1 for prismatic joints, by which the arm leaves least of
    the torques (N, n); return them and the share that it leaves.

    One ratio for all joints comes first. Steps then change all ratios, or a single one.
    """
    turning = _revolute(robot)
    is_turning = np.isin(np.arange(robot.n), turning)
    reach = np.array([max(-x.lower, x.upper) for x in robot.joints]) + ENCODER_ZERO
    # By a smaller ratio a joint leaves its range.
    smallest = np.abs(q).max(axis=0) / reach
    if not np.isfinite(smallest).all():
        return np.ones(robot.n), 1.0

    def share_left(ratios: Array) -> float:
        if np.any(ratios[turning] < smallest[turning]):
            return 1.0
        of_arm = apart(q / ratios, tau)
        return 1.0 if of_arm is None else of_arm.share

    common = _STEP_OF_COMMON_RATIO ** np.arange(_N_COMMON_RATIOS)
    common = smallest[turning].max() * common
    ratios = min((np.where(is_turning, x, 1.0) for x in common), key=share_left)
    share = share_left(ratios)
    all_and_each = [is_turning, *np.eye(robot.n, dtype=bool)[turning]]
    for step in _STEPS_OF_RATIOS:
        for changes, factor in product(all_and_each, (step, 1.0 / step)):
            while True:
                tried = np.where(changes, factor * ratios, ratios)
                share_of_tried = share_left(tried)
                if share_of_tried >= _LESS * share:
                    break
                ratios, share = tried, share_of_tried
    return ratios, share


def _distance_to_nominal(fit: ChannelFit | None) -> float:
    """Return how far torques are from the size that the nominal links need, as a logarithm;
    infinite where no size is known."""
    if fit is None or fit.size == 0.0:
        return np.inf
    return abs(float(np.log(fit.size)))


def with_lengths(recognition: Recognition, robot: Robot) -> Recognition:
    """Take positions of prismatic joints in metres where the unit of all joints is one of
    angles; of a unit of lengths and one of angles, each joint's by its kind."""
    slides = np.delete(np.arange(robot.n), _revolute(robot))
    for group in ("q", "dq", "qcmd"):
        factors = np.array(recognition.factors(group, robot.n))
        if np.isnan(factors).any():
            for text in recognition.units[group].answer.split(" and "):
                is_length = text.split("/")[0] in LENGTHS
                joints = slides if is_length else _revolute(robot)
                factors[joints] = units_in_names()[group][text]
            recognition = recognition.with_factors(group, factors.tolist())
        if np.isin(factors[slides], (UNITS["deg"], _TURN)).any():
            factors[slides] = 1.0
            sentence = f"{group} of prismatic joints in m, which no angle is"
            recognition = recognition.with_factors(group, factors.tolist())
            recognition = replace(recognition, said=(*recognition.said, sentence))
    return recognition


def with_joint_side(
    recognition: Recognition, blocks: dict[str, Array], robot: Robot, fit: Fit
) -> tuple[Recognition, dict[str, Array]]:
    """Bring positions and torques of the motors to the joints by the robot's transmission,
    if nothing else brings positions into the joints' ranges and the arm explains the
    torques.

    Names have to say motors, or a unit: other positions may be in degrees. Torques may be
    the joints' already: the side is taken on which the arm leaves less of them.
    """
    q, tau = blocks["q"] * recognition.factors("q", blocks["q"].shape[1]), blocks["tau"]
    is_open = "q" in recognition.unsaid and not any(map(_says_motors, recognition.said))
    if robot.transmission is None or is_open or is_in_ranges(robot, q):
        return recognition, blocks
    at_motors = robot.transmission.at_motors
    possible = [at_motors(joint_torque=x) for x in (False, True)]
    sides = {"q and tau" if "motor" in x.torques else "q": x for x in possible}
    fits = dict[str, ChannelFit]()
    for text, side in sides.items():
        at_joints = side.joint_positions(q)
        of_arm = fit(at_joints, side.joint_torques(tau))
        if of_arm is not None and is_in_ranges(robot, at_joints):
            fits[text] = of_arm
    if not fits:
        return recognition, blocks
    text = min(fits, key=lambda x: fits[x].share)
    share = fits[text].share
    if share > EXPLAINS_NONE:
        return recognition, blocks
    side = sides[text]
    are_rates = {"q": False, "qcmd": False, "dq": True, "dqcmd": True}
    blocks = {**blocks, "tau": side.joint_torques(tau)}
    for group, rates in are_rates.items():
        if group in blocks:
            factors = recognition.factors(group, q.shape[1])
            blocks[group] = side.joint_positions(factors * blocks[group], rates=rates)
            recognition = recognition.without_unit(group)
    sentence = (
        f"{text} are the motors': the robot's transmission makes the joints' of them, of"
        f" which the arm leaves {formatting.percent(share, 2)}"
    )
    others = [
        x for x in recognition.said if not (_says_motors(x) or x.startswith(_Q_MAY_BE))
    ]
    return replace(
        recognition, said=(*others, sentence), possible_scale={}, is_of_arm=True
    ), blocks


def _says_motors(sentence: str) -> bool:
    """Tell whether a sentence is that of columns whose names say motors."""
    return sentence.startswith(("q are the motors'", "tau are the motors'"))


def _odds_of_gears(
    unit: _Unit,
    share: float,
    q: Array,
    torques: Sequence[Array],
    fit: Fit,
    turning: Sequence[int],
) -> float:
    """Return the largest odds of gears over a unit in which the arm leaves ``share`` of the
    torques, each over those up to which the unit is certain: it is not, above 1.

    Factors change the scale of positions q (N, n) of all ``turning`` joints, or of one.
    Those of prismatic joints stay: their ranges tell the unit of a length.
    """
    most = 0.0
    each = np.eye(q.shape[1])[turning]
    factors = [
        (1.0 + (x - 1.0) * each.sum(axis=0), y) for x, y in _GEARS_OF_ALL.items()
    ]
    for x, odds in _GEARS_OF_ONE.items() if len(each) > 1 else ():
        factors += [(1.0 + (x - 1.0) * row, odds) for row in each]
    for factor, odds in factors:
        beside = replace(unit, scale=factor * unit.scale)
        for other in filter(None, (fit(beside.in_si(q), x) for x in torques)):
            most = max(most, (share / other.share) ** N_PARTS / odds)
    return most


#: Positions that are less may be turns [rad].
_LITTLE = 1.0


def _revolute(robot: Robot) -> list[int]:
    """List the joints whose positions are angles."""
    return [j for j, joint in enumerate(robot.joints) if joint.kind == "revolute"]


def likeliest_scale(robot: Robot, run: Measurements, links: Array | None) -> str:
    """Return the value of ``--scale q=`` for positions that joints cannot reach, "" where
    no unit brings them into the joints' ranges.

    The unit is the likeliest by the ranges, the arm (its nominal links (n, 10)) and use.
    """
    torques = [run.tau] if run.torque_logged else []
    fit = fit_of(robot, lambda _: run.t, links)
    units = _weighed_units(robot, run.q, torques, fit, is_of_servo=False)
    if not {*far_outside(robot, run.q)} & {*_revolute(robot)}:
        # Only lengths are out of reach: the angles are radians.
        units = [x for x in units if x[-1].words == "rad"]
    *_, best = max(units, key=lambda x: x[0], default=(None,))
    return "" if best is None or np.all(best.scale == 1.0) else best.scale_words(robot)


def _weighed_units(
    robot: Robot,
    q: Array,
    torques: Sequence[Array],
    fit: Fit,
    is_of_servo: bool,
    unit_of_others: str = "",
) -> list[tuple[float, ChannelFit, _Unit]]:
    """List the units in which positions (N, n) may be, each with its weight and with the
    fit to those of several torques that the arm explains best in it.

    Ranges and use alone make the weights where the arm explains the torques in no unit.
    """
    fitted = list[tuple[ChannelFit, _Unit]]()
    for unit in _units(robot, q, is_of_servo, unit_of_others):
        fits = (fit(unit.in_si(q), x) for x in torques)
        of_unit = min(filter(None, fits), key=lambda x: x.share, default=_NO_FIT)
        prior = unit.prior * (CERTAIN if unit.words == unit_of_others else 1.0)
        fitted.append((of_unit, replace(unit, prior=prior)))
    is_explained = any(x.share <= EXPLAINS_NONE for x, _ in fitted)
    powers = N_PARTS if is_explained else 0
    return [(unit.prior * x.share**-powers, x, unit) for x, unit in fitted]


def _units(
    robot: Robot, q: Array, is_of_servo: bool, unit_of_others: str
) -> Iterator[_Unit]:
    """Yield the units in which positions (N, n) may be for the joints' ranges, each with
    its prior."""
    for unit in _usual_units(robot, q, is_of_servo, unit_of_others):
        in_si = unit.in_si(q)
        is_usual = is_in_ranges(robot, in_si)
        if not far_outside(robot, in_si):
            yield replace(unit, prior=unit.prior * (1.0 if is_usual else _BESIDE_RANGE))


def _usual_units(
    robot: Robot, q: Array, is_of_servo: bool, unit_of_others: str
) -> Iterator[_Unit]:
    """Yield the units that logs are written in; lengths are millimetres where one is out of
    reach."""
    far = far_outside(robot, q)
    revolute = np.isin(np.arange(robot.n), _revolute(robot))
    is_length = ~revolute & bool(set(far) - set(_revolute(robot)))
    lengths = np.where(is_length, UNITS["mm"], 1.0)

    def unit(words: str, prior: float, radians: float, middle: float = 0.0) -> _Unit:
        scale = np.where(revolute, radians, lengths)
        return _Unit(words, prior, scale, np.where(revolute, middle, 0.0))

    largest = np.abs(q[:, revolute]).max(initial=0.0)
    yield unit("rad", 1.0, 1.0)
    if largest < _LITTLE:
        yield unit("turns", _RARE, _TURN)
        if not unit_of_others:  # of a larger motion
            return
    yield unit("deg", _DEGREES, UNITS["deg"])
    yield unit("mrad", 1e-3, 1e-3)
    yield unit("mdeg", 1e-3, UNITS["mdeg"])
    yield unit("0.01 deg", 1e-3, 1e-2 * UNITS["deg"])
    yield unit("0.1 deg", 1e-3, 1e-1 * UNITS["deg"])
    if percent := radians_per_percent(robot, q):
        pairs = np.array([percent.get(j, (1.0, 0.0)) for j in range(robot.n)])
        words = "per cent of each joint's range"
        yield _Unit(words, _OF_SERVO if is_of_servo else 1e-3, *pairs.T)
    if np.all(q[:, revolute] == np.round(q[:, revolute])):
        for bits in ENCODER_BITS:
            words = f"counts of an encoder with {2**bits} a turn"
            for middle in ("", f", the middle at {2 ** (bits - 1)}"):
                of_zero = -np.pi if middle else 0.0
                counts = unit(words + middle, _RARE, _TURN / 2**bits, of_zero)
                yield replace(counts, is_of_any_size=True)


def with_channel_of_torque(
    recognition: Recognition, blocks: dict[str, Array], channels: Arrays, fit: Fit
) -> tuple[Recognition, dict[str, Array]]:
    """Choose the torque among several sets of channels (N, n), by their first and last
    names, the likeliest by its name first."""
    if len(channels) < 2:
        return recognition, blocks
    q = blocks["q"] * recognition.factors("q", blocks["q"].shape[1])

    whole = np.isfinite(np.hstack(list(channels.values()))).all(axis=1)
    first = {x: next(iter(recognition.torques[x].values())) for x in channels}
    hypotheses = which_torque(
        {x: tau[whole] for x, tau in channels.items()},
        [x for x in channels if not is_current(first[x])],
        {x: y for x, tau in channels.items() if (y := fit(q, tau)) is not None},
    )
    best = weigh(hypotheses)
    others = [
        f"{x.answer} ({x.why})" if x.why else x.answer
        for x in hypotheses
        if x is not best
    ]
    sentences = [f"tau: {best.why}"] if best.why else []
    sentences.append(
        f"not used, of the same joints: {formatting.words(others)}: name them in"
        " --rename to take them"
    )
    blocks = {**blocks, "tau": channels[best.answer]}
    recognition = with_torque(recognition, recognition.torques[best.answer])
    return replace(recognition, said=(*recognition.said, *sentences)), blocks


def with_signed_register(
    recognition: Recognition,
    blocks: dict[str, Array],
    fit: Fit,
    *,
    is_known: bool = False,
) -> tuple[Recognition, dict[str, Array]]:
    """Read torques as a servo's registers with a sign bit, if the arm then leaves far less
    of them, or if that is known of another log of the recorder.

    Slightly less is enough if they then vary less from row to row: as it is written, a
    register jumps at each change of sign.
    """
    register, bit = signed_register(blocks["tau"])
    q = blocks["q"] * recognition.factors("q", blocks["q"].shape[1])
    if not bit:
        return recognition, blocks
    as_written, as_register = fit(q, blocks["tau"]), fit(q, register)
    if as_written is None or as_register is None:
        return recognition, blocks
    varies_less = _variation(register) < _variation(blocks["tau"])
    odds = (as_written.share / as_register.share) ** N_PARTS
    if not is_known and odds < (1.0 if varies_less else CERTAIN):
        return recognition, blocks
    # Friction takes power: a negative one shows that torques count the other way.
    sign = 1.0 if as_register.friction > 0.0 else -1.0
    text = (
        f"tau is a register whose bit {bit} is its sign: the arm leaves"
        f" {formatting.percent(as_register.share, 2)} of it,"
        f" {formatting.percent(as_written.share, 2)} as it is written"
    )
    recognition = replace(
        recognition.with_sentences(text), is_of_arm=True, has_sign_bit=True
    )
    return recognition, {**blocks, "tau": sign * register}


def _variation(values: Array) -> float:
    """Return by how much columns (N, n) change from row to row, in all."""
    return float(np.abs(np.diff(values, axis=0)).sum())


def confirmed(recognition: Recognition, blocks: Arrays, fit: Fit) -> Recognition:
    """Return a reading that its order or its letters suggest, where the arm explains the
    torques by it and they are no velocities; raise its error where it does not."""
    if recognition.unless_confirmed is None:
        return recognition
    q, tau = blocks["q"] * recognition.factors("q", blocks["q"].shape[1]), blocks["tau"]
    if "q" in recognition.possible_scale:
        word = recognition.possible_scale["q"]
        factors, zeros = factors_and_zeros("q", word, q.shape[1])
        q = factors * (q - zeros)
    # Velocities mostly have the unit in which positions are written.
    has_velocities = "dq" not in blocks or any(
        rate_from_velocities(x, blocks["dq"]) for x in (blocks["q"], q)
    )
    of_torques = fit(q, tau) if has_velocities else None
    is_velocity = rate_from_velocities(q, tau) is not None
    if of_torques is None or of_torques.share > EXPLAINS_NONE or is_velocity:
        raise recognition.unless_confirmed
    sentence = (
        f"the arm leaves {formatting.percent(of_torques.share, 2)} of the torques so"
    )
    return replace(
        recognition,
        said=(*recognition.said, sentence),
        unless_confirmed=None,
        share=of_torques.share,
        is_confirmed=True,
    )


# -- the steps --------------------------------------------------------------------------


def _fit_at_stamps(draft: Draft) -> Fit:
    """Return a function that fits the arm at the stamps as they are decided so far."""
    return fit_of(draft.robot, lambda _: draft.seconds)


def _with_kinds_of_joints(draft: Draft) -> Draft:
    """Take lengths and angles of a unit that names say for all joints, by their kind."""
    if draft.robot is None:
        return draft
    recognition = with_lengths(draft.recognition, draft.robot)
    return replace(draft, recognition=recognition)


def _with_unit_of_positions(draft: Draft) -> Draft:
    """Decide or propose the unit of positions; the speed of joints in it tells the clock's."""
    robot, recognition = draft.robot, draft.recognition
    if robot is None or "q" in map(group_of, draft.choice.scale or {}):
        return draft

    def clock_of_positions(q: Array) -> Array:
        return replace(draft, blocks={"q": q}).with_unit_of_clock().seconds

    links = getattr(draft.choice.joints, "links", None)
    of_links, apart = (
        fit_of(robot, clock_of_positions, links, each_in_its_unit=x)
        for x in (bool(recognition.torque_unit), True)
    )
    decided, blocks = with_unit_of_positions(
        recognition, draft.blocks, robot, of_links, apart, draft.choice.recorder
    )
    if decided is recognition:
        return draft
    draft = replace(draft, recognition=decided, blocks=blocks).with_unit_of_clock()
    return _with_possible_clock(draft) if draft.recognition.possible_scale else draft


def _with_possible_clock(draft: Draft) -> Draft:
    """Add the unit of the clock by which joints move at a usual speed in a unit of positions
    that is only possible."""
    recognition, q = draft.recognition, draft.blocks["q"]
    possible = recognition.possible_scale
    factors, zeros = factors_and_zeros("q", possible["q"], q.shape[1])
    in_si = replace(
        draft,
        recognition=recognition.without_unit("q"),
        blocks={"q": factors * (q - zeros)},
    )
    clock = in_si.with_unit_of_clock().recognition.units.get("t")
    if clock is None or clock == recognition.units.get("t"):
        return draft
    possible = {**possible, "t": clock.answer}
    return replace(draft, recognition=replace(recognition, possible_scale=possible))


def _at_joints(draft: Draft) -> Draft:
    """Bring channels of the motors to the joints."""
    robot, recognition = draft.robot, draft.recognition
    if robot is None or recognition.unit_by_arm or draft.choice.is_of_motors:
        return draft
    recognition, blocks = with_joint_side(
        recognition, draft.blocks, robot, _fit_at_stamps(draft)
    )
    return replace(draft, recognition=recognition, blocks=blocks)


def _with_likeliest_torques(draft: Draft) -> Draft:
    """Choose the torque among the sets of columns that compete."""
    recognition, blocks = with_channel_of_torque(
        draft.recognition, draft.blocks, draft.rival_torques, _fit_at_stamps(draft)
    )
    return replace(draft, recognition=recognition, blocks=blocks)


def _with_signs_of_registers(draft: Draft) -> Draft:
    """Read torques as registers with a sign bit."""
    if draft.robot is None:
        return draft
    recognition, blocks = with_signed_register(
        draft.recognition,
        draft.blocks,
        _fit_at_stamps(draft),
        is_known=draft.choice.recorder.has_sign_bit,
    )
    return replace(draft, recognition=recognition, blocks=blocks)


def _confirmed(draft: Draft) -> Draft:
    """Confirm columns that only their order or letters suggest, by rows whose stamps are in
    order; raise the error of a reading that the arm does not confirm."""
    steady = ~stray_rows(draft.t)
    fit = fit_of(draft.robot, lambda _: draft.seconds[steady])
    of_steady = {group: x[steady] for group, x in draft.blocks.items()}
    recognition = confirmed(draft.recognition, of_steady, fit)
    return replace(draft, recognition=recognition)


#: What the arm decides, in this order: a later step fits torques by positions whose unit
#: and side an earlier one has decided.
STEPS_BY_ARM: tuple[Callable[[Draft], Draft], ...] = (
    _with_kinds_of_joints,
    _with_unit_of_positions,
    _at_joints,
    _with_likeliest_torques,
    _with_signs_of_registers,
    _confirmed,
)
