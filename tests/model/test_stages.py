"""Stages: run-up and run-out from rest, against the path added up in time."""

from functools import partial

import jax
import numpy as np
import pytest

from mishutter import (
    Exposures,
    FreeMotion,
    Limits,
    LinearMotion,
    ParabolicMotion,
    StillCamera,
    TimedFrame,
    stage_path,
)
from mishutter.model.stages import Knots, run_up, stage_use

CASES = {
    "turns": (4.1e5, 0.01, 700.0, 1.1e6, None),
    "does-not-turn": (3.2e4, 0.013, -2100.0, 2.5e5, None),
    "jerk": (4.1e5, 0.01, 700.0, 1.1e6, 3e8),
    "turns-in-the-ramp": (5e4, 0.01, 1040.0, 1.3e5, 4e7),
    "jerk-alone": (1.3e4, 0.02, 900.0, 3e4, 2e7),
    "pan": (0.0, 0.015, 1300.0, 9e4, 6e6),
}


def _motion(case):
    a, half, v = case[:3]
    return ParabolicMotion(acceleration=a, half_exposure=half, velocity=v)


def _use(most, jerk, *case):
    return stage_use(_motion(case), most, jerk)


def _driven(path, num_steps=200_000):
    """Positions and velocities by adding up the accelerations of a path; times `(n,)`."""
    times = np.linspace(path.times[0], path.times[-1], num_steps + 1)
    middle = (times[1:] + times[:-1]) / 2
    piece = np.searchsorted(path.times, middle, side="right") - 1
    pulled = path.accelerations[piece] + path.jerks[piece] * (middle - path.times[piece])
    step = times[1] - times[0]
    velocity = np.concatenate([[0.0], np.cumsum(pulled) * step])
    travelled = np.cumsum((velocity[1:] + velocity[:-1]) / 2) * step
    return times, np.concatenate([[0.0], travelled]), velocity, pulled


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_travel_and_top_speed_are_those_of_the_path(case):
    """The closed forms are the range and the greatest speed of a path that is added up in time."""
    path = stage_path(_motion(case), max_acceleration=case[3], max_jerk=case[4])
    times, position, velocity, pulled = _driven(path)
    found = path.at(times)
    np.testing.assert_allclose(found[0] - found[0][0], position, atol=1e-4 * np.ptp(position))
    np.testing.assert_allclose(found[1], velocity, atol=1e-3 * np.max(np.abs(velocity)))
    middles = (times[1:] + times[:-1]) / 2
    np.testing.assert_allclose(path.acceleration_at(middles), pulled, rtol=1e-12)
    assert not path.acceleration_at(path.times[[0, -1]] + np.array([-1.0, 0.0])).any()
    use = stage_use(_motion(case), *case[3:])
    assert float(use.travel) == pytest.approx(np.ptp(position), rel=1e-4)
    assert float(use.top_speed) == pytest.approx(np.abs(velocity).max(), rel=1e-4)
    assert abs(velocity[-1]) < 1e-4 * np.abs(velocity).max()
    assert path.travel == pytest.approx(float(use.travel), rel=1e-12)
    assert np.abs(pulled).max() <= case[3] * (1 + 1e-9)
    if case[4] is not None:
        jumps = np.abs(np.diff(pulled)) / np.diff(path.times[[0, -1]]) * pulled.size
        assert jumps.max() <= case[4] * (1 + 1e-6)


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_the_exposure_is_the_parabola(case):
    """In the exposure the stage is at v t + a t^2, and before and after everything at rest."""
    a, half, v = case[:3]
    path = stage_path(_motion(case), max_acceleration=case[3], max_jerk=case[4])
    times = np.linspace(-1, 1, 13) * half
    position, velocity = path.at(times)
    np.testing.assert_allclose(position, v * times + a * times**2, atol=1e-10 * path.travel)
    np.testing.assert_allclose(
        velocity, v + 2 * a * times, atol=1e-9 * float(abs(v) + 2 * a * half)
    )
    outside = np.array([path.times[0] - 1.0, path.times[-1] + 1.0])
    np.testing.assert_allclose(path.at(outside)[0], path.positions[[0, -1]], rtol=1e-14)
    assert not path.at(outside)[1].any()


