"""The kernel's identities, edge cases and errors; accuracy has a file of its own."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.cases import SHUTTERS
from support.programs import compiled_programs

from mishutter import (
    ChippedShutter,
    FreeMotion,
    GaussianShutter,
    HannShutter,
    ParabolicMotion,
    RectShutter,
    SplineShutter,
    StillCamera,
    TukeyShutter,
    binned_exposure,
    blur_kernel,
)

MASS_ULP_PER_THOUSAND = 4
"""Units in the last place by which a thousand taps may miss the efficiency."""
ROUNDING = 1e-13
"""Two compilations of one formula, or two formulae of a short sum."""

motion_of = jax.jit(
    lambda a, T, s, edges: binned_exposure(
        SHUTTERS["spline"].shutter(),
        ParabolicMotion(acceleration=a, half_exposure=T),
        speed=s,
        edges=edges,
    )
)


PARABOLA = ParabolicMotion(acceleration=7100.0, half_exposure=0.31)


@pytest.mark.parametrize(
    "motion",
    [PARABOLA, FreeMotion.fit(PARABOLA), StillCamera(half_exposure=0.31)],
    ids=["parabola", "free", "still"],
)
def test_a_known_support_takes_no_program(motion, caplog):
    """Also while another function is traced; it is that of a program."""
    traced = float(jax.jit(lambda x, s: x.kernel_length(s))(motion, 800.0))
    with compiled_programs(caplog) as programs:
        known = float(motion.kernel_length(np.asarray(800.0)))
    assert not programs
    np.testing.assert_allclose(known, traced, rtol=1e-13)
    times = jax.jit(lambda x: x * float(motion.kernel_length(np.asarray(800.0))))
    np.testing.assert_allclose(times(2.0), 2 * known, rtol=1e-13)


@pytest.mark.parametrize("slug", ["hann", "flutter", "spline"])
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_taps_sum_to_the_efficiency(slug, dtype):
    """Over the full support, within 4 ulp per thousand taps, none negative."""
    shutter = SHUTTERS[slug].shutter(dtype)
    motion = ParabolicMotion(acceleration=dtype(7100.0), half_exposure=dtype(0.31))
    taps = blur_kernel(shutter, motion, speed=dtype(800.0), num_taps=1100, phase=dtype(-0.3))
    efficiency = SHUTTERS[slug].shutter(dtype).efficiency().astype(dtype)
    total = np.sum(np.asarray(taps), dtype=np.longdouble)
    assert float(motion.kernel_length(dtype(800.0))) < 1099
    assert taps.dtype == dtype
    assert np.all(taps >= 0)
    assert abs(total - float(efficiency)) <= MASS_ULP_PER_THOUSAND * 1.1 * np.spacing(efficiency)


def test_a_million_taps():
    """In blocks, with the same result as the block alone and the right sum."""
    motion = ParabolicMotion(acceleration=9.1e5, half_exposure=1.0)
    taps = np.asarray(jax.jit(lambda: blur_kernel(HannShutter(), motion, num_taps=1_000_000))())
    assert abs(np.sum(taps) - 0.5) < 1e-12
    alone = blur_kernel(HannShutter(), motion, num_taps=50, phase=640_000.0)
    np.testing.assert_allclose(taps[640_000:640_050], alone, rtol=1e-12)


def test_no_acceleration_is_a_box():
    """An object of constant speed under a rect shutter; and the limit is smooth."""
    edges = np.array([-11.0, -7.3, -2.1, 0.4, 6.9, 9.0])
    still = binned_exposure(RectShutter(), StillCamera(half_exposure=0.5), speed=14.2, edges=edges)
    inside = np.clip(edges, -7.1, 7.1)
    np.testing.assert_allclose(still, np.diff(inside) / 14.2, rtol=1e-14)
    for a in (1e-300, 1e-30, 1e-17):
        motion = ParabolicMotion(acceleration=a, half_exposure=0.5)
        nearly = binned_exposure(RectShutter(), motion, speed=14.2, edges=edges)
        np.testing.assert_allclose(nearly, still, rtol=1e-13)


@pytest.mark.slow
def test_a_point_at_rest_falls_on_one_pixel():
    """A delta; its derivative by speed is finite."""
    edges = np.array([-1.5, -0.5, 0.5, 1.5])
    still = StillCamera(half_exposure=0.5)
    taps = binned_exposure(HannShutter(), still, speed=0.0, edges=edges)
    np.testing.assert_array_equal(taps, [0.0, 0.5, 0.0])
    slope = jax.jacfwd(lambda s: binned_exposure(HannShutter(), still, speed=s, edges=edges))(0.0)
    assert np.all(np.isfinite(slope))


@pytest.mark.slow
def test_frames_differ_by_the_vertex():
    """The vertex frame is the sensor frame moved by the vertex's position."""
    motion = ParabolicMotion(acceleration=310.0, half_exposure=0.31)
    vertex = -(57.0**2) / (4 * 310.0)
    for slug in ("flutter", "spline"):
        shutter = SHUTTERS[slug].shutter()
        kernel = blur_kernel(shutter, motion, speed=57.0, num_taps=40, phase=0.37)
        edges = np.arange(41.0) + 0.37 + vertex
        sensor = binned_exposure(shutter, motion, speed=57.0, edges=edges)
        np.testing.assert_allclose(kernel, sensor, atol=ROUNDING)


