r"""The expected PSNR that no path of the sensor and no shutter exceeds for a scene.

Let $g(t) = w(t)\,e^{-2\pi i f x_c(t)}$ be the wave that any path $x_c$ and any transmittance
$0 \le w \le 1$ record, $L = \int w\,dt$ the time that the shutter is open, and
$K_i(f) = \int g\,e^{2\pi i f s_i t}\,dt$ the response at speed $s_i$ of weight $p_i$, in seconds.
White noise of equation (4) of the paper has, in the same unit, the variance
$L\bar f/R + (\sigma/R)^2$ at a photon rate $R$.

1.  *Error.* One filter for all speeds leaves at least the error of one filter for each, and since
    $x \mapsto 1/(1 + x)$ is convex (Jensen's inequality) that is at least
    $E \ge \overline{S/(1 + S\,\mathrm{sinc}^2(f)\,q)}$ with
    $q = \sum_i p_i|K_i|^2 / (L\bar f/R + (\sigma/R)^2)$; the mean is over frequencies.
2.  *Response.* $|K_i| \le L$, and $K_i$ is the inner product of $g$ with a wave. Since
    $\lVert g\rVert^2 = \int w^2 \le L$, both together say
    $\sum_i p_i|K_i|^2 \le \min(L^2, L\,M)$, where $M(T) = 2T\lambda(Tf)$ is the largest eigenvalue
    of the weighted Gram matrix of these waves on $[-T, T]$,
    $2T\sqrt{p_i p_j}\,\mathrm{sinc}(2Tf(s_i - s_j))$.
3.  *Open shutter.* Hence $q \le \min(L^2, L M)/(L\bar f/R + (\sigma/R)^2)$. Neither $L^2$ nor
    $L M$ over that divisor falls with $L$, so the bound is largest for an open shutter,
    $L = 2T$, although that lets the most noise through.
4.  *Longest exposure.* A shutter within a shorter exposure is one within the longest that stays
    closed at both ends: $M$ never falls with $T$, although $\lambda$ alone may fall and rise, and
    the longest exposure bounds all. At one exposure $f\lambda(Tf)$ is proportional to $M$ at one
    frequency and an exposure that varies: it never falls with $f$, so that its value at a higher
    frequency bounds it at a lower one.

5.  *Uneven speeds.* By Parseval's theorem $\int|K_s|^2 ds \le L/f$, so that of
    $\rho(s) = S\,\mathrm{sinc}^2(f)\,|K_s|^2/(L\bar f/R + (\sigma/R)^2)$ no more than a budget
    can be spread over speeds of the density $p(s)$, and none is above a cap. The least mean of
    $1/(1 + \rho)$ pours the budget like water: $\rho = \sqrt{p/m} - 1$ between 0 and the cap. It
    equals 2. where $p$ is even, and is a lower ceiling elsewhere.

With $L = 2T$ the ceiling is that of
$q = 2R\,T\lambda\,/\,(\bar f + \sigma^2/2RT)$.

"The paper" is "Improved motion invariant imaging with time varying shutter functions".
"""

from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from mishutter._core.checks import as_float, require, require_known, require_scalar
from mishutter.evaluation.fans import MEASURED, Fan, Grid
from mishutter.evaluation.layers import Background
from mishutter.evaluation.levels import Light, psnr_of_error
from mishutter.evaluation.needs import distinct_speeds, frequency_counts
from mishutter.model.occlusion import Occlusion
from mishutter.model.optics import NUM_FREQUENCIES, NYQUIST_FREQUENCY, frequencies, pixel_response
from mishutter.model.scene import Scene, power_on_grid, require_scene, require_velocities
from mishutter.model.velocities import Cells

_STEP_TOLERANCE = 1e-4
"""Share of a step by which equal steps of single precision may differ."""


