"""Pictures say what they show: labelled axes with units, lines that survive a grey printout."""

import json
import os
from functools import cache
from itertools import pairwise

import equinox as eqx
import numpy as np
import pytest
import xarray
from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL import Image
from support.bursts import a_burst_design
from support.drive import a_design
from support.photographs import photograph
from support.sweeps import SCENE, grid

from mishutter import (
    ChippedShutter,
    Comparison,
    FirstOrderDevice,
    HannShutter,
    Limits,
    ParabolicMotion,
    Picture,
    RectShutter,
    Scene,
    SplineShutter,
    StillCamera,
    drive_table,
    evaluate,
    gain_over,
    optimise,
    pareto_front,
    plot_design,
    sweep,
)
from mishutter.evaluation.speed_knowledge import SPEED_KNOWLEDGE
from mishutter.model.exposures import Exposures
from mishutter.report import sweep_plots

# The curve that a front draws for a profile; a line in pixels does not hold its values.
from mishutter.report.plots import (
    MAP_COLOURS,
    leave_room,
    new_figure,
    plot_capture,
    plot_drive,
    plot_kernels,
    plot_levels,
    plot_photograph,
    plot_profiles,
    plot_psnr,
    plot_transfer,
    save_figure,
)
from mishutter.report.sweep_plots import plot_front, plot_map
from mishutter.search.rows import Row

MOTION = ParabolicMotion(acceleration=2.3e5, half_exposure=0.0061)
DESIGNS = {
    "rect": (MOTION, RectShutter()),
    "Hann": (MOTION, HannShutter()),
    "snapshot": (StillCamera(half_exposure=0.0013), RectShutter()),
}


@cache
def swept():
    """The small sweep, and what it gains over Hann."""
    found = sweep(SCENE, **grid())
    return found.assign(gain=gain_over(found, "Hann"))


FRONT = ("condition_number", "expected_psnr")

FIGURES = {
    "profiles": lambda: plot_profiles(DESIGNS),
    "kernels": lambda: plot_kernels(DESIGNS, [0.0, 700.0]),
    "transfer": lambda: plot_transfer(SCENE, DESIGNS),
    "psnr": lambda: plot_psnr({"rect": photograph(21), "Hann": photograph(24)}),
    "design": lambda: plot_design(a_design(HannShutter())),
    "levels": lambda: plot_levels({"rect": 21.3, "Hann": 22.7, "own": 24.1}, 27.9, "own"),
    "drive": lambda: plot_drive(drive_table(a_design(HannShutter()), num_levels=5)),
    "map": lambda: plot_map(swept(), "gain"),
    "row": lambda: plot_map(swept().isel(acceleration=[2])),
    "column": lambda: plot_map(swept().isel(half_exposure=[2]), shutter="rect"),
    "front": lambda: plot_front(swept(), FRONT),
}


@pytest.fixture(scope="module")
def figures():
    return {name: make() for name, make in FIGURES.items()}


def test_no_solver_of_layouts_draws_a_figure():
    """Room for labels is told: a solver takes longer than all of the drawing."""
    figure = plot_profiles(DESIGNS)
    assert figure.get_layout_engine() is None


def test_a_design_draws_its_shutter_and_its_path():
    """Over its own exposure: the transmittance, the command of a device, and the sensor's place."""
    device = FirstOrderDevice(rise_time=7e-4, fall_time=1.3e-3)
    scene = Scene([-310.0, 420.0], photon_rate=2e5, read_noise=3.0, device=device)
    seen = scene.light(HannShutter(), MOTION)
    top, bottom = plot_design(a_design(seen, scene=scene, motion=MOTION)).axes
    (path,) = bottom.get_lines()
    time, place = path.get_data()
    np.testing.assert_allclose(time[[0, -1]], [-6.1, 6.1])
    np.testing.assert_allclose(place, MOTION.position(time * 1e-3), rtol=1e-6, atol=1e-9)
    passed, sent = (line.get_data()[1][1:-1] for line in top.get_lines())
    tau = np.linspace(-1, 1, passed.size)
    np.testing.assert_allclose(passed, seen.transmittance(tau), atol=1e-6)
    np.testing.assert_allclose(sent, HannShutter().transmittance(tau), atol=1e-6)


def test_a_design_of_a_burst_draws_its_frames():
    """The frames are what is to be taken, and the path is the stage's through them."""
    design = a_burst_design()
    (axes,) = plot_design(design).axes
    frames = [patch for patch in axes.patches if patch.get_alpha() is None]
    assert len(frames) == len(design.sequence.frames)
    assert axes.get_ylabel() == "stage position / px"


def test_a_comparison_draws_its_levels():
    """One mark for each camera at its own best motion, the advised one filled, and the ceiling."""
    of_row = {"exposures": Exposures.of_one(MOTION, HannShutter()), "loss": 0.2}
    metrics = evaluate(SCENE, MOTION, HannShutter())
    better = eqx.tree_at(lambda each: each.expected_psnr, metrics, metrics.expected_psnr + 1.3)
    best, other, same = (
        Row("own best motion", "own", metrics=better, **of_row),
        Row("own best motion", "hann", metrics=metrics, **of_row),
        Row("same motion", "rect", metrics=metrics, **of_row),
    )
    (axes,) = Comparison((best, other, same), "V.", 0.1, 31.0, choice=best).plot().axes
    *marks, most = axes.get_lines()
    assert [text.get_text() for text in axes.get_yticklabels()] == ["hann", "own"]
    levels = [float(mark.get_xdata()[0]) for mark in marks]
    np.testing.assert_allclose(levels, [other.level, best.level])
    assert [mark.get_markerfacecolor() == "white" for mark in marks] == [True, False]
    assert set(most.get_xdata()) == {31.0}


