"""Traces as instruments write them: what a file plainly says is read, and nothing is guessed.

The files are made in the layouts of fourteen instruments, and in the spellings of separators,
units and encodings that programs and people write.
"""

import re

import numpy as np
import pytest
from support.exports import (
    EXPORTS,
    HALF,
    keysight,
    labview,
    picoscope,
    pulse,
    rigol_ds1000z,
    tektronix_mso,
)

from mishutter import measured_profile, read_trace

TIME, LEVEL = pulse()
STEP = TIME[1] - TIME[0]


def read(tmp_path, text, encoding="utf-8", **options):
    content = text if isinstance(text, bytes) else text.encode(encoding)
    (tmp_path / "trace.csv").write_bytes(content)
    return read_trace(tmp_path / "trace.csv", **options)


@pytest.mark.parametrize("slug", EXPORTS)
def test_an_instruments_export_is_its_trace(slug, tmp_path):
    """Times come out to a thousandth of a step, levels to the digits that the instrument writes."""
    trace = read(tmp_path, EXPORTS[slug](TIME, LEVEL))
    np.testing.assert_allclose(trace.time, TIME, rtol=0, atol=1e-3 * STEP)
    np.testing.assert_allclose(trace.level, LEVEL, rtol=0, atol=6e-5)


def rows(separator=",", factor=1.0, digits=9):
    pairs = zip(TIME * factor, LEVEL, strict=True)
    return [f"{t:.{digits}g}{separator}{v:.6g}" for t, v in pairs]


def text(*header, **options):
    return "\n".join([*header, *rows(**options)]) + "\n"


SPELLINGS = {
    "capitals": text("Time,Level", "S,V"),
    "brackets": text("time (s),level (V)"),
    "square-brackets": text("time [ms],level [V]", factor=1e3),
    "slash": text("time/ms,level/V", factor=1e3),
    "underscore": text("time_us,level_v", factor=1e6),
    "quotes": text('"time","level"', '"s","V"'),
    "quoted-numbers": "\n".join(
        ['"time","level"', '"s","V"', *[f'"{row}"' for row in rows('","')]]
    ),
    "quoted-decimal-commas": "\n".join(
        ["time,level", "s,V", *[f'"{row}"'.replace(".", ",") for row in rows('","')]]
    ),
    "tabs": text("time\tlevel", "s\tV", separator="\t"),
    "semicolons": text("time;level", "s;V", separator=";"),
    "decimal-commas": text("time;level", "s;V", separator=";").replace(".", ","),
    "decimal-commas-and-tabs": text("time\tlevel", "s\tV", separator="\t").replace(".", ","),
    "white-space": text("time (s)   level (V)", separator="   "),
    "nanoseconds": text("time,level", "ns,V", factor=1e9, digits=12),
    "comments": "# taken on the bench\n% 3 mW\n" + text("time,level", "s,V"),
    "a-comment-between": text("time,level", "s,V").replace("\n-0.01", "\n# here\n-0.01", 1),
    "trailing-commas": text("time,level", "s,V").replace("\n", ",\n"),
    "trailer": text("time,level", "s,V") + "END\n",
    "settings-below": text("time,level", "s,V") + "END\nProbe,5\nSamples,600\n",
    "blank-trailer": text("time,level", "s,V") + ",\n,\n",
    "level-first": "\n".join(
        ["level,time", "V,s", *[",".join(row.split(",")[::-1]) for row in rows()]]
    ),
    "a-unit-with-a-slash": text("time,level", "s,W/m2"),
    "words-in-a-column": "\n".join(["mark,time,level", ",s,V", *["a," + row for row in rows()]]),
}
"""Texts of one trace, each in another spelling."""


@pytest.mark.parametrize("slug", SPELLINGS)
def test_spellings_of_a_table_are_one_trace(slug, tmp_path):
    """Headings, separators, decimals and lines beside the numbers do not change the trace."""
    trace = read(tmp_path, SPELLINGS[slug])
    np.testing.assert_allclose(trace.time, TIME, rtol=0, atol=1e-3 * STEP)
    np.testing.assert_allclose(trace.level, LEVEL, rtol=0, atol=6e-6)


