r"""Velocities of things that move in any direction of the picture.

A camera meets a velocity $\mathbf v$ at a frequency of direction $\hat{\mathbf f}$ through the
component $\mathbf v\cdot\hat{\mathbf f}$ alone. So a law of velocities is asked for its components
along a direction, which are the speeds of a scene of one axis.
"""

import math
from abc import abstractmethod
from collections.abc import Sequence
from typing import NamedTuple, final

import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Float

from mishutter._core.checks import (
    RowLike,
    all_concrete,
    as_float,
    as_numpy,
    in_digits,
    is_concrete,
    namespace_of,
    require,
    require_at_least,
    require_finite,
    require_number,
    shape_of,
)
from mishutter._core.modules import AbstractModule

Directions = Float[Array | np.ndarray, "*k"]
"""Angles of directions from the axis of the rows; rad."""
Firsts = Float[np.ndarray, "*#k"]
"""Shares of a step from which on components stand along each direction."""


class Components(NamedTuple):
    """Components of velocities along some directions."""

    # px/s, shape `(*k, l)`, or that of their first where they are alike along all directions
    speeds: Float[Array | np.ndarray, "*k l"]
    # How often each occurs; their sum along each direction is 1
    weights: Float[Array | np.ndarray, "*#k l"]


class Cells(NamedTuple):
    """Cells that the components along a direction are cut into, which cover their range."""

    # Width of each over half the range; shape `(m,)`, their sum is 2
    width: Float[np.ndarray, "m"]
    mass: Float[np.ndarray, "m"]  # Share of the velocities in it; shape `(m,)`


_MIDDLE = np.full(1, 0.5)
"""Share of a step at which components begin that are symmetric."""


def _turns(num_speeds: int, first: Float[np.ndarray, "*k"]) -> Float[np.ndarray, "*k l"]:
    """Angles in equal steps over half a turn, of which each begins with a share of a step; rad."""
    return np.pi / num_speeds * (np.arange(num_speeds) + np.asarray(first)[..., None])


def _on_rings(radii: Float[np.ndarray, "r"]) -> tuple[np.ndarray, np.ndarray]:
    """Eight places on each of some rings, and their weights; each ring is turned."""
    turns = 2 * np.pi / 8 * (np.arange(8) + np.arange(radii.size)[:, None] / radii.size)
    each = np.stack([radii[:, None] * turn(turns) for turn in (np.cos, np.sin)], axis=-1)
    return each.reshape(-1, 2), np.full(turns.size, 1 / turns.size)


class AbstractVelocities(AbstractModule):
    """A law of velocities in the plane of the picture."""

    @abstractmethod
    def components(
        self, direction: Directions, num_speeds: int, first: Firsts = _MIDDLE
    ) -> Components:
        r"""So many components, of a law that is no list, that stand for all of them in a mean.

        They are along directions by their angles from the axis of the rows; rad. Those of a range
        are in its middle and $\cos\varphi$ times its half beside it, in equal steps of $\varphi$
        from a share of one on, `first`.
        """

    @abstractmethod
    def greatest(self, direction: Float[np.ndarray, "k"]) -> Float[np.ndarray, "k"]:
        """Greatest component along directions, rad, of either sign; px/s, of a concrete law."""

    @abstractmethod
    def half_range(self, direction: Float[np.ndarray, "k"]) -> Float[np.ndarray, "k"]:
        """Half of the range of components along directions, rad; px/s, of a concrete law."""

    @abstractmethod
    def cells(self, count: int) -> Cells | None:
        """Cells of the components along any direction; None of a law without a density."""

    @abstractmethod
    def within(self, velocities: Float[np.ndarray, "k 2"], beyond: float) -> Bool[np.ndarray, "k"]:
        """Whether velocities of a concrete law occur, or are no further than `beyond`; px/s."""

    @abstractmethod
    def stand_ins(
        self,
    ) -> tuple[Float[Array | np.ndarray, "s 2"], Float[Array | np.ndarray, "s"]]:
        """A few velocities that stand for all in a mean, and their weights."""

    @property
    @abstractmethod
    def axis(self) -> float:
        """Angle of the direction along which things are fastest; rad, of a concrete law."""

    @property
    @abstractmethod
    def centre(self) -> Float[np.ndarray, "2"]:
        """Mean velocity along rows and columns; px/s, of a concrete law."""

    @property
    @abstractmethod
    def words(self) -> str:
        """The law in words, with its unit."""

    @property
    @abstractmethod
    def table(self) -> dict[str, object]:
        """The keys of a scene file that stand for the law."""

    @property
    def fastest(self) -> float:
        """Greatest speed in any direction; px/s, of a concrete law."""
        return float(self.greatest(np.array([self.axis]))[0])


