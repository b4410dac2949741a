"""Exposure integrals at 300 digits, by closed forms that share nothing with the package.

A window is known by its antiderivative, for exposures, and as a sum of terms
`polynomial(t) exp(i w t - t^2 r)` on each piece, for transfer functions.
"""

import itertools
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import mpmath as mp

mp.mp.dps = 300
"""Differences of error functions in the tail of a Gaussian of sigma 0.03 are 1e-241 of its peak."""
STEADY_DIGITS = 100
"""Of waves that do not fade: their moments cancel by some 40 digits at most."""
IMAGINARY = mp.mpc(0, 1)
HALF = mp.mpf("0.5")


@dataclass(frozen=True)
class Term:
    """`sum_k coefficients[k] t^k exp(i frequency t - rate t^2)`."""

    coefficients: tuple
    frequency: object = 0
    rate: object = 0


@dataclass(frozen=True)
class Window:
    """A transmittance on [-1, 1]: its antiderivative from -1 and its pieces."""

    antiderivative: object
    pieces: tuple

    def integral(self, tau):
        return self.antiderivative(max(mp.mpf(-1), min(mp.mpf(1), tau)))

    @cached_property
    def total(self):
        return self.antiderivative(mp.mpf(1))


def rect():
    return Window(lambda t: t + 1, ((-1, 1, (Term((1,)),)),))


def hann():
    terms = (Term((HALF,)), Term((HALF / 2,), mp.pi), Term((HALF / 2,), -mp.pi))
    return Window(lambda t: (t + 1) / 2 + mp.sin(mp.pi * t) / (2 * mp.pi), ((-1, 1, terms),))


def triangle():
    pieces = ((-1, 0, (Term((1, 1)),)), (0, 1, (Term((1, -1)),)))
    return Window(lambda t: (1 + t) ** 2 / 2 if t < 0 else 1 - (1 - t) ** 2 / 2, pieces)


def gaussian(sigma):
    sigma = mp.mpf(sigma)
    scale = sigma * mp.sqrt(2)

    def antiderivative(t):
        return sigma * mp.sqrt(mp.pi / 2) * (_erf(t / scale) + _erf(1 / scale))

    return Window(antiderivative, ((-1, 1, (Term((1,), 0, 1 / scale**2),)),))


def tukey(taper):
    taper = mp.mpf(taper)

    def ramp(v):
        return v / 2 - taper * mp.sin(mp.pi * v / taper) / (2 * mp.pi) if taper else mp.mpf(0)

    def antiderivative(t):
        if t < taper - 1:
            return ramp(t + 1)
        return (taper / 2 + t + 1 - taper) if t <= 1 - taper else 2 - taper - ramp(1 - t)

    pieces = [(taper - 1, 1 - taper, (Term((1,)),))]
    if taper:
        w = mp.pi / taper
        for side in (-1, 1):
            turn = side * w * (1 - taper)
            terms = [Term((HALF,))] + [
                Term((mp.exp(-IMAGINARY * sign * turn) / 4,), sign * w) for sign in (-1, 1)
            ]
            lo, hi = (-1, taper - 1) if side < 0 else (1 - taper, 1)
            pieces.append((lo, hi, tuple(terms)))
    return Window(antiderivative, tuple(pieces))


def chips(values):
    values = [mp.mpf(v) for v in values]
    count = len(values)
    below = [mp.fsum(values[:j]) for j in range(count + 1)]

    def antiderivative(t):
        position = (t + 1) * count / 2
        chip = min(int(mp.floor(position)), count - 1)
        return (below[chip] + values[chip] * (position - chip)) * 2 / count

    pieces = tuple(
        (mp.mpf(2 * j - count) / count, mp.mpf(2 * j + 2 - count) / count, (Term((v,)),))
        for j, v in enumerate(values)
        if v
    )
    return Window(antiderivative, pieces)


