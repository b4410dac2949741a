"""A design beside its baselines, and the verdict for a scene."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import equinox as eqx
import jax
import numpy as np

from mishutter._core import (
    alone_in_blas,
    as_numpy,
    in_threads,
    named,
    num_processors,
    outside_trace,
    require,
    require_known,
)
from mishutter.evaluation import (
    PLANNED,
    AbstractLoss,
    Automatic,
    Metrics,
    Plan,
    ToleranceCosts,
    as_loss,
    best_burst,
    ceiling,
    evaluate,
    loss_of_decoder,
    tolerance_costs,
)
from mishutter.hardware import GIVEN, Design, metrics_to_dict, motion_to_dict
from mishutter.model import (
    AbstractMotion,
    AbstractShutter,
    DecoderSpeed,
    FirstOrderShutter,
    FreeMotion,
    LinearMotion,
    RectShutter,
    Scene,
    SplineShutter,
    StillCamera,
    TukeyShutter,
    baselines,
    command_of,
    is_straight,
    require_scene,
    settled,
    without_velocity,
)
from mishutter.search.planning import plan as planned
from mishutter.search.search import free_by_default, on_free_path, optimise
from mishutter.search.space import beyond_limits, forbids_free_path, mirrors

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
_RIVALS = (
    BEST_TUKEY,
    OPEN_ON_FREE_PATH,
    SHAPED_ON_FREE_PATH,
    BEST_SNAPSHOT,
    BEST_PANNED_SNAPSHOT,
    BEST_CODED_STILL,
    CODED_AT_REST,
    BEST_BURST,
)
_SNAPSHOTS = (BEST_SNAPSHOT, BEST_PANNED_SNAPSHOT)
_WORTH_IT = 0.1
"""Gain over an ordinary snapshot below which a coded camera is not worth building; dB."""
_OPEN = 1 - 1e-6
"""Efficiency above which a profile is that of a shutter that stays open."""
_SAME_LEVEL = 1e-4
"""Difference of levels up to which two searches ended in one place; dB."""
_SLOW_PAN = 0.01
"""Of the fastest object, with which a search for a pan begins."""
_TELLING = 0.005
"""Gain that a verdict tells; dB."""
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
        loss: The loss that tuned it; None where none was given.
        metrics: Its metrics.
        turns: Whether turning the camera makes the pan, and not the stage.
        speed: What the decoder that judges it knows of the speed, as `Scene.decoder_speed`.
        num_frames: Frames of the motion's exposure that are added up; 1 of all but a burst.
        at_worst: Whether it is judged at the worst speed, and not by the mean over speeds.
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

    def __repr__(self) -> str:
        """Name and level, of which the table has the rest."""
        return f"Row({self.reading!r}, {self.name!r}, {self.level:.2f} dB, {_how(self.motion)})"

    @cached_property
    def takes(self) -> frozenset[str]:
        """What a camera at rest with an ordinary shutter lacks for it: a stage, a shutter, both."""
        of_stage = without_velocity(self.motion) if self.turns else self.motion
        stays_open = isinstance(self.shutter, RectShutter)
        stays_open = stays_open or float(self.shutter.efficiency()) > _OPEN
        takes = {
            "a stage": float(of_stage.extent) >= _STANDS_STILL,
            "a shutter": not stays_open,
        }
        return frozenset(part for part, needed in takes.items() if needed)

    @property
    def level(self) -> float:
        """Expected PSNR that it is judged by: within the tolerances of a scene with any; dB.

        That of a decoder which knows of the speed, and that at the worst speed, is of a camera as
        designed.
        """
        within = self.metrics.toleranced_psnr
        is_mean = self.speed == "unknown" and not self.at_worst
        return float(within) if is_mean and within is not None else self.psnr

    @property
    def psnr(self) -> float:
        """Expected PSNR of the camera as designed, by the decoder that it is judged by; dB."""
        if self.at_worst:
            return float(self.metrics.worst_speed_psnr)
        return float(self.metrics.psnr_of(self.speed))


@dataclass(frozen=True)
class Comparison:
    """Shutters side by side.

    Attributes:
        rows: One a shutter and reading.
        verdict: What to build for this scene or to use instead; on a second line how far physics
            would let any camera go; and where there is one a line on a better camera than that,
            and one on the nearest simpler.
        gain: Gain of the best design that was given, or of the best coded camera, over the best
            snapshot, panned where that is allowed, both within the scene's tolerances; dB,
            negative where the snapshot is better.
        ceiling: Expected PSNR that no camera exceeds; dB. Speeds in equal steps stand for those
            between them, unless a design exceeds the ceiling of these by dwelling at the listed.
        notes: Sentences for the foot of the tables: the light that the shutter loses, and what a
            burst would reach.
        costs: What each tolerance costs the best design; None for a scene without.
    """

    rows: tuple[Row, ...]
    verdict: str
    gain: float
    ceiling: float
    notes: tuple[str, ...] = ()
    costs: ToleranceCosts | None = None

    def __repr__(self) -> str:
        """The number of rows and the first line of the verdict; `str` is the `text`."""
        return f"Comparison({len(self.rows)} rows: {self.verdict.splitlines()[0]})"

    def __str__(self) -> str:
        return self.text()

    @property
    def rivals(self) -> dict[str, Row]:
        """The best row of each purchase, the simplest first; bursts take another camera.

        Whoever has bought more may use less of it: the best of a purchase is among all rows that
        take no more.
        """
        rows = [r for r in self.rows if r.reading == OWN_BEST_MOTION and r.name != BEST_BURST]
        return {
            name: _plainest([row for row in rows if row.takes <= kind])
            for kind, name in _PURCHASES.items()
            if any(row.takes == kind for row in rows)
        }

    @property
    def snapshot(self) -> Row:
        """The best snapshot that the scene allows, which gains are over."""
        rows = (row for row in self.rows if row.reading == OWN_BEST_MOTION)
        return _best([row for row in rows if row.name in _SNAPSHOTS])

    def over_snapshot(self, level: float) -> float:
        """Gain of an expected PSNR over that of the best snapshot that the scene allows; dB."""
        snapshot = _level(self.snapshot)
        return 0.0 if level == snapshot else level - snapshot

    def row(self, name: str, reading: str = OWN_BEST_MOTION) -> Row:
        """The row of a shutter in a reading.

        Raises:
            ValueError: if there is none.
        """
        for row in self.rows:
            if (row.name, row.reading) == (name, reading):
                return row
        names = ", ".join(sorted({row.name for row in self.rows}))
        raise ValueError(f"`Comparison.row(name=...)` must be one of {names}; got {name!r}.")

    def to_dict(self) -> dict[str, Any]:
        """The table as plain numbers and text."""
        rows = [
            {
                "reading": row.reading,
                "name": row.name,
                "motion": motion_to_dict(row.motion),
                "loss": row.loss,
                "num_frames": row.num_frames,
                "metrics": metrics_to_dict(row.metrics),
            }
            for row in self.rows
        ]
        rivals = {
            takes: {
                "name": row.name,
                "expected_psnr_db": _level(row),
                "over_snapshot_db": self.over_snapshot(_level(row)),
                "motion": motion_to_dict(row.motion),
            }
            for takes, row in self.rivals.items()
        }
        numbers = {"gain_db": self.gain, "ceiling_db": self.ceiling}
        words = {"verdict": self.verdict, "notes": list(self.notes)}
        costs = {} if self.costs is None else {"tolerance_costs": self.costs.to_dict()}
        return {"rows": rows, "rivals": rivals, **words, **numbers, **costs}

    def text(self) -> str:
        """The verdict, the tables and their notes as text."""
        lines = [self.verdict, ""]
        for reading in dict.fromkeys(row.reading for row in self.rows):
            lines += [f"{reading}", _HEADER if self.costs is None else _HEADER + _WITHIN]
            lines += [_line(row) for row in self.rows if row.reading == reading]
            lines.append("")
            if reading == OWN_BEST_MOTION:
                lines.append("what each purchase brings")
                lines += [self._purchase(takes, row) for takes, row in self.rivals.items()]
                lines += [*self.notes, ""]
                lines += [] if self.costs is None else [self.costs.text(), ""]
        return "\n".join(lines[:-1])

    def _purchase(self, takes: str, row: Row) -> str:
        level = _level(row)
        gain = f"{self.over_snapshot(level):+.2f} dB"
        return f"{takes:<10}{row.name:<21}{level:>9.2f} dB, {gain}, {_how(row.motion)}"


@alone_in_blas()
@outside_trace()
def compare(
    scene: Scene,
    motion: AbstractMotion | Design,
    shutters: Mapping[str, Any] | Sequence[Any] | Entry | None = None,
    *,
    loss: AbstractLoss | Callable[..., Any] | None = None,
    step: Step | None = None,
    plan: Plan | Automatic | None = PLANNED,
) -> Comparison:
    r"""Measure shutters beside the baselines, in two readings.

    Every row is judged by the decoder that the scene names, by `KnownSpeedLoss` or
    `FoundSpeedLoss` by one that is told the speed of the picture or finds it, and by
    `WorstSpeedLoss` at the worst of the speeds.

    *Own best motion*: exposure, velocity and acceleration, none included, tuned for each by the
    same loss within the scene's limits, from `motion` or from the motion of a `Design`; a
    `Design` that this loss found for this scene is finished and stays as it is. *Same motion*:
    every shutter on `motion`.

    Rivals beside the windows, tuned alike: the best Tukey, its taper too; the best snapshot, an
    open shutter at rest, and where the sensor may pan the best panned snapshot; the best coded
    still, a free profile without acceleration, and where that pans the best at rest; an open
    shutter and a free profile on the best free path, unless the scene has tolerances or limits the
    jerk of its stage; and the best burst of a scene that has a `Burst`.

    Args:
        scene: Speeds, light, noise and limits.
        motion: Motion of the first reading, and the start of the second; or a design, which
            is compared on its own motion, as "optimised" where no `shutters` are given.
        shutters: Profiles or designs to compare with the baselines, by name. Those of a
            list are "shutter 0" and so on.
        loss: The loss that tunes the motions, or a function of scene, motion and shutter; the
            expected error by default, and where the loss does not see how much light an exposure
            brings.
        step: Called with the name of each shutter when its own best motion is found.
        plan: The parts to compute: a plan is made for each shutter and motion; None computes
            everything.

    Returns:
        The table and the verdict.

    Raises:
        ValueError: if a name is that of a baseline that is not the same shutter, or
            something else than a shutter or a design is given, or JAX traces the scene or the
            motion.
    """
    require_scene(scene)
    if isinstance(motion, Design):
        shutters = {"optimised": motion} if shutters is None else shutters
        motion = motion.motion
    require_known("compare", scene=scene, motion=motion)
    loss = loss_of_decoder(scene) if loss is None else as_loss(loss, "compare(loss=...)")
    step = step or (lambda name: None)
    motion = settled(motion)
    plan = PLANNED if isinstance(plan, Plan) else plan
    loss = loss if loss.sees_light else loss_of_decoder(scene)
    given = _given(shutters) if shutters else {}
    for name, entry in given.items():
        _require_own_name(name, entry)
    entries = given | {name: window for name, window in baselines().items() if name not in given}
    commands = {n: e.command if isinstance(e, Design) else e for n, e in entries.items()}
    fixed = {name: scene.light(command, motion) for name, command in commands.items()}
    measured = partial(evaluate, scene, motion, plan=plan)
    rows = [
        Row(
            SAME_MOTION,
            name,
            shutter,
            motion,
            None,
            measured(shutter),
            _turns(scene),
        )
        for name, shutter in fixed.items()
    ]
    # The longest search is begun first, and the others go on beside it.
    start = _searchable(motion, scene)
    searches = [
        lambda: _free_profiles(scene, start, entries, loss, plan),
        lambda: [_row(BEST_TUKEY, optimise(scene, start, TukeyShutter(0.5), loss=loss, plan=plan))],
        *(
            partial(_own_best, name, entry, scene, start, loss, plan)
            for name, entry in entries.items()
            if name != OPEN
        ),
        lambda: _snapshots(scene, loss, plan),
        lambda: _bursts(scene),
    ]
    at_best = {}
    speed = loss.decoder_speed or scene.decoder_speed
    judged = partial(replace, speed=speed, at_worst=loss.of_worst_speed)
    found = in_threads(lambda search: search(), searches, num_processors(), first_alone=False)
    for some in filter(None, found):
        step(some[0].name)
        some = [row if row.name == BEST_BURST else judged(row) for row in some]
        at_best |= {row.name: row for row in some}
    names = [name for name in (*fixed, *_RIVALS) if name in at_best]
    rows = [judged(row) for row in rows]
    return _with_verdict([at_best[name] for name in names] + rows, given, scene)


def _searchable(motion: AbstractMotion, scene: Scene) -> AbstractMotion:
    """The motion that others are found from: given, of the scene, or the fullest parabola."""
    for start in (motion, scene.motion):
        if not isinstance(start, FreeMotion) and not is_straight(start):
            return start
    return scene.fullest_motion if isinstance(scene.motion, FreeMotion) else scene.motion


def _given(shutters: object) -> dict[str, Entry]:
    kinds, what = (AbstractShutter, Design), "shutter or design"
    return named("compare(shutters=...)", shutters, kinds, what, label="shutter ")


def taken_names() -> tuple[str, ...]:
    """Names of rows that a comparison may have of itself."""
    return (*baselines(), *_RIVALS)


def _require_own_name(name: str, entry: AbstractShutter | Design) -> None:
    same = _are_equal(baselines().get(name), entry)
    requirement = f"call no other shutter one of {', '.join(taken_names())}"
    require(same or name not in taken_names(), "compare(shutters=...)", requirement, name)


def best_snapshot(scene: Scene, loss: AbstractLoss, plan: Plan | Automatic | None = PLANNED) -> Row:
    """A camera at rest with an ordinary shutter, its exposure tuned by the loss."""
    still = StillCamera(half_exposure=_middle_exposure(scene))
    if plan is PLANNED:
        plan = _roomy_plan(scene, still, loss)
    return _row(BEST_SNAPSHOT, optimise(scene, still, RectShutter(), loss=loss, plan=plan))


def _middle_exposure(scene: Scene) -> np.ndarray:
    low, high = as_numpy(scene.limits.min_half_exposure, scene.limits.max_half_exposure)
    return np.asarray(np.sqrt(low * high))


def _unaccelerated(scene: Scene) -> LinearMotion:
    """A sensor at the velocity in the middle of the speeds, as far as it may pan.

    Where that is 0 and more of them are to one side, a search begins with a slow pan: a motion
    without any is a camera at rest, which stays there.
    """
    velocity = scene.fullest_motion.velocity
    if float(velocity) == 0 and not mirrors(scene, 0.0):
        velocity = np.asarray(_SLOW_PAN * float(min(scene.max_speed, scene.limits.max_pan)))
    return LinearMotion(half_exposure=_middle_exposure(scene), velocity=velocity)


def _may_pan(scene: Scene) -> bool:
    return float(scene.limits.max_pan) > 0


def _snapshots(scene: Scene, loss: AbstractLoss, plan: Plan | Automatic | None) -> list[Row]:
    """The best snapshots at rest and, where that is allowed, panned."""
    at_rest = best_snapshot(scene, loss, plan)
    if not _may_pan(scene):
        return [at_rest]
    pan = _unaccelerated(scene)
    if float(pan.velocity) == 0 and "velocity" not in free_by_default(scene, pan, RectShutter()):
        return [at_rest, replace(at_rest, name=BEST_PANNED_SNAPSHOT)]
    found = optimise(scene, pan, RectShutter(), loss=loss, plan=plan)
    return [at_rest, _row(BEST_PANNED_SNAPSHOT, found)]


def _free_profiles(
    scene: Scene,
    motion: AbstractMotion,
    entries: Mapping[str, Entry],
    loss: AbstractLoss,
    plan: Plan | Automatic | None,
) -> list[Row]:
    """Rows of which one begins with another: coded stills, open shutters, and both on a free path.

    A free path has rows where the stage may take one.
    """
    shutter = RectShutter()
    free = free_by_default(scene, motion, shutter)
    takes_path = "acceleration" in free and not forbids_free_path(scene)
    shaped = _known_profile(scene, entries, loss)
    if shaped is None and takes_path:
        shaped = optimise(scene, motion, loss=loss, plan=plan)
    rows = _coded_stills(scene, shaped, loss, plan)
    steady = optimise(scene, motion, shutter, free=free, loss=loss, plan=plan)
    rows.append(_row(OPEN, steady))
    if takes_path and shaped is not None:
        on_path = on_free_path(steady, motion, loss=loss, plan=plan)
        beside = [design for design in (steady, on_path) if not is_straight(design.motion)]
        best = on_free_path(shaped, motion, loss=loss, shaped=True, beside=beside, plan=plan)
        rows += [_row(OPEN_ON_FREE_PATH, on_path), _row(SHAPED_ON_FREE_PATH, best)]
    return rows


def _bursts(scene: Scene) -> list[Row]:
    """The best burst of a camera that takes any, by a decoder that is told the speed."""
    burst = best_burst(scene)
    if burst is None:
        return []
    measured = evaluate(burst.scene, burst.motion, RectShutter())
    motion = settled(burst.motion)
    row = Row(OWN_BEST_MOTION, BEST_BURST, RectShutter(), motion, None, measured, speed="told")
    return [replace(row, turns=_turns(scene), num_frames=burst.num_frames)]


def _coded_stills(
    scene: Scene, shaped: Design | None, loss: AbstractLoss, plan: Plan | Automatic | None
) -> list[Row]:
    """The best free profile without acceleration, and where that pans the best at rest."""
    best = None if shaped is None else shaped.straight
    if best is None:
        best = optimise(scene, _unaccelerated(scene), loss=loss, plan=plan)
    rows = [_row(BEST_CODED_STILL, best)]
    if not _pans(best.motion):
        return rows
    still = StillCamera(half_exposure=_middle_exposure(scene))
    return [*rows, _row(CODED_AT_REST, optimise(scene, still, loss=loss, plan=plan))]


def _known_profile(scene: Scene, entries: Mapping[str, Entry], loss: AbstractLoss) -> Design | None:
    """The best design of a free profile and a parabola, where it is one of those given."""
    for entry in entries.values():
        if isinstance(entry, Design) and _is_finished(entry, scene, loss):
            if isinstance(entry.command, SplineShutter) and entry.straight is not None:
                return entry
    return None


def _roomy_plan(scene: Scene, still: StillCamera, loss: AbstractLoss) -> Plan:
    """The plan of a camera at rest, in the sizes of a moving one: one program serves both."""
    shutter = RectShutter()
    plan = planned(scene, still, shutter, loss=loss, free="half_exposure")
    start = scene.motion
    if is_straight(start):
        return plan
    moving = planned(scene, start, shutter, loss=loss, free=free_by_default(scene, start, shutter))
    sizes = ("num_taps", "dft_length", "num_nodes")
    room = {name: max(getattr(plan, name), getattr(moving, name)) for name in sizes}
    finer = max(plan, moving, key=lambda each: each.num_frequencies)
    return replace(
        plan,
        **room,
        num_frequencies=finer.num_frequencies,
        num_kept=finer.num_kept,
        folds=plan.folds and moving.folds,
    )


def _own_best(
    name: str,
    entry: AbstractShutter | Design,
    scene: Scene,
    motion: AbstractMotion,
    loss: AbstractLoss,
    plan: Plan | Automatic | None,
) -> list[Row]:
    if isinstance(entry, Design) and _is_finished(entry, scene, loss):
        return [_row(name, entry)]
    shutter, start = (entry.shutter, entry.motion) if isinstance(entry, Design) else (entry, motion)
    start = motion if isinstance(start, FreeMotion) else start
    free = [part for part in free_by_default(scene, start, shutter) if part != "shutter"]
    return [_row(name, optimise(scene, start, shutter, free=free, loss=loss, plan=plan))]


def _is_finished(design: Design, scene: Scene, loss: AbstractLoss) -> bool:
    """Whether a design was found for this scene by this loss, or is given as it is."""
    if design.loss_name == GIVEN:
        return True
    same_scene = _are_equal(design.scene.bare(), scene.bare())
    return same_scene and design.loss_name == repr(loss)


def _are_equal(first: Any, second: Any) -> bool:
    """Whether two trees are, compared on the host: on the device each shape has a program."""

    def on_host(leaf: Any) -> Any:
        return np.asarray(leaf) if eqx.is_array(leaf) else leaf

    return bool(eqx.tree_equal(*jax.tree.map(on_host, (first, second))))


def _row(name: str, design: Design) -> Row:
    shutter, motion = design.shutter, design.motion
    turns = _turns(design.scene)
    return Row(OWN_BEST_MOTION, name, shutter, motion, design.loss, design.metrics, turns)


def _turns(scene: Scene) -> bool:
    """Whether the camera is turned to pan."""
    return scene.limits.pans == "camera"


_NO_DETAIL = "This scene's picture holds no detail: there is nothing to restore or to gain."


def _with_verdict(rows: list[Row], given: Mapping[str, Entry], scene: Scene) -> Comparison:
    at_best = {row.name: row for row in rows if row.reading == OWN_BEST_MOTION}
    burst = at_best.pop(BEST_BURST, None)
    snapshot = _best([at_best[name] for name in _SNAPSHOTS if name in at_best])
    notes = (
        *_of_device(scene),
        *_of_blind_drives(given),
        *_of_limits(scene, at_best.values()),
        *(() if burst is None else (_of_burst(burst),)),
    )
    if np.isposinf(_level(snapshot)):
        return Comparison(tuple(rows), _NO_DETAIL, 0.0, np.inf, notes)
    coded = [row for row in at_best.values() if row.name not in _SNAPSHOTS]
    best = _best([row for row in coded if row.name in given] or coded)
    most = float(ceiling(scene))
    if most < max(map(_level, coded)):  # by dwelling at the speeds that are listed
        most = float(ceiling(scene, continuous=False))
    chosen_from, named = list(at_best.values()), best if best.name in given else None
    lines = _verdict(chosen_from, named, snapshot, most)
    costs = None
    if scene.tolerances is not None:
        costs = tolerance_costs(scene, best.motion, best.shutter)
    gain = _level(best) - _level(snapshot)
    return Comparison(tuple(rows), "\n".join(lines), gain, most, notes, costs)


def _verdict(rows: Sequence[Row], given: Row | None, snapshot: Row, most: float) -> list[str]:
    """What to build, the ceiling, and what stands beside it.

    Args:
        rows: The rows at their own best motions, without a burst.
        given: The best of those that were given; None without any.
        snapshot: The best snapshot.
        most: The ceiling; dB.
    """
    chosen = _to_build(rows, given, snapshot)
    beside = _beside(rows, chosen, given)
    at_worst = " at the worst speed" if chosen.at_worst else ""
    if chosen.name in _SNAPSHOTS:
        return [
            "Do not build a coded camera for this scene: nothing beats a snapshot by "
            f"{_WORTH_IT} dB.",
            f"Use an ordinary shutter: {_how(chosen.motion)}, {_level(chosen):.2f} dB{at_worst}. "
            f"Ceiling: {most:.2f} dB.",
            *beside,
        ]
    if given is not None and chosen.takes < given.takes:
        return [
            f"Do not build {given.name} for this scene: {chosen.name} has {_level(chosen):.2f} dB.",
            f"It takes {_named(chosen.takes)}: {_how(chosen.motion)}. Ceiling: {most:.2f} dB.",
            *beside,
        ]
    below = max(most - _level(chosen), 0.0)
    return [
        f"Build {chosen.name}: {_level(chosen):.2f} dB{at_worst}, {_lead(chosen, snapshot):.2f} dB "
        f"above the {snapshot.name}.",
        f"It is {below:.2f} dB below what any path and any shutter could reach ({most:.2f} dB).",
        *beside,
    ]


def _to_build(rows: Sequence[Row], given: Row | None, snapshot: Row) -> Row:
    """The row to build: about as good as the best, and with less where some row is.

    What is given goes before others that are as good and take as much, and where it pays before
    a profile on a free path, which asks more of a stage. A coded camera that is worth building is
    better than the best snapshot by as much as that counts for.
    """
    top = _best(rows)
    if given is not None and _lead(given, snapshot) >= _WORTH_IT:
        top = _best([row for row in rows if row.name != SHAPED_ON_FREE_PATH])
    if _lead(top, snapshot) < _WORTH_IT:
        return snapshot
    if given is not None and given.takes <= top.takes:
        if _lead(top, given) < _WORTH_IT <= _lead(given, snapshot):
            top = given
    about = [row for row in rows if row.takes < top.takes and _lead(top, row) < _WORTH_IT]
    worth = [row for row in about if _lead(row, snapshot) >= _WORTH_IT]
    return min([*worth, top], key=lambda row: (len(row.takes), -_level(row)))


def _beside(rows: Sequence[Row], chosen: Row, given: Row | None) -> list[str]:
    """Sentences on a better camera than the one to build, and on the nearest simpler one."""
    lines, top = [], _best(rows)
    if chosen.speed != "unknown" and chosen.takes == {"a stage"}:
        knows = "finds" if chosen.speed == "found" else "is told"
        lines.append(f"A stage and a decoder that {knows} the speed: no shutter is needed.")
    is_other = given is not None and given is not chosen and chosen.name not in _SNAPSHOTS
    if given is not None and is_other and given.takes == chosen.takes:
        lines.append(f"{_beginning(given.name)} takes as much and has {_level(given):.2f} dB.")
    if _lead(top, chosen) >= _TELLING:
        more = top.takes - chosen.takes
        lines.append(
            f"{_beginning(top.name)} has {_level(top):.2f} dB"
            f"{f' with {_named(more)} too' if more else ''}: {_lead(top, chosen):.2f} more."
        )
    simpler = [row for row in rows if row is not given and _is_simpler(row, chosen)]
    if simpler and chosen.name not in _SNAPSHOTS:
        nearest = _best(simpler)
        below = _lead(chosen, nearest)
        side = f"{abs(below):.2f} dB {'below' if below >= 0 else 'above'} it"
        lines.append(f"The nearest simpler camera, {nearest.name}, is {side}.")
    return lines


def _named(takes: frozenset[str]) -> str:
    """What a row takes, in words."""
    return " and ".join(sorted(takes, reverse=True)) or "neither stage nor shutter"


def _beginning(name: str) -> str:
    """A name at the beginning of a sentence; one that somebody has given stays as it is."""
    return f"{name[0].upper()}{name[1:]}" if name in (*_RIVALS, *baselines(), "optimised") else name


def _is_simpler(row: Row, chosen: Row) -> bool:
    """Whether a row takes less, or as much with a fixed kind of profile for a free one."""
    if row.takes < chosen.takes:
        return True
    is_free = "a shutter" in chosen.takes and isinstance(command_of(chosen.shutter), SplineShutter)
    is_fixed = not isinstance(command_of(row.shutter), SplineShutter)
    return row.takes == chosen.takes and is_free and is_fixed


def _lead(row: Row, other: Row) -> float:
    """By how much one row is better than another; dB."""
    return 0.0 if row is other else _level(row) - _level(other)


_PURCHASES = {
    frozenset[str](): "nothing",
    frozenset({"a stage"}): "a stage",
    frozenset({"a shutter"}): "a shutter",
    frozenset({"a stage", "a shutter"}): "both",
}


def _of_device(scene: Scene) -> tuple[str, ...]:
    device, notes = scene.device, []
    if device is None:
        return ()
    t, closed = float(device.transmission), float(device.transmission * device.leakage)
    if t != 1 or closed != 0:
        notes.append(
            f"The shutter passes {t:.1%} of the light when open, {closed:.2%} when closed."
        )
    if isinstance(device, FirstOrderShutter):
        rise, fall = (float(x) * 1e3 for x in (device.rise_time, device.fall_time))
        notes.append(f"It rises from 10 to 90 % in {rise:.3g} ms and falls in {fall:.3g} ms.")
    if device.num_slots is not None:
        levels = "any level" if device.levels is None else f"one of {device.levels} levels"
        notes.append(f"It holds {levels} over each of {device.num_slots} slots.")
    return tuple(notes)


def _of_blind_drives(given: Mapping[str, Entry]) -> tuple[str, ...]:
    levels = [entry.blind_psnr for entry in given.values() if isinstance(entry, Design)]
    return tuple(
        f"Sent blindly, the design for a device that follows at once has {level:.2f} dB."
        for level in dict.fromkeys(levels)
        if level is not None
    )


def _of_limits(scene: Scene, rows: Iterable[Row]) -> tuple[str, ...]:
    """What rows exceed of the scene's limits, as cameras that are given as built may."""
    notes = []
    for row in rows:
        beyond = beyond_limits(scene, row.motion, row.shutter)
        names = ", ".join(name.replace("_", " ") for name in beyond)
        notes += [f"{row.name} is outside the scene's limits: {names}."] if beyond else []
    return tuple(notes)


