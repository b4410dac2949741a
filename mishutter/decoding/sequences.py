r"""One picture from the frames of a sequence: its speed, and its restoration from all of them.

Frame $k$ is $g_k = M(A_k f) + \text{noise}$ of variance $N_k$: the picture $f$ through the response
$A_k$ of the frame, displacement included, as far as the sensor reaches, which is $M$. The picture
goes on beyond the sensor, and what lies there is as unknown as the rest. For rows of the power $S$
the likeliest picture is the minimum of

$$\sum_k |g_k - M A_k f|^2 / N_k + \sum |\hat f|^2/S ,$$

which conjugate gradients find for all rows at once. It says what each frame would have recorded
beyond its borders. With that the frames are complete, and as good as one capture of the response
$\sqrt{\sum_k |A_k|^2/N_k}$ with white noise, $\sum_k \bar A_k \hat g_k / N_k$ over that response.
Any decoder restores it, and the ensemble filter restores it to the likeliest picture.

The same minimum, and the volume of the Gaussian around it, is the likelihood of a speed. Gains and
black levels may change from frame to frame: the level of each row of a frame is then unknown, and
the gains are those of the detail at the likeliest speed.

Frames of a wrong model have a likeliest speed too, so that one is trusted only where the frames
fit: what the picture leaves of frame $k$ has the expected square
$1 - \frac{S|A_k|^2/N_k}{1 + S\sum_j |A_j|^2/N_j}$ at each frequency, over the noise, with the sums
over the frames that see the same part of the picture.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
import scipy.fft
from jaxtyping import ArrayLike, Complex, Float, Int

from mishutter._core.checks import (
    RowLike,
    as_float,
    require,
    require_known,
    shape_of,
)
from mishutter._core.parallel import alone_in_blas
from mishutter.camera.capture import as_pixels, distinct_colours, every_colour, kernel_layout
from mishutter.camera.rows import Planes, fast_length, rows_last
from mishutter.camera.sequences import (
    furthest,
    require_reach,
    require_speed,
    responses_of_frames,
)
from mishutter.decoding.decoders.base import (
    AbstractDecoder,
    BlurModel,
    CompleteFrames,
    blur_model,
    density_of,
)
from mishutter.decoding.decoders.linear import LEAST_POWER, decoder_or_ensemble, mean_over_dft
from mishutter.decoding.decoders.speed import BEYOND, LITTLE, SpeedEstimate, luminance_shares
from mishutter.decoding.frame_doubts import (
    BANDS,
    BLACK,
    DARK,
    FLICKER,
    FLOOR,
    LARGEST_SHIFT,
    LEAD,
    LEAST_DETAIL,
    REGISTERED,
    SHARED,
    TRIED_BEYOND,
    WORTH,
    Rival,
    doubt_of_fit,
    doubt_of_one_frame,
    doubt_of_rivals,
    equal_frames,
    odd_frame,
)
from mishutter.decoding.restoration import restored_light
from mishutter.evaluation.sequences import FrameNodes, nodes_of_frames
from mishutter.model.optics import frequencies
from mishutter.model.scene import Scene, require_scene, require_whole
from mishutter.model.sensor import noise_power, white_electrons
from mishutter.model.sequences import TimedFrame
from mishutter.model.shutters.windows import RectShutter
from mishutter.pictures.images import Axis, turned
from mishutter.plane.frames import PlaneFrames

if TYPE_CHECKING:
    from mishutter.decoding.plane_velocity import VelocityEstimate

_rfft: Callable[..., np.ndarray] = scipy.fft.rfft  # type: ignore[assignment]
_irfft: Callable[..., np.ndarray] = scipy.fft.irfft  # type: ignore[assignment]
_MARGIN = 64
"""Pixels beyond the furthest displacement in which the waves of the sensor's ends die away."""
_TOLERANCE, _TOLERANCE_OF_SPEED, _MOST_STEPS = 1e-3, 1e-2, 200
"""Residuals at which conjugate gradients end, as shares of the first one, and most steps. At the
first the level is within 0.01 dB of its limit; likelihoods of speeds differ less by the second than
by the picture's own statistics."""
_ROWS_OF_SPEED, _ROWS_OF_SEARCH = 32, 4
"""Rows that tell a picture's speed, and those of most detail, one a band, in which it is sought."""
_PX_A_STEP = 0.7
"""Displacement over the sequence between neighbouring speeds that are tried."""
_MOST_SPEEDS, _MOST_RESPONSES = 4096, 3000
"""Most speeds that are tried, and the speeds times frames above which fewer frames tell where to
look."""
_AT_ONCE = 2**16
"""Pixels of canvas for which likelihoods are computed together."""
_CANDIDATES = 4
"""Peaks of the likelihood of some rows that all rows judge."""
_FEW_SPEEDS = 17
"""Speeds at whose mean a picture's power is estimated."""
_ELSEWHERE = (-8.0, 5.0)
"""Displacements from frame to frame by which these are off; px."""
_REASONS = (
    "their order, a lost or repeated frame, another design, two objects, motion across the axis, a "
    "speed beyond the scene's"
)
_MOST_MOVES = 8
"""Times that a peak is looked for within a step."""
_REACH = 3.0
"""Steps about the speed that is found within which no other is a rival."""