@pytest.mark.parametrize(
    ("encoding", "sign"),
    [
        ("utf-8", "\u00b5"),
        ("utf-8", "\u03bc"),
        ("utf-8-sig", "\u00b5"),
        ("utf-16", "\u03bc"),
        ("latin-1", "\u00b5"),
    ],
)
def test_microseconds_are_read_in_each_encoding(encoding, sign, tmp_path):
    """Both micro signs are one, in UTF-8 with a byte order mark or without, UTF-16 and Latin-1."""
    trace = read(tmp_path, text("time,level", f"{sign}s,V", factor=1e6), encoding)
    np.testing.assert_allclose(trace.time, TIME, rtol=0, atol=1e-3 * STEP)


def test_times_of_a_trace_are_in_the_unit_that_it_names(tmp_path):
    """Seconds, milliseconds and microseconds are told apart by the second line, to the last bit."""
    for unit, factor in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6)):
        (tmp_path / "t.csv").write_text(f"level,time\nmV,{unit}\n3,1.5\n4,2.5\n")
        trace = read_trace(tmp_path / "t.csv")
        np.testing.assert_allclose(trace.time, np.array([1.5, 2.5]) * factor, rtol=1e-15)
        assert trace.level.tolist() == [3, 4]


def test_a_column_is_chosen_by_name(tmp_path):
    """Of several channels one is named, however it is spelt; that of the name level is default."""
    content = tektronix_mso(TIME, LEVEL, channels=3)
    for name, sign in (("CH2", -1), ("ch3", 1)):
        trace = read(tmp_path, content, column=name)
        np.testing.assert_allclose(trace.level, sign * LEVEL, rtol=0, atol=1e-6)
    for times in ("One", "No"):
        trace = read(tmp_path, labview(TIME, LEVEL, times, channels=2), column="voltage_1")
        np.testing.assert_allclose(trace.level, -LEVEL, rtol=0, atol=1e-6)
    pairs = zip(rows(), TIME, strict=True)
    lines = [f"{row},{5.0 * (t > -HALF)}" for row, t in pairs]
    mine = "\n".join(["time (s),level (V),gate (V)", *lines])
    np.testing.assert_allclose(read(tmp_path, mine).level, LEVEL, rtol=0, atol=6e-6)
    assert set(read(tmp_path, mine, column="gate").level) == {0.0, 5.0}


def test_a_count_that_begins_late_begins_late(tmp_path):
    """Part of a counted export keeps its times, which the count and the start give."""
    lines = rigol_ds1000z(TIME, LEVEL).splitlines()
    trace = read(tmp_path, "\n".join([*lines[:2], *lines[2 + 57 :]]))
    np.testing.assert_allclose(trace.time, TIME[57:], rtol=0, atol=1e-3 * STEP)


def test_without_a_start_time_counts_from_the_first_sample(tmp_path):
    """A sample interval alone gives times from 0 on, for `middle` to place."""
    content = "\n".join([f"Sample Interval,{STEP * 1e6:.9g} us", *[f"{v:.6g}" for v in LEVEL]])
    np.testing.assert_allclose(read(tmp_path, content).time, TIME - TIME[0], atol=1e-3 * STEP)


def test_times_that_are_rounded_may_repeat(tmp_path):
    """Four digits of a fine trace repeat; its profile is the trace's to what rounding changes."""
    time, level = pulse(6000)
    lines = [f"{t:.3e},{v:.6g}" for t, v in zip(time, level, strict=True)]
    trace = read(tmp_path, "\n".join(["time,level", "s,V", *lines]))
    assert np.sum(np.diff(trace.time) == 0) > 500
    found, exact = (
        measured_profile(each, half_exposure=HALF) for each in (trace, trace._replace(time=time))
    )
    tau = np.linspace(-0.95, 0.95, 77)
    difference = found.shutter.transmittance(tau) - exact.shutter.transmittance(tau)
    assert np.max(np.abs(difference)) < 3e-3


