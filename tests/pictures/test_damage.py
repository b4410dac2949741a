"""A damaged picture is refused, and what its file says of its numbers is honoured or told.

Formats without check sums cannot show that a byte is another: there a file that ends early, or
lacks a part, is what can be told.
"""

import io
import struct
import zlib

import numpy as np
import pytest
import tifffile
from PIL import Image
from support.picture_files import COLOUR, DEEP_COLOUR, PALETTE, PROMISED, SMOOTH

import mishutter as ms
from mishutter.pictures.images import PictureWarning

CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
"""Channels of a PNG by its kind of colour."""
PNG_KINDS = [
    *((0, bits) for bits in (1, 2, 4, 8, 16)),
    *((2, bits) for bits in (8, 16)),
    *((3, bits) for bits in (1, 2, 4, 8)),
    *((kind, bits) for kind in (4, 6) for bits in (8, 16)),
]
"""Every kind of colour of a PNG at every depth that it may have."""
PASSES = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2))
PASSES += ((0, 1, 1, 2),)
"""First column and row, and steps of columns and rows, of the passes of an interlaced PNG."""
SHAPE = 24, 13


def chunk(name, data):
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


END = chunk(b"IEND", b"")


def pixels_of(kind, bits):
    """Rows that are alike, so that they are packed to a few bytes."""
    row = np.random.default_rng(5).integers(0, 1 << bits, (SHAPE[1], CHANNELS[kind]))
    return np.broadcast_to(row, (*SHAPE, CHANNELS[kind]))


def packed(values, bits):
    """Rows of a PNG's pixels, each after the number of its filter."""
    bits_of = (values[..., None] >> np.arange(bits)[::-1]) & 1
    return b"".join(b"\0" + np.packbits(row.ravel()).tobytes() for row in bits_of.astype(np.uint8))


def png(kind, bits, *, interlaced=False, share=1.0, extra=b"", end=END):
    """A PNG that holds a share of its pixels, and is in order otherwise."""
    values = pixels_of(kind, bits)
    parts = [values]
    if interlaced:
        parts = [values[row::down, column::across] for column, row, across, down in PASSES]
    data = b"".join(packed(part, bits) for part in parts if part.size)
    head = struct.pack(">IIBBBBB", *SHAPE[::-1], bits, kind, 0, 0, interlaced)
    if kind == 3:
        colours = np.random.default_rng(6).integers(0, 256, (1 << bits, 3)).astype(np.uint8)
        extra += chunk(b"PLTE", colours.tobytes())
    data = zlib.compress(data[: round(share * len(data))])
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + extra + chunk(b"IDAT", data) + end


def read(path, content, **options):
    path.write_bytes(content)
    return ms.read_picture(path, **options)


def is_refused(path, content):
    """Whether a file is refused as damaged; another error is one of the test."""
    try:
        read(path, content)
    except ValueError as error:
        return "must name a whole PNG" in str(error)
    return False


@pytest.mark.parametrize("interlaced", [False, True])
def test_a_png_of_fewer_rows_than_it_says_is_refused(interlaced, tmp_path):
    """Of every kind and depth, if its pixels are packed as they should be; a whole one is read."""
    path = tmp_path / "a.png"
    for kind, bits in PNG_KINDS:
        whole = read(path, png(kind, bits, interlaced=interlaced))
        if kind in (0, 2):
            coded = whole.light ** (1 / 2.2)
            np.testing.assert_allclose(coded, pixels_of(kind, bits) / ((1 << bits) - 1), atol=1e-6)
        for share in (0, 0.5, 23 / 24):
            short = png(kind, bits, interlaced=interlaced, share=share)
            assert is_refused(path, short), (kind, bits, share)


def test_a_png_in_which_one_bit_is_another_is_refused(tmp_path):
    """Whichever it is: every chunk has a check sum."""
    for slug in ("png-bilevel", "png-deep-grey"):
        path = tmp_path / "a.png"
        PROMISED[slug].write(path)
        whole = path.read_bytes()
        for place in range(len(whole)):
            content = bytearray(whole)
            content[place] ^= 1 << place % 8
            assert is_refused(path, bytes(content)), (slug, place)


