"""The ceiling against closed forms and other arithmetic, and as a bound of every design drawn."""

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from support.helpers import ROUNDING

from benchmarks.scenes import scenes
from mishutter import (
    HannShutter,
    Limits,
    LinearMotion,
    Optics,
    ParabolicMotion,
    RectShutter,
    Scene,
    SplineShutter,
    StillCamera,
    Texture,
    ceiling,
    evaluate,
)

# Instants and counts are steps of the ceiling, which returns a single number.
from mishutter.evaluation.ceilings import Times, _poured_error
from mishutter.evaluation.needs import Plan, frequency_counts

LONGEST = 0.012
LIMITS = Limits(max_stroke=40.0, max_half_exposure=LONGEST)
BOTH_WAYS = np.array([-1900.0, -800.0, 130.0, 700.0, 2100.0])
WEIGHTS = np.array([0.1, 0.35, 0.3, 0.05, 0.2])
SCENES = {
    "dim": Scene(BOTH_WAYS, WEIGHTS, photon_rate=3e4, read_noise=9.0, limits=LIMITS),
    "bright": Scene(BOTH_WAYS, WEIGHTS, photon_rate=2e7, read_noise=2.0, limits=LIMITS),
    "one way": Scene(
        [500.0, 700.0, 1100.0, 2600.0, 3000.0], photon_rate=2e5, read_noise=0.0, limits=LIMITS
    ),
    "mostly one": Scene(
        BOTH_WAYS, [0.02, 0.02, 0.92, 0.02, 0.02], photon_rate=4e5, read_noise=3.0, limits=LIMITS
    ),
}
PLAN = Plan(num_taps=64, dft_length=256, num_frequencies=256, num_nodes=512)
"""One size for all designs: their kernels are cut, and their transfer functions are whole."""

INTERPOLATION = 0.03
"""The ceiling is too high by at most so many dB, as its module says."""
GRIDS = 2e-3
"""Mean over 4,096 frequencies against the grid of the highest ceiling; dB."""


def _known(scene, num_frequencies):
    """Frequencies and picture power of the default spectrum; shapes `(m,)`."""
    frequency = (np.arange(num_frequencies) + 0.5) / (2 * num_frequencies)
    power = 1 / (frequency**2 + 0.01**2)
    return frequency, power * float(scene.picture.deviation) ** 2 / np.mean(power)


def _written_out(scene, most, half, num_frequencies=4096):
    """The ceiling of an eigenvalue `most(f)`, written out as section by section of its proof."""
    frequency, power = _known(scene, num_frequencies)
    electrons = float(scene.photon_rate) * 2 * half
    noise = float(scene.picture.mean_level) / electrons + (float(scene.read_noise) / electrons) ** 2
    signal = power * np.sinc(frequency) ** 2 * most(frequency)
    return -10 * np.log10(np.mean(power * noise / (signal + noise)))


def _eigenvalues(scene, half):
    """The largest eigenvalue at every frequency itself."""
    speeds, weights = np.asarray(scene.speeds), np.asarray(scene.weights)
    shares, gaps = np.sqrt(weights[:, None] * weights), speeds[:, None] - speeds
    return lambda frequency: np.array(
        [np.linalg.eigvalsh(shares * np.sinc(2 * half * f * gaps))[-1] for f in frequency]
    )


def test_two_speeds_have_their_closed_form():
    """The eigenvalue is 1/2 + sqrt((p - q)^2/4 + p q sinc^2), to all digits."""
    scene = Scene([-410.0, 930.0], [0.3, 0.7], photon_rate=1e5, read_noise=2.0)
    knots, times = Times.of_list(scene, 0.013)
    with mp.workdps(50):
        for f, found in zip(knots[::64], times[::64], strict=True):
            p, q = (mp.mpf(float(x)) for x in scene.weights)
            sinc = mp.sincpi(2 * mp.mpf(0.013) * mp.mpf(float(f)) * 1340)
            largest = (p + q) / 2 + mp.sqrt((p - q) ** 2 / 4 + p * q * sinc**2)
            assert abs(found / (f * 0.013 * largest) - 1) < ROUNDING


