r"""Frames of one picture on a real sensor: the price of registering them, and of things that leave.

Frame $k$ shows the picture through $b_k = \sqrt{S/N_k}\,\mathrm{sinc}(f)\,H_k(f, s)$, displacement
included, and noise of the power 1, so that the frames together have
$\rho = \sum_k |b_k|^2$ of it and leave the error $2\int_0^{1/2} S/(1 + \rho)\,df$. Both prices
follow from these $b_k$, for frames of any motion, length and time.
"""

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from mishutter._core.compiling import outside_trace
from mishutter._core.parallel import alone_in_blas
from mishutter.evaluation.needs import Plan, distinct_speeds
from mishutter.evaluation.open_frames import in_parts, psnr_of_error
from mishutter.evaluation.response import nodes_in_time
from mishutter.model.exposures import Lights
from mishutter.model.optics import frequencies, pixel_response
from mishutter.model.scene import Scene, power_on_grid
from mishutter.model.sensor import DARK, noise_power, white_electrons
from mishutter.model.sequences import FrameSequence, TimedFrame
from mishutter.model.shutters.windows import RectShutter

REGION = 64
"""Rows and columns of the region by which an object is registered; px."""
_PLACES = 4
"""Points that stand for a part of a sensor."""
_DIGIT = 32
"""Frequencies that share a digit."""


class FrameNodes(NamedTuple):
    """Instants of one frame, and where its sensor is then."""

    time: Float[np.ndarray, "q"]  # Time from the middle of the sequence; s
    place: Float[np.ndarray, "q"]  # Place of the sensor, from that at the middle of all; px
    weight: Float[np.ndarray, "q"]  # Share of the exposure, times the transmittance

    def displacement(self, speed: float) -> Float[np.ndarray, "q"]:
        """Way of a thing on the sensor since the middle of the sequence; px."""
        return self.place - speed * self.time


def nodes_of_frames(
    frames: Sequence[TimedFrame], fastest: float, lights: Lights | None = None
) -> list[FrameNodes]:
    """Quadrature nodes of each frame, for things up to a speed."""
    near, every = [], []
    with outside_trace():
        lights = _lights_of(frames) if lights is None else lights
        # The sensor has a place at the middle of the sequence, be a frame exposed then or not.
        for frame in frames:
            half = float(frame.motion.half_exposure)
            time = np.clip(-frame.time, -half, half)
            near.append((frame.time + time, frame.position + float(frame.motion.position(time))))
        times, places = zip(*sorted(near), strict=True)
        middle = float(np.interp(0.0, times, places))
        for frame, (begin, end) in zip(frames, lights, strict=True):
            half = (end - begin) / 2
            velocity = (float(frame.motion.top_speed) + fastest) * half
            tau, weight = nodes_in_time(
                RectShutter(), frame.motion, Plan.of_travel(0.0, velocity).num_nodes
            )
            time = (begin + end) / 2 + half * np.asarray(tau, np.float64)[0]
            way = np.asarray(frame.motion.position(time - frame.time), np.float64)
            place = frame.position + way - middle
            every.append(FrameNodes(time, place, np.asarray(weight, np.float64)[0]))
    return every


def _lights_of(frames: Sequence[TimedFrame]) -> Lights:
    return [(x.time - x.exposure / 2, x.time + x.exposure / 2) for x in frames]


class Registration(NamedTuple):
    """The least error to which frames can be registered, and its cost."""

    speeds: Float[np.ndarray, "n"]  # The speeds that occur in the scene, ascending; px/s
    deviation: Float[np.ndarray, "n"]  # Standard deviation of each in the frames; px/s
    loss: Float[np.ndarray, "n"]  # Decibels that the level at each loses by it; shape `(n,)`


def registration(
    scene: Scene, frames: Sequence[TimedFrame], *, num_samples: int = REGION**2
) -> Registration:
    r"""The Cramer-Rao bound of the speed from a region of the frames, and what it costs.

    Frames have the covariance $C = bb^* + 1$ at each frequency, and $b' = \partial b/\partial s$:
    a sample holds the information $J = \tfrac12\,2\int_0^{1/2}\mathrm{tr}(C^{-1}C'C^{-1}C')\,df$,

    $$J = 2\int_0^{1/2}\Bigl[\frac{2 (\Re\,b^* b')^2}{(1+\rho)^2}
    + \frac{\rho\,|b'|^2 - |b^* b'|^2}{1+\rho}\Bigr]df .$$

    The places of an object in the frames make nearly all of the second part, and the first is of
    its blur. A decoder that is off by $\delta$ restores by $g(s + \delta)$ in place of
    $g = \sqrt S\,b^*/(1 + \rho)$, which costs $\delta^2\,2\int g' C g'^*\,df$, but for what only
    displaces the picture.
    """
    parts = in_parts(scene)
    speeds, _ = distinct_speeds(parts, folds=False)
    every = [waves.registered(num_samples) for waves in _Waves.of(parts, frames, speeds)]
    deviation, loss = np.array(every).T
    return Registration(speeds, deviation, loss)


