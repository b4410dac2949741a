"""Quality of a restored picture: PSNR, SSIM, ghosts; whole, inside, and at the border.

"The paper" is "Improved motion invariant imaging with time varying shutter functions".
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import ArrayLike, Float

from mishutter._core.checks import (
    floating_light,
    require,
    require_finite,
    require_positive_int,
    shape_of,
)
from mishutter.pictures.images import to_display

_ROWS_AT_ONCE = 128


class Quality(NamedTuple):
    """Figures of a restored picture."""

    psnr: float  # Of gamma-coded values, over the picture; dB
    linear_psnr: float  # In linear light; dB
    inner_psnr: float  # With gamma, without the border; dB
    border_psnr: float  # With gamma, of the border alone; dB
    ssim: float  # Structural similarity of the gamma-coded pictures, over the picture
    inner_ssim: float  # The same without the border


def psnr(
    reference: ArrayLike,
    estimate: ArrayLike,
    *,
    gamma: bool = False,
    matte: ArrayLike | None = None,
) -> float:
    r"""Peak signal-to-noise ratio, $-10 \log_{10} \overline{(f - \hat f)^2}$, white = 1.

    Args:
        reference: Linear light; any shape.
        estimate: Linear light; the same shape.
        gamma: Whether both are clipped and gamma-coded first (the paper's section 4.2); by
            default the error is taken in linear light, as that of every expected PSNR is.
        matte: Weight of each pixel in the mean, for the PSNR of one layer; shape
            `(rows, columns)`.

    Returns:
        dB; `inf` where the two agree.

    Raises:
        ValueError: if the shapes differ, a value is not finite, or the matte is empty.
    """
    truth, restored = _alike("psnr", reference, estimate)
    weight = None if matte is None else _weights("psnr", truth.shape, matte)
    total = 0.0
    truth, restored = (x[None] if x.ndim == 0 else x for x in (truth, restored))
    for first in range(0, len(truth), _ROWS_AT_ONCE):
        rows = slice(first, first + _ROWS_AT_ONCE)
        pair = [np.asarray(x[rows], np.float64) for x in (truth, restored)]
        pair = [to_display(x) for x in pair] if gamma else pair
        squared = (pair[0] - pair[1]) ** 2
        total += float(np.sum(squared if weight is None else squared * weight[rows]))
    error = total / truth.size
    return float(-10 * np.log10(error)) if error > 0 else float("inf")


def ssim(reference: ArrayLike, estimate: ArrayLike, *, matte: ArrayLike | None = None) -> float:
    """Structural similarity of two gamma-coded pictures, as scikit-image defines it.

    Raises:
        ValueError: if the shapes differ, a value is not finite, the picture is smaller than
            the 7 x 7 window, or the matte is empty.
    """
    from skimage.metrics import structural_similarity

    truth, restored = (to_display(x) for x in _pair("ssim", reference, estimate))
    sides = truth.shape[:2]
    require(min(sides) >= 7, "ssim(reference=...)", "be at least 7 x 7 px", shape_of(truth))
    axis = -1 if truth.ndim == 3 else None
    parts: Any = structural_similarity(
        truth, restored, data_range=1.0, channel_axis=axis, full=True
    )
    if matte is None:
        return float(parts[0])
    return float(np.mean(parts[1] * _weights("ssim", truth.shape, matte)))


def measure_quality(reference: ArrayLike, estimate: ArrayLike, *, border: int) -> Quality:
    """All figures of a restored picture, with and without `border` columns at either end.

    Raises:
        ValueError: if the shapes differ, a value is not finite, `border` is not a positive
            integer, or nothing is left between the borders.
    """
    require_positive_int("measure_quality(border=...)", border)
    truth, restored = _pair("measure_quality", reference, estimate)
    columns = truth.shape[1]
    is_wide = columns >= 2 * border + 7
    require(is_wide, "measure_quality(border=...)", f"leave 7 of the {columns} columns", border)
    inner = np.s_[:, border : columns - border]
    outer = np.r_[0:border, columns - border : columns]
    return Quality(
        psnr=psnr(truth, restored, gamma=True),
        linear_psnr=psnr(truth, restored),
        inner_psnr=psnr(truth[inner], restored[inner], gamma=True),
        border_psnr=psnr(truth[:, outer], restored[:, outer], gamma=True),
        ssim=ssim(truth, restored),
        inner_ssim=ssim(truth[inner], restored[inner]),
    )


def ghost_energy(
    reference: ArrayLike, estimate: ArrayLike, *, distance: float, width: int = 3
) -> float:
    r"""Energy of the picture's echo in the error of its restoration.

    The paper calls it ghosting: where a kernel ends abruptly, the restoration holds a
    faint copy of the picture's edges displaced by the kernel's length. With the rows'
    differences $u$ of the picture and $e$ of the error, $\rho(d) = \sum e_{k+d} u_k / \sum
    u_k^2$ is the amplitude of the copy at displacement $d$; the energy is
    $\max \rho(d)^2$ over `distance` to within `width` px, to either side.

    Raises:
        ValueError: if the shapes differ, a value is not finite, `distance` or `width` is below 0,
            or the picture is narrower than twice the distance and a few `width`.
    """
    require(width >= 0, "ghost_energy(width=...)", "be at least 0 px", width)
    truth, restored = _pair("ghost_energy", reference, estimate)
    truth, restored = (x[..., None] if x.ndim == 2 else x for x in (truth, restored))
    subject = "ghost_energy(distance=...)"
    require_finite(subject, distance)
    require(distance >= 0, subject, "be at least 0 px", distance)
    columns, reach = truth.shape[1], round(distance) + 4 * width
    require(reach < columns // 2, subject, f"be well below half of {columns} px", distance)
    edges = np.diff(truth, axis=1)
    error = np.diff(restored - truth, axis=1)
    size = float(np.sum(edges**2))
    if size == 0:
        return 0.0

    def echo(shift: int) -> float:
        source, copy = (edges[:, : columns - 1 - shift], error[:, shift:])
        if shift < 0:
            source, copy = edges[:, -shift:], error[:, : columns - 1 + shift]
        return float(np.sum(source * copy)) / size

    shifts = range(round(distance) - width, round(distance) + width + 1)
    return max(echo(sign * d) ** 2 for d in shifts for sign in (1, -1))


def _weights(name: str, shape: tuple, matte: ArrayLike) -> np.ndarray:
    """Weights of the rows and columns of an array of `shape`, of mean 1."""
    weight = np.asarray(matte, np.float64)
    has_weight = weight.shape == shape[:2] and float(np.sum(weight)) > 0
    require(has_weight, f"{name}(matte=...)", f"have shape {shape[:2]} and weight", weight.shape)
    return weight.reshape(weight.shape + (1,) * (len(shape) - 2)) / np.mean(weight)


def _alike(
    name: str, reference: ArrayLike, estimate: ArrayLike
) -> tuple[Float[np.ndarray, "*shape"], Float[np.ndarray, "*shape"]]:
    truth = floating_light(reference, f"{name}(reference=...)")
    restored = floating_light(estimate, f"{name}(estimate=...)")
    are_alike = truth.shape == restored.shape and truth.size > 0
    require(are_alike, f"{name}(estimate=...)", f"have shape {truth.shape}", shape_of(restored))
    for argument, values in (("reference", truth), ("estimate", restored)):
        is_finite = bool(np.all(np.isfinite(values)))
        require(is_finite, f"{name}({argument}=...)", "be finite", "a value that is not")
    return truth, restored


def _pair(
    name: str, reference: ArrayLike, estimate: ArrayLike
) -> tuple[Float[np.ndarray, "*shape"], Float[np.ndarray, "*shape"]]:
    """Two pictures of one shape, in double precision."""
    truth, restored = _alike(name, reference, estimate)
    requirement = "have rows and columns, or channels after them"
    require(truth.ndim in (2, 3), f"{name}(reference=...)", requirement, shape_of(truth))
    return truth.astype(np.float64), restored.astype(np.float64)
