"""A capture as the camera records it: blur, shot noise, read noise, and its borders.

"The paper" is "Improved motion invariant imaging with time varying shutter functions".
"""

import math
import os
from collections.abc import Iterator, Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Complex, Float

from mishutter._core.checks import (
    as_float,
    as_numpy,
    floating_light,
    is_concrete,
    namespace_of,
    require,
    require_finite,
    require_key,
    require_known,
    require_number,
)
from mishutter._core.compiling import compiled, outside_trace
from mishutter._core.parallel import alone_in_blas
from mishutter.camera.footage import Footage, expose_frames
from mishutter.camera.layers import Layers
from mishutter.camera.noise import recorded
from mishutter.camera.occlusion import expose_layers, nodes_for
from mishutter.camera.rows import (
    MAX_REACH,
    Planes,
    blur_length,
    blurred,
    channels_last,
    continued,
    fast_length,
    period_of,
    require_border,
    rows_last,
    seen_in_turn,
)
from mishutter.evaluation.needs import Plan
from mishutter.evaluation.response import pixel_responses
from mishutter.evaluation.views import sensor_view
from mishutter.model.motion import AbstractMotion
from mishutter.model.optics import NYQUIST_FREQUENCY, WIDEST_BLUR, Optics, lens_response
from mishutter.model.scene import Scene, require_scene
from mishutter.model.sensor import Sensor, white_electrons
from mishutter.model.shutters.base import AbstractShutter
from mishutter.model.shutters.windows import RectShutter
from mishutter.pictures.images import Picture, pixels_along, transposed

_ROLL_OFF = 0.4
"""Frequency from which on the response of a kernel for other libraries falls off to 0 at 1/2."""