class RestoredFrames(NamedTuple):
    """A picture that was restored from the frames of a sequence.

    Attributes:
        light: Light of the picture where the sensor is at the middle of the sequence, white = 1;
            the shape of a frame.
        estimate: The speed that was found, and its doubt; None where it was given.
    """

    light: Planes
    estimate: "SpeedEstimate | VelocityEstimate | None"


class _Stack(NamedTuple):
    """Rows of the frames of one sequence, about their mean, and what is known of them."""

    # Deviations of the frames from the level of each row; shape `(rows, frames, columns)`
    rows: Float[np.ndarray, "rows frames columns"]
    nodes: list[FrameNodes]  # Instants of each frame
    noises: Float[np.ndarray, "frames"]  # Variance of the noise in each frame, $N_k$
    model: BlurModel  # The picture's statistics and the lens
    has_levels: bool = True  # Whether the mean of each row in each frame is that of the picture

    def of(self, some: Int[np.ndarray, "f"]) -> "_Stack":
        """The same of some of the frames."""
        nodes, noises = [self.nodes[k] for k in some], self.noises[some]
        return self._replace(rows=self.rows[:, some], nodes=nodes, noises=noises)

    def without_levels(
        self, rows: Float[np.ndarray, "*s rows frames columns"]
    ) -> Float[np.ndarray, "*s rows frames columns"]:
        r"""Rows of frames, less their levels where nothing is known of these.

        An unknown level adds $\sigma^2 1 1^\top$ to the covariance $N_k I$ of the noise; the
        inverse of the sum is $(I - 1 1^\top/n)/N_k$ as $\sigma$ grows without bound.
        """
        return rows if self.has_levels else rows - np.mean(rows, axis=-1, keepdims=True)

    def canvas(self, speeds: RowLike) -> tuple[int, int]:
        """Pixels beyond either end of the sensor, and of the whole period, at some speeds."""
        margin = math.ceil(furthest(self.nodes, speeds)) + _MARGIN
        return margin, fast_length(self.rows.shape[-1] + 2 * margin)


class _Likeliest(NamedTuple):
    """The likeliest pictures at some speeds."""

    speeds: Float[np.ndarray, "s"]  # The speeds; px/s
    spectrum: Complex[np.ndarray, "s rows k"]  # Their DFTs over the canvas; shape `(s, rows, k)`
    # Responses of the frames on that grid; shape `(s, frames, k)`
    responses: Complex[np.ndarray, "s frames k"]
    # How much better than no picture each explains each row of the frames, as a logarithm of
    # likelihood; shape `(s, rows)`
    gains: Float[np.ndarray, "s rows"]
    margin: int  # Pixels of the canvas before the sensor
    length: int  # Pixels of the canvas

    def seen(
        self, responses: Complex[np.ndarray, "s frames k"], columns: int
    ) -> Float[np.ndarray, "s rows frames columns"]:
        """Rows of the pictures through some responses, as far as the sensor reaches."""
        rows = _irfft(self.spectrum[:, :, None] * responses[:, None], self.length)
        return rows[..., self.margin : self.margin + columns]


