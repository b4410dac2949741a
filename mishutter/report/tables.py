"""Rows and columns of a comparison, which Python, the command and the page draw."""

from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, NamedTuple

from mishutter.evaluation.metrics import METRICS, Metrics
from mishutter.search.rows import (
    OWN_BEST_MOTION,
    Row,
    best_of_each_purchase,
    best_snapshot_of,
    cameras_of,
    gain_over,
)

if TYPE_CHECKING:
    from mishutter.evaluation.tolerances import ToleranceCosts
    from mishutter.report.by_decoder import Judgement

_GAP = "  "
"""Space between the columns of a table as text."""


class Column(NamedTuple):
    """A column of numbers."""

    heading: str  # Its head
    # The number of a row as text, by its gain in dB; a dash where there is none
    cell: Callable[[Row, float], str]
    note: str = ""  # Its meaning, below the table; empty where other lines say it

    @staticmethod
    def of_metric(name: str) -> "Column":
        """The column of a metric by its name."""
        metric = METRICS[name]

        def cell(row: Row, _: float) -> str:
            value = getattr(row.metrics, name, None)  # a burst has few of them
            return "–" if value is None else format(float(value), metric.form)

        return Column(metric.heading, cell)


class Table(NamedTuple):
    """A table as text; its first column holds names, the others numbers."""

    title: str  # Its title
    columns: tuple[str, ...]  # Heads of the columns
    rows: tuple[tuple[str, ...], ...]  # Cells of each row
    notes: tuple[str, ...] = ()  # Lines below the table

    def text(self) -> str:
        """The table in lines of one width, its title above and its notes below."""
        every = [line for row in (self.columns, *self.rows) for line in _lines(row)]
        widths = [max(map(len, column)) for column in zip(*every, strict=True)]
        lines = [
            _GAP.join([name.ljust(widths[0]), *map(str.rjust, numbers, widths[1:])]).rstrip()
            for name, *numbers in every
        ]
        return "\n".join([self.title, *lines, *self.notes])


def _lines(row: Sequence[str]) -> list[tuple[str, ...]]:
    """A row as lines: several names of one camera may need more than one."""
    name, *numbers = row
    first, *others = name.splitlines() or [""]
    return [(first, *numbers), *((other, *[""] * len(numbers)) for other in others)]


def _or_dash(level: float | None) -> str:
    return "–" if level is None else f"{level:.2f}"


_LEVELS = (
    Column("PSNR dB", lambda row, _: f"{row.psnr:.2f}"),
    Column(
        "gain dB",
        lambda _, gain: f"{round(gain, 2) + 0.0:+.2f}",
        "over the best snapshot, at rest or panned",
    ),
    Column("worst speed", lambda row, _: _or_dash(row.worst_psnr)),
)
_LIGHT = Column.of_metric("efficiency")._replace(note="share that the shutter passes")
_MOTION = (
    Column(
        "stroke px",
        lambda row, _: f"{row.stroke:.1f}",
        "travel of the stage over the exposure, from end to end",
    ),
    Column(
        "pan px/s",
        lambda row, _: "-" if row.sequence else f"{round(float(row.motion.velocity)) + 0:d}",
        "velocity at mid-exposure",
    ),
    Column(
        "open ms",
        lambda row, _: f"{max(row.exposures.exposures) * 1e3:.2f}",
        "from first to last light, of the longest frame",
    ),
)
_WITHIN = Column(
    METRICS["toleranced_psnr"].heading,
    lambda row, _: _or_dash(row.within),
    "expected within the tolerances; gain dB compares these",
)
_OF_ROWS = (*_LEVELS, _LIGHT, *_MOTION)
_OF_KERNELS = tuple(
    Column.of_metric(metric.name)
    for metric in METRICS.values()
    if not metric.sees_light and metric.heading != _LIGHT.heading
)
"""The metrics that no light changes, but for the share of it that the shutter passes."""


def joined_name(camera: Iterable[Row]) -> str:
    """The names of rows that are one camera, in as many lines as they need."""
    first, *others = (row.name for row in camera)
    lines = [first]
    for name in others:
        if len(f"{lines[-1]} = {name}") <= 30:
            lines[-1] += f" = {name}"
        else:
            lines.append(f"= {name}")
    return "\n".join(lines)


def comparison_tables(
    rows: Sequence[Row],
    ceiling: float,  # dB
    costs: "ToleranceCosts | None",
    judgement: "Judgement | None",
    frames: str,  # Those of the best option in words, if it has some
) -> list[Table]:
    """Every table of the rows of a comparison, in the order in which they are read.

    Rows that are the same camera are one, with all of its names.
    """
    within = () if costs is None else (_WITHIN,)
    judged = () if judgement is None else _on_pictures(judgement)
    snapshot = best_snapshot_of(rows).level
    tables = []
    for reading in dict.fromkeys(row.reading for row in rows):
        cameras = cameras_of(row for row in rows if row.reading == reading)
        columns = (*_OF_ROWS, *within, *(judged if reading == OWN_BEST_MOTION else ()))
        if reading == OWN_BEST_MOTION:
            notes = _notes([camera[0] for camera in cameras], columns)
            if frames:
                notes += (f"{'frames':<11}{_GAP}{frames}",)
            numbers = f"{ceiling:.2f}", f"{gain_over(ceiling, snapshot):+.2f}"
            bound = ("ceiling", *numbers, *[""] * (len(columns) - len(numbers)))
            cells = *_cells(cameras, columns, snapshot), bound
            tables += [_table(reading, columns, cells, notes), _purchases(rows, within)]
            tables += [] if costs is None else [_costs(costs)]
        else:
            tables += [_table(reading, columns, _cells(cameras, columns, snapshot))]
            kernels = _cells(cameras, _OF_KERNELS, snapshot)
            note = _condition_note(cameras)
            tables += [_table(f"kernels, {reading}", _OF_KERNELS, kernels, (note,))]
    return tables


