"""The command line: arguments in, public functions called, text and files out.

Modules that take seconds to import are imported inside the commands.
"""

import itertools
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from platform import python_version
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from mishutter._core.files import ONE_EXPOSURE, short_names, writable_folder
from mishutter._core.progress import note, progress_bar, working
from mishutter.cli.camera import reproduce, simulate
from mishutter.cli.console import (
    AGAIN,
    InterruptedWorkError,
    closable_output,
    doubts_as_notes,
    ends_when_asked,
    error_line,
    interruptible,
    next_step,
    print_text,
    start_jax,
    take_any_text,
    write_error,
    write_json,
)
from mishutter.cli.explore import explore
from mishutter.cli.export import export
from mishutter.cli.fit_command import fit
from mishutter.cli.help import (
    DESIGN,
    SEARCH,
    TO_BEGIN,
    TO_BUILD,
    TO_DESIGN,
    TO_SEE,
    GroupedCommand,
    GroupedCommands,
)
from mishutter.cli.laboratory import (
    AS_DESIGNED,
    AS_MEASURED,
    CameraFiles,
    Cameras,
    cameras,
    note_other_device,
    takes_camera_files,
)
from mishutter.cli.measure_command import measure
from mishutter.cli.options import (
    CoefficientsOption,
    EveryPhotographOption,
    FreeOption,
    JsonOption,
    JudgeOption,
    LossOption,
    OutOption,
    PicturesOption,
    SceneArgument,
    SeedsOption,
    ShuttersOption,
    VerboseOption,
    design_option,
    judge_of,
    loss_of,
    names_of,
    option,
    scene_of,
)
from mishutter.cli.plan_command import plan, plan_of_search, plan_text
from mishutter.cli.plane_command import optimised_in_plane, refuse_in_plane
from mishutter.cli.restore_command import restore
from mishutter.cli.sweep_command import sweep

if TYPE_CHECKING:
    from mishutter.decoding.decoders.base import AbstractDecoder
    from mishutter.design.design import Design
    from mishutter.evaluation.losses import AbstractLoss
    from mishutter.model.exposures import Exposures
    from mishutter.model.motion import AbstractMotion
    from mishutter.model.scene import Scene
    from mishutter.model.shutters.base import AbstractShutter
    from mishutter.pictures.images import Picture
    from mishutter.report.documents import Report

_WHY_NO_STEP = "finding the speed in frames, or compiling"
"""Why a step of what follows the verdict takes a while."""
_IMPORT = "--import"
_INTERRUPTED = 130
"""The exit code of an interrupt, which the parser of the command line returns too."""

app = typer.Typer(
    name="mishutter",
    help="Choose exposures, sensor motion and shutter to photograph moving things in dim light.",
    no_args_is_help=False,
    cls=GroupedCommands,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(is_asked: bool) -> bool:
    if is_asked:
        from mishutter.design.design import package_version

        libraries = (f"{name} {version(name)}" for name in ("jax", "jaxlib"))
        words = f"mishutter {package_version()}", *libraries, f"Python {python_version()}"
        print_text(", ".join(words))
        raise typer.Exit
    return is_asked


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option(
            "--version",
            callback=_version,
            is_eager=True,
            help="Show the versions of mishutter, jax, jaxlib and Python, and exit.",
        ),
    ] = False,
    modules: Annotated[
        list[str] | None,
        typer.Option(
            _IMPORT,
            metavar="MODULE",
            help="Python module that registers a shutter of your own, of which a design is; "
            "before or after the command.",
        ),
    ] = None,
) -> None:
    """Options shared by all commands."""
    for name in modules or []:
        sys.path.insert(0, "")  # as `python -m` does, for modules in the current folder
        try:
            import_module(name)
        except ImportError as error:
            requirement = f"be a module that can be imported; got {name!r}: {error}"
            raise ValueError(f"`{_IMPORT}` must {requirement}.") from None
        finally:
            sys.path.remove("")


@app.command(cls=GroupedCommand, rich_help_panel=TO_BEGIN)
def example() -> None:
    """Print the built-in scene, an annotated file to edit."""
    from mishutter.model.scene_file import example_scene_text

    sys.stdout.write(example_scene_text())


