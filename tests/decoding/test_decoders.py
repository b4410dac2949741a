"""Decoders against scikit-image, at borders, and against one another.

Borders are pinned on a photograph whose scene goes on beyond the sensor, because there
the usual rules (wrapped, dark) are known to ring.
"""

from dataclasses import replace
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from skimage.restoration import denoise_tv_chambolle
from support import borders
from support.cameras import camera, scene
from support.classes import final_classes_in

import mishutter as ms
from mishutter.decoding import decoders

# The filters themselves; decoders apply them to rows whose borders are continued.
from mishutter.decoding.decoders.base import blur_model
from mishutter.decoding.decoders.borders import Continuation, continuation
from mishutter.decoding.decoders.linear import (
    expected_squared_error,
)

# The minimisers alone: what they minimise is a short formula on periodic rows, which no camera's
# rows are.
from mishutter.decoding.decoders.richardson_lucy import (
    _Method,
    _Penalty,
    _restored,
    richardson_lucy,
)
from mishutter.decoding.photographs import restore_by_each

PLAIN = ms.RichardsonLucyDecoder(30, accelerated=False, until_noise=False, start="capture")


def of_few_edges(picture, noise):
    """scikit-image's denoiser by total variation."""
    return denoise_tv_chambolle(picture, weight=noise, max_num_iter=30)


DECODERS = {
    "ensemble": ms.EnsembleDecoder(),
    "wiener": ms.WienerDecoder(),
    "total variation": ms.TotalVariationDecoder(),
    "richardson-lucy": PLAIN,
    "accelerated": ms.RichardsonLucyDecoder(30, until_noise=False, start="capture"),
    "few edges": ms.RichardsonLucyDecoder(start="capture"),
    "from an estimate": ms.RichardsonLucyDecoder(),
    "plug and play": ms.PlugAndPlayDecoder(of_few_edges, num_iterations=3),
    "speed finding": ms.SpeedFindingDecoder(ms.EnsembleDecoder()),
}
OF_ROWS = [name for name in DECODERS if name not in ("plug and play", "speed finding")]
"""Those that need no numbers: a capture may be traced, and turned over."""


def test_every_decoder_is_among_them():
    """One that is missing is one that nothing tests."""
    assert {type(d) for d in DECODERS.values()} == final_classes_in(decoders, ms.AbstractDecoder)


def photograph(first=100, last=124):
    return ms.example_picture().light[first:last].astype(np.float64)


def recaptured(restored, known):
    """What a restored picture would look like to the camera, without noise."""
    seen = np.maximum(np.asarray(restored), 0)
    return np.asarray(ms.simulate_capture(seen, known, camera(), ms.HannShutter()))


def bright():
    return scene(photon_rate=1e6, picture=ms.Texture(mean_level=0.21, deviation=0.2))


def test_a_model_knows_the_scene():
    """Light, noise and its part in the dark, and the picture's spectrum, in units of white."""
    known = ms.Scene(
        [-300.0, 700.0, 300.0],
        [0.2, 0.5, 0.3],
        photon_rate=3e5,
        read_noise=4.0,
        picture=ms.Texture(mean_level=0.3),
    )
    model = blur_model(known, camera(), ms.HannShutter())
    electrons = 3e5 * 0.02
    assert model.electrons == pytest.approx(electrons)
    assert model.efficiency == pytest.approx(0.5)
    assert model.read_variance == pytest.approx((4 / electrons) ** 2)
    assert model.noise == pytest.approx(0.5 * 0.3 / electrons + model.read_variance)
    assert np.mean(model.power) == pytest.approx(0.2**2)
    np.testing.assert_allclose(model.weights, [0.5, 0.5])
    response, length = model.assumed_response(600), 600
    frequency = np.arange(301) / length
    exact = ms.transfer_function(ms.HannShutter(), camera(), speed=0.0, frequency=frequency)
    wanted = np.asarray(exact) * np.sinc(frequency)
    np.testing.assert_allclose(response, wanted, atol=1e-12)


