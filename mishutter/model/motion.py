"""Motions of the sensor while the shutter is open: paths of pieces of constant acceleration.

A parabola, and a pan or a camera at rest without acceleration, are paths of one piece. All members
of a motion are written once, for pieces. The few that a single piece evaluates from its vertex, or
in closed form, ask for the number of pieces, never for a class.

"The paper" is "Improved motion invariant imaging with time varying shutter functions".
"""

import operator
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import fields, replace
from fractions import Fraction
from functools import lru_cache
from typing import Any, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Shaped

from mishutter._core.checks import (
    Numbers,
    RowLike,
    all_concrete,
    as_float,
    as_numpy,
    common_dtype,
    is_concrete,
    namespace_of,
    require,
    require_finite,
    require_number,
    require_positive_int,
    shape_of,
)
from mishutter._core.modules import AbstractModule
from mishutter._core.slopes import largest_of, magnitude, safe_sqrt
from mishutter.model.alignment import (
    PathPieces,
    above_alignment,
    length_on_parabola,
    turns,
)

Positions = Array | np.ndarray | np.floating
"""Numbers of NumPy where all are known and the caller's are of NumPy; of JAX elsewhere."""


class FixedParts(NamedTuple):
    """Parts of a motion that a search may not move, and the request of an error to leave them."""

    names: set[str]
    request: str


