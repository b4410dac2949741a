"""Reports: notes that say of what they speak, and a folder that holds one run."""

import io
import json
import re
import shlex
import sys
from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from support.bursts import SEQUENCE, a_burst_design
from support.designs import LIMITS, MOTION, SCENE
from support.photographs import photograph
from support.rows import changed, sequence

from mishutter import (
    Comparison,
    Design,
    HannShutter,
    LinearMotion,
    Picture,
    RectShutter,
    Scene,
    StillCamera,
    Texture,
    TukeyShutter,
    evaluate,
)

# Tables of the terminal, whose folder's face is `main` alone; a command would search for minutes.
from mishutter.cli import app
from mishutter.cli.tables import print_comparison, print_photographs
from mishutter.design.design import given_design
from mishutter.evaluation.speed_knowledge import SPEED_KNOWLEDGE
from mishutter.model.exposures import Exposures
from mishutter.pictures.images import write_picture

# The names of the files alone: to write the pictures takes seconds.
from mishutter.report.documents import (
    Report,
    _drawings,
    _writers,
    write_report,
)
from mishutter.report.restored import Photographs, photograph_of, photographs, shown_speeds
from mishutter.search.rivals import BEST_CODED_STILL, BEST_STILL_BURST, BEST_TUKEY
from mishutter.search.rows import (
    BEST_PANNED_SNAPSHOT,
    BEST_SNAPSHOT,
    FRAMES,
    OWN_BEST_MOTION,
    SAME_MOTION,
    STAGE,
    Row,
)

DESIGNS = {
    "rect": (MOTION, RectShutter()),
    "Hann": (MOTION, HannShutter()),
    BEST_TUKEY: (MOTION, TukeyShutter(0.3)),
    BEST_SNAPSHOT: (StillCamera(half_exposure=1.3e-3), RectShutter()),
}
PANNED = LinearMotion(half_exposure=17.5e-3, velocity=-12345.0)


@pytest.fixture(scope="module")
def report():
    rows = [
        Row(reading, name, Exposures.of_one(motion, shutter), 0.3, evaluate(SCENE, motion, shutter))
        for reading in (OWN_BEST_MOTION, SAME_MOTION)
        for name, (motion, shutter) in DESIGNS.items()
    ]
    return Report(SCENE, Comparison(tuple(rows), "A verdict.", 0.1, 31.0), ())


@pytest.mark.slow
def test_a_condition_says_of_which_row_it_is(report, capsys):
    """Where phases differ, the few rows that have another are named."""
    print_comparison(report, verbose=True)
    lines = capsys.readouterr().out.splitlines()
    (note,) = (line for line in lines if line.startswith("Condition at"))
    assert note.count("phase") == 2
    assert f", of {BEST_SNAPSHOT} at phase " in note


def test_numbers_stand_under_their_columns(report, capsys, monkeypatch):
    """The gain is over the snapshot's row, and the exposure is the whole of it."""
    monkeypatch.setenv("COLUMNS", "100")
    print_comparison(report, verbose=True)
    lines = [re.split(r"\s{2,}", line.strip()) for line in capsys.readouterr().out.splitlines()]
    names = [cells for cells in lines if cells[0] == "shutter"]
    numbers = [cells for cells in lines if cells[0] == "Hann"]
    best, same, kernels = (dict(zip(*t, strict=True)) for t in zip(names, numbers, strict=True))
    bought = next(cells for cells in lines if cells[0] == "both: best Tukey")
    m = report.comparison.row("Hann").metrics
    snapshot = report.comparison.row(BEST_SNAPSHOT).metrics
    assert best == {
        "shutter": "Hann",
        "PSNR dB": f"{m.expected_psnr:.2f}",
        "gain dB": f"{m.expected_psnr - snapshot.expected_psnr:+.2f}",
        "worst speed": f"{m.worst_speed_psnr:.2f}",
        "light": "0.500",
        "stroke px": "22.0",
        "pan px/s": "0",
        "open ms": "20.00",
    }
    assert same == best
    tukey = report.comparison.row(BEST_TUKEY).metrics
    gain = tukey.expected_psnr - snapshot.expected_psnr
    levels = [f"{tukey.expected_psnr:.2f}", f"{gain:+.2f}", f"{tukey.worst_speed_psnr:.2f}"]
    assert bought[1:] == [*levels, "22.0", "0", "20.00"]
    assert kernels == {
        "shutter": "Hann",
        "condition": f"{m.condition_number:.2f}",
        "kernel diff": f"{m.kernel_difference:.4f}",
        "relative": f"{m.relative_kernel_difference:.3f}",
        "bound": f"{m.bound_share:.3f}",
    }


