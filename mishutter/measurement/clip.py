"""Clips: frames of a camera at rest as its files hold them, and files that hold no clip."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float, Shaped

from mishutter._core.checks import Unquoted, require, shape_of
from mishutter.pictures.files import VIDEO_SUFFIXES, by_numbers, is_tiff, pictures_in
from mishutter.pictures.images import decoded_pages, frames_of_tiff

Source: TypeAlias = str | Path | np.ndarray | Sequence[str | Path]
"""Files, a folder of them, or an array of `(frames, rows, columns)`."""

MOST_FRAMES = 64
"""Frames of a clip that are read; further ones would make no number better that matters."""
LEAST_SIDE = 48
"""Rows and columns of the least frame: a tile, of which one velocity is found."""


class Levels(NamedTuple):
    """Frames as files hold them."""

    # Levels; shape `(frames, rows, columns)`, float32
    frames: Float[np.ndarray, "frames rows columns"]
    full: float  # Greatest level of the file's depth
    is_whole: bool  # Whether levels are whole numbers
    words: tuple[str, ...] = ()  # Sentences on what was read otherwise than one would expect
    # A sentence on how white follows from the levels; `""` where the file states it
    guess: str = ""
    kind: str = ""  # Depth and colours of the files, in words; `""` of arrays


@dataclass(frozen=True, eq=False)
class Clip:
    """Frames of a camera at rest, at equal times."""

    # Levels; shape `(frames, rows, columns)`, float32
    frames: Float[np.ndarray, "frames rows columns"]
    frames_per_s: float  # Frames a second
    exposure: float | None  # Exposure of a frame, s; None if it is not known
    white: float  # Level of white
    step: float  # Step between neighbouring levels; 0 for levels that are no whole numbers
    ends: tuple[float, float]  # Levels at and beyond which the file cuts off, below and above
    words: tuple[str, ...] = ()  # Sentences on what was read otherwise than one would expect
    kind: str = ""  # Depth and colours of its files, in words; `""` of arrays

    @property
    def num_frames(self) -> int:
        """Number of frames."""
        return self.frames.shape[0]

    @property
    def longest_exposure(self) -> float:
        """The exposure, or the longest that the frame rate allows; s."""
        return 1 / self.frames_per_s if self.exposure is None else self.exposure

    def with_words(self, words: Iterable[str], frames: np.ndarray | None = None) -> "Clip":
        """The clip with more sentences on it, and with frames that were corrected, if any were."""
        own = self.frames if frames is None else frames
        return replace(self, frames=own, words=(*self.words, *words))


def clip_of(
    source: Source,
    frames_per_s: float | int,
    exposure: float | int | None,  # s
    white: float | int | None,
) -> Clip:
    """A clip from files or an array."""
    requirement, subject = "be a number above 0", "measure(frames_per_s=...)"
    require(_is_above_zero(frames_per_s), subject, requirement, frames_per_s)
    if exposure is not None:
        subject, period = "measure(exposure=...)", 1 / frames_per_s
        requirement = f"be above 0 and at most the {period:g} s from frame to frame"
        # A period that was rounded in milliseconds may exceed the frame's by little.
        fits = _is_above_zero(exposure) and exposure <= 1.01 * period
        require(fits, subject, requirement, exposure)
    if white is not None:
        require(_is_above_zero(white), "measure(white=...)", "be a number above 0", white)
    levels = read_levels_of(source, "measure(clip=...)", most=MOST_FRAMES)
    frames, subject = levels.frames, "measure(clip=...)"
    count, *size = frames.shape
    requirement = "hold at least 2 frames, of which the differences are the noise"
    require(count >= 2, subject, requirement, count)
    requirement = f"have at least {LEAST_SIDE} rows and columns"
    require(min(size) >= LEAST_SIDE, subject, requirement, f"{size[0]} x {size[1]}")
    same = [k for k in range(1, count) if np.array_equal(frames[k], frames[k - 1])]
    requirement = "hold frames that each were exposed: record at the camera's own frame rate"
    got = Unquoted(f"frame {same[0] + 1} equal to the one before it" if same else "")
    require(not same, subject, requirement, got)
    _check_lost(frames)
    step = 0.0
    if levels.is_whole:
        # The greatest common step is 16 where 12 bits are stored in the upper ones of 16.
        distinct = np.unique(frames.astype(np.int64))
        step = float(np.gcd.reduce(np.diff(distinct))) if distinct.size > 1 else 1.0
    return Clip(
        frames=frames,
        frames_per_s=float(frames_per_s),
        exposure=None if exposure is None else float(exposure),
        white=levels.full if white is None else float(white),
        step=step,
        ends=cut_off(frames, step),
        words=(*levels.words, *([levels.guess] if levels.guess and white is None else [])),
        kind=levels.kind,
    )


def read_levels_of(source: Source, subject: str, most: int | None = None) -> Levels:
    """Levels of files, of a folder's pictures in the order of their numbers, or of an array."""
    if isinstance(source, np.ndarray):
        return _of_array(source, subject, most)
    paths = [source] if isinstance(source, str | Path) else list(source)
    files = [file for path in paths for file in _files(Path(path), subject)]
    require(len(files) > 0, subject, "name a file", Unquoted("none"))
    # A shell, too, lists `frame_10` before `frame_2`.
    if files == sorted(files):
        files.sort(key=lambda path: by_numbers(path.name))
    parts, words, count = [], _gaps(files), 0
    for file in files:
        if most is not None and count >= most:
            break
        part = _of_file(file, subject, None if most is None else most - count)
        parts.append(part)
        count += len(part.frames)
        words += part.words
    sizes = [part.frames.shape[1:] for part in parts]
    odd = next((k for k, size in enumerate(sizes) if size != sizes[0]), 0)
    requirement = f"hold frames of one size, {sizes[0][0]} x {sizes[0][1]}"
    got = Unquoted(f"{sizes[odd][0]} x {sizes[odd][1]} in {str(files[odd])!r}")
    require(odd == 0, subject, requirement, got)
    kinds = [part.kind for part in parts]
    odd = next((k for k, kind in enumerate(kinds) if kind != kinds[0]), 0)
    got = Unquoted(f"{kinds[odd] or 'others'} in {str(files[odd])!r}")
    require(odd == 0, subject, f"hold frames of one kind, {kinds[0] or 'arrays'}", got)
    full = max(part.full for part in parts)
    frames = np.concatenate([part.frames for part in parts])
    if len(files) > len(parts):
        words.append(_first(most))
    is_whole = all(part.is_whole for part in parts)
    full, guess = _depth(frames, full) if is_whole else (full, "")
    return Levels(frames, full, is_whole, tuple(dict.fromkeys(words)), guess, kinds[0])


