"""Designs that follow a scene while it changes, and the numbers that the page draws of them."""

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import equinox as eqx
import numpy as np
from jaxtyping import ArrayLike, Float, Shaped

from mishutter.design.design import Design
from mishutter.evaluation.errors import SpectralLevels, spectral_levels
from mishutter.evaluation.found_speed import found_psnr, smear_difference_of
from mishutter.evaluation.metrics import Metrics, evaluate
from mishutter.evaluation.needs import sizes
from mishutter.evaluation.response import kernel_phase, kernels_at_speeds
from mishutter.evaluation.speed_knowledge import SpeedKnowledge, knowledge_of, loss_of_decoder
from mishutter.evaluation.views import sensor_view
from mishutter.model.motion import AbstractMotion, ParabolicMotion, steady
from mishutter.model.scene import Scene
from mishutter.model.shutters.base import AbstractShutter
from mishutter.model.shutters.polynomials import profile_of
from mishutter.search.planning import plan
from mishutter.search.rows import OWN_BEST_MOTION, Row
from mishutter.search.search import SearchSettings, Start, best_design
from mishutter.search.space import fills

if TYPE_CHECKING:
    from mishutter.report.comparison import Comparison

OPTIMISED = "optimised"
Numbers = dict[str, object]
"""Numbers, and lists of them, by the names under which the page reads them."""
_SHORTER = 0.8
"""Ratio of a shorter exposure to the one before."""


def first_answer(scene: Scene, before: Design, turn: int = 0) -> Design:
    """A design for a scene within 0.05 s, from the design of a similar scene.

    The exposure so far and, by turns, a shorter or a longer one are measured with the profile so
    far, each on a motion that takes the same share of the stage's reach as before. On the better
    of them the profile is searched from few starts. The whole search takes a second or more.
    """
    command, roomy = before.command, with_room(scene)
    motions = _near(scene, before, 1 / _SHORTER if turn % 2 else _SHORTER)
    loss = loss_of_decoder(scene)
    losses = [float(loss(roomy, motion, command)) for motion in motions]
    motion = motions[int(np.argmin(losses))]
    half, sag = motion.half_exposure, _octave(float(motion.sag))
    furthest = ParabolicMotion(
        acceleration=sag / half**2, half_exposure=half, velocity=motion.velocity
    )
    shared = plan(roomy, furthest, command, loss=loss, free="shutter").sizes.coarser()
    # The starts are the profile so far and one beside it; 20 steps end 1e-4 dB better.
    settings = SearchSettings(loss, shared, num_starts=2, max_steps=8)
    design = best_design(Start(roomy, motion, command, ("shutter",)), settings)
    return replace(design, scene=scene)


def with_room(scene: Scene) -> Scene:
    """The scene with its limit on the stroke rounded up to a power of 2.

    The limit sets the sizes of compiled programs, so that rounding compiles once for each octave
    and not at every step of a slider. On a given motion it changes only the sampling of
    frequencies, by 0.01 dB.
    """
    stroke = np.asarray(_octave(float(scene.limits.max_stroke)), scene.speeds.dtype)
    return eqx.tree_at(lambda s: s.limits.max_stroke, scene, stroke)


def _octave(length: float) -> float:
    """The next power of 2, or 0."""
    return 2.0 ** math.ceil(math.log2(length)) if length > 0 else 0.0


def _near(scene: Scene, before: Design, change: float) -> list[ParabolicMotion]:
    """Motions within the limits of a scene, like that of an earlier design, at two exposures."""
    limits, motion = scene.limits, steady(before.motion)
    pan = min(float(limits.max_pan), 0.5 * float(limits.max_top_speed))
    velocity = float(np.clip(float(motion.velocity), -pan, pan))
    whole = _largest_acceleration(before.scene, float(motion.half_exposure), float(motion.velocity))
    share = min(1.0, float(motion.acceleration) / whole) if whole > 0 else 0.0
    shortest, longest = float(limits.min_half_exposure), float(limits.max_half_exposure)

    def near(half: float) -> ParabolicMotion:
        """A motion of about that half exposure, at which white does not fill a pixel."""
        half = min(max(half, shortest), longest)
        acceleration = share * _largest_acceleration(scene, half, velocity)
        near_motion = ParabolicMotion(
            acceleration=acceleration, half_exposure=half, velocity=velocity
        )
        is_too_long = half > shortest and fills(scene, near_motion, before.command)
        return near(_SHORTER * half) if is_too_long else near_motion

    motions = [near(factor * float(motion.half_exposure)) for factor in (1.0, change)]
    return list({float(each.half_exposure): each for each in motions}.values())


def _largest_acceleration(scene: Scene, half_exposure: float, velocity: float) -> float:
    """The largest acceleration within the limits of a scene; px/s^2."""
    half, pan = (np.asarray(x, scene.speeds.dtype) for x in (half_exposure, velocity))
    return float(scene.limits.largest_acceleration(half, pan))


