"""The search in the plane: its ways within limits, its order, and the answer."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from mishutter import (
    BurstMode,
    EvenVelocities,
    Limits,
    ListedVelocities,
    Objects,
    Occlusion,
    Scene,
    Sensor,
    best_in_plane,
    cli,
    exposures_psnr,
)
from mishutter.cli.plane_command import _require_frames
from mishutter.evaluation.bursts import FrameTimes, StillBursts
from mishutter.evaluation.fans import MEASURED, Grid
from mishutter.evaluation.registration import loss_of_width
from mishutter.model.exposures import Exposures
from mishutter.model.frame_path import PlaneFrames
from mishutter.report.documents import Report
from mishutter.report.in_plane import answer_in_plane, compare_in_plane
from mishutter.report.plots import plot_design
from mishutter.search.frame_levels import Frames, Levels, Shape
from mishutter.search.frame_limits import Room
from mishutter.search.frame_search import Descent, End
from mishutter.search.frame_ties import FREE, RING, STILLS, SWEEP, WAYS, WAYS_ON_TWO_AXES, Tie
from mishutter.search.plane_frames import PlaneSearch, _PlaneSearch, _Stage, search_words

LIMITS = Limits(max_stroke=24.0, max_half_exposure=0.01, max_acceleration=9e5, max_travel=31.0)
BURST = BurstMode(frames_per_s=90.0, window=0.05, max_frames=4)


def a_scene(limits: Limits = LIMITS, **others) -> Scene:
    law = EvenVelocities(1700.0, 1100.0, angle=0.3)
    parts = {"photon_rate": 3e4, "read_noise": 9.0, "limits": limits, "burst": BURST}
    return Scene.any_direction(law, **(parts | others))


def test_a_path_is_where_its_velocities_lead():
    """Places by the trapezoids of the velocities, between knots too; a jump takes no time."""
    frames = PlaneFrames(
        np.array([0.01]),
        np.array([0.02]),
        np.array([0.005, 0.0, 0.015]),
        np.array([[100.0, 300.0, -200.0, 0.0], [0.0, 0.0, 40.0, 40.0]]),
    )
    place = np.asarray(frames.place(np.array([0.0, 0.0025, 0.005, 0.02])))
    np.testing.assert_allclose(place[0], [0, 0.375, 1.0, -0.5], atol=1e-12)
    np.testing.assert_allclose(place[1], [0, 0, 0, 0.6], atol=1e-12)


def a_room(limits: Limits = LIMITS) -> Room:
    scene = a_scene(limits)
    return Room.of(scene.limits, FrameTimes.of(scene, scene.burst), 1700.0)


def test_ways_about_a_mean_are_as_wide_across_as_things_are():
    """Four velocities on an ellipse, whose axes are along the unit and across it."""
    unit, across = np.array([0.6, 0.8]), np.array([-0.8, 0.6])
    tie = Tie(RING, a_room(), Shape(4, 2, 2), -700.0, 1300.0, unit, 40.0 * across, widest=250.0)
    velocity = tie.frames(np.array([0.5, 0.0, 0.5, 0.4, 0.5])).velocity
    np.testing.assert_allclose(np.diff(velocity, axis=1), 0, atol=1e-9)
    beside = velocity[:, 0] - np.mean(velocity[:, 0], axis=0)
    size = 1.5 * 0.4 * np.sqrt(0.5)
    np.testing.assert_allclose(np.abs(beside @ unit), size * 1000)
    np.testing.assert_allclose(np.abs(beside @ across), size * 250)
    np.testing.assert_allclose(np.mean(velocity[:, 0], axis=0), 300 * unit + 40 * across)


def test_a_camera_that_turns_sees_things_at_what_is_left_of_their_velocities():
    """Frames that move by its pan more have the level of those of a camera that stands."""
    scene, pan = a_scene(), np.array([300.0, -200.0])
    draw = np.random.default_rng(4)
    frames = Frames(
        np.array([4e-3, 7e-3]),
        draw.normal(0, 600, (2, 3, 2)),
        np.array([3e-3]),
        np.zeros((2, 2)),
        np.zeros(2),
    )
    grid = Grid(8, 6, 8)
    standing = Levels.in_plane(scene, grid, np.eye(2), np.zeros(2)).level(frames)
    turning = Levels.in_plane(scene, grid, np.eye(2), pan)
    beside = frames._replace(velocity=frames.velocity - pan)
    assert turning.level(beside) == pytest.approx(standing, abs=1e-9)
    assert abs(turning.level(frames) - standing) > 1e-3


def _along(turns: np.ndarray, knots) -> np.ndarray:
    """Velocities of a path along some directions."""
    return np.stack([np.cos(turns), np.sin(turns)], axis=-1) @ knots.velocities


@pytest.mark.slow
@pytest.mark.parametrize("axes", ["one", "each", "disc"])
def test_frames_keep_the_limits(axes):
    """Travel, stroke, speed and acceleration by places and velocities of the path itself.

    Progress goes on through the paths of two axes, which take longest.
    """
    most, top, shares = 9e5, 1200.0, []
    limits = replace(LIMITS, axes=axes, max_top_speed=top, max_stroke=8.0, max_travel=9.0)
    burst = BurstMode(frames_per_s=90.0, window=0.023, max_frames=2)
    found = best_in_plane(a_scene(limits, burst=burst), progress=shares.append)
    assert shares == sorted(shares)
    late = [share for share in shares if share >= 0.6]
    assert late == pytest.approx([] if axes == "one" else [0.6, 0.7, 0.8, 0.9])
    assert max(each.num_axes for each in found.bursts) == (1 if axes == "one" else 2)
    turns = np.linspace(0, np.pi, 37) if axes == "disc" else np.array([0, np.pi / 2])
    for each in found.bursts:
        assert each.num_frames <= 2
        assert each.frames.duration <= 0.023 * (1 + 1e-6)
        if each.frames.stays:
            continue
        own = turns if each.num_axes == 2 else np.array([0, np.pi / 2])
        knots = each.frames.knots(limits)
        velocity, lasts = _along(own, knots), knots.durations > 0
        if each.num_axes == 1:  # along that of the fastest things
            across = _along(np.array([0.3 + np.pi / 2]), knots)
            np.testing.assert_allclose(across, 0, atol=1e-6)
        gains = np.abs(np.diff(velocity))
        assert (gains[:, lasts] / knots.durations[lasts]).max() <= most * (1 + 1e-3)
        assert np.abs(velocity).max() <= top * (1 + 1e-3)
        place = np.cumsum((velocity[:, 1:] + velocity[:, :-1]) / 2 * knots.durations, axis=1)
        assert np.ptp(place, axis=1).max() <= 9 * (1 + 1e-2)
        lit = place[:, knots.first - 1 : knots.last]
        assert np.ptp(lit, axis=1).max() <= 8 * (1 + 1e-3)


@pytest.mark.slow
def test_paths_of_the_stage_are_those_of_the_frames(searched):
    """Along each axis within a frame, but for a constant, and at rest before and after."""
    scene = a_scene()
    burst = max(searched.bursts, key=lambda each: each.level)
    paths = list(burst.stage_paths(scene).values())
    assert len(paths) == 2
    for time, exposure in zip(burst.times, burst.exposures, strict=True):
        within = time + np.linspace(-0.49, 0.49, 9) * exposure
        wanted = burst.place(within[None])[:, 0]
        for path, own in zip(paths, wanted, strict=True):
            np.testing.assert_allclose(np.diff(path.at(within)[0]), np.diff(own), atol=1e-3)
    for path in paths:
        assert np.all(path.at(path.times[[0, -1]] + np.array([-1.0, 1.0]))[1] == 0)


@pytest.mark.slow
def test_frames_pan_with_velocities_that_have_a_mean():
    """Things that all move one way are followed; a camera that turns leaves its stage the rest."""
    law = ListedVelocities([[900.0, 300.0], [1100.0, 500.0]])
    burst = BurstMode(frames_per_s=90.0, window=0.023, max_frames=2)
    light = {"photon_rate": 3e4, "read_noise": 9.0, "burst": burst}
    levels = {}
    for pans in ("stage", "camera"):
        limits = Limits(max_stroke=5.0, max_half_exposure=0.01, pans=pans)
        scene = Scene.any_direction(law, limits=limits, **light)
        found = best_in_plane(scene)
        best = max(found.bursts, key=lambda each: each.level)
        levels[pans] = best.level
        assert best.stroke <= 5 * (1 + 1e-3)
        middle = np.mean(best.frames.velocities, axis=1)
        if pans == "camera":
            np.testing.assert_allclose(middle, [1000.0, 400.0], rtol=0.25)
            assert float(best.frames.use(limits).stroke) > 10
    assert levels["camera"] > levels["stage"] + 0.5


@pytest.mark.slow
def test_a_camera_without_a_stage_takes_stills():
    """A stroke of 0 leaves frames at rest, of one exposure or two, and one exposure."""
    found = best_in_plane(a_scene(Limits(max_stroke=0.0, max_half_exposure=0.01, axes="one")))
    assert found.snapshot.num_frames == 1
    for each in found.bursts:
        assert each.stroke < 0.01
    assert max(each.level for each in found.bursts) > found.snapshot.level
    assert max(each.level for each in found.bursts) < found.ceiling


@pytest.fixture(scope="module")
def searched() -> PlaneSearch:
    return best_in_plane(a_scene())


@pytest.mark.slow
def test_a_search_orders_ways_as_the_physics_does(searched):
    """Two sines beat one axis, one axis beats stills, and nothing beats the ceiling."""
    levels = {burst.kind: burst.psnr for burst in searched.bursts}
    assert searched.snapshot.psnr < levels["stills"] < levels["sweep"] < levels["two sines"]
    assert max(levels.values()) < searched.ceiling
    assert searched.ceiling - levels["two sines"] < 0.6
    assert levels["two sines"] > levels["stills"] + 0.7
    if FREE in levels:
        assert levels[FREE] >= max(x for kind, x in levels.items() if kind != FREE) + 0.05
    for burst in searched.bursts:
        assert burst.travel <= 31 * 1.01
        assert burst.num_frames <= 4


def a_burst(kind: str, num_axes: int, psnr: float, count: int = 4) -> Exposures:
    times = np.arange(count) * 0.01
    turns = -1.0 if num_axes == 2 else 1.0
    velocities = 700.0 * num_axes * np.array([[1.0, 1.0], [1.0, turns]])
    frames = PlaneFrames(times, np.full(count, 0.008), np.array([0.04]), velocities)
    use = frames.use(LIMITS)
    return Exposures(
        kind, frames, float(use.travel), psnr, pan=(0.0, 0.0), lit_travel=float(use.stroke)
    )


@pytest.mark.parametrize(
    ("one", "two", "free", "kind"),
    [
        (26.1, 26.19, None, "stills"),
        (26.3, 26.45, None, "sweep"),
        (26.3, 26.9, None, "two sines"),
        (26.3, 26.9, 26.93, "two sines"),
        (26.3, 26.9, 27.09, "two sines"),
        (26.3, 26.9, 27.11, FREE),
    ],
)
def test_the_simplest_of_equals_is_recommended(one, two, free, kind):
    """A stage must be worth 0.2 dB, a second axis as much again, and a free path as well."""
    bursts = [a_burst("stills", 0, 26.0), a_burst("sweep", 1, one)]
    bursts += [a_burst("circle", 2, two - 0.06), a_burst("two sines", 2, two)]
    bursts += [a_burst(FREE, 2, free)] if free else []
    search = PlaneSearch(a_burst("stills", 0, 24.5, 1), tuple(bursts), 27.3)
    answer = answer_in_plane(a_scene(), search)
    assert answer.choice.exposures.kind == kind
    text = answer.text()
    level = f"{answer.choice.psnr:.1f} dB, {answer.choice.psnr - 24.5:.1f} dB better"
    assert level in text.splitlines()[0]
    assert "ceiling of any path" in text
    document = json.loads(json.dumps(answer.to_dict()))
    assert document["choice"] == answer.choice.name
    assert [each["kind"] for each in document["rows"]] == [
        "stills",
        *(each.kind for each in bursts),
    ]


@pytest.mark.parametrize("ends_well", [True, False])
def test_a_free_path_of_one_exposure_ends_on_the_grid_of_levels(monkeypatch, ends_well):
    """From the better of two ends on a coarser grid, which is kept where that leads nowhere."""
    search = _PlaneSearch.of(a_scene(burst=None, decoder_speed="known"))
    stage, sizes, levels = search.stage(2), [], iter([27.1, 27.3, 27.2])
    place = np.zeros((1, 2))
    ways = [
        Frames(np.full(1, 8e-3), np.full((1, 17, 2), v), np.zeros(0), place, np.zeros(2))
        for v in (200.0, 500.0)
    ]

    def free(descent, start):
        sizes.append((descent.shape.pieces, len(descent.levels.weight)))
        last = len(sizes) == 3
        return End(FREE, start, next(levels)) if ends_well or not last else None

    monkeypatch.setattr(Descent, "free", free)
    ends = [[End(SWEEP, each, 27.0), None] for each in ways]
    (found,) = stage.free(*ends, progress=lambda share: None)
    searched, told = (
        len(Levels.in_plane(search.scene, grid, np.eye(2), np.zeros(2)).weight)
        for grid in (Grid(96, 4, 16, 4), MEASURED)
    )
    assert sizes == [(8, searched), (8, searched), (8, told)]
    assert found.level == (27.2 if ends_well else 27.3)
    np.testing.assert_allclose(found.frames.velocity, 500, atol=100)


@pytest.mark.slow
def test_long_exposures_of_fast_things_gain_by_a_path_of_their_own():
    """Beside two sines; a descent that trusted a coarse grid gained 0.03 dB of what is told."""
    limits = Limits(
        max_stroke=60.0,
        max_travel=80.0,
        max_acceleration=1.5e6,
        max_top_speed=2e4,
        max_half_exposure=0.025,
    )
    light = {"photon_rate": 1.2e4, "read_noise": 6.0, "decoder_speed": "known"}
    scene = Scene.any_direction(EvenVelocities(3000.0), limits=limits, **light)
    found = {burst.kind: burst.psnr for burst in best_in_plane(scene).bursts}
    others = max(level for kind, level in found.items() if kind != FREE)
    assert found[FREE] > others + 0.08


@pytest.mark.parametrize(("level", "has_free"), [(27.24, False), (27.26, True)])
def test_free_frames_are_sought_from_the_best_of_one_axis_and_of_two(monkeypatch, level, has_free):
    """All ways at all numbers of frames; on two axes again where the first of them are best."""
    asked, given = [], []
    levels = dict.fromkeys(WAYS, 25.0) | {SWEEP: 27.0} | dict.fromkeys(WAYS_ON_TWO_AXES, 27.2)

    def best(stage, kind, count, *, first=0, most=None):
        asked.append((kind, count, first, most))
        place = np.arange(2.0, 2 + count * len(stage.unit)).reshape(count, -1)
        velocity, nothing = np.full((count, 2, len(stage.unit)), 300.0), np.zeros(len(stage.unit))
        frames = Frames(np.full(count, 4e-3), velocity, np.full(count - 1, 5e-3), place, nothing)
        return End(kind, frames, levels[kind] - abs(count - 3))

    def free(stage, *ends, progress):
        given.extend(ends)
        return [End(FREE, ends[1][-1].frames, level)]

    def burst(search, stage, end):
        return a_burst(end.kind, len(stage.unit), end.level, end.frames.exposure.size)

    stills = lambda search, times: a_burst(STILLS, 0, 26.0, times.max_frames)  # noqa: E731
    monkeypatch.setattr(StillBursts, "best_sequence", stills)
    monkeypatch.setattr(_PlaneSearch, "stills", stills)
    monkeypatch.setattr(_PlaneSearch, "_burst", burst)
    monkeypatch.setattr(_PlaneSearch, "_ceiling", lambda *_: 28.0)
    monkeypatch.setattr(_Stage, "best", best)
    monkeypatch.setattr(_Stage, "free", free)
    found = best_in_plane(a_scene())
    twice = [(kind, 3, 1, None) for kind in WAYS_ON_TWO_AXES]
    every = [(kind, count, 0, None) for count in (2, 3, 4) for kind in WAYS]
    every += [(kind, count, 0, 1) for count in (2, 3, 4) for kind in WAYS_ON_TWO_AXES]
    assert asked == every + twice
    kinds = [STILLS, *WAYS, *WAYS_ON_TWO_AXES, *[FREE] * has_free]
    assert [each.kind for each in found.bursts] == kinds
    assert (found.snapshot.num_frames, found.bursts[0].num_frames) == (1, 4)
    assert [each.num_frames for each in found.bursts[1:]] == [3] * (len(kinds) - 1)
    flat, on_two_axes = given
    assert [end.kind for end in flat] == [kind for kind, *_ in every[: len(flat)]]
    assert [end.kind for end in on_two_axes] == [kind for kind, *_ in asked[len(flat) :]]
    unit = np.array([np.cos(0.3), np.sin(0.3)])
    np.testing.assert_allclose(flat[0].frames.place, 2.5 + np.outer([-0.5, 0.5], unit))
    np.testing.assert_allclose(flat[0].frames.velocity, np.broadcast_to(300 * unit, (2, 2, 2)))


def test_frames_that_lose_more_at_the_borders_of_a_sensor_are_not_recommended():
    """Levels are those on the sensor, whose loss is said; without a width it is an assumption."""
    stills = replace(a_burst("stills", 0, 26.0), width_loss=0.21)
    sines = replace(a_burst("two sines", 2, 26.6), width_loss=0.72)
    search = PlaneSearch(a_burst("stills", 0, 24.5, 1), (stills, sines), 27.3)
    wide = a_scene(sensor=Sensor(width=190.0))
    answer = answer_in_plane(wide, search)
    assert answer.choice.exposures.kind == "stills"
    text = " ".join(answer.text().split())
    assert "25.8 dB, 1.3 dB better" in text
    assert answer.details == ("Points that leave the sensor cost 0.21 dB of the level.",)
    assert "not counted" not in text
    assert answer.to_dict()["options"][1]["width_loss_db"] == 0.21
    assert "borders cost more" not in text
    lengths = np.array([0.005, 0.008, 0.006, 0.003])  # of which the longest counts
    uneven = replace(sines.frames, exposures=lengths)
    sines = replace(sines, width_loss=0.3, frames=uneven)
    narrow = a_scene(sensor=Sensor(width=54.0))
    text = answer_in_plane(narrow, replace(search, bursts=(stills, sines))).text()
    assert "borders cost more than is counted: things move by 14 px" in " ".join(text.split())
    sines = replace(sines, width_loss=0.72)
    bare = [replace(each, width_loss=None) for each in (stills, sines)]
    answer = answer_in_plane(a_scene(), replace(search, bursts=tuple(bare)))
    assert answer.choice.exposures.kind == "two sines"
    assert "leave are not counted (else say [sensor] width_px)" in " ".join(answer.text().split())


@pytest.mark.slow
def test_frames_are_measured_on_the_sensor_of_the_scene():
    """Several frames have a loss by its width; one has none."""
    burst = BurstMode(frames_per_s=90.0, window=0.023, max_frames=2)
    wide = a_scene(replace(LIMITS, axes="one"), sensor=Sensor(width=190.0), burst=burst)
    found = best_in_plane(wide)
    assert found.snapshot.width_loss is None
    for each in found.bursts:
        assert each.width_loss == loss_of_width(wide, each.frames, width=190.0) > 0
        assert each.level == each.psnr - each.width_loss
        assert f"{each.width_loss:.2g} by borders" in each.text


def test_a_snapshot_is_told_to_be_taken_where_nothing_is_worth_more():
    """Frames that gain less than 0.2 dB over it are left."""
    search = PlaneSearch(a_burst("stills", 0, 24.5, 1), (a_burst("stills", 0, 24.6),), 25.0)
    first = answer_in_plane(a_scene(), search).text().splitlines()[0]
    assert first == "Take a snapshot of 8 ms at rest: 24.5 dB; no other option is worth more."


def test_a_run_up_that_nothing_limits_is_said():
    """Its travel is counted where the limits have an acceleration."""
    bursts = a_burst("stills", 0, 24.5, 1), (a_burst("two sines", 2, 26.0),)
    search = PlaneSearch(*bursts, 27.3)
    text = " ".join(answer_in_plane(a_scene(), search).text().split())
    assert "each axis, run-up from rest included." in text
    text = " ".join(answer_in_plane(a_scene(Limits(max_stroke=24.0)), search).text().split())
    assert "each axis, reached at once, as [limits] max_acceleration_g or _px_per_s2 says" in text
    alone = Limits(max_stroke=24.0, axes="one")
    assert "axis, reached" not in " ".join(answer_in_plane(a_scene(alone), search).text().split())


def test_a_camera_that_turns_leaves_its_stage_where_it_is():
    """Its answer needs no stage, and no path of one is drawn."""
    at_rest = a_burst("stills", 0, 24.5, 1)
    turning = replace(a_burst("stills", 1, 27.0), travel=0.0, lit_travel=0.0, pan=(700.0, 700.0))
    answer = answer_in_plane(a_scene(), PlaneSearch(at_rest, (turning,), 28.0))
    first, *_ = answer.text().splitlines()
    assert first == "Take 4 frames while the camera turns: 27.0 dB, 2.5 dB better than a snapshot."
    assert answer.choice.needs == ("registration", "turning camera")
    assert len(Report(a_scene(), answer, ()).plot().axes) == 1


def test_a_camera_turns_where_that_pays():
    """Frames at rest stand beside its own, and are taken where a slow pan gains too little."""
    limits = Limits(max_stroke=0.0, max_half_exposure=0.01, pans="camera")
    burst = BurstMode(frames_per_s=40.0, window=0.12, max_frames=4)
    parts = {"photon_rate": 5e4, "read_noise": 4.0, "limits": limits, "burst": burst}
    turned = ("registration", "turning camera")
    for law, needs in (
        (EvenVelocities(300.0, mean=(40.0, 0.0)), turned[:1]),
        (EvenVelocities(200.0, mean=(900.0, -400.0)), turned),
    ):
        answer = compare_in_plane(Scene.any_direction(law, **parts))
        assert answer.choice.needs == needs
        assert {turned[:1], turned} <= {row.needs for row in answer.rows}


@pytest.mark.parametrize(("travel", "said"), [(24.49, "25 px"), (241.0, "250 px"), (0.5, "0.5 px")])
def test_a_travel_is_rounded_up(travel, said):
    """A stage that follows what is said follows the path."""
    burst = replace(a_burst("sweep", 1, 27.0), travel=travel)
    search = PlaneSearch(a_burst("stills", 0, 24.5, 1), (burst,), 28.0)
    first, *_ = answer_in_plane(a_scene(), search).text().splitlines()
    assert f"the stage sweeps {said}:" in first


def test_one_filter_is_refused_with_its_reason():
    """A scene of one filter for all velocities is told why frames are registered all the same."""
    search = PlaneSearch(a_burst("stills", 0, 24.5, 1), (a_burst("stills", 0, 26.0),), 27.0)
    told = answer_in_plane(a_scene(), search).text()
    untold = answer_in_plane(a_scene(decoder_speed="unknown"), search).text()
    assert "One filter for all velocities is not offered" in " ".join(untold.split())
    assert "One filter" not in told


def test_a_camera_that_nothing_moves_is_told_of_a_pan():
    """Things that all move one way: the level that it names is that of a camera that turns."""
    law = EvenVelocities(300.0, mean=(1600.0, -1200.0))
    limits = Limits(max_stroke=0.0, max_half_exposure=0.01)
    parts = {"photon_rate": 3e4, "read_noise": 9.0}
    parts |= {"burst": BurstMode(frames_per_s=90.0, window=0.023, max_frames=2)}
    said = compare_in_plane(Scene.any_direction(law, limits=limits, **parts))
    turning = replace(limits, pans="camera")
    turned = compare_in_plane(Scene.any_direction(law, limits=turning, **parts))
    assert turned.choice.needs == ("registration", "turning camera")
    assert turned.options_baseline.level == pytest.approx(said.options_baseline.level, abs=1e-9)
    more = turned.choice.margin_over(said.choice)
    text = " ".join(said.text().split())
    assert "Following at (1,600, -1,200) px/s, by turning the camera, a mirror or a stage" in text
    assert f"would reach {turned.choice.level:.1f} dB, {more:.1f} dB more" in text
    assert "Following" not in turned.text()
    about_rest = EvenVelocities(2100.0, mean=(1600.0, -1200.0))
    assert (
        "Following"
        not in compare_in_plane(Scene.any_direction(about_rest, limits=limits, **parts)).text()
    )


def test_a_jerk_that_is_limited_is_refused():
    """Ways in the plane have pieces of constant acceleration."""
    for of_scene in (best_in_plane, search_words):
        with pytest.raises(ValueError, match=r"Limits\(max_jerk=...\)` must be left out in the pl"):
            of_scene(a_scene(Limits(max_half_exposure=0.01, max_jerk=1e9)))


def test_a_velocity_that_nothing_tells_is_refused():
    """One exposure is searched for where the decoder is told; else frames have to tell."""
    line = "`scene` must have a burst with time for two frames.*; got one exposure of unknown"
    for burst in (None, BurstMode(frames_per_s=40.0, window=0.02)):
        with pytest.raises(ValueError, match=line):
            best_in_plane(a_scene(burst=burst))


FILE = """[speeds]
any_direction = { max_px_per_s = 1700 }
[light]
photon_rate_per_s = 3e4
[sensor]
read_noise_e = 9
pixel_pitch_um = 4
[limits]
max_stroke_px = 24
max_half_exposure_ms = 8
"""
REFUSED = {
    "sweep": ["sweep"],
    "compare": ["compare"],
    "loss": ["optimise", "--loss", "design"],
    "free": ["optimise", "--free", "shutter"],
}


@pytest.mark.parametrize("slug", REFUSED)
def test_commands_along_one_axis_refuse_the_file(slug, tmp_path, capsys):
    """One line says what must hold, on standard error, and nothing is written."""
    path = tmp_path / "scene.toml"
    path.write_text(FILE)
    command, *options = REFUSED[slug]
    assert cli.main([command, str(path), *options]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    *_, line = err.splitlines()
    assert line.startswith("mishutter: error: ")
    assert "one axis" in line or "be left out for things that move in any direction" in line


def test_plan_shows_the_velocities(tmp_path, capsys):
    """In words in the table, and in the document."""
    path = tmp_path / "scene.toml"
    path.write_text(FILE)
    assert cli.main(["plan", str(path)]) == 0
    out, _ = capsys.readouterr()
    assert "up to 1,700 px/s in any direction" in out
    assert "two sines" in out
    assert cli.main(["plan", str(path), "--json"]) == 0
    out, _ = capsys.readouterr()
    assert json.loads(out)["scene"]["velocities"] == "up to 1,700 px/s in any direction"


def test_a_picture_of_stills_has_no_empty_panels():
    """Exposures over time alone; of moving frames the path and the velocities too."""
    at_rest, moving = a_burst("stills", 0, 26.0), a_burst("sweep", 1, 26.5)
    for burst, num_panels in ((at_rest, 1), (moving, 3)):
        search = PlaneSearch(a_burst("stills", 0, 24.5, 1), (burst,), 27.3)
        report = Report(a_scene(), answer_in_plane(a_scene(), search), ())
        assert len(report.plot().axes) == num_panels
        assert len(plot_design(report.recommended).axes) == num_panels


@pytest.mark.parametrize(
    ("burst", "line"),
    [
        (None, "`[burst]` must be given for things in any direction"),
        (BurstMode(frames_per_s=50.0, max_frames=1), "`[burst] max_frames` must be at least 2"),
        (
            BurstMode(frames_per_s=5.0, max_frames=4),
            "`[burst] window_ms` must be at least 200.2, in",
        ),
    ],
)
def test_a_camera_that_cannot_tell_a_velocity_is_refused_by_its_keys(burst, line):
    """Before the search; one that is told the velocity takes one exposure."""
    scene = replace(a_scene(), burst=burst)
    with pytest.raises(ValueError, match=re.escape(line)):
        _require_frames(scene)
    _require_frames(replace(scene, decoder_speed="known"))


def test_before_a_background_frames_rest_and_one_frame_has_one_filter():
    """A frame alone tells no velocities; one filter is as good as told where there is one."""
    burst = BurstMode(frames_per_s=50.0, max_frames=4, window=0.08)
    numbers = {"photon_rate": 1e5, "read_noise": 8.0, "burst": burst}
    numbers["limits"] = Limits(max_stroke=60.0, max_half_exposure=0.01)
    layers = Occlusion(front_share=0.3, object_width=70.0)
    scene = Scene.any_direction(800.0, occlusion=layers, **numbers)
    found = best_in_plane(scene)
    assert not any(each.moves for each in found.bursts)
    assert found.snapshot.level < float(exposures_psnr(scene, found.snapshot)) - 0.3
    assert found.snapshot.level + 2 < found.bursts[0].level < found.ceiling
    apart = best_in_plane(Scene.any_direction(800.0, objects=Objects(width=70.0), **numbers))
    assert not any(each.moves for each in apart.bursts)
    whole = Occlusion(front_share=1.0)
    alike = Scene.any_direction(ListedVelocities([(500.0, 200.0)]), occlusion=whole, **numbers)
    snapshot = best_in_plane(alike).snapshot
    assert snapshot.level == pytest.approx(float(exposures_psnr(alike, snapshot)), abs=1e-4)


@pytest.mark.parametrize(
    ("change", "wanted", "others"),
    [
        ({}, (*WAYS, *WAYS_ON_TWO_AXES, "a place of its own"), ()),
        ({"axes": "one"}, WAYS, (*WAYS_ON_TWO_AXES, "a place of its own")),
        ({"max_stroke": 0.0, "max_travel": None}, (), (*WAYS, *WAYS_ON_TWO_AXES)),
        (None, (), (*WAYS, *WAYS_ON_TWO_AXES)),
    ],
)
def test_a_plan_names_the_ways_that_are_searched(change, wanted, others):
    """Of a stage of two axes, of one and of none, and before a background at rest alone."""
    layers = Occlusion(front_share=0.3, object_width=70.0)
    scene = a_scene(occlusion=layers) if change is None else a_scene(replace(LIMITS, **change))
    words = search_words(scene)
    assert all(each in words for each in (STILLS, *wanted))
    assert not any(f" {each}," in words for each in others)
