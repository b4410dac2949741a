"""A scene from a clip of one's own camera: its noise, what moves, and how fast."""

from mishutter.measurement.estimates import Refusal as Refusal
from mishutter.measurement.measurement import Measurement as Measurement
from mishutter.measurement.measurement import measure as measure
from mishutter.measurement.measurement import noise_from as noise_from
from mishutter.measurement.motion import Motion as Motion
from mishutter.measurement.motion import MovingObject as MovingObject
from mishutter.measurement.noise import Noise as Noise
