"""A capture as the camera records it: blur, shot noise, read noise, and its borders.

"The paper" is "Improved motion invariant imaging with time varying shutter functions".
"""

import math
from collections.abc import Iterator, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from mishutter._core import (
    at_once,
    common_dtype,
    compiled,
    is_concrete,
    require,
    require_finite,
    require_key,
    require_known,
    require_scalar,
)
from mishutter.blur import support
from mishutter.camera.footage import Frames, expose_frames
from mishutter.camera.layers import Layers
from mishutter.camera.noise import recorded, white_electrons
from mishutter.camera.occlusion import expose_layers
from mishutter.camera.rows import channels_last, convolved, extended, require_border, rows_last
from mishutter.evaluation import (
    PLANNED,
    Automatic,
    Plan,
    kernels_at_speeds,
    require_plan,
    sized_for,
)
from mishutter.model import (
    AbstractMotion,
    AbstractShutter,
    Picture,
    Scene,
    is_straight,
    without_velocity,
)

MAX_TAPS = 1 << 13
"""Longest kernel that a capture is simulated with; px."""


def simulate_capture(
    picture: Picture | Layers | Frames | ArrayLike,
    scene: Scene,
    motion: AbstractMotion,
    shutter: AbstractShutter,
    *,
    speed: float = 0.0,
    key: Array | None = None,
    border: str = "reflect",
    full_well: float | None = None,
    adc_bits: int | None = None,
    plan: Plan | Automatic | None = PLANNED,
) -> Array:
    r"""Simulate the capture of a picture that moves along its rows.

    $g_k = \sum_i h_i f_{k - i}$ with the exact kernel $h$ of the picture's speed, then
    the noise of the paper's equation (4) at $p = \text{rate}\cdot 2T$, in linear light and in
    units of a fully open exposure of white. A picture's pixel $j$ is a sample at position
    $j$. Sensor pixel $k$ of a moving sensor collects $[k, k + 1]$ px from the vertex of the
    path, so that the displacement $-s^2/4a$, which no decoder can know, is left out; that of
    a camera at rest collects $[k - \frac12, k + \frac12]$ px from mid-exposure.

    Args:
        picture: Light, white = 1; a `Picture`, or an array of shape `(rows, columns)` or
            `(..., rows, columns, channels)`. Or `Layers`, captured with exact occlusion,
            or `Frames` of footage: these are aligned at mid-exposure, and bring their
            own speeds and borders.
        scene: Light and noise; its speeds are not used.
        motion: Motion of the sensor; concrete.
        shutter: Transmittance over the exposure; concrete with layers and frames.
        speed: Speed of the picture, px/s; 0 for layers and frames; concrete.
        key: JAX key of the noise; None for none.
        border: Where light from beyond the picture comes from. `"scene"`: the picture is
            the scene, and the sensor records the part of it whose light is all known,
            `num_taps - 1` columns less (see `captured_columns`). `"reflect"`, `"edge"`,
            `"wrap"`, `"zero"`: the sensor is as large as the picture, which goes on
            mirrored, as its last pixel, periodically, or dark.
        full_well: Most electrons a pixel holds, e-; by default as many as the scene says.
        adc_bits: Bits of the converter; None for no rounding.
        plan: By default equal colours of a picture are computed once; None computes every
            colour. Layers are computed where they are seen, in either case.

    Returns:
        Light in units of a fully open exposure; the shape of `picture`, but for the
        columns with `border="scene"`.

    Raises:
        ValueError: if an argument is out of its range, light is below 0, the scene has
            no light and noise is asked for, or the picture is narrower than the kernel with
            `border="scene"`.
    """
    require_border("simulate_capture(border=...)", border)
    require_plan(plan)
    _check_noise(scene, key)
    shutter = scene.light(shutter)
    if isinstance(picture, Layers | Frames):
        alone = speed == 0 and border == "reflect"
        subject = "simulate_capture(speed=..., border=...)"
        require(alone, subject, "be left to layers and frames", f"{speed!r}, {border!r}")
        expose = expose_layers if isinstance(picture, Layers) else expose_frames
        light = jnp.asarray(expose(picture, motion, shutter))  # type: ignore[arg-type]
        return _recorded(light, scene, motion, key, full_well, adc_bits)
    light = as_light(picture, "simulate_capture(picture=...)")
    kernel, origin = capture_kernel(motion, shutter, speed, np.dtype(light.dtype))
    if border == "scene":
        columns = light.shape[-1 if light.ndim == 2 else -2]
        enough = columns >= kernel.size
        subject = "simulate_capture(border='scene')"
        require(enough, subject, f"have a picture of at least {kernel.size} columns", columns)
    distinct = distinct_colours(light, plan)
    blurred = channels_last(_blurred(rows_last(distinct), kernel, origin, border), light)
    return _recorded(every_colour(blurred, light), scene, motion, key, full_well, adc_bits)


