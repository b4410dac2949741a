"""Frames as files hold them, and files that hold no clip: each is refused in a line."""

import re
import struct
import zlib
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image

import mishutter as ms
from mishutter.measurement.clip import Levels, _gaps, clip_of, cut_off, read_levels_of
from mishutter.measurement.noise import require_others
from mishutter.pictures.images import PictureWarning, read_captures

RNG = np.random.default_rng(4)
FRAMES = RNG.integers(70, 900, (3, 51, 62)).astype(np.uint16)
GIVEN = {"frames_per_s": 47.0, "exposure": 3e-3, "white": None}


def a_clip(source, **others):
    return clip_of(source, **GIVEN | others)


def test_every_format_holds_the_same_levels(tmp_path):
    """Pages of a TIFF, PNGs and PGMs in the order of their names, and an array are one clip."""
    tifffile.imwrite(tmp_path / "a.tif", FRAMES, photometric="minisblack", compression="zlib")
    np.save(tmp_path / "a.npy", FRAMES)
    for kind in ("png", "pgm"):
        (tmp_path / kind).mkdir()
        for k, frame in enumerate(FRAMES):
            Image.fromarray(frame).save(tmp_path / kind / f"{k}.{kind}")
    sources = [tmp_path / name for name in ("a.tif", "a.npy", "png", "pgm")]
    for source in (FRAMES, *sources, str(sources[0]), sorted((tmp_path / "png").iterdir())):
        clip = a_clip(source)
        np.testing.assert_array_equal(clip.frames, FRAMES)
        assert (clip.white, clip.step) == (1023.0, 1.0)


def test_levels_in_the_upper_bits_have_a_step():
    """12 bits that a camera stores in the upper ones of 16 lie 16 levels apart."""
    assert a_clip(FRAMES * 16, white=65535.0).step == 16
    assert a_clip(FRAMES.astype(np.float32) + 0.25).step == 0


def test_colours_are_measured_by_their_green(tmp_path):
    """And that is said; three equal channels are grey."""
    for name, shifts in (("colour", (0, 7, 11)), ("grey", (0, 0, 0))):
        colours = np.stack([FRAMES + shift for shift in shifts], axis=-1)
        tifffile.imwrite(tmp_path / f"{name}.tif", colours, photometric="rgb")
    clip = a_clip(tmp_path / "colour.tif")
    np.testing.assert_array_equal(clip.frames, FRAMES + 7)
    assert "green" in clip.words[0]
    assert not any("green" in word for word in a_clip(tmp_path / "grey.tif").words)


def test_a_long_clip_is_read_in_part(tmp_path):
    """Its first 64 frames, which is said, whichever way they are stored."""
    long = RNG.integers(70, 900, (67, 48, 49)).astype(np.uint16)
    tifffile.imwrite(tmp_path / "long.tif", long, photometric="minisblack")
    for source in (long, tmp_path / "long.tif"):
        clip = a_clip(source)
        assert clip.num_frames == 64
        assert "the first 64 frames are read" in clip.words


def test_piles_at_the_ends_are_cut_off():
    """Level 0 and the greatest, where more pixels lie than noise would bring there."""
    frames = np.clip(RNG.normal(30, 40, (2, 60, 70)), 0, 55).round().astype(np.float32)
    assert cut_off(frames, 1.0) == (0.0, 55.0)
    assert cut_off(np.clip(frames, 3, None) + 1, 1.0)[0] == -np.inf
    whole = RNG.normal(900, 40, (2, 60, 70)).round().astype(np.float32)
    assert cut_off(whole, 1.0) == (-np.inf, np.inf)


def as_files(folder, frames, numbers):
    for frame, number in zip(frames, numbers, strict=True):
        tifffile.imwrite(folder / f"run7_{number}.tif", frame, photometric="minisblack")
    return sorted(folder.iterdir())


