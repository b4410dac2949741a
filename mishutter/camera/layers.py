"""Objects in front of one another, each at its own velocity, and their file.

A layered scene in TOML has a table `[[layers]]` with picture, matte and velocity for each.
"""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
from jaxtyping import Float
from pydantic import Field

from mishutter._core.checks import RowLike, Unquoted, require, require_finite
from mishutter._core.files import contents, write_text
from mishutter._core.validation import Section, parsed, validated
from mishutter.camera.rows import PAD_MODES
from mishutter.model.scene_schema import Speed, Velocity, White
from mishutter.pictures.images import (
    GAMMA,
    Axis,
    Picture,
    read_opacity,
    read_picture,
    write_picture,
)

_FARTHEST = 10**9
"""Columns or rows that a layer's corner may lie from the sensor's."""
_Place = Annotated[int, Field(ge=-_FARTHEST, le=_FARTHEST)]
_Name = Annotated[str, Field(min_length=1)]


@dataclass(frozen=True, eq=False)
class Layer:
    """A picture that moves; its matte says where it is.

    Attributes:
        picture: The picture; opaque where it has no matte.
        speed: Speed on the sensor along its rows, either sign; or its velocity along rows and
            columns, to the left and up, for frames in the plane; px/s.
        left: Column of the sensor under its first column at mid-exposure.
        top: Row of the sensor under its first row.

    Where the scene's `axis` is `"columns"` one speed is along its columns, and the corner is where
    it is at mid-exposure all the same.
    """

    picture: Picture
    speed: float | RowLike = 0.0
    left: int = 0
    top: int = 0

    def __post_init__(self) -> None:
        picture = self.picture
        require(isinstance(picture, Picture), "Layer(picture=...)", "be a `Picture`", picture)
        require_finite("Layer(speed=...)", self.speed)
        words = "be a speed, or a velocity along rows and columns"
        require(np.shape(self.speed) in ((), (2,)), "Layer(speed=...)", words, self.speed)
        for name, place in (("left", self.left), ("top", self.top)):
            is_near = -_FARTHEST <= place <= _FARTHEST
            require(is_near, f"Layer({name}=...)", f"lie within {_FARTHEST:g} px", place)

    def transposed(self, axis: Axis) -> "Layer":
        """The layer with rows and columns exchanged, unless things move along its rows.

        Args:
            axis: The axis along which things move.
        """
        if axis == "rows":
            return self
        speed = self.speed if np.ndim(self.speed) == 0 else self.velocity[::-1]
        return Layer(self.picture.transposed(axis), speed, left=self.top, top=self.left)

    @property
    def velocity(self) -> Float[np.ndarray, "2"]:
        """Its velocity along rows and columns, to the left and up; px/s."""
        speed = np.asarray(self.speed, np.float64)
        return speed if speed.ndim else np.array([float(speed), 0.0])

    @property
    def along_rows(self) -> float:
        """Its speed along the rows, for what serves no other direction; px/s."""
        along, across = self.velocity
        words = "be along the axis of the scene; frames in the plane take any velocity"
        require(across == 0, "Layer(speed=...)", words, self.speed)
        return float(along)

    @property
    def matte(self) -> Float[np.ndarray, "rows columns"]:
        """Opacity of each pixel, from 0 to 1; 1 for a picture without a matte."""
        matte = self.picture.matte
        return np.ones(self.picture.light.shape[:2], np.float32) if matte is None else matte


@dataclass(frozen=True, eq=False)
class Layers:
    """Layers from back to front; the first is opaque and is as large as the sensor.

    Attributes:
        layers: At least one.
        border: Continuation of the first beyond its ends: `"reflect"`, `"edge"`, `"wrap"`
            or `"zero"`. The others end where they end.
    """

    layers: tuple[Layer, ...]
    border: str = "reflect"

    def __post_init__(self) -> None:
        subject, layers = "Layers(layers=...)", self.layers
        is_list = isinstance(layers, Sequence) and len(layers) >= 1
        are_layers = is_list and all(isinstance(layer, Layer) for layer in layers)
        require(are_layers, subject, "hold at least one layer and nothing else", layers)
        is_known, requirement = self.border in PAD_MODES, f"be one of {[*PAD_MODES]}"
        require(is_known, "Layers(border=...)", requirement, self.border)
        is_opaque = bool(np.all(self.layers[0].matte == 1))
        require(is_opaque, subject, "begin with an opaque layer", Unquoted("one with a matte"))

    @staticmethod
    def load(path: str | Path) -> "Layers":
        """Read a layered scene from a TOML file; see `read_layers` for its keys.

        Args:
            path: The file.

        Raises:
            ValueError: if the file is not a layered scene, or a matte does not fit.
            OSError: if a file cannot be read.
        """
        return read_layers(path)

    def transposed(self, axis: Axis) -> "Layers":
        """The layers with rows and columns exchanged, unless things move along their rows.

        Args:
            axis: The axis along which things move.
        """
        return Layers(tuple(layer.transposed(axis) for layer in self.layers), self.border)

    def on_rows(self, rows: slice) -> "Layers":
        """The layers of some rows of the sensor alone.

        Args:
            rows: Those rows, at least one.
        """
        first, *others = self.layers
        own = replace(first, picture=replace(first.picture, light=first.picture.light[rows]))
        return replace(self, layers=(own, *(replace(x, top=x.top - rows.start) for x in others)))

    @property
    def shape(self) -> tuple[int, int, int]:
        """Rows, columns and channels of the sensor."""
        channels = max(layer.picture.light.shape[2] for layer in self.layers)
        return (*self.layers[0].picture.light.shape[:2], channels)


