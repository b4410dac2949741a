"""Places to film whose scenes are known: clips of them, and the scenes that those are of."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from mishutter import Occlusion, Picture, Scene, Texture, best_sequence
from support.clips import ClipOf, Thing


class Place(NamedTuple):
    """A scene to film: light, noise, and the objects before a photograph."""

    photograph: str
    photon_rate: float
    read_noise: float
    frames_per_s: float
    exposure: float
    things: tuple[Thing, ...]

    @property
    def clip(self) -> ClipOf:
        """Eight frames of it, whose pixels average light along rows."""
        return ClipOf(
            self.things,
            size=(256, 384),
            background=self.photograph,
            num_frames=8,
            frames_per_s=self.frames_per_s,
            exposure=self.exposure,
            electrons=self.photon_rate * self.exposure,
            read_noise=self.read_noise,
            black=1 / 8,
            has_pixels=True,
        )

    def scene_like(self, like: Scene) -> Scene:
        """The scene that the clip was simulated from, with sensor, limits and burst of another."""
        clip = self.clip
        time = float(clip.times[clip.num_frames // 2])
        labels, light = clip.labels(time) > 0, clip.light(time)
        begins = np.sum(labels[:, 1:] & ~labels[:, :-1]) + labels[:, 0].sum()
        speeds = [-thing.velocity[1] for thing in self.things]
        fast = max(map(abs, speeds))
        both = min(speeds) < 0 < max(speeds)
        return Scene(
            np.linspace(-fast, fast, 9) if both else speeds,
            photon_rate=self.photon_rate,
            read_noise=self.read_noise,
            picture=Texture.of_photograph(Picture(light[..., None])),
            sensor=like.sensor,
            limits=like.limits,
            burst=like.burst,
            occlusion=Occlusion(
                front_share=labels.mean(),
                object_width=labels.sum() / begins,
                level_difference=light[labels].mean() - light[~labels].mean(),
            ),
        )


PLACES = {
    "one object": Place(
        "brick.png", 1e5, 8.0, 60.0, 2e-3, (Thing((128, 200), (70, 90), (0, 900.0), "brick.png"),)
    ),
    "two objects, both ways": Place(
        "astronaut.png",
        3e5,
        6.0,
        60.0,
        2e-3,
        (
            Thing((75, 140), (55, 70), (0, 760.0), "astronaut.png"),
            Thing((185, 260), (50, 60), (0, -760.0), "astronaut.png"),
        ),
    ),
    "three objects, both ways": Place(
        "camera.png",
        2e5,
        3.0,
        50.0,
        4e-3,
        (
            Thing((55, 130), (42, 55), (0, 480.0), "camera.png"),
            Thing((135, 250), (36, 60), (0, -480.0), "camera.png"),
            Thing((210, 150), (38, 60), (0, 240.0), "camera.png"),
        ),
    ),
}


def best_frames(scene: Scene) -> tuple[str, float]:
    """The frames to take where objects are registered, and their level."""
    known = replace(scene, decoder_speed="known")
    sequence = best_sequence(known)
    if sequence is None:
        return "none", float("nan")
    losses = sequence.registration_loss or 0.0, sequence.width_loss or 0.0
    return f"{len(sequence.frames)}, {sequence.kind}", float(sequence.psnr - sum(losses))
