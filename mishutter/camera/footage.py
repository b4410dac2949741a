"""High-speed footage exposed under a shutter by a moving sensor."""

import re
import subprocess
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import ArrayLike, Float, Int

from mishutter._core.checks import (
    Unquoted,
    common_dtype,
    floating_light,
    require,
    require_finite,
    require_positive_int,
    shape_of,
)
from mishutter.blur.waves import waves_on_dft
from mishutter.camera.responses import aperture_on
from mishutter.camera.rows import PAD_MODES, blur_length, continued, period_of
from mishutter.model.motion import AbstractMotion
from mishutter.model.optics import Optics
from mishutter.model.shutters.base import AbstractShutter, piecewise
from mishutter.pictures.files import VIDEO_SUFFIXES, Decoded, pictures_in
from mishutter.pictures.images import (
    Axis,
    Picture,
    PictureWarning,
    checked_white,
    examined,
    light_of,
    transposed,
)

_GIF = ".gif"
_READ = "read_frames(path=...)"
_ONCE = ("-an", "-fps_mode", "vfr")
"""Has FFmpeg give each frame once, at its time in steps of the frame rate."""


@dataclass(frozen=True, eq=False)
class Footage:
    """Frames of a camera at rest, spread over the exposure, each shown for its share.

    Attributes:
        frames: Light of each frame, white = 1, shape `(rows, columns, channels)`; an
            array, a list, or an iterator that is read once.
        num_frames: Number of frames.
        border: Continuation of each beyond its ends: `"reflect"`, `"edge"`, `"wrap"`, `"zero"`.
        durations: Duration of each, in any one unit; all equal by default.
    """

    frames: Iterable[np.ndarray | Picture]
    num_frames: int
    border: str = "reflect"
    durations: Sequence[float] | None = None

    def __post_init__(self) -> None:
        require_positive_int("Footage(num_frames=...)", self.num_frames)
        is_known, requirement = self.border in PAD_MODES, f"be one of {[*PAD_MODES]}"
        require(is_known, "Footage(border=...)", requirement, self.border)
        if self.durations is not None:
            subject, durations = "Footage(durations=...)", self.durations
            is_complete = np.shape(durations) == (self.num_frames,)
            require(is_complete, subject, f"be {self.num_frames}, one a frame", shape_of(durations))
            require_finite(subject, np.asarray(durations))
            least = float(np.min(durations))
            require(least > 0, subject, "be above 0", least)

    @property
    def ends(self) -> Float[np.ndarray, "ends"]:
        """Times at which frames begin, and the last ends, in half exposures from its middle."""
        if self.durations is None:
            return np.linspace(-1, 1, self.num_frames + 1)
        times = np.concatenate([[0.0], np.cumsum(np.asarray(self.durations, np.float64))])
        return 2 * (times / times[-1]) - 1

    def transposed(self, axis: Axis) -> "Footage":
        """The footage with rows and columns exchanged, unless things move along its rows.

        Args:
            axis: The axis along which things move.
        """
        radiances = (f.light if isinstance(f, Picture) else np.asarray(f) for f in self.frames)
        return replace(self, frames=(transposed(radiance, axis) for radiance in radiances))

    @staticmethod
    def of(frames: np.ndarray | list, border: str = "reflect") -> "Footage":
        """Frames that are all there; the first axis counts them.

        Args:
            frames: Pictures of one size.
            border: What goes on beyond their borders, as `Footage` takes it.
        """
        require(len(frames) >= 1, "Footage.of(frames=...)", "hold at least one frame", 0)
        return Footage(frames, len(frames), border)


