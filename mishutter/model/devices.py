r"""What a shutter is made with: the light that it loses when open, and passes when closed.

A profile $w(\tau)$ is a command. A device of transmission $t$ and leakage $\ell$ makes of it the
transmittance $t\,(\ell + (1 - \ell)\,w(\tau))$, which is what light sees. A shutter that stays
open over the exposure needs no device: the sensor's own exposure begins and ends it.
"""

from typing import final

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike

from mishutter._core import (
    DoubleWord,
    as_float,
    is_concrete,
    require,
    require_finite,
    require_scalar,
)
from mishutter.model.shutters import AbstractPiecewiseShutter, AbstractShutter, RectShutter
from mishutter.model.shutters.interpolated import SampledShutter, piecewise


@final
class IdealShutter(eqx.Module):
    r"""A device that follows every command, at its own loss of light.

    Args:
        transmission: Share of the light that passes where it is fully open, $t$.
        leakage: Share of that which passes where it is closed, $\ell$.

    Raises:
        ValueError: if `transmission` is not above 0 and at most 1, or `leakage` is not at least 0
            and below 1.
    """

    transmission: Array
    leakage: Array

    def __init__(self, *, transmission: ArrayLike = 1.0, leakage: ArrayLike = 0.0):
        self.transmission = as_float(transmission, "IdealShutter(transmission=...)")
        self.leakage = as_float(leakage, "IdealShutter(leakage=...)")

    def __check_init__(self) -> None:
        for name in ("transmission", "leakage"):
            require_scalar(f"IdealShutter({name}=...)", getattr(self, name))
            require_finite(f"IdealShutter({name}=...)", getattr(self, name))
        for name, requirement, holds in (
            ("transmission", "be above 0 and at most 1", lambda x: 0 < x <= 1),
            ("leakage", "be at least 0 and below 1", lambda x: 0 <= x < 1),
        ):
            value = getattr(self, name)
            if is_concrete(value):
                require(holds(float(value)), f"IdealShutter({name}=...)", requirement, value)

    def light(self, command: AbstractShutter, dtype: np.dtype) -> AbstractShutter:
        """The transmittance that light sees, in a precision; of an open shutter itself.

        Args:
            command: The profile that is sent, or what `light` has made of one, which stays.
            dtype: Precision of the device's numbers.
        """
        if isinstance(command, RectShutter | TransmittedShutter):
            return command
        transmission, leakage = (jnp.asarray(x, dtype) for x in (self.transmission, self.leakage))
        return TransmittedShutter(piecewise(command), transmission, leakage)


@final
class TransmittedShutter(AbstractPiecewiseShutter):
    r"""The transmittance $t\,(\ell + (1 - \ell)\,w(\tau))$ of a profile sent to a device.

    Args:
        profile: The profile $w$.
        transmission: $t$.
        leakage: $\ell$.
    """

    profile: AbstractPiecewiseShutter
    transmission: Array
    leakage: Array

    def __init__(self, profile: AbstractPiecewiseShutter, transmission: Array, leakage: Array):
        self.profile, self.transmission, self.leakage = profile, transmission, leakage

    @property
    def command(self) -> AbstractShutter:
        """The profile, as it was given."""
        profile = self.profile
        return profile.shutter if isinstance(profile, SampledShutter) else profile

    @property
    def panels_per_piece(self) -> int:
        return self.profile.panels_per_piece

    @property
    def smooth_length(self) -> float | Array:
        return self.profile.smooth_length

    @property
    def equal_pieces(self) -> bool:
        return self.profile.equal_pieces

    @property
    def symmetric(self) -> bool:
        return self.profile.symmetric

    def transmittance(self, tau: ArrayLike) -> Array:
        light = self._passed(self.profile.transmittance(tau))
        return jnp.where(jnp.abs(jnp.asarray(tau)) <= 1, light, jnp.zeros_like(light))

    def dtype(self) -> np.dtype | None:
        own = self.profile.dtype()
        return np.dtype(self.leakage.dtype) if own is None else own

    def breakpoints(self, dtype: np.dtype) -> DoubleWord:
        return self.profile.breakpoints(dtype)

    def piece_transmittance(self, offset: Array) -> Array:
        return self._passed(self.profile.piece_transmittance(offset))

    def piece_mean(self, piece: Array, from_left: Array, distance: Array, width: Array) -> Array:
        return self._passed(self.profile.piece_mean(piece, from_left, distance, width))

    def _passed(self, opened: Array) -> Array:
        if not jnp.issubdtype(opened.dtype, jnp.inexact):  # open and closed as 1 and 0
            opened = opened.astype(self.leakage.dtype)
        t, leakage = (x.astype(opened.dtype) for x in (self.transmission, self.leakage))
        return t * (leakage + (1 - leakage) * opened)


def command_of(shutter: AbstractShutter) -> AbstractShutter:
    """The profile that is sent to a device to make a transmittance; itself without a device."""
    return shutter.command if isinstance(shutter, TransmittedShutter) else shutter