@pytest.mark.parametrize(("num_rows", "num_columns"), [(1, 1), (3, 2)])
def test_room_is_in_inches(num_rows, num_columns):
    """Between the edge, the panels and their neighbours, whatever the size of the figure."""
    figure = new_figure(7.5, 6.5)
    margins = {"left": 0.9, "right": 0.2, "bottom": 0.6, "top": 0.35, "columns": 0.7, "rows": 0.45}
    leave_room(figure, num_rows=num_rows, num_columns=num_columns, **margins)
    panels = figure.subplots(num_rows, num_columns, squeeze=False)
    boxes = np.array([[axes.get_position().extents for axes in row] for row in panels])
    x0, y0, x1, y1 = np.moveaxis(boxes * [7.5, 6.5, 7.5, 6.5], -1, 0)
    np.testing.assert_allclose([x0[:, 0], x1[:, -1]], [[0.9] * num_rows, [7.3] * num_rows])
    np.testing.assert_allclose([y0[-1], y1[0]], [[0.6] * num_columns, [6.15] * num_columns])
    np.testing.assert_allclose(x0[:, 1:] - x1[:, :-1], 0.7)
    np.testing.assert_allclose(y0[:-1] - y1[1:], 0.45)


@pytest.mark.slow
@pytest.mark.parametrize("name", FIGURES)
def test_axes_are_labelled(name, figures):
    """Every panel, or its neighbour, says what is up; the lowest what is across, with its unit."""
    panels = figures[name].axes
    numbered = [axes for axes in panels if axes.yaxis.get_tick_params().get("labelleft", True)]
    assert all(axes.get_ylabel() for axes in numbered)
    lowest = [axes for axes in panels if axes.get_label() != "<colorbar>"][-1]
    assert "/ " in lowest.get_xlabel()


NAMES = ["rect", "_design_" + 9 * "of_a_long_name_", "_own", "cost $5 to $\\frac", "run/03/design"]
NAMES += [f"tukey:{share}" for share in (0.1, 0.2, 0.3, 0.4)]
MANY = {
    "profiles": lambda: plot_profiles(dict.fromkeys(NAMES, DESIGNS["Hann"])),
    "transfer": lambda: plot_transfer(SCENE, dict.fromkeys(NAMES, DESIGNS["Hann"])),
    "psnr": lambda: plot_psnr({name: photograph(21 + i) for i, name in enumerate(NAMES)}),
}


@pytest.mark.parametrize("slug", MANY)
def test_designs_of_any_name_and_number(slug):
    """All stand in the legend, as they are called, beside no line's likeness or any line."""
    figure = MANY[slug]()
    FigureCanvasAgg(figure).draw()
    (legend,) = figure.legends
    texts = [text.get_text().strip().replace("\\$", "$") for text in legend.get_texts()]
    assert len(texts) == len(NAMES)
    for text, name in zip(texts, NAMES, strict=True):
        assert text.startswith(name[:15])
    box = legend.get_window_extent()
    assert figure.bbox.x0 <= box.x0 < box.x1 <= figure.bbox.x1
    for axes in figure.axes:
        assert axes.bbox.y1 < box.y0 < box.y1 <= figure.bbox.y1
        assert axes.bbox.width > 0.7 * figure.bbox.width
    lines = [line for line in figure.axes[0].get_lines() if line.get_linestyle() != "None"]
    # Matplotlib's public name for every dash pattern of one's own is "--".
    styles = {(line.get_color(), str(line._unscaled_dash_pattern)) for line in lines}
    assert len(styles) == len(NAMES)


@pytest.mark.parametrize("name", ["設計", os.fsdecode(b"na\xefve")])
def test_letters_that_the_font_lacks(name, tmp_path):
    """A name in them is drawn as boxes, one of bytes that are no text as those, without a word."""
    figure = plot_profiles({name: DESIGNS["Hann"]})
    save_figure(figure, tmp_path / "profile.png")
    assert (tmp_path / "profile.png").stat().st_size > 0


def test_speeds_of_one_value_are_told_apart_in_grey():
    """Points have a shape of their own, and one does not cover another."""
    other = photograph(21)._replace(linear_psnr=photograph(21).linear_psnr * 1.01)
    axes = plot_psnr({"rect": photograph(21), "best Tukey": other}).axes[0]
    lines = [line for line in axes.get_lines() if line.get_linestyle() != "None"]
    assert len({line.get_marker() for line in lines}) == 2
    assert all(line.get_fillstyle() == "none" for line in lines)


def legend_texts(artist):
    """What a legend of a figure or of its axes says."""
    legend = artist.legends[0] if hasattr(artist, "legends") else artist.get_legend()
    return [text.get_text() for text in legend.get_texts()]


def test_a_curve_that_lies_on_another_is_one_by_both_names():
    """Levels of a photograph that nobody could tell apart are drawn once; others are not."""
    near = photograph(21)._replace(linear_psnr=photograph(21).linear_psnr + 2e-3)
    figure = plot_psnr({"rect": photograph(21), "Hann": photograph(23), "best Tukey": near})
    assert legend_texts(figure) == ["rect = best Tukey", "Hann"]
    lines = [x for x in figure.axes[0].get_lines() if x.get_linestyle() != "None"]
    assert len(lines) == 2
    np.testing.assert_array_equal(lines[0].get_ydata(), photograph(21).linear_psnr)


def test_kernels_that_lie_on_one_another_are_one():
    """A camera at rest blurs alike what moves one way and the other; neither lies on the rest."""
    still = {"snapshot": DESIGNS["snapshot"]}
    left, right = plot_kernels(still, [0.0, 900.0, -900.0]).axes
    assert legend_texts(left) == ["0 px/s", "900 px/s = -900 px/s"]
    assert [text.split(": ")[0] for text in legend_texts(right)] == ["900 px/s"]
    assert "= -900 px/s" in legend_texts(right)[0]
    assert (len(left.patches), len(right.patches)) == (2, 1)
    moving, _ = plot_kernels({"rect": DESIGNS["rect"]}, [0.0, 900.0]).axes
    assert legend_texts(moving) == ["0 px/s", "900 px/s"]


