"""Frames of a burst by numbers without bounds."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from mishutter import (
    BurstMode,
    ExposureParameters,
    Exposures,
    Limits,
    ParabolicMotion,
    PlaneFrames,
    Scene,
    StillCamera,
    TimedFrame,
    exposures_psnr,
)
from mishutter.evaluation.bursts import FrameTimes

LIGHT = {"photon_rate": 3e4, "read_noise": 5.0}
STAGE = {"max_stroke": 30, "max_acceleration": 1e6, "max_half_exposure": 0.02}
BURST = BurstMode(frames_per_s=40, max_frames=3, window=0.09, dead_time=0.002)
LINE = Scene.uniform(max_speed=600.0, num_speeds=3, **LIGHT, limits=Limits(**STAGE), burst=BURST)
PLANE = {
    axes: Scene.any_direction(
        400.0, **LIGHT, limits=Limits(**STAGE, max_travel=45, axes=axes), burst=BURST
    )
    for axes in ("each", "disc", "one")
}
SWING = ParabolicMotion(acceleration=8.0 / 0.006**2, half_exposure=0.006)
FRAMES = [TimedFrame(StillCamera(half_exposure=0.005), -0.03), TimedFrame(SWING, 0.0)]
CIRCLE = PlaneFrames(
    np.array([-0.025, 0.02]),
    np.array([0.02, 0.015]),
    np.array([0.02, 0.0275, 0.015]),
    900.0 * np.stack([np.cos([0.0, 2.0, 4.0, 5.5]), np.sin([0.0, 2.0, 4.0, 5.5])]),
)
IN_PLANE = {
    "circle": CIRCLE,
    "stills": replace(CIRCLE, velocities=0 * CIRCLE.velocities),
    "pan": replace(CIRCLE, velocities=CIRCLE.velocities[:, :1] + 0 * CIRCLE.velocities),
}
STARTS = {"line": (LINE, FRAMES)} | {axes: (PLANE[axes], CIRCLE) for axes in PLANE}


@pytest.fixture(scope="module", params=STARTS)
def parameters(request):
    return ExposureParameters(*STARTS[request.param])


def test_it_begins_with_the_frames_that_it_was_given(parameters):
    """The numbers of frames within the limits are theirs."""
    scene, frames = next(each for each in STARTS.values() if each[0] is parameters.scene)
    if scene.limits.axes == "one" and not isinstance(frames, list):
        pytest.skip("a circle takes two axes")
    again = parameters.frames(parameters.start)
    given = Exposures("given", frames)
    np.testing.assert_allclose(again.exposures, given.exposures, rtol=2e-3)
    np.testing.assert_allclose(np.diff(again.times), np.diff(given.times), rtol=2e-3)
    levels = [float(exposures_psnr(scene, each)) for each in (again, frames)]
    assert levels[0] == pytest.approx(levels[1], abs=0.02)


@pytest.mark.parametrize("size", [0.3, 3.0, 30.0])
def test_frames_of_any_numbers_can_be_taken(parameters, size):
    """Whatever the numbers, the camera has time for the frames, and the stage the room."""
    rng, camera = np.random.default_rng(0), FrameTimes.of(parameters.scene, BURST)
    for _ in range(5):
        frames = parameters.frames(size * rng.standard_normal(parameters.size))
        begin, end = (np.asarray(frames.times + sign * frames.exposures / 2) for sign in (-1, 1))
        least = 1 - 1e-9
        assert end[-1] - begin[0] <= camera.window / least
        assert np.all(frames.exposures >= camera.shortest * least)
        assert np.all(frames.exposures <= camera.longest / least)
        assert np.all(np.diff(end) >= camera.period * least)
        assert np.all(begin[1:] - end[:-1] >= camera.dead_time * least)
        assert Exposures("some", frames).share_of(parameters.scene.limits) <= 1 / least


def test_the_greatest_share_of_a_limit_is_reached(parameters):
    """What is slowed takes all of some limit, but for a run-up that is shorter then."""
    numbers = np.array(parameters.start)
    numbers[2 * parameters.num_frames - 1 :] *= 20
    taken = Exposures("fast", parameters.frames(numbers)).share_of(parameters.scene.limits)
    assert 0.5 < taken <= 1 + 1e-9


@pytest.fixture(scope="module")
def on_a_line():
    """Parameters, and what is compiled of them once."""
    parameters = ExposureParameters(LINE, FRAMES)
    return parameters, jax.jit(jax.value_and_grad(parameters.loss()))


def is_that_of_differences(value, row):
    """Whether a gradient along some direction is the difference of a function's values."""
    along, step = np.random.default_rng(1).standard_normal(row.size), 1e-5
    ends = [float(value(jnp.array(row + sign * step * along))[0]) for sign in (1, -1)]
    slope = float(np.dot(value(jnp.array(row))[1], along))
    return slope == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-4, abs=1e-5)


