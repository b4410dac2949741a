"""Losses of frames on a real sensor, against covariances that are written out anew in NumPy."""

import math

import numpy as np
import pytest

from mishutter import (
    BurstMode,
    FreeMotion,
    Limits,
    Objects,
    Occlusion,
    ParabolicMotion,
    Scene,
    Sensor,
    StillCamera,
    Texture,
    TimedFrame,
)
from mishutter.evaluation.bursts import best_still_burst
from mishutter.evaluation.registration import loss_of_width, registration, with_losses
from mishutter.search.moving_frames import best_moving_burst

U = (np.arange(512) + 0.5) / 512
F, DF = 0.5 * U**2, 2 * U / 512
"""Frequencies and their shares: dense where the power is."""
_BAND = (np.arange(8192) + 0.5) / 16384
_SCALE = 0.04 / np.mean(1 / (_BAND**2 + 1e-4))
NEAR_EXACT = 0.1
"""dB, of losses up to 2 dB: how near an end a point is does not count, but for frames that miss it.
"""


def power(frequency):
    """The spectrum of a typical photograph."""
    return _SCALE / (frequency**2 + 1e-4)


def scene_of(*speeds, rate=1e5, read_noise=8.0, **others):
    """A scene of equally likely speeds."""
    return Scene(list(speeds), photon_rate=rate, read_noise=read_noise, **others)


def stills(count, half, period):
    """Frames at rest."""
    still = StillCamera(half_exposure=half)
    return [TimedFrame(still, (k - (count - 1) / 2) * period) for k in range(count)]


def alternating(count, half, acceleration, period):
    """Parabolas of alternating direction without a jump of the velocity."""
    swing = acceleration * half * (period - 2 * half) + acceleration * half**2
    there = ParabolicMotion(acceleration=acceleration, half_exposure=half)
    back = FreeMotion(accelerations=np.array([-acceleration]), half_exposure=half)
    return [
        TimedFrame((there, back)[k % 2], (k - (count - 1) / 2) * period, (-swing, swing)[k % 2])
        for k in range(count)
    ]


def sweep(count, half, acceleration, period):
    """One slow parabola, read out several times."""
    times = (np.arange(count) - (count - 1) / 2) * period
    return [
        TimedFrame(
            ParabolicMotion(
                acceleration=acceleration, half_exposure=half, velocity=2 * acceleration * time
            ),
            float(time),
            float(acceleration * time**2),
        )
        for time in times
    ]


def a_still_and_parabolas(acceleration=25 / 8.5e-3**2):
    """One long exposure at rest before three short ones that move."""
    moving = alternating(3, 8.5e-3, acceleration, 0.02)
    later = [TimedFrame(one.motion, one.time + 0.01, one.position) for one in moving]
    return [TimedFrame(StillCamera(half_exposure=14e-3), -0.03), *later]


def path_of(frame, count=800):
    """Times from the middle of the burst, and places of the sensor then."""
    half = float(frame.motion.half_exposure)
    time = half * ((np.arange(count) + 0.5) * 2 / count - 1)
    return frame.time + time, frame.position + np.asarray(frame.motion.position(time), np.float64)


def noise_of(scene, frame):
    """Variance of the noise of a frame, white = 1."""
    electrons = frame.exposure * float(scene.photon_rate)
    return 0.25 / electrons + (float(scene.read_noise) / electrons) ** 2


def brute_registration(scene, frames, speed, step=0.5):
    """Deviation and loss by the whole covariance of the frames and the filter that they want."""

    def seen(s):
        waves = [
            np.exp(-2j * np.pi * F[:, None] * (place - s * time)).mean(axis=1)
            for time, place in map(path_of, frames)
        ]
        return np.stack(waves, axis=1) * np.sinc(F)[:, None]

    here, above, below = (seen(s) for s in (speed, speed + step, speed - step))
    noise, s = np.array([noise_of(scene, frame) for frame in frames]), power(F)[:, None, None]

    def outer(a, b):
        return s * a[:, :, None] * b[:, None, :].conj()

    def restoring(a):
        every = 1 + s[:, 0, 0] * (abs(a) ** 2 / noise).sum(1)
        return s[:, 0] * a.conj() / noise / every[:, None]

    covariance = outer(here, here) + np.diag(noise)
    slope = (above - below) / (2 * step)
    change = np.linalg.solve(covariance, outer(slope, here) + outer(here, slope))
    information = DF @ np.einsum("fij,fji->f", change, change).real / 2
    off = (restoring(above) - restoring(below)) / (2 * step)
    shift = 2j * np.pi * F[:, None] * restoring(here)

    def product(a, b):
        return DF @ np.einsum("fi,fij,fj->f", a, covariance, b.conj()).real

    excess = product(off, off) - product(off, shift) ** 2 / product(shift, shift)
    error = DF @ (s[:, 0, 0] / (1 + s[:, 0, 0] * (abs(here) ** 2 / noise).sum(1)))
    variance = 1 / (4096 * information)
    return math.sqrt(variance), 10 * math.log10(1 + variance * excess / error)


