"""The noise of a camera in electrons, or why a clip does not tell it."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mishutter._core.checks import Unquoted, require
from mishutter.measurement import photon_transfer
from mishutter.measurement.clip import Clip
from mishutter.measurement.estimates import Estimate, Refusal
from mishutter.measurement.photon_transfer import Blocks, Law, Transfer
from mishutter.measurement.signs import (
    BELOW_STEPS,
    MORE_BITS,
    NOISE,
    shot_gamma,
    signs_of,
    too_few,
    too_narrow,
)

_MODEL = 0.012
"""Error of a gain that no resampling shows, as a share, on clips of photographs of known truth."""
_READ_MODEL = 0.03
"""The same of the read noise, to which few blocks at rest are dark."""
_NO_ENDS = -np.inf, np.inf
READ = "the read noise"
_LEAST_OF_A_STEP = 0.5
"""Noise below which rounding is no noise of its own; steps."""
_LEAST_AT_WHITE = 0.3
"""Noise of the brightest blocks below which steps hide all noise; steps."""
_MOST_ERROR = 0.25
"""Error of the electrons, as a share, beyond which they are not written."""
_MOST_READ_ERROR = 0.4
_LEAST_AT_REST = 0.03
_MOST_CUT = 0.03
"""Share of dark pixels at level 0 that changes their mean and variance by little."""
_PATTERN = 0.1
"""Share of one dark frame's noise that may be its fixed pattern."""
_SATURATION = 0.7
"""Share of white up to which flat fields count (EMVA 1288)."""


@dataclass(frozen=True, eq=False)
class Noise:
    """Noise of a camera, as far as it is known."""

    # Photo-electrons that raise a level from black to white; e-
    electrons_at_white: Estimate | None
    # Standard deviation of the read noise; e-. Without a level of black it is the middle of
    # `read_noise_range`, and its error is a quarter of that
    read_noise: Estimate | None
    read_noise_range: tuple[float, float] | None  # Least and greatest, where black is not known; e-
    black: Estimate | None  # Level of black
    black_range: tuple[float, float]  # Least and greatest, where it is not known
    gain: Estimate | None  # System gain, levels of an electron
    law: Law  # Variance of a level, however rough
    transfer: Transfer | None  # Where that was fitted; None if too little stands still
    refusals: tuple[Refusal, ...]  # Numbers that are not known, with reasons
    sources: tuple[str, str, str]  # Words for the sources of electrons, read noise and black

    @property
    def black_level(self) -> float:
        """Level of black, or the middle of where it may lie."""
        return self.black.value if self.black else sum(self.black_range) / 2


def noise_of(
    clip: Clip,
    steady: np.ndarray,
    dark: np.ndarray | None,
    flats: np.ndarray | None,
    black: float | None,
) -> Noise:
    """The noise of a clip, with dark frames and flat fields where there are some.

    Raises:
        ValueError: if dark frames or flat fields have another size, or flat fields are no pairs.
    """
    _check_others(clip, dark, flats, black)
    told = _black_of(clip, dark, black)
    known, dark = told.black, told.dark
    refusals = [] if told.refusal is None else [told.refusal]
    blocks = photon_transfer.blocks_of(photon_transfer.pairs_of(steady), clip.ends)
    transfer = photon_transfer.transfer_of(blocks, _others(clip, dark, flats), clip.step)
    low = _darkest(blocks)
    span = (min(0.0, low), low) if known is None else (known.value, known.value)
    law = photon_transfer.rough_law(blocks, clip.step) if transfer is None else transfer.law
    is_still = transfer is not None and transfer.share >= _LEAST_AT_REST
    if transfer is None or not (is_still or flats is not None):
        transfer, signs = None, [_too_few(clip, blocks)]
    else:
        signs = signs_of(clip, steady, transfer, None if known is None else known.value)
        signs = signs or _doubts(clip, transfer, known, dark is not None or flats is not None)
    if transfer is None or signs:
        unknown = None, None, None, known, span, None
        return Noise(*unknown, law, transfer, (*refusals, *signs), ("", "", told.source))
    gain = _gain_of(transfer)
    if known is None:  # no noise has a square below 0
        span = min(max(span[0], -law.dark / gain.value), low), low
    middle = sum(span) / 2
    errors = gain.error / gain.value, _deviation(known, span) / (clip.white - middle)
    electrons = (clip.white - middle) / gain.value
    texts = [_frames_text(clip.num_frames, "")]
    texts += [_frames_text(len(flats), "flat")] if flats is not None else []
    source = f"photon transfer over {' and '.join(texts)}"
    read = _read_of(clip, transfer, span, known, dark)
    return Noise(
        electrons_at_white=Estimate(electrons, electrons * float(np.hypot(*errors))),
        read_noise=read.value,
        read_noise_range=read.ends,
        black=known,
        black_range=span,
        gain=gain,
        law=law,
        transfer=transfer,
        refusals=(*refusals, *([] if read.refusal is None else [read.refusal])),
        sources=(source, read.source or source, told.source),
    )


