"""Cameras judged by a decoder of one's own, on photographs that each of them captures."""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import ArrayLike, Float

from mishutter._core.checks import require
from mishutter._core.progress import counts
from mishutter.camera.capture import as_radiance
from mishutter.camera.rows import Planes
from mishutter.decoding.decoders.base import AbstractDecoder
from mishutter.decoding.photographs import restore_by_each
from mishutter.design.design import motion_to_dict
from mishutter.model.motion import AbstractMotion
from mishutter.model.scene import Scene
from mishutter.pictures.images import Picture
from mishutter.report.restored import longest_kernel
from mishutter.search.rows import Row, cameras_of
from mishutter.search.space import beyond_limits

_LONGER, _SHORTER = (1.18,), (0.85, 0.72, 0.61, 0.52, 0.44)
"""Shares of an exposure that are tried in turn, as long as they gain something."""


class OnPictures(NamedTuple):
    """A camera on photographs, its exposure tuned for the decoder that restores them."""

    # PSNR of each photograph over the scene's speeds, linear light; dB
    levels: Float[np.ndarray, "pictures"]
    motion: AbstractMotion  # The motion with the tuned exposure
    exposure_share: float  # Its exposure over that which the loss prefers
    gain: float = 0.0  # Mean difference of the levels to those of the best snapshot; dB
    standard_error: float = 0.0  # Standard error of that mean over the photographs; dB

    def over(self, snapshot: "OnPictures") -> "OnPictures":
        """The same with the paired differences to a snapshot."""
        differences = self.levels - snapshot.levels
        error = float(np.std(differences, ddof=1) / np.sqrt(differences.size))
        return self._replace(gain=float(np.mean(differences)), standard_error=error)

    def to_dict(self) -> dict[str, object]:
        """The numbers, plain."""
        return {
            "gain_db": self.gain,
            "standard_error_db": self.standard_error,
            "psnr_db": self.levels.tolist(),
            "exposure_share": self.exposure_share,
            "motion": motion_to_dict(self.motion),
        }


class Judgement(NamedTuple):
    """Cameras by the names of their rows, as a decoder restores their photographs."""

    decoder: str  # Name of the decoder's class
    num_pictures: int  # Number of photographs
    cameras: Mapping[str, OnPictures]  # The cameras

    def to_dict(self) -> dict[str, object]:
        """The decoder, and the numbers of each camera."""
        cameras = {name: camera.to_dict() for name, camera in self.cameras.items()}
        return {"decoder": self.decoder, "num_pictures": self.num_pictures, "cameras": cameras}

    def sentence(self, name: str | None) -> str:
        """A line of the verdict."""
        best = max(self.cameras, key=lambda each: self.cameras[each].gain)
        camera = self.cameras[name or best]
        side = "above" if camera.gain >= 0 else "below"
        return (
            f"By {self.decoder} on {self.num_pictures} pictures "
            f"{name or f'the best camera, {best},'} is {abs(camera.gain):.2f} ± "
            f"{camera.standard_error:.2f} dB {side} the best snapshot."
        )


def pictures_to_judge(
    decoder: AbstractDecoder | None, pictures: Iterable[Picture | ArrayLike]
) -> list[Planes]:
    """The light of photographs for a decoder; refuses one without the other.

    What no photograph is, is told here, before minutes of search.
    """
    lights = [as_radiance(picture, "compare(pictures=...)") for picture in pictures]
    subject, requirement = "compare(decoder=...)", "stand beside compare(pictures=...)"
    require(decoder is not None or len(lights) == 0, subject, requirement, decoder)
    if decoder is not None:
        require(isinstance(decoder, AbstractDecoder), subject, "be a decoder", decoder)
        requirement = "be two or more beside a decoder, for a standard error"
        require(len(lights) > 1, "compare(pictures=...)", requirement, len(lights))
    return lights


def judged_by(
    decoder: AbstractDecoder,
    pictures: Sequence[Picture | ArrayLike],
    scene: Scene,
    rows: Sequence[Row],
    snapshot: Row,
    *,
    progress: bool = False,
) -> Judgement:
    """Captures and restores photographs by each camera, at the exposure that is best for a decoder.

    The exposure is a share of the row's own, at the same acceleration: the one of the highest mean
    level over the photographs, each at every speed of the scene. All cameras have the same noise
    and are judged on the same columns. The decoder knows as much of the speed as the one that
    judges the row.
    """
    longest = longest_kernel(scene, [_exposed(row.motion, max(_LONGER)) for row in rows])

    def tried(row: Row, share: float) -> OnPictures:
        motion = _exposed(row.motion, share)
        levels = [
            restore_by_each(
                picture,
                scene,
                motion,
                row.shutter,
                {"": decoder},
                num_seeds=1,
                least_taps=longest,
                decoder_speed=row.decoder.name,
            )[""].mean_psnr
            for picture in pictures
        ]
        return OnPictures(np.array(levels), motion, share)

    def tuned(row: Row) -> OnPictures:
        counter.began(row.name)
        best = tried(row, 1.0)
        for shares in (_SHORTER, _LONGER):
            for share in shares:
                if beyond_limits(scene, _exposed(row.motion, share), row.shutter):
                    break
                other = tried(row, share)
                if other.levels.mean() <= best.levels.mean():
                    break
                best = other
        counter.ended(row.name)
        return best

    cameras = cameras_of(rows)
    with counts(progress, "restoring", len(cameras)) as counter:
        by_camera = [(camera, tuned(camera[0])) for camera in cameras]
    by_name = {row.name: best for camera, best in by_camera for row in camera}
    judged = {row.name: by_name[row.name].over(by_name[snapshot.name]) for row in rows}
    return Judgement(type(decoder).__name__, len(pictures), judged)


def _exposed(motion: AbstractMotion, share: float) -> AbstractMotion:
    """The motion of a share of the exposure, at the same acceleration."""
    return eqx.tree_at(lambda m: m.half_exposure, motion, motion.half_exposure * share)
