r"""Frames of a rolling shutter, whose rows are exposed one after another.

Row $y$ sees everything $d_y$ later than the middle row: at a velocity it has the response
$A_k(\mathbf f; d_y)$ of its own. The mean way of a thing up to each row is a phase; what is left of
$A_k$ changes with the sensor's own way alone, slowly with $d$, and is a sum of its values at few
delays. Their weights are those of least squares over pictures of the power $S$ at some velocities,
and then the same for all.

Where rows are read across the motion of an axis, each is a picture of its own, and nothing else
changes. Where things may move along the readout, a frame at $y$ is
$\sum_{\mathbf f} A_k(\mathbf f; d_y)\,\hat f\,e^{2\pi i\,\mathbf f\cdot\mathbf u}$ at each of its
pixels $\mathbf u$: the way along the readout ends at any place between pixels, by a non-uniform
DFT.
"""

import math
from collections.abc import Callable
from functools import cached_property, lru_cache
from typing import NamedTuple, final

import jax
import numpy as np
import scipy.fft
from jaxtyping import Complex, Float, Int

from mishutter.blur.waves import waves_on_dft
from mishutter.camera.responses import frequencies_on, waves_of
from mishutter.camera.rows import counted_in, fast_length, irfftn, rfftn
from mishutter.decoding.likeliest import AbstractRolledFrame, Canvas, LineInTurn
from mishutter.evaluation.instants import Instants
from mishutter.model.frame_path import FramePath
from mishutter.model.sensor import Sensor
from mishutter.pictures.registration.windows import means

_WIDTH, _FINER = 6, 1.25
"""Points of the fine grid that a place between pixels is interpolated from, and how fine it is."""
_MOST_ALONE = 49
"""Most rows that each have a response of their own."""
_MOST_TRIED, _PX_A_DELAY = 97, 1.25
"""Most delays at which responses are compared, and way of the sensor from one to the next."""
_SOME, _GRIDS = 3, ((128,), (64, 64))
"""Velocities, and frequencies along each axis, at which they are compared."""
SHARE, ROUGH_SHARE = 0.003, 4.0
"""Shares of the noise that a sum over few delays may leave, in pictures and in a search."""
Waves = Callable[[Instants, Float[np.ndarray, "s axes"]], Complex[np.ndarray, "n s *k"]]
"""The responses of exposures at some velocities."""


class RowTimes(NamedTuple):
    """When the rows of pictures are exposed that are turned so that things move along rows."""

    delays: Float[np.ndarray, "d"]  # Of each later than the middle; s. A global shutter has one, 0
    is_along: bool = False  # Whether things move along the readout, as in the plane

    @staticmethod
    def of(sensor: Sensor, shape: tuple[int, ...], *, in_plane: bool = False) -> "RowTimes":
        """Those of pictures of so many rows and columns, once they are turned."""
        if not sensor.is_rolling:
            return GLOBAL
        is_turned = sensor.axis == "columns" and not in_plane
        delays = sensor.row_delays(shape[-1 if is_turned else -2])
        return RowTimes(delays, is_turned or in_plane)

    @property
    def is_rolling(self) -> bool:
        """Whether rows differ in their times."""
        return self.delays.size > 1

    def of_rows(self, some: slice | np.ndarray) -> "RowTimes":
        """Those of some rows."""
        is_same = self.is_along or not self.is_rolling
        return self if is_same else RowTimes(self.delays[some])

    @property
    def turned(self) -> "RowTimes":
        """Those of pictures whose rows and columns are exchanged."""
        return RowTimes(self.delays, not self.is_along) if self.is_rolling else self


GLOBAL = RowTimes(np.zeros(1))
"""All rows at once."""


