"""Frames of several things before a background, restored object by object."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from mishutter._core.checks import Unquoted, require
from mishutter.camera.layers import Layer, Layers
from mishutter.camera.responses import aperture_on
from mishutter.decoding.decoders.base import AbstractDecoder
from mishutter.decoding.decoders.linear import EnsembleDecoder
from mishutter.decoding.decoders.plug_and_play import PlugAndPlayDecoder
from mishutter.decoding.decoders.speed import luminance_shares
from mishutter.decoding.decoders.total_variation import TotalVariationDecoder
from mishutter.decoding.likeliest import electrons_of
from mishutter.decoding.objects.arrangement import Arrangement, Thing
from mishutter.decoding.objects.composite import (
    Alone,
    composite,
    labels_of,
    trusted,
    whole_of,
)
from mishutter.decoding.objects.finding import Told, found_in
from mishutter.decoding.objects.light import Knowledge, Misfit, Sight, light_of
from mishutter.decoding.objects.readout import Readout
from mishutter.decoding.objects.stills import Stills
from mishutter.decoding.rolling import RowTimes
from mishutter.evaluation.fans import picture_power_on
from mishutter.evaluation.instants import Instants
from mishutter.model.frame_path import AT_REST, PlaneFrames, TimedFrame
from mishutter.model.scene import Scene
from mishutter.pictures.images import Axis, Picture, transposed
from mishutter.pictures.registration.windows import Window

Progress = Callable[[str, float], None]

_LEAST_SHARE = 0.5
"""Share of an object's pixels, away from its outline, that have to be trusted."""
_WIDEST = 1.0
"""Standard error of an object's way over the frames above which it is not trusted; px."""
_PART = 1.5
"""Way of a layer over a part of an exposure; px."""


class FoundObject(NamedTuple):
    """A thing that was found before a background.

    Attributes:
        velocity: Its velocity along rows and columns, to the left and up; px/s, shape `(2,)`.
        covariance: Covariance of that; (px/s)^2, shape `(2, 2)`. 0 where the velocity was told.
        speed: Its speed along the axis of the scene, of either sign, or the size of its velocity in
            a scene of the plane; px/s.
        area: Pixels that it covers at the middle of the frames.
        place: Row and column of the middle of these.
        trusted: Whether the frames agree on it, and tell its velocity.
        doubt: A sentence that says why it is not trusted; empty if it is.
    """

    velocity: Float[np.ndarray, "2"]
    covariance: Float[np.ndarray, "2 2"]
    speed: float
    area: float
    place: tuple[float, float]
    trusted: bool
    doubt: str

    @property
    def error(self) -> float:
        """Standard error of the velocity in the direction in which it is greatest; px/s."""
        return float(np.sqrt(max(float(np.linalg.eigvalsh(self.covariance)[-1]), 0.0)))


class RestoredObjects(NamedTuple):
    """A picture of several things before a background, and what it was put together from."""

    light: Float[np.ndarray, "rows columns colours"]  # At the middle of the frames, white = 1
    objects: tuple[FoundObject, ...]  # From the largest to the smallest
    # Number of the object that a pixel shows, from 1; 0 for the background
    labels: Int[np.ndarray, "rows columns"]
    trust: Bool[np.ndarray, "rows columns"]  # Whether the frames agree on a pixel
    layers: Layers  # The background, and the objects from the back to the front


class Known(NamedTuple):
    """Objects that a user knows of."""

    # Of each, px/s: along the axis of the scene, or along rows and columns
    speeds: Sequence[float] | Sequence[Sequence[float]] | None = None
    # Number of the object that a pixel shows at the middle, from 1; 0 for the background
    outlines: Int[np.ndarray, "rows columns"] | None = None


def is_at_rest(frames: Sequence[TimedFrame] | PlaneFrames) -> bool:
    """Whether the sensor stands still from the first frame to the last."""
    if isinstance(frames, PlaneFrames):
        times = np.asarray(frames.times)
        places = np.asarray(frames.place(np.linspace(times[0], times[-1], 65)))
        return float(np.max(np.ptp(places, axis=1))) < AT_REST
    places = [float(frame.position) for frame in frames]
    return all(frame.is_still for frame in frames) and float(np.ptp(places)) < AT_REST


