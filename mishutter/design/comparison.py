"""A design beside its baselines, and the verdict for a scene."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import numpy as np

from mishutter._core import alone_in_blas, in_threads, named, num_processors, require, require_known
from mishutter.design.planning import plan as planned
from mishutter.design.result import Design, metrics_to_dict, motion_to_dict
from mishutter.design.search import optimise
from mishutter.evaluation import (
    PLANNED,
    AbstractLoss,
    Automatic,
    ExpectedErrorLoss,
    Metrics,
    Plan,
    as_loss,
    evaluate,
)
from mishutter.model import (
    AbstractMotion,
    AbstractShutter,
    RectShutter,
    Scene,
    StillCamera,
    TukeyShutter,
    baselines,
    is_straight,
    settled,
)

SAME_MOTION = "same motion"
OWN_BEST_MOTION = "own best motion"
BEST_TUKEY = "best Tukey"
BEST_SNAPSHOT = "best snapshot"

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
    """

    reading: str
    name: str
    shutter: AbstractShutter
    motion: AbstractMotion
    loss: float | None
    metrics: Metrics


@dataclass(frozen=True)
class Comparison:
    """Shutters side by side.

    Attributes:
        rows: One a shutter and reading.
        verdict: A sentence on the gain over the best snapshot for this scene.
        gain: That gain; dB, negative where the snapshot is better.
    """

    rows: tuple[Row, ...]
    verdict: str
    gain: float

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
                "metrics": metrics_to_dict(row.metrics),
            }
            for row in self.rows
        ]
        return {"rows": rows, "verdict": self.verdict, "gain_db": self.gain}

    def text(self) -> str:
        """The table as text, then the verdict."""
        lines = []
        for reading in dict.fromkeys(row.reading for row in self.rows):
            lines += [f"{reading}", _HEADER]
            lines += [_line(row) for row in self.rows if row.reading == reading]
            lines.append("")
        return "\n".join([*lines, self.verdict])


@alone_in_blas()
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

    *Same motion*: every shutter on `motion`. *Own best motion*: acceleration and
    exposure tuned for each by the same loss within the scene's limits, from `motion` or
    from the motion of a `Design`; a `Design` that this loss found for this scene is
    finished and stays as it is. The best Tukey has its taper tuned too; the best
    snapshot is a camera at rest with an open shutter and its exposure tuned.

    Args:
        scene: Speeds, light, noise and limits.
        motion: Motion of the first reading, and the start of the second; or a design, which
            is compared on its own motion, as "optimised" where no `shutters` are given.
        shutters: Profiles or designs to compare with the baselines, by name. Those of a
            list are "shutter 0" and so on.
        loss: The loss that tunes the motions, or a function of scene, motion and shutter; the
            expected error by default.
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
    if isinstance(motion, Design):
        shutters = {"optimised": motion} if shutters is None else shutters
        motion = motion.motion
    require_known("compare", scene=scene, motion=motion)
    loss = ExpectedErrorLoss() if loss is None else as_loss(loss, "compare(loss=...)")
    step = step or (lambda name: None)
    motion = settled(motion)
    plan = PLANNED if isinstance(plan, Plan) else plan
    tuned = partial(_tuned, loss=loss, plan=plan)
    given = _given(shutters) if shutters else {}
    for name, entry in given.items():
        _require_own_name(name, entry)
    entries = given | {name: window for name, window in baselines().items() if name not in given}
    fixed = {n: e.shutter if isinstance(e, Design) else e for n, e in entries.items()}
    measured = partial(evaluate, scene, motion, plan=plan)
    rows = [
        Row(SAME_MOTION, name, shutter, motion, None, measured(shutter))
        for name, shutter in fixed.items()
    ]
    # The longest search is begun first, and the others go on beside it.
    everything = ("shutter", *_MOTION_ONLY)
    tukey = partial(_at_own_best, BEST_TUKEY, scene, motion, TukeyShutter(0.5), everything, tuned)
    searches = [tukey] + [
        partial(_own_best, name, entry, scene, motion, loss, tuned)
        for name, entry in entries.items()
    ]
    searches.append(partial(best_snapshot, scene, loss, plan))
    at_best = {}
    found = in_threads(lambda search: search(), searches, num_processors(), first_alone=False)
    for row in found:
        step(row.name)
        at_best[row.name] = row
    rows += [at_best[name] for name in (*fixed, BEST_TUKEY, BEST_SNAPSHOT)]
    return _with_verdict(rows, tuple(given))


def _given(shutters: object) -> dict[str, Entry]:
    kinds, what = (AbstractShutter, Design), "shutter or design"
    return named("compare(shutters=...)", shutters, kinds, what, label="shutter ")


def taken_names() -> tuple[str, ...]:
    """Names of rows that every comparison has."""
    return (*baselines(), BEST_TUKEY, BEST_SNAPSHOT)


def _require_own_name(name: str, entry: AbstractShutter | Design) -> None:
    same = _are_equal(baselines().get(name), entry)
    requirement = f"call no other shutter one of {', '.join(taken_names())}"
    require(same or name not in taken_names(), "compare(shutters=...)", requirement, name)


