"""A photograph that was captured and restored."""

import numpy as np

from mishutter.decoding.photographs import RestoredPhotograph


def photograph(level, num_seeds=3, columns=slice(None)):
    """A made-up result of a restoration, of some columns of a picture wider than it is high."""
    light = np.random.default_rng(7).uniform(0.1, 0.9, (3, 23, 31, 1))[:, :, columns]
    error = np.full(3, np.nan if num_seeds == 1 else 0.04)
    return RestoredPhotograph(
        speeds=np.array([-310.0, 0.0, 450.0]),
        psnr=level + np.array([0.3, 1.1, 0.7]),
        linear_psnr=level + np.array([2.3, 3.1, 2.7]),
        standard_error=error,
        linear_standard_error=error,
        mean_psnr=level,
        expected_psnr=level + 0.2,
        own_expected_psnr=np.full(len(light), level + 0.1),
        reference=light[1],
        captured=light * 0.6,
        restored=light + 1 / level,
        doubts=np.full(len(light), "", object),
    )
