"""The formats of pictures: each that is promised is read right, and any other refused by name.

Values are known before they are written, by libraries other than the reader where there are two.
"""

import re

import numpy as np
import pytest
from support.picture_files import COLOUR, DEEP_COLOUR, EIGHT, GREY, PROMISED, REFUSED, SIXTEEN

import mishutter as ms
from mishutter.pictures.files import PICTURE_FORMATS, PICTURE_SUFFIXES

# Pictures are compared as they were coded, by the transfer curve that reading inverts.
from mishutter.pictures.images import GAMMA, PictureWarning


def in_file(folder, suffix, write):
    path = folder / f"a{suffix}"
    write(path)
    return path


@pytest.mark.parametrize("slug", PROMISED)
def test_what_is_promised_is_read_right(slug, tmp_path):
    """Every format, depth and layout has its values over that of white, and its opacity."""
    shown = PROMISED[slug]
    read = ms.read_picture(in_file(tmp_path, shown.suffix, shown.write))
    coded = read.light if shown.linear else read.light ** (1 / GAMMA)
    np.testing.assert_allclose(coded, shown.coded, atol=shown.atol)
    assert (read.matte is None) == (shown.matte is None)
    if shown.matte is not None:
        np.testing.assert_allclose(read.matte, shown.matte, atol=1e-6)


def test_each_promised_suffix_has_a_file():
    """The list of formats and the files of it are one."""
    assert {shown.suffix for shown in PROMISED.values()} == set(PICTURE_SUFFIXES)


@pytest.mark.parametrize("slug", REFUSED)
def test_what_is_not_promised_is_refused_by_name(slug, tmp_path):
    """A file of another kind, and a kind of TIFF that would come out wrong, are named."""
    suffix, write, reason = REFUSED[slug]
    line = re.escape(f"must name a whole {PICTURE_FORMATS} picture") + ".*" + re.escape(reason)
    with pytest.raises(ValueError, match=line):
        ms.read_picture(in_file(tmp_path, suffix, write))


def thumbnail_and(write_whole, **options):
    """A TIFF that begins with a small picture, as raw files do, or with a mask."""
    import tifffile

    def write(path):
        with tifffile.TiffWriter(path) as file:
            file.write(COLOUR[::4, ::4], photometric="rgb", **options)
            write_whole(file)

    return write


def deep(file):
    file.write(DEEP_COLOUR, photometric="rgb")


def palette(file):
    colours = np.repeat(np.arange(256, dtype=np.uint16)[None], 3, axis=0) * 257
    file.write(GREY[..., 0], photometric="palette", colormap=colours)


@pytest.mark.parametrize(
    ("write", "coded"),
    [
        (thumbnail_and(deep, subfiletype=1), DEEP_COLOUR / 65535),
        (thumbnail_and(deep, subfiletype=1, subifds=1), DEEP_COLOUR / 65535),
        (thumbnail_and(deep, subfiletype=9), DEEP_COLOUR / 65535),
        (thumbnail_and(palette, subfiletype=1), np.repeat(GREY, 3, axis=-1) / 255),
    ],
)
def test_pages_that_are_no_whole_picture_are_passed_over(tmp_path, write, coded):
    """A page marked as reduced or as a mask is not the picture, also where others lie within it."""
    read = ms.read_picture(in_file(tmp_path, ".tif", write))
    np.testing.assert_allclose(read.light ** (1 / GAMMA), coded, atol=1e-6)


def test_a_palette_within_a_small_picture_is_refused(tmp_path):
    """Pillow alone reads palettes, but no page within another: none is read in its place."""
    write = thumbnail_and(palette, subfiletype=1, subifds=1)
    with pytest.raises(ValueError, match="whose picture lies within a page of another"):
        ms.read_picture(in_file(tmp_path, ".tif", write))


def test_the_first_of_several_pictures_is_read_with_a_warning(tmp_path):
    """Pages of equal standing are a choice that the reader says it has made."""
    import tifffile

    def write(path):
        with tifffile.TiffWriter(path) as file:
            file.write(COLOUR, photometric="rgb")
            deep(file)

    path = in_file(tmp_path, ".tif", write)
    with pytest.warns(PictureWarning, match="several pictures, of which the first is read"):
        read = ms.read_picture(path)
    np.testing.assert_allclose(read.light ** (1 / GAMMA), COLOUR / 255, atol=1e-6)


PAGE = {1: "minisblack", 3: "rgb"}


@pytest.mark.parametrize("num_colours", [1, 3])
@pytest.mark.parametrize(
    ("extras", "matte"),
    [(["unspecified"], None), (["unassalpha"], 0), (["unspecified", "unassalpha"], 1)],
)
def test_a_band_is_opacity_where_the_file_says_so(tmp_path, num_colours, extras, matte):
    """A band of unknown meaning is left out, and opacity is found behind it."""
    import tifffile

    if num_colours == 1 and len(extras) > 1:
        pytest.skip("bands of unknown meaning beside grey are refused")
    bands = np.concatenate([SIXTEEN[..., :num_colours], SIXTEEN[..., 2 : 2 + len(extras)]], axis=-1)
    options = {"photometric": PAGE[num_colours], "planarconfig": "contig"}
    tifffile.imwrite(tmp_path / "a.tif", bands, extrasamples=extras, **options)
    read = ms.read_picture(tmp_path / "a.tif")
    coded = SIXTEEN[..., :num_colours] / 65535
    np.testing.assert_allclose(read.light ** (1 / GAMMA), coded, atol=1e-6)
    assert (read.matte is None) == (matte is None)
    if matte is not None:
        np.testing.assert_allclose(read.matte, SIXTEEN[..., 2 + matte] / 65535, atol=1e-6)


