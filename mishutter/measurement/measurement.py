"""A camera and what it sees, measured from a clip: from frames to a scene."""

from pathlib import Path

import numpy as np

from mishutter._core.checks import Unquoted, require, require_finite
from mishutter._core.progress import counts
from mishutter.measurement.clip import Clip, Source, clip_of, read_levels_of
from mishutter.measurement.estimates import Estimate
from mishutter.measurement.motion import Motion, motion_of, read_in_turn, time_of_a_row
from mishutter.measurement.noise import Noise, noise_of, require_others
from mishutter.measurement.pan import registered
from mishutter.measurement.scene import Measurement, along_axis
from mishutter.measurement.signs import detail_excess, is_moved, shot_gamma
from mishutter.measurement.steady import steady
from mishutter.measurement.texture import averaged, is_empty, is_mosaic, light_of_texture
from mishutter.model.scene_units import View
from mishutter.model.sensor import RowsRead, Sensor


def measure(
    clip: Source,
    *,
    frames_per_s: float | int,
    exposure: float | int | None = None,
    dark: Source | None = None,
    flats: Source | None = None,
    black: float | int | None = None,
    white: float | int | None = None,
    pixel_pitch: float | int | None = None,
    px_per_mm: float | int | None = None,
    readout: float | int | None = None,
    rows_read: RowsRead = "down",
    progress: bool = False,
) -> Measurement:
    r"""Measure noise, velocities and texture from a clip of a camera at rest.

    Noise is by photon transfer over frames: the variance of what stands still is a line in its
    level, $k(m - b) + s^2$, of the system gain $k$ and the temporal dark noise $s$ (EMVA 1288).
    Velocities are those along which successive frames differ by noise alone.

    Args:
        clip: Frames at equal times of one exposure, uncompressed and linear: PNG, TIFF (each
            page, or those of the first channel), PGM or `.npy` files, a folder of them in the order
            of their numbers, or levels of shape `(frames, rows, columns)`, 8 to 16 bits.
        frames_per_s: Frames a second.
        exposure: Exposure of a frame, s. Without it the rate of photons is a lower limit.
        dark: Frames of a covered lens with the same settings; two or more tell the read noise.
        flats: Pairs of flat fields, two frames at each exposure, one pair after the other.
        black: Level of black, if it is known without dark frames.
        white: Level of white [default: the greatest of the file's depth].
        pixel_pitch: Distance of the sensor's pixels; m.
        px_per_mm: Pixels of a millimetre of things.
        readout: Time from the exposure of the first row to that of the last, of a sensor whose rows
            are exposed one after another; s. Velocities and heights are those that all rows at once
            would show.
        rows_read: Whether they are read `"down"` or `"up"`.
        progress: Whether progress is shown on standard error.

    Returns:
        The measurement; `.scene` is the scene, `.save("scene.toml")` its file.

    Raises:
        ValueError: if the frames are no clip: compressed with loss, fewer than two, of several
            sizes, repeated, not finite; or a number is out of its range.
        OSError: if a file cannot be read.

    Examples:
        >>> import numpy as np
        >>> from mishutter import measure
        >>> rng = np.random.default_rng(0)
        >>> light = np.linspace(100, 2000, 96)  # electrons
        >>> frames = rng.poisson(np.tile(light, (6, 96, 1))) + rng.normal(64, 5, (6, 96, 96))
        >>> found = measure(np.rint(frames).astype(np.uint16), frames_per_s=50, black=64)
        >>> round(found.noise.gain.value, 1)
        1.0
    """
    View(pixel_pitch=pixel_pitch, px_per_mm=px_per_mm)
    sensor = None if readout is None else Sensor(readout=readout, rows_read=rows_read)
    if readout is not None:
        require_finite("measure(readout=...)", readout)
        requirement = f"be at least 0, within the {1e3 / frames_per_s:g} ms from frame to frame"
        is_read = 0 <= readout <= 1 / frames_per_s
        require(is_read, "measure(readout=...)", requirement, Unquoted(f"{readout * 1e3:g} ms"))
    name = clip.name if isinstance(clip, Path) else clip if isinstance(clip, str) else ""
    if not isinstance(clip, str | Path | np.ndarray):
        name = f"{Path(next(iter(clip), '')).name} and others"
    with counts(progress, "measuring", 2) as counter:
        counter.next("noise")
        frames = clip_of(clip, frames_per_s, exposure, white)
        frames, noise = noise_from(frames, dark=dark, flats=flats, black=black)
        counter.next("velocities")
        unit = noise.law.of_unit_noise(frames.frames)
        row = time_of_a_row(sensor, frames.frames.shape[1])
        seen = motion_of(unit, frames.frames_per_s, row)
        frames = frames.with_words(seen.words)
        # Frames follow one another by the velocities that they show.
        picture = averaged(frames.frames, unit, seen, frames.frames_per_s)
        motion = read_in_turn(seen, row)
        if is_mosaic(picture.levels):
            word = (
                "pixels alternate as under a mosaic of colour filters, which the picture holds as "
                "texture: measure one colour alone"
            )
            frames = frames.with_words([word])
        along = along_axis(motion.objects)
        axis = "rows" if along is None else along.axis
        ends = noise.black_level, frames.white
        levels = (picture.levels - ends[0]) / (ends[1] - ends[0])
        at_rest, mean = motion.labels == 0, None
        on_empty = is_empty(picture, at_rest, noise.law, ends[0])
        if on_empty:  # the picture is that of the objects
            at_rest, mean = ~at_rest, float(levels[~at_rest].mean())
        light = light_of_texture(picture, at_rest, noise.law, ends, axis, mean=mean)
    difference = _level_difference(levels, motion)
    name = Path(name).name if name else "an array"
    return Measurement(
        name, frames, noise, motion, light, difference, pixel_pitch, px_per_mm, sensor, on_empty
    )


