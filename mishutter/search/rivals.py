"""Rivals of a design: snapshots, the best Tukey, coded stills and bursts.

A new rival is a function that searches for it, and a line of `RIVALS`.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import cached_property, partial
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float, PyTree

from mishutter._core.parallel import as_they_end, num_processors, once
from mishutter.design.design import GIVEN, Design
from mishutter.evaluation.bursts import FrameTimes, StillBursts
from mishutter.evaluation.ceilings import ceiling
from mishutter.evaluation.losses import AbstractLoss
from mishutter.evaluation.metrics import SequenceMetrics, evaluate
from mishutter.evaluation.speed_knowledge import KNOWN_SPEED, knowledge_of
from mishutter.evaluation.views import transmittance
from mishutter.model.exposures import Exposures
from mishutter.model.frame_path import AT_REST
from mishutter.model.motion import AbstractMotion, LinearMotion, StillCamera
from mishutter.model.scene import Scene
from mishutter.model.sensor import BurstMode
from mishutter.model.shutters.base import AbstractShutter
from mishutter.model.shutters.kinds import baselines
from mishutter.model.shutters.spline import SplineShutter
from mishutter.model.shutters.windows import RectShutter, TukeyShutter
from mishutter.search.bursts import best_bursts
from mishutter.search.moving_frames import ONE_PARABOLA
from mishutter.search.rows import (
    BEST_PANNED_SNAPSHOT,
    BEST_SNAPSHOT,
    FRAMES,
    ONE_EXPOSURE,
    OWN_BEST_MOTION,
    SAME_MOTION,
    SHUTTER,
    SNAPSHOTS,
    STAGE,
    WORTH_IT,
    Row,
    choice_of,
)
from mishutter.search.search import (
    SearchSettings,
    Start,
    best_design,
    free_by_default,
)
from mishutter.search.space import mirrors

OPEN = "rect"
BEST_TUKEY = "best Tukey"
BEST_CODED_STILL = "best coded still"
CODED_AT_REST = "best coded at rest"
BEST_STILL_BURST = "best still burst"
BEST_MOVING_BURST = "best moving burst"
BEST_TURNED_BURST = "best moving burst without a stage"
PLAIN_RATE = 30.0
"""Frame rate that every camera has; 1/s."""
PLAIN_STILLS = f"stills at {PLAIN_RATE:.0f} frames/s"
"""Frames at rest that any camera could take, of a scene that states no frame rate."""

Step = Callable[[str], None]
Entry = AbstractShutter | Design


class RivalSearch:
    """The searches of one comparison: what they are for, and designs that some of them share."""

    def __init__(
        self,
        scene: Scene,
        loss: AbstractLoss,
        motion: AbstractMotion | None = None,
        entries: Mapping[str, Entry] | None = None,
        *,
        every: bool = True,
        bursts: tuple[Exposures, ...] = (),
    ) -> None:
        self.scene, self.loss, self.every, self._bursts = scene, loss, every, bursts
        self.motion = scene.motion if motion is None else motion
        # Searches begin with this motion, the scene's, or the fullest parabola.
        steady = scene.motion if scene.motion.accelerates_constantly else scene.fullest_motion
        motions = (self.motion, scene.motion)
        parabolas = (m for m in motions if m.accelerates_constantly and not m.is_straight)
        self.start = next(parabolas, steady)
        self.entries = {} if entries is None else entries
        self.burst_progress: Callable[[float], None] = lambda share: None
        is_open = not every or scene.sensor.is_rolling
        self._baselines = {OPEN: RectShutter()} if is_open else baselines()
        self.open_on_parabola = once(lambda: self.best(self.start, RectShutter()))

    def best(
        self,
        start: AbstractMotion,
        shutter: AbstractShutter | None = None,
        free: Iterable[str] | None = None,
    ) -> Design:
        """The best design from a motion and a shutter, or from a free-form profile."""
        names = None if free is None else tuple(free)
        return best_design(Start(self.scene, start, shutter, names), SearchSettings(self.loss))

    def shaped_entry(self) -> Design | None:
        """The best design of a free profile on a parabola, where it is one of the entries."""
        for entry in self._finished_entries():
            if isinstance(entry.command, SplineShutter) and entry.straight is not None:
                return entry
        return None

    @property
    def windows(self) -> dict[str, AbstractShutter]:
        """The baselines, but for those that an entry is."""
        if self.frames_alone:
            return {}
        return {n: window for n, window in self._baselines.items() if n not in self.entries}

    @cached_property
    def frames_alone(self) -> bool:
        """Whether frames are the answer whatever one exposure reaches, and nothing asks for that.

        No simpler camera within 0.2 dB of them would replace them: the ceiling is below.
        """
        if self.every or self.entries or self.scene.burst is None:
            return False
        rows = [self.judged(row) for row in rows_of_bursts(*self.bursts())]
        return bool(rows) and choice_of(rows).level - WORTH_IT >= float(ceiling(self.scene))

    def bursts(self) -> tuple[Exposures, ...]:
        """The best bursts, which a search of an entry may have found."""
        if not self._bursts:
            known = (entry.bursts for entry in self._finished_entries() if entry.bursts)
            found = next(known, ()) or best_bursts(self.scene, progress=self.burst_progress)
            self._bursts = found
        return self._bursts

    def judged(self, row: Row) -> Row:
        """A row as the decoder of the loss judges it."""
        if row.is_of_one_exposure:
            return row.judged_by(self.loss, self.scene)
        # A burst keeps its own decoder, which is told the speed by the registration of its frames.
        return replace(row, at_worst=self.loss.of_worst_speed)

    def _finished_entries(self) -> Iterator[Design]:
        """The entries that are results of searches of this scene."""
        for entry in self.entries.values():
            if isinstance(entry, Design) and is_finished(entry, self.scene, self.loss):
                yield entry


class Rival(NamedTuple):
    """A kind of camera that stands beside a design, tuned alike."""

    names: tuple[str, ...]  # Names of its rows, of which a search may find fewer
    hardware: frozenset[str]  # Parts that its rows may require
    search: Callable[[RivalSearch], list[Row]]  # Finds its rows
    # Whether a comparison searches for it
    is_asked: Callable[[RivalSearch], bool] = lambda search: True

    def rows(self, search: RivalSearch) -> list[Row]:
        """Its rows, which know the parts that they may require."""
        return [replace(row, hardware=self.hardware) for row in self.search(search)]


def taken_names() -> tuple[str, ...]:
    """Names of the rows that a comparison adds by itself."""
    return (*baselines(), *(name for rival in RIVALS for name in rival.names))


def may_be_named(entry: Entry, name: str) -> bool:
    """Whether a name is free, or that of a baseline with the same shutter."""
    return name not in taken_names() or _are_equal(baselines().get(name), entry)


def searches(search: RivalSearch) -> dict[str, Callable[[], list[Row]]]:
    """The searches of a comparison by the names of their first rows, the longest first."""
    rivals = [rival for rival in RIVALS if rival.is_asked(search)]
    of_rivals = {rival.names[0]: partial(rival.rows, search) for rival in reversed(rivals)}
    entries = {**search.entries, **search.windows}
    return of_rivals | {name: partial(_own_best, search, name) for name in entries}


def compared_rows(search: RivalSearch, step: Step, begin: Step = lambda name: None) -> list[Row]:
    """Measures shutters, baselines and rivals at their own best motions, and on one motion."""
    scene, motion = search.scene, search.motion
    entries = {**search.entries, **search.windows} if search.every else {}
    commands = {n: e.command if isinstance(e, Design) else e for n, e in entries.items()}
    shutters = {name: transmittance(scene, motion, each) for name, each in commands.items()}
    measure = partial(evaluate, scene, motion)
    on_motion = [
        Row(SAME_MOTION, name, Exposures.of_one(motion, each, scene.limits), None, measure(each))
        for name, each in shutters.items()
    ]
    at_best = {}

    def named(name: str, call: Callable[[], list[Row]]) -> tuple[str, list[Row]]:
        begin(name)
        return name, call()

    calls = [partial(named, *item) for item in searches(search).items()]
    for first_name, rows in as_they_end(calls, num_processors()):
        step(first_name)
        at_best |= {row.name: search.judged(row) for row in rows}
    order = dict.fromkeys((*search.entries, *taken_names()))
    names = [name for name in order if name in at_best and _is_alike(at_best[name], scene)]
    return [*(at_best[name] for name in names), *map(search.judged, on_motion)]


def _is_alike(row: Row, scene: Scene) -> bool:
    """Whether all rows of a picture see the same profile and path, or are restored by their own."""
    is_simple = SHUTTER not in row.required_hardware and row.is_straight
    return is_simple or not row.is_of_one_exposure or not scene.sensor.is_rolling


def _middle_exposure(scene: Scene) -> Float[np.ndarray, ""]:
    limits = scene.limits
    low, high = (np.asarray(x) for x in (limits.min_half_exposure, limits.max_half_exposure))
    return np.asarray(np.sqrt(low * high))


def _camera_at_rest(scene: Scene) -> AbstractMotion:
    return StillCamera(half_exposure=_middle_exposure(scene))


def _unaccelerated(scene: Scene) -> AbstractMotion:
    """A sensor at the velocity in the middle of the speeds, as far as it may pan.

    Where that is 0 and more speeds are to one side, a search begins with a slow pan: a motion
    without a pan would be a camera at rest, which stays at rest.
    """
    velocity = scene.fullest_motion.velocity
    if float(velocity) == 0 and scene.limits.may_pan and not mirrors(scene, 0.0):
        velocity = np.asarray(0.01 * float(min(scene.max_speed, scene.limits.max_pan)))
    return LinearMotion(half_exposure=_middle_exposure(scene), velocity=velocity)


def snapshots(search: RivalSearch) -> list[Row]:
    """Searches for the best snapshots: at rest and, where the limits allow a pan, panned."""
    scene = search.scene
    at_rest = search.best(_camera_at_rest(scene), RectShutter())
    designs = {BEST_SNAPSHOT: at_rest}
    if scene.limits.may_pan:
        pan = _unaccelerated(scene)
        # Where the speeds lie evenly about 0, no pan is better than none.
        is_still = float(pan.velocity) == 0
        designs[BEST_PANNED_SNAPSHOT] = at_rest if is_still else search.best(pan, RectShutter())
    return [_row(name, design) for name, design in designs.items()]


def _coded_stills(search: RivalSearch) -> list[Row]:
    """The best free profile without acceleration, and where that pans the best at rest."""
    scene = search.scene
    # The search for a free profile holds the best one without acceleration.
    shaped = search.shaped_entry()
    best = None if shaped is None else shaped.straight
    if best is None:
        best = search.best(_unaccelerated(scene))
    still = _row(BEST_CODED_STILL, best)
    if not still.pans:
        return [still]
    return [still, _row(CODED_AT_REST, search.best(_camera_at_rest(scene)))]


def _bursts(search: RivalSearch) -> list[Row]:
    """The best bursts of a camera that takes any, by a decoder that registers their frames.

    Nothing registers one frame: where there is no time for more, it is a row of single exposures.
    """
    scene, is_told = search.scene, knowledge_of(search.scene, search.loss).is_told
    burst: BurstMode = scene.burst  # type: ignore[assignment]
    if not (is_told or FrameTimes.of(scene, burst).holds_several):
        return []
    still, *moving = search.bursts()
    # A burst may be no more than one exposure of an open shutter.
    if moving and is_told and not search.frames_alone:
        design = search.open_on_parabola()
        levels = design.metrics.known_speed_psnr, design.metrics.worst_known_speed_psnr
        limits = design.scene.limits
        one = Exposures.of_one(design.motion, design.shutter, limits)
        whole = Exposures(ONE_PARABOLA, one.frames, 0.0, *map(float, levels), pan=one.pan)
        moving.append(whole.with_travel(limits))
    return rows_of_bursts(still, *moving)


def rows_of_bursts(still: Exposures, *moving: Exposures) -> list[Row]:
    """The rows of the burst at rest, of the best that moves, and of one without its stage."""
    found = {BEST_STILL_BURST: still}
    if moving:
        found[BEST_MOVING_BURST] = best = max(moving, key=lambda burst: burst.level)
        # A camera that turns may do without the stage of the best.
        alone = [x for x in moving if x.num_frames > 1 and x.stroke < AT_REST <= best.stroke]
        if alone:
            found[BEST_TURNED_BURST] = max(alone, key=lambda burst: burst.level)
    # One frame is no burst: it has rows of its own.
    return [_row_of_burst(name, each) for name, each in found.items() if each.num_frames > 1]


def _plain_stills(search: RivalSearch) -> list[Row]:
    """The best frames at rest at a rate that any camera has, if there is time for several."""
    burst = BurstMode(frames_per_s=PLAIN_RATE)
    times = FrameTimes.of(search.scene, burst)
    stills = StillBursts(search.scene)
    best = stills.best_within(times)
    if best.num_frames == 1:
        return []
    return [_row_of_burst(PLAIN_STILLS, stills.sequence([best], times))]


def _row_of_burst(name: str, sequence: Exposures) -> Row:
    """A burst as a row, of the level of all its frames."""
    levels = (sequence.level_of(at_worst=at_worst) for at_worst in (False, True))
    metrics = SequenceMetrics(1.0, *levels)
    parts = frozenset({STAGE, FRAMES})
    return Row(OWN_BEST_MOTION, name, sequence, None, metrics, KNOWN_SPEED, hardware=parts)


RIVALS = (
    Rival(
        (BEST_TUKEY,),
        ONE_EXPOSURE,
        lambda search: [_row(BEST_TUKEY, search.best(search.start, TukeyShutter(0.5)))],
        is_asked=lambda search: search.every and not search.scene.sensor.is_rolling,
    ),
    Rival(SNAPSHOTS, frozenset({STAGE}), snapshots),
    Rival(
        (BEST_CODED_STILL, CODED_AT_REST),
        ONE_EXPOSURE,
        _coded_stills,
        is_asked=lambda search: not (search.frames_alone or search.scene.sensor.is_rolling),
    ),
    Rival(
        (BEST_STILL_BURST, BEST_TURNED_BURST, BEST_MOVING_BURST),
        frozenset({STAGE, FRAMES}),
        _bursts,
        is_asked=lambda search: search.scene.burst is not None,
    ),
    Rival(
        (PLAIN_STILLS,),
        frozenset({FRAMES}),
        _plain_stills,
        is_asked=lambda search: search.scene.burst is None and search.scene.occlusion is None,
    ),
)
"""All rivals, in the order of their rows. Searches for the last take longest, and begin first."""


def _own_best(search: RivalSearch, name: str) -> list[Row]:
    """Searches for an entry's own best motion, unless it is a design that has it."""
    scene, loss, start = search.scene, search.loss, search.start
    entry = search.entries[name] if name in search.entries else search.windows[name]
    if isinstance(entry, Design) and is_finished(entry, scene, loss):
        return [_row(name, entry)]
    if name == OPEN:
        return [_row(name, search.open_on_parabola())]
    shutter = entry.shutter if isinstance(entry, Design) else entry
    if isinstance(entry, Design) and entry.motion.accelerates_constantly:
        start = entry.motion
    parts = free_by_default(scene, start, shutter)
    return [_row(name, search.best(start, shutter, [part for part in parts if part != "shutter"]))]


def is_finished(design: Design, scene: Scene, loss: AbstractLoss) -> bool:
    """Whether a design is the result of a search of this scene by this loss, or is to stay."""
    if design.loss_name == GIVEN:
        return True
    is_of_scene = _are_equal(design.scene.without_metadata(), scene.without_metadata())
    return is_of_scene and design.loss_name == repr(loss)


def _are_equal(first: PyTree, second: PyTree) -> bool:
    """Whether two trees are equal. The host compares them: JAX would compile for each shape."""

    def on_host(leaf: object) -> object:
        return np.asarray(leaf) if eqx.is_array(leaf) else leaf

    return bool(eqx.tree_equal(*jax.tree.map(on_host, (first, second))))


def _row(name: str, design: Design) -> Row:
    one = Exposures.of_one(design.motion, design.shutter, design.scene.limits)
    return Row(OWN_BEST_MOTION, name, one, design.loss, design.metrics, design=design)
