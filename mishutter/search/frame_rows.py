r"""The level of frames in the mean over rows that are read one after another, with its gradient.

A row of the delay $d$ sees the part of the stage's path that is $d$ later: parts of the frames,
which accelerate constantly, of the gentlest ways between them, and of how the stage comes and goes.
With the share $s_p$ of an exposure that part $p$ lasts, its phase in the middle $\varphi_p$ and its
own response $h_p$, a frame's is

$$H = \sum_p s_p\,e^{-i\varphi_p}\,h_p,$$

in the closed form of `mishutter.search.frame_levels`. Shares and phases are linear in six numbers
of each part. The derivatives by these are in closed form, and theirs by numbers of the frames are
differences, as those of limits are.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float, Int

from mishutter.evaluation.levels import ROWS, psnr_of_error
from mishutter.model.frame_path import FramePath
from mishutter.model.stages import Knots, gentlest
from mishutter.search.frame_levels import Frames, Levels, chirps
from mishutter.search.frame_limits import Room

_STEP = 1e-7
"""Step of the differences of numbers of frames, which are of the order of 1."""
_NO_LIGHT = 1e-9
"""Share of an exposure below which a part counts for nothing."""
_TINY, _NONE = np.finfo(float).tiny, np.zeros(1)

Point = Float[np.ndarray, "v"]


class _Way(NamedTuple):
    """A way of a sensor along an axis, of pieces of constant acceleration."""

    times: Float[np.ndarray, "*b p+1"]  # Ends of its pieces, from the first light; s
    velocities: Float[np.ndarray, "*b p+1"]  # There; px/s
    places: Float[np.ndarray, "*b p+1"]  # There; px

    @staticmethod
    def of(knots: Knots, wait: float = 0.0, pan: Float[np.ndarray, "*b 1"] = _NONE) -> "_Way":
        """That of a stage, which keeps its velocities for a time before and after, s."""
        d, v = knots.durations, knots.velocities
        longer = np.full_like(d[..., :1], wait)
        d = np.concatenate([longer, d, longer], axis=-1)
        v = np.concatenate([v[..., :1], v, v[..., -1:]], axis=-1) + pan
        times = np.concatenate([0 * longer, np.cumsum(d, axis=-1)], axis=-1)
        places = np.asarray(Knots(d, v, None, 0, d.shape[-1]).positions)
        return _Way(times - times[..., knots.first + 1, None], v, places)


class _Windows(NamedTuple):
    """Times from first to last light of frames in rows that stand for all."""

    begin: Float[np.ndarray, "*b d n"]  # s, from the first light in the middle row
    exposure: Float[np.ndarray, "*b 1 n"]  # s

    @staticmethod
    def of(
        begin: Float[np.ndarray, "*b n"], exposure: Float[np.ndarray, "*b n"], readout: float
    ) -> "_Windows":
        """Those of frames that begin at some times in the middle row, s, for a readout, s."""
        return _Windows(begin[..., None, :] + readout * ROWS[0, :, None], exposure[..., None, :])


class _Lit(NamedTuple):
    """The parts of a way that rows see in frames."""

    row: Int[np.ndarray, "q"]
    frame: Int[np.ndarray, "q"]
    piece: Int[np.ndarray, "q"]  # Of the way

    @staticmethod
    def of(way: _Way, windows: _Windows) -> "_Lit":
        """Those of a way, in the order of rows and frames."""
        begin, end = windows.begin[..., None], (windows.begin + windows.exposure)[..., None]
        lasting = np.minimum(end, way.times[1:]) - np.maximum(begin, way.times[:-1])
        return _Lit(*np.nonzero(lasting > _NO_LIGHT * windows.exposure[..., None]))

    @property
    def begins(self) -> Int[np.ndarray, "w"]:
        """The first part of each frame in each row."""
        return np.flatnonzero(np.diff(self.frame, prepend=-1) | np.diff(self.row, prepend=-1))

    def numbers(self, way: _Way, windows: _Windows) -> Float[np.ndarray, "*b q 6"]:
        """Six numbers of each part, px and s.

        They are the way over it, its duration, its gain of velocity times that, place and time of
        its middle, and its share of the exposure.
        """
        begin = windows.begin[..., self.row, self.frame]
        exposure = windows.exposure[..., 0, self.frame]
        since, until = way.times[..., self.piece], way.times[..., self.piece + 1]
        start = way.velocities[..., self.piece]
        # A ramp may come to nothing where numbers of frames are changed.
        whole = np.maximum(until - since, _NO_LIGHT * exposure)
        rate = (way.velocities[..., self.piece + 1] - start) / whole
        first, last = np.maximum(begin, since), np.minimum(begin + exposure, until)
        lasting, middle = last - first, (first + last) / 2
        after = middle - since
        numbers = (
            lasting * (start + rate * after),
            lasting,
            lasting * lasting * rate,
            way.places[..., self.piece] + after * (start + rate * after / 2),
            middle,
            lasting / exposure,
        )
        return np.stack(numbers, axis=-1)


class _Seen(NamedTuple):
    """Responses of the parts of a way, and of frames in rows."""

    moments: list[Complex[np.ndarray, "q m l"]]  # $e^{-i\varphi_p}h_p$, and its two moments
    frames: Complex[np.ndarray, "d n m l"]

    @staticmethod
    def of(levels: Levels, numbers: Float[np.ndarray, "q 6"], lit: _Lit) -> "_Seen":
        """Those of parts by their numbers."""
        way, lasting, gain, place, time, share = numbers.T[..., None, None]
        linear = np.pi * (way * levels.frequency - lasting * levels.temporal)
        square = np.broadcast_to(np.pi / 4 * gain * levels.frequency, linear.shape)
        wave = np.exp(-2j * np.pi * (place * levels.frequency - time * levels.temporal))
        moments = [wave * moment for moment in chirps(linear, square)]
        seen = np.add.reduceat(share * moments[0], lit.begins)
        return _Seen(moments, seen.reshape(ROWS.shape[1], -1, *seen.shape[1:]))

    def lost(self, levels: Levels, exposure: Float[np.ndarray, "n"]) -> tuple[np.ndarray, ...]:
        """Each row's part of the error that is left, and how fast it falls by what is gained."""
        gains = np.asarray(levels.light.gains(exposure))
        over = 1 + levels.signal[:, None] * np.tensordot(np.abs(self.frames) ** 2, gains, (1, 0))
        left = ROWS[1, :, None, None] * levels.weight / over
        return left, left * levels.signal[:, None] / over


