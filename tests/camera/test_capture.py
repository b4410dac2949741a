"""The camera: pictures, layers and footage against the scene at each of many instants.

A brute force in time knows no kernel, no transfer function and no order of integration, which are
what formulas get wrong. Where rows repeat themselves, as mirrored ones do, both agree to rounding.
Elsewhere waves that steps of light send through a row of pixels end 64 px beyond the blur.
"""

import inspect
import re
import tracemalloc
from functools import partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.time_sampling import captured_footage, captured_layers, captured_picture
from support.videos import film

import mishutter as ms
from mishutter.camera.capture import through_optics
from mishutter.camera.rows import continued, period_of
from mishutter.decoding.decoders.base import blur_model
from mishutter.model.sensor import noise_power
from mishutter.pictures.images import shipped_picture

HALF = 0.011
MOVING = ms.ParabolicMotion(acceleration=27.0 / HALF**2, half_exposure=HALF)
TOP = 2 * 27.0 / HALF
STILL = ms.StillCamera(half_exposure=HALF)
SCENE = ms.Scene([0.0], photon_rate=4e5, read_noise=6.0)
SHUTTERS = {"rect": ms.RectShutter(), "hann": ms.HannShutter()}
CHIPPED = ms.ChippedShutter([1.0, 0.2, 0.7, 0.0, 1.0, 0.4])
PAN = -0.4 * TOP
PANNING = {
    "parabola": ms.ParabolicMotion(acceleration=27.0 / HALF**2, half_exposure=HALF, velocity=PAN),
    "line": ms.LinearMotion(half_exposure=HALF, velocity=PAN),
}
AT_REST = {"parabola": MOVING, "line": STILL}
MOTIONS = {"moving": MOVING, "still": STILL, "moving and panning": PANNING["parabola"]}
ROUNDING = 1e-12
"""Where rows repeat themselves; white = 1."""
WAVES = 1e-4
"""Of photographs with hard mattes and ends, white = 1; white noise has ten times as much."""


RUN = 1 << 16
"""Pixels after which numbers would repeat if generators shared a seed."""


def flat_capture(levels, white, read_noise=0.0, *, shape=(1, 1), **options):
    """Captures of flat pictures, `white` electrons at 1; one row of them is one flat level."""
    rows, columns = shape
    light = np.ones((rows, columns)) * np.asarray(levels, float).reshape(-1, 1)
    scene = ms.Scene([0.0], photon_rate=white / (2 * HALF), read_noise=read_noise)
    captured = ms.simulate_capture(light, scene, STILL, ms.RectShutter(), **options)
    return np.asarray(captured)


def rows(count=7, columns=260, channels=3, seed=1):
    return np.random.default_rng(seed).random((count, columns, channels))


def photograph(count, columns):
    return ms.example_picture().light[100 : 100 + count, 100 : 100 + columns].astype(np.float64)


def three_layers():
    """A street, an object that enters and leaves, and a faster one that crosses it."""
    back = ms.Picture(ms.example_picture().light[100:148:6, 100:230, :2:2].astype(np.float64))
    y, x = np.mgrid[:30, :70]
    soft = np.clip(14.5 - np.hypot(y - 15, (x - 35) / 2), 0, 1)
    first = shipped_picture("chelsea.png").light[100:130:6, 100:170, :1] * 1.0
    second = shipped_picture("coffee.png").light[100:125:6, 200:240, :1] * 1.0
    return ms.Layers(
        (
            ms.Layer(back, 0.1 * TOP),
            ms.Layer(ms.Picture(first, soft[::6]), 0.35 * TOP, left=-20, top=1),
            ms.Layer(ms.Picture(second), -0.6 * TOP, left=25, top=-1),
        )
    )


def capture(picture, motion, shutter=SHUTTERS["hann"], scene=SCENE, **options):
    return np.asarray(ms.simulate_capture(picture, scene, motion, shutter, **options))


@pytest.mark.parametrize("border", ["reflect", "wrap"])
@pytest.mark.parametrize("columns", [1, 53, 120], ids=["one", "prime", "even"])
@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)
def test_a_capture_is_the_scene_at_each_instant(motion, columns, border):
    """At rest, slow and past the top speed, between pixels, under a light that jumps.

    The exposure of the fastest is longer than any of the pictures.
    """
    picture = rows(2, columns, 1)
    for shutter, speed, displacement in (
        (SHUTTERS["hann"], 0.0, 0.37),
        (SHUTTERS["rect"], 0.23 * TOP, 0.0),
        (CHIPPED, -2.3 * TOP, -41.2),
    ):
        options = {"speed": speed, "displacement": displacement, "border": border}
        found = capture(picture, motion, shutter, **options)
        breaks = np.linspace(-1, 1, 7)
        wanted = captured_picture(picture, motion, shutter, breaks=breaks, **options)
        np.testing.assert_allclose(found, wanted, atol=ROUNDING)


@pytest.mark.parametrize("border", ["edge", "zero"])
@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)
def test_a_capture_beyond_borders_that_do_not_repeat(motion, border):
    """A photograph goes on as its last pixel, or dark, as far as its light comes from."""
    picture = photograph(2, 97)
    options = {"speed": 0.31 * TOP, "displacement": 0.37, "border": border}
    wanted = captured_picture(picture, motion, SHUTTERS["hann"], **options)
    np.testing.assert_allclose(capture(picture, motion, **options), wanted, atol=WAVES)