def test_a_run_up_at_the_same_acceleration_doubles_the_travel():
    """A stroke of 45 px takes 90 px from rest to rest."""
    assert float(stage_use(_motion((4.5e5, 0.01, 0.0)), 9e5).travel) == pytest.approx(90, rel=1e-14)


def test_a_still_camera_has_a_stage_at_rest():
    """It travels nowhere."""
    path = stage_path(StillCamera(half_exposure=0.02), max_acceleration=1.0, max_jerk=1.0)
    assert path.travel == 0
    assert path.exposure == (-0.02, 0.02)


def test_more_motion_never_takes_less():
    """Travel and top speed rise with acceleration, exposure and velocity, as bounds rely on."""
    rising = np.linspace(0, 1, 301)
    for most, jerk in ((1e6, None), (1e6, 3e8), (None, None), (None, 1e8)):
        for numbers in (
            (5e5 * rising, 0.01, 1500.0),
            (2e5, 1e-4 + 0.02 * rising, 1500.0),
            (2e5, 0.01, 2e4 * rising),
        ):
            use = jax.vmap(partial(_use, most, jerk))(*np.broadcast_arrays(*numbers))
            for values in map(np.asarray, (use.travel, use.stroke, use.top_speed)):
                assert np.all(np.diff(values) >= -1e-12 * values.max())


def test_a_free_path_of_a_parabola_uses_a_stage_as_the_parabola_does():
    """Travel from rest to rest, panned or not, with an acceleration of the run-up and without."""
    for velocity in (0.0, 300.0, -4000.0):
        parabola = ParabolicMotion(acceleration=2e5, half_exposure=0.007, velocity=velocity)
        path = FreeMotion.fit(parabola, num_pieces=5)
        for most in (None, 5e5):
            limits = Limits(max_travel=90.0, max_acceleration=most)
            wanted = float(limits.stage_share_of(parabola))
            assert float(limits.stage_share_of(path)) == pytest.approx(wanted, rel=1e-12)


def test_travel_of_a_path_is_that_of_its_steps():
    """Run-up, exposure and run-out, stepped through in time, span what is told."""
    path = FreeMotion(accelerations=[3e5, -1e5, 2e5, 5e4], half_exposure=0.004, velocity=250.0)
    most = 8e5
    times = np.linspace(-0.004, 0.004, 200_001)
    x, u = np.asarray(path.position(times)), np.asarray(path.velocity_at(times))
    before = x[0] - np.sign(u[0]) * u[0] ** 2 / (2 * most)
    after = x[-1] + np.sign(u[-1]) * u[-1] ** 2 / (2 * most)
    wanted = max(*x, before, after) - min(*x, before, after)
    use = stage_use(path, most)
    assert stage_path(path, max_acceleration=most).travel == pytest.approx(wanted, rel=1e-9)
    assert float(use.travel) == pytest.approx(wanted, rel=1e-9)
    assert float(use.top_speed) == pytest.approx(np.max(np.abs(u)), rel=1e-12)


@pytest.mark.parametrize(
    ("arguments", "requirement"),
    [
        ({"max_acceleration": 1e5}, "be at least the 820000 px/s\\^2 of the exposure; got 100000"),
        ({"max_acceleration": -1.0}, "be above 0"),
        ({"max_acceleration": 1e6, "max_jerk": 0.0}, "be above 0"),
        ({}, "be given where the jerk is not limited; got None"),
    ],
)
def test_a_stage_that_cannot(arguments, requirement):
    """One line says which limit is none, or is exceeded."""
    with pytest.raises(ValueError, match=requirement):
        stage_path(_motion(CASES["turns"]), **arguments)


