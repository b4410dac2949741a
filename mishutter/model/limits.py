r"""The limits of the mechanism and of the exposure.

The stroke $S$ bounds the whole path of the stage over the exposure, from its lowest position to its
highest. Where the stage pans too, at the velocity $v$, that is $a\,(T + |v|/2a)^2 \le S$ for a
parabola that turns within the exposure, $|v| < 2aT$, and $2|v|T \le S$ for one that does not.
Solved for one of the three numbers,

$$a \le \left(\frac{\sqrt S + \sqrt{S - 2|v|T}}{2T}\right)^2,\qquad
|v| \le \begin{cases} 2\,(\sqrt{Sa} - aT) & S < 4aT^2\\ S/2T & \text{else}\end{cases},\qquad
T \le \begin{cases} \sqrt{S/a} - |v|/2a & |v| < \sqrt{Sa}\\ S/2|v| & \text{else.}\end{cases}$$
"""

from collections.abc import Callable, Mapping
from contextlib import nullcontext
from typing import ClassVar, Literal, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, PyTree

from mishutter._core.checks import (
    all_concrete,
    as_array_like,
    as_float,
    is_concrete,
    namespace_of,
    require,
    require_number,
)
from mishutter._core.compiling import compiled
from mishutter._core.modules import AbstractModule
from mishutter.model.motion import (
    AbstractMotion,
    ParabolicMotion,
    Positions,
    acceleration_of_stroke,
    is_known_zero,
)
from mishutter.model.servos import SecondOrderStage
from mishutter.model.stages import SINGLE, StagePath, stage_path, stage_use

Number = Float[Array | np.ndarray | np.floating, ""]
LEAST_STROKE = 1e-3
"""A sensor that may move by less than this stands still; px."""
_OF_STAGE = ("max_travel", "max_acceleration", "max_jerk")
"""Limits that a scene may do without, and that the search bounds motions by."""


class LimitUse(NamedTuple):
    """The use of one limit by motions, and the limit itself."""

    taken: Float[np.ndarray, "..."]  # The use; of any shape
    there: Float[np.ndarray, "..."]  # The limit, in the same unit; of any shape

    def is_met(self, slack: float) -> np.ndarray | np.bool_:
        """Whether no more is taken than there is, by a share of it."""
        return self.taken <= self.there * (1 + slack)


class Limit(NamedTuple):
    """One limit of a motion: its name, its measure, and the words of errors."""

    name: str  # Its name in `Limits.demands`, in notes of designs and in maps
    bit: int  # Its bit among the reasons in a sweep's store, which no other takes later
    # The use of it by a motion and the limit itself, among all `Limits`; either may be None
    demand: Callable[["Limits", AbstractMotion], tuple[Positions | None, Positions | None]]
    requirement: str  # Words for what a motion must do, of the numbers `taken` and `there`
    got: str  # Words for what a motion does, of the same numbers
    scale: float = 1.0  # Factor from the unit of the numbers to that of the words

    def words(self, demand: LimitUse) -> tuple[str, str]:
        """The requirement of an error, and what it got, of one motion."""
        numbers = {name: float(x) * self.scale for name, x in demand._asdict().items()}
        return self.requirement.format(**numbers), self.got.format(**numbers)


LIMITS = (
    Limit(
        "exposure_too_short",
        2,
        lambda limits, motion: (limits.min_half_exposure, motion.half_exposure),
        "leave an exposure of at least {taken:g} ms",
        "{there:g} ms",
        scale=2e3,
    ),
    Limit(
        "exposure_too_long",
        3,
        lambda limits, motion: (motion.half_exposure, limits.max_half_exposure),
        "leave an exposure of at most {there:g} ms",
        "{taken:g} ms",
        scale=2e3,
    ),
    Limit(
        "pan",
        5,
        lambda limits, motion: (abs(motion.velocity), limits.max_pan),
        "keep the pan within max_pan_px_per_s = {there:g}",
        "{taken:g} px/s",
    ),
    Limit(
        "top_speed",
        1,
        lambda limits, motion: (motion.top_speed, limits.max_top_speed),
        "keep the top speed within max_top_speed_px_per_s = {there:g}",
        "{taken:g} px/s",
    ),
    Limit(
        "stroke",
        0,
        lambda limits, motion: (limits.of_stage(motion).stroke, limits.max_stroke),
        "keep the stroke within max_stroke_px = {there:g}",
        "{taken:g} px, the pan included",
    ),
    Limit(
        "acceleration",
        7,
        lambda limits, motion: (motion.greatest_acceleration, limits.max_acceleration),
        "keep within max_acceleration, {there:g} px/s^2",
        "{taken:g} px/s^2",
    ),
    Limit(
        "travel",
        6,
        lambda limits, motion: (
            _compiled_travel_share(limits, motion) if limits.has_stage else None,
            np.ones(()),
        ),
        "leave the stage room to run up and out within its travel and top speed",
        "{taken:.3g} times as much",
    ),
)
"""All limits of a motion, in the order in which errors name them."""


