"""Levels and losses that are the same in other units, and seen from another side."""

from typing import NamedTuple

import numpy as np
import pytest

from mishutter import (
    EvenVelocities,
    FreeMotion,
    Limits,
    ListedVelocities,
    Occlusion,
    Optics,
    PlaneFrames,
    Scene,
    TimedFrame,
    ceiling,
    exposures_psnr,
)
from mishutter.evaluation.ceilings import exposures_ceiling
from mishutter.evaluation.fans import Grid
from mishutter.evaluation.registration import loss_of_width, registration
from mishutter.model.sensor import Sensor
from mishutter.search.moving_frames import levels_of

COARSE = Grid(8, 4, 6, 2)
OPTICS = Optics(lens_blur=0.5)


class Case(NamedTuple):
    """A scene in the plane, and frames on a path: all by numbers that a change can reach."""

    velocities: np.ndarray  # of a list; or the half axes, angle and mean of an ellipse
    weights: np.ndarray | None  # of a list
    times: np.ndarray
    exposures: np.ndarray
    durations: np.ndarray
    path: np.ndarray
    rate: float = 6e4
    readout: float = 0.0
    width: float | None = None

    @property
    def scene(self):
        if self.weights is None:
            (along, across), (angle, _), mean = self.velocities
            law = EvenVelocities(along, across, angle=angle, mean=mean)
        else:
            law = ListedVelocities(self.velocities, self.weights)
        layers = None
        if self.width is not None:
            layers = Occlusion(front_share=0.3, object_width=self.width)
        return Scene.any_direction(
            law,
            photon_rate=self.rate,
            read_noise=5.0,
            optics=OPTICS,
            occlusion=layers,
            sensor=Sensor(readout=self.readout) if self.readout else Sensor(),
        )

    @property
    def frames(self):
        return PlaneFrames(self.times, self.exposures, self.durations, self.path)

    def in_time(self, unit):
        """In a unit of time that is so much shorter."""
        velocities = np.array(self.velocities) / unit
        if self.weights is None:
            velocities[1] = self.velocities[1]
        return self._replace(
            velocities=velocities,
            times=self.times * unit,
            exposures=self.exposures * unit,
            durations=self.durations * unit,
            path=self.path / unit,
            rate=self.rate / unit,
            readout=self.readout * unit,
        )

    def backwards(self):
        """The film run backwards."""
        return self._replace(
            times=-self.times[::-1],
            exposures=self.exposures[::-1],
            durations=self.durations[::-1],
            path=self.path[:, ::-1],
        )

    def swapped(self):
        """Rows for columns."""
        velocities = np.array(self.velocities)
        if self.weights is None:
            velocities[1, 0] = np.pi / 2 - velocities[1, 0]
            velocities[2] = velocities[2, ::-1]
        else:
            velocities = velocities[:, ::-1]
        return self._replace(velocities=velocities, path=self.path[::-1])

    def mirrored(self):
        """From the other side of the film."""
        velocities = np.array(self.velocities)
        if self.weights is None:
            velocities[1, 0] *= -1
            velocities[2, 0] *= -1
        else:
            velocities[:, 0] *= -1
        return self._replace(velocities=velocities, path=self.path * [[-1], [1]])


PATH = {
    "times": np.array([-0.011, 0.0, 0.0125]),
    "exposures": np.array([0.006, 0.0045, 0.009]),
    "durations": np.array([0.004, 0.008, 0.007, 0.012]),
    "path": np.array([[-700.0, -400.0, 900.0, -100.0, 350.0], [250, 600, -500, 300, -820]]),
}
ELLIPSE = np.array([[1300.0, 450.0], [0.4, 0.0], [150.0, -80.0]])
LIST = np.array([[900.0, -300.0], [0.0, 1100.0], [-250.0, 0.0]])
CASES = {
    "ellipse": Case(ELLIPSE, None, **PATH),
    "list": Case(LIST, np.array([0.5, 0.2, 0.3]), **PATH),
    "rows": Case(LIST, np.array([0.5, 0.2, 0.3]), **PATH, readout=0.004),
    "background": Case(ELLIPSE, None, **PATH, width=60.0),
}


@pytest.mark.parametrize("slug", CASES)
def test_nothing_depends_on_the_side_that_is_looked_from(slug):
    """Levels, ceilings and losses in another unit of time, mirrored, and of rows for columns."""

    def numbers(case, unit):
        scene, frames = case.scene, case.frames
        level = float(exposures_psnr(scene, frames)), exposures_ceiling(scene, case.exposures)
        # The velocities that stand for a law lie otherwise, and rows take their time.
        if case.weights is None or case.readout:
            return np.array(level)
        found = registration(scene, frames)
        loss = loss_of_width(scene, frames, width=110.0)
        # Those of the components change their places.
        deviation = np.sort(found.deviation * unit, axis=1)
        return np.concatenate([level, [loss], found.loss, deviation.ravel()])

    case = CASES[slug]
    own = numbers(case, 1.0)
    rounding = 1e-6 if slug == "list" else 1e-4
    # A lattice of frequencies is another one for a picture that is turned.
    for other, unit, most in (
        (case.in_time(8.0), 8.0, rounding),
        (case.backwards(), 1.0, rounding),
        (case.swapped(), 1.0, 2e-3),
        (case.mirrored(), 1.0, 2e-3),
    ):
        np.testing.assert_allclose(numbers(other, unit), own, rtol=most)


SPEEDS, WEIGHTS = np.array([-700.0, 1900.0, 150.0]), np.array([0.5, 0.1, 0.4])
MOTIONS = (
    ([3e4, -9e4], 0.0041, 100.0, -0.0105, 4.4),
    ([2e4], 0.003, 0.0, 0.0, 1.0),
    ([5e4], 0.0045, -80.0, 0.0112, 0.4),
)


def _on_axis(unit=1.0, sign=1, order=(0, 1, 2), layers=None):
    """Levels and losses of frames along an axis, in a unit of time and a direction."""
    order = list(order)
    scene = Scene(
        sign * SPEEDS[order] / unit,
        WEIGHTS[order],
        photon_rate=6e4 / unit,
        read_noise=5.0,
        optics=OPTICS,
        limits=Limits(max_half_exposure=0.006 * unit, max_top_speed=1e5 / unit),
        occlusion=layers,
    )
    frames = tuple(
        TimedFrame(
            FreeMotion(
                accelerations=sign * np.array(a) / unit**2,
                half_exposure=half * unit,
                velocity=sign * v / unit,
            ),
            time * unit,
            sign * place,
        )
        for a, half, v, time, place in MOTIONS
    )
    numbers = [float(exposures_psnr(scene, frames)), loss_of_width(scene, frames, width=110.0)]
    if layers is None:
        found = registration(scene, frames)
        place = np.argsort(sign * found.speeds)
        numbers += [*levels_of(scene, frames), float(ceiling(scene))]
        numbers += [*found.loss[place], *found.deviation[place] * unit]
    return numbers


@pytest.mark.parametrize(
    "layers", [None, Occlusion(front_share=0.3, object_width=60.0)], ids=["whole", "background"]
)
def test_nothing_along_an_axis_depends_on_the_side(layers):
    """In another unit of time, the other way round, and with the speeds in another order."""
    own = _on_axis(layers=layers)
    for other in ({"unit": 8.0}, {"sign": -1}, {"order": (2, 0, 1)}):
        np.testing.assert_allclose(_on_axis(**other, layers=layers), own, rtol=1e-6)
