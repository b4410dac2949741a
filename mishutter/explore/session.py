"""One tab of the page: what it asked for, the designs that it has, and what is answered."""

import copy
import json
import tempfile
import tomllib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, final

import numpy as np
from pydantic import Field

from mishutter._core import Section, in_section, parsed, require, strict_json, validated
from mishutter.explore.answers import (
    OPTIMISED,
    can_be_pictured,
    curves,
    first_answer,
    shown_rows,
    table,
    with_room,
)
from mishutter.explore.fields import scene_text
from mishutter.explore.pictures import Reader, reader, restored, uploaded
from mishutter.hardware import Design
from mishutter.model import (
    EXAMPLE_PICTURE,
    Axis,
    ChippedShutter,
    Scene,
    SceneFile,
    Speed,
    example_picture,
    example_scene_text,
    read_picture,
    scene_of_tables,
)
from mishutter.search import optimise

if TYPE_CHECKING:
    from mishutter.report import Comparison

DRAWN = "drawn"
NUM_CHIPS = 64
"""Of a profile that is drawn."""
MOST_PINS, MOST_ROWS = 6, 4
_MOST_TEXT = 1 << 20
"""Letters of a file that is loaded."""
_MOST_NAME = 60
_SCENE = "the scene"

Check = Callable[[], None]
Text = Annotated[str, Field(max_length=_MOST_TEXT)]
Name = Annotated[str, Field(min_length=1, max_length=200)]
Chip = Annotated[float, Field(ge=0, le=1)]


class SupersededError(Exception):
    """Nobody waits any longer for what is being computed."""


@final
class Request(Section):
    """A scene to design for, what is drawn beside it, and the rows whose pictures are shown."""

    kind: str
    id: Annotated[int, Field(ge=0, le=1 << 50)]
    scene: dict[str, Any]
    drawn: Annotated[list[Chip], Field(min_length=NUM_CHIPS, max_length=NUM_CHIPS)] | None = None
    rows: Annotated[tuple[Name, ...], Field(max_length=MOST_ROWS, strict=False)] = ()
    speed: Speed = 0.0


@final
class Order(Section):
    """Anything else that a page asks for; each kind takes what it needs."""

    kind: str
    name: Name = "design"
    text: Text = ""
    scene: Annotated[dict[str, Any], Field(default_factory=dict)]
    drawn: Annotated[list[Chip], Field(min_length=NUM_CHIPS, max_length=NUM_CHIPS)] | None = None


@dataclass(frozen=True)
class Beginning:
    """What every tab begins with.

    Attributes:
        tables: Those of the scene file.
        photographs: Photographs by the path that a scene file has for them.
        design: The finished design of the scene; None until it is found.
    """

    tables: dict[str, Any]
    photographs: Mapping[str, Reader]
    design: Design | None = None

    def scene(self) -> Scene:
        """The scene of the file."""
        return built(self.tables, self.photographs)

    @property
    def speed(self) -> int:
        """Half of the largest speed, at which the photograph is shown at first; px/s."""
        return round(float(self.scene().max_speed) / 2)


def beginning(path: Path | None) -> Beginning:
    """The scene file that the page begins with, and the photographs that it may name.

    Raises:
        ValueError: if it is not a scene file.
        OSError: if it or its picture cannot be read.
    """
    text = example_scene_text() if path is None else path.read_text("utf-8")
    tables = _tables(text, "example_scene.toml" if path is None else str(path))
    photographs = {EXAMPLE_PICTURE: reader(EXAMPLE_PICTURE, lambda *_: example_picture())}
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


def _tables(text: str, name: str) -> dict[str, Any]:
    """The tables of a scene file, without the motion to start from.

    It would have to lie within the limits while these are moved.
    """
    tables = parsed(tomllib.loads, text.encode(), name, "TOML")
    validated(SceneFile, tables, name, in_section)
    return {key: table for key, table in tables.items() if key != "motion"}


def built(tables: Mapping[str, Any], photographs: Mapping[str, Reader]) -> Scene:
    """The scene of some tables; it may name those photographs alone, and no other file.

    Raises:
        ValueError: if it is no scene, or names another photograph.
    """

    def arguments(place: str, white: float | None, linear: bool, axis: Axis) -> Mapping[str, Any]:
        known = ", ".join(photographs)
        require(place in photographs, "[picture] path", f"be one of {known}, or uploaded", place)
        return photographs[place](white, linear, axis).arguments

    return scene_of_tables(tables, _SCENE, Path(), arguments)


