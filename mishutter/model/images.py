"""Pictures in and out: any PNG, JPEG or TIFF to linear light, and back to a 16-bit PNG.

"The paper" is "Improved motion invariant imaging with time varying shutter functions".
"""

import importlib.util
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from mishutter._core import (
    Bare,
    floating_light,
    require,
    require_positive_int,
    shape_of,
    write_bytes,
)
from mishutter.model.picture_files import MAX_PIXELS, decoded, deep_png

GAMMA = 2.2
"""Exponent of the coding of pictures (the paper's section 4.2)."""
LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Weights of linear red, green and blue in luminance (ITU-R BT.709)."""

_READ = "read_picture(path=...)"
_WRITE = "write_picture(path=...)"


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture in linear light.

    Attributes:
        light: Light, white = 1; shape `(rows, columns, channels)`, 1 or 3 channels, float32.
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
        require(finite, subject, "be finite", Bare("a value that is not"))
        require(bool(np.min(self.light) >= 0), subject, "be at least 0", np.min(self.light))
        if self.matte is not None:
            matte, fits = self.matte, np.shape(self.matte) == shape[:2]
            require(fits, "Picture(matte=...)", f"have shape {shape[:2]}", shape_of(matte))
            inside = bool(np.all((matte >= 0) & (matte <= 1)))
            require(inside, "Picture(matte=...)", "lie in [0, 1]", Bare("a value that does not"))

    @property
    def luminance(self) -> np.ndarray:
        """Luminance in linear light; shape `(rows, columns)`."""
        if self.light.shape[2] == 1:
            return self.light[..., 0]
        return self.light @ np.asarray(LUMINANCE, self.light.dtype)


class RowSpectrum(NamedTuple):
    """The fields of a scene that follow from a picture: `Scene(**spectrum._asdict())` fields.

    Attributes:
        power_spectrum: Mean power of the rows in equal steps of (0, 0.5) cycles/px.
        mean_level: Mean of the luminance in linear light.
        deviation: Its standard deviation.
    """

    power_spectrum: np.ndarray
    mean_level: float
    deviation: float


def read_picture(path: str | Path) -> Picture:
    """Read a picture into linear light.

    Whole-number pictures (8 or 16 bits; grey, RGB, alpha, palette, CMYK) are scaled to
    `[0, 1]` and raised to the power 2.2; colour profiles are not applied. Floating-point
    TIFFs are taken to be linear light already. A picture is turned upright as its
    orientation tag says. Of a file with several pages the first is read.

    Args:
        path: A PNG, JPEG or TIFF file.

    Returns:
        The picture; see `Picture`.

    Raises:
        OSError: if there is no such file, or it cannot be read.
        ValueError: if it is not a picture, damaged, larger than 150 megapixels, or
            holds a value that is not light.
    """
    path = Path(path)
    values, gamma = _values(path)
    has_matte = values.shape[2] in (2, 4)
    colour = values[..., :-1] if has_matte else values
    matte = np.ascontiguousarray(values[..., -1]) if has_matte else None
    light = np.ascontiguousarray(colour) if gamma == 1.0 else colour ** np.float32(gamma)
    return Picture(light=light, matte=matte, name=path.stem)


def read_opacity(path: str | Path) -> np.ndarray:
    """Read a grey picture as opacity: its values as the file holds them, without gamma.

    Args:
        path: A PNG, JPEG or TIFF file; of one in colour the luminance is taken.

    Returns:
        Opacity in `[0, 1]`; shape `(rows, columns)`, float32.

    Raises:
        OSError: as `read_picture`.
        ValueError: as `read_picture`.
    """
    values, _ = _values(Path(path))
    colour = values[..., : 1 if values.shape[2] < 3 else 3]
    return np.clip(Picture(np.ascontiguousarray(colour)).luminance, 0, 1)


def example_picture() -> Picture:
    """The built-in photograph: a motorcycle, as scikit-image ships it; 500 x 741, colour.

    Raises:
        OSError: if scikit-image is not installed with its pictures.
    """
    return shipped_picture("motorcycle_left.png")


def shipped_picture(file_name: str) -> Picture:
    """One of the pictures inside scikit-image's package, without importing or downloading."""
    found = importlib.util.find_spec("skimage")
    folder = Path(found.origin).parent / "data" if found and found.origin else Path()
    return read_picture(folder / file_name)


