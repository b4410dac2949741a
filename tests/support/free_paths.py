"""Taps on a free path at 80 digits, piece by piece, and random points to check them at.

Each piece is integrated between the roots of its own parabola, sorted: nothing is shared with the
package, which follows branches over many pieces.
"""

import itertools
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np

from mishutter import FreeMotion, binned_exposure, blur_kernel, transfer_function
from support import reference
from support.cases import SHUTTERS
from support.helpers import (
    DERIVATIVE_OF_LARGEST,
    DERIVATIVE_OF_TAP,
    TAP_OF_LARGEST,
    TAPS_OF_TRAVEL,
    TRANSFER_ABSOLUTE,
)

DIGITS = 80
NUM_TAPS = 12
STEP = mp.mpf(10) ** -25
DURATIONS = (1.0, 2.5, 0.0, 0.75, 3.0, 0.5, 0.0, 1.25)
"""Of pieces, two of which have no length."""


@dataclass(frozen=True)
class PathPoint:
    """A shutter, a path, and edges (or, in the frame of the lowest position, a phase)."""

    slug: str
    accelerations: np.ndarray
    half_exposure: np.floating
    speed: np.floating
    velocity: np.floating
    edges: np.ndarray
    frame: str

    @property
    def dtype(self):
        return self.edges.dtype.type

    @property
    def arguments(self):
        """All that taps depend on but the shutter, in one row; the last moves all edges."""
        numbers = self.half_exposure, self.speed, self.velocity, self.dtype(0)
        return np.array([*self.accelerations, *numbers], self.edges.dtype)

    @property
    def window(self):
        """The reference of the shutter."""
        return SHUTTERS[self.slug].reference(self.edges.dtype)

    @property
    def scales(self):
        """The change of each argument that changes taps by about their own size."""
        T, stroke = float(self.half_exposure), self.reach
        fast = stroke / T
        return [*[fast / T] * len(DURATIONS), T, fast, fast, stroke]

    @property
    def reach(self):
        T = float(self.half_exposure)
        bend = np.max(np.abs(self.accelerations.astype(float))) * T * T
        return bend + abs(float(self.speed) - float(self.velocity)) * T


def pieces(arguments):
    """Begin, end, position, velocity and stroke of each piece that lasts."""
    *accelerations, T, speed, velocity, _ = arguments
    passed = [mp.mpf(0)]
    for duration in DURATIONS:
        passed.append(passed[-1] + mp.mpf(duration))
    ends = [2 * t / passed[-1] - 1 for t in passed]
    rows, x, u = [], mp.mpf(0), mp.mpf(0)
    for a, begin, end in zip(accelerations, ends, ends[1:], strict=False):
        if end > begin:
            A, h = a * T * T, end - begin
            rows.append([begin, end, x, u, A])
            x, u = x + h * (u + A * h), u + 2 * A * h
    begin, _, x, u, A = next(row for row in reversed(rows) if row[0] <= 0)
    middle, drift = x - begin * (u - A * begin), u - 2 * A * begin + (speed - velocity) * T
    for row in rows:
        row[2] -= middle + drift * row[0]
        row[3] -= drift
    return rows


def lowest(rows):
    found = []
    for begin, end, x, u, A in rows:
        h = end - begin
        found += [x, x + h * (u + A * h)]
        if A > 0 and 0 < -u / (2 * A) < h:
            found.append(x - u * u / (4 * A))
    return min(found)


def exact_taps(window, arguments, point, delay=0):
    rows = pieces(arguments)
    edges = [float(e) for e in point.edges]
    if point.frame == "vertex":
        start = lowest(rows)
        edges = [start + edges[0] + k for k in range(NUM_TAPS + 1)]
    edges = [mp.mpf(e) + arguments[-1] for e in edges]
    taps = [mp.mpf(0)] * NUM_TAPS
    for begin, end, x, u, A in rows:
        times = {begin, end}
        for edge in edges:
            times.update(begin + h for h in roots(A, u, x - edge) if 0 < h < end - begin)
        times = sorted(times)
        for first, last in itertools.pairwise(times):
            h = (first + last) / 2 - begin
            place = x + h * (u + A * h)
            tap = sum(edge <= place for edge in edges) - 1
            if 0 <= tap < NUM_TAPS:
                taps[tap] += (window.integral(last + delay) - window.integral(first + delay)) / 2
    return taps


