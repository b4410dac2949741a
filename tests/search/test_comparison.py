"""A design beside its baselines: two readings, one verdict, and names that stay apart."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from support.designs import MOTION, OUTLIER, SCENE, SLOW
from support.helpers import ROUNDING

from mishutter import (
    DesignLoss,
    ExpectedErrorLoss,
    GaussianShutter,
    HannShutter,
    KnownSpeedLoss,
    Limits,
    LinearMotion,
    ParabolicMotion,
    RectShutter,
    Scene,
    StillCamera,
    TukeyShutter,
    WorstSpeedLoss,
    ceiling,
    compare,
    evaluate,
    optimise,
)
from mishutter.search.comparison import (
    BEST_BURST,
    BEST_CODED_STILL,
    BEST_PANNED_SNAPSHOT,
    BEST_SNAPSHOT,
    CODED_AT_REST,
    OWN_BEST_MOTION,
    SAME_MOTION,
    SHAPED_ON_FREE_PATH,
    Row,
    _is_finished,
    _snapshots,
    _with_verdict,
    taken_names,
)

ROUNDING_DB = 1e-9


TOLD = Scene.uniform(
    max_speed=2000.0,
    num_speeds=5,
    photon_rate=1e5,
    read_noise=10.0,
    limits=SCENE.limits,
    decoder_speed="told",
)
"""The small scene, for a decoder that is told the speed."""


@pytest.fixture(scope="module")
def table():
    return compare(OUTLIER, SLOW, {"mine": HannShutter()})


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
    """A scene without detail: no decibels of infinity, and no gain."""
    grey = eqx.tree_at(lambda scene: scene.deviation, OUTLIER, jnp.zeros_like(OUTLIER.deviation))
    table = compare(grey, SLOW, {"mine": TukeyShutter(0.3)})
    assert "there is nothing to restore" in table.verdict
    assert table.gain == 0


STILL = StillCamera(half_exposure=1.3e-3)
PANNED = LinearMotion(half_exposure=2e-3, velocity=-1500.0)
MOVING = ParabolicMotion(acceleration=21.875 / 1e-4, half_exposure=1e-2, velocity=-12345.0)
OF_THEIR_KIND = {
    BEST_SNAPSHOT: (STILL, RectShutter()),
    BEST_PANNED_SNAPSHOT: (PANNED, RectShutter()),
    BEST_CODED_STILL: (PANNED, HannShutter()),
    CODED_AT_REST: (STILL, HannShutter()),
    "rect": (MOVING, RectShutter()),
}


def made_up(levels):
    """Rows of given expected PSNR, on the motions of their kind, others on one that moves."""
    metrics = evaluate(SCENE, MOTION, HannShutter())
    return [
        Row(
            OWN_BEST_MOTION,
            name,
            shutter,
            motion,
            0.25,
            replace(metrics, expected_psnr=jnp.asarray(level)),
        )
        for name, level in levels.items()
        for motion, shutter in [OF_THEIR_KIND.get(name, (MOTION, HannShutter()))]
    ]


def verdict(levels, *given):
    return _with_verdict(made_up(levels), dict.fromkeys(given, RectShutter()), SCENE)


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
    at_rest, panned = _snapshots(scene, ExpectedErrorLoss(), None)
    assert float(panned.motion.velocity) == pytest.approx(3000, abs=400)
    assert panned.level > at_rest.level + 0.2


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
        f"({most}).\nb takes as much and has 23.25 dB.\n"
        "The nearest simpler camera, best snapshot, is 0.13 dB below it.",
        21.0: "Build b: 23.25 dB, 2.25 dB above the best snapshot.\nIt is "
        f"{float(most[:-3]) - 23.25:.2f} dB below what any path and any shutter could reach "
        f"({most}).\nHann has 23.30 dB: 0.05 more.\n"
        "The nearest simpler camera, best snapshot, is 2.25 dB below it.",
    }
    for still, text in verdicts.items():
        found = verdict(levels | {BEST_SNAPSHOT: still}, "a", "b")
        assert found.gain == 23.25 - still
        assert found.verdict == text
    found = verdict(levels | {BEST_SNAPSHOT: 21.0, "rect": 23.2}, "a", "b")
    assert found.verdict == (
        "Do not build b for this scene: rect has 23.20 dB.\n"
        f"It takes a stage: 20 ms, pan -12345 px/s, stroke 21.9 px. Ceiling: {most}.\n"
        "Hann has 23.30 dB with a shutter too: 0.10 more.\n"
        "The nearest simpler camera, best snapshot, is 2.20 dB below it."
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
    found = verdict({given: 21.2} | levels, given)
    lines = found.verdict.splitlines()
    assert 2 <= len(lines) <= 4
    assert max(map(len, lines)) <= 80
    assert f"{found.ceiling:.2f} dB" in lines[1]


def test_a_camera_that_does_not_pay_is_not_advised():
    """Where nothing beats a snapshot by 0.1 dB, the verdict names what to use instead."""
    levels = {"a": 24.09, "Hann": 23.9, BEST_SNAPSHOT: 24.0}
    assert "ordinary shutter: 2.6 ms, at rest, 24.00 dB." in verdict(levels, "a").verdict
    found = verdict(levels | {BEST_PANNED_SNAPSHOT: 26.0}, "a")
    assert found.verdict.startswith("Do not build a coded camera for this scene")
    assert "Use an ordinary shutter: 4 ms, pan -1500 px/s, 26.00 dB." in found.verdict
    assert found.gain == pytest.approx(-1.91)


def test_what_each_purchase_brings():
    """The best of nothing, a stage, a shutter and both, given or not; a burst is none of them."""
    levels = {"a": 23.0, "Hann": 24.5, "rect": 22.25, BEST_SNAPSHOT: 21.5}
    levels |= {BEST_PANNED_SNAPSHOT: 21.75, CODED_AT_REST: 21.625, BEST_BURST: 29.0}
    found = verdict(levels, "a")
    names = {takes: row.name for takes, row in found.rivals.items()}
    assert names == {
        "nothing": BEST_SNAPSHOT,
        "a stage": "rect",
        "a shutter": CODED_AT_REST,
        "both": "Hann",
    }
    document = found.to_dict()["rivals"]
    assert {takes: each["name"] for takes, each in document.items()} == names
    assert document["both"]["expected_psnr_db"] == 24.5
    assert document["both"]["over_snapshot_db"] == 2.75
    assert document["a stage"]["motion"]["velocity"] == -12345.0
    _, table = found.text().split("what each purchase brings\n")
    lines = [" ".join(line.split()) for line in table.splitlines()]
    assert lines[:4] == [
        "nothing best snapshot 21.50 dB, -0.25 dB, 2.6 ms, at rest",
        "a stage rect 22.25 dB, +0.50 dB, 20 ms, pan -12345 px/s, stroke 21.9 px",
        "a shutter best coded at rest 21.62 dB, -0.12 dB, 2.6 ms, at rest",
        "both Hann 24.50 dB, +2.75 dB, 20 ms, stroke 22 px",
    ]
    better = verdict(levels | {"a": 25.0}, "a")
    assert better.rivals["both"].name == "a"


def test_more_never_brings_less():
    """Whoever has bought both may leave the shutter open, and one with a stage keep it at rest."""
    levels = {"a": 23.0, "Hann": 22.0, "rect": 23.5, CODED_AT_REST: 22.5, BEST_SNAPSHOT: 23.25}
    found = verdict(levels, "a")
    brings = {takes: row.level for takes, row in found.rivals.items()}
    assert brings == {"nothing": 23.25, "a stage": 23.5, "a shutter": 23.25, "both": 23.5}
    assert found.rivals["both"].name == "rect"


def test_a_free_path_is_advised_where_the_design_does_not_pay():
    """One that pays stays, and what the path would bring is told beside it."""
    levels = {"a": 24.0, SHAPED_ON_FREE_PATH: 24.75, BEST_SNAPSHOT: 23.5}
    pays = verdict(levels, "a").verdict.splitlines()
    assert pays[0] == "Build a: 24.00 dB, 0.50 dB above the best snapshot."
    assert pays[2] == "Shaped on a free path has 24.75 dB: 0.75 more."
    found = verdict(levels | {BEST_SNAPSHOT: 23.95}, "a").verdict.splitlines()
    assert found[0] == "Build shaped on a free path: 24.75 dB, 0.80 dB above the best snapshot."
    assert found[2] == "a takes as much and has 24.00 dB."


@pytest.mark.slow
def test_a_scene_names_the_decoder_that_all_are_judged_by():
    """Design, rivals, gain and ceiling are of it, as by the loss of that decoder."""
    design = optimise(TOLD, num_starts=6)
    same = optimise(SCENE, loss=KnownSpeedLoss(), num_starts=6)
    assert float(design.loss) == float(same.loss)
    found = compare(TOLD, design)
    assert {row.speed for row in found.rows} == {"told"}
    levels = [float(row.metrics.known_speed_psnr) for row in found.rows]
    assert [row.level for row in found.rows] == levels
    assert max(levels) <= found.ceiling
    of_loss = compare(SCENE, same, loss=KnownSpeedLoss())
    assert found.text() == of_loss.text()


def test_a_decoder_that_finds_the_speed_needs_no_shutter_where_an_open_one_is_as_good():
    """The verdict says so of a row that takes a stage alone, and not of one with a shutter too."""
    words = "A stage and a decoder that finds the speed: no shutter is needed."
    for level, speed, is_said in ((23.0, "found", 1), (23.0, "unknown", 0), (25.0, "found", 0)):
        rows = [
            replace(row, speed=speed, metrics=replace(row.metrics, known_speed_psnr=known))
            for row in made_up({"rect": 24.0, "Hann": level, BEST_SNAPSHOT: 22.0})
            for known in [row.metrics.expected_psnr]
        ]
        assert (words in _with_verdict(rows, {}, SCENE).verdict) == bool(is_said)


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
    found = _with_verdict(rows, {"a": HannShutter()}, SCENE)
    line = "Build a: 23.00 dB at the worst speed, 2.00 dB above the best snapshot."
    assert found.verdict.splitlines()[0] == line
    assert found.gain == 2.0


@pytest.mark.slow
def test_a_search_for_the_worst_speed_is_better_there_and_worse_in_the_mean():
    """Than one for the mean; a comparison judges every row by it, below the ceiling."""
    loss = WorstSpeedLoss()
    for_worst, for_mean = (optimise(SCENE, loss=x, num_starts=6) for x in (loss, None))
    worst, mean = (for_worst.metrics, for_mean.metrics)
    assert float(worst.worst_speed_psnr) > float(mean.worst_speed_psnr)
    assert float(worst.expected_psnr) < float(mean.expected_psnr)
    found = compare(SCENE, for_worst, loss=loss)
    levels = [float(row.metrics.worst_speed_psnr) for row in found.rows]
    assert [row.level for row in found.rows] == levels
    assert max(levels) <= found.ceiling
    assert found.row("optimised").level >= max(row.level for row in found.rows[:3]) - 1e-3


def test_gains_are_over_the_best_snapshot_that_is_allowed():
    """One that pans, where that is better: in the verdict, the table and the document alike."""
    levels = {"a": 24.0, BEST_SNAPSHOT: 21.0, BEST_PANNED_SNAPSHOT: 23.0}
    found = verdict(levels, "a")
    assert found.verdict.startswith("Build a: 24.00 dB, 1.00 dB above the best panned snapshot.")
    assert found.gain == found.over_snapshot(24.0) == found.to_dict()["gain_db"] == 1.0
    assert found.over_snapshot(21.0) == -2.0


@pytest.mark.slow
def test_no_row_exceeds_the_ceiling(table):
    """At its own best motion or at the same."""
    assert all(float(row.metrics.expected_psnr) <= table.ceiling for row in table.rows)


@pytest.mark.slow
def test_a_scene_of_one_speed_is_panned():
    """An open shutter on a camera that keeps up with it is as good as anything."""
    turned = Limits(
        max_top_speed=2e4, min_half_exposure=5e-4, max_half_exposure=0.03, pans="camera"
    )
    scene = Scene([1500.0], photon_rate=1e5, read_noise=4.0, limits=turned)
    table = compare(scene, MOTION, {"mine": HannShutter()})
    snapshot = table.row(BEST_PANNED_SNAPSHOT)
    assert float(snapshot.motion.velocity) == pytest.approx(1500.0, abs=1.0)
    assert table.verdict.startswith("Do not build a coded camera")
    assert table.gain < 0.1


def test_the_table_as_text():
    """Each number stands under its name, in the units that are named."""
    found = verdict({"a": 21.5, BEST_SNAPSHOT: 24.0}, "a")
    table = found.text().removeprefix(found.verdict).strip()
    reading, header, line, *_ = table.splitlines()
    m = found.row("a").metrics
    numbers = (m.condition_number, m.kernel_difference, m.relative_kernel_difference)
    shares = (m.efficiency, m.bound_share)
    assert reading == OWN_BEST_MOTION
    names = "PSNR dB worst speed cond. diff. rel. light bound stroke px pan px/s exposure ms loss"
    assert header.split() == ["shutter", *names.split()]
    cells = [float(cell) for cell in line.split()[1:]]
    np.testing.assert_allclose(
        cells, [21.5, m.worst_speed_psnr, *numbers, *shares, 22, 0, 20, 0.25], atol=6e-3
    )


def test_a_comparison_prints_its_table():
    """And shows its verdict alone, or a row's level, within something larger."""
    found = verdict({"a": 21.5, BEST_SNAPSHOT: 24.0}, "a")
    assert str(found) == found.text()
    assert repr(found) == f"Comparison(2 rows: {found.verdict.splitlines()[0]})"
    assert repr(found.row("a")).startswith("Row('own best motion', 'a', 21.50 dB, 20 ms, stroke")


