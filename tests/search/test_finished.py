"""Which designs a comparison takes as they are, and which bursts it takes."""

from dataclasses import replace

import pytest
from support.bursts import SEQUENCE, a_burst_design
from support.designs import SCENE
from support.drive import a_design

from mishutter import ExpectedErrorLoss, HannShutter, KnownSpeedLoss, Scene, WorstSpeedLoss
from mishutter.design.design import GIVEN as NO_LOSS
from mishutter.search.bursts import choose_burst

# Of the search of a whole comparison these are single steps.
from mishutter.search.rivals import is_finished
from mishutter.search.search import _beside_bursts

GIVEN = a_design(HannShutter()).with_one(loss_name=NO_LOSS)
SEARCHED = GIVEN.with_one(loss_name=repr(ExpectedErrorLoss()))
DIM = Scene.uniform(
    max_speed=2000.0, num_speeds=5, photon_rate=9e4, read_noise=10.0, limits=SCENE.limits
)


@pytest.mark.parametrize(
    ("design", "scene", "loss", "is_as_it_is"),
    [
        (SEARCHED, SCENE, ExpectedErrorLoss(), True),
        (SEARCHED, SCENE, WorstSpeedLoss(), False),
        (SEARCHED, SCENE, KnownSpeedLoss(), False),
        (SEARCHED, DIM, ExpectedErrorLoss(), False),
        (GIVEN, DIM, WorstSpeedLoss(), True),
    ],
)
def test_a_design_of_another_loss_or_scene_is_searched_anew(design, scene, loss, is_as_it_is):
    """The result of a search by this loss, and a camera that is given, stay as they are."""
    assert is_finished(design, scene, loss) == is_as_it_is


STILL = replace(
    SEQUENCE, frames=SEQUENCE.frames[:1] * 2, psnr=30.0, worst_psnr=27.5, width_loss=None
)
MOVING = replace(SEQUENCE, psnr=31.2, worst_psnr=26.25, width_loss=None)


def test_a_burst_is_taken_by_the_level_that_is_asked_for():
    """One that is better in the mean is worse at the worst speed, where that is asked for."""
    bursts, exposure = (STILL, MOVING), (1, 1)
    assert choose_burst(bursts) is MOVING
    assert choose_burst(bursts, at_worst=True) is STILL
    assert choose_burst(bursts, 30.5, exposure) is MOVING
    assert choose_burst(bursts, 31.15, exposure) is None
    assert choose_burst(bursts, 27.2, exposure, at_worst=True) is STILL
    assert choose_burst(bursts, 28.5, exposure, at_worst=True) is None
    assert choose_burst((), 0.0, exposure) is None


@pytest.mark.parametrize(("loss", "best"), [(KnownSpeedLoss(), MOVING), (WorstSpeedLoss(), STILL)])
def test_a_search_takes_the_burst_of_its_loss(loss, best, monkeypatch):
    """That of the worst speed asks for the level there."""
    design = a_burst_design(None)
    monkeypatch.setattr(type(design), "levels", property(lambda _: {"level": 20.0}))
    found = _beside_bursts(design, loss, (STILL, MOVING))
    assert found.sequence is best
    assert found.bursts == (STILL, MOVING)
