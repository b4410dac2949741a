"""What is lost where levels are rounded by error diffusion alone, and not searched slot by slot?

Designs of six scenes for devices of few levels: searched as `optimise` does, and with the motion
searched but the command as error diffusion rounds it.
"""

from unittest.mock import patch

import jax
import numpy as np

import mishutter as ms
from benchmarks import harness
from benchmarks.scenes import scenes
from mishutter.search import search
from mishutter.search.search import with_device

DEVICES = {
    "2 levels, 128 slots": ms.SwitchedDevice(),
    "2 levels, 64 slots": ms.SwitchedDevice(num_slots=64),
    "2 levels, 128 slots, 4 alike in a row": ms.SwitchedDevice(min_open=4, min_closed=4),
    "2 levels, 64 slots, 6 open and 3 closed": ms.SwitchedDevice(
        num_slots=64, min_open=6, min_closed=3
    ),
}
TEXT = """## Levels by error diffusion, and slot by slot

Expected PSNR that designs for devices of few levels lose where the command is rounded by error
diffusion and its slots are not searched, dB, over the six scenes of the pages.

{table}"""


def losses(device: object) -> list[float]:
    """Loss by error diffusion in each scene; dB."""
    found = []
    for scene in scenes().values():
        given = with_device(scene, device)  # type: ignore[arg-type]
        searched = ms.optimise(given)
        with patch.object(search, "searched_slots", lambda _, levels, __: np.asarray(levels)):
            rounded = ms.optimise(given)
        found.append(searched.metrics.expected_psnr - rounded.metrics.expected_psnr)
    return [float(loss) for loss in found]


def main() -> None:
    """Measure, store and print."""
    jax.config.update("jax_enable_x64", True)
    rows = []
    for name, device in DEVICES.items():
        each = losses(device)
        rows.append(
            {
                "device": name,
                "mean": f"{np.mean(each):.3f}",
                "least": f"{min(each):.3f}",
                "most": f"{max(each):.3f}",
            }
        )
        print(rows[-1], flush=True)
    harness.write("slots", rows)
    harness.section("slots", TEXT.format(table=harness.table(rows, list(rows[0]))))


if __name__ == "__main__":
    main()
