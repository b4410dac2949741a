"""Motions of the sensor while the shutter is open.

"The paper" is "Improved motion invariant imaging with time varying shutter functions".
"""

import itertools
import operator
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import fields, replace
from fractions import Fraction
from functools import lru_cache
from typing import Any, ClassVar, NamedTuple, cast, final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float, Int, Shaped

from mishutter._core.checks import (
    RowLike,
    all_concrete,
    as_float,
    as_numpy,
    common_dtype,
    is_concrete,
    namespace_of,
    require,
    require_finite,
    require_positive_int,
    require_scalar,
    shape_of,
)
from mishutter._core.modules import AbstractModule
from mishutter.model.alignment import (
    Reach,
    above_alignment,
    length_on_parabola,
    lowest_on_parabola,
    reach_of_parabola,
    turns,
)

Positions = Array | np.ndarray | np.floating
"""Numbers of NumPy where all are known and the caller's are of NumPy; of JAX elsewhere."""


_BALANCED = 1e-6
"""Share of the velocity gained and lost beside which a path's ends are equally fast."""


class MotionNumbers(NamedTuple):
    """The numbers that tell motions of one kind apart."""

    acceleration: Array  # $a$, of a free path the mean of its pieces; px/s^2, scalar
    half_exposure: Array  # $T$; s, scalar
    velocity: Array  # $v$ at mid-exposure; px/s, scalar
    # Accelerations of the equal pieces of a free path, as multiples of their mean; shape `(K,)`.
    # None of other kinds
    pieces: Array | None = None


class Phases(NamedTuple):
    """Phases of constant acceleration, one after the other."""

    durations: Float[np.ndarray, "k"]  # Their durations; s
    accelerations: Float[np.ndarray, "k"]  # Mechanical accelerations, $2a$; px/s^2


class FixedParts(NamedTuple):
    """Parts of a motion that its kind fixes, and the request of an error to leave them so."""

    names: frozenset[str]
    request: str


_FIXED_OF_PAN = FixedParts(frozenset({"path", "acceleration"}), "leave a pan its constant velocity")
_FIXED_AT_REST = FixedParts(
    frozenset({"path", "acceleration", "velocity"}), "leave a still camera at rest"
)


