"""Taps and their derivatives against 300-digit references over the whole domain.

A short sweep of one shutter runs always; the full one, 400 points a precision, is slow. Seeds
are fixed, so a failure names its point and can be repeated.
"""

import itertools

import jax
import numpy as np
import pytest
from support.cases import SHUTTERS
from support.helpers import (
    ARGUMENTS,
    DERIVATIVE_OF_LARGEST,
    NUM_TAPS,
    REST_STROKES,
    TAP_OF_LARGEST,
    Point,
    computed,
    derivative_error,
    direction_of,
    edge_at_vertex,
    exact_taps,
    random_point,
    tap_error,
)

FULL_SWEEP = 400
"""Points a precision, shared out among the shutters."""
DTYPES = {"float64": np.float64, "float32": np.float32}

CORPUS = {
    "a branch's end, of a slow object": (
        "flutter sensor float32",
        (5765.2217, 0.12375513, -0.018968461),
        "87.63766 87.745575 87.84615 87.86455 87.938065 88.05675 88.07994 88.16602 88.17286 "
        "88.243195 88.331215 88.57129 88.66878 88.67334 88.72473 88.92164 88.92699",
    ),
    "adjacent open chips": (
        "flutter sensor float32",
        (1.0566539e06, 0.0004222746, 426.88516),
        "-0.0010864949 -0.0008411765 -0.0008014052 -0.0006598674 -0.0002562643 -0.0002087851 "
        "0.0004830687 0.0013189642 0.0014962852 0.002172854 0.002521659 0.0025579205 "
        "0.0025820849 0.0026033923 0.0026341972 0.0028316467 0.002864627",
    ),
    "a knot at mid-exposure of a fast object": (
        "spline-symmetric sensor float32",
        (3.6033143e-07, 0.015700633, -6.9390135e-06),
        "-7.314071e-10 -7.0404843e-10 -6.7273775e-10 -6.1646266e-10 -6.1509814e-10 "
        "-3.3305822e-10 -1.6944128e-10 1.6191846e-10 1.8076153e-10 1.8168521e-10 3.580676e-10 "
        "3.628115e-10 4.1518822e-10 4.3535048e-10 4.725535e-10 6.6077926e-10 6.6406347e-10",
    ),
    "a taper that ends at the vertex": (
        "tukey sensor float32",
        (11412.615, 0.23355962, 3038.6997),
        "-202.31102 -202.30772 -202.30629 -202.3007 -202.29378 -202.28355 -202.28046 -202.27533 "
        "-202.27092 -202.26965 -202.24652 -202.24536 -202.24345 -202.23969 -202.23619 "
        "-202.23329 -202.2205",
    ),
    "a chip that holds the vertex": (
        "one-open-chip sensor float32",
        (4.9429634e-11, 1.3175808, 5.5823606e-11),
        "-7.8862854e-11 -7.83518e-11 -6.971284e-11 -5.9889205e-11 -4.2684502e-11 -1.4285474e-11 "
        "-1.118872e-11 -6.671178e-12 -4.8104598e-12 -1.9518094e-12 1.0638714e-11 2.269495e-11 "
        "2.6431796e-11 4.072423e-11 4.4740125e-11 7.023698e-11 7.766367e-11",
    ),
    "a slow object under a smooth profile": (
        "gaussian sensor float32",
        (1.52709e-14, 6880.408, 1.262699e-15),
        "7.172903e-07 7.1779067e-07 7.1784484e-07 7.186063e-07 7.191869e-07 7.1983305e-07 "
        "7.2051284e-07 7.213602e-07 7.2206325e-07 7.225901e-07 7.2370585e-07 7.238655e-07 "
        "7.248054e-07 7.260553e-07 7.2639557e-07 7.279605e-07 7.279867e-07",
    ),
}
"""Points that once missed a bound, by what they have in common: acceleration, exposure, speed
and edges (or the phase)."""


def check(point, arguments=ARGUMENTS):
    dtype = point.taps.dtype.type
    taps, derivatives = computed(point)
    exact = exact_taps(point)
    assert taps.dtype == dtype
    assert np.all(taps >= 0), point
    assert tap_error(taps, point, exact) <= 1, point
    for argument in arguments:
        if argument == "position" and edge_at_vertex(point):
            continue
        if argument == "velocity" and point.velocity == 0:
            continue
        column = derivatives[:, ARGUMENTS.index(argument)]
        assert derivative_error(column, point, argument, exact) <= 1, (argument, point)


