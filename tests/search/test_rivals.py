"""Rivals of a design: each at its own best motion, and the best of each purchase."""

import numpy as np
import pytest
from support.designs import MOTION, SCENE, SLOW, on_parabolas
from support.helpers import ROUNDING
from support.rows import made_up

from mishutter import (
    DesignLoss,
    ExpectedErrorLoss,
    HannShutter,
    Scene,
    optimise,
)
from mishutter.search import (
    BEST_SNAPSHOT,
    CODED_AT_REST,
    OWN_BEST_MOTION,
    SAME_MOTION,
    RivalSearch,
    best_of_each_purchase,
    compared_rows,
    is_finished,
    snapshots,
)


@pytest.mark.slow
def test_a_snapshot_pans_with_the_most_objects_of_a_range_about_rest():
    """The range is as wide to either side, and more of the objects move to one."""
    scene = Scene(
        [-4000.0, -3250.0, 2500.0, 3250.0, 4000.0],
        [0.05, 0.15, 0.3, 0.3, 0.2],
        photon_rate=6e4,
        read_noise=4.0,
        limits=SCENE.limits,
    )
    at_rest, panned = snapshots(RivalSearch(scene, ExpectedErrorLoss(), None))
    assert float(panned.motion.velocity) == pytest.approx(3000, abs=400)
    assert panned.level > at_rest.level + 0.2


@pytest.mark.slow
def test_designs_keep_or_start_from_their_own_motions():
    """A design that this loss found for this scene stays as it is; another is tuned."""
    loss, scene = ExpectedErrorLoss(), on_parabolas(SCENE)
    finished = optimise(scene, SLOW, HannShutter(), loss=loss, free="acceleration")
    elsewhere = scene.bare(weights=np.array([0.2, 0.3, 0.2, 0.2, 0.1]))
    other = optimise(elsewhere, MOTION, HannShutter(), loss=loss, free="half_exposure")
    names: list[str] = []
    search = RivalSearch(scene, loss)
    rows = compared_rows(search, MOTION, {"found": finished, "other": other}, names.append)
    row = {(row.name, row.reading): row for row in rows}
    same, tuned = row["found", OWN_BEST_MOTION], row["other", OWN_BEST_MOTION]
    assert {"found", "other", BEST_SNAPSHOT} <= set(names)
    assert is_finished(finished, scene, loss)
    assert not is_finished(finished, scene, DesignLoss())
    assert same.motion is finished.motion
    assert (same.loss, same.metrics) == (finished.loss, finished.metrics)
    assert tuned.motion is not other.motion
    assert tuned.loss <= float(loss(scene, other.motion, other.shutter)) * (1 + ROUNDING)
    assert row["other", SAME_MOTION].motion is MOTION


def test_more_never_brings_less():
    """Whoever has bought both may leave the shutter open, and one with a stage keep it at rest."""
    levels = {"a": 23.0, "Hann": 22.0, "rect": 23.5, CODED_AT_REST: 22.5, BEST_SNAPSHOT: 23.25}
    best = best_of_each_purchase(made_up(levels))
    brings = {takes: row.level for takes, row in best.items()}
    assert brings == {"nothing": 23.25, "a stage": 23.5, "a shutter": 23.25, "both": 23.5}
    assert best["both"].name == "rect"
