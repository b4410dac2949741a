"""What equal frames at rest leave of a picture, written out anew."""

import numpy as np


def errors_of_stills(num_frames, exposure, scene, num_frequencies=2048):
    """Mean over frequencies of what one Wiener filter a speed leaves, at each speed."""
    rate, noise_of_reading = float(scene.photon_rate), float(scene.read_noise)
    frequency = (np.arange(num_frequencies) + 0.5) / (2 * num_frequencies)
    power = 1 / (frequency**2 + 0.01**2)
    power *= 0.2**2 / np.mean(power)
    electrons = num_frames * rate * exposure
    noise = 0.25 * electrons + num_frames * noise_of_reading**2
    passed = np.sinc(frequency * exposure * np.asarray(scene.speeds)[:, None]) * np.sinc(frequency)
    return np.mean(power * noise / (power * electrons**2 * passed**2 + noise), axis=1)
