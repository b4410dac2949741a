"""The statistics of pictures, and the photograph that they may be of."""

import os
from typing import final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from mishutter._core.checks import (
    RowLike,
    as_float,
    is_concrete,
    require,
    require_at_least,
    require_number,
    shape_of,
)
from mishutter._core.modules import AbstractModule
from mishutter.model.optics import NUM_FREQUENCIES, frequencies, on_steps
from mishutter.pictures.images import (
    Axis,
    Picture,
    checked_white,
    read_picture,
    row_power_spectrum,
    shipped_picture,
)

CORNER_FREQUENCY = 0.01
"""Corner of the spectrum that stands for a photograph where a scene brings none; cycles/px."""
EXAMPLE_PICTURE = "example"
"""The path of the photograph that scikit-image ships."""
PHOTOGRAPH = "photograph"
"""The kind of picture that the spectrum without a picture stands for."""
LIKE = {"print": "page.png", "cells": "ihc.png"}
"""Kinds of pictures other than photographs, by one of each that scikit-image ships: a page of a
book, and stained tissue under a microscope. Their names are paths, as that of the example is."""
SHIPPED = {EXAMPLE_PICTURE: "motorcycle_left.png"} | LIKE
"""Pictures that scikit-image ships, by their paths."""
_FINEST = 0.1
"""Share of a picture's contrast that its finest detail holds, by which `detail` is judged."""


@final
class Texture(AbstractModule):
    r"""Statistics of pictures in linear light, white = 1, and the photograph that they are of.

    Args:
        mean_level: Mean of the picture.
        deviation: Standard deviation of the picture.
        power_spectrum: Power of the picture's rows at the centres of $m$ equal steps of
            (0, 0.5) cycles/px, on any scale, above 0 somewhere unless the deviation is 0; the
            spectrum $1/(f^2 + 0.01^2)$ by default. Integrals take it in 256 steps, or in more
            where light spreads further, without a loss of power. Shape `(m,)`.
        path: Path of the photograph to show results on; None for none.
        white: The argument `white` of `read_picture`, which reads the photograph.
        linear: The argument `linear` of `read_picture`.

    Raises:
        ValueError: if a number is below 0 or not finite, the spectrum is no row with a value above
            0, or `path` or `linear` is of another kind.
    """

    mean_level: Array
    deviation: Array
    power_spectrum: Array | None
    path: str | None = eqx.field(static=True)
    white: float | None = eqx.field(static=True)
    linear: bool = eqx.field(static=True)

    def __init__(
        self,
        *,
        mean_level: ArrayLike = 0.25,
        deviation: ArrayLike = 0.2,
        power_spectrum: RowLike | None = None,
        path: str | os.PathLike[str] | None = None,
        white: ArrayLike | None = None,
        linear: bool = False,
    ):
        self.mean_level = as_float(mean_level, "Texture(mean_level=...)")
        self.deviation = as_float(deviation, "Texture(deviation=...)")
        self.power_spectrum = None
        if power_spectrum is not None:
            self.power_spectrum = as_float(power_spectrum, "Texture(power_spectrum=...)")
        self.path = os.fspath(path) if isinstance(path, os.PathLike) else path
        self.white = checked_white("Texture(white=...)", white)
        self.linear = linear

    def __check_init__(self) -> None:
        for name in ("mean_level", "deviation"):
            value = getattr(self, name)
            require_number(f"Texture({name}=...)", value, "at least 0")
        require(isinstance(self.path, str | None), "Texture(path=...)", "be a path", self.path)
        is_known = isinstance(self.linear, bool)
        require(is_known, "Texture(linear=...)", "be True or False", self.linear)
        subject, power = "Texture(power_spectrum=...)", self.power_spectrum
        if power is None:
            return
        one_row = power.ndim == 1 and power.size >= 1
        require(one_row, subject, "be one row of at least one value", shape_of(power))
        require_at_least(subject, power, "at least 0")
        if is_concrete(power) and is_concrete(self.deviation):
            some = bool(np.any(np.asarray(power) > 0)) or float(self.deviation) == 0
            require(some, subject, "hold some power where the deviation is not 0", 0.0)

    @staticmethod
    def of_photograph(
        picture: Picture,
        path: str | None = None,
        *,
        white: float | None = None,
        linear: bool = False,
        axis: Axis = "rows",
    ) -> "Texture":
        """The statistics of a photograph.

        Args:
            picture: The photograph.
            path: The place that it came from.
            white: The argument of `read_picture` that it was read with.
            linear: The argument of `read_picture` that it was read with.
            axis: The axis that things move along, along which its spectrum is.
        """
        spectrum = row_power_spectrum(picture.transposed(axis), NUM_FREQUENCIES)
        return Texture(
            mean_level=spectrum.mean_level,
            deviation=spectrum.deviation,
            power_spectrum=spectrum.power_spectrum,
            path=path,
            white=white,
            linear=linear,
        )

    @property
    def detail(self) -> float:
        """Period than which a tenth of the contrast, as power, is finer; px."""
        power = np.asarray(self.spectrum_on_grid(NUM_FREQUENCIES, np.dtype(float)))
        if not np.any(power > 0):
            return np.inf
        above = np.append(np.cumsum(power[::-1])[::-1], 0.0) / np.sum(power)
        edges = np.linspace(0, 0.5, NUM_FREQUENCIES + 1)
        return float(1 / np.interp(-_FINEST, -above, edges))

    def photograph(self) -> Picture:
        """The photograph, read from its file.

        Raises:
            OSError: if it cannot be read.
            ValueError: if there is none, or it is no picture.
        """
        require(self.path is not None, "Texture(path=...)", "name a photograph", self.path)
        return photograph_at(str(self.path), self.white, self.linear)

    def spectrum_on_grid(
        self, num_frequencies: int, dtype: np.dtype
    ) -> Float[Array | np.ndarray, "{num_frequencies}"]:
        """The power spectrum at `frequencies`, on any scale; by NumPy if concrete.

        Args:
            num_frequencies: Number of frequencies.
            dtype: Precision.
        """
        spectrum = self.power_spectrum
        if spectrum is None:
            return 1 / (frequencies(num_frequencies).astype(dtype) ** 2 + CORNER_FREQUENCY**2)
        space = np if is_concrete(spectrum) else jnp
        return on_steps(space.asarray(spectrum, dtype), num_frequencies)

    def without_metadata(self, power_spectrum: RowLike | None = None) -> "Texture":
        """The statistics without the photograph.

        Args:
            power_spectrum: Power in place of the texture's own.
        """
        return Texture(
            mean_level=self.mean_level,
            deviation=self.deviation,
            power_spectrum=self.power_spectrum if power_spectrum is None else power_spectrum,
        )


def photograph_at(path: str, white: float | None, linear: bool) -> Picture:
    """The photograph of a path, or one that scikit-image ships."""
    if path in SHIPPED:
        return shipped_picture(SHIPPED[path])
    return read_picture(path, white=white, linear=linear)
