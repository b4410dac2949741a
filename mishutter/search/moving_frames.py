"""The best frames of a sensor that moves along one axis."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from mishutter._core.checks import require_known
from mishutter._core.compiling import outside_trace
from mishutter._core.parallel import alone_in_blas
from mishutter.evaluation.bursts import FrameTimes
from mishutter.evaluation.open_frames import in_parts, psnr_of_error
from mishutter.evaluation.sequences import loss_of_width
from mishutter.evaluation.speed_knowledge import knowledge_of
from mishutter.model.motion import (
    AbstractMotion,
    FreeMotion,
    LinearMotion,
    ParabolicMotion,
    StillCamera,
)
from mishutter.model.scene import Scene
from mishutter.model.sequences import SINE, FrameSequence, TimedFrame
from mishutter.model.stages import place_at_begin
from mishutter.search.frame_levels import Frames, Levels
from mishutter.search.frame_limits import Room
from mishutter.search.frame_search import (
    ALTERNATING,
    FAN,
    FOLLOW,
    FREE,
    PAN,
    SWEEP,
    WAYS,
    End,
    Search,
    Tie,
)

ONE_PARABOLA = "one parabola"
_AS_GOOD = 0.05
"""Decibels below the best at which a simpler way is preferred."""
_MOST = 64
"""Most frames of a search: each has a transfer function of its own."""
_STRAIGHT = 0.25
"""Way aside of a pan below which a frame is one; px."""
_BEYOND = 1.05
"""Share of a limit that frames are slowed down from, as a solver keeps limits to some digits."""


@outside_trace()
@alone_in_blas()
def best_moving_burst(
    scene: Scene, *, progress: Callable[[float], None] = lambda share: None
) -> FrameSequence | None:
    """The frames of least error of a sensor that moves; None without `scene.burst`.

    Each frame has a length, a velocity at its begin and one at its end, and a place, and the stage
    goes from one to the next in any way that its acceleration, top speed and travel allow, from rest
    to rest. A stage of limited jerk pans, sweeps or follows a sine. Of frames within 0.05 dB of the best
    those of the simplest way are taken. One exposure alone, which nothing registers, is among them
    where the scene's decoder is told the speed, or where there is no time for more. On a sensor of
    a known width the frames are those that leave least error there.

    Args:
        scene: Speeds, light, noise, limits and burst.
        progress: Called with the share of the search that is done.
    """
    require_known("best_moving_burst", scene=scene)
    if scene.burst is None:
        return None
    times, limits = FrameTimes.of(scene, scene.burst), scene.limits
    least = 2 if times.holds_several and not knowledge_of(scene).is_told else 1
    counts = [n for n in times.numbers_of_frames if least <= n <= _MOST]
    slowest, fastest = (float(x) for x in in_parts(scene).speed_range)
    room = Room.of(limits, times, max(abs(slowest), abs(fastest)))
    kinds = WAYS if limits.max_jerk is None else (PAN, SWEEP, SINE)
    jerk = math.inf if limits.max_jerk is None else float(limits.max_jerk)
    unit, none = np.ones(1), np.zeros(1)

    def ties(shape: tuple[int, int, int]) -> list[Tie]:
        every = (Tie(x, room, shape, slowest, fastest, unit, none, jerk) for x in kinds)
        return [tie for tie in every if tie.exists]

    search = Search(Levels.on_axis(scene), room, 1, ties, _pieces, limits.max_jerk is None)
    ends = [_Found.of(scene, end, search.levels) for end in search.ends(counts, progress)]
    return _chosen(scene, [end for end in ends if end is not None])


def _pieces(count: int) -> int:
    """Pieces of each of so many frames: few frames gain by more."""
    return {1: 6, 2: 2}.get(count, 1)


class _Found:
    """Frames within the limits, and their level."""

    def __init__(self, sequence: FrameSequence, simplicity: int, level: float) -> None:
        self.sequence, self.simplicity, self.level = sequence, simplicity, level

    @staticmethod
    def of(scene: Scene, end: End, levels: Levels) -> "_Found | None":
        """The end of a descent, brought within the limits; None where it is far from them."""
        if end.frames is None:
            return None
        frames = end.frames
        for _ in range(3):
            sequence = sequence_of(frames, end.kind)
            share = _share(scene, sequence)
            if share <= 1:
                break
            if share > _BEYOND:
                return None
            slower = (1 - 1e-9) / share
            velocity = frames.pan + (frames.velocity - frames.pan) * slower
            frames = frames._replace(velocity=velocity, place=frames.place * slower)
        return _Found(sequence, _simplicity(end.kind), levels.level(frames))


def _share(scene: Scene, sequence: FrameSequence) -> float:
    """Greatest share of a limit that the path of a stage takes."""
    limits, use = scene.limits, scene.limits.use_of_frames(sequence)
    pairs = [
        (use.stroke, limits.max_stroke),
        (use.top_speed, limits.max_top_speed - abs(sequence.pan)),
        (use.travel, limits.max_travel),
        (use.acceleration, limits.max_acceleration),
    ]
    return max(
        float(taken) / float(there) if float(there) > 0 else float(float(taken) > 0)
        for taken, there in pairs
        if there is not None
    )


def _simplicity(kind: str) -> int:
    return (*WAYS[:2], SINE, *WAYS[2:], FREE).index(kind)


def _chosen(scene: Scene, found: list[_Found]) -> FrameSequence | None:
    """The simplest frames of those that are as good as the best on the scene's sensor."""
    if not found:
        return None
    width, top = scene.registered_width, max(each.level for each in found)
    if width is not None:
        # Frames that are as good without an end differ by some decibels on a narrow sensor.
        near = sorted(found, key=lambda each: -each.level)[:12]
        for each in near:
            frames = each.sequence.frames
            each.level -= loss_of_width(scene, frames, width=width) if len(frames) > 1 else 0.0
        found, top = near, max(each.level for each in near)
    near = [each for each in found if each.level >= top - _AS_GOOD]
    best = min(near, key=lambda each: (each.simplicity, -each.level))
    own = best.sequence
    kind = (
        ONE_PARABOLA
        if own.num_frames == 1
        else kind_of(own)
        if best.simplicity == _simplicity(FREE)
        else own.kind
    )
    psnr, worst = levels_of(scene, own.frames)
    return scene.limits.with_travel(replace(own, kind=kind, psnr=psnr, worst_psnr=worst))


