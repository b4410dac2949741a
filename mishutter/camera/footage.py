"""High-speed footage exposed under a shutter by a moving sensor."""

import warnings
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np

from mishutter._core import Bare, require, require_positive_int, shape_of
from mishutter.blur import exposure_cells
from mishutter.camera.rows import PAD_MODES, padded_columns
from mishutter.model import GAMMA, AbstractMotion, AbstractShutter, Picture, read_picture

PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff")


@dataclass(frozen=True, eq=False)
class Frames:
    """Frames of a camera at rest, evenly spread over the exposure, each shown for its share.

    Attributes:
        frames: Light of each frame, white = 1, shape `(rows, columns, channels)`; an
            array, a list, or an iterator that is read once.
        num_frames: How many there are.
        border: How each goes on beyond its ends: `"reflect"`, `"edge"`, `"wrap"`, `"zero"`.
    """

    frames: Iterable[np.ndarray | Picture]
    num_frames: int
    border: str = "reflect"

    def __post_init__(self) -> None:
        require_positive_int("Frames(num_frames=...)", self.num_frames)
        require(
            self.border in PAD_MODES, "Frames(border=...)", f"be one of {[*PAD_MODES]}", self.border
        )

    @staticmethod
    def of(frames: np.ndarray | list, border: str = "reflect") -> "Frames":
        """Frames that are all there; the first axis counts them."""
        require(len(frames) >= 1, "Frames.of(frames=...)", "hold at least one frame", 0)
        return Frames(frames, len(frames), border)


def read_frames(path: str | Path, border: str = "reflect") -> Frames:
    """Frames from a folder of pictures, in the order of their names, or from a video file.

    Frames are read one by one as they are exposed. Video needs an imageio plug-in, which
    the extra `mishutter[video]` installs; its values are gamma-coded as pictures are.

    Raises:
        OSError: if there is no such file or folder.
        ValueError: if it holds no frames, or cannot be decoded.
    """
    path, subject = Path(path), "read_frames(path=...)"
    if not path.exists():
        raise FileNotFoundError(
            f"`{subject}` must name a folder or a video; got {str(path)!r}, not found."
        )
    if path.is_dir():
        names = sorted(p for p in path.iterdir() if p.suffix.lower() in PICTURE_SUFFIXES)
        require(len(names) >= 1, subject, "hold pictures", str(path))
        return Frames((read_picture(name).light for name in names), len(names), border)
    try:
        count = sum(1 for _ in _video(path))
    except Exception as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise ValueError(
            f"`{subject}` must name a video that imageio reads (its extra: "
            f"mishutter[video]); got {str(path)!r}: {reason}."
        ) from error
    require(count >= 1, subject, "hold at least one frame", str(path))
    return Frames(_video(path), count, border)


def expose_frames(frames: Frames, motion: AbstractMotion, shutter: AbstractShutter) -> np.ndarray:
    r"""Light on a moving sensor while footage plays, one frame at a time.

    $g_k = \sum_i \sum_c W_{ic} f_{i, k - c}$ with the light $W_{ic}$ that falls while frame
    `i` shows and the sensor is displaced by `c` pixels.

    Returns:
        Light in units of a fully open exposure; shape of a frame.

    Raises:
        ValueError: if frames differ in shape, hold values that are not light, or are not
            as many as was said.
    """
    half = float(motion.half_exposure)
    ends = np.linspace(-half, half, frames.num_frames + 1)
    cells = exposure_cells(shutter, motion, np.zeros(1), ends)
    shifts = cells.shifts[:, 0]
    number = np.clip(np.searchsorted(ends, cells.begin, side="right") - 1, 0, None)
    before, after = max(0, int(shifts.max())), max(0, -int(shifts.min()))
    total, seen = None, 0
    for index, frame in enumerate(frames.frames):
        light = _checked(frame, None if total is None else total.shape)
        seen += 1
        if total is None:
            total = np.zeros_like(light)
        padded = padded_columns(light.swapaxes(1, 2), before, after, frames.border).swapaxes(1, 2)
        mine = number == index
        for shift in np.unique(shifts[mine]):
            weight = light.dtype.type(np.sum(cells.light[mine & (shifts == shift)]))
            begin = before - int(shift)
            total += weight * padded[:, begin : begin + light.shape[1]]
    subject = "Frames(num_frames=...)"
    require(seen == frames.num_frames, subject, f"be the {seen} that came", frames.num_frames)
    return total if total is not None else np.zeros((0, 0, 1))


def _checked(frame: np.ndarray | Picture, shape: tuple | None) -> np.ndarray:
    light = frame.light if isinstance(frame, Picture) else np.asarray(frame)
    light = light[..., None] if light.ndim == 2 else light
    subject = "Frames(frames=...)"
    layout = light.ndim == 3 and light.shape[2] in (1, 3) and min(light.shape) > 0
    require(layout, subject, "be pictures", shape_of(light))
    floating = np.issubdtype(light.dtype, np.floating)
    require(floating, subject, "hold light as floating-point numbers", str(light.dtype))
    finite = bool(np.all(np.isfinite(light)))
    require(finite, subject, "hold finite light", Bare("a value that is not"))
    require(bool(np.min(light) >= 0), subject, "hold light of at least 0", np.min(light))
    same = shape is None or light.shape == shape
    require(same, subject, f"all have shape {shape}", shape_of(light))
    return light


def _video(path: Path) -> Iterator[np.ndarray]:
    import imageio.v3 as iio

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # ffmpeg is started by a fork
        footage = iio.imiter(path)
        first = next(footage, None)
    for frame in () if first is None else chain([first], footage):
        frame = frame[..., None] if frame.ndim == 2 else frame[..., :3]
        yield (frame.astype(np.float32) / np.iinfo(frame.dtype).max) ** np.float32(GAMMA)
