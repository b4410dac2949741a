"""The answer of a comparison: which option it names, in which words, and what it assumes."""

import math
from dataclasses import replace
from types import SimpleNamespace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from support.designs import SCENE
from support.rolling import frames_on_parabolas
from support.rows import MOVING, ON_FREE_PATH, SHORT, STILL, made_up, sequence, turned, verdict

from mishutter import (
    BurstMode,
    ExpectedErrorLoss,
    Exposures,
    FirstOrderDevice,
    HannShutter,
    IdealDevice,
    Limits,
    Objects,
    Occlusion,
    RectShutter,
    Scene,
    Sensor,
    StillCamera,
    SwitchedDevice,
    Texture,
    TimedFrame,
    ceiling,
    compare,
    evaluate,
    optimise,
)
from mishutter.evaluation.speed_knowledge import SPEED_KNOWLEDGE
from mishutter.model.frame_path import SINE
from mishutter.model.limits import LEAST_STROKE
from mishutter.report.comparison import with_verdict
from mishutter.report.verdict import (
    detail_words,
    device_notes,
    on_pan,
    option_name,
    order_at_rest,
    points_that_leave,
)
from mishutter.search.frame_ties import ALTERNATING, FAN, SWEEP
from mishutter.search.moving_frames import loss_untold
from mishutter.search.rivals import (
    BEST_CODED_STILL,
    BEST_MOVING_BURST,
    BEST_STILL_BURST,
    CODED_AT_REST,
    PLAIN_STILLS,
)
from mishutter.search.rows import BEST_PANNED_SNAPSHOT, BEST_SNAPSHOT, FRAMES, STAGE

BURST = eqx.tree_at(
    lambda each: each.burst,
    SCENE,
    BurstMode(frames_per_s=60.0, max_frames=6),
    is_leaf=lambda x: x is None,
)
"""The small scene with a camera that takes frames."""


def of_bursts(levels, still=6, moving=4, rests=0, kind=ALTERNATING, losses=(), decoder="unknown"):
    """Rows of these levels, the bursts among them of so many frames, the moving ones over 45 px."""
    knows = SPEED_KNOWLEDGE[decoder]
    paths = {
        BEST_STILL_BURST: sequence(STILL, still),
        PLAIN_STILLS: sequence(STILL, still),
        BEST_MOVING_BURST: sequence(MOVING, moving, 45.0),
    }
    rested = tuple(
        TimedFrame(StillCamera(half_exposure=7e-4), 0.03 * k - 0.3) for k in range(rests)
    )
    moved = paths[BEST_MOVING_BURST]
    frames = (*rested, *moved.frames[rests:])
    moved = replace(moved, frames=frames, kind=kind, **dict(losses))
    paths[BEST_MOVING_BURST] = moved
    rows = []
    for row in made_up(levels):
        level = jnp.asarray(levels[row.name])
        own = replace(row, decoder=knows, metrics=replace(row.metrics, **{knows.level: level}))
        if row.name in paths:
            metrics = replace(row.metrics, known_speed_psnr=level)
            parts = {FRAMES} if row.name == PLAIN_STILLS else {STAGE, FRAMES}
            own = replace(
                row,
                decoder=SPEED_KNOWLEDGE["known"],
                metrics=metrics,
                hardware=frozenset(parts),
                exposures=paths[row.name],
            )
        rows.append(own)
    return rows


def answer(levels, *names, scene=BURST, **how):
    """The comparison of such rows, of which these are the user's own."""
    rows = of_bursts({"rect": 11.5} | levels, **how)
    return with_verdict(rows, dict.fromkeys(names, HannShutter()), scene)


def first(comparison):
    """The first line of an answer."""
    return comparison.verdict.splitlines()[0]


