"""Commands that take pictures: `simulate` and `reproduce`."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from mishutter._core.files import ONE_EXPOSURE, writable_folder
from mishutter._core.progress import note, progress_bar
from mishutter.cli.console import AGAIN, interruptible, print_table, start_jax, write_json
from mishutter.cli.help import DESIGN, OUTPUT, PICTURES, SENSOR
from mishutter.cli.laboratory import (
    CameraFiles,
    cameras,
    speed_for,
    takes_camera_files,
    warn_beyond,
)
from mishutter.cli.options import (
    DECODERS,
    DecoderName,
    JsonOption,
    PicturesOutOption,
    design_option,
    named_decoder,
    option,
    path_option,
    scene_argument,
    scene_of,
)

if TYPE_CHECKING:
    import numpy as np

    from mishutter.camera.footage import Footage
    from mishutter.camera.layers import Layers
    from mishutter.decoding.restoration import Estimate, Simulation
    from mishutter.decoding.restored_frames import RestoredFrames
    from mishutter.design.design import Design
    from mishutter.model.scene import Scene
    from mishutter.pictures.images import Picture

NUM_TICKS = 100
WHY_RESTORING = "finding what moves and how fast, or compiling"
"""Why a restoration tells no step for a while."""
_LEAST_ERROR = 0.01
"""Least error of a speed that is printed; px/s."""
_LINEAR = "PSNR / dB, linear light"


@takes_camera_files
def simulate(
    scene_file: Annotated[
        Path | None, scene_argument("the design's, or the built-in scene")
    ] = None,
    *,
    subject: Annotated[
        Path | None,
        path_option(
            PICTURES,
            "--subject PATH",
            "Photograph, layered scene (.toml), video or folder of frames [default: the "
            "scene's photograph].",
        ),
    ] = None,
    white: Annotated[
        float | None,
        option(
            PICTURES,
            "--white VALUE",
            "Value of white in the subject's file, such as 4095 for 12 bits [default: the "
            "largest value of its bit depth].",
        ),
    ] = None,
    linear: Annotated[
        bool,
        option(
            PICTURES, "--linear", "Read the subject's values as linear light, not as gamma-coded."
        ),
    ] = False,
    design: Annotated[
        Path | None, design_option(DESIGN, "--design FILE", "Saved design to use.")
    ] = None,
    shutter: Annotated[
        str | None,
        option(
            DESIGN, "--shutter NAME[:VALUE]", "Shutter to use without --design [default: hann]."
        ),
    ] = None,
    files: CameraFiles,
    speed_text: Annotated[
        str,
        option(
            PICTURES,
            "--speed SPEED",
            "Speed of the object in the photograph: px/s, or with a unit, such as 0.9m/s, "
            "'90 km/h' or 3deg/s. For a design in the plane its velocity, such as 1500,-800.",
        ),
    ] = "0",
    decoder: Annotated[
        DecoderName,
        option(
            PICTURES,
            "--decoder NAME",
            f"Decoder that restores the capture, in place of the scene's: {DECODERS}.",
        ),
    ] = DecoderName.ENSEMBLE,
    noiseless: Annotated[bool, option(SENSOR, "--noiseless", "Add no noise.")] = False,
    full_well: Annotated[
        float | None,
        option(
            SENSOR, "--full-well E", "Full well of a pixel, e- [default: the scene's].", min=1.0
        ),
    ] = None,
    adc_bits: Annotated[
        int | None,
        option(
            SENSOR,
            "--adc-bits N",
            "Bits of the analogue-to-digital converter [default: no rounding].",
            min=1,
            max=24,
        ),
    ] = None,
    seed: Annotated[
        int, option(SENSOR, "--seed N", "Seed of the noise.", min=0, max=(1 << 63) - 1)
    ] = 0,
    out: PicturesOutOption = Path("simulation"),
    json: JsonOption = False,
) -> None:
    """Capture a photograph, a layered scene or footage, and restore it.

    If the design takes a burst, all of its frames of a photograph or a layered scene are taken.
    """
    if shutter is not None and any((design, files.drive, files.measured)):
        which = "--design" if design is not None else "--drive or --measured"
        raise ValueError(f"`--shutter` must be left out with {which}; got '{shutter}'.")
    start_jax()
    import jax
    import numpy as np

    from mishutter.pictures.images import Picture, write_picture
    from mishutter.report.objects import write_objects
    from mishutter.report.plots import camera_text, plot_capture, save_figure, shown_name

    window = "hann" if shutter is None else shutter
    given = None if scene_file is None else scene_of(scene_file)
    designs = cameras(given, design, files, window=window, of_example=True).designs
    camera = [*designs.values()][-1]
    scene, speed = camera.scene, speed_for(camera, speed_text, scene_file)
    photographed = _subject(subject, scene, white, linear)
    if np.any(speed) and not isinstance(photographed, Picture):
        raise ValueError(f"`--speed` must be given with a photograph only; got {speed_text}.")
    method, folder = named_decoder(decoder, scene), writable_folder(out)
    with (
        interruptible(lambda: AGAIN),
        progress_bar("capturing and restoring", NUM_TICKS, WHY_RESTORING) as update,
    ):
        settings: dict[str, Any] = {
            "speed": speed,
            "decoder": method,
            "key": None if noiseless else jax.random.key(seed),
            "full_well": full_well,
            "adc_bits": adc_bits,
            "progress": lambda text, share: update(int(share * NUM_TICKS), text),
        }
        taken, result = _simulated(photographed, scene, camera, settings)
    for each, light in taken.items():
        write_picture(folder / f"{each}.png", light)
    write_picture(folder / "restored.png", result.restored)
    figures = _quality(photographed, result.restored)
    last = files.measured or files.drive or design
    name = f"{window} shutter" if last is None else shown_name(last.name)
    speed_words = ", ".join(f"{each:g}" for each in np.atleast_1d(speed))
    moving = f", object at {speed_words} px/s" if isinstance(photographed, Picture) else ""
    level = f", {figures[_LINEAR]:.2f} dB (linear light)" if figures else ""
    picture = plot_capture(
        photographed,
        taken,
        result.restored,
        camera=f"by {name}: {camera_text(camera)}{moving}",
        decoder=f"by the {decoder.value} decoder{level}",
    )
    save_figure(picture, folder / "side_by_side.png")
    written = [*(f"{each}.png" for each in taken), "restored.png", "side_by_side.png"]
    written += write_objects(folder, result.by_object)
    if not figures:
        note("no PSNR: layers and frames move on their own, so no single picture is the truth")
    if isinstance(speed, tuple) and any(speed):
        note("the sensor is as large as the picture, which goes on mirrored beyond its borders")
    warn_beyond(scene, speed)
    estimate = result.found
    if estimate is not None and estimate.doubt:
        note(f"warning: {estimate.doubt}")
    levels = {}
    if files.drive is not None or files.measured is not None:
        levels = {name: float(each.metrics.expected_psnr) for name, each in designs.items()}
    if json:
        quality = {"quality": figures} if figures else {}
        expected = {"expected_psnr_db": levels} if levels else {}
        speeds = {} if estimate is None else {"found": estimate_document(estimate)}
        speeds |= objects_document(result.by_object)
        write_json(quality | expected | {"decoder": decoder.value, "files": written} | speeds)
    else:
        _print_numbers(f"Restored by {decoder.value}", "figure", "value", figures)
        if estimate is not None:
            value, trust = speed_found(estimate, in_burst=camera.sequence is not None)
            print_table("Speed found", ["px/s", ""], [[value, trust]])
        print_objects(result.by_object)
        _print_numbers("Expected of the scene", "camera", _LINEAR, levels)
    note(f"{folder}: {', '.join(written)}")


def _simulated(
    subject: "Picture | Layers | Footage",
    scene: "Scene",
    camera: "Design",
    settings: dict[str, Any],
) -> "tuple[dict[str, np.ndarray], Simulation]":
    """The records of a subject, by the names of their files, and the picture restored from them."""
    from mishutter.camera.footage import Footage
    from mishutter.camera.layers import Layers
    from mishutter.decoding.restoration import capture_and_restore

    if camera.sequence is None:
        result = capture_and_restore(subject, scene, camera.exposures, **settings)
        return {"captured": result.captured}, result
    if isinstance(subject, Footage):
        raise ValueError("`--subject` must be a photograph or layers for a burst; got footage.")
    exposures = camera.exposures
    if scene.occlusion is not None and exposures.moves and sum(exposures.rests) < 2:
        raise ValueError(
            "`--design` must be of two frames at rest at least, or of one exposure, as "
            f"{ONE_EXPOSURE} beside an answer, to be simulated before a background; got frames "
            "that move, and [occlusion]."
        )
    result = capture_and_restore(subject, scene, camera.exposures, **settings)
    if isinstance(subject, Layers) and result.by_object is None:
        note("restored at one speed: several objects are found in two frames at rest or more")
    frames = camera.exposures.of_one_gain(result.captured)
    # A shell lists names of equal length in the order of their numbers.
    digits = len(str(len(frames)))
    return {f"frame_{k:0{digits}d}": frame for k, frame in enumerate(frames, 1)}, result


def _print_numbers(title: str, names: str, unit: str, numbers: dict[str, float]) -> None:
    """Prints a table of numbers by their names, if there are any."""
    if numbers:
        print_table(title, [names, unit], [[name, f"{x:.2f}"] for name, x in numbers.items()])


def reproduce(
    out: Annotated[Path, path_option(OUTPUT, "--out DIR", "Folder for the figures and the page.")],
    quick: Annotated[
        bool, option(None, "--quick", "Use fewer speeds, noise levels and photographs.")
    ] = False,
    json: JsonOption = False,
) -> None:
    """Compute the published Figures 3 to 6 again, and check each published statement."""
    folder = writable_folder(out)
    start_jax()
    from mishutter.paper.reproduction import reproduce as redo

    with interruptible(lambda: AGAIN), progress_bar("reproducing", NUM_TICKS) as update:
        numbers = redo(
            folder,
            quick=quick,
            progress=lambda text, share: update(int(share * NUM_TICKS), text),
        )
    if json:
        write_json(numbers)
    else:
        rows = [[s["claim"], "met" if s["met"] else "not met"] for s in numbers["statements"]]
        print_table("Published statements", ["statement", ""], rows)
    note(f"{folder}: REPRODUCTION.md, figures.json, figure_3.png to figure_6.png")


def _subject(
    path: Path | None, scene: "Scene", white: float | None, linear: bool
) -> "Picture | Layers | Footage":
    from mishutter.camera.footage import read_frames
    from mishutter.camera.layers import is_layers_file, read_layers
    from mishutter.pictures.files import VIDEO_SUFFIXES
    from mishutter.pictures.images import read_picture

    if path is None or is_layers_file(path):
        subject = "the scene's photograph" if path is None else "a layered scene"
        for name, is_told in (("--white", white is not None), ("--linear", linear)):
            if is_told:
                raise ValueError(
                    f"`{name}` must be a key of the file that names the pictures of {subject}; "
                    "got an option."
                )
    if path is None:
        if scene.picture.path is None:
            raise ValueError(
                "`--subject` must be given where the scene has no picture; got nothing."
            )
        return scene.picture.photograph()
    if is_layers_file(path):
        return read_layers(path)
    if path.is_dir() or path.suffix.lower() in VIDEO_SUFFIXES:
        return read_frames(path, white=white, linear=linear)
    return read_picture(path, white=white, linear=linear)


def speed_found(estimate: "Estimate", *, in_burst: bool) -> tuple[str, str]:
    """The speed of a capture or a burst, with its error if it was found, and its trust in words."""
    from mishutter.decoding.frame_velocity import VelocityEstimate

    if isinstance(estimate, VelocityEstimate):
        speeds = estimate.velocity.tolist()
    elif estimate.tells_nothing:
        return "none", "restored for all speeds of the scene"
    else:
        speeds = [estimate.speed]
    error = estimate.error
    value = ", ".join(_speed_words(float(speed), error) for speed in speeds)
    value += f" {_error_words(error)}" if error > 0 else ", as told"
    instead = ", but used" if in_burst else ": restored for all likely speeds"
    return value, "trusted" if estimate.trusted else f"not trusted{instead}"


def _speed_words(speed: float, error: float) -> str:
    """A speed, px/s, down to the first digit that its error leaves open."""
    if error <= 0:
        return f"{round(speed, 6) + 0.0:,.6g}"
    digits = max(0, -math.floor(math.log10(max(error, _LEAST_ERROR))))
    return f"{round(speed, digits) + 0.0:,.10g}"


def _error_words(error: float) -> str:
    """The error of a speed, px/s; that of frames without noise is only of rounding."""
    if error < _LEAST_ERROR:
        return f"+- less than {_LEAST_ERROR:g}"
    return f"+- {error:,.0f}" if error >= 10 else f"+- {error:.2g}"


def print_objects(found: "RestoredFrames | None") -> None:
    """Prints a table of the objects that were found, if some were looked for."""
    if found is None:
        return
    rows = []
    for number, each in enumerate(found.objects, 1):
        across, down = each.velocity.tolist()
        size = f"{each.area:,.0f}"
        trust = "trusted" if each.trusted else f"not trusted: {each.doubt}"
        known = f" {_error_words(each.error)}" if each.error > 0 else ", as told"
        speed = ", ".join(_speed_words(one, each.error) for one in (across, down)) + known
        rows.append([f"{number}", speed, size, trust])
    if rows:
        print_table("Objects found", ["", "along rows, columns / px/s", "px", ""], rows)
    else:
        note("no object moves: the picture is that of the background")


def objects_document(found: "RestoredFrames | None") -> dict[str, object]:
    """Objects that were found, as JSON has them; empty where none were looked for."""
    if found is None:
        return {}
    each_of = [
        {
            "velocity_px_per_s": each.velocity.tolist(),
            "speed_px_per_s": each.speed,
            "error_px_per_s": each.error,
            "area_px": each.area,
            "place_px": list(each.place),
            "trusted": each.trusted,
            "doubt": each.doubt,
        }
        for each in found.objects
    ]
    return {"objects": each_of}


def estimate_document(estimate: "Estimate") -> dict[str, object]:
    """An estimated speed, as JSON has it: null where the capture tells nothing."""
    from mishutter.decoding.frame_velocity import VelocityEstimate

    numbers: dict[str, object]
    if isinstance(estimate, VelocityEstimate):
        numbers = {
            "velocity_px_per_s": estimate.velocity.tolist(),
            "covariance_px2_per_s2": estimate.covariance.tolist(),
            "error_px_per_s": estimate.error,
        }
    elif estimate.tells_nothing:
        numbers = {"speed_px_per_s": None, "error_px_per_s": None}
    else:
        numbers = {"speed_px_per_s": estimate.speed, "error_px_per_s": estimate.error}
    trust = {"trusted": estimate.trusted, "doubt": estimate.doubt, "misfit": estimate.misfit}
    return numbers | trust


def _quality(
    photographed: "Picture | Layers | Footage", restored: "np.ndarray"
) -> dict[str, float]:
    """PSNR of a restored photograph; empty for layers and footage, which have no single truth."""
    from mishutter.decoding.image_quality import psnr
    from mishutter.pictures.images import Picture

    if not isinstance(photographed, Picture):
        return {}
    return {
        _LINEAR: float(psnr(photographed.light, restored)),
        "PSNR / dB, gamma-coded": float(psnr(photographed.light, restored, gamma=True)),
    }