class _Black(NamedTuple):
    """Black and its source, the dark frames that show noise, and why they may not."""

    black: Estimate | None
    source: str
    dark: np.ndarray | None
    refusal: Refusal | None = None


def _black_of(clip: Clip, dark: np.ndarray | None, black: float | None) -> _Black:
    told = None if black is None else Estimate(black, 0.0)
    source = "" if black is None else "as given"
    if dark is None:
        return _Black(told, source, None)
    if np.mean(dark <= 0) > _MOST_CUT and clip.step > 0:
        reason = "dark frames are cut off at their lowest level"
        remedy = "Raise the camera's black level (offset) until dark frames show all noise"
        return _Black(told, source, None, Refusal("the level of black", reason, remedy))
    if told is not None:
        return _Black(told, source, dark)
    each = dark.mean(axis=(1, 2), dtype=np.float64)
    # Rounding alone decides the level of frames whose noise is below the steps.
    doubt = clip.step / (100 if dark[0].std() > _LEAST_OF_A_STEP * clip.step else 3)
    error = float(np.hypot(each.std() / np.sqrt(each.size), doubt))
    return _Black(Estimate(float(each.mean()), error), _frames_text(len(dark), "dark"), dark)


def _too_few(clip: Clip, blocks: Blocks) -> Refusal:
    whole = blocks.where(blocks.is_whole)
    usual = float(np.median(whole.variance)) if whole.variance.size else 0.0
    return too_few(clip, float(blocks.is_whole.mean()), usual)


def _gain_of(transfer: Transfer) -> Estimate:
    """System gain; levels per electron."""
    spread, value = transfer.lines[:, 1].std(), transfer.law.gain
    return Estimate(value, float(np.hypot(spread, _MODEL * value)))


def _doubts(
    clip: Clip, transfer: Transfer, known: Estimate | None, has_others: bool
) -> list[Refusal]:
    """The refusal of a clip whose levels are as a sensor gave them, and do not tell its gain."""
    narrow = too_narrow(transfer, None if known is None else known.value, has_others=has_others)
    if narrow is not None:
        return [narrow]
    brightest = float(transfer.law(np.quantile(transfer.blocks.mean, 0.99)))
    if brightest - clip.step**2 / 12 < (_LEAST_AT_WHITE * clip.step) ** 2:
        return [Refusal(NOISE, BELOW_STEPS, MORE_BITS)]
    gain = _gain_of(transfer)
    if gain.error < _MOST_ERROR * gain.value:
        return []
    gamma = shot_gamma(transfer, clip.step)
    coded = f", as under a gamma of {gamma:.2g}" if gamma is not None and gamma > 1 else ""
    reason = f"the variance does not rise measurably with the level{coded}"
    remedy = (
        "Switch gamma off, and film brighter and darker parts at rest, or add flat fields (--flat)"
    )
    return [Refusal(NOISE, reason, remedy)]


class _Read(NamedTuple):
    """Read noise, its range where black is not known, its source, and why there may be none."""

    value: Estimate | None
    ends: tuple[float, float] | None
    source: str
    refusal: Refusal | None = None


