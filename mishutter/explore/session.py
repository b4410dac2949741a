"""One tab of the page: its requests, its designs, and the answers."""

import copy
import json
import tempfile
import tomllib
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, final

import numpy as np
from pydantic import Field

from mishutter._core.checks import require
from mishutter._core.files import contents, strict_json
from mishutter._core.validation import Section, in_section, parsed, validated
from mishutter.design.design import Design
from mishutter.evaluation.views import transmittance
from mishutter.explore.answers import OPTIMISED, curves, first_answer, shown_rows, table, with_room
from mishutter.explore.fields import Tables, scene_text
from mishutter.explore.pictures import Reader, png_of_figure, reader, uploaded
from mishutter.model.scene import Scene, scene_of_tables
from mishutter.model.scene_file import example_scene_text
from mishutter.model.scene_schema import SceneFile, Speed
from mishutter.model.shutters.chips import ChippedShutter
from mishutter.model.texture import SHIPPED, Texture, photograph_at
from mishutter.pictures.images import Axis, read_picture
from mishutter.search.search import optimise

if TYPE_CHECKING:
    from mishutter.report.comparison import Comparison
    from mishutter.report.documents import Report

DRAWN = "drawn"
NUM_CHIPS = 64
"""Chips of a profile that is drawn."""
MOST_PINS, MOST_ROWS = 6, 4

Check = Callable[[], None]
"""Raises `SupersededError` if the request is superseded."""
Answer = dict[str, object]
"""A message to the page: its `kind`, and names that the page reads."""
Name = Annotated[str, Field(min_length=1, max_length=200)]
Chip = Annotated[float, Field(ge=0, le=1)]


class SupersededError(Exception):
    """The tab has a newer request, or is closed."""


@final
class Request(Section):
    """A scene to design for, a profile drawn by hand, and the rows whose pictures are shown."""

    kind: str
    id: Annotated[int, Field(ge=0, le=1 << 50)]
    scene: Tables
    drawn: Annotated[list[Chip], Field(min_length=NUM_CHIPS, max_length=NUM_CHIPS)] | None = None
    rows: Annotated[tuple[Name, ...], Field(max_length=MOST_ROWS, strict=False)] = ()
    speed: Speed = 0.0


@final
class Order(Section):
    """Any other request of the page; each kind reads the fields that it needs."""

    kind: str
    name: Name = "design"
    text: Annotated[str, Field(max_length=1 << 20)] = ""
    scene: Annotated[Tables, Field(default_factory=dict)]
    drawn: Annotated[list[Chip], Field(min_length=NUM_CHIPS, max_length=NUM_CHIPS)] | None = None


@dataclass(frozen=True)
class Beginning:
    """The state with which every tab begins."""

    tables: Tables  # Tables of the scene file
    photographs: Mapping[str, Reader]  # Photographs by their paths in scene files
    design: Design | None = None  # The finished design of the scene; None until the search ends

    def scene(self) -> Scene:
        """A new scene from the tables of the file, with its photographs."""
        return built(self.tables, self.photographs)

    @property
    def speed(self) -> int:
        """Half of the largest speed, the first speed of the photograph; px/s."""
        return round(float(self.scene().max_speed) / 2)


def beginning(path: Path | None) -> Beginning:
    """The scene file that the page begins with, and the photographs that it may name."""
    content = example_scene_text().encode() if path is None else contents(path)
    tables = _tables(content, "example_scene.toml" if path is None else str(path))
    photographs = {place: reader(place, partial(photograph_at, place)) for place in SHIPPED}
    section = tables.get("picture", {})
    place = section.get("path") if isinstance(section, Mapping) else None
    if path is not None and isinstance(place, str) and place not in photographs:
        own = path.parent / place
        photographs[place] = reader(
            place, lambda white, linear: read_picture(own, white=white, linear=linear)
        )
    started = Beginning(tables, photographs)
    started.scene()
    return started


def _tables(content: bytes, name: str) -> Tables:
    """The tables of a scene file, without the motion to start from.

    Sliders move the limits, out of which that motion would come to lie.
    """
    tables = parsed(tomllib.loads, content, name, "TOML")
    validated(SceneFile, tables, name, in_section)
    return {key: table for key, table in tables.items() if key != "motion"}


