"""High-speed footage exposed under a shutter by a moving sensor."""

import warnings
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np

from mishutter._core import (
    Bare,
    common_dtype,
    floating_light,
    require,
    require_positive_int,
    shape_of,
)
from mishutter.blur import path_ends, waves_on_dft
from mishutter.camera.rows import PAD_MODES, continued, period_of
from mishutter.model import (
    GAMMA,
    AbstractMotion,
    AbstractShutter,
    Optics,
    Picture,
    piecewise,
    read_picture,
)

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


def expose_frames(
    frames: Frames, motion: AbstractMotion, shutter: AbstractShutter, optics: Optics
) -> np.ndarray:
    r"""Light on a moving sensor while footage plays, one frame at a time.

    $\hat g(f) = \operatorname{sinc}(f) \sum_i \hat f_i(f) \int_{t_i}^{t_{i+1}} w(t)\,e^{-2\pi i f
    x(t)}\,dt$: each frame is a continuous, band-limited picture through its pixels, for as long as
    it shows.

    Args:
        frames: The footage, in linear light.
        motion: Motion of the sensor.
        shutter: Transmittance over the exposure.
        optics: The lens.

    Returns:
        Light in units of a fully open exposure; shape of a frame.

    Raises:
        ValueError: if frames differ in shape, hold values that are not light, or are not
            as many as was said.
    """
    position, light, number = _nodes(shutter, motion, frames.num_frames)
    reach = int(np.ceil(np.max(np.abs(position))))
    total, shape, dtype, period, num_seen = None, None, None, 0, 0
    for index, frame in enumerate(frames.frames):
        image = _checked(frame, shape)
        num_seen += 1
        if total is None:
            shape, dtype = image.shape, image.dtype
            period = period_of(shape[1], reach, frames.border)
            total = np.zeros((shape[0], shape[2], period // 2 + 1), complex)
        mine = number == index
        if not np.any(light[mine]):
            continue
        waves = waves_on_dft(position[None, mine], light[None, mine], period, total.shape[-1])
        rows = continued(np.moveaxis(image, 1, 2).astype(np.float64), period, frames.border)
        total += np.fft.rfft(rows) * np.asarray(waves[0])
    subject = "Frames(num_frames=...)"
    wanted = frames.num_frames
    require(num_seen == wanted, subject, f"be the {num_seen} that came", wanted)
    if total is None or shape is None:
        return np.zeros((0, 0, 1))
    aperture = np.sinc(np.arange(total.shape[-1]) / period) * optics.response(period)
    recorded = np.fft.irfft(total * aperture, period)[..., : shape[1]]
    return np.ascontiguousarray(np.moveaxis(recorded, 2, 1)).astype(dtype)


_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)
_NUM_PANELS = 16
"""Panels of the exposure, short enough for these nodes to integrate the narrowest profile."""
_PX_A_PANEL = 2.0


def _nodes(
    shutter: AbstractShutter, motion: AbstractMotion, num_frames: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions of the sensor, px, the light there, and the frame that shows; shape `(q,)` each."""
    half = float(motion.half_exposure)
    profile = piecewise(shutter)
    dtype = np.dtype(profile.dtype() or common_dtype())
    breaks = np.asarray(profile.breakpoints(dtype).high, np.float64)
    breaks = np.append(breaks, np.array(path_ends(motion), float))
    fastest = float(motion.top_speed) * half
    count = _NUM_PANELS + int(np.ceil(2 * fastest / _PX_A_PANEL))
    shown = np.linspace(-1, 1, num_frames + 1)
    ends = np.unique(np.concatenate([np.linspace(-1, 1, count + 1), shown, np.clip(breaks, -1, 1)]))
    width = np.diff(ends)[:, None]
    tau = ends[:-1, None] + width * (_NODES + 1) / 2
    light = width / 4 * _WEIGHTS * np.asarray(shutter.transmittance(tau.astype(dtype)), np.float64)
    number = np.clip(np.searchsorted(shown, tau) - 1, 0, num_frames - 1)
    time = tau * half
    return np.asarray(motion.position(time)).ravel(), light.ravel(), number.ravel()


def _checked(frame: np.ndarray | Picture, shape: tuple | None) -> np.ndarray:
    subject = "Frames(frames=...)"
    light = floating_light(frame.light if isinstance(frame, Picture) else frame, subject)
    light = light[..., None] if light.ndim == 2 else light
    layout = light.ndim == 3 and light.shape[2] in (1, 3) and min(light.shape) > 0
    require(layout, subject, "be pictures", shape_of(light))
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
