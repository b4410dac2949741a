"""What the paper states, what came out, and the page that says so.

"The paper" is "Improved motion invariant imaging with time varying shutter functions".
"""

from typing import Any

import numpy as np

from mishutter.paper.capture import PLAIN

TITLE = "Improved motion invariant imaging with time varying shutter functions"
"""Title of the paper whose statements are held against what came out."""

Statement = dict[str, Any]
"""`claim` as published, `met`, and `found`: the numbers."""

_SMOOTH = ("triangle", "hann", "gaussian")


def statements(numbers: dict[str, Any]) -> list[Statement]:
    """Every published statement beside what was found."""
    return [
        *_kernel_statements(numbers),
        *_spectrum_statements(numbers["figure_4"]),
        *_ghost_statements(numbers["figure_5"]),
        *_speed_statements(numbers["figure_6"]),
        *_plain_statements(numbers["decoders"]),
        _noise_statement(numbers["figure_6"]),
    ]


def report_page(numbers: dict[str, Any]) -> str:
    """The page, in Markdown."""
    setting = numbers["setting"]
    lines = [
        "# What the paper states, and what came out",
        "",
        f'The paper is "{TITLE}"; figures, sections and equations are numbered as there.',
        "",
        f"Stroke {setting['stroke_px']:g} px, phase {setting['phase_px']:g}, "
        f"{setting['electrons_at_white']:g} e- at white and {setting['read_noise_e']:g} e- of "
        "read noise unless said otherwise; decoder: " + setting["decoder"] + ". PSNR with "
        "gamma 2.2 put back, on photographs whose borders are real. The paper says neither "
        "how much light it assumed nor what its speed axis is normalised by: both readings "
        "of the axis are given, `s/(aT)` and `s/(2aT)`; the first fits the paper's own "
        "kernel lengths (34 to 51 samples) and is the likelier.",
        "",
        "| published | met | found |",
        "|---|---|---|",
    ]
    for statement in numbers["statements"]:
        mark = "yes" if statement["met"] else "**no**"
        lines.append(f"| {statement['claim']} | {mark} | {statement['found']} |")
    missed = sum(not s["met"] for s in numbers["statements"])
    total = len(numbers["statements"])
    lines += [
        "",
        f"{total - missed} of {total} met; by reading of the axis: {_by_reading(numbers)}.",
        "",
        "## Condition numbers",
        "",
        f"At a stroke of {numbers['figure_4']['stroke_px']:g} px, phase 0, over a DFT of "
        f"{numbers['figure_4']['dft_length']} points.",
        "",
        "| kernel | published | found |",
        "|---|---|---|",
    ]
    four = numbers["figure_4"]
    lines += [
        f"| {name} | {four['published'][name]:g} | {value:.2f} |"
        for name, value in four["condition"].items()
    ]
    lines += _decoder_lines(numbers["decoders"])
    for reading, photographs in numbers["figure_6"]["psnr_over_speed"].items():
        lines += ["", f"## PSNR against speed, {reading}", ""]
        lines += _psnr_table(numbers["figure_6"]["speed"], photographs)
    lines += [
        "",
        "## Figures",
        "",
        *(f"![Figure {n}](figure_{n}.png)\n" for n in (3, 4, 5, 6)),
        "`figures.json` holds every number in them.",
        "",
    ]
    return "\n".join(lines)


def _by_reading(numbers: dict[str, Any]) -> str:
    counts = []
    for reading in numbers["setting"]["speed_readings"]:
        mine = [s["met"] for s in numbers["statements"] if reading in s["claim"]]
        counts.append(f"{sum(mine)} of {len(mine)} with `{reading}`")
    return ", ".join(counts)