# Levels, and the row that is taken: nothing is worth less than two tenths over what is simpler.
CHOICES = {
    "nothing beats a snapshot": ({"a": 24.19, BEST_SNAPSHOT: 24.0, "Hann": 23.1}, BEST_SNAPSHOT),
    "two tenths are worth a stage and a shutter": ({"a": 24.21, BEST_SNAPSHOT: 24.0}, "a"),
    "a stage alone within two tenths": (
        {"a": 25.0, "rect": 24.81, BEST_SNAPSHOT: 23.7},
        "rect",
    ),
    "a stage alone beyond them": ({"a": 25.0, "rect": 24.79, BEST_SNAPSHOT: 23.7}, "a"),
    "a chain that ends at nothing": (
        {"a": 24.3, "rect": 24.15, BEST_SNAPSHOT: 24.0},
        BEST_SNAPSHOT,
    ),
    "a pan that pays": (
        {"a": 25.6, BEST_SNAPSHOT: 23.1, BEST_PANNED_SNAPSHOT: 25.5},
        BEST_PANNED_SNAPSHOT,
    ),
    "frames at rest above a stage and a shutter": (
        {"a": 25.58, BEST_SNAPSHOT: 25.48, BEST_STILL_BURST: 30.56, BEST_MOVING_BURST: 30.6},
        BEST_STILL_BURST,
    ),
    "frames at rest within two tenths of these": (
        {"a": 26.1, BEST_SNAPSHOT: 24.0, BEST_STILL_BURST: 25.95, BEST_MOVING_BURST: 25.97},
        BEST_STILL_BURST,
    ),
    "frames that move": (
        {"a": 25.0, BEST_SNAPSHOT: 24.0, BEST_STILL_BURST: 26.0, BEST_MOVING_BURST: 26.21},
        BEST_MOVING_BURST,
    ),
    "one exposure on the same stage, without registration": (
        {"rect": 26.1, BEST_SNAPSHOT: 24.0, BEST_STILL_BURST: 25.0, BEST_MOVING_BURST: 26.2},
        "rect",
    ),
    "one exposure that is better than frames": (
        {"a": 27.3, BEST_SNAPSHOT: 24.0, BEST_STILL_BURST: 25.0, BEST_MOVING_BURST: 26.2},
        "a",
    ),
    "stills at a rate that any camera has": (
        {"a": 25.0, BEST_SNAPSHOT: 24.0, PLAIN_STILLS: 26.4},
        PLAIN_STILLS,
    ),
    "a parabola within two tenths of a free path": (
        {"rect": 26.55, ON_FREE_PATH: 26.7, BEST_SNAPSHOT: 24.0},
        "rect",
    ),
    "a free path beyond them": (
        {"rect": 26.55, ON_FREE_PATH: 26.76, BEST_SNAPSHOT: 24.0},
        ON_FREE_PATH,
    ),
    "the user's own of equals": ({"a": 25.0, "Hann": 25.12, BEST_SNAPSHOT: 23.0}, "a"),
    "a window that is better than the user's": (
        {"a": 25.0, "Hann": 25.21, BEST_SNAPSHOT: 23.0},
        "Hann",
    ),
    "an ordinary pan before the user's": (
        {"rect": 25.0, BEST_PANNED_SNAPSHOT: 24.9, BEST_SNAPSHOT: 23.0},
        BEST_PANNED_SNAPSHOT,
    ),
    "a shutter at rest before one on a stage": (
        {CODED_AT_REST: 26.6, "a": 26.75, BEST_SNAPSHOT: 24.0},
        CODED_AT_REST,
    ),
}


@pytest.mark.parametrize("slug", CHOICES)
def test_the_option_that_is_named(slug):
    """The best of all, unless what is simpler is less than two tenths of a decibel below it."""
    levels, wanted = CHOICES[slug]
    comparison = answer(levels, *({"a"} & {*levels}))
    assert comparison.choice.name == wanted
    assert f": {levels[wanted]:.1f} dB" in first(comparison)
    assert comparison.options[-1].level >= comparison.choice.level
    assert not {"Build", "build"} & {*comparison.text().replace(",", " ").split()}


OF_FRAMES = {BEST_SNAPSHOT: 22.0, BEST_STILL_BURST: 24.0, BEST_MOVING_BURST: 26.5}
HEADLINES = {
    "snapshot": (
        {"levels": {BEST_SNAPSHOT: 24.04, "a": 24.1}},
        "Take a snapshot of 2.6 ms at rest: 24.0 dB; no other option is worth more.",
    ),
    "pan": (
        {"levels": {BEST_SNAPSHOT: 24.04, BEST_PANNED_SNAPSHOT: 27.56, "a": 24.1}},
        "Take a snapshot on a pan of -1,500 px/s: 27.6 dB, 3.5 dB better than a snapshot at rest.",
    ),
    "parabola": (
        {"levels": {BEST_SNAPSHOT: 24.04, "rect": 27.56}},
        "Take one exposure while the stage follows a parabola of 247 px: 27.6 dB, 3.5 dB better "
        "than a snapshot.",
    ),
    "shaped shutter": (
        {"levels": {BEST_SNAPSHOT: 24.04, "optimised": 27.56}},
        "Take one exposure behind a shaped shutter, the stage on a parabola of 22 px: 27.6 dB, "
        "3.5 dB better than a snapshot.",
    ),
    "shaped shutter at rest": (
        {"levels": {BEST_SNAPSHOT: 24.04, CODED_AT_REST: 27.56}},
        "Take one exposure behind a shaped shutter, at rest: 27.6 dB, 3.5 dB better than a "
        "snapshot.",
    ),
    "own": (
        {"levels": {BEST_SNAPSHOT: 24.04, "mine": 27.56}},
        "Take mine, one exposure behind a shaped shutter, the stage on a parabola of 22 px: "
        "27.6 dB, 3.5 dB better than a snapshot.",
    ),
    "frames at rest": (
        {"levels": {BEST_SNAPSHOT: 24.04, BEST_STILL_BURST: 27.56}},
        "Take 6 frames of 2.6 ms and keep the stage still: 27.6 dB, 3.5 dB better than a snapshot.",
    ),
    "frames at a rate that any camera has": (
        {"levels": {BEST_SNAPSHOT: 24.04, PLAIN_STILLS: 27.56}, "still": 3},
        "Take 3 frames of 2.6 ms at 30 frames/s and keep the stage still: 27.6 dB, 3.5 dB better "
        "than a snapshot.",
    ),
    "parabolas": (
        {"levels": OF_FRAMES},
        "Take 4 frames while the stage swings 45 px: 26.5 dB, 4.5 dB better than a snapshot.",
    ),
    "sweep": (
        {"levels": OF_FRAMES, "kind": SWEEP, "moving": 3},
        "Take 3 frames while the stage sweeps 45 px: 26.5 dB, 4.5 dB better than a snapshot.",
    ),
    "sine": (
        {"levels": OF_FRAMES, "kind": SINE},
        "Take 4 frames while the stage swings 45 px on a sine: 26.5 dB, 4.5 dB better than a "
        "snapshot.",
    ),
    "fan": (
        {"levels": OF_FRAMES, "kind": FAN},
        "Take 4 frames while the stage takes a speed of its own in each, over 45 px: 26.5 dB, "
        "4.5 dB better than a snapshot.",
    ),
    "a camera that turns too": (
        {"levels": OF_FRAMES, "losses": {"pan": 150.0}},
        "Take 4 frames while the camera turns and the stage swings 45 px: 26.5 dB, 4.5 dB better "
        "than a snapshot.",
    ),
    "the second of two": (
        {"levels": OF_FRAMES, "moving": 2, "rests": 1},
        "Take 2 frames, the stage moving during the second: 26.5 dB, 4.5 dB better than a "
        "snapshot.",
    ),
    "the last of three": (
        {"levels": OF_FRAMES, "moving": 3, "rests": 2},
        "Take 3 frames, the stage moving during the last: 26.5 dB, 4.5 dB better than a snapshot.",
    ),
    "the last three of five": (
        {"levels": OF_FRAMES, "moving": 5, "rests": 2},
        "Take 5 frames, the stage moving during the last 3: 26.5 dB, 4.5 dB better than a "
        "snapshot.",
    ),
}