class _LayerEntry(Section):
    picture: _Name
    white: White | None = None
    linear: bool = False
    matte: _Name | None = None
    speed_px_per_s: Speed | None = None
    velocity_px_per_s: Velocity | None = None
    left: _Place = 0
    top: _Place = 0


class _LayersFile(Section):
    border: str = "reflect"
    layers: list[_LayerEntry] = Field(min_length=1)


def write_layers(folder: str | Path, layers: Layers) -> list[str]:
    """Write a layered scene as `layers.toml`, which `read_layers` reads, and its pictures.

    Args:
        folder: An existing folder.
        layers: The layers.

    Returns:
        The names of the files: `layers.toml`, and `layer_0.png` of the background and on, with the
        matte of each thing before it beside it.

    Raises:
        OSError: if a file cannot be written.
    """
    folder, lines, written = Path(folder), [f'border = "{layers.border}"'], ["layers.toml"]
    for number, layer in enumerate(layers.layers):
        name = f"layer_{number}.png"
        write_picture(folder / name, layer.picture)
        lines += ["", "[[layers]]", f'picture = "{name}"']
        written.append(name)
        if layer.picture.matte is not None:
            # Files of pictures are gamma-coded, and those of mattes are read as they are.
            write_picture(folder / f"matte_{number}.png", layer.matte.astype(np.float64) ** GAMMA)
            lines.append(f'matte = "matte_{number}.png"')
            written.append(f"matte_{number}.png")
        if number:
            each = [f"{x:.6g}" for x in np.ravel(layer.speed)]
            is_velocity = np.ndim(layer.speed) > 0
            lines += [
                f"velocity_px_per_s = [{', '.join(each)}]"
                if is_velocity
                else f"speed_px_per_s = {each[0]}"
            ]
            lines += [f"left = {layer.left}", f"top = {layer.top}"]
    write_text(folder / "layers.toml", "\n".join([*lines, ""]))
    return written


def is_layers_file(path: str | Path) -> bool:
    """Whether a file is meant as a layered scene, by its name."""
    return Path(path).suffix.lower() == ".toml"


def read_layers(path: str | Path) -> Layers:
    """Read a layered scene, from back to front.

    ```toml
    border = "reflect"            # how the first layer goes on: reflect, edge, wrap, zero

    [[layers]]                    # the background, opaque, as large as the sensor
    picture = "street.png"
    white = 4095                  # value of its file that is white, where not that of its depth
    linear = true                 # its numbers are linear light

    [[layers]]
    picture = "car.png"           # its alpha is its matte
    matte = "car_matte.png"       # or a grey picture of the same size; 0 is transparent
    speed_px_per_s = 1200.0       # or velocity_px_per_s = [1200, -300], along rows and columns
    left = 40                     # column and row of its corner at mid-exposure
    top = 80
    ```

    Paths are taken from the file's place. A matte is opacity, not light: no gamma is
    removed from it.

    Args:
        path: The file.

    Raises:
        OSError: if a file cannot be read.
        ValueError: if the file is not a layered scene, or a matte does not fit.
    """
    path = Path(path)
    if not path.is_file():
        got = f"{str(path)!r}, not found"
        raise FileNotFoundError(f"`read_layers(path=...)` must name a TOML file; got {got}.")
    tables = parsed(tomllib.loads, contents(path), str(path), "TOML")
    file = validated(_LayersFile, tables, str(path))
    layers = []
    for entry in file.layers:
        place = path.parent / entry.picture
        picture = read_picture(place, white=entry.white, linear=entry.linear)
        if entry.matte is not None:
            place = path.parent / entry.matte
            matte, (rows, columns) = read_opacity(place), picture.light.shape[:2]
            got = f"{matte.shape[1]} x {matte.shape[0]} px in {str(place)!r}"
            requirement = f"be as large as its picture, {columns} x {rows} px"
            require(matte.shape == (rows, columns), "read_layers(matte=...)", requirement, got)
            picture = Picture(picture.light, matte, picture.name)
        speed, velocity = entry.speed_px_per_s, entry.velocity_px_per_s
        words = "be left out beside `velocity_px_per_s`"
        is_one = speed is None or velocity is None
        require(is_one, "read_layers(speed_px_per_s=...)", words, speed)
        layers.append(Layer(picture, velocity or speed or 0.0, entry.left, entry.top))
    return Layers(tuple(layers), border=file.border)
