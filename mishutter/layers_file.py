"""Layered scenes from a TOML file: `[[layers]]` with picture, matte and speed."""

import tomllib
from pathlib import Path

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from mishutter.layers import Layer, Layers
from mishutter.pictures import Picture, read_picture
from mishutter.types import require

_READ = "read_layers(path=...)"


class _LayerEntry(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)

    picture: str
    matte: str | None = None
    speed_px_per_s: float = Field(default=0.0, allow_inf_nan=False)
    left: int = 0
    top: int = 0


class _LayersFile(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)

    border: str = "reflect"
    layers: list[_LayerEntry] = Field(min_length=1)


def is_layers_file(path: str | Path) -> bool:
    """Whether a file is meant as a layered scene, by its name."""
    return Path(path).suffix.lower() == ".toml"


def read_layers(path: str | Path) -> Layers:
    """Read a layered scene, from back to front.

    ```toml
    border = "reflect"            # how the first layer goes on: reflect, edge, wrap, zero

    [[layers]]                    # the background, opaque, as large as the sensor
    picture = "street.png"

    [[layers]]
    picture = "car.png"           # its alpha is its matte
    matte = "car_matte.png"       # or a grey picture of the same size; 0 is transparent
    speed_px_per_s = 1200.0
    left = 40                     # column and row of its corner at mid-exposure
    top = 80
    ```

    Paths are taken from the file's place. A matte is opacity, not light: no gamma is
    removed from it.

    Raises:
        OSError: if a file cannot be read.
        ValueError: if the file is not a layered scene, or a matte does not fit.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"`{_READ}` must name a TOML file; got {str(path)!r}, not found.")
    try:
        parsed = _LayersFile.model_validate(tomllib.loads(path.read_text("utf-8")))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ValueError(f"`{_READ}` must be TOML; got {error} in {str(path)!r}.") from error
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or "the file"
        raise ValueError(
            f"`{_READ}` must describe layers; got {first['msg'].lower()} at {where} in "
            f"{str(path)!r}."
        ) from error
    layers = tuple(_layer(entry, path.parent) for entry in parsed.layers)
    return Layers(layers, border=parsed.border)


def _layer(entry: _LayerEntry, folder: Path) -> Layer:
    picture = read_picture(folder / entry.picture)
    if entry.matte is not None:
        picture = Picture(picture.light, _matte(folder / entry.matte, picture), picture.name)
    return Layer(picture, entry.speed_px_per_s, entry.left, entry.top)


def _matte(path: Path, picture: Picture) -> np.ndarray:
    from mishutter.pictures import GAMMA

    read = read_picture(path)
    shape, expected = read.light.shape[:2], picture.light.shape[:2]
    got = f"{shape[1]} x {shape[0]} px in {str(path)!r}"
    size = f"be as large as its picture, {expected[1]} x {expected[0]} px"
    require(shape == expected, "read_layers(matte=...)", size, got)
    if path.suffix.lower() in (".tif", ".tiff") and read.light.dtype == np.float32:
        return np.clip(read.luminance, 0, 1)
    return np.clip(read.luminance ** (1 / GAMMA), 0, 1).astype(np.float32)