BEFORE = [f'"Sample Interval",{STEP:.9g}', f'"Start",{TIME[0]:.9g}', '"VUnit","V"']
"""Settings that give the times of levels alone."""
ABOVE = {
    "a-number": (",", ['"Probe",5']),
    "a-sign": (",", ["%Probe,5", "* Channel_1,2", "1st probe,7", "Gain:,3"]),
    "three-numbers": (",", ["Samples,300", "Channel,1", "Vertical Scale,0.5"]),
    "four-numbers": (",", ["Samples,300", "Channel,1", "Vertical Scale,0.5", "Offset,-0.3"]),
    "numbers-and-words": (",", ["Channel,1", "Scale,0.5", "Offset,0", "Coupling,DC", "Probe,10"]),
    "units": (",", ["Trigger Level,0.4,V", "Bandwidth,20,MHz"]),
    "a-source": (",,", ['"HUnit","s"', '"Probe","CH1",5']),
    "the-unit-of-time": (",", ['"HUnit","s"']),
}
"""Empty cells before each number, and settings directly above the numbers."""


@pytest.mark.parametrize("slug", ABOVE)
def test_a_setting_above_the_numbers_is_no_sample(slug, tmp_path):
    """It has as many cells as a line of numbers has, but a name before its value."""
    beside, settings = ABOVE[slug]
    levels = [f"{beside}{v:.6g}" for v in LEVEL]
    times = [f"{beside}{row}" for row in rows()]
    both = [f"{beside}{v:.6g},{-v:.6g}" for v in LEVEL]
    doubled = [re.sub(r",(-?[\d.]+)", r",\1,\1", row) for row in settings]
    names = f'"TraceName"{beside}CH1,CH2'
    for separator in ",;\t":
        for lines, column in (
            ([*BEFORE, *settings, *levels], None),
            ([f"{beside}time (s),level", *doubled, *times], None),
            ([*BEFORE[:2], *doubled, names, *both], "CH1"),
        ):
            content = "\n".join(lines).replace(",", separator)
            trace = read(tmp_path, content, column=column)
            np.testing.assert_allclose(trace.time, TIME, rtol=0, atol=1e-3 * STEP)
            np.testing.assert_allclose(trace.level, LEVEL, rtol=0, atol=6e-6)


def test_a_setting_above_the_times_of_day_is_no_sample(tmp_path):
    """A column of clock readings is no column of names."""
    levels = [f"12:{k // 60:02}:{k % 60:02} PM,{v:.6g}" for k, v in enumerate(LEVEL)]
    trace = read(tmp_path, "\n".join([*BEFORE, "Samples,600", "Probe,5", "Gain,3", *levels]))
    np.testing.assert_allclose(trace.time, TIME, rtol=0, atol=1e-3 * STEP)
    np.testing.assert_allclose(trace.level, LEVEL, rtol=0, atol=6e-6)


def test_a_unit_of_time_above_the_numbers_names_no_column(tmp_path):
    """Settings end with the unit of time, above columns without names: it is no level's unit."""
    header = [f"Sampling Period,{STEP * 1e3:.9g}", "Vertical Units,V", "Horizontal Units,ms"]
    trace = read(tmp_path, text(*header, factor=1e3))
    np.testing.assert_allclose(trace.time, TIME, rtol=0, atol=1e-3 * STEP)
    levels = [f",{v:.6g}" for v in LEVEL]
    header = [f'"Interval",{STEP * 1e6:.9g}', f'"X0",{TIME[0] * 1e6:.9g}', '"HUnit","us"']
    trace = read(tmp_path, "\n".join([*header, *levels]))
    np.testing.assert_allclose(trace.time, TIME, rtol=0, atol=1e-3 * STEP)


