"""How sure a table is: intervals of shares, paired tests, and who is about as good.

A share of right answers has Wilson's 95 % interval (J. Am. Stat. Assoc. 1927). Two contestants
are compared on the problems that both ran, by the exact sign test of the problems on which
they differ (McNemar's test, for right answers). Contestants that no test tells apart are about as
good. All tests of a table together err with a probability of 5 % (Bonferroni). Problems of one
robot are alike: the intervals hold for the set of problems that ran, not for others.
"""

import math

import numpy as np
import pandas

#: The 97.5 % point of the normal distribution, for 95 % intervals.
_NORMAL_97 = 1.959964
#: Probability that any test of a table errs.
LEVEL = 0.05
#: Times within this factor are about the same: runs again spread as much.
SAME_TIME = 1.1
#: Shorter times are not told apart by the clock of a process [s].
SHORTEST = 1e-4


def wilson(right: int, n: int) -> tuple[float, float]:
    """Return the 95 % interval of a share: ``right`` of n cases were seen."""
    if n == 0:
        return 0.0, 1.0
    z2 = _NORMAL_97**2
    centre = (right + 0.5 * z2) / (n + z2)
    half = _NORMAL_97 * math.sqrt(right * (n - right) / n + 0.25 * z2) / (n + z2)
    return max(centre - half, 0.0), min(centre + half, 1.0)


def sign_test(first: int, second: int) -> float:
    """Return the two-sided p of a sign test between two contestants, from the number of
    problems in favour of each."""
    n = first + second
    tail = sum(math.comb(n, k) for k in range(min(first, second) + 1))
    return min(1.0, 2.0 * tail / 2.0**n)


def level(n_contestants: int) -> float:
    """Return the level of each test of a table in which each contestant but one has a
    test: LEVEL is the probability that any of them errs."""
    return LEVEL / max(n_contestants - 1, 1)


def can_tell(n: int, n_contestants: int = 2) -> bool:
    """Tell whether there are enough problems to rank the contestants.

    There are if the test would tell two contestants apart, one of them right on all
    problems, the other on none.
    """
    return sign_test(n, 0) <= level(n_contestants)


def beside(cells: pandas.DataFrame, one: str, other: str) -> dict[str, float]:
    """Compare two contestants on the problems that both ran.

    Parameters
    ----------
    cells : DataFrame
        A row for each problem and solver: "problem", "solver", "right", "seconds".

    Returns
    -------
    dict of str to float
        "n", how many both ran; "one" and "other", on how many problems only that one is
        right, and "p" of these;
        "ratio", the geometric mean of the time of ``other`` over that of ``one`` where both
        are right (NaN without such problems), and "p_time" of who is faster.
    """
    table = cells.pivot(index="problem", columns="solver", values=["right", "seconds"])
    both = table["right"][[one, other]].dropna()
    right = both.astype(bool)
    n_one = int((right[one] & ~right[other]).sum())
    n_other = int((right[other] & ~right[one]).sum())
    seconds = table["seconds"].loc[right.index[right.all(axis=1)]].astype(float)
    seconds = seconds.clip(lower=SHORTEST)
    logs = np.log(seconds[other] / seconds[one]).dropna()
    return {
        "n": len(both),
        "one": n_one,
        "other": n_other,
        "p": sign_test(n_one, n_other),
        "ratio": float(np.exp(logs.mean())) if len(logs) else float("nan"),
        "p_time": sign_test(int((logs > 0.0).sum()), int((logs < 0.0).sum())),
    }
