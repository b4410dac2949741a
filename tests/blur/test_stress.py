"""The losses over their whole domain: finite, and right wherever they are computed again."""

import pytest

from benchmarks import stress


@pytest.mark.slow
def test_random_scenes_and_designs_are_finite_and_right():
    """No value or slope is missing, and those computed by other means agree."""
    for row in stress.measure(count=2000, sample=20):
        assert row["not finite"] == 0
        assert row["re-checked"] >= 10
        assert row["worst value / bound"] < 1
        assert row["worst slope / bound"] < 1


@pytest.mark.slow
def test_random_integrals_are_finite_and_right():
    """The transfer function of a path that turns, and narrow Gaussians in single precision."""
    for row in stress.integrals(count=2000, sample=12):
        assert row["not finite"] == 0
        assert row["re-checked"] >= 10
        assert row["worst value / bound"] < 1
        assert row["worst slope / bound"] < 1
