"""The reproduction's camera and photographs, captured and restored.

"The paper" is "Improved motion invariant imaging with time varying shutter functions".
"""

import jax
import numpy as np

from mishutter.decoding.decoders.base import AbstractDecoder
from mishutter.decoding.decoders.richardson_lucy import RichardsonLucyDecoder
from mishutter.decoding.photographs import RestoredPhotograph, restore_photograph
from mishutter.model.motion import ParabolicMotion
from mishutter.model.scene import Scene
from mishutter.model.shutters.base import AbstractShutter
from mishutter.model.texture import Texture
from mishutter.paper.numbers import PlainNumbers
from mishutter.pictures.images import Picture, shipped_picture

HALF_EXPOSURE = 0.01
STROKE = 34.0
"""Kernels of 34 to 51 samples for a still object and the fastest, as in section 3."""
ELECTRONS, READ_NOISE = 1e4, 10.0
"""Moderate noise: photo-electrons at white and read noise; e-."""
AXIS = np.linspace(0.0, 0.5, 11)
"""The paper's speed axis."""
READINGS = {"s/(aT)": 0.5, "s/(2aT)": 1.0}
"""Readings of the speed axis: normalised speed `s/(2aT)` of 1 on it, by the reading."""
PHOTOGRAPHS = {
    "camera": ("camera.png", (60, 188)),
    "motorcycle": ("motorcycle_left.png", (180, 308)),
    "coffee": ("coffee.png", (120, 248)),
}
"""Files of scikit-image's package, and first and last row of the part that is used."""
MID_TO_HIGH = (0.2, 0.3, 0.4, 0.5)
"""Speeds on the paper's axis at which decoders are compared."""
PLAIN = RichardsonLucyDecoder(30, accelerated=False, until_noise=False, start="capture")
ACCELERATED = RichardsonLucyDecoder(30, until_noise=False, start="capture")
"""Decoders of thirty steps each; MATLAB's `deconvlucy` is the second."""


def camera(stroke: float = STROKE) -> ParabolicMotion:
    """The motion of the reproduction's sensor."""
    return ParabolicMotion(acceleration=stroke / HALF_EXPOSURE**2, half_exposure=HALF_EXPOSURE)


def photograph(name: str) -> Picture:
    """One of the photographs, in luminance, cut to the rows that are used."""
    file_name, (first, last) = PHOTOGRAPHS[name]
    whole = shipped_picture(file_name)
    return Picture(light=np.ascontiguousarray(whole.luminance[first:last, :, None]), name=name)


def restored(
    picture: Picture,
    shutter: AbstractShutter,
    normalised_speeds: list[float],
    *,
    electrons: float = ELECTRONS,
    decoder: AbstractDecoder = ACCELERATED,
) -> RestoredPhotograph:
    """Captures and restores a photograph at speeds `s/(2aT)`."""
    motion = camera()
    top = float(motion.top_speed)
    scene = Scene(
        [0.0],
        photon_rate=electrons / (2 * HALF_EXPOSURE),
        read_noise=READ_NOISE,
        picture=Texture.of_photograph(picture),
    )
    speeds = [nu * top for nu in normalised_speeds]
    key = jax.random.key(20)
    return restore_photograph(
        picture, scene, motion, shutter, decoder=decoder, speeds=speeds, num_seeds=1, key=key
    )


def plain_numbers(
    photographs: dict[str, Picture],
    windows: dict[str, AbstractShutter],
    speeds: tuple[float, ...] = MID_TO_HIGH,
) -> PlainNumbers:
    """PSNR at mid to high speeds by plain iterations, for each window and reading of the axis."""
    numbers: PlainNumbers = {"speed": list(speeds), "psnr": {}}
    for reading, scale in READINGS.items():
        nus = [v * scale for v in speeds]
        numbers["psnr"][reading] = {
            photograph: {
                window: restored(picture, shutter, nus, decoder=PLAIN).psnr.tolist()
                for window, shutter in windows.items()
            }
            for photograph, picture in photographs.items()
        }
    return numbers
