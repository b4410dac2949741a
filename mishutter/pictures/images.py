"""Pictures in and out: files of many formats to linear light, and back to PNG and TIFF.

"The paper" is "Improved motion invariant imaging with time varying shutter functions".
"""

import importlib.util
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import ArrayLike, Float, Int, Shaped

from mishutter._core.checks import (
    Unquoted,
    floating_light,
    is_concrete,
    require,
    require_number,
    require_positive_int,
    shape_of,
)
from mishutter._core.files import write_bytes
from mishutter.pictures.files import (
    MAX_PIXELS,
    PICTURE_FORMATS,
    Decoded,
    GreyFrames,
    decoded,
    deep_png,
    grey_frames,
    is_tiff,
    tiff_like,
)

GAMMA = 2.2
"""Exponent of the coding of pictures (the paper's section 4.2)."""
LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Weights of linear red, green and blue in luminance (ITU-R BT.709)."""

_READ = "read_picture(path=...)"
_WRITE = "write_picture(path=...)"
_DEPTHS = (8, 10, 12, 14)
"""Depths of cameras, bits, whose software stores values in 16 bits without scaling them."""
_SEVERAL = "it holds several pictures, of which the first is read"


Axis = Literal["rows", "columns"]
"""Axis of a picture along which things move: along its rows (across) or its columns (up, down)."""


class PictureWarning(UserWarning):
    """The values of a picture may mean something other than they were read as."""


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture in linear light.

    Attributes:
        light: Linear light, white = 1; shape `(rows, columns, channels)`, 1 or 3 channels, float32.
        matte: Opacity, if the file holds one; shape `(rows, columns)`, in `[0, 1]`.
        name: Its name in an error.
    """

    light: np.ndarray
    matte: np.ndarray | None = None
    name: str = "picture"

    def __post_init__(self) -> None:
        subject = "Picture(light=...)"
        object.__setattr__(self, "light", floating_light(self.light, subject))
        shape = np.shape(self.light)
        sized = len(shape) == 3 and shape[2] in (1, 3) and min(shape) > 0
        require(sized, subject, "have shape (rows, columns, 1 or 3)", shape_of(self.light))
        finite = bool(np.all(np.isfinite(self.light)))
        require(finite, subject, "be finite", Unquoted("a value that is not"))
        require(bool(np.min(self.light) >= 0), subject, "be at least 0", np.min(self.light))
        if self.matte is not None:
            matte, fits = self.matte, np.shape(self.matte) == shape[:2]
            require(fits, "Picture(matte=...)", f"have shape {shape[:2]}", shape_of(matte))
            inside = bool(np.all((matte >= 0) & (matte <= 1)))
            require(
                inside, "Picture(matte=...)", "lie in [0, 1]", Unquoted("a value that does not")
            )

    @property
    def luminance(self) -> Float[np.ndarray, "rows columns"]:
        """Luminance in linear light; shape `(rows, columns)`."""
        if self.light.shape[2] == 1:
            return self.light[..., 0]
        return self.light @ np.asarray(LUMINANCE, self.light.dtype)

    def transposed(self, axis: Axis = "columns") -> "Picture":
        """The picture with rows and columns exchanged, unless things move along its rows.

        Args:
            axis: The axis along which things move.
        """
        matte = None if self.matte is None else transposed(self.matte, axis)
        return Picture(transposed(self.light, axis), matte, self.name)


def transposed(light: Any, axis: Axis) -> Any:
    """Exchanges rows and columns where things move along columns, so that they move along rows.

    A second call turns the picture back.
    """
    if axis == "rows":
        return light
    axes = (-2, -1) if np.ndim(light) == 2 else (-3, -2)
    if not is_concrete(light):
        return light.swapaxes(*axes)
    return np.ascontiguousarray(np.asarray(light).swapaxes(*axes))


