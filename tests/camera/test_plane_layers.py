"""Layers in the plane, by sums of whole pictures over the instants of each frame."""

import re

import numpy as np
import pytest
from support.plane import scene_of

from mishutter import (
    Layer,
    Layers,
    Picture,
    PlaneFrames,
    Scene,
    StillCamera,
    TimedFrame,
    read_layers,
    simulate_frames,
    write_layers,
)
from mishutter.camera.plane_layers import _reach
from mishutter.camera.responses import aperture_on
from mishutter.evaluation.instants import Instants

SCENE = scene_of("A")
SIZE = (80, 100)
FINER = 3
# A stage that moves, between frames of two lengths too.
FRAMES = PlaneFrames(
    np.array([-0.02, 0.01, 0.02]),
    np.array([0.01, 0.01, 0.004]),
    np.array([0.03, 0.01, 0.007]),
    np.array([[300.0, -200, 600, 0], [0, 400, -100, 200]]),
)


def texture(rows, columns, seed):
    """Light without the highest frequencies, whose phase is not told by pixels."""
    noise = np.fft.rfft2(np.random.default_rng(seed).standard_normal((rows, columns)))
    down, across = np.fft.fftfreq(rows)[:, None], np.fft.rfftfreq(columns)
    noise *= (np.abs(down) < 0.45) * (across < 0.45) / np.sqrt(down**2 + across**2 + 1e-3)
    light = np.fft.irfft2(noise, (rows, columns))
    return 0.5 + 0.1 * light[..., None] / light.std()


def layers(*velocities):
    """A background and things whose outlines are soft, the second before the first."""
    down, across = np.mgrid[:30, :40]
    matte = np.exp(-(((down - 14.5) / 6) ** 2) - ((across - 19.5) / 8) ** 2)
    places = [(30, 25), (40, 30)]
    things = [
        Layer(Picture(texture(30, 40, seed), matte), velocity, left, top)
        for seed, velocity, (left, top) in zip((2, 5), velocities, places, strict=False)
    ]
    return Layers((Layer(Picture(texture(*SIZE, 1)), (50.0, -30.0)), *things), border="wrap")


def displaced(light, way):
    """A picture as large as the sensor, displaced and at `FINER` times the pixels."""
    numbers = [np.fft.fftfreq(n, 1 / n).astype(int) for n in SIZE]
    phase = [np.exp(-2j * np.pi * k / n * x) for k, n, x in zip(numbers, SIZE, way, strict=True)]
    wide = np.zeros([FINER * n for n in SIZE], complex)
    wide[np.ix_(*numbers)] = np.fft.fft2(light) * phase[0][:, None] * phase[1]
    return np.real(np.fft.ifft2(wide)) * FINER**2


def placed(light, layer):
    picture = np.zeros(SIZE)
    rows, columns = light.shape
    picture[layer.top : layer.top + rows, layer.left : layer.left + columns] = light
    return picture


def test_every_instant_shows_the_layers_where_they_are_then():
    """A frame is the sum of composites of displaced layers, through the pixels and the lens."""
    scene = layers((900.0, -400.0), (-500.0, 300.0))
    instants = Instants.of(FRAMES, 3000.0)
    for k, found in enumerate(np.asarray(simulate_frames(scene, SCENE, FRAMES))):
        total = np.zeros([FINER * n for n in SIZE])
        one = instants.some([k])
        for time, place, weight in zip(one.time[0], one.place[:, 0].T, one.weight[0], strict=True):
            picture = np.zeros_like(total)
            for layer in scene.layers:
                way = (place - layer.velocity * time)[::-1]
                matte = displaced(placed(layer.matte, layer), way)
                light = displaced(placed(layer.matte * layer.picture.light[..., 0], layer), way)
                picture = picture * (1 - matte) + light
            total += weight * picture
        rows, columns = (np.fft.fftfreq(n, 1 / n).astype(int) for n in SIZE)
        wanted = np.fft.fft2(total)[np.ix_(rows, columns)][:, : SIZE[1] // 2 + 1] / FINER**2
        wanted = np.fft.irfft2(wanted * aperture_on(SCENE.optics, SIZE), SIZE)
        # Instants between which things move half a pixel hold the frame to this.
        np.testing.assert_allclose(found[..., 0], wanted, atol=4e-4)


def test_a_background_alone_is_a_picture_that_moves_as_a_whole():
    """So is a thing that moves with it, on part of the picture that a smaller sensor sees."""
    light, velocity = texture(*SIZE, 7), (330.0, -410.0)
    thing = layers(velocity).layers[1]
    cut = Picture(light[25:55, 30:70], thing.matte)
    both = Layers((Layer(Picture(light), velocity), Layer(cut, velocity, left=30, top=25)))
    size = {"num_rows": 50, "num_columns": 64}
    wanted = simulate_frames(light, SCENE, FRAMES, speed=velocity, **size)
    alone = simulate_frames(Layers(both.layers[:1]), SCENE, FRAMES, **size)
    np.testing.assert_allclose(alone, wanted, atol=1e-6)
    np.testing.assert_allclose(simulate_frames(both, SCENE, FRAMES, **size), wanted, atol=4e-4)


def test_velocities_are_read_as_they_are_written(tmp_path):
    """One number is a speed along the axis of the scene, two are a velocity."""
    scene = layers((900.0, -400.0), 300.0)
    write_layers(tmp_path, scene)
    first, second = read_layers(tmp_path / "layers.toml").layers[1:]
    assert first.speed == [900.0, -400.0]
    assert second.speed == 300.0
    file = tmp_path / "layers.toml"
    text = file.read_text(encoding="utf-8").replace("speed", "velocity_px_per_s=[1,2]\nspeed")
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=re.escape("beside `velocity_px_per_s`; got 300.0")):
        read_layers(tmp_path / "layers.toml")