@pytest.mark.parametrize("slug", HEADLINES)
def test_the_first_line_says_what_to_do(slug):
    """The option, its level, and its gain over the best snapshot at rest."""
    how, line = HEADLINES[slug]
    assert first(answer(**{"levels": {}, **how})) == line


def test_the_options_stand_in_one_table_over_one_baseline():
    """Sorted by level, the best of what needs the same, and the ceiling last."""
    levels = {
        "rect": 24.3,
        "Hann": 24.6,
        "optimised": 24.9,
        BEST_SNAPSHOT: 23.2,
        BEST_PANNED_SNAPSHOT: 23.21,
        BEST_CODED_STILL: 23.22,
        CODED_AT_REST: 23.22,
        BEST_STILL_BURST: 24.0,
        BEST_MOVING_BURST: 27.44,
    }
    comparison = answer(levels, "optimised", moving=2, rests=1)
    (line,) = (line for line in comparison.text().splitlines() if "the second moving" in line)
    assert line.split("  ")[0] == " 2 frames, the second moving, 1.4 and 20 ms"
    saved = comparison.to_dict()
    assert [each["row"] for each in saved["options"]] == [
        BEST_SNAPSHOT,
        BEST_STILL_BURST,
        "rect",
        "optimised",
        BEST_MOVING_BURST,
    ]
    assert saved["choice"] == BEST_MOVING_BURST
    assert saved["options"][2]["gain_db"] == pytest.approx(1.1)
    assert saved["options"][3]["needs"] == ["stage", "shaped shutter"]


def test_an_option_that_needs_more_and_brings_nothing_is_left_out():
    """But not one of the user's, by its own name."""
    levels = {"mine": 23.9, "rect": 24.04, "Hann": 24.06, BEST_SNAPSHOT: 24.0}
    names = [option_name(row) for row in answer(levels, "mine").options]
    assert names == ["mine: one exposure on a parabola, 20 ms", "snapshot at rest, 2.6 ms"]
    levels |= {"rect": 24.06}
    names = [option_name(row) for row in answer(levels, "mine").options]
    assert names[1:] == ["snapshot at rest, 2.6 ms", "one exposure on a parabola, 20 ms"]


def test_an_option_says_in_its_name_what_its_decoder_knows():
    """One exposure whose speed is told or found; frames tell it themselves."""
    for decoder, words in (("known", ", speed known"), ("found", ", speed found"), ("unknown", "")):
        rows = {row.name: row for row in of_bursts(OF_FRAMES | {"rect": 25.0}, decoder=decoder)}
        assert option_name(rows[BEST_SNAPSHOT]) == f"snapshot at rest, 2.6 ms{words}"
        assert option_name(rows["rect"]) == f"one exposure on a parabola, 20 ms{words}"
        assert option_name(rows[BEST_STILL_BURST]) == "6 frames at rest, 2.6 ms"
    plain = of_bursts({PLAIN_STILLS: 26.0})[0]
    assert option_name(plain) == "6 frames at rest, 2.6 ms, at 30 frames/s"


