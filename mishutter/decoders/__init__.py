"""Decoders: from a capture back to the picture."""

from mishutter.decoders.base import AbstractDecoder as AbstractDecoder
from mishutter.decoders.base import BlurModel as BlurModel
from mishutter.decoders.base import blur_model as blur_model
from mishutter.decoders.linear import EnsembleDecoder as EnsembleDecoder
from mishutter.decoders.linear import WienerDecoder as WienerDecoder
from mishutter.decoders.linear import expected_squared_error as expected_squared_error
from mishutter.decoders.richardson_lucy import RichardsonLucyDecoder as RichardsonLucyDecoder
from mishutter.decoders.richardson_lucy import richardson_lucy as richardson_lucy
from mishutter.decoders.tikhonov import TikhonovDecoder as TikhonovDecoder
from mishutter.decoders.total_variation import TotalVariationDecoder as TotalVariationDecoder