def roots(A, u, x):
    if A == 0:
        return [-x / u] if u else []
    square = u * u - 4 * A * x
    if square < 0:
        return []
    far = -(u + (mp.sqrt(square) if u >= 0 else -mp.sqrt(square))) / 2
    return [far / A] + ([x / far] if far else [])


def exact(point):
    """Taps, and their derivatives by each argument."""
    with mp.workdps(DIGITS):
        window = point.window
        arguments = [mp.mpf(float(x)) for x in point.arguments]
        taps = exact_taps(window, arguments, point)
        columns = []
        for index, scale in enumerate(point.scales):
            step = STEP * mp.mpf(scale)
            sides = []
            for sign in (1, -1):
                moved = list(arguments)
                moved[index] += sign * step
                sides.append(exact_taps(window, moved, point))
            columns.append([(p - m) / (2 * step) for p, m in zip(*sides, strict=True)])
        return taps, columns


def _motion(arguments):
    """The path of some arguments, the speed of a thing and the shift of the edges."""
    rates, (T, speed, velocity, shift) = jnp.split(arguments, [len(DURATIONS)])
    path = {"accelerations": rates, "velocity": velocity, "durations": DURATIONS}
    return FreeMotion(half_exposure=T, **path), speed, shift


@partial(jax.jit, static_argnums=(0, 1))
def taps_and_derivatives(slug, frame, arguments, edges, parameters):
    """Taps `(n,)`, and derivatives `(n, arguments)`."""

    def along(arguments):
        motion, speed, shift = _motion(arguments)
        shutter = SHUTTERS[slug].make(parameters)
        if frame == "vertex":
            rule = {"speed": speed, "num_taps": NUM_TAPS, "phase": edges[0] + shift}
            return blur_kernel(shutter, motion, **rule)
        return binned_exposure(shutter, motion, speed=speed, edges=edges + shift)

    return along(arguments), jax.jacfwd(along)(arguments)


def random_path(rng, dtype, slug, *, largest=3.5):
    """A path of any kind, with edges over the whole of it or next to where it turns."""
    count = len(DURATIONS)
    T = dtype(10 ** rng.uniform(-4, 3))
    stroke = 10 ** rng.uniform(-6, largest)
    signs = rng.choice([-1, 0, 1, 1], count) if rng.uniform() < 0.6 else np.ones(count)
    strokes = stroke * signs * 10 ** rng.uniform(-2, 0, count)
    gain = 2 * stroke / float(T)
    # An object at rest on a stretch of the sensor has a lowest position that bends with its speed.
    rests = not np.any(signs == 0) and rng.uniform() < 0.25
    relative = 0.0 if rests else gain * rng.uniform(-1, 1)
    velocity = dtype(gain * rng.choice([0, 0.35]) * rng.uniform(-1, 1))
    accelerations = (strokes / float(T) ** 2).astype(dtype)
    speed = dtype(relative + float(velocity))
    frame = str(rng.choice(["sensor", "vertex"]))
    if frame == "vertex":
        edges = np.array([dtype(rng.choice([0.0, -0.5, -0.37, rng.uniform(0, stroke)]))])
    else:
        with mp.workdps(DIGITS):
            numbers = [*accelerations, T, speed, velocity, 0]
            rows = pieces([mp.mpf(float(x)) for x in numbers])
            places = [float(row[2]) for row in rows]
        low, high = min(places), max(places)
        spread = max(high - low, stroke * 1e-3)
        near = rng.choice(places) + spread * 10 ** rng.uniform(-6, 0) * rng.normal(
            size=NUM_TAPS + 1
        )
        even = rng.uniform(low - 0.1 * spread, high + 0.1 * spread, NUM_TAPS + 1)
        edges = np.sort(near if rng.uniform() < 0.3 else even).astype(dtype)
    return PathPoint(slug, accelerations, T, speed, velocity, edges, frame)