def test_three_speeds_have_the_eigenvalue_of_fifty_digits():
    """Of uneven speeds and weights, at frequencies of some and of many turns."""
    scene = Scene([-410.0, 37.0, 930.0], [0.3, 0.25, 0.45], photon_rate=1e5, read_noise=2.0)
    knots, times = Times.of_list(scene, 0.17)
    speeds, weights = ([mp.mpf(float(x)) for x in row] for row in (scene.speeds, scene.weights))
    with mp.workdps(50):
        for f, found in zip(knots[7::128], times[7::128], strict=True):
            turns = 2 * mp.mpf(0.17) * mp.mpf(float(f))
            rows = [
                [
                    mp.sqrt(p * q) * mp.sincpi(turns * (s - r))
                    for s, q in zip(speeds, weights, strict=True)
                ]
                for r, p in zip(speeds, weights, strict=True)
            ]
            largest = max(mp.eigsy(mp.matrix(rows), eigvals_only=True))
            assert abs(found / (f * 0.17 * largest) - 1) < ROUNDING


@pytest.mark.parametrize("name", SCENES)
def test_the_eigenvalue_by_frequency_never_falls(name):
    """So few eigenvalues bound those between, and the longest exposure bounds all."""
    _, times = Times.of_list(SCENES[name], LONGEST)
    assert np.all(np.diff(times) > -ROUNDING)


def test_the_eigenvalue_alone_rises_again():
    """The largest at the longest exposure is not the largest of all."""
    knots, times = Times.of_list(Scene([0.0, 900.0], photon_rate=1e5, read_noise=2.0), 0.013)
    assert np.max(np.diff(times / knots)) / 0.013 > 1e-3


@pytest.mark.parametrize("name", SCENES)
def test_the_ceiling_is_that_of_its_formula(name):
    """With an eigenvalue at each frequency it comes out at most 0.03 dB lower."""
    scene = SCENES[name]
    exact = _written_out(scene, _eigenvalues(scene, LONGEST), LONGEST)
    assert -GRIDS < float(ceiling(scene)) - exact < INTERPOLATION


def _random_shutter(rng):
    parameters = rng.uniform(0, 1, 8) ** rng.choice([0.2, 1.0, 4.0])
    return SplineShutter(np.where(rng.random(8) < rng.choice([0.0, 0.4]), 0.0, parameters))


def _random_motion(rng):
    half = LONGEST * rng.choice([1.0, rng.uniform(0.05, 1)])
    velocity = rng.choice([0.0, *BOTH_WAYS, rng.uniform(-3000, 3000)])
    if rng.random() < 0.3:
        return LinearMotion(half_exposure=half, velocity=velocity)
    stroke = 40 * rng.choice([0.0, rng.uniform(0.01, 1), rng.uniform(0.25, 1) ** 4])
    return ParabolicMotion(acceleration=stroke / half**2, half_exposure=half, velocity=velocity)


def _held(scene, metrics, ceilings):
    """Whether the metrics are in the order of what their decoders know, below the ceiling."""
    found = float(metrics.expected_psnr), float(metrics.known_speed_psnr)
    return (
        -10 * np.log10(float(scene.picture.deviation) ** 2)
        <= found[0]
        <= found[1] + 1e-9
        <= ceilings
    )


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENES)
def test_no_random_design_exceeds_the_ceiling(name):
    """Splines and windows, moving, panning and at rest: 30 designs a scene."""
    rng = np.random.default_rng(len(name))
    scene = SCENES[name]
    highest = float(ceiling(scene)) + 1e-9
    for index in range(30):
        motion = _random_motion(rng)
        shutter = RectShutter() if index % 5 == 0 else _random_shutter(rng)
        assert _held(scene, evaluate(scene, motion, shutter), highest), motion


def _segments(rng, scene, num_segments):
    """Velocities and transmittances, by segment, of a path that is random, dwells or bends."""
    low, high = float(scene.speeds.min()), float(scene.speeds.max())
    kind = rng.integers(4)
    velocity = {
        0: rng.choice(np.asarray(scene.speeds), num_segments),
        1: np.sort(rng.choice(np.asarray(scene.speeds), num_segments)),
        2: rng.uniform(low, high, num_segments),
        3: np.linspace(low, high, num_segments) * rng.uniform(-0.2, 1.3),
    }[int(kind)]
    light = {
        0: np.ones(num_segments),
        1: rng.uniform(0, 1, num_segments),
        2: (rng.random(num_segments) < rng.uniform()).astype(float),
        3: (np.abs(np.linspace(-1, 1, num_segments)) < rng.uniform(0.1, 1)).astype(float),
    }[int(rng.integers(4))]
    return velocity, light


