"""The scene's photograph, captured and restored by each of several designs."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from mishutter.camera import kernel_layout
from mishutter.design import Row
from mishutter.model import EXAMPLE_PICTURE, Picture, Scene, example_picture, read_picture
from mishutter.restore import (
    AbstractDecoder,
    EnsembleDecoder,
    RestoredPhotograph,
    RichardsonLucyDecoder,
    WienerDecoder,
    least_columns,
    restore_by_each,
)

Update = Callable[[str], None]

ENSEMBLE = "ensemble"
_MAX_ROWS = 160
"""Rows of the photograph that are captured: rows are blurred one by one."""


class Photographs(NamedTuple):
    """What restoring a photograph showed of several shutters.

    Attributes:
        levels: How well each was restored, without the pictures; by decoder, then by shutter.
        shown: By shutter what the ensemble filter restored, at the fastest speed alone.
    """

    levels: Mapping[str, Mapping[str, RestoredPhotograph]]
    shown: Mapping[str, RestoredPhotograph]


def decoders() -> dict[str, AbstractDecoder]:
    """The decoders that a photograph is restored with, by name."""
    return {
        ENSEMBLE: EnsembleDecoder(),
        "Wiener": WienerDecoder(),
        "Richardson-Lucy": RichardsonLucyDecoder(),
    }


def photograph_of(
    scene: Scene, rows: Mapping[str, Row], *, note: Callable[[str], None]
) -> Picture | None:
    """What of the scene's photograph is captured; None if there is none.

    One that is too narrow for the kernels of some designs is left out, with a `note` that says so.
    """
    if scene.picture is None:
        return None
    picture = _middle_rows(scene_picture(scene.picture))
    width, enough = picture.light.shape[1], least_columns(_longest_kernel(scene, rows))
    if width >= enough:
        return picture
    blur = f"{width} columns are too few to be restored from this blur; {enough} would do"
    note(f"{scene.picture}: {blur}.")
    return None


def photographs(
    picture: Picture, scene: Scene, rows: Mapping[str, Row], num_seeds: int, *, update: Update
) -> Photographs:
    """A photograph captured and restored by every row's design and every decoder."""
    chosen, longest = decoders(), _longest_kernel(scene, rows)
    levels: dict[str, dict[str, RestoredPhotograph]] = {name: {} for name in chosen}
    shown: dict[str, RestoredPhotograph] = {}
    speeds = np.asarray(scene.speeds)
    fastest = int(np.lexsort((speeds, np.abs(speeds)))[-1])
    for name, row in rows.items():
        found = restore_by_each(
            picture,
            scene,
            row.motion,
            row.shutter,
            chosen,
            num_seeds=num_seeds,
            least_taps=longest,
        )
        update(name)
        shown[name] = found[ENSEMBLE].at(fastest)
        for decoder, result in found.items():
            levels[decoder][name] = result.without_pictures()
    return Photographs(levels, shown)


def _longest_kernel(scene: Scene, rows: Mapping[str, Row]) -> int:
    speeds = np.asarray(scene.speeds).tolist()
    return max(kernel_layout(row.motion, *speeds, 0.0)[0] for row in rows.values())


def scene_picture(place: str) -> Picture:
    """The photograph that a scene names.

    Raises:
        OSError: if it cannot be read.
        ValueError: if it is no picture.
    """
    return example_picture() if place == EXAMPLE_PICTURE else read_picture(place)


def _middle_rows(picture: Picture) -> Picture:
    first = max(0, (picture.light.shape[0] - _MAX_ROWS) // 2)
    return Picture(light=picture.light[first : first + _MAX_ROWS], name=picture.name)
