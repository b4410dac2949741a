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
from mishutter.blur import LitNodes, lit_nodes
from mishutter.design.space import DesignSpace
from mishutter.evaluation import (
    AbstractLoss,
    AbstractResponseLoss,
    Parts,
    Plan,
    Records,
    Response,
    aligned_spectra,
    assembled,
    picture_power,
    records,
    value_of,
)
from mishutter.model import AbstractAdjustableShutter, AbstractMotion, RectShutter, Scene

_ROUGH_FREQUENCIES = 64
_ROUGH_NODES = 0.7
"""Share of the nodes: where the longest path turns fastest, what they sum to is then wrong by
parts in ten thousand."""
_ONLY_SPECTRA = Parts(kernels=False, spectra=True, differences=False)


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
        return value_of(self.loss, self.scene, motion, shutter, self.plan).astype(box.dtype)

    @property
    def batches(self) -> bool:
        return _many_at_once()


@final
class MotionObjective(AbstractObjective):
    """The loss of a shutter that stays, on the motion at each point.

    It sees the shutter by its nodes alone, so that one program serves every kind of it.
    """

    loss: AbstractResponseLoss
    scene: Scene
    space: DesignSpace
    nodes: LitNodes
    plan: Plan = eqx.field(static=True)

    def __call__(self, box: Array) -> Array:
        _, motion = self.space.at(box)
        grid = self.plan.num_frequencies, self.plan.num_kept
        spectra = aligned_spectra(self.nodes, motion, self.scene.speeds, *grid)
        light = self.nodes.efficiency
        response = assembled(self.scene, Records(jnp.zeros(0), spectra, light), self.plan)
        return self.loss.of_response(self.scene, motion, response, self.plan)

    @property
    def batches(self) -> bool:
        return _many_at_once()


@final
class LinearObjective(AbstractObjective):
    """The loss of a weighted sum of responses, one a coordinate of the profile.

    Attributes:
        basis: Each coordinate's response as one row of real numbers; shape `(size, k)`.
        layout: How such a row is taken apart.
    """

    loss: AbstractResponseLoss
    scene: Scene
    motion: AbstractMotion
    basis: Array
    layout: "Layout" = eqx.field(static=True)
    plan: Plan = eqx.field(static=True)

    def __call__(self, box: Array) -> Array:
        response = self.layout.response(box @ self.basis)
        return self.loss.of_response(self.scene, self.motion, response, self.plan)

    @property
    def batches(self) -> bool:
        return True


def objective_of(
    loss: AbstractLoss, scene: Scene, space: DesignSpace, plan: Plan
) -> AbstractObjective:
    """The cheapest exact form of the loss over the space."""
    linear = isinstance(space.shutter, AbstractAdjustableShutter) and space.shutter.linear
    alone = plan.skips and space.free == ("shutter",) and linear
    if alone and isinstance(loss, AbstractResponseLoss):
        basis, layout = _basis(space, scene, plan, loss.parts(plan))
        return LinearObjective(loss, scene, space.motion, basis, layout, plan)
    held = plan.skips and "shutter" not in space.free
    if held and isinstance(loss, AbstractResponseLoss) and loss.parts(plan) == _ONLY_SPECTRA:
        nodes = lit_nodes(space.shutter, plan.num_nodes, np.dtype(space.max_speed.dtype))
        space = replace(space, shutter=RectShutter())
        return MotionObjective(loss, scene, space, nodes, plan)
    return DesignObjective(loss, scene, space, plan)


def roughly(objective: AbstractObjective, space: DesignSpace) -> AbstractObjective:
    """The objective on fewer frequencies and nodes, where they take the time; itself where not.

    Good enough to descend on where the ends are finished on the whole.
    """
    if not isinstance(objective, DesignObjective | MotionObjective):
        return objective
    plan, scene = objective.plan, objective.scene
    share = plan.num_frequencies // _ROUGH_FREQUENCIES
    if share <= 1 or not plan.skips:
        return objective
    kept = plan.num_kept
    rough = replace(
        plan,
        num_frequencies=_ROUGH_FREQUENCIES,
        num_kept=kept and math.ceil(kept * _ROUGH_FREQUENCIES / plan.num_frequencies),
        num_nodes=math.ceil(plan.num_nodes * _ROUGH_NODES),
    )
    # The mean power of each band: it is steep, and where a band's middle lies says little.
    dtype = np.dtype(scene.speeds.dtype)
    power = np.asarray(picture_power(scene, _ROUGH_FREQUENCIES * share, dtype))
    bands = jax.device_put(power.reshape(_ROUGH_FREQUENCIES, share).mean(axis=1))
    banded = eqx.tree_at(lambda s: s.power_spectrum, scene, bands, is_leaf=lambda x: x is None)
    return objective_of(objective.loss, banded, space, rough)


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
    """Response of each coordinate alone, and what it is laid out as."""
    recorded = _records_of_each(scene, space.motion, space.shutter, space.size, plan, parts_wanted)
    kernels, spectra, light = map(np.asarray, recorded)
    still = spectrum = differences = np.zeros((light.size, 0), light.dtype)
    if parts_wanted.kernels:
        shares = np.sqrt(np.asarray(scene.weights, light.dtype))[: kernels.shape[1] - 1, None]
        spectrum = np.fft.rfft(kernels[:, 0], plan.dft_length)
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
    """Of a profile with each coordinate alone at 1, by one program."""

    def one(corner: Array) -> Records:
        return records(scene, motion, profile.at(corner), plan, *parts_wanted)

    dtype = common_dtype(motion.half_exposure, scene.speeds)
    corners = jnp.eye(num_coordinates, dtype=dtype)
    return jax.lax.map(one, corners)


def _triangular(rows: np.ndarray) -> np.ndarray:
    r"""Rows that only count by their sum of squares, rotated to a few.

    $\|\sum_j c_j d_j\| = \|R c\|$ for the triangular factor $R$ of the $d_j$ as columns:
    as many numbers as coordinates stand for all taps at all speeds.
    """
    return np.transpose(np.asarray(np.linalg.qr(rows.reshape(rows.shape[0], -1).T, mode="r")))
