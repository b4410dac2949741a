"""Pictures in and out.

Pinned against values written by other libraries, because what matters is that a file
means here what it means elsewhere; and each refusal by its text.
"""

import re
import struct
import subprocess
import sys
import zlib

import numpy as np
import pytest

import mishutter as ms

# The formula of the transfer curve and the limit of size, to which pictures are held.
from mishutter.pictures.images import (
    GAMMA,
    MAX_PIXELS,
    frames_of_tiff,
    middle_rows,
    read_captures,
    read_labels,
    read_opacity,
    to_display,
)

ROWS, COLUMNS = 13, 29
CODED = np.random.default_rng(7).integers(0, 256, (ROWS, COLUMNS, 4)).astype(np.uint8)


def as_light(coded):
    return (coded / np.iinfo(coded.dtype).max) ** GAMMA


def chunk(name, data):
    """A chunk of a PNG."""
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def save(path, array, **options):
    from PIL import Image

    Image.fromarray(array).save(path, **options)
    return path


@pytest.mark.parametrize("suffix", ["png", "tif"])
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_eight_bits(tmp_path, suffix, channels):
    """Grey, RGB and RGBA of 8 bits become light by the power 2.2, alpha a matte without it."""
    coded = CODED[..., 0] if channels == 1 else CODED[..., :channels]
    read = ms.read_picture(save(tmp_path / f"a.{suffix}", coded))
    colour = coded[..., None] if channels == 1 else coded[..., :3]
    np.testing.assert_allclose(read.light, as_light(colour), atol=1e-6)
    assert (read.matte is None) == (channels < 4)
    if channels == 4:
        np.testing.assert_allclose(read.matte, coded[..., 3] / 255, atol=1e-7)


def test_palette_and_bilevel(tmp_path):
    """A palette is looked up and a bilevel picture is black and white."""
    from PIL import Image

    image = Image.fromarray(CODED[..., :3]).quantize(12)
    image.save(tmp_path / "p.png")
    read = ms.read_picture(tmp_path / "p.png")
    np.testing.assert_allclose(read.light, as_light(np.asarray(image.convert("RGB"))), atol=1e-6)
    Image.fromarray(CODED[..., 0]).convert("1").save(tmp_path / "b.png")
    assert set(np.unique(ms.read_picture(tmp_path / "b.png").light)) == {0.0, 1.0}


def test_cmyk_jpeg(tmp_path):
    """A CMYK JPEG is read as the RGB that Pillow makes of it."""
    from PIL import Image

    smooth = np.broadcast_to(np.arange(COLUMNS, dtype=np.uint8)[None, :, None] * 8, (16, 29, 3))
    Image.fromarray(np.ascontiguousarray(smooth)).convert("CMYK").save(tmp_path / "c.jpg")
    read = ms.read_picture(tmp_path / "c.jpg")
    assert read.light.shape == (16, 29, 3)
    np.testing.assert_allclose(read.light ** (1 / GAMMA) * 255, smooth, atol=12)


@pytest.mark.parametrize("compression", ["lzw", "zlib", "zstd"])
@pytest.mark.parametrize("separate", [False, True])
@pytest.mark.parametrize("tile", [None, (16, 112)])
@pytest.mark.parametrize("predictor", [False, True])
def test_sixteen_bit_tiff_compressed(tmp_path, predictor, tile, separate, compression):
    """A compressed 16-bit RGB TIFF keeps all of its bits, in whatever pieces it stores them."""
    import tifffile

    coded = np.random.default_rng(3).integers(0, 50, (37, 300, 3)).astype(np.uint16) * 1301
    path = tmp_path / "p.tif"
    pieces = {"tile": tile} if tile else {"rowsperstrip": 16}
    planes = {"planarconfig": "separate" if separate else "contig"}
    stored = np.moveaxis(coded, -1, 0) if separate else coded
    tifffile.imwrite(
        path,
        stored,
        photometric="rgb",
        byteorder=">",
        compression=compression,
        predictor=predictor,
        **pieces,
        **planes,
    )
    np.testing.assert_allclose(ms.read_picture(path).light, as_light(coded), atol=1e-6)
    path.write_bytes(path.read_bytes()[:2000])
    with pytest.raises(ValueError, match="must name a whole PNG, JPEG, TIFF"):
        ms.read_picture(path)


