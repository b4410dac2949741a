"""Pictures of options, of two axes, of fits and of measurements: what their lines hold."""

import json
from dataclasses import replace

import numpy as np
import pytest
import xarray
from support.bursts import a_burst_design
from support.photographs import photograph
from support.plane import a_plane_design

from mishutter import (
    EvenVelocities,
    FreeMotion,
    HannShutter,
    Limits,
    ListedVelocities,
    ParabolicMotion,
    Scene,
    SplineShutter,
    StillCamera,
    TimedFrame,
    plot_design,
)
from mishutter.evaluation.metrics import Metrics
from mishutter.hardware.calibration.estimation import Estimate as Fitted
from mishutter.hardware.calibration.estimation import FittedCamera
from mishutter.hardware.triggers import frame_table
from mishutter.measurement.clip import Clip
from mishutter.measurement.estimates import Estimate, Refusal
from mishutter.measurement.motion import Motion, MovingObject
from mishutter.measurement.noise import Noise
from mishutter.measurement.photon_transfer import Blocks, Law, Transfer
from mishutter.measurement.scene import Measurement
from mishutter.model.exposures import Exposures
from mishutter.model.shutters.kinds import shutter_to_dict
from mishutter.report.fit_plots import plot_fit
from mishutter.report.measurement_plots import plot_motion, plot_noise
from mishutter.report.plots import (
    _details,
    _offset,
    _outline,
    _shrunk,
    motion_text,
    new_figure,
    plot_frames,
    plot_option,
    plot_photograph,
    shown_name,
)
from mishutter.report.sweep_plots import _draw_profile
from mishutter.search.rows import FRAMES, ONE_EXPOSURE, STAGE, Row

SCENE = Scene([-310.0, 420.0], photon_rate=2e5, read_noise=3.0, limits=Limits(max_stroke=40.0))


@pytest.mark.parametrize(
    ("acceleration", "pan", "text"),
    [
        (0.0, 0.0, "12.2 ms"),
        (0.0, -310.0, "12.2 ms, pan -310 px/s"),
        (2.3e5, 0.0, "12.2 ms, stroke 8.56 px"),
        (2.3e5, 120.0, "12.2 ms, sag 8.56 px beside a pan of 120 px/s"),
    ],
)
def test_a_motion_has_a_stroke_or_a_sag_beside_its_pan(acceleration, pan, text):
    """A pan adds to the stroke, and what is left of that is the sag."""
    motion = ParabolicMotion(acceleration=acceleration, half_exposure=0.0061, velocity=pan)
    assert motion_text(motion) == text


def row_of(exposures):
    metrics = object.__new__(Metrics)  # of which a picture asks the efficiency alone
    object.__setattr__(metrics, "efficiency", np.float64(0.6))
    hardware = ONE_EXPOSURE if exposures.shutter else frozenset({STAGE, FRAMES})
    return Row("own best motion", "own", exposures, 0.1, metrics, hardware=hardware)


def test_an_option_of_one_exposure_draws_its_path_and_its_shutter():
    """One under the other, in ms, with the stroke from first to last light."""
    motion = ParabolicMotion(acceleration=2.3e5, half_exposure=0.0061, velocity=120.0)
    row = row_of(Exposures.of_one(motion, HannShutter()))
    figure = plot_option(SCENE, row, "One exposure, moved.")
    path, below = figure.axes
    (line,) = path.get_lines()
    time, place = line.get_data()
    lit = np.abs(time) < 6.1  # between the run-up and the run-out
    own = np.asarray(motion.position(time[lit] * 1e-3))
    np.testing.assert_allclose(np.diff(place[lit]), np.diff(own), atol=1e-6)
    assert np.mean(lit) == pytest.approx(0.5, abs=0.02)
    assert line.get_label() == f"stage, {row.stroke:.3g} px from first to last light"
    assert path.get_ylabel() == "stage position / px"
    time, passed = below.get_lines()[0].get_data()
    np.testing.assert_allclose(passed, HannShutter().transmittance(time / 6.1), atol=1e-9)
    assert (path.get_xlabel(), below.get_xlabel()) == ("", "time from the middle / ms")
    assert figure.get_suptitle() == "One exposure, moved."
    lit = path.patches[0].get_window_extent().transformed(path.transData.inverted())
    assert (lit.x0, lit.x1) == pytest.approx((-6.1, 6.1), abs=0.02)


