"""The search for frames in the plane: ways of few numbers, and free paths from the best of them."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from mishutter._core.checks import Unquoted, require, require_known
from mishutter._core.compiling import compiled, outside_trace
from mishutter._core.parallel import alone_in_blas
from mishutter.evaluation.bursts import FrameTimes, some_numbers
from mishutter.evaluation.open_frames import psnr_of_error
from mishutter.model.exposures import AbstractExposures
from mishutter.model.scene import Scene, require_scene
from mishutter.model.sensor import BurstMode
from mishutter.model.stages import StagePath, StageUse
from mishutter.plane.borders import loss_of_borders
from mishutter.plane.ceilings import plane_ceiling
from mishutter.plane.families import FAMILIES, FREE, PAN, STILLS, Family, Room, of_stage
from mishutter.plane.frames import PlaneFrames
from mishutter.plane.levels import (
    MEASURED,
    SEARCHED,
    Fan,
    Grid,
    plane_error,
    plane_psnr,
    require_velocities,
)

_MOST_STEPS = 20
"""Most steps of the simplex of the best of a kind, for each of its numbers."""
_AS_GOOD = 0.05
"""Decibels below the best at which simpler frames are preferred, and that a free path must gain."""
_OF_DESCENT = Grid(28, 12, 24)
"""The grid of a free path, other than that by which it is measured: it exploits no ripple."""


@final
@dataclass(frozen=True)
class PlaneBurst(AbstractExposures):
    """Frames of a sensor that moves in the plane, and their level.

    Attributes:
        kind: The way of the sensor, in words.
        num_axes: Axes of the stage that it needs; 0 at rest.
        frames: The frames and the path through them.
        psnr: PSNR of the best linear decoder that finds the velocity; dB.
        use: Demands on an axis of the stage, from rest to rest.
        width_loss: Loss by things that enter and leave the scene's sensor or object, a square of
            its width; dB. None of one frame, and where no width is known.
    """

    kind: str
    num_axes: int
    frames: PlaneFrames
    psnr: float
    use: StageUse
    width_loss: float | None = None
    axes: ClassVar = ("_x", "_y")

    @property
    def level(self) -> float:
        """PSNR on a sensor of the scene's width; dB."""
        return self.psnr - (self.width_loss or 0.0)

    @property
    def times(self) -> list[float]:
        """Mid-exposures; s."""
        return np.asarray(self.frames.times).tolist()

    @property
    def exposures(self) -> list[float]:
        """Exposure of each frame; s."""
        return np.asarray(self.frames.exposures).tolist()

    @property
    def rests(self) -> list[bool]:
        """Whether the sensor stands still in all frames, for each."""
        return [self.frames.stays] * self.num_frames

    def place(self, times: Float[np.ndarray, "n q"]) -> Float[np.ndarray, "2 n q"]:
        """Places of the sensor at some times; px.

        Args:
            times: Times in each exposure; s.
        """
        return np.asarray(self.frames.place(times), np.float64)

    def stage_paths(self, scene: Scene) -> dict[str, StagePath]:
        """The paths of the stage along rows and columns, each about the middle of its travel.

        Args:
            scene: The scene, whose limits say how the stage runs up.
        """
        require_scene(scene, in_plane=True)
        frames = self.frames
        if self.num_axes:
            frames = of_stage(frames, require_velocities(scene), scene.limits)
        return dict(zip(self.axes, frames.stage_paths(scene.limits), strict=False))

    @property
    def text(self) -> str:
        """The frames in words, and their level."""
        loss = self.width_loss
        less = "" if loss is None else f", less {loss:.2g} by the width of the sensor"
        return f"{self.kind}, {self.setting}: {self.psnr:.2f} dB{less}"

    def __repr__(self) -> str:
        return f"PlaneBurst({self.text})"


@dataclass(frozen=True)
class PlaneSearch:
    """The best frames of each kind, and the level that none exceed.

    Attributes:
        snapshot: One exposure at rest.
        bursts: The best frames of each kind of way, the simplest first.
        ceiling: Level that no path over any number of frames exceeds; dB.
    """

    snapshot: PlaneBurst
    bursts: tuple[PlaneBurst, ...]
    ceiling: float

    @property
    def simplest(self) -> tuple[PlaneBurst, ...]:
        """For each number of axes of a stage, the simplest frames within 0.05 dB of the best."""
        chosen = []
        for axes in sorted({burst.num_axes for burst in self.bursts}):
            group = [burst for burst in self.bursts if burst.num_axes == axes]
            most = max(burst.level for burst in group)
            chosen.append(next(burst for burst in group if burst.level >= most - _AS_GOOD))
        return tuple(chosen)


