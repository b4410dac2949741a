"""The way of a stage over frames, told from where it is while they are exposed."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from mishutter.model.exposures import Exposures
from mishutter.model.frame_path import AT_REST, SINE
from mishutter.search.frame_ties import (
    ALTERNATING,
    BRACKETED,
    CIRCLE,
    CROSSED,
    FAN,
    FOLLOW,
    FREE,
    PAN,
    RING,
    STILLS,
    SWEEP,
    SWINGS,
    TWO_SINES,
)

_STEPS = 48
"""Steps of each frame, over which velocities are means: whole ones of most numbers of pieces."""
_STRAIGHT = 0.25
"""Way aside of a pan below which a frame is one; px."""
_BENT = 0.25
"""Share of a gain of velocity by which a parabola may differ from one on the way."""
_ALIKE = 0.05
"""Share of the greatest speed by which the velocities of one pan may differ."""
_WAVY = 0.2
"""Share of a velocity by which a sine may differ from it, as pieces of constant acceleration do."""
_MOST_TURNS = 1.25
"""Turns of a sine in each frame, above which none is looked for."""


def kind_of(exposures: Exposures) -> str:
    """The way of a stage over exposures; that of the sensor where the camera alone turns."""
    if not exposures.moves:
        lengths = exposures.exposures
        return STILLS if np.ptp(lengths) <= 1e-6 * max(lengths) else BRACKETED
    if exposures.kind == SINE:  # between the frames too
        return SINE
    every = _Ways.of(exposures)
    if every.flights_back:
        return FOLLOW
    if every.is_straight:
        middle = np.mean(every.velocity, axis=1)
        apart = np.max(np.linalg.norm(middle - middle[0], axis=-1))
        if apart < _ALIKE * np.max(np.linalg.norm(middle, axis=-1)):
            return PAN
        return FAN if every.along is not None else RING
    return _on_two_axes(every) if every.along is None else _on_axis(every, every.along)


def flights_back(exposures: Exposures) -> int:
    """How often a stage that follows things flies back between frames."""
    return _Ways.of(exposures).flights_back


class _Ways(NamedTuple):
    """Places and velocities in the exposures in which the sensor moves."""

    time: Float[np.ndarray, "n q"]  # Middles of the steps; s
    place: Float[np.ndarray, "n q+1 axes"]  # px
    velocity: Float[np.ndarray, "n q axes"]  # px/s

    @staticmethod
    def of(exposures: Exposures) -> "_Ways":
        """Those of the stage, or of the sensor where the stage rests."""
        lights = np.array(exposures.lights)
        times = lights[:, :1] + np.diff(lights) * np.linspace(0, 1, _STEPS + 1)
        place = exposures.place(times)
        stage = place - np.atleast_1d(exposures.pan)[:, None, None] * times
        stage_moves = np.max(np.ptp(stage, axis=-1)) >= AT_REST
        moving = ~np.array(exposures.rests)
        times = times[moving]
        place = np.moveaxis(stage if stage_moves else place, 0, -1)[moving]
        velocity = np.diff(place, axis=1) / np.diff(times, axis=1)[..., None]
        return _Ways((times[:, 1:] + times[:, :-1]) / 2, place, velocity)

    @property
    def along(self) -> Float[np.ndarray, "n q"] | None:
        """Velocities along the one direction in which it moves; px/s. None in the plane."""
        axes = self.velocity.shape[-1]
        _, sizes, units = np.linalg.svd(self.velocity.reshape(-1, axes), full_matrices=False)
        is_one = axes == 1 or sizes[1] < 1e-3 * sizes[0]
        return self.velocity @ units[0] if is_one else None

    @property
    def flights_back(self) -> int:
        """How often it comes back between frames, where it moves one way in all of them."""
        middle = np.mean(self.velocity, axis=(0, 1))
        unit = middle / max(float(np.linalg.norm(middle)), np.finfo(float).tiny)
        between = (self.place[1:, 0] - self.place[:-1, -1]) @ unit
        goes_one_way = np.all(self.velocity @ unit >= 0)
        return int(np.sum(between < -_STRAIGHT)) if goes_one_way else 0

    @property
    def is_straight(self) -> bool:
        """Whether it moves at one velocity in each frame."""
        first, last = self.place[:, :1], self.place[:, -1:]
        chord = first + np.linspace(0, 1, _STEPS + 1)[:, None] * (last - first)
        aside = np.max(np.linalg.norm(self.place - chord, axis=-1), axis=1)
        lengths = np.linalg.norm(last - first, axis=-1)[:, 0]
        return bool(np.all(aside < np.maximum(_STRAIGHT, 0.02 * lengths)))


def _ends(velocity: Float[np.ndarray, "n q"]) -> Float[np.ndarray, "n 2"]:
    """Velocities at the begin and the end of each frame; px/s."""
    first = velocity[:, 0] + (velocity[:, 0] - velocity[:, 1]) / 2
    return np.stack([first, velocity[:, -1] + (velocity[:, -1] - velocity[:, -2]) / 2], axis=1)


def _bend(velocity: Float[np.ndarray, "n q"]) -> Float[np.ndarray, "n"]:
    """Greatest change of the velocity beside a parabola's, over that from begin to end."""
    ends = _ends(velocity)
    share = (np.arange(_STEPS) + 0.5) / _STEPS
    parabola = ends[:, :1] + np.diff(ends) * share
    return np.max(np.abs(velocity - parabola), axis=1) / np.abs(np.diff(ends)[:, 0])


