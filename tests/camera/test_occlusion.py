"""Pictures computed once, and only where they are seen: the light of everything everywhere.

Layers of white noise with hard edges are the worst that there can be: their waves reach far. Light
ends a margin beyond the blur, and the error falls with the square of that margin.
"""

import jax.numpy as jnp
import numpy as np
import pytest
from support import time_sampling
from support.time_sampling import captured_layers

from mishutter import (
    FreeMotion,
    HannShutter,
    Layer,
    Layers,
    Optics,
    ParabolicMotion,
    Picture,
    RectShutter,
    Scene,
    StillCamera,
    deconvolve,
    simulate_capture,
)

# `widen` changes the distance at which light ends, for which captures have no argument.
from mishutter.camera import occlusion, rows
from mishutter.decoding.decoders.base import blur_model

HALF = 0.009
MOVING = ParabolicMotion(acceleration=13.0 / HALF**2, half_exposure=HALF)
MOTIONS = {"moving": MOVING, "at_rest": StillCamera(half_exposure=HALF)}
SCENE = Scene([-700.0, 0.0, 700.0, 700.0, 300.0], photon_rate=3e5, read_noise=4.0)
AGREES = 1e-12
"""Of white, in double precision: transforms of other lengths round otherwise."""
WAVES = 2e-3
"""Of white: the light of white noise that ends at 64 px beyond the blur."""
WIDE, WAVES_OF_WIDE = 512, 3e-5
"""Eight times as far there is a sixtieth of it."""


def picture(rows, columns, *, channels=3, matte=None, seed=0):
    light = np.random.default_rng(seed + rows + columns).uniform(size=(rows, columns, channels))
    return Picture(light, matte=matte)


def disc(rows, columns):
    y, x = np.mgrid[-1 : 1 : rows * 1j, -1 : 1 : columns * 1j]
    return np.clip(1.7 - 1.7 * np.hypot(x, y), 0, 1)


def random_layers(seed):
    """A background, and objects some of which are off the sensor, empty or covered."""
    random = np.random.default_rng(seed)
    layers = [Layer(picture(7, 61, seed=seed), speed=float(random.choice([0.0, 210.0])))]
    for _ in range(random.integers(1, 4)):
        rows, columns = random.integers(3, 15, 2).tolist()
        matte = (None, disc(rows, columns), np.zeros((rows, columns)))[random.integers(3)]
        layers.append(
            Layer(
                picture(rows, columns, channels=int(random.choice([1, 3])), matte=matte),
                speed=float(random.uniform(-900, 900)),
                left=int(random.integers(-25, 80)),
                top=int(random.integers(-9, 9)),
            )
        )
    return Layers(tuple(layers), border=("reflect", "edge", "zero", "wrap")[seed % 4])


def deep_layers(depth):
    """Layers that lie over one another, each of noise through a matte of opaque and clear."""
    random = np.random.default_rng(depth)
    layers = [Layer(picture(2, 61, channels=1), speed=210.0)]
    for index in range(depth):
        columns = int(random.integers(12, 30))
        matte = np.round(random.random((2, columns)))
        thing = picture(2, columns, channels=1, matte=matte, seed=index)
        place = {"speed": float(random.uniform(-1800, 1800)), "left": int(random.integers(5, 25))}
        layers.append(Layer(thing, **place))
    return Layers(tuple(layers), border="zero")


def error(layers, motion):
    """Largest difference of a capture from its composites at many instants; white = 1."""
    found = simulate_capture(layers, SCENE, motion, HannShutter())
    wanted = captured_layers(layers, motion, HannShutter(), count=160)
    return float(np.max(np.abs(found - wanted)))


def widen(monkeypatch):
    """Let light end farther off, here and in the brute force.

    Captures have no argument for this distance, and only a longer one tells a composite that is too
    coarse from light that ends.
    """
    for module in (occlusion, rows):
        monkeypatch.setattr(module, "MARGIN", WIDE)
    monkeypatch.setattr("support.time_sampling.BEYOND", WIDE)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "seeds"), [("moving", range(10)), ("at_rest", range(10, 15))])
