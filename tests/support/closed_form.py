r"""The expected error from Fresnel integrals: no nodes, no waves, no plan, numpy and scipy alone.

A window is a list of pieces `(start, end, terms)`, each term `(c, k, p)` standing for
$c\cos(k\tau + p)$. Its transfer function on a parabola is a Fresnel integral a term.
"""

import numpy as np
from scipy.special import fresnel

RECT = [(-1, 1, [(1.0, 0.0, 0.0)])]
HANN = [(-1, 1, [(0.5, 0.0, 0.0), (0.5, np.pi, 0.0)])]


def tukey(taper):
    """A Tukey window."""
    k, p = np.pi / taper, np.pi * (1 - taper) / taper
    return [
        (-1, -1 + taper, [(0.5, 0.0, 0.0), (0.5, k, p)]),
        (-1 + taper, 1 - taper, [(1.0, 0.0, 0.0)]),
        (1 - taper, 1, [(0.5, 0.0, 0.0), (0.5, k, -p)]),
    ]


def chips(values):
    """Equal chips."""
    ends = np.linspace(-1, 1, len(values) + 1)
    return [(a, b, [(v, 0.0, 0.0)]) for a, b, v in zip(ends[:-1], ends[1:], values, strict=True)]


def efficiency(window):
    """Share of light let through."""
    total = 0.0
    for start, end, terms in window:
        middle, width = (start + end) / 2, end - start
        for c, k, p in terms:
            total += c * width * np.cos(k * middle + p) * np.sinc(k * width / (2 * np.pi))
    return total / 2


def _integral_to(u):
    sine, cosine = fresnel(u)
    return cosine - 1j * sine


def transfer(window, stroke, smear, frequency):
    """Transfer function, from the lowest place or, without a stroke, from that at mid-exposure."""
    beyond = max(abs(smear) - 2 * stroke, 0) ** 2 / (4 * stroke) if stroke > 0 else 0.0
    total = np.zeros(frequency.size, complex)
    for start, end, terms in window:
        for c, k, p in terms:
            for sign in (1,) if k == 0 else (1, -1):
                share = c if k == 0 else c / 2
                omega = sign * k + 2 * np.pi * frequency * smear
                if stroke > 0:
                    middle, root = (
                        omega / (4 * np.pi * frequency * stroke),
                        2 * np.sqrt(frequency * stroke),
                    )
                    phase = (k * k + 4 * np.pi * sign * k * frequency * smear) / (
                        8 * np.pi * frequency * stroke
                    )
                    ends = _integral_to(root * (end - middle)) - _integral_to(
                        root * (start - middle)
                    )
                    total += share * np.exp(1j * (sign * p + phase)) * ends / root
                else:
                    wave = np.exp(1j * (sign * p + omega * (start + end) / 2))
                    width = end - start
                    total += share * wave * width * np.sinc(omega * width / (2 * np.pi))
    return total / 2 * np.exp(2j * np.pi * frequency * beyond)


def expected_psnr(window, stroke, half_exposure, speeds, rate, noise, num_frequencies=65536):
    """Of equally frequent speeds, a picture of the default spectrum, mean and deviation; dB."""
    frequency = (np.arange(num_frequencies) + 0.5) * (0.5 / num_frequencies)
    power = 1 / (frequency**2 + 0.01**2)
    power *= 0.2**2 / np.mean(power)
    aperture = np.sinc(frequency)
    spectra = [aperture * transfer(window, stroke, s * half_exposure, frequency) for s in speeds]
    mean = sum(spectra) / len(spectra)
    spread = sum(np.abs(h - mean) ** 2 for h in spectra) / len(spectra)
    electrons = 2 * rate * half_exposure
    own = efficiency(window) * 0.25 * electrons + noise**2
    signal = power * electrons**2
    error = power * (signal * spread + own) / (signal * (np.abs(mean) ** 2 + spread) + own)
    return -10 * np.log10(np.mean(error))