@alone_in_blas()
def restore_frames(
    captures: ArrayLike | Sequence[ArrayLike],
    scene: Scene,
    frames: Sequence[TimedFrame] | PlaneFrames,
    *,
    decoder: AbstractDecoder | None = None,
    speed: float | RowLike | None = None,
) -> RestoredFrames:
    """Restore the picture that the frames of a sequence show, each point from those that see it.

    Args:
        captures: Light of each frame in units of its exposure of white, as `simulate_frames` gives
            it; shape `(frames, rows, columns)`, or channels last; concrete.
        scene: Speeds that may occur, light, noise, and spectrum of pictures.
        frames: The frames, with open shutters; or frames in the plane.
        decoder: The method; the ensemble filter by default, which is then the best linear one. In
            the plane total variation and a denoiser of your own are others.
        speed: The speed of the picture, px/s; by default it is found in the frames, and trusted
            where they fit one picture at that speed, and at no other as well. For frames in the
            plane its velocity along rows and columns, of which the estimate is a
            `VelocityEstimate`.

    Raises:
        ValueError: if the scene has a background, no light, or more speeds than frames can tell
            apart; the captures are traced, not finite, or not of so many frames; or `speed` is not
            a finite scalar, or displaces light by more than 8,192 px.

    Examples:
        >>> import jax
        >>> from mishutter import Scene, StillCamera, TimedFrame, example_picture
        >>> from mishutter import restore_frames, simulate_frames
        >>> scene = Scene.uniform(max_speed=1500.0, photon_rate=1e5, read_noise=8)
        >>> still = StillCamera(half_exposure=1e-3)
        >>> frames = [TimedFrame(still, time) for time in (-0.02, 0.0, 0.02)]
        >>> picture = example_picture().light[200:232]
        >>> key = jax.random.key(0)
        >>> captures = simulate_frames(picture, scene, frames, speed=700.0, key=key)
        >>> found = restore_frames(captures, scene, frames)
        >>> print(f"{found.estimate.speed:.1e} px/s, {found.estimate.trusted}")
        7.0e+02 px/s, True
    """
    in_plane = isinstance(frames, PlaneFrames)
    require_scene(scene, in_plane=in_plane)
    require_whole(scene, "restore_frames")
    require_known("restore_frames", captures=captures, speed=speed)
    if speed is not None:
        speed = require_speed("restore_frames(speed=...)", speed, frames)
    chosen = decoder_or_ensemble(decoder, "restore_frames")
    if isinstance(frames, PlaneFrames):
        # It takes frames apart as this module does.
        from mishutter.decoding.plane_frames import restored_in_plane

        return restored_in_plane(captures, scene, frames, chosen, speed)
    light, planes = _planes_of(captures, scene, frames)
    taken = _Taken.of(scene, frames)
    estimate = None
    if speed is None:
        estimate = _judged(planes, scene, taken)
        speed = estimate.speed
    nodes = require_reach("restore_frames(speed=...)", frames, float(speed))
    stack, level = _stacked(planes, taken, nodes)
    found = _likeliest(stack, [float(speed)])
    equal = _complete(stack, found).reshape(*level.shape, found.length) + level[..., None]
    capture = as_float(np.moveaxis(equal, 0, -1))
    restored = np.asarray(restored_light(capture, chosen, taken.as_one(float(speed))))
    restored = restored[:, found.margin : found.margin + planes.shape[-1]]
    has_colours = light.ndim == 4
    result = every_colour(restored, light[0]) if has_colours else restored[..., 0]
    return RestoredFrames(as_float(turned(result, scene.sensor.axis)), estimate)


@alone_in_blas()
def speed_of_frames(
    captures: ArrayLike | Sequence[ArrayLike], scene: Scene, frames: Sequence[TimedFrame]
) -> SpeedEstimate:
    """The speed that `restore_frames` finds, without the picture."""
    return _judged(_planes_of(captures, scene, frames)[1], scene, _Taken.of(scene, frames))


def _planes_of(
    captures: ArrayLike | Sequence[ArrayLike], scene: Scene, frames: Sequence[TimedFrame]
) -> tuple[Planes, Float[np.ndarray, "colours rows frames columns"]]:
    """Frames as arrays, turned so that things move along their rows, and their distinct colours."""
    original, planes = planes_of(captures, len(frames), scene.sensor.axis)
    return original, np.moveaxis(np.asarray(planes, np.float64), 0, -2)


def planes_of(
    captures: ArrayLike | Sequence[ArrayLike], num_frames: int, axis: Axis
) -> tuple[Planes, Float[np.ndarray, "frames colours rows columns"]]:
    """Frames as arrays, turned so that things move along their rows, and their distinct colours."""
    subject, stack = "restore_frames(captures=...)", cast(Any, captures)
    if isinstance(captures, list | tuple):
        shapes = [np.shape(one) for one in captures]
        require(len(set(shapes)) <= 1, subject, "be frames of one size and as many colours", shapes)
        stack = np.stack([np.asarray(one) for one in captures]) if captures else np.zeros(0)
    light = as_pixels(stack, subject)
    is_stack = light.ndim in (3, 4) and light.shape[0] == num_frames > 0
    requirement = f"be {num_frames} frames, of rows and columns"
    require(is_stack, subject, requirement, shape_of(light))
    light = turned(light[..., None] if light.ndim == 3 else light, axis)
    planes = np.asarray(rows_last(distinct_colours(light)))
    return light if np.ndim(stack) == 4 else light[..., 0], planes


