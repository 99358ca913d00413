"""Which one typing mistake explains an <inertial> that no body can have.

A hypothesis changes as little text as a person mistypes: a decimal point or an exponent
(powers of ten), a sign, two numbers exchanged, or one convention of the whole tensor
(order of its entries, sign of its products, unit, reference point). Each that makes the
link consistent, and no larger than its shapes, is scored by

    -ln(10) n + ln p(second moments),

with n the characters to insert and delete, and p a broad prior of what links are
like. The nearest consistent tensor competes as an error of unknown cause. Hypotheses
within a factor of ten of the best are not told apart.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import NamedTuple

import numpy as np

from sdp_vs_penalty.records import NOT_STORED, WritesJson, stored_as
from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.arrays import Array, at_least_tiny

#: The numbers of an <inertial> in URDF's order: mass, xyz of its origin, its tensor.
CENTRE = ("x", "y", "z")
MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
PRODUCTS = ("ixy", "ixz", "iyz")
#: Other orders in which programs write a symmetric tensor.
_ORDERS = (
    ("ixx", "iyy", "izz", "ixy", "ixz", "iyz"),
    ("ixx", "iyy", "izz", "ixy", "iyz", "ixz"),
    ("ixx", "ixy", "iyy", "ixz", "iyz", "izz"),
)
#: Units of a tensor by how many are a kg m^2, and of a centre by how many are a metre.
_INERTIA_UNITS = {3: "g m^2", 4: "kg cm^2", 6: "kg mm^2", 7: "g cm^2", 9: "g mm^2"}
_CENTRE_UNITS = {2: "cm", 3: "mm"}
#: Characters that an exchange counts for, or a convention of the whole tensor.
_CONVENTION = 1
#: Powers of ten that a wrong point or exponent makes: an exponent's lost sign makes the
#: largest.
_POWERS = [k for k in range(-12, 13) if k]
#: One more wrong character is ten times less likely [nats]; hypotheses that are closer
#: than this are not told apart.
_CHARACTER = float(np.log(10.0))
#: Characters that the nearest tensor counts for: those of a number that is typed anew,
#: and two more (or fewer) for a tensor ten times farther away (or nearer).
_ANEW = 6.0
_PER_DECADE = 2.0
#: Links of arms fill their ellipsoid of inertia with 1000 kg/m^3, to a factor of 5, and
#: are longer than thick by a factor of e, as standard deviations of logarithms.
_DENSITY = 1000.0
_DENSITY_SPREAD = float(np.log(5.0))
_ASPECT_SPREAD = 2.0
#: Second moment of a link in one direction over that of its box filled evenly.
_FILLING_SPREAD = 1.0
#: Characters of a number that a person types.
_LONGEST = 40
#: Thinnest link [m].
_THIN = 5e-4
#: Shapes may be drawn too small by this share of their largest extent.
_DRAWN = 0.05
#: A centre of mass is at the end of its shapes within this share of their length.
_END = 0.2
#: Coordinates of a centre of mass below this are zeros [m].
_ZERO = 1e-9
#: Links fill the box around their shapes with 500 kg/m^3, to a factor of 4.
_BOX_DENSITY = 500.0
_BOX_DENSITY_SPREAD = float(np.log(4.0))
#: Characters that invented numbers count for, and so do shapes that leave parts out: few
#: of the links that can exist but do not fit were mistyped.
_INVENTED = 2.0


@dataclass(frozen=True)
class WrittenInertial:
    """An <inertial> as its file writes it."""

    #: Text of each number by its name: mass, x, y, z, ixx, ..., izz.
    texts: Mapping[str, str]
    #: (3, 3) axes of the tensor in the link frame.
    rotation: Array
    #: How far the link's body reaches [m].
    reach: float = np.inf
    #: (k, 3) points around the link's shapes in its frame [m]; None where not known.
    shape: Array | None = None

    def number(self, name: str) -> float:
        """Return a number of the file."""
        return float(self.texts[name])

    def barycentric(self, texts: Mapping[str, str] | None = None) -> Array:
        """Return m, the centre and the six entries about it (10,) in the tensor's axes,
        with other texts for some numbers."""
        all_texts = {**self.texts, **(texts or {})}
        order = [f"i{p[1:]}" for p in inertia.PARAMETERS[4:]]
        centre = self.rotation.T @ [float(all_texts[k]) for k in CENTRE]
        moments = [float(all_texts[k]) for k in order]
        return np.array([float(all_texts["mass"]), *centre, *moments])

    @property
    def resolution(self) -> float:
        """Norm of what the written digits of the tensor leave open: half a unit of each
        number's last digit, at most a twentieth of it [kg m^2]."""
        units = []
        for name in MOMENTS:
            if self.number(name) == 0.0:  # perhaps 0e999
                continue
            mantissa, _, exponent = _split_exponent(self.texts[name])
            decimals = len(mantissa.partition(".")[2])
            half = 0.5 * 10.0 ** (int(exponent or 0) - decimals)
            units.append(min(half, abs(self.number(name)) / 20.0))
        return float(np.linalg.norm(units))

    def misfit(self, barycentric: Array) -> str:
        """Say why a link that can exist does not fit its shapes or its place in the
        robot; "" where it does.

        In shapes a mass is no denser than osmium, and with its centre c in [a, b] along
        an axis its second moment is at most (b - c)(c - a). Without shapes its radius
        of gyration is at most what the joints around it leave, and at least a ball's of
        osmium.
        """
        mass = float(barycentric[0])
        second = _second_moment(barycentric)
        if not mass > 0.0:
            return ""
        if self.shape is not None:
            along = self.shape @ self.rotation
            extent = np.ptp(along, axis=0)
            volume = float(np.prod(np.maximum(extent, _THIN)))
            if mass > inertia.DENSEST * volume:
                return (
                    f"heavier than its shapes: {mass:.4g} kg in at most {volume:.2g} m^3, where"
                    f" the densest metal weighs {inertia.DENSEST * volume:.2g} kg"
                )
            slack = _DRAWN * float(extent.max())
            above = along.max(axis=0) + slack - barycentric[1:4]
            below = barycentric[1:4] - along.min(axis=0) + slack
            if min(above.min(), below.min()) <= 0.0:
                return "outside of its shapes: its centre of mass lies outside of them"
            nearest = np.minimum(above, below) / (above + below)
            if (
                np.abs(barycentric[1:4]).max() < _ZERO
                and nearest[int(np.argmax(extent))] < _END
            ):
                return (
                    "its centre of mass is exactly at the frame's origin, at the end of its"
                    " shapes: as where the <origin> of its <inertial> (<pose> in SDF) is"
                    " left out"
                )
            radii = np.sqrt(np.maximum(np.diagonal(second), 0.0))
            worst = int(np.argmax(radii / np.sqrt(at_least_tiny(above * below))))
            radius = float(np.sqrt(max(second[worst, worst], 0.0)))
            if radius > np.sqrt(above[worst] * below[worst]):
                drawn = max((above[worst] - slack) * (below[worst] - slack), 0.0)
                return (
                    f"larger than its shapes: its mass is {radius:.3g} m (root mean square)"
                    f" from its centre along one axis, and its shapes allow {np.sqrt(drawn):.3g} m"
                )
        gyration = float(np.sqrt(max(np.trace(second), 0.0)))
        # Of all bodies of one density the ball has the least radius of gyration.
        ball = np.cbrt(0.75 * mass / np.pi / inertia.DENSEST)
        if gyration < np.sqrt(0.6) * ball:
            return (
                f"denser than any metal: its radius of gyration is {gyration:.2g} m, and"
                f" that of {mass:.4g} kg at least {np.sqrt(0.6) * ball:.2g} m"
            )
        if gyration > self.reach:
            return (
                f"implausible: radius of gyration {gyration:.3g} m for {mass:.3g} kg, and"
                f" its body reaches {self.reach:.3g} m. The torques of a link that hardly"
                " moves do not determine its mass and inertia separately; the default"
                " method of `identify` keeps every link in its body"
            )
        return ""

    def fits(self, barycentric: Array) -> bool:
        """Return whether a body can have a link's numbers, in its shapes and place."""
        # With the centre at the origin: rounding errors of a distant one would hide that
        # the tensor is wrong.
        centred = np.concatenate([barycentric[:1], np.zeros(3), barycentric[4:]])
        return not inertia.why_impossible(centred) and not self.misfit(barycentric)

    def plausibility(self, barycentric: Array) -> float:
        """Return the log prior [nats] of a consistent link (10,), 0 for the likeliest.

        It is Gaussian in logarithms: of the density and the length over the thickness of
        the link's ellipsoid; and, where its shapes are known, of the second moments and
        the density over those of the box around them, filled evenly.
        """
        moments = _second_moment(barycentric)
        sizes = np.maximum(np.linalg.eigvalsh(moments), _THIN**2)
        volume = 4.0 / 3.0 * np.pi * float(np.prod(np.sqrt(5.0 * sizes)))
        density = np.log(barycentric[0] / volume / _DENSITY) / _DENSITY_SPREAD
        aspect = np.log(sizes[-1] / sizes[0]) / 2.0 / _ASPECT_SPREAD
        terms = [density, aspect]
        if self.shape is not None:
            extent = np.ptp(self.shape @ self.rotation, axis=0)
            of_box = np.maximum(extent**2 / 12.0, _THIN**2)  # second moments over mass
            ratios = np.maximum(np.diagonal(moments), _THIN**2) / of_box
            terms += list(np.log(ratios) / _FILLING_SPREAD)
            volume = float(np.prod(np.sqrt(12.0 * of_box)))
            filling = np.log(barycentric[0] / volume / _BOX_DENSITY)
            terms.append(filling / _BOX_DENSITY_SPREAD)
        return -0.5 * float(np.square(terms).sum())


