"""The answer of a comparison in words; `search/rows.py` decides which option to take."""

import math
import textwrap
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Array

from mishutter._core.checks import in_digits, three_digits
from mishutter.design.design import Design
from mishutter.evaluation.bursts import FrameTimes, StillBursts, window_of
from mishutter.evaluation.losses import AbstractLoss
from mishutter.evaluation.registration import LONG, REGION, with_losses
from mishutter.model.devices import AbstractDevice
from mishutter.model.exposures import Exposures
from mishutter.model.frame_path import AT_REST, SINE
from mishutter.model.limits import Limits
from mishutter.model.motion import LinearMotion
from mishutter.model.occlusion import Occlusion
from mishutter.model.scene import Scene, in_sensor_frame, require_velocities
from mishutter.model.scene_units import GRAVITY
from mishutter.model.sensor import BurstMode
from mishutter.model.texture import EXAMPLE_PICTURE
from mishutter.search.frame_ties import (
    ALTERNATING,
    CIRCLE,
    CROSSED,
    FAN,
    FOLLOW,
    FREE,
    MOST_FREE,
    PAN,
    RING,
    SWEEP,
    SWINGS,
    TWO_SINES,
)
from mishutter.search.frame_words import flights_back
from mishutter.search.moving_frames import loss_untold
from mishutter.search.plane_frames import stills_on_pan
from mishutter.search.rivals import (
    PLAIN_RATE,
    PLAIN_STILLS,
    Entry,
    RivalSearch,
    snapshots,
    taken_names,
)
from mishutter.search.rows import BEST_SNAPSHOT, SHUTTER, STAGE, Row, best_row
from mishutter.search.space import beyond_limits

_OPTIMISED = "optimised"
"""Name of the design of a search, which an answer calls by what it is."""
_ADDS = 0.1
"""Gain of a shaped shutter below which it adds nothing; dB."""
_SHOWN = 0.05
"""Least difference of levels that one decimal shows, and loss that is said; dB."""
_WORTH_A_PAN = 1.0
"""Gain by a pan from which on a camera that has none is told of it; dB."""
_WAYS = {
    PAN: ("pans at {speeds}", "pans"),
    SINE: ("swings on a sine that turns in the middle of each frame", "swings {way} on a sine"),
    SWEEP: ("goes out and back once at a constant acceleration", "sweeps {way}"),
    ALTERNATING: ("turns back in each frame", "swings {way}"),
    SWINGS: ("turns back in each frame", "swings {way}"),
    FAN: (
        "takes another velocity in each frame",
        "takes a speed of its own in each, over {way}",
    ),
    FOLLOW: (
        "follows the objects at {speeds} and flies back between frames, {turns}",
        "follows the objects and flies back over {way}",
    ),
    CIRCLE: ("circles", "circles over {way}"),
    TWO_SINES: ("follows two sines", "follows two sines over {way}"),
    CROSSED: ("swings along two axes in turn", "swings {way} along two axes in turn"),
    RING: (
        "takes another velocity in each frame",
        "takes another velocity in each over {way}",
    ),
    FREE: ("takes a path of its own in each frame", "follows a free path over {way}"),
}
"""The way of a stage over frames, and the same in brief."""
_ANY_WAY = "swings", "swings {way}"


def options_of(rows: Iterable[Row], choice: Row, own: Collection[str] = ()) -> list[Row]:
    """The options by what they need, each the best of its kind, in the order of their levels.

    An option is left out where another needs no more and is as good. The best snapshot at rest,
    the choice and what has a name of the user's always stand.
    """
    several = [row for row in rows if row.is_of_one_exposure or row.num_frames > 1]
    kept = {BEST_SNAPSHOT, choice.name, *(name for name in own if name != _OPTIMISED)}
    named = (row for row in several if row.name in kept)
    shown = {row.name: row for row in (*named, *best_of_each_need(several))}

    def is_needless(row: Row) -> bool:
        return any(
            other.parts <= row.parts and row.margin_over(other) < _SHOWN
            for other in shown.values()
            if other is not row and other.rank <= row.rank
        )

    options = [row for row in shown.values() if row.name in kept or not is_needless(row)]
    return sorted(options, key=lambda row: (row.level, row.rank))


