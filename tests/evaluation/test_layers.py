"""The expected error of objects before a background: its reference, its limits, its derivatives."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.plan_check import metrics_by

from mishutter import (
    ExpectedErrorLoss,
    HannShutter,
    KnownSpeedLoss,
    Limits,
    Occlusion,
    Optics,
    ParabolicMotion,
    RectShutter,
    Scene,
    SplineShutter,
    StillCamera,
    Texture,
    Tolerances,
    WorstSpeedLoss,
    ceiling,
    evaluate,
)
from mishutter.decoding.decoders.base import blur_model
from mishutter.decoding.decoders.linear import expected_squared_error
from mishutter.evaluation.errors import spectral_levels

# Sizes and shares of a search, which no argument asks for.
from mishutter.evaluation.layers import Background, Frequencies, _texture_weights
from mishutter.evaluation.losses import value_of
from mishutter.evaluation.needs import effective_speeds, sizes
from mishutter.evaluation.speed_knowledge import KNOWN_SPEED, UNKNOWN_SPEED
from mishutter.search.planning import plan

REFERENCE = 1.5e-4
"""Difference from the reference's values, dB: these have four decimals, and are known to 1e-4."""
SPEEDS = 4500 * (np.arange(9) + 0.5) / 9
LIMITS = Limits(max_stroke=45, max_half_exposure=0.02)
SWEPT = ParabolicMotion(acceleration=45 / 0.009**2, half_exposure=0.009)
SNAPSHOT = StillCamera(half_exposure=1.08e-3)


def scene_of(occlusion, speeds=SPEEDS, **others):
    numbers = {"photon_rate": 1e5, "read_noise": 8.0, "limits": LIMITS} | others
    return Scene(speeds, occlusion=occlusion, **numbers)


STILL = Occlusion(front_share=0.3, object_width=100.0)
LAYERS = {
    "still": scene_of(STILL),
    "narrow": scene_of(Occlusion(front_share=0.55, object_width=23.0)),
    "moving": scene_of(
        Occlusion(front_share=0.4, object_width=70.0, background="moving"), [-3100.0, 700.0, 2900.0]
    ),
    "levels": scene_of(Occlusion(front_share=0.3, object_width=60.0, level_difference=0.13)),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("motion", "shutter", "layers", "mean_level", "psnr"),
    [
        (SNAPSHOT, RectShutter(), STILL, 0.25, 27.1784),
        (SWEPT, HannShutter(), STILL, 0.25, 26.7466),
        (
            ParabolicMotion(acceleration=30 / 0.009**2, half_exposure=0.009),
            RectShutter(),
            Occlusion(front_share=0.3, object_width=100.0, level_difference=0.1),
            0.28,
            25.4146,
        ),
        (SWEPT, HannShutter(), Occlusion(front_share=0.3), 0.25, 27.3689),
    ],
    ids=["snapshot", "Hann", "levels apart", "no edges"],
)
def test_the_reference(motion, shutter, layers, mean_level, psnr):
    """Plain sums over time and over the frequencies of the matte give the same expected PSNR."""
    metrics = evaluate(scene_of(layers, picture=Texture(mean_level=mean_level)), motion, shutter)
    np.testing.assert_allclose(metrics.expected_psnr, psnr, rtol=0, atol=REFERENCE)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("motion", "shutter", "rate", "layers", "psnr"),
    [
        (
            StillCamera(half_exposure=1.3e-3),
            RectShutter(),
            3e5,
            Occlusion(front_share=0.6, object_width=70.0, background="moving"),
            25.57935,
        ),
        (
            ParabolicMotion(acceleration=41 / 0.008**2, half_exposure=0.008),
            HannShutter(),
            1e5,
            Occlusion(front_share=0.35, object_width=110.0),
            26.68716,
        ),
        (
            ParabolicMotion(acceleration=27 / 0.009**2, half_exposure=0.009),
            RectShutter(),
            2e5,
            Occlusion(front_share=0.55, object_width=35.0, background="moving"),
            22.54090,
        ),
    ],
    ids=["snapshot", "Hann", "open"],
)
def test_the_reference_of_random_rows(motion, shutter, rate, layers, psnr):
    """What the filter of plain sums leaves of them, which `benchmarks/occlusion.py` draws."""
    scene = Scene([-2900.0, 700.0, 3700.0], photon_rate=rate, read_noise=7.0, occlusion=layers)
    # `evaluate` takes its integrals over the matte by finitely many speeds.
    np.testing.assert_allclose(evaluate(scene, motion, shutter).expected_psnr, psnr, atol=4e-4)