@final
class EvenVelocities(AbstractVelocities):
    r"""Velocities that fill an ellipse evenly; a disc where both half axes are one.

    Along the direction $\theta$ components are within
    $h = \sqrt{a^2\cos^2(\theta - \alpha) + b^2\sin^2(\theta - \alpha)}$ of that of the mean, and
    those of $hu$ beside it have the density $\tfrac2\pi\sqrt{1 - u^2}$.

    Args:
        along: Half of the longer axis, $a$; px/s.
        across: Half of the shorter, $b$; px/s, at most `along`. That by default.
        angle: Angle of the longer axis from that of the rows, $\alpha$; rad.
        mean: Velocity in the middle of the ellipse along rows and columns, as of all that a drone
            sees that flies on; px/s, shape `(2,)`. At rest by default.

    Raises:
        ValueError: if a number is no finite scalar, `along` is not above 0, `across` not from 0
            to it, or `mean` is not two finite numbers.
    """

    along: Array
    across: Array
    angle: Array
    mean: Array

    def __init__(
        self,
        along: ArrayLike,
        across: ArrayLike | None = None,
        *,
        angle: ArrayLike = 0.0,
        mean: ArrayLike | Sequence[float] = (0.0, 0.0),
    ):
        self.along = as_float(along, "EvenVelocities(along=...)")
        across = self.along if across is None else across
        self.across = as_float(across, "EvenVelocities(across=...)")
        self.angle = as_float(angle, "EvenVelocities(angle=...)")
        pair = np.asarray(mean) if isinstance(mean, Sequence) else mean
        self.mean = as_float(pair, "EvenVelocities(mean=...)")

    def __check_init__(self) -> None:
        for name in ("along", "across", "angle"):
            require_number(f"EvenVelocities({name}=...)", getattr(self, name))
        subject, shape = "EvenVelocities(mean=...)", self.mean.shape
        require(shape == (2,), subject, "be two components", shape_of(self.mean))
        require_finite(subject, self.mean)
        require_at_least("EvenVelocities(along=...)", self.along, "above 0", strict=True)
        require_at_least("EvenVelocities(across=...)", self.across, "at least 0")
        if all_concrete((self.along, self.across)):
            is_shorter = float(self.across) <= float(self.along)
            requirement = f"be at most along = {float(self.along):g} px/s"
            require(is_shorter, "EvenVelocities(across=...)", requirement, self.across)

    def components(
        self, direction: Directions, num_speeds: int, first: Firsts = _MIDDLE
    ) -> Components:
        turns = _turns(num_speeds, first)
        along, across, angle = as_numpy(self.along, self.across, self.angle)
        space, dtype = namespace_of(along, direction), along.dtype
        u = np.cos(turns).astype(dtype)
        weights = (2 / num_speeds * np.sin(turns) ** 2).astype(dtype)
        if self._is_disc and self._is_centred:
            return Components(along * u, weights)
        turn, (mean,) = direction.astype(dtype) - angle, as_numpy(self.mean)
        half = space.hypot(along * space.cos(turn), across * space.sin(turn))
        angles = direction.astype(dtype)
        middle = mean[0] * space.cos(angles) + mean[1] * space.sin(angles)
        return Components(middle[..., None] + half[..., None] * u, weights)

    @property
    def _is_centred(self) -> bool:
        """Whether the mean is known to be at rest."""
        return all_concrete(self.mean) and not np.any(np.asarray(self.mean))

    @property
    def _is_disc(self) -> bool:
        """Whether both half axes are known to be one, but for rounding."""
        if not all_concrete((self.along, self.across)):
            return self.along is self.across
        return float(self.along) - float(self.across) <= 1e-12 * float(self.along)

    def greatest(self, direction: Float[np.ndarray, "k"]) -> Float[np.ndarray, "k"]:
        middle = np.stack([np.cos(direction), np.sin(direction)], axis=-1) @ self.centre
        return np.abs(middle) + self.half_range(direction)

    def half_range(self, direction: Float[np.ndarray, "k"]) -> Float[np.ndarray, "k"]:
        turn = direction - float(self.angle)
        return np.hypot(float(self.along) * np.cos(turn), float(self.across) * np.sin(turn))

    def within(self, velocities: Float[np.ndarray, "k 2"], beyond: float) -> Bool[np.ndarray, "k"]:
        along, across = self._axes @ (velocities - self.centre).T
        halves = float(self.along) + beyond, float(self.across) + beyond
        return np.hypot(along / halves[0], across / halves[1]) <= 1

    def cells(self, count: int) -> Cells:
        ends = np.linspace(0, np.pi, count + 1)
        return Cells(-np.diff(np.cos(ends)), np.diff(ends - np.sin(2 * ends) / 2) / np.pi)

    def stand_ins(self) -> tuple[Array | np.ndarray, Array | np.ndarray]:
        each, weights = _on_rings(np.sqrt((np.arange(3) + 0.5) / 3))  # rings of equal areas
        along, across, angle, mean = as_numpy(self.along, self.across, self.angle, self.mean)
        space = namespace_of(along, across, angle, mean)
        cosine, sine = space.cos(angle), space.sin(angle)
        x, y = along * each[:, 0], across * each[:, 1]
        turned = x * cosine - y * sine + mean[0], x * sine + y * cosine + mean[1]
        return space.stack(turned, axis=-1), weights

    @property
    def _axes(self) -> Float[np.ndarray, "2 2"]:
        """Directions along and across the longer axis; a row each."""
        cosine, sine = math.cos(float(self.angle)), math.sin(float(self.angle))
        return np.array([[cosine, sine], [-sine, cosine]])

    @property
    def axis(self) -> float:
        if self._is_centred:
            return float(self.angle)
        angles = np.linspace(0.0, np.pi, 3600, endpoint=False)
        return float(angles[np.argmax(self.greatest(angles))])

    @property
    def centre(self) -> Float[np.ndarray, "2"]:
        return np.asarray(self.mean, np.float64)

    @property
    def words(self) -> str:
        along, across = float(self.along), float(self.across)
        x, y = self.centre
        about = "" if self._is_centred else f" about ({in_digits(x, 5)}, {in_digits(y, 5)}) px/s"
        furthest, least = in_digits(along, 5), in_digits(across, 5)
        if self._is_disc:
            return f"up to {furthest} px/s in any direction{about}"
        degrees = math.degrees(float(self.angle))
        turned = f" at {degrees:.3g} degrees" if degrees else ""
        return f"up to {furthest} px/s along and {least} px/s across an axis{turned}{about}"

    @property
    def table(self) -> dict[str, object]:
        mean = {} if self._is_centred else {"mean_px_per_s": self.centre.tolist()}
        if self._is_disc:
            return {"max_px_per_s": float(self.along), **mean}
        return {
            "along_px_per_s": float(self.along),
            "across_px_per_s": float(self.across),
            "angle_deg": math.degrees(float(self.angle)),
            **mean,
        }


