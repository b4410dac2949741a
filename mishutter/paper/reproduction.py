"""The paper's Figures 3 to 6 and its table, computed again and compared with its statements.

"The paper" is "Improved motion invariant imaging with time varying shutter functions".
"""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Float

from mishutter._core.files import write_text
from mishutter.blur.kernel import blur_kernel
from mishutter.blur.spectrum import condition_number
from mishutter.decoding.image_quality import ghost_energy
from mishutter.decoding.photographs import RestoredPhotograph
from mishutter.evaluation.speed_knowledge import ExpectedErrorLoss
from mishutter.model.limits import Limits
from mishutter.model.scene import Scene
from mishutter.model.shutters.base import AbstractShutter
from mishutter.model.shutters.chips import RASKAR_CODE
from mishutter.model.shutters.spline import SplineShutter
from mishutter.model.shutters.windows import (
    GaussianShutter,
    HannShutter,
    RectShutter,
    TriangleShutter,
)
from mishutter.paper.capture import (
    AXIS,
    ELECTRONS,
    HALF_EXPOSURE,
    MID_TO_HIGH,
    PHOTOGRAPHS,
    READ_NOISE,
    READINGS,
    STROKE,
    camera,
    photograph,
    plain_numbers,
    restored,
)
from mishutter.paper.figures import figure_3, figure_4, figure_5, figure_6
from mishutter.paper.numbers import (
    FigureNumbers,
    KernelNumbers,
    Numbers,
    PhotographNumbers,
    Setting,
    SpectrumNumbers,
    SpeedNumbers,
)
from mishutter.paper.page import report_page, statements
from mishutter.pictures.images import Picture
from mishutter.report.plots import save_figure
from mishutter.search.search import optimise

TABLE_STROKE = 45.0
"""Stroke at which phase 0 gives the published condition numbers; px."""
NOISE_AXIS = np.geomspace(1e2, 1e6, 7)

Progress = Callable[[str, float], None]
"""Called with the name of the current step and the share of the work that is done."""


def reproduce(
    out: str | Path,
    *,
    progress: Progress | None = None,
    optimised: AbstractShutter | None = None,
    quick: bool = False,
) -> Numbers:
    """Reproduces the paper's Figures 3 to 6 and its table of condition numbers.

    Writes `figure_3.png` to `figure_6.png`, `figures.json` with every number in them, and
    `REPRODUCTION.md`, which says of each published statement whether it was met, and by
    how much. The paper does not state the normalisation of its speed axis; every figure
    over speed is given for both readings.

    Raises:
        OSError: if the folder cannot be made or written to.
    """
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    report = progress if progress is not None else lambda text, share: None
    report("optimising a profile", 0.0)
    shutters: dict[str, AbstractShutter] = {
        "rect": RectShutter(),
        "triangle": TriangleShutter(),
        "hann": HannShutter(),
        "gaussian": GaussianShutter(0.4),
        "optimised": _optimised() if optimised is None else optimised,
    }
    names = list(PHOTOGRAPHS)[: 1 if quick else None]
    photographs = {name: photograph(name) for name in names}
    setting: Setting = {
        "stroke_px": STROKE,
        "half_exposure_s": HALF_EXPOSURE,
        "electrons_at_white": ELECTRONS,
        "read_noise_e": READ_NOISE,
        "phase_px": 0.0,
        "speed_readings": READINGS,
        "decoder": "Richardson-Lucy, 30 accelerated iterations (as MATLAB's deconvlucy)",
    }
    report("kernels and spectra", 0.05)
    kernels, spectra = kernel_numbers(shutters), spectrum_numbers(shutters)
    report("photographs at two speeds", 0.1)
    pictures, two_speeds = _figure_5_numbers(photographs)
    report("plain iterations", 0.15)
    windows = {name: shutters[name] for name in ("rect", "hann")}
    speeds = MID_TO_HIGH[::3] if quick else MID_TO_HIGH
    plain = plain_numbers(photographs, windows, speeds)
    report("photographs over speed and noise", 0.3)
    figures: FigureNumbers = {
        "setting": setting,
        "figure_3": kernels,
        "figure_4": spectra,
        "figure_5": two_speeds,
        "plain_iterations": plain,
        "figure_6": _figure_6_numbers(shutters, photographs, report, quick),
    }
    numbers: Numbers = {**figures, "statements": statements(figures)}
    report("writing", 0.95)
    save_figure(figure_3(numbers["figure_3"]), folder / "figure_3.png")
    save_figure(figure_4(numbers["figure_4"]), folder / "figure_4.png")
    save_figure(figure_5(pictures), folder / "figure_5.png")
    save_figure(figure_6(numbers["figure_6"], READINGS), folder / "figure_6.png")
    write_text(folder / "figures.json", json.dumps(numbers, indent=1) + "\n")
    write_text(folder / "REPRODUCTION.md", report_page(numbers))
    report("done", 1.0)
    return numbers