@dataclass(frozen=True)
class _Taken:
    """Frames, and the knowledge of them before any is seen."""

    frames: Sequence[TimedFrame]  # The frames
    model: BlurModel  # The picture's statistics and the lens
    electrons: Float[np.ndarray, "frames"]  # Electrons of a white pixel in each
    noises: Float[np.ndarray, "frames"]  # Variance of the noise in each, $N_k$; white = 1

    @staticmethod
    def of(scene: Scene, frames: Sequence[TimedFrame]) -> "_Taken":
        """The frames of a scene.

        Raises:
            ValueError: if it has no light.
        """
        p = np.array([float(white_electrons(scene.photon_rate, one.exposure)) for one in frames])
        has_light, requirement = float(np.min(p)) > 0, "have a photon rate above 0 e-/s"
        require(has_light, "restore_frames(scene=...)", requirement, 0.0)
        model = blur_model(scene, frames[0].motion, RectShutter())
        return _Taken(frames, model, p, _noises_at(model.mean_level, p, model))

    def like(
        self,
        rows: Float[np.ndarray, "rows frames columns"],
        slowest: float,  # px/s
        fastest: float,
        noise_share: float,
    ) -> "_Taken":
        r"""The same of pictures as bright, and as rich in detail, as that of some rows of frames.

        A picture of less detail than expected, or of finer, would else seem to move at a speed that
        explains it. In each band of frequencies its power is that of the frames beyond their noise
        over $\sum_k |A_k|^2$, of which the speeds that are tried have the mean.
        """
        model, columns = self.model, rows.shape[-1]
        level = max(float(np.mean(rows)), 0.0)
        noises = np.maximum(noise_share * _noises_at(level, self.electrons, model), DARK)
        length = fast_length(columns)
        about = rows - np.mean(rows, axis=(-2, -1), keepdims=True)
        recorded = np.mean(np.abs(_spectra_of_windows(about, length)) ** 2, axis=0)
        few = np.linspace(slowest, fastest, _FEW_SPEEDS)
        responses = responses_of_frames(
            nodes_of_frames(self.frames, float(np.max(np.abs(few)))), few, model.optics, length
        )
        detail = np.sum(recorded / noises[:, None] - 1, axis=0)
        expected = np.mean(density_of(responses, noises), axis=0) * model.picture_spectrum(length)
        place = np.fft.rfftfreq(length)
        ends = np.geomspace(2 / columns, 0.5, BANDS + 1)
        bands = [(place >= low) & (place <= high) for low, high in itertools.pairwise(ends)]
        sums = [(float(np.sum(detail[x])), float(np.sum(expected[x]))) for x in bands]
        scales = [max(x / y, LEAST_DETAIL) if y > 0 else 1.0 for x, y in sums]
        middles = np.sqrt(ends[:-1] * ends[1:])
        each = np.interp(np.log(frequencies(model.power.size)), np.log(middles), np.log(scales))
        model = replace(model, power=np.exp(each) * model.power)
        return replace(self, model=model, noises=noises)

    def as_one(self, speed: float) -> BlurModel:
        """The blur and noise of the one capture that the complete frames are as good as."""
        noise = 1 / float(np.sum(1 / self.noises))
        electrons = float(np.sum(self.electrons))
        read_variance = max(noise - self.model.mean_level / electrons, 0.0)
        layouts = (kernel_layout(one.motion, speed)[0] for one in self.frames)
        return replace(
            self.model,
            speeds=np.array([speed]),
            weights=np.ones(1),
            num_taps=max(layouts),
            efficiency=1.0,
            electrons=electrons,
            read_noise=electrons * math.sqrt(read_variance),
            complete=CompleteFrames(tuple(self.frames), speed, tuple(self.noises.tolist())),
        )


def _noises_at(
    level: float, electrons: Float[np.ndarray, "frames"], model: BlurModel
) -> Float[np.ndarray, "frames"]:
    """Variance of the noise in each frame of a picture of some mean level; white = 1."""
    noises = noise_power(1.0, level, electrons, model.read_noise, unit=electrons)
    return np.maximum(noises, DARK)


def _spectra_of_windows(
    rows: Float[np.ndarray, "rows frames columns"], length: int
) -> Complex[np.ndarray, "rows frames k"]:
    """Spectra of rows that fade at their ends, as large as those of rows that do not."""
    columns = rows.shape[-1]
    fading = np.hanning(columns + 2)[1:-1]
    return np.fft.rfft(rows * fading / math.sqrt(float(np.mean(fading**2)) * columns), length)


def _stacked(
    planes: Float[np.ndarray, "*planes frames columns"], taken: _Taken, nodes: list[FrameNodes]
) -> tuple[_Stack, Float[np.ndarray, "*planes"]]:
    """Deviations of the rows of frames from the level of each row, and that level."""
    level = np.mean(planes, axis=(-2, -1))
    rows = (planes - level[..., None, None]).reshape(-1, *planes.shape[-2:])
    return _Stack(rows, nodes, taken.noises, taken.model), level


