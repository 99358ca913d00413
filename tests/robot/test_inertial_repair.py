"""One typing mistake in an inertial, of ten links of seven robots: the original text comes
back, or is among those that are named."""

import re

import numpy as np
import pytest

from sdp_vs_penalty.robot import inertia
from sdp_vs_penalty.robot.inertial_repair import (
    MOMENTS,
    WrittenInertial,
    find_exchanges,
    find_repairs,
)

NAMES = ("mass", "x", "y", "z", *MOMENTS)
#: Mass, centre, and the tensor in URDF's order, as their files write them.
LINKS = {
    "rx75": "1.559 .488E-3 -13.727E-3 -10.765E-3"
    " 2661.9E-6 -31.029E-6 9.34E-6 2302.5E-6 151.466E-6 1676.359E-6",
    "iiwa": "4.0 0.0003 0.059 0.042 0.05 0.001 -0.002 0.018 0.0004 0.044",
    "a1 hip": "0.696 -0.003311 -0.000635 0.000031"
    " 0.000469246 -0.000009409 -0.000000342 0.00080749 -0.000000466 0.000552929",
    "xarm": "2.177 0.0 0.02 -0.08"
    " 1.8310e-02 5.6460e-05 -8.3410e-05 1.7990e-02 3.3400e-03 3.9000e-03",
    "gantry": "1.5 0.1 0 0.02 0.004 0.0005 0 0.02 -0.0002 0.021",
    "finger": "0.03 0.001 0.002 0.015"
    " 1.234e-05 2.1e-07 -3.3e-07 1.187e-05 1.5e-07 3.456e-06",
    "tube": "3.2 0.2 0.001 -0.002"
    " 0.006123 0.000411 -0.000212 0.061245 0.000087 0.062517",
    "plate": "6.5 0 0 0.011 0.0712 -0.0011 0.0007 0.0534 0.0004 0.1198",
    "housing": "12.75 0.012 -0.034 0.101 0.21345 0.0123 -0.0045 0.19876 0.0099 0.12345",
    "motor": "0.482 0 0 0.0215"
    " 2.871e-04 -1.12e-06 3.04e-06 2.644e-04 2.2e-06 1.983e-04",
}
LARGEST = ("ixx", "iyy", "izz")


def texts_of(name):
    return dict(zip(NAMES, LINKS[name].split(), strict=True))


def largest(texts):
    return max(LARGEST, key=lambda k: float(texts[k]))


def product(texts):
    return max(("ixy", "ixz", "iyz"), key=lambda k: abs(float(texts[k])))


def replaced(key, pattern, new):
    """The change of one number's text, {} where the pattern is not in it."""

    def change(texts):
        name = key(texts)
        text = re.sub(pattern, new, texts[name], count=1)
        return {} if text == texts[name] else {name: text}

    return change


def exchanged(texts):
    return {"izz": texts["iyz"], "iyz": texts["izz"]}


def other_order(texts):
    order = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    return dict(zip(MOMENTS, (texts[k] for k in order), strict=True))


#: What a person types instead, by kind.
MISTAKES = {
    "lost point": replaced(largest, r"\.", ""),
    "a zero too few": replaced(largest, r"^0\.0", "0."),
    "a zero too many": replaced(largest, r"^0\.", "0.0"),
    "exponent without its sign": replaced(largest, r"e-", "e"),
    "sign of a moment": replaced(largest, "^", "-"),
    "sign of another": replaced(lambda _: "izz", "^", "-"),
    "a moment and a product": exchanged,
    "order of the tensor": other_order,
    "point of a product": replaced(product, r"\.", ""),
    "sign of the mass": replaced(lambda _: "mass", "^", "-"),
}
#: Kinds that more than one explanation fits: the right one is among those that are named.
NAMED = ("order of the tensor", "point of a product")
#: Other mistakes that two explanations fit.
NAMED_OF = (("xarm", "sign of another"), ("tube", "a zero too many"))


def is_possible(texts):
    written = WrittenInertial(texts, np.eye(3)).barycentric()
    return not inertia.why_impossible(inertia.standard_from_barycentric(written))


ROWS = [
    (link, kind, typed)
    for link in LINKS
    for kind, mistake in MISTAKES.items()
    if (typed := mistake(texts_of(link))) and not is_possible(texts_of(link) | typed)
]


def test_there_are_sixty_mistakes_of_possible_links():
    assert len(ROWS) >= 60
    assert all(is_possible(texts_of(link)) for link in LINKS)


@pytest.mark.parametrize(
    ("link", "kind", "typed"), ROWS, ids=[f"{link}, {kind}" for link, kind, _ in ROWS]
)
def test_the_mistake_is_found(link, kind, typed):
    right = WrittenInertial(texts_of(link), np.eye(3)).barycentric()
    repairs, is_clear = find_repairs(
        WrittenInertial(texts_of(link) | typed, np.eye(3)), move=1.0
    )
    is_right = [np.allclose(x.barycentric, right, rtol=1e-9) for x in repairs]
    assert any(is_right), [x.sentence for x in repairs]
    is_named = kind in NAMED or (link, kind) in NAMED_OF
    assert is_clear or is_named, [x.sentence for x in repairs]


def test_a_number_that_nobody_types_has_no_typing_mistake():
    """Comparing texts takes the square of their length."""
    texts = texts_of("rx75") | {"izz": "-0." + 100_000 * "1"}
    assert find_repairs(WrittenInertial(texts, np.eye(3)), move=1.0) == ([], False)


