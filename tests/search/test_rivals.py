"""Rivals of a design: each at its own best motion, and the best of each purchase."""

import time
from dataclasses import replace
from functools import partial

import jax.numpy as jnp
import numpy as np
import pytest
from support.designs import MOTION, SCENE, SLOW
from support.helpers import ROUNDING
from support.rows import made_up

from mishutter import (
    BurstMode,
    DesignLoss,
    ExpectedErrorLoss,
    Exposures,
    HannShutter,
    KnownSpeedLoss,
    Limits,
    Objects,
    Occlusion,
    RectShutter,
    Scene,
    StillCamera,
    TimedFrame,
    baselines,
    ceiling,
    optimise,
)
from mishutter._core.parallel import as_they_end, once
from mishutter.evaluation.bursts import best_still_burst
from mishutter.evaluation.speed_knowledge import KNOWN_SPEED
from mishutter.search.bursts import best_bursts, choose_burst
from mishutter.search.rivals import (
    BEST_CODED_STILL,
    BEST_MOVING_BURST,
    BEST_STILL_BURST,
    BEST_TUKEY,
    BEST_TURNED_BURST,
    CODED_AT_REST,
    PLAIN_STILLS,
    RIVALS,
    Rival,
    RivalSearch,
    compared_rows,
    is_finished,
    rows_of_bursts,
    searches,
    snapshots,
)
from mishutter.search.rows import (
    BEST_SNAPSHOT,
    FRAMES,
    ONE_EXPOSURE,
    OWN_BEST_MOTION,
    SAME_MOTION,
    SHUTTER,
    STAGE,
    TURNS,
    best_of_each_purchase,
)


@pytest.mark.slow
def test_a_snapshot_pans_with_the_most_objects_of_a_range_about_rest():
    """The range is as wide to either side, and more of the objects move to one."""
    scene = Scene(
        [-4000.0, -3250.0, 2500.0, 3250.0, 4000.0],
        [0.05, 0.15, 0.3, 0.3, 0.2],
        photon_rate=6e4,
        read_noise=4.0,
        limits=SCENE.limits,
    )
    at_rest, panned = snapshots(RivalSearch(scene, ExpectedErrorLoss()))
    assert float(panned.motion.velocity) == pytest.approx(3000, abs=400)
    assert panned.level > at_rest.level + 0.2


def test_a_level_within_tolerances_is_of_one_filter_and_the_mean_of_speeds():
    """A decoder that knows the speed, or the worst speed, is judged as the camera was designed."""
    row = made_up({"rect": 24.0})[0]
    metrics = replace(
        row.metrics,
        toleranced_psnr=jnp.asarray(23.1),
        worst_speed_psnr=jnp.asarray(21.7),
        known_speed_psnr=jnp.asarray(25.3),
    )
    row = replace(row, metrics=metrics)
    assert (row.within, row.level, row.psnr) == (pytest.approx(23.1), pytest.approx(23.1), 24.0)
    worst, known = replace(row, at_worst=True), replace(row, decoder=KNOWN_SPEED)
    assert (worst.within, worst.level) == (None, pytest.approx(21.7))
    assert (known.within, known.level) == (None, pytest.approx(25.3))


@pytest.mark.slow
def test_designs_keep_or_start_from_their_own_motions():
    """A design that this loss found for this scene stays as it is; another is tuned."""
    loss, scene = ExpectedErrorLoss(), SCENE
    finished = optimise(scene, SLOW, HannShutter(), loss=loss, free="acceleration")
    elsewhere = scene.without_metadata(weights=np.array([0.2, 0.3, 0.2, 0.2, 0.1]))
    other = optimise(elsewhere, MOTION, HannShutter(), loss=loss, free="half_exposure")
    names: list[str] = []
    begun: list[str] = []
    search = RivalSearch(scene, loss, MOTION, {"found": finished, "other": other})
    rows = compared_rows(search, names.append, begun.append)
    row = {(row.name, row.reading): row for row in rows}
    same, tuned = row["found", OWN_BEST_MOTION], row["other", OWN_BEST_MOTION]
    assert {"found", "other", BEST_SNAPSHOT} <= set(names)
    assert sorted(names) == sorted(begun) == sorted(searches(search))
    assert is_finished(finished, scene, loss)
    assert not is_finished(finished, scene, DesignLoss())
    assert same.motion is finished.motion
    assert (same.loss, same.metrics) == (finished.loss, finished.metrics)
    assert tuned.motion is not other.motion
    assert tuned.loss <= float(loss(scene, other.motion, other.shutter)) * (1 + ROUNDING)
    assert row["other", SAME_MOTION].motion is MOTION