class AbstractMotion(AbstractModule):
    r"""A sensor on a path $x(t)$, $t \in [-T, T]$, which counts from mid-exposure.

    $x(t) = v t + 2\int_0^t (t - t')\,a(t')\,dt'$, where $a(t)$ is constant on each piece of the
    exposure and $v$ is the velocity at mid-exposure, by which the sensor pans. A point that moves
    at speed $s$ then passes over the sensor along $x(t) - s t$: panning shifts every speed, and
    changes nothing else. Outside of the exposure the sensor accelerates as at its end.

    A class holds numbers and says what pieces they make. Many paths of one piece may be stacked:
    numbers of the whole path then have the shape of the stack.
    """

    half_exposure: eqx.AbstractVar[Array]
    velocity: eqx.AbstractVar[Array]

    @property
    @abstractmethod
    def piece_ends(self) -> tuple[Fraction, ...]:
        r"""Ends of the pieces, all of which have a length; $\tau$ from -1 to 1."""

    @property
    @abstractmethod
    def piece_accelerations(self) -> Numbers:
        """$a$ of each piece, half its mechanical acceleration; px/s^2, shape `(..., K)`."""

    def __check_init__(self) -> None:
        name = type(self).__name__
        _check_half_exposure(f"{name}(half_exposure=...)", self.half_exposure)
        require_number(f"{name}(velocity=...)", self.velocity)

    def __repr__(self) -> str:
        """The numbers, of which a module shows no more than their type."""
        parts = []
        for field in fields(self):
            value = getattr(self, field.name)
            is_row = getattr(value, "ndim", 0) > 0 and is_concrete(value)
            parts.append(f"{field.name}={value.tolist() if is_row else value}")
        return f"{type(self).__name__}({', '.join(parts)})"

    @property
    def accelerates_constantly(self) -> bool:
        """Whether the path has one piece, which is a parabola or straight."""
        return len(self.piece_ends) == 2

    @property
    def is_straight(self) -> bool:
        """Whether the path is known to be straight, but for a sag too small to matter."""
        return any(is_known_zero(sign) for sign in (self.bend, self.has_vertex))

    @property
    def has_vertex(self) -> Array | np.ndarray | np.bool_:
        """Whether the path bends, so that objects are aligned by it; by NumPy if concrete.

        On a sensor without a sag to speak of they are aligned at mid-exposure. That of several
        pieces is the sag of a parabola that accelerates as much in the mean over the exposure.
        """
        numbers = self.bend, self.half_exposure
        a, half = (np.asarray(x) if is_concrete(x) else x for x in numbers)
        with np.errstate(over="ignore"):
            return turns(a * half * half)

    @property
    def fixed(self) -> FixedParts:
        """Parts that a search leaves as they are: of a straight path that it is straight."""
        if self.is_straight and is_known_zero(self.velocity):
            return FixedParts({"acceleration", "velocity"}, "leave a still camera at rest")
        if self.is_straight:
            return FixedParts({"acceleration"}, "leave a pan its constant velocity")
        if self.accelerates_constantly:
            return FixedParts(set(), "move")
        names = {"half_exposure", "acceleration", "velocity"}
        return FixedParts(names, "leave a free path as it is")

    @property
    def mirrors(self) -> bool:
        """Whether the path beside its pan is known to be the same forwards and backwards."""
        ends, (a,) = self.piece_ends, as_numpy(self.piece_accelerations)
        if self.accelerates_constantly or not is_concrete(a):
            return self.accelerates_constantly
        return ends == tuple(-end for end in reversed(ends)) and np.array_equal(a, a[::-1])

    def panned(self, velocity: ArrayLike) -> "AbstractMotion":
        """The motion at another velocity at mid-exposure, px/s."""
        return replace(self, velocity=velocity)

    def without_velocity(self) -> "AbstractMotion":
        """The motion in a frame that pans with it."""
        return self.panned(0.0)

    def mirrored(self, sign: ArrayLike) -> "AbstractMotion":
        """The motion, or its mirror image where a sign is -1 rather than 1."""
        scaled = jax.tree.map(lambda number: number * sign, self)
        return replace(scaled, half_exposure=self.half_exposure)

    @property
    def exposure(self) -> Float[Array, "..."]:
        """Time from first to last light, $2T$; s."""
        return _number(lambda half: 2 * half, self.half_exposure)

    @property
    def mean_acceleration(self) -> Float[Array, "..."]:
        """Mean of $a$ of the pieces, however long each of them is; px/s^2."""
        return _number(lambda a: a.mean(axis=-1), self.piece_accelerations)

    @property
    def bend(self) -> Float[Array, "..."]:
        r"""Mean of $|a(t)|$ over the exposure; px/s^2."""
        shares = (np.diff(self._ends) / 2).astype(self.piece_accelerations.dtype)
        return _number(lambda a: (magnitude(a) * shares).sum(axis=-1), self.piece_accelerations)

    @property
    def turn(self) -> Positions:
        """-1 of a path that loses velocity from end to end, by more than rounding; else 1."""
        (a,) = as_numpy(self.piece_accelerations)
        gained = a * np.diff(self._ends).astype(a.dtype)
        loses = gained.sum(axis=-1) < -1e-6 * abs(gained).sum(axis=-1)
        return namespace_of(a).where(loses, -1.0, 1.0).astype(a.dtype)

    @property
    def greatest_acceleration(self) -> Float[Array, "..."]:
        """Greatest rate at which the velocity changes, twice that of $|a|$; px/s^2."""
        return _number(lambda a: 2 * largest_of(magnitude(a)), self.piece_accelerations)

    @property
    def sag(self) -> Float[Array, "..."]:
        r"""Distance beside the pan, $\max_t - \min_t$ of $x(t) - v t$; px, $aT^2$ of a parabola."""
        return _number(self._travel, self.velocity)

    @property
    def stroke(self) -> Float[Array, "..."]:
        r"""Distance with the pan, $\max_t x(t) - \min_t x(t)$; px."""
        return _number(self._travel, np.zeros((), self.half_exposure.dtype))

    @property
    def speed_gain(self) -> Float[Array, "..."]:
        r"""Greatest speed gained or lost from mid-exposure, $\max_t |x'(t) - v|$; px/s."""
        return _number(lambda gains: largest_of(magnitude(gains)), self._gains)

    @property
    def top_speed(self) -> Float[Array, "..."]:
        r"""Greatest speed of the sensor during the exposure, $\max_t |x'(t)|$; px/s."""
        return _number(lambda each: largest_of(magnitude(each)), self.end_velocities)

    @property
    def end_velocities(self) -> Positions:
        """Velocity where pieces begin and end; px/s, shape `(..., K + 1)`."""
        velocity, gains = _together(*as_numpy(self.velocity, self._gains))
        return velocity[..., None] + gains

    @property
    def _gains(self) -> Positions:
        """Velocity gained since mid-exposure where pieces begin and end; px/s, `(..., K + 1)`."""
        T, a = _together(*as_numpy(self.half_exposure, self.piece_accelerations))
        ends = self._ends.astype(a.dtype)
        each = ends.reshape((1,) * T.ndim + (-1,))
        return 2 * T[..., None] * _integrals(each, a[..., None, :], ends)[0]

    def position(self, time: RowLike) -> Positions:
        r"""Position of the sensor, from where it is at mid-exposure; px, shape of `time`.

        $v t + 2\int_0^t (t - t')\,a(t')\,dt'$, of one piece $v t + a t^2$.

        Args:
            time: Time from mid-exposure, s; any shape. A NumPy array gives one, where the motion is
                known.
        """
        return self.position_of(self._shares(time), 0.0)

    def velocity_at(self, time: RowLike) -> Positions:
        r"""Velocity of the sensor, $v + 2\int_0^t a(t')\,dt'$; px/s, shape of `time`.

        Args:
            time: Times from mid-exposure, as in `position`; s.
        """
        tau, v, a, T = _together(
            self._shares(time), self.velocity, self.piece_accelerations, self.half_exposure
        )
        return v + 2 * T * _integrals(tau, a, self._ends)[0]

    def position_of(self, tau: RowLike, speed: RowLike) -> Positions:
        r"""Position on the sensor of objects, $x(\tau T) - s\tau T$, from that at mid-exposure; px.

        Times and speeds broadcast. Derivatives by $T$ take $\tau$ for fixed.
        """
        tau, s, v, a, T = _together(
            tau, speed, self.velocity, self.piece_accelerations, self.half_exposure
        )
        _, risen = _integrals(tau, a, self._ends)
        return (risen * T) * T - ((s - v) * T) * tau

    def aligned_position(self, tau: RowLike, speed: RowLike) -> Any:
        """The `position_of` objects, from where they are aligned; px.

        On one piece it is measured from the vertex, so that it has all digits there.
        """
        tau, s = _together(tau, speed)
        if not self.accelerates_constantly:
            return self.position_of(tau, s) - self.alignment(s)
        sag, smear = self._sag_and_smear(s)
        space = namespace_of(tau, sag, smear)
        return space.where(turns(abs(sag)), above_alignment(sag, smear, tau), -smear * tau)

    def alignment(self, speed: RowLike) -> Positions:
        r"""Position on the sensor that objects of a speed are aligned at; px, shape of `speed`.

        It counts from where they are at mid-exposure. On a path that gains velocity over the
        exposure it is the lowest position that they reach, $\min_t x(t) - s t$: where the sensor
        keeps pace with the object, or the end of the exposure at which it all but does. On the
        mirror image of such a path it is the highest, and on a straight one 0. A NumPy array gives
        one, where the motion is known.

        Args:
            speed: Speed of the object; px/s.
        """
        bends, gains = self.has_vertex, self.turn > 0
        if all_concrete((bends, gains)):
            at_rest = self.lowest(speed) if gains else self.highest(speed)
            return at_rest if bends else 0 * at_rest
        at_rest = jnp.where(gains, self.lowest(speed), self.highest(speed))
        return jnp.where(bends, at_rest, jax.lax.stop_gradient(0 * at_rest))

    def lowest(self, speed: RowLike) -> Positions:
        r"""Lowest position of objects on the sensor, $\min_t x(t) - s t$; px, shape of `speed`."""
        return self.pieces_of(speed).lowest()[0]

    def highest(self, speed: RowLike) -> Positions:
        r"""Highest position of objects on the sensor, $\max_t x(t) - s t$; px, shape of `speed`."""
        return -self.pieces_of(speed).mirrored().lowest()[0]

    def kernel_length(self, speed: RowLike) -> Shaped[Array | np.ndarray, "..."]:
        r"""Length of the aligned kernel of objects; px, shape of `speed`, by NumPy if concrete.

        It is that of the direction of the speed that makes it longer: on one piece
        $aT^2 (1 + |\nu|)^2$ where the path turns within the exposure, $2|s|T$ elsewhere.
        """
        speed, v, *_ = _together(*as_numpy(speed, self.velocity, *jax.tree.leaves(self)))
        relative, space = speed - v, namespace_of(speed)
        with np.errstate(over="ignore", invalid="ignore"):
            both = map(space.asarray, (v + relative, v - relative))
            return space.asarray(space.maximum(*map(self._travel, both)))

    def greatest_travel(self, speeds: Float[np.ndarray, "speeds"]) -> Float[np.ndarray, "..."]:
        """Distance from the lowest to the highest position of objects, at the worst of some speeds.

        In px, of the shape of stacked motions of one piece; concrete.
        """
        axes = (-1,) + (1,) * self.half_exposure.ndim
        return np.asarray(np.max(np.asarray(self._travel(speeds.reshape(axes))), axis=0))

    def pieces_of(self, speed: RowLike) -> PathPieces:
        """The pieces of the paths of points over the sensor, on an axis after those of `speed`."""
        s, v, a, T = _together(speed, self.velocity, self.piece_accelerations, self.half_exposure)
        ends = self._ends.astype(s.dtype)
        base = np.clip(np.zeros((), ends.dtype), ends[:-1], ends[1:])
        smear, sag = ((s - v) * T)[..., None], (a * T) * T
        (gain, rise), (_, travel) = (_integrals(base, x, ends) for x in (sag, abs(sag)))
        rows = sag, gain, rise, travel, base, ends[:-1], ends[1:]
        sag, gain, rise, travel, base, begin, end = (_across(row, s.ndim) for row in rows)
        velocity, position = 2 * gain - smear, rise - smear * base
        travel = travel + abs(smear) * abs(base)
        return PathPieces(sag, velocity, position, base, begin, end, travel)

    def _travel(self, speed: RowLike) -> Positions:
        """Distance from the lowest to the highest position of objects; px."""
        if self.accelerates_constantly:
            return length_on_parabola(*self._sag_and_smear(speed))
        return self.highest(speed) - self.lowest(speed)

    def _sag_and_smear(self, speed: RowLike) -> tuple[Positions, Positions]:
        """The sag of one piece, and the travel of objects beside the pan in half the exposure."""
        s, v, a, T = _together(speed, self.velocity, self.piece_accelerations, self.half_exposure)
        space = namespace_of(s)
        return space.asarray((a[..., 0] * T) * T), space.asarray((s - v) * T)

    def _shares(self, time: RowLike) -> Positions:
        """Times in units of $T$."""
        return operator.truediv(*_together(time, self.half_exposure))

    @property
    def _ends(self) -> Float[np.ndarray, "ends"]:
        r"""Times at which pieces begin and end, $\tau$ from -1 to 1."""
        return np.array(self.piece_ends, float)


