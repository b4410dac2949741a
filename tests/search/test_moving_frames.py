"""The search for frames of a sensor that moves along an axis: its level, limits and answers."""

import itertools
from dataclasses import replace

import equinox as eqx
import numpy as np
import pytest

from mishutter import (
    BurstMode,
    Exposures,
    FreeMotion,
    Limits,
    ParabolicMotion,
    Scene,
    Sensor,
    Texture,
    TimedFrame,
    exposures_psnr,
)
from mishutter.evaluation.bursts import FrameTimes, best_still_burst
from mishutter.evaluation.registration import loss_of_width
from mishutter.model.frame_path import SINE
from mishutter.model.stages import Knots, extent, transfer
from mishutter.search.frame_levels import Frames, Levels, Shape, chirps
from mishutter.search.frame_limits import Room
from mishutter.search.frame_ties import ALTERNATING, FOLLOW, FREE, PAN, SWEEP, SWINGS, Tie
from mishutter.search.frame_words import kind_of
from mishutter.search.moving_frames import best_moving_burst, levels_of, sequence_of

SIMPLER = 0.05 + 0.005
"""Decibels that simpler frames may be below the best, and those of the search."""
BOTH_WAYS = np.linspace(-4500.0, 4500.0, 9)
WINDOW = 0.08
FAR = {"min_half_exposure": 1e-4, "max_half_exposure": WINDOW / 2}


def _in_window(speeds, num_frames, *, rate=None, dead_time=0.0, weights=None, sensor=None, **given):
    """The camera of a window of 80 ms that takes some frames, without a gap but for its rate."""
    limits = Limits(**({"max_stroke": 60.0} | FAR | given))
    rate = num_frames / WINDOW if rate is None else rate
    frames = {"max_frames": num_frames, "window": WINDOW, "dead_time": dead_time}
    burst = BurstMode(frames_per_s=rate, **frames)
    scene = Scene(speeds, weights, photon_rate=1e5, read_noise=8.0, limits=limits, burst=burst)
    if sensor is None:
        return scene
    return eqx.tree_at(lambda x: x.sensor, scene, sensor, is_leaf=lambda x: x is None)


def _belt():
    """Things on a belt at 4,560 to 5,040 px/s, over a stage that flies back between 5 frames."""
    limits = Limits(
        max_stroke=1e4,
        max_travel=87.0,
        max_top_speed=11594.0,
        max_acceleration=4.26e6,
        min_half_exposure=1e-4,
        max_half_exposure=5 / 120,
    )
    return Scene(
        np.linspace(4560.0, 5040.0, 9),
        photon_rate=1.8e5,
        read_noise=2.0,
        limits=limits,
        burst=BurstMode(frames_per_s=60.0, max_frames=5),
    )


@pytest.fixture(scope="module")
def belt():
    return best_moving_burst(_belt())


@pytest.fixture(scope="module")
def roomy():
    """Four frames of things that move both ways, over a stage that only its stroke limits."""
    return best_moving_burst(_in_window(BOTH_WAYS, 4, max_stroke=120.0))


@pytest.fixture(scope="module")
def pair():
    """Two frames of a camera of 240 frames a second, of things that all move one way."""

    def found(sign, pans):
        given = {"max_stroke": 45.0, "max_top_speed": 2e4, "max_half_exposure": 0.02}
        limits = Limits(max_pan=900.0, pans=pans, **given)
        burst = BurstMode(frames_per_s=240.0, max_frames=2)
        speeds = sign * np.array([610.0, 790.0])
        return best_moving_burst(
            Scene(speeds, photon_rate=1e5, read_noise=8.0, limits=limits, burst=burst)
        )

    return {key: found(*key) for key in itertools.product((1, -1), ("stage", "camera"))}


def _shares(limits, burst):
    """Shares of the limits that the exported path takes, by its places at many times."""
    path = burst.stage_paths_within(limits).get("")
    times = np.linspace(path.times[0], path.times[-1], 100_001)
    place, velocity = path.at(times)
    lit = place[(times >= path.exposure[0]) & (times <= path.exposure[1])]
    knots = np.append(path.at(path.times)[1], velocity)
    taken = {
        "max_travel": np.ptp(place),
        "max_stroke": np.ptp(lit),
        "max_top_speed": np.max(np.abs(knots)) + abs(burst.pan),
        "max_acceleration": np.max(np.abs(path.accelerations)),
    }
    there = {name: getattr(limits, name) for name in taken}
    return {name: taken[name] / float(most) for name, most in there.items() if most is not None}


