"""Steps of the decoders of single captures by small sums of their own: filters, speeds, edges."""

import math
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import polygamma

import mishutter as ms
from mishutter.decoding.decoders import speed as speeds_module
from mishutter.decoding.decoders import total_variation
from mishutter.decoding.decoders.base import BlurModel, blur_model
from mishutter.decoding.decoders.borders import Continuation
from mishutter.decoding.decoders.linear import (
    ensemble_filter,
    expected_squared_error,
    mean_over_dft,
    misfit_of,
    squared_error_of,
    wiener_filter,
)
from mishutter.decoding.decoders.speed import (
    Blurs,
    Energies,
    Posterior,
    SpeedEstimate,
    _flat_window,
    _likeness,
    _phase_energy,
    _spectrum_energy,
    bands,
    energies,
    judged,
    log_power,
    luminance,
    parts_of,
    posterior_of,
    prior,
    speeds_to_try,
)
from mishutter.decoding.decoders.total_variation import (
    TotalVariationDecoder,
    _shrunk,
    adjoint_differences,
    differences,
)
from mishutter.decoding.photographs import _Errors, errors_of, levels_of

HALF = 0.01
MOTION = ms.ParabolicMotion(acceleration=2e5, half_exposure=HALF)


def model_of(shutter=None, low=-1500.0, high=1500.0, **others) -> BlurModel:
    numbers = {"photon_rate": 3e4, "read_noise": 5.0, "num_speeds": 5} | others
    scene = ms.Scene.uniform(min_speed=low, max_speed=high, **numbers)
    return blur_model(scene, MOTION, ms.RectShutter() if shutter is None else shutter)


def whole(half):
    """All frequencies of a DFT of an even length, of numbers of those from 0 up."""
    return np.concatenate([half, half[..., -2:0:-1]], axis=-1)


@pytest.mark.parametrize("decoder", [ms.EnsembleDecoder(), ms.WienerDecoder()])
def test_a_filter_restores_the_level_of_light_that_the_shutter_lost(decoder):
    """Half of the light is white again; of a shutter that is closed nothing is."""
    model = model_of(ms.HannShutter())
    assert model.efficiency == pytest.approx(0.5)
    rows = jnp.asarray(np.full((1, 3, 160), 0.5) * np.array([0.2, 0.5, 0.8])[:, None])
    np.testing.assert_allclose(decoder.restore(rows, model), 2 * rows, atol=1e-6)
    closed = replace(model, efficiency=0.0)
    assert np.all(np.abs(decoder.restore(jnp.full((1, 2, 160), 0.3), closed)) < 1e-6)


def test_filters_and_the_misfit_are_sums_over_the_speeds():
    """Weighted by how often they occur, at each frequency by itself."""
    scene = ms.Scene([-700.0, 300.0, 1400.0], [0.2, 0.5, 0.3], photon_rate=3e4, read_noise=5.0)
    model, length = blur_model(scene, MOTION, ms.HannShutter()), 240
    responses, power = model.responses_at(model.speeds, length), model.picture_spectrum(length)
    mean = sum(p * h for p, h in zip(model.weights, responses, strict=True))
    square = sum(p * np.abs(h) ** 2 for p, h in zip(model.weights, responses, strict=True))
    gain = power * mean.conj() / (power * square + model.noise)
    np.testing.assert_allclose(ensemble_filter(model, length), gain, atol=1e-12)
    still = model.responses_at(np.zeros(1), length)[0]
    wiener = still.conj() / (np.abs(still) ** 2 + model.noise / power)
    np.testing.assert_allclose(wiener_filter(model, length), wiener, rtol=1e-9)
    found, own_power, disturbance, error = misfit_of(model, length)
    np.testing.assert_allclose(found, mean, atol=1e-12)
    np.testing.assert_allclose(own_power, power)
    np.testing.assert_allclose(disturbance, model.noise + power * (square - np.abs(mean) ** 2))
    left = [power * np.abs(1 - gain * h) ** 2 + model.noise * np.abs(gain) ** 2 for h in responses]
    wanted = np.mean(whole(np.tensordot(model.weights, left, 1)))
    assert error == pytest.approx(wanted)
    assert expected_squared_error(model, length) == pytest.approx(wanted)
    random = np.random.default_rng(2)
    rows = 0.3 + 0.1 * random.normal(size=(2, 4, 90))
    mirrored = np.concatenate([rows, rows[..., ::-1]], axis=-1)
    mirrored -= np.mean(mirrored, axis=-1, keepdims=True)
    gain, speeds = ensemble_filter(model, 180), np.array([-400.0, 900.0])
    noise = np.mean(rows) * 0.5 / model.electrons + (5 / model.electrons) ** 2
    for speed, found in zip(speeds, squared_error_of(model, rows, speeds), strict=True):
        missed = 1 - whole(gain * model.responses_at(np.array([speed]), 180)[0])
        # A half of a DFT stands for its conjugate, whose gain is that of the mirrored frequency.
        lost = np.abs(np.fft.fft(mirrored)) ** 2 * np.abs(missed) ** 2 / 180**2
        wanted = np.mean(np.sum(lost, axis=-1)) + noise * np.mean(np.abs(whole(gain)) ** 2)
        assert found == pytest.approx(wanted, rel=1e-6)


