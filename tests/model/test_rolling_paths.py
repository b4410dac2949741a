"""The path that rows see that are exposed earlier or later than the middle one."""

import numpy as np
import pytest
from support.rolling import PERIOD, alternating, frames_on_parabolas

from mishutter import Limits, PlaneFrames, TimedFrame
from mishutter.evaluation.instants import Instants
from mishutter.model.exposures import Exposures
from mishutter.model.motion import LinearMotion


def test_a_row_sees_the_part_of_the_path_that_is_later():
    """Beyond the first and the last light alternating parabolas alternate."""
    path = Exposures("", tuple(frames_on_parabolas())).path_for_rows(0.02, Limits())
    for delay in (-0.01, 0.0, 0.004, 0.01):
        instants = Instants.of(path, 900.0, delay=delay)
        np.testing.assert_allclose(np.sum(instants.weight, axis=1), 1, rtol=1e-9)
        differs = instants.place[0] - alternating(instants.time)
        assert np.ptp(differs) < 2e-5
        assert np.min(instants.time) - delay == pytest.approx(-2 * PERIOD, rel=1e-3)
        assert np.max(instants.time) - delay == pytest.approx(2 * PERIOD, rel=1e-3)
        np.testing.assert_allclose(instants.exposure, PERIOD)


def test_a_circle_turns_on():
    """Mirrored across its velocity it goes on as the circle that it is."""
    pieces, turn = 400, 2 * np.pi / 0.07
    angle = np.linspace(0, turn * 0.08, pieces + 1)
    velocities = 3000 * np.stack([-np.sin(angle), np.cos(angle)])
    middles = (np.arange(4) - 1.5) * PERIOD
    lasting = np.full(pieces, 0.08 / pieces)
    circle = PlaneFrames(middles, np.full(4, PERIOD), lasting, velocities)
    led = circle.for_rows(0.018, Limits(max_stroke=500.0))
    assert led.lead == 0.009
    instants = Instants.of(led, 0.0, delay=0.009)
    angle = turn * (instants.time + 0.04)
    wanted = 3000 / turn * np.stack([np.cos(angle), np.sin(angle)])
    differs = instants.place - wanted
    assert np.max(np.ptp(differs, axis=(1, 2))) < 0.02


def test_a_path_that_does_not_fit_comes_from_rest():
    """Within the travel of the frames alone the first rows see how the stage runs up."""
    pan = LinearMotion(half_exposure=PERIOD / 2, velocity=3000.0)
    two = [TimedFrame(pan, -PERIOD / 2, -30.0), TimedFrame(pan, PERIOD / 2, 30.0)]
    free = Exposures("", tuple(two)).path_for_rows(0.004, Limits(max_acceleration=4e6))
    assert np.ptp(free.place(free.bends)) == pytest.approx(120 + 2 * 6 + 3000**2 / 4e6, rel=1e-6)
    path = Exposures("", tuple(two)).path_for_rows(
        0.004, Limits(max_acceleration=4e6, max_travel=125.0)
    )
    assert np.ptp(path.place(path.bends)) == pytest.approx(120 + 3000**2 / 4e6, rel=1e-6)
    early = Instants.of(path, 0.0, delay=-0.002)
    at = path.place(np.array([-0.022, -0.021]))[0]
    assert at[0] == at[1]
    assert early.place[0, 0, 0] == pytest.approx(early.place[0, 0, 2], abs=1e-9)


def test_rows_beside_a_camera_that_turns_see_frames_move_as_they_do():
    """The stage rests before and after them, so that the sensor goes with the camera."""
    moves = LinearMotion(half_exposure=PERIOD / 2, velocity=3000.0)
    two = [TimedFrame(moves, -PERIOD / 2, -30.0), TimedFrame(moves, PERIOD / 2, 30.0)]
    taken = Exposures("", tuple(two)).path
    path = taken.path_for_rows(0.004, Limits(max_acceleration=4e6), np.array([700.0]))
    times = np.array([-PERIOD, -0.003, 0.0, PERIOD])
    np.testing.assert_allclose(np.diff(path.place(times)[0]), 3000 * np.diff(times), rtol=1e-9)
    begin = path.bends[0]
    before = path.place(np.array([begin, begin + 0.003]))[0]
    np.testing.assert_allclose(np.diff(before), 700 * 0.003, rtol=1e-6)
    # So too in the plane, where the camera turns along the columns alone and travel is short.
    middles, velocities = np.array([-PERIOD / 2, PERIOD / 2]), np.array([[0.0, 0.0], [3000, 3000]])
    plane = PlaneFrames(middles, np.full(2, PERIOD), np.array([2 * PERIOD]), velocities)
    limits = Limits(max_acceleration=4e6, max_travel=95.0)
    turned = plane.for_rows(0.004, limits, np.array([0.0, 700.0]))
    before = turned.place(turned.bends[0] + np.array([0.0, 0.001]))
    np.testing.assert_allclose(np.diff(before)[:, 0], [0, 0.7], atol=1e-9)


def test_frames_without_a_path_have_no_rows():
    """What the stage does between frames is not known of frames alone."""
    with pytest.raises(ValueError, match=r"Instants.of\(delay=...\)` must be 0 for frames without"):
        Instants.of(frames_on_parabolas(), 0.0, delay=0.001)
