"""Whether a channel carries noise: what equal rows, and torques without any, mean."""

import numpy as np

from sdp_vs_penalty.robot.arrays import Array, nonzero_or_one

#: Fourth differences of a channel with noise take so many sizes.
_SIZES = 12.0


def shows_noise(x: Array) -> bool:
    """Return whether a channel x (N,) carries white noise of more than its digits.

    Fourth differences of white noise change their sign four times in five from row to
    row, those of a smooth signal seldom. If rounding to steps d is all the noise there
    is, they are whole multiples of d with a standard deviation of 2.4 d: with shares p_k
    of equal sizes, 1 / sum p_k^2 is 5, and 15 with as much noise beside it. Floating
    digits keep d within a power of two and of ten: the rows of the most frequent are taken.
    """
    powers_of_ten = np.floor(np.log10(nonzero_or_one(np.abs(x))))
    powers_of_two = np.frexp(x)[1]
    # One number for each pair of powers: rows with the same one have the same digits.
    pairs = 1000.0 * powers_of_two + powers_of_ten
    values, counts = np.unique(pairs, return_counts=True)
    is_most_frequent = pairs[2:-2] == values[np.argmax(counts)]
    differences = np.diff(x, 4)[is_most_frequent]
    differences = differences[differences != 0.0]
    if len(differences) < 2:
        return False
    alternates = np.mean(differences[1:] * differences[:-1] < 0.0)
    size = np.abs(differences)
    in_steps = np.round(size / (0.05 * np.median(size)))
    shares = np.unique(in_steps, return_counts=True)[1] / len(size)
    return bool(alternates > 0.5 and 1.0 / np.sum(shares**2) > _SIZES)