def _errors(scene, velocity, light, half, num_frequencies=256):
    """Expected errors of one filter and of one a speed, on a path of straight segments.

    Each segment is integrated exactly: it is a sinc of the way that the object goes within it.
    """
    frequency, power = _known(scene, num_frequencies)
    step = 2 * half / velocity.size
    middle = -half + step * (np.arange(velocity.size) + 0.5)
    way = np.cumsum(velocity) * step - velocity * step / 2
    seen = velocity - np.asarray(scene.speeds)[:, None]
    place = way - np.asarray(scene.speeds)[:, None] * middle
    f = frequency[:, None, None]
    response = np.mean(light * np.sinc(f * seen * step) * np.exp(-2j * np.pi * f * place), axis=2)
    passed = (np.abs(response) * np.sinc(frequency)[:, None]) ** 2
    electrons = float(scene.photon_rate) * 2 * half
    noise = np.mean(light) * float(scene.picture.mean_level) / electrons
    noise += (float(scene.read_noise) / electrons) ** 2
    signal = power[:, None] * passed
    weights = np.asarray(scene.weights)
    if not np.any(light):
        return np.mean(power), np.mean(power)
    whole = signal @ weights
    coherent = power * np.abs(response @ weights * np.sinc(frequency)) ** 2
    one = np.mean(power * (whole - coherent + noise) / (whole + noise))
    return one, np.mean(power * ((noise / (signal + noise)) @ weights))


def _check_paths(scene, seed, count):
    rng = np.random.default_rng(seed)
    allowed = 10 ** (-float(ceiling(scene)) / 10) * (1 - 1e-9)
    for _ in range(count):
        half = LONGEST * rng.choice([1.0, rng.uniform(0.1, 1)])
        one, told = _errors(scene, *_segments(rng, scene, int(rng.integers(2, 40))), half)
        assert allowed <= told <= one * (1 + 1e-9)


@pytest.mark.parametrize("name", SCENES)
def test_no_random_path_exceeds_the_ceiling(name):
    """Neither paths that dwell at the speeds of the list, which no parabola does."""
    _check_paths(SCENES[name], 3 * len(name), 60)


@pytest.mark.slow
def test_paths_of_the_test_are_measured_as_designs_are():
    """A straight path, cut into segments, has the metrics of a panning camera."""
    scene, velocity = SCENES["dim"], np.full(7, 640.0)
    one, told = _errors(scene, velocity, np.ones(7), LONGEST)
    motion = LinearMotion(half_exposure=LONGEST, velocity=640.0)
    found = evaluate(scene, motion, RectShutter())
    np.testing.assert_allclose(-10 * np.log10(one), found.expected_psnr, rtol=1e-9)
    np.testing.assert_allclose(-10 * np.log10(told), found.known_speed_psnr, rtol=1e-9)


@pytest.mark.slow
def test_one_speed_has_the_ceiling_of_a_camera_that_keeps_up_with_it():
    """Panning with an open shutter reaches it; the best a camera at rest can do does not."""
    scene = Scene([700.0], photon_rate=7e4, read_noise=6.0, limits=LIMITS)
    highest = float(ceiling(scene))
    panning = LinearMotion(half_exposure=LONGEST, velocity=700.0)
    reached = evaluate(scene, panning, RectShutter())
    assert reached.expected_psnr == pytest.approx(highest, abs=1e-5)
    assert reached.known_speed_psnr == pytest.approx(highest, abs=1e-5)
    snapshot = StillCamera(half_exposure=1.09 / 700 / 2)
    assert float(evaluate(scene, snapshot, RectShutter()).expected_psnr) < highest - 1


def test_a_shift_of_all_speeds_changes_nothing():
    """A pan does the same to the sensor; be they of either sign about it or of one."""
    even = SCENES["dim"].without_metadata(
        speeds=np.array([-900.0, 0.0, 900.0]), weights=np.ones(3) / 3
    )
    for scene in (SCENES["dim"], even):
        shifted = scene.without_metadata(speeds=scene.speeds + 1234.5)
        assert float(ceiling(shifted)) == pytest.approx(float(ceiling(scene)), rel=1e-12)


def test_more_light_and_longer_exposures_raise_the_ceiling():
    """The limit that counts is that of the scene, unless another is given."""
    scene = SCENES["dim"]
    assert float(ceiling(scene)) == float(ceiling(scene, max_half_exposure=LONGEST))
    levels = [float(ceiling(scene, max_half_exposure=LONGEST * x)) for x in (0.01, 0.3, 1.0, 3.0)]
    assert np.all(np.diff(levels) > 0)
    assert float(ceiling(SCENES["bright"])) > levels[2]