def test_an_option_of_frames_draws_each_where_no_limit_says_how_the_stage_gets_there():
    """Frames at rest have one line, from the first light to the last."""
    halves, velocities = (0.002, 0.003), (0.0, -500.0)
    moving = [
        FreeMotion(accelerations=[0.0], half_exposure=half, velocity=velocity)
        for half, velocity in zip(halves, velocities, strict=True)
    ]
    moving[0] = StillCamera(half_exposure=halves[0])  # at rest first: nothing says how it goes on
    frames = (TimedFrame(moving[0], -0.01, 3.0), TimedFrame(moving[1], 0.008, -2.0))
    exposures = Exposures("own", frames)
    free = replace(SCENE, limits=Limits(max_half_exposure=0.02))
    (axes,) = plot_option(free, row_of(exposures)).axes
    for line, frame in zip(axes.get_lines(), frames, strict=True):
        time, place = line.get_data()
        half = frame.exposure * 500
        np.testing.assert_allclose(time[[0, -1]], frame.time * 1e3 + np.array([-half, half]))
        slope = np.diff(place) / np.diff(time) * 1e3
        np.testing.assert_allclose(slope, float(frame.motion.velocity), rtol=1e-6, atol=1e-6)
    assert axes.get_lines()[0].get_label().startswith("stage, ")
    middles = [line.get_ydata()[500] for line in axes.get_lines()]
    own = [float(exposures.place(np.full((2, 1), f.time))[0, k, 0]) for k, f in enumerate(frames)]
    assert np.diff(middles) == pytest.approx(np.diff(own))
    still = StillCamera(half_exposure=0.003)
    stills = Exposures("own", (TimedFrame(still, -0.01), TimedFrame(still, 0.012)))
    held = replace(SCENE, limits=Limits(max_stroke=0.0))
    (axes,) = plot_option(held, row_of(stills)).axes
    (line,) = axes.get_lines()
    np.testing.assert_allclose(line.get_xdata()[[0, -1]], [-13.0, 15.0])
    assert not line.get_ydata().any()
    assert axes.get_ylim() == (-1, 1)
    assert line.get_label().endswith(", at rest")
    assert axes.get_ylabel().startswith("sensor" if not held.limits.moves else "stage")


def test_frames_of_a_table_are_drawn_with_what_is_sent():
    """Along both axes of the plane, each axis by its name, in ms."""
    for design, names in (
        (a_burst_design(), ["stage"]),
        (a_plane_design(), ["stage along rows", "stage along columns"]),
    ):
        table = frame_table(design)
        (axes,) = plot_frames(table).axes
        assert [line.get_label() for line in axes.get_lines()] == names
        for line, path in zip(axes.get_lines(), table.paths.values(), strict=True):
            time, place = line.get_data()
            np.testing.assert_allclose(
                time[[0, -1]], 1e3 * np.array([path.times[0], path.times[-1]])
            )
            np.testing.assert_allclose(place, path.at(time * 1e-3)[0], atol=1e-9)
        assert len(axes.patches) == len(table.lights)


def test_stills_of_a_table_are_drawn_at_rest():
    """A camera without a stage has a sensor, and a line at 0 is no wiggle that is magnified."""
    still = StillCamera(half_exposure=0.003)
    stills = Exposures("own", (TimedFrame(still, -0.01), TimedFrame(still, 0.012)))
    for stroke, part in ((0.0, "sensor"), (45.0, "stage")):
        design = a_burst_design(stills, Limits(max_stroke=stroke, max_half_exposure=0.02))
        (axes,) = plot_frames(frame_table(design)).axes
        assert [line.get_label() for line in axes.get_lines()] == [f"{part}, at rest"]
        assert axes.get_ylabel() == f"{part} position / px"
        assert axes.get_ylim() == (-1, 1)