EARED = SplineShutter([0.8, 0.2, 0.6, 1.0, 1.0, 0.6, 0.2, 0.8])
WITHOUT_EARS = {
    "a fade": SplineShutter([0.1, 0.2, 0.6, 1.0, 1.0, 0.6, 0.2, 0.1]),
    "two lobes": SplineShutter([0.2, 0.9, 0.6, 0.3, 0.3, 0.6, 0.9, 0.2]),
    "a shutter that closes late": SplineShutter([1.0, 1.0, 0.9, 0.8, 0.6, 0.4, 0.2, 0.0]),
    "chips": ChippedShutter([1.0, 0.0, 1.0, 1.0, 0.0, 1.0]),
    "an open one": SplineShutter.fit(RectShutter(), num_coefficients=8),
}


def notes_of(figure):
    """The lines below the panels of a figure."""
    return [text.get_text() for text in figure.texts]


def test_ears_are_explained_where_they_are_drawn():
    """Each is marked, and a note below says what they are for, within the figure."""
    figure = plot_profiles({"optimised": (MOTION, EARED), "Hann": DESIGNS["Hann"]})
    (note,) = notes_of(figure)
    assert note.startswith("Ears: ")
    (marks,) = (x for x in figure.axes[0].get_lines() if x.get_marker() == "o")
    half = 1e3 * float(MOTION.half_exposure)
    np.testing.assert_allclose(marks.get_xdata(), [-half, half])
    np.testing.assert_allclose(marks.get_ydata(), EARED.transmittance(np.array([-1.0, 1.0])))
    FigureCanvasAgg(figure).draw()
    box = figure.texts[0].get_window_extent()
    assert figure.bbox.x0 <= box.x0 < box.x1 <= figure.bbox.x1
    assert figure.bbox.y0 <= box.y0 < box.y1 <= figure.axes[0].get_tightbbox().y0
    legend = figure.legends[0].get_window_extent()
    assert figure.axes[0].bbox.y1 < legend.y0 < legend.y1 <= figure.bbox.y1


def test_ears_of_a_design_that_is_not_taken_are_not_explained():
    """Where the answer is another camera the profile is drawn alone."""
    figure = plot_profiles({"optimised": (MOTION, EARED)}, explains_ears=False)
    assert not notes_of(figure)
    assert all(line.get_marker() != "o" for line in figure.axes[0].get_lines())


def test_a_single_ear_is_one():
    """A scene whose objects move one way asks for one end more than for the other."""
    one = SplineShutter([0.0, 0.1, 0.6, 1.0, 1.0, 0.6, 0.2, 0.8])
    figure = plot_profiles({"optimised": (MOTION, one)})
    (marks,) = (x for x in figure.axes[0].get_lines() if x.get_marker() == "o")
    np.testing.assert_allclose(marks.get_xdata(), [1e3 * float(MOTION.half_exposure)])


@pytest.mark.parametrize("slug", WITHOUT_EARS)
def test_no_ears_are_explained_where_there_are_none(slug):
    """Nor is a profile of one's own choice, which nothing was optimised for."""
    assert not notes_of(plot_profiles({"mine": (MOTION, WITHOUT_EARS[slug])}))


@pytest.mark.slow
def test_what_is_said_of_ears_is_so():
    """Without them one filter for all speeds loses, the worst speed most; a known one gains."""
    limits = Limits(max_stroke=38, max_half_exposure=0.04)
    scene = Scene.uniform(max_speed=2800.0, photon_rate=3e4, read_noise=10, limits=limits)
    design = optimise(scene)
    middles = (np.arange(400) + 0.5) / 200 - 1
    eared = np.asarray(design.shutter.transmittance(middles))
    dip = int(np.argmin(eared[:100]))
    assert eared[0] - eared[dip] > 0.3
    level = eared.copy()
    level[:dip] = level[400 - dip :] = eared[dip]
    with_ears, without = (
        evaluate(scene, design.motion, ChippedShutter(each)) for each in (eared, level)
    )
    lost = float(with_ears.expected_psnr - without.expected_psnr)
    assert 0 < lost < float(with_ears.worst_speed_psnr - without.worst_speed_psnr)
    assert float(with_ears.known_speed_psnr) < float(without.known_speed_psnr)


@pytest.mark.slow
def test_profiles_span_their_own_exposures(figures):
    """In ms, from shut to shut, each with the share of light that it passes."""
    lines = {line.get_label(): line for line in figures["profiles"].axes[0].get_lines()}
    halves = {"rect, passes 100%": 6.1, "Hann, passes 50%": 6.1}
    for label, half in (halves | {"snapshot, passes 100%": 1.3}).items():
        time, light = lines[label].get_data()
        np.testing.assert_allclose((time[0], time[-1]), (-half, half))
        assert light[0] == light[-1] == 0
        assert light.max() == pytest.approx(1)


@pytest.mark.slow
def test_the_error_of_a_transfer_ends_at_the_expected_psnr(figures):
    """As the table has it, and in the legend, so that the better design ends below the other."""
    ratios, errors = figures["transfer"].axes
    lines = dict(zip(DESIGNS, errors.get_lines(), strict=True))
    for name, (motion, shutter) in DESIGNS.items():
        psnr = float(evaluate(SCENE, motion, shutter).expected_psnr)
        error = lines[name].get_ydata() * 1e-3
        assert -10 * np.log10(error[-1]) == pytest.approx(psnr, abs=1e-9)
        assert lines[name].get_label() == f"{name}: {psnr:.2f} dB"
        assert np.all(np.diff(error) >= 0)
    begin = ratios.get_xlim()[0]
    shares = [np.interp(begin, *line.get_data()) / line.get_ydata()[-1] for line in lines.values()]
    assert max(shares) == pytest.approx(0.01, abs=0.01)