def test_a_capture_through_optics():
    """A picture, layers and footage are blurred by the lens, and above its cutoff left out."""
    optics, picture = {"cutoff": 0.29, "lens": 0.83}, rows(2, 80, 1)
    lens = ms.Optics(cutoff_frequency=0.29, lens_blur=0.83)
    scene = ms.Scene([0.0], photon_rate=4e5, read_noise=6.0, optics=lens)
    wanted = captured_picture(picture, MOVING, SHUTTERS["hann"], **optics)
    for subject in (
        picture,
        ms.Layers((ms.Layer(ms.Picture(picture)),)),
        ms.Footage.of([picture, picture]),
    ):
        np.testing.assert_allclose(capture(subject, MOVING, scene=scene), wanted, atol=ROUNDING)
    layers = three_layers()
    found = capture(layers, MOVING, scene=scene)
    wanted = captured_layers(layers, MOVING, SHUTTERS["hann"], **optics)
    # Each period ends at a wave of its own below the cutoff.
    np.testing.assert_allclose(found, wanted, atol=3 * WAVES)


def test_single_precision_is_captured_as_double():
    """Pictures, layers and footage keep their precision, and lose no more than it holds."""
    picture = rows(2, 90, 1).astype(np.float32)
    for subject in (picture, ms.Layers((ms.Layer(ms.Picture(picture)),)), ms.Footage.of([picture])):
        found = capture(subject, MOVING)
        assert found.dtype == np.float32
        wanted = captured_picture(picture.astype(np.float64), MOVING, SHUTTERS["hann"])
        np.testing.assert_allclose(found, wanted, atol=3e-7)
    single = {"half_exposure": np.float32(HALF), "acceleration": np.float32(27.0 / HALF**2)}
    scene = ms.Scene(np.zeros(1, np.float32), photon_rate=4e5, read_noise=6.0)
    found = ms.simulate_capture(
        picture, scene, ms.ParabolicMotion(**single), ms.HannShutter(), speed=700.0
    )
    assert found.dtype == np.float32
    wanted = captured_picture(picture.astype(float), MOVING, SHUTTERS["hann"], speed=700.0)
    np.testing.assert_allclose(found, wanted, atol=3e-6)


@pytest.mark.parametrize("speed", [310.0, -1900.0])
@pytest.mark.parametrize("motion", [MOVING, STILL], ids=["moving", "still"])
def test_the_kernel_for_other_libraries(motion, speed):
    """SciPy's convolution with it is the capture of a picture without detail near the pixels'.

    Its middle shifts nothing.
    """
    from scipy.signal import convolve

    column = np.arange(170)
    waves = np.cos(2 * np.pi * np.outer([0.03, 0.17, 0.35], column) + np.arange(3)[:, None])
    picture = np.sin(np.pi * column / 169) ** 4 * (1 + waves)
    kernel = ms.centred_kernel(motion, ms.HannShutter(), speed=speed)
    assert kernel.shape[0] == 1
    assert kernel.shape[1] % 2 == 1
    assert np.sum(kernel) == pytest.approx(0.5, abs=1e-5)
    found = convolve(picture, kernel, mode="same")
    wanted = capture(picture, motion, speed=speed, border="zero")
    np.testing.assert_allclose(found, wanted, atol=WAVES)


@pytest.mark.parametrize(
    ("motion", "speed", "blur"), [(MOVING, 310.0, 0.7), (MOVING, 310.0, 4.1), (STILL, 0.0, 16.0)]
)
def test_the_kernel_for_other_libraries_behind_a_lens(motion, speed, blur):
    """SciPy's convolution with it is the capture through that lens."""
    from scipy.signal import convolve

    column = np.arange(230)
    picture = np.sin(np.pi * column / 229) ** 4 * (1 + np.cos(0.9 * column[None] + 0.3))
    kernel = ms.centred_kernel(motion, ms.HannShutter(), speed=speed, lens_blur=blur)
    scene = ms.Scene([0.0], photon_rate=4e5, read_noise=6.0, optics=ms.Optics(lens_blur=blur))
    wanted = capture(picture, motion, scene=scene, speed=speed, border="zero")
    np.testing.assert_allclose(convolve(picture, kernel, mode="same"), wanted, atol=WAVES)
    with pytest.raises(ValueError, match=r"`centred_kernel\(lens_blur=...\)` must be at least 0"):
        ms.centred_kernel(MOVING, ms.HannShutter(), lens_blur=-blur)


@pytest.mark.slow
def test_a_capture_differentiates_by_the_shutter():
    """Forward and reverse mode, against a difference; motion and speed are numbers."""
    picture = rows(3, 40, 1)

    def light(taper):
        shutter = ms.TukeyShutter(taper)
        return jnp.sum(ms.simulate_capture(picture, SCENE, MOVING, shutter, speed=310.0) ** 2)

    slope = jax.jit(jax.grad(light))(0.37)
    single = jax.jit(jax.grad(light))(jnp.float32(0.37))
    assert single.dtype == np.float32
    np.testing.assert_allclose(single, slope, rtol=1e-4)
    np.testing.assert_allclose(slope, jax.jacfwd(light)(0.37), rtol=1e-11)
    difference = (light(0.37 + 1e-5) - light(0.37 - 1e-5)) / 2e-5
    np.testing.assert_allclose(slope, difference, rtol=1e-7)


@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)
def test_scene_beyond_the_sensor(motion):
    """With `border="scene"` the capture is the middle of the capture of a larger picture."""
    from mishutter.camera.capture import captured_columns

    whole = photograph(3, 400)
    seen = captured_columns(motion, 99.0, 200)
    inner = capture(whole[:, 100:300], motion, speed=99.0, border="scene")
    wanted = capture(whole, motion, speed=99.0)[:, 100:300][:, seen]
    # Detail as fine as the pixels' is not known to the last pixel.
    np.testing.assert_allclose(inner, wanted, atol=1e-2)
    np.testing.assert_allclose(inner[:, 20:-20], wanted[:, 20:-20], atol=3e-4)


