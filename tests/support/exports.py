"""Traces as instruments export them, in the layouts that their makers write.

Each function makes the text of a trace of times in s and levels in V, with the header of that
instrument. Numbers have the digits that it writes.
"""

import numpy as np

HALF = 0.02
"""Half of the exposure; s."""


def pulse(count=600, seed=3):
    """Times and levels of a shutter that opens once, from 0.05 V to about 1.25 V, with noise."""
    time = np.linspace(-1.25, 1.25, count) * HALF
    rng = np.random.default_rng(seed)
    light = np.where(np.abs(time) < HALF, np.cos(np.pi * time / (2 * HALF)) ** 2, 0)
    return time, 0.05 + 1.2 * light**1.5 + 0.008 * rng.standard_normal(count)


def tektronix_tds(time, level):
    """TDS 1000 and 2000: settings stand beside the first samples."""
    step = time[1] - time[0]
    beside = [
        f"Record Length,{time.size:e},",
        f"Sample Interval,{step:e},",
        "Trigger Point,1.250000000000e+03,",
        *[",,"] * 3,
        "Source,CH1,",
        "Vertical Units,V,",
        "Vertical Scale,5.000000e-01,",
        "Vertical Offset,0.000000e+00,",
        "Horizontal Units,s,",
        "Horizontal Scale,5.000000e-03,",
        "Pt Fmt,Y,",
        "Yzero,0.000000e+00,",
        "Probe Atten,1.000000e+00,",
        "Model Number,TDS2014C,",
        "Serial Number,C010203,",
        "Firmware Version,FV:v24.26,",
    ]
    beside += [",,"] * (time.size - len(beside))
    rows = zip(beside, time, level, strict=True)
    return "".join(f"{b},{t:016.12f},{v:10.5f},\r\n" for b, t, v in rows)


def tektronix_700(time, level):
    """TDS 700 and earlier: the unit of time stands beside the sample interval alone."""
    beside = [
        f'"Record Length",{time.size},"Points"',
        f'"Sample Interval",{time[1] - time[0]:.8e},s',
        '"Trigger Point",39,"Samples"',
        '"Trigger Time",0.2,s',
    ]
    beside += [",,"] * (time.size - len(beside))
    rows = zip(beside, time, level, strict=True)
    return "".join(f"{b},{t:.8e},{v:.8f}\r\n" for b, t, v in rows)


def tektronix_mso(time, level, comment="", channels=1):
    """MSO and DPO 2000 to 6000; MDO 3000 marks the same header as a comment."""
    other = "," * channels
    header = f"""Model,MSO4034
Firmware Version,2.68

Waveform Type,ANALOG{other}
Point Format,Y{other}
Horizontal Units,s{other}
Horizontal Scale,0.004{other}
Horizontal Delay,0{other}
Sample Interval,{time[1] - time[0]:.9g}{other}
Record Length,{time.size}{other}
Gating,0.0% to 100.0%{other}
Probe Attenuation,{",".join("1" * channels)}
Vertical Units,{",".join("V" * channels)}
Vertical Offset,{",".join("0" * channels)}
Vertical Scale,{",".join(["0.2"] * channels)}
Vertical Position,{",".join(["-2.96"] * channels)}
{other}
{other}
Label{other}
TIME,{",".join(f"CH{k + 1}" for k in range(channels))}"""
    lines = [comment + line for line in header.splitlines()]
    lines += [
        ",".join([f"{t:.9e}", *[f"{v * (-1) ** k:.7g}" for k in range(channels)]])
        for t, v in zip(time, level, strict=True)
    ]
    return "\n".join(lines) + "\n"


def keysight(time, level):
    """InfiniiVision: a line of channels' numbers, and one of units in words."""
    rows = [f"{t * 1e3:+.6f}E-03,{v * 1e3:+.4f}E-03" for t, v in zip(time, level, strict=True)]
    return "\r\n".join(["x-axis,1", "second,Volt", *rows]) + "\r\n"


def infiniium(time, level):
    """Infiniium: settings with colons, and levels alone."""
    header = f"""Revision:,0
Type:,raw
Points:,{time.size}
XInc:,{time[1] - time[0]:.12E}
XOrg:,{time[0]:.12E}
XUnits:,Second
YUnits:,Volt
Frame:,DSO9104A:MY50060102
Max Bandwidth:,1.0E+009
Data:,"""
    return "\n".join([header, *[f"{v:.7E}" for v in level]]) + "\n"


def rigol_ds1000z(time, level):
    """DS1000Z: samples are counted, and start and increment stand in the header."""
    step = f"{time[0]:.9e},{time[1] - time[0]:.9e}"
    rows = [f"{k},{v:.4e}," for k, v in enumerate(level)]
    return "\n".join(["X,CH1,Start,Increment,", f"Sequence,Volt,{step}", *rows]) + "\n"


