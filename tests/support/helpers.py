"""Tolerances by name, random points of the domain, and the comparison with the reference."""

from dataclasses import dataclass, replace
from functools import partial

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np

from mishutter import ParabolicMotion, binned_exposure, blur_kernel, transfer_function
from support import reference
from support.cases import SHUTTERS

TAP_OF_LARGEST = {np.float64: 1e-12, np.float32: 5e-6}
"""Error of a tap relative to the largest of its kernel, where light travels over so many taps:"""
TAPS_OF_TRAVEL = {np.float64: 1e3, np.float32: 50.0}
"""and in proportion to their number beyond, as a rounding of time is one of a narrower tap."""
DERIVATIVE_OF_LARGEST = {np.float64: 1e-11, np.float32: 1e-4}
"""Error of a derivative relative to the largest, or"""
DERIVATIVE_OF_TAP = {np.float64: 1e-12, np.float32: 1e-5}
"""to the largest tap, or response, per natural unit of the argument: one that is zero in exact
arithmetic, because all light falls on one tap, is a difference of equal numbers."""
TRANSFER_ABSOLUTE = {np.float64: 1e-12, np.float32: 2e-6}
"""Error of a transfer function, of modulus at most 1."""
ROUNDING = 1e-14
"""Two compilations of the same formula."""

MAX_TRAVEL = 1e4
"""Longest travel of light over the sensor, px, that digits are promised for."""

REST_STROKES = (0.0, 1e-310, 1e-200, 1e-131, 1e-78)
"""Strokes, px, that are no different from none to an object without speed."""

NUM_TAPS = 16
ARGUMENTS = ("acceleration", "half_exposure", "speed", "velocity", "position", "shutter")
TRANSFER_ARGUMENTS = (*ARGUMENTS[:4], "frequency", "shutter")
PANNING_SHARE = 0.35
"""Share of the random points at which the sensor pans."""
MOST_CANCELLED = {np.float64: 13, np.float32: 5}
"""Decades by which the speed and the velocity of a random point may exceed their difference."""


@dataclass(frozen=True)
class Point:
    """One random problem; `taps` are positions of tap edges, or that of the first.

    `speed` is that of the object, and `velocity` that of the sensor.

    The shutter's parameters are those of the case, unless some were `drawn`.
    """

    slug: str
    stroke: float
    acceleration: float
    half_exposure: float
    speed: float
    taps: np.ndarray
    frame: str
    drawn: np.ndarray | None = None
    velocity: float = 0.0

    @property
    def relative_speed(self):
        """Speed of the object over the sensor, exactly."""
        return mp.mpf(float(self.speed)) - mp.mpf(float(self.velocity))

    @property
    def parameters(self):
        """Parameters of the shutter, in the point's precision."""
        given = SHUTTERS[self.slug].parameters if self.drawn is None else self.drawn
        return given.astype(self.taps.dtype)

    @property
    def window(self):
        """The reference of the shutter."""
        return SHUTTERS[self.slug].window(self.parameters)

    @property
    def travel(self):
        """The greatest distance of light from where its positions count from; px."""
        smear = abs(float(self.relative_speed)) * float(self.half_exposure)
        if self.frame == "sensor":
            return self.stroke + smear
        share = smear / (2 * self.stroke) if smear else 0.0
        return self.stroke * (1 + share) ** 2

    @property
    def is_at_rest(self):
        """Whether the object does not move to speak of."""
        return self.stroke <= max(REST_STROKES) and self.speed == self.velocity

    @property
    def regime(self):
        """The corner of the domain that a point lies in, for the table of worst cases."""
        if self.is_at_rest:
            return "at rest"
        if self.stroke == 0:
            return "no acceleration"
        if self.stroke < 1e-3:
            return "stroke below 1e-3 px"
        if abs(self.relative_speed) > 2 * self.acceleration * self.half_exposure:
            return "object faster than the sensor"
        return "stroke 1e-3 to 1e4 px" if self.stroke < 1e4 else "stroke above 1e4 px"


