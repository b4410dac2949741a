"""The page in a real browser: every control, two tabs, and the library's numbers on it.

Each test has a tab of its own, which begins at the scene of the file.
"""

import time
import tomllib

import numpy as np
import pytest
from PIL import Image
from support import chromium

from mishutter import ChippedShutter, Design, Scene, evaluate, optimise

pytestmark = [
    pytest.mark.skipif(chromium.MISSING is not None, reason=str(chromium.MISSING)),
    pytest.mark.filterwarnings("ignore::ResourceWarning"),  # of sockets that selenium leaves open
    pytest.mark.slow,
]

SCENE = """
[speeds]
uniform = { min_px_per_s = -310, max_px_per_s = 310, count = 3 }
[light]
photon_rate_per_s = 2.3e5
[sensor]
read_noise_e = 4.7
[limits]
max_stroke_px = 7.3
max_top_speed_px_per_s = 1300
min_half_exposure_ms = 2.1
max_half_exposure_ms = 17
[picture]
path = "example"
"""

TABLE = "window.mishutter?.answers.table > 0"
"""Whether a table has come, with the verdict."""


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    return tmp_path_factory.mktemp("page")


@pytest.fixture(scope="module")
def served(place):
    """A browser, and the address of the page of a small scene."""
    pytest.importorskip("selenium")
    (place / "scene.toml").write_text(SCENE)
    (place / "downloads").mkdir()
    with (
        chromium.explorer(str(place / "scene.toml")) as (address, _),
        chromium.browser(downloads=place / "downloads") as driver,
    ):
        yield driver, address


@pytest.fixture
def page(served):
    """The browser at a new tab of the page that was first answered.

    Its console stays quiet, and all that it loads in any test comes from its own server.
    """
    driver, address = served
    own = driver.current_window_handle
    driver.switch_to.new_window("tab")
    chromium.resize(driver, 1280, 800)
    driver.get(address)
    chromium.wait(driver, "window.mishutter?.answers.first > 0")
    yield driver
    loaded = driver.execute_script(
        "return performance.getEntriesByType('resource').map(e => e.name)"
    )
    said = [entry["message"] for entry in chromium.complaints(driver)]
    for handle in set(driver.window_handles) - {own}:
        driver.switch_to.window(handle)
        driver.close()
    driver.switch_to.window(own)
    assert [message for message in said if "favicon" not in message] == []
    assert loaded
    assert [name for name in loaded if not name.startswith((address, "data:"))] == []


def downloaded(place, name):
    """The text of a file that the page saved."""
    for _ in range(2400):
        path = place / "downloads" / name
        if path.exists():
            text = path.read_text("utf-8")
            path.unlink()
            return text
        time.sleep(0.1)
    raise AssertionError(name)


def click(page, name):
    """Click on what a reader scrolls to: the header stays above what is scrolled beneath it."""
    button = page.find_element("id", name)
    page.execute_script("arguments[0].scrollIntoView({block: 'center'})", button)
    button.click()


def scene_of(page):
    return page.execute_script("return window.mishutter.state.scene")


def numbers(answer, name="optimised"):
    return answer["curves"][name]["numbers"]


def test_the_page_shows_the_librarys_numbers(page, place):
    """The design, verdict and ceiling of a scene that was moved are those of the saved file."""
    answer = chromium.after(
        page, "table", lambda: chromium.slide(page, "light.photon_rate_per_s", 430)
    )
    finished = page.execute_script("return window.mishutter.latest.finished")
    click(page, "save-scene")
    (place / "moved.toml").write_text(downloaded(place, "scene.toml"))
    design = optimise(Scene.load(place / "moved.toml"))
    assert numbers(finished)["psnr"] == pytest.approx(float(design.metrics.expected_psnr), rel=1e-9)
    assert page.find_element("id", "verdict").text == answer["verdict"]
    assert page.find_element("id", "answer").text == answer["answer"].strip()
    cells = page.find_elements("css selector", "tr[data-name='optimised'] td")
    assert cells[1].text == f"{float(design.metrics.expected_psnr):.2f}"
    click(page, "save-design")
    (place / "saved.json").write_text(downloaded(place, "design.json"))
    assert Design.load(place / "saved.json").loss == pytest.approx(design.loss, rel=1e-9)


def test_every_control_moves_the_design(page):
    """Each slider and each number changes the scene and is answered, without a complaint."""
    sliders = page.execute_script(
        "return [...document.querySelectorAll('.field input[type=range]')]"
        ".map(s => s.closest('.field').dataset.place)"
    )
    assert {"light.photon_rate_per_s", "limits.max_stroke_px"} < set(sliders)
    for place in sliders:
        before = scene_of(page)
        chromium.after(page, "first", lambda place=place: chromium.slide(page, place, 480))
        assert scene_of(page) != before, place
        assert not page.find_element("id", "problem").is_displayed(), place
        chromium.after(page, "first", lambda: click(page, "undo"))
        assert scene_of(page) == before