def ceiling(
    scene: Scene, *, max_half_exposure: ArrayLike | None = None, continuous: bool | None = None
) -> Float[Array, ""]:
    r"""The expected PSNR that no path, no shutter and no linear decoder exceeds; dB.

    $-10\log_{10}$ of the mean over frequencies of $S/(1 + S\,\mathrm{sinc}^2(f)\,q)$, where $S$ is
    the picture's power and $q = 2R\,T\lambda\,/\,(\bar f + \sigma^2/2RT)$ at the longest half
    exposure $T$ (after the wedge bound of Levin et al. 2008; this module derives it). It holds
    for one filter for all speeds (`Metrics.expected_psnr`) and for a decoder that knows the
    speed (`Metrics.known_speed_psnr`), for any path of the sensor whatever its stroke or top
    speed, and does not change when all speeds are shifted, as by a pan.

    The speeds of a scene are a list, and $\lambda$ is the largest eigenvalue of
    $\sqrt{p_i p_j}\,\mathrm{sinc}(2Tf(s_i - s_j))$, which holds for exactly these speeds. It is
    high for few speeds: a path may dwell at each of them, and without a limit on exposure it then
    collects all light, so that there is no ceiling.

    A list in equal steps often stands for speeds that are spread continuously: the range between
    the slowest and the fastest is cut into as many equal cells as there are speeds, and within
    each of them all speeds are equally likely. The largest density $d$ gives
    $T\lambda = \min(T, d/2f)$ (Parseval's theorem), which is finite at every exposure. This
    ceiling is that of the continuous speeds: a design may exceed it on the list alone, by dwelling
    at speeds that are listed, and of few speeds it may be the higher of the two.

    The default is the lower of both for a list of three or more speeds in equal steps, and the
    ceiling of the list for others. `compare` shows the same number, and that of the list where a
    row dwells at its speeds.

    It is the highest of the values on all grids of frequencies that `evaluate` chooses between, so
    that it bounds the averages there, up to rounding.

    Args:
        scene: Speeds, light, noise and picture; concrete.
        max_half_exposure: The longest half exposure, s, above 0; that of the scene's limits by
            default. `inf` is no limit: read noise then does not count.
        continuous: Whether the listed speeds stand for speeds spread continuously; None for the
            lower of both.

    Returns:
        The ceiling, dB. It is `inf` where nothing is lost: for a grey picture, without any noise,
        or for a list without a limit on exposure.

    Raises:
        ValueError: if the scene is no scene or is traced, the exposure is not above 0, or a
            `continuous` list is not of two or more speeds in equal steps.

    Examples:
        >>> from mishutter import Limits, Scene, ceiling
        >>> limits = Limits(max_stroke=20, max_half_exposure=0.02)
        >>> scene = Scene.uniform(max_speed=1500.0, photon_rate=1e5, read_noise=5, limits=limits)
        >>> print(f"{ceiling(scene):.2f} dB")
        31.09 dB
    """
    require_scene(scene)
    require_known("ceiling", scene=scene, max_half_exposure=max_half_exposure)
    longest = scene.limits.max_half_exposure if max_half_exposure is None else max_half_exposure
    require_scalar("ceiling(max_half_exposure=...)", longest)
    positive = np.asarray(longest).dtype.kind in "fiu" and float(np.asarray(longest)) > 0
    require(positive, "ceiling(max_half_exposure=...)", "be above 0 s", longest)
    half = float(np.asarray(longest))
    is_range = continuous
    if continuous is None:  # two speeds alone are those of two objects
        is_range = in_equal_steps(scene) and distinct_speeds(scene, folds=False)[0].size > 2
    bounds: list[Times] = []
    if is_range:
        bounds.append(Times.of_cells(scene))
    if not continuous:
        bounds.append(Times.of_list(scene, half))
    if scene.occlusion is not None:
        errors = [_least_error_of_layers(scene, half, times) for times in bounds]
    else:
        powers = [power_on_grid(scene, count) for count in frequency_counts()]
        errors = [min(_least_error(scene, half, times, x) for x in powers) for times in bounds]
        if is_range:
            errors.append(min(_poured_error(scene, half, n) for n in frequency_counts()))
    with np.errstate(divide="ignore"):
        # Each of the bounds holds, so that the largest of the least errors does.
        return as_float(-10 * np.log10(max(errors)).astype(scene.speeds.dtype))


def water_filled(
    mass: Float[np.ndarray, "m"],  # their sum is 1
    width: Float[np.ndarray, "m"],
    budget: Float[np.ndarray, "*shape"],
    cap: Float[np.ndarray, "*shape"],
) -> Float[np.ndarray, "*shape"]:
    r"""Least mean of $1/(1 + \rho)$ over a density, with $\int\rho\,du$ at most a budget."""
    occurs = mass > 0
    mass, width = mass[occurs], width[occurs]
    root = np.sqrt(mass / width)
    budget, cap = np.broadcast_arrays(np.asarray(budget, float), np.asarray(cap, float))

    def poured(level: np.ndarray) -> np.ndarray:
        return np.clip(root * np.exp(level)[..., None] - 1, 0, cap[..., None])

    # Between these levels the lowest cell is dry, and the highest is at the cap.
    low = np.full(cap.shape, -np.log(np.max(root)))
    high = np.log1p(np.minimum(cap, 1e300)) - np.log(np.min(root))
    for _ in range(45):
        middle = (low + high) / 2
        is_over = poured(middle) @ width > budget
        low, high = np.where(is_over, low, middle), np.where(is_over, middle, high)
    # The higher level has the budget at least, so that it bounds the error.
    return (1 / (1 + poured(high))) @ mass


