"""The numbers of `figures.json`, figure by figure.

"The paper" is "Improved motion invariant imaging with time varying shutter functions".
"""

from typing import TypedDict

Curves = dict[str, list[float]]
"""Values over an axis, by the name of a shutter or a kernel."""


class Setting(TypedDict):
    """The camera of all figures, and the readings of the paper's speed axis."""

    stroke_px: float
    half_exposure_s: float
    electrons_at_white: float
    read_noise_e: float
    phase_px: float
    speed_readings: dict[str, float]
    decoder: str


class KernelNumbers(TypedDict):
    """Figure 3: kernels still and moving, and their difference over speed, by reading and shutter.

    `rms` is the root mean square difference from the still kernel, `relative_rms` its share of
    the still kernel's root mean square.
    """

    speed: list[float]
    kernels: dict[str, dict[str, Curves]]
    rms: dict[str, Curves]
    relative_rms: dict[str, Curves]


class SpectrumNumbers(TypedDict):
    """Figure 4: magnitudes over frequency in cycles/px, and condition numbers, by kernel."""

    stroke_px: float
    dft_length: int
    frequency: list[float]
    magnitude: Curves
    condition: dict[str, float]
    published: dict[str, float]


class PhotographNumbers(TypedDict):
    """Figure 5: PSNR in dB and energy of ghosts of a photograph over speed, by shutter."""

    speed: list[float]
    psnr: Curves
    ghost_energy: Curves


class PlainNumbers(TypedDict):
    """PSNR in dB by plain Richardson-Lucy over speed, by reading, photograph and shutter."""

    speed: list[float]
    psnr: dict[str, dict[str, Curves]]


class SpeedNumbers(TypedDict):
    """Figure 6: PSNR in dB over speed, by reading, photograph and shutter, and over noise."""

    speed: list[float]
    electrons: list[float]
    noise_nu: float
    psnr_over_speed: dict[str, dict[str, Curves]]
    psnr_over_noise: dict[str, Curves]


class Statement(TypedDict):
    """A published claim, whether it was met, and the numbers in words."""

    claim: str
    met: bool
    found: str


class FigureNumbers(TypedDict):
    """The numbers of all figures."""

    setting: Setting
    figure_3: KernelNumbers
    figure_4: SpectrumNumbers
    figure_5: dict[str, dict[str, PhotographNumbers]]
    plain_iterations: PlainNumbers
    figure_6: SpeedNumbers


class Numbers(FigureNumbers):
    """The numbers of all figures, and every statement of the paper beside them."""

    statements: list[Statement]