def _read_of(
    clip: Clip,
    transfer: Transfer,
    span: tuple[float, float],
    known: Estimate | None,
    dark: np.ndarray | None,
) -> _Read:
    """The read noise: the root of the variance at black, less that of rounding."""
    gain, rounding = _gain_of(transfer), clip.step**2 / 12
    squares = [transfer.law.dark + gain.value * b - rounding for b in span]
    if known is None:
        low, high = (float(np.sqrt(max(s, 0.0)) / gain.value) for s in squares)
        text = "an interval: black is not known (add two dark frames, --dark)"
        read = _Read(Estimate((low + high) / 2, (high - low) / 4), (low, high), text)
        greatest = high
    else:
        samples = transfer.lines[:, 0] + transfer.lines[:, 1] * known.value - rounding
        value = _root(squares[0], float(np.maximum(samples, 0).std()), gain)
        text = _frames_text(len(dark), "dark") if dark is not None and len(dark) > 1 else ""
        if dark is not None and len(dark) == 1:
            value, text = _of_one_dark(dark[0], value, clip.step, gain, text)
        read, greatest = _Read(value, None, text), value.value
    least = _LEAST_OF_A_STEP * clip.step / gain.value
    if greatest < least:
        reason = f"it is below half a step of the file, {least:.3g} e-"
        return _Read(None, None, "", Refusal(READ, reason, MORE_BITS))
    value, error = read.value  # type: ignore[misc]
    if known is not None and error > _MOST_READ_ERROR * value:
        reason = f"what stands still is too bright to show it ({value:.2g} +- {error:.2g} e-)"
        return _Read(None, None, "", Refusal(READ, reason, "Add two dark frames (--dark)"))
    return read


def _check_others(
    clip: Clip, dark: np.ndarray | None, flats: np.ndarray | None, black: float | None
) -> None:
    size = clip.frames.shape[1:]
    for name, frames in (("dark", dark), ("flats", flats)):
        if frames is not None:
            requirement = f"have the size of the clip, {size[0]} x {size[1]}"
            got = Unquoted(f"{frames.shape[1]} x {frames.shape[2]}")
            require(frames.shape[1:] == size, f"measure({name}=...)", requirement, got)
    if flats is not None:
        requirement = "be pairs of flat fields, one pair after the other"
        is_paired = len(flats) % 2 == 0
        require(is_paired, "measure(flats=...)", requirement, Unquoted(f"{len(flats)} frames"))
    if black is not None:
        fits = np.isfinite(black) and black < clip.white
        require(bool(fits), "measure(black=...)", f"be below white, {clip.white:g}", black)


def _others(clip: Clip, dark: np.ndarray | None, flats: np.ndarray | None) -> Blocks | None:
    """Blocks of pairs of dark frames, and of pairs of flat fields below saturation."""
    parts = []
    if dark is not None and len(dark) > 1:
        parts.append(photon_transfer.blocks_of(photon_transfer.pairs_of(dark), _NO_ENDS))
    if flats is not None:
        pairs = [pair for pair in _couples(flats) if np.mean(pair) < _SATURATION * clip.white]
        if pairs:
            parts.append(photon_transfer.blocks_of(pairs, clip.ends))
    if not parts:
        return None
    return parts[0] if len(parts) == 1 else parts[0] + parts[1]


def _couples(frames: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    return zip(frames[::2], frames[1::2], strict=True)


def _darkest(blocks: Blocks) -> float:
    """Level of the darkest block, above which black does not lie."""
    levels = blocks.mean[blocks.is_whole]
    return float(np.quantile(levels, 0.001)) if levels.size else 0.0


def _deviation(known: Estimate | None, span: tuple[float, float]) -> float:
    """Error of black: its own, or that of a number somewhere in a range."""
    return (span[1] - span[0]) / np.sqrt(12) if known is None else known.error


def _root(square: float, error: float, gain: Estimate) -> Estimate:
    """Read noise in electrons by its square in levels."""
    level = float(np.sqrt(max(square, 0.0)))
    spread = error / (2 * level) if level**2 > error else float(np.sqrt(error))
    value = level / gain.value
    share = float(np.hypot(gain.error / gain.value, _READ_MODEL))
    return Estimate(value, float(np.hypot(spread / gain.value, value * share)))


def _of_one_dark(
    dark: np.ndarray, read: Estimate, step: float, gain: Estimate, text: str
) -> tuple[Estimate, str]:
    """The better of the clip's read noise and that of one dark frame, over its neighbours.

    One frame counts its fixed pattern as noise.
    """
    differences = np.diff(dark.astype(np.float64), axis=1)
    square = float(np.mean(differences**2)) / 2 - step**2 / 12
    value = float(np.sqrt(max(square, 0.0))) / gain.value
    error = value * float(np.hypot(_PATTERN, gain.error / gain.value))
    if error >= read.error:
        return read, text
    return Estimate(value, error), "one dark frame, whose fixed pattern counts as noise (give two)"


def _frames_text(count: int, kind: str) -> str:
    return f"{count} {kind} frame{'s' * (count != 1)}".replace("  ", " ")