def test_symmetric_shutters_do_not_see_the_sign_of_the_speed():
    """The same vertex-frame kernel for +s and -s."""
    motion = ParabolicMotion(acceleration=310.0, half_exposure=0.31)
    for slug in ("gaussian", "spline-symmetric"):
        shutter = SHUTTERS[slug].shutter()
        there, back = (
            blur_kernel(shutter, motion, speed=s, num_taps=50, phase=-0.2) for s in (41.0, -41.0)
        )
        np.testing.assert_allclose(there, back, atol=ROUNDING)


@pytest.mark.slow
def test_closed_shutters_and_edges_off_the_path():
    """Nothing falls where nothing passes, and repeated edges hold nothing."""
    motion = ParabolicMotion(acceleration=310.0, half_exposure=0.31)
    closed = ChippedShutter(np.zeros(6))
    assert not np.any(blur_kernel(closed, motion, speed=3.0, num_taps=40))
    far = np.array([1e3, 1e3, 2e5, 1e300])
    assert not np.any(binned_exposure(HannShutter(), motion, speed=3.0, edges=far))
    edges = np.array([-1e300, 2.0, 2.0, np.nextafter(2.0, 3.0), 1e300])
    taps = binned_exposure(HannShutter(), motion, speed=3.0, edges=edges)
    assert taps[1] == 0
    assert taps[2] > 0
    np.testing.assert_allclose(np.sum(taps), 0.5, rtol=1e-15)


def test_derivative_at_the_vertex_is_from_below():
    """An edge exactly on the vertex: the infinite share is left out, the rest is there."""
    motion = ParabolicMotion(acceleration=45.0, half_exposure=1.0)
    slope = jax.jacfwd(lambda p: blur_kernel(HannShutter(), motion, num_taps=5, phase=p))(0.0)
    assert np.all(np.isfinite(slope))
    assert slope[0] > 0


@pytest.mark.slow
def test_forward_and_reverse_mode_agree():
    """To 1e-12, by motion, speed, edges and the shutter's parameters."""
    edges = jnp.linspace(-7.0, 40.0, 12)

    def taps(x, shift, parameters):
        motion = ParabolicMotion(acceleration=x[0], half_exposure=x[1])
        return binned_exposure(SplineShutter(parameters), motion, speed=x[2], edges=edges + shift)

    point = jnp.array([310.0, 0.31, 41.0]), jnp.full(12, 0.1), jnp.linspace(0.1, 0.9, 8)
    forward = jax.jit(jax.jacfwd(taps, argnums=(0, 1, 2)))(*point)
    reverse = jax.jit(jax.jacrev(taps, argnums=(0, 1, 2)))(*point)
    for f, r in zip(forward, reverse, strict=True):
        np.testing.assert_allclose(f, r, atol=1e-12 * np.max(np.abs(f)))


