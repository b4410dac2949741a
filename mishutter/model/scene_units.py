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
from typing import Any, NamedTuple

from mishutter._core import Section, Unquoted, require
from mishutter.model.arguments import argument_names
from mishutter.model.scene_schema import (
    Light,
    Sensor,
    ViewSection,
)

_GRAVITY = 9.80665e6
"""Standard gravity; um/s^2."""
_MICROMETRES = {"mm": 1e3, "mm_per_s": 1e3, "g": _GRAVITY, "g_per_s": _GRAVITY}
"""Units of the stage, in um and seconds."""
_MILLIMETRES = {"mm": 1.0, "m": 1e3, "mm_per_s": 1.0, "m_per_s": 1e3}
"""Units of things, in mm and seconds."""
_PHOTONS_PER_LUX = 6.02214076e23 * 1e-6 / 54 * 1e-12
"""Photons of sunlight between 400 and 700 nm by lux, second and square micrometre: 1.1e4."""
_NOTHING = Unquoted("nothing")
SPEED_UNITS = ("px_per_s", "mm_per_s", "m_per_s", "deg_per_s")
"""Units of the speeds of things, as the names of keys end in them."""
_SPEED = re.compile(r"\s*(\S+?)\s*(px|mm|m|deg)/s\s*")
FASTEST = 1e7
"""Greatest speed of a thing, px/s."""


class Scales(NamedTuple):
    """Factors that turn units of a scene file into pixels.

    Attributes:
        pitch: Distance of pixels; um; None where the file does not say it.
        view: How large things are in the picture.
    """

    pitch: float | None
    view: ViewSection

    def of_stage(self, unit: str, key: str) -> float:
        """Pixels in a unit of the sensor's own way; the key that is in it is named in errors."""
        if unit.startswith("px"):
            return 1.0
        return _MICROMETRES[unit] / self.pitch_for(key)

    def of_things(self, unit: str, key: str) -> float:
        """Pixels in a unit of the size or the way of things, as the picture shows them."""
        if unit.startswith("px"):
            return 1.0
        if unit == "deg_per_s":
            focal = self.view.focal_length_mm
            requirement = f"be given where {key} is"
            require(focal is not None, "[view] focal_length_mm", requirement, _NOTHING)
            return math.radians(1) * 1e3 * focal / self.pitch_for(key)  # type: ignore[operator]
        return _MILLIMETRES[unit] * self._px_per_mm(key)

    def _px_per_mm(self, key: str) -> float:
        magnification = self.magnification
        if self.view.px_per_mm is not None:
            return self.view.px_per_mm
        ways = "magnification, px_per_mm, or distance_m and focal_length_mm"
        requirement = f"hold {ways}, where {key} is given"
        require(magnification is not None, "[view]", requirement, _NOTHING)
        return magnification * 1e3 / self.pitch_for(key)  # type: ignore[operator]

    @property
    def magnification(self) -> float | None:
        """Size on the sensor over that of things; None where the file does not say it.

        Raises:
            ValueError: if it says it in several ways, or half of it.
        """
        view = self.view
        ways = {
            "magnification": view.magnification,
            "px_per_mm": view.px_per_mm,
            "distance_m": view.distance_m,
        }
        told = [name for name, value in ways.items() if value is not None]
        requirement = "hold one of magnification, px_per_mm and distance_m"
        require(len(told) <= 1, "[view]", requirement, Unquoted(" and ".join(told)))
        if view.distance_m is not None:
            f, d = view.focal_length_mm, 1e3 * view.distance_m
            beside = "be given where distance_m is"
            require(f is not None, "[view] focal_length_mm", beside, _NOTHING)
            beyond = f"be beyond the focal length, {f:g} mm"
            require(d > f, "[view] distance_m", beyond, view.distance_m)  # type: ignore[operator]
            return f / (d - f)  # type: ignore[operator]
        if view.px_per_mm is not None:
            return None if self.pitch is None else view.px_per_mm * self.pitch / 1e3
        return view.magnification

    def pitch_for(self, key: str) -> float:
        """The pitch, um, which a key needs."""
        requirement = f"be given where {key} is"
        require(self.pitch is not None, "[sensor] pixel_pitch_um", requirement, _NOTHING)
        return self.pitch  # type: ignore[return-value]


def speed_of(text: str, scales: Scales, subject: str) -> float:
    """The speed of a thing that a text gives in px/s, or with its unit; px/s.

    Args:
        text: As `2400`, `0.9 m/s`, `0.9 mm/s` or `3 deg/s`.
        scales: Of the scene that it moves in.
        subject: What the speed is of, in an error.

    Raises:
        ValueError: if it is no number, one of another unit, or faster than anything, or the scene
            does not say what the unit needs.
    """
    match = _SPEED.fullmatch(text)
    number, unit = match.groups() if match else (text, "px")
    try:
        value = float(number)
    except ValueError:
        value = math.nan
    requirement = "be a number of px/s, or one with its unit, as 0.9m/s: px/s, mm/s, m/s or deg/s"
    require(math.isfinite(value), subject, requirement, text)
    speed = value * scales.of_things(f"{unit}_per_s", f"{subject} in {unit}/s")
    require(abs(speed) <= FASTEST, subject, f"be at most {FASTEST:g} px/s", speed)
    return speed


