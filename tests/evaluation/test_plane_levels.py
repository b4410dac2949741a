"""Levels of frames in the plane, held to a reference, to one axis, and to finite differences."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support import plane

from mishutter import (
    EvenVelocities,
    ListedVelocities,
    Occlusion,
    Optics,
    ParabolicMotion,
    RingOfVelocities,
    Scene,
    StillCamera,
    Texture,
    TimedFrame,
    example_picture,
    exposures_psnr,
)
from mishutter.evaluation.ceilings import ceiling, exposures_ceiling, water_filled
from mishutter.evaluation.fans import MEASURED, SEARCHED, Fan, Grid, power_of
from mishutter.evaluation.levels import instants_of, left, psnr_of_error
from mishutter.evaluation.open_frames import OpenFrames
from mishutter.model.frame_path import PlaneFrames
from mishutter.model.optics import frequencies
from mishutter.pictures.images import Picture

WINDOW = 0.08


@pytest.mark.slow
@pytest.mark.parametrize("slug", plane.SCENES)
def test_levels_and_ceilings_are_those_of_the_reference(slug):
    """16 levels of a scene to 0.01 dB in the mean: stills, crossed parabolas, circle, two sines."""
    scene, levels, ceilings = plane.scene_of(slug), plane.LEVELS[slug], plane.CEILINGS[slug]
    frames = {each: jax.tree.map(np.float32, plane.frames_of(slug, *each)) for each in levels}
    off = [float(exposures_psnr(scene, frames[each])) - level for each, level in levels.items()]
    assert np.max(np.abs(off)) < 0.05
    assert np.mean(np.abs(off)) < 0.01
    for count, level in ceilings.items():
        found = exposures_ceiling(scene, np.full(count, WINDOW / count))
        assert found == pytest.approx(level, abs=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(("grid", "most"), [(SEARCHED, 0.05), (MEASURED, 0.02)])
def test_the_grids_are_as_fine_as_they_say(grid, most):
    """Four frames on two sines, against the level on the fine grid."""
    for slug in ("A", "B"):
        frames, scene = plane.frames_of(slug, 4, "sines"), plane.scene_of(slug)
        level = float(exposures_psnr(scene, frames, grid=grid))
        assert level == pytest.approx(plane.LEVELS[slug][4, "sines"], abs=most)


def test_one_axis_is_a_fan_of_one_line():
    """A disc of 1e-6 across, on the line of the rows, has the level of today's scene of one axis.

    The speeds are those of the disc along that line, for two frames of which one is still.
    """
    frames = plane.frames_of("A", 2, "sines")
    law = EvenVelocities(2800.0, 2800.0e-6)
    scene = Scene.any_direction(law, photon_rate=3e4, read_noise=10.0)
    parts = law.components(np.zeros(1), 96)
    line = Scene(
        np.asarray(parts.speeds[0]),
        np.asarray(parts.weights[0]),
        photon_rate=3e4,
        read_noise=10.0,
    )
    one = OpenFrames.of(line, 0.04, folds=False)

    x, weight = np.polynomial.legendre.leggauss(400)
    after = 0.02 * x  # s, from mid-exposure

    def passed(index):
        place = np.asarray(frames.place(jnp.asarray(frames.times[index] + after)))[0]
        way = place[:, None] - after[:, None] * one.speeds[:, 0]
        waves = np.exp(-2j * np.pi * one.fan.radius * way[..., None])
        return np.abs(np.tensordot(weight / 2, waves, 1)) ** 2

    errors = one.errors(sum(one.snr(passed(index), 0.04) for index in (0, 1)))
    in_plane = left(scene, instants_of(scene, frames, "exposures_psnr"), one.fan, 96)
    # The speeds of `one` are sorted as those of the fan are not: only means are compared.
    assert psnr_of_error(float(in_plane)) == pytest.approx(
        psnr_of_error(float(np.sum(one.weights * errors))), abs=5e-3
    )


@pytest.mark.slow
def test_a_disc_of_nothing_across_is_the_mean_of_lines_of_one_axis():
    """The level over the plane, where nothing moves across, is that of today's rows of all kinds.

    Each row of the plane's spectrum, at its own frequency across, is a scene of one axis.
    """
    law = EvenVelocities(2800.0, 2800.0e-6)
    scene = Scene.any_direction(law, photon_rate=3e4, read_noise=10.0)
    exposure, speeds = 0.004, law.components(np.zeros(1), 48)
    frames = PlaneFrames(np.zeros(1), np.full(1, exposure), np.ones(1), np.zeros((2, 2)))
    x, weight = np.polynomial.legendre.leggauss(120)
    s = (x + 1) / 2
    across, share = s**3 / 2, weight / 2 * 3 * s**2 / 2
    along = frequencies(8192)
    power = (along**2 + across[:, None] ** 2 + 0.01**2) ** -1.5
    scale = 0.2**2 / (4 * share @ power.mean(1) / 2)
    errors = []
    for each, f in zip(power * scale, across, strict=True):
        aperture = float(np.sinc(f)) ** 2
        deviation = np.sqrt(aperture * each.mean())
        texture = Texture(power_spectrum=each, deviation=deviation)
        own = np.asarray(speeds.speeds[0]), np.asarray(speeds.weights[0])
        line = Scene(*own, photon_rate=3e4, read_noise=10.0, picture=texture)
        one = OpenFrames.of(line, exposure, folds=True)
        error = one.error(one.snr(one.at_rest(exposure), exposure))
        errors.append(error / aperture)
    expected = psnr_of_error(float(2 * share @ np.array(errors)))
    level = float(exposures_psnr(scene, frames, grid=Grid(96, 96, 48, 16)))
    assert level == pytest.approx(expected, abs=1e-3)


def small(dtype=np.float64) -> PlaneFrames:
    """Two unequal frames on four pieces, with a gap in which the velocity jumps."""
    return jax.tree.map(
        lambda x: np.asarray(x, dtype),
        PlaneFrames(
            np.array([-0.011, 0.006]),
            np.array([0.012, 0.021]),
            np.array([0.012, 0.0005, 0.0, 0.021]),
            np.array([[-900.0, 700.0, 700.0, -400.0, 1300.0], [300.0, 1100.0, 0.0, -800.0, 50.0]]),
        ),
    )


COARSE = Grid(8, 4, 6, 2)


def test_the_level_has_the_slopes_of_differences():
    """By velocities, durations and exposures, by light, noise, lens and law; forward as reverse."""
    frames = small()

    def level(numbers):
        path, scene_numbers = numbers
        rate, read, blur, along = scene_numbers
        scene = Scene.any_direction(
            EvenVelocities(along, 900.0, angle=0.4),
            photon_rate=rate,
            read_noise=read,
            optics=Optics(lens_blur=blur),
        )
        return exposures_psnr(scene, path, grid=COARSE, num_panels=12)

    numbers = (jax.tree.map(jnp.asarray, frames), tuple(map(jnp.asarray, (3e4, 9.0, 0.4, 2100.0))))
    level = jax.jit(level)  # waves of NumPy are of single precision
    slope = jax.grad(level)(numbers)
    rng = np.random.default_rng(3)
    change = jax.tree.map(lambda x: 1e-6 * jnp.abs(x) * rng.normal(size=x.shape), numbers)
    # The first light stays where the first velocity begins.
    forward = jax.jvp(level, (numbers,), (change,))[1]
    ahead, behind = (
        level(jax.tree.map(lambda x, d, s=sign: x + s * d, numbers, change)) for sign in (1, -1)
    )
    product = sum(
        jnp.vdot(x, y) for x, y in zip(*map(jax.tree.leaves, (slope, change)), strict=True)
    )
    assert float(forward) == pytest.approx(float(ahead - behind) / 2, rel=1e-5)
    assert float(product) == pytest.approx(float(forward), rel=1e-9)


def test_single_precision_and_a_batch_have_the_same_levels():
    """Frames of 32 bits keep them, to 1e-4 dB; `jit` and `vmap` change nothing."""
    scene = Scene.any_direction(RingOfVelocities(1900.0), photon_rate=3e4, read_noise=9.0)
    level = float(exposures_psnr(scene, small(), grid=COARSE, num_panels=12))
    single = exposures_psnr(scene, small(np.float32), grid=COARSE, num_panels=12)
    assert single.dtype == np.float32
    assert float(single) == pytest.approx(level, abs=1e-4)
    two = jax.tree.map(lambda x: jnp.stack([x, 0.8 * x]), small())
    batch = jax.jit(
        jax.vmap(lambda frames: exposures_psnr(scene, frames, grid=COARSE, num_panels=12))
    )(two)
    assert float(batch[0]) == pytest.approx(level, abs=1e-6)
    assert float(batch[1]) != pytest.approx(level, abs=1e-2)


def test_traced_frames_need_their_number_of_panels():
    """Without it the error says so, in place of a level that is wrong; so it does of too few."""
    scene = Scene.any_direction(RingOfVelocities(1900.0), photon_rate=3e4, read_noise=9.0)
    with pytest.raises(RuntimeError, match=r"nothing passes more than 10 px in a panel; got 4"):
        jax.jit(lambda frames: exposures_psnr(scene, frames, grid=COARSE, num_panels=4))(small())
    with pytest.raises(
        ValueError, match=r"exposures_psnr\(num_panels=...\)` must be given where JAX"
    ):
        jax.jit(lambda frames: exposures_psnr(scene, frames))(small())


def test_an_exposure_over_which_things_pass_hundreds_of_px_has_a_level():
    """Of which NumPy computes each radius alone; JAX computes all at once."""
    law, grid = EvenVelocities(4000.0, 1000.0), Grid(2, 16, 64, 2)
    scene = Scene.any_direction(law, photon_rate=3e4, read_noise=5.0)
    velocities = np.random.default_rng(0).normal(0, 500.0, (2, 7))
    frames = PlaneFrames(np.zeros(1), np.full(1, 0.2), np.full(6, 0.2 / 6), velocities)
    level = float(exposures_psnr(scene, frames, grid=grid))
    whole = jax.jit(lambda x: exposures_psnr(scene, x, grid=grid, num_panels=192))(frames)
    assert float(whole) == pytest.approx(level, abs=1e-5)


def test_a_scene_without_light_or_noise_has_a_level():
    """Darkness leaves the picture's variance; without noise no level is NaN."""
    dark = Scene.any_direction(1900.0, photon_rate=0.0, read_noise=9.0)
    assert float(exposures_psnr(dark, small(), grid=COARSE)) == pytest.approx(-20 * np.log10(0.2))
    picture = Texture(mean_level=0.0)
    clean = Scene.any_direction(1900.0, photon_rate=3e4, read_noise=0.0, picture=picture)
    assert 60 < float(exposures_psnr(clean, small(), grid=COARSE)) < 200