def test_names_of_settings_are_known_by_their_letters(tmp_path):
    """Spaces, underscores and capitals of a maker's names do not matter."""
    levels = [f"{v:.6g}" for v in LEVEL]
    for name, start in (("Delta_X", "X0"), ("deltaX", "x0"), ("sample_interval", "X Org")):
        for sign in (",", ": ", " = "):
            header = [f"{name}{sign}{STEP:.9g}", f"{start}{sign}{TIME[0]:.9g}"]
            trace = read(tmp_path, "\n".join([*header, *levels]))
            np.testing.assert_allclose(trace.time, TIME, rtol=0, atol=1e-3 * STEP)


DIGITS = {
    "arabic": "\u0660\u0661\u0662\u0663\u0664\u0665\u0666\u0667\u0668\u0669",
    "devanagari": "\u0966\u0967\u0968\u0969\u096a\u096b\u096c\u096d\u096e\u096f",
    "full-width": "\uff10\uff11\uff12\uff13\uff14\uff15\uff16\uff17\uff18\uff19",
}


@pytest.mark.parametrize("slug", DIGITS)
def test_digits_of_other_scripts_are_digits(slug, tmp_path):
    """A column is read wherever its numbers are recognised, with each separator and sign."""
    signs = {"full-width": ".\uff0e-\uff0d", "arabic": ".\u066b-\u2212"}.get(slug, "-\u2013")
    table = str.maketrans("0123456789" + signs[::2], DIGITS[slug] + signs[1::2])
    for separator in (",", "\t", ";", "  "):
        for lines in (
            [row.translate(table) for row in rows(separator, digits=7)],
            [f"{t:.7f}{separator}{v:.6f}".translate(table) for t, v in [(TIME[0], LEVEL[0])]]
            + rows(separator, digits=7)[1:],
        ):
            trace = read(tmp_path, "\n".join(["time (s),level", *lines]))
            np.testing.assert_allclose(trace.time, TIME, rtol=0, atol=2e-3 * STEP)
            np.testing.assert_allclose(trace.level, LEVEL, rtol=0, atol=6e-6)


def test_underscores_between_digits_are_read_among_comments(tmp_path):
    """Python's way of writing long numbers, of a time and of a level, is read or named."""
    pairs = np.rint(np.stack([TIME, LEVEL], axis=1) * 1e9).astype(int)
    lines = [f"{t:_},{v:_}" for t, v in pairs]
    lines.insert(77, "# the trigger, 5_0")
    trace = read(tmp_path, "\n".join(["time (ns),level (nV)", *lines]))
    np.testing.assert_allclose(trace.time, TIME, rtol=0, atol=1e-9)
    np.testing.assert_allclose(trace.level, LEVEL * 1e9, rtol=0, atol=1)
    for wrong in ("5__0", "5_", "\u00b2"):
        lines[201] = f"{pairs[200][0]},{wrong}"
        with pytest.raises(ValueError, match=f"hold numbers alone .*; got {lines[201]}"):
            read(tmp_path, "\n".join(["time (ns),level (nV)", *lines]))


@pytest.mark.parametrize("separator", [",", "\t", ";", " ", "   "])
@pytest.mark.parametrize("before", ["", "a"])
def test_a_hint_works_as_it_stands(separator, before, tmp_path):
    """The line that an error proposes makes the file readable, whatever separates its numbers."""
    beside = f"{before}{separator}"
    blocks = [
        ["Time;Ampl"],
        [],
        ["Segments,1,SegmentSize,600"],
    ]
    for header in blocks:
        for lead in ("", beside if before or separator.strip() or separator == "\t" else ""):
            for lines in (rows(separator), [f"{v:.6g}" for v in LEVEL]):
                numbers = [lead + line for line in lines]
                with pytest.raises(ValueError, match="above its numbers would") as caught:
                    read(tmp_path, "\n".join([*header, *numbers]))
                hint = str(caught.value).split("`")[3].replace("1e-5", f"{STEP:.9g}")
                trace = read(tmp_path, "\n".join([*header, hint, *numbers]))
                start = TIME[0] if "time" in hint else 0.0
                np.testing.assert_allclose(trace.time - start, TIME - TIME[0], atol=1e-3 * STEP)
                np.testing.assert_allclose(trace.level, LEVEL, rtol=0, atol=6e-6)