def best_of_each_need(rows: Iterable[Row]) -> list[Row]:
    """The best of the rows that need the same, or a simpler one that is as good."""
    groups: dict[object, list[Row]] = {}
    for row in rows:
        groups.setdefault((row.parts, row.is_free), []).append(row)
    best = []
    for group in groups.values():
        top = best_row(group)
        near = [row for row in group if top.margin_over(row) < _SHOWN]
        least = min(row.rank for row in near)
        best.append(best_row(row for row in near if row.rank == least))
    return best


def option_name(row: Row) -> str:
    """A row in the words of a table of options: what is exposed, on which path, for how long."""
    name = f"{_what(row)}, {row.exposures.lengths}"
    if row.name == PLAIN_STILLS:
        name += f", at {PLAIN_RATE:.0f} frames/s"
    elif row.num_frames == 1 and row.decoder.knows_speed and not row.is_in_plane:
        name += f", speed {'found' if row.decoder.finds_speed else 'known'}"
    return f"{row.name}: {name}" if _is_named(row) else name


def _is_named(row: Row) -> bool:
    """Whether a row has a name of the user's."""
    return row.sequence is None and row.name not in (*taken_names(), _OPTIMISED)


def _what(row: Row) -> str:
    frames = row.sequence
    if frames is not None and (row.num_frames > 1 or frames.moves):
        return f"{_counted(frames)}{_way_of_frames(frames, short=True)}"
    return f"{'snapshot' if _is_snapshot(row) else 'one exposure'} {_path(row)}"


def _is_snapshot(row: Row) -> bool:
    """Whether a row is an ordinary exposure without acceleration, whatever search found it."""
    is_open = SHUTTER not in row.required_hardware
    return row.is_of_one_exposure and is_open and row.is_straight


def _path(row: Row) -> str:
    """The path of a single exposure."""
    if row.is_straight:
        return f"on a pan of {row.pan_words} px/s" if row.pans else "at rest"
    return "on a free path" if row.is_free else "on a parabola"


def _way_of_frames(frames: Exposures, *, short: bool = False) -> str:
    """The way of the sensor over several frames."""
    turns = " while the camera turns" if np.any(frames.pan) else ""
    if not frames.moves or frames.stroke < AT_REST:
        return turns or " at rest"
    rests, moving = frames.num_rests, frames.num_frames - frames.num_rests
    if rests:
        which = "second" if frames.num_frames == 2 else "last" if moving == 1 else f"last {moving}"
        during = f", the {which} moving" if short else f", the stage moving during the {which}"
        return f"{turns}{during}"
    travel = _at_most(frames.travel) if frames.in_plane else frames.travel
    way = _WAYS.get(frames.kind, _ANY_WAY)[1].format(way=f"{three_digits(travel)} px")
    return f"{turns} and the stage {way}" if turns else f" while the stage {way}"


def _at_most(value: float) -> float:
    """A number rounded up to two digits: a search in the plane does not settle the next."""
    size = 10.0 ** (math.floor(math.log10(value)) - 1)
    return math.ceil(value / size - 1e-6) * size


def _counted(exposures: Exposures) -> str:
    """The number of exposures, in words."""
    return "one exposure" if exposures.num_frames == 1 else f"{exposures.num_frames} frames"


def order_at_rest(exposures: Exposures, limits: Limits, aside: str = "") -> str:
    """The order to take some exposures, in words, with the stage at rest if there is one."""
    link = ", " if " of " in exposures.lengths else " of "
    if not limits.moves:
        several = exposures.num_frames > 1
        what = f"{exposures.num_frames} stills" if several else "one exposure at rest"
        return f"{what}{link}{exposures.lengths}{aside}"
    end = ", and" if link == ", " else " and"
    return f"{_counted(exposures)}{link}{exposures.lengths}{aside}{end} keep the stage still"


