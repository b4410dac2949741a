"""Exposures of one picture, one or more in their order: what all of them have in common."""

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable
from itertools import pairwise, takewhile
from typing import Any, ClassVar

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from mishutter._core.modules import AbstractModule
from mishutter.model.limits import Limits
from mishutter.model.scene import Scene
from mishutter.model.stages import StagePath

AT_REST = 0.05
"""Travel over an exposure below which its sensor counts as standing still; px."""
_MOST_NAMED = 3
"""Different exposures that are named one by one."""
_MOST_LISTED = 6
"""Most frames whose exposures are said in their order, where long and short ones take turns."""
Lights = list[tuple[float, float]]
"""First and last light of exposures; s."""


class AbstractPath(AbstractModule):
    """Exposures of an open shutter along a path of the sensor, which is known between them too."""

    times: eqx.AbstractVar[Float[Array | np.ndarray, "n"]]  # Mid-exposures; s
    exposures: eqx.AbstractVar[Float[Array | np.ndarray, "n"]]  # s

    @property
    @abstractmethod
    def top_speed(self) -> float:
        """Greatest speed of the sensor; px/s, of a concrete path."""

    @abstractmethod
    def for_rows(self, readout: float, limits: Limits) -> "AbstractPath":
        """A known path that goes on while rows are exposed earlier and later, within limits.

        Args:
            readout: Time from the first row to the last; s.
            limits: Those of the stage.
        """

    @property
    @abstractmethod
    def bends(self) -> Float[np.ndarray, "k"]:
        """Times at which its velocity or its acceleration jumps; s, of a concrete path."""

    @abstractmethod
    def place(
        self, time: Float[Array | np.ndarray, "*shape"]
    ) -> Float[Array | np.ndarray, "axes *shape"]:
        """Place of the sensor at a time, s, from one place for all; px."""


class AbstractExposures(ABC):
    """One exposure or more of one picture, in order, and the way of the sensor through them.

    Tables, files and pictures ask for these names, and for the number of axes where that matters.
    """

    kind: str  # The way of the sensor over them, in words
    frames: Any  # The exposures along an axis or in the plane, as `simulate_frames` takes them
    axes: ClassVar[tuple[str, ...]] = ("",)  # Endings of a table's columns for each axis

    @property
    @abstractmethod
    def times(self) -> list[float]:
        """Mid-exposures, from the middle of all; s."""

    @property
    @abstractmethod
    def exposures(self) -> list[float]:
        """Time from the first to the last light of each; s."""

    @property
    @abstractmethod
    def rests(self) -> list[bool]:
        """Whether the sensor stands still in each."""

    @property
    @abstractmethod
    def stroke(self) -> float:
        """Travel of the stage, or of an axis of it, from the first light to the last; px."""

    @abstractmethod
    def place(self, times: Float[np.ndarray, "n q"]) -> Float[np.ndarray, "axes n q"]:
        """Places of the sensor at some times of each exposure, from one place for all; px."""

    @abstractmethod
    def stage_paths(self, scene: Scene) -> dict[str, StagePath]:
        """The path of the stage along each axis, from rest to rest, by the ending of its columns.

        The run-up takes the greatest acceleration of the scene's limits, or that of the rest of the
        path where they have none. There is no path where the stage stays at rest, or no limit says
        how it gets to a velocity.
        """

    @property
    def num_frames(self) -> int:
        """Number of exposures."""
        return len(self.times)

    @property
    def lights(self) -> Lights:
        """First and last light of each; s."""
        pairs = zip(self.times, self.exposures, strict=True)
        return [(time - exposure / 2, time + exposure / 2) for time, exposure in pairs]

    @property
    def duration(self) -> float:
        """Time from the first light to the last; s."""
        times, exposures = self.times, self.exposures
        return times[-1] - times[0] + (exposures[0] + exposures[-1]) / 2

    @property
    def moves(self) -> bool:
        """Whether the sensor moves during some exposure."""
        return not all(self.rests)

    @property
    def num_rests(self) -> int:
        """Number of frames at rest before the first that moves.

        A later one does not count: the middle frame of a fan may be so slow that it seems at rest.
        """
        return len([*takewhile(bool, self.rests)])

    @property
    def setting(self) -> str:
        """Numbers of frames and their exposures; frames at rest before moving ones say so."""
        num_rests = self.num_rests if self.moves else 0
        kinds = Counter(
            (f"{exposure * 1e3:.3g} ms", index < num_rests)
            for index, exposure in enumerate(self.exposures)
        )
        if len(kinds) > _MOST_NAMED:
            at_rest = [f"{num_rests} at rest"] if num_rests else []
            return ", ".join([f"{self.num_frames} of {self._range} ms", *at_rest])
        return " and ".join(
            f"{count} of {exposure}{' at rest' if is_still else ''}"
            for (exposure, is_still), count in kinds.items()
        )

    @property
    def lengths(self) -> str:
        """Exposures in words: each that occurs, with its number where stills differ in them."""
        kinds = Counter(f"{exposure * 1e3:.3g}" for exposure in self.exposures)
        if len(kinds) > _MOST_NAMED:
            return f"{self._range} ms"
        if self.moves or set(kinds.values()) == {1} or len(kinds) == 1:
            return f"{' and '.join(kinds)} ms"
        every = [f"{exposure * 1e3:.3g}" for exposure in self.exposures]
        num_runs = 1 + sum(one != other for one, other in pairwise(every))
        if num_runs > len(kinds) and len(every) <= _MOST_LISTED:  # in an order that counts
            return f"{', '.join(every[:-1])} and {every[-1]} ms"
        return f"{' and '.join(f'{count} of {exposure}' for exposure, count in kinds.items())} ms"

    @property
    def _range(self) -> str:
        """The least and the greatest exposure; ms."""
        return f"{min(self.exposures) * 1e3:.3g} to {max(self.exposures) * 1e3:.3g}"

    def of_one_gain(self, frames: Iterable[np.ndarray]) -> list[np.ndarray]:
        """Frames as a sensor of one gain has them: in units of the white of the longest."""
        longest = max(self.exposures)
        return [time / longest * each for time, each in zip(self.exposures, frames, strict=True)]

    def of_own_whites(self, frames: Iterable[np.ndarray]) -> list[np.ndarray]:
        """Frames that a sensor of one gain has recorded, each in units of its own white."""
        longest = max(self.exposures)
        return [each / (time / longest) for time, each in zip(self.exposures, frames, strict=True)]
