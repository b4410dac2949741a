"""One or more instances of every final class, by a slug, and the reference of each shutter.

Parameters are none of them zero, one, equal or symmetric, unless the slug says so.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from mishutter import (
    RASKAR_CODE,
    AbstractShutter,
    ChippedShutter,
    FirstOrderDevice,
    FreeMotion,
    GaussianShutter,
    HannShutter,
    IdealDevice,
    LinearMotion,
    ParabolicMotion,
    RectShutter,
    SplineShutter,
    StillCamera,
    SwitchedDevice,
    TriangleShutter,
    TukeyShutter,
)
from support import reference


@dataclass(frozen=True)
class ShutterCase:
    """A shutter of given parameters, and the reference window of the same ones.

    Random points take its parameters from those `drawn`, where there is such a range.
    """

    parameters: np.ndarray
    make: Callable[[np.ndarray], AbstractShutter]
    window: Callable[[np.ndarray], reference.Window]
    drawn: tuple[float, float] | None = None

    def shutter(self, dtype=np.float64):
        return self.make(self.parameters.astype(dtype))

    def reference(self, dtype=np.float64):
        return self.window(self.parameters.astype(dtype))


def _fixed(make, window):
    return ShutterCase(np.zeros(0), lambda _: make(), lambda _: window())


def _single(value, make, window, **others):
    return ShutterCase(np.array(value), make, lambda p: window(p.item()), **others)


def _row(values, make, window):
    return ShutterCase(np.asarray(values, float), make, lambda p: window(p.tolist()))


def _profile(count):
    index = np.arange(count)
    return 0.5 + 0.45 * np.sin(1.7 * index + 0.3) * np.cos(0.4 * index)


def _mirrored(count):
    return lambda half: reference.spline([*half, *half[: count // 2][::-1]])


SHUTTERS = {
    "rect": _fixed(RectShutter, reference.rect),
    "hann": _fixed(HannShutter, reference.hann),
    "triangle": _fixed(TriangleShutter, reference.triangle),
    "gaussian": _single(0.37, GaussianShutter, reference.gaussian),
    # From narrower ones than may be asked for, so that there is something in hand.
    "gaussian-narrow": _single(0.0521, GaussianShutter, reference.gaussian, drawn=(0.03, 0.15)),
    "tukey": _single(0.43, TukeyShutter, reference.tukey),
    "tukey-steep": _single(0.0023, TukeyShutter, reference.tukey),
    "flutter": _row(RASKAR_CODE, ChippedShutter, reference.chips),
    "chips": _row(_profile(7), ChippedShutter, reference.chips),
    "one-open-chip": _row(np.eye(31)[22], ChippedShutter, reference.chips),
    "spline": _row(_profile(24), SplineShutter, reference.spline),
    # Of as many coefficients, so that programs of the two are one.
    "spline-closed-middle": _row(
        _profile(24) * (np.abs(np.arange(24) - 11.5) > 4), SplineShutter, reference.spline
    ),
    "spline-symmetric": _row(
        _profile(6),
        lambda p: SplineShutter(p, symmetric=True, num_coefficients=11),
        _mirrored(11),
    ),
}

QUICK = ["hann", "flutter", "spline"]
"""A smooth one, one of jumps and one of coefficients, which quick tests of digits are of."""

DEVICES = {
    "ideal": lambda: IdealDevice(transmission=0.83, leakage=0.07),
    "ideal-of-levels": lambda: IdealDevice(leakage=0.02, levels=5, num_slots=23),
    "first-order": lambda: FirstOrderDevice(
        rise_time=1.7e-3, fall_time=4.1e-3, transmission=0.9, leakage=0.03, num_slots=11
    ),
    "first-order-late": lambda: FirstOrderDevice(
        rise_time=2.9e-3, fall_time=1.3e-3, num_slots=13, delay=1.1e-3
    ),
    "first-order-of-levels": lambda: FirstOrderDevice(
        rise_time=0.4e-3, fall_time=0.7e-3, num_slots=19, levels=3
    ),
    "switched": lambda: SwitchedDevice(num_slots=29, min_open=2, min_closed=3, transmission=0.7),
}

MOTIONS = {
    "parabolic": lambda: ParabolicMotion(acceleration=310.0, half_exposure=0.31),
    "still": lambda: StillCamera(half_exposure=0.013),
    "pan": lambda: LinearMotion(half_exposure=0.013, velocity=70.0),
    "free": lambda: FreeMotion(
        accelerations=[410.0, 0.0, -130.0, 280.0],
        half_exposure=0.31,
        velocity=-12.0,
        durations=[1.0, 0.5, 0.0, 2.5],
    ),
}
