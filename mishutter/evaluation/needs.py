"""The needs of a scene: sizes and skips, chosen before anything is computed and shared by all.

Sizes follow from the travel of the scene's light: a kernel takes a tap for each pixel over which
that of one object falls, the expected error frequencies for each over which that of all does.

A plan leaves out only work that cannot change a result: speeds that never occur, occur twice or
mirror one another under a symmetric shutter; taps that no object reaches; terms without weight.
`sizes` holds everything all the same, and is what a plan is tested against.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from mishutter._core.checks import Unquoted, all_concrete, is_concrete, primal_values, require
from mishutter._core.compiling import outside_trace
from mishutter.blur.spectrum import default_num_frequencies
from mishutter.evaluation.ensembles import ensemble_of
from mishutter.evaluation.layers import (
    LEAST_EFFECTIVE_SPEEDS,
    SEARCHED_EFFECTIVE_SPEEDS,
    Background,
    Frequencies,
    num_effective_speeds,
)
from mishutter.model.alignment import length_on_parabola
from mishutter.model.motion import AbstractMotion
from mishutter.model.optics import NUM_FREQUENCIES
from mishutter.model.scene import Scene, in_sensor_frame
from mishutter.model.shutters.base import AbstractShutter

_MAX_LENGTH = 1 << 16
"""Longest kernel, px."""
_MAX_COUNT = 1 << 30
"""Largest count: more leave the range of 32 bits."""
_FREQUENCIES_PER_PX = 1.4
"""Frequencies for each px over which light of all speeds falls. The error is periodic in frequency
with about the inverse of this length as its period; its overtones are weak."""
_OF_ONE_SPEED = 2560, 24, 1 << 17
"""Frequencies of a single speed: at least, for each px, and at most. Its response has zeros, about
which the error rises within a fraction of a step. Several speeds have no zeros in common, as a
rule: two need a quarter as many, three a ninth."""
_PHASE_PER_NODE = 1.8
_SPARE_NODES = 12


plan_of_traced_search = jax.make_user_context(None)
"""The plan of the search whose loss is being traced, by which functions that the loss calls know
their sizes.

