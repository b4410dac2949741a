"""The scene's photograph, captured and restored by each of several designs."""

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import NamedTuple

import numpy as np

from mishutter.camera.capture import kernel_layout
from mishutter.camera.noise import fixed_key
from mishutter.decoding.decoders.base import AbstractDecoder
from mishutter.decoding.decoders.linear import EnsembleDecoder, WienerDecoder
from mishutter.decoding.decoders.richardson_lucy import RichardsonLucyDecoder
from mishutter.decoding.decoders.speed_finding import ROWS_TO_FIND
from mishutter.decoding.photographs import RestoredPhotograph, least_columns, restore_by_each
from mishutter.decoding.restoration import photograph_by_frames
from mishutter.model.motion import AbstractMotion
from mishutter.model.scene import Scene
from mishutter.pictures.images import Picture, middle_rows, pixels_along, transposed
from mishutter.search.rows import Row

ENSEMBLE = "ensemble"


class Photographs(NamedTuple):
    """Results of restoring a photograph with several shutters."""

    # How well each of one exposure was restored, without the pictures; by decoder, then by shutter
    levels: Mapping[str, Mapping[str, RestoredPhotograph]]
    # By shutter what the ensemble filter restored, at a typical speed and the fastest; frames too,
    # by the speed that they tell
    shown: Mapping[str, RestoredPhotograph]


def shown_speeds(scene: Scene) -> list[float]:
    """The slowest, a typical and the fastest of the speeds that occur, by size; px/s.

    Half of all objects are at most as fast as the typical one. Of two speeds that differ in sign
    alone the positive one stands for both.
    """
    speeds, weights = (np.asarray(x, np.float64) for x in (scene.speeds, scene.weights))
    shares: dict[float, float] = {}
    for speed, weight in zip(np.abs(speeds).tolist(), weights.tolist(), strict=True):
        shares[speed] = shares.get(speed, 0.0) + weight
    sizes = sorted(size for size, share in shares.items() if share > 0)
    slower = np.cumsum([shares[size] for size in sizes])
    half = 0.5 * slower[-1] * (1 - 1e-6)  # sums of weights differ by rounding
    typical = sizes[int(np.argmax(slower >= half))]
    occurring = set((speeds[weights > 0] + 0.0).tolist())
    chosen = dict.fromkeys((sizes[0], typical, sizes[-1]))
    return [size if size in occurring else -size for size in chosen]


def photograph_of(
    scene: Scene, rows: Mapping[str, Row], *, note: Callable[[str], None]
) -> Picture | None:
    """The part of the scene's photograph that is captured; None if there is none.

    One that is too narrow for the kernels of some designs is left out, with a `note` that says so.
    """
    if scene.picture.path is None:
        return None
    finds = any(row.decoder.finds_speed or row.num_frames > 1 for row in rows.values())
    # Each row is blurred by itself: only to find the speed many are needed.
    count = ROWS_TO_FIND if finds else 160
    picture, axis = scene.picture.photograph(), scene.sensor.axis
    light = middle_rows(transposed(picture.light, axis), count)
    width = light.shape[1]
    enough = least_columns(longest_kernel(scene, _motions(rows)))
    if width >= enough:
        return Picture(light=transposed(light, axis), name=picture.name)
    note(
        f"{scene.picture.path}: {width} {pixels_along(axis)} are too few to be restored from this "
        f"blur; {enough} would do."
    )
    return None


def photographs(
    picture: Picture,
    scene: Scene,
    rows: Mapping[str, Row],
    num_seeds: int,
    *,
    every: bool = False,
    begin: Callable[[str], None],
    within: Callable[[str, float], None] = lambda name, share: None,
) -> Photographs:
    """A photograph captured and restored by every row's design.

    Each decoder knows of the speed as much as the one that judges the row. `begin` is called with
    the name of each row, and `within` with the share of it that is done.
    """
    chosen: dict[str, AbstractDecoder] = {ENSEMBLE: EnsembleDecoder()}
    if every:
        chosen |= {"Wiener": WienerDecoder(), "Richardson-Lucy": RichardsonLucyDecoder()}
    longest = longest_kernel(scene, _motions(rows))
    speeds = None if every else shown_speeds(scene)
    levels: dict[str, dict[str, RestoredPhotograph]] = {name: {} for name in chosen}
    shown: dict[str, RestoredPhotograph] = {}
    for name, row in rows.items():
        begin(name)
        if row.sequence is not None and not row.is_in_plane:
            moving = pictured_speeds(scene)
            shown[name] = photograph_by_frames(
                picture,
                scene,
                row.sequence,
                speeds=moving,
                key=fixed_key(),
                progress=partial(within, name),
            )
            continue
        results = restore_by_each(
            picture,
            scene,
            row.motion,
            row.shutter,
            chosen,
            speeds=speeds,
            num_seeds=num_seeds,
            least_taps=longest,
            decoder_speed=row.decoder.name,
        )
        tried = results[ENSEMBLE].speeds
        places = (int(np.argmin(np.abs(tried - speed))) for speed in pictured_speeds(scene))
        shown[name] = results[ENSEMBLE].at(*places)
        for decoder, result in results.items():
            levels[decoder][name] = result.without_pictures()
    return Photographs(levels, shown)


def _motions(rows: Mapping[str, Row]) -> list[AbstractMotion]:
    """Motions over all exposures of rows along an axis."""
    return [frame.motion for row in rows.values() for frame in row.exposures.along]


def pictured_speeds(scene: Scene) -> list[float]:
    """A typical speed and the fastest, once where they are one; px/s."""
    return shown_speeds(scene)[-2:]


def longest_kernel(scene: Scene, motions: Iterable[AbstractMotion]) -> int:
    """Most pixels that light falls over; pictures restored alike over as many share programs."""
    speeds = np.asarray(scene.speeds).tolist()
    return max(kernel_layout(motion, *speeds, 0.0)[0] for motion in motions)
