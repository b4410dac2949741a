"""Pictures computed once, and only where they are seen: the light of everything everywhere."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.frame_reference import integrate_cells

from mishutter import (
    HannShutter,
    Layer,
    Layers,
    ParabolicMotion,
    Picture,
    RichardsonLucyDecoder,
    Scene,
    StillCamera,
    WienerDecoder,
    blur_model,
    capture_and_restore,
    deconvolve,
    restore_photograph,
    simulate_capture,
)
from mishutter.blur.intervals import exposure_cells
from mishutter.camera.occlusion import expose_layers, seen_layers

HALF = 0.009
MOVING = ParabolicMotion(acceleration=13.0 / HALF**2, half_exposure=HALF)
MOTIONS = {"moving": MOVING, "at_rest": StillCamera(half_exposure=HALF)}
SCENE = Scene([-700.0, 0.0, 700.0, 700.0, 300.0], photon_rate=3e5, read_noise=4.0)
AGREES = 1e-12
"""Of white, in double precision: transforms of other lengths round otherwise."""


def picture(rows, columns, *, channels=3, matte=None, seed=0):
    light = np.random.default_rng(seed + rows + columns).uniform(size=(rows, columns, channels))
    return Picture(light, matte=matte)


def disc(rows, columns):
    y, x = np.mgrid[-1 : 1 : rows * 1j, -1 : 1 : columns * 1j]
    return np.clip(1.7 - 1.7 * np.hypot(x, y), 0, 1)


def random_layers(seed):
    """A background, and objects some of which are off the sensor, empty or covered."""
    random = np.random.default_rng(seed)
    layers = [Layer(picture(23, 61, seed=seed), speed=float(random.choice([0.0, 210.0])))]
    for _ in range(random.integers(1, 4)):
        rows, columns = random.integers(3, 15, 2).tolist()
        matte = (None, disc(rows, columns), np.zeros((rows, columns)))[random.integers(3)]
        layers.append(
            Layer(
                picture(rows, columns, channels=int(random.choice([1, 3])), matte=matte),
                speed=float(random.uniform(-900, 900)),
                left=int(random.integers(-25, 80)),
                top=int(random.integers(-18, 30)),
            )
        )
    return Layers(tuple(layers), border=("reflect", "edge", "zero")[seed % 3])


@pytest.mark.parametrize("name", MOTIONS)
@pytest.mark.parametrize(
    "seeds", [range(8), pytest.param(range(8, 108), marks=pytest.mark.slow)], ids=["few", "many"]
)
def test_occlusion_is_the_sum_of_all_images(name, seeds):
    """Random layered scenes have the light of the whole sensor's image in every cell."""
    for seed in seeds:
        layers = random_layers(seed)
        found = expose_layers(layers, MOTIONS[name], HannShutter())
        whole = integrate_cells(layers, MOTIONS[name], HannShutter())
        assert np.max(np.abs(whole - found)) < AGREES


@pytest.mark.parametrize(
    "gone",
    [
        Layer(picture(5, 6, matte=np.zeros((5, 6))), speed=200.0, left=9, top=4),
        Layer(picture(5, 6), speed=200.0, left=9, top=23),
        Layer(picture(5, 6), speed=200.0, left=9, top=-5),
        Layer(picture(5, 6), speed=200.0, left=-90, top=4),
        Layer(picture(5, 6), speed=-350.0, left=21, top=9),
    ],
    ids=["empty", "below", "above", "beside", "covered"],
)
def test_layers_that_nobody_sees_are_left_out(gone):
    """A layer that is clear, off the sensor or behind one that moves along is not rendered."""
    front = Layer(picture(9, 11), speed=-350.0, left=20, top=7)
    layers = Layers((Layer(picture(23, 61)), gone, front))
    assert seen_layers(layers, MOVING).layers == (layers.layers[0], front)
    whole = integrate_cells(layers, MOVING, HannShutter())
    assert np.max(np.abs(whole - expose_layers(layers, MOVING, HannShutter()))) < AGREES