def test_files_are_in_the_order_of_their_numbers(tmp_path):
    """Of a folder, and as a shell lists them, 10 before 2; a list of another order is kept."""
    frames = RNG.integers(70, 900, (11, 50, 52)).astype(np.uint16)
    listed = as_files(tmp_path, frames, range(3, 14))
    assert listed[0].name == "run7_10.tif"
    for source in (tmp_path, listed):
        clip = a_clip(source)
        np.testing.assert_array_equal(clip.frames, frames)
        assert not any("names" in word for word in clip.words)
    np.testing.assert_array_equal(a_clip(listed[::-1]).frames[-1], frames[7])


def test_a_number_that_is_missing_is_said(tmp_path):
    """With the files on either side; numbers in steps of 20 are not missing."""
    frames = RNG.integers(70, 900, (6, 50, 52)).astype(np.uint16)
    as_files(tmp_path, frames, (8, 9, 10, 12, 13, 14))
    (word,) = (word for word in a_clip(tmp_path).words if "names" in word)
    assert "after 'run7_10.tif', before 'run7_12.tif'" in word
    (tmp_path / "steps").mkdir()
    as_files(tmp_path / "steps", frames, (80, 100, 121, 140, 160, 181))
    assert not any("names" in word for word in a_clip(tmp_path / "steps").words)


CHANNELS = RNG.integers(70, 900, (3, 2, 50, 52)).astype(np.uint16)
AXES = {
    "channels of an OME-TIFF": (
        "a.ome.tif",
        CHANNELS,
        {"metadata": {"axes": "TCYX"}},
        "first of C",
    ),
    "depths of an OME-TIFF": ("a.ome.tif", CHANNELS, {"metadata": {"axes": "TZYX"}}, "of Z is"),
    "channels of ImageJ": (
        "a.tif",
        CHANNELS,
        {"imagej": True, "metadata": {"axes": "TCYX"}},
        "3 x 2 x 50 x 52: the first of C is taken",
    ),
    "frames that are called channels": (
        "a.tif",
        CHANNELS[:, 0],
        {"imagej": True},
        "channels (C) are taken for times",
    ),
    "more than 4 GB of ImageJ": (
        "a.tif",
        CHANNELS,
        {"imagej": True, "truncate": True, "metadata": {"axes": "TCYX"}},
        "first of C",
    ),
    "axes without a name": ("a.tif", CHANNELS, {"photometric": "minisblack"}, "first of Q"),
}


@pytest.mark.parametrize("slug", AXES)
def test_frames_follow_each_other_in_time(slug, tmp_path):
    """By the axes that a file states: of channels and depths the first is taken, which is said.

    ImageJ describes the first frame of a file of more than 4 GB alone. Captures to be restored are
    those that a clip is measured by.
    """
    name, frames, settings, words = AXES[slug]
    tifffile.imwrite(tmp_path / name, frames, **settings)
    clip = a_clip(tmp_path / name)
    np.testing.assert_array_equal(clip.frames, CHANNELS[:, 0])
    assert any(words in word for word in clip.words)
    with pytest.warns(PictureWarning, match=re.escape(words)):
        captures = read_captures(tmp_path / name, white=65535.0, linear=True)
    light = np.stack([each.light[..., 0] for each in captures])
    np.testing.assert_allclose(light * 65535, CHANNELS[:, 0], rtol=1e-6)


def test_channels_of_one_time_are_no_clip(tmp_path):
    """The line names the axes of the file."""
    tifffile.imwrite(tmp_path / "a.ome.tif", CHANNELS[0], metadata={"axes": "CYX"})
    with pytest.raises(ValueError, match=r"its axes CYX are channels \(C\) of one time"):
        a_clip(tmp_path / "a.ome.tif")


@pytest.mark.parametrize("kind", [np.int16, np.int32, np.uint32])
def test_whole_numbers_of_other_kinds_are_read(kind, tmp_path):
    """From TIFFs and arrays, below 0 too, where black was taken off."""
    levels = FRAMES.astype(kind) - (100 if kind != np.uint32 else 0)
    tifffile.imwrite(tmp_path / "a.tif", levels, photometric="minisblack")
    for source in (levels, tmp_path / "a.tif"):
        clip = a_clip(source)
        np.testing.assert_array_equal(clip.frames, levels)
        assert clip.white == 1023


