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

The same minimum, and the volume of the Gaussian around it, is the likelihood of a speed.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import ArrayLike, Complex, Float

from mishutter._core import (
    RowLike,
    alone_in_blas,
    as_float,
    require,
    require_finite,
    require_scalar,
    shape_of,
)
from mishutter.camera import (
    Planes,
    as_pixels,
    distinct_colours,
    every_colour,
    fast_length,
    furthest,
    kernel_layout,
    responses_of_frames,
    rows_last,
)
from mishutter.decoding.decoders import (
    AbstractDecoder,
    BlurModel,
    SpeedEstimate,
    blur_model,
)
from mishutter.decoding.decoders.base import CompleteFrames, density_of
from mishutter.decoding.decoders.linear import LEAST_POWER, decoder_or_ensemble, mean_over_dft
from mishutter.decoding.decoders.speed import BEYOND, LITTLE, luminance_shares
from mishutter.decoding.restoration import restored_light
from mishutter.evaluation import FrameNodes, nodes_of_frames
from mishutter.model import (
    RectShutter,
    Scene,
    TimedFrame,
    frequencies,
    noise_power,
    require_scene,
    require_whole,
    white_electrons,
)
from mishutter.pictures import turned

_MARGIN = 64
"""Pixels beyond the furthest displacement in which the waves of the sensor's ends die away."""
_TOLERANCE, _TOLERANCE_OF_SPEED, _MOST_STEPS = 1e-3, 1e-2, 200
"""Residuals at which conjugate gradients end, as shares of the first one, and most steps. At the
first the level is within 0.01 dB of its limit; likelihoods of speeds differ less by the second than
by the picture's own statistics."""
ROWS_OF_SPEED = 32
"""Rows of a picture from which its speed is found."""
_PX_A_STEP = 0.7
"""Displacement over the sequence between neighbouring speeds that are tried."""
_BEYOND = 0.03
"""Share of the range of the scene's speeds that is tried beyond either end."""
_CANDIDATES = 3
"""Peaks of the first likelihood that the second one judges."""
_SURE = 12.0
"""Logarithm of the likelihood by which the speed that is found must lead, to be trusted."""
_DARK = 1e-12
"""Least variance of the noise, for pictures without light or noise; white = 1."""
_REGISTERED = 1.0
"""Error of a picture's way over the sequence above which no speed is trusted; px."""
_WORTH = 0.1
"""Share of the likelihood that counts: photographs are no Gaussian rows, and alike from row to row.
"""
_LEAST_DETAIL = 1e-4
"""Least detail of a picture, over that which the scene expects."""
_BANDS, _FEW_SPEEDS = 6, 17
"""Bands of frequencies in which a picture's power is estimated, at the mean of so many speeds."""
_REACH = 3.0
"""Steps about a peak of the first likelihood in which that of the second is looked for."""
_SPREAD = 9
"""Speeds, all over those that are tried, which the one that is found must lead too."""
_MOST_MOVES = 6
"""Times that it is looked for beyond the end of these steps, each time twice as far."""
_SPEEDS_AT_ONCE = 64


class RestoredFrames(NamedTuple):
    """A picture that was restored from the frames of a sequence.

    Attributes:
        light: Light of the picture where the sensor is at the middle of the sequence, white = 1;
            the shape of a frame.
        estimate: The speed that was found, and its doubt; None where it was told.
    """

    light: Planes
    estimate: SpeedEstimate | None


class _Stack(NamedTuple):
    """Rows of the frames of one sequence, about their mean, and what is known of them.

    Attributes:
        rows: Deviations of the frames from the level of each row; shape `(rows, frames, columns)`.
        nodes: Instants of each frame.
        noises: Variance of the noise in each frame, $N_k$.
        model: The picture's statistics and the lens.
    """

    rows: Float[np.ndarray, "rows frames columns"]
    nodes: list[FrameNodes]
    noises: Float[np.ndarray, "frames"]
    model: BlurModel

    def canvas(self, speeds: RowLike) -> tuple[int, int]:
        """Pixels beyond either end of the sensor, and of the whole period, at some speeds."""
        margin = math.ceil(furthest(self.nodes, speeds)) + _MARGIN
        return margin, fast_length(self.rows.shape[-1] + 2 * margin)


