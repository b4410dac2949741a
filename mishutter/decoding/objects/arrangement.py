r"""Things before a background, each with an outline, a velocity and a place in the order of depth.

A thing covers $c_k(p) = (b_k * m)(p - v t_k)$ of the pixel $p$ in frame $k$: its matte $m$ under
the box $b_k$ of its way within the exposure. What is before the background at the pixel shows as
much of itself as those in front leave.
"""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from mishutter.decoding.objects.grids import Mask, moved
from mishutter.decoding.objects.stills import Stills
from mishutter.pictures.registration.windows import Window

MARGIN = 24
"""Pixels about an outline in which its own is looked for."""


@dataclass
class Thing:
    """A thing that moves as a whole."""

    velocity: Float[np.ndarray, "2"]  # Down and across; px/s
    matte: Mask  # Opacity, where the thing is at the time 0; shape of a frame
    # Velocity at which it was first seen, and its uncertainty; px/s
    first: Float[np.ndarray, "2"]
    uncertainty: float
    # Of the velocity; px^2/s^2
    covariance: Float[np.ndarray, "2 2"] = field(default_factory=lambda: np.zeros((2, 2)))
    evidence: float = 0.0  # Logarithm of the likelihood over that of no such thing

    @property
    def window(self) -> Window:
        """The part of the picture in which its outline is looked for."""
        return Window.around(self.matte, MARGIN)

    @property
    def area(self) -> float:
        """Pixels."""
        return float(np.sum(self.matte))


@dataclass
class Arrangement:
    """Things before a background at rest, and what each covers in frames."""

    stills: Stills
    things: list[Thing]
    order: list[int]  # Numbers of the things, from the front to the back

    def __post_init__(self) -> None:
        self.place()

    def place(self) -> None:
        """Computes what each thing covers, and what is seen of it, from outlines and velocities."""
        self.cover = [self.covered(thing) for thing in self.things]
        clear = np.ones(self.stills.light.shape, np.float32)
        self.front = [clear] * len(self.things)  # Share of a pixel that is not hidden from a thing
        for number in self.order:
            self.front[number] = clear
            clear = clear * (1 - self.cover[number])
        self.ground = clear  # Share of a pixel at which the background is seen

    def seen_in(self, stills: Stills) -> "Arrangement":
        """The same things in other frames."""
        return Arrangement(stills, self.things, self.order)

    def seen(self, number: int) -> Float[np.ndarray, "frames rows columns"]:
        """Share of each pixel at which a thing is seen."""
        return self.front[number] * self.cover[number]

    def covered(
        self, thing: Thing, matte: Mask | None = None
    ) -> Float[np.ndarray, "frames rows columns"]:
        """Share of each pixel of the frames that a thing lies over, or a matte of its own."""
        stills, shape = self.stills, self.stills.shape
        window = thing.window
        part = window.of(thing.matte if matte is None else matte).astype(np.float32)
        covers = np.zeros(stills.light.shape, np.float32)
        for one in stills.parts:
            way, blur = one.way(thing.velocity), one.blur(thing.velocity)
            steps = max(1, int(np.ceil(np.hypot(*blur) / 1.5)))
            shares = (np.arange(steps) + 0.5) / steps - 0.5
            each = [moved(part, window, way + blur * share, shape) for share in shares.tolist()]
            covers[one.frame] += np.float32(one.share) * np.mean(each, axis=0)
        return covers

    def behind(self, number: int) -> list[int]:
        """Numbers of the things behind one, from the back to the front."""
        return self.order[self.order.index(number) + 1 :][::-1]

    def drop(self, number: int) -> None:
        """Leaves a thing out."""
        del self.things[number]
        self.order = [other - (other > number) for other in self.order if other != number]
        self.place()

    def alphas(self) -> Float[np.ndarray, "layers rows columns"]:
        """Share of each pixel that shows the background and each thing at the time 0."""
        clear = np.ones(self.stills.shape, np.float32)
        shown: list[Mask] = [clear] * len(self.things)
        for number in self.order:
            matte = self.things[number].matte
            shown[number], clear = clear * matte, clear * (1 - matte)
        return np.stack([clear, *shown])
