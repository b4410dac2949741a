"""The best frames of a sensor that moves along one axis."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from mishutter._core.checks import require_known
from mishutter._core.compiling import outside_trace
from mishutter._core.parallel import alone_in_blas
from mishutter.evaluation.bursts import FrameTimes
from mishutter.evaluation.levels import in_parts, psnr_of_error, rows_of
from mishutter.evaluation.registration import loss_of_width
from mishutter.evaluation.speed_knowledge import knowledge_of
from mishutter.model.exposures import Exposures, path_for_rows
from mishutter.model.frame_path import SINE, TimedFrame, height_of_sine
from mishutter.model.motion import (
    AbstractMotion,
    FreeMotion,
    LinearMotion,
    ParabolicMotion,
    StillCamera,
)
from mishutter.model.scene import Scene
from mishutter.model.stages import place_at_begin
from mishutter.search.frame_levels import Frames, Levels, Shape, is_range
from mishutter.search.frame_limits import Room
from mishutter.search.frame_rows import RowLevels, errors_by_rows
from mishutter.search.frame_search import Descent, End, Search, shaken, within
from mishutter.search.frame_ties import (
    AS_GOOD,
    BRACKETED,
    FREE,
    MOST,
    MOST_FREE,
    PAN,
    SIMPLEST_FIRST,
    STILLS,
    SWEEP,
    WAYS,
    Tie,
)
from mishutter.search.frame_words import kind_of

ONE_PARABOLA = "one parabola"
_OF_TELEPHONES = 0.01
"""Time within which a telephone reads its rows; s."""
_FAR = 0.5
"""Decibels below the best at which an end is not judged: levels that are told differ by less."""
_NEARLY_WITHIN = 1.01
"""Share of the limits from which frames are slowed down rather than a camera turned."""
_SPARED = 0.8
"""Share of the stroke of a stage that is left to it where a camera turns for no other reason."""
_ON_SENSOR = 12
"""Ends that are judged on a sensor of a known width."""
_STARTS_BY_ROWS = 5
"""Ends among these near which descents of the level by rows begin."""


@outside_trace()
@alone_in_blas()
def best_moving_burst(
    scene: Scene, *, progress: Callable[[float], None] = lambda share: None
) -> Exposures | None:
    """The frames of least error of a sensor that moves.

    Each frame has a length, a place, and velocities at its ends and, where there are few frames,
    between them. The stage goes from one to the next in any way that its acceleration, top speed
    and travel allow, from rest to rest. A stage of limited jerk pans, sweeps or follows a sine, as
    does one of more than 24 frames, or follows things and flies back. Of frames within 0.05 dB of
    the best those of the simplest way are taken. One exposure alone, which nothing registers, is
    among them where the scene's decoder is told the speed, or where there is no time for more. On a
    sensor of a known width the frames are those that leave least error there.

    Args:
        scene: Speeds, light, noise, limits and burst.
        progress: Called with the share of the search that is done.

    Returns:
        The frames; None without `scene.burst`, and where none are within the limits.
    """
    require_known("best_moving_burst", scene=scene)
    if scene.burst is None:
        return None
    times, limits = FrameTimes.of(scene, scene.burst), scene.limits
    least = 2 if times.holds_several and not knowledge_of(scene).is_told else 1
    counts = [n for n in times.numbers_of_frames if least <= n <= MOST]
    slowest, fastest = (float(x) for x in in_parts(scene).speed_range)
    room = Room.of(limits, times, max(abs(slowest), abs(fastest)))
    moving = WAYS if limits.max_jerk is None else (PAN, SWEEP, SINE)
    kinds = (STILLS, BRACKETED, *(moving if limits.moves else (PAN,)))
    jerk = math.inf if limits.max_jerk is None else float(limits.max_jerk)

    def ties(shape: Shape) -> list[Tie]:
        ends = slowest, fastest, np.ones(1), np.zeros(1), jerk
        every = (Tie(kind, room, shape, *ends) for kind in kinds)
        return [tie for tie in every if tie.exists]

    speeds = np.unique([*np.asarray(in_parts(scene).speeds, np.float64), 0.0])
    stands_for_more = is_range(np.asarray(in_parts(scene).speeds))

    def followed(count: int) -> tuple[float, ...]:
        # One of a few frames follows a thing of a list, but serves all of a range. On a sensor
        # frames that each follow another lose more than they gain.
        serves_all = _pieces(count) > 1 or _is_judged_on_sensor(scene)
        return () if stands_for_more and serves_all else tuple(speeds.tolist())

    levels, is_free = Levels.on_axis(scene), limits.moves and limits.max_jerk is None
    search = Search(levels, room, ties, _pieces, followed, is_free)
    # Descents of the level by rows take most of the time.
    part = 0.3 if scene.sensor.is_rolling and is_free else 0.9
    found = _judged(scene, search.ends(counts, lambda share: progress(part * share)))
    progress(part)
    return _chosen(scene, found, search, progress) if found else None


def _judged(scene: Scene, ends: list[End]) -> list["_Found"]:
    """Ends within the limits, the best first, but for those that are far below the best."""
    found: list[_Found] = []
    least = -math.inf
    for end in sorted(ends, key=lambda each: -each.level):
        if end.level < least and not _is_judged_on_sensor(scene):
            break
        each = _Found.of(scene, end)
        if each is not None:
            found.append(each)
            least = max(least, end.level - _FAR)
    return found


def _pieces(count: int) -> int:
    """Pieces of each of so many frames: few frames gain by more."""
    return {1: 6, 2: 2, 3: 2}.get(count, 1)


@dataclass(frozen=True)
class _Found:
    """Frames within the limits, and their level."""

    sequence: Exposures
    level: float  # dB
    frames: Frames  # As the search has them

    @staticmethod
    def of(scene: Scene, end: End) -> "_Found | None":
        """The end of a descent, brought within the limits; None where it is far from them."""
        frames = end.frames
        if scene.limits.pans == "camera":
            frames = _spared(scene, frames)
        sequence = within(scene.limits, frames, lambda slowed: sequence_of(slowed, end.kind))
        if sequence is None:
            return None
        # Ends are judged by the level that is told, at the scene's own speeds.
        return _Found(sequence, levels_of(scene, sequence.along)[0], end.frames)

    def on_sensor(self, scene: Scene) -> "_Found":
        """These with the level by the scene's rows, and on a sensor of its width."""
        width, level = scene.registered_width, self.level
        if self.sequence.moves and scene.sensor.is_rolling:
            level = _levels_by_rows(scene, self.sequence)[0]
        if width is not None and self.sequence.num_frames > 1:
            level -= loss_of_width(scene, self.sequence, width=width)
        return replace(self, level=level)

    @property
    def order(self) -> tuple[int, float]:
        """The simplest come first, and of these the best."""
        return SIMPLEST_FIRST.index(self.sequence.kind), -self.level