def test_a_listed_velocity_that_the_sensor_follows_is_as_sharp_as_stillness():
    """A sensor on the one velocity of a list has the level of a picture and a sensor at rest."""
    law = ListedVelocities([[1900.0, -700.0]])
    scene = Scene.any_direction(law, photon_rate=3e4, read_noise=9.0)
    velocity = np.array([[1900.0], [-700.0]]) * np.ones((1, 2))
    still = np.array([0.0]), np.array([0.03]), np.array([0.03])
    level = float(exposures_psnr(scene, PlaneFrames(*still, velocity), grid=COARSE))
    fan = Fan.of(scene, COARSE)
    r, a = fan.radius[:, None], fan.direction
    aperture = np.sinc(r * np.cos(a)) ** 2 * np.sinc(r * np.sin(a)) ** 2
    e = 3e4 * 0.03
    lost = 1 / (1 + 0.04 * fan.power * aperture * e**2 / (0.25 * e + 81))
    assert level == pytest.approx(-10 * np.log10(0.04 * np.sum(fan.weight * lost)), abs=1e-6)


def test_a_lens_that_passes_less_leaves_no_power_above_its_cutoff():
    """The fan ends at the cutoff, and its shares of power sum to 1 there as elsewhere."""
    for cutoff in (0.5, 0.23):
        scene = Scene.any_direction(
            1900.0, photon_rate=1.0, read_noise=1.0, optics=Optics(cutoff_frequency=cutoff)
        )
        fan = Fan.of(scene)
        assert fan.weight.sum() == pytest.approx(1)
        x = np.abs(fan.radius[:, None] * np.stack([np.cos(fan.direction), np.sin(fan.direction)]))
        assert x.max() < cutoff


