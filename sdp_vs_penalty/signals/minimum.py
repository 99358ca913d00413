"""The least value of a function of one number, without scipy.optimize: importing it takes longer than
a check."""

from __future__ import annotations

from collections.abc import Callable


def minimum(
    f: Callable[[float], float], low: float, high: float, tolerance: float = 1e-5, most: int = 500
) -> float:
    """x between low and high where f is least within a tolerance, by at most so many evaluations.

    Parabolas through the three best points, the golden section where they do not converge (Brent,
    Algorithms for Minimization without Derivatives, 1973, ch. 5).
    """
    golden, rounding = 1.5 - 1.25**0.5, 2.0**-26  # the section's smaller part; of the place of a minimum
    best = second = third = low + golden * (high - low)
    least = next_least = last = f(best)
    step = before = 0.0
    for _ in range(most - 1):
        middle, near = 0.5 * (low + high), rounding * abs(best) + tolerance / 3.0
        if abs(best - middle) <= 2.0 * near - 0.5 * (high - low):
            break
        parabola = False
        if abs(before) > near:
            r = (best - second) * (least - last)
            q = (best - third) * (least - next_least)
            p, q = (best - third) * q - (best - second) * r, 2.0 * (q - r)
            p, q = (-p if q > 0.0 else p), abs(q)
            if abs(p) < abs(0.5 * q * before) and q * (low - best) < p < q * (high - best):
                before, step, parabola = step, p / q, True
                if best + step - low < 2.0 * near or high - best - step < 2.0 * near:
                    step = near if middle >= best else -near
        if not parabola:
            before = (low if best >= middle else high) - best
            step = golden * before
        x = best + (max(abs(step), near) if step >= 0.0 else -max(abs(step), near))
        value = f(x)
        if value <= least:
            low, high = (best, high) if x >= best else (low, best)
            third, last, second, next_least, best, least = second, next_least, best, least, x, value
            continue
        low, high = (x, high) if x < best else (low, x)
        if value <= next_least or second == best:
            third, last, second, next_least = second, next_least, x, value
        elif value <= last or third in (best, second):
            third, last = x, value
    return best