def test_means_over_half_of_a_dft_are_those_over_all():
    """Of rows and of pictures of even rows; planes before them stay."""
    random = np.random.default_rng(1)
    light = random.normal(size=(3, 6, 10))
    every = np.abs(np.fft.fft(light)) ** 2
    half = np.abs(np.fft.rfft(light)) ** 2
    np.testing.assert_allclose(mean_over_dft(half, 10), np.mean(every, axis=-1))
    every, half = np.abs(np.fft.fft2(light)) ** 2, np.abs(np.fft.rfft2(light)) ** 2
    np.testing.assert_allclose(mean_over_dft(half, 6, 10), np.mean(every, axis=(1, 2)))


@pytest.mark.parametrize(
    ("low", "high", "first", "last"),
    [
        (-1000.0, 4500.0, 0.0, 4912.5),
        (500.0, 4500.0, 100.0, 4900.0),
        (-4500.0, -500.0, 100.0, 4900.0),
        (-4500.0, 1000.0, 0.0, 4912.5),
        (-500.0, 500.0, 0.0, 550.0),
    ],
)
def test_sizes_of_speeds_are_tried_where_signs_look_alike(low, high, first, last):
    """A tenth of the range beyond either end, from the least size of any of them."""
    model = model_of(low=low, high=high)
    speeds, reach = speeds_to_try(model)
    other, _ = speeds_to_try(replace(model, speeds=-model.speeds))
    np.testing.assert_allclose(other, speeds)
    assert speeds[0] == pytest.approx(first, abs=1e-6)
    assert speeds[-1] == pytest.approx(last)
    step = (last - first) / (len(speeds) - 1)
    np.testing.assert_allclose(np.diff(speeds), step)
    assert reach == pytest.approx(max(2 / (2 * HALF), step))
    assert len(speeds) == 1 + min(max(math.ceil((last - first) / 100), 32), 512)


def test_likeness_is_the_highest_correlation():
    """Of shifted blurs it is 1; of others that of the shift at which they are most alike."""
    random = np.random.default_rng(3)
    one, other = random.uniform(size=(2, 30))
    spectra = np.fft.rfft([one, other])
    across = max(np.sum(one * np.roll(other, k)) for k in range(30))
    wanted = across / np.sqrt(np.sum(one**2) * np.sum(other**2))
    assert _likeness(*spectra) == pytest.approx(wanted)
    assert _likeness(spectra[0], 3 * np.fft.rfft(np.roll(one, 7))) == pytest.approx(1)


def energies_of(spectrum, phase=None, distance=5.0, counts=(100.0, 400.0)):
    phase = np.zeros((2, len(spectrum))) if phase is None else phase
    return Energies(np.asarray(spectrum, float), phase, np.array(counts), distance)


def test_probabilities_are_of_the_mean_evidence_of_tiles():
    """Energies of spectra in the mean, those of edges by the root of all waves of an octave."""
    random, statistics, speeds = np.random.default_rng(4), prior(), np.arange(5.0)
    parts = [
        energies_of(random.normal(size=5), random.normal(size=(2, 5)) / 30, counts=c)
        for c in ((100.0, 400.0), (60.0, 900.0))
    ]
    found = posterior_of(parts, speeds, 1.5, statistics)
    energy = statistics.spectrum_weight * (parts[0].spectrum + parts[1].spectrum) / 2
    roots = np.sqrt([160.0, 1300.0])
    edges = (parts[0].phase + parts[1].phase) / 2
    energy = energy + statistics.phase_weight * sum(
        n * e for n, e in zip(roots, edges, strict=True)
    )
    weights = np.exp(-energy)
    np.testing.assert_allclose(found.weights, weights / weights.sum())
    assert (found.reach, found.width) == (1.5, statistics.width)


