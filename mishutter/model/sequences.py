"""Frames that a camera takes one after the other of the same picture, and what its sensor does."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import takewhile

import numpy as np

from mishutter.model.motion import AbstractMotion

_AT_REST = 0.05
"""Travel over a frame below which its sensor counts as standing still; px."""


@dataclass(frozen=True)
class TimedFrame:
    """An exposure of an open shutter, one of a sequence.

    Attributes:
        motion: Motion of the sensor, from its mid-exposure.
        time: Mid-exposure, from the middle of the sequence; s.
        position: Place of the sensor at mid-exposure, on the way of a camera that pans; px.
    """

    motion: AbstractMotion
    time: float
    position: float = 0.0

    @property
    def exposure(self) -> float:
        """Time from its first to its last light; s."""
        return float(self.motion.exposure)

    @property
    def is_still(self) -> bool:
        """Whether its sensor stands still."""
        return float(self.motion.stroke) < _AT_REST


@dataclass(frozen=True)
class FrameSequence:
    """Frames of one picture in the order in which they are exposed, for a decoder that aligns them.

    Attributes:
        kind: The path of the sensor over the sequence, in words.
        frames: The frames.
        travel: Way of the stage, from its lowest to its highest position; px.
        psnr: PSNR of the best linear decoder, which knows the speed from the frames, in the scene
            that they were found for; in linear light, dB.
        worst_psnr: The same at the worst of the scene's speeds; dB.
        pan: Velocity at which the camera turns meanwhile, which the stage does not follow; px/s.
        registration_loss: Least loss, at the worst of the speeds, of a decoder that finds the speed
            in 64 x 64 px of the frames; dB. None of one frame.
        width_loss: Loss by things that enter and leave the scene's sensor; dB. None of one frame,
            and of a sensor whose width is not known.
    """

    kind: str
    frames: tuple[TimedFrame, ...]
    travel: float
    psnr: float
    worst_psnr: float
    pan: float = 0.0
    registration_loss: float | None = None
    width_loss: float | None = None

    def __repr__(self) -> str:
        return f"FrameSequence({self.text})"

    @property
    def text(self) -> str:
        """The frames in words, their level, and its losses on a real sensor."""
        losses = {
            "registration": self.registration_loss,
            "the width of the sensor": self.width_loss,
        }
        said = [f"{loss:.2g} by {cause}" for cause, loss in losses.items() if loss is not None]
        less = f", less {' and '.join(said)}" if said else ""
        return f"{self.kind}, {self.setting}: {self.psnr:.2f} dB{less}"

    @property
    def num_frames(self) -> int:
        """Number of frames."""
        return len(self.frames)

    @property
    def duration(self) -> float:
        """Time from the first light to the last; s."""
        first, last = self.frames[0], self.frames[-1]
        return last.time - first.time + (first.exposure + last.exposure) / 2

    @property
    def lights(self) -> tuple[float, ...]:
        """Light of each frame over that of the longest, as a sensor of one gain records them."""
        longest = max(frame.exposure for frame in self.frames)
        return tuple(frame.exposure / longest for frame in self.frames)

    def of_one_gain(self, frames: Iterable[np.ndarray]) -> list[np.ndarray]:
        """Frames as a sensor of one gain records them: white is that of the longest.

        Args:
            frames: Each in units of its own white.
        """
        return [share * frame for share, frame in zip(self.lights, frames, strict=True)]

    def of_own_whites(self, frames: Iterable[np.ndarray]) -> list[np.ndarray]:
        """The frames that a sensor of one gain has recorded, each in units of its own white.

        Args:
            frames: Each in units of the white of the longest.
        """
        return [frame / share for share, frame in zip(self.lights, frames, strict=True)]

    @property
    def moves(self) -> bool:
        """Whether the sensor moves during some frame."""
        return not all(frame.is_still for frame in self.frames)

    @property
    def num_rests(self) -> int:
        """Number of frames at rest before the first that moves.

        A later one does not count: the middle frame of a fan may be so slow that it seems at rest.
        """
        return len([*takewhile(lambda frame: frame.is_still, self.frames)])

    @property
    def setting(self) -> str:
        """Numbers of frames and their exposures; frames at rest before moving ones say so."""
        num_rests = self.num_rests if self.moves else 0
        kinds = Counter(
            (f"{frame.exposure * 1e3:.3g} ms", index < num_rests)
            for index, frame in enumerate(self.frames)
        )
        return " and ".join(
            f"{count} of {exposure}{' at rest' if is_still else ''}"
            for (exposure, is_still), count in kinds.items()
        )
