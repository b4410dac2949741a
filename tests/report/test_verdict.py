"""The verdict of a scene: which camera it names, in which words."""

import math
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import pytest
from support.designs import SCENE, on_parabolas
from support.rows import MOVING, PANNED, SHORT, STILL, made_up, sequence, verdict

from mishutter import (
    Burst,
    FirstOrderShutter,
    HannShutter,
    IdealShutter,
    Occlusion,
    Sensor,
    SwitchedShutter,
    ceiling,
)
from mishutter.evaluation import SPEED_KNOWLEDGE, StillBursts
from mishutter.report import with_verdict
from mishutter.report.verdict import (
    RULES,
    Bursts,
    Case,
    bursts_of,
    device_notes,
    plain_stills,
    row_to_build,
    verdict_of,
)
from mishutter.search import (
    BEST_CODED_STILL,
    BEST_MOVING_BURST,
    BEST_PANNED_SNAPSHOT,
    BEST_SNAPSHOT,
    BEST_STILL_BURST,
    CODED_AT_REST,
    FRAMES,
    OPEN_ON_FREE_PATH,
    SHAPED_ON_FREE_PATH,
    SNAPSHOTS,
    STAGE,
    best_row,
)


@pytest.mark.slow
def test_the_verdict_is_of_the_best_that_was_given():
    """Beside the best snapshot, in dB, unless that is as good, or another with as much better."""
    most = f"{float(ceiling(SHORT)):.2f} dB"
    levels = {"a": 21.5, "b": 23.25, "Hann": 23.3}

    def said(comparison):
        """The verdict, but for the line about stills."""
        lines = comparison.verdict.splitlines()
        return "\n".join(line for line in lines if not line.startswith("Of 30 frames/s"))

    verdicts = {
        24.0: "Do not build a coded camera for this scene: nothing beats a snapshot by 0.1 dB.\n"
        f"Use an ordinary shutter: 2.6 ms, at rest, 24.00 dB. Ceiling: {most}.",
        23.17: "Build Hann: 23.30 dB, 0.13 dB above the best snapshot.\nIt is "
        f"{float(most[:-3]) - 23.3:.2f} dB below what any path and any shutter could reach "
        f"({most}).\nb takes as much and has 23.25 dB.",
        21.0: "Build b: 23.25 dB, 2.25 dB above the best snapshot.\nIt is "
        f"{float(most[:-3]) - 23.25:.2f} dB below what any path and any shutter could reach "
        f"({most}).\nHann has 23.30 dB: 0.05 more.",
    }
    for still, text in verdicts.items():
        comparison = verdict(levels | {BEST_SNAPSHOT: still}, "a", "b", scene=SHORT)
        assert comparison.gain == 23.25 - still
        assert said(comparison) == text
    comparison = verdict(levels | {BEST_SNAPSHOT: 21.0, "rect": 23.2}, "a", "b", scene=SHORT)
    assert said(comparison) == (
        "Build rect: 23.20 dB, 2.20 dB above the best snapshot.\n"
        f"It takes a stage: 20 ms, pan -12345 px/s, stroke 247 px. Ceiling: {most}.\n"
        "Hann has 23.30 dB with a shutter too: 0.10 more."
    )
    without = verdict(levels | {BEST_SNAPSHOT: 22.3})
    assert without.gain == 1


@pytest.mark.parametrize("given", ["optimised", BEST_CODED_STILL])
@pytest.mark.parametrize(
    "levels",
    [
        {BEST_SNAPSHOT: 21.15},
        {BEST_SNAPSHOT: 19.75},
        {BEST_SNAPSHOT: 19.75, BEST_PANNED_SNAPSHOT: 21.15},
        {BEST_SNAPSHOT: 19.75, BEST_PANNED_SNAPSHOT: 20.05},
        {BEST_SNAPSHOT: 19.75, CODED_AT_REST: 21.15},
        {BEST_SNAPSHOT: 19.75, BEST_PANNED_SNAPSHOT: 19.85, "rect": 21.15},
    ],
)
def test_the_verdict_is_a_few_lines_of_eighty_columns(levels, given):
    """Whatever it says, with the package's own names and velocities of five digits."""
    comparison = verdict({given: 21.2} | levels, given)
    lines = comparison.verdict.splitlines()
    assert 3 <= len(lines) <= 5
    assert max(map(len, lines)) <= 80
    assert f"{comparison.ceiling:.2f} dB" in comparison.verdict