def headline(
    choice: Row, snapshot: Row, limits: Limits, within: tuple[float, float] | None = None
) -> str:
    """The first line of an answer: what to take, its level and its gain."""
    level = f"{choice.level:.1f} dB{' at the worst speed' if choice.at_worst else ''}"
    if choice.name == BEST_SNAPSHOT:
        exposure = choice.exposures.lengths
        return f"Take a snapshot of {exposure} at rest: {level}; no other option is worth more."
    gains = (choice.margin_over(snapshot),) if within is None else within
    gain = " to ".join(dict.fromkeys(f"{end:.1f}" for end in gains))
    beside = " at rest" if _is_snapshot(choice) else ""
    return f"Take {_order(choice, limits)}: {level}, {gain} dB better than a snapshot{beside}."


def _order(row: Row, limits: Limits) -> str:
    """A row in the words of somebody who is to take it."""
    name = f"{row.name}, " if _is_named(row) else ""
    frames = row.sequence
    if frames is not None:
        way = _way_of_frames(frames)
        rate = f" at {PLAIN_RATE:.0f} frames/s" if row.name == PLAIN_STILLS else ""
        if way == " at rest":
            return order_at_rest(row.exposures, limits, rate)
        return f"{_counted(frames)}{way}"
    if _is_snapshot(row):
        return f"{name}a {_what(row)}"
    size = "" if row.is_straight else f" of {three_digits(row.stroke)} px"
    if SHUTTER not in row.required_hardware:
        path = f" while the stage follows {_path(row)[3:]}" if size else f" {_path(row)}"
        return f"{name}one exposure{path}{size}"
    path = f", the stage {_path(row)}" if size else f", {_path(row)}"
    return f"{name}one exposure behind a shaped shutter{path}{size}"


def sentences_of(
    scene: Scene, rows: Iterable[Row], choice: Row, notes: Iterable[str] = ()
) -> list[str]:
    """The lines below the table of options: the shutter, notes, and what is assumed."""
    rows = list(rows)
    if scene.sensor.is_rolling:
        said = [
            "One exposure behind a shaped shutter, or on a path that accelerates, is left out: "
            "rows that are exposed one after another would each see another part of it."
        ]
    else:
        said = [_on_shaped_shutters([row for row in rows if row.is_of_one_exposure], choice)]
    if scene.burst is not None and scene.is_found_by_object:
        said.append(_on_objects(scene.occlusion))
    if choice.hides_speed:
        said.append("The speed cannot be found: the blur differs too little between the speeds.")
    if choice.sequence is not None and choice.sequence.turning:
        said.append(f"{choice.sequence.turning.capitalize()}.")
    if STAGE in choice.required_hardware:
        said.append(_on_stage(scene, rows, choice))
    one_filter = scene.velocities is not None and scene.decoder_speed == "unknown"
    if one_filter and scene.occlusion is None:
        said.append(
            "One filter for all velocities is not offered: no moving camera beats the best still "
            "frame by it where things move in any direction."
        )
    if scene.errors is not None and choice.name != BEST_SNAPSHOT:
        said.append(
            "The gain is stated within two standard errors of each measured number ([errors] of "
            "the scene), for both cameras unchanged."
        )
    sentences = (*said, *notes, _assumptions(scene, choice))
    return [paragraph(sentence) for sentence in sentences if sentence]


def on_what_is_left_out(below: float) -> str:
    """The reason why single exposures are not searched: their ceiling is so far below frames."""
    return paragraph(
        f"Other single exposures are left out: their ceiling is {below:.1f} dB below this "
        "(--verbose searches for them)."
    )


def on_pan(scene: Scene, choice: Row, loss: AbstractLoss) -> str:
    """The gain by following things that all move one way, where nothing moves the sensor."""
    limits, occurs = scene.limits, np.asarray(scene.weights) > 0
    speeds = np.asarray(scene.speeds, np.float64)[occurs]
    slowest, fastest = float(np.min(speeds)), float(np.max(speeds))
    velocity, both_ways = (slowest + fastest) / 2, slowest * fastest < 0
    if _moves(limits) or both_ways or velocity == 0 or scene.occlusion is not None:
        return ""
    room = replace(limits, pans="camera", max_pan=abs(velocity), max_top_speed=2 * abs(velocity))
    motion = LinearMotion(half_exposure=limits.max_half_exposure, velocity=velocity)
    on_it = in_sensor_frame(replace(scene, limits=room, given_motion=None), motion)[0]
    row = snapshots(RivalSearch(on_it, loss))[0].judged_by(loss, on_it)
    taken, level = row.exposures, row.level
    if choice.num_frames > 1:
        times = FrameTimes.of(scene, scene.burst or BurstMode(frames_per_s=PLAIN_RATE))
        stills = StillBursts(on_it, at_worst=choice.at_worst).best_sequence(times)
        of_stills = with_losses(on_it, stills).level_of(at_worst=choice.at_worst)
        if of_stills > level:
            taken, level = stills, of_stills
    return _following(in_digits(velocity, 4), taken, level, choice)


