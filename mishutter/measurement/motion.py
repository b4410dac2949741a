"""Objects of a clip: their velocities, where they are, and what stands still.

Connected pixels of a reference frame that one velocity explains are an object, whose velocity is
refined over more and more frames.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import ndimage

from mishutter.measurement.estimates import Estimate
from mishutter.model.sensor import Sensor
from mishutter.pictures.registration.search import (
    AROUND,
    EXPLAINED,
    SEPARATE,
    WINDOW,
    around,
    searched,
)
from mishutter.pictures.registration.sweep import ROBUST, UNCERTAIN, Region, Smoothed, Sweep
from mishutter.pictures.registration.windows import Window, means

MOST_FRAMES = 16
"""Frames about the middle of a clip in which motion is looked for."""
MOST_PIXELS = 1_200_000
"""Pixels of a frame above which it is averaged first."""
_LEAST_AREA = 500
"""Pixels of the least object."""
_STEP_ERROR = 0.05
"""Error of a step of an object from one frame to the next; px."""
_WIDE = 5
"""Half the width of an area without a velocity that is no object's edge; px."""
_BETTER = 0.9
"""Cost of a part along the velocity of a larger one, over that along its own, if it is of that."""
_REST = -1
"""Number of what stands still among parts."""


@dataclass(frozen=True, eq=False)
class MovingObject:
    """A part of the picture that moves as a whole."""

    velocity: tuple[float, float]  # Rows down and columns to the right a second; px/s
    error: tuple[float, float]  # Standard deviation of each; px/s
    centre: tuple[float, float]  # Row and column of its middle in the reference frame; px
    area: int  # Pixels in that frame
    lead: float  # Logarithm of the likelihood over that of the best other velocity, a tenth of it
    residual: float  # Residual over noise along the velocity
    frame: int  # Number of the reference frame, from 0
    # Frame from which to the next it goes so many times as far as usual; None if it moves evenly
    leap: tuple[int, int] | None = None

    @property
    def speed(self) -> Estimate:
        """Size of the velocity; px/s."""
        size = float(np.hypot(*self.velocity))
        share = np.array(self.velocity) / max(size, 1e-12)
        return Estimate(size, float(np.hypot(*(share * self.error))))


@dataclass(frozen=True, eq=False)
class Motion:
    """Motion of a clip."""

    objects: tuple[MovingObject, ...]  # Objects, the largest first
    # Number of the object that is seen in the reference frame, from 1 on; 0 at rest, -1 where no
    # velocity explains the frames; shape of a frame
    labels: Int[np.ndarray, "rows columns"]
    # Trust in the labels, from 0 to 1, as far as the best velocity explains the frames
    trust: Float[np.ndarray, "rows columns"]
    frame: int  # Number of the reference frame
    share_at_rest: float  # Share of the picture that stands still, over the reference frames
    share_unexplained: float  # Share that moves without a velocity
    # Mean length of runs of what moves, along rows and along columns; px
    width: tuple[float, float]
    num_frames: int  # Frames that were looked at
    words: tuple[str, ...] = ()  # Sentences on objects that do not move evenly


def time_of_a_row(sensor: Sensor | None, num_rows: int) -> float:
    """Time from the exposure of one row to that of the next below it, as a sensor is known; s."""
    ends = np.zeros(2) if sensor is None else sensor.row_delays(num_rows)[[0, -1]]
    return float(ends[1] - ends[0]) / max(num_rows - 1, 1)


def read_in_turn(motion: Motion, row: float) -> Motion:
    r"""The motion of a clip whose rows are exposed one after another, as all at once would show it.

    What goes down by $v$ while rows are read downwards, each $\tau$ later, is met $1/(1 - v\tau)$
    times as late: velocities and heights that are seen are as much larger. Slants are `motion_of`'s
    to take out.

    Args:
        motion: The motion that the clip shows.
        row: Time from one row to the next below it, below 0 where rows are read upwards; s.
    """
    objects = []
    for each in motion.objects:
        share = 1 / (1 + each.velocity[0] * row)
        down, right = (share * x for x in each.velocity)
        # An error downwards changes the share too.
        across = float(np.hypot(each.error[1], right * row * each.error[0]))
        error = share**2 * each.error[0], share * across
        objects.append(replace(each, velocity=(down, right), error=error))
    area = [float(each.area) for each in motion.objects]
    shares = [1 - each.velocity[0] * row for each in objects]
    along, height = motion.width
    width = along, height * float(np.average(shares, weights=area)) if objects else height
    return replace(motion, objects=tuple(objects), width=width)