def test_a_posterior_is_of_its_mode_and_of_all():
    """Means near the mode, errors over all, in which those near count by a width."""
    weights = np.array([0.05, 0.1, 0.4, 0.25, 0.0, 0.2])
    found = Posterior(np.array([0.0, 10.0, 20.0, 30.0, 40.0, 50.0]), weights, 10.0, 0.5)
    assert found.mode == 2
    np.testing.assert_array_equal(found.near, [False, True, True, True, False, False])
    mean = (0.1 * 10 + 0.4 * 20 + 0.25 * 30) / 0.75
    assert found.speed == pytest.approx(mean)
    squares = 0.05 * mean**2 + 0.2 * (50 - mean) ** 2
    squares += 0.25 * (0.1 * (10 - mean) ** 2 + 0.4 * (20 - mean) ** 2 + 0.25 * (30 - mean) ** 2)
    assert found.error == pytest.approx(np.sqrt(squares))
    sure = found._replace(weights=np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0]))
    assert sure.error == pytest.approx(0.5 * 10 / np.sqrt(12))
    assert found.around(45.0) == pytest.approx(0.25 + 0.2)
    assert found.trusted(0.75 - 1e-9)
    assert not found.trusted(0.76)
    for mode, is_end in enumerate([False, False, False, False, True, True]):
        one = found._replace(weights=np.eye(6)[mode])
        assert one.at_end == is_end
        beyond = one._replace(speeds=one.speeds + 5)
        assert beyond.at_end == (is_end or mode < 2)


def test_an_estimate_past_a_pan_is_in_the_scene():
    """Mirrored where the scene's speeds go further down from the pan, and its doubt with it."""
    speeds, weights = np.array([0.0, 10.0, 20.0]), np.array([0.2, 0.5, 0.3])
    found = SpeedEstimate(12.0, 1.0, True, speeds, weights, "", second_speed=4.0)
    scene = ms.Scene([-100.0, 40.0], photon_rate=1e4, read_noise=2.0)
    pan = replace(MOTION, velocity=jnp.asarray(30.0))
    there = found.of(scene, pan)
    assert (there.speed, there.second_speed) == (18.0, 26.0)
    np.testing.assert_allclose(there.speeds, [10, 20, 30])
    np.testing.assert_allclose(there.weights, [0.3, 0.5, 0.2])
    assert there.doubt == "Some rows seem to move at 26 px/s, where all rows together do at 18."
    signed = found._replace(speeds=np.array([-10.0, 0.0, 10.0])).of(scene, pan)
    assert (signed.speed, signed.second_speed) == (42.0, 34.0)
    np.testing.assert_allclose(signed.speeds, [20, 30, 40])
    np.testing.assert_allclose(signed.weights, weights)


def peaked(place, depth=2000.0, distance=5.0):
    energy = np.full(9, depth)
    energy[place] = 0.0
    return energies_of(energy, distance=distance)


def test_bands_that_deny_the_speed_are_a_second_one():
    """At which the band that denies it most is; weights are then the mean with those of bands."""
    speeds, statistics = np.arange(0.0, 90.0, 10.0), prior()
    bands_ = [[peaked(3), peaked(3)], [peaked(3, 4000.0)], [peaked(6)]]
    found, whole_ = judged(bands_, speeds, 10.0, statistics)
    assert (found.speed, found.second_speed, found.trusted) == (
        pytest.approx(30),
        pytest.approx(60),
        False,
    )
    assert "at 60 px/s, where all rows together do at 30" in found.doubt
    each = np.eye(9)[[3, 3, 6]].mean(axis=0)
    np.testing.assert_allclose(found.weights, (whole_.weights + each) / 2, atol=1e-6)
    assert not found.is_unusual
    alike, _ = judged([[peaked(3)], [peaked(4, distance=45.0)]], speeds, 10.0, statistics)
    assert alike.second_speed is None
    assert alike.is_unusual  # 25 in the mean, of which 24.7 is the hundredth of 11 numbers
    last, _ = judged([[peaked(7)]], speeds, 10.0, statistics)
    assert last.doubt == "The speed may lie beyond those of the scene."
    unsure, _ = judged([[peaked(4, 1.0)]], speeds, 10.0, statistics)
    assert unsure.doubt == "The picture has too little detail to show its speed."


