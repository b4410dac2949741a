"""One tab: its answers are the library's numbers, and nothing that it is sent grows or escapes."""

import base64
import io
import json
import re
import tomllib
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import tifffile
from PIL import Image
from support.command_line import SMALL_SCENE
from support.drive import a_design

from mishutter import (
    ChippedShutter,
    HannShutter,
    Limits,
    ParabolicMotion,
    RectShutter,
    Scene,
    SecondOrderStage,
    SplineShutter,
    StillCamera,
    compare,
    evaluate,
    optimise,
)

# The face starts a server; answers are checked without one.
from mishutter.evaluation.speed_knowledge import SPEED_KNOWLEDGE
from mishutter.explore import pictures
from mishutter.explore import session as sessions
from mishutter.explore.answers import curves, first_answer
from mishutter.explore.session import Order, Request, Session, SupersededError
from mishutter.model.exposures import Exposures
from mishutter.pictures.images import LUMINANCE
from mishutter.report import comparison
from mishutter.search.rows import Row
from mishutter.search.space import beyond_limits

TABLES = tomllib.loads(SMALL_SCENE.replace('path = "photo.png"', "mean_level = 0.23"))
del TABLES["motion"]
ROWS = ("optimised", "best snapshot")
PARABOLA = ParabolicMotion(acceleration=45 / 0.015**2, half_exposure=0.015)
DRAWN = [round(0.2 + 0.6 * (chip % 5) / 4, 3) for chip in range(sessions.NUM_CHIPS)]


@pytest.fixture(scope="module")
def started():
    """A small scene and its finished design."""
    tables = tomllib.loads(sessions.scene_text(TABLES))
    photographs = sessions.beginning(None).photographs
    return sessions.with_design(sessions.Beginning(tables, photographs), lambda step, value: None)


def request(number=1, *, light=2.3e5, **others):
    scene = TABLES | {"light": {"photon_rate_per_s": light}}
    return Request(kind="design", id=number, scene=scene, rows=ROWS, **others)


def psnr(answer, name="optimised"):
    return answer["curves"][name]["numbers"]["psnr"]


def library_scene(light=2.3e5):
    return sessions.built(TABLES | {"light": {"photon_rate_per_s": light}}, {})


def parts(session, asked, last=None):
    """Answers by their kinds, up to the last that is asked for: all without."""
    answers = {}
    for part in session.rest(asked, lambda: None):
        answers[part["kind"]] = part
        if part["kind"] == last:
            break
    return answers


def test_a_scene_may_be_in_units_of_ones_own():
    """The page begins at half of its largest speed, and scenes beside it are in its units too."""
    units = {
        "speeds": {"uniform": {"min_mm_per_s": -1.0, "max_mm_per_s": 1.0, "count": 5}},
        "view": {"px_per_mm": 800.0},
        "light": {"white_e": 900.0, "white_ms": 5.0},
        "sensor": {"read_noise_e": 4.0, "pixel_pitch_um": 5.0, "axis": "columns"},
        "limits": {"max_stroke_mm": 0.1},
    }
    assert sessions.Beginning(units, {}).speed == 400
    # A session starts a search in each of these scenes, and holds no other sign of them.
    beside = [sessions.built(tables, {}) for tables in sessions._around(units) if tables]
    strokes, rates, fastest = (
        {round(float(number), 6) for number in numbers}
        for numbers in (
            [scene.limits.max_stroke for scene in beside],
            [scene.photon_rate for scene in beside],
            [scene.speeds[-1] for scene in beside],
        )
    )
    assert (strokes, rates, fastest) == ({20, 40, 10}, {1.8e5, 1.836e5}, {800, 720})


@pytest.mark.slow
def test_the_first_answer_is_a_design_for_the_new_scene(started):
    """It is no worse than the design before it, measured on the new scene."""
    answer = Session(started).first(request(light=1.1e5))
    before = evaluate(library_scene(1.1e5), started.design.motion, started.design.shutter)
    assert psnr(answer) >= float(before.expected_psnr) - 1e-9
    assert psnr(answer) < float(started.design.metrics.expected_psnr)