class RowPaths:
    """Instants of rows that are exposed one after another, on the path of their sensor."""

    def __init__(
        self,
        path: FramePath,
        instants: Instants,  # Of the middle row
        first: int,  # Number of the first of these frames
        times: RowTimes,
        size: int,  # Pixels of the sensor along a side of these
    ):
        """Takes the instants of some frames of a path, from one on."""
        self.path, self.instants, self._size = jax.tree.map(np.asarray, path), instants, size
        self.is_along = times.is_along
        self.delays = means(times.delays, size, (0,)) if self.is_along else times.delays
        self.middles = np.sum(instants.time * instants.weight, axis=1)
        # Their clock and their places may begin elsewhere than the path's.
        self.clock = float(path.times[first] - self.middles[0])
        begin = np.asarray(path.place(instants.time[:1, :1] + self.clock)) / size
        self._start = begin - instants.place[:, :1, :1]

    def at(self, delay: float) -> Instants:
        """Instants of a row."""
        time = self.instants.time + delay
        place = np.asarray(self.path.place(time + self.clock)) / self._size - self._start
        return self.instants._replace(time=time, place=place)

    @cached_property
    def some(self) -> list[Instants]:
        """Those of three rows, whose mean is about that of all."""
        half = (self.delays[-1] - self.delays[0]) / 2
        return [self.at(float(half * x)) for x in np.polynomial.legendre.leggauss(3)[0]]

    def still(self, one: Instants) -> Instants:
        """The instants of a row without its mean way."""
        times = self.instants.time - self.middles[:, None]
        return one._replace(time=times, place=one.place - _mean_place(one)[..., None])


class RowsInTurn:
    """The ways from a picture on a canvas to frames whose rows are exposed one after another."""

    def __init__(
        self,
        paths: RowPaths,
        canvas: Canvas,
        velocities: Float[np.ndarray, "s axes"],  # That are looked at; px/s of the sensor
        share: float,  # Of the noise, which a sum over few delays may leave
    ):
        """Takes rows, and what they are looked at for."""
        some = np.unique(np.linspace(0, len(velocities) - 1, _SOME).astype(int))
        self.paths, self._canvas, self._share = paths, canvas, share
        self._velocities = velocities[some] / canvas.size

    def responses(
        self, velocities: Float[np.ndarray, "s axes"], waves: Waves, *, by_time: bool = False
    ) -> "Complex[np.ndarray, 'n s rows k'] | list[LineInTurn] | list[FrameInTurn]":
        r"""The way from a picture to each frame: of rows that are pictures, or along the readout.

        Or its derivative by the velocity, but for the factor $2\pi i\,\mathbf f$.
        """
        paths, canvas = self.paths, self._canvas
        length, first = canvas.shape[-1], canvas.margin[-1]
        if not paths.is_along and paths.delays.size <= _MOST_ALONE:
            every = [paths.at(each) for each in paths.delays.tolist()]
            if by_time:
                every = [one._replace(weight=one.weight * one.time) for one in every]
            return np.stack([waves(one, velocities) for one in every], axis=2)
        few, weights, places = self._few
        still = [paths.still(one) for one in few]
        kernels = [waves(one, velocities) for one in still]
        lasts = paths.middles[:, None] + paths.delays
        if by_time:  # from the middle of each exposure, and from that of all to it
            apart = [one._replace(weight=one.weight * one.time) for one in still]
            kernels = [waves(one, velocities) for one in apart] + kernels
            weights = np.concatenate([weights, weights * lasts[..., None]], axis=-1)
        ways = places[:, :, None] - velocities.T[:, None, :, None] * lasts[:, None]
        each = zip(np.stack(kernels, axis=2), weights, np.moveaxis(ways, 1, 0), strict=True)
        if len(canvas.shape) > 1:
            return [FrameInTurn(*one, canvas) for one in each]
        # A pixel along the readout is the picture as far back as it lies before the pixel.
        back = -(first + np.arange(paths.delays.size)) if paths.is_along else 0
        rows = []
        for kernel, weight, way in each:
            turn = waves_on_dft(
                (way[0] + back).reshape(-1, 1), np.ones((1, 1)), length, length // 2 + 1
            )
            rows.append(weight @ kernel * turn.reshape(*way.shape[1:], -1))
        return [LineInTurn(one, length) for one in rows] if paths.is_along else np.stack(rows)

    @cached_property
    def _few(
        self,
    ) -> tuple[list[Instants], Float[np.ndarray, "n rows f"], Float[np.ndarray, "axes n rows"]]:
        """Instants of a few delays, weights of their responses in rows, and places of rows."""
        from scipy.interpolate import CubicSpline

        paths, canvas = self.paths, self._canvas
        count, low, high = len(paths.middles), *(f(paths.delays).item() for f in (np.min, np.max))
        way = paths.path.top_speed * (high - low) / canvas.size
        tried = np.linspace(low, high, min(math.ceil(way / _PX_A_DELAY) + 5, _MOST_TRIED))
        there = [paths.at(each) for each in tried.tolist()]
        places = CubicSpline(tried, np.stack([*map(_mean_place, there)]))(paths.delays)
        places = np.moveaxis(places, 0, -1)
        if way == 0:
            return there[:1], np.ones((count, paths.delays.size, 1)), places
        grid = tuple(map(min, _GRIDS[len(canvas.shape) - 1], canvas.shape))
        power = np.sqrt(_on_grid(canvas.power, grid) / len(self._velocities)).astype(np.float32)
        every = [waves_of(paths.still(one), self._velocities, grid) * power for one in there]
        flat = np.stack(every, axis=1).reshape(count, tried.size, -1)
        products = np.real(flat.conj() @ np.swapaxes(flat, 1, 2)).astype(np.float64)
        index, weights = _few_delays(products, self._share * canvas.noises)
        weights = CubicSpline(tried, np.moveaxis(weights, 2, 0))(paths.delays)
        return [there[k] for k in index], weights.transpose(1, 0, 2), places