@alone_in_blas()
def simulate_capture(
    picture: Picture | Layers | Footage | ArrayLike,
    scene: Scene,
    motion: AbstractMotion,
    shutter: AbstractShutter,
    *,
    speed: float = 0.0,
    displacement: float = 0.0,
    key: Array | None = None,
    border: str = "reflect",
    full_well: float | None = None,
    adc_bits: int | None = None,
) -> Float[Array, "..."]:
    r"""Simulate the capture of a picture that moves along its rows, or along the scene's axis.

    A picture that moves along its columns is captured as one of exchanged rows and columns would
    be. The rows are a continuous, band-limited scene through the picture's pixels, whose spectrum
    $F(f)$ becomes $F(f)\,H_s(f)\,\operatorname{sinc}(f)$: the exact transfer function of the
    picture's speed, then a pixel's width; the scene's lens comes before both. The noise is that of
    the paper's equation (4) at $p = \text{rate}\cdot 2T$, in linear light and in units of a fully
    open exposure of white. Pixel $k$ of an accelerated sensor is centred $k$ px from where objects
    are aligned (`alignment` of the motion), so that a displacement that no decoder can know, of
    $-s^2/4a$ at a vertex, is left out; that of any other is centred $k$ px from mid-exposure.

    Args:
        picture: Light, white = 1; a `Picture`, or an array of shape `(rows, columns)` or
            `(..., rows, columns, channels)`. Or `Layers`, captured with exact occlusion,
            or `Footage` of footage: these are aligned at mid-exposure, and bring their
            own speeds and borders.
        scene: Light, noise, optics and axis; its speeds are not used.
        motion: Motion of the sensor; concrete.
        shutter: Transmittance over the exposure; concrete with layers and frames.
        speed: Speed of the picture, px/s, to the left or up; 0 for layers and frames; concrete.
        displacement: Distance of the picture's pixels from the sensor's, px; 0 for layers and
            frames; concrete.
        key: JAX key of the noise; None for none.
        border: Where light from beyond the picture comes from. `"scene"`: the picture is
            the scene, and the sensor records the part of it whose light is all known (see
            `captured_columns`). `"reflect"`, `"edge"`, `"wrap"`, `"zero"`: the sensor is as
            large as the picture, which goes on mirrored, as its last pixel, periodically, or dark.
        full_well: Most electrons a pixel holds, e-; by default as many as the scene says.
        adc_bits: Bits of the converter; None for no rounding.

    Returns:
        Light in units of a fully open exposure; the shape of `picture`, but for the
        columns with `border="scene"`.

    Raises:
        ValueError: if an argument is out of its range, light is below 0, the scene has
            no light and noise is asked for, or the picture is narrower than the blur with
            `border="scene"`; or if rows are exposed one after another and the shutter is shaped,
            the motion accelerates, or the subject is no picture.

    Examples:
        >>> import jax
        >>> from mishutter import HannShutter, ParabolicMotion, Scene, example_picture
        >>> from mishutter import simulate_capture
        >>> scene = Scene.uniform(max_speed=1500.0, photon_rate=1e5, read_noise=5)
        >>> motion = ParabolicMotion(acceleration=2e5, half_exposure=0.01)
        >>> picture = example_picture()
        >>> captured = simulate_capture(
        ...     picture, scene, motion, HannShutter(), speed=700.0, key=jax.random.key(0)
        ... )
        >>> print(captured.shape, f"{captured.mean():.3f}")
        (500, 741, 3) 0.109
    """
    require_scene(scene)
    require_border("simulate_capture(border=...)", border)
    _check_noise(scene, key)
    shutter, exposure = sensor_view(scene, motion, shutter).shutter, motion.exposure
    if scene.sensor.is_rolling:
        require_alike_rows("simulate_capture(shutter=...)", motion, shutter)
        is_picture = not isinstance(picture, Layers | Footage)
        requirement = "be a picture, or frames be taken, where rows are exposed one after another"
        require(is_picture, "simulate_capture(picture=...)", requirement, type(picture).__name__)
    if isinstance(picture, Layers | Footage):
        are_defaults = speed == 0 and displacement == 0 and border == "reflect"
        subject = "simulate_capture(speed=..., displacement=..., border=...)"
        got = f"{speed!r}, {displacement!r}, {border!r}"
        require(are_defaults, subject, "be left to layers and frames", got)
        along = picture.transposed(scene.sensor.axis)
        expose = expose_layers if isinstance(picture, Layers) else expose_frames
        light = expose(along, motion, shutter, scene.optics)  # type: ignore[arg-type]
        levels = recorded_by(scene, light, exposure, key, full_well=full_well, adc_bits=adc_bits)
        return as_float(transposed(levels, scene.sensor.axis))
    radiance = transposed(as_radiance(picture, "simulate_capture(picture=...)"), scene.sensor.axis)
    require_known("simulate_capture", motion=motion, speed=speed, displacement=displacement)
    for name, value in (("speed", speed), ("displacement", displacement)):
        require_number(f"simulate_capture({name}=...)", value)
    columns = radiance.shape[-1 if radiance.ndim == 2 else -2]
    num_taps, _ = kernel_layout(motion, speed, subject="simulate_capture(speed=...)")
    is_near = border not in ("edge", "zero") or abs(displacement) <= MAX_REACH
    requirement = f"be within {MAX_REACH} px of a picture that ends"
    require(is_near, "simulate_capture(displacement=...)", requirement, displacement)
    window = slice(0, columns)
    if border == "scene":
        subject = "simulate_capture(border='scene')"
        requirement = f"have a picture of at least {num_taps} {pixels_along(scene.sensor.axis)}"
        require(columns >= num_taps, subject, requirement, columns)
        window = captured_columns(motion, speed, columns)
    period = period_of(columns, num_taps + math.ceil(abs(displacement)), border)
    response = captured_response(motion, shutter, [speed], period)[0]
    response = _through_lens(scene, response, period, displacement)
    planes = rows_last(distinct_colours(radiance))
    if scene.sensor.is_rolling:
        way = float(motion.velocity) - speed
        exposed = _by_rows(
            scene.sensor, np.asarray(planes), response, way, (period, border, window)
        )
    else:
        exposed = _exposed(planes, response, period, border)[..., window]
    irradiance = every_colour(channels_last(exposed, radiance), radiance)
    levels = recorded_by(scene, irradiance, exposure, key, full_well=full_well, adc_bits=adc_bits)
    return as_float(transposed(levels, scene.sensor.axis))