def errors_by_rows(levels: Levels, path: FramePath, readout: float) -> Float[np.ndarray, "m l"]:
    """Error that is left in the mean over rows, at each frequency by each velocity; white = 1.

    Args:
        levels: Errors of the scene along an axis.
        path: The path that all rows see, of pieces of constant acceleration.
        readout: Time from the first row to the last; s.
    """
    every = path.times, path.exposures, path.durations, path.velocities[0]
    times, exposures, d, v = (np.asarray(each, np.float64) for each in every)
    begin = times - exposures / 2
    windows = _Windows.of(begin - begin[0], exposures, readout)
    way = _Way.of(Knots(d, v, None, 0, d.size))
    way = way._replace(times=way.times - path.lead)
    lit = _Lit.of(way, windows)
    seen = _Seen.of(levels, lit.numbers(way, windows), lit)
    return np.sum(seen.lost(levels, exposures)[0], axis=0)


class RowLevels(NamedTuple):
    """Errors of frames along an axis in the mean over rows that are exposed one after another."""

    levels: Levels
    room: Room
    readout: float  # Time from the first row to the last; s
    goes_on: bool  # Whether the path goes on as its mirror image beyond the frames, or from rest

    def slope(self, frames_of: Callable[[np.ndarray], Frames], x: Point) -> tuple[float, Point]:
        r"""$10\log_{10} E$ and its derivatives by all numbers that frames are of."""
        frames, (frequency, temporal) = frames_of(x), self.levels[:2]
        way, windows = self._way(frames), self._windows(frames)
        lit = _Lit.of(way, windows)
        numbers = lit.numbers(way, windows)
        seen = _Seen.of(self.levels, numbers, lit)
        left, by_gain = seen.lost(self.levels, frames.exposure)
        error = float(np.sum(left))
        gains = np.asarray(self.levels.light.gains(frames.exposure))[:, None, None]
        turned = (-2 * seen.frames.conj() * gains * by_gain[:, None])[lit.row, lit.frame]
        whole, first, second = (turned * moment for moment in seen.moments)
        share = numbers[:, 5, None, None]
        by_phase, by_linear, by_square = (share * np.imag(each) for each in (whole, first, second))
        each = (
            by_linear * frequency,
            -by_linear * temporal,
            by_square * frequency / 4,
            2 * by_phase * frequency,
            -2 * by_phase * temporal,
            np.real(whole) / np.pi,
        )
        by_number = np.pi * np.stack([np.sum(x, axis=(1, 2)) for x in each], axis=-1)
        gained = -np.sum(by_gain[:, None] * np.abs(seen.frames) ** 2, axis=(0, 2, 3))
        by_exposure = self.levels.gain_slope(frames.exposure) / frames.exposure * gained
        near = frames_of(x + _STEP * np.eye(x.size))
        moved = lit.numbers(self._way(near), self._windows(near)) - numbers
        slope = np.tensordot(moved, by_number, 2) + (near.exposure - frames.exposure) @ by_exposure
        return -psnr_of_error(error), 10 / np.log(10) / max(error, _TINY) * slope / _STEP

    def _windows(self, frames: Frames) -> _Windows:
        """Those of frames."""
        return _Windows.of(frames.begins, frames.exposure, self.readout)

    def _way(self, frames: Frames) -> _Way:
        """The way of the sensor, with that of the stage between the frames and beyond them."""
        stage = frames.stage[..., 0]
        begins, ends = stage[..., 0], stage[..., 1:]
        step = np.broadcast_to(frames.steps, ends.shape)
        pair = ends[..., :-1, -1], begins[..., 1:]
        rate, coasting = gentlest(frames.between[..., 0], frames.gap, *pair, self.room.top_speed)
        rise, fall = (abs(coasting - v) / np.maximum(rate, _TINY) for v in pair)
        gaps = rise, np.maximum(frames.gap - rise - fall, 0.0), fall
        d = _in_turn(step, np.stack(gaps, axis=-1))
        v = _in_turn(ends, np.stack([coasting, coasting, pair[1]], axis=-1))
        v = np.concatenate([begins[..., :1], v], axis=-1)
        lit = Knots(d, v, None, 0, d.shape[-1])
        if self.goes_on:
            d = np.concatenate([d[..., ::-1], d, d[..., ::-1]], axis=-1)
            v = np.concatenate([v[..., :0:-1], v, v[..., -2::-1]], axis=-1)
            way = Knots(d, v, None, lit.last, 2 * lit.last)
        else:
            way = lit.from_rest_to_rest((0.0, 0.0), self.room.acceleration)
        return _Way.of(way, self.readout, frames.pan)


def _in_turn(
    frames: Float[np.ndarray, "*b n j"], between: Float[np.ndarray, "*b n-1 k"]
) -> Float[np.ndarray, "*b p"]:
    """Numbers of the pieces of each frame and of the way to the next."""
    first = np.concatenate([frames[..., :-1, :], between], axis=-1)
    return np.concatenate([first.reshape(*first.shape[:-2], -1), frames[..., -1, :]], axis=-1)
