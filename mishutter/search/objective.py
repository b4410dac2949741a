"""The loss as a function of a point in the design space, ready to be compiled.

Where only a profile moves that is linear in its coordinates, and the loss sees it
through its response, the response of each coordinate is computed once and a step of
the solver costs a matrix product.
"""

import math
from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from mishutter._core import common_dtype, compiled
from mishutter.blur import ExposureQuadrature, exposure_quadrature, path_ends
from mishutter.evaluation import (
    ONLY_SPECTRA,
    AbstractLoss,
    AbstractResponseLoss,
    Parts,
    Plan,
    Records,
    Response,
    SampledView,
    assembled,
    folded,
    one_real_number,
    plan_of_traced_search,
    records,
    require_sizes,
    size_class,
    spectra_of,
    transmittance,
    value_of,
)
from mishutter.model import (
    AbstractAdjustableShutter,
    AbstractMotion,
    RectShutter,
    Scene,
    seen_from,
)
from mishutter.search.space import DesignSpace


class AbstractObjective(eqx.Module):
    """A scalar function of box coordinates."""

    @abstractmethod
    def __call__(self, box: Array) -> Array:
        """Loss at a point of the unit box; scalar."""

    @property
    @abstractmethod
    def batches(self) -> bool:
        """Whether many points at once take less time than one after the other."""


def _many_at_once() -> bool:
    """Whether waves of many points are best at hand together: those of one fit a CPU's cache."""
    return jax.default_backend() != "cpu"


@final
class DesignObjective(AbstractObjective):
    """The loss of the design at each point, computed from scratch."""

    loss: AbstractLoss
    scene: Scene
    space: DesignSpace
    plan: Plan = eqx.field(static=True)

    def __call__(self, box: Array) -> Array:
        shutter, motion = self.space.at(box)
        with plan_of_traced_search(self.plan):
            value = value_of(self.loss, self.scene, motion, shutter, self.plan)
        return value.astype(box.dtype)

    @property
    def batches(self) -> bool:
        return _many_at_once()


@final
class SpectralObjective(AbstractObjective):
    """The loss of the design at each point where it sees transfer functions alone.

    Attributes:
        nodes: Quadrature nodes of a shutter that stays, which windows of every kind share a
            program by; None where it moves.
    """

    loss: AbstractResponseLoss
    scene: Scene
    space: DesignSpace
    nodes: ExposureQuadrature | None
    plan: Plan = eqx.field(static=True)

    def __call__(self, box: Array) -> Array:
        shutter, motion = self.space.at(box)
        nodes, plan = self.nodes, _plan_of_spectra(self.plan)
        if nodes is None:
            dtype = np.dtype(box.dtype)
            nodes = exposure_quadrature(shutter, self.plan.num_nodes, dtype, path_ends(motion))
        scene, motion = seen_from(self.scene, motion)
        spectra = spectra_of(scene, nodes, motion, plan.num_frequencies, plan.num_kept)
        response = assembled(scene, Records(jnp.zeros(0), spectra, nodes.efficiency), plan)
        value = self.loss.of_response(scene, motion, response, plan)
        return one_real_number(self.loss, value).astype(box.dtype)

    @property
    def batches(self) -> bool:
        return _many_at_once()


@final
class LinearObjective(AbstractObjective):
    """The loss of a weighted sum of responses, one a coordinate of the profile.

    Attributes:
        basis: The response of a closed profile, which a device may leak, then what each
            coordinate adds to it, as rows of real numbers; shape `(size + 1, k)`.
        layout: How such a row is taken apart.
    """

    loss: AbstractResponseLoss
    scene: Scene
    motion: AbstractMotion
    basis: Array
    layout: "Layout" = eqx.field(static=True)
    plan: Plan = eqx.field(static=True)

    def __call__(self, box: Array) -> Array:
        response = self.layout.response(self.basis[0] + box @ self.basis[1:])
        return self.loss.of_response(self.scene, self.motion, response, self.plan)

    @property
    def batches(self) -> bool:
        return True