def read_frames(
    path: str | Path,
    border: str = "reflect",
    *,
    white: ArrayLike | None = None,
    linear: bool = False,
) -> Footage:
    """Frames from a folder of pictures, in the order of their numbers, or from a video file.

    Frames are read one by one as they are exposed, and show for as long as the file says. Video
    other than GIF needs FFmpeg, which the extra `mishutter[video]` installs; its values are
    gamma-coded as pictures are.

    Args:
        path: The folder, or the file, whose name ends as those of videos do.
        border: As in `Footage`.
        white: As in `read_picture`.
        linear: As in `read_picture`.

    Raises:
        OSError: if there is no such file or folder.
        ValueError: if it holds no frames, or cannot be decoded.

    Warns:
        PictureWarning: as `read_picture`, once for a folder; or if FFmpeg has met errors.
    """
    path, white_level = Path(path), checked_white("read_frames(white=...)", white)
    if not path.exists():
        got = f"{str(path)!r}, not found"
        raise FileNotFoundError(f"`{_READ}` must name a folder or a video; got {got}.")
    if path.is_dir():
        names = pictures_in(path)
        got = Unquoted(f"folder {str(path)!r}, which has none")
        require(len(names) >= 1, _READ, "hold pictures", got)
        return Footage(_pictures(names, white_level, linear), len(names), border)
    kinds = ", ".join(suffix[1:] for suffix in VIDEO_SUFFIXES)
    is_video = path.suffix.lower() in VIDEO_SUFFIXES
    require(is_video, _READ, f"name a folder of pictures or a video ({kinds})", str(path))
    try:
        if path.suffix.lower() == _GIF:
            durations, frames = _durations_of_gif(path), _frames_of_gif(path)
        else:
            durations, frames = _durations_of_video(path), _frames_of_video(path)
    except ImportError as error:
        raise ValueError(
            f"`{_READ}` must name a video while FFmpeg is installed, as the extra "
            f"mishutter[video] does; got {str(path)!r}: {error}."
        ) from error
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        got = f"{str(path)!r}: {reason.removesuffix('.')}"
        raise ValueError(f"`{_READ}` must name a whole video; got {got}.") from error
    require(len(durations) >= 1, _READ, "hold at least one frame", str(path))
    decoded = (Decoded(frame, None, 255.0) for frame in frames)
    radiances = (light_of(frame, path, white_level, linear) for frame in decoded)
    return Footage(radiances, len(durations), border, durations)


