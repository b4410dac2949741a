r"""The likeliest picture of frames, and how well it explains them.

Frame $k$ is $g_k = M(A_k f) + \text{noise}$ of variance $N_k$: the picture $f$ through the response
$A_k$ of the frame, displacement included, as far as the sensor reaches, which is $M$. The picture
goes on beyond the sensor, and what lies there is as unknown as the rest. Of pictures of the power
$S$ the likeliest is the minimum of

$$\sum_k |g_k - M A_k f|^2 / N_k + \sum |\hat f|^2/S ,$$

which conjugate gradients find. It says what each frame would have recorded beyond its borders, and
so completes the frames: all that they tell is then $\sum_k \bar A_k \hat g_k / N_k$.

The same minimum, and the volume of the Gaussian around it, is the likelihood of a motion. Frames of
a wrong model have a likeliest motion too, so that one is trusted only where the frames fit: what
the picture leaves of frame $k$ has the expected square
$1 - \frac{S|A_k|^2/N_k}{1 + S\sum_j |A_j|^2/N_j}$ at each frequency, over the noise, with the sums
over the frames that see the same part of the picture.

In the plane the DFT is over the last two axes. Along one axis it is over the last one, and rows are
pictures of their own. Arrays have the frames first, then any motions and rows.
"""

import itertools
import math
import operator
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import partial, reduce
from typing import NamedTuple

import numpy as np
import scipy.linalg
from jaxtyping import Complex, Float, Int

from mishutter._core.checks import RowLike, require
from mishutter.camera.responses import frequencies_on
from mishutter.camera.rows import counted_in, irfftn, pixels_through, rfftn
from mishutter.decoding.decoders.base import density_of
from mishutter.decoding.decoders.linear import mean_over_dft
from mishutter.model.scene import Scene
from mishutter.model.sensor import noise_of_frames, white_electrons

TOLERANCE = 1e-3
"""Residual at which conjugate gradients end, as a share of the first one: the misfit of frames is
within 1 % of its limit. A picture may be far from its own, in waves that frames hardly record."""
SETTLED = 0.05
"""Squared change of a picture on the sensor as steps double, as a share of its expected squared
error, at which it ends as well: less than that is left, and the level is within 0.1 dB of its
limit."""
_MOST_STEPS = 512
"""Most steps of conjugate gradients; four turns of a circle over 192 x 320 px settle in 64."""
_PIXELS_A_WAVE, _WAVES = 128, 400
"""Pixels of a canvas for each of the waves of most power that have a matrix where pictures settle,
and such waves where they need not: theirs costs no more than some steps of conjugate gradients."""
_BY_WAVES = 2e-2
"""Residual below which conjugate gradients take so many steps that a matrix is worth its cost."""
TILES = 8
"""Parts of a picture along each axis whose likelihoods are compared."""


