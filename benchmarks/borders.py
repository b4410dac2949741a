"""How good are the borders of a restored photograph, beside the middle and beside the usual?

A typical printout stands in `RESULTS.md`.
"""

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

from support import borders  # noqa: E402

import mishutter as ms  # noqa: E402
from benchmarks import harness, restoration_over_speeds  # noqa: E402

DECODERS = restoration_over_speeds.DECODERS | {
    "Richardson-Lucy, 30 plain steps": ms.RichardsonLucyDecoder(
        30, accelerated=False, until_noise=False, start="capture"
    ),
}
PHOTON_RATES = (3e5, 3e6)
WITHIN_DB, ABOVE_DB = 3, 6
TEXT = """## Borders of a restored photograph

PSNR in dB of the outermost {border} columns (the kernel's length) at either end of a row, on
{count} photographs that go on beyond the sensor, Hann window, {half:g} s half exposure: `middle`
is what lies between, `recorded beyond` the same columns on a sensor that goes on beyond them,
`wrapped` the same decoder on rows taken for periodic, `scikit-image` its `wiener` or
`richardson_lucy` with the same kernel and spectra. The last columns count the photographs
whose borders are within {within} dB of the middle, and at least {above} dB above the wrapped.

Means over the photographs:

{means}

The ensemble filter at 3e6 e-/s, photograph by photograph:

{each}"""


def measure() -> list[dict]:
    """A row for each photograph, decoder and light."""
    rows = []
    for photon_rate in PHOTON_RATES:
        for name, decoder in DECODERS.items():
            for photograph in borders.PHOTOGRAPHS:
                found = borders.measured(photograph, decoder, photon_rate)._asdict()
                row = {"e-/s": photon_rate, "decoder": name, "photograph": photograph}
                rows.append({**row, **found})
    return rows


def shown(row: dict) -> dict:
    """A row under the names of the table's columns, its numbers to a tenth of a dB."""
    names = {
        "inner": "middle",
        "border": "border",
        "recorded": "recorded beyond",
        "wrapped": "wrapped",
        "reference": "scikit-image",
    }
    numbers = {new: f"{row[old]:.1f}" for old, new in names.items()}
    gains = {
        "below the middle": f"{row['inner'] - row['border']:.1f}",
        "above wrapped": f"{row['border'] - row['wrapped']:.1f}",
    }
    return numbers | gains


def mean_rows(rows: list[dict]) -> list[dict]:
    """Means over the photographs, and how many meet each bound."""
    result = []
    for photon_rate in PHOTON_RATES:
        for name in DECODERS:
            mine = [r for r in rows if (r["e-/s"], r["decoder"]) == (photon_rate, name)]
            figures = {k: float(np.mean([r[k] for r in mine])) for k in borders.Borders._fields}
            near = sum(r["inner"] - r["border"] <= WITHIN_DB for r in mine)
            above = sum(r["border"] - r["wrapped"] >= ABOVE_DB for r in mine)
            result.append(
                {
                    "light": f"{photon_rate:.0e} e-/s",
                    "decoder": name,
                    **shown(figures),
                    f"within {WITHIN_DB} dB": f"{near} of {len(mine)}",
                    f"{ABOVE_DB} dB above": f"{above} of {len(mine)}",
                }
            )
    return result


def main() -> None:
    """Measure, store and print."""
    rows = measure()
    harness.write("borders", rows, columns=borders.COLUMNS, border=borders.BORDER)
    means = mean_rows(rows)
    best = [r for r in rows if (r["e-/s"], r["decoder"]) == (PHOTON_RATES[-1], "ensemble")]
    each = [{"photograph": r["photograph"], **shown(r)} for r in best]
    text = TEXT.format(
        border=borders.BORDER,
        count=len(borders.PHOTOGRAPHS),
        half=borders.HALF_EXPOSURE,
        within=WITHIN_DB,
        above=ABOVE_DB,
        means=harness.table(means, list(means[0])),
        each=harness.table(each, list(each[0])),
    )
    harness.section("borders", text)


if __name__ == "__main__":
    main()
