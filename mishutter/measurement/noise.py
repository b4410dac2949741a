"""The noise of a camera in electrons, or why a clip does not tell it."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from mishutter._core.checks import Unquoted, require
from mishutter.measurement import photon_transfer
from mishutter.measurement.clip import Clip, Levels
from mishutter.measurement.estimates import Estimate, Refusal
from mishutter.measurement.photon_transfer import Blocks, Law, Transfer, pairs_of
from mishutter.measurement.signs import (
    BELOW_STEPS,
    MORE_BITS,
    NOISE,
    shot_gamma,
    signs_of,
    too_few,
    too_narrow,
)
from mishutter.measurement.steady import Steady

READ = "the read noise"
_BLOCK = 16
"""Side of the blocks whose levels are the structure of a dark frame; px."""
_STRUCTURE = 0.02
"""Share of the clip's contrast by which a dark frame may differ from black."""
_LEAST_OF_A_STEP = 0.5
"""Noise below which rounding is no noise of its own; steps."""


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
    steady: Steady,
    dark: np.ndarray | None,
    flats: np.ndarray | None,
    black: float | None,
) -> Noise:
    """The noise of a clip, with dark frames and flat fields where there are some."""
    known, of_black, dark, refusals = _black_of(clip, dark, black)
    blocks = photon_transfer.blocks_of(steady, pairs_of(steady.num_frames), clip.ends)
    transfer = photon_transfer.transfer_of(blocks, _others(clip, dark, flats), clip.step)
    if transfer is not None:
        transfer = replace(transfer, error=steady.error)
    # Black does not lie above the darkest block.
    whole = blocks.where(blocks.is_whole)
    low = float(np.quantile(whole.mean, 0.001)) if whole.mean.size else 0.0
    span = (min(0.0, low), low) if known is None else (known.value, known.value)
    law = photon_transfer.rough_law(blocks, clip.step) if transfer is None else transfer.law
    is_still = transfer is not None and transfer.share >= 0.03  # of the blocks
    if transfer is None or not (is_still or flats is not None):
        usual = float(np.median(whole.variance)) if whole.variance.size else 0.0
        transfer, signs = None, [too_few(clip, float(blocks.is_whole.mean()), usual)]
    else:
        signs = signs_of(clip, steady, transfer, None if known is None else known.value)
        signs = signs or _doubts(clip, transfer, known, dark is not None or flats is not None)
    if transfer is None or signs:
        unknown = None, None, None, known, span, None
        return Noise(*unknown, law, transfer, (*refusals, *signs), ("", "", of_black))
    gain = _gain_of(transfer)
    if known is None:  # no noise has a square below 0
        span = min(max(span[0], -law.dark / gain.value), low), low
    middle = sum(span) / 2
    # A number that may lie anywhere in a range has this deviation.
    deviation = (span[1] - span[0]) / np.sqrt(12) if known is None else known.error
    errors = gain.error / gain.value, deviation / (clip.white - middle)
    electrons = (clip.white - middle) / gain.value
    texts = [_frames_text(steady.num_frames, "")]
    texts += [_frames_text(len(flats), "flat")] if flats is not None else []
    source = f"photon transfer over {' and '.join(texts)}"
    read, ends, of_read, unread = _read_of(clip, transfer, span, known, dark)
    return Noise(
        electrons_at_white=Estimate(electrons, electrons * float(np.hypot(*errors))),
        read_noise=read,
        read_noise_range=ends,
        black=known,
        black_range=span,
        gain=gain,
        law=law,
        transfer=transfer,
        refusals=(*refusals, *unread),
        sources=(source, of_read or source, of_black),
    )


def _black_of(
    clip: Clip, dark: np.ndarray | None, black: float | None
) -> tuple[Estimate | None, str, np.ndarray | None, list[Refusal]]:
    """Black and its source, the dark frames that show noise, and why they may not."""
    told = None if black is None else Estimate(black, 0.0)
    source = "" if black is None else "as given"
    if dark is None:
        return told, source, None, []
    usual = [_usual(frame, clip.step) for frame in dark]
    every = np.concatenate(usual)
    # A few dark pixels at level 0 change their mean and variance by little; levels below it do not
    # end there.
    if clip.step > 0 and every.min() >= 0 and np.mean(every == 0) > 0.03:
        reason = "dark frames are cut off at their lowest level"
        remedy = "Raise the camera's black level (offset) until dark frames show all noise"
        return told, source, None, [Refusal("the level of black", reason, remedy)]
    if told is not None:
        return told, source, dark, []
    each = np.array([levels.mean(dtype=np.float64) for levels in usual])
    # Rounding alone decides the level of frames whose noise is below the steps.
    doubt = clip.step / (100 if usual[0].std() > _LEAST_OF_A_STEP * clip.step else 3)
    error = float(np.hypot(each.std() / np.sqrt(each.size), doubt))
    return Estimate(float(each.mean()), error), _frames_text(len(dark), "dark"), dark, []


