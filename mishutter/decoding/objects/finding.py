"""The things of frames: velocities, outlines and order, in turn."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy import ndimage

from mishutter.decoding.objects.arrangement import Arrangement, Thing
from mishutter.decoding.objects.candidates import candidates, within
from mishutter.decoding.objects.grids import Mask, moved
from mishutter.decoding.objects.light import Knowledge
from mishutter.decoding.objects.mattes import settle
from mishutter.decoding.objects.outlines import Along, cut_out, mean_lights, sharpen
from mishutter.decoding.objects.stills import Stills
from mishutter.decoding.objects.velocities import refine_velocity

_ROUNDS, _SHARPENINGS = 4, 3
_LEAST_EVIDENCE = 150.0
"""Logarithm of the likelihood of a thing over none below which there is none."""
_LEAST_AREA = 200
"""Pixels of the least thing."""
_GUESSED = 0.6
"""Error of a velocity over that of the first guess from which on frames tell nothing of it."""
_SEPARATE = 1.5
"""Way between two velocities over the frames within which they are one; px."""
_BLURRED = 6.0
"""Way within an exposure above which an outline is mixed over more pixels than those by which a
velocity is refined unless light is freed of its blur; px."""
_BRIDGE = 3
"""Pixels from an outline within which parts of a thing may hang together by chance."""
_APART = 5.0
"""Standard errors by which the velocities of two parts of a thing have to differ."""


class Told(NamedTuple):
    """Things that are partly known beforehand."""

    velocities: Float[np.ndarray, "n 2"] | None = None  # Down and across; px/s
    # Number of the thing that a pixel shows at the time 0, from 1; 0 for the background
    labels: Int[np.ndarray, "rows columns"] | None = None


def found_in(
    stills: Stills,
    told: Told | None = None,
    progress: Callable[[str, float], None] | None = None,
    known: Knowledge | None = None,
) -> Arrangement:
    """The things of frames, which are looked for in those of about one exposure.

    Args:
        stills: The frames.
        told: What is known of the things: their velocities, or their outlines.
        progress: Called with a sentence and the share done.
        known: The statistics of pictures, by which outlines are solved in the end, in all frames.
    """
    told = Told() if told is None else told
    report = (lambda text, share: None) if progress is None else progress
    report("looking for things that move", 0.0)
    alike = stills.only(stills.alike)
    if told.labels is not None:
        return _of_known_outlines(alike, told.labels, told.velocities).seen_in(stills)
    arrangement, is_told = candidates(alike, told.velocities), told.velocities is not None
    for turn in range(_ROUNDS):
        report("velocities and outlines", 0.3 + 0.12 * turn)
        if not is_told:
            _refine_parts(arrangement, is_first=not turn)
        _merge(arrangement)
        put_in_order(arrangement)
        cut_out(arrangement)
        if turn:
            _drop_weakest(arrangement)
        arrangement.place()
        _drop_empty(arrangement)
    for half in range(2):
        report("outlines from pixels that show two things", 0.75 + 0.1 * half)
        _sharpen(arrangement)
    if not is_told:
        _refine_velocities(arrangement)
    report("outlines by the light of the layers", 0.95)
    arrangement = arrangement.seen_in(stills)
    are_told = is_told or (alike.count == stills.count and not _is_blurred(arrangement))
    if known is not None and not are_told:
        settle(arrangement, known, are_told=False)
    if not is_told:
        _drop_untold(arrangement)
    if known is not None and are_told:
        settle(arrangement, known)
    return arrangement


def _is_blurred(arrangement: Arrangement) -> bool:
    """Whether exposures mix a thing with what is behind it far beyond its outline."""
    longest = float(np.max(arrangement.stills.exposures))
    ways = [float(np.hypot(*thing.velocity)) * longest for thing in arrangement.things]
    return max(ways, default=0.0) > _BLURRED


def _refine_parts(arrangement: Arrangement, *, is_first: bool) -> None:
    """Refines the velocities of things, of parts that lie apart one by one."""
    if not is_first:
        _split(arrangement)
        arrangement.place()
    lights = None if is_first else mean_lights(arrangement)
    for number, thing in enumerate(arrangement.things):
        if thing.area > 0:
            refine_velocity(arrangement, number, lights)


def _sharpen(arrangement: Arrangement) -> None:
    """Draws outlines by all that is known by now, and solves them near there."""
    cut_out(arrangement, at_edges=True)
    arrangement.place()
    _drop_empty(arrangement)
    drawn = [thing.matte for thing in arrangement.things]
    for _ in range(_SHARPENINGS):
        sharpen(arrangement, drawn)
        arrangement.place()
        drawn = _drop_empty(arrangement, drawn)


def _drop_empty(arrangement: Arrangement, drawn: Sequence[Mask] = ()) -> list[Mask]:
    """Leaves out things whose outline is drawn nowhere, and returns the masks of the others."""
    kept = list(drawn)
    for number in range(len(arrangement.things) - 1, -1, -1):
        if arrangement.things[number].area < 1:
            arrangement.drop(number)
            del kept[number : number + 1]
    return kept


def _drop_weakest(arrangement: Arrangement) -> None:
    """Leaves out the thing of least evidence among those that have too little."""
    things = arrangement.things
    weak = [
        number
        for number, thing in enumerate(things)
        if thing.evidence < _LEAST_EVIDENCE or thing.area < _LEAST_AREA
    ]
    if weak:
        arrangement.drop(min(weak, key=lambda number: things[number].evidence))


def _drop_untold(arrangement: Arrangement) -> None:
    """Leaves out the things of which frames tell nothing."""
    for number in range(len(arrangement.things) - 1, -1, -1):
        if _tells_nothing(arrangement.things[number]):
            arrangement.drop(number)


def _tells_nothing(thing: Thing) -> bool:
    """Whether a sliver is left, or one whose velocity is that of the first guess alone."""
    own = np.linalg.eigvalsh(thing.covariance)
    own = own[own > 0]  # along the axes on which things move
    is_guessed = bool(np.min(own, initial=np.inf) > (_GUESSED * thing.uncertainty) ** 2)
    return thing.area < _LEAST_AREA or thing.evidence < _LEAST_EVIDENCE or is_guessed


def _of_known_outlines(
    stills: Stills,
    labels: Int[np.ndarray, "rows columns"],
    velocities: Float[np.ndarray, "n 2"] | None,
) -> Arrangement:
    """Things of known outlines, their order, and their velocities if these are not known."""
    arrangement = within(stills, labels, velocities)
    for _ in range(2):
        put_in_order(arrangement)
        if velocities is None:
            _refine_velocities(arrangement)
    return arrangement


def _refine_velocities(arrangement: Arrangement) -> None:
    """Refines all velocities by the same light of the layers."""
    lights = mean_lights(arrangement)
    for number in range(len(arrangement.things)):
        refine_velocity(arrangement, number, lights)
    arrangement.place()


def put_in_order(arrangement: Arrangement) -> None:
    """Puts the thing in front whose light, as seen elsewhere, is seen where two overlap."""
    stills = arrangement.stills
    for i in range(len(arrangement.things)):
        for j in range(i + 1, len(arrangement.things)):
            over = (arrangement.cover[i] > 0.5) & (arrangement.cover[j] > 0.5)
            if over.sum() <= 10:
                continue
            first, second = (_shown(stills, arrangement.things[n], over) for n in (i, j))
            both = first[1] & second[1]
            lead = float(np.sum((second[0] - first[0])[both]))
            order = arrangement.order
            a, b = order.index(i), order.index(j)
            if both.sum() > 10 and abs(lead) > 20 and (lead > 0) != (a < b):
                order[a], order[b] = j, i
    arrangement.place()


def _shown(stills: Stills, thing: Thing, over: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Squares over the noise that the frames have by a thing's light, and where it is known."""
    ways, window = stills.ways(thing.velocity), thing.window
    along = Along.of(stills, window, thing.velocity)
    clear = along.seen * (along.shares(over.astype(np.float32), ways) <= 0.1)
    weighed = stills.weights[:, None, None] * clear
    worth = np.maximum(np.sum(weighed, axis=0), 1e-9)
    light = np.asarray(np.einsum("klm,klm->lm", weighed, along.frames) / worth)
    have = np.max(clear, axis=0).astype(np.float32)
    squares, known = np.zeros(over.shape, np.float32), np.zeros(over.shape, bool)
    for k, way in enumerate(ways):
        shown = moved(light, window, way, stills.shape)
        noise = 1.3 * stills.noise(shown, k)
        squares[k] = np.minimum((stills.light[k] - shown) ** 2 / noise, 12)
        known[k] = (moved(have, window, way, stills.shape) > 0.99) & over[k]
    return squares, known