def test_noise_has_the_variance_of_equation_four():
    """Mean and variance of the noise are the light and `f/p + (sigma/p)^2`, within 4 sigma."""
    p = float(SCENE.photon_rate) * 2 * HALF
    noisy = flat_capture(0.3, p, 6.0, shape=(200, 500), key=jax.random.key(3))
    variance = float(noise_power(1.0, 0.3, p, 6.0, unit=p))
    assert variance == pytest.approx(0.3 / p + (6.0 / p) ** 2)
    assert abs(noisy.mean() - 0.3) < 4 * np.sqrt(variance / noisy.size)
    assert noisy.var() == pytest.approx(variance, rel=4 * np.sqrt(2 / noisy.size))


@pytest.mark.parametrize("mean", [0.0, 0.3, 40.0, 3e7, 4e16])
def test_shot_noise_is_poisson(mean):
    """Mean and variance are the number expected, from none to more than can be counted."""
    white = max(mean, 1.0)
    drawn = flat_capture(mean / white, white, shape=(200, 200), key=jax.random.key(5)) * white
    assert abs(drawn.mean() - mean) <= 4 * np.sqrt(mean / drawn.size)
    fourth = np.sqrt((2 * mean**2 + mean) / drawn.size)
    assert abs(drawn.var() - mean) <= 5 * fourth


