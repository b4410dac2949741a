r"""Paths of a stage from rest to the parabola of an exposure, and back to rest.

The sensor's own acceleration is $2a$ (px/s^2) on $x(t) = v t + a t^2$. At the ends of the exposure
its velocities are $u_0 = v - 2aT$ and $u_1 = v + 2aT$. Reached from rest at the greatest
acceleration $A$, the first takes $u_0^2/2A$ of travel, and a stop from the second $u_1^2/2A$.
Above the vertex the sensor is at $u^2/4a$, so that a path that turns within the exposure,
$|v| \le 2aT$, travels

$$(2aT + |v|)^2 \left(\frac1{4a} + \frac1{2A}\right)$$

in all: twice the sag, $2aT^2$, where $v = 0$ and $A = 2a$. One that does not turn travels
$2|v|T + (v^2 + (2aT)^2)/A$.

Where the jerk is at most $J$ the acceleration must rise to $2a$ before the exposure, over the time
$t_2 = 2a/J$, in which the velocity changes by $2a^2/J$: the sensor has $U_0 = u_0 - 2a^2/J$ without
any acceleration before that, and after the exposure $U_1 = u_1 + 2a^2/J$. To such a velocity from
rest, and from it, takes $t_1 = |U|/A + A/J$, or $2\sqrt{|U|/J}$ where $A$ is not reached
($|U| J < A^2$), and half as far as at $|U|$ throughout.
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int

from mishutter._core import require, require_finite, require_known, require_scalar
from mishutter.model.motion import AbstractMotion, FreeMotion, largest_of, safe_root
from mishutter.model.sequences import FrameSequence, TimedFrame


class StageUse(NamedTuple):
    """Travel and speed that an exposure asks of a stage that begins and ends at rest.

    Attributes:
        travel: From the lowest to the highest position; px.
        top_speed: Greatest speed, of the run-up and the run-out too; px/s.
    """

    travel: Float[Array, "..."]
    top_speed: Float[Array, "..."]


def stage_use(
    acceleration: ArrayLike,
    half_exposure: ArrayLike,
    velocity: ArrayLike,
    max_acceleration: ArrayLike | None = None,
    max_jerk: ArrayLike | None = None,
) -> StageUse:
    r"""Travel and top speed of $x(t) = v t + a t^2$, $t \in [-T, T]$, from rest to rest.

    Args:
        acceleration: $a$; px/s^2, any shape.
        half_exposure: $T$; s.
        velocity: $v$; px/s.
        max_acceleration: Greatest acceleration of the sensor, $A \ge 2a$; px/s^2. None for one
            that reaches any velocity at once.
        max_jerk: Greatest jerk, $J$; px/s^3. None for any.
    """
    a, half, v = (jnp.asarray(x) for x in (acceleration, half_exposure, velocity))
    v = jnp.abs(v)  # the path that is run backwards
    gain = 2 * a * half
    before, after = v - gain, v + gain
    begin, end = a * half * half - v * half, a * half * half + v * half
    vertex = -v * v / (4 * jnp.where(a > 0, a, 1.0))
    lowest = jnp.where(gain > 0, vertex, 0.0)
    if max_jerk is not None:
        ramp = 2 * a / max_jerk
        before, after = before - a * ramp, after + a * ramp
        # Along the ramp the velocity is the mean of its ends, but for a third of the ramp's own
        # share.
        aside = a * ramp * ramp / 3
        begin, end = begin - (before * ramp + aside), end + (after * ramp - aside)
        early = jnp.maximum(-before, 0)
        share = jnp.where(a > 0, a * ramp, 1.0)
        in_ramp = begin - (2 / 3) * early * ramp * safe_root(early / share)
        lowest = jnp.where(v <= gain, lowest, in_ramp)
    begin = begin + _stopping(-before, max_acceleration, max_jerk)
    end = end + _stopping(after, max_acceleration, max_jerk)
    turning = (before < 0) & (gain > 0)
    travel = jnp.where(turning, jnp.maximum(begin, end) - lowest, end - begin)
    return StageUse(travel, after)


def stage_use_of_path(path: FreeMotion, max_acceleration: ArrayLike | None = None) -> StageUse:
    """Travel and top speed of a free path, from rest to rest, as `stage_use` has them."""
    half = jnp.asarray(path.half_exposure)
    ends = jnp.stack([-half, half])
    outwards = jnp.asarray(path.velocity_at(ends)) * np.array([-1, 1], ends.dtype)
    rests = jnp.asarray(path.position(ends)) + _stopping(outwards, max_acceleration, None)
    at_rest = jnp.zeros_like(half)
    highest = jnp.maximum(largest_of(rests), jnp.asarray(path.highest(at_rest)))
    lowest = jnp.minimum(-largest_of(-rests), jnp.asarray(path.lowest(at_rest)))
    return StageUse(highest - lowest, path.top_speed)


def _stopping(
    velocity: Array, max_acceleration: ArrayLike | None, max_jerk: ArrayLike | None
) -> Array:
    """Displacement from a velocity to rest, without acceleration at either end; px."""
    speed = jnp.abs(velocity)
    if max_jerk is None:
        if max_acceleration is None:
            return jnp.zeros_like(velocity)
        return velocity * speed / (2 * max_acceleration)
    time = 2 * safe_root(speed / max_jerk)
    if max_acceleration is not None:
        full = speed * max_jerk >= jnp.square(max_acceleration)
        time = jnp.where(full, speed / max_acceleration + max_acceleration / max_jerk, time)
    return velocity * time / 2


class StagePath(NamedTuple):
    """A stage from rest through one exposure or more to rest: pieces of constant jerk.

    Attributes:
        times: Beginnings of the pieces and the end of the last, from mid-exposure, or the middle of
            a sequence of frames; s, `(n + 1,)`.
        positions: Positions there; px, `(n + 1,)`.
        velocities: Velocities there; px/s, `(n + 1,)`.
        accelerations: Accelerations at the beginnings of the pieces; px/s^2, `(n,)`.
        jerks: Jerks; px/s^3, `(n,)`.
        exposure: Beginning and end of the exposure, or of all; s.
    """

    times: Float[np.ndarray, "n+1"]
    positions: Float[np.ndarray, "n+1"]
    velocities: Float[np.ndarray, "n+1"]
    accelerations: Float[np.ndarray, "n"]
    jerks: Float[np.ndarray, "n"]
    exposure: tuple[float, float]

    @property
    def travel(self) -> float:
        """Distance from the lowest to the highest position, turning points included; px."""
        times = np.concatenate([self.times, *map(self._turns, range(self.jerks.size))])
        return float(np.ptp(self.at(times)[0]))

    def _turns(self, piece: int) -> np.ndarray:
        """Times within a piece at which the stage turns; s."""
        powers = self.jerks[piece] / 2, self.accelerations[piece], self.velocities[piece]
        roots = np.roots(powers)
        length = self.times[piece + 1] - self.times[piece]
        return self.times[piece] + np.clip(np.real(roots), 0, length)

    def at(
        self, times: Float[np.ndarray, "*times"]
    ) -> tuple[Float[np.ndarray, "*times"], Float[np.ndarray, "*times"]]:
        """Positions, px, and velocities, px/s, at some times, s, of any shape; at rest outside.

        Args:
            times: Times from mid-exposure; s.
        """
        piece = self._piece_at(times)
        elapsed = np.clip(times, self.times[0], self.times[-1]) - self.times[piece]
        start = self.positions[piece], self.velocities[piece], self.accelerations[piece]
        jerk = self.jerks[piece]
        position = start[0] + elapsed * (start[1] + elapsed * (start[2] / 2 + elapsed * (jerk / 6)))
        velocity = start[1] + elapsed * (start[2] + elapsed * (jerk / 2))
        rests = (times <= self.times[0]) | (times >= self.times[-1])
        return position, np.where(rests, 0.0, velocity)

    def _piece_at(self, times: Float[np.ndarray, "*times"]) -> Int[np.ndarray, "*times"]:
        """The piece that each time falls in: the first before the path, the last after it."""
        piece = np.searchsorted(self.times, times, side="right") - 1
        return np.clip(piece, 0, self.jerks.size - 1)

    def acceleration_at(self, times: Float[np.ndarray, "*times"]) -> Float[np.ndarray, "*times"]:
        """Accelerations, px/s^2, at some times, s, of any shape: where they jump, those after.

        Args:
            times: Times from mid-exposure; s.
        """
        piece = self._piece_at(times)
        acceleration = self.accelerations[piece] + self.jerks[piece] * (times - self.times[piece])
        rests = (times < self.times[0]) | (times >= self.times[-1])
        return np.where(rests, 0.0, acceleration)


def stage_path(
    motion: AbstractMotion,
    *,
    max_acceleration: ArrayLike | None = None,
    max_jerk: ArrayLike | None = None,
) -> StagePath:
    """The whole path of a stage: rest, run-up, exposure, run-out, rest.

    The run-up and the run-out reach the velocity, and with a `max_jerk` the acceleration, of the
    exposure's ends at the greatest acceleration; `mishutter.model.stages` derives them.

    Args:
        motion: Motion of the sensor over the exposure.
        max_acceleration: Greatest acceleration, at least the exposure's own $2a$; px/s^2. None for
            any, where the jerk is limited.
        max_jerk: Greatest jerk; px/s^3. None for any, as a free path needs.

    Raises:
        ValueError: if a limit is not a finite scalar above 0, is exceeded within the exposure, or
            both are None, or there is no motion, or JAX traces anything.
    """
    is_motion = isinstance(motion, AbstractMotion)
    require(is_motion, "stage_path(motion=...)", "be a motion", motion)
    require_known("stage_path", motion=motion, limits=(max_acceleration, max_jerk))
    subject = "stage_path(max_acceleration=...)"
    limited = max_acceleration is not None or max_jerk is not None
    require(limited, subject, "be given where the jerk is not limited", max_acceleration)
    most = np.inf if max_acceleration is None else _above_zero(subject, max_acceleration)
    jerk = None if max_jerk is None else _above_zero("stage_path(max_jerk=...)", max_jerk)
    half, own = float(motion.half_exposure), float(motion.greatest_acceleration)
    requirement = f"be at least the {own:g} px/s^2 of the exposure"
    require(most >= own * (1 - 1e-9), subject, requirement, most)
    ends = np.array([-half, half])
    begin, end = (float(x) for x in np.asarray(motion.velocity_at(ends)))
    is_smooth = jerk is None or motion.accelerates_constantly
    requirement = "be left out for a free path, whose acceleration jumps between pieces"
    require(is_smooth, "stage_path(max_jerk=...)", requirement, max_jerk)
    exposure = [(length, rate, 0.0) for length, rate in zip(*motion.phases, strict=True)]
    ramp = 0.0 if jerk is None else own / jerk
    begin, end = begin - own / 2 * ramp, end + own / 2 * ramp
    rise = [(ramp, 0.0, jerk)] if jerk is not None and ramp else []
    fall = [(ramp, own, -jerk)] if jerk is not None and ramp else []
    before = [*_between_rest_and(begin, most, jerk), *rise]
    pieces = [*before, *exposure, *fall, *_between_rest_and(-end, most, jerk)]
    place = float(np.asarray(motion.position(ends))[0])
    return _joined(pieces, len(before), place, (-half, half))


def stage_path_of_frames(
    sequence: FrameSequence, *, max_acceleration: ArrayLike | None = None
) -> StagePath | None:
    r"""The whole path of a stage over a sequence of frames: rest, run-up, frames, run-out, rest.

    From the end of a frame at the place $p$ and the velocity $v$ to the beginning of the next, at
    $q$ and $u$ after the time $g$, the stage takes the least acceleration that leads there: $A$ and
    then $-A$, with $A^2 g^2 - 4dA - (u - v)^2 = 0$ and $d = q - p - g(u + v)/2$. From a frame at
    rest it starts as late as a constant acceleration lets it.

    Args:
        sequence: The frames.
        max_acceleration: Greatest acceleration of the run-up and the run-out; px/s^2. None for the
            greatest of the rest of the path.

    Returns:
        The path; None where the stage stays at rest. None also where `max_acceleration` is missing
        and needed: the frames do not say how fast a stage reaches a velocity that it keeps, or
        starts from rest between two of them.

    Raises:
        ValueError: if `max_acceleration` is not a finite scalar above 0.
    """
    subject = "stage_path_of_frames(max_acceleration=...)"
    frames = [(frame.time, *_of_stage(frame, sequence.pan)) for frame in sequence.frames]
    pieces: list[_Piece] = []
    ends: tuple[float, float, float] | None = None
    for time, motion, place in frames:
        half = float(motion.half_exposure)
        sides = np.array([-half, half])
        places, velocities = (np.asarray(f(sides)) for f in (motion.position, motion.velocity_at))
        begin, end = zip(time + sides, place + places, velocities, strict=True)
        if ends is not None:
            pieces += _between(ends, begin)
        pieces += [(length, rate, 0.0) for length, rate in zip(*motion.phases, strict=True)]
        ends = end
    (first, motion, place), (last, last_motion, _) = frames[0], frames[-1]
    start, stop = -float(motion.half_exposure), float(last_motion.half_exposure)
    begin = float(motion.velocity_at(np.asarray(start)))
    end = float(last_motion.velocity_at(np.asarray(stop)))
    own = max(abs(rate) for _, rate, _ in pieces)
    most = own if max_acceleration is None else _above_zero(subject, max_acceleration)
    starts_between = sequence.moves and sequence.num_rests > 0
    if most == 0 or begin == own == 0 or (max_acceleration is None and starts_between):
        return None
    before, after = _between_rest_and(begin, most, None), _between_rest_and(-end, most, None)
    place += float(motion.position(np.asarray(start)))
    exposure = first + start, last + stop
    return _joined([*before, *pieces, *after], len(before), place, exposure)


def _of_stage(frame: TimedFrame, pan: float) -> tuple[AbstractMotion, float]:
    """The motion of the stage over a frame, and its place, beside a camera that turns."""
    motion = frame.motion.panned(frame.motion.velocity - pan) if pan else frame.motion
    return motion, frame.position - pan * frame.time


_Piece = tuple[float, float, float]
"""Duration, first acceleration and jerk of a piece of a path."""
_At = tuple[float, float, float]
"""Time, place and velocity of a stage."""
_ROUNDING = 1e-9
"""Share of a time, or of a velocity, below which it is one of rounding."""


def _between(start: _At, end: _At) -> list[_Piece]:
    """The pieces from the end of a frame to the beginning of the next."""
    (before, p, v), (after, q, u) = start, end
    time, gain = after - before, u - v
    if time <= _ROUNDING * max(abs(before), abs(after)):
        return []
    if v == 0 and u * (q - p) > 0 and 2 * (q - p) / u <= time:
        rise = 2 * (q - p) / u
        return [(time - rise, 0.0, 0.0), (rise, u / rise, 0.0)]
    aside = 2 * (q - p - time * (u + v) / 2)
    root = np.hypot(aside, time * gain)
    # The difference of two like numbers is avoided by the root of the sign of `aside`.
    rate = (aside + (root if aside >= 0 else -root)) / time**2
    if abs(rate) * time <= _ROUNDING * max(abs(u), abs(v)):
        return [(time, 0.0, 0.0)]
    first = np.clip((time + gain / rate) / 2, 0.0, time)
    return [(first, rate, 0.0), (time - first, -rate, 0.0)]


def _joined(
    pieces: list[_Piece], num_before: int, place: float, exposure: tuple[float, float]
) -> StagePath:
    """Pieces one after the other from rest, so many of them before the exposure at a place."""
    durations, accelerations, jerks = (np.array(x, float) for x in zip(*pieces, strict=True))
    gains = accelerations * durations + jerks * durations**2 / 2
    velocities = np.concatenate([[0.0], np.cumsum(gains)])
    each = durations * (velocities[:-1] + durations * (accelerations / 2 + durations * jerks / 6))
    positions, times = (np.concatenate([[0.0], np.cumsum(x)]) for x in (each, durations))
    times = times - times[num_before] + exposure[0]
    positions = positions - positions[num_before] + place
    velocities = np.append(velocities[:-1], 0.0)
    return StagePath(times, positions, velocities, accelerations, jerks, exposure)


def _above_zero(subject: str, value: ArrayLike) -> float:
    require_scalar(subject, value)
    require_finite(subject, value)
    number = float(np.asarray(value))
    require(number > 0, subject, "be above 0", value)
    return number


def _between_rest_and(change: float, most: float, jerk: float | None) -> list[_Piece]:
    """Pieces that change the velocity from rest, or to it; none for a change of 0."""
    sign, speed = np.sign(change), abs(change)
    if speed == 0:
        return []
    if jerk is None:
        return [(speed / most, sign * most, 0.0)]
    reached = min(most, float(np.sqrt(speed * jerk)))
    rise, hold = reached / jerk, max(speed / reached - reached / jerk, 0.0)
    held = [(hold, sign * reached, 0.0)] if hold else []
    return [(rise, 0.0, sign * jerk), *held, (rise, sign * reached, -sign * jerk)]
