"""Decoders, and the model of the blur that they are given.

"The paper" is "Improved motion invariant imaging with time varying shutter functions".
"""

import math
from abc import abstractmethod
from dataclasses import dataclass, replace
from functools import partial
from typing import final

import equinox as eqx
import numpy as np
from jaxtyping import Array, Complex, Float

from mishutter._core.checks import require_known
from mishutter._core.compiling import outside_trace
from mishutter._core.modules import AbstractModule
from mishutter._core.parallel import alone_in_blas
from mishutter.camera.capture import captured_response, captured_responses_below, kernel_layout
from mishutter.camera.responses import aperture_on, waves_of
from mishutter.camera.rows import blur_length
from mishutter.evaluation.found_speed import open_time, smear_difference
from mishutter.evaluation.instants import Instants
from mishutter.evaluation.layers import Background, LayerMoments
from mishutter.evaluation.needs import needed_speeds
from mishutter.evaluation.views import sensor_view
from mishutter.model.motion import AbstractMotion
from mishutter.model.optics import NUM_FREQUENCIES, Optics, frequencies
from mishutter.model.scene import Scene, picture_power
from mishutter.model.sensor import noise_power, white_electrons
from mishutter.model.shutters.base import AbstractShutter


@dataclass(frozen=True, eq=False)
class CompleteFrames:
    """Frames of a sequence that go on beyond their borders, and so are as good as one capture."""

    nodes: list[Instants]  # Of the frames, or of them in some rows
    speed: float  # Speed of the picture; px/s
    noises: Float[np.ndarray, "frames"]  # Variance of the noise in each, white = 1

    def density(self, optics: Optics, length: int) -> Float[np.ndarray, "{length}//2+1"]:
        r"""Signal by noise of that capture, $\sum_k |A_k|^2/N_k$, in the mean over rows."""
        velocity, shape = np.array([[self.speed]]), (length,)
        each = [waves_of(one, velocity, shape)[:, 0] for one in self.nodes]
        density = np.mean([density_of(one, self.noises) for one in each], axis=0)
        return density * aperture_on(optics, shape) ** 2

    def response(self, optics: Optics, length: int) -> Float[np.ndarray, "{length}//2+1"]:
        """The square root of that over its value at 0."""
        density = self.density(optics, length)
        return np.sqrt(density / density[0])


def density_of(
    responses: Complex[np.ndarray, "frames *k"], noises: Float[np.ndarray, "frames"]
) -> Float[np.ndarray, "*k"]:
    r"""Signal by noise of frames together, $\sum_k |A_k|^2/N_k$."""
    pairs = zip(responses, noises, strict=True)
    return sum(np.abs(response) ** 2 / noise for response, noise in pairs)  # type: ignore[return-value]


def power_at(
    frequency: Float[np.ndarray, "k"], power: Float[np.ndarray, "m"]
) -> Float[np.ndarray, "k"]:
    """Power at some frequencies, by that at the centres of equal steps of (0, 0.5) cycles/px."""
    # At low frequencies the power falls by a multiple from one centre to the next.
    logarithm = np.log(np.maximum(power, np.finfo(np.float64).tiny))
    return np.exp(np.interp(frequency, frequencies(power.size), logarithm))


