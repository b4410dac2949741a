"""TIFF at all of its bits, as it is meant to be seen.

Of 16 bits a channel under LZW tifffile alone unpacks nothing, and Pillow's libtiff keeps
only 8 bits of a colour. So each strip or tile is handed to it as a grey picture of bytes,
and the bytes are put together here.
"""

import struct
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from mishutter.model.upright import ORIENTATION, upright

LZW = 5
"""TIFF's number of the compression."""
_DIFFERENCES = 2
"""TIFF's number of the predictor that stores differences along a row."""
_WHITE_IS_ZERO, _BLACK_IS_ZERO, _RGB = range(3)
"""TIFF's numbers of what the values of a pixel stand for."""
_COLOUR_TIMES_ALPHA = 1
"""TIFF's number of an opacity that the colours are multiplied by."""
_SIGNATURES = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")


def is_tiff(path: Path) -> bool:
    """Whether a file begins as a TIFF does, whatever its name."""
    with path.open("rb") as file:
        return file.read(4) in _SIGNATURES


def read_tiff(path: Path, max_pixels: int) -> np.ndarray | None:
    """Pixels of a TIFF's first page, upright, or None of one that Pillow reads whole.

    Black is 0, and colours are not multiplied by opacity, however the file holds them.

    Raises:
        ValueError: with the reason, if it is larger than `max_pixels`, of another number
            of bits than pictures have, or damaged.
    """
    import tifffile

    with tifffile.TiffFile(path) as file:
        page: Any = file.pages[0]
        if page.imagewidth * page.imagelength > max_pixels:
            raise ValueError(f"{page.imagewidth} x {page.imagelength} pixels")
        if page.bitspersample not in (1, 2, 4, 8, 16, 32, 64):
            raise ValueError(f"{page.bitspersample} bits a channel")
        plain = page.photometric in (_WHITE_IS_ZERO, _BLACK_IS_ZERO, _RGB)
        stored = _stored(path, page) if plain and page.bitspersample >= 8 else None
        if stored is None:
            return None
        if page.photometric == _WHITE_IS_ZERO:
            stored = _full(stored) - stored
        if page.extrasamples == (_COLOUR_TIMES_ALPHA,):
            stored = _divided_by_alpha(stored)
        tag = page.tags.get(ORIENTATION)
        return upright(stored, 1 if tag is None else tag.value)


def _stored(path: Path, page: Any) -> np.ndarray | None:
    """Values as a page holds them, channels last; None under what only Pillow unpacks."""
    if is_packed_deep(page):
        return unpacked_page(path, page)
    try:
        array = page.asarray()
    except ValueError as error:
        if "imagecodecs" not in str(error):
            raise
        return None
    return np.moveaxis(array, 0, -1) if array.ndim == 3 and page.planarconfig == 2 else array


def _full(values: np.ndarray) -> Any:
    """What stands for white, or for opaque."""
    return np.iinfo(values.dtype).max if np.issubdtype(values.dtype, np.integer) else 1


def _divided_by_alpha(pixels: np.ndarray) -> np.ndarray:
    """Colours that opacity was multiplied into, without it; black where all is clear."""
    alpha, full = pixels[..., -1:].astype(np.float64), _full(pixels)
    colour = pixels[..., :-1] * np.divide(full, alpha, out=np.zeros_like(alpha), where=alpha > 0)
    colour = np.rint(colour) if full > 1 else colour
    return np.concatenate(
        [np.minimum(colour, full).astype(pixels.dtype), pixels[..., -1:]], axis=-1
    )


def is_packed_deep(page: Any) -> bool:
    """Whether a page is of 16 bits a channel, whole numbers, under LZW."""
    whole = page.sampleformat in (None, 1) and page.predictor in (1, _DIFFERENCES)
    return page.compression == LZW and page.bitspersample == 16 and whole


def unpacked_page(path: Path, page: Any) -> np.ndarray:
    """Pixels of such a page; shape `(rows, columns, channels)`, uint16.

    Raises:
        OSError: if a strip or tile is damaged.
        ValueError: if there are not as many as the page needs.
    """
    separate = page.planarconfig == 2
    channels = 1 if separate else page.samplesperpixel
    planes = page.samplesperpixel if separate else 1
    height = page.tilelength if page.is_tiled else min(page.rowsperstrip, page.imagelength)
    width = page.tilewidth if page.is_tiled else page.imagewidth
    grid = (planes, -(-page.imagelength // height), -(-page.imagewidth // width))
    if len(page.dataoffsets) != np.prod(grid):
        raise ValueError(f"{len(page.dataoffsets)} strips or tiles, not {np.prod(grid)}")
    order = page.parent.byteorder
    picture = np.empty((planes, grid[1] * height, grid[2] * width, channels), np.uint16)
    with path.open("rb") as file:
        for place, offset, size in zip(
            np.ndindex(*grid), page.dataoffsets, page.databytecounts, strict=True
        ):
            file.seek(offset)
            top, left = place[1] * height, place[2] * width
            rows = height if page.is_tiled else min(height, page.imagelength - top)
            lines = _unpacked(file.read(size), rows, 2 * width * channels)
            values = lines.view(f"{order}u2").reshape(rows, width, channels)
            if page.predictor == _DIFFERENCES:
                values = np.cumsum(values, axis=1, dtype=np.uint16)
            picture[place[0], top : top + rows, left : left + width] = values
    whole = picture[:, : page.imagelength, : page.imagewidth]
    return whole[..., 0].transpose(1, 2, 0) if separate else whole[0]


def _unpacked(data: bytes, rows: int, width: int) -> np.ndarray:
    """Bytes of a strip or tile, by way of a grey TIFF made up around it."""
    from PIL import Image

    first = 8 + 2 + 12 * 9 + 4
    entries = [
        (256, width),
        (257, rows),
        (258, 8),
        (259, LZW),
        (262, 1),
        (273, first),
        (277, 1),
        (278, rows),
        (279, len(data)),
    ]
    fields = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in entries)
    head = struct.pack("<2sHIH", b"II", 42, 8, len(entries)) + fields + struct.pack("<I", 0)
    with Image.open(BytesIO(head + data)) as made_up:
        return np.ascontiguousarray(made_up)