def test_frames_of_two_exposures_say_how_many_have_each():
    """And a single one of each needs no number."""
    row = of_bursts({BEST_STILL_BURST: 26.0})[0]
    short = TimedFrame(StillCamera(half_exposure=3e-4), 0.9)
    for count, words in ((2, "2 of 2.6 and 1 of 0.6 ms"), (1, "2.6 and 0.6 ms")):
        frames = (*row.sequence.frames[:count], short)
        changed = replace(row, exposures=replace(row.sequence, frames=frames))
        assert option_name(changed) == f"{count + 1} frames at rest, {words}"


def test_a_single_frame_is_no_burst():
    """Nothing registers it: it is neither the choice nor an option, whatever its level."""
    levels = {BEST_SNAPSHOT: 25.18, "rect": 26.06, BEST_MOVING_BURST: 26.64}
    comparison = answer(levels, moving=1)
    assert comparison.choice.name == "rect"
    assert [row.name for row in comparison.options] == [BEST_SNAPSHOT, "rect"]


@pytest.mark.parametrize(("turns", "needs"), [(False, ("stage",)), (True, ("turning camera",))])
def test_a_pan_is_not_free(turns, needs):
    """It needs what makes it: the stage, or a camera that turns."""
    levels = {"a": 21.0, BEST_SNAPSHOT: 13.91, BEST_PANNED_SNAPSHOT: 26.25}
    rows = turned(made_up(levels)) if turns else made_up(levels)
    comparison = with_verdict(rows, {}, SCENE)
    assert comparison.choice.name == BEST_PANNED_SNAPSHOT
    assert comparison.choice.needs == needs


SHUTTERS = {
    "nothing": ({"rect": 25.0, "optimised": 25.09}, "A shaped shutter adds nothing here (below "),
    "none": ({"rect": 25.0}, "A shaped shutter adds nothing here (below 0.1 dB)."),
    "chosen": (
        {"rect": 25.0, "optimised": 25.62},
        "The shaped shutter adds 0.6 dB to an open one.",
    ),
    "too little": (
        {"rect": 25.0, "optimised": 25.14},
        "A shaped shutter adds 0.1 dB to one exposure, which is not worth it.",
    ),
    "below frames": (
        {"rect": 25.0, "optimised": 25.62, BEST_STILL_BURST: 26.97},
        "A shaped shutter adds 0.6 dB to one exposure, which stays 1.3 dB below this.",
    ),
}


@pytest.mark.parametrize("slug", SHUTTERS)
def test_a_line_says_what_a_shaped_shutter_adds(slug):
    """To the best of one exposure, in the answer's second line."""
    levels, line = SHUTTERS[slug]
    said = answer({BEST_SNAPSHOT: 23.2} | levels, "optimised").verdict.splitlines()
    assert said[1].startswith(line)


def test_an_answer_says_what_it_assumes():
    """The axis, whole or in objects and how large, the decoder, the sensor and its shutter."""
    scene = eqx.tree_at(
        lambda each: each.sensor,
        BURST,
        Sensor(width=517.0, axis="columns"),
        is_leaf=lambda x: x is None,
    )
    said = answer(OF_FRAMES, scene=scene, moving=3).verdict.replace("\n", " ")
    way = math.ceil(float(SCENE.max_speed) * (0.06 + 0.02))
    window = 2e3 * float(SCENE.limits.max_half_exposure)
    stroke, speed = float(SCENE.limits.max_stroke), float(SCENE.limits.max_top_speed)
    assert said.endswith(
        "Assumes: detail as in a photograph (a tenth of its contrast is finer than 17.7 px; for "
        "print, codes or cells say [picture]); all motion along the columns; the picture "
        f"moves as a whole, or its objects are much wider than {way:,} px (else say [objects], "
        "or [occlusion] before a background); "
        f"frames are registered without error; frames within {window:g} ms; a stage with a stroke "
        f"of {stroke:g} px during frames, 45 px with its run-up, and {speed:,g} px/s; a sensor "
        "of 517 px; global shutter."
    )
    for decoder, words in (
        ("unknown", "one filter restores all speeds"),
        ("known", "the decoder knows the speed"),
    ):
        said = answer({BEST_SNAPSHOT: 22.0, "rect": 24.5}, decoder=decoder).verdict
        assert f"; {words}; a stage with a stroke of" in said.replace("\n", " ")
    plain = answer({BEST_SNAPSHOT: 22.0, PLAIN_STILLS: 24.5}).verdict.replace("\n", " ")
    assert "; a camera that takes 30 frames/s; frames are registered without error;" in plain


@pytest.mark.parametrize(
    ("how", "way"),
    [
        ({"kind": ALTERNATING}, "turns back in each frame"),
        ({"kind": SWEEP, "moving": 3, "rests": 1}, "rests in the first frame, then goes out and"),
        ({"kind": SINE, "moving": 5, "rests": 2}, "rests in the first 2 frames, then swings on a"),
        ({"kind": FAN}, "takes another velocity in each frame"),
    ],
)
def test_an_answer_says_how_the_stage_moves_over_the_frames(how, way):
    """And what that takes of it from rest to rest, in um too where the pixel pitch is known."""
    scene = replace(BURST, sensor=Sensor(pixel_pitch=3e-6), limits=Limits(max_acceleration=3e6))
    comparison = answer(OF_FRAMES, scene=scene, **how)
    said = comparison.verdict.replace("\n", " ")
    assert "The stage adds 2.5 dB to the best option without one. It " in said
    assert f"It {way}" in said
    use = comparison.choice.sequence.use_within(scene.limits)
    assert f": {float(use.travel):.3g} px at up to" in said
    assert f"({float(use.travel) * 3:.3g} um, {float(use.top_speed) * 3e-3:.3g} mm/s, " in said
    assert ", run-up from rest included." in said


