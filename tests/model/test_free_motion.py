"""A path of piecewise constant acceleration: its numbers against brute force, and its errors."""

import re

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.designs import SCENE

from mishutter import FreeMotion, LinearMotion, ParabolicMotion, StillCamera
from mishutter.model.motion import simplified
from mishutter.model.scene import in_sensor_frame
from mishutter.model.stages import stage_path

PATH = FreeMotion(
    accelerations=[410.0, -95.0, 0.0, 700.0, 280.0],
    half_exposure=0.31,
    velocity=-12.0,
    durations=[1.0, 0.7, 0.4, 0.0, 2.5],
)
PARABOLA = ParabolicMotion(acceleration=310.0, half_exposure=0.31, velocity=45.0)


def by_steps(motion, count=200_000):
    """Times, and velocity and position there, by adding up the acceleration step by step."""
    half = float(motion.half_exposure)
    time = (np.arange(count) + 0.5) * (2 * half / count) - half
    share = np.cumsum(motion.durations) / np.sum(motion.durations)
    piece = np.searchsorted(share, (time + half) / (2 * half))
    rate = 2 * np.asarray(motion.accelerations)[piece]
    step = time[1] - time[0]
    ends = np.append(time - step / 2, half)
    velocity = np.append(0.0, np.cumsum(rate) * step)
    velocity += float(motion.velocity) - np.interp(0.0, ends, velocity)
    position = np.append(0.0, np.cumsum((velocity[1:] + velocity[:-1]) / 2) * step)
    return ends, velocity, position - np.interp(0.0, ends, position)


def test_a_path_is_the_integral_of_its_accelerations():
    """Position, velocity, extremes and the numbers that limits are set by, against small steps."""
    time, velocity, position = by_steps(PATH)
    np.testing.assert_allclose(PATH.velocity_at(time), velocity, atol=1e-3)
    np.testing.assert_allclose(PATH.position(time), position, atol=1e-4)
    for speed in (-130.0, 7.0, 250.0):
        way = position - speed * time
        np.testing.assert_allclose(PATH.lowest(speed), np.min(way), atol=1e-4)
        np.testing.assert_allclose(PATH.highest(speed), np.max(way), atol=1e-4)
    way = position + 12.0 * time
    np.testing.assert_allclose(PATH.sag, np.ptp(way), atol=1e-4)
    np.testing.assert_allclose(PATH.stroke, np.ptp(position), atol=1e-4)
    np.testing.assert_allclose(PATH.top_speed, np.max(np.abs(velocity)), atol=1e-3)
    np.testing.assert_allclose(PATH.speed_gain, np.max(np.abs(velocity + 12)), atol=1e-3)
    assert PATH.greatest_acceleration == 820.0
    assert PATH.exposure == 0.62


def test_numbers_are_differentiable():
    """The derivative of a position, and of the lowest one, by each acceleration."""

    @jax.jit
    def numbers(a):
        motion = FreeMotion(accelerations=a, half_exposure=0.31, durations=PATH.durations)
        return jnp.stack([motion.position(0.21), motion.lowest(jnp.array(33.0))])

    slopes = np.asarray(jax.jacrev(numbers)(PATH.accelerations))
    step = 1e-3
    for index in range(5):
        to_side = step * np.eye(5)[index]
        around = [np.asarray(numbers(PATH.accelerations + sign * to_side)) for sign in (1, -1)]
        np.testing.assert_allclose(
            slopes[:, index], (around[0] - around[1]) / (2 * step), atol=1e-9
        )


@pytest.mark.parametrize("num_pieces", [1, 4, 7])
def test_a_parabola_is_a_free_path(num_pieces):
    """The path that is fitted to a parabola has its numbers and its place at every time."""
    path = FreeMotion.fit(PARABOLA, num_pieces=num_pieces)
    time = np.linspace(-0.4, 0.4, 17)
    np.testing.assert_allclose(path.position(time), PARABOLA.position(time), atol=1e-13)
    np.testing.assert_allclose(path.velocity_at(time), PARABOLA.velocity_at(time), atol=1e-12)
    for name in ("stroke", "sag", "speed_gain", "top_speed", "greatest_acceleration", "exposure"):
        np.testing.assert_allclose(getattr(path, name), getattr(PARABOLA, name), rtol=1e-14)
    speed = np.array([-100.0, 45.0, 230.0])
    np.testing.assert_allclose(path.alignment(speed), PARABOLA.alignment(speed), atol=1e-13)


def test_a_fit_keeps_velocities_where_pieces_meet():
    """The path itself where its pieces meet there too, and the same velocities where not."""
    path = FreeMotion(accelerations=[3.0, -2.0, 0.5, 1.0], half_exposure=0.5, velocity=1.5)
    time = np.linspace(-0.5, 0.5, 13)
    same = FreeMotion.fit(path, num_pieces=12)
    np.testing.assert_allclose(same.position(time), path.position(time), atol=1e-14)
    other = FreeMotion.fit(path, num_pieces=3)
    ends = np.linspace(-0.5, 0.5, 4)
    np.testing.assert_allclose(other.velocity_at(ends), path.velocity_at(ends), atol=1e-14)