@pytest.mark.parametrize("knows", ["unknown", "found", "known"])
def test_a_transfer_is_of_the_filter_of_the_decoder(knows):
    """Its error ends at that filter's PSNR, and the legend names it."""
    _, errors = plot_transfer(SCENE, DESIGNS, knows).axes
    for line, (motion, shutter) in zip(errors.get_lines(), DESIGNS.values(), strict=True):
        metrics = evaluate(SCENE, motion, shutter)
        psnr = float(SPEED_KNOWLEDGE["unknown" if knows == "unknown" else "known"].psnr(metrics))
        assert -10 * np.log10(line.get_ydata()[-1] * 1e-3) == pytest.approx(psnr, abs=1e-9)
    words = SPEED_KNOWLEDGE[knows].filter_words
    title = errors.figure.legends[0].get_title().get_text()
    assert title == f"expected PSNR of {words}, linear light"
    figure = plot_transfer(SCENE, DESIGNS, knows, dict.fromkeys(DESIGNS, 27.3))
    drawn = f", curves of {words}" if knows == "found" else ""
    title = figure.legends[0].get_title().get_text()
    assert title == f"expected PSNR as in the answer{drawn}, linear light"


@pytest.mark.slow
def test_kernels_have_axes_of_their_own(figures):
    """The first tap of one hides no other, and each stands beside its difference from its own."""
    rows = np.reshape(figures["kernels"].axes, (len(DESIGNS), 2))
    for (left, right), (motion, shutter) in zip(rows, DESIGNS.values(), strict=True):
        still, moving = (patch.get_data() for patch in left.patches)
        assert left.get_ylim()[1] < 1.1 * max(still.values.max(), moving.values.max())
        (difference,) = (patch.get_data() for patch in right.patches)
        np.testing.assert_allclose(difference.values, moving.values - still.values, atol=1e-15)
        scene = Scene([700.0], photon_rate=2e5, read_noise=6.0)
        relative = float(evaluate(scene, motion, shutter).relative_kernel_difference)
        assert right.patches[0].get_label() == f"700 px/s: {relative:.0%}"


def test_kernels_of_a_panning_sensor_differ_from_that_of_what_it_keeps_up_with():
    """An object as fast as the sensor is the one at rest, and has no difference."""
    panning = ParabolicMotion(acceleration=2.3e5, half_exposure=0.0061, velocity=700.0)
    left, right = plot_kernels({"pan": (panning, HannShutter())}, [300.0, 700.0]).axes
    still = plot_kernels({"rest": DESIGNS["Hann"]}, [-400.0, 0.0]).axes[0]
    for one, other in zip(left.patches, still.patches, strict=True):
        width = min(one.get_data().values.size, other.get_data().values.size)
        pair = (patch.get_data().values[:width] for patch in (one, other))
        np.testing.assert_allclose(*pair, atol=1e-12)
    assert [patch.get_label()[:8] for patch in right.patches] == ["300 px/s"]
    assert right.get_title() == "difference from the kernel at 700 px/s"
    assert right.get_legend().get_title().get_text() == "RMS, relative"


@pytest.mark.parametrize("name", FIGURES)
def test_a_figure_is_a_whole_png(name, figures, tmp_path):
    """A saved figure opens as a picture and leaves nothing else in its folder."""
    path = tmp_path / f"{name}.png"
    save_figure(figures[name], path)
    with Image.open(path) as picture:
        assert min(picture.size) > 300
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_a_notebook_shows_a_figure(figures):
    """Also one that never imports `pyplot`, by which a figure would else be shown."""
    assert figures["levels"]._repr_png_().startswith(b"\x89PNG")


GRIDS = {
    "map": {},
    "row": {"acceleration": [2]},
    "column": {"half_exposure": [2]},
    "point": {"acceleration": [1], "half_exposure": [3]},
    "at-rest": {"acceleration": [0]},
    "at-rest-and-a-row": {"acceleration": [0, 2]},
    "at-rest-and-a-point": {"acceleration": [0, 2], "half_exposure": [3]},
}


@pytest.mark.parametrize("slug", GRIDS)
def test_a_map_of_any_grid_marks_its_best(slug, tmp_path):
    """A star that the axes do not cut off, its value in the title, be it one row or one point."""
    found = swept().isel(GRIDS[slug])
    figure = plot_map(found)
    save_figure(figure, tmp_path / "map.png")
    (star,) = (line for line in figure.axes[0].get_lines() if line.get_marker() == "*")
    assert not star.get_clip_on()
    moving = found.expected_psnr
    if min(moving.shape[:2]) > 1:
        moving = moving.where(moving.acceleration > 0, drop=True)
    best = moving.where(moving == moving.max(), drop=True)
    a, half = float(best.acceleration[0]), float(best.half_exposure[0])
    said = figure.axes[0].get_title().splitlines()[1].removeprefix("☆ best: ").split(", ")
    assert said[0] == f"{float(best.max()):.3g} dB"
    assert said[1] in {str(name) for name in best.dropna("shutter").shutter.values}
    place = [f"{2e3 * half:.3g} ms", f"{2 * a:.3g} px/s²", f"pan {float(found.velocity):.4g} px/s"]
    assert said[2:] == [*place, f"sag {a * half**2:.3g} px"]
    places = {2 * a, 2e3 * half, float(best.max())}
    assert {float(star.get_xdata()[0]), float(star.get_ydata()[0])} <= places


