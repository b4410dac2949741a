"""The command that measures a camera by what it recorded: `fit`."""

import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mishutter._core.files import writable_folder, write_text
from mishutter._core.progress import note, working
from mishutter.cli.console import print_table, print_text, start_jax, write_json
from mishutter.cli.help import CAMERA, SEARCH
from mishutter.cli.laboratory import AS_DESIGNED, AS_DRIVEN
from mishutter.cli.options import JsonOption, OutOption, as_path, design_option, option, path_option

if TYPE_CHECKING:
    from mishutter.design.design import Design
    from mishutter.hardware.calibration.estimation import FittedCamera
    from mishutter.model.scene import Scene

AS_BUILT = "as built"
REDESIGNED = "re-designed for what was built"
IMPLAUSIBLE = ": IMPLAUSIBLE, see the warning"


def fit(
    measurements: Annotated[
        Path,
        typer.Argument(
            metavar="MEASUREMENTS.toml",
            parser=as_path,
            help="File that lists pictures of a point or an edge, the sensor's gain, and a trace.",
        ),
    ],
    *,
    design: Annotated[
        Path, design_option(CAMERA, "--design FILE", "Design by which the camera was built.")
    ],
    drive: Annotated[
        Path | None, path_option(CAMERA, "--drive FILE", "Drive table that was sent, csv or npy.")
    ] = None,
    num_coefficients: Annotated[
        int,
        option(
            SEARCH,
            "--coefficients N",
            "Number of coefficients of the fitted profile.",
            min=4,
            max=64,
        ),
    ] = 12,
    redesign: Annotated[
        bool, option(SEARCH, "--redesign", "Also search for the best profile of the fitted camera.")
    ] = False,
    out: OutOption = None,
    json: JsonOption = False,
) -> None:
    """Fit a camera as it was built, with error bars, and evaluate it."""
    start_jax()
    from mishutter.design.design import Design
    from mishutter.hardware.calibration.estimation import fit as fitted
    from mishutter.hardware.calibration.measurements import read_measurements
    from mishutter.hardware.traces import for_a_fit

    saved = Design.load_one(design)
    records = read_measurements(measurements)
    if records.trace is not None:
        half = float(saved.motion.half_exposure)
        trace, sentences = for_a_fit(records.trace, half, f"{measurements}: trace")
        records = records._replace(trace=trace)
        for sentence in sentences:
            note(f"{measurements}: trace: {sentence}")
    folder = None if out is None else writable_folder(out)
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "fit: ")  # printed below, without a line of code
        camera = fitted(
            records,
            saved.motion,
            saved.shutter,
            num_coefficients=num_coefficients,
            progress=True,
        )
    with working("measuring each camera"):
        cameras = _cameras(camera, saved, drive, redesign)
        levels = {name: float(each.metrics.expected_psnr) for name, each in cameras.items()}
    files = [] if folder is None else _write(camera, cameras, saved.scene, folder)
    if camera.doubt:  # before the numbers that it is about
        note(f"mishutter: warning: {camera.doubt}.")
    if json:
        write_json(camera.to_dict() | {"expected_psnr_db": levels, "files": files})
    else:
        _print(camera, levels)
    if files:
        note(f"{folder}: {', '.join(files)}")


def _cameras(
    camera: "FittedCamera", saved: "Design", drive: Path | None, redesign: bool
) -> "dict[str, Design]":
    """The camera as designed, driven, built and re-designed, each behind the fitted lens."""
    from mishutter.design.design import GIVEN
    from mishutter.hardware.drive import design_from_drive
    from mishutter.search.search import optimise

    scene = camera.seen_through_lens(saved.scene)
    cameras = {AS_DESIGNED: replace(saved, scene=scene).with_one(loss_name=GIVEN)}
    if drive is not None:
        cameras[AS_DRIVEN] = design_from_drive(drive, scene, saved.motion)
    cameras[AS_BUILT] = camera.design(saved.scene)
    if redesign:
        cameras[REDESIGNED] = optimise(scene, camera.motion, free="shutter")
    return cameras


def _write(
    camera: "FittedCamera", cameras: "dict[str, Design]", scene: "Scene", folder: Path
) -> list[str]:
    from mishutter.report.fit_plots import plot_fit
    from mishutter.report.plots import save_figure

    text = camera.scene_text(scene)
    save_figure(plot_fit(camera, cameras[AS_DESIGNED].shutter), folder / "fit.png")
    cameras[AS_BUILT].save(folder / "as_built.json")
    write_text(folder / "as_built.toml", text)
    files = ["fit.png", "as_built.json", "as_built.toml"]
    if REDESIGNED in cameras:
        cameras[REDESIGNED].save(folder / "redesigned.json")
        files.append("redesigned.json")
    return files


def _print(camera: "FittedCamera", levels: Mapping[str, float]) -> None:
    print_text(
        f"Chi squared for each free level: {camera.reduced_chi_squared:.3f}, which noise alone "
        f"exceeds in {camera.chance:.2g} of fits{IMPLAUSIBLE * bool(camera.doubt)}."
    )
    rows = [[n, f"{e.value:.6g}", f"{e.error:.2g}"] for n, e in camera.estimates_of_stage.items()]
    each = zip(camera.coefficients, camera.coefficient_errors, strict=True)
    rows += [[f"transmittance {k}", f"{c:.4f}", f"{e:.2g}"] for k, (c, e) in enumerate(each)]
    print_table("The camera as built", ["number", "value", "error bar"], rows)
    if max(camera.coefficients) > 1:
        k = int(camera.coefficients.argmax())
        value = float(camera.coefficients[k])
        bars = (value - 1) / float(camera.coefficient_errors[k])
        print_text(
            f"Transmittance {k}, of {value:.2f}, is {bars:.1f} error bars above an open shutter. A "
            "fit sees only the shape of a profile, and scales it to the efficiency that was sent: "
            "more than two error bars mean that the shutter passed less. The files have 1 there."
        )
    for line in camera.not_identifiable:
        print_text(f"Not identifiable: {line}.")
    rows = [[name, f"{level:.2f}"] for name, level in levels.items()]
    print_table("Expected behind this lens", ["camera", "PSNR / dB, linear light"], rows)
