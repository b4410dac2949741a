"""How long does a user wait for the command line, the first time and every time after?

`mishutter optimise` for the built-in scene, in a home folder of its own that is empty at
first, with what Python says it spent on importing: the first time, and twice with what JAX kept.
"""

import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import matplotlib.pyplot as plt

from benchmarks import harness

COMMANDS = {
    "tables": ("optimise",),
    "tables and files": ("optimise", "--out", "design"),
    "no photograph": ("optimise", "--noise-seeds", "0"),
}
RUNS = ("first", "second", "third")
_IMPORT = re.compile(r"import time:\s+(\d+) \|")


def waited(command: tuple[str, ...], home: Path) -> tuple[float, float]:
    """Seconds that a command takes, and those of them that go to importing."""
    environment = os.environ | {"HOME": str(home), "XDG_CACHE_HOME": str(home / "cache")}
    call = [sys.executable, "-X", "importtime", "-m", "mishutter", *command]
    start = time.perf_counter()
    done = subprocess.run(
        call, env=environment, cwd=home, check=True, capture_output=True, text=True
    )
    took = time.perf_counter() - start
    return took, sum(int(self) for self in _IMPORT.findall(done.stderr)) / 1e6


def measure() -> list[dict]:
    """A row a command and run; the cache folder is empty before the first."""
    rows = []
    for name, command in COMMANDS.items():
        with tempfile.TemporaryDirectory() as folder:
            for run in RUNS:
                took, importing = waited(command, Path(folder))
                rows.append(
                    {
                        "command": name,
                        "run": run,
                        "s": took,
                        "importing s": importing,
                        "importing": f"{importing / took:.0%}",
                    }
                )
    return rows


def picture(rows: list[dict]) -> None:
    """Bars of each run, with the part that is importing."""
    figure, axes = plt.subplots(figsize=(6.4, 0.6 + 0.28 * len(rows)), layout="constrained")
    places = range(len(rows))
    axes.barh(places, [r["s"] for r in rows], color="0.8", edgecolor="black", label="the rest")
    axes.barh(places, [r["importing s"] for r in rows], color="0.2", label="importing")
    axes.set_yticks(places, [f"{r['command']}, {r['run']}" for r in rows])
    axes.invert_yaxis()
    axes.set_xlabel("time until `mishutter optimise` has ended / s")
    axes.legend()
    harness.save_picture(figure, "command")
    plt.close(figure)


def main() -> None:
    """Measure, store, print and draw."""
    rows = measure()
    harness.write("command", rows)
    picture(rows)
    text = "## The command line: first run and later ones\n\n![command](results/command.png)\n\n"
    harness.section("command", text + harness.table(rows, list(rows[0])))


if __name__ == "__main__":
    main()
