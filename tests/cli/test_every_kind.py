"""Each kind of scene is planned and explored, and its design goes through every command."""

import shlex

import numpy as np
import pytest

from mishutter import Layer, Layers, Picture, cli, example_picture, write_layers
from mishutter.explore import server
from mishutter.pictures.images import write_picture

TWO_WAYS = "uniform = { min_px_per_s = -900, max_px_per_s = 900, count = 3 }"
ONE_WAY = "uniform = { min_px_per_s = 200, max_px_per_s = 1100, count = 3 }"
ANY = "any_direction = { max_px_per_s = 700 }"
BURST = "[burst]\nframes_per_s = 60\nmax_frames = 2\nwindow_ms = 30\n"
FOUR = BURST.replace("= 2", "= 4").replace("= 30", "= 60")
"""Before a background two frames are no better than one exposure, and of four along an axis two
rest, in which things of a layered scene are found."""
SCENE = """[speeds]
{speeds}
[light]
photon_rate_per_s = 1e5
[sensor]
read_noise_e = 6
axis = "{axis}"
[limits]
max_stroke_px = 12
max_exposure_ms = 12
[picture]
path = "photo.png"
{sections}"""
KINDS = {
    "along rows": (TWO_WAYS, ""),
    "along columns": (TWO_WAYS, FOUR),
    "one-way speeds": (ONE_WAY, BURST),
    "known speeds": (TWO_WAYS, BURST + '[decoder]\nspeed = "known"\n'),
    "background": (TWO_WAYS, FOUR + "[occlusion]\nfront_share = 0.3\nobject_width_px = 40\n"),
    "objects": (TWO_WAYS, BURST + "[objects]\nwidth_px = 60\n"),
    "any direction": (ANY, BURST),
    "objects in any direction": (ANY, BURST + "[objects]\nwidth_px = 60\n"),
    "background in any direction": (
        ANY,
        BURST + "[occlusion]\nfront_share = 0.3\nobject_width_px = 40\n",
    ),
    "servo": (TWO_WAYS, "[stage]\nbandwidth_hz = 300\n"),
    "device": (TWO_WAYS, "[shutter]\ntransmission = 0.8\nrise_ms = 1\nlevels = 16\n"),
    "tolerances": (
        TWO_WAYS,
        "[tolerances]\nobject_speed_px_per_s = 10\nacceleration_share = 0.02\n",
    ),
}
"""Speeds, and what else the file of the scene says."""
SMALL = "--starts 1 --steps 2 --coefficients 6 --noise-seeds 1"
CHAIN = {
    "export": "export {design} --out {out}",
    "simulate a photograph": "simulate --design {design} --subject photo.png --speed={speed} "
    "--out {out}",
    "restore": "restore {frames} --design {design} --out {out}",
    "simulate layers": "simulate --design {design} --subject layers.toml --out {out}",
    "compare": "compare {scene} --design {design} --noise-seeds 0",
    "sweep": "sweep {scene} --acceleration 1e3:9e3:2 --half-exposure 3:5:2 --shutter hann "
    "--out {out}",
}
"""What is typed once `optimise` has made a design."""
ALONG_ONE_AXIS = ("compare", "sweep")


@pytest.fixture(scope="module")
def desk(tmp_path_factory):
    """A folder with a scene of each kind, a photograph, and a layered scene."""
    place = tmp_path_factory.mktemp("desk")
    for kind, (speeds, sections) in KINDS.items():
        axis = "columns" if kind == "along columns" else "rows"
        text = SCENE.format(speeds=speeds, axis=axis, sections=sections)
        (place / f"{kind}.toml").write_text(text, encoding="utf-8")
    light = np.asarray(example_picture().light)
    ground = Picture(light[100:148, :64])
    write_picture(place / "photo.png", ground)
    down, across = np.mgrid[:24, :24]
    matte = np.clip(11 - np.hypot(down - 11.5, across - 11.5), 0, 1)
    thing = Layer(Picture(light[200:224, 300:324], matte), 500.0, left=18, top=12)
    write_layers(place, Layers((Layer(ground), thing)))
    return place


@pytest.mark.parametrize("kind", KINDS)
def test_it_is_understood_and_explored(kind, desk, monkeypatch, capsys):
    """`plan` says what it is, and `explore` would serve its page."""
    monkeypatch.chdir(desk)
    assert cli.main(["plan", f"{kind}.toml"]) == 0
    assert "as understood" in capsys.readouterr().out
    served = []
    monkeypatch.setattr(server, "serve", lambda started, **others: served.append(started))
    assert cli.main(["explore", f"{kind}.toml", "--no-browser"]) == 0
    assert len(served) == 1


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_its_design_goes_through_every_command(kind, desk, monkeypatch, capsys):
    """It is exported, simulated, restored, compared and swept, or a line says why not."""
    monkeypatch.chdir(desk)
    own, scene = kind.replace(" ", "_"), shlex.quote(f"{kind}.toml")
    in_plane = KINDS[kind][0] == ANY
    (desk / own).mkdir()
    (desk / own / "one_exposure.json").write_text("of an earlier scene", encoding="utf-8")
    assert cli.main(shlex.split(f"optimise {scene} {SMALL} --out {own}")) == 0
    answer = capsys.readouterr().out
    assert "dB" in answer
    # No single exposure comes near the frames of these scenes, unless they rest for objects.
    takes_frames = "[burst]" in KINDS[kind][1] and kind != "objects"
    leaves_out = "Other single exposures are left out" in answer
    assert leaves_out == (takes_frames and not in_plane)
    assert (desk / own / "one_exposure.json").exists() != takes_frames
    speed = "300,-200" if in_plane else "300"
    names = {"scene": scene, "speed": speed, "design": f"{own}/recommended.json"}
    for number, (command, line) in enumerate(CHAIN.items()):
        simulated = desk / own / "1"
        frames = [*simulated.glob("frame_*.png")] or [*simulated.glob("captured.png")]
        taken = shlex.join(sorted(map(str, frames)))
        typed = shlex.split(line.format(**names, out=f"{own}/{number}", frames=taken))
        if in_plane and command in ALONG_ONE_AXIS:
            assert cli.main(typed) == 2
            assert "along one axis" in capsys.readouterr().err
            continue
        assert cli.main(typed) == 0, f"{command}: {capsys.readouterr().err}"
        assert "".join(capsys.readouterr()), command
