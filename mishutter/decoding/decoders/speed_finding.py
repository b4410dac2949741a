"""Restoration of a picture that moves as a whole, by an estimate of its speed."""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from mishutter.camera.capture import kernel_layout
from mishutter.decoding.decoders.base import AbstractDecoder, BlurModel
from mishutter.decoding.decoders.speed import SpeedEstimate, speed_in
from mishutter.decoding.decoders.total_variation import TotalVariationDecoder
from mishutter.evaluation.speed_knowledge import SpeedKnowledge

ROWS_TO_FIND = 256
"""Rows of a photograph from which its speed is found: a few rows do not tell it."""


@final
class SpeedFindingDecoder(AbstractDecoder):
    r"""Finds the speed of a picture that moves as a whole, and restores the picture for it.

    A trusted speed replaces all speeds of the scene. If no speed is trusted, the inner decoder
    restores for the speeds of the posterior, weighted by $(1 - d^2/2)\,p(s)$, and for those of the
    scene, at $d^2/2$ times their weights. Here $d$ is the probability of all speeds but the
    likeliest and its neighbours: the wider a posterior is, the more often it is wrong. If the
    picture's spectrum is unlike those of the prior, $p(s)^{0.4}$ replaces $p(s)$. Where nothing
    tells speeds apart, as in a snapshot, the inner decoder restores as it would alone.

    Args:
        inner: The decoder that restores the picture, once it is given these speeds.

    Raises:
        ValueError: if a capture is traced, or if the scene has a background.
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
    # The estimate relative to the sensor; None for a decoder that looks for no speed
    estimate: SpeedEstimate | None


def informed(
    decoders: Sequence[AbstractDecoder], planes: ArrayLike, model: BlurModel
) -> list[Informed]:
    """Estimates the speed of a picture once, for all those decoders that look for it."""
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


def decoder_of(knowledge: SpeedKnowledge, inner: AbstractDecoder) -> AbstractDecoder:
    """Wraps a decoder in a `SpeedFindingDecoder` if the speed is to be found."""
    finds = knowledge.finds_speed and not isinstance(inner, SpeedFindingDecoder)
    return SpeedFindingDecoder(inner) if finds else inner


def at_speed(model: BlurModel, estimate: SpeedEstimate) -> BlurModel:
    """The model for the speeds that an estimate leaves; all are relative to the sensor."""
    if estimate.tells_nothing:
        return model
    if estimate.trusted:
        speeds, weights = np.array([estimate.speed]), np.ones(1)
    else:
        mode = int(np.argmax(estimate.weights))
        near = float(np.sum(estimate.weights[max(mode - 1, 0) : mode + 2]))
        # Among multiples of 1 - near and of its square, this one makes the true speeds of the
        # prior's photographs likeliest, if open shutters capture them.
        doubt = 0.5 * (1 - near) ** 2
        # Of 0.2, 0.3, 0.4, 0.5 and 0.7 this is the highest power with which the ensemble filter
        # loses at most 0.3 dB on each photograph of the prior, with open shutters of 30 and 38 ms
        # and each of four noises.
        power = 0.4 if estimate.is_unusual else 1.0
        share = estimate.weights**power / np.sum(estimate.weights**power)
        is_likely = share >= 1e-3  # the scene's own speeds stand for the rest
        share = share[is_likely] / np.sum(share[is_likely])
        speeds = np.concatenate([estimate.speeds[is_likely], model.speeds])
        weights = np.concatenate([(1 - doubt) * share, doubt * model.weights])
    # Enough taps for every speed that was tried, so that one program restores for any of them.
    num_taps, _ = kernel_layout(model.motion, *estimate.speeds.tolist(), least_taps=model.num_taps)
    return replace(model, speeds=speeds, weights=weights, num_taps=num_taps)
