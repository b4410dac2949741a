"""Drive tables and traces with one thing wrong each, and what is said of it."""

import io

import numpy as np

STEPS = 12
HALF_MS = 10.0
"""Of the design that the tables are held against; ms."""


def table(rows=None, names="begin,transmittance", units="ms,1"):
    """The text of a table of equal steps, some of whose rows are changed."""
    lines = [f"{-HALF_MS + 2 * HALF_MS * k / STEPS:.9g},0.5" for k in range(STEPS)]
    for index, line in (rows or {}).items():
        lines[index] = line
    return "\n".join([names, units, *[line for line in lines if line is not None]]) + "\n"


def trace(change=lambda time, level: (time, level), names="time,level", units="ms,V"):
    """The text of a trace that reaches beyond the exposure, changed."""
    time = np.linspace(-1.2 * HALF_MS, 1.2 * HALF_MS, 241)
    level = 0.3 + 2 * np.cos(np.pi * np.clip(time / HALF_MS, -1, 1) / 2) ** 2
    time, level = change(time, level)
    rows = [f"{t:.6g},{v:.6g}" for t, v in zip(time, level, strict=True)]
    return "\n".join([names, units, *rows]) + "\n"


def npy(array):
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


DRIVES = {
    "empty": ("d.csv", "", "must hold at least one line; got an empty file"),
    "picture": (
        "d.csv",
        b"\x89PNG\r\n\x1a\n\x00\xff",
        "must be text, as CSV is, in UTF-8, UTF-16 o",
    ),
    "prose": (
        "d.csv",
        "once upon a time\n",
        "must be a drive table in csv, with one column begi",
    ),
    "wrong-unit": (
        "d.csv",
        table(units="s,1"),
        "must have `begin` in ms by its second line; got 's'",
    ),
    "no-units": (
        "d.csv",
        "begin,transmittance\n",
        "have `begin` in ms by its second line; got ''",
    ),
    "short-units": (
        "d.csv",
        table(units="ms"),
        "have `transmittance` in 1 by its second line",
    ),
    "unknown-column": (
        "d.csv",
        table(names="begin,transmittence"),
        "must be a drive table in csv, with one column begin and one tra",
    ),
    "column-missing": (
        "d.csv",
        table(names="begin,level"),
        "one column begin and one transmittance, or npy; got 'begin,level'",
    ),
    "column-twice": (
        "d.csv",
        table(names="begin,begin"),
        "one column begin and one transmittance, or npy; got 'begin,begin'",
    ),
    "unordered": ("d.csv", table({5: "-8,0.5"}), "must have equal steps without a gap, 12 from -1"),
    "gap": (
        "d.csv",
        table({7: None}),
        "must have equal steps without a gap, 11 from -10 to 10 ms; got ",
    ),
    "from-its-start": (
        "d.csv",
        "begin,transmittance\nms,1\n0,0.5\n1,0.5\n",
        "must begin before mid-exposure, at a time below 0; got 0 ms",
    ),
    "nan": ("d.csv", table({3: "-5,nan"}), "must hold finite numbers; got -5,nan"),
    "word": ("d.csv", table({3: "-5,open"}), "numbers a row; got: could not convert string 'open'"),
    "ragged": ("d.csv", table({3: "-5"}), "a row; got: the number of columns changed from 2 to 1"),
    "decimal-comma": ("d.csv", table({3: "-5,0,5"}), "a row; got: the number of columns changed"),
    "above-one": (
        "d.csv",
        table({3: "-5,1.5"}),
        "must hold a transmittance in [0, 1] alone; got 1.5",
    ),
    "heading-alone": ("d.csv", "begin,transmittance\nms,1\n", "at least one row of numbers; got n"),
    "path-of-its-own": (
        "d.csv",
        table(
            {k: f"{-HALF_MS + 20 * k / STEPS:.9g},0.5,{(-1) ** k}" for k in range(STEPS)},
            names="begin,transmittance,sensor_position",
            units="ms,1,px",
        ),
        "must move the sensor along v t + a t^2; got a path up to ",
    ),
    "backwards": (
        "d.csv",
        table(
            {k: f"{-HALF_MS + 20 * k / STEPS:.9g},0.5,{-((k - 6) ** 2)}" for k in range(STEPS)},
            names="begin,transmittance,sensor_position",
            units="ms,1,px",
        ),
        "must accelerate the sensor towards positive positions, or not at all; got a sag of -36",
    ),
    "half-an-array": ("d.npy", npy(np.zeros((2, 9)))[:-9], "must be a whole .npy file; got: "),
    "samples-first": (
        "d.npy",
        npy(np.zeros((9, 2))),
        "must be an array of (channels, samples) of 1 to 3 channels; got shape (9, 2)",
    ),
    "complex": ("d.npy", npy(np.zeros((1, 9), complex)), "hold real numbers; got complex128"),
    "npy-nan": ("d.npy", npy(np.full((1, 3), np.nan)), "must hold finite numbers; got nan"),
    "volts": ("d.npy", npy(np.array([[0.5, 4.2]])), "hold a drive in [-1, 1] alone; got 4.2"),
    "gate-twice": (
        "d.npy",
        npy(np.array([[0.5, 0.5, 0.5], [0, 0, 0], [1, 0, 1]])),
        "must have its gate open once, without a gap; got 2 openings",
    ),
    "gate-half-open": (
        "d.npy",
        npy(np.array([[0.5], [0.0], [0.5]])),
        "must have a gate of 0 and 1; got 0.5",
    ),
}