def on_pan_in_plane(scene: Scene, choice: Row) -> str:
    """The same sentence where things move in any direction about a mean."""
    law = require_velocities(scene)
    x, y = law.centre.tolist()
    speed = math.hypot(x, y)
    is_one_way = speed > 0 and speed >= law.half_range(np.array([math.atan2(y, x)]))[0]
    if _moves(scene.limits) or not is_one_way:
        return ""
    burst = stills_on_pan(scene)
    return _following(f"({in_digits(x, 4)}, {in_digits(y, 4)})", burst, burst.level, choice)


def _moves(limits: Limits) -> bool:
    """Whether something may move the sensor."""
    return limits.moves or (limits.pans == "camera" and float(limits.max_pan) > 0)


def _following(velocity: str, taken: Exposures, level: float, choice: Row) -> str:
    """The sentence on exposures that follow at a velocity, px/s; empty where they gain little."""
    if level - choice.level < _WORTH_A_PAN:
        return ""
    what = f"{taken.num_frames} frames" if taken.num_frames > 1 else "a snapshot"
    return (
        f"Following at {velocity} px/s, by turning the camera, a mirror or a stage, {what} of "
        f"{taken.lengths} would reach {level:.1f} dB, {level - choice.level:.1f} dB more (say "
        '[limits] pans = "camera").'
    )


def _on_shaped_shutters(rows: Sequence[Row], choice: Row) -> str:
    """The gain of a shaped shutter over an open one, of one exposure."""
    if not any(SHUTTER in row.hardware for row in rows):
        return ""
    shaped = [row for row in rows if SHUTTER in row.required_hardware]
    steady = best_row(row for row in rows if row not in shaped)
    best = best_row(shaped) if shaped else steady
    gain = best.margin_over(steady)
    if gain < _ADDS:
        return f"A shaped shutter adds nothing here (below {_ADDS} dB)."
    if SHUTTER in choice.required_hardware:
        return f"The shaped shutter adds {gain:.1f} dB to an open one."
    below = choice.margin_over(best)
    stays = f"which stays {below:.1f} dB below this" if below >= _SHOWN else "which is not worth it"
    return f"A shaped shutter adds {gain:.1f} dB to one exposure, {stays}."


def _on_stage(scene: Scene, rows: Sequence[Row], choice: Row) -> str:
    """The gain by the stage, its path over frames, and what that takes of it."""
    several = (row for row in rows if row.is_of_one_exposure or row.num_frames > 1)
    without = best_row(row for row in several if STAGE not in row.required_hardware)
    gain = choice.margin_over(without)
    added = f"The stage adds {gain:.1f} dB to the best option without one."
    frames = choice.sequence
    if frames is None or not frames.moves:
        return added
    rests = frames.num_rests
    rest = f"rests in the first {'frame' if rests == 1 else f'{rests} frames'}, then "
    doing = _WAYS.get(frames.kind, _ANY_WAY)[0].format(speeds=_speeds(frames), turns=_turns(frames))
    way = f"{rest if rests else ''}{doing}"
    axes = ""
    use = frames.use_within(scene.limits)
    travel, top_speed = float(use.travel), float(use.top_speed)
    if choice.is_in_plane:
        travel, top_speed = _at_most(travel), _at_most(top_speed)
        axes = {"one": "", "each": ", each axis", "disc": ", both axes"}[scene.limits.axes]
    pitch = scene.sensor.pixel_pitch
    numbers = _stage_numbers(travel, top_speed, float(use.acceleration), pitch)
    run_up = "run-up from rest included"
    if scene.limits.max_acceleration is None:
        run_up = "reached at once, as [limits] max_acceleration_g or _px_per_s2 says no limit"
    said = f"{added} It {way}: {numbers}{axes}, {run_up}."
    if frames.num_frames > MOST_FREE and not choice.is_in_plane:
        said += (
            f" More than {MOST_FREE} frames are searched on ways of few numbers alone, which may "
            "lose some tenths of a decibel."
        )
    return said


