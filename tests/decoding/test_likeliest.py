"""What frames tell before a motion is looked for, and the likeliest picture of some."""

import numpy as np
import pytest

from mishutter import Scene
from mishutter.decoding.likeliest import (
    Canvas,
    _together,
    complete,
    detail_of,
    fit_of,
    likeliest,
    noises_of,
    volume_of,
)


@pytest.mark.parametrize("shape", [(1024,), (256, 1024)])
def test_detail_is_told_where_it_is(shape):
    """Pictures with 0.1/f of the expected power at the frequency f, in two frames with noise."""
    random = np.random.default_rng(5)
    down, across = np.fft.fftfreq(256)[:, None], np.fft.rfftfreq(1024)
    radius = np.hypot(down, across) if len(shape) == 2 else across[None]
    white = np.fft.rfft2(random.normal(size=(256, 1024)))
    picture = np.fft.irfft2(white * np.sqrt(0.1 / np.maximum(radius, 1e-3)), (256, 1024))
    noises = np.array([0.2, 0.5])
    frames = picture + np.sqrt(noises)[:, None, None] * random.normal(size=(2, 256, 1024))
    expected = np.full((*shape[:-1], 513), np.sum(1 / noises))
    told = detail_of(frames, noises, shape, expected, 0.04)
    assert told.radius.size >= 5
    np.testing.assert_allclose(told.scale, 0.1 / told.radius, rtol=0.15)


def test_the_likeliest_picture_solves_the_normal_equations():
    """Of two frames of unequal noise, on a canvas of unequal sides that reaches beyond them."""
    random, shape, noises = np.random.default_rng(6), (9, 14), np.array([0.2, 0.7])
    down, across = np.fft.fftfreq(9)[:, None], np.fft.rfftfreq(14)
    power = 1 / (0.3 + 40 * down**2 + 9 * across**2)
    canvas = Canvas(random.normal(size=(2, 6, 10)), noises, power, (1, 3), shape)
    responses = canvas.spectrum(random.normal(size=(2, *shape)) * np.array([[[0.3]], [[0.1]]]))
    units = canvas.spectrum(np.eye(126).reshape(126, *shape))
    seen = [canvas.seen(units * one).reshape(126, -1).T for one in responses]
    prior = canvas.picture(units / power).reshape(126, -1)
    normal = prior + sum(a.T @ a / n for a, n in zip(seen, noises, strict=True))
    each = zip(seen, canvas.frames, noises, strict=True)
    target = sum(a.T @ frame.ravel() / n for a, frame, n in each)
    found = likeliest(canvas, responses, tolerance=1e-10)
    expected = np.linalg.solve(normal, target)
    np.testing.assert_allclose(found.picture.ravel(), expected, atol=1e-9)
    assert float(found.gains) == pytest.approx(target @ expected / 2)
    # Beside one that is found at once it is found as well.
    both = likeliest(canvas, np.stack([1e-9 * responses, responses], axis=1), tolerance=1e-10)
    np.testing.assert_allclose(both.picture[1].ravel(), expected, atol=1e-9)
    # What frames go on as tells the same picture, by all of the canvas.
    density = np.sum(np.abs(responses) ** 2 / noises[:, None, None], axis=0)
    np.testing.assert_allclose(found.density, density)
    whole = (density + 1 / power) * found.spectrum
    np.testing.assert_allclose(complete(found), whole, atol=1e-6 * np.max(np.abs(whole)))
    np.testing.assert_allclose(
        complete(found, 3 * density)[1:], (whole + 2 * density * found.spectrum)[1:]
    )


def test_waves_of_most_power_are_found_at_once():
    """Some of two pictures, by the matrix that the sensor's borders leave of them."""
    random, shape, noises = np.random.default_rng(8), (24, 33), np.array([0.2, 0.7])
    down, across = np.fft.fftfreq(24)[:, None], np.fft.rfftfreq(33)
    power = 1 / (1e-3 + down**2 + 0.5 * across**2)
    canvas = Canvas(random.normal(size=(2, 13, 20)), noises, power, (4, 6), shape)
    responses = canvas.spectrum(random.normal(size=(2, 2, *shape)))
    light = canvas.spectrum(random.normal(size=(2, *shape)))
    light[:, power < np.sort(power, axis=None)[-40]] = 0.0
    told = canvas.gathered(responses, canvas.through(responses, light))
    found = _together(canvas, responses, 99)(told + light / power)
    np.testing.assert_allclose(found[light != 0], light[light != 0], rtol=1e-9)