def test_a_photograph_holds_its_detail_along_its_axes():
    """Its fitted power is that of its periodogram in octaves, and is less along diagonals."""
    picture = example_picture()
    power = power_of(picture)
    light = np.asarray(picture.light, np.float64).mean(-1)
    window = np.outer(*(np.hanning(n + 2)[1:-1] for n in light.shape[:2]))
    field = (light - light.mean()) * window
    found = np.abs(np.fft.fft2(field)) ** 2
    fy, fx = np.meshgrid(*map(np.fft.fftfreq, light.shape[:2]), indexing="ij")
    r, a = np.hypot(fx, fy), np.arctan2(fy, fx)
    means = []
    for low in (0.03, 0.06, 0.12, 0.24):
        ring = (r > low) & (r < 2 * low)
        means.append(np.log(found[ring]).mean() - np.log(power(r[ring], a[ring])).mean())
    assert np.ptp(means) < 0.5
    ring = (r > 0.1) & (r < 0.3)
    turned = np.cos(4 * a)
    logs = [np.log(found), np.log(power(r, a))]
    along, fitted = (
        x[ring & (turned > 0.5)].mean() - x[ring & (turned < -0.5)].mean() for x in logs
    )
    assert along > 0.1
    assert fitted == pytest.approx(along, abs=0.1)