def _mean_place(of: Instants) -> Float[np.ndarray, "axes n"]:
    """Mean place of the sensor in each exposure."""
    return np.sum(of.place * of.weight, axis=-1)


def _on_grid(power: Float[np.ndarray, "..."], grid: tuple[int, ...]) -> Float[np.ndarray, "..."]:
    """A density on the coarser grid of another DFT, whose sum is its mean power."""
    lengths = *power.shape[:-1], 2 * (power.shape[-1] - 1)
    each = zip(frequencies_on(grid), lengths, strict=True)
    index = [np.round(f.ravel() * length).astype(int) for f, length in each]
    return power[np.ix_(*index)] * counted_in(grid[-1]) / math.prod(grid)


def _few_delays(
    products: Float[np.ndarray, "n d d"], most: Float[np.ndarray, "n"]
) -> tuple[list[int], Float[np.ndarray, "n f d"]]:
    """A few delays of some, and weights by which responses there give those at all, to an error."""
    count = products.shape[1]
    whole, index, weights = np.einsum("ndd->n", products), np.arange(count), products
    for few in range(1, count + 1):
        turns = np.cos(np.pi * (np.arange(few) + 0.5) / few)
        index = np.unique(np.round((count - 1) / 2 * (1 - turns)).astype(int))
        among = products[:, index][:, :, index]
        among = among + 1e-9 * whole[:, None, None] / count * np.eye(index.size)
        across = products[:, index]
        weights = np.linalg.solve(among, across)
        left = whole - np.einsum("nfd,nfd->n", across, weights)
        if np.all(left <= most * count):
            break
    return index.tolist(), weights


