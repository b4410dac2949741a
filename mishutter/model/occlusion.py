"""Objects in front of a background: how much of a picture they cover, and how wide they are."""

from typing import ClassVar, Literal, final, get_args

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from mishutter._core.checks import (
    all_concrete,
    as_float,
    common_dtype,
    require,
    require_number,
    shown,
)
from mishutter._core.modules import AbstractModule

Background = Literal["still", "moving"]
"""Motion of a background: none, or at one of the speeds that the objects have."""


@final
class LayerShares(eqx.Module):
    r"""Shares that the parts of a picture of two layers have in its power, by frequency.

    The texture of the objects and that of the background move rigidly. Where the edge of an object
    uncovers the background, the product of their waves moves at an effective speed in between or
    beyond: the beat.
    """

    power: Float[Array, "m"]  # Power of the picture, $S_r$; shape `(m,)`
    objects: Float[Array, "m"]  # Share of the objects' texture; shape `(m,)`
    background: Float[Array, "m"]  # Share of the background's own texture; shape `(m,)`
    same: Float[Array, "m"]  # Share of the beat where both layers have one speed; shape `(m,)`
    # Share of the beat of each pair of speeds at each effective speed, at the knots; `(b, n, k, c)`
    beat: Float[Array, "b n k c"]
    background_speeds: Float[Array, "b"]  # Speeds of the background; px/s, shape `(b,)`
    background_weights: Float[Array, "b"]  # How often each occurs; shape `(b,)`
    speeds: Float[Array, "k"]  # Effective speeds; px/s, shape `(k,)`
    first: float = eqx.field(static=True)  # Lowest of the frequencies, cycles/px; static
    step: float = eqx.field(static=True)  # Step between them; static
    # Whether `+s` and `-s` are taken for one effective speed; static
    folds: bool = eqx.field(static=True)
    # Places among the frequencies that the beat is known at; None for all; static
    knots: tuple[int, ...] | None = eqx.field(static=True, default=None)

    def in_sensor_frame(self, velocity: Array | np.ndarray) -> "LayerShares":
        """The same shares in the frame of a sensor that pans."""
        places = lambda s: (s.background_speeds, s.speeds)  # noqa: E731
        return eqx.tree_at(places, self, tuple(_shifted(x, velocity) for x in places(self)))


@final
class Occlusion(AbstractModule):
    r"""Objects in front of a background, which stands still or moves.

    The objects have the scene's speeds, and both layers its spectrum and mean level. The widths of
    the objects along the rows are exponentially distributed, as far as the theory knows them; what
    counts is the number of edges by length.

    Args:
        front_share: Share of the picture that objects cover, from 0 to 1.
        object_width: Mean width of an object along the direction of motion, px; None for objects
            without edges: parts of the picture that move, beside others that do not.
        level_difference: Mean of the objects less that of the background, white = 1. The scene's
            mean level is that of the whole picture.
        background: `"still"`, or `"moving"`: at one of the scene's speeds, whatever the objects'.
        background_speed: Speed of a still background in the frame, which `in_sensor_frame` sets;
            px/s.
        shares: Shares that have been computed of these numbers.

    Raises:
        ValueError: if a number is out of its range, or `background` neither.
    """

    front_share: Array
    object_width: Array | None
    level_difference: Array
    background_speed: Array
    background: Background = eqx.field(static=True)
    shares: LayerShares | None
    handed_on: ClassVar = ("background_speed", "shares")

    def __init__(
        self,
        *,
        front_share: ArrayLike,
        object_width: ArrayLike | None = None,
        level_difference: ArrayLike = 0.0,
        background: Background = "still",
        background_speed: ArrayLike | None = None,
        shares: LayerShares | None = None,
    ):
        self.front_share = as_float(front_share, "Occlusion(front_share=...)")
        self.object_width = None
        if object_width is not None:
            self.object_width = as_float(object_width, "Occlusion(object_width=...)")
        self.level_difference = as_float(level_difference, "Occlusion(level_difference=...)")
        rest = np.zeros((), self.front_share.dtype)
        speed = rest if background_speed is None else background_speed
        self.background_speed = as_float(speed, "Occlusion(background_speed=...)")
        self.background, self.shares = background, shares

    def __check_init__(self) -> None:
        subject = "Occlusion(front_share=...)"
        require_number(subject, self.front_share, "from 0 to 1", most=1.0)
        if self.object_width is not None:
            subject = "Occlusion(object_width=...)"
            require_number(subject, self.object_width, "above 0 px", strict=True)
        subject = "Occlusion(level_difference=...)"
        require_number(subject, self.level_difference)
        subject, is_valid = "Occlusion(background=...)", self.background in get_args(Background)
        require(is_valid, subject, "be 'still' or 'moving'", self.background)

    def __repr__(self) -> str:
        """One line with the numbers, in place of an Equinox module's types."""
        names = "front_share", "object_width", "level_difference"
        numbers = (f"{n}={shown(x)}" for n in names if (x := getattr(self, n)) is not None)
        return f"Occlusion({', '.join(numbers)}, background={self.background!r})"

    @property
    def has_edges(self) -> bool:
        """Whether objects have edges, behind which the background is uncovered."""
        return self.object_width is not None

    def in_sensor_frame(self, velocity: Array | np.ndarray) -> "Occlusion":
        """The same layers in the frame of a sensor that pans.

        Args:
            velocity: Velocity of the sensor; px/s.
        """
        speed = _shifted(self.background_speed, velocity)
        layers = eqx.tree_at(lambda o: o.background_speed, self, speed)
        if self.shares is None:
            return layers
        return layers.with_shares(self.shares.in_sensor_frame(velocity))

    def with_shares(self, shares: LayerShares | None) -> "Occlusion":
        """The same layers, with shares that have been computed, or without.

        Args:
            shares: What `LayerShares` holds; None for layers without.
        """
        return eqx.tree_at(lambda o: o.shares, self, shares, is_leaf=lambda part: part is None)


def _shifted(speed: Array, velocity: Array | np.ndarray) -> Array:
    dtype = common_dtype(speed, velocity)
    if all_concrete((speed, velocity)):
        return as_float(np.asarray(speed, dtype) - np.asarray(velocity, dtype))
    return jnp.asarray(speed, dtype) - jnp.asarray(velocity, dtype)