@dataclass(frozen=True)
class Repair(WritesJson):
    """One typing mistake that explains an inertial."""

    #: What is wrong and what it should be, as a sentence.
    sentence: str
    #: New text of each number that changes, by its name.
    texts: Mapping[str, str] = field(metadata=stored_as("numbers"))
    #: Characters that differ.
    n_characters: int
    #: (10,) m, centre and entries about it, in the tensor's axes.
    barycentric: Array = field(metadata=NOT_STORED)
    #: Logarithm of its odds, up to a constant [nats].
    score: float


def find_repairs(
    written: WrittenInertial, move: float | None = None
) -> tuple[list[Repair], bool]:
    """Return the typing mistakes that explain an inertial and are not told apart.

    Parameters
    ----------
    written : WrittenInertial
        An inertial that is impossible, or does not fit its shapes.
    move : float, optional
        Distance of the nearest consistent tensor, over the norm of the written one: how
        well an error of unknown cause explains it. None where the written one can exist:
        then invented numbers do.

    Returns
    -------
    repairs : list of Repair
        The likeliest first, each within a factor of ten of it and of the unknown cause.
    is_clear : bool
        Whether there is one, ten times likelier than the unknown cause.
    """
    candidates: list[Repair] = []
    if max(map(len, written.texts.values())) > _LONGEST:
        return [], False
    for sentence, texts, n_characters in _hypotheses(written):
        barycentric = written.barycentric(texts)
        if not written.fits(barycentric):
            continue
        score = written.plausibility(barycentric) - _CHARACTER * n_characters
        repair = Repair(sentence, texts, n_characters, barycentric, score)
        same = [
            k
            for k, other in enumerate(candidates)
            if np.allclose(other.barycentric, barycentric, rtol=1e-9, atol=0.0)
        ]
        if not same:
            candidates.append(repair)
        elif score > candidates[same[0]].score:
            candidates[same[0]] = repair
    # The score of the unknown cause: it leaves a link of the likeliest kind, 0.
    n_characters_of_unknown = _INVENTED
    if move is not None:
        in_decades = np.log10(max(move, 1e-300))
        n_characters_of_unknown = max(_ANEW + _PER_DECADE * in_decades, 0.0)
    unknown = -_CHARACTER * n_characters_of_unknown
    best = max((repair.score for repair in candidates), default=unknown)
    # A link that can exist needs no repair: one must be likelier than the unknown cause.
    least_beside_unknown = unknown if move is None else unknown - _CHARACTER
    least_score = max(best - _CHARACTER, least_beside_unknown)
    repairs = sorted(
        (x for x in candidates if x.score > least_score), key=lambda x: -x.score
    )
    return repairs, len(repairs) == 1 and best > unknown + _CHARACTER