def _on_pictures(judgement: "Judgement") -> tuple[Column, ...]:
    """Gains on photographs, and the exposures that are tuned for their decoder."""
    cameras = judgement.cameras

    def gain(row: Row, _: float) -> str:
        camera = cameras.get(row.name)
        return "–" if camera is None else f"{camera.gain:+.2f} ±{camera.standard_error:.2f}"

    def exposure(row: Row, _: float) -> str:
        camera = cameras.get(row.name)
        return "–" if camera is None else f"{float(camera.motion.exposure) * 1e3:.2f}"

    of = f"on {judgement.num_pictures} pictures by {judgement.decoder}"
    note = f"gain over the best snapshot {of}, and its standard error"
    return (
        Column("on pictures", gain, note),
        Column("there ms", exposure, "exposure that is best for that decoder"),
    )


def _cells(
    cameras: Sequence[list[Row]],
    columns: Sequence[Column],
    snapshot: float,  # Level of the best snapshot, dB
) -> tuple[tuple[str, ...], ...]:
    """The rows of a table of cameras."""
    return tuple(
        _row_cells(camera[0], columns, snapshot, name=joined_name(camera)) for camera in cameras
    )


def page_table(rows: Sequence[Row], *, within: bool) -> Table:
    """One wide table of some rows, levels, also within tolerances, and kernels together."""
    columns = (*_OF_ROWS, *([_WITHIN] if within else []), *_OF_KERNELS)
    snapshot = best_snapshot_of(rows).level
    return _table("", columns, tuple(_row_cells(row, columns, snapshot) for row in rows))


def _table(
    title: str,
    columns: Sequence[Column],
    rows: tuple[tuple[str, ...], ...],
    notes: tuple[str, ...] = (),
) -> Table:
    heads = ("shutter", *(column.heading for column in columns))
    return Table(title.capitalize(), heads, rows, notes)


def _row_cells(
    row: Row,
    columns: Sequence[Column],
    other: float,  # Level over which the gain is, dB
    *,
    name: str | None = None,
) -> tuple[str, ...]:
    """The name of a row, then its cells."""
    name = row.name if name is None else name
    frames = "" if row.num_frames == 1 else f", {row.num_frames} frames"
    gain = gain_over(row.level, other)
    return (f"{name}{frames}", *(column.cell(row, gain) for column in columns))


def _notes(rows: Sequence[Row], columns: Sequence[Column]) -> tuple[str, ...]:
    """The meaning of the columns; that of the levels is by the decoder of the first row."""
    level, _, worst, *_ = columns
    row, bounded = rows[0], "nothing exceeds it"
    bursts: dict[str, str] = {}
    if any(each.num_frames > 1 for each in rows):
        bounded = bounded if row.is_in_plane else "no single exposure exceeds it"
        bursts = {"bursts": "of frames that are registered, so that each speed is known"}
    decoder = row.decoder
    of_level = decoder.worst_words if row.at_worst else f"of {decoder.level_words}"
    meanings = {column.heading: column.note for column in columns}
    meanings |= {level.heading: f"expected {of_level}"}
    meanings |= {worst.heading: f"{level.heading} {decoder.worst_words}"}
    meanings |= bursts | {"ceiling": bounded, "PSNR": "of linear light, white = 1"}
    return tuple(f"{heading:<11}{_GAP}{meaning}" for heading, meaning in meanings.items())


def _purchases(rows: Sequence[Row], within: tuple[Column, ...]) -> Table:
    """The best row of each purchase."""
    columns, rivals = (*_LEVELS, *_MOTION, *within), best_of_each_purchase(rows)
    lines = []
    for purchase, row in rivals.items():
        name, *numbers = _row_cells(row, columns, rivals["nothing"].level)
        lines.append((f"{purchase}: {name}", *numbers))
    heads = ("purchase: its best", *(column.heading for column in columns))
    return Table("Gain of each purchase over buying nothing", heads, tuple(lines))


def _costs(costs: "ToleranceCosts") -> Table:
    """The cost of each tolerance to the best design, and a sentence on the largest."""
    cells = (
        (row.name, row.size, f"{row.cost:z.3f}", f"{row.unaware_cost:z.3f}") for row in costs.rows
    )
    notes = (costs.verdict, "unaware dB  cost by a decoder for a camera without errors")
    heads = ("tolerance", "1 sigma", "costs dB", "unaware dB")
    return Table("Cost of each tolerance to the best design", heads, tuple(cells), notes)


def _condition_note(cameras: Sequence[list[Row]]) -> str:
    """The phase and the length over which condition numbers are taken."""
    places: dict[str, list[str]] = {}
    for camera in cameras:
        metrics = camera[0].metrics
        if not isinstance(metrics, Metrics):  # a burst, which has no kernel
            continue
        place = f"phase {float(metrics.phase):g} px over {metrics.dft_length} DFT points"
        places.setdefault(place, []).append(camera[0].name)
    most = max(places, key=lambda place: len(places[place]))
    others = [f", of {' and '.join(places[p])} at {p}" for p in places if p != most]
    return f"{METRICS['condition_number'].heading.capitalize()} at {most}{''.join(others)}."
