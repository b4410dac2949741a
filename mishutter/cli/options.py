"""Arguments and options that the commands share, and the objects that they name."""

from enum import Enum
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from mishutter._core.checks import require
from mishutter._core.files import FORMER, RECOMMENDED
from mishutter._core.progress import note
from mishutter.cli.help import DESIGN, MOVES, OUTPUT, PICTURES

if TYPE_CHECKING:
    from mishutter.decoding.decoders.base import AbstractDecoder
    from mishutter.evaluation.losses import AbstractLoss
    from mishutter.model.scene import Scene
    from mishutter.pictures.images import Picture


class LossName(Enum):
    """The losses of `--loss`."""

    EXPECTED_ERROR = "expected-error"
    KNOWN_SPEED = "known-speed"
    FOUND_SPEED = "found-speed"
    WORST_SPEED = "worst-speed"
    DESIGN = "design"


class FreeName(Enum):
    """The parts of a design that `--free` lets move."""

    SHUTTER = "shutter"
    ACCELERATION = "acceleration"
    HALF_EXPOSURE = "half_exposure"
    VELOCITY = "velocity"
    PATH = "path"


class DecoderName(Enum):
    """The decoders of `--decoder`."""

    ENSEMBLE = "ensemble"
    WIENER = "wiener"
    RICHARDSON_LUCY = "richardson-lucy"
    TOTAL_VARIATION = "total-variation"
    SPEED_FINDING = "speed-finding"


def _in_words(names: type[Enum]) -> str:
    """Alternatives as `a, b or c`."""
    *others, last = (name.value for name in names)
    return f"{', '.join(others)} or {last}"


DECODERS = _in_words(DecoderName)


def option(group: str | None, name: str, help: str, **settings: Any) -> Any:
    """An option of a group of `--help`; its name and a word for its value are `--out DIR`."""
    name, _, metavar = name.partition(" ")
    return typer.Option(name, metavar=metavar or None, rich_help_panel=group, help=help, **settings)


def as_path(text: str | Path) -> Path:
    """The path of an argument; an empty one is refused, as `Path("")` is the current folder."""
    if text == "":
        raise typer.BadParameter("be a path of at least one character; got ''")
    return Path(text)


def as_design(text: str | Path) -> Path:
    """The path of a saved design: a file, or the folder of an answer, whose recommendation it is.

    A folder of one version is read by the names of the other, with a note.
    """
    path = as_path(text)
    path = path / RECOMMENDED if path.is_dir() else path
    if path.exists() or path.name not in (RECOMMENDED, *FORMER):
        return path
    others = (path.with_name(name) for name in (RECOMMENDED, *FORMER))
    other = next((each for each in others if each.exists()), path)
    if other != path:
        note(f"{path} is {other.name} in this folder, which is read")
    return other


path_option = partial(option, parser=as_path)
design_option = partial(option, parser=as_design)


def scene_argument(default: str) -> Any:
    """The file of a scene, and what stands for it in words."""
    text = f"Scene file: speeds, noise and limits of the camera [default: {default}]."
    return typer.Argument(metavar="SCENE.toml", parser=as_path, help=text)