class _Likeliest(NamedTuple):
    """The likeliest picture at a speed.

    Attributes:
        spectrum: Its DFT over the canvas; shape `(rows, k)`.
        responses: Responses of the frames on that grid; shape `(frames, k)`.
        gain: How much better than no picture it explains the frames, as a logarithm of likelihood.
        margin: Pixels of the canvas before the sensor.
        length: Pixels of the canvas.
    """

    spectrum: Complex[np.ndarray, "rows k"]
    responses: Complex[np.ndarray, "frames k"]
    gain: float
    margin: int
    length: int


@alone_in_blas()
def restore_frames(
    captures: ArrayLike,
    scene: Scene,
    frames: Sequence[TimedFrame],
    *,
    decoder: AbstractDecoder | None = None,
    speed: float | None = None,
) -> RestoredFrames:
    """Restore the picture that the frames of a sequence show, each point from those that see it.

    Args:
        captures: Light of each frame in units of its exposure of white, as `simulate_frames` gives
            it; shape `(frames, rows, columns)`, or channels last.
        scene: Speeds that may occur, light, noise, and spectrum of pictures.
        frames: The frames, with open shutters.
        decoder: The method; the ensemble filter by default, which is then the best linear one.
        speed: The speed of the picture, px/s; by default it is found in the frames.

    Raises:
        ValueError: if the scene has a background or no light, the captures are not of so many
            frames, or `speed` is not a finite scalar.

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
        >>> print(f"{found.estimate.speed:.0f} px/s, {found.estimate.trusted}")
        700 px/s, True
    """
    require_scene(scene)
    require_whole(scene, "restore_frames")
    if speed is not None:
        require_scalar("restore_frames(speed=...)", speed)
        require_finite("restore_frames(speed=...)", speed)
    subject = "restore_frames(captures=...)"
    light = as_pixels(captures, subject)
    is_stack = light.ndim in (3, 4) and light.shape[0] == len(frames) > 0
    requirement = f"be {len(frames)} frames, of rows and columns"
    require(is_stack, subject, requirement, shape_of(light))
    taken = _Taken.of(scene, frames)
    colours = light[..., None] if light.ndim == 3 else light
    along = np.asarray(turned(colours, scene.sensor.axis))
    planes = np.moveaxis(np.asarray(rows_last(distinct_colours(along))), 0, -2).astype(np.float64)
    estimate = None
    if speed is None:
        estimate = _speed_of(planes, scene, taken)
        speed = estimate.speed
    stack, level = _stacked(planes, taken, [speed])
    found = _likeliest(stack, float(speed))
    equal = _complete(stack, found).reshape(*level.shape, found.length) + level[..., None]
    capture = as_float(np.moveaxis(equal, 0, -1))
    chosen = decoder_or_ensemble(decoder, "restore_frames")
    restored = np.asarray(restored_light(capture, chosen, taken.as_one(float(speed))))
    restored = restored[:, found.margin : found.margin + planes.shape[-1]]
    result = restored[..., 0] if light.ndim == 3 else every_colour(restored, colours[0])
    return RestoredFrames(as_float(turned(result, scene.sensor.axis)), estimate)


