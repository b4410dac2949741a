r"""Units that people have, as pixels, seconds and electrons: the one place that converts.

Way: a thing of size 1 is $M$ on the sensor, and $M/p$ px by the pitch $p$. A thin lens of focal
length $f$ at a distance $d$ from things has $M = f/(d - f)$. What is far away and turns by a small
angle moves by $f$ times it on the sensor, in the middle of the picture.

Light: a white, diffuse surface under an illuminance $E$ has the luminance $E/\pi$, and a lens of
f-number $N$ and transmission $t$ collects it on the sensor from a cone of
$\sin\theta = 1/(2N(1 + M))$: $E\,t/(2N(1 + M))^2$. Sunlight of 54 lx brings 1 umol of photons
between 400 and 700 nm a second and square metre (Thimijan and Heins, "Photometric, radiometric, and
quantum light units of measure", HortScience 18, 1983); cool white fluorescent lamps take 74 lx for
it, high-pressure sodium lamps 82, incandescent lamps 50.
"""

import math
import re
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, final

import numpy as np

from mishutter._core.checks import (
    Numbers,
    RowLike,
    Unquoted,
    as_numpy,
    fields_text,
    require,
    require_at_least,
    require_finite,
    require_number,
)
from mishutter._core.validation import Section
from mishutter.model.arguments import argument_names
from mishutter.model.scene_schema import SPEED_UNITS, Light, SensorSection, ViewSection

GRAVITY = 9.80665
"""Standard gravity; m/s^2."""
_METRES = {
    "um": 1e-6,
    "mm": 1e-3,
    "m": 1.0,
    "um_per_s": 1e-6,
    "mm_per_s": 1e-3,
    "m_per_s": 1.0,
    "km_per_h": 1 / 3.6,
    "g": GRAVITY,
    "g_per_s": GRAVITY,
}
"""Units in metres and seconds, as the names of keys end in them."""
_PHOTONS_PER_LUX = 6.02214076e23 * 1e-6 / 54
"""Photons of sunlight between 400 and 700 nm by lux, second and square metre: 1.1e16."""
_NOTHING = Unquoted("nothing")
FASTEST = 1e7
"""Greatest speed of a thing, px/s."""
_KEYS = {
    "magnification": "[view] magnification",
    "px_per_mm": "[view] px_per_mm",
    "distance": "[view] distance_m",
    "focal_length": "[view] focal_length_mm",
    "pixel_pitch": "[sensor] pixel_pitch_um",
}
"""Arguments of `View` as a scene file calls them."""


class SceneWarning(UserWarning):
    """A scene is read, but has a number that no camera has."""


def _text(unit: str) -> str:
    """A unit as people write it, of the end of a key's name."""
    return unit.replace("_per_", "/")


_MICRO = str.maketrans("\u00b5\u03bc", "uu")
"""Both micro signs, as what stands for them in names of units."""