def _frames(count, pieces, seed):
    """Frames of any velocities, that have nothing to do with one another."""
    draw = np.random.default_rng(seed)
    velocity = draw.normal(2000.0, 1500.0, (count, pieces + 1, 1))
    velocity[0] = velocity[0, :1]  # one of constant velocity
    exposure, none = draw.uniform(2e-3, 2e-2, count), np.zeros((count, 1))
    return Frames(exposure, velocity, exposure[1:], none, np.zeros(1))


# ---- the level --------------------------------------------------------------------------------


@pytest.mark.parametrize("b", [-31.0, -1.7, 0.0, 4e-3, 0.9, 12.0])
@pytest.mark.parametrize("c", [-8.0, -0.02, 0.0, 1e-5, 2.9e-3, 3.1e-3, 0.029, 0.031, 1.3, 40.0])
def test_waves_of_constant_acceleration_are_their_integrals(b, c):
    """And the moments that their slopes follow from, near constant velocity and rest as well."""
    x, weight = np.polynomial.legendre.leggauss(400)
    found = chirps(np.array([b]), np.array([c]))
    wave = weight / 2 * np.exp(-1j * (b * x + c * x * x))
    wanted = [np.sum(wave * x**k) for k in range(3)]
    np.testing.assert_allclose(np.ravel(found), wanted, atol=1e-4)
    assert abs(found[0][0] - wanted[0]) < 5e-6


@pytest.mark.parametrize("pieces", [1, 3])
def test_errors_are_those_of_quadrature(pieces):
    """Of each speed at each frequency, by nodes in each piece of each frame."""
    scene, frames = (
        _in_window([-900.0, 300.0, 4000.0], 3, weights=[0.6, 0.3, 0.1]),
        _frames(3, pieces, 5),
    )
    levels, gained = Levels.on_axis(scene), 0.0
    x, weight = np.polynomial.legendre.leggauss(120)
    speeds = levels.temporal[-1] / levels.frequency[-1]
    for length, velocity in zip(frames.exposure, frames.velocity[..., 0], strict=True):
        step, place, whole = length / pieces, 0.0, 0.0
        for k, (v, u) in enumerate(itertools.pairwise(velocity)):
            t = step * (x + 1) / 2
            way = place + v * t + (u - v) / step * t**2 / 2
            way = way[:, None] - (k * step + t)[:, None] * speeds
            waves = np.exp(-2j * np.pi * levels.frequency[:, None] * way)
            whole = whole + np.tensordot(weight / 2 / pieces, waves, (0, 1))
            place += step * (v + u) / 2
        electrons = 1e5 * length
        gained = gained + np.abs(whole) ** 2 * electrons**2 / (0.25 * electrons + 64.0)
    wanted = levels.weight / (1 + levels.signal[:, None] * gained)
    np.testing.assert_allclose(levels.errors(frames), wanted, rtol=1e-3, atol=1e-9)
    assert levels.level(frames) == pytest.approx(-10 * np.log10(np.sum(wanted)), abs=1e-4)


@pytest.mark.parametrize("pieces", [1, 3])
def test_slopes_are_those_of_differences(pieces):
    """By each exposure and each velocity."""
    levels, frames = Levels.on_axis(_in_window(BOTH_WAYS, 3)), _frames(3, pieces, 7)
    value, by_exposure, by_velocity = levels.slope(frames)
    assert value == pytest.approx(-levels.level(frames))

    def differences(name, step):
        own = getattr(frames, name)
        slope = np.zeros(own.shape)
        for index in np.ndindex(own.shape):
            ends = []
            for sign in (1, -1):
                moved = own.copy()
                moved[index] += sign * step
                ends.append(-levels.level(frames._replace(**{name: moved})))
            slope[index] = (ends[0] - ends[1]) / (2 * step)
        return slope

    for name, slope, step in (("exposure", by_exposure, 1e-7), ("velocity", by_velocity, 0.05)):
        wanted = differences(name, step)
        np.testing.assert_allclose(slope, wanted, atol=2e-4 * np.max(np.abs(wanted)))