@dataclass(frozen=True)
class _Taken:
    """Frames, and the knowledge of them before any is seen.

    Attributes:
        frames: The frames.
        model: The picture's statistics and the lens.
        electrons: Electrons of a white pixel in each.
        noises: Variance of the noise in each, $N_k$; white = 1.
    """

    frames: Sequence[TimedFrame]
    model: BlurModel
    electrons: Float[np.ndarray, "frames"]
    noises: Float[np.ndarray, "frames"]

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
        self, rows: Float[np.ndarray, "rows frames columns"], speeds: Float[np.ndarray, "s"]
    ) -> "_Taken":
        r"""The same of pictures as bright, and as rich in detail, as that of some rows of frames.

        A picture of less detail than expected, or of finer, would else seem to move at a speed that
        explains it. In each band of frequencies its power is that of the frames beyond their noise
        over $\sum_k |A_k|^2$, of which the speeds that are tried have the mean.
        """
        model, columns = self.model, rows.shape[-1]
        noises = _noises_at(max(float(np.mean(rows)), 0.0), self.electrons, model)
        length = fast_length(columns)
        about = rows - np.mean(rows, axis=(-2, -1), keepdims=True)
        recorded = np.mean(np.abs(_spectra_of_windows(about, length)) ** 2, axis=0)
        few = np.linspace(speeds[0], speeds[-1], _FEW_SPEEDS)
        responses = responses_of_frames(
            nodes_of_frames(self.frames, float(np.max(np.abs(few)))), few, model.optics, length
        )
        detail = np.sum(recorded / noises[:, None] - 1, axis=0)
        expected = np.mean(density_of(responses, noises), axis=0) * model.picture_spectrum(length)
        place = np.fft.rfftfreq(length)
        ends = np.geomspace(2 / columns, 0.5, _BANDS + 1)
        bands = [(place >= low) & (place <= high) for low, high in itertools.pairwise(ends)]
        sums = [(float(np.sum(detail[x])), float(np.sum(expected[x]))) for x in bands]
        scales = [max(x / y, _LEAST_DETAIL) if y > 0 else 1.0 for x, y in sums]
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
    return np.maximum(noises, _DARK)


def _spectra_of_windows(
    rows: Float[np.ndarray, "rows frames columns"], length: int
) -> Complex[np.ndarray, "rows frames k"]:
    """Spectra of rows that fade at their ends, as large as those of rows that do not."""
    columns = rows.shape[-1]
    fading = np.hanning(columns + 2)[1:-1]
    return np.fft.rfft(rows * fading / math.sqrt(float(np.mean(fading**2)) * columns), length)


def _stacked(
    planes: Float[np.ndarray, "*planes frames columns"], taken: _Taken, speeds: RowLike
) -> tuple[_Stack, Float[np.ndarray, "*planes"]]:
    """Deviations of the rows of frames from the level of each row, and that level."""
    level = np.mean(planes, axis=(-2, -1))
    rows = (planes - level[..., None, None]).reshape(-1, *planes.shape[-2:])
    nodes = nodes_of_frames(taken.frames, float(np.max(np.abs(speeds))))
    return _Stack(rows, nodes, taken.noises, taken.model), level


def _likeliest(stack: _Stack, speed: float, tolerance: float = _TOLERANCE) -> _Likeliest:
    """The likeliest picture at a speed, by conjugate gradients on all rows at once."""
    columns = stack.rows.shape[-1]
    margin, length = stack.canvas([speed])
    responses = responses_of_frames(stack.nodes, [speed], stack.model.optics, length)[0]
    power = np.maximum(stack.model.picture_spectrum(length), LEAST_POWER)
    window = slice(margin, margin + columns)
    shares = responses.conj() / stack.noises[:, None]

    def gathered(rows: np.ndarray) -> np.ndarray:
        """Spectrum of the picture that frames on the sensor would be made of."""
        whole = np.zeros((*rows.shape[:-1], length))
        whole[..., window] = rows
        return np.sum(shares * np.fft.rfft(whole), axis=1)

    def recorded(picture: np.ndarray) -> np.ndarray:
        """Rows that the frames record of the spectrum of a picture."""
        return np.fft.irfft(picture[:, None] * responses, length)[..., window]

    # The sensor sees a share of the canvas; elsewhere the prior alone holds the picture.
    share = columns / length
    inverse = 1 / (share * density_of(responses, stack.noises) + 1 / power)
    target = gathered(stack.rows)
    picture = np.zeros_like(target)
    residual, step = target, target * inverse
    size = _product(residual, step, length)
    least = tolerance**2 * size
    for _ in range(_MOST_STEPS):
        active = size > least
        if not np.any(active):
            break
        image = gathered(recorded(step)) + step / power
        stride = np.where(active, size / np.maximum(_product(step, image, length), 1e-300), 0.0)
        picture = picture + stride[:, None] * step
        residual = residual - stride[:, None] * image
        turned_residual = residual * inverse
        following = _product(residual, turned_residual, length)
        step = turned_residual + (following / np.maximum(size, 1e-300))[:, None] * step
        size = following
    gain = float(np.sum(_product(target, picture, length))) / 2
    return _Likeliest(picture, responses, gain, margin, length)


