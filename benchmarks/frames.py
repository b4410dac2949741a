"""Frames of a stage on the paths that bursts follow, as their level takes them."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import ArrayLike

from benchmarks.burst_levels import FrameGroup
from mishutter import FreeMotion, ParabolicMotion, StillCamera

_PIECES_OF_SINE = 32
"""Pieces of constant acceleration that stand for a sine within a frame."""


def steps_of(num_frames: int) -> np.ndarray:
    """Places of frames from the middle of a burst, in periods."""
    return np.arange(num_frames) - (num_frames - 1) / 2


def alternating_frames(
    num_frames: int, half_exposure: ArrayLike, acceleration: ArrayLike
) -> FrameGroup:
    r"""Frames of a stage on parabolas $(-1)^k a t^2$, whose velocity has no jump.

    The direction of a parabola does not change $|H|$ at speeds of either sign: $H_{-a}(f, s)$ is
    the conjugate of $H_a(f, -s)$, whose modulus is that of $H_a(f, s)$ by $t \to -t$.

    Args:
        num_frames: Number of frames.
        half_exposure: Half the exposure of each, $T$; s.
        acceleration: $a$; px/s^2.
    """
    motion = ParabolicMotion(acceleration=acceleration, half_exposure=half_exposure)
    return FrameGroup(motion, num_each=num_frames)


def sweep_frames(
    num_frames: int, half_exposure: ArrayLike, acceleration: ArrayLike, period: ArrayLike
) -> FrameGroup:
    r"""Frames of one slow parabola $a t^2$ over the whole burst.

    Frame $k$, at $t_k$ from the middle of the burst, is on a parabola with the velocity
    $2 a t_k$.

    Args:
        num_frames: Number of frames.
        half_exposure: Half the exposure of each, $T$; s.
        acceleration: $a$; px/s^2.
        period: Time from one frame to the next; s.
    """
    motion = ParabolicMotion(acceleration=acceleration, half_exposure=half_exposure)
    velocities = 2 * motion.acceleration * jnp.asarray(period) * steps_of(num_frames)
    return FrameGroup(motion, velocities)


def sine_frames(
    num_frames: int, half_exposure: ArrayLike, stroke: ArrayLike, period: ArrayLike
) -> FrameGroup:
    r"""Frames about the turning points of a stage on a sine of half the frame rate.

    The path $A(1 - \cos(\pi t/P))$ is followed by 32 pieces of constant acceleration, which meet on
    it: their trapezoids add up to a sine that is $(\theta/2)/\tan(\theta/2)$ as high, with
    $\theta = \pi h/P$ for pieces of length $h$. Levels differ from the sine's by less
    than 1e-5 dB at 8 e- of read noise, and by 3e-5 dB at 1e6 e-/s and 2 e-.

    Args:
        num_frames: Number of frames.
        half_exposure: Half the exposure of each, $T$; s.
        stroke: Travel of the sensor within a frame; px.
        period: Time from one frame to the next, $P$; s.
    """
    half, period = jnp.asarray(half_exposure), jnp.asarray(period)
    amplitude = jnp.asarray(stroke) / (1 - jnp.cos(np.pi * half / period))
    meet = half * np.linspace(-1, 1, _PIECES_OF_SINE + 1)
    velocity = amplitude * np.pi / period * jnp.sin(np.pi * meet / period)
    turn = np.pi * half / period / _PIECES_OF_SINE
    accelerations = jnp.diff(velocity) / (4 * half / _PIECES_OF_SINE) * jnp.tan(turn) / turn
    motion = FreeMotion(accelerations=accelerations, half_exposure=half)
    return FrameGroup(motion, num_each=num_frames)


def panned_frames(num_frames: int, half_exposure: ArrayLike, top_speed: ArrayLike) -> FrameGroup:
    """A fan of pans: frames at constant velocities in equal steps from one direction to the other.

    Args:
        num_frames: Number of frames.
        half_exposure: Half the exposure of each, $T$; s.
        top_speed: The greatest of the velocities; px/s.
    """
    steps = 2 * steps_of(num_frames) / max(num_frames - 1, 1)
    return FrameGroup(StillCamera(half_exposure=half_exposure), jnp.asarray(top_speed) * steps)
