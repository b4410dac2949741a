r"""The speed of a picture that moves as a whole, estimated from one capture of it.

Two kinds of evidence tell the speed. The ripple of $|H_s(f)|^2$ shows in the power spectrum of the
capture; and only the phase of the right $H_s$, once it is undone, leaves edges that are few and
high, with flat areas between them (Wiggins 1978, minimum entropy deconvolution). Either kind alone
is wrong in too many captures.
"""

import itertools
import json
from collections.abc import Callable
from functools import lru_cache
from importlib import resources
from typing import NamedTuple

import numpy as np
import scipy.fft
from jaxtyping import ArrayLike, Bool, Complex, Float
from scipy.special import chdtri, digamma, polygamma

from mishutter._core.checks import Unquoted, is_concrete, require, shape_of
from mishutter._core.parallel import alone_in_blas, in_threads, num_processors
from mishutter.camera.capture import as_pixels, distinct_colours
from mishutter.camera.rows import irfftn, rfftn, rows_last
from mishutter.decoding.decoders.base import BlurModel, blur_model
from mishutter.decoding.decoders.linear import LEAST_POWER
from mishutter.evaluation.found_speed import LEAST_DIFFERENCE
from mishutter.model.motion import AbstractMotion
from mishutter.model.scene import Scene, require_scene, require_whole
from mishutter.model.shutters.base import AbstractShutter
from mishutter.pictures.images import LUMINANCE, transposed

_fast_length: Callable[[int], int] = scipy.fft.next_fast_len  # type: ignore[assignment]
_TAPER = 0.25
"""Share of a row in which the window rises and falls."""
_MOST_ROWS = 512
"""Most rows of a tile."""
_MOST_BANDS, _LEAST_ROWS = 4, 64
"""Most bands of rows whose speeds are compared, and the fewest rows of a band."""
_FREEDOM = 4.0
"""Degrees of freedom of Student's t: a photograph's spectrum has lines that no smooth one has."""
_OCTAVES = ((0.008, 0.018), (0.018, 0.04), (0.04, 0.09), (0.09, 0.2))
"""Bands along the rows in which edges count; cycles/px."""
LITTLE = "The picture has too little detail to show its speed."
BEYOND = "The speed may lie beyond those of the scene."
_LOWEST = 2
"""Number of DFT frequencies left out at either end, where the window leaks."""


class Prior(NamedTuple):
    """Statistics of photographs, fitted by `python -m benchmarks.speed fit`."""

    # Mean of the coefficients of a smooth logarithm of a power spectrum
    mean: Float[np.ndarray, "11"]
    precision: Float[np.ndarray, "11 11"]  # Inverse of their covariance
    misfit: float  # Variance of the logarithm about a smooth spectrum
    spectrum_weight: float  # Weight of the evidence from the spectrum
    phase_weight: float  # Weight of the evidence from the edges
    trust: float  # Least probability near the mode at which a speed is trusted
    # Width of error bars, in units of the posterior's width near its mode: the two weights suit
    # gross errors, and are too low for fine ones
    width: float


@lru_cache
def prior() -> Prior:
    """The prior of photographs that the package ships."""
    text = (resources.files("mishutter.decoding.decoders") / "speed_prior.json").read_text("utf-8")
    numbers = json.loads(text)
    covariance = np.array(numbers["covariance"])
    others = (numbers[name] for name in Prior._fields[2:])
    return Prior(np.array(numbers["mean"]), np.linalg.inv(covariance), *others)


class Energies(NamedTuple):
    r"""Negative logarithm of the evidence for each speed, by kind of evidence."""

    spectrum: Float[np.ndarray, "s"]  # Energy from the power spectrum
    phase: Float[np.ndarray, "o s"]  # Mean of $\log(1 + u^2)$, by octave
    counts: Float[np.ndarray, "o"]  # Number of waves of each octave
    distance: float  # Squared Mahalanobis distance of the picture's spectrum from the prior's mean


def _flat_window(count: int) -> Float[np.ndarray, "{count}"]:
    """A window that is flat except near the ends."""
    from_end = np.minimum(np.arange(count) + 0.5, count - np.arange(count) - 0.5) / count
    return np.sin(np.pi / 2 * np.minimum(2 * from_end / _TAPER, 1)) ** 2


