"""The speed of a whole picture, found in one capture, and restoration by it.

Photographs are captured by the package's camera with scene beyond both borders. Estimates are held
to their own error bars, and to the 2 px of smear that the tried speeds are apart at most.
"""

import json
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, rotate

import mishutter as ms
from mishutter import cli
from mishutter.decoding.decoders.base import blur_model
from mishutter.decoding.decoders.speed_finding import at_speed
from mishutter.decoding.deconvolution import restored_light

# Speeds that are tried and the model at one of them; a decoder returns only its estimate.
from mishutter.evaluation.speed_knowledge import SPEED_KNOWLEDGE

HALF = 0.015
OPEN = ms.RectShutter()
SEEN = slice(120, 632)
"""Columns of a photograph that are captured: light is displaced by no more than is left."""


def camera(velocity=0.0, half=HALF):
    return ms.ParabolicMotion(acceleration=45 / half**2, half_exposure=half, velocity=velocity)


PICTURE = ms.Texture(mean_level=0.21, deviation=0.2)


def scene(low=-4500.0, high=4500.0, **others):
    numbers = {"photon_rate": 1e5, "read_noise": 8.0, "picture": PICTURE}
    return ms.Scene.uniform(min_speed=low, max_speed=high, num_speeds=9, **{**numbers, **others})


def photograph(rows=256):
    return ms.example_picture().light[100 : 100 + rows].astype(np.float64)


def grey(rows=256):
    return ms.example_picture().luminance[100 : 100 + rows].astype(np.float64)


def capture(picture, known, motion, shutter, speed, seed=1, **options):
    whole = ms.simulate_capture(
        picture, known, motion, shutter, speed=speed, key=jax.random.key(seed), **options
    )
    return np.asarray(whole)[:, SEEN]


def is_right(found, speed):
    """Within three of its errors, which are no wider than the speeds that decoders do not mind."""
    return found.trusted and abs(found.speed - speed) < 3 * found.error < 250


@pytest.mark.parametrize("speed", [430.0, -2210.0, 3700.0])
def test_a_speed_is_found(speed):
    """At speeds between those tried; of either sign, which the camera does not see."""
    known = scene()
    found = ms.estimate_speed(capture(grey(), known, camera(), OPEN, speed), known, camera(), OPEN)
    assert is_right(found, abs(speed))
    assert found.doubt == ""
    assert np.sum(found.weights) == pytest.approx(1)
    assert found.speeds.shape == found.weights.shape
    assert np.all(np.diff(found.speeds) > 0)


@pytest.mark.slow
@pytest.mark.parametrize("side", [1, -1])
def test_a_pan_is_in_the_speed(side):
    """Speeds are those of the scene: of the two that blur alike past a pan, the scene's own."""
    low, high = sorted((side * 500.0, side * 5000.0))
    known, motion = scene(low, high), camera(velocity=side * 1000.0)
    given = known, motion, OPEN
    found = ms.estimate_speed(capture(grey(), *given, side * 3530.0), *given)
    assert is_right(found, side * 3530.0)
    assert np.all(np.diff(found.speeds) > 0)


@pytest.mark.slow
@pytest.mark.parametrize("speed", [1730.0, -1730.0])
def test_a_code_that_is_not_symmetric_tells_the_sign(speed):
    """A camera at rest sees the two signs mirrored: only the phase of the blur tells them apart."""
    known, motion = scene(-3000.0, 3000.0, photon_rate=1e6), ms.StillCamera(half_exposure=0.01)
    code = ms.ChippedShutter(ms.RASKAR_CODE)
    found = ms.estimate_speed(capture(grey(), known, motion, code, speed), known, motion, code)
    assert is_right(found, speed)


@pytest.mark.slow
def test_colour_bits_lens_and_device():
    """Three colours, a converter of 8 bits, a lens that blurs, a slow shutter: all known."""
    slow = ms.FirstOrderDevice(rise_time=2e-4, fall_time=2e-4, transmission=0.8)
    for picture, known, shutter, options in (
        (photograph(), scene(), OPEN, {}),
        (grey(), scene(), OPEN, {"adc_bits": 8}),
        (grey(), scene(optics=ms.Optics(lens_blur=1.5)), OPEN, {}),
        (grey(), scene(device=slow), OPEN, {}),
    ):
        given = known, camera(), shutter
        found = ms.estimate_speed(capture(picture, *given, 2960.0, **options), *given)
        assert is_right(found, 2960.0), str(known)