def test_no_two_runs_of_pixels_have_the_same_noise():
    """However many pixels there are, none's noise is another's: sums over lags stay small."""
    drawn = flat_capture(1.0, 40.0, shape=(3 * RUN // 256, 256), key=jax.random.key(5)) * 40 - 40
    first, second, third = drawn.reshape(3, -1) / np.sqrt(40)
    for one, other in ((first, second), (second, third), (first, third)):
        assert abs(np.mean(one * other)) < 5 / np.sqrt(RUN)


@pytest.mark.slow
def test_noise_is_held_where_a_capture_differentiates():
    """A noisy capture moves with its light as one without noise does."""
    picture = rows(3, 60, 1)

    def slope(key):
        def light(taper):
            shutter = ms.TukeyShutter(taper)
            return jnp.sum(ms.simulate_capture(picture, SCENE, MOVING, shutter, key=key))

        return jax.grad(light)(0.4)

    np.testing.assert_allclose(slope(jax.random.key(3)), slope(None), rtol=1e-12)
    assert slope(None) < 0


@pytest.mark.slow
def test_a_key_gives_the_same_noise_compiled_and_batched():
    """`jit` and `vmap` over keys draw what single calls draw, and keys differ."""
    light = jnp.asarray(rows(6, 30, 1)[..., 0])
    keys = jax.random.split(jax.random.key(2), 3)

    def capture(key):
        return ms.simulate_capture(light, SCENE, MOVING, ms.HannShutter(), key=key)

    each = np.stack([capture(key) for key in keys])
    np.testing.assert_allclose(jax.vmap(capture)(keys), each, atol=1e-12)
    np.testing.assert_allclose(jax.jit(capture)(keys[1]), each[1], atol=1e-12)
    assert np.all(each[0] != each[1])


def test_without_noise_it_does_not_matter_how_much_light_there_is():
    """A capture is in units of white, also where white is no electron at all."""
    dark = ms.Scene([0.0], photon_rate=0.0, read_noise=6.0)
    found = [ms.simulate_capture(rows(), s, MOVING, ms.HannShutter()) for s in (dark, SCENE)]
    np.testing.assert_allclose(*found, atol=1e-12)


def test_a_closed_shutter_records_darkness():
    """Layers and frames of which no light falls on the sensor are black, not an error."""
    closed = ms.ChippedShutter([0.0, 0.0])
    picture = ms.Picture(rows(2, 90, 1).astype(np.float32))
    layers = ms.Layers((ms.Layer(picture), ms.Layer(picture, 300.0, left=9)))
    for subject in (layers, ms.Footage.of([picture.light, picture.light])):
        assert not np.any(ms.simulate_capture(subject, SCENE, MOVING, closed))


@pytest.mark.parametrize("motion", [STILL, MOVING])
def test_layers_at_rest_get_the_light_of_a_narrow_profile(motion):
    """However long nothing crosses an edge, the light of that time is integrated exactly."""
    shutter = ms.GaussianShutter(0.05)
    layers = ms.Layers((ms.Layer(ms.Picture(np.ones((2, 90, 1), np.float32))),))
    light = ms.simulate_capture(layers, SCENE, motion, shutter)
    np.testing.assert_allclose(light, float(shutter.efficiency()), rtol=1e-6)


@pytest.mark.parametrize("speed", [0.0, 0.3 * TOP])
def test_a_parabola_of_no_acceleration_captures_as_a_camera_at_rest(speed):
    """Its light is not lost, and it is aligned, modelled and layered as a still camera's."""
    parked = ms.ParabolicMotion(acceleration=0.0, half_exposure=HALF)
    light = rows(3, 120, 1)
    layers = ms.Layers((ms.Layer(ms.Picture(light.astype(np.float32)), speed),))

    def found(motion):
        model = blur_model(SCENE, motion, ms.HannShutter())
        return [
            ms.simulate_capture(light, SCENE, motion, ms.HannShutter(), speed=speed),
            ms.simulate_capture(layers, SCENE, motion, ms.HannShutter()),
            ms.centred_kernel(motion, ms.HannShutter(), speed=speed),
            np.abs(model.responses(240)),
        ]

    for first, second in zip(found(parked), found(STILL), strict=True):
        np.testing.assert_array_equal(first, second)
        assert np.sum(first) > 0


def test_full_well_and_converter():
    """Light is cut at the full well and rounded to the converter's steps, both ends included."""
    light = np.linspace(0.0, 1.5, 41)[:, None]  # none half-way between two of the steps

    def recorded(**limits):
        return flat_capture(light, 1000.0, shape=(41, 1), **limits)

    np.testing.assert_allclose(recorded(full_well=800.0), np.minimum(light, 0.8), atol=1e-12)
    stepped = np.round(np.clip(light, 0, 1) * 7) / 7
    np.testing.assert_allclose(recorded(adc_bits=3), stepped, atol=1e-12)
    both = recorded(full_well=800.0, adc_bits=3)
    steps = np.round(np.minimum(light / 0.8, 1) * 7)
    np.testing.assert_allclose(both, 0.8 * steps / 7, atol=1e-12)


def test_read_noise_goes_beyond_a_full_well():
    """A full well cuts off what is collected, not what is read: noise lies to either side."""
    limits = {"key": jax.random.key(3), "full_well": 800.0}
    found = flat_capture(1.3, 1000.0, 9.0, shape=(30, 40), **limits)
    np.testing.assert_allclose(found.mean(), 0.8, atol=4 * 0.009 / np.sqrt(found.size))
    np.testing.assert_allclose(found.std(), 0.009, rtol=4 / np.sqrt(2 * found.size))


@pytest.mark.parametrize("name", SHUTTERS)
def test_layers_are_composited_at_each_instant(name):
    """Objects enter, leave and cross one another, past hard and soft edges."""
    scene = three_layers()
    wanted = captured_layers(scene, MOVING, SHUTTERS[name])
    np.testing.assert_allclose(capture(scene, MOVING, SHUTTERS[name]), wanted, atol=WAVES)


@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)
def test_one_layer_is_a_picture(motion):
    """Without occlusion it is captured as a picture is, but aligned at mid-exposure."""
    picture, speed = ms.Picture(rows(2, 151, 1)), 0.2 * TOP
    a = float(motion.acceleration)
    vertex = (speed - float(motion.velocity)) ** 2 / (4 * a) if a else 0.0
    alone = capture(ms.Layers((ms.Layer(picture, speed),)), motion)
    plain = capture(picture, motion, speed=speed, displacement=-vertex)
    np.testing.assert_allclose(alone, plain, atol=ROUNDING)


def test_an_opaque_layer_in_front_hides_all():
    """Under an opaque layer that covers the sensor throughout, nothing shows."""
    front = ms.Layer(ms.Picture(rows(3, 400, 1, seed=4)), 300.0, left=-170)
    backs = rows(3, 60, 1), np.zeros((3, 60, 1))
    found = [capture(ms.Layers((ms.Layer(ms.Picture(x)), front)), MOVING) for x in backs]
    np.testing.assert_allclose(*found, atol=5e-4)


def test_footage_of_a_still_scene_is_a_picture():
    """Frames that do not change are captured as the picture they show, one frame included."""
    picture = rows(4, 120, 3)
    wanted = ms.simulate_capture(picture, SCENE, MOVING, ms.HannShutter())
    for count in (1, 9):
        frames = ms.Footage((picture for _ in range(count)), count)
        found = ms.simulate_capture(frames, SCENE, MOVING, ms.HannShutter())
        np.testing.assert_allclose(found, wanted, atol=1e-12)


def test_footage_shows_each_frame_for_its_share():
    """A camera at rest sees the frames weighted by the shutter over each one's time."""
    frames = np.broadcast_to(rows(5, 1, 1)[:, None], (5, 1, 30, 1))
    found = ms.simulate_capture(ms.Footage.of(frames), SCENE, STILL, ms.TriangleShutter())
    ends = np.linspace(-1, 1, 6)
    share = np.diff(np.sign(ends) * (np.abs(ends) - ends**2 / 2)) / 2
    np.testing.assert_allclose(found, np.tensordot(share, frames, 1), atol=1e-12)


@pytest.mark.parametrize("speed", [0.0, 0.31 * TOP, -0.7 * TOP])
@pytest.mark.parametrize("kind", PANNING)
def test_a_photograph_on_a_sensor_that_pans(kind, speed):
    """It is the scene at each instant, and the capture at the shifted speed."""
    picture, motion = rows(3, 260, 1), PANNING[kind]
    found = capture(picture, motion, speed=speed)
    same = capture(picture, AT_REST[kind], speed=speed - PAN)
    np.testing.assert_allclose(found, same, atol=ROUNDING)
    wanted = captured_picture(picture, motion, SHUTTERS["hann"], speed=speed)
    np.testing.assert_allclose(found, wanted, atol=ROUNDING)
    kernel = ms.centred_kernel(motion, ms.HannShutter(), speed=speed)
    np.testing.assert_allclose(
        kernel, ms.centred_kernel(AT_REST[kind], ms.HannShutter(), speed=speed - PAN), atol=ROUNDING
    )


def test_a_fast_pan_along_with_a_fast_object_rounds_nothing():
    """Single-precision light under speeds that all but cancel is that of their difference."""
    picture, velocity = rows(2, 200, 1).astype(np.float32), 9e6
    motion = MOVING.panned(velocity)
    found = ms.simulate_capture(picture, SCENE, motion, ms.HannShutter(), speed=velocity + 311.25)
    same = ms.simulate_capture(picture, SCENE, MOVING, ms.HannShutter(), speed=311.25)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, same, atol=1e-7)


