"""Pictures of a point or an edge on a slide, and the file that lists them."""

import io
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal, NamedTuple, final, get_args

import numpy as np
from jaxtyping import Float, Shaped
from pydantic import Field

from mishutter._core.checks import Unquoted, require, require_finite, shape_of
from mishutter._core.columns import number_rows, text_lines
from mishutter._core.files import contents
from mishutter._core.validation import Section, parsed, validated
from mishutter.hardware.trace_files import read_trace
from mishutter.hardware.traces import Trace
from mishutter.pictures.files import PICTURE_SUFFIXES
from mishutter.pictures.images import Axis, pixels_along, read_levels, transposed

END = 4
"""Columns at either end of a picture that the blur must not reach."""


@dataclass(frozen=True)
class SensorLevels:
    """The conversion of electrons to a sensor's levels.

    Attributes:
        electrons_per_level: Electrons that raise the level by 1; e-.
        read_noise: Standard deviation of the read noise; e-.
        black_level: Level of a pixel that no light reaches.
        full_level: Level from which on a pixel is saturated.
    """

    electrons_per_level: float = 1.0
    read_noise: float = 0.0
    black_level: float = 0.0
    full_level: float = np.inf

    def __post_init__(self) -> None:
        for name in ("electrons_per_level", "read_noise", "black_level"):
            require_finite(f"SensorLevels({name}=...)", getattr(self, name))
        is_positive = self.electrons_per_level > 0
        subject = "SensorLevels(electrons_per_level=...)"
        require(is_positive, subject, "be above 0", self.electrons_per_level)
        is_noise = self.read_noise >= 0
        require(is_noise, "SensorLevels(read_noise=...)", "be at least 0", self.read_noise)

    def variance(self, level: np.ndarray, is_rounded: bool) -> np.ndarray:
        r"""Variance of a level, $(\mu - b)/e + (\sigma/e)^2$, and 1/12 if rounded; levels^2.

        Args:
            level: Mean level of a pixel.
            is_rounded: Whether levels are rounded to whole numbers.
        """
        shot = np.maximum(level - self.black_level, 0) / self.electrons_per_level
        read = (self.read_noise / self.electrons_per_level) ** 2
        return np.maximum(shot + read, 1e-12) + (1 / 12 if is_rounded else 0.0)


