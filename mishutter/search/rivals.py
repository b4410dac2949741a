"""Rivals of a design: windows, snapshots, coded stills, free paths and bursts, each at its best."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float, PyTree

from mishutter._core import as_they_end, num_processors
from mishutter.evaluation import (
    PLANNED,
    AbstractLoss,
    Automatic,
    Metrics,
    Plan,
    best_burst,
    evaluate,
    transmittance,
)
from mishutter.hardware import GIVEN, Design
from mishutter.model import (
    AbstractMotion,
    AbstractShutter,
    DecoderSpeed,
    LinearMotion,
    RectShutter,
    Scene,
    SplineShutter,
    StillCamera,
    TukeyShutter,
    baselines,
)
from mishutter.search.planning import plan as plan_of_scene
from mishutter.search.search import free_by_default, on_free_path, optimise
from mishutter.search.space import forbids_free_path, mirrors

SAME_MOTION = "same motion"
OWN_BEST_MOTION = "own best motion"
OPEN = "rect"
BEST_TUKEY = "best Tukey"
BEST_SNAPSHOT = "best snapshot"
BEST_PANNED_SNAPSHOT = "best panned snapshot"
BEST_CODED_STILL = "best coded still"
CODED_AT_REST = "best coded at rest"
BEST_BURST = "best burst"
OPEN_ON_FREE_PATH = "open on a free path"
SHAPED_ON_FREE_PATH = "shaped on a free path"
SNAPSHOTS = (BEST_SNAPSHOT, BEST_PANNED_SNAPSHOT)
_RIVALS = (
    BEST_TUKEY,
    OPEN_ON_FREE_PATH,
    SHAPED_ON_FREE_PATH,
    *SNAPSHOTS,
    BEST_CODED_STILL,
    CODED_AT_REST,
    BEST_BURST,
)
_PURCHASES = {
    frozenset[str](): "nothing",
    frozenset({"a stage"}): "a stage",
    frozenset({"a shutter"}): "a shutter",
    frozenset({"a stage", "a shutter"}): "both",
}
_OPEN = 1 - 1e-6
"""Efficiency above which a shutter counts as one that stays open."""
_SAME_LEVEL = 1e-4
"""Difference of levels up to which two searches ended in one place; dB."""
_SLOW_PAN = 0.01
"""Share of the fastest object's speed with which a search for a pan begins."""
_STANDS_STILL = 0.05
"""Travel during the exposure below which a sensor counts as standing still; px."""

Step = Callable[[str], None]
Entry = AbstractShutter | Design