class Terminal(io.StringIO):
    """Standard output of someone who watches."""

    def isatty(self):
        return True


def test_tables_fit_eighty_columns(report, monkeypatch):
    """None goes on below another, and each column is explained on a line of its own."""
    rows = report.comparison.rows
    others = [
        changed(rows[0], name=BEST_PANNED_SNAPSHOT, motion=PANNED),
        replace(rows[0], name=BEST_STILL_BURST, exposures=sequence(PANNED, 8)),
        changed(rows[1], name=BEST_CODED_STILL, motion=PANNED),
    ]
    table = replace(report.comparison, rows=(*rows[:4], *others, *rows[4:]))
    terminal = Terminal()
    monkeypatch.setattr(sys, "stdout", terminal)
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("TERM", "dumb")
    print_comparison(replace(report, comparison=table), verbose=True)
    lines = [line.strip() for line in terminal.getvalue().splitlines()]
    tables = [line for line in lines if not line.startswith("Condition")]
    assert max(map(len, tables)) <= 80
    own_best, purchases, same, kernels = (
        lines.index(title)
        for title in (
            "Own best motion",
            "Gain of each purchase over buying nothing",
            "Same motion",
            "Kernels, same motion",
        )
    )
    assert own_best < purchases < same < kernels
    for titles in (range(own_best, purchases), range(purchases, same), range(same, kernels)):
        assert sum(lines[index].startswith("───") for index in titles) == 1
    columns = ["PSNR dB", "gain dB", "worst speed", "light"]
    columns += ["stroke px", "pan px/s", "open ms", "bursts", "ceiling"]
    first_words = [line.split("  ")[0] for line in lines[own_best:purchases]]
    after = len(first_words) - first_words[::-1].index("ceiling")
    assert first_words[after - len(columns) : after] == columns


def test_what_a_photograph_showed(report):
    """Measured and expected stand apart, with gamma and in linear light."""
    shown = replace(report, photographs=Photographs({"ensemble": {"rect": photograph(21)}}, {}))
    found = shown.to_dict()["photographs"]["ensemble"]["rect"]
    assert found["mean_linear_psnr_db"] == 21
    assert found["expected_of_ensemble_filter_db"] == pytest.approx(21.2)
    np.testing.assert_allclose(found["psnr_db"], [21.3, 22.1, 21.7])
    np.testing.assert_allclose(found["linear_psnr_db"], [23.3, 24.1, 23.7])


def _rivals(report, levels, velocity=0.0):
    """The report's comparison with other levels, and a panned snapshot."""
    pan = LinearMotion(half_exposure=1.3e-3, velocity=velocity)
    rows = [
        *(row for row in report.comparison.rows if row.reading == OWN_BEST_MOTION),
        changed(report.comparison.row(BEST_SNAPSHOT), name=BEST_PANNED_SNAPSHOT, motion=pan),
        replace(report.comparison.row("Hann"), name="optimised"),
        replace(report.comparison.row("Hann"), name="Gaussian"),
        replace(
            report.comparison.row("rect"),
            name=BEST_STILL_BURST,
            exposures=sequence(report.comparison.row("rect").motion, 3),
            hardware=frozenset({STAGE, FRAMES}),
        ),
    ]
    psnr = {row.name: jnp.asarray(levels.get(row.name, 20.0)) for row in rows}
    metrics = {row.name: replace(row.metrics, expected_psnr=psnr[row.name]) for row in rows}
    measured = tuple(replace(row, metrics=metrics[row.name]) for row in rows)
    return Comparison(measured, "A verdict.", 0.1, 31.0)


PICTURED = {
    "frames": (BEST_STILL_BURST, False, [BEST_STILL_BURST, BEST_SNAPSHOT]),
    "a snapshot": (BEST_SNAPSHOT, False, [BEST_SNAPSHOT]),
    "a design": ("optimised", False, ["optimised", BEST_SNAPSHOT, BEST_TUKEY]),
    "a rival": ("Gaussian", False, ["Gaussian", BEST_SNAPSHOT, "optimised", BEST_TUKEY]),
    "all for who asks": (
        BEST_STILL_BURST,
        True,
        [BEST_STILL_BURST, BEST_SNAPSHOT, "optimised", BEST_TUKEY],
    ),
}