@pytest.mark.parametrize("rows", [slice(None), slice(20, None)])
@pytest.mark.parametrize("level", [0, 900])
def test_a_frame_that_was_lost_is_named(rows, level):
    """All of it, or the rows that did not arrive; rows that are so in all frames are no sign."""
    frames = RNG.integers(70, 900, (5, 51, 62)).astype(np.uint16)
    stuck = frames.copy()
    stuck[:, rows][:, :20] = level
    a_clip(stuck)
    frames[3, rows] = level
    with pytest.raises(ValueError, match=r"got frame 4, in which \d+ of 51 rows hold one level"):
        a_clip(frames)


def jpeg(path):
    Image.fromarray(FRAMES[0].astype(np.uint8)).save(path / "a.jpg", quality=95)
    return path / "a.jpg"


def webp(path):
    Image.fromarray(FRAMES[0].astype(np.uint8)).save(path / "a.webp")
    return path / "a.webp"


def video(path):
    (path / "a.mp4").write_bytes(b"\0\0\0\x20ftypisom" + bytes(40))
    return path / "a.mp4"


def jpeg_in_tiff(path):
    tifffile.imwrite(
        path / "a.tif", FRAMES.astype(np.uint8), compression="jpeg", photometric="minisblack"
    )
    return path / "a.tif"


def sizes(path):
    for k, frame in enumerate((FRAMES[0], FRAMES[1, :50])):
        Image.fromarray(frame).save(path / f"{k}.png")
    return path


def not_finite(path):
    frames = FRAMES.astype(np.float32)
    frames[1, 3, 4] = np.nan
    return frames


def repeated(path):
    return FRAMES[[0, 1, 1]]


REFUSED = {
    "a JPEG": (jpeg, "be uncompressed frames, as PNG, TIFF, PGM or .npy; got a JPEG"),
    "a WebP": (webp, "got a WebP"),
    "a video": (video, "got a video"),
    "a TIFF of JPEGs": (jpeg_in_tiff, "got a TIFF compressed by JPEG"),
    "several sizes": (sizes, "hold frames of one size, 51 x 62; got 50 x 62"),
    "a NaN": (not_finite, "hold finite levels; got NaN or an infinity in frame 2"),
    "a frame again": (repeated, "got frame 3 equal to the one before it"),
    "one frame": (lambda _: FRAMES[:1], "hold at least 2 frames"),
    "tiny frames": (lambda _: FRAMES[:, :40], "have at least 48 rows and columns; got '40 x 62'"),
    "a row": (lambda _: FRAMES[0, 0], "be of shape (frames, rows, columns)"),
    "words": (lambda _: np.array([["a"]]), "hold whole or floating-point levels"),
    "32 bits": (lambda _: FRAMES.astype(np.int64) * 99999, "hold levels of 8 to 16 bits"),
    "an empty folder": (lambda path: path, "name a folder of frames"),
    "no files": (lambda _: [], "name a file; got none"),
}


@pytest.mark.parametrize("slug", REFUSED)
def test_what_is_no_clip_is_refused(slug, tmp_path):
    """With what must hold, and what came."""
    source, line = REFUSED[slug]
    with pytest.raises(ValueError, match=re.escape(line)):
        a_clip(source(tmp_path))


def test_a_missing_file_is_named():
    """As other commands name it."""
    with pytest.raises(FileNotFoundError, match=r"nowhere.tif', not found"):
        read_levels_of("nowhere.tif", "measure(clip=...)")


@pytest.mark.parametrize(
    ("given", "line"),
    [
        ({"frames_per_s": 0.0}, "measure(frames_per_s=...)` must be a number above 0"),
        ({"exposure": 0.03}, "be above 0 and at most the 0.0212766 s from frame to frame"),
        ({"white": -5.0}, "measure(white=...)` must be a number above 0"),
    ],
)
def test_numbers_out_of_range_are_refused(given, line):
    """Each by its name."""
    with pytest.raises(ValueError, match=re.escape(line)):
        a_clip(FRAMES, **given)


