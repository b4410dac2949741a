"""Reads the pixels of a picture file at its full depth, and encodes PNGs and TIFFs."""

import io
import itertools
import logging
import math
import re
import warnings
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
from jaxtyping import UInt16

if TYPE_CHECKING:
    from PIL import Image
    from tifffile import TiffFile, TiffFrame, TiffPage, TiffPageSeries

MAX_PIXELS = 150_000_000
"""The reader refuses a larger picture before it decodes it."""
PICTURE_FORMATS = "PNG, JPEG, TIFF, BMP, WebP, PGM or PPM"
"""Formats that are read, each of them under test; any other is refused."""
PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp", ".pgm", ".ppm")
"""Suffixes of such files; the contents of a file decide its format."""
VIDEO_SUFFIXES = (
    *(".3gp", ".asf", ".avi", ".flv", ".gif", ".m2ts", ".m4v", ".mkv", ".mov", ".mp4"),
    *(".mpeg", ".mpg", ".mts", ".ogv", ".ts", ".webm", ".wmv"),
)
"""Suffixes of video files. FFmpeg also reads single pictures, and some of them wrongly."""
_ORIENTATION = 274
"""Number of the TIFF and EXIF tag that says how a picture is stored."""
_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PNG_PIXELS = (b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND")
"""Chunks of a PNG that its pixels need."""
_TIFF_SIGNATURES = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_WHITE_IS_ZERO, _BLACK_IS_ZERO, _RGB = range(3)
"""TIFF's numbers for the meaning of a pixel's values."""
_CONVERTED = {3: "palette", 5: "CMYK", 6: "YCbCr"}
"""TIFF's numbers for colours that Pillow converts to RGB."""
_TRANSFERS = {
    **dict.fromkeys((1, 4, 6, 7, 11, 12, 13, 14, 15), 2.2),
    **{5: 2.8, 8: 1.0, 16: "PQ", 18: "HLG"},
}
"""Transfer functions by their numbers in H.273: the exponent of a power, or near it, or a name."""

# Prevents a second line on standard error beside the error of a damaged file.
logging.getLogger("tifffile").addHandler(logging.NullHandler())


def pictures_in(folder: Path, *others: str) -> list[Path]:
    """The pictures of a folder in the order of the numbers in their names: 2 before 10.

    Args:
        folder: The folder.
        others: Suffixes of other files that are wanted.
    """
    suffixes = *PICTURE_SUFFIXES, *others
    files = sorted(path for path in folder.iterdir() if path.suffix.lower() in suffixes)
    return sorted(files, key=lambda path: by_numbers(path.name))


def by_numbers(name: str) -> list[str | int]:
    """A name as its texts and numbers in turn."""
    return [int(x) if k % 2 else x for k, x in enumerate(re.split(r"(\d+)", name))]


class Decoded(NamedTuple):
    """Values of a picture as its file holds them, upright."""

    colour: np.ndarray  # Grey, or red, green and blue; shape `(rows, columns, 1 or 3)`
    alpha: np.ndarray | None  # Opacity in `[0, 1]`, if the file holds one; shape `(rows, columns)`
    full: float  # Value of white at the depth that the file states
    has_more: bool = False  # Whether the file holds further pictures, which are not read
    # Power by which light follows from the values, if the file states one
    exponent: float | None = None
    # A meaning of the values that the file states and that is not read; `""` for none
    doubt: str = ""

    @staticmethod
    def of(pixels: np.ndarray, has_more: bool) -> "Decoded":
        """Splits opacity, the last of two or four channels, from grey or colour."""
        pixels = pixels[..., None] if pixels.ndim == 2 else pixels
        full = float(np.iinfo(pixels.dtype).max)
        if pixels.shape[2] not in (2, 4):
            return Decoded(pixels, None, full, has_more)
        return Decoded(pixels[..., :-1], _share(pixels[..., -1], full), full, has_more)


def is_tiff(path: Path) -> bool:
    """Whether a file begins as a TIFF does."""
    with path.open("rb") as file:
        return file.read(8).startswith(_TIFF_SIGNATURES)


class GreyFrames(NamedTuple):
    """Frames of a TIFF in the order of time, as the file holds them."""

    frames: np.ndarray  # Whole or floating-point levels; shape `(frames, rows, columns)`
    has_more: bool  # Whether the file holds further frames, which are not read
    word: str  # A sentence on axes that were read otherwise than one would expect; `""` for none


def grey_frames(path: Path, most: int | None) -> GreyFrames | None:
    """The frames of a TIFF by the axes that it states; None if its pages are no plain numbers.

    Of channels, depths and whatever else stands beside time, the first is taken.
    """
    import tifffile

    with tifffile.TiffFile(path) as file:
        series = file.series[0]
        key = series.keyframe
        _require_size(key.imagewidth, key.imagelength)
        tag = key.tags.get(_ORIENTATION)
        is_plain = (
            key.photometric == _BLACK_IS_ZERO
            and key.samplesperpixel == 1
            and key.dtype is not None
            and key.bitspersample == 8 * key.dtype.itemsize
            and (tag is None or tag.value == 1)
            and not key.is_reduced
            and series.axes.endswith("YX")
        )
        if not is_plain:
            return None
        numbers, word = _in_time(series)
        if len(file.series) > 1 and series.axes == "YX":
            # Each page was written as a picture of its own.
            alike = [each for each in file.series if each.shape == series.shape]
            pages = [each.keyframe for each in alike]
        elif len(series.pages) < series.size // (key.imagewidth * key.imagelength):
            # ImageJ describes the first frame of more than 4 GB alone; others follow its bytes.
            whole = tifffile.memmap(path, mode="r").reshape(-1, key.imagelength, key.imagewidth)
            return GreyFrames(whole[numbers[:most]], len(numbers) > len(numbers[:most]), word)
        else:
            # Frames of one set may lie in many files: those of this one are read.
            each = (series.pages[number] for number in numbers)
            pages = [page for page in each if page is not None and page.parent is file]
        for page in pages[:most]:
            _require_strips(page, key)
        frames = [page.asarray().reshape(key.imagelength, key.imagewidth) for page in pages[:most]]
        return GreyFrames(np.stack(frames), len(pages) > len(frames), word)


def _in_time(series: "TiffPageSeries") -> tuple[np.ndarray, str]:
    """Numbers of the pages of a series that follow each other in time, and a word on its axes."""
    axes, shape = series.axes[:-2], series.shape[:-2]
    # An axis without a name is of frames; some programs call frames depths, or channels.
    order = sorted(axes, key=lambda axis: {"T": 0, "Z": 2, "C": 3}.get(axis, 1))
    numbers = np.arange(math.prod(shape)).reshape(shape)
    if not order:
        return numbers.reshape(1), ""
    time = order[0]
    if time == "C" and series.kind == "ome":
        raise ValueError(f"its axes {series.axes} are channels (C) of one time: it holds no clip")
    others = [k for k in range(len(axes)) if k != axes.index(time)]
    for k in reversed(others):
        numbers = numbers.take(0, axis=k)
    size = " x ".join(map(str, series.shape))
    words = [f"the axes of the file are {series.axes}, {size}"]
    if time in "ZC":
        words.append(f"{'depths' if time == 'Z' else 'channels'} ({time}) are taken for times")
    if others:
        words.append(f"the first of {' and '.join(axes[k] for k in others)} is taken")
    return np.asarray(numbers), ": ".join([words[0], " and ".join(words[1:])]) if len(
        words
    ) > 1 else ""


def header_size(content: bytes) -> tuple[int, int]:
    """Columns and rows of the first whole picture of a file by its header, without decoding it."""
    if content.startswith(_TIFF_SIGNATURES):
        # Pillow knows no TIFF of colours in floating-point numbers.
        import tifffile

        with tifffile.TiffFile(io.BytesIO(content)) as file:
            _, page = next(_whole_pages(file))
            return page.imagewidth, page.imagelength
    from PIL import Image

    with Image.open(io.BytesIO(content)) as picture:
        return picture.size


def decoded(path: Path, number: int = 0) -> Decoded:
    """A picture as its file holds it."""
    with path.open("rb") as file:
        head = file.read(8)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if head.startswith(_TIFF_SIGNATURES):
            return _decoded_tiff(path, number)
        if head.startswith(_PNG_SIGNATURE):
            return _decoded_png(path)
        return _decoded_by_pillow(path)


def deep_png(pixels: UInt16[np.ndarray, "rows columns channels"]) -> bytes:
    """A PNG of 16 bits a channel, by the settings with which OpenCV encodes quickly."""
    import imagecodecs

    png = imagecodecs.PNG
    encoded = imagecodecs.png_encode(
        pixels, png.COMPRESSION.SPEED, strategy=png.STRATEGY.RLE, filter=png.FILTER.SUB
    )
    return bytes(encoded)


def tiff_like(pixels: np.ndarray, path: Path) -> bytes:
    """A TIFF of pixels, with the size of a pixel that another TIFF states."""
    import tifffile

    with tifffile.TiffFile(path) as file:
        page = file.pages.first
        unit = (file.imagej_metadata or {}).get("unit")
    content = io.BytesIO()
    is_grey = pixels.shape[2] == 1
    tifffile.imwrite(
        content,
        pixels[..., 0] if is_grey else pixels,
        photometric="minisblack" if is_grey else "rgb",
        resolution=page.resolution,
        resolutionunit=page.resolutionunit,
        description=None if unit is None else f"ImageJ=\nunit={unit}\n",
        metadata=None,
    )
    return content.getvalue()


def _decoded_png(path: Path) -> Decoded:
    """A PNG of any depth; of 16 bits a channel, Pillow would keep only 8 of a colour picture."""
    import imagecodecs
    from PIL import Image

    content = path.read_bytes()
    chunks, shown = _png_chunks(content)
    exponent, doubt = _png_coding(chunks)
    pixels = imagecodecs.png_decode(shown)  # refuses missing rows, which Pillow leaves black
    if chunks[b"IHDR"][8] <= 8:
        return _decoded_by_pillow(path)._replace(exponent=exponent, doubt=doubt)
    with Image.open(path) as file:
        orientation = file.getexif().get(_ORIENTATION, 1)
        has_more = _has_more(file)
    pixels = _upright(pixels, orientation)
    return Decoded.of(pixels, has_more)._replace(exponent=exponent, doubt=doubt)


def _png_chunks(content: bytes) -> tuple[dict[bytes, bytes], bytes]:
    """The chunks of a PNG by their names, without its pixels, and the PNG of its pixels alone.

    None may be missing or damaged. The second is without what the decoder would only warn of on
    standard error, as of a colour profile that breaks a rule.
    """
    view, place, chunks = memoryview(content), len(_PNG_SIGNATURE), {}
    shown = [view[:place]]
    while b"IEND" not in chunks:
        size = int.from_bytes(view[place : place + 4], "big")
        name = bytes(view[place + 4 : place + 8])
        data, check = view[place + 8 :][:size], view[place + 8 + size :][:4]
        if len(check) < 4:
            raise ValueError("it ends early")
        if int.from_bytes(check, "big") != zlib.crc32(data, zlib.crc32(name)):
            raise ValueError(f"the check sum of a chunk {name.decode('latin-1')!r} is another")
        if not chunks:
            if name != b"IHDR" or size != 13:
                raise ValueError("it does not begin with its header")
            _require_size(*(int.from_bytes(data[i : i + 4], "big") for i in (0, 4)))
        if name != b"IDAT":
            chunks[name] = bytes(data)
        if name in _PNG_PIXELS:
            shown.append(view[place:][: 12 + size])
        place += 12 + size
    return chunks, b"".join(shown)


def _png_coding(chunks: dict[bytes, bytes]) -> tuple[float | None, str]:
    """The exponent of light that a PNG states, and a doubt if it states what is no power."""
    if len(coding := chunks.get(b"cICP", b"")) == 4:
        coded = _TRANSFERS.get(coding[1], f"the transfer function {coding[1]} of H.273")
        is_full = coding[3] == 1
        if isinstance(coded, float) and is_full:
            return coded, ""
        coded = coded if is_full else "the narrow range of video"
        return None, f"its numbers are coded by {coded}, and are read as if by gamma 2.2"
    gamma = int.from_bytes(chunks.get(b"gAMA", b""), "big") / 1e5
    return (round(1 / gamma, 2) if gamma > 0 and b"sRGB" not in chunks else None), ""


def _share(alpha: np.ndarray, full: float) -> np.ndarray:
    return np.clip(alpha.astype(np.float32) / np.float32(full), 0, 1)


def _decoded_tiff(path: Path, number: int) -> Decoded:
    """A picture of a TIFF by its number, which does not count masks and those of reduced size.

    In the result black is 0 and colours are not multiplied by opacity, whatever the file holds.
    """
    import tifffile

    with tifffile.TiffFile(path) as file:
        pages = itertools.islice(_whole_pages(file), number, None)
        index, page = next(pages, (None, None))
        if page is None:
            raise ValueError("a TIFF of reduced pictures alone")
        has_more = next(pages, None) is not None
        _require_size(page.imagewidth, page.imagelength)
        _require_strips(page, page)
        meaning = page.photometric
        if meaning in _CONVERTED or (meaning <= _BLACK_IS_ZERO and _has_few_bits(page)):
            if not _has_few_bits(page, most=8):
                raise ValueError(f"{_CONVERTED[meaning]} of {page.bitspersample} bits a channel")
            if index is None:
                raise ValueError("a TIFF whose picture lies within a page of another")
            return _decoded_by_pillow(path, index)._replace(has_more=has_more)
        if meaning not in (_WHITE_IS_ZERO, _BLACK_IS_ZERO, _RGB):
            raise ValueError(f"a TIFF whose values are {getattr(meaning, 'name', meaning)}")
        first = file.pages.first
        tag = page.tags.get(_ORIENTATION) or first.tags.get(_ORIENTATION)
        pixels = _direct(page, 1 if tag is None else tag.value)
        return pixels._replace(has_more=has_more)


def _require_strips(page: "TiffPage | TiffFrame", key: "TiffPage") -> None:
    """Refuses a page without all strips or tiles, which both decoders would leave black."""
    held = min(sum(map(bool, page.dataoffsets)), sum(map(bool, page.databytecounts)))
    expected = math.prod(key.chunked)
    if held < expected:
        raise ValueError(f"it holds {held} of its {expected} strips or tiles")


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
    multiplies, stands_beside = 1, 2  # TIFF's numbers for opacity
    kinds = [kind for kind in extras if kind in (multiplies, stands_beside)]
    if kinds:
        alpha = _share(pixels[..., num_colours + extras.index(kinds[0])], full)
        if kinds[0] == multiplies:  # divided by it again, and black where it is 0
            share = alpha[..., None].astype(np.float64)
            plain = colour * np.divide(1, share, out=np.zeros_like(share), where=share > 0)
            plain = np.rint(plain) if colour.dtype.kind == "u" else plain
            colour = np.minimum(plain, full).astype(colour.dtype)
        alpha = _upright(alpha, orientation)
    return Decoded(_upright(colour, orientation), alpha, full)


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
        # A telephone's JPEG with further pictures in it is an MPO.
        if file.format not in ("PNG", "JPEG", "MPO", "TIFF", "BMP", "WEBP", "PPM"):
            raise ValueError(f"a {file.format} file")
        _require_size(file.width, file.height)
        has_more = _has_more(file)
        if page:
            file.seek(page)
        if file.format == "PPM":
            return _decoded_map(file, path)
        if file.format in ("JPEG", "MPO"):
            _require_whole_jpeg(file, path.read_bytes())
        upright = ImageOps.exif_transpose(file)
        has_alpha = "transparency" in upright.info or upright.mode in ("LA", "PA", "RGBA", "La")
        if upright.mode in ("L", "RGB", "RGBA", "LA"):
            mode = "RGBA" if has_alpha and upright.mode in ("L", "RGB") else upright.mode
        else:
            mode = "RGBA" if has_alpha else "L" if upright.mode == "1" else "RGB"
        pixels = np.asarray(upright.convert(mode) if mode != upright.mode else upright)
    return Decoded.of(pixels, has_more)


def _require_whole_jpeg(file: "Image.Image", content: bytes) -> None:
    """Refuses a JPEG whose pixels end before its end marker.

    The decoder fills missing pixels with grey, and its warning does not reach Python. It reads on
    up to the end marker only if pixels are missing, so that bytes put there change the picture then
    and only then.
    """
    from PIL import Image

    held, end = np.asarray(file), _end_of_jpeg(content)
    others = io.BytesIO(content[:end] + bytes(range(255)) * 8 + content[end:])
    with Image.open(others, formats=["JPEG"]) as other:
        if not np.array_equal(held, np.asarray(other)):
            raise ValueError("its pixels end early")


def _end_of_jpeg(content: bytes) -> int:
    """Place of the end marker of a JPEG; a preview within it has one of its own."""
    scan, end = 0xDA, 0xD9  # markers that begin the pixels and end the file
    place = 2
    while (kind := content[place + 1]) != end:
        if kind == 0xFF:  # fills up
            place += 1
            continue
        place += 2 + int.from_bytes(content[place + 2 : place + 4], "big")
        if kind == scan:
            # The next marker that does not stand between parts of the pixels.
            marker = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]").search(content, place)
            if marker is None:
                raise ValueError("it ends early")
            place = marker.start()
    return place