def curves(
    scene: Scene, motion: AbstractMotion, shutter: AbstractShutter, *, at_once: bool = False
) -> Numbers:
    """The numbers that the page draws of a design."""
    half = float(motion.half_exposure)
    tau = np.linspace(-1, 1, 257)
    transmittance, _ = profile_of(shutter, tau)
    time = np.linspace(-half, half, 97)
    levels, decoder = spectral_levels(scene, motion, shutter), knowledge_of(scene)
    seen, frequency, speeds = decoder.of(levels), levels.frequencies, levels.speeds
    # Frequencies in equal ratios, and speeds in equal steps, no more than are seen.
    even = np.geomspace(frequency[0], frequency[-1], 160)
    places = np.unique(np.searchsorted(frequency, even).clip(0, frequency.size - 1))
    with np.errstate(divide="ignore"):
        signal = 10 * np.log10(seen.signal_over_noise[places])
    few = np.linspace(0, speeds.size - 1, min(speeds.size, 41)).round().astype(int)
    if at_once:
        numbers: Numbers = {"psnr": _level(scene, motion, shutter, levels)}
    else:
        stroke = float(scene.limits.of_stage(motion).stroke)
        numbers = _numbers(evaluate(scene, motion, shutter), motion, stroke, decoder)
    return {
        "time": _short(tau * half * 1e3),
        "profile": _short(transmittance, 4),
        "path_time": _short(time * 1e3),
        "path": _short(motion.position(time)),
        **_sent(scene, motion, time),
        **_kernels(scene, motion, shutter),
        "of_decoder": decoder.filter_words,
        "frequency": _short(frequency[places]),
        "signal": _short(signal, 4),
        "speeds": _short(speeds[few]),
        "psnr": _short(seen.psnr[few]),
        "numbers": numbers,
    }


def _sent(scene: Scene, motion: AbstractMotion, time: Float[np.ndarray, "t"]) -> Numbers:
    """Positions to send to the stage of the scene; empty without a stage."""
    path = None if scene.limits.stage is None else scene.limits.stage_path(motion)
    if scene.limits.stage is None or path is None:
        return {}
    before_the_end = np.minimum(time, time[-1] * (1 - 1e-9))
    return {"sent": _short(scene.limits.stage.sent_for(path, before_the_end))}


def _kernels(scene: Scene, motion: AbstractMotion, shutter: AbstractShutter) -> Numbers:
    """Kernels of the slowest, a middle and the fastest object, without their dark ends."""
    by_size = np.unique(np.abs(np.asarray(scene.speeds)))
    speeds = np.unique(by_size[[0, by_size.size // 2, -1]])
    num_taps = sizes(scene, motion).num_taps
    taps = np.asarray(kernels_at_speeds(shutter, motion, speeds, num_taps))
    bright = np.flatnonzero(np.max(taps, axis=0) > 1e-4 * max(float(np.max(taps)), 1e-12))
    first, end = (int(bright[0]), int(bright[-1]) + 1) if bright.size else (0, 1)
    return {
        "kernel_speeds": _short(speeds),
        "offset": first + float(kernel_phase(motion, num_taps)),
        "kernels": [_short(row[first:end], 4) for row in taps],
    }


def _level(
    scene: Scene, motion: AbstractMotion, shutter: AbstractShutter, levels: SpectralLevels
) -> float:
    """PSNR over all speeds by the scene's decoder."""
    speeds, weights = levels.speeds, np.asarray(scene.weights)
    places = np.searchsorted(speeds, np.asarray(scene.speeds)).clip(0, speeds.size - 1)

    def mean(psnr: Float[np.ndarray, "n"]) -> float:
        error = float(np.average(10 ** (-psnr[places] / 10), weights=weights))
        return -10 * math.log10(error) if error > 0 else math.inf

    view = sensor_view(scene, motion, shutter)
    difference = smear_difference_of(view.scene, view.motion, view.shutter.efficiency())
    share = knowledge_of(scene).share(difference)
    return float(found_psnr(mean(levels.unknown.psnr), mean(levels.known.psnr), share))


def _numbers(
    metrics: Metrics, motion: AbstractMotion, stroke: float, decoder: SpeedKnowledge
) -> Numbers:
    """Numbers of a design beside its curves."""
    worst = decoder.worst_psnr(metrics)
    return {
        "psnr": float(decoder.psnr(metrics)),
        **({} if worst is None else {"worst_speed_psnr": float(worst)}),
        "known_speed_psnr": float(metrics.known_speed_psnr),
        "condition": float(metrics.condition_number),
        "relative": float(metrics.relative_kernel_difference),
        "light": float(metrics.efficiency),
        "stroke_px": stroke,
        "pan_px_per_s": float(motion.velocity) + 0.0,
        "open_ms": float(motion.exposure) * 1e3,
    }


def table(comparison: "Comparison") -> Numbers:
    """The answer of a comparison, and its rows, each at its own best motion, with the ceiling."""
    from mishutter.report.tables import page_table

    shown = shown_rows(comparison)
    wide = page_table(list(shown.values()), within=comparison.costs is not None)
    cells = zip(shown, wide.rows, strict=True)
    first, _, answer = comparison.text().partition("\n")
    return {
        "columns": list(wide.columns),
        "rows": [{"name": name, "cells": list(each)} for name, each in cells],
        "ceiling": comparison.ceiling,
        "verdict": first,
        "answer": answer.strip("\n"),
        "notes": list(comparison.notes),
    }


def shown_rows(comparison: "Comparison") -> dict[str, Row]:
    """Rows at their own best motion, by name."""
    return {row.name: row for row in comparison.rows if row.reading == OWN_BEST_MOTION}


def _short(values: Shaped[ArrayLike, "n"], digits: int = 6) -> list[float | None]:
    """Rounds numbers to the digits that a drawing shows; None stands for infinity and NaN."""
    rows = np.asarray(values, np.float64)
    return [float(f"{x:.{digits}g}") if math.isfinite(x) else None for x in rows.tolist()]
