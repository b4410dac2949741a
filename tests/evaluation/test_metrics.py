"""Metrics against independent formulae: the definitions are what is pinned, not figures."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mishutter import (
    ChippedShutter,
    DesignLoss,
    ExpectedErrorLoss,
    HannShutter,
    Limits,
    Optics,
    ParabolicMotion,
    RectShutter,
    Scene,
    StillCamera,
    Texture,
    Tolerances,
    TukeyShutter,
    binned_exposure,
    blur_kernel,
    evaluate,
    transfer_function,
)

# The error as a share of 1, to its last digits; metrics hold it in decibels.
from mishutter.evaluation.errors import LinearErrors, spectral_levels
from mishutter.evaluation.needs import ONLY_SPECTRA, Plan, sizes
from mishutter.evaluation.response import compute_response
from mishutter.evaluation.speed_knowledge import KNOWN_SPEED, SPEED_KNOWLEDGE, UNKNOWN_SPEED
from mishutter.evaluation.views import sampled_view
from mishutter.model.optics import frequencies, frequency_grid
from mishutter.model.scene import picture_power

HALF_EXPOSURE = 0.013
MOTION = ParabolicMotion(acceleration=31.0 / HALF_EXPOSURE**2, half_exposure=HALF_EXPOSURE)
SPEEDS = np.array([-2100.0, 0.0, 700.0, 1900.0])
WEIGHTS = np.array([0.1, 0.4, 0.3, 0.2])
SCENE = Scene(SPEEDS, WEIGHTS, photon_rate=7e4, read_noise=6.0)
SHUTTER = TukeyShutter(0.37)
FEW = Limits(max_stroke=40.0)
"""Limits within which light spreads so little that 256 frequencies are enough."""


def test_no_acceleration_is_a_camera_at_rest():
    """A parabola of no acceleration is measured as the still camera that it is."""
    parked = ParabolicMotion(acceleration=0.0, half_exposure=0.0021)
    still = StillCamera(half_exposure=0.0021)
    first, second = (evaluate(SCENE, motion, SHUTTER) for motion in (parked, still))
    assert jax.tree.all(jax.tree.map(lambda x, y: bool(x == y), first, second))


@pytest.mark.slow
def test_a_spectrum_in_narrow_steps_loses_none_of_its_power():
    """Lines between the frequencies that are looked at count as much as those on them."""
    lines = np.zeros(1280)
    lines[[51, 933]] = 3.0, 1.0
    broad = lines.reshape(256, 5).mean(axis=1)
    narrow, wide = (
        evaluate(
            Scene(
                SPEEDS,
                photon_rate=7e4,
                read_noise=6.0,
                picture=Texture(power_spectrum=x),
                limits=FEW,
            ),
            MOTION,
            SHUTTER,
        )
        for x in (lines, broad)
    )
    assert np.isclose(narrow.expected_psnr, wide.expected_psnr, rtol=1e-12)


def test_what_the_optics_do_not_pass_is_no_part_of_the_picture():
    """It has the same contrast below the cut-off, and neither power nor error above."""
    frequency = (np.arange(256) + 0.5) / 512
    passed = (frequency <= 0.13) / (frequency**2 + 0.01**2)
    light: dict[str, Any] = {"photon_rate": 7e4, "read_noise": 6.0, "limits": FEW}
    by_optics = evaluate(
        Scene(SPEEDS, **light, optics=Optics(cutoff_frequency=0.13)), MOTION, SHUTTER
    )
    by_picture = evaluate(
        Scene(SPEEDS, **light, picture=Texture(power_spectrum=passed)), MOTION, SHUTTER
    )
    assert np.isclose(by_optics.expected_psnr, by_picture.expected_psnr, rtol=1e-12)


def test_a_lens_blurs_what_is_restored():
    """Of a still object the error is that of a Wiener filter behind pixel, lens and noise."""
    rate, noise, blur, half = 7e4, 6.0, 0.77, 0.0021
    light: dict[str, Any] = {"photon_rate": rate, "read_noise": noise, "limits": FEW}
    scene = Scene([0.0], **light, optics=Optics(lens_blur=blur))
    frequency = (np.arange(4096) + 0.5) / 8192
    power = 1 / (frequency**2 + 0.01**2)
    power *= float(scene.picture.deviation) ** 2 / np.mean(power)
    places, weights = np.polynomial.hermite_e.hermegauss(40)
    spread = np.cos(2 * np.pi * blur * np.outer(frequency, places)) @ weights / weights.sum()
    electrons = rate * 2 * half
    passed = power * (electrons * np.sinc(frequency) * spread) ** 2
    variance = float(scene.picture.mean_level) * electrons + noise**2
    error = np.mean(power * variance / (passed + variance))
    found = evaluate(scene, StillCamera(half_exposure=half), RectShutter())
    assert float(found.expected_psnr) == pytest.approx(-10 * np.log10(error), abs=5e-6)
    assert float(found.known_speed_psnr) == pytest.approx(-10 * np.log10(error), abs=5e-6)


@pytest.mark.slow
@pytest.mark.parametrize("motion", [MOTION, StillCamera(half_exposure=HALF_EXPOSURE)])
def test_only_the_shutter_is_traced(motion):
    """A scene and a motion that a compiled function closes over are known to it."""

    def found(taper):
        metrics = evaluate(SCENE, motion, TukeyShutter(taper))
        losses = [
            loss(SCENE, motion, TukeyShutter(taper)) for loss in (ExpectedErrorLoss(), DesignLoss())
        ]
        return metrics, losses

    plain, compiled = found(jnp.asarray(0.37)), jax.jit(found)(0.37)
    for first, second in zip(jax.tree.leaves(plain), jax.tree.leaves(compiled), strict=True):
        assert np.isclose(first, second, rtol=1e-9)
    assert plain[0].num_taps == compiled[0].num_taps


def _by_acceleration(scene):
    def found(acceleration):
        motion = ParabolicMotion(acceleration=acceleration, half_exposure=HALF_EXPOSURE)
        return DesignLoss()(scene, motion, SHUTTER), evaluate(scene, motion, SHUTTER)

    return found


@pytest.mark.slow
def test_a_traced_motion_is_measured_as_one_that_is_known():
    """Within its scene's limits, long strokes included."""
    limits = Limits(max_stroke=500.0)
    found = _by_acceleration(Scene(SPEEDS, WEIGHTS, photon_rate=7e4, read_noise=6.0, limits=limits))
    acceleration = jnp.asarray(430.0 / HALF_EXPOSURE**2)
    (loss, metrics), _ = jax.jit(jax.value_and_grad(found, has_aux=True))(acceleration)
    for traced, known in zip(
        jax.tree.leaves((loss, metrics)), jax.tree.leaves(found(acceleration)), strict=True
    ):
        assert np.isclose(traced, known, rtol=1e-9)