@pytest.mark.slow
def test_first_answers_are_within_what_the_stage_reaches(started):
    """Also where its travel and its acceleration end sooner than stroke and top speed."""
    motion = ParabolicMotion(acceleration=3.6e4, half_exposure=0.013)
    before = started.design.with_one(motion=motion)
    tables = TABLES | {"limits": TABLES["limits"] | {"max_travel_px": 4.5}}
    scene = sessions.built(tables | {"light": {"photon_rate_per_s": 1.9e5}}, {})
    for turn in (0, 1):
        found = first_answer(scene, before, turn)
        assert not beyond_limits(scene, found.motion, found.shutter)
    assert beyond_limits(scene, motion, before.shutter) == ("travel",)


def test_a_first_answer_leaves_room_for_the_pan():
    """Of the top speed and the stroke, what panning takes is no more there for the parabola."""
    limits = Limits(max_stroke=60.0, max_top_speed=4e3, max_half_exposure=0.02)
    scene = Scene([1900.0, 2300.0], photon_rate=2e5, read_noise=6.0, limits=limits)
    pan = {"half_exposure": 6e-3, "velocity": 1800.0}
    most = float(limits.largest_acceleration(np.asarray(6e-3), np.asarray(1800.0)))
    motion = ParabolicMotion(acceleration=most, **pan)
    before = a_design(SplineShutter([0.3, 0.8, 1.0, 0.6]), scene=scene, motion=motion)
    for turn in (0, 1):
        answer = first_answer(scene, before, turn)
        half, velocity = answer.motion.half_exposure, answer.motion.velocity
        reach = float(limits.largest_acceleration(half, velocity))
        assert abs(float(velocity)) > 1000
        assert float(answer.motion.acceleration) == pytest.approx(reach, rel=1e-6)


@pytest.mark.slow
def test_tolerances_are_drawn_beside(started):
    """A scene with tolerances has every curve of the camera as it is designed."""
    asked = request(light=1.3e5)
    off = {"delay_us": 70.0, "object_speed_px_per_s": 45.0}
    within = asked.model_copy(update={"scene": asked.scene | {"tolerances": off}})
    answer = Session(started).first(within)["curves"]["optimised"]
    assert len(answer["psnr"]) == len(answer["speeds"]) == 3
    assert min(answer["psnr"]) < answer["numbers"]["psnr"] < max(answer["psnr"])


@pytest.mark.slow
def test_numbers_of_the_page_are_of_the_scene_with_its_background():
    """What is drawn at once, and what stands in the table, are what `evaluate` measures."""
    section = {"front_share": 0.41, "object_width_px": 37.0, "background": "moving"}
    before = sessions.built(TABLES | {"occlusion": section}, {})
    motion = ParabolicMotion(acceleration=4.1e4, half_exposure=0.011)
    level = float(evaluate(before, motion, HannShutter()).expected_psnr)
    for at_once in (True, False):
        drawn = curves(before, motion, HannShutter(), at_once=at_once)
        assert drawn["numbers"]["psnr"] == pytest.approx(level, abs=1e-4)
    whole = sessions.built(TABLES, {})
    assert level < float(evaluate(whole, motion, HannShutter()).expected_psnr) - 0.05


@pytest.mark.slow
def test_curves_and_numbers_are_of_the_decoder_of_the_scene():
    """Its level is drawn at once as `evaluate` measures it, and its worst speed is in the table."""
    motion = ParabolicMotion(acceleration=1.3e5, half_exposure=0.011)
    lines = {}
    for knows, filter_ in (("unknown", "one filter"), ("found", "true"), ("known", "knows")):
        scene = sessions.built(TABLES | {"decoder": {"speed": knows}}, {})
        metrics = evaluate(scene, motion, HannShutter())
        for at_once in (True, False):
            drawn = curves(scene, motion, HannShutter(), at_once=at_once)
            level = float(SPEED_KNOWLEDGE[knows].psnr(metrics))
            assert drawn["numbers"]["psnr"] == pytest.approx(level, abs=1e-4)
        lines[knows] = drawn["psnr"]
        assert filter_ in drawn["of_decoder"]
        worst = SPEED_KNOWLEDGE[knows].worst_psnr(metrics)
        assert drawn["numbers"].get("worst_speed_psnr") == worst
        assert worst is None or min(drawn["psnr"]) == pytest.approx(float(worst), abs=1e-3)
    assert lines["found"] == lines["known"] != lines["unknown"]