@final
class ParabolicMotion(AbstractMotion):
    r"""Constant acceleration: the motion-invariant camera, and without any a camera that pans.

    Equation (5) of the paper with a velocity $v$ at mid-exposure, $x(t) = v t + a t^2$. A point
    that moves at speed $s$ passes over the sensor along $x(t) = a t^2 - (s - v) t$. A search leaves
    an acceleration that is known to be 0 as it is: `LinearMotion` makes such a motion, and
    `StillCamera` one that stays at rest.

    Args:
        acceleration: The parameter $a$ of $x(t) = v t + a t^2$, half the mechanical
            acceleration; px/s^2, at least 0.
        half_exposure: $T$; s, above 0.
        velocity: $v$, that at mid-exposure; px/s, either sign.

    Raises:
        ValueError: if one is not a finite scalar, or out of its range.
    """

    acceleration: Array
    half_exposure: Array
    velocity: Array

    def __init__(
        self, *, acceleration: ArrayLike, half_exposure: ArrayLike, velocity: ArrayLike = 0.0
    ):
        half = as_float(half_exposure, "ParabolicMotion(half_exposure=...)")
        self.acceleration = _beside(half, acceleration, "ParabolicMotion(acceleration=...)")
        self.half_exposure = half
        self.velocity = _beside(half, velocity, "ParabolicMotion(velocity=...)")

    def __check_init__(self) -> None:
        subject = "ParabolicMotion(acceleration=...)"
        require_number(subject, self.acceleration, "at least 0 px/s^2")

    @classmethod
    def from_stroke(
        cls, stroke: ArrayLike, *, half_exposure: ArrayLike, velocity: ArrayLike = 0.0
    ) -> "ParabolicMotion":
        """The motion of a stroke; the fastest accelerated one where its pan alone takes that.

        Args:
            stroke: Distance from the lowest to the highest position, the pan included; px.
            half_exposure: $T$; s.
            velocity: $v$, that at mid-exposure; px/s.

        Raises:
            ValueError: if the pan alone, $2|v|T$, takes more, or a number is out of its range.
        """
        subject = "ParabolicMotion.from_stroke(stroke=...)"
        pan = cls(acceleration=0.0, half_exposure=half_exposure, velocity=velocity)
        length = _length(subject, stroke, pan.stroke, ", which the pan takes")
        a = _solved(acceleration_of_stroke, length, half_exposure, abs(pan.velocity))
        return cls(acceleration=a, half_exposure=half_exposure, velocity=velocity)

    @classmethod
    def from_sag(
        cls, sag: ArrayLike, *, half_exposure: ArrayLike, velocity: ArrayLike = 0.0
    ) -> "ParabolicMotion":
        """The motion of a sag, $aT^2$.

        Args:
            sag: Distance from mid-exposure to either end beside the pan; px, at least 0.
            half_exposure: $T$; s.
            velocity: $v$, that at mid-exposure; px/s.

        Raises:
            ValueError: if a number is out of its range.
        """
        pan = cls(acceleration=0.0, half_exposure=half_exposure, velocity=velocity)
        length = _length("ParabolicMotion.from_sag(sag=...)", sag, pan.sag, "")
        a = _solved(lambda sag, half: sag / half**2, length, half_exposure)
        return cls(acceleration=a, half_exposure=half_exposure, velocity=velocity)

    @property
    def piece_ends(self) -> tuple[Fraction, ...]:
        """The ends of the exposure."""
        return exact_ends(None, 1)

    @property
    def piece_accelerations(self) -> Numbers:
        """$a$ of the one piece; px/s^2."""
        (a,) = as_numpy(self.acceleration)
        return a[..., None]


