"""An independent search finds no better design or coded still than the package's."""

import pytest

from benchmarks import independent
from mishutter import optimise


@pytest.mark.slow
@pytest.mark.parametrize("start", ["slow, one way", "no pan"])
def test_an_independent_search_finds_nothing_better(start):
    """With a few starts; more, and snapshots, are in `python -m benchmarks.independent`."""
    (scene,) = (scene for name, scene in independent.scenes().items() if name.startswith(start))
    design = optimise(scene)
    rows = {"optimised": design, "best coded still": design.straight}
    figures = independent.beside(scene, rows, num_screened=500, num_descents=4)
    for name, figure in figures.items():
        assert figure["tool"] >= figure["independent"] - independent.ALLOWED, name
        assert figure["anew"] == pytest.approx(figure["tool"], abs=independent.ALLOWED), name