SceneArgument = Annotated[Path | None, scene_argument("the built-in scene")]
OutOption = Annotated[
    Path | None, path_option(OUTPUT, "--out DIR", "Folder for files; created if it does not exist.")
]
PicturesOutOption = Annotated[Path, path_option(OUTPUT, "--out DIR", "Folder for the pictures.")]
JsonOption = Annotated[
    bool, option(OUTPUT, "--json", "Print one JSON document, and nothing else, on standard output.")
]
LossOption = Annotated[
    LossName | None,
    option(
        DESIGN,
        "--loss NAME",
        "Quantity to minimise. expected-error: the error of the restored picture by one "
        "filter for all speeds. worst-speed: the same at the worst of the speeds. known-speed: by "
        "a filter that knows the speed. found-speed: by a decoder that finds the speed in the "
        "picture. design: condition number, kernel difference and lost light; it ignores noise "
        "and moves only the profile [default: the error by the scene's decoder].",
        show_default=False,
    ),
]
FreeOption = Annotated[
    list[FreeName] | None,
    option(
        MOVES,
        "--free PART",
        f"Part of the design to search for: {_in_words(FreeName)}; repeat for more [default: all "
        "that the limits allow, except path].",
    ),
]
CoefficientsOption = Annotated[
    int,
    option(
        DESIGN,
        "--coefficients N",
        "Number of coefficients of the free-form profile.",
        min=4,
        max=512,
    ),
]
VerboseOption = Annotated[
    bool,
    option(
        OUTPUT,
        "--verbose",
        "Also print the losses of a real sensor, the tables of all rows, and, before a "
        "search, which parts are computed or skipped.",
    ),
]
SeedsOption = Annotated[
    int,
    option(
        PICTURES,
        "--noise-seeds N",
        "Number of captures of the scene's photograph at each speed, each with its own "
        "noise; 0 takes none.",
        min=0,
        max=1000,
    ),
]
EveryPhotographOption = Annotated[
    bool,
    option(
        PICTURES,
        "--every-photograph",
        "Restore the photograph at every speed and by three decoders [default: at the "
        "slowest, a middle and the fastest speed, by one decoder].",
    ),
]
PicturesOption = Annotated[
    list[Path] | None,
    path_option(
        PICTURES,
        "--pictures PATH",
        "Photograph, or folder of photographs, on which each camera is also judged, with "
        "its exposure tuned for --decoder; repeat for more. Two or more are needed; crops"
        " of about a hundred rows are enough.",
    ),
]
JudgeOption = Annotated[
    DecoderName | None,
    option(
        PICTURES,
        "--decoder NAME",
        f"Decoder that restores --pictures: {DECODERS} [default: ensemble].",
        show_default=False,
    ),
]
ShuttersOption = Annotated[
    list[str] | None,
    option(
        DESIGN,
        "--shutter NAME[:VALUE]",
        "Shutter to compare as well: rect, hann, triangle, gaussian:0.4, tukey:0.5 or "
        "raskar; repeat for more.",
    ),
]


def scene_of(path: Path | None) -> "Scene":
    """The scene of a file, or the built-in one."""
    from mishutter.model.scene import example_scene, read_scene

    return example_scene() if path is None else read_scene(path)


def names_of(free: list[FreeName] | None) -> tuple[str, ...] | None:
    """The names of `--free`; None lets the default parts move."""
    return tuple(name.value for name in free) if free else None


def named_decoder(name: DecoderName, scene: "Scene | None" = None) -> "AbstractDecoder":
    """The decoder of a name, with the parameters that it has by default, for a scene."""
    import mishutter as ms

    in_plane = scene is not None and scene.velocities is not None
    fits = not in_plane or name in (DecoderName.ENSEMBLE, DecoderName.TOTAL_VARIATION)
    requirement = "be ensemble or total-variation where things move in any direction"
    require(fits, "--decoder", requirement, name.value)
    decoders = {
        DecoderName.ENSEMBLE: ms.EnsembleDecoder,
        DecoderName.WIENER: ms.WienerDecoder,
        DecoderName.RICHARDSON_LUCY: ms.RichardsonLucyDecoder,
        DecoderName.TOTAL_VARIATION: ms.TotalVariationDecoder,
        DecoderName.SPEED_FINDING: ms.SpeedFindingDecoder,
    }
    return decoders[name]()


def judge_of(
    name: DecoderName | None, paths: list[Path] | None
) -> "tuple[AbstractDecoder | None, list[Picture]]":
    """The decoder and the photographs of `--decoder` and `--pictures`; none of both without these.

    They are read before a search begins, which no wrong file then follows.
    """
    from mishutter.pictures.images import read_picture

    if not paths:
        require(name is None, "--decoder", "stand beside --pictures", name and name.value)
        return None, []
    files = [
        file
        for path in paths
        for file in (sorted(path.iterdir()) if path.is_dir() else [path])
        if not file.name.startswith(".")
    ]
    require(len(files) > 1, "--pictures", "be two or more, for a standard error", len(files))
    return named_decoder(name or DecoderName.ENSEMBLE), [read_picture(file) for file in files]


def loss_of(name: LossName | None, scene: "Scene") -> "AbstractLoss":
    """The loss of a name; by default the expected error of the scene's decoder."""
    import mishutter as ms
    from mishutter.evaluation.speed_knowledge import loss_of_decoder

    if name is None:
        return loss_of_decoder(scene)
    made = {
        LossName.EXPECTED_ERROR: ms.ExpectedErrorLoss,
        LossName.KNOWN_SPEED: ms.KnownSpeedLoss,
        LossName.FOUND_SPEED: ms.FoundSpeedLoss,
        LossName.WORST_SPEED: ms.WorstSpeedLoss,
        LossName.DESIGN: ms.DesignLoss,
    }
    return made[name]()
