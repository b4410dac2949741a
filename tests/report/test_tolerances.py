"""A comparison of a scene with tolerances is judged within them, and says what each costs."""

import equinox as eqx
import pytest
from support.designs import MOTION, SCENE

from mishutter import (
    Comparison,
    RectShutter,
    StillCamera,
    Tolerances,
    TukeyShutter,
    evaluate,
    tolerance_costs,
)

# A table of the terminal, whose folder's face is `main` alone; a command would search.
from mishutter.model.exposures import Exposures
from mishutter.search.rows import BEST_SNAPSHOT, OWN_BEST_MOTION, Row


def _within():
    loose = Tolerances(velocity=400.0, speed=100.0)
    return eqx.tree_at(lambda s: s.tolerances, SCENE, loose, is_leaf=lambda x: x is None)


@pytest.fixture(scope="module")
def comparison():
    scene = _within()
    still = StillCamera(half_exposure=1.3e-3)
    cameras = {"own": (MOTION, TukeyShutter(0.7)), BEST_SNAPSHOT: (still, RectShutter())}
    rows = [
        Row(
            OWN_BEST_MOTION,
            name,
            Exposures.of_one(motion, shutter),
            0.1,
            evaluate(scene, motion, shutter),
        )
        for name, (motion, shutter) in cameras.items()
    ]
    costs = tolerance_costs(scene, MOTION, rows[0].shutter)
    return Comparison(tuple(rows), "Build own.", 0.3, 40.0, costs=costs)


@pytest.mark.slow
def test_rows_are_judged_within_tolerances(comparison):
    """The level of a row is that within them; a row of a scene without has its expected PSNR."""
    row = comparison.row("own")
    assert row.level == float(row.metrics.toleranced_psnr) < float(row.metrics.expected_psnr)
    plain = Row(
        OWN_BEST_MOTION,
        "own",
        Exposures.of_one(MOTION, row.shutter),
        0.1,
        evaluate(SCENE, MOTION, row.shutter),
    )
    assert plain.level == float(plain.metrics.expected_psnr) == float(row.metrics.expected_psnr)


@pytest.mark.slow
def test_the_text_holds_both_levels_and_the_costs(comparison):
    """And so does the document for programs."""
    row, text = comparison.row("own"), comparison.text(verbose=True)
    for level in (row.level, float(row.metrics.expected_psnr)):
        assert f"{level:.2f}" in text
    assert comparison.costs.verdict in text
    document = comparison.to_dict()
    assert document["tolerance_costs"]["largest"] == "velocity"
    assert document["rows"][0]["metrics"]["toleranced_psnr"] == row.level
