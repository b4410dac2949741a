"""TIFF at 16 bits a channel under LZW, which tifffile alone does not unpack, nor Pillow whole.

Pillow's libtiff unpacks bytes but keeps only 8 bits of a colour of 16. So each strip or
tile is handed to it as a grey picture of bytes, and the bytes are put together here.
"""

import struct
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

LZW = 5
"""TIFF's number of the compression."""
_DIFFERENCES = 2
"""TIFF's number of the predictor that stores differences along a row."""


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
