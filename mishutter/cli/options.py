"""Arguments and options that the commands share, and what they stand for."""

from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from mishutter.evaluation import AbstractLoss
    from mishutter.model import Scene


class LossName(Enum):
    """Losses that `--loss` names."""

    EXPECTED_ERROR = "expected-error"
    KNOWN_SPEED = "known-speed"
    FOUND_SPEED = "found-speed"
    WORST_SPEED = "worst-speed"
    DESIGN = "design"


class FreeName(Enum):
    """What `--free` names."""

    SHUTTER = "shutter"
    ACCELERATION = "acceleration"
    HALF_EXPOSURE = "half_exposure"
    VELOCITY = "velocity"
    PATH = "path"


def as_path(text: str | Path) -> Path:
    """The path that an argument gives; `Path("")` would be the current folder."""
    if text == "":
        raise typer.BadParameter("be a path of at least one character; got ''")
    return Path(text)


SceneArgument = Annotated[
    Path | None,
    typer.Argument(
        metavar="[SCENE.toml]",
        parser=as_path,
        help="Scene file; the built-in scene without one.",
    ),
]
OutOption = Annotated[
    Path | None,
    typer.Option("--out", metavar="DIR", parser=as_path, help="Folder for designs and pictures."),
]
JsonOption = Annotated[
    bool, typer.Option("--json", help="Print one JSON document, and nothing else, on stdout.")
]
LossOption = Annotated[
    LossName | None,
    typer.Option(
        "--loss",
        show_default=False,
        help="What is made small: the expected error of the picture restored by one filter for all "
        "speeds (expected-error), the same at the worst of the speeds (worst-speed), by a filter "
        "that is told the speed (known-speed), or by a decoder that finds it in the picture "
        "(found-speed); or (design) condition number, kernel difference and lost light, which know "
        "no noise and move the profile alone "
        "[default: the expected error of the scene's decoder].",
    ),
]
FreeOption = Annotated[
    list[FreeName] | None,
    typer.Option("--free", help="What may move; repeat for more; all that can without it."),
]
CoefficientsOption = Annotated[
    int, typer.Option("--coefficients", min=4, max=512, help="Coefficients of the profile.")
]
SeedsOption = Annotated[
    int,
    typer.Option(
        "--noise-seeds",
        min=0,
        max=1000,
        help="Captures of the photograph at each speed; 0 leaves it out.",
    ),
]
EveryPhotographOption = Annotated[
    bool,
    typer.Option(
        "--every-photograph",
        help="Restore the photograph at every speed and by three decoders, not only at the "
        "slowest, a middling and the fastest by one.",
    ),
]
ShuttersOption = Annotated[
    list[str] | None,
    typer.Option(
        "--shutter",
        metavar="NAME[:VALUE]",
        help="rect, hann, triangle, gaussian:0.4, tukey:0.5 or raskar; repeat for more.",
    ),
]


def scene_of(path: Path | None) -> "Scene":
    """The scene of a file, or the built-in one."""
    from mishutter.model import example_scene, read_scene

    return example_scene() if path is None else read_scene(path)


def names_of(free: list[FreeName] | None) -> tuple[str, ...] | None:
    """What `--free` names; None for what moves by default."""
    return tuple(name.value for name in free) if free else None


def loss_of(name: LossName | None, scene: "Scene") -> "AbstractLoss":
    """The loss of a name, or the expected error of the decoder that the scene names."""
    from mishutter.evaluation import (
        DesignLoss,
        ExpectedErrorLoss,
        FoundSpeedLoss,
        KnownSpeedLoss,
        WorstSpeedLoss,
        loss_of_decoder,
    )

    if name is None:
        return loss_of_decoder(scene)
    losses = {
        LossName.EXPECTED_ERROR: ExpectedErrorLoss,
        LossName.KNOWN_SPEED: KnownSpeedLoss,
        LossName.FOUND_SPEED: FoundSpeedLoss,
        LossName.WORST_SPEED: WorstSpeedLoss,
        LossName.DESIGN: DesignLoss,
    }
    return losses[name]()