def spline(coefficients):
    """Clamped uniform cubic B-spline, by the recursion that defines the basis."""
    values = [mp.mpf(c) for c in coefficients]
    count, num_pieces = len(values), len(values) - 3
    inner = [mp.mpf(2 * j - num_pieces) / num_pieces for j in range(num_pieces + 1)]
    knots = [mp.mpf(-1)] * 3 + inner + [mp.mpf(1)] * 3
    shares = [values[j] * (knots[j + 4] - knots[j]) / 4 for j in range(count)]
    sums = [mp.fsum(shares[: j + 1]) for j in range(count)]

    def piece_of(t):
        return min(int(mp.floor((t + 1) * num_pieces / 2)), num_pieces - 1)

    def antiderivative(t):
        return _de_boor([mp.mpf(0), *sums], [mp.mpf(-1), *knots, mp.mpf(1)], 4, piece_of(t), t)

    def polynomial(piece):
        lo, hi = inner[piece], inner[piece + 1]
        nodes = [lo + (hi - lo) * k / 3 for k in range(4)]
        rows = mp.matrix([[x**k for k in range(4)] for x in nodes])
        heights = mp.matrix([_de_boor(values, knots, 3, piece, x) for x in nodes])
        return tuple(mp.lu_solve(rows, heights))

    pieces = tuple((inner[j], inner[j + 1], (Term(polynomial(j)),)) for j in range(num_pieces))
    return Window(antiderivative, pieces)


def _de_boor(values, knots, degree, piece, t):
    span = piece + degree
    d = [values[j + span - degree] for j in range(degree + 1)]
    for r in range(1, degree + 1):
        for j in range(degree, r - 1, -1):
            left, right = knots[j + span - degree], knots[j + 1 + span - r]
            share = (t - left) / (right - left)
            d[j] = (1 - share) * d[j - 1] + share * d[j]
    return d[degree]


def _light_below(window, A, B, edge, discriminant):
    """Integral of the window over the times at which the point is below `edge`."""
    if A == 0 and B == 0:
        return window.total if edge > 0 else mp.mpf(0)
    if A == 0:
        return window.total - window.integral(-edge / B) if B > 0 else window.integral(-edge / B)
    if discriminant <= 0:
        return mp.mpf(0)
    far = (abs(B) + mp.sqrt(discriminant)) / 2
    roots = (far / A, (B * B - discriminant) / (4 * A * far)) if far else (mp.mpf(0),) * 2
    first, last = sorted(root if B >= 0 else -root for root in roots)
    return window.integral(last) - window.integral(first)


def exposures(window, a, T, s, edges, *, from_vertex):
    """Share of a fully open exposure between consecutive edges."""
    a, T, s = mp.mpf(a), mp.mpf(T), mp.mpf(s)
    A, B = a * T * T, s * T
    if from_vertex and A == 0 and B != 0:
        return [mp.mpf(0)] * (len(edges) - 1)
    below = [
        _light_below(window, A, B, e, 4 * A * e if from_vertex else B * B + 4 * A * e)
        for e in map(mp.mpf, edges)
    ]
    return [_clean((after - before) / 2) for before, after in itertools.pairwise(below)]


def _clean(light):
    """Zero for what is left of light that cancelled in 300 digits."""
    return light if abs(light) > mp.mpf(10) ** (15 - mp.mp.dps) else mp.mpf(0)


def transfer(window, a, T, s, frequency, *, power=0):
    """Transfer function in the sensor frame, without the pixel aperture.

    With a `power`, that of the window times this power of normalised time.
    """
    fades = any(term.rate for _, _, terms in window.pieces for term in terms)
    with mp.workdps(mp.mp.dps if fades else STEADY_DIGITS):
        a, T, s = mp.mpf(a), mp.mpf(T), mp.mpf(s)
        kappa, mu = (2 * mp.pi * mp.mpf(frequency) * q for q in (a * T * T, s * T))
        each = [
            wave(_times_time(term, power), kappa, mu, mp.mpf(lo), mp.mpf(hi))
            for lo, hi, terms in window.pieces
            for term in terms
        ]
        return mp.fsum(each) / 2


def transfer_derivatives(window, a, T, s, frequency):
    """Derivatives of the transfer function by acceleration, exposure, speed and frequency.

    The integrand times the derivative of its exponent, `-2 pi i f (a T^2 t^2 - s T t)`.
    """
    first, second = (transfer(window, a, T, s, frequency, power=n) for n in (1, 2))
    a, T, s = mp.mpf(a), mp.mpf(T), mp.mpf(s)
    turn = -2 * mp.pi * IMAGINARY
    phase = turn * mp.mpf(frequency)
    return {
        "acceleration": phase * T**2 * second,
        "half_exposure": phase * (2 * a * T * second - s * first),
        "speed": -phase * T * first,
        "frequency": turn * (a * T**2 * second - s * T * first),
    }


def _times_time(term, power):
    return replace(term, coefficients=(0,) * power + tuple(term.coefficients))


