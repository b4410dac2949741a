r"""Errors of frames behind open shutters, for a decoder that registers them.

A decoder that registers the frames of a burst knows the speed $s$, and restores one picture from
$g_k = h_k * r + \text{noise}$ with independent noise. It leaves

$$E(s) = 2\int_0^{1/2}\frac{S}{1 + S\,\mathrm{sinc}^2(f)\,\sum_k |H_k(f, s)|^2/N_k}\,df,\qquad
N_k = \frac{\bar f}{2RT_k} + \Bigl(\frac{\sigma}{2RT_k}\Bigr)^2 .$$

Frames of any path and length may be mixed. Only $|H_k|$ counts: the direction of a parabola, its
place and the gaps between frames do not matter. Of a picture before a background the decoder knows
the speed of both layers and which part is which, and each part is restored by the filter of its
speed: the error is the mean over the parts. Edges, where one hides the other, do not count.

A search over bursts asks for hundreds, and a verdict on a scene for some: they must not cost a
compiled program. An open frame needs none: at rest its response is a sinc, and on any path it is
the mean of waves over the exposure.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from mishutter._core.checks import all_concrete, namespace_of
from mishutter.evaluation.ensembles import without_tolerances
from mishutter.evaluation.errors import residual_fraction
from mishutter.evaluation.layers import Background
from mishutter.evaluation.needs import distinct_speeds, sizes
from mishutter.model.motion import LinearMotion
from mishutter.model.optics import frequencies, pixel_response
from mishutter.model.scene import Scene, power_on_grid, require_one_axis
from mishutter.model.sensor import noise_power, white_electrons

Places = Callable[[Float[np.ndarray, "q"]], Float[np.ndarray, "k q"]]
"""Places of the sensor in some frames at times from their mid-exposures; px, s."""
_NODES = np.polynomial.legendre.leggauss(32)


def in_parts(scene: Scene) -> Scene:
    """The scene as parts that move on their own, a background among them, without tolerances."""
    require_one_axis(scene)
    layers, scene = scene.occlusion, without_tolerances(scene)
    if layers is None:
        return scene
    space = np if all_concrete((scene.speeds, scene.weights, layers)) else jnp
    speeds, weights, share, *behind = (
        space.asarray(x)
        for x in (scene.speeds, scene.weights, layers.front_share, *Background.of(scene))
    )
    return scene.with_occlusion(None).without_metadata(
        speeds=space.concatenate([speeds, behind[0]]),
        weights=space.concatenate([share * weights, (1 - share) * behind[1]]),
    )


@dataclass(frozen=True)
class OpenFrames:
    """Frames of open shutters, and their errors for a decoder that knows the speed."""

    scene: Scene  # Light and noise
    speeds: Float[np.ndarray, "n"]  # Speeds that occur, ascending; px/s
    weights: Float[np.ndarray, "n"]  # How often each occurs; their sum is 1
    frequency: Float[np.ndarray, "m"]  # Frequencies; cycles/px
    power: Float[np.ndarray, "m"]  # Power of the picture at them
    steps: Float[np.ndarray, "m"]  # Share of the frequencies in (0, 0.5) that each stands for
    precision: type = np.float64  # Type of the numbers that waves are computed in

    @staticmethod
    def of(scene: Scene, longest: float, *, folds: bool) -> "OpenFrames":
        """The frames of a scene."""
        scene = in_parts(scene)
        speeds, weights = (x.astype(np.float64) for x in distinct_speeds(scene, folds=folds))
        count = sizes(scene, LinearMotion(half_exposure=longest / 2)).num_frequencies
        grid = frequencies(count), power_on_grid(scene, count), np.full(count, 1 / count)
        return OpenFrames(scene, speeds, weights / weights.sum(), *grid)

    def coarser(self) -> "OpenFrames":
        """The same at few frequencies, most of them low, in single precision."""
        count = self.frequency.size
        # Of 96 frequencies bursts can be told apart.
        ends = np.unique(np.round(count * np.linspace(0, 1, 1 + 96) ** 2).astype(int))
        widths = np.diff(ends)
        frequency, power = (
            np.add.reduceat(x, ends[:-1]) / widths for x in (self.frequency, self.power)
        )
        few = {"frequency": frequency, "power": power, "steps": widths / count}
        return replace(self, **few, precision=np.float32)

    @cached_property
    def _aperture(self) -> Float[np.ndarray, "m"]:
        blur = float(self.scene.optics.lens_blur)
        return np.asarray(pixel_response(self.frequency, blur)) ** 2

    @cached_property
    def _light(self) -> tuple[float, float, float]:
        """Photo-electrons a second at white, mean level and read noise."""
        scene = self.scene
        rate, mean, read = scene.photon_rate, scene.picture.mean_level, scene.read_noise
        return float(rate), float(mean), float(read)

    def at_rest(self, exposure: float) -> Float[np.ndarray, "n m"]:
        """Power that passes one frame at rest, by speed and frequency."""
        smear = self.frequency * exposure * self.speeds[:, None]
        return np.sinc(smear) ** 2 * self._aperture

    def on_paths(self, places: Places, exposure: float, fastest: float) -> Float[np.ndarray, "n m"]:
        """Power that passes some frames together, by speed and frequency."""
        # Low frequencies, which are most of a search's, need fewer nodes.
        parts = [
            self._passed(places, exposure / 2, fastest, frequency)
            for frequency in np.array_split(self.frequency, 3)
        ]
        return np.concatenate(parts, axis=1) * self._aperture

    def _passed(
        self, places: Places, half: float, fastest: float, frequency: Float[np.ndarray, "m"]
    ) -> Float[np.ndarray, "n m"]:
        """Power that passes at some frequencies, without the pixels' aperture."""
        turns = 2 * np.pi * frequency
        # The nodes of a panel hold twice 40 rad to 1e-8.
        count = 1 + int(float(turns[-1]) * fastest * half / 40.0)
        x, weights = _NODES
        middles = (2 * np.arange(count) + 1) / count - 1
        times = half * (middles[:, None] + x / count).ravel()
        weights = np.tile(weights / (2 * count), count).astype(self.precision)
        turns = turns.astype(self.precision)[:, None, None]
        on_sensor, passing = (
            turns * x.astype(self.precision)[None]
            for x in (places(times), self.speeds[:, None] * times)
        )
        return np.sum(power_of_waves(on_sensor, passing, weights[None, None]), axis=1).T

    def snr(self, passed: Float[np.ndarray, "n m"], exposure: float) -> Float[np.ndarray, "n m"]:
        """Power of the picture over that of the noise in frames of an exposure."""
        rate, mean, read = self._light
        electrons = white_electrons(rate, exposure)
        noise = noise_power(1.0, mean, electrons, read)
        lost = residual_fraction(self.power * electrons**2, passed, 0.0 * passed, noise)
        with np.errstate(divide="ignore"):
            return 1 / lost - 1

    def errors(self, gained: Float[np.ndarray, "n m"]) -> Float[np.ndarray, "n"]:
        """Squared error that is left at each speed; white = 1."""
        return (self.power / (1 + gained)) @ self.steps

    def error(self, gained: Float[np.ndarray, "n m"], *, at_worst: bool = False) -> float:
        """Squared error that is left in the mean over the speeds, or at the worst of them."""
        errors = self.errors(gained)
        return float(np.max(errors) if at_worst else self.weights @ errors)


def power_of_waves(
    on_sensor: Float[Array | np.ndarray, "*f k q"],  # Phases of the places of a sensor; rad
    passing: Float[Array | np.ndarray, "*f n q"],  # Phases of the ways of things; rad
    weight: Float[Array | np.ndarray, "#*f #k q"],
) -> Float[Array | np.ndarray, "*f k n"]:
    r"""$|\sum_q w_q e^{i(\beta_q - \alpha_q)}|^2$ for each sensor and thing.

    A wave of a difference is a product of waves, so that the sums are products of matrices, in real
    numbers.
    """
    space = namespace_of(on_sensor, passing, weight)
    sensor = space.concatenate(
        [weight * space.cos(on_sensor), weight * space.sin(on_sensor)], axis=-1
    )
    cosine, sine = space.cos(passing), space.sin(passing)
    real, imaginary = (
        sensor @ space.swapaxes(space.concatenate(pair, axis=-1), -1, -2)
        for pair in ((cosine, sine), (sine, -cosine))
    )
    return real**2 + imaginary**2


def psnr_of_error(error: float) -> float:
    """The level of a squared error; dB. Without any error it is infinite."""
    return -10 * math.log10(error) if error > 0 else math.inf
