r"""Signs in a clip that forbid a number: its levels are not those that a sensor gave.

All look at differences of successive frames where nothing moves, which hold noise alone. Their
thresholds lie between uncompressed clips of photographs and the same clips after a JPEG of quality
95, a gamma, or a smoothing (`benchmarks/measure.py`).
"""

import numpy as np
from jaxtyping import Float
from scipy import fft, optimize, special

from mishutter.measurement.clip import Clip
from mishutter.measurement.estimates import Refusal
from mishutter.measurement.photon_transfer import Transfer

NOISE = "the noise"
UNCOMPRESSED = "Record frames as the sensor gives them: PNG or TIFF, no compression, no denoising"
BELOW_STEPS = "it is smaller than the steps of the file"
MORE_BITS = "Record more bits, or raise the camera's gain until noise spans some levels"
_LEAST_NOISE = 0.3
"""Noise without that of rounding below which steps hide it; steps."""
_SIDE = 8
"""Side of a block of `photon_transfer`, and of a JPEG's; px."""
_MOST_REPEATS = 1.3, 0.03
"""Share of pixels that may repeat, over that which noise repeats, and beyond it."""
_MOST_CORRELATION = 0.06
_QUANTA = np.array([2, 3, 4, 5, 6, 8, 10, 12, 16, 20])
"""Steps of coefficients that a JPEG of quality 60 to 97 has; levels."""
_OUTLIER, _LEAST_COMB = 8.0, 0.03
_PAIRS_LOOKED_AT, _BLOCKS_LOOKED_AT = 3, 400
_GAMMAS = np.arange(0.3, 3.51, 0.05)
_LEAST_GAMMA, _GAMMA_CERTAIN = 0.15, 25.0
"""Distance of gamma from 1 that is looked at, and the fall of chi squared that proves it."""
_LEAST_RISE = 0.2
"""Rise of the variance over the levels, as a share, below which it counts as flat."""
_LEAST_BEND = 0.06
"""Distance from a line below which a gamma would change no number by much."""
_BENT, _BENT_CERTAIN = 0.2, 8.0
"""Distance from a line, as a share of the variance and in errors, that is no straight curve's."""
_LEAST_RANGE = 2.0
_MOST_CUT = 0.9


def signs_of(
    clip: Clip, steady: np.ndarray, transfer: Transfer, black: float | None
) -> list[Refusal]:
    """The signs that a clip has, each with its reason and remedy.

    Args:
        clip: The clip.
        steady: Its frames, divided by an exposure that drifts.
        transfer: Its law of the noise.
        black: Level of black, if it is known.
    """
    signs = (
        _repeats(clip, transfer),
        _correlates(steady, transfer.at_rest),
        _steps_of_eight(clip),
        _bends(transfer, black, clip.step),
    )
    return [sign for sign in signs if sign is not None]


def shot_gamma(transfer: Transfer, step: float) -> float | None:
    """The gamma that explains the curve without read noise as well as a line; None for none.

    Args:
        transfer: The law of the noise.
        step: Step between levels.
    """
    level, variance, error, _ = transfer.curve()
    usable = level > 0.02 * level.max()
    unit = level[usable] / level.max()
    target, error = variance[usable] - step**2 / 12, error[usable]
    straight = float(np.sum(((variance[usable] - transfer.law(level[usable])) / error) ** 2))
    shot = unit[None] ** (2 - _GAMMAS[:, None]) / error
    gains = shot @ (target / error) / np.sum(shot**2, axis=1)
    misfit = np.sum((target / error - gains[:, None] * shot) ** 2, axis=1)
    best = int(np.argmin(misfit))
    gamma = float(_GAMMAS[best])
    if abs(gamma - 1) < _LEAST_GAMMA or misfit[best] > straight + _GAMMA_CERTAIN:
        return None
    return gamma


