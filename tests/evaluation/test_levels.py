"""Levels of exposures: NumPy as JAX, slopes by every number of every frame, and their use."""

import jax
import jax.flatten_util
import numpy as np
import pytest
from support import plane

from mishutter import (
    EvenVelocities,
    FreeMotion,
    ListedVelocities,
    Occlusion,
    Optics,
    ParabolicMotion,
    PlaneFrames,
    Scene,
    StillCamera,
    TimedFrame,
    evaluate,
    exposures_psnr,
)
from mishutter.evaluation.instants import Instants
from mishutter.evaluation.registration import registration
from mishutter.model.shutters.windows import RectShutter

SCENE = Scene(
    [-1700.0, 300.0, 2100.0],
    [0.2, 0.5, 0.3],
    photon_rate=4e4,
    read_noise=7.0,
    optics=Optics(lens_blur=0.4),
)


def frames_of(numbers):
    """Three frames of a free path of two pieces, a parabola with a pan, and one at rest."""
    accelerations, halves, velocity, times = numbers
    motions = (
        FreeMotion(accelerations=accelerations, half_exposure=halves[0], velocity=velocity),
        ParabolicMotion(acceleration=accelerations[1], half_exposure=halves[1], velocity=velocity),
        StillCamera(half_exposure=halves[2]),
    )
    return tuple(TimedFrame(*each) for each in zip(motions, times, strict=True))


NUMBERS = (
    np.array([-9.1e4, 1.3e5]),
    np.array([0.0042, 0.0031, 0.0013]),
    np.array(350.0),
    [-0.012, 0.001, 0.011],
)


def test_a_path_of_which_some_numbers_are_traced_has_the_level_of_known_ones():
    """Times may be of NumPy beside velocities that `jax.jit` traces."""
    times, exposures = np.array([-0.021, 0.017]), np.array([0.0103, 0.0071])
    durations, velocities = np.array([0.011, 0.03, 0.00867]), np.array([[-90.0, 140.0, 20.0, 75.0]])

    def level(velocities):
        frames = PlaneFrames(times, exposures, durations, velocities)
        return exposures_psnr(SCENE, frames, num_panels=12)

    traced = jax.jit(level)(velocities)
    assert float(traced) == pytest.approx(float(level(velocities)), abs=1e-9)


def test_a_level_has_the_slopes_of_differences_by_every_number_of_every_frame():
    """On an axis, of frames of all kinds; NumPy and JAX have the same level."""

    def level(numbers):
        return exposures_psnr(SCENE, frames_of(numbers), num_panels=5)

    slope = jax.jit(jax.grad(level))(NUMBERS)
    numbers, unflatten = jax.flatten_util.ravel_pytree(NUMBERS)
    for index, one in enumerate(jax.flatten_util.ravel_pytree(slope)[0]):
        change = np.zeros(numbers.size)
        change[index] = 1e-5 * abs(numbers[index])
        ends = [float(level(unflatten(numbers + sign * change))) for sign in (1, -1)]
        difference = (ends[0] - ends[1]) / (2 * change[index])
        assert float(one) == pytest.approx(difference, rel=1e-5, abs=1e-8 / change[index])
    traced = jax.jit(level)(NUMBERS)
    assert float(traced) == pytest.approx(float(level(NUMBERS)), abs=1e-10)
    assert float(exposures_psnr(SCENE, frames_of(NUMBERS))) == pytest.approx(
        float(traced), abs=1e-9
    )


def test_the_slope_is_by_frames_themselves_and_by_light():
    """`TimedFrame`s are a tree of numbers; a time or a place of registered frames moves nothing."""
    frames = frames_of(NUMBERS)
    slope = jax.jit(jax.grad(lambda each: exposures_psnr(SCENE, each, num_panels=4)))(frames)
    assert all(abs(float(x.time)) < 1e-9 and abs(float(x.position)) < 1e-9 for x in slope)
    assert abs(float(slope[2].motion.half_exposure)) > 1

    def by_light(rate, read):
        scene = Scene(SCENE.speeds, SCENE.weights, photon_rate=rate, read_noise=read)
        return exposures_psnr(scene, frames, num_panels=4)

    by_rate, by_noise = jax.jit(jax.grad(by_light, (0, 1)))(4e4, 7.0)
    ends = [float(by_light(4e4 * (1 + x), 7.0)) for x in (1e-5, -1e-5)]
    assert float(by_rate) == pytest.approx((ends[0] - ends[1]) / (2e-5 * 4e4), rel=1e-5)
    assert float(by_noise) < 0 < float(by_rate)


def test_one_exposure_has_the_level_of_a_decoder_that_knows_the_speed():
    """That of `evaluate`, by another quadrature and grid; before a background too."""
    motion = ParabolicMotion(acceleration=9e4, half_exposure=0.006, velocity=250.0)
    layered = SCENE.with_occlusion(None)
    for scene in (SCENE, layered):
        told = float(evaluate(scene, motion, RectShutter()).known_speed_psnr)
        level = float(exposures_psnr(scene, [TimedFrame(motion, 0.0)]))
        assert level == pytest.approx(told, abs=1e-5)
    parts = Scene(
        SCENE.speeds, photon_rate=4e4, read_noise=7.0, occlusion=Occlusion(front_share=0.3)
    )
    apart = Scene(
        [*SCENE.speeds.tolist(), 0.0], [0.1, 0.1, 0.1, 0.7], photon_rate=4e4, read_noise=7.0
    )
    frames = frames_of(NUMBERS)
    assert float(exposures_psnr(parts, frames)) == pytest.approx(
        float(exposures_psnr(apart, frames)), abs=1e-9
    )


