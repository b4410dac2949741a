"""A measured clip and its scene file: every number with its error and its source."""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from mishutter._core.checks import Unquoted, require
from mishutter._core.files import write_text
from mishutter.measurement.clip import Clip
from mishutter.measurement.estimates import Estimate, Refusal
from mishutter.measurement.motion import Motion, MovingObject, time_of_a_row, upright
from mishutter.measurement.noise import Noise
from mishutter.model.scene import Scene, scene_of_tables
from mishutter.model.sensor import Sensor
from mishutter.model.texture import Texture
from mishutter.pictures.images import Axis, Picture, write_picture

PICTURE = "picture.png"
"""Name of the picture beside the scene file."""
VELOCITIES = "velocities.csv"
"""Name of the objects' velocities beside the scene file."""
_FAST = 0.98
"""Quantile of the speeds, by area, that the scene reaches."""
_ACROSS = (0.0, 0.1, 0.2, 0.3)
"""Speeds across over those along of which the loss of gain is known."""
_WHOLE = 0.9
"""Share that moves from which on the picture moves as a whole."""
_SHARE_ERROR = 0.05
"""Error of the share that moves, by clips of known truth."""


class AlongAxis(NamedTuple):
    """The motion along one axis of the picture."""

    axis: Axis  # The axis
    speeds: tuple[float, float]  # Least and greatest; px/s, of the sign that scenes have
    error: float  # Standard deviation of the faster; px/s
    across: float  # Fast speed across over the fast speed along
    turn: float  # Degrees by which turning the camera clockwise brings the motion onto the axis
    across_turned: float  # Speed across over that along after that
    fastest: float  # Fast speed in whatever direction; px/s

    @property
    def sentences(self) -> list[str]:
        """The share of the motion that goes across the axis, its cost, and a remedy."""
        if self.across <= 0.05:
            return [f"One axis explains the motion: {self.across:.0%} of the speed goes across it."]
        words = f"{self.across:.0%} of the speed goes across the {self.axis}, which smears"
        if self.across > _ACROSS[-1]:
            first = (
                f"No one axis explains the motion: {words}. From 30 % on that costs a moving "
                "sensor all of its gain: trust only the options at rest."
            )
        else:
            # Decibels that a design for none and one for it lose (`benchmarks/cross_motion.py`).
            cost = float(np.interp(self.across, _ACROSS, (0.0, 0.26, 0.91, 1.67)))
            designed = float(np.interp(self.across, _ACROSS, (0.0, 0.20, 0.42, 0.55)))
            first = (
                f"{words[0].upper() + words[1:]}: in the light of the built-in scene that costs "
                f"{cost:.1f} dB of a moving sensor's gain, or {designed:.1f} dB by a design for it."
            )
        sentences = [first]
        if self.across_turned < 0.7 * self.across:
            way = "clockwise" if self.turn > 0 else "anticlockwise"
            sentences.append(
                f"A camera turned by {abs(self.turn):.0f} degrees {way} has "
                f"{self.across_turned:.0%} across."
            )
        return sentences


def along_axis(objects: Sequence[MovingObject]) -> AlongAxis | None:
    """The axis of the picture along which most moves, and how fast; None if nothing does.

    A positive speed is to the left, or up.
    """
    if not objects:
        return None
    area = np.array([float(each.area) for each in objects])
    velocities = np.array([each.velocity for each in objects])
    moments = np.einsum("n,ni,nj->ij", area, velocities, velocities)
    axis: Axis = "rows" if moments[1, 1] >= moments[0, 0] else "columns"
    index = 1 if axis == "rows" else 0
    along, across = -velocities[:, index], velocities[:, 1 - index]
    fast = _quantile(np.abs(along), area, _FAST)
    ways = np.array([area[along > 0].sum(), area[along < 0].sum()]) / area.sum()
    if ways.min() >= 0.05:  # of the moving area goes the rarer way
        speeds = -fast, fast
    else:
        sign = 1.0 if ways[0] >= ways[1] else -1.0
        ends = [sign * _quantile(sign * along, area, q) for q in (1 - _FAST, _FAST)]
        speeds = min(ends), max(ends)
    errors = np.array([each.error[index] for each in objects])
    error = float(errors[int(np.argmin(np.abs(np.abs(along) - fast)))])
    direction = np.linalg.eigh(moments)[1][:, 1]
    main = np.abs(velocities @ direction)
    beside = np.abs(velocities @ np.array([-direction[1], direction[0]]))
    angle = float(np.degrees(np.arctan2(direction[0], direction[1])))
    turn = angle if axis == "rows" else angle - 90
    return AlongAxis(
        axis,
        (float(speeds[0]), float(speeds[1])),
        error,
        _ratio(_quantile(np.abs(across), area, _FAST), fast),
        (turn + 90) % 180 - 90,
        _ratio(_quantile(beside, area, _FAST), _quantile(main, area, _FAST)),
        _quantile(np.hypot(along, across), area, _FAST),
    )