def test_opacity_is_not_turned_with_the_grey_beside_it(tmp_path):
    """Where zero is white, an opacity of zero is still clear."""
    import tifffile

    bands = np.concatenate([255 - GREY, EIGHT[..., 3:]], axis=-1)
    options = {"photometric": "miniswhite", "planarconfig": "contig"}
    tifffile.imwrite(tmp_path / "a.tif", bands, extrasamples=["unassalpha"], **options)
    read = ms.read_picture(tmp_path / "a.tif")
    np.testing.assert_allclose(read.light ** (1 / GAMMA), GREY / 255, atol=1e-6)
    np.testing.assert_allclose(read.matte, EIGHT[..., 3] / 255, atol=1e-6)


@pytest.mark.parametrize("bits", [10, 12, 14])
@pytest.mark.parametrize("suffix", [".tif", ".png", ".pgm"])
def test_few_bits_in_sixteen(tmp_path, suffix, bits):
    """Their white can be said, and where it is not a warning says what it may be."""
    import imagecodecs
    import tifffile

    values, white = SIXTEEN[..., 0] >> (16 - bits), (1 << bits) - 1
    path = tmp_path / f"a{suffix}"
    if suffix == ".tif":
        tifffile.imwrite(path, values, photometric="minisblack")
    elif suffix == ".png":
        path.write_bytes(imagecodecs.png_encode(values))
    else:
        head = b"P5 %d %d 65535\n" % values.shape[::-1]
        path.write_bytes(head + values.astype(">u2").tobytes())
    said = f"greatest value is {values.max()} of 65535; .* {bits} bits in 16, .* `white` {white}"
    with pytest.warns(PictureWarning, match=said):
        read = ms.read_picture(path)
    np.testing.assert_allclose(read.light[..., 0] ** (1 / GAMMA), values / 65535, atol=1e-6)
    read = ms.read_picture(path, white=white)
    np.testing.assert_allclose(read.light[..., 0] ** (1 / GAMMA), values / white, atol=1e-6)


@pytest.mark.parametrize(("white", "most"), [(None, 255), (203.5, 203)])
def test_numbers_that_are_light(tmp_path, white, most):
    """Whole numbers are linear light where that is said, up to the value that is white."""
    from PIL import Image

    coded = np.minimum(COLOUR, most)
    Image.fromarray(coded).save(tmp_path / "a.png")
    read = ms.read_picture(tmp_path / "a.png", white=white, linear=True)
    np.testing.assert_allclose(read.light, coded / (white or 255), atol=1e-7)


@pytest.mark.parametrize("white", [3.5, 0.8])
def test_floating_point_light_of_another_white(tmp_path, white):
    """Light of a floating-point TIFF is over the value that is said to be white."""
    import tifffile

    light = (COLOUR / 255 * white).astype(np.float32)
    tifffile.imwrite(tmp_path / "a.tif", light, photometric="rgb")
    read = ms.read_picture(tmp_path / "a.tif", white=white)
    np.testing.assert_allclose(read.light, light / white, rtol=1e-6)


def test_a_value_that_is_no_light_is_told(tmp_path):
    """Above white or below black, the line holds the value at all of its digits."""
    import tifffile

    for worst, white in ((np.nextafter(np.float32(1), np.float32(2)), 1), (np.float32(-3e-7), 1)):
        light = (COLOUR / 255).astype(np.float32)
        light[2, 3, 1] = worst
        tifffile.imwrite(tmp_path / "a.tif", light, photometric="rgb")
        line = f"must hold values from 0 to white, {white}; got {worst} in"
        with pytest.raises(ValueError, match=re.escape(line)):
            ms.read_picture(tmp_path / "a.tif")
    tifffile.imwrite(tmp_path / "b.tif", DEEP_COLOUR >> 4, photometric="rgb")
    line = f"must hold values from 0 to white, 4000; got {DEEP_COLOUR.max() >> 4} in"
    with pytest.raises(ValueError, match=line):
        ms.read_picture(tmp_path / "b.tif", white=4000)


@pytest.mark.parametrize(
    ("coding", "line"),
    [
        ({"white": 0.0}, "`read_picture(white=...)` must be above 0; got 0.0"),
        ({"white": -4095}, "`read_picture(white=...)` must be above 0; got -4095"),
        ({"white": float("nan")}, "`read_picture(white=...)` must be finite; got nan"),
    ],
)
def test_a_white_that_is_none(tmp_path, coding, line):
    """It is a number above black, and is checked before the file is read."""
    with pytest.raises(ValueError, match=re.escape(line)):
        ms.read_picture(tmp_path / "none.png", **coding)