def restored_objects(
    planes: Float[np.ndarray, "colours frames rows columns"],
    scene: Scene,
    frames: Sequence[TimedFrame] | PlaneFrames,
    decoder: AbstractDecoder,
    known: Known,
    *,
    report: Progress,
) -> RestoredObjects:
    """The picture at the middle of frames, object by object.

    The planes of a scene along one axis are turned so that things move along their rows. Things are
    found in the frames of a sensor at rest among them, and restored from all.
    """
    subject, in_plane = "restore_frames(frames=...)", isinstance(frames, PlaneFrames)
    axis: Axis = "rows" if in_plane else scene.sensor.axis
    times = RowTimes.of(scene.sensor, planes.shape, in_plane=in_plane)
    words = "be of a sensor at rest where rows are exposed one after another before a background"
    is_seen = is_at_rest(frames) or not times.is_rolling
    require(is_seen, subject, words, Unquoted("frames of one that moves"))
    require(planes.shape[1] > 1, subject, "be two at least to tell objects", planes.shape[1])
    is_known = isinstance(decoder, EnsembleDecoder | TotalVariationDecoder | PlugAndPlayDecoder)
    words = "be EnsembleDecoder, TotalVariationDecoder or PlugAndPlayDecoder for objects"
    require(is_known, "restore_frames(decoder=...)", words, type(decoder).__name__)
    readout = Readout.of(times, axis)
    grey, alone = stills_of(planes, scene, frames, readout)
    told = _told(known, axis, readout, in_plane=in_plane, shape=grey.shape)
    if told.labels is None or told.velocities is None:
        words = "be of a sensor at rest twice, or `speed` and `outlines` be given, to find objects"
        require(int(grey.rests.sum()) > 1, subject, words, Unquoted(f"{grey.rests.sum()} at rest"))
    known_of = knowledge_of(scene, grey, in_plane=in_plane)
    found = found_in(grey, told, lambda text, share: report(text, 0.6 * share), known_of)
    light, composites = [], []
    for number, stills in enumerate(alone):
        report("light of the layers", 0.6 + 0.4 * number / len(alone))
        known_of = knowledge_of(scene, stills, in_plane=in_plane)
        misfit = Misfit.of(Sight.of(stills, found, known_of))
        layers = light_of(misfit, decoder)
        alone_of = Alone.of(stills, known_of, decoder)
        composites.append(composite(found, misfit, layers, alone_of))
        pairs = zip(misfit.sight.sheets, layers, strict=True)
        light.append([whole_of(sheet.window, own, stills.shape) for sheet, own in pairs])
    whole = composites[0]._replace(
        misfit=np.mean([one.misfit for one in composites], axis=0),
        alone=np.max([one.alone for one in composites], axis=0),
    )
    report("done", 1.0)
    pictures, labels, trust = (x.light for x in composites), labels_of(found), trusted(found, whole)
    whole = _Whole(found, light, np.stack([*pictures], axis=-1), labels, trust)
    if readout.line:
        whole = _set_right(whole, readout, [one.lights for one in composites])
    return _result(whole, axis, in_plane=in_plane)


class _Whole(NamedTuple):
    """A picture of things, and the maps of them."""

    found: Arrangement
    light: list[list[np.ndarray]]  # Of each layer, in each colour
    picture: Float[np.ndarray, "rows columns colours"]
    labels: Int[np.ndarray, "rows columns"]
    trust: Bool[np.ndarray, "rows columns"]


def _set_right(whole: _Whole, readout: Readout, shown: list[list[np.ndarray]]) -> _Whole:
    """The picture as it is at one time, by that of rows that are exposed one after another.

    Args:
        whole: The picture as those rows show it.
        readout: The times of the rows.
        shown: Light of the layers in it, in each colour.
    """
    found, seen = whole.found, [np.zeros(2), *(thing.velocity for thing in whole.found.things)]

    def upright(layers: list[np.ndarray], order: int) -> list[np.ndarray]:
        pairs = zip(layers, seen, strict=True)
        return [readout.set_right(layer, velocity, order) for layer, velocity in pairs]

    mattes = upright([whole.light[0][0], *(thing.matte for thing in found.things)], 1)[1:]
    things = [
        replace(
            thing,
            matte=matte,
            velocity=readout.true(thing.velocity),
            covariance=readout.covariance(thing.velocity, thing.covariance),
        )
        for thing, matte in zip(found.things, mattes, strict=True)
    ]
    right = Arrangement(found.stills, things, found.order)
    labels, alphas, colours = labels_of(right), right.alphas(), [upright(x, 3) for x in shown]
    picture = np.stack([sum(a * x for a, x in zip(alphas, y, strict=True)) for y in colours], -1)
    each = ((whole.trust & (whole.labels == number)) for number in range(len(seen)))
    own = [one.astype(np.float32) for one in each]
    trust = np.take_along_axis(np.stack(upright(own, 0)), labels[None], axis=0)[0] > 0.5
    return _Whole(right, [upright(x, 3) for x in whole.light], picture, labels, trust)