def too_narrow(transfer: Transfer, black: float | None, has_others: bool) -> Refusal | None:
    """The refusal of a clip whose levels are too alike to show a slope.

    Args:
        transfer: The law of the noise.
        black: Level of black, if it is known.
        has_others: Whether dark frames or flat fields widen the range.
    """
    low, high = np.quantile(transfer.blocks.mean, (0.01, 0.99)) - (black or 0.0)
    if has_others or high > _LEAST_RANGE * max(low, 0):
        return None
    reason = f"levels of what stands still lie within a factor of {high / low:.2g}"
    remedy = "Film a scene with bright and dark parts, or add two dark frames (--dark)"
    return Refusal(NOISE, reason, remedy)


def too_few(clip: Clip, whole_share: float, variance: float) -> Refusal:
    """The refusal of a clip with too few blocks at rest.

    Args:
        clip: The clip.
        whole_share: Share of the blocks that are not cut off.
        variance: Median variance of those.
    """
    if whole_share >= 1 - _MOST_CUT and variance < (_LEAST_NOISE**2 + 1 / 12) * clip.step**2:
        return Refusal(NOISE, BELOW_STEPS, MORE_BITS)
    if whole_share < 1 - _MOST_CUT:
        ends = "black" if np.isfinite(clip.ends[0]) else "white"
        if all(np.isfinite(clip.ends)):
            ends = "black or white"
        reason = f"{1 - whole_share:.0%} of the picture is cut off at {ends}"
        remedy = "Expose so that neither end is reached, with a black level above 0"
        return Refusal(NOISE, reason, remedy)
    reason = "too little of the clip stands still to measure the noise of each level"
    remedy = "Film with the same settings what stands still, or add flat fields (--flat)"
    return Refusal(NOISE, reason, remedy)


def _repeats(clip: Clip, transfer: Transfer) -> Refusal | None:
    r"""Pixels that keep their level from frame to frame more often than noise lets them.

    Two levels that were rounded are equal with the chance $E\max(0, 1 - |x|)$, of a difference
    $x$ in steps before rounding.
    """
    if clip.step == 0:
        return None
    equal, expected = [], []
    for k, rest in enumerate(transfer.at_rest):
        if not rest.any():
            continue
        first, second = _blocks(clip.frames[k])[rest], _blocks(clip.frames[k + 1])[rest]
        equal.append(np.mean(first == second, axis=1))
        variance = transfer.law((first.mean(axis=1) + second.mean(axis=1)) / 2)
        deviation = np.sqrt(2 * np.maximum(variance / clip.step**2 - 1 / 12, 1e-4))
        tail = deviation * np.sqrt(2 / np.pi) * (1 - np.exp(-1 / (2 * deviation**2)))
        expected.append(special.erf(1 / deviation / np.sqrt(2)) - tail)
    if not equal:
        return None
    share, usual = np.concatenate(equal).mean(), np.concatenate(expected).mean()
    if share <= _MOST_REPEATS[0] * usual + _MOST_REPEATS[1]:
        return None
    reason = (
        f"{share:.0%} of the pixels at rest repeat from frame to frame, noise repeats {usual:.0%}"
    )
    return Refusal(NOISE, reason, UNCOMPRESSED)


def _correlates(frames: np.ndarray, at_rest: np.ndarray) -> Refusal | None:
    """Noise that neighbours share, as after compression, demosaicing, resizing or denoising."""
    products = power = 0.0
    for k, rest in enumerate(at_rest):
        if not rest.any():
            continue
        noise = _blocks(frames[k + 1] - frames[k])[rest].astype(np.float64)
        noise = (noise - noise.mean(axis=1, keepdims=True)).reshape(-1, _SIDE, _SIDE)
        products += np.sum(noise[:, :, 1:] * noise[:, :, :-1])
        products += np.sum(noise[:, 1:] * noise[:, :-1])
        power += np.sum(noise**2) * 2 * (_SIDE - 1) / _SIDE
    # Without its mean, a block of independent pixels has neighbours that correlate by -1/63.
    correlation = products / max(power, 1e-30) + 1 / (_SIDE**2 - 1)
    if abs(correlation) <= _MOST_CORRELATION:
        return None
    reason = f"the noise of neighbouring pixels correlates by {correlation:.2f}"
    remedy = "Record raw frames: no compression, demosaicing, resizing, sharpening or denoising"
    return Refusal(NOISE, reason, remedy)


