"""PNG at 16 bits a channel, which Pillow neither reads nor writes in colour."""

import os
import struct
import tempfile
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np

from mishutter._core import move_into_place
from mishutter.model.upright import ORIENTATION, upright

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_CHANNELS = {0: 1, 2: 3, 4: 2, 6: 4}
_COLOUR_TYPE = {channels: colour for colour, channels in _CHANNELS.items()}
_ADAM7 = ((0, 0, 8, 8), (0, 4, 8, 8), (4, 0, 8, 4), (0, 2, 4, 4), (2, 0, 4, 2), (0, 1, 2, 2),
          (1, 0, 2, 1))  # fmt: skip
_ROWS_AT_ONCE = 256


def is_deep_png(path: Path) -> bool:
    """Whether a file is a PNG of 16 bits a channel with more than one channel."""
    with path.open("rb") as file:
        head = file.read(26)
    return head[:8] == _SIGNATURE and len(head) == 26 and head[24] == 16 and head[25] in (2, 4, 6)


def read_deep_png(path: Path, max_pixels: int) -> np.ndarray:
    """Decode a 16-bit PNG, upright; shape `(rows, columns, channels)`, uint16.

    Raises:
        ValueError: with the reason, if it is damaged or larger than `max_pixels`.
    """
    with path.open("rb") as file:
        file.seek(8)
        chunks = list(_chunks(file))
    header = dict(chunks).get(b"IHDR", b"")
    if len(header) != 13:
        raise ValueError("a PNG without a header")
    columns, rows, _, colour, _, _, interlaced = struct.unpack(">IIBBBBB", header)
    if rows * columns > max_pixels:
        raise ValueError(f"{columns} x {rows} pixels")
    channels = _CHANNELS[colour]
    starts = _ADAM7 if interlaced else ((0, 0, 1, 1),)
    passes = [(s, _pass_shape(rows, columns, s)) for s in starts]
    sizes = [r * (1 + 2 * channels * c) if r and c else 0 for _, (r, c) in passes]
    packed = b"".join(data for kind, data in chunks if kind == b"IDAT")
    try:
        raw = zlib.decompressobj().decompress(packed, sum(sizes))
    except zlib.error as error:
        raise ValueError("a damaged PNG") from error
    if len(raw) < sum(sizes):
        raise ValueError("a truncated PNG")
    picture = np.empty((rows, columns, channels), np.uint16)
    first = 0
    for ((top, left, down, across), (r, c)), size in zip(passes, sizes, strict=True):
        if size:
            lines = np.frombuffer(raw, np.uint8, size, first).reshape(r, -1)
            values = _unfiltered(lines[:, 0], lines[:, 1:], 2 * channels)
            picture[top::down, left::across] = values.view(">u2").reshape(r, c, channels)
        first += size
    return upright(picture, _orientation(dict(chunks).get(b"eXIf", b"")))


def write_deep_png(path: Path, rows_of: Callable[[slice], np.ndarray], shape: tuple) -> None:
    """Write a 16-bit PNG, whole or not at all.

    Args:
        path: Where to.
        rows_of: Gives the rows of a slice; uint16, shape `(rows, columns, channels)`.
        shape: Shape of the whole.

    Raises:
        OSError: if the folder cannot be written.
    """
    rows, columns, channels = shape
    header = struct.pack(">IIBBBBB", columns, rows, 16, _COLOUR_TYPE[channels], 0, 0, 0)
    descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(_SIGNATURE + _chunk(b"IHDR", header))
            for data in _compressed(rows_of, rows, columns * channels):
                file.write(_chunk(b"IDAT", data))
            file.write(_chunk(b"IEND", b""))
        move_into_place(name, path)
    except BaseException:
        Path(name).unlink(missing_ok=True)
        raise


def _orientation(exif: bytes) -> int:
    from PIL import Image

    tags = Image.Exif()
    tags.load(exif)
    return tags.get(ORIENTATION, 1)


def _compressed(rows_of: Callable[[slice], np.ndarray], rows: int, width: int) -> Iterator[bytes]:
    packer = zlib.compressobj(3, strategy=zlib.Z_FILTERED)
    above = np.zeros((1, 2 * width), np.uint8)
    for top in range(0, rows, _ROWS_AT_ONCE):
        block = rows_of(slice(top, min(top + _ROWS_AT_ONCE, rows)))
        lines = np.ascontiguousarray(block, ">u2").view(np.uint8).reshape(len(block), -1)
        difference = np.diff(lines, axis=0, prepend=above)
        above = lines[-1:].copy()
        up = np.concatenate([np.full((len(lines), 1), 2, np.uint8), difference], axis=1)
        data = packer.compress(up.tobytes())
        if data:
            yield data
    yield packer.flush()


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def _chunks(file: BinaryIO) -> Iterator[tuple[bytes, bytes]]:
    while len(head := file.read(8)) == 8:
        length, kind = struct.unpack(">I4s", head)
        data = file.read(length)
        check = file.read(4)
        if len(data) < length or len(check) < 4:
            raise ValueError("a truncated PNG")
        if zlib.crc32(kind + data) != struct.unpack(">I", check)[0]:
            raise ValueError("a damaged PNG")
        yield kind, data
        if kind == b"IEND":
            return
    raise ValueError("a truncated PNG")


def _pass_shape(rows: int, columns: int, start: tuple[int, int, int, int]) -> tuple[int, int]:
    top, left, down, across = start
    return -(-(rows - top) // down), -(-(columns - left) // across)


def _unfiltered(kinds: np.ndarray, lines: np.ndarray, pixel: int) -> np.ndarray:
    """Undo the row filters of PNG (its section 9); shape of `lines`, uint8.

    A byte depends on those to its left, above, and above left. All bytes of an
    anti-diagonal of pixels are therefore done at once, whatever filter each row has.
    """
    rows, width = lines.shape
    columns = width // pixel
    out = np.zeros((rows + 1, columns + 1, pixel), np.int16)
    coded = lines.reshape(rows, columns, pixel)
    for diagonal in range(rows + columns - 1):
        r = np.arange(max(0, diagonal - columns + 1), min(rows, diagonal + 1))
        c = diagonal - r
        left, up, corner = out[r + 1, c], out[r, c + 1], out[r, c]
        to_left, to_up = np.abs(up - corner), np.abs(left - corner)
        to_corner = np.abs(left + up - 2 * corner)
        paeth = np.where(
            (to_left <= to_up) & (to_left <= to_corner),
            left,
            np.where(to_up <= to_corner, up, corner),
        )
        kind = kinds[r, None]
        guess = np.select(
            [kind == 1, kind == 2, kind == 3, kind == 4], [left, up, (left + up) // 2, paeth], 0
        )
        out[r + 1, c + 1] = (coded[r, c] + guess) & 255
    return np.ascontiguousarray(out[1:, 1:]).astype(np.uint8).reshape(rows, width)
