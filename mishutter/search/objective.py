"""The loss as a function of a point in the design space, ready to be compiled.

Where a profile moves alone that is linear in its coordinates, and the loss depends on it through
its response, the response of each coordinate is computed once and a step of the solver costs a
matrix product.
"""

import math
from abc import abstractmethod
from dataclasses import replace
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from mishutter._core.checks import common_dtype
from mishutter._core.compiling import compiled
from mishutter.blur.quadrature import ExposureQuadrature, exposure_quadrature
from mishutter.evaluation.losses import (
    AbstractLoss,
    AbstractResponseLoss,
    one_real_number,
    value_of,
)
from mishutter.evaluation.needs import (
    ONLY_SPECTRA,
    Parts,
    Plan,
    plan_of_traced_search,
    reduced,
    size_class,
)
from mishutter.evaluation.response import Response, compute_response
from mishutter.evaluation.views import sensor_view
from mishutter.model.motion import AbstractMotion
from mishutter.model.scene import Scene
from mishutter.model.shutters.base import AbstractAdjustableShutter
from mishutter.model.shutters.windows import RectShutter
from mishutter.search.space import DesignSpace


class AbstractObjective(eqx.Module):
    """A scalar function of box coordinates."""

    def __call__(self, point: Float[Array, "size"]) -> Float[Array, ""]:
        """Loss of the design at a point of the unit box, differentiable there; NaN of a NaN.

        A branch that a comparison with NaN chooses would else give the best loss of all.
        """
        return jnp.where(jnp.any(jnp.isnan(point)), jnp.nan, self.value(point))

    @abstractmethod
    def value(self, point: Float[Array, "size"]) -> Float[Array, ""]:
        """The loss at a point whose coordinates are numbers."""

    @property
    @abstractmethod
    def batches(self) -> bool:
        """Whether many points at once take less time than one after the other."""


def _many_at_once() -> bool:
    """Whether the waves of many points are best computed together: a CPU's cache fits one's."""
    return jax.default_backend() != "cpu"


@final
class DesignObjective(AbstractObjective):
    """The loss of the design at each point, computed from scratch."""

    loss: AbstractLoss
    scene: Scene
    space: DesignSpace
    plan: Plan = eqx.field(static=True)

    def value(self, point: Float[Array, "size"]) -> Float[Array, ""]:
        shutter, motion = self.space.at(point)
        # A loss of the user's may call `evaluate`, which cannot plan for numbers that are traced.
        with plan_of_traced_search(self.plan):
            value = value_of(self.loss, self.scene, motion, shutter, self.plan)
        return value.astype(point.dtype)

    @property
    def batches(self) -> bool:
        return _many_at_once()


@final
class SpectralObjective(AbstractObjective):
    """The loss of the design at each point where it depends on transfer functions alone."""

    loss: AbstractResponseLoss
    scene: Scene
    space: DesignSpace
    # Quadrature nodes of a fixed shutter, by which windows of every kind share a program; None
    # where the shutter moves
    nodes: ExposureQuadrature | None
    plan: Plan = eqx.field(static=True)

    def value(self, point: Float[Array, "size"]) -> Float[Array, ""]:
        shutter, motion = self.space.at(point)
        view = sensor_view(self.scene, motion, shutter)
        view = view.sampled(self.plan, ONLY_SPECTRA, self.nodes)
        count = self.plan.num_frequencies
        value = self.loss.of_response(view.scene, view.motion, compute_response(view), count)
        return one_real_number(self.loss, value).astype(point.dtype)

    @property
    def batches(self) -> bool:
        return _many_at_once()


@final
class LinearObjective(AbstractObjective):
    """The loss of a weighted sum of responses, one a coordinate of the profile."""

    loss: AbstractResponseLoss
    scene: Scene
    motion: AbstractMotion
    # The response of a closed profile, through which a device may leak light, then the contribution
    # of each coordinate, as rows of real numbers
    basis: Float[Array, "rows k"]
    # Shapes of the parts of a response, one after the other in such a row
    shapes: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    # Frequencies of the grid that transfer functions stand on
    num_frequencies: int = eqx.field(static=True)

    def value(self, point: Float[Array, "size"]) -> Float[Array, ""]:
        row = self.basis[0] + point @ self.basis[1:]
        ends = np.cumsum([math.prod(shape) for shape in self.shapes[:-1]]).tolist()
        flat = zip(jnp.split(row, ends), self.shapes, strict=True)
        still, differences, spectrum, spectra, spectrum_imag, spectra_imag, efficiency = (
            part.reshape(shape) for part, shape in flat
        )
        response = Response(
            still,
            jax.lax.complex(spectrum, spectrum_imag),
            differences,
            jax.lax.complex(spectra, spectra_imag),
            efficiency,
        )
        return self.loss.of_response(self.scene, self.motion, response, self.num_frequencies)

    @property
    def batches(self) -> bool:
        return True