@final
class BlurModel(eqx.Module):
    r"""The knowledge of a decoder: blur, noise, and the statistics of pictures.

    The picture is a continuous, band-limited scene; the blur of an object at speed $s$ is its
    exact transfer function and a pixel's width, $H_s(f)\operatorname{sinc}(f)$.

    Attributes:
        motion: Motion of the sensor, without velocity.
        shutter: Transmittance over the exposure.
        speeds: Speeds that may occur, relative to the sensor; px/s.
        weights: Probability of each.
        num_taps: Pixels over which light of the fastest falls.
        efficiency: Mean transmittance over the exposure.
        read_noise: Standard deviation of the read noise; e-.
        electrons: Photo-electrons of a white pixel in a fully open exposure.
        power: Power of the picture's rows in equal steps of (0, 0.5) cycles/px; its mean is the
            variance.
        mean_level: Mean of the picture.
        optics: The lens.
        open_time: Time in which an open shutter would pass as much light; s.
        layers: The scene, seen from the motion, where objects hide part of a background; None
            where the picture moves as a whole.
        complete: The frames of a sequence that the capture combines; None for a single capture.
    """

    motion: AbstractMotion
    shutter: AbstractShutter
    speeds: Float[np.ndarray, "s"]
    weights: Float[np.ndarray, "s"]
    num_taps: int = eqx.field(static=True)
    efficiency: float = eqx.field(static=True)
    read_noise: float = eqx.field(static=True)
    electrons: float = eqx.field(static=True)
    power: Float[np.ndarray, "m"]
    mean_level: float = eqx.field(static=True)
    optics: Optics
    open_time: float = eqx.field(static=True)
    layers: Scene | None = None
    complete: CompleteFrames | None = eqx.field(static=True, default=None)

    @property
    def smear_difference(self) -> float:
        """Difference of the smear between the fastest and the slowest object; px."""
        return float(smear_difference(self.speeds, self.weights, np.asarray(self.open_time)))

    @property
    def noise(self) -> float:
        """Variance of the noise per pixel of a capture of the mean level, white = 1."""
        return self.noise_at(self.mean_level)

    @property
    def read_variance(self) -> float:
        r"""The part of the noise that is there in the dark, $(\sigma/p)^2$."""
        return self.noise_at(0.0)

    def noise_at(self, mean_level: float) -> float:
        r"""Variance of the noise where the picture has a mean, $\eta\bar f/p + (\sigma/p)^2$.

        Args:
            mean_level: Mean level of the picture, white = 1.
        """
        p = self.electrons
        if p <= 0:
            return math.inf
        return noise_power(self.efficiency, mean_level, p, self.read_noise, unit=p)

    def knowing(self, speed: float) -> "BlurModel":
        """The model of a decoder that knows the one speed of what moves.

        Args:
            speed: The speed relative to the sensor; px/s.
        """
        num_taps, _ = kernel_layout(self.motion, speed, least_taps=self.num_taps)
        speeds, weights, layers = np.array([speed]), np.ones(1), self.layers
        if layers is not None:
            one = layers.without_metadata(speeds=speeds, weights=weights)
            with outside_trace():
                layers = Background.of(layers).behind(one)
        return replace(self, speeds=speeds, weights=weights, num_taps=num_taps, layers=layers)

    def responses(self, length: int) -> Complex[np.ndarray, "s {length}//2+1"]:
        """Responses at the speeds that may occur, on the grid of a DFT.

        Args:
            length: Pixels of the DFT.
        """
        return self.responses_at(self.speeds, length)

    def assumed_response(self, length: int) -> Complex[np.ndarray, "{length}//2+1"]:
        """Response of a still object, which classical decoders take for all, as in the paper.

        Args:
            length: Pixels of the DFT.
        """
        return self.responses_at(np.zeros(1), length)[0]

    def responses_at(
        self, speeds: Float[np.ndarray, "speeds"], length: int
    ) -> Complex[np.ndarray, "speeds {length}//2+1"]:
        """Responses at speeds relative to the sensor, px/s, on the grid of a DFT.

        Args:
            speeds: Speeds of the objects; px/s.
            length: Pixels of the DFT.
        """
        if self.complete is not None:
            response = self.complete.response(self.optics, length)
            return np.broadcast_to(response.astype(complex), (speeds.size, response.size))
        with outside_trace():
            responses = captured_response(self.motion, self.shutter, speeds.tolist(), length)
        return np.asarray(responses) * self.optics.response(length)

    def _responses_below(self, speeds: np.ndarray, counts: np.ndarray, length: int) -> np.ndarray:
        """Responses at speeds, of each at so many of the lowest frequencies at least."""
        responses = captured_responses_below(self.motion, self.shutter, speeds, length, counts)
        return responses * self.optics.response(length)

    def mean_and_spread(
        self, length: int
    ) -> tuple[Complex[np.ndarray, "{length}//2+1"], Float[np.ndarray, "{length}//2+1"]]:
        r"""Mean response over the speeds, and its variance, on the grid of a DFT.

        $m = \sum p_i H_i$ and $v = \sum p_i |H_i - m|^2$: a capture is $m f$ and an error of power
        $N + S v$. Where objects hide a background the sums are over the parts of the picture
        (`evaluation.LayerMoments`).

        Args:
            length: Pixels of the DFT.
        """
        if self.layers is None:
            responses = self.responses(length)
            mean = self.weights @ responses
            return mean, self.weights @ np.abs(responses - mean) ** 2
        with outside_trace():
            at = partial(self._responses_below, length=length)
            moments = LayerMoments.on_dft(self.layers, self.motion, length, at)
        return np.asarray(moments.mean[0]), np.asarray(moments.spread[0])

    def picture_spectrum(self, length: int) -> Float[np.ndarray, "{length}//2+1"]:
        """Power spectrum of the picture on the grid of a DFT.

        Args:
            length: Pixels of the DFT.
        """
        return power_at(np.fft.rfftfreq(length), self.power)


