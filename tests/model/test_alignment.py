"""Where objects lie on the sensor, by motions of every kind and by light beside it."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.cases import MOTIONS

from mishutter import FreeMotion, HannShutter, ParabolicMotion, blur_kernel
from mishutter.model.alignment import length_on_parabola

SPEEDS = np.array([-61.0, 0.0, 23.0, 140.0])
TAU = np.linspace(-1, 1, 41)
HALF = 0.31


@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)
def test_objects_move_against_the_path_of_the_sensor(motion):
    """`position_of` is $x(t) - s t$, and `aligned_position` that from the `alignment` on."""
    motion = motion()
    half = float(motion.half_exposure)
    path = motion.position(TAU * half) - SPEEDS[:, None] * TAU * half
    found = motion.position_of(TAU[None], SPEEDS[:, None])
    np.testing.assert_allclose(found, path, atol=1e-13 * np.max(np.abs(path)))
    aligned = motion.aligned_position(TAU[None], SPEEDS[:, None])
    wanted = path - motion.alignment(SPEEDS)[:, None]
    np.testing.assert_allclose(aligned, wanted, atol=1e-13 * np.max(np.abs(wanted)))


def test_a_path_of_one_acceleration_is_the_parabola():
    """Alignment and kernels of all speeds, those that the sensor falls behind among them, agree."""
    parabola = ParabolicMotion(acceleration=310.0, half_exposure=HALF, velocity=17.0)
    path = FreeMotion(accelerations=[310.0] * 3, half_exposure=HALF, velocity=17.0)
    speeds = np.array([-330.0, -61.0, 0.0, 23.0, 140.0, 209.2, 460.0])
    close = {"rtol": 1e-12, "atol": 1e-12}
    for name in ("alignment", "lowest", "highest", "kernel_length"):
        one, other = getattr(parabola, name)(speeds), getattr(path, name)(speeds)
        np.testing.assert_allclose(other, one, **close, err_msg=name)
    still = parabola.without_velocity(), path.without_velocity()
    ends = np.array([-340.0, 0.0, 340.0])
    np.testing.assert_allclose(*(motion.greatest_travel(ends) for motion in still), **close)
    assert parabola.mirrors
    assert path.mirrors
    assert float(path.bend) == pytest.approx(float(parabola.bend), rel=1e-14)


def test_the_number_of_pieces_decides_and_no_class():
    """One piece is the parabola to the bit, from a vertex beyond the exposure too."""
    parabola = ParabolicMotion(acceleration=310.0, half_exposure=HALF, velocity=17.0)
    piece = FreeMotion(accelerations=[310.0], half_exposure=HALF, velocity=17.0)
    assert piece.accelerates_constantly
    assert piece.fixed == parabola.fixed
    for name in ("sag", "stroke", "speed_gain", "top_speed", "bend", "mean_acceleration"):
        assert getattr(piece, name) == getattr(parabola, name), name
    speeds = np.array([-330.0, 0.0, 140.0, 460.0])[:, None]
    np.testing.assert_array_equal(
        piece.aligned_position(TAU[None], speeds), parabola.aligned_position(TAU[None], speeds)
    )
    first, other = (
        blur_kernel(HannShutter(), motion, speed=330.0, num_taps=210)
        for motion in (piece, parabola)
    )
    np.testing.assert_array_equal(first, other)
    assert not np.any(first[:11])
    assert np.sum(first) == pytest.approx(0.5, rel=1e-12)


def test_numbers_of_stacked_parabolas_are_those_of_each():
    """Of a row of them, as a sweep makes it, the mirror image of one among them."""
    rows = np.array([310.0, 0.0, -95.0]), np.array([0.31, 0.2, 0.7]), np.array([17.0, -80.0, 3.0])
    one = ParabolicMotion(acceleration=1.0, half_exposure=1.0)

    def numbers(*row):
        motion = eqx.tree_at(lambda m: (m.acceleration, m.half_exposure, m.velocity), one, row)
        names = "sag stroke speed_gain top_speed greatest_acceleration bend turn has_vertex"
        return [np.asarray(getattr(motion, name), float) for name in names.split()]

    together = numbers(*rows)
    for index, row in enumerate(zip(*rows, strict=True)):
        each = numbers(*(np.asarray(number) for number in row))
        np.testing.assert_allclose([x[index] for x in together], each, rtol=1e-14)


@pytest.mark.parametrize(("sag", "smear"), [(0.0, 7.3), (3.1, 7.3), (3.1, 2.2)])
def test_light_reaches_as_far_as_the_fastest_object(sag, smear):
    """Over the whole exposure: to both sides of a sensor at rest, from the lowest place on."""
    tau, speeds = np.linspace(-1, 1, 2001), np.linspace(-smear, smear, 201)[:, None]
    travelled = np.max(np.ptp(sag * tau**2 - speeds * tau, axis=1))
    found = length_on_parabola(np.asarray(sag), np.asarray(smear))
    assert float(found) == pytest.approx(travelled, rel=1e-6)


MIRRORED = {
    "parabolic": lambda: ParabolicMotion(acceleration=310.0, half_exposure=HALF, velocity=17.0),
    "free": MOTIONS["free"],
}


@pytest.mark.parametrize("motion", MIRRORED.values(), ids=MIRRORED)
def test_a_mirrored_path_is_aligned_at_the_mirror_image(motion):
    """Objects of the opposite speed lie opposite, by known numbers and by traced ones.

    Known numbers make no mirrored parabola.
    """
    motion = motion()
    rising = motion.aligned_position(TAU[None], SPEEDS[:, None])
    falling = jax.jit(lambda m, s: m.mirrored(-1.0).aligned_position(TAU[None], -s[:, None]))
    np.testing.assert_allclose(falling(motion, SPEEDS), -rising, atol=1e-10)
    assert -1e-10 < np.min(rising) < 1e-4 * np.max(rising)
    lengths = jax.jit(lambda m, s: m.mirrored(-1.0).kernel_length(s))(motion, -SPEEDS)
    np.testing.assert_allclose(lengths, motion.kernel_length(SPEEDS), rtol=1e-12)
    for name in ("sag", "stroke", "speed_gain", "top_speed", "greatest_acceleration", "bend"):
        number = jax.jit(lambda m, name=name: getattr(m.mirrored(-1.0), name))(motion)
        assert number == pytest.approx(float(getattr(motion, name)), rel=1e-12), name


def test_a_path_that_is_as_fast_at_both_ends_is_aligned_at_its_lowest():
    """Whatever rounding makes of the sum of its accelerations."""
    path = FreeMotion(accelerations=[0.1, 0.2, -0.3], half_exposure=3.1)
    assert sum([0.1, 0.2, -0.3]) != 0
    for sign in (1.0, -1.0):
        own = path.mirrored(sign)
        np.testing.assert_array_equal(own.alignment(SPEEDS), own.lowest(SPEEDS))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("speed", [-1e7, -81.0, 0.0, 12.0, 1e-30, 3e9])
def test_alignment_loses_no_digits(dtype, speed):
    """Where the sensor falls behind by far as well, and its derivative has no gap in between."""
    half, a = dtype(0.01), dtype(4e3)
    motion = ParabolicMotion(acceleration=a, half_exposure=half)
    tau = np.array([[-1.0, -0.75, -0.125, 0.5, 1.0]], dtype)
    sag, smear = a.astype(float) * float(half) ** 2, float(dtype(speed)) * float(half)
    turn = np.clip(smear / (2 * sag), -1, 1)
    wanted = (tau - turn) * (sag * (tau + turn) - smear)
    found = motion.aligned_position(tau, np.array([[speed]], dtype))
    assert found.dtype == dtype
    np.testing.assert_allclose(found, wanted, rtol=8 * np.finfo(dtype).eps, atol=sag * 4e-7)
    end = 2 * float(a) * float(half)
    slope = jax.grad(lambda s: motion.alignment(s))
    before, after = (float(slope(jnp.asarray(end * x, dtype))) for x in (1 - 1e-6, 1 + 1e-6))
    assert before == pytest.approx(after, rel=1e-5)
    assert after == pytest.approx(-float(half), rel=1e-6)