@pytest.mark.parametrize("kind", PANNING)
def test_layers_on_a_sensor_that_pans(kind):
    """They are composited at each instant, and captured as at the shifted speeds."""
    scene = three_layers()
    shifted = [ms.Layer(x.picture, x.speed - PAN, x.left, x.top) for x in scene.layers]
    found = capture(scene, PANNING[kind])
    same = capture(ms.Layers(tuple(shifted)), AT_REST[kind])
    np.testing.assert_allclose(found, same, atol=ROUNDING)
    wanted = captured_layers(scene, PANNING[kind], SHUTTERS["hann"])
    np.testing.assert_allclose(found, wanted, atol=WAVES)


def test_a_layer_that_only_panning_brings_onto_the_sensor():
    """An object beside the sensor is recorded where the sensor pans towards it, on either side."""
    back, front = ms.Picture(np.zeros((3, 60, 1))), ms.Picture(np.ones((3, 8, 1)))
    for sign, left in ((1, -10), (-1, 62)):
        layers = ms.Layers((ms.Layer(back), ms.Layer(front, 0.0, left=left)))
        motion = ms.LinearMotion(half_exposure=HALF, velocity=sign * 20 / HALF)
        found = capture(layers, motion, ms.RectShutter())
        assert np.max(found) > 0.1
        wanted = captured_layers(layers, motion, ms.RectShutter())
        np.testing.assert_allclose(found, wanted, atol=WAVES)


@pytest.mark.slow
@pytest.mark.parametrize("border", ["reflect", "edge", "wrap", "zero"])
@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)
def test_footage_is_exposed_frame_by_frame(motion, border):
    """Each frame is of a camera at rest: it is displaced by v t + a t^2 while it shows."""
    frames = np.stack([photograph(2 + i, 90)[-2:] for i in range(5)])
    allowed = ROUNDING if border in ("reflect", "wrap") else WAVES
    for shutter in (SHUTTERS["hann"], CHIPPED):
        found = capture(ms.Footage.of(frames, border), motion, shutter)
        breaks = np.linspace(-1, 1, 7)
        wanted = captured_footage(frames, motion, shutter, border=border, breaks=breaks)
        np.testing.assert_allclose(found, wanted, atol=allowed)


@pytest.mark.parametrize("columns", [61, 90])
def test_an_edge_goes_back_to_the_first_pixel_as_it_left_the_last(columns):
    """The slope is the middle third of the gap, and as far from the one as from the other."""
    period = period_of(columns, 20, "edge")
    row = np.linspace(0.2, 0.9, columns)
    gap = continued(row, period, "edge")[columns:]
    third = gap.size // 3
    np.testing.assert_allclose(gap[:third], 0.9)
    np.testing.assert_allclose(gap[2 * third :], 0.2)
    slope = gap[third : 2 * third]
    np.testing.assert_allclose(np.diff(slope), -0.7 / third)
    np.testing.assert_allclose(slope + slope[::-1], 0.2 + 0.9)


@pytest.mark.parametrize("kind", PANNING)
def test_footage_that_stands_still_is_a_layer(kind):
    """Both are aligned at mid-exposure."""
    picture, motion = rows(2, 90, 1), PANNING[kind]
    found = capture(ms.Footage.of([picture] * 5), motion)
    alone = capture(ms.Layers((ms.Layer(ms.Picture(picture)),)), motion)
    np.testing.assert_allclose(found, alone, atol=ROUNDING)


FOOTAGE = {
    "negative": ([-rows()], "`Footage(frames=...)` must hold light of at least 0; got -"),
    "nan": ([np.nan * rows()], "`Footage(frames=...)` must hold finite light; got"),
    "coded": ([np.ones((2, 3, 1), np.uint8)], "must hold light, white = 1, as floating-point numb"),
    "two-channels": ([np.ones((2, 3, 2))], "must be pictures; got shape (2, 3, 2)"),
    "two-sizes": ([rows(), rows(5)], "must all have shape (7, 260, 3); got shape (5, 260, 3)"),
}


@pytest.mark.parametrize("slug", FOOTAGE)
def test_footage_that_is_none(slug):
    """A frame is refused as a picture is, and where it is unlike the one before."""
    frames, message = FOOTAGE[slug]
    with pytest.raises(ValueError, match=re.escape(message)):
        ms.simulate_capture(ms.Footage.of(frames), SCENE, STILL, ms.HannShutter())


def test_footage_of_another_length():
    """As many frames as were said must come, and at least one."""
    for count in (1, 3):
        frames = ms.Footage(iter([rows(), rows()]), count)
        with pytest.raises(ValueError, match=rf"must be the 2 that came; got {count}"):
            ms.simulate_capture(frames, SCENE, STILL, ms.HannShutter())
    with pytest.raises(
        ValueError, match=r"`Footage.of\(frames=...\)` must hold at least one frame"
    ):
        ms.Footage.of([])


def test_layers_that_are_none():
    """There is a background, it is opaque, and it goes on by a rule that is known."""
    clear = ms.Layer(ms.Picture(rows(), np.full((7, 260), 0.4)))
    with pytest.raises(ValueError, match=r"must hold at least one layer and .*; got \(\)"):
        ms.Layers(())
    with pytest.raises(ValueError, match=r"`Layer\(picture=...\)` must be a `Picture`; got \[\["):
        inspect.unwrap(ms.Layer.__post_init__)(SimpleNamespace(picture=np.ones((2, 3))))
    with pytest.raises(ValueError, match="must begin with an opaque layer; got"):
        ms.Layers((clear,))
    with pytest.raises(ValueError, match=r"must be one of .*'reflect'.*; got 'scene'"):
        ms.Layers((ms.Layer(ms.Picture(rows())),), border="scene")


def test_footage_from_a_folder_and_a_video(tmp_path):
    """Pictures of a folder are frames in the order of their names; so are those of a video."""
    picture = rows(32, 48, 3)
    for index in range(3):
        ms.write_picture(tmp_path / f"{index}.png", picture * (index + 1) / 3)
    frames = ms.read_frames(tmp_path)
    levels = [float(f.mean()) for f in frames.frames]
    assert frames.num_frames == 3
    assert levels == sorted(levels)