def test_the_power_of_a_photograph_is_found_in_any_light_and_from_any_side():
    """Of noise of a power that is steeper along rows, in a picture of unequal sides."""
    draw, shape = np.random.default_rng(8), (120, 168)
    down, across = np.fft.fftfreq(shape[0])[:, None], np.fft.fftfreq(shape[1])
    radius, angle = np.hypot(down, across), np.arctan2(down, across)
    log = np.log(np.maximum(radius, 0.004))
    power = np.exp(-2.3 * log - 0.1 * log**2 + 0.5 * np.cos(2 * angle) + 0.3 * np.sin(2 * angle))
    noise = np.fft.fft2(draw.normal(size=shape)) * np.sqrt(power)
    light = np.real(np.fft.ifft2(noise))
    light = (0.5 + 0.1 * light / np.std(light))[..., None].astype(np.float32)
    r, a = np.array([0.08, 0.1, 0.3, 0.1, 0.2]), np.array([0.0, 0.4, 1.5, 2.0, -0.7])
    found = power_of(Picture(light))(r, a)
    wanted = r ** (-2.3 - 0.1 * np.log(r)) * np.exp(0.5 * np.cos(2 * a) + 0.3 * np.sin(2 * a))
    assert np.ptp(np.log(found / wanted)) < 0.5
    dark = power_of(Picture(light / 1024))(r, a)
    np.testing.assert_allclose(dark, found / 1024**2, rtol=1e-4)
    np.testing.assert_allclose(power_of(Picture(light[::-1]))(r, -a), found, rtol=1e-4)
    turned = power_of(Picture(np.swapaxes(light, 0, 1)))(r, np.pi / 2 - a)
    np.testing.assert_allclose(turned, found, rtol=0.2)