def random_point(rng, dtype=np.float64, slug=None):
    """A point of the domain, log-uniform, with the special places drawn often."""
    while (point := _random_point(rng, dtype, slug)).travel > MAX_TRAVEL:
        pass
    return point


def _random_point(rng, dtype, slug):
    slug = slug or str(rng.choice(list(SHUTTERS)))
    frame = str(rng.choice(["vertex", "sensor"]))
    still = frame == "sensor" and rng.random() < 0.1
    stroke = (
        0.0
        if still
        else 10 ** rng.uniform(-9 if dtype is np.float32 else -12, np.log10(MAX_TRAVEL))
    )
    T = dtype(10 ** rng.uniform(-9, 5))
    # Drawn apart, so that all other points stay as they are.
    apart = rng.spawn(1)[0]
    at_rest = apart.random() < 0.03
    stroke = apart.choice(REST_STROKES) if at_rest else stroke
    a = dtype(stroke / float(T) / float(T))
    special = [0.0, 1.0, 0.5, 1 / 26, 3 / 7, 1 - 2 / 21]
    nu = rng.choice([rng.choice(special), 10 ** rng.uniform(-6, 2)]) * rng.choice([-1, 1])
    smear = 10 ** rng.uniform(-9, 4) if still else 2 * stroke * nu
    smear = 0.0 if at_rest else smear
    s, v = dtype(smear / float(T)), dtype(0)
    pan = apart.spawn(1)[0]
    if pan.random() < PANNING_SHARE:
        s, v = panning(pan, float(s), 2 * float(a) * float(T) or 1 / float(T), dtype)
        smear = (float(s) - float(v)) * float(T)
        nu = smear / (2 * stroke) if stroke else nu
    far, reach = stroke * (1 + abs(nu)) ** 2, stroke + abs(smear)
    drawn_from = SHUTTERS[slug].drawn
    drawn = np.array(np.exp(rng.uniform(*np.log(drawn_from)))) if drawn_from else None
    if frame == "vertex":
        near = stroke * max(abs(nu) - 1, 0) ** 2
        start = [0, -0.5, rng.uniform(-3, 3), rng.uniform(near, far), far - rng.uniform(0, 16)]
        phase = rng.choice(start)
        # No edge lies within the path of a point at rest: that path counts as one place.
        phase = dtype(apart.choice([0.0, -0.5, apart.uniform(-3, 3)]) if at_rest else phase)
        return Point(slug, stroke, a, T, s, np.array([phase]), frame, drawn, v)
    vertex = -smear * nu / 2 if stroke else 0.0
    centre = rng.choice([0, vertex, stroke - smear, stroke + smear, rng.uniform(-reach, reach)])
    pitch = rng.choice([1.0, reach / NUM_TAPS, 1e-3 * reach]) or 1.0
    spread = rng.uniform(-NUM_TAPS / 2, NUM_TAPS / 2, NUM_TAPS + 1)
    edges = spread if at_rest else centre + pitch * spread
    return Point(slug, stroke, a, T, s, np.sort(edges).astype(dtype), frame, drawn, v)


def panning(rng, relative, gain, dtype):
    """Speed of an object and velocity of a sensor that differ by about `relative`, px/s.

    The velocity is comparable with the speed, far above the sensor's `gain` of speed, or so
    close to the speed that both all but cancel.
    """
    kind, sign = rng.choice(["comparable", "huge", "cancels"]), rng.choice([-1, 1])
    v = {
        "comparable": (relative or gain) * rng.uniform(-3, 3),
        "huge": sign * gain * 10 ** rng.uniform(1, 6),
        "cancels": sign * (relative or gain) * 10 ** rng.uniform(1, MOST_CANCELLED[dtype]),
    }[str(kind)]
    return dtype(relative + float(dtype(v))), dtype(v)


def _taps(make, frame, a, T, s, v, shift, parameters, positions):
    shutter = make(parameters)
    motion = ParabolicMotion(acceleration=a, half_exposure=T, velocity=v)
    if frame == "vertex":
        phase = positions[0] + shift
        return blur_kernel(shutter, motion, speed=s, num_taps=NUM_TAPS, phase=phase)
    return binned_exposure(shutter, motion, speed=s, edges=positions + shift)


