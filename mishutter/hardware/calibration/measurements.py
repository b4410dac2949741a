"""What a camera recorded of a point or an edge on a slide, and the file that lists it."""

import io
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal, NamedTuple, final

import numpy as np
from pydantic import Field

from mishutter._core import (
    Bare,
    Section,
    contents,
    number_rows,
    parsed,
    require,
    require_finite,
    shape_of,
    text_lines,
    validated,
)
from mishutter.hardware.trace_files import read_trace
from mishutter.hardware.traces import Trace

TARGETS = ("point", "edge")
END = 4
"""Columns at either end of a picture that the blur must not reach."""
_CLEAR = 6.0
"""Noise of the mean of some columns that a step must exceed, or a difference must not."""


@dataclass(frozen=True)
class SensorLevels:
    """How a sensor's levels come from electrons.

    Attributes:
        electrons_per_level: e- that raise the level by 1.
        read_noise: Standard deviation of the read noise; e-.
        black_level: Level of a pixel without light, about which its noise is told.
        full_level: Level from which on a pixel is saturated.
    """

    electrons_per_level: float = 1.0
    read_noise: float = 0.0
    black_level: float = 0.0
    full_level: float = np.inf

    def __post_init__(self) -> None:
        for name in ("electrons_per_level", "read_noise", "black_level"):
            require_finite(f"SensorLevels({name}=...)", getattr(self, name))
        some = self.electrons_per_level > 0
        subject = "SensorLevels(electrons_per_level=...)"
        require(some, subject, "be above 0", self.electrons_per_level)
        right = self.read_noise >= 0
        require(right, "SensorLevels(read_noise=...)", "be at least 0", self.read_noise)

    def variance(self, level: np.ndarray, is_rounded: bool) -> np.ndarray:
        r"""$(\mu - b)/e + (\sigma/e)^2$, and 1/12 of whole levels; levels squared."""
        light = np.maximum(level - self.black_level, 0) / self.electrons_per_level
        read = (self.read_noise / self.electrons_per_level) ** 2
        return np.maximum(light + read, 1e-12) + (1 / 12 if is_rounded else 0.0)


@dataclass(frozen=True)
class TargetPicture:
    """A picture of a point light or of an upright edge that moves along the rows.

    Attributes:
        levels: Rows of the picture, which show the same; `(rows, columns)` or `(columns,)`.
        target: `"point"` or `"edge"`.
        speed: px/s; None where it is unknown, but equal in all pictures where it is.
        name: Name in errors and pictures.
    """

    levels: np.ndarray
    target: str = "point"
    speed: float | None = 0.0
    name: str = "TargetPicture(levels=...)"
    is_rounded: bool = field(init=False)

    def __post_init__(self) -> None:
        levels = np.asarray(self.levels)
        name = self.name
        require(levels.ndim in (1, 2) and levels.size > 0, name, "have rows", shape_of(levels))
        require(
            self.target in TARGETS, "TargetPicture(target=...)", "be point or edge", self.target
        )
        require_finite(name, levels)
        wide = levels.shape[-1] >= 4 * END
        require(wide, name, f"have at least {4 * END} columns", int(levels.shape[-1]))
        if self.speed is not None:
            require_finite("TargetPicture(speed=...)", self.speed)
        object.__setattr__(self, "is_rounded", bool(np.all(levels == np.rint(levels))))
        object.__setattr__(self, "levels", np.atleast_2d(levels.astype(np.float64)))

    def profile(self, sensor: SensorLevels) -> np.ndarray:
        """Mean of the rows; shape `(columns,)`.

        Raises:
            ValueError: if a pixel is saturated, the blur reaches an end, or there is no target.
        """
        highest = float(self.levels.max())
        requirement = f"stay below the full level {sensor.full_level:g} in every pixel"
        require(highest < sensor.full_level, self.name, requirement, highest)
        profile = self.levels.mean(axis=0)
        noise = np.sqrt(sensor.variance(profile, self.is_rounded) / len(self.levels))
        for end in (profile[:END], profile[-END:]):
            slope = abs(float(np.mean(end[: END // 2]) - np.mean(end[END // 2 :])))
            flat = slope <= _CLEAR * float(noise.max())
            requirement = f"end in {END} columns that the blur does not reach"
            require(flat, self.name, requirement, Bare(f"levels that change by {slope:.3g} there"))
        left, right = float(np.mean(profile[:END])), float(np.mean(profile[-END:]))
        clear = _CLEAR * float(noise.max())
        if self.target == "edge":
            requirement = "hold an edge: levels at its ends that differ by more than the noise"
            got = Bare(f"{left:.4g} and {right:.4g}")
            require(abs(right - left) > clear, self.name, requirement, got)
        else:
            dark = abs(right - left) <= clear
            got = Bare(f"{left:.4g} and {right:.4g}")
            require(dark, self.name, "hold a point: the same level at both ends", got)
            peak = float(profile.max()) - left
            requirement = "hold a point: light above the level of its ends"
            require(peak > clear, self.name, requirement, Bare(f"{peak:.3g} above"))
        return profile


class Measurements(NamedTuple):
    """Everything that was recorded of one camera.

    Attributes:
        pictures: Pictures of targets.
        sensor: How levels come from electrons.
        trace: A photodiode's trace, on the camera's clock; None for none.
    """

    pictures: tuple[TargetPicture, ...]
    sensor: SensorLevels
    trace: Trace | None = None


@final
class _Sensor(Section):
    electrons_per_level: Annotated[float, Field(gt=0)] = 1.0
    read_noise_e: Annotated[float, Field(ge=0)] = 0.0
    black_level: float = 0.0
    full_level: float | None = None


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
    """Read a TOML file that lists pictures, how the sensor counts, and a trace if there is one.

    A picture is CSV, one line a row, or `.npy` of rows and columns. One without a speed has
    the speed that all such pictures share.

    Raises:
        ValueError: if a file is not what it must be.
        OSError: if one cannot be read.
    """
    name, folder = str(path), Path(path).parent
    file = validated(_File, parsed(tomllib.loads, contents(path), name, "TOML"), name)
    pictures = tuple(
        TargetPicture(_levels(folder / p.path), p.target, p.speed_px_per_s, str(folder / p.path))
        for p in file.picture
    )
    s = file.sensor
    full = np.inf if s.full_level is None else s.full_level
    sensor = SensorLevels(s.electrons_per_level, s.read_noise_e, s.black_level, full)
    t = file.trace
    trace = None if t is None else read_trace(folder / t.path, column=t.column)
    return Measurements(pictures, sensor, trace)


def _levels(path: Path) -> np.ndarray:
    content, name = contents(path), str(path)
    if not content.startswith(b"\x93NUMPY"):
        is_text = b"\0" not in content or content.startswith((b"\xff\xfe", b"\xfe\xff"))
        got = Bare("a file that is neither")
        require(is_text, name, "hold the levels of a picture as CSV or .npy", got)
        lines = text_lines(content, name)
        return number_rows(lines, lines[0].count(",") + 1, name)
    try:
        levels = np.load(io.BytesIO(content), allow_pickle=False)
    except (ValueError, EOFError, OSError, SyntaxError) as error:
        raise ValueError(f"{name} must be a whole .npy file; got: {error}.") from None
    require(levels.dtype.kind in "fiu", name, "hold real numbers", Bare(levels.dtype))
    return levels
