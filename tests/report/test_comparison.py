"""A design beside its baselines: two readings, one table, and names that stay apart."""

import re
from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from support.designs import MOTION, OUTLIER, SCENE, SLOW
from support.rows import changed, made_up, verdict

from mishutter import (
    GaussianShutter,
    HannShutter,
    KnownSpeedLoss,
    Limits,
    Scene,
    StillCamera,
    TukeyShutter,
    WorstSpeedLoss,
    baselines,
    compare,
    optimise,
)
from mishutter.evaluation.speed_knowledge import SPEED_KNOWLEDGE
from mishutter.report.comparison import with_verdict
from mishutter.report.tables import page_table
from mishutter.search.rivals import BEST_STILL_BURST, BEST_TUKEY, CODED_AT_REST, taken_names
from mishutter.search.rows import BEST_PANNED_SNAPSHOT, BEST_SNAPSHOT, OWN_BEST_MOTION, SAME_MOTION

ROUNDING_DB = 1e-9


TOLD = Scene.uniform(
    max_speed=2000.0,
    num_speeds=5,
    photon_rate=1e5,
    read_noise=10.0,
    limits=SCENE.limits,
    decoder_speed="known",
)
"""The small scene, for a decoder that knows the speed."""


@pytest.fixture(scope="module")
def table():
    """Of two baselines under their own names, and of a shutter that is one of them."""
    hann, gaussian = HannShutter(), GaussianShutter()
    return compare(OUTLIER, SLOW, {"Hann": hann, "Gaussian": gaussian, "mine": hann})


@pytest.mark.slow
def test_its_own_best_motion_is_never_below_the_same_motion(table):
    """Also where the motion at hand gives up what the fastest object would ask for."""
    for row in table.rows:
        if row.reading == SAME_MOTION:
            own = table.row(row.name, OWN_BEST_MOTION)
            same = float(row.metrics.expected_psnr)
            assert float(own.metrics.expected_psnr) >= same - ROUNDING_DB
            assert np.isfinite(same)


@pytest.mark.slow
def test_nothing_to_restore_is_said_in_words():
    """A scene without detail: no decibels of infinity, and no gain; a list has numbers as names."""
    grey = eqx.tree_at(
        lambda scene: scene.picture.deviation, SCENE, jnp.zeros_like(SCENE.picture.deviation)
    )
    table = compare(grey, MOTION, [HannShutter()])
    assert "there is nothing to restore" in table.verdict
    assert table.gain == 0
    assert table.row("shutter 0").metrics == table.row("Hann").metrics
    assert "shutter 0" in table.text(verbose=True)


def test_what_each_purchase_brings():
    """The best of nothing, a stage, a shutter and both, given or not; a burst is none of them."""
    levels = {"a": 23.0, "Hann": 24.5, "rect": 22.25, BEST_SNAPSHOT: 21.5}
    levels |= {BEST_PANNED_SNAPSHOT: 21.75, CODED_AT_REST: 21.625, BEST_STILL_BURST: 29.0}
    comparison = verdict(levels, "a")
    names = {takes: row.name for takes, row in comparison.rivals.items()}
    assert names == {
        "nothing": BEST_SNAPSHOT,
        "a stage": "rect",
        "a shutter": CODED_AT_REST,
        "both": "Hann",
    }
    document = comparison.to_dict()["rivals"]
    assert {takes: each["name"] for takes, each in document.items()} == names
    assert document["both"]["expected_psnr_db"] == 24.5
    assert document["both"]["over_nothing_db"] == 3.0
    assert document["a stage"]["motion"]["velocity"] == -12345.0
    _, table = comparison.text(verbose=True).split("Gain of each purchase over buying nothing\n")
    heads, *lines = [re.split(r"\s{2,}", line) for line in table.splitlines()[:5]]
    assert heads[:3] == ["purchase: its best", "PSNR dB", "gain dB"]
    assert [[*line[:3], *line[4:]] for line in lines] == [
        ["nothing: best snapshot", "21.50", "+0.00", "0.0", "0", "2.60"],
        ["a stage: rect", "22.25", "+0.75", "246.9", "-12345", "20.00"],
        ["a shutter: best coded at rest", "21.62", "+0.12", "0.0", "0", "2.60"],
        ["both: Hann", "24.50", "+3.00", "22.0", "0", "20.00"],
    ]
    better = verdict(levels | {"a": 25.0}, "a")
    assert better.rivals["both"].name == "a"