class AbstractMotion(AbstractModule):
    r"""A sensor on a path $x(t)$, $t \in [-T, T]$, which counts from mid-exposure.

    $v$ is its velocity at mid-exposure, by which it pans. A point that moves at speed $s$ then
    passes over the sensor along $x(t) - s t$: panning shifts every speed, and changes nothing else.
    """

    half_exposure: eqx.AbstractVar[Array]
    velocity: eqx.AbstractVar[Array]
    accelerates_constantly: eqx.AbstractClassVar[bool]
    fixed_by_kind: eqx.AbstractClassVar[FixedParts]

    @property
    def is_straight(self) -> bool:
        """Whether the path is known to be straight, but for a sag too small to matter."""
        return any(is_known_zero(sign) for sign in (self.bend, self.has_vertex))

    @property
    def has_vertex(self) -> Array | np.ndarray | np.bool_:
        """Whether the path bends, so that objects are aligned by it; by NumPy if concrete.

        On a sensor without a sag to speak of they are aligned at mid-exposure. That of a free
        path is the sag of a parabola that accelerates as much in the mean over the exposure.
        """
        numbers = self.bend, self.half_exposure
        a, half = (np.asarray(x) if is_concrete(x) else x for x in numbers)
        with np.errstate(over="ignore"):
            return turns(a * half * half)

    @property
    def fixed(self) -> FixedParts:
        """Parts that a search leaves as they are: of a straight path that it is straight."""
        if not self.is_straight:
            return self.fixed_by_kind
        return _FIXED_AT_REST if is_known_zero(self.velocity) else _FIXED_OF_PAN

    def __repr__(self) -> str:
        """The numbers, of which a module shows no more than their type."""
        names = [field.name for field in fields(self)]
        numbers = (f"{name}={_shown(getattr(self, name))}" for name in names)
        return f"{type(self).__name__}({', '.join(numbers)})"

    @property
    def exposure(self) -> Float[Array, "..."]:
        """Time from first to last light, $2T$; s."""
        return _number(lambda half: 2 * half, self.half_exposure)

    @abstractmethod
    def position(self, time: RowLike) -> Positions:
        """Position of the sensor, from where it is at mid-exposure; px, shape of `time`.

        Args:
            time: Time from mid-exposure, s; any shape. Outside of the exposure the sensor
                accelerates as at its end. A NumPy array gives one, where the motion is known.
        """

    @abstractmethod
    def velocity_at(self, time: RowLike) -> Positions:
        """Velocity of the sensor; px/s, shape of `time`, which is as in `position`.

        Args:
            time: Times from mid-exposure; s.
        """

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
        return jnp.where(bends, jnp.where(gains, self.lowest(speed), self.highest(speed)), 0.0)

    @abstractmethod
    def is_at_vertex(self, speed: RowLike) -> Any:
        """Whether the origin of `blur_kernel` is where objects are aligned; shape of `speed`.

        Args:
            speed: Speed of the object; px/s.
        """

    @property
    @abstractmethod
    def turn(self) -> Positions:
        """-1 of a path that loses velocity over the exposure, and 1 of any other; scalar."""

    @abstractmethod
    def mirrored(self, sign: ArrayLike) -> "AbstractMotion":
        """The motion, or its mirror image where a sign is -1.

        Args:
            sign: 1 or -1; scalar.
        """

    @abstractmethod
    def lowest(self, speed: RowLike) -> Positions:
        r"""Lowest position of objects on the sensor, $\min_t x(t) - s t$; px, shape of `speed`.

        Args:
            speed: Speed of the object; px/s.
        """

    @abstractmethod
    def highest(self, speed: RowLike) -> Positions:
        r"""Highest position of objects on the sensor, $\max_t x(t) - s t$; px, shape of `speed`.

        Args:
            speed: Speed of the object; px/s.
        """

    @abstractmethod
    def position_of(self, tau: RowLike, speed: RowLike) -> Positions:
        r"""Position on the sensor of objects, from where they are at mid-exposure; px.

        Args:
            tau: Time from mid-exposure, in units of $T$; any shape.
            speed: Speeds, px/s; a shape that broadcasts with it.
        """

    @abstractmethod
    def aligned_position(self, tau: RowLike, speed: RowLike) -> Any:
        """The `position_of` objects, from where they are aligned.

        Args:
            tau: Normalised times, from -1 to 1.
            speed: Speed of the object; px/s.
        """

    @abstractmethod
    def reach(self, max_speed: float) -> Reach:
        """The travel of light from objects up to a speed; of a concrete motion.

        Args:
            max_speed: Greatest speed of an object; px/s.
        """

    @abstractmethod
    def with_numbers(self, numbers: MotionNumbers) -> "AbstractMotion":
        """The motion of this kind that has other numbers, but for those that the kind fixes.

        Args:
            numbers: Acceleration, half exposure, velocity and pieces.
        """

    @abstractmethod
    def panned(self, velocity: ArrayLike) -> "AbstractMotion":
        """The motion at another velocity.

        Args:
            velocity: Velocity at mid-exposure; px/s.
        """

    @abstractmethod
    def without_velocity(self) -> "AbstractMotion":
        """The motion in a frame that pans with it."""

    @abstractmethod
    def as_free_path(self) -> "FreeMotion":
        """The motion as a path of pieces."""

    @abstractmethod
    def acceleration_shares(self, num_pieces: int) -> Array:
        """Accelerations of equal pieces over their mean, those below 0 as 0; shape `(num_pieces,)`.

        Args:
            num_pieces: Number of pieces; those of a free path.
        """

    @abstractmethod
    def kernel_length(self, speed: RowLike) -> Shaped[Array | np.ndarray, "..."]:
        """Length of the aligned kernel of objects; px, shape of `speed`, by NumPy if concrete.

        Args:
            speed: Speed of the object; px/s.
        """

    @property
    @abstractmethod
    def path_numbers(self) -> dict[str, Any]:
        """Parameters of the path beside its exposure and velocity, as files hold them."""

    @property
    @abstractmethod
    def phases(self) -> "Phases":
        """The phases of the exposure in which the sensor accelerates constantly; concrete."""

    @property
    @abstractmethod
    def piece_ends(self) -> tuple[Fraction, ...]:
        r"""Ends of the pieces of a free path that have a length, $\tau$; none of other motions."""

    @property
    @abstractmethod
    def piece_accelerations(self) -> Array:
        """$a$ of each piece that has a length; px/s^2, shape `(K,)`."""

    @property
    @abstractmethod
    def mean_acceleration(self) -> Array:
        """$a$, of a free path the mean of its pieces; px/s^2."""

    @property
    @abstractmethod
    def mirrors(self) -> bool:
        """Whether the path beside its pan is known to be the same forwards and backwards."""

    @property
    @abstractmethod
    def bend(self) -> Float[Array | np.ndarray, "..."]:
        r"""Mean of $|a(t)|$ over the exposure; px/s^2."""

    @property
    @abstractmethod
    def sag(self) -> Float[Array, "..."]:
        """Distance from the lowest to the highest position beside the pan, $x(t) - v t$; px."""

    @property
    @abstractmethod
    def stroke(self) -> Float[Array, "..."]:
        """Distance from the lowest to the highest position of the sensor, its pan included; px."""

    @property
    @abstractmethod
    def speed_gain(self) -> Float[Array, "..."]:
        """Greatest speed that the sensor gains or loses from mid-exposure; px/s."""

    @property
    @abstractmethod
    def top_speed(self) -> Float[Array, "..."]:
        """Greatest speed of the sensor during the exposure; px/s."""

    @property
    @abstractmethod
    def greatest_acceleration(self) -> Float[Array, "..."]:
        """Greatest rate at which the velocity changes, twice the parameter $a$; px/s^2."""


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
    accelerates_constantly: ClassVar[bool] = True
    fixed_by_kind: ClassVar[FixedParts] = FixedParts(frozenset(), "move")

    def __init__(
        self, *, acceleration: ArrayLike, half_exposure: ArrayLike, velocity: ArrayLike = 0.0
    ):
        half = as_float(half_exposure, "ParabolicMotion(half_exposure=...)")
        self.acceleration = _beside(half, acceleration, "ParabolicMotion(acceleration=...)")
        self.half_exposure = half
        self.velocity = _beside(half, velocity, "ParabolicMotion(velocity=...)")

    def __check_init__(self) -> None:
        _check_acceleration(self.acceleration)
        _check_half_exposure("ParabolicMotion(half_exposure=...)", self.half_exposure)
        _check_velocity("ParabolicMotion(velocity=...)", self.velocity)

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

    def panned(self, velocity: ArrayLike) -> "ParabolicMotion":
        """The parabola at another velocity.

        Args:
            velocity: Velocity at mid-exposure; px/s.
        """
        return replace(self, velocity=velocity)

    def without_velocity(self) -> "ParabolicMotion":
        """The parabola in a frame that pans with it."""
        return self.panned(0.0)

    def with_numbers(self, numbers: MotionNumbers) -> "ParabolicMotion":
        """The parabola of other numbers.

        Args:
            numbers: Acceleration, half exposure, velocity and pieces.
        """
        acceleration, half_exposure, velocity, _ = numbers
        return ParabolicMotion(
            acceleration=acceleration, half_exposure=half_exposure, velocity=velocity
        )

    def as_free_path(self) -> "FreeMotion":
        """A `FreeMotion` on the same path."""
        return FreeMotion.fit(self)

    def kernel_length(self, speed: RowLike) -> Shaped[Array | np.ndarray, "..."]:
        r"""$aT^2 (1 + |\nu|)^2$ where the path turns within the exposure, $2|s|T$ elsewhere; px.

        Args:
            speed: Speed of the object; px/s.
        """
        (speed,) = as_numpy(speed)
        with np.errstate(over="ignore", invalid="ignore"):
            _, sag, smear = self._sag_and_smear(speed, speed)
            return namespace_of(sag).asarray(length_on_parabola(sag, smear))

    @property
    def path_numbers(self) -> dict[str, Any]:
        """The acceleration $a$; px/s^2."""
        return {"acceleration": float(self.acceleration)}

    @property
    def phases(self) -> Phases:
        """The whole exposure, over which the acceleration is one."""
        whole = 2 * float(self.half_exposure), float(self.greatest_acceleration)
        return Phases(*(np.array([x]) for x in whole))

    @property
    def piece_ends(self) -> tuple[Fraction, ...]:
        """No ends: the whole exposure is one parabola."""
        return ()

    @property
    def piece_accelerations(self) -> Array:
        """$a$ of the one piece; px/s^2."""
        return jnp.reshape(self.acceleration, 1)

    def acceleration_shares(self, num_pieces: int) -> Array:
        """Ones, of a path that accelerates alike everywhere.

        Args:
            num_pieces: Number of pieces.
        """
        return jnp.ones(num_pieces, self.half_exposure.dtype)

    @property
    def mean_acceleration(self) -> Array:
        """$a$; px/s^2."""
        return self.acceleration

    def position(self, time: RowLike) -> Positions:
        """$v t + a t^2$; px, shape of `time`.

        Args:
            time: Times from mid-exposure; s.
        """
        time, v, a = _together(time, self.velocity, self.acceleration)
        return (v + a * time) * time

    def velocity_at(self, time: RowLike) -> Positions:
        """$v + 2 a t$; px/s, shape of `time`.

        Args:
            time: Times from mid-exposure; s.
        """
        time, v, a = _together(time, self.velocity, self.acceleration)
        return v + 2 * a * time

    def is_at_vertex(self, speed: RowLike) -> Any:
        """Whether the sensor keeps pace with the object at a time of the exposure.

        Args:
            speed: Speed of the object; px/s.
        """
        _, sag, smear = self._sag_and_smear(speed, speed)
        return turns(sag) & (abs(smear) < 2 * sag)

    @property
    def turn(self) -> Positions:
        """The sign of the acceleration, which only a traced one has; 1 of a straight path."""
        (a,) = as_numpy(self.acceleration)
        return namespace_of(a).where(a < 0, -1.0, 1.0).astype(a.dtype)

    def mirrored(self, sign: ArrayLike) -> "ParabolicMotion":
        """The parabola, or its mirror image.

        Args:
            sign: 1 or -1; scalar.
        """
        return replace(self, acceleration=self.acceleration * sign, velocity=self.velocity * sign)

    def lowest(self, speed: RowLike) -> Positions:
        """The vertex, or the lower end where that lies beyond the exposure; px.

        Args:
            speed: Speed of the object; px/s.
        """
        _, sag, smear = self._sag_and_smear(speed, speed)
        return lowest_on_parabola(sag, smear)

    def highest(self, speed: RowLike) -> Positions:
        """The higher end, or the vertex of a mirrored path; px.

        Args:
            speed: Speed of the object; px/s.
        """
        _, sag, smear = self._sag_and_smear(speed, speed)
        return -lowest_on_parabola(-sag, smear)

    def position_of(self, tau: RowLike, speed: RowLike) -> Positions:
        r"""$aT^2\tau^2 - (s - v)T\tau$; px.

        Args:
            tau: Normalised times, from -1 to 1.
            speed: Speed of the object; px/s.
        """
        tau, sag, smear = self._sag_and_smear(tau, speed)
        return tau * (sag * tau - smear)

    def aligned_position(self, tau: RowLike, speed: RowLike) -> Any:
        r"""The `position_of` objects, from where they are aligned; px.

        Args:
            tau: Normalised times, from -1 to 1.
            speed: Speed of the object; px/s.
        """
        times, sag, smear = self._sag_and_smear(tau, speed)
        space = namespace_of(times)
        return space.where(turns(abs(sag)), above_alignment(sag, smear, times), -smear * times)

    def reach(self, max_speed: float) -> Reach:
        """The `reach_of_parabola`.

        Args:
            max_speed: Greatest speed of an object; px/s.
        """
        _, sag, smear = self._sag_and_smear(np.asarray(max_speed), max_speed)
        return reach_of_parabola(sag, smear)

    def _sag_and_smear(self, tau: RowLike, speed: RowLike) -> tuple[Any, Any, Any]:
        """Times, the sag, and travel in half the exposure, as arrays of one kind."""
        tau, s, v, a, T = _together(
            tau, speed, self.velocity, self.acceleration, self.half_exposure
        )
        space = namespace_of(tau)
        return tau, space.asarray((a * T) * T), space.asarray((s - v) * T)

    @property
    def mirrors(self) -> bool:
        """A parabola is its own mirror image."""
        return True

    @property
    def bend(self) -> Float[Array | np.ndarray, "..."]:
        """$|a|$; px/s^2."""
        return _number(_size, self.acceleration)

    @property
    def sag(self) -> Float[Array, "..."]:
        """Distance from mid-exposure to either end beside the pan, $aT^2$; px."""
        return _number(lambda a, half: (a * half) * half, self.bend, self.half_exposure)

    @property
    def stroke(self) -> Float[Array, "..."]:
        """`stroke_of_parabola`; px."""
        return _number(stroke_of_parabola, self.bend, self.half_exposure, self.velocity)

    @property
    def speed_gain(self) -> Float[Array, "..."]:
        """Speed gained from mid-exposure to either end, $2aT$; px/s."""
        return _number(lambda a, half: 2 * a * half, self.bend, self.half_exposure)

    @property
    def top_speed(self) -> Float[Array, "..."]:
        """Greatest speed of the sensor during the exposure, $2aT + |v|$; px/s."""
        return _number(lambda gain, v: gain + abs(v), self.speed_gain, self.velocity)

    @property
    def greatest_acceleration(self) -> Float[Array, "..."]:
        """Rate at which the velocity changes, $2a$; px/s^2."""
        return _number(lambda a: 2 * a, self.bend)


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
    accelerates_constantly: ClassVar[bool] = False
    fixed_by_kind: ClassVar[FixedParts] = FixedParts(
        frozenset({"half_exposure", "acceleration", "velocity"}),
        "name path, or leave a free path as it is",
    )

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
        self.durations = None if durations is None else _as_durations(durations)

    def __check_init__(self) -> None:
        subject, row = "FreeMotion(accelerations=...)", self.accelerations
        one_row = row.ndim == 1 and row.size >= 1
        require(one_row, subject, "be one row of at least one number", shape_of(row))
        require_finite(subject, row)
        _check_half_exposure("FreeMotion(half_exposure=...)", self.half_exposure)
        _check_velocity("FreeMotion(velocity=...)", self.velocity)
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
        if isinstance(motion, ParabolicMotion):
            return cls(
                accelerations=_number(lambda a: a * np.ones(count, a.dtype), motion.acceleration),
                half_exposure=motion.half_exposure,
                velocity=motion.velocity,
            )
        half = motion.half_exposure
        ends = np.array(exact_ends(None, count), float).astype(half.dtype)
        velocity = jnp.asarray(motion.velocity_at(ends * as_numpy(half)[0]))
        pan = jnp.interp(jnp.zeros_like(half), ends, velocity)
        rates = jnp.diff(velocity) / (np.diff(ends) * (2 * half))
        return cls(accelerations=rates, half_exposure=half, velocity=pan)

    def panned(self, velocity: ArrayLike) -> "FreeMotion":
        """The path at another velocity.

        Args:
            velocity: Velocity at mid-exposure; px/s.
        """
        return replace(self, velocity=velocity)

    def without_velocity(self) -> "FreeMotion":
        """The path in a frame that pans with it."""
        return self.panned(0.0)

    def with_numbers(self, numbers: MotionNumbers) -> "FreeMotion":
        """The path of equal pieces of other numbers.

        Args:
            numbers: Acceleration, half exposure, velocity and pieces.
        """
        acceleration, half_exposure, velocity, pieces = numbers
        return FreeMotion(
            accelerations=acceleration * (1.0 if pieces is None else pieces),
            half_exposure=half_exposure,
            velocity=velocity,
        )

    def as_free_path(self) -> "FreeMotion":
        """The path itself."""
        return self

    def kernel_length(self, speed: RowLike) -> Shaped[Array | np.ndarray, "..."]:
        """Distance from the lowest position to the highest; px.

        It is that of the direction of the speed that makes it longer.

        Args:
            speed: Speed of the object; px/s.
        """
        speed, v, *_ = as_numpy(speed, self.velocity, self.half_exposure, self.accelerations)
        space = namespace_of(speed)
        with np.errstate(over="ignore", invalid="ignore"):
            relative = space.asarray(speed) - v
            both = map(space.asarray, (v + relative, v - relative))
            return space.asarray(space.maximum(*(self.highest(s) - self.lowest(s) for s in both)))

    @property
    def path_numbers(self) -> dict[str, Any]:
        """Accelerations and durations of the pieces."""
        durations = self.durations and list(self.durations)
        return {"accelerations": self.accelerations.tolist(), "durations": durations}

    @property
    def phases(self) -> Phases:
        """The pieces that take time."""
        rates = 2 * np.asarray(self.accelerations, float)
        lengths = float(self.half_exposure) * np.diff(self._ends)
        return Phases(lengths[self.lasting], rates[self.lasting])

    @property
    def piece_ends(self) -> tuple[Fraction, ...]:
        r"""Ends of the pieces that have a length, $\tau$ from -1 to 1."""
        return tuple(dict.fromkeys(exact_ends(self.durations, self.accelerations.size)))

    @property
    def piece_accelerations(self) -> Array:
        """$a$ of each piece that has a length; px/s^2."""
        return self.accelerations[self.lasting]

    def acceleration_shares(self, num_pieces: int) -> Array:
        """Accelerations over their mean, those below 0 as 0; shape `(K,)`.

        Args:
            num_pieces: Number of pieces, $K$.
        """
        shares = jnp.maximum(self.accelerations, 0)
        return shares / jnp.where(jnp.any(shares > 0), jnp.mean(shares), 1.0)

    @property
    def mean_acceleration(self) -> Array:
        """Mean of the pieces, however long each of them is; px/s^2."""
        return jnp.mean(self.accelerations)

    def position(self, time: RowLike) -> Positions:
        r"""$v t + 2\int_0^t (t - t')\,a(t')\,dt'$; px, shape of `time`.

        Args:
            time: Times from mid-exposure; s.
        """
        return self.position_at(self._shares(time))

    def position_at(self, tau: RowLike) -> Positions:
        r"""`position` at $t = \tau T$; derivatives by $T$ take $\tau$ for fixed.

        Args:
            tau: Normalised times, from -1 to 1.
        """
        tau, v, a, T = _together(tau, self.velocity, self.accelerations, self.half_exposure)
        begin, end = self._passed(tau)
        passed = (end - begin) * abs(2 * tau[..., None] - begin - end)
        return (v * tau + _of_pieces(a, passed) * T) * T

    def position_of(self, tau: RowLike, speed: RowLike) -> Positions:
        r"""$x(\tau T) - s\tau T$; px.

        Args:
            tau: Normalised times, from -1 to 1.
            speed: Speed of the object; px/s.
        """
        tau, s, T = _together(tau, speed, self.half_exposure)
        return self.position_at(tau) - (s * T) * tau

    def aligned_position(self, tau: RowLike, speed: RowLike) -> Any:
        """The `position_of` objects, from where they are aligned; px.

        Args:
            tau: Normalised times, from -1 to 1.
            speed: Speed of the object; px/s.
        """
        tau, s = _together(tau, speed)
        return self.position_of(tau, s) - self.alignment(s)

    def reach(self, max_speed: float) -> Reach:
        """The distance between the lowest and the highest position of objects in either direction.

        Args:
            max_speed: Greatest speed of an object; px/s.
        """
        half, fastest = np.asarray(self.half_exposure, np.float64), float(max_speed)
        speeds = np.array([-fastest, 0.0, fastest])
        length = np.max(self.highest(speeds) - self.lowest(speeds))
        velocity = (float(self.speed_gain) + fastest) * half
        return Reach(np.maximum(length, 2 * fastest * half), velocity)

    def velocity_at(self, time: RowLike) -> Positions:
        r"""$v + 2\int_0^t a(t')\,dt'$; px/s, shape of `time`.

        Args:
            time: Times from mid-exposure; s.
        """
        return self._velocity_at(self._shares(time))

    def _velocity_at(self, tau: RowLike) -> Positions:
        tau, v, a, T = _together(tau, self.velocity, self.accelerations, self.half_exposure)
        space = namespace_of(tau)
        begin, end = self._passed(tau)
        passed = space.sign(tau)[..., None] * (end - begin)
        return v + 2 * T * _of_pieces(a, passed)

    def _shares(self, time: RowLike) -> Positions:
        """Times in units of $T$."""
        return operator.truediv(*_together(time, self.half_exposure))

    def _passed(self, tau: Positions) -> tuple[Positions, Positions]:
        r"""Between which times, in units of $T$, each piece is passed from 0 to `tau`."""
        space = namespace_of(tau)
        ends = self._ends
        ends[[0, -1]] = -np.inf, np.inf
        row = ends.astype(tau.dtype).reshape((1,) * tau.ndim + (-1,))
        first, last = space.minimum(tau, 0)[..., None], space.maximum(tau, 0)[..., None]
        places = space.minimum(space.maximum(row, first), last)
        return places[..., :-1], places[..., 1:]

    def is_at_vertex(self, speed: RowLike) -> Any:
        """Whether the path bends: kernels of free paths count from the lowest position.

        Args:
            speed: Speed of the object; px/s.
        """
        return self.has_vertex

    @property
    def turn(self) -> Positions:
        """-1 of a path that loses velocity from end to end, by more than rounding; else 1."""
        (a,) = as_numpy(self.accelerations)
        gained = a * np.diff(self._ends).astype(a.dtype)
        loses = gained.sum() < -_BALANCED * abs(gained).sum()
        return namespace_of(a).where(loses, -1.0, 1.0).astype(a.dtype)

    def mirrored(self, sign: ArrayLike) -> "FreeMotion":
        """The path, or its mirror image.

        Args:
            sign: 1 or -1; scalar.
        """
        accelerations, velocity = self.accelerations * sign, self.velocity * sign
        return replace(self, accelerations=accelerations, velocity=velocity)

    def lowest(self, speed: RowLike) -> Positions:
        r"""Lowest position of objects on the sensor, $\min_t x(t) - s t$; px, shape of `speed`.

        Args:
            speed: Speed of the object; px/s.
        """
        return self._extreme(speed, 1.0)

    def highest(self, speed: RowLike) -> Positions:
        r"""Highest position of objects on the sensor, $\max_t x(t) - s t$; px, shape of `speed`.

        Args:
            speed: Speed of the object; px/s.
        """
        return -self._extreme(speed, -1.0)

    def _extreme(self, speed: RowLike, sign: float) -> Positions:
        """The lowest position on a path that is mirrored where `sign` is -1."""
        s, a, T, _ = _together(speed, self.accelerations, self.half_exposure, self.velocity)
        space = namespace_of(s)
        across = (1,) * s.ndim + (-1,)
        ends = self._ends.astype(s.dtype)
        x, u = (at(ends).reshape(across) for at in (self.position_at, self._velocity_at))
        times, a = (ends * T).reshape(across), a.reshape(across)
        position, velocity = sign * (x - s[..., None] * times), sign * (u - s[..., None])
        before, after, rate = velocity[..., :-1], velocity[..., 1:], sign * a
        turns = (before < 0) & (after > 0) & (rate > 0)
        rise = before * before / (4 * space.where(turns, rate, 1.0))
        turned = space.where(turns, position[..., :-1] - rise, position[..., :-1])
        positions = space.concatenate([turned, position[..., -1:]], axis=-1)
        lowest = space.argmin(positions, axis=-1, keepdims=True)
        return space.take_along_axis(positions, lowest, axis=-1)[..., 0]

    @property
    def sag(self) -> Float[Array, "..."]:
        r"""Distance beside the pan, $\max_t - \min_t$ of $x(t) - v t$; px."""
        (velocity,) = as_numpy(self.velocity)
        return _number(operator.sub, self.highest(velocity), self.lowest(velocity))

    @property
    def stroke(self) -> Float[Array, "..."]:
        r"""Distance with the pan, $\max_t x(t) - \min_t x(t)$; px."""
        rest = np.zeros((), self.half_exposure.dtype)
        return _number(operator.sub, self.highest(rest), self.lowest(rest))

    @property
    def speed_gain(self) -> Float[Array, "..."]:
        r"""Greatest speed gained or lost from mid-exposure, $\max_t |x'(t) - v|$; px/s."""
        return _number(lambda each, v: largest_of(abs(each - v)), self._velocities(), self.velocity)

    @property
    def top_speed(self) -> Float[Array, "..."]:
        r"""Greatest speed of the sensor during the exposure, $\max_t |x'(t)|$; px/s."""
        return _number(lambda each: largest_of(abs(each)), self._velocities())

    @property
    def greatest_acceleration(self) -> Float[Array, "..."]:
        """Greatest rate at which the velocity changes, twice that of $|a|$; px/s^2."""
        return _number(lambda a: 2 * largest_of(abs(a[self.lasting])), self.accelerations)

    @property
    def lasting(self) -> Int[np.ndarray, "k"]:
        """Indices of the pieces that take time; shape `(k,)`."""
        ends = exact_ends(self.durations, self.accelerations.size)
        return np.flatnonzero([after > before for before, after in itertools.pairwise(ends)])

    @property
    def bend(self) -> Float[Array | np.ndarray, "..."]:
        r"""Mean of $|a(t)|$ over the exposure; px/s^2."""
        shares = (np.diff(self._ends) / 2).astype(self.accelerations.dtype)
        return _number(lambda a: (abs(a) * shares).sum(), self.accelerations)

    @property
    def mirrors(self) -> bool:
        """Whether the path beside its pan is known to be the same forwards and backwards."""
        if not is_concrete(self.accelerations):
            return False
        a, lengths = np.asarray(self.accelerations)[self.lasting], self.durations
        lengths = None if lengths is None else np.array(lengths)[self.lasting]
        same = lengths is None or np.array_equal(lengths, lengths[::-1])
        return same and np.array_equal(a, a[::-1])

    @property
    def _ends(self) -> Float[np.ndarray, "ends"]:
        r"""Times at which pieces begin and end, $\tau$ from -1 to 1; shape `(K + 1,)`."""
        return np.array(exact_ends(self.durations, self.accelerations.size), float)

    def _velocities(self) -> Positions:
        """Velocity where pieces begin and end; px/s, shape `(K + 1,)`."""
        return self._velocity_at(self._ends.astype(self.half_exposure.dtype))