class AbstractDecoder(AbstractModule):
    """Turns captured rows into rows of the picture by a `BlurModel`.

    A decoder is a function of its parameters and the capture: it draws no numbers and
    keeps no state. Planes are independent of one another.
    """

    @property
    def rows_beyond(self) -> int:
        """Rows above and below a portion of a picture that its own rows are restored from."""
        return 0

    @abstractmethod
    def restore(
        self, captured: Float[Array, "*planes rows columns"], model: BlurModel
    ) -> Float[Array, "*planes rows columns"]:
        """Restore planes of captured rows.

        Args:
            captured: Light in units of a fully open exposure.
            model: Blur, noise and the picture's statistics.

        Returns:
            Light of the picture, white = 1.
        """


@alone_in_blas()
@outside_trace()  # numbers also where the capture is traced
def blur_model(
    scene: Scene,  # concrete
    motion: AbstractMotion,  # concrete
    shutter: AbstractShutter,  # concrete
    *,
    least_taps: int = 1,
) -> BlurModel:
    r"""The knowledge that a decoder may have of a scene, a motion and a shutter.

    The blur is that of the scene's speeds with its weights; the noise is
    $N = \eta\bar f/p + (\sigma/p)^2$; the picture's spectrum is the scene's.
    """
    require_known("blur_model", scene=scene, motion=motion)
    view = sensor_view(scene, motion, shutter)
    # Where the sensor's own velocity is too much, the motion is to blame.
    blur_length(motion, *scene.speeds.tolist(), subject="scene")
    scene, motion, shutter, _ = view
    speeds = np.asarray(scene.speeds)
    # The still object counts too: classical decoders take its kernel for all.
    num_taps, _ = kernel_layout(motion, *speeds.tolist(), 0.0, least_taps=least_taps)
    needed = needed_speeds(scene, motion, shutter)
    speeds, weights = np.asarray(needed.speeds), np.asarray(needed.weights, np.float64)
    electrons = float(white_electrons(scene.photon_rate, motion.exposure))
    # The speeds beside that of rest choose the nodes that the responses have too.
    *_, still = np.asarray(captured_response(motion, shutter, [*speeds.tolist(), 0.0], 2))
    efficiency = float(still[0].real)
    layers = None
    if scene.occlusion is not None:
        layers = scene.without_metadata()
        scene = Background.of(scene).behind(layers)
    power = picture_power(scene, NUM_FREQUENCIES, np.dtype(scene.speeds.dtype))
    return BlurModel(
        motion=motion,
        shutter=shutter,
        speeds=speeds,
        weights=weights,
        num_taps=num_taps,
        efficiency=efficiency,
        read_noise=float(scene.read_noise),
        electrons=electrons,
        power=np.asarray(power, np.float64),
        mean_level=float(scene.picture.mean_level),
        optics=scene.optics,
        open_time=float(open_time(scene, motion.half_exposure, np.asarray(efficiency))),
        layers=layers,
    )