@pytest.mark.slow
def test_a_scene_names_the_decoder_that_all_are_judged_by():
    """Design, rivals, gain and ceiling are of it, as by the loss of that decoder.

    The design alone is compared on its own motion, as "optimised".
    """
    design = optimise(TOLD, num_starts=6)
    same = optimise(SCENE, loss=KnownSpeedLoss(), num_starts=6)
    assert float(design.loss) == float(same.loss)
    comparison = compare(TOLD, design)
    assert {row.decoder.name for row in comparison.rows} == {"known"}
    levels = [float(row.metrics.known_speed_psnr) for row in comparison.rows]
    assert [row.level for row in comparison.rows] == levels
    assert max(levels) <= comparison.ceiling
    worst = [float(row.metrics.worst_known_speed_psnr) for row in comparison.rows]
    assert [row["worst_speed_psnr_db"] for row in comparison.to_dict()["rows"]] == worst
    assert all(low < mean for low, mean in zip(worst, levels, strict=True))
    assert comparison.row("optimised", SAME_MOTION).motion is design.motion
    of_loss = compare(SCENE, same.motion, {"optimised": same}, loss=KnownSpeedLoss())
    assert comparison.text() == of_loss.text()


@pytest.mark.slow
def test_a_search_for_the_worst_speed_is_better_there_and_worse_in_the_mean():
    """Than one for the mean; a comparison judges every row by it, below the ceiling."""
    loss = WorstSpeedLoss()
    for_worst, for_mean = (optimise(SCENE, loss=x, num_starts=6) for x in (loss, None))
    worst, mean = (for_worst.metrics, for_mean.metrics)
    assert float(worst.worst_speed_psnr) > float(mean.worst_speed_psnr)
    assert float(worst.expected_psnr) < float(mean.expected_psnr)
    comparison = compare(SCENE, for_worst, loss=loss)
    rows = [row for row in comparison.rows if row.is_of_one_exposure]
    levels = [float(row.metrics.worst_speed_psnr) for row in rows]
    assert [row.level for row in rows] == levels
    assert max(levels) <= comparison.ceiling
    assert comparison.row("optimised").level >= max(row.level for row in comparison.rows[:3]) - 1e-3


def test_gains_are_over_the_best_snapshot_that_is_allowed():
    """One that pans, where that is better, in tables of rows; those of options are over rest."""
    levels = {"a": 24.0, BEST_SNAPSHOT: 21.0, BEST_PANNED_SNAPSHOT: 23.0}
    table = verdict(levels, "a")
    assert table.gain == table.over_snapshot(24.0) == table.to_dict()["gain_db"] == 1.0
    assert table.over_snapshot(21.0) == -2.0
    assert "24.0 dB, 3.0 dB better than a snapshot." in table.verdict
    assert table.options_baseline.level == 21.0


def table_lines(comparison):
    """The lines of its first table as text, split into cells, without its notes."""
    lines = comparison.tables[0].text().splitlines()
    end = next(i for i, line in enumerate(lines) if line.startswith("ceiling"))
    return [re.split(r"\s{2,}", line) for line in lines[2 : end + 1]]


def test_a_camera_is_one_row_by_all_of_its_names():
    """Two searches that end in one place are one row; each name still finds its own."""
    rows = made_up({"mine": 25.5, "rect": 26.75, BEST_TUKEY: 26.75, BEST_SNAPSHOT: 24.0})
    mine, opened, tapered, snapshot = rows
    tapered = changed(tapered, motion=opened.motion, shutter=TukeyShutter(1e-6))
    panned = replace(snapshot, name=BEST_PANNED_SNAPSHOT)
    rows = [mine, opened, tapered, snapshot, panned]
    comparison = with_verdict(rows, {"mine": HannShutter()}, SCENE)
    names = [cells[0] for cells in table_lines(comparison)]
    assert names == [
        "mine",
        "rect = best Tukey",
        BEST_SNAPSHOT,
        f"= {BEST_PANNED_SNAPSHOT}",
        "ceiling",
    ]
    assert [comparison.row(row.name) for row in rows] == rows
    document = comparison.to_dict()["rows"]
    assert [each["name"] for each in document] == [row.name for row in rows]


@pytest.mark.slow
def test_no_row_exceeds_the_ceiling(table):
    """At its own best motion or at the same."""
    rows = [row for row in table.rows if row.is_of_one_exposure]
    assert len(rows) > 3
    assert all(float(row.metrics.expected_psnr) <= table.ceiling for row in rows)