def test_grey_has_the_noise_of_its_colours():
    """Of three by their shares of the luminance, of two equally; a level below 0 has no light."""
    random, model = np.random.default_rng(5), model_of()
    electrons, dark = model.electrons, (5.0 / model.electrons) ** 2
    for shares in ([0.2126, 0.7152, 0.0722], [0.5, 0.5]):
        planes = random.uniform(0, 1, size=(len(shares), 4, 6))
        planes[0] -= 2
        light, noise = luminance(planes, model)
        np.testing.assert_allclose(light, np.tensordot(shares, planes, 1), atol=1e-6)
        levels = np.maximum(planes.mean(axis=(1, 2)), 0)
        wanted = sum(s**2 * (x / electrons + dark) for s, x in zip(shares, levels, strict=True))
        assert noise == pytest.approx(wanted)


def place_of(tile, *_):
    """A tile's size and its first pixel, as evidence."""
    return energies_of(np.zeros(2), counts=(*tile.shape, tile[0, 0]))


@pytest.mark.parametrize(
    ("shape", "tiles"),
    [((120, 300), [[120]]), ((128, 300), [[64], [64]]), ((700, 300), [[175]] * 4)],
)
def test_pictures_are_looked_at_by_bands(monkeypatch, shape, tiles):
    """Of 64 rows and more, four at most; each band from top to bottom."""
    monkeypatch.setattr(speeds_module, "energies", place_of)
    light = np.broadcast_to(np.arange(float(shape[0]))[:, None], shape)
    found = parts_of(light, model_of(), np.array([0.0, 100.0]), 1e-3, prior())
    assert [[tile.counts[0] for tile in band] for band in found] == tiles
    firsts = np.cumsum([0] + [rows for (rows,) in tiles[:-1]])
    assert [band[0].counts[2] for band in found] == firsts.tolist()


def test_wide_pictures_are_looked_at_in_tiles(monkeypatch):
    """No wider than 1024 px, or four kernels; each row of tiles is a band."""
    monkeypatch.setattr(speeds_module, "energies", place_of)
    light = np.zeros((130, 2500))
    found = parts_of(light, model_of(), np.array([0.0, 100.0]), 1e-3, prior())
    sizes = [[tuple(tile.counts[:2]) for tile in band] for band in found]
    assert sizes == [[(65, 834), (65, 833), (65, 833)]] * 2


def test_the_logarithm_of_a_power_has_no_bias():
    """Of white noise it is in the mean that of the variance, in every band and along the rows."""
    random = np.random.default_rng(6)
    each = np.mean([log_power(0.3 * random.normal(size=(48, 96)) + 5) for _ in range(80)], axis=0)
    # The mean of a band scatters by 0.02, and that of all by 0.006.
    assert np.mean(each) == pytest.approx(2 * np.log(0.3), abs=0.02)
    np.testing.assert_allclose(np.mean(each, axis=1), 2 * np.log(0.3), atol=0.05)


def test_bands_hold_every_frequency_once_and_smooth_terms():
    """The terms of one frequency are powers and Legendre polynomials of its logarithms."""
    layout = bands(40, 60)
    np.testing.assert_array_equal(np.sort(np.concatenate(layout.members)), np.arange(40))
    # Powers of complex Gaussians correlate by the square of their correlation.
    waves = np.exp(-2j * np.pi * np.outer(np.arange(40), np.arange(40)) / 40)
    waves *= np.sin(np.pi * (np.arange(40) + 0.5) / 40)
    correlations = np.abs(waves @ waves.conj().T / np.sum(np.abs(waves[0]) ** 2)) ** 2
    each = [len(band) ** 2 / correlations[np.ix_(band, band)].sum() for band in layout.members]
    np.testing.assert_allclose(layout.counts[:, 0], each)
    assert (layout.along.start, layout.along.stop) == (2, 29)
    band, place = 3, 11
    down = np.mean(np.abs(np.fft.fftfreq(40))[layout.members[band]])
    across = (2 + place) / 60
    radial = (np.log(np.hypot(across, down) + 0.003) + 2) / 2
    column = (np.log(down + 0.003) + 2.5) / 2
    x = 2 * np.log(across / 0.004) / np.log(0.5 / 0.004) - 1
    legendre = [np.polynomial.legendre.legval(x, np.eye(6)[n]) for n in range(1, 6)]
    wanted = [1, radial, radial**2, *legendre, column, column**2, x * column]
    found = layout.terms.reshape(len(layout.members), -1, 11)[band, place]
    np.testing.assert_allclose(found, wanted, rtol=1e-5, atol=1e-6)