def middle_rows(
    light: Float[np.ndarray, "rows columns channels"], count: int
) -> Float[np.ndarray, "some columns channels"]:
    """The middle rows of a picture, at most `count`."""
    first = max(0, (light.shape[0] - count) // 2)
    return light[first : first + count]


def pixels_along(axis: Axis) -> str:
    """The word that counts pixels along an axis: the length of a row is a number of columns."""
    return "columns" if axis == "rows" else "rows"


class RowSpectrum(NamedTuple):
    """The statistics of a picture, by the names of the arguments of `Texture`."""

    power_spectrum: np.ndarray  # Mean power of the rows in equal steps of (0, 0.5) cycles/px
    mean_level: float  # Mean of the luminance in linear light
    deviation: float  # Standard deviation of the luminance


def read_picture(
    path: str | Path, *, white: ArrayLike | None = None, linear: bool = False
) -> Picture:
    """Read a picture into linear light.

    Whole numbers (up to 16 bits; grey, RGB, alpha, palette, CMYK) are divided by the greatest that
    the file's depth allows, or by `white`, and raised to the power 2.2, or that which a PNG states
    (`gAMA`, `cICP`), unless they are `linear`; colour profiles are not applied. Floating-point
    TIFFs are linear light already. A picture is turned upright as its orientation tag says. If a
    file holds several pictures, the first that is not marked as reduced is read. A band of a TIFF
    is opacity where the file says so.

    Args:
        path: A PNG, JPEG, TIFF, BMP, WebP, PGM or PPM file.
        white: Value of white in the file: 4095 for 12 bits, even if they are stored in 16.
        linear: Whether the file's numbers are linear light.

    Returns:
        The picture; see `Picture`.

    Raises:
        OSError: if there is no such file, or it cannot be read.
        ValueError: if the file is no picture of these formats, is damaged, is larger than 150
            megapixels, or holds a value that is not finite, below 0 or above `white`.

    Warns:
        PictureWarning: if all values fit in fewer bits than the file has, it states a coding that
            is not a power, as PQ, or it holds more pictures.
    """
    picture, doubts = examined(path, white, linear)
    for doubt in doubts:
        warnings.warn(doubt, PictureWarning, stacklevel=2)
    return picture


class Capture(NamedTuple):
    """A record of a camera, and how its file's numbers stand for light."""

    # Light in units of a fully open exposure; shape `(rows, columns, channels)`, float32
    light: np.ndarray
    path: Path  # The file
    page: str  # Number of its page, of a file that holds several; else `""`
    black: float  # Number of black
    white: float  # Number of white, were the shutter open for the whole exposure
    exponent: float  # Power by which light follows from the numbers
    is_whole: bool  # Whether the numbers are whole ones, of up to 16 bits

    def write_like(self, path: Path, light: np.ndarray) -> None:
        """Write light as a TIFF in the numbers of this capture, whole or not at all.

        Numbers below black and above white are kept, as a mean over noise needs them. The size of
        a pixel is that of the capture, if it says one.
        """
        shares = np.copysign(np.abs(light) ** (1 / self.exponent), light)
        numbers = self.black + shares * (self.white - self.black)
        if self.is_whole:
            pixels = np.rint(np.clip(numbers, 0, 65535)).astype(np.uint16)
        else:
            pixels = numbers.astype(np.float32)
        write_bytes(path, tiff_like(pixels, self.path))

    @property
    def is_tiff(self) -> bool:
        """Whether its file is a TIFF."""
        return is_tiff(self.path)

    @property
    def name(self) -> str:
        """Name of its file, and the page."""
        return f"{self.path.name} {self.page}".rstrip()

    @property
    def stem(self) -> str:
        """Name of its file without the suffix, and the page, as part of another file's name."""
        return f"{self.path.stem}_{self.page}" if self.page else self.path.stem


def read_captures(
    path: str | Path, *, black: float = 0.0, white: float | None = None, linear: bool = False
) -> tuple[Capture, ...]:
    """Read what a camera has recorded, as `read_picture` does, whatever its values are.

    A capture that a dark frame was taken from is below 0 by its noise, and a highlight may be above
    white. A TIFF holds as many captures as its axes have times, or as it has pages of full size.
    """
    path, white = Path(path), checked_white("read_captures(white=...)", white)
    require_number("read_captures(black=...)", black)
    files = decoded_pages(path)
    file = files[0]
    full = file.full if white is None else white
    require(full > black, "read_captures(white=...)", f"be above black, {black:g}", full)
    is_all = len(files) > 1
    for doubt in _doubts(file._replace(has_more=not is_all and file.has_more), path, white, linear):
        warnings.warn(doubt, PictureWarning, stacklevel=2)
    digits = len(str(len(files)))
    return tuple(
        Capture(
            light=light_of(each, path, white, linear, black=black, bounded=False),
            path=path,
            page=f"{number:0{digits}d}" if is_all else "",
            black=float(black),
            white=float(full),
            exponent=_exponent(each, linear),
            is_whole=each.colour.dtype.kind == "u",
        )
        for number, each in enumerate(files, 1)
    )


def decoded_pages(path: str | Path, most: int | None = None) -> tuple[Decoded, ...]:
    """The pictures of a file as it holds them.

    A TIFF of plain grey numbers has one for each time of its axes, and others one for each page of
    full size.
    """
    path = Path(path)
    files = [_file(path)]
    stack = frames_of_tiff(path, most) if is_tiff(path) else None
    if stack is not None:
        if stack.word:
            warnings.warn(f"{path}: {stack.word}", PictureWarning, stacklevel=3)
        first = files[0]._replace(has_more=stack.has_more)
        return tuple(first._replace(colour=frame[..., None]) for frame in stack.frames)
    while files[-1].has_more and is_tiff(path) and (most is None or len(files) < most):
        files.append(_file(path, len(files)))
    return tuple(files)


def frames_of_tiff(path: Path, most: int | None) -> GreyFrames | None:
    """The frames of a TIFF by the axes that it states; None if its pages are no plain numbers."""
    with _errors_of_one_line(path):
        return grey_frames(path, most)


def examined(
    path: str | Path, white: ArrayLike | None, linear: bool
) -> tuple[Picture, tuple[str, ...]]:
    """A picture as `read_picture` reads it, and a sentence for each doubt about it."""
    path, white = Path(path), checked_white("read_picture(white=...)", white)
    file = _file(path)
    light = light_of(file, path, white, linear)
    matte = None if file.alpha is None else np.ascontiguousarray(file.alpha)
    picture = Picture(light=light, matte=matte, name=path.stem)
    return picture, _doubts(file, path, white, linear)


def light_of(
    file: Decoded,
    path: Path,
    white: float | None,
    linear: bool,
    *,
    black: float = 0.0,
    bounded: bool = True,
) -> Float[np.ndarray, "rows columns channels"]:
    """Linear light of a picture's colours, white = 1; `(rows, columns, channels)`, float32."""
    shares = np.ascontiguousarray(_shares(file, path, white, black, bounded=bounded))
    exponent = _exponent(file, linear)
    if exponent == 1:
        return shares
    # Numbers below black are light below 0, by the noise of the sensor.
    powers = np.abs(shares)
    powers **= np.float32(exponent)
    return np.copysign(powers, shares, out=powers)


def _exponent(file: Decoded, linear: bool) -> float:
    """Power by which light follows from a file's numbers."""
    is_light = linear or np.issubdtype(file.colour.dtype, np.floating)
    return 1.0 if is_light else file.exponent or GAMMA


def checked_white(subject: str, white: ArrayLike | None) -> float | None:
    """A value of white as a Python float; None stays None."""
    if white is None:
        return None
    require_number(subject, white)
    require(bool(np.asarray(white) > 0), subject, "be above 0", white)
    return float(np.asarray(white))


def read_levels(path: str | Path) -> Shaped[np.ndarray, "rows columns"]:
    """Read the numbers of a grey picture as the file holds them."""
    file = _file(Path(path))
    colour = file.colour
    if file.has_more:
        warnings.warn(f"{path}: {_SEVERAL}", PictureWarning, stacklevel=2)
    got = Unquoted(f"colours in {str(path)!r}")
    require(colour.shape[2] == 1, "read_levels(path=...)", "be a grey picture", got)
    return colour[..., 0]


def read_opacity(path: str | Path) -> Float[np.ndarray, "rows columns"]:
    """Read a grey picture as opacity: its values as the file holds them, without gamma."""
    path = Path(path)
    return np.clip(Picture(_shares(_file(path), path, None)).luminance, 0, 1)


def read_labels(path: str | Path) -> Int[np.ndarray, "rows columns"]:
    """Read a picture of labels: 0 where it is black, and a number from 1 for each other value."""
    path = Path(path)
    codes = _shares(_file(path), path, None)
    _, labels = np.unique(codes.reshape(-1, codes.shape[2]), axis=0, return_inverse=True)
    has_black = bool(np.all(codes.min(axis=(0, 1)) == 0) and np.any(np.all(codes == 0, axis=2)))
    return labels.reshape(codes.shape[:2]) + (0 if has_black else 1)


def example_picture() -> Picture:
    """The built-in photograph: a motorcycle, as scikit-image ships it; 500 x 741, colour.

    Raises:
        OSError: if scikit-image is not installed with its pictures.
    """
    return shipped_picture("motorcycle_left.png")


def shipped_picture(file_name: str) -> Picture:
    """One of the pictures inside scikit-image's package, without importing or downloading."""
    spec = importlib.util.find_spec("skimage")
    folder = Path(spec.origin).parent / "data" if spec and spec.origin else Path()
    return read_picture(folder / file_name)


def write_picture(path: str | Path, light: Picture | np.ndarray) -> None:
    """Write linear light as a 16-bit PNG with gamma 2.2, whole or not at all.

    Light outside `[0, 1]` is clipped. An array with four channels holds the matte in
    the last.

    Args:
        path: File to write, whose name ends in `.png`; its folder must exist.
        light: A `Picture`, or an array of shape `(rows, columns)` or
            `(rows, columns, channels)`.

    Raises:
        OSError: if the file cannot be written.
        ValueError: if the name ends otherwise, or the array has another shape or holds values
            that are not finite.
    """
    path = Path(path)
    require(path.suffix.lower() == ".png", _WRITE, "end in `.png`", str(path))
    subject = "write_picture(light=...)"
    array = floating_light(light.light if isinstance(light, Picture) else light, subject)
    array = array[..., None] if array.ndim == 2 else array
    shape = array.shape
    sized = array.ndim == 3 and shape[2] in (1, 3, 4) and min(shape) > 0
    require(sized, subject, "be a picture", shape_of(array))
    if not path.parent.is_dir():
        raise FileNotFoundError(
            f"`{_WRITE}` must lie in a folder that exists; got {str(path.parent)!r}."
        )
    if path.is_dir():
        raise IsADirectoryError(f"`{_WRITE}` must name a file; got the folder {str(path)!r}.")

    coded = array.copy()
    finite = bool(np.all(np.isfinite(coded)))
    require(finite, subject, "be finite", Unquoted("a value that is not"))
    np.clip(coded, 0, 1, out=coded)
    coded[..., :3] **= 1 / GAMMA
    coded *= 65535
    write_bytes(path, deep_png(np.rint(coded, out=coded).astype(np.uint16)))


def to_display(irradiance: np.ndarray) -> np.ndarray:
    r"""Gamma-coded values $\min(\max(f, 0), 1)^{1/2.2}$ of linear light; any shape."""
    return np.clip(np.asarray(irradiance), 0, 1) ** (1 / GAMMA)


def row_power_spectrum(picture: Picture, num_frequencies: int = 256) -> RowSpectrum:
    r"""Mean power spectrum of a picture's rows, and its mean and deviation.

    The spectrum is the periodogram of each row's luminance in linear light, without the
    picture's mean and under a Hann window (the jump between a row's ends would otherwise
    count as contrast), averaged over rows and over each of `num_frequencies` equal steps
    whose centres are $(m + \tfrac12) / 2M$ cycles/px.

    Args:
        picture: The picture.
        num_frequencies: Number of steps $M$.

    Returns:
        The spectrum, scaled so that its mean is the variance; see `RowSpectrum`.

    Raises:
        ValueError: if rows are shorter than 8 px, or `num_frequencies` is not a
            positive integer.
    """
    require_positive_int("row_power_spectrum(num_frequencies=...)", num_frequencies)
    luminance = picture.luminance.astype(np.float64)
    columns = luminance.shape[1]
    subject = "row_power_spectrum(picture=...)"
    require(columns >= 8, subject, "have rows of at least 8 px", f"{columns} px")
    mean, deviation = float(np.mean(luminance)), float(np.std(luminance))
    window = np.sin(np.pi * (np.arange(columns) + 0.5) / columns) ** 2
    window /= np.sqrt(np.mean(window**2))
    power = np.mean(np.abs(np.fft.rfft((luminance - mean) * window)) ** 2, axis=0) / columns
    edges = np.concatenate([[0.0], np.minimum(np.arange(power.size) + 0.5, columns / 2) / columns])
    below = np.concatenate([[0.0], np.cumsum(power * np.diff(edges))])
    steps = np.linspace(0, 0.5, num_frequencies + 1)
    binned = np.diff(np.interp(steps, edges, below)) * (2 * num_frequencies)
    total = float(np.mean(binned))
    scale = deviation**2 / total if total > 0 else 0.0
    return RowSpectrum(binned * scale, mean, deviation)


def _file(path: Path, number: int = 0) -> Decoded:
    """Decodes a picture of a file."""
    with _errors_of_one_line(path):
        return decoded(path, number)


@contextmanager
def _errors_of_one_line(path: Path) -> Iterator[None]:
    """Makes the failure of reading a file an error of one line with the reason."""
    if not path.exists():
        raise FileNotFoundError(f"`{_READ}` must name a file; got {str(path)!r}, not found.")
    if path.is_dir():
        raise IsADirectoryError(f"`{_READ}` must name a file; got the folder {str(path)!r}.")
    try:
        yield
    except PermissionError as error:
        raise PermissionError(
            f"`{_READ}` must name a readable file; got {str(path)!r}, permission denied."
        ) from error
    except MemoryError:
        raise
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(
            f"`{_READ}` must name a whole {PICTURE_FORMATS} picture of at most "
            f"{MAX_PIXELS // 10**6} megapixels; got {str(path)!r}: {reason}."
        ) from error


def _shares(
    file: Decoded, path: Path, white: float | None, black: float = 0.0, *, bounded: bool = True
) -> np.ndarray:
    """Values above black divided by that of white; shape `(rows, columns, channels)`, float32."""
    colour, full = file.colour, file.full if white is None else float(white)
    if np.issubdtype(colour.dtype, np.floating):
        finite = bool(np.all(np.isfinite(colour)))
        require(finite, _READ, "hold finite pixels", f"NaN or infinite pixels in {str(path)!r}")
    if bounded:
        least, most = colour.min(), colour.max()
        worst = least if least < 0 else most
        requirement = f"hold values from 0 to white, {full:g}"
        inside = bool(least >= 0 and most <= full)
        require(inside, _READ, requirement, Unquoted(f"{worst} in {str(path)!r}"))
    # In place: a picture of many megapixels should be in memory no more often than it must.
    shares = colour.astype(np.float32)
    shares -= np.float32(black)
    shares /= np.float32(full - black)
    return shares


def _doubts(file: Decoded, path: Path, white: float | None, linear: bool) -> tuple[str, ...]:
    """Warnings about a file whose values may mean something other than they are read as."""
    doubts = []
    most = int(file.colour.max()) if file.full == np.iinfo(np.uint16).max else 0
    if white is None and 0 < most < 1 << _DEPTHS[-1]:
        depth = next(bits for bits in _DEPTHS if most < 1 << bits)
        doubts.append(
            f"{path}: its greatest value is {most} of 65535; if its values are {depth} bits in 16, "
            f"read them with `white` {(1 << depth) - 1}, and with `linear` if a camera recorded "
            "them without gamma"
        )
    if file.doubt and not linear:
        doubts.append(f"{path}: {file.doubt}")
    if file.has_more:
        doubts.append(f"{path}: {_SEVERAL}")
    return tuple(doubts)