@pytest.mark.parametrize(
    "slug",
    ["hann", *(pytest.param(slug, marks=pytest.mark.slow) for slug in ("flutter", "spline"))],
)
def test_taps_and_derivatives(slug):
    """Taps and their derivatives by every argument, at 20 points of each kind of shutter."""
    rng = np.random.default_rng(11)
    for _ in range(20):
        check(random_point(rng, np.float64, slug))


@pytest.mark.slow
@pytest.mark.parametrize("name", CORPUS)
def test_points_that_missed_once(name):
    """Taps and their derivatives by every argument, where long times all but cancel."""
    kind, motion, taps = CORPUS[name]
    slug, frame, precision = kind.split()
    dtype = DTYPES[precision]
    a, T, s = (dtype(x) for x in motion)
    stroke = float(a) * float(T) ** 2
    check(Point(slug, stroke, a, T, s, np.array(taps.split(), dtype), frame))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("slug", "precision"),
    list(zip(SHUTTERS, itertools.cycle(DTYPES), strict=False)),
)
def test_objects_at_rest(slug, precision):
    """All light on the tap that holds position 0, with no derivative but the shutter's."""
    dtype, T = DTYPES[precision], DTYPES[precision](0.0173)
    parameters = SHUTTERS[slug].parameters.astype(dtype)
    direction = direction_of(parameters)

    def efficiency(parameters):
        return SHUTTERS[slug].make(parameters).efficiency().astype(dtype)

    light, brighter = jax.jvp(efficiency, (parameters,), (direction,))
    for stroke, phase in itertools.product(REST_STROKES, (-3.0, -2.3, -0.5, 0.0, 0.4)):
        a, first = dtype(stroke / float(T) ** 2), np.array([phase], dtype)
        s = dtype(0 if phase else 1 / 3)  # of an object that the sensor keeps up with
        point = Point(slug, stroke, a, T, s, first, "vertex", velocity=s)
        taps, derivatives = computed(point)
        lit = (np.arange(NUM_TAPS) == np.floor(-phase)).astype(dtype)
        np.testing.assert_allclose(taps, lit * light, rtol=TAP_OF_LARGEST[dtype])
        by_shutter = derivatives[:, ARGUMENTS.index("shutter")]
        np.testing.assert_allclose(by_shutter, lit * brighter, atol=DERIVATIVE_OF_LARGEST[dtype])
        assert not np.any(derivatives[:, : ARGUMENTS.index("shutter")])


@pytest.mark.slow
@pytest.mark.parametrize("precision", DTYPES)
def test_gaussians_about_as_narrow_as_the_drift(precision):
    """Taps and derivatives, from the middle of the profile out into its tail."""
    dtype, rng = DTYPES[precision], np.random.default_rng(4)
    for sigma in np.geomspace(0.03, 0.15, 12):
        stroke, T = 10 ** rng.uniform(0.5, 3.4), dtype(10 ** rng.uniform(-3, 0))
        a = dtype(stroke / float(T) ** 2)
        s = dtype(2 * float(a) * float(T) * sigma * rng.uniform(0.1, 1.0))
        start = rng.choice([-0.5, 0.37 * stroke * sigma**2, 9 * stroke * sigma**2])
        check(
            Point(
                "gaussian-narrow",
                stroke,
                a,
                T,
                s,
                np.array([start], dtype),
                "vertex",
                np.array(sigma),
            )
        )


@pytest.mark.slow
@pytest.mark.parametrize("precision", DTYPES)
@pytest.mark.parametrize("slug", SHUTTERS)
def test_taps_and_derivatives_over_the_domain(slug, precision):
    """The full sweep: every tap, and on each tenth point every derivative."""
    rng = np.random.default_rng(2)
    for index in range(FULL_SWEEP // len(SHUTTERS) + 1):
        point = random_point(rng, DTYPES[precision], slug)
        check(point, ARGUMENTS if index % 10 == 0 else ())
