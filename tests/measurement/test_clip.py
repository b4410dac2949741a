"""Frames as files hold them, and files that hold no clip: each is refused in a line."""

import re
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image

import mishutter as ms
from mishutter.measurement.clip import clip_of, cut_off, read_levels_of

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
