"""Design of shutters for motion-invariant photography."""

from mishutter.decoders import AbstractDecoder as AbstractDecoder
from mishutter.decoders import BlurModel as BlurModel
from mishutter.decoders import EnsembleDecoder as EnsembleDecoder
from mishutter.decoders import RichardsonLucyDecoder as RichardsonLucyDecoder
from mishutter.decoders import WienerDecoder as WienerDecoder
from mishutter.decoders import blur_model as blur_model
from mishutter.kernel import binned_exposure as binned_exposure
from mishutter.kernel import blur_kernel as blur_kernel
from mishutter.motion import AbstractMotion as AbstractMotion
from mishutter.motion import ParabolicMotion as ParabolicMotion
from mishutter.motion import StillCamera as StillCamera
from mishutter.pictures import Picture as Picture
from mishutter.pictures import example_picture as example_picture
from mishutter.pictures import read_picture as read_picture
from mishutter.pictures import row_power_spectrum as row_power_spectrum
from mishutter.pictures import write_picture as write_picture
from mishutter.quality import psnr as psnr
from mishutter.restoration import RestoredPhotograph as RestoredPhotograph
from mishutter.restoration import deconvolve as deconvolve
from mishutter.restoration import restore_photograph as restore_photograph
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
from mishutter.simulate import simulate_capture as simulate_capture
from mishutter.spectrum import condition_number as condition_number
from mishutter.spectrum import transfer_function as transfer_function

__version__ = "0.1.0"