def test_what_to_send_to_the_stage_is_drawn_beside_the_motion():
    """Where the scene knows how it follows: turning before the sensor does."""
    followed = TABLES | {"stage": {"bandwidth_hz": 60.0, "damping": 0.7}}
    motion = ParabolicMotion(acceleration=1.3e5, half_exposure=0.011)
    drawn = curves(sessions.built(followed, {}), motion, HannShutter(), at_once=True)
    time, sent, path = (np.array(drawn[name]) for name in ("path_time", "sent", "path"))
    delay = float(time[np.argmin(path)] - time[np.argmin(sent)])
    assert delay == pytest.approx(SecondOrderStage(bandwidth=60.0).delay * 1e3, abs=0.3)
    assert "sent" not in curves(library_scene(), motion, HannShutter(), at_once=True)


class Answered(NamedTuple):
    """A tab with a drawn profile, pins and a photograph, and all that it answers to one scene."""

    session: Session
    scene: Scene
    names: list[str]  # Of the pins as they were put in
    saved: str  # The pinned design, as the page saves it
    first: dict
    rest: dict


@pytest.fixture(scope="module")
def answered(started):
    """The search and the comparison of one tab, which the tests below look at from each side."""
    session = Session(started)
    names = [session.answer(Order(kind="pin", name="Hann"))["pins"][-1] for _ in range(2)]
    saved = session.answer(Order(kind="save_design"))["text"]
    load = Order(kind="load_design", name="mine.json", text=saved)
    names += session.answer(load)["pins"][-1:]
    session.upload("mine.png", picture_file(rows=30, columns=260))
    asked = request(light=1.4e5, drawn=DRAWN, speed=310.0)
    asked = asked.model_copy(update={"scene": asked.scene | {"picture": {"path": "mine.png"}}})
    first = session.first(asked)
    rest = parts(session, asked)
    scene = sessions.built(asked.scene, session._photographs)
    return Answered(session, scene, names, saved, first, rest)


@pytest.mark.slow
def test_the_finished_design_and_the_table_are_the_librarys(started, answered):
    """`optimise` and `compare` give the numbers of the page, to the last digit."""
    scene, found = answered.scene, answered.rest
    design = optimise(scene)
    assert psnr(found["finished"]) == float(design.metrics.expected_psnr)
    own = ChippedShutter(np.array(DRAWN))
    level = float(evaluate(scene, design.motion, own).expected_psnr)
    assert psnr(found["finished"], "drawn") == level
    assert psnr(answered.first, "drawn") != level  # on the motion of the first answer
    pins = dict.fromkeys(answered.names, started.design)
    rows = compare(scene, design.motion, {"optimised": design, **pins, "drawn": own})
    shown = {row["name"]: row for row in found["table"]["rows"]}
    assert f"{found['table']['verdict']}\n\n{found['table']['answer']}" == rows.text()
    assert found["table"]["ceiling"] == rows.ceiling
    for name in ("optimised", "drawn", "Hann", "best snapshot"):
        level = float(rows.row(name).metrics.expected_psnr)
        assert shown[name]["cells"][:2] == [name, f"{level:.2f}"]
    assert set(found["table"]["curves"]) == {"best snapshot"}