def test_frames_of_a_burst_have_sliders_and_rows(page):
    """Their rate and their number slide, the number in whole steps, and the table has bursts."""
    tick = "fieldset[data-place=burst] > legend input"
    chromium.after(page, "first", lambda: page.find_element("css selector", tick).click())
    chromium.after(page, "first", lambda: chromium.slide(page, "burst.frames_per_s", 650))
    answer = chromium.after(page, "table", lambda: chromium.slide(page, "burst.max_frames", 317))
    burst = scene_of(page)["burst"]
    assert burst["frames_per_s"] != pytest.approx(240)
    assert isinstance(burst["max_frames"], int)
    assert 1 < burst["max_frames"] < 8
    names = {row["name"] for row in answer["rows"]}
    assert {"best still burst", "best moving burst"} <= names


def test_a_bad_number_is_said_and_the_design_stays(page):
    """What the library refuses is shown in its words; a good number takes it away."""
    chromium.wait(page, TABLE)
    box = page.find_element("id", "f-sensor-read_noise_e")
    shown = page.find_element("id", "verdict").text
    box.clear()
    box.send_keys("-3\t")
    chromium.wait(
        page,
        "!document.getElementById('problem').hidden && "
        "document.getElementById('problem').textContent.includes('at least 0')",
    )
    assert page.find_element("id", "verdict").text == shown
    chromium.after(page, "first", lambda: click(page, "undo"))
    assert not page.find_element("id", "problem").is_displayed()


def test_a_section_is_put_in_and_taken_out(page):
    """A tick puts a section in with values that work; another takes it out."""
    tick = "fieldset[data-place=shutter] > legend input"
    answer = chromium.after(page, "first", lambda: page.find_element("css selector", tick).click())
    assert scene_of(page)["shutter"]["transmission"] == 0.85
    behind = numbers(answer)["psnr"]
    answer = chromium.after(page, "first", lambda: page.find_element("css selector", tick).click())
    assert "shutter" not in scene_of(page)
    # The design of this scene stays open, and so needs no device.
    assert numbers(answer)["psnr"] == pytest.approx(behind, rel=1e-12)


@pytest.mark.slow
def test_a_drawn_profile_is_measured(page):
    """Strokes of the mouse make a profile, whose cost on the same motion is the library's."""
    from selenium.webdriver.common.action_chains import ActionChains

    click(page, "draw")
    chart = page.find_element("id", "profile")
    page.execute_script("arguments[0].scrollIntoView({block: 'center'})", chart)
    stroke = ActionChains(page, duration=20).move_to_element_with_offset(chart, -90, 30)
    stroke.click_and_hold().move_by_offset(60, -50).move_by_offset(70, 45).release()
    answer = chromium.after(page, "table", stroke.perform)
    drawn = page.execute_script("return window.mishutter.state.drawn")
    assert np.ptp(drawn) > 0.2
    finished = page.execute_script("return window.mishutter.latest.finished")
    motion_numbers = numbers(finished)
    assert "dB below the optimised one" in page.find_element("id", "cost").text
    click(page, "recipe")
    chromium.wait(page, "document.getElementById('commands').open")
    program = page.find_element("id", "python").text
    page.find_element("css selector", "#commands form button").click()
    text = program.split('r"""\n')[1].split('"""')[0]
    assert tomllib.loads(text) == scene_of(page)
    (design,) = [optimise(scene_at(text))]
    assert float(design.motion.exposure) * 1e3 == pytest.approx(motion_numbers["open_ms"], rel=1e-6)
    level = evaluate(design.scene, design.motion, ChippedShutter(np.array(drawn))).expected_psnr
    assert numbers(finished, "drawn")["psnr"] == pytest.approx(float(level), rel=1e-6)
    assert "drawn" in [row["name"] for row in answer["rows"]]


def scene_at(text):
    import tempfile
    from pathlib import Path

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.toml"
        path.write_text(text)
        return Scene.load(path)


def pin(page):
    """Pin the finished design, and see the page answered."""
    chromium.wait(page, "!document.getElementById('pin').disabled")
    chromium.after(page, "first", lambda: click(page, "pin"))


def uploaded(page, place, kind="photograph"):
    """Upload a picture; the answer to it of some kind."""
    noise = np.random.default_rng(5).integers(40, 200, (60, 75), dtype=np.uint8)
    Image.fromarray(np.repeat(np.repeat(noise, 4, 0), 4, 1)).save(place / "mine.png")
    box = page.find_element("id", "picture-file")
    return chromium.after(page, kind, lambda: box.send_keys(str(place / "mine.png")))