def rigol_ds1000e(time, level):
    """DS1000E and DS2000: names, units in words, and a comma behind each line."""
    rows = [f"{t:.8e},{v:.4e}," for t, v in zip(time, level, strict=True)]
    return "\r\n".join(["X,CH1,", "Second,Volt,", *rows]) + "\r\n"


def rigol_heading(time, level):
    """Later models of Rigol: levels alone, and start and increment in two cells of the heading."""
    heading = f"CH1V,t0 ={time[0]:.9e}, tInc = {time[1] - time[0]:.9e},"
    return "\n".join([heading, *[f"{v:.4e},," for v in level]]) + "\n"


def siglent(time, level):
    """SDS1000X-E: settings by source, then the source's name and units in words."""
    header = f"""Record Length,Analog:{time.size},
Sample Interval,Analog:{time[1] - time[0]:.6E},
Vertical Units,CH1:V,,
Vertical Scale,CH1:0.20,,
Vertical Offset,CH1:-0.60,,
Horizontal Units,s,
Horizontal Scale,5.000000E-03,
Model Number,SDS1104X-E,
Serial Number,SDSMMEBQ3R0102,
Software Version,6.1.33,
Source,CH1
Second,Volt"""
    rows = [f"{t:+.8E},{v:+.6E}" for t, v in zip(time, level, strict=True)]
    return "\n".join([header, *rows]) + "\n"


def gw_instek(time, level):
    """GDS: settings, and no names above the samples."""
    header = f"""Memory Length,{time.size},
Trigger Level,1.20000e-01,
Source,CH1,
Probe,1.0X,
Vertical Units,V,
Vertical Scale,2.00000e-01,
Horizontal Units,S,
Horizontal Scale,5.00000e-03,
Horizontal Mode,Main,
Sampling Period,{time[1] - time[0]:.8e},
Firmware,V1.09,
Mode,Detail,
Waveform Data,"""
    rows = [f"{t:.9e},{v:.6e}," for t, v in zip(time, level, strict=True)]
    return "\n".join([header, *rows]) + "\n"


def picoscope(time, level):
    """PicoScope: names, units in brackets, and an empty line."""
    rows = [f"{t * 1e3:.8f},{v:.8f}" for t, v in zip(time, level, strict=True)]
    return "\r\n".join(["Time,Channel A", "(ms),(V)", "", *rows]) + "\r\n"


def labview(time, level, times="One", channels=1):
    """LabVIEW's measurement file: settings, and the times of one column or of none."""

    def row(name, value):
        return "\t".join([name, *[str(value)] * channels, ""])

    names = [f"Voltage_{k}" for k in range(channels)]
    header = [
        "LabVIEW Measurement\t",
        "Writer_Version\t2",
        "Separator\tTab",
        "Decimal_Separator\t.",
        f"X_Columns\t{times}",
        "Time_Pref\tRelative",
        "Date\t2026/11/27",
        "Time\t12:00:00.1234567",
        "***End_of_Header***\t",
        "\t",
        f"Channels\t{channels}",
        row("Samples", time.size),
        row("Y_Unit_Label", "Volts"),
        row("X_Dimension", "Time"),
        row("X0", f"{time[0]:.16E}"),
        row("Delta_X", f"{time[1] - time[0]:.6E}"),
        "***End_of_Header***\t\t",
        "\t".join(["X_Value", *names, "Comment"]),
    ]
    cells = [f"{t:.9f}" if times == "One" else "" for t in time]
    levels = ["\t".join(f"{v * (-1) ** k:.6f}" for k in range(channels)) for v in level]
    return "\r\n".join([*header, *map("\t".join, zip(cells, levels, strict=True)), ""])


def rohde_schwarz(time, level):
    """RTB and RTM: the first line holds units, and the name of the waveform."""
    rows = [f"{t:.7E},{v:.7E}" for t, v in zip(time, level, strict=True)]
    return "\r\n".join(["in s,C1 in V", *rows]) + "\r\n"


EXPORTS = {
    "tektronix-tds": tektronix_tds,
    "tektronix-700": tektronix_700,
    "tektronix-mso": tektronix_mso,
    "tektronix-mdo": lambda time, level: tektronix_mso(time, level, comment="#"),
    "keysight": keysight,
    "infiniium": infiniium,
    "rigol-ds1000z": rigol_ds1000z,
    "rigol-ds1000e": rigol_ds1000e,
    "rigol-heading": rigol_heading,
    "siglent": siglent,
    "gw-instek": gw_instek,
    "labview": labview,
    "labview-levels-alone": lambda time, level: labview(time, level, times="No"),
    "picoscope": picoscope,
    "rohde-schwarz": rohde_schwarz,
}
