"""Files of a picture that was restored object by object."""

from pathlib import Path

import numpy as np

from mishutter._core.files import write_text
from mishutter.camera.layers import write_layers
from mishutter.decoding.restored_frames import RestoredFrames
from mishutter.pictures.images import write_picture

_COLOURS = np.array(
    [
        [0.0, 0.0, 0.0],
        [0.0, 0.24, 0.38],
        [0.89, 0.61, 0.0],
        [0.0, 0.46, 0.33],
        [0.56, 0.33, 0.46],
        [0.45, 0.76, 0.92],
        [0.64, 0.28, 0.0],
        [0.95, 0.9, 0.36],
    ]
)
"""Colours of the background, which is black, and of objects; greys tell them apart too."""


def write_objects(folder: Path, found: RestoredFrames | None) -> list[str]:
    """Write labels, trust, objects and layers, and return the names of the files.

    Args:
        folder: An existing folder.
        found: Frames restored object by object; None for none, of which nothing is written.

    Raises:
        OSError: if a file cannot be written.
    """
    if found is None:
        return []
    labels, trust = np.asarray(found.labels), np.asarray(found.trust)
    colours = _COLOURS[np.where(labels > 0, (labels - 1) % (len(_COLOURS) - 1) + 1, 0)]
    write_picture(folder / "labels.png", colours.astype(np.float32))
    write_picture(folder / "trust.png", trust.astype(np.float32))
    names = "velocity along rows (px/s),velocity along columns (px/s),error (px/s),area (px)"
    lines = [f"object,{names},row (px),column (px),trusted"]
    for number, each in enumerate(found.objects, 1):
        along, down = each.velocity.tolist()
        row, column = each.place
        numbers = f"{along:.6g},{down:.6g},{each.error:.3g},{each.area:.0f},{row:.1f},{column:.1f}"
        lines.append(f"{number},{numbers},{'yes' if each.trusted else 'no'}")
    write_text(folder / "objects.csv", "\n".join([*lines, ""]))
    written = ["labels.png", "trust.png", "objects.csv"]
    return written + ([] if found.layers is None else write_layers(folder, found.layers))