def test_occlusion_is_that_of_composites_at_each_instant(name, seeds):
    """Random layered scenes of noise: on, partly on and beside the sensor, clear and opaque."""
    for seed in seeds:
        assert error(random_layers(seed), MOTIONS[name]) < WAVES


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "depth"), [("moving", 1), ("moving", 2), ("moving", 3), ("moving", 5), ("at_rest", 3)]
)
def test_layers_may_lie_as_deep_as_they_like(name, depth, monkeypatch):
    """A composite is as fine as all its mattes together, and none of it looks coarser."""
    layers = deep_layers(depth)
    assert error(layers, MOTIONS[name]) < WAVES
    widen(monkeypatch)
    assert error(layers, MOTIONS[name]) < WAVES_OF_WIDE


@pytest.mark.parametrize(
    "gone",
    [
        Layer(picture(5, 6, matte=np.zeros((5, 6))), speed=200.0, left=9, top=4),
        Layer(picture(5, 6), speed=200.0, left=9, top=13),
        Layer(picture(5, 6), speed=200.0, left=9, top=-5),
        Layer(picture(5, 6), speed=200.0, left=-90, top=4),
        Layer(picture(5, 6), speed=200.0, left=128, top=4),
    ],
    ids=["empty", "below", "above", "left", "right"],
)
def test_layers_that_nobody_sees_are_left_out(gone):
    """A layer that is clear or off the sensor is not rendered, and leaves no light."""
    front = Layer(picture(9, 11), speed=-350.0, left=20, top=7)
    layers = Layers((Layer(picture(13, 61)), gone, front))
    without = Layers((layers.layers[0], front))
    captures = [simulate_capture(each, SCENE, MOVING, HannShutter()) for each in (layers, without)]
    assert np.array_equal(*captures)
    assert error(layers, MOVING) < WAVES


@pytest.mark.parametrize("left", [-9, 63])
def test_a_layer_just_beside_the_sensor_sends_waves_onto_it(left):
    """A hard edge of noise rings as far as its light is computed."""
    beside = Layer(picture(5, 6), speed=90.0, left=left, top=1)
    still = StillCamera(half_exposure=HALF)
    assert error(Layers((Layer(picture(7, 61)), beside)), still) < WAVES


@pytest.mark.parametrize("left", [-140, pytest.param(130, marks=pytest.mark.slow)])
def test_a_layer_that_crosses_the_sensor_comes_from_far_beyond_it(left):
    """By more than the margin from its place at mid-exposure, behind one that hides it there."""
    object_ = Layer(picture(3, 60), speed=-np.sign(left) * 150.0 / HALF, left=left, top=1)
    back, front = Layer(picture(4, 61)), Layer(picture(4, 9), left=30)
    layers = Layers((back, object_, front))
    found, without = (
        simulate_capture(each, SCENE, MOVING, HannShutter())
        for each in (layers, Layers((back, front)))
    )
    wanted = captured_layers(layers, MOVING, HannShutter(), count=960)
    assert np.max(np.abs(found - wanted)) < WAVES
    assert np.max(np.abs(found - without)) > 5 * WAVES


@pytest.mark.slow
@pytest.mark.parametrize("bend", [-1, 1])
def test_a_free_path_brings_a_layer_in_from_the_side_to_which_it_bends(bend):
    """By more than the margin, whichever side that is."""
    accelerations = bend * np.array([90.0, 150.0, 110.0, 130.0]) / HALF**2
    path = FreeMotion(accelerations=accelerations, half_exposure=HALF)
    beside = Layer(picture(3, 17), left=61 + 72 if bend < 0 else -17 - 72, top=1)
    layers = Layers((Layer(picture(4, 61)), beside))
    found = simulate_capture(layers, SCENE, path, RectShutter())
    wanted = captured_layers(layers, path, RectShutter(), count=960)
    assert np.max(np.abs(found - wanted)) < WAVES