def test_a_layer_that_is_seen_through_a_hole_stays():
    """Behind a matte that is not opaque, or at another speed, a layer is rendered."""
    behind = Layer(picture(5, 6), speed=-350.0, left=21, top=9)
    hole = Layer(picture(9, 11, matte=disc(9, 11)), speed=-350.0, left=20, top=7)
    faster = Layer(picture(9, 11), speed=-360.0, left=20, top=7)
    for front in (hole, faster):
        layers = Layers((Layer(picture(23, 61)), behind, front))
        assert len(seen_layers(layers, MOVING).layers) == 3


@pytest.mark.parametrize(("left", "top"), [(9, 9), (21, -2), (26, 9), (21, 12)])
def test_a_layer_beside_one_that_moves_along_stays(left, top):
    """To its left, above it, or beyond its far corner by a pixel or more."""
    beside = Layer(picture(5, 6), speed=-350.0, left=left, top=top)
    front = Layer(picture(9, 11), speed=-350.0, left=20, top=7)
    layers = Layers((Layer(picture(23, 61)), beside, front))
    assert len(seen_layers(layers, MOVING).layers) == 3


def test_cells_that_share_what_is_hidden_take_the_transforms():
    """Where a sum over cells takes longer the light is that of Fourier transforms."""
    wide = Layer(picture(23, 400, matte=disc(23, 400)), speed=40.0, left=-100)
    layers = Layers((Layer(picture(23, 300), speed=3.0), wide))
    num_cells = len(exposure_cells(HannShutter(), MOVING, np.array([3.0, 40.0])).light)
    assert num_cells > 20
    whole = integrate_cells(layers, MOVING, HannShutter())
    assert np.max(np.abs(whole - expose_layers(layers, MOVING, HannShutter()))) < AGREES


def grey(rows, columns):
    return np.repeat(picture(rows, columns, channels=1).light, 3, axis=2)


@pytest.mark.parametrize("light", [grey(11, 90), picture(11, 90).light], ids=["grey", "colours"])
@pytest.mark.parametrize("key", [None, 7])
def test_equal_colours_are_done_once(light, key):
    """A capture and its restoration are those of every colour on its own."""
    key = None if key is None else jax.random.key(key)
    results = []
    for plan in ({}, {"plan": None}):
        g = simulate_capture(light, SCENE, MOVING, HannShutter(), speed=500.0, key=key, **plan)
        f = deconvolve(g, SCENE, MOVING, HannShutter(), **plan)
        results.append((g, f))
    assert jax.tree.all(jax.tree.map(lambda x, y: bool(jnp.max(jnp.abs(x - y)) < AGREES), *results))
    if key is None and np.all(light == light[..., :1]):
        assert all(bool(jnp.all(x == x[..., :1])) for x in results[0])


@pytest.mark.parametrize("decoder", [WienerDecoder(), RichardsonLucyDecoder(num_iterations=4)])
def test_a_layered_scene_is_restored_alike(decoder):
    """Capture and restoration of layers agree with a computation of everything."""
    layers, key = random_layers(4), jax.random.key(3)
    arguments = (layers, SCENE, MOVING, HannShutter())
    planned = capture_and_restore(*arguments, decoder=decoder, key=key)
    full = capture_and_restore(*arguments, decoder=decoder, key=key, plan=None)
    assert np.allclose(planned.captured, full.captured, rtol=0, atol=1e-10)
    assert np.allclose(planned.restored, full.restored, rtol=0, atol=1e-9)


def test_a_decoder_knows_each_speed_once():
    """Merged and mirrored speeds leave the restored picture as it is."""
    known = blur_model(SCENE, MOVING, HannShutter())
    assert known.kernels.shape[0] == 3
    assert blur_model(SCENE, MOVING, HannShutter(), plan=None).kernels.shape[0] == 5


def test_a_photograph_is_blurred_once_for_all_its_captures():
    """The noise of each seed falls on the same blur: nothing changes."""
    arguments = (picture(9, 260, channels=1), SCENE, MOVING, HannShutter())
    options = {"speeds": [0.0, 400.0], "num_seeds": 2}
    planned = restore_photograph(*arguments, **options)
    full = restore_photograph(*arguments, **options, plan=None)
    assert np.allclose(planned.linear_psnr, full.linear_psnr, rtol=1e-12)
    assert np.allclose(planned.captured, full.captured, rtol=0, atol=AGREES)