def require_alike_rows(subject: str, motion: AbstractMotion, shutter: AbstractShutter) -> None:
    """Refuse an exposure of which rows that are exposed in turn see unlike parts."""
    requirement = (
        "have an open shutter and no acceleration before rows that are exposed one after "
        "another, which would each see another part of a profile or a path"
    )
    require(motion.is_straight and isinstance(shutter, RectShutter), subject, requirement, shutter)


def blurred_at_speeds(
    radiance: Planes,
    scene: Scene,
    motion: AbstractMotion,
    shutter: AbstractShutter,
    speeds: Sequence[float],
    *,
    least_taps: int = 1,
) -> Iterator[Planes]:
    """Irradiance of the sensor from a picture at each of several speeds, without noise.

    The picture is the scene: of `columns` those are recorded whose irradiance is known at every
    speed (see `kernel_layout`).
    """
    num_taps, origin = kernel_layout(motion, *speeds, least_taps=least_taps)
    planes = rows_last(distinct_colours(radiance))
    columns = planes.shape[-1]
    period = period_of(columns, num_taps, "scene")
    window = slice(num_taps - 1 - origin, columns - origin)
    for response in captured_response(motion, shutter, speeds, period):
        response = _through_lens(scene, response, period)
        irradiance = _exposed(planes, response, period, "scene")[..., window]
        yield every_colour(channels_last(irradiance, radiance), radiance)


def through_optics(
    rows: Float[np.ndarray, "*planes columns"], cutoff: float
) -> Float[np.ndarray, "*planes columns"]:
    """Rows of a picture as optics of some cutoff pass them, mirrored beyond their ends."""
    if cutoff >= NYQUIST_FREQUENCY:
        return rows
    columns = rows.shape[-1]
    period = period_of(columns, 0, "reflect")
    spectrum = np.fft.rfft(continued(rows, period, "reflect"))
    image = np.fft.irfft(spectrum * Optics(cutoff_frequency=cutoff).response(period), period)
    return image[..., :columns].astype(rows.dtype)


def captured_columns(motion: AbstractMotion, speed: float, num_columns: int) -> slice:
    """Columns of the picture, or rows of one that moves along these, of a capture of the scene.

    They are those that a capture with `border="scene"` lies over.
    """
    num_taps, origin = kernel_layout(motion, speed, subject="captured_columns(speed=...)")
    return slice(num_taps - 1 - origin, num_columns - origin)


def captured_response(
    motion: AbstractMotion, shutter: AbstractShutter, speeds: Sequence[float], period: int
) -> Complex[Array | np.ndarray, "speeds frequencies"]:
    """Responses at some speeds as a capture has them, on the grid of a DFT."""
    relative = np.asarray(speeds, np.float64) - float(motion.velocity)
    num_nodes, still = nodes_of_capture(motion, relative), motion.without_velocity()
    return pixel_responses(shutter, still, relative, period, num_nodes=num_nodes)


def nodes_of_capture(motion: AbstractMotion, relative: Float[np.ndarray, "s"]) -> int:
    """Quadrature nodes of a capture at speeds from which the sensor's velocity is taken; px/s."""
    fastest = float(np.max(np.abs(relative), initial=0.0))
    with outside_trace():
        speed_gain = float(motion.speed_gain)
    return nodes_for((speed_gain + fastest) * float(motion.half_exposure))