def _likeliest(
    stack: _Stack, speeds: RowLike, tolerance: float = _TOLERANCE, most_steps: int = _MOST_STEPS
) -> _Likeliest:
    """The likeliest pictures at some speeds, by conjugate gradients on all rows at once."""
    columns = stack.rows.shape[-1]
    margin, length = stack.canvas(speeds)
    responses = responses_of_frames(stack.nodes, speeds, stack.model.optics, length)
    power = np.maximum(stack.model.picture_spectrum(length), LEAST_POWER)
    density = density_of(responses, stack.noises)
    # The sensor sees a share of the canvas; elsewhere the prior alone holds the picture.
    inverse = (1 / (columns / length * density + 1 / power))[:, None]
    shares = responses.conj() / stack.noises[:, None]
    window = slice(margin, margin + columns)

    def gathered(rows: np.ndarray) -> np.ndarray:
        """Spectra of the pictures that frames on the sensor would be made of."""
        whole = np.zeros((*rows.shape[:-1], length))
        whole[..., window] = stack.without_levels(rows)
        return np.einsum("skf,srkf->srf", shares, _rfft(whole))

    def recorded(pictures: np.ndarray) -> np.ndarray:
        """Rows that the frames record of the spectra of pictures."""
        return _irfft(pictures[:, :, None] * responses[:, None], length)[..., window]

    target = gathered(stack.rows[None])
    picture = np.zeros_like(target)
    residual, step = target, target * inverse
    size = _product(residual, step, length)
    least = tolerance**2 * size
    for _ in range(most_steps):
        active = size > least
        if not np.any(active):
            break
        image = gathered(recorded(step)) + step / power
        stride = np.where(active, size / np.maximum(_product(step, image, length), 1e-300), 0.0)
        picture = picture + stride[..., None] * step
        residual = residual - stride[..., None] * image
        turned_residual = residual * inverse
        following = _product(residual, turned_residual, length)
        step = turned_residual + (following / np.maximum(size, 1e-300))[..., None] * step
        size = following
    gains = _product(target, picture, length) / 2
    return _Likeliest(np.asarray(speeds, np.float64), picture, responses, gains, margin, length)


def _product(
    first: Complex[np.ndarray, "s rows k"], second: Complex[np.ndarray, "s rows k"], length: int
) -> Float[np.ndarray, "s rows"]:
    """Inner products of rows, from half of their spectra."""
    return mean_over_dft(np.real(first.conj() * second), length)


def _complete(stack: _Stack, found: _Likeliest) -> Float[np.ndarray, "rows length"]:
    r"""The one capture that the frames are as good as, once each goes on beyond its borders."""
    columns, begin = stack.rows.shape[-1], found.margin
    responses, picture = found.responses[0], found.spectrum[0]
    density = density_of(responses, stack.noises)
    spectrum = np.zeros_like(picture)
    for frame, (response, noise) in enumerate(zip(responses, stack.noises, strict=True)):
        rows = _irfft(picture * response, found.length)
        rows[:, begin : begin + columns] = stack.rows[:, frame]
        spectrum += response.conj() / noise * _rfft(rows)
    equal = spectrum / np.sqrt(np.maximum(density, LEAST_POWER) * density[0])
    return _irfft(equal, found.length)


class _Search(NamedTuple):
    """Speeds at which the likelihood of some rows is high, of all speeds that are tried."""

    low: float  # Least speed that is tried; px/s
    high: float  # Greatest one
    step: float  # Step between speeds for all frames; px/s
    peaks: list[float]  # Speeds at which it is highest nearby, the highest first; px/s
    middle: float  # Median of the likelihood's logarithm over all speeds, below its top


class _Peak(NamedTuple):
    """A speed at which the likelihood is highest nearby, its logarithm there, and its error."""

    speed: float
    value: float
    width: float


class _Fit(NamedTuple):
    """How the frames fit the likeliest picture at a speed."""

    # Mean square of what the picture leaves of the frames, over their noise, with the picture's own
    # freedom counted, and without gains that change
    misfit: float
    misfits: Float[np.ndarray, "frames"]  # The same of each frame
    gains: Float[np.ndarray, "frames"]  # Gain of each frame over their mean
    values: Float[np.ndarray, "rows"]  # Logarithm of the likelihood of each row
    shifts: Float[np.ndarray, "frames"]  # Displacement of each frame from its place; px
    shift_errors: Float[np.ndarray, "frames"]  # Standard errors of these; px


class _Found(NamedTuple):
    """The speed that was found, and what speaks for and against it."""

    rows: Float[np.ndarray, "rows frames columns"]  # Rows of the frames
    stack: _Stack  # The same about their mean, each over its gain
    search: _Search  # The speeds that were tried
    ends: list[_Peak]  # Peaks of the likelihood, the highest first
    best: _Peak  # The speed
    fit: _Fit  # How the frames fit there
    elsewhere: float  # Misfit of frames that are registered some pixels off
    # The other peaks, which are no part of the highest, and how the frames fit there
    rivals: list[tuple[_Peak, _Fit]]


