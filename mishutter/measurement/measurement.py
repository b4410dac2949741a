"""A camera and what it sees, measured from a clip: from frames to a scene."""

import tomllib
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from mishutter._core.checks import Unquoted, require, require_finite
from mishutter._core.files import write_text
from mishutter._core.progress import counts
from mishutter.measurement.clip import Clip, Source, clip_of, read_levels_of
from mishutter.measurement.estimates import Estimate
from mishutter.measurement.motion import Motion, motion_of, read_in_turn
from mishutter.measurement.noise import Noise, noise_of
from mishutter.measurement.scene import PICTURE, AlongAxis, along_axis, missing_keys, scene_text
from mishutter.measurement.signs import detail_excess, is_moved, shot_gamma
from mishutter.measurement.steady import bands_of_light, steady
from mishutter.measurement.texture import averaged, is_mosaic, light_of_texture
from mishutter.model.scene import Scene, scene_of_tables
from mishutter.model.scene_units import View
from mishutter.model.sensor import RowsRead, Sensor
from mishutter.model.texture import Texture
from mishutter.pictures.images import Picture, write_picture

VELOCITIES = "velocities.csv"
"""Name of the objects' velocities beside the scene file."""


@dataclass(frozen=True, eq=False)
class Measurement:
    """A camera and its scene, as measured from a clip.

    Attributes:
        name: Name of the clip.
        clip: The frames.
        noise: Noise, as far as it is known, and why not.
        motion: Objects, and what stands still.
        light: The still parts, averaged, before the pixels; linear light, white = 1.
        level_difference: Mean light of what moves less that of the rest.
        pixel_pitch: Pixel pitch, m; None if it was not given.
        px_per_mm: Pixels per millimetre of the scene; None if it was not given.
        sensor: When its rows are exposed; None if it was not given.
    """

    name: str
    clip: Clip
    noise: Noise
    motion: Motion
    light: Float[np.ndarray, "rows columns 1"]
    level_difference: Estimate
    pixel_pitch: float | int | None
    px_per_mm: float | int | None
    sensor: Sensor | None = None

    @property
    def along(self) -> AlongAxis | None:
        """The motion along one axis of the picture; None if nothing moves."""
        return along_axis(self.motion.objects)

    @property
    def scene_text(self) -> str:
        """The scene file: each number with its error and source, or the reason for none."""
        return scene_text(self)

    @property
    def missing(self) -> tuple[str, ...]:
        """Keys of the scene file that its user has to write: the clip does not tell them."""
        return missing_keys(self.scene_text)

    @property
    def scene(self) -> Scene:
        """The scene that the file holds.

        Raises:
            ValueError: if the clip does not tell the light or the read noise; the reason why.
        """
        reasons = "; ".join(each.text for each in self.noise.refusals)
        got = Unquoted(reasons or "nothing")
        require(not self.missing, "Measurement.scene", "have light and noise", got)

        def texture(*_: object) -> Texture:
            axis = "rows" if self.along is None else self.along.axis
            return Texture.of_photograph(Picture(self.light), PICTURE, axis=axis)

        return scene_of_tables(tomllib.loads(self.scene_text), self.name, Path(), texture)

    def save(self, path: str | Path) -> list[str]:
        """Write the scene file, and beside it its picture and the velocities.

        Args:
            path: The scene file, `.toml`.

        Returns:
            Names of the files.

        Raises:
            ValueError: if the name ends otherwise.
            OSError: if a file cannot be written.
        """
        path = Path(path)
        is_toml = path.suffix.lower() == ".toml"
        require(is_toml, "Measurement.save(path=...)", "end in `.toml`", str(path))
        write_picture(path.with_name(PICTURE), self.light)
        write_text(path.with_name(VELOCITIES), self.velocities_text)
        write_text(path, self.scene_text)
        return [path.name, PICTURE, VELOCITIES]

    @property
    def velocities_text(self) -> str:
        """The objects as CSV: velocity to the right and down, errors, area, lead and residual."""
        lines = [
            "object,right_px_per_s,right_error_px_per_s,down_px_per_s,down_error_px_per_s,"
            "area_px,lead,residual,frame,column_px,row_px"
        ]
        for number, each in enumerate(self.motion.objects, 1):
            (down, right), (down_error, right_error) = each.velocity, each.error
            values = (right, right_error, down, down_error)
            row, column = each.centre
            lines.append(
                f"{number},{','.join(f'{value:.6g}' for value in values)},{each.area},"
                f"{each.lead:.4g},{each.residual:.4g},{each.frame},{column:.1f},{row:.1f}"
            )
        return "\n".join(lines) + "\n"

    def to_dict(self) -> dict[str, object]:
        """The numbers, as strict JSON holds them."""
        noise, motion, along = self.noise, self.motion, self.along
        numbers = {
            "electrons_at_white": noise.electrons_at_white,
            "read_noise_e": noise.read_noise,
            "black_level": noise.black,
            "gain_levels_per_e": noise.gain,
        }
        return {
            "frames": self.clip.num_frames,
            "words": list(self.clip.words),
            "noise": {name: value and value._asdict() for name, value in numbers.items()},
            "read_noise_range_e": noise.read_noise_range and list(noise.read_noise_range),
            "refusals": [each._asdict() for each in noise.refusals],
            "missing": list(self.missing),
            "objects": [
                {
                    "right_px_per_s": each.velocity[1],
                    "right_error_px_per_s": each.error[1],
                    "down_px_per_s": each.velocity[0],
                    "down_error_px_per_s": each.error[0],
                    "area_px": each.area,
                    "lead": each.lead,
                    "residual": each.residual,
                }
                for each in motion.objects
            ],
            "share_at_rest": motion.share_at_rest,
            "share_without_velocity": motion.share_unexplained,
            "axis": None if along is None else along.axis,
            "speeds_px_per_s": None if along is None else list(along.speeds),
            "share_across": None if along is None else along.across,
        }

    @property
    def sentences(self) -> list[str]:
        """Findings in words: light, noise, motion, and what is not known."""
        noise, motion = self.noise, self.motion
        lines = []
        if noise.electrons_at_white is not None:
            value, error = noise.electrons_at_white
            lines.append(f"White holds {value:.4g} +- {error:.2g} photo-electrons.")
        if noise.read_noise_range is not None and noise.read_noise is not None:
            low, high = noise.read_noise_range
            lines.append(
                f"The read noise lies from {low:.2g} to {high:.2g} e-: black is not known."
            )
        elif noise.read_noise is not None:
            value, error = noise.read_noise
            lines.append(f"The read noise is {value:.3g} +- {error:.2g} e-.")
        lines += [each.text[0].upper() + each.text[1:] for each in noise.refusals]
        lines += [f"{word[0].upper() + word[1:]}." for word in self.clip.words]
        count = len(motion.objects)
        lines.append(
            f"{motion.share_at_rest:.0%} of the picture stands still, and {count} "
            f"object{'s' * (count != 1)} move{'s' * (count == 1)}."
            if count
            else "Nothing was seen to move."
        )
        if motion.share_unexplained > 0.005:
            share = f"{motion.share_unexplained:.1%} of the picture"
            lines.append(f"{share} changes without a velocity: it deforms, diffuses or flickers.")
        if self.along is not None:
            lines += self.along.sentences
        return lines


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
        motion = motion_of(unit, frames.frames_per_s)
        if sensor is not None:
            delays = sensor.row_delays(frames.frames.shape[1])
            motion = read_in_turn(motion, float(np.mean(np.diff(delays))))
        for word in motion.words:
            frames = frames.with_frames(frames.frames, word)
        picture = averaged(frames.frames, unit, motion, frames.frames_per_s)
        if is_mosaic(picture.levels):
            word = (
                "pixels alternate as under a mosaic of colour filters, which the picture holds as "
                "texture: measure one colour alone"
            )
            frames = frames.with_frames(frames.frames, word)
        along = along_axis(motion.objects)
        axis = "rows" if along is None else along.axis
        ends = noise.black_level, frames.white
        light = light_of_texture(picture, motion.labels == 0, noise.law, ends, axis)
        levels = (picture.levels - ends[0]) / (ends[1] - ends[0])
    difference = _level_difference(levels, motion)
    name = Path(name).name if name else "an array"
    return Measurement(
        name, frames, noise, motion, light, difference, pixel_pitch, px_per_mm, sensor
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
    read = {
        key: None if source is None else read_levels_of(source, f"measure({key}=...)").frames
        for key, source in others.items()
    }
    alike = steady(clip.frames, clip.step)
    told = None if black is None else float(black)
    noise = noise_of(clip, alike, read["dark"], read["flats"], told)
    for word in alike.words:
        clip = clip.with_frames(alike.same, word)
    bands = bands_of_light(alike.same)
    if bands:
        word = (
            f"the light differs by {bands:.1%} in bands of rows that change from frame to frame: "
            "lamps flicker on the mains while rows are read one after another, and noise may be "
            "too high; take daylight, or lamps on direct current"
        )
        clip = clip.with_frames(clip.frames, word)
    if noise.transfer is not None and noise.electrons_at_white is not None:
        excess = detail_excess(clip, alike, noise.transfer)
        if is_moved(excess):
            word = (
                f"what has detail has {excess.value:.0%} more noise: the camera, its focus or what "
                "it sees moves a little, and noise may be too high"
            )
            clip = clip.with_frames(clip.frames, word)
    if noise.transfer is not None and noise.electrons_at_white is not None and dark is None:
        gamma = shot_gamma(noise.transfer, clip.step)
        if gamma is not None:
            word = f"a gamma of {gamma:.2g} with little read noise would explain the noise as well"
            clip = clip.with_frames(clip.frames, word)
    return clip, noise


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