class Session:
    """The state of one tab; its methods are called from one thread at a time.

    Everything that it holds is bounded: one scene with its design and comparison, one uploaded
    photograph, and a few pins.
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

    def copy(self) -> "Session":
        """Another session, which goes on from what this one has."""
        other = copy.copy(self)
        other._photographs, other._pins = dict(self._photographs), dict(self._pins)
        return other

    def begin(self, design: Design) -> None:
        """Take the design that was found while the page was loading."""
        if self._design is None:
            self._design = design

    def first(self, request: Request) -> dict[str, Any]:
        """The first answer to a request: a design at once, and what is drawn beside it."""
        scene = built(request.scene, self._photographs)
        key = self._key_of(request.scene)
        if key != self._key or self._design is None:
            before = self._design
            if before is None:
                self._design = optimise(scene)
            else:
                self._design = first_answer(scene, before, request.id)
            self._key, self._is_finished = key, before is None
        return {"kind": "first", **self._shown(with_room(scene), request, at_once=True)}

    def rest(self, request: Request, check: Check) -> Iterator[dict[str, Any]]:
        """Everything that follows when the hand rests: the whole search, the table, photographs.

        After the last of it the programs are compiled that sliders may need next.

        Args:
            request: That of which `first` was the answer.
            check: Called now and then; raises `SupersededError` where nobody waits any longer.
        """
        scene = built(request.scene, self._photographs)
        if not self._is_finished:
            found = optimise(scene, progress=lambda step, value: check())
            check()
            self._design, self._is_finished = found, True
        yield {"kind": "finished", **self._shown(scene, request)}
        comparison = self._compare(scene, request, check)
        rows = shown_rows(comparison)
        wanted = {name: rows[name] for name in request.rows if name in rows}
        others = {
            name: curves(scene, row.motion, row.shutter)
            for name, row in wanted.items()
            if name != OPTIMISED
        }
        pictured = {name: row for name, row in wanted.items() if can_be_pictured(row)}
        follows = scene.picture is not None and bool(pictured)
        shown = {"curves": others, "pins": self.pins, "pictured": follows}
        yield {"kind": "table", **table(comparison), **shown}
        if scene.picture is not None and follows:
            check()
            read = self._photographs[scene.picture]
            taken = read(scene.picture_white, scene.picture_linear, scene.axis)
            yield {
                "kind": "photograph",
                **restored(taken, scene, pictured, request.speed, check),
            }
        for _ in self.ahead(request.scene):
            check()

    def ahead(self, tables: Mapping[str, Any]) -> Iterator[None]:
        """First answers to changes of some tables, one a step, whose programs later ones share."""
        for changed in _around(tables):
            try:
                scene = built(changed, self._photographs)
            except ValueError:  # as far as a slider goes, and no further
                continue
            found = first_answer(scene, self._found)
            curves(with_room(scene), found.motion, found.shutter, at_once=True)
            yield

    def _compare(self, scene: Scene, request: Request, check: Check) -> "Comparison":
        from mishutter.report import compare

        asked = json.dumps([self._key, request.drawn, list(self._pins)])
        if self._compared is None or asked != self._compared[0]:
            entries: dict[str, Any] = {OPTIMISED: self._found, **self._pins}
            if request.drawn is not None:
                entries[DRAWN] = _chips(request.drawn)
            found = compare(scene, self._found.motion, entries, step=lambda name: check())
            self._compared = asked, found
        return self._compared[1]

    @property
    def _found(self) -> Design:
        if self._design is None:
            raise ValueError("`a design` must be found first; got none yet.")
        return self._design

    def _shown(self, scene: Scene, request: Request, *, at_once: bool = False) -> dict[str, Any]:
        design = self._found
        found = {OPTIMISED: curves(scene, design.motion, design.shutter, at_once=at_once)}
        if request.drawn is not None:
            drawn = scene.light(_chips(request.drawn), design.motion)
            found[DRAWN] = curves(scene, design.motion, drawn, at_once=at_once)
        return {"curves": found, "outcome": design.outcome}

    def _key_of(self, tables: Mapping[str, Any]) -> str:
        return json.dumps([tables, self._uploaded], sort_keys=True)

    def answer(self, order: Order) -> dict[str, Any]:
        """The answer to anything but a request for a design.

        Raises:
            ValueError: if it cannot be met.
        """
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

    def _pin(self, order: Order) -> dict[str, Any]:
        require(self._is_finished, "a pin", "wait for the finished design", "an earlier one")
        return self._add_pin(order.name, self._found)

    def _add_pin(self, name: str, design: Design) -> dict[str, Any]:
        room = len(self._pins) < MOST_PINS
        require(room, "pins", f"be at most {MOST_PINS}; take one away first", len(self._pins) + 1)
        name = free_name(name[:_MOST_NAME], self._pins)
        self._pins[name] = design
        return {"pins": self.pins}

    def _unpin(self, order: Order) -> dict[str, Any]:
        self._pins.pop(order.name, None)
        return {"pins": self.pins}

    def _load_scene(self, order: Order) -> dict[str, Any]:
        tables = _tables(order.text, order.name)
        built(tables, self._photographs)
        return {"scene": tables}

    def _load_design(self, order: Order) -> dict[str, Any]:
        with _file(order.text, order.name) as path:
            design = Design.load(path)
        return self._add_pin(Path(order.name).stem, design)

    def _save_scene(self, order: Order) -> dict[str, Any]:
        built(order.scene, self._photographs)
        return {"text": scene_text(order.scene)}

    def _save_design(self, _: Order) -> dict[str, Any]:
        require(self._is_finished, "a design", "be finished before it is saved", "an earlier one")
        return {"text": strict_json(self._found.to_dict()) + "\n"}

    def _recipe(self, order: Order) -> dict[str, Any]:
        text = self._save_scene(order)["text"]
        return {
            "command": f"cat > scene.toml <<'END'\n{text}END\nmishutter optimise scene.toml\n",
            "python": _python(text, order.drawn),
        }

    def upload(self, name: str, content: bytes) -> dict[str, Any]:
        """Take an uploaded photograph in place of an earlier one.

        Raises:
            ValueError: if it is none, or too large.
        """
        place = Path(name).name
        taken = place in self._started.photographs
        require(not taken, "a photograph", "not be called as another is", place)
        found = uploaded(place, content)
        if self._uploaded is not None:
            del self._photographs[self._uploaded]
        self._photographs[place], self._uploaded, self._key = found, place, ""
        return {"kind": "uploaded", "path": place, "photographs": list(self._photographs)}

    @property
    def photographs(self) -> list[str]:
        """Paths that a scene of this tab may name."""
        return list(self._photographs)

    @property
    def pins(self) -> list[str]:
        """Names of the designs that are kept."""
        return list(self._pins)


def _around(tables: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
    """Tables beside some, for which programs of other sizes may be needed than for these."""

    def changed(section: str, key: str, factor: float) -> dict[str, Any]:
        table = tables.get(section, {})
        return {**tables, section: {**table, key: table[key] * factor}} if key in table else {}

    # In whatever unit the scene has them; changes of keys that it does not have come to nothing.
    for key in ("photon_rate_per_s", "white_e", "illuminance_lux"):
        yield changed("light", key, 1.02)
    for key in ("max_stroke_px", "max_stroke_mm"):
        yield changed("limits", key, 2.0)
        yield changed("limits", key, 0.5)
    uniform = tables.get("speeds", {}).get("uniform", {})
    for key in (name for name in uniform if name.startswith("max_")):
        one_sided = {**uniform, key: 0.9 * uniform[key]}
        yield {**tables, "speeds": {**tables["speeds"], "uniform": one_sided}}


def free_name(name: str, taken: Mapping[str, Any]) -> str:
    """A name that is not that of a row, with a number behind it where it would be."""
    from mishutter.search import taken_names

    used = {*taken, *taken_names(), OPTIMISED, DRAWN}
    tries = (name, *(f"{name} {number}" for number in range(2, len(used) + 3)))
    return next(each for each in tries if each not in used)


def _chips(drawn: list[float]) -> ChippedShutter:
    return ChippedShutter(np.asarray(drawn, np.float64))


@contextmanager
def _file(text: str, name: str) -> Iterator[Path]:
    """A file of a text while it is read, whose errors name the file of the user."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "design.json"
        path.write_text(text, "utf-8", errors="replace")
        try:
            yield path
        except (ValueError, OSError) as error:
            raise ValueError(str(error).replace(str(path), name)) from None


def _python(text: str, drawn: list[float] | None) -> str:
    """A program that finds the same numbers."""
    own = "" if drawn is None else f"drawn = ChippedShutter({[round(x, 6) for x in drawn]})\n"
    more = "" if drawn is None else ', "drawn": drawn'
    names = (
        "Scene, compare, optimise" if drawn is None else "ChippedShutter, Scene, compare, optimise"
    )
    return (
        "from pathlib import Path\n\nimport jax\n\n"
        'jax.config.update("jax_enable_x64", True)\n\n'
        f"from mishutter import {names}\n\n"
        f'Path("scene.toml").write_text("""\\\n{text}""")\n\n'
        'scene = Scene.load("scene.toml")\ndesign = optimise(scene)\n'
        f"print(design.metrics.expected_psnr)\n{own}"
        f'print(compare(scene, design.motion, {{"optimised": design{more}}}).text())\n'
    )


def with_design(started: Beginning, check: Callable[[int, float], None]) -> Beginning:
    """The beginning with the finished design of its scene."""
    return replace(started, design=optimise(started.scene(), progress=check))