def test_a_list_without_a_limit_on_exposure_has_no_ceiling():
    """A path that dwells at each speed collects all light; continuous speeds have a ceiling."""
    assert np.isposinf(ceiling(SCENES["dim"], max_half_exposure=jnp.inf))
    longer = [float(ceiling(SCENES["dim"], max_half_exposure=x)) for x in (1e3, 1e6, 1e9)]
    np.testing.assert_allclose(np.diff(longer), 30, atol=0.1)


UNIFORM = Scene.uniform(max_speed=1800.0, photon_rate=6e4, read_noise=5.0, limits=LIMITS)


def test_continuous_speeds_have_their_closed_form():
    """Of uniform speeds the eigenvalue is at most 1/(4STf); no limit leaves the rate alone."""
    exact = _written_out(UNIFORM, lambda f: np.minimum(1, 1 / (4 * 1800 * LONGEST * f)), LONGEST)
    assert float(ceiling(UNIFORM, continuous=True)) == pytest.approx(exact, abs=GRIDS)
    frequency, power = _known(UNIFORM, 4096)
    gain = np.sinc(frequency) ** 2 * 6e4 / (2 * 1800 * frequency * 0.25)
    unlimited = -10 * np.log10(np.mean(power / (1 + power * gain)))
    found = float(ceiling(UNIFORM, max_half_exposure=np.inf, continuous=True))
    assert found == pytest.approx(unlimited, abs=GRIDS)


def test_the_ceilings_of_scenes():
    """Without a limit on exposure, of speeds spread between the ends of each list."""
    found = [
        float(ceiling(scene, max_half_exposure=np.inf, continuous=True))
        for scene in scenes().values()
    ]
    np.testing.assert_allclose(found, [28.83, 24.62, 44.55, 33.44, 30.85, 27.57], atol=0.01)


BELL = np.exp(-0.5 * (np.linspace(-1, 1, 9) / 0.45) ** 2)


def _refined(scene, num_parts):
    """A scene with each equal cell of the range cut into parts; the middle of each is a speed."""
    low, high, count = float(scene.speeds[0]), float(scene.speeds[-1]), scene.speeds.size
    fine = low + (np.arange(count * num_parts) + 0.5) * (high - low) / (count * num_parts)
    return scene.without_metadata(
        speeds=fine, weights=np.repeat(np.asarray(scene.weights), num_parts)
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "scene", [UNIFORM, UNIFORM.without_metadata(weights=BELL)], ids=["uniform", "bell"]
)
def test_the_continuous_ceiling_bounds_speeds_spread_finely(scene):
    """Of 72 speeds: their own ceiling comes near from below, and designs stay under it."""
    highest = float(ceiling(scene, continuous=True))
    crowd = _refined(scene, 8)
    assert highest - 1.2 < float(ceiling(crowd)) < highest + INTERPOLATION
    assert float(ceiling(scene, continuous=False)) > highest + 1
    rng = np.random.default_rng(11)
    for _ in range(6):
        found = evaluate(crowd, _random_motion(rng), _random_shutter(rng))
        assert _held(crowd, found, highest)
    _check_paths(crowd, 5, 20)


def test_without_light_the_ceiling_is_the_variance_of_the_picture():
    """As is the error of every design, with and without read noise."""
    for noise in (0.0, 5.0):
        scene = Scene(
            BOTH_WAYS,
            photon_rate=0.0,
            read_noise=noise,
            picture=Texture(deviation=0.17),
            limits=LIMITS,
        )
        for half in (LONGEST, np.inf):
            for continuous in (False, True):
                listed = UNIFORM.without_metadata(speeds=np.linspace(-7, 9, 5), weights=np.ones(5))
                dark = scene.without_metadata(speeds=listed.speeds) if continuous else scene
                found = ceiling(dark, max_half_exposure=half, continuous=continuous)
                assert float(found) == pytest.approx(-20 * np.log10(0.17), rel=1e-12)
        dark = evaluate(scene, StillCamera(half_exposure=LONGEST), HannShutter())
        assert float(dark.known_speed_psnr) == pytest.approx(-20 * np.log10(0.17), rel=1e-12)


def test_a_picture_of_no_mean_has_the_error_of_one_that_hardly_has_any():
    """Its read noise is left, of speeds that fill their range unevenly."""
    speeds, weights = np.linspace(-700.0, 900.0, 5), np.array([1.0, 2.0, 5.0, 2.0, 1.0])
    light = {"photon_rate": 2e5, "read_noise": 6.0}
    none, little = (
        _poured_error(Scene(speeds, weights, **light, picture=Texture(mean_level=mean)), 0.012, 64)
        for mean in (0.0, 1e-9)
    )
    assert none == pytest.approx(little, rel=1e-6)
    assert none > 0