def test_little_detail_is_not_trusted():
    """Few rows, few columns, one pixel, one level: an estimate, and a sentence that doubts it."""
    given = scene(), camera(), OPEN
    seen = capture(grey(24), *given, 2960.0)
    for part in (seen[:20, :100], seen[:3, :70], seen[:2, :9], seen[:1, :1], 0 * seen + 0.2):
        found = ms.estimate_speed(part, *given)
        assert not found.trusted
        assert found.doubt == "The picture has too little detail to show its speed."
        assert np.sum(found.weights) == pytest.approx(1)
        assert np.isfinite([found.speed, found.error]).all()


def test_two_speeds_are_noticed():
    """Halves that move at speeds of their own are a warning that names both."""
    given = scene(), camera(), OPEN
    one, other = (capture(grey(), *given, speed) for speed in (2960.0, 800.0))
    found = ms.estimate_speed(np.concatenate([one[:128], other[128:]]), *given)
    assert not found.trusted
    words = found.doubt.replace(",", "").strip(".").split()
    speeds = sorted(float(word) for word in words if word.isdigit())
    np.testing.assert_allclose(speeds, [800, 2960], atol=40)
    assert {round(found.speed), round(found.second_speed)} == set(speeds)


@pytest.mark.slow
@pytest.mark.parametrize("side", [1, -1])
def test_two_speeds_past_a_pan_are_those_of_the_scene(side):
    """A doubt names the speeds of objects, and not those past the sensor."""
    low, high = sorted((side * 500.0, side * 5000.0))
    known, motion = scene(low, high, decoder_speed="found"), camera(velocity=side * 1000.0)
    given = known, motion, OPEN
    one, other = (capture(grey(), *given, side * speed) for speed in (3960.0, 1900.0))
    halves = np.concatenate([one[:128], other[128:]])
    found = ms.estimate_speed(halves, *given)
    assert not found.trusted
    named = sorted([found.speed, found.second_speed], key=abs)
    np.testing.assert_allclose(named, [side * 1900.0, side * 3960.0], atol=40)
    assert f"{found.speed:,.0f}" in found.doubt
    assert f"{found.second_speed:,.0f} px/s" in found.doubt


@pytest.mark.parametrize("speed", [5800.0, 7500.0, -9000.0])
def test_a_speed_beyond_those_of_the_scene_is_not_trusted(speed):
    """Speeds a tenth of the range beyond are tried; those further out fit none of them."""
    given = scene(), camera(), OPEN
    assert not ms.estimate_speed(capture(grey(), *given, speed), *given).trusted


@pytest.mark.slow
def test_a_tilt_of_three_degrees_is_not_trusted():
    """Where the blur runs across rows, no speed along them explains it."""
    known, motion = scene(), camera()
    turned = rotate(grey(336), -3.0, reshape=False, mode="reflect")
    seen = ms.simulate_capture(np.maximum(turned, 0), known, motion, OPEN, speed=2210.0)
    seen = rotate(np.asarray(seen), 3.0, reshape=False, mode="reflect")[40:-40, SEEN]
    noise = np.sqrt(np.maximum(seen, 0) / 3000 + (8 / 3000) ** 2)
    seen = seen + noise * np.random.default_rng(4).standard_normal(seen.shape)
    assert not ms.estimate_speed(seen, known, motion, OPEN).trusted


def test_one_speed_needs_no_finding():
    """Of a scene with one speed it is that."""
    known = ms.Scene([700.0], photon_rate=1e5, read_noise=8.0)
    found = ms.estimate_speed(np.full((5, 90), 0.2), known, camera(), OPEN)
    assert (found.speed, found.error, found.trusted) == (700.0, 0.0, True)


def test_the_decoder_restores_by_the_speed():
    """Trusted, it is the inner decoder of a scene with that speed, 1 dB better than without."""
    known, motion, inner = scene(), camera(), ms.EnsembleDecoder()
    picture, given = grey(), (known, motion, OPEN)
    seen = capture(picture, *given, 2960.0)
    decoder = ms.SpeedFindingDecoder(inner)
    restored = np.asarray(ms.deconvolve(seen, *given, decoder=decoder))
    found = ms.estimate_speed(seen, *given)
    told = known.without_metadata(speeds=np.array([found.speed]), weights=np.ones(1))
    num_taps = at_speed(blur_model(*given), found).num_taps
    model = blur_model(told, motion, OPEN, least_taps=num_taps)
    again = restored_light(seen, inner, model)
    np.testing.assert_allclose(restored, again, atol=1e-9)
    untold = np.asarray(ms.deconvolve(seen, *given, decoder=inner))
    levels = [ms.psnr(picture[:, SEEN], light) for light in (restored, untold)]
    assert levels[0] > levels[1] + 1