def test_the_best_of_shutters_is_the_least_where_less_is_better():
    """A map of the condition number, at each point of the shutter that has the least."""
    moving = swept().isel(acceleration=slice(1, None))
    figure = plot_map(moving, "condition_number")
    least = moving.condition_number.min("shutter").values
    shown = np.ma.filled(figure.axes[0].collections[0].get_array(), np.nan)
    known = np.unique(least[~np.isnan(least)])
    np.testing.assert_array_equal(np.unique(shown[~np.isnan(shown)]), known)
    assert f"best: {np.nanmin(least):.3g}, " in figure.axes[0].get_title()


@pytest.mark.parametrize(
    ("velocity", "length", "speed"), [(0.0, "stroke", "top speed"), (310.0, "sag", "speed gain")]
)
def test_lines_of_a_map_are_where_they_say(velocity, length, speed):
    """Each label lies at a motion of about the number that it names: stroke holds any pan."""
    found = swept()
    axes = plot_map(found.assign_coords(velocity=0 * found.velocity + velocity)).axes[0]
    named = {"px": lambda whole, T: whole / 2 * T**2, "px/s": lambda whole, T: whole * T}
    seen = set()
    for text in axes.texts:
        *name, number, unit = text.get_text().split()
        assert {"px": length, "px/s": speed}[unit] == " ".join(name)
        time, acceleration = text.get_position()
        assert named[unit](acceleration, time * 5e-4) == pytest.approx(float(number), rel=0.2)
        seen.add(unit)
    assert seen == set(named)


def test_a_gain_is_told_from_a_loss():
    """A gain is as light as it is high, losses beyond the highest are dark, a line parts them."""
    figure = plot_map(swept(), "gain", shutter="rect")
    axes, bar = figure.axes
    mesh = axes.collections[0]
    gain = np.ma.compressed(mesh.get_array())
    assert gain.min() < 0 < gain.max()
    lowest = max(gain.min(), -gain.max())
    shares = (gain - lowest) / (gain.max() - lowest)
    np.testing.assert_allclose(mesh.norm(gain), shares, atol=1e-12)
    assert bar.get_ylabel().startswith("gain")
    (legend,) = figure.legends
    assert [text.get_text() for text in legend.get_texts()] == ["0 dB: as good as Hann"]
    places = axes.collections[-1].get_paths()[0].vertices
    found = swept().gain.sel(shutter="rect").transpose("acceleration", "half_exposure")
    for exposure, acceleration in places:
        half, a = exposure / 2, acceleration / 2
        row = np.searchsorted(found.acceleration, a * (1 - 1e-9))
        column = np.searchsorted(found.half_exposure, half * 1e-3 * (1 - 1e-9))
        corners = found.values[max(0, row - 1) : row + 1, max(0, column - 1) : column + 1]
        assert np.nanmin(corners) < 0 < np.nanmax(corners)
    assert len(places) >= 2


@pytest.mark.parametrize("sign", [-1, 1])
def test_a_gain_that_is_0_nowhere_has_no_line(sign):
    """Where all of it is a loss, or a gain, the colours are of its own range."""
    changed = swept().assign(gain=(sign * (1 + abs(swept().gain))).assign_attrs(swept().gain.attrs))
    figure = plot_map(changed, "gain", shutter="rect")
    assert not figure.legends
    mesh = figure.axes[0].collections[0]
    gain = np.ma.compressed(mesh.get_array())
    assert (mesh.norm.vmin, mesh.norm.vmax) == (gain.min(), gain.max())


def test_shutters_of_a_front_are_told_apart_in_grey(figures):
    """Each has its own front, in a marker and a dash of its own."""
    lines = {line.get_label(): line for line in figures["front"].axes[0].get_lines()}
    names = [str(name) for name in swept().shutter.values]
    for name in names:
        front = pareto_front(swept().sel(shutter=[name]), FRONT)
        drawn = lines[name].get_data()
        np.testing.assert_array_equal(drawn, [front[metric].values for metric in FRONT])
    assert len({lines[name].get_marker() for name in names}) == len(names)
    # Matplotlib's public name for every dash pattern of one's own is "--".
    assert len({str(lines[name]._unscaled_dash_pattern) for name in names}) == len(names)


def test_profiles_of_a_front():
    """Over the exposure in ms of one of its points, of the shutter that stands there."""
    front = pareto_front(swept(), FRONT)
    halves = np.unique(front.half_exposure) * 1e3
    for axes in plot_front(swept(), FRONT).axes[1:]:
        time = axes.get_lines()[0].get_xdata()
        assert np.isclose(halves, time.max(), rtol=1e-12).any()
        assert time.min() == -time.max()
    tau, spline = np.linspace(-1, 1, 31), np.array([0.2, 0.7, 0.9, 1.0, 0.4])
    drawn = {"Hann": HannShutter(), "optimised": SplineShutter(spline)}
    for name, shutter in drawn.items():
        point = xarray.Dataset({"coefficients": ("coefficient", spline)}, {"shutter": name})
        found = sweep_plots._transmittance(swept(), point, tau)
        np.testing.assert_array_equal(found, shutter.transmittance(tau))
    # Of a shutter of one's own a sweep holds samples from the first light to the last.
    own = {"kind": "Own", "transmittance": [0.0, 0.9, 0.6, 0.4, 0.2]}
    samples = xarray.Dataset(attrs={"sweep": json.dumps({"shutters": {"own": own}})})
    point = xarray.Dataset({}, {"shutter": "own"})
    found = sweep_plots._transmittance(samples, point, np.array([-0.75, -0.5, 0.25, 1.0]))
    np.testing.assert_allclose(found, [0.45, 0.9, 0.5, 0.2])


