"""Restoration of a picture that moves as a whole, by an estimate of its speed."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from mishutter.camera import kernel_layout
from mishutter.model import DecoderSpeed
from mishutter.restore.decoders.base import AbstractDecoder, BlurModel
from mishutter.restore.decoders.speed import SpeedEstimate, speed_in
from mishutter.restore.decoders.total_variation import TotalVariationDecoder

ROWS_TO_FIND = 256
"""Rows of a photograph in which its speed is found: few of them do not tell it."""
_DOUBT = 0.5
"""Weight of the scene's own speeds where the posterior is all over: of the multiples of d and of
its square, the true speeds of open shutters in the photographs of the prior are likeliest by this.
"""
_UNUSUAL_POWER = 0.4
"""Power of the probabilities of a picture unlike those of the prior: of 0.2, 0.3, 0.4, 0.5 and 0.7
the highest by which the ensemble filter loses at most 0.3 dB on each photograph of the prior, by
open shutters of 30 and 38 ms, with each of four noises.
"""
_LEAST_WEIGHT = 1e-3
"""Probability below which a speed is left to the scene's own."""


@final
class SpeedFindingDecoder(AbstractDecoder):
    r"""Finds the speed of a picture that moves as a whole, and restores by it.

    A speed that is trusted takes the place of all of the scene's. Where none is, the speeds are
    those of the posterior, $(1 - d^2/2)\,p(s)$, and the scene's own, at $d^2/2$ times their
    weights, where $d$ is the probability of all speeds but the likeliest and its neighbours: the
    wider a posterior is, the more often it is wrong. Of a picture whose spectrum is unlike those of
    the prior, $p(s)^{0.4}$ takes the place of $p(s)$. Where nothing tells speeds apart, as in a
    snapshot, the inner decoder restores as it would alone.

    Args:
        inner: The decoder that restores, knowing these speeds.

    Raises:
        ValueError: if a capture is traced, or of a scene with a background.
    """

    inner: AbstractDecoder = eqx.field(default_factory=TotalVariationDecoder)

    @property
    def rows_beyond(self) -> int:
        return self.inner.rows_beyond

    def restore(self, captured: Array, model: BlurModel) -> Array:
        pictures = captured.reshape(-1, *captured.shape[-3:])
        models = (informed([self], picture, model)[0].model for picture in pictures)
        restored = [self.inner.restore(p, m) for p, m in zip(pictures, models, strict=True)]
        return jnp.stack(restored).reshape(captured.shape)


class Informed(NamedTuple):
    """A decoder and the model by which it restores one picture, once the speed is estimated."""

    decoder: AbstractDecoder
    model: BlurModel
    estimate: SpeedEstimate | None
    """Relative to the sensor; None of a decoder that looks for no speed."""


def informed(
    decoders: Sequence[AbstractDecoder], planes: ArrayLike, model: BlurModel
) -> list[Informed]:
    """Decoders of one picture, after those that look for its speed have looked for it, together.

    Args:
        decoders: The methods.
        planes: Light of the picture, as `speed_in` takes it.
        model: Blur and noise for all speeds.
    """
    finds = any(isinstance(each, SpeedFindingDecoder) for each in decoders)
    estimate, sharper = None, model
    if finds and model.efficiency > 0 and np.all(np.isfinite(model.noise)):
        estimate = speed_in(planes, model)
        sharper = at_speed(model, estimate)
    return [
        Informed(each.inner, sharper, estimate)
        if isinstance(each, SpeedFindingDecoder)
        else Informed(each, model, None)
        for each in decoders
    ]


def decoder_of(knows: DecoderSpeed, inner: AbstractDecoder) -> AbstractDecoder:
    """The decoder that finds the speed where one does, by another that restores.

    Args:
        knows: What it knows of the speed.
        inner: The decoder that restores.
    """
    finds = knows == "found" and not isinstance(inner, SpeedFindingDecoder)
    return SpeedFindingDecoder(inner) if finds else inner


def at_speed(model: BlurModel, estimate: SpeedEstimate) -> BlurModel:
    """The model of a decoder that takes account of a speed relative to the sensor."""
    if estimate.tells_nothing:
        return model
    if estimate.trusted:
        speeds, weights = np.array([estimate.speed]), np.ones(1)
    else:
        mode = int(np.argmax(estimate.weights))
        near = float(np.sum(estimate.weights[max(mode - 1, 0) : mode + 2]))
        doubt = _DOUBT * (1 - near) ** 2
        power = _UNUSUAL_POWER if estimate.is_unusual else 1.0
        share = estimate.weights**power / np.sum(estimate.weights**power)
        is_likely = share >= _LEAST_WEIGHT
        share = share[is_likely] / np.sum(share[is_likely])
        speeds = np.concatenate([estimate.speeds[is_likely], model.speeds])
        weights = np.concatenate([(1 - doubt) * share, doubt * model.weights])
    # Taps for all speeds that were tried, so that one program restores by any of them.
    num_taps, _ = kernel_layout(model.motion, *estimate.speeds.tolist(), least_taps=model.num_taps)
    return replace(model, speeds=speeds, weights=weights, num_taps=num_taps)
