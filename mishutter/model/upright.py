"""Pictures turned as they are meant to be seen."""

import numpy as np

ORIENTATION = 274
"""Number of the tag of TIFF and EXIF that says how a picture is stored."""

_TRANSPOSED = (5, 6, 7, 8)
_RIGHT_TO_LEFT = (2, 3, 6, 7)
_BOTTOM_TO_TOP = (3, 4, 7, 8)


def upright(pixels: np.ndarray, orientation: int) -> np.ndarray:
    """Pixels `(rows, columns, ...)` turned by their orientation tag; a view.

    1 is upright, and so is what the tag should not hold.
    """
    turned = pixels.swapaxes(0, 1) if orientation in _TRANSPOSED else pixels
    turned = turned[:, ::-1] if orientation in _RIGHT_TO_LEFT else turned
    return turned[::-1] if orientation in _BOTTOM_TO_TOP else turned