@pytest.mark.slow
def test_designs_keep_or_start_from_their_own_motions():
    """What this loss found for this scene stays as it is; another design is tuned."""
    loss = ExpectedErrorLoss()
    found = optimise(OUTLIER, SLOW, HannShutter(), loss=loss, free="acceleration")
    elsewhere = OUTLIER.bare(weights=np.array([0.2, 0.3, 0.4, 0.1]))
    other = optimise(elsewhere, MOTION, HannShutter(), loss=loss, free="half_exposure")
    table = compare(OUTLIER, MOTION, {"found": found, "other": other}, loss=loss)
    kept, tuned = table.row("found"), table.row("other")
    assert _is_finished(found, OUTLIER, loss)
    assert not _is_finished(found, OUTLIER, DesignLoss())
    assert kept.motion is found.motion
    assert (kept.loss, kept.metrics) == (found.loss, found.metrics)
    assert tuned.motion is not other.motion
    assert tuned.loss <= float(loss(OUTLIER, other.motion, other.shutter)) * (1 + ROUNDING)
    assert table.row("other", SAME_MOTION).motion is MOTION


@pytest.mark.slow
def test_shutters_without_names(table):
    """A list is compared as a mapping is, under numbers."""
    found = compare(OUTLIER, SLOW, [HannShutter()])
    assert found.row("shutter 0").metrics == table.row("mine").metrics
    assert "shutter 0" in found.text()


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
    """The same window under its own name is one row, and one of those judged."""
    given = compare(OUTLIER, SLOW, {"Hann": HannShutter(), "Gaussian": GaussianShutter()})
    assert sorted(row.name for row in given.rows) == sorted(
        row.name for row in table.rows if row.name != "mine"
    )


@pytest.mark.slow
def test_a_design_brings_its_motion():
    """`compare(scene, design)` is the table of the design on its own motion, as "optimised"."""
    design = optimise(OUTLIER, SLOW, TukeyShutter(0.4), free="acceleration")
    short = compare(OUTLIER, design)
    spelled = compare(OUTLIER, design.motion, {"optimised": design})
    assert short.text() == spelled.text()
    assert short.row("optimised", "same motion").motion is design.motion