def _decoded_map(file: "Image.Image", path: Path) -> Decoded:
    """A PGM or PPM picture, whose header gives the value of white."""
    _, _, begin, how = cast("Any", file).tile[0]
    white = how[-1] if isinstance(how, tuple) else 65535 if how == "I;16B" else 255
    if file.mode not in ("1", "L", "I", "RGB"):
        raise ValueError("a map of floating-point values")
    if file.mode == "RGB" and white > 255:
        raise ValueError("a PPM of more than 8 bits a channel")
    pixels = np.asarray(file.convert("L") if file.mode == "1" else file)
    # Pillow stretches values to 8 or 16 bits and rounds; scaled back and rounded they are exact.
    stretch = white / (65535 if file.mode == "I" else 255)
    values = np.rint(pixels * stretch).astype(np.uint16 if white > 255 else np.uint8)
    values = values[..., None] if values.ndim == 2 else values
    # Another map may follow the pixels, which are in letters or in bytes.
    content = path.read_bytes()
    if content[1:2] in b"123":
        further = re.search(rb"^P[1-6]\s", content[begin:], re.MULTILINE)
    else:
        num_bytes = -(-file.width // 8) * file.height if file.mode == "1" else values.nbytes
        further = re.match(rb"\s*P[1-6]\s", content[begin + num_bytes :])
    return Decoded(values, None, float(white), has_more=further is not None)
