"""The best profile at each point of a block: the one that `optimise` finds on its motion."""

from typing import NamedTuple, cast

import jax
import numpy as np

from mishutter.evaluation import automatic, coarser
from mishutter.model import AbstractMotion, ParabolicMotion, Scene, SplineShutter, steady
from mishutter.search import optimise
from mishutter.sweeps.grid import Search


class Profiles(NamedTuple):
    """The best profiles of `n` points.

    Attributes:
        boxes: Coordinates of each profile; shape `(n, c)`.
        losses: Loss of each; shape `(n,)`.
        converged: Whether each search converged; shape `(n,)`.
    """

    boxes: np.ndarray
    losses: np.ndarray
    converged: np.ndarray


def basis_of(profile: SplineShutter) -> list[SplineShutter]:
    """The basis of a kind of profile: a closed one, then each coordinate alone open."""
    size = profile.parameters.size
    corners = np.eye(size + 1, size, -1, dtype=profile.parameters.dtype)
    return [profile.at(jax.device_put(corner)) for corner in corners]


def search(
    settings: Search, scene: Scene, motions: AbstractMotion, profile: SplineShutter, skips: bool
) -> Profiles:
    """The best profiles of a kind on some motions of a scene."""
    numbers = np.asarray(steady(motions).acceleration), np.asarray(motions.half_exposure)
    boxes = np.zeros((numbers[0].size, profile.parameters.size))
    losses, converged = np.zeros(len(boxes)), np.zeros(len(boxes), bool)
    for index, (acceleration, half_exposure) in enumerate(zip(*numbers, strict=True)):
        motion = ParabolicMotion(acceleration=acceleration, half_exposure=half_exposure)
        # A plan for every motion within the limits lets points share programs.
        design = optimise(
            scene,
            motion,
            profile,
            loss=settings.loss,
            free="shutter",
            seed=settings.seed,
            max_steps=settings.max_steps,
            plan=coarser(automatic(scene, motion, profile)) if skips else None,
        )
        boxes[index] = cast(SplineShutter, design.command).parameters
        losses[index], converged[index] = design.loss, design.converged
    return Profiles(boxes, losses, converged)


def coefficients_of(boxes: np.ndarray, profile: SplineShutter) -> np.ndarray:
    """B-spline coefficients of profiles of a kind; shape `(..., n)`."""
    if not profile.symmetric:
        return boxes
    mirrored = boxes[..., : profile.num_coefficients // 2]
    return np.concatenate([boxes, mirrored[..., ::-1]], axis=-1)
