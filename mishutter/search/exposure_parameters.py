"""Frames of a burst by numbers without bounds, for optimisers of one's own."""

import math
from collections.abc import Callable
from itertools import pairwise
from typing import final

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from mishutter._core.checks import (
    Alike,
    Numbers,
    RowLike,
    as_float,
    require,
    require_known,
    row_of,
)
from mishutter._core.modules import AbstractModule
from mishutter.evaluation.bursts import FrameTimes
from mishutter.evaluation.instants import NODES
from mishutter.evaluation.levels import exposures_psnr, instants_of
from mishutter.model.exposures import Exposures, frames_of
from mishutter.model.frame_path import FramePath, Frames, frames_in
from mishutter.model.scene import Scene, require_scene

_NEAREST = 1e-3
"""Least distance of an exposure from its ends, in shares, and of a frame from the one before, in
periods, where the numbers would be infinite."""

_ROUNDING = 1e-6
"""Share of a frame, or of the time between two, below which a piece is one of rounding."""


@final
class ExposureParameters(AbstractModule):
    r"""Frames within a scene's limits, as a function of real numbers without bounds.

    The numbers are one $z$ of each exposure, $t_0 + (t_1 - t_0)/(1 + e^{-z})$ long between the
    shortest and the longest; one of each pause beyond the least that the frame rate and the dead
    time leave, $e^z$ periods; and the velocities of the sensor at the ends of the pieces of its
    path, in units of the speed by which the longest exposure of the start takes all of the stroke.
    Where things move in the plane and the stage has one axis, they are velocities along it, and one
    number more is its angle. Each piece has a constant acceleration, and keeps its share of its
    frame, or of the time between two.

    Frames that take more than the window $W$ are shortened: the time $F(s)$ that they take where
    what is beyond the least of each is $s$ times as long is convex, so that they fit with
    $s = (W - F(0))/(F(1) - F(0))$. A path that asks too much of the stage, from rest to rest, is
    slowed by the greatest share of a limit that it takes; a run-up then is shorter still. An
    optimiser that knows no bounds so moves frames that can be taken.

    Args:
        scene: A scene with a `burst`, and limits with a `max_acceleration` and no `max_jerk`.
        exposures: Frames to start from, which no camera turns beside: `Exposures`, as
            `best_sequence` finds them, `TimedFrame`s or `PlaneFrames`.

    Attributes:
        start: The numbers of those frames, or of the nearest that the limits allow; `(size,)`.

    Raises:
        ValueError: if the scene has no burst, no such limits, or no time for so many frames, if the
            camera turns, or if JAX traces an argument.

    Examples:
        >>> from mishutter import BurstMode, ExposureParameters, Limits, Scene, best_sequence
        >>> limits = Limits(max_stroke=30, max_acceleration=1e6, max_half_exposure=0.02)
        >>> burst = BurstMode(frames_per_s=50, max_frames=2)
        >>> light = {"photon_rate": 3e4, "read_noise": 5.0}
        >>> scene = Scene.uniform(max_speed=1500.0, **light, limits=limits, burst=burst)
        >>> parameters = ExposureParameters(scene, best_sequence(scene))
        >>> frames = parameters.frames(parameters.start)
        >>> loss = parameters.loss()
    """

    scene: Scene
    start: Float[Array, "size"]
    camera: FrameTimes = eqx.field(static=True)  # When it may expose frames
    # Of the pieces of each frame and of the time to the next one in turn: their shares of it
    shares: tuple[tuple[float, ...], ...] = eqx.field(static=True)
    num_axes: int = eqx.field(static=True)
    is_turned: bool = eqx.field(static=True)  # Whether a stage of one axis lies in the plane
    unit: float = eqx.field(static=True)  # Of velocities; px/s
    num_panels: int = eqx.field(static=True)  # Half as many again as the start's

    def __init__(self, scene: Scene, exposures: Frames | Exposures):
        require_scene(scene, in_plane=True)
        frames, limits = frames_of(exposures), scene.limits
        require_known("ExposureParameters", scene=scene, exposures=frames)
        subject = "ExposureParameters(scene=...)"
        require(scene.burst is not None, subject, "have a `burst`", scene)
        is_limited = limits.max_acceleration is not None and limits.max_jerk is None
        requirement = "have limits with a `max_acceleration` and without a `max_jerk`"
        require(is_limited, subject, requirement, limits)
        turns = isinstance(exposures, Exposures) and bool(exposures.turning)
        subject = "ExposureParameters(exposures=...)"
        require(not turns, subject, "be taken by a camera that does not turn", exposures)
        path = frames_in(frames).path_for_rows(0.0, limits)
        times, lit = np.asarray(path.times, np.float64), np.asarray(path.exposures, np.float64)
        begin, end = times - lit / 2, times + lit / 2
        requirement = "be in their order, and none begin before another ends"
        require(bool(np.all(begin[1:] >= end[:-1])), subject, requirement, exposures)
        ends = np.stack([begin, end], axis=-1).ravel()
        knots, self.shares = _pieces(ends, path.bends)
        self.scene, self.num_axes = scene, path.num_axes
        self.is_turned = path.num_axes == 2 and limits.axes == "one"
        self.camera = camera = FrameTimes.of(scene, scene.burst)  # type: ignore[arg-type]
        self.unit = float(limits.max_stroke) / float(np.max(lit))
        instants = instants_of(scene, path, "ExposureParameters")
        self.num_panels = math.ceil(1.5 * instants.time.shape[1] / NODES)
        least = np.full(lit.size, camera.shortest)
        requirement = f"be so few that {camera.window:.4g} s hold them"
        fits = float(self._duration(least, np.zeros(lit.size - 1))) <= camera.window
        require(fits, subject, requirement, lit.size)
        share = (lit - least) / max(camera.longest - camera.shortest, math.ulp(1.0))
        share = np.clip(share, _NEAREST, 1 - _NEAREST)
        pauses = (begin[1:] - end[:-1] - camera.least_pauses(lit)) / camera.period
        along, turn = np.asarray(path.velocities, np.float64), []
        if self.is_turned:
            axis = np.linalg.svd(along)[0][:, 0]
            along, turn = axis[None] @ along, [math.atan2(axis[1], axis[0])]
        velocities = [np.interp(knots, path.bends, each) for each in along]
        parts = (
            np.log(share / (1 - share)),
            np.log(np.maximum(pauses, _NEAREST)),
            np.concatenate(velocities) / self.unit,
            turn,
        )
        self.start = as_float(np.concatenate(parts).astype(scene.speeds.dtype))

    @property
    def size(self) -> int:
        """Number of numbers."""
        return self.start.size

    @property
    def num_frames(self) -> int:
        """Number of frames."""
        return (len(self.shares) + 1) // 2

    def frames(self, numbers: RowLike) -> FramePath:
        """The frames of some numbers, and the path of the sensor through them.

        Args:
            numbers: Numbers from the whole line; shape `(size,)`.

        Raises:
            ValueError: if they are of another shape, or known and not finite.
        """
        row = row_of("ExposureParameters.frames(numbers=...)", numbers, self.size)
        count, camera = self.num_frames, self.camera
        lit, pauses, velocities = jnp.split(row, [count, 2 * count - 1])
        beyond = (camera.longest - camera.shortest) * jax.nn.sigmoid(lit)
        pauses = camera.period * jnp.exp(pauses)
        least = self._duration(camera.shortest + 0 * beyond, 0 * pauses)
        whole = self._duration(camera.shortest + beyond, pauses)
        is_short = whole <= camera.window
        share = (camera.window - least) / jnp.where(is_short, 1.0, whole - least)
        share = jnp.where(is_short, 1.0, share)
        lit, pauses = camera.shortest + share * beyond, share * pauses
        pauses = pauses + camera.least_pauses(lit)
        parts = jnp.zeros(2 * count - 1, row.dtype).at[::2].set(lit).at[1::2].set(pauses)
        times = jnp.cumsum(parts)[::2] - lit / 2 - jnp.sum(parts) / 2
        each = zip(parts, self.shares, strict=True)
        durations = jnp.concatenate([part * jnp.asarray(own) for part, own in each])
        if self.is_turned:
            turn = velocities[-1]
            velocities = jnp.outer(jnp.stack([jnp.cos(turn), jnp.sin(turn)]), velocities[:-1])
        path = FramePath(times, lit, durations, self.unit * velocities.reshape(self.num_axes, -1))
        taken = Exposures("frames by numbers", path).share_of(self.scene.limits)
        return eqx.tree_at(lambda x: x.velocities, path, path.velocities / jnp.maximum(taken, 1.0))

    def loss(self) -> Callable[[RowLike], Float[Array, ""]]:
        """Minus the level of the frames, dB, as a function of the numbers.

        It holds frames in which things go twice as far on the sensor as in those to start from;
        longer ways are an error.

        Returns:
            A function of numbers of shape `(size,)`, to be differentiated and compiled.
        """
        return lambda numbers: (
            -exposures_psnr(self.scene, self.frames(numbers), num_panels=self.num_panels)
        )

    def _duration(self, lit: Alike, pauses: Alike) -> Numbers | np.floating:
        """Time of all frames, where pauses are beyond the least ones; s."""
        return lit.sum() + (self.camera.least_pauses(lit) + pauses).sum()


def _pieces(
    ends: Float[np.ndarray, "k"], bends: Float[np.ndarray, "m"]
) -> tuple[Float[np.ndarray, "p"], tuple[tuple[float, ...], ...]]:
    """Knots of a path between the begins and ends of frames, and the shares of pieces of each."""
    knots, shares = [ends[:1]], []
    for low, high in pairwise(ends):
        margin = _ROUNDING * (high - low)
        inner = bends[(bends > low + margin) & (bends < high - margin)]
        own = np.r_[low, inner[np.diff(inner, prepend=low) > margin], high]
        lengths = np.diff(own) if high > low else np.ones(1)
        knots.append(own[1:])
        shares.append((*(lengths / np.sum(lengths)).tolist(),))
    return np.concatenate(knots), (*shares,)
