"""The answer of a search in the plane: its frames as rows of a comparison."""

from collections.abc import Callable

from mishutter.evaluation.metrics import SequenceMetrics
from mishutter.evaluation.speed_knowledge import KNOWN_SPEED
from mishutter.model.exposures import Exposures
from mishutter.model.scene import Scene
from mishutter.report.comparison import Comparison
from mishutter.report.verdict import (
    best_of_each_need,
    details_of,
    headline,
    on_pan_in_plane,
    options_of,
    sentences_of,
)
from mishutter.search.frame_ties import FREE, STILLS, WAYS
from mishutter.search.plane_frames import PlaneSearch, best_in_plane
from mishutter.search.rivals import BEST_MOVING_BURST, BEST_STILL_BURST
from mishutter.search.rows import (
    BEST_SNAPSHOT,
    FRAMES,
    OWN_BEST_MOTION,
    SECOND_AXIS,
    STAGE,
    Row,
    choice_of,
)


def compare_in_plane(
    scene: Scene, *, progress: Callable[[float], None] = lambda share: None
) -> Comparison:
    """The best frames of each kind of path in the plane, beside a snapshot at rest.

    Args:
        scene: As `best_in_plane` takes it.
        progress: As `best_in_plane` takes it.
    """
    return answer_in_plane(scene, best_in_plane(scene, progress=progress))


def answer_in_plane(scene: Scene, search: PlaneSearch) -> Comparison:
    """The rows of a search, with the answer, the gain and the ceiling."""
    snapshot = _row(BEST_SNAPSHOT, search.snapshot)
    others = (burst for burst in search.bursts if burst.num_frames > 1 or burst.moves)
    rows = [snapshot, *(_row(_name(burst), burst) for burst in others)]
    choice = choice_of(best_of_each_need(rows))
    said = sentences_of(scene, rows, choice, (on_pan_in_plane(scene, choice),))
    return Comparison(
        tuple(rows),
        "\n".join([headline(choice, snapshot, scene.limits), *said]),
        choice.margin_over(snapshot),
        search.ceiling,
        choice=choice,
        options=tuple(options_of(rows, choice)),
        details=tuple(details_of(scene, choice.sequence)),
    )


def _name(burst: Exposures) -> str:
    """The name of a row, by whether the sensor moves, and how."""
    # Two axes may go a way of one, and one a way of its own, as the best of two do.
    is_common = (burst.kind == FREE) == (burst.num_axes == 1) and burst.kind in (FREE, *WAYS)
    way = f"{burst.kind} on {'two axes' if burst.num_axes == 2 else 'one axis'}"
    way = way if is_common and burst.num_axes else burst.kind
    if burst.num_frames == 1:
        return f"one exposure, {way}"
    name = BEST_MOVING_BURST if burst.moves else BEST_STILL_BURST
    return name if burst.kind == STILLS else f"{name}, {way}"


def _row(name: str, burst: Exposures) -> Row:
    """Frames in the plane as a row."""
    parts = [FRAMES] if burst.num_frames > 1 else []
    parts += [STAGE, SECOND_AXIS][: burst.num_axes]
    metrics = SequenceMetrics(1.0, burst.level, None)
    return Row(OWN_BEST_MOTION, name, burst, None, metrics, KNOWN_SPEED, hardware=frozenset(parts))
