r"""The designs a solver may reach, as a unit box.

A point of the box is a shutter's coordinates, then half exposure, velocity and acceleration, each
only if it is free. The half exposure and the acceleration are logarithmic between bounds that hold
stroke, top speed and exposure at every point: the half exposure between its limits, and the
acceleration between the slowest that keeps up with what the given motion keeps up with, or with all
objects at the best velocity, if that is less, and the largest that $aT^2 \le$ stroke and
$2aT \le$ top speed allow. The velocity lies between the slowest and the fastest object, as far as
that acceleration leaves it any of the top speed and, where the stage pans, of the stroke
(`mishutter.model.limits`). A stage that begins and ends at rest travels further than the exposure
(`mishutter.model.stages`), which bounds all three where its travel, its acceleration or its jerk is
limited. Where a pixel holds so many electrons and no more, a half exposure ends where white fills
it, sooner the more light the shutter lets through. So a given motion within the limits is a point
of the box.

Coordinates are those of the profile that is sent to the scene's device. The shutter of a design
is the transmittance that light sees.
"""

from collections.abc import Iterable
from dataclasses import replace
from functools import partial
from typing import NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from mishutter._core.checks import common_dtype, device_constant, require
from mishutter._core.compiling import compiled
from mishutter.evaluation.views import transmittance
from mishutter.model.devices import AbstractDevice
from mishutter.model.limits import Limits
from mishutter.model.motion import (
    AbstractMotion,
    ParabolicMotion,
    is_known_zero,
    simplified,
)
from mishutter.model.scene import Scene, in_sensor_frame
from mishutter.model.sensor import filling_half_exposure, white_electrons
from mishutter.model.shutters.base import (
    AbstractShutter,
    at_coordinates,
    coordinates,
    is_adjustable,
    num_coordinates,
)
from mishutter.model.shutters.windows import RectShutter

FREE_NAMES = ("shutter", "half_exposure", "velocity", "acceleration")
_ROUNDING = 1e-6
_TIMES_AT_ONCE = 8
"""Half exposures a call: one compiled program serves the first round and the halvings."""
_SLOWEST = 1e-2
"""Share of the largest acceleration that is explored where every object is at rest."""


class Bends(NamedTuple):
    """Places along one coordinate of the box where a loss may have a kink."""

    coordinate: int  # Index of the coordinate
    places: Float[np.ndarray, "n"]  # Its values there, inside the box; shape `(n,)`


class Interval(NamedTuple):
    """An interval with a logarithmic coordinate from 0 to 1; scalars."""

    low: Float[Array, ""]  # Its lower end, at least 0
    high: Float[Array, ""]  # Its upper end

    def at(self, share: Float[Array, ""]) -> Float[Array, ""]:
        """The number at a coordinate, inside after rounding too; 0 in an interval up to 0."""
        ratio = jnp.where(self.low > 0, self.high, 1.0) / jnp.where(self.low > 0, self.low, 1.0)
        return _rounded_into(self.low * jnp.exp(share * jnp.log(ratio)), self.low, self.high)

    def share(self, value: Float[Array, ""]) -> Float[Array, ""]:
        """The coordinate of the number nearest to a value."""
        wide = self.high > self.low
        least = jnp.where(wide & (self.low > 0), self.low, 1.0)
        span = jnp.log(jnp.where(wide, self.high, 2.0) / least)
        positive = jnp.maximum(value, np.finfo(np.dtype(self.low.dtype)).tiny)
        return jnp.clip(jnp.where(wide, jnp.log(positive / least) / span, 0.5), 0, 1)


