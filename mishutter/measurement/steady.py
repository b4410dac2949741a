"""Frames that a lamp, a shaking tripod or a lens makes unlike, and how far they are so.

A lamp that warms up or flashes changes the exposure, and a tripod that shakes moves the picture by
parts of a pixel. Both are judged by what stands still, and taken out.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import interpolate, ndimage

from mishutter.pictures.registration.windows import means

SIDE, PART = 8, 4
"""Sides of a block and of its quarters, whose means show what moves; px."""
_STEADY = 0.003
"""Deviation of the frames' exposures, as a share, that needs no correction."""
_STILL = 2.0
"""Square of the change of a block's mean, over that of noise, below which a block stands still."""
_LEAST_STILL = 0.15
"""Share of the blocks that must stand still to show an exposure."""
_LEAST_SHAKE, _MOST_SHAKE = 0.01, 1.0
"""Shake that changes no noise, and the greatest that is told from motion; px."""
_PARTS = 5
"""Parts of a picture along either side, whose motions tell the error of a shake."""
MOST_PIXELS = 250_000
"""Pixels of a frame by which its motion is found."""
_CERTAIN = 5.0
"""Errors beyond which a shake is taken for one."""
_LEAST_OF_BANDS, _LEAST_BANDS, _CERTAIN_BANDS = 4, 0.003, 8.0
"""Frames, and blocks of rows, that show bands; their least share, and errors of a certain one."""
_LINES_OF_BANDS, _LEAST_LIGHT = 500, 0.2
"""Rows of blocks by which black is found, and the least light of a row by which it is divided."""
_LEAST_FOCUS, _CERTAIN_FOCUS = 0.05, 8.0
"""Change of the square of the blur that changes no noise, px^2, and errors that make it certain."""


class Steady(NamedTuple):
    """Frames as files hold them, and made alike."""

    levels: Float[np.ndarray, "frames rows columns"]  # As files hold them
    same: Float[np.ndarray, "frames rows columns"]  # Of one exposure and one place
    gains: Float[np.ndarray, "frames"]  # Exposure of each frame, the usual one 1
    drift: float = 0.0  # Standard deviation of the exposures, as a share; 0 if none is taken out
    moves: Float[np.ndarray, "frames 2"] | None = None  # Motions that were taken out; px
    # Change of the square of the lens's blur over the clip; px^2, 0 if none is certain
    focus: float = 0.0
    # Share by which the light of rows differs in bands that change; 0 if none are certain
    bands: float = 0.0
    # Ways in whole pixels by which frames of a picture that moves as a whole were cut; px
    ways: Int[np.ndarray, "frames 2"] | None = None

    @staticmethod
    def of(frames: np.ndarray, ways: np.ndarray | None = None) -> "Steady":
        """Frames that are alike as they are."""
        return Steady(frames, frames, np.ones(len(frames)), ways=ways)

    @property
    def num_frames(self) -> int:
        """Number of frames."""
        return len(self.levels)

    @property
    def error(self) -> float:
        """Error of the noise by the motions that were taken out; a share."""
        if self.moves is None:
            return 0.0
        # A frame keeps so much of a pixel's noise where it is interpolated; the mean picture, which
        # is moved in its place, has a part of each frame's noise, and less detail than they.
        kept = np.prod(np.sinc(np.diff(self.moves, axis=0)), axis=1)
        return float(np.mean(1 - kept)) / len(self.levels)

    @property
    def words(self) -> list[str]:
        """Sentences on what was taken out, and on what cannot be."""
        words = []
        if self.drift:
            words.append(
                f"the exposure drifts by {self.drift:.1%} from frame to frame, which was divided "
                "out"
            )
        if self.ways is not None:
            moves = self.ways if self.moves is None else self.ways + self.moves
            words.append(
                f"all detail moves alike, by {_size(np.diff(moves, axis=0)):.2g} px a frame: the "
                f"noise is that of {len(moves)} frames laid on one another, and holds the fixed "
                "pattern of the pixels; a clip at rest, or flat fields (--flat), tell it without"
            )
        elif self.moves is not None:
            words.append(f"the camera shakes by {_size(self.moves):.2g} px, which was taken out")
        if self.focus:
            words.append(
                f"the focus drifts by {np.sqrt(self.focus):.2g} px of blur over the clip: noise is "
                "too high, and the picture blurred; lock the focus and record again"
            )
        if self.bands:
            words.append(
                f"the light differs by {self.bands:.1%} in bands of rows that change from frame to "
                "frame, which was divided out: lamps flicker on the mains while rows are read one "
                "after another, and noise may be off by as much; take daylight, or lamps on "
                "direct current"
            )
        return words


