"""Design of shutters for motion-invariant photography."""

from mishutter.kernel import binned_exposure as binned_exposure
from mishutter.kernel import blur_kernel as blur_kernel
from mishutter.motion import AbstractMotion as AbstractMotion
from mishutter.motion import ParabolicMotion as ParabolicMotion
from mishutter.motion import StillCamera as StillCamera
from mishutter.scene import Limits as Limits
from mishutter.scene import Scene as Scene
from mishutter.shutters import RASKAR_CODE as RASKAR_CODE
from mishutter.shutters import AbstractShutter as AbstractShutter
from mishutter.shutters import ChippedShutter as ChippedShutter
from mishutter.shutters import GaussianShutter as GaussianShutter
from mishutter.shutters import HannShutter as HannShutter
from mishutter.shutters import RectShutter as RectShutter
from mishutter.shutters import SplineShutter as SplineShutter
from mishutter.shutters import TriangleShutter as TriangleShutter
from mishutter.shutters import TukeyShutter as TukeyShutter
from mishutter.spectrum import condition_number as condition_number
from mishutter.spectrum import transfer_function as transfer_function

__version__ = "0.1.0"
