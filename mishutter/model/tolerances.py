r"""Deviations of a camera as it is built from its design, and of objects from their speeds.

On the parabola $x(t) = v t + a t^2$ most errors have the same effect. A stage that is late by $d$
beside the shutter is at $x(t - d) = x(t) - 2 a d\,t + (a d^2 - v d)$: it has the velocity
$v - 2ad$, and a displacement, which is no error of a restored picture. An error of the velocity
adds to the speeds of all objects. Errors of acceleration, velocity, delay and speed are therefore
errors of the acceleration and of the speed alone. Errors of the transmittance add noise to the
response.
"""

from typing import final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from mishutter._core.checks import (
    all_concrete,
    as_float,
    is_concrete,
    require,
    require_number,
    require_positive_int,
)
from mishutter._core.modules import AbstractModule
from mishutter._core.slopes import safe_sqrt
from mishutter.model.motion import is_known_zero


@final
class Tolerances(AbstractModule):
    r"""Standard deviations of independent, normally distributed errors, each of mean 0.

    A decoder knows how they are distributed, and not what they are in a capture.

    Args:
        acceleration: Error of the acceleration, as a share of it; 1.
        velocity: Error of the velocity at mid-exposure of a sensor that moves; px/s. One that is
            at rest has none.
        delay: Time by which the stage is late beside the shutter; s.
        speed: Error of each of the scene's speeds, which lets objects be slower or faster than
            the scene says; px/s.
        transmittance: Error of a driven shutter's transmittance in each step of its drive, of
            those of all others independent; 1. A shutter that stays open has none.
        drive_step: Duration of such a step, which says how long an error lasts; s.
        num_accelerations: Nodes of the quadrature over errors of the acceleration; static. By
            default 3, or 1 where there is none.
        num_speeds: Nodes over errors of the velocity, the delay and the speed; by default 5, or 1.
            With these levels are known to 0.001 dB where errors cost 0.1 dB, and to 0.01 dB
            where they cost 2.

    Raises:
        ValueError: if one is not a finite scalar of at least 0, `transmittance` is above 0 and
            `drive_step` is not, or a number of nodes is not a positive integer, or is 1 for an
            error above 0.
    """

    acceleration: Array
    velocity: Array
    delay: Array
    speed: Array
    transmittance: Array
    drive_step: Array
    num_accelerations: int = eqx.field(static=True)
    num_speeds: int = eqx.field(static=True)

    def __init__(
        self,
        *,
        acceleration: ArrayLike = 0.0,
        velocity: ArrayLike = 0.0,
        delay: ArrayLike = 0.0,
        speed: ArrayLike = 0.0,
        transmittance: ArrayLike = 0.0,
        drive_step: ArrayLike = 0.0,
        num_accelerations: int | None = None,
        num_speeds: int | None = None,
    ):
        self.acceleration = as_float(acceleration, "Tolerances(acceleration=...)")
        self.velocity = as_float(velocity, "Tolerances(velocity=...)")
        self.delay = as_float(delay, "Tolerances(delay=...)")
        self.speed = as_float(speed, "Tolerances(speed=...)")
        self.transmittance = as_float(transmittance, "Tolerances(transmittance=...)")
        self.drive_step = as_float(drive_step, "Tolerances(drive_step=...)")
        errors, of_speed = (self.acceleration,), (self.velocity, self.delay, self.speed)
        self.num_accelerations = _num_nodes("num_accelerations", num_accelerations, 3, errors)
        self.num_speeds = _num_nodes("num_speeds", num_speeds, 5, of_speed)

    def __check_init__(self) -> None:
        for name in (*TOLERANCE_NAMES, "drive_step"):
            require_number(f"Tolerances({name}=...)", getattr(self, name), "at least 0")
        if is_concrete(self.transmittance) and is_concrete(self.drive_step):
            lasts = float(self.transmittance) == 0 or float(self.drive_step) > 0
            requirement = "be above 0 where the transmittance has an error"
            require(lasts, "Tolerances(drive_step=...)", requirement, self.drive_step)

    def in_sensor_frame(self, velocity: Array | np.ndarray) -> "Tolerances":
        """The tolerances in the frame of a sensor that pans, where its error is one of speeds.

        Args:
            velocity: Velocity of the sensor; px/s.
        """
        pans = velocity != 0
        are_concrete = all_concrete((velocity, self.speed, self.velocity))
        space = np if are_concrete else jnp
        square = space.asarray(self.speed) ** 2 + space.asarray(self.velocity) ** 2
        speed = space.where(pans, safe_sqrt(square).astype(square.dtype), space.asarray(self.speed))
        rest = space.where(pans, space.zeros_like(square), space.asarray(self.velocity))
        numbers = tuple(as_float(x) for x in (speed, rest))
        return eqx.tree_at(lambda t: (t.speed, t.velocity), self, numbers)

    def alone(self, name: str) -> "Tolerances":
        """The tolerance of one name, without the others.

        Args:
            name: The tolerance that stays.
        """
        names = [n for n in TOLERANCE_NAMES if n != name]
        nothing = [jnp.zeros_like(getattr(self, n)) for n in names]
        return eqx.tree_at(lambda t: [getattr(t, n) for n in names], self, nothing)


TOLERANCE_NAMES = ("acceleration", "velocity", "delay", "speed", "transmittance")
"""Tolerances that cost something each."""


def _num_nodes(name: str, given: int | None, default: int, errors: tuple[Array, ...]) -> int:
    """Nodes over some errors; a single one, the mean, only where there are none."""
    varies = not all(map(is_known_zero, errors))
    if given is None:
        return default if varies else 1
    subject = f"Tolerances({name}=...)"
    number = require_positive_int(subject, given)
    require(number > 1 or not varies, subject, "be at least 2, for errors above 0", number)
    return number