def test_a_png_without_its_end_is_refused(tmp_path):
    """Also where all pixels came before."""
    for kind, bits in PNG_KINDS:
        assert is_refused(tmp_path / "a.png", png(kind, bits, end=b"")), (kind, bits)
        assert is_refused(tmp_path / "a.png", png(kind, bits)[:-1]), (kind, bits)


@pytest.mark.parametrize("slug", PROMISED)
def test_a_file_that_is_cut_is_refused(slug, tmp_path):
    """A tenth or more of any format is missing, and the reader does not fill it up."""
    path = tmp_path / f"a{PROMISED[slug].suffix}"
    PROMISED[slug].write(path)
    whole = path.read_bytes()
    first = whole.find(b"MPF\0")  # what follows the first picture is not read
    end = len(whole) if first < 0 else whole.find(b"\xff\xd9") + 2
    for share in (0.4, 0.7, 0.9):
        assert is_refused(path, whole[: round(share * end)]), share


@pytest.mark.parametrize("options", [{}, {"progressive": True}, {"restart_marker_blocks": 3}])
def test_a_jpeg_that_was_closed_early_is_refused(options, tmp_path):
    """Its decoder would make what is missing grey: the end marker alone does not make it whole."""
    buffer = io.BytesIO()
    Image.fromarray(np.tile(COLOUR, (4, 2, 1))).save(buffer, "JPEG", quality=90, **options)
    whole = buffer.getvalue()
    assert read(tmp_path / "a.jpg", whole).light.shape == (48, 64, 3)
    for share in (0.6, 0.9, 0.98):
        cut = whole[: round(share * len(whole))] + b"\xff\xd9"
        assert is_refused(tmp_path / "a.jpg", cut), share


PARTS = {
    "strips": (DEEP_COLOUR, {"photometric": "rgb", "rowsperstrip": 4}),
    "tiles": (np.tile(DEEP_COLOUR, (2, 1, 1)), {"photometric": "rgb", "tile": (16, 16)}),
    "deflate": (DEEP_COLOUR, {"photometric": "rgb", "rowsperstrip": 4, "compression": "zlib"}),
    "lzw": (DEEP_COLOUR, {"photometric": "rgb", "rowsperstrip": 4, "compression": "lzw"}),
    "packbits": (DEEP_COLOUR, {"photometric": "rgb", "rowsperstrip": 4, "compression": "packbits"}),
    "12 bits": (DEEP_COLOUR >> 4, {"photometric": "rgb", "rowsperstrip": 4, "bitspersample": 12}),
    "palette": (
        np.ascontiguousarray(COLOUR[..., 0]),
        {"photometric": "palette", "colormap": PALETTE * 257, "rowsperstrip": 4},
    ),
    "4 bits": (
        COLOUR[..., 0] >> 4,
        {"photometric": "minisblack", "bitspersample": 4, "rowsperstrip": 4},
    ),
}


@pytest.mark.parametrize("slug", PARTS)
def test_a_tiff_that_lacks_a_part_is_refused(slug, tmp_path):
    """A strip or tile of no place or no size, or for which the file has no entry."""
    path, (values, options) = tmp_path / "a.tif", PARTS[slug]
    tifffile.imwrite(path, values, **options)
    whole = path.read_bytes()
    assert ms.read_picture(path).light.shape[:2] == values.shape[:2]
    kind = "Tile" if slug == "tiles" else "Strip"
    for name in (f"{kind}Offsets", f"{kind}ByteCounts"):
        for lack in (lambda entries: (*entries[:-1], 0), lambda entries: entries[:-1]):
            path.write_bytes(whole)
            with tifffile.TiffFile(path, mode="r+b") as file:
                tag = file.pages[0].tags[name]
                tag.overwrite(lack(tag.value))
            with pytest.raises(ValueError, match="must name a whole PNG"):
                ms.read_picture(path)