def test_the_power_of_a_blur_leaks_through_the_window():
    """As the circular mean of its power by the power of the window's DFT."""
    columns, random = 128, np.random.default_rng(7)
    responses = np.fft.rfft(random.normal(size=(2, 9)), columns)
    window = np.array(
        [
            np.sin(np.pi / 2 * min(8 * min(x + 0.5, columns - x - 0.5) / columns, 1)) ** 2
            for x in range(columns)
        ]
    )
    np.testing.assert_allclose(_flat_window(columns), window)
    leak = np.abs(np.fft.fft(window)) ** 2
    leak /= np.sum(leak)
    power = whole(np.abs(responses) ** 2)
    wanted = np.real(np.fft.ifft(np.fft.fft(power) * np.fft.fft(leak)))[:, :65]
    found = Blurs.of(responses, columns)
    np.testing.assert_allclose(found.power, wanted, rtol=2e-3, atol=2e-3)
    np.testing.assert_allclose(np.abs(found.phases), 1, atol=1e-3)
    undone = responses * found.phases
    np.testing.assert_allclose(undone, np.abs(responses), atol=1e-4)


def spectrum_problem():
    """Powers of two blurs in noise, of a smooth spectrum near the prior's mean."""
    random, statistics = np.random.default_rng(8), prior()
    layout = bands(24, 64)
    layout = layout._replace(terms=layout.terms.astype(np.float64))
    columns = layout.terms.shape[0] // len(layout.members)
    blur = random.uniform(0.05, 1, size=(2, columns))
    smooth = (layout.terms @ statistics.mean).reshape(-1, columns)
    noise = float(np.exp(np.median(smooth)))
    observed = np.log(np.exp(smooth) * blur[0] + noise) + 0.1 * random.normal(size=smooth.shape)
    return observed, blur, noise, layout, statistics


def test_the_evidence_of_a_spectrum_is_laplaces():
    """The energy of Student's t and the prior at its least, and half the logarithm of curvature."""
    observed, blur, noise, layout, statistics = spectrum_problem()
    found, coefficients = _spectrum_energy(observed, blur, noise, layout, statistics)
    scatter = polygamma(1, layout.counts)
    for number, own in enumerate(coefficients):
        signal = np.exp(layout.terms @ own).reshape(observed.shape) * blur[number]
        share = signal / (signal + noise)
        left = observed - np.log(signal + noise)
        variance = scatter + share**2 * statistics.misfit
        off = own - statistics.mean
        energy = np.sum(2.5 * np.log(1 + left**2 / (4 * variance)) + np.log(variance) / 2)
        energy += off @ statistics.precision @ off / 2
        weight = (1.25 / (1 + left**2 / (4 * variance)) / variance * share).ravel()
        slopes = layout.terms * share.ravel()[:, None]
        curvature = layout.terms.T @ (slopes * weight[:, None]) + statistics.precision
        pull = layout.terms.T @ (weight * left.ravel()) - statistics.precision @ off
        assert found[number] == pytest.approx(energy + np.linalg.slogdet(curvature)[1] / 2)
        assert np.max(np.abs(np.linalg.solve(curvature, pull))) < 0.05


