"""Frames of one picture, along one axis or in the plane: what is trusted of them, and why not.

`python -m benchmarks.trust` shows what the numbers here keep and catch.
"""

import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from mishutter.decoding.decoders.speed import LITTLE
from mishutter.decoding.likeliest import Fit
from mishutter.model.sensor import RowsRead, Sensor

TRIED_BEYOND = 0.03
"""Share of the range of the scene's speeds that is tried beyond either end."""

_LEAD = 100.0
"""Logarithm of likelihood by which the speed that is found must lead."""
WORTH = 0.1
"""Share of the likelihood that counts in weights: photographs are no Gaussian rows, and alike from
row to row."""
FLOOR = 0.005
"""Least error of a picture's way over the sequence; px."""
_SURE_SHIFT = 4.6
"""Standard errors beyond which a frame's shift or level is certain."""
ROLLS_ABOVE = 1.03
"""Misfit above which rows that are exposed in turn are tried."""
BLACK = 0.1
"""Level of a black frame over that of the brightest."""


class Words(NamedTuple):
    """Words for the motions of a kind."""

    motion: str
    reasons: str  # Why frames may fit none
    parts: str  # Parts of a picture that fit another
    beyond: str  # A sentence for a motion that is none of the scene's


class Rival(NamedTuple):
    """Another motion that frames may show."""

    motion: Float[np.ndarray, "*axes"] | float  # px/s
    below: float  # Logarithm of the likelihood by which it is below the highest
    fit: Fit  # How the frames fit there


class Evidence(NamedTuple):
    """Evidence for and against the motion that was found in frames."""

    frames: Float[np.ndarray, "frames rows columns"]  # The frames as they came
    noises: Float[np.ndarray, "frames"]  # Variance of the noise in each
    places: Float[np.ndarray, "axes frames"]  # The picture's in each, along rows first; px
    fit: Fit  # How the frames fit
    compared: Fit  # How they fit on the pixels by which motions are compared
    elsewhere: float  # Misfit on these of frames that are registered some pixels off
    rivals: list[Rival]  # The other peaks of the likelihood
    lead: float  # Logarithm of the likelihood, over that of no picture
    middle: float  # Median of the logarithm over all motions, below its top
    is_within: bool  # Whether the motion is one of the scene's
    is_only: bool = False  # Whether the scene has no other

    def doubt(self, error: float, words: Words) -> str:
        """Why the motion, to an error as a displacement over the frames, px, is not trusted."""
        return (
            odd_frame(self.frames, self.noises)
            or _doubt_of_fit(self, words)
            # Frames that tell nothing do not tell which of them is off either.
            or (LITTLE if not self.is_only and self.lead < _LEAD * self.fit.spread else "")
            or _doubt_of_one_frame(self, words)
            or _doubt_of_steps(self)
            or ("" if self.is_only else _doubt_of_rivals(self, error, words))
        )


def doubt_of_rows(
    sensor: Sensor,
    exposure: float,
    counts: dict[int, int],
    misfit_by: Callable[[Sensor, int], float],
) -> str:
    """The doubt of frames that rows which are exposed otherwise in turn explain better.

    Counts are those of pixels, by how many along a side are binned. Readouts are tried on the
    largest: of a global shutter longer ones, unless a shorter one adds a quarter to what is above
    1, and of a rolling one half, twice, reversed and none of its own, which holds where it is the
    best of these. The best is judged there and on the finer ones, whose detail counts as noise in
    larger: where there is a misfit it leads in likelihood, by an eighth of what is above 1 at
    least. Noise of bright points in the dark is there too, whatever the readout.
    """
    coarse, own = max(counts), sensor.readout_time
    misfit, shares = misfit_by(sensor, coarse), (0.25 * exposure, 0.5 * exposure, exposure)
    least, best = math.inf, sensor
    for readout in (0.0, own / 2, own, 2 * own) if own else shares:
        ways: tuple[RowsRead, ...] = ("down", "up") if readout else (sensor.rows_read,)
        every = [replace(sensor, readout=readout, rows_read=way) for way in ways]
        tried = [x for x in every if not (own == readout and x.rows_read == sensor.rows_read)]
        misfits = [misfit_by(each, coarse) for each in tried]
        if min(misfits) < least:
            least, best = min(misfits), tried[int(np.argmin(misfits))]
        if not own and min(misfits) - misfit > 0.25 * (misfit - 1):
            break
    if own and least >= misfit:
        return ""
    for size in sorted(counts, reverse=True):
        if size != coarse:
            misfit, least = misfit_by(sensor, size), misfit_by(best, size)
        enough = max(2 * _LEAD * misfit / counts[size], 0.125 * (misfit - 1))
        if misfit >= ROLLS_ABOVE and misfit - least > enough:
            fits = f"fits the frames better (misfit {least:.3g}, not {misfit:.3g})"
            if not best.is_rolling:
                return f"A global shutter {fits}: the scene has a readout."
            return (
                f"A rolling shutter of about {best.readout_time * 1e3:.2g} ms from the first row "
                f"to the last, read {best.rows_read}, {fits}: give the scene its readout."
            )
    return ""


