r"""Signs in a clip that forbid a number: its levels are not those that a sensor gave.

All look at differences of successive frames where nothing moves, which hold noise alone. Their
thresholds lie between uncompressed clips of photographs and the same clips after a JPEG, a gamma
or a smoothing, and hold for other photographs (`benchmarks/measure.py`).
"""

import numpy as np
from jaxtyping import Float
from scipy import fft, ndimage, optimize, special

from mishutter.measurement.clip import Clip
from mishutter.measurement.estimates import Estimate, Refusal
from mishutter.measurement.photon_transfer import Transfer, blocks_of, pairs_of
from mishutter.measurement.steady import SIDE, Steady
from mishutter.pictures.registration.windows import means

NOISE = "the noise"
UNCOMPRESSED = "Record frames as the sensor gives them: PNG or TIFF, no compression, no denoising"
BELOW_STEPS = "it is smaller than the steps of the file"
MORE_BITS = "Record more bits, or raise the camera's gain until noise spans some levels"
_GAMMAS = np.arange(0.3, 3.51, 0.05)
_LEAST_GAMMA, _GAMMA_CERTAIN = 0.15, 16.0
"""Distance of gamma from 1 that is looked at, and fall of chi squared that proves it."""
_LEAP_CERTAIN = 40.0
"""Fall of chi squared that proves a leap of the variance: photographs of one gain reach 8, and two
gains 100 where the brighter of 900 electrons have 8 of read noise in place of 2."""
_STRAIGHT = 0.01
"""Distance from a line, as a share of the variance, that a sensor and what moves may leave."""
_LEAST_DETAIL, _MOST_DETAIL = 0.04, 0.15
"""Excess of the noise of edges that is doubted, and that forbids a number."""
_MOST_SHARED = 0.05
"""Share by which the variance of differences may depend on the time between frames."""
_MOST_CUT = 0.9
"""Share of the picture that may be cut off where noise is still measured."""


def signs_of(clip: Clip, steady: Steady, transfer: Transfer, black: float | None) -> list[Refusal]:
    """The signs that a clip has, each with its reason and remedy."""
    coded = [_repeats(steady.levels, transfer, clip.step), _steps_of_eight(clip)]
    others = [
        _correlates(steady.same, transfer.at_rest),
        _is_filtered(clip, steady, transfer),
        _bends(transfer, black, clip.step),
    ]
    excess = detail_excess(clip, steady, transfer)
    # Edges that move make noise that neighbours and frames share, and that no level explains.
    if is_moved(excess) and (any(others) or excess.value > _MOST_DETAIL):
        reason = f"what has detail has {excess.value:.0%} more of it: the camera or its focus moves"
        remedy = "Stand the camera on something firm, lock its focus, and record with one gain"
        others = [Refusal(NOISE, reason, remedy)]
    elif steady.bands and any(others):
        remedy = "Take daylight, or lamps on direct current, and record again"
        reason = f"lamps that flicker light rows unlike, by {steady.bands:.1%}"
        others = [Refusal(NOISE, reason, remedy)]
    elif steady.focus and any(others):
        remedy = "Lock the focus, and record again"
        others = [Refusal(NOISE, "the focus drifts over the clip, which changes edges", remedy)]
    return [sign for sign in (*coded, *others) if sign is not None]


def is_moved(excess: Estimate) -> bool:
    """Whether edges have more noise than flat parts, and more than chance gives them."""
    return excess.value > max(_LEAST_DETAIL, 4 * excess.error)


def shot_gamma(transfer: Transfer, step: float) -> float | None:
    """The gamma that explains the curve without read noise as well as a line; None for none."""
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
    if gamma - 1 < _LEAST_GAMMA or misfit[best] > straight + _GAMMA_CERTAIN:
        return None
    return gamma


def too_narrow(transfer: Transfer, black: float | None, has_others: bool) -> Refusal | None:
    """The refusal of a clip whose levels are too alike to show a slope."""
    low, high = np.quantile(transfer.blocks.mean, (0.01, 0.99)) - (black or 0.0)
    if has_others or high > 2 * max(low, 0):
        return None
    reason = f"levels of what stands still lie within a factor of {high / low:.3g}"
    remedy = "Film a scene with bright and dark parts, or add two dark frames (--dark)"
    return Refusal(NOISE, reason, remedy)


def too_few(clip: Clip, whole_share: float, variance: float) -> Refusal:
    """The refusal of a clip with too few blocks at rest."""
    # Noise of less than 0.3 steps, without that of rounding, is hidden by them.
    if whole_share >= 1 - _MOST_CUT and variance < (0.3**2 + 1 / 12) * clip.step**2:
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