@final
class FrameInTurn(AbstractRolledFrame):
    """A frame that is read down the columns: a few responses, and a way to each of its rows."""

    def __init__(
        self,
        kernels: Complex[np.ndarray, "s f m k"],
        share: Float[np.ndarray, "rows f"],  # Of each of them in each row
        ways: Float[np.ndarray, "2 s rows"],
        canvas: Canvas,
    ):
        """Takes what `RowsInTurn` has found, without the mean way."""
        from scipy import sparse

        dtype = np.result_type(canvas.frames, np.complex64)
        self._canvas, self._kernels = canvas, kernels.astype(dtype)
        self._share, self._ways = share, ways
        length, count = canvas.shape[0], share.shape[0]
        self._fine, spread = _fine_grid(length)
        self._spread = self._kernels / spread[:, None].astype(canvas.frames.dtype)
        place = (np.arange(count) + canvas.margin[0] - ways[1]) * (self._fine / length)
        near = np.ceil(place - _WIDTH / 2)[..., None] + np.arange(_WIDTH)
        values = share[:, :, None] * _window((place[..., None] - near) * 2 / _WIDTH)[:, :, None]
        block = np.arange(values[:, 0, :, 0].size).reshape(len(place), 1, -1, 1)
        index = self._fine * block + near[:, :, None].astype(int) % self._fine
        shape = place.size, self._fine * block.size
        ends = index[0, 0].size * np.arange(place.size + 1)
        numbers = values.ravel().astype(canvas.frames.dtype)
        self._rows = sparse.csr_array((numbers, index.ravel(), ends), shape)
        turn = -2j * np.pi * ways[0][..., None] * np.fft.rfftfreq(canvas.shape[1])
        self._turn = np.exp(turn).astype(dtype)

    def seen(self, spectrum: Complex[np.ndarray, "s m k"]) -> Float[np.ndarray, "s rows columns"]:
        canvas, length = self._canvas, self._canvas.shape[0]
        passed = self._spread * spectrum[:, None]
        fine = np.zeros((*passed.shape[:2], self._fine, passed.shape[3]), passed.dtype)
        for part in self._parts:
            fine[:, :, part] = passed[:, :, part]
        waves = np.asarray(scipy.fft.ifft(fine, axis=2, norm="forward", overwrite_x=True))
        rows = self._rows @ waves.reshape(-1, passed.shape[3])
        rows = rows.reshape(len(spectrum), -1, passed.shape[3]) / length
        return irfftn(self._turn * rows, (canvas.shape[1],), axes=(2,))[..., canvas.window[-1]]

    def told(self, frame: Float[np.ndarray, "... rows columns"]) -> Complex[np.ndarray, "s m k"]:
        canvas, count = self._canvas, len(self._kernels)
        whole = np.zeros((*frame.shape[:-1], canvas.shape[1]), frame.dtype)
        whole[..., canvas.window[-1]] = frame
        rows = self._turn.conj() * rfftn(whole, axes=(-1,))
        rows = np.broadcast_to(rows, (count, *rows.shape[-2:]))
        fine = (self._rows.T @ rows.reshape(-1, rows.shape[2])).reshape(
            count, -1, self._fine, rows.shape[2]
        )
        waves = np.asarray(scipy.fft.fft(fine, axis=2, overwrite_x=True))
        kept = np.concatenate([waves[:, :, part] for part in self._parts], axis=2)
        return np.sum(self._spread.conj() * kept, axis=1)

    def rows(
        self, down: Int[np.ndarray, "w"], across: Int[np.ndarray, "w"]
    ) -> Complex[np.ndarray, "s rows w"]:
        (length, width), first = self._canvas.shape, self._canvas.margin[0]
        places = first + np.arange(len(self._share)) - self._ways[1]
        turns = places[..., None] * (down / length) - self._ways[0][..., None] * (across / width)
        return np.exp(2j * np.pi * turns) * (self._share @ self._kernels[..., down, across])

    @property
    def _parts(self) -> tuple[slice, slice]:
        """Frequencies from 0 up, and those below 0, on this grid and on the fine one."""
        half = self._canvas.shape[0] // 2
        return slice(0, half), slice(-half, None)

    @property
    def power(self) -> Float[np.ndarray, "s m k"]:
        return np.mean(np.abs(self._kernels) ** 2, axis=1)


@lru_cache
def _fine_grid(length: int) -> tuple[int, Float[np.ndarray, "{length}"]]:
    """Points of the grid from which places are interpolated, and the transform of the window."""
    fine = fast_length(math.ceil(_FINER * length))
    nodes, weights = np.polynomial.legendre.leggauss(4 * _WIDTH)
    turns = np.pi * _WIDTH * np.fft.fftfreq(length) * length / fine
    return fine, np.cos(np.outer(turns, nodes)) @ (_window(nodes) * weights) * _WIDTH / 2


def _window(place: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """Values of the window at places from -1 to 1."""
    scale = math.pi * _WIDTH * (1 - 0.5 / _FINER) * 0.98
    return np.exp(scale * (np.sqrt(np.maximum(1 - place**2, 0)) - 1))
