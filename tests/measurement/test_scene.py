"""The scene file of a clip: numbers with errors and sources, and what a clip does not tell."""

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage
from support.clips import ClipOf, Thing

import mishutter as ms
from mishutter.cli import measure_command
from mishutter.measurement.motion import Motion, MovingObject
from mishutter.measurement.photon_transfer import Law
from mishutter.measurement.scene import along_axis
from mishutter.measurement.texture import Averaged, is_empty, light_of_texture
from mishutter.pictures.images import row_power_spectrum

CLIP = ClipOf(
    (
        Thing((70, 90), (38, 46), (12.0, 310.0)),
        Thing((125, 160), (40, 36), (-9.0, -265.0), "chelsea.png"),
    ),
    size=(192, 240),
    background="astronaut.png",
    num_frames=5,
)
TOLD = {"frames_per_s": 50.0, "exposure": 4e-3, "white": float(CLIP.full)}


@pytest.fixture(scope="module")
def measurement():
    return ms.measure(CLIP.levels(), dark=CLIP.dark(), pixel_pitch=3.2e-6, px_per_mm=6.0, **TOLD)


def test_the_file_is_the_scene(measurement, tmp_path):
    """Written and read again, it is that of `scene`, with its picture beside it."""
    files = measurement.save(tmp_path / "found.toml")
    assert files == ["found.toml", "picture.png", "velocities.csv"]
    read, held = ms.Scene.load(tmp_path / "found.toml"), measurement.scene
    for name in ("speeds", "photon_rate", "read_noise"):
        np.testing.assert_array_equal(getattr(read, name), getattr(held, name))
    assert float(read.picture.deviation) == pytest.approx(float(held.picture.deviation), rel=1e-3)
    assert float(read.photon_rate) == pytest.approx(3000 / 4e-3, rel=0.05)
    assert float(read.read_noise) == pytest.approx(4, rel=0.1)
    assert float(np.max(read.speeds)) == pytest.approx(310, abs=4)
    assert float(read.occlusion.front_share) == pytest.approx(0.22, abs=0.06)
    lines = (tmp_path / "velocities.csv").read_text(encoding="utf-8").splitlines()
    assert len(lines) == 1 + len(measurement.motion.objects) == 3
    assert lines[0].startswith("object,right_px_per_s,right_error_px_per_s,down_px_per_s")


def test_each_number_has_its_error_and_source(measurement):
    """In the line of the file that has it; the head lists what is assumed."""
    lines = measurement.scene_text.splitlines()
    for key, words in (
        ("photon_rate_per_s", ("+-", "e- at white in 4 ms", "photon transfer over 5 frames")),
        ("read_noise_e", ("+-", "2 dark frames")),
        ("front_share", ("+-",)),
        ("frames_per_s", ("as given",)),
        ("pixel_pitch_um = 3.2", ("as given",)),
        ("px_per_mm = 6", ("mm/s",)),
    ):
        (line,) = (each for each in lines if each.startswith(key) and "#" in each)
        assert all(word in line for word in words), line
    assert any("Assumed, not measured: [limits]" in line for line in lines)
    assert any(line.startswith("# Electrons are effective") for line in lines)
    assert sum(line.startswith("# object ") for line in lines) == 2


def test_without_an_exposure_the_light_is_a_lower_limit():
    """Of the whole time between frames, which the file says."""
    still = replace(CLIP, things=())
    told = {"frames_per_s": 50, "white": CLIP.full, "px_per_mm": 6}
    found = ms.measure(still.levels(), black=still.black_level, **told)
    assert float(found.scene.photon_rate) == pytest.approx(3000 * 50, rel=0.06)
    assert "A LOWER LIMIT" in found.scene_text
    assert tomllib.loads(found.scene_text)["speeds"] == {"list_px_per_s": [0.0]}