def find_exchanges(written: WrittenInertial) -> list[Repair]:
    """Return the exchanges of two moments of inertia that explain a link that can exist but
    does not look like its shapes, the likeliest first.

    An exchange must make the link ten times likelier for each of _INVENTED characters.
    """
    if written.shape is None:
        return []
    as_written = written.plausibility(written.barycentric())
    exchanges = list[Repair]()
    for a, b in combinations(("ixx", "iyy", "izz"), 2):
        texts = {a: written.texts[b], b: written.texts[a]}
        barycentric = written.barycentric(texts)
        score = written.plausibility(barycentric) - _CHARACTER * _CONVENTION
        if written.fits(barycentric) and score > as_written + _CHARACTER * _INVENTED:
            sentence = f"{a} and {b} are exchanged{_corrected(texts)}"
            exchanges.append(Repair(sentence, texts, _CONVENTION, barycentric, score))
    exchanges.sort(key=lambda repair: -repair.score)
    return [x for x in exchanges if x.score > exchanges[0].score - _CHARACTER]


def find_shared(links: Sequence[WrittenInertial]) -> tuple[str, list[Repair]] | None:
    """Find a mistake that was made in all links of a file.

    One convention may explain all links together, so it is tried before each link alone.

    Returns
    -------
    tuple or None
        The mistake in words, and the repair of each link; no repairs where only the true
        numbers help. None if the links share no mistake.
    """
    written = [text for link in links for text in link.texts.values()]
    if len(links) < 2 or max(map(len, written)) > _LONGEST:
        return None
    all_fit = all(x.fits(x.barycentric()) for x in links)
    if sentence := _placeholders(links, all_fit):
        return sentence, []
    # Links that all fit need a stronger reason to be repaired.
    best_gain = _CHARACTER * (_ANEW if all_fit else _INVENTED)
    conventions = dict.fromkeys(sentence for sentence, _ in _of_all_links(links[0]))
    before = [_score(x, x.barycentric()) for x in links]
    best: tuple[str, list[Repair]] | None = None
    for sentence in conventions:
        repairs = _repaired_by(sentence, links, before)
        gain = sum(x.score for x in repairs) - _CHARACTER * _CONVENTION
        # If only one link has the mistake, the others may stay possible, but do not
        # become likelier.
        helps_most = 2 * sum(x.score > 0.0 for x in repairs) > len(links)
        if helps_most and gain > best_gain:
            best, best_gain = (sentence, repairs), gain
    return best