def _judged(
    planes: Float[np.ndarray, "colours rows frames columns"], scene: Scene, taken: _Taken
) -> SpeedEstimate:
    """The speed at which the frames show one picture, and whether they do."""
    estimate = _speed_of(planes, scene, taken)
    if estimate.trusted or min(planes.shape[1], planes.shape[-1]) <= _ROWS_OF_SPEED:
        return estimate
    # The frames may be turned, or their motion be along the other axis.
    across = _speed_of(np.swapaxes(planes, 1, 3), scene, taken)
    if not across.trusted:
        return estimate
    axis = "rows" if scene.sensor.axis == "columns" else "columns"
    return estimate._replace(
        doubt=f"The frames fit a picture that moves along its {axis}, at {across.speed:,.0f} px/s."
    )


def _speed_of(
    planes: Float[np.ndarray, "colours rows frames columns"], scene: Scene, taken: _Taken
) -> SpeedEstimate:
    """The same, of pictures that move along their rows."""
    shares = luminance_shares(len(planes))
    grey = np.tensordot(shares, planes, 1)
    some = np.unique(np.linspace(0, len(grey) - 1, min(_ROWS_OF_SPEED, len(grey))).astype(int))
    grey, (low, high) = grey[some], _range_to_try(scene)
    taken = taken.like(grey, low, high, float(shares @ shares))
    nodes = nodes_of_frames(taken.frames, max(abs(low), abs(high)))
    # Gains and black levels that change from frame to frame tell no speed.
    stack = _stacked(grey, taken, nodes)[0]._replace(has_levels=False)
    search = _searched(stack, taken.frames, low, high)
    values = np.sum(_logarithms(stack, np.array(search.peaks)), axis=1)
    ends = [_Peak(*each, 0.0) for each in zip(search.peaks, values.tolist(), strict=True)]
    ends.sort(key=lambda end: -end.value)
    stack = stack._replace(rows=stack.rows / _fit(stack, ends[0].speed).gains[:, None])
    best = _highest(stack, ends[0].speed, search, 0.01)
    fit, duration = _fit(stack, best.speed), _duration(taken.frames)
    a_frame = duration / max(len(taken.frames) - 1, 1)
    others = [_fit(stack, best.speed + px / a_frame).misfit for px in _ELSEWHERE]
    beside = [end for end in ends if abs(end.speed - best.speed) > _REACH * search.step]
    rivals = [(end, _fit(stack, end.speed)) for end in beside]
    spread = max(1.0, fit.misfit)
    error = math.hypot(math.sqrt(spread) * best.width, FLOOR / duration)
    error = min(error, (high - low) / math.sqrt(12))
    found = _Found(grey, stack, search, ends, best, fit, float(np.mean(others)), rivals)
    doubt = _doubt(found, error * duration)
    known = sorted([best, *beside], key=lambda end: end.speed)
    values = np.array([end.value for end in known])
    weights = np.exp(WORTH / spread * (values - np.max(values)))
    return SpeedEstimate(
        best.speed,
        error,
        doubt == "",
        np.array([end.speed for end in known]),
        weights / np.sum(weights),
        doubt,
        misfit=fit.misfit if len(taken.frames) > 1 else None,
    )


def _doubt(found: "_Found", error: float) -> str:
    """Why a speed is not trusted, in a sentence; empty if it is."""
    best, fit, search, spread = found.best, found.fit, found.search, max(1.0, found.fit.misfit)
    odd = odd_frame(found.rows, found.stack.noises)
    if odd:
        return odd
    middles = [float(np.mean(some.place - best.speed * some.time)) for some in found.stack.nodes]
    same = equal_frames(found.rows, middles)
    columns = found.rows.shape[-1]
    furthest_apart = float(np.max(np.abs(np.diff(middles)), initial=0.0))
    moves = (
        f"The picture moves by {furthest_apart:.0f} px from frame to frame, of which the "
        f"sensor sees {columns}."
    )
    elsewhere, shifts, errors = found.elsewhere, fit.shifts[:, None], fit.shift_errors[:, None]
    return (
        doubt_of_fit(fit.misfit, elsewhere, same, "speed", _REASONS)
        or doubt_of_one_frame(shifts, errors, fit.misfits, spread, elsewhere, reasons=_REASONS)
        or (moves if furthest_apart > (1 - SHARED) * columns else "")
        or (_doubt_of_rivals(found, error, spread) if search.low < search.high else "")
    )