@final
class DesignSpace(eqx.Module):
    """A unit box of designs around a shutter and a motion."""

    # Profile as it is sent to the device: fixed, or of the kind that moves
    shutter: AbstractShutter
    motion: AbstractMotion  # Motion, whose numbers are fixed where they are not free
    limits: Limits  # Bounds on stroke, top speed, exposure and pan
    # Device that the profile is sent to; None for one that loses no light
    device: AbstractDevice | None
    # Half exposure over which white fills a pixel, s: through a fixed shutter, or through an open
    # one where the profile moves. None where pixels never fill
    filling: Float[Array, ""] | None
    slowest: Float[Array, ""]  # Least velocity worth panning at; px/s
    fastest: Float[Array, ""]  # Greatest velocity worth panning at; px/s
    demand: Float[Array, ""]  # Speed that a sensor gains as it keeps up with every object; px/s
    strongest: Float[Array, ""]  # Largest acceleration that is explored, within the limits; px/s^2
    free: tuple[str, ...] = eqx.field(static=True)  # Parts that may move
    # Number of coordinates that belong to the shutter
    num_profile_coordinates: int = eqx.field(static=True)

    @property
    def size(self) -> int:
        """Number of coordinates of a point of the box."""
        return self.num_profile_coordinates + len(self.free_of_motion)

    def at(self, point: Float[Array, "size"]) -> tuple[AbstractShutter, AbstractMotion]:
        """The design at a point of the box: the shutter behind the device, and the motion."""
        shutter = self._profile_at(point)
        share = dict(zip(self.free_of_motion, point[self.num_profile_coordinates :], strict=True))
        if not share:
            return self.transmittance(shutter, self.motion.half_exposure), self.motion
        half_exposure, velocity = self.motion.half_exposure, self.motion.velocity
        acceleration = self.motion.mean_acceleration
        # The order matters: the bounds of each number depend on those before it.
        if "half_exposure" in share:
            half_exposure = self._half_exposure_bounds(shutter).at(share["half_exposure"])
        if "acceleration" in share:
            acceleration = self._acceleration_bounds(half_exposure).at(share["acceleration"])
        if "velocity" in share:
            low, high = self._velocity_bounds(acceleration, half_exposure)
            velocity = low + share["velocity"] * (high - low)
        motion = ParabolicMotion(
            acceleration=acceleration, half_exposure=half_exposure, velocity=velocity
        )
        return self.transmittance(shutter, half_exposure), motion

    def shutter_at(
        self, point: Float[Array | np.ndarray, "size"], half_exposure: Float[Array, ""]
    ) -> AbstractShutter:
        """The shutter behind the device at a point of the box, for a half exposure there, s."""
        return self.transmittance(self._profile_at(point), half_exposure)

    def _profile_at(self, point: Float[Array | np.ndarray, "size"]) -> AbstractShutter:
        """The profile that is sent to the device at a point of the box."""
        count = self.num_profile_coordinates
        return at_coordinates(self.shutter, jnp.asarray(point[:count])) if count else self.shutter

    @property
    def of_motion(self) -> "DesignSpace":
        """The space of the motion alone, whose programs serve shutters of every kind.

        It is this space itself where no number of the motion moves, and where the longest exposure
        depends on the profile.
        """
        if self.fills_by_profile or not self.free_of_motion:
            return self
        return replace(
            self,
            free=tuple(name for name in self.free if name != "shutter"),
            shutter=RectShutter(),
            device=None,
            num_profile_coordinates=0,
        )

    @property
    def fills_by_profile(self) -> bool:
        """Whether the longest exposure, over which white fills a pixel, depends on the profile."""
        return self.filling is not None and (self.num_profile_coordinates > 0 or self.lags)

    @property
    def free_of_motion(self) -> tuple[str, ...]:
        """Numbers of the motion that may move, in the order of their coordinates."""
        return tuple(name for name in FREE_NAMES[1:] if name in self.free)

    @property
    def dtype(self) -> np.dtype:
        """Precision of the box."""
        return np.dtype(self.demand.dtype)

    def without_acceleration(self) -> "DesignSpace":
        """The same box for sensors that do not accelerate."""
        # A bound of 0 leaves the coordinate where it is, so that both spaces share compiled
        # programs.
        return eqx.tree_at(lambda s: s.strongest, self, device_constant(np.zeros((), self.dtype)))

    def holding(self, motions: Iterable[AbstractMotion]) -> "DesignSpace":
        """The space with a demand that some motions meet which keep up with fewer objects."""
        gains = [
            2 * float(motion.mean_acceleration) * float(motion.half_exposure)
            for motion in motions
            if not motion.is_straight
        ]
        least = np.asarray(min([float(self.demand), *gains]), self.dtype)
        return replace(self, demand=device_constant(least))

    @property
    def lags(self) -> bool:
        """Whether the transmittance of a profile depends on the exposure that it is sent over."""
        return self.device is not None and self.device.lags

    @property
    def bends(self) -> Bends:
        """Half exposures, as coordinates, at which another limit bounds a free acceleration.

        Stroke, top speed, the demand of the objects and of the motion, and the least acceleration
        that is explored give way to one another where two of them meet.
        """
        index = self.num_profile_coordinates
        moves = {"acceleration", "half_exposure"} <= set(self.free)
        if not moves or is_known_zero(self.strongest):
            return Bends(index, np.zeros(0))
        if self.fills_by_profile:
            return Bends(index, np.zeros(0))  # the exposures there are others for each profile
        low, high = (float(bound) for bound in self._half_exposure_bounds(self.shutter))
        demands = float(self.demand), float(self.motion.speed_gain)
        # The stroke and a gain of speed $v$ allow the same acceleration at $T = 2\,$stroke$/v$.
        speeds = [float(self.limits.max_top_speed), *demands, *(v / _SLOWEST for v in demands)]
        times = np.array([2 * float(self.limits.max_stroke) / v for v in speeds if v > 0])
        if self.limits.has_stage or self.limits.frame_velocity is not None:
            times = np.concatenate([times, self._bends_of_stage(low, high)])
        inside = np.sort(times[(low < times) & (times < high)])
        return Bends(index, np.log(inside / low) / np.log(high / low) if inside.size else inside)

    def _bends_of_stage(self, low: float, high: float) -> Float[np.ndarray, "n"]:
        """Half exposures at which another limit on the acceleration begins to hold; s."""

        def active_limits_at(times: Float[np.ndarray, "k"]) -> Int[np.ndarray, "k"]:
            padded = np.resize(times, -(-times.size // _TIMES_AT_ONCE) * _TIMES_AT_ONCE)
            rows = padded.astype(self.dtype).reshape(-1, _TIMES_AT_ONCE)
            each = [np.asarray(_active_limits(self.of_motion, row)) for row in rows]
            return np.concatenate(each)[: times.size]

        # No formula tells where limits of a stage meet: a row of exposures brackets each place, and
        # halving the bracket finds it.
        times = np.geomspace(low, high, 256)
        active = active_limits_at(times)
        at = np.flatnonzero(np.diff(active))
        before, after = times[at], times[at + 1]
        for _ in range(40 if at.size else 0):
            middle = np.sqrt(before * after)
            same = active_limits_at(middle) == active[at]
            before, after = np.where(same, middle, before), np.where(same, after, middle)
        return after

    def active_limits(self, half_exposure: Float[Array, ""]) -> Int[Array, ""]:
        """A number for the limits that bound the acceleration over an exposure; scalar."""
        limits, half = self.limits, half_exposure
        least, most = self._acceleration_bounds(half)
        rest = jnp.zeros_like(half)
        # Any change of one of these facts changes the number.
        shares = [
            most / limits.acceleration_by_stroke(half),
            2 * most * half / limits.max_top_speed,
            limits.stage_share(most, half, rest),
            rest if limits.max_acceleration is None else 2 * most / limits.max_acceleration,
        ]
        floors = jnp.stack([self.demand.astype(most.dtype), _SLOWEST * 2 * most * half])
        own = least * 2 * half / jnp.maximum(self.motion.speed_gain, 1e-30)
        number = jnp.argmax(jnp.stack(shares)) * 8
        number += jnp.argmax(floors) * 4 + jnp.where(own < 1 - 1e-9, 2, 0)
        return number + jnp.where(least >= most, 1, 0)

    def point_of(self, shutter: AbstractShutter, motion: AbstractMotion) -> Float[Array, "size"]:
        """The point of the box nearest to a design."""
        dtype = common_dtype(self.demand, motion.half_exposure)
        parts = []
        if "shutter" in self.free:
            parts.append(jnp.clip(coordinates(shutter), 0, 1).astype(dtype))
        half_exposure = motion.half_exposure
        if "half_exposure" in self.free:
            bounds = self._half_exposure_bounds(shutter)
            share = bounds.share(half_exposure)
            parts.append(share.astype(dtype)[None])
            half_exposure = bounds.at(share)
        if not self.free_of_motion:
            return jnp.concatenate(parts)
        acceleration, share = motion.mean_acceleration, None
        if "acceleration" in self.free:
            bounds = self._acceleration_bounds(half_exposure)
            share = bounds.share(acceleration)
            acceleration = bounds.at(share)
        if "velocity" in self.free:
            low, high = self._velocity_bounds(acceleration, half_exposure)
            width = jnp.where(high > low, high - low, 1.0)
            place = jnp.where(high > low, (motion.velocity - low) / width, 0.5)
            parts.append(jnp.clip(place, 0, 1).astype(dtype)[None])
        if share is not None:
            parts.append(share.astype(dtype)[None])
        return jnp.concatenate(parts)

    def _velocity_bounds(self, acceleration: Float[Array, ""], half: Float[Array, ""]) -> Interval:
        """Least and greatest velocity at mid-exposure; px/s."""
        rest, limits = jnp.zeros_like(half), self.limits
        most = jnp.clip(limits.max_top_speed - 2 * acceleration * half, 0, limits.max_pan)
        by_stroke = limits.velocity_by_stroke(acceleration, half)
        most = most if by_stroke is None else jnp.minimum(most, by_stroke)
        if limits.has_stage:
            numbers = {"acceleration": acceleration, "half_exposure": half, "velocity": rest}
            most = limits.largest("velocity", rest, most, numbers)
        return Interval(jnp.clip(self.slowest, -most, most), jnp.clip(self.fastest, -most, most))

    def transmittance(
        self, shutter: AbstractShutter, half_exposure: Float[Array, ""]
    ) -> AbstractShutter:
        """The transmittance that the search sees of a profile.

        One that moves stays behind the device where it comes to stay open: the loss has no step.
        """
        if self.device is None:
            return shutter
        through = self.device.behind if self.num_profile_coordinates else self.device.light
        return through(shutter, half_exposure, self.dtype)

    def _half_exposure_bounds(self, shutter: AbstractShutter) -> Interval:
        """Shortest and longest half exposure; s."""
        low, high = self.limits.min_half_exposure, self.limits.max_half_exposure
        if self.filling is not None:
            filling = longest = self.filling
            # The light that a lagging device passes depends on the exposure: each round leaves less
            # than a quarter of the error.
            num_rounds = 8 if self.lags else min(1, self.num_profile_coordinates)
            for _ in range(num_rounds):
                profile = self.transmittance(shutter, longest)
                efficiency = profile.efficiency().astype(filling.dtype)
                longest = filling / jnp.maximum(efficiency, filling / high)
            high = jnp.clip(longest, low, high)
        moves = "acceleration" in self.free
        # An acceleration that moves makes room for any exposure.
        a = jnp.zeros((), self.dtype) if moves else self.motion.mean_acceleration
        longest = self.limits.half_exposure_by_stroke(a)
        safe = jnp.where(a > 0, a, 1.0)
        by_speed = jnp.where(a > 0, self.limits.max_top_speed / (2 * safe), jnp.inf)
        high = jnp.clip(jnp.minimum(longest, by_speed), low, high)
        if self.limits.has_stage:
            rest = jnp.zeros_like(a)
            numbers = {"acceleration": a, "half_exposure": low, "velocity": rest}
            high = self.limits.largest("half_exposure", low, high, numbers)
        return Interval(low, high)

    def _acceleration_bounds(self, half_exposure: Float[Array, ""]) -> Interval:
        """Least and greatest acceleration; px/s^2."""
        rest = jnp.zeros_like(half_exposure)
        high = self.limits.largest_acceleration(half_exposure, rest)
        high = jnp.minimum(high, self.strongest)
        keeping_up = jnp.clip(self.demand / (2 * half_exposure), _SLOWEST * high, high)
        gain = jnp.abs(self.motion.mean_acceleration) * self.motion.half_exposure
        return Interval(jnp.minimum(keeping_up, gain / half_exposure), high)


@compiled
def _active_limits(
    space: DesignSpace, half_exposures: Float[Array | np.ndarray, "k"]
) -> Int[Array, "k"]:
    return jax.vmap(space.active_limits)(jnp.asarray(half_exposures))


def search_frame(
    scene: Scene, motion: AbstractMotion, free: Iterable[str]
) -> tuple[Scene, AbstractMotion]:
    """A scene and a motion in the frame of the sensor, unless the search may move its velocity."""
    motion = simplified(motion)
    return (scene, motion) if "velocity" in free else in_sensor_frame(scene, motion)


def design_space(
    scene: Scene,
    motion: AbstractMotion,
    shutter: AbstractShutter,
    free: str | Iterable[str],
    *,
    function: str = "optimise",
) -> DesignSpace:
    """The space of what `free` names, within the scene's limits.

    The scene and the motion are those of the `search_frame`. Errors name the `function`.
    """
    names = (free,) if isinstance(free, str) else tuple(free)
    subject = f"{function}(free=...)"
    are_parts = bool(names) and all(name in FREE_NAMES for name in names)
    require(are_parts, subject, f"name some of {', '.join(FREE_NAMES)}", free)
    if "shutter" in names:
        require(
            is_adjustable(shutter),
            f"{function}(shutter=...)",
            "have parameters with bounds, as a SplineShutter or TukeyShutter has, "
            "for free to name it",
            type(shutter).__name__,
        )
    require(not motion.fixed.names & set(names), subject, motion.fixed.request, free)
    dtype = common_dtype(motion.half_exposure, scene.speeds)
    ordered = tuple(name for name in FREE_NAMES if name in names)
    num_profile = num_coordinates(shutter) if "shutter" in ordered else 0
    slowest, fastest = (x.astype(dtype) for x in scene.speed_range)
    velocity = motion.velocity.astype(dtype)
    lags = scene.device is not None and scene.device.lags
    filling = _filling(scene, None if num_profile or lags else shutter)
    # A sensor that pans at the middle of the speeds has half their range to keep up with.
    pans = "velocity" in ordered
    return DesignSpace(
        shutter=shutter,
        motion=motion,
        limits=jax.tree.map(lambda x: x.astype(dtype), scene.limits),
        device=jax.tree.map(lambda x: x.astype(dtype), scene.device),
        filling=None if filling is None else jnp.asarray(filling, dtype),
        slowest=device_constant(np.minimum(slowest, velocity)),
        fastest=device_constant(np.maximum(fastest, velocity)),
        demand=(fastest - slowest) / 2 if pans else scene.max_speed.astype(dtype),
        strongest=device_constant(np.full((), np.inf, dtype)),
        free=ordered,
        num_profile_coordinates=num_profile,
    )


def mirrors(scene: Scene, velocity: float) -> bool:
    """Whether the objects move alike in both directions from a velocity, px/s.

    A background that stands still has to stand still at that velocity too.
    """
    layers = scene.occlusion
    if layers is not None and layers.background == "still":
        if float(layers.background_speed) != velocity:
            return False
    speeds, weights = np.asarray(scene.speeds, np.float64) - velocity, np.asarray(scene.weights)
    # The order is that of speeds and then of weights, so that a speed that is listed twice finds
    # its mirror image.
    forward = np.lexsort((weights, speeds))
    backward = np.lexsort((weights, -speeds))
    equal = partial(np.allclose, atol=1e-5 * float(np.max(np.abs(speeds))))
    return equal(speeds[forward], -speeds[backward]) and np.allclose(
        weights[forward], weights[backward]
    )


def _filling(scene: Scene, shutter: AbstractShutter | None) -> float | None:
    """Half exposure over which white fills a pixel through a shutter, or an open one; s.

    None where the longest exposure does not fill it.
    """
    if scene.sensor.full_well is None:
        return None
    rate, full_well = float(scene.photon_rate), float(scene.sensor.full_well)
    shortest = float(white_electrons(rate, 2 * float(scene.limits.min_half_exposure)))
    requirement = (
        f"hold what an open shutter lets through in the shortest exposure, {shortest:g} e-"
    )
    require(shortest <= full_well, "Sensor(full_well=...)", requirement, full_well)
    efficiency, most = 1.0, scene.limits.max_half_exposure
    if shutter is not None:
        efficiency = float(transmittance(scene, most, shutter).efficiency())
    if white_electrons(rate, 2 * float(most), efficiency) <= full_well:
        return None
    return float(filling_half_exposure(full_well, rate, efficiency))


def all_that_can_move(
    scene: Scene, motion: AbstractMotion, shutter: AbstractShutter | None
) -> tuple[str, ...]:
    """Parts that may move: a camera at rest stays, and so does a fixed window.

    Without a shutter the profile is of free form.
    """
    fixed = set(motion.fixed.names)
    if not scene.limits.may_pan:
        fixed.add("velocity")
    if shutter is not None and not is_adjustable(shutter):
        fixed.add("shutter")
    return tuple(name for name in FREE_NAMES if name not in fixed)


def beyond_limits(
    scene: Scene, motion: AbstractMotion, shutter: AbstractShutter
) -> tuple[str, ...]:
    """Names of the limits that a design exceeds by more than rounding.

    The names are those of `Limits.demands`, and `"full_well"` where white fills a pixel.
    """
    demands = scene.limits.demands(motion).items()
    names = tuple(name for name, demand in demands if not demand.is_met(_ROUNDING))
    return (*names, "full_well") if fills(scene, motion, shutter) else names


def fills(scene: Scene, motion: AbstractMotion, shutter: AbstractShutter) -> bool:
    r"""Whether white, $2RT\eta$ electrons, is more than a pixel holds, to rounding."""
    if scene.sensor.full_well is None:
        return False
    efficiency = float(transmittance(scene, motion, shutter).efficiency())
    electrons = white_electrons(float(scene.photon_rate), float(motion.exposure), efficiency)
    return bool(electrons > float(scene.sensor.full_well) * (1 + _ROUNDING))


@jax.custom_jvp
def _rounded_into(
    value: Float[Array, ""], low: Float[Array, ""], high: Float[Array, ""]
) -> Float[Array, ""]:
    """Undoes a last-digit excursion from an interval and leaves the derivative alone.

    A clip has half of it at an end, or none: a search would see no slope that leads inside.
    """
    return jnp.clip(value, low, high)


@_rounded_into.defjvp
def _rounded_into_jvp(primals, tangents):
    return _rounded_into(*primals), tangents[0]