def _ratio(part: float, whole: float) -> float:
    return part / whole if whole > 0 else 0.0


def _quantile(values: np.ndarray, weights: np.ndarray, share: float) -> float:
    """The least value that at least a share of the weights does not exceed."""
    return float(np.quantile(values, share, weights=weights, method="inverted_cdf"))


@dataclass(frozen=True, eq=False)
class Measurement:
    """A camera and its scene, as measured from a clip.

    Attributes:
        name: Name of the clip.
        clip: The frames.
        noise: Noise, as far as it is known, and why not.
        motion: Objects, and what stands still.
        light: The still parts, averaged, before the pixels; or what moves, before a background that
            is empty; linear light, white = 1.
        level_difference: Mean light of what moves less that of the rest.
        pixel_pitch: Pixel pitch, m; None if it was not given.
        px_per_mm: Pixels per millimetre of the scene; None if it was not given.
        sensor: When its rows are exposed; None if it was not given.
        on_empty: Whether the background is dark and empty, so that nothing is to be restored there.
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
    on_empty: bool = False

    @property
    def along(self) -> AlongAxis | None:
        """The motion along one axis of the picture; None if nothing moves."""
        return along_axis(self.motion.objects)

    @property
    def scene_text(self) -> str:
        """The scene file: each number with its error and source, or the reason for none."""
        return _scene_text(self)

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


def _scene_text(found: Measurement) -> str:
    """The text of the scene file."""
    sections = (
        _head(found),
        _speeds(found),
        _light(found),
        _sensor(found),
        _view(found),
        _occlusion(found),
        _errors(found),
        [
            "[burst]",
            f"frames_per_s = {found.clip.frames_per_s:g}  # as given",
            "# dead_time_ms = 0.1  # of the data sheet",
        ],
        _limits(found),
        [
            "# Assumed: one filter restores all speeds. A decoder that registers frames knows "
            "them.",
            "# [decoder]",
            '# speed = "known"',
        ],
        [
            f"# {'What moves' if found.on_empty else 'The still parts'}, averaged over frames; the "
            "power of their lines is that of the clip, less the noise, before the pixels.",
            "[picture]",
            f'path = "{PICTURE}"',
        ],
    )
    return "\n\n".join("\n".join(lines) for lines in sections if lines) + "\n"


def missing_keys(text: str) -> tuple[str, ...]:
    """Keys without which a scene file does not run, that a text leaves to its user."""
    tables = tomllib.loads(text)
    keys = (("light", "photon_rate_per_s"), ("sensor", "read_noise_e"))
    return tuple(f"[{s}] {key}" for s, key in keys if key not in tables.get(s, {}))


def _head(found: Measurement) -> list[str]:
    clip, (count, rows, columns) = found.clip, found.clip.frames.shape
    exposure = (
        "exposures of unknown length"
        if clip.exposure is None
        else f"exposures of {clip.exposure * 1e3:g} ms"
    )
    lines = [
        f"A scene measured by `mishutter measure` from {found.name}: {count} frames of {rows} x "
        f"{columns} at {clip.frames_per_s:g} frames/s, {exposure}.",
        "A number after +- is a standard deviation.",
    ]
    lines += [f"{word[0].upper() + word[1:]}." for word in clip.words]
    lines += [refusal.text[0].upper() + refusal.text[1:] for refusal in found.noise.refusals]
    lines.append(
        "Assumed, not measured: [limits] (the stage), [decoder], a lens that passes all that is "
        "seen, and that the clip shows what the camera will see."
    )
    return [f"# {line}" for line in lines]


def _speeds(found: Measurement) -> list[str]:
    along, lines = found.along, ["[speeds]"]
    for number, each in enumerate(found.motion.objects, 1):
        down, right = each.velocity
        lines.append(
            f"# object {number}: {right:.1f} +- {each.error[1]:.1g} px/s to the right, {down:.1f} "
            f"+- {each.error[0]:.1g} px/s down, {each.area} px"
        )
    if found.motion.share_unexplained > 0.005:
        lines.append(
            f"# {found.motion.share_unexplained:.1%} of the picture changes without a velocity: it "
            "deforms, diffuses, flickers or is too small."
        )
    if along is None:
        return [*lines, "# Nothing was seen to move.", "list_px_per_s = [0.0]"]
    lines += [f"# {sentence}" for sentence in along.sentences]
    low, high = along.speeds
    sign = "left" if along.axis == "rows" else "up"
    lines.append(
        f"# Along the {along.axis}, positive to the {sign}; the fast end is the 98 % quantile by "
        f"area, +- {along.error:.2g} px/s."
    )
    if along.across > _ACROSS[-1]:
        lines.append("# Where things move in any direction, in place of the line below:")
        lines.append(f"# any_direction = {{ max_px_per_s = {_digits(along.fastest)} }}")
    if high - low <= 4 * along.error:
        lines.append("# One speed was seen: widen this where others occur.")
        return [*lines, f"list_px_per_s = [{_digits((low + high) / 2)}]"]
    ends = f"min_px_per_s = {_digits(low)}, max_px_per_s = {_digits(high)}"
    return [*lines, f"uniform = {{ {ends}, count = 9 }}"]


def _light(found: Measurement) -> list[str]:
    electrons = found.noise.electrons_at_white
    if electrons is None:
        return ["[light]", f"# photon_rate_per_s = 1.0e5  # {_reason(found.noise.refusals)}"]
    time = found.clip.longest_exposure
    rate, error = electrons.value / time, electrons.error / time
    told = f"{electrons.value:.4g} +- {electrons.error:.2g} e- at white"
    limit = ""
    if found.clip.exposure is None:
        limit = (
            f" A LOWER LIMIT: exposures are taken for the whole {time * 1e3:g} ms between frames "
            "(give --exposure-ms)."
        )
    line = f"photon_rate_per_s = {rate:.4g}"
    note = f"# +- {error:.2g}; {told} in {time * 1e3:g} ms, {found.noise.sources[0]}.{limit}"
    return [
        "[light]",
        f"# White is level {found.clip.white:g} of the file.",
        "# Electrons are effective, by their shot noise: an EMCCD, whose excess noise doubles its "
        "variance, has twice as many.",
        f"{line}  {note}",
    ]


def _reason(refusals: Sequence[Refusal]) -> str:
    """The first reason for which a number of the noise is not known."""
    reasons = [each for each in refusals if each.number != "the level of black"]
    return f"not known: {(reasons or list(refusals))[0].reason}"


def _sensor(found: Measurement) -> list[str]:
    noise, lines = found.noise, ["[sensor]"]
    if noise.read_noise is None:
        lines.append(f"# read_noise_e = 4.0  # {_reason(noise.refusals)}")
    else:
        value, error = noise.read_noise
        source = noise.sources[1]
        if noise.read_noise_range is not None:
            low, high = noise.read_noise_range
            source = f"anywhere from {low:.2g} to {high:.2g}: {source}"
        lines.append(f"read_noise_e = {value:.3g}  # +- {error:.2g}; {source}.")
    if noise.black is not None:
        told = f"level {noise.black.value:.5g} +- {noise.black.error:.2g}, {noise.sources[2]}"
        lines.append(f"# Black is {told}.")
    else:
        lines.append(
            f"# Black lies from level {noise.black_range[0]:.4g} to {noise.black_range[1]:.4g}."
        )
    if noise.gain is not None:
        lines.append(
            f"# System gain {noise.gain.value:.4g} +- {noise.gain.error:.2g} levels per electron."
        )
    axis = "rows" if found.along is None else found.along.axis
    rows, columns = found.clip.frames.shape[1:]
    width = columns if axis == "rows" else rows
    lines += [f'axis = "{axis}"', f"width_px = {width}  # of the frames, along the axis"]
    if found.pixel_pitch is not None:
        lines.append(f"pixel_pitch_um = {found.pixel_pitch * 1e6:.6g}  # as given")
    else:
        lines.append("# pixel_pitch_um = 3.45  # not told (--pixel-pitch-um)")
    if found.sensor is not None:
        lines.append(f"readout_ms = {found.sensor.readout_time * 1e3:.6g}  # as given")
        if found.sensor.is_rolling:
            lines.append(f'rows_read = "{found.sensor.rows_read}"')
    lines.append("# full_well_e = 10000  # of the data sheet")
    return lines


def _view(found: Measurement) -> list[str]:
    if found.px_per_mm is None:
        return []
    return [
        "[view]",
        f"px_per_mm = {found.px_per_mm:.6g}  # as given; the fastest moves at "
        f"{_fastest(found) / found.px_per_mm:.4g} mm/s",
    ]


def _occlusion(found: Measurement) -> list[str]:
    motion, along = found.motion, found.along
    share = 1 - motion.share_at_rest
    if along is None:
        return []
    row = time_of_a_row(found.sensor, motion.labels.shape[0])
    narrowest = f"width_px = {_narrowest(motion, along.axis, row):.1f}  # of the narrowest"
    if found.on_empty:
        why = "# No [occlusion]: the background is dark and empty, and levels are of what moves."
        return [why, "[objects]", f"{narrowest} along the {along.axis}"]
    if share >= _WHOLE:
        moves = f"# No [occlusion]: {share:.0%} of the picture moves"
        if len(motion.objects) == 1:
            return [f"{moves}, and is taken to move as a whole."]
        return [f"{moves}, object by object.", "[objects]", f"{narrowest} along the {along.axis}"]
    width = motion.width[0 if along.axis == "rows" else 1]
    difference = found.level_difference
    key = f"level_difference = {difference.value:.3f}"
    note = f"+- {difference.error:.2g}; mean light of what moves less that of the rest"
    is_known = np.isfinite(difference.error)
    return [
        "[occlusion]",
        f"front_share = {share:.3f}  # +- {_SHARE_ERROR:g}; share that moves",
        f"object_width_px = {width:.1f}  # mean length along the {along.axis} of what moves",
        f"{key}  # {note}" if is_known else f"# {key}  # {note}",
        'background = "still"  # the camera stood still',
        "# For a decoder that registers objects one by one:",
        "# [objects]",
        f"# {narrowest}",
    ]


def _narrowest(motion: Motion, axis: Axis, row: float = 0.0) -> float:
    """Mean width along an axis of the narrowest object in the reference frame; px."""
    lines, widths = 1 if axis == "rows" else 0, []
    # Objects are slanted and stretched by rows that are exposed one after another.
    labels = upright(motion.labels, [each.velocity[1] * row for each in motion.objects])
    for number in np.unique(labels[labels > 0]):
        mask = labels == number
        share = 1.0 if lines else 1 - motion.objects[number - 1].velocity[0] * row
        widths.append(share * float(mask.sum() / mask.any(axis=lines).sum()))
    return min(widths, default=motion.width[1 - lines])


def _errors(found: Measurement) -> list[str]:
    """The errors again, as `optimise` reads them."""
    noise, along = found.noise, found.along
    rate = noise.electrons_at_white
    is_covered = along and not found.on_empty and 1 - found.motion.share_at_rest < _WHOLE
    errors = {
        "photon_rate_per_s": rate and rate.error / found.clip.longest_exposure,
        "read_noise_e": noise.read_noise and noise.read_noise.error,
        "object_speed_px_per_s": along and along.error,
        "front_share": _SHARE_ERROR if is_covered else None,
    }
    lines = [f"{key} = {error:.2g}" for key, error in errors.items() if error is not None]
    note = "# The errors above: the answer says how far the gain moves within two of each."
    return [note, "[errors]", *lines] if lines else []


def _limits(found: Measurement) -> list[str]:
    # A scene file may have no object that goes further than 10,000 px over an exposure.
    longest = min(80.0, 1e4 / max(_fastest(found), 1e-9) * 1e3)
    reach = ["max_stroke_mm = 0.155", "max_top_speed_mm_per_s = 69"]
    if found.pixel_pitch is None:
        reach = ["max_stroke_px = 45", "max_top_speed_px_per_s = 20000"]
    return [
        "# Assumed: the piezo stage of the built-in scene. Write what yours does.",
        "[limits]",
        *reach,
        "min_exposure_ms = 1",
        f"max_exposure_ms = {_digits(longest)}",
    ]


def _fastest(found: Measurement) -> float:
    """Greatest speed along the axis; px/s."""
    return 0.0 if found.along is None else max(map(abs, found.along.speeds))


def _digits(value: float) -> str:
    """Four digits of a number, as TOML writes it."""
    return f"{float(f'{value:.4g}')}"
