"""Student's t distribution for real-valued degrees of freedom.

    P(|T| ≥ t) = I_x(ν/2, 1/2),   x = ν / (ν + t²),   I the regularised incomplete beta function

**Conventions.** Degrees are positive; results have nine correct digits up to 10,000 degrees. Only the standard library
is used, so that participants compute intervals without SciPy.

Source: Student (1908); the continued fraction of I and its evaluation, Lentz (1976), as in Press et al., Numerical
Recipes, section 6.4.
"""

from math import exp, lgamma, log, log1p, pi

_SMALLEST = 1e-300
_EPSILON = 1e-16
_MOST_TERMS = 10_000
_MOST_STEPS = 100


def two_sided(t: float, degrees: float) -> float:
    """Return P(|T| ≥ |t|)."""
    a, b, square = degrees / 2, 0.5, t * t
    if square == 0:
        return 1.0
    x, log_x, log_rest = degrees / (degrees + square), -log1p(square / degrees), -log1p(degrees / square)
    front = exp(lgamma(a + b) - lgamma(a) - lgamma(b) + a * log_x + b * log_rest)
    if x < (a + 1) / (a + b + 2):
        return front * _fraction(x, a, b) / a
    return 1 - front * _fraction(square / (degrees + square), b, a) / b


def critical_value(level: float, degrees: float) -> float:
    """Return t with P(|T| ≥ t) = 1 − level, for a level in (0, 1)."""
    log_scale = lgamma((degrees + 1) / 2) - lgamma(degrees / 2) - log(degrees * pi) / 2
    t = 0.0
    for _ in range(_MOST_STEPS):  # Newton's steps converge from below, because the tail is convex
        density = exp(log_scale - (degrees + 1) / 2 * log1p(t * t / degrees))
        step = (two_sided(t, degrees) - (1 - level)) / (2 * density)
        t += step
        if abs(step) <= 1e-14 * t:
            break
    return t


def _fraction(x: float, a: float, b: float) -> float:
    """Return the continued fraction of the incomplete beta function."""
    c, d = 1.0, 1 / _nonzero(1 - (a + b) * x / (a + 1))
    fraction = d
    for m in range(1, _MOST_TERMS):
        even = m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m))
        odd = -(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1))
        before = fraction
        for term in (even, odd):
            c, d = _nonzero(1 + term / c), 1 / _nonzero(1 + term * d)
            fraction *= c * d
        if abs(fraction - before) <= _EPSILON * abs(fraction):
            break
    return fraction


def _nonzero(value: float) -> float:
    return value if abs(value) >= _SMALLEST else _SMALLEST
