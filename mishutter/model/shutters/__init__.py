"""Shutters: transmittance profiles over one exposure."""

from mishutter.model.shutters.base import AbstractAdjustableShutter as AbstractAdjustableShutter
from mishutter.model.shutters.base import AbstractPiecewiseShutter as AbstractPiecewiseShutter
from mishutter.model.shutters.base import AbstractShutter as AbstractShutter
from mishutter.model.shutters.chips import RASKAR_CODE as RASKAR_CODE
from mishutter.model.shutters.chips import ChippedShutter as ChippedShutter
from mishutter.model.shutters.interpolated import SampledShutter as SampledShutter
from mishutter.model.shutters.interpolated import piecewise as piecewise
from mishutter.model.shutters.spline import SplineShutter as SplineShutter
from mishutter.model.shutters.windows import GaussianShutter as GaussianShutter
from mishutter.model.shutters.windows import HannShutter as HannShutter
from mishutter.model.shutters.windows import RectShutter as RectShutter
from mishutter.model.shutters.windows import TriangleShutter as TriangleShutter
from mishutter.model.shutters.windows import TukeyShutter as TukeyShutter