def test_a_speed_in_doubt_keeps_all_speeds():
    """Not trusted, the scene's own speeds weigh half the square of those far from the mode."""
    given = scene(), camera(), ms.HannShutter()
    model = blur_model(*given)
    seen = capture(grey(24), *given, 2960.0)
    found = ms.estimate_speed(seen, *given)
    assert not found.trusted
    known = at_speed(model, found)
    count = model.speeds.size
    np.testing.assert_array_equal(known.speeds[-count:], model.speeds)
    mode = int(np.argmax(found.weights))
    doubt = (1 - np.sum(found.weights[mode - 1 : mode + 2])) ** 2 / 2
    assert doubt > 0.1
    np.testing.assert_allclose(known.weights[-count:], doubt * model.weights)
    assert np.sum(known.weights) == pytest.approx(1)
    assert known.num_taps >= model.num_taps
    decoder = ms.SpeedFindingDecoder(ms.EnsembleDecoder())
    again = decoder.inner.restore(jnp.asarray(seen), known)
    np.testing.assert_allclose(ms.deconvolve(seen, *given, decoder=decoder), again, atol=1e-9)


def test_a_picture_unlike_photographs_is_believed_less():
    """Out of focus, its spectrum is none of the prior's: probabilities count by a power."""
    given = scene(), camera(), OPEN
    model = blur_model(*given)
    sharp = ms.estimate_speed(capture(grey(), *given, 2960.0), *given)
    soft = ms.estimate_speed(capture(gaussian_filter(grey(), 4.0), *given, 2960.0), *given)
    assert (sharp.trusted, sharp.is_unusual) == (True, False)
    assert (soft.trusted, soft.is_unusual) == (False, True)
    count = model.speeds.size
    usual, unusual = (at_speed(model, soft._replace(is_unusual=each)) for each in (False, True))
    np.testing.assert_array_equal(usual.weights[-count:], unusual.weights[-count:])
    mode = int(np.argmax(soft.weights))
    ratios = []
    for known in (usual, unusual):
        each = known.weights[:-count]
        places = np.searchsorted(soft.speeds, known.speeds[:-count])
        ratios.append((each / each[places == mode])[np.isin(places, [mode - 1, mode + 1])])
    np.testing.assert_allclose(ratios[1], ratios[0] ** 0.4, rtol=1e-9)
    assert unusual.speeds.size > usual.speeds.size
    assert np.sum(unusual.weights) == pytest.approx(1)


def test_a_snapshot_is_restored_as_it_would_be():
    """A blur of a few pixels may be the photograph's own: the speed is not looked for."""
    known, still = scene(), ms.StillCamera(half_exposure=0.001)
    given = known, still, OPEN
    seen = capture(grey(24), *given, 2960.0)
    found = ms.estimate_speed(seen, *given)
    assert (found.trusted, found.doubt) == (
        False,
        "The blur differs by only 9.0 px over the speeds of the scene, which cannot be told from a "
        "soft photograph: finding a speed takes 29 px or more.",
    )
    assert found.tells_nothing
    np.testing.assert_allclose(found.speed, np.mean(found.speeds))
    np.testing.assert_allclose(found.error, np.std(found.speeds))
    inner = ms.EnsembleDecoder()
    restored = ms.deconvolve(seen, *given, decoder=ms.SpeedFindingDecoder(inner))
    np.testing.assert_array_equal(restored, ms.deconvolve(seen, *given, decoder=inner))
    found, untold = (
        ms.restore_photograph(
            ms.Picture(grey(24)[..., None]),
            scene(decoder_speed=knows),
            still,
            OPEN,
            speeds=[0.0],
            num_seeds=1,
        )
        for knows in ("found", "unknown")
    )
    assert found.expected_psnr == untold.expected_psnr
    assert all(found.doubts)
    assert not any(untold.doubts)


