"""Layered scenes from a TOML file: `[[layers]]` with picture, matte and speed."""

import tomllib
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from mishutter._core import Section, contents, parsed, require, validated
from mishutter.camera.layers import FARTHEST, Layer, Layers
from mishutter.model import Picture, Speed, read_opacity, read_picture

_READ = "read_layers(path=...)"
_Place = Annotated[int, Field(ge=-FARTHEST, le=FARTHEST)]
_Name = Annotated[str, Field(min_length=1)]


class _LayerEntry(Section):
    picture: _Name
    matte: _Name | None = None
    speed_px_per_s: Speed = 0.0
    left: _Place = 0
    top: _Place = 0


class _LayersFile(Section):
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
    tables = parsed(tomllib.loads, contents(path), str(path), "TOML")
    file = validated(_LayersFile, tables, str(path))
    layers = tuple(_layer(entry, path.parent) for entry in file.layers)
    return Layers(layers, border=file.border)


def _layer(entry: _LayerEntry, folder: Path) -> Layer:
    picture = read_picture(folder / entry.picture)
    if entry.matte is not None:
        picture = Picture(picture.light, _matte(folder / entry.matte, picture), picture.name)
    return Layer(picture, entry.speed_px_per_s, entry.left, entry.top)


def _matte(path: Path, picture: Picture) -> np.ndarray:
    matte, expected = read_opacity(path), picture.light.shape[:2]
    got = f"{matte.shape[1]} x {matte.shape[0]} px in {str(path)!r}"
    size = f"be as large as its picture, {expected[1]} x {expected[0]} px"
    require(matte.shape == expected, "read_layers(matte=...)", size, got)
    return matte