@pytest.mark.slow
@pytest.mark.parametrize("phase", [-0.3, 1200.4, 2.9e7])
def test_forward_and_reverse_mode_agree_by_phase(phase):
    """To 1e-12, also where taps are so narrow that their edges' derivatives all but cancel."""
    motion = ParabolicMotion(acceleration=30.0, half_exposure=1.0)

    def taps(x):
        return blur_kernel(RectShutter(), motion, speed=6e4, num_taps=16, phase=x)

    forward, reverse = jax.jacfwd(taps)(phase), jax.jacrev(taps)(phase)
    np.testing.assert_allclose(forward, reverse, atol=1e-12 * np.max(np.abs(forward)))


def test_a_count_may_be_an_integer_of_numpy():
    """It is a shape, so it must not become an array on the way."""
    motion = ParabolicMotion(acceleration=30.0, half_exposure=1.0)
    counted = blur_kernel(HannShutter(), motion, num_taps=np.int64(40))
    np.testing.assert_array_equal(counted, blur_kernel(HannShutter(), motion, num_taps=40))
    half = SplineShutter([0.2, 0.9, 1.0], symmetric=True, num_coefficients=np.int64(5))
    assert type(half.num_coefficients) is int


@pytest.mark.parametrize("share", [-1.0, 1.0, 0.37, 0.0])
@pytest.mark.parametrize("taper", [0.0, 1e-20, 1e-17])
def test_a_taper_shorter_than_a_rounding_loses_no_light(taper, share):
    """A Tukey window of no taper is a rect, also where an end is crossed at the vertex."""
    a, T = 7441.804498378646, 0.06663706372079768
    edges = jnp.linspace(-132.1812797448222, 132.1812797448222, 4)

    def kernel(shutter):
        motion = ParabolicMotion(acceleration=a, half_exposure=T)
        return binned_exposure(shutter, motion, speed=2 * a * T * share, edges=edges)

    np.testing.assert_allclose(kernel(TukeyShutter(taper)), kernel(RectShutter()), atol=ROUNDING)


def test_vmap_and_jit_change_nothing_and_trace_once():
    """One trace a shape; batches and single evaluations agree to rounding."""
    edges = jnp.linspace(-7.0, 40.0, 12)

    @eqx.debug.assert_max_traces(max_traces=1)
    def row(speed, a):
        motion = ParabolicMotion(acceleration=a, half_exposure=0.31)
        return binned_exposure(HannShutter(), motion, speed=speed, edges=edges)

    speeds = jnp.array([0.0, -33.0, 410.0])
    batch = jax.jit(jax.vmap(row, in_axes=(0, None)))(speeds, jnp.asarray(310.0))
    single = jax.jit(eqx.debug.assert_max_traces(row.__wrapped__, max_traces=1))
    for speed, expected in zip(speeds, batch, strict=True):
        np.testing.assert_allclose(single(speed, jnp.asarray(310.0)), expected, atol=ROUNDING)
        motion = ParabolicMotion(acceleration=310.0, half_exposure=0.31)
        plain = binned_exposure(HannShutter(), motion, speed=speed, edges=edges)
        np.testing.assert_allclose(plain, expected, atol=ROUNDING)


SIZES = st.just(0.0) | st.floats(1e-12, 1e8) | st.floats(5e-324, 1e-300)


@pytest.mark.slow
@given(
    stroke=SIZES,
    half_exposure=st.floats(1e-9, 1e5),
    smear=SIZES,
    edges=st.lists(st.floats(-1e9, 1e9), min_size=5, max_size=5),
)
@settings(max_examples=150, deadline=None)
def test_any_motion_and_edges_give_taps(stroke, half_exposure, smear, edges):
    """Finite, none negative, never more than the shutter lets through."""
    a, s = stroke / half_exposure**2, smear / half_exposure
    taps = np.asarray(motion_of(a, half_exposure, s, np.sort(np.array(edges))))
    assert np.all(np.isfinite(taps))
    assert np.all(taps >= 0)
    assert np.sum(taps) <= float(SHUTTERS["spline"].shutter().efficiency()) * (1 + 1e-14)


