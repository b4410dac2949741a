"""How good the borders of a restored picture are, on photographs that go on beyond them.

A photograph is captured whole, and a sensor is cut out of the middle of the capture: the
truth beyond its borders is known, and the same columns can also be restored with what lies
beyond them at hand. What a decoder loses at a border is the difference of the two, which the
content of the columns has no part in.
"""

from contextlib import ExitStack
from importlib import import_module
from typing import NamedTuple
from unittest import mock

import numpy as np

import mishutter as ms
from benchmarks.photographs import PHOTOGRAPHS
from mishutter.decoding.decoders.base import blur_model

# Periodic rows in place of continued ones, for which decoders have no argument.
from mishutter.decoding.decoders.borders import Continuation
from mishutter.pictures.images import shipped_picture

NUM_ROWS, COLUMNS = 128, 336
STROKE, HALF_EXPOSURE = 34.0, 0.01
BORDER = 34
"""Columns that count as border: the kernel's length."""
SPEED_SHARE = 0.15
"""Largest speed that the decoder reckons with, of the sensor's top speed."""
READ_NOISE = 4.0


class Borders(NamedTuple):
    """PSNR of the restored picture, dB: between the borders, and of the borders alone.

    Attributes:
        inner: Between the borders.
        border: Of the outermost kernel length of columns at either end.
        recorded: Of the same columns where the sensor goes on beyond them.
        wrapped: Of the borders by the same decoder on rows taken for periodic.
        reference: Of the borders by scikit-image's decoder of the same kind.
    """

    inner: float
    border: float
    recorded: float
    wrapped: float
    reference: float


def camera():
    """The moving sensor."""
    return ms.ParabolicMotion(acceleration=STROKE / HALF_EXPOSURE**2, half_exposure=HALF_EXPOSURE)


def measured(name, decoder, photon_rate):
    """Borders of a photograph under a Hann window, standing still before the camera."""
    first = PHOTOGRAPHS[name]
    light = shipped_picture(name).luminance[first : first + NUM_ROWS, :, None].astype(np.float64)
    motion, shutter = camera(), ms.HannShutter()
    known = ms.Scene.uniform(
        max_speed=SPEED_SHARE * float(motion.top_speed),
        num_speeds=5,
        photon_rate=photon_rate,
        read_noise=READ_NOISE,
        picture=ms.Texture.of_photograph(ms.Picture(light)),
    )
    whole = ms.restore_photograph(
        light, known, motion, shutter, decoder=decoder, speeds=[0.0], num_seeds=1
    )
    begin = (whole.reference.shape[1] - COLUMNS) // 2
    middle = np.s_[:, begin : begin + COLUMNS]
    truth, captured = whole.reference[middle], whole.captured[0][middle]
    found = ms.deconvolve(captured, known, motion, shutter, decoder=decoder)
    with wrapped_borders():
        wrapped = ms.deconvolve(captured, known, motion, shutter, decoder=decoder)
    reference = _by_scikit_image(captured[..., 0], known, decoder)[..., None]
    each = (found, whole.restored[0][middle], wrapped, reference)
    (inner, border), *others = (inside_and_at_border(truth, np.asarray(one)) for one in each)
    return Borders(inner, border, *(level for _, level in others))


def inside_and_at_border(truth, restored):
    """PSNR between the borders, and of the borders alone; with gamma, dB."""
    columns = np.arange(truth.shape[1])
    is_inside = (columns >= BORDER) & (columns < columns.size - BORDER)
    return [
        float(ms.psnr(truth[:, some], restored[:, some], gamma=True))
        for some in (is_inside, ~is_inside)
    ]


def wrapped_borders():
    """Inside this context every decoder takes rows for periodic; `COLUMNS` fills its blocks."""

    def periodic(model, columns):
        return Continuation(np.zeros((0, 0)), columns, columns, 0)

    stack = ExitStack()
    for name in ("linear", "richardson_lucy", "total_variation"):
        module = import_module(f"mishutter.decoding.decoders.{name}")
        stack.enter_context(mock.patch.object(module, "continuation", periodic))
    return stack


def _by_scikit_image(captured, known, decoder):
    """`richardson_lucy` or `wiener`, with the same kernel, noise and spectrum, on rows."""
    from skimage.restoration import richardson_lucy as iterate
    from skimage.restoration import wiener

    model = blur_model(known, camera(), ms.HannShutter())
    if isinstance(decoder, ms.RichardsonLucyDecoder):
        light, taps = captured / model.efficiency, ms.centred_kernel(camera(), ms.HannShutter())
        taps = np.maximum(taps, 0)
        return iterate(light, taps / taps.sum(), num_iter=decoder.num_iterations, clip=False)
    penalty = np.sqrt(model.noise / model.picture_spectrum(COLUMNS)).astype(complex)[None]
    taps = np.fft.fftshift(np.fft.irfft(model.assumed_response(COLUMNS), COLUMNS))[None]
    rows = [wiener(r[None], taps, 1.0, reg=penalty, is_real=True, clip=False) for r in captured]
    return np.concatenate(rows)
