"""The paper's Figures 3 to 6 and its table, computed anew and held against what it says."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import jax
import numpy as np

from mishutter.decoders import AbstractDecoder, RichardsonLucyDecoder
from mishutter.files import write_text
from mishutter.kernel import blur_kernel
from mishutter.losses import ExpectedErrorLoss
from mishutter.motion import ParabolicMotion
from mishutter.optimise import optimise
from mishutter.pictures import Picture, row_power_spectrum, shipped_picture
from mishutter.plots import save_figure
from mishutter.quality import ghost_energy
from mishutter.reproduce_figures import (
    figure_3,
    figure_4,
    figure_5,
    figure_6,
)
from mishutter.reproduce_page import report_page, statements
from mishutter.restoration import RestoredPhotograph, restore_photograph
from mishutter.scene import Limits, Scene
from mishutter.shutters import (
    RASKAR_CODE,
    AbstractShutter,
    GaussianShutter,
    HannShutter,
    RectShutter,
    SplineShutter,
    TriangleShutter,
)
from mishutter.spectrum import condition_number

HALF_EXPOSURE = 0.01
STROKE = 34.0
"""Kernels of 34 to 51 samples for a still object and the fastest, as in section 3."""
TABLE_STROKE = 45.0
"""Where the published condition numbers come out (phase 0)."""
ELECTRONS, READ_NOISE = 1e4, 10.0
"""Moderate noise: photo-electrons at white and read noise; e-."""
AXIS = np.linspace(0.0, 0.5, 11)
"""The paper's speed axis."""
READINGS = {"s/(aT)": 0.5, "s/(2aT)": 1.0}
"""What the axis may mean, and the normalised speed `s/(2aT)` that 1 on it then is."""
NOISE_AXIS = np.geomspace(1e2, 1e6, 7)
PHOTOGRAPHS = {
    "camera": ("camera.png", (60, 188)),
    "motorcycle": ("motorcycle_left.png", (180, 308)),
    "coffee": ("coffee.png", (120, 248)),
}
"""Files of scikit-image's package, and the rows of them that are used."""

Progress = Callable[[str, float], None]
"""Called with what is being done and the share that is."""


def reproduce(
    out: str | Path,
    *,
    progress: Progress | None = None,
    optimised: AbstractShutter | None = None,
    quick: bool = False,
) -> dict[str, Any]:
    """Reproduce the paper's Figures 3 to 6 and its table of condition numbers.

    Writes `figure_3.png` to `figure_6.png`, `figures.json` with every number in them, and
    `REPRODUCTION.md`, which says of each published statement whether it was met, and by
    how much. The paper does not say what its speed axis is normalised by; every figure
    over speed is given for both readings.

    Args:
        out: Folder to write to; made if it is not there.
        progress: Called with a sentence and the share done.
        optimised: A profile to draw beside the windows; one optimised for the expected
            error of the same scene by default.
        quick: Whether to take fewer speeds, noise levels and photographs, for a look.

    Returns:
        What `figures.json` holds.

    Raises:
        OSError: if the folder cannot be made or written to.
    """
    folder = Path(out)
    folder.mkdir(parents=True, exist_ok=True)
    report = progress if progress is not None else lambda text, share: None
    report("optimising a profile", 0.0)
    profile = _optimised() if optimised is None else optimised
    shutters = _shutters(profile)
    names = list(PHOTOGRAPHS)[: 1 if quick else None]
    photographs = {name: photograph(name) for name in names}
    numbers: dict[str, Any] = {
        "setting": {
            "stroke_px": STROKE,
            "half_exposure_s": HALF_EXPOSURE,
            "electrons_at_white": ELECTRONS,
            "read_noise_e": READ_NOISE,
            "phase_px": 0.0,
            "speed_readings": READINGS,
            "decoder": "Richardson-Lucy, 30 accelerated iterations (as MATLAB's deconvlucy)",
        }
    }
    report("kernels and spectra", 0.05)
    numbers["figure_3"] = kernel_numbers(shutters)
    numbers["figure_4"] = spectrum_numbers(shutters)
    report("photographs at two speeds", 0.1)
    pictures, numbers["figure_5"] = _figure_5_numbers(photographs)
    report("photographs over speed and noise", 0.2)
    numbers["figure_6"] = _figure_6_numbers(shutters, photographs, report, quick)
    numbers["statements"] = statements(numbers)
    report("writing", 0.95)
    save_figure(figure_3(numbers["figure_3"]), folder / "figure_3.png")
    save_figure(figure_4(numbers["figure_4"]), folder / "figure_4.png")
    save_figure(figure_5(pictures), folder / "figure_5.png")
    save_figure(figure_6(numbers["figure_6"], READINGS), folder / "figure_6.png")
    write_text(folder / "figures.json", json.dumps(numbers, indent=1) + "\n")
    write_text(folder / "REPRODUCTION.md", report_page(numbers))
    report("done", 1.0)
    return numbers


def camera(stroke: float = STROKE) -> ParabolicMotion:
    """The moving sensor of the reproduction."""
    return ParabolicMotion(acceleration=stroke / HALF_EXPOSURE**2, half_exposure=HALF_EXPOSURE)


def photograph(name: str) -> Picture:
    """One of the photographs, in luminance, cut to the rows that are used."""
    file_name, (first, last) = PHOTOGRAPHS[name]
    whole = shipped_picture(file_name)
    return Picture(light=np.ascontiguousarray(whole.luminance[first:last, :, None]), name=name)