def upright(
    labels: Int[np.ndarray, "rows columns"], ways: Sequence[float]
) -> Int[np.ndarray, "rows columns"]:
    """Labels of rows in turn without the slant of objects, which each have their middle row still.

    Args:
        labels: Numbers of objects, as the rows show them.
        ways: Way of each object to the right from one row to the next below it; px.
    """
    found, columns = np.minimum(labels, 0), labels.shape[1]
    for number, way in enumerate(ways, 1):
        down, right = np.nonzero(labels == number)
        if down.size:
            right = right - np.rint(way * (down - down.mean())).astype(int)
            is_seen = (right >= 0) & (right < columns)
            found[down[is_seen], right[is_seen]] = number
    return found


class _View(NamedTuple):
    """A reference frame with its labels and objects."""

    objects: list[MovingObject]
    labels: np.ndarray
    trust: np.ndarray

    def moving(self, row: float) -> Bool[np.ndarray, "rows columns"]:
        """Pixels that move, upright; specks, and parts without texture, end no run of them.

        Args:
            row: Time from one row to the next below it, over that from frame to frame.
        """
        ways = [x.velocity[1] * row / (1 + x.velocity[0] * row) for x in self.objects]
        return ndimage.gaussian_filter((upright(self.labels, ways) != 0).astype(float), 6.0) > 0.5