class _Waves(NamedTuple):
    """Frames at one speed, on a frequency grid."""

    power: Float[np.ndarray, "m"]  # Power of the picture, $S$
    frequency: Float[np.ndarray, "m"]  # cycles/px
    scale: Float[np.ndarray, "frames m"]  # $b_k/H_k$
    ways: list[Float[np.ndarray, "q"]]  # Way of a thing at the nodes of each frame; px
    nodes: list[FrameNodes]  # Instants of each frame

    @staticmethod
    def of(
        scene: Scene,
        frames: Sequence[TimedFrame],
        speeds: Float[np.ndarray, "n"],
        lights: Lights | None = None,
    ) -> Iterator["_Waves"]:
        """The frames at each of some speeds, in whole or as long as they are lit."""
        lights = _lights_of(frames) if lights is None else lights
        nodes = nodes_of_frames(frames, float(np.max(np.abs(speeds))), lights)
        reach = max(float(np.ptp(x.displacement(float(s)))) for x in nodes for s in speeds[[0, -1]])
        count = _DIGIT * math.ceil(max(512, 2 * reach) / _DIGIT)
        frequency, power = frequencies(count), power_on_grid(scene, count)
        blur, rate = float(scene.optics.lens_blur), float(scene.photon_rate)
        electrons = np.array([white_electrons(rate, end - begin) for begin, end in lights])
        mean, read = float(scene.picture.mean_level), float(scene.read_noise)
        noise = noise_power(1.0, mean, electrons, read)
        noise = np.maximum(noise, DARK * electrons.clip(1.0) ** 2)
        aperture = np.asarray(pixel_response(frequency, blur)) * np.sqrt(power)
        scale = aperture * (electrons / np.sqrt(noise))[:, None]
        for speed in speeds.tolist():
            ways = [some.displacement(speed) for some in nodes]
            yield _Waves(power, frequency, scale, ways, nodes)

    @alone_in_blas()
    def registered(self, num_samples: int) -> tuple[float, float]:
        """Deviation, px/s, and loss, dB, at one speed."""
        sums = np.stack(
            [
                np.stack([np.ones_like(way), some.time])
                @ _on_grid(way, some.weight, self.frequency.size)
                for way, some in zip(self.ways, self.nodes, strict=True)
            ],
            axis=1,
        )
        omega, power = 2 * np.pi * self.frequency, self.power
        seen, slope = self.scale * sums[0], self.scale * sums[1] * 1j * omega
        density = np.sum(np.abs(seen) ** 2, axis=0)
        every = 1 + density
        common = np.sum(seen.conj() * slope, axis=0)
        # What is common to all frames, and the rest, in which they differ.
        changed, turned = common.real, common.imag
        squares = density * np.sum(np.abs(slope) ** 2, axis=0)
        differing = np.maximum(squares - np.abs(common) ** 2, 0)
        information = np.mean(2 * (changed / every) ** 2 + differing / every)
        over = np.divide(power, density, where=density > 0, out=np.zeros_like(power))
        blurred = changed**2 * (1 - density) ** 2 / every**3
        excess = np.mean(over * (blurred + differing / every**2 + turned**2 / every))
        shift = np.mean(power * omega * turned / every)
        if shift:
            excess -= shift**2 / np.mean(power * omega**2 * density / every)
        error, nothing = float(np.mean(power / every)), float(np.mean(power))
        if information <= 0:
            return math.inf, decibels_over(nothing, error) if excess > 0 else 0.0
        variance = float(1 / (num_samples * information))
        # With so uncertain a speed, returning the mean is better.
        return math.sqrt(variance), decibels_over(min(error + variance * excess, nothing), error)

    def errors_of_width(self, width: float | int) -> tuple[float, float]:
        """Errors on a sensor of a width, and on one that sees all."""
        ends = np.array([end for way in self.ways for end in (np.min(way), np.max(way))])
        # Between neighbours of these places no frame begins or ends to see a point.
        parts = np.unique(np.clip([0.0, width, *-ends, *(width - ends)], 0, width))
        steps = (np.arange(_PLACES) + 0.5) / _PLACES
        points = (parts[:-1, None] + np.diff(parts)[:, None] * steps).ravel()
        shares = np.repeat(np.diff(parts) / width / _PLACES, _PLACES)
        there = np.zeros((points.size, self.power.size))
        every = np.zeros(self.power.size)
        for k, (way, some) in enumerate(zip(self.ways, self.nodes, strict=True)):
            order = np.argsort(way)
            waves_in_order = _on_grid(way[order], some.weight[order], self.power.size)
            # `np.cumsum` along the first axis takes many times as long.
            added = np.array([*itertools.accumulate(waves_in_order, initial=0 * waves_in_order[0])])
            # From the first to the last place at which the sensor sees a point.
            begin, end = (np.searchsorted(way[order], x - points) for x in (0.0, width))
            squared, whole = self.scale[k] ** 2, np.abs(added[-1]) ** 2
            part = (added[-1].conj() * (added[end] - added[begin])).real
            there += squared * np.clip(part, 0.0, whole)
            every += squared * whole
        errors = np.mean(self.power / (1 + there), axis=1)
        return float(shares @ errors), float(np.mean(self.power / (1 + every)))