BURSTS = {
    "stills": (lambda: stills(4, 0.75e-3, 0.0785 / 3), (0.64984, 2.4873e-4)),
    "alternating": (lambda: alternating(4, 1e-2, 27e4, 0.02), (0.37923, 2.2447e-4)),
    "sweep": (lambda: sweep(4, 1e-2, 1.17 * 4500 / 0.08, 0.02), (1.02537, 8.4424e-5)),
    "still and moving": (a_still_and_parabolas, (0.51051, 2.2374e-4)),
}


@pytest.mark.parametrize("name", BURSTS)
def test_registration_is_the_bound_of_the_whole_covariance(name):
    """Of frames of any motion, length and time, with published values at one of two speeds."""
    make, published = BURSTS[name]
    scene, frames = scene_of(-1300.0, 3000.0), make()
    bound = registration(scene, frames)
    np.testing.assert_allclose(bound.speeds, [-1300.0, 3000.0])
    np.testing.assert_allclose((bound.deviation[1], bound.loss[1]), published, rtol=1e-3)
    brute = brute_registration(scene, frames, -1300.0)
    np.testing.assert_allclose((bound.deviation[0], bound.loss[0]), brute, rtol=2e-3)


def test_a_single_frame_tells_the_speed_by_its_blur():
    """Frames that do not differ tell what one exposure tells, far less than two moments do."""
    scene, (one,) = scene_of(2100.0), stills(1, 1.1e-3, 0.01)
    alone = registration(scene, [one])
    brute = brute_registration(scene, [one], 2100.0)
    np.testing.assert_allclose((alone.deviation[0], alone.loss[0]), brute, rtol=2e-3)
    two = registration(scene, stills(2, 1.1e-3, 0.01))
    assert two.deviation[0] < alone.deviation[0] / 10


def test_more_samples_register_better():
    """The variance falls with their number, and with it the loss."""
    scene, frames = scene_of(1200.0, 2700.0), stills(3, 0.9e-3, 0.02)
    few, many = (registration(scene, frames, num_samples=n) for n in (50, 200))
    np.testing.assert_allclose(few.deviation, 2 * many.deviation, rtol=1e-12)
    np.testing.assert_allclose(few.loss, 4 * many.loss, rtol=0.05)
    assert np.all(many.loss > 0)


def test_registration_costs_no_more_than_the_picture():
    """In the dark the bound is beyond all speeds, and whoever restores nothing loses little."""
    dim = registration(scene_of(1700.0, rate=30.0), stills(3, 0.9e-3, 0.02))
    assert 0 < dim.loss[0] < 0.1
    dark = registration(scene_of(1700.0, rate=0.0), stills(3, 0.9e-3, 0.02))
    assert (dark.deviation[0], dark.loss[0]) == (math.inf, 0.0)
    blank = scene_of(1700.0, picture=Texture(deviation=0.0))
    assert registration(blank, stills(3, 0.9e-3, 0.02)).loss[0] == 0
    assert loss_of_width(blank, stills(3, 0.9e-3, 0.02), width=70.0) == 0


def exact_losses(scene, frames, width, beyond=224):
    """What a sensor's ends cost the best linear decoder of Gaussian rows, by whole covariances.

    The rows go on beyond the sensor, and what lies there is as unknown as the rest.
    """
    length = width + 2 * beyond
    frequency = np.fft.fftfreq(length)
    beside = (np.arange(length)[:, None] - np.arange(length)) % length
    window, errors = slice(beyond, beyond + width), []
    for speed in np.asarray(scene.speeds):
        precision = np.fft.ifft(1 / power(frequency)).real[beside]
        density = np.zeros(length)
        for frame in frames:
            time, place = path_of(frame)
            way = place - speed * time
            wave = np.exp(-2j * np.pi * frequency[:, None] * way).mean(axis=1) * np.sinc(frequency)
            rows = np.fft.ifft(wave).real[beside[window]]
            precision += rows.T @ rows / noise_of(scene, frame)
            density += np.abs(wave) ** 2 / noise_of(scene, frame)
        whole = np.mean(power(frequency) / (1 + power(frequency) * density))
        errors.append((np.mean(np.diag(np.linalg.inv(precision))[window]), whole))
    seen, whole = np.mean(errors, axis=0)
    return 10 * math.log10(seen / whole)


@pytest.mark.parametrize(
    ("make", "speeds", "width"),
    [
        (lambda: stills(3, 0.9e-3, 0.012), (-3100.0, 1700.0), 160),
        (lambda: alternating(4, 9e-3, 25e4, 0.0185), (-2300.0, 900.0), 190),
        (lambda: alternating(2, 8.1e-3, 27e4, 0.0167), (3900.0, -2200.0, -300.0), 144),
        (lambda: sweep(5, 6e-3, 6e4, 0.0125), (-2600.0, 2100.0), 210),
        (lambda: a_still_and_parabolas(2.4e5), (-700.0, 1500.0), 177),
    ],
    ids=["stills", "alternating", "two frames", "sweep", "still and moving"],
)
def test_ends_cost_what_they_cost_the_best_decoder(make, speeds, width):
    """Of frames of which a point may be exposed in part, on sensors that are narrow for them."""
    scene, frames = scene_of(*speeds), make()
    exact = exact_losses(scene, frames, width)
    assert exact > 0.2
    assert loss_of_width(scene, frames, width=width) == pytest.approx(exact, abs=NEAR_EXACT)