def test_float_tiff_is_light_already(tmp_path):
    """A floating-point TIFF is linear light; NaN and values above white are refused."""
    import tifffile

    light = (CODED[..., :3] / 255).astype(np.float32)
    tifffile.imwrite(tmp_path / "f.tif", light, photometric="rgb")
    np.testing.assert_array_equal(ms.read_picture(tmp_path / "f.tif").light, light)
    light[2, 3, 1] = np.nan
    tifffile.imwrite(tmp_path / "n.tif", light, photometric="rgb")
    with pytest.raises(ValueError, match=r"must hold finite pixels; got .*NaN"):
        ms.read_picture(tmp_path / "n.tif")
    tifffile.imwrite(tmp_path / "h.tif", 3 * (CODED[..., 0] / 255).astype(np.float32))
    with pytest.raises(ValueError, match=r"must hold values from 0 to white, 1; got 3\.0 in"):
        ms.read_picture(tmp_path / "h.tif")


def transposed(pixels, orientation):
    """Pillow's reading of the orientation tag, channel by channel."""
    from PIL import Image, ImageOps

    planes = []
    for channel in range(pixels.shape[2]):
        plane = Image.fromarray(pixels[..., channel].astype(np.int32))
        plane.getexif()[274] = orientation
        planes.append(np.asarray(ImageOps.exif_transpose(plane)))
    return np.stack(planes, axis=-1).astype(pixels.dtype)