@pytest.mark.filterwarnings("ignore")
def test_footage_from_a_video_of_one_frame(tmp_path):
    """A video with one frame is captured as a picture; what is no video gets one line."""
    video = ms.read_frames(film(tmp_path / "one.mp4", "-pix_fmt", "yuv420p", num_frames=1))
    assert video.num_frames == 1
    found = ms.simulate_capture(video, SCENE, MOVING, ms.HannShutter())
    assert found.shape == (96, 160, 3)
    (tmp_path / "bad.mp4").write_text("no video")
    with pytest.raises(ValueError, match="must name a whole video; got"):
        ms.read_frames(tmp_path / "bad.mp4")


def test_layers_from_a_file(tmp_path):
    """A layered scene is read from TOML, paths from the file's place, mattes without gamma."""
    ms.write_picture(tmp_path / "back.png", rows(6, 20, 3))
    ms.write_picture(tmp_path / "front.png", rows(4, 5, 3))
    matte = np.linspace(0, 1, 20).reshape(4, 5)
    ms.write_picture(tmp_path / "matte.png", matte**2.2)
    text = (
        '[[layers]]\npicture = "back.png"\n[[layers]]\npicture = "front.png"\n'
        'matte = "matte.png"\nspeed_px_per_s = -40.5\nleft = 3\n'
    )
    (tmp_path / "scene.toml").write_text(text)
    scene = ms.Layers.load(tmp_path / "scene.toml")
    np.testing.assert_allclose(scene.layers[1].matte, matte, atol=1e-4)
    told = text.replace('back.png"', 'back.png"\nwhite = 65545\nlinear = true')
    (tmp_path / "told.toml").write_text(told)
    light = ms.Layers.load(tmp_path / "told.toml").layers[0].picture.light
    wanted = scene.layers[0].picture.light ** (1 / 2.2) * (65535 / 65545)
    np.testing.assert_allclose(light, wanted, atol=1e-6)
    assert (scene.layers[1].speed, scene.layers[1].left) == (-40.5, 3)
    refusals = {
        "matte.png": (
            '[[layers]]\npicture = "front.png"\nmatte = "back.png"',
            "must be as large as its picture",
        ),
        "layers": ("[[layers]]\npicture = 3", r"`layers\[0\].picture` must be text; got 3"),
        "other": (
            'colour = 1\n[[layers]]\npicture = "back.png"',
            r"bad.toml: the file must hold known keys only \(.*layers.*\); got 'colour'",
        ),
        "unit": (
            '[[layers]]\npicture = "back.png"\nspeed = 3',
            "perhaps `layers.speed_px_per_s`; got 'speed'",
        ),
        "far": (
            '[[layers]]\npicture = "back.png"\nleft = 99999999999999999999',
            r"bad.toml: `layers\[0\].left` must be at most 1000000000; got 9999",
        ),
        "fast": (
            '[[layers]]\npicture = "back.png"\nspeed_px_per_s = 1e300',
            r"bad.toml: `layers\[0\].speed_px_per_s` must be at most 1e\+07; got 1e\+300",
        ),
        "not toml": ("layers = [", "must be a TOML file"),
        "deep": ("layers = " + "[" * 5000, "must be a TOML file; got: brackets nested too"),
    }
    for text, message in refusals.values():
        (tmp_path / "bad.toml").write_text(text)
        with pytest.raises(ValueError, match=message):
            ms.Layers.load(str(tmp_path / "bad.toml"))
    with pytest.raises(FileNotFoundError, match=r"must name a TOML file; got .*not found"):
        ms.Layers.load(str(tmp_path / "none.toml"))


@pytest.mark.parametrize("options", [{"speed": 300.0}, {"border": "zero"}])
def test_layers_bring_their_own_speeds_and_borders(options):
    """A speed or a border beside layers is refused rather than ignored, whoever captures."""
    alone = ms.Layers((ms.Layer(ms.Picture(rows(2, 40, 1))),))
    for capture in (ms.simulate_capture, ms.capture_and_restore):
        with pytest.raises(ValueError, match="must be left to layers and frames; got"):
            capture(alone, SCENE, MOVING, ms.HannShutter(), **options)


def test_layers_beyond_reach():
    """A layer farther off than any sensor reaches is refused where it is made."""
    with pytest.raises(ValueError, match=r"`Layer\(left=...\)` must lie within 1e\+09 px; got"):
        ms.Layer(ms.Picture(rows()), left=10**20)