def blurred_at_speeds(
    light: Array,
    motion: AbstractMotion,
    shutter: AbstractShutter,
    speeds: Sequence[float],
    plan: Plan | Automatic | None = PLANNED,
    least_taps: int = 1,
) -> Iterator[Array]:
    """Light on the sensor from a picture at each of several speeds, without noise.

    The picture is the scene: of `columns` those are recorded whose light is known at every
    speed, by kernels of one length (see `kernel_layout`), so that one program serves all.
    """
    num_taps, origin = kernel_layout(motion, *speeds, least_taps=least_taps)
    planes = rows_last(distinct_colours(light, plan))
    kernels = kernels_at_speeds(shutter, motion, np.asarray(speeds), num_taps)
    for taps in np.asarray(kernels, light.dtype):
        yield every_colour(channels_last(_blurred(planes, taps, origin, "scene"), light), light)


def captured_columns(motion: AbstractMotion, speed: float, num_columns: int) -> slice:
    """Columns of the picture that a capture with `border="scene"` lies over."""
    num_taps, origin = kernel_layout(motion, speed)
    return slice(num_taps - 1 - origin, num_columns - origin)


def capture_kernel(
    motion: AbstractMotion, shutter: AbstractShutter, speed: float, dtype: np.dtype | None = None
) -> tuple[Array, int]:
    """Exact kernel of one speed, and which of its taps shifts nothing.

    Returns:
        Taps, shape `(n,)`, in units of a fully open exposure; index of the tap of
        pixel `k` that comes from the picture's pixel `k`.
    """
    require_known("simulate_capture", motion=motion, speed=speed)
    require_scalar("simulate_capture(speed=...)", speed)
    require_finite("simulate_capture(speed=...)", speed)
    num_taps, origin = kernel_layout(motion, speed)
    dtype = common_dtype(*jax.tree.leaves((motion, shutter))) if dtype is None else dtype
    # Taken in float64: in float32 what is left of two large speeds would be their rounding.
    relative = np.asarray([float(speed) - float(motion.velocity)], dtype)
    taps = kernels_at_speeds(shutter, without_velocity(motion), relative, num_taps)[0]
    if is_concrete(taps):
        return jax.device_put(np.asarray(taps, dtype)), origin
    return taps.astype(dtype), origin


def centred_kernel(
    motion: AbstractMotion, shutter: AbstractShutter, *, speed: float = 0.0
) -> np.ndarray:
    """The kernel of a capture as other libraries take it: one row, odd, its middle at rest.

    `scipy.signal.convolve(picture, centred_kernel(motion, shutter), mode="same")` is the
    capture without noise, in the dark beyond its borders. Divided by its sum it is the
    `psf` of scikit-image's decoders.

    Args:
        motion: Motion of the sensor.
        shutter: Transmittance over the exposure.
        speed: Speed of the picture, px/s; 0 is what the classical decoders assume.

    Returns:
        Taps in units of a fully open exposure, float64; shape `(1, 2 m + 1)`.

    Raises:
        ValueError: if the speed is not finite or the kernel longer than 8,192 px.
    """
    taps, origin = capture_kernel(motion, shutter, speed)
    reach = max(origin, int(np.max(np.flatnonzero(taps), initial=origin)) - origin)
    centred = np.zeros((1, 2 * reach + 1))
    kept = np.asarray(taps, np.float64)[: origin + reach + 1]
    centred[0, reach - origin : reach - origin + kept.size] = kept
    return centred


