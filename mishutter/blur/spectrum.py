"""Transfer function of a shutter on a motion, and condition number of a kernel.

"The paper" is "Improved motion invariant imaging with time varying shutter functions".
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Complex, Float

from mishutter._core.checks import (
    RowLike,
    all_concrete,
    as_float,
    common_dtype,
    primal_values,
    require,
    require_finite,
    require_positive_int,
    shape_of,
)
from mishutter._core.compiling import compiled
from mishutter.blur.quadrature import ExposureQuadrature, exposure_quadrature
from mishutter.model.motion import AbstractMotion
from mishutter.model.shutters.base import AbstractShutter

_MOST_FREQUENCIES = 1 << 26
"""Longest transform; it takes a GiB."""
_CYCLES_PER_NODE, _SPARE_NODES = 0.25, 64
"""Periods of the fastest wave for each node, and nodes beyond their share."""
_TRACED_NODES = 1 << 12
"""Nodes where the numbers that decide them are traced."""


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
    # Up to 8 roundings of the sum of the taps count as zero, and NaN stays.
    has_zero = least <= (8 * jnp.finfo(taps.dtype).eps) ** 2
    ratio = jnp.where(has_zero, 1.0, jnp.max(power) / jnp.where(has_zero, 1.0, least))
    return jnp.where(has_zero, jnp.inf, jnp.sqrt(ratio))


def default_num_frequencies(num_taps: int) -> int:
    """Default length of the transform in `condition_number`."""
    return max(1024, 1 << (4 * num_taps - 1).bit_length())


def transfer_function(
    shutter: AbstractShutter,
    motion: AbstractMotion,
    *,
    speed: RowLike,
    frequency: RowLike,
) -> Complex[Array, "..."]:
    r"""Response to a spatial frequency, in the sensor frame, without the pixel aperture.

    $H(f) = \frac{1}{2T}\int_{-T}^{T} w(t/T)\,e^{-2\pi i f x(t)}\,dt$ with
    $x(t) = a t^2 - (s - v) t$, the path (5) of the paper on a sensor that pans, or any other. By
    quadrature, with as many nodes as the fastest wave has turns: exact to 1e-12 in float64, and in
    float32 to 1e-6 and the rounding of the phase, 2e-7 of its turns. Under `jit` and `vmap`, where
    speed, frequency or motion is traced, 4,096 nodes hold 1,000 turns over the exposure, and more
    are an error at run time.

    Args:
        shutter: Transmittance over the exposure.
        motion: Motion of the sensor.
        speed: Object speed $s$, px/s; either sign, any shape that broadcasts with
            `frequency`.
        frequency: $f$, cycles/px; either sign, any shape.

    Returns:
        $H(f)$; the shape of `frequency`, broadcast with `speed`.

    Raises:
        ValueError: if `speed` or `frequency` is not finite, their shapes do not broadcast, or the
            phase turns more than 262,128 times over the exposure.

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
    dtype = common_dtype(shutter, motion, speed, frequency)
    try:
        shape = np.broadcast_shapes(np.shape(speed), np.shape(frequency))
    except ValueError:
        subject, got = "transfer_function(speed=...)", np.shape(speed)
        requirement = f"broadcast with shape {np.shape(frequency)}"
        raise ValueError(f"`{subject}` must {requirement}; got shape {got}.") from None
    s = jnp.broadcast_to(jnp.asarray(speed, dtype), shape).reshape(-1)
    f = jnp.broadcast_to(jnp.asarray(frequency, dtype), shape).reshape(-1)
    num_nodes, f = _num_nodes(motion, s, f)
    nodes = exposure_quadrature(shutter, num_nodes, dtype, motion.piece_ends)
    return _transfer(nodes, motion, s, f).reshape(shape)


def _num_nodes(motion: AbstractMotion, s: Array, f: Array) -> tuple[int, Array]:
    """Nodes that hold the phase at every point, and frequencies, refused at run time if traced."""
    subject = "transfer_function(frequency=...)"
    motion, speeds, frequencies = primal_values((motion, s, f))
    # Whole turns that the phase takes over the exposure, at most.
    fastest = (motion.speed_gain + abs(speeds - motion.velocity)) * motion.half_exposure
    turns = jnp.max(2 * abs(frequencies) * fastest, initial=0.0)
    if not all_concrete(turns):
        most = int(_CYCLES_PER_NODE * (_TRACED_NODES - _SPARE_NODES))
        message = f"`{subject}` must turn the phase at most {most} times where numbers are traced."
        return _TRACED_NODES, eqx.error_if(f, turns > most, message)
    most = int(_CYCLES_PER_NODE * ((1 << 20) - _SPARE_NODES))
    holds = float(turns) <= most
    require(holds, subject, f"turn the phase at most {most} times over the exposure", float(turns))
    # Powers of two, so that other speeds and frequencies share a program.
    least = math.ceil(float(turns) / _CYCLES_PER_NODE) + _SPARE_NODES
    return 1 << (least - 1).bit_length(), f


@compiled
def _transfer(
    nodes: ExposureQuadrature,
    motion: AbstractMotion,
    s: Float[Array, "points"],
    f: Float[Array, "points"],
) -> Complex[Array, "points"]:
    tau, weight = nodes.tau[None], nodes.weight[None]

    def block(points: tuple[Array, Array]) -> Array:
        speed, frequency = (x[:, None] for x in points)
        turns = frequency * motion.position_of(tau, speed)
        angle = (-2 * jnp.pi) * (turns - jnp.round(turns))
        real, imaginary = (jnp.sum(weight * wave(angle), axis=1) for wave in (jnp.cos, jnp.sin))
        return jax.lax.complex(real, imaginary)

    length = max(1, (1 << 18) // nodes.tau.size)  # bounds the memory of one block
    if f.size <= length:
        return block((s, f))
    index = np.minimum(np.arange(-(-f.size // length) * length), f.size - 1).reshape(-1, length)
    # Reverse mode computes each block again, instead of holding the intermediate values of all.
    return jax.lax.map(jax.checkpoint(block), (s[index], f[index])).reshape(-1)[: f.size]