def _placeholders(links: Sequence[WrittenInertial], all_fit: bool) -> str:
    """Return a sentence that all links have the same placeholder numbers; "" if they
    differ, or the links may be equal modules.

    all_fit : whether the numbers of each link are possible, and fit its shape.
    """
    masses = {x.number("mass") for x in links}
    tensors = {tuple(map(x.number, MOMENTS)) for x in links}
    if len(tensors) > 1 or not any(*tensors):
        return ""
    first = links[0].texts
    moments = [first[k] for k in MOMENTS]
    # Three links alike may be modules, but for their round numbers.
    are_round = all(_digits(x) < 2 for x in (*moments, first["mass"]))
    numbers = f"({' '.join(moments)})"
    remark = "placeholders, not the links' own numbers"
    if len(masses) == 1 and len(links) > 2 and are_round:
        return f"all have the same mass and inertia {numbers}: {remark}"
    if len(masses) > 1 and not all_fit:
        return f"all have the same inertia {numbers}, whatever they weigh: {remark}"
    return ""


def _repaired_by(
    sentence: str, links: Sequence[WrittenInertial], before: Sequence[float]
) -> list[Repair]:
    """Return the repair of each link by one mistake, which a ``sentence`` of
    :func:`_of_all_links` names; empty if some link does not fit its shapes afterwards.

    A repair's score is the rise [nats] of the link's :func:`_score` from ``before``.
    """
    repairs = list[Repair]()
    for link, score_before in zip(links, before, strict=True):
        texts = dict(_of_all_links(link))[sentence]
        barycentric = link.barycentric(texts)
        if not link.fits(barycentric):
            return []
        gain = link.plausibility(barycentric) - score_before
        repairs.append(Repair(sentence, texts, _CONVENTION, barycentric, gain))
    return repairs