def stills_of(
    planes: np.ndarray,
    scene: Scene,
    frames: Sequence[TimedFrame] | PlaneFrames,
    readout: Readout,
) -> tuple[Stills, list[Stills]]:
    """The luminance of frames, and their colours."""
    if isinstance(frames, PlaneFrames):
        exposures, times = (np.asarray(x, np.float64) for x in (frames.exposures, frames.times))
        moves = (True, True)
        times = times - (times[0] - exposures[0] / 2 + times[-1] + exposures[-1] / 2) / 2
    else:
        exposures, times = np.array([[one.exposure, one.time] for one in frames]).T
        moves = (False, True)
    electrons = electrons_of(scene, exposures)
    shares = luminance_shares(len(planes))
    square, read = float(shares @ shares), float(scene.read_noise)
    fastest = float(scene.max_speed)
    instants = None if is_at_rest(frames) else _instants_of(frames, fastest)
    if moves[readout.axis]:
        share = fastest * abs(readout.line)
        words = "be of less than half a row in the time from row to row"
        require(share < 0.5, "restore_frames(scene=...)", words, Unquoted(f"{share:.2g}"))
        fastest = fastest / (1 - share)
    alone = [
        Stills(one.astype(np.float32), times, exposures, electrons, read, fastest, moves, instants)
        for one in planes
    ]
    # Noise of the mean of colours is that of one of as many more electrons.
    grey = replace(
        alone[0],
        light=np.tensordot(shares, planes, 1).astype(np.float32),
        electrons=electrons / square,
        read_noise=read / np.sqrt(square),
    )
    return grey, alone


def _instants_of(frames: Sequence[TimedFrame] | PlaneFrames, fastest: float) -> Instants:
    """Places of a sensor that moves, in panels in which no layer moves by much."""
    instants = Instants.of(frames, fastest)
    ways = instants.ways(np.zeros(len(instants.place)))
    longest = float(np.max(ways + fastest * instants.exposure))
    instants = Instants.of(frames, fastest, num_panels=math.ceil(longest / _PART))
    across, down = instants.place if len(instants.place) > 1 else (*instants.place, 0.0)
    place = np.stack(np.broadcast_arrays(down, across))
    return instants._replace(place=place)


def knowledge_of(scene: Scene, stills: Stills, *, in_plane: bool) -> Knowledge:
    """The power of pictures, of as much contrast as the frames have, and the pixel's response."""
    frame = stills.light[stills.middle]
    noise = float(stills.noise(np.float32(frame.mean()), stills.middle))
    variance = max(float(np.var(frame)) - noise, 0.01 * noise)
    scale = variance / float(scene.picture.deviation) ** 2

    def power(size: tuple[int, int]) -> np.ndarray:
        down, across = np.fft.fftfreq(size[0]), np.fft.rfftfreq(size[1])
        return np.maximum(scale * picture_power_on(scene, down, across), 1e-12)

    def aperture(size: tuple[int, int]) -> np.ndarray:
        if in_plane:
            return aperture_on(scene.optics, size)
        along = np.sinc(np.fft.rfftfreq(size[1])) * np.asarray(scene.optics.response(size[1]))
        return np.broadcast_to(along, (size[0], along.size))

    return Knowledge(power, aperture)


