r"""Devices of shutters: each turns a command into a transmittance.

A profile $w(\tau)$ is a command. The electronics of a device send it as it is, or the mean of each
of equal slots of the exposure, which they hold, at one of the levels that the device has. It
follows at once, or as a first-order system, whose state $x$ approaches the level by a time
constant of its own where it rises and where it falls. The sensor or the light source begins and
ends the exposure. The device may therefore stand at its first level before, and is assumed to have
settled there, which takes `settling_time`. A shutter that has to begin and end the exposure itself
starts dark and closes late; no device here models that. A device of transmission $t$ and leakage
$\ell$ turns the state into the transmittance $t\,(\ell + (1 - \ell)\,x(\tau))$.

A shutter that stays open over the whole exposure needs no device and loses nothing, whatever its
class; every other one is seen through the device (`AbstractDevice.light`). The value decides, also
where it is traced, so that a profile gains the whole loss of the device at once where it comes to
stay open. A search has no such step: it compares profiles `behind` the device, open ones included,
and only the design that it ends with is looked at again.
"""

from abc import abstractmethod
from collections.abc import Collection
from typing import ClassVar, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float, Inexact, Num

from mishutter._core.checks import (
    all_concrete,
    as_float,
    is_concrete,
    require,
    require_number,
    require_positive_int,
)
from mishutter._core.compiling import outside_trace
from mishutter._core.modules import AbstractModule
from mishutter.model.lagged import lagged
from mishutter.model.shutters.base import (
    AbstractPiecewiseShutter,
    AbstractShutter,
    Cells,
    Offsets,
    Pieces,
    SampledShutter,
    Sides,
    Values,
    piecewise,
    within_exposure,
)
from mishutter.model.shutters.chips import ChippedShutter
from mishutter.model.slots import diffused, slot_means

NUM_SLOTS = 128
"""Slots of a device that has levels and none given."""
_TEN_TO_NINETY = float(np.log(9.0))
"""Time from 10 to 90 % of a first-order system, in time constants."""


