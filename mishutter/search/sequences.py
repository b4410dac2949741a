"""The frames that a camera with a burst is to take, if it is to take more than one exposure."""

from mishutter.evaluation import best_moving_burst, best_still_burst, with_losses
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
    return tuple(with_losses(scene, each) for each in found if each is not None)


def to_take(bursts: tuple[FrameSequence, ...], *, at_worst: bool = False) -> FrameSequence:
    """The burst that moves, or that at rest where moving gains less than is worth a stage.

    On a sensor of a known width each is judged by what it leaves there.

    Args:
        bursts: As `best_bursts` returns them, of which there are two.
        at_worst: Whether levels are those at the worst of the speeds.
    """
    still, moving = bursts
    gain = _level(moving, at_worst=at_worst) - _level(still, at_worst=at_worst)
    return moving if moves_rather(moving, still, gain) else still


def moves_rather(moving: FrameSequence, still: FrameSequence, gain: float) -> bool:
    """Whether a burst that moves is worth a stage, beside one at rest.

    Args:
        moving: The burst that moves.
        still: That at rest.
        gain: Level of the first above that of the second, on an endless sensor; dB.
    """
    losses = moving.width_loss, still.width_loss
    more = 0.0 if None in losses else losses[0] - losses[1]  # type: ignore[operator]
    return gain - more >= WORTH_IT


def pays(burst: FrameSequence, gain: float, *, builds: bool = True) -> bool:
    """Whether a burst is worth taking in place of one exposure.

    One at rest takes nothing to build, and needs to be no better than what does.

    Args:
        burst: The burst.
        gain: Its level above that of the exposure, by a decoder that knows the speed; dB.
        builds: Whether the exposure takes something to build.
    """
    is_simpler = builds and not burst.moves
    return burst.num_frames > 1 and gain >= (-WORTH_IT if is_simpler else WORTH_IT)


def instead_of(
    bursts: tuple[FrameSequence, ...], level: float, *, at_worst: bool = False
) -> FrameSequence | None:
    """The burst to take in place of a design of one exposure; None where that is as good.

    Args:
        bursts: As `best_bursts` returns them.
        level: PSNR of the design by a decoder that knows the speed; dB.
        at_worst: Whether it is the level at the worst of the speeds.
    """
    if not bursts:
        return None
    burst = to_take(bursts, at_worst=at_worst)
    return burst if pays(burst, _level(burst, at_worst=at_worst) - level) else None


def _level(burst: FrameSequence, *, at_worst: bool) -> float:
    return burst.worst_psnr if at_worst else burst.psnr