def errors(point):
    """Largest error of a tap and of a derivative, in units of what is allowed."""
    dtype = point.dtype
    taps, slopes = (
        np.asarray(x)
        for x in taps_and_derivatives(
            point.slug,
            point.frame,
            point.arguments,
            point.edges,
            SHUTTERS[point.slug].parameters.astype(dtype),
        )
    )
    truth, columns = exact(point)
    if not (np.all(np.isfinite(taps)) and np.all(np.isfinite(slopes))):
        return np.nan, np.nan
    # The taps may be narrow, or in the dark: the kernel's mean tap of their width counts too.
    width = 1.0 if point.frame == "vertex" else float(np.ptp(point.edges)) / NUM_TAPS
    count = max(1.0, point.reach / width)
    light = float(point.window.integral(1) - point.window.integral(-1)) / 2
    largest, tiny = max(*truth, light / count), mp.mpf(float(np.finfo(dtype).tiny))
    factor = max(1.0, count / TAPS_OF_TRAVEL[dtype])
    worst = max(abs(mp.mpf(float(h)) - r) for h, r in zip(taps, truth, strict=True))
    of_taps = worst / (factor * TAP_OF_LARGEST[dtype] * largest)
    of_slopes = 0.0
    for index, (column, scale) in enumerate(zip(columns, point.scales, strict=True)):
        at_vertex = point.frame == "vertex" and float(point.edges[0]) in (0.0,)
        if index == len(columns) - 1 and at_vertex:
            continue
        floor = DERIVATIVE_OF_TAP[dtype] * largest / mp.mpf(scale)
        allowed = factor * max(DERIVATIVE_OF_LARGEST[dtype] * max(map(abs, column)), floor, tiny)
        worst = max(
            abs(mp.mpf(float(h)) - r) for h, r in zip(slopes[:, index], column, strict=True)
        )
        of_slopes = max(of_slopes, worst / allowed)
    return float(of_taps), float(of_slopes)


def exact_transfer(window, arguments, frequency):
    """Transfer function of a window on a path, from the moments of each piece's own parabola."""
    turn, total = 2 * mp.pi * frequency, mp.mpc(0)
    for begin, end, x, u, A in pieces(arguments):
        linear, start = u - 2 * A * begin, x - begin * (u - A * begin)
        each = [
            reference.wave(term, turn * A, -turn * linear, max(begin, lo), min(end, hi))
            for lo, hi, terms in window.pieces
            for term in terms
            if max(begin, mp.mpf(lo)) < min(end, mp.mpf(hi))
        ]
        total += mp.exp(-reference.IMAGINARY * turn * start) * mp.fsum(each)
    return total / 2


@partial(jax.jit, static_argnums=0)
def response_and_derivatives(slug, arguments, frequencies, parameters):
    """Transfer function and its derivatives by the path; real and imaginary part, `(2, m, k)`."""

    def along(arguments):
        motion, speed, _ = _motion(arguments)
        shutter = SHUTTERS[slug].make(parameters)
        found = transfer_function(shutter, motion, speed=speed, frequency=frequencies)
        return jnp.stack([found.real, found.imag])

    return along(arguments), jax.jacfwd(along)(arguments)


def transfer_errors(point, frequencies):
    """Largest error of the transfer function and of a derivative, in units of what is allowed."""
    dtype, eps = point.dtype, float(np.finfo(point.dtype).eps)
    parameters = SHUTTERS[point.slug].parameters.astype(dtype)
    arguments = point.arguments, frequencies, parameters
    found, slopes = (np.asarray(x) for x in response_and_derivatives(point.slug, *arguments))
    of_values = of_slopes = 0.0
    with mp.workdps(reference.STEADY_DIGITS):
        window = SHUTTERS[point.slug].reference(dtype)
        numbers = [mp.mpf(float(x)) for x in point.arguments]
        for k, f in enumerate(frequencies.tolist()):
            held = 2 * np.pi * abs(f) * point.reach * eps
            exact = complex(exact_transfer(window, numbers, mp.mpf(f)))
            error = abs(complex(*found[:, k]) - exact)
            of_values = max(of_values, error / (TRANSFER_ABSOLUTE[dtype] + held))
            truth = []
            for index, scale in enumerate(point.scales[:-1]):
                step, sides = STEP * mp.mpf(scale), []
                for sign in (1, -1):
                    moved = list(numbers)
                    moved[index] += sign * step
                    sides.append(exact_transfer(window, moved, mp.mpf(f)))
                truth.append(complex((sides[0] - sides[1]) / (2 * STEP)))
            row = (slopes[0, k] + 1j * slopes[1, k])[:-1] * np.array(point.scales[:-1])
            largest = np.max(np.abs(truth))
            floor = TRANSFER_ABSOLUTE[dtype] * 2 * np.pi * abs(f) * point.reach
            allowed = max(DERIVATIVE_OF_LARGEST[dtype] * largest, floor, TRANSFER_ABSOLUTE[dtype])
            of_slopes = max(of_slopes, np.max(np.abs(row - truth)) / allowed)
    return of_values, of_slopes