def _repeats(frames: np.ndarray, transfer: Transfer, step: float) -> Refusal | None:
    r"""Pixels that keep their level from frame to frame more often than noise lets them.

    Two levels that were rounded are equal with the chance $E\max(0, 1 - |x|)$, of a difference
    $x$ in steps before rounding.
    """
    if step == 0:
        return None
    equal, expected = [], []
    for k, rest in enumerate(transfer.at_rest):
        if not rest.any():
            continue
        first, second = _blocks(frames[k])[rest], _blocks(frames[k + 1])[rest]
        equal.append(np.mean(first == second, axis=1))
        variance = transfer.law((first.mean(axis=1) + second.mean(axis=1)) / 2)
        deviation = np.sqrt(2 * np.maximum(variance / step**2 - 1 / 12, 1e-4))
        tail = deviation * np.sqrt(2 / np.pi) * (1 - np.exp(-1 / (2 * deviation**2)))
        expected.append(special.erf(1 / deviation / np.sqrt(2)) - tail)
    if not equal:
        return None
    share, usual = np.concatenate(equal).mean(), np.concatenate(expected).mean()
    # So many pixels may repeat, over those that noise repeats and beyond them.
    if share <= 1.3 * usual + 0.03:
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
        noise = (noise - noise.mean(axis=1, keepdims=True)).reshape(-1, SIDE, SIDE)
        products += np.sum(noise[:, :, 1:] * noise[:, :, :-1])
        products += np.sum(noise[:, 1:] * noise[:, :-1])
        power += np.sum(noise**2) * 2 * (SIDE - 1) / SIDE
    # Without its mean, a block of independent pixels has neighbours that correlate by -1/63.
    correlation = products / max(power, 1e-30) + 1 / (SIDE**2 - 1)
    if abs(correlation) <= 0.06:
        return None
    reason = f"the noise of neighbouring pixels correlates by {correlation:.2f}"
    remedy = "Record raw frames: no compression, demosaicing, resizing, sharpening or denoising"
    return Refusal(NOISE, reason, remedy)


def detail_excess(clip: Clip, steady: Steady, transfer: Transfer) -> Estimate:
    """Variance of what has most detail over that of what has least, beyond what levels explain.

    Noise does not know detail: where edges have more of it, they move.
    """
    mean = np.mean(steady.same, axis=0)
    slopes = ndimage.gaussian_gradient_magnitude(mean, 1.0) ** 2
    level, detail = (means(x, SIDE) for x in (mean, slopes))
    rest = transfer.at_rest & transfer.law.exceeds_steps(level, clip.step)
    detail = np.broadcast_to(detail / transfer.law(level), rest.shape)[rest]
    spread = (transfer.clip.variance / transfer.law(transfer.clip.mean)).reshape(rest.shape)[rest]
    level = np.broadcast_to(level, rest.shape)[rest]
    excesses, squares = [], []
    # Blocks of one level are compared, so that no curve of the noise counts.
    for part in np.array_split(np.argsort(level), 8):
        if part.size < 30:
            return Estimate(0.0, np.inf)
        low, high = np.quantile(detail[part], (0.5, 0.8))
        few, many = spread[part][detail[part] <= low], spread[part][detail[part] >= high]
        excesses.append(many.mean() - few.mean())
        # Each frame is in two pairs.
        squares.append(1.5 * (few.var() / few.size + many.var() / many.size))
    return Estimate(float(np.mean(excesses)), float(np.sqrt(np.sum(squares))) / len(squares))


def _is_filtered(clip: Clip, steady: Steady, transfer: Transfer) -> Refusal | None:
    r"""Noise that successive frames share, as after a denoising over time.

    Differences of raw frames have one variance, however far apart in time: that of frames two or
    three apart over that of neighbours is $1 + \rho$ and more for noise that correlates by
    $\rho$. Flat parts alone are asked, where little motion changes nothing.
    """
    worst, error = 0.0, np.inf
    near = transfer.clip
    shape = transfer.at_rest.shape
    near_spread = (near.variance / transfer.law(near.mean)).reshape(shape)
    texture = (near.texture / transfer.law(near.mean)).reshape(shape)
    for lag in (2, 3):
        if steady.num_frames <= lag:
            break
        far = blocks_of(steady, pairs_of(steady.num_frames, lag), clip.ends)
        count = steady.num_frames - lag
        rest = np.all([transfer.at_rest[k : k + count] for k in range(lag)], axis=0)
        if rest.sum() < 30:
            break
        rest &= texture[:count] <= np.median(texture[:count][rest])
        spread = (far.variance / transfer.law(far.mean)).reshape(rest.shape)
        by_one = np.mean([near_spread[k : k + count] for k in range(lag)], axis=0)
        ratio = float(spread[rest].mean() / by_one[rest].mean())
        own = 3 / np.sqrt(60 * rest.sum())
        if abs(ratio - 1) > worst:
            worst, error = abs(ratio - 1), own
    if worst <= max(_MOST_SHARED, 4 * error):
        return None
    reason = f"the noise of successive frames is alike by {worst:.0%}, as after denoising over time"
    remedy = "Switch temporal noise reduction off: each frame must be an exposure of its own"
    return Refusal(NOISE, reason, remedy)


