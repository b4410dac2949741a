"""Bursts of a sensor that moves: never worse than an independent search, within every limit."""

import itertools

import equinox as eqx
import numpy as np
import pytest
from support.burst_levels import FrameGroup, burst_psnr

from mishutter import BurstMode, Limits, Occlusion, ParabolicMotion, Scene, Sensor
from mishutter.evaluation.bursts import FrameTimes, best_still_burst
from mishutter.evaluation.moving_bursts import (
    _best_of,
    _Room,
    _Search,
    _Try,
    best_moving_burst,
    way_over_frames,
)
from mishutter.evaluation.open_frames import OpenFrames
from mishutter.evaluation.sequences import loss_of_width

LIMITS = Limits(max_stroke=45.0, max_top_speed=2e4, min_half_exposure=2e-4, max_half_exposure=0.02)
RATE, NOISE, SPEEDS = 1e5, 8.0, np.linspace(-3000.0, 3000.0, 7)


def _search(scene, *, pans=False, speeds=(-4500.0, 4500.0)):
    return _Search(_Room(scene.limits), FrameTimes.of(scene, scene.burst), pans, *speeds)


SIMPLER = 0.05 + 0.005
"""Decibels that a simpler burst may be below the best, and those of the search."""


def _scene(**others):
    burst = others.pop("burst", BurstMode(frames_per_s=240.0, max_frames=6))
    given = {"photon_rate": RATE, "read_noise": NOISE, "limits": LIMITS, "burst": burst}
    return Scene(SPEEDS, **(given | others))


@pytest.mark.slow
def test_moving_frames_have_the_times_of_still_ones():
    """Window and dead time are of the camera, whatever its sensor does in a frame."""
    given = BurstMode(frames_per_s=110.0, max_frames=9, window=0.022, dead_time=0.0031)
    burst = best_moving_burst(_scene(burst=given))
    assert burst.num_frames <= 3
    ends, begins = (
        np.array([frame.time + side * frame.exposure / 2 for frame in burst.frames])
        for side in (1, -1)
    )
    assert np.min(np.diff(ends)) >= (1 - 1e-9) / 110
    assert np.min(begins[1:] - ends[:-1]) >= 0.0031 * (1 - 1e-9)
    assert burst.duration <= 0.022 * (1 + 1e-6)


def _of_window(rate, read_noise, num_frames, *, stroke=45.0, **others):
    """The camera of a window of 80 ms that takes some frames without a gap."""
    limits = Limits(max_stroke=stroke, min_half_exposure=1e-4, max_half_exposure=0.04, **others)
    return Scene(
        np.linspace(-4500.0, 4500.0, 9),
        photon_rate=rate,
        read_noise=read_noise,
        limits=limits,
        burst=BurstMode(frames_per_s=num_frames / 0.08, max_frames=num_frames),
    )


def _groups(burst):
    """The frames of a sequence, one by one, as their level takes them."""
    return [
        FrameGroup(frame.motion.without_velocity(), np.array([float(frame.motion.velocity)]))
        for frame in burst.frames
    ]


@pytest.mark.slow
@pytest.mark.parametrize(("rate", "level", "num_frames"), [(1e5, 33.3268, 16), (1e4, 25.6958, 15)])
def test_the_best_moving_burst_is_that_of_an_independent_search(rate, level, num_frames):
    """A search in NumPy found these levels of 16 parabolas; in the dark 15 frames are better."""
    burst = best_moving_burst(_of_window(rate, 8.0, 16))
    assert burst.psnr >= level - SIMPLER
    assert burst.num_frames == num_frames
    frames = [
        FrameGroup(x.motion.without_velocity(), np.array([x.motion.velocity])) for x in burst.frames
    ]
    level = float(burst_psnr(_of_window(rate, 8.0, 16), frames))
    assert level == pytest.approx(burst.psnr, abs=1e-4)


