"""Objectives of the search by a plan are those with everything computed, on random scenes.

Losses and metrics are in `test_planning`, grids in `sweeps/test_plan`.
"""

import jax.numpy as jnp
import numpy as np
import pytest
from support.random_scenes import random_scene

import mishutter as ms
from mishutter.evaluation.needs import reduced

# A search's loss at one point; a design holds only that of its minimum.
from mishutter.search.objective import objective_of
from mishutter.search.planning import full_sizes, plan
from mishutter.search.space import FREE_NAMES, design_space

LOSSES = (ms.ExpectedErrorLoss(), ms.DesignLoss())
FREE = (("shutter",), ("acceleration", "half_exposure"), FREE_NAMES)
SEEDS = range(3, 15)
"""Random scenes are of twelve kinds, and these one of each."""


@pytest.mark.slow
def test_objectives_of_the_search():
    """At two points of each space the planned objective is the full one to 1e-12."""
    for seed in SEEDS:
        scene, motion, shutter = random_scene(seed)
        still = motion.is_straight
        names = [n for n in FREE[seed % 3] if not (still and n == "acceleration")]
        loss = LOSSES[seed // 6 % 2]
        space = design_space(scene, motion, shutter, names)
        planned = plan(scene, motion, shutter, loss=loss, free=names).sizes
        short = objective_of(loss, reduced(scene, planned), space, planned)
        everything = full_sizes(scene, space.motion, space)
        full = objective_of(loss, reduced(scene, everything), space, everything)
        for point in np.random.default_rng(seed).uniform(0.1, 0.9, (2, space.size)):
            found, wanted = (float(value(jnp.asarray(point))) for value in (short, full))
            assert found == pytest.approx(wanted, rel=1e-12), seed