class Bands(NamedTuple):
    """Frequencies at which the logarithm of a power spectrum is evaluated."""

    members: list[np.ndarray]  # Indices of the DFT down the rows, by band of their frequency
    counts: Float[np.ndarray, "b 1"]  # Independent frequencies that each band is worth
    along: slice  # Indices of the DFT along the rows
    terms: Float[np.ndarray, "b*k 11"]  # Terms of the smooth spectrum at every frequency


@lru_cache(maxsize=4)
def bands(rows: int, columns: int) -> Bands:
    """The bands of a tile of this shape."""
    down = np.abs(np.fft.fftfreq(rows))
    edges = [-1.0, 0.6 / rows, 2.5 / rows]
    if rows > 12:
        edges += np.geomspace(4.5 / rows, 0.5001, 10).tolist()
    edges[-1] = 0.5001
    pairs = itertools.pairwise(edges)
    members = [np.flatnonzero((down > low) & (down <= high)) for low, high in pairs]
    members = [band for band in members if band.size]
    # Under a sine window powers at neighbouring frequencies of a DFT correlate by a quarter.
    neighbours = [np.isin((band + 1) % rows, band).sum() for band in members]
    each = zip(members, neighbours, strict=True)
    counts = np.array([[band.size**2 / (band.size + pairs / 2)] for band, pairs in each])
    along = slice(_LOWEST, columns // 2 + 1 - _LOWEST)
    fx = np.fft.rfftfreq(columns)[along]
    fy = np.array([down[band].mean() for band in members])[:, None]
    radial = (np.log(np.hypot(fx, fy) + 0.003) + 2) / 2
    row, column = np.log(fx), (np.log(fy + 0.003) + 2.5) / 2
    row = 2 * (row - np.log(0.004)) / np.log(0.5 / 0.004) - 1
    legendre = np.polynomial.legendre.Legendre.basis
    each = [radial**0, radial, radial**2, *(legendre(n)(row) for n in range(1, 6))]
    each += [column, column**2, row * column]
    shape = np.broadcast_shapes(fx.shape, fy.shape)
    terms = np.stack([np.broadcast_to(term, shape).ravel() for term in each], axis=1)
    return Bands(members, counts, along, terms.astype(np.float32))


def log_power(tile: Float[np.ndarray, "rows columns"]) -> Float[np.ndarray, "b k"]:
    """Unbiased logarithm of the power of a tile, by band and along the rows."""
    rows, columns = tile.shape
    layout, down = bands(rows, columns), np.sin(np.pi * (np.arange(rows) + 0.5) / rows)
    window = (down[:, None] * _flat_window(columns)).astype(tile.dtype)
    deviation = tile - np.sum(tile * window) / np.sum(window)
    spectrum = rfftn(deviation * window)[:, layout.along]
    power = np.abs(spectrum) ** 2 / np.sum(window**2)
    mean = np.stack([power[band].mean(axis=0) for band in layout.members])
    # Powers at single frequencies are exponentially distributed, which makes the logarithm of the
    # mean of so many too low by this, to 0.01.
    bias = digamma(layout.counts) - np.log(layout.counts)
    return np.log(mean.astype(np.float64) + 1e-30) - bias


def _power_through_window(
    responses: Complex[np.ndarray, "s k"], columns: int
) -> Float[np.ndarray, "s k"]:
    """Power of each response, as the spectrum of a windowed row shows it."""
    leak = np.abs(np.fft.fft(_flat_window(columns))) ** 2
    # The window moves power to few neighbours: six to either side have nearly all of it.
    leak = np.concatenate([leak[-6:], leak[:7]])
    power = np.abs(responses) ** 2
    power = np.concatenate([power[:, 6:0:-1], power, power[:, -2:-8:-1]], axis=1)
    return np.stack([np.convolve(row, leak / leak.sum(), "valid") for row in power])


class Blurs(NamedTuple):
    """Blurs of the speeds in rows of one width."""

    power: Float[np.ndarray, "s k"]  # $|H_s|^2$, as the spectrum of a windowed row shows it
    phases: Complex[np.ndarray, "s k"]  # Factors that undo the phase of $H_s$

    @staticmethod
    def of(responses: Complex[np.ndarray, "s k"], columns: int) -> "Blurs":
        """Blurs from their responses."""
        phases = np.conj(responses) / (np.abs(responses) + 1e-9)
        return Blurs(_power_through_window(responses, columns), phases.astype(np.complex64))


def _spectrum_energy(
    observed: Float[np.ndarray, "b k"],
    blur_power: Float[np.ndarray, "s k"],
    noise: float,
    layout: Bands,
    statistics: Prior,
) -> tuple[Float[np.ndarray, "s"], Float[np.ndarray, "s 11"]]:
    r"""Energy of each speed from the power spectrum, by Laplace; and the likeliest coefficients.

    The model of the $\log$ power is $\log(S |H_s|^2 + N)$, with $\log S$ linear in coefficients
    whose prior is Gaussian. Gauss-Newton steps, weighted for Student's t, find the coefficients.
    """
    terms, num = layout.terms, len(statistics.mean)
    upper = np.triu_indices(num)
    pairs = terms[:, upper[0]] * terms[:, upper[1]]
    # The logarithm of a mean of so many exponential powers has this variance.
    scatter = polygamma(1, layout.counts).astype(terms.dtype)
    target, power = observed.astype(terms.dtype), blur_power.astype(terms.dtype)[:, None]
    misfit, freedom = terms.dtype.type(statistics.misfit), terms.dtype.type(_FREEDOM)

    def fit(coefficients: np.ndarray, power: np.ndarray) -> tuple[np.ndarray, ...]:
        """Energies, curvatures and gradients at some coefficients."""
        # On the way to a minimum coefficients may be such that single precision overflows.
        smooth = np.clip(coefficients.astype(terms.dtype) @ terms.T, -25, 15)
        signal = np.exp(smooth).reshape(-1, *target.shape) * power
        total = signal + terms.dtype.type(noise)
        share = signal / total
        residual = (target - np.log(total)).reshape(len(coefficients), -1)
        variance = (scatter + share**2 * misfit).reshape(residual.shape)
        share = share.reshape(residual.shape)
        ratio = residual**2 / (freedom * variance)
        weight = (1 + 1 / freedom) / (1 + ratio) / variance * share
        curvature = np.empty((len(coefficients), num, num))
        curvature[:, upper[0], upper[1]] = (weight * share) @ pairs
        curvature[:, upper[1], upper[0]] = curvature[:, upper[0], upper[1]]
        losses = (freedom + 1) / 2 * np.log1p(ratio) + np.log(variance) / 2
        energy = losses.sum(axis=1, dtype=np.float64)
        return energy, curvature + statistics.precision, (weight * residual) @ terms

    def stepped(coefficients: np.ndarray, power: np.ndarray, count: int) -> np.ndarray:
        for _ in range(count):
            _, curvature, gradient = fit(coefficients, power)
            gradient = gradient - (coefficients - statistics.mean) @ statistics.precision
            step = np.linalg.solve(curvature, gradient[..., None])[..., 0]
            # Far from the minimum the curvature says too little, and a whole step would overshoot.
            coefficients = coefficients + np.clip(step, -1.5, 1.5)
        return coefficients

    # The likeliest spectrum for all speeds together comes first, from there that for each speed.
    first = stepped(statistics.mean[None], power.mean(axis=0, keepdims=True), 12)
    coefficients = stepped(np.repeat(first, len(power), axis=0), power, 4)
    energy, curvature, _ = fit(coefficients, power)
    deviation = coefficients - statistics.mean
    energy += np.einsum("si,ij,sj->s", deviation, statistics.precision, deviation) / 2
    # Laplace's approximation integrates over the coefficients: a speed that a wide range of spectra
    # explains is likelier.
    return energy + np.linalg.slogdet(curvature)[1] / 2, coefficients


def _phase_energy(
    tile: Float[np.ndarray, "rows columns"],
    phases: Complex[np.ndarray, "s k"],
    amplitude: Float[np.ndarray, "rows k"],
) -> tuple[Float[np.ndarray, "o s"], Float[np.ndarray, "o"]]:
    r"""Mean of $\log(1 + u^2)$ by octave and speed, and the number of waves of each octave.

    $u$ is the tile with the phase of $H_s$ undone, scaled to unit variance; its amplitudes are the
    same for all speeds.
    """
    rows, columns = tile.shape
    taper = np.outer(_flat_window(rows), _flat_window(columns)).astype(tile.dtype)
    deviation = tile - np.sum(tile * taper) / np.sum(taper)
    spectrum = rfftn(deviation * taper) * amplitude
    octave = np.log2(np.maximum(np.fft.rfftfreq(columns), 1e-6))
    energy, counts = np.empty((len(_OCTAVES), len(phases))), np.empty(len(_OCTAVES))
    for index, (low, high) in enumerate(_OCTAVES):
        # A sharp cut would ring about every edge.
        mask = 1 / (1 + np.exp(-8 * (octave - np.log2(low))))
        mask /= 1 + np.exp(8 * (octave - np.log2(high)))
        mask[0] = 0
        # A coarse grid is enough for low octaves, and cheap.
        num_waves = min(octave.size, 1 + _fast_length(max(32, int(2 * high * columns))))
        lines = min(rows, 2 * _fast_length(max(32, int(3 * high * rows))))
        part = spectrum[:, :num_waves] * mask[:num_waves].astype(tile.dtype)
        if lines < rows:
            part = np.concatenate([part[: lines // 2], part[-(lines // 2) :]])
        power = np.abs(part) ** 2
        # Their mean varies as that of so many equally strong waves.
        counts[index] = power.sum() ** 2 / max((power**2).sum(), 1e-300)
        for place, phase in enumerate(phases[:, :num_waves]):
            square = irfftn(part * phase) ** 2
            energy[index, place] = np.log1p(square / max(square.mean(), 1e-300)).mean()
    return energy, counts


def energies(
    tile: Float[np.ndarray, "rows columns"], blurs: Blurs, noise: float, statistics: Prior
) -> Energies:
    """Energies of each speed, from one tile in single precision."""
    rows, columns = tile.shape
    layout = bands(rows, columns)
    power = blurs.power[:, layout.along]
    observed = log_power(tile)
    spectrum, coefficients = _spectrum_energy(observed, power, noise, layout, statistics)
    likeliest = coefficients[np.argmin(spectrum)]
    smooth = np.exp(np.clip(layout.terms @ likeliest, -25, 15)).reshape(observed.shape)
    # One amplitude for all speeds: amplitudes of their own pick the speed worse.
    smooth = smooth * power.mean(axis=0)
    amplitude = np.zeros((rows, columns // 2 + 1), tile.dtype)
    for line, band in zip(np.sqrt(smooth) / (smooth + noise), layout.members, strict=True):
        amplitude[band, layout.along] = line
        amplitude[band, 1] = line[0]
    deviation = likeliest - statistics.mean
    distance = float(deviation @ statistics.precision @ deviation)
    return Energies(spectrum, *_phase_energy(tile, blurs.phases, amplitude), distance)


class Posterior(NamedTuple):
    """Probabilities of speeds, given a capture."""

    speeds: Float[np.ndarray, "s"]  # Speeds relative to the sensor that were tried, ascending; px/s
    weights: Float[np.ndarray, "s"]  # Their probabilities
    reach: float  # Distance from the mode within which a speed counts as the same; px/s
    width: float  # The `width` of `Prior`

    @property
    def mode(self) -> int:
        """Index of the likeliest speed."""
        return int(np.argmax(self.weights))

    @property
    def near(self) -> Bool[np.ndarray, "s"]:
        """Whether each speed counts as the mode."""
        return np.abs(self.speeds - self.speeds[self.mode]) <= self.reach * (1 + 1e-9)

    @property
    def speed(self) -> float:
        """Mean of the speeds near the mode; px/s."""
        share = self.weights * self.near
        return float(share @ self.speeds / share.sum())

    @property
    def error(self) -> float:
        r"""Root of $\sum p\,d^2$; px/s.

        $d$ is the distance from `speed`, times `width` for speeds near the mode. The error is at
        least that of rounding to the steps.
        """
        distance = (self.speeds - self.speed) * np.where(self.near, self.width, 1.0)
        # A speed anywhere within a step has this standard deviation.
        rounding = self.width * np.diff(self.speeds[:2]).sum() / np.sqrt(12)
        return max(float(np.sqrt(self.weights @ distance**2)), float(rounding))

    @property
    def at_end(self) -> bool:
        """Whether the mode is at an end of the range beyond which the speed may lie; 0 is none."""
        first = self.mode < 2 and float(self.speeds[0]) != 0
        return self.speeds.size > 1 and (first or self.mode >= self.speeds.size - 2)

    def around(self, speed: float) -> float:
        """Probability of the speeds within twice the `reach` of a speed."""
        return float(self.weights @ (np.abs(self.speeds - speed) <= 2 * self.reach))

    def trusted(self, share: float) -> bool:
        """Whether at least a share of the probability is near a mode that is at no end."""
        return bool(self.weights @ self.near >= share) and not self.at_end


def speeds_to_try(model: BlurModel) -> tuple[Float[np.ndarray, "s"], float]:
    """Speeds relative to the sensor at equal steps, and the least difference that counts; px/s.

    They cover the range of the model's speeds, and a tenth of it more at either end. Where both
    signs of a speed have blurs more alike than two speeds one step apart, only speeds from 0 up
    are tried.
    """
    occurs = model.speeds[model.weights > 0]
    low, high = float(np.min(occurs)), float(np.max(occurs))
    beyond = 0.1 * (high - low)
    if beyond == 0:
        return occurs[:1], np.inf
    low, high = low - beyond, high + beyond
    reach = 2 / float(2 * model.motion.half_exposure)  # by which the smear differs by 2 px
    fastest = max(abs(low), abs(high))
    probes = np.array([0.7 * fastest, -0.7 * fastest, 0.7 * fastest + reach])
    response, opposite, neighbour = model.responses_at(probes, _MOST_ROWS)
    if _likeness(opposite, response) > _likeness(neighbour, response):
        low, high = max(low, -high, 0.0), fastest
    count = int(np.clip(np.ceil((high - low) / reach), 32, 512))
    speeds = np.linspace(low, high, count + 1)
    return speeds, max(reach, float(speeds[1] - speeds[0]))


def _likeness(one: np.ndarray, other: np.ndarray) -> float:
    """Highest normalised correlation of two blurs over all shifts; at most 1."""
    across, first, second = (
        np.max(np.fft.irfft(a * np.conj(b))) for a, b in ((one, other), (one, one), (other, other))
    )
    return float(across / np.sqrt(first * second))


def posterior_of(
    parts: list[Energies], speeds: Float[np.ndarray, "s"], reach: float, statistics: Prior
) -> Posterior:
    """The posterior from the evidence of tiles of one picture."""
    energy = statistics.spectrum_weight * np.mean([part.spectrum for part in parts], axis=0)
    waves = np.sqrt(np.sum([part.counts for part in parts], axis=0))
    phase = np.mean([part.phase for part in parts], axis=0)
    energy = energy + statistics.phase_weight * waves @ phase
    weights = np.exp(np.min(energy) - energy)
    return Posterior(speeds, weights / weights.sum(), reach, statistics.width)


class SpeedEstimate(NamedTuple):
    """The speed of a whole picture, estimated from one capture of it.

    Attributes:
        speed: The speed; px/s. Where both signs relative to the sensor have the same blur, the
            sign is that in which the scene's speeds go further; where the capture tells nothing,
            this is the mean of the speeds that were tried.
        error: Standard error of the speed; px/s.
        trusted: Whether a decoder should restore for this speed alone.
        speeds: Speeds that were tried, ascending; px/s.
        weights: Their probabilities.
        doubt: A sentence that says why the speed is not trusted; empty if it is.
        second_speed: Speed at which a band of rows seems to move instead, px/s; None if all rows
            seem to move at `speed`.
        is_unusual: Whether fewer than one in a hundred pictures of the prior would have a spectrum
            as far from its mean; the evidence is then worth less.
        misfit: Of the frames of a sequence, mean square of what the restored picture leaves of
            them over their noise: about 1 where they fit one picture at one speed. None of a single
            capture, which any speed fits.
    """

    speed: float
    error: float
    trusted: bool
    speeds: Float[np.ndarray, "s"]
    weights: Float[np.ndarray, "s"]
    doubt: str
    second_speed: float | None = None
    is_unusual: bool = False
    misfit: float | None = None

    @property
    def tells_nothing(self) -> bool:
        """Whether the capture leaves several speeds, all equally likely."""
        return self.speeds.size > 1 and bool(np.ptp(self.weights) == 0)

    def of(self, scene: Scene, motion: AbstractMotion) -> "SpeedEstimate":
        """Converts an estimate relative to a sensor that pans into the frame of a scene.

        Args:
            scene: The scene.
            motion: Motion of the sensor.
        """
        require_scene(scene)
        pan, expected = float(motion.velocity), np.asarray(scene.speeds, np.float64)
        is_mirrored = self.speeds[0] >= 0 and pan - np.min(expected) > np.max(expected) - pan
        sign, order = (-1.0, slice(None, None, -1)) if is_mirrored else (1.0, slice(None))
        speed, speeds = pan + sign * self.speed, (pan + sign * self.speeds)[order]
        estimate = self._replace(speed=speed, speeds=speeds, weights=self.weights[order])
        if self.second_speed is None:
            return estimate
        second = pan + sign * self.second_speed
        return estimate._replace(second_speed=second, doubt=_doubt_of_two(second, speed))


def _doubt_of_two(second: float, speed: float) -> str:
    """The doubt of a picture some of whose rows have a second speed; px/s."""
    return (
        f"Some rows seem to move at {second:,.0f} px/s, where all rows together do at {speed:,.0f}."
    )


@alone_in_blas()
def estimate_speed(
    capture: ArrayLike, scene: Scene, motion: AbstractMotion, shutter: AbstractShutter
) -> SpeedEstimate:
    r"""Find the one speed of a picture that moves as a whole, in one capture of it.

    The posterior is $p(s) \propto \exp(-\beta A(s) - \gamma \sum_o \sqrt{n_o} B_o(s))$ over
    the scene's range of speeds. $A$ is the evidence of the power spectrum, $S |H_s|^2 + N$ with a
    smooth $S$ that has a prior, under Student's t. $B_o$ is the mean of $\log(1 + u^2)$ in an
    octave of $n_o$ waves, $u$ being the capture with the phase of $H_s$ undone: the right phase
    makes few edges. The prior and both weights are fitted to photographs.

    Args:
        capture: Irradiance in units of a fully open exposure, as `simulate_capture` gives it;
            shape `(rows, columns)` or `(rows, columns, channels)`; concrete.
        scene: Speeds that may occur, light, noise, lens and device; concrete.
        motion: Motion of the sensor; concrete.
        shutter: Transmittance over the exposure; concrete.

    Returns:
        The speed, its error and any doubt; see `SpeedEstimate`.

    Raises:
        ValueError: if the capture is traced, not finite or not a picture; if the scene has no light
            or the shutter lets none through; or if the scene has a background, as no single speed
            is then the picture's.

    Examples:
        >>> import jax
        >>> from mishutter import ParabolicMotion, RectShutter, Scene, estimate_speed
        >>> from mishutter import example_picture, simulate_capture
        >>> scene = Scene.uniform(max_speed=1500.0, photon_rate=1e5, read_noise=5)
        >>> motion = ParabolicMotion(acceleration=2e5, half_exposure=0.01)
        >>> picture = example_picture()
        >>> captured = simulate_capture(
        ...     picture, scene, motion, RectShutter(), speed=700.0, key=jax.random.key(0)
        ... )
        >>> found = estimate_speed(captured, scene, motion, RectShutter())
        >>> print(f"{found.speed:.1e} px/s", found.trusted)
        7.1e+02 px/s True
    """
    require_scene(scene)
    subject = "estimate_speed(capture=...)"
    irradiance = transposed(as_pixels(capture, subject), scene.sensor.axis)
    require(np.ndim(irradiance) <= 3, subject, "be one picture", shape_of(irradiance))
    model = blur_model(scene, motion, shutter)
    has_light = model.electrons > 0 and model.efficiency > 0
    require(has_light, "estimate_speed(scene=...)", "let light through the shutter", 0.0)
    planes = rows_last(distinct_colours(irradiance))
    return speed_in(planes, model).of(scene, motion)


def speed_in(planes: ArrayLike, model: BlurModel) -> SpeedEstimate:
    """The speed of one picture, relative to the sensor."""
    require_whole(model.layers, "the speed to be found")
    concrete, got = is_concrete(planes), Unquoted("a tracer")
    require(concrete, "estimate_speed(capture=...)", "be known, not traced", got)
    irradiance, noise = luminance(np.asarray(planes), model)
    statistics = prior()
    speeds, reach = speeds_to_try(model)
    difference = model.smear_difference
    is_short = difference <= LEAST_DIFFERENCE
    is_narrow = irradiance.shape[1] < max(64, model.num_taps)
    if speeds.size == 1 or is_short or is_narrow or not np.ptp(irradiance) > 0:
        flat = np.full(speeds.size, 1 / speeds.size)
        posterior = Posterior(speeds, flat, np.inf, 1.0)
        doubt = "" if speeds.size == 1 else LITTLE
        if doubt and is_short:
            doubt = (
                f"The blur differs by only {difference:.1f} px over the speeds of the scene, which "
                "cannot be told from a soft photograph: finding a speed takes "
                f"{LEAST_DIFFERENCE:g} px or more."
            )
        return SpeedEstimate(posterior.speed, posterior.error, not doubt, speeds, flat, doubt)
    parts = parts_of(irradiance, model, speeds, noise, statistics)
    return judged(parts, speeds, reach, statistics)[0]


def judged(
    parts: list[list[Energies]], speeds: Float[np.ndarray, "s"], reach: float, statistics: Prior
) -> tuple[SpeedEstimate, Posterior]:
    """The estimate by the bands of a picture, all together and each by itself, and by all alone."""
    all_parts = [part for band in parts for part in band]
    whole = posterior_of(all_parts, speeds, reach, statistics)
    each = [posterior_of(band, speeds, reach, statistics) for band in parts]
    weights, doubt, second = whole.weights, "", None
    is_sure = whole.trusted(statistics.trust)
    if whole.at_end:
        doubt = BEYOND
    elif not is_sure:
        doubt = LITTLE
    denials = [p for p in each if p.around(whole.speed) < 0.01]
    denials = [p for p in denials if is_sure or p.trusted(statistics.trust)]
    if denials:
        second = min(denials, key=lambda p: p.around(whole.speed)).speed
        doubt = _doubt_of_two(second, whole.speed)
        # The disagreement is as likely a false alarm as a second speed.
        weights = (whole.weights + np.mean([p.weights for p in each], axis=0)) / 2
    # One in a hundred of the prior's pictures, those farthest from its mean, are unusual.
    furthest = chdtri(len(statistics.mean), 0.01)
    is_unusual = bool(np.mean([part.distance for part in all_parts]) > furthest)
    estimate = SpeedEstimate(
        speed=whole.speed,
        error=whole.error,
        trusted=not doubt,
        speeds=speeds,
        weights=weights,
        doubt=doubt,
        second_speed=second,
        is_unusual=is_unusual,
    )
    return estimate, whole


def luminance_shares(count: int) -> Float[np.ndarray, "{count}"]:
    """Weights of so many colours in the luminance: those of red, green and blue, or equal ones."""
    return np.array(LUMINANCE) if count == len(LUMINANCE) else np.full(count, 1 / count)


def luminance(
    planes: Float[np.ndarray, "*colours rows columns"], model: BlurModel
) -> tuple[Float[np.ndarray, "rows columns"], float]:
    """Luminance of the planes of a picture, and the variance of its noise."""
    planes = planes.reshape(-1, *planes.shape[-2:])
    share = luminance_shares(len(planes))
    levels = np.maximum(planes.mean(axis=(1, 2), dtype=np.float64), 0)
    noise = share**2 @ (levels / model.electrons + model.read_variance)
    irradiance = np.tensordot(share.astype(np.float32), planes.astype(np.float32), 1)
    # A camera without noise has no logarithm of 0 either.
    return irradiance, max(float(noise), LEAST_POWER)


def parts_of(
    irradiance: Float[np.ndarray, "rows columns"],
    model: BlurModel,
    speeds: Float[np.ndarray, "s"],
    noise: float,
    statistics: Prior,
) -> list[list[Energies]]:
    """The evidence of tiles of about equal size, by bands of rows from top to bottom.

    There are at least two bands where the picture is high enough for that, so that a part of the
    picture at another speed shows in one of them.
    """
    rows, columns = irradiance.shape
    count = max(-(-rows // _MOST_ROWS), min(_MOST_BANDS, rows // _LEAST_ROWS))
    across = -(-columns // max(1024, 4 * model.num_taps))
    parts = [np.array_split(band, across, axis=1) for band in np.array_split(irradiance, count)]
    tiles = [(i, tile) for i, band in enumerate(parts) for tile in band]
    widths = {tile.shape[1] for _, tile in tiles}
    blurs = {width: Blurs.of(model.responses_at(speeds, width), width) for width in widths}

    def evidence(place: tuple[int, np.ndarray]) -> tuple[int, Energies]:
        index, tile = place
        return index, energies(tile, blurs[tile.shape[1]], noise, statistics)

    pieces = list(in_threads(evidence, tiles, num_processors()))
    return [[e for i, e in pieces if i == index] for index in range(count)]