def best_snapshot(scene: Scene, loss: AbstractLoss, plan: Plan | Automatic | None = PLANNED) -> Row:
    """A camera at rest with an ordinary shutter, its exposure tuned by the loss."""
    low, high = scene.limits.min_half_exposure, scene.limits.max_half_exposure
    still = StillCamera(half_exposure=np.sqrt(np.asarray(low) * np.asarray(high)))
    if plan is PLANNED:
        plan = _roomy_plan(scene, still, loss)
    found = _tuned(scene, still, RectShutter(), ("half_exposure",), loss=loss, plan=plan)
    return _row(BEST_SNAPSHOT, found)


_MOTION_ONLY = ("acceleration", "half_exposure")


def _roomy_plan(scene: Scene, still: StillCamera, loss: AbstractLoss) -> Plan:
    """The plan of a camera at rest, in the sizes of a moving one: one program serves both."""
    shutter = RectShutter()
    plan = planned(scene, still, shutter, loss=loss, free="half_exposure")
    if is_straight(scene.motion):
        return plan
    moving = planned(scene, scene.motion, shutter, loss=loss, free=_MOTION_ONLY)
    sizes = ("num_taps", "dft_length", "num_nodes")
    room = {name: max(getattr(plan, name), getattr(moving, name)) for name in sizes}
    finer = max(plan, moving, key=lambda each: each.num_frequencies)
    return replace(plan, **room, num_frequencies=finer.num_frequencies, num_kept=finer.num_kept)


def _own_best(
    name: str,
    entry: AbstractShutter | Design,
    scene: Scene,
    motion: AbstractMotion,
    loss: AbstractLoss,
    tuned: Callable[..., Design],
) -> Row:
    if not isinstance(entry, Design):
        return _at_own_best(name, scene, motion, entry, _MOTION_ONLY, tuned)
    if _is_finished(entry, scene, loss):
        return _row(name, entry)
    return _at_own_best(name, scene, entry.motion, entry.shutter, _MOTION_ONLY, tuned)


def _is_finished(design: Design, scene: Scene, loss: AbstractLoss) -> bool:
    """Whether a design was found for this scene by this loss."""
    same_scene = _are_equal(design.scene.bare(), scene.bare())
    return same_scene and design.loss_name == repr(loss)


def _are_equal(first: Any, second: Any) -> bool:
    """Whether two trees are, compared on the host: on the device each shape has a program."""
    return bool(eqx.tree_equal(*jax.tree.map(_on_host, (first, second))))


def _on_host(leaf: Any) -> Any:
    return np.asarray(leaf) if eqx.is_array(leaf) else leaf


def _at_own_best(
    name: str,
    scene: Scene,
    motion: AbstractMotion,
    shutter: AbstractShutter,
    free: tuple[str, ...],
    tuned: Callable[..., Design],
) -> Row:
    if isinstance(motion, StillCamera):
        free = tuple(part for part in free if part != "acceleration")
    return _row(name, tuned(scene, motion, shutter, free))


def _tuned(
    scene: Scene,
    motion: AbstractMotion,
    shutter: AbstractShutter,
    free: tuple[str, ...],
    *,
    loss: AbstractLoss,
    plan: Plan | Automatic | None,
) -> Design:
    return optimise(scene, motion, shutter, loss=loss, free=free, plan=plan)


def _row(name: str, design: Design) -> Row:
    return Row(OWN_BEST_MOTION, name, design.shutter, design.motion, design.loss, design.metrics)


_NO_DETAIL = "This scene's picture holds no detail: there is nothing to restore or to gain."


def _with_verdict(rows: list[Row], given: tuple[str, ...]) -> Comparison:
    at_best = [row for row in rows if row.reading == OWN_BEST_MOTION]
    snapshot = next(row for row in at_best if row.name == BEST_SNAPSHOT)
    contenders = [row for row in at_best if row.name in given] or [
        row for row in at_best if row.name != BEST_SNAPSHOT
    ]
    best = max(contenders, key=lambda row: float(row.metrics.expected_psnr))
    level, still = (float(row.metrics.expected_psnr) for row in (best, snapshot))
    if np.isposinf(still):
        return Comparison(tuple(rows), _NO_DETAIL, 0.0)
    gain = level - still
    comparison = "better than" if gain >= 0 else "worse than"
    verdict = (
        f"For this scene {best.name} on its own best motion is expected to be "
        f"{abs(gain):.2f} dB {comparison} the best snapshot "
        f"({level:.2f} dB against {still:.2f} dB, exposures "
        f"{float(best.motion.exposure) * 1e3:.3g} ms and "
        f"{float(snapshot.motion.exposure) * 1e3:.3g} ms)."
    )
    return Comparison(tuple(rows), verdict, gain)


_HEADER = (
    f"{'shutter':<16}{'PSNR dB':>9}{'cond.':>8}{'diff.':>8}{'rel.':>7}"
    f"{'light':>7}{'bound':>7}{'stroke px':>11}{'exposure ms':>13}{'loss':>9}"
)


def _line(row: Row) -> str:
    m = row.metrics
    loss = "" if row.loss is None else f"{row.loss:.4f}"
    return (
        f"{row.name:<16}{float(m.expected_psnr):>9.2f}{float(m.condition_number):>8.2f}"
        f"{float(m.kernel_difference):>8.4f}{float(m.relative_kernel_difference):>7.3f}"
        f"{float(m.efficiency):>7.3f}{float(m.bound_share):>7.3f}"
        f"{float(row.motion.stroke):>11.2f}{float(row.motion.exposure) * 1e3:>13.3f}{loss:>9}"
    )