@pytest.mark.parametrize("depth", [np.uint8, np.uint16])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_pictures_stand_upright(tmp_path, orientation, depth):
    """A TIFF and a PNG are turned as their tag says, at 8 bits a channel and at 16."""
    import tifffile
    from PIL import Image

    coded = CODED[..., :3].astype(depth) * (np.iinfo(depth).max // 255)
    tag = (274, "H", 1, orientation, True)
    tifffile.imwrite(tmp_path / "t.tif", coded, photometric="rgb", extratags=[tag])
    exif = Image.Exif()
    exif[274] = orientation
    if depth == np.uint8:
        Image.fromarray(coded).save(tmp_path / "t.png", exif=exif)
    else:
        ms.write_picture(tmp_path / "t.png", as_light(coded))
        whole = (tmp_path / "t.png").read_bytes()
        tags = chunk(b"eXIf", exif.tobytes().removeprefix(b"Exif\0\0"))
        (tmp_path / "t.png").write_bytes(whole[:33] + tags + whole[33:])  # after the header
        (tmp_path / "l.png").write_bytes(whole[:-12] + tags + whole[-12:])  # after the pixels
    for name in ("t.tif", "t.png", "l.png")[: 2 if depth == np.uint8 else 3]:
        read = ms.read_picture(tmp_path / name).light
        np.testing.assert_allclose(read, as_light(transposed(coded, orientation)), atol=1e-6)


@pytest.mark.parametrize("depth", [np.uint8, np.uint16, np.float32])
def test_colour_that_opacity_is_multiplied_into(tmp_path, depth):
    """A TIFF with associated alpha is read as the same picture with its alpha apart."""
    import tifffile

    full = 1 if depth == np.float32 else np.iinfo(depth).max
    matte = CODED[..., 3:] / 255
    held = np.concatenate([CODED[..., :3] / 255 * matte, matte], axis=-1) * full
    held = (held if full == 1 else np.rint(held)).astype(depth)
    tifffile.imwrite(tmp_path / "a.tif", held, photometric="rgb", extrasamples=["assocalpha"])
    read = ms.read_picture(tmp_path / "a.tif")
    assert read.matte is not None
    np.testing.assert_allclose(read.matte, matte[..., 0], atol=1e-6)
    seen = read.matte > 0.2
    apart = CODED[..., :3] / 255 if full == 1 else as_light(CODED[..., :3])
    np.testing.assert_allclose(read.light[seen], apart[seen], atol=0.03 if full == 255 else 2e-4)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_opacity_below_the_colour_that_it_multiplies(tmp_path, dtype):
    """Colour beyond its opacity is white, and where opacity is zero, black: neither wraps round."""
    import tifffile

    full = np.iinfo(dtype).max
    colour, alpha = np.array([[0.41, 0.2, 0.3], [0.83, 0.29, 0.0]]), np.array([0.3, 0.0])
    held = np.rint(np.column_stack([colour, alpha]) * full).astype(dtype)[None]
    tifffile.imwrite(tmp_path / "a.tif", held, photometric="rgb", extrasamples=["assocalpha"])
    read = ms.read_picture(tmp_path / "a.tif")
    shown = np.array([[[1, 0.2 / 0.3, 1], [0, 0, 0]]]) ** 2.2
    np.testing.assert_allclose(read.light, shown, atol=0.01 if full == 255 else 1e-4)


def test_a_picture_is_known_by_what_it_holds(tmp_path):
    """A TIFF named as a PNG keeps its bits, and a PNG named as a TIFF is read."""
    import tifffile

    coded = CODED[..., :3].astype(np.uint16) * 251 + 3
    tifffile.imwrite(tmp_path / "a.tif", coded, photometric="rgb")
    (tmp_path / "a.tif").rename(tmp_path / "a.png")
    ms.write_picture(tmp_path / "b.png", as_light(coded))
    (tmp_path / "b.png").rename(tmp_path / "b.tif")
    for name in ("a.png", "b.tif"):
        np.testing.assert_allclose(
            ms.read_picture(tmp_path / name).light, as_light(coded), atol=1e-6
        )


@pytest.mark.parametrize(("rows", "channels"), [(ROWS, 1), (521, 3), (ROWS, 4)])
def test_sixteen_bit_png_both_ways(tmp_path, rows, channels):
    """What is written at 16 bits comes back to within half a step of them."""
    light = np.random.default_rng(2).random((rows, COLUMNS, channels))
    ms.write_picture(tmp_path / "w.png", light)
    read = ms.read_picture(tmp_path / "w.png")
    colour = light[..., :3]
    np.testing.assert_allclose(read.light ** (1 / GAMMA), colour ** (1 / GAMMA), atol=0.6 / 65535)
    if channels == 4:
        np.testing.assert_allclose(read.matte, light[..., 3], atol=0.6 / 65535)
    assert [p.name for p in tmp_path.iterdir()] == ["w.png"]


def test_refusals(tmp_path):
    """The reader refuses what is no picture, with one line that names the file and says why."""
    from PIL import Image

    whole = save(tmp_path / "w.jpg", np.ascontiguousarray(CODED[..., :3]))
    (tmp_path / "cut.jpg").write_bytes(whole.read_bytes()[:700])
    ms.write_picture(tmp_path / "deep.png", CODED[..., :3] / 255)
    (tmp_path / "cut.png").write_bytes((tmp_path / "deep.png").read_bytes()[:500])
    (tmp_path / "text.png").write_text("not a picture")
    (tmp_path / "empty.tif").write_bytes(b"")
    for name in ("cut.jpg", "cut.png", "text.png", "empty.tif"):
        with pytest.raises(ValueError, match=f"must name a whole PNG, JPEG, TIFF.*{name}"):
            ms.read_picture(tmp_path / name)
    with pytest.raises(FileNotFoundError, match=r"must name a file; got .*none.png', not found"):
        ms.read_picture(tmp_path / "none.png")
    with pytest.raises(IsADirectoryError, match="must name a file; got the folder"):
        ms.read_picture(tmp_path)
    bomb = Image.new("1", (20000, MAX_PIXELS // 20000 + 1))
    bomb.save(tmp_path / "bomb.png")
    with pytest.raises(ValueError, match=r"at most 150 megapixels; got .*bomb.png"):
        ms.read_picture(tmp_path / "bomb.png")
    with pytest.raises(FileNotFoundError, match="must lie in a folder that exists"):
        ms.write_picture(tmp_path / "no" / "a.png", CODED[..., 0] / 255)
    with pytest.raises(ValueError, match="must be finite"):
        ms.write_picture(tmp_path / "a.png", np.full((3, 4), np.nan))
    assert not list(tmp_path.glob(".a.png*"))


def test_a_damaged_or_boundless_png(tmp_path):
    """A header, or pixels, that contradict their check sums, and more pixels than are decoded."""
    whole = tmp_path / "w.png"
    ms.write_picture(whole, CODED[..., :3] / 255)
    for place in (19, 300):
        data = bytearray(whole.read_bytes())
        data[place] ^= 5
        (tmp_path / "d.png").write_bytes(data)
        with pytest.raises(ValueError, match=r"must name a whole PNG.*d\.png"):
            ms.read_picture(tmp_path / "d.png")
    for side, reason in ((13000, "13000 x 13000 pixels"), (30000, "30000 x 30000 pixels")):
        numbers = struct.pack(">IIBBBBB", side, side, 16, 2, 0, 0, 0)
        body = chunk(b"IHDR", numbers) + chunk(b"IDAT", b"") + chunk(b"IEND", b"")
        (tmp_path / "b.png").write_bytes(b"\x89PNG\r\n\x1a\n" + body)
        with pytest.raises(ValueError, match=rf"at most 150 megapixels.*b\.png.*: .*{reason}"):
            ms.read_picture(tmp_path / "b.png")


def test_a_damaged_tiff_is_one_line(tmp_path):
    """The reader prints nothing of what tifffile logs, where nobody has set up logging."""
    path = save(tmp_path / "c.tif", CODED[..., 0], compression="tiff_lzw")
    path.write_bytes(path.read_bytes()[:200])
    code = f"import mishutter; mishutter.read_picture({str(path)!r})"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stderr.startswith("Traceback")
    assert "must name a whole PNG, JPEG, TIFF" in done.stderr.splitlines()[-1]


def test_a_boundless_tiff(tmp_path):
    """One of more pixels than are unpacked is refused by what it says of itself."""
    import tifffile

    path = tmp_path / "b.tif"
    tifffile.imwrite(path, CODED[..., 0])
    with tifffile.TiffFile(path, mode="r+") as file:
        for name in ("ImageWidth", "ImageLength"):
            file.pages[0].tags[name].overwrite(20000)
    with pytest.raises(ValueError, match=r"b\.tif.*: 20000 x 20000 pixels"):
        ms.read_picture(path)


def test_colours_in_planes_of_their_own(tmp_path):
    """A TIFF that holds all red, then all green, is the picture that one in turns is."""
    import tifffile

    planes = np.moveaxis(CODED[..., :3], -1, 0)
    tifffile.imwrite(tmp_path / "s.tif", planes, photometric="rgb", planarconfig="separate")
    read = ms.read_picture(tmp_path / "s.tif")
    np.testing.assert_allclose(read.light, as_light(CODED[..., :3]), atol=1e-6)


def test_opacity_of_grey_and_of_a_palette(tmp_path):
    """A grey picture may have a matte, and so may a colour of a palette."""
    from PIL import Image

    grey = ms.read_picture(save(tmp_path / "g.png", CODED[..., :2]))
    np.testing.assert_allclose(grey.light[..., 0], as_light(CODED[..., 0]), atol=1e-6)
    np.testing.assert_allclose(grey.matte, CODED[..., 1] / 255, atol=1e-7)
    image = Image.fromarray(CODED[..., :3]).quantize(12)
    image.save(tmp_path / "p.png", transparency=3)
    clear = np.asarray(image) == 3
    np.testing.assert_array_equal(ms.read_picture(tmp_path / "p.png").matte, np.where(clear, 0, 1))


def test_opacity_of_sixteen_bits_of_grey(tmp_path):
    """One of the values of a grey PNG may be clear, at 16 bits too."""
    path, clear = tmp_path / "g.png", 3 * 257
    coded = np.where(CODED[..., 0] > 200, clear, CODED[..., 0].astype(np.uint16) * 251)
    ms.write_picture(path, as_light(coded.astype(np.uint16)))
    whole = path.read_bytes()
    path.write_bytes(whole[:33] + chunk(b"tRNS", struct.pack(">H", clear)) + whole[33:])
    np.testing.assert_array_equal(ms.read_picture(path).matte, np.where(coded == clear, 0, 1))


def test_opacity_of_a_picture_in_colour(tmp_path):
    """It is the luminance of what the file holds, without gamma."""
    coded = CODED[..., :3] / 255
    save(tmp_path / "c.png", np.ascontiguousarray(CODED[..., :3]))
    wanted = coded @ [0.2126, 0.7152, 0.0722]
    np.testing.assert_allclose(read_opacity(tmp_path / "c.png"), wanted, atol=1e-6)


@pytest.mark.parametrize(
    ("light", "matte", "message"),
    [
        (np.ones((3, 4)), None, "`Picture(light=...)` must have shape (rows, columns, 1 or 3)"),
        (np.full((3, 4, 1), np.inf), None, "`Picture(light=...)` must be finite"),
        (np.full((3, 4, 1), -0.25), None, "`Picture(light=...)` must be at least 0; got -0.25"),
        (np.ones((3, 4, 1)), np.ones((4, 3)), "`Picture(matte=...)` must have shape (3, 4)"),
        (np.ones((3, 4, 1)), np.full((3, 4), 1.5), "`Picture(matte=...)` must lie in [0, 1]"),
    ],
)
def test_a_picture_that_is_none(light, matte, message):
    """Light is finite and not below 0, opacity is a share, and both are of one size."""
    with pytest.raises(ValueError, match=re.escape(message)):
        ms.Picture(light, matte)


def test_example_needs_no_network():
    """The built-in photograph comes out of scikit-image's package."""
    assert ms.example_picture().light.shape == (500, 741, 3)


def test_row_spectrum_of_a_known_process():
    """Rows of the default spectrum give it back, and the mean and deviation are exact."""
    columns = 2048
    frequency = np.fft.rfftfreq(columns)
    power = 1 / (frequency**2 + 0.01**2)
    white = np.random.default_rng(5).standard_normal((400, columns))
    rows = np.fft.irfft(np.fft.rfft(white) * np.sqrt(power), columns)
    light = 0.5 + 0.05 * rows / np.std(rows)
    picture = ms.Picture(np.maximum(light, 0)[..., None].astype(np.float32))
    found = ms.row_power_spectrum(picture, 32)
    grid = (np.arange(32) + 0.5) / 64
    expected = 1 / (grid**2 + 0.01**2)
    ratio = found.power_spectrum[1:] / expected[1:]
    assert np.ptp(np.log(ratio)) < 0.15
    assert found.mean_level == pytest.approx(light.mean(), abs=1e-6)
    assert np.mean(found.power_spectrum) == pytest.approx(found.deviation**2)


def test_row_spectrum_of_a_wave_and_of_a_slope():
    """A wave between two steps counts for both; a jump between a row's ends is no contrast."""
    place = np.arange(64)
    wave, slope = (
        ms.Picture(np.tile(row, (3, 1))[..., None])
        for row in (0.5 + 0.3 * np.sin(2 * np.pi * place / 8 + 0.4), (place + 2) / 70)
    )
    power = ms.row_power_spectrum(wave, 4).power_spectrum
    np.testing.assert_allclose(power, np.mean(power) * np.array([2, 2, 0, 0]), atol=1e-9)
    fine = ms.row_power_spectrum(slope, 4).power_spectrum
    assert fine[3] < 1e-6 * fine[0]


def test_row_spectrum_of_one_grey():
    """There is no power where there is no contrast."""
    found = ms.row_power_spectrum(ms.Picture(np.full((3, 40, 3), 0.5)))
    assert not np.any(found.power_spectrum)
    assert (found.mean_level, found.deviation) == (pytest.approx(0.5), pytest.approx(0))


def test_row_spectrum_needs_a_row():
    """A picture of one pixel has no spectrum, and says so."""
    with pytest.raises(ValueError, match=r"must have rows of at least 8 px; got '1 px'"):
        ms.row_power_spectrum(ms.Picture(np.ones((1, 1, 1))))


def test_luminance_of_a_colour():
    """The weights of ITU-R BT.709, on linear light; of grey the light itself."""
    colour = ms.Picture(np.array([[[0.3, 0.5, 0.9]]]))
    assert colour.luminance[0, 0] == pytest.approx(0.2126 * 0.3 + 0.7152 * 0.5 + 0.0722 * 0.9)
    assert ms.Picture(np.full((1, 1, 1), 0.3)).luminance[0, 0] == 0.3


def test_displayed_values_are_coded_by_one_gamma():
    """Light is clipped to what a screen shows; the value between is its 2.2th root."""
    light = np.array([-0.3, 0.0, 0.18, 0.7, 1.0, 1.6])
    assert to_display(light) ** 2.2 == pytest.approx([0, 0, 0.18, 0.7, 1, 1], rel=1e-12)


def test_a_high_picture_is_cut_to_its_middle():
    """As many rows above as below are left out."""
    light = np.tile(np.arange(200.0)[:, None, None] / 200, (1, 9, 1))
    assert np.array_equal(middle_rows(light, 160), light[20:180])
    assert np.array_equal(middle_rows(light[:7], 160), light[:7])


def test_each_value_is_a_label(tmp_path):
    """Black is 0 where there is some; other values count from 1, of grey and of colours."""
    grey = np.repeat(np.array([[0, 90, 90, 0, 255, 7]], np.uint8), 3, axis=0)
    for name, coded in (("g", grey), ("c", np.stack([grey, grey, 0 * grey], axis=-1))):
        found = read_labels(save(tmp_path / f"{name}.png", coded))
        np.testing.assert_array_equal(found[0], [0, 2, 2, 0, 3, 1])
    bright = read_labels(save(tmp_path / "b.png", np.maximum(grey, 7)))
    np.testing.assert_array_equal(bright[0], [1, 2, 2, 1, 3, 1])
    sides = np.zeros((2, 3, 3), np.uint8)
    sides[0, 0], sides[1, 2] = (9, 0, 0), (0, 0, 9)  # no channel is black everywhere
    np.testing.assert_array_equal(
        read_labels(save(tmp_path / "s.png", sides)), [[2, 0, 0], [0, 0, 1]]
    )


def test_pages_of_a_tiff_that_are_pictures_of_their_own_follow_each_other(tmp_path):
    """Each was written by itself; one of another size is none of them."""
    import tifffile

    frames = np.random.default_rng(3).integers(0, 999, (4, 11, 17)).astype(np.uint16)
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        for frame in (*frames[:2], frames[0, :5], *frames[2:]):
            file.write(frame, photometric="minisblack", metadata=None)
    found = frames_of_tiff(tmp_path / "a.tif", 3)
    np.testing.assert_array_equal(found.frames, frames[:3])
    assert found.has_more
    assert not frames_of_tiff(tmp_path / "a.tif", None).has_more


def test_a_folder_is_no_file_to_write(tmp_path):
    """Whatever its name; nor is a name in a folder that is not there."""
    (tmp_path / "a.png").mkdir()
    with pytest.raises(IsADirectoryError, match="must name a file; got the folder"):
        ms.write_picture(tmp_path / "a.png", np.ones((3, 4)))
    with pytest.raises(FileNotFoundError, match="must lie in a folder that exists"):
        ms.write_picture(tmp_path / "none" / "a.png", np.ones((3, 4)))


def test_numbers_of_a_capture_are_those_of_light_and_back(tmp_path):
    """Above black, over white and below black, by a power of either sign."""
    levels = np.array([[90.0, 100.0, 400.0, 1100.0, 1500.0]] * 3, np.float32)
    import tifffile

    tifffile.imwrite(tmp_path / "a.tif", levels.astype(np.uint16), photometric="minisblack")
    (found,) = read_captures(tmp_path / "a.tif", black=100.0, white=1100.0)
    shares = (levels - 100) / 1000
    wanted = np.copysign(np.abs(shares) ** 2.2, shares)
    np.testing.assert_allclose(found.light[..., 0], wanted, rtol=1e-5)
    found.write_like(tmp_path / "b.tif", found.light)
    np.testing.assert_array_equal(tifffile.imread(tmp_path / "b.tif"), levels)