def test_a_range_is_no_list():
    """Speeds in equal steps stand for all between them; a level that is told takes them as given.

    Frames that follow nine speeds of a belt one by one would gain nothing by those in between.
    """
    wide, listed = (Levels.on_axis(_belt(), literal=x) for x in (False, True))
    speeds = wide.temporal / wide.frequency
    assert np.unique(np.round(speeds, 3)).size > 500
    assert np.unique(np.round(listed.temporal / listed.frequency, 3)).size == 9
    few = Levels.on_axis(_in_window([100.0, 300.0, 4000.0], 4))
    assert np.unique(np.round(few.temporal / few.frequency, 3)).size == 3


# ---- the limits -------------------------------------------------------------------------------


def _room(**given):
    scene = _in_window(BOTH_WAYS, 4, **given)
    return Room.of(scene.limits, FrameTimes.of(scene, scene.burst), 4500.0)


@pytest.mark.parametrize("seed", range(6))
def test_ways_between_frames_are_the_transfers_that_there_are(seed):
    """From the least way to the greatest; each keeps its way, time, top speed and acceleration."""
    draw = np.random.default_rng(seed)
    most, top = 3e5, 2500.0
    room = _room(max_acceleration=most, max_top_speed=top, max_stroke=1e3)
    rate, fastest = room.acceleration, room.top_speed
    start, end = draw.uniform(-fastest, fastest, 2)
    gap = abs(end - start) / rate * (1.05 + 3 * draw.uniform())
    ends = room.reach(*(np.array([x]) for x in (start, end, gap)))
    least, greatest = (float(x[0]) for x in ends)
    assert least < greatest
    for share in (1e-6, 0.02, 0.3, 0.5, 0.8, 1 - 1e-6):
        way = least + share * (greatest - least)
        knots = Knots.of(start, transfer(way, gap, start, end, acceleration=most, top_speed=top))
        assert float(np.sum(knots.durations)) == pytest.approx(gap)
        assert float(knots.positions[-1]) == pytest.approx(way, abs=1e-6)
        assert float(knots.velocities[-1]) == pytest.approx(end)
        assert np.max(np.abs(knots.velocities)) <= top * (1 + 1e-6)
        lasting = knots.durations > 1e-12
        steep = np.abs(np.diff(knots.velocities))[lasting] / knots.durations[lasting]
        assert np.max(steep) <= most * (1 + 1e-6)
    # Beyond either end no acceleration within the limit leads there.
    for way in (least - 0.5, greatest + 0.5):
        knots = Knots.of(start, transfer(way, gap, start, end, acceleration=rate))
        lasting = knots.durations > 1e-12
        steep = np.abs(np.diff(knots.velocities))[lasting] / knots.durations[lasting]
        assert max(np.max(steep) / rate, np.max(np.abs(knots.velocities)) / fastest) > 1


def test_a_transfer_stays_within_a_span_where_it_can():
    """At a greater acceleration than it needs, up to the greatest."""
    way, gap, start, end = -20.0, 0.02, 2000.0, 2000.0
    gentle = Knots.of(start, transfer(way, gap, start, end))
    low, high = extent(gentle)
    steep = Knots.of(start, transfer(way, gap, start, end, acceleration=4e6, span=(low, high / 2)))
    assert extent(steep)[1] <= high / 2 * (1 + 1e-6)
    assert float(steep.positions[-1]) == pytest.approx(way)


def _at_random(room, shape, draw):
    """Frames at random, of which some keep the limits and others do not."""
    count, pieces, _ = shape
    exposure, gap = draw.uniform(1e-3, 4e-3, count), draw.uniform(0.018, 0.022, count - 1)
    velocity = draw.uniform(-1, 1, (count, pieces + 1, 1)) * draw.uniform(100.0, 2500.0)
    place = room.stroke * (0.5 + draw.uniform(-0.4, 0.4, (count, 1)))
    return Frames(exposure, velocity, gap, place, np.zeros(1))