@pytest.mark.parametrize("slug", PICTURED)
def test_rows_that_are_pictured(report, slug):
    """What is recommended beside the snapshot at rest; designs where one of them is."""
    name, every, pictured = PICTURED[slug]
    comparison = _rivals(report, {BEST_TUKEY: 26.0, BEST_PANNED_SNAPSHOT: 27.0}, 400.0)
    comparison = replace(comparison, choice=comparison.row(name))
    assert list(Report(SCENE, comparison, ("optimised",), every=every).rows) == pictured


def test_pictures_are_of_what_is_recommended(report):
    """Profiles and kernels of designs are drawn where one of them is; the answer always is."""
    comparison = _rivals(report, {})
    of_designs = {"profile.png", "kernels.png", "transfer.png"}
    for name, is_drawn in (("optimised", True), (BEST_STILL_BURST, False), (BEST_SNAPSHOT, False)):
        judged = replace(comparison, choice=comparison.row(name))
        drawn = {*_drawings(Report(SCENE, judged, ("optimised",)))}
        assert drawn == {"answer.png"} | (of_designs if is_drawn else set())
        assert {*_drawings(Report(SCENE, judged, (), every=True))} == {"answer.png"} | of_designs


def test_a_camera_is_pictured_once_by_all_of_its_names(report, capsys):
    """In every picture and in the table of the photograph; a document keeps each name."""
    rows = {row.name: row for row in report.comparison.rows if row.reading == OWN_BEST_MOTION}
    mine = replace(rows[BEST_TUKEY], name="mine")
    level = replace(rows["Hann"].metrics, expected_psnr=mine.metrics.expected_psnr - 1)
    others = [replace(rows["Hann"], metrics=level), rows[BEST_SNAPSHOT]]
    comparison = Comparison((mine, rows[BEST_TUKEY], *others), "A verdict.", 0.1, 31.0)
    comparison = replace(comparison, choice=mine)
    names = [*Report(SCENE, comparison, ("mine",)).rows]
    assert names == ["mine", BEST_SNAPSHOT, BEST_TUKEY]
    seen = {name: photograph(21 + index) for index, name in enumerate(names)}
    shown = Report(SCENE, comparison, ("mine",), Photographs({"ensemble": seen}, seen))
    levels = shown.photograph_levels
    assert [*levels["ensemble"]] == [f"mine = {BEST_TUKEY}", BEST_SNAPSHOT]
    assert levels["ensemble"][BEST_SNAPSHOT] is seen[BEST_SNAPSHOT]
    print_photographs(levels)
    lines = [re.split(r"\s{2,}", line.strip()) for line in capsys.readouterr().out.splitlines()]
    assert [cells[0] for cells in lines if cells[0] in levels["ensemble"]] == [*levels["ensemble"]]
    legend = _drawings(shown)["profile.png"]().legends[0]
    words = [text.get_text().split(", passes")[0] for text in legend.get_texts()]
    assert words == [*levels["ensemble"]]
    assert [*shown.to_dict()["photographs"]["ensemble"]] == names


@pytest.mark.slow
def test_the_verdict_is_printed_before_anything_is_photographed(report, capsys, monkeypatch):
    """What is known is on standard output when the first capture begins; a document is whole."""
    seen: list[str] = []

    def photographed(delivery, result):
        seen.append(capsys.readouterr().out)
        return result

    # Only what is printed before it matters, and both take long.
    monkeypatch.setattr(app.Delivery, "photographed", photographed)
    spoken = app.Delivery(None, as_json=False, num_seeds=1, every_photograph=False, verbose=True)
    app._deliver(report, spoken, None)
    app._deliver(report, spoken._replace(as_json=True), None)
    assert seen[0].startswith("A verdict.\n")
    assert "Same motion" in seen[0]
    assert seen[1] == ""
    assert json.loads(capsys.readouterr().out)["files"] == []


def test_an_answer_ends_with_a_command_that_goes_on(report, tmp_path):
    """The file of what is recommended, once there is a folder; before that the folder."""
    design = given_design(SCENE, MOTION, HannShutter(), "")
    rows = {row.name: row for row in report.comparison.rows}
    for name, file in (("Hann", "recommended.json"), (None, "one_exposure.json")):
        row = None if name is None else replace(rows[name], design=design)
        judged = replace(
            report,
            comparison=replace(report.comparison, choice=row),
            names=("Hann",),
            design=design,
        )
        folder = tmp_path / "a folder"
        command = shlex.split(app.next_step(None, folder, judged.file_to_build), comments=True)
        assert command[:3] == ["mishutter", "export", str(folder / file)]
        assert command[3:] == ["--out", str(folder / "lab")]
    again, writes = app.next_step(None, None, judged.file_to_build).split("  # ")
    assert (again, writes) == (
        "mishutter optimise --out design",
        "the design, pictures and a report",
    )
    own = app.next_step(Path("my own/belt.toml"), None, judged.file_to_build).split("  # ")[0]
    assert own == "mishutter optimise 'my own/belt.toml' --out belt"