def test_a_spectrum_between_its_steps():
    """It goes on by equal ratios, as those of photographs do more nearly than by differences."""
    steps, wanted = (np.arange(256) + 0.5) / 512, np.fft.rfftfreq(1000)[1:-1]
    model = blur_model(bright(), camera(), ms.HannShutter())
    steep = replace(model, power=np.exp(-19 * steps))
    np.testing.assert_allclose(steep.picture_spectrum(1000)[1:-1], np.exp(-19 * wanted), rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", OF_ROWS)
def test_a_capture_alone_may_be_traced(name):
    """What is known of the blur is worked out once, and the rest compiles."""
    known = bright(), camera(), ms.HannShutter()

    def restored(captured):
        return ms.deconvolve(captured, *known, decoder=DECODERS[name])

    captured = ms.simulate_capture(photograph(100, 103), *known)
    np.testing.assert_allclose(jax.jit(restored)(captured), restored(captured), atol=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize("name", [*OF_ROWS, "until_noise"])
def test_a_restoration_differentiates(name):
    """In reverse mode as in forward mode, and along a direction as a difference does.

    Total variation bends wherever a difference of neighbours is kept or not, also where
    Richardson-Lucy counts it: closer together than any step that rounding allows.
    Richardson-Lucy bends where an estimate ends in the dark. Its accelerated steps magnify a
    rounding of the blur a billion times.
    """
    decoder = DECODERS.get(name, ms.RichardsonLucyDecoder(accelerated=False, start="capture"))
    captured = ms.simulate_capture(photograph(4, 24), bright(), camera(), ms.HannShutter())
    direction, weights = np.random.default_rng(5).standard_normal((2, *captured.shape))

    def seen(step):
        light = captured + step * direction * captured
        restored = ms.deconvolve(light, bright(), camera(), ms.HannShutter(), decoder=decoder)
        return jnp.sum(weights * restored)

    slope = jax.grad(seen)(0.0)
    alike = 1e-6 if name == "accelerated" else 1e-9
    np.testing.assert_allclose(slope, jax.jvp(seen, (0.0,), (1.0,))[1], rtol=alike)
    if name not in ("total variation", "from an estimate", "few edges", "until_noise"):
        np.testing.assert_allclose(slope, (seen(2e-8) - seen(-2e-8)) / 4e-8, rtol=1e-4)


@pytest.mark.slow
def test_a_black_capture_in_single_precision_has_a_slope():
    """Steps that are too small to be squared are none: no NaN comes of their quotient."""
    model = blur_model(bright(), camera(), ms.HannShutter())
    black = jnp.zeros((6, 80), jnp.float32)
    restored = ms.RichardsonLucyDecoder().restore
    slopes = jax.grad(lambda light: jnp.sum(restored(light, model)))(black)
    assert slopes.dtype == np.float32
    assert np.all(np.isfinite(slopes))


@pytest.mark.slow
@pytest.mark.parametrize("num_taps", [51, 41])
def test_richardson_lucy_is_that_of_scikit_image(num_taps):
    """Thirty iterations agree with scikit-image's to 1e-4 at its border rule and start."""
    from skimage.restoration import richardson_lucy as reference

    taps = np.asarray(ms.blur_kernel(ms.HannShutter(), camera(), num_taps=num_taps))
    taps = (taps + 0.01) / np.sum(taps + 0.01)  # light in every tap: else neither is stable
    taps = taps.astype(np.float32)
    picture = 0.05 + photograph()[:, :300, 0]
    blurred = np.stack([np.convolve(row, taps, "same") for row in picture]).astype(np.float32)
    wanted = reference(blurred, taps[None], num_iter=30, clip=False)
    found = richardson_lucy(blurred, taps)
    assert found.dtype == jnp.float32
    np.testing.assert_allclose(found, wanted, atol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ensemble", "total variation", "accelerated"])
def test_borders_are_far_better_than_wrapped(name):
    """Over photographs borders are within 3 dB of the middle, 6 dB above wrapped ones.

    The ensemble filter's over all twelve, those of decoders that iterate over every other one.
    Both in the mean: where a row's ends look alike wrapping does no harm, and where the
    columns at the border hold more contrast than the rest they are worse wherever they lie.
    So it is also held, for each photograph, to how the same columns come out on a sensor
    that goes on beyond them: what was not recorded costs at most 2.5 dB with the
    ensemble filter, 6 dB with the others.
    """
    best = name == "ensemble"
    photographs = list(borders.PHOTOGRAPHS)[:: 1 if best else 2]
    measured = [borders.measured(p, DECODERS[name], 3e6) for p in photographs]
    found = borders.Borders(*np.array(measured).T)
    assert np.mean(found.border) > np.mean(found.inner) - 3
    assert np.mean(found.border) > np.mean(found.wrapped) + 6
    assert np.mean(found.border) > np.mean(found.reference) + 6
    assert np.all(found.border > found.recorded - (2.5 if best else 6))


@pytest.mark.slow
@pytest.mark.parametrize("name", OF_ROWS)
def test_planes_are_independent(name):
    """A picture in a batch is restored as it is alone, whatever stands beside it."""
    decoder = DECODERS[name]
    model = blur_model(bright(), camera(), ms.HannShutter())
    batch = jnp.asarray(np.random.default_rng(4).random((2, 3, 90))) * 0.4 + 0.1
    together = decoder.restore(batch, model)
    alone = jnp.stack([decoder.restore(plane, model) for plane in batch])
    np.testing.assert_allclose(together, alone, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", OF_ROWS)
def test_a_picture_turned_over_is_restored_as_it_is(name):
    """Upside down of any camera; left to right of one that sees both directions alike."""
    key = jax.random.key(9)
    decoder, light = DECODERS[name], photograph(100, 109)
    for motion, axis in ((camera(), 0), (ms.StillCamera(half_exposure=0.001), 1)):
        known = bright(), motion, ms.HannShutter()
        captured = np.asarray(ms.simulate_capture(light, *known, speed=900.0, key=key))
        upright, over = (
            np.asarray(ms.deconvolve(x, *known, decoder=decoder))
            for x in (captured, np.flip(captured, axis))
        )
        # Accelerated steps magnify a rounding of the blur.
        rounding = 1e-12 if axis == 0 else 1e-8
        np.testing.assert_allclose(np.flip(over, axis), upright, atol=rounding)


@pytest.mark.slow
@pytest.mark.parametrize("name", DECODERS)
@pytest.mark.parametrize("columns", [1, 7])
def test_pictures_narrower_than_the_kernel(name, columns):
    """Rows of any length come back finite, in the shape and precision they came in."""
    model = blur_model(bright(), camera(), ms.HannShutter())
    rows = jnp.full((2, columns), 0.2, jnp.float32)
    found = DECODERS[name].restore(rows, model)
    assert found.shape == rows.shape
    assert found.dtype == jnp.float32
    assert bool(jnp.all(jnp.isfinite(found)))


@pytest.mark.slow
def test_ten_accelerated_steps_go_as_far_as_twenty_five():
    """What they leave of a capture unexplained says how far: by plain steps it takes more."""
    model = blur_model(bright(), camera(), ms.HannShutter())
    captured = ms.simulate_capture(photograph(100, 104), bright(), camera(), ms.HannShutter())
    planes = jnp.moveaxis(captured, -1, 0)

    def unexplained(**options):
        decoder = ms.RichardsonLucyDecoder(until_noise=False, start="capture", **options)
        again = recaptured(np.moveaxis(np.asarray(decoder.restore(planes, model)), 0, -1), bright())
        return np.mean((again - captured)[:, 100:-100] ** 2)

    quick = unexplained(num_iterations=10, accelerated=True)
    plain = (unexplained(num_iterations=n, accelerated=False) for n in (25, 10))
    assert quick < next(plain) < next(plain)


@pytest.mark.slow
@pytest.mark.parametrize(("photon_rate", "read_noise"), [(3e4, 4.0), (1e5, 60.0)])
def test_a_likely_picture_keeps_the_noise_out(photon_rate, read_noise):
    """In little light, or much noise of reading, it is better than thirty steps of it."""
    light = {"photon_rate": photon_rate, "read_noise": read_noise}
    dim = scene(**light, picture=ms.Texture(mean_level=0.21, deviation=0.2))
    results = [
        ms.restore_photograph(
            photograph(), dim, camera(), ms.HannShutter(), decoder=d, speeds=[0.0], num_seeds=1
        ).psnr[0]
        for d in (PLAIN, DECODERS["few edges"])
    ]
    assert results[1] > results[0] + 1


@pytest.mark.slow
@pytest.mark.parametrize("photon_rate", [3e4, 1e6])
def test_from_an_estimate_it_goes_further(photon_rate):
    """Over all speeds, from a filter's estimate, it ends above thirty steps from the capture."""
    known = scene(photon_rate=photon_rate, picture=ms.Texture(mean_level=0.21, deviation=0.2))
    results = [
        ms.restore_photograph(
            photograph(), known, camera(), ms.HannShutter(), decoder=d, num_seeds=1
        ).mean_psnr
        for d in (PLAIN, DECODERS["from an estimate"])
    ]
    assert results[1] > results[0] + 0.1


def test_richardson_lucy_ends_at_the_likeliest_picture_of_few_edges():
    """No picture near its end is likelier than to 1e-7, edges counted in both directions."""
    around = Continuation(np.zeros((0, 0)), 64, 64, 0)
    rng = np.random.default_rng(9)
    truth = 0.1 + np.repeat(rng.random((4, 8)), 8, axis=1)
    response, light, strength = np.fft.rfft([0.3, 0.2, 0.1], 64), 0.6, 0.004
    rows = np.fft.irfft(np.fft.rfft(truth) * response, 64)
    rows = rows + 0.03 * rng.standard_normal(rows.shape)
    penalty = _Penalty(np.asarray(strength), np.asarray(0.07))
    given = around, response, np.asarray(light), _Method(4000, True, 0.1)
    weighed = {"penalty": penalty, "first_filter": None}
    found = np.asarray(_restored(jnp.asarray(rows), *given, **weighed))
    dark = 0.07 + 0.1 * rows.mean()

    def unlikely(picture):
        again = np.fft.irfft(np.fft.rfft(picture) * response, 64) + dark
        across = np.roll(picture, -1, axis=1) - picture
        down = np.diff(picture, axis=0, append=picture[-1:])
        edges = np.sum(np.hypot(across, down))
        return np.sum(again - (rows + dark) * np.log(again)) + strength * edges

    for step in (1e-3, 1e-2):
        for _ in range(20):
            change = rng.standard_normal(found.shape)
            smooth = np.cumsum(change, axis=1) / 8
            for other in (found * (1 + step * change), found * (1 + step * smooth)):
                assert unlikely(other) > unlikely(found) * (1 - 1e-7)
    assert unlikely(found) < min(unlikely(truth), unlikely(np.maximum(rows / light, 0)))


@pytest.mark.slow
@pytest.mark.parametrize(("photon_rate", "gain"), [(3e4, 0.3), (2e7, -1.0)])
def test_richardson_lucy_settles_at_every_speed(photon_rate, gain):
    """In dim light above the ensemble filter, in bright near it; more steps change little."""
    known = scene(photon_rate=photon_rate, picture=ms.Texture(mean_level=0.21, deviation=0.2))
    picture = photograph(100, 164)[..., :1]
    decoders = {"": DECODERS["ensemble"]} | {n: ms.RichardsonLucyDecoder(n) for n in (15, 60)}
    given = picture, known, camera(), ms.HannShutter(), decoders
    found = restore_by_each(*given, num_seeds=1)
    assert np.all(found[15].linear_psnr > found[""].linear_psnr + gain)
    np.testing.assert_allclose(found[60].linear_psnr, found[15].linear_psnr, atol=0.5)


def test_a_denoiser_is_given_what_minimises_the_sum():
    """Of misfit and distance from the picture before it; the noise that it is told of falls."""
    seen = []

    def spy(picture, noise):
        seen.append((picture, noise))
        return 0.9 * picture + 0.01

    model = blur_model(scene(), camera(), ms.HannShutter())
    captured = np.random.default_rng(5).uniform(0.1, 0.4, (1, 3, 160))
    decoder = ms.PlugAndPlayDecoder(
        spy, strength=0.7, first_noise=3.0, last_noise=0.4, num_iterations=4
    )
    restored = np.asarray(decoder.restore(jnp.asarray(captured), model))
    np.testing.assert_allclose(restored[0], 0.9 * seen[-1][0][:, :160] + 0.01, atol=1e-12)

    length = seen[0][0].shape[-1]
    noises = [noise for _, noise in seen]
    error = np.sqrt(expected_squared_error(model, length))
    np.testing.assert_allclose(noises, np.geomspace(3.0, 0.4, 4) * error)

    mean, spread = model.mean_and_spread(length)
    disturbance = model.noise + model.picture_spectrum(length) * spread
    deviation, level = borders_of(model, captured[0])
    recorded = np.fft.rfft(deviation + level)

    def total(picture, before, noise):
        misfit = np.abs(recorded - mean * np.fft.rfft(picture)) ** 2 / disturbance
        distance = np.abs(np.fft.rfft(picture - before)) ** 2 / noise**2
        both = misfit + 0.7 * distance
        return np.sum(both) + np.sum(both[:, 1:-1])  # a DFT has these frequencies twice

    steps = np.random.default_rng(6).normal(0, 1e-3, (20, 3, length))
    for (before, _), (picture, noise) in pairwise(seen):
        least = total(picture, 0.9 * before + 0.01, noise)
        for step in steps:
            assert total(picture + step, 0.9 * before + 0.01, noise) > least


def borders_of(model, rows):
    """The deviations of continued rows from their means, and the means."""
    return (np.asarray(x) for x in continuation(model, rows.shape[-1]).deviations(jnp.array(rows)))


@pytest.mark.slow
def test_a_denoiser_brings_more_than_a_filter():
    """A third of a decibel and more on a photograph, also where the speed is found first."""
    known, moving = bright(), {"speed": 0.0, "key": jax.random.key(3)}
    picture = photograph(100, 164)
    seen = ms.simulate_capture(picture, known, camera(), ms.HannShutter(), **moving)
    level = {}
    for name, decoder in {
        "filter": ms.EnsembleDecoder(),
        "denoiser": ms.PlugAndPlayDecoder(of_few_edges),
        "found": ms.SpeedFindingDecoder(ms.PlugAndPlayDecoder(of_few_edges)),
    }.items():
        found = ms.deconvolve(seen, known, camera(), ms.HannShutter(), decoder=decoder)
        level[name] = float(ms.psnr(picture, found))
    assert level["denoiser"] > level["filter"] + 0.33
    assert level["found"] > level["filter"] + 0.33


class OfAnotherLibrary:
    """A tensor: an array for NumPy, with a data type of its own."""

    dtype = "single"

    def __init__(self, values, error=None):
        self.values, self.error = values, error
        self.shape = np.shape(values)

    def __array__(self, dtype=None, copy=None):
        if self.error is not None:
            raise RuntimeError(self.error)
        return np.asarray(self.values, dtype)


NOT_PICTURES = {
    "nothing": (lambda picture, noise: None, "must return real numbers; got None"),
    "text": (lambda picture, noise: "done", "must return real numbers; got 'done'"),
    "complex": (lambda picture, noise: picture + 0.1j, "must return real numbers; got"),
    "pair": (lambda picture, noise: (picture, noise), r"of shape \(2, 240\); got a tuple: "),
    "gradients": (
        lambda picture, noise: OfAnotherLibrary(picture, "Use tensor.detach().numpy()"),
        "got a OfAnotherLibrary: Use tensor.detach",
    ),
    "batch": (lambda picture, noise: picture[None], r"of shape \(2, 240\), as it was given; got"),
    "bytes": (lambda picture, noise: 255 * picture, "as bright as it was given.* got a mean of 51"),
    "noise": (lambda picture, noise: picture - picture.mean(), "as bright .*0.2, white = 1; got"),
}


@pytest.mark.parametrize(("denoise", "message"), NOT_PICTURES.values(), ids=NOT_PICTURES)
def test_a_denoiser_of_other_conventions(denoise, message):
    """Networks return tensors, batches, other units and the noise: one line says which."""
    model = blur_model(scene(), camera(), ms.HannShutter())
    rows = jnp.full((1, 2, 40), 0.1)  # Hann passes half of the light
    with pytest.raises(ValueError, match=message) as raised:
        ms.PlugAndPlayDecoder(denoise).restore(rows, model)
    assert "\n" not in str(raised.value)


def test_a_denoiser_may_return_what_numpy_reads():
    """A tensor, lists, single precision, and its own argument, overwritten, are as an array."""
    model = blur_model(scene(), camera(), ms.HannShutter())
    rows = jnp.asarray(np.random.default_rng(8).uniform(0.1, 0.2, (1, 2, 40)))

    def in_place(picture, noise):
        picture[...] = 0.9 * picture + 0.02
        return picture

    restored = [
        ms.PlugAndPlayDecoder(denoise).restore(rows, model)
        for denoise in (
            lambda picture, noise: 0.9 * picture + 0.02,
            lambda picture, noise: OfAnotherLibrary(0.9 * picture + 0.02),
            lambda picture, noise: (0.9 * picture + 0.02).tolist(),
            lambda picture, noise: (0.9 * picture + 0.02).astype(np.float32),
            in_place,
        )
    ]
    for other in restored[1:]:
        np.testing.assert_allclose(other, restored[0], atol=1e-6)


def test_an_error_within_a_denoiser_says_how_it_was_called():
    """The error stays the denoiser's own; a note has the type that a network does not take."""

    def network(picture, noise):
        raise TypeError("conv2d(): argument 'input' must be Tensor, not numpy.ndarray")

    model = blur_model(scene(), camera(), ms.HannShutter())
    with pytest.raises(TypeError, match="conv2d") as raised:
        ms.PlugAndPlayDecoder(network).restore(jnp.full((1, 2, 40), 0.1), model)
    (note,) = raised.value.__notes__
    assert "was called with a NumPy array of shape (2, 240), float64, and a float" in note


def test_a_denoiser_that_returns_no_picture():
    """Another shape and numbers that are not finite are refused, and a capture that is traced."""
    model = blur_model(scene(), camera(), ms.HannShutter())
    rows = jnp.ones((1, 2, 40)) * 0.2
    with pytest.raises(ValueError, match="return a picture of shape"):
        ms.PlugAndPlayDecoder(lambda picture, noise: picture[:-1]).restore(rows, model)
    with pytest.raises(ValueError, match="return finite numbers"):
        ms.PlugAndPlayDecoder(lambda picture, noise: picture * np.nan).restore(rows, model)
    with pytest.raises(ValueError, match="JAX traces"):
        jax.jit(lambda x: ms.PlugAndPlayDecoder(of_few_edges).restore(x, model))(rows)
    for bad, message in (
        ({"strength": 0.0}, r"strength=...\)` must be above 0; got 0"),
        ({"last_noise": -1.0}, "must be above 0; got -1"),
        ({"first_noise": 0.2}, "must be at least `last_noise`, 0.5; got 0.2"),
        ({"num_iterations": 0}, "must be a positive integer"),
    ):
        with pytest.raises(ValueError, match=message):
            ms.PlugAndPlayDecoder(of_few_edges, **bad)


def test_refusals():
    """Parameters out of range are refused in one line."""
    with pytest.raises(ValueError, match="must be a positive integer; got 0"):
        ms.RichardsonLucyDecoder(0)
    with pytest.raises(ValueError, match="must be 'capture' or 'wiener'; got 'flat'"):
        ms.RichardsonLucyDecoder(start="flat")
    with pytest.raises(ValueError, match="must be above 0; got -1"):
        ms.TotalVariationDecoder(strength=-1.0)
    with pytest.raises(ValueError, match="must be a positive integer"):
        ms.TotalVariationDecoder(num_iterations=0)
    with pytest.raises(ValueError, match="must be one row of taps"):
        richardson_lucy(np.ones((3, 4)), np.ones((2, 2)))


@pytest.mark.parametrize(
    ("captured", "requirement"),
    [
        (np.arange(3, 43).reshape(4, 10), "hold light, white = 1, as floating-point numbers"),
        (np.linspace(0.2, 0.7, 10), "have rows and columns"),
        (np.array([[0.3, np.nan, 0.4]]), "be finite"),
    ],
    ids=["levels", "one row", "not finite"],
)
def test_richardson_lucy_takes_light_alone(captured, requirement):
    """A flat start of 0.5 among whole numbers would be 0, from which no step leads away."""
    with pytest.raises(ValueError, match=rf"`richardson_lucy\(captured=...\)` must {requirement}"):
        richardson_lucy(captured, np.array([0.2, 0.5, 0.3]))


def test_richardson_lucy_takes_finite_taps():
    """A tap that is not a number would make every pixel none."""
    with pytest.raises(ValueError, match=r"`richardson_lucy\(kernel=...\)` must be finite"):
        richardson_lucy(np.full((3, 9), 0.4), np.array([0.2, np.nan, 0.3]))