class AbstractDevice(AbstractModule):
    """A device that turns a command into a transmittance."""

    transmission: eqx.AbstractVar[Array]
    leakage: eqx.AbstractVar[Array]

    num_slots: eqx.AbstractVar[int | None]
    """Equal slots over each of which a level is held; None where a command is sent as it is."""

    levels: eqx.AbstractVar[int | None]
    """Levels that a slot may take, in equal steps from 0 to 1; None where it may take any."""

    min_open: eqx.AbstractVar[int]
    """Fewest slots in a row that are open, of a device of two levels."""

    min_closed: eqx.AbstractVar[int]
    """Fewest slots in a row that are closed."""

    lags: eqx.AbstractClassVar[bool]
    """Whether the light depends on how long the exposure is."""

    lag_words: eqx.AbstractVar[str]
    """A sentence on how late the device follows; empty where it follows at once."""

    is_linear: eqx.AbstractVar[bool]
    """Whether the light is known to be linear in the command, up to what leaks."""

    settling_time: eqx.AbstractVar[float | Array]
    """Time for which the first level must be held before the exposure; s."""

    def __check_init__(self) -> None:
        kind, bound = type(self).__name__, "above 0 and at most 1"
        require_number(f"{kind}(transmission=...)", self.transmission, bound, strict=True, most=1.0)
        below_one, bound = np.nextafter(1.0, 0.0), "at least 0 and below 1"
        require_number(f"{kind}(leakage=...)", self.leakage, bound, most=below_one)

    @staticmethod
    @abstractmethod
    def has(arguments: Collection[str]) -> bool:
        """Whether the arguments of a file, by their names, are those of this kind of device."""

    @property
    @abstractmethod
    def relaxed(self) -> "AbstractDevice":
        """The same device without levels; its transmittance has derivatives by the command."""

    @abstractmethod
    def made(
        self, command: AbstractShutter, half_exposure: ArrayLike, dtype: np.dtype
    ) -> "TransmittedShutter":
        """The transmittance made of a profile that is sent over twice a half exposure, s."""

    def behind(
        self, command: AbstractShutter, half_exposure: ArrayLike, dtype: np.dtype
    ) -> "TransmittedShutter":
        """The transmittance `made`, also of an open profile; one that the device has made stays."""
        if isinstance(command, TransmittedShutter):
            return command
        return self.made(command, half_exposure, dtype)

    def light(
        self, command: AbstractShutter, half_exposure: ArrayLike, dtype: np.dtype
    ) -> AbstractShutter:
        """The transmittance that light sees: that of a profile that `stays_open`, or `behind`."""
        if isinstance(command, TransmittedShutter):
            return command
        if all_concrete(command):
            return command if stays_open(command) else self.behind(command, half_exposure, dtype)
        seen = self.behind(command, half_exposure, dtype)
        # Behind a device that loses nothing an open profile is as bright as without one.
        transmission = jnp.where(stays_open(command), jnp.ones((), dtype), seen.transmission)
        return TransmittedShutter(seen.profile, transmission, seen.leakage, seen.sent)

    @property
    def follows_at_once(self) -> bool:
        """Whether the light at any time is that of the command at that time."""
        return not self.lags and self.num_slots is None

    @property
    def without_lag(self) -> "IdealDevice":
        """A device of the same losses that follows every command."""
        return IdealDevice(transmission=self.transmission, leakage=self.leakage)

    def passed(
        self, profile: AbstractPiecewiseShutter, dtype: np.dtype, sent: AbstractShutter | None
    ) -> "TransmittedShutter":
        """The transmittance of a profile that the device follows, where another may be `sent`."""
        transmission, leakage = (jnp.asarray(x, dtype) for x in (self.transmission, self.leakage))
        return TransmittedShutter(profile, transmission, leakage, sent)

    def slots(self, command: AbstractShutter, dtype: np.dtype) -> Float[Array, "n"]:
        """Level that is held over each slot of a profile that is sent; shape `(num_slots,)`."""
        means = slot_means(command, self.num_slots or NUM_SLOTS, dtype)
        if self.levels is None:
            return means
        return diffused(means, self.levels, self.min_open, self.min_closed)


def stays_open(shutter: AbstractShutter) -> Bool[Array, ""] | bool:
    """Whether a shutter passes all light, to rounding, as a mean transmittance of 1 says."""
    if not all_concrete(shutter):
        return _passes_all(shutter)
    with outside_trace():
        return bool(_passes_all(shutter))


def _passes_all(shutter: AbstractShutter) -> Bool[Array, ""]:
    efficiency = jax.lax.stop_gradient(shutter.efficiency())
    return efficiency >= least_efficiency(efficiency.dtype)


def least_efficiency(dtype: np.dtype) -> np.floating:
    """Throughput of a shutter that stays open, computed in a precision: 1 but for 64 roundings."""
    return 1 - 64 * np.finfo(dtype).eps


