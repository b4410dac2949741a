r"""The designs a solver may reach, as a unit box.

A point of the box is a shutter's coordinates, then those of a free path, then half exposure,
velocity and acceleration, each only if it is free. The half exposure and the acceleration are
logarithmic between bounds that hold stroke, top speed and exposure at every point: the half
exposure between its limits, and the acceleration between the slowest that keeps up with what the
given motion keeps up with, or with all objects at the best velocity, if that is less, and the
largest that $aT^2 \le$ stroke and $2aT \le$ top speed allow. The velocity lies between the slowest
and the fastest object, as far as that acceleration leaves it any of the top speed and, where the
stage pans, of the stroke (`mishutter.model.limits`). A stage that
begins and ends at rest travels further than the exposure (`mishutter.model.stages`), which bounds
all three where its travel, its acceleration or its jerk is limited. Where a pixel holds so many
electrons and no more, a half exposure ends where white fills it, sooner the more light the shutter
lets through. So a given motion within the limits is a point of the box.

A free path has equal pieces. Coordinates of it are the logarithms of the shares that they have in
the acceleration, which is their mean: so the speeds gained to both ends are $2aT$ on the mean, and
in the middle of the box the path is a parabola. Where the sensor sees as many objects to either
side, it is the same forwards and backwards. A path that bends more before mid-exposure than after
it takes the least stroke at a velocity of its own, at which it ends where it began: where the stage
pans, the acceleration is bounded at that velocity, and others are counted from it.

Coordinates are those of the profile that is sent to the scene's device. The shutter of a design
is the transmittance that light sees.
"""

import math
from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from typing import NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from mishutter._core import Unquoted, common_dtype, compiled, device_constant, require
from mishutter.model import (
    AbstractDevice,
    AbstractMotion,
    AbstractShutter,
    FreeMotion,
    Limits,
    LinearMotion,
    ParabolicMotion,
    PathShape,
    RectShutter,
    Scene,
    StillCamera,
    at_coordinates,
    coordinates,
    filling_half_exposure,
    is_adjustable,
    is_known_zero,
    is_straight,
    largest_of,
    num_coordinates,
    settled,
    steady,
)

FREE_NAMES = ("shutter", "path", "half_exposure", "velocity", "acceleration")
_OF_MOTION = FREE_NAMES[2:]
_ROUNDING = 1e-6
_ROUNDS_TO_FILL = 8
"""Rounds that find the exposure which fills a pixel through a device whose light depends on it:
each leaves less than a quarter of the error."""
_NUM_TRIED, _HALVINGS = 256, 40
"""Half exposures between which a limit of the stage may begin to hold, and halvings of one step."""
_TIMES_AT_ONCE = 8
"""Of these, for one program to serve both the first of them and the halvings."""
_MOST_PIECES_DIFFER = 20.0
"""How many times more, or less, than the mean the acceleration of a piece of a free path may be."""
_MEETING = 0.5
"""Where along the half exposure a free path comes to its stroke and its top speed together: a
kink whose place in the box is the same for every path."""
_SAME = 1e-5
"""Difference of speeds, as a share of the fastest, and of weights, within which they mirror."""
_SLOWEST = 1e-2
"""Share of the largest acceleration that is explored where every object is at rest."""


class Bends(NamedTuple):
    """Places along one coordinate of the box where a loss may have a kink.

    Attributes:
        coordinate: Which coordinate.
        places: Its values there, inside the box; shape `(n,)`.
    """

    coordinate: int
    places: np.ndarray


