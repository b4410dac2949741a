"""The frames that a camera with a burst is to take, if it is to take more than one exposure."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mishutter._core.progress import counts
from mishutter.evaluation.bursts import best_still_burst
from mishutter.evaluation.registration import with_losses
from mishutter.model.exposures import Exposures
from mishutter.model.frame_path import AT_REST
from mishutter.model.scene import Scene, require_scene
from mishutter.search.moving_frames import best_moving_burst
from mishutter.search.rows import simplest_of


def best_sequence(scene: Scene) -> Exposures | None:
    """The frames to take of a camera with a `BurstMode`, by a decoder that registers them.

    They are those of the best burst of a sensor that moves, or those of one at rest where moving
    gains less than 0.2 dB.

    Args:
        scene: Speeds, light, noise, limits and burst.

    Returns:
        Motion and time of each frame, and their level; None of a scene without a burst.
    """
    require_scene(scene)
    bursts = best_bursts(scene)
    return choose_burst(bursts) if bursts else None


def best_bursts(
    scene: Scene, *, progress: Callable[[float], None] = lambda share: None
) -> tuple[Exposures, ...]:
    """The best burst of a sensor at rest, and those that move; none without `scene.burst`.

    A camera that turns needs no stage: what it does alone stands beside what it does with one.
    Where things are found one by one there is only the burst at rest: `restore` finds them in such
    frames alone.
    """
    found, limits = [best_still_burst(scene)], scene.limits
    if not scene.is_found_by_object:
        found.append(best_moving_burst(scene, progress=progress))
        if limits.pans == "camera" and limits.moves and float(limits.max_pan) > 0:
            alone = best_moving_burst(replace(scene, limits=replace(limits, max_stroke=0.0)))
            found += [alone] if alone is not None and alone.moves else []
    return tuple(with_losses(scene, each) for each in found if each is not None)


def shown_bursts(scene: Scene, *, is_shown: bool) -> tuple[Exposures, ...]:
    """As `best_bursts`, with a bar where it is asked for."""
    with counts(is_shown and scene.burst is not None, "searching", 1) as counter:
        name = "several frames"
        counter.next(name)
        return best_bursts(scene, progress=lambda share: counter.within(name, share))


def choose_burst(
    bursts: tuple[Exposures, ...],
    level: float = -math.inf,
    rank: tuple[int, ...] = (),
    *,
    at_worst: bool = False,
) -> Exposures | None:
    """The burst to take, or None for one exposure that is as good and as simple."""
    several = [burst for burst in bursts if burst.num_frames > 1 or not rank]
    options = []
    for burst in several:
        parts = int(burst.stroke >= AT_REST) + int(np.any(burst.pan))
        options.append((burst.level_of(at_worst=at_worst), (parts, parts + 1), burst))
    return simplest_of([*options, (level, rank, None)] if rank else options)