class AbstractRolledFrame(ABC):
    """The way from a picture of the plane to a frame whose rows have responses of their own."""

    @abstractmethod
    def seen(self, spectrum: Complex[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """The frame that a picture leaves, from half of its DFT on the canvas."""

    @abstractmethod
    def told(self, frame: Float[np.ndarray, "..."]) -> Complex[np.ndarray, "..."]:
        """The adjoint: half of the DFT of what a frame tells of the picture."""

    @abstractmethod
    def rows(
        self, down: Int[np.ndarray, "w"], across: Int[np.ndarray, "w"]
    ) -> Complex[np.ndarray, "s rows w"]:
        """Traces of some waves of half of the DFT at the head of each row."""

    @property
    @abstractmethod
    def power(self) -> Float[np.ndarray, "..."]:
        """Square of the response in the mean over rows."""


class LineInTurn(NamedTuple):
    """The way from pictures of a line to a frame whose pixels have responses of their own."""

    matrix: Complex[np.ndarray, "s pixels k"]  # The response of each times the waves there
    length: int  # Pixels of the line's DFT

    def seen(self, spectrum: Complex[np.ndarray, "s rows k"]) -> Float[np.ndarray, "s rows pixels"]:
        """The frame that pictures leave, from half of their DFT."""
        return pixels_through(self.matrix, spectrum, self.length)

    def told(self, frame: Float[np.ndarray, "... rows pixels"]) -> Complex[np.ndarray, "s rows k"]:
        """The adjoint."""
        return frame @ self.matrix.conj()

    @property
    def power(self) -> Float[np.ndarray, "s 1 k"]:
        """Square of the response in the mean over pixels."""
        return np.mean(np.abs(self.matrix) ** 2, axis=1, keepdims=True)


Responses = Complex[np.ndarray, "frames ..."] | Sequence[LineInTurn] | Sequence[AbstractRolledFrame]
"""The way from a picture to each frame: a response on the canvas, or one for each row."""


class Canvas(NamedTuple):
    """Frames on a canvas that reaches beyond the sensor, and what is known of them."""

    frames: Float[np.ndarray, "frames ..."]  # Deviations from the picture's mean level
    noises: Float[np.ndarray, "frames"]  # Variance of the noise in each, $N_k$; white = 1
    power: Float[np.ndarray, "*k"]  # Power of pictures on the canvas, $S$; above 0
    margin: tuple[int, ...]  # Pixels of the canvas before the sensor, along each axis of the DFT
    shape: tuple[int, ...]  # Pixels of the canvas
    has_levels: bool = True  # Whether the mean of each row in each frame is that of the picture
    size: int = 1  # Pixels of the sensor along a side of these

    @property
    def sensor(self) -> tuple[int, ...]:
        """Pixels of the sensor."""
        return self.frames.shape[-len(self.shape) :]

    @property
    def window(self) -> tuple:
        """The sensor's part of the canvas."""
        ends = zip(self.margin, self.sensor, strict=True)
        return (..., *(slice(first, first + count) for first, count in ends))

    def known(self, frames: Float[np.ndarray, "*f columns"]) -> Float[np.ndarray, "*f columns"]:
        r"""Frames, less the levels of their rows where nothing is known of these.

        An unknown level adds $\sigma^2 1 1^\top$ to the covariance $N_k I$ of the noise; the
        inverse of the sum is $(I - 1 1^\top/n)/N_k$ as $\sigma$ grows without bound.
        """
        return frames if self.has_levels else frames - np.mean(frames, axis=-1, keepdims=True)

    def spectrum(self, whole: Float[np.ndarray, "..."]) -> Complex[np.ndarray, "..."]:
        """Half of the DFT of pictures on the canvas."""
        return rfftn(whole, axes=range(-len(self.shape), 0))

    def picture(self, spectrum: Complex[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """The inverse of `spectrum`."""
        return irfftn(spectrum, self.shape, axes=range(-len(self.shape), 0))

    def seen(self, spectrum: Complex[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """The sensor's part of pictures: of rows beyond it no inverse is computed."""
        *down, across = self.window[1:]
        for rows in down:
            spectrum = np.asarray(scipy.fft.ifft(spectrum, axis=-2))[..., rows, :]
        return irfftn(spectrum, self.shape[-1:], axes=(-1,))[..., across]

    def told(self, frames: Float[np.ndarray, "..."]) -> Complex[np.ndarray, "..."]:
        """The adjoint of `seen`: half of the DFT of frames, which are 0 beyond the sensor."""
        *down, across = self.window[1:]
        whole = np.zeros((*frames.shape[:-1], self.shape[-1]), frames.dtype)
        whole[..., across] = frames
        spectrum = rfftn(whole, axes=(-1,))
        for rows in down:
            shape = *spectrum.shape[:-2], self.shape[-2], spectrum.shape[-1]
            whole = np.zeros(shape, spectrum.dtype)
            whole[..., rows, :] = spectrum
            spectrum = np.asarray(scipy.fft.fft(whole, axis=-2, overwrite_x=True))
        return spectrum

    def through(
        self, responses: Responses, spectrum: Complex[np.ndarray, "..."]
    ) -> Float[np.ndarray, "frames ..."]:
        """The frames that pictures leave."""
        if isinstance(responses, np.ndarray):
            return self.seen(spectrum * responses)
        return np.stack([one.seen(spectrum) for one in responses])

    def gathered(
        self, responses: Responses, frames: Float[np.ndarray, "frames ..."]
    ) -> Complex[np.ndarray, "..."]:
        r"""All that frames tell of the picture, $\sum_k \bar A_k \hat g_k / N_k$.

        Those are less their levels where nothing is known of them.
        """
        noises = self.noises.astype(frames.dtype).reshape(-1, *[1] * (frames.ndim - 1))
        frames = self.known(frames) / noises
        if not isinstance(responses, np.ndarray):
            each = zip(responses, frames, strict=True)
            return reduce(operator.iadd, (one.told(frame) for one, frame in each))
        # Each for all pictures that they may show.
        alike = [1] * (responses.ndim - frames.ndim)
        frames = frames.reshape(len(frames), *alike, *frames.shape[1:])
        return np.sum(responses.conj() * self.told(frames), axis=0)

    def density(self, responses: Responses) -> Float[np.ndarray, "..."]:
        r"""Signal by noise of the frames, $\sum_k |A_k|^2/N_k$, in the mean over rows."""
        noises = self.noises.astype(self.frames.dtype)
        if isinstance(responses, np.ndarray):
            return density_of(responses, noises)
        return reduce(operator.iadd, (a.power / n for a, n in zip(responses, noises, strict=True)))

    def error(self, density: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        """Squared error that the likeliest pictures are expected to leave."""
        return mean_over_dft(self.power / (1 + self.power * density), *self.shape)


Near = Callable[[Complex[np.ndarray, "..."]], Complex[np.ndarray, "..."]]
"""Pictures near the likeliest ones, from all that frames tell of them."""
Solve = Callable[[Complex[np.ndarray, "..."], float], Complex[np.ndarray, "..."]]
"""The likeliest pictures, from all that frames tell of them, to a tolerance."""


class Likeliest(NamedTuple):
    """The likeliest pictures of frames."""

    canvas: Canvas
    responses: Responses
    solve: Solve
    spectrum: Complex[np.ndarray, "..."]
    # How much better than no picture each explains the frames, as a logarithm of likelihood
    gains: Float[np.ndarray, "*pictures"]

    def of(
        self, frames: Float[np.ndarray, "frames ..."], tolerance: float = TOLERANCE
    ) -> "Likeliest":
        """Those of other frames of the same responses."""
        canvas = self.canvas._replace(frames=frames)
        return _solved(canvas, self.responses, self.solve, tolerance)

    @property
    def picture(self) -> Float[np.ndarray, "..."]:
        """The pictures on the canvas."""
        return self.canvas.picture(self.spectrum)

    @property
    def density(self) -> Float[np.ndarray, "..."]:
        """Signal by noise of the frames."""
        return self.canvas.density(self.responses)

    @property
    def seen(self) -> Float[np.ndarray, "frames ..."]:
        """The frames that the pictures give."""
        return self.canvas.through(self.responses, self.spectrum)


def likeliest(
    canvas: Canvas,
    responses: Responses,
    tolerance: float = TOLERANCE,
    settled: float = math.inf,  # Share of the expected squared error
) -> Likeliest:
    """The likeliest pictures: by a matrix that all share, or by gradients until they settle."""
    matrices = [one.matrix for one in responses if isinstance(one, LineInTurn)]
    if matrices:
        solve = _by_matrices(canvas, matrices)
    else:
        settles = math.isfinite(settled)
        if len(canvas.shape) > 1 and (settles or tolerance < _BY_WAVES):
            waves = math.prod(canvas.shape) // _PIXELS_A_WAVE if settles else _WAVES
            near = _together(canvas, responses, waves)
        else:
            near = _alone(canvas, responses)
        solve = partial(_by_gradients, canvas, responses, near=near, settled=settled)
    return _solved(canvas, responses, solve, tolerance)


def _solved(canvas: Canvas, responses: Responses, solve: Solve, tolerance: float) -> Likeliest:
    """The likeliest pictures of the frames of a canvas."""
    target = canvas.gathered(responses, canvas.frames)
    picture = solve(target, tolerance)
    gains = mean_over_dft(np.real(target.conj() * picture), *canvas.shape) / 2
    return Likeliest(canvas, responses, solve, picture, gains)


def _by_matrices(
    canvas: Canvas,
    matrices: Sequence[Complex[np.ndarray, "s pixels k"]],  # Of frames
) -> Solve:
    """The likeliest lines, all of which pass the same pixels."""
    # Numbers of unit variance: both parts of each frequency, that of the whole DFT counted.
    root = np.sqrt(counted_in(*canvas.shape) * canvas.power / canvas.shape[0])
    factors = []

    def levels(matrix: Complex[np.ndarray, "pixels k"]) -> Complex[np.ndarray, "k"] | float:
        """The mean over pixels, where nothing is known of that."""
        return 0.0 if canvas.has_levels else np.mean(matrix, axis=0)

    for every in zip(*matrices, strict=True):
        each = zip(every, np.sqrt(canvas.noises), strict=True)
        parts = [(one - levels(one)) / noise for one, noise in each]
        rows = np.concatenate(parts) * root
        rows = np.concatenate([np.real(rows), -np.imag(rows)], axis=1)
        factors.append(scipy.linalg.cho_factor(rows.T @ rows + np.eye(rows.shape[1])))

    def solve(target: Complex[np.ndarray, "s rows k"], _: float) -> Complex[np.ndarray, "s rows k"]:
        told = np.concatenate([np.real(target) * root, np.imag(target) * root], axis=-1)
        pairs = zip(factors, told, strict=True)
        found = np.stack([scipy.linalg.cho_solve(factor, one.T).T for factor, one in pairs])
        real, imaginary = np.split(found, 2, axis=-1)
        return (real + 1j * imaginary) * (canvas.power / root)

    return solve


def _alone(canvas: Canvas, responses: Responses) -> Near:
    """Pictures near the likeliest ones: each wave is seen by the sensor's share of the canvas."""
    share = math.prod(canvas.sensor) / math.prod(canvas.shape)
    inverse = 1 / (share * canvas.density(responses) + 1 / canvas.power)
    return partial(np.multiply, inverse)


def _together(canvas: Canvas, responses: Responses, waves: int) -> Near:
    """Pictures of the plane that are nearer to them: so many waves of most power have a matrix.

    Where frames tell far more of waves than the prior does, what lies beyond the borders decides,
    and gradients find it last; the matrix knows the borders.
    """
    alone = _alone(canvas, responses)
    half = min(waves // 2, canvas.power.size)
    if half == 0:
        return alone
    # With a wave comes its mirror image, of which half of a DFT has none in its first column alone.
    inside = np.nonzero(canvas.power >= np.partition(canvas.power, -half, axis=None)[-half])
    inside[0][2 * inside[0] > canvas.shape[0]] -= canvas.shape[0]
    is_twice = inside[1] > 0

    def whole(values: np.ndarray) -> Complex[np.ndarray, "... w"]:
        """Values of waves, and of their mirror images."""
        return np.concatenate([values, values[..., is_twice].conj()], axis=-1)

    def between(axis: int) -> Complex[np.ndarray, "w w"]:
        """Sums of products of waves over the sensor along an axis, over those of the canvas."""
        numbers = np.concatenate([inside[axis], -inside[axis][is_twice]])
        numbers, which = np.unique(numbers, return_inverse=True)
        places = canvas.margin[axis] + np.arange(canvas.sensor[axis])
        along = np.exp(2j * np.pi / canvas.shape[axis] * np.outer(places, numbers))
        return (along.conj().T @ along / canvas.shape[axis])[np.ix_(which, which)]

    if isinstance(responses, np.ndarray):
        each = responses.reshape(len(responses), -1, 1, *canvas.power.shape)[..., *inside]
        borders = between(0) * between(1)
    else:
        each = [one.rows(*inside) for one in responses if isinstance(one, AbstractRolledFrame)]
        borders = between(1) / canvas.shape[0]
    root, factors = whole(np.sqrt(canvas.power[inside].astype(np.float64))), []
    for every in zip(*each, strict=True):
        pairs = zip(every, np.sqrt(canvas.noises), strict=True)
        rows = root * whole(np.concatenate([row / noise for row, noise in pairs]))
        matrix = borders * (rows.conj().T @ rows) + np.eye(root.size)
        factors.append(scipy.linalg.cho_factor(matrix))

    def solve(target: Complex[np.ndarray, "... m k"]) -> Complex[np.ndarray, "... m k"]:
        found, told = alone(target), root * whole(target[..., *inside])
        pairs = zip(factors, told.reshape(-1, root.size), strict=True)
        held = root * np.stack([scipy.linalg.cho_solve(*pair) for pair in pairs])
        found[..., *inside] = held.reshape(told.shape)[..., : inside[0].size]
        return found

    return solve


def _by_gradients(
    canvas: Canvas,
    responses: Responses,
    target: Complex[np.ndarray, "..."],
    tolerance: float,
    *,
    near: Near,
    settled: float,
) -> Complex[np.ndarray, "..."]:
    """The likeliest pictures, by conjugate gradients on all of them at once."""
    dtype, shape = canvas.frames.dtype, canvas.shape
    prior = 1 / canvas.power

    def product(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """Inner products of pictures, from half of their spectra."""
        return mean_over_dft(np.real(first.conj() * second), *shape)

    def along(numbers: np.ndarray) -> np.ndarray:
        """A number for each picture."""
        return numbers.astype(dtype).reshape(*numbers.shape, *[1] * len(shape))

    picture, residual, step = np.zeros_like(target), target.copy(), near(target)
    size = product(residual, step)
    least, most, moved = (
        tolerance**2 * size,
        settled * canvas.error(canvas.density(responses)),
        math.inf,
    )
    is_active, before = np.ones(size.shape, bool), 0.0
    for count in range(1, _MOST_STEPS + 1):
        is_active &= (size > least) | (moved > most)
        if not np.any(is_active):
            break
        image = canvas.gathered(responses, canvas.through(responses, step))
        image += prior * step
        curvature = product(step, image)
        # Of frames with next to no noise, rounding leaves steps that lead nowhere.
        is_active &= (size > 0) & (curvature > 0)
        stride = along(np.divide(size, curvature, out=np.zeros_like(size), where=is_active))
        picture += stride * step
        residual -= stride * image
        turned = near(residual)
        following = product(residual, turned)
        kept = np.divide(following, size, out=np.zeros_like(size), where=is_active)
        step = turned + along(kept) * step
        size = following
        if math.isfinite(settled) and count.bit_count() == 1:
            seen = canvas.seen(picture)
            moved = np.mean((seen - before) ** 2, axis=tuple(range(-len(shape), 0)))
            before = seen
    return picture


def complete(
    found: Likeliest, density: Float[np.ndarray, "*k"] | None = None
) -> Complex[np.ndarray, "..."]:
    r"""All that frames tell which go on beyond their borders, as the likeliest pictures do.

    With $\hat d = \sum_k \bar A_k\hat g_k/N_k$ and $\rho = \sum_k |A_k|^2/N_k$ the misfit of a
    picture is $\tfrac12\sum(\rho|\hat f|^2 - 2\,\Re\,\bar{\hat f}\hat d)$. Frames whose rows have
    responses of their own are completed to those of a density $\rho$ for all rows, of which the
    likeliest picture is the same: $\hat d = (\rho + 1/S)\hat f$.
    """
    canvas, responses = found.canvas, found.responses
    if density is not None or not isinstance(responses, np.ndarray):
        own = found.density if density is None else density
        return (own + 1 / canvas.power) * found.spectrum
    data = np.zeros_like(found.spectrum)
    noises = canvas.noises.astype(canvas.frames.dtype)
    for frame, response, noise in zip(canvas.frames, responses, noises, strict=True):
        whole = canvas.picture(found.spectrum * response)
        whole[canvas.window] = frame
        data = data + np.conj(response) * canvas.spectrum(whole / noise)
    return data


class Volume(NamedTuple):
    """The volume of the Gaussian about the likeliest picture."""

    # Half the logarithm of the determinant of the frames' covariance, over that of their noise, or
    # that of each row
    logarithm: float | Float[np.ndarray, "rows"]
    freedoms: Float[np.ndarray, "frames"]  # Numbers of each frame that are left to the noise


def volume_of(
    density: Float[np.ndarray, "frames *k"],  # $S|A_k|^2/N_k$
    places: Float[np.ndarray, "axes frames"],  # Of each frame, down the columns and along the rows
    sensor: tuple[int, ...],
) -> Volume:
    """That of a picture without ends, in each part of it for the frames that see that."""
    *down, num_across = density.shape[1:]
    period = 2 * (num_across - 1)
    counted = np.broadcast_to(counted_in(period), density.shape[1:])
    weight = counted.ravel() / math.prod([*down, period])
    density = density.reshape(len(density), -1)
    sees, areas = _parts(places, sensor)
    each = sees @ density
    logarithm = float(areas @ (np.log1p(each) @ weight)) / 2
    held = (weight / (1 + each)) @ density.T
    return Volume(logarithm, np.sum(areas[:, None] * sees * (1 - held), axis=0))


def _parts(
    places: Float[np.ndarray, "axes frames"], sensor: tuple[int, ...]
) -> tuple[Float[np.ndarray, "p frames"], Float[np.ndarray, "p"]]:
    """Which frames see each part of a picture that some see, and the pixels of that part."""
    sees, areas = np.ones((1, places.shape[1]), bool), np.ones(1)
    for firsts, count in zip(places, sensor, strict=True):
        ends = np.unique(np.concatenate([firsts, firsts + count]))
        inner = (ends[1:] + ends[:-1])[:, None] / 2
        sees = sees[:, None] & (firsts <= inner) & (inner <= firsts + count)
        sees = sees.reshape(-1, places.shape[1])
        areas = np.outer(areas, np.diff(ends)).ravel()
    bits = np.packbits(sees, axis=1)
    words = bits.view(f"V{bits.shape[1]}").ravel()  # which sort far faster than rows
    _, first, kind = np.unique(words, return_index=True, return_inverse=True)
    kinds, areas = sees[first], np.bincount(kind.ravel(), areas)
    is_seen = np.any(kinds, axis=1)
    return kinds[is_seen].astype(np.float64), areas[is_seen]


class Fit(NamedTuple):
    """How the frames fit the likeliest picture at a motion."""

    # Mean square of what the picture leaves of the frames, over their noise, with the picture's own
    # freedom counted, and without gains and black levels that change
    misfit: float
    misfits: Float[np.ndarray, "frames"]  # The same of each frame
    gains: Float[np.ndarray, "frames"]  # Gain of each frame beside the picture, less 1
    offsets: Float[np.ndarray, "frames"]  # Its black level; white = 1
    shifts: Float[np.ndarray, "frames axes"]  # From where the others put it, along rows first
    shift_errors: Float[np.ndarray, "frames axes"]  # Standard errors of these; px
    # Logarithm of the likelihood of each row, or that which the residual has in each tile
    parts: Float[np.ndarray, "parts"]
    logarithm: float  # Logarithm of the likelihood of all, over that of no picture

    @property
    def spread(self) -> float:
        """Misfit by which errors are wider than those of frames that fit."""
        return max(1.0, self.misfit)


def fit_of(found: Likeliest, space: Volume, mean: float = 0.0) -> Fit:
    """How the frames fit the likeliest picture at one motion, about a mean level."""
    canvas, num_frames = found.canvas, len(found.responses)
    shape, num_axes = canvas.frames.shape, len(canvas.shape)
    seen = found.seen.reshape(shape)
    residual = canvas.known(canvas.frames) - canvas.known(seen)
    gains, offsets = np.zeros((2, num_frames))
    shifts, errors = np.zeros((2, num_frames, num_axes))
    covariances = np.zeros((num_frames, num_axes, num_axes))
    # Standard deviations by which a frame may differ: of its gain, black level, and shift, 10 px.
    expected = np.diag(np.array([0.2, 0.2, *[10.0 / canvas.size] * num_axes]) ** -2.0)
    slopes = []
    for frequency in frequencies_on(canvas.shape)[::-1] if num_frames > 1 else []:
        turn = (-2j * np.pi * frequency).astype(found.spectrum.dtype)  # along the rows first
        slopes.append(canvas.through(found.responses, turn * found.spectrum).reshape(shape))
    for k, noise in enumerate(canvas.noises if num_frames > 1 else []):
        changes = [seen[k] + mean, np.ones_like(seen[k]), *(slope[k] for slope in slopes)]
        design = np.stack([canvas.known(one).ravel() for one in changes], axis=1)
        design = design.astype(np.float64)
        inverse = np.linalg.inv(design.T @ design / noise + expected)
        change = inverse @ (design.T @ residual[k].ravel()) / noise
        residual[k] -= (design[:, :2] @ change[:2]).reshape(shape[1:])
        gains[k], offsets[k], *shifts[k] = change
        covariances[k] = inverse[2:, 2:]
    if num_frames > 1:
        shifts, errors = _from_the_others(shifts, covariances)
    noises = canvas.noises.reshape(-1, *[1] * (len(shape) - 1))
    squares = residual.astype(np.float64) ** 2 / noises
    # Each frame has a gain and a black level, or each of its rows has one.
    lost = (2 if canvas.has_levels else 1) * (num_frames > 1)
    lost += 0 if canvas.has_levels else math.prod(shape[1:-1])
    freedoms = found.gains.size * space.freedoms - lost
    sums = np.sum(squares.reshape(num_frames, -1), axis=1)
    logarithms = found.gains.ravel() - space.logarithm
    if num_axes == 1:
        parts = logarithms
    else:
        parts = -_in_tiles(np.sum(squares, axis=0)) / 2
    return Fit(
        float(np.sum(sums) / max(np.sum(freedoms), 1.0)),
        sums / np.maximum(freedoms, 1.0),
        gains,
        offsets,
        canvas.size * shifts,
        canvas.size * errors,
        parts,
        float(np.sum(logarithms)),
    )


def _from_the_others(
    shifts: Float[np.ndarray, "frames axes"], covariances: Float[np.ndarray, "frames axes axes"]
) -> tuple[Float[np.ndarray, "frames axes"], Float[np.ndarray, "frames axes"]]:
    r"""Displacements of each frame from where all others are, and their standard errors.

    The picture lies where frames are in the mean, $\sum_j J_j d_j/J$, $J = \sum_j J_j$, by the
    information $J_j$ that each has of its place. Beside it a frame seems displaced by
    $r_k = d_k - \sum_j J_j d_j/J$ alone, which is $J^{-1}(J - J_k)$ of its displacement from the
    mean of the others, and that has the covariance $J_k^{-1} + (J - J_k)^{-1}$.
    """
    information = np.linalg.inv(covariances)
    every = np.sum(information, axis=0)
    of_others = np.linalg.inv(every - information)
    displaced = np.einsum("kij,jl,kl->ki", of_others, every, shifts)
    variances = np.diagonal(covariances + of_others, axis1=1, axis2=2)
    return displaced, np.sqrt(variances)


def _in_tiles(values: Float[np.ndarray, "*planes rows columns"]) -> Float[np.ndarray, "*planes t"]:
    """Sums over tiles."""
    for axis in (-2, -1):
        count = values.shape[axis]
        starts = np.linspace(0, count, min(TILES, count), endpoint=False).astype(int)
        values = np.add.reduceat(values, starts, axis=axis)
    return values.reshape(*values.shape[:-2], -1)


def electrons_of(scene: Scene, exposures: RowLike) -> Float[np.ndarray, "frames"]:
    """Electrons of a white pixel in each frame."""
    electrons = white_electrons(float(scene.photon_rate), np.asarray(exposures, np.float64))
    has_light, requirement = float(np.min(electrons)) > 0, "have a photon rate above 0 e-/s"
    require(has_light, "restore_frames(scene=...)", requirement, 0.0)
    return electrons


def noises_of(
    scene: Scene, exposures: RowLike, mean_level: float, share: float = 1.0
) -> Float[np.ndarray, "frames"]:
    """Variance of the noise in frames of a mean level, or a share of it for one grey; white = 1."""
    electrons_of(scene, exposures)
    light = float(scene.photon_rate), np.asarray(exposures, np.float64)
    electrons, noises = noise_of_frames(*light, max(mean_level, 0.0), float(scene.read_noise))
    return share * noises / electrons**2


class Detail(NamedTuple):
    """Power of a picture over that which a scene expects, by radius of the frequency."""

    radius: Float[np.ndarray, "b"] = np.array([0.1])  # cycles/px
    scale: Float[np.ndarray, "b"] = np.ones(1)

    def at(self, radius: Float[np.ndarray, "*k"]) -> Float[np.ndarray, "*k"]:
        """The scale at some radii."""
        logarithms = np.log(np.maximum(radius, 1e-6)), np.log(self.radius), np.log(self.scale)
        return np.exp(np.interp(*logarithms))


def detail_of(
    frames: Float[np.ndarray, "frames ..."],
    noises: Float[np.ndarray, "frames"],
    shape: tuple[int, ...],
    expected: Float[np.ndarray, "..."],
    lowest: float,
) -> Detail:
    r"""Detail that frames show by a DFT of a shape, from a lowest frequency on.

    A picture of less detail than expected, or of finer, would else seem to move as explains it. The
    power of frames beyond their noise is compared, band by band, with $S\sum_k |A_k|^2/N_k$, of
    which the motions that are tried have the mean; its DFT may be another.
    """
    num_axes = len(shape)
    window = reduce(np.multiply.outer, (np.hanning(n + 2)[1:-1] for n in frames.shape[-num_axes:]))
    window /= math.sqrt(float(np.sum(window**2)))
    power = np.abs(rfftn(frames * window, shape, axes=range(-num_axes, 0))) ** 2
    power = np.mean(power.reshape(len(frames), -1, *power.shape[-num_axes:]), axis=1)
    recorded = np.sum([one / noise - 1 for one, noise in zip(power, noises, strict=True)], axis=0)
    grid = (*expected.shape[:-1], 2 * (expected.shape[-1] - 1))
    edges = np.geomspace(lowest, 0.5, 7)
    scales = []
    for ends in itertools.pairwise(edges):
        shown, told = _mean_between(recorded, shape, *ends), _mean_between(expected, grid, *ends)
        scales.append(max(shown / told, 1e-4) if told > 0 else 1.0)
    return Detail(np.sqrt(edges[:-1] * edges[1:]), np.array(scales))


def _mean_between(power: np.ndarray, shape: tuple[int, ...], low: float, high: float) -> float:
    """Mean power between two frequencies of half of a DFT."""
    radius = reduce(np.hypot, frequencies_on(shape))
    inside = (radius >= low) & (radius <= high)
    return float(np.sum(power[inside]) / max(np.sum(inside), 1))