def told_in(section: Section, name: str, units: tuple[str, ...], place: str) -> tuple[str, Any]:
    """The one unit that a quantity of a section is given in, and its value there; None of none.

    A default, of a key that the file does not have, gives way to another unit.

    Args:
        section: The section.
        name: The keys without their units.
        units: The units, that of the default first.
        place: How an error calls the section.

    Raises:
        ValueError: if it is given in several units.
    """
    values = {unit: getattr(section, _key(name, unit)) for unit in units}
    told = [unit for unit, x in values.items() if x is not None and _is_told(section, name, unit)]
    chosen, other = (told[0], told[-1]) if told else (units[0], units[0])
    subject, beside = f"{place} {name}_{other}", f"not stand beside {name}_{chosen}"
    require(chosen == other, subject, beside, values[other])
    return chosen, values[chosen]


_DIVISORS = {"ms": 1e3, "us": 1e6}
"""Units of time, in a second."""
_OF_CLASSES = ("", "cycles_per_px", "e", "hz", "per_s", "share", "slots")
"""Units that classes have too."""
_OF_LENGTH = ("px", "mm", "m", "px_per_s2", "px_per_s3", "g", "g_per_s", *SPEED_UNITS)
_UNITS = (*_OF_CLASSES, *_DIVISORS, *_OF_LENGTH)
_OF_THINGS = ("max_pan", "object_speed", "object_width")
"""Quantities whose units are those of things; lengths of all others are of the stage."""
_OTHER_NAMES = {
    "cutoff": "cutoff_frequency",
    "rise": "rise_time",
    "fall": "fall_time",
    "object_speed": "speed",
}
"""Arguments of classes that keys call otherwise."""


def arguments_in(section: Section, kind: type, place: str, scales: Scales) -> dict[str, Any]:
    """Arguments of a class that a section gives, in the units of the class.

    Args:
        section: The section, each of whose keys is an argument and its unit.
        kind: The class.
        place: The section's name in an error.
        scales: Lengths of the scene.

    Raises:
        ValueError: if a quantity is given in several units, or in one that needs a key that the
            file does not have.
    """
    values = {}
    for name, units in _quantities(type(section), kind).items():
        unit, value = told_in(section, name, units, place)
        if value is not None and unit in _OF_LENGTH:
            of_unit = scales.of_things if name in _OF_THINGS else scales.of_stage
            value = value * of_unit(unit, f"{place} {name}_{unit}")
        elif value is not None and unit in _DIVISORS:
            value = value / _DIVISORS[unit]
        values[_OTHER_NAMES.get(name, name)] = value
    return {name: value for name, value in values.items() if value is not None}


def table_of(instance: object, section: type[Section]) -> dict[str, object]:
    """The table of a section that `arguments_in` reads back, in the first unit of each quantity.

    Args:
        instance: An object of the class.
        section: The section.
    """
    table: dict[str, object] = {}
    for name, (unit, *_) in _quantities(section, type(instance)).items():
        value = getattr(instance, _OTHER_NAMES.get(name, name))
        if hasattr(value, "dtype"):
            value = float(value) * _DIVISORS.get(unit, 1.0)
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


def _key(name: str, unit: str) -> str:
    return f"{name}_{unit}" if unit else name


def _is_told(section: Section, name: str, unit: str) -> bool:
    return _key(name, unit) in section.model_fields_set


_WAYS_OF_LIGHT = {
    "photon_rate_per_s": (),
    "white_e": ("white_ms",),
    "illuminance_lux": ("f_number", "quantum_efficiency"),
}
"""Keys that say how much light there is, and those that each cannot do without."""


def photon_rate(light: Light, scales: Scales) -> float:
    """Photo-electrons a second at a white pixel of an open shutter.

    Raises:
        ValueError: if the section says it in several ways, in none, or half of it.
    """
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
    if light.photon_rate_per_s is not None:
        return light.photon_rate_per_s
    if light.white_e is not None:
        return light.white_e / (light.white_ms * 1e-3)  # type: ignore[operator]
    area = scales.pitch_for("[light] illuminance_lux") ** 2
    cone = 2 * light.f_number * (1 + (scales.magnification or 0.0))  # type: ignore[operator]
    on_sensor = light.illuminance_lux * light.lens_transmission / cone**2  # type: ignore[operator]
    return on_sensor * _PHOTONS_PER_LUX * area * light.quantum_efficiency  # type: ignore[operator]


def read_noise(sensor: Sensor) -> float:
    r"""Standard deviation of the read noise; e-.

    A dynamic range of $D$ dB is $20\log_{10}$ of the full well over it.

    Raises:
        ValueError: if the section says it in both ways, in none, or half of it.
    """
    range_db, well = sensor.dynamic_range_db, sensor.full_well_e
    if range_db is None:
        require(sensor.read_noise_e is not None, "[sensor] read_noise_e", "be given", _NOTHING)
        return sensor.read_noise_e  # type: ignore[return-value]
    subject = "[sensor] dynamic_range_db"
    require(sensor.read_noise_e is None, subject, "not stand beside read_noise_e", range_db)
    requirement = "be given where dynamic_range_db is"
    require(well is not None, "[sensor] full_well_e", requirement, _NOTHING)
    return well / 10 ** (range_db / 20)  # type: ignore[operator]
