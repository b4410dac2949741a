"""Design of shutters for motion-invariant photography.

Begin with `optimise(example_scene())`; `python -m mishutter` is the command line.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mishutter.blur import binned_exposure as binned_exposure
    from mishutter.blur import blur_kernel as blur_kernel
    from mishutter.blur import condition_number as condition_number
    from mishutter.blur import transfer_function as transfer_function
    from mishutter.camera import Frames as Frames
    from mishutter.camera import Layer as Layer
    from mishutter.camera import Layers as Layers
    from mishutter.camera import centred_kernel as centred_kernel
    from mishutter.camera import read_frames as read_frames
    from mishutter.camera import read_layers as read_layers
    from mishutter.camera import simulate_capture as simulate_capture
    from mishutter.decoding import AbstractDecoder as AbstractDecoder
    from mishutter.decoding import BlurModel as BlurModel
    from mishutter.decoding import EnsembleDecoder as EnsembleDecoder
    from mishutter.decoding import PlugAndPlayDecoder as PlugAndPlayDecoder
    from mishutter.decoding import RichardsonLucyDecoder as RichardsonLucyDecoder
    from mishutter.decoding import SpeedEstimate as SpeedEstimate
    from mishutter.decoding import SpeedFindingDecoder as SpeedFindingDecoder
    from mishutter.decoding import TikhonovDecoder as TikhonovDecoder
    from mishutter.decoding import TotalVariationDecoder as TotalVariationDecoder
    from mishutter.decoding import WienerDecoder as WienerDecoder
    from mishutter.decoding import capture_and_restore as capture_and_restore
    from mishutter.decoding import deconvolve as deconvolve
    from mishutter.decoding import estimate_speed as estimate_speed
    from mishutter.decoding import psnr as psnr
    from mishutter.decoding import restore as restore
    from mishutter.decoding import restore_photograph as restore_photograph
    from mishutter.decoding import richardson_lucy as richardson_lucy
    from mishutter.design import Design as Design
    from mishutter.design import Outcome as Outcome
    from mishutter.evaluation import AbstractLoss as AbstractLoss
    from mishutter.evaluation import AbstractResponseLoss as AbstractResponseLoss
    from mishutter.evaluation import DesignLoss as DesignLoss
    from mishutter.evaluation import ExpectedErrorLoss as ExpectedErrorLoss
    from mishutter.evaluation import FoundSpeedLoss as FoundSpeedLoss
    from mishutter.evaluation import KnownSpeedLoss as KnownSpeedLoss
    from mishutter.evaluation import Metrics as Metrics
    from mishutter.evaluation import WorstSpeedLoss as WorstSpeedLoss
    from mishutter.evaluation import ceiling as ceiling
    from mishutter.evaluation import evaluate as evaluate
    from mishutter.evaluation import tolerance_costs as tolerance_costs
    from mishutter.hardware import Drive as Drive
    from mishutter.hardware import DriveTable as DriveTable
    from mishutter.hardware import FittedCamera as FittedCamera
    from mishutter.hardware import SensorLevels as SensorLevels
    from mishutter.hardware import TargetPicture as TargetPicture
    from mishutter.hardware import design_from_drive as design_from_drive
    from mishutter.hardware import drive_table as drive_table
    from mishutter.hardware import fit as fit
    from mishutter.hardware import measured_profile as measured_profile
    from mishutter.hardware import read_drive as read_drive
    from mishutter.hardware import read_measurements as read_measurements
    from mishutter.hardware import read_trace as read_trace
    from mishutter.model import RASKAR_CODE as RASKAR_CODE
    from mishutter.model import AbstractPiecewiseShutter as AbstractPiecewiseShutter
    from mishutter.model import AbstractShutter as AbstractShutter
    from mishutter.model import Burst as Burst
    from mishutter.model import ChippedShutter as ChippedShutter
    from mishutter.model import FirstOrderShutter as FirstOrderShutter
    from mishutter.model import FreeMotion as FreeMotion
    from mishutter.model import GaussianShutter as GaussianShutter
    from mishutter.model import HannShutter as HannShutter
    from mishutter.model import IdealShutter as IdealShutter
    from mishutter.model import Limits as Limits
    from mishutter.model import LinearMotion as LinearMotion
    from mishutter.model import Occlusion as Occlusion
    from mishutter.model import ParabolicMotion as ParabolicMotion
    from mishutter.model import RectShutter as RectShutter
    from mishutter.model import Scene as Scene
    from mishutter.model import SecondOrderStage as SecondOrderStage
    from mishutter.model import SplineShutter as SplineShutter
    from mishutter.model import StillCamera as StillCamera
    from mishutter.model import SwitchedShutter as SwitchedShutter
    from mishutter.model import Tolerances as Tolerances
    from mishutter.model import TriangleShutter as TriangleShutter
    from mishutter.model import TukeyShutter as TukeyShutter
    from mishutter.model import baselines as baselines
    from mishutter.model import example_scene as example_scene
    from mishutter.model import read_scene as read_scene
    from mishutter.model import register_shutter as register_shutter
    from mishutter.model import stage_path as stage_path
    from mishutter.pictures import Picture as Picture
    from mishutter.pictures import example_picture as example_picture
    from mishutter.pictures import read_picture as read_picture
    from mishutter.pictures import row_power_spectrum as row_power_spectrum
    from mishutter.pictures import write_picture as write_picture
    from mishutter.report import Comparison as Comparison
    from mishutter.report import compare as compare
    from mishutter.search import NonFiniteLossError as NonFiniteLossError
    from mishutter.search import SearchFailedError as SearchFailedError
    from mishutter.search import optimise as optimise
    from mishutter.search import starting_shutter as starting_shutter
    from mishutter.sweeps import best_points as best_points
    from mishutter.sweeps import gain_over as gain_over
    from mishutter.sweeps import gain_over_snapshot as gain_over_snapshot
    from mishutter.sweeps import light_map as light_map
    from mishutter.sweeps import pareto_front as pareto_front
    from mishutter.sweeps import sweep as sweep
else:

    def __getattr__(name: str) -> Any:
        """A public name or a folder, imported when it is first asked for."""
        if name in __all__:
            folders = (import_module(f"{__name__}.{folder}") for folder in _FOLDERS)
            globals()[name] = next(vars(x)[name] for x in folders if name in vars(x))
            return globals()[name]
        if name in _FOLDERS:
            return import_module(f"{__name__}.{name}")
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

    def __dir__() -> list[str]:
        return sorted({*globals(), *__all__})


__version__ = "0.2.0"

_FOLDERS = (
    "pictures",
    "model",
    "blur",
    "evaluation",
    "design",
    "hardware",
    "search",
    "camera",
    "decoding",
    "sweeps",
    "report",
)
"""Folders of the public names, in an order in which each imports only those before it."""

__all__ = [
    "RASKAR_CODE",
    "AbstractDecoder",
    "AbstractLoss",
    "AbstractPiecewiseShutter",
    "AbstractResponseLoss",
    "AbstractShutter",
    "BlurModel",
    "Burst",
    "ChippedShutter",
    "Comparison",
    "Design",
    "DesignLoss",
    "Drive",
    "DriveTable",
    "EnsembleDecoder",
    "ExpectedErrorLoss",
    "FirstOrderShutter",
    "FittedCamera",
    "FoundSpeedLoss",
    "Frames",
    "FreeMotion",
    "GaussianShutter",
    "HannShutter",
    "IdealShutter",
    "KnownSpeedLoss",
    "Layer",
    "Layers",
    "Limits",
    "LinearMotion",
    "Metrics",
    "NonFiniteLossError",
    "Occlusion",
    "Outcome",
    "ParabolicMotion",
    "Picture",
    "PlugAndPlayDecoder",
    "RectShutter",
    "RichardsonLucyDecoder",
    "Scene",
    "SearchFailedError",
    "SecondOrderStage",
    "SensorLevels",
    "SpeedEstimate",
    "SpeedFindingDecoder",
    "SplineShutter",
    "StillCamera",
    "SwitchedShutter",
    "TargetPicture",
    "TikhonovDecoder",
    "Tolerances",
    "TotalVariationDecoder",
    "TriangleShutter",
    "TukeyShutter",
    "WienerDecoder",
    "WorstSpeedLoss",
    "baselines",
    "best_points",
    "binned_exposure",
    "blur_kernel",
    "capture_and_restore",
    "ceiling",
    "centred_kernel",
    "compare",
    "condition_number",
    "deconvolve",
    "design_from_drive",
    "drive_table",
    "estimate_speed",
    "evaluate",
    "example_picture",
    "example_scene",
    "fit",
    "gain_over",
    "gain_over_snapshot",
    "light_map",
    "measured_profile",
    "optimise",
    "pareto_front",
    "psnr",
    "read_drive",
    "read_frames",
    "read_layers",
    "read_measurements",
    "read_picture",
    "read_scene",
    "read_trace",
    "register_shutter",
    "restore",
    "restore_photograph",
    "richardson_lucy",
    "row_power_spectrum",
    "simulate_capture",
    "stage_path",
    "starting_shutter",
    "sweep",
    "tolerance_costs",
    "transfer_function",
    "write_picture",
]