def objective_of(
    loss: AbstractLoss, scene: Scene, space: DesignSpace, plan: Plan
) -> AbstractObjective:
    """The cheapest exact form of the loss over the space."""
    linear = isinstance(space.shutter, AbstractAdjustableShutter) and space.shutter.linear
    linear = linear and (scene.device is None or scene.device.is_linear)
    alone = plan.skips and space.free == ("shutter",) and linear
    if alone and isinstance(loss, AbstractResponseLoss):
        parts = loss.parts(plan)
        basis, layout = _basis(space, scene, plan, parts)
        plan = _plan_of_spectra(plan) if parts == ONLY_SPECTRA else plan
        return LinearObjective(loss, scene, space.motion, basis, layout, plan)
    if plan.skips and isinstance(loss, AbstractResponseLoss) and loss.parts(plan) == ONLY_SPECTRA:
        require_sizes(plan.num_taps, plan.num_frequencies, kernels=False, spectra=True)
        # Rounding to two numbers an octave lets scenes of other speeds share programs.
        plan, nodes = replace(plan, num_nodes=size_class(plan.num_nodes)), None
        if "shutter" not in space.free and not space.lags:
            light = space.light(space.shutter, space.motion.half_exposure)
            nodes = exposure_quadrature(light, plan.num_nodes, space.dtype, path_ends(space.motion))
            space = replace(space, shutter=RectShutter())
        return SpectralObjective(loss, scene, space, nodes, plan)
    return DesignObjective(loss, scene, space, plan)


def _plan_of_spectra(plan: Plan) -> Plan:
    """A plan without the sizes that a loss of transfer functions does not see: more are equal."""
    unseen = {"num_taps": 1, "dft_length": 1, "loss_dft_length": None, "num_nodes": 1}
    return replace(plan, **unseen, folds=False, still=False)


@dataclass(frozen=True)
class Layout:
    """Where in a row of real numbers the parts of a response lie.

    Attributes:
        num_still: Numbers that stand for the still object's kernel.
        num_differences: Numbers that stand for the differences.
        spectrum_size: Frequencies of the still object's spectrum.
        spectra_shape: Speeds and frequencies of the transfer functions.
    """

    num_still: int
    num_differences: int
    spectrum_size: int
    spectra_shape: tuple[int, ...]

    def response(self, row: Array) -> Response:
        """The response that such a row stands for."""
        sizes = [self.num_still, self.num_differences]
        sizes += [self.spectrum_size, math.prod(self.spectra_shape)] * 2
        *parts, light = jnp.split(row, np.cumsum(sizes).tolist())
        still, differences, spectrum, spectra, spectrum_imag, spectra_imag = parts
        return Response(
            still,
            jax.lax.complex(spectrum, spectrum_imag),
            differences,
            jax.lax.complex(spectra, spectra_imag).reshape(self.spectra_shape),
            light[0],
        )


def _basis(
    space: DesignSpace, scene: Scene, plan: Plan, parts_wanted: Parts
) -> tuple[Array, Layout]:
    """Response of a closed profile and what each coordinate adds to it, and their layout."""
    recorded = _records_of_each(scene, space.motion, space.shutter, space.size, plan, parts_wanted)
    kernels, spectra, light = (
        np.concatenate([part[:1], part[1:] - part[:1]]) for part in map(np.asarray, recorded)
    )
    still = spectrum = differences = np.zeros((light.size, 0), light.dtype)
    if parts_wanted.kernels:
        shares = np.sqrt(np.asarray(scene.weights, light.dtype))[: kernels.shape[1] - 1, None]
        spectrum = np.fft.rfft(*folded(kernels[:, 0], plan))
        still = _triangular(kernels[:, 0])
        differences = _triangular(shares * (kernels[:, 1:] - kernels[:, :1]))
    waves = spectrum, spectra
    parts = [still, differences, *map(np.real, waves), *map(np.imag, waves), light]
    rows = np.concatenate([np.reshape(part, (light.size, -1)) for part in parts], axis=1)
    layout = Layout(still.shape[1], differences.shape[1], spectrum.shape[1], spectra.shape[1:])
    return jax.device_put(rows.astype(light.dtype)), layout


@compiled
def _records_of_each(
    scene: Scene,
    motion: AbstractMotion,
    profile: Any,
    num_coordinates: int,
    plan: Plan,
    parts_wanted: Parts,
) -> Records:
    """Records of a closed profile, and of one with each coordinate alone at 1; one program."""

    def one(corner: Array) -> Records:
        passed = transmittance(scene, motion, profile.at(corner))
        return records(SampledView(scene, motion, passed, plan, parts_wanted))

    dtype = common_dtype(motion.half_exposure, scene.speeds)
    corners = jnp.eye(num_coordinates + 1, num_coordinates, -1, dtype=dtype)
    return jax.lax.map(one, corners)


def _triangular(rows: np.ndarray) -> np.ndarray:
    r"""Rows that only count by their sum of squares, rotated to a few.

    $\|\sum_j c_j d_j\| = \|R c\|$ for the triangular factor $R$ of the $d_j$ as columns:
    as many numbers as coordinates stand for all taps at all speeds.
    """
    return np.transpose(np.asarray(np.linalg.qr(rows.reshape(rows.shape[0], -1).T, mode="r")))