@outside_trace()
@alone_in_blas()
def best_in_plane(
    scene: Scene, *, progress: Callable[[float], None] = lambda share: None
) -> PlaneSearch:
    """The best frames of things that move in any direction, registered by their velocity.

    A stage of two axes follows a circle, two sines of different frequency, parabolas crossed at
    right angles, or one constant velocity a frame; one of a single axis sweeps, swings on a sine or
    on parabolas along the axis of the fastest things. Limits hold for each axis, or for both
    together where they are those of a disc, from rest to rest. From the best way a free path
    descends by its gradient, and is among the bursts where it gains 0.05 dB.

    Args:
        scene: Velocities in any direction, light, noise, limits and burst; without a burst, which
            is possible where the decoder is told the velocity, it is one exposure.
        progress: Called with the share of the search that is done.

    Raises:
        ValueError: if the scene is of one axis, limits the jerk of its stage, or has no frames
            that tell the velocity.
    """
    require_scene(scene, in_plane=True)
    require_known("best_in_plane", scene=scene)
    require_velocities(scene)
    jerk = scene.limits.max_jerk
    requirement = "be left out in the plane, where ways are of pieces of constant acceleration"
    require(jerk is None, "Limits(max_jerk=...)", requirement, jerk)
    search = _Search.of(scene)
    requirement = (
        'have a burst with time for two frames, or `decoder_speed="known"`: frames tell it'
    )
    has_counts = search.counts[-1] >= search.least
    require(has_counts, "scene", requirement, Unquoted("one exposure of unknown velocity"))
    tries = [*search.tries]
    found: dict[str, _Found] = {}
    starts = []
    for number, (family, count) in enumerate(tries):
        progress(0.2 * number / len(tries))
        every = (search.found(family, count, np.array(x)) for x in family.starts)
        starts.append(min(every, key=_error))
    # The best two numbers of frames of each way are searched further.
    firsts = [
        first
        for kind in dict.fromkeys(start.family.kind for start in starts)
        for first in sorted((x for x in starts if x.family.kind == kind), key=_error)[:2]
    ]
    for number, first in enumerate(firsts):
        progress(0.2 + 0.5 * number / len(firsts))
        each, family = search.improved(first, 10), first.family
        before = found.get(family.kind)
        if before is None or each.level > before.level + _gain(each, before):
            found[family.kind] = each
    most = max(each.level for each in found.values())
    # A way that is 0.5 dB below the best may come to that by a longer simplex.
    near = {
        kind: search.improved(each, _MOST_STEPS) if each.level > most - 0.5 else each
        for kind, each in found.items()
    }
    bursts = [search.burst(each) for each in near.values()]
    progress(0.8)
    best = max(bursts, key=lambda burst: burst.level)
    if best.num_axes == 2:
        free = search.freed(best)
        if free.level >= best.level + _AS_GOOD:
            bursts.append(free)
    one = search.improved(search.found(FAMILIES[0], 1, np.array([0.5])), _MOST_STEPS)
    counts = [count for count in search.counts if count >= search.least]
    return PlaneSearch(
        search.burst(one),
        tuple(bursts),
        max(plane_ceiling(scene, np.full(n, search.room.exposure(n, 1.0))) for n in counts),
    )


def grid_words() -> str:
    """The computations of a search in the plane, in words."""
    radii, angles, speeds, corner = SEARCHED
    finer = f"{MEASURED.num_radii} x {MEASURED.num_angles} x {MEASURED.num_speeds}"
    ways = ", ".join(family.kind for family in FAMILIES)
    return (
        f"The search tries {ways}, and a free path from the best of them, over {radii} radii x "
        f"{angles} directions x {speeds} velocities and {corner} radii of the corners; levels are "
        f"over {finer}. One filter for all velocities is not searched: it gains nothing there."
    )