@final
class FreeMotion(AbstractMotion):
    r"""A path of piecewise constant acceleration, without a jump in position or velocity.

    $x(t) = v t + 2\int_0^t (t - t')\,a(t')\,dt'$, where $a(t)$ is `accelerations[j]` on the
    $j$-th of $K$ pieces of $[-T, T]$. With all of them equal it is the path of a `ParabolicMotion`.

    Objects are aligned as on any path (`alignment`): of several turning points at the lowest, and
    on a path that loses velocity over the exposure at the highest.

    Args:
        accelerations: The parameter $a$ of each piece, half the mechanical acceleration; px/s^2,
            either sign, shape `(K,)`.
        half_exposure: $T$; s, above 0.
        velocity: $v$, that at mid-exposure; px/s, either sign.
        durations: How long the pieces are, on any scale; equally by default. They are at least 0,
            and known; shape `(K,)`.

    Raises:
        ValueError: if a value is not finite, of another shape, or out of its range, or the
            durations are all 0.
    """

    accelerations: Array
    half_exposure: Array
    velocity: Array
    durations: tuple[float, ...] | None = eqx.field(static=True)

    def __init__(
        self,
        *,
        accelerations: RowLike,
        half_exposure: ArrayLike,
        velocity: ArrayLike = 0.0,
        durations: RowLike | None = None,
    ):
        self.accelerations = as_float(accelerations, "FreeMotion(accelerations=...)")
        self.half_exposure = as_float(half_exposure, "FreeMotion(half_exposure=...)")
        self.velocity = _beside(self.half_exposure, velocity, "FreeMotion(velocity=...)")
        self.durations = None
        if durations is not None:
            subject, shape = "FreeMotion(durations=...)", shape_of(durations)
            require(np.ndim(durations) == 1, subject, "be one row", shape)  # type: ignore[arg-type]
            require_finite(subject, durations)
            self.durations = tuple(float(x) for x in np.asarray(durations))
            lasts = any(self.durations) and min(self.durations) >= 0
            require(lasts, subject, "be at least 0, and not all of them 0", self.durations)

    def __check_init__(self) -> None:
        subject, row = "FreeMotion(accelerations=...)", self.accelerations
        one_row = row.ndim == 1 and row.size >= 1
        require(one_row, subject, "be one row of at least one number", shape_of(row))
        require_finite(subject, row)
        if self.durations is not None:
            requirement = f"be as many as the {row.size} accelerations"
            got = len(self.durations)
            require(got == row.size, "FreeMotion(durations=...)", requirement, got)

    @classmethod
    def fit(cls, motion: AbstractMotion, *, num_pieces: int = 12) -> "FreeMotion":
        """The motion of equal pieces that has the velocity of another where pieces meet.

        That of a parabola, and of a path whose pieces meet nowhere else, is the same path.

        Args:
            motion: The motion to follow.
            num_pieces: Number of pieces $K$.

        Raises:
            ValueError: if `num_pieces` is not a positive integer.
        """
        count = require_positive_int("FreeMotion.fit(num_pieces=...)", num_pieces)
        is_motion = isinstance(motion, AbstractMotion)
        require(is_motion, "FreeMotion.fit(motion=...)", "be a motion", motion)
        T, v, a = _together(
            *as_numpy(motion.half_exposure, motion.velocity, motion.piece_accelerations)
        )
        ends, own = np.array(exact_ends(None, count), float), motion._ends
        begin = np.maximum(ends[:-1, None], own[None, :-1])
        end = np.minimum(ends[1:, None], own[None, 1:])
        # The share of each new piece that lies in each of the old ones.
        shares = (np.maximum(end - begin, 0) / np.diff(ends)[:, None]).astype(a.dtype)
        gains = 2 * T * _integrals(ends.astype(a.dtype), a, own)[0]
        # Mid-exposure may lie within a new piece, whose velocity is linear in time.
        pan = namespace_of(gains).interp(0.0, ends, gains)
        return cls(
            accelerations=(a[None] * shares).sum(axis=1),
            half_exposure=motion.half_exposure,
            velocity=v + pan.astype(v.dtype),
        )

    @property
    def piece_ends(self) -> tuple[Fraction, ...]:
        r"""Ends of the pieces that have a length, $\tau$ from -1 to 1."""
        return exact_ends(self.durations, self.accelerations.size)

    @property
    def piece_accelerations(self) -> Numbers:
        """$a$ of each piece that has a length; px/s^2."""
        durations = self.durations or ()
        lasting = np.flatnonzero(durations)
        return self.accelerations if lasting.size == len(durations) else self.accelerations[lasting]