def test_a_table_is_compared_anew_for_another_drawing_or_pin(monkeypatch):
    """And once where the same is asked again."""
    session, design, seen = Session(sessions.Beginning(TABLES, {})), a_design(HannShutter()), []

    def compared(scene, motion, entries, progress):
        seen.append([*entries])
        return comparison.Comparison((), "V.", 0.1, 31.0)

    monkeypatch.setattr(comparison, "compare", compared)
    session.begin(design)
    for drawn in (None, None, DRAWN, DRAWN[::-1], DRAWN[::-1]):
        session._compare(library_scene(), request(drawn=drawn), lambda: None)
    session._pins["mine"] = design
    session._compare(library_scene(), request(), lambda: None)
    assert seen == [["optimised"], *[["optimised", "drawn"]] * 2, ["optimised", "mine"]]


@pytest.mark.slow
def test_a_photograph_is_captured_and_restored(answered):
    """Every chosen row has a capture and a restored picture of one size, with the PSNR."""
    shown = answered.rest["photograph"]
    assert [each["name"] for each in shown["designs"]] == list(ROWS)
    sizes = {opened(each[k]).size for each in shown["designs"] for k in ("captured", "restored")}
    assert sizes == {opened(shown["reference"]).size}
    assert all(10 < each["psnr"] < 60 for each in shown["designs"])
    assert [each["found"] for each in shown["designs"]] == [None, None]


@pytest.mark.slow
def test_the_speed_that_is_found_stands_beside_the_picture():
    """With its error, where the scene's decoder finds it; of a blur too short, with the doubt."""
    begun = sessions.beginning(None)
    taken = begun.photographs["example"](None, False, "rows")
    scene = sessions.built(begun.tables | {"decoder": {"speed": "found"}}, begun.photographs)
    rows = {
        name: Row(
            "own best motion",
            name,
            Exposures.of_one(motion, RectShutter()),
            None,
            evaluate(scene, motion, RectShutter()),
        )
        for name, motion in (("snapshot", StillCamera(half_exposure=0.001)), ("open", PARABOLA))
    }
    shown = taken.restored(scene, rows, 2960.0, lambda: None)["designs"]
    short, told = (each["found"] for each in shown)
    assert not short["trusted"]
    assert short["tells_nothing"]
    assert short["doubt"].startswith("The blur differs by only 9.0 px over the speeds of the scene")
    assert told["trusted"]
    assert told["doubt"] == ""
    assert abs(told["speed"] - 2960) < 3 * told["error"] < 250
    assert shown[1]["psnr"] > shown[0]["psnr"] + 1


def opened(text):
    return Image.open(io.BytesIO(base64.b64decode(text)))


