"""How soon does the live page answer, in a real browser?

Headless Chromium moves the sliders of `mishutter explore` as a hand would, each again as soon as it
is answered: latency from the change to the drawn first answer, with one tab and with eight; and the
memory of server and browser over 2,000 changes. Run `python -m benchmarks.explore`; it needs
Chromium, its driver and selenium, and does nothing without.
"""

import os
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from support import chromium

from benchmarks import harness

NUM_CHANGES, NUM_MANY, NUM_TABS = 200, 2000, 8
_AT_ONCE = 100
"""Changes a call of the driver, which waits for two minutes at most."""
SLIDERS = (
    "light.photon_rate_per_s",
    "sensor.read_noise_e",
    "limits.max_stroke_px",
    "speeds.uniform.max_px_per_s",
    "limits.max_top_speed_px_per_s",
)
MOVE = """
const [sliders, count, done] = arguments;
const m = window.mishutter, before = m.latencies.length;
const at = (place) => document.querySelector(`.field[data-place='${place}'] input[type=range]`);
let k = 0;
const next = () => {
  if (k === count) { done(m.latencies.slice(-count)); return; }
  const slider = at(sliders[Math.floor(k / 20) % sliders.length]), was = m.answers.first;
  slider.value = 500 + 120 * Math.sin(k / 3);
  slider.dispatchEvent(new Event("input", { bubbles: true }));
  k += 1;
  const wait = () => (m.answers.first > was ? setTimeout(next, 5) : setTimeout(wait, 5));
  wait();
};
next();
"""


def moved(driver, count):
    """Latencies of changes, one after the other; ms."""
    calls = range(0, count, _AT_ONCE)
    return np.concatenate(
        [driver.execute_async_script(MOVE, list(SLIDERS), _AT_ONCE) for _ in calls]
    )


class Clock:
    """Processor time of a process between calls; s."""

    def __init__(self, pid):
        self._path = Path(f"/proc/{pid}/stat")
        self.passed()

    def passed(self):
        user, system = self._path.read_text("utf-8").rpartition(")")[2].split()[11:13]
        total = (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")
        before, self._total = getattr(self, "_total", total), total
        return total - before


def opened(driver, address):
    """Open the page and wait until it shows a design with its comparison."""
    driver.get(address)
    chromium.wait(driver, "window.mishutter?.answers.table > 0", 600)


def row(what, latencies, clock):
    """A row of the table."""
    median, high = np.percentile(latencies, [50, 95])
    return {
        "what": what,
        "changes": latencies.size,
        "median ms": median,
        "95th percentile ms": high,
        "server's processor ms": 1e3 * clock.passed() / latencies.size,
        "machine's load": os.getloadavg()[0],
    }


def heap(driver):
    """Bytes that the page's script holds after a collection."""
    driver.execute_cdp_cmd("HeapProfiler.collectGarbage", {})
    return driver.execute_script("return performance.memory.usedJSHeapSize")


def main() -> None:
    """Measure, print and keep the section of `RESULTS.md`."""
    if chromium.MISSING:
        print(chromium.MISSING)
        return
    rows = []
    with chromium.explorer() as (address, process), chromium.browser() as driver:
        driver.set_script_timeout(3600)
        opened(driver, address)
        clock = Clock(process.pid)
        rows.append(row("first round, with compiling", moved(driver, NUM_CHANGES), clock))
        rows.append(row("one tab", moved(driver, NUM_CHANGES), clock))
        before = chromium.resident_bytes(process.pid), heap(driver)
        begin = time.perf_counter()
        rows.append(row("2,000 changes", moved(driver, NUM_MANY), clock))
        seconds = time.perf_counter() - begin
        grown = (chromium.resident_bytes(process.pid) - before[0], heap(driver) - before[1])
        tabs = [driver.current_window_handle]
        for _ in range(NUM_TABS - 1):
            driver.switch_to.new_window("window")
            opened(driver, address)
            tabs.append(driver.current_window_handle)
        clock.passed()
        for tab in tabs:
            driver.switch_to.window(tab)
            driver.execute_script(
                "const args = [arguments[0], arguments[1], (x) => { window.found = x; }];"
                f"(function () {{ {MOVE} }}).apply(null, args)",
                list(SLIDERS),
                NUM_CHANGES // 4,
            )
        found = []
        for tab in tabs:
            driver.switch_to.window(tab)
            chromium.wait(driver, "window.found", 600)
            found += driver.execute_script("return window.found")
        rows.append(row(f"{NUM_TABS} tabs at once", np.array(found), clock))
    columns = ["what", "changes", "median ms", "95th percentile ms"]
    columns += ["server's processor ms", "machine's load"]
    text = (
        "## The live page\n\nLatency from a slider's change to the drawn first answer, in headless "
        "Chromium on the same machine as the server; each change follows the answer to the one "
        f"before.\n\n{harness.table(rows, columns)}\n\nOver {NUM_MANY:,} changes in "
        f"{seconds:.0f} s the server grew by {grown[0] / 2**20:.0f} MiB, the page's script by "
        f"{grown[1] / 2**20:.1f} MiB.\n"
    )
    harness.write("explore", rows, grown_bytes=grown)
    harness.section("explore", text)


if __name__ == "__main__":
    main()