@partial(jax.jit, static_argnums=(0, 1))
def taps_and_derivatives(make, frame, arguments, positions, direction):
    """Taps, and their derivatives by each of `ARGUMENTS`, the shutter's along a direction.

    Cases of one class and as many parameters share a program.
    """

    def along(step):
        *motion, parameters = arguments
        motion = [x + step[i] for i, x in enumerate(motion)]
        moved = parameters + direction * step[5]
        return _taps(make, frame, *motion, step[4], moved, positions)

    origin = jnp.zeros(len(ARGUMENTS), positions.dtype)
    return along(origin), jax.jacfwd(along)(origin)


def direction_of(parameters):
    """A fixed direction in the space of a shutter's parameters."""
    index = np.arange(parameters.size).reshape(parameters.shape)
    return np.cos(2.1 * index + 0.4).astype(parameters.dtype)


def computed(point):
    """What the package finds at a point: taps `(n,)` and derivatives `(n, 6)`."""
    direction = direction_of(point.parameters)
    taps, derivatives = taps_and_derivatives(
        SHUTTERS[point.slug].make, point.frame, _arguments(point), point.taps, direction
    )
    return np.asarray(taps), np.asarray(derivatives)


def _arguments(point):
    numbers = point.acceleration, point.half_exposure, point.speed, point.velocity
    dtype = point.taps.dtype.type
    return *(dtype(x) for x in numbers), point.parameters


def exact_taps(point, *, a=None, T=None, s=None, shift=0, window=None):
    """Taps of the reference, with some arguments replaced."""
    window = window or point.window
    first = point.taps if point.frame == "sensor" else None
    edges = (
        [mp.mpf(float(e)) + shift for e in first]
        if first is not None
        else [k + mp.mpf(float(point.taps[0])) + shift for k in range(NUM_TAPS + 1)]
    )
    return reference.exposures(
        window,
        float(point.acceleration) if a is None else a,
        float(point.half_exposure) if T is None else T,
        point.relative_speed if s is None else s,
        edges,
        from_vertex=point.frame == "vertex",
    )


def natural_scale(point, argument):
    """The change of an argument that changes taps by about their own size."""
    a, T, s = _motion(point)
    if point.is_at_rest:
        a, s = T**-2, 1 / T
    return {
        "acceleration": a or abs(s) / T,
        "half_exposure": T,
        "speed": max(abs(s), 2 * a * T),
        "velocity": max(abs(s), 2 * a * T),
        "position": min(1.0, a * T * T + abs(s) * T),
        "shutter": 1.0,
    }[argument]


def exact_derivative(point, argument):
    """Derivative of the reference by one of `ARGUMENTS`, a row over taps."""
    if argument == "shutter":
        return _exact_shutter_derivative(point)
    if argument == "velocity":
        return [-x for x in exact_derivative(point, "speed")]
    window = point.window
    name, at = {
        "acceleration": ("a", float(point.acceleration)),
        "half_exposure": ("T", float(point.half_exposure)),
        "speed": ("s", point.relative_speed),
        "position": ("shift", 0.0),
    }[argument]
    return reference.derivative(
        lambda x: exact_taps(point, window=window, **{name: x}),
        at,
        natural_scale(point, argument),
        one_sided=argument == "acceleration" and (at == 0 or point.is_at_rest),
    )


def _exact_shutter_derivative(point):
    if point.parameters.size == 0:
        return [mp.mpf(0)] * NUM_TAPS
    direction = direction_of(point.parameters)
    return _along(point, direction, lambda window: exact_taps(point, window=window))


def _along(point, direction, row):
    """Derivative of a row of numbers of the reference's window along a direction."""
    base = point.parameters
    start, step = (np.array([mp.mpf(float(x)) for x in v.flat]) for v in (base, direction))

    def moved(x):
        return row(SHUTTERS[point.slug].window((start + x * step).reshape(base.shape)))

    return reference.derivative(moved, 0, 1)