def picture_file(rows, columns, form="PNG"):
    noise = np.random.default_rng(3).integers(30, 220, (rows, columns // 4 + 1), dtype=np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(np.repeat(noise, 4, axis=1)[:, :columns]).save(buffer, form)
    return buffer.getvalue()


@pytest.mark.slow
def test_work_that_nobody_waits_for_ends(started):
    """The check that a newer request makes fail ends the search in its middle."""
    session = Session(started)
    asked = request(light=1.7e5)
    session.first(asked)
    calls = []

    def check():
        calls.append(1)
        raise SupersededError

    with pytest.raises(SupersededError):
        next(session.rest(asked, check))
    assert len(calls) == 1


@pytest.mark.slow
def test_pins_are_bounded_and_are_rows_of_the_table(answered):
    """A pin is a design as it was; one too many is refused, and a name is taken once."""
    session = answered.session
    assert answered.names == ["Hann 2", "Hann 3", "mine"]
    rows = {row["name"]: row for row in answered.rest["table"]["rows"]}
    mine, pinned, best = (float(rows[n]["cells"][1]) for n in ("mine", "Hann 2", "optimised"))
    assert mine == pinned <= best
    for _ in range(sessions.MOST_PINS - 3):
        session.answer(Order(kind="load_design", name="x.json", text=answered.saved))
    with pytest.raises(ValueError, match="`pins` must be at most 6"):
        session.answer(Order(kind="pin"))
    assert "mine" not in session.answer(Order(kind="unpin", name="mine"))["pins"]


@pytest.mark.slow
def test_a_scene_is_saved_loaded_and_written_as_commands(started):
    """A saved scene loads to the same tables; the commands hold it and what was drawn."""
    session = Session(started)
    text = session.answer(Order(kind="save_scene", scene=TABLES))["text"]
    assert session.answer(Order(kind="load_scene", text=text))["scene"] == TABLES
    recipe = session.answer(Order(kind="recipe", scene=TABLES, drawn=DRAWN))
    assert text in recipe["command"]
    assert recipe["command"].endswith("mishutter optimise scene.toml\n")
    compile(recipe["python"], "recipe", "exec")
    assert f"ChippedShutter({DRAWN})" in recipe["python"]


NAMES = ['my "own".png', r"C:\new\u0041.png", "\u00e9t\u00e9.png"]


@pytest.mark.parametrize("name", NAMES)
def test_a_recipe_writes_the_scene_with_any_name_of_a_photograph(name, tmp_path, monkeypatch):
    """Quotes and backslashes of TOML reach the file through the Python program."""
    scene = TABLES | {"picture": {"path": name}}
    program = sessions._python(sessions.scene_text(scene), None, in_plane=False)
    monkeypatch.chdir(tmp_path)
    # The part that searches takes seconds, and reads the file as any scene.
    writes = program[program.index("Path(") : program.index("scene = Scene")]
    exec(writes, {"Path": Path})
    assert tomllib.loads((tmp_path / "scene.toml").read_text("utf-8")) == scene


@pytest.mark.parametrize(
    ("content", "line"),
    [
        (b"[speeds]\n# \xff", "must be UTF-8 text; got byte 11 of it"),
        (b"[speeds]\nlist = ", "must be a TOML file; got"),
    ],
)
def test_a_file_that_is_no_scene_is_refused_by_its_name(content, line, tmp_path):
    """The page begins with none that a command refuses."""
    place = tmp_path / "mine.toml"
    place.write_bytes(content)
    with pytest.raises(ValueError, match=re.escape(f"{place} {line}")):
        sessions.beginning(place)


@pytest.mark.parametrize("dtype", [np.float32, np.uint16])
def test_a_photograph_of_any_depth_that_files_have_is_taken(started, dtype):
    """A TIFF in colour, of floating-point numbers or of 16 bits, is read as `read_picture` does."""
    light = np.random.default_rng(3).uniform(0.1, 0.9, (20, 80, 3))
    pixels = light.astype(dtype) if dtype == np.float32 else (light * 65535).astype(dtype)
    content = io.BytesIO()
    tifffile.imwrite(content, pixels, photometric="rgb")
    session = Session(started)
    session.upload("mine.tif", content.getvalue())
    scene = sessions.built(TABLES | {"picture": {"path": "mine.tif"}}, session._photographs)
    expected = light if dtype == np.float32 else light**2.2
    assert float(scene.picture.mean_level) == pytest.approx(np.mean(expected @ LUMINANCE), rel=1e-3)


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({"light": {"photon_rate_per_s": -1.0}}, r"\[light\] photon_rate_per_s"),
        ({"light": {"photon_rate_per_s": float("nan")}}, "photon_rate_per_s"),
        ({"light": {"photon_rate_per_s": "1e5"}}, "be a number"),
        ({"light": 3}, "be a table"),
        ({"lamp": {}}, "known keys only"),
        ({"speeds": {"list_px_per_s": [1e6] * 5}}, "travel at most"),
        ({"speeds": {"list_px_per_s": [1.0] * 1001}}, "at most 1000"),
        ({"picture": {"path": "/etc/hostname"}}, "be one of example"),
        ({"picture": {"path": "example", "mean_level": 0.2}}, "not stand beside path"),
        ({"picture": {"path": "../../../etc/passwd"}}, "be one of example"),
    ],
)
def test_a_scene_that_is_none_is_refused_in_a_line(started, change, line):
    """What a page sends is checked as a file is, and reads no file of this machine."""
    asked = Request(kind="design", id=1, scene=TABLES | change)
    with pytest.raises(ValueError, match=line):
        Session(started).first(asked)