@pytest.mark.slow
def test_pictures_of_velocities():
    """A map has the best of them at each point, of one shutter or all; a front takes them all."""
    panned = sweep(SCENE, **grid(velocities=[-500.0, 0.0, 200.0]))
    for shutter in (None, "Hann"):
        for metric, most in (("expected_psnr", True), ("relative_kernel_difference", False)):
            figure = plot_map(panned, metric, shutter=shutter)
            values = panned[metric] if shutter is None else panned[metric].sel(shutter=shutter)
            over = [name for name in ("velocity", "shutter") if name in values.dims]
            best = values.max(over) if most else values.min(over)
            best = best.dropna("half_exposure", how="all").sel(acceleration=slice(1, None))
            drawn = figure.axes[0].collections[0].get_array()
            np.testing.assert_array_equal(np.ma.filled(drawn, np.nan), best)
            title = figure.axes[0].get_title().splitlines()[0]
            assert title.endswith(f"{shutter or 'the best shutter'} at its best velocity")
    front = pareto_front(panned, FRONT)
    lines = plot_front(panned, FRONT).axes[0].get_lines()
    drawn = {str(line.get_label()): line for line in lines}
    np.testing.assert_array_equal(drawn["front of all"].get_xdata(), front[FRONT[0]])
    np.testing.assert_array_equal(
        drawn["other points"].get_ydata(), panned[FRONT[1]].values.ravel()
    )
    for name in ("rect", "Hann"):
        own = pareto_front(panned.sel(shutter=[name]), FRONT)
        np.testing.assert_array_equal(drawn[name].get_ydata(), own[FRONT[1]])


def test_a_map_says_at_which_pan_it_is_best():
    """Beside a sag, since a pan adds to the stroke; of a shutter that is chosen no name is said."""
    panned = sweep(SCENE, **grid(velocities=[-500.0, 200.0]))
    title = plot_map(panned, shutter="Hann").axes[0].get_title().splitlines()[1]
    levels = panned.expected_psnr.sel(shutter="Hann", drop=True)
    moving = levels.where(levels.acceleration > 0)
    best = moving[moving.argmax(...)]
    a, half, velocity = (float(best[n]) for n in ("acceleration", "half_exposure", "velocity"))
    assert title == (
        f"☆ best: {float(best):.3g} dB, {2e3 * half:.3g} ms, {2 * a:.3g} px/s², "
        f"pan {velocity:.4g} px/s, sag {a * half**2:.3g} px"
    )


def test_no_colour_of_a_map_is_grey():
    """Grey is the place outside the limits; a gain of none has a colour of its own."""
    from matplotlib import colormaps

    colours = colormaps[MAP_COLOURS](np.linspace(0, 1, 256))[:, :3]
    assert np.ptp(colours, axis=1).min() > 0.15
    # They rise in lightness, so that a grey printout keeps their order.
    lightness = colours @ [0.2126, 0.7152, 0.0722]
    assert np.all(np.diff(lightness) > 0)


def test_a_map_leaves_out_what_is_wholly_outside():
    """One acceleration near the largest number leaves the others as they are."""
    huge = sweep(SCENE, **grid(accelerations=[3e4, 9e4, 1.7e308]))
    axes = plot_map(huge).axes[0]
    assert axes.get_ylim()[1] < 4e5


def test_a_map_of_equal_steps_shows_every_point():
    """On logarithmic axes too the first row and column are whole, and none is outside."""
    a, half = np.linspace(2e4, 3e5, 5), np.linspace(0.001, 0.0105, 6)
    even = sweep(SCENE, **grid(accelerations=a, half_exposures=half))
    axes = plot_map(even).axes[0]
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")
    points = np.stack(np.meshgrid(half * 2e3, 2 * a), axis=-1).reshape(-1, 2)
    shares = axes.transAxes.inverted().transform(axes.transData.transform(points))
    assert np.all((shares > 0.01) & (shares < 0.99))


MAP_MISTAKES = {
    "metric": ({}, {"metric": "beauty"}, "`plot_map(metric=...)` must be in the sweep; got"),
    "shutter": ({}, {"shutter": "Tukey"}, "must be one of rect, Hann; got 'Tukey'"),
    "outside": ({"half_exposure": [0]}, {}, "must reach a point within the limits; got 'none'"),
}


@pytest.mark.parametrize("slug", MAP_MISTAKES)
def test_map_mistakes(slug):
    """What is not in a sweep cannot be drawn."""
    some, arguments, message = MAP_MISTAKES[slug]
    with pytest.raises(ValueError, match="must") as caught:
        plot_map(swept().isel(some), **arguments)
    assert message in str(caught.value)


def test_kernels_without_acceleration_lie_around_mid_exposure():
    """They are drawn where a camera at rest has them."""
    unmoved = ParabolicMotion(acceleration=0.0, half_exposure=0.0013)
    given = {"at rest": DESIGNS["snapshot"], "unmoved": (unmoved, RectShutter())}
    panels = np.reshape(plot_kernels(given, [0.0, 2700.0]).axes, (2, 2))
    for one, other in panels.T:
        for pair in zip(one.patches, other.patches, strict=True):
            first, second = (patch.get_data() for patch in pair)
            np.testing.assert_array_equal(first.values, second.values)
            np.testing.assert_array_equal(first.edges, second.edges)


def test_a_map_of_several_scenes():
    """One of them must be chosen."""
    both = sweep([SCENE, SCENE], **grid(metrics=["efficiency"]))
    with pytest.raises(ValueError, match="must be of one scene and light; got"):
        plot_map(both, "efficiency")