def motion_of(
    frames: Float[np.ndarray, "frames rows columns"], frames_per_s: float, row: float = 0.0
) -> Motion:
    """The motion of frames of unit noise, as they show it.

    The height of what moves is that of upright objects: where rows are exposed one after another, a
    slant would divide it.

    Args:
        frames: The frames.
        frames_per_s: Frames a second.
        row: Time from the exposure of one row to that of the next below it; s.
    """
    first = max(0, (len(frames) - MOST_FRAMES) // 2)
    frames = frames[first : first + MOST_FRAMES]
    size, scale = frames.shape[1:], 1
    while size[0] * size[1] / scale**2 > MOST_PIXELS:
        scale += 1
    if scale > 1:
        frames = scale * means(frames, scale, dtype=frames.dtype)
    count = len(frames)
    times = np.arange(count, dtype=np.float64)
    smooth = Smoothed.of(frames, times, 1.0), Smoothed.of(frames, times, 2.0)
    # Objects are looked for in the places of frames that are spread over the clip.
    parts = min(3, max(1, count // 5))
    references = [int((i + 0.5) * count / parts) for i in range(parts)]
    views = [_view(frames, smooth, reference) for reference in references]
    unit = scale * frames_per_s
    # Each object is listed once: as the best known of its appearances.
    objects: list[MovingObject] = []
    for each in sorted((o for view in views for o in view.objects), key=lambda o: sum(o.error)):
        if not any(_is_same(each, other) for other in objects):
            objects.append(each)
    objects.sort(key=lambda each: -each.area)
    middle = views[len(views) // 2]
    # The objects of the frame that is shown have the numbers of the list.
    numbers = [
        next(i for i, other in enumerate(objects, 1) if other is each or _is_same(each, other))
        for each in middle.objects
    ]
    labels = np.array([0, *numbers, -1])[middle.labels]
    enlarged = [_enlarged(each, scale, size) for each in (labels, middle.trust)]
    masks = [view.moving(scale * frames_per_s * row) for view in views]
    return Motion(
        objects=tuple(_in_seconds(each, unit, scale, first) for each in objects),
        labels=enlarged[0],
        trust=enlarged[1],
        frame=first + references[len(views) // 2],
        share_at_rest=float(np.mean([np.mean(view.labels == 0) for view in views])),
        share_unexplained=float(np.mean([np.mean(view.labels < 0) for view in views])),
        width=(scale * _run(masks, 1), scale * _run(masks, 0)),
        num_frames=count,
        words=tuple(_words(objects, first)),
    )


def _words(objects: Sequence[MovingObject], first: int) -> list[str]:
    """Sentences on steps of objects that tell of a frame that was lost."""
    leaps: dict[tuple[int, int], list[str]] = {}
    for number, each in enumerate(objects, 1):
        if each.leap is not None:
            leaps.setdefault(each.leap, []).append(str(number))
    return [
        f"object {' and '.join(numbers)} goes {several} times as far as usual from frame "
        f"{first + frame + 1} to the next: frames seem to be lost there, and are counted"
        for (frame, several), numbers in leaps.items()
    ]


def _view(frames: np.ndarray, smooth: tuple[Smoothed, Smoothed], reference: int) -> _View:
    """The objects: connected pixels of one velocity, each with a velocity of its own."""
    found = searched(frames, smooth, reference, _LEAST_AREA)
    labels = np.zeros(found.labels.shape, int)
    seen: list[tuple[MovingObject, Bool[np.ndarray, "rows columns"]]] = []
    for number, velocity in enumerate(found.velocities[1:], 1):
        parts = np.empty(labels.shape, np.int32)
        ndimage.label(ndimage.binary_opening(found.labels == number, iterations=2), output=parts)
        for part in range(1, int(parts.max()) + 1):
            mask = np.asarray(ndimage.binary_fill_holes(parts == part))
            if mask.sum() < _LEAST_AREA:
                continue
            each, mask = _object(smooth[0], reference, velocity, mask, found.sweeps)
            is_told_from_rest = np.any(np.abs(each.velocity) > 2 * np.array(each.error))
            if each.lead > 0 and is_told_from_rest:  # otherwise noise has made it up, or it rests
                seen.append((each, mask))
    owners = _owners(smooth[0], reference, seen)
    own = sorted(set(owners) - {_REST})
    objects = [seen[n][0] for n in own]
    for (_, mask), owner in zip(seen, owners, strict=True):
        if owner != _REST:
            labels[mask & (labels == 0)] = own.index(owner) + 1
    near = np.asarray(ndimage.binary_dilation(labels > 0, iterations=_WIDE))
    unexplained = (found.least > EXPLAINED) & (near == 0)
    is_wide = np.asarray(ndimage.binary_opening(unexplained, iterations=_WIDE), bool)
    labels[is_wide] = -1
    return _View(objects, labels, 1 / (1 + np.maximum(found.least - 1, 0) ** 4))


def _owners(
    fine: Smoothed,
    reference: int,
    seen: Sequence[tuple[MovingObject, Bool[np.ndarray, "rows columns"]]],
) -> list[int]:
    """Number of the part with whose velocity each part goes: its own, a larger one, or rest.

    A strip along an edge, which others hide in some frames, may end its search far from both.
    """
    near = around(len(fine.coefficients), reference, 1)
    velocities = {n: np.array(each.velocity) for n, (each, _) in enumerate(seen)}
    owners, larger = list(range(len(seen))), {_REST: np.zeros(2)}
    for number in sorted(owners, key=lambda n: -seen[n][0].area):
        region = Region(fine, reference, near, _inner(seen[number][1]))
        costs = {n: region.cost(velocity) for n, velocity in larger.items()}
        best = min(costs, key=costs.__getitem__)
        if costs[best] < _BETTER * region.cost(velocities[number]):
            owners[number] = best
        else:
            larger[number] = velocities[number]
    return owners


def _inner(mask: Bool[np.ndarray, "rows columns"]) -> Bool[np.ndarray, "rows columns"]:
    """The inner part of an object, at whose edge another's light may be seen."""
    inner = np.asarray(ndimage.binary_erosion(mask, iterations=4), bool)
    return inner if inner.sum() >= _LEAST_AREA // 2 else mask


def _object(
    fine: Smoothed, reference: int, velocity: np.ndarray, mask: np.ndarray, sweeps: list[Sweep]
) -> tuple[MovingObject, Bool[np.ndarray, "rows columns"]]:
    """An object, its velocity refined over more and more frames, and its own pixels."""
    count = len(fine.coefficients)
    inner = _inner(mask)
    farthest = max(reference, count - 1 - reference)
    reach, used, residual, covariance = 1, 1, np.inf, np.eye(2)
    while True:
        reach = min(2 * reach, farthest)
        numbers = range(max(0, reference - reach), min(count, reference + reach + 1))
        region = Region(fine, reference, numbers, inner)
        other = region.descended(velocity, 0.25 / reach, 0.03 / reach)
        other, spread, left = region.polished(other)
        # An object that turns, or goes behind another, is measured while it does not.
        if residual < np.inf and left > EXPLAINED * max(residual, 1.0):
            break
        velocity, covariance, residual, used = other, spread, left, reach
        if reach >= farthest:
            break
    # Where noise explains all that is seen, frames tell no more than was assumed.
    is_told = used * np.sqrt(np.linalg.eigvalsh(covariance)[-1]) < UNCERTAIN / 2
    # Splines and exposures leave an error of a shift, in px.
    error = np.sqrt(np.diag(covariance) + (0.05 / used) ** 2)
    # A clip without one of its frames shows every other step right.
    times, places = _track(fine, reference, velocity, inner)
    leap = _leap(times, places, velocity)
    if leap is not None:
        later = np.where(times > leap[0], leap[1] - 1, 0)
        velocity = np.polyfit(times + later, places, 1)[0]
    else:  # until it turns, or is hidden
        numbers = range(max(0, reference - used), min(count, reference + used + 1))
        own = _unlike_rest(fine, reference, velocity, mask, numbers)
        mask = own if own.sum() >= _LEAST_AREA // 2 else mask
    rows, columns = np.nonzero(mask)
    each = MovingObject(
        velocity=(float(velocity[0]), float(velocity[1])),
        error=(float(error[0]), float(error[1])),
        centre=(float(rows.mean()), float(columns.mean())),
        area=int(mask.sum()),
        lead=max(_lead(sweep, velocity, mask) for sweep in sweeps) if is_told else 0.0,
        residual=residual,
        frame=reference,
        leap=leap,
    )
    return each, mask


def _unlike_rest(
    fine: Smoothed, reference: int, velocity: np.ndarray, mask: np.ndarray, numbers: Sequence[int]
) -> Bool[np.ndarray, "rows columns"]:
    """The pixels of a mask that differ, on their way, from what stands still behind them.

    Beside an object, what is dark and flat seems to move as well: its own pixels pass before more.
    """
    rows, columns = mask.shape
    frames, _ = fine.along(np.zeros(2), reference, numbers, Window.whole((rows, columns)))
    pixels = np.argwhere(mask)
    ways = [np.rint(velocity * (k - reference)).astype(int) for k in numbers]
    insides = [np.all((pixels + w >= 0) & (pixels + w < mask.shape), axis=1) for w in ways]
    covered = np.zeros(frames.shape, bool)
    for cover, way, inside in zip(covered, ways, insides, strict=True):
        cover[tuple((pixels + way)[inside].T)] = True
    times_seen = np.sum(~covered, axis=0)
    behind = np.sum(frames, axis=0, where=~covered) / np.maximum(times_seen, 1)
    unlike = np.minimum((frames - behind) ** 2 / fine.variance, ROBUST)
    total, count = np.zeros(len(pixels)), np.zeros(len(pixels))
    for each, way, inside in zip(unlike, ways, insides, strict=True):
        at = tuple((pixels + way)[inside].T)
        is_known = times_seen[at] > 0
        total[inside] += np.where(is_known, each[at], 0)
        count[inside] += is_known
    mean = np.zeros(mask.shape)
    mean[mask] = np.where(count > 0, total / np.maximum(count, 1), ROBUST)
    # Both Gaussians, the frames' own and this one, blur the edge: the outline is half-way up it,
    # and above the noise.
    height = max(float(np.median(mean[mask])), 4.0)
    own = mask & (ndimage.gaussian_filter(mean, 1.0) > height / 2)
    return np.asarray(ndimage.binary_fill_holes(own), bool)


def _track(
    fine: Smoothed, reference: int, velocity: np.ndarray, mask: np.ndarray
) -> tuple[Int[np.ndarray, "frames"], Float[np.ndarray, "frames 2"]]:
    """Numbers of frames in which an object is seen, and its way since the reference; px."""
    places = {reference: np.zeros(2)}
    for way in (-1, 1):
        place, number = np.zeros(2), reference + way
        while 0 <= number < len(fine.coefficients):
            time = number - reference
            region = Region(fine, reference, sorted((reference, number)), mask)
            # The next place, or the one after it.
            starts = [(place + n * way * velocity) / time for n in (1, 2)]
            start = min(starts, key=region.cost)
            each = region.descended(start, 0.5 / abs(time), 0.05 / abs(time))
            each, _, residual = region.polished(each)
            if residual > EXPLAINED:
                break
            place = each * time
            places[number] = place
            number += way
    times = np.array(sorted(places))
    return times, np.array([places[number] for number in times])


def _leap(times: np.ndarray, places: np.ndarray, velocity: np.ndarray) -> tuple[int, int] | None:
    """The frame after which an object goes several times its usual step, and how many times."""
    if len(times) < 4:
        return None
    steps = np.diff(places, axis=0) @ velocity / max(float(np.hypot(*velocity)), 1e-12)
    usual = float(np.median(steps))
    worst = int(np.argmax(steps))
    several = round(float(steps[worst] / max(usual, 1e-9)))
    others = np.delete(steps, worst)
    spread = 1.4826 * float(np.median(np.abs(others - usual))) + _STEP_ERROR
    is_whole = abs(steps[worst] - several * usual) < 0.3 * usual
    is_leap = several >= 2 and is_whole and steps[worst] - usual > 5 * spread
    return (int(times[worst]), several) if is_leap else None


def _lead(sweep: Sweep, velocity: np.ndarray, mask: np.ndarray) -> float:
    """Lead of a velocity over those farther away, by the tiles about the middle of an object."""
    rows, columns = np.nonzero(mask)
    down, across = sweep.logarithms.shape[1:]
    middle = rows.mean(), columns.mean()
    i, j = (
        int(np.clip(round(2 * at / sweep.side - 1), 0, most - 1))
        for at, most in zip(middle, (down, across), strict=True)
    )
    logarithms = sweep.logarithms[:, i, j]
    near = sweep.near(velocity, 1.6)
    if not near.any() or near.all():
        return 0.0
    gap = logarithms[~near].min() - logarithms[near].min()
    pixels = (sweep.side // 4) ** 2
    return float(0.1 * gap * pixels * (WINDOW - 1) / 2) if np.isfinite(gap) else 0.0


def _is_same(one: MovingObject, other: MovingObject) -> bool:
    """Whether two appearances have one velocity, and places that it joins."""
    v, w = np.array(one.velocity), np.array(other.velocity)
    apart = np.hypot(*(v - w)) * AROUND
    time = other.frame - one.frame
    way = np.array(one.centre) + v * time - np.array(other.centre)
    size = np.sqrt(max(one.area, other.area))
    return time != 0 and bool(apart < 2 * SEPARATE and np.hypot(*way) < size)


def _in_seconds(each: MovingObject, unit: float, scale: int, first: int) -> MovingObject:
    return replace(
        each,
        velocity=(each.velocity[0] * unit, each.velocity[1] * unit),
        error=(each.error[0] * unit, each.error[1] * unit),
        centre=(each.centre[0] * scale, each.centre[1] * scale),
        area=each.area * scale**2,
        frame=each.frame + first,
    )


def _enlarged(picture: np.ndarray, scale: int, size: tuple[int, int]) -> np.ndarray:
    """A picture in the size of the frames; edges that were left out go on."""
    large = picture.repeat(scale, axis=0).repeat(scale, axis=1)
    pads = [(0, full - have) for full, have in zip(size, large.shape, strict=True)]
    return np.pad(large, pads, mode="edge")


def _run(masks: Sequence[Bool[np.ndarray, "rows columns"]], axis: int) -> float:
    """Mean length of runs along an axis; 0 without any."""
    pixels = sum(int(mask.sum()) for mask in masks)
    begins = 0
    for mask in masks:
        rows = mask if axis == 1 else mask.T
        begins += int(rows[:, 0].sum() + np.sum(rows[:, 1:] & ~rows[:, :-1]))
    return pixels / begins if begins else 0.0
