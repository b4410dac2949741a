"""The loss that is visible in a restored picture: its expected error."""

from typing import final

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array

from mishutter._core import require
from mishutter.evaluation.losses.base import AbstractResponseLoss, Parts
from mishutter.evaluation.metrics import expected_squared_error, freely_aligned
from mishutter.evaluation.needs import Plan
from mishutter.evaluation.response import Response
from mishutter.model import AbstractMotion, Scene

ALIGNMENTS = ("vertex", "free")


@final
class ExpectedErrorLoss(AbstractResponseLoss):
    r"""Expected RMS error of the restored picture over the picture's standard deviation.

    The square root of `expected_squared_error` (the best single linear decoder for the
    scene's speeds) over $\sigma_f$: 0 for a perfect picture, 1 where nothing is gained
    over a grey one. 20 dB of PSNR are a factor of 10.

    Args:
        alignment: Where the decoder places the object of each speed: `"vertex"`, as kernels are
            aligned, or `"free"`, each displaced to where the error is least. Kernels of speeds
            that the sensor does not keep up with gain most by that; where it keeps up with all,
            up to 0.01 dB.

    Raises:
        ValueError: if `alignment` is neither.
    """

    alignment: str = eqx.field(default="vertex", static=True)

    def __check_init__(self) -> None:
        known = self.alignment in ALIGNMENTS
        requirement = f"be one of {', '.join(ALIGNMENTS)}"
        require(known, "ExpectedErrorLoss(alignment=...)", requirement, self.alignment)

    def parts(self, plan: Plan) -> Parts:
        return Parts(kernels=False, spectra=True, differences=False)

    def of_response(
        self, scene: Scene, motion: AbstractMotion, response: Response, plan: Plan
    ) -> Array:
        if self.alignment == "free":
            response = freely_aligned(scene, motion, response, plan.num_frequencies)
        squared = expected_squared_error(scene, motion, response, plan.num_frequencies)
        variance = scene.deviation.astype(squared.dtype) ** 2
        textured = (variance > 0) & (squared > 0)
        ratio = jnp.where(textured, squared, 1.0) / jnp.where(textured, variance, 1.0)
        return jnp.where(textured, jnp.sqrt(ratio), 0.0)
