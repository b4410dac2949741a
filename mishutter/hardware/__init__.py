"""Designs in a laboratory: drive tables, traces and calibration."""

from mishutter.hardware.calibration import Estimate as Estimate
from mishutter.hardware.calibration import FittedCamera as FittedCamera
from mishutter.hardware.calibration import SensorLevels as SensorLevels
from mishutter.hardware.calibration import TargetPicture as TargetPicture
from mishutter.hardware.calibration import fit as fit
from mishutter.hardware.calibration import read_measurements as read_measurements
from mishutter.hardware.drive import DriveTable as DriveTable
from mishutter.hardware.drive import design_from_drive as design_from_drive
from mishutter.hardware.drive import drive_table as drive_table
from mishutter.hardware.drive_files import DRIVE_FORMATS as DRIVE_FORMATS
from mishutter.hardware.drive_files import Drive as Drive
from mishutter.hardware.drive_files import DriveWarning as DriveWarning
from mishutter.hardware.drive_files import drive_bytes as drive_bytes
from mishutter.hardware.drive_files import read_drive as read_drive
from mishutter.hardware.trace_files import read_trace as read_trace
from mishutter.hardware.traces import MeasuredProfile as MeasuredProfile
from mishutter.hardware.traces import Trace as Trace
from mishutter.hardware.traces import for_a_fit as for_a_fit
from mishutter.hardware.traces import measured_profile as measured_profile
from mishutter.hardware.traces import span_of_shifts as span_of_shifts
from mishutter.hardware.triggers import FrameTable as FrameTable
from mishutter.hardware.triggers import frame_table as frame_table
