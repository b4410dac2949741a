"""Decoders: from a capture back to the picture."""

from mishutter.restore.decoders.base import AbstractDecoder as AbstractDecoder
from mishutter.restore.decoders.base import BlurModel as BlurModel
from mishutter.restore.decoders.base import blur_model as blur_model
from mishutter.restore.decoders.likelihood import (
    RichardsonLucyDecoder as RichardsonLucyDecoder,
)
from mishutter.restore.decoders.likelihood import richardson_lucy as richardson_lucy
from mishutter.restore.decoders.linear import EnsembleDecoder as EnsembleDecoder
from mishutter.restore.decoders.linear import WienerDecoder as WienerDecoder
from mishutter.restore.decoders.linear import expected_squared_error as expected_squared_error
from mishutter.restore.decoders.linear import squared_error_in as squared_error_in
from mishutter.restore.decoders.plug_and_play import PlugAndPlayDecoder as PlugAndPlayDecoder
from mishutter.restore.decoders.speed import SpeedEstimate as SpeedEstimate
from mishutter.restore.decoders.speed import estimate_speed as estimate_speed
from mishutter.restore.decoders.speed_finding import ROWS_TO_FIND as ROWS_TO_FIND
from mishutter.restore.decoders.speed_finding import SpeedFindingDecoder as SpeedFindingDecoder
from mishutter.restore.decoders.tikhonov import TikhonovDecoder as TikhonovDecoder
from mishutter.restore.decoders.total_variation import (
    TotalVariationDecoder as TotalVariationDecoder,
)
