r"""Frames of one picture on a real sensor: the price of registering them, and of things that leave.

Frame $k$ shows the picture through $b_k = \sqrt{SP e_k^2/N_k}\,H_k(\mathbf f, \mathbf v)$,
displacement included, and noise of the power 1, so that the frames together have
$\rho = \sum_k |b_k|^2$ of it and leave the error of `mishutter.evaluation.levels`. Both prices
follow from these $b_k$, for frames of any motion, length and time, along an axis or in the plane.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

from mishutter._core.parallel import alone_in_blas
from mishutter.evaluation.fans import MEASURED, SEARCHED, Grid
from mishutter.evaluation.instants import Frames, Instants
from mishutter.evaluation.levels import Light, fan_of, rows_of, velocities_of
from mishutter.model.exposures import Exposures
from mishutter.model.scene import Scene

REGION = 64
"""Rows and columns of the region by which an object is registered; px."""
LONG = 0.25
"""Way of a thing within one frame, over the sensor's width, above which moving frames in the plane
lose more by its borders than is counted."""
_NOTHING = 1e-22
"""Information of a sample that is one of rounding, of frames that tell no velocity; s^2/px^2."""
_PLACES = 4
"""Points that stand for a part of a sensor along an axis."""
_MOST_PARTS = 32
"""Most parts of each side of a sensor in the plane, which are all looked at in their middle."""


class Registration(NamedTuple):
    """The least error to which frames can be registered, and its cost."""

    speeds: Float[np.ndarray, "n"] | Float[np.ndarray, "n 2"]  # Speeds or velocities; px/s
    # Standard deviation of each, or of each component, in the frames; px/s
    deviation: Float[np.ndarray, "n"] | Float[np.ndarray, "n 2"]
    loss: Float[np.ndarray, "n"]  # Decibels that the level at each loses by it; shape `(n,)`


@alone_in_blas()
def registration(
    scene: Scene, frames: Frames | Exposures, *, num_samples: int = REGION**2
) -> Registration:
    r"""The Cramer-Rao bound of the velocity from a region of the frames, and what it costs.

    Frames have the covariance $C = bb^* + 1$ at each frequency, and
    $\partial b/\partial v_i = \omega_i b'$ with $\omega = 2\pi\mathbf f$: a sample holds the
    information $J_{ij} = \tfrac12\int\mathrm{tr}(C^{-1}C_iC^{-1}C_j)\,d\mathbf f$,

    $$J_{ij} = \int\omega_i\omega_j\Bigl[\frac{2 (\Re\,b^* b')^2}{(1+\rho)^2}
    + \frac{\rho\,|b'|^2 - |b^* b'|^2}{1+\rho}\Bigr]d\mathbf f .$$

    The places of an object in the frames make nearly all of the second part, and the first is of
    its blur. A decoder that is off by $\delta$ restores by $g(\mathbf v + \delta)$ in place of
    $g = \sqrt S\,b^*/(1 + \rho)$, which costs $\delta^\top L\,\delta$ with
    $L_{ij} = \int g_i C g_j^*\,d\mathbf f$, but for what only displaces the picture.
    """
    every = _Waves.of(scene, frames, MEASURED)
    velocities, _ = velocities_of(scene)
    deviation, loss = np.zeros_like(velocities), np.zeros(len(velocities))
    for share, waves in every:
        found = [waves.registered(v, num_samples) for v in velocities]
        deviation += share * np.array([each for each, _ in found])
        loss += share * np.array([each for _, each in found])
    speeds, deviation = (x if x.shape[1] > 1 else x[:, 0] for x in (velocities, deviation))
    return Registration(speeds, deviation, loss)


class _Waves(NamedTuple):
    """Frames at the frequencies of a fan, one after another."""

    frequency: Float[np.ndarray, "axes m"]  # cycles/px
    share: Float[np.ndarray, "m"]  # Share of all frequencies that each stands for
    power: Float[np.ndarray, "m"]  # Power of the picture, $S$, times the share
    signal: Float[np.ndarray, "m"]  # $SP$
    gains: Float[np.ndarray, "frames"]  # $e_k^2/N_k$
    instants: Instants

    @staticmethod
    def of(scene: Scene, frames: Frames | Exposures, grid: Grid) -> "list[tuple[float, _Waves]]":
        """The frames of a scene, which are known, for rows that stand for all and their shares."""
        rows = rows_of(scene, frames, "registration")
        return [(share, _Waves.of_row(scene, instants, grid)) for share, instants in rows]

    @staticmethod
    def of_row(scene: Scene, instants: Instants, grid: Grid) -> "_Waves":
        """The frames of a scene at the instants that a row sees."""
        fan, light = fan_of(scene, instants, grid), Light.of(scene)
        turns = (np.cos, np.sin)[: instants.place.shape[0]]
        frequency = np.stack([(fan.radius[:, None] * f(fan.direction)).ravel() for f in turns])
        power = float(light.deviation) ** 2 * np.asarray(fan.weight).ravel()
        signal = np.asarray(light.signal(fan), np.float64).ravel()
        gains = np.asarray(light.gains(instants.exposure), np.float64)
        return _Waves(frequency, fan.share.ravel(), power, signal, gains, instants)

    def at(self, way: Float[np.ndarray, "axes q"]) -> Complex[np.ndarray, "q m"]:
        """Waves of the frequencies at some places of a thing; px."""
        return np.exp(-2j * np.pi * (way.T @ self.frequency))

    def registered(
        self, velocity: Float[np.ndarray, "axes"], num_samples: int
    ) -> tuple[Float[np.ndarray, "axes"], float]:
        """Deviation of each component, px/s, and loss, dB, at one velocity."""
        time, weight = self.instants.time, self.instants.weight
        ways = np.moveaxis(self.instants.displacement(velocity), 1, 0)
        sums = np.stack(
            [
                np.stack([some, some * at]) @ self.at(way)
                for way, some, at in zip(ways, weight, time, strict=True)
            ],
            axis=1,
        )
        scale = np.sqrt(self.signal * self.gains[:, None])
        seen, slope = scale * sums[0], 1j * scale * sums[1]
        density = np.sum(np.abs(seen) ** 2, axis=0)
        every = 1 + density
        common = np.sum(seen.conj() * slope, axis=0)
        # What is common to all frames, and the rest, in which they differ.
        changed, turned = common.real, common.imag
        squares = density * np.sum(np.abs(slope) ** 2, axis=0)
        differing = np.maximum(squares - np.abs(common) ** 2, 0)
        omega = 2 * np.pi * self.frequency

        def integral(values: Float[np.ndarray, "m"]) -> Float[np.ndarray, "axes axes"]:
            return (omega * values) @ omega.T

        information = integral(self.share * (2 * (changed / every) ** 2 + differing / every))
        over = np.divide(self.power, density, where=density > 0, out=np.zeros_like(density))
        blurred = changed**2 * (1 - density) ** 2 / every**3
        excess = integral(over * (blurred + differing / every**2 + turned**2 / every))
        shift = integral(self.power * turned / every)
        if np.any(shift):
            displaced = integral(self.power * density / every)
            excess -= shift @ np.linalg.pinv(displaced) @ shift.T
        error, nothing = float(np.sum(self.power / every)), float(np.sum(self.power))
        if np.linalg.eigvalsh(information)[0] <= _NOTHING:
            return np.full(velocity.shape, math.inf), 0.0
        covariance = np.linalg.inv(num_samples * information)
        # With so uncertain a velocity, returning the mean is better.
        most = min(error + float(np.sum(covariance * excess)), nothing)
        return np.sqrt(np.diag(covariance)), decibels_over(most, error)

    def errors_of_width(
        self, velocity: Float[np.ndarray, "axes"], width: float
    ) -> Float[np.ndarray, "2"]:
        """Errors at one velocity on a sensor of a width, and on one that sees all."""
        ways = np.moveaxis(self.instants.displacement(velocity), 1, 0)
        points, shares = _points_of(ways, width)
        there, every = np.zeros((shares.size, self.power.size)), np.zeros(self.power.size)
        # Of the nearest point to each that a frame sees all the time.
        nearest, beside = np.full(points.shape, np.inf), np.zeros(shares.size)
        for way, weight, gain in zip(ways, self.instants.weight, self.gains, strict=True):
            waves = weight[:, None] * self.at(way)
            whole = np.sum(waves, axis=0)
            most = gain * np.abs(whole) ** 2
            # The sensor sees a point as long as this lies on it along each axis, and an end of it
            # passes while a node stands for the time.
            within = width / 2 - np.abs(points[..., None] + way - width / 2)
            passing = np.maximum(np.abs(np.gradient(way, axis=-1)), 1e-12)
            seen = np.prod(np.clip(within / passing + 0.5, 0, 1), axis=1)
            is_whole = np.all(seen == 1, axis=1)
            is_part = np.any(seen > 0, axis=1) & ~is_whole
            parts = seen[is_part]
            part = (parts @ waves.real) * whole.real + (parts @ waves.imag) * whole.imag
            there[is_part] += np.clip(gain * part, 0.0, most)
            there[is_whole] += most
            every += most
            gaps = np.max(np.maximum(-within, 0), axis=-1)
            is_nearer = np.sum(gaps**2, axis=1) < np.sum(nearest**2, axis=1)
            nearest[is_nearer] = gaps[is_nearer]
            beside[is_nearer] = np.sum(self.power / (1 + self.signal * most))
        errors, total = (1 / (1 + self.signal * there)) @ self.power, np.sum(self.power)
        strays = np.any(nearest > 0, axis=1)
        phases = 2 * np.pi * nearest[strays] @ self.frequency
        # The least error of a variable of which another is known that correlates with it so far.
        alike = (np.cos(phases) @ self.power / total) ** 2 if total > 0 else 0.0
        known = total + alike * (beside[strays] - total)
        errors[strays] = np.minimum(errors[strays], known)
        return np.array([shares @ errors, np.sum(self.power / (1 + self.signal * every))])


def _points_of(
    ways: Float[np.ndarray, "frames axes q"], width: float
) -> tuple[Float[np.ndarray, "p axes"], Float[np.ndarray, "p"]]:
    """Points that stand for a sensor in the middle of the frames, and their shares of it; px."""
    sides, is_plane = [], ways.shape[1] > 1
    for way in np.moveaxis(ways, 1, 0):
        ends = np.concatenate([np.min(way, axis=-1), np.max(way, axis=-1)])
        # Between neighbours of these places no frame begins or ends to see a point.
        parts = np.unique(np.clip([0.0, width, *-ends, *(width - ends)], 0, width))
        if is_plane and parts.size > _MOST_PARTS:  # of many parts each has few points
            parts = np.linspace(0, width, _MOST_PARTS + 1)
        places = 1 if is_plane else _PLACES
        steps = (np.arange(places) + 0.5) / places
        side = (parts[:-1, None] + np.diff(parts)[:, None] * steps).ravel()
        sides.append((side, np.repeat(np.diff(parts) / width / places, places)))
    along, shares = zip(*sides, strict=True)
    points = np.stack(np.meshgrid(*along, indexing="ij"), axis=-1).reshape(-1, len(along))
    return points, np.prod(np.meshgrid(*shares, indexing="ij"), axis=0).ravel()


@alone_in_blas()
def loss_of_width(scene: Scene, frames: Frames | Exposures, *, width: float | int) -> float:
    r"""Decibels that frames lose on a sensor, or an object's outline, that things enter and leave.

    A point that the sensor sees in a part of the exposures, which alone have the responses
    $H_k^u$, is restored with the error of $\sum_k \Re(\bar H_k H_k^u)e_k^2/N_k$ in place of
    $\sum_k |H_k|^2e_k^2/N_k$: at each place the sum is the symbol of what all frames together do
    to the picture. The mean is over all points of the sensor in the middle of the sequence, which
    are the picture that `restore_frames` returns. One that no frame sees throughout is as well
    known as the nearest that does lets one predict: of the correlation $c$ to that, of the
    variance $V$ and the error $E$, to $V - c^2(V - E)$.

    The best linear decoder of Gaussian rows loses some hundredths of a decibel more, on narrow
    sensors up to 0.1, and 0.3 dB more or less where a sixth of the points is in no frame; of fields
    in the plane it loses 0.1 to 0.3 dB more by four frames.

    Args:
        scene: Velocities, light and noise.
        frames: The frames, which are known.
        width: Length of the sensor along the axis, or of its sides in the plane, or those of an
            object by which it is registered; px.
    """
    velocities, weights = velocities_of(scene)
    errors = [
        share * (weights @ np.array([waves.errors_of_width(v, float(width)) for v in velocities]))
        for share, waves in _Waves.of(scene, frames, SEARCHED)
    ]
    ends, whole = np.sum(errors, axis=0)
    return decibels_over(float(ends), float(whole))


def with_losses(scene: Scene, sequence: Exposures) -> Exposures:
    """A sequence of several frames with its losses by registration and by the sensor's width."""
    if sequence.num_frames == 1:
        return sequence
    width = scene.registered_width
    ends = None if width is None else loss_of_width(scene, sequence, width=width)
    worst = float(np.max(registration(scene, sequence).loss))
    return replace(sequence, registration_loss=worst, width_loss=ends)


def decibels_over(error: float, other: float) -> float:
    """An error over another; dB. Without any error nothing is lost."""
    return 10 * math.log10(error / other) if other > 0 else 0.0