def _usual(dark: np.ndarray, step: float) -> Float[np.ndarray, "pixels"]:
    """Levels of a dark frame without those of pixels that are stuck, or hot."""
    away = np.abs(dark - np.median(dark))
    return dark[away <= 5 * max(1.4826 * float(np.median(away)), step)]


def _gain_of(transfer: Transfer) -> Estimate:
    """System gain; levels per electron."""
    spread, value = transfer.lines[:, 1].std(), transfer.law.gain
    # Clips of photographs of known truth have this error besides, which no resampling shows.
    return Estimate(value, float(np.hypot(spread, np.hypot(0.012, transfer.error) * value)))


def _doubts(
    clip: Clip, transfer: Transfer, known: Estimate | None, has_others: bool
) -> list[Refusal]:
    """The refusal of a clip whose levels are as a sensor gave them, and do not tell its gain."""
    narrow = too_narrow(transfer, None if known is None else known.value, has_others=has_others)
    if narrow is not None:
        return [narrow]
    brightest = float(transfer.law(np.quantile(transfer.blocks.mean, 0.99)))
    # Steps hide all noise where that of the brightest blocks is less than a third of one.
    if brightest - clip.step**2 / 12 < (0.3 * clip.step) ** 2:
        return [Refusal(NOISE, BELOW_STEPS, MORE_BITS)]
    gain = _gain_of(transfer)
    if gain.error < 0.25 * gain.value:  # electrons of a greater error are not written
        return []
    gamma = shot_gamma(transfer, clip.step)
    coded = f", as under a gamma of {gamma:.2g}" if gamma is not None and gamma > 1 else ""
    reason = f"the variance does not rise measurably with the level{coded}"
    remedy = (
        "Switch gamma off, and film brighter and darker parts at rest, or add flat fields (--flat)"
    )
    return [Refusal(NOISE, reason, remedy)]


def _read_of(
    clip: Clip,
    transfer: Transfer,
    span: tuple[float, float],
    known: Estimate | None,
    dark: np.ndarray | None,
) -> tuple[Estimate | None, tuple[float, float] | None, str, list[Refusal]]:
    """Read noise, its range where black is not known, its source, and why there may be none.

    It is the root of the variance at black, less that of rounding.
    """
    gain, rounding = _gain_of(transfer), clip.step**2 / 12
    squares = [transfer.law.dark + gain.value * b - rounding for b in span]
    ends, source = None, ""
    if known is None:
        low, high = (float(np.sqrt(max(s, 0.0)) / gain.value) for s in squares)
        read, ends, greatest = Estimate((low + high) / 2, (high - low) / 4), (low, high), high
        source = "an interval: black is not known (add two dark frames, --dark)"
    else:
        samples = transfer.lines[:, 0] + transfer.lines[:, 1] * known.value - rounding
        read = _root(squares[0], float(np.maximum(samples, 0).std()), gain)
        if dark is not None and len(dark) > 1:
            source = _frames_text(len(dark), "dark")
        elif dark is not None:
            read, source = _of_one_dark(dark[0], read, clip.step, gain)
        greatest = read.value
    least = _LEAST_OF_A_STEP * clip.step / gain.value
    if greatest < least:
        reason = f"it is below half a step of the file, {least:.3g} e-"
        return None, None, "", [Refusal(READ, reason, MORE_BITS)]
    value, error = read
    if known is not None and error > 0.4 * value:
        reason = f"what stands still is too bright to show it ({value:.2g} +- {error:.2g} e-)"
        return None, None, "", [Refusal(READ, reason, "Add two dark frames (--dark)")]
    return read, ends, source, []


