"""A scene of any direction on the page: the answer of the library, and the path of its stage."""

import base64
import io
import json

import numpy as np
import pytest
from PIL import Image
from support.plane import a_plane_design

from mishutter import Design, Exposures, PlaneFrames, PlaneSearch
from mishutter.explore.session import (
    Beginning,
    Order,
    Request,
    Session,
    SupersededError,
    with_design,
)
from mishutter.report import in_plane

TABLES = {
    "speeds": {"any_direction": {"max_px_per_s": 1700.0}},
    "light": {"photon_rate_per_s": 3e4},
    "sensor": {"read_noise_e": 9.0},
    "limits": {"max_half_exposure_ms": 10.0},
    "burst": {"frames_per_s": 90.0, "window_ms": 50.0, "max_frames": 3},
}


@pytest.fixture
def found(monkeypatch):
    """The search, in place of one that takes seconds, and the scenes that it was asked for."""
    burst, scenes = a_plane_design().sequence, []
    at_rest = PlaneFrames(np.zeros(1), np.full(1, 0.003), np.ones(1), np.zeros((2, 2)))
    one = Exposures("stills", at_rest, psnr=24.5)

    def best(scene, *, progress):
        progress(0.5)
        scenes.append(scene)
        return PlaneSearch(one, (burst,), 28.5)

    monkeypatch.setattr(in_plane, "best_in_plane", best)
    return scenes


def test_the_answer_comes_with_the_path_in_the_plane(found):
    """At once a word, then the library's answer and a picture; a request twice searches once."""
    started = with_design(Beginning(TABLES, {}), lambda step, value: None)
    session, asked = Session(started), Request(kind="design", id=3, scene=TABLES)
    assert list(session.ahead(TABLES)) == []
    assert session.first(asked)["kind"] == "plane"
    for _ in range(2):
        (answer,) = session.rest(asked, lambda: None)
    assert len(found) == 1
    assert float(found[0].velocities.fastest) == 1700
    own = in_plane.compare_in_plane(found[0])
    assert answer["verdict"] == own.text().splitlines()[0]
    assert "ceiling of any path" in answer["answer"]
    picture = Image.open(io.BytesIO(base64.b64decode(answer["picture"])))
    assert np.ptp(np.asarray(picture.convert("L"))) > 200
    assert picture.size == (814, 682)


def test_a_newer_request_stops_the_search(found):
    """The search asks between its steps whether it is still wanted."""

    def check():
        raise SupersededError

    session = Session(Beginning(TABLES, {}))
    with pytest.raises(SupersededError):
        next(session.rest(Request(kind="design", id=1, scene=TABLES), check))
    assert found == []


def test_its_design_and_its_program_are_of_the_plane(found, tmp_path):
    """The file is that of `optimise`, and the program searches in the plane."""
    session = Session(Beginning(TABLES, {}))
    list(session.rest(Request(kind="design", id=1, scene=TABLES), lambda: None))
    text = session.answer(Order(kind="save_design", scene=TABLES))["text"]
    assert json.loads(text)["plane"]["kind"] == "two sines"
    (tmp_path / "design.json").write_text(text, encoding="utf-8")
    assert Design.load(tmp_path / "design.json").scene.velocities.fastest == 1700
    recipe = session.answer(Order(kind="recipe", scene=TABLES))
    assert "best_in_plane(scene)" in recipe["python"]
    assert "any_direction" in recipe["command"]
    compile(recipe["python"], "recipe", "exec")
    other = TABLES | {"light": {"photon_rate_per_s": 4e4}}
    with pytest.raises(ValueError, match="be finished before it is saved"):
        session.answer(Order(kind="save_design", scene=other))