@pytest.mark.parametrize(
    ("width", "wanted"), [(None, "sweep"), (6000.0, "sweep"), (3500.0, "alternating parabolas")]
)
def test_the_width_decides_between_two_paths(width, wanted):
    """A sweep loses 0.11 dB more on 3,500 px, and is 0.03 dB better on a sensor without ends."""
    scene = _of_window(1e5, 8.0, 4, stroke=120.0)
    search = _search(scene)
    tries = [_Try(search, kind, 4) for kind in ("alternating parabolas", "sweep")]
    frames = OpenFrames.of(scene, search.times.longest, folds=True)
    assert _best_of(frames, tries, width, lambda share: None).kind == wanted


@pytest.mark.slow
@pytest.mark.parametrize(("width", "gain"), [(512.0, 0.5), (900.0, 0.2)])
def test_a_sensor_chooses_the_path_that_leaves_most_on_it(width, gain):
    """Four frames of a sweep are best without an end, and look beside a narrow sensor."""
    scene = _of_window(1e5, 8.0, 4, stroke=120.0)
    endless = best_moving_burst(scene)
    narrow = eqx.tree_at(
        lambda each: each.sensor, scene, Sensor(width=width), is_leaf=lambda x: x is None
    )
    burst = best_moving_burst(narrow)
    assert endless.kind == "sweep"
    assert burst.psnr == pytest.approx(31.046, abs=2e-3)  # the most of four frames that all move
    lost, less = (loss_of_width(scene, x.frames, width=width) for x in (endless, burst))
    assert burst.psnr - less > endless.psnr - lost + gain


def _accelerations(burst):
    """Those within frames, and those between frames that move."""
    moving = [frame for frame in burst.frames if frame is burst.frames[-1] or not frame.is_still]
    within = [float(frame.motion.greatest_acceleration) for frame in moving]
    pairs = itertools.pairwise(burst.frames[1:] if burst.frames[0].is_still else burst.frames)
    for first, second in pairs:
        half = np.array(first.exposure / 2)
        change = float(second.motion.velocity_at(-half)) - float(first.motion.velocity_at(half))
        within.append(abs(change) / (second.time - first.time - first.exposure + 1e-12))
    return within


@pytest.mark.slow
@pytest.mark.parametrize(
    "limits", [{"max_acceleration": 1.5e5}, {"max_travel": 31.0}, {"max_top_speed": 3000.0}, {}]
)
def test_limits_hold_over_the_whole_burst(limits):
    """The way of the stage from frame to frame, and what it does in each; one of them binds."""
    scene = _of_window(1e5, 8.0, 4, stroke=37.0, **limits)
    burst = best_moving_burst(scene)
    used = {
        "max_stroke": burst.stroke,
        "max_top_speed": max(float(frame.motion.top_speed) for frame in burst.frames),
        "max_acceleration": max(_accelerations(burst)),
        "max_travel": burst.stroke,  # without a limit on the acceleration it runs up at once
    }
    shares = [used[name] / bound for name, bound in ({"max_stroke": 37.0} | limits).items()]
    assert max(shares) == pytest.approx(1, abs=0.02)
    assert max(shares) <= 1 + 1e-6


@pytest.mark.slow
def test_a_moving_burst_is_never_worse_than_stills():
    """It may hardly move: of objects at rest, in a light in which moving loses."""
    scene = _of_window(3e3, 20.0, 4)
    slow = Scene(
        [0.0, 40.0],
        photon_rate=1e5,
        read_noise=8.0,
        limits=scene.limits,
        burst=scene.burst,
    )
    for each in (scene, slow):
        assert best_moving_burst(each).psnr >= best_still_burst(each).psnr - SIMPLER


@pytest.mark.slow
@pytest.mark.parametrize("pans", ["stage", "camera"])
def test_a_burst_follows_either_way(pans):
    """Of objects that all move one way, and of their mirror image, it is the same but for signs."""
    limits = Limits(
        max_stroke=45.0, max_top_speed=2e4, max_half_exposure=0.02, max_pan=900.0, pans=pans
    )
    given = {"photon_rate": RATE, "read_noise": NOISE, "limits": limits}
    given["burst"] = BurstMode(frames_per_s=240.0, max_frames=2)
    there, back = (
        best_moving_burst(Scene(sign * np.array([610.0, 790.0]), **given)) for sign in (1, -1)
    )
    velocities = [[float(frame.motion.velocity) for frame in x.frames] for x in (there, back)]
    assert np.mean(velocities[0]) == pytest.approx(700.0, rel=0.01)
    np.testing.assert_allclose(np.sort(-np.array(velocities[1])), np.sort(velocities[0]), rtol=1e-4)
    assert back.psnr == pytest.approx(there.psnr, abs=1e-4)
    assert there.travel <= 45.0