def steady(frames: np.ndarray, step: float, ways: np.ndarray | None = None) -> Steady:
    """Frames that are divided by their exposures and moved back, where they differ in these.

    Frames of a picture that moves as a whole are cut already, by the ways that it goes.
    """
    bands = bands_of_light(frames)
    even = _without_bands(frames) if bands else frames
    series = _of_one_exposure(even, step)._replace(levels=frames, ways=ways, bands=bands)
    moves, error, focus = moves_of(series.same)
    if np.abs(moves).max() > max(_MOST_SHAKE, _CERTAIN * error):
        # Where all moves, and not alike, nothing shows the exposure.
        return Steady.of(frames, ways)._replace(same=even, bands=bands)
    if _size(moves) > max(_LEAST_SHAKE, _CERTAIN * error):
        # The mean of frames that shake is blurred, which makes their motions look smaller.
        more = moves
        for _ in range(2):
            registered = _moved_back(series.same, moves)
            more, _, focus = moves_of(registered)
            moves = moves + more
        # Motion that is left is no shake.
        if _size(more) < 0.1 * _size(moves):
            series = series._replace(same=_moved_back(series.same, moves), moves=moves)
    value, error = focus
    is_certain = value > max(_LEAST_FOCUS, _CERTAIN_FOCUS * error)
    return series._replace(focus=value if is_certain else 0.0)


def bands_of_light(frames: Float[np.ndarray, "frames rows columns"]) -> float:
    """Share by which the light of rows differs in bands that change from frame to frame.

    Lamps that flicker on the mains light the rows of a rolling shutter unlike. Bands are alike in
    neighbouring blocks of rows, as noise is not; 0 if none are certain.
    """
    blocks = means(frames, SIDE)
    usual = np.median(blocks, axis=0)
    if len(frames) < _LEAST_OF_BANDS or min(usual.shape) < _LEAST_OF_BANDS:
        return 0.0
    seen = usual > np.quantile(usual, 0.25)
    # A brightness that rises evenly, and moves, changes all levels alike: a line of the usual ones.
    lines = [_robust_line(usual.ravel(), each.ravel()) for each in blocks]
    offsets, slopes, _ = np.array(lines).T[:, :, None, None]
    changes = blocks - offsets - slopes * usual
    ratio = np.where(seen, changes / np.where(seen, usual, 1.0), np.nan)
    lit = np.sum(seen, axis=1) >= _LEAST_OF_BANDS
    if np.sum(lit) < _LEAST_OF_BANDS:
        return 0.0
    rows = np.nanmedian(ratio[:, lit], axis=2)
    rows = rows - np.mean(rows, axis=1, keepdims=True)
    products = rows[:, 1:] * rows[:, :-1]
    value, error = float(np.mean(products)), float(np.std(products)) / np.sqrt(products.size)
    is_certain = value > max(_LEAST_BANDS**2, _CERTAIN_BANDS * error)
    return float(np.sqrt(value)) if is_certain else 0.0


