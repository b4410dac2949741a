"""Decoders that know how speeds differ, and one that knows how rows go together.

Total variation is pinned to the objective in its docstring, which a general minimiser is
given here, and both decoders to how they stand to the best filter on a photograph.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.cameras import camera, scene

import mishutter as ms
from mishutter.decoding.decoders.base import blur_model

# Filters and operators of a decoder, checked against their formulas; it returns only a picture.
from mishutter.pictures.images import shipped_picture


def portrait(rows=64):
    return shipped_picture("astronaut.png").luminance[120 : 120 + rows, :400].astype(np.float64)


def dim():
    """Speeds that differ much, in little light, for pictures like the portrait."""
    return scene(picture=ms.Texture.of_photograph(ms.Picture(portrait()[..., None])))


def model_of():
    return blur_model(dim(), camera(), ms.HannShutter())


def captured_at(speed):
    options = {"speed": speed, "key": jax.random.key(6)}
    return ms.simulate_capture(portrait(), dim(), camera(), ms.HannShutter(), **options)


@pytest.mark.slow
@pytest.mark.parametrize("speed", [0.0, 1000.0, 2000.0])
def test_rows_that_go_together_tell_more(speed):
    """A prior in two dimensions gains over the best filter at each speed, and rows are needed."""
    model, light = model_of(), portrait()
    captured = captured_at(speed)
    inner = np.s_[:, 60:-60]

    def level(decoder, planes):
        found = np.asarray(decoder.restore(planes, model)).reshape(light.shape)
        return ms.psnr(light[inner], found[inner])

    together = level(ms.TotalVariationDecoder(), captured)
    assert together > level(ms.EnsembleDecoder(), captured) + 1
    assert together > level(ms.TotalVariationDecoder(), captured[:, None]) + 0.5


@pytest.mark.slow
@pytest.mark.parametrize("rows", [1, 2, 5])
def test_total_variation_of_few_rows(rows):
    """As many as there are, and in single precision as in double."""
    captured = jnp.asarray(captured_at(400.0)[:rows], jnp.float32)
    restore = ms.TotalVariationDecoder().restore
    found = restore(captured, model_of())
    assert found.shape == captured.shape
    assert found.dtype == jnp.float32
    exact = restore(captured.astype(jnp.float64), model_of())
    np.testing.assert_allclose(found, exact, atol=1e-4)


def test_total_variation_without_detail():
    """A picture that is known to have none comes back even."""
    model = replace(model_of(), power=np.zeros(256))
    level = 0.2 * model.efficiency
    captured = level + 0.01 * np.random.default_rng(3).standard_normal((5, 90))
    found = np.asarray(ms.TotalVariationDecoder().restore(jnp.asarray(captured), model))
    np.testing.assert_allclose(found, np.mean(captured) / model.efficiency, atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("decoder", "nearer"),
    [(ms.TotalVariationDecoder(), 10), (ms.RichardsonLucyDecoder(), 5)],
    ids=["total variation", "Richardson-Lucy"],
)
def test_portions_know_the_rows_beside_them(decoder, nearer):
    """A picture restored a few rows at a time is what it is at once, but for far rows' part.

    The darkest light whose noise Richardson-Lucy counts is a share of each portion's own mean.
    """
    light = portrait(96)[..., None]
    given = dim(), camera(), ms.HannShutter()
    parts = ms.capture_and_restore(
        light, *given, decoder=decoder, key=jax.random.key(2), rows_at_once=24
    )
    whole = np.asarray(ms.deconvolve(parts.captured, *given, decoder=decoder))
    model = model_of()
    apart = [
        np.asarray(decoder.restore(jnp.moveaxis(jnp.asarray(rows), -1, 0), model))[0]
        for rows in np.split(parts.captured, 4)
    ]
    off, off_apart = (
        np.sqrt(np.mean((x - whole[..., 0]) ** 2))
        for x in (parts.restored[..., 0], np.concatenate(apart))
    )
    assert off_apart > 1e-3
    assert off < off_apart / nearer


@pytest.mark.slow
@pytest.mark.parametrize(
    ("decoder", "rows"),
    [
        (ms.TotalVariationDecoder(), 40),
        (ms.TotalVariationDecoder(), 41),
        (ms.RichardsonLucyDecoder(), 41),
    ],
    ids=["total variation, even", "total variation, odd", "Richardson-Lucy"],
)
def test_portions_of_a_picture_turned_over_are_the_same(decoder, rows):
    """Of an even and an odd number of rows, which the portions do not divide."""
    noise = 0.03 * np.random.default_rng(8).standard_normal((rows, 400, 1))
    light = np.clip(portrait(rows)[..., None] + noise, 0, 1)
    upright, over = (
        ms.capture_and_restore(
            x, dim(), camera(), ms.HannShutter(), decoder=decoder, rows_at_once=12
        ).restored
        for x in (light, light[::-1])
    )
    np.testing.assert_allclose(over[::-1], upright, atol=1e-12)


@pytest.mark.slow
def test_a_tall_picture_is_restored_as_a_low_one_is():
    """Rows are iterated on a few at a time, and those beside them count: no seam shows."""
    block = np.random.default_rng(5).gamma(2.0, 0.1, (20, 90))
    tall, low = jnp.asarray(np.tile(block, (7, 1))), jnp.asarray(np.tile(block, (6, 1)))
    decoder, model = ms.RichardsonLucyDecoder(3), model_of()
    found = np.asarray(decoder.restore(tall, model))[:110]
    np.testing.assert_allclose(found, np.asarray(decoder.restore(low, model))[:110], rtol=1e-12)