def write_picture(path: str | Path, light: Picture | np.ndarray) -> None:
    """Write linear light as a 16-bit PNG with gamma 2.2, whole or not at all.

    Light outside `[0, 1]` is clipped. An array with four channels holds the matte in
    the last.

    Args:
        path: Where to; its folder exists.
        light: A `Picture`, or an array of shape `(rows, columns)` or
            `(rows, columns, channels)`.

    Raises:
        OSError: if the file cannot be written.
        ValueError: if the array has another shape or holds values that are not finite.
    """
    path = Path(path)
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
    require(finite, subject, "be finite", Bare("a value that is not"))
    np.clip(coded, 0, 1, out=coded)
    coded[..., :3] **= 1 / GAMMA
    coded *= 65535
    write_bytes(path, deep_png(np.rint(coded, out=coded).astype(np.uint16)))


def to_display(light: np.ndarray) -> np.ndarray:
    r"""Gamma-coded values $\min(\max(f, 0), 1)^{1/2.2}$ of linear light; any shape."""
    return np.clip(np.asarray(light), 0, 1) ** (1 / GAMMA)


def row_power_spectrum(picture: Picture, num_frequencies: int = 256) -> RowSpectrum:
    r"""Mean power spectrum of a picture's rows, and its mean and deviation.

    The periodogram of each row's luminance in linear light, without the picture's mean
    and under a Hann window (the jump between a row's ends would otherwise count as
    contrast), averaged over rows and over each of `num_frequencies` equal steps whose
    centres are $(m + \tfrac12) / 2M$ cycles/px.

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


def _pixels(path: Path) -> np.ndarray:
    """Pixels as `decoded` gives them, or one line that says why not."""
    if not path.exists():
        raise FileNotFoundError(f"`{_READ}` must name a file; got {str(path)!r}, not found.")
    if path.is_dir():
        raise IsADirectoryError(f"`{_READ}` must name a file; got the folder {str(path)!r}.")
    try:
        return decoded(path)
    except PermissionError as error:
        raise PermissionError(
            f"`{_READ}` must name a readable file; got {str(path)!r}, permission denied."
        ) from error
    except MemoryError:
        raise
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise ValueError(
            f"`{_READ}` must name a whole PNG, JPEG or TIFF picture of at most "
            f"{MAX_PIXELS // 10**6} megapixels; got {str(path)!r}: {reason}."
        ) from error


def _values(path: Path) -> tuple[np.ndarray, float]:
    """Values in `[0, 1]`, shape `(rows, columns, channels)`, and their gamma."""
    raw = _pixels(path)
    raw = raw[..., None] if raw.ndim == 2 else raw
    layout = raw.ndim == 3 and raw.shape[2] in (1, 2, 3, 4) and min(raw.shape) > 0
    require(layout, _READ, "name a grey or RGB picture, with or without alpha", f"{path}")
    if np.issubdtype(raw.dtype, np.floating):
        finite = bool(np.all(np.isfinite(raw)))
        require(finite, _READ, "hold finite pixels", f"NaN or infinite pixels in {str(path)!r}")
        low, high = float(raw.min()), float(raw.max())
        inside = low >= 0 and high <= 1
        got = f"[{low:g}, {high:g}] in {str(path)!r}"
        require(inside, _READ, "hold floating-point light in [0, 1]", got)
        values, gamma = raw.astype(np.float32), 1.0
    elif raw.dtype in (np.uint8, np.uint16):
        values, gamma = raw.astype(np.float32) / np.iinfo(raw.dtype).max, GAMMA
    elif raw.dtype == bool:
        values, gamma = raw.astype(np.float32), 1.0
    else:
        raise ValueError(f"`{_READ}` must hold 8 or 16 bits a channel; got {raw.dtype}.")
    return values, gamma