def _doubt_of_rivals(found: _Found, error: float, spread: float) -> str:
    """The doubt of a speed that others equal, or that is none of those of the scene."""
    best, fit, search, top = found.best, found.fit, found.search, found.ends[0].value
    if not search.low + 0.1 * search.step < best.speed < search.high - 0.1 * search.step:
        return BEYOND
    if top < LEAD * spread or not error < REGISTERED or len(found.stack.nodes) == 1:
        return LITTLE
    rivals = [
        Rival(f"{end.speed:,.0f}", top - end.value, rival.misfit, rival.values - fit.values)
        for end, rival in found.rivals
    ]
    tells_little = search.middle < LEAD * spread
    parts = "of the rows fit better"
    return doubt_of_rivals(rivals, fit.misfit, found.elsewhere, spread, parts, little=tells_little)


def _range_to_try(scene: Scene) -> tuple[float, float]:
    """Least and greatest speed that are tried; px/s."""
    slowest, fastest = (float(speed) for speed in scene.speed_range)
    is_one = slowest == fastest
    beyond = 0.0 if is_one else TRIED_BEYOND * max(fastest - slowest, abs(fastest), abs(slowest))
    return slowest - beyond, fastest + beyond


def _duration(frames: Sequence[TimedFrame]) -> float:
    """Time from the first mid-exposure to the last, or that of one frame; s."""
    times = [frame.time for frame in frames]
    return max(max(times) - min(times), max(frame.exposure for frame in frames))


def _searched(stack: _Stack, frames: Sequence[TimedFrame], low: float, high: float) -> _Search:
    """The likelihood of some rows, at speeds between which the picture moves by less than a pixel.

    Of many frames those in the middle tell where to look with all of them.
    """
    order = np.argsort([frame.time for frame in frames])
    size = len(frames)
    while True:
        start = (len(frames) - size) // 2
        few = order[start : start + size]
        coarse = _PX_A_STEP / _duration([frames[k] for k in few])
        count = 2 + int((high - low) / coarse)
        if size <= 2 or size * count <= _MOST_RESPONSES:
            break
        size -= 1
    step, most = _PX_A_STEP / _duration(frames), coarse * (_MOST_SPEEDS - 2)
    requirement = (
        f"have speeds within {most:,.0f} px/s of each other, so that frames tell them apart"
    )
    require(count <= _MOST_SPEEDS, "restore_frames(scene=...)", requirement, high - low)
    detail = np.sum(np.diff(stack.rows, axis=-1) ** 2, axis=(1, 2))
    bands = np.array_split(np.arange(detail.size), min(_ROWS_OF_SEARCH, detail.size))
    some = [band[np.argmax(detail[band])] for band in bands]
    all_frames = stack._replace(rows=stack.rows[some])
    speeds = np.linspace(low, high, count) if low < high else np.array([low])
    of_rows = _logarithms(all_frames.of(few), speeds)
    values = np.sum(of_rows, axis=1)
    beside = np.concatenate([[-np.inf], values, [-np.inf]])
    places = np.flatnonzero((values >= beside[:-2]) & (values > beside[2:]))
    places = places[np.argsort(-values[places])][:_CANDIDATES].tolist()
    # Rows of a second object may be too dim to show among all.
    for place in np.argmax(of_rows, axis=0).tolist():
        if min(abs(place - other) for other in places) > _REACH:
            places.append(place)
    peaks, middle = speeds[places], float(np.max(values) - np.median(values))
    if size < len(frames):
        fine = step * np.arange(-math.ceil(coarse / step), math.ceil(coarse / step) + 1)
        near = np.clip(peaks[:, None] + fine, low, high)
        tops = [np.argmax(np.sum(_logarithms(all_frames, some), axis=1)) for some in near]
        peaks = near[np.arange(len(near)), tops]
    search = _Search(low, high, step, [], middle)
    tops = [_highest(all_frames, speed, search).speed for speed in peaks.tolist()]
    return search._replace(peaks=tops)


def _highest(stack: _Stack, speed: float, search: _Search, steps: float = 0.1) -> _Peak:
    """The peak of the likelihood near a speed, within those that are tried, to so many steps."""
    from scipy.optimize import minimize_scalar

    tolerance = _TOLERANCE_OF_SPEED * steps / 0.1

    def loss(value: float) -> float:
        return -float(np.sum(_logarithms(stack, np.array([value]), tolerance)))

    if search.low == search.high:
        return _Peak(speed, -loss(speed), 0.0)
    peak, least = speed, math.inf
    for _ in range(_MOST_MOVES):
        low, high = max(search.low, peak - search.step), min(search.high, peak + search.step)
        options = {"xatol": steps * search.step}
        end: Any = minimize_scalar(loss, bounds=(low, high), method="bounded", options=options)
        peak, least = float(end.x), float(end.fun)
        beyond_low = low > search.low and peak < low + 0.1 * search.step
        if not beyond_low and not (high < search.high and peak > high - 0.1 * search.step):
            break
    side = 0.2 * search.step
    near = _logarithms(stack, peak + side * np.array([-1.0, 0.0, 1.0]), tolerance)
    curvature = max(-float(np.sum(np.diff(near, 2, axis=0))) / side**2, 1e-300)
    # Rows of photographs pull to either side by more than Gaussian ones of their spectrum would.
    scores = (near[2] - near[0]) / (2 * side)
    disagreement = scores.size * float(np.var(scores))
    width = math.sqrt(max(curvature, disagreement)) / curvature
    return _Peak(peak, -least, min((search.high - search.low) / math.sqrt(12), width))


