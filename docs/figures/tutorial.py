"""Draw the pictures of the first page and of the verdict, from the scene of both.

`python docs/figures/tutorial.py`, in a folder that holds the page's `slides.toml` and its answer,
`slides`.
"""

import json
from pathlib import Path

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

from mishutter import Design, example_picture  # noqa: E402
from mishutter.decoding.restoration import capture_and_restore  # noqa: E402
from mishutter.pictures.images import to_display  # noqa: E402
from mishutter.report.plots import new_figure, save_figure  # noqa: E402

HERE = Path(__file__).parent
SPEED = 1200.0
"""Speed of the photograph; px/s."""
ROWS, COLUMNS = slice(60, 190), slice(430, 700)
"""The part of the photograph that is shown."""


def draw_options() -> None:
    """Draw the levels of the options of an answer, and the ceiling of one exposure."""
    comparison = json.loads(Path("slides/report.json").read_text("utf-8"))["comparison"]
    options = comparison["options"]
    figure = new_figure(8.4, 2.4)
    axes = figure.add_subplot()
    for place, option in enumerate(options):
        level, is_choice = option["psnr_db"], option["row"] == comparison["choice"]
        axes.barh(place, level - 23, left=23, color="#0072b2" if is_choice else "0.75")
        axes.text(23.05, place, f"{level:.1f}", va="center", fontsize="small")
    most = comparison["ceiling_db"]
    axes.axvline(most, color="k", linestyle="--")
    axes.text(most - 0.05, -0.1, "ceiling of one exposure", ha="right", fontsize="small")
    axes.set_yticks(range(len(options)), [option["name"] for option in options])
    top = max(most, *(option["psnr_db"] for option in options))
    axes.set(xlabel="expected PSNR / dB", xlim=(23, top + 0.1))
    axes.tick_params(labelsize="small")
    figure.subplots_adjust(left=0.43, right=0.98, bottom=0.2, top=0.97)
    save_figure(figure, HERE / "verdict_options.png")


def draw_photograph() -> None:
    """Draw a detail of a photograph in each frame, and restored from both."""
    design = Design.load("slides/recommended.json")
    light = example_picture().light[100:356]
    key = jax.random.key(0)
    result = capture_and_restore(light, design.scene, design.exposures, speed=SPEED, key=key)
    shown = [("at rest", light), *zip(("frame 1", "frame 2"), result.captured, strict=True)]
    shown.append(("restored", result.restored))
    figure = new_figure(9.6, 1.5)
    for place, (name, part) in enumerate(shown, 1):
        axes = figure.add_subplot(1, len(shown), place)
        axes.imshow(to_display(np.asarray(part)[ROWS, COLUMNS]))
        axes.set_title(name, fontsize="small")
        axes.axis("off")
    figure.subplots_adjust(left=0.01, right=0.99, bottom=0.02, top=0.86, wspace=0.04)
    save_figure(figure, HERE / "tutorial_frames.png")


def main() -> None:
    """Draw the answer, its options, and a photograph by its frames."""
    (HERE / "tutorial_answer.png").write_bytes(Path("slides/answer.png").read_bytes())
    draw_options()
    draw_photograph()


if __name__ == "__main__":
    main()