def test_the_volume_counts_each_part_for_the_frames_that_see_it():
    """Of two frames of 6 x 10 pixels, the second 2 down and 3 across: 4 x 7 are seen by both."""
    random = np.random.default_rng(7)
    whole = np.abs(np.fft.fft2(random.normal(size=(2, 9, 14)))) ** 2 / 90
    volume = volume_of(whole[..., :8], np.array([[0.0, 2.0], [0.0, 3.0]]), (6, 10))
    logarithms = [np.mean(np.log1p(each)) for each in (whole[0], whole[1], np.sum(whole, axis=0))]
    alone, both = 60 - 28, 28
    expected = (alone * (logarithms[0] + logarithms[1]) + both * logarithms[2]) / 2
    assert volume.logarithm == pytest.approx(expected)
    shares = [np.mean(each / (1 + each)) for each in whole]
    together = [np.mean(each / (1 + np.sum(whole, axis=0))) for each in whole]
    left = [alone * (1 - a) + both * (1 - b) for a, b in zip(shares, together, strict=True)]
    np.testing.assert_allclose(volume.freedoms, left)


@pytest.mark.parametrize("lights", [(1, 1), (1, 1, 1, 1), (1, 10, 1, 10), (30, 1, 1)])
def test_a_frame_that_is_displaced_is_said_to_be_so(lights):
    """By its way from the mean of the others, to errors that are those by which it scatters."""
    random, shape, count = np.random.default_rng(3), (24, 32), len(lights)
    noises = 0.1 / np.array(lights)
    down, across = np.fft.fftfreq(24)[:, None], np.fft.rfftfreq(32)
    power, found = 0.02 / (0.02 + down**2 + across**2), []
    turn = np.exp(-2j * np.pi * (0.3 * across - 0.1 * down))
    responses = np.ones((count, *power.shape), complex)
    space = volume_of(power / noises[:, None, None], np.zeros((2, count)), shape)
    for _ in range(120):
        picture = np.fft.rfft2(random.normal(size=shape)) * np.sqrt(power)
        every = [picture] * (count - 1) + [picture * turn]
        frames = np.fft.irfft2(every, shape)
        frames += np.sqrt(noises)[:, None, None] * random.normal(size=(count, *shape))
        canvas = Canvas(frames, noises, power, (0, 0), shape)
        found.append(fit_of(likeliest(canvas, responses, 1e-6), space))
    shifts = np.array([each.shifts for each in found])
    errors = np.array([each.shift_errors for each in found])
    np.testing.assert_allclose(np.mean(shifts, axis=0)[-1], [0.3, -0.1], atol=0.03)
    sizes = np.mean(np.var(shifts, axis=0) / np.mean(errors, axis=0) ** 2, axis=1) ** 0.5
    np.testing.assert_allclose(sizes, 1, atol=0.2)
    assert np.mean(sizes) == pytest.approx(1, abs=0.1)


def test_a_frame_of_another_gain_and_black_level_is_told():
    """A tenth brighter, and 0.03 of white above the others, of which the picture has a quarter."""
    random, shape, noises = np.random.default_rng(4), (40, 48), np.full(4, 1e-4)
    down, across = np.fft.fftfreq(40)[:, None], np.fft.rfftfreq(48)
    power = 1e-3 / (0.02 + down**2 + across**2)
    picture = np.fft.irfft2(np.fft.rfft2(random.normal(size=shape)) * np.sqrt(power), shape)
    frames = np.stack([picture] * 4)
    frames[2] = 1.1 * (picture + 0.3) - 0.3 + 0.03
    frames += 0.01 * random.normal(size=frames.shape)
    canvas = Canvas(frames, noises, power, (0, 0), shape)
    responses = np.ones((4, *power.shape), complex)
    space = volume_of(np.stack([power / 1e-4] * 4), np.zeros((2, 4)), shape)
    fit = fit_of(likeliest(canvas, responses, 1e-6), space, mean=0.3)
    np.testing.assert_allclose(fit.gains, 0.1 * (np.arange(4) == 2) - 0.025, atol=0.005)
    np.testing.assert_allclose(fit.offsets, 0.03 * (np.arange(4) == 2) - 0.0075, atol=0.003)
    assert fit.misfit == pytest.approx(1, abs=0.1)
    np.testing.assert_allclose(fit.misfits, 1, atol=0.15)
    # One alone has no others that it could differ from.
    canvas = Canvas(frames[2:3], noises[:1], power, (0, 0), shape)
    space = volume_of(power[None] / 1e-4, np.zeros((2, 1)), shape)
    alone = fit_of(likeliest(canvas, responses[:1], 1e-6), space, mean=0.3)
    for none in (alone.gains, alone.offsets, alone.shifts):
        np.testing.assert_array_equal(none, 0)
    assert alone.misfit == pytest.approx(1, abs=0.2)


def test_the_noise_of_one_grey_of_three_is_a_third():
    """Of white pixels of 300 and 1200 electrons, a fifth of them lit, with 8 of read noise."""
    scene = Scene([0.0], photon_rate=3e4, read_noise=8.0)
    wanted = np.array([(60 + 64) / 300**2, (240 + 64) / 1200**2])
    for share in (1.0, 1 / 3):
        found = noises_of(scene, [0.01, 0.04], 0.2, share)
        np.testing.assert_allclose(found, share * wanted, rtol=1e-6)