def test_the_evidence_of_edges_is_that_of_octaves():
    """Of a tile of steps through the right phase and a wrong one, on a grid of all pixels."""
    rows, columns = 64, 256
    steps = np.repeat(np.random.default_rng(9).normal(size=(8, 8)), 8, axis=0)
    tile = np.repeat(steps, 32, axis=1).astype(np.float32)
    wrong = np.exp(2j * np.pi * 40 * np.fft.rfftfreq(columns) ** 2)
    phases = np.stack([np.ones(129), wrong]).astype(np.complex64)
    amplitude = np.ones((rows, 129), np.float32)
    energy, counts = _phase_energy(tile, phases, amplitude)
    taper = np.outer(_flat_window(rows), _flat_window(columns))
    light = (tile - np.sum(tile * taper) / np.sum(taper)) * taper
    frequency = np.fft.rfftfreq(columns)
    for octave, (low, high) in enumerate(
        [(0.008, 0.018), (0.018, 0.04), (0.04, 0.09), (0.09, 0.2)]
    ):
        with np.errstate(divide="ignore"):
            place = np.log2(frequency)
        mask = (
            1
            / (1 + np.exp(-8 * (place - np.log2(low))))
            / (1 + np.exp(8 * (place - np.log2(high))))
        )
        part = np.fft.rfft2(light) * mask
        shown = np.abs(part[:, : 1 + max(32, int(2 * high * columns))]) ** 2
        assert counts[octave] == pytest.approx(np.sum(shown) ** 2 / np.sum(shown**2), rel=0.05)
        for speed, phase in enumerate(phases):
            square = np.fft.irfft2(part * phase, (rows, columns)) ** 2
            wanted = np.mean(np.log(1 + square / np.mean(square)))
            assert energy[octave, speed] == pytest.approx(wanted, rel=0.05)
    assert energy[-1, 0] < energy[-1, 1]


def test_the_distance_of_a_spectrum_is_in_units_of_the_prior():
    """That of the likeliest spectrum of all speeds, as the sum of squares of eleven numbers."""
    random, statistics = np.random.default_rng(10), prior()
    tile = random.normal(size=(24, 64)).cumsum(axis=1).astype(np.float32) / 20
    responses = np.fft.rfft(np.array([[1.0, 0, 0, 0, 0], [0.2] * 5]), 64)
    blurs, noise = Blurs.of(responses, 64), 1e-3
    found = energies(tile, blurs, noise, statistics)
    layout = bands(24, 64)
    energy, coefficients = _spectrum_energy(
        log_power(tile), blurs.power[:, layout.along], noise, layout, statistics
    )
    off = coefficients[np.argmin(energy)] - statistics.mean
    assert found.distance == pytest.approx(np.sum(off * (statistics.precision @ off)))
    np.testing.assert_allclose(found.spectrum, energy)
    smooth = np.exp(layout.terms @ coefficients[np.argmin(energy)]).reshape(len(layout.members), -1)
    smooth = smooth * np.mean(blurs.power[:, layout.along], axis=0)
    amplitude = np.zeros((24, 33), np.float32)
    for k, band in enumerate(layout.members):
        amplitude[band, 2:31] = np.sqrt(smooth[k]) / (smooth[k] + noise)
        amplitude[band, 1] = amplitude[band, 2]
    phase, counts = _phase_energy(tile, blurs.phases, amplitude)
    np.testing.assert_allclose(found.phase, phase, rtol=1e-4)
    np.testing.assert_allclose(found.counts, counts, rtol=1e-4)


def test_differences_among_four_pixels_and_their_adjoint():
    """Halves of the squares of both differences within rows and of both between them."""
    random = np.random.default_rng(11)
    light, other = random.normal(size=(4, 6)), random.normal(size=(4, 5, 6))
    found = np.asarray(differences(jnp.asarray(light)))
    np.testing.assert_allclose(
        np.sum(found * other), np.sum(light * adjoint_differences(jnp.asarray(other))), rtol=1e-5
    )
    square = np.sum(found**2, axis=0)
    for row in range(5):
        for column in range(6):
            pair = [column, (column + 1) % 6]
            above, below = (light[k, pair] if 0 <= k < 4 else None for k in (row - 1, row))
            wanted = sum(np.diff(x)[0] ** 2 / 2 for x in (above, below) if x is not None)
            if above is not None and below is not None:
                wanted += np.sum((below - above) ** 2) / 2
            assert square[row, column] == pytest.approx(wanted, rel=1e-5)


def test_vectors_shrink_by_a_length():
    """Of several numbers together, and to none where they are shorter."""
    vectors = np.array([[3.0, 0.3, 0.0], [-4.0, 0.4, 0.0]])
    np.testing.assert_allclose(_shrunk(vectors, 1.0), [[2.4, 0, 0], [-3.2, 0, 0]])