def captured_responses_below(
    motion: AbstractMotion,  # concrete
    shutter: AbstractShutter,  # concrete
    speeds: np.ndarray,
    period: int,
    counts: np.ndarray,
) -> Complex[np.ndarray, "speeds frequencies"]:
    """The `captured_response` of each speed at the lowest of the frequencies; 0 at the highest.

    Speeds far beyond the fastest object's take so many nodes for each frequency that they are
    computed at those alone.
    """
    number, half = period // 2 + 1, float(motion.half_exposure)
    octave = np.floor(np.log2(number / np.clip(counts, 1, number))).astype(int)
    responses = np.zeros((speeds.size, number), complex)
    for each in np.unique(octave):
        some, count = np.flatnonzero(octave == each), -(-number // 2 ** int(each))
        velocity = (float(motion.speed_gain) + float(np.max(np.abs(speeds[some])))) * half
        responses[some, :count] = pixel_responses(
            shutter,
            motion,
            speeds,
            period,
            num_nodes=nodes_for(velocity * count / number),
            num_frequencies=count,
            some=some,
        )
    return responses


def centred_kernel(
    motion: AbstractMotion, shutter: AbstractShutter, *, speed: float = 0.0, lens_blur: float = 0.0
) -> Float[np.ndarray, "1 taps"]:
    r"""The blur as other libraries take it: one row of taps, odd, its middle at rest.

    The samples of the band-limited response of a point,
    $\int H_s(f)\operatorname{sinc}(f)\,e^{2\pi i f k}\,df$, with frequencies above 0.4
    cycles/px let fall off to 0 at 1/2, so that the taps end. Some are slightly below 0.
    `scipy.signal.convolve(picture, centred_kernel(motion, shutter), mode="same")` is the
    capture without noise of a picture without detail that fine, in the dark beyond its borders.
    Divided by its sum it is the `psf` of scikit-image's decoders. Of pictures that move along their
    columns take its transpose.

    Args:
        motion: Motion of the sensor.
        shutter: Transmittance over the exposure.
        speed: Speed of the picture, px/s; classical decoders assume 0.
        lens_blur: Deviation of the lens's Gaussian, as `Scene` has it; px.

    Returns:
        Taps in units of a fully open exposure, float64; an odd number of them.

    Raises:
        ValueError: if the speed is not finite, the light displaced by over 8,192 px, or the blur
            of the lens not within 0 and 16 px.
    """
    require_number("centred_kernel(speed=...)", speed)
    requirement = f"be at least 0 and at most {WIDEST_BLUR:g} px"
    is_narrow = 0 <= lens_blur <= WIDEST_BLUR
    require(is_narrow, "centred_kernel(lens_blur=...)", requirement, lens_blur)
    num_taps, origin = kernel_layout(motion, speed, subject="centred_kernel(speed=...)")
    # Taps die away in 24 px, and light falls within five standard deviations of the lens's.
    tail = 24 + math.ceil(5 * lens_blur)
    middle = max(origin, num_taps - 1 - origin) + tail
    length = fast_length(4 * (middle + tail))
    response = np.asarray(captured_response(motion, shutter, [speed], length)[0])
    frequency = np.arange(response.size) / length
    response = response * lens_response(frequency, lens_blur)
    roll_off = np.clip((frequency - _ROLL_OFF) / (NYQUIST_FREQUENCY - _ROLL_OFF), 0, 1)
    taps = np.fft.irfft(response * np.cos(np.pi / 2 * roll_off) ** 2, length)
    return np.roll(taps, middle)[None, : 2 * middle + 1]


def kernel_layout(
    motion: AbstractMotion, *speeds: float, least_taps: int = 1, subject: str = "scene"
) -> tuple[int, int]:
    """Number of taps that hold every speed, and the index of the tap at no displacement."""
    longest = blur_length(motion, *speeds, subject=subject)
    num_taps = max(least_taps, Plan.of_travel(longest - 1, 0.0).num_taps)
    if motion.is_straight:
        return num_taps, num_taps // 2
    return num_taps, 0 if motion.turn > 0 else num_taps - 1


def as_radiance(picture: Picture | ArrayLike, subject: str) -> Planes:
    """The radiance of a picture, linear, as an array: `(rows, columns)` or with channels last."""
    radiance = as_pixels(picture, subject)
    if isinstance(picture, Picture):  # is checked where it is made
        return radiance
    least = float(np.min(np.asarray(radiance))) if is_concrete(radiance) else 0.0
    require(least >= 0, subject, "be at least 0", least)
    return radiance


def as_pixels(picture: Picture | ArrayLike, subject: str) -> Planes:
    """Pixels as an array of 32 or 64 bits: `(rows, columns)` or with channels last."""
    if isinstance(picture, Picture):  # a capture that `read_picture` has read from a file
        return floating_light(picture.light, subject)
    shape = np.shape(picture)
    got = picture if isinstance(picture, str | os.PathLike) else shape
    require(len(shape) >= 2, subject, "have rows and columns", got)
    require(0 not in shape, subject, "hold at least one pixel", shape)
    require_finite(subject, picture)
    return floating_light(picture, subject)


def recorded_by(
    scene: Scene,
    irradiance: Planes,
    exposure: Array | float,  # s
    key: Array | None,
    *,
    full_well: float | None = None,
    adc_bits: int | None = None,
) -> Array:
    """An irradiance as the sensor of a scene records it; its full well is the default."""
    if full_well is None and scene.sensor.full_well is not None:
        full_well = float(scene.sensor.full_well)
    white, noise = white_electrons(scene.photon_rate, exposure), scene.read_noise
    return recorded(irradiance, white, noise, key=key, full_well=full_well, adc_bits=adc_bits)


def noisy(irradiance: Planes, scene: Scene, motion: AbstractMotion, key: Array) -> Array:
    """An irradiance of the sensor with the noise of one capture; its shape."""
    _check_noise(scene, key)
    return recorded_by(scene, irradiance, motion.exposure, key)


def _check_noise(scene: Scene, key: Array | None) -> None:
    require_key("simulate_capture(key=...)", key)
    rate = scene.photon_rate
    has_light = key is None or not is_concrete(rate) or float(rate) > 0
    require(has_light, "simulate_capture(scene=...)", "have a photon rate above 0 e-/s", 0.0)


def _through_lens(
    scene: Scene,
    response: Complex[Array | np.ndarray, "frequencies"],
    period: int,
    displacement: float = 0.0,
) -> Complex[Array | np.ndarray, "frequencies"]:
    """A response on the grid of a DFT times that of the lens and of the picture's displacement."""
    frequency = np.arange(response.size) / period
    shift = np.exp(-2j * np.pi * frequency * float(displacement))
    return response * (shift * scene.optics.response(period)).astype(response.dtype)


def _exposed(planes: Planes, response: ArrayLike, period: int, border: str) -> Planes:
    """One period of blurred rows, by one program for all columns that a camera may record."""
    return as_numpy(_blurred(planes, response, period, border))[0]


def _by_rows(
    sensor: Sensor,
    planes: np.ndarray,
    response: ArrayLike,
    way: float,  # Of the sensor before the picture; px/s
    sizes: tuple[int, str, slice],
) -> np.ndarray:
    """Blurred rows, each displaced by what has moved until it is exposed."""
    period, border, window = sizes
    along, spectrum = sensor.axis == "columns", np.fft.rfft(continued(planes, period, border))
    delays = sensor.row_delays(window.stop - window.start if along else planes.shape[-2])
    frequency = np.arange(spectrum.shape[-1]) / period
    each = np.asarray(response) * np.exp(np.multiply.outer(-2j * np.pi * way * delays, frequency))
    return seen_in_turn(spectrum, each, window, period, is_along=along).astype(planes.dtype)


@compiled
def _blurred(planes: Planes, response: ArrayLike, period: int, border: str) -> Array:
    return blurred(continued(jnp.asarray(planes), period, border), response)


def distinct_colours(picture: Planes) -> Planes:
    """A picture, or one of its colours where all are known to be the same."""
    if picture.ndim < 3 or picture.shape[-1] == 1 or not is_concrete(picture):
        return picture
    colours = np.asarray(picture)
    are_equal = bool(np.all(colours == colours[..., :1]))
    return colours[..., :1] if are_equal else picture


def every_colour(picture: Planes, like: ArrayLike) -> Planes:
    """`picture` with as many channels as `like`."""
    if picture.ndim < 3 or picture.shape[-1] == jnp.shape(like)[-1]:
        return picture
    space = namespace_of(picture)
    return space.broadcast_to(picture, (*picture.shape[:-1], np.shape(like)[-1]))
