"""How many programs does the command line compile, and what processor time does a run take?

`mishutter optimise --out DIR` in a home folder of its own that is empty at first: the built-in
scene, then another scene right after, which finds what the first one left in JAX's cache, then
the built-in scene again. `-v` names the programs, the slowest first.
"""

import os
import re
import resource
import subprocess
import sys
import tempfile
import time
from collections import Counter
from importlib import resources
from pathlib import Path

from benchmarks import harness

_CHANGED = {
    "min_px_per_s = -4500, max_px_per_s = 4500": "min_px_per_s = -3700, max_px_per_s = 3700",
    "photon_rate_per_s = 1.0e5": "photon_rate_per_s = 2.3e5",
    "read_noise_e = 8.0": "read_noise_e = 5.0",
}
_COMPILED = re.compile(r"Finished XLA compilation of (\S+) in ([\d.]+) sec")
_TRACED = re.compile(r"Finished (?:tracing|jaxpr to MLIR module conversion) .* in ([\d.]+) sec")
_FROM_CACHE = re.compile(r"Persistent compilation cache hit")


def another_scene(folder: Path) -> Path:
    """The built-in scene at other speeds and in other light."""
    text = (resources.files("mishutter") / "example_scene.toml").read_text("utf-8")
    for key, value in _CHANGED.items():
        if key not in text:
            raise RuntimeError(f"The built-in scene must hold {key!r}.")
        text = text.replace(key, value)
    path = folder / "another.toml"
    path.write_text(text)
    return path


def measured(home: Path, *arguments: str) -> dict:
    """A run of `mishutter optimise`: seconds, programs, and where they came from."""
    environment = os.environ | {"HOME": str(home), "XDG_CACHE_HOME": str(home / "cache")}
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    command = [sys.executable, "-m", "mishutter", "optimise", *arguments, "--out", "design"]
    return _used(command, environment | {"JAX_LOG_COMPILES": "1"}, home)


def imported(names: str) -> dict:
    """Seconds that importing takes."""
    return _used([sys.executable, "-c", f"import {names}"], dict(os.environ), Path.cwd())


def _used(command: list[str], environment: dict[str, str], folder: Path) -> dict:
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(command, env=environment, cwd=folder, capture_output=True, text=True)
    took, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        raise RuntimeError(done.stderr[-2000:])
    programs = [(name, float(seconds)) for name, seconds in _COMPILED.findall(done.stderr)]
    return {
        "processor s": after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime,
        "waited s": took,
        "programs": len(programs),
        "from JAX's cache": len(_FROM_CACHE.findall(done.stderr)),
        "tracing s": sum(map(float, _TRACED.findall(done.stderr))),
        "compiling s": sum(seconds for _, seconds in programs),
        "names": programs,
    }


def measure() -> list[dict]:
    """A row a run; nothing is cached before the first."""
    with tempfile.TemporaryDirectory() as folder:
        home = Path(folder)
        other = str(another_scene(home))
        runs = {"first": (), "another scene": (other,), "the first scene again": ()}
        rows = [{"run": name, **measured(home, *more)} for name, more in runs.items()]
    rows += [
        {"run": f"import {names}", **imported(names)} for names in ("jax, optimistix", "mishutter")
    ]
    return rows


def _named(row: dict) -> str:
    """The programs of a run, how often each was compiled, and for how long."""
    seconds, times = Counter(), Counter(name for name, _ in row["names"])
    for name, took in row["names"]:
        seconds[name] += took
    lines = [f"{took:8.3f} s {times[name]:4d} x {name}" for name, took in seconds.most_common()]
    return "\n".join([row["run"], *lines, ""])


def main() -> None:
    """Measure, store and print."""
    rows = measure()
    if "-v" in sys.argv:
        print("\n".join(_named(row) for row in rows if row["names"]))
    for row in rows:
        del row["names"]
    harness.write("compiles", rows)
    text = "## Programs that a run compiles, and its processor time\n\n"
    harness.section("compiles", text + harness.table(rows, list(rows[0])))


if __name__ == "__main__":
    main()
