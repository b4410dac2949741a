"""A camera as it was built, from its recordings."""

from mishutter.hardware.calibration.estimation import Estimate as Estimate
from mishutter.hardware.calibration.estimation import FittedCamera as FittedCamera
from mishutter.hardware.calibration.estimation import fit as fit
from mishutter.hardware.calibration.measurements import SensorLevels as SensorLevels
from mishutter.hardware.calibration.measurements import TargetPicture as TargetPicture
from mishutter.hardware.calibration.measurements import read_measurements as read_measurements
