"""The search's starts, slopes and paths, each against sums that are written out."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from mishutter import (
    BurstMode,
    EvenVelocities,
    Exposures,
    Limits,
    ListedVelocities,
    Scene,
    Sensor,
    exposures_psnr,
)
from mishutter.evaluation.bursts import FrameTimes
from mishutter.evaluation.ceilings import exposures_ceiling
from mishutter.evaluation.fans import Grid
from mishutter.evaluation.instants import Instants
from mishutter.evaluation.registration import loss_of_width
from mishutter.model.frame_path import FramePath
from mishutter.search import frame_search, moving_frames, plane_frames
from mishutter.search.frame_levels import Frames, Levels, Shape
from mishutter.search.frame_limits import Room
from mishutter.search.frame_search import Descent, End, Search, changed, one_by_one, reordered
from mishutter.search.frame_ties import (
    ALTERNATING,
    BRACKETED,
    CIRCLE,
    FOLLOW,
    FREE,
    PAN,
    RING,
    STILLS,
    SWEEP,
    TWO_SINES,
    WAYS,
    Tie,
)
from mishutter.search.moving_frames import sequence_of

LIMITS = Limits(
    max_stroke=30.0,
    max_half_exposure=0.02,
    max_acceleration=4e5,
    max_travel=47.0,
    max_top_speed=3100.0,
)
FOLLOWED = (-700.0, 150.0, 2400.0)


def _scene(limits=LIMITS):
    burst = BurstMode(frames_per_s=70.0, window=0.07, dead_time=0.7e-3, max_frames=4)
    light = {"photon_rate": 1.1e5, "read_noise": 6.0}
    return Scene(FOLLOWED, [0.5, 0.2, 0.3], limits=limits, burst=burst, **light)


@pytest.fixture(scope="module")
def scene():
    return _scene()


@pytest.fixture(scope="module")
def levels(scene):
    return Levels.on_axis(scene)


@pytest.fixture(scope="module")
def room(scene):
    return Room.of(scene.limits, FrameTimes.of(scene, scene.burst), 2400.0)


def _frames(count, pieces, axes=1, seed=3):
    """Frames of any lengths, velocities, gaps and places."""
    draw = np.random.default_rng(seed)
    exposure, gap = draw.uniform(3e-3, 9e-3, count), draw.uniform(6e-3, 1.1e-2, count - 1)
    velocity = draw.normal(300.0, 800.0, (count, pieces + 1, axes))
    return Frames(exposure, velocity, gap, draw.uniform(0, 30, (count, axes)), np.zeros(axes))


def _following(room, frames, frame, thing, longest):
    """The frames of which one follows a thing as long as its way is within the stroke."""
    exposure, velocity = frames.exposure.copy(), frames.velocity.copy()
    velocity[frame] = np.clip(thing, -room.top_speed, room.top_speed)
    most = min(room.length / abs(thing), longest)
    exposure[frame] = max(most, room.times.shortest)
    return frames._replace(exposure=exposure, velocity=velocity)


def test_exchanges_are_those_that_gain_most(levels, room):
    """Of all in which one frame follows another thing, the four of the highest levels, in order."""
    frames = _frames(3, 2)
    frames.velocity[1] = 2400.0  # which the second follows already
    every = [
        _following(room, frames, k, thing, frames.exposure[k])
        for k, thing in itertools.product(range(3), FOLLOWED)
        if (k, thing) != (1, 2400.0)
    ]
    every.sort(key=levels.level, reverse=True)
    found = changed(levels, room, FOLLOWED, frames)
    assert len(found) == 4
    for one, other in zip(found, every, strict=False):
        np.testing.assert_allclose(one.exposure, other.exposure)
        np.testing.assert_allclose(one.velocity, other.velocity)


def test_frames_follow_one_thing_after_the_other(levels, room):
    """Each that by which the level gains most; then neighbours go the same way."""
    count, times = 3, room.times
    longest = times.window / count - times.dead_time
    options = [_following(room, _frames(1, 1), 0, thing, longest) for thing in FOLLOWED]

    def level(frames):
        parts = [np.concatenate([getattr(x, name) for x in frames]) for name in Frames._fields[:4]]
        return levels.level(Frames(*parts, np.zeros(1)))

    chosen = []
    for _ in range(count):
        chosen.append(max(options, key=lambda one: level([*chosen, one])))
    chosen.sort(key=lambda one: one.velocity[0, 0, 0])
    found = one_by_one(levels, room, Shape(count, 1, 1), FOLLOWED)
    np.testing.assert_allclose(found.velocity, [one.velocity[0] for one in chosen])
    np.testing.assert_allclose(found.exposure, [one.exposure[0] for one in chosen])
    assert found.velocity[0, 0, 0] != found.velocity[-1, 0, 0]
    # Each begins where its way has room, and no frame ends too soon after the one before.
    np.testing.assert_allclose(found.place, np.where(found.velocity[:, 0] < 0, room.length, 0.0))
    np.testing.assert_allclose(
        found.gap, np.maximum(times.period - found.exposure[1:], times.dead_time)
    )


def test_another_order_moves_whole_frames(room, monkeypatch):
    """Lengths, velocities and places stay together; the times between them are the least."""
    monkeypatch.setattr(frame_search, "_SHARES", (0.0, 0.0, 0.0))
    frames = _frames(4, 1)
    starts, orders = reordered(room), set()
    for _ in range(20):
        moved, same = starts(frames)
        order = [int(np.argmin(np.abs(frames.exposure - x))) for x in moved.exposure]
        orders.add(tuple(order))
        for name in ("exposure", "velocity", "place"):
            own = getattr(frames, name)
            np.testing.assert_array_equal(getattr(moved, name), own[order])
            np.testing.assert_array_equal(getattr(same, name), own)
        gap = np.maximum(room.times.period - moved.exposure[1:], room.times.dead_time)
        np.testing.assert_array_equal(moved.gap, gap)
        np.testing.assert_array_equal(same.gap, frames.gap)
    assert all(sorted(order) == [0, 1, 2, 3] for order in orders)
    assert len(orders) > 4


def _places_of(room, frames, gap):
    """Whether two frames so much apart have places within the limits."""
    pair, every = frames._replace(gap=np.array([gap])), np.linspace(0, room.stroke, 121)
    places = np.stack(np.meshgrid(every, every), axis=-1).reshape(-1, 2)
    shape, least = pair.shape, -2e-2
    points = [room.joined(pair._replace(place=place[:, None])) for place in places]
    slack = room.slack(np.array(points), shape)
    return bool(np.any(np.min(slack, axis=1) > least))


@pytest.mark.parametrize("seed", [1, 4, 5])
def test_flights_take_the_least_time_that_any_places_allow(seed):
    """Against all limits, of frames at any places: not in a shorter time, but in a longer one."""
    limits = replace(LIMITS, max_acceleration=2e6, max_stroke=30.0, max_travel=30.0)
    own = _scene(limits)
    times = FrameTimes.of(own, own.burst)._replace(dead_time=0.0, period=1e-3, window=0.07)
    room, draw = Room.of(limits, times, 2400.0), np.random.default_rng(seed)
    exposure, velocity = draw.uniform(3e-3, 9e-3, 2), draw.normal(0.0, 1500.0, (2, 2, 1))
    frames = Frames(exposure, velocity, exposure[1:], np.zeros((2, 1)), np.zeros(1))
    gap = frame_search._least_gaps(room, frames)[0, 1]
    assert _places_of(room, frames, 1.1 * gap)
    assert gap < 1.1e-6 or not _places_of(room, frames, 0.8 * gap)


def test_one_frame_goes_and_another_stands_twice_or_elsewhere(levels, room):
    """Either way round, with the flights that this takes; all others stay in their order."""
    frames, every = _frames(4, 1), []
    gaps = frame_search._least_gaps(room, frame_search._both_ways(frames))
    for found in frame_search.arrangements(levels, room, frames):
        order = [int(np.argmin(np.abs(frames.exposure - x))) for x in found.exposure]
        is_turned = [
            not np.array_equal(velocity, frames.velocity[k])
            for k, velocity in zip(order, found.velocity, strict=True)
        ]
        states = [k + 4 * turned for k, turned in zip(order, is_turned, strict=True)]
        every.append(tuple(states))
        for place, state in enumerate(states):
            way = slice(None, None, -1 if state > 3 else 1)
            np.testing.assert_array_equal(found.velocity[place], frames.velocity[state % 4][way])
            np.testing.assert_array_equal(found.place[place], frames.place[state % 4])
        np.testing.assert_array_equal(found.gap, gaps[states[:-1], states[1:]])
        left = [[*states[:k], *states[k + 1 :]] for k in range(4)]
        assert any(rest == sorted(rest) and max(rest) < 4 and len({*rest}) == 3 for rest in left)
    assert len({*every}) == len(every) > 8
    assert (0, 1, 2, 3) not in every


def test_frames_that_follow_two_ways_take_turns(levels, room):
    """Of orders of the same frames the first takes least time: none flies back in between.

    Two of the slow ones have room one after the other, and two of the fast ones have not.
    """
    velocity = np.array([2400.0, 2400.0, -700.0, -700.0])[:, None, None] * np.ones((1, 2, 1))
    exposure = np.array([0.0120, 0.0121, 0.0160, 0.0161])
    frames = Frames(exposure, velocity, np.full(3, 4e-3), np.zeros((4, 1)), np.zeros(1))
    times = room.times._replace(period=1e-3, dead_time=0.0)
    # A stage that turns round in less time than it flies back.
    quick = room._replace(acceleration=8e6, times=times)
    every = list(frame_search.arrangements(levels, quick, frames))
    orders = [found for found in every if len({*found.exposure}) == 4]
    is_fast = orders[0].velocity[:, 0, 0] > 0
    assert not np.any(is_fast[1:] & is_fast[:-1])
    spent = [float(np.sum(found.gap) + np.sum(found.exposure)) for found in orders]
    gaps = frame_search._least_gaps(quick, frames)
    before = float(np.sum(np.diagonal(gaps, 1)) + np.sum(frames.exposure))
    assert spent[0] == min(spent) < before - 5e-3


def test_each_start_of_the_same_frames_is_less_likely(levels, room, monkeypatch):
    """The two likeliest ones first and then the next; of other frames again the likeliest."""
    monkeypatch.setattr(frame_search, "shaken", lambda frames, *_: frames)
    frames, other = _frames(4, 1), _frames(4, 1, seed=4)
    starts = frame_search.rearranged(levels, room)
    wanted = [*frame_search.arrangements(levels, room, frames)][:3]
    wanted += [next(frame_search.arrangements(levels, room, other))]
    found = [*starts(frames), *starts(frames)[:1], *starts(other)[:1]]
    for one, each in zip(found, wanted, strict=True):
        np.testing.assert_array_equal(one.velocity, each.velocity)


@pytest.mark.parametrize("kind", [SWEEP, BRACKETED, FREE])
def test_slopes_of_a_descent_are_those_of_differences(kind, levels, room, monkeypatch):
    """Of the level and of all limits, by numbers of a tie and by those of each frame."""
    seen = {}

    def climbed(error, start, bounds, limits, most):
        seen.update(error=error, at=np.clip(start, *bounds.T), limits=limits, bounds=bounds)
        return start

    monkeypatch.setattr(frame_search, "_climbed", climbed)
    monkeypatch.setattr(frame_search, "_nearest", lambda x, bounds, limits: x)
    shape = Shape(3, 2, 1)
    descent = Descent(levels, room, shape)
    if kind == FREE:
        end = descent.free(_frames(3, 2))
        assert end is None  # their ways are no transfers
    else:
        tie = Tie(kind, room, shape, -700.0, 2400.0, np.ones(1), np.zeros(1))
        end = descent.tied(tie, np.array([0.3, 0.6, 0.41, 0.2]))
        assert end.kind == kind
        assert end.level == pytest.approx(levels.level(end.frames))
        assert -seen["error"](seen["at"])[0] == pytest.approx(end.level)
    at, step = seen["at"], 1e-5
    _, slope = seen["error"](at)
    wanted, rows = [], []
    for one in step * np.eye(at.size):
        ends = [
            (seen["error"](at + sign * one)[0], seen["limits"]["fun"](at + sign * one))
            for sign in (1, -1)
        ]
        wanted.append((ends[0][0] - ends[1][0]) / (2 * step))
        rows.append((ends[0][1] - ends[1][1]) / (2 * step))
    np.testing.assert_allclose(slope, wanted, atol=1e-3 * np.max(np.abs(wanted)))
    found, rows = seen["limits"]["jac"](at), np.array(rows).T
    assert found.shape == rows.shape
    # Limits have corners, at which one side differs from the other.
    apart = np.abs(found - rows) > 1e-3 * (1 + np.abs(rows))
    assert np.mean(apart) < 0.02


def test_a_descent_keeps_to_its_limits():
    """The best of a circle within a half plane, from within it and from beyond."""

    def error(x):
        return float(np.sum((x - 2) ** 2)), 2 * (x - 2)

    limits = {
        "type": "ineq",
        "fun": lambda x: np.array([1.5 - x[0] - x[1]]),
        "jac": lambda x: np.array([[-1.0, -1.0]]),
    }
    bounds = np.array([[-3.0, 3.0], [-3.0, 0.5]])
    for start in ([-1.0, 0.2], [2.5, 0.4]):
        end = frame_search._climbed(error, np.array(start), bounds, limits, 40)
        end = frame_search._nearest(end, bounds, limits)
        np.testing.assert_allclose(end, [1.0, 0.5], atol=1e-5)
    near = frame_search._nearest(np.array([1.3, 0.5]), bounds, limits)
    np.testing.assert_allclose(near, [1.15, 0.35], atol=1e-9)


def test_frames_are_slowed_down_about_their_pan_and_no_more_than_is_needed(scene):
    """By the share beyond a limit; those 5 % beyond it are none."""
    frames = _frames(1, 1)._replace(place=np.full((1, 1), 11.0), pan=np.array([250.0]))
    frames.velocity[0, :, 0] = -1900.0, 2300.0

    def exposures_of(each):
        return sequence_of(each, FREE)

    taken = exposures_of(frames).use_within(LIMITS)
    for over, is_far in ((1.04, False), (1.06, True), (0.97, False)):
        limits = Limits(max_half_exposure=0.02, max_acceleration=float(taken.acceleration) / over)
        found = frame_search.within(limits, frames, exposures_of)
        assert (found is None) == is_far
        if found is None:
            continue
        ends = np.asarray(found.along[0].motion.end_velocities)
        slower = 1 / max(over, 1.0)
        np.testing.assert_allclose(ends, 250 + (np.array([-1900, 2300]) - 250) * slower, rtol=1e-5)
        assert found.share_of(limits) <= 1 + 1e-7


@pytest.mark.parametrize(
    ("levels_of", "tried"),
    [
        (lambda count: 30 + 0.1 * count, [16, 12]),
        (lambda count: 30 - 0.1 * count, [16, 12, 8, 6, 4, 3, 2, 1]),
        (lambda count: 30 - abs(count - 8), [16, 12, 8, 6]),
        (lambda count: 30 + 0.0021 * count, [16, 12, 8, 6]),
    ],
)
def test_ever_fewer_frames_are_tried_while_they_are_as_good(
    levels_of, tried, levels, room, monkeypatch
):
    """At most four fifths of those before, until they are 0.02 dB below the best.

    Half of the bar is theirs: the rest of the search goes on from the best.
    """
    seen, shares = [], []

    def of_number(self, count):
        seen.append(count)
        return [None, End(FREE, _frames(1, 1), levels_of(count))]

    monkeypatch.setattr(Search, "_of_number", of_number)
    search = Search(levels, room, lambda shape: [], lambda count: 1, lambda count: (), False)
    ends = search.ends([1, 2, 3, 4, 6, 8, 12, 16], shares.append)
    assert seen == tried
    assert [end.level for end in ends] == [levels_of(count) for count in tried]
    np.testing.assert_allclose(shares, (1 - np.array(tried) / 17) / 2)


@pytest.mark.parametrize(
    ("is_free", "most", "best", "tried"),
    [
        (True, 64, 64, [64, 51, 24]),
        (True, 64, 40, [64, 51, 40, 32, 24]),
        (True, 25, 25, [25, 24]),
        (True, 64, 24, [64, 51, 40, 32, 25, 24, 19]),
        (False, 64, 64, [64, 51]),
        (False, 25, 25, [25, 20]),
    ],
)
def test_frames_that_share_numbers_are_compared_with_fewer_that_do_not(
    is_free, most, best, tried, levels, room, monkeypatch
):
    """Whatever the level of the former; 24 frames are the most that have numbers of their own."""
    seen = []

    def of_number(self, count):
        seen.append(count)
        return [End(FREE, _frames(1, 1), 30 - abs(count - best))]

    monkeypatch.setattr(Search, "_of_number", of_number)
    monkeypatch.setattr(Search, "_beside", lambda self, every, progress: [])
    search = Search(levels, room, lambda shape: [], lambda count: 1, lambda count: (), is_free)
    search.ends([*range(1, most + 1)], lambda share: None)
    assert seen == tried


def test_free_frames_begin_with_flights_back_and_with_one_long_exposure(levels, room, monkeypatch):
    """And with the best of the other ways; frames at rest are in the middle of the stroke."""
    ties = [STILLS, SWEEP, BRACKETED, ALTERNATING, FOLLOW, PAN]
    shape, starts = Shape(3, 2, 1), []

    def ties_of(shape):
        return [Tie(kind, room, shape, -700.0, 2400.0, np.ones(1), np.zeros(1)) for kind in ties]

    def best(self, tie, starts_of_tie):
        return End(tie.kind, _frames(3, 2, seed=ties.index(tie.kind)), 20.0 - ties.index(tie.kind))

    def free(self, frames):
        starts.append(float(frames.gap[0]))
        return End(FREE, frames, 25.0)

    monkeypatch.setattr(Descent, "best", best)
    monkeypatch.setattr(Descent, "free", free)
    monkeypatch.setattr(frame_search, "shaken", lambda frames, *_: frames)
    search = Search(levels, room, ties_of, lambda count: 2, lambda count: (), True)
    ends = search._of_number(3)
    assert [end.kind for end in ends] == [*ties, *[FREE] * 4]
    begun = [ties.index(kind) for kind in (PAN, FOLLOW, BRACKETED, STILLS)]
    assert starts == [_frames(3, 2, seed=seed).gap[0] for seed in begun]
    at_rest = ties_of(shape)[2].frames(np.array([0.5, 0.0, 0.5, 0.5]))
    np.testing.assert_array_equal(at_rest.place, np.full((3, 1), room.stroke / 2))
    assert not at_rest.velocity.any()


# ---- levels of paths --------------------------------------------------------------------------


@pytest.mark.parametrize("pieces", [1, 3])
def test_levels_of_a_search_are_those_of_the_frames_that_are_made(pieces, levels):
    """Along an axis, by nodes of the motions."""
    frames = _frames(3, pieces)
    instants = Instants.of(sequence_of(frames, FREE).frames, 2400.0)
    np.testing.assert_allclose(
        levels.errors_at(instants), levels.errors(frames), rtol=1e-4, atol=1e-9
    )
    assert levels.lost_untold(instants, instants) == pytest.approx(0, abs=1e-9)


def test_a_decoder_that_is_not_told_the_way_loses_what_its_filters_leave(levels):
    """By the filters written out, at the best whole pixel for each speed."""
    told, seen = (
        Instants.of(sequence_of(_frames(2, 1, seed=k), FREE).frames, 2400.0) for k in (3, 4)
    )
    told = told._replace(place=told.place / 8)
    seen = seen._replace(place=seen.place / 8 + 3)

    def waves(each, f, temporal):
        ways = -2j * np.pi * (f * each.place[0] - temporal * each.time)
        return np.sum(each.weight * np.exp(ways), axis=1)

    length = np.asarray(told.exposure)
    electrons = 1.1e5 * length
    gain = electrons**2 / (0.25 * electrons + 36.0)
    some, over, shifts = range(0, levels.signal.size, 7), 0.0, np.arange(-20, 21)
    least = np.zeros((levels.temporal.shape[1], shifts.size))
    part = levels._replace(
        **{
            name: getattr(levels, name)[::7]
            for name in ("frequency", "temporal", "weight", "signal")
        }
    )
    for m in some:
        f, power = levels.frequency[m, 0], levels.signal[m]
        for k, temporal in enumerate(levels.temporal[m]):
            mine, truth = waves(told, f, temporal), waves(seen, f, temporal)
            whole = 1 + power * np.sum(gain * np.abs(mine) ** 2)
            filters = power * gain * mine.conj() / whole
            noise = np.sum(np.abs(filters) ** 2 / gain) / power
            passed = np.sum(filters * truth) * np.exp(2j * np.pi * f * shifts)
            least[k] += levels.weight[m, k] * (np.abs(1 - passed) ** 2 + noise)
            over += levels.weight[m, k] / whole
    assert np.any(np.argmin(least, axis=1) != 20)
    wanted = 10 * np.log10(np.sum(np.min(least, axis=1)) / over)
    assert wanted > 0.5
    assert part.lost_untold(told, seen) == pytest.approx(wanted, rel=1e-6)


PLANE = {
    "max_stroke": 40.0,
    "max_half_exposure": 0.01,
    "max_acceleration": 9e5,
    "max_top_speed": 2900.0,
}


def _plane_search(**others):
    law = EvenVelocities(1700.0, 1100.0, angle=0.3, mean=[200.0, -90.0])
    burst = BurstMode(frames_per_s=90.0, window=0.05, max_frames=4)
    light = {"photon_rate": 3e4, "read_noise": 9.0, "burst": burst}
    scene = Scene.any_direction(law, limits=Limits(**(PLANE | others)), **light)
    return plane_frames._PlaneSearch.of(scene)


@pytest.mark.parametrize("pans", ["stage", "camera"])
@pytest.mark.parametrize("axes", ["each", "disc"])
def test_a_path_in_the_plane_leads_through_the_places_of_its_frames(axes, pans):
    """At their velocities, within the limits between them; its level is that of the search."""
    search = _plane_search(axes=axes, pans=pans)
    stage = search.stage(2)
    tie = stage._tie(TWO_SINES, Shape(3, 5, 2))
    frames = tie.frames(np.array([0.6, 0.5, 0.5, 0.35, 0.3, 0.2]))
    # Somewhat aside, so that the ways between them have a coast.
    frames = frames._replace(place=frames.place + np.array([[0.0, 0.0], [1.1, -0.7], [0.3, 0.4]]))
    path = stage.made(frames)
    turned = search.offset
    assert (np.hypot(*turned) > 0) == (pans == "camera")
    begins, ends = path.times - path.exposures / 2, path.times + path.exposures / 2
    np.testing.assert_allclose(path.exposures, frames.exposure)
    np.testing.assert_allclose(begins[1:] - ends[:-1], frames.gap)
    assert begins[0] == pytest.approx(-ends[-1])
    # In the camera's frame the stage is at its places, and has its velocities.
    of_stage = path.place(begins).T - np.outer(begins - begins[0], turned)
    np.testing.assert_allclose(of_stage, frames.place - frames.place[0], atol=1e-9)
    step = 1e-7
    slopes = (path.place(begins + 2 * step) - path.place(begins + step)).T / step - turned
    np.testing.assert_allclose(slopes, frames.velocity[:, 0], atol=1.0)
    slopes = (path.place(ends - step) - path.place(ends - 2 * step)).T / step - turned
    np.testing.assert_allclose(slopes, frames.velocity[:, -1], atol=1.0)
    between = np.diff(path.velocities) / np.where(path.durations > 0, path.durations, np.inf)
    outside = np.array(
        [not np.any((begins <= t) & (t <= ends)) for t in (path.bends[1:] + path.bends[:-1]) / 2]
    )
    size = np.linalg.norm(between, 2 if axes == "disc" else math.inf, axis=0)[outside]
    assert size.size > 2
    assert np.max(size) <= 9e5 * (1 + 1e-6)
    seen = Instants.of(path, search.law.fastest)
    of_stage = seen._replace(place=seen.place - turned[:, None, None] * seen.time)
    errors = stage.levels.errors(frames)
    np.testing.assert_allclose(stage.levels.errors_at(of_stage), errors, rtol=1e-3, atol=1e-9)


# ---- levels that are told along an axis -------------------------------------------------------


def _alternating():
    """Two swings against each other and a pan, whose ways have room between them."""
    exposure = np.array([0.008, 0.006, 0.005])
    velocity = np.array([[-1500.0, 0.0, 1500.0], [1100.0, 0.0, -1100.0], [300.0, 300.0, 300.0]])
    place = np.array([[12.0], [15.0], [11.0]])
    gap = np.array([0.011, 0.012])
    return sequence_of(Frames(exposure, velocity[..., None], gap, place, np.zeros(1)), FREE)


@pytest.mark.parametrize("readout", [0.0, 0.009])
def test_levels_that_are_told_are_those_of_the_exposures(readout, scene):
    """In the mean over the speeds by their weights, and at the worst; with rows and borders too."""
    sequence = _alternating()
    sensor = Sensor(readout=readout) if readout else Sensor(width=260.0)
    own = replace(scene, sensor=sensor)
    told = moving_frames._levels_by_rows if readout else moving_frames.levels_of
    mean, worst = told(own, sequence if readout else sequence.along)
    assert mean == pytest.approx(float(exposures_psnr(own, sequence)), abs=5e-3)
    each = [
        float(exposures_psnr(replace(own, speeds=[v], weights=[1.0]), sequence)) for v in FOLLOWED
    ]
    assert np.ptp(each) > 1
    assert worst == pytest.approx(min(each), abs=5e-3)
    if readout:
        path = replace(sequence, frames=sequence.path_for_rows(readout, own.limits))
        lost = float(exposures_psnr(scene, path)) - mean
    else:
        lost = loss_of_width(own, sequence, width=260.0)
    assert lost > 0.1
    found = moving_frames._Found(sequence, mean + lost, _frames(3, 2)).on_sensor(own)
    wanted = mean if readout else mean + lost - lost
    assert found.level == pytest.approx(wanted, abs=5e-3)


def test_ends_are_judged_down_to_half_a_decibel_below_the_best(scene, monkeypatch):
    """From the best on, one beyond the limits aside; on a sensor of a known width all are."""
    judged = []

    def of(scene, end):
        judged.append(end.level)
        return (
            None
            if end.level == 30.2
            else moving_frames._Found(_alternating(), end.level, end.frames)
        )

    monkeypatch.setattr(moving_frames._Found, "of", staticmethod(of))
    ends = [End(FREE, _frames(1, 1), level) for level in (29.6, 30.2, 30.0, 29.4, 29.3)]
    found = moving_frames._judged(scene, ends)
    assert judged == [30.2, 30.0, 29.6]
    assert [each.level for each in found] == [30.0, 29.6]
    found = moving_frames._judged(replace(scene, sensor=Sensor(width=90.0)), ends)
    assert [each.level for each in found] == [30.0, 29.6, 29.4, 29.3]


@pytest.mark.parametrize("most", [400.0, 5e3])
def test_a_camera_turns_where_that_spares_its_stage(most):
    """By the mean of the velocities, as far as it can; the sensor goes as it went."""
    limits = Limits(max_stroke=40.0, max_pan=most, pans="camera", max_half_exposure=0.02)
    scene = _scene(limits)
    frames = _frames(2, 2)
    frames.velocity[..., 0] = [[600.0, 900.0, 1100.0], [1000.0, 700.0, 500.0]]
    on = 875 * frames.exposure[0] + 1050 * frames.gap[0]  # as the sensor goes on
    frames = frames._replace(place=np.array([[0.0], [on]]))
    turned = moving_frames._spared(scene, frames)
    np.testing.assert_allclose(turned.pan, [min(800.0, most)])
    assert sequence_of(turned, FREE).share_of(limits) < sequence_of(frames, FREE).share_of(limits)
    np.testing.assert_array_equal(turned.velocity, frames.velocity)
    # Between frames the stage goes on from one velocity to the other.
    step = (turned.velocity - turned.pan)[:, 1:] + (turned.velocity - turned.pan)[:, :-1]
    way = np.sum(step[0]) / 2 * frames.exposure[0] / 2
    beside = frames.velocity[0, -1, 0] + frames.velocity[1, 0, 0] - 2 * turned.pan[0]
    assert turned.place[1, 0] - turned.place[0, 0] == pytest.approx(
        way + frames.gap[0] * beside / 2
    )
    back = frames._replace(velocity=frames.velocity * [[[1.0]], [[-1.0]]])
    np.testing.assert_allclose(moving_frames._spared(scene, back).velocity, back.velocity)


# ---- the search in the plane ------------------------------------------------------------------

COARSE = Grid(6, 4, 6, 2)
LISTED = ListedVelocities([[900.0, 300.0], [1100.0, -500.0], [-200.0, 100.0]], [0.4, 0.35, 0.25])


def _of_list(law=LISTED, width=190.0, most=4, **others):
    burst = BurstMode(frames_per_s=90.0, window=0.05, max_frames=most)
    light = {"photon_rate": 3e4, "read_noise": 9.0, "burst": burst, "sensor": Sensor(width=width)}
    return Scene.any_direction(law, limits=Limits(**(PLANE | others)), **light)


def _level(scene, frames):
    return float(exposures_psnr(scene, frames, grid=COARSE))


def _ceiling(scene, exposures):
    return exposures_ceiling(scene, exposures, grid=COARSE)


@pytest.fixture
def starts_alone(monkeypatch):
    """A search whose descents end where they begin."""

    def tied(self, tie, start):
        frames = tie.frames(start)
        return End(tie.kind, frames, self.levels.level(frames))

    monkeypatch.setattr(Descent, "tied", tied)
    monkeypatch.setattr(Descent, "free", lambda self, x: End(FREE, x, self.levels.level(x)))
    monkeypatch.setattr(plane_frames, "SEARCHED", COARSE)
    monkeypatch.setattr(plane_frames, "exposures_psnr", _level)
    monkeypatch.setattr(plane_frames, "exposures_ceiling", _ceiling)


@pytest.mark.parametrize(("axes", "most"), [("one", 2), ("each", 3)])
def test_frames_of_each_way_are_measured_within_the_limits(axes, most, starts_alone):
    """Their level, travel, pan and loss are their own; no way on two axes where there is one."""
    scene, shares = _of_list(axes=axes, max_stroke=70.0, most=most), []
    search = plane_frames._PlaneSearch.of(scene)
    found = search.found(shares.append)
    assert shares == sorted(shares)
    assert search.counts == [2, 3][: most - 1]
    assert found.snapshot.num_frames == 1
    assert not found.snapshot.moves
    kinds = {number: [x.kind for x in found.bursts if x.num_axes == number] for number in range(3)}
    assert kinds[0] == [STILLS]
    assert set(kinds[1]) <= {*WAYS, FREE}
    assert len(kinds[1]) > 1
    assert (len(kinds[2]) > 0) == (axes == "each")
    along = np.array([math.cos(LISTED.axis), math.sin(LISTED.axis)])
    stills, *moving = found.bursts
    for burst in (found.snapshot, stills):
        assert not burst.moves
        assert burst.psnr == pytest.approx(float(exposures_psnr(scene, burst)), abs=2e-3)
    for burst in moving:
        assert burst.psnr == _level(scene, burst.frames)
        assert burst.share_of(scene.limits) <= 1 + 1e-6
        assert burst.travel == float(burst.use_within(scene.limits).travel)
        assert burst.pan == (0.0, 0.0)
        assert burst.width_loss is not None
        if burst.num_axes == 1:
            aside = burst.frames.velocities - np.outer(along, along @ burst.frames.velocities)
            np.testing.assert_allclose(aside, 0, atol=1e-6)
    loss = loss_of_width(scene, found.bursts[-1].frames, width=190.0)
    assert found.bursts[-1].width_loss == pytest.approx(loss) != 0
    times = search.times
    counts = {*search.counts, stills.num_frames}
    ceilings = [_ceiling(scene, np.full(n, times.longest_of(n))) for n in counts]
    assert found.ceiling == max(ceilings)


def test_more_frames_and_free_ones_are_taken_where_they_gain_enough(monkeypatch):
    """A 40th of a decibel by each number of frames, and 0.05 dB over all ways of a name."""

    def burst(self, stage, end):
        return replace(NAMED, kind=end.kind, psnr=end.level)

    monkeypatch.setattr(plane_frames._PlaneSearch, "_burst", burst)
    search = plane_frames._PlaneSearch.of(_of_list())
    stage = search.stage(2)

    def ends(kind, *levels):
        return [
            None if x is None else End(kind, _frames(k + 2, 1, 2), x) for k, x in enumerate(levels)
        ]

    every = [*ends(SWEEP, 25.0, 25.02, 25.04), *ends(RING, None, 24.0, 23.0), *ends(CIRCLE, None)]
    chosen = search._bursts(stage, every)
    assert [(x.kind, x.psnr) for x in chosen] == [(SWEEP, 25.04), (RING, 24.0)]
    chosen = search._bursts(stage, ends(SWEEP, 25.0, 25.024))
    assert [x.psnr for x in chosen] == [25.0]

    named = {TWO_SINES: 26.0, RING: 25.0}
    for gain, number in ((0.049, 0), (0.051, 1)):

        def best(self, kind, count, **some):
            return End(kind, _frames(count, 1, 2), named[kind]) if kind in named else None

        monkeypatch.setattr(plane_frames._Stage, "best", best)
        monkeypatch.setattr(
            plane_frames._Stage,
            "free",
            lambda self, *ends, progress, level=26.0 + gain: [End(FREE, _frames(2, 1, 2), level)],
        )
        flat = [End(SWEEP, _frames(2, 1), 24.0), None]
        found = search._on_two_axes(search.stage(1), flat, [], lambda share: None)
        assert [x.kind for x in found] == [TWO_SINES, RING] + number * [FREE]
        # One on a single axis counts among the ways of a name.
        better = [replace(NAMED, kind=SWEEP, psnr=26.1)]
        found = search._on_two_axes(search.stage(1), flat, better, lambda share: None)
        assert [x.kind for x in found] == [TWO_SINES, RING]


NAMED = Exposures(
    SWEEP, FramePath(np.zeros(1), np.full(1, 0.01), np.full(1, 0.01), np.ones((2, 2))), 1.0
)


def test_frames_along_an_axis_are_the_same_in_the_plane():
    """By more pieces too: where they are at each time, along the direction of the axis."""
    search = plane_frames._PlaneSearch.of(_of_list(max_stroke=70.0))
    one, two = search.stage(1), search.stage(2)
    frames = one._tie(SWEEP, Shape(3, 2, 1)).frames(np.array([0.9, 0.2, 0.4, 0.3]))
    turned = plane_frames._on_plane(plane_frames._resampled(frames, 6), one.unit)
    assert turned.velocity.shape == (3, 7, 2)
    np.testing.assert_allclose(np.mean(turned.place, axis=0), np.mean(frames.place))
    paths = one.made(frames), two.made(turned)
    within = paths[0].times[:, None] + paths[0].exposures[:, None] * np.linspace(-0.49, 0.49, 7)
    places = [path.place(within) for path in paths]
    apart = places[1] - places[0]
    np.testing.assert_allclose(apart, np.broadcast_to(apart[:, :1, :1], apart.shape), atol=1e-6)
    np.testing.assert_allclose(paths[0].times, paths[1].times)
    assert two.levels.level(turned) == pytest.approx(one.levels.level(frames), abs=1e-5)


def test_ways_are_about_the_things_that_occur():
    """Beside the velocity at which the camera turns; a thing of no weight counts for nothing."""
    law = ListedVelocities([[900.0, 300.0], [1100.0, -500.0], [-4e3, 100.0]], [0.4, 0.6, 0.0])
    turning = plane_frames._PlaneSearch.of(_of_list(law, pans="camera", max_pan=260.0))
    for search in (plane_frames._PlaneSearch.of(_of_list(law)), turning):
        stage, axis = search.stage(2), law.axis
        along = np.array([math.cos(axis), math.sin(axis)])
        tie = stage._tie(RING, Shape(4, 1, 2))
        seen = np.array([[900.0, 300.0], [1100.0, -500.0]]) - search.offset
        assert tie.slowest == pytest.approx(np.min(seen @ along))
        assert tie.fastest == pytest.approx(np.max(seen @ along))
        middle = np.array([0.4, 0.6]) @ seen
        np.testing.assert_allclose(tie.across, middle - along * (along @ middle), atol=1e-9)
        across = np.array([-along[1], along[0]])
        assert tie.widest == pytest.approx(np.max(np.abs(np.asarray(law.velocities)[:2] @ across)))
    np.testing.assert_allclose(turning.offset, 260 * law.centre / np.hypot(*law.centre))
    top = PLANE["max_top_speed"] - 260
    assert turning.stage(1).room.top_speed == pytest.approx(top)


def test_stills_of_a_camera_that_turns_are_those_of_things_about_rest():
    """The best of one frame and of several, for the velocities less their mean."""
    about_rest = ListedVelocities(np.asarray(LISTED.velocities) - LISTED.centre, LISTED.weights)
    found = plane_frames.stills_on_pan(_of_list(max_top_speed=100.0, max_pan=20.0))
    rest = _of_list(about_rest)
    search = plane_frames._PlaneSearch.of(rest)
    several = search.times, search.times._replace(max_frames=1)
    best = max(map(search.stills, several), key=lambda burst: burst.level)
    assert found.level == pytest.approx(best.level, abs=1e-3)
    np.testing.assert_allclose(found.pan, LISTED.centre, rtol=1e-6)
    assert found.exposures == pytest.approx(best.exposures)
    assert found.num_axes == 0
