"""A photograph comes back as well as the table promises, captured by brute force.

The captures are made by sampling the exposure in time and know nothing of the package, so that a
mistake that capture, decoder and expectation share would show.
"""

import jax.numpy as jnp
import numpy as np
import pytest

import mishutter as ms
from benchmarks import photographs
from benchmarks.scenes import scenes

SNAPSHOT = ms.StillCamera(half_exposure=0.0008)
NUM_INSTANTS = 4000
WITHIN_DB = 0.15


NUM_SCENES = 5


@pytest.mark.slow
@pytest.mark.parametrize("index", range(NUM_SCENES))
def test_twelve_photographs_come_back_as_the_table_promises(index):
    """Each in one of five scenes, by the Hann window that is best there and by a snapshot.

    At 4,000 instants. All of them in every scene are `python -m benchmarks.photographs`.
    """
    scene = list(scenes().values())[index]
    window = ms.optimise(scene, scene.motion, ms.HannShutter(), free="half_exposure")
    for motion, shutter in ((window.motion, ms.HannShutter()), (SNAPSHOT, ms.RectShutter())):
        responses = photographs.sampled_responses(scene, motion, shutter, NUM_INSTANTS)
        for photograph in list(photographs.PHOTOGRAPHS)[index::NUM_SCENES]:
            rows = photographs.rows_of(photograph)
            promised, found = photographs.levels(rows, scene, motion, shutter, responses)
            assert abs(found - promised) < WITHIN_DB


def test_the_scene_of_rows_has_their_spectrum():
    """A wave of one frequency has all its power in the step that holds it."""
    rows = 0.5 + 0.1 * np.cos(2 * np.pi * 0.2 * np.arange(2 * photographs.COLUMNS))[None]
    seen = photographs.scene_of(rows, ms.Scene([0.0], photon_rate=1e5, read_noise=1.0))
    power = np.asarray(seen.picture.power_spectrum)
    assert abs((np.argmax(power) + 0.5) / (2 * power.size) - 0.2) < 1 / photographs.COLUMNS
    assert float(jnp.abs(seen.picture.deviation - 0.1 / np.sqrt(2))) < 1e-4
