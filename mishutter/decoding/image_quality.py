"""Quality of a restored picture: PSNR and ghosts.

"The paper" is "Improved motion invariant imaging with time varying shutter functions".
"""

import numpy as np
from jaxtyping import ArrayLike, Float

from mishutter._core.checks import floating_light, require, require_finite, shape_of
from mishutter.pictures.images import to_display

_ROWS_AT_ONCE = 128


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
    weight, shape, total = None, truth.shape, 0.0
    if matte is not None:
        share = np.asarray(matte, np.float64)
        has_weight = share.shape == shape[:2] and float(np.sum(share)) > 0
        require(has_weight, "psnr(matte=...)", f"have shape {shape[:2]} and weight", share.shape)
        weight = share.reshape(share.shape + (1,) * (len(shape) - 2)) / np.mean(share)
    truth, restored = (x[None] if x.ndim == 0 else x for x in (truth, restored))
    for first in range(0, len(truth), _ROWS_AT_ONCE):
        rows = slice(first, first + _ROWS_AT_ONCE)
        pair = [np.asarray(x[rows], np.float64) for x in (truth, restored)]
        pair = [to_display(x) for x in pair] if gamma else pair
        squared = (pair[0] - pair[1]) ** 2
        total += float(np.sum(squared if weight is None else squared * weight[rows]))
    error = total / truth.size
    return float(-10 * np.log10(error)) if error > 0 else float("inf")


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
    truth, restored = _alike("ghost_energy", reference, estimate)
    requirement = "have rows and columns, or channels after them"
    is_picture = truth.ndim in (2, 3)
    require(is_picture, "ghost_energy(reference=...)", requirement, shape_of(truth))
    truth, restored = truth.astype(np.float64), restored.astype(np.float64)
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