def _of_pieces(accelerations: Positions, passed: Positions) -> Positions:
    """Sum of accelerations times what has passed of each piece, on the last axis."""
    return (accelerations.reshape((1,) * (passed.ndim - 1) + (-1,)) * passed).sum(axis=-1)


@lru_cache
def exact_ends(durations: tuple[float, ...] | None, num_pieces: int) -> tuple[Fraction, ...]:
    r"""Ends of the pieces of a `FreeMotion`, $\tau$ from -1 to 1; shape `(K + 1,)`."""
    passed = [Fraction(0)]
    for duration in durations or (1.0,) * num_pieces:
        passed.append(passed[-1] + Fraction(duration))
    return tuple(2 * time / passed[-1] - 1 for time in passed)


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
    _check_velocity("LinearMotion(velocity=...)", pan)
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


def stroke_of_parabola(
    acceleration: Positions, half_exposure: Positions, velocity: Positions
) -> Positions:
    r"""Distance from the lowest to the highest of $v t + a t^2$, $|t| \le T$; px, any shape.

    $a\,(T + |v|/2a)^2$ where the path turns within the exposure, $|v| < 2aT$, and $2|v|T$ where
    it does not.
    """
    space, speed = namespace_of(acceleration, half_exposure, velocity), abs(velocity)
    turns_within = speed < 2 * acceleration * half_exposure
    a = space.where(turns_within, acceleration, 1.0)
    reach = half_exposure + speed / (2 * a)
    return space.where(turns_within, (a * reach) * reach, 2 * speed * half_exposure)