@pytest.mark.parametrize("given", [{"max_travel": 52.0}, {"max_travel": 90.0}, {}])
def test_slack_is_what_the_exported_path_leaves(given):
    """Where no number is below 0 the path from rest to rest keeps all limits."""
    room = _room(max_acceleration=8e5, max_top_speed=3000.0, max_pan=3000.0, **given)
    limits = _in_window(
        BOTH_WAYS, 4, max_acceleration=8e5, max_top_speed=3000.0, max_pan=3000.0, **given
    ).limits
    shape, draw, kept = Shape(3, 1, 1), np.random.default_rng(3), []
    for _ in range(120):
        frames = _at_random(room, shape, draw)
        slack = room.slack(room.joined(frames), shape)
        shares = _shares(limits, sequence_of(frames, FREE))
        kept.append(np.min(slack) >= 0)
        if kept[-1]:
            assert max(shares.values()) <= 1 + 1e-4
    assert 10 < np.sum(kept) < 110


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("moving", [0, 1])
def test_a_stage_turns_round_beyond_a_frame_that_it_leaves_or_meets(moving, sign):
    """At 2000 px/s and 8e5 px/s^2 it takes 2.5 px, on the side that it goes to or comes from."""
    room = _room(max_acceleration=8e5, max_top_speed=3000.0, max_travel=60.0)
    for aside, fits in ((2.6, True), (2.4, False)):
        velocity, place = np.zeros((2, 2, 1)), np.full((2, 1), 30.0)
        velocity[moving] = sign * 2000.0
        # It leaves the first frame outwards, and meets the second from outside.
        from_end = aside + (4.0 if moving == 0 else 0.0)
        goes_up = (sign > 0) == (moving == 0)
        place[moving] = 60.0 - from_end if goes_up else from_end
        frames = Frames(np.full(2, 2e-3), velocity, np.array([0.02]), place, np.zeros(1))
        slack = room.slack(room.joined(frames), Shape(2, 1, 1))
        assert (np.min(slack) >= 0) == fits


@pytest.mark.parametrize("sign", [1, -1])
def test_a_stage_beside_a_camera_that_turns_has_what_is_left_of_the_top_speed(sign):
    """Of 3000 px/s, the camera's 500 less, as the sensor sees both at once."""
    room = _room(max_acceleration=8e5, max_top_speed=3000.0, max_pan=900.0, pans="camera")
    for speed, fits in ((2490.0, True), (2510.0, False)):
        velocity = np.full((1, 2, 1), sign * speed + 500.0)
        place = np.array([[30.0 - sign * speed * 5e-4]])
        frames = Frames(np.array([1e-3]), velocity, np.zeros(0), place, np.array([500.0]))
        slack = room.slack(room.joined(frames), Shape(1, 1, 1))
        assert (np.min(slack) >= 0) == fits


@pytest.mark.slow
@pytest.mark.parametrize(
    "given",
    [{"max_acceleration": 1.5e5}, {"max_travel": 31.0}, {"max_top_speed": 3000.0}, {}],
)
def test_limits_hold_over_the_whole_burst(given):
    """From rest to rest, flights back and run-up included; one of them binds."""
    limits = {"max_stroke": 37.0, "max_acceleration": 3e6} | given
    scene = _in_window(BOTH_WAYS, 4, **limits)
    burst = best_moving_burst(scene)
    shares = _shares(scene.limits, burst)
    assert max(shares.values()) == pytest.approx(1, abs=0.02)
    assert max(shares.values()) <= 1 + 1e-4
    assert burst.psnr > best_still_burst(scene).psnr


@pytest.mark.slow
def test_nothing_limits_the_acceleration():
    """A stage that has any velocity at once keeps its stroke, and moves within it."""
    scene = _in_window(BOTH_WAYS, 4, max_stroke=37.0)
    burst = best_moving_burst(scene)
    assert burst.psnr >= 31.02 - SIMPLER
    # It turns round beyond its frames, in a time that is not 0: 0.2 % are left for that.
    stroke = float(burst.use_within(scene.limits).stroke)
    assert stroke == pytest.approx(37, rel=4e-3)
    assert stroke <= 37


@pytest.mark.slow
def test_a_limit_on_the_jerk_holds_over_a_burst():
    """Only ways whose acceleration does not jump between frames remain: pans, sweeps and sines."""
    jerk = 4e7
    scene = _in_window(BOTH_WAYS, 4, max_acceleration=6e5, max_jerk=jerk)
    found = best_moving_burst(scene)
    path = found.stage_paths_within(scene.limits).get("")
    assert found.kind in (SWEEP, "sine")
    assert float(path.use.jerk) <= jerk * (1 + 1e-6)
    assert path.jerks.any()
    assert float(path.use.stroke) <= 60.0 * (1 + 1e-6)
    assert found.psnr > best_still_burst(scene).psnr + 0.5