def _decoder_lines(numbers: dict[str, Any]) -> list[str]:
    """What Hann gains over rect by each decoder, and what of that is the decoder's doing."""
    speeds, lines = numbers["speed"], ["", "## Hann over rect by other decoders", ""]
    lines += [
        "Richardson-Lucy sharpens less the fewer steps it takes, and so hides differences "
        "between kernels; the accelerated form goes about as far in 10 steps as the plain "
        "in 30. Gain of Hann over rect in dB; the last column is Hann's own PSNR at "
        f"{speeds[0]:g}. All but the last decoder take every object for a still one.",
    ]
    for reading, photographs in numbers["psnr"].items():
        head = " | ".join(f"{v:g}" for v in speeds)
        lines += ["", f"| photograph | decoder | {reading} = {head} | Hann |"]
        lines.append("|---" * (len(speeds) + 3) + "|")
        by_decoder: dict[str, list[float]] = {}
        for photograph, decoders in photographs.items():
            for name, psnr in decoders.items():
                gain = _gain(psnr)
                by_decoder.setdefault(name, []).extend(gain.tolist())
                cells = " | ".join(f"{v:+.1f}" for v in gain)
                lines.append(f"| {photograph} | {name} | {cells} | {psnr['hann'][0]:.1f} |")
        ranges = [f"{n} {min(v):.1f} to {max(v):.1f} dB" for n, v in by_decoder.items()]
        lines += ["", f"Over all photographs and speeds, {reading}: " + "; ".join(ranges) + "."]
    return lines


def _psnr_table(speeds: list[float], photographs: dict[str, Any]) -> list[str]:
    head = " | ".join(f"{v:.2f}" for v in speeds)
    lines = [f"| photograph | shutter | {head} |", "|---" * (len(speeds) + 2) + "|"]
    for photograph, windows in photographs.items():
        for window, values in windows.items():
            cells = " | ".join(f"{v:.1f}" for v in values)
            lines.append(f"| {photograph} | {window} | {cells} |")
    return lines


def _kernel_statements(numbers: dict[str, Any]) -> list[Statement]:
    three, found = numbers["figure_3"], []
    for reading, rms in three["rms"].items():
        rect, hann = np.array(rms["rect"])[1:], np.array(rms["hann"])[1:]
        below = hann < rect
        rising = bool(np.all(np.diff(rms["rect"]) >= 0))
        crossing = "" if below.all() else f"; above from {three['speed'][1 + below.argmin()]:.2f}"
        found.append(
            _statement(
                f"Smooth shuttering reduces the RMS kernel difference over the range ({reading})",
                bool(below.all()),
                f"Hann/rect {hann[0] / rect[0]:.2f} at 0.05, {hann[-1] / rect[-1]:.2f} at 0.5"
                + crossing,
            )
        )
        found.append(
            _statement(
                f"For rect the difference rises steadily with speed ({reading})",
                rising,
                f"{rect[0]:.2e} at 0.05 to {rect[-1]:.2e} at 0.5",
            )
        )
    stroke = numbers["setting"]["stroke_px"]
    lengths = {
        r: stroke * (1 + 0.5 * k) ** 2 for r, k in numbers["setting"]["speed_readings"].items()
    }
    text = "; ".join(f"{stroke:g} to {v:.0f} px by {r}" for r, v in lengths.items())
    fits = min(abs(v - 51) for v in lengths.values()) < 3
    found.append(_statement("Kernels are 34 to 51 samples long", fits, text))
    return found


def _spectrum_statements(four: dict[str, Any]) -> list[Statement]:
    found = []
    for name, value in four["condition"].items():
        published = four["published"][name]
        close = abs(value - published) < 0.02 * published
        claim = f"Condition number of {name}: {published:g}"
        found.append(_statement(claim, close, f"{value:.2f}"))
    magnitude = {name: np.array(v) for name, v in four["magnitude"].items()}
    rect, hann = magnitude["motion invariant, rect"], magnitude["motion invariant, Hann"]
    lower = bool(hann[0] < rect[0])
    found.append(
        _statement(
            "A smooth shutter attenuates low frequencies",
            lower,
            f"response at 0: {hann[0]:.2f} of an open exposure against {rect[0]:.2f}",
        )
    )
    flatter = hann.max() / hann.min() < rect.max() / rect.min()
    found.append(
        _statement(
            "A smooth shutter makes the response notably flatter",
            bool(flatter),
            f"largest over least {np.max(hann) / np.min(hann):.2f} against "
            f"{np.max(rect) / np.min(rect):.2f}",
        )
    )
    return found