def _speeds(frames: Exposures) -> str:
    """Mean speeds over the frames that move, in words."""
    ends = np.array(frames.lights)
    ways = np.hypot.reduce(np.diff(frames.place(ends), axis=-1)[..., 0])
    moving = (ways / np.diff(ends)[:, 0])[~np.array(frames.rests)]
    few = sorted({float(f"{speed:.2g}") for speed in (np.min(moving), np.max(moving))})
    return f"{' to '.join(f'{speed:,g}' for speed in few)} px/s"


def _turns(frames: Exposures) -> str:
    """How often the stage flies back between frames, in words."""
    count = flights_back(frames)
    return {1: "once", 2: "twice"}.get(count, f"{count} times")


def _stage_numbers(
    travel: float, top_speed: float, acceleration: float, pitch: Array | None
) -> str:
    """The demands of a path on a stage, in um, mm/s and g too where the pixel pitch is known."""
    words = f"{three_digits(travel)} px at up to {three_digits(top_speed)} px/s"
    if pitch is None:
        rate = f"{float(f'{acceleration:.2g}'):,g} px/s^2"
        return f"{words} and {rate}" if acceleration else words
    p = float(pitch)  # m
    physical = [
        f"{three_digits(travel * p * 1e6)} um",
        f"{three_digits(top_speed * p * 1e3)} mm/s",
    ]
    # A velocity that is reached at once has no acceleration.
    physical += [f"{acceleration * p / GRAVITY:.2g} g"] if acceleration else []
    return f"{words} ({', '.join(physical)})"


def _on_objects(layers: Occlusion | None) -> str:
    """The knowledge of objects that levels of frames take for granted."""
    why = "Moving frames are left out: objects are found in frames at rest alone."
    if layers is None:
        return f"{why} If all of a picture moves alike, say width_px of [sensor] and not [objects]."
    if layers.background == "moving":
        return f"Levels of frames assume known speeds and outlines, and ignore edges. {why}"
    if not layers.has_edges:
        return f"Levels of frames ignore edges, for want of `object_width_px`. {why}"
    return (
        "Levels of frames include what edges cost `restore`, in the mean over photographs at 1e5 "
        f"e-/s: a single one is 2 dB above or below. {why}"
    )


def _as_known(layers: Occlusion) -> str:
    """The way in which levels of frames before a background take velocities to be known."""
    is_counted = layers.background == "still" and layers.has_edges
    return "found from the frames, as outlines are" if is_counted else "told"


def _assumptions(scene: Scene, choice: Row) -> str:
    """The assumptions of a level: of the motion, of the objects, of the decoder."""
    frames, law, beside = choice.sequence, scene.velocities, []
    motion = f"all motion along the {scene.sensor.axis}" if law is None else law.words
    if law is not None:
        decoder = "velocities are found from the frames without error"
        if choice.num_frames == 1:
            decoder = "the decoder knows the velocity"
        elif scene.occlusion is not None:
            decoder = f"velocities are {_as_known(scene.occlusion)}"
        beside = _on_borders(scene, choice)
    elif frames is not None:
        decoder = "frames are registered without error"
        if scene.occlusion is not None:
            decoder = f"speeds are {_as_known(scene.occlusion)}"
        if choice.name == PLAIN_STILLS:
            decoder = f"a camera that takes {PLAIN_RATE:.0f} frames/s; {decoder}"
    elif not choice.decoder.knows_speed or choice.hides_speed:
        decoder = "one filter restores all speeds"
    else:
        decoder = f"the decoder {'finds' if choice.decoder.finds_speed else 'knows'} the speed"
    objects = _objects_words(scene, choice.exposures)
    said = [detail_words(scene), motion, objects, decoder, *beside, *_camera_words(scene, choice)]
    return f"Assumes: {'; '.join(said)}."


