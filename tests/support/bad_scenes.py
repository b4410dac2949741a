"""Scene files with one thing wrong each, as edits of the built-in one."""

import re
from importlib import resources

EXAMPLE = (resources.files("mishutter") / "example_scene.toml").read_text("utf-8")

_RATE, _NOISE, _SPEEDS = "photon_rate_per_s", "read_noise_e", "uniform"
_LIST = "list_px_per_s = "

LINES = {
    "negative-light": (_RATE, f"{_RATE} = -3", "must be above 0; got -3"),
    "no-light": (_RATE, f"{_RATE} = 0", "must be above 0; got 0"),
    "light-nan": (_RATE, f"{_RATE} = nan", "must be finite; got nan"),
    "light-astronomic": (_RATE, f"{_RATE} = 1e200", "must be at most 1e+12; got 1e+200"),
    "light-as-text": (_RATE, f'{_RATE} = "3"', "must be a number; got '3'"),
    "light-as-truth": (_RATE, f"{_RATE} = true", "must be a number; got True"),
    "light-missing": (_RATE, "", "`[light] photon_rate_per_s` must be given, or white_e"),
    "light-without-unit": (
        _RATE,
        "photon_rate = 3e4",
        "perhaps `[light] photon_rate_per_s`; got 'photon_rate'",
    ),
    "beginning-of-a-key": (
        _SPEEDS,
        "uniform = { min = 1, max_px_per_s = 2, count = 3 }",
        "perhaps `[speeds] uniform.min_px_per_s`; got 'min'",
    ),
    "beginning-of-a-mean": (
        _SPEEDS,
        "normal = { mean = 1, deviation_px_per_s = 2, count = 3 }",
        "perhaps `[speeds] normal.mean_px_per_s`; got 'mean'",
    ),
    "beginning-of-a-list": (_SPEEDS, "list = [1]", "perhaps `[speeds] list_px_per_s`; got 'list'"),
    "section-in-itself": (
        _SPEEDS,
        "speeds = [1]",
        "must hold known keys only, perhaps `[decoder] speed`; got",
    ),
    "key-of-another-section": (_RATE, "read_noise = 3", "perhaps `[sensor] read_noise_e`"),
    "key-of-no-section": (
        _RATE,
        "iso = 400",
        "`[light]` must hold known keys only (photon_rate_per_s, white_e, white_ms,",
    ),
    "unknown-section": ("[light]", "[lihgt]", "perhaps `[light]`; got 'lihgt'"),
    "section-of-no-file": (
        "[light]",
        "[camera]",
        "known keys only (speeds, light, sensor, view, oc",
    ),
    "section-twice": ("[light]", "[speeds]", "must be a TOML file; got: Cannot declare"),
    "not-toml": ("[light]", "[light", "must be a TOML file; got: "),
    "brackets-without-end": (_SPEEDS, "a = " + "[" * 5000, "must be a TOML file; got: brackets "),
    "digits-without-end": (_RATE, f"{_RATE} = 1" + "0" * 5000, "must be a TOML file; got: Exceeds"),
    "hexadecimal-without-end": (_RATE, f"{_RATE} = 0x" + "f" * 5000, "got int too long to show"),
    "negative-noise": (_NOISE, f"{_NOISE} = -0.1", "must be at least 0; got -0.1"),
    "no-speeds": (
        _SPEEDS,
        "",
        "must hold one of uniform, normal, list_px_per_s and any_direction; got no sp",
    ),
    "empty-speeds": (_SPEEDS, _LIST + "[]", "must hold at least 1 value; got []"),
    "two-forms-of-speeds": (
        _SPEEDS,
        _LIST + "[1]\nuniform = { min_px_per_s = 1, max_px_per_s = 2, count = 3 }",
        "got uniform and list",
    ),
    "speed-nan": (_SPEEDS, _LIST + "[1, nan]", "list_px_per_s[1]` must be finite; got nan"),
    "speed-of-light": (_SPEEDS, _LIST + "[3e8]", "must be at most 1e+07; got 3"),
    "speeds-nested": (_SPEEDS, _LIST + "[[1, 2]]", "must be a number; got [1, 2]"),
    "speeds-reversed": (
        _SPEEDS,
        "uniform = { min_px_per_s = 4, max_px_per_s = 2, count = 3 }",
        "`[speeds] uniform.max_px_per_s` must be at least min_px_per_s = 4; got 2",
    ),
    "half-a-speed": (
        _SPEEDS,
        "uniform = { min_px_per_s = 1, max_px_per_s = 2, count = 2.5 }",
        "`[speeds] uniform.count` must be a whole number; got 2.5",
    ),
    "one-speed-of-two": (
        _SPEEDS,
        "uniform = { min_px_per_s = -2800, max_px_per_s = 2800, count = 1 }",
        "`[speeds] uniform.count` must be at least 2, for speeds from -2800 to 2800; got 1",
    ),
    "one-speed-in-metres": (
        _SPEEDS,
        "uniform = { min_m_per_s = 0, max_m_per_s = 1.5, count = 1 }",
        "`[speeds] uniform.count` must be at least 2, for speeds from 0 to 1.5; got 1",
    ),
    "one-speed-of-a-normal": (
        _SPEEDS,
        "normal = { mean_px_per_s = 300, deviation_px_per_s = 70, count = 1 }",
        "`[speeds] normal.count` must be at least 2, for speeds that deviate; got 1",
    ),
    "countless-speeds": (
        _SPEEDS,
        "uniform = { min_px_per_s = 1, max_px_per_s = 2, count = 1000000 }",
        "must be at most 1000; got 1000000",
    ),
    "normal-without-width": (
        _SPEEDS,
        "normal = { mean_px_per_s = 1, deviation_px_per_s = 0, count = 3 }",
        "`[speeds] normal.deviation_px_per_s` must be above 0; got 0",
    ),
    "weights-off": (_SPEEDS, _LIST + "[1, 2]\nweights = [0, 0.0]", "must hold one above 0; got"),
    "weights-short": (_SPEEDS, _LIST + "[1, 2]\nweights = [1.0]", "must be 2, one a speed; got 1"),
    "weights-negative": (
        _SPEEDS,
        _LIST + "[1, 2]\nweights = [1.0, -0.1]",
        "`[speeds] weights[1]` must be at least 0; got -0.1",
    ),
    "weights-of-a-range": (
        _SPEEDS,
        "uniform = { min_px_per_s = 1, max_px_per_s = 2, count = 2 }\nweights = [0.5, 0.5]",
        "must go with list_px_per_s; got uniform",
    ),
    "zero-exposure": ("exposure_ms", "exposure_ms = 0", "must be at least 0.002; got 0"),
    "no-exposure": ("exposure_ms", "", "`[motion] exposure_ms` must be given; got nothing"),
    "two-exposures": (
        "exposure_ms",
        "exposure_ms = 20\nhalf_exposure_ms = 10",
        "`[motion] exposure_ms` must not stand beside half_exposure_ms; got 20",
    ),
    "exposure-beyond-limits": (
        "exposure_ms",
        "exposure_ms = 99",
        "must lie in the limits 1 to 80; got 99",
    ),
    "limits-reversed": (
        "max_exposure_ms",
        "max_exposure_ms = 0.2",
        "must be at least min_exposure_ms = 1; got 0.2",
    ),
    "smear-of-a-mile": (
        "max_exposure_ms",
        "max_exposure_ms = 180000",
        "must let the fastest object travel at most 10000 px; got 810000 px",
    ),
    "stroke-beyond-limits": (
        "stroke_px",
        "stroke_px = 60",
        "must keep the stroke within max_stroke_px = 45; got 60 px",
    ),
    "stroke-of-nothing": (
        "max_stroke_px",
        "max_stroke_px = 1e-320",
        "`[limits] max_stroke_px` must be 0, without a stage, or lie in 0.001 to 10000 px; "
        "got 1e-320",
    ),
    "top-speed-of-a-snail": (
        "max_top_speed_px_per_s",
        "max_top_speed_px_per_s = 1e-9",
        "`[limits] max_top_speed_px_per_s` must be at least 0.001; got 1e-09",
    ),
    "top-speed-beyond-limits": (
        "max_top_speed_px_per_s",
        "max_top_speed_px_per_s = 100",
        "must keep the top speed within max_top_speed_px_per_s = 100; got 9000 px/s",
    ),
    "pan-of-less-than-nothing": (
        "max_stroke_px",
        "max_pan_px_per_s = -1",
        "`[limits] max_pan_px_per_s` must be at least 0; got -1",
    ),
    "pan-of-light": (
        "max_stroke_px",
        "max_pan_px_per_s = 3e8",
        "`[limits] max_pan_px_per_s` must be at most 1e+07; got 3",
    ),
    "velocity-of-light": (
        "stroke_px",
        "stroke_px = 45\nvelocity_px_per_s = -3e8",
        "`[motion] velocity_px_per_s` must be at least -1e+07; got -3",
    ),
    "velocity-beyond-the-top-speed": (
        "stroke_px",
        "sag_px = 45\nvelocity_px_per_s = -12000",
        "must keep the top speed within max_top_speed_px_per_s = 20000; got 21000 px/s",
    ),
    "no-stroke": (
        "stroke_px",
        "",
        "hold one of sag_px, sag_mm, stroke_px, stroke_mm and stage_acceleration_px_per_s2; "
        "got neither",
    ),
    "stroke-and-acceleration": (
        "stroke_px",
        "stroke_px = 45\nacceleration_px_per_s2 = 4.5e5",
        "got stroke_px and acceleration_px_per_s2",
    ),
    "stroke-of-a-pan": (
        "stroke_px",
        "stroke_px = 37.5\nvelocity_px_per_s = 310.7",
        "`[motion] stroke_px` must be sag_px where the stage pans, "
        "whose stroke is more than a T^2; got 37.5",
    ),
    "stroke-of-a-pan-in-mm": (
        "stroke_px",
        "stroke_mm = 0.11\nvelocity_px_per_s = -1.7",
        "`[motion] stroke_mm` must be sag_mm where the stage pans",
    ),
    "no-optics": ("cutoff", "cutoff_cycles_per_px = 0", "must be above 0; got 0"),
    "optics-beyond-the-pixel": (
        "cutoff",
        "cutoff_cycles_per_px = 0.6",
        "`[optics] cutoff_cycles_per_px` must be at most 0.5; got 0.6",
    ),
    "lens-that-sharpens": (
        "cutoff",
        "lens_blur_px = -0.5",
        "`[optics] lens_blur_px` must be at least 0; got -0.5",
    ),
    "lens-in-the-wrong-unit": (
        "cutoff",
        "lens_blur_px = 620",
        "`[optics] lens_blur_px` must be at most 16; got 620",
    ),
    "picture-missing": ("path", 'path = "no.png"', "must name a file; got "),
    "picture-a-folder": ("path", 'path = "."', "must name a file; got the folder"),
    "picture-a-number": ("path", "path = 3", "`[picture] path` must be text; got 3"),
    "picture-unnamed": ("path", 'path = ""', "must not be empty; got ''"),
    "picture-and-level": (
        "path",
        'path = "example"\nmean_level = 0.2',
        "`[picture] mean_level` must not stand beside path; got 'example'",
    ),
    "white-of-nothing": (
        "path",
        "white = 4095",
        "`[picture] white` must stand beside the path of a photograph of one's own; got no path",
    ),
    "light-of-the-example": (
        "path",
        'path = "example"\nlinear = true',
        "`[picture] linear` must stand beside the path of a photograph of one's own; got example",
    ),
    "white-that-is-black": (
        "path",
        'path = "photo.png"\nwhite = 0',
        "`[picture] white` must be above 0; got 0",
    ),
    "level-above-white": ("path", "mean_level = 1.2", "must be at most 1; got 1.2"),
    "no-stage-by-travel": (
        "max_travel_mm",
        "max_travel_px = 0",
        "`[limits] max_travel_px` must be left out where there is no stage, as `[limits] max_str",
    ),
    "no-stage-by-a-key": (
        "max_travel_mm",
        "stage = false",
        "perhaps `[limits] max_stroke_px`; got",
    ),
    "no-stage-by-a-section": (
        "[speeds]",
        "stage = false\n[speeds]",
        "as `[limits] max_stroke_px = 0`",
    ),
    "frames": (
        "frames_per_s",
        "frames_per_s = 15\nframes = 4",
        "perhaps `[burst] max_frames`; got",
    ),
    "frames-above-all": ("[speeds]", "frames = 4\n[speeds]", "perhaps `[burst] max_frames`; got"),
    "like-and-path": (
        "path = ",
        'path = "example"\nlike = "print"',
        "like` must not stand beside pat",
    ),
    "like-nothing": ("path = ", 'like = "prints"', "must be 'photograph', 'print' or 'cells'; got"),
    "like-with-levels": (
        "path = ",
        'like = "cells"\ndeviation = 0.1',
        "must not stand beside like",
    ),
}
"""Slug to the line that is replaced, by what it starts with; its replacement; the error."""


def edited(start: str, replacement: str) -> str:
    """The built-in scene file with one line replaced."""
    pattern = re.compile(f"^{re.escape(start)}.*$", flags=re.MULTILINE)
    text, count = pattern.subn(replacement, EXAMPLE)
    if count != 1:
        raise ValueError(f"{count} lines of the example start with {start!r}")
    return text