def allowance(point, exact):
    """The factor by which errors may exceed their tolerances, and the largest tap of the kernel.

    The taps of a point may be narrow, or in the dark: the kernel's mean tap of their width counts
    too.
    """
    dtype = point.taps.dtype.type
    width = 1.0 if point.frame == "vertex" else float(np.ptp(point.taps)) / NUM_TAPS
    count = point.travel / width
    light = float(point.window.integral(1) - point.window.integral(-1)) / 2
    largest = max(float(max(exact)), light / max(count, 1.0))
    return max(1.0, count / TAPS_OF_TRAVEL[dtype]), largest


def tap_error(taps, point, exact):
    """Largest error of a tap, in units of what is allowed; nan where a tap is not finite."""
    if max(exact) == 0:
        return 0.0 if not np.any(taps) else np.inf
    if not np.all(np.isfinite(taps)):
        return np.nan
    factor, largest = allowance(point, exact)
    errors = [abs(mp.mpf(float(h)) - r) for h, r in zip(taps, exact, strict=True)]
    return float(max(errors)) / (factor * TAP_OF_LARGEST[point.taps.dtype.type] * largest)


def derivative_error(derivatives, point, argument, exact):
    """Largest error of a derivative, in units of what is allowed; `exact` are the taps."""
    dtype = point.taps.dtype.type
    if not np.all(np.isfinite(derivatives)):
        return np.nan
    slopes, (factor, largest) = exact_derivative(point, argument), allowance(point, exact)
    floor = DERIVATIVE_OF_TAP[dtype] * largest / mp.mpf(natural_scale(point, argument))
    allowed = factor * max(DERIVATIVE_OF_LARGEST[dtype] * max(abs(r) for r in slopes), floor)
    allowed = max(allowed, mp.mpf(float(np.finfo(dtype).tiny)))
    errors = [abs(mp.mpf(float(h)) - r) for h, r in zip(derivatives, slopes, strict=True)]
    return float(max(errors) / allowed)


def edge_at_vertex(point):
    """Whether a tap's edge lies on the vertex, where the derivative by position is infinite."""
    return point.frame == "vertex" and float(point.taps[0]).is_integer() and point.taps[0] <= 0


@partial(jax.jit, static_argnums=0)
def transfer_and_derivatives(make, arguments, frequencies, direction):
    """Transfer function, `(2, m)`, and derivatives by each of `TRANSFER_ARGUMENTS`, `(2, m, 6)`.

    Its real and its imaginary part are on the leading axis. Programs are shared as those of taps.
    """

    def along(step):
        *motion, parameters = arguments
        a, T, s, v = (x + step[i] for i, x in enumerate(motion))
        response = transfer_function(
            make(parameters + direction * step[5]),
            ParabolicMotion(acceleration=a, half_exposure=T, velocity=v),
            speed=s,
            frequency=frequencies + step[4],
        )
        return jnp.stack([response.real, response.imag])

    origin = jnp.zeros(len(TRANSFER_ARGUMENTS), frequencies.dtype)
    return along(origin), jax.jacfwd(along)(origin)


def transferred(point, frequencies):
    """What the package finds at a point: responses `(m,)` and derivatives `(m, 6)`."""
    direction = direction_of(point.parameters)
    make = SHUTTERS[point.slug].make
    parts = transfer_and_derivatives(make, _arguments(point), frequencies, direction)
    return [np.asarray(x[0], float) + 1j * np.asarray(x[1], float) for x in parts]


def _motion(point):
    """Acceleration, exposure and speed over the sensor; all but the speed exact."""
    return [float(x) for x in (point.acceleration, point.half_exposure, point.relative_speed)]


def _exact_response(point, frequency, window=None):
    a, T, _ = _motion(point)
    window = window or point.window
    return reference.transfer(window, a, T, point.relative_speed, float(frequency))


