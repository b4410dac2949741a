"""Reads the pixels of a picture file at its full depth, and encodes a 16-bit PNG."""

import logging
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from jaxtyping import UInt16

if TYPE_CHECKING:
    from PIL import Image
    from tifffile import TiffFile, TiffPage

MAX_PIXELS = 150_000_000
"""The reader refuses a larger picture before it decodes it."""
PICTURE_FORMATS = "PNG, JPEG, TIFF, BMP, WebP, PGM or PPM"
"""Formats that are read, each of them under test; any other is refused."""
PICTURE_SUFFIXES = (
    ".png",
    *(".jpg", ".jpeg"),
    *(".tif", ".tiff"),
    ".bmp",
    ".webp",
    *(".pgm", ".ppm"),
)
"""Suffixes of such files; the contents of a file decide its format."""
_BY_PILLOW = ("PNG", "JPEG", "MPO", "TIFF", "BMP", "WEBP", "PPM")
"""Pillow's names for these formats; a telephone's JPEG with further pictures in it is an MPO."""
_ORIENTATION = 274
"""Number of the TIFF and EXIF tag that says how a picture is stored."""
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_TIFF_SIGNATURES = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_WHITE_IS_ZERO, _BLACK_IS_ZERO, _RGB = range(3)
"""TIFF's numbers for the meaning of a pixel's values."""
_CONVERTED = {3: "palette", 5: "CMYK", 6: "YCbCr"}
"""TIFF's numbers for colours that Pillow converts to RGB."""
_PREMULTIPLIED_ALPHA, _PLAIN_ALPHA = 1, 2
"""TIFF's numbers for a band of opacity, which multiplies the stored colours or does not."""

# Prevents a second line on standard error beside the error of a damaged file.
logging.getLogger("tifffile").addHandler(logging.NullHandler())


class Decoded(NamedTuple):
    """Values of a picture as its file holds them, upright.

    Attributes:
        colour: Grey, or red, green and blue; shape `(rows, columns, 1 or 3)`.
        alpha: Opacity in `[0, 1]`, if the file holds one; shape `(rows, columns)`.
        full: Value of white at the depth that the file states.
        has_more: Whether the file holds further pictures, which are not read.
    """

    colour: np.ndarray
    alpha: np.ndarray | None
    full: float
    has_more: bool = False


def decoded(path: Path) -> Decoded:
    """A picture as its file holds it.

    Raises:
        OSError: if the file cannot be read.
        Exception: with the reason, if the file is no picture of a format that is read, is damaged
            or has too many pixels.
    """
    with path.open("rb") as file:
        head = file.read(25)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if head.startswith(_TIFF_SIGNATURES):
            return _decoded_tiff(path)
        if head.startswith(_PNG_SIGNATURE) and head[24:] == b"\x10":
            return _decoded_deep_png(path)
        return _decoded_by_pillow(path)


def deep_png(pixels: UInt16[np.ndarray, "rows columns channels"]) -> bytes:
    """A PNG of 16 bits a channel, by the settings with which OpenCV encodes quickly.

    Args:
        pixels: Shape `(rows, columns, channels)`, uint16.
    """
    import imagecodecs

    png = imagecodecs.PNG
    encoded = imagecodecs.png_encode(
        pixels, png.COMPRESSION.SPEED, strategy=png.STRATEGY.RLE, filter=png.FILTER.SUB
    )
    return bytes(encoded)


def _decoded_deep_png(path: Path) -> Decoded:
    """A PNG of 16 bits a channel; Pillow would keep only 8 bits of a colour picture."""
    import imagecodecs
    from PIL import Image

    with Image.open(path) as file:
        _require_size(file.width, file.height)
        orientation = file.getexif().get(_ORIENTATION, 1)
        has_more = _has_more(file)
    pixels = _upright(imagecodecs.png_decode(path.read_bytes()), orientation)
    return _with_alpha_last(pixels, has_more)


