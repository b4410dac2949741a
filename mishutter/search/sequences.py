"""The frames that a camera with a burst is to take, if it is to take more than one exposure."""

from mishutter.evaluation import best_moving_burst, best_still_burst
from mishutter.model import FrameSequence, Scene, require_scene
from mishutter.search.rows import WORTH_IT


def best_sequence(scene: Scene) -> FrameSequence | None:
    """The frames to take of a camera with a `Burst`, by a decoder that registers them.

    They are those of the best burst of a sensor that moves, or those of one at rest where moving
    gains less than 0.1 dB.

    Args:
        scene: Speeds, light, noise, limits and burst.

    Returns:
        Motion and time of each frame, and their level; None of a scene without a burst.
    """
    require_scene(scene)
    bursts = best_bursts(scene)
    return to_take(bursts) if bursts else None


def best_bursts(scene: Scene) -> tuple[FrameSequence, ...]:
    """The best burst of a sensor at rest, and that of one that moves; none without `scene.burst`.

    Args:
        scene: Speeds, light, noise, limits and burst.
    """
    found = best_still_burst(scene), best_moving_burst(scene)
    return tuple(each for each in found if each is not None)


def to_take(bursts: tuple[FrameSequence, ...]) -> FrameSequence:
    """The burst that moves, or that at rest where moving gains less than is worth a stage.

    Args:
        bursts: As `best_bursts` returns them, of which there are two.
    """
    still, moving = bursts
    return moving if moving.psnr >= still.psnr + WORTH_IT else still


def instead_of(
    bursts: tuple[FrameSequence, ...], level: float, *, at_worst: bool = False
) -> FrameSequence | None:
    """The burst to take in place of a design of one exposure; None where that is as good.

    One at rest takes nothing to build, and needs to be no better than what does.

    Args:
        bursts: As `best_bursts` returns them.
        level: PSNR of the design by a decoder that knows the speed; dB.
        at_worst: Whether it is the level at the worst of the speeds.
    """
    if not bursts:
        return None
    burst = to_take(bursts)
    own = burst.worst_psnr if at_worst else burst.psnr
    is_worth_it = own >= level + (WORTH_IT if burst.moves else -WORTH_IT)
    return burst if burst.num_frames > 1 and is_worth_it else None