@pytest.mark.parametrize(("pan", "words"), [(1500.0, "1,500"), ((-900.0, 80.5), "-900, 80.5")])
def test_an_answer_says_how_fast_the_camera_turns(pan, words):
    """Beside the stage, along one axis or two."""
    said = answer(OF_FRAMES, losses={"pan": pan}).verdict.replace("\n", " ")
    assert f" The camera turns at {words} px/s. The stage adds " in said
    assert "camera turns" not in answer(OF_FRAMES).verdict


def test_an_answer_says_that_nothing_limits_the_acceleration_of_a_stage():
    """And nothing of a stage where it rests."""
    said = answer(OF_FRAMES).verdict.replace("\n", " ")
    assert ", reached at once, as [limits] max_acceleration_g or _px_per_s2 says no limit." in said
    at_rest = answer({BEST_SNAPSHOT: 22.0, BEST_STILL_BURST: 24.0}).verdict
    assert "The stage" not in at_rest


def test_an_answer_says_what_room_a_stage_is_assumed_to_have():
    """Its travel where that is the less; beside the stroke what the run-up takes beyond it."""
    said = {}
    for stroke, travel in ((50.0, None), (50.0, 48.5), (20.0, None), (20.0, 64.0)):
        limits = replace(SCENE.limits, max_stroke=stroke, max_travel=travel)
        found = answer(OF_FRAMES, scene=replace(BURST, limits=limits)).verdict
        words = found.replace("\n", " ").partition("; a stage with a ")[2]
        said[stroke, travel] = words.partition(" and ")[0]
    beyond = "stroke of 20 px during frames, 45 px with its run-up,"
    assert said == {
        (50.0, None): "stroke of 50 px",
        (50.0, 48.5): "travel of 48.5 px",
        (20.0, None): beyond,
        (20.0, 64.0): beyond,
    }


@pytest.mark.slow
def test_a_camera_without_a_stage_has_a_stroke_of_zero():
    """No option then needs a stage."""
    rows = Limits(max_stroke=0.0)
    assert float(rows.max_stroke) == LEAST_STROKE
    scene = replace(BURST, limits=replace(SCENE.limits, max_stroke=0.0))
    design = optimise(scene, num_coefficients=4, num_starts=1, max_steps=20)
    needs = {need for row in compare(scene, design).options for need in row.needs}
    assert "stage" not in needs


def test_stills_are_ordered_without_a_stage_where_there_is_none():
    """One exposure, and frames of two exposures, which read as one."""
    rows, halves = Limits(max_stroke=0.0), [0.00355] * 3 + [0.0002] * 2
    frames = [TimedFrame(StillCamera(half_exposure=x), 0.01 * k) for k, x in enumerate(halves)]
    stills = Exposures("stills", tuple(frames), 0.0, 31.0, 30.0)
    assert order_at_rest(stills, Limits(max_stroke=0.7)) == (
        "5 frames, 3 of 7.1 and 2 of 0.4 ms, and keep the stage still"
    )
    assert order_at_rest(stills, rows) == "5 stills, 3 of 7.1 and 2 of 0.4 ms"
    one = Exposures("stills", (TimedFrame(StillCamera(half_exposure=3.55e-3), 0.0),))
    assert order_at_rest(one, rows) == "one exposure at rest of 7.1 ms"


@pytest.mark.parametrize(
    ("path", "power", "words"),
    [
        (None, None, "as in a photograph"),
        (None, [0.0, 0.0, 3.0, 1.0], "by the scene's spectrum"),
        ("example", None, "as in the example"),
        ("print", None, "as in print"),
        ("parts/barcode.png", None, "as in barcode.png"),
    ],
)
def test_an_answer_begins_with_the_detail_that_it_assumes(path, power, words):
    """Levels depend on nothing as much; who has said nothing is told how to say it."""
    scene = replace(SCENE, picture=Texture(path=path, power_spectrum=power))
    said = detail_words(scene)
    assert said.startswith(f"detail {words} (a tenth of its contrast is finer than ")
    assert ("say [picture]" in said) == (path is None and power is None)


BELT = Scene(
    [2900.0, 3100.0, 3300.0],
    photon_rate=1e5,
    read_noise=4.0,
    limits=Limits(max_stroke=0.0, max_half_exposure=0.01),
)
"""Things that all move one way before a camera that nothing moves."""


