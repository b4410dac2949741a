"""Cameras and scenes that photographs are restored from."""

import mishutter as ms

HALF_EXPOSURE = 0.01
STROKE = 34.0


def camera(stroke=STROKE):
    return ms.ParabolicMotion(acceleration=stroke / HALF_EXPOSURE**2, half_exposure=HALF_EXPOSURE)


def scene(**others):
    top = 2 * STROKE / HALF_EXPOSURE
    values = {
        "photon_rate": 3e5,
        "read_noise": 4.0,
        "picture": ms.Texture(mean_level=0.5, deviation=0.1),
    }
    return ms.Scene.uniform(max_speed=0.3 * top, num_speeds=5, **{**values, **others})
