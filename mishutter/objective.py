"""The loss as a function of a point in the design space, ready to be compiled.

Where only a profile moves that is linear in its coordinates, and the loss sees it
through its response, the response of each coordinate is computed once and a step of
the solver costs a matrix product.
"""

from abc import abstractmethod
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array

from mishutter.design_space import DesignSpace
from mishutter.losses.base import AbstractLoss, AbstractResponseLoss
from mishutter.motion import AbstractMotion
from mishutter.plan import Plan
from mishutter.response import Response, respond
from mishutter.scene import Scene
from mishutter.shutters.base import AbstractAdjustableShutter


class AbstractObjective(eqx.Module):
    """A scalar function of box coordinates."""

    @abstractmethod
    def __call__(self, box: Array) -> Array:
        """Loss at a point of the unit box; scalar."""


@final
class DesignObjective(AbstractObjective):
    """The loss of the design at each point, computed from scratch."""

    loss: AbstractLoss
    scene: Scene
    space: DesignSpace
    plan: Plan = eqx.field(static=True)

    def __call__(self, box: Array) -> Array:
        shutter, motion = self.space.at(box)
        return self.loss(self.scene, motion, shutter, plan=self.plan)


@final
class LinearObjective(AbstractObjective):
    """The loss of a weighted sum of responses, one a coordinate of the profile."""

    loss: AbstractResponseLoss
    scene: Scene
    motion: AbstractMotion
    basis: Response
    plan: Plan = eqx.field(static=True)

    def __call__(self, box: Array) -> Array:
        response = _joined(jax.tree.map(lambda part: jnp.tensordot(box, part, 1), self.basis))
        return self.loss.of_response(self.scene, self.motion, response, self.plan)


def objective_of(
    loss: AbstractLoss, scene: Scene, space: DesignSpace, plan: Plan
) -> AbstractObjective:
    """The cheapest exact form of the loss over the space."""
    linear = isinstance(space.shutter, AbstractAdjustableShutter) and space.shutter.linear
    if space.free == ("shutter",) and linear and isinstance(loss, AbstractResponseLoss):
        basis = _basis(space, scene, plan, loss.needs_kernels, loss.needs_spectra)
        return LinearObjective(loss, scene, space.motion, basis, plan)
    return DesignObjective(loss, scene, space, plan)


@eqx.filter_jit
def _basis(
    space: DesignSpace, scene: Scene, plan: Plan, needs_kernels: bool, needs_spectra: bool
) -> Response:
    def of_coordinate(box: Array) -> Response:
        shutter, motion = space.at(box)
        response = respond(
            scene, motion, shutter, plan, kernels=needs_kernels, spectra=needs_spectra
        )
        return _parted(response)

    return _condensed(jax.vmap(of_coordinate)(jnp.eye(space.size, dtype=space.max_speed.dtype)))


def _parted(response: Response) -> Response:
    """Complex parts as real and imaginary ones, which real weights may multiply."""
    return jax.tree.map(lambda x: jnp.stack([jnp.real(x), jnp.imag(x)]), response)


def _joined(response: Response) -> Response:
    """The response that `_parted` took apart."""

    def complex_part(x: Array) -> Array:
        return jax.lax.complex(x[0], x[1])

    return Response(
        response.still_kernel[0],
        complex_part(response.still_spectrum),
        response.differences[0],
        complex_part(response.spectra),
        response.efficiency[0],
    )


def _condensed(basis: Response) -> Response:
    r"""The basis with rows that only count by their sum of squares rotated to a few.

    $\|\sum_j c_j d_j\| = \|R c\|$ for the triangular factor $R$ of the $d_j$ as columns:
    as many numbers as coordinates stand for all taps at all speeds.
    """

    def triangular(rows: Array) -> Array:
        columns = rows[:, 0].reshape(rows.shape[0], -1).T
        factor = jnp.linalg.qr(columns, mode="r").T
        return jnp.stack([factor, jnp.zeros_like(factor)], axis=1)

    if not basis.differences.size:
        return basis
    return eqx.tree_at(
        lambda r: (r.still_kernel, r.differences),
        basis,
        (triangular(basis.still_kernel), triangular(basis.differences)),
    )