def cut_off(frames: Shaped[np.ndarray, "frames rows columns"], step: float) -> tuple[float, float]:
    """Levels at and beyond which a file cuts off; infinite where it does not."""
    if step == 0:
        return -np.inf, np.inf
    low, high = float(frames.min()), float(frames.max())
    least = int(np.rint(low / step))
    counts = np.bincount(np.rint(frames.ravel() / step).astype(np.int64) - least)
    ends = []
    for end, beside in ((0, 1), (-1, -2)):
        few = counts[beside] if counts.size > 1 else 0
        # Noise spreads a level that is met over those beside it; a converter that ends there does
        # not. A tail of noise may leave some pixels there by chance.
        ends.append(counts[end] > max(1.5 * few, 1e-4 * frames.size, 10))
    # Where black is above level 0, dark parts lie on few levels and are not cut off.
    return low if ends[0] and low <= 0 else -np.inf, high if ends[1] else np.inf


def _depth(frames: np.ndarray, full: float) -> tuple[float, str]:
    """White of levels that fill fewer bits than their file has, and a sentence that says so."""
    most = float(frames.max())
    depth = next((bits for bits in (8, 10, 12, 14) if most < 1 << bits), 16)
    if full not in (np.iinfo(np.uint16).max, np.iinfo(np.int16).max) or depth == 16:
        return full, ""
    white = float((1 << depth) - 1)
    text = (
        f"no level exceeds {most:g} of {full:g}: white is taken for {white:g}, as of {depth} bits"
    )
    return white, f"{text} (set --white if it is another)"