def test_a_stage_coasts_between_alternating_parabolas():
    """Within frames it accelerates to either side in turn, and between them not at all."""
    way = way_over_frames("alternating parabolas", 3, 4e-3, 11e-3)
    np.testing.assert_allclose(way.rates, [250.0, 0.0, -250.0, 0.0, 250.0])
    np.testing.assert_allclose(way.durations, [8e-3, 3e-3, 8e-3, 3e-3, 8e-3])


@pytest.mark.slow
@pytest.mark.parametrize("num_rests", [0, 2])
@pytest.mark.parametrize("kind", ["alternating parabolas", "sine", "sweep", "fan of pans"])
def test_the_frames_of_a_path_fit_together(kind, num_rests):
    """From frame to frame the stage is where its velocity takes it, within its travel."""
    scene = _of_window(1e5, 8.0, 4)
    each = _Try(_search(scene, pans=True), kind, 4 - num_rests, num_rests)
    place = each.at(np.array([0.93, 0.8, 0.6, 0.53, 0.3]))
    found = scene.limits.with_travel(each.sequence(place, np.ones(9), 1.0))
    assert place.pan == pytest.approx(270.0)
    ends = []
    for frame in found.frames[num_rests:]:
        half = frame.exposure / 2
        tau = np.linspace(-half, half, 101)
        path = frame.position + np.asarray(frame.motion.position(tau))
        speeds = np.asarray(frame.motion.velocity_at(tau[[0, -1]]))
        ends.append((path, speeds))
    assert np.ptp([path for path, _ in ends]) <= found.travel * (1 + 1e-4)
    gap = place.way.period - found.frames[-1].exposure
    for (path, before), (after, speeds) in itertools.pairwise(ends):
        # A stage that coasts, or accelerates evenly, or nearly so, travels by its mean speed.
        way = gap * (before[1] + speeds[0]) / 2
        assert after[0] - path[-1] == pytest.approx(way, abs=0.03 * found.travel)


@pytest.mark.slow
def test_frames_at_rest_pay_before_a_background():
    """Where 37 % of the picture moves, one of them at least among those that move."""
    scene = eqx.tree_at(
        lambda s: s.occlusion,
        _of_window(1e5, 8.0, 4),
        Occlusion(front_share=0.37),
        is_leaf=lambda x: x is None,
    )
    still, moving = best_still_burst(scene), best_moving_burst(scene)
    rests = [frame.is_still for frame in moving.frames]
    assert rests[0]
    assert rests == sorted(rests, reverse=True)
    assert not rests[-1]
    assert moving.psnr > still.psnr + 0.5
    assert moving.psnr == pytest.approx(float(burst_psnr(scene, _groups(moving))), abs=1e-3)


def _in_window(speeds, num_frames, *, rate=None, dead_time=0.0, weights=None, **limits):
    """The camera of a window of 80 ms whose limits or speeds hold a plain path back."""
    given = {"max_stroke": 60.0, "min_half_exposure": 1e-4, "max_half_exposure": 0.04} | limits
    rate = num_frames / 0.08 if rate is None else rate
    frames = {"max_frames": num_frames, "window": 0.08, "dead_time": dead_time}
    return Scene(
        speeds,
        weights=weights,
        photon_rate=1e5,
        read_noise=8.0,
        limits=Limits(**given),
        burst=BurstMode(frames_per_s=rate, **frames),
    )


@pytest.mark.parametrize(("decoder", "num_frames"), [("unknown", 2), ("found", 2), ("known", 1)])
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


