"""Draw `any_direction.png`: the frames that the page's scene is told to take.

Run it as `python docs/figures/any_direction.py`, in a folder that holds the page's `drone.toml`.
"""

from pathlib import Path

import jax

jax.config.update("jax_enable_x64", True)

from mishutter import Scene  # noqa: E402
from mishutter.report.documents import Report  # noqa: E402
from mishutter.report.in_plane import compare_in_plane  # noqa: E402


def main():
    """Draw the figure and save it beside this script."""
    scene = Scene.load("drone.toml")
    figure = Report(scene, compare_in_plane(scene), ()).plot()
    figure.savefig(Path(__file__).with_suffix(".png"), dpi=110)


if __name__ == "__main__":
    main()