def _score(link: WrittenInertial, barycentric: Array) -> float:
    """Return the log prior [nats] of a link with mass, centre and inertia about it (10,).

    If no body can have them, it is the log prior of a number that is typed anew.
    """
    if not link.fits(barycentric):
        return -_CHARACTER * _ANEW
    return link.plausibility(barycentric)


def _of_all_links(written: WrittenInertial) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield the mistakes that a program makes in all links of a file: each in words, with
    the corrected texts of one link's numbers, by name."""
    yield from _of_whole_tensor(written.texts)
    about_origin = _about_origin(written)
    without_numbers = about_origin.sentence.partition(": ")[0]
    yield without_numbers, about_origin.texts
    texts = written.texts
    grams = {"mass": _times_power_of_ten(texts["mass"], -3).text}
    yield "the mass is in g", grams
    moments = {name: _times_power_of_ten(texts[name], -3).text for name in MOMENTS}
    yield "the mass is in g, and the inertia in g m^2", {**grams, **moments}


def _second_moment(barycentric: Array) -> Array:
    """Return the second moment (3, 3) about the centre over the mass [m^2]."""
    tensor = inertia.inertia_matrix(barycentric[4:])
    return (0.5 * np.trace(tensor) * np.eye(3) - tensor) / max(barycentric[0], 1e-300)


class _Mistake(NamedTuple):
    """A mistake that the writer of an inertial may have made."""

    #: What is wrong, in words.
    sentence: str
    #: Corrected texts of the numbers, by name.
    texts: dict[str, str]
    #: How rare the mistake is, in wrong characters.
    n_characters: int


def _hypotheses(written: WrittenInertial) -> Iterator[_Mistake]:
    """Yield the typing mistakes that may explain one inertial: of a single number, of a
    convention, of the signs of several moments, of the reference point."""
    for name in ("mass", *CENTRE, *MOMENTS):
        yield from _of_one_number(written, name)
    for sentence, changed in _of_conventions(written.texts):
        yield _Mistake(f"{sentence}{_corrected(changed)}", changed, _CONVENTION)
    diagonal = {name: written.texts[name] for name in ("ixx", "iyy", "izz")}
    changed = {k: _negated(text) for k, text in diagonal.items() if float(text) < 0.0}
    if len(changed) > 1:
        sentence = f"moments have the wrong sign{_corrected(changed)}"
        yield _Mistake(sentence, changed, len(changed))
    yield _about_origin(written)


def _of_conventions(texts: Mapping[str, str]) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield two numbers exchanged, and other conventions of the whole tensor: each in words,
    with the corrected texts by name."""
    for a, b in (*combinations(CENTRE, 2), *combinations(MOMENTS, 2)):
        if float(texts[a]) != float(texts[b]):
            yield f"{a} and {b} are exchanged", {a: texts[b], b: texts[a]}
    yield from _of_whole_tensor(texts)


def _of_whole_tensor(texts: Mapping[str, str]) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield other orders, signs and units of all six moments, and units of the centre: each
    in words, with the corrected texts by name."""
    moments = [texts[name] for name in MOMENTS]
    for order in _ORDERS:
        changed = dict(zip(order, moments, strict=True))
        yield f"the six numbers are in the order {' '.join(order)}", changed
    signs = {name: _negated(texts[name]) for name in PRODUCTS}
    yield (
        "the products of inertia have the other sign, as CAD programs write them",
        signs,
    )
    for k, unit in _INERTIA_UNITS.items():
        changed = {name: _times_power_of_ten(texts[name], -k).text for name in MOMENTS}
        yield f"the inertia is in {unit}", changed
    for k, unit in _CENTRE_UNITS.items():
        changed = {name: _times_power_of_ten(texts[name], -k).text for name in CENTRE}
        yield f"the centre of mass is in {unit}", changed