def _is_above_zero(value: object) -> bool:
    is_number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    return is_number and bool(np.isfinite(value)) and value > 0  # type: ignore[operator]


def _files(path: Path, subject: str) -> list[Path]:
    if not path.exists():
        raise FileNotFoundError(f"`{subject}` must name files; got {str(path)!r}, not found.")
    if not path.is_dir():
        return [path]
    files = pictures_in(path, ".npy")
    require(len(files) > 0, subject, "name a folder of frames", str(path))
    return files


def _gaps(files: Sequence[Path]) -> list[str]:
    """A sentence on numbers that are missing in the names of files that one number tells apart."""
    names = [by_numbers(file.name) for file in files]
    if len(names) < 3 or len({len(name) for name in names}) > 1:
        return []
    varied = [each for each in zip(*names, strict=True) if len(set(each)) > 1]
    if len(varied) != 1 or isinstance(varied[0][0], str):
        return []
    steps = np.diff(np.array(varied[0], float))
    # Times in names are equally far apart but for rounding.
    wide = np.flatnonzero(steps > 1.5 * np.median(steps))
    if not 0 < wide.size <= len(steps) // 2 or np.any(steps <= 0):
        return []
    first = int(wide[0])
    return [
        f"the names of files leave out a number after {files[first].name!r}, before "
        f"{files[first + 1].name!r}: if a frame is missing there, velocities are too high"
    ]


def _check_lost(frames: Float[np.ndarray, "frames rows columns"]) -> None:
    """Refuses a frame whose rows hold one level each, as those of a buffer that was lost do.

    Rows that are stuck, or dark, hold one level in most frames.
    """
    constant = frames.max(axis=2) == frames.min(axis=2)
    lost = np.sum(constant & (constant.mean(axis=0) < 0.5), axis=1)
    worst, rows = int(np.argmax(lost)), frames.shape[1]
    got = Unquoted(f"frame {worst + 1}, in which {lost[worst]} of {rows} rows hold one level")
    requirement = "hold frames that each were exposed: give those before or after a lost one"
    # Rows that are cut off at black change with what moves.
    require(bool(lost[worst] <= 0.25 * rows), "measure(clip=...)", requirement, got)


def _of_array(array: np.ndarray, subject: str, most: int | None, name: str = "") -> Levels:
    place = f" in {name!r}" if name else ""
    is_number = array.dtype.kind in "uif"
    got = Unquoted(f"{array.dtype}{place}")
    require(is_number, subject, "hold whole or floating-point levels", got)
    array = array[None] if array.ndim == 2 else array
    is_stack = array.ndim == 3 and min(array.shape) > 0
    requirement = "be of shape (frames, rows, columns)"
    require(is_stack, subject, requirement, Unquoted(f"{shape_of(array)}{place}"))
    words = () if most is None or len(array) <= most else (_first(most),)
    array = np.asarray(array[:most])
    is_whole = array.dtype.kind in "ui"
    frames = array.astype(np.float32)
    finite = np.isfinite(frames).all(axis=(1, 2))
    got = Unquoted(f"NaN or an infinity in frame {int(np.argmin(finite)) + 1}{place}")
    require(bool(finite.all()), subject, "hold finite levels", got)
    if not is_whole:
        return Levels(frames, float(frames.max()), False, words)
    # Levels below 0 are those of a camera or program that takes black off.
    low, high = int(array.min()), int(array.max())
    in_range = high < 1 << 16 and low >= -(1 << 15)
    requirement = (
        "hold levels of 8 to 16 bits (give others as floating-point numbers, with --white)"
    )
    require(in_range, subject, requirement, Unquoted(f"{low} to {high}{place}"))
    full = float(min(np.iinfo(array.dtype).max, np.iinfo(np.uint16).max))
    full, guess = _depth(frames, full) if name == "" else (full, "")
    return Levels(frames, full, True, words, guess)