@pytest.mark.parametrize(
    ("exposure", "mean", "pan"), [(0.02, 0.0, 0.0), (0.012, 0.0, 0.0), (0.017, 400.0, 400.0)]
)
@pytest.mark.parametrize("lead", [0.0, 0.004])
def test_the_path_of_a_sine_keeps_the_limit_on_the_jerk(exposure, mean, pan, lead):
    """As `stage.csv` has it, sampled from rest to rest, through the places of all frames."""
    number, period, top = 5, 0.02, 2500.0
    share = np.linspace(-0.5, 0.5, 9)
    beside = top * np.sin(np.pi / period * exposure * share)
    velocity = (mean + (-1.0) ** np.arange(number)[:, None] * beside)[..., None]
    gap = np.full(number - 1, period - exposure)
    each = np.full(number, exposure), velocity, gap, 0 * velocity[:, 0], np.array([pan])
    found = sequence_of(Frames(*each), SINE)
    jerk, acceleration = top * (np.pi / period) ** 2, 1.1 * top * np.pi / period
    limits = Limits(max_stroke=100.0, max_acceleration=acceleration, max_jerk=jerk)
    along = replace(found.along, lead=lead).beside(np.array([pan]))
    (path,) = along.stage_paths(limits)
    times = np.arange(path.times[0] - 1e-3, path.times[-1] + 1e-3, 2e-5)
    places, velocities = path.at(times)
    rates = np.diff(velocities) / 2e-5
    assert velocities[0] == velocities[-1] == 0
    assert np.max(abs(velocities)) <= top * (1 + 1e-3)
    assert np.max(abs(rates)) <= acceleration * (1 + 1e-6)
    assert np.max(abs(np.diff(rates))) / 2e-5 <= jerk * (1 + 1e-4)
    assert np.max(abs(np.diff(places, 3))) / 2e-5**3 <= jerk * (1 + 1e-3)
    # Between the meeting points of its pieces a frame is off by a cube of their length.
    lit = along.times[:, None] + along.exposures[:, None] * np.linspace(-0.5, 0.5, 99)
    assert np.ptp(path.at(lit)[0] - along.place(lit)[0]) < 0.02


@pytest.mark.slow
def test_moving_frames_have_the_times_of_still_ones():
    """Window and dead time are of the camera, whatever its sensor does in a frame."""
    limits = Limits(max_stroke=45.0, max_top_speed=2e4, max_half_exposure=0.02)
    given = BurstMode(frames_per_s=110.0, max_frames=9, window=0.022, dead_time=0.0031)
    speeds = np.linspace(-3000.0, 3000.0, 7)
    burst = best_moving_burst(
        Scene(speeds, photon_rate=1e5, read_noise=8.0, limits=limits, burst=given)
    )
    assert 2 <= burst.num_frames <= 3
    ends, begins = (
        np.array([frame.time + side * frame.exposure / 2 for frame in burst.frames])
        for side in (1, -1)
    )
    assert np.min(np.diff(ends)) >= (1 - 1e-6) / 110
    assert np.min(begins[1:] - ends[:-1]) >= 0.0031 * (1 - 1e-6)
    assert burst.duration <= 0.022 * (1 + 1e-6)


@pytest.mark.parametrize("number", [24, 25])
def test_frames_that_are_not_searched_freely_follow_things_of_each_speed(number):
    """More than 24 that fly back differ in velocity, as no free search spreads theirs."""
    burst = BurstMode(frames_per_s=400.0, max_frames=number)
    scene = Scene([500.0, 3000.0], photon_rate=1e5, read_noise=2.0, burst=burst)
    room = Room.of(scene.limits, FrameTimes.of(scene, burst), 3000.0)
    tie = Tie(FOLLOW, room, Shape(number, 1, 1), 500.0, 3000.0, np.ones(1), np.zeros(1))
    velocity = tie.frames(np.array([0.5, 0.0, 0.5, 0.2])).velocity[..., 0]
    assert np.all(np.diff(velocity, axis=1) == 0)
    assert (np.ptp(velocity) > 100) == (number > 24)


# ---- the frames that are found ----------------------------------------------------------------


@pytest.mark.slow
def test_frames_over_a_belt_follow_it_and_fly_back(belt):
    """Five pans of unequal lengths and velocities have 41.3 dB; of a list of ways none had 36.2.

    No limit is exceeded, and the stage takes all of its travel, top speed and acceleration.
    """
    assert belt.kind == FOLLOW
    assert belt.num_frames == 5
    assert belt.psnr >= 41.3
    assert belt.worst_psnr <= belt.psnr
    shares = _shares(_belt().limits, belt)
    assert max(shares.values()) <= 1 + 1e-4
    for name in ("max_travel", "max_top_speed", "max_acceleration"):
        assert shares[name] > 0.99
    middles = [float(frame.motion.velocity) for frame in belt.frames]
    assert 4300 < min(middles) < max(middles) < 5300


