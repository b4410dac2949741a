r"""The best profile at each point of a block, from its neighbours' profiles.

At one point the transfer functions are linear in the profile's coefficients, so those of
every basis function are computed once, by the program that measures fixed shutters, and a
step of the search is a small matrix product. The exposures of a block are done one after
the other: each point starts from what its neighbours at the last exposure ended with.
"""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache, partial
from typing import final

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array

from mishutter._core import compiled
from mishutter.evaluation import AbstractResponseLoss, Plan, Response, sizes
from mishutter.model import (
    HannShutter,
    ParabolicMotion,
    RectShutter,
    Scene,
    SplineShutter,
    TukeyShutter,
    frequency_grid,
)
from mishutter.sweeps.grid import Block, Search
from mishutter.sweeps.layout import Kit, Layout
from mishutter.sweeps.points import FREQUENCIES_A_TURN, PARTS, SceneNumbers, Tile
from mishutter.sweeps.spectra import Spectra, aligned_spectra
from mishutter.sweeps.tables import Tables

_MARGIN = 0.02
_COARSE_STEP = 8
"""The descents from every start see one frequency for so many; the best is finished on all."""


@lru_cache
def start_boxes(num_coefficients: int, symmetric: bool, seed: int) -> np.ndarray:
    """Profiles that a search starts from without neighbours: windows and a random one."""
    windows = (TukeyShutter(0.5), HannShutter(), RectShutter())
    fits = [SplineShutter.fit(w, num_coefficients, symmetric=symmetric) for w in windows]
    boxes = np.stack([np.asarray(fit.box()) for fit in fits])
    random = np.random.default_rng(seed).uniform(size=boxes.shape[1])
    return np.concatenate([boxes, random[None]])


def basis_shutters(search: Search) -> list[SplineShutter]:
    """The profile's basis functions, each with one coordinate open."""
    first = SplineShutter.fit(RectShutter(), search.num_coefficients, symmetric=search.symmetric)
    return [first.at(box) for box in jnp.eye(first.box().size, dtype=first.parameters.dtype)]


@compiled
def search_tile(
    tables: Tables,
    numbers: SceneNumbers,
    scene: Scene,
    loss: AbstractResponseLoss,
    plan: Plan,
    tile: Tile,
    starts: Array,
    max_steps: int,
    tolerance: float,
) -> tuple[Array, Array]:
    """Best profile of every point of a tile, and its loss.

    Args:
        tables: Tables of the basis functions.
        numbers: What the scene brings.
        scene: The scene at the speeds of `numbers`.
        loss: What is made small.
        plan: For the loss; static.
        tile: The points, `j` of them.
        starts: Boxes to start from; shape `(j, n, c)`.
        max_steps: Steps of a descent, at most.
        tolerance: Relative change at which one ends.

    Returns:
        Boxes `(j, c)` and losses `(j,)`.
    """
    num_coarse = plan.num_frequencies // _COARSE_STEP
    coarse = _spectra_of_points(tables, numbers, tile, num_coarse)
    fine = _spectra_of_points(tables, numbers, tile, plan.num_frequencies)

    def of_point(acceleration: Array, boxes: Array, coarse: Spectra, fine: Spectra):
        motion = ParabolicMotion(acceleration=acceleration, half_exposure=tile.half_exposure)
        few = replace(plan, num_frequencies=num_coarse)
        rough = partial(_loss_at, loss, scene, motion, few, tables.efficiency, coarse)
        exact = partial(_loss_at, loss, scene, motion, plan, tables.efficiency, fine)
        descend = partial(_descend, max_steps=max_steps, tolerance=tolerance)
        ends = jax.vmap(partial(descend, rough))(boxes)
        ends = jnp.concatenate([ends, boxes])
        start = _best(ends, jax.vmap(exact)(ends))[0]
        end = jnp.stack([descend(exact, start), start])
        return _best(end, jax.vmap(exact)(end))

    return jax.vmap(of_point)(tile.accelerations, starts, coarse, fine)


def _loss_at(
    loss: AbstractResponseLoss,
    scene: Scene,
    motion: ParabolicMotion,
    plan: Plan,
    efficiency: Array,
    basis: Spectra,
    box: Array,
) -> Array:
    """Loss of a profile, from the transfer functions of its basis, `(k, s, m)`; scalar."""
    spectra = jax.lax.complex(*(jnp.tensordot(box, part, 1) for part in basis))
    empty = jnp.zeros(0, box.dtype)
    response = Response(empty, empty.astype(spectra.dtype), empty, spectra, box @ efficiency)
    return loss.of_response(scene, motion, response, plan)


def _descend(
    objective: Callable[[Array], Array], box: Array, max_steps: int, tolerance: float
) -> Array:
    r"""Optimistix BFGS in the unit box, through $x = \sin^2\theta$; shape `(c,)`."""
    theta = jnp.arcsin(jnp.sqrt(jnp.clip(box, _MARGIN, 1 - _MARGIN)))
    solver = optx.BFGS(rtol=tolerance, atol=tolerance)
    ended = optx.minimise(
        lambda y, _: objective(jnp.sin(y) ** 2), solver, theta, max_steps=max_steps, throw=False
    )
    return jnp.sin(ended.value) ** 2