@app.command(cls=GroupedCommand, rich_help_panel=TO_DESIGN)
def optimise(
    scene_file: SceneArgument = None,
    *,
    out: OutOption = None,
    json: JsonOption = False,
    loss: LossOption = None,
    free: FreeOption = None,
    num_coefficients: CoefficientsOption = 24,
    num_starts: Annotated[
        int | None,
        option(
            SEARCH,
            "--starts N",
            "Number of starts [default: 16; more for few speeds].",
            min=1,
            max=4096,
        ),
    ] = None,
    max_steps: Annotated[
        int,
        option(
            SEARCH, "--steps N", "Most steps of a minimisation from each start.", min=1, max=100_000
        ),
    ] = 400,
    seed: Annotated[int, option(SEARCH, "--seed N", "Seed of the random starts.", min=0)] = 0,
    noise_seeds: SeedsOption = 1,
    every_photograph: EveryPhotographOption = False,
    pictures: PicturesOption = None,
    decoder: JudgeOption = None,
    verbose: VerboseOption = False,
) -> None:
    """Find the best exposures, sensor motion and shutter for a scene, beside simpler cameras."""
    start_jax()
    from mishutter.search.bursts import shown_bursts
    from mishutter.search.rivals import RivalSearch
    from mishutter.search.search import optimise as search

    scene = scene_of(scene_file)
    if scene.velocities is not None:
        beside = {
            "--loss": loss,
            "--free": free,
            "--every-photograph": every_photograph,
            "--pictures": pictures,
            "--decoder": decoder,
        }
        refuse_in_plane(beside)
        folder = None if out is None else writable_folder(out)
        result = optimised_in_plane(scene)
        delivery = Delivery(folder, json, 0, every_photograph=False, verbose=verbose)
        _deliver(result, delivery, scene_file, folder)
        return
    chosen = loss_of(loss, scene)
    judge = judge_of(decoder, pictures)
    folder = None if out is None else writable_folder(out)
    if verbose:
        note(plan_text(plan_of_search(scene, chosen, free, num_coefficients)))
    delivery = Delivery(folder, json, noise_seeds, every_photograph, verbose)
    every, bursts, design = verbose or json, (), None
    asks_for_one = every or free is not None or decoder is not None or delivery.shows_every
    with interruptible(lambda: AGAIN):
        if not asks_for_one:
            bursts = shown_bursts(scene, is_shown=True)
        if not RivalSearch(scene, chosen, every=asks_for_one, bursts=bursts).frames_alone:
            design = search(
                scene,
                loss=chosen,
                free=names_of(free),
                num_coefficients=num_coefficients,
                num_starts=num_starts,
                seed=seed,
                max_steps=max_steps,
                progress=True,
                bursts=bursts,
            )
    with interruptible(lambda: AGAIN if design is None else _after_search(scene_file, folder)):
        if design is not None and folder is not None:
            replace(design, sequence=None).save(folder / ONE_EXPOSURE)
        result = _compared(
            scene,
            scene.motion if design is None else design.motion,
            {} if design is None else {"optimised": design},
            chosen,
            every=every,
            judge=judge,
            bursts=bursts,
        )
        if design is None:  # of the frames, beside the best snapshot
            snapshot = result.comparison.options_baseline.design
            design = snapshot and replace(snapshot, sequence=result.comparison.sequence)
        result = replace(result, design=design)
        _deliver(result, delivery, scene_file, folder)


def _after_search(scene_file: Path | None, folder: Path | None) -> str:
    """The message of an interrupt that comes between the end of a search and its report."""
    if folder is None:
        return f"{AGAIN}; with --out DIR the design is saved as soon as the search ends"
    design = shlex.join(["--design", str(folder / ONE_EXPOSURE)])
    scene = "" if scene_file is None else f" {shlex.quote(str(scene_file))}"
    return f"the design is saved; `mishutter compare{scene} {design}` continues from it"


