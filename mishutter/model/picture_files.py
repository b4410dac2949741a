"""Pixels of a picture file at all of its bits, and of a 16-bit PNG."""

import logging
import warnings
from pathlib import Path
from typing import Any

import numpy as np

MAX_PIXELS = 150_000_000
"""The reader refuses a larger picture before it decodes it."""
_ORIENTATION = 274
"""Number of the TIFF and EXIF tag that says how a picture is stored."""
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_TIFF_SIGNATURES = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_WHITE_IS_ZERO, _BLACK_IS_ZERO, _RGB = range(3)
"""TIFF's numbers for the meaning of a pixel's values."""
_PREMULTIPLIED_ALPHA = 1
"""TIFF's number for an opacity that multiplies the stored colours."""

# Prevents a second line on standard error beside the error of a damaged file.
logging.getLogger("tifffile").addHandler(logging.NullHandler())


def decoded(path: Path) -> np.ndarray:
    """Pixels as the file holds them, upright; `(rows, columns)` or with channels last.

    Raises:
        OSError: if the file cannot be read.
        Exception: with the reason, if it is not a picture, damaged or of too many pixels.
    """
    with path.open("rb") as file:
        head = file.read(25)
    pixels = None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if head.startswith(_TIFF_SIGNATURES):
            pixels = _decoded_tiff(path)
        elif head.startswith(_PNG_SIGNATURE) and head[24:] == b"\x10":
            pixels = _decoded_deep_png(path)
        return _decoded_by_pillow(path) if pixels is None else pixels


def deep_png(pixels: np.ndarray) -> bytes:
    """A PNG of 16 bits a channel, by the settings with which OpenCV encodes quickly.

    Args:
        pixels: Shape `(rows, columns, channels)`, uint16.
    """
    import imagecodecs

    png = imagecodecs.PNG
    options = {"strategy": png.STRATEGY.RLE, "filter": png.FILTER.SUB}
    return bytes(imagecodecs.png_encode(pixels, png.COMPRESSION.SPEED, **options))


def _decoded_deep_png(path: Path) -> np.ndarray:
    """Pixels of a PNG of 16 bits a channel, of which Pillow would keep 8 in colour."""
    import imagecodecs
    from PIL import Image

    with Image.open(path) as file:
        _require_size(file.width, file.height)
        orientation = file.getexif().get(_ORIENTATION, 1)
    return _upright(imagecodecs.png_decode(path.read_bytes()), orientation)


def _decoded_tiff(path: Path) -> np.ndarray | None:
    """Pixels of a TIFF's first page, or None of one whose colours Pillow must convert.

    Black is 0, and opacity does not multiply the colours, whatever the file holds.
    """
    import tifffile

    with tifffile.TiffFile(path) as file:
        page: Any = file.pages[0]
        _require_size(page.imagewidth, page.imagelength)
        if page.bitspersample not in (1, 2, 4, 8, 16, 32, 64):
            raise ValueError(f"{page.bitspersample} bits a channel")
        is_direct = page.photometric in (_WHITE_IS_ZERO, _BLACK_IS_ZERO, _RGB)
        if not is_direct or page.bitspersample < 8:
            return None
        pixels = page.asarray()
        if pixels.ndim == 3 and page.planarconfig == 2:
            pixels = np.moveaxis(pixels, 0, -1)
        if page.photometric == _WHITE_IS_ZERO:
            pixels = _full_scale(pixels) - pixels
        if page.extrasamples == (_PREMULTIPLIED_ALPHA,):
            pixels = _divided_by_alpha(pixels)
        tag = page.tags.get(_ORIENTATION)
        return _upright(pixels, 1 if tag is None else tag.value)


def _full_scale(values: np.ndarray) -> Any:
    """The value that means white, or opaque."""
    return np.iinfo(values.dtype).max if np.issubdtype(values.dtype, np.integer) else 1


def _divided_by_alpha(pixels: np.ndarray) -> np.ndarray:
    """Colours without the opacity that multiplies them; black where they are clear."""
    alpha, full = pixels[..., -1:].astype(np.float64), _full_scale(pixels)
    colour = pixels[..., :-1] * np.divide(full, alpha, out=np.zeros_like(alpha), where=alpha > 0)
    colour = np.rint(colour) if full > 1 else colour
    return np.concatenate(
        [np.minimum(colour, full).astype(pixels.dtype), pixels[..., -1:]], axis=-1
    )


def _upright(pixels: np.ndarray, orientation: int) -> np.ndarray:
    """Pixels `(rows, columns, ...)` turned by their orientation tag; 1 leaves them alone."""
    turned = pixels.swapaxes(0, 1) if orientation in (5, 6, 7, 8) else pixels
    turned = turned[:, ::-1] if orientation in (2, 3, 6, 7) else turned
    return turned[::-1] if orientation in (3, 4, 7, 8) else turned


def _require_size(columns: int, rows: int) -> None:
    if columns * rows > MAX_PIXELS:
        raise ValueError(f"{columns} x {rows} pixels")


def _decoded_by_pillow(path: Path) -> np.ndarray:
    from PIL import Image, ImageOps

    with Image.open(path) as file:
        _require_size(file.width, file.height)
        upright = ImageOps.exif_transpose(file)
        has_alpha = "transparency" in upright.info or upright.mode in ("LA", "PA", "RGBA", "La")
        if upright.mode in ("L", "RGB", "RGBA", "LA", "F", "I", "I;16", "I;16B"):
            wanted = "RGBA" if has_alpha and upright.mode in ("L", "RGB") else upright.mode
        else:
            wanted = "RGBA" if has_alpha else "L" if upright.mode == "1" else "RGB"
        pixels = np.asarray(upright.convert(wanted) if wanted != upright.mode else upright)
    # Pillow holds the 16 bits of a PGM in 32.
    return pixels.astype(np.uint16) if pixels.dtype == np.int32 else pixels
