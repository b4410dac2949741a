"""The sensor: its pixels, their photo-electrons and noise, and the frames that it reads out."""

from typing import Any, Literal, final, get_args

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from mishutter._core.checks import (
    Unquoted,
    all_concrete,
    as_float,
    as_numpy,
    is_concrete,
    require,
    require_number,
    require_positive_int,
)
from mishutter._core.modules import AbstractModule
from mishutter.pictures.images import Axis

Numbers = Array | np.ndarray | np.floating | float
RowsRead = Literal["down", "up"]
"""The way in which a sensor reads its rows one after another."""
DARK = 1e-12
"""Least variance of the noise of a frame, for pictures without light or noise; white = 1."""


@final
class Sensor(AbstractModule):
    """The electrons that a pixel holds, the axis that things move along, and its length.

    Args:
        full_well: Electrons at which a pixel is full: searches expose white to no more; no limit
            by default; e-.
        axis: Axis of pictures along which things and the sensor move: `"rows"`, across, or
            `"columns"`, a positive speed up. Captures, decoders and photographs know it.
        width: Length of the sensor along that axis, or of both sides for things in any direction,
            for the loss of bursts by objects that enter and leave; unlimited by default; px.
        pixel_pitch: Distance of its pixels, by which the path of a stage is written in um too; m.
        readout: Time from the exposure of the first row to that of the last: each row of a rolling
            shutter sees everything later than the one before. 0 for a global shutter; None where
            nothing says it, as which it is taken; s.
        rows_read: Whether rows are read `"down"` from the top of pictures, or `"up"`.

    Raises:
        ValueError: if `full_well`, `width` or `pixel_pitch` is no scalar above 0, `readout` is
            below 0, or `axis` or `rows_read` is neither.
    """

    full_well: Array | None
    width: Array | None
    pixel_pitch: Array | None
    readout: Array | None
    axis: Axis = eqx.field(static=True)
    rows_read: RowsRead = eqx.field(static=True)

    def __init__(
        self,
        *,
        full_well: ArrayLike | None = None,
        axis: Axis = "rows",
        width: ArrayLike | None = None,
        pixel_pitch: ArrayLike | None = None,
        readout: ArrayLike | None = None,
        rows_read: RowsRead = "down",
    ):
        numbers = {"full_well": full_well, "width": width, "pixel_pitch": pixel_pitch}
        for name, value in (numbers | {"readout": readout}).items():
            setattr(self, name, None if value is None else as_float(value, f"Sensor({name}=...)"))
        self.axis = axis
        self.rows_read = rows_read

    def __check_init__(self) -> None:
        for name in ("full_well", "width", "pixel_pitch"):
            value, subject = getattr(self, name), f"Sensor({name}=...)"
            if value is not None:
                require_number(subject, value, "above 0", strict=True)
        if self.readout is not None:
            require_number("Sensor(readout=...)", self.readout, "at least 0")
        is_axis = self.axis in get_args(Axis)
        require(is_axis, "Sensor(axis=...)", "be 'rows' or 'columns'", self.axis)
        is_way = self.rows_read in get_args(RowsRead)
        require(is_way, "Sensor(rows_read=...)", "be 'down' or 'up'", self.rows_read)

    @property
    def readout_time(self) -> float:
        """Time from its first row to its last, 0 where nothing says it; s, of a known sensor."""
        return 0.0 if self.readout is None else float(self.readout)

    @property
    def is_rolling(self) -> bool:
        """Whether its rows are known to be exposed one after another."""
        return self.readout_time > 0

    def require_read_within(self, subject: str, burst: "BurstMode") -> None:
        """Refuses a known readout that is longer than the time from frame to frame.

        Args:
            subject: Name of the readout, in the error.
            burst: Frames of the camera.
        """
        if not all_concrete((self.readout, burst.frames_per_s)):
            return
        period, readout = 1 / float(burst.frames_per_s), self.readout_time
        requirement = f"be at most the {1e3 * period:g} ms from frame to frame"
        # Numbers of scenes may be those of single precision.
        is_read, got = readout <= period * (1 + 1e-6), Unquoted(f"{1e3 * readout:g} ms")
        require(is_read, subject, requirement, got)

    def row_delays(self, num_rows: int) -> Float[np.ndarray, "{num_rows}"]:
        """Times by which each row of a picture is exposed later than the middle of all rows; s.

        Args:
            num_rows: Rows of the picture, over which the readout lasts.

        Raises:
            ValueError: if `num_rows` is not a whole number above 0.
        """
        require_positive_int("Sensor.row_delays(num_rows=...)", num_rows)
        half = self.readout_time / 2 * (1 if self.rows_read == "down" else -1)
        return np.linspace(-half, half, num_rows) if num_rows > 1 else np.zeros(1)