def test_more_never_brings_less():
    """Whoever has bought both may leave the shutter open, and one with a stage keep it at rest."""
    levels = {"a": 23.0, "Hann": 22.0, "rect": 23.5, CODED_AT_REST: 22.5, BEST_SNAPSHOT: 23.25}
    best = best_of_each_purchase(made_up(levels))
    brings = {takes: row.level for takes, row in best.items()}
    assert brings == {"nothing": 23.25, "a stage": 23.5, "a shutter": 23.25, "both": 23.5}
    assert best["both"].name == "rect"


def _asked(scene, **how):
    """Names of the searches of a comparison that are of rivals, and not of windows."""
    names = searches(RivalSearch(scene, ExpectedErrorLoss(), **how))
    return {name for name in names if name not in baselines()}


def test_rivals_are_searched_for_where_they_are_asked_for():
    """Bursts where the scene has frames, stills at a plain rate where it has none."""
    always = {BEST_TUKEY, BEST_SNAPSHOT, BEST_CODED_STILL}
    light = {"photon_rate": 6e4, "read_noise": 4.0}
    burst = Scene([-900.0, 900.0], burst=BurstMode(frames_per_s=130.0, max_frames=3), **light)
    layered = SCENE.with_occlusion(Occlusion(front_share=0.6))
    assert _asked(SCENE) == always | {PLAIN_STILLS}
    assert _asked(burst) == always | {BEST_STILL_BURST}
    assert _asked(layered) == always  # frames that are aligned for objects blur what is behind


def test_an_answer_needs_fewer_searches():
    """No window and no Tukey: its rows are an open shutter, the user's, and the rivals."""
    search = RivalSearch(SCENE, ExpectedErrorLoss(), every=False)
    assert {*searches(search)} == {"rect", BEST_SNAPSHOT, BEST_CODED_STILL, PLAIN_STILLS}


@pytest.mark.parametrize(
    ("above", "is_alone"),
    [((-3.0, 0.21), True), ((-3.0, 0.19), False), ((0.15, 0.3), False), ((0.25, 0.3), True)],
    ids=["far above", "near it", "the simpler one is near it", "the simpler one is far above"],
)
def test_no_exposure_is_searched_for_that_cannot_win(above, is_alone):
    """Its ceiling tells, unless it is asked for; a simpler burst within 0.2 dB is what wins."""
    most = float(ceiling(SWIFT))
    bursts = tuple(
        replace(burst, psnr=most + more, width_loss=None)
        for burst, more in zip(BURSTS, above, strict=True)
    )
    search = partial(RivalSearch, SWIFT, KnownSpeedLoss(), bursts=bursts)
    frames = {BEST_SNAPSHOT, BEST_STILL_BURST}
    assert {*searches(search(every=False))} == (
        frames if is_alone else frames | {"rect", BEST_CODED_STILL}
    )
    for asks in (search(), search(every=False, entries={"own": HannShutter()})):
        assert BEST_CODED_STILL in searches(asks)


def test_each_rival_has_names_of_its_own_and_parts_that_are_bought():
    """No name stands twice, and only a burst takes parts beyond a stage and a shutter."""
    names = [name for rival in RIVALS for name in rival.names]
    assert len(set(names)) == len(names)
    beyond = {rival.names for rival in RIVALS if not rival.hardware <= ONE_EXPOSURE}
    bursts = BEST_STILL_BURST, BEST_TURNED_BURST, BEST_MOVING_BURST
    assert beyond == {bursts, (PLAIN_STILLS,)}