@pytest.mark.slow
def test_things_that_all_move_one_way_are_told_of_a_pan():
    """Where following is worth more than 1 dB, by the level of a snapshot at rest among them."""
    at_rest = made_up({BEST_SNAPSHOT: 22.0})[0]
    said = on_pan(BELT, at_rest, ExpectedErrorLoss())
    follows = replace(BELT, speeds=BELT.speeds - 3100.0)
    motion = StillCamera(half_exposure=float(said.split("snapshot of ")[1].split(" ms")[0]) / 2e3)
    level = float(evaluate(follows, motion, RectShutter()).expected_psnr)
    assert said.startswith("Following at 3,100 px/s, by turning the camera, a mirror or a stage, a")
    assert f"would reach {level:.1f} dB, {level - 22:.1f} dB more" in said
    near = replace(at_rest, metrics=replace(at_rest.metrics, expected_psnr=jnp.array(level - 0.9)))
    assert on_pan(BELT, near, ExpectedErrorLoss()) == ""


@pytest.mark.slow
def test_frames_on_a_pan_lose_by_borders_as_others_do():
    """Objects of few pixels enter and leave frames that follow their mean: a snapshot is better."""
    burst = of_bursts({BEST_STILL_BURST: 12.0})[0]
    scene = replace(BELT, burst=BurstMode(frames_per_s=60.0, max_frames=4))
    wide, narrow = (
        on_pan(replace(scene, objects=objects), burst, ExpectedErrorLoss())
        for objects in (None, Objects(width=31.0))
    )
    assert "a stage, 2 frames of 3.33 ms would reach 33.6 dB" in wide
    assert "a stage, a snapshot of 8.62 ms would reach 33.5 dB" in narrow


@pytest.mark.parametrize(
    ("speeds", "words"),
    [
        ([0.0, 900.0, 3000.0], "1,500"),
        ([-2000.0, 0.0], "-1,000"),
        ([15e3, 30001.0], "22,500"),
        ([0.0], ""),
    ],
)
def test_things_that_rest_do_not_move_the_other_way(speeds, words, monkeypatch):
    """Among things at rest and others of one way, half of the fastest is followed."""
    at_rest, better = (made_up({BEST_SNAPSHOT: level})[0] for level in (22.0, 25.0))
    found = [SimpleNamespace(judged_by=lambda *_: better)]
    monkeypatch.setattr("mishutter.report.verdict.snapshots", lambda _: found)
    scene = Scene(speeds, photon_rate=1.8e5, read_noise=4.0, limits=BELT.limits)
    said = on_pan(scene, at_rest, ExpectedErrorLoss())
    assert said.startswith(words and f"Following at {words} px/s, by turning the camera, a mirror")
    assert bool(said) == bool(words)


def test_no_pan_is_told_of_where_one_is_there_or_would_not_help():
    """A stage, a camera that turns, things that move both ways, and a background at rest."""
    at_rest = made_up({BEST_SNAPSHOT: 12.0})[0]
    for changed in (
        {"speeds": jnp.array([-3.0, 3100.0, 3300.0])},
        {"limits": replace(BELT.limits, pans="camera")},
        {"limits": replace(BELT.limits, max_stroke=3.0)},
        {"occlusion": Occlusion(front_share=0.3)},
    ):
        assert on_pan(replace(BELT, **changed), at_rest, ExpectedErrorLoss()) == ""


@pytest.mark.parametrize(
    ("background", "words"), [("still", "background at rest"), ("moving", "moving background")]
)
def test_before_a_background_an_answer_says_why_frames_are_at_rest(background, words):
    """And which objects it is about; it is silent where the camera takes no frames."""
    layers = Occlusion(front_share=0.37, object_width=83.0, background=background)
    levels = {BEST_SNAPSHOT: 22.0, BEST_STILL_BURST: 24.0}
    said = answer(levels, scene=BURST.with_occlusion(layers)).verdict.replace("\n", " ")
    assert "Moving frames are left out: objects are found in frames at rest alone" in said
    assert ("in the mean over photographs" in said) == (background == "still")
    what = "objects 83 px wide that cover 37% of the picture"
    assert f"{what}, before a {words} with detail" in said
    known = {"still": "found from the frames, as outlines are", "moving": "told"}[background]
    assert f"(before one that is dark and empty say [objects]); speeds are {known}; " in said
    alone = SCENE.with_occlusion(layers)
    assert "left out" not in answer({BEST_SNAPSHOT: 22.0, "rect": 23.0}, scene=alone).verdict
    parts = Occlusion(front_share=0.37, background=background)
    said = answer(levels, scene=BURST.with_occlusion(parts)).verdict.replace("\n", " ")
    assert ("for want of `object_width_px`" in said) == (background == "still")


def test_details_say_what_a_real_sensor_takes():
    """Where it matters: points that leave it, and registration."""
    losses = {"width_loss": 0.4812, "registration_loss": 0.0731}
    said = " ".join(answer(OF_FRAMES, losses=losses).details).replace("\n", " ")
    assert "Points that leave the sensor cost 0.48 dB of the level." in said
    assert "Registration by 64 x 64 px costs 0.07 dB at the worst speed, which" in said
    little = {"width_loss": 0.049, "registration_loss": 0.049}
    said = " ".join(answer(OF_FRAMES, losses=little).details)
    assert "Points that leave" not in said
    assert "Registration" not in said