@pytest.mark.slow
def test_the_level_is_that_of_all_motions_and_shutters(belt):
    """By the response of each exposure, at many frequencies, of each of the scene's speeds."""
    assert belt.psnr == pytest.approx(float(exposures_psnr(_belt(), belt.frames)), abs=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("pans", ["stage", "camera"])
def test_a_burst_follows_either_way(pair, pans):
    """Of things that all move one way, and of their mirror image, it is the same but for signs."""
    there, back = pair[1, pans], pair[-1, pans]
    velocities = [[float(frame.motion.velocity) for frame in x.frames] for x in (there, back)]
    assert np.mean(velocities[0]) == pytest.approx(700.0, rel=0.01)
    np.testing.assert_allclose(np.sort(-np.array(velocities[1])), np.sort(velocities[0]), rtol=1e-2)
    assert back.psnr == pytest.approx(there.psnr, abs=1e-3)
    assert there.travel <= 45.0


@pytest.mark.slow
def test_a_camera_that_turns_spares_its_stage_the_way(pair):
    """It pans with what all things do, and the stage does the rest."""
    turning, moving = pair[1, "camera"], pair[1, "stage"]
    assert 500 < turning.pan <= 900
    assert moving.pan == 0
    assert turning.travel < 0.2 * moving.travel
    assert turning.psnr >= moving.psnr - SIMPLER


@pytest.mark.parametrize(("decoder", "num_frames"), [("unknown", 2), ("known", 1)])
def test_one_exposure_is_a_burst_where_its_speed_is_told(decoder, num_frames):
    """Beside one of 79 ms there is time for one of 0.6 ms, which shows nothing but the speed."""
    scene = Scene(
        np.linspace(-2300.0, 2300.0, 5),
        photon_rate=3e3,
        read_noise=8.0,
        decoder_speed=decoder,
        limits=Limits(max_stroke=45.0, min_half_exposure=2e-4, max_half_exposure=0.04),
        burst=BurstMode(frames_per_s=12.6, max_frames=2),
    )
    assert best_moving_burst(scene).num_frames == num_frames


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "level"),
    [
        # Two ways, eight frames of a weak stage.
        (_in_window(BOTH_WAYS, 8, max_acceleration=1.6e5), 31.447),
        # One way; the pan of a stage and a sweep overlap: their travels do not add up.
        (_in_window(np.linspace(300.0, 1200.0, 7), 4, max_pan=900.0), 36.472),
        # Nothing is at the middle of the speeds, of unequal weights.
        (
            _in_window(
                [-900.0, 0.0, 210.0, 380.0, 3700.0],
                4,
                weights=[0.3, 0.1, 0.3, 0.2, 0.1],
                max_pan=1500.0,
            ),
            34.520,
        ),
        # Each end of a fan is for one of the speeds.
        (
            _in_window(
                [100.0, 300.0, 4000.0], 4, weights=[0.6, 0.3, 0.1], max_pan=3e3, pans="camera"
            ),
            34.993,
        ),
    ],
)
def test_no_list_of_ways_is_better(scene, level):
    """The levels are the best of sweeps, swings, sines and fans by a search among these alone."""
    found = best_moving_burst(scene)
    assert found.psnr >= level - SIMPLER
    assert found.psnr > best_still_burst(scene).psnr


@pytest.mark.slow
def test_four_frames_within_a_stroke_alone_are_as_good_as_any_of_a_list(roomy):
    """Of sweeps, swings, sines and fans the best has 31.046 dB."""
    assert roomy.psnr >= 31.046 - SIMPLER


@pytest.mark.slow
def test_two_frames_may_follow_one_direction():
    """Where the stroke lets them follow only one of two that are alike."""
    scene = _in_window(BOTH_WAYS, 2, rate=30.0, dead_time=6e-3)
    half, stroke = (1 / 30 - 6e-3) / 2, 60.0
    period, pan = 1 / 30, -973.0
    levels = []
    for acceleration in np.linspace(0.3, 1.0, 15) * stroke / (2 * half * (period - half)):
        t = np.linspace(-half, half, 201)
        first = acceleration * t**2
        second = 2 * acceleration * half * (period - half) - first
        places = np.r_[first + pan * t, second + pan * (t + period)]
        if np.ptp(places) <= stroke:
            motion = ParabolicMotion(acceleration=acceleration, half_exposure=half, velocity=pan)
            levels.append(float(exposures_psnr(scene, [TimedFrame(motion, 0.0)] * 2)))
    assert best_moving_burst(scene).psnr >= max(levels) - SIMPLER


