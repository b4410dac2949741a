"""A camera as it was built, from what it recorded."""

from mishutter.calibration.estimation import FittedCamera as FittedCamera
from mishutter.calibration.estimation import fit as fit
from mishutter.calibration.measurements import SensorLevels as SensorLevels
from mishutter.calibration.measurements import TargetPicture as TargetPicture
from mishutter.calibration.measurements import read_measurements as read_measurements
