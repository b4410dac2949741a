"""Errors of many frames of open shutters along an axis, for searches that ask for hundreds.

The formula is that of `mishutter.evaluation.levels`. An open frame at rest has a sinc for its
response; frames that share the path of the sensor share the waves of the things that pass.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from mishutter.evaluation.fans import Fan
from mishutter.evaluation.instants import NODES, PX_A_PANEL
from mishutter.evaluation.levels import Light, in_parts, power_of_waves
from mishutter.evaluation.levels import psnr_of_error as psnr_of_error
from mishutter.evaluation.needs import distinct_speeds, sizes
from mishutter.model.motion import LinearMotion
from mishutter.model.scene import Scene

Places = Callable[[Float[np.ndarray, "q"]], Float[np.ndarray, "k q"]]
"""Places of the sensor in some frames at times from their mid-exposures; px, s."""


@dataclass(frozen=True)
class OpenFrames:
    """Frames of open shutters, and their errors for a decoder that knows the speed."""

    scene: Scene  # Light and noise
    speeds: Float[np.ndarray, "n"]  # Speeds that occur, ascending; px/s
    weights: Float[np.ndarray, "n"]  # How often each occurs; their sum is 1
    fan: Fan  # Frequencies of the axis, and the picture's power at them
    precision: type = np.float64  # Type of the numbers that waves are computed in

    @staticmethod
    def of(scene: Scene, longest: float, *, folds: bool) -> "OpenFrames":
        """The frames of a scene."""
        scene = in_parts(scene)
        speeds, weights = (x.astype(np.float64) for x in distinct_speeds(scene, folds=folds))
        count = sizes(scene, LinearMotion(half_exposure=longest / 2)).num_frequencies
        return OpenFrames(scene, speeds, weights / weights.sum(), Fan.of_axis(scene, count))

    def coarser(self) -> "OpenFrames":
        """The same at few frequencies, most of them low, in single precision."""
        count = self.fan.radius.size
        # Of 96 frequencies bursts can be told apart.
        ends = np.unique(np.round(count * np.linspace(0, 1, 1 + 96) ** 2).astype(int))
        sums = [np.add.reduceat(x, ends[:-1]) for x in self.fan]
        radius, direction, power = (
            x / np.diff(ends).reshape(-1, *(1,) * (x.ndim - 1)) for x in sums[:-1]
        )
        return replace(self, fan=Fan(radius, direction, power, sums[-1]), precision=np.float32)

    @cached_property
    def _signal(self) -> tuple[Light, Float[np.ndarray, "m"]]:
        light = Light.of(self.scene)
        return light, np.asarray(light.signal(self.fan))[:, 0]

    def at_rest(self, exposure: float) -> Float[np.ndarray, "n m"]:
        """Power that passes one frame at rest, by speed and frequency."""
        return np.sinc(self.fan.radius * exposure * self.speeds[:, None]) ** 2

    def on_paths(self, places: Places, exposure: float, fastest: float) -> Float[np.ndarray, "n m"]:
        """Power that passes some frames together, by speed and frequency."""
        # Low frequencies, which are most of a search's, need fewer nodes.
        parts = [
            self._passed(places, exposure / 2, fastest, frequency)
            for frequency in np.array_split(self.fan.radius, 3)
        ]
        return np.concatenate(parts, axis=1)

    def _passed(
        self, places: Places, half: float, fastest: float, frequency: Float[np.ndarray, "m"]
    ) -> Float[np.ndarray, "n m"]:
        """Power that passes at some frequencies."""
        count = 1 + int(4 * float(frequency[-1]) * fastest * half / PX_A_PANEL)
        x, weights = np.polynomial.legendre.leggauss(NODES)
        middles = (2 * np.arange(count) + 1) / count - 1
        times = half * (middles[:, None] + x / count).ravel()
        weights = np.tile(weights / (2 * count), count).astype(self.precision)
        turns = (2 * np.pi * frequency).astype(self.precision)[:, None, None]
        on_sensor, passing = (
            turns * x.astype(self.precision)[None]
            for x in (places(times), self.speeds[:, None] * times)
        )
        return np.sum(power_of_waves(on_sensor, passing, weights[None, None]), axis=1).T

    def snr(self, passed: Float[np.ndarray, "n m"], exposure: float) -> Float[np.ndarray, "n m"]:
        """Power of the picture over that of the noise in frames of an exposure."""
        light, signal = self._signal
        return signal * passed * light.gains(np.array([exposure]))

    def errors(self, gained: Float[np.ndarray, "n m"]) -> Float[np.ndarray, "n"]:
        """Squared error that is left at each speed; white = 1."""
        return self._signal[0].deviation ** 2 / (1 + gained) @ self.fan.weight[:, 0]

    def error(self, gained: Float[np.ndarray, "n m"], *, at_worst: bool = False) -> float:
        """Squared error that is left in the mean over the speeds, or at the worst of them."""
        errors = self.errors(gained)
        return float(np.max(errors) if at_worst else self.weights @ errors)