def transfer_error(point, frequencies):
    """Largest error of the transfer function, in units of what is allowed."""
    dtype, (a, T, _) = point.taps.dtype.type, _motion(point)
    found, _ = transferred(point, frequencies)
    exact = [_exact_response(point, f) for f in frequencies]
    errors = [float(abs(mp.mpc(complex(h)) - r)) for h, r in zip(found, exact, strict=True)]
    held = 2 * np.pi * np.abs(frequencies) * a * T * T * np.finfo(dtype).eps
    return float(np.max(np.array(errors) / (TRANSFER_ABSOLUTE[dtype] + held)))


def transfer_derivative_error(point, frequencies):
    """Largest error of a derivative of the transfer function, in units of what is allowed.

    Derivatives by the motion and the frequency are compared at each frequency, per natural unit
    of each; the shutter's, which does not grow with frequency, over all of them. One may be as
    small as what cancels in it, which is of the size of a response.
    """
    dtype, (a, T, s) = point.taps.dtype.type, _motion(point)
    _, found = transferred(point, frequencies)
    by_motion = [
        reference.transfer_derivatives(point.window, a, T, point.relative_speed, float(f))
        for f in frequencies
    ]
    by_motion = [row | {"velocity": -row["speed"]} for row in by_motion]
    exact = np.array([[complex(row[k]) for k in TRANSFER_ARGUMENTS[:-1]] for row in by_motion])
    size = np.array([natural_scale(point, k) for k in TRANSFER_ARGUMENTS[:4]])
    length = 1.0 if point.is_at_rest else a * T * T + abs(s) * T
    own = np.where(frequencies == 0, 1 / length, np.abs(frequencies).astype(float))
    units = np.column_stack([np.tile(size, (frequencies.size, 1)), own])
    relative, floor = DERIVATIVE_OF_LARGEST[dtype], DERIVATIVE_OF_TAP[dtype]
    # A rounding of the phase changes each term of a sum that is as large as the phase.
    phase = 2 * np.pi * np.abs(frequencies).astype(float)[:, None] * length
    floor = floor + phase**2 * np.finfo(dtype).eps
    largest = np.max(np.abs(exact * units), axis=1, keepdims=True)
    errors = [np.abs(found[:, :-1] - exact) * units / np.maximum(relative * largest, floor)]
    if point.parameters.size:
        direction = direction_of(point.parameters)
        row = _along(
            point,
            direction,
            lambda window: [_exact_response(point, f, window) for f in frequencies],
        )
        exact = np.array([complex(x) for x in row])
        allowed = max(relative * np.max(np.abs(exact)), np.max(floor))
        errors.append(np.abs(found[:, -1] - exact) / allowed)
    return max(float(np.max(error)) for error in errors)


def turning_point(rng, dtype, slug):
    """A point that turns on or near the sensor within the exposure, as long ones do."""
    stroke, T = 10 ** rng.uniform(-1, 3), dtype(10 ** rng.uniform(-3, 1))
    a = dtype(stroke / float(T) ** 2)
    gain = 2 * float(a) * float(T)
    s, v = dtype(gain * rng.choice([0.0, rng.uniform(-1.1, 1.1)])), dtype(0)
    pan = rng.spawn(1)[0]
    if pan.random() < PANNING_SHARE:
        s, v = panning(pan, float(s), gain, dtype)
    motion = {"acceleration": a, "half_exposure": T, "speed": s, "velocity": v}
    return replace(random_point(rng, dtype, slug), stroke=stroke, **motion)


def turning_frequencies(rng, point, count=6):
    """Frequencies at which the phase turns up to some hundreds of times, and 0."""
    cycles = 10 ** rng.uniform(-1, 2.0, count) * rng.choice([-1, 1], count)
    cycles[0] = 0
    return (cycles / point.stroke).astype(point.taps.dtype)


def random_frequencies(rng, point, count=6):
    """Frequencies of either sign, log-uniform, zero among them, that turn up to 900 times."""
    path = 2 * point.stroke + abs(float(point.relative_speed)) * float(point.half_exposure)
    highest = min(3.0, float(np.log10(450 / max(path, 1e-3))))
    sizes = 10 ** rng.uniform(highest - 9, highest, count) * rng.choice([-1, 1], count)
    return np.where(rng.random(count) < 0.1, 0.0, sizes).astype(point.taps.dtype)