def acceleration_of_stroke(
    stroke: Positions, half_exposure: Positions, speed: ArrayLike
) -> Positions:
    r"""Largest $a$ of a parabola of a stroke, 0 where its pan alone takes more; px/s^2.

    It is the inverse of `stroke_of_parabola`,
    $\left(\sqrt S + \sqrt{S - 2|v|T}\right)^2 / 4T^2$.
    """
    space, by_pan = namespace_of(half_exposure), speed * half_exposure
    root = np.sqrt if isinstance(half_exposure, np.ndarray) else safe_root
    room = stroke - 2 * by_pan
    sag = stroke - by_pan + root(stroke * space.maximum(room, 0))
    return space.where(room >= 0, sag, 0.0) / 2 / half_exposure / half_exposure


def safe_root(square: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Square root whose derivative at 0 is 0."""
    positive = square > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1.0)), 0.0)


def _together(*values: RowLike) -> tuple[Array | np.ndarray, ...]:
    """Numbers as arrays of one kind: of NumPy where the first is and all are known."""
    if isinstance(values[0], np.ndarray) and all_concrete(values):
        return tuple(np.asarray(x, np.result_type(values[0], np.float32)) for x in values)
    dtype = common_dtype(*values)
    return tuple(jnp.asarray(x, dtype) for x in values)


def largest_of(values: Array | np.ndarray) -> Positions:
    """The largest of a row, by its index.

    The derivative of a maximum asks which values equal it: none does where the compiler computes
    them again and rounds otherwise, and the slope is then 0 / 0.
    """
    return values[values.argmax()]


def _size(value: Positions) -> Positions:
    """$|x|$, whose derivative at 0 is 1."""
    return namespace_of(value).where(value < 0, -value, value)


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
    """The motion as programs take it: without an acceleration where none to speak of is known.

    Raises:
        ValueError: if it is no motion, as that of a scene may be.
    """
    require(isinstance(motion, AbstractMotion), "motion", "be a motion", motion)
    if not motion.is_straight:
        return motion
    if is_known_zero(motion.velocity):
        return StillCamera(half_exposure=motion.half_exposure)
    return LinearMotion(half_exposure=motion.half_exposure, velocity=motion.velocity)


def steady(motion: AbstractMotion) -> ParabolicMotion:
    """A motion that must be of constant acceleration.

    Raises:
        ValueError: if it is not.
    """
    require(isinstance(motion, ParabolicMotion), "motion", "accelerate constantly", motion)
    return cast(ParabolicMotion, motion)


def is_known_zero(value: ArrayLike) -> bool:
    """Whether a number, or all of an array, can be looked at and is 0."""
    return is_concrete(value) and not np.any(np.asarray(value))


def _beside(half_exposure: Array, value: ArrayLike, subject: str) -> Array:
    """A number; a Python 0, which stands for none, takes the precision of the exposure."""
    if isinstance(value, float | int) and value == 0:
        return as_float(np.zeros((), half_exposure.dtype))
    return as_float(value, subject)


def _as_durations(durations: RowLike) -> tuple[float, ...]:
    subject = "FreeMotion(durations=...)"
    require(np.ndim(durations) == 1, subject, "be one row", shape_of(durations))  # type: ignore[arg-type]
    require_finite(subject, durations)
    row = tuple(float(x) for x in np.asarray(durations))
    lasts = any(row) and min(row) >= 0
    require(lasts, subject, "be at least 0, and not all of them 0", row)
    return row


def _shown(value: Any) -> object:
    return value.tolist() if getattr(value, "ndim", 0) and is_concrete(value) else value


def _check_acceleration(value: Array) -> None:
    subject = "ParabolicMotion(acceleration=...)"
    require_scalar(subject, value)
    require_finite(subject, value)
    if is_concrete(value):
        require(bool(np.all(np.asarray(value) >= 0)), subject, "be at least 0 px/s^2", value)


def _check_half_exposure(subject: str, value: Array) -> None:
    require_scalar(subject, value)
    require_finite(subject, value)
    if is_concrete(value):
        require(bool(np.all(np.asarray(value) > 0)), subject, "be above 0 s", value)


def _length(subject: str, value: ArrayLike, least: Array, why: str) -> ArrayLike:
    """A length, px, that must not be less than another: an error, at run time if it is traced."""
    length = as_float(value, subject)
    require_scalar(subject, length)
    require_finite(subject, length)
    if not all_concrete((length, least)):
        message = f"`{subject}` must be no less than the least{why}."
        return eqx.error_if(length, length < least.astype(length.dtype), message)
    requirement = f"be at least {float(least):g} px{why}"
    require(float(length) >= float(least), subject, requirement, length)
    return value


def _check_velocity(subject: str, value: Array) -> None:
    require_scalar(subject, value)
    require_finite(subject, value)