def built(tables: Tables, photographs: Mapping[str, Reader]) -> Scene:
    """The scene of some tables, which may name these photographs and no other file."""

    def texture(place: str, white: float | None, linear: bool, axis: Axis) -> Texture:
        names = ", ".join(photographs)
        require(place in photographs, "[picture] path", f"be one of {names}, or uploaded", place)
        return photographs[place](white, linear, axis).texture

    return scene_of_tables(tables, "the scene", Path(), texture)


class Session:
    """The state of one tab; its methods are called from one thread at a time.

    Its memory is bounded: one scene with its design and comparison, one uploaded photograph, and
    a few pins.
    """

    def __init__(self, started: Beginning):
        self._started = started
        self._photographs = dict(started.photographs)
        self._uploaded: str | None = None
        self._pins: dict[str, Design] = {}
        self._design = started.design
        self._key = "" if started.design is None else self._key_of(started.tables)
        self._is_finished = started.design is not None
        self._compared: tuple[str, Comparison] | None = None
        self._in_plane: tuple[str, Report] | None = None

    def copy(self) -> "Session":
        """Another session with the same state."""
        other = copy.copy(self)
        other._photographs, other._pins = dict(self._photographs), dict(self._pins)
        return other

    def begin(self, design: Design) -> None:
        """Takes the design of a search that ended while the page was loading."""
        if self._design is None:
            self._design = design

    def first(self, request: Request) -> Answer:
        """The first answer to a request: curves of a quick design and of the drawn profile."""
        scene = built(request.scene, self._photographs)
        key = self._key_of(request.scene)
        if scene.velocities is not None:
            return {"kind": "plane", "verdict": "searching in the plane when the hand rests"}
        if key != self._key or self._design is None:
            before = self._design
            if before is None:
                self._design = optimise(scene)
            else:
                self._design = first_answer(scene, before, request.id)
            self._key, self._is_finished = key, before is None
        return {"kind": "first", **self._shown(with_room(scene), request, at_once=True)}

    def rest(self, request: Request, check: Check) -> Iterator[Answer]:
        """The further answers when the hand rests: the whole search, the table, photographs.

        At the end it compiles the programs that sliders may need next.
        """
        scene = built(request.scene, self._photographs)
        if scene.velocities is not None:
            yield self._of_plane(scene, self._key_of(request.scene), check)
            return
        if not self._is_finished:
            design = optimise(scene, progress=lambda step, value: check())
            check()
            self._design, self._is_finished = design, True
        yield {"kind": "finished", **self._shown(scene, request)}
        comparison = self._compare(scene, request, check)
        rows = shown_rows(comparison)
        chosen = {name: rows[name] for name in request.rows if name in rows}
        others = {
            name: curves(scene, row.motion, row.shutter)
            for name, row in chosen.items()
            if name != OPTIMISED and row.sequence is None
        }
        pictured = {name: row for name, row in chosen.items() if row.is_of_one_exposure}
        follows = scene.picture.path is not None and bool(pictured)
        shown = {"curves": others, "pins": self.pins, "pictured": follows}
        yield {"kind": "table", **table(comparison), **shown}
        if scene.picture.path is not None and follows:
            check()
            read = self._photographs[scene.picture.path]
            photograph = read(scene.picture.white, scene.picture.linear, scene.sensor.axis)
            yield {
                "kind": "photograph",
                **photograph.restored(scene, pictured, request.speed, check),
            }
        for _ in self.ahead(request.scene):
            check()

    def _of_plane(self, scene: Scene, key: str, check: Check) -> Answer:
        """The answer for things that move in any direction, with the path of its stage."""
        from mishutter.report.documents import Report
        from mishutter.report.in_plane import compare_in_plane

        if self._in_plane is None or self._in_plane[0] != key:
            result = compare_in_plane(scene, progress=lambda share: check())
            self._in_plane = key, Report(scene, result, ())
        report = self._in_plane[1]
        verdict, _, answer = report.comparison.text().partition("\n")
        return {
            "kind": "plane",
            "verdict": verdict,
            "answer": answer.strip("\n"),
            "picture": png_of_figure(report.plot()),
        }

    def ahead(self, tables: Tables) -> Iterator[None]:
        """Compiles programs that later first answers share, one at each step.

        Scenes of any direction have no first answers.
        """
        for changed in _around(tables) if self._design is not None else ():
            try:
                scene = built(changed, self._photographs)
            except ValueError:  # the change is beyond the range of a slider
                continue
            design = first_answer(scene, self._current)
            curves(with_room(scene), design.motion, design.shutter, at_once=True)
            yield

    def _compare(self, scene: Scene, request: Request, check: Check) -> "Comparison":
        from mishutter.report.comparison import compare

        asked = json.dumps([self._key, request.drawn, list(self._pins)])
        if self._compared is None or asked != self._compared[0]:
            entries: dict[str, Design | ChippedShutter] = {OPTIMISED: self._current, **self._pins}
            if request.drawn is not None:
                entries[DRAWN] = _chips(request.drawn)
            result = compare(scene, self._current.motion, entries, progress=lambda name: check())
            self._compared = asked, result
        return self._compared[1]

    @property
    def _current(self) -> Design:
        """The design so far, finished or not."""
        if self._design is None:
            raise ValueError("`a design` must be searched for first; got none yet.")
        return self._design

    def _shown(self, scene: Scene, request: Request, *, at_once: bool = False) -> Answer:
        """Curves of the design and of the drawn profile."""
        design = self._current
        drawings = {OPTIMISED: curves(scene, design.motion, design.shutter, at_once=at_once)}
        if request.drawn is not None:
            drawn = transmittance(scene, design.motion, _chips(request.drawn))
            drawings[DRAWN] = curves(scene, design.motion, drawn, at_once=at_once)
        return {"curves": drawings, "outcome": design.ending}

    def _key_of(self, tables: Tables) -> str:
        return json.dumps([tables, self._uploaded], sort_keys=True)

    def answer(self, order: Order) -> Answer:
        """The answer to any request but one for a design."""
        kinds = {
            "pin": self._pin,
            "unpin": self._unpin,
            "load_scene": self._load_scene,
            "load_design": self._load_design,
            "save_scene": self._save_scene,
            "save_design": self._save_design,
            "recipe": self._recipe,
        }
        require(order.kind in kinds, "a message", f"be one of {', '.join(kinds)}", order.kind)
        return {"kind": order.kind, **kinds[order.kind](order)}

    def _pin(self, order: Order) -> Answer:
        require(self._is_finished, "a pin", "wait for the finished design", "an earlier one")
        return self._add_pin(order.name, self._current)

    def _add_pin(self, name: str, design: Design) -> Answer:
        from mishutter.search.rivals import taken_names

        room = len(self._pins) < MOST_PINS
        require(room, "pins", f"be at most {MOST_PINS}; take one away first", len(self._pins) + 1)
        # No row may have the name: a number stands behind one that is taken.
        used = {*self._pins, *taken_names(), OPTIMISED, DRAWN}
        tries = (name[:60], *(f"{name[:60]} {number}" for number in range(2, len(used) + 3)))
        self._pins[next(each for each in tries if each not in used)] = design
        return {"pins": self.pins}

    def _unpin(self, order: Order) -> Answer:
        self._pins.pop(order.name, None)
        return {"pins": self.pins}

    def _load_scene(self, order: Order) -> Answer:
        tables = _tables(order.text.encode("utf-8", "replace"), order.name)
        built(tables, self._photographs)
        return {"scene": tables}

    def _load_design(self, order: Order) -> Answer:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "design.json"
            path.write_text(order.text, "utf-8", errors="replace")
            try:
                design = Design.load_one(path)
            except (ValueError, OSError) as error:
                raise ValueError(str(error).replace(str(path), order.name)) from None
        return self._add_pin(Path(order.name).stem, design)

    def _save_scene(self, order: Order) -> Answer:
        built(order.scene, self._photographs)
        return {"text": scene_text(order.scene)}

    def _save_design(self, order: Order) -> Answer:
        key, report = self._in_plane or ("", None)
        design = None
        if report is not None and key == self._key_of(order.scene):
            design = report.recommended
        is_finished = self._is_finished or design is not None
        require(is_finished, "a design", "be finished before it is saved", "an earlier one")
        return {"text": strict_json((design or self._current).to_dict()) + "\n"}

    def _recipe(self, order: Order) -> Answer:
        text = str(self._save_scene(order)["text"])
        return {
            "command": f"cat > scene.toml <<'END'\n{text}END\nmishutter optimise scene.toml\n",
            "python": _python(text, order.drawn, "any_direction" in order.scene.get("speeds", {})),
        }

    def upload(self, name: str, content: bytes) -> Answer:
        """Takes an uploaded photograph in place of an earlier one."""
        place = Path(name).name
        is_taken = place in self._started.photographs
        require(not is_taken, "a photograph", "have a name of its own", place)
        photograph = uploaded(place, content)
        if self._uploaded is not None:
            del self._photographs[self._uploaded]
        self._photographs[place], self._uploaded, self._key = photograph, place, ""
        return {"kind": "uploaded", "path": place, "photographs": list(self._photographs)}

    @property
    def photographs(self) -> list[str]:
        """Paths that a scene of this tab may name."""
        return list(self._photographs)

    @property
    def pins(self) -> list[str]:
        """Names of the pinned designs."""
        return list(self._pins)