def kernel_numbers(shutters: dict[str, AbstractShutter]) -> dict[str, Any]:
    """Figure 3: kernels at 0.5, and RMS difference from the still object's over speed."""
    result: dict[str, Any] = {"speed": AXIS.tolist(), "kernels": {}, "rms": {}, "relative_rms": {}}
    for reading, scale in READINGS.items():
        rows: dict[str, Any] = {"kernels": {}, "rms": {}, "relative": {}}
        for name in ("rect", "hann"):
            kernels = [_kernel(shutters[name], nu * scale) for nu in AXIS]
            still = kernels[0]
            size = float(np.sqrt(np.mean(still**2)))
            rms = [float(np.sqrt(np.mean((k - still) ** 2))) for k in kernels]
            rows["kernels"][name] = {"still": still.tolist(), "moving": kernels[-1].tolist()}
            rows["rms"][name] = rms
            rows["relative"][name] = [value / size for value in rms]
        result["kernels"][reading] = rows["kernels"]
        result["rms"][reading] = rows["rms"]
        result["relative_rms"][reading] = rows["relative"]
    return result


def spectrum_numbers(shutters: dict[str, AbstractShutter]) -> dict[str, Any]:
    """Figure 4: Fourier magnitudes and condition numbers; DFT of 1024 points, phase 0."""
    motion = camera(TABLE_STROKE)
    kernels = {
        "motion invariant, Hann": blur_kernel(shutters["hann"], motion, num_taps=46),
        "motion invariant, rect": blur_kernel(shutters["rect"], motion, num_taps=46),
        "flutter shutter": np.asarray(RASKAR_CODE) / len(RASKAR_CODE),
    }
    published = {"motion invariant, Hann": 4.45, "motion invariant, rect": 9.27}
    published["flutter shutter"] = 19.5
    length = 1024
    return {
        "stroke_px": TABLE_STROKE,
        "dft_length": length,
        "frequency": np.fft.rfftfreq(length).tolist(),
        "magnitude": {n: np.abs(np.fft.rfft(k, length)).tolist() for n, k in kernels.items()},
        "condition": {
            n: float(condition_number(k, num_frequencies=length)) for n, k in kernels.items()
        },
        "published": published,
    }


def restored(
    picture: Picture,
    shutter: AbstractShutter,
    normalised_speeds: list[float],
    *,
    electrons: float = ELECTRONS,
    decoder: AbstractDecoder | None = None,
) -> RestoredPhotograph:
    """A photograph at speeds `s/(2aT)` through camera and decoder."""
    motion = camera()
    spectrum = row_power_spectrum(picture)._asdict()
    scene = Scene(
        [0.0], photon_rate=electrons / (2 * HALF_EXPOSURE), read_noise=READ_NOISE, **spectrum
    )
    chosen = RichardsonLucyDecoder(accelerated=True) if decoder is None else decoder
    speeds = [nu * float(motion.top_speed) for nu in normalised_speeds]
    key = jax.random.key(20)
    return restore_photograph(
        picture, scene, motion, shutter, decoder=chosen, speeds=speeds, num_seeds=1, key=key
    )


def _figure_5_numbers(photographs: dict[str, Picture]) -> tuple[dict, dict[str, Any]]:
    windows = {"rect": RectShutter(), "hann": HannShutter()}
    pictures: dict[str, Any] = {}
    numbers: dict[str, Any] = {}
    for reading, scale in READINGS.items():
        numbers[reading] = {}
        for name, picture in photographs.items():
            nus = [0.1 * scale, 0.3 * scale]
            found = {w: restored(picture, shutter, nus) for w, shutter in windows.items()}
            if name == next(iter(photographs)):
                pictures[reading] = found
            numbers[reading][name] = {
                "speed": [0.1, 0.3],
                "psnr": {w: r.psnr.tolist() for w, r in found.items()},
                "ghost_energy": {w: _ghosts(r, nus) for w, r in found.items()},
            }
    return pictures, numbers


def _ghosts(result: RestoredPhotograph, nus: list[float]) -> list[float]:
    """Largest ghost at the kernels' ends: the still one's, and the moving one's two."""
    return [
        max(
            ghost_energy(result.reference, picture, distance=STROKE * (1 + sign * nu) ** 2)
            for sign in (-1, 0, 1)
        )
        for picture, nu in zip(result.restored, nus, strict=True)
    ]


def _figure_6_numbers(shutters, photographs, report: Progress, quick: bool) -> dict[str, Any]:
    axis = AXIS[::5] if quick else AXIS
    levels = NOISE_AXIS[::3] if quick else NOISE_AXIS
    nus = sorted({float(v * scale) for v in axis for scale in READINGS.values()})
    numbers: dict[str, Any] = {
        "speed": axis.tolist(),
        "electrons": levels.tolist(),
        "noise_nu": 0.1,
    }
    numbers["psnr_over_speed"] = {reading: {} for reading in READINGS}
    numbers["psnr_over_noise"] = {}
    done, total = 0, len(photographs) * len(shutters)
    for name, picture in photographs.items():
        over_noise: dict[str, list[float]] = {}
        over_speed: dict[str, dict[str, list[float]]] = {r: {} for r in READINGS}
        for window, shutter in shutters.items():
            report(f"{name}, {window}", 0.2 + 0.75 * done / total)
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


def _kernel(shutter: AbstractShutter, nu: float) -> np.ndarray:
    motion = camera()
    speed = nu * float(motion.top_speed)
    num_taps = int(np.ceil(STROKE * 1.5**2)) + 1
    return np.asarray(blur_kernel(shutter, motion, speed=speed, num_taps=num_taps), np.float64)


def _shutters(optimised: AbstractShutter) -> dict[str, AbstractShutter]:
    return {
        "rect": RectShutter(),
        "triangle": TriangleShutter(),
        "hann": HannShutter(),
        "gaussian": GaussianShutter(0.4),
        "optimised": optimised,
    }


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