def _integrals(
    tau: Numbers, accelerations: Numbers, ends: Float[np.ndarray, "ends"]
) -> tuple[Numbers, Numbers]:
    r"""$\int_0^\tau a(t)\,dt$ and $2\int_0^\tau (\tau - t)\,a(t)\,dt$ of pieces; shape of `tau`.

    The first and the last piece go on beyond their ends.
    """
    space, inner = namespace_of(tau), ends[1:-1]
    begin, end, base = (
        _across(row.astype(tau.dtype), tau.ndim)
        for row in (np.r_[-np.inf, inner], np.r_[inner, np.inf], np.clip(0.0, ends[:-1], ends[1:]))
    )
    tau, a = tau[..., None], accelerations
    a = _across(a, tau.ndim - 1) if a.ndim == 1 else a
    place = space.minimum(space.maximum(tau, begin), end)
    passed = a * (place - base)
    return passed.sum(axis=-1), (passed * (2 * tau - place - base)).sum(axis=-1)


def _across(row: Any, num_axes: int) -> Any:
    """A row of pieces as the last axis after some others."""
    return row.reshape((1,) * num_axes + (-1,))


@lru_cache
def exact_ends(durations: tuple[float, ...] | None, num_pieces: int) -> tuple[Fraction, ...]:
    r"""Ends of the pieces that have a length, $\tau$ from -1 to 1; equal ones by default."""
    passed = [Fraction(0)]
    for duration in durations or (1.0,) * num_pieces:
        passed.append(passed[-1] + Fraction(duration))
    return tuple(2 * time / passed[-1] - 1 for time in dict.fromkeys(passed))