@pytest.mark.parametrize("size", [0.0, 0.5])
def test_derivatives_are_those_of_differences(on_a_line, size):
    """Each number's, where nothing is shortened or slowed and where something is."""
    parameters, value = on_a_line
    change = size * np.random.default_rng(2).standard_normal(parameters.size)
    assert is_that_of_differences(value, 0.9 * np.array(parameters.start) + change)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("axes", "name"), [("each", "circle"), ("disc", "circle"), ("disc", "stills"), ("one", "pan")]
)
def test_derivatives_in_the_plane_are_those_of_differences(axes, name):
    """Limits of each axis, of both together and of one are differentiated too."""
    parameters = ExposureParameters(PLANE[axes], IN_PLANE[name])
    value = jax.jit(jax.value_and_grad(parameters.loss()))
    for share in (1.0, 2.0):
        assert is_that_of_differences(value, share * np.array(parameters.start))


def test_a_stage_of_one_axis_stays_on_it():
    """Whatever the numbers, the path is straight, along a direction that one of them turns."""
    parameters = ExposureParameters(PLANE["one"], CIRCLE)
    row = np.random.default_rng(3).standard_normal(parameters.size)
    for turn in (-0.4, 1.3):
        row[-1] = turn
        x, y = np.asarray(parameters.frames(row).velocities)
        np.testing.assert_allclose(y, np.tan(turn) * x, rtol=1e-12)
    assert parameters.size == ExposureParameters(PLANE["each"], CIRCLE).size - 3


def test_optax_raises_the_level_within_the_limits(on_a_line):
    """A step of a network's optimiser is one of frames."""
    parameters, value = on_a_line
    optimiser, numbers = optax.adam(0.1), parameters.start
    state, losses = optimiser.init(numbers), []
    for _ in range(8):
        loss, slope = value(numbers)
        losses.append(float(loss))
        with jax.numpy_dtype_promotion("standard"):  # as optax counts steps by whole numbers
            step, state = optimiser.update(slope, state)
        numbers = optax.apply_updates(numbers, step)
    assert min(losses) < losses[0] - 0.05
    assert Exposures("end", parameters.frames(numbers)).share_of(LINE.limits) <= 1 + 1e-9


def test_a_number_that_is_none_makes_no_level(on_a_line):
    """Where JAX traces it the level is no number either."""
    parameters, value = on_a_line
    for place in (0, parameters.num_frames, -1):
        assert np.isnan(value(parameters.start.at[place].set(jnp.nan))[0])


def scene_of(**changes):
    limits = Limits(**(STAGE | changes.pop("limits", {})))
    return Scene.uniform(
        max_speed=1500.0, **LIGHT, **({"limits": limits, "burst": BURST} | changes)
    )


REFUSED = {
    "have a `burst`": lambda: ExposureParameters(scene_of(burst=None), FRAMES),
    "have limits with a `max_acceleration` and without": lambda: ExposureParameters(
        scene_of(limits={"max_jerk": 1e9}), FRAMES
    ),
    "be in their order": lambda: ExposureParameters(LINE, FRAMES[::-1]),
    "be so few that 0.09 s hold them; got 5": lambda: ExposureParameters(
        LINE, [TimedFrame(StillCamera(half_exposure=0.005), 0.03 * k) for k in range(5)]
    ),
    "have shape (": lambda: ExposureParameters(LINE, FRAMES).frames([0.1, 0.2]),
    "be finite; got nan": lambda: ExposureParameters(LINE, FRAMES).frames(
        np.full(ExposureParameters(LINE, FRAMES).size, np.nan)
    ),
}


@pytest.mark.parametrize("requirement", REFUSED)
def test_bad_input_is_refused(requirement):
    """One line that names the argument."""
    with pytest.raises(ValueError, match=r"`ExposureParameters.*`") as error:
        REFUSED[requirement]()
    assert requirement in str(error.value)
