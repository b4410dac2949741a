r"""The frames of a sequence: what a moving picture leaves in each, where the sensor then is.

A thing that is at the column $u$ of the sensor at the middle of the sequence is displaced by
$c_k(t) - s\,t$ at the time $t$ of the sequence, where $c_k$ is the place of the sensor. All frames
share that frame of reference, and so do the pictures that are restored from them.

"The paper" is "Improved motion invariant imaging with time varying shutter functions".
"""

import math
from collections.abc import Iterator, Sequence

import jax
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from mishutter._core.checks import (
    RowLike,
    as_float,
    require,
    require_finite,
    require_key,
    require_known,
    require_scalar,
)
from mishutter._core.parallel import alone_in_blas
from mishutter.camera.capture import as_radiance, distinct_colours, every_colour, recorded_by
from mishutter.camera.layers import Layers
from mishutter.camera.occlusion import expose_layers_in_frame
from mishutter.camera.plane_frames import exposed_in_plane
from mishutter.camera.plane_layers import layers_in_plane
from mishutter.camera.responses import aperture_on, waves_of
from mishutter.camera.rows import (
    Planes,
    bands_of,
    channels_last,
    continued,
    instants_within_reach,
    period_of,
    rows_last,
    seen_in_turn,
    window_of,
)
from mishutter.evaluation.instants import Instants
from mishutter.model.exposures import Exposures, open_frames, path_for_rows
from mishutter.model.frame_path import Frames, PlaneFrames, TimedFrame
from mishutter.model.scene import Scene, require_scene
from mishutter.pictures.images import Picture, pixels_along, transposed


@alone_in_blas()
def simulate_frames(
    picture: Picture | Layers | ArrayLike,
    scene: Scene,
    frames: Frames | Exposures,
    *,
    speed: float | RowLike = 0.0,
    num_columns: int | None = None,
    num_rows: int | None = None,
    key: Array | None = None,
    full_well: float | None = None,
    adc_bits: int | None = None,
) -> Float[Array, "frames ..."]:
    r"""Simulate the frames that a camera takes of a picture that moves as a whole, or of layers.

    The sensor lies over the middle of the picture at the middle of the sequence, when layers are at
    their own places. Where the picture is wider than the sensor, light enters and leaves at real
    borders; beyond the picture it goes on mirrored. Layers hide one another at every instant of
    each frame. The noise is that of the paper's equation (4) in each frame.

    Args:
        picture: Light, white = 1, shape `(rows, columns)` or with channels last. Or `Layers`, which
            bring their own speeds and borders.
        scene: Light, noise, optics and axis; its speeds are not used.
        frames: The frames, with open shutters: `TimedFrame`s, `PlaneFrames`, or `Exposures`, as
            `best_sequence` finds them.
        speed: Speed of the picture; px/s, as that of `simulate_capture`; 0 for layers. For frames
            in the plane its velocity along rows and columns: to the left and up.
        num_columns: Pixels of the sensor along the motion, or along the rows for frames in the
            plane; those of the picture by default.
        num_rows: Pixels of the sensor down the columns, for frames in the plane; those of the
            picture by default.
        key: JAX key of the noise; None for none.
        full_well: Most electrons a pixel holds, e-; by default as many as the scene says.
        adc_bits: Bits of the converter; None for no rounding.

    Returns:
        Light of each frame in units of its exposure of white; shape `(frames, rows, num_columns)`,
        channels last where the picture has some.

    Raises:
        ValueError: if the frames are no frames or have a shaped shutter, a speed stands beside
            layers, it is no velocity for frames in the plane or is one for others, the sensor is
            larger than the picture, or light is displaced by more than 8,192 px.
    """
    require_scene(scene, in_plane=True)
    frames = open_frames("simulate_frames(frames=...)", frames)
    require_scene(scene, in_plane=isinstance(frames, PlaneFrames))
    require_known("simulate_frames", speed=speed, frames=frames)
    subject = "simulate_frames(speed=...)"
    if isinstance(picture, Layers):
        require(not np.any(speed), subject, "be left to layers", speed)
        value = np.zeros(2)
    else:
        value = require_speed(subject, speed, frames)
    require_key("simulate_frames(key=...)", key)
    if isinstance(frames, PlaneFrames):
        frames = frames.for_rows(scene.sensor.readout_time, scene.limits)
        size = num_rows, num_columns
        if isinstance(picture, Layers):
            exposed = layers_in_plane(picture, scene, frames, size)
        else:
            radiance = as_radiance(picture, "simulate_frames(picture=...)")
            exposed = exposed_in_plane(radiance, scene, frames, value, size)
        axis, exposures = "rows", np.asarray(frames.exposures).tolist()
    else:
        require(len(frames) > 0, "simulate_frames(frames=...)", "hold one frame at least", 0)
        subject = "simulate_frames(num_rows=...)"
        require(num_rows is None, subject, "be left out along one axis", num_rows)
        if isinstance(picture, Layers):
            exposed = _layers_in_frames(picture, scene, frames, num_columns)
        else:
            radiance = as_radiance(picture, "simulate_frames(picture=...)")
            exposed = _picture_in_frames(radiance, scene, frames, float(value), num_columns)
        axis, exposures = scene.sensor.axis, [frame.exposure for frame in frames]
    count = len(exposures)
    keys = [None] * count if key is None else list(jax.random.split(key, count))
    most = None if full_well is None else float(full_well)
    levels = []
    for exposure, irradiance, one in zip(exposures, exposed, keys, strict=True):
        level = recorded_by(scene, irradiance, exposure, one, full_well=most, adc_bits=adc_bits)
        levels.append(np.asarray(transposed(level, axis)))
    return as_float(np.stack(levels))


