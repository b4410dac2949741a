"""Restoration of captures: decoders, borders and image quality."""

from mishutter.restore.decoders import ROWS_TO_FIND as ROWS_TO_FIND
from mishutter.restore.decoders import AbstractDecoder as AbstractDecoder
from mishutter.restore.decoders import BlurModel as BlurModel
from mishutter.restore.decoders import EnsembleDecoder as EnsembleDecoder
from mishutter.restore.decoders import RichardsonLucyDecoder as RichardsonLucyDecoder
from mishutter.restore.decoders import SpeedEstimate as SpeedEstimate
from mishutter.restore.decoders import SpeedFindingDecoder as SpeedFindingDecoder
from mishutter.restore.decoders import TikhonovDecoder as TikhonovDecoder
from mishutter.restore.decoders import TotalVariationDecoder as TotalVariationDecoder
from mishutter.restore.decoders import WienerDecoder as WienerDecoder
from mishutter.restore.decoders import blur_model as blur_model
from mishutter.restore.decoders import estimate_speed as estimate_speed
from mishutter.restore.decoders import richardson_lucy as richardson_lucy
from mishutter.restore.decoders import squared_error_in as squared_error_in
from mishutter.restore.image_quality import Quality as Quality
from mishutter.restore.image_quality import ghost_energy as ghost_energy
from mishutter.restore.image_quality import measure_quality as measure_quality
from mishutter.restore.image_quality import psnr as psnr
from mishutter.restore.image_quality import ssim as ssim
from mishutter.restore.restoration import RestoredPhotograph as RestoredPhotograph
from mishutter.restore.restoration import deconvolve as deconvolve
from mishutter.restore.restoration import least_columns as least_columns
from mishutter.restore.restoration import restore_by_each as restore_by_each
from mishutter.restore.restoration import restore_photograph as restore_photograph
from mishutter.restore.simulation import Simulation as Simulation
from mishutter.restore.simulation import capture_and_restore as capture_and_restore
