"""The level of frames of things that move in any direction: `exposures_psnr` by its other names."""

from dataclasses import replace

from jaxtyping import Array, Float

from mishutter.evaluation.fans import MEASURED, Grid
from mishutter.evaluation.levels import level_of, require_velocities
from mishutter.model.scene import Scene, require_scene
from mishutter.model.velocities import EvenVelocities
from mishutter.plane.frames import PlaneFrames


def plane_psnr(
    scene: Scene,
    frames: PlaneFrames,
    *,
    grid: Grid = MEASURED,
    num_panels: int | None = None,
) -> Float[Array, ""]:
    """PSNR of the best linear decoder that finds the velocity in frames, in linear light; dB.

    It is `exposures_psnr`, for scenes in the plane alone.

    Args:
        scene: Velocities in any direction, light and noise; its picture and cutoff are concrete.
        frames: The frames.
        grid: Sizes of the fan of directions.
        num_panels: Panels of 16 nodes in each frame; by default those that concrete frames need.

    Raises:
        ValueError: if the scene is of one axis, the frames are traced without `num_panels`, or
            something passes more than 10 px in a panel.
    """
    require_scene(scene, in_plane=True)
    require_velocities(scene)
    return level_of(scene, frames, "plane_psnr", grid, num_panels=num_panels)


def cross_motion_loss(scene: Scene, frames: PlaneFrames, *, across: float = 0.1) -> float:
    """Decibels that frames lose where things that move along one axis move across it too.

    Velocities fill an ellipse whose longer half axis is the greatest speed of the scene; the loss
    is that against an ellipse of nothing across. `frames_of` makes such frames of those of a
    `FrameSequence`.
    """
    fastest = float(scene.max_speed)
    levels = [
        plane_psnr(replace(scene, velocities=EvenVelocities(fastest, share * fastest)), frames)
        for share in (0.0, across)
    ]
    return float(levels[0] - levels[1])