def test_a_camera_that_does_not_pay_is_not_advised():
    """Where nothing beats a snapshot by 0.1 dB, the verdict names what to use instead."""
    levels = {"a": 24.09, "Hann": 23.9, BEST_SNAPSHOT: 24.0}
    assert "ordinary shutter: 2.6 ms, at rest, 24.00 dB." in verdict(levels, "a").verdict
    comparison = verdict(levels | {BEST_PANNED_SNAPSHOT: 26.0}, "a")
    assert comparison.verdict.startswith("Do not build a coded camera for this scene")
    assert "Use an ordinary shutter: 4 ms, pan -1500 px/s, 26.00 dB." in comparison.verdict
    assert (
        "The pan brings 2.00 dB and takes a stage: at rest it has 24.00 dB." in comparison.verdict
    )
    assert comparison.gain == pytest.approx(-1.91)


@pytest.mark.parametrize(("turns", "part"), [(False, "a stage"), (True, "a camera that turns")])
def test_a_pan_is_not_free(turns, part):
    """The verdict says which part makes it, in a line of eighty columns."""
    levels = {"a": 21.0, BEST_SNAPSHOT: 13.91, BEST_PANNED_SNAPSHOT: 26.25}
    rows = [replace(row, turns=turns) for row in made_up(levels)]
    said = with_verdict(rows, {}, SCENE).verdict.splitlines()
    assert said[2] == f"The pan brings 12.34 dB and takes {part}: at rest it has 13.91 dB."
    assert len(said[2]) <= 80


def test_no_stage_is_bought_for_a_pan_that_nobody_sees():
    """Of snapshots that two decimals do not tell apart the verdict names the one at rest."""
    levels = {"a": 23.95, BEST_SNAPSHOT: 24.0}
    equal, better = (
        verdict(levels | {BEST_PANNED_SNAPSHOT: panned}, "a") for panned in (24.004, 24.006)
    )
    assert equal.choice.name == BEST_SNAPSHOT
    assert "a stage" not in equal.verdict
    assert better.choice.name == BEST_PANNED_SNAPSHOT
    assert "takes a stage" in better.verdict