@pytest.mark.slow
def test_a_sensor_chooses_the_path_that_leaves_most_on_it(roomy):
    """The best four frames without an end look beside a narrow sensor, which swings."""
    narrow = _in_window(BOTH_WAYS, 4, max_stroke=120.0, sensor=Sensor(width=512.0))
    burst = best_moving_burst(narrow)
    assert burst.kind == "alternating parabolas"
    assert roomy.psnr > burst.psnr
    lost, less = (loss_of_width(narrow, x.frames, width=512.0) for x in (roomy, burst))
    assert burst.psnr - less > roomy.psnr - lost + 0.1


@pytest.mark.slow
def test_the_simplest_of_equals_is_taken(roomy):
    """Things of nearly one speed are followed on one pan, which a freer path only equals."""
    alike = best_moving_burst(_in_window(np.linspace(950.0, 960.0, 5), 4, max_stroke=120.0))
    assert alike.kind == PAN != roomy.kind
    assert np.ptp([float(frame.motion.velocity) for frame in alike.frames]) == pytest.approx(0.0)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_one_exposure_is_no_worse_than_a_parabola(seed):
    """Of told speeds both ways or one way, over the parabolas that a stroke has room for."""
    draw = np.random.default_rng(seed)
    fastest, stroke = float(np.exp(draw.uniform(6, 8.5))), float(draw.uniform(10, 80))
    speeds = np.linspace(draw.choice([-1.0, 0.3]) * fastest, fastest, 9)
    limits = Limits(max_stroke=stroke, **FAR)
    burst = BurstMode(frames_per_s=12.0, max_frames=1)
    light = {"photon_rate": float(np.exp(draw.uniform(10, 13))), "read_noise": 5.0}
    scene = Scene(speeds, limits=limits, burst=burst, decoder_speed="known", **light)
    levels = []
    for half, top in itertools.product(np.geomspace(1e-3, 0.04, 12), np.linspace(0.1, 1.5, 8)):
        rate, mean = top * fastest / half, float(np.mean(speeds))
        motion = ParabolicMotion(acceleration=rate, half_exposure=half, velocity=mean)
        if np.ptp(np.asarray(motion.position(np.linspace(-half, half, 101)))) <= stroke:
            levels.append(levels_of(scene, [TimedFrame(motion, 0.0, 0.0)])[0])
    assert best_moving_burst(scene).psnr >= max(levels) - 0.01


@pytest.mark.slow
def test_frames_come_in_the_order_that_leaves_most_room():
    """Six frames over things that all move one way end at 42.52 dB without another order."""
    limits = Limits(
        max_stroke=59.12,
        max_travel=59.12,
        max_top_speed=1636.1,
        max_acceleration=80830.0,
        min_half_exposure=1e-4,
        max_half_exposure=0.04,
    )
    burst = BurstMode(frames_per_s=29.2, max_frames=6, window=6.5 / 29.2)
    speeds, light = np.linspace(371.0, 857.0, 9), {"photon_rate": 1.716e5, "read_noise": 2.435}
    assert best_moving_burst(Scene(speeds, limits=limits, burst=burst, **light)).psnr > 42.56


@pytest.mark.parametrize("slug", ["at rest", "slow", "dark", "no light", "no noise"])
def test_moving_is_never_worse_than_stills(slug):
    """Of what is at rest or hardly moves, or in the dark: it may stay, and no level is NaN."""
    limits = Limits(max_stroke=45.0, max_half_exposure=0.02)
    burst = BurstMode(frames_per_s=100.0, max_frames=3)
    speeds = {"at rest": [0.0], "slow": [0.0, 40.0]}.get(slug, [-4500.0, 0.0, 4500.0])
    rate = {"dark": 3e3, "no light": 0.0}.get(slug, 1e5)
    read = {"dark": 20.0, "no noise": 0.0}.get(slug, 8.0)
    picture = Texture(mean_level=0.0) if slug == "no noise" else Texture()
    given = {"photon_rate": rate, "read_noise": read, "picture": picture}
    scene = Scene(speeds, limits=limits, burst=burst, **given)
    found = best_moving_burst(scene)
    assert found.psnr >= best_still_burst(scene).psnr - SIMPLER
    assert np.isfinite([found.psnr, found.worst_psnr, found.travel]).all()