def expose_frames(
    frames: Footage, motion: AbstractMotion, shutter: AbstractShutter, optics: Optics
) -> np.ndarray:
    r"""Light on a moving sensor while footage plays, one frame at a time.

    $\hat g(f) = \operatorname{sinc}(f) \sum_i \hat f_i(f) \int_{t_i}^{t_{i+1}} w(t)\,e^{-2\pi i f
    x(t)}\,dt$: each frame is a continuous, band-limited picture through its pixels, for as long as
    it shows.
    """
    blur_length(motion, 0.0, subject="motion")
    places, weights, shown = _nodes(shutter, motion, frames.ends)
    reach = int(np.ceil(np.max(np.abs(places))))
    total, shape, dtype, period, num_frames = None, None, None, 0, 0
    for index, frame in enumerate(frames.frames):
        image = _checked(frame, shape)
        num_frames += 1
        if total is None:
            shape, dtype = image.shape, image.dtype
            period = period_of(shape[1], reach, frames.border)
            total = np.zeros((shape[0], shape[2], period // 2 + 1), complex)
        is_own = shown == index
        if not np.any(weights[is_own]):
            continue
        waves = waves_on_dft(places[None, is_own], weights[None, is_own], period, total.shape[-1])
        rows = continued(np.moveaxis(image, 1, 2).astype(np.float64), period, frames.border)
        total += np.fft.rfft(rows) * np.asarray(waves[0])
    subject = "Footage(num_frames=...)"
    is_complete = num_frames == frames.num_frames
    require(is_complete, subject, f"be the {num_frames} that came", frames.num_frames)
    if total is None or shape is None:
        return np.zeros((0, 0, 1))
    irradiance = np.fft.irfft(total * aperture_on(optics, (period,)), period)[..., : shape[1]]
    return np.ascontiguousarray(np.moveaxis(irradiance, 2, 1)).astype(dtype)


def _nodes(
    shutter: AbstractShutter, motion: AbstractMotion, frame_ends: Float[np.ndarray, "ends"]
) -> tuple[Float[np.ndarray, "q"], Float[np.ndarray, "q"], Int[np.ndarray, "q"]]:
    """Places of the sensor, px, at quadrature nodes, their weights, and the frames that show.

    Panels also end where frames do. Transmittances are part of the weights.
    """
    nodes, weights = np.polynomial.legendre.leggauss(12)
    half = float(motion.half_exposure)
    profile = piecewise(shutter)
    dtype = np.dtype(profile.dtype() or common_dtype())
    breaks = np.asarray(profile.breakpoints(dtype), np.float64)
    breaks = np.append(breaks, np.array(motion.piece_ends, float))
    fastest = float(motion.top_speed) * half
    # Sixteen panels integrate the narrowest profile; none is longer than 2 px.
    count = 16 + int(np.ceil(2 * fastest / 2.0))
    equal_ends, breaks = np.linspace(-1, 1, count + 1), np.clip(breaks, -1, 1)
    ends = np.unique(np.concatenate([equal_ends, frame_ends, breaks]))
    width = np.diff(ends)[:, None]
    tau = ends[:-1, None] + width * (nodes + 1) / 2
    transmittance = np.asarray(shutter.transmittance(tau.astype(dtype)), np.float64)
    weight = width / 4 * weights * transmittance
    frame = np.clip(np.searchsorted(frame_ends, tau) - 1, 0, frame_ends.size - 2)
    position = np.asarray(motion.position(tau * half))
    return position.ravel(), weight.ravel(), frame.ravel()


def _checked(frame: np.ndarray | Picture, shape: tuple | None) -> np.ndarray:
    subject = "Footage(frames=...)"
    radiance = floating_light(frame.light if isinstance(frame, Picture) else frame, subject)
    radiance = radiance[..., None] if radiance.ndim == 2 else radiance
    is_picture = radiance.ndim == 3 and radiance.shape[2] in (1, 3) and min(radiance.shape) > 0
    require(is_picture, subject, "be pictures", shape_of(radiance))
    is_finite = bool(np.all(np.isfinite(radiance)))
    require(is_finite, subject, "hold finite light", Unquoted("a value that is not"))
    require(bool(np.min(radiance) >= 0), subject, "hold light of at least 0", np.min(radiance))
    has_shape = shape is None or radiance.shape == shape
    require(has_shape, subject, f"all have shape {shape}", shape_of(radiance))
    return radiance


def _pictures(names: Sequence[Path], white: float | None, linear: bool) -> Iterator[np.ndarray]:
    """Light of pictures, with one warning for all of them."""
    has_warned = False
    for name in names:
        picture, doubts = examined(name, white, linear)
        if doubts and not has_warned:
            warnings.warn(doubts[0], PictureWarning, stacklevel=2)
            has_warned = True
        yield picture.light


def _durations_of_gif(path: Path) -> tuple[float, ...]:
    """Durations of the frames of a GIF; all equal if the file has none."""
    from PIL import Image, ImageSequence

    with Image.open(path, formats=("GIF",)) as file:
        durations = tuple(float(f.info.get("duration", 0)) for f in ImageSequence.Iterator(file))
    if not any(durations):
        return (1.0,) * len(durations)
    if not all(durations):
        raise ValueError(f"frame {durations.index(0)} shows for no time")
    return durations


def _frames_of_gif(path: Path) -> Iterator[np.ndarray]:
    from PIL import Image, ImageSequence

    with Image.open(path, formats=("GIF",)) as file:
        for frame in ImageSequence.Iterator(file):
            yield np.asarray(frame.convert("RGB"))


def _durations_of_video(path: Path) -> tuple[float, ...]:
    """Durations of the `_frames_of_video`, of a file that FFmpeg reads without failing."""
    from imageio_ffmpeg import get_ffmpeg_exe

    command = [get_ffmpeg_exe(), "-nostdin", "-v", "error", "-xerror"]
    command += ["-i", str(path), *_ONCE, "-f", "framecrc", "-"]
    run = subprocess.run(command, capture_output=True, text=True, errors="replace", check=False)
    # Without FFmpeg's names and addresses of the parts that speak.
    lines = [line for line in run.stderr.splitlines() if line.strip()]
    messages = [re.sub(r"^(\[[^]]*\]\s*)+", "", line) for line in lines]
    if run.returncode:
        raise ValueError(messages[0] if messages else f"FFmpeg ended with code {run.returncode}")
    # Number of the stream, times of decoding and showing, duration, and three unused numbers.
    lines = [line.split(",") for line in run.stdout.splitlines() if not line.startswith("#")]
    if messages:
        doubt = f"{path}: {len(lines)} frames are read, and FFmpeg says: {messages[0]}"
        warnings.warn(doubt, PictureWarning, stacklevel=3)
    begins = [float(line[2]) for line in lines]
    ends = [*begins[1:], *(begins[-1] + float(line[3]) for line in lines[-1:])]
    return tuple(end - begin for begin, end in zip(begins, ends, strict=True))


def _frames_of_video(path: Path) -> Iterator[np.ndarray]:
    import imageio_ffmpeg

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # ffmpeg is started by a fork
        footage = imageio_ffmpeg.read_frames(str(path), output_params=[*_ONCE])
        columns, rows = next(footage)["size"]  # type: ignore[call-overload]
    for frame in footage:
        yield np.frombuffer(frame, np.uint8).reshape(rows, columns, 3)  # type: ignore[arg-type]