@pytest.mark.parametrize(
    ("given", "line"),
    [
        ({"dark": FRAMES[:, :50]}, "measure(dark=...)` must have the size of the clip, 51 x 62"),
        ({"flats": FRAMES}, "measure(flats=...)` must be pairs of flat fields"),
        ({"black": 2000.0}, "measure(black=...)` must be below white, 1023"),
        ({"pixel_pitch": -1e-6}, "View(pixel_pitch=...)"),
    ],
)
def test_what_does_not_go_with_the_clip_is_refused(given, line):
    """Before anything is measured."""
    with pytest.raises(ValueError, match=re.escape(line)):
        ms.measure(FRAMES, frames_per_s=47.0, **given)


LIT = np.linspace(100, 900, 62)
BLACK = 64 + 3 * np.random.default_rng(8).standard_normal((51, 62))
NO_DARK = {
    "as bright as the clip": (np.full((51, 62), 500.0), "at most at the"),
    "a dim picture": (BLACK + 0.15 * LIT, "its parts differ by"),
}


@pytest.mark.parametrize("slug", NO_DARK)
def test_a_dark_frame_is_of_a_covered_lens(slug):
    """Its level is that of dark parts of the clip, and it has no structure; noise and glow pass."""
    frames = BLACK + LIT * np.array([1.0, 1.01])[:, None, None]
    clip = clip_of(np.rint(frames).astype(np.uint16), 47.0, None, 1023.0)
    glow = BLACK + 6 * np.linspace(0, 1, 62) ** 4
    glow[3, 5] = 1000
    frame, line = NO_DARK[slug]
    for dark in (BLACK, glow, np.zeros_like(BLACK)):
        require_others(clip, {"dark": Levels(dark[None].astype(np.float32), 1023.0, True)}, None)
    both = Levels(np.stack([BLACK, frame]).astype(np.float32), 1023.0, True)
    with pytest.raises(ValueError, match=rf"`measure\(dark=...\)` must be of a .*{line}.* frame 2"):
        require_others(clip, {"dark": both}, None)


def test_files_of_other_kinds_do_not_go_together(tmp_path):
    """A photograph in colour, or of 8 bits, is no dark frame of a clip, nor a frame of it."""
    rng = np.random.default_rng(4)
    pixels = {"a": (51, 62), "b": (51, 62), "colour": (51, 62, 3)}
    for name, shape in pixels.items():
        Image.fromarray(rng.integers(0, 255, shape).astype(np.uint8)).save(tmp_path / f"{name}.png")
    Image.fromarray(rng.integers(0, 4000, (51, 62)).astype(np.uint16)).save(tmp_path / "deep.png")
    both = [tmp_path / "a.png", tmp_path / "b.png"]
    for name, kind in (("colour", "8-bit colour"), ("deep", "16-bit grey")):
        odd = tmp_path / f"{name}.png"
        line = rf"hold frames of one kind, 8-bit grey; got {kind} in "
        with pytest.raises(ValueError, match=line):
            clip_of([*both, odd], 47.0, None, None)
        line = rf"measure\(dark=...\)` must be 8-bit grey as the clip is; got {kind}"
        with pytest.raises(ValueError, match=line):
            ms.measure(both, frames_per_s=47.0, dark=odd)


def test_black_is_checked_before_the_noise_is_measured(monkeypatch):
    """And before frames are registered."""
    monkeypatch.setattr("mishutter.measurement.measurement.registered", None)
    with pytest.raises(ValueError, match=r"measure\(black=...\)` must be below white, 1023"):
        ms.measure(FRAMES, frames_per_s=47.0, black=70000.0)


SHIPPED = {
    "no_time_for_that_tiny.gif": "got a video",
    "multipage.tif": "must have at least 48 rows and columns; got '15 x 10'",
    "lfw_subset.npy": "must have at least 48 rows and columns; got '25 x 25'",
}


@pytest.mark.parametrize("name", SHIPPED)
def test_stacks_that_scikit_image_ships_are_refused(name):
    """Real ones: a video, and two that are smaller than a tile."""
    folder = Path(find_spec("skimage").origin).parent / "data"
    with pytest.raises(ValueError, match=re.escape(SHIPPED[name])):
        clip_of(folder / name, 50.0, None, None)