def require_others(clip: Clip, others: Mapping[str, Levels], black: float | int | None) -> None:
    """Refuses dark frames, flat fields and a level of black that cannot be a clip's."""
    size = clip.frames.shape[1:]
    for name, levels in others.items():
        subject, own = f"measure({name}=...)", levels.frames.shape[1:]
        requirement = f"have the size of the clip, {size[0]} x {size[1]}"
        require(own == size, subject, requirement, Unquoted(f"{own[0]} x {own[1]}"))
        is_alike = levels.kind == clip.kind or not (levels.kind and clip.kind)
        require(is_alike, subject, f"be {clip.kind} as the clip is", Unquoted(levels.kind))
    if "flats" in others:
        count = len(others["flats"].frames)
        requirement = "be pairs of flat fields, one pair after the other"
        require(count % 2 == 0, "measure(flats=...)", requirement, Unquoted(f"{count} frames"))
    if black is not None:
        fits = np.isfinite(black) and black < clip.white
        require(bool(fits), "measure(black=...)", f"be below white, {clip.white:g}", black)
    if "dark" in others:
        low, high = np.quantile(np.mean(clip.frames, axis=0), (0.1, 0.99)).tolist()
        # Black drifts a little; where a sensor glows or rows differ there is structure of its own.
        least = max(clip.step, _STRUCTURE * (high - low))
        for number, frame in enumerate(others["dark"].frames, 1):
            _require_dark(frame, number, low, least)


def _require_dark(
    frame: Float[np.ndarray, "rows columns"], number: int, low: float, least: float
) -> None:
    """Refuses a dark frame that has seen light: more than dark parts of the clip, or structure.

    Args:
        frame: The frame.
        number: Its number, for an error.
        low: Level of dark parts of the clip.
        least: Difference from black that counts for nothing, beside noise.
    """
    subject, level = "measure(dark=...)", float(np.median(frame))
    steps = np.diff(frame, axis=1)
    noise = 1.4826 * float(np.median(np.abs(steps - np.median(steps)))) / np.sqrt(2)
    own = max(noise, least)
    requirement = f"be of a covered lens: at most at the {low + own:.4g} of dark parts of the clip"
    got = Unquoted(f"{level:.4g} in frame {number}")
    require(level <= low + own, subject, requirement, got)
    # Medians over blocks hold no hot pixels, and a sixteenth of the noise; quartiles of these no
    # rows that are stuck.
    rows, columns = (n // _BLOCK for n in frame.shape)
    blocks = frame[: rows * _BLOCK, : columns * _BLOCK].reshape(rows, _BLOCK, columns, _BLOCK)
    quartiles = np.quantile(np.median(blocks, axis=(1, 3)), (0.25, 0.75))
    spread = float(np.diff(quartiles)[0]) / 2
    requirement = f"be of a covered lens: its parts differ by at most {own:.3g} levels"
    require(spread <= own, subject, requirement, Unquoted(f"{spread:.3g} in frame {number}"))


def _others(clip: Clip, dark: np.ndarray | None, flats: np.ndarray | None) -> Blocks | None:
    """Blocks of pairs of dark frames, and of pairs of flat fields below saturation."""
    parts = []
    if dark is not None and len(dark) > 1:
        ends = -np.inf, np.inf
        parts.append(photon_transfer.blocks_of(Steady.of(dark), pairs_of(len(dark)), ends))
    if flats is not None:
        couples = ((k, k + 1) for k in range(0, len(flats), 2))
        # EMVA 1288
        pairs = [(i, j) for i, j in couples if np.mean(flats[i : j + 1]) < 0.7 * clip.white]
        if pairs:
            parts.append(photon_transfer.blocks_of(Steady.of(flats), pairs, clip.ends))
    if not parts:
        return None
    return parts[0] if len(parts) == 1 else parts[0] + parts[1]


def _root(square: float, error: float, gain: Estimate) -> Estimate:
    """Read noise in electrons by its square in levels."""
    level = float(np.sqrt(max(square, 0.0)))
    spread = error / (2 * level) if level**2 > error else float(np.sqrt(error))
    value = level / gain.value
    # Few blocks at rest are dark: clips of known truth have this error besides.
    share = float(np.hypot(gain.error / gain.value, 0.03))
    return Estimate(value, float(np.hypot(spread / gain.value, value * share)))


def _of_one_dark(
    dark: np.ndarray, read: Estimate, step: float, gain: Estimate
) -> tuple[Estimate, str]:
    """The better of the clip's read noise and that of one dark frame, with the latter's source."""
    differences = np.diff(dark.astype(np.float64), axis=1).ravel()
    square = float(np.mean(_usual(differences, step) ** 2)) / 2 - step**2 / 12
    value = float(np.sqrt(max(square, 0.0))) / gain.value
    # A tenth of one frame's noise may be its fixed pattern.
    error = value * float(np.hypot(0.1, gain.error / gain.value))
    if error >= read.error:
        return read, ""
    return Estimate(value, error), "one dark frame, whose fixed pattern counts as noise (give two)"


def _frames_text(count: int, kind: str) -> str:
    return f"{count} {kind} frame{'s' * (count != 1)}".replace("  ", " ")
