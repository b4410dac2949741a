"""The best profile at each point of a block: the one that `optimise` finds on its motion."""

from typing import NamedTuple, cast

import jax
import numpy as np
from jaxtyping import Bool, Float

from mishutter.evaluation import automatic, coarser
from mishutter.model import AbstractMotion, ParabolicMotion, Scene, SplineShutter, steady
from mishutter.search import SearchSettings, Start, best_design
from mishutter.sweeps.grid import Search


class Profiles(NamedTuple):
    """The best profiles of `n` points.

    Attributes:
        boxes: Coordinates of each profile.
        losses: Loss of each.
        converged: Whether each search converged.
    """

    boxes: Float[np.ndarray, "n c"]
    losses: Float[np.ndarray, "n"]
    converged: Bool[np.ndarray, "n"]


def basis_of(profile: SplineShutter) -> list[SplineShutter]:
    """The basis of a kind of profile: a closed one, then each coordinate alone open."""
    size = profile.parameters.size
    corners = np.eye(size + 1, size, -1, dtype=profile.parameters.dtype)
    return [profile.at(jax.device_put(corner)) for corner in corners]


def search(
    settings: Search, scene: Scene, motions: AbstractMotion, profile: SplineShutter
) -> Profiles:
    """The best profiles of a kind on some motions of a scene."""
    accelerations = np.asarray(steady(motions).acceleration)
    half_exposures = np.asarray(motions.half_exposure)
    boxes = np.zeros((accelerations.size, profile.parameters.size))
    losses, converged = np.zeros(len(boxes)), np.zeros(len(boxes), bool)
    for index in range(len(boxes)):
        motion = ParabolicMotion(
            acceleration=accelerations[index], half_exposure=half_exposures[index]
        )
        # A plan for every motion within the limits lets points share programs.
        shared = SearchSettings(
            settings.loss,
            coarser(automatic(scene, motion, profile)),
            seed=settings.seed,
            max_steps=settings.max_steps,
        )
        design = best_design(Start(scene, motion, profile, ("shutter",)), shared)
        boxes[index] = cast(SplineShutter, design.command).parameters
        losses[index], converged[index] = design.loss, design.converged
    return Profiles(boxes, losses, converged)


def coefficients_of(
    boxes: Float[np.ndarray, "*points c"], profile: SplineShutter
) -> Float[np.ndarray, "*points n"]:
    """B-spline coefficients of profiles of a kind."""
    if not profile.symmetric:
        return boxes
    mirrored = boxes[..., : profile.num_coefficients // 2]
    return np.concatenate([boxes, mirrored[..., ::-1]], axis=-1)
