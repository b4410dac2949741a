"""Photographs of the page: checks of uploads, and restoration by some designs."""

import base64
import io
import tempfile
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from mishutter._core.checks import require
from mishutter.camera.capture import kernel_layout
from mishutter.decoding.decoders.linear import EnsembleDecoder
from mishutter.decoding.decoders.speed import estimate_speed
from mishutter.decoding.decoders.speed_finding import ROWS_TO_FIND
from mishutter.decoding.photographs import least_columns, restore_by_each
from mishutter.evaluation.speed_knowledge import knowledge_of
from mishutter.model.scene import Scene
from mishutter.model.texture import Texture
from mishutter.pictures.files import PICTURE_FORMATS, PICTURE_SUFFIXES, header_size
from mishutter.pictures.images import (
    Axis,
    Picture,
    middle_rows,
    pixels_along,
    read_picture,
    to_display,
    transposed,
)
from mishutter.search.rows import Row

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_BYTES = 32 << 20
MOST_PIXELS = 30_000_000


@dataclass(frozen=True)
class Photograph:
    """The middle of a photograph, and the spectrum of the whole."""

    part: Picture  # Rows from the middle, along which things move
    texture: Texture  # Statistics of the whole

    def restored(
        self,
        scene: Scene,
        rows: Mapping[str, Row],
        speed: float,  # px/s
        check: Callable[[], None],
    ) -> dict[str, object]:
        """Captures and restores it at one speed by each of some designs."""
        speeds = [*np.asarray(scene.speeds).tolist(), speed]
        longest = max(kernel_layout(row.motion, *speeds, 0.0)[0] for row in rows.values())
        least, columns = least_columns(longest), self.part.light.shape[1]
        pixels = pixels_along(scene.sensor.axis)
        requirement = f"have at least {least} {pixels}, to be restored from this blur"
        require(columns >= least, "the photograph", requirement, columns)
        width = min(columns, max(least, 400 + longest))
        first = (columns - width) // 2
        knowledge = knowledge_of(scene)
        # Extents of what is restored within a second.
        num_rows = ROWS_TO_FIND if knowledge.finds_speed else 112
        window = middle_rows(self.part.light, num_rows)[:, first : first + width]
        part = Picture(light=transposed(window, scene.sensor.axis).copy())
        designs, reference = [], None
        for name, row in rows.items():
            check()
            result = restore_by_each(
                part,
                scene,
                row.motion,
                row.shutter,
                {name: EnsembleDecoder()},
                speeds=[speed],
                num_seeds=1,
                least_taps=longest,
            )[name]
            reference, found = result.reference, None
            if knowledge.finds_speed:
                estimate = estimate_speed(result.captured[0], scene, row.motion, row.shutter)
                numbers = ("speed", "error", "trusted", "doubt", "tells_nothing")
                found = {number: getattr(estimate, number) for number in numbers}
            designs.append(
                {
                    "name": name,
                    "psnr": float(result.linear_psnr[0]),
                    "captured": _png(result.brightened(0)),
                    "restored": _png(result.restored[0]),
                    "aside": knowledge.aside,
                    "found": found,
                }
            )
        return {
            "speed": speed,
            "reference": None if reference is None else _png(reference),
            "designs": designs,
        }


Reader = Callable[[float | None, bool, Axis], Photograph]
"""Reads a photograph, by `white` and `linear` of `read_picture` and the axis of a scene."""


def reader(place: str, read: Callable[[float | None, bool], Picture]) -> Reader:
    """A reader of a photograph that remembers its last result."""

    @lru_cache(maxsize=1)
    def part_of(white: float | None, linear: bool, axis: Axis) -> Photograph:
        picture = read(white, linear)
        along = transposed(picture.light, axis)
        part = Picture(light=middle_rows(along, ROWS_TO_FIND).copy(), name=picture.name)
        texture = Texture.of_photograph(picture, place, white=white, linear=linear, axis=axis)
        return Photograph(part, texture)

    return part_of


def uploaded(name: str, content: bytes) -> Reader:
    """A reader of an uploaded photograph, which is checked as files are."""
    suffix = Path(name).suffix.lower()
    kinds = f"be a {PICTURE_FORMATS} file"
    require(suffix in PICTURE_SUFFIXES, "a photograph", kinds, name)
    size = f"at most {MOST_BYTES >> 20} MiB"
    require(0 < len(content) <= MOST_BYTES, "a photograph", f"hold {size}", len(content))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            columns, rows = header_size(content)
        except Exception as error:  # decoders raise many kinds
            raise ValueError(
                f"{name} must be a {PICTURE_FORMATS} picture; got: {type(error).__name__}."
            ) from None
    count = columns * rows
    require(count <= MOST_PIXELS, name, f"have at most {MOST_PIXELS:,} pixels", count)

    def read(white: float | None, linear: bool) -> Picture:
        with tempfile.TemporaryDirectory() as folder:
            place = Path(folder) / f"photograph{suffix}"
            place.write_bytes(content)
            try:
                return read_picture(place, white=white, linear=linear)
            except (ValueError, OSError) as error:
                raise ValueError(str(error).replace(str(place), name)) from None

    photograph = reader(name, read)
    photograph(None, False, "rows")
    return photograph


def png_of_figure(figure: "Figure") -> str:
    """A figure as PNG in base 64."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    return base64.b64encode(buffer.getvalue()).decode("ascii")


def _png(picture: Float[np.ndarray, "rows columns channels"]) -> str:
    """A picture as PNG in base 64."""
    from PIL import Image

    pixels = np.rint(to_display(picture) * 255).astype(np.uint8)
    pixels = pixels[..., 0] if pixels.shape[2] == 1 else pixels
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG", compress_level=1)
    return base64.b64encode(buffer.getvalue()).decode("ascii")