def _of_one_number(written: WrittenInertial, name: str) -> Iterator[_Mistake]:
    """Yield the mistakes of one number: its sign, and each power of ten with which the link
    fits its shapes."""
    text = written.texts[name]
    value = float(text)
    if value == 0.0:
        return
    negated = _negated(text)
    sentence = f'the sign of {name}="{text}" is wrong: {name}="{negated}"'
    yield _Mistake(sentence, {name: negated}, 1)
    for k in _POWERS:
        if not written.fits(written.barycentric({name: repr(value * 10.0**k)})):
            continue
        new, n_characters = _times_power_of_ten(text, k)
        sentence = (
            f'the decimal point or exponent of {name}="{text}" is wrong: {name}="{new}"'
        )
        yield _Mistake(sentence, {name: new}, n_characters)


def _about_origin(written: WrittenInertial) -> _Mistake:
    """Return the mistake of a tensor about the link's origin: I_c = I - m (c.c 1 - c
    c^T)."""
    values = written.barycentric()
    centre = values[1:4]
    steiner = centre @ centre * np.eye(3) - np.outer(centre, centre)
    about_centre = inertia.inertia_matrix(values[4:]) - values[0] * steiner
    changed = {
        name: f"{about_centre['xyz'.index(name[1]), 'xyz'.index(name[2])] + 0.0:.12g}"
        for name in MOMENTS
    }
    sentence = "the inertia is about the link's origin, not about the centre of mass"
    return _Mistake(f"{sentence}{_corrected(changed)}", changed, _CONVENTION)


def _corrected(texts: Mapping[str, str]) -> str:
    """Return how the changed numbers should read."""
    return ": " + " ".join(f'{name}="{text}"' for name, text in texts.items())


def _negated(text: str) -> str:
    """Return a number's text with the other sign."""
    plain = text.strip().removeprefix("+")
    if float(plain) == 0.0:
        return plain
    return plain[1:] if plain.startswith("-") else f"-{plain}"


class _Retyped(NamedTuple):
    """Another text of a number."""

    #: The text.
    text: str
    #: Characters to insert and delete between it and the first text.
    n_characters: int


def _times_power_of_ten(text: str, k: int) -> _Retyped:
    """Return 10^k times a number as the text that differs in the fewest characters: the
    point moves within the digits, or the exponent changes."""
    plain = text.strip()
    sign = plain[:1] if plain[:1] in ("+", "-") else ""
    mantissa, letter, exponent = _split_exponent(plain[len(sign) :])
    integer_digits, _, decimals = mantissa.partition(".")
    digits = integer_digits + decimals
    place = len(integer_digits) + k  # of the point, behind so many digits
    # Zeros where the point leaves the digits.
    padded = "0" * max(1 - place, 0) + digits + "0" * max(place - len(digits), 0)
    place = max(place, 1)
    ending = f"{letter}{exponent}" if letter else ""
    fraction = f".{padded[place:]}" if padded[place:] else ""
    candidates = [f"{sign}{padded[:place].lstrip('0') or '0'}{fraction}{ending}"]
    # The other candidate has the same digits and another exponent, of the same width.
    power = int(exponent or 0) + k
    width = len(exponent.lstrip("+-")) if letter else 1
    candidates.append(
        f"{sign}{mantissa}{letter or 'e'}{'-' if power < 0 else ''}{abs(power):0{width}d}"
    )
    retyped = [_Retyped(x, _distance(plain, x)) for x in candidates]
    return min(retyped, key=lambda x: x.n_characters)


def _digits(text: str) -> int:
    """Count the digits of a number's text that are no zeros at its ends."""
    return len(_split_exponent(text)[0].strip("+-").replace(".", "").strip("0"))


def _split_exponent(text: str) -> tuple[str, str, str]:
    """Return mantissa, the letter of the exponent and the exponent, "" without."""
    for letter in ("e", "E"):
        if letter in text:
            return text.partition(letter)
    return text, "", ""


def _distance(a: str, b: str) -> int:
    """Return the number of characters to insert and delete between two texts, by dynamic
    programming (Levenshtein's distance; a replaced character counts twice)."""
    row = list(range(len(b) + 1))
    for i, x in enumerate(a, start=1):
        diagonal, row[0] = row[0], i
        for j, y in enumerate(b, start=1):
            best = diagonal if x == y else min(row[j], row[j - 1]) + 1
            diagonal, row[j] = row[j], best
    return row[-1]