def test_a_design_in_the_plane_draws_its_path_without_its_pan():
    """About the middle of all; exposures are coloured, and velocities are those of the path."""
    pan = np.array([210.0, -90.0])
    design = a_plane_design()
    for turned in (False, True):
        exposures = design.exposures
        if turned:
            exposures = replace(exposures, pan=tuple(pan.tolist()))
            design = replace(design, sequence=exposures)
        plane, hodograph, below = plot_design(design).axes
        path = exposures.frames
        middle = float(path.times[0] - path.exposures[0] / 2)
        time = middle + np.linspace(0, exposures.duration * (1 - 1e-9), 8008)
        place = np.asarray(path.place(time)) - turned * np.outer(pan, time)
        place -= place.mean(axis=1)[:, None]
        np.testing.assert_allclose(plane.get_lines()[0].get_data(), place, atol=1e-6)
        ends = middle + np.append(0, np.cumsum(path.durations))
        velocity = [np.interp(time, ends, each) for each in path.velocities]
        np.testing.assert_allclose(hodograph.get_lines()[0].get_data(), velocity, rtol=1e-6)
        rows, columns = below.get_lines()
        np.testing.assert_allclose([rows.get_ydata(), columns.get_ydata()], place, atol=1e-6)
        np.testing.assert_allclose(rows.get_xdata(), time * 1e3)
        lits = zip(exposures.lights, plane.get_lines()[1:], strict=True)
        for (first, last), line in lits:
            lit = (time >= first) & (time <= last)
            np.testing.assert_allclose(line.get_data(), place[:, lit], atol=1e-6)


def test_velocities_of_flights_leave_the_panel_to_those_of_things():
    """Between the first two frames the stage flies ten times as fast."""
    design = a_plane_design()
    path = design.exposures.frames
    ends = path.times[0] - path.exposures[0] / 2 + np.append(0, np.cumsum(path.durations))
    fast = path.velocities.copy()
    fast[:, (ends > -0.007) & (ends < -0.0055)] = 2e4
    flying = replace(design.exposures, frames=replace(path, velocities=fast))
    hodograph = plot_design(replace(design, sequence=flying)).axes[1]
    assert np.max(hodograph.get_lines()[0].get_data()) == pytest.approx(2e4, rel=0.01)
    assert np.max(np.abs([hodograph.get_xlim(), hodograph.get_ylim()])) < 3e3


@pytest.mark.parametrize("law", ["ellipse", "list"])
def test_the_outline_of_velocities_is_theirs(law):
    """An ellipse that is turned; of a list off centre its hull, by the tangents."""
    angles = np.linspace(0, 2 * np.pi, 1001)
    if law == "ellipse":
        x, y = _outline(EvenVelocities(1700.0, 1100.0, angle=0.3), angles)
        along, across = x * np.cos(0.3) + y * np.sin(0.3), y * np.cos(0.3) - x * np.sin(0.3)
        inner = slice(2, -2)
        radius = np.hypot(along / 1700, across / 1100)[inner]
        np.testing.assert_allclose(radius, 1, atol=1e-3)
        return
    corners = np.array([[100.0, 200.0], [700.0, 300.0], [400.0, 900.0]])
    x, y = _outline(ListedVelocities(corners), angles)
    away = np.hypot(x[:, None] - corners[:, 0], y[:, None] - corners[:, 1])
    assert np.mean(np.min(away, axis=1) < 1) > 0.98
    assert np.all(np.min(away, axis=0) < 1)