class Times(NamedTuple):
    r"""Bounds of $f T\lambda(Tf)$, which never fall with the frequency."""

    frequency: Float[np.ndarray, "k"]  # Frequencies, ascending up to 0.5; cycles/px, shape `(k,)`
    bound: Float[np.ndarray, "k"]  # The bound at these; cycles s/px, shape `(k,)`

    @staticmethod
    def of_list(scene: Scene, half: float) -> "Times":
        r"""$f T\lambda(Tf)$ for exactly the speeds of the list."""
        # The lowest frequency is below every grid. Each is 1.006 times the last: the bound of the
        # largest eigenvalue is too high by no more than that, and the ceiling by 0.03 dB.
        knots = np.geomspace(1e-6, NYQUIST_FREQUENCY, 2048)
        if np.isinf(half):
            return Times(knots, np.full(knots.shape, np.inf))
        speeds, weights = (x.astype(np.float64) for x in distinct_speeds(scene, folds=False))
        shares = np.sqrt(weights[:, None] * weights)
        turns = 2 * half * (speeds[:, None] - speeds)
        largest = [np.linalg.eigvalsh(shares * np.sinc(turns * f))[-1] for f in knots]
        return Times(knots, knots * half * np.array(largest))

    @staticmethod
    def of_cells(scene: Scene) -> "Times":
        """Half the largest density of speeds that are spread evenly over equal cells."""
        subject, requirement = "ceiling(scene=...)", "hold two or more speeds in equal steps"
        steps = in_equal_steps(scene)
        require(steps, subject, f"{requirement} where it is `continuous`", scene.speeds)
        speeds, weights = distinct_speeds(scene, folds=False)
        # As many equal cells as speeds cover the range, each with the weight of one speed.
        density = float(np.max(weights)) * speeds.size / float(np.ptp(speeds))
        return Times(np.array([NYQUIST_FREQUENCY]), np.array([density / 2]))

    def at(self, frequency: Float[np.ndarray, "m"]) -> Float[np.ndarray, "m"]:
        """A bound at other frequencies, up to 0.5 cycles/px, which may be higher than the best."""
        # The bound of the next higher frequency holds too, because it never falls.
        return self.bound[np.searchsorted(self.frequency, frequency)]


def _poured_error(scene: Scene, half: float, count: int) -> float:
    """Least expected squared error by 5., of speeds that fill equal cells unevenly; else 0."""
    light = Light.of(scene)
    is_noisy = float(light.read) > 0 or float(light.mean) > 0
    if float(light.rate) == 0 or np.isinf(half) or not is_noisy:
        return 0.0
    cells = _uneven_cells(scene)
    if cells is None:
        return 0.0
    reach = np.ptp(distinct_speeds(scene, folds=False)[0].astype(np.float64)) / 2
    return _poured(Fan.of_axis(scene, count), light, np.array([2 * half]), cells, reach)


def _uneven_cells(scene: Scene) -> Cells | None:
    """The equal cells that the speeds of a scene of one axis stand for, where weights differ."""
    _, weights = (x.astype(np.float64) for x in distinct_speeds(scene, folds=False))
    if np.ptp(weights) <= _STEP_TOLERANCE * np.max(weights):
        return None
    return Cells(np.full(weights.size, 2 / weights.size), weights / weights.sum())


def exposures_ceiling(
    scene: Scene, exposures: Float[np.ndarray, "n"], *, grid: Grid = MEASURED
) -> float:
    r"""PSNR that no path of a sensor exceeds over several exposures, registered; dB.

    By Parseval's theorem $\int|K_k|^2\,dq = D_k/|\mathbf f|$ over the components of velocities,
    and $|K_k| \le D_k$: at each frequency the signal over the noise has a budget and a cap, and
    the least error pours it like water, as in 5. for one exposure along an axis.

    Args:
        scene: Velocities in any direction, light and noise. A list of velocities has the cap alone,
            as a path may dwell at each, and so has a background at rest.
        exposures: Length of each exposure; s.
        grid: Sizes of the fan of directions.
    """
    require_scene(scene, in_plane=True)
    law, fan = require_velocities(scene), Fan.of(scene, grid)
    direction = np.asarray(fan.direction)
    reach = law.half_range(direction.ravel()).reshape(direction.shape)
    error = _poured(fan, Light.of(scene), exposures, law.cells(128), reach)
    if scene.occlusion is not None:
        share = float(scene.occlusion.front_share)
        error = share * error + (1 - share) * _poured(fan, Light.of(scene), exposures, None, 0.0)
    return psnr_of_error(error)