@final
class IdealDevice(AbstractDevice):
    r"""A device that follows every command, at its own loss of light.

    Args:
        transmission: Share of the light that passes where it is fully open, $t$.
        leakage: Share of that which passes where it is closed, $\ell$.
        levels: Levels that it has, in equal steps, at least 2; any by default.
        num_slots: Equal slots over each of which a level is held; 128 where it has `levels`,
            none by default.

    Raises:
        ValueError: if `transmission` is not above 0 and at most 1, or `leakage` is not at least 0
            and below 1, or a count is out of its range.
    """

    transmission: Array
    leakage: Array
    levels: int | None = eqx.field(static=True)
    num_slots: int | None = eqx.field(static=True)
    min_open: ClassVar[int] = 1
    min_closed: ClassVar[int] = 1
    lags: ClassVar[bool] = False
    lag_words: ClassVar[str] = ""
    settling_time: ClassVar[float] = 0.0

    def __init__(
        self,
        *,
        transmission: ArrayLike = 1.0,
        leakage: ArrayLike = 0.0,
        levels: int | None = None,
        num_slots: int | None = None,
    ):
        self.transmission = as_float(transmission, "IdealDevice(transmission=...)")
        self.leakage = as_float(leakage, "IdealDevice(leakage=...)")
        self.levels = _levels(levels, "IdealDevice")
        default = None if levels is None else NUM_SLOTS
        self.num_slots = default if num_slots is None else _slots(num_slots, "IdealDevice")

    @staticmethod
    def has(arguments: Collection[str]) -> bool:
        return True

    @property
    def is_linear(self) -> bool:
        return self.levels is None

    @property
    def relaxed(self) -> "IdealDevice":
        return self.without_lag

    def made(
        self, command: AbstractShutter, half_exposure: ArrayLike, dtype: np.dtype
    ) -> "TransmittedShutter":
        if self.num_slots is None:
            return self.passed(piecewise(command), dtype, None)
        chips = ChippedShutter(self.slots(command, dtype))
        return self.passed(chips, dtype, command if self.levels is None else None)


@final
class FirstOrderDevice(AbstractDevice):
    r"""A device that opens and closes gradually, as liquid crystals do.

    In a slot of level $c$ its state follows $\dot x = (c - x)/\theta$, with $\theta = t/\ln 9$ of
    the rise time $t$ where $c > x$ and of the fall time elsewhere: exactly, by exponentials. At the
    beginning of the exposure the state is the first level: the device must hold that for
    `settling_time` before, which is the delay plus the time until a thousandth of a step remains.
    A device that was closed until then starts dark, and has another transmittance.

    A smooth command is sent as the mean of each slot. With 64 slots a design of the built-in scene
    loses less than 0.01 dB by that.

    Args:
        rise_time: Time from 10 to 90 % after a step up; s, at least 0.
        fall_time: Time from 90 to 10 % after a step down; s, at least 0.
        transmission: Share of the light that passes where it is fully open, $t$.
        leakage: Share of that which passes where it is closed, $\ell$.
        levels: Levels that a slot may take, in equal steps, at least 2; any by default.
        num_slots: Equal slots of the exposure over each of which a level is held.
        delay: Time by which the device follows late; s, at least 0.

    Raises:
        ValueError: as `IdealDevice`, or if a time is not at least 0.
    """

    rise_time: Array
    fall_time: Array
    transmission: Array
    leakage: Array
    delay: Array | None
    levels: int | None = eqx.field(static=True)
    num_slots: int | None = eqx.field(static=True)
    min_open: ClassVar[int] = 1
    min_closed: ClassVar[int] = 1
    lags: ClassVar[bool] = True

    def __init__(
        self,
        *,
        rise_time: ArrayLike,
        fall_time: ArrayLike,
        transmission: ArrayLike = 1.0,
        leakage: ArrayLike = 0.0,
        levels: int | None = None,
        num_slots: int = 64,
        delay: ArrayLike | None = None,
    ):
        self.rise_time = as_float(rise_time, "FirstOrderDevice(rise_time=...)")
        self.fall_time = as_float(fall_time, "FirstOrderDevice(fall_time=...)")
        self.transmission = as_float(transmission, "FirstOrderDevice(transmission=...)")
        self.leakage = as_float(leakage, "FirstOrderDevice(leakage=...)")
        self.levels = _levels(levels, "FirstOrderDevice")
        self.num_slots = _slots(num_slots, "FirstOrderDevice")
        none = delay is None or (is_concrete(delay) and np.ndim(delay) == 0 and delay == 0)
        self.delay = None if none else as_float(delay, "FirstOrderDevice(delay=...)")  # type: ignore[arg-type]

    def __check_init__(self) -> None:
        for name in ("rise_time", "fall_time", "delay"):
            value, subject = getattr(self, name), f"FirstOrderDevice({name}=...)"
            if value is not None:
                require_number(subject, value, "at least 0")

    @staticmethod
    def has(arguments: Collection[str]) -> bool:
        return not {"rise_time", "fall_time"}.isdisjoint(arguments)

    @property
    def lag_words(self) -> str:
        rise, fall = (float(x) * 1e3 for x in (self.rise_time, self.fall_time))
        late = "" if self.delay is None else f", {float(self.delay) * 1e3:.3g} ms late"
        return f"It rises from 10 to 90 % in {rise:.3g} ms and falls in {fall:.3g} ms{late}."

    @property
    def is_linear(self) -> bool:
        times = self.rise_time, self.fall_time
        are_concrete = all(is_concrete(time) for time in times)
        return self.levels is None and are_concrete and float(times[0]) == float(times[1])

    @property
    def relaxed(self) -> "FirstOrderDevice":
        return FirstOrderDevice(
            rise_time=self.rise_time,
            fall_time=self.fall_time,
            transmission=self.transmission,
            leakage=self.leakage,
            num_slots=self.num_slots,  # type: ignore[arg-type]
            delay=self.delay,
        )

    @property
    def settling_time(self) -> float | Array:
        to_settle = float(np.log(1e3))  # time constants, until a thousandth of a step remains
        slower = jnp.maximum(self.rise_time, self.fall_time) * (to_settle / _TEN_TO_NINETY)
        return slower if self.delay is None else slower + self.delay

    def made(
        self, command: AbstractShutter, half_exposure: ArrayLike, dtype: np.dtype
    ) -> "TransmittedShutter":
        half = jnp.asarray(half_exposure, dtype)
        rise, fall = (
            jnp.asarray(time, dtype) / (half * _TEN_TO_NINETY)
            for time in (self.rise_time, self.fall_time)
        )
        delay = None if self.delay is None else jnp.asarray(self.delay, dtype) / half
        slots = self.slots(command, dtype)
        sent = command if self.levels is None else ChippedShutter(slots)
        return self.passed(lagged(slots, rise, fall, delay), dtype, sent)