def _with_alpha_last(pixels: np.ndarray, has_more: bool) -> Decoded:
    """Splits opacity, the last of two or four channels, from grey or colour."""
    pixels = pixels[..., None] if pixels.ndim == 2 else pixels
    full = float(np.iinfo(pixels.dtype).max)
    if pixels.shape[2] not in (2, 4):
        return Decoded(pixels, None, full, has_more)
    return Decoded(pixels[..., :-1], _share(pixels[..., -1], full), full, has_more)


def _share(alpha: np.ndarray, full: float) -> np.ndarray:
    return np.clip(alpha.astype(np.float32) / np.float32(full), 0, 1)


def _decoded_tiff(path: Path) -> Decoded:
    """The first picture of a TIFF that is neither of reduced size nor a mask.

    In the result black is 0 and colours are not multiplied by opacity, whatever the file holds.
    """
    import tifffile

    with tifffile.TiffFile(path) as file:
        pages = _whole_pages(file)
        index, page = next(pages, (None, None))
        if page is None:
            raise ValueError("a TIFF of reduced pictures alone")
        has_more = next(pages, None) is not None
        _require_size(page.imagewidth, page.imagelength)
        meaning = page.photometric
        if meaning in _CONVERTED or (meaning <= _BLACK_IS_ZERO and _has_few_bits(page)):
            if not _has_few_bits(page, most=8):
                raise ValueError(f"{_CONVERTED[meaning]} of {page.bitspersample} bits a channel")
            if index is None:
                raise ValueError("a TIFF whose picture lies within a page of another")
            return _decoded_by_pillow(path, index)._replace(has_more=has_more)
        if meaning not in (_WHITE_IS_ZERO, _BLACK_IS_ZERO, _RGB):
            raise ValueError(f"a TIFF whose values are {getattr(meaning, 'name', meaning)}")
        first: Any = file.pages[0]
        tag = page.tags.get(_ORIENTATION) or first.tags.get(_ORIENTATION)
        pixels = _direct(page, 1 if tag is None else tag.value)
        return pixels._replace(has_more=has_more)


def _whole_pages(file: "TiffFile") -> Iterator[tuple[int | None, "TiffPage"]]:
    """Pictures of full size, each after its page number, which is None for one within a page.

    Raw files begin with a small picture, whose page holds the others.
    """
    pages: Any = file.pages
    for index, page in enumerate(pages):
        within = page.pages or ()
        for number, each in ((index, page), *((None, inner) for inner in within)):
            if not (each.is_reduced or each.is_mask):
                yield number, each


def _has_few_bits(page: "TiffPage", most: int = 7) -> bool:
    """Whether a channel has at most `most` bits; Pillow reads such grey values right."""
    return isinstance(page.bitspersample, int) and page.bitspersample <= most


def _direct(page: "TiffPage", orientation: int) -> Decoded:
    """Values of a page that is grey, or red, green and blue, without Pillow."""
    bits, dtype = page.bitspersample, page.dtype
    if not isinstance(bits, int) or dtype is None or dtype.kind not in "uf" or bits > 64:
        raise ValueError(f"{bits} bits a channel, {'of no kind' if dtype is None else dtype.name}")
    if dtype.kind == "u" and bits > 16:
        raise ValueError(f"whole numbers of {bits} bits a channel")
    pixels = page.asarray()
    if page.samplesperpixel > 1 and page.planarconfig == 2:
        pixels = np.moveaxis(pixels, 0, -1)
    pixels = pixels if page.samplesperpixel > 1 else pixels.reshape(*pixels.shape[:2], 1)
    num_colours, extras = 3 if page.photometric == _RGB else 1, list(page.extrasamples)
    extra = pixels.shape[2] - num_colours
    if extra < 0 or (num_colours == 1 and extra > 1):
        raise ValueError(f"a TIFF of {pixels.shape[2]} bands that are not said to be colours")
    full = float((1 << bits) - 1) if dtype.kind == "u" else 1.0
    colour, alpha = pixels[..., :num_colours], None
    if page.photometric == _WHITE_IS_ZERO:
        colour = (full - colour).astype(dtype)
    kinds = [kind for kind in extras if kind in (_PREMULTIPLIED_ALPHA, _PLAIN_ALPHA)]
    if kinds:
        alpha = _share(pixels[..., num_colours + extras.index(kinds[0])], full)
        if kinds[0] == _PREMULTIPLIED_ALPHA:
            colour = _divided_by_alpha(colour, alpha, full)
        alpha = _upright(alpha, orientation)
    return Decoded(_upright(colour, orientation), alpha, full)