@final
@dataclass(frozen=True, kw_only=True, repr=False)
class View:
    """Size of things in the picture, which turns speeds and widths in their own units into pixels.

    One of `magnification`, `px_per_mm`, and `distance` with `focal_length` says how large things
    are; degrees a second need `focal_length` alone, and a stage `pixel_pitch` alone. It is the
    `[view]` of a scene file.

    Args:
        magnification: Size on the sensor over that of things; 1.
        px_per_mm: Pixels of a millimetre of things, by a ruler in the picture; px/mm.
        distance: From a thin lens to things; m.
        focal_length: Of the lens; m.
        pixel_pitch: Distance of the sensor's pixels; m.
        keys: Names of the arguments in errors, where they come from a file.

    Raises:
        ValueError: if a number is not above 0, the size is given in several ways, or in half of
            one, or the distance is within the focal length.
    """

    magnification: float | int | None = None
    px_per_mm: float | int | None = None
    distance: float | int | None = None
    focal_length: float | int | None = None
    pixel_pitch: float | int | None = None
    keys: Mapping[str, str] | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        for name in _KEYS:
            value = getattr(self, name)
            if value is not None:
                require_number(self._subject(name), value, "a number above 0", strict=True)
        ways = ("magnification", "px_per_mm", "distance")
        told = [self._bare(name) for name in ways if getattr(self, name) is not None]
        requirement = f"hold one of magnification, px_per_mm and {self._bare('distance')}"
        require(len(told) <= 1, self._whole, requirement, Unquoted(" and ".join(told)))
        f, d = self.focal_length, self.distance
        if d is not None:
            beside = f"be given where {self._bare('distance')} is"
            require(f is not None, self._subject("focal_length"), beside, _NOTHING)
            beyond = f"be beyond the focal length, {f:g} m"
            require(d > f, self._subject("distance"), beyond, d)  # type: ignore[operator]
        pitch, magnification = self.pixel_pitch, self._magnification
        # A pixel that covers more than 5 cm of things hints at a distance in mm.
        covered = pitch / magnification if d and pitch and magnification else 0.0
        if covered > 0.05:
            doubt = f"at {self._bare('distance')} = {d:g} a pixel covers {covered * 1e3:.3g} mm"
            warnings.warn(f"{doubt} of things; distances are in m", SceneWarning, stacklevel=3)

    def __repr__(self) -> str:
        return fields_text(self)

    def speed(self, value: RowLike, unit: str) -> Numbers | np.floating:
        """Speeds of things on the sensor; px/s, in the shape of `value`.

        Args:
            value: Speeds in the unit.
            unit: `"px/s"`, `"um/s"`, `"mm/s"`, `"m/s"`, `"km/h"`, or `"deg/s"` of a camera that
                turns and of what is far away.

        Raises:
            ValueError: if the view lacks what the unit needs.
        """
        key = _unit("View.speed", unit, SPEED_UNITS)
        return _numbers("View.speed", value) * self.px_of_things(key, f"a speed in {unit}")

    def length(self, value: RowLike, unit: str) -> Numbers | np.floating:
        """Lengths of things on the sensor; px, in the shape of `value`.

        Args:
            value: Lengths in the unit.
            unit: `"px"`, `"um"`, `"mm"` or `"m"`.

        Raises:
            ValueError: if the view lacks what the unit needs.
        """
        key = _unit("View.length", unit, ("px", "um", "mm", "m"))
        return _numbers("View.length", value) * self.px_of_things(key, f"a length in {unit}")

    def stage(self, value: RowLike, unit: str) -> Numbers | np.floating:
        """Lengths, speeds or accelerations of the sensor itself; in px and seconds.

        Args:
            value: Numbers in the unit, in any shape.
            unit: `"um"`, `"mm"`, `"mm/s"`, `"g"` or `"g/s"`, whatever the sensor looks at; also
                `"px"`, `"px/s"`, `"m"`, `"um/s"`, `"m/s"` and `"km/h"`.

        Raises:
            ValueError: if the unit needs the pixel pitch and there is none.
        """
        key = _unit("View.stage", unit, ("px", "px_per_s", *_METRES))
        return _numbers("View.stage", value) * self.px_of_stage(key, f"a stage in {unit}")

    def photon_rate(
        self,
        *,
        illuminance: RowLike,
        f_number: float | int,
        quantum_efficiency: float | int,
        lens_transmission: float | int = 1.0,
    ) -> Numbers | np.floating:
        """Photo-electrons a second at white, diffuse things, in sunlight; e-/s.

        Args:
            illuminance: On the things; lx, in any shape.
            f_number: Of the lens; 1.
            quantum_efficiency: Mean from 400 to 700 nm, behind the pixels' filter; 1.
            lens_transmission: Share of light that the lens passes; 1.

        Raises:
            ValueError: if a number is not above 0, a share is above 1, or the view has no pixel
                pitch.
        """
        shares = {"quantum_efficiency": quantum_efficiency, "lens_transmission": lens_transmission}
        require_number("View.photon_rate(f_number=...)", f_number, "above 0", strict=True)
        for name, value in shares.items():
            subject, bound = f"View.photon_rate({name}=...)", "above 0 and at most 1"
            require_number(subject, value, bound, strict=True, most=1.0)
        lux = _numbers("View.photon_rate", illuminance, "illuminance")
        require_at_least("View.photon_rate(illuminance=...)", lux, "above 0", strict=True)
        per_lux = self._rate_of_lux("an illuminance", f_number, lens_transmission)
        return lux * per_lux * quantum_efficiency

    @property
    def _whole(self) -> str:
        return "View(...)" if self.keys is None else "[view]"

    def _subject(self, name: str) -> str:
        return f"View({name}=...)" if self.keys is None else self.keys[name]

    def _bare(self, name: str) -> str:
        return name if self.keys is None else self.keys[name].split()[-1]

    def px_of_stage(self, unit: str, key: str) -> float:
        """Pixels in a unit of the sensor's own way.

        Args:
            unit: The unit of a length or a speed, such as `"mm_per_s"`.
            key: The key that has it, which an error names.

        Raises:
            ValueError: if the pixels' pitch is not known.
        """
        return 1.0 if unit.startswith("px") else _METRES[unit] / self._pitch_for(key)

    def px_of_things(self, unit: str, key: str) -> float:
        """Pixels in a unit of the size or the way of things.

        Args:
            unit: The unit of a length, an angle or a speed, such as `"m_per_s"`.
            key: The key that has it, which an error names.

        Raises:
            ValueError: if nothing says how large things are on the sensor.
        """
        if unit.startswith("px"):
            return 1.0
        if unit == "deg_per_s":
            subject, requirement = self._subject("focal_length"), f"be given where {key} is"
            require(self.focal_length is not None, subject, requirement, _NOTHING)
            return math.radians(1) * self.focal_length / self._pitch_for(key)  # type: ignore[operator]
        if self.px_per_mm is not None:
            return _METRES[unit] * 1e3 * self.px_per_mm
        distance, focal_length = self._bare("distance"), self._bare("focal_length")
        ways = f"magnification, px_per_mm, or {distance} and {focal_length}"
        magnification, requirement = self._magnification, f"hold {ways}, where {key} is given"
        require(magnification is not None, self._whole, requirement, _NOTHING)
        return _METRES[unit] * magnification / self._pitch_for(key)  # type: ignore[operator]

    @property
    def _magnification(self) -> float | int | None:
        """Size on the sensor over that of things; None where nothing says it."""
        f, d = self.focal_length, self.distance
        if d is not None:
            return f / (d - f)  # type: ignore[operator]
        if self.px_per_mm is not None:
            return None if self.pixel_pitch is None else self.px_per_mm * 1e3 * self.pixel_pitch
        return self.magnification

    def _pitch_for(self, key: str) -> float | int:
        """The pitch, m, which a key needs."""
        requirement, pitch = f"be given where {key} is", self.pixel_pitch
        require(pitch is not None, self._subject("pixel_pitch"), requirement, _NOTHING)
        return pitch  # type: ignore[return-value]

    def _rate_of_lux(
        self, key: str, f_number: float | int, lens_transmission: float | int
    ) -> float:
        """Photons a second at a pixel by the lux on white things, which a key tells."""
        cone = 2 * f_number * (1 + (self._magnification or 0.0))
        return lens_transmission / cone**2 * _PHOTONS_PER_LUX * self._pitch_for(key) ** 2