def test_what_loses_nothing_has_no_ceiling():
    """A grey picture, and one recorded without any noise."""
    light = {"photon_rate": 1e5, "limits": LIMITS}
    grey = Scene(BOTH_WAYS, read_noise=4.0, picture=Texture(deviation=0.0), **light)
    silent = Scene(BOTH_WAYS, read_noise=0.0, picture=Texture(mean_level=0.0), **light)
    for scene in (grey, silent):
        assert np.isposinf(ceiling(scene))
        assert np.isposinf(ceiling(scene, max_half_exposure=np.inf))


def test_what_the_optics_cut_off_counts_nowhere():
    """Power above the cut-off is no part of the picture, whose contrast stays the same."""
    steps = (np.arange(256) + 0.5) / 512
    passed = (steps <= 0.125) / (steps**2 + 0.01**2)
    by_optics = ceiling(
        Scene(
            BOTH_WAYS,
            photon_rate=1e5,
            read_noise=4.0,
            limits=LIMITS,
            optics=Optics(cutoff_frequency=0.125),
        )
    )
    by_picture = ceiling(
        Scene(
            BOTH_WAYS,
            photon_rate=1e5,
            read_noise=4.0,
            limits=LIMITS,
            picture=Texture(power_spectrum=passed),
        )
    )
    assert float(by_optics) == pytest.approx(float(by_picture), abs=0.02)


def test_speeds_that_never_occur_or_repeat_change_nothing():
    """A weight of zero, and one speed listed twice."""
    light = {"photon_rate": 1e5, "read_noise": 4.0, "limits": LIMITS}
    plain = Scene([-300.0, 800.0], [0.4, 0.6], **light)
    same = Scene([800.0, -300.0, 5e4, 800.0], [0.5, 0.4, 0.0, 0.1], **light)
    assert float(ceiling(same)) == pytest.approx(float(ceiling(plain)), rel=1e-12)


def test_single_precision_has_the_same_ceiling():
    """It is computed in double precision, and returned in that of the speeds."""
    single = Scene(
        np.float32(BOTH_WAYS), np.float32(WEIGHTS), photon_rate=3e4, read_noise=9.0, limits=LIMITS
    )
    found = ceiling(single)
    assert found.dtype == np.float32
    assert float(found) == pytest.approx(float(ceiling(SCENES["dim"])), abs=1e-5)


def test_the_grids_are_those_of_an_evaluation():
    """From 256 frequencies to the most that are computed, each octave in two steps."""
    assert frequency_counts()[:4] == [256, 384, 512, 768]
    assert frequency_counts()[-1] == 1 << 17


@pytest.mark.parametrize("half", [0.0, -1.0, np.nan, -np.inf, True])
def test_an_exposure_that_is_none_is_refused(half):
    """By the argument's name."""
    with pytest.raises(ValueError, match=r"`ceiling\(max_half_exposure=...\)` must be above 0 s"):
        ceiling(SCENES["dim"], max_half_exposure=half)


def test_exposures_for_each_speed_are_refused():
    """There is one longest exposure."""
    with pytest.raises(ValueError, match=r"`ceiling\(max_half_exposure=...\)` must be a scalar"):
        ceiling(SCENES["dim"], max_half_exposure=np.ones(5))


@pytest.mark.parametrize("speeds", [[3.0], [5.0, 5.0], [0.0, 1.0, 3.0]])
def test_lists_that_stand_for_no_continuous_speeds_are_refused(speeds):
    """One speed, one that repeats, and uneven steps say nothing of what lies between."""
    scene = Scene(speeds, photon_rate=1e5, read_noise=2.0)
    needed = "must hold two or more speeds in equal steps where it is `continuous`; got"
    with pytest.raises(ValueError, match=rf"`ceiling\(scene=...\)` {needed}"):
        ceiling(scene, continuous=True)


def test_a_traced_scene_is_refused():
    """The eigenvalues are those of known numbers."""

    def traced(rate):
        return ceiling(Scene(BOTH_WAYS, photon_rate=rate, read_noise=2.0))

    needed = r"`ceiling\(scene=...\)` must hold concrete numbers; got ones that JAX traces"
    with pytest.raises(ValueError, match=needed):
        jax.jit(traced)(1e5)