def test_rows_know_the_parts_that_their_rival_may_require(monkeypatch):
    """A burst requires frames whatever its levels; a stage and a shutter that rest do not count."""
    (row,) = made_up({"Hann": 22.0})
    kinds = {frozenset({STAGE, FRAMES}): {STAGE, FRAMES}, ONE_EXPOSURE: {STAGE, SHUTTER}}
    for hardware, required in kinds.items():
        rival = Rival(("mine",), hardware, lambda search: [replace(row, name="mine")])
        (found,) = rival.rows(RivalSearch(SCENE, ExpectedErrorLoss()))
        assert found.required_hardware == required
        assert found.is_of_one_exposure == (FRAMES not in hardware)


def test_a_shared_design_is_searched_for_once():
    """By the first of several threads that ask at once; the others get the same."""
    calls = []

    def slow():
        time.sleep(0.05)
        calls.append(1)
        return object()

    shared = once(slow)
    found = list(as_they_end([shared] * 5, 5))
    assert len(calls) == 1
    assert all(each is found[0] for each in found)


STILL = StillCamera(half_exposure=1e-3)
BURSTS = (
    Exposures("stills", (TimedFrame(StillCamera(half_exposure=1e-3), 0.0),) * 3, 0.0, 30.0, 29.0),
    Exposures("sweep", (TimedFrame(MOTION, 0.0),) * 2, 25.0, 31.0, 28.0),
)


NOTHING, A_STAGE, BOTH = (0, 0, 0), (1, 1, 1), (2, 2, 1)
"""Ranks of a snapshot at rest, of a parabola, and of one behind a shaped shutter."""


@pytest.mark.parametrize(
    ("levels", "one_exposure", "rank", "wanted"),
    [
        ((30.0, 31.0), 29.0, A_STAGE, "sweep"),
        ((30.0, 31.0), 30.79, A_STAGE, "sweep"),
        ((30.0, 31.0), 30.81, A_STAGE, None),  # which needs no registration
        ((30.85, 31.0), 29.0, A_STAGE, "stills"),
        ((30.85, 31.0), 31.04, BOTH, "stills"),  # which take nothing to build
        ((30.85, 31.0), 31.04, NOTHING, None),
        ((30.85, 31.0), 31.21, BOTH, None),
    ],
)
def test_frames_are_taken_where_they_are_worth_it(levels, one_exposure, rank, wanted):
    """What is simpler by less than two tenths is taken; where the worst speed counts, by that."""
    some = tuple(replace(each, psnr=x) for each, x in zip(BURSTS, levels, strict=True))
    found = choose_burst(some, one_exposure, rank)
    assert (found and found.kind) == wanted
    assert choose_burst(some, one_exposure - 5, rank, at_worst=True) is some[0]
    assert choose_burst(some, 31.3, rank, at_worst=True) is None
    assert choose_burst((), one_exposure, rank) is None


@pytest.mark.parametrize(
    ("losses", "wanted"),
    [((0.31, 1.09), "sweep"), ((0.31, 1.13), "stills"), ((None, 0.7), "sweep")],
)
def test_frames_move_where_that_pays_on_the_sensor(losses, wanted):
    """A gain of 1 dB is none on a sensor from which as much more leaves; unknown ones are none."""
    some = tuple(replace(each, width_loss=x) for each, x in zip(BURSTS, losses, strict=True))
    assert choose_burst(some).kind == wanted
    assert choose_burst(some, 25.0, A_STAGE).kind == wanted


@pytest.mark.parametrize(
    "parts", [{"occlusion": Occlusion(front_share=0.3)}, {"objects": Objects(width=90.0)}]
)
def test_things_that_are_found_one_by_one_have_frames_at_rest(parts):
    """In frames that move things of several velocities are not told apart."""
    (still,) = best_bursts(Scene(**_OF_SWIFT, **parts))
    assert not still.moves
    assert len(best_bursts(SWIFT)) == 2