def test_a_folder_of_many_files_is_read_in_part(tmp_path):
    """Its first 64 files, which is said; two stacks tell it as well, and no more than once."""
    frames = RNG.integers(70, 900, (66, 48, 49)).astype(np.uint16)
    for k, frame in enumerate(frames):
        (tmp_path / f"{k:03d}.pgm").write_bytes(b"P5 49 48 65535\n" + frame.astype(">u2").tobytes())
    clip = a_clip(tmp_path)
    np.testing.assert_array_equal(clip.frames, frames[:64])
    assert clip.words.count("the first 64 frames are read") == 1
    few = a_clip(sorted(tmp_path.iterdir())[:64])
    assert not any("first" in word for word in few.words)


def test_a_power_that_files_state_is_doubted(tmp_path):
    """Of light that follows from levels otherwise than by a line; the noise decides."""
    for k, frame in enumerate(FRAMES):
        chunks = Image.fromarray(frame)
        chunks.save(tmp_path / f"{k}.png", gamma=1 / 1.8)
        content = (tmp_path / f"{k}.png").read_bytes()
        name = b"gAMA" + struct.pack(">I", 55_556)
        own = struct.pack(">I", 4) + name + struct.pack(">I", zlib.crc32(name))
        (tmp_path / f"{k}.png").write_bytes(content[:33] + own + content[33:])
    clip = a_clip(tmp_path)
    assert any("light is the power 1.8 of their levels" in word for word in clip.words)
    np.testing.assert_array_equal(clip.frames, FRAMES)


@pytest.mark.parametrize(
    ("numbers", "is_gap"),
    [
        ((3, 4, 5, 7, 8), True),
        ((3, 4, 6, 8, 10), False),  # as many wide steps as not
        ((3, 5, 6, 4, 7), False),
        ((3, 4), False),
    ],
)
def test_a_gap_is_a_step_that_is_wider_than_most(numbers, is_gap):
    """Where numbers ascend, and more than two files tell what is usual."""
    names = [Path(f"take2_{number:02d}.tif") for number in numbers]
    assert bool(_gaps(names)) == is_gap
    others = [Path(f"take{k}_{number:02d}.tif") for k, number in enumerate(numbers)]
    assert _gaps(others) == []


def test_an_exposure_is_no_longer_than_the_frame():
    """But for the rounding of a period; without one it may be all of that."""
    assert a_clip(FRAMES, exposure=1.009 / 47).longest_exposure == 1.009 / 47
    assert a_clip(FRAMES, exposure=None).longest_exposure == 1 / 47
    with pytest.raises(ValueError, match="be above 0 and at most"):
        a_clip(FRAMES, exposure=1.02 / 47)


@pytest.mark.parametrize(("most", "white"), [(255, 255), (256, 1023), (4095, 4095), (16383, 16383)])
def test_white_is_that_of_the_fewest_bits(most, white):
    """Of 8, 10, 12 or 14 in 16, beyond which it is that of the file."""
    frames = np.minimum(FRAMES, 200)
    frames[1, 7, 9] = most
    assert a_clip(frames).white == white
    assert any(f"taken for {white}" in word for word in a_clip(frames).words)
    frames[1, 7, 9] = 16384
    assert a_clip(frames).white == 65535
    assert a_clip(np.minimum(frames, 200).astype(np.uint8)).white == 255


@pytest.mark.parametrize("scheme", [1, 5, 8, 32773, 32946, 34925, 50000])
def test_compressions_that_keep_every_level_are_read(scheme, tmp_path):
    """By TIFF's numbers: none, LZW, Deflate's two, PackBits, LZMA and Zstandard."""
    tifffile.imwrite(
        tmp_path / "a.tif", FRAMES.astype(np.uint8), compression=scheme, photometric="minisblack"
    )
    np.testing.assert_array_equal(a_clip(tmp_path / "a.tif").frames, FRAMES.astype(np.uint8))