def _on_borders(scene: Scene, choice: Row) -> list[str]:
    """The losses by the borders of the sensor that levels in the plane do not count."""
    width, longest = scene.registered_width, max(choice.exposures.exposures)
    if width is None:
        return ["things that enter and leave are not counted (else say [sensor] width_px)"]
    within = float(scene.max_speed) * longest
    if STAGE not in choice.required_hardware or within <= LONG * width:
        return []
    return [f"borders cost more than is counted: things move by {within:.0f} px within a frame"]


def detail_words(scene: Scene) -> str:
    """The assumption on the detail of pictures, on which levels depend most."""
    picture = scene.picture
    if picture.path is None and picture.power_spectrum is not None:
        kind = "by the scene's spectrum"
    elif picture.path is None:
        kind = "as in a photograph"
    else:
        kind = "as in " + {EXAMPLE_PICTURE: "the example"}.get(
            picture.path, Path(picture.path).name
        )
    finer = f"a tenth of its contrast is finer than {picture.detail:.3g} px"
    is_said = picture.path is not None or picture.power_spectrum is not None
    other = "" if is_said else "; for print, codes or cells say [picture]"
    return f"detail {kind} ({finer}{other})"


def _objects_words(scene: Scene, exposures: Exposures) -> str:
    """The assumption on the width of the objects, which move while there are exposures."""
    layers = scene.occlusion
    if layers is not None:
        width = layers.object_width
        wide = "" if width is None else f"{float(width):,.4g} px wide "
        return (
            f"objects {wide}that cover {float(layers.front_share):.0%} of the picture, before a "
            f"{'background at rest' if layers.background == 'still' else 'moving background'} with "
            "detail like theirs (before one that is dark and empty say [objects])"
        )
    if scene.objects is not None:
        registered = ", each registered" if exposures.num_frames > 1 else ""
        return f"objects at least {float(scene.objects.width):,.4g} px wide{registered}"
    way = math.ceil(float(scene.max_speed) * exposures.duration)
    return (
        f"the picture moves as a whole, or its objects are much wider than {way:,} px (else say "
        "[objects], or [occlusion] before a background)"
    )


def _camera_words(scene: Scene, choice: Row) -> list[str]:
    """The assumptions on the time for frames, on the stage, and on the sensor."""
    limits, width, is_burst = scene.limits, scene.sensor.width, choice.num_frames > 1
    window = 1e3 * window_of(scene)
    said = [f"frames within {window:,.{4 if window < 1e4 else 9}g} ms"] if is_burst else []
    if STAGE in choice.required_hardware:
        room, speed = _room(limits, choice.sequence), float(limits.max_top_speed)
        said.append(f"a stage with {room} and {speed:,g} px/s")
    said += [] if width is None else [f"a sensor of {float(width):,.6g} px"]
    readout = scene.sensor.readout_time
    return [*said, f"rows read within {readout * 1e3:,.4g} ms" if readout else "global shutter"]


def _room(limits: Limits, frames: Exposures | None) -> str:
    """The room of a stage: its travel where that is the less, or else the stroke during frames."""
    stroke, most = float(limits.max_stroke), limits.max_travel
    if most is not None and float(most) < stroke:
        return f"a travel of {float(most):,.4g} px"
    room = f"a stroke of {stroke:,.4g} px"
    travel = 0.0 if frames is None else float(frames.travel)
    if travel <= 1.001 * stroke:
        return room
    way = _at_most(travel) if frames is not None and frames.in_plane else travel
    return f"{room} during frames, {three_digits(way)} px with its run-up,"


def details_of(scene: Scene, frames: Exposures | None) -> list[str]:
    """The losses of the choice's frames by a real sensor."""
    if frames is None:
        return []
    said = [points_that_leave(scene, frames.width_loss)]
    if frames.registration_loss is not None and frames.registration_loss >= _SHOWN:
        said.append(
            f"Registration by {REGION} x {REGION} px costs {frames.registration_loss:.2f} dB "
            "at the worst speed, which the level does not count."
        )
    is_told = scene.sensor.readout is not None or frames.num_frames == 1
    if not frames.in_plane and frames.moves and not is_told:
        readout, lost = loss_untold(scene, frames)
        said.append(
            f"Behind rows that are read one after another within {readout * 1e3:.3g} ms, as a "
            f"telephone's, a decoder that is not told would lose {lost:.1f} dB (say [sensor] "
            "readout_ms)."
        )
    return [paragraph(sentence) for sentence in said if sentence]