class _Found(NamedTuple):
    """A point of a way, and the error of its frames."""

    error: float
    family: Family
    num_frames: int
    point: Float[np.ndarray, "d"]

    @property
    def level(self) -> float:
        """Level of the error; dB."""
        return psnr_of_error(self.error)


def _error(found: _Found) -> float:
    return found.error


def _gain(other: _Found, before: _Found) -> float:
    """The gain that more frames are worth; dB."""
    return _AS_GOOD / 2 if other.num_frames > before.num_frames else -_AS_GOOD / 2


class _Search(NamedTuple):
    """The part that is the same of all ways and numbers of frames."""

    scene: Scene  # The scene
    room: Room  # Its velocities, limits and times
    least: int  # Least number of frames that something registers
    fans: tuple[Fan, Fan]  # Fans for few frames, whose ripple is greatest, and for more

    @staticmethod
    def of(scene: Scene) -> "_Search":
        """The search of a scene, of one exposure where it has no burst."""
        longest = 2 * float(scene.limits.max_half_exposure)
        none = BurstMode(frames_per_s=1 / longest, max_frames=1)
        times = FrameTimes.of(scene, none if scene.burst is None else scene.burst)
        times = times._replace(max_frames=min(times.max_frames or 64, 64))
        room = Room(scene.velocities, scene.limits, times)  # type: ignore[arg-type]
        told = scene.decoder_speed == "known"
        least = 1 if told else 2
        return _Search(scene, room, least, (Fan.of(scene, MEASURED), Fan.of(scene, SEARCHED)))

    @property
    def counts(self) -> list[int]:
        """Numbers of frames to try."""
        possible = self.room.times.numbers_of_frames
        return [count for count in some_numbers(possible[-1], 4) if count in possible]

    @property
    def tries(self) -> Iterator[tuple[Family, int]]:
        """Ways and numbers of frames."""
        most = 1 if self.scene.limits.axes == "one" else 2
        pans = bool(np.any(self.room.pan))
        for family in FAMILIES:
            if family.num_axes <= most and (pans or family.kind != PAN):
                least = max(family.least, self.least)
                yield from ((family, count) for count in self.counts if count >= least)

    def found(self, family: Family, count: int, point: Float[np.ndarray, "d"]) -> _Found:
        """A point of a way with its error."""
        whole, panels = self.sized(family.made(self.room, count, point))
        single = jax.tree.map(lambda x: np.asarray(x, np.float32), whole)
        is_many = count > 2  # so few leave ripples of 0.2 dB
        num_speeds = (SEARCHED if is_many else MEASURED).num_speeds
        error = plane_error(self.scene, single, self.fans[is_many], num_speeds, panels)
        return _Found(float(error), family, count, point)

    def sized(self, frames: PlaneFrames) -> tuple[PlaneFrames, int]:
        """Frames and panels of their nodes, of few sizes: each is a program to compile.

        Frames without an exposure follow the others, on a path with pieces without a length.
        """
        # Up to 8 panels and 512 pieces cost less than another program.
        panels = frames.num_panels(self.scene.velocities.fastest)  # type: ignore[union-attr]
        panels = max(_power_of_2(panels), 8)
        count, pieces = frames.num_frames, frames.durations.size
        missing, more = _power_of_2(count) - count, max(_power_of_2(pieces), 512) - pieces
        padded = PlaneFrames(
            np.pad(frames.times, (0, missing), mode="edge"),
            np.pad(frames.exposures, (0, missing)),
            np.pad(frames.durations, (0, more)),
            np.pad(frames.velocities, ((0, 0), (0, more)), mode="edge"),
        )
        return padded, panels

    def improved(self, first: _Found, steps: int) -> _Found:
        """The end of a simplex from a point, of at most some steps for each number."""
        from scipy.optimize import minimize

        size, best = first.point.size, first

        def error(point: Float[np.ndarray, "d"]) -> float:
            nonlocal best
            each = self.found(first.family, first.num_frames, point)
            best = min(best, each, key=_error)
            return each.error

        inwards = np.diag(np.where(first.point > 0.5, -0.12, 0.12))
        simplex = first.point + np.concatenate([np.zeros((1, size)), inwards])
        options: dict[str, Any] = {
            "initial_simplex": simplex,
            "xatol": 1e-3,
            "fatol": 1e-5 * first.error,
            "maxfev": steps * size,
        }
        minimize(error, first.point, method="Nelder-Mead", bounds=[(0, 1)] * size, options=options)
        return best

    def burst(self, found: _Found) -> PlaneBurst:
        """The frames of a point, with their level."""
        frames = found.family.made(self.room, found.num_frames, found.point)
        return self.measured(found.family.kind, found.family.num_axes, frames)

    def measured(self, kind: str, num_axes: int, frames: PlaneFrames) -> PlaneBurst:
        """Frames with their level."""
        whole, panels = self.sized(frames)
        psnr = float(plane_psnr(self.scene, whole, grid=MEASURED, num_panels=panels))
        axes = 0 if frames.stays else num_axes
        use = self.room.of_stage(frames).use(self.scene.limits)
        width, loss = self.scene.registered_width, None
        if width is not None and frames.num_frames > 1:
            loss = loss_of_borders(self.scene, frames, width=width)
        return PlaneBurst(STILLS if axes < num_axes else kind, axes, frames, psnr, use, loss)

    def freed(self, burst: PlaneBurst) -> PlaneBurst:
        """The end of a descent from a burst, by waves in the velocities."""
        start = burst.frames
        waves = min(2 * burst.num_frames + 8, 24)
        panels = start.num_panels(1.1 * self.scene.velocities.fastest)  # type: ignore[union-attr]
        # Single precision holds levels to 1e-4 dB, in a third of the time.
        dtype = np.dtype(np.float32)
        fan = Fan.of(self.scene, _OF_DESCENT)
        begin = jax.tree.map(lambda x: jnp.asarray(x, dtype), start)
        scale = float(np.max(self.room.half_axes))
        numbers, unit = jnp.zeros((2, waves), dtype), jnp.asarray(scale, dtype)
        end = _descended(numbers, begin, self.scene, fan, scale=unit, panels=panels)
        freed = np.asarray(_with_waves(end, begin, scale).velocities, np.float64)
        frames = eqx.tree_at(lambda x: x.velocities, start, freed)
        return self.measured(FREE, 2, self.room.within(frames))