@final
class Limits(AbstractModule):
    """The furthest that the mechanism and the exposure may reach.

    Args:
        max_stroke: Greatest distance from the lowest to the highest position of the stage over the
            exposure; px. It is $aT^2$ of a parabola without a pan. 0 says that there is no stage,
            and becomes a thousandth of a pixel.
        max_top_speed: Largest $2aT + |v|$, also where the camera pans; over frames that of the
            stage, beside which the camera pans no faster than that either; px/s.
        min_half_exposure: Shortest $T$; s.
        max_half_exposure: Longest $T$; s.
        max_pan: Largest $|v|$; px/s. 0 forbids panning; `max_top_speed` by default.
        max_travel: Largest travel from rest to rest, run-up and run-out at the greatest
            acceleration included (`mishutter.model.stages`); px. None for any.
        max_acceleration: Greatest acceleration of the sensor, $2a$ in the exposure; px/s^2. None
            for any, which runs up at once.
        max_jerk: Greatest jerk of the run-up and the run-out, which a higher top speed pays for;
            px/s^3. None for any.
        pans: What pans: `"stage"`, whose stroke and travel then hold the pan, or `"camera"`, where
            turning the camera does, and the stage makes the rest of the motion.
        axes: Axes of the stage, where things move in any direction: `"one"`, along that of the
            fastest; `"each"` of two, which keeps the limits by itself; or `"disc"`, two that keep
            them together.
        stage: How the stage follows what it is sent, which says what to send; by default it is
            where it is sent at once.
        frame_velocity: Velocity of the frame that motions are in, which `in_sensor_frame` sets;
            px/s. None for a frame at rest, or where the camera pans.

    Raises:
        ValueError: if one is not a positive scalar (`max_pan` at least 0), the exposures are out
            of order, `pans` is neither, or `stage` is no stage.
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
    stage: SecondOrderStage | None
    pans: Literal["stage", "camera"] = eqx.field(static=True)
    axes: Literal["one", "each", "disc"] = eqx.field(static=True)
    handed_on: ClassVar = ("frame_velocity",)
    former: ClassVar = ("free_paths",)

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
        pans: Literal["stage", "camera"] = "stage",
        axes: Literal["one", "each", "disc"] = "each",
        stage: SecondOrderStage | None = None,
        frame_velocity: ArrayLike | None = None,
    ):
        stroke = as_float(max_stroke, "Limits(max_stroke=...)")
        is_none = all_concrete(stroke) and stroke.ndim == 0 and float(stroke) == 0
        self.max_stroke = as_float(np.asarray(LEAST_STROKE, stroke.dtype)) if is_none else stroke
        self.max_top_speed = as_float(max_top_speed, "Limits(max_top_speed=...)")
        self.min_half_exposure = as_float(min_half_exposure, "Limits(min_half_exposure=...)")
        self.max_half_exposure = as_float(max_half_exposure, "Limits(max_half_exposure=...)")
        max_pan = self.max_top_speed if max_pan is None else max_pan
        self.max_pan = as_float(max_pan, "Limits(max_pan=...)")
        for name, value in {
            "max_travel": max_travel,
            "max_acceleration": max_acceleration,
            "max_jerk": max_jerk,
            "frame_velocity": frame_velocity,
        }.items():
            setattr(self, name, None if value is None else as_float(value, f"Limits({name}=...)"))
        self.pans, self.axes, self.stage = pans, axes, stage

    def __check_init__(self) -> None:
        stage = [name for name in _OF_STAGE if getattr(self, name) is not None]
        always = ("max_stroke", "max_top_speed", "min_half_exposure", "max_half_exposure")
        for name in (*always, *stage):
            require_number(f"Limits({name}=...)", getattr(self, name), "above 0", strict=True)
        require_number("Limits(max_pan=...)", self.max_pan, "at least 0")
        kinds = ("stage", "camera")
        require(self.pans in kinds, "Limits(pans=...)", "be 'stage' or 'camera'", self.pans)
        kinds = ("one", "each", "disc")
        require(self.axes in kinds, "Limits(axes=...)", "be 'one', 'each' or 'disc'", self.axes)
        is_stage = isinstance(self.stage, SecondOrderStage | None)
        require(is_stage, "Limits(stage=...)", "be a `SecondOrderStage`", self.stage)
        if is_concrete(self.min_half_exposure) and is_concrete(self.max_half_exposure):
            shortest, longest = self.min_half_exposure, float(self.max_half_exposure)
            subject = "Limits(min_half_exposure=...)"
            requirement = f"be at most max_half_exposure = {longest:g} s"
            require(float(shortest) <= longest, subject, requirement, shortest)

    @property
    def moves(self) -> bool:
        """Whether there is a stage, which a stroke of 0 denies."""
        return float(self.max_stroke) > LEAST_STROKE * (1 + 1e-6)

    @property
    def may_pan(self) -> bool:
        """Whether the sensor may pan: on a stage, or with a camera that turns."""
        carries = self.pans == "camera" or not is_concrete(self.max_stroke) or self.moves
        return carries and not is_known_zero(self.max_pan)

    @property
    def has_stage(self) -> bool:
        """Whether travel, acceleration or jerk of the stage is limited."""
        return any(getattr(self, name) is not None for name in _OF_STAGE)

    def demands(self, motion: AbstractMotion) -> dict[str, LimitUse]:
        """The use of each limit by a motion, by the limit's name; scalars.

        The electrons that fill a pixel are a limit of the scene.

        Args:
            motion: Motion of the sensor.
        """
        pairs = {limit.name: limit.demand(self, motion) for limit in LIMITS}
        return {
            name: LimitUse(np.asarray(taken, np.float64), np.asarray(there, np.float64))
            for name, (taken, there) in pairs.items()
            if taken is not None and there is not None
        }

    def demands_of_parabolas(
        self,
        acceleration: Float[np.ndarray, "..."],
        half_exposure: Float[np.ndarray, "..."],
        velocity: Float[np.ndarray, "..."],
    ) -> dict[str, LimitUse]:
        """The `demands` of parabolas, from their numbers; of any shape.

        Args:
            acceleration: $a$; px/s^2.
            half_exposure: $T$; s.
            velocity: $v$; px/s.
        """
        numbers = np.broadcast_arrays(acceleration, half_exposure, velocity)
        one = ParabolicMotion(acceleration=0.0, half_exposure=1.0)
        return self.demands(
            eqx.tree_at(lambda m: (m.acceleration, m.half_exposure, m.velocity), one, numbers)
        )

    def of_stage(self, motion: AbstractMotion) -> AbstractMotion:
        """The part of a motion that the stage makes, seen from where it is mounted.

        Args:
            motion: Motion of the sensor.
        """
        velocity = motion.velocity
        if self.pans == "camera":
            velocity = as_float(np.zeros(velocity.shape, velocity.dtype))
        elif self.frame_velocity is not None:
            velocity = velocity + self._frame(jnp.asarray(velocity))
        return eqx.tree_at(lambda each: each.velocity, motion, velocity)

    def acceleration_by_stroke(
        self, half_exposure: Positions, velocity: ArrayLike = 0.0
    ) -> Positions:
        """Largest $a$ that the stroke leaves beside a pan, 0 where it holds no more than that.

        In px/s^2, of the shape of `half_exposure`.

        Args:
            half_exposure: $T$; s.
            velocity: Velocity at mid-exposure; px/s.
        """
        half = half_exposure
        speed = self._speed_of_stage(as_array_like(half, velocity))
        return acceleration_of_stroke(as_array_like(half, self.max_stroke), half, speed)

    def acceleration_of_path(
        self, half_exposure: Positions, velocity: ArrayLike = 0.0
    ) -> Positions:
        """Largest $a$ that the stroke and the top speed leave a parabola; px/s^2, as the exposure.

        Args:
            half_exposure: $T$; s.
            velocity: Velocity at mid-exposure; px/s.
        """
        space = namespace_of(half_exposure)
        by_stroke = self.acceleration_by_stroke(half_exposure, velocity)
        top, v = (as_array_like(half_exposure, x) for x in (self.max_top_speed, velocity))
        by_speed = space.maximum(top - abs(v), 0) / (2 * half_exposure)
        return space.minimum(by_stroke, by_speed)

    def largest_acceleration(self, half_exposure: Number, velocity: Number) -> Number:
        """Largest acceleration within stroke, top speed and the stage's reach; px/s^2, scalar.

        Args:
            half_exposure: $T$; s.
            velocity: Velocity at mid-exposure; px/s.
        """
        most = self.acceleration_of_path(half_exposure, velocity)
        return self.acceleration_of_stage(most, half_exposure, velocity)

    def velocity_by_stroke(
        self, acceleration: Float[Array, ""], half_exposure: Float[Array, ""]
    ) -> Float[Array, ""] | None:
        """Greatest $|v|$ that the stroke leaves beside an acceleration; px/s, None for any.

        Args:
            acceleration: $a$; px/s^2.
            half_exposure: $T$; s.
        """
        if self.pans == "camera":
            return None
        stroke, a, half = self.max_stroke, acceleration, half_exposure
        turns_within = stroke < 4 * a * half * half
        safe = jnp.where(turns_within, a, 1.0)
        turned = 2 * (jnp.sqrt(stroke * safe) - safe * half)
        return jnp.where(turns_within, jnp.maximum(turned, 0), stroke / (2 * half))

    def half_exposure_by_stroke(self, acceleration: Float[Array, ""]) -> Float[Array, ""]:
        """Largest $T$ that the stroke leaves beside an acceleration, and the frame's pan; s.

        Args:
            acceleration: $a$; px/s^2.
        """
        stroke, a = self.max_stroke, acceleration
        speed = self._speed_of_stage(jnp.zeros_like(a))
        turns_within = (a > 0) & (speed * speed < stroke * a)
        safe, pan = jnp.where(turns_within, a, 1.0), jnp.where(speed > 0, speed, 1.0)
        straight = jnp.where(speed > 0, stroke / (2 * pan), jnp.inf)
        return jnp.where(turns_within, jnp.sqrt(stroke / safe) - speed / (2 * safe), straight)

    def stage_share(
        self,
        acceleration: Float[Array, ""],
        half_exposure: Float[Array, ""],
        velocity: Float[Array, ""],
    ) -> Float[Array, ""]:
        """Share in use of what the stage reaches, for which there is no formula.

        That is its travel, and its top speed where its jerk is limited. It never falls with the
        acceleration, px/s^2, the half exposure, s, or the size of the velocity, px/s, in the frame
        of the stage.

        Args:
            acceleration: $a$; px/s^2.
            half_exposure: $T$; s.
            velocity: Velocity at mid-exposure; px/s.
        """
        motion = ParabolicMotion(
            acceleration=acceleration, half_exposure=half_exposure, velocity=velocity
        )
        return self.stage_share_of(motion)

    def stage_share_of(self, motion: AbstractMotion) -> Float[Array, "..."]:
        """The `stage_share` of a motion; of the shape of stacked motions.

        Args:
            motion: Motion of the sensor.
        """
        use = stage_use(self.of_stage(motion), self.max_acceleration, self.max_jerk)
        share = jnp.zeros_like(use.travel)
        if self.max_travel is not None:
            share = jnp.maximum(share, use.travel / self.max_travel)
        if self.max_jerk is not None:
            velocity = jnp.asarray(motion.velocity)
            by_camera = velocity if self.pans == "camera" else jnp.zeros_like(velocity)
            beside = jnp.abs(by_camera) - jnp.abs(self._frame(velocity))
            most = jnp.maximum(self.max_top_speed, np.finfo(share.dtype).tiny)
            share = jnp.maximum(share, (use.top_speed + beside) / most)
        return share

    def stage_path(self, motion: AbstractMotion) -> StagePath | None:
        """The path of the stage from rest through an exposure to rest.

        Its run-up and run-out take the greatest acceleration and jerk, or the greatest
        acceleration of the exposure where neither is limited. None where the stage stays at rest,
        or keeps its velocity and neither is limited.

        Args:
            motion: Motion of the sensor over the exposure, within these limits.
        """
        motion = self.of_stage(motion)
        most, jerk = self.max_acceleration, self.max_jerk
        runs_up_at_once = most is None and jerk is None
        is_at_rest = motion.is_straight and is_known_zero(motion.velocity)
        if is_at_rest or (runs_up_at_once and motion.is_straight):
            return None
        most = motion.greatest_acceleration if runs_up_at_once else most
        return stage_path(motion, max_acceleration=most, max_jerk=jerk)

    def beside(self, turning: float) -> "Limits":
        """The limits of a stage beside a camera that turns: what it turns by is not the stage's.

        Args:
            turning: Speed at which it turns; px/s.
        """
        return eqx.tree_at(lambda x: x.max_top_speed, self, self.max_top_speed - turning)

    def have_room_for(self, *, travel: float, stroke: float) -> bool:
        """Whether a way is within them, to single precision.

        Args:
            travel: From rest to rest; px.
            stroke: From the first light to the last; px.
        """
        uses = [LimitUse(np.asarray(stroke), np.asarray(self.max_stroke))]
        if self.max_travel is not None:
            uses.append(LimitUse(np.asarray(travel), np.asarray(self.max_travel)))
        return all(bool(use.is_met(SINGLE)) for use in uses)

    def travel_beyond(self, path: StagePath | None) -> float | None:
        """Travel of a path of the stage where it is more than is allowed; px. None elsewhere.

        It may be more where no limit says how a stage runs up, so that the search takes it to do so
        at once.

        Args:
            path: From rest to rest; None of a stage that stays at rest.
        """
        if path is None or self.max_travel is None:
            return None
        return path.travel if path.travel > float(self.max_travel) * (1 + 1e-6) else None

    def _frame(self, velocity: Array) -> Array:
        """Velocity of the frame that motions are in; px/s, the shape and precision given."""
        frame = jnp.zeros_like(velocity)
        if self.frame_velocity is not None:
            frame = frame + self.frame_velocity.astype(frame.dtype)
        return frame

    def _speed_of_stage(self, velocity: Positions | float) -> Positions | float:
        """Greatness of the velocity that the stage itself has at mid-exposure; px/s."""
        if self.pans == "camera":
            return abs(velocity) * 0
        if self.frame_velocity is None:
            return abs(velocity)
        return abs(velocity + as_array_like(velocity, self.frame_velocity))

    def largest(
        self,
        name: str,
        low: Number,
        high: Number,
        numbers: Mapping[str, Number],
    ) -> Float[Array, ""]:
        """Largest value of a number of a motion that the stage reaches; scalar.

        It keeps the limits, but for where all of the interval exceeds them: there it is the lower
        end.

        Args:
            name: `"acceleration"`, `"half_exposure"` or `"velocity"`.
            low: Least value.
            high: Greatest value.
            numbers: The numbers of a motion in which it takes its place.
        """
        return _largest(self, name, low, high, {**numbers})

    def fullest_motion(self, velocity: ArrayLike = 0.0) -> ParabolicMotion:
        """The longest stroke at the highest top speed that the limits allow.

        Args:
            velocity: Velocity at mid-exposure, px/s, which is brought within half of the top
                speed and the largest pan.
        """
        stroke, top, pan = self.max_stroke, self.max_top_speed, self.max_pan
        shortest, longest = self.min_half_exposure, self.max_half_exposure
        are_concrete = all_concrete((stroke, top, pan, shortest, longest, velocity))
        space, number = (np, np.asarray) if are_concrete else (jnp, jnp.asarray)
        numbers = map(number, (stroke, top, pan, shortest, longest, velocity))
        stroke, top, pan, shortest, longest, velocity = numbers
        furthest = space.minimum(pan, top / 2)
        if self.pans == "stage":  # half of the stroke, over the shortest exposure, is left
            furthest = space.minimum(furthest, stroke / (4 * shortest))
        furthest = furthest if self.may_pan else 0 * furthest
        velocity = space.clip(velocity, -furthest, furthest).astype(top.dtype)
        speed_gain = top - space.abs(velocity)
        T = space.clip(2 * stroke / speed_gain, shortest, longest)
        if self.pans == "stage":
            quickest = space.maximum(space.abs(velocity), stroke / (4 * longest))
            T = space.minimum(T, stroke / (4 * quickest))
        T, velocity = space.asarray(T), space.asarray(velocity)
        acceleration = self.acceleration_of_path(T, velocity)
        if self.has_stage:
            numbers = acceleration, T, velocity, shortest
            with jax.ensure_compile_time_eval() if are_concrete else nullcontext():
                acceleration, T, velocity = self._within_stage(*map(jnp.asarray, numbers))
        return ParabolicMotion(acceleration=acceleration, half_exposure=T, velocity=velocity)

    def _within_stage(
        self, acceleration: Array, half_exposure: Array, velocity: Array, shortest: Array
    ) -> tuple[Number, Number, Number]:
        """A motion that the stage reaches: with a slower pan, then shorter, then weaker."""
        none = jnp.zeros_like(acceleration)
        pan, sign = jnp.abs(velocity), jnp.sign(velocity)
        numbers = {"acceleration": none, "half_exposure": shortest, "velocity": none}
        velocity = numbers["velocity"] = sign * self.largest("velocity", none, pan, numbers)
        half = self.largest("half_exposure", shortest, half_exposure, numbers)
        return self.acceleration_of_stage(acceleration, half, velocity), half, velocity

    def acceleration_of_stage(
        self, most: Number, half_exposure: Number, velocity: Number
    ) -> Number:
        """Largest acceleration up to `most` that the stage reaches; px/s^2, scalar.

        Args:
            most: Acceleration above which none is looked for; px/s^2.
            half_exposure: $T$; s.
            velocity: Velocity at mid-exposure; px/s.
        """
        if self.max_acceleration is not None:
            most = jnp.minimum(most, self.max_acceleration / 2)
        if not self.has_stage:
            return most
        rest = jnp.zeros_like(most)
        numbers = {"acceleration": rest, "half_exposure": half_exposure, "velocity": velocity}
        return self.largest("acceleration", rest, most, numbers)


_compiled_travel_share = compiled(Limits.stage_share_of)


@compiled
def _largest(
    limits: Limits, name: str, low: Number, high: Number, numbers: dict[str, Number]
) -> Array:
    def use(value: Array, parameters: tuple[Limits, dict[str, Number]]) -> Array:
        limits, numbers = parameters
        return limits.stage_share(**{**numbers, name: value})

    return largest_within_one(low, high, (limits, numbers), function=use)


@eqx.filter_custom_jvp
def largest_within_one(
    low: Float[Array, ""],
    high: Float[Array, ""],
    parameters: PyTree,
    *,
    function: Callable[[Float[Array, ""], PyTree], Float[Array, ""]],
) -> Float[Array, ""]:
    r"""Largest $x$ of an interval with $g(x, p) <= 1$; the lower end where there is none; scalar.

    It is bracketed by bisection. Between the ends $g(x, p) = 1$ makes it a function of $p$,

    $$\frac{dx}{dp} = -\frac{\partial g/\partial p}{\partial g/\partial x},$$

    and derivatives of any order follow, as the rule is made of functions that have them.
    """

    def halved(step: Array, ends: tuple[Array, Array]) -> tuple[Array, Array]:
        middle = jnp.where(step == 0, ends[1], (ends[0] + ends[1]) / 2)
        is_within = function(middle, parameters) <= 1
        return jnp.where(is_within, middle, ends[0]), jnp.where(is_within, ends[1], middle)

    # The first step tries the upper end; sixty halvings follow.
    return jax.lax.fori_loop(0, 61, halved, (low, high))[0]


@largest_within_one.def_jvp
def _largest_within_one_jvp(
    primals: tuple[Array, Array, PyTree],
    tangents: tuple[Array | None, Array | None, PyTree],
    *,
    function: Callable[[Array, PyTree], Array],
) -> tuple[Array, Array]:
    low, high, parameters = primals
    root = largest_within_one(low, high, parameters, function=function)
    _, slope = jax.jvp(lambda x: function(x, parameters), (root,), (jnp.ones_like(root),))
    _, change = eqx.filter_jvp(lambda p: function(root, p), (parameters,), tangents[2:])
    if change is None:  # the function does not depend on what the parameters' tangents move
        change = jnp.zeros_like(root)
    rises = slope > 0
    between = jnp.where(rises, -change / jnp.where(rises, slope, 1.0), 0.0)
    of_low, of_high = (jnp.zeros_like(root) if t is None else t for t in tangents[:2])
    at_end = jnp.where(root > low, of_high, of_low)
    return root, jnp.where((root > low) & (root < high), between, at_end)