@pytest.mark.slow
@pytest.mark.parametrize("motion", [SNAPSHOT, SWEPT], ids=["snapshot", "swept"])
def test_objects_that_cover_everything_move_as_a_whole(motion):
    """With a share of 1 the picture is the objects', with a share of 0 a background's at rest."""
    shutter = HannShutter()
    for share, speeds in ((1.0, SPEEDS), (0.0, np.array([0.0]))):
        layers = Occlusion(front_share=share, object_width=37.0)
        hidden = evaluate(scene_of(layers), motion, shutter).expected_psnr
        whole = evaluate(scene_of(None, speeds), motion, shutter).expected_psnr
        np.testing.assert_allclose(hidden, whole, rtol=0, atol=1e-5)


def test_objects_without_edges_are_a_prior_of_two_kinds_of_speeds():
    """Without edges the picture is one that moves as the objects or not at all, by their shares."""
    share, shutter = 0.37, HannShutter()
    hidden = evaluate(scene_of(Occlusion(front_share=share)), SWEPT, shutter).expected_psnr
    weights = np.append(np.full(SPEEDS.size, share / SPEEDS.size), 1 - share)
    both = scene_of(None, np.append(SPEEDS, 0.0), weights=weights)
    np.testing.assert_allclose(hidden, evaluate(both, SWEPT, shutter).expected_psnr, atol=1e-9)


def test_wide_objects_have_hardly_any_edges():
    """The wider the objects, the nearer the error is to that of objects without edges."""
    without = float(
        evaluate(scene_of(Occlusion(front_share=0.3)), SWEPT, HannShutter()).expected_psnr
    )
    widths = (30.0, 100.0, 1e3, 1e4)
    levels = [
        float(
            evaluate(
                scene_of(Occlusion(front_share=0.3, object_width=w)), SWEPT, HannShutter()
            ).expected_psnr
        )
        for w in widths
    ]
    distances = np.abs(np.array(levels) - without)
    assert np.all(np.diff(distances) < 0)
    np.testing.assert_allclose(levels[-1], 27.36155, rtol=0, atol=REFERENCE)