@final
class SwitchedDevice(AbstractDevice):
    r"""A device that is open or closed in each of equal slots, and switches at once.

    Camera triggers that expose often, pixels that code their exposure, micromirrors, strobes. A
    profile is sent by error diffusion over the slots.

    Args:
        num_slots: Equal slots of the exposure.
        min_open: Fewest slots in a row that are open, at most all; a row that reaches over an end
            of the exposure may be as long as it takes outside.
        min_closed: Fewest slots in a row that are closed, alike.
        transmission: Share of the light that passes where it is open, $t$.
        leakage: Share of that which passes where it is closed, $\ell$.

    Raises:
        ValueError: as `IdealDevice`.
    """

    transmission: Array
    leakage: Array
    num_slots: int | None = eqx.field(static=True)
    min_open: int = eqx.field(static=True)
    min_closed: int = eqx.field(static=True)
    levels: ClassVar[int | None] = 2
    is_linear: ClassVar[bool] = False
    lags: ClassVar[bool] = False
    lag_words: ClassVar[str] = ""
    settling_time: ClassVar[float] = 0.0

    def __init__(
        self,
        *,
        num_slots: int = NUM_SLOTS,
        min_open: int = 1,
        min_closed: int = 1,
        transmission: ArrayLike = 1.0,
        leakage: ArrayLike = 0.0,
    ):
        self.transmission = as_float(transmission, "SwitchedDevice(transmission=...)")
        self.leakage = as_float(leakage, "SwitchedDevice(leakage=...)")
        self.num_slots = _slots(num_slots, "SwitchedDevice")
        self.min_open = _run(min_open, self.num_slots, "SwitchedDevice(min_open=...)")
        self.min_closed = _run(min_closed, self.num_slots, "SwitchedDevice(min_closed=...)")

    @staticmethod
    def has(arguments: Collection[str]) -> bool:
        switches = not {"num_slots", "min_open", "min_closed"}.isdisjoint(arguments)
        return switches and "levels" not in arguments

    @property
    def relaxed(self) -> IdealDevice:
        return self.without_lag

    def made(
        self, command: AbstractShutter, half_exposure: ArrayLike, dtype: np.dtype
    ) -> "TransmittedShutter":
        return self.passed(ChippedShutter(self.slots(command, dtype)), dtype, None)