@pytest.mark.slow
def test_portions_are_restored_by_the_speed_of_the_whole():
    """A few rows tell little: the speed is found once, in all, and stands on the result."""
    given = scene(), camera(), OPEN
    decoder = ms.SpeedFindingDecoder(ms.EnsembleDecoder())
    options = {"speed": 2960.0, "key": jax.random.key(3), "decoder": decoder}
    result = ms.capture_and_restore(photograph(), *given, rows_at_once=40, **options)
    assert is_right(result.found, 2960.0)
    whole = ms.deconvolve(result.captured, *given, decoder=decoder)
    np.testing.assert_allclose(result.restored, whole, atol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("knows", ["known", "found"])
def test_photographs_are_restored_by_the_decoder_of_the_scene(knows):
    """Told, by a filter for each speed; found, by the speed in the picture: so are levels expected.

    Both are within 0.1 dB of each other where the speed is found, and dB above one filter for all.
    """
    one, named = scene(), scene(decoder_speed=knows)
    picture, given = ms.Picture(grey()[..., None]), (camera(), OPEN)
    options = {"speeds": [0.0, 2960.0], "num_seeds": 1}
    result = ms.restore_photograph(picture, named, *given, **options)
    untold = ms.restore_photograph(picture, one, *given, **options)
    alone = [
        one.without_metadata(speeds=np.array([speed]), weights=np.ones(1))
        for speed in options["speeds"]
    ]
    told = [ms.restore_photograph(picture, each, *given, **options) for each in alone]
    assert np.all(result.linear_psnr > untold.linear_psnr + 0.5)
    assert not any(result.doubts)
    levels = [each.own_expected_psnr[index] for index, each in enumerate(told)]
    share = {"known": 1.0, "found": 0.8}[knows]
    expected = untold.own_expected_psnr + share * (np.array(levels) - untold.own_expected_psnr)
    np.testing.assert_allclose(result.own_expected_psnr, expected, atol=0.02)
    metrics = ms.evaluate(named, *given)
    assert result.expected_psnr == pytest.approx(
        float(SPEED_KNOWLEDGE[knows].psnr(metrics)), abs=0.02
    )
    at_once = ms.restore_photograph(picture, scene(decoder_speed="known"), *given, **options)
    np.testing.assert_allclose(result.linear_psnr, at_once.linear_psnr, atol=0.1)


@pytest.mark.slow
def test_a_knowing_decoder_of_two_layers_knows_the_speed_of_the_front_one():
    """The level expected over the scene's speeds is that of the metric."""
    layers = scene(
        decoder_speed="known", occlusion=ms.Occlusion(front_share=0.4, object_width=70.0)
    )
    picture, given = ms.Picture(grey(8)[..., None]), (camera(), OPEN)
    result = ms.restore_photograph(picture, layers, *given, speeds=[0.0], num_seeds=1)
    expected = float(ms.evaluate(layers, *given).known_speed_psnr)
    assert result.expected_psnr == pytest.approx(expected, abs=0.02)


def test_refusals():
    """What cannot be looked at is refused in one line."""
    given = scene(), camera(), OPEN
    with pytest.raises(ValueError, match="must be known, not traced; got a tracer"):
        jax.jit(lambda light: ms.estimate_speed(light, *given).speed)(jnp.ones((4, 90)))
    with pytest.raises(ValueError, match="must be one picture; got "):
        ms.estimate_speed(np.ones((2, 4, 90, 1)), *given)
    with pytest.raises(ValueError, match="must let light through the shutter; got 0"):
        ms.estimate_speed(np.ones((4, 90)), scene(photon_rate=0.0), camera(), OPEN)
    layered = scene(occlusion=ms.Occlusion(front_share=0.4, object_width=70.0)), camera(), OPEN
    text = (
        "`scene` must move as a whole for the speed to be found, without an occlusion; got objects"
    )
    decoder = ms.SpeedFindingDecoder()
    for use in (ms.estimate_speed, partial(ms.deconvolve, decoder=decoder)):
        with pytest.raises(ValueError, match=text):
            use(np.ones((4, 90)), *layered)
    with pytest.raises(ValueError, match=text):
        ms.capture_and_restore(np.ones((4, 90)), *layered, speed=300.0, decoder=decoder)


@pytest.mark.slow
def test_the_command_says_what_it_found(tmp_path, capsys):
    """The speed with its error; and where it is in doubt, the sentence, as a warning."""
    ms.write_picture(tmp_path / "belt.png", photograph(130))
    arguments = ["simulate", "--subject", str(tmp_path / "belt.png"), "--shutter", "rect"]
    arguments += ["--decoder", "speed-finding", "--out", str(tmp_path / "out")]
    assert cli.main([*arguments, "--speed", "2960", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["found"]
    assert abs(found["speed_px_per_s"] - 2960) < 3 * found["error_px_per_s"]
    ms.write_picture(tmp_path / "belt.png", photograph(130)[:, :90])
    assert cli.main([*arguments, "--speed", "2960"]) == 0
    written = capsys.readouterr()
    assert "none  restored for all speeds of the scene" in written.out
    assert "warning: The picture has too little detail to show its speed." in written.err
    assert "warning: " in written.err
