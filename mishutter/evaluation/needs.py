"""The needs of a scene: sizes and skips, chosen before anything is computed and shared by all.

A plan leaves out only work that cannot change a result: speeds that never occur, occur twice or
mirror one another under a symmetric shutter; taps that no object reaches; terms without weight.
`plan=None` computes everything all the same.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from mishutter._core import all_concrete, is_concrete, numbers_of, require
from mishutter.blur import default_num_frequencies, support
from mishutter.model import (
    CORNER_FREQUENCY,
    NUM_FREQUENCIES,
    AbstractMotion,
    AbstractShutter,
    Scene,
    frequencies,
    on_steps,
)

_PHASE_PER_NODE = 1.8
_SPARE_NODES = 12
_MAX_TAPS = 1 << 14
_MAX_NODES = 1 << 16
_SAME_SPEED = 4
"""Two speeds count as one if they differ by up to this many roundings of the fastest."""
_UNKNOWN_REACH = 256.0


class Automatic(Enum):
    """The default of every `plan=`: a plan made from the scene, motion and shutter given."""

    PLANNED = "planned"


PLANNED = Automatic.PLANNED


@dataclass(frozen=True)
class Item:
    """One decision of a plan.

    Attributes:
        name: What the decision is about.
        full: How much of it a full computation has.
        kept: How much of it the plan keeps.
        why: Why that is enough.
    """

    name: str
    full: str
    kept: str
    why: str


@dataclass(frozen=True)
class Plan:
    """What to compute; static, hashable, and equal for scenes of equal needs.

    Attributes:
        num_taps: Taps of a blur kernel.
        dft_length: Length of the DFT that the condition number is taken over.
        num_frequencies: Frequencies in (0, 0.5) cycles/px of the expected error.
        num_nodes: Nodes over the whole exposure for the transfer functions there.
        num_kept: The lowest of the frequencies, to which the expected error is confined;
            None for all.
        skips: Whether work that cannot change a result is left out: speeds that never occur
            or occur twice, and responses that a search would compute again.
        folds: Whether `+s` and `-s` are taken for one speed.
        still: Whether nothing in the scene moves, so that one kernel is enough.
        items: The decisions and their reasons, for readers; no computation uses them.
    """

    num_taps: int
    dft_length: int
    num_frequencies: int
    num_nodes: int
    num_kept: int | None = None
    skips: bool = False
    folds: bool = False
    still: bool = False
    items: tuple[Item, ...] = field(default=(), compare=False, repr=False)

    def __str__(self) -> str:
        header = Item("item", "full", "kept", "why")
        rows = [header, *self.items]
        widths = [max(len(getattr(row, name)) for row in rows) for name in ("name", "full", "kept")]
        return "\n".join(_line(row, widths) for row in rows)

    def to_dict(self) -> dict[str, Any]:
        """The plan as plain numbers and text."""
        return vars(self) | {"items": [vars(item) for item in self.items]}

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> "Plan":
        """The plan that `to_dict` wrote.

        Raises:
            KeyError: if `data` is not such a plan.
            TypeError: if it holds more than one.
        """
        return Plan(**{**data, "items": tuple(Item(**item) for item in data["items"])})


def _line(row: Item, widths: list[int]) -> str:
    cells = zip((row.name, row.full, row.kept), widths, strict=True)
    return "  ".join([*(cell.ljust(width) for cell, width in cells), row.why])


def sizes(scene: Scene, motion: AbstractMotion) -> Plan:
    """Sizes that hold the scene on this motion and on every motion within its limits.

    One size for all motions makes designs comparable (the condition number depends on
    the DFT length) and lets them share one compiled program. Where the motion or the speeds
    are traced, only the limits are known; where those are traced too, sizes allow for kernels
    of up to 256 px. Values that are only differentiated are known.
    """
    scene, motion = numbers_of((scene, motion))
    if not is_concrete(scene.limits.max_stroke):
        return sized_for(_UNKNOWN_REACH, _UNKNOWN_REACH)
    longest = 4 * float(scene.limits.max_stroke)
    if not all_concrete((scene.speeds, motion)):
        return sized_for(longest, longest)
    reach, velocity = extent(scene, motion)
    return sized_for(max(reach, longest), max(velocity, longest))


def extent(scene: Scene, motion: AbstractMotion) -> tuple[float, float]:
    """Length of the longest kernel, px, and its greatest velocity, px per half exposure."""
    a, half = (np.asarray(x, np.float64) for x in (motion.acceleration, motion.half_exposure))
    stroke, smear = a * half * half, float(scene.max_speed) * half
    moving = stroke > 0
    with np.errstate(over="ignore"):  # a tiny stroke: a kernel longer than any that is kept
        length = (2 * stroke + smear) ** 2 / (4 * np.where(moving, stroke, 1.0))
    reach = np.where(moving, length, 0.0)
    longest = np.max(np.maximum(reach, 2 * smear))
    return float(longest), float(np.max(2 * stroke + smear))


def larger(first: Plan, second: Plan) -> Plan:
    """Sizes large enough for both plans."""
    return Plan(
        max(first.num_taps, second.num_taps),
        max(first.dft_length, second.dft_length),
        max(first.num_frequencies, second.num_frequencies),
        max(first.num_nodes, second.num_nodes),
    )


def sized_for(reach: float, velocity: float) -> Plan:
    """Sizes for kernels of `reach` px on paths of at most `velocity` px per half exposure."""
    num_taps = _rounded_up(min(reach + 1.0, float(_MAX_TAPS)))
    phase = 2 * np.pi * 0.5 * 2 * velocity
    num_nodes = _rounded_up(phase / _PHASE_PER_NODE + 4 * _SPARE_NODES)
    length = default_num_frequencies(num_taps)
    return Plan(num_taps, length, NUM_FREQUENCIES, min(num_nodes, _MAX_NODES))


def _rounded_up(count: float) -> int:
    """Round up to one of four sizes an octave, so that similar scenes share a program."""
    count = max(16, int(np.ceil(count)))
    step = max(4, 1 << (count.bit_length() - 3))
    return -(-count // step) * step


def automatic(scene: Scene, motion: AbstractMotion, shutter: AbstractShutter) -> Plan:
    """The plan that a function makes by default: exact, and one for every motion.

    Its sizes hold every motion within the scene's limits, so that one compiled program
    serves all of them.
    """
    folds, still = is_symmetric(shutter), nothing_moves(scene)
    return replace(sizes(scene, motion), skips=True, folds=folds, still=still)


def require_plan(value: object) -> None:
    """Refuse a value that is no plan; without this it would count as the default."""
    known = value is None or isinstance(value, Plan | Automatic)
    require(known, "plan", "be a plan, or None for everything", value)


class Parts(NamedTuple):
    """Parts of a response.

    Attributes:
        kernels: The kernel of an object at rest.
        spectra: Transfer functions at the scene's speeds.
        differences: Kernels at the scene's speeds, less the one at rest.
    """

    kernels: bool
    spectra: bool
    differences: bool


def chosen(
    plan: Plan | Automatic | None,
    scene: Scene,
    motion: AbstractMotion,
    shutter: AbstractShutter,
    parts: Callable[[Plan], Parts],
) -> tuple[Plan, AbstractMotion]:
    """The plan that an argument `plan=` stands for, and the motion.

    One that is traced is refused, when it is run, if a plan made here has too few taps or
    nodes for those parts of its response that are used.
    """
    require_plan(plan)
    if isinstance(plan, Plan):
        return plan, motion
    found = sizes(scene, motion) if plan is None else automatic(scene, motion, shutter)
    if all_concrete(numbers_of((scene.speeds, motion))):
        return found, motion
    used, fastest = parts(found), scene.max_speed
    if used.kernels:
        reach = support(motion, fastest if used.differences else jnp.zeros_like(fastest))
        requirement = f"keep light within {found.num_taps} px of where it is aligned"
        motion = _refused(motion, reach > found.num_taps, requirement)
    if used.spectra:
        # Nodes hold twice the velocity that they are chosen for, to 1e-7.
        velocity = (motion.top_speed + fastest) * motion.half_exposure
        most = int(2 * (found.num_nodes - 4 * _SPARE_NODES) * _PHASE_PER_NODE / (2 * np.pi))
        requirement = f"be passed at no more than {most} px per half exposure"
        motion = _refused(motion, velocity > most, requirement)
    return found, motion


def _refused(motion: AbstractMotion, exceeds: Array, requirement: str) -> AbstractMotion:
    """The motion, which is an error, when it is run, where it `exceeds` a requirement."""
    where = "where it or the scene's limits are traced"
    message = f"`motion` must {requirement} {where}; got one that exceeds it."
    # Threads the error on a number of its own: the branches that return the motion itself would
    # differ in how they vary over the devices of a mesh.
    nothing = eqx.error_if(jnp.zeros(()), exceeds, message)
    return jax.tree.map(lambda x: x + nothing.astype(x.dtype), motion)


def reduced(scene: Scene, plan: Plan) -> Scene:
    """The scene with only the numbers that a plan keeps: no picture, no motion, fewer speeds.

    Scenes that differ only in their numbers get the same shapes, and share programs.
    """
    power = _power_on_grid(scene, plan)
    if not (plan.skips and scene.speeds_known):
        return scene.bare(power_spectrum=power)
    speeds, weights = distinct_speeds(scene, folds=plan.folds)
    speeds, weights = padded(speeds, weights)
    if speeds.size == scene.speeds.size:
        return scene.bare(power_spectrum=power)
    return scene.bare(speeds=speeds, weights=weights, power_spectrum=power)


def distinct_speeds(scene: Scene, *, folds: bool) -> tuple[np.ndarray, np.ndarray]:
    """Speeds that occur, each once, ascending, with their weights; shapes `(n,)`.

    Speeds that differ only in their last digits count as one, because rounding makes such
    pairs in ranges that are meant to mirror themselves.
    """
    speeds, weights = np.asarray(scene.speeds), np.asarray(scene.weights)
    speeds, weights = speeds[weights > 0], weights[weights > 0]
    values = np.abs(speeds) if folds else speeds
    order = np.argsort(values, kind="stable")
    values, weights = values[order], weights[order]
    begins = np.diff(values, prepend=-np.inf) > rounding(values, values.dtype)
    merged = np.bincount(np.cumsum(begins) - 1, weights)
    return values[begins], merged.astype(weights.dtype)


def rounding(speeds: np.ndarray, dtype: np.dtype) -> float:
    """Difference up to which two of these speeds count as one in a precision; px/s."""
    return float(_SAME_SPEED * np.finfo(dtype).eps * np.max(np.abs(speeds), initial=0))


def padded(speeds: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Speeds padded to one of two counts an octave, without weight, so that shapes are shared."""
    spare = size_class(speeds.size) - speeds.size
    return np.pad(speeds, (0, spare), mode="edge"), np.pad(weights, (0, spare))