def wave(term, kappa, mu, lo, hi):
    """Moments of `exp(-i (k t^2 - m t))` by the recursion that parts gives."""
    k, m = kappa - IMAGINARY * term.rate, mu + term.frequency
    if hi <= lo:
        return mp.mpf(0)
    if abs(k) < mp.mpf(10) ** -8:
        return _nearly_linear(term, k, m, lo, hi)
    ends = [mp.exp(-IMAGINARY * t * (k * t - m)) for t in (lo, hi)]
    moments = [_fresnel(k, m, lo, hi)]
    for order in range(len(term.coefficients) - 1):
        jump = hi**order * ends[1] - lo**order * ends[0]
        below = order * moments[order - 1] if order else 0
        moments.append((m * moments[order] + IMAGINARY * (jump - below)) / (2 * k))
    return mp.fsum(c * moment for c, moment in zip(term.coefficients, moments, strict=True))


def _fresnel(k, m, lo, hi):
    root, centre = mp.sqrt(IMAGINARY * k), m / (2 * k)
    difference = _erf(root * (hi - centre)) - _erf(root * (lo - centre))
    return mp.exp(IMAGINARY * k * centre**2) * mp.sqrt(mp.pi) / (2 * root) * difference


def _erf(z):
    """Error function; neighbouring pieces, and the moments of one integral, ask for the same."""
    return _erf_to(z, mp.mp.dps)


@lru_cache(4096)
def _erf_to(z, digits):
    """Error function; far out by its asymptotic series, where mpmath's takes hours."""
    if abs(z) ** 2 < min(400, 2.4 * digits):  # its least term is exp(-abs(z) ** 2)
        return mp.erf(z)
    if mp.re(z) < 0:
        return -_erf_to(-z, digits)
    total = term = mp.mpf(1)
    for order in range(1, 400):
        term *= -(2 * order - 1) / (2 * z * z)
        total += term
        if abs(term) < mp.eps:
            break
    return 1 - mp.exp(-z * z) / (z * mp.sqrt(mp.pi)) * total


def _nearly_linear(term, k, m, lo, hi):
    """By the power series in `k`, each term of which is a moment of `exp(i m t)`."""
    series = _exponential_series(-IMAGINARY * k)
    highest = len(term.coefficients) - 1 + 2 * (len(series) - 1)
    moments = _linear_moments(m, lo, hi, highest)
    return mp.fsum(
        share * c * moments[2 * order + power]
        for order, share in enumerate(series)
        for power, c in enumerate(term.coefficients)
    )


def _linear_moments(m, lo, hi, highest):
    """Integrals of `t^n exp(i m t)` by parts, or where `m` is small by its power series."""
    if abs(m) < 60:
        series = _exponential_series(IMAGINARY * m)
        powers = [(hi**n - lo**n) / n for n in range(1, len(series) + highest + 1)]
        return [mp.fdot(series, powers[n : n + len(series)]) for n in range(highest + 1)]
    ends = [mp.exp(IMAGINARY * m * t) for t in (lo, hi)]
    moments = [(ends[1] - ends[0]) / (IMAGINARY * m)]
    for n in range(1, highest + 1):
        jump = hi**n * ends[1] - lo**n * ends[0]
        moments.append((jump - n * moments[-1]) / (IMAGINARY * m))
    return moments


def _exponential_series(x):
    """The terms of `exp(x)` down to what 300 digits hold."""
    terms = [mp.mpc(1)]
    while terms[-1] and (abs(terms[-1]) > mp.eps or len(terms) < abs(x)):
        terms.append(terms[-1] * x / len(terms))
    return terms


@lru_cache
def differences(order):
    """Steps and weights of a difference quotient: central, or one-sided at a bound."""
    if order == "central":
        return (-1, 1), (-HALF, HALF)
    return (0, 1, 2), (mp.mpf("-1.5"), mp.mpf(2), mp.mpf("-0.5"))


def derivative(function, at, scale, *, one_sided=False):
    """Derivative of a row of numbers, exact to about 40 digits."""
    step = mp.mpf(scale) * mp.mpf(10) ** -20
    steps, weights = differences("one-sided" if one_sided else "central")
    rows = [function(mp.mpf(at) + k * step) for k in steps]
    return [
        mp.fsum(w * v for w, v in zip(weights, column, strict=True)) / step
        for column in zip(*rows, strict=True)
    ]