def test_a_path_that_bends_to_both_sides_brings_a_layer_in_from_either():
    """Its lowest and its highest position count, not where it ends."""
    accelerations = np.array([-1800.0, 400.0, 410.0, -1790.0]) / HALF**2
    path = FreeMotion(accelerations=accelerations, half_exposure=HALF)
    layers = [Layer(picture(3, 17), left=left, top=1) for left in (61 + 70, -17 - 70)]
    seen = occlusion.visible_layers(Layers((Layer(picture(4, 61)), *layers)), path)
    assert len(seen.layers) == 3


def test_the_lens_cuts_off_detail_of_the_composite():
    """Of layers and what they hide alike: nothing finer than its cutoff is recorded."""
    front = Layer(picture(5, 17, matte=disc(5, 17)), speed=-350.0, left=22, top=1)
    layers = Layers((Layer(picture(7, 96), speed=120.0), front), border="wrap")
    soft = Scene([0.0], photon_rate=3e5, read_noise=4.0, optics=Optics(cutoff_frequency=0.21))
    sharp, found = (
        np.asarray(simulate_capture(layers, scene, MOVING, HannShutter()))
        for scene in (SCENE, soft)
    )
    passed = time_sampling.through_optics(np.moveaxis(sharp, 1, 2), 0.21)
    assert np.max(np.abs(np.moveaxis(found, 1, 2) - passed)) < 2 * WAVES
    assert np.max(np.abs(found - sharp)) > 0.05


def test_a_layer_behind_one_that_moves_along_shows_at_its_edges():
    """As it does behind one that is a little faster: nothing jumps where speeds are equal."""
    behind, cover = picture(9, 11, seed=3), Layer(picture(9, 11), speed=-350.0, left=20, top=2)
    for speed in (-350.0, -350.001):
        layers = Layers((Layer(picture(13, 61)), Layer(behind, speed, left=20, top=2), cover))
        assert error(layers, MOVING) < WAVES


def test_a_layer_wider_than_the_sensor():
    """Hides it through a soft matte, which ends beyond the sensor on either side."""
    wide = Layer(picture(3, 150, matte=disc(3, 150)), speed=40.0, left=-40)
    layers = Layers((Layer(picture(3, 61), speed=3.0), wide))
    assert error(layers, MOVING) < WAVES


def test_what_a_small_thing_hides_is_hidden_once():
    """On a sensor far wider than it, the background away from it is as if nothing were there."""
    light = np.full((30, 700, 1), 0.8)
    thing = Layer(Picture(np.full((20, 24, 1), 0.1)), 90.0, left=500, top=5)
    both = Layers((Layer(Picture(light)), thing))
    still = StillCamera(half_exposure=0.005)
    seen = np.asarray(simulate_capture(both, SCENE, still, RectShutter()))[..., 0]
    away = np.abs(np.arange(700) - 512) > 60
    np.testing.assert_allclose(seen[:, away], 0.8, atol=1e-3)
    assert np.min(seen[:, ~away]) < 0.15


def grey(rows, columns):
    return np.repeat(picture(rows, columns, channels=1).light, 3, axis=2)


@pytest.mark.parametrize("light", [grey(11, 90), picture(11, 90).light], ids=["grey", "colours"])
def test_equal_colours_are_done_once(light):
    """A capture and its restoration are those of every colour on its own."""
    given = SCENE, MOVING, HannShutter()

    def results(colours):
        g = simulate_capture(colours, *given, speed=500.0)
        return g, deconvolve(g, *given)

    # A last row of another light keeps the colours apart, and shares no light with the others.
    apart = np.concatenate([light, light[-1:] * np.array([1.0, 0.5, 0.25])])
    for once, each in zip(results(light), results(apart), strict=True):
        assert float(jnp.max(jnp.abs(once - each[:-1]))) < AGREES
        if np.all(light == light[..., :1]):
            assert bool(jnp.all(once == once[..., :1]))


def test_a_decoder_knows_each_speed_once():
    """Merged and mirrored speeds leave the restored picture as it is."""
    known = blur_model(SCENE, MOVING, HannShutter())
    assert known.speeds.size == 3
    assert SCENE.speeds.size == 5