def test_a_camera_that_turns_needs_no_stage():
    """Frames that follow one-way things without one are an option of their own."""
    limits = Limits(
        max_stroke=25.0, max_half_exposure=0.025, max_acceleration=2e6, pans="camera", max_pan=900.0
    )
    burst = BurstMode(frames_per_s=30, max_frames=2)
    scene = Scene([410.0, 610.0, 810.0], photon_rate=8e4, read_noise=6, limits=limits, burst=burst)
    rows = sorted(rows_of_bursts(*best_bursts(scene)), key=lambda row: row.psnr)
    assert [row.parts - {FRAMES} for row in rows] == [set(), {TURNS}, {STAGE, TURNS}]
    seen_from_it = Scene(
        [-200.0, 0.0, 200.0], photon_rate=8e4, read_noise=6, limits=limits, burst=burst
    )
    assert rows[1].psnr == pytest.approx(best_still_burst(seen_from_it).psnr, abs=0.02)
    assert rows[0].psnr < rows[1].psnr - 3 < rows[2].psnr - 4
    both_ways = replace(seen_from_it, speeds=[-900.0, 0.0, 900.0])
    _, *moving = best_bursts(both_ways)
    assert [each.pan for each in moving] == [0]


@pytest.mark.parametrize("decoder", ["unknown", "found"])
def test_one_frame_is_no_burst(decoder):
    """Nothing registers it, so that it must not be judged as if its speed were known."""
    bursts = next(rival for rival in RIVALS if BEST_STILL_BURST in rival.names)
    limits = {"max_stroke": 31.0, "min_half_exposure": 2e-4}
    found = {}
    for half in (0.007, 0.019):
        own = {"limits": Limits(max_half_exposure=half, **limits), "decoder_speed": decoder}
        found[half] = bursts.rows(RivalSearch(Scene(**{**_OF_SWIFT, **own}), ExpectedErrorLoss()))
    assert found[0.007] == []
    assert [row.num_frames for row in found[0.019]] == [2, 2]


def test_a_burst_of_one_frame_is_one_exposure():
    """Which the design is, with a shutter of its own: it is never taken in place of one."""
    one = replace(BURSTS[1], frames=BURSTS[1].frames[:1])
    assert choose_burst((BURSTS[0], one), 20.0, A_STAGE) is BURSTS[0]
    assert choose_burst((BURSTS[0], one), 31.0, A_STAGE) is None


_OF_SWIFT = {
    "speeds": [-3500.0, 0.0, 3500.0],
    "photon_rate": 1e5,
    "read_noise": 8.0,
    "limits": Limits(max_stroke=80, max_half_exposure=0.017),
    "burst": BurstMode(frames_per_s=60, max_frames=2),
    "decoder_speed": "known",
}
SWIFT = Scene(**_OF_SWIFT)


@pytest.mark.slow
def test_a_search_for_a_decoder_that_registers_finds_frames():
    """Two frames that move are better than one exposure; a comparison does not look again."""
    design = optimise(SWIFT, shutter=RectShutter(), num_starts=4)
    still, moving = design.bursts
    assert design.sequence is moving
    assert moving.num_frames == 2
    assert moving.psnr > max(still.psnr, float(design.metrics.known_speed_psnr)) + 0.1
    rivals = RivalSearch(SWIFT, KnownSpeedLoss(), entries={"own": design})
    assert rivals.bursts() is design.bursts


@pytest.mark.parametrize(
    ("scene", "arguments"),
    [
        (SWIFT, {"free": ("half_exposure",)}),
        (SWIFT, {"loss": ExpectedErrorLoss()}),
        (Scene(**{**_OF_SWIFT, "decoder_speed": "unknown"}), {}),
    ],
    ids=["one exposure is named", "one filter for all by loss", "one filter for all"],
)
def test_no_frames_are_looked_for_elsewhere(scene, arguments, monkeypatch):
    """Where a part of one exposure is to move, or one filter restores all speeds."""
    monkeypatch.setattr(
        "mishutter.search.search.shown_bursts", lambda *_, **how: pytest.fail("searched")
    )
    start = {"shutter": RectShutter(), "num_starts": 1, "max_steps": 3}
    design = optimise(scene, **start, **arguments)
    assert (design.sequence, design.bursts) == (None, ())