def _on_axis(every: _Ways, velocity: Float[np.ndarray, "n q"]) -> str:
    """The way along one direction."""
    ends = _ends(velocity)
    gains, middle = ends[:, 1] - ends[:, 0], np.mean(ends, axis=1)
    if np.all(ends[:, 0] * ends[:, 1] < 0):
        is_parabola = np.all(_bend(velocity) < _BENT)
        return ALTERNATING if is_parabola and np.all(gains[1:] * gains[:-1] < 0) else SWINGS
    rates = gains / (every.time[:, -1] - every.time[:, 0])
    is_even = np.ptp(rates) < 0.5 * np.max(np.abs(rates))
    turns = ends[0, 0] * ends[-1, 1] < 0
    return SWEEP if turns and is_even and np.all(np.diff(middle) * gains[0] > 0) else FREE


def _on_two_axes(every: _Ways) -> str:
    """The way in the plane."""
    if _is_crossed(every.velocity):
        return CROSSED
    time, plane = every.time.ravel(), every.velocity.reshape(-1, 2).T
    turning = plane[0] + 1j * plane[1]
    turns = np.arange(0.25, max(2.0, _MOST_TURNS * len(every.time)), 0.05)
    rates = 2 * np.pi * turns / np.ptp(time)
    at_least_half = rates[turns >= 0.5]
    one_way = np.concatenate([at_least_half, -at_least_half])
    if _beside_waves(time, turning, one_way, both_ways=False) < _WAVY:
        return CIRCLE
    sines = [_beside_waves(time, axis, rates, both_ways=True) for axis in plane]
    return TWO_SINES if max(sines) < _WAVY else FREE


def _is_crossed(velocity: Float[np.ndarray, "n q 2"]) -> bool:
    """Whether it swings along a line in each frame, across that of the frame before."""
    units = []
    for frame in velocity:
        _, sizes, lines = np.linalg.svd(frame, full_matrices=False)
        along = frame @ lines[0]
        if sizes[1] > _ALIKE * sizes[0] or along[0] * along[-1] >= 0:
            return False
        units.append(lines[0])
    each = np.array(units)
    return len(each) > 1 and bool(np.all(np.abs(np.sum(each[1:] * each[:-1], axis=1)) < 0.5))


def _beside_waves(
    time: Float[np.ndarray, "m"], values: np.ndarray, rates: np.ndarray, *, both_ways: bool
) -> float:
    """Least share of some values, about their mean, that a wave of one of some rates leaves."""
    least = np.inf
    for rate in rates:
        wave = np.exp(1j * rate * time)
        columns = np.stack(
            [np.ones_like(wave), wave, *([wave.conj()] if both_ways else [])], axis=1
        )
        fitted = columns @ np.linalg.lstsq(columns, values.astype(complex), rcond=None)[0]
        least = min(least, float(np.linalg.norm(values - fitted)))
    spread = float(np.linalg.norm(values - np.mean(values)))
    return least / spread if spread > 0 else 0.0