def test_one_axis_takes_what_moves_along_it():
    """Exchanged with rows and columns; anything else is refused."""
    frames = [TimedFrame(StillCamera(half_exposure=2e-3), time) for time in (-0.01, 0.01)]
    scene = Scene([300.0], photon_rate=1e5, read_noise=2.0)
    still = Layers((Layer(layers().layers[0].picture), *layers((400.0, 0.0)).layers[1:]))
    single = Layers((still.layers[0], *layers(400.0).layers[1:]))
    pair = [simulate_frames(each, scene, frames) for each in (still, single)]
    np.testing.assert_array_equal(*pair)
    with pytest.raises(ValueError, match=re.escape("be along the axis of the scene; frames in")):
        simulate_frames(layers((400.0, 30.0)), scene, frames)
    with pytest.raises(ValueError, match=re.escape("be a speed, or a velocity along rows and")):
        Layer(still.layers[0].picture, (1.0, 2.0, 3.0))


def test_what_a_small_thing_hides_is_hidden_once():
    """On a sensor far wider than it, the background away from it is as if nothing were there."""
    ground = Layer(Picture(np.full((70, 420, 1), 0.8)))
    thing = Layer(Picture(np.full((20, 24, 1), 0.1)), (90.0, -60.0), left=310, top=25)
    frames = PlaneFrames(np.zeros(1), np.full(1, 0.01), np.full(1, 0.01), np.zeros((2, 2)))
    scene = Scene.any_direction(200.0, photon_rate=1e5, read_noise=2.0)
    light = np.asarray(simulate_frames(Layers((ground, thing)), scene, frames))[0, ..., 0]
    away = np.abs(np.arange(420) - 322) > 30
    np.testing.assert_allclose(light[:, away], 0.8, atol=1e-3)
    assert np.min(light[:, ~away]) < 0.15


@pytest.mark.parametrize("axis", [0, 1], ids=["along rows", "along columns"])
def test_a_streak_hides_all_across_it(axis):
    """A thing at rest hides each point of its streak for its share of the way."""
    velocities, size, way = np.zeros((2, 2)), 24, 300
    velocities[axis] = way / 0.03
    frames = PlaneFrames(np.zeros(1), np.full(1, 0.03), np.full(1, 0.03), velocities)
    shape = (60, 400) if axis == 0 else (400, 60)
    top, left = (18, 188) if axis == 0 else (188, 18)
    thing = Layer(Picture(np.full((size, size, 1), 0.1)), (0.0, 0.0), left=left, top=top)
    layers = Layers((Layer(Picture(np.full((*shape, 1), 0.8)), (0.0, 0.0)), thing))
    light = np.asarray(simulate_frames(layers, SCENE, frames))[0, ..., 0]
    streak = light[21:39, 70:330] if axis == 0 else light[70:330, 21:39]
    np.testing.assert_allclose(streak, 0.8 - 0.7 * size / way, atol=0.01)


def test_a_sheet_reaches_as_far_as_it_is_displaced_to_either_side():
    displacement = np.array([[[-7.2, 1.0]], [[0.5, -2.1]]])
    assert _reach(displacement) == (3, 8)
    assert _reach(-displacement) == (3, 8)