@final
class DesignSpace(eqx.Module):
    """A unit box of designs around a shutter and a motion.

    Attributes:
        shutter: Profile that is held, or whose kind is moved, as it is sent to the device.
        motion: Motion that is held where it is not free.
        limits: Bounds on stroke, top speed, exposure and pan.
        device: What it is sent to; None for one that loses no light.
        filling: Half exposure over which white fills a pixel, s: through a shutter that is held,
            or through an open one where it moves. None where pixels hold any light.
        slowest: Least velocity worth panning at; px/s.
        fastest: Greatest velocity worth panning at; px/s.
        demand: Speed that a sensor gains as it keeps up with every object; px/s.
        strongest: Largest acceleration that is explored, beside what the limits allow; px/s^2.
        free: Parts that may move.
        num_profile_coordinates: How many of the coordinates belong to the shutter.
        num_path_coordinates: How many of them after these belong to a free path.
        path_mirrors: Whether these are of one half of the path, and of the other mirrored.
    """

    shutter: AbstractShutter
    motion: AbstractMotion
    limits: Limits
    device: AbstractDevice | None
    filling: Array | None
    slowest: Array
    fastest: Array
    demand: Array
    strongest: Array
    free: tuple[str, ...] = eqx.field(static=True)
    num_profile_coordinates: int = eqx.field(static=True)
    num_path_coordinates: int = eqx.field(static=True)
    path_mirrors: bool = eqx.field(static=True)

    @property
    def size(self) -> int:
        """Number of coordinates."""
        return self.num_shape_coordinates + len(self.free_of_motion)

    @property
    def num_shape_coordinates(self) -> int:
        """How many of the coordinates are of a profile or a path, before the motion's numbers."""
        return self.num_profile_coordinates + self.num_path_coordinates

    def at(self, box: Array) -> tuple[AbstractShutter, AbstractMotion]:
        """The design at a point of the box; shape `(size,)`."""
        count = self.num_profile_coordinates
        shutter = self._profile_at(box)
        share = dict(zip(self.free_of_motion, box[self.num_shape_coordinates :], strict=True))
        if not share:
            return self.light(shutter, self.motion.half_exposure), self.motion
        half_exposure, velocity = self.motion.half_exposure, self.motion.velocity
        shape = self._shape(box[count : self.num_shape_coordinates])
        acceleration = _mean_acceleration(self.motion)
        if "half_exposure" in share:
            bounds = self._half_exposure_bounds(shutter)
            half_exposure = self._half_exposure_at(bounds, shape, share["half_exposure"])
        if "acceleration" in share:
            bounds = self._acceleration_bounds(half_exposure, shape)
            acceleration = _between(*bounds, share["acceleration"])
        if "velocity" in share:
            low, high = self._velocity_bounds(acceleration, half_exposure, shape)
            velocity = low + share["velocity"] * (high - low)
        shutter = self.light(shutter, half_exposure)
        if isinstance(self.motion, StillCamera):
            return shutter, StillCamera(half_exposure=half_exposure)
        if isinstance(self.motion, LinearMotion):
            return shutter, LinearMotion(half_exposure=half_exposure, velocity=velocity)
        numbers = {"half_exposure": half_exposure, "velocity": velocity}
        if shape is not None:
            return shutter, FreeMotion(accelerations=acceleration * shape.pieces, **numbers)
        return shutter, ParabolicMotion(acceleration=acceleration, **numbers)

    def shutter_at(self, box: Array, half_exposure: Array) -> AbstractShutter:
        """The transmittance of the design at a point of the box, whose half exposure is known."""
        return self.light(self._profile_at(box), half_exposure)

    def _profile_at(self, box: Array) -> AbstractShutter:
        """The profile that is sent to the device at a point of the box."""
        count = self.num_profile_coordinates
        return at_coordinates(self.shutter, box[:count]) if count else self.shutter

    def _shape(self, box: Array) -> PathShape | None:
        """The shape of a free path at its coordinates."""
        if not self.num_path_coordinates:
            return None
        shares = jnp.exp((2 * box - 1) * math.log(_MOST_PIECES_DIFFER))
        pieces = shares / jnp.mean(shares)
        if self.path_mirrors:
            pieces = jnp.concatenate([pieces[::-1], pieces])
        pans = "velocity" in self.free and self.limits.pans == "stage"
        return PathShape(pieces, _level_velocity(pieces) if pans else jnp.zeros_like(pieces[0]))

    @property
    def of_motion(self) -> "DesignSpace":
        """The space of the motion alone, whose programs serve shutters of every kind.

        It is this space itself where none of it moves, and where pixels fill and the exposures that
        there are depend on the profile.
        """
        fills = self.filling is not None and (self.num_profile_coordinates > 0 or self.lags)
        if fills or not self.free_of_motion:
            return self
        free = tuple(name for name in self.free if name != "shutter")
        of_shutter = {"shutter": RectShutter(), "device": None, "num_profile_coordinates": 0}
        return replace(self, free=free, **of_shutter)

    @property
    def free_of_motion(self) -> tuple[str, ...]:
        """Numbers of the motion that may move, in the order of their coordinates."""
        return tuple(name for name in _OF_MOTION if name in self.free)

    @property
    def dtype(self) -> np.dtype:
        """Precision of the box."""
        return np.dtype(self.demand.dtype)

    def without_acceleration(self) -> "DesignSpace":
        """The same box, at every point of which the sensor does not accelerate."""
        return eqx.tree_at(lambda s: s.strongest, self, device_constant(np.zeros((), self.dtype)))

    def holding(self, motions: Iterable[AbstractMotion]) -> "DesignSpace":
        """The space that reaches down to motions which keep up with fewer objects than it asks."""
        gains = [
            2 * float(_mean_acceleration(motion)) * float(motion.half_exposure)
            for motion in motions
            if not is_straight(motion)
        ]
        least = np.asarray(min([float(self.demand), *gains]), self.dtype)
        return replace(self, demand=device_constant(least))

    @property
    def lags(self) -> bool:
        """Whether the light of a profile depends on the exposure that it is sent over."""
        return self.device is not None and self.device.lags

    @property
    def bends(self) -> Bends:
        """Where along the half exposure the bounds of a free acceleration change their course.

        Stroke, top speed, the demand of the objects and the given motion, and the least
        acceleration that is explored give way to one another where two of them meet. Of a free
        path only the place where stroke and top speed do is known.
        """
        index = self.num_shape_coordinates
        moves = {"acceleration", "half_exposure"} <= set(self.free)
        if not moves or is_known_zero(self.strongest):
            return Bends(index, np.zeros(0))
        if self.num_path_coordinates:
            return Bends(index, np.array([_MEETING]))
        if self.filling is not None and (self.num_profile_coordinates or self.lags):
            return Bends(index, np.zeros(0))  # the exposures there are others for each profile
        low, high = (float(bound) for bound in self._half_exposure_bounds(self.shutter))
        kept_up = float(self.demand), float(self.motion.speed_gain)
        speeds = [float(self.limits.max_top_speed), *kept_up, *(v / _SLOWEST for v in kept_up)]
        times = np.array([2 * float(self.limits.max_stroke) / v for v in speeds if v > 0])
        if self.limits.has_stage or self.limits.frame_velocity is not None:
            times = np.concatenate([times, self._bends_of_stage(low, high)])
        inside = np.sort(times[(low < times) & (times < high)])
        return Bends(index, np.log(inside / low) / np.log(high / low) if inside.size else inside)

    def _bends_of_stage(self, low: float, high: float) -> np.ndarray:
        """Half exposures at which another limit on the acceleration begins to hold; s."""

        def courses_at(some: np.ndarray) -> np.ndarray:
            padded = np.resize(some, -(-some.size // _TIMES_AT_ONCE) * _TIMES_AT_ONCE)
            rows = padded.astype(self.dtype).reshape(-1, _TIMES_AT_ONCE)
            each = [np.asarray(_courses(self.of_motion, row)) for row in rows]
            return np.concatenate(each)[: some.size]

        times = np.geomspace(low, high, _NUM_TRIED)
        courses = courses_at(times)
        at = np.flatnonzero(np.diff(courses))
        before, after = times[at], times[at + 1]
        for _ in range(_HALVINGS if at.size else 0):
            middle = np.sqrt(before * after)
            same = courses_at(middle) == courses[at]
            before, after = np.where(same, middle, before), np.where(same, after, middle)
        return after

    def course_at(self, half_exposure: Array) -> Array:
        """A number that tells which limits the acceleration ends at over an exposure; scalar."""
        limits, half = self.limits, half_exposure
        least, most = self._acceleration_bounds(half)
        rest = jnp.zeros_like(half)
        shares = [
            most / limits.acceleration_by_stroke(half),
            2 * most * half / limits.max_top_speed,
            limits.stage_share(most, half, rest),
            rest if limits.max_acceleration is None else 2 * most / limits.max_acceleration,
        ]
        floors = jnp.stack([self.demand.astype(most.dtype), _SLOWEST * 2 * most * half])
        own = least * 2 * half / jnp.maximum(self.motion.speed_gain, 1e-30)
        course = jnp.argmax(jnp.stack(shares)) * 8
        course += jnp.argmax(floors) * 4 + jnp.where(own < 1 - 1e-9, 2, 0)
        return course + jnp.where(least >= most, 1, 0)

    def box(self, shutter: AbstractShutter, motion: AbstractMotion) -> Array:
        """The point of the box nearest to a design; shape `(size,)`."""
        dtype = common_dtype(self.demand, motion.half_exposure)
        parts = []
        if "shutter" in self.free:
            parts.append(jnp.clip(coordinates(shutter), 0, 1).astype(dtype))
        shape = None
        if "path" in self.free:
            parts.append(self._coordinates_of_path(motion).astype(dtype))
            shape = self._shape(parts[-1])
        half_exposure = motion.half_exposure
        if "half_exposure" in self.free:
            bounds = self._half_exposure_bounds(shutter)
            share = self._half_exposure_share(bounds, shape, half_exposure)
            parts.append(share.astype(dtype)[None])
            half_exposure = self._half_exposure_at(bounds, shape, share)
        if not self.free_of_motion:
            return jnp.concatenate(parts)
        acceleration, share = _mean_acceleration(motion), None
        if "acceleration" in self.free:
            bounds = self._acceleration_bounds(half_exposure, shape)
            share = _share(*bounds, acceleration)
            acceleration = _between(*bounds, share)
        if "velocity" in self.free:
            low, high = self._velocity_bounds(acceleration, half_exposure, shape)
            width = jnp.where(high > low, high - low, 1.0)
            place = jnp.where(high > low, (motion.velocity - low) / width, 0.5)
            parts.append(jnp.clip(place, 0, 1).astype(dtype)[None])
        if share is not None:
            parts.append(share.astype(dtype)[None])
        return jnp.concatenate(parts)

    def _half_exposure_at(
        self, bounds: tuple[Array, Array], shape: PathShape | None, share: Array
    ) -> Array:
        if shape is None:
            return _between(*bounds, share)
        (low, high), middle = bounds, self._meeting(bounds, shape)
        before = share < _MEETING
        begin, end = jnp.where(before, low, middle), jnp.where(before, middle, high)
        inside = jnp.where(before, share / _MEETING, (share - _MEETING) / (1 - _MEETING))
        return _between(begin, end, inside)

    def _half_exposure_share(
        self, bounds: tuple[Array, Array], shape: PathShape | None, half_exposure: Array
    ) -> Array:
        if shape is None:
            return _share(*bounds, half_exposure)
        (low, high), middle = bounds, self._meeting(bounds, shape)
        before = _MEETING * _share(low, middle, half_exposure)
        after = _MEETING + (1 - _MEETING) * _share(middle, high, half_exposure)
        return jnp.where(half_exposure < middle, before, after)

    def _meeting(self, bounds: tuple[Array, Array], shape: PathShape) -> Array:
        """Half exposure at which a path comes to its stroke and its top speed together; s."""
        path = _unit_path(shape.pieces, shape.velocity)
        times = self.limits.max_stroke / path.extent * path.top_speed
        return jnp.clip(times / self.limits.max_top_speed, *bounds)

    def _coordinates_of_path(self, motion: AbstractMotion) -> Array:
        """Coordinates of a path: the middle of the box for a parabola."""
        count = self.num_path_coordinates
        if not isinstance(motion, FreeMotion):
            return jnp.full(count, 0.5)
        shares = jnp.maximum(motion.accelerations, 0)
        shares = shares / jnp.where(jnp.any(shares > 0), jnp.mean(shares), 1.0)
        if self.path_mirrors:
            before, after = jnp.split(shares, 2)
            shares = (before[::-1] + after) / 2
        least = jnp.asarray(1 / _MOST_PIECES_DIFFER, shares.dtype)
        logarithm = jnp.log(jnp.maximum(shares, least)) / math.log(_MOST_PIECES_DIFFER)
        return jnp.clip((1 + logarithm) / 2, 0, 1)

    def _velocity_bounds(
        self, acceleration: Array, half: Array, shape: PathShape | None
    ) -> tuple[Array, Array]:
        if shape is None:
            most = self._largest_pan(acceleration, half)
            bounds = -most, most
        else:  # to the left is to the right on the path that is run backwards
            backwards = PathShape(shape.pieces[::-1], -shape.velocity)
            ways = (self._largest_pan(acceleration, half, each) for each in (backwards, shape))
            to_the_left, to_the_right = ways
            bounds = -to_the_left, to_the_right
        return jnp.clip(self.slowest, *bounds), jnp.clip(self.fastest, *bounds)

    def _largest_pan(
        self, acceleration: Array, half: Array, shape: PathShape | None = None
    ) -> Array:
        """Greatest velocity to the right at mid-exposure that the limits leave a motion; px/s."""
        rest = jnp.zeros_like(half)
        numbers = {"acceleration": acceleration, "half_exposure": half, "velocity": rest}
        most = self.limits.max_pan
        if shape is not None:
            own = shape.own_velocity(acceleration, half, most)
            return own + self.limits.largest("velocity", rest, most - own, numbers, shape)
        most = jnp.clip(self.limits.max_top_speed - 2 * acceleration * half, 0, most)
        by_stroke = self.limits.velocity_by_stroke(acceleration, half)
        most = most if by_stroke is None else jnp.minimum(most, by_stroke)
        if self.limits.has_stage:
            most = self.limits.largest("velocity", rest, most, numbers)
        return most

    def light(self, shutter: AbstractShutter, half_exposure: Array) -> AbstractShutter:
        """The transmittance that light sees where a profile is sent to the device.

        Args:
            shutter: The profile.
            half_exposure: Half of the exposure that it is sent over; s.
        """
        if self.device is None:
            return shutter
        return self.device.light(shutter, half_exposure, self.dtype)

    def _half_exposure_bounds(self, shutter: AbstractShutter) -> tuple[Array, Array]:
        low, high = self.limits.min_half_exposure, self.limits.max_half_exposure
        if self.filling is not None:
            filling = longest = self.filling
            for _ in range(_ROUNDS_TO_FILL if self.lags else 1):
                if self.num_profile_coordinates or self.lags:
                    efficiency = self.light(shutter, longest).efficiency().astype(filling.dtype)
                    longest = filling / jnp.maximum(efficiency, filling / high)
            high = jnp.clip(longest, low, high)
        moves = "acceleration" in self.free
        a = jnp.zeros((), self.dtype) if moves else _mean_acceleration(self.motion)
        if not isinstance(self.motion, FreeMotion) or moves:
            longest = self.limits.half_exposure_by_stroke(a)
            safe = jnp.where(a > 0, a, 1.0)
            by_speed = jnp.where(a > 0, self.limits.max_top_speed / (2 * safe), jnp.inf)
            high = jnp.clip(jnp.minimum(longest, by_speed), low, high)
        if self.limits.has_stage:
            rest = jnp.zeros_like(a)
            numbers = {"acceleration": a, "half_exposure": low, "velocity": rest}
            high = self.limits.largest("half_exposure", low, high, numbers)
        return low, high

    def _acceleration_bounds(
        self, half_exposure: Array, shape: PathShape | None = None
    ) -> tuple[Array, Array]:
        by_speed = self.limits.max_top_speed / (2 * half_exposure)
        high, steepest = jnp.minimum(by_speed, self.strongest), 1.0
        if shape is None:
            high = jnp.minimum(high, self.limits.acceleration_by_stroke(half_exposure))
        else:
            steepest = largest_of(shape.pieces)
        if self.limits.max_acceleration is not None:
            high = jnp.minimum(high, self.limits.max_acceleration / (2 * steepest))
        if self.limits.has_stage or shape is not None:
            rest = jnp.zeros_like(high)
            numbers = {"acceleration": rest, "half_exposure": half_exposure, "velocity": rest}
            high = self.limits.largest("acceleration", rest, high, numbers, shape)
        keeping_up = jnp.clip(self.demand / (2 * half_exposure), _SLOWEST * high, high)
        kept_up = jnp.abs(_mean_acceleration(self.motion)) * self.motion.half_exposure
        return jnp.minimum(keeping_up, kept_up / half_exposure), high


@compiled
def _courses(space: DesignSpace, half_exposures: Array | np.ndarray) -> Array:
    return jax.vmap(space.course_at)(jnp.asarray(half_exposures))


def _mean_acceleration(motion: AbstractMotion) -> Array:
    """$a$, or by how much on the mean a free path accelerates; px/s^2."""
    if isinstance(motion, FreeMotion):
        return jnp.mean(motion.accelerations)
    return steady(motion).acceleration


def _unit_path(pieces: Array, velocity: Array) -> FreeMotion:
    """The path of such pieces whose mean acceleration and half exposure are 1."""
    return FreeMotion(
        accelerations=pieces, half_exposure=jnp.ones((), pieces.dtype), velocity=velocity
    )


def _level_velocity(pieces: Array) -> Array:
    """Velocity at mid-exposure at which a path ends where it began, in units of $aT$; scalar."""
    path = _unit_path(pieces, jnp.zeros((), pieces.dtype))
    begin, end = jnp.asarray(path.position_at(np.array([-1, 1], pieces.dtype)))
    return (begin - end) / 2


def design_space(
    scene: Scene, motion: AbstractMotion, shutter: AbstractShutter, free: str | Iterable[str]
) -> DesignSpace:
    """The space of what `free` names, within the scene's limits.

    A velocity that is held is that of the frame: the scene is as it is `seen_from` the motion.
    A path that is free has an acceleration that is, and begins as that of the motion.

    Raises:
        ValueError: if `free` is empty or names something that cannot move.
    """
    names = (free,) if isinstance(free, str) else tuple(free)
    motion = settled(motion)
    subject = "optimise(free=...)"
    known = bool(names) and all(name in FREE_NAMES for name in names)
    require(known, subject, f"name some of {', '.join(FREE_NAMES)}", free)
    if "shutter" in names:
        require_adjustable(shutter)
    frees_path = "path" in names
    is_free = isinstance(motion, FreeMotion)
    held = (set() if frees_path and is_free else _held_by_kind(motion)) & set(names)
    at_rest = isinstance(motion, StillCamera)
    requirement = "leave a still camera at rest" if at_rest else "leave a pan its constant velocity"
    if isinstance(motion, FreeMotion):
        requirement = "name path, or leave a free path as it is"
    require(not held, subject, requirement, free)
    path_mirrors = frees_path and "velocity" not in names and mirrors(scene, 0.0)
    num_path = 0
    if frees_path:
        names = (*names, "acceleration")
        motion = motion if is_free else FreeMotion.fit(motion)
        num_path = num_free_pieces(scene, motion) // (2 if path_mirrors else 1)
    dtype = common_dtype(motion.half_exposure, scene.speeds)
    limits = jax.tree.map(lambda x: x.astype(dtype), scene.limits)
    ordered = tuple(name for name in FREE_NAMES if name in names)
    count = num_coordinates(shutter) if "shutter" in ordered else 0
    slowest, fastest = (x.astype(dtype) for x in scene.speed_range)
    demand = (fastest - slowest) / 2 if "velocity" in ordered else scene.max_speed.astype(dtype)
    velocity = motion.velocity.astype(dtype)
    bounds = (
        device_constant(np.minimum(slowest, velocity)),
        device_constant(np.maximum(fastest, velocity)),
    )
    device = jax.tree.map(lambda x: x.astype(dtype), scene.device)
    lags = scene.device is not None and scene.device.lags
    filling = _filling(scene, None if count or lags else shutter)
    filling = None if filling is None else jnp.asarray(filling, dtype)
    counts = count, num_path, path_mirrors
    strongest = device_constant(np.full((), np.inf, dtype))
    return DesignSpace(
        shutter, motion, limits, device, filling, *bounds, demand, strongest, ordered, *counts
    )


def num_free_pieces(scene: Scene, motion: AbstractMotion) -> int:
    """Pieces of a path that may move.

    Raises:
        ValueError: if it has no even number of equal ones, or the scene has no free path.
    """
    subject, named = "optimise(free=...)", Unquoted("path")
    requirement = "be a path of an even number of equal pieces, as FreeMotion.fit makes it, to move"
    count = 0
    if isinstance(motion, FreeMotion) and len(set(motion.durations or ())) <= 1:
        count = motion.accelerations.size
    is_even = count > 0 and count % 2 == 0
    require(is_even, "optimise(motion=...)", requirement, type(motion).__name__)
    forbidden = forbids_free_path(scene)
    require(forbidden is None, subject, f"leave the path where {forbidden}", named)
    return count


def forbids_free_path(scene: Scene) -> str | None:
    """Why no path may be free in a scene, in words; None where one may."""
    if scene.limits.max_jerk is not None:
        return "the jerk of the stage is limited: between pieces it jumps"
    if scene.tolerances is not None:
        return "the scene has tolerances, which are of a parabola"
    return None


def mirrors(scene: Scene, velocity: float) -> bool:
    """Whether speeds and weights are the same in both directions from a velocity.

    So is a background that stands still.
    """
    layers = scene.occlusion
    if layers is not None and layers.background == "still":
        if float(layers.background_speed) != velocity:
            return False
    speeds, weights = np.asarray(scene.speeds, np.float64) - velocity, np.asarray(scene.weights)
    forward = np.lexsort((weights, speeds))
    backward = np.lexsort((weights, -speeds))
    equal = partial(np.allclose, atol=_SAME * float(np.max(np.abs(speeds))))
    return equal(speeds[forward], -speeds[backward]) and np.allclose(
        weights[forward], weights[backward]
    )


def _filling(scene: Scene, shutter: AbstractShutter | None) -> float | None:
    """Half exposure over which white fills a pixel through a shutter, or an open one; s.

    None where the longest exposure does not fill it.

    Raises:
        ValueError: if an open shutter fills it within the shortest exposure.
    """
    if scene.full_well is None:
        return None
    rate, full_well = float(scene.photon_rate), float(scene.full_well)
    shortest = 2 * rate * float(scene.limits.min_half_exposure)
    requirement = (
        f"hold what an open shutter lets through in the shortest exposure, {shortest:g} e-"
    )
    require(shortest <= full_well, "Scene(full_well=...)", requirement, full_well)
    light = 1.0
    if shutter is not None:
        light = float(scene.light(shutter, scene.limits.max_half_exposure).efficiency())
    longest = 2 * rate * light * float(scene.limits.max_half_exposure)
    return float(filling_half_exposure(full_well, rate, light)) if longest > full_well else None


def _held_by_kind(motion: AbstractMotion) -> set[str]:
    """Parts of a motion that its kind holds at 0."""
    motion = settled(motion)
    if isinstance(motion, StillCamera):
        return {"path", "acceleration", "velocity"}
    if isinstance(motion, FreeMotion):
        return {"half_exposure", "acceleration", "velocity"}
    return {"path", "acceleration"} if is_straight(motion) else set()


def all_that_can_move(
    scene: Scene, motion: AbstractMotion, shutter: AbstractShutter | None
) -> tuple[str, ...]:
    """Parts that a search moves by default: a camera at rest stays, so does a fixed window.

    A path becomes a free one only where that is asked for.

    No shutter stands for a free-form profile.
    """
    held = _held_by_kind(motion)
    if is_known_zero(scene.limits.max_pan):
        held.add("velocity")
    if shutter is not None and not is_adjustable(shutter):
        held.add("shutter")
    return tuple(name for name in FREE_NAMES if name not in held | {"path"})


def beyond_limits(
    scene: Scene, motion: AbstractMotion, shutter: AbstractShutter
) -> tuple[str, ...]:
    """Names of the limits that a design exceeds by more than rounding; none of one within them.

    The names are those of `Limits.demands`, and `"full_well"` where white fills a pixel.
    """
    demands = scene.limits.demands(motion).items()
    names = tuple(name for name, demand in demands if not demand.is_met(_ROUNDING))
    return (*names, "full_well") if fills(scene, motion, shutter) else names


def fills(scene: Scene, motion: AbstractMotion, shutter: AbstractShutter) -> bool:
    r"""Whether white, $2RT\eta$ electrons, is more than a pixel holds, to rounding."""
    if scene.full_well is None:
        return False
    light = float(scene.light(shutter, motion).efficiency()) * float(motion.exposure)
    return float(scene.photon_rate) * light > float(scene.full_well) * (1 + _ROUNDING)


def require_adjustable(shutter: AbstractShutter) -> None:
    """Refuse a shutter with nothing to move."""
    require(
        is_adjustable(shutter),
        "optimise(shutter=...)",
        "have parameters with bounds, as a SplineShutter or TukeyShutter has, for free to name it",
        type(shutter).__name__,
    )


def _between(low: Array, high: Array, share: Array) -> Array:
    """Point of a logarithmic interval, inside it also after rounding; 0 where it ends at 0."""
    ratio = jnp.where(low > 0, high, 1.0) / jnp.where(low > 0, low, 1.0)
    return _rounded_into(low * jnp.exp(share * jnp.log(ratio)), low, high)


@jax.custom_jvp
def _rounded_into(value: Array, low: Array, high: Array) -> Array:
    """Undo a last-digit excursion from an interval and leave the derivative alone.

    A clip has half of it at an end, or none: a search would see no slope that leads inside.
    """
    return jnp.clip(value, low, high)


@_rounded_into.defjvp
def _rounded_into_jvp(primals, tangents):
    return _rounded_into(*primals), tangents[0]


def _share(low: Array, high: Array, value: Array) -> Array:
    wide = high > low
    least = jnp.where(wide & (low > 0), low, 1.0)
    span = jnp.log(jnp.where(wide, high, 2.0) / least)
    positive = jnp.maximum(value, np.finfo(np.dtype(low.dtype)).tiny)
    return jnp.clip(jnp.where(wide, jnp.log(positive / least) / span, 0.5), 0, 1)
