"""What a single exposure, a burst along an axis and a burst in the plane have in common."""

from dataclasses import replace

import numpy as np
import pytest
from support.bursts import LIMITS, SEQUENCE, a_burst_design
from support.plane import a_plane_design

from mishutter import Exposures, FrameSequence, Limits, ParabolicMotion, StillCamera, TimedFrame


def _one():
    """The design of a single exposure, whose parabola pans."""
    motion = ParabolicMotion(acceleration=2.1e4, half_exposure=0.007, velocity=350.0)
    return replace(a_burst_design(None), motion=motion)


DESIGNS = {"one": _one, "burst": a_burst_design, "plane": a_plane_design}


@pytest.mark.parametrize("slug", DESIGNS)
def test_a_stage_is_where_the_exposures_want_it(slug):
    """Each axis has one path from rest to rest, which is the sensor's but for a constant."""
    design = DESIGNS[slug]()
    taken = design.exposures
    paths = taken.stage_paths(design.scene)
    assert tuple(paths) == taken.axes == (("_x", "_y") if slug == "plane" else ("",))
    times = np.array([np.linspace(first, last, 9)[1:-1] for first, last in taken.lights])
    for path, places in zip(paths.values(), taken.place(times), strict=True):
        apart = path.at(times)[0] - places
        np.testing.assert_allclose(apart, apart[0, 0], atol=2e-4)
        assert path.exposure == pytest.approx((taken.lights[0][0], taken.lights[-1][1]))


@pytest.mark.parametrize("slug", DESIGNS)
def test_lights_follow_from_times_and_exposures(slug):
    """They are in order, and the first and the last are as far apart as the duration."""
    taken = DESIGNS[slug]().exposures
    begin, end = np.transpose(taken.lights)
    np.testing.assert_allclose((begin + end) / 2, taken.times, atol=1e-12)
    np.testing.assert_allclose(end - begin, taken.exposures)
    assert np.all(np.diff(begin) > 0)
    assert taken.duration == pytest.approx(end[-1] - begin[0])
    assert taken.num_frames == len(taken.lights)


def test_exposures_are_numbered_where_stills_differ():
    """Of frames that move, or that are all alike or all unlike, lengths alone are said."""

    def stills(*halves):
        frames = [TimedFrame(StillCamera(half_exposure=x), 0.05 * k) for k, x in enumerate(halves)]
        return FrameSequence("stills", tuple(frames), 0.0, 31.0, 30.0)

    assert stills(0.0054, 0.00176, 0.00176).lengths == "1 of 10.8 and 2 of 3.52 ms"
    assert stills(0.0054, 0.00176).lengths == "10.8 and 3.52 ms"
    assert stills(0.0054, 0.0054).lengths == "10.8 ms"
    assert SEQUENCE.lengths == "4.2 and 13.6 ms"
    assert a_plane_design().exposures.lengths == "9 and 10.3 and 11 ms"


def test_a_camera_that_turns_makes_the_pan_of_an_exposure():
    """The stage makes what is left."""
    one = _one()
    assert Exposures.of_one(one.motion, one.shutter, LIMITS).pan == 0.0
    turning = Limits(max_stroke=40.0, max_half_exposure=0.012, pans="camera")
    assert Exposures.of_one(one.motion, one.shutter, turning).pan == 350.0
