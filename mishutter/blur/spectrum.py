"""Transfer function of a shutter on a motion, and condition number of a kernel.

"The paper" is "Improved motion invariant imaging with time varying shutter functions".
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from mishutter._core import (
    RowLike,
    as_float,
    common_dtype,
    compiled,
    require,
    require_finite,
    require_positive_int,
    shape_of,
)
from mishutter.blur.free_path import refined
from mishutter.blur.steepest_descent import (
    Panels,
    along_panel,
    along_rays,
    free_panels,
    panels,
    turns_far,
)
from mishutter.blur.trajectory import speed_on_sensor
from mishutter.model import (
    AbstractMotion,
    AbstractPiecewiseShutter,
    AbstractShutter,
    FreeMotion,
    piecewise,
    steady,
)

_MIN_FREQUENCIES = 1024
_MOST_FREQUENCIES = 1 << 26
"""Longest transform; it takes a GiB."""
_ZERO_RESPONSE_ULP = 8
"""Roundings of the sum of the taps up to which a response counts as zero."""
_BLOCK_SIZE = 1 << 14
"""Frequencies times panels in one block; it bounds the memory."""


def condition_number(kernel: RowLike, *, num_frequencies: int | None = None) -> Float[Array, ""]:
    r"""Condition number of the convolution with a kernel, $\max|H| / \min|H|$.

    Equation (3) of the paper, over the frequencies of the discrete Fourier transform of the
    kernel, padded with zeros. A response that is zero to rounding gives `inf`, with a
    derivative of zero.

    Args:
        kernel: Taps $h_k$; shape `(n,)`.
        num_frequencies: Length of the transform, at least `n`; static. By default the
            least power of two that is at least 1024 and at least `4 n`: with 1024 the
            rect, the Hann and the 52-chip flutter kernel of the field have the condition numbers
            9.274, 4.438 and 19.57. The function misses a minimum between two samples.

    Returns:
        The condition number, at least 1.

    Raises:
        ValueError: if `kernel` is not one row of finite taps, or `num_frequencies` is
            not a whole number of at least the number of taps and at most 67,108,864.
    """
    subject = "condition_number(kernel=...)"
    taps = as_float(kernel, subject)
    is_row = taps.ndim == 1 and taps.size >= 1
    require(is_row, subject, "be one row of at least one tap", shape_of(taps))
    require_finite(subject, taps)
    length = default_num_frequencies(taps.size) if num_frequencies is None else num_frequencies
    subject = "condition_number(num_frequencies=...)"
    length = require_positive_int(subject, length)
    require(length >= taps.size, subject, f"be at least the {taps.size} taps", length)
    require(length <= _MOST_FREQUENCIES, subject, f"be at most {_MOST_FREQUENCIES}", length)

    # The ratio does not depend on the scale of the kernel, but the test for a response of zero
    # does. As the scale cancels, so would its derivative.
    magnitude = jax.lax.stop_gradient(jnp.sum(jnp.abs(taps)))
    taps = taps / jnp.where(magnitude > 0, magnitude, 1.0)
    response = jnp.fft.rfft(taps, length)
    # The slope of `abs` is NaN at a zero of the response; that of its square is 0.
    power = response.real**2 + response.imag**2
    least = jnp.min(power)
    invertible = least > (_ZERO_RESPONSE_ULP * jnp.finfo(taps.dtype).eps) ** 2
    ratio = jnp.where(invertible, jnp.max(power) / jnp.where(invertible, least, 1.0), 1.0)
    return jnp.where(invertible, jnp.sqrt(ratio), jnp.inf)


def default_num_frequencies(num_taps: int) -> int:
    """Default length of the transform in `condition_number`."""
    return max(_MIN_FREQUENCIES, 1 << (4 * num_taps - 1).bit_length())


def transfer_function(
    shutter: AbstractShutter,
    motion: AbstractMotion,
    *,
    speed: RowLike,
    frequency: RowLike,
) -> Complex[Array, "..."]:
    r"""Response to a spatial frequency, in the sensor frame, without the pixel aperture.

    $H(f) = \frac{1}{2T}\int_{-T}^{T} w(t/T)\,e^{-2\pi i f x(t)}\,dt$ with
    $x(t) = a t^2 - (s - v) t$, the path (5) of the paper on a sensor that pans. Accurate to
    1e-12 in float64 and 1e-6 in float32 at every frequency, speed and acceleration, zero
    included. First derivatives, each times the size of its argument (for speed and velocity
    that of $s - v$, at least $2aT$), are exact to 1e-9 (1e-4) of the largest at their
    frequency or to 1e-12 (1e-5).

    Args:
        shutter: Transmittance over the exposure.
        motion: Motion of the sensor.
        speed: Object speed $s$, px/s; either sign, any shape that broadcasts with
            `frequency`.
        frequency: $f$, cycles/px; either sign, any shape.

    Returns:
        $H(f)$; the shape of `frequency`, broadcast with `speed`.

    Raises:
        ValueError: if `speed` or `frequency` is not finite, or their shapes do not broadcast.

    Examples:
        >>> import numpy as np
        >>> from mishutter import HannShutter, ParabolicMotion, transfer_function
        >>> motion = ParabolicMotion(acceleration=2e5, half_exposure=0.01)
        >>> frequency = np.array([0.0, 0.1, 0.4])
        >>> response = transfer_function(HannShutter(), motion, speed=300.0, frequency=frequency)
        >>> print([f"{size:.3f}" for size in abs(response)])
        ['0.500', '0.245', '0.123']
    """
    require_finite("transfer_function(speed=...)", speed)
    require_finite("transfer_function(frequency=...)", frequency)
    dtype = common_dtype(*jax.tree.leaves((shutter, motion)), speed, frequency)
    shape = _common_shape(np.shape(speed), np.shape(frequency))
    s = jnp.broadcast_to(jnp.asarray(speed, dtype), shape).reshape(-1)
    f = jnp.broadcast_to(jnp.asarray(frequency, dtype), shape).reshape(-1)
    return _transfer(piecewise(shutter), motion, s, f).reshape(shape)


def _common_shape(speed: tuple[int, ...], frequency: tuple[int, ...]) -> tuple[int, ...]:
    try:
        return np.broadcast_shapes(speed, frequency)
    except ValueError:
        subject, requirement = "transfer_function(speed=...)", f"broadcast with shape {frequency}"
        raise ValueError(f"`{subject}` must {requirement}; got shape {speed}.") from None


@compiled
def _transfer(
    profile: AbstractPiecewiseShutter,
    motion: AbstractMotion,
    s: Float[Array, "points"],
    f: Float[Array, "points"],
) -> Complex[Array, "points"]:
    # Not `abs`, whose derivative at 0 is 0: that of the response at 0 is not.
    response = _at_positive(profile, motion, s, jnp.where(f < 0, -f, f))
    return jnp.where(f < 0, jnp.conj(response), response)


def _at_positive(
    profile: AbstractPiecewiseShutter,
    motion: AbstractMotion,
    s: Float[Array, "points"],
    f: Float[Array, "points"],
) -> Complex[Array, "points"]:
    """The transfer function at frequencies of at least 0."""
    dtype = np.dtype(f.dtype)
    T, v = (x.astype(dtype) for x in (motion.half_exposure, motion.velocity))
    if isinstance(motion, FreeMotion):
        profile, place = refined(profile, motion.piece_ends, dtype)

        def panels_at(s: Array, f: Array) -> tuple[Panels, Array | None]:
            return free_panels(profile, place, motion, speed_on_sensor(s, v), f)
    else:
        a = steady(motion).acceleration.astype(dtype)

        def panels_at(s: Array, f: Array) -> tuple[Panels, Array | None]:
            return panels(profile, a, T, speed_on_sensor(s, v), f), None

    def block(points: tuple[Array, Array]) -> Array:
        panel, is_mirrored = jax.vmap(panels_at)(*points)
        direct = jax.vmap(lambda p: along_panel(profile, p))(panel)
        far = turns_far(panel)
        # Short or slow exposures have no far panel, and are spared the rays.
        descent = jax.lax.cond(
            jnp.any(far),
            jax.vmap(lambda p: along_rays(profile, p)),
            lambda _: jnp.zeros_like(direct),
            panel,
        )
        integral = jnp.where(far, descent, direct)
        if is_mirrored is not None:
            integral = jnp.where(is_mirrored, jnp.conj(integral), integral)
        return jnp.sum(integral, axis=(1, 2)) / 2

    num_pieces = profile.breakpoints(dtype).high.size - 1
    length = max(1, _BLOCK_SIZE // (num_pieces * profile.panels_per_piece))
    if f.size <= length:
        return block((s, f))
    index = np.minimum(np.arange(-(-f.size // length) * length), f.size - 1).reshape(-1, length)
    # Reverse mode computes each block again, instead of holding the intermediate values of all.
    return jax.lax.map(jax.checkpoint(block), (s[index], f[index])).reshape(-1)[: f.size]
