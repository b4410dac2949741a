"""Where objects lie on the sensor, by motions of every kind and by light beside it."""

import numpy as np
import pytest
from support.cases import MOTIONS

from mishutter import FreeMotion, ParabolicMotion
from mishutter.model import reach_of_parabola

SPEEDS = np.array([-61.0, 0.0, 23.0, 140.0])
TAU = np.linspace(-1, 1, 41)
HALF = 0.31


@pytest.mark.parametrize("motion", MOTIONS.values(), ids=MOTIONS)
def test_objects_move_against_the_path_of_the_sensor(motion):
    """`position_of` is $x(t) - s t$, and `aligned_position` that from the `alignment` on."""
    motion = motion()
    half = float(motion.half_exposure)
    path = motion.position(TAU * half) - SPEEDS[:, None] * TAU * half
    found = motion.position_of(TAU[None], SPEEDS[:, None])
    np.testing.assert_allclose(found, path, atol=1e-13 * np.max(np.abs(path)))
    aligned = motion.aligned_position(TAU[None], SPEEDS[:, None])
    wanted = path - motion.alignment(SPEEDS)[:, None]
    np.testing.assert_allclose(aligned, wanted, atol=1e-13 * np.max(np.abs(wanted)))


def test_a_path_of_one_acceleration_reaches_as_far_as_the_parabola():
    """Kernels, velocities, alignment and extent of speeds that the sensor keeps up with agree."""
    parabola = ParabolicMotion(acceleration=310.0, half_exposure=HALF)
    path = FreeMotion(accelerations=[310.0] * 3, half_exposure=HALF)
    slow = SPEEDS[:3]
    for one, other in (
        (parabola.reach(140.0), path.reach(140.0)),
        (parabola.side_by_side(slow), path.side_by_side(slow)),
    ):
        for number, wanted in zip(other, one, strict=True):
            np.testing.assert_allclose(number, wanted, rtol=1e-12, atol=1e-12)
    assert parabola.mirrors
    assert path.mirrors
    assert float(path.bend) == pytest.approx(float(parabola.bend), rel=1e-14)


@pytest.mark.parametrize(("sag", "smear"), [(0.0, 7.3), (3.1, 7.3), (3.1, 2.2)])
def test_light_reaches_as_far_as_the_fastest_object(sag, smear):
    """Over the whole exposure: to both sides of a sensor at rest, from the vertex of a parabola."""
    tau, speeds = np.linspace(-1, 1, 2001), np.linspace(-smear, smear, 201)[:, None]
    path = sag * tau**2 - speeds * tau
    places = path + (speeds**2 / (4 * sag) if sag else 0.0)
    travelled = np.max(places) if sag else np.max(np.ptp(places, axis=1))
    found = reach_of_parabola(np.asarray(sag), np.asarray(smear))
    assert float(found.length) == pytest.approx(travelled, rel=1e-9)
    assert float(found.velocity) == pytest.approx(np.max(np.abs(2 * sag * tau - speeds)))
