"""Stages of a second-order response, against the oscillator's equation stepped in time."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from mishutter import FreeMotion, ParabolicMotion, SecondOrderStage, stage_path

PARABOLA = ParabolicMotion(acceleration=4.1e5, half_exposure=0.01, velocity=700.0)
PATHS = {
    "parabola": stage_path(PARABOLA, max_acceleration=1.1e6),
    "jerk": stage_path(PARABOLA, max_acceleration=1.1e6, max_jerk=3e8),
    "free": stage_path(
        FreeMotion(accelerations=[3e5, -1e5, 0.0, 4e5], half_exposure=0.012, velocity=-90.0),
        max_acceleration=9e5,
    ),
}
STAGES = {
    "soft": SecondOrderStage(bandwidth=31.0, damping=0.7),
    "rings": SecondOrderStage(bandwidth=240.0, damping=0.11),
    "critical": SecondOrderStage(bandwidth=90.0, damping=1.0),
    "sluggish": SecondOrderStage(bandwidth=40.0, damping=3.0),
}


def _stepped(stage, path, sent, num_steps=600):
    """Times and positions of the oscillator that is sent positions, by the rule of Runge-Kutta."""
    square, drag = stage.natural_frequency**2, 2 * float(stage.damping) * stage.natural_frequency
    state, times, found = np.array([path.positions[0], 0.0]), [], []
    for begin, end in itertools.pairwise([*path.times, path.times[-1] + 0.01]):
        step = (end - begin) / num_steps
        halves = np.linspace(begin, end, 2 * num_steps + 1)
        pulled = sent(np.minimum(halves, np.nextafter(end, begin)))
        for k in range(num_steps):
            times.append(halves[2 * k])
            found.append(state[0])
            slopes, at = [], state
            for share, place in ((0.5, 0), (0.5, 1), (1.0, 1), (0.0, 2)):
                slope = np.array([at[1], square * (pulled[2 * k + place] - at[0]) - drag * at[1]])
                slopes.append(slope)
                at = state + share * step * slope
            state = state + step / 6 * (slopes[0] + 2 * slopes[1] + 2 * slopes[2] + slopes[3])
    return np.array(times), np.array(found)


@pytest.mark.parametrize(
    ("stage", "path"),
    [
        pytest.param(
            STAGES[stage],
            PATHS[path],
            marks=() if (stage, path) == ("rings", "jerk") else pytest.mark.slow,
            id=f"{path}-{stage}",
        )
        for path, stage in itertools.product(PATHS, STAGES)
    ],
)
def test_what_a_stage_makes_of_a_path_solves_its_equation(stage, path):
    """Sent the path it strays as the oscillator does; sent what `sent_for` says it is on it."""
    times, strayed = _stepped(stage, path, lambda t: path.at(t)[0])
    position, _ = path.at(times)
    made, velocity = stage.followed(path, times)
    np.testing.assert_allclose(made, strayed, atol=1e-5)
    assert np.ptp(made - position) > 0.1
    slope = np.diff(stage.followed(path, np.array([-1e-6, 1e-6]))[0])[0] / 2e-6
    assert stage.followed(path, np.array([0.0]))[1][0] == pytest.approx(slope, rel=1e-5)
    _, kept = _stepped(stage, path, lambda t: stage.sent_for(path, t))
    np.testing.assert_allclose(kept, position, atol=1e-5)
    assert velocity.shape == times.shape


@pytest.mark.parametrize("stage", STAGES.values(), ids=STAGES)
@pytest.mark.parametrize("path", PATHS.values(), ids=PATHS)
def test_the_motion_that_a_stage_makes_is_known_to_a_hundredth_of_a_pixel(stage, path):
    """Its pieces have the stage's own velocities, and go where it goes."""
    motion = stage.made_of(path)
    times = np.linspace(*path.exposure, 613)
    exact = stage.followed(path, times)[0] - stage.followed(path, np.array([0.0]))[0]
    assert np.max(np.abs(np.asarray(motion.position(times)) - exact)) < 0.01
    early = np.asarray(stage.made_of(path, ahead=0.003).velocity_at(times[:1]))
    np.testing.assert_allclose(early, stage.followed(path, times[:1] + 0.003)[1], rtol=1e-9)


def test_a_bandwidth_is_where_half_of_the_power_passes():
    """At any damping, and the delay is the slope of the phase at frequency 0."""
    for damping in (0.01, 0.3, 2**-0.5, 1.0, 40.0):
        stage = SecondOrderStage(bandwidth=70.0, damping=damping)
        ratio = 2 * np.pi * 70.0 / stage.natural_frequency
        assert abs(1 - ratio**2 + 2j * damping * ratio) ** 2 == pytest.approx(2, rel=1e-12)
        low = 1e-6j
        phase = -np.angle(1 / (1 + low**2 + 2 * damping * low)) / (1e-6 * stage.natural_frequency)
        assert stage.delay == pytest.approx(phase, rel=1e-6)


def test_a_steady_parabola_is_followed_late():
    """Long after the run-up the path that is made is the one that was sent, a delay before."""
    stage = STAGES["critical"]
    slow = ParabolicMotion(acceleration=2e3, half_exposure=0.2)
    path = stage_path(slow, max_acceleration=4e3)
    times = np.linspace(0.05, 0.15, 30)
    aside = stage.followed(path, times)[0] - path.at(times - stage.delay)[0]
    np.testing.assert_allclose(aside, aside[0], atol=1e-9)


@pytest.mark.parametrize("name", ["bandwidth", "damping"])
@pytest.mark.parametrize("value", [0.0, -3.0, np.inf, np.nan, np.ones(2)])
def test_a_response_that_is_none_is_refused(name, value):
    """The line names the argument."""
    given = {"bandwidth": 50.0, "damping": 0.5} | {name: value}
    with pytest.raises(ValueError, match=rf"`SecondOrderStage\({name}=...\)` must"):
        SecondOrderStage(**given)


def test_a_response_travels_through_jit():
    """It is a tree of two numbers, in the precision that they have."""
    stage = SecondOrderStage(bandwidth=jnp.float32(50), damping=jnp.float32(0.5))
    doubled = jax.jit(lambda s: jax.tree.map(lambda x: 2 * x, s))(stage)
    assert (float(doubled.bandwidth), float(doubled.damping)) == (100.0, 1.0)
    assert doubled.bandwidth.dtype == jnp.float32