def test_kinds_of_motion():
    """Without acceleration a path is a pan or at rest; panning changes its velocity alone."""
    straight = FreeMotion(accelerations=[0.0, 0.0], half_exposure=0.3, velocity=4.0)
    assert eqx.tree_equal(simplified(straight), LinearMotion(half_exposure=0.3, velocity=4.0))
    assert eqx.tree_equal(simplified(straight.without_velocity()), StillCamera(half_exposure=0.3))
    assert simplified(PATH) is PATH
    assert PATH.has_vertex
    assert not straight.has_vertex
    moved = PATH.panned(30.0)
    assert isinstance(moved, FreeMotion)
    assert (moved.velocity, moved.durations) == (30.0, PATH.durations)
    scene, still = in_sensor_frame(SCENE, PATH)
    np.testing.assert_array_equal(scene.speeds, SCENE.speeds + 12.0)
    assert still.velocity == 0
    assert FreeMotion(accelerations=[2.0, 1.0, 2.0], half_exposure=0.3).mirrors
    assert not PATH.mirrors


@pytest.mark.parametrize(
    ("accelerations", "durations"),
    [([0.0, 5000.0, 0.0], [1.0, 0.0, 2.0]), ([-7e4, 0.0, 0.0, 3e5], [0.0, 0.6, 1.7, 0.0])],
)
def test_pieces_without_length_bend_no_path(accelerations, durations):
    """A straight path stays one, to whoever asks, with pieces that take no time."""
    path = FreeMotion(
        accelerations=accelerations, durations=durations, half_exposure=0.3, velocity=4.0
    )
    assert eqx.tree_equal(simplified(path), LinearMotion(half_exposure=0.3, velocity=4.0))
    assert not path.has_vertex
    assert path.greatest_acceleration == 0.0
    np.testing.assert_array_equal(path.alignment(np.array([-130.0, 250.0])), 0.0)


def test_pieces_without_length_change_nothing_of_a_bent_path():
    """Whether it mirrors itself, its greatest acceleration and its way from rest to rest."""
    plain = FreeMotion(accelerations=[3.0, 1.0, 3.0], half_exposure=0.3, durations=[1.0, 2.5, 1.0])
    path = FreeMotion(
        accelerations=[3.0, -80.0, 1.0, 3.0, 20.0],
        half_exposure=0.3,
        durations=[1.0, 0.0, 2.5, 1.0, 0.0],
    )
    assert path.mirrors
    assert path.greatest_acceleration == plain.greatest_acceleration == 6.0
    for found, expected in zip(
        stage_path(path, max_acceleration=7.0), stage_path(plain, max_acceleration=7.0), strict=True
    ):
        np.testing.assert_allclose(found, expected, rtol=1e-14)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(("stroke", "is_bent"), [(4e-16, False), (2e-15, True)])
def test_a_free_path_bends_where_its_parabola_does(dtype, stroke, is_bent):
    """From one stroke on, in both precisions, known or traced, of equal pieces or not."""
    half = dtype(1.3e-3)
    a = np.full(3, stroke / 1.3e-3**2, dtype)
    parabola = ParabolicMotion(acceleration=a[0], half_exposure=half)
    path = FreeMotion(accelerations=a, half_exposure=half, durations=[1.0, 0.25, 2.0])
    back_and_forth = FreeMotion(accelerations=a * np.array([1, -1, 1], dtype), half_exposure=half)
    for motion in (parabola, path, back_and_forth):
        assert bool(motion.has_vertex) is is_bent
        assert bool(jax.jit(lambda m: m.has_vertex)(motion)) is is_bent
        assert eqx.tree_equal(simplified(motion), StillCamera(half_exposure=half)) is not is_bent


def test_precision_and_text():
    """A path has the precision of what it is given, and shows its numbers."""
    path = FreeMotion(accelerations=np.ones(2, np.float32), half_exposure=np.float32(0.25))
    assert path.position(np.zeros(3, np.float32)).dtype == np.float32
    assert path.velocity.dtype == np.float32
    text = "FreeMotion(accelerations=[1.0, 1.0], half_exposure=0.25, velocity=0.0, durations=None)"
    assert repr(path) == text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"accelerations": np.zeros(0)}, "be one row of at least one number; got shape (0,)"),
        ({"accelerations": np.ones((1, 1))}, "be one row of at least one number; got shape (1, 1)"),
        ({"accelerations": [1.0, np.inf]}, "be finite; got [1.0, inf]"),
        ({"half_exposure": 0.0}, "be above 0 s; got 0.0"),
        ({"velocity": np.nan}, "be finite; got nan"),
        ({"durations": [1.0]}, "be as many as the 2 accelerations; got 1"),
        ({"durations": [1.0, -1.0]}, "be at least 0, and not all of them 0; got (1.0, -1.0)"),
        ({"durations": [0.0, 0.0]}, "be at least 0, and not all of them 0; got (0.0, 0.0)"),
        ({"durations": 1.0}, "be one row; got shape ()"),
        ({"durations": []}, "be at least 0, and not all of them 0; got ()"),
    ],
)
def test_errors(arguments, message):
    """Each requirement is one line that names the argument and what was given."""
    whole = {"accelerations": [1.0, 2.0], "half_exposure": 0.3} | arguments
    (name,) = arguments
    with pytest.raises(ValueError, match=re.escape(f"`FreeMotion({name}=...)` must {message}.")):
        FreeMotion(**whole)


def test_errors_of_a_fit():
    """A fit has a whole number of pieces."""
    with pytest.raises(ValueError, match="must be a positive integer; got 0"):
        FreeMotion.fit(PARABOLA, num_pieces=0)
