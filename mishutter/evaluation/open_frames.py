"""Errors of frames of open shutters at rest along an axis, for searches that ask for hundreds.

The formula is that of `mishutter.evaluation.levels`. An open frame at rest has a sinc for its
response.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from mishutter.evaluation.fans import Fan
from mishutter.evaluation.levels import Light, in_parts
from mishutter.evaluation.levels import psnr_of_error as psnr_of_error
from mishutter.evaluation.needs import distinct_speeds, sizes
from mishutter.evaluation.strips import Strips
from mishutter.model.motion import LinearMotion
from mishutter.model.scene import Scene


@dataclass(frozen=True)
class OpenFrames:
    """Frames of open shutters, and their errors for a decoder that knows the speed."""

    scene: Scene  # Light and noise
    speeds: Float[np.ndarray, "n"]  # Speeds that occur, ascending; px/s
    weights: Float[np.ndarray, "n"]  # How often each occurs; their sum is 1
    fan: Fan  # Frequencies of the axis, and the picture's power at them
    strips: Strips | None  # What objects hide of a background at rest

    @staticmethod
    def of(scene: Scene, longest: float, *, folds: bool) -> "OpenFrames":
        """The frames of a scene."""
        strips, scene = Strips.of(scene), in_parts(scene)
        speeds, weights = (x.astype(np.float64) for x in distinct_speeds(scene, folds=folds))
        count = sizes(scene, LinearMotion(half_exposure=longest / 2)).num_frequencies
        return OpenFrames(scene, speeds, weights / weights.sum(), Fan.of_axis(scene, count), strips)

    @cached_property
    def _signal(self) -> tuple[Light, Float[np.ndarray, "m"]]:
        light = Light.of(self.scene)
        return light, np.asarray(light.signal(self.fan))[:, 0]

    def at_rest(self, exposure: float) -> Float[np.ndarray, "n m"]:
        """Power that passes one frame at rest, by speed and frequency."""
        return np.sinc(self.fan.radius * exposure * self.speeds[:, None]) ** 2

    def snr(self, passed: Float[np.ndarray, "n m"], exposure: float) -> Float[np.ndarray, "n m"]:
        """Power of the picture over that of the noise in frames of an exposure."""
        light, signal = self._signal
        return signal * passed * light.gains(np.array([exposure]))

    def errors(self, gained: Float[np.ndarray, "n m"]) -> Float[np.ndarray, "n"]:
        """Squared error that is left at each speed; white = 1."""
        return float(self._signal[0].deviation) ** 2 / (1 + gained) @ self.fan.weight[:, 0]

    def error(
        self, gained: Float[np.ndarray, "n m"], *, at_worst: bool = False, hidden: float = 0.0
    ) -> float:
        """Squared error that is left in the mean over the speeds, or at the worst of them.

        What edges leave more of a picture, `error_of_edges`, is the background's.
        """
        errors = self.errors(gained)
        if hidden:
            behind = np.abs(self.speeds) == np.min(np.abs(self.speeds))
            errors = errors + hidden * behind / self.weights[behind]
        return float(np.max(errors) if at_worst else self.weights @ errors)

    def error_of_edges(
        self, exposures: Float[np.ndarray, "n"], moments: Float[np.ndarray, "n"]
    ) -> float:
        """Squared error that frames at some times leave more in strips and at outlines."""
        if self.strips is None:
            return 0.0
        light, signal = self._signal
        gains = light.gains(exposures)
        shares, told = self.strips.beside(moments, exposures)
        seen = np.append(told @ gains, gains.sum())
        errors = light.deviation**2 / (1 + seen[:, None] * signal) @ self.fan.weight[:, 0]
        outlines = light.deviation**2 * self.strips.outlines(exposures)
        return float(shares @ (errors[:-1] - errors[-1]) + outlines)