def test_a_detail_is_one_place_of_parts_that_begin_apart():
    """Along rows and, exchanged, along columns; within the columns that all have."""
    random = np.random.default_rng(2)
    whole = np.full((30, 90, 1), 0.4)
    whole[12:20, 41:51] = random.uniform(size=(8, 10, 1))
    parts = [whole[:, 4:80], whole[:, :85], whole[:, 11:]]
    assert [_offset(parts[0], part) for part in parts] == [0, -4, 7]
    for axis in ("rows", "columns"):
        given = parts if axis == "rows" else [np.swapaxes(part, 0, 1) for part in parts]
        found = [
            part[place] for part, place in zip(given, _details(given, (8, 11), axis), strict=True)
        ]
        for one in found:
            assert one.shape == ((8, 11, 1) if axis == "rows" else (11, 8, 1))
            np.testing.assert_array_equal(one, found[0])
        assert np.sum(found[0] != 0.4) == 80


def test_the_box_in_a_scene_is_the_detail():
    """Its edges lie between pixels, in both colours; the scene is twice as high as a detail."""
    found = photograph(21)
    figure = plot_photograph({"rect": found, "Hann": photograph(24)}, [0.0, 450.0], detail=(7, 11))
    whole, detail = figure.axes[:2]
    shown = np.asarray(detail.images[0].get_array())
    (first, second), picture = whole.patches, np.asarray(whole.images[0].get_array())
    corner = np.array(first.get_xy()) + 0.5
    left, top = corner.astype(int)
    assert (first.get_width(), first.get_height()) == (11, 7) == shown.shape[::-1]
    np.testing.assert_array_equal(picture[top : top + 7, left : left + 11], shown)
    np.testing.assert_array_equal(second.get_bbox().bounds, first.get_bbox().bounds)
    heights = [axes.get_position().height * figure.get_figheight() for axes in figure.axes[:3]]
    below = figure.axes[2].get_position(original=True).height * figure.get_figheight()
    assert below == pytest.approx(1.6 * 7 / 11, rel=0.1)
    assert heights[0] == pytest.approx(min(2 * below, 1.6 * 4 * 23 / 31), rel=0.15)


def test_a_profile_of_a_front_names_its_stroke_or_its_sag():
    """A pan adds to the stroke, and what is left is the sag."""
    shutters = {"shutters": {"Hann": shutter_to_dict(HannShutter())}}
    for velocity, word in ((0.0, "stroke"), (-200.0, "sag")):
        point = xarray.Dataset(
            {},
            {"shutter": "Hann", "half_exposure": 0.004, "acceleration": 5e5, "velocity": velocity},
        )
        axes = new_figure(4.0, 3.0).subplots()
        dataset = xarray.Dataset(attrs={"sweep": json.dumps(shutters)})
        _draw_profile(axes, dataset, point, "B")
        assert axes.get_title() == f"B: Hann\n8 px {word}"
        time, passed = axes.get_lines()[0].get_data()
        np.testing.assert_allclose(time[[0, -1]], [-4.0, 4.0])
        np.testing.assert_allclose(passed[1:-1], HannShutter().transmittance(time[1:-1] / 4))


def test_pictures_are_shrunk_by_means_and_names_in_the_middle():
    """Of whole squares; a short name stays, whose underscore and dollar are letters."""
    picture = np.arange(5 * 7 * 2.0).reshape(5, 7, 2)
    wanted = [
        [picture[2 * a : 2 * a + 2, 2 * b : 2 * b + 2].mean((0, 1)) for b in range(3)]
        for a in range(2)
    ]
    np.testing.assert_allclose(_shrunk(picture, 2), wanted)
    assert _shrunk(picture, 6) is picture
    assert shown_name("abcdefghijkl", 10) == "abcd…hijkl"
    assert shown_name("abcdefghij", 10) == "abcdefghij"
    assert shown_name("_a$b") == r" _a\$b"


