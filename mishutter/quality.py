"""How good a restored picture is: PSNR, SSIM, ghosts; whole, inside, and at the border."""

import numpy as np
from jaxtyping import ArrayLike

from mishutter.pictures import to_display
from mishutter.types import require


def psnr(reference: ArrayLike, estimate: ArrayLike, *, gamma: bool = True) -> float:
    r"""Peak signal-to-noise ratio, $-10 \log_{10} \overline{(f - \hat f)^2}$, white = 1.

    Args:
        reference: Linear light; any shape.
        estimate: Linear light; the same shape.
        gamma: Whether both are clipped and gamma-coded first (the paper's section 4.2);
            otherwise the error is taken in linear light, as `expected_psnr` is.

    Returns:
        dB; `inf` where the two agree.

    Raises:
        ValueError: if the shapes differ.
    """
    true, found = _pair("psnr", reference, estimate)
    if gamma:
        true, found = to_display(true), to_display(found)
    error = float(np.mean((true - found) ** 2))
    return -10 * np.log10(error) if error > 0 else float("inf")


def _pair(name: str, reference: ArrayLike, estimate: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
    true, found = np.asarray(reference, np.float64), np.asarray(estimate, np.float64)
    alike = true.shape == found.shape and true.size > 0
    require(alike, f"{name}(estimate=...)", f"have shape {true.shape}", f"shape {found.shape}")
    return true, found
