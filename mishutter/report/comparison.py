"""Designs beside their rivals: rows of a table, their ceiling and the verdict of a scene."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import ArrayLike

from mishutter._core.checks import named, require, require_known
from mishutter._core.compiling import outside_trace
from mishutter._core.parallel import alone_in_blas
from mishutter._core.progress import counts
from mishutter.decoding.decoders.base import AbstractDecoder
from mishutter.design.design import Design, frames_to_dict, metrics_to_dict, motion_to_dict
from mishutter.evaluation.ceilings import ceiling
from mishutter.evaluation.losses import AbstractLoss, as_loss
from mishutter.evaluation.speed_knowledge import loss_of_decoder
from mishutter.evaluation.tolerances import ToleranceCosts, tolerance_costs
from mishutter.model.exposures import Exposures
from mishutter.model.motion import AbstractMotion
from mishutter.model.scene import Scene, require_scene
from mishutter.model.shutters.base import AbstractShutter
from mishutter.pictures.images import Picture
from mishutter.report.by_decoder import Judgement, judged_by, pictures_to_judge
from mishutter.report.gain_range import gain_range
from mishutter.report.plots import plot_levels
from mishutter.report.tables import Table, comparison_tables
from mishutter.report.verdict import (
    comparison_notes,
    details_of,
    headline,
    on_pan,
    on_what_is_left_out,
    option_name,
    options_of,
    options_table,
    sentences_of,
)
from mishutter.search.rivals import (
    BEST_MOVING_BURST,
    BEST_STILL_BURST,
    Entry,
    RivalSearch,
    Step,
    compared_rows,
    may_be_named,
    searches,
    taken_names,
)
from mishutter.search.rows import (
    BEST_SNAPSHOT,
    OWN_BEST_MOTION,
    SECOND_AXIS,
    SNAPSHOTS,
    STAGE,
    Row,
    best_of_each_purchase,
    best_row,
    best_snapshot_of,
    choice_of,
    gain_over,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Comparison:
    """Shutters side by side.

    Attributes:
        rows: One row for each shutter and reading.
        verdict: The answer in lines of text, without its table: the best option that the scene
            allows, where nothing simpler is within 0.2 dB of it; what a shaped shutter adds; and
            what the answer assumes.
        gain: Gain of the best of the user's designs, or else of the best coded camera, over the
            best snapshot, panned where that is allowed, both within the scene's tolerances; dB,
            negative where the snapshot is better.
        ceiling: Expected PSNR that no camera of one exposure exceeds; dB. Speeds in equal steps
            stand for all speeds between them, unless a design exceeds that ceiling by dwelling at
            the listed speeds.
        notes: Further sentences, such as the light that the shutter loses.
        costs: Cost of each tolerance to the best design; None for a scene without tolerances, and
            where a decoder that knows the speed, or the worst speed, judges.
        choice: The row of the best option; None where there is nothing to restore.
        gain_range: Least and greatest gain of that over the best snapshot at rest, within two
            errors of each number of a scene that states errors; dB. None of others.
        judgement: The rows of one exposure by a decoder on photographs; None without those.
        options: The options by what they need, the worst first; gains are over the best snapshot
            at rest, which is one of them.
        details: Sentences that stand beside all tables: what a real sensor takes from the choice.
    """

    rows: tuple[Row, ...]
    verdict: str
    gain: float
    ceiling: float
    notes: tuple[str, ...] = ()
    costs: ToleranceCosts | None = None
    choice: Row | None = None
    gain_range: tuple[float, float] | None = None
    judgement: Judgement | None = None
    options: tuple[Row, ...] = ()
    details: tuple[str, ...] = ()

    def __repr__(self) -> str:
        """The number of rows and the first line of the verdict; `str` is the `text`."""
        return f"Comparison({len(self.rows)} rows: {self.verdict.splitlines()[0]})"

    def __str__(self) -> str:
        return self.text()

    @property
    def rivals(self) -> dict[str, Row]:
        """The best row of each purchase, the least first; no burst, which is another camera.

        The rows of a purchase are all those that need no more parts, since its owner may use fewer.
        """
        return best_of_each_purchase(self.rows)

    @property
    def snapshot(self) -> Row:
        """The best snapshot that the scene allows; gains in tables of rows are relative to it."""
        return best_snapshot_of(self.rows)

    @property
    def is_coded(self) -> bool:
        """Whether the choice is one exposure of a sensor that accelerates or a shaped shutter."""
        choice = self.choice
        if choice is None or choice.is_in_plane:
            return False
        return choice.is_of_one_exposure and choice.name not in SNAPSHOTS

    @property
    def sequence(self) -> Exposures | None:
        """The frames of the best option; None without any.

        Where that is one exposure, since nothing is said to register objects, they are those that
        are best if something does.
        """
        bursts = [row for row in self.rows if row.sequence is not None]
        if self.choice is not None and self.choice.sequence is not None:
            return self.choice.sequence
        return best_row(bursts).sequence if bursts else None

    def over_snapshot(self, level: float) -> float:
        """Gain of an expected PSNR over that of the best snapshot that the scene allows; dB.

        Args:
            level: The expected PSNR; dB.
        """
        return gain_over(level, self.snapshot.level)

    def over_nothing(self, level: float) -> float:
        """Gain of an expected PSNR over the best camera that takes nothing to buy; dB.

        Args:
            level: The expected PSNR; dB.
        """
        return gain_over(level, self.rivals["nothing"].level)

    def row(self, name: str, reading: str = OWN_BEST_MOTION) -> Row:
        """The row of a shutter in a reading.

        Args:
            name: Name of the shutter.
            reading: `"own best motion"` or `"same motion"`.

        Raises:
            ValueError: if there is none.
        """
        for row in self.rows:
            if (row.name, row.reading) == (name, reading):
                return row
        names = ", ".join(sorted({row.name for row in self.rows}))
        raise ValueError(f"`Comparison.row(name=...)` must be one of {names}; got {name!r}.")

    @property
    def options_baseline(self) -> Row:
        """The best snapshot at rest, over which the gains of options are."""
        return self.row(BEST_SNAPSHOT)

    def to_dict(self) -> dict[str, object]:
        """The table as plain numbers and text."""
        rows = [
            {
                "reading": row.reading,
                "name": row.name,
                "motion": None if row.sequence else motion_to_dict(row.motion),
                "loss": row.loss,
                **_frames_of(row),
                "psnr_db": row.psnr,
                "worst_speed_psnr_db": row.worst_psnr,
                "metrics": metrics_to_dict(row.metrics),
            }
            for row in self.rows
        ]
        rivals = {
            purchase: {
                "name": row.name,
                "expected_psnr_db": row.level,
                "over_nothing_db": self.over_nothing(row.level),
                "motion": None if row.is_in_plane else motion_to_dict(row.motion),
            }
            for purchase, row in self.rivals.items()
        }
        options = [
            {
                "name": option_name(row),
                "row": row.name,
                **_frames_of(row),
                "psnr_db": row.level,
                "gain_db": row.margin_over(self.options_baseline),
                "needs": list(row.needs),
            }
            for row in self.options
        ]
        document: dict[str, object] = {
            "rows": rows,
            "rivals": rivals,
            "verdict": self.verdict,
            "notes": list(self.notes),
            "details": list(self.details),
            "choice": None if self.choice is None else self.choice.name,
            "options": options,
            "gain_db": self.gain,
            "ceiling_db": self.ceiling,
        }
        if self.gain_range is not None:
            document["choice_gain_range_db"] = list(self.gain_range)
        if self.costs is not None:
            document["tolerance_costs"] = self.costs.to_dict()
        if self.judgement is not None:
            document["on_pictures"] = self.judgement.to_dict()
        if self.sequence is not None:
            document["sequence"] = frames_to_dict(self.sequence)
        return document

    def plot(self) -> "Figure":
        """A figure of the levels of all rows at their own best motion, and of the ceiling."""
        rows = [row for row in self.rows if row.reading == OWN_BEST_MOTION]
        chosen = None if self.choice is None else self.choice.name
        return plot_levels({row.name: row.level for row in rows}, self.ceiling, chosen)

    @property
    def tables(self) -> list[Table]:
        """Every table of the rows, in the order in which they are read."""
        frames = "" if self.sequence is None else self.sequence.text
        return comparison_tables(self.rows, self.ceiling, self.costs, self.judgement, frames)

    def text(self, *, verbose: bool = False) -> str:
        """The answer with its table of options, as the command and the page show it.

        Args:
            verbose: Whether the details and the tables of all rows follow.
        """
        first, *parts = self.verdict.split("\n", 1)
        if self.options:
            parts.insert(0, options_table(self.options, self.options_baseline, self.ceiling))
        if verbose:
            parts += ["\n".join(self.details)] if self.details else []
            parts += [table.text() for table in self.tables]
        return "\n\n".join([first, *parts])


def _frames_of(row: Row) -> dict[str, object]:
    """The frames of a row as a document has them: one exposure has no travel and no loss."""
    frames = row.sequence
    return {
        "kind": row.exposures.kind,
        "num_frames": row.num_frames,
        "num_axes": len(row.parts & {STAGE, SECOND_AXIS}),
        "exposures_s": row.exposures.exposures,
        "travel_px": None if frames is None else frames.travel,
        "width_loss_db": None if frames is None else frames.width_loss,
    }


@alone_in_blas()
@outside_trace()
def compare(
    scene: Scene,
    motion: AbstractMotion | Design,
    shutters: Mapping[str, object] | Sequence[object] | Entry | None = None,
    *,
    loss: AbstractLoss | Callable[..., object] | None = None,
    every: bool = True,
    decoder: AbstractDecoder | None = None,
    pictures: Iterable[Picture | ArrayLike] = (),
    progress: Step | bool | None = None,
    bursts: tuple[Exposures, ...] = (),
) -> Comparison:
    r"""Measure shutters beside the baselines, in two readings.

    Every row is judged by the decoder that the scene names, unless the loss names another. With
    `KnownSpeedLoss` the decoder knows the speed of the picture, with `FoundSpeedLoss` it finds
    the speed, and with `WorstSpeedLoss` rows are judged at the worst of the speeds.

    *Own best motion*: exposure, velocity and acceleration are tuned for each shutter by the same
    loss within the scene's limits, from `motion` or from the motion of a `Design`; the best
    acceleration may be none. A `Design` of this loss for this scene is finished and stays as it is.
    *Same motion*: every shutter is on `motion`.

    These rivals stand beside the windows, and are tuned alike: the best Tukey, whose taper is tuned
    too; the best snapshot, which is an open shutter at rest, and where the sensor may pan the best
    panned snapshot; the best coded still, which is a free profile without acceleration, and where
    that pans the best one at rest; the best still burst of a scene that has a `BurstMode`, and the
    best moving one where there is no background; and without either stills at 30 frames/s.

    A `decoder` and `pictures` add a column, a line of the verdict and a `judgement`: each camera of
    one exposure captures the photographs at every speed of the scene, with an exposure that is
    tuned for that decoder, and the differences of its levels to those of the best snapshot are
    averaged. The choice of the camera stays that of the expected error.

    Args:
        scene: Speeds, light, noise and limits.
        motion: The motion of the reading *same motion*, from which *own best motion* starts; or a
            design, which is compared on its own motion, as "optimised" where no `shutters` are
            given.
        shutters: Profiles or designs to compare with the baselines, by name. Those of a
            list are "shutter 0" and so on.
        loss: The loss that tunes the motions, or a function of scene, motion and shutter. The loss
            of the scene's decoder is the default, and replaces a loss that ignores the number of
            photons.
        every: Whether every row is computed, or only those of the answer: your own, an open
            shutter, snapshots, coded stills and bursts at their own best motions. Where you name
            none, and the ceiling of one exposure tells that it cannot come within 0.2 dB of frames,
            they are the snapshots and the bursts.
        decoder: Your own decoder, or one of the package's.
        pictures: Photographs that it restores, two or more; `read_picture` reads one.
        progress: Whether a bar is shown, in a terminal or a notebook; or a function that is called
            with the name of each search once it has ended: a shutter's, or the first of a kind of
            rival.
        bursts: The best bursts, where an earlier search has found them.

    Returns:
        The table and the verdict.

    Raises:
        ValueError: if a shutter has the name of a baseline that it is not, if something is
            neither a shutter nor a design, if a decoder stands without two pictures or they without
            it, or if JAX traces the scene or the motion.
    """
    require_scene(scene)
    if isinstance(motion, Design):
        shutters = {"optimised": motion} if shutters is None else shutters
        motion = motion.motion
    require(isinstance(motion, AbstractMotion), "compare(motion=...)", "be a motion", motion)
    require_known("compare", scene=scene, motion=motion)
    lights = pictures_to_judge(decoder, pictures)
    loss = loss_of_decoder(scene) if loss is None else as_loss(loss, "compare(loss=...)")
    loss = loss if loss.sees_light else loss_of_decoder(scene)
    entries: dict[str, Entry] = {}
    if shutters:
        subject, kinds = "compare(shutters=...)", (AbstractShutter, Design)
        entries = named(subject, shutters, kinds, "shutter or design", label="shutter ")
        for name, entry in entries.items():
            must = f"call no other shutter one of {', '.join(taken_names())}"
            require(may_be_named(entry, name), subject, must, name)
    search = RivalSearch(scene, loss, motion, entries, every=every, bursts=bursts)
    why_no_step = "compiling, or a long search"
    with counts(progress is True, "comparing", len(searches(search)), why_no_step) as counter:
        # Of frames the moving ones take the time.
        labels = {BEST_STILL_BURST: BEST_MOVING_BURST} if scene.limits.moves else {}

        def began(name: str) -> None:
            counter.began(labels.get(name, name))

        def ended(name: str) -> None:
            counter.ended(labels.get(name, name))
            if callable(progress):
                progress(name)

        frames = labels.get(BEST_STILL_BURST, BEST_STILL_BURST)
        search.burst_progress = lambda share: counter.within(frames, share)
        rows = compared_rows(search, ended, began)
    leaves_out = search.frames_alone
    table = with_verdict(rows, entries, scene, loss, details=every, leaves_out=leaves_out)
    if decoder is None:
        return table
    at_best = [row for row in rows if row.reading == OWN_BEST_MOTION and row.is_of_one_exposure]
    judgement = judged_by(
        decoder, lights, scene, at_best, table.snapshot, progress=progress is True
    )
    choice = table.choice.name if table.choice is not None and table.is_coded else None
    is_judged = choice in judgement.cameras  # a burst is not
    verdict = f"{table.verdict}\n{judgement.sentence(choice if is_judged else None)}"
    return replace(table, verdict=verdict, judgement=judgement)


def with_verdict(
    rows: Sequence[Row],
    entries: Mapping[str, Entry],
    scene: Scene,
    loss: AbstractLoss | None = None,
    *,
    details: bool = True,
    leaves_out: bool = False,
) -> Comparison:
    """Adds the answer, the gain and the ceiling to the rows of a scene."""
    loss = loss_of_decoder(scene) if loss is None else loss
    at_best = [row for row in rows if row.reading == OWN_BEST_MOTION]
    single = [row for row in at_best if row.is_of_one_exposure]
    notes = comparison_notes(scene, entries, single)
    snapshot = best_row(row for row in single if row.name in SNAPSHOTS)
    if np.isposinf(snapshot.level):
        said = "This scene's picture holds no detail: there is nothing to restore or to gain."
        return Comparison(tuple(rows), said, 0.0, np.inf, notes)
    coded = [row for row in single if row.name not in SNAPSHOTS] or single
    best = best_row([row for row in coded if row.name in entries] or coded)
    most = float(ceiling(scene))
    if most < max(row.level for row in coded):  # a design that dwells at the listed speeds
        most = float(ceiling(scene, continuous=False))
    at_rest = next(row for row in single if row.name == BEST_SNAPSHOT)
    # Nothing registers a single frame: that is one of the single exposures.
    choice = choice_of([*single, *(row for row in at_best if row.num_frames > 1)], entries)
    within = gain_range(scene, choice, at_rest)
    first = headline(choice, at_rest, scene.limits, within)
    lines = [first]
    if leaves_out and not scene.sensor.is_rolling:
        lines.append(on_what_is_left_out(choice.level - most))
    lines += sentences_of(scene, at_best, choice, (on_pan(scene, choice, loss), *notes))
    costs = None
    if best.within is not None:
        costs = tolerance_costs(scene, best.motion, best.shutter)
    return Comparison(
        tuple(rows),
        "\n".join(lines),
        best.level - snapshot.level,
        most,
        notes,
        costs,
        choice,
        gain_range=within,
        options=tuple(options_of(at_best, choice, entries)),
        details=tuple(details_of(scene, choice.sequence)) if details else (),
    )