def odd_frame(
    frames: Float[np.ndarray, "frames rows columns"], noises: Float[np.ndarray, "frames"]
) -> str:
    """A sentence that says which frame is black or saturated, if one is."""
    levels, pixels = np.mean(frames, axis=(1, 2)), (1, 2)
    errors = np.sqrt(noises / frames[0].size)
    brightest = float(np.max(levels))
    is_black = (levels < BLACK * brightest) & (levels < brightest - _SURE_SHIFT * errors)
    # Neighbours are alike in the dark part of a picture, and not in noise.
    unlike = np.mean(np.diff(frames, axis=-1) ** 2, axis=pixels)
    is_black &= unlike >= np.var(frames, axis=pixels)
    is_top = np.mean(frames == np.max(frames, axis=pixels, keepdims=True), axis=pixels)
    is_saturated = (is_top > 0.5) & (levels >= np.median(levels))
    for is_odd, word in ((is_saturated, "saturated"), (is_black, "black")):
        if np.any(is_odd) and not np.all(is_odd):
            return f"Frame {int(np.argmax(is_odd)) + 1} of {len(levels)} is {word}."
    return ""


def _doubt_of_fit(found: Evidence, words: Words) -> str:
    """The doubt of frames that do not fit one picture as they should, or of which two are equal."""
    misfit, expected, same = found.compared.misfit, _expected(found), ""
    for first, second in itertools.combinations(range(len(found.frames)), 2):
        is_apart = np.linalg.norm(found.places[:, first] - found.places[:, second]) > 1
        if is_apart and np.array_equal(found.frames[first], found.frames[second]):
            same = f"frames {first + 1} and {second + 1} are the same"
            break
    # Bright frames show all that a camera does besides: their misfit is also a large part of that
    # of frames that are registered elsewhere.
    limits = (1.25, 0.45), (1.8, 0.25)
    if any(misfit > least and misfit - 1 > share * expected for least, share in limits):
        because = same or f"{words.reasons}, or more noise than the scene says"
        return (
            f"The frames do not fit one picture at one {words.motion} "
            f"(misfit {misfit:.3g}, 1 if they do): {because}."
        )
    return f"{same[0].upper()}{same[1:]}, though the picture moves between them." if same else ""


def _doubt_of_one_frame(found: Evidence, words: Words) -> str:
    """The doubt of a frame that is not where its time puts it, or shows another picture."""
    shifts, spread = found.fit.shifts, found.fit.spread
    # A frame is off by so many px and by so many of its own errors.
    sure = np.maximum(0.35, _SURE_SHIFT * math.sqrt(spread) * found.fit.shift_errors)
    far = np.max(np.abs(shifts) / sure, axis=1)
    others = found.fit.misfits - np.median(found.fit.misfits)  # above the middle one of all
    if np.max(far) > 1:
        which = int(np.argmax(far))
        # Shifts are told by the slope of the picture, which holds within a pixel.
        if np.max(found.fit.shift_errors[which]) >= 1:
            return LITTLE
        off = ", ".join(f"{shift:+.1f}" for shift in shifts[which])
        return f"Frame {which + 1} of {far.size} is {off} px off its place: {words.reasons}."
    if np.max(others) > max(0.4 * spread, 0.5 * _expected(found)):
        which = int(np.argmax(others))
        frame = f"Frame {which + 1} of {far.size} does not fit the picture of the others"
        return f"{frame} (misfit {found.fit.misfits[which]:.3g}): {words.reasons}."
    return ""


def _doubt_of_steps(found: Evidence) -> str:
    """The doubt of a picture that leaves a frame before the next one."""
    steps = np.abs(np.diff(found.places, axis=1))
    sensor = found.frames.shape[: -len(steps) - 1 : -1]
    shared = np.prod(np.maximum(1 - steps / np.array(sensor)[:, None], 0), axis=0)
    if np.all(shared >= 0.2):  # of a frame
        return ""
    furthest = np.max(np.linalg.norm(steps, axis=0))
    pixels = " x ".join(map(str, sensor))
    return (
        f"The picture moves by {furthest:.0f} px from frame to frame, of which the "
        f"sensor sees {pixels}."
    )


def _doubt_of_rivals(found: Evidence, error: float, words: Words) -> str:
    """The doubt of a motion that another equals, in the picture or in parts of it."""
    spread, misfit = found.fit.spread, found.compared.misfit
    if not found.is_within:
        return words.beyond
    if not error < 1 or len(found.frames) == 1:
        return LITTLE
    # Another fits as well within a part of the way to frames that are registered elsewhere.
    as_well = misfit + 0.25 * max(found.elsewhere - misfit, 0.0)
    for rival in found.rivals:
        name = ", ".join(f"{each:,.0f}" for each in np.atleast_1d(rival.motion))
        prefers = np.mean(rival.fit.parts - found.compared.parts > 30 * spread)
        if prefers > 0.1:
            return f"At {name} px/s {prefers:.0%} {words.parts}: there may be two objects."
        if rival.below < _LEAD * spread or rival.fit.misfit <= as_well:
            if found.middle < _LEAD * spread:
                return LITTLE
            as_another = f"The frames fit {name} px/s as well"
            return f"{as_another}, as those of a regular pattern or of two objects do."
    return ""


def _expected(found: Evidence) -> float:
    """The part of the misfit of frames that are registered elsewhere which is not noise."""
    return max(found.elsewhere - 1, 1e-9)