def _without_bands(
    frames: Float[np.ndarray, "frames rows columns"],
) -> Float[np.ndarray, "frames rows columns"]:
    """Frames whose rows are divided by their light, the usual one 1, with black where it was."""
    blocks = means(frames, SIDE)
    usual = np.median(blocks, axis=0)
    # Each row of blocks is a line in the usual one, and the lines of all meet at black.
    every = [*np.ndindex(*blocks.shape[:2])]
    some = every[:: max(1, len(every) // _LINES_OF_BANDS)]
    lines = np.array([_robust_line(usual[row], blocks[frame, row]) for frame, row in some])
    offset, slope, error = lines.T
    weight = (1 - slope) / np.maximum(error, 1e-9) ** 2
    black = float(np.sum(weight * offset) / np.sum(weight * (1 - slope)))
    light = usual - black
    seen = light > max(float(np.quantile(light, 0.25)), 0.0)
    ratio = np.where(seen, (blocks - black) / np.where(seen, light, 1.0), np.nan)
    lit = np.any(seen, axis=1)
    centres = SIDE * (np.arange(len(lit)) + 0.5) - 0.5
    by_row = interpolate.CubicSpline(centres[lit], np.nanmedian(ratio[:, lit], axis=2), axis=1)
    gains = np.clip(by_row(np.arange(frames.shape[1])), _LEAST_LIGHT, 1 / _LEAST_LIGHT)
    return ((frames - black) / gains[:, :, None] + black).astype(np.float32)


def _of_one_exposure(frames: np.ndarray, step: float) -> Steady:
    """Frames whose exposure drifts, divided by it.

    Each frame is a line in the median of all, over blocks that stand still, of which those that are
    far from it do not count. Frames that do not drift are returned as they are.
    """
    each = means(frames, SIDE).reshape(len(frames), -1)
    usual = np.median(each, axis=0)
    # Half of the picture at rest holds the median, whatever moves over the rest.
    shifts = np.median(each - usual, axis=1) / max(abs(float(np.median(usual))), step, 1e-9)
    if np.ptp(usual) <= step or np.std(shifts) < _STEADY:
        return Steady.of(frames)
    lines = np.array([_robust_line(usual, y) for y in each])
    is_still = _stands_still(frames, lines)
    if is_still.mean() < _LEAST_STILL or np.ptp(usual[is_still]) <= step:
        return Steady.of(frames)
    lines = np.array([_robust_line(usual[is_still], y[is_still]) for y in each])
    offsets, gains, errors = lines.T
    gains = gains / np.median(gains)
    deviation = float(np.std(gains))
    if deviation < max(_STEADY, 3 * float(np.median(errors))):
        return Steady.of(frames)
    corrected = (frames - offsets[:, None, None]) / lines[:, 1, None, None]
    return Steady(frames, corrected.astype(np.float32), gains, deviation)


def _stands_still(frames: np.ndarray, lines: np.ndarray) -> Bool[np.ndarray, "blocks"]:
    """Whether the mean of a block changes from frame to frame by no more than noise."""
    same = (frames - lines[:, 0, None, None]) / lines[:, 1, None, None]
    changes, noises = [], []
    for difference in np.diff(same, axis=0):
        mean = means(difference, SIDE)
        changes.append(mean**2)
        noises.append((means(difference**2, SIDE) - mean**2) / (SIDE**2 - 1))
    return (np.mean(changes, axis=0) < _STILL * np.mean(noises, axis=0)).ravel()


def _robust_line(x: np.ndarray, y: np.ndarray) -> tuple[float, float, float]:
    """Offset, slope and the slope's error of the line from which most points deviate least."""
    kept = np.ones(x.size, bool)
    offset, slope, error = 0.0, 1.0, np.inf
    for _ in range(12):
        mean = x[kept].mean()
        spread = np.sum((x[kept] - mean) ** 2)
        if spread <= 0:
            break
        slope = float(np.sum((x[kept] - mean) * y[kept]) / spread)
        offset = float(y[kept].mean() - slope * mean)
        residual = y - offset - slope * x
        scale = 1.4826 * float(np.median(np.abs(residual)))
        error = scale / float(np.sqrt(spread))
        kept = np.abs(residual) <= 3 * max(scale, 1e-9)
    return offset, slope, error


def _size(moves: np.ndarray) -> float:
    """Root of the mean square of motions; px."""
    return float(np.sqrt(np.mean(np.sum(moves**2, axis=1))))


def _moved_back(frames: np.ndarray, moves: np.ndarray) -> Float[np.ndarray, "frames rows columns"]:
    """Frames less what their motions change in the picture that all of them show.

    To interpolate a frame would smooth its noise: the mean picture is moved, and the change of it
    taken off the frame.
    """
    mean = np.mean([_moved(*pair) for pair in zip(frames, -moves, strict=True)], axis=0)
    pairs = zip(frames, moves, strict=True)
    return np.stack([frame - (_moved(mean, move) - mean) for frame, move in pairs])


def _moved(picture: np.ndarray, move: np.ndarray) -> np.ndarray:
    return ndimage.shift(picture, move, order=3, mode="nearest", output=np.float32)


def moves_of(
    frames: np.ndarray,
) -> tuple[Float[np.ndarray, "frames 2"], float, tuple[float, float]]:
    """Motion of each frame against their mean, its error, and how much blur changes, with error."""
    smooth = ndimage.gaussian_filter(np.mean(frames, axis=0), 1.0)
    # A picture that is moved by s is less its slope times s, and one that is blurred more by a
    # Gaussian of variance c is more its curvature times c / 2.
    slopes = [-np.gradient(smooth, axis=axis) for axis in (0, 1)]
    # Some pixels of a large picture tell as much as all.
    jump = 1 + int(np.sqrt(smooth.size / MOST_PIXELS))
    some = slice(None, None, jump), slice(None, None, jump)
    columns = np.stack([x[some] for x in (*slopes, ndimage.laplace(smooth) / 2)], axis=-1)
    rows, cols = (np.arange(n) * _PARTS // n for n in columns.shape[:2])
    part = (rows[:, None] * _PARTS + cols).ravel()
    columns = columns.reshape(-1, 3).astype(np.float64)
    found, errors = [], []
    for frame in frames:
        change = (ndimage.gaussian_filter(frame, 1.0) - smooth)[some].ravel().astype(np.float64)
        value, inverse, kept = np.zeros(3), np.zeros((3, 3)), np.ones(change.size, bool)
        for _ in range(4):
            residual = change - columns @ value
            kept = np.abs(residual) <= 6 * max(float(np.median(np.abs(residual[kept]))), 1e-9)
            chosen = columns[kept]
            inverse = np.linalg.pinv(chosen.T @ chosen, hermitian=True)
            value = inverse @ (chosen.T @ change[kept])
        pulls = columns[kept] * (change[kept] - columns[kept] @ value)[:, None]
        sums = np.stack([np.bincount(part[kept], pull, _PARTS**2) for pull in pulls.T])
        found.append(value)
        errors.append(np.diag(inverse @ (sums @ sums.T) @ inverse))
    values, deviations = np.array(found), np.sqrt(np.median(errors, axis=0))
    blurs = float(np.ptp(values[:, 2])), float(deviations[2] * np.sqrt(2))
    return values[:, :2], float(np.hypot(*deviations[:2])), blurs