@pytest.mark.slow
def test_the_fullest_motion_is_within_the_stage():
    """Its share of travel is at most 1, and a stage that limits nothing leaves it as it is."""
    given = {"max_stroke": 45.0, "max_top_speed": 2e4, "max_half_exposure": 0.04}
    for pan in (0.0, 900.0):
        limits = Limits(**given, max_travel=38.0, max_acceleration=1.1e6, max_jerk=5e9)
        motion = limits.fullest_motion(pan)
        numbers = motion.acceleration, motion.half_exposure, motion.velocity
        assert 0.5 < float(limits.stage_share(*numbers)) <= 1 + 1e-9
    roomy = Limits(**given, max_travel=1e9).fullest_motion(900.0)
    assert float(roomy.stroke) == pytest.approx(float(Limits(**given).fullest_motion(900.0).stroke))


@pytest.mark.parametrize("velocity", [0.0, 430.0])
def test_a_stage_of_limited_jerk_alone_keeps_its_travel(velocity):
    """The path that is written travels what the limits count, and its acceleration is free."""
    limits = Limits(max_stroke=21.0, max_top_speed=5e3, max_travel=12.0, max_jerk=3e8)
    motion = limits.fullest_motion(velocity)
    path = limits.stage_path(motion)
    share = float(limits.stage_share_of(motion))
    assert share == pytest.approx(1, rel=1e-9)
    _, position, reached, pulled = _driven(path)
    assert np.ptp(position) <= 12.0 * (1 + 1e-6)
    assert np.abs(reached).max() <= 5e3 * (1 + 1e-6)
    assert np.abs(pulled).max() > float(motion.greatest_acceleration)
    pan = LinearMotion(half_exposure=0.005, velocity=400.0)
    use = stage_use(pan, None, 3e8)
    assert limits.stage_path(pan).travel == pytest.approx(float(use.travel), rel=1e-9)


@pytest.mark.parametrize("name", ["max_travel", "max_acceleration", "max_jerk"])
def test_limits_of_nothing(name):
    """They are above 0."""
    with pytest.raises(ValueError, match=rf"`Limits\({name}=...\)` must be above 0"):
        Limits(**{name: 0.0})


def burst(*frames, pan=0.0):
    """Frames of a stage, of times, places and motions."""
    return Exposures("own", tuple(TimedFrame(m, t, x) for t, x, m in frames), 0.0, 0.0, 0.0, pan)


def swing(direction, half=0.006, acceleration=3e5):
    return FreeMotion(accelerations=[direction * acceleration], half_exposure=half)


BURSTS = {
    "swings": burst((-0.008, 0.0, swing(1)), (0.008, 2 * 3e5 * 0.006 * 0.01, swing(-1))),
    "sweep": burst(
        *((t, 2e5 * t * t, swing(1, acceleration=2e5).panned(4e5 * t)) for t in (-0.02, 0.0, 0.02))
    ),
    "fan": burst(
        (-0.01, 3.0, LinearMotion(half_exposure=0.004, velocity=-900.0)),
        (0.01, 3.5, LinearMotion(half_exposure=0.004, velocity=900.0)),
    ),
    "one at rest": burst((-0.01, 0.0, StillCamera(half_exposure=0.003)), (0.01, -20.0, swing(1))),
}


@pytest.mark.parametrize("pan", [0.0, 1700.0], ids=["stage", "camera turns"])
@pytest.mark.parametrize("name", BURSTS)
def test_a_path_leads_through_all_frames(name, pan):
    """Within each it is the frame's own, less the pan of a camera; its velocity never jumps."""
    most = 1.2e6
    frames = [
        (one.time, one.position + pan * one.time, one.motion.panned(one.motion.velocity + pan))
        for one in BURSTS[name].frames
    ]
    path = burst(*frames, pan=pan).stage_paths_within(Limits(max_acceleration=most)).get("")
    for one in BURSTS[name].frames:
        elapsed = np.linspace(-0.999, 0.999, 9) * float(one.motion.half_exposure)
        place, velocity = path.at(one.time + elapsed)
        np.testing.assert_allclose(place, one.position + one.motion.position(elapsed), atol=2e-5)
        np.testing.assert_allclose(velocity, one.motion.velocity_at(elapsed), atol=2e-2)
    times = np.linspace(path.times[0], path.times[-1], 20_001)
    place, velocity = path.at(times)
    steps = np.abs(np.diff(velocity)) / np.diff(times)
    # The first and the last frame's run-ups take all that is allowed.
    assert steps.max() == pytest.approx(most, rel=2e-3)
    np.testing.assert_allclose(np.gradient(place, times)[1:-1], velocity[1:-1], atol=1.5)
    assert velocity[0] == velocity[-1] == 0