@pytest.mark.parametrize("kind", [np.uint8, np.uint16, np.float32])
def test_a_matte_is_the_same_in_any_file(kind, tmp_path):
    """8 and 16 bits and floating point, in a TIFF or a PNG: opacity without gamma."""
    import tifffile

    coded = np.arange(20, dtype=np.uint8).reshape(4, 5) * np.uint8(13)
    matte = coded / np.float32(255)
    stored = matte if kind == np.float32 else coded.astype(kind) * (np.iinfo(kind).max // 255)
    tifffile.imwrite(tmp_path / "matte.tif", stored.astype(kind))
    ms.write_picture(tmp_path / "back.png", rows(4, 5, 3))
    back = '[[layers]]\npicture = "back.png"\n'
    (tmp_path / "scene.toml").write_text(back + back + 'matte = "matte.tif"\n')
    found = ms.Layers.load(str(tmp_path / "scene.toml")).layers[1].matte
    np.testing.assert_allclose(found, matte, atol=1e-7)


def test_pictures_narrower_than_the_kernel():
    """One pixel, one row and pictures narrower than the kernel are captured, or say why not."""
    flat = ms.simulate_capture(np.full((1, 1), 0.4), SCENE, MOVING, ms.HannShutter())
    np.testing.assert_allclose(flat, 0.2, atol=1e-12)
    with pytest.raises(ValueError, match=r"must have a picture of at least .* columns; got 20"):
        ms.simulate_capture(rows(2, 20), SCENE, MOVING, ms.HannShutter(), border="scene")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"border": "mirror"}, r"border=...\)` must be one of scene, reflect"),
        ({"speed": np.nan}, r"speed=...\)` must be finite"),
        ({"speed": 1e9}, r"`simulate_capture\(speed=...\)` must blur over at most 8192 px"),
        ({"displacement": -1e12, "border": "zero"}, "be within 8192 px of a picture that ends"),
        ({"full_well": 0.0}, "must be above 0 e- and finite; got 0.0"),
        ({"full_well": np.inf, "adc_bits": 8}, "must be above 0 e- and finite; got inf"),
        ({"adc_bits": 0}, "must be a positive integer"),
        ({"adc_bits": 30}, "must be at most 24"),
    ],
)
def test_refusals(change, message):
    """What a capture cannot be made of is refused in one line."""
    with pytest.raises(ValueError, match=message):
        ms.simulate_capture(rows(), SCENE, MOVING, ms.HannShutter(), **change)


@pytest.mark.parametrize(
    ("motion", "speed", "subject"),
    [
        (ms.ParabolicMotion(acceleration=1e8 / 0.01**2, half_exposure=0.01), 0.0, "motion"),
        (ms.LinearMotion(half_exposure=0.01, velocity=-1e10), 30.0, "motion"),
        (ms.StillCamera(half_exposure=0.01), 1e10, "speed"),
    ],
    ids=["stroke", "pan", "speed"],
)
def test_light_that_travels_too_far_is_refused_before_anything_is_made(motion, speed, subject):
    """By captures of pictures, layers and footage, and by decoders, which name what is too much."""
    picture, shutter = rows(4, 96), ms.HannShutter()
    scene = ms.Scene([speed, 0.5 * speed], photon_rate=1e5, read_noise=4.0)
    back = ms.Picture(picture[..., :1])
    layers = ms.Layers((ms.Layer(back), ms.Layer(back, speed=speed)))
    names = {"speed": [r"simulate_capture\(speed=...\)", r"Layer\(speed=...\)", "scene"]}
    told = names.get(subject, ["motion"] * 3)
    calls = [
        (told[0], lambda: ms.simulate_capture(picture, SCENE, motion, shutter, speed=speed)),
        (told[1], lambda: ms.simulate_capture(layers, SCENE, motion, shutter)),
        (told[2], lambda: ms.deconvolve(picture, scene, motion, shutter)),
        (told[2], lambda: blur_model(scene, motion, shutter)),
        (told[2], lambda: ms.estimate_speed(picture, scene, motion, shutter)),
    ]
    if subject == "motion":
        footage = ms.Footage([picture] * 3, 3)
        calls.append(("motion", lambda: ms.simulate_capture(footage, SCENE, motion, shutter)))
    tracemalloc.start()
    try:
        for name, call in calls:
            with pytest.raises(ValueError, match=rf"^`{name}` must blur over at most 8192 px; got"):
                call()
        assert tracemalloc.get_traced_memory()[1] < 16 * 2**20
    finally:
        tracemalloc.stop()


def test_a_displaced_picture_goes_and_comes_as_far_as_it_is_told():
    """By more than the margin beyond the blur: one that has left does not come round again."""
    light, still = rows(3, 70), ms.StillCamera(half_exposure=0.002)
    wide = np.pad(light, ((0, 0), (300, 300), (0, 0)))
    capture = partial(
        ms.simulate_capture,
        scene=SCENE,
        motion=still,
        shutter=ms.HannShutter(),
        border="zero",
    )
    around = np.asarray(capture(wide))
    for shift in (-260, -150, 31, 83, 190):
        there = np.asarray(capture(light, displacement=float(shift)))
        assert np.max(np.abs(there - around[:, 300 - shift : 370 - shift])) < 10 * WAVES


def test_half_precision_is_computed_in_single():
    """What no Fourier transform takes is widened."""
    picture = rows().astype(np.float16)
    found = ms.simulate_capture(picture, SCENE, MOVING, ms.HannShutter())
    assert found.dtype == np.float32
    wanted = ms.simulate_capture(picture.astype(np.float32), SCENE, MOVING, ms.HannShutter())
    np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize("kind", [">f4", ">f8", np.longdouble])
def test_numbers_of_other_makers(kind):
    """In another order of bytes, as FITS files hold them, or longer, they are the same light."""
    picture = rows().astype(kind)
    precision = np.float32 if picture.itemsize == 4 else np.float64
    plain = rows().astype(precision)
    for capture in (ms.simulate_capture, ms.capture_and_restore):
        of_plain = capture(plain, SCENE, MOVING, ms.HannShutter())
        of_these = capture(picture, SCENE, MOVING, ms.HannShutter())
        np.testing.assert_array_equal(np.asarray(of_these), np.asarray(of_plain))
    assert ms.Picture(picture).light.dtype == precision
    found = ms.deconvolve(picture, SCENE, MOVING, ms.HannShutter())
    wanted = ms.deconvolve(plain, SCENE, MOVING, ms.HannShutter())
    np.testing.assert_array_equal(found, wanted)