TRACES = {
    "trace-unordered": (
        trace(lambda t, v: (t[::-1], v)),
        "must have times that ascend; got",
    ),
    "trace-in-minutes": (
        trace(units="min,V"),
        "must name s, ms, us or ns as the unit of a column of times, as `time (s),level` above ",
    ),
    "trace-in-seconds": (
        trace(units="s,V"),
        "must have at least 32 samples within the exposure, -10 to 10 ms by its clock; got 1 of ",
    ),
    "trace-gap": (
        trace(lambda t, v: (t[(t < 2) | (t > 5)], v[(t < 2) | (t > 5)])),
        "must have no gap above 1/16 of the exposure, -10 to 10 ms by its clock; got one of 3.",
    ),
    "trace-cut-off": (
        trace(lambda t, v: (t[t < 8], v[t < 8])),
        "must reach over the exposure, -10 to 10 ms by its clock, or be read with that clock's "
        "mid-exposure: `middle` or `--mid-exposure-ms`; got times from -12 to 7.9 ms",
    ),
    "trace-of-the-dark": (
        trace(lambda t, v: (t, 0.01 * np.random.default_rng(5).standard_normal(t.size))),
        "must tell the open shutter from the closed one by more than its noise; got levels",
    ),
    "trace-of-transitions": (
        trace(lambda t, v: (t[::60], np.arange(5) % 2)),
        "must hold samples, of which many fall in each rest of the shutter; got a list of transit",
    ),
    "trace-without-dark": (
        trace(lambda t, v: (t[abs(t) <= 10], v[abs(t) <= 10])),
        "must have 8 samples outside the exposure, or a level of the closed shutter; got 0",
    ),
    "trace-nan": (
        trace(lambda t, v: (t, np.where(t > 3, np.nan, v))),
        "must hold finite numbers below 9.9e+37, others being an instrument's sign for a signal ",
    ),
    "trace-without-level": (
        trace(names="time,time", units="ms,ms"),
        "must have a column of levels beside the times; got none",
    ),
    "trace-of-light-elsewhere": (
        trace(lambda t, v: (3 * t + 23, v)),
        "must rise in the exposure, or fall there from a steady level, or be read with the levels",
    ),
    "trace-of-bytes": (
        "\0" + trace(),
        "must be text, as CSV is, in UTF-8, UTF-16 or Latin-1; got other bytes",
    ),
}