def _on_grid(
    place: Float[np.ndarray, "q"], weight: Float[np.ndarray, "q"], count: int
) -> Complex[np.ndarray, "q {count}"]:
    r"""$w_q e^{-2\pi i f x_q}$ at the frequencies of a grid.

    The wave of a frequency is the product of the waves of its higher and of its lower digits.
    """
    phase = place[:, None] * (-1j * np.pi / count)
    low = weight[:, None] * np.exp(phase * (np.arange(_DIGIT) + 0.5))
    high = np.exp(phase * np.arange(0, count, _DIGIT))
    return (high[:, :, None] * low[:, None, :]).reshape(-1, count)


@alone_in_blas()
def psnr_of_frames(
    scene: Scene, frames: Sequence[TimedFrame], *, lights: Lights | None = None
) -> float:
    """PSNR of the best linear decoder, which knows the speed from the frames; dB."""
    parts = in_parts(scene)
    speeds, weights = distinct_speeds(parts, folds=False)
    errors = []
    for waves in _Waves.of(parts, frames, speeds, lights):
        density = np.zeros_like(waves.power)
        for way, some, scale in zip(waves.ways, waves.nodes, waves.scale, strict=True):
            passed = np.sum(_on_grid(way, some.weight, waves.power.size), axis=0)
            density += scale**2 * np.abs(passed) ** 2
        errors.append(float(np.mean(waves.power / (1 + density))))
    weights = np.asarray(weights, np.float64)
    return psnr_of_error(float(weights @ errors / weights.sum()))


def loss_of_width(scene: Scene, frames: Sequence[TimedFrame], *, width: float | int) -> float:
    r"""Decibels that frames lose on a sensor that things enter and leave.

    A point that the sensor sees in a part of the exposures, which alone have the responses
    $H_k^u$, is restored with the error
    $2\int_0^{1/2} S/(1 + S\,\mathrm{sinc}^2 f\sum_k \Re(\bar H_k H_k^u)/N_k)\,df$: at each place
    the sum is the symbol of what all frames together do to the picture. The mean is over all points
    of the sensor at the middle of the sequence, which are the picture that `restore_frames`
    returns. The best linear decoder of Gaussian rows loses some hundredths of a decibel more, on
    narrow sensors up to 0.1.
    """
    parts = in_parts(scene)
    speeds, weights = distinct_speeds(parts, folds=False)
    errors = [waves.errors_of_width(width) for waves in _Waves.of(parts, frames, speeds)]
    ends, whole = np.asarray(weights, np.float64) @ np.array(errors)
    return decibels_over(ends, whole)


def with_losses(scene: Scene, sequence: FrameSequence) -> FrameSequence:
    """A sequence of several frames with its losses by registration and by the sensor's width."""
    if sequence.num_frames == 1:
        return sequence
    frames, width = sequence.frames, scene.registered_width
    ends = None if width is None else loss_of_width(scene, frames, width=width)
    worst = float(np.max(registration(scene, frames).loss))
    return replace(sequence, registration_loss=worst, width_loss=ends)


def decibels_over(error: float, other: float) -> float:
    """An error over another; dB. Without any error nothing is lost."""
    return 10 * math.log10(error / other) if other > 0 else 0.0