@dataclass(frozen=True)
class TargetPicture:
    """A picture of a point light or of an edge across the axis along which it moves.

    Attributes:
        levels: Rows of the picture, which show the same; `(rows, columns)` or `(columns,)`.
            Of a target that moves along columns, the columns become the rows.
        target: `"point"` or `"edge"`.
        speed: Speed of the target, px/s; None for an unknown one, which all such pictures share.
        name: Name in errors and pictures.
        axis: `"rows"`, or `"columns"` of a target that moves down or up the picture.
        is_rounded: Whether all levels are whole numbers.
    """

    levels: Shaped[np.ndarray, "*rows columns"]
    target: str = "point"
    speed: float | None = 0.0
    name: str = "TargetPicture(levels=...)"
    axis: Axis = "rows"
    is_rounded: bool = field(init=False)

    def __post_init__(self) -> None:
        levels = np.asarray(self.levels)
        name = self.name
        require(levels.ndim in (1, 2) and levels.size > 0, name, "have rows", shape_of(levels))
        is_known = self.target in ("point", "edge")
        require(is_known, "TargetPicture(target=...)", "be point or edge", self.target)
        require_finite(name, levels)
        is_axis = self.axis in get_args(Axis)
        require(is_axis, "TargetPicture(axis=...)", "be 'rows' or 'columns'", self.axis)
        levels = transposed(levels, self.axis) if levels.ndim == 2 else levels
        is_wide, pixels = levels.shape[-1] >= 4 * END, pixels_along(self.axis)
        require(is_wide, name, f"have at least {4 * END} {pixels}", int(levels.shape[-1]))
        if self.speed is not None:
            require_finite("TargetPicture(speed=...)", self.speed)
        object.__setattr__(self, "is_rounded", bool(np.all(levels == np.rint(levels))))
        object.__setattr__(self, "levels", np.atleast_2d(levels.astype(np.float64)))

    def profile(self, sensor: SensorLevels) -> Float[np.ndarray, "columns"]:
        """Mean of the rows.

        Args:
            sensor: The sensor that recorded it.

        Raises:
            ValueError: if a pixel is saturated, the blur reaches an end, or there is no target.
        """
        highest = float(self.levels.max())
        requirement = f"stay below the full level {sensor.full_level:g} in every pixel"
        require(highest < sensor.full_level, self.name, requirement, highest)
        profile = self.levels.mean(axis=0)
        noise = np.sqrt(sensor.variance(profile, self.is_rounded) / len(self.levels))
        threshold = 6.0 * float(noise.max())  # above which a difference is a step, or a blur
        for end in (profile[:END], profile[-END:]):
            change = abs(float(np.mean(end[: END // 2]) - np.mean(end[END // 2 :])))
            requirement = f"end in {END} columns that the blur does not reach"
            got = Unquoted(f"levels that change by {change:.3g} there")
            require(change <= threshold, self.name, requirement, got)
        left, right = float(np.mean(profile[:END])), float(np.mean(profile[-END:]))
        got = Unquoted(f"{left:.4g} and {right:.4g}")
        if self.target == "edge":
            requirement = "hold an edge: levels at its ends that differ by more than the noise"
            require(abs(right - left) > threshold, self.name, requirement, got)
        else:
            requirement = "hold a point: the same level at both ends"
            require(abs(right - left) <= threshold, self.name, requirement, got)
            peak = float(profile.max()) - left
            requirement = "hold a point: light above the level of its ends"
            require(peak > threshold, self.name, requirement, Unquoted(f"{peak:.3g} above"))
        return profile


class Measurements(NamedTuple):
    """The measurements of one camera."""

    pictures: tuple[TargetPicture, ...]  # Pictures of targets
    sensor: SensorLevels  # The conversion of electrons to levels
    trace: Trace | None = None  # A photodiode's trace, on the camera's clock; None for none


@final
class _Sensor(Section):
    electrons_per_level: Annotated[float, Field(gt=0)] = 1.0
    read_noise_e: Annotated[float, Field(ge=0)] = 0.0
    black_level: float = 0.0
    full_level: float | None = None
    axis: Axis = "rows"


@final
class _Picture(Section):
    path: Annotated[str, Field(min_length=1)]
    target: Literal["point", "edge"] = "point"
    speed_px_per_s: Annotated[float, Field(ge=-1e7, le=1e7)] | None = None


@final
class _Trace(Section):
    path: Annotated[str, Field(min_length=1)]
    column: str | None = None


@final
class _File(Section):
    sensor: _Sensor = _Sensor()
    picture: Annotated[list[_Picture], Field(min_length=1)]
    trace: _Trace | None = None


def read_measurements(path: str | Path) -> Measurements:
    """Read a TOML file that lists pictures, the figures of the sensor, and perhaps a trace.

    A picture is CSV, one line a row, `.npy` of rows and columns, or a grey picture's file;
    `[sensor] axis` says along which of them targets move. All pictures without a speed share an
    unknown one.

    Args:
        path: The file.

    Raises:
        ValueError: if a file does not match its format.
        OSError: if a file cannot be read.
    """
    name, folder = str(path), Path(path).parent
    file = validated(_File, parsed(tomllib.loads, contents(path), name, "TOML"), name)
    figures, pictures = file.sensor, []
    for each in file.picture:
        place, speed = folder / each.path, each.speed_px_per_s
        picture = TargetPicture(_levels(place), each.target, speed, str(place), figures.axis)
        pictures.append(picture)
    sensor = SensorLevels(
        electrons_per_level=figures.electrons_per_level,
        read_noise=figures.read_noise_e,
        black_level=figures.black_level,
        full_level=np.inf if figures.full_level is None else figures.full_level,
    )
    entry = file.trace
    trace = None if entry is None else read_trace(folder / entry.path, column=entry.column)
    return Measurements(tuple(pictures), sensor, trace)


def _levels(path: Path) -> np.ndarray:
    """Levels of a picture's file, in the format that its contents or its suffix say."""
    content, name = contents(path), str(path)
    if not content.startswith(b"\x93NUMPY"):
        if path.suffix.lower() in PICTURE_SUFFIXES:
            return read_levels(path)
        # Text in UTF-16, which begins with a mark of its byte order, holds zeros.
        is_text = b"\0" not in content or content.startswith((b"\xff\xfe", b"\xfe\xff"))
        got = Unquoted("a file that is neither")
        require(is_text, name, "hold the levels of a picture as CSV or .npy", got)
        lines = text_lines(content, name)
        return number_rows(lines, lines[0].count(",") + 1, name)
    try:
        levels = np.load(io.BytesIO(content), allow_pickle=False)
    except (ValueError, EOFError, OSError, SyntaxError) as error:
        raise ValueError(f"{name} must be a whole .npy file; got: {error}.") from None
    require(levels.dtype.kind in "fiu", name, "hold real numbers", Unquoted(levels.dtype))
    return levels