@app.command(cls=GroupedCommand, rich_help_panel=TO_DESIGN)
@takes_camera_files
def compare(
    scene_file: SceneArgument = None,
    *,
    designs: Annotated[
        list[Path] | None,
        design_option(DESIGN, "--design FILE", "Saved design to show; repeat for more."),
    ] = None,
    shutters: ShuttersOption = None,
    files: CameraFiles,
    out: OutOption = None,
    json: JsonOption = False,
    loss: LossOption = None,
    noise_seeds: SeedsOption = 1,
    every_photograph: EveryPhotographOption = False,
    pictures: PicturesOption = None,
    decoder: JudgeOption = None,
    verbose: VerboseOption = False,
) -> None:
    """Compare shutters, saved designs, drive tables or traces with simpler cameras."""
    start_jax()
    from mishutter.design.design import Design
    from mishutter.model.shutters.kinds import named_shutter
    from mishutter.search.rivals import taken_names

    scene = scene_of(scene_file)
    windows = {name: named_shutter(name) for name in shutters or []}
    camera = Cameras({})
    if files.drive is not None or files.measured is not None:
        if designs is not None and len(designs) > 1:
            raise ValueError(
                "`--design` must be given at most once with --drive or --measured, which belong to "
                f"one design; got {len(designs)}."
            )
        camera = cameras(scene, designs[0] if designs else None, files)
        saved = camera.designs
        motion = next(iter(saved.values())).motion
    else:
        paths = short_names(designs or [], {*taken_names(), *windows})
        saved = {name: Design.load_one(path) for name, path in paths.items()}
        for name, path in paths.items():
            note_other_device(path, saved[name], scene)
        motion = next(iter(saved.values())).motion if len(saved) == 1 else scene.motion
    judge = judge_of(decoder, pictures)
    folder = None if out is None else writable_folder(out)
    delivery = Delivery(folder, json, noise_seeds, every_photograph, verbose)
    with interruptible(lambda: AGAIN):
        entries = saved | windows
        result = _compared(
            scene,
            motion,
            entries,
            loss_of(loss, scene),
            every=verbose or json or not entries,
            judge=judge,
        )
        result = _beside_design(result, camera, files.middle_ms * 1e-3)
        _deliver(result, delivery, scene_file)


for _command, _group in (
    (measure, TO_BEGIN),
    (sweep, TO_DESIGN),
    (plan, TO_DESIGN),
    (simulate, TO_SEE),
    (restore, TO_SEE),
    (explore, TO_SEE),
    (reproduce, TO_SEE),
    (export, TO_BUILD),
    (fit, TO_BUILD),
):
    app.command(cls=GroupedCommand, rich_help_panel=_group)(_command)


def _compared(
    scene: "Scene",
    motion: "AbstractMotion",
    entries: "Mapping[str, AbstractShutter | Design]",
    loss: "AbstractLoss",
    *,
    every: bool,
    judge: "tuple[AbstractDecoder | None, list[Picture]]",
    bursts: "tuple[Exposures, ...]" = (),
) -> "Report":
    from mishutter.report.comparison import compare as beside_baselines
    from mishutter.report.documents import Report

    decoder, pictures = judge
    comparison = beside_baselines(
        scene,
        motion,
        entries,
        loss=loss,
        every=every,
        decoder=decoder,
        pictures=pictures,
        progress=True,
        bursts=bursts,
    )
    return Report(scene, comparison, tuple(entries))


def _beside_design(report: "Report", camera: Cameras, middle: float) -> "Report":
    """Adds the loss of a measured shutter against its design, and its best shift."""
    from mishutter.report.measured import measured_camera
    from mishutter.search.rows import OWN_BEST_MOTION

    if camera.trace is None or camera.profile is None:
        return report
    all_rows = report.comparison.rows
    rows = {row.name: row for row in all_rows if row.reading == OWN_BEST_MOTION}
    with working("shifting the measured shutter"):
        measured = measured_camera(
            report.scene,
            rows,
            camera.trace,
            camera.profile,
            middle=middle,
            measured=AS_MEASURED,
            designed=AS_DESIGNED,
        )
    return replace(report, measured=measured)