def test_points_leave_what_has_a_width():
    """A sensor, or the outline of an object where that is narrower or the only one."""
    light = {"photon_rate": 3e4, "read_noise": 9.0}
    scenes = {
        "the sensor": {"sensor": Sensor(width=190.0), "objects": Objects(width=260.0)},
        "an object's outline": {"objects": Objects(width=260.0)},
    }
    for what, parts in scenes.items():
        said = points_that_leave(Scene([-900.0, 900.0], **light, **parts), 0.391)
        assert said == f"Points that leave {what} cost 0.39 dB of the level."
    assert points_that_leave(Scene([900.0], **light, sensor=Sensor(width=90.0)), 0.049) == ""


@pytest.mark.parametrize("speeds", [(-900.0, 900.0), (-900.0, -900.0)])
def test_an_answer_says_where_frames_that_move_are_left_out(speeds):
    """Where objects have several velocities."""
    scene = Scene(
        speeds, photon_rate=3e4, read_noise=9.0, burst=BURST.burst, objects=Objects(width=61.0)
    )
    said = answer(OF_FRAMES, scene=scene).verdict.replace("\n", " ")
    is_said = "say width_px of [sensor] and not [objects]" in said
    assert is_said == (speeds[0] != speeds[1])
    assert "objects at least 61 px wide, each registered;" in said


@pytest.mark.parametrize(("number", "slowest"), [(25, 500.0), (24, 500.0), (25, -500.0)])
def test_an_answer_says_where_its_frames_were_searched_on_simple_ways(number, slowest):
    """More than 24 frames, of things that move one way or both."""
    light = {"photon_rate": 1e5, "read_noise": 10.0, "limits": SCENE.limits}
    rows = of_bursts(OF_FRAMES, moving=number)
    said = with_verdict(rows, {}, Scene([slowest, 3000.0], **light)).verdict
    is_said = "More than 24 frames are searched" in said.replace("\n", " ")
    assert is_said == (number > 24)


def test_losses_of_a_burst_stand_in_the_tables_and_in_the_file():
    """Whether they matter or not."""
    taken = answer(OF_FRAMES, losses={"width_loss": 0.0413, "registration_loss": 0.00031})
    less = "30.00 dB, less 0.00031 by registration and 0.041 by borders"
    assert less in taken.text(verbose=True)
    assert less not in taken.text()
    saved = taken.to_dict()["sequence"]
    assert (saved["width_loss_db"], saved["registration_loss_db"]) == (0.0413, 0.00031)
    assert "width_loss_db" not in answer(OF_FRAMES).to_dict()["sequence"]


def test_rows_are_judged_at_the_worst_speed_where_the_loss_is():
    """Level, gain and answer are of it, whatever the means are, and the answer says so."""
    means = {"a": 24.0, BEST_SNAPSHOT: 24.5}
    worst = {"a": 23.0, BEST_SNAPSHOT: 21.0}
    rows = [
        replace(
            row,
            at_worst=True,
            metrics=replace(row.metrics, worst_speed_psnr=jnp.asarray(worst[row.name])),
        )
        for row in made_up(means)
    ]
    comparison = with_verdict(rows, {"a": HannShutter()}, SHORT)
    assert first(comparison).endswith(
        ": 23.0 dB at the worst speed, 2.0 dB better than a snapshot."
    )
    assert (
        "Expected PSNR of the restored picture in linear light, at the worst speed:"
        in comparison.text()
    )
    assert comparison.gain == 2.0


def test_a_speed_that_nothing_tells_is_said():
    """Of a decoder that looks for it in captures whose blur differs too little."""
    words = "The speed cannot be found: the blur differs too little between the speeds."
    for gain, is_said in ((0.0, True), (0.3, False)):
        rows = of_bursts({BEST_SNAPSHOT: 22.0, "rect": 24.5}, decoder="found")
        unknown, known = jnp.asarray(24.5 - gain), jnp.asarray(25.1)
        found = replace(rows[1].metrics, expected_psnr=unknown, known_speed_psnr=known)
        said = with_verdict([rows[0], replace(rows[1], metrics=found)], {}, SCENE).verdict
        assert (words in said) == is_said
        assert ("; the decoder finds the speed" in " ".join(said.split())) != is_said


@pytest.mark.parametrize("given", ["optimised", BEST_CODED_STILL])
def test_an_answer_has_lines_of_eighty_columns(given):
    """But for the first, which is one line whatever it says."""
    levels = {given: 21.25, BEST_SNAPSHOT: 19.75, BEST_PANNED_SNAPSHOT: 20.05}
    comparison = verdict(levels, given)
    _, *lines = comparison.text().splitlines()
    assert max(map(len, lines)) <= 80
    assert comparison.verdict.splitlines()[0] == comparison.text().splitlines()[0]