def require_speed(
    subject: str, speed: float | RowLike, frames: Sequence[TimedFrame] | PlaneFrames
) -> Float[np.ndarray, "..."]:
    """A speed along one axis, or a velocity for frames in the plane; px/s."""
    require_finite(subject, speed)
    value = np.asarray(speed, np.float64)
    if isinstance(frames, PlaneFrames):
        words = "be a velocity along rows and columns, as (1500, -800), for frames in the plane"
        require(value.shape == (2,), subject, words, speed)
    else:
        require_scalar(subject, value)
    return value


def _picture_in_frames(
    radiance: Planes,
    scene: Scene,
    frames: Sequence[TimedFrame],
    speed: float,
    num_columns: int | None,
) -> Iterator[Planes]:
    """Irradiance of the sensor in each frame of a picture that moves as a whole."""
    radiance = transposed(radiance, scene.sensor.axis)
    axis, num_pixels = scene.sensor.axis, radiance.shape[-1 if radiance.ndim == 2 else -2]
    window = window_of(num_pixels, num_columns, "num_columns", pixels_along(axis))
    subject, along = "simulate_frames(speed=..., frames=...)", axis == "columns"
    path = path_for_rows(scene, frames) if scene.sensor.is_rolling else frames
    planes = np.asarray(rows_last(distinct_colours(radiance)))
    num_rows = window.stop - window.start if along else planes.shape[-2]
    delays = scene.sensor.row_delays(num_rows)[: None if scene.sensor.is_rolling else 1].tolist()
    velocity = np.array([speed])
    nodes = [instants_within_reach(subject, path, velocity, delay) for delay in delays]
    reach = max(each.reach(velocity[None])[0] for each in nodes)
    period = period_of(planes.shape[-1], math.ceil(reach), "reflect")
    spectrum = np.fft.rfft(np.asarray(continued(planes, period, "reflect")))
    aperture = aperture_on(scene.optics, (period,))
    for k in range(len(frames)):
        each = [waves_of(x.some([k]), velocity[None], (period,))[0] for x in nodes]
        response = np.concatenate(each) * aperture
        is_along = along and len(nodes) > 1
        irradiance = seen_in_turn(spectrum, response, window, period, is_along=is_along)
        yield every_colour(channels_last(irradiance.astype(planes.dtype), radiance), radiance)


def _layers_in_frames(
    layers: Layers, scene: Scene, frames: Sequence[TimedFrame], num_columns: int | None
) -> Iterator[Planes]:
    """Irradiance of the sensor in each frame of layers, which hide one another."""
    layers = layers.transposed(scene.sensor.axis)
    words = pixels_along(scene.sensor.axis)
    window = window_of(layers.shape[1], num_columns, "num_columns", words)
    speeds = [layer.along_rows for layer in layers.layers]
    for speed in speeds:
        instants_within_reach("Layer(speed=...)", frames, np.array([float(speed)]))
    # Images that change while they are displaced ask for nodes for both.
    swiftest = max(float(frame.motion.top_speed) for frame in frames)
    fastest, along = 2 * max(map(abs, speeds)) + swiftest, scene.sensor.axis == "columns"
    path = path_for_rows(scene, frames) if scene.sensor.is_rolling else frames
    num_rows = window.stop - window.start if along else layers.shape[0]
    bands = bands_of(scene.sensor, num_rows, fastest)
    nodes = [Instants.of(path, fastest, delay=band.delay) for band in bands]
    for index in range(len(frames)):
        parts = []
        for instants, band in zip(nodes, bands, strict=True):
            own = layers if along else layers.on_rows(band.rows)
            light = expose_layers_in_frame(own, instants.some([index]), scene.optics)[:, window]
            parts.append(light[:, band.rows] if along else light)
        yield np.concatenate(parts, axis=1 if along else 0)