@pytest.mark.parametrize("unit", ["Counts/s", "lx/s", "W/m2/s", "1/s", "kCounts / ms", "V/us"])
def test_a_rate_is_no_time(unit, tmp_path):
    """A level per second stands beside times, in either order, or is what an interval times."""
    pairs = [row.split(",") for row in rows(factor=1e3)]
    for lines in (
        [f"Time (ms),{unit}", *map(",".join, pairs)],
        [f"t/ms,{unit}", *map(",".join, pairs)],
        [f"{unit},Date/Time (ms)", *[f"{v},{t}" for t, v in pairs]],
        [f"{unit},Zeit/ms", *[f"{v},{t}" for t, v in pairs]],
        ["time,level", f"ms,{unit}", *map(",".join, pairs)],
        [f"Sample Interval,{STEP:.9g}", f"Start,{TIME[0]:.9g}", f"{unit},", *[v for _, v in pairs]],
    ):
        trace = read(tmp_path, "\n".join(lines))
        np.testing.assert_allclose(trace.time, TIME, rtol=0, atol=1e-3 * STEP)
        np.testing.assert_allclose(trace.level, LEVEL, rtol=0, atol=6e-6)
    with pytest.raises(ValueError, match=rf"unit of a column of times, .*; got x,{unit}"):
        read(tmp_path, "\n".join([f"x,{unit}", *map(",".join, pairs)]))


def test_a_gate_beside_a_signal_is_no_list_of_transitions(tmp_path):
    """Two channels of a logic analyser, listed at their changes, are refused by name."""
    steps = [f"{t:.6f},{k // 3 % 2},{k % 2}" for k, t in enumerate(TIME)]
    with pytest.raises(ValueError, match=r"must hold samples, .*; got a list of transitions, 600"):
        read(tmp_path, "\n".join(["Time [s],D0,D1", *steps]), column="D0")
    gates = [f"{t:.6f},{v:.6f},{k % 2}" for k, (t, v) in enumerate(zip(TIME, LEVEL, strict=True))]
    trace = read(tmp_path, "\n".join(["Time [s],A0,D1", *gates]), column="D1")
    assert trace.level.mean() == 0.5


def with_value(content, value):
    """The text with one level, a third of the way down, replaced."""
    lines = content.splitlines()
    place = len(lines) // 3
    lines[place] = lines[place].rpartition(",")[0] + "," + value
    return "\n".join(lines)