DEVICES: tuple[type[AbstractDevice], ...] = (FirstOrderDevice, SwitchedDevice, IdealDevice)
"""All devices; the first that `has` the arguments of a file is the one that it describes."""


def _count(count: int, subject: str, most: int) -> int:
    count = require_positive_int(subject, count)
    require(2 <= count <= most, subject, f"be 2 to {most}", count)
    return count


def _levels(count: int | None, kind: str) -> int | None:
    return None if count is None else _count(count, f"{kind}(levels=...)", 65536)


def _slots(count: int, kind: str) -> int:
    return _count(count, f"{kind}(num_slots=...)", 4096)


def _run(count: int, num_slots: int, subject: str) -> int:
    """Slots in a row."""
    count = require_positive_int(subject, count)
    require(count <= num_slots, subject, f"be at most num_slots = {num_slots}", count)
    return count


@final
class TransmittedShutter(AbstractPiecewiseShutter):
    r"""The transmittance $t\,(\ell + (1 - \ell)\,w(\tau))$ of a profile sent to a device."""

    profile: AbstractPiecewiseShutter
    transmission: Array
    leakage: Array
    sent: AbstractShutter | None

    def __init__(
        self,
        profile: AbstractPiecewiseShutter,
        transmission: Array,
        leakage: Array,
        sent: AbstractShutter | None = None,
    ):
        self.profile, self.transmission, self.leakage = profile, transmission, leakage
        self.sent = sent

    @property
    def command(self) -> AbstractShutter:
        """The profile that was sent to the device."""
        if self.sent is not None:
            return self.sent
        profile = self.profile
        return profile.shutter if isinstance(profile, SampledShutter) else profile

    @property
    def panels_per_piece(self) -> int:
        return self.profile.panels_per_piece

    @property
    def equal_pieces(self) -> bool:
        return self.profile.equal_pieces

    @property
    def symmetric(self) -> bool:
        return self.profile.symmetric

    def transmittance(self, tau: ArrayLike) -> Float[Array, "..."]:
        passed = self._passed(self.profile.transmittance(tau))
        return within_exposure(jnp.asarray(tau), passed)

    def breakpoints(self, dtype: np.dtype) -> Float[Array | np.ndarray, "ends"]:
        return self.profile.breakpoints(dtype)

    def piece_transmittance(self, offset: Offsets) -> Values:
        return self._passed(self.profile.piece_transmittance(offset))

    def piece_mean(self, piece: Pieces, from_left: Sides, distance: Cells, width: Cells) -> Cells:
        return self._passed(self.profile.piece_mean(piece, from_left, distance, width))

    def _passed(self, opened: Num[Array | np.ndarray, "*shape"]) -> Inexact[Array, "*shape"]:
        if not jnp.issubdtype(opened.dtype, jnp.inexact):  # open and closed as 1 and 0
            opened = opened.astype(self.leakage.dtype)
        t, leakage = (x.astype(opened.dtype) for x in (self.transmission, self.leakage))
        return t * (leakage + (1 - leakage) * opened)


def command_of(shutter: AbstractShutter) -> AbstractShutter:
    """The profile that is sent to a device to make a transmittance; itself without a device."""
    return shutter.command if isinstance(shutter, TransmittedShutter) else shutter
