"""Errors of the numbers of a scene that were measured."""

from dataclasses import fields
from typing import final

from jaxtyping import Array, ArrayLike

from mishutter._core.checks import as_float, require_number
from mishutter._core.modules import AbstractModule


@final
class MeasurementErrors(AbstractModule):
    """Standard deviations of measured numbers of a scene, which are independent of each other.

    Designs are for the numbers themselves; how far the gain of the best option moves within two
    of these is part of the answer. `Tolerances`, in contrast, are of a camera as it is built.

    Args:
        photon_rate: Error of the photo-electrons a second at a white pixel; e-/s.
        read_noise: Error of the read noise; e-.
        speed: Error of the fastest speed; all speeds are off by the same share; px/s.
        front_share: Error of the share of the picture that objects cover; 1.

    Raises:
        ValueError: if one is no finite scalar of at least 0.
    """

    photon_rate: Array
    read_noise: Array
    speed: Array
    front_share: Array

    def __init__(
        self,
        *,
        photon_rate: ArrayLike = 0.0,
        read_noise: ArrayLike = 0.0,
        speed: ArrayLike = 0.0,
        front_share: ArrayLike = 0.0,
    ):
        self.photon_rate = as_float(photon_rate, "MeasurementErrors(photon_rate=...)")
        self.read_noise = as_float(read_noise, "MeasurementErrors(read_noise=...)")
        self.speed = as_float(speed, "MeasurementErrors(speed=...)")
        self.front_share = as_float(front_share, "MeasurementErrors(front_share=...)")

    def __check_init__(self) -> None:
        for field in fields(self):
            subject, value = f"MeasurementErrors({field.name}=...)", getattr(self, field.name)
            require_number(subject, value, "at least 0")