def test_a_fit_shows_levels_residuals_and_both_profiles():
    """Of pictures of unlike noise; residuals are over the noise."""
    random = np.random.default_rng(3)
    expected = [random.uniform(0.2, 0.8, n) for n in (17, 17)]
    noise = [np.full(17, 0.02), np.linspace(0.01, 0.03, 17)]
    levels = [e + n * random.normal(size=n.size) for e, n in zip(expected, noise, strict=True)]
    motion = ParabolicMotion(acceleration=2e5, half_exposure=0.007)
    spline = SplineShutter([0.2, 0.7, 0.9, 1.0, 0.4])
    none = {"lens_blur_px": Fitted(0.3, 0.1)}
    camera = FittedCamera(
        motion,
        spline,
        np.array([0.2, 0.7, 0.9, 1.0, 0.4]),
        np.full(5, 0.05),
        none,
        (),
        ("a", "b"),
        tuple(levels),
        tuple(expected),
        tuple(noise),
        31.0,
        7,
    )
    *pictures, bottom = plot_fit(camera, HannShutter()).axes
    for k in range(2):
        left, right = pictures[2 * k : 2 * k + 2]
        recorded, fitted = left.get_lines()
        np.testing.assert_array_equal(recorded.get_ydata(), levels[k])
        np.testing.assert_array_equal(fitted.get_ydata(), expected[k])
        residual = (levels[k] - expected[k]) / noise[k]
        np.testing.assert_allclose(right.get_lines()[0].get_ydata(), residual)
        assert left.get_ylabel() == f"{k}: level"
    assert pictures[1].get_title() == f"residuals: chi squared {31 / 27:.3g} for each free level"
    assert [axes.get_xlabel() for axes in pictures] == ["", "", "column / px", "column / px"]
    built, sent = bottom.get_lines()
    np.testing.assert_allclose(built.get_xdata()[[0, -1]], [-7.0, 7.0])
    tau = built.get_xdata() / 7
    np.testing.assert_allclose(built.get_ydata(), spline.transmittance(tau), atol=1e-9)
    np.testing.assert_allclose(sent.get_ydata(), HannShutter().transmittance(tau), atol=1e-9)
    low, high = camera.band(tau)
    ends = bottom.collections[0].get_paths()[0].get_extents()
    assert (ends.y0, ends.y1) == pytest.approx((np.min(low), np.max(high)))


def noise_with(**others):
    count = 64
    mean = np.linspace(300.0, 2900.0, count)
    blocks = Blocks(mean, 20 + 0.5 * mean, mean, 0 * mean, mean > 0, np.arange(count), (1, 8, 8))
    law = Law(20.0, 0.5, 10.0)
    transfer = Transfer.__new__(Transfer)
    for name, value in {"blocks": blocks, "law": law}.items():
        object.__setattr__(transfer, name, value)
    given = {
        "electrons_at_white": Estimate(8000.0, 120.0),
        "read_noise": Estimate(4.5, 0.3),
        "read_noise_range": None,
        "black": Estimate(256.0, 0.5),
        "black_range": (256.0, 256.0),
        "gain": Estimate(0.5, 0.01),
        "law": law,
        "transfer": transfer,
        "refusals": (),
        "sources": ("", "", ""),
    }
    return Noise(**(given | others))


def measurement_with(noise, labels=None, objects=(), **others):
    shape = (60, 90)
    labels = np.zeros(shape, int) if labels is None else labels
    frames = np.full((3, *shape), 1000.0, np.float32)
    clip = Clip(frames, 50.0, 0.004, 4095.0, 1.0, (0.0, 4095.0))
    given = {"share_at_rest": 0.7, "share_unexplained": 0.0}
    motion = Motion(
        tuple(objects),
        labels,
        np.full(shape, 0.9),
        1,
        width=(9.0, 9.0),
        num_frames=3,
        **(given | others),
    )
    light = np.full((*shape, 1), 0.3)
    return Measurement("clip", clip, noise, motion, light, Estimate(0.0, 0.1), None, None)