@dataclass(frozen=True)
class Row:
    """One shutter on one motion.

    Attributes:
        reading: `"same motion"` or `"own best motion"`.
        name: Name of the shutter.
        shutter: The profile.
        motion: The motion it is measured on.
        loss: Value of the loss that tuned it; None on the same motion.
        metrics: Its metrics.
        turns: Whether turning the camera makes the pan, and not the stage.
        speed: Knowledge that the judging decoder has of the speed, as `Scene.decoder_speed`.
        num_frames: Frames of the motion's exposure that are added up; 1 but for a burst.
        at_worst: Whether it is judged at the worst speed, and not by the mean over speeds.
        design: The design that a search found; None for the reading *same motion* and for a burst.
    """

    reading: str
    name: str
    shutter: AbstractShutter
    motion: AbstractMotion
    loss: float | None
    metrics: Metrics
    turns: bool = False
    speed: DecoderSpeed = "unknown"
    num_frames: int = 1
    at_worst: bool = False
    design: Design | None = None

    def __repr__(self) -> str:
        """The name and the level; the table has the rest."""
        return f"Row({self.reading!r}, {self.name!r}, {self.level:.2f} dB, {self.setting})"

    @cached_property
    def stroke(self) -> float:
        """Distance from the lowest to the highest position of the stage over the exposure; px.

        It includes the pan, unless turning the camera makes the pan.
        """
        of_stage = self.motion.without_velocity() if self.turns else self.motion
        return float(of_stage.extent)

    @cached_property
    def takes(self) -> frozenset[str]:
        """Parts that are needed in addition to a camera at rest with an ordinary shutter."""
        stays_open = isinstance(self.shutter, RectShutter)
        stays_open = stays_open or float(self.metrics.efficiency) > _OPEN
        takes = {
            "a stage": self.stroke >= _STANDS_STILL,
            "a shutter": not stays_open,
        }
        return frozenset(part for part, is_needed in takes.items() if is_needed)

    @cached_property
    def kind(self) -> tuple[bool, bool]:
        """Whether the sensor follows another path than a parabola, and whether a shutter is made.

        Of rows that take the same parts, one of a lesser kind is plainer.
        """
        return not self.motion.accelerates_constantly, not isinstance(self.shutter, RectShutter)

    def is_plainer_than(self, other: "Row") -> bool:
        """Whether it takes fewer of the other's parts, or the same parts of a plainer kind."""
        same = self.takes == other.takes
        return self.kind < other.kind if same else self.takes < other.takes

    @property
    def level(self) -> float:
        """Expected PSNR that judges it, within the tolerances of a scene that has any; dB."""
        return self.psnr if self.within is None else self.within

    @property
    def within(self) -> float | None:
        """Expected PSNR within the tolerances of the scene; dB.

        None for a scene without tolerances, and where a decoder that knows the speed, or the worst
        speed, judges: these judge the camera as designed.
        """
        level = self.metrics.toleranced_psnr
        is_mean = self.speed == "unknown" and not self.at_worst
        return float(level) if is_mean and level is not None else None

    @property
    def psnr(self) -> float:
        """Expected PSNR of the camera as designed, by the judging decoder; dB."""
        if self.at_worst:
            return float(self.metrics.worst_speed_psnr)
        return float(self.metrics.psnr_of(self.speed))

    @property
    def hides_speed(self) -> bool:
        """Whether being told the speed would gain something, but looking for it gains nothing."""
        metrics = self.metrics
        untold, told = float(metrics.expected_psnr), float(metrics.known_speed_psnr)
        return float(metrics.found_speed_psnr) <= untold < told

    @property
    def worst_psnr(self) -> float | None:
        """PSNR at the worst speed by the judging decoder; None if it finds the speed; dB."""
        level = self.metrics.worst_psnr_of(self.speed)
        return None if level is None else float(level)

    @property
    def setting(self) -> str:
        """Exposure, pan and stroke of the motion with units; a pan alone is without its stroke."""
        motion = self.motion
        parts = [f"{float(motion.exposure) * 1e3:.3g} ms"]
        if _pans(motion):
            parts.append(f"pan {float(motion.velocity):.0f} px/s")
        if float(motion.stroke) >= _STANDS_STILL:
            parts.append(f"stroke {self.stroke:.3g} px")
        return ", ".join(parts if len(parts) > 1 else [*parts, "at rest"])

    def lead_over(self, other: "Row") -> float:
        """Level above that of another row; 0 over itself, also where it is infinite; dB."""
        return 0.0 if self is other else self.level - other.level


def best_row(rows: Iterable[Row]) -> Row:
    """The row of the highest level, the first of equals."""
    return max(rows, key=lambda row: row.level)


def plainest(rows: Iterable[Row], top: Row, *, within: float) -> Row:
    """The plainest row of those that are about as good as one: that one, or a plainer row.

    Fewer parts come first, then a parabola before a free path, then an ordinary shutter before a
    made one, and then the level.

    Args:
        rows: Rows to choose from.
        top: The one that they are compared with.
        within: Level below the top from which on a row is not as good; dB.
    """
    plainer = [row for row in rows if row.is_plainer_than(top) and top.lead_over(row) < within]
    return min([*plainer, top], key=lambda row: (len(row.takes), row.kind, -row.level))