MOTION = ParabolicMotion(acceleration=3.0, half_exposure=2.0)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: blur_kernel(HannShutter(), MOTION, num_taps=0), "must be a positive integer"),
        (
            lambda: blur_kernel(HannShutter(), MOTION, num_taps=3, speed=np.nan),
            r"blur_kernel\(speed=...\)` must be finite",
        ),
        (
            lambda: blur_kernel(HannShutter(), MOTION, num_taps=3, phase=np.inf),
            r"blur_kernel\(phase=...\)` must be finite",
        ),
        (
            lambda: blur_kernel(HannShutter(), MOTION, num_taps=3, phase=np.zeros(2)),
            "must be a scalar",
        ),
        (
            lambda: binned_exposure(HannShutter(), MOTION, speed=0.0, edges=np.array([1.0])),
            "must hold at least two edges",
        ),
        (
            lambda: binned_exposure(HannShutter(), MOTION, speed=0.0, edges=np.ones((2, 2))),
            "must be one row",
        ),
        (
            lambda: binned_exposure(HannShutter(), MOTION, speed=0.0, edges=np.array([1.0, 0.0])),
            "must ascend",
        ),
        (
            lambda: binned_exposure(
                HannShutter(), MOTION, speed=0.0, edges=np.array([0.0, np.nan])
            ),
            "must be finite",
        ),
        (
            lambda: binned_exposure(
                HannShutter(), MOTION, speed=np.ones(2), edges=np.array([0.0, 1.0])
            ),
            "must be a scalar",
        ),
        (lambda: ParabolicMotion(acceleration=-1.0, half_exposure=1.0), "must be at least 0 px/s"),
        (lambda: ParabolicMotion(acceleration=1.0, half_exposure=0.0), "must be above 0 s"),
        (lambda: ParabolicMotion(acceleration=np.nan, half_exposure=1.0), "must be finite"),
        (lambda: StillCamera(half_exposure=-2.0), "must be above 0 s"),
        (lambda: GaussianShutter(np.nan), "must lie in"),
    ],
)
def test_wrong_arguments_are_named(call, message):
    """One sentence with the argument, what must hold and what came."""
    with pytest.raises(ValueError, match=message):
        call()


def _weighed(taper, speed, phase):
    """A number that every tap of a kernel decides."""
    motion = ParabolicMotion(acceleration=1.1e5, half_exposure=9.3e-3)
    options = {"speed": speed, "phase": phase, "num_taps": 23}
    return jnp.cos(1.3 * jnp.arange(23.0)) @ blur_kernel(TukeyShutter(taper), motion, **options)


@pytest.mark.slow
def test_second_derivatives_by_what_moves_a_crossing_or_a_breakpoint():
    """By taper, speed and phase, in any order, are differences of first ones."""
    slope, point = jax.jit(jax.grad(_weighed, (0, 1, 2))), jnp.array([0.43, 310.0, -0.2])
    found = np.array(jax.jit(jax.jacrev(slope, (0, 1, 2)))(*point))
    steps = np.diag([1e-5, 1e-2, 1e-5])
    pairs = [np.subtract(slope(*(point + x)), slope(*(point - x))) / (2 * x.sum()) for x in steps]
    unit = np.array([1.0, 1e3, 1.0])
    differences = np.array(pairs) * np.outer(unit, unit)
    largest = np.max(np.abs(differences))
    np.testing.assert_allclose(found * np.outer(unit, unit), differences, atol=1e-6 * largest)


@pytest.mark.slow
def test_second_derivative_by_a_profile():
    """One that moves no breakpoint has it."""
    motion = ParabolicMotion(acceleration=1.1e5, half_exposure=9.3e-3)

    def weighed(sigma):
        kernel = blur_kernel(GaussianShutter(sigma), motion, speed=310.0, num_taps=23)
        return jnp.cos(1.3 * jnp.arange(23.0)) @ kernel

    slope = jax.grad(weighed)
    differences = (slope(0.37 + 1e-5) - slope(0.37 - 1e-5)) / 2e-5
    np.testing.assert_allclose(jax.grad(slope)(0.37), differences, rtol=1e-7)
