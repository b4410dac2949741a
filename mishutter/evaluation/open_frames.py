"""Errors of frames of open shutters at rest, for searches that ask for hundreds.

The formula is that of `mishutter.evaluation.levels`. An open frame at rest has a sinc for its
response.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from mishutter.evaluation.fans import MEASURED, Fan
from mishutter.evaluation.levels import Light, components_on, in_parts
from mishutter.evaluation.needs import distinct_speeds, sizes
from mishutter.evaluation.strips import Strips
from mishutter.model.motion import LinearMotion
from mishutter.model.scene import Scene


@dataclass(frozen=True)
class OpenFrames:
    """Frames of open shutters, and their errors for a decoder that knows the speed."""

    scene: Scene  # Light and noise
    # Speeds that occur, ascending along an axis, or components in the plane at each frequency; px/s
    speeds: Float[np.ndarray, "n #m"]
    weights: Float[np.ndarray, "n #m"]  # How often each occurs; their sum is 1
    fan: Fan  # Frequencies, a row of one direction each, and the picture's power at them
    strips: Strips | None  # What objects hide of a background at rest

    @staticmethod
    def of(
        scene: Scene,
        longest: float,
        *,
        folds: bool,
        pan: Float[np.ndarray, "2"] | tuple[float, float] = (0.0, 0.0),
    ) -> "OpenFrames":
        """The frames of a scene, in the plane on a camera that turns at a velocity, px/s."""
        strips = Strips.of(scene)
        if scene.velocities is not None:
            plane = Fan.of(scene)
            parts = components_on(scene, plane, MEASURED.num_speeds)
            radius = np.repeat(plane.radius, plane.direction.shape[1])
            fan = Fan(radius, *(np.ravel(x)[:, None] for x in plane[1:]))
            turned = pan[0] * np.cos(plane.direction) + pan[1] * np.sin(plane.direction)
            parts = parts.speeds - turned[..., None], parts.weights
            each = (np.broadcast_to(x, (*plane.power.shape, x.shape[-1])) for x in parts)
            speeds, weights = (x.reshape(radius.size, -1).T for x in each)
            return OpenFrames(scene, speeds, weights, fan, strips)
        scene = in_parts(scene)
        speeds, weights = (x.astype(np.float64) for x in distinct_speeds(scene, folds=folds))
        count = sizes(scene, LinearMotion(half_exposure=longest / 2)).num_frequencies
        shares, fan = weights[:, None] / weights.sum(), Fan.of_axis(scene, count)
        return OpenFrames(scene, speeds[:, None], shares, fan, strips)

    @property
    def in_plane(self) -> bool:
        """Whether things move in any direction."""
        return self.scene.velocities is not None

    @cached_property
    def _signal(self) -> tuple[Light, Float[np.ndarray, "m"]]:
        light = Light.of(self.scene)
        return light, np.asarray(light.signal(self.fan))[:, 0]

    def at_rest(self, exposure: float) -> Float[np.ndarray, "n m"]:
        """Power that passes one frame at rest, by speed and frequency."""
        return np.sinc(self.fan.radius * exposure * self.speeds) ** 2

    def snr(self, passed: Float[np.ndarray, "n m"], exposure: float) -> Float[np.ndarray, "n m"]:
        """Power of the picture over that of the noise in frames of an exposure."""
        light, signal = self._signal
        return signal * passed * light.gains(np.array([exposure]))

    def errors(self, gained: Float[np.ndarray, "n m"]) -> Float[np.ndarray, "n m"]:
        """Squared error that is left by each speed at each frequency; white = 1."""
        return float(self._signal[0].deviation) ** 2 / (1 + gained) * self.fan.weight[:, 0]

    def error(
        self, gained: Float[np.ndarray, "n m"], *, at_worst: bool = False, hidden: float = 0.0
    ) -> float:
        """Squared error that is left in the mean over the speeds, or at the worst of them.

        What edges leave more of a picture, `error_of_edges`, is the background's.
        """
        errors = self.errors(gained)
        if not at_worst:
            return float(np.sum(self.weights * errors)) + hidden
        each, (speeds, weights) = np.sum(errors, axis=1), (self.speeds[:, 0], self.weights[:, 0])
        behind = np.abs(speeds) == np.min(np.abs(speeds))
        return float(np.max(each + hidden * behind / np.where(behind, weights, 1.0)))

    @property
    def one_is_untold(self) -> bool:
        """Whether one frame alone is restored by one filter: it shows several unknown velocities.

        Along an axis single exposures are searched by the loss of the scene.
        """
        is_known = self.scene.decoder_speed == "known"
        return self.in_plane and self.scene.occlusion is not None and not is_known

    def error_untold(self, exposure: float) -> float:
        """Squared error that one filter for all velocities leaves of a frame; white = 1."""
        light, signal = self._signal
        response = np.sinc(self.fan.radius * exposure * self.speeds)
        mean, power = (np.sum(self.weights * x, axis=0) for x in (response, response**2))
        gain = signal * light.gains(np.array([exposure]))
        lost = 1 - gain * mean**2 / (1 + gain * power)
        return float(light.deviation**2 * (lost @ self.fan.weight[:, 0]))

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