@pytest.mark.slow
def test_no_pictures_of_an_earlier_run_are_left(report, tmp_path):
    """Those of a photograph go where this run has none; what is somebody else's stays."""
    kept, stale = {"design.json", "notes.txt"}, {"psnr.png", "photograph.png"}  # of no search
    for name in kept | stale:
        (tmp_path / name).write_text("from before")
    told: list[str] = []
    written = write_report(report, tmp_path, wrote=told.append)
    assert told == written
    assert {path.name for path in tmp_path.iterdir()} == kept | set(written)
    assert not stale & set(written)


def test_the_recommendation_is_one_file_beside_the_one_exposure(report, tmp_path):
    """Whatever it is: the design of the search, or that of a rival."""
    design, rival = (given_design(SCENE, MOTION, s, "") for s in (HannShutter(), RectShutter()))
    rows = {row.name: row for row in report.comparison.rows}
    for name, shutter in (("Hann", HannShutter), ("rect", RectShutter)):
        comparison = replace(report.comparison, choice=replace(rows[name], design=rival))
        given = replace(report, comparison=comparison, names=("Hann",), design=design)
        writers = _writers(given)
        saved = [file for file in writers if file.endswith(".json")]
        assert saved == ["recommended.json", "one_exposure.json", "report.json"]
        for file, kind in (("recommended.json", shutter), ("one_exposure.json", HannShutter)):
            writers[file](tmp_path / file)
            assert isinstance(Design.load(tmp_path / file).shutter, kind)


def test_the_frames_that_a_verdict_names_are_saved(report, tmp_path):
    """Whether the search has found them or not; the one exposure has none."""
    rows = {row.name: row for row in report.comparison.rows}
    parts = frozenset({STAGE, FRAMES})
    burst = replace(rows["rect"], name="best moving burst", exposures=SEQUENCE, hardware=parts)
    comparison = replace(report.comparison, choice=burst)
    for design in (a_burst_design(None), a_burst_design()):
        judged = replace(report, comparison=comparison, design=design)
        assert "one_exposure.json" not in _writers(judged)  # none was searched for
        writers = _writers(replace(judged, names=("optimised",)))
        file = tmp_path / "saved.json"
        writers["recommended.json"](file)
        assert Design.load(file).sequence.text == SEQUENCE.text
        writers["one_exposure.json"](file)
        assert Design.load(file).sequence is None


def test_a_recommended_exposure_takes_no_frames(report):
    """Where the search found frames that the answer does not take, for 0.2 dB, say."""
    row = report.comparison.row("Hann")
    comparison = replace(report.comparison, choice=row)
    judged = replace(report, comparison=comparison, names=("Hann",), design=a_burst_design())
    assert judged.recommended.sequence is None


def test_a_narrow_photograph_is_left_out_with_a_note(report, tmp_path):
    """What was computed is not lost to it: one line names the file and how wide it should be."""
    path = tmp_path / "narrow.png"
    write_picture(path, np.random.default_rng(3).uniform(0.2, 0.8, (9, 41)))
    scene = Scene(
        [0.0, 310.0],
        photon_rate=1e5,
        read_noise=4.0,
        limits=LIMITS,
        picture=Texture(path=str(path)),
    )
    rows = {row.name: row for row in report.comparison.rows}
    notes: list[str] = []
    assert photograph_of(scene, rows, note=notes.append) is None
    (line,) = notes
    assert line.startswith(f"{path}: 41 columns are too few")


def test_a_result_at_one_speed_and_one_without_pictures():
    """The levels stay what they were; pictures go with the speeds, or all of them."""
    whole = photograph(21)
    fastest, levels = whole.at(2), whole.without_pictures()
    assert (fastest.speeds, fastest.psnr) == (whole.speeds[2], whole.psnr[2])
    assert np.array_equal(fastest.captured[0], whole.captured[2])
    assert np.array_equal(fastest.restored[0], whole.restored[2])
    assert levels.captured.shape == levels.restored.shape == (0, *whole.captured.shape[1:])
    for name in ("speeds", "psnr", "linear_psnr", "standard_error", "mean_psnr"):
        assert np.array_equal(getattr(levels, name), getattr(whole, name))