def LinearMotion(*, half_exposure: ArrayLike, velocity: ArrayLike = 0.0) -> ParabolicMotion:
    """Constant velocity: a panning camera, which is a `ParabolicMotion` without acceleration.

    Args:
        half_exposure: $T$; s, above 0.
        velocity: $v$; px/s, either sign.

    Raises:
        ValueError: if one is not a finite scalar, or the exposure not positive.
    """
    half = as_float(half_exposure, "LinearMotion(half_exposure=...)")
    _check_half_exposure("LinearMotion(half_exposure=...)", half)
    pan = _beside(half, velocity, "LinearMotion(velocity=...)")
    require_number("LinearMotion(velocity=...)", pan)
    return ParabolicMotion(acceleration=0.0, half_exposure=half, velocity=pan)


def StillCamera(*, half_exposure: ArrayLike) -> ParabolicMotion:
    """A sensor at rest: a snapshot, or a flutter shutter, by the same integrals.

    Args:
        half_exposure: $T$; s, above 0.

    Raises:
        ValueError: if it is not a finite and positive scalar.
    """
    half = as_float(half_exposure, "StillCamera(half_exposure=...)")
    _check_half_exposure("StillCamera(half_exposure=...)", half)
    return ParabolicMotion(acceleration=0.0, half_exposure=half)