@pytest.mark.parametrize("width", [1, 2])
def test_a_mosaic_of_colours_is_said(width):
    """Filters over single pixels or squares of four; the picture would hold them as texture."""
    still = replace(CLIP, things=(), size=(96, 110))
    told = {"frames_per_s": 50, "white": CLIP.full, "black": still.black_level}
    rows, columns = (index // width % 2 for index in np.indices(still.size))
    filters = np.where(rows == columns, np.where(rows == 0, 0.5, 0.6), 1.0)
    rng = np.random.default_rng(3)
    levels = np.stack([still.recorded(filters * still.exposed(0.0), rng) for _ in range(4)])
    assert any("mosaic" in word for word in ms.measure(levels, **told).clip.words)
    assert not any("mosaic" in word for word in ms.measure(still.levels(), **told).clip.words)


def test_what_is_not_known_is_a_commented_key():
    """With an example and the reason; the scene is refused in a line that says why."""
    eight = replace(CLIP, bits=8)
    coded = np.rint(255 * (eight.levels() / 255.0) ** (1 / 2.2)).astype(np.uint8)
    found = ms.measure(coded, frames_per_s=50.0)
    assert "# photon_rate_per_s = 1.0e5  # not known: " in found.scene_text
    assert "# read_noise_e = 4.0  # not known: " in found.scene_text
    assert found.missing == ("[light] photon_rate_per_s", "[sensor] read_noise_e")
    with pytest.raises(ValueError, match=r"have light and noise; got the noise is not known"):
        _ = found.scene
    assert found.to_dict()["noise"]["electrons_at_white"] is None


def an_object(right, down, area, error=1.0):
    velocity = float(down), float(right)
    return MovingObject(velocity, (error, error), (50.0, 60.0), area, 9.0, 1.0, 2)


def test_speeds_end_at_the_fast_quantile_by_area():
    """A speck that is faster does not count; both ways make speeds of either sign."""
    objects = [an_object(-700, 5, 9000), an_object(410, -8, 3000), an_object(-3000, 0, 90)]
    along = along_axis(objects)
    assert (along.axis, along.speeds) == ("rows", (-700, 700))
    one_way = along_axis([an_object(-700, 5, 9000), an_object(-410, -8, 3000)])
    assert one_way.speeds == (410, 700)
    assert along_axis([]) is None


def test_things_that_go_up_have_a_positive_speed():
    """Along the columns, as scenes have it."""
    along = along_axis([an_object(8, -350, 5000), an_object(-3, -120, 4000)])
    assert (along.axis, along.speeds) == ("columns", (120, 350))


def test_motion_across_the_axis_is_told_with_its_cost():
    """And the turn of the camera that leaves less; beyond 30 % no one axis explains it."""
    slanted = along_axis([an_object(300, 60, 5000), an_object(-250, -50, 4000)])
    first, second = slanted.sentences
    assert "20% of the speed goes across the rows" in first
    assert "costs 0.9 dB" in first
    assert second == "A camera turned by 11 degrees clockwise has 0% across."
    crossed = along_axis([an_object(300, 20, 5000), an_object(-10, 280, 4000)])
    (only,) = crossed.sentences
    assert only.startswith("No one axis explains the motion: 93% of the speed goes across")
    straight = along_axis([an_object(300, 3, 5000)])
    assert straight.sentences[0].startswith("One axis explains the motion: 1%")


def test_the_picture_has_the_power_of_the_light():
    """Without the noise, and before the pixels that averaged it."""
    rng = np.random.default_rng(3)
    columns = 256
    frequency = np.fft.rfftfreq(columns)
    shape = 1 / (frequency + 0.03)
    rows = np.fft.irfft(np.fft.rfft(rng.normal(size=(200, columns))) * shape, columns)
    light = 0.5 + 0.09 * rows / rows.std()
    seen = np.fft.irfft(np.fft.rfft(light) * np.sinc(frequency), columns)
    law = Law(dark=400.0, gain=0.0, floor=1.0)
    levels = 40 + 1000 * seen + 20 / np.sqrt(3) * rng.normal(size=light.shape)
    everywhere = np.ones(light.shape, bool)
    averaged = Averaged(levels, np.full(light.shape, 3.0))
    picture = light_of_texture(averaged, everywhere, law, (40.0, 1040.0), "rows")
    found, truth = (
        row_power_spectrum(ms.Picture(np.asarray(x)), 16).power_spectrum
        for x in (picture, light[..., None].astype(np.float32))
    )
    np.testing.assert_allclose(found[:14], truth[:14], rtol=0.15)


@pytest.mark.parametrize("axis", ["rows", "columns"])
def test_the_spectrum_is_that_of_the_still_parts(axis):
    """A smooth object over two fifths of the picture leaves it as it is, along either axis."""
    rng = np.random.default_rng(5)
    shape, sigma = (220, 260), 0.04
    light = 0.5 + sigma * rng.standard_normal(shape)
    at_rest = np.ones(shape, bool)
    at_rest[30:170, 40:210] = False
    light[~at_rest] = 0.6
    levels = 40 + 1000 * light
    law = Law(dark=1e-6, gain=0.0, floor=1e-7)
    picture = light_of_texture(Averaged(levels, np.ones(shape)), at_rest, law, (40.0, 1040.0), axis)
    seen = row_power_spectrum(ms.Picture(picture).transposed(axis), 16).power_spectrum
    pixels = np.sinc((np.arange(16) + 0.5) / 32) ** 2
    # The object's own line is in the first of them.
    np.testing.assert_allclose((seen * pixels)[2:14], sigma**2, rtol=0.2)


def of_motion(measurement, objects, share, labels):
    """The scene file with other objects, of which a share of the picture stands still."""
    motion = Motion(tuple(objects), labels, labels * 0.5, 2, share, 0.0, (61.0, 47.0), 5)
    return replace(measurement, motion=motion).scene_text


def two_labels():
    """Two objects, 50 px wide and 20 high, and 30 px wide and 44 high."""
    labels = np.zeros((192, 240), int)
    labels[20:40, 30:80] = 1
    labels[100:144, 90:120] = 2
    return labels


@pytest.mark.parametrize(
    ("velocities", "narrowest"), [(((-310, 3), (260, 5)), 30.0), (((4, 290), (-2, 240)), 20.0)]
)
def test_objects_that_fill_the_picture_are_registered_one_by_one(
    measurement, velocities, narrowest
):
    """By the width of the narrowest along the motion; before a background that is a comment."""
    objects = [an_object(*velocity, 3000) for velocity in velocities]
    tables = tomllib.loads(of_motion(measurement, objects, 0.04, two_labels()))
    assert tables["objects"] == {"width_px": narrowest}
    assert "occlusion" not in tables
    assert "front_share" not in tables["errors"]
    text = of_motion(measurement, objects, 0.7, two_labels())
    assert tomllib.loads(text)["occlusion"]["front_share"] == 0.3
    assert f"# width_px = {narrowest}  # of the narrowest" in text.splitlines()
    alone = tomllib.loads(of_motion(measurement, objects[:1], 0.04, two_labels()))
    assert not {"objects", "occlusion"} & set(alone)


def test_motion_in_any_direction_is_a_commented_key(measurement):
    """With the fast speed in whatever direction; the file runs as it is, along one axis."""
    objects = [an_object(300, 20, 5000), an_object(-180, 240, 4000)]
    text = of_motion(measurement, objects, 0.6, two_labels())
    assert "# any_direction = { max_px_per_s = 300.7 }" in text.splitlines()
    assert tomllib.loads(text)["speeds"]["uniform"]["max_px_per_s"] == 300.0
    straight = of_motion(measurement, [an_object(300, 9, 5000)], 0.6, two_labels())
    assert "any_direction" not in straight


def test_errors_stand_where_answers_read_them(measurement, tmp_path):
    """A section of the file, and a part of the scene, with the errors of the comments."""
    measurement.save(tmp_path / "found.toml")
    errors = ms.Scene.load(tmp_path / "found.toml").errors
    noise = measurement.noise
    electrons = noise.electrons_at_white
    assert float(errors.photon_rate) == pytest.approx(electrons.error / 4e-3, rel=0.05)
    assert float(errors.read_noise) == pytest.approx(noise.read_noise.error, rel=0.05)
    assert float(errors.speed) == pytest.approx(measurement.along.error, rel=0.05)
    assert float(errors.front_share) == 0.05


@pytest.mark.parametrize(
    ("level", "contrast", "expected"), [(0.01, 0.0, True), (0.01, 0.08, False), (0.2, 0.0, False)]
)
def test_a_background_is_empty_if_it_is_dark_and_shows_nothing(level, contrast, expected):
    """Beside a thing of 0.3 of white and a contrast of 0.1, in the noise of four frames."""
    random, shape = np.random.default_rng(8), (96, 128)
    rows, columns = np.indices(shape)
    thing = np.hypot(rows - 44, columns - 60) < 26
    detail = ndimage.gaussian_filter(random.normal(size=shape), 1.5)
    detail *= np.where(thing, 0.1, contrast) / detail.std()
    light = np.where(thing, 0.3, level) + detail
    levels = 50 + 1000 * light + 40 / 2 * random.normal(size=shape)
    law = Law(dark=1600.0, gain=0.0, floor=1.0)
    picture = Averaged(levels, np.full(shape, 4.0))
    assert is_empty(picture, ~thing, law, 50.0) is expected
    # Where all or nothing moves, there is nothing to compare.
    for at_rest in (np.ones(shape, bool), np.zeros(shape, bool)):
        assert not is_empty(picture, at_rest, law, 50.0)


def test_before_an_empty_background_the_scene_is_of_what_moves(measurement, monkeypatch):
    """Its things have their own width, and the picture their mean light."""
    monkeypatch.setattr("mishutter.measurement.measurement.is_empty", lambda *_: True)
    found = ms.measure(CLIP.levels(), dark=CLIP.dark(), **TOLD)
    assert found.scene.occlusion is None
    assert found.scene.errors.front_share == 0
    assert found.scene.objects.width == pytest.approx(66, abs=10)
    moves = found.motion.labels > 0
    black, white = found.noise.black_level, found.clip.white
    light = (np.mean(found.clip.frames[found.motion.frame][moves]) - black) / (white - black)
    assert found.light.mean() == pytest.approx(light, abs=0.02)
    assert abs(light - measurement.light.mean()) > 0.04


def unlike(down, right, area, error):
    """An object whose numbers all differ."""
    return MovingObject((down, right), error, (51.3, 97.6), area, 8.25, 1.17, 3)


@pytest.mark.parametrize("axis", ["rows", "columns"])
def test_the_file_and_the_tables_have_both_axes(measurement, axis, capsys):
    """Of an object known to 9 px/s down and 2 px/s across, and of one to 4 and 7."""
    first, second = (21.4, -308.9), (-35.6, 147.3)
    if axis == "columns":
        first, second = first[::-1], second[::-1]
    objects = [unlike(*first, 3021, (9.0, 2.0)), unlike(*second, 2018, (4.0, 7.0))]
    motion = Motion(tuple(objects), two_labels(), two_labels() * 0.5, 2, 0.7, 0.0, (61.0, 47.0), 5)
    found = replace(measurement, motion=motion)
    lines, tables = found.scene_text.splitlines(), tomllib.loads(found.scene_text)
    (down, right), error = first, 2.0 if axis == "rows" else 9.0
    assert (
        f"# object 1: {right:.1f} +- 2 px/s to the right, {down:.1f} +- 9 px/s down, 3021 px"
        in lines
    )
    sign = "left" if axis == "rows" else "up"
    said = f"# Along the {axis}, positive to the {sign}; the fast end is the 98 % quantile by area"
    assert f"{said}, +- {error:.2g} px/s." in lines
    assert tables["speeds"]["uniform"] == {
        "min_px_per_s": -308.9,
        "max_px_per_s": 308.9,
        "count": 9,
    }
    assert tables["errors"]["object_speed_px_per_s"] == error
    sensor = tables["sensor"]
    assert (sensor["axis"], sensor["width_px"]) == (axis, 240 if axis == "rows" else 192)
    assert tables["occlusion"]["object_width_px"] == (61.0 if axis == "rows" else 47.0)
    assert f"the fastest moves at {308.9 / 6:.4g} mm/s" in found.scene_text
    row = found.velocities_text.splitlines()[1]
    assert row == f"1,{right:g},2,{down:g},9,3021,8.25,1.17,3,97.6,51.3"
    (one, _) = found.to_dict()["objects"]
    assert one == {
        **{"right_px_per_s": right, "right_error_px_per_s": 2.0, "down_px_per_s": down},
        **{"down_error_px_per_s": 9.0, "area_px": 3021, "lead": 8.25, "residual": 1.17},
    }
    measure_command._print(found, Path("found.toml"))
    said = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["1", f"{right:.1f}", "2", f"{down:.1f}", "9", "3021", "1.17"] in said


def test_the_light_has_its_error_a_second(measurement):
    """Electrons of a frame over its exposure; what is brighter in front is above what is behind."""
    value, error = measurement.noise.electrons_at_white
    line = next(x for x in measurement.scene_text.splitlines() if x.startswith("photon_rate"))
    assert line.startswith(f"photon_rate_per_s = {value / 4e-3:.4g}  # +- {error / 4e-3:.2g}; ")
    still, moving = (measurement.motion.labels == 0, measurement.motion.labels > 0)
    light = np.mean(measurement.clip.frames[measurement.motion.frame][moving])
    light -= np.mean(measurement.clip.frames[measurement.motion.frame][still])
    wanted = light / (measurement.clip.white - measurement.noise.black_level)
    assert measurement.level_difference.value == pytest.approx(wanted, abs=0.01)


def test_a_speed_that_hardly_varies_is_one_speed(measurement):
    """Where its ends are within four errors of the faster; and no exposure goes 10,000 px."""
    objects = [unlike(3.0, -300_000.0, 3000, (9.0, 2.0)), unlike(3.0, -299_993.0, 3000, (4.0, 7.0))]
    tables = tomllib.loads(of_motion(measurement, objects, 0.7, two_labels()))
    assert tables["speeds"] == {"list_px_per_s": [300000.0]}
    assert tables["limits"]["max_exposure_ms"] == pytest.approx(1e4 / 300, rel=1e-3)
    objects[1] = replace(objects[1], velocity=(3.0, -299_991.0))
    text = of_motion(replace(measurement, pixel_pitch=None), objects, 0.7, two_labels())
    tables = tomllib.loads(text)
    assert tables["speeds"]["uniform"]["count"] == 9
    assert tables["limits"]["max_stroke_px"] == 45


@pytest.mark.parametrize("rows_read", ["down", "up"])
def test_a_sensor_that_reads_rows_in_turn_shows_its_own_velocities(
    measurement, rows_read, monkeypatch
):
    """By the time from one row to the next, of one less than there are."""
    motion = replace(
        measurement.motion,
        objects=tuple(replace(x, velocity=(900.0, 310.0)) for x in measurement.motion.objects),
    )
    monkeypatch.setattr("mishutter.measurement.measurement.motion_of", lambda *_: motion)
    found = ms.measure(CLIP.levels(), dark=CLIP.dark(), readout=9e-3, rows_read=rows_read, **TOLD)
    row = 9e-3 / 191 * (1 if rows_read == "down" else -1)
    for each in found.motion.objects:
        assert each.velocity == pytest.approx((900 / (1 + 900 * row), 310 / (1 + 900 * row)))


def test_what_leaves_an_axis_has_its_cost():
    """Of a design for none of it and of one for it, between those that are known."""
    (first, *_) = along_axis([an_object(300, 75, 5000), an_object(-300, 75, 5000)]).sentences
    assert "costs 1.3 dB of a moving sensor's gain, or 0.5 dB by a design for it" in first
    (only,) = along_axis([an_object(300, 14, 5000), an_object(-300, 14, 5000)]).sentences
    assert only == "One axis explains the motion: 5% of the speed goes across it."


@pytest.mark.parametrize(("scale", "offset"), [(1, 1900), (3, 0)])
def test_levels_of_another_black_or_another_step_are_the_same_camera(
    measurement, scale, offset, monkeypatch
):
    """Electrons, noise, light and its difference stay; the gain is in levels."""
    monkeypatch.setattr(
        "mishutter.measurement.measurement.motion_of", lambda *_: measurement.motion
    )
    levels, dark = (scale * each.astype(np.int32) + offset for each in (CLIP.levels(), CLIP.dark()))
    told = TOLD | {"white": float(scale * CLIP.full + offset)}
    found = ms.measure(levels, dark=dark, **told)
    for name in ("electrons_at_white", "read_noise"):
        assert getattr(found.noise, name) == pytest.approx(
            getattr(measurement.noise, name), rel=0.02
        )
    assert found.noise.gain.value == pytest.approx(scale * measurement.noise.gain.value, rel=0.01)
    assert found.noise.black.value == pytest.approx(
        scale * measurement.noise.black.value + offset, abs=0.01 * scale
    )
    assert found.level_difference == pytest.approx(measurement.level_difference, rel=0.01)
    np.testing.assert_allclose(found.light, measurement.light, atol=2e-3)


def test_a_clip_on_its_side_is_the_same_scene_on_its_side(measurement):
    """Its axis, velocities, errors, places and lengths are those of rows and columns exchanged."""
    frames, dark = (np.swapaxes(each, 1, 2) for each in (CLIP.levels(), CLIP.dark()))
    found = ms.measure(np.ascontiguousarray(frames), dark=np.ascontiguousarray(dark), **TOLD)
    assert (measurement.along.axis, found.along.axis) == ("rows", "columns")
    assert found.along.speeds == pytest.approx(measurement.along.speeds, rel=0.02)
    for own, other in zip(found.motion.objects, measurement.motion.objects, strict=True):
        assert own.velocity == pytest.approx(other.velocity[::-1], abs=4)
        assert own.error == pytest.approx(other.error[::-1], rel=0.3)
        assert own.centre == pytest.approx(other.centre[::-1], abs=2)
    assert found.motion.width == pytest.approx(measurement.motion.width[::-1], rel=0.1)
    assert np.mean(found.motion.labels.T == measurement.motion.labels) > 0.97
    assert found.noise.electrons_at_white.value == pytest.approx(
        measurement.noise.electrons_at_white.value, rel=0.02
    )
    np.testing.assert_allclose(found.light.mean(), measurement.light.mean(), rtol=0.02)
    for name in ("mean_level", "deviation"):
        numbers = [float(getattr(each.scene.picture, name)) for each in (found, measurement)]
        assert numbers[0] == pytest.approx(numbers[1], rel=0.03)


def test_findings_are_told_in_words(measurement):
    """Light and noise with their errors, what stands still and what has no velocity."""
    noise = measurement.noise
    motion = replace(measurement.motion, share_at_rest=0.756, share_unexplained=0.023)
    found = replace(measurement, motion=motion).sentences
    value, error = noise.electrons_at_white
    assert found[0] == f"White holds {value:.4g} +- {error:.2g} photo-electrons."
    value, error = noise.read_noise
    assert found[1] == f"The read noise is {value:.3g} +- {error:.2g} e-."
    assert found[2] == "76% of the picture stands still, and 2 objects move."
    assert found[3].startswith("2.3% of the picture changes without a velocity")
    alone = replace(motion, objects=motion.objects[:1], share_unexplained=0.004)
    assert replace(measurement, motion=alone).sentences[2].endswith("and 1 object moves.")
    unknown = replace(noise, read_noise_range=(1.25, 6.5))
    said = replace(measurement, noise=unknown).sentences[1]
    assert said == "The read noise lies from 1.2 to 6.5 e-: black is not known."
    still = replace(measurement, motion=replace(motion, objects=(), share_unexplained=0.0))
    assert still.sentences[2] == "Nothing was seen to move."