def best_of_each_purchase(rows: Iterable[Row]) -> dict[str, Row]:
    """The best row of each purchase, the simplest first; no burst, which is another camera.

    The best row of a purchase is the best of all rows that need no more parts, and the plainest of
    equals: whoever has bought more may use less of it.

    Args:
        rows: Rows of both readings; only those at their own best motion count.
    """
    rows = [row for row in rows if row.reading == OWN_BEST_MOTION and row.name != BEST_BURST]
    return {
        name: plainest(enough, best_row(enough), within=_SAME_LEVEL)
        for parts, name in _PURCHASES.items()
        for enough in [[row for row in rows if row.takes <= parts]]
        if any(row.takes == parts for row in enough)
    }


def taken_names() -> tuple[str, ...]:
    """Names of the rows that a comparison adds by itself."""
    return (*baselines(), *_RIVALS)


def may_be_named(entry: Entry, name: str) -> bool:
    """Whether a name is free, or that of a baseline with the same shutter."""
    return name not in taken_names() or _are_equal(baselines().get(name), entry)


class RivalSearch(NamedTuple):
    """Settings of the searches of one comparison.

    Attributes:
        scene: Speeds, light, noise and limits.
        loss: The loss that tunes every design; it depends on how much light an exposure brings.
        plan: The plan of the computation: one for each search, or None for everything.
    """

    scene: Scene
    loss: AbstractLoss
    plan: Plan | Automatic | None = PLANNED

    def best(
        self,
        start: AbstractMotion,
        shutter: AbstractShutter | None = None,
        free: Iterable[str] | None = None,
    ) -> Design:
        """The best design from a motion and a shutter, or from a free-form profile."""
        return optimise(self.scene, start, shutter, free=free, loss=self.loss, plan=self.plan)


def compared_rows(
    search: RivalSearch, motion: AbstractMotion, entries: Mapping[str, Entry], step: Step
) -> list[Row]:
    """Measures shutters, baselines and rivals at their own best motions, and on one motion.

    Args:
        search: The scene, loss and plan of the searches.
        motion: Motion of the second reading, and the start of the first.
        entries: Profiles and designs to compare with the baselines, by name.
        step: Called with the name of each row when its own best motion is known.

    Returns:
        The rows at their own best motion, then those on the same motion.
    """
    scene, loss, plan = search
    windows = {name: window for name, window in baselines().items() if name not in entries}
    entries = {**entries, **windows}
    commands = {n: e.command if isinstance(e, Design) else e for n, e in entries.items()}
    shutters = {name: transmittance(scene, motion, each) for name, each in commands.items()}
    measure, turns = partial(evaluate, scene, motion, plan=plan), _turns(scene)
    on_motion = [
        Row(SAME_MOTION, name, shutter, motion, None, measure(shutter), turns)
        for name, shutter in shutters.items()
    ]
    # The longest search begins first.
    start = _searchable(motion, scene)
    searches = [
        lambda: _free_profiles(search, start, entries),
        lambda: [_row(BEST_TUKEY, search.best(start, TukeyShutter(0.5)))],
        *(
            partial(_own_best, search, start, name, entry)
            for name, entry in entries.items()
            if name != OPEN
        ),
        lambda: snapshots(search),
        lambda: _bursts(scene),
    ]
    speed = loss.decoder_speed or scene.decoder_speed
    judge = partial(replace, speed=speed, at_worst=loss.of_worst_speed)
    at_best = {}
    for rows in filter(None, as_they_end(searches, num_processors())):
        step(rows[0].name)
        at_best |= {row.name: row if row.name == BEST_BURST else judge(row) for row in rows}
    names = [name for name in (*shutters, *_RIVALS) if name in at_best]
    return [*(at_best[name] for name in names), *map(judge, on_motion)]


