"""Sums of waves against the sums themselves, and spectra on other steps against their power."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mishutter.blur.waves import sum_of_waves, waves_on_dft
from mishutter.model.optics import frequencies, on_steps

COUNTS = [(256, 256), (384, 384), (1024, 96), (256, 33), (64, 1), (4096, 4096)]
DISTANCES = [3.0, 180.0, 900.0, 9000.0]


def _points(distance, dtype=np.float64):
    random = np.random.default_rng(int(distance))
    position = random.uniform(-0.4, 1, (3, 211)) * distance
    return position.astype(dtype), random.normal(size=(1, 211)).astype(dtype)


def _waves(position, num_frequencies, num_kept):
    frequency = frequencies(num_frequencies)[:num_kept]
    turns = frequency[None, :, None] * position.astype(np.float64)[:, None]
    return frequency, np.exp(-2j * np.pi * turns)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("distance", DISTANCES)
@pytest.mark.parametrize("counts", COUNTS)
def test_sums_are_those_of_the_waves(counts, distance, dtype):
    """Of few frequencies and of many, on a fraction of a period and over many of them."""
    position, light = _points(distance, dtype)
    waves = _waves(position, *counts)[1]
    found = jax.jit(sum_of_waves, static_argnums=(2, 3))(position, light, *counts)
    assert found.dtype == np.result_type(dtype, np.complex64)
    error = np.max(np.abs(np.asarray(found) - np.sum(light[:, None] * waves, axis=2)))
    # Angles of many turns are known to as many roundings.
    allowed = np.finfo(dtype).eps * (40 + distance)
    assert error < allowed * np.sum(np.abs(light))


@pytest.mark.slow
@pytest.mark.parametrize("counts", COUNTS)
def test_derivatives_are_those_of_the_sums(counts):
    """By positions and by light, forward; reverse mode is its transpose."""
    random = np.random.default_rng(2)
    position, light = _points(300.0)
    moved, lit = random.normal(size=position.shape), random.normal(size=light.shape)
    frequency, waves = _waves(position, *counts)
    turn = (-2j * np.pi * frequency)[None, :, None]
    exact = np.sum((lit[:, None] + turn * (light * moved)[:, None]) * waves, axis=2)

    def sums(x, y):
        return sum_of_waves(x, y, *counts)

    given = jnp.asarray(position), jnp.asarray(light)
    slopes = jax.jit(lambda *x: jax.jvp(sums, given, x)[1])(moved, lit)
    np.testing.assert_allclose(slopes, exact, rtol=0, atol=1e-12 * np.max(np.abs(exact)))
    weight = jnp.asarray(random.normal(size=exact.shape))
    slope = jax.jit(jax.grad(lambda *x: jnp.sum(weight * sums(*x).real), (0, 1)))
    by_position, by_light = slope(*given)
    reverse = np.sum(by_position * moved) + np.sum(by_light * lit)
    np.testing.assert_allclose(reverse, np.sum(weight * exact.real), rtol=1e-10)


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize(("length", "count"), [(2, 2), (97, 49), (360, 181), (360, 5), (1, 1)])
def test_waves_on_the_grid_of_a_dft(length, count, dtype):
    """Of any length, with one light for all rows of positions; NumPy's arrays stay NumPy's."""
    position, light = _points(180.0, dtype)
    turns = np.arange(count)[None, :, None] / length * position.astype(np.float64)[:, None]
    wanted = np.sum(light[:, None] * np.exp(-2j * np.pi * turns), axis=2)
    allowed = np.finfo(dtype).eps * (40 + 180) * np.sum(np.abs(light))
    known = waves_on_dft(position, light, length, count)
    assert isinstance(known, np.ndarray)
    traced = jax.jit(waves_on_dft, static_argnums=(2, 3))(position, light, length, count)
    for found in (known, traced):
        assert found.dtype == np.result_type(dtype, np.complex64)
        np.testing.assert_allclose(found, wanted, rtol=0, atol=allowed)


def test_positions_past_all_numbers_stay_on_the_grid():
    """Their waves mean nothing, and harm no others."""
    position, light = jnp.asarray([[1e300, -1e40, 7.3]]), jnp.asarray([[0.0, 0.0, 2.0]])
    alone = sum_of_waves(position[:, 2:], light[:, 2:], 64, 64)
    np.testing.assert_allclose(sum_of_waves(position, light, 64, 64), alone, rtol=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize("numpy", [True, False])
@pytest.mark.parametrize(("known", "factor"), [(256, 2), (256, 12), (7, 3), (1, 16)])
def test_finer_steps_hold_each_step_s_power(known, factor, numpy):
    """Steps that a step is cut into have its power together, and none of them less than 0."""
    random = np.random.default_rng(known)
    power = random.uniform(0, 1, known) ** 6 * (random.random(known) < 0.8) + (known == 1)
    found = np.asarray(on_steps(power if numpy else jnp.asarray(power), factor * known))
    assert np.all(found >= 0)
    np.testing.assert_allclose(
        found.reshape(known, factor).mean(axis=1), power, rtol=1e-13, atol=1e-15
    )


@pytest.mark.parametrize("count", [384, 96, 100])
def test_steps_that_overlap_lose_no_power(count):
    """Where ends of steps do not meet, the mean over all of them stays."""
    power = np.random.default_rng(5).uniform(0, 1, 256) ** 4
    assert np.mean(on_steps(power, count)) == pytest.approx(np.mean(power), rel=1e-13)


def test_a_smooth_spectrum_stays_smooth():
    """Between steps of a steep one: a few thousandths off where straight lines are a tenth."""
    steep = 1 / (frequencies(4096) ** 2 + 0.03**2)
    found = on_steps(steep.reshape(256, 16).mean(axis=1), 4096)
    assert np.max(np.abs(found / steep - 1)[16:-16]) < 6e-3


def test_a_program_asks_for_full_precision():
    """Products of matrices in single precision would else be of three digits on a GPU."""
    position, weight = (jnp.asarray(x) for x in _points(180.0, np.float32))
    program = jax.make_jaxpr(lambda x, w: waves_on_dft(x, w, 97, 49))(position, weight)
    assert "HIGHEST" in str(program)
