"""Photographs of the page: what may be uploaded, and how some designs restore it."""

import base64
import io
import tempfile
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from mishutter._core import require
from mishutter.camera import kernel_layout
from mishutter.model import (
    PICTURE_FORMATS,
    PICTURE_SUFFIXES,
    Axis,
    Picture,
    Scene,
    picture_arguments,
    pixels_along,
    read_picture,
    to_display,
    turned,
)
from mishutter.restore import (
    ROWS_TO_FIND,
    EnsembleDecoder,
    SpeedEstimate,
    estimate_speed,
    least_columns,
    restore_by_each,
)
from mishutter.search import Row

MOST_BYTES = 32 << 20
MOST_PIXELS = 30_000_000
_ROWS, _COLUMNS = 112, 400
"""Of the part that is captured: as much as is restored in a second."""


@dataclass(frozen=True)
class Photograph:
    """A part of a photograph, and what the whole says of the detail that there is to restore.

    Attributes:
        part: Rows from the middle, along which things move.
        arguments: Arguments of `Scene`.
    """

    part: Picture
    arguments: Mapping[str, Any]


Reader = Callable[[float | None, bool, Axis], Photograph]
"""A photograph by the arguments `white` and `linear` of `read_picture`, and a scene's axis."""


def reader(place: str, read: Callable[[float | None, bool], Picture]) -> Reader:
    """A photograph by the name that a scene file has for it; one that was just read is kept."""

    @lru_cache(maxsize=1)
    def taken(white: float | None, linear: bool, axis: Axis) -> Photograph:
        picture = read(white, linear)
        along = turned(picture.light, axis)
        part = Picture(light=_middle(along, ROWS_TO_FIND).copy(), name=picture.name)
        return Photograph(part, picture_arguments(place, picture, white, linear, axis))

    return taken


def _middle(light: np.ndarray, count: int) -> np.ndarray:
    """At most so many rows, from the middle."""
    first = max(0, (light.shape[0] - count) // 2)
    return light[first : first + count]


def uploaded(name: str, content: bytes) -> Reader:
    """A photograph from the bytes of a file, checked as files are.

    Raises:
        ValueError: if it is no picture that is read, damaged or too large.
    """
    suffix = Path(name).suffix.lower()
    kinds = f"be a {PICTURE_FORMATS} file"
    require(suffix in PICTURE_SUFFIXES, "a photograph", kinds, name)
    size = f"at most {MOST_BYTES >> 20} MiB"
    require(0 < len(content) <= MOST_BYTES, "a photograph", f"hold {size}", len(content))
    _require_few_pixels(name, content)

    def read(white: float | None, linear: bool) -> Picture:
        with tempfile.TemporaryDirectory() as folder:
            place = Path(folder) / f"photograph{suffix}"
            place.write_bytes(content)
            try:
                return read_picture(place, white=white, linear=linear)
            except (ValueError, OSError) as error:
                raise ValueError(str(error).replace(str(place), name)) from None

    found = reader(name, read)
    found(None, False, "rows")
    return found


def _require_few_pixels(name: str, content: bytes) -> None:
    """Refuse a picture by its header, before it is decoded."""
    from PIL import Image

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            with Image.open(io.BytesIO(content)) as file:
                count = file.width * file.height
        except Exception as error:  # of many kinds, by what is damaged
            raise ValueError(
                f"{name} must be a {PICTURE_FORMATS} picture; got: {type(error).__name__}."
            ) from None
    require(count <= MOST_PIXELS, name, f"have at most {MOST_PIXELS:,} pixels", count)


def restored(
    taken: Photograph,
    scene: Scene,
    rows: Mapping[str, Row],
    speed: float,
    check: Callable[[], None],
) -> dict[str, Any]:
    """A photograph captured and restored by each of some designs at one speed.

    Args:
        taken: The photograph.
        scene: Light and noise, and the speeds that the decoder may know.
        rows: The designs by name.
        speed: Speed of the object; px/s.
        check: Called before each design; it raises where nobody waits any longer.

    Returns:
        The `reference`, and for each design what was `captured` and `restored`, as PNG in base 64,
        with its `psnr` in linear light, dB, and what the scene's decoder `knows` of the speed;
        where it finds it also the one that it `found`, with the fields of a `SpeedEstimate` that
        are no arrays, otherwise None.

    Raises:
        ValueError: if the photograph is too narrow for the blur.
    """
    seen = [*np.asarray(scene.speeds).tolist(), speed]
    longest = max(kernel_layout(row.motion, *seen, 0.0)[0] for row in rows.values())
    enough, there = least_columns(longest), taken.part.light.shape[1]
    pixels = pixels_along(scene.axis)
    requirement = f"have at least {enough} {pixels}, to be restored from this blur"
    require(there >= enough, "the photograph", requirement, there)
    width = min(there, max(enough, _COLUMNS + longest))
    first = (there - width) // 2
    finds = scene.decoder_speed == "found"
    num_rows = ROWS_TO_FIND if finds else _ROWS
    part = Picture(light=_middle(taken.part.light, num_rows)[:, first : first + width].copy())
    along, found, reference = scene.along_rows(), [], None
    for name, row in rows.items():
        check()
        result = restore_by_each(
            part,
            along,
            row.motion,
            row.shutter,
            {name: EnsembleDecoder()},
            speeds=[speed],
            num_seeds=1,
            least_taps=longest,
        )[name]
        captured = result.captured[0]
        gain = np.mean(result.reference) / max(float(np.mean(captured)), 1e-12)
        reference = turned(result.reference, scene.axis)
        level = float(result.linear_psnr[0])
        pictures = {"captured": captured * gain, "restored": result.restored[0]}
        pair = {which: _png(turned(light, scene.axis)) for which, light in pictures.items()}
        estimate = estimate_speed(captured, along, row.motion, row.shutter) if finds else None
        known = {"knows": scene.decoder_speed, "found": _plain(estimate)}
        found.append({"name": name, "psnr": level, **pair, **known})
    return {
        "speed": speed,
        "reference": None if reference is None else _png(reference),
        "designs": found,
    }


def _plain(estimate: SpeedEstimate | None) -> dict[str, Any] | None:
    """The fields of an estimate that are no arrays; px/s."""
    names = ("speed", "error", "trusted", "doubt")
    return None if estimate is None else {name: getattr(estimate, name) for name in names}


def _png(light: np.ndarray) -> str:
    from PIL import Image

    pixels = np.rint(to_display(light) * 255).astype(np.uint8)
    pixels = pixels[..., 0] if pixels.shape[2] == 1 else pixels
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, "PNG", compress_level=1)
    return base64.b64encode(buffer.getvalue()).decode("ascii")