def points_that_leave(scene: Scene, loss: float | None) -> str:
    """The loss by the width of a sensor or an object in a sentence; empty where it is small."""
    if loss is None or loss < _SHOWN:
        return ""
    of_object = None if scene.objects is None else scene.objects.width
    is_object = of_object is not None and float(of_object) == scene.registered_width
    what = "an object's outline" if is_object else "the sensor"
    return f"Points that leave {what} cost {loss:.2f} dB of the level."


def options_table(options: Sequence[Row], snapshot: Row, most: float) -> str:
    """The table of options, under a line that says of what the decibels are."""
    mean, bound = "mean over all speeds", "ceiling of one exposure"
    if snapshot.is_in_plane:
        mean, bound = "mean over all velocities", "ceiling of any path"
    where = "at the worst speed" if snapshot.at_worst else mean
    lines = [("option", "dB", "gain", "needs")]
    for row in options:
        over = "-" if row is snapshot else f"{row.margin_over(snapshot):+.1f}"
        needs = ", ".join(row.needs) or "nothing"
        lines.append((option_name(row), f"{row.level:.1f}", over, needs))
    gain = most - snapshot.level if most != snapshot.level else 0.0
    lines.append((bound, f"{most:.1f}", f"{gain:+.1f}", "-"))
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    table = [
        f" {name.ljust(widths[0])}  {level.rjust(widths[1])}  {over.rjust(widths[2])}  {needs}"
        for name, level, over, needs in lines
    ]
    title = f"Expected PSNR of the restored picture in linear light, {where}:"
    return "\n".join([title, "", *table])


def paragraph(sentence: str) -> str:
    """Sentences in lines of an answer's width."""
    return textwrap.fill(sentence, 80)


def comparison_notes(
    scene: Scene,
    entries: Mapping[str, Entry],
    rows: Sequence[Row],
) -> tuple[str, ...]:
    """Sentences for the foot of the tables."""
    notes = device_notes(scene.device)
    if scene.device is not None:
        levels = [e.psnr_ignoring_lag for e in entries.values() if isinstance(e, Design)]
        notes += [
            f"A design for an ideal shutter, sent to this one unchanged, reaches {level:.2f} dB."
            for level in dict.fromkeys(levels)
            if level is not None
        ]
    for row in rows:  # a camera as built may exceed some limits
        beyond = row.sequence is None and beyond_limits(scene, row.motion, row.shutter)
        if beyond:
            names = ", ".join(name.replace("_", " ") for name in beyond)
            notes.append(f"{row.name} is outside the scene's limits: {names}.")
    if scene.tolerances is not None and all(row.within is None for row in rows):
        notes.append(
            "Levels ignore the tolerances: those apply to one filter and the mean over speeds."
        )
    burst = scene.burst
    if burst is not None and burst.max_frames == 1:
        notes.append("No burst is compared: [burst] max_frames is 1.")
    elif burst is not None and not (times := FrameTimes.of(scene, burst)).holds_several:
        notes.append(
            f"No burst is compared: at {float(burst.frames_per_s):.3g} frames/s only one frame "
            f"fits into the window of {1e3 * times.window:.4g} ms; say a longer [burst] window_ms."
        )
    return tuple(notes)


def device_notes(device: AbstractDevice | None) -> list[str]:
    """Sentences on the transmission of a shutter, its speed, and the levels that it holds."""
    notes: list[str] = []
    if device is None:
        return notes
    t, closed = float(device.transmission), float(device.transmission * device.leakage)
    if t != 1 or closed != 0:
        notes.append(
            f"The shutter passes {t:.1%} of the light when open, {closed:.2%} when closed."
        )
    if device.lag_words:
        notes.append(device.lag_words)
    if device.num_slots is not None:
        levels = "any level" if device.levels is None else f"one of {device.levels} levels"
        notes.append(f"It holds {levels} over each of {device.num_slots} slots.")
    return notes