def _poured(
    fan: Fan,
    light: Light,
    exposures: Float[np.ndarray, "n"],
    cells: Cells | None,  # of the components of velocities along a direction
    reach: Float[np.ndarray, "i j"] | float,  # half of their range; px/s
) -> float:
    """Least squared error over exposures by a budget and a cap, or by the cap alone."""
    exposures = np.asarray(exposures, np.float64)
    gains, signal = light.gains(exposures), light.signal(fan)
    cap = signal * np.sum(gains)
    lost = 1 / (1 + cap)
    if cells is not None:
        each = np.divide(gains, exposures, where=exposures > 0, out=np.zeros_like(gains))
        budget = signal * np.sum(each)
        budget = budget / np.maximum(fan.radius[:, None] * reach, np.finfo(float).tiny)
        lost = water_filled(cells.mass, cells.width, np.minimum(budget, 2 * cap), cap)
    return float(light.deviation**2 * np.sum(fan.weight * lost))


def _least_error(scene: Scene, half: float, times: Times, every: Float[np.ndarray, "m"]) -> float:
    r"""Least expected squared error of pictures of a power at all `frequencies`, white = 1."""
    frequency, power = frequencies(every.size)[every > 0], every[every > 0]
    rate, read_noise, mean_level = (
        np.float64(x) for x in (scene.photon_rate, scene.read_noise, scene.picture.mean_level)
    )
    if not power.size:
        return 0.0
    if rate == 0:
        return float(np.sum(power) / every.size)
    time = np.minimum(half, times.at(frequency) / frequency)
    with np.errstate(divide="ignore", over="ignore"):
        signal = 2 * rate * time / (mean_level + read_noise * (read_noise / (2 * rate * half)))
        aperture = np.asarray(pixel_response(frequency, float(scene.optics.lens_blur))) ** 2
        share = 1 / (1 + power * aperture * signal)
    return float(np.sum(power * share) / every.size)


def _least_error_of_layers(scene: Scene, half: float, of_objects: Times) -> float:
    r"""Least expected squared error of objects before a background.

    The largest eigenvalue of a sum is at most the sum of the largest eigenvalues of its parts: that
    of the objects and of a background that moves as they do; that of a still background, with which
    any camera keeps up; and that of the beat at its effective speeds. The parts are uncorrelated,
    so that the error is also at least that of the rest where a still background, or that and the
    beat, are recorded without any error.
    """
    if np.isinf(half):
        return 0.0
    scene = Background.of(scene).behind(scene, num_effective_speeds=65)
    occlusion: Occlusion = scene.occlusion  # type: ignore[assignment]
    shares = jax.tree.map(lambda x: np.asarray(x, np.float64), occlusion.shares)
    frequency, weights = frequencies(NUM_FREQUENCIES), np.asarray(scene.weights, np.float64)
    beat = np.einsum("b,n,bnkf->fk", shares.background_weights, weights, shares.beat)
    turns = 2 * half * (shares.speeds[:, None] - shares.speeds)
    largest = [
        _largest(share, np.sinc(turns * f)) for share, f in zip(beat, frequency, strict=True)
    ]
    own = np.minimum(of_objects.at(frequency), half * frequency)
    is_still = occlusion.background == "still"
    still = shares.background * is_still
    # The beat at equal speeds moves as both layers do.
    other = 1 - still - np.sum(beat, axis=1)
    moving = other * own + half * frequency * np.array(largest)
    with np.errstate(divide="ignore", invalid="ignore"):
        alone = np.where(still < 1, moving / (1 - still), 0)
    # The error is at least that of the whole, of all but the still background, and of all but this
    # and the beat.
    parts = (
        (shares.power, moving + still * half * frequency),
        (shares.power * (1 - still), alone),
        (shares.power * other, own),
    )
    return max(_least_error(scene, half, Times(frequency, bound), power) for power, bound in parts)


def _largest(shares: Float[np.ndarray, "k"], gram: Float[np.ndarray, "k k"]) -> float:
    """Largest eigenvalue of a Gram matrix with weights, some of which may be below 0."""
    if not shares.size:
        return 0.0
    # This symmetric product has the same eigenvalues. The usual one takes roots of the shares,
    # which interpolation may have taken below 0.
    factor = np.linalg.cholesky(gram + 1e-12 * np.eye(shares.size))  # keeps it regular
    return float(np.linalg.eigvalsh(factor.T @ (shares[:, None] * factor))[-1])


def in_equal_steps(scene: Scene) -> bool:
    """Whether two or more speeds occur, in equal steps, as those that stand for a range."""
    speeds = np.sort(distinct_speeds(scene, folds=False)[0].astype(np.float64))
    width = speeds[-1] - speeds[0]
    steps = np.diff(speeds) * (speeds.size - 1)
    return bool(width > 0) and np.allclose(steps, width, rtol=_STEP_TOLERANCE, atol=0)
