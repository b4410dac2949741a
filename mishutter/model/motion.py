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
    r"""A sensor on the path $x(t) = a t^2$, $t \in [-T, T]$ (equation (5) of the paper).

    A point that moves at speed $s$ then passes over the sensor along
    $x(t) = a t^2 - s t$.
    """

    acceleration: eqx.AbstractVar[Array]
    half_exposure: eqx.AbstractVar[Array]

    def __repr__(self) -> str:
        """The numbers, of which a module shows no more than their type."""
        numbers = (f"{field}={getattr(self, field)}" for field in self.__dataclass_fields__)
        return f"{type(self).__name__}({', '.join(numbers)})"

    @property
    def stroke(self) -> Array:
        """Travel from mid-exposure to either end, $aT^2$; px."""
        return (self.acceleration * self.half_exposure) * self.half_exposure

    @property
    def top_speed(self) -> Array:
        """Speed at either end of the exposure, $2aT$; px/s."""
        return 2 * self.acceleration * self.half_exposure

    @property
    def exposure(self) -> Array:
        """Time from first to last light, $2T$; s."""
        return 2 * self.half_exposure


@final
class ParabolicMotion(AbstractMotion):
    r"""Constant acceleration: the motion-invariant camera.

    Args:
        acceleration: The parameter $a$ of $x(t) = a t^2$, half the mechanical
            acceleration; px/s^2, at least 0.
        half_exposure: $T$; s, above 0.

    Raises:
        ValueError: if either is not a finite scalar, or out of its range.
    """

    acceleration: Array
    half_exposure: Array

    def __init__(self, *, acceleration: ArrayLike, half_exposure: ArrayLike):
        self.acceleration = as_float(acceleration, "ParabolicMotion(acceleration=...)")
        self.half_exposure = as_float(half_exposure, "ParabolicMotion(half_exposure=...)")

    def __check_init__(self) -> None:
        _check_acceleration(self.acceleration)
        _check_half_exposure("ParabolicMotion(half_exposure=...)", self.half_exposure)


@final
class StillCamera(AbstractMotion):
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
    def acceleration(self) -> Array:  # type: ignore[override]
        """Zero; px/s^2."""
        with jax.ensure_compile_time_eval():
            return jnp.zeros(self.half_exposure.shape, self.half_exposure.dtype)


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
    """`motion`, or a still camera where it is known to have no acceleration to speak of.

    Raises:
        ValueError: if it is no motion, as that of a scene may be.
    """
    require(isinstance(motion, AbstractMotion), "motion", "be a motion", motion)
    signs = motion.acceleration, has_vertex(motion)
    if any(is_concrete(sign) and not np.any(np.asarray(sign)) for sign in signs):
        return StillCamera(half_exposure=motion.half_exposure)
    return motion


def as_parabolic(motion: AbstractMotion) -> ParabolicMotion:
    """The same motion as the one kind that holds all, for programs that serve all."""
    return ParabolicMotion(acceleration=motion.acceleration, half_exposure=motion.half_exposure)


def stands_still(motion: AbstractMotion) -> bool:
    """Whether the sensor is known not to move."""
    return isinstance(settled(motion), StillCamera)


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
