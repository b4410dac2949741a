"""The range of a gain within the errors of the measured numbers of a scene."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import ArrayLike

from mishutter.evaluation.levels import exposures_psnr
from mishutter.evaluation.metrics import evaluate
from mishutter.model.scene import Scene
from mishutter.search.rows import Row


def gain_range(scene: Scene, choice: Row, other: Row) -> tuple[float, float] | None:
    """The least and greatest gain of a row over another within two errors of each number; dB.

    Both cameras stay as they are, and the decoder knows what the scene is: designs for the other
    scene differ by the square of the errors. Shifts by independent errors add up by their squares.
    """
    if scene.errors is None or choice is other:
        return None
    gain = choice.margin_over(other)

    def shift(where: Scene) -> float:
        return _moved(scene, where, choice) - _moved(scene, where, other)

    shifts = np.array([[shift(end) for end in ends] for ends in _ends(scene)]).reshape(-1, 2)
    down = np.sqrt(np.sum(np.minimum(shifts.min(axis=1), 0) ** 2))
    up = np.sqrt(np.sum(np.maximum(shifts.max(axis=1), 0) ** 2))
    return float(gain - down), float(gain + up)


def _moved(scene: Scene, where: Scene, row: Row) -> float:
    """Level of a row in another scene, less that in its own; dB."""
    if row.sequence is not None:
        own, moved = (float(exposures_psnr(each, row.sequence)) for each in (scene, where))
        return moved - own
    return replace(row, metrics=evaluate(where, row.motion, row.shutter)).level - row.level


def _ends(scene: Scene) -> Iterator[list[Scene]]:
    """The scene at either end of each number that has an error."""
    errors = scene.errors
    if errors is None:
        return

    def around(value: ArrayLike, error: ArrayLike, least: float) -> list[np.ndarray]:
        """Two standard deviations to either side, but no less than a share of the number."""
        middle, step = np.asarray(value), np.asarray(error)
        return [np.asarray(np.maximum(middle + k * step, least * middle)) for k in (-2.0, 2.0)]

    if errors.photon_rate > 0:
        rates = around(scene.photon_rate, errors.photon_rate, 0.05)
        yield [replace(scene, photon_rate=rate) for rate in rates]
    if errors.read_noise > 0:
        noises = around(scene.read_noise, errors.read_noise, 0.0)
        yield [replace(scene, read_noise=noise) for noise in noises]
    fastest = float(scene.max_speed)
    if errors.speed > 0 and fastest > 0:
        shares = around(1.0, float(errors.speed) / fastest, 0.0)
        yield [replace(scene, speeds=np.asarray(scene.speeds) * float(s)) for s in shares]
    layers = scene.occlusion
    if errors.front_share > 0 and layers is not None:
        shares = around(layers.front_share, errors.front_share, 0.0)
        covered = [replace(layers, front_share=np.minimum(share, 1)) for share in shares]
        yield [replace(scene, occlusion=each) for each in covered]