def size_class(count: int) -> int:
    """The least of 1, 2, 3, 4, 6, 8, 12, ... that is at least `count`."""
    octave = 1 << max(0, count - 1).bit_length()
    return octave * 3 // 4 if octave >= 4 and count <= octave * 3 // 4 else octave


def nothing_moves(scene: Scene) -> bool:
    """Whether every speed that occurs is known to be 0."""
    if not scene.speeds_known:
        return False
    return not np.any(np.asarray(scene.speeds)[np.asarray(scene.weights) > 0])


def needed_speeds(scene: Scene, shutter: AbstractShutter) -> Scene:
    """The scene with every speed once, none that never occurs, and no picture or motion.

    A symmetric shutter has one kernel for `+s` and `-s`, and these are folded. Results
    computed from the scene change only by rounding.
    """
    if not scene.speeds_known:
        return scene.bare()
    speeds, weights = distinct_speeds(scene, folds=is_symmetric(shutter))
    return scene.bare(speeds=speeds, weights=weights)


def is_symmetric(shutter: AbstractShutter) -> bool:
    """Whether a shutter is known to satisfy `w(-tau) = w(tau)`."""
    return bool(getattr(shutter, "symmetric", False))


def _power_on_grid(scene: Scene, plan: Plan) -> np.ndarray | jax.Array | None:
    """The scene's power spectrum, sampled at the plan's frequencies if that changes no result."""
    given = scene.power_spectrum
    if not is_concrete(given) or plan.num_frequencies != NUM_FREQUENCIES:
        return given
    return _spectrum(scene, NUM_FREQUENCIES)


def power_on_grid(scene: Scene, num_frequencies: int) -> np.ndarray:
    """Power of the picture's rows at frequencies that the optics pass, in arbitrary units."""
    passed = frequencies(num_frequencies) <= float(scene.cutoff_frequency)
    return _spectrum(scene, num_frequencies) * passed * (float(scene.deviation) > 0)


def _spectrum(scene: Scene, num_frequencies: int) -> np.ndarray:
    if scene.power_spectrum is None:
        grid = frequencies(num_frequencies)
        return (1 / (grid**2 + CORNER_FREQUENCY**2)).astype(scene.speeds.dtype)
    return np.asarray(on_steps(np.asarray(scene.power_spectrum), num_frequencies))