def _divided_by_alpha(colour: np.ndarray, alpha: np.ndarray, full: float) -> np.ndarray:
    """Colours divided by the opacity that multiplies them; black where the opacity is 0."""
    share = alpha[..., None].astype(np.float64)
    plain = colour * np.divide(1, share, out=np.zeros_like(share), where=share > 0)
    plain = np.rint(plain) if colour.dtype.kind == "u" else plain
    return np.minimum(plain, full).astype(colour.dtype)


def _upright(pixels: np.ndarray, orientation: int) -> np.ndarray:
    """Pixels `(rows, columns, ...)` turned by their orientation tag; 1 leaves them alone."""
    turned = pixels.swapaxes(0, 1) if orientation in (5, 6, 7, 8) else pixels
    turned = turned[:, ::-1] if orientation in (2, 3, 6, 7) else turned
    return turned[::-1] if orientation in (3, 4, 7, 8) else turned


def _require_size(columns: int, rows: int) -> None:
    if columns * rows > MAX_PIXELS:
        raise ValueError(f"{columns} x {rows} pixels")


def _has_more(file: "Image.Image") -> bool:
    """Whether a file holds more pictures of equal standing; a telephone's previews are not."""
    return file.format != "MPO" and getattr(file, "n_frames", 1) > 1


def _decoded_by_pillow(path: Path, page: int = 0) -> Decoded:
    from PIL import Image, ImageOps

    with Image.open(path) as file:
        if file.format not in _BY_PILLOW:
            raise ValueError(f"a {file.format} file")
        _require_size(file.width, file.height)
        has_more = _has_more(file)
        if page:
            file.seek(page)
        if file.format == "PPM":
            return _decoded_map(file)
        upright = ImageOps.exif_transpose(file)
        has_alpha = "transparency" in upright.info or upright.mode in ("LA", "PA", "RGBA", "La")
        if upright.mode in ("L", "RGB", "RGBA", "LA"):
            mode = "RGBA" if has_alpha and upright.mode in ("L", "RGB") else upright.mode
        else:
            mode = "RGBA" if has_alpha else "L" if upright.mode == "1" else "RGB"
        pixels = np.asarray(upright.convert(mode) if mode != upright.mode else upright)
    return _with_alpha_last(pixels, has_more)


def _decoded_map(file: "Image.Image") -> Decoded:
    """A PGM or PPM picture, whose header gives the value of white."""
    how: Any = file.tile[0][3]  # type: ignore[attr-defined]
    white = how[-1] if isinstance(how, tuple) else 65535 if how == "I;16B" else 255
    if file.mode not in ("1", "L", "I", "RGB"):
        raise ValueError("a map of floating-point values")
    if file.mode == "RGB" and white > 255:
        raise ValueError("a PPM of more than 8 bits a channel")
    pixels = np.asarray(file.convert("L") if file.mode == "1" else file)
    # Pillow stretches values to 8 or 16 bits and rounds; scaled back and rounded they are exact.
    stretch = white / (65535 if file.mode == "I" else 255)
    values = np.rint(pixels * stretch).astype(np.uint16 if white > 255 else np.uint8)
    return Decoded(values[..., None] if values.ndim == 2 else values, None, float(white))