def test_water_is_poured_where_it_gains_most():
    """Against the best of many other ways to spend the same budget on three cells."""
    mass, width = np.array([0.55, 0.3, 0.15]), np.array([0.7, 0.6, 0.7])
    least = float(water_filled(mass, width, np.array([4.0]), np.array([5.0]))[0])
    rho = np.random.default_rng(2).uniform(0, 5, (200_000, 3))
    rho = rho[rho @ width <= 4.0]
    best = float(np.min((1 / (1 + rho)) @ mass))
    assert least <= best
    assert least == pytest.approx(best, abs=2e-3)


def test_slow_things_have_the_ceiling_of_one_still():
    """In 10 ms they pass a hundredth of a pixel, so that the cap alone counts."""
    scene = Scene.any_direction(1.0, photon_rate=3e4, read_noise=10.0)
    still = PlaneFrames(np.zeros(1), np.array([0.01]), np.ones(1), np.zeros((2, 2)))
    wanted = float(exposures_psnr(scene, still))
    assert exposures_ceiling(scene, still.exposures) == pytest.approx(wanted, abs=1e-4)


def test_the_ceiling_before_a_background_is_that_of_its_parts():
    """Of the objects by their share, and of what rests, with which any path keeps up."""
    light, exposures = {"photon_rate": 3e4, "read_noise": 9.0}, np.array([0.01, 0.002, 0.006])

    def error(law, **others):
        scene = Scene.any_direction(law, **light, **others)
        return 10 ** (-exposures_ceiling(scene, exposures, grid=COARSE) / 10)

    objects, rest = EvenVelocities(2100.0, 700.0, angle=0.4), ListedVelocities([[1.0, 0.0]])
    layers = Occlusion(front_share=0.2, object_width=50.0)
    wanted = 0.2 * error(objects) + 0.8 * error(rest)
    assert error(objects, occlusion=layers) == pytest.approx(wanted, rel=1e-4)
    assert error(objects) > 1.2 * error(rest)


def test_the_ceiling_of_uneven_speeds_is_lower_than_that_of_their_peak():
    """On one axis as well; a list of equal weights keeps its ceiling to 1e-3 dB."""
    speeds = np.linspace(-2000, 2000, 9)
    light = {"photon_rate": 3e4, "read_noise": 9.0}
    peaked = Scene(speeds, np.exp(-((speeds / 900) ** 2) / 2), **light)
    long = {"max_half_exposure": 0.03, "continuous": True}
    even, own = float(ceiling(Scene(speeds, **light), **long)), float(ceiling(peaked, **long))
    from mishutter.evaluation.ceilings import Times, _least_error
    from mishutter.model.scene import power_on_grid

    peak = _least_error(peaked, 0.03, Times.of_cells(peaked), power_on_grid(peaked, 512))
    assert even < own < psnr_of_error(peak) - 0.05


@pytest.mark.slow
def test_motion_across_costs_frames_that_move_more():
    """A tenth across costs less than a third, and stills least."""
    swing, still = (
        [TimedFrame(motion, time) for time in (-0.01, 0.01)]
        for motion in (
            ParabolicMotion.from_stroke(9.0, half_exposure=0.007),
            StillCamera(half_exposure=0.0014),
        )
    )
    light = {"photon_rate": 3e4, "read_noise": 9.0}

    def lost(frames: list[TimedFrame], across: float) -> float:
        laws = EvenVelocities(2300.0, 0.0), EvenVelocities(2300.0, across * 2300.0)
        levels = [exposures_psnr(Scene.any_direction(law, **light), frames) for law in laws]
        return float(levels[0] - levels[1])

    assert 0.01 < lost(swing, 0.1) < lost(swing, 0.33) < 2
    assert lost(still, 0.33) < lost(swing, 0.33)


def test_a_scene_of_one_axis_has_no_ceiling_of_frames():
    """The error says what would make one of any direction."""
    scene = Scene.uniform(max_speed=2300.0, photon_rate=3e4, read_noise=9.0)
    line = "`scene` must have velocities in any direction, as `Scene.any_direction` makes it; got"
    with pytest.raises(ValueError, match=line):
        exposures_ceiling(scene, small().exposures)