@pytest.mark.slow
def test_a_scene_of_one_speed_is_panned():
    """An open shutter on a camera that keeps up with it is as good as anything."""
    turned = Limits(
        max_top_speed=2e4,
        min_half_exposure=5e-4,
        max_half_exposure=0.03,
        pans="camera",
    )
    scene = Scene([1500.0], photon_rate=1e5, read_noise=4.0, limits=turned)
    table = compare(scene, MOTION, {"mine": HannShutter()})
    snapshot = table.row(BEST_PANNED_SNAPSHOT)
    assert float(snapshot.motion.velocity) == pytest.approx(1500.0, abs=1.0)
    assert table.verdict.startswith("Take a snapshot on a pan of 1,500 px/s: ")
    assert table.gain < 0.1


def test_everybody_sees_one_table():
    """The command's and the page's cells are those of the text, and each column has its note."""
    comparison = verdict({"a": 24.5, BEST_SNAPSHOT: 24.0}, "a")
    first, *others = comparison.tables
    tables = "\n\n".join(each.text() for each in (first, *others))
    assert comparison.text(verbose=True).endswith(f"\n\n{tables}")
    assert comparison.text(verbose=True).startswith(f"{comparison.text()}\n")
    over = comparison.ceiling - 24.0
    most = ["ceiling", f"{comparison.ceiling:.2f}", f"{over:+.2f}"]
    assert table_lines(comparison)[-1] == most
    wide = page_table(comparison.rows, within=False)
    assert wide.columns[: len(first.columns)] == first.columns
    for cells, row in zip(wide.rows, first.rows, strict=False):
        assert cells[: len(row)] == row
    explained = [note.split("  ")[0] for note in first.notes]
    assert explained == [*first.columns[1:], "ceiling", "PSNR"]
    assert wide.columns[len(first.columns) :] == ("condition", "kernel diff", "relative", "bound")


def test_the_worst_speed_is_of_the_decoder_that_judges():
    """By one filter, or by one that knows the speed; of one that finds it nothing is said."""
    rows = verdict({"a": 21.5, BEST_SNAPSHOT: 24.0}, "a").rows
    m = rows[0].metrics
    assert float(m.worst_speed_psnr) < float(m.worst_known_speed_psnr) < float(m.known_speed_psnr)
    cells = {
        "unknown": (f"{float(m.worst_speed_psnr):.2f}", "of one linear filter for all"),
        "known": (f"{float(m.worst_known_speed_psnr):.2f}", "of a filter that knows it"),
        "found": ("–", "of a decoder that finds the speed is known in the mean alone"),
    }
    for knows, (cell, words) in cells.items():
        judged = with_verdict(
            [replace(row, decoder=SPEED_KNOWLEDGE[knows]) for row in rows], {}, SCENE
        )
        whole = judged.text(verbose=True)
        line = next(line for line in whole.splitlines() if line.startswith("a  "))
        assert line.split()[3] == cell
        (note,) = (line for line in whole.splitlines() if line.startswith("worst speed  "))
        assert note.endswith(words)
        worst = judged.to_dict()["rows"][0]["worst_speed_psnr_db"]
        assert worst is None if knows == "found" else f"{worst:.2f}" == cell


@pytest.mark.slow
def test_a_row_that_is_not_there(table):
    """It is refused by the names that are."""
    with pytest.raises(ValueError, match=r"name=...\)` must be one of .*Hann, .*; got 'Hamming'"):
        table.row("Hamming")


def test_what_is_no_shutter():
    """Anything else is refused by name, before anything is computed."""
    message = r"`compare\(shutters=...\)` must hold at least one shutter or design and nothing else"
    with pytest.raises(ValueError, match=message):
        compare(OUTLIER, SLOW, {"a": HannShutter(), "b": StillCamera(half_exposure=1e-3)})


@pytest.mark.parametrize("name", taken_names())
def test_a_baseline_keeps_its_name(name):
    """Another shutter is refused by it, and the verdict never speaks of the wrong one."""
    with pytest.raises(ValueError, match=f"call no other shutter one of .*; got '{name}'"):
        compare(OUTLIER, SLOW, {name: TukeyShutter(0.3)})


@pytest.mark.slow
def test_a_baseline_may_be_given_by_name(table):
    """The same window under its own name is one row in each reading, and one of those judged."""
    for reading in (OWN_BEST_MOTION, SAME_MOTION):
        names = [row.name for row in table.rows if row.reading == reading]
        assert sorted(set(names)) == sorted(names)
        assert {"Hann", "Gaussian", "mine", *baselines()} <= set(names)
    judged = max(table.row(name).level for name in ("Hann", "Gaussian", "mine"))
    assert table.gain == judged - table.snapshot.level
