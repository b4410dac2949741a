"""How long does a user wait for the command line, the first time and every time after?

`mishutter optimise` for the built-in scene, in a home folder of its own that is empty at first: the
first time, and twice with what JAX kept. The verdict is printed first, photographs and files
follow. Processor seconds stand beside those on the clock, which grow on a machine that others use.
"""

import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import IO, NamedTuple

import matplotlib.pyplot as plt

from benchmarks import harness

COMMANDS = {"tables": ("optimise",), "tables and files": ("optimise", "--out", "design")}
RUNS = ("first", "second", "third")
_TICKS = os.sysconf("SC_CLK_TCK")


class Seconds(NamedTuple):
    """How long a command took until its verdict, and until its end; of each processor seconds."""

    verdict: float
    verdict_processor: float
    whole: float
    whole_processor: float


def waited(command: tuple[str, ...], home: Path) -> Seconds:
    """How long a command takes until the first line on its standard output, and until its end."""
    environment = os.environ | {"HOME": str(home), "XDG_CACHE_HOME": str(home / "cache")}
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    call = [sys.executable, "-m", "mishutter", *command]
    before, start = _of_children(), time.perf_counter()
    with subprocess.Popen(
        call, env=environment, cwd=home, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    ) as process:
        output: IO[bytes] = process.stdout  # type: ignore[assignment]
        output.readline()
        verdict, of_verdict = time.perf_counter() - start, _of_process(process.pid)
        output.read()
        code = process.wait()
    whole = time.perf_counter() - start
    if code != 0:
        raise RuntimeError(f"{' '.join(call)} ended with {code}")
    return Seconds(verdict, of_verdict, whole, _of_children() - before)


def _of_children() -> float:
    """Processor seconds of all processes that were waited for."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def _of_process(number: int) -> float:
    """Processor seconds that a running process of Linux has taken; NaN elsewhere."""
    place = Path(f"/proc/{number}/stat")
    if not place.exists():
        return float("nan")
    fields = place.read_text("utf-8").rpartition(")")[2].split()  # the name before may hold spaces
    return (int(fields[11]) + int(fields[12])) / _TICKS


def measure() -> list[dict]:
    """A row a command and run; the cache folder is empty before the first."""
    rows = []
    for name, command in COMMANDS.items():
        with tempfile.TemporaryDirectory() as folder:
            for run in RUNS:
                took = waited(command, Path(folder))
                rows.append(
                    {
                        "command": name,
                        "run": run,
                        "seconds to the verdict": took.verdict,
                        "of processor": took.verdict_processor,
                        "seconds to the end": took.whole,
                        "of processor to the end": took.whole_processor,
                        "load": os.getloadavg()[0],
                    }
                )
    return rows


def picture(rows: list[dict]) -> None:
    """Bars of each run, with the part that goes before the verdict."""
    figure, axes = plt.subplots(figsize=(6.4, 1.2 + 0.28 * len(rows)), layout="constrained")
    places = range(len(rows))
    whole, verdict = ([r[f"seconds to the {part}"] for r in rows] for part in ("end", "verdict"))
    axes.barh(places, whole, color="0.8", edgecolor="black", label="photographs, files")
    axes.barh(places, verdict, color="0.2", label="until the verdict")
    axes.set_yticks(places, [f"{r['command']}, {r['run']}" for r in rows])
    axes.invert_yaxis()
    axes.set_xlabel("time after `mishutter optimise` / s")
    figure.legend(loc="outside upper center", ncols=2)
    harness.save_picture(figure, "command")
    plt.close(figure)


def main() -> None:
    """Measure, store, print and draw."""
    rows = measure()
    harness.write("command", rows)
    picture(rows)
    text = (
        "## The command line: first run and later ones\n\n![command](results/command.png)\n\n"
        "Processor seconds stand beside those on the clock. A machine that does other things "
        "lengthens both: two threads of a core share it.\n\n"
    )
    harness.section("command", text + harness.table(rows, list(rows[0])))


if __name__ == "__main__":
    main()
