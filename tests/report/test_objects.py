"""Files of a picture that was restored object by object."""

import numpy as np

from mishutter.decoding.restored_frames import RestoredFrames
from mishutter.pictures.images import read_picture
from mishutter.report.objects import write_objects


def test_labels_differ_in_grey_too(tmp_path):
    """Seven objects and the background, as a printer without colours shows them."""
    found = RestoredFrames(np.zeros((1, 8, 1)), None)
    found.labels, found.trust = np.arange(8)[None], np.ones((1, 8))
    found.objects, found.layers = (), None
    write_objects(tmp_path, found)
    light = read_picture(tmp_path / "labels.png").light[0]
    coded = 255 * np.where(light > 0.0031308, 1.055 * light ** (1 / 2.4) - 0.055, 12.92 * light)
    grey = np.sort(coded @ [0.299, 0.587, 0.114])
    assert np.diff(grey).min() > 18