def test_a_front_is_legible_beside_an_outlier():
    """A condition number of 1,200 makes the axis logarithmic, and letters stay apart."""
    moving = swept().isel(acceleration=slice(1, None))
    far = _with_best_at(moving, 1.2e3)
    figure = plot_front(moving.assign(condition_number=far), FRONT)
    axes = figure.axes[0]
    assert axes.get_xscale() == "log"
    assert axes.get_yscale() == "linear"
    places = [axes.transData.transform(text.xy) for text in axes.texts]
    assert len(places) == len(figure.axes) - 1 > 1
    assert all(np.hypot(*(a - b)) > 20 for a, b in pairwise(places))


@pytest.mark.parametrize("largest", [60.0, 8e3])
def test_numbers_of_a_logarithmic_axis_stay_apart(largest):
    """Between decades they are written where there is room, over two decades at most."""
    moving = swept().isel(acceleration=slice(1, None))
    far = _with_best_at(moving, largest)
    figure = plot_front(moving.assign(condition_number=far), FRONT)
    FigureCanvasAgg(figure).draw()
    axes = figure.axes[0]
    texts = [*axes.get_xticklabels(), *axes.get_xticklabels(minor=True)]
    boxes = [text.get_window_extent() for text in texts if text.get_text()]
    boxes = sorted((box for box in boxes if axes.bbox.x0 <= box.x0 <= axes.bbox.x1), key=_left)
    assert len(boxes) >= 3
    assert all(one.x1 < other.x0 for one, other in pairwise(boxes))


def _with_best_at(found, number):
    """Condition numbers of a sweep, one of them for the best point, which is on the front."""
    return found.condition_number.where(found.expected_psnr != found.expected_psnr.max(), number)


def test_points_that_no_front_reaches_do_not_stretch_the_axes():
    """The axes are those of the fronts; a condition number of 1,200 far below them is outside."""
    moving = swept().isel(acceleration=slice(1, None))
    worst = moving.expected_psnr == moving.expected_psnr.min()
    far = moving.assign(condition_number=moving.condition_number.where(~worst, 1.2e3))
    axes = plot_front(far, FRONT).axes[0]
    assert axes.get_xlim()[1] < 100


def _left(box):
    return box.x0


def test_a_front_of_nothing():
    """Where no point is within the limits there are no letters and no profiles."""
    figure = plot_front(swept().isel(half_exposure=[0]), FRONT)
    assert len(figure.axes) == 1
    assert not figure.axes[0].texts
    with pytest.raises(ValueError, match=r"plot_front\(num_profiles=...\)` must be a positive"):
        plot_front(swept(), FRONT, num_profiles=0)


@pytest.mark.parametrize("shape", [(23, 31, 1), (497, 741, 1), (60, 20, 1)])
def test_titles_of_a_capture_are_within_the_picture(shape):
    """Both lines, above a picture of any shape."""
    light = np.full(shape, 0.5)
    figure = plot_capture(Picture(light), light, light, camera="a", decoder="b")
    FigureCanvasAgg(figure).draw()
    for axes in figure.axes:
        box = axes.title.get_window_extent()
        assert axes.get_window_extent().y1 < box.y0 < box.y1 <= figure.bbox.y1


@pytest.mark.parametrize(
    ("shape", "aspect"),
    [((1, 20_000, 1), "auto"), ((40, 300, 1), 1.0), ((5_000, 3, 1), "auto"), ((300, 40, 1), 1.0)],
)
def test_a_capture_of_any_shape_is_seen(shape, aspect):
    """One long row, or a few columns, are stretched; what is less so keeps its shape."""
    light = np.full(shape, 0.5)
    figure = plot_capture(None, light, light)
    FigureCanvasAgg(figure).draw()
    for axes in figure.axes:
        assert axes.get_aspect() == aspect
        assert min(axes.get_window_extent().size) >= 10


def test_frames_of_a_burst_are_shown_as_bright_as_their_restoration():
    """Titles say of the others how many times they are brighter; a frame without light stays."""
    light = np.random.default_rng(1).uniform(0.1, 0.5, (23, 31, 1))
    frames = {"frame_1": 0.9 * light, "frame_2": 0.1 * light, "frame_3": 0 * light}
    figure = plot_capture(None, frames, light)
    titles = [axes.get_title().splitlines()[0] for axes in figure.axes]
    assert titles == ["frame 1", "frame 2, shown 10 times as bright", "frame 3", "restored"]
    long, short, dark, restored = (axes.images[0].get_array() for axes in figure.axes)
    np.testing.assert_allclose(short, restored)
    assert np.all(long < restored)
    assert not np.any(dark)
    (one, _) = plot_capture(None, 0.1 * light, light).axes
    assert np.all(one.images[0].get_array() < 0.9 * restored)


def test_a_drive_of_one_step_shows_the_sensor():
    """The sensor moves through the whole exposure, however few steps drive the shutter."""
    design = a_design(HannShutter())
    figure = plot_drive(drive_table(design, num_steps=1))
    time, position = figure.axes[1].lines[0].get_data()
    half = float(design.motion.half_exposure) * 1e3
    np.testing.assert_allclose((time[0], time[-1]), (-half, half))
    np.testing.assert_allclose((position.max(), position.min()), (design.motion.stroke, 0))


def test_a_drive_is_drawn_at_the_middle_of_its_steps():
    """The mean over a step stands there, and the level from its beginning to its end."""
    table = drive_table(a_design(HannShutter()), num_steps=4)
    top = plot_drive(table).axes[0]
    half = float(table.design.motion.half_exposure) * 1e3
    np.testing.assert_allclose(top.lines[0].get_xdata(), half * np.array([-3, -1, 1, 3]) / 4)
    np.testing.assert_allclose(top.patches[0].get_data().edges, half * np.linspace(-1, 1, 5))