def kernel_layout(motion: AbstractMotion, *speeds: float, least_taps: int = 1) -> tuple[int, int]:
    """Number of taps that hold every speed, and the index of the tap at no displacement.

    Raises:
        ValueError: if the kernel would be longer than 8,192 px.
    """
    fastest = max(abs(float(s) - float(motion.velocity)) for s in speeds)
    a, half = float(motion.acceleration), float(motion.half_exposure)
    with at_once():
        reach, stroke = float(support(without_velocity(motion), fastest)), a * half * half
    smear = 2 * fastest * half
    longest = max(reach, smear) + 1
    held = math.isfinite(longest) and longest <= MAX_TAPS
    require(held, "simulate_capture(speed=...)", f"blur over at most {MAX_TAPS} px", longest)
    num_taps = max(least_taps, sized_for(longest - 1, stroke + smear / 2).num_taps)
    return num_taps, num_taps // 2 if is_straight(motion) else 0


def as_light(picture: Picture | ArrayLike, subject: str) -> Array:
    """The light of a picture as an array: `(rows, columns)` or with channels last."""
    if isinstance(picture, Picture):
        return jax.device_put(picture.light)
    light = as_pixels(picture, subject)
    least = float(np.min(np.asarray(light))) if is_concrete(light) else 0.0
    require(least >= 0, subject, "be at least 0", least)
    return light


def as_pixels(picture: ArrayLike, subject: str) -> Array:
    """Pixels as an array of 32 or 64 bits: `(rows, columns)` or with channels last."""
    shape = np.shape(picture)
    require(len(shape) >= 2, subject, "have rows and columns", shape)
    require(0 not in shape, subject, "hold at least one pixel", shape)
    require_finite(subject, picture)
    coded = getattr(picture, "dtype", None) in (np.uint8, np.uint16)
    requirement = "hold light, white = 1, as `read_picture` makes it of what a file holds"
    require(not coded, subject, requirement, getattr(picture, "dtype", None))
    dtype = common_dtype(picture)
    return jnp.asarray(picture, dtype if dtype.itemsize >= 4 else np.float32)


def _recorded(
    light: Array,
    scene: Scene,
    motion: AbstractMotion,
    key: Array | None,
    full_well: float | None,
    adc_bits: int | None,
) -> Array:
    if full_well is None and scene.full_well is not None:
        full_well = float(scene.full_well)
    limits = {"full_well": full_well, "adc_bits": adc_bits}
    return recorded(light, white_electrons(scene, motion), scene.read_noise, key=key, **limits)


def noisy(light: Array, scene: Scene, motion: AbstractMotion, key: Array) -> Array:
    """The noise of one capture on what fell on the sensor; the shape of `light`."""
    _check_noise(scene, key)
    return _recorded(light, scene, motion, key, None, None)


def _check_noise(scene: Scene, key: Array | None) -> None:
    require_key("simulate_capture(key=...)", key)
    rate = scene.photon_rate
    lit = key is None or not is_concrete(rate) or float(rate) > 0
    require(lit, "simulate_capture(scene=...)", "have a photon rate above 0 e-/s", 0.0)


@compiled
def _blurred(planes: Array, kernel: Array, origin: int, border: str) -> Array:
    return convolved(extended(planes, kernel.size - 1 - origin, origin, border), kernel)


def skips(plan: Plan | Automatic | None) -> bool:
    """Whether an argument `plan=` leaves out what changes nothing."""
    require_plan(plan)
    return plan.skips if isinstance(plan, Plan) else plan is not None


def distinct_colours(light: Array, plan: Plan | Automatic | None) -> Array:
    """A picture, or one of its colours where all are the same and `plan` skips.

    Args:
        light: Shape `(rows, columns)` or `(..., rows, columns, channels)`.
        plan: The caller's own argument `plan=`.

    Returns:
        Shape of `light`, with one channel where the colours are equal.
    """
    if not (skips(plan) and light.ndim > 2 and light.shape[-1] > 1 and is_concrete(light)):
        return light
    colours = np.asarray(light)
    alike = bool(np.all(colours == colours[..., :1]))
    return jnp.asarray(colours[..., :1]) if alike else light


def every_colour(light: Array, like: ArrayLike) -> Array:
    """`light` with as many channels as `like`."""
    if light.ndim < 3 or light.shape[-1] == jnp.shape(like)[-1]:
        return light
    return jnp.broadcast_to(light, (*light.shape[:-1], jnp.shape(like)[-1]))