class Delivery(NamedTuple):
    """The form in which a command hands over a comparison."""

    folder: Path | None  # Folder for designs and pictures; None writes none
    as_json: bool  # Whether standard output is one JSON document, and not tables
    num_seeds: int  # Captures of the photograph at each speed; 0 takes none
    every_photograph: bool  # Whether the photograph is restored at every speed, by three decoders
    verbose: bool  # Whether every table is printed

    @property
    def shows_every(self) -> bool:
        """Whether pictures show designs that the answer does not recommend."""
        return self.verbose or self.every_photograph or self.num_seeds > 1

    def photographed(self, result: "Report") -> "Report":
        """Adds the scene's photograph, captured and restored by each design."""
        from mishutter.report.restored import photograph_of, photographs

        rows, scene, every = result.rows, result.scene, self.every_photograph
        picture = photograph_of(scene, rows, note=note) if self.num_seeds > 0 else None
        if picture is None:
            return result
        with progress_bar("photograph", len(rows), _WHY_NO_STEP) as bar:
            shown = photographs(
                picture,
                scene,
                rows,
                self.num_seeds,
                every=every,
                begin=bar.next,
                within=bar.within,
            )
        return replace(result, photographs=shown)


def _deliver(
    result: "Report",
    delivery: Delivery,
    scene_file: Path | None,
    designs: Path | None = None,  # Folder of a design from which work goes on, if it has one
) -> None:
    """Prints the answer at once, then adds photographs, then writes files."""
    from mishutter.cli.tables import print_comparison, print_photographs
    from mishutter.report.documents import write_report

    folder = delivery.folder

    def wrote(name: str) -> None:
        note(f"wrote {name if folder is None else folder / name}")

    if not delivery.as_json:
        with closable_output():  # a reader who has read enough still gets the files
            step = next_step(scene_file, designs, result.file_to_build)
            print_comparison(result, verbose=delivery.verbose, next_step=step)
    shows = delivery.shows_every
    result = replace(result, every=shows)
    if shows or delivery.as_json or folder is not None:
        result = delivery.photographed(result)
    if result.photographs is not None and shows and not delivery.as_json:
        with closable_output():
            decoder = result.comparison.rows[0].decoder
            print_photographs(result.photograph_levels, decoder.name)
    files = []
    if folder is not None:
        files = write_report(result, folder, wrote=wrote)
    if delivery.as_json:
        write_json(result.to_dict() | {"files": files})


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command line, or shows its help if there are no arguments; returns the exit code."""
    words = list(sys.argv[1:] if arguments is None else arguments) or ["--help"]
    take_any_text()
    with closable_output():
        return _run(words)
    return 0


def _imports_first(words: Sequence[str]) -> list[str]:
    """The arguments with `--import` and its module, which all commands share, before the others."""
    first: list[str] = []
    rest: list[str] = []
    others = iter(words)
    for word in others:
        if word == _IMPORT and word is not words[-1]:
            first += [word, *itertools.islice(others, 1)]
        elif word.startswith(f"{_IMPORT}="):
            first.append(word)
        else:
            rest.append(word)
    return [*first, *rest]


def _options_of(command: Any, words: Sequence[str]) -> dict[str, str]:
    """The options of the command that some words call, by the names of its arguments."""
    called = next((command.commands[word] for word in words if word in command.commands), command)
    shown = (each for each in called.params if not getattr(each, "hidden", False))
    return {each.name: each.opts[0] for each in shown if each.opts[0].startswith("--")}


def _run(words: Sequence[str]) -> int:
    command, words = typer.main.get_command(app), _imports_first(words)
    try:
        with ends_when_asked(), doubts_as_notes():
            code = command.main(words, prog_name="mishutter", standalone_mode=False)
            sys.stdout.flush()  # a disk may be too full for the last lines
        if code == _INTERRUPTED:  # no `interruptible` had begun
            note(f"mishutter: interrupted: {AGAIN}")
    except InterruptedWorkError as error:
        note(f"mishutter: interrupted: {error}")
        code = _INTERRUPTED
    except (KeyboardInterrupt, typer.Abort):
        code = _INTERRUPTED
    except BrokenPipeError:
        raise
    except Exception as error:
        line = error_line(error, words, _options_of(command, words))
        if line is None:
            raise
        write_error(line)
        return 2
    return code if isinstance(code, int) else 0