def _steps_of_eight(clip: Clip) -> Refusal | None:
    r"""Coefficients of 8 x 8 blocks that lie on steps, on one of the 64 grids alone: a JPEG's.

    The mean of $\cos(2\pi c/q)$ over coefficients $c$ of a cosine transform is 1 where all are
    multiples of $q$; on other grids it is that of the noise.
    """
    if clip.step == 0:
        return None
    count = min(_PAIRS_LOOKED_AT, clip.num_frames - 1)
    differences = (clip.frames[1 : count + 1] - clip.frames[:count]) / np.float32(clip.step)
    scores = np.array([_comb(differences, *divmod(n, _SIDE)) for n in range(_SIDE**2)])
    best, usual = scores.max(), np.median(scores)
    spread = 1.4826 * np.median(np.abs(scores - usual))
    if best - usual <= max(_LEAST_COMB, _OUTLIER * spread):
        return None
    reason = "frames lie on steps of 8 x 8 px, as those that were a JPEG or a video do"
    return Refusal(NOISE, reason, UNCOMPRESSED)


def _comb(differences: np.ndarray, down: int, across: int) -> float:
    """The strongest comb of each coefficient on the grid of an offset, averaged."""
    blocks = np.concatenate([_blocks(d[down:, across:]).reshape(-1, 64) for d in differences])
    blocks = blocks[:: max(1, len(blocks) // _BLOCKS_LOOKED_AT)]
    squares = blocks.reshape(-1, _SIDE, _SIDE)
    coefficients = np.asarray(fft.dctn(squares, axes=(1, 2), norm="ortho"))
    angles = coefficients.reshape(len(blocks), -1, 1) * (2 * np.pi / _QUANTA)
    return float(np.cos(angles).mean(axis=0).max(axis=-1).mean())


def _blocks(frame: np.ndarray) -> Float[np.ndarray, "rows columns 64"]:
    rows, columns = (n // _SIDE for n in frame.shape)
    cut = frame[: rows * _SIDE, : columns * _SIDE].reshape(rows, _SIDE, columns, _SIDE)
    return cut.swapaxes(1, 2).reshape(rows, columns, _SIDE**2)


def _bends(transfer: Transfer, black: float | None, step: float) -> Refusal | None:
    r"""A curve of variance over mean that is no line, and the gamma that explains it.

    Light $x$ that is coded as $m = A x^{1/\gamma}$ has the variance $a m^{2 - \gamma} +
    s m^{2 - 2\gamma}$ of shot and read noise.
    """
    level, variance, error, count = transfer.curve()
    light = level - (black or 0.0)
    usable = (light > 0.02 * light.max()) & (count > 5)
    if np.sum(usable) < 5:
        return None
    level, light, variance, error = (x[usable] for x in (level, light, variance, error))
    misfit = (variance - transfer.law(level)) / error
    straight = float(np.sum(misfit**2))
    target = (variance - step**2 / 12) / error
    unit = light / light.max()
    fits = []
    for gamma in _GAMMAS:
        columns = np.stack([unit ** (2 - gamma), unit ** (2 - 2 * gamma)], axis=1)
        fits.append(optimize.nnls(columns / error[:, None], target)[1] ** 2)
    best = int(np.argmin(fits))
    gamma, gain = float(_GAMMAS[best]), straight - fits[best]
    remedy = "Switch gamma off, or record raw frames: levels must be proportional to light"
    bend = np.abs(variance / transfer.law(level) - 1)
    is_flat = transfer.law.gain * np.ptp(level) < _LEAST_RISE * variance.max()
    is_bent = abs(gamma - 1) >= _LEAST_GAMMA and (is_flat or bend.max() > _LEAST_BEND)
    if is_bent and gain > _GAMMA_CERTAIN * max(1.0, fits[best] / unit.size):
        reason = f"the variance over the mean is bent as by a gamma of {gamma:.2g}"
        return Refusal(NOISE, reason, remedy)
    if np.any((bend > _BENT) & (np.abs(misfit) > _BENT_CERTAIN)):
        reason = f"the variance over the mean is {bend.max():.0%} from a straight line"
        return Refusal(NOISE, reason, remedy)
    return None