def _of_burst(row: Row) -> str:
    return (
        f"A burst of {row.num_frames} frames of {_milliseconds(row.motion)}, aligned perfectly at "
        f"no cost, reaches {_level(row):.2f} dB."
    )


def _best(rows: Sequence[Row]) -> Row:
    return max(rows, key=_level)


def _plainest(rows: Sequence[Row]) -> Row:
    """The best row; of equals one with an ordinary shutter."""
    top = _best(rows)
    equals = [row for row in rows if _lead(top, row) < _SAME_LEVEL]
    return next((row for row in equals if isinstance(row.shutter, RectShutter)), top)


def _level(row: Row) -> float:
    return row.level


def _pans(motion: AbstractMotion) -> bool:
    return abs(float(motion.velocity)) * float(motion.exposure) >= _STANDS_STILL


def _how(motion: AbstractMotion) -> str:
    """Exposure, pan and stroke of a motion, in words."""
    parts = [_milliseconds(motion)]
    if _pans(motion):
        parts.append(f"pan {float(motion.velocity):.0f} px/s")
    if float(motion.stroke) >= _STANDS_STILL:
        parts.append(f"stroke {float(motion.stroke):.3g} px")
    return ", ".join(parts if len(parts) > 1 else [*parts, "at rest"])


def _milliseconds(motion: AbstractMotion) -> str:
    return f"{float(motion.exposure) * 1e3:.3g} ms"


_HEADER = (
    f"{'shutter':<21}{'PSNR dB':>9}{'worst speed':>13}{'cond.':>8}{'diff.':>8}{'rel.':>7}"
    f"{'light':>7}{'bound':>7}{'stroke px':>11}{'pan px/s':>10}{'exposure ms':>13}{'loss':>9}"
)
_WITHIN = f"{'within dB':>11}"
"""Expected PSNR within the scene's tolerances."""


def _line(row: Row) -> str:
    m = row.metrics
    loss = "" if row.loss is None else f"{row.loss:.4f}"
    within = "" if m.toleranced_psnr is None else f"{float(m.toleranced_psnr):>11.2f}"
    return (
        f"{row.name:<21}{row.psnr:>9.2f}{float(m.worst_speed_psnr):>13.2f}{float(m.condition_number):>8.2f}"
        f"{float(m.kernel_difference):>8.4f}{float(m.relative_kernel_difference):>7.3f}"
        f"{float(m.efficiency):>7.3f}{float(m.bound_share):>7.3f}"
        f"{float(row.motion.stroke):>11.2f}{float(row.motion.velocity) + 0.0:>10.1f}"
        f"{float(row.motion.exposure) * 1e3:>13.3f}{loss:>9}{within}"
    )