@pytest.mark.parametrize(
    ("speeds", "weights", "rate", "number", "light", "stage", "level"),
    [
        # More frames for the commoner thing: a fan of even steps ends at 37.7 dB.
        ((-1490, 1560), (0.69, 0.31), 20.7, 6, (3.4e4, 6.0), (43.7, 2900, 9.6e6), 39.2),
        # Five things of unequal shares: without an exchange of one, 42.3 dB.
        pytest.param(
            (-1310, 178, 263, 905, 1200),
            (1, 20, 46, 28, 5),
            25.0,
            6,
            (2e5, 5.0),
            (27.7, 3300, 2e7),
            42.6,
            marks=pytest.mark.slow,
        ),
        # A range: swings alone end at 39.9 dB.
        pytest.param(
            np.linspace(-3005, 3005, 9),
            (1,) * 9,
            143.0,
            12,
            (5.1e5, 3.3),
            (34.6, 6988, 7.1e7),
            40.05,
            marks=pytest.mark.slow,
        ),
    ],
)
def test_each_frame_may_follow_another_thing(speeds, weights, rate, number, light, stage, level):
    """Frames that fly back between things, each of its own length."""
    stroke, top, acceleration = stage
    limits = Limits(
        max_stroke=stroke,
        max_travel=stroke,
        max_top_speed=top,
        max_acceleration=acceleration,
        min_half_exposure=1e-4,
        max_half_exposure=0.04,
    )
    scene = Scene(
        np.array(speeds, float),
        np.array(weights, float),
        photon_rate=light[0],
        read_noise=light[1],
        limits=limits,
        burst=BurstMode(frames_per_s=rate, max_frames=number, window=(number + 0.5) / rate),
    )
    assert best_moving_burst(scene).psnr > level


@pytest.mark.parametrize("pans", ["stage", "camera"])
def test_the_top_speed_bounds_the_pan_whatever_makes_it(pans):
    """That of one exposure, and of frames."""
    limits = Limits(max_stroke=9.0, max_top_speed=1200.0, max_pan=5000.0, pans=pans)
    for velocity, is_met in ((1190.0, True), (1210.0, False)):
        motion = ParabolicMotion(acceleration=0.0, half_exposure=1e-3, velocity=velocity)
        assert limits.demands(motion)["top_speed"].is_met(1e-5) == is_met
    times = FrameTimes.of(_in_window([3000.0], 4), BurstMode(frames_per_s=50.0))
    assert Room.of(limits, times, 3000.0).max_pan == pytest.approx(1200.0, rel=1e-3)


@pytest.mark.parametrize(
    ("rates", "kind"),
    [
        (([2.1e5], [-1.9e5], [2.3e5]), ALTERNATING),
        (([2.1e5], [1.9e5], [2.3e5]), SWINGS),
        (([2.1e5], [-1.9e5], [-2.3e5]), SWINGS),
        (([2.2e5, 2.0e5], [-1.9e5, -2.0e5], [2.3e5, 2.3e5]), ALTERNATING),
        (([9.1e5, 1.1e5], [-1.9e5, -2.0e5], [2.3e5, 2.3e5]), SWINGS),
    ],
    ids=["alternate", "one way", "not in turn", "nearly parabolas", "bent"],
)
def test_only_parabolas_that_alternate_are_called_so(rates, kind):
    """A frame that turns back may do so on any path."""
    motions = (FreeMotion(accelerations=each, half_exposure=0.006) for each in rates)
    frames = [TimedFrame(each, 0.013 * k, 4.0 * (k % 2)) for k, each in enumerate(motions)]
    assert kind_of(Exposures(FREE, tuple(frames))) == kind


@pytest.mark.parametrize("rate", [4e5, -4e5])
@pytest.mark.parametrize("turns", [1, -1])
def test_frames_are_one_sweep_whichever_way_they_bend(rate, turns):
    """On one parabola over all frames; turned about their middles the frames are none."""
    half, frames = 0.006, []
    for time in (-0.02, 0.0, 0.02):
        motion = FreeMotion(
            accelerations=[turns * rate / 2], half_exposure=half, velocity=rate * time
        )
        frames.append(TimedFrame(motion, time, rate * time**2 / 2))
    kind = kind_of(Exposures("", tuple(frames), 0.0, 0.0, 0.0))
    assert (kind == SWEEP) == (turns == 1)
