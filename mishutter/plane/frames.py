"""Frames of a sensor that moves in the plane, and the path of its stage through them."""

import math
from dataclasses import replace
from typing import final

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from mishutter._core.checks import as_numpy, namespace_of
from mishutter.evaluation.instants import panels_for
from mishutter.model.exposures import AT_REST, AbstractPath
from mishutter.model.limits import Limits
from mishutter.model.stages import Knots, StagePath, StageUse, led

_DIRECTIONS = np.arange(16) * np.pi / 16
"""Directions along which two axes keep a limit together."""


@final
class PlaneFrames(AbstractPath):
    """Frames of an open shutter, one after the other, and the path of the sensor through them.

    The path has pieces of constant acceleration from the first light of any row to the last. All
    numbers may be differentiated.

    Attributes:
        times: Mid-exposures, ascending; s, shape `(n,)`.
        exposures: Exposures, of which 0 is no frame; s, shape `(n,)`.
        durations: Durations of the pieces, of which some may be 0; s, shape `(p,)`.
        velocities: Velocities along rows and columns at their ends; px/s, shape `(2, p + 1)`.
        lead: Time by which the path begins before the first light, and ends after the last, for
            rows that are exposed earlier and later; s.
    """

    times: Float[Array | np.ndarray, "n"]
    exposures: Float[Array | np.ndarray, "n"]
    durations: Float[Array | np.ndarray, "p"]
    velocities: Float[Array | np.ndarray, "2 p+1"]
    lead: float = eqx.field(static=True, default=0.0)

    @property
    def num_frames(self) -> int:
        """Number of frames."""
        return self.times.shape[0]

    @property
    def duration(self) -> float:
        """Time from the first light to the last; s, of concrete frames."""
        ends = np.asarray(self.times) + np.asarray(self.exposures) / 2
        return float(ends[-1] - self._begin)

    @property
    def _begin(self) -> Array | np.ndarray | np.floating:
        return self.times[0] - self.exposures[0] / 2

    def for_rows(self, readout: float, limits: Limits) -> "PlaneFrames":
        """Known frames, with a path that goes on while rows are exposed earlier and later.

        It does not go on where the stage would leave its limits so: then the first and the last
        rows see how it comes from rest, and goes back to it.

        Args:
            readout: Time from the first row to the last; s.
            limits: Those of the stage.
        """
        if self.lead or self.stays or not readout:
            return self
        durations, velocities, _ = led(*self._known, readout / 2)
        going_on = replace(self, durations=durations, velocities=velocities, lead=readout / 2)
        use = going_on.use(limits)
        if limits.have_room_for(travel=float(use.travel), stroke=float(use.stroke)):
            return going_on
        knots = self.knots(limits)
        rest = max(readout / 2 - float(min(knots.durations[0], knots.durations[-1])), 0.0)
        ends = np.zeros((2, 1))
        return replace(
            self,
            durations=np.r_[rest, knots.durations, rest],
            velocities=np.hstack([ends, knots.velocities, ends]),
            lead=rest + float(knots.durations[0]),
        )

    def place(
        self, time: Float[Array | np.ndarray, "*shape"]
    ) -> Float[Array | np.ndarray, "2 *shape"]:
        """Place of the sensor, from that at the begin of the path; px.

        Args:
            time: Time on the clock of `times`; s.
        """
        d, v, time, begin = as_numpy(self.durations, self.velocities, time, self._begin - self.lead)
        space = namespace_of(d, v, time, begin)
        ends = space.concatenate([space.zeros_like(d[:1]), space.cumsum(d)])
        places = Knots(d[None], v, None, 0, d.size).positions
        since = space.asarray(time, d.dtype) - begin
        piece = space.searchsorted(ends, since.ravel(), side="right").reshape(since.shape) - 1
        piece = space.clip(piece, 0, d.size - 1)
        lasts = d[piece]
        # Pieces without a length meet no time but one at their end.
        elapsed = since - ends[piece]
        share = elapsed / space.where(lasts > 0, lasts, 1.0)
        start, end = v[:, piece], v[:, piece + 1]
        share, elapsed = share[None], elapsed[None]
        return places[:, piece] + elapsed * (start + share * (end - start) / 2)

    @property
    def _known(self) -> tuple[Float[np.ndarray, "p"], Float[np.ndarray, "2 p+1"]]:
        """Its pieces, of a concrete path."""
        return np.asarray(self.durations, np.float64), np.asarray(self.velocities, np.float64)

    def num_panels(self, fastest: float) -> int:
        """Number of panels of nodes for all things up to a speed; of concrete frames.

        Args:
            fastest: That speed; px/s.
        """
        return panels_for((self.top_speed + fastest) * float(np.max(np.asarray(self.exposures))))

    @property
    def top_speed(self) -> float:
        """Greatest speed of the sensor; px/s, of concrete frames."""
        return float(np.max(np.hypot(*np.asarray(self.velocities, np.float64))))

    @property
    def bends(self) -> Float[np.ndarray, "k"]:
        begin = float(self._begin) - self.lead
        return begin + np.append(0.0, np.cumsum(self._known[0]))

    @property
    def stays(self) -> bool:
        """Whether the sensor stands still in all frames; of concrete frames."""
        return self.top_speed * float(np.max(np.asarray(self.exposures))) < AT_REST

    def knots(self, limits: Limits) -> Knots:
        """The way from rest to rest, along rows and columns.

        The stage runs up straight to the velocity of the first light, at the greatest acceleration
        of the limits; at once where they have none.

        Args:
            limits: Those of the stage.
        """
        durations, velocities = self._known
        most = math.inf if limits.max_acceleration is None else float(limits.max_acceleration)
        times = [
            float(np.max(np.abs(v))) / most if limits.axes == "each" else math.hypot(*v) / most
            for v in (velocities[:, 0], velocities[:, -1])
        ]
        rest = np.zeros((2, 1))
        durations = np.r_[times[0], durations, times[1]]
        last = durations.size - 1
        return Knots(durations, np.hstack([rest, velocities, rest]), None, 1, last)

    def use(self, limits: Limits) -> StageUse:
        """The demands on each axis of a stage, or on both together where limits are of a disc.

        Args:
            limits: Those of the stage.
        """
        knots = self.knots(limits)
        angles = _DIRECTIONS if limits.axes == "disc" else np.array([0.0, np.pi / 2])
        if limits.axes == "one":
            x, y = knots.velocities[:, np.argmax(np.hypot(*knots.velocities))]
            angles = np.array([math.atan2(y, x)])
        units = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        if limits.axes == "disc":  # between two directions there may be that much more
            units = units / np.cos(_DIRECTIONS[1] / 2)
        use = knots._replace(velocities=units @ knots.velocities).use
        return StageUse(*(np.max(each) for each in use))

    def acceleration(self, limits: Limits) -> float:
        """Greatest acceleration of an axis or of both, infinite where a velocity jumps; px/s^2.

        Args:
            limits: Those of the stage.
        """
        gains = np.diff(np.asarray(self.velocities))
        size = np.max(np.abs(gains), axis=0) if limits.axes == "each" else np.hypot(*gains)
        d = np.asarray(self.durations)
        if np.any(size[d == 0] > 0):
            return math.inf
        return float(np.max(size[d > 0] / d[d > 0], initial=0.0))

    def stage_paths(self, limits: Limits) -> list[StagePath]:
        """The paths of the stage along rows and columns, each about the middle of its travel.

        Args:
            limits: Those of the stage.
        """
        most = limits.max_acceleration
        most = self.acceleration(limits) if most is None else float(most)
        if self.stays or not 0 < most < math.inf:
            return []
        knots, paths = self.knots(replace(limits, max_acceleration=most)), []
        for velocities, places in zip(knots.velocities, knots.positions, strict=True):
            begin = float(places[knots.first] - (np.min(places) + np.max(places)) / 2)
            own = knots._replace(velocities=velocities)
            paths.append(own.path(float(self._begin) - self.lead, begin))
        return paths