def test_noise_is_drawn_with_its_line_and_its_black():
    """Blocks with two standard errors; without a level of black the range where it lies."""
    found = measurement_with(noise_with())
    (axes,) = plot_noise(found).axes
    level, variance, error, _ = found.noise.transfer.curve()
    bars = axes.containers[0]
    np.testing.assert_allclose(bars[0].get_data(), [level, variance])
    ends = np.array([each[:, 1] for each in bars[2][0].get_segments()])
    np.testing.assert_allclose(ends, np.stack([variance - 2 * error, variance + 2 * error], 1))
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert set(labels) == {"blocks at rest", "line, 0.5 levels an electron", "black, 256"}
    lines = {line.get_label(): line for line in axes.get_lines()}
    x, y = lines["line, 0.5 levels an electron"].get_data()
    assert (x[0], x[-1]) == pytest.approx((256, level.max() * 1.03))
    np.testing.assert_allclose(y, 20 + 0.5 * x)
    known = "Photon transfer: 8000 +- 1.2e+02 e- at white, read noise 4.5 +- 0.3 e-"
    assert axes.get_title() == known
    bare = noise_with(
        black=None, black_range=(200.0, 300.0), read_noise_range=(3.0, 6.0), gain=None
    )
    (axes,) = plot_noise(measurement_with(bare)).axes
    assert axes.get_title().endswith("at white, read noise 3 to 6 e-")
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert set(labels) == {"blocks at rest", "line", "black lies here"}
    refusal = Refusal("electrons", "the noise does not rise", "Record raw.")
    for noise, ending in (
        (noise_with(read_noise=None), "read noise not known"),
        (
            noise_with(electrons_at_white=None, refusals=(refusal,)),
            "because the noise does not rise",
        ),
        (noise_with(transfer=None), "too little stands still"),
    ):
        assert plot_noise(measurement_with(noise)).axes[0].get_title().endswith(ending)


def test_objects_are_drawn_with_arrows_along_their_velocities():
    """From the middle of each, as long as it is fast; where nothing is explained all is grey."""
    labels = np.zeros((60, 90), int)
    labels[10:20, 10:40], labels[30:50, 50:80], labels[:5, 80:] = 1, 2, -1
    parts = {"area": 300, "lead": 9.0, "residual": 1.0, "frame": 1}
    objects = [
        MovingObject((30.0, -40.0), (1.0, 2.0), (14.5, 24.5), **parts),
        MovingObject((-3.0, 4.0), (1.0, 2.0), (39.5, 64.5), **parts),
        MovingObject((90.0, 90.0), (1.0, 2.0), (0.0, 0.0), **parts),  # seen in another frame
    ]
    found = measurement_with(noise_with(), labels, objects, share_unexplained=0.031)
    left, right, _ = plot_motion(found).axes
    title = "frame 2: 70% at rest, 3.1% without a velocity (grey); arrows in px/s"
    assert left.get_title() == title
    arrows, texts = left.texts[::2], left.texts[1::2]
    assert [text.get_text() for text in texts] == ["1: 50 +- 2", "2: 5 +- 2"]
    # The faster goes a fifth of the shorter side, and the slow one at least 6 %.
    for arrow, text, each, length in zip(arrows, texts, objects, (12.0, 3.6), strict=False):
        down, across = np.array(each.velocity) / np.hypot(*each.velocity) * length
        row, column = each.centre
        assert text.xy == pytest.approx((column, row))
        assert text.get_va() == ("bottom" if down > 0 else "top")
        assert np.sign(text.xyann[1]) == (1 if down > 0 else -1)
        assert arrow.xyann == pytest.approx((column, row))
        assert arrow.xy == pytest.approx((column + across, row + down))
    shown = left.images[0].get_array()
    plain = shown[55, 5]
    np.testing.assert_allclose(shown[2, 85], 0.5 * plain + 0.25)
    np.testing.assert_allclose(shown[10, 20], [0xD5 / 255, 0x5E / 255, 0])  # an edge
    pale = 0.55 * plain + 0.45 * np.array([0, 0x72 / 255, 0xB2 / 255])
    np.testing.assert_allclose(shown[40, 65], pale)
    np.testing.assert_allclose(plain, 1)  # the brightest 0.5 % are white
    np.testing.assert_array_equal(right.images[0].get_array(), found.motion.trust)