def kernel_numbers(shutters: dict[str, AbstractShutter]) -> KernelNumbers:
    """Figure 3: kernels at 0.5, and RMS difference from the still object's over speed."""
    numbers: KernelNumbers = {"speed": AXIS.tolist(), "kernels": {}, "rms": {}, "relative_rms": {}}
    motion, num_taps = camera(), int(np.ceil(STROKE * 1.5**2)) + 1  # as many as the fastest needs

    def kernel(shutter: AbstractShutter, nu: float) -> Float[np.ndarray, "taps"]:
        taps = blur_kernel(shutter, motion, speed=nu * float(motion.top_speed), num_taps=num_taps)
        return np.asarray(taps, np.float64)

    for reading, scale in READINGS.items():
        pairs, differences, shares = {}, {}, {}
        for name in ("rect", "hann"):
            kernels = [kernel(shutters[name], nu * scale) for nu in AXIS]
            still = kernels[0]
            size = float(np.sqrt(np.mean(still**2)))
            rms = [float(np.sqrt(np.mean((k - still) ** 2))) for k in kernels]
            pairs[name] = {"still": still.tolist(), "moving": kernels[-1].tolist()}
            differences[name] = rms
            shares[name] = [value / size for value in rms]
        numbers["kernels"][reading] = pairs
        numbers["rms"][reading] = differences
        numbers["relative_rms"][reading] = shares
    return numbers


def spectrum_numbers(shutters: dict[str, AbstractShutter]) -> SpectrumNumbers:
    """Figure 4: Fourier magnitudes and condition numbers; DFT of 1024 points, phase 0."""
    motion = camera(TABLE_STROKE)
    kernels = {
        "motion invariant, Hann": blur_kernel(shutters["hann"], motion, num_taps=46),
        "motion invariant, rect": blur_kernel(shutters["rect"], motion, num_taps=46),
        "flutter shutter": np.asarray(RASKAR_CODE) / len(RASKAR_CODE),
    }
    length = 1024
    return {
        "stroke_px": TABLE_STROKE,
        "dft_length": length,
        "frequency": np.fft.rfftfreq(length).tolist(),
        "magnitude": {n: np.abs(np.fft.rfft(k, length)).tolist() for n, k in kernels.items()},
        "condition": {
            n: float(condition_number(k, num_frequencies=length)) for n, k in kernels.items()
        },
        "published": {
            "motion invariant, Hann": 4.45,
            "motion invariant, rect": 9.27,
            "flutter shutter": 19.5,
        },
    }


def _figure_5_numbers(
    photographs: dict[str, Picture],
) -> tuple[dict[str, dict[str, RestoredPhotograph]], dict[str, dict[str, PhotographNumbers]]]:
    """The first photograph restored, and numbers of all, each by the reading of the axis."""
    windows = {"rect": RectShutter(), "hann": HannShutter()}
    pictures: dict[str, dict[str, RestoredPhotograph]] = {}
    numbers: dict[str, dict[str, PhotographNumbers]] = {}
    for reading, scale in READINGS.items():
        numbers[reading] = {}
        for name, picture in photographs.items():
            nus = [0.1 * scale, 0.3 * scale]
            results = {w: restored(picture, shutter, nus) for w, shutter in windows.items()}
            if name == next(iter(photographs)):
                pictures[reading] = results
            numbers[reading][name] = {
                "speed": [0.1, 0.3],
                "psnr": {w: r.psnr.tolist() for w, r in results.items()},
                "ghost_energy": {w: _ghosts(r, nus) for w, r in results.items()},
            }
    return pictures, numbers


def _ghosts(result: RestoredPhotograph, nus: list[float]) -> list[float]:
    """Energy of the largest ghost at the ends of the still and the moving kernel, by speed."""
    return [
        max(
            ghost_energy(result.reference, picture, distance=STROKE * (1 + sign * nu) ** 2)
            for sign in (-1, 0, 1)
        )
        for picture, nu in zip(result.restored, nus, strict=True)
    ]


def _figure_6_numbers(
    shutters: dict[str, AbstractShutter],
    photographs: dict[str, Picture],
    report: Progress,
    quick: bool,
) -> SpeedNumbers:
    """PSNR of each photograph and shutter over speed, by both readings, and over noise."""
    axis = AXIS[::5] if quick else AXIS
    levels = NOISE_AXIS[::3] if quick else NOISE_AXIS
    nus = sorted({float(v * scale) for v in axis for scale in READINGS.values()})
    numbers: SpeedNumbers = {
        "speed": axis.tolist(),
        "electrons": levels.tolist(),
        "noise_nu": 0.1,
        "psnr_over_speed": {reading: {} for reading in READINGS},
        "psnr_over_noise": {},
    }
    done, total = 0, len(photographs) * len(shutters)
    for name, picture in photographs.items():
        over_noise: dict[str, list[float]] = {}
        over_speed: dict[str, dict[str, list[float]]] = {r: {} for r in READINGS}
        for window, shutter in shutters.items():
            report(f"{name}, {window}", 0.3 + 0.65 * done / total)
            by_nu = dict(zip(nus, restored(picture, shutter, nus).psnr.tolist(), strict=True))
            for reading, scale in READINGS.items():
                over_speed[reading][window] = [by_nu[float(v * scale)] for v in axis]
            over_noise[window] = [
                float(restored(picture, shutter, [0.1], electrons=float(p)).psnr[0]) for p in levels
            ]
            done += 1
        for reading in READINGS:
            numbers["psnr_over_speed"][reading][name] = over_speed[reading]
        numbers["psnr_over_noise"][name] = over_noise
    return numbers


def _optimised() -> AbstractShutter:
    """The profile of least expected error at the same motion, speeds up to a quarter of 2aT."""
    motion = camera()
    scene = Scene.uniform(
        max_speed=0.25 * float(motion.top_speed),
        num_speeds=9,
        photon_rate=ELECTRONS / (2 * HALF_EXPOSURE),
        read_noise=READ_NOISE,
        limits=Limits(),
    )
    start = SplineShutter.fit(HannShutter(), num_coefficients=24)
    design = optimise(
        scene, motion, start, loss=ExpectedErrorLoss(), free=("shutter",), num_starts=8
    )
    return design.shutter