@pytest.mark.parametrize(
    ("name", "content", "line"),
    [
        ("notes.txt", b"text", "be a PNG, JPEG, TIFF"),
        ("broken.png", b"\x89PNG\r\n\x1a\n" + b"x" * 40, "broken.png must be a PNG"),
        ("half.png", picture_file(40, 300)[:-400], "half.png"),
        ("empty.png", b"", "hold at most 32 MiB"),
        ("large.png", b"x" * ((32 << 20) + 1), "hold at most 32 MiB"),
        ("example", b"x", "have a name of its own"),
        ("thin.png", picture_file(9, 5), "at least 8 px"),
    ],
)
def test_an_upload_that_is_no_photograph_is_refused(started, name, content, line):
    """The line names the user's file, and an earlier photograph stays."""
    session = Session(started)
    session.upload("mine.png", picture_file(20, 80))
    with pytest.raises(ValueError, match=line):
        session.upload(name, content)
    assert session.photographs == ["example", "print", "cells", "mine.png"]


def test_a_picture_of_too_many_pixels_is_refused_by_its_header(started, monkeypatch):
    """It is not decoded: a small file may hold a picture that fills the memory."""
    # A picture beyond the package's own limit takes seconds to make; reading it would fail.
    monkeypatch.setattr(pictures, "MOST_PIXELS", 500)
    monkeypatch.setattr(pictures, "read_picture", None)
    with pytest.raises(ValueError, match="at most 500 pixels"):
        Session(started).upload("bomb.png", picture_file(40, 300))


def test_numbers_of_an_upload_may_be_told(started):
    """The page's scene has the keys of a file, by which the photograph is read again."""
    session = Session(started)
    session.upload("mine.png", picture_file(20, 80))
    found = []
    for told in ({}, {"white": 300.0}, {"linear": True}):
        scene = TABLES | {"picture": {"path": "mine.png", **told}}
        # A search of the whole scene takes long; what it would read is what matters.
        found.append(sessions.built(scene, session._photographs))
    plain, whiter, linear = (float(scene.picture.mean_level) for scene in found)
    assert whiter == pytest.approx(plain * (255 / 300) ** 2.2, rel=1e-5)
    assert linear > 1.2 * plain
    assert (found[1].picture.white, found[2].picture.linear) == (300.0, True)
    with pytest.raises(ValueError, match=r"`\[picture\] white` must stand beside the path"):
        sessions.built(TABLES | {"picture": {"path": "example", "white": 3.0}}, {})


def test_an_upload_takes_the_place_of_the_one_before(started):
    """One photograph a tab is kept, by its name without folders."""
    session = Session(started)
    session.upload("first.png", picture_file(20, 80))
    answer = session.upload("../folder/second.jpg", picture_file(20, 80, "JPEG"))
    assert answer["photographs"] == ["example", "print", "cells", "second.jpg"]


@pytest.mark.parametrize(
    ("order", "line"),
    [
        (Order(kind="halt"), "a message"),
        (Order(kind="load_scene", text="[light"), "TOML file"),
        (Order(kind="load_scene", text="[light]\nx = 1"), "known keys"),
        (Order(kind="load_design", text="{}", name="d.json"), "d.json"),
        (Order(kind="load_design", text="[" * 100_000, name="d.json"), "d.json"),
        (Order(kind="save_scene", scene={"light": {}}), "must be given"),
    ],
    ids=lambda value: value if isinstance(value, str) else value.kind,
)
def test_an_order_that_cannot_be_met_is_refused_in_a_line(started, order, line):
    """Each line says what must hold and what came."""
    with pytest.raises(ValueError, match=line) as refusal:
        Session(started).answer(order)
    assert "; got" in str(refusal.value)


@pytest.mark.slow
def test_a_dark_drawing_is_measured(started):
    """A profile that is closed throughout loses the whole picture, and nothing fails."""
    answer = Session(started).first(request(drawn=[0.0] * sessions.NUM_CHIPS))
    assert psnr(answer, "drawn") < psnr(answer) - 3
    json.dumps(answer["curves"]["drawn"]["profile"], allow_nan=False)