@final
class RingOfVelocities(AbstractVelocities):
    r"""One speed in any direction: components $Vu$ have the density $1/\pi\sqrt{1 - u^2}$.

    Args:
        speed: $V$; px/s, above 0.

    Raises:
        ValueError: if it is no finite scalar above 0.
    """

    speed: Array

    def __init__(self, speed: ArrayLike):
        self.speed = as_float(speed, "RingOfVelocities(speed=...)")

    def __check_init__(self) -> None:
        require_number("RingOfVelocities(speed=...)", self.speed, "above 0", strict=True)

    def components(
        self, direction: Directions, num_speeds: int, first: Firsts = _MIDDLE
    ) -> Components:
        (speed,) = as_numpy(self.speed)
        u = np.cos(_turns(num_speeds, first)).astype(speed.dtype)
        return Components(speed * u, np.full(u.shape, 1 / num_speeds, u.dtype))

    def greatest(self, direction: Float[np.ndarray, "k"]) -> Float[np.ndarray, "k"]:
        return np.full(direction.shape, float(self.speed))

    def half_range(self, direction: Float[np.ndarray, "k"]) -> Float[np.ndarray, "k"]:
        return self.greatest(direction)

    def within(self, velocities: Float[np.ndarray, "k 2"], beyond: float) -> Bool[np.ndarray, "k"]:
        return np.abs(np.hypot(*velocities.T) - float(self.speed)) <= beyond

    def cells(self, count: int) -> Cells:
        ends = np.linspace(0, np.pi, count + 1)
        return Cells(-np.diff(np.cos(ends)), np.full(count, 1 / count))

    def stand_ins(self) -> tuple[Array | np.ndarray, Array | np.ndarray]:
        each, weights = _on_rings(np.ones(1))
        (speed,) = as_numpy(self.speed)
        return speed * each, weights

    @property
    def axis(self) -> float:
        return 0.0

    @property
    def centre(self) -> Float[np.ndarray, "2"]:
        return np.zeros(2)

    @property
    def words(self) -> str:
        return f"{in_digits(float(self.speed), 5)} px/s in any direction"

    @property
    def table(self) -> dict[str, object]:
        return {"speed_px_per_s": float(self.speed)}