def _spared(scene: Scene, frames: Frames) -> Frames:
    """The frames with a camera that turns along with the mean of them, if the limits allow it.

    The level knows nothing of who moves the sensor: the less the stage, the better. A camera that
    spares it little does not turn.
    """
    most = float(scene.limits.max_pan)
    mean = np.clip(np.mean(frames.velocity, axis=(0, 1)), -most, most)
    place = frames.place + frames.begins[:, None] * frames.pan
    turned = frames._replace(pan=mean).in_line()
    every = frames._replace(pan=0 * mean, place=place), frames, turned
    made = [sequence_of(each, FREE) for each in every]
    shares = [each.share_of(scene.limits) for each in made]
    best = 1 + int(shares[2] < shares[1])
    spares = made[best].stroke < _SPARED * made[0].stroke
    return every[best if spares or shares[0] > _NEARLY_WITHIN else 0]


def _is_judged_on_sensor(scene: Scene) -> bool:
    """Whether borders or rows decide between frames that are as good on an endless sensor."""
    return scene.registered_width is not None or scene.sensor.is_rolling


def _by_rows(
    scene: Scene, found: list[_Found], search: Search, progress: Callable[[float], None]
) -> list[_Found]:
    """Ends of descents of the level by rows, from near the best by it."""
    readout, draw, ends = scene.sensor.readout_time, np.random.default_rng(1), []
    free = [
        each for each in found if each.sequence.moves and each.frames.exposure.size <= MOST_FREE
    ]
    nearest = sorted(free, key=lambda each: -each.level)[:_STARTS_BY_ROWS]
    for index, each in enumerate(nearest):
        progress(0.4 + 0.4 * index / len(nearest))
        goes_on = each.sequence.for_rows(readout, scene.limits).along.lead > 0
        rows = RowLevels(search.levels, search.room, readout, goes_on)
        descent = Descent(search.levels, search.room, each.frames.shape, rows)
        ends.append(descent.free(shaken(each.frames, draw, search.room, 0.01)))
    progress(0.8)
    judged = (_Found.of(scene, end) for end in ends if end is not None)
    return [each.on_sensor(scene) for each in judged if each is not None]


def _chosen(
    scene: Scene, found: list[_Found], search: Search, progress: Callable[[float], None]
) -> Exposures:
    """The simplest frames of those that are as good as the best on the scene's sensor."""
    if _is_judged_on_sensor(scene):
        # Frames that are as good without an end differ by some decibels on a narrow sensor.
        found = sorted(found, key=lambda each: -each.level)[:_ON_SENSOR]
        found = [each.on_sensor(scene) for each in found]
    if scene.sensor.is_rolling and search.is_free:
        found += _by_rows(scene, found, search, progress)
    top = max(each.level for each in found)
    near = [each for each in found if each.level >= top - AS_GOOD]
    best = min(near, key=lambda each: each.order).sequence
    kind = ONE_PARABOLA if best.num_frames == 1 else kind_of(best)
    best = best.for_rows(scene.sensor.readout_time, scene.limits)
    if best.moves and scene.sensor.is_rolling:
        psnr, worst = _levels_by_rows(scene, best)
    else:
        psnr, worst = levels_of(scene, best.along)
    return replace(best, kind=kind, psnr=psnr, worst_psnr=worst).with_travel(scene.limits)


