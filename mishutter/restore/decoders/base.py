"""Decoders, and the model of the blur that they are given.

"The paper" is "Improved motion invariant imaging with time varying shutter functions".
"""

from abc import abstractmethod
from typing import final

import equinox as eqx
import numpy as np
from jaxtyping import Array

from mishutter._core import at_once, require_known
from mishutter.camera import kernel_layout, noise_variance, skips, white_electrons
from mishutter.evaluation import (
    PLANNED,
    Automatic,
    Plan,
    kernels_at_speeds,
    needed_speeds,
    picture_power,
)
from mishutter.model import NUM_FREQUENCIES, AbstractMotion, AbstractShutter, Scene, seen_from


@final
class BlurModel(eqx.Module):
    r"""The knowledge of a decoder: kernels, noise, and the statistics of pictures.

    Attributes:
        kernels: Kernels at the speeds that may occur, aligned; shape `(s, n)`, numpy.
        weights: How often each occurs; shape `(s,)`.
        assumed: The one kernel that the classical decoders take for all, that of a still
            object as in the paper; shape `(n,)`.
        origin: Index of the tap that displaces nothing.
        noise: Variance of the noise per pixel of the capture, white = 1.
        read_variance: The part of it that is there in the dark, $(\sigma/p)^2$.
        electrons: Photo-electrons of a white pixel in a fully open exposure.
        power: Power of the picture's rows in equal steps of (0, 0.5) cycles/px, its mean
            being the variance; shape `(m,)`.
        mean_level: Mean of the picture.
    """

    kernels: np.ndarray
    weights: np.ndarray
    assumed: np.ndarray
    origin: int = eqx.field(static=True)
    noise: float = eqx.field(static=True)
    read_variance: float = eqx.field(static=True)
    electrons: float = eqx.field(static=True)
    power: np.ndarray
    mean_level: float = eqx.field(static=True)

    @property
    def num_taps(self) -> int:
        """Length of the kernels."""
        return self.assumed.size

    @property
    def efficiency(self) -> float:
        """Light of the assumed kernel."""
        return float(np.sum(self.assumed))

    def responses(self, length: int) -> np.ndarray:
        """Transfer functions of the kernels on the grid of a DFT; `(s, length // 2 + 1)`."""
        return self.shifted(np.fft.rfft(self.kernels, length), length)

    def assumed_response(self, length: int) -> np.ndarray:
        """Transfer function of the assumed kernel there; `(length // 2 + 1,)`."""
        return self.shifted(np.fft.rfft(self.assumed, length), length)

    def shifted(self, response: np.ndarray, length: int) -> np.ndarray:
        """A response with the tap that displaces nothing at position 0."""
        return response * np.exp(2j * np.pi * np.fft.rfftfreq(length) * self.origin)

    def picture_spectrum(self, length: int) -> np.ndarray:
        """Power spectrum of the picture on the grid of a DFT; `(length // 2 + 1,)`."""
        known = (np.arange(self.power.size) + 0.5) / (2 * self.power.size)
        least = np.finfo(np.float64).tiny
        logarithm = np.log(np.maximum(self.power, least))
        return np.exp(np.interp(np.fft.rfftfreq(length), known, logarithm))


class AbstractDecoder(eqx.Module):
    """Turns captured rows into rows of the picture, knowing a `BlurModel`.

    A decoder is a function of its parameters and the capture: it draws no numbers and
    keeps no state. Planes are independent of one another.
    """

    @abstractmethod
    def restore(self, captured: Array, model: BlurModel) -> Array:
        """Restore planes of captured rows.

        Args:
            captured: Light in units of a fully open exposure; shape
                `(..., rows, columns)`.
            model: Kernels, noise and the picture's statistics.

        Returns:
            Light of the picture, white = 1; shape of `captured`.
        """


def blur_model(
    scene: Scene,
    motion: AbstractMotion,
    shutter: AbstractShutter,
    *,
    plan: Plan | Automatic | None = PLANNED,
    least_taps: int = 1,
) -> BlurModel:
    r"""The knowledge that a decoder may have of a scene, a motion and a shutter.

    The kernels are those of the scene's speeds with its weights; the noise is
    $N = \eta\bar f/p + (\sigma/p)^2$; the picture's spectrum is the scene's.

    Args:
        scene: Speeds, light, noise, spectrum; concrete.
        motion: Motion of the sensor; concrete.
        shutter: Transmittance over the exposure; concrete.
        plan: The parts to compute: by default each speed that occurs once; None for all.
        least_taps: Length of the kernels, where they do not need more.

    Raises:
        ValueError: if a kernel would be longer than 8,192 px.
    """
    require_known("blur_model", scene=scene, motion=motion)
    with at_once():  # numbers also where the capture is traced
        return _known_blur(scene, motion, shutter, plan, least_taps)


def _known_blur(
    scene: Scene,
    motion: AbstractMotion,
    shutter: AbstractShutter,
    plan: Plan | Automatic | None,
    least_taps: int,
) -> BlurModel:
    scene, motion = seen_from(scene, motion)
    shutter = scene.light(shutter)
    speeds = np.asarray(scene.speeds)
    num_taps, origin = kernel_layout(motion, *speeds.tolist(), 0.0, least_taps=least_taps)
    weights = np.asarray(scene.weights, np.float64)
    if skips(plan):
        kept = needed_speeds(scene, shutter)
        speeds, weights = np.asarray(kept.speeds), np.asarray(kept.weights, np.float64)
    with_still = np.append(speeds, speeds.dtype.type(0))
    kernels = np.asarray(kernels_at_speeds(shutter, motion, with_still, num_taps), np.float64)
    electrons = float(white_electrons(scene, motion))
    light = np.sum(kernels[-1])
    noise = float(noise_variance(scene, motion, light)) if electrons > 0 else np.inf
    power = picture_power(scene, NUM_FREQUENCIES, np.dtype(scene.speeds.dtype))
    return BlurModel(
        kernels=kernels[:-1],
        weights=weights,
        assumed=kernels[-1],
        origin=origin,
        noise=noise,
        read_variance=float(scene.read_noise) ** 2 / electrons**2 if electrons > 0 else np.inf,
        electrons=electrons,
        power=np.asarray(power, np.float64),
        mean_level=float(scene.mean_level),
    )
