"""Parts of pictures put back into place, and masks of few edges."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float
from scipy import ndimage

from mishutter.pictures.registration.windows import Window

Mask = Float[np.ndarray, "_ _"]
"""Numbers from 0 to 1 on the pixels of a picture."""


def moved(
    part: np.ndarray, window: Window, by: Float[np.ndarray, "2"], shape: tuple[int, ...]
) -> np.ndarray:
    """A picture of zeros but for a part of another, displaced; px."""
    target = window.swept(by[None], shape)
    padded = np.pad(part, 1)
    offset = np.array([target.top - window.top + 1, target.left - window.left + 1])
    here = Window(0, 0, target.rows, target.columns)
    seen = here.taken(padded, offset - by)
    return target.placed(seen, shape)


def of_few_edges(
    start: Mask, slope: Callable[[Mask], Mask], weight: Mask, step: Mask | float, num_steps: int
) -> Mask:
    r"""The mask $0 \le u \le 1$ of least $F(u) + \sum \lambda\,|\nabla u|$.

    Args:
        start: The first $u$.
        slope: $F'$.
        weight: $\lambda$ of each pixel.
        step: Length of a primal step, of each pixel; that of a dual one is 0.4.
        num_steps: Number of both.
    """
    u = bar = start.astype(np.float32)
    down, across = np.zeros_like(u), np.zeros_like(u)
    for _ in range(num_steps):
        down[:-1] += 0.4 * (bar[1:] - bar[:-1])
        across[:, :-1] += 0.4 * (bar[:, 1:] - bar[:, :-1])
        size = np.maximum(1, np.hypot(down, across) / weight)
        down /= size
        across /= size
        pulled = down + across
        pulled[1:] -= down[:-1]
        pulled[:, 1:] -= across[:, :-1]
        following = np.clip(u + step * (pulled - slope(u)), 0, 1)
        bar, u = 2 * following - u, following
    return u


def from_outline(inside: np.ndarray) -> Float[np.ndarray, "rows columns"]:
    """Distance of each pixel to the nearest one on the other side of an outline; px."""
    each = [np.asarray(ndimage.distance_transform_edt(side)) for side in (inside, ~inside)]
    return np.maximum(*each)