def _unit(function: str, unit: str, units: tuple[str, ...]) -> str:
    """A unit as keys end in it."""
    texts = {_text(key): key for key in units}
    plain = unit.translate(_MICRO)
    require(plain in texts, f"{function}(unit=...)", f"be one of {', '.join(texts)}", unit)
    return texts[plain]


def _numbers(function: str, value: RowLike, name: str = "value") -> Numbers:
    require_finite(f"{function}({name}=...)", value)
    return as_numpy(value)[0]


def read_noise_from_dynamic_range(*, dynamic_range: float | int, full_well: float | int) -> float:
    r"""Read noise from the dynamic range of a data sheet, a standard deviation; e-.

    Args:
        dynamic_range: $20\log_{10}$ of the full well over the read noise; dB.
        full_well: Electrons at which a pixel is full; e-.

    Raises:
        ValueError: if a number is not finite, or `full_well` is not above 0.
    """
    require_finite("read_noise_from_dynamic_range(dynamic_range=...)", dynamic_range)
    require_finite("read_noise_from_dynamic_range(full_well=...)", full_well)
    require(full_well > 0, "read_noise_from_dynamic_range(full_well=...)", "be above 0", full_well)
    return full_well / 10 ** (dynamic_range / 20)


def view_of(section: ViewSection, pitch: float | None) -> View:
    """The view of a scene file's sections, pixels of a pitch, um, whose errors name their keys."""
    return View(
        magnification=section.magnification,
        px_per_mm=section.px_per_mm,
        distance=section.distance_m,
        focal_length=None if section.focal_length_mm is None else section.focal_length_mm / 1e3,
        pixel_pitch=None if pitch is None else pitch / 1e6,
        keys=_KEYS,
    )