@pytest.mark.parametrize("kind", ["u1", "<u2", ">u2", "i2", "i4", "u4"])
def test_levels_are_no_light(kind):
    """Whole numbers, as files hold them, are refused wherever light is asked for."""
    levels = (rows() * 120).astype(kind)
    message = f"as floating-point numbers.*; got {levels.dtype.name}"
    for takes in (ms.simulate_capture, ms.deconvolve, ms.capture_and_restore):
        with pytest.raises(ValueError, match=message):
            takes(levels, SCENE, MOVING, ms.HannShutter())
    with pytest.raises(ValueError, match=rf"`Picture\(light=...\)` must .*{message}"):
        ms.Picture(levels)
    with pytest.raises(ValueError, match=rf"`psnr\(estimate=...\)` must .*{message}"):
        ms.psnr(rows(), levels)


def test_pictures_that_are_none():
    """A value that is not light is refused before anything is computed."""
    bad = rows()
    bad[1, 2, 0] = np.nan
    with pytest.raises(ValueError, match=r"picture=...\)` must be finite"):
        ms.simulate_capture(bad, SCENE, MOVING, ms.HannShutter())
    coded = (rows() * 255).astype(np.uint8)
    with pytest.raises(ValueError, match=r"picture=...\)` must hold light, white = 1, .*; got .*8"):
        ms.simulate_capture(coded, SCENE, MOVING, ms.HannShutter())
    with pytest.raises(ValueError, match=r"picture=...\)` must have rows and columns; got \(9,\)"):
        ms.simulate_capture(np.ones(9), SCENE, MOVING, ms.HannShutter())
    with pytest.raises(
        ValueError, match=r"picture=...\)` must hold at least one pixel; got \(0, 9\)"
    ):
        ms.simulate_capture(np.ones((0, 9)), SCENE, MOVING, ms.HannShutter())
    with pytest.raises(ValueError, match=r"`deconvolve\(captured=...\)` must be finite"):
        ms.deconvolve(bad, SCENE, MOVING, ms.HannShutter())
    with pytest.raises(ValueError, match=r"picture=...\)` must be at least 0; got -0.3"):
        ms.simulate_capture(np.full((2, 9), -0.3), SCENE, MOVING, ms.HannShutter())
    dark = ms.Scene([0.0], photon_rate=0.0, read_noise=1.0)
    with pytest.raises(ValueError, match="must have a photon rate above 0"):
        ms.simulate_capture(rows(), dark, MOVING, ms.HannShutter(), key=jax.random.key(1))


def test_large_pictures_by_rows_are_small_ones():
    """Rows done in portions give what they give at once, and progress runs to its end."""
    seen = []
    whole = ms.simulate_capture(rows(), SCENE, MOVING, ms.HannShutter())
    parts = ms.capture_and_restore(
        rows(),
        SCENE,
        MOVING,
        ms.HannShutter(),
        rows_at_once=3,
        progress=lambda text, share: seen.append(share),
    )
    np.testing.assert_allclose(parts.captured, whole, atol=1e-12)
    restored = ms.deconvolve(whole, SCENE, MOVING, ms.HannShutter())
    np.testing.assert_allclose(parts.restored, restored, atol=1e-9)
    assert seen[-1] == 1.0
    assert seen == sorted(seen)


def test_portions_have_noise_of_their_own():
    """Rows that show the same are not recorded the same, in whichever portion they are."""
    flat, key = np.full((6, 90, 1), 0.4), jax.random.key(3)
    given = flat, SCENE, MOVING, ms.HannShutter()
    captured = ms.capture_and_restore(*given, key=key, rows_at_once=2).captured
    for one in range(6):
        for other in range(one):
            assert np.any(captured[one] != captured[other])


@pytest.mark.slow
def test_a_grey_picture_stays_one_plane():
    """Rows and columns in, rows and columns out, the same as with a channel."""
    flat, key = np.linspace(0.1, 0.9, 6 * 90).reshape(6, 90), jax.random.key(3)
    given = SCENE, MOVING, ms.HannShutter()
    plane = ms.capture_and_restore(flat, *given, key=key, rows_at_once=4)
    channel = ms.capture_and_restore(flat[..., None], *given, key=key, rows_at_once=4)
    for found, with_axis in zip(plane, channel, strict=True):
        assert found.shape == flat.shape
        np.testing.assert_array_equal(found, with_axis[..., 0])


@pytest.mark.parametrize("border", ["scene", "wrap", "reflect"])
def test_a_mirrored_path_records_the_mirrored_picture(border):
    """A path that loses velocity is aligned at its highest, and its light falls to the left."""
    rising = ms.FreeMotion(accelerations=[4e4, 9e4, 7e4], half_exposure=0.012, velocity=90.0)
    falling = ms.FreeMotion(accelerations=[-4e4, -9e4, -7e4], half_exposure=0.012, velocity=-90.0)
    picture, shutter = rows(3, 151, 1), ms.SplineShutter([0.2, 0.9, 0.7, 0.4, 0.6, 0.3])
    scene = ms.Scene([700.0], photon_rate=1e5, read_noise=5)
    shown = ms.simulate_capture(picture, scene, rising, shutter, speed=700.0, border=border)
    mirrored = ms.simulate_capture(
        picture[:, ::-1], scene, falling, shutter, speed=-700.0, border=border
    )
    np.testing.assert_allclose(mirrored[:, ::-1], shown, atol=1e-9)


@pytest.mark.parametrize(("mode", "passes"), [(3, 1.0), (8, 1.0), (20, 0.0)])
def test_optics_pass_a_wave_that_a_mirror_continues(mode, passes):
    """Half waves over 37 px are of the frequency mode / 74: up to the cutoff as they were."""
    wave = np.cos(np.pi * mode * (np.arange(37) + 0.5) / 37)
    np.testing.assert_allclose(through_optics(wave[None], 0.21)[0], passes * wave, atol=1e-12)