@pytest.mark.slow
def test_layers_of_one_speed_are_one_picture():
    """Where both layers move alike nothing is uncovered: the error is of the picture's spectrum."""
    layers = Occlusion(front_share=0.4, object_width=50.0, background="moving")
    alone = np.array([900.0])
    shares = np.array([0.2, 0.8])
    one = evaluate(scene_of(layers, alone), SWEPT, HannShutter())
    twice = evaluate(
        scene_of(layers, np.array([900.0, 900.0]), weights=shares), SWEPT, HannShutter()
    )
    assert float(one.expected_psnr) == pytest.approx(float(one.known_speed_psnr), abs=1e-9)
    np.testing.assert_allclose(one.expected_psnr, twice.expected_psnr, rtol=0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", LAYERS)
def test_a_short_snapshot_sees_no_edges(name):
    """Over a short exposure nothing moves: little but noise is lost, as of one speed."""
    scene, short = LAYERS[name], StillCamera(half_exposure=2e-5)
    metrics = evaluate(scene, short, RectShutter())
    np.testing.assert_allclose(metrics.expected_psnr, metrics.known_speed_psnr, rtol=0, atol=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("name", LAYERS)
def test_the_errors_at_each_speed_have_the_expected_mean(name):
    """By the weights of the objects, told and not; the worst of them is what the metrics say."""
    layers = LAYERS[name]
    weights = np.arange(1.0, layers.speeds.size + 1)
    scene = eqx.tree_at(lambda s: s.weights, layers, jnp.asarray(weights / weights.sum()))
    metrics, levels = (f(scene, SWEPT, HannShutter()) for f in (evaluate, spectral_levels))
    weights = np.asarray(scene.weights)[np.argsort(scene.speeds)]
    for decoder in (UNKNOWN_SPEED, KNOWN_SPEED):
        errors = 10 ** (-decoder.of(levels).psnr / 10)
        mean = -10 * np.log10(weights @ errors)
        np.testing.assert_allclose(mean, decoder.psnr(metrics), rtol=1e-9)
        worst = -10 * np.log10(np.max(errors))
        np.testing.assert_allclose(worst, decoder.worst_psnr(metrics), rtol=1e-9)
    assert float(metrics.known_speed_psnr) > float(metrics.expected_psnr)


@pytest.mark.slow
@pytest.mark.parametrize("name", LAYERS)
@pytest.mark.parametrize("motion", [SNAPSHOT, SWEPT], ids=["snapshot", "swept"])
def test_no_camera_exceeds_the_ceiling(name, motion):
    """The ceiling of two layers bounds a decoder that is told the speed, too."""
    metrics = evaluate(LAYERS[name], motion, HannShutter())
    assert float(metrics.known_speed_psnr) < float(ceiling(LAYERS[name]))


def test_layers_of_few_outlines_have_the_ceiling_of_one_picture():
    """Both move at the same speeds, and what beats between far outlines at those of either."""
    wide = Occlusion(front_share=0.5, object_width=3e4, background="moving")
    one, two = (
        Scene([200.0, 900.0, 1700.0], photon_rate=1e5, read_noise=5.0, occlusion=each)
        for each in (None, wide)
    )
    level = float(ceiling(one, max_half_exposure=4e-3))
    assert level - 0.02 < float(ceiling(two, max_half_exposure=4e-3)) < level


def test_a_pan_asks_for_as_many_effective_speeds():
    """As the layers need that move as fast against one another as seen from a sensor at rest."""
    for occlusion in (STILL, Occlusion(front_share=0.4, object_width=70.0, background="moving")):
        scene, half = scene_of(occlusion, [-3100.0, 700.0, 2900.0]), 0.009
        counts = [
            sizes(scene, ParabolicMotion(acceleration=3e5, half_exposure=half, velocity=velocity))
            for velocity in (0.0, -2900.0, 1700.0)
        ]
        assert {plan.num_effective_speeds for plan in counts} == {effective_speeds(scene, half)}
        assert effective_speeds(scene, half) > effective_speeds(scene, half / 8)
        slower = scene_of(occlusion, [-310.0, 70.0, 290.0])
        assert effective_speeds(slower, half) < effective_speeds(scene, half)
        assert effective_speeds(slower, 10 * half) == effective_speeds(scene, half)
    # A background at rest is as far from objects that all move one way as they are fast.
    one_way = [scene_of(each, [2400.0, 2900.0]) for each in (STILL, occlusion)]
    assert effective_speeds(one_way[0], 10 * half) > effective_speeds(one_way[1], 10 * half)


def test_a_picture_of_layers_has_no_power_above_the_cutoff():
    """Below it edges mix the texture with the matte, of which soft optics pass as little."""
    cutoff, grid = 0.21, Frequencies.of_grid(256)
    front, width, frequency = 0.55, 23.0, (np.arange(256) + 0.5) / 512
    occlusion = Occlusion(front_share=front, object_width=width)
    scene = scene_of(occlusion, [-900.0, 700.0], optics=Optics(cutoff_frequency=cutoff))
    shares = Background.of(scene).behind(scene, grid).occlusion.shares
    power = np.asarray(shares.power)
    assert np.all(power[frequency > cutoff] == 0)
    step = 1e-5
    place = np.arange(-cutoff, cutoff, step) + step / 2
    texture = 1 / (place**2 + 0.01**2)
    known = 1 / (frequency**2 + 0.01**2) * (frequency <= cutoff)
    scale = 0.2**2 / np.mean(known)
    length = width * (1 - front)
    for index in (3, 40, 90):
        apart = frequency[index] - place
        matte = 2 * front * (1 - front) * length / (1 + (2 * np.pi * apart * length) ** 2)
        mixed = scale * np.sum(texture * matte) * step
        expected = (front**2 + (1 - front) ** 2) * scale * known[index] + 2 * mixed
        assert power[index] == pytest.approx(expected, rel=5e-3)


@pytest.mark.parametrize("name", ["still", "moving"])
def test_the_parts_of_layers_are_the_whole_picture(name):
    """Textures that move rigidly and the beat, of all objects and of each; none at equal speeds."""
    own = LAYERS[name]
    scene = Background.of(own).behind(own)
    shares = scene.occlusion.shares
    for of_each in (False, True):
        parts = _texture_weights(scene, 40, np.dtype(np.float64), of_each=of_each)
        textures, beat = map(np.asarray, parts)
        assert np.min(textures) >= 0
        np.testing.assert_allclose(np.sum(textures, axis=1) + beat, 1, rtol=1e-9)
    at_knots = np.asarray(shares.same)[np.array(shares.knots)]
    behind, speeds = np.asarray(shares.background_speeds), np.asarray(scene.speeds)
    differ = behind[:, None] != speeds
    wanted = differ[..., None] * at_knots
    np.testing.assert_allclose(np.sum(np.asarray(shares.beat), axis=2), wanted, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", LAYERS)
def test_folded_speeds_change_nothing(name):
    """Mirrored speeds of a symmetric shutter are computed once; without a plan, each."""
    planned = evaluate(LAYERS[name], SWEPT, HannShutter()).expected_psnr
    every = metrics_by(None, LAYERS[name], SWEPT, HannShutter())["expected_psnr"]
    np.testing.assert_allclose(planned, every, rtol=0, atol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "cutoff", "nearness"),
    [*((name, 0.5, 0.12) for name in LAYERS), ("narrow", 0.12, 0.3), ("moving", 0.12, 0.3)],
)
def test_a_search_knows_the_error_by_few_frequencies(name, cutoff, nearness):
    """A search computes the beat at few speeds and frequencies, and knows the error to 0.1 dB.

    Behind soft optics, of fewer frequencies still, to 0.3 dB.
    """
    scene = eqx.tree_at(lambda s: s.optics.cutoff_frequency, LAYERS[name], jnp.asarray(cutoff))
    for motion in (SNAPSHOT, SWEPT):
        loss, shutter = ExpectedErrorLoss(), HannShutter()
        start = SplineShutter.fit(shutter, 8)
        few = plan(scene, motion, start, loss=loss, free="shutter").sizes
        assert (few.num_kept is None) == (cutoff == 0.5)
        values = [float(value_of(loss, scene, motion, shutter, each)) for each in (few, None)]
        np.testing.assert_allclose(20 * np.log10(values[0] / values[1]), 0, atol=nearness)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["still", "moving"])
def test_the_decoder_leaves_what_is_expected(name):
    """The ensemble filter of a scene of two layers is the filter whose error is expected."""
    expected = evaluate(LAYERS[name], SWEPT, HannShutter()).expected_psnr
    error = expected_squared_error(blur_model(LAYERS[name], SWEPT, HannShutter()))
    np.testing.assert_allclose(-10 * np.log10(error), expected, rtol=0, atol=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("name", LAYERS)
def test_a_pan_is_a_change_of_all_speeds(name):
    """A sensor that pans meets the objects and a still background less its velocity."""
    scene, velocity = LAYERS[name], 600.0
    panned = ParabolicMotion(acceleration=4e5, half_exposure=0.009, velocity=velocity)
    shifted = eqx.tree_at(lambda s: s.speeds, scene, scene.speeds - velocity)
    layers = scene.occlusion.in_sensor_frame(jnp.asarray(velocity))
    shifted = eqx.tree_at(lambda s: s.occlusion, shifted, layers)
    still = ParabolicMotion(acceleration=4e5, half_exposure=0.009)
    np.testing.assert_allclose(
        evaluate(scene, panned, RectShutter()).expected_psnr,
        evaluate(shifted, still, RectShutter()).expected_psnr,
        rtol=0,
        atol=1e-4,
    )


@pytest.mark.parametrize("loss", [ExpectedErrorLoss(), KnownSpeedLoss(), WorstSpeedLoss()])
def test_losses_are_the_metrics(loss):
    """The loss over the picture's deviation is the PSNR that `evaluate` measures."""
    scene = LAYERS["narrow"]
    metrics = evaluate(scene, SWEPT, HannShutter())
    level = -20 * np.log10(
        float(loss(scene, SWEPT, HannShutter())) * float(scene.picture.deviation)
    )
    of = {
        ExpectedErrorLoss: "expected",
        KnownSpeedLoss: "known_speed",
        WorstSpeedLoss: "worst_speed",
    }
    np.testing.assert_allclose(level, getattr(metrics, f"{of[type(loss)]}_psnr"), rtol=0, atol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["still", "moving"])
def test_derivatives_follow_the_loss(name):
    """By motion, profile, light, speeds and layers they agree with central differences."""
    scene, loss = LAYERS[name], ExpectedErrorLoss()
    profile = SplineShutter.fit(HannShutter(), num_coefficients=6)

    def value(numbers):
        a, T, v, light, speed, share, width, edge = numbers
        layers = eqx.tree_at(
            lambda o: (o.front_share, o.object_width), scene.occlusion, (share, width)
        )
        places = lambda s: (s.photon_rate, s.speeds, s.occlusion)  # noqa: E731
        own = eqx.tree_at(places, scene, (light * 1e5, scene.speeds * speed, layers))
        box = profile.at(jnp.linspace(0.2, 0.9, 6).at[2].set(edge))
        return loss(
            own,
            ParabolicMotion(acceleration=a * 5e5, half_exposure=T * 0.008, velocity=v * 300),
            box,
        )

    numbers = jnp.array([1.07, 0.93, 1.11, 1.3, 0.97, 0.41, 63.0, 0.6])
    slope, value = jax.jit(jax.grad(value))(numbers), jax.jit(value)
    steps = 1e-4 * numbers
    differences = [
        (value(numbers.at[i].add(h)) - value(numbers.at[i].add(-h))) / (2 * h)
        for i, h in enumerate(steps)
    ]
    np.testing.assert_allclose(slope, differences, rtol=2e-4, atol=1e-7)


@pytest.mark.slow
def test_the_hessian_is_the_slope_of_the_slope():
    """Forward over reverse gives second derivatives by the profile and the motion."""
    scene, profile = LAYERS["still"], SplineShutter.fit(HannShutter(), num_coefficients=4)

    def value(numbers):
        motion = ParabolicMotion(acceleration=numbers[0] * 5e5, half_exposure=0.008)
        box = profile.at(jnp.linspace(0.3, 0.8, 4).at[1].set(numbers[1]))
        return ExpectedErrorLoss()(scene, motion, box)

    numbers = jnp.array([1.05, 0.55])
    hessian = jax.jit(jax.hessian(value))(numbers)
    slope = jax.jit(jax.grad(value))
    h = 1e-4
    differences = [
        (slope(numbers.at[i].add(h)) - slope(numbers.at[i].add(-h))) / (2 * h) for i in range(2)
    ]
    np.testing.assert_allclose(hessian, np.array(differences), rtol=1e-3, atol=1e-6)


@pytest.mark.slow
def test_single_precision_is_near():
    """In float32 the expected PSNR is that of float64 to 1e-3 dB."""
    scene = LAYERS["still"]
    single = jax.tree.map(lambda x: x.astype(np.float32) if eqx.is_array(x) else x, scene)
    motion = jax.tree.map(lambda x: jnp.asarray(x, np.float32), SWEPT)
    level = evaluate(single, motion, HannShutter()).expected_psnr
    assert level.dtype == np.float32
    expected = evaluate(scene, SWEPT, HannShutter()).expected_psnr
    np.testing.assert_allclose(level, expected, rtol=0, atol=1e-3)


@pytest.mark.slow
def test_errors_of_no_size_cost_nothing():
    """Within tolerances each error is another camera; of errors near 0 all are the same."""
    tiny = scene_of(STILL, tolerances=Tolerances(acceleration=1e-9, delay=1e-12, speed=1e-6))
    metrics = evaluate(tiny, SWEPT, HannShutter())
    np.testing.assert_allclose(metrics.toleranced_psnr, metrics.expected_psnr, rtol=0, atol=2e-3)
    wide = scene_of(STILL, tolerances=Tolerances(acceleration=0.05))
    assert float(evaluate(wide, SWEPT, HannShutter()).toleranced_psnr) < float(
        metrics.expected_psnr
    )


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        ({"front_share": 1.2}, r"`Occlusion\(front_share=...\)` must be from 0 to 1; got 1.2"),
        ({"front_share": -0.1}, r"must be from 0 to 1; got -0.1"),
        ({"front_share": 0.3, "object_width": 0.0}, r"must be above 0 px; got 0"),
        ({"front_share": 0.3, "level_difference": np.inf}, r"must be finite; got inf"),
    ],
)
def test_what_layers_must_be(arguments, line):
    """Each number that is out of its range is named."""
    with pytest.raises(ValueError, match=line):
        Occlusion(**arguments)


def test_a_speed_that_is_found_is_a_whole_picture_s():
    """Before a background one speed is no picture's, so that no decoder finds it."""
    with pytest.raises(ValueError, match="no single speed describes a picture with a background"):
        scene_of(STILL, decoder_speed="found")