@pytest.mark.parametrize("kind", [2, 3])
def test_a_colour_profile_that_breaks_a_rule_is_passed_over(kind, tmp_path, caplog):
    """It is not used, and the decoder would warn of it on users' standard error."""
    profile = chunk(b"iCCP", b"ICC Profile\0\0" + zlib.compress(bytes(200)))
    taken = read(tmp_path / "a.png", png(kind, 8, extra=profile))
    assert caplog.text == ""
    plain = read(tmp_path / "b.png", png(kind, 8))
    np.testing.assert_array_equal(taken.light, plain.light)


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize(
    ("chunks", "power"),
    [
        ({b"gAMA": struct.pack(">I", 100_000)}, 1.0),
        ({b"gAMA": struct.pack(">I", 45_455)}, 2.2),
        ({b"gAMA": struct.pack(">I", 55_556)}, 1.8),
        ({b"gAMA": struct.pack(">I", 0)}, 2.2),
        ({b"gAMA": struct.pack(">I", 100_000), b"sRGB": b"\0"}, 2.2),
        ({b"cICP": bytes([1, 8, 0, 1])}, 1.0),
        ({b"cICP": bytes([1, 13, 0, 1])}, 2.2),
        ({b"cICP": bytes([5, 5, 0, 1])}, 2.8),
        ({b"cICP": bytes([1, 8, 0, 1]), b"gAMA": struct.pack(">I", 45_455)}, 1.0),
    ],
)
def test_the_power_that_a_png_states_is_taken(bits, chunks, power, tmp_path):
    """Linear light is linear, and a coding of its own is undone; `linear` still says otherwise."""
    content = png(2, bits, extra=b"".join(chunk(*each) for each in chunks.items()))
    shares = pixels_of(2, bits) / ((1 << bits) - 1)
    picture = read(tmp_path / "a.png", content)
    np.testing.assert_allclose(picture.light, shares**power, rtol=1e-5, atol=1e-7)
    picture = ms.read_picture(tmp_path / "a.png", linear=True)
    np.testing.assert_allclose(picture.light, shares, rtol=1e-6)


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize(
    ("coding", "told"),
    [
        ([9, 16, 0, 1], "coded by PQ, and are read as if by gamma 2.2"),
        ([9, 18, 0, 1], "coded by HLG"),
        ([1, 9, 0, 1], "coded by the transfer function 9 of H.273"),
        ([1, 1, 0, 0], "coded by the narrow range of video"),
    ],
)
def test_a_coding_that_is_no_power_is_told(bits, coding, told, tmp_path):
    """The picture is read as ever, with a warning unless its numbers are said to be light."""
    content = png(2, bits, extra=chunk(b"cICP", bytes(coding)))
    with pytest.warns(PictureWarning, match=told):
        picture = read(tmp_path / "a.png", content)
    shares = pixels_of(2, bits) / ((1 << bits) - 1)
    np.testing.assert_allclose(picture.light ** (1 / 2.2), shares, atol=1e-6)
    ms.read_picture(tmp_path / "a.png", linear=True)


MAPS = {
    "P2": b"P2\n# P5 of old\n3 2 4095\n7 4095 2048\n100 3000 19\n",
    "P4": b"P4 11 2\n\x50\x31\x20\x50",
    "P5": b"P5 3 2 255\nP5 P5 ",
    "P5 of 12 bits": b"P5 3 2 4095\n\1\2\3\4\5\6\7\x08\x09\x0a\x0b\x0c",
    "P6": b"P6 3 1 255\nP5 P5 abc",
}


@pytest.mark.parametrize("slug", MAPS)
def test_the_first_of_several_maps_is_read_with_a_warning(slug, tmp_path):
    """As the first page of a TIFF; a line break, or pixels that look like a header, are no map."""
    path, one = tmp_path / "a.pgm", MAPS[slug]
    first = read(path, one + b"\n")
    for second in (one, b"\n" + one, b"\n\n" + MAPS["P6"]):
        with pytest.warns(PictureWarning, match="several pictures, of which the first is read"):
            again = read(path, one + second)
        np.testing.assert_array_equal(again.light, first.light)


@pytest.mark.parametrize("name", ["a.jpg", "a.tif", "a.PNG.jpeg", "a", "png", "a.pngx"])
def test_a_name_that_promises_another_format_is_refused(name, tmp_path):
    """A picture is written as a PNG, and its name says so."""
    with pytest.raises(ValueError, match=r"`write_picture\(path=...\)` must end in `.png`; got"):
        ms.write_picture(tmp_path / name, SMOOTH / 255)
    assert not list(tmp_path.iterdir())
    ms.write_picture(tmp_path / "a.PNG", SMOOTH / 255)
    assert ms.read_picture(tmp_path / "a.PNG").light.shape == SMOOTH.shape