JAX makes a trace depend on it, so that a function that a user has compiled is traced anew for
another search.
"""


class Parts(NamedTuple):
    """Parts of a response."""

    kernels: bool  # The kernel of an object at rest
    spectra: bool  # Transfer functions at the scene's speeds
    differences: bool  # Kernels at the scene's speeds, less the one at rest

    @staticmethod
    def of_all(every: Iterable["Parts"]) -> "Parts":
        """The parts that any of some needs asks for."""
        return Parts(*map(any, zip(*every, strict=True)))

    def refuse(
        self, num_taps: Int[np.ndarray, "*shape"], num_frequencies: Int[np.ndarray, "*shape"]
    ) -> Bool[np.ndarray, "*shape"]:
        """Whether `Plan.require_feasible` refuses designs of some sizes."""
        long_kernels = self.kernels & (num_taps > _MAX_LENGTH)
        return np.asarray(long_kernels | (self.spectra & (num_frequencies > _OF_ONE_SPEED[2])))


EVERY_PART = Parts(kernels=True, spectra=True, differences=True)
ONLY_SPECTRA = Parts(kernels=False, spectra=True, differences=False)


@dataclass(frozen=True)
class Plan:
    """The parts to compute; static, hashable, and equal for scenes of equal needs."""

    num_taps: int  # Taps of a blur kernel
    dft_length: int  # Length of the DFT that the condition number is taken over
    num_frequencies: int  # Frequencies in (0, 0.5) cycles/px of the expected error
    num_nodes: int  # Nodes over the whole exposure for the transfer functions there
    num_kept: int | None = None  # Lowest frequencies that an error is confined to; None for all
    # Whether work that cannot change a result is left out: speeds that never occur or occur twice,
    # and responses that a search would compute again
    skips: bool = False
    folds: bool = False  # Whether `+s` and `-s` count as one speed
    still: bool = False  # Whether nothing in the scene moves, so that one kernel is enough
    loss_dft_length: int | None = None  # DFT of a loss's condition number; None for `dft_length`
    # Effective speeds of the beat between objects and the background that they hide; 0 for a
    # picture that moves as a whole
    num_effective_speeds: int = 0

    @staticmethod
    def of_travel(reach: float, velocity: float) -> "Plan":
        """Sizes for kernels of `reach` px on paths of at most `velocity` px per half exposure."""
        num_taps = _rounded_up(reach + 1.0)
        phase = 2 * np.pi * 0.5 * 2 * velocity
        num_nodes = _rounded_up(phase / _PHASE_PER_NODE + 4 * _SPARE_NODES)
        return Plan(num_taps, default_num_frequencies(num_taps), NUM_FREQUENCIES, num_nodes)

    def holding(self, other: "Plan") -> "Plan":
        """Sizes large enough for both plans."""
        return Plan(
            max(self.num_taps, other.num_taps),
            max(self.dft_length, other.dft_length),
            max(self.num_frequencies, other.num_frequencies),
            max(self.num_nodes, other.num_nodes),
            loss_dft_length=self.loss_dft_length,
            num_effective_speeds=max(self.num_effective_speeds, other.num_effective_speeds),
        )

    def coarser(self) -> "Plan":
        """The plan with the few effective speeds of a search, enough to tell designs apart."""
        count = min(self.num_effective_speeds, SEARCHED_EFFECTIVE_SPEEDS)
        return replace(self, num_effective_speeds=count)

    @property
    def velocity_held(self) -> int:
        """The greatest velocity, px per half exposure, for which the nodes are exact to 1e-7."""
        # Twice that for which `of_travel` chooses their number.
        return int(2 * (self.num_nodes - 4 * _SPARE_NODES) * _PHASE_PER_NODE / (2 * np.pi))

    @property
    def spread_held(self) -> float:
        """Length over which light may fall for the number of frequencies; px."""
        return self.num_frequencies / _FREQUENCIES_PER_PX

    def require_feasible(self, parts: Parts) -> None:
        """Refuses sizes that a computation cannot hold, before anything of them is made."""
        where = "at the scene's speeds, wherever a search may take it"
        requirement = f"blur over fewer than {_MAX_LENGTH} px {where}"
        is_short = not parts.kernels or self.num_taps <= _MAX_LENGTH
        require(is_short, "motion", requirement, self.num_taps)
        most = _OF_ONE_SPEED[2]
        furthest = f"spread light over at most {most / _FREQUENCIES_PER_PX:.0f} px {where}"
        got = Unquoted(f"what takes {self.num_frequencies} frequencies")
        require(not parts.spectra or self.num_frequencies <= most, "motion", furthest, got)


def distinct_speeds(
    scene: Scene, *, folds: bool
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """Speeds that occur, each once, ascending, px/s, with their weights.

    Speeds that differ in their last digits alone are one: a range that is meant to mirror itself
    has such speeds.
    """
    speeds, weights = np.asarray(scene.speeds), np.asarray(scene.weights)
    speeds, weights = speeds[weights > 0], weights[weights > 0]
    values = np.abs(speeds) if folds else speeds
    order = np.argsort(values, kind="stable")
    values, weights = values[order], weights[order]
    same = 4 * np.finfo(values.dtype).eps * np.max(np.abs(values), initial=0)
    begins = np.diff(values, prepend=-np.inf) > same
    merged = np.bincount(np.cumsum(begins) - 1, weights)
    return values[begins], merged.astype(weights.dtype)


class Extent(NamedTuple):
    """Travel of light on a motion, or on each of stacked ones of one piece."""

    reach: Float[np.ndarray, "..."]  # Length of the longest kernel; px
    velocity: Float[np.ndarray, "..."]  # Its greatest velocity; px per half exposure
    spread: Float[np.ndarray, "..."]  # Length over which light of the speeds that occur falls; px

    @staticmethod
    def of(scene: Scene, motion: AbstractMotion) -> "Extent":
        """Travel of the light of a concrete scene on a motion."""
        with outside_trace():
            half, fastest = np.asarray(motion.half_exposure, np.float64), float(scene.max_speed)
            reach = motion.greatest_travel(np.array([-fastest, 0.0, fastest]))
            gain = np.asarray(motion.speed_gain, np.float64)
            spread = motion.greatest_travel(occurring_speeds(scene))
        return Extent(np.maximum(reach, 2 * fastest * half), (gain + fastest) * half, spread)

    @staticmethod
    def within_tolerances(scene: Scene, motion: AbstractMotion) -> "Extent":
        """The same of a camera that is built within the scene's tolerances.

        Kernels are those of the camera as it is designed.
        """
        nominal, tolerances = Extent.of(scene, motion), scene.tolerances
        if tolerances is None:
            return nominal
        speeds = jnp.asarray(occurring_speeds(scene), scene.speeds.dtype)

        def at_errors(motion: AbstractMotion) -> tuple[Array, Array]:
            return ensemble_of(speeds, tolerances, motion, np.dtype(speeds.dtype))

        half = np.asarray(motion.half_exposure, np.float64)[..., None]
        with outside_trace():
            ensemble = (jax.vmap(at_errors) if half.ndim > 1 else at_errors)(motion)
            accelerations, shifted = (np.asarray(x, np.float64) for x in ensemble)
        sag, smear = accelerations * half**2, np.max(np.abs(shifted), axis=-1) * half
        spread, velocity = np.asarray(length_on_parabola(sag, smear)), 2 * abs(sag) + smear
        return Extent(nominal.reach, velocity.max(axis=-1), spread.max(axis=-1))


def occurring_speeds(scene: Scene) -> Float[np.ndarray, "n"]:
    """Speeds of some weight, or all where the weights are traced; px/s."""
    speeds = np.asarray(scene.speeds, np.float64)
    return speeds[np.asarray(scene.weights) > 0] if is_concrete(scene.weights) else speeds


def num_frequencies(
    scene: Scene, spread: Float[np.ndarray, "*shape"] | float
) -> Int[np.ndarray, "*shape"]:
    """Number of frequencies whose mean is the expected error to 0.01 dB."""
    num_speeds = scene.speeds.size
    if scene.speeds_known:
        num_speeds = distinct_speeds(scene, folds=True)[0].size
    least, per_px, most = (x / num_speeds**2 for x in _OF_ONE_SPEED)
    spread = np.ceil(np.asarray(spread) * (1 - 1e-9))  # whole pixels, whatever its rounding
    fundamental = _FREQUENCIES_PER_PX * np.maximum(spread, longest_within_limits(scene))
    count = np.maximum(np.minimum(per_px * spread, most), fundamental)
    count = np.clip(np.ceil(np.maximum(count, max(NUM_FREQUENCIES, least))), None, _MAX_COUNT)
    each, index = np.unique(count, return_inverse=True)
    classes = np.array([size_class(int(x)) for x in each], int)
    return np.asarray(classes[index]).reshape(count.shape)


def frequency_counts() -> list[int]:
    """Every number of frequencies that is chosen and that `Plan.require_feasible` passes."""
    counts = [NUM_FREQUENCIES]
    while counts[-1] < _OF_ONE_SPEED[2]:
        counts.append(size_class(counts[-1] + 1))
    return counts


def longest_within_limits(scene: Scene) -> float:
    """Longest kernel of an object that a motion within the limits keeps up with; px."""
    stroke = scene.limits.max_stroke
    # Where the stroke is traced, no longer kernel is expected than 256 px.
    return min(4 * float(stroke), _MAX_LENGTH - 1.0) if is_concrete(stroke) else 256.0


def size_class(count: int) -> int:
    """The least of 1, 2, 3, 4, 6, 8, 12, ... that is at least `count`."""
    octave = 1 << max(0, count - 1).bit_length()
    return octave * 3 // 4 if octave >= 4 and count <= octave * 3 // 4 else octave


def sizes(scene: Scene, motion: AbstractMotion) -> Plan:
    """Everything: sizes that hold the scene on this motion and on all that keep up within limits.

    One size for all of them makes designs comparable (the condition number depends on
    the DFT length) and lets them share one compiled program. Under `jit` sizes come from the limits
    alone, and hold kernels of up to 256 px where these are traced too; under `grad` they come from
    the primal values. In a loss that a search traces, sizes are at least those of the search's
    plan. The DFT of a loss follows from the limits alone, whatever the motion.
    """
    scene, motion = in_sensor_frame(*primal_values((scene, motion)))
    longest = longest_within_limits(scene)
    is_concrete_scene = all_concrete((scene.speeds, motion, scene.limits.max_stroke))
    reach = velocity = spread = longest
    if is_concrete_scene:
        reach, velocity, spread = map(float, Extent.within_tolerances(scene, motion))
    own = replace(
        Plan.of_travel(max(reach, longest), max(velocity, longest)),
        num_frequencies=int(num_frequencies(scene, spread)),
        loss_dft_length=Plan.of_travel(longest, longest).dft_length,
        num_effective_speeds=effective_speeds(scene, motion.half_exposure),
    )
    plan_of_search = plan_of_traced_search.value
    return own if is_concrete_scene or plan_of_search is None else plan_of_search.holding(own)


def effective_speeds(
    scene: Scene, half_exposure: Float[Array | np.ndarray, ""] | np.floating | float
) -> int:
    """Number of effective speeds of two layers over half an exposure, s."""
    if scene.occlusion is None or not scene.occlusion.has_edges:
        return 0
    # A traced exposure counts as the longest.
    half = half_exposure if is_concrete(half_exposure) else scene.limits.max_half_exposure
    background = Background.of(scene)
    if not all_concrete((scene.speeds, background, half)):
        return LEAST_EFFECTIVE_SPEEDS
    speeds = np.append(occurring_speeds(scene), np.asarray(background.speeds))
    count = num_effective_speeds(float(np.ptp(speeds)) / 2 * float(half))
    return 1 + size_class(count - 1)  # near exposures share a program


def _rounded_up(count: float) -> int:
    """Round up to one of four sizes an octave, so that near scenes share a program."""
    count = max(16, int(np.ceil(min(count, _MAX_COUNT))))
    step = max(4, 1 << (count.bit_length() - 3))
    return -(-count // step) * step


def automatic(scene: Scene, motion: AbstractMotion, shutter: AbstractShutter) -> Plan:
    """The plan of a scene in the frame of its motion: exact, and one for all within the limits."""
    folds, still = folds_speeds(scene, motion, shutter), scene.nothing_moves
    return replace(sizes(scene, motion), skips=True, folds=folds, still=still)


def reduced(scene: Scene, plan: Plan) -> Scene:
    """The scene with only the numbers that a plan asks for: no picture, no motion, fewer speeds."""
    power = scene.picture.power_spectrum
    if is_concrete(power):
        dtype = np.dtype(scene.speeds.dtype)
        power = scene.picture.spectrum_on_grid(plan.num_frequencies, dtype)
    speeds = weights = None
    if plan.skips and scene.speeds_known:
        speeds, weights = distinct_speeds(scene, folds=plan.folds)
        # Two numbers of speeds an octave share programs; those added have no weight.
        spare = size_class(speeds.size) - speeds.size
        speeds, weights = np.pad(speeds, (0, spare), mode="edge"), np.pad(weights, (0, spare))
        if speeds.size == scene.speeds.size:
            speeds = weights = None
    fewer = scene.without_metadata(speeds=speeds, weights=weights, power_spectrum=power)
    if scene.occlusion is None:
        return fewer
    grid, num_speeds = Frequencies.of_grid(plan.num_frequencies), plan.num_effective_speeds
    return Background.of(scene).behind(fewer, grid, num_speeds, folds=plan.folds)


def needed_speeds(scene: Scene, motion: AbstractMotion, shutter: AbstractShutter) -> Scene:
    """The scene with every speed once, none that never occurs, and no picture or motion."""
    if not scene.speeds_known:
        return scene.without_metadata()
    speeds, weights = distinct_speeds(scene, folds=folds_speeds(scene, motion, shutter))
    return scene.without_metadata(speeds=speeds, weights=weights)


def folds_speeds(scene: Scene, motion: AbstractMotion, shutter: AbstractShutter) -> bool:
    """Whether the kernels of `+s` and `-s` are known to be one on a motion without velocity."""
    is_prompt = scene.device is None or scene.device.follows_at_once
    is_symmetric = bool(getattr(shutter, "symmetric", False))
    if not (is_prompt and motion.mirrors and is_symmetric):
        return False
    if scene.occlusion is None or not scene.occlusion.has_edges:
        return True
    # Two layers are recorded alike where the speeds of the background mirror one another as well.
    background = Background.of(scene)
    if not (scene.speeds_known and all_concrete(background)):
        return False
    speeds, weights = (np.asarray(x) for x in background)
    forward, backward = np.argsort(speeds), np.argsort(-speeds)
    mirrored = np.array_equal(speeds[forward], -speeds[backward])
    return mirrored and np.array_equal(weights[forward], weights[backward])