def test_the_owner_of_nothing_buys_the_stage_that_pans():
    """Gains of purchases are over the snapshot at rest, unless the camera is turned to pan."""
    levels = {"a": 24.75, BEST_SNAPSHOT: 21.5, BEST_PANNED_SNAPSHOT: 23.25}
    bought = {
        turns: with_verdict([replace(row, turns=turns) for row in made_up(levels)], {}, SCENE)
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


@pytest.mark.parametrize("gain", [0.001, 0.03, 0.05, 0.0999])
def test_a_gain_of_less_than_a_tenth_builds_nothing(gain):
    """Whether the row is the user's or the package's, and however near to 0.1 dB it comes."""
    levels = {"a": 24.0 + gain, "Hann": 23.0, BEST_SNAPSHOT: 24.0}
    for names in ((), ("a",)):
        comparison = verdict(levels, *names)
        assert comparison.choice.name == BEST_SNAPSHOT
        assert not comparison.is_to_build
        assert comparison.verdict.startswith("Do not build")
        more = [line for line in comparison.verdict.splitlines() if line.endswith(" more.")]
        assert more == (
            [f"a has {24 + gain:.2f} dB with a stage and a shutter too: {gain:.2f} more."]
            if gain >= 0.005
            else []
        )


@pytest.mark.parametrize("short", [0.02, 0.06, 0.0999])
def test_of_rows_within_a_tenth_the_simplest_or_the_own_is_built(short):
    """A row that is better by less than 0.1 dB changes nothing; one that is so by more does."""
    levels = {"a": 25.0, "Hann": 25.0 + short, BEST_SNAPSHOT: 23.0}
    assert verdict(levels, "a").choice.name == "a"  # the user's own, of as many parts
    assert verdict(levels).choice.name == "Hann"
    assert verdict(levels | {"Hann": 25.12}, "a").choice.name == "Hann"
    assert verdict(levels | {"rect": 25.0 - short + 0.0001}, "a").choice.name == "rect"
    assert verdict(levels | {"rect": 25.0 - short - 0.1}, "a").choice.name == "a"


@pytest.mark.parametrize("gain", [0.03, 0.06, 0.0999])
def test_a_simpler_row_that_does_not_pay_is_not_built(gain):
    """Though it is as good as the best to 0.1 dB: the snapshot is, too, and takes nothing."""
    levels = {"a": 24.12, "rect": 24.0 + gain, BEST_SNAPSHOT: 24.0}
    assert verdict(levels, "a").choice.name == "a"
    assert verdict(levels).choice.name == "a"
    assert verdict(levels | {"rect": 24.1001}, "a").choice.name == "rect"


def test_an_own_row_that_does_not_pay_is_not_preferred():
    """Beside a better one within 0.1 dB, where the own is above the snapshot by less than that."""
    levels = {"a": 24.07, "Hann": 24.13, BEST_SNAPSHOT: 24.0}
    assert verdict(levels, "a").choice.name == "Hann"
    assert verdict(levels | {"a": 24.11}, "a").choice.name == "a"


def test_each_rule_says_its_sentence_once():
    """Over verdicts of many kinds; a rule that none of them reached would be dead."""
    cases = [
        {"a": 24.0, BEST_SNAPSHOT: 24.2, BEST_PANNED_SNAPSHOT: 24.6},
        {"a": 24.9, BEST_SNAPSHOT: 24.0, "rect": 24.5, SHAPED_ON_FREE_PATH: 25.2},
        {"a": 24.9, BEST_SNAPSHOT: 24.0, "rect": 24.85},
        {"a": 24.0, BEST_SNAPSHOT: 23.0, "Hann": 24.4},
    ]
    still, moving = made_up({BEST_STILL_BURST: 30.0, BEST_MOVING_BURST: 30.5})
    losses = {"width_loss": 0.21, "registration_loss": 0.06}
    still, moving = (
        replace(x, sequence=replace(sequence(x.motion, 6, 31.0), **losses)) for x in (still, moving)
    )
    dim = replace(made_up({"dim": 20.0})[0], sequence=still.sequence)
    found = [
        Case(rows, choice, own, snapshot, 27.0, plain_stills(SCENE, choice), bursts)
        for levels, rest in zip(cases, (still, still, dim, still), strict=True)
        for bursts in [Bursts(rest, moving, 9, width=1300.0)]
        for rows in [made_up(levels)]
        for own, snapshot in [(rows[0], best_row(row for row in rows if row.name in SNAPSHOTS))]
        for choice in [row_to_build(rows, own, snapshot)]
    ]
    reached = {rule for case in found for rule in RULES if rule.applies(case)}
    assert len(set(RULES) - reached) == 3  # two of decoders that know the speed, one of layers
    for case in found:
        sentences = [rule.sentence(case) for rule in RULES if rule.applies(case)]
        assert verdict_of(case) == "\n".join(sentences)
        assert len(set(sentences)) == len(sentences)


@pytest.mark.parametrize(("rate", "holds_one"), [(11.7, True), (130.0, False)])
def test_a_note_says_that_a_camera_is_too_slow_for_a_burst(rate, holds_one):
    """Where no second frame has its time in the window; otherwise its bursts are rows."""
    scene = eqx.tree_at(
        lambda x: x.burst, SCENE, Burst(frames_per_s=rate), is_leaf=lambda x: x is None
    )
    notes = with_verdict(made_up({"a": 24.0, BEST_SNAPSHOT: 23.0}), {}, scene).notes
    words = "No burst is compared: of 11.7 frames/s only one has its time in the window."
    assert notes == ((words,) if holds_one else ())


def test_a_note_says_why_free_paths_that_were_asked_for_are_missing():
    """Of a stage whose jerk is limited, and of tolerances; nothing of what was not asked for."""
    rows = made_up({"a": 24.0, BEST_SNAPSHOT: 23.0})
    for scene, why in ((on_parabolas(SCENE), "the jerk of the stage"), (SCENE, "")):
        asked = with_verdict(rows, {}, scene, free_paths=True).notes
        assert [f"No free path is compared: {why}" in note for note in asked] == [True] * bool(why)
        assert with_verdict(rows, {}, scene).notes == ()


def test_a_free_path_is_advised_where_the_design_does_not_pay():
    """One that pays stays, and what the path would bring is told beside it."""
    levels = {"a": 24.0, SHAPED_ON_FREE_PATH: 24.75, BEST_SNAPSHOT: 23.5}
    pays = verdict(levels, "a", scene=SHORT).verdict.splitlines()
    assert pays[0] == "Build a: 24.00 dB, 0.50 dB above the best snapshot."
    assert pays[2] == "Shaped on a free path has 24.75 dB: 0.75 more."
    advised = verdict(levels | {BEST_SNAPSHOT: 23.95}, "a", scene=SHORT).verdict.splitlines()
    assert advised[0] == "Build shaped on a free path: 24.75 dB, 0.80 dB above the best snapshot."
    assert advised[2] == "a takes as much and has 24.00 dB."


def test_the_simplest_of_equals_is_advised():
    """A parabola before a free path, an ordinary shutter before a made one, fewer parts first."""
    levels = {"a": 26.51, OPEN_ON_FREE_PATH: 26.57, "rect": 26.55, BEST_SNAPSHOT: 24.0}
    lines = verdict(levels, "a", scene=SHORT).verdict.splitlines()
    assert lines[0] == "Build rect: 26.55 dB, 2.55 dB above the best snapshot."
    assert lines[2] == "Open on a free path has 26.57 dB: 0.02 more."
    better = verdict(levels | {OPEN_ON_FREE_PATH: 26.66}, "a", scene=SHORT).verdict.splitlines()
    assert better[0] == "Build open on a free path: 26.66 dB, 2.66 dB above the best snapshot."
    assert better[-2] == "The nearest simpler camera, rect, is 0.11 dB below it."
    other = verdict({CODED_AT_REST: 26.6, "rect": 26.55, BEST_SNAPSHOT: 24.0})
    assert other.verdict.startswith(f"Build {CODED_AT_REST}: 26.60 dB")  # no stage for a shutter


def test_the_best_of_a_purchase_is_the_simplest_of_one_level():
    """Where searches end in one place; a level that is higher, however little, is the best."""
    levels = {"a": 25.0, OPEN_ON_FREE_PATH: 25.0, "rect": 25.0, BEST_SNAPSHOT: 24.0}
    assert {row.name for row in verdict(levels).rivals.values()} == {BEST_SNAPSHOT, "rect"}
    higher = verdict(levels | {OPEN_ON_FREE_PATH: 25.02})
    assert higher.rivals["a stage"].name == OPEN_ON_FREE_PATH


def test_a_decoder_that_finds_the_speed_needs_no_shutter_where_an_open_one_is_as_good():
    """The verdict says so of a row that takes a stage alone, and not of one with a shutter too."""
    words = "A stage and a decoder that finds the speed: no shutter is needed."
    for level, speed, is_said in ((23.0, "found", 1), (23.0, "unknown", 0), (25.0, "found", 0)):
        rows = [
            replace(
                row,
                decoder=SPEED_KNOWLEDGE[speed],
                metrics=replace(row.metrics, found_speed_psnr=found, expected_psnr=found - 1),
            )
            for row in made_up({"rect": 24.0, "Hann": level, BEST_SNAPSHOT: 22.0})
            for found in [row.metrics.expected_psnr]
        ]
        assert (words in with_verdict(rows, {}, SCENE).verdict) == bool(is_said)


def test_a_snapshot_that_pans_is_not_said_to_find_the_speed():
    """Nothing of the verdict follows from a decoder that finds it, whatever the stage does."""
    rows = [
        replace(row, decoder=SPEED_KNOWLEDGE["found"])
        for row in made_up({BEST_SNAPSHOT: 1.0, "rect": 1.0})
    ]
    better = replace(rows[0].metrics, found_speed_psnr=rows[0].metrics.found_speed_psnr + 1)
    panned = replace(rows[0], name=BEST_PANNED_SNAPSHOT, motion=PANNED, metrics=better)
    said = with_verdict([*rows, panned], {}, SCENE).verdict
    assert said.startswith("Do not build a coded camera")
    assert "The pan brings 1.00 dB and takes a stage" in said
    assert "finds the speed" not in said
    assert "No speed can be found: the blur differs too little over the speeds." not in said
    found = panned.metrics.found_speed_psnr
    short = replace(panned.metrics, expected_psnr=found, known_speed_psnr=found + 0.5)
    said = with_verdict([*rows, replace(panned, metrics=short)], {}, SCENE).verdict
    assert "No speed can be found: the blur differs too little over the speeds." in said


def test_rows_are_judged_at_the_worst_speed_where_the_loss_is():
    """Level, gain and verdict are of it, whatever the means are, and the verdict says so."""
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
    line = "Build a: 23.00 dB at the worst speed, 2.00 dB above the best snapshot."
    assert comparison.verdict.splitlines()[0] == line
    assert comparison.gain == 2.0


def test_what_leaks_is_a_share_of_what_passes():
    """Of all light, in the notes: a closed shutter passes the leakage of the transmission."""
    for device in (IdealShutter, SwitchedShutter):
        notes = device_notes(device(transmission=0.4, leakage=0.05))
        assert notes[0] == "The shutter passes 40.0% of the light when open, 2.00% when closed."
    assert device_notes(IdealShutter(transmission=1.0, leakage=0.003))[0].endswith(
        "0.30% when closed."
    )
    assert device_notes(IdealShutter()) == device_notes(None) == []


def test_a_device_says_itself_how_late_it_is():
    """The notes ask the device, so that one more kind needs no line here."""
    late = FirstOrderShutter(rise_time=2e-3, fall_time=7e-3, delay=3e-4, num_slots=11)
    words = "It rises from 10 to 90 % in 2 ms and falls in 7 ms, 0.3 ms late."
    assert late.lag_words == words
    assert device_notes(late) == [words, "It holds any level over each of 11 slots."]
    assert IdealShutter(levels=5).lag_words == SwitchedShutter().lag_words == ""


def _said_of_stills(scene, levels, decoder="unknown"):
    """The sentence on stills of a verdict on rows of these levels by this decoder."""
    knows = SPEED_KNOWLEDGE[decoder]
    rows = [replace(row, decoder=knows) for row in made_up(levels)]
    metrics = {
        row.name: replace(row.metrics, **{knows.level: jnp.asarray(levels[row.name])})
        for row in rows
    }
    rows = [replace(row, metrics=metrics[row.name]) for row in rows]
    said = with_verdict(rows, {}, scene).verdict
    first = said.replace("\n", " ").partition("It is ")[0].strip()
    return first if " but below " in first else said.splitlines()[-1]


def test_no_headline_is_silent_about_a_plain_burst():
    """What stills at 30 frames/s reach stands last, and in the headline where they beat it."""
    builds = {"a": 23.0, BEST_SNAPSHOT: 21.0}
    assert _said_of_stills(SCENE, builds) == (
        "Build a: 23.00 dB, 2.00 dB above the best snapshot, but below "
        "2 stills at 30 frames/s, registered by object: 28.54 dB; 17 frames/s equal it."
    )
    assert _said_of_stills(SCENE, builds, "known") == (
        "Build a: 23.00 dB, 2.00 dB above the best snapshot, but below "
        "2 registered stills at 30 frames/s: 28.54 dB; 17 frames/s equal it."
    )
    assert _said_of_stills(SCENE, {"a": 29.75, BEST_SNAPSHOT: 21.0}, "found") == (
        "2 registered stills at 30 frames/s: 28.54 dB; 69 frames/s equal it."
    )
    none = _said_of_stills(SCENE, {"a": 23.0, BEST_SNAPSHOT: 24.1})
    assert none == "2 stills at 30 frames/s, registered by object: 28.54 dB, 4.44 above it."
    far = _said_of_stills(SCENE, {"a": 45.0, BEST_SNAPSHOT: 21.0}, "known")
    assert far == "2 registered stills at 30 frames/s: 28.54 dB; 1000 frames/s do not equal it."


def test_a_short_exposure_leaves_no_room_for_a_burst():
    """Where one frame at 30/s is all of it, the verdict has the rate alone, or says nothing."""
    scene = SHORT
    said = _said_of_stills(scene, {"a": 26.9, BEST_SNAPSHOT: 21.0}, "known")
    assert said.startswith("Of 30 frames/s no more than one pays within the longest exposure; ")
    assert said.endswith("frames/s equal it.")
    assert "stills" not in _said_of_stills(scene, {"a": 23.0, BEST_SNAPSHOT: 24.1}, "known")


def test_a_scene_with_a_burst_or_a_background_has_no_such_line():
    """The first has the rows of its own bursts; frames aligned for objects blur a background."""
    levels = {"a": 23.0, BEST_SNAPSHOT: 21.0}
    burst = eqx.tree_at(
        lambda each: each.burst,
        SCENE,
        Burst(frames_per_s=60.0, max_frames=3),
        is_leaf=lambda x: x is None,
    )
    layered = SCENE.with_occlusion(Occlusion(front_share=0.6))
    for scene in (burst, layered):
        assert "stills" not in _said_of_stills(scene, levels)


def _said_of_bursts(still, moving, decoder="unknown", width=None, still_losses=(), losses=()):
    """What a verdict says of bursts of these levels, 6 stills and 4 frames that swing 45 px."""
    knows = SPEED_KNOWLEDGE[decoder]
    levels = {"a": 24.0, BEST_SNAPSHOT: 22.0, BEST_STILL_BURST: still, BEST_MOVING_BURST: moving}
    rows = [
        replace(
            row,
            decoder=knows,
            metrics=replace(row.metrics, **{knows.level: jnp.asarray(levels[row.name])}),
        )
        for row in made_up(levels)
    ]
    of_burst = {
        BEST_STILL_BURST: {"sequence": replace(sequence(STILL, 6), **dict(still_losses))},
        BEST_MOVING_BURST: {"sequence": replace(sequence(MOVING, 4, 45.0), **dict(losses))},
    }
    rows = [
        replace(row, hardware=frozenset({STAGE, FRAMES}), **of_burst[row.name])
        if row.name in of_burst
        else row
        for row in rows
    ]
    scene = eqx.tree_at(
        lambda each: (each.burst, each.sensor),
        SCENE,
        (Burst(frames_per_s=60.0, max_frames=6), Sensor(width=width)),
        is_leaf=lambda x: x is None,
    )
    return with_verdict(rows, {}, scene)


def test_a_burst_that_pays_is_taken_and_moves_where_that_pays():
    """The verdict says which frames, over what they gain, and what has to register them."""
    taken = _said_of_bursts(27.25, 29.5, "known")
    first, last = taken.verdict.replace("\n", " ").split(" Rect")[0], taken.choice.name
    assert first.startswith(
        "Take 4 frames of 20 ms while the stage swings 45 px: 29.50 dB, 2.25 dB above the best "
        "still burst (6 of 2.6 ms), as much as 4 stills in the same time. a, of one exposure, "
        "has 24.00 dB: "
    )
    assert last == BEST_MOVING_BURST
    assert taken.is_to_build
    assert taken.sequence.travel == 45.0
    saved = taken.to_dict()["sequence"]
    assert (saved["travel_px"], len(saved["frames"])) == (45.0, 4)
    assert saved["frames"][2]["time_s"] == pytest.approx(0.06)
    assert saved["frames"][2]["motion"]["half_exposure"] == pytest.approx(1e-2)
    said = _said_of_bursts(27.25, 29.5).verdict
    assert "\nIf objects are registered, take 4 frames of 20 ms while" in said
    assert said.startswith("Build a: ")
    assert max(map(len, said.splitlines())) <= 80


def test_stills_are_taken_where_moving_gains_nothing():
    """They take nothing to build, so that they need to be no better than what does."""
    rests = _said_of_bursts(27.25, 27.3, "known")
    assert rests.verdict.startswith("Do not move: 6 stills of 2.6 ms have 27.25 dB, 3.25 dB above")
    assert (rests.choice.name, rests.is_to_build) == (BEST_STILL_BURST, False)
    assert not rests.sequence.moves
    assert _said_of_bursts(23.95, 23.97, "known").verdict.startswith("Do not move: ")
    single = _said_of_bursts(23.8, 23.85, "known")
    assert single.verdict.startswith("Build a: ")
    assert "stills of" not in single.verdict
    assert single.choice.name == "a"


@pytest.mark.parametrize("decoder", ["known", "unknown"])
def test_a_verdict_says_what_leaves_the_sensor_where_it_matters(decoder):
    """With the loss of the still burst, and the price of registration where that matters too."""
    own = {"width_loss": 0.4812, "registration_loss": 0.0731}
    said = _said_of_bursts(27.25, 29.5, decoder, 517.0, {"width_loss": 0.274}, own).verdict
    assert max(map(len, said.splitlines())) <= 80
    assert (
        "in the same time. On a sensor of 517 px, points that leave it cost 0.48 dB, and the best "
        "still burst 0.27 dB. Registration by 64 x 64 px costs 0.07 dB at the worst speed."
    ) in said.replace("\n", " ")
    little = {"width_loss": 0.049, "registration_loss": 0.049}
    said = _said_of_bursts(27.25, 29.5, decoder, 5170.0, {"width_loss": 0.3}, little).verdict
    assert "sensor of" not in said
    assert "Registration" not in said


def test_a_verdict_says_what_leaves_the_sensor_of_a_still_burst():
    """Of that burst alone, where it is the one to take."""
    rests = {"width_loss": 0.163, "registration_loss": 0.002}
    said = _said_of_bursts(27.25, 27.3, "known", 800.0, rests, {"width_loss": 0.31}).verdict
    assert "\nOn a sensor of 800 px, points that leave it cost 0.16 dB.\n" in said
    leaves = {"width_loss": 2.5}
    said = _said_of_bursts(27.25, 29.5, "known", 300.0, rests, leaves).verdict
    assert said.startswith("Do not move: ")
    single = _said_of_bursts(23.8, 23.85, "known", 800.0, rests).verdict
    assert "sensor of" not in single


def test_losses_of_a_burst_stand_in_the_tables_and_in_the_file():
    """Whether they matter or not."""
    own = {"width_loss": 0.0413, "registration_loss": 0.00031}
    taken = _said_of_bursts(27.25, 29.5, "known", 5170.0, {}, own)
    less = "30.00 dB, less 0.00031 by registration and 0.041 by the width of the sensor"
    assert less in taken.text(verbose=True)
    assert less not in taken.text()
    saved = taken.to_dict()["sequence"]
    assert (saved["width_loss_db"], saved["registration_loss_db"]) == (0.0413, 0.00031)
    assert "width_loss_db" not in _said_of_bursts(27.25, 29.5, "known").to_dict()["sequence"]


def test_notes_say_that_rows_of_bursts_are_of_another_decoder():
    """Their levels stand in one column with those of one filter for all speeds."""
    note = "bursts       of frames that are registered, so that each speed is known"
    assert note in _said_of_bursts(27.25, 29.5).text()
    assert "bursts" not in verdict({"a": 24.5, BEST_SNAPSHOT: 22.0}).text()


def test_a_camera_that_takes_frames_keeps_the_design_and_says_what_frames_do():
    """One filter serves all speeds: the design stands, and a reader of one sentence learns more."""
    said = _said_of_bursts(23.25, 26.5)
    first, *_ = said.verdict.split(".\n")
    assert first.replace("\n", " ") == (
        "Build a: 24.00 dB, 2.00 dB above the best snapshot, "
        "but below 4 frames, registered by object: 26.50 dB"
    )
    assert (said.choice.name, said.is_to_build, said.is_below_frames) == ("a", True, True)
    assert not _said_of_bursts(23.25, 23.5).is_below_frames
    text = said.verdict.replace("\n", " ")
    assert "If objects are registered, take 4 frames of 20 ms" in text
    rate = StillBursts(SCENE).rate_that_equals(24.0, most=1000.0)
    assert text.endswith(f"Registered stills at {math.ceil(rate)} frames/s equal a.")


def test_no_rate_is_named_where_the_frames_of_the_camera_are_enough():
    """Its own still burst equals the design, or the verdict is not to build one."""
    assert "Registered stills at" not in _said_of_bursts(24.1, 26.5).verdict
    assert "Registered stills at" not in _said_of_bursts(23.25, 26.5, "known").verdict


def test_no_number_of_stills_equals_a_burst_that_none_does():
    """The sentence says so, and names no number."""
    said = _said_of_bursts(27.25, 39.5, "known").verdict.replace("\n", " ")
    assert "more than any number of stills in the same time." in said


def test_stills_are_named_beside_a_single_exposure_that_a_told_speed_makes_better():
    """Where the best of the moving bursts is one exposure, nothing registers it."""
    rows = {
        name: row
        for name, row in zip("sm", made_up({BEST_STILL_BURST: 25.0, "m": 26.6}), strict=True)
    }
    still = replace(rows["s"], sequence=sequence(STILL, 2))
    moving = replace(rows["m"], name=BEST_MOVING_BURST, sequence=sequence(MOVING, 1, 38.0))
    found = bursts_of(SCENE, [still, moving])
    assert found.top is found.still is still
    several = replace(moving, sequence=sequence(MOVING, 3, 38.0))
    assert bursts_of(SCENE, [still, several]).top is several
