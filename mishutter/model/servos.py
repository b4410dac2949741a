r"""Stages of limited bandwidth: the motion that a path leads to, and the path to send for a motion.

A servo that is sent the position $u(t)$ moves the sensor as a damped oscillator,

$$\ddot x + 2\zeta\omega\,\dot x + \omega^2 x = \omega^2 u,$$

so that a sensor is on a path $x(t)$ where the servo is sent

$$u = x + \frac{2\zeta}{\omega}\,\dot x + \frac{1}{\omega^2}\,\ddot x.$$

Over a parabola $a t^2$ that is the same parabola, sent ahead by the delay $d = 2\zeta/\omega$ and
from $2a/\omega^2 (1 - 2\zeta^2)$ px above. What is sent jumps where the acceleration does.

A servo that is sent the path itself follows, over a piece of constant jerk, the cubic that solves
the same equation, and oscillates about it less and less, as $e^{-\zeta\omega t}$. On a parabola
the delay is left, which pans by $-2ad$.
"""

from collections.abc import Sequence
from typing import final

import numpy as np
from jaxtyping import Array, ArrayLike, Float

from mishutter._core.checks import as_float, require_number
from mishutter._core.modules import AbstractModule
from mishutter.model.motion import FreeMotion
from mishutter.model.stages import StagePath


@final
class SecondOrderStage(AbstractModule):
    r"""A stage whose servo follows as a damped oscillator of natural frequency $\omega$.

    Of a sine of frequency $f$ it passes $|1 - r^2 + 2i\zeta r|^{-1}$, $r = 2\pi f/\omega$; its
    bandwidth is where that is $1/\sqrt2$.

    Args:
        bandwidth: Frequency at which it follows half of the power of a sine; Hz, above 0.
        damping: Damping ratio $\zeta$, above 0; 1 is critical.

    Raises:
        ValueError: if one is not a finite scalar above 0.
    """

    bandwidth: Array
    damping: Array

    def __init__(self, *, bandwidth: ArrayLike, damping: ArrayLike = 0.7):
        self.bandwidth = as_float(bandwidth, "SecondOrderStage(bandwidth=...)")
        self.damping = as_float(damping, "SecondOrderStage(damping=...)")

    def __check_init__(self) -> None:
        for name in ("bandwidth", "damping"):
            value, subject = getattr(self, name), f"SecondOrderStage({name}=...)"
            require_number(subject, value, "above 0", strict=True)

    @property
    def natural_frequency(self) -> float:
        r"""Angular frequency $\omega$ of the free oscillation; rad/s."""
        damping = float(self.damping)
        slack = 1 - 2 * damping**2
        root = np.hypot(slack, 1.0)
        # Each of the two forms of one number has no cancellation on its side.
        square = root + slack if slack > 0 else 1 / (root - slack)
        return 2 * np.pi * float(self.bandwidth) / float(np.sqrt(square))

    @property
    def delay(self) -> float:
        r"""Time $2\zeta/\omega$ by which a steady parabola is followed late; s."""
        return 2 * float(self.damping) / self.natural_frequency

    def sent_for(
        self, path: StagePath, times: Float[np.ndarray, "*times"]
    ) -> Float[np.ndarray, "*times"]:
        """Positions to send so that the stage is on a path; px, shape of `times`.

        Args:
            path: Where the stage shall be, from rest to rest.
            times: Times from mid-exposure; s, any shape.
        """
        position, velocity = path.at(times)
        acceleration = path.acceleration_at(times)
        return position + self.delay * velocity + acceleration / self.natural_frequency**2

    def made_of(self, path: StagePath, *, ahead: float = 0.0) -> FreeMotion:
        """The motion over an exposure of a stage that is sent the path where it should be.

        Its velocities are exact where its 256 equal pieces meet.

        Args:
            path: What is sent, from rest to rest.
            ahead: Time by which it is sent early; s. `delay` makes up for the lag on a parabola.
        """
        num_pieces = 256  # a stroke of 45 px in 18 ms is known to 0.001 px
        times = np.linspace(*path.exposure, num_pieces + 1)
        _, velocity = self.followed(path, times + ahead)
        return FreeMotion(
            accelerations=np.diff(velocity) / np.diff(times) / 2,
            half_exposure=path.exposure[1],
            velocity=velocity[num_pieces // 2],
        )

    def followed(
        self, path: StagePath, times: Float[np.ndarray, "*times"]
    ) -> tuple[Float[np.ndarray, "*times"], Float[np.ndarray, "*times"]]:
        """Positions, px, and velocities, px/s, of a stage that is sent the path where it should be.

        Args:
            path: What is sent, from rest to rest.
            times: Times from mid-exposure; s, any shape.
        """
        # After its last piece the path rests.
        accelerations, jerks = (np.append(x, 0.0) for x in (path.accelerations, path.jerks))
        starts = path.positions, path.velocities, accelerations, jerks
        state, strays = np.array([path.positions[0], 0.0]), []
        for piece, length in enumerate(np.diff(path.times, append=path.times[-1])):
            strays.append(state - self._cubic([x[piece] for x in starts], 0.0))
            steady = self._cubic([x[piece] for x in starts], length)
            state = steady + self._decay(length) @ strays[-1]
        place = np.maximum(np.searchsorted(path.times, times, side="right") - 1, 0)
        elapsed = np.maximum(times - path.times[place], 0.0)
        steady = self._cubic([x[place] for x in starts], elapsed)
        strayed = self._decay(elapsed) @ np.stack(strays)[place][..., None]
        made = steady + strayed[..., 0]
        return made[..., 0], made[..., 1]

    def _cubic(
        self, starts: Sequence[np.ndarray | np.floating], elapsed: np.ndarray | np.floating | float
    ) -> np.ndarray:
        """Position and velocity that a piece of constant jerk leads to, without an oscillation."""
        position, velocity, acceleration, jerk = starts
        delay, square = self.delay, 1 / self.natural_frequency**2
        sent = position + elapsed * (velocity + elapsed * (acceleration / 2 + elapsed * (jerk / 6)))
        sent_velocity = velocity + elapsed * (acceleration + elapsed * (jerk / 2))
        made_acceleration = acceleration + elapsed * jerk - delay * jerk
        made_velocity = sent_velocity - delay * made_acceleration - square * jerk
        made = sent - delay * made_velocity - square * made_acceleration
        return np.stack([made, made_velocity], axis=-1)

    def _decay(self, elapsed: np.ndarray | np.floating) -> np.ndarray:
        """The matrix that carries a position and a velocity on, nothing sent; `(..., 2, 2)`."""
        from scipy.linalg import expm

        frequency = self.natural_frequency
        scale = np.array([[1.0, 1 / frequency], [frequency, 1.0]])
        angles = np.asarray(elapsed * frequency)[..., None, None]
        return expm(angles * np.array([[0.0, 1.0], [-1.0, -2 * float(self.damping)]])) * scale
