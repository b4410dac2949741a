"""Objects that are registered one by one, each in a region of its own."""

from typing import final

from jaxtyping import Array, ArrayLike

from mishutter._core.checks import as_float, require_number
from mishutter._core.modules import AbstractModule


@final
class Objects(AbstractModule):
    """Things that move on their own, of which a decoder registers each within its own outline.

    A point near the outline is seen by fewer frames, or by part of an exposure, as one near the
    border of a sensor that is as wide as the object. Bursts lose by that, and are chosen by what is
    left. Things of several velocities are found in frames at rest alone.

    Args:
        width: Width of the narrowest object that is to be restored, along the motion; px.

    Raises:
        ValueError: if `width` is no scalar above 0.
    """

    width: Array

    def __init__(self, *, width: ArrayLike):
        self.width = as_float(width, "Objects(width=...)")

    def __check_init__(self) -> None:
        require_number("Objects(width=...)", self.width, "above 0 px", strict=True)