def _product(
    first: Complex[np.ndarray, "rows k"], second: Complex[np.ndarray, "rows k"], length: int
) -> Float[np.ndarray, "rows"]:
    """Inner products of rows, from half of their spectra."""
    return mean_over_dft(np.real(first.conj() * second), length)


def _complete(stack: _Stack, found: _Likeliest) -> Float[np.ndarray, "rows length"]:
    r"""The one capture that the frames are as good as, once each goes on beyond its borders."""
    columns, begin = stack.rows.shape[-1], found.margin
    density = density_of(found.responses, stack.noises)
    spectrum = np.zeros_like(found.spectrum)
    for frame, (response, noise) in enumerate(zip(found.responses, stack.noises, strict=True)):
        rows = np.fft.irfft(found.spectrum * response, found.length)
        rows[:, begin : begin + columns] = stack.rows[:, frame]
        spectrum += response.conj() / noise * np.fft.rfft(rows)
    equal = spectrum / np.sqrt(np.maximum(density, LEAST_POWER) * density[0])
    return np.fft.irfft(equal, found.length)


def _speed_of(
    planes: Float[np.ndarray, "*planes frames columns"], scene: Scene, taken: _Taken
) -> SpeedEstimate:
    """The speed at which the frames show one picture.

    A first likelihood is that of the spectra of windows, of many speeds; a second, of the frames as
    they are, judges its highest peaks.
    """
    slowest, fastest = (float(speed) for speed in scene.speed_range)
    if slowest == fastest:
        return SpeedEstimate(slowest, 0.0, True, np.array([slowest]), np.ones(1), "")
    grey = np.tensordot(luminance_shares(len(planes)), planes, 1)
    some = np.unique(np.linspace(0, len(grey) - 1, min(ROWS_OF_SPEED, len(grey))).astype(int))
    speeds = _speeds_to_try(slowest, fastest, taken.frames)
    stack, _ = _stacked(grey[some], taken.like(grey[some], speeds), speeds)
    first = _likelihoods_of_windows(stack, speeds)
    beside = np.concatenate([[-np.inf], first, [-np.inf]])
    peaks = np.flatnonzero((first >= beside[:-2]) & (first > beside[2:]))
    peaks = peaks[np.argsort(-first[peaks])][:_CANDIDATES]
    spacing = float(speeds[1] - speeds[0])
    ends = [_highest(stack, float(speeds[place]), spacing) for place in peaks]
    ends.sort(key=lambda end: -end.value)
    best = ends[0]
    # A likelihood that is as high all over has one peak too.
    spread = np.linspace(speeds[0], speeds[-1], _SPREAD).tolist()
    rivals = [(end.speed, end.value) for end in ends]
    rivals += [(speed, _logarithm(stack, speed)) for speed in spread]
    others = [value for speed, value in rivals if abs(speed - best.speed) > _REACH * spacing]
    lead = _WORTH * (best.value - max(others, default=-math.inf))
    is_at_end = best.speed <= speeds[0] or best.speed >= speeds[-1]
    doubt = ""
    if is_at_end:
        doubt = BEYOND
    elif lead < _SURE or not best.error * _duration(taken.frames) < _REGISTERED:
        doubt = LITTLE
    known = sorted(ends, key=lambda end: end.speed)
    weights = np.exp(_WORTH * np.array([end.value - best.value for end in known]))
    return SpeedEstimate(
        best.speed,
        best.error,
        doubt == "",
        np.array([end.speed for end in known]),
        weights / np.sum(weights),
        doubt,
    )


def _speeds_to_try(
    slowest: float, fastest: float, frames: Sequence[TimedFrame]
) -> Float[np.ndarray, "s"]:
    """Speeds between which the picture moves on by less than a pixel over the sequence."""
    duration = _duration(frames)
    beyond = _BEYOND * max(fastest - slowest, abs(fastest), abs(slowest))
    low, high = slowest - beyond, fastest + beyond
    return np.linspace(low, high, 2 + int((high - low) * duration / _PX_A_STEP))


