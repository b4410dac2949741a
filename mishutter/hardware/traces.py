"""A photodiode's trace of a shutter, in place of the shutter as it was designed.

A trace is a table of times and levels, noise and unequal steps included. The level of the closed
shutter counts as 0 and that of the open one as 1, so that a profile from a trace stands where a
profile that is sent stands: the transmission and the leakage of a scene's device are not in it.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import ArrayLike, Float

from mishutter._core.checks import RowLike, Unquoted, require, require_finite, require_number
from mishutter.model.shutters.spline import SplineShutter, bounded_coefficients, spline_basis

_LEAST = 32
"""Fewest samples of an exposure."""
_LEAST_CLOSED = 8
"""Fewest samples outside the exposure that give the level of the closed shutter."""
_LONGEST_GAP = 1 / 16
"""Longest step of a trace inside the exposure, in units of the exposure."""


class Trace(NamedTuple):
    """Levels of a photodiode behind the shutter."""

    # Times, ascending, or equal where they are rounded, on any clock; s
    time: Float[np.ndarray, "n"]
    # Levels in any unit, proportional to the light but for an offset, with either sign
    level: Float[np.ndarray, "n"]

    @staticmethod
    def of(trace: "TraceLike", name: str) -> "Trace":
        """A trace as arrays; any row of finite times and one of as many finite levels are one."""
        rows: Any = trace
        is_pair = (isinstance(rows, Sequence) or np.ndim(rows) > 0) and len(rows) == 2
        require(is_pair, name, "be a `Trace`, or times and levels", trace)
        time, level = rows
        for row in (time, level):
            require_finite(name, row)
        shapes = np.shape(time), np.shape(level)
        fits = len(shapes[0]) == 1 and shapes[0] == shapes[1]
        requirement = "have a row of times and one of as many levels"
        require(fits, name, requirement, Unquoted(f"shapes {shapes[0]} and {shapes[1]}"))
        return Trace(np.asarray(time, np.float64), np.asarray(level, np.float64))

    def require_ascending(self, name: str) -> None:
        """Refuse times that fall, or are all one; rounded ones may be equal."""
        time = np.asarray(self.time)
        falls = np.diff(time) < 0
        got = Unquoted(f"{time[1 + int(np.argmax(falls))]:g} s" if np.any(falls) else "one time")
        ascends = not np.any(falls) and time.size > 0 and bool(time[-1] > time[0])
        require(ascends, name, "have times that ascend", got)

    def within_exposure(
        self, half_exposure: float, middle: float, name: str
    ) -> Float[np.ndarray, "n"]:
        """Normalised time of each sample; the exposure is covered without a gap."""
        tau = (np.asarray(self.time) - middle) / half_exposure
        inside = np.abs(tau) <= 1
        count = int(inside.sum())
        begin, end = (f"{1e3 * (middle + side * half_exposure):.6g}" for side in (-1, 1))
        exposure = f"the exposure, {begin} to {end} ms by its clock"
        first, last = float(np.min(self.time)), float(np.max(self.time))
        span = f"times from {first * 1e3:.4g} to {last * 1e3:.4g} ms"
        longest = 2 * _LONGEST_GAP
        reaches = bool(np.min(tau) <= longest - 1 and np.max(tau) >= 1 - longest)
        requirement = (
            f"reach over {exposure}, or be read with that clock's mid-exposure: `middle` or "
            "`--mid-exposure-ms`"
        )
        require(reaches, name, requirement, Unquoted(span))
        requirement = f"have at least {_LEAST} samples within {exposure}"
        require(count >= _LEAST, name, requirement, Unquoted(f"{count} of {span}"))
        ends = np.concatenate([[-1.0], tau[inside], [1.0]])
        gap = float(np.max(np.diff(ends))) / 2
        requirement = f"have no gap above 1/16 of {exposure}"
        got = Unquoted(f"one of {gap * half_exposure * 2e3:.3g} ms")
        require(gap <= _LONGEST_GAP, name, requirement, got)
        return tau

    def span_of_shifts(self, half_exposure: float, middle: float) -> tuple[float, float]:
        """Least and greatest shift of mid-exposure at which it still covers the exposure; s.

        Shifts are at most a quarter of the exposure either way, and never cross a gap of the trace.
        """
        time, begin, end = np.asarray(self.time), middle - half_exposure, middle + half_exposure
        gaps = np.flatnonzero(np.diff(time) > _LONGEST_GAP * 2 * half_exposure)
        firsts, lasts = [time[0], *time[gaps + 1]], [*time[gaps], time[-1]]
        first = max((t for t in firsts if t <= begin), default=begin)
        last = min((t for t in lasts if t >= end), default=end)
        most = half_exposure / 2
        return max(float(first - begin), -most), min(float(last - end), most)


TraceLike = Trace | ArrayLike | Sequence[RowLike]
"""A trace, or any two rows of times and levels."""


class MeasuredProfile(NamedTuple):
    """A profile that a trace shows."""

    shutter: SplineShutter  # The profile
    noise: float  # Standard deviation of one sample about it, transmittance
    closed: float  # Level of the closed shutter, in the unit of the trace
    opened: float  # Level of the open one, below that of the closed one by an inverted photodiode
    # Sentences for whoever trusts the profile: that the trace is cut off or inverted, or its levels
    # are those of a shutter that rests open
    notes: tuple[str, ...] = ()


def has_two_levels(level: Float[np.ndarray, "n"]) -> bool:
    """Whether each level is the least or the greatest, and these differ."""
    low, high = np.min(level), np.max(level)
    return bool(low < high) and bool(np.all((level == low) | (level == high)))


def require_samples(rows: np.ndarray, name: str) -> None:
    """Refuse a list of transitions, in which each line stands at a change of a binary channel.

    A change takes one line, or two if the levels before and after it are both listed, so that no
    three lines are alike. A shutter that is sampled rests for longer.
    """
    changes = np.asarray(np.any(rows[1:] != rows[:-1], axis=1))
    are_binary = all(np.unique(channel).size <= 2 for channel in rows.T)
    is_list = are_binary and bool(np.any(changes)) and bool(np.all(changes[1:] | changes[:-1]))
    requirement = "hold samples, of which many fall in each rest of the shutter"
    got = Unquoted(f"a list of transitions, {len(rows)} lines of which each is at a change")
    require(not is_list, name, requirement, got)


def measured_profile(
    trace: TraceLike,
    *,
    half_exposure: float,
    middle: float = 0.0,
    closed: float | None = None,
    opened: float | None = None,
    name: str = "measured_profile(trace=...)",
) -> MeasuredProfile:
    r"""The profile that a noisy trace of unequal steps shows.

    Cubic splines of 8 to 256 coefficients within [0, 1] are fitted by least squares, each sample
    at its own time, and the one of the smallest generalised cross-validation
    $\frac{1}{m}\lVert r\rVert^2 / (1 - n/m)^2$ (Craven and Wahba 1979) is taken: it needs no
    level of noise, and gives one, $\lVert r\rVert^2/(m - n)$. A step of the shutter is as steep as
    the spline, 1/125 of the exposure at the most coefficients.

    Args:
        trace: Times and levels, as a `Trace` or any two rows.
        half_exposure: $T$; s.
        middle: Mid-exposure on the clock of the trace; s.
        closed: Level of the closed shutter; by default the mean of the samples outside the
            exposure.
        opened: Level of the open shutter, above that of the closed one or, by an inverted
            photodiode, below; by default the extreme of the spline on the side where it goes
            farther, so that the fullest moment of the exposure counts as fully open.
        name: The trace's name in an error.

    Raises:
        ValueError: if times fall or leave a gap in the exposure, a number is not finite, the
            levels do not tell open from closed, or they are a list of transitions.
    """
    trace = Trace.of(trace, name)
    numbers = {"half_exposure": half_exposure, "middle": middle, "closed": closed, "opened": opened}
    for argument, number in numbers.items():
        if number is not None:
            require_number(f"measured_profile({argument}=...)", number)
    subject = "measured_profile(half_exposure=...)"
    require(half_exposure > 0, subject, "be above 0 s", half_exposure)
    trace.require_ascending(name)
    if has_two_levels(np.asarray(trace.level)):
        require_samples(np.asarray(trace.level)[:, None], name)
    tau = trace.within_exposure(half_exposure, middle, name)
    inside = np.abs(tau) <= 1
    levels = np.asarray(trace.level, np.float64)
    dark = levels[~inside]
    words = f"have {_LEAST_CLOSED} samples outside the exposure, or a level of the closed shutter"
    require(closed is not None or dark.size >= _LEAST_CLOSED, name, words, int(dark.size))
    black = float(np.mean(dark)) if closed is None else closed
    swing = None if opened is None else opened - black
    coefficients, white, greatest, noise = _smoothed(tau[inside], levels[inside] - black, swing)
    requirement = "tell the open shutter from the closed one by more than its noise"
    got = Unquoted(f"levels {black:g} and {black + white:g}, noise {noise:.3g}")
    require(abs(white) > 2 * noise, name, requirement, got)
    notes = tuple(_clipping(levels))
    if white < 0 and opened is None:
        spread = max(float(np.std(dark)) if closed is None else 0.0, greatest)
        requirement = (
            "rise in the exposure, or fall there from a steady level, or be read with the levels "
            "of the closed and the open shutter"
        )
        got = Unquoted(f"a fall by {-white:.3g} from levels that go {spread:.3g} about {black:.4g}")
        require(spread < noise + 0.1 * abs(white), name, requirement, got)
        notes += (f"it falls where the shutter opens, from {black:.4g}: it is read as inverted",)
    outside = float(np.mean(dark) - black) / white if dark.size >= _LEAST_CLOSED else 0.0
    if outside > 0.5:
        notes += (f"by these levels the shutter is open outside the exposure, by {outside:.2f}",)
    shutter = SplineShutter(coefficients)
    return MeasuredProfile(shutter, noise / abs(white), black, black + white, notes)


def for_a_fit(trace: TraceLike, half_exposure: float, name: str) -> tuple[Trace, tuple[str, ...]]:
    """A trace as the fit of a camera takes it: of few samples, in which light is upwards.

    Neighbouring samples become their mean, within the exposure and outside it apart, as the
    profile may jump at its ends. A trace without samples of the closed shutter stays upright.
    """
    trace = Trace.of(trace, name)
    tau = trace.time / half_exposure
    is_known = int(np.sum(np.abs(tau) > 1)) >= _LEAST_CLOSED
    closed = None if is_known else float(np.min(trace.level))
    profile = measured_profile(trace, half_exposure=half_exposure, closed=closed, name=name)
    sign = 1.0 if profile.opened > profile.closed else -1.0
    ends = [np.searchsorted(tau, -1, side="left"), np.searchsorted(tau, 1, side="right")]
    # More than 4096 samples do not improve a fit.
    first = np.unique(np.append(np.arange(0, tau.size, -(-tau.size // 4096)), ends))
    first = first[first < tau.size]
    count = np.diff([*first, tau.size])
    time, level = (np.add.reduceat(np.asarray(each), first) / count for each in trace)
    return Trace(time, sign * level), profile.notes


def _smoothed(
    tau: np.ndarray, level: np.ndarray, swing: float | None
) -> tuple[Float[np.ndarray, "count"], float, float, float]:
    """Coefficients of the spline of least cross-validation, its white, greatest level and noise.

    Levels are above that of the closed shutter, and the greatest is that of the spline without
    bounds. Normal equations need the four B-splines at each sample, where the dense basis has all
    of them. They are well conditioned as long as samples cover each B-spline. With their Cholesky
    factor the bounded problem has a row for each coefficient, whose squared residuals are what the
    bounds add to those of the free spline.
    """
    from scipy.linalg import cholesky, solve_triangular

    most = min(tau.size // 3, 3 + int(2 / float(np.max(np.diff(tau)))))
    splines = []
    for count in (8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256):
        if count > most:
            break
        basis = spline_basis(tau, count)
        squares = (basis.T @ basis).toarray()
        # A ridge, a share of a B-spline's mean square, fixes a coefficient with hardly a sample.
        triangle = cholesky(squares + 1e-12 * np.trace(squares) / count * np.eye(count))
        target = solve_triangular(triangle, basis.T @ level, trans=1)
        free = solve_triangular(triangle, target)
        values = spline_basis(np.linspace(-1, 1, 1001), count) @ free
        least, greatest = float(np.min(values)), float(np.max(values))
        white = swing
        if white is None:
            white = greatest if greatest > -least else least
        coefficients = bounded_coefficients(triangle, target / (white or 1.0))
        excess = target - triangle @ coefficients * white
        residual = float(np.sum((level - basis @ free) ** 2) + np.sum(excess**2))
        score = residual / (1 - count / tau.size) ** 2
        noise = float(np.sqrt(residual / (tau.size - count)))
        splines.append((score, coefficients, white, greatest, noise))
    _, coefficients, white, greatest, noise = min(splines, key=lambda each: each[0])
    return coefficients, white, greatest, noise


def _clipping(level: np.ndarray) -> Iterator[str]:
    """A sentence for each end at which a trace is cut off.

    Samples of a noisy signal do not stay at one level, its greatest or its least, for long: if each
    sample were there at even odds, hardly any run would be as long as twice the binary logarithm of
    their number. Where the noise is less than a step of the converter, no sentence is added.
    """
    noise = _noise_between_rails(level)
    for word, extreme in (("above", float(np.max(level))), ("below", float(np.min(level)))):
        edges = np.flatnonzero(np.diff(np.concatenate([[False], level == extreme, [False]])))
        longest = int(np.max(np.diff(edges)[::2]))
        if longest > 2 * np.log2(level.size) and noise > 1e-4 * np.ptp(level):
            share = float(np.mean(level == extreme))
            yield (
                f"it is clipped, with {share:.2g} of its samples at exactly {extreme:.6g}: what "
                f"went {word} that is lost, and the profile flat there; take it again at a "
                "coarser vertical scale"
            )


def _noise_between_rails(level: np.ndarray) -> float:
    """About the standard deviation of a sample, from those between the extreme levels; 0 if none.

    Neighbouring second differences of noise have opposite signs, which distinguishes it from a
    smooth signal. Those of samples at a rail would hide it, and rounding to the converter's steps
    looks like noise of up to one step.
    """
    is_between = (level > np.min(level)) & (level < np.max(level))
    are_four = is_between[3:] & is_between[2:-1] & is_between[1:-2] & is_between[:-3]
    bend = np.diff(level, 2)
    products = (-bend[1:] * bend[:-1])[are_four]
    if products.size == 0:
        return 0.0
    noise = float(np.sqrt(max(np.median(products), 0.0)))
    step = float(np.min(np.diff(np.unique(level[is_between])), initial=np.inf))
    return noise if noise > 1.1 * step else 0.0
