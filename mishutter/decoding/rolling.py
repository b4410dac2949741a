r"""Frames of a rolling shutter, whose rows are exposed one after another.

Row $y$ sees everything $d_y$ later than the middle row: at a velocity it has the response
$A_k(\mathbf f; d_y)$ of its own. Where rows are read across the motion of an axis, each is a
picture of its own, and nothing else changes. Where things may move along the readout, a frame at
$y$ is $\sum_{\mathbf f} A_k(\mathbf f; d_y)\,\hat f\,e^{2\pi i\,\mathbf f\cdot\mathbf u}$ at each
of its pixels $\mathbf u$.

Along one axis that is a product with a matrix. In the plane the mean way of a thing up to each row
comes first, at any place between pixels, by a non-uniform DFT down the columns; what is left of
$A_k$ changes slowly with $d$, and is a sum of its values at few delays, whose weights are those of
least squares over pictures of the power $S$.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple, final

import numpy as np
import scipy.fft
from jaxtyping import Complex, Float

from mishutter.blur.waves import waves_in_plane
from mishutter.camera.plane_frames import frequencies_on
from mishutter.camera.rows import counted_in, fast_length, irfftn, pixels_through, rfftn
from mishutter.decoding.likeliest import AbstractRolledFrame, Canvas
from mishutter.evaluation.instants import Instants
from mishutter.model.exposures import path_for_rows
from mishutter.model.scene import Scene
from mishutter.model.sensor import Sensor
from mishutter.model.sequences import PlaneFrames, TimedFrame

_WIDTH, _FINER = 8, 1.5
"""Points of the fine grid that a place between pixels is interpolated from, and how fine it is."""
_MOST_TRIED = 49
"""Most delays at which responses are compared."""


class RowTimes(NamedTuple):
    """When the rows of pictures are exposed that are turned so that things move along rows."""

    delays: Float[np.ndarray, "d"]  # Of each later than the middle; s. A global shutter has one, 0
    is_along: bool = False  # Whether they were rows across the motion, and are columns here

    @staticmethod
    def of(sensor: Sensor, shape: tuple[int, ...]) -> "RowTimes":
        """Those of pictures of so many rows and columns, once they are turned."""
        if not sensor.is_rolling:
            return GLOBAL
        is_along = sensor.axis == "columns"
        return RowTimes(sensor.row_delays(shape[-1 if is_along else -2]), is_along)

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


def instants_of_rows(
    taken: Sequence[TimedFrame], scene: Scene, fastest: float, delays: Float[np.ndarray, "d"]
) -> Instants:
    """Instants of frames along an axis, at some delays of each of them in turn."""
    if delays.size == 1 and delays[0] == 0:
        return Instants.of(taken, fastest)
    path = path_for_rows(scene, taken)
    each = [Instants.of(path, fastest, delay=delay) for delay in delays.tolist()]
    count = max(one.time.shape[1] for one in each)

    def together(parts: list[np.ndarray], mode: str) -> np.ndarray:
        """Nodes of the frames, with all delays of one beside each other."""
        wide = [(*[(0, 0)] * (each.ndim - 1), (0, count - each.shape[-1])) for each in parts]
        padded = [np.pad(one, by, mode) for one, by in zip(parts, wide, strict=True)]  # type: ignore[call-overload]
        whole = np.stack(padded, axis=-2)
        return whole.reshape(*whole.shape[:-3], -1, count)

    return Instants(
        together([one.time for one in each], "edge"),
        together([one.place for one in each], "edge"),
        together([one.weight for one in each], "constant"),
        np.repeat(each[0].exposure, delays.size),
    )


@final
class FrameAlong(AbstractRolledFrame):
    """A frame along one axis whose rows are read along it: a matrix for each speed."""

    def __init__(self, matrix: Complex[np.ndarray, "s columns k"]):
        """Takes the response of each pixel, times the wave there from the begin of the canvas."""
        self.matrix = matrix

    def seen(self, spectrum: Complex[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
        return pixels_through(self.matrix, spectrum, 2 * (self.matrix.shape[-1] - 1))

    def told(self, frame: Float[np.ndarray, "..."]) -> Complex[np.ndarray, "..."]:
        return frame @ self.matrix.conj()

    @property
    def power(self) -> Float[np.ndarray, "s 1 k"]:
        return np.mean(np.abs(self.matrix) ** 2, axis=1, keepdims=True)


class RowsInPlane(NamedTuple):
    """Frames in the plane whose rows are exposed one after another."""

    instants: Instants  # Of the middle row
    path: PlaneFrames
    clock: float  # Time on the path's clock at which theirs is 0; s
    start: Float[np.ndarray, "2 1 1"]  # Place on the path at which theirs is 0; px of these frames
    delays: Float[np.ndarray, "rows"]  # s
    size: int  # Pixels of the sensor along a side of these
    tried: Float[np.ndarray, "d"]  # Delays at which responses are compared; s
    there: list[Instants]  # Those of rows of these delays

    @staticmethod
    def of(
        path: PlaneFrames, instants: Instants, first: int, delays: np.ndarray, size: int
    ) -> "RowsInPlane":
        """Those of instants from a frame on."""
        clock = float(path.times[first] - np.sum(instants.weight[0] * instants.time[0]))
        start = path.place(instants.time + clock) / size - instants.place
        count = delays.size // size
        binned = np.mean(delays[: count * size].reshape(count, size), axis=1)
        low, high = float(np.min(binned)), float(np.max(binned))
        # Responses change with the sensor's own way: at rest they are those of the middle row.
        way = 0.0 if path.stays else path.top_speed * (high - low) / size
        tried = np.linspace(low, high, min(2 * math.ceil(way) + 3, _MOST_TRIED))
        rows = RowsInPlane(
            instants, path, clock, np.asarray(start)[:, :1, :1], binned, size, tried, []
        )
        rows.there.extend(map(rows.at, tried.tolist()))
        return rows

    def at(self, delay: float) -> Instants:
        """Instants of a row."""
        time = self.instants.time + delay
        place = np.asarray(self.path.place(time + self.clock)) / self.size - self.start
        return self.instants._replace(time=time, place=place)

    @property
    def some(self) -> list[Instants]:
        """Those of three rows, whose mean is about that of all."""
        half = (self.delays[-1] - self.delays[0]) / 2
        return [self.at(float(half * x)) for x in np.polynomial.legendre.leggauss(3)[0]]

    def frames(
        self,
        velocity: Float[np.ndarray, "2"],  # In px of these frames
        canvas: Canvas,
        aperture: Float[np.ndarray, "m k"],
        tolerance: float,
        *,
        by_time: bool = False,
    ) -> "list[FrameInPlane]":
        r"""The way from a picture to each, to a share of the noise; or its derivative.

        The derivative is that by the velocity, but for the factor $2\pi i\,\mathbf f$.
        """
        from scipy.interpolate import CubicSpline

        tried, each = self.tried, self.there
        down, across = (min(max(64 // self.size, 16), count) for count in canvas.shape)
        grid = down, across
        places = np.array([one.middles(velocity) for one in each])  # (tried, 2, n)
        power = _on_grid(canvas.power * aperture**2, grid)

        def changed(one: Instants, shape: tuple[int, ...], by_time: bool) -> np.ndarray:
            """Responses at a delay, without the mean way."""
            way = one.displacement(velocity) - one.middles(velocity)[..., None]
            weight = one.weight * one.time if by_time else one.weight
            single = way.astype(np.float32), weight.astype(np.float32)
            return waves_in_plane(*single, frequencies_on(shape))

        def products(by_time: bool) -> Float[np.ndarray, "n d d"]:
            """Covariances of what pictures leave at two delays."""
            waves = np.stack([changed(one, grid, by_time) for one in each], axis=1)
            flat = (waves * np.sqrt(power)).reshape(*waves.shape[:2], -1)
            return np.real(flat.conj() @ np.swapaxes(flat, 1, 2)).astype(np.float64)

        if self.path.stays:
            index, weights = [1], np.ones((len(canvas.noises), 1, 3))
        else:
            own = products(False)
            most = tolerance * canvas.noises / np.mean(np.einsum("ndd->nd", own), axis=1)
            own = products(True) if by_time else own
            index, weights = _few_delays(own, most)
        rows = np.arange(self.delays.size) + canvas.margin[0]
        few = [changed(each[j], canvas.shape, by_time) * aperture for j in index]
        frames = []
        for k in range(len(canvas.noises)):
            share, place = (
                CubicSpline(tried, part)(self.delays) for part in (weights[k].T, places[:, :, k])
            )
            kernels = np.stack([one[k] for one in few])
            frames.append(FrameInPlane(kernels, share, rows - place[:, 1], place[:, 0], canvas))
        return frames


def _on_grid(power: Float[np.ndarray, "m k"], grid: tuple[int, int]) -> Float[np.ndarray, "a b"]:
    """A density on the coarser grid of another DFT, whose sum is its mean power."""
    down, across = (np.fft.fftfreq(grid[0]), np.fft.rfftfreq(grid[1]))
    rows, columns = power.shape[0], 2 * (power.shape[1] - 1)
    i = np.round(down * rows).astype(int) % rows
    j = np.round(across * columns).astype(int)
    return power[np.ix_(i, j)] * counted_in(grid[1]) / math.prod(grid)


def _few_delays(
    products: Float[np.ndarray, "n d d"], most: Float[np.ndarray, "n"]
) -> tuple[list[int], Float[np.ndarray, "n f d"]]:
    """A few delays of some, and weights by which their responses give those at all, to a share."""
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
        if np.all(left <= most * whole):
            break
    return index.tolist(), weights


@final
class FrameInPlane(AbstractRolledFrame):
    """A frame in the plane: responses at few delays, and the mean way up to each row."""

    def __init__(
        self,
        kernels: Complex[np.ndarray, "f m k"],
        share: Float[np.ndarray, "rows f"],  # Of each of them in each row
        places: Float[np.ndarray, "rows"],  # Place of each row on the canvas
        shifts: Float[np.ndarray, "rows"],  # Way along the rows; px
        canvas: Canvas,
    ):
        """Takes what `RowsInPlane.frames` has found."""
        from scipy import sparse

        dtype = np.result_type(canvas.frames, np.complex64)
        (rows, columns), self._canvas = canvas.shape, canvas
        self._fine = fine = fast_length(math.ceil(_FINER * rows))
        scale = math.pi * _WIDTH * (1 - 0.5 / _FINER) * 0.98
        nodes, weights = np.polynomial.legendre.leggauss(4 * _WIDTH)
        values = np.exp(scale * (np.sqrt(1 - nodes**2) - 1)) * weights * _WIDTH / 2
        turns = np.pi * _WIDTH * np.fft.fftfreq(rows) * rows / fine
        spread = np.cos(np.outer(turns, nodes)) @ values
        self.kernels = kernels.astype(dtype)
        self._spread = (kernels / spread[:, None]).astype(dtype)
        turn = -2j * np.pi * shifts[:, None] * np.fft.rfftfreq(columns)
        self._turn = np.exp(turn).astype(dtype)
        place = places * (fine / rows)
        near = np.ceil(place - _WIDTH / 2)[:, None] + np.arange(_WIDTH)
        window = np.exp(
            scale * (np.sqrt(np.maximum(1 - ((place[:, None] - near) * 2 / _WIDTH) ** 2, 0)) - 1)
        )
        values = share[:, :, None] * window[:, None]
        index = fine * np.arange(share.shape[1])[:, None] + near[:, None].astype(int) % fine
        row = np.broadcast_to(np.arange(places.size)[:, None, None], index.shape)
        numbers = values.ravel().astype(canvas.frames.dtype)
        shape = (places.size, fine * share.shape[1])
        self._rows = sparse.csr_array((numbers, (row.ravel(), index.ravel())), shape)

    def seen(self, spectrum: Complex[np.ndarray, "m k"]) -> Float[np.ndarray, "rows columns"]:
        passed = self._spread * spectrum
        (rows, columns), half = self._canvas.shape, spectrum.shape[0] // 2
        fine = np.zeros((len(passed), self._fine, passed.shape[2]), passed.dtype)
        fine[:, :half], fine[:, half - rows :] = passed[:, :half], passed[:, half:]
        waves: Any = scipy.fft.ifft(fine, axis=1, norm="forward", overwrite_x=True)
        turned = self._turn * (self._rows @ waves.reshape(-1, passed.shape[2]))
        first = self._canvas.margin[1]
        whole = irfftn(turned, (columns,), axes=(1,)) / rows
        return whole[:, first : first + self._canvas.sensor[1]]

    def told(self, frame: Float[np.ndarray, "rows columns"]) -> Complex[np.ndarray, "m k"]:
        canvas = self._canvas
        (rows, columns), first = canvas.shape, canvas.margin[1]
        whole = np.zeros((len(frame), columns), frame.dtype)
        whole[:, first : first + frame.shape[1]] = frame
        turned = self._turn.conj() * rfftn(whole, axes=(1,))
        fine = (self._rows.T @ turned).reshape(len(self._spread), self._fine, -1)
        waves: Any = scipy.fft.fft(fine, axis=1, overwrite_x=True)
        half = rows // 2
        kept = np.concatenate([waves[:, :half], waves[:, half - rows :]], axis=1)
        return np.sum(self._spread.conj() * kept, axis=0)

    @property
    def power(self) -> Float[np.ndarray, "m k"]:
        return np.mean(np.abs(self.kernels) ** 2, axis=0)
