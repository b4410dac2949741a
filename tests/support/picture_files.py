"""Picture files of every format that is read, what they show, and files that are refused by name.

Each writes a file by a library that is not the reader, from values that are known.
"""

from functools import partial
from typing import Any, NamedTuple

import imagecodecs
import numpy as np
import tifffile
from PIL import Image

ROWS, COLUMNS = 12, 32
EIGHT = np.random.default_rng(7).integers(3, 256, (ROWS, COLUMNS, 4)).astype(np.uint8)
SIXTEEN = np.random.default_rng(8).integers(300, 65536, (ROWS, COLUMNS, 4)).astype(np.uint16)
# Block compression keeps what changes slowly.
SMOOTH = np.broadcast_to(np.linspace(20, 235, COLUMNS), (16, COLUMNS)).astype(np.uint8)
SMOOTH = np.stack([SMOOTH, SMOOTH[:, ::-1], SMOOTH // 2 + 60], axis=-1)
GREY, COLOUR = EIGHT[..., :1], EIGHT[..., :3]
DEEP_GREY, DEEP_COLOUR = SIXTEEN[..., :1], SIXTEEN[..., :3]
FITS = b"".join(
    line.ljust(80)
    for line in (
        b"SIMPLE  =                    T",
        b"BITPIX  =                   32",
        b"NAXIS   =                    2",
        b"NAXIS1  =                   32",
        b"NAXIS2  =                   12",
        b"END",
    )
).ljust(2880) + np.arange(ROWS * COLUMNS, dtype=">i4").tobytes().ljust(2880, b"\0")


class Shown(NamedTuple):
    """A file, and its picture.

    Attributes:
        suffix: How its name ends.
        write: Writes it to a path.
        coded: Its values over that of white; `(rows, columns, channels)`.
        matte: Its opacity, if it has one.
        linear: Whether the values are light.
        atol: Largest error of a coded value.
    """

    suffix: str
    write: Any
    coded: np.ndarray
    matte: np.ndarray | None = None
    linear: bool = False
    atol: float = 1e-6


def saved(array, **options):
    """A file that Pillow writes."""
    image = Image.fromarray(array[..., 0] if array.shape[-1] == 1 else array)
    return lambda path: image.save(path, **options)


def converted(mode, array=COLOUR, **options):
    """A file that Pillow writes after it has converted a picture."""
    return lambda path: Image.fromarray(array).convert(mode).save(path, **options)


def tiff(array, photometric, **options):
    """A TIFF that tifffile writes."""
    array = array[..., 0] if array.shape[-1] == 1 else array
    return lambda path: tifffile.imwrite(path, array, photometric=photometric, **options)


def encoded(encode, array):
    """A file that imagecodecs writes."""
    return lambda path: path.write_bytes(encode(array))


def whole(head, data=b""):
    """A file of some bytes."""
    return lambda path: path.write_bytes(head + data)


def share(array):
    return array / np.iinfo(array.dtype).max


def grey_map(white):
    """A grey map of values up to that of white."""
    values = (SIXTEEN[..., 0].astype(int) % (white + 1)).astype(">u2" if white > 255 else "u1")
    head = b"P5\n# from a camera\n%d %d\n%d\n" % (COLUMNS, ROWS, white)
    return Shown(".pgm", whole(head, values.tobytes()), values[..., None] / white)


def colour_map(white):
    values = (COLOUR.astype(int) % (white + 1)).astype("u1")
    head = b"P6 %d %d %d\n" % (COLUMNS, ROWS, white)
    return Shown(".ppm", whole(head, values.tobytes()), values / white)


def packed(bits):
    """A TIFF of so many bits a channel, one after the other."""
    values = DEEP_COLOUR >> (16 - bits)
    return Shown(".tif", tiff(values, "rgb", bitspersample=bits), values / ((1 << bits) - 1))


def floats(dtype):
    values = share(COLOUR).astype(dtype)
    return Shown(".tif", tiff(values, "rgb"), values, linear=True)


def compressed(compression, array=DEEP_COLOUR, **options):
    options["compression"] = compression
    return Shown(".tif", tiff(array, "rgb", **options), share(array))


PALETTE = np.random.default_rng(9).integers(0, 256, (3, 256)).astype(np.uint16)
LUMA = np.array([[1, 0, 1.402], [1, -0.344136, -0.714136], [1, 1.772, 0]])
YCBCR = SMOOTH // 4 + 96
"""Luma and two differences of colour, within the colours that RGB has."""

PROMISED = {
    "png-bilevel": Shown(".png", converted("1"), np.zeros((0,))),
    "png-grey": Shown(".png", saved(GREY), share(GREY)),
    "png-grey-alpha": Shown(".png", saved(EIGHT[..., :2]), share(GREY), share(EIGHT[..., 1])),
    "png-colour": Shown(".png", saved(COLOUR), share(COLOUR)),
    "png-colour-alpha": Shown(".png", saved(EIGHT), share(COLOUR), share(EIGHT[..., 3])),
    "png-deep-grey": Shown(
        ".png", encoded(imagecodecs.png_encode, SIXTEEN[..., 0].copy()), share(DEEP_GREY)
    ),
    "png-deep-grey-alpha": Shown(
        ".png",
        encoded(imagecodecs.png_encode, np.ascontiguousarray(SIXTEEN[..., :2])),
        share(DEEP_GREY),
        share(SIXTEEN[..., 1]),
    ),
    "png-deep-colour-alpha": Shown(
        ".png", encoded(imagecodecs.png_encode, SIXTEEN), share(DEEP_COLOUR), share(SIXTEEN[..., 3])
    ),
    "jpeg-grey": Shown(".jpg", saved(SMOOTH[..., :1], quality=95), share(SMOOTH[..., :1])),
    "jpeg-colour": Shown(".jpeg", saved(SMOOTH, quality=95, subsampling=0), share(SMOOTH)),
    "jpeg-with-previews": Shown(
        ".jpg",
        saved(
            SMOOTH, format="MPO", save_all=True, quality=95, append_images=[Image.new("L", (8, 4))]
        ),
        share(SMOOTH),
    ),
    "tiff-grey": Shown(".tif", tiff(GREY, "minisblack"), share(GREY)),
    "tiff-white-is-zero": Shown(".tif", tiff(255 - GREY, "miniswhite"), share(GREY)),
    "tiff-deep-white-is-zero": Shown(
        ".tif", tiff(65535 - DEEP_GREY, "miniswhite"), share(DEEP_GREY)
    ),
    "tiff-deep-colour": Shown(".tiff", tiff(DEEP_COLOUR, "rgb"), share(DEEP_COLOUR)),
    "tiff-big-endian": Shown(".tif", tiff(DEEP_COLOUR, "rgb", byteorder=">"), share(DEEP_COLOUR)),
    "tiff-of-over-4-gib": Shown(".tif", tiff(DEEP_COLOUR, "rgb", bigtiff=True), share(DEEP_COLOUR)),
    "tiff-planes": Shown(
        ".tif",
        tiff(np.moveaxis(DEEP_COLOUR, -1, 0).copy(), "rgb", planarconfig="separate"),
        share(DEEP_COLOUR),
    ),
    "tiff-4-bits": Shown(".tif", tiff(GREY >> 4, "minisblack", bitspersample=4), (GREY >> 4) / 15),
    "tiff-10-bits": packed(10),
    "tiff-12-bits": packed(12),
    "tiff-14-bits": packed(14),
    "tiff-half": floats(np.float16),
    "tiff-single": floats(np.float32),
    "tiff-double": floats(np.float64),
    "tiff-lzw": compressed("lzw", predictor=True),
    "tiff-deflate": compressed("zlib"),
    "tiff-packbits": compressed("packbits"),
    "tiff-zstd": compressed("zstd"),
    "tiff-jpeg-2000": compressed("jpeg2000"),
    "tiff-jpeg": Shown(
        ".tif",
        tiff(SMOOTH, "rgb", compression="jpeg", compressionargs={"level": 95}),
        share(SMOOTH),
    ),
    "tiff-palette": Shown(
        ".tif",
        tiff(GREY, "palette", colormap=PALETTE * 257),
        share(PALETTE.T[GREY[..., 0]].astype(np.uint8)),
    ),
    "tiff-cmyk": Shown(
        ".tif",
        tiff(np.concatenate([255 - COLOUR, np.zeros_like(GREY)], axis=-1), "separated"),
        share(COLOUR),
    ),
    "tiff-ycbcr": Shown(
        ".tif", tiff(YCBCR, "ycbcr"), ((YCBCR - [0.0, 128, 128]) @ LUMA.T).clip(0, 255) / 255
    ),
    "bmp-grey": Shown(".bmp", saved(GREY), share(GREY)),
    "bmp-colour": Shown(".bmp", saved(COLOUR), share(COLOUR)),
    "webp-colour": Shown(".webp", saved(COLOUR, lossless=True), share(COLOUR)),
    "webp-alpha": Shown(
        ".webp", saved(EIGHT, lossless=True, exact=True), share(COLOUR), share(EIGHT[..., 3])
    ),
    "pgm": grey_map(255),
    "pgm-of-200-levels": grey_map(199),
    "pgm-10-bits": grey_map(1023),
    "pgm-12-bits": grey_map(4095),
    "pgm-16-bits": grey_map(65535),
    "pgm-in-letters": Shown(
        ".pgm",
        whole(b"P2 3 2 4095\n", b"7 4095 2048\n100 3000 19\n"),
        np.array([[7, 4095, 2048], [100, 3000, 19]])[..., None] / 4095,
    ),
    "ppm": colour_map(255),
    "ppm-of-100-levels": colour_map(99),
}
"""A file of each format, depth and layout that the reader promises."""
LOSSY = {"jpeg-grey", "jpeg-colour", "jpeg-with-previews", "tiff-jpeg", "tiff-ycbcr"}
PROMISED["png-bilevel"] = PROMISED["png-bilevel"]._replace(
    coded=np.asarray(Image.fromarray(COLOUR).convert("1"))[..., None].astype(float)
)
PROMISED |= {slug: PROMISED[slug]._replace(atol=5 / 255) for slug in LOSSY}

_raw = partial(tiff, np.concatenate([DEEP_GREY, DEEP_GREY], axis=0))
REFUSED = {
    "fits": (".fits", whole(FITS), "a FITS file"),
    "jpeg-2000": (
        ".jp2",
        encoded(imagecodecs.jpeg2k_encode, np.ascontiguousarray(DEEP_COLOUR)),
        "a JPEG2000 file",
    ),
    "gif": (".gif", saved(GREY), "a GIF file"),
    "targa": (".tga", saved(COLOUR), "a TGA file"),
    "icon": (".ico", saved(EIGHT), "a ICO file"),
    "ppm-16-bits": (
        ".ppm",
        whole(b"P6 %d %d 65535\n" % (COLUMNS, ROWS), DEEP_COLOUR.astype(">u2").tobytes()),
        "a PPM of more than 8 bits a channel",
    ),
    "pfm": (
        ".pfm",
        whole(b"Pf %d %d -1.0\n" % (COLUMNS, ROWS), share(GREY).astype("<f4").tobytes()),
        "a map of floating-point values",
    ),
    "tiff-mosaic": (".tif", _raw(32803), "a TIFF whose values are CFA"),
    "tiff-lab": (".tif", tiff(COLOUR, "cielab"), "a TIFF whose values are CIELAB"),
    "tiff-deep-cmyk": (".tif", tiff(SIXTEEN, "separated"), "CMYK of 16 bits a channel"),
    "tiff-32-bits": (
        ".tif",
        tiff(DEEP_GREY.astype(np.uint32), "minisblack"),
        "whole numbers of 32 bits a channel",
    ),
    "tiff-signed": (
        ".tif",
        tiff((DEEP_GREY >> 2).astype(np.int16), "minisblack"),
        "16 bits a channel, int16",
    ),
    "tiff-bands": (
        ".tif",
        tiff(SIXTEEN, "minisblack", planarconfig="contig"),
        "a TIFF of 4 bands that are not said to be colours",
    ),
    "tiff-reduced-alone": (
        ".tif",
        tiff(COLOUR, "rgb", subfiletype=1),
        "a TIFF of reduced pictures alone",
    ),
}
"""Files that no promise is made of: how they end, what writes them, and the reason for refusing."""