def test_a_ceiling_that_listed_speeds_exceed_is_theirs():
    """The ceiling of a table is the one of the scene, over the same snapshot."""
    comparison = verdict({"a": 21.5, BEST_SNAPSHOT: 20.0}, "a", scene=SHORT)
    assert comparison.ceiling == float(ceiling(SHORT))
    (line,) = (line for line in comparison.text().splitlines() if line.startswith(" ceiling of"))
    level = comparison.ceiling
    assert line.split()[4:] == [f"{level:.1f}", f"{level - 20.0:+.1f}", "-"]


def test_the_owner_of_nothing_buys_the_stage_that_pans():
    """Gains of purchases are over the snapshot at rest, unless the camera is turned to pan."""
    levels = {"a": 24.75, BEST_SNAPSHOT: 21.5, BEST_PANNED_SNAPSHOT: 23.25}
    bought = {
        turns: with_verdict(turned(made_up(levels)) if turns else made_up(levels), {}, SCENE)
        for turns in (False, True)
    }
    over = {
        turns: {name: table.over_nothing(row.level) for name, row in table.rivals.items()}
        for turns, table in bought.items()
    }
    assert over[False] == {"nothing": 0.0, "a stage": 1.75, "both": 3.25}
    assert over[True] == {"nothing": 0.0, "both": 1.5}
    for turns, table in bought.items():
        assert table.over_snapshot(24.75) == 1.5  # of every other gain
        gains = {name: row["over_nothing_db"] for name, row in table.to_dict()["rivals"].items()}
        assert gains == over[turns]


@pytest.mark.parametrize(
    ("burst", "why"),
    [
        (
            BurstMode(frames_per_s=11.7),
            "at 11.7 frames/s only one frame fits into the window of 60 ms; say a longer [burst] "
            "window_ms",
        ),
        (BurstMode(frames_per_s=130.0, max_frames=1), "[burst] max_frames is 1"),
        (BurstMode(frames_per_s=130.0), None),
    ],
)
def test_a_note_says_why_no_burst_is_compared(burst, why):
    """A camera that is too slow for a second frame, or may take no second one."""
    scene = eqx.tree_at(lambda x: x.burst, SCENE, burst, is_leaf=lambda x: x is None)
    notes = with_verdict(made_up({"a": 24.0, BEST_SNAPSHOT: 23.0}), {}, scene).notes
    assert notes == (() if why is None else (f"No burst is compared: {why}.",))


def test_the_best_of_a_purchase_is_the_simplest_of_one_level():
    """Where searches end in one place; a level that is higher, however little, is the best."""
    levels = {"a": 25.0, ON_FREE_PATH: 25.0, "rect": 25.0, BEST_SNAPSHOT: 24.0}
    assert {row.name for row in verdict(levels).rivals.values()} == {BEST_SNAPSHOT, "rect"}
    higher = verdict(levels | {ON_FREE_PATH: 25.02})
    assert higher.rivals["a stage"].name == ON_FREE_PATH


def test_what_leaks_is_a_share_of_what_passes():
    """Of all light, in the notes: a closed shutter passes the leakage of the transmission."""
    for device in (IdealDevice, SwitchedDevice):
        notes = device_notes(device(transmission=0.4, leakage=0.05))
        assert notes[0] == "The shutter passes 40.0% of the light when open, 2.00% when closed."
    assert device_notes(IdealDevice(transmission=1.0, leakage=0.003))[0].endswith(
        "0.30% when closed."
    )
    assert device_notes(IdealDevice()) == device_notes(None) == []


def test_a_device_says_itself_how_late_it_is():
    """The notes ask the device, so that one more kind needs no line here."""
    late = FirstOrderDevice(rise_time=2e-3, fall_time=7e-3, delay=3e-4, num_slots=11)
    words = "It rises from 10 to 90 % in 2 ms and falls in 7 ms, 0.3 ms late."
    assert late.lag_words == words
    assert device_notes(late) == [words, "It holds any level over each of 11 slots."]
    assert IdealDevice(levels=5).lag_words == SwitchedDevice().lag_words == ""


def test_rows_that_are_read_in_turn_are_said():
    """The assumption names the readout, and shaped shutters are left out with their reason."""
    rolling = replace(SCENE, sensor=Sensor(readout=0.0125))
    said = " ".join(verdict({BEST_SNAPSHOT: 25.0, "a": 25.1}, scene=rolling).verdict.split())
    assert "rows read within 12.5 ms." in said
    assert (
        "One exposure behind a shaped shutter, or on a path that accelerates, is left out" in said
    )
    with pytest.raises(ValueError, match=r"optimise\(shutter=...\)` must be open, as `RectShut"):
        optimise(rolling, shutter=HannShutter())


def test_what_a_decoder_loses_that_is_not_told_the_rows():
    """Parabolas that alternate lose 2 dB at 5 ms, and 4.5 at 10."""
    scene = Scene(np.linspace(-4500, 4500, 9), photon_rate=1e5, read_noise=8.0)
    frames = Exposures("", tuple(frames_on_parabolas()), 0.0, 0.0, 0.0)
    assert loss_untold(scene, frames) == pytest.approx((0.01, 4.45), abs=0.1)
    fast = replace(scene, burst=BurstMode(frames_per_s=200))
    assert loss_untold(fast, frames) == pytest.approx((0.005, 2.09), abs=0.1)