@final
class BurstMode(AbstractModule):
    """Frames that a camera may take instead of one exposure.

    Args:
        frames_per_s: Frames that the sensor reads out a second.
        max_frames: Most frames of a burst; by default as many as the window holds, up
            to 1000.
        window: Longest time from the first light to the last; s. By default twice the longest half
            exposure of the scene's limits, as long as one exposure may be.
        dead_time: Time between the end of one frame and the beginning of the next in which the
            sensor sees nothing, at least; s.

    Raises:
        ValueError: if `frames_per_s` or `window` is not above 0, `max_frames` is not a whole number
            above 0, or `dead_time` is below 0 or not shorter than the time from frame to frame.
    """

    frames_per_s: Array
    window: Array | None
    dead_time: Array
    max_frames: int | None = eqx.field(static=True)

    def __init__(
        self,
        *,
        frames_per_s: ArrayLike,
        max_frames: int | None = None,
        window: ArrayLike | None = None,
        dead_time: ArrayLike = 0.0,
    ):
        self.frames_per_s = as_float(frames_per_s, "BurstMode(frames_per_s=...)")
        self.window = None if window is None else as_float(window, "BurstMode(window=...)")
        self.dead_time = as_float(dead_time, "BurstMode(dead_time=...)")
        if max_frames is not None:
            max_frames = require_positive_int("BurstMode(max_frames=...)", max_frames)
        self.max_frames = max_frames

    def __check_init__(self) -> None:
        for name in ("frames_per_s", "window"):
            value, subject = getattr(self, name), f"BurstMode({name}=...)"
            if value is not None:
                require_number(subject, value, "above 0", strict=True)
        subject = "BurstMode(dead_time=...)"
        require_number(subject, self.dead_time, "at least 0")
        if is_concrete(self.dead_time) and is_concrete(self.frames_per_s):
            period = 1 / float(self.frames_per_s)
            requirement = f"be shorter than the {period:g} s from frame to frame"
            require(float(self.dead_time) < period, subject, requirement, self.dead_time)


def noise_power(
    throughput: Numbers,
    mean_level: Numbers,
    electrons: Numbers,
    read_noise: Numbers,  # e-
    *,
    unit: Numbers = 1.0,
) -> Any:
    r"""Variance of a pixel, $\eta \bar f p + \sigma^2$, in squares of a unit; of any shape.

    The noise of equation (4) of "Improved motion invariant imaging with time varying shutter
    functions": Poisson numbers of electrons, and those of reading. In units of $p$ it is
    $\eta \bar f/p + (\sigma/p)^2$.
    """
    shot = throughput * mean_level * (electrons / unit) / unit
    return shot + (read_noise / unit) ** 2


def white_electrons(photon_rate: Numbers, exposure: Numbers, throughput: Numbers = 1.0) -> Any:
    r"""Photo-electrons of a white pixel, $p = R\cdot\eta\cdot 2T$; e-, of NumPy if concrete."""
    rate, exposure = as_numpy(photon_rate, exposure)
    return rate * (throughput * exposure)


def noise_of_frames(
    photon_rate: Numbers, exposure: Numbers, mean_level: Numbers, read_noise: Numbers
) -> tuple[Any, Any]:
    """Electrons of white in frames of an open shutter, and the variance of their noise; e-, e-^2.

    The variance is `DARK` of the square of white at least, or of one electron: pictures without
    light or noise have a level too.
    """
    numbers = as_numpy(photon_rate, exposure, mean_level, read_noise)
    space = np if all_concrete(numbers) else jnp
    rate, exposure, mean_level, read_noise = numbers
    electrons = white_electrons(rate, exposure)
    noise = noise_power(1.0, mean_level, electrons, read_noise)
    return electrons, space.maximum(noise, DARK * space.maximum(electrons, 1.0) ** 2)


def filling_half_exposure(
    full_well: ArrayLike, photon_rate: ArrayLike, throughput: ArrayLike = 1.0
) -> Float[np.ndarray, "..."]:
    """Half exposure after which white fills a pixel, infinite without light; s, of any shape."""
    rate = np.asarray(photon_rate, np.float64) * np.asarray(throughput, np.float64)
    with np.errstate(divide="ignore"):
        return np.asarray(np.asarray(full_well, np.float64) / (2 * rate))
