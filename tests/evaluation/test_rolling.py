"""The level of frames whose rows are exposed one after another, by the numbers of a reference.

The reference sums the transfer functions of 160 nodes for each of five rows, without this package.
"""

import numpy as np
import pytest
from support.rolling import PERIOD, frames_on_parabolas

from mishutter import Limits, PlaneFrames, Scene, Sensor, exposures_psnr
from mishutter.evaluation.registration import loss_of_width, registration

LIGHT = {"photon_rate": 1e5, "read_noise": 8.0}
SPEEDS = np.linspace(0, 4500, 4)


def of_readout(readout):
    """The scene behind a sensor of a readout time, s."""
    return Scene(SPEEDS, **LIGHT, sensor=Sensor(readout=readout))


@pytest.mark.parametrize(
    ("readout", "wanted"), [(0.0, 31.03), (0.005, 31.03), (0.01, 31.03), (0.02, 30.69)]
)
def test_the_level_is_the_mean_over_rows(readout, wanted):
    """Alternating parabolas hardly lose by rows that are known."""
    level = float(exposures_psnr(of_readout(readout), frames_on_parabolas()))
    assert level == pytest.approx(wanted, abs=0.02)


def test_the_way_in_which_rows_are_read_does_not_count():
    """The mean over the rows is the same from below."""
    up = Scene(SPEEDS, **LIGHT, sensor=Sensor(readout=0.02, rows_read="up"))
    wanted = exposures_psnr(of_readout(0.02), frames_on_parabolas())
    assert float(exposures_psnr(up, frames_on_parabolas())) == float(wanted)


def test_a_circle_loses_nothing():
    """Each row sees the same circle, turned; parabolas that alternate on one axis lose."""
    turn, pieces = 2 * np.pi / PERIOD, 96
    angle = np.linspace(0, turn * 4 * PERIOD, pieces + 1)
    velocities = 2500 * np.stack([-np.sin(angle), np.cos(angle)])
    middles, lasting = (np.arange(4) - 1.5) * PERIOD, np.full(pieces, 4 * PERIOD / pieces)
    circle = PlaneFrames(middles, np.full(4, PERIOD), lasting, velocities)
    scene, rolling = (
        Scene.any_direction(3000.0, **LIGHT, sensor=Sensor(readout=readout), limits=Limits())
        for readout in (0.0, 0.018)
    )
    level = float(exposures_psnr(scene, circle))
    assert float(exposures_psnr(rolling, circle)) == pytest.approx(level, abs=0.03)


def test_registration_and_borders_are_those_of_the_rows():
    """Rows that see less regular paths tell the slowest speed worse, and lose less at the ends."""
    together, rolling = of_readout(0.0), of_readout(0.02)
    deviations = [registration(x, frames_on_parabolas()).deviation for x in (together, rolling)]
    assert deviations[1][0] == pytest.approx(1.108 * deviations[0][0], rel=0.01)
    losses = [loss_of_width(x, frames_on_parabolas(), width=512) for x in (together, rolling)]
    assert losses == pytest.approx([0.3383, 0.3024], abs=2e-3)