def _fit(stack: _Stack, speed: float) -> _Fit:
    """How the frames fit the likeliest picture at a speed."""
    found = _likeliest(stack, [speed])
    columns, num_frames = stack.rows.shape[-1], stack.rows.shape[1]
    turns = -2j * np.pi * np.fft.rfftfreq(found.length)
    seen = stack.without_levels(found.seen(found.responses, columns)[0])
    slopes = stack.without_levels(found.seen(found.responses * turns, columns)[0])
    residual = stack.without_levels(stack.rows) - seen
    changes, (shifts, errors) = np.zeros(num_frames), np.zeros((2, num_frames))
    for k, noise in enumerate(stack.noises if num_frames > 1 else []):
        design = np.stack([seen[:, k].ravel(), slopes[:, k].ravel()], axis=1)
        expected = np.array([FLICKER, LARGEST_SHIFT])
        inverse = np.linalg.inv(design.T @ design / noise + np.diag(expected**-2.0))
        changes[k], shifts[k] = inverse @ (design.T @ residual[:, k].ravel()) / noise
        errors[k] = math.sqrt(inverse[1, 1])
    squares = np.sum((residual - changes[:, None] * seen) ** 2, axis=(0, 2)) / stack.noises
    volume = _volumes(stack, found)[0]
    # Each row has a level of its own in each frame, and each frame a gain.
    freedoms = volume.freedoms - len(residual) - 1
    misfit = float(np.sum(squares) / max(np.sum(freedoms), 1.0))
    misfits = squares / np.maximum(freedoms, 1.0)
    values = found.gains[0] - volume.logarithm / len(residual)
    # What all gains share is a picture that its prior holds back.
    gains = np.maximum(1 + changes, BLACK)
    # The picture follows a frame that is off by about one part in as many as there are.
    follows = num_frames / max(num_frames - 1, 1)
    return _Fit(misfit, misfits, gains / np.mean(gains), values, follows * shifts, follows * errors)


def _logarithms(
    stack: _Stack, speeds: Float[np.ndarray, "s"], tolerance: float = _TOLERANCE_OF_SPEED
) -> Float[np.ndarray, "s rows"]:
    """Logarithms of the likelihood of each row of the frames, over that of no picture."""
    rows, frames, columns = stack.rows.shape
    at_once = max(1, _AT_ONCE // (rows * frames * fast_length(columns)))
    values = []
    for begin in range(0, speeds.size, at_once):
        found = _likeliest(stack, speeds[begin : begin + at_once], tolerance)
        volumes = np.array([one.logarithm for one in _volumes(stack, found)])
        values.append(found.gains - volumes[:, None] / rows)
    return np.concatenate(values)


class _Volume(NamedTuple):
    """Half the logarithm of the determinant of the frames' covariance, over that of their noise.

    And how many numbers of each frame the likeliest picture leaves to the noise.
    """

    logarithm: float
    freedoms: Float[np.ndarray, "frames"]


def _volumes(stack: _Stack, found: _Likeliest) -> list[_Volume]:
    """Those of rows without ends, in each part of the picture for as many frames as see it."""
    rows, _, columns = stack.rows.shape
    power = stack.model.picture_spectrum(found.length)
    volumes = []
    for speed, responses in zip(found.speeds, found.responses, strict=True):
        density = np.abs(responses) ** 2 * power / stack.noises[:, None]
        middles = [float(np.mean(some.place - speed * some.time)) for some in stack.nodes]
        ends = np.unique(np.concatenate([middles, np.array(middles) + columns]))
        logarithm, freedoms = 0.0, np.zeros(len(middles))
        for begin, end in itertools.pairwise(ends):
            sees = np.array([m <= (begin + end) / 2 <= m + columns for m in middles])
            each = np.sum(density[sees], axis=0)
            logarithm += (end - begin) * float(mean_over_dft(np.log1p(each), found.length)) / 2
            held = mean_over_dft(density[sees] / (1 + each), found.length)
            freedoms[sees] += (end - begin) * (1 - held)
        volumes.append(_Volume(rows * logarithm, rows * freedoms))
    return volumes