REFUSED = {
    "overrange": (
        with_value(keysight(TIME, LEVEL), "+9.9E+37"),
        r"must hold finite numbers below 9.9e\+37, .* out of its range; got .*,\+9.9E\+37\.",
    ),
    "infinite": (with_value(picoscope(TIME, LEVEL), "\u221e"), "must hold finite .*\u221e"),
    "negative-infinite": (with_value(text("time,level", "s,V"), "-inf"), "finite .*-inf"),
    "no-number": (with_value(text("time,level", "s,V"), "nan"), "finite .*,nan"),
    "a-word": (
        with_value(text("time,level", "s,V"), "OVER"),
        "must hold numbers alone from the first row of them to the last; got .*,OVER",
    ),
    "a-missing-level": (with_value(text("time,level", "s,V"), ""), "hold numbers alone .*,'?\\."),
    "two-records": (
        text("time,level", "s,V") * 2,
        "must hold numbers alone from the first row of them to the last; got time,level",
    ),
    "no-unit": (
        text("LECROYWR104Xi,42,Waveform", "Segments,1,SegmentSize,600", "Time,Ampl"),
        r"must name s, ms, us or ns as the unit of a column of times, as `time \(s\),level` above "
        r"its numbers would say; got Segments,1,SegmentSize,600 / Time,Ampl",
    ),
    "minutes": (text("time,level", "min,V"), "must name s, ms, .* got time,level / min,V"),
    "a-signal-of-the-name-s": (text("t,s"), "must name s, ms, us or ns as the unit .*; got t,s"),
    "numbers-alone": ("\n".join(rows()), "must name s, ms, us or ns as the unit .*; got -0.025,0"),
    "several-channels": (
        tektronix_mso(TIME, LEVEL, channels=3),
        "have one column of levels, or be read with the name of one as its `column` or "
        "`--measured-column`; got CH1, CH2",
    ),
    "channels-of-one-name": (
        text("time (s),V").replace("\n", ",7\n").replace("V,7", "V,V"),
        "have one column of levels, or a line of their names above its numbers; got V, V",
    ),
    "channels-without-names": (
        "\n".join([*BEFORE, *[f",{v:.6g},7" for v in LEVEL]]),
        "or a line of their names above its numbers; got one without a name, one without a name",
    ),
    "times-alone": (text("time,time", "ms,ms"), "have a column of levels beside the times"),
    "decimal-commas-between-commas": (
        text("time,level", "ms,V", factor=1e3).replace(".", ","),
        r"hold as many numbers in each line \(decimal commas need another separator\); got -25,0,",
    ),
    "one-name-too-few": (
        text("time,level", "s,V").replace("\n", ",7\n").replace("V,7", "V").replace("l,7", "l"),
        r"must have a name above each column of numbers \(decimal commas need another separator\)",
    ),
    "prose": (
        "once upon a time\n" * 9,
        r"must hold lines of numbers in columns, as those of times",
    ),
    "times-of-edges": (
        "time (s),edge\n-0.02,rising\n0.011,falling\n",
        "have a column of levels beside the times; got none: the times at which a shutter moves a",
    ),
    "an-interval-in-minutes": (
        "\n".join(["Sample Interval,3 min", *[f"{v:.6g}" for v in LEVEL]]),
        "must have its sample interval in s, ms, us or ns; got 3 min",
    ),
    "a-clock-in-hertz": (
        "\n".join(["Horizontal Units,Hz", "Increment,25", *[f"{v:.6g}" for v in LEVEL]]),
        "must have its times in s, ms, us or ns; got Hz",
    ),
    "an-interval-of-each-channel": (
        labview(TIME, LEVEL, "No", 2).replace("Delta_X\t", "Delta_X\t3.5E-5\t"),
        "must have one sample interval for all of its columns; got 3.5E-5,8.3",
    ),
    "no-value-for-a-unit": (
        "\n".join(["Horizontal Units,", *[f"{v:.6g}" for v in LEVEL]]),
        "give the time from one of its levels to the next, as `Sample Interval,1e-5 s` above its",
    ),
    "empty": ("\n", "must hold lines of numbers in columns, .*; got an empty file"),
    "one-long-line": ("0.5," * 5000, "must name s, ms, us or ns as the unit"),
    "one-long-cell": (("5" * 140_000 + ",1\n") * 3, "must give the time from one of its le"),
    "binary": (b":WFMPRE:BYT_NR 2;:CURVE #42000\x00\x01\xff", "must be text, as CSV is, in UTF-8"),
    "backwards": (
        "\n".join(["time,level", "s,V", *rows()[::-1]]),
        "must have times that ascend; got 0.02",
    ),
    "one-time": ("time,level\ns,V\n2,3\n2,4\n2,5\n", "must have times that ascend; got one time"),
}


@pytest.mark.parametrize("slug", REFUSED)
def test_what_a_file_does_not_say_is_not_guessed(slug, tmp_path):
    """A level out of range, a unit that is not told or a choice that is open: one line says so."""
    content, message = REFUSED[slug]
    with pytest.raises(ValueError, match=message) as caught:
        read(tmp_path, content)
    assert "\n" not in str(caught.value)


def test_a_column_that_is_not_there_is_refused(tmp_path):
    """The names that a file has are told."""
    with pytest.raises(ValueError, match="have one column of levels of the name CH9; got CH1, CH2"):
        read(tmp_path, tektronix_mso(TIME, LEVEL, channels=2), column="CH9")
