"""What a wheel must hold, read from where it was installed: `python smoke.py FOLDER`."""

import sys
from importlib import resources
from pathlib import Path

import mishutter
from mishutter.decoding.decoders.speed import prior

folder = Path(sys.argv[1])
for name in dir(mishutter):
    getattr(mishutter, name)
prior()
for name in ("py.typed", "example_scene.toml", "explore/page/explore.js"):
    if not (folder / "mishutter" / name).is_file():
        raise SystemExit(f"the wheel must hold {name}")
if not Path(str(resources.files(mishutter))).is_relative_to(folder):
    raise SystemExit(f"the wheel must be what is imported; got {mishutter.__file__}")
