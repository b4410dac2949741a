"""What every benchmark shares: timing, the record of the machine, tables, JSON, pictures."""

import importlib.metadata
import json
import os
import platform
import time
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np

RESULTS = Path(__file__).parent / "results"
PACKAGES = ("jax", "numpy", "scipy", "equinox", "optimistix", "jaxopt", "optax", "quadax")
NUM_SAMPLES, MAX_SECONDS = 1000, 0.5
"""Enough for what takes microseconds to meet a quiet moment of the machine."""


def timed(function: Callable, *arguments) -> dict:
    """First call, and up to 1,000 more within half a second; every sample is kept, in seconds."""
    first, value = _once(function, arguments)
    samples: list[float] = []
    while len(samples) < NUM_SAMPLES and (len(samples) < 2 or sum(samples) < MAX_SECONDS):
        samples.append(_once(function, arguments)[0])
    return {"first_s": first, "best_s": min(samples), "samples_s": samples, "value": value}


def _once(function: Callable, arguments: tuple) -> tuple[float, object]:
    start = time.perf_counter()
    value = jax.block_until_ready(function(*arguments))
    return round(time.perf_counter() - start, 9), value


def failed(error: Exception) -> dict:
    """The row of a method that could not do it: NaN, and why."""
    reason = f"{type(error).__name__}: {str(error).splitlines()[0][:120]}"
    nothing = float("nan")
    return {"first_s": nothing, "best_s": nothing, "samples_s": [], "value": None, "why": reason}


def environment() -> dict:
    """Versions, device, cores and load that stand with every figure."""
    versions = {}
    for package in PACKAGES:
        try:
            versions[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            versions[package] = None
    return {
        "python": platform.python_version(),
        "versions": versions,
        "device": str(jax.devices()[0].device_kind),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "load": os.getloadavg()[0],
    }


def _processor() -> str:
    lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines() if os.name == "posix" else []
    names = [line.split(":")[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


def write(name: str, rows: list[dict], **more) -> None:
    """Store rows, with the machine, as JSON beside the pictures."""
    RESULTS.mkdir(exist_ok=True)
    document = {"benchmark": name, "environment": environment(), **more, "rows": rows}
    text = json.dumps(document, default=_plain, indent=None, separators=(",", ":"))
    (RESULTS / f"{name}.json").write_text(text.replace('{"', '\n{"') + "\n")


def _plain(value):
    return float(value) if np.ndim(value) == 0 else np.asarray(value).tolist()


def table(rows: list[dict], columns: list[str]) -> str:
    """Rows as Markdown."""
    lines = ["| " + " | ".join(columns) + " |", "|" + "---|" * len(columns)]
    lines += ["| " + " | ".join(_cell(row.get(c)) for c in columns) + " |" for row in rows]
    return "\n".join(lines)


def _cell(value) -> str:
    if value is None:
        return "-"
    return f"{value:.3g}" if isinstance(value, float | np.floating) else str(value)


def save_picture(figure, name: str) -> None:
    """A picture beside the rows it shows."""
    RESULTS.mkdir(exist_ok=True)
    figure.savefig(RESULTS / f"{name}.png", dpi=90)


def section(name: str, text: str) -> None:
    """Print a benchmark's summary and keep it for `RESULTS.md`."""
    print(text)
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / f"{name}.md").write_text(text + "\n")