def test_a_photograph_is_uploaded_and_magnified(page, place):
    """An upload is the scene's photograph; one place is magnified in all pictures."""
    box = page.find_element("id", "picture-file")
    shown = uploaded(page, place)
    assert scene_of(page)["picture"] == {"path": "mine.png"}
    assert [each["name"] for each in shown["designs"]] == ["optimised", "best snapshot"]
    canvas = "document.querySelector('#panels canvas')"
    still = page.execute_script(f"return {canvas}.toDataURL()")
    page.execute_script(
        f"const c = {canvas}, b = c.getBoundingClientRect(); c.dispatchEvent(new PointerEvent("
        "'pointermove', {clientX: b.x + b.width / 3, clientY: b.y + b.height / 2}))"
    )
    assert page.execute_script(f"return {canvas}.toDataURL()") != still
    box.send_keys(str(place / "scene.toml"))
    chromium.wait(page, "document.getElementById('problem').textContent.includes('PNG, JPEG')")


def test_a_reload_keeps_the_scene_and_a_second_tab_has_its_own(page):
    """What was moved is there after a reload; another tab begins anew, and each is answered."""
    chromium.after(page, "first", lambda: chromium.slide(page, "sensor.read_noise_e", 900))
    moved, first = scene_of(page), page.current_window_handle
    address = page.current_url
    page.refresh()
    chromium.wait(page, "window.mishutter?.answers.first > 0")
    assert scene_of(page) == moved
    page.switch_to.new_window("tab")
    page.get(address)
    chromium.wait(page, "window.mishutter?.answers.first > 0")
    assert scene_of(page) == tomllib.loads(SCENE)
    own = page.execute_script("return window.mishutter.latest.first")
    page.close()
    page.switch_to.window(first)
    other = page.execute_script("return window.mishutter.latest.first")
    assert numbers(own)["psnr"] > numbers(other)["psnr"] + 0.1


def filled(page, place):
    """An upload, a pin and a slider moved; the scene before the slider."""
    uploaded(page, place, "finished")
    pin(page)
    before = scene_of(page)
    chromium.after(page, "first", lambda: chromium.slide(page, "sensor.read_noise_e", 700))
    return before


def pinned(page):
    return [part.text for part in page.find_elements("css selector", "#pins span")]


def test_a_reload_keeps_photograph_pins_and_undo(page, place):
    """All that the page held is there again, and goes on working.

    A pin is a row of the table until it is taken away.
    """
    before = filled(page, place)
    moved = scene_of(page)
    page.refresh()
    chromium.wait(page, "window.mishutter?.answers.photograph > 0")
    assert scene_of(page) == moved
    assert moved["picture"] == {"path": "mine.png"}
    assert pinned(page) == ["pin 1×"]
    assert page.find_elements("css selector", "tr[data-name='pin 1']")
    assert not page.find_element("id", "lost").is_displayed()
    chromium.after(page, "first", lambda: click(page, "undo"))
    assert scene_of(page) == before
    tables = page.execute_script("return window.mishutter.answers.table")
    page.find_element("css selector", "#pins button").click()
    # The table of what was undone, which has the pin, may come first.
    gone = """!document.querySelector("tr[data-name='pin 1']")"""
    chromium.wait(page, f"window.mishutter.answers.table > {tables} && {gone}")
    assert pinned(page) == []


def test_a_server_that_began_anew_is_said(page, place):
    """The page names what it no longer has, until the next change, and keeps the rest."""
    before = filled(page, place)
    page.execute_script(
        "const kept = JSON.parse(sessionStorage['mishutter-tab']);"
        "sessionStorage['mishutter-tab'] = JSON.stringify({...kept, key: 'of another server'});"
    )
    page.refresh()
    chromium.wait(page, "window.mishutter?.answers.first > 0")
    lost = page.find_element("id", "lost").text
    assert lost.startswith("No longer on the server: pin 1, mine.png;")
    assert scene_of(page)["picture"] == {"path": "example"}
    assert pinned(page) == []
    chromium.after(page, "first", lambda: click(page, "undo"))
    assert scene_of(page) == before | {"picture": {"path": "example"}}
    lost = page.find_element("id", "lost").text
    assert lost.startswith("No longer on the server: mine.png;")
    chromium.after(page, "first", lambda: chromium.slide(page, "sensor.read_noise_e", 300))
    assert not page.find_element("id", "lost").is_displayed()
    assert not page.find_element("id", "problem").is_displayed()
