"""Frames of a sensor that moves in the plane, with their level and what they ask of a stage."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, final

import equinox as eqx
import numpy as np
from jaxtyping import Float

from mishutter.evaluation.levels import require_velocities
from mishutter.model.exposures import AbstractExposures
from mishutter.model.limits import Limits
from mishutter.model.scene import Scene, require_scene
from mishutter.model.sequences import TimedFrame
from mishutter.model.stages import Knots, StagePath, StageUse
from mishutter.model.velocities import AbstractVelocities
from mishutter.plane.frames import PlaneFrames


@final
@dataclass(frozen=True)
class PlaneBurst(AbstractExposures):
    """Frames of a sensor that moves in the plane, and their level.

    Attributes:
        kind: The way of the sensor, in words.
        num_axes: Axes of the stage that it needs; 0 at rest.
        frames: The frames and the path through them.
        psnr: PSNR of the best linear decoder that finds the velocity; dB.
        use: Demands on an axis of the stage, from rest to rest.
        width_loss: Loss by things that enter and leave the scene's sensor or object, a square of
            its width; dB. None of one frame, and where no width is known.
        pan: Velocity at which the camera turns meanwhile along rows and columns, which the stage
            does not follow; px/s.
    """

    kind: str
    num_axes: int
    frames: PlaneFrames
    psnr: float
    use: StageUse
    width_loss: float | None = None
    pan: tuple[float, ...] = (0.0, 0.0)
    axes: ClassVar = ("_x", "_y")

    @property
    def level(self) -> float:
        """PSNR on a sensor of the scene's width; dB."""
        return self.psnr - (self.width_loss or 0.0)

    @property
    def travel(self) -> float:
        """Travel of an axis of the stage, from rest to rest; px."""
        return float(self.use.travel)

    @property
    def stroke(self) -> float:
        """Travel of an axis of the stage from the first light to the last; px."""
        return float(self.use.stroke)

    @property
    def times(self) -> list[float]:
        """Mid-exposures; s."""
        return np.asarray(self.frames.times).tolist()

    @property
    def exposures(self) -> list[float]:
        """Exposure of each frame; s."""
        return np.asarray(self.frames.exposures).tolist()

    @property
    def rests(self) -> list[bool]:
        """Whether the sensor stands still in all frames, for each."""
        return [self.frames.stays] * self.num_frames

    def place(self, times: Float[np.ndarray, "n q"]) -> Float[np.ndarray, "2 n q"]:
        """Places of the sensor at some times; px.

        Args:
            times: Times in each exposure; s.
        """
        return np.asarray(self.frames.place(times), np.float64)

    def stage_paths(self, scene: Scene) -> dict[str, StagePath]:
        """The paths of the stage along rows and columns, each about the middle of its travel.

        Args:
            scene: The scene, whose limits say how the stage runs up.
        """
        require_scene(scene, in_plane=True)
        frames = of_stage(self.frames, pan_over(scene, self.frames))
        return dict(zip(self.axes, frames.stage_paths(scene.limits), strict=False))

    @property
    def text(self) -> str:
        """The frames in words, and their level."""
        loss = self.width_loss
        less = "" if loss is None else f", less {loss:.2g} by the width of the sensor"
        return f"{self.kind}, {self.setting}: {self.psnr:.2f} dB{less}"

    def __repr__(self) -> str:
        return f"PlaneBurst({self.text})"


def burst_of(
    scene: Scene,
    kind: str,
    num_axes: int,
    frames: PlaneFrames,
    psnr: float,
    *,
    width_loss: float | None = None,
) -> PlaneBurst:
    """Frames with what they ask of a stage, beside a camera that turns where they move."""
    pan = pan_over(scene, frames)
    use = of_stage(frames, pan).use(scene.limits)
    return PlaneBurst(kind, num_axes, frames, psnr, use, width_loss, (*pan.tolist(),))


def pan_over(scene: Scene, frames: PlaneFrames) -> Float[np.ndarray, "2"]:
    """Velocity at which the camera turns over frames, 0 if they are at rest; px/s."""
    return np.zeros(2) if frames.stays else turned_by(require_velocities(scene), scene.limits)


def turned_by(velocities: AbstractVelocities, limits: Limits) -> Float[np.ndarray, "2"]:
    """Velocity of a camera that pans by turning along with the mean of the things; px/s."""
    centre, most = velocities.centre, float(limits.max_pan) if limits.pans == "camera" else 0.0
    speed = float(np.hypot(*centre))
    return centre * min(1.0, most / speed) if speed > 0 else centre


def of_stage(frames: PlaneFrames, pan: Float[np.ndarray, "2"]) -> PlaneFrames:
    """Frames that move as the stage makes them, beside a camera that turns at a velocity, px/s."""
    if not np.any(pan):
        return frames
    velocity = frames.velocities - pan[:, None]
    return eqx.tree_at(lambda x: x.velocities, frames, velocity)


def frames_of(frames: Sequence[TimedFrame], angle: float = 0.0) -> PlaneFrames:
    """Frames along one axis as frames in the plane, of which the gaps say nothing."""
    every = [(frame, Knots.of_exposure(frame.motion)) for frame in frames]
    lengths = [knots.durations for _, knots in every]
    for index, ((before, _), (frame, _)) in enumerate(itertools.pairwise(every)):
        gap = frame.time - before.time - (frame.exposure + before.exposure) / 2
        lengths[index] = np.append(lengths[index], max(gap, 0.0))
    along = np.concatenate([knots.velocities for _, knots in every])
    return PlaneFrames(
        np.array([frame.time for frame, _ in every]),
        np.array([frame.exposure for frame, _ in every]),
        np.concatenate(lengths),
        np.stack([math.cos(angle) * along, math.sin(angle) * along]),
    )