def _best(boxes: Array, losses: Array) -> tuple[Array, Array]:
    best = jnp.argmin(jnp.where(jnp.isfinite(losses), losses, jnp.inf))
    return boxes[best], losses[best]


def _spectra_of_points(tables: Tables, numbers: SceneNumbers, tile: Tile, count: int) -> Spectra:
    """Transfer functions of the basis at every point; shape `(j, k, s, m)`."""
    frequency = frequency_grid(count, np.dtype(numbers.speeds.dtype))
    chunks = frequency.reshape(-1, math.gcd(count, FREQUENCIES_A_TURN))
    parts = ((jnp.arange(chunks.shape[0]) + 1) * PARTS - 1) // chunks.shape[0]
    found = jax.lax.map(lambda x: aligned_spectra(tables, numbers, tile, *x), (chunks, parts))
    whole = (part.reshape(count, *part.shape[2:]) for part in found)
    return Spectra(*(jnp.moveaxis(part, (3, 2, 1, 0), (0, 1, 2, 3)) for part in whole))


@final
class Searcher:
    """The search over the blocks of a grid.

    Args:
        layout: The points.
        basis: The profile's basis functions.
        settings: How it is searched.
    """

    def __init__(self, layout: Layout, basis: Kit, settings: Search):
        self.layout, self.basis, self.settings = layout, basis, settings
        given = settings.num_coefficients, settings.symmetric, settings.seed
        self.without_neighbours = start_boxes(*given)

    def search(self, block: Block) -> tuple[np.ndarray, np.ndarray]:
        """Best boxes `(a, t, c)` and losses `(a, t)` of a block, NaN outside the limits."""
        layout, settings = self.layout, self.settings
        scene = layout.scenes[block.scene]
        inside = layout.inside(block)
        numbers = layout.scene_numbers(scene, symmetric=self.basis.symmetric)
        seen = _seen(scene, self.basis.symmetric, numbers)
        boxes = np.full((*inside.shape, self.without_neighbours.shape[1]), np.nan)
        losses = np.full(inside.shape, np.nan)
        plan = sizes(seen, ParabolicMotion(acceleration=1.0, half_exposure=1e-3))
        tiles = layout.tiles(block, self.basis.tile_size)
        for chosen in tiles:
            stacked = layout.stacked(block, [chosen], self.basis, 1)
            tile = jax.tree.map(lambda x: x[0], stacked)
            starts = starts_at(self.without_neighbours, boxes, chosen.rows, chosen.column)
            spare = self.basis.tile_size - chosen.rows.size
            starts = np.pad(starts, ((0, spare), (0, 0), (0, 0)), "edge")
            count = layout.tile_sizes.grids[int(tile.grid)]
            found, loss = search_tile(
                self.basis.tables,
                numbers,
                seen,
                settings.loss,
                replace(plan, num_frequencies=count),
                tile,
                jnp.asarray(starts, layout.grid.dtype),
                settings.max_steps,
                settings.tolerance,
            )
            boxes[chosen.rows, chosen.column] = np.asarray(found)[: chosen.rows.size]
            losses[chosen.rows, chosen.column] = np.asarray(loss)[: chosen.rows.size]
        return boxes, losses


def starts_at(first: np.ndarray, boxes: np.ndarray, rows: np.ndarray, column: int) -> np.ndarray:
    """A window and what the neighbours at the last exposure ended with; `(j, n, c)`.

    Args:
        first: What stands for neighbours that are not there; shape `(n, c)`.
        boxes: What was found so far, NaN elsewhere; shape `(a, t, c)`.
        rows: Accelerations; shape `(j,)`.
        column: The exposure.
    """
    starts = np.tile(first[None], (rows.size, 1, 1))
    if column == 0:
        return starts
    for number, step in enumerate((0, -1, 1), start=1):
        near = np.clip(rows + step, 0, boxes.shape[0] - 1)
        known = boxes[near, column - 1]
        there = ~np.isnan(known[:, 0])
        starts[there, -number] = known[there]
    return starts


def coefficients_of(boxes: np.ndarray, settings: Search) -> np.ndarray:
    """B-spline coefficients of profiles; shape `(a, t, n)`."""
    if not settings.symmetric:
        return boxes
    return np.concatenate([boxes, boxes[..., : settings.num_coefficients // 2][..., ::-1]], -1)


def _seen(scene: Scene, symmetric: bool, numbers: SceneNumbers) -> Scene:
    """The scene at the speeds of the transfer functions, in their order."""
    speeds = np.asarray(numbers.speeds)
    signed = speeds if symmetric else np.concatenate([speeds, -speeds])
    return scene.bare(signed, np.asarray(numbers.weights).ravel())