def _power_of_2(count: int) -> int:
    """The next power of 2."""
    return 2 ** math.ceil(math.log2(count))


def _with_waves(
    numbers: Float[Array, "2 w"], start: PlaneFrames, scale: float | Array
) -> PlaneFrames:
    """Frames whose velocities have waves beside those of a start, in px/s over a scale."""
    ends = jnp.concatenate([jnp.zeros_like(start.durations[:1]), jnp.cumsum(start.durations)])
    share = ends / ends[-1]
    order = jnp.arange(numbers.shape[1], dtype=share.dtype)
    waves = jnp.cos(jnp.pi * order[:, None] * share[None])
    return eqx.tree_at(lambda x: x.velocities, start, start.velocities + scale * (numbers @ waves))


@compiled
def _descended(
    numbers: Float[Array, "2 w"],
    start: PlaneFrames,
    scene: Scene,
    fan: Fan,
    *,
    scale: Float[Array, ""],
    panels: int,
) -> Float[Array, "2 w"]:
    import optimistix as optx

    limits = scene.limits
    reference = plane_error(scene, start, fan, _OF_DESCENT.num_speeds, panels)

    def excess(frames: PlaneFrames) -> Array:
        v, d = frames.velocities, frames.durations
        shares = [v / limits.max_top_speed.astype(v.dtype)]
        if limits.max_acceleration is not None:
            lasts = jnp.where(d > 0, d, jnp.inf)[None]
            shares.append(jnp.diff(v) / lasts / limits.max_acceleration.astype(v.dtype))
        return sum(
            (jnp.sum(jax.nn.relu(jnp.abs(x) - 1) ** 2) for x in shares), jnp.zeros((), v.dtype)
        )

    def loss(numbers: Array, _: None) -> Array:
        frames = _with_waves(numbers, start, scale)
        error = plane_error(scene, frames, fan, _OF_DESCENT.num_speeds, panels)
        # Limits are soft: a path beyond them is slowed down to them afterwards.
        return jnp.log(error / reference) + 30.0 * excess(frames)

    solver = optx.BFGS(rtol=1e-4, atol=1e-5)
    end = optx.minimise(loss, solver, numbers, max_steps=50, throw=False)
    return end.value
