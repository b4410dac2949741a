"""How the sensor moves while the shutter is open.

"The paper" is "Improved motion invariant imaging with time varying shutter functions".
"""

from typing import Any, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from mishutter._core import as_float, is_concrete, require, require_finite, require_scalar


class AbstractMotion(eqx.Module):
    r"""A sensor on the path $x(t) = v t + a t^2$, $t \in [-T, T]$.

    Equation (5) of the paper with a velocity $v$ at mid-exposure, by which the sensor pans. A
    point that moves at speed $s$ then passes over the sensor along $x(t) = a t^2 - (s - v) t$:
    panning shifts every speed, and changes nothing else.
    """

    acceleration: eqx.AbstractVar[Array]
    half_exposure: eqx.AbstractVar[Array]
    velocity: eqx.AbstractVar[Array]

    def __repr__(self) -> str:
        """The numbers, of which a module shows no more than their type."""
        numbers = (f"{field}={getattr(self, field)}" for field in self.__dataclass_fields__)
        return f"{type(self).__name__}({', '.join(numbers)})"

    @property
    def stroke(self) -> Array:
        """Travel from mid-exposure to either end, $aT^2$; px."""
        return (self.acceleration * self.half_exposure) * self.half_exposure

    @property
    def speed_gain(self) -> Array:
        """Speed gained from mid-exposure to either end, $2aT$; px/s."""
        return 2 * self.acceleration * self.half_exposure

    @property
    def top_speed(self) -> Array:
        """Greatest speed of the sensor during the exposure, $2aT + |v|$; px/s."""
        return self.speed_gain + jnp.abs(self.velocity)

    @property
    def exposure(self) -> Array:
        """Time from first to last light, $2T$; s."""
        return 2 * self.half_exposure


@final
class ParabolicMotion(AbstractMotion):
    r"""Constant acceleration: the motion-invariant camera.

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
        self.acceleration = as_float(acceleration, "ParabolicMotion(acceleration=...)")
        self.half_exposure = as_float(half_exposure, "ParabolicMotion(half_exposure=...)")
        self.velocity = _as_velocity(velocity, self.half_exposure, "ParabolicMotion")

    def __check_init__(self) -> None:
        _check_acceleration(self.acceleration)
        _check_half_exposure("ParabolicMotion(half_exposure=...)", self.half_exposure)
        _check_velocity("ParabolicMotion(velocity=...)", self.velocity)


class AbstractStraightMotion(AbstractMotion):
    """A sensor whose path is straight."""

    @property
    def acceleration(self) -> Array:  # type: ignore[override]
        """Zero; px/s^2."""
        return _zero_like(self.half_exposure)


@final
class LinearMotion(AbstractStraightMotion):
    """Constant velocity: a panning camera.

    Args:
        half_exposure: $T$; s, above 0.
        velocity: $v$; px/s, either sign.

    Raises:
        ValueError: if one is not a finite scalar, or the exposure not positive.
    """

    half_exposure: Array
    velocity: Array

    def __init__(self, *, half_exposure: ArrayLike, velocity: ArrayLike = 0.0):
        self.half_exposure = as_float(half_exposure, "LinearMotion(half_exposure=...)")
        self.velocity = _as_velocity(velocity, self.half_exposure, "LinearMotion")

    def __check_init__(self) -> None:
        _check_half_exposure("LinearMotion(half_exposure=...)", self.half_exposure)
        _check_velocity("LinearMotion(velocity=...)", self.velocity)


@final
class StillCamera(AbstractStraightMotion):
    """A sensor at rest: a snapshot, or a flutter shutter, by the same integrals.

    Args:
        half_exposure: $T$; s, above 0.

    Raises:
        ValueError: if it is not a finite and positive scalar.
    """

    half_exposure: Array

    def __init__(self, *, half_exposure: ArrayLike):
        self.half_exposure = as_float(half_exposure, "StillCamera(half_exposure=...)")

    def __check_init__(self) -> None:
        _check_half_exposure("StillCamera(half_exposure=...)", self.half_exposure)

    @property
    def velocity(self) -> Array:  # type: ignore[override]
        """Zero; px/s."""
        return _zero_like(self.half_exposure)


def has_vertex(motion: AbstractMotion) -> Array | np.ndarray | np.bool_:
    """Whether objects are aligned at the vertex of their path; on the host where that is known.

    On a sensor without a stroke to speak of, whose powers leave the range of its precision,
    they are aligned at mid-exposure.
    """
    a, half = (
        np.asarray(x) if is_concrete(x) else x for x in (motion.acceleration, motion.half_exposure)
    )
    with np.errstate(over="ignore"):
        return turns(a * half * half)


def turns(stroke: Array | np.ndarray | np.floating) -> Any:
    """Whether the sensor's path has a vertex within what its precision can tell."""
    return stroke > float(np.finfo(stroke.dtype).tiny) ** 0.4


def settled(motion: AbstractMotion) -> AbstractMotion:
    """`motion`, or a linear one where it is known to have no acceleration to speak of.

    That is a `StillCamera` where its velocity is known to be 0.

    Raises:
        ValueError: if it is no motion, as that of a scene may be.
    """
    require(isinstance(motion, AbstractMotion), "motion", "be a motion", motion)
    if isinstance(motion, StillCamera):
        return motion
    signs = motion.acceleration, has_vertex(motion)
    if not any(is_known_zero(sign) for sign in signs):
        return motion
    if is_known_zero(motion.velocity):
        return StillCamera(half_exposure=motion.half_exposure)
    return LinearMotion(half_exposure=motion.half_exposure, velocity=motion.velocity)


def is_known_zero(value: Any) -> bool:
    """Whether a number, or all of an array, can be looked at and is 0."""
    return is_concrete(value) and not np.any(np.asarray(value))


def as_parabolic(motion: AbstractMotion) -> ParabolicMotion:
    """The same motion as the one kind that holds all, for programs that serve all."""
    numbers = ("acceleration", "half_exposure", "velocity")
    return ParabolicMotion(**{name: getattr(motion, name) for name in numbers})


def panned(motion: AbstractMotion, velocity: ArrayLike) -> AbstractMotion:
    """The motion at another velocity."""
    half_exposure = motion.half_exposure
    if isinstance(motion, AbstractStraightMotion):
        return LinearMotion(half_exposure=half_exposure, velocity=velocity)
    return ParabolicMotion(
        acceleration=motion.acceleration, half_exposure=half_exposure, velocity=velocity
    )


def without_velocity(motion: AbstractMotion) -> AbstractMotion:
    """The motion in a frame that pans with it."""
    if isinstance(motion, AbstractStraightMotion):
        return StillCamera(half_exposure=motion.half_exposure)
    return ParabolicMotion(acceleration=motion.acceleration, half_exposure=motion.half_exposure)


def is_straight(motion: AbstractMotion) -> bool:
    """Whether the sensor is known not to accelerate."""
    return isinstance(settled(motion), AbstractStraightMotion)


def _zero_like(value: Array) -> Array:
    with jax.ensure_compile_time_eval():
        return jnp.zeros(value.shape, value.dtype)


def _as_velocity(velocity: ArrayLike, half_exposure: Array, kind: str) -> Array:
    """A velocity; the 0 that stands for none takes the precision of the exposure."""
    if isinstance(velocity, float | int) and velocity == 0:
        return _zero_like(half_exposure)
    return as_float(velocity, f"{kind}(velocity=...)")


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


def _check_velocity(subject: str, value: Array) -> None:
    require_scalar(subject, value)
    require_finite(subject, value)