def _of_file(path: Path, subject: str, most: int | None) -> Levels:
    """Levels of the frames of a file, if it holds every one as the camera gave it."""
    kind = _lossy_kind(path)
    got = Unquoted(f"{kind}, {str(path)!r}, which changes the noise: record without compression")
    require(not kind, subject, "be uncompressed frames, as PNG, TIFF, PGM or .npy", got)
    if path.suffix.lower() == ".npy":
        try:
            array = np.load(path, mmap_mode="r", allow_pickle=False)
        except ValueError as error:
            reason = Unquoted(f"{str(path)!r}: {error}")
            require(False, subject, "hold an array of numbers", reason)
            raise
        return _of_array(array, subject, most, str(path))
    stack = frames_of_tiff(path, most) if is_tiff(path) else None
    if stack is not None:
        levels = _of_array(stack.frames, subject, most, str(path))
        words = [stack.word] if stack.word else []
        words += [_first(most)] if stack.has_more else []
        return levels._replace(words=tuple(words), kind=_kind_of(levels.full, is_grey=True))
    pages = decoded_pages(path, most)
    words, planes, greys = [], [], []
    for page in pages:
        colour = page.colour
        is_grey = colour.shape[2] == 1 or np.array_equal(colour[..., 0], colour[..., 1])
        if not is_grey:
            words.append("frames are in colour: their green is measured")
        greys.append(is_grey)
        # Green levels are interpolated no more than others.
        planes.append(colour[..., 0 if is_grey else 1].astype(np.float32))
    frames = np.stack(planes)
    finite = bool(np.isfinite(frames).all())
    got = Unquoted(f"NaN or an infinity in {str(path)!r}")
    require(finite, subject, "hold finite levels", got)
    if pages[0].exponent not in (None, 1.0):
        words.append(
            f"files say that light is the power {pages[0].exponent:g} of their levels: the curve "
            "of the noise decides"
        )
    if len(pages) == most and pages[-1].has_more:
        words.append(_first(most))
    first, full = pages[0].colour, pages[0].full
    # Black alone has the same level in all colours too.
    is_one = first.shape[2] == 1 or (greys[0] and bool(first.min() < first.max()))
    kind = _kind_of(full, is_grey=is_one)
    return Levels(frames, full, first.dtype.kind == "u", tuple(words), kind=kind)


def _kind_of(full: float, *, is_grey: bool) -> str:
    """Depth and colours of a file in words, by the greatest level of its depth."""
    return f"{8 if full < 1 << 8 else 16}-bit {'grey' if is_grey else 'colour'}"


def _first(most: int | None) -> str:
    return f"the first {most} frames are read"


def _lossy_kind(path: Path) -> str:
    """The kind of a file that does not hold every level; `""` of others."""
    with path.open("rb") as file:
        head = file.read(12)
    if head.startswith(b"\xff\xd8"):
        return "a JPEG"
    if head[:4] == b"RIFF" and head[8:] == b"WEBP":
        return "a WebP"
    if path.suffix.lower() in VIDEO_SUFFIXES or head[4:8] == b"ftyp":
        return "a video"
    if is_tiff(path):
        import tifffile

        with tifffile.TiffFile(path) as file:
            scheme = getattr(file.pages[0], "compression", 1)
        # These compressions keep every level.
        if int(scheme) not in (1, 5, 8, 32773, 32946, 34925, 50000):
            return f"a TIFF compressed by {getattr(scheme, 'name', scheme)}"
    return ""