def box(*size):
    corners = [[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    return 0.5 * np.array(corners) * size


#: A box of .4 x .08 x .06 m and 2 kg about its own centre, at x = .2 m.
NUMBERS = "2 0.2 0 0 0.0016667 0 0 0.027267 0 0.0277333"
BOX = dict(zip(NAMES, NUMBERS.split(), strict=True))
BOX_SHAPE = box(0.4, 0.08, 0.06) + np.array([0.2, 0.0, 0.0])
IN_BOX = {
    "axes exchanged": (
        {"ixx": "0.027267", "iyy": "0.0016667"},
        "larger",
        "ixx and iyy",
    ),
    "about the link": (
        {"iyy": "0.107267", "izz": "0.1077333"},
        "larger",
        "about the link's origin",
    ),
    "lost point of the centre": ({"x": "02"}, "outside", 'x="0.2"'),
    "mass in grams": ({"mass": "2000"}, "heavier", 'mass="2'),
    "inertia in kg mm^2": (
        {"ixx": "1666.7", "iyy": "27267", "izz": "27733.3"},
        "larger",
        "kg mm^2",
    ),
}


@pytest.mark.parametrize("name", IN_BOX)
def test_what_does_not_fit_its_shapes_is_named_and_not_clear(name):
    """A body can have these numbers: they may be meant, and are never replaced."""
    typed, why, words = IN_BOX[name]
    right = WrittenInertial(BOX, np.eye(3), shape=BOX_SHAPE)
    assert right.misfit(right.barycentric()) == ""
    wrong = WrittenInertial(BOX | typed, np.eye(3), shape=BOX_SHAPE)
    assert wrong.misfit(wrong.barycentric()).startswith(why)
    repairs, _ = find_repairs(wrong)
    assert words in " ".join(x.sentence for x in repairs)


@pytest.mark.parametrize("pair", [("ixx", "iyy"), ("ixx", "izz"), ("iyy", "izz")])
@pytest.mark.parametrize("filling", [0.2, 0.5])
def test_moments_about_exchanged_axes_are_found_in_shapes_that_hold_them(pair, filling):
    """A link that is thicker at its middle than the box around it is within the bounds
    of its shapes about any axis; the box tells which is its long one."""
    texts = BOX | {k: repr(filling * float(BOX[k])) for k in LARGEST}
    right = WrittenInertial(texts, np.eye(3), shape=BOX_SHAPE)
    assert find_exchanges(right) == []
    a, b = pair
    typed = texts | {a: texts[b], b: texts[a]}
    wrong = WrittenInertial(typed, np.eye(3), shape=BOX_SHAPE)
    if pair == ("iyy", "izz"):  # the box is about as high as wide
        assert find_exchanges(wrong) == []
    else:
        assert {a: texts[a], b: texts[b]} in [x.texts for x in find_exchanges(wrong)]
    assert find_exchanges(WrittenInertial(typed, np.eye(3))) == []


def test_the_bound_of_a_shape_is_exact():
    """Two equal masses at the ends of a rod reach it, and a shape is drawn 5 % too small
    at most."""
    rod = box(0.6, 0.02, 0.02)
    for half, fits in ((0.32, True), (0.34, False)):
        texts = dict.fromkeys(NAMES, "0") | {"mass": "1"}
        texts |= {k: repr(half**2) for k in ("iyy", "izz")}
        written = WrittenInertial(texts, np.eye(3), shape=rod)
        assert (written.misfit(written.barycentric()) == "") is fits


def test_the_worst_axis_decides():
    """Along x the mass is spread more, along z farther than the shapes allow."""
    texts = BOX | {"mass": "1", "ixx": "0.0042", "iyy": "0.039", "izz": "0.0352"}
    written = WrittenInertial(texts, np.eye(3), shape=BOX_SHAPE)
    radius = np.sqrt(0.5 * (0.0042 + 0.039 - 0.0352))
    assert f"its mass is {radius:.3g} m" in written.misfit(written.barycentric())


def test_a_mistake_that_hardly_beats_an_unknown_error_is_not_clear():
    """ixx = 1.486 exceeds .2 + .83; iyy = 2 would fit, and makes a light, wide body."""
    texts = dict.fromkeys(NAMES, "0")
    texts |= {"mass": "8.0", "ixx": "1.486", "iyy": "0.2", "izz": "0.83"}
    repairs, is_clear = find_repairs(WrittenInertial(texts, np.eye(3)), move=0.137)
    assert [x.texts for x in repairs] == [{"iyy": "2"}]
    assert not is_clear


def test_a_turned_tensor_is_judged_in_its_own_axes():
    """The box's shapes turned by 90 degrees about z against the link frame."""
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    texts = BOX | {"x": "0", "y": "0.2"}
    shape = BOX_SHAPE @ turn.T
    written = WrittenInertial(texts, turn, shape=shape)
    assert written.misfit(written.barycentric()) == ""
    unturned = WrittenInertial(texts, np.eye(3), shape=shape)
    assert unturned.misfit(unturned.barycentric()).startswith("larger")


@pytest.mark.parametrize(
    ("text", "half"),
    [
        ("1.2e-05", 5e-7),
        ("8.00001e-06", 5e-12),
        ("1676.359E-6", 5e-10),
        ("0.25", 0.005),
        ("4", 0.2),  # one digit: a twentieth
        ("0", 0.0),
        ("0e999", 0.0),
    ],
)
def test_digits_leave_half_a_unit_open(text, half):
    texts = dict.fromkeys(NAMES, "0") | {"izz": text}
    assert WrittenInertial(texts, np.eye(3)).resolution == pytest.approx(half)