def loss_untold(scene: Scene, sequence: Exposures) -> tuple[float, float]:
    """A telephone's readout, s, and decibels that a decoder would lose which is not told it.

    It knows the speed, and takes all rows for exposed at once.
    """
    levels, readout = Levels.on_axis(scene), _OF_TELEPHONES
    if scene.burst is not None:
        readout = min(readout, 1 / float(scene.burst.frames_per_s))
    sensor = replace(scene.sensor, readout=readout)
    rows = rows_of(replace(scene, sensor=sensor), sequence, "loss_untold")
    middle = rows[len(rows) // 2][1]
    lost = sum(share * 10 ** (levels.lost_untold(middle, seen) / 10) for share, seen in rows)
    return readout, 10 * float(np.log10(lost))


def _levels_by_rows(scene: Scene, sequence: Exposures) -> tuple[float, float]:
    """As `levels_of`, in the mean over rows that are exposed one after another."""
    levels, path = Levels.on_axis(scene, literal=True), path_for_rows(scene, sequence)
    if path.jerks is None:
        errors = errors_by_rows(levels, path, scene.sensor.readout_time)
    else:
        rows = rows_of(scene, sequence, "best_moving_burst")
        errors = sum((share * levels.errors_at(each) for share, each in rows), np.zeros(()))
    return _mean_and_worst(levels, np.sum(errors, axis=0))


def levels_of(scene: Scene, frames: Sequence[TimedFrame]) -> tuple[float, float]:
    """The level of frames in the mean over the scene's speeds and at the worst of them; dB."""
    ends = [np.asarray(frame.motion.end_velocities, np.float64) for frame in frames]
    exposure = np.array([frame.exposure for frame in frames])
    levels, gained = Levels.on_axis(scene, literal=True), []
    for pieces in {each.size for each in ends}:
        alike = [k for k, each in enumerate(ends) if each.size == pieces]
        velocity, none = np.array([ends[k] for k in alike])[..., None], np.zeros((len(alike), 1))
        part = Frames(exposure[alike], velocity, exposure[alike[1:]], none, np.zeros(1))
        gained += [*levels.gained(part)]
    left = levels.left(np.sum(gained, axis=0))
    return _mean_and_worst(levels, np.sum(left, axis=0))


def _mean_and_worst(levels: Levels, by_speed: Float[np.ndarray, "l"]) -> tuple[float, float]:
    """The level of the errors at each speed in the mean, and at the worst of them; dB."""
    shares = np.sum(levels.weight, axis=0) / max(np.sum(levels.weight), np.finfo(float).tiny)
    worst = np.max(by_speed / np.maximum(shares, np.finfo(float).tiny))
    return psnr_of_error(float(np.sum(by_speed))), psnr_of_error(float(worst))


def sequence_of(frames: Frames, kind: str) -> Exposures:
    """Frames along one axis, with the motion and the time of each."""
    every, middles, pan = [], frames.middles.tolist(), float(frames.pan[0])
    for velocity, time, exposure, place in zip(
        frames.velocity[..., 0], middles, frames.exposure.tolist(), frames.place[:, 0], strict=True
    ):
        motion = _motion(velocity, exposure / 2)
        # The stage is where the sensor is, less the way of a camera that turns.
        begin = place_at_begin(motion) + pan * exposure / 2
        every.append(TimedFrame(motion, time, float(place) - begin + pan * time))
    if kind == SINE:
        # The stage goes on along it, not straight, between frames.
        turns = 2 * height_of_sine(every[0].motion, middles[1] - middles[0])
        pans = ((x, float(x.motion.velocity) * x.time) for x in every)
        every = [replace(x, position=way + k % 2 * turns) for k, (x, way) in enumerate(pans)]
    first = every[0].position
    moved = (TimedFrame(x.motion, x.time, x.position - first) for x in every)
    return Exposures(kind, tuple(moved), pan=pan)


def _motion(velocities: Float[np.ndarray, "k"], half: float) -> AbstractMotion:
    """The motion of an exposure by its velocities at the ends of equal pieces, px/s."""
    count = velocities.size - 1
    middle = float(np.interp(count / 2, np.arange(count + 1), velocities))
    gains = np.diff(velocities)
    if np.max(np.abs(gains)) <= 1e-9 * np.max(np.abs(velocities)):
        still = StillCamera(half_exposure=half)
        return LinearMotion(half_exposure=half, velocity=middle) if middle else still
    rates = gains * count / (4 * half)
    if count == 1 and rates[0] > 0:
        return ParabolicMotion(acceleration=float(rates[0]), half_exposure=half, velocity=middle)
    return FreeMotion(accelerations=rates, half_exposure=half, velocity=middle)
