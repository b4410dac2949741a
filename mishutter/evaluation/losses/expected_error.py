"""The loss that is visible in a restored picture: its expected error."""

from typing import final

import jax.numpy as jnp
from jaxtyping import Array

from mishutter.evaluation.losses.base import AbstractResponseLoss, Parts
from mishutter.evaluation.metrics import expected_squared_error
from mishutter.evaluation.needs import Plan
from mishutter.evaluation.response import Response
from mishutter.model import AbstractMotion, Scene


@final
class ExpectedErrorLoss(AbstractResponseLoss):
    r"""Expected RMS error of the restored picture over the picture's standard deviation.

    The square root of `expected_squared_error` (the best single linear decoder for the
    scene's speeds) over $\sigma_f$: 0 for a perfect picture, 1 where nothing is gained
    over a grey one. 20 dB of PSNR are a factor of 10.
    """

    def parts(self, plan: Plan) -> Parts:
        return Parts(kernels=False, spectra=True, differences=False)

    def of_response(
        self, scene: Scene, motion: AbstractMotion, response: Response, plan: Plan
    ) -> Array:
        squared = expected_squared_error(scene, motion, response, plan.num_frequencies)
        variance = scene.deviation.astype(squared.dtype) ** 2
        textured = (variance > 0) & (squared > 0)
        ratio = jnp.where(textured, squared, 1.0) / jnp.where(textured, variance, 1.0)
        return jnp.where(textured, jnp.sqrt(ratio), 0.0)
