"""How many of the package's files does a call run through?

Each call is traced in a process of its own, with nothing compiled: a file counts if one of its
functions runs. Run `python -m benchmarks.house`.
"""

import inspect
import multiprocessing
import sys
import threading
from pathlib import Path
from typing import Any

import mishutter as ms

PACKAGE = Path(ms.__file__).parent

# Imported before calls are followed.
PUBLIC = [getattr(ms, name) for name in dir(ms)]
SCENE = ms.example_scene()
MOTION = SCENE.motion
GRID: dict[str, Any] = {"accelerations": [1e5, 4e5], "half_exposures": [0.005, 0.01]}
CALLS = {
    "blur_kernel": lambda: ms.blur_kernel(ms.HannShutter(), MOTION, num_taps=50),
    "optimise": lambda: ms.optimise(SCENE, num_starts=2, max_steps=20),
    "sweep": lambda: ms.sweep(SCENE, **GRID),
}


def files_of(name: str) -> list[str]:
    """Files whose functions a call runs, in any thread."""
    seen = set()

    def profile(frame, event, _):
        is_function = frame.f_code.co_flags & inspect.CO_OPTIMIZED
        if event == "call" and is_function and frame.f_code.co_filename.startswith(str(PACKAGE)):
            seen.add(str(Path(frame.f_code.co_filename).relative_to(PACKAGE)))

    threading.setprofile(profile)
    sys.setprofile(profile)
    CALLS[name]()
    sys.setprofile(None)
    return sorted(seen)


def main() -> None:
    """Trace and print."""
    for name in CALLS:
        with multiprocessing.get_context("spawn").Pool(1) as alone:
            files = alone.apply(files_of, (name,))
        print(f"{name}: {len(files)} files\n    {' '.join(files)}")


if __name__ == "__main__":
    main()
