"""What a single exposure, a burst along an axis and a burst in the plane have in common."""

from dataclasses import replace

import numpy as np
import pytest
from support.bursts import LIMITS, SEQUENCE, a_burst_design
from support.plane import a_plane_design

from mishutter import (
    EvenVelocities,
    Exposures,
    FreeMotion,
    Limits,
    LinearMotion,
    ParabolicMotion,
    PlaneFrames,
    Scene,
    StillCamera,
    TimedFrame,
)
from mishutter.model.exposures import exposures_in_plane
from mishutter.model.frame_path import FramePath, TimedFrames


def _one():
    """The design of a single exposure, whose parabola pans."""
    motion = ParabolicMotion(acceleration=2.1e4, half_exposure=0.007, velocity=350.0)
    return a_burst_design(None).with_one(motion=motion)


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
        return Exposures("stills", tuple(frames), 0.0, 31.0, 30.0)

    assert stills(0.0054, 0.00176, 0.00176).lengths == "1 of 10.8 and 2 of 3.52 ms"
    assert stills(0.0054, 0.00176).lengths == "10.8 and 3.52 ms"
    assert stills(0.0054, 0.0054).lengths == "10.8 ms"
    assert SEQUENCE.lengths == "4.2 and 13.6 ms"
    assert a_plane_design().exposures.lengths == "9, 10.3 and 11 ms"
    assert stills(0.6172, 1e-6).lengths == "1,230 and 0.002 ms"


def test_a_camera_that_turns_makes_the_pan_of_an_exposure():
    """The stage makes what is left."""
    one = _one()
    assert Exposures.of_one(one.motion, one.shutter, LIMITS).pan == 0.0
    turning = Limits(max_stroke=40.0, max_half_exposure=0.012, pans="camera")
    assert Exposures.of_one(one.motion, one.shutter, turning).pan == 350.0


A = 8.3e5
PATH = PlaneFrames(
    np.array([-0.011, 0.0, 0.0125]),
    np.array([0.006, 0.0075, 0.009]),
    np.array([0.004, 0.008, 0.0, 0.007, 0.0, 0.012]),
    np.array(
        [
            [-700.0, -400.0, 900.0, 900.0, -100.0, -100.0, 350.0],
            [250.0, 600.0, -500.0, -500.0, 300.0, 300.0, -820.0],
        ]
    ),
)
ON_AXIS = (
    TimedFrame(LinearMotion(half_exposure=0.002, velocity=300.0), -0.011, 4.0),
    TimedFrame(FreeMotion(accelerations=[3e4, -9e4], half_exposure=0.0041), 0.0, 4.4),
    TimedFrame(FreeMotion(accelerations=[5e4], half_exposure=0.003, velocity=-80.0), 0.0112, 0.4),
)
TAKEN = {
    "axis": (Exposures("own", ON_AXIS), Limits(max_acceleration=A)),
    "turning": (Exposures("own", ON_AXIS, pan=140.0), Limits(max_acceleration=A, pans="camera")),
    **{
        axes: (Exposures("own", PATH), Limits(max_acceleration=A, axes=axes))
        for axes in ("each", "disc")
    },
    "turning in the plane": (
        Exposures("own", PATH, pan=(120.0, 0.0)),
        Limits(max_acceleration=A, pans="camera"),
    ),
}


def _sampled(taken, limits):
    """Travel, stroke and top speed of a stage, and its acceleration, by many times of its way."""
    pan = np.atleast_1d(taken.pan)
    if isinstance(taken.path, TimedFrames):
        (path,) = taken.stage_paths_within(limits).values()
        times = np.linspace(path.times[0], path.times[-1], 40_001)
        velocity, lit = path.at(times)[1][None], path.exposure
    else:
        first, last = (taken.path.velocities[:, k] - pan for k in (0, -1))
        size = 2 if limits.axes == "disc" else np.inf
        ups = [np.linalg.norm(x, size) / A for x in (first, last)]
        ends = np.cumsum([0.0, ups[0], *taken.path.durations, ups[1]])
        ends, firsts = np.unique(ends, return_index=True)
        every = np.hstack(
            [np.zeros((2, 1)), taken.path.velocities - pan[:, None], np.zeros((2, 1))]
        )
        # A velocity that jumps is before its jump what `unique` keeps.
        times = np.linspace(0, ends[-1], 40_001)
        velocity = np.array([np.interp(times, ends, row[firsts]) for row in every])
        lit = ups[0], ends[-1] - ups[1]
    if limits.axes == "disc":
        turns = np.linspace(0, np.pi, 64, endpoint=False)
        velocity = np.stack([np.cos(turns), np.sin(turns)], axis=-1) @ velocity
    step = times[1] - times[0]
    place = np.cumsum((velocity[:, 1:] + velocity[:, :-1]) / 2 * step, axis=1)
    within = place[:, (times[1:] >= lit[0]) & (times[1:] <= lit[1])]
    return np.array(
        [
            np.max(np.ptp(place, axis=1)),
            np.max(np.ptp(within, axis=1)),
            np.max(np.abs(velocity)),
            np.max(np.abs(np.diff(velocity))) / step,
        ]
    )


@pytest.mark.parametrize("slug", TAKEN)
def test_the_use_of_a_stage_is_that_of_its_way(slug):
    """Beside a camera that turns it is that of the rest; a disc counts all directions together."""
    taken, limits = TAKEN[slug]
    use = taken.use_within(limits)
    found = np.array([use.travel, use.stroke, use.top_speed, use.acceleration])
    wanted = _sampled(taken, limits)
    # Between sixteen directions a limit holds with a margin.
    margin = 1 / np.cos(np.pi / 32) if limits.axes == "disc" else 1.0
    assert np.all(found >= wanted * (1 - 2e-3))
    assert np.all(found <= wanted * margin * (1 + 2e-3))
    assert taken.with_travel(limits).travel == use.travel
    assert taken.duration == pytest.approx(0.0272 if len(taken.axes) == 1 else 0.031)
    assert PATH.duration == pytest.approx(0.031)