def test_between_frames_a_stage_takes_the_least_acceleration():
    """Swings that meet at one velocity need none, and a sweep goes on along its parabola."""
    swings = BURSTS["swings"].stage_paths_within(Limits()).get("")
    between = (swings.times[:-1] >= -0.002 - 1e-9) & (swings.times[:-1] < 0.002 - 1e-9)
    np.testing.assert_allclose(swings.accelerations[between], 0.0, atol=1e-3)
    sweep = BURSTS["sweep"].stage_paths_within(Limits()).get("")
    np.testing.assert_allclose(np.abs(sweep.accelerations), 4e5, rtol=1e-5)


@pytest.mark.parametrize("velocity", [900.0, -900.0])
def test_a_stage_of_any_acceleration_stays_where_its_frames_are(velocity):
    """After a way of 7.2 px it turns round at once, for a slower one in the same direction."""
    first, second = (
        LinearMotion(half_exposure=0.004, velocity=v) for v in (velocity, velocity / 3)
    )
    path = burst((-0.01, 0.0, first), (0.01, 0.0, second)).stage_paths_within(Limits()).get("")
    place = path.at(np.linspace(-0.014, 0.014, 2001))[0]
    assert place.min() == pytest.approx(-3.6, abs=0.02)
    assert place.max() == pytest.approx(3.6, abs=0.02)


def test_a_path_without_a_limit_ends_where_it_is_told():
    """From rest between two frames, and to a velocity that it keeps, nothing says how fast."""
    still, moving = (
        StillCamera(half_exposure=0.003),
        LinearMotion(half_exposure=0.003, velocity=80.0),
    )
    at_rest = burst((-0.01, 1.0, still), (0.01, 1.0, still))
    steady = burst((-0.01, -0.8, moving), (0.01, 0.8, moving))
    assert BURSTS["one at rest"].stage_paths_within(Limits()).get("") is None
    assert steady.stage_paths_within(Limits()).get("") is None
    assert (
        at_rest.stage_paths_within(Limits()).get("")
        is at_rest.stage_paths_within(Limits(max_acceleration=9e5)).get("")
        is None
    )
    limits = Limits(max_acceleration=9e5, max_travel=2.0)
    path = steady.stage_paths_within(limits).get("")
    assert path.travel == pytest.approx(80 * 0.026 + 80**2 / 9e5, rel=1e-4)
    assert limits.travel_beyond(path) == path.travel
    assert Limits(max_acceleration=9e5, max_travel=2.2).travel_beyond(path) is None


def _sampled(path):
    """Range of the whole way and of that from the first light to the last, and the top speed."""
    times = np.linspace(path.times[0], path.times[-1], 400_001)
    place, velocity = path.at(times)
    lit = place[(times >= path.exposure[0]) & (times <= path.exposure[1])]
    return np.ptp(place), np.ptp(lit), np.max(np.abs(velocity))


@pytest.mark.parametrize("jerk", [None, 9e7], ids=["any jerk", "jerk"])
@pytest.mark.parametrize("name", BURSTS)
def test_a_burst_asks_of_its_stage_what_its_path_does(name, jerk):
    """Travel, stroke and top speed are those of the path at many times, run-ups included."""
    path = BURSTS[name].stage_paths_within(Limits(max_acceleration=1.2e6, max_jerk=jerk)).get("")
    use = path.use
    np.testing.assert_allclose((use.travel, use.stroke, use.top_speed), _sampled(path), rtol=1e-4)
    assert use.acceleration == pytest.approx(np.max(np.abs(path.accelerations)), rel=1e-9)