@final
class ListedVelocities(AbstractVelocities):
    """Velocities one by one.

    Args:
        velocities: Components along rows and columns; px/s, shape `(n, 2)`.
        weights: How often each occurs, on any scale; equal by default.

    Raises:
        ValueError: if the velocities are not two components each and finite, none of them moves,
            lengths differ, or no weight is above 0.
    """

    velocities: Array
    weights: Array

    def __init__(
        self, velocities: ArrayLike | Sequence[Sequence[float]], weights: RowLike | None = None
    ):
        pairs = np.asarray(velocities) if isinstance(velocities, Sequence) else velocities
        self.velocities = as_float(pairs, "ListedVelocities(velocities=...)")
        count = max(self.velocities.shape[0], 1) if self.velocities.ndim else 1
        shares = np.full(count, 1 / count, self.velocities.dtype) if weights is None else weights
        (row,) = as_numpy(as_float(shares, "ListedVelocities(weights=...)"))
        total = row.sum()
        is_some = not is_concrete(total) or float(total) > 0
        require(is_some, "ListedVelocities(weights=...)", "hold one above 0", row)
        self.weights = as_float(row / total)

    def __check_init__(self) -> None:
        subject = "ListedVelocities(velocities=...)"
        shape = self.velocities.shape
        are_pairs = len(shape) == 2 and shape[0] >= 1 and shape[1] == 2
        require(are_pairs, subject, "be rows of two components", shape_of(self.velocities))
        require_finite(subject, self.velocities)
        matches = self.weights.shape == shape[:1]
        subject = "ListedVelocities(weights=...)"
        require(matches, subject, f"have shape {shape[:1]}", self.weights.shape)
        require_at_least(subject, self.weights, "at least 0")
        if is_concrete(self.velocities):
            moves = bool(np.any(np.asarray(self.velocities)))
            requirement = "hold one above 0 px/s"
            require(moves, "ListedVelocities(velocities=...)", requirement, 0.0)

    def components(
        self, direction: Directions, num_speeds: int, first: Firsts = _MIDDLE
    ) -> Components:
        velocities, weights = as_numpy(self.velocities, self.weights)
        space, angle = namespace_of(velocities, direction), direction.astype(velocities.dtype)
        units = space.stack([space.cos(angle), space.sin(angle)], axis=-1)
        speeds = units @ velocities.T
        return Components(speeds, namespace_of(weights).broadcast_to(weights, speeds.shape))

    @property
    def _occurring(self) -> Float[np.ndarray, "n 2"]:
        return np.asarray(self.velocities, np.float64)[np.asarray(self.weights) > 0]

    def _along(self, direction: Float[np.ndarray, "k"]) -> Float[np.ndarray, "k n"]:
        """Components of those that occur."""
        return np.stack([np.cos(direction), np.sin(direction)], axis=-1) @ self._occurring.T

    def greatest(self, direction: Float[np.ndarray, "k"]) -> Float[np.ndarray, "k"]:
        return np.max(np.abs(self._along(direction)), axis=1)

    def half_range(self, direction: Float[np.ndarray, "k"]) -> Float[np.ndarray, "k"]:
        return np.ptp(self._along(direction), axis=1) / 2

    def within(self, velocities: Float[np.ndarray, "k 2"], beyond: float) -> Bool[np.ndarray, "k"]:
        apart = np.moveaxis(velocities[:, None] - self._occurring, -1, 0)
        return np.min(np.hypot(*apart), axis=1) <= beyond

    def cells(self, count: int) -> None:
        return None

    def stand_ins(self) -> tuple[Array | np.ndarray, Array | np.ndarray]:
        velocities, weights = as_numpy(self.velocities, self.weights)
        return velocities, weights

    @property
    def axis(self) -> float:
        each = self._occurring
        x, y = each[np.argmax(np.hypot(*each.T))]
        return math.atan2(y, x)

    @property
    def centre(self) -> Float[np.ndarray, "2"]:
        return np.asarray(self.weights, np.float64) @ np.asarray(self.velocities, np.float64)

    @property
    def words(self) -> str:
        return f"{self.velocities.shape[0]} velocities of up to {in_digits(self.fastest, 5)} px/s"

    @property
    def table(self) -> dict[str, object]:
        return {"list_px_per_s": self.velocities.tolist(), "weights": self.weights.tolist()}