def _duration(frames: Sequence[TimedFrame]) -> float:
    """Time from the first mid-exposure to the last, or that of one frame; s."""
    times = [frame.time for frame in frames]
    return max(max(times) - min(times), max(frame.exposure for frame in frames))


def _likelihoods_of_windows(
    stack: _Stack, speeds: Float[np.ndarray, "s"]
) -> Float[np.ndarray, "s"]:
    r"""Logarithms of the likelihood of speeds, from the spectra of frames that fade at their ends.

    $\sum_f \frac{S\,|\sum_k \bar A_k \hat g_k/N_k|^2}{1 + S Q} - \log(1 + S Q)$ with
    $Q = \sum_k |A_k|^2/N_k$, halved, of each frame and the next: of frames that are further apart
    the same windows may show different parts of the picture.
    """
    number, num_frames, columns = stack.rows.shape
    length = fast_length(columns)
    spectra = _spectra_of_windows(stack.rows, length) / stack.noises[:, None]
    power, result = stack.model.picture_spectrum(length), np.zeros(speeds.size)
    pairs = list(itertools.pairwise(range(num_frames))) or [(0,)]
    for begin in range(0, speeds.size, _SPEEDS_AT_ONCE):
        some = slice(begin, begin + _SPEEDS_AT_ONCE)
        responses = responses_of_frames(stack.nodes, speeds[some], stack.model.optics, length)
        for pair in map(list, pairs):
            both, noises = responses[:, pair], stack.noises[pair]
            density = power * density_of(both, noises)
            together = np.einsum("snf,rnf->srf", both.conj(), spectra[:, pair], optimize=True)
            match = np.sum(np.abs(together) ** 2, axis=1) * power / (1 + density)
            result[some] += np.sum(match - number * np.log1p(density), axis=1) / 2
    return result


class _Peak(NamedTuple):
    """A speed at which the likelihood is highest nearby, its logarithm there, and its width."""

    speed: float
    value: float
    error: float


def _highest(stack: _Stack, speed: float, spacing: float) -> _Peak:
    """The peak of the likelihood of the frames as they are, near a speed."""
    from scipy.optimize import minimize_scalar

    def loss(value: float) -> float:
        return -_logarithm(stack, value)

    reach, peak, least = _REACH * spacing, speed, math.inf
    for _ in range(_MOST_MOVES):
        # Windows of fast pictures show too little of the same for a better start, and those of
        # smooth ones hardly more than their own fading.
        middle = peak
        end: Any = minimize_scalar(
            loss,
            bounds=(middle - reach, middle + reach),
            method="bounded",
            options={"xatol": 0.05 * spacing},
        )
        peak, least = float(end.x), float(end.fun)
        if abs(peak - middle) < 0.9 * reach:
            break
        reach *= 2
    side = 0.2 * spacing
    curvature = (loss(peak - side) + loss(peak + side) - 2 * least) / side**2
    error = 1 / math.sqrt(_WORTH * curvature) if curvature > 0 else math.inf
    return _Peak(peak, -least, error)


def _logarithm(stack: _Stack, speed: float) -> float:
    """Logarithm of the likelihood of the frames as they are, but for a constant."""
    return _likeliest(stack, speed, _TOLERANCE_OF_SPEED).gain - _volume(stack, speed)


def _volume(stack: _Stack, speed: float) -> float:
    """Half the logarithm of the determinant of the frames' covariance, over that of their noise.

    It is that of rows without ends, in each part of the picture for as many frames as see it.
    """
    columns = stack.rows.shape[-1]
    length = fast_length(columns)
    responses = responses_of_frames(stack.nodes, [speed], stack.model.optics, length)[0]
    power = stack.model.picture_spectrum(length)
    density = np.abs(responses) ** 2 / stack.noises[:, None]
    middles = [float(np.mean(some.place - speed * some.time)) for some in stack.nodes]
    ends = np.unique(np.concatenate([middles, np.array(middles) + columns]))
    total = 0.0
    for begin, end in itertools.pairwise(ends):
        sees = [m <= (begin + end) / 2 <= m + columns for m in middles]
        each = np.log1p(power * np.sum(density[sees], axis=0))
        total += (end - begin) / columns * length * float(mean_over_dft(each, length)) / 2
    return len(stack.rows) * total / 2