def _ghost_statements(five: dict[str, Any]) -> list[Statement]:
    found = []
    for reading, photographs in five.items():
        ratios = [
            rect / hann if hann > 0 else np.inf
            for values in photographs.values()
            for rect, hann in zip(
                *(values["ghost_energy"][w] for w in ("rect", "hann")), strict=True
            )
        ]
        found.append(
            _statement(
                f"No ghost with Hann at 0.1 and 0.3: energy at least 10 times lower ({reading})",
                min(ratios) >= 10,
                f"{min(ratios):.0f} to {max(ratios):.0f} times lower",
            )
        )
    return found


def _speed_statements(six: dict[str, Any]) -> list[Statement]:
    found = []
    speed = np.array(six["speed"])
    for reading, photographs in six["psnr_over_speed"].items():
        for name, windows in photographs.items():
            rows = {w: np.array(v) for w, v in windows.items()}
            gain = rows["hann"] - rows["rect"]
            fast = speed >= 0.2
            within = bool(np.all((gain[fast] >= 3) & (gain[fast] <= 8)))
            text = f"{gain[fast].min():.1f} to {gain[fast].max():.1f} dB from 0.2 to 0.5"
            where = f"({name}, {reading})"
            found.append(
                _statement(f"Hann over rect 3 to 8 dB at mid to high speeds {where}", within, text)
            )
            spread = np.ptp([rows[w] for w in _SMOOTH], axis=0)
            text = f"spread at most {spread.max():.2f} dB"
            found.append(
                _statement(f"Smooth windows within 1 dB {where}", bool(spread.max() < 1), text)
            )
            fit = np.corrcoef(speed, rows["rect"])[0, 1] ** 2
            slope = np.polyfit(speed, rows["rect"], 1)[0]
            text = f"{slope:.0f} dB per unit of speed, a line explains {100 * fit:.0f} %"
            falls = bool(slope < 0 and fit > 0.9)
            found.append(_statement(f"Rect declines in proportion to speed {where}", falls, text))
            text = f"{gain[0]:.1f} dB"
            found.append(
                _statement(f"Better also for a still object {where}", bool(gain[0] > 0), text)
            )
            slow = rows["hann"][speed <= 0.2]
            late = rows["hann"][-1]
            fall = slow[-1] - late
            text = f"Hann loses {np.ptp(slow):.1f} dB up to 0.2, {fall:.1f} dB from there to 0.5"
            steady = bool(np.ptp(slow) < fall)
            found.append(
                _statement(
                    f"Hann is consistent up to about 0.2, then declines {where}", steady, text
                )
            )
    return found


def _plain_statements(numbers: dict[str, Any]) -> list[Statement]:
    """The gain by Richardson-Lucy as it is, should the paper not have used MATLAB's form."""
    found = []
    for reading, photographs in numbers["psnr"].items():
        gains = np.array([_gain(decoders[PLAIN]) for decoders in photographs.values()])
        within = bool(np.all((gains >= 3) & (gains <= 8)))
        claim = f"Hann over rect 3 to 8 dB also by 30 plain iterations, all photographs ({reading})"
        text = f"{gains.min():.1f} to {gains.max():.1f} dB from 0.2 to 0.5"
        found.append(_statement(claim, within, text))
    return found


def _gain(psnr: dict[str, list[float]]) -> np.ndarray:
    return np.array(psnr["hann"]) - np.array(psnr["rect"])


def _noise_statement(six: dict[str, Any]) -> Statement:
    levels, found, faster = six["electrons"], [], True
    for name, windows in six["psnr_over_noise"].items():
        drops = {w: windows[w][len(levels) // 2] - windows[w][0] for w in ("rect", "hann")}
        faster &= drops["hann"] > drops["rect"]
        found.append(f"{name}: Hann {drops['hann']:.1f} dB, rect {drops['rect']:.1f} dB")
    text = f"from {levels[len(levels) // 2]:.0e} to {levels[0]:.0e} e-: " + "; ".join(found)
    return _statement("PSNR drops faster with noise under smooth shuttering", bool(faster), text)


def _statement(claim: str, met: bool, found: str) -> Statement:
    return {"claim": claim, "met": bool(met), "found": found}