def _steps_of_eight(clip: Clip) -> Refusal | None:
    r"""Coefficients of 8 x 8 blocks that are whole numbers, on one of the 64 grids alone: a JPEG's.

    A JPEG of any quality rounds them to multiples of whole numbers, from 1 on. What is left of that
    after levels are rounded, $E\cos 2\pi c = e^{-2\pi^2/12} = 0.19$ over coefficients $c$ of the
    cosine transform, is 0 on other grids, but for what flat parts and single coefficients have on
    all of them.
    """
    if clip.step == 0:
        return None
    frames, means = clip.frames[:3] / np.float32(clip.step), []
    for down, across in np.ndindex(SIDE, SIDE):
        each = [_blocks(frame[down:, across:]).reshape(-1, SIDE**2) for frame in frames]
        blocks = np.concatenate(each)
        # Some hundred blocks tell as much as all.
        blocks = blocks[:: max(1, len(blocks) // 400)].reshape(-1, SIDE, SIDE)
        coefficients = np.asarray(fft.dctn(blocks, axes=(1, 2), norm="ortho"))
        means.append(np.cos(2 * np.pi * coefficients).mean(axis=0).ravel())
    combs = np.array(means)
    *_, second, best = np.sort((combs - np.median(combs, axis=0)).mean(axis=1))
    # A JPEG's grid leads the second best by 0.09 to 0.26 for qualities from 60 on, others by 0.01.
    if best - second <= 0.04:
        return None
    reason = "frames lie on steps of 8 x 8 px, as those that were a JPEG do"
    return Refusal(NOISE, reason, UNCOMPRESSED)


def _blocks(frame: np.ndarray) -> Float[np.ndarray, "rows columns 64"]:
    rows, columns = (n // SIDE for n in frame.shape)
    cut = frame[: rows * SIDE, : columns * SIDE].reshape(rows, SIDE, columns, SIDE)
    return cut.swapaxes(1, 2).reshape(rows, columns, SIDE**2)


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
    error = np.hypot(error, _STRAIGHT * transfer.law(level))
    straight = float(np.sum(((variance - transfer.law(level)) / error) ** 2))
    target = (variance - step**2 / 12) / error
    unit = light / light.max()
    fits = []
    for gamma in _GAMMAS:
        columns = np.stack([unit ** (2 - gamma), unit ** (2 - 2 * gamma)], axis=1)
        fits.append(optimize.nnls(columns / error[:, None], target)[1] ** 2)
    best = int(np.argmin(fits))
    gamma, gain = float(_GAMMAS[best]), straight - fits[best]
    is_gamma = abs(gamma - 1) >= _LEAST_GAMMA
    is_bent = is_gamma and gain > _GAMMA_CERTAIN * max(1.0, fits[best] / unit.size)
    bend = np.abs(variance / transfer.law(level) - 1)
    # No straight curve is as far from a line, or has as much that is square in the level.
    is_far = np.any(bend > np.maximum(0.2, 8.0 * error / transfer.law(level)))
    square, spread = transfer.curvature
    spread = np.hypot(spread, _STRAIGHT * float(transfer.law(np.median(transfer.blocks.mean))))
    misfit, leap = _leap(level, variance, error)
    leaps = leap is not None and misfit < 0.3 * min(straight, *fits)
    if not (is_bent or is_far or abs(square) > 4.5 * spread) and not (
        leaps and straight - misfit > _LEAP_CERTAIN
    ):
        return None
    reason = f"the variance over the mean is {bend.max():.0%} from a straight line"
    remedy = "Record raw frames with one gain: levels must be proportional to light"
    if leaps:
        reason = f"the variance leaps at level {leap:.3g}, as of a sensor that reads with two gains"
        remedy = "Record with one gain (one readout, no high dynamic range)"
    elif is_gamma and gamma > 1 and gain > 4:
        reason = f"the variance over the mean is bent as by a gamma of {gamma:.2g}"
        remedy = "Switch gamma off, or record raw frames: levels must be proportional to light"
    return Refusal(NOISE, reason, remedy)


def _leap(level: np.ndarray, variance: np.ndarray, error: np.ndarray) -> tuple[float, float | None]:
    """The misfit of a variance that leaps up at a level and goes on as steeply, and that level.

    So a sensor reads with two gains, the brighter part with more noise.
    """
    fits: list[tuple[float, float | None]] = [(np.inf, None)]
    for k in range(2, level.size - 2):
        # Blocks of one bin lie to either side of the leap.
        used = np.arange(level.size) != k
        leap = np.arange(level.size) > k
        columns = np.stack([np.ones(level.size), level, leap], axis=1)[used] / error[used, None]
        target = variance[used] / error[used]
        found = np.linalg.lstsq(columns, target)[0]
        if found[1] > 0 and found[2] > 0:
            fits.append((float(np.sum((columns @ found - target) ** 2)), float(level[k])))
    return min(fits, key=lambda fit: fit[0])
