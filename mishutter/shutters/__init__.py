"""Shutters: transmittance profiles over one exposure."""

from mishutter.shutters.base import AbstractAdjustableShutter as AbstractAdjustableShutter
from mishutter.shutters.base import AbstractPiecewiseShutter as AbstractPiecewiseShutter
from mishutter.shutters.base import AbstractShutter as AbstractShutter
from mishutter.shutters.chips import RASKAR_CODE as RASKAR_CODE
from mishutter.shutters.chips import ChippedShutter as ChippedShutter
from mishutter.shutters.sampled import SampledShutter as SampledShutter
from mishutter.shutters.sampled import piecewise as piecewise
from mishutter.shutters.spline import SplineShutter as SplineShutter
from mishutter.shutters.windows import GaussianShutter as GaussianShutter
from mishutter.shutters.windows import HannShutter as HannShutter
from mishutter.shutters.windows import RectShutter as RectShutter
from mishutter.shutters.windows import TriangleShutter as TriangleShutter
from mishutter.shutters.windows import TukeyShutter as TukeyShutter