def test_a_drive_shows_the_shutter_behind_its_device():
    """Its levels are sent; the light that passes lags behind them."""
    device = FirstOrderDevice(rise_time=2e-3, fall_time=2e-3)
    scene = Scene(SCENE.speeds, photon_rate=1e5, read_noise=10.0, device=device)
    table = drive_table(a_design(HannShutter(), scene=scene))
    top = plot_drive(table).axes[0]
    labels = [text.get_text() for text in top.get_legend().get_texts()]
    assert labels == ["sent, 256 levels", "sent as designed", "behind the device"]
    passed = top.lines[1].get_ydata()
    tau = np.linspace(-1, 1, passed.size)
    np.testing.assert_allclose(passed, table.passed().transmittance(tau), atol=1e-6)
    assert np.max(np.abs(passed - np.asarray(HannShutter().transmittance(tau)))) > 0.1


def _rows(figure, across):
    """Panels of a photograph beneath those of the scene."""
    return np.reshape(figure.axes[2:-1], (-1, across))


def test_photograph_of_several_designs(tmp_path):
    """One row a design; at each speed, the nearest that was tried, what it has and what it errs."""
    results = {"rect": photograph(21), "best snapshot": photograph(24)}
    figure = plot_photograph(results, [0.0, 400.0], detail=(11, 17))
    titles = [[axes.get_title() for axes in row] for row in _rows(figure, 6)]
    assert titles[1] == [
        "best snapshot,\ncaptured at 0 px/s",
        "restored,\n27.10 dB",
        "error",
        "best snapshot,\ncaptured at 450 px/s",
        "restored,\n26.70 dB",
        "error",
    ]
    assert all(axes.images for axes in figure.axes)
    assert "linear light" in figure.axes[-1].get_title()
    save_figure(figure, tmp_path / "photograph.png")


def test_a_detail_whose_speed_is_in_doubt_says_so():
    """At that speed alone; where an estimate is trusted the speed was found."""
    doubts = np.array(["", "", "two speeds fit."], object)
    results = {"rect": photograph(21)._replace(doubts=doubts)}
    figure = plot_photograph(results, [0.0, 450.0], detail=(11, 17), decoder_speed="found")
    titles = [panel.get_title().partition("\n")[0] for panel in _rows(figure, 6)[0][1::3]]
    assert titles == ["restored, speed found,", "restored, speed in doubt,"]


def test_a_detail_is_of_one_place():
    """Also of designs that recorded other columns, as a camera at rest does beside a moving one."""
    results = {"Hann": photograph(21), "best snapshot": photograph(21, columns=slice(5, 28))}
    figure = plot_photograph(results, [0.0], detail=(11, 9))
    scene = figure.axes[1].images[0].get_array()
    assert scene.shape == (11, 9)
    for panels in _rows(figure, 3):
        np.testing.assert_allclose(panels[0].images[0].get_array(), scene)
        np.testing.assert_allclose(panels[2].images[0].get_array(), 1 / 21)


def test_a_detail_is_where_the_photograph_varies():
    """Stripes in one part of an even picture are what is magnified."""
    light = np.full((40, 90, 1), 0.4)
    light[25:33, 50:60:2] = 0.9
    found = photograph(21)
    seen = np.stack(3 * [light])
    found = found._replace(reference=light, captured=seen, restored=seen)
    figure = plot_photograph({"rect": found}, [0.0], detail=(10, 12))
    scene = figure.axes[1].images[0].get_array()
    assert np.sum(scene == scene.max()) == np.sum(light == 0.9)


def test_errors_have_one_scale():
    """The map of the worse design is darker, and the key spans the scale in % of white."""
    results = {"good": photograph(50), "bad": photograph(5)}
    figure = plot_photograph(results, [0.0], detail=(11, 17))
    good, bad = (panels[2].images[0] for panels in _rows(figure, 3))
    np.testing.assert_allclose(bad.norm(bad.get_array()), 1)
    np.testing.assert_allclose(good.norm(good.get_array()), 0.1)
    assert figure.axes[-1].get_xlim() == pytest.approx((0, 20))
    assert figure.axes[-1].get_xlabel() == "error / % of white"


def test_a_capture_is_shown_as_bright_as_its_scene():
    """However much light a shutter costs; the picture at rest is then the scene itself."""
    figure = plot_photograph({"rect": photograph(21)}, [0.0], detail=(11, 17))
    scene, captured = (panel.images[0].get_array() for panel in figure.axes[1:3])
    np.testing.assert_allclose(captured, scene)


def test_levels_are_drawn_in_order_of_speed():
    """Whatever order the speeds were tried in, each level stands at its own."""
    found = photograph(21)
    order = np.array([2, 0, 1])
    mixed = found._replace(
        speeds=found.speeds[order], psnr=found.psnr[order], linear_psnr=found.linear_psnr[order]
    )
    for result in (found, mixed):
        axes = plot_psnr({"rect": result}).axes[0]
        line = axes.get_lines()[0]
        np.testing.assert_array_equal(line.get_xdata(), found.speeds)
        np.testing.assert_array_equal(line.get_ydata(), found.linear_psnr)
        assert "linear light" in axes.get_ylabel()


def test_one_seed_has_no_error_bar():
    """Without a second capture there is no standard error, and no bar stands for it."""
    figure = plot_psnr({"rect": photograph(21, num_seeds=1)})
    assert not figure.axes[0].collections


def test_nothing_to_show_is_an_error():
    """A photograph of no design, at no speed, or not of one scene, is refused."""
    with pytest.raises(ValueError, match="must hold a result; got 0"):
        plot_photograph({}, [0.0])
    with pytest.raises(ValueError, match="must hold a speed; got 0"):
        plot_photograph({"rect": photograph(21)}, [])
    other = photograph(21)
    other = other._replace(reference=other.reference + 0.1)
    with pytest.raises(ValueError, match="must be of one photograph; got several"):
        plot_photograph({"rect": photograph(21), "Hann": other}, [0.0])