BOTH_WAYS = np.linspace(-4500.0, 4500.0, 9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "level"),
    [
        # The pan of a stage and a sweep overlap: their travels do not add up.
        (_in_window(np.linspace(300.0, 1200.0, 7), 4, max_pan=900.0), 36.472),
        # A sweep of fewer frames is faster, where there is no time to run up after one at rest.
        (_in_window(BOTH_WAYS, 8, max_acceleration=1.6e5), 31.447),
        # One parabola among stills needs the least travel.
        (_in_window(BOTH_WAYS, 4, max_stroke=11.0), 29.257),
        # Nothing is at the middle of the speeds.
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
def test_no_burst_of_an_independent_search_is_better(scene, level):
    """The levels are those of `benchmarks.bursts_search`, which shares no code with the package."""
    assert best_moving_burst(scene).psnr >= level - SIMPLER


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
            motion = ParabolicMotion(acceleration=acceleration, half_exposure=half)
            group = FrameGroup(motion, np.array([pan]), 2)
            levels.append(float(burst_psnr(scene, [group])))
    assert best_moving_burst(scene).psnr >= max(levels) - SIMPLER


@pytest.mark.parametrize("kind", ["alternating parabolas", "sine", "sweep", "fan of pans"])
def test_a_pan_takes_the_travel_that_it_adds(kind):
    """With its largest top speed a path beside a pan fills the stroke, sampled, and no more."""
    scene = _in_window(BOTH_WAYS, 4)
    each = _Try(_search(scene, pans=True), kind, 4)
    place = each.at(np.array([0.97, 1.0, 1.0, 0.547, 0.0]))
    assert place.pan == pytest.approx(423.0)
    ends = np.append(0.0, np.cumsum(place.way.durations))
    t = np.linspace(0, ends[-1], 20_001)
    velocity = place.pan + place.top_speed * np.interp(t, ends, place.way.velocities)
    ways = np.r_[0.0, np.cumsum((velocity[1:] + velocity[:-1]) / 2 * np.diff(t))]
    assert np.ptp(ways) == pytest.approx(60.0, rel=2e-3)
    # A sum of both travels would have left no more than this.
    assert place.top_speed > each.at(np.array([0.97, 1.0, 1.0, 0.5, 0.0])).top_speed * (
        1 - 33.8 / 60
    )


KINDS = ["alternating parabolas", "sine", "sweep", "fan of pans"]


@pytest.mark.parametrize("num_rests", [0, 3])
@pytest.mark.parametrize("kind", KINDS)
def test_the_path_from_rest_to_rest_stays_within_the_travel(kind, num_rests):
    """Run-up and run-out included, as the path is exported; where they bind they fill it."""
    scene = _in_window(BOTH_WAYS, 8, max_acceleration=8e5, max_travel=57.0, pans="stage")
    limits = scene.limits
    each = _Try(_search(scene, pans=True), kind, 8 - num_rests, num_rests)
    for pan in (0.5, 0.56):
        place = each.at(np.array([0.7, 1.0, 0.2, pan, 0.1]))
        path = limits.stage_path_of_frames(each.sequence(place, np.ones(9), 1.0))
        assert path.travel <= 57.0 * (1 + 1e-6)
        if kind in ("sweep", "fan of pans"):
            assert path.travel == pytest.approx(57.0, rel=1e-3)


@pytest.mark.parametrize("kind", ["sweep", "fan of pans"])
def test_a_run_up_leaves_less_travel_for_the_frames(kind):
    """By the way from rest to the velocity at the first light and back, u^2/2A at each end."""
    at = []
    for most in (None, 3e5):
        scene = _in_window(BOTH_WAYS, 5, max_acceleration=most, max_travel=53.0)
        each = _Try(_search(scene), kind, 5)
        place = each.at(np.array([0.6, 1.0, 1.0, 0.0, 0.0]))
        at.append((place.top_speed, each.sequence(place, np.ones(9), 1.0).stroke))
    (free, whole), (held, lit) = at
    assert whole == pytest.approx(53.0)
    assert held < free
    assert lit + held**2 / 2 / 3e5 == pytest.approx(53.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("read_noise", "num_frames", "level"), [(2.0, 8, 32.80), (8.0, 32, 34.208)]
)
def test_no_frame_is_at_rest_for_a_gain_that_nobody_sees(read_noise, num_frames, level):
    """One at rest before a sine is best by 0.03 dB; the burst whose frames all move is taken."""
    burst = best_moving_burst(_of_window(1e5, read_noise, num_frames))
    assert burst.num_rests == 0
    assert burst.num_frames == num_frames
    assert level - SIMPLER - 0.005 <= burst.psnr < level


def test_the_simplest_comes_first():
    """One exposure, then frames that all move, on the paths of fewer turns."""
    scene = _in_window(BOTH_WAYS, 7)
    search = _search(scene)

    def simplicity(kind, num_moving, num_rests):
        return _Try(search, kind, num_moving, num_rests).simplicity

    order = [("alternating parabolas", 1, 0), ("sweep", 7, 0), ("sine", 7, 0)]
    order += [("alternating parabolas", 7, 0), ("fan of pans", 7, 0), ("sweep", 4, 3)]
    found = [simplicity(*each) for each in order]
    assert found == sorted(found)
    assert len(set(found)) == len(order)


@pytest.mark.slow
def test_a_simpler_path_is_no_more_than_a_little_below_the_best():
    """A sweep has all but 0.02 dB of parabolas of alternating direction, and is taken."""
    scene = _in_window(BOTH_WAYS, 4, max_stroke=130.0)
    only = _in_window(BOTH_WAYS, 4, max_stroke=60.0)
    free, bound = best_moving_burst(scene), best_moving_burst(only)
    assert (free.kind, bound.kind) == ("sweep", "alternating parabolas")
    assert free.psnr >= bound.psnr - SIMPLER


def _sampled(limits, burst):
    """Ranges of the exported path, whole and from first light to last, and its top speed."""
    path = limits.stage_path_of_frames(burst)
    times = np.linspace(path.times[0], path.times[-1], 100_001)
    place, velocity = path.at(times)
    lit = place[(times >= path.exposure[0]) & (times <= path.exposure[1])]
    return np.ptp(place), np.ptp(lit), np.max(np.abs(velocity))


@pytest.mark.slow
def test_limits_hold_where_frames_at_rest_precede_moving_ones():
    """The run-up between them lies in the burst, whose stroke and travel are of the whole path."""
    limits = Limits(
        max_stroke=47.02,
        max_travel=55.0,
        max_acceleration=4.1e5,
        min_half_exposure=1e-4,
        max_half_exposure=0.04,
    )
    scene = eqx.tree_at(lambda s: s.limits, _of_window(1e5, 8.0, 4), limits)
    scene = scene.with_occlusion(Occlusion(front_share=0.45))
    found = best_moving_burst(scene)
    assert found.num_rests > 0
    travel, stroke, top = _sampled(limits, found)
    assert found.travel == pytest.approx(travel, rel=1e-4)
    assert found.stroke == pytest.approx(stroke, rel=1e-4)
    assert max(stroke / 47.02, travel / 55.0) == pytest.approx(1, abs=0.02)
    assert max(stroke / 47.02, travel / 55.0) <= 1 + 1e-6
    assert top <= 1e5


@pytest.mark.parametrize("duty", [0.55, 0.81, 1.0])
def test_a_sine_keeps_its_top_speed(duty):
    """That of its path, between frames too, and it goes on as a sine there."""
    scene = _in_window(BOTH_WAYS, 5, max_acceleration=4e6, max_top_speed=3100.0)
    each = _Try(_search(scene), "sine", 5)
    share = np.log(duty * 0.016 / 2e-4) / np.log(each.longest / 2e-4)
    place = each.at(np.array([share, 1.0, 1.0, 0.5, 0.0]))
    burst = each.sequence(place, np.ones(9), 1.0)
    assert place.top_speed == pytest.approx(3100.0)
    path = scene.limits.stage_path_of_frames(burst)
    assert float(path.use.top_speed) == pytest.approx(3100.0, rel=1e-9)
    inside = np.linspace(*path.exposure, 5001)
    start = burst.frames[0].time
    sine = np.sin(np.pi * (inside - start) / 0.016)
    np.testing.assert_allclose(path.at(inside)[1], 3100.0 * sine, atol=3100 * 3e-3)


@pytest.mark.parametrize("most", [6e5, 1.4e5])
def test_the_limits_of_a_search_are_those_of_the_path(most):
    """With any rests, pan and path: the greatest share of all is that of the exported path.

    The lower acceleration binds where no pan takes room. Run-ups take all of it anyway.
    """
    limits = {"max_acceleration": most, "max_travel": 57.0, "max_top_speed": 4300.0}
    scene = _in_window(BOTH_WAYS, 8, pans="stage", max_stroke=49.0, **limits)
    for kind, num_rests, pan in itertools.product(KINDS, (0, 3), (0.5, 0.57)):
        each = _Try(_search(scene, pans=True), kind, 8 - num_rests, num_rests)
        place = each.at(np.array([0.8, 1.0, 0.1, pan, 0.2]))
        burst = each.sequence(place, np.ones(9), 1.0)
        use = scene.limits.stage_path_of_frames(burst).use
        assert float(use.acceleration) <= most * (1 + 1e-6)
        shares = [use.stroke / 49.0, use.travel / 57.0, use.top_speed / 4300.0]
        shares.append(max(_accelerations(burst)) / most)
        assert float(max(shares)) == pytest.approx(1, abs=1e-3)
        assert float(max(shares)) <= 1 + 1e-6


@pytest.mark.parametrize(("pan", "top_speed", "most"), [(710.0, 4e3, 710.0), (3e3, 930.0, 930.0)])
def test_frames_pan_as_fast_as_they_may(pan, top_speed, most):
    """A camera that turns stops at its own pan, or at the stage's top speed; a slower pan stays."""
    room = _Room(Limits(max_pan=pan, max_top_speed=top_speed, pans="camera"))
    for sign in (1, -1):
        assert room.nearest_pan(sign * 2e4, 0.1) == sign * most
        assert room.nearest_pan(sign * 0.9 * most, 0.1) == sign * 0.9 * most


@pytest.mark.slow
def test_a_limit_on_the_jerk_holds_over_a_burst():
    """Only paths whose acceleration does not jump between frames remain."""
    jerk = 4e7
    scene = _in_window(BOTH_WAYS, 4, max_acceleration=6e5, max_jerk=jerk)
    found = best_moving_burst(scene)
    path = scene.limits.stage_path_of_frames(found)
    assert found.kind in ("sweep", "sine", "stills")
    assert float(path.use.jerk) <= jerk * (1 + 1e-6)
    assert path.jerks.any()
    assert float(path.use.stroke) <= 60.0 * (1 + 1e-6)


@pytest.mark.slow
def test_a_faster_camera_is_no_worse():
    """Four frames of 20 ms are within reach of any that takes 50 a second or more."""
    levels = []
    for rate in (50.0, 110.0, 230.0):
        found = best_moving_burst(_in_window(BOTH_WAYS, 4, rate=rate))
        levels.append(found.psnr)
        ends = [frame.time + frame.exposure / 2 for frame in found.frames]
        assert np.min(np.diff(ends)) >= (1 - 1e-9) / rate
        assert found.duration <= 0.08 * (1 + 1e-9)
    assert min(levels[1:]) >= levels[0] - SIMPLER


@pytest.mark.slow
def test_any_number_of_frames_may_move():
    """Two of twelve, on a sweep; of the numbers that a search begins with none is as good."""
    light = {"photon_rate": 1e6, "read_noise": 2.0}
    limits = Limits(max_stroke=7.0, min_half_exposure=1e-4, max_half_exposure=0.04)
    burst = BurstMode(frames_per_s=150.0, max_frames=12, window=0.08)
    found = best_moving_burst(Scene(BOTH_WAYS, limits=limits, burst=burst, **light))
    assert (found.kind, found.num_rests, found.num_frames) == ("sweep", 10, 12)
    assert found.psnr > 39.79  # 39.68 with all, half or one of them