def noise_from(
    clip: Clip,
    *,
    dark: Source | None = None,
    flats: Source | None = None,
    black: float | int | None = None,
) -> tuple[Clip, Noise]:
    """The frames of a clip, made alike, and their noise; see `measure`."""
    others = {"dark": dark, "flats": flats}
    levels = {
        key: read_levels_of(source, f"measure({key}=...)")
        for key, source in others.items()
        if source is not None
    }
    require_others(clip, levels, black)
    read = {key: levels[key].frames if key in levels else None for key in others}
    whole = registered(clip.frames)
    frames, ways = whole or (clip.frames, None)
    alike = steady(frames, clip.step, ways)
    told = None if black is None else float(black)
    noise = noise_of(clip, alike, read["dark"], read["flats"], told)
    words = [*alike.words]
    is_corrected = ways is None and (alike.drift > 0 or alike.bands > 0 or alike.moves is not None)
    if noise.transfer is not None and noise.electrons_at_white is not None:
        excess = detail_excess(clip, alike, noise.transfer)
        if is_moved(excess):
            words.append(
                f"what has detail has {excess.value:.0%} more noise: the camera, its focus or what "
                "it sees moves a little, and noise may be too high"
            )
        gamma = shot_gamma(noise.transfer, clip.step) if dark is None else None
        if gamma is not None:
            words.append(
                f"a gamma of {gamma:.2g} with little read noise would explain the noise as well"
            )
    return clip.with_words(words, alike.same if is_corrected else None), noise


def _level_difference(levels: np.ndarray, motion: Motion) -> Estimate:
    """Mean of what moves less that of the rest, whose errors are those of means over squares."""
    each = []
    for mask in (motion.labels > 0, motion.labels == 0):
        if not mask.any():
            return Estimate(0.0, np.inf)
        rows, columns = np.indices(levels.shape) // 32  # px
        number = (rows * (columns.max() + 1) + columns)[mask]
        total = np.bincount(number, levels[mask])
        count = np.bincount(number)
        means = total[count > 0] / count[count > 0]
        each.append((float(levels[mask].mean()), float(means.var() / means.size)))
    (front, front_error), (back, back_error) = each
    return Estimate(front - back, float(np.sqrt(front_error + back_error)))