def _split(arrangement: Arrangement) -> None:
    """Tells things apart that were found as one, as they lie apart and move nearly alike."""
    for number, thing in enumerate(list(arrangement.things)):
        inner = ndimage.binary_erosion(thing.matte > 0.5, iterations=_BRIDGE)
        cores = np.empty(inner.shape, np.int32)
        ndimage.label(inner, output=cores)
        large = 1 + np.flatnonzero(np.bincount(cores.ravel())[1:] > _LEAST_AREA)
        if len(large) < 2:
            continue
        away = [np.asarray(ndimage.distance_transform_edt(cores != one)) for one in large]
        nearest = np.argmin(away, axis=0)
        parts = [
            _alone(arrangement, number, thing.matte * (nearest == k)) for k in range(len(large))
        ]
        parts.sort(key=lambda part: -part.area)
        for part in parts[1:]:
            off, variance = part.velocity - parts[0].velocity, part.covariance + parts[0].covariance
            is_apart = off @ np.linalg.pinv(variance) @ off > _APART**2
            if is_apart and np.hypot(*off) * arrangement.stills.span > _SEPARATE:
                place = arrangement.order.index(number)
                arrangement.order.insert(place, len(arrangement.things))
                arrangement.things.append(part)
                thing.matte = np.where(part.matte > 0, np.float32(0), thing.matte)


def _alone(arrangement: Arrangement, number: int, matte: Mask) -> Thing:
    """A part of a thing, at the velocity that it has of its own."""
    things = list(arrangement.things)
    things[number] = replace(things[number], matte=matte)
    one = Arrangement(arrangement.stills, things, list(arrangement.order))
    refine_velocity(one, number, None)
    return things[number]


def _merge(arrangement: Arrangement) -> None:
    """Leaves out things of another's velocity, or of rest, whose pixels are then that one's."""
    for number in range(len(arrangement.things) - 1, -1, -1):
        thing = arrangement.things[number]
        span = arrangement.stills.span
        others = [other.velocity for other in arrangement.things[:number]]
        near = [
            k
            for k, velocity in enumerate([np.zeros(2), *others])
            if np.hypot(*(thing.velocity - velocity)) * span < _SEPARATE
        ]
        if near or thing.area < 1:
            if near and near[0]:
                other = arrangement.things[near[0] - 1]
                other.matte = np.maximum(other.matte, thing.matte)
            arrangement.drop(number)