def acceleration_of_stroke(
    stroke: Positions, half_exposure: Positions, speed: ArrayLike
) -> Positions:
    r"""Largest $a$ of a parabola of a stroke, 0 where its pan alone takes more; px/s^2.

    It is the inverse of `ParabolicMotion.stroke`,
    $\left(\sqrt S + \sqrt{S - 2|v|T}\right)^2 / 4T^2$.
    """
    space, by_pan = namespace_of(half_exposure), speed * half_exposure
    room = stroke - 2 * by_pan
    sag = stroke - by_pan + safe_sqrt(stroke * space.maximum(room, 0))
    return space.where(room >= 0, sag, 0.0) / 2 / half_exposure / half_exposure


def _together(*values: RowLike) -> tuple[Array | np.ndarray, ...]:
    """Numbers as arrays of one kind: of NumPy where the first is and all are known."""
    if isinstance(values[0], np.ndarray) and all_concrete(values):
        return tuple(np.asarray(x, np.result_type(values[0], np.float32)) for x in values)
    dtype = common_dtype(*values)
    return tuple(jnp.asarray(x, dtype) for x in values)


def _number(formula: Callable[..., Positions], *numbers: Positions) -> Array:
    """Evaluates a formula by NumPy if all of its numbers are concrete."""
    with np.errstate(over="ignore", invalid="ignore"):
        return as_float(formula(*as_numpy(*numbers)))


def _solved(formula: Callable[..., Positions], *numbers: ArrayLike) -> Array:
    """A formula of numbers, in double precision where all of them are known."""
    dtype = common_dtype(*numbers)
    if all_concrete(numbers):
        return as_float(np.asarray(formula(*(np.asarray(x, np.float64) for x in numbers)), dtype))
    return jnp.asarray(formula(*(jnp.asarray(x, dtype) for x in numbers)))


def simplified(motion: AbstractMotion) -> AbstractMotion:
    """The motion as programs take it: without an acceleration where none to speak of is known."""
    require(isinstance(motion, AbstractMotion), "motion", "be a motion", motion)
    if not motion.is_straight:
        return motion
    if is_known_zero(motion.velocity):
        return StillCamera(half_exposure=motion.half_exposure)
    return LinearMotion(half_exposure=motion.half_exposure, velocity=motion.velocity)


def steady(motion: AbstractMotion) -> ParabolicMotion:
    """The parabola that a motion must be."""
    is_motion = isinstance(motion, AbstractMotion)
    is_steady = is_motion and motion.accelerates_constantly
    require(is_steady, "motion", "accelerate constantly", motion)
    return ParabolicMotion(
        acceleration=motion.mean_acceleration,
        half_exposure=motion.half_exposure,
        velocity=motion.velocity,
    )


def is_known_zero(value: ArrayLike) -> bool:
    """Whether a number, or all of an array, can be looked at and is 0."""
    return is_concrete(value) and not np.any(np.asarray(value))


def _beside(half_exposure: Array, value: ArrayLike, subject: str) -> Array:
    """A number; a Python 0, which stands for none, takes the precision of the exposure."""
    if isinstance(value, float | int) and value == 0:
        return as_float(np.zeros((), half_exposure.dtype))
    return as_float(value, subject)


def _check_half_exposure(subject: str, value: Array) -> None:
    require_number(subject, value, "above 0 s", strict=True)


def _length(subject: str, value: ArrayLike, least: Array, why: str) -> ArrayLike:
    """A length, px, that must not be less than another: an error, at run time if it is traced."""
    length = as_float(value, subject)
    require_number(subject, length)
    if not all_concrete((length, least)):
        message = f"`{subject}` must be no less than the least{why}."
        return eqx.error_if(length, length < least.astype(length.dtype), message)
    requirement = f"be at least {float(least):g} px{why}"
    require(float(length) >= float(least), subject, requirement, length)
    return value