def _searchable(motion: AbstractMotion, scene: Scene) -> AbstractMotion:
    """The motion that searches begin with: this one, the scene's, or the fullest parabola."""
    for start in (motion, scene.motion):
        if start.accelerates_constantly and not start.is_straight:
            return start
    return scene.motion if scene.motion.accelerates_constantly else scene.fullest_motion


def _middle_exposure(scene: Scene) -> Float[np.ndarray, ""]:
    limits = scene.limits
    low, high = (np.asarray(x) for x in (limits.min_half_exposure, limits.max_half_exposure))
    return np.asarray(np.sqrt(low * high))


def _camera_at_rest(scene: Scene) -> StillCamera:
    return StillCamera(half_exposure=_middle_exposure(scene))


def _unaccelerated(scene: Scene) -> LinearMotion:
    """A sensor at the velocity in the middle of the speeds, as far as it may pan.

    Where that is 0 and more speeds are to one side, a search begins with a slow pan: a motion
    without a pan would be a camera at rest, which stays at rest.
    """
    velocity = scene.fullest_motion.velocity
    if float(velocity) == 0 and not mirrors(scene, 0.0):
        velocity = np.asarray(_SLOW_PAN * float(min(scene.max_speed, scene.limits.max_pan)))
    return LinearMotion(half_exposure=_middle_exposure(scene), velocity=velocity)


def snapshots(search: RivalSearch) -> list[Row]:
    """Searches for the best snapshots: at rest and, where the limits allow a pan, panned."""
    scene = search.scene
    at_rest = _best_snapshot(search)
    if float(scene.limits.max_pan) <= 0:
        return [at_rest]
    pan = _unaccelerated(scene)
    if float(pan.velocity) == 0:
        return [at_rest, replace(at_rest, name=BEST_PANNED_SNAPSHOT)]
    return [at_rest, _row(BEST_PANNED_SNAPSHOT, search.best(pan, RectShutter()))]


def _best_snapshot(search: RivalSearch) -> Row:
    """Searches for the exposure of a camera at rest with an ordinary shutter."""
    still = _camera_at_rest(search.scene)
    if search.plan is PLANNED:
        search = search._replace(plan=_roomy_plan(search.scene, still, search.loss))
    return _row(BEST_SNAPSHOT, search.best(still, RectShutter()))


def _roomy_plan(scene: Scene, still: StillCamera, loss: AbstractLoss) -> Plan:
    """The plan of a camera at rest, in the sizes of a moving one: one program serves both."""
    shutter = RectShutter()
    plan = plan_of_scene(scene, still, shutter, loss=loss, free="half_exposure")
    start = scene.motion
    if start.is_straight:
        return plan
    free = free_by_default(scene, start, shutter)
    moving = plan_of_scene(scene, start, shutter, loss=loss, free=free)
    finer = max(plan, moving, key=lambda each: each.num_frequencies)
    return replace(
        plan,
        num_taps=max(plan.num_taps, moving.num_taps),
        dft_length=max(plan.dft_length, moving.dft_length),
        num_nodes=max(plan.num_nodes, moving.num_nodes),
        num_frequencies=finer.num_frequencies,
        num_kept=finer.num_kept,
        folds=plan.folds and moving.folds,
    )


def _free_profiles(
    search: RivalSearch, start: AbstractMotion, entries: Mapping[str, Entry]
) -> list[Row]:
    """Searches that begin with one another's designs: coded stills, open shutters, free paths.

    Free paths have rows where the stage may take one.
    """
    scene, loss, plan = search
    shutter = RectShutter()
    free = free_by_default(scene, start, shutter)
    takes_path = "acceleration" in free and not forbids_free_path(scene)
    shaped = _best_of_entries(search, entries)
    if shaped is None and takes_path:
        shaped = search.best(start)
    rows = _coded_stills(search, shaped)
    steady = search.best(start, shutter, free)
    rows.append(_row(OPEN, steady))
    if takes_path and shaped is not None:
        on_path = on_free_path(steady, start, loss=loss, plan=plan)
        beside = [design for design in (steady, on_path) if not design.motion.is_straight]
        best = on_free_path(shaped, start, loss=loss, shaped=True, beside=beside, plan=plan)
        rows += [_row(OPEN_ON_FREE_PATH, on_path), _row(SHAPED_ON_FREE_PATH, best)]
    return rows