def _around(tables: Tables) -> Iterator[Tables]:
    """Tables changed as by a slider, whose programs may have other sizes than those of `tables`."""

    def changed(section: str, key: str, factor: float) -> Tables:
        table = tables.get(section, {})
        return {**tables, section: {**table, key: table[key] * factor}} if key in table else {}

    # A scene has each of these in one of several units. Empty tables stand for the keys that it
    # lacks, and are no scene: whoever compiles leaves them out.
    for key in ("photon_rate_per_s", "white_e", "illuminance_lux"):
        yield changed("light", key, 1.02)
    for key in ("max_stroke_px", "max_stroke_mm"):
        yield changed("limits", key, 2.0)
        yield changed("limits", key, 0.5)
    uniform = tables.get("speeds", {}).get("uniform", {})
    for key in (name for name in uniform if name.startswith("max_")):
        one_sided = {**uniform, key: 0.9 * uniform[key]}
        yield {**tables, "speeds": {**tables["speeds"], "uniform": one_sided}}


def _chips(drawn: list[float]) -> ChippedShutter:
    return ChippedShutter(np.asarray(drawn, np.float64))


def _python(text: str, drawn: list[float] | None, in_plane: bool) -> str:
    """A program that computes the same numbers."""
    if in_plane:
        names, own = "Scene, best_in_plane", "print(best_in_plane(scene))\n"
    else:
        names, drawing, more = "Scene, compare, optimise", "", ""
        if drawn is not None:
            names = f"ChippedShutter, {names}"
            drawing = f"drawn = ChippedShutter({[round(x, 6) for x in drawn]})\n"
            more = ', "drawn": drawn'
        own = (
            "design = optimise(scene)\n"
            f"print(design.metrics.expected_psnr)\n{drawing}"
            f'print(compare(scene, design.motion, {{"optimised": design{more}}}).text())\n'
        )
    return (
        "from pathlib import Path\n\nimport jax\n\n"
        'jax.config.update("jax_enable_x64", True)\n\n'
        f"from mishutter import {names}\n\n"
        # Raw, for the backslashes of TOML, which holds no three quotes here.
        f'Path("scene.toml").write_text(r"""\n{text}""", "utf-8")\n\n'
        f'scene = Scene.load("scene.toml")\n{own}'
    )


def with_design(started: Beginning, check: Callable[[int, float], None]) -> Beginning:
    """The beginning with the finished design of its scene, if things move along one axis."""
    if started.scene().velocities is not None:
        return started
    return replace(started, design=optimise(started.scene(), progress=check))
