"""Draws the figures of the page on measuring a camera, from a simulated clip.

`PYTHONPATH=tests python docs/figures/measure.py` writes them beside this file.
"""

from pathlib import Path

from support.clips import ClipOf, Thing

import mishutter as ms
from mishutter.report.measurement_plots import plot_motion, plot_noise
from mishutter.report.plots import save_figure

HERE = Path(__file__).parent
CLIP = ClipOf(
    (
        Thing((150, 170), (52, 64), (40.0, -310.0), "coffee.png"),
        Thing((270, 330), (45, 58), (-30.0, 260.0), "chelsea.png"),
    ),
    size=(384, 512),
    background="motorcycle_left.png",
    num_frames=16,
)


def main() -> None:
    """Measure the clip and draw what came out."""
    measurement = ms.measure(
        CLIP.levels(),
        frames_per_s=CLIP.frames_per_s,
        exposure=CLIP.exposure,
        dark=CLIP.dark(),
        white=float(CLIP.full),
    )
    save_figure(plot_noise(measurement), HERE / "measure_noise.png")
    save_figure(plot_motion(measurement), HERE / "measure_motion.png")
    print(measurement.scene_text)


if __name__ == "__main__":
    main()