def _best_of_entries(search: RivalSearch, entries: Mapping[str, Entry]) -> Design | None:
    """The best design of a free profile on a parabola, where it is one of the entries."""
    for entry in entries.values():
        if isinstance(entry, Design) and is_finished(entry, search.scene, search.loss):
            if isinstance(entry.command, SplineShutter) and entry.straight is not None:
                return entry
    return None


def _coded_stills(search: RivalSearch, shaped: Design | None) -> list[Row]:
    """The best free profile without acceleration, and where that pans the best at rest.

    Args:
        search: The scene, loss and plan of the searches.
        shaped: The best design of a free profile, which holds the best one without acceleration.
    """
    scene = search.scene
    best = None if shaped is None else shaped.straight
    if best is None:
        best = search.best(_unaccelerated(scene))
    rows = [_row(BEST_CODED_STILL, best)]
    if not _pans(best.motion):
        return rows
    return [*rows, _row(CODED_AT_REST, search.best(_camera_at_rest(scene)))]


def _own_best(search: RivalSearch, start: AbstractMotion, name: str, entry: Entry) -> list[Row]:
    """Searches for an entry's own best motion, unless it is a design that has it."""
    if isinstance(entry, Design) and is_finished(entry, search.scene, search.loss):
        return [_row(name, entry)]
    shutter = entry.shutter if isinstance(entry, Design) else entry
    if isinstance(entry, Design) and entry.motion.accelerates_constantly:
        start = entry.motion
    parts = free_by_default(search.scene, start, shutter)
    return [_row(name, search.best(start, shutter, [part for part in parts if part != "shutter"]))]


def _bursts(scene: Scene) -> list[Row]:
    """The best burst of a camera that takes any, by a decoder that is told the speed."""
    burst = best_burst(scene)
    if burst is None:
        return []
    shutter = RectShutter()
    metrics = evaluate(burst.scene, burst.motion, shutter)
    row = Row(OWN_BEST_MOTION, BEST_BURST, shutter, burst.motion, None, metrics)
    return [replace(row, speed="told", turns=_turns(scene), num_frames=burst.num_frames)]


def is_finished(design: Design, scene: Scene, loss: AbstractLoss) -> bool:
    """Whether a design is the result of a search of this scene by this loss, or is to stay."""
    if design.loss_name == GIVEN:
        return True
    is_of_scene = _are_equal(design.scene.bare(), scene.bare())
    return is_of_scene and design.loss_name == repr(loss)


def _are_equal(first: PyTree, second: PyTree) -> bool:
    """Whether two trees are equal. The host compares them: JAX would compile for each shape."""

    def on_host(leaf: object) -> object:
        return np.asarray(leaf) if eqx.is_array(leaf) else leaf

    return bool(eqx.tree_equal(*jax.tree.map(on_host, (first, second))))


def _row(name: str, design: Design) -> Row:
    shutter, motion = design.shutter, design.motion
    turns = _turns(design.scene)
    loss, metrics = design.loss, design.metrics
    return Row(OWN_BEST_MOTION, name, shutter, motion, loss, metrics, turns, design=design)


def _turns(scene: Scene) -> bool:
    """Whether the camera is turned to pan."""
    return scene.limits.pans == "camera"


def _pans(motion: AbstractMotion) -> bool:
    """Whether the pan of a sensor is more than counts as standing still."""
    return abs(float(motion.velocity)) * float(motion.exposure) >= _STANDS_STILL