def speed_of(text: str, view: View, subject: str) -> float:
    """The speed of a thing that a text gives in px/s, or with its unit; px/s."""
    *units, last = map(_text, SPEED_UNITS)
    pattern = rf"\s*(\S+?)\s*({'|'.join([*units, last])})\s*"
    match = re.fullmatch(pattern, text.translate(_MICRO))
    number, unit = match.groups() if match else (text, "px/s")
    try:
        value = float(number)
    except ValueError:
        value = math.nan
    units_text = f"{', '.join(units)} or {last}"
    requirement = f"be a number of px/s, or one with its unit, as 0.9m/s: {units_text}"
    require(math.isfinite(value), subject, requirement, text)
    key = _unit(subject, unit, SPEED_UNITS)
    speed = value * view.px_of_things(key, f"{subject} in {unit}")
    require(abs(speed) <= FASTEST, subject, f"be at most {FASTEST:g} px/s", speed)
    return speed


def told_in(section: Section, name: str, units: tuple[str, ...], place: str) -> tuple[str, Any]:
    """The one unit in which a section gives a quantity, and its value; None if it gives none.

    A default, of a key that the file does not have, gives way to another unit.
    """
    values = {unit: getattr(section, _key(name, unit)) for unit in units}
    in_file = [unit for unit in units if _key(name, unit) in section.model_fields_set]
    told = [unit for unit in in_file if values[unit] is not None]
    chosen, other = (told[0], told[-1]) if told else (units[0], units[0])
    subject, beside = f"{place} {name}_{other}", f"not stand beside {name}_{chosen}"
    require(chosen == other, subject, beside, values[other])
    return chosen, values[chosen]


_DIVISORS = {"ms": 1e3, "us": 1e6}
"""Units of time, in a second."""
_OF_LENGTH = ("px", "um", "mm", "m", "px_per_s2", "px_per_s3", "g", "g_per_s", *SPEED_UNITS)
_UNITS = ("", "cycles_per_px", "e", "hz", "per_s", "share", "slots", *_DIVISORS, *_OF_LENGTH)
"""Units of keys; the first seven are those of classes too."""
_PITCH, _MICROMETRE = "pixel_pitch", 1e-6
"""The length by which others are pixels, itself in m, and m in the unit of its key."""
_OTHER_NAMES = {
    "cutoff": "cutoff_frequency",
    "rise": "rise_time",
    "fall": "fall_time",
    "object_speed": "speed",
}
"""Arguments of classes that keys call otherwise."""


def arguments_in(section: Section, kind: type, place: str, view: View) -> dict[str, Any]:
    """Arguments of a class that a section gives, in the units of the class."""
    values = {}
    for name, units in _quantities(type(section), kind).items():
        unit, value = told_in(section, name, units, place)
        if value is not None and name == _PITCH:
            value = value * _MICROMETRE
        elif value is not None and unit in _OF_LENGTH:
            is_of_things = name in ("max_pan", "object_speed", "object_width", "width")
            of_unit = view.px_of_things if is_of_things else view.px_of_stage
            value = value * of_unit(unit, f"{place} {name}_{unit}")
        elif value is not None and unit in _DIVISORS:
            value = value / _DIVISORS[unit]
        values[_OTHER_NAMES.get(name, name)] = value
    return {name: value for name, value in values.items() if value is not None}