@pytest.mark.slow
def test_a_derivative_is_that_of_the_figure_reported():
    """Of an object much faster than the sensor too, whose kernel no limit foresees."""
    found = _by_acceleration(
        Scene([0.0, 40 * float(MOTION.top_speed)], photon_rate=7e4, read_noise=6.0)
    )
    acceleration = jnp.asarray(31.0 / HALF_EXPOSURE**2)
    (loss, metrics), slope = jax.value_and_grad(found, has_aux=True)(acceleration)
    known = found(acceleration)
    assert np.isclose(loss, known[0], rtol=1e-12)
    assert (metrics.num_taps, metrics.dft_length) == (known[1].num_taps, known[1].dft_length)
    step = 1e-5 * acceleration
    difference = (found(acceleration + step)[0] - found(acceleration - step)[0]) / (2 * step)
    assert np.isclose(slope, difference, rtol=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("measure", [evaluate, DesignLoss()])
def test_kernels_longer_than_a_compiled_function_provides_for(measure):
    """They are not cut without a word: of a traced motion by its scene's limits, else 256 px."""
    few, many = (
        ParabolicMotion(acceleration=stroke / HALF_EXPOSURE**2, half_exposure=HALF_EXPOSURE)
        for stroke in (20.0, 1000.0)
    )
    by_motion = jax.jit(lambda motion: measure(SCENE, motion, SHUTTER))
    for compiled in (by_motion, lambda motion: jax.jit(measure)(SCENE, motion, SHUTTER)):
        assert all(np.all(np.isfinite(x)) for x in jax.tree.leaves(compiled(few)))
        with pytest.raises(
            (RuntimeError, ValueError), match=r"`motion` must keep light within \d+ px of where"
        ):
            compiled(many)


@pytest.mark.slow
def test_what_a_compiled_function_builds_is_known_to_it():
    """A scene or a motion made of numbers inside has the sizes that it has outside."""

    def found(taper):
        scene = Scene([-700.0, 0.0, 300.0], photon_rate=7e4, read_noise=6.0)
        motion = ParabolicMotion(acceleration=31.0 / HALF_EXPOSURE**2, half_exposure=HALF_EXPOSURE)
        return evaluate(scene, motion, TukeyShutter(taper))

    plain, compiled = found(0.37), jax.jit(found)(0.37)
    assert (plain.num_taps, plain.dft_length) == (compiled.num_taps, compiled.dft_length)
    assert np.isclose(plain.condition_number, compiled.condition_number, rtol=1e-12)


@pytest.mark.slow
def test_kernel_difference_is_the_rms_over_the_taps_reached():
    """Raw and relative difference follow from public kernels."""
    count = int(np.ceil(31.0 * (1 + 2100 / float(MOTION.top_speed)) ** 2))
    kernels = [np.asarray(blur_kernel(SHUTTER, MOTION, speed=s, num_taps=count)) for s in SPEEDS]
    still = np.asarray(blur_kernel(SHUTTER, MOTION, num_taps=count))
    square = sum(p * np.mean((h - still) ** 2) for p, h in zip(WEIGHTS, kernels, strict=True))
    metrics = evaluate(SCENE, MOTION, SHUTTER)
    assert np.isclose(metrics.kernel_difference, np.sqrt(square), rtol=1e-12)
    relative = np.sqrt(square / np.mean(still**2))
    assert np.isclose(metrics.relative_kernel_difference, relative, rtol=1e-12)


@pytest.mark.parametrize("reach", [0.4, 0.7, 1.45, 2.6])
def test_kernel_difference_of_a_still_camera_is_over_the_pixels_lit(reach):
    """A middle pixel and as many to either side as the fastest object reaches into."""
    still = StillCamera(half_exposure=HALF_EXPOSURE)
    edges = np.arange(-9, 10) + 0.5
    speeds = np.array([reach, -0.3 * reach]) / HALF_EXPOSURE
    fast, slow, rest = (
        np.asarray(binned_exposure(SHUTTER, still, speed=s, edges=edges)) for s in (*speeds, 0.0)
    )
    square = (np.sum((fast - rest) ** 2) + np.sum((slow - rest) ** 2)) / 2
    metrics = evaluate(Scene(speeds, photon_rate=7e4, read_noise=6.0), still, SHUTTER)
    lit = np.count_nonzero(fast)
    assert np.isclose(metrics.kernel_difference, np.sqrt(square / lit), rtol=1e-12)


def test_the_share_of_the_bound_is_that_of_its_definition():
    """Least of |K|^2 over min((2T)^2, T/(Sf)) of what occurs; what never does bounds nothing."""
    scene = Scene([-900.0, 400.0, 5e4], [0.3, 0.7, 0.0], photon_rate=7e4, read_noise=6.0)
    frequency = frequencies(sizes(scene, MOTION).num_frequencies)
    bound = np.minimum((2 * HALF_EXPOSURE) ** 2, HALF_EXPOSURE / (900 * frequency))
    shares = [
        abs(transfer_function(SHUTTER, MOTION, speed=speed, frequency=frequency)) ** 2
        * (2 * HALF_EXPOSURE) ** 2
        / bound
        for speed in (-900.0, 400.0)
    ]
    found = evaluate(scene, MOTION, SHUTTER).bound_share
    assert np.isclose(found, np.min(shares), rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("taper", [0.004, 0.11, 0.7])
def test_the_grid_resolves_a_long_flat_top(taper):
    """However the exposure is cut, a fast object's response is right at every frequency."""
    motion = ParabolicMotion(acceleration=150 / HALF_EXPOSURE**2, half_exposure=HALF_EXPOSURE)
    scene = Scene([270 / HALF_EXPOSURE, 0.0], photon_rate=1e5, read_noise=1.0)
    shutter = TukeyShutter(taper)
    plan = sizes(scene, motion)
    response = compute_response(sampled_view(scene, motion, shutter, ONLY_SPECTRA, plan))
    frequency = frequency_grid(plan.num_frequencies, np.dtype(np.float64))
    public = [
        transfer_function(shutter, motion, speed=s, frequency=frequency) for s in scene.speeds
    ]
    assert np.max(np.abs(np.abs(response.spectra) - np.abs(np.stack(public)))) < 1e-13


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rate", "noise", "shutter"),
    [
        (0.0, 0.0, SHUTTER),
        (0.0, 5.0, SHUTTER),
        (1e12, 0.0, SHUTTER),
        (1e5, 0.0, ChippedShutter(np.zeros(4))),
        (1e5, 5.0, ChippedShutter(np.zeros(4))),
    ],
)
def test_extremes_of_light_and_noise_give_finite_errors(rate, noise, shutter):
    """Without light the picture's variance is left; value and gradient stay finite."""

    def error(half_exposure, read_noise):
        scene = Scene(SPEEDS, WEIGHTS, photon_rate=rate, read_noise=read_noise)
        motion = ParabolicMotion(acceleration=MOTION.acceleration, half_exposure=half_exposure)
        view = sampled_view(scene, motion, shutter, ONLY_SPECTRA, Plan(64, 256, 64, 256))
        return LinearErrors(scene, motion, compute_response(view)).unknown

    value, gradient = jax.value_and_grad(error, argnums=(0, 1))(HALF_EXPOSURE, noise)
    assert np.isfinite(value)
    assert np.all(np.isfinite(gradient))
    if rate == 0 or not float(shutter.efficiency()):
        assert np.isclose(value, 0.2**2, rtol=1e-12)
    else:
        assert 0 < float(value) < 0.1**2


def test_a_closed_shutter_has_an_infinite_condition_number():
    """Nothing gets through, and that is said by a number, not by NaN."""
    metrics = evaluate(SCENE, MOTION, ChippedShutter(np.zeros(3)))
    assert np.isposinf(metrics.condition_number)
    assert not any(np.isnan(x) for x in jax.tree.leaves(metrics))


@pytest.mark.slow
def test_single_precision_is_kept():
    """Inputs of float32 give metrics of float32 that agree with float64."""
    half = np.float32(HALF_EXPOSURE)
    motion = ParabolicMotion(acceleration=np.float32(31.0) / half**2, half_exposure=half)
    scene = Scene(
        SPEEDS.astype(np.float32),
        WEIGHTS.astype(np.float32),
        photon_rate=np.float32(7e4),
        read_noise=np.float32(6),
        picture=Texture(mean_level=np.float32(0.25), deviation=np.float32(0.2)),
    )
    single = evaluate(scene, motion, HannShutter())
    double = evaluate(SCENE, MOTION, HannShutter())
    names = "condition_number", "efficiency", "expected_psnr", "known_speed_psnr", "bound_share"
    for name in names:
        assert getattr(single, name).dtype == np.float32
        assert np.isclose(getattr(single, name), getattr(double, name), rtol=2e-3)


@pytest.mark.slow
def test_light_may_be_traced_where_the_motion_is_known():
    """Metrics of a known design compile, and vary with the scene's light alone."""

    def expected(rate):
        scene = Scene(SPEEDS, WEIGHTS, photon_rate=rate, read_noise=6.0)
        return evaluate(scene, MOTION, SHUTTER).expected_psnr

    found = jax.jit(expected)(jnp.asarray(3e5))
    np.testing.assert_allclose(found, expected(jnp.asarray(3e5)), rtol=1e-12)
    assert float(jax.grad(expected)(jnp.asarray(3e5))) > 0


def test_metrics_show_their_numbers():
    """In a notebook as in a terminal."""
    found = evaluate(SCENE, MOTION, SHUTTER)
    assert f"expected_psnr={found.expected_psnr}" in repr(found)
    assert f"dft_length={found.dft_length}" in repr(found)


SEEN = {
    "moving": (MOTION, SHUTTER),
    "panning": (
        ParabolicMotion(acceleration=2e4, half_exposure=HALF_EXPOSURE, velocity=390.0),
        HannShutter(),
    ),
    "at-rest": (StillCamera(half_exposure=0.0017), RectShutter()),
}


@pytest.mark.parametrize("slug", SEEN)
def test_signal_over_noise_leaves_the_expected_error(slug):
    r"""The filter leaves $S/(1 + r)$ at a frequency where signal over noise is $r$."""
    motion, shutter = SEEN[slug]
    levels = spectral_levels(SCENE, motion, shutter)
    metrics = evaluate(SCENE, motion, shutter)
    for decoder in (UNKNOWN_SPEED, KNOWN_SPEED):
        ratio = decoder.of(levels).signal_over_noise
        power = picture_power(SCENE, ratio.size, ratio.dtype)
        error = np.mean(power / (1 + ratio))
        np.testing.assert_allclose(-10 * np.log10(error), decoder.psnr(metrics), rtol=1e-12)
    np.testing.assert_array_equal(levels.frequencies, frequencies(ratio.size))
    assert SPEED_KNOWLEDGE["found"].of(levels) is levels.known


def test_signal_over_noise_of_a_still_object():
    r"""$S\,\operatorname{sinc}^2(f)\,p^2/(\bar f p + \sigma^2)$ electrons of the whole exposure."""
    scene = Scene([0.0], photon_rate=7e4, read_noise=6.0)
    still = StillCamera(half_exposure=0.0017)
    frequency, _, (ratio, _), told = spectral_levels(scene, still, RectShutter())
    electrons = 7e4 * 2 * 0.0017
    power = picture_power(scene, ratio.size, ratio.dtype) * np.sinc(frequency) ** 2
    expected = power * electrons**2 / (0.25 * electrons + 36)
    np.testing.assert_allclose(ratio, expected, rtol=1e-9)
    np.testing.assert_allclose(told.signal_over_noise, expected, rtol=1e-9)


@pytest.mark.parametrize("velocity", [0.0, 240.0])
@pytest.mark.parametrize("speeds", [SPEEDS, np.array([-900.0, 0.0, 900.0, 900.0])])
def test_the_mean_error_over_speeds_is_the_expected_one(speeds, velocity):
    """The errors at each speed, weighted, are those expected of a decoder, however speeds fold.

    A decoder is better at each speed if it is told it, and its worst is what the metrics say.
    """
    scene = Scene(speeds, WEIGHTS, photon_rate=7e4, read_noise=6.0)
    motion = ParabolicMotion(
        acceleration=MOTION.acceleration, half_exposure=HALF_EXPOSURE, velocity=velocity
    )
    levels, metrics = spectral_levels(scene, motion, SHUTTER), evaluate(scene, motion, SHUTTER)
    assert np.array_equal(levels.speeds, np.unique(speeds))
    weights = np.array([WEIGHTS[speeds == speed].sum() for speed in levels.speeds])
    for decoder in (UNKNOWN_SPEED, KNOWN_SPEED):
        psnr = decoder.of(levels).psnr
        mean = -10 * np.log10(weights @ 10 ** (-psnr / 10))
        np.testing.assert_allclose(mean, decoder.psnr(metrics), rtol=1e-12)
        np.testing.assert_allclose(np.min(psnr), decoder.worst_psnr(metrics), rtol=1e-12)
    assert np.all(levels.known.psnr > levels.unknown.psnr)
    assert np.ptp(levels.unknown.psnr) > 0.1
    assert SPEED_KNOWLEDGE["found"].worst_psnr(metrics) is None


def test_no_light_and_no_noise_leave_the_variance_at_every_speed():
    """The worst speed is as bad as the mean, and as a decoder that is told it; so by frequency."""
    for rate, noise in [(0.0, 0.0), (0.0, 6.0)]:
        scene = Scene(
            SPEEDS, WEIGHTS, photon_rate=rate, read_noise=noise, picture=Texture(deviation=0.17)
        )
        found = evaluate(scene, MOTION, SHUTTER)
        levels = [decoder.psnr(found) for decoder in SPEED_KNOWLEDGE.values()]
        levels += [decoder.worst_psnr(found) for decoder in (UNKNOWN_SPEED, KNOWN_SPEED)]
        np.testing.assert_allclose(levels, -20 * np.log10(0.17), rtol=1e-12)
        each = spectral_levels(scene, MOTION, SHUTTER)
        for psnr in (each.unknown.psnr, each.known.psnr):
            np.testing.assert_allclose(psnr, -20 * np.log10(0.17), rtol=1e-12)


def test_a_speed_that_never_occurs_changes_no_metric():
    """Although it is far the worst."""
    light = {"photon_rate": 7e4, "read_noise": 6.0}
    never = Scene([*SPEEDS, 9000.0], [*WEIGHTS, 0.0], **light)
    one, other = (evaluate(scene, MOTION, SHUTTER) for scene in (never, SCENE))
    values = [np.array(jax.tree.leaves(metrics)) for metrics in (one, other)]
    np.testing.assert_allclose(*values, rtol=1e-9)
    alone = evaluate(Scene([9000.0], **light), MOTION, SHUTTER)
    assert float(alone.known_speed_psnr) < float(one.worst_speed_psnr) - 1


def test_the_error_at_each_speed_is_of_the_camera_as_designed():
    """Tolerances of a scene leave its errors at each speed where they are."""
    tolerances = Tolerances(acceleration=0.07, velocity=31.0)
    within = Scene(SPEEDS, WEIGHTS, photon_rate=7e4, read_noise=6.0, tolerances=tolerances)
    found, expected = (
        jax.tree.leaves(spectral_levels(s, MOTION, SHUTTER)) for s in (within, SCENE)
    )
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.slow
@pytest.mark.parametrize("slug", ["moving", "at-rest"])
def test_the_error_at_a_speed_is_that_of_the_filter_written_out(slug):
    """At each speed the filter of all of them misses what its formula says, noise included.

    Objects are aligned where the sensor is as fast as they are, and at mid-exposure if it rests.
    """
    motion, shutter = SEEN[slug]
    levels = spectral_levels(SCENE, motion, shutter)
    num = sizes(SCENE, motion).num_frequencies
    frequency = np.asarray(frequency_grid(num, np.dtype(float)))
    acceleration = float(motion.acceleration)
    vertex = SPEEDS**2 / (4 * acceleration) if acceleration else 0 * SPEEDS
    response = [
        np.asarray(transfer_function(shutter, motion, speed=s, frequency=jnp.asarray(frequency)))
        * np.exp(2j * np.pi * frequency * -v)
        * np.sinc(frequency)
        for s, v in zip(SPEEDS, vertex, strict=True)
    ]
    power = np.asarray(picture_power(SCENE, num, np.dtype(float)))
    electrons = 7e4 * 2 * float(motion.half_exposure)
    light = float(shutter.efficiency())
    noise = light * float(SCENE.picture.mean_level) / electrons + (6.0 / electrons) ** 2
    mean = sum(p * h for p, h in zip(WEIGHTS, response, strict=True))
    square = sum(p * abs(h) ** 2 for p, h in zip(WEIGHTS, response, strict=True))
    gain = power * np.conj(mean) / (power * square + noise)
    errors = [np.mean(power * abs(1 - gain * h) ** 2 + noise * abs(gain) ** 2) for h in response]
    np.testing.assert_allclose(levels.unknown.psnr, -10 * np.log10(errors), rtol=1e-6)
    told = [np.mean(power * noise / (power * abs(h) ** 2 + noise)) for h in response]
    np.testing.assert_allclose(levels.known.psnr, -10 * np.log10(told), rtol=1e-6)