def test_points_that_no_frame_sees_are_predicted_from_their_neighbours():
    """A sixth of the points, between two frames: 5.0 dB, where all of their variance would be 5.9.

    Left out, the loss would be 1.1 dB, of a picture with a hole.
    """
    scene, frames = scene_of(-3000.0, 3000.0), stills(2, 0.5e-3, 0.1)
    assert loss_of_width(scene, frames, width=256.0) == pytest.approx(5.030, abs=0.3)


def test_short_frames_see_points_whole_or_not_at_all():
    """The closed form: of the steps d a share d/X of the sensor misses 1, 2, ... frames."""
    scene, half, period, width = scene_of(2900.0), 2e-5, 0.011, 190.0
    frames, step = stills(5, half, period), 2900.0 * period / width
    error = [0.0] + [
        DF
        @ (
            power(F)
            / (
                1
                + power(F)
                * n
                * np.sinc(F) ** 2
                * np.sinc(F * 2900.0 * 2 * half) ** 2
                / noise_of(scene, frames[0])
            )
        )
        for n in range(1, 6)
    ]
    mean = (1 - 4 * step) * error[5] + 2 * step * (error[4] + error[3])
    closed = 10 * math.log10(mean / error[5])
    assert loss_of_width(scene, frames, width=width) == pytest.approx(closed, rel=5e-3)


def test_published_losses_of_narrow_and_wide_sensors():
    """They fall with the width, to nothing on a sensor without an end."""
    scene = Scene.uniform(max_speed=4500.0, photon_rate=1e5, read_noise=8.0)
    frames = stills(4, 0.75e-3, 0.0785 / 3)
    for width, loss in {512.0: 28.2547 - 27.9830, 2048.0: 28.2547 - 28.1852}.items():
        assert loss_of_width(scene, frames, width=width) == pytest.approx(loss, abs=1e-3)
    assert loss_of_width(scene, frames, width=1e9) == pytest.approx(0, abs=1e-5)


def test_nothing_that_rests_leaves_a_sensor_at_rest():
    """Without motion the ends cost nothing; a sensor that sees no point twice pays all of it."""
    rests, goes = scene_of(0.0), scene_of(5200.0)
    assert loss_of_width(rests, stills(3, 0.9e-3, 0.02), width=60.0) == pytest.approx(0, abs=1e-12)
    frames = stills(3, 5e-5, 0.02)
    once = loss_of_width(goes, frames, width=90.0)
    alone, every = (
        np.mean(power(_BAND) / (1 + n * power(_BAND) * density))
        for density in [
            (np.sinc(_BAND) * np.sinc(_BAND * 5200.0 * 1e-4)) ** 2 / noise_of(goes, frames[0])
        ]
        for n in (1, 3)
    )
    assert once == pytest.approx(10 * math.log10(alone / every), abs=0.02)


BURST = BurstMode(frames_per_s=58.0, max_frames=3, window=0.046)


@pytest.mark.slow
@pytest.mark.parametrize("best", [best_still_burst, best_moving_burst])
def test_a_burst_that_is_found_holds_its_losses(best):
    """That by the width where the scene says it; a single exposure has neither."""
    limits = Limits(max_stroke=41.0, max_half_exposure=0.022)
    scene = scene_of(-1900.0, 0.0, 2600.0, burst=BURST, limits=limits, sensor=Sensor(width=430))
    burst = with_losses(scene, best(scene))
    bound = registration(scene, burst.frames)
    assert burst.registration_loss == pytest.approx(np.max(bound.loss))
    assert burst.width_loss == loss_of_width(scene, burst.frames, width=430.0)
    assert f"{burst.width_loss:.2g} by borders" in burst.text
    objects = scene_of(
        -1900.0,
        0.0,
        2600.0,
        burst=BURST,
        limits=limits,
        sensor=Sensor(width=430),
        objects=Objects(width=97.0),
    )
    found = with_losses(objects, best(objects))
    assert found.width_loss == loss_of_width(scene, found.frames, width=97.0)
    endless = scene_of(-1900.0, 0.0, 2600.0, burst=BURST, limits=limits)
    assert with_losses(endless, best(endless)).width_loss is None
    single = BurstMode(frames_per_s=58.0, max_frames=1)
    one = scene_of(-1900.0, 0.0, 2600.0, burst=single, limits=limits, sensor=Sensor(width=430))
    assert with_losses(one, best(one)).registration_loss is None


def test_parts_before_a_background_count_by_their_shares():
    """What rests stays on the sensor, and what moves leaves it."""
    frames = stills(4, 0.75e-3, 0.025)
    moves, layered = (
        scene_of(-2900.0, 2900.0, occlusion=occlusion)
        for occlusion in (None, Occlusion(front_share=0.3))
    )
    alone, beside = (loss_of_width(scene, frames, width=333.0) for scene in (moves, layered))
    assert 0.1 * alone < beside < 0.8 * alone