SearchedObjective = DesignObjective | SpectralObjective | LinearObjective


def objective_of(
    loss: AbstractLoss, scene: Scene, space: DesignSpace, plan: Plan
) -> SearchedObjective:
    """The cheapest exact form of the loss over the space."""
    is_of_response = isinstance(loss, AbstractResponseLoss)
    plan.require_feasible(loss.parts if is_of_response else ONLY_SPECTRA)
    scene = reduced(scene, plan)
    linear = isinstance(space.shutter, AbstractAdjustableShutter) and space.shutter.linear
    linear = linear and (scene.device is None or scene.device.is_linear)
    alone = plan.skips and space.free == ("shutter",) and linear
    if alone and isinstance(loss, AbstractResponseLoss):
        basis, shapes = _basis(space, scene, plan, loss.parts)
        return LinearObjective(loss, scene, space.motion, basis, shapes, plan.num_frequencies)
    if plan.skips and isinstance(loss, AbstractResponseLoss) and loss.parts == ONLY_SPECTRA:
        # Rounding to two numbers an octave lets scenes of other speeds share programs.
        plan, nodes = replace(plan, num_nodes=size_class(plan.num_nodes)), None
        if "shutter" not in space.free and not space.lags:
            profile = space.transmittance(space.shutter, space.motion.half_exposure)
            ends = space.motion.piece_ends
            nodes = exposure_quadrature(profile, plan.num_nodes, space.dtype, ends)
            # The nodes stand for the shutter, whose kind would make another program.
            space = replace(space, shutter=RectShutter())
        return SpectralObjective(loss, scene, space, nodes, plan)
    return DesignObjective(loss, scene, space, plan)


def _basis(
    space: DesignSpace, scene: Scene, plan: Plan, parts: Parts
) -> tuple[Float[Array, "rows k"], tuple[tuple[int, ...], ...]]:
    """Response of a closed profile, the contribution of each coordinate, and shapes of parts."""
    responses = _responses_of_each(scene, space, plan, parts)
    # Behind a device that leaks, a coordinate adds to what a closed profile records already.
    each = jax.tree.map(lambda x: np.concatenate([x[:1], x[1:] - x[:1]]), jax.device_get(responses))
    still, differences = _triangular(each.still_kernel), _triangular(each.differences)
    efficiency, waves = each.efficiency, (each.still_spectrum, each.spectra)
    rows = [still, differences, *map(np.real, waves), *map(np.imag, waves), efficiency]
    flat = [np.reshape(part, (efficiency.size, -1)) for part in rows]
    basis = jax.device_put(np.concatenate(flat, axis=1).astype(efficiency.dtype))
    return basis, tuple(part.shape[1:] for part in rows)


@compiled
def _responses_of_each(scene: Scene, space: DesignSpace, plan: Plan, parts: Parts) -> Response:
    """Responses of a closed profile, and of one with each coordinate alone at 1; one program."""

    def one(corner: Float[Array, "size"]) -> Response:
        profile = space.shutter_at(corner, space.motion.half_exposure)
        view = sensor_view(scene, space.motion, profile)
        return compute_response(view.sampled(plan, parts))

    dtype = common_dtype(space.motion.half_exposure, scene.speeds)
    corners = jnp.eye(space.size + 1, space.size, -1, dtype=dtype)
    return jax.lax.map(one, corners)


def _triangular(rows: np.ndarray) -> Float[np.ndarray, "rows k"]:
    r"""Rows that only count by their sum of squares, rotated to a few numbers.

    $\|\sum_j c_j d_j\| = \|R c\|$ for the triangular factor $R$ of the $d_j$ as columns:
    as many numbers as coordinates stand for all taps at all speeds.
    """
    return np.transpose(np.asarray(np.linalg.qr(rows.reshape(len(rows), -1).T, mode="r")))
