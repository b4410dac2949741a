"""Decoders: from a capture back to the picture."""

from mishutter.decoding.decoders.base import AbstractDecoder as AbstractDecoder
from mishutter.decoding.decoders.base import BlurModel as BlurModel
from mishutter.decoding.decoders.base import blur_model as blur_model
from mishutter.decoding.decoders.likelihood import (
    RichardsonLucyDecoder as RichardsonLucyDecoder,
)
from mishutter.decoding.decoders.likelihood import richardson_lucy as richardson_lucy
from mishutter.decoding.decoders.linear import EnsembleDecoder as EnsembleDecoder
from mishutter.decoding.decoders.linear import WienerDecoder as WienerDecoder
from mishutter.decoding.decoders.linear import expected_squared_error as expected_squared_error
from mishutter.decoding.decoders.linear import squared_error_in as squared_error_in
from mishutter.decoding.decoders.plug_and_play import PlugAndPlayDecoder as PlugAndPlayDecoder
from mishutter.decoding.decoders.speed import SpeedEstimate as SpeedEstimate
from mishutter.decoding.decoders.speed import estimate_speed as estimate_speed
from mishutter.decoding.decoders.speed_finding import ROWS_TO_FIND as ROWS_TO_FIND
from mishutter.decoding.decoders.speed_finding import SpeedFindingDecoder as SpeedFindingDecoder
from mishutter.decoding.decoders.tikhonov import TikhonovDecoder as TikhonovDecoder
from mishutter.decoding.decoders.total_variation import (
    TotalVariationDecoder as TotalVariationDecoder,
)