@pytest.mark.parametrize(
    ("speeds", "weights", "shown"),
    [
        ([-900.0, 0.0, 300.0, 900.0], None, [0.0, 300.0, 900.0]),
        ([-900.0, -300.0, 0.0, 300.0, 900.0], None, [0.0, 300.0, 900.0]),
        ([-2550.0, -1500.0, -450.0], None, [-450.0, -1500.0, -2550.0]),
        ([-700.0, 200.0], None, [200.0, -700.0]),
        ([410.0], None, [410.0]),
        ([0.0, 300.0, 900.0, 4000.0], [0.1, 0.2, 0.695, 0.005], [0.0, 900.0, 4000.0]),
        ([0.0, 300.0, 4000.0], [0.9, 0.05, 0.05], [0.0, 4000.0]),
        ([-300.0, 0.0, 300.0, 900.0], [0.3, 0.4, 0.3, 0.0], [0.0, 300.0]),
    ],
)
def test_speeds_that_are_shown(speeds, weights, shown):
    """Of those that occur the slowest, the one that half of all do not exceed, and the fastest."""
    scene = Scene(speeds, weights, photon_rate=1e5, read_noise=4.0)
    assert shown_speeds(scene) == shown


@pytest.mark.parametrize("every", [False, True])
def test_a_photograph_at_some_speeds_or_all(report, capsys, every):
    """By one filter at each of three speeds, or by three decoders over all that may occur."""
    scene = Scene([-310.0, -90.0, 0.0, 310.0], photon_rate=1e6, read_noise=3.0, limits=LIMITS)
    picture = Picture(np.random.default_rng(5).uniform(0.2, 0.8, (7, 400, 1)))
    rows = {"Hann": report.comparison.row("Hann")}
    found = photographs(picture, scene, rows, 1, every=every, begin=lambda name: None)
    speeds = [-310.0, -90.0, 0.0, 310.0] if every else [0.0, -90.0, 310.0]
    assert list(found.levels) == ["ensemble", "Wiener", "Richardson-Lucy"][: 3 if every else 1]
    for level in found.levels.values():
        assert level["Hann"].speeds.tolist() == speeds
    shown = found.shown["Hann"]
    assert shown.speeds.tolist() == [-90.0, 310.0]
    assert shown.captured.shape == shown.restored.shape == (2, *shown.reference.shape)
    places = [speeds.index(speed) for speed in shown.speeds]
    np.testing.assert_array_equal(shown.psnr, found.levels["ensemble"]["Hann"].psnr[places])
    print_photographs(found.levels)
    lines = [re.split(r"\s{2,}", line.strip()) for line in capsys.readouterr().out.splitlines()]
    (title,) = (i for i, cells in enumerate(lines) if cells[0].startswith("Photograph, restored"))
    names = next(cells for cells in lines[title:] if cells[0] == "shutter")
    numbers = next(cells for cells in lines[title:] if cells[0] == "Hann")
    level = found.levels["ensemble"]["Hann"]
    figure = level.mean_psnr if every else level.linear_psnr[0]
    assert dict(zip(names, numbers, strict=True))["ensemble" if every else "0 px/s"] == (
        f"{figure:.2f}"
    )


def test_a_photograph_is_restored_by_the_decoder_of_the_verdict(report, capsys):
    """Of rows that are judged as knowing the speed, each capture has the filter for its speed."""
    scene = Scene([-310.0, 0.0, 310.0], photon_rate=1e6, read_noise=3.0, limits=LIMITS)
    picture = Picture(np.random.default_rng(5).uniform(0.2, 0.8, (7, 400, 1)))
    row = report.comparison.row("Hann")
    levels = {}
    for knows in ("unknown", "known"):
        rows = {"Hann": replace(row, decoder=SPEED_KNOWLEDGE[knows])}
        found = photographs(picture, scene, rows, 1, begin=lambda name: None)
        levels[knows] = found.levels["ensemble"]["Hann"]
        print_photographs(found.levels, knows)
    known, unknown = levels["known"], levels["unknown"]
    assert known.expected_psnr > unknown.expected_psnr
    assert np.all(known.linear_psnr != unknown.linear_psnr)
    np.testing.assert_allclose(known.linear_psnr, known.own_expected_psnr, atol=0.3)
    assert " ".join(capsys.readouterr().out.split()).count("filter, speed known") == 1