def test_total_variation_of_a_capture_ends_at_its_minimum(monkeypatch):
    """Of misfit, a twentieth of the power over its expectation and 0.3 c/e of the edges."""
    columns = 48
    ring = Continuation(np.zeros((0, 2)), columns, columns, 1)  # Rows that go on as they begin
    monkeypatch.setattr(total_variation, "continuation", lambda *_: ring)
    model = model_of(ms.HannShutter(), low=-200.0, high=500.0)
    random = np.random.default_rng(12)
    captured = 0.15 + 0.05 * random.normal(size=(1, 10, columns)).cumsum(axis=-1) / 3
    decoder = TotalVariationDecoder(num_iterations=800, strength=1.3)
    light = np.asarray(decoder.restore(jnp.asarray(captured), model), np.float64)[0]
    quick = replace(decoder, num_iterations=TotalVariationDecoder().num_iterations)
    restored = np.asarray(quick.restore(jnp.asarray(captured), model))[0]
    centre = np.mean(captured)
    data = np.fft.fft(captured[0] - centre)
    mean, power, disturbance, error = (
        whole(np.asarray(x)) if np.ndim(x) else x for x in misfit_of(model, columns)
    )
    np.testing.assert_allclose(restored, light, atol=0.1 * np.sqrt(error))
    frequencies = np.fft.fftfreq(columns)
    mean = np.where(frequencies < 0, mean.conj(), mean)

    def cost(picture):
        spectrum = np.fft.fft(picture - centre / model.efficiency)
        misfit = np.sum(np.abs(data - mean * spectrum) ** 2 / disturbance) / 2
        smooth = np.sum((np.abs(spectrum) ** 2 / power)[:, 1:]) / 20
        edges = np.sqrt(np.sum(np.asarray(differences(jnp.asarray(picture)), np.float64) ** 2, 0))
        return (misfit + smooth) / columns + 0.3 * 1.3 / np.sqrt(error) * np.sum(edges)

    least = cost(light)
    wave = np.cos(2 * np.pi * np.arange(columns) / columns) * np.ones((10, 1))
    for other in (
        light - np.mean(light),
        wave,
        np.ones_like(light),
        random.normal(size=light.shape),
    ):
        scale = 1e-2 * np.ptp(light) / np.max(np.abs(other))
        for side in (1, -1):
            assert cost(light + side * scale * other) > least


def test_levels_are_means_over_seeds_and_speeds():
    """Of three captures at each of two speeds, of which the second occurs three times as often."""
    random = np.random.default_rng(13)
    squared, coded = (
        random.uniform(0.01, 0.02, size=(2, 3, 2)),
        random.uniform(20, 30, size=(2, 3, 2)),
    )
    trials = [_Errors(*each) for each in zip(squared, coded, strict=True)]
    found = levels_of(np.array([0.0, 9.0]), np.array([0.25, 0.75]), trials, 1)
    mean = np.mean(squared[:, :, 1], axis=1)
    np.testing.assert_allclose(found.linear_psnr, -10 * np.log10(mean))
    np.testing.assert_allclose(found.psnr, np.mean(coded[:, :, 1], axis=1))
    assert found.mean_psnr == pytest.approx(-10 * np.log10(0.25 * mean[0] + 0.75 * mean[1]))
    spread = np.std(coded[:, :, 1], axis=1, ddof=1) / np.sqrt(3)
    np.testing.assert_allclose(found.standard_error, spread)
    error = np.std(squared[:, :, 1], axis=1, ddof=1) / np.sqrt(3)
    up = -10 * np.log10(mean - 1e-6 * error)
    down = -10 * np.log10(mean + 1e-6 * error)
    np.testing.assert_allclose(found.linear_standard_error, (up - down) / 2e-6, rtol=1e-4)
    even = levels_of(np.array([0.0, 9.0]), None, trials, 1)
    assert even.mean_psnr == pytest.approx(-10 * np.log10(np.mean(mean)))


def test_errors_are_mean_squares():
    """Of each estimate, in linear light, and as a level of coded values."""
    truth = np.full((4, 5, 1), 0.25)
    off = truth + 0.1 * np.array([1.0, -1.0, 1.0, -1.0])[:, None, None]
    found = errors_of(truth, [truth, off])
    np.testing.assert_allclose(found.squared, [[0, 0.01]], atol=1e-12)
    assert found.coded[0, 1] == pytest.approx(float(ms.psnr(truth, off, gamma=True)))
