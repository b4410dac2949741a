"""How far the mechanism and the exposure may reach."""

from collections.abc import Mapping
from contextlib import nullcontext
from dataclasses import replace
from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from mishutter._core import (
    all_concrete,
    as_float,
    compiled,
    fields_text,
    is_concrete,
    require,
    require_at_least,
    require_scalar,
)
from mishutter.model.motion import (
    AbstractMotion,
    FreeMotion,
    ParabolicMotion,
    StillCamera,
    is_straight,
    settled,
    steady,
)
from mishutter.model.stages import StagePath, StageUse, stage_path, stage_use, stage_use_of_path

_BISECTIONS = 60
_OF_STAGE = ("max_travel", "max_acceleration", "max_jerk")


@final
class Limits(eqx.Module):
    """The furthest that the mechanism and the exposure may reach.

    Args:
        max_stroke: Largest $aT^2$; px.
        max_top_speed: Largest $2aT + |v|$; px/s.
        min_half_exposure: Shortest $T$; s.
        max_half_exposure: Longest $T$; s.
        max_pan: Largest $|v|$; px/s. 0 forbids panning; `max_top_speed` by default.
        max_travel: Largest travel from rest to rest, run-up and run-out at the greatest
            acceleration included (`mishutter.model.stages`); px. None for any.
        max_acceleration: Greatest acceleration of the sensor, $2a$ in the exposure; px/s^2. None
            for any, which runs up at once.
        max_jerk: Greatest jerk of the run-up and the run-out, which a higher top speed pays for;
            px/s^3. None for any.

    Attributes:
        frame_velocity: Velocity of the frame that motions are in, as `seen_from` sets it; px/s.
            None where no stage limits anything.

    Raises:
        ValueError: if one is not a positive scalar (`max_pan` at least 0), or the exposures
            are out of order.
    """

    max_stroke: Array
    max_top_speed: Array
    min_half_exposure: Array
    max_half_exposure: Array
    max_pan: Array
    max_travel: Array | None
    max_acceleration: Array | None
    max_jerk: Array | None
    frame_velocity: Array | None

    def __init__(
        self,
        *,
        max_stroke: ArrayLike = 200.0,
        max_top_speed: ArrayLike = 1e5,
        min_half_exposure: ArrayLike = 1e-4,
        max_half_exposure: ArrayLike = 0.5,
        max_pan: ArrayLike | None = None,
        max_travel: ArrayLike | None = None,
        max_acceleration: ArrayLike | None = None,
        max_jerk: ArrayLike | None = None,
    ):
        self.max_stroke = as_float(max_stroke, "Limits(max_stroke=...)")
        self.max_top_speed = as_float(max_top_speed, "Limits(max_top_speed=...)")
        self.min_half_exposure = as_float(min_half_exposure, "Limits(min_half_exposure=...)")
        self.max_half_exposure = as_float(max_half_exposure, "Limits(max_half_exposure=...)")
        max_pan = self.max_top_speed if max_pan is None else max_pan
        self.max_pan = as_float(max_pan, "Limits(max_pan=...)")
        self.max_travel = self.max_acceleration = self.max_jerk = self.frame_velocity = None
        if max_travel is not None:
            self.max_travel = as_float(max_travel, "Limits(max_travel=...)")
        if max_acceleration is not None:
            self.max_acceleration = as_float(max_acceleration, "Limits(max_acceleration=...)")
        if max_jerk is not None:
            self.max_jerk = as_float(max_jerk, "Limits(max_jerk=...)")
        if self.has_stage:
            self.frame_velocity = as_float(np.zeros((), self.max_top_speed.dtype))

    def __check_init__(self) -> None:
        stage = [name for name in _OF_STAGE if getattr(self, name) is not None]
        always = ("max_stroke", "max_top_speed", "min_half_exposure", "max_half_exposure")
        for name in (*always, *stage):
            require_scalar(f"Limits({name}=...)", getattr(self, name))
            require_at_least(f"Limits({name}=...)", getattr(self, name), "above 0", strict=True)
        require_scalar("Limits(max_pan=...)", self.max_pan)
        require_at_least("Limits(max_pan=...)", self.max_pan, "at least 0")
        if is_concrete(self.min_half_exposure) and is_concrete(self.max_half_exposure):
            require(
                float(self.min_half_exposure) <= float(self.max_half_exposure),
                "Limits(min_half_exposure=...)",
                f"be at most max_half_exposure = {float(self.max_half_exposure):g} s",
                self.min_half_exposure,
            )

    def __repr__(self) -> str:
        """The numbers, of which a module shows no more than their type."""
        return fields_text(self)

    @property
    def has_stage(self) -> bool:
        """Whether travel, acceleration or jerk of the stage is limited."""
        return any(getattr(self, name) is not None for name in _OF_STAGE)

    def stage_share(
        self,
        acceleration: Array,
        half_exposure: Array,
        velocity: Array,
        pieces: Array | None = None,
    ) -> Array:
        """Share of the stage's travel, and of its top speed where its jerk is limited, in use.

        It never falls with the acceleration, px/s^2, the half exposure, s, or the size of the
        velocity, px/s, in the frame of the stage. Of any shape.

        With `pieces` it is that of a free path of so many equal ones, `(K,)`, whose accelerations
        are multiples of the one given; of scalars then, and where no jerk is limited.
        """
        if pieces is not None:
            return self.stage_share_of(
                FreeMotion(
                    accelerations=acceleration * pieces,
                    half_exposure=half_exposure,
                    velocity=velocity,
                )
            )
        frame = self._frame(velocity)
        limits = self.max_acceleration, self.max_jerk
        use = stage_use(acceleration, half_exposure, velocity + frame, *limits)
        return self._share_of(use, frame)

    def stage_share_of(self, motion: AbstractMotion) -> Array:
        """The `stage_share` of a motion; scalar."""
        velocity = jnp.asarray(motion.velocity)
        frame = self._frame(velocity)
        if isinstance(motion, FreeMotion):
            path = replace(motion, velocity=velocity + frame)
            return self._share_of(stage_use_of_path(path, self.max_acceleration), frame)
        acceleration, half = steady(motion).acceleration, motion.half_exposure
        return self.stage_share(jnp.asarray(acceleration), jnp.asarray(half), velocity)

    def stage_path(self, motion: AbstractMotion) -> StagePath | None:
        """The path of the stage from rest through an exposure to rest.

        Its run-up and run-out take the greatest acceleration and jerk, or the greatest
        acceleration of the exposure where neither is limited. None where the sensor stays at rest,
        or pans and neither is limited.

        Args:
            motion: Motion of the sensor over the exposure, within these limits.
        """
        motion = settled(motion)
        most, jerk = self.max_acceleration, self.max_jerk
        runs_up_at_once = most is None and jerk is None
        if isinstance(motion, StillCamera) or (runs_up_at_once and is_straight(motion)):
            return None
        most = motion.greatest_acceleration if runs_up_at_once else most
        return stage_path(motion, max_acceleration=most, max_jerk=jerk)

    def _frame(self, velocity: Array) -> Array:
        """Velocity of the frame that motions are in; px/s, the shape and precision given."""
        frame = jnp.zeros_like(velocity)
        if self.frame_velocity is not None:
            frame = frame + self.frame_velocity.astype(frame.dtype)
        return frame

    def _share_of(self, use: StageUse, frame: Array) -> Array:
        share = jnp.zeros_like(use.travel)
        if self.max_travel is not None:
            share = jnp.maximum(share, use.travel / self.max_travel)
        if self.max_jerk is not None:
            left = jnp.maximum(self.max_top_speed, np.finfo(share.dtype).tiny)
            share = jnp.maximum(share, (use.top_speed - jnp.abs(frame)) / left)
        return share

    def largest(
        self,
        name: str,
        low: Array,
        high: Array,
        numbers: Mapping[str, Array],
        pieces: Array | None = None,
    ) -> Array:
        """Largest value of a number of a motion that the stage reaches; scalar.

        It is bracketed by bisection, on the side that keeps the limits, and has the derivative of
        an implicit function. Where all of the interval exceeds them it is the lower end.

        Args:
            name: `"acceleration"`, `"half_exposure"` or `"velocity"`.
            low: Least value.
            high: Greatest value.
            numbers: The numbers of a motion in which it takes its place.
            pieces: Those of a free path, as `stage_share` takes them.
        """
        return _largest(self, name, low, high, {**numbers, "pieces": pieces})

    def fullest_motion(self, velocity: ArrayLike = 0.0) -> ParabolicMotion:
        """The longest stroke at the highest top speed that the limits allow.

        Args:
            velocity: Velocity at mid-exposure, px/s, which is brought within half of the top
                speed and the largest pan.
        """
        stroke, top, pan = self.max_stroke, self.max_top_speed, self.max_pan
        shortest, longest = self.min_half_exposure, self.max_half_exposure
        known = all_concrete((stroke, top, pan, shortest, longest, velocity))
        space, number = (np, np.asarray) if known else (jnp, jnp.asarray)
        numbers = map(number, (stroke, top, pan, shortest, longest, velocity))
        stroke, top, pan, shortest, longest, velocity = numbers
        furthest = space.minimum(pan, top / 2)
        velocity = space.clip(velocity, -furthest, furthest).astype(top.dtype)
        left = top - space.abs(velocity)
        T = space.clip(2 * stroke / left, shortest, longest)
        acceleration = space.minimum(stroke / T / T, left / (2 * T))
        if self.has_stage:
            numbers = acceleration, T, velocity, shortest
            with jax.ensure_compile_time_eval() if known else nullcontext():
                acceleration, T, velocity = self._within_stage(*map(jnp.asarray, numbers))
        return ParabolicMotion(acceleration=acceleration, half_exposure=T, velocity=velocity)

    def _within_stage(
        self, acceleration: Array, half_exposure: Array, velocity: Array, shortest: Array
    ) -> tuple[Array, Array, Array]:
        """A motion that the stage reaches: with a slower pan, then shorter, then weaker."""
        none = jnp.zeros_like(acceleration)
        if self.max_acceleration is not None:
            acceleration = jnp.minimum(acceleration, self.max_acceleration / 2)
        pan, sign = jnp.abs(velocity), jnp.sign(velocity)
        numbers = {"acceleration": none, "half_exposure": shortest, "velocity": none}
        numbers["velocity"] = sign * self.largest("velocity", none, pan, numbers)
        half = self.largest("half_exposure", shortest, half_exposure, numbers)
        numbers["half_exposure"] = half
        return self.largest("acceleration", none, acceleration, numbers), half, numbers["velocity"]


@compiled
def _largest(limits: Limits, name: str, low: Array, high: Array, numbers: Any) -> Array:
    def use(value: Array, limits: Limits, numbers: Any) -> Array:
        return limits.stage_share(**(numbers | {name: value}))

    fixed = jax.lax.stop_gradient((limits, numbers))
    ends = jax.lax.stop_gradient((jnp.asarray(low), jnp.asarray(high)))

    def halved(_: Array, ends: tuple[Array, Array]) -> tuple[Array, Array]:
        middle = (ends[0] + ends[1]) / 2
        keeps = use(middle, *fixed) <= 1
        return jnp.where(keeps, middle, ends[0]), jnp.where(keeps, ends[1], middle)

    found, _ = jax.lax.fori_loop(0, _BISECTIONS, halved, ends)
    slope = jax.grad(use)(found, *fixed)
    share, rises = use(found, limits, numbers), slope > 0
    moved = jnp.where(rises, share - jax.lax.stop_gradient(share), 0.0)
    inside = found - moved / jnp.where(rises, slope, 1.0)
    return jnp.where(use(ends[1], *fixed) <= 1, high, jnp.where(found > ends[0], inside, low))
