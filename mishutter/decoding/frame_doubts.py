"""Frames of one picture, along one axis or in the plane: what is trusted of them, and why not."""

import itertools
import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from mishutter.decoding.decoders.speed import LITTLE

TRIED_BEYOND = 0.03
"""Share of the range of the scene's speeds that is tried beyond either end."""
DARK = 1e-12
"""Least variance of the noise, for pictures without light or noise; white = 1."""
LEAST_DETAIL = 1e-4
"""Least detail of a picture, over that which the scene expects."""
BANDS = 6
"""Bands of frequencies in which a picture's power is estimated."""

# What is trusted: `python -m benchmarks.trust` shows what these numbers keep and catch.
LEAD, _LEAD_OF_ROW, _OTHER_ROWS = 100.0, 30.0, 0.1
"""Logarithm of likelihood by which the speed that is found must lead, that by which a row prefers
another, and the share of such rows that is doubted."""
WORTH = 0.1
"""Share of the likelihood that counts in weights: photographs are no Gaussian rows, and alike from
row to row."""
REGISTERED = 1.0
"""Error of a picture's way over the sequence above which no speed is trusted; px."""
FLOOR = 0.005
"""Least error of a picture's way over the sequence; px."""
_MISFITS, _UNEXPLAINED = (1.25, 1.8), (0.45, 0.25)
"""Misfits from which frames are doubted, and their least share of the misfit of frames that are
registered elsewhere: bright frames show all that a camera does besides."""
_AS_WELL = 0.25
"""Part of the way to that misfit within which another speed fits as well."""
_SHIFT, _SURE_SHIFT = 0.35, 4.0
"""Shift of one frame from where its time puts it that is doubted, px, and in its own errors."""
_OTHER, _OTHER_SHARE = 0.4, 0.5
"""Misfit of one frame above the middle one of all that is doubted, over the misfit of all, and as a
share of that of frames registered elsewhere."""
FLICKER, LARGEST_SHIFT = 0.2, 10.0
"""Gain and shift, px, by which a frame may differ from the others, as standard deviations."""
SHARED = 0.2
"""Least share of a frame that a neighbouring one must see."""
BLACK, _SATURATED = 0.1, 0.5
"""Level of a black frame over that of the brightest, and share of equal pixels of a saturated one.
"""


class Rival(NamedTuple):
    """Another motion that frames may show."""

    name: str  # The motion in words, but for its unit
    below: float  # Logarithm of the likelihood by which it is below the highest
    misfit: float  # Misfit there
    # Logarithm of the likelihood of each part of the picture, over that at the motion found
    gains: Float[np.ndarray, "parts"]


def odd_frame(
    rows: Float[np.ndarray, "rows frames columns"], noises: Float[np.ndarray, "frames"]
) -> str:
    """A sentence that says which frame is black or saturated, if one is."""
    levels, count = np.mean(rows, axis=(0, 2)), rows.shape[0] * rows.shape[2]
    errors = np.sqrt(noises / count)
    brightest = float(np.max(levels))
    is_black = (levels < BLACK * brightest) & (levels < brightest - _SURE_SHIFT * errors)
    # Neighbours are alike in the dark part of a picture, and not in noise.
    unlike = np.mean(np.diff(rows, axis=-1) ** 2, axis=(0, 2))
    is_black &= unlike >= np.var(rows, axis=(0, 2))
    is_top = np.mean(rows == np.max(rows, axis=(0, 2), keepdims=True), axis=(0, 2)) > _SATURATED
    is_top &= levels >= np.median(levels)
    for is_odd, word in ((is_top, "saturated"), (is_black, "black")):
        if np.any(is_odd) and not np.all(is_odd):
            return f"Frame {int(np.argmax(is_odd)) + 1} of {len(levels)} is {word}."
    return ""


def equal_frames(
    rows: Float[np.ndarray, "rows frames columns"], places: list[float] | list[complex]
) -> str:
    """Words for two frames that are the same, though at places that are not, if two are."""
    for first, second in itertools.combinations(range(len(places)), 2):
        is_apart = abs(places[first] - places[second]) > 1
        if is_apart and np.array_equal(rows[:, first], rows[:, second]):
            return f"frames {first + 1} and {second + 1} are the same"
    return ""


def doubt_of_fit(misfit: float, elsewhere: float, same: str, motion: str, reasons: str) -> str:
    """The doubt of frames that do not fit one picture as they should, or of which two are equal."""
    expected, limits = _expected(elsewhere), zip(_MISFITS, _UNEXPLAINED, strict=True)
    if any(misfit > least and misfit - 1 > share * expected for least, share in limits):
        because = same or f"{reasons}, or more noise than the scene says"
        return (
            f"The frames do not fit one picture at one {motion} "
            f"(misfit {misfit:.3g}, 1 if they do): {because}."
        )
    return f"{same[0].upper()}{same[1:]}, though the picture moves between them." if same else ""


def doubt_of_one_frame(
    shifts: Float[np.ndarray, "frames axes"],  # px
    shift_errors: Float[np.ndarray, "frames axes"],  # px
    misfits: Float[np.ndarray, "frames"],
    spread: float,
    elsewhere: float,
    *,
    reasons: str,
) -> str:
    """The doubt of a frame that is not where its time puts it, or shows another picture."""
    sure = np.maximum(_SHIFT, _SURE_SHIFT * math.sqrt(spread) * shift_errors)
    far = np.max(np.abs(shifts) / sure, axis=1)
    others = misfits - np.median(misfits)
    if np.max(far) > 1:
        which = int(np.argmax(far))
        off = ", ".join(f"{shift:+.1f}" for shift in shifts[which])
        return f"Frame {which + 1} of {far.size} is {off} px off its place: {reasons}."
    if np.max(others) > max(_OTHER * spread, _OTHER_SHARE * _expected(elsewhere)):
        which = int(np.argmax(others))
        frame = f"Frame {which + 1} of {far.size} does not fit the picture of the others"
        return f"{frame} (misfit {misfits[which]:.3g}): {reasons}."
    return ""


def doubt_of_rivals(
    rivals: Iterable[Rival],
    misfit: float,
    elsewhere: float,
    spread: float,
    parts: str,
    *,
    little: bool,
) -> str:
    """The doubt of a motion that another equals, in the picture or in parts of it."""
    as_well = misfit + _AS_WELL * max(elsewhere - misfit, 0.0)
    for rival in rivals:
        prefers = np.mean(rival.gains > _LEAD_OF_ROW * spread)
        if prefers > _OTHER_ROWS:
            return f"At {rival.name} px/s {prefers:.0%} {parts}: there may be two objects."
        if rival.below < LEAD * spread or rival.misfit <= as_well:
            if little:
                return LITTLE
            as_another = f"The frames fit {rival.name} px/s as well"
            return f"{as_another}, as those of a regular pattern or of two objects do."
    return ""


def _expected(elsewhere: float) -> float:
    """The part of the misfit of frames that are registered elsewhere which is not noise."""
    return max(elsewhere - 1, 1e-9)