@pytest.mark.parametrize("slug", TAKEN)
def test_a_share_is_that_of_the_limit_that_is_fullest(slug):
    """Each in turn; what a camera turns by counts in the top speed, and not in the acceleration."""
    taken, limits = TAKEN[slug]
    use, turned = taken.use_within(limits), float(np.linalg.norm(taken.pan))
    wanted = {
        "max_stroke": float(use.stroke),
        "max_travel": float(use.travel),
        "max_top_speed": float(use.top_speed) + turned,
    }
    roomy = {"max_stroke": 1e4, "max_travel": 1e4, "max_acceleration": A}
    own = {"pans": limits.pans, "axes": limits.axes}
    least = taken.share_of(Limits(**roomy, **own))  # that of the acceleration
    assert (least == pytest.approx(1.0)) == (len(taken.axes) == 1)
    for name, most in wanted.items():
        given = Limits(**(roomy | {name: most / 1.25}), **own)
        assert taken.share_of(given) == pytest.approx(1.25, rel=1e-6)
    if len(taken.axes) == 2:
        gains = np.diff(PATH.velocities)[:, PATH.durations > 0] / PATH.durations[PATH.durations > 0]
        size = np.linalg.norm(gains, 2 if limits.axes == "disc" else np.inf, axis=0)
        assert least == pytest.approx(np.max(size) / A, rel=1e-9)


@pytest.mark.parametrize("slug", TAKEN)
def test_exposures_in_other_units_ask_for_as_much(slug):
    """Pixels half as wide, and the film run backwards in the plane: the same share of limits."""
    taken, limits = TAKEN[slug]
    pan = np.atleast_1d(taken.pan)
    if isinstance(taken.path, FramePath):
        path = taken.path
        halved = replace(path, velocities=2 * path.velocities)
        back = replace(
            path,
            times=-path.times[::-1],
            exposures=path.exposures[::-1],
            durations=path.durations[::-1],
            velocities=-path.velocities[:, ::-1],
        )
        others = [(halved, 2.0, 2 * pan), (back, 1.0, -pan)]
        swapped = replace(path, velocities=path.velocities[::-1])
        others.append((swapped, 1.0, pan[::-1]))
    else:
        frames = tuple(
            TimedFrame(x.motion.mirrored(2.0), x.time, 2 * x.position) for x in taken.frames
        )
        back = tuple(TimedFrame(x.motion.mirrored(-1), x.time, -x.position) for x in taken.frames)
        others = [(frames, 2.0, 2 * pan), (back, 1.0, -pan)]
    own = np.array(taken.use_within(limits))
    for frames, scale, turned in others:
        given = (*turned.tolist(),) if pan.size == 2 else float(turned[0])
        other = Exposures("own", frames, pan=given)
        scaled = replace(limits, max_acceleration=A * scale)
        np.testing.assert_allclose(np.array(other.use_within(scaled)), scale * own, rtol=1e-6)
        assert other.stroke == pytest.approx(scale * taken.stroke, rel=1e-6)


def test_paths_beside_a_camera_that_turns_are_those_of_the_rest():
    """Of rows that see more, too: within the frames the sensor goes as it went."""
    for slug in ("turning", "turning in the plane"):
        taken, limits = TAKEN[slug]
        whole = taken.path_for_rows(0.003, limits)
        times = np.array([np.linspace(*lights, 9)[1:-1] for lights in taken.lights])
        wanted, found = taken.place(times), whole.place(times)
        apart = found - wanted
        np.testing.assert_allclose(apart - apart[:, :1, :1], 0, atol=1e-6)
        (begin, _), *_, (_, end) = taken.lights
        assert whole.bends[0] <= begin - 0.0015 + 1e-12
        assert whole.bends[-1] >= end + 0.0015 - 1e-12
        # Beyond that it runs up and out, and rests for no longer than the readout.
        assert whole.bends[-1] - whole.bends[0] <= end - begin + 4 * 0.003 + 0.004
        # As far out as rows see, the camera turns on, and the stage keeps its limits.
        tight = replace(limits, max_travel=float(taken.use_within(limits).travel))
        rest = taken.path_for_rows(0.003, tight).beside(np.atleast_1d(taken.pan))
        np.testing.assert_allclose(rest.velocities[:, [0, -1]], 0, atol=1e-9)


def test_frames_beside_a_camera_that_turns_ask_a_stage_for_what_is_beside_it():
    """Travel and stroke in the plane are those of the stage, not of the camera's way."""
    law = EvenVelocities(300.0, mean=(2000.0, 0.0))
    limits = Limits(pans="camera", max_pan=3000.0, max_acceleration=1e6)
    scene = Scene.any_direction(law, photon_rate=1e5, read_noise=2.0, limits=limits)
    velocities = np.array([[200.0, -200.0], [100.0, 100.0]])
    alone = FramePath(np.zeros(1), np.full(1, 0.02), np.full(1, 0.02), velocities)
    turning = replace(alone, velocities=velocities + np.array([[2000.0], [0.0]]))
    found = exposures_in_plane(scene, "sweep", turning, 30.0)
    assert found.pan == (2000.0, 0.0)
    use = alone.use(limits)
    assert found.travel == pytest.approx(float(use.travel), rel=1e-9)
    assert found.lit_travel == pytest.approx(float(use.stroke), rel=1e-9)
    assert found.lit_travel < 4