def levels_of(scene: Scene, frames: Sequence[TimedFrame]) -> tuple[float, float]:
    """The level of frames in the mean over the scene's speeds and at the worst of them; dB."""
    velocities, exposures = [], []
    count = max(len(frame.motion.end_velocities) for frame in frames) - 1
    for frame in frames:
        ends = np.asarray(frame.motion.end_velocities, np.float64)
        velocities.append(
            np.interp(np.linspace(0, 1, count + 1), np.linspace(0, 1, ends.size), ends)
        )
        exposures.append(frame.exposure)
    none, exposure = np.zeros((len(frames), 1)), np.array(exposures)
    made = Frames(exposure, np.array(velocities)[..., None], exposure[1:], none, np.zeros(1))
    levels = Levels.on_axis(scene, literal=True)
    by_speed = np.sum(levels.errors(made), axis=0)
    weights = np.sum(levels.weight, axis=0) / np.sum(levels.weight)
    variance = float(np.sum(levels.weight))
    worst = np.max(by_speed / weights) if variance else 0.0
    return psnr_of_error(float(np.sum(by_speed))), psnr_of_error(float(worst))


def sequence_of(frames: Frames, kind: str) -> FrameSequence:
    """Frames along one axis, with the motion and the time of each."""
    exposure, pan = frames.exposure, float(frames.pan[0])
    begins = np.concatenate([[0.0], np.cumsum(exposure[:-1] + frames.gap)])
    middles = begins + exposure / 2 - (begins[-1] + exposure[-1]) / 2
    every = []
    for velocity, time, length, place in zip(
        frames.velocity[..., 0],
        middles.tolist(),
        exposure.tolist(),
        frames.place[:, 0].tolist(),
        strict=True,
    ):
        motion, of_stage = (_motion(x, length / 2) for x in (velocity, velocity - pan))
        every.append(TimedFrame(motion, time, place - place_at_begin(of_stage) + pan * time))
    first = every[0].position
    moved = tuple(TimedFrame(x.motion, x.time, x.position - first) for x in every)
    return FrameSequence(kind, moved, 0.0, 0.0, 0.0, pan)


def _motion(velocities: Float[np.ndarray, "k"], half: float) -> AbstractMotion:
    """The motion of an exposure by its velocities at the ends of equal pieces, px/s."""
    count = velocities.size - 1
    middle = float(np.interp(count / 2, np.arange(count + 1), velocities))
    rates = np.diff(velocities) / (4 * half / count)
    if np.max(np.abs(np.diff(velocities))) <= 1e-9 * np.max(np.abs(velocities), initial=1e-30):
        still = StillCamera(half_exposure=half)
        return LinearMotion(half_exposure=half, velocity=middle) if middle else still
    if count == 1 and rates[0] > 0:
        return ParabolicMotion(acceleration=float(rates[0]), half_exposure=half, velocity=middle)
    return FreeMotion(accelerations=rates, half_exposure=half, velocity=middle)


def kind_of(sequence: FrameSequence) -> str:
    """The way of a sensor over frames, told from their motions and places."""
    moving = [frame for frame in sequence.frames if not frame.is_still]
    if not moving:
        return FREE
    ends = np.array([np.asarray(x.motion.end_velocities, np.float64)[[0, -1]] for x in moving])
    lengths, middle = np.array([x.exposure for x in moving]), np.mean(ends, axis=1)
    aside = np.abs(ends[:, 1] - ends[:, 0]) * lengths / 8
    is_steady = bool(np.all(aside < np.maximum(_STRAIGHT, 0.02 * np.abs(middle) * lengths)))
    one_way = bool(np.all(ends >= 0) or np.all(ends <= 0))
    # Between frames the sensor goes against their velocity.
    ways = np.diff([frame.position for frame in moving])
    between = ways - (middle[1:] * lengths[1:] + middle[:-1] * lengths[:-1]) / 2
    returns = bool(np.all(between * np.sign(middle[0]) < -_STRAIGHT))
    if one_way and len(moving) > 1 and returns:
        return FOLLOW
    if is_steady:
        return PAN if len(moving) > 1 and np.ptp(middle) < 0.05 * np.max(np.abs(middle)) else FAN
    turns = ends[:, 0] * ends[:, 1] < 0
    gains = np.sign(ends[:, 1] - ends[:, 0])
    if np.all(turns):
        return ALTERNATING
    if np.all(gains == gains[0]) and np.all(np.diff(middle) * gains[0] > 0):
        return SWEEP
    return FREE