def _told(
    known: Known, axis: Axis, readout: Readout, *, in_plane: bool, shape: tuple[int, int]
) -> Told:
    """The known objects, in the order down and across, and turned as the frames are."""
    labels = velocities = None
    if known.outlines is not None:
        labels = np.asarray(transposed(np.asarray(known.outlines, int), axis))
        words = f"be a picture of {shape[0]} x {shape[1]} px, as the frames are"
        require(labels.shape == shape, "restore_frames(outlines=...)", words, labels.shape)
    if known.speeds is not None:
        speeds = -np.atleast_1d(np.asarray(known.speeds, np.float64))
        speeds = np.atleast_2d(speeds) if in_plane else speeds.reshape(-1, 1)
        words = "be a velocity along rows and columns of each object" if in_plane else "be a row"
        fits = speeds.shape[1:] == ((2,) if in_plane else (1,))
        require(fits, "restore_frames(speed=...)", words, known.speeds)
        if labels is not None:
            count, words = int(labels.max()), "be one of each outline, in the order of their values"
            require(len(speeds) == count, "restore_frames(speed=...)", words, known.speeds)
        velocities = speeds[:, ::-1] if in_plane else np.pad(speeds, ((0, 0), (1, 0)))
        velocities = readout.seen(velocities)
    return Told(velocities, labels)


def _result(whole: _Whole, axis: Axis, *, in_plane: bool) -> RestoredObjects:
    """The picture, objects and maps as a user has them, turned back."""
    found, light, picture, labels, trust = whole
    areas = [int(np.sum(labels == n + 1)) for n in range(len(found.things))]
    order = np.argsort(areas, kind="stable")[::-1].tolist()
    numbers = np.zeros(len(order) + 1, int)
    numbers[[n + 1 for n in order]] = np.arange(1, len(order) + 1)
    objects = [_object(found, n, (labels, trust), axis, in_plane=in_plane) for n in order]
    back = Layer(_picture([each[0] for each in light], None, axis))
    layers = [
        _layer(found.things[n], [each[n + 1] for each in light], axis, in_plane=in_plane)
        for n in reversed(found.order)
    ]
    return RestoredObjects(
        transposed(picture, axis),
        tuple(objects),
        transposed(numbers[labels], axis),
        transposed(trust, axis),
        Layers((back, *layers)),
    )


def _object(
    found: Arrangement,
    number: int,
    maps: tuple[np.ndarray, np.ndarray],
    axis: Axis,
    *,
    in_plane: bool,
) -> FoundObject:
    """A thing as a user has it."""
    (labels, trust), thing = maps, found.things[number]
    turn = slice(None, None, -1) if axis == "rows" else slice(None)
    velocity, covariance = 0.0 - thing.velocity[turn], thing.covariance[turn, turn]
    own = labels == number + 1
    down, across = (float(x.mean()) if x.size else 0.0 for x in np.nonzero(own))
    place = (down, across) if axis == "rows" else (across, down)
    speed = float(np.hypot(*velocity)) if in_plane else -float(thing.velocity[1])
    spread = float(np.sqrt(max(np.linalg.eigvalsh(thing.covariance)[-1], 0))) * found.stills.span
    share = float(np.mean(trust[own])) if own.any() else 0.0
    doubt = ""
    if spread > _WIDEST:
        doubt = f"its velocity is known to {spread:.1g} px over the frames only"
    elif share < _LEAST_SHARE:
        doubt = f"the frames agree on {share:.0%} of its pixels only"
    area = float(np.sum(thing.matte))
    return FoundObject(velocity, covariance, speed, area, place, not doubt, doubt)


def _layer(thing: Thing, light: list[np.ndarray], axis: Axis, *, in_plane: bool) -> Layer:
    """A thing as a layer, cut out about its matte."""
    window = Window.around(thing.matte > 0.002, 1)
    matte = window.of(thing.matte)
    picture = _picture([window.of(one) for one in light], matte, axis)
    top, left = (window.top, window.left) if axis == "rows" else (window.left, window.top)
    across, along = (-thing.velocity).tolist()
    speed = (along, across) if in_plane else along
    return Layer(picture, speed, left=left, top=top)


def _picture(colours: list[np.ndarray], matte: np.ndarray | None, axis: Axis) -> Picture:
    light = np.maximum(np.stack(colours, axis=-1), 0).astype(np.float32)
    opacity = None if matte is None else transposed(matte.astype(np.float32), axis)
    return Picture(transposed(light, axis), opacity)