def test_a_stage_that_runs_up_between_frames_takes_its_way_in_the_burst():
    """From a frame at rest, u^2/2A before the first that moves, to the far end of that."""
    acceleration, speed, half = 2.4e5, 1800.0, 0.006
    moving = ParabolicMotion(acceleration=speed / 2 / half, half_exposure=half)
    run_up = speed**2 / 2 / acceleration
    at_rest = float(moving.stroke) + run_up
    frames = burst(
        (-0.013, at_rest, StillCamera(half_exposure=0.0004)),
        (0.009, 0.0, moving.panned(0.0)),
    )
    use = frames.stage_paths_within(Limits(max_acceleration=acceleration)).get("").use
    assert float(use.stroke) == pytest.approx(at_rest, rel=1e-9)
    assert frames.stroke == pytest.approx(at_rest, rel=1e-9)
    assert float(use.acceleration) == pytest.approx(speed / half, rel=1e-9)


def test_a_run_up_of_limited_jerk_leads_to_a_burst():
    """Out of a frame at rest, and to the acceleration with which the next frame begins."""
    acceleration, jerk, half = 3.1e5, 6e8, 0.004
    own = 1.7e5
    within = Knots.of(0.0, run_up(-own * half, own, acceleration, jerk))
    duration, way = float(np.sum(within.durations)), float(within.positions[-1])
    motion = ParabolicMotion(acceleration=own / 2, half_exposure=half)
    place = way - float(motion.position(half))
    frames = burst(
        (-duration - 0.001, 0.0, StillCamera(half_exposure=0.0005)), (half, place, motion)
    )
    path = frames.stage_paths_within(Limits(max_acceleration=acceleration, max_jerk=jerk)).get("")
    assert float(path.use.jerk) == pytest.approx(jerk, rel=1e-9)
    ends = path.accelerations + path.jerks * np.diff(path.times)
    # No acceleration jumps, from rest to rest.
    np.testing.assert_allclose(path.accelerations[1:], ends[:-1], atol=1e-5 * acceleration)
    assert float(path.use.acceleration) <= acceleration * (1 + 1e-9)


@pytest.mark.parametrize("velocity", [0.0, 700.0], ids=["swings", "pans"])
def test_a_limit_of_the_jerk_alone_says_how_a_stage_gets_to_frames(velocity):
    """As it does of one exposure: no acceleration is limited where no limit says one."""
    limits, half = Limits(max_jerk=7e8), 0.006
    motion = LinearMotion(half_exposure=half, velocity=velocity) if velocity else swing(1)
    (path,) = burst((0.0, 0.0, motion)).stage_paths_within(limits).values()
    wanted = limits.stage_path(motion)
    for one, other in zip(path[:-1], wanted[:-1], strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-15)


def test_a_pan_over_frames_is_reached_at_a_limit_of_the_jerk_alone():
    """In the time of two ramps of the acceleration, up to the root of speed times jerk."""
    moving = LinearMotion(half_exposure=0.006, velocity=700.0)
    frames = burst((-0.01, -7.0, moving), (0.01, 7.0, moving))
    (path,) = frames.stage_paths_within(Limits(max_jerk=7e8)).values()
    assert float(path.use.acceleration) == pytest.approx(np.sqrt(700 * 7e8), rel=1e-9)
    assert path.exposure[0] - path.times[0] == pytest.approx(2 * np.sqrt(700 / 7e8), rel=1e-9)


def test_a_velocity_that_jumps_has_no_path():
    """Frames at two velocities that touch: no limit says how, and no stage can."""
    first, second = (LinearMotion(half_exposure=0.004, velocity=v) for v in (-300.0, 500.0))
    touching = burst((-0.004, 0.0, first), (0.004, 0.8, second))
    assert touching.stage_paths_within(Limits()).get("") is None
    assert touching.stroke == pytest.approx(4.0)


def test_a_short_piece_counts_beside_many_other_ways():
    """A piece of 0.5 % in each of 2000 ways is none of rounding, in single precision too."""
    durations = np.tile(np.array([0.01, 5e-5, 0.01], np.float32), (2000, 1))
    velocities = np.tile(np.array([0.0, 10.0, 40.0, 20.0], np.float32), (2000, 1))
    use = Knots(durations, velocities, None, 0, 3).use
    np.testing.assert_allclose(use.acceleration, 30 / 5e-5, rtol=1e-5)
    np.testing.assert_allclose(use.travel, 0.05 + 0.00125 + 0.3, rtol=1e-5)