def test_a_scene_before_a_background_may_be_made_where_it_is_traced():
    """By its light, its noise or its share alone; the level and its slope are those outside."""
    frames, own = frames_of(NUMBERS), (2e4, 3.0, 0.4)

    def level(rate, noise, share):
        layers = Occlusion(front_share=share, object_width=60.0)
        scene = Scene(SCENE.speeds, photon_rate=rate, read_noise=noise, occlusion=layers)
        return exposures_psnr(scene, frames, num_panels=5)

    for index, number in enumerate(own):

        def one(x, index=index):
            return level(*own[:index], x, *own[index + 1 :])

        traced, slope = jax.jit(jax.value_and_grad(one))(number)
        assert float(traced) == pytest.approx(float(level(*own)), abs=1e-9)
        ends = [float(one(number * (1 + sign * 1e-5))) for sign in (1, -1)]
        assert float(slope) == pytest.approx((ends[0] - ends[1]) / (2e-5 * number), rel=1e-5)


def test_lights_shorten_frames_on_the_path_that_they_keep():
    """A gate that closes early is a shorter frame on the same parabola; so is one in the plane."""
    motion = ParabolicMotion(acceleration=9e4, half_exposure=0.006)
    cut = exposures_psnr(SCENE, [TimedFrame(motion, 0.0)], lights=[(-0.002, 0.006)])
    later = ParabolicMotion(acceleration=9e4, half_exposure=0.004, velocity=2 * 9e4 * 0.002)
    own = exposures_psnr(SCENE, [TimedFrame(later, 0.002)])
    assert float(cut) == pytest.approx(float(own), abs=1e-9)
    scene, frames = plane.scene_of("A"), plane.frames_of("A", 2, "sines")
    begin, end = frames.times - frames.exposures / 2, frames.times + frames.exposures / 2
    whole = exposures_psnr(scene, frames, lights=[*zip(begin, end, strict=True)])
    assert float(whole) == pytest.approx(float(exposures_psnr(scene, frames)), abs=1e-12)
    short = [(float(b) + 0.004, float(e)) for b, e in zip(begin, end, strict=True)]
    instants = Instants.of(frames, 2800.0, lights=short)
    np.testing.assert_allclose(instants.exposure, frames.exposures - 0.004)
    middle = float(begin[0] + end[-1]) / 2
    expected = frames.place(instants.time + middle) - frames.place(np.array([middle]))[..., None]
    np.testing.assert_allclose(instants.place, expected, atol=1e-9)


def test_frames_of_one_axis_have_a_level_in_the_plane():
    """Along its rows, as the same path of two components."""
    scene = Scene.any_direction(EvenVelocities(1500.0), photon_rate=3e4, read_noise=9.0)
    velocity = 700.0 * np.ones((1, 2)) * np.array([[1.0], [0.0]])
    path = PlaneFrames(np.array([0.0]), np.array([0.006]), np.array([0.006]), velocity)
    motion = ParabolicMotion(acceleration=0.0, half_exposure=0.003, velocity=700.0)
    one = exposures_psnr(scene, [TimedFrame(motion, 0.0)])
    assert float(one) == pytest.approx(float(exposures_psnr(scene, path)), abs=1e-9)


@pytest.mark.parametrize(
    ("kind", "size", "loss"), [("still", 2.2328, 1.339e-3), ("crossed", 1.0023, 7.552e-4)]
)
def test_registration_in_the_plane_is_the_bound_of_the_reference(kind, size, loss):
    """The deviation of a velocity, px/s, from 64 x 64 px of four frames; both components of it."""
    law = ListedVelocities([[1500.0, 800.0]])
    scene = Scene.any_direction(law, photon_rate=3e4, read_noise=10.0)
    bound = registration(scene, plane.frames_of("A", 4, kind))
    assert bound.deviation.shape == (1, 2)
    assert float(np.hypot(*bound.deviation[0])) == pytest.approx(size, rel=2e-3)
    assert float(bound.loss[0]) == pytest.approx(loss, rel=1e-2)


def test_no_exposure_and_a_traced_one_without_panels_are_refused():
    """The line says what is missing."""
    with pytest.raises(ValueError, match=r"exposures_psnr\(exposures=...\)` must hold one exp"):
        exposures_psnr(SCENE, [])
    frames = frames_of(NUMBERS)
    unknown = jax.tree.map(lambda x: np.nan * x, frames)
    with pytest.raises(
        ValueError, match=r"exposures_psnr\(exposures=...\)` must be finite numbers"
    ):
        exposures_psnr(SCENE, unknown)
    with pytest.raises(ValueError, match=r"exposures_psnr\(num_panels=...\)` must be given where"):
        jax.jit(lambda frames: exposures_psnr(SCENE, frames))(frames)


def test_panels_that_do_not_hold_the_way_are_refused():
    """Over the 25 px of the fastest thing in 12 ms: of numbers at once, and of traced ones run."""
    still = [TimedFrame(StillCamera(half_exposure=0.006), 0.0)]

    def level(speeds, num_panels):
        scene = SCENE.without_metadata(speeds=speeds)
        return exposures_psnr(scene, still, num_panels=num_panels)

    run = jax.jit(level, static_argnums=1)
    for each in (level, run):
        whole = float(exposures_psnr(SCENE, still))
        assert float(each(SCENE.speeds, 3)) == pytest.approx(whole, abs=1e-6)
        few = r"exposures_psnr\(num_panels=...\)` must be so many .* 10 px in a panel; got 2"
        with pytest.raises((ValueError, RuntimeError), match=few):
            each(SCENE.speeds, 2)
        assert np.isfinite(each(0.7 * SCENE.speeds, 2))
