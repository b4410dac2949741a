"""The verdict of a scene: which camera it names, in which words."""

from dataclasses import replace

import jax.numpy as jnp
import pytest
from support.designs import SCENE
from support.rows import PANNED, made_up, verdict

from mishutter import HannShutter, ceiling
from mishutter.report import with_verdict
from mishutter.search import (
    BEST_CODED_STILL,
    BEST_PANNED_SNAPSHOT,
    BEST_SNAPSHOT,
    CODED_AT_REST,
    OPEN_ON_FREE_PATH,
    SHAPED_ON_FREE_PATH,
)


@pytest.mark.slow
def test_the_verdict_is_of_the_best_that_was_given():
    """Beside the best snapshot, in dB, unless that is as good, or another with as much better."""
    most = f"{float(ceiling(SCENE)):.2f} dB"
    levels = {"a": 21.5, "b": 23.25, "Hann": 23.3}
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
        comparison = verdict(levels | {BEST_SNAPSHOT: still}, "a", "b")
        assert comparison.gain == 23.25 - still
        assert comparison.verdict == text
    comparison = verdict(levels | {BEST_SNAPSHOT: 21.0, "rect": 23.2}, "a", "b")
    assert comparison.verdict == (
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
    assert 2 <= len(lines) <= 4
    assert max(map(len, lines)) <= 80
    assert f"{comparison.ceiling:.2f} dB" in lines[1]


def test_a_camera_that_does_not_pay_is_not_advised():
    """Where nothing beats a snapshot by 0.1 dB, the verdict names what to use instead."""
    levels = {"a": 24.09, "Hann": 23.9, BEST_SNAPSHOT: 24.0}
    assert "ordinary shutter: 2.6 ms, at rest, 24.00 dB." in verdict(levels, "a").verdict
    comparison = verdict(levels | {BEST_PANNED_SNAPSHOT: 26.0}, "a")
    assert comparison.verdict.startswith("Do not build a coded camera for this scene")
    assert "Use an ordinary shutter: 4 ms, pan -1500 px/s, 26.00 dB." in comparison.verdict
    assert "The pan alone brings 2.00 dB: a snapshot at rest has 24.00 dB." in comparison.verdict
    assert comparison.gain == pytest.approx(-1.91)


def test_a_free_path_is_advised_where_the_design_does_not_pay():
    """One that pays stays, and what the path would bring is told beside it."""
    levels = {"a": 24.0, SHAPED_ON_FREE_PATH: 24.75, BEST_SNAPSHOT: 23.5}
    pays = verdict(levels, "a").verdict.splitlines()
    assert pays[0] == "Build a: 24.00 dB, 0.50 dB above the best snapshot."
    assert pays[2] == "Shaped on a free path has 24.75 dB: 0.75 more."
    advised = verdict(levels | {BEST_SNAPSHOT: 23.95}, "a").verdict.splitlines()
    assert advised[0] == "Build shaped on a free path: 24.75 dB, 0.80 dB above the best snapshot."
    assert advised[2] == "a takes as much and has 24.00 dB."


def test_the_plainest_of_equals_is_advised():
    """A parabola before a free path, an ordinary shutter before a made one, fewer parts first."""
    levels = {"a": 26.51, OPEN_ON_FREE_PATH: 26.57, "rect": 26.55, BEST_SNAPSHOT: 24.0}
    lines = verdict(levels, "a").verdict.splitlines()
    assert lines[0] == "Build rect: 26.55 dB, 2.55 dB above the best snapshot."
    assert lines[2] == "Open on a free path has 26.57 dB: 0.02 more."
    better = verdict(levels | {OPEN_ON_FREE_PATH: 26.66}, "a").verdict.splitlines()
    assert better[0] == "Build open on a free path: 26.66 dB, 2.66 dB above the best snapshot."
    assert better[-1] == "The nearest simpler camera, rect, is 0.11 dB below it."
    other = verdict({CODED_AT_REST: 26.6, "rect": 26.55, BEST_SNAPSHOT: 24.0})
    assert other.verdict.startswith(f"Build {CODED_AT_REST}: 26.60 dB")  # no stage for a shutter


def test_the_best_of_a_purchase_is_the_plainest_of_one_level():
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
                speed=speed,
                metrics=replace(row.metrics, found_speed_psnr=found, expected_psnr=found - 1),
            )
            for row in made_up({"rect": 24.0, "Hann": level, BEST_SNAPSHOT: 22.0})
            for found in [row.metrics.expected_psnr]
        ]
        assert (words in with_verdict(rows, {}, SCENE).verdict) == bool(is_said)


def test_a_snapshot_that_pans_is_not_said_to_find_the_speed():
    """Nothing of the verdict follows from a decoder that finds it, whatever the stage does."""
    rows = [replace(row, speed="found") for row in made_up({BEST_SNAPSHOT: 1.0, "rect": 1.0})]
    better = replace(rows[0].metrics, found_speed_psnr=rows[0].metrics.found_speed_psnr + 1)
    panned = replace(rows[0], name=BEST_PANNED_SNAPSHOT, motion=PANNED, metrics=better)
    said = with_verdict([*rows, panned], {}, SCENE).verdict
    assert said.startswith("Do not build a coded camera")
    assert "The pan alone brings 1.00 dB" in said
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
    comparison = with_verdict(rows, {"a": HannShutter()}, SCENE)
    line = "Build a: 23.00 dB at the worst speed, 2.00 dB above the best snapshot."
    assert comparison.verdict.splitlines()[0] == line
    assert comparison.gain == 2.0
