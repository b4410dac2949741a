"""Clips of a camera at rest, simulated from photographs, whose truth is known.

Objects are ellipses that are cut from one photograph and move before another. They are rendered
by cubic splines at several instants of each exposure, without the package's own camera.
"""

from dataclasses import dataclass, field

import numpy as np
from scipy import ndimage

from mishutter.pictures.images import shipped_picture

PHOTOGRAPHS = (
    "astronaut.png",
    "brick.png",
    "camera.png",
    "chelsea.png",
    "coffee.png",
    "coins.png",
    "grass.png",
    "gravel.png",
    "moon.png",
    "motorcycle_left.png",
)
OTHERS = (
    "cell.png",
    "clock_motion.png",
    "hubble_deep_field.jpg",
    "ihc.png",
    "microaneurysms.png",
    "page.png",
    "retina.jpg",
    "rocket.jpg",
)
"""Photographs by which no threshold was chosen."""


def photograph(name: str, rows: int, columns: int, seed: int = 0) -> np.ndarray:
    """Luminance of a piece of a photograph in linear light; small ones go on mirrored."""
    light = shipped_picture(name).luminance.astype(np.float64)
    pads = [
        (0, max(0, size - have)) for size, have in zip((rows, columns), light.shape, strict=True)
    ]
    light = np.pad(light, pads, mode="symmetric")
    rng = np.random.default_rng(seed)
    y, x = (
        int(rng.integers(0, n - m + 1)) for n, m in zip(light.shape, (rows, columns), strict=True)
    )
    return light[y : y + rows, x : x + columns]


@dataclass(frozen=True)
class Thing:
    """An ellipse that moves: centre at the middle of the clip and half axes, px; velocity, px/s.

    Rows come first, and count downwards.
    """

    centre: tuple[float, float]
    half_axes: tuple[float, float]
    velocity: tuple[float, float]
    photograph: str = "coffee.png"


@dataclass(frozen=True)
class ClipOf:
    """A camera at rest, and what it films.

    Attributes:
        things: Objects, from back to front.
        size: Rows and columns.
        background: Name of a photograph.
        num_frames: Number of frames.
        frames_per_s: Frames a second.
        exposure: Exposure of a frame; s.
        electrons: Photo-electrons of a white pixel in an exposure.
        read_noise: Standard deviation of the read noise; e-.
        bits: Bits of a level.
        black: Level of black, as a share of the full range.
        flicker: Standard deviation of the frames' exposures, as a share.
        seed: Of the noise, and of the pieces of photographs.
        has_pixels: Whether photographs are light that pixels average along rows.
    """

    things: tuple[Thing, ...] = ()
    size: tuple[int, int] = (256, 256)
    background: str = "astronaut.png"
    num_frames: int = 8
    frames_per_s: float = 50.0
    exposure: float = 4e-3
    electrons: float = 3000.0
    read_noise: float = 4.0
    bits: int = 12
    black: float = 1 / 64
    flicker: float = 0.0
    seed: int = 0
    has_pixels: bool = False
    num_instants: int = field(default=5)

    @property
    def full(self) -> int:
        """Level of white."""
        return 2**self.bits - 1

    @property
    def black_level(self) -> int:
        """Level of black."""
        return round(self.black * self.full)

    @property
    def per_electron(self) -> float:
        """Levels of an electron."""
        return (self.full - self.black_level) / self.electrons

    @property
    def times(self) -> np.ndarray:
        """Times of the frames from the middle of the clip; s."""
        return (np.arange(self.num_frames) - (self.num_frames - 1) / 2) / self.frames_per_s

    def mattes(self, time: float) -> list[np.ndarray]:
        """Opacity of each thing at a time."""
        rows, columns = np.indices(self.size)
        mattes = []
        for thing in self.things:
            y, x = (c + v * time for c, v in zip(thing.centre, thing.velocity, strict=True))
            a, b = thing.half_axes
            radius = np.hypot((rows - y) / a, (columns - x) / b)
            mattes.append(np.clip(0.5 - (radius - 1) * min(a, b), 0, 1))
        return mattes

    def labels(self, time: float) -> np.ndarray:
        """Number of the thing that is seen at a time, from 1 on; 0 is the background."""
        labels = np.zeros(self.size, int)
        for number, matte in enumerate(self.mattes(time), 1):
            labels[matte > 0.5] = number
        return labels

    def light(self, time: float) -> np.ndarray:
        """The picture at a time, white = 1."""
        light = self._background
        for index, (thing, matte) in enumerate(zip(self.things, self.mattes(time), strict=True)):
            shift = [v * time for v in thing.velocity]
            moved = ndimage.shift(
                self._textures[index], shift, order=3, mode="mirror", prefilter=False
            )
            light = light * (1 - matte) + matte * moved
        return np.clip(light, 0, 1)

    def __post_init__(self) -> None:
        background = photograph(self.background, *self.size, seed=self.seed)
        textures = [
            ndimage.spline_filter(
                photograph(t.photograph, *self.size, seed=self.seed + 1 + i), order=3, mode="mirror"
            )
            for i, t in enumerate(self.things)
        ]
        object.__setattr__(self, "_background", background)
        object.__setattr__(self, "_textures", textures)

    def exposed(self, time: float) -> np.ndarray:
        """Mean light of an exposure about a time."""
        steps = (np.arange(self.num_instants) + 0.5) / self.num_instants - 0.5
        steps = steps if self.things else [0.0]
        light = np.mean([self.light(time + s * self.exposure) for s in steps], axis=0)
        if not self.has_pixels:
            return light
        mirrored = np.concatenate([light, light[:, ::-1]], axis=1)
        aperture = np.sinc(np.fft.rfftfreq(mirrored.shape[1]))
        seen = np.fft.irfft(np.fft.rfft(mirrored) * aperture, mirrored.shape[1])
        return np.clip(seen[:, : light.shape[1]], 0, 1)

    def levels(self) -> np.ndarray:
        """The frames as the file holds them; shape `(frames, rows, columns)`, whole numbers."""
        rng = np.random.default_rng([self.seed, 7])
        gains = 1 + self.flicker * rng.standard_normal(self.num_frames)
        light = (g * self.exposed(t) for g, t in zip(gains, self.times, strict=True))
        return np.stack([self.recorded(each, rng) for each in light])

    def recorded(self, light: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Levels of light, with noise."""
        electrons = rng.poisson(light * self.electrons) + rng.normal(
            0, self.read_noise, light.shape
        )
        levels = np.rint(self.black_level + electrons * self.per_electron)
        return np.clip(levels, 0, self.full).astype(np.uint8 if self.bits <= 8 else np.uint16)

    def dark(self, count: int = 2) -> np.ndarray:
        """Frames of a covered lens."""
        rng = np.random.default_rng([self.seed, 11])
        return np.stack([self.recorded(np.zeros(self.size), rng) for _ in range(count)])

    def flats(self, shares: tuple[float, ...] = (0.1, 0.2, 0.4, 0.6)) -> np.ndarray:
        """Pairs of flat fields at several exposures, with a pattern of the pixels of 1 %."""
        rng = np.random.default_rng([self.seed, 13])
        pattern = 1 + 0.01 * rng.standard_normal(self.size)
        return np.stack([self.recorded(s * pattern, rng) for s in shares for _ in range(2)])
