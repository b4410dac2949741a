"""A headless Chromium of this machine, and how scripts drive the live page with it."""

import contextlib
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from support.command_line import environment

BROWSER, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
MISSING = None if BROWSER and DRIVER else "no Chromium with its driver is installed here"
_FLAGS = (
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run --disable-sync "
    "--disable-background-networking --disable-component-update"
)
_PATIENCE = 240
"""For an answer of a machine that is busy; s."""


@contextlib.contextmanager
def explorer(*arguments, **variables):
    """The address of a page that is served, and its process."""
    command = [sys.executable, "-m", "mishutter", "explore", "--no-browser", *arguments]
    with tempfile.TemporaryFile("w+") as messages:
        process = subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=messages,
            text=True,
            env=environment(**variables),
        )
        try:
            yield process.stdout.readline().strip(), process
        finally:
            process.terminate()
            process.wait(_PATIENCE)
            process.stdout.close()
            messages.seek(0)
            written = messages.read()
    assert "Traceback" not in written, written


@contextlib.contextmanager
def browser(width=1280, height=800, *, dark=False, downloads=None):
    """A new browser of a size and a colour scheme."""
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        options = webdriver.ChromeOptions()
        options.binary_location = BROWSER
        for flag in (*_FLAGS.split(), f"--user-data-dir={profile}"):
            options.add_argument(flag)
        options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
        if downloads is not None:
            options.add_experimental_option("prefs", {"download.default_directory": str(downloads)})
        driver = webdriver.Chrome(options=options, service=Service(DRIVER))
        try:
            driver.set_script_timeout(_PATIENCE)
            resize(driver, width, height)
            scheme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
            driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": [scheme]})
            yield driver
        finally:
            driver.quit()


def resize(driver, width, height):
    size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 500}
    driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)


def wait(driver, condition, seconds=_PATIENCE):
    """Wait until a JavaScript expression holds."""
    end = time.monotonic() + seconds
    while not driver.execute_script(f"return Boolean({condition})"):
        assert time.monotonic() < end, f"{condition}; {driver.find_element('id', 'problem').text}"
        time.sleep(0.05)


def count(driver, kind):
    return driver.execute_script(f"return window.mishutter.answers.{kind}")


def after(driver, kind, act):
    """Do something, and wait for the answer of a kind to it, which is returned."""
    before = driver.execute_script("return window.mishutter.latest.first?.id ?? 0")
    act()
    newer = f"(window.mishutter.latest['{kind}']?.id ?? 0) > {before}"
    wait(driver, newer)
    return driver.execute_script(f"return window.mishutter.latest['{kind}']")


def slide(driver, place, to):
    """Move the slider of a key to a position of 1000, as a hand would."""
    driver.execute_script(
        "const [place, to] = arguments;"
        "const s = document.querySelector(`.field[data-place='${place}'] input[type=range]`);"
        "s.value = to; s.dispatchEvent(new Event('input', {bubbles: true}));"
        "s.dispatchEvent(new Event('change', {bubbles: true}));",
        place,
        to,
    )


def complaints(driver):
    """What the browser's console holds."""
    return [entry for entry in driver.get_log("browser") if entry["level"] != "INFO"]


def resident_bytes(pid):
    """Memory of a process that is resident."""
    status = Path(f"/proc/{pid}/status").read_text("utf-8")
    return int(re.search(r"VmRSS:\s+(\d+)", status)[1]) << 10
