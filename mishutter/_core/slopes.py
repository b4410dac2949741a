"""Functions whose derivatives are finite, and not left to rounding, where those of JAX are not."""

from typing import Any

from mishutter._core.checks import primal_values, space_of


def safe_sqrt(square: Any) -> Any:
    """Square root; 0 for negative numbers, and with a derivative of 0 at 0."""
    space, is_zero = space_of(square), square <= 0
    # Without the inner `where` the infinite slope at 0, times the 0 of the outer one, would be NaN.
    return space.where(is_zero, 0.0, space.sqrt(space.where(is_zero, 1.0, square)))


def magnitude(value: Any) -> Any:
    """$|x|$, whose derivative at 0 is 1."""
    return space_of(value).where(value < 0, -value, value)


def length_of(vectors: Any) -> Any:
    """Length of vectors, whose components lie along the first axis; a derivative of 0 at 0."""
    # Squares of small components are 0 without the scale, and those of great ones infinite.
    size = abs(primal_values(vectors)).max(axis=0, keepdims=True)
    scale = space_of(vectors).where(size > 0, size, 1.0)
    return scale[0] * safe_sqrt(((vectors / scale) ** 2).sum(axis=0))


def largest_of(values: Any) -> Any:
    """The largest of the last axis, of equal ones the last, by its index.

    The derivative of a maximum asks which values equal it: none does where the compiler computes
    them again and rounds otherwise, and the slope is then 0 / 0. A path without acceleration gains
    speed at its end as soon as it has some.
    """
    values = values[..., ::-1]
    index = values.argmax(axis=-1)[..., None]
    return space_of(values).take_along_axis(values, index, axis=-1)[..., 0]