def table_of(instance: object, section: type[Section]) -> dict[str, object]:
    """The table of a section that `arguments_in` reads back, in the first unit of each quantity."""
    table: dict[str, object] = {}
    for name, (unit, *_) in _quantities(section, type(instance)).items():
        value = getattr(instance, _OTHER_NAMES.get(name, name))
        if hasattr(value, "dtype"):
            value = float(value) * _DIVISORS.get(unit, 1.0)
            value = value / _MICROMETRE if name == _PITCH else value
        table[_key(name, unit)] = value
    return {key: value for key, value in table.items() if value is not None}


def _quantities(section: type[Section], kind: type) -> dict[str, tuple[str, ...]]:
    """Arguments of a class among the keys of a section, without units, and their units."""
    units: dict[str, tuple[str, ...]] = {}
    arguments = argument_names(kind)
    for key in section.model_fields:
        for unit in _UNITS:
            name = key.removesuffix(f"_{unit}") if unit else key
            is_argument = _OTHER_NAMES.get(name, name) in arguments
            if is_argument and _key(name, unit) == key:
                units[name] = (*units.get(name, ()), unit)
    return units


def keys_of(section: type[Section], kind: type) -> dict[str, str]:
    """Keys of a section by the arguments of a class that they hold in its unit."""
    return {
        _OTHER_NAMES.get(name, name): _key(name, units[0])
        for name, units in _quantities(section, kind).items()
        if units[0] not in _DIVISORS and name != _PITCH
    }


def _key(name: str, unit: str) -> str:
    return f"{name}_{unit}" if unit else name


_WAYS_OF_LIGHT = {
    "photon_rate_per_s": (),
    "white_e": ("white_ms",),
    "illuminance_lux": ("f_number", "quantum_efficiency"),
}
"""Keys that say how much light there is, and those that each cannot do without."""


def photon_rate(light: Light, view: View) -> float:
    """Photo-electrons a second at a white pixel of an open shutter."""
    told = [way for way in _WAYS_OF_LIGHT if getattr(light, way) is not None]
    requirement = "be given, or white_e and white_ms, or illuminance_lux"
    require(len(told) > 0, "[light] photon_rate_per_s", requirement, _NOTHING)
    requirement = "hold one of photon_rate_per_s, white_e and illuminance_lux"
    require(len(told) == 1, "[light]", requirement, Unquoted(" and ".join(told)))
    for way, keys in _WAYS_OF_LIGHT.items():
        for key in keys:
            value, subject = getattr(light, key), f"[light] {key}"
            if way == told[0]:
                require(value is not None, subject, f"be given where {way} is", _NOTHING)
            else:
                require(value is None, subject, f"stand beside {way}", value)
    # Older files of a scene hold a default of 1, which may stand beside any light.
    lens = 1.0 if light.lens_transmission is None else light.lens_transmission
    is_of_lux, requirement = light.illuminance_lux is not None, "stand beside illuminance_lux"
    require(is_of_lux or lens == 1, "[light] lens_transmission", requirement, lens)
    if light.photon_rate_per_s is not None:
        return light.photon_rate_per_s
    if light.white_e is not None:
        return light.white_e / (light.white_ms * 1e-3)  # type: ignore[operator]
    key = "[light] illuminance_lux"
    per_lux = view._rate_of_lux(key, light.f_number, lens)  # type: ignore[arg-type]
    return light.illuminance_lux * per_lux * light.quantum_efficiency  # type: ignore[operator]


def read_noise_in(sensor: SensorSection) -> float:
    """Standard deviation of the read noise that a section gives; e-."""
    range_db, well = sensor.dynamic_range_db, sensor.full_well_e
    if range_db is None:
        require(sensor.read_noise_e is not None, "[sensor] read_noise_e", "be given", _NOTHING)
        return sensor.read_noise_e  # type: ignore[return-value]
    subject = "[sensor] dynamic_range_db"
    require(sensor.read_noise_e is None, subject, "not stand beside read_noise_e", range_db)
    requirement = "be given where dynamic_range_db is"
    require(well is not None, "[sensor] full_well_e", requirement, _NOTHING)
    return read_noise_from_dynamic_range(dynamic_range=range_db, full_well=well)  # type: ignore[arg-type]
