"""Plans: what is left out changes nothing, is said, and a wrong plan is found out.

Each scene is measured as planned and in full by `check_plan`; the tests that break a plan on
purpose go through it too.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
from support.bad_scenes import edited
from support.plan_check import WrongPlanError, check_plan, plan_error
from support.programs import compiled_programs
from support.random_scenes import LIMITS, PROFILE, random_scene

from mishutter import (
    ChippedShutter,
    Design,
    DesignLoss,
    ExpectedErrorLoss,
    GaussianShutter,
    HannShutter,
    Limits,
    Occlusion,
    ParabolicMotion,
    Plan,
    RectShutter,
    Scene,
    StillCamera,
    TukeyShutter,
    cli,
    evaluate,
    example_scene,
    optimise,
    plan,
)
from mishutter.evaluation import distinct_speeds, reduced, require_plan, sizes
from mishutter.model import frequencies

MOTION = ParabolicMotion(acceleration=11.0 / 1e-4, half_exposure=1e-2)
LOSSES = {
    "metrics": None,
    "expected_error": ExpectedErrorLoss(),
    "design": DesignLoss(),
    "no_invariance": DesignLoss(invariance=0.0),
    "sum": 0.7 * ExpectedErrorLoss() + 0.0 * DesignLoss(),
}
FREE = ("acceleration", "half_exposure")


@pytest.mark.slow
@pytest.mark.parametrize("seeds", [range(6), range(6, 12)], ids=["six kinds", "six others"])
@pytest.mark.daily(1)
def test_exact_skips_change_nothing(seeds):
    """Losses and metrics of the twelve kinds of random scenes agree to 1e-12 with all computed."""
    for seed in seeds:
        scene, motion, shutter = random_scene(seed)
        for loss in LOSSES.values():
            check_plan(plan(scene, motion, shutter, loss=loss), scene, motion, shutter, loss=loss)


def item(found, name):
    return next(item for item in found.items if item.name == name)


def test_speeds_are_dropped_merged_and_folded():
    """A speed that never occurs, one that occurs twice and a mirrored one are left out."""
    speeds, weights = [0.0, 600.0, 600.0, -600.0, 1300.0], [0.25, 0.125, 0.125, 0.5, 0.0]
    scene = Scene(speeds, weights, photon_rate=1e5, read_noise=3.0, limits=LIMITS)
    found = plan(scene, MOTION, HannShutter())
    assert item(found, "speeds").kept == "2"
    kept = reduced(scene, found)
    assert np.array_equal(kept.speeds, [0.0, 600.0])
    assert np.allclose(kept.weights, [0.25, 0.75])
    one_sided = plan(scene, MOTION, ChippedShutter([1.0, 0.4]))
    assert item(one_sided, "speeds").kept == "3"


def test_effective_speeds_are_for_edges_alone():
    """The plan says how many there are where objects have edges, more for a longer exposure."""
    layers = {"edges": Occlusion(front_share=0.4, object_width=70.0), "none": None}
    layers["without edges"] = Occlusion(front_share=0.4)
    counts = {}
    for name, occlusion in layers.items():
        scene = Scene([-4600.0, 1300.0], photon_rate=1e5, read_noise=3.0, occlusion=occlusion)
        for half in (0.002, 0.019):
            found = plan(scene, StillCamera(half_exposure=half), HannShutter())
            names = [item.name for item in found.items]
            assert ("effective speeds" in names) == (name == "edges")
            counts[name, half] = found.num_effective_speeds
    assert counts["edges", 0.019] > counts["edges", 0.002] > 0
    scene = Scene([-600.0, 600.0], photon_rate=1e5, read_noise=3.0, occlusion=layers["edges"])
    own = item(plan(scene, MOTION, HannShutter()), "effective speeds")
    assert own.kept == own.full
    assert "25 are enough for a search" in own.why
    without_spectra = plan(scene, MOTION, HannShutter(), loss=DesignLoss())
    assert item(without_spectra, "effective speeds").kept == "0"


@pytest.mark.slow
def test_a_still_scene_needs_one_kernel():
    """Where nothing moves no invariance is computed, and none is reported."""
    scene = Scene([0.0, 0.0], photon_rate=1e5, read_noise=3.0, limits=LIMITS)
    found = plan(scene, MOTION, HannShutter())
    assert found.still
    assert item(found, "kernels").kept == "at rest"
    assert check_plan(found, scene, MOTION, HannShutter()) <= 1e-12
    assert float(evaluate(scene, MOTION, HannShutter(), plan=found).kernel_difference) == 0


def test_frequencies_stop_where_the_optics_do():
    """Only frequencies with power are computed, for a loss that sees no others."""
    scene = Scene([0.0, 900.0], photon_rate=1e5, read_noise=3.0, cutoff_frequency=0.1)
    found = plan(scene, MOTION, HannShutter(), loss=ExpectedErrorLoss())
    assert found.num_kept == found.num_frequencies // 4 == 384
    assert found.num_nodes < plan(scene, MOTION, HannShutter()).num_nodes
    assert plan(scene, MOTION, HannShutter()).num_kept is None


@pytest.mark.slow
@pytest.mark.parametrize("share", [16, 4])
def test_the_last_frequency_with_power_is_kept(share):
    """One more than fill a size, at the cutoff itself; and the nodes of a path that is long."""
    speeds, light = [-80000.0, 50000.0], {"photon_rate": 1e9, "read_noise": 0.0}
    motion = ParabolicMotion(acceleration=190.0 / 1e-4, half_exposure=1e-2)
    count = sizes(Scene(speeds, **light), motion).num_frequencies
    full_size = count // share
    scene = Scene(speeds, **light, cutoff_frequency=frequencies(count)[full_size])
    for shutter in (RectShutter(), TukeyShutter(0.3)):
        found = plan(scene, motion, shutter, loss=ExpectedErrorLoss())
        assert full_size < found.num_kept < count
        assert plan_error(found, scene, motion, shutter, loss=ExpectedErrorLoss()) <= 1e-12


@pytest.mark.slow
def test_the_bound_is_measured_at_every_frequency():
    """Also by a plan for a loss that sees few of them, and so takes few nodes in time."""
    limits = Limits(max_stroke=200.0)
    light = {"photon_rate": 1e5, "read_noise": 3.0}
    scene = Scene([0.0, 2000.0], **light, cutoff_frequency=0.03, limits=limits)
    motion = ParabolicMotion(acceleration=190.0 / 1e-4, half_exposure=1e-2)
    few = plan(scene, motion, HannShutter(), loss=ExpectedErrorLoss())
    assert few.num_kept == 96
    found, full = (evaluate(scene, motion, HannShutter(), plan=p) for p in (few, None))
    assert float(found.bound_share) == pytest.approx(float(full.bound_share), rel=1e-9)
    assert float(found.expected_psnr) == pytest.approx(float(full.expected_psnr), rel=1e-12)


SCENE = Scene.uniform(
    max_speed=1500.0, num_speeds=5, photon_rate=1e6, read_noise=4.0, limits=LIMITS
)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wrong", "loss"),
    [
        ({"still": True}, DesignLoss()),
        ({"num_taps": 16}, None),
        ({"num_taps": 16}, DesignLoss()),
        ({"num_kept": 128}, ExpectedErrorLoss()),
        ({"num_nodes": 16}, ExpectedErrorLoss()),
        ({"folds": True}, None),
    ],
)
def test_a_wrong_plan_is_found_out(wrong, loss):
    """A plan that drops a needed speed, tap, frequency or node does not pass the guard."""
    speeds = [-12000.0, -1600.0, 0.0, 5600.0, 12000.0]
    scene = Scene(speeds, photon_rate=1e6, read_noise=4.0, limits=LIMITS)
    shutter = ChippedShutter([0.2, 0.9, 1.0, 0.4])
    right = plan(scene, MOTION, shutter, loss=loss)
    assert check_plan(right, scene, MOTION, shutter, loss=loss) <= 1e-12
    with pytest.raises(WrongPlanError, match="must change no result by more than 1e-12"):
        check_plan(replace(right, **wrong), scene, MOTION, shutter, loss=loss)


@pytest.mark.slow
def test_a_plan_of_another_scene_is_found_out():
    """Also where the kernels of this one are longer than its transform."""
    shutter = HannShutter()
    other = plan(SCENE, MOTION, shutter)
    fast = Scene([40 * 1500.0], photon_rate=1e6, read_noise=4.0, limits=LIMITS)
    assert sizes(fast, MOTION).num_taps > other.dft_length
    with pytest.raises(WrongPlanError, match="must change no result by more than"):
        check_plan(other, fast, MOTION, shutter)


def test_what_is_no_plan_is_refused():
    """False, or a word, is neither a plan nor the None that asks for everything."""
    for value in (False, "exact"):
        with pytest.raises(ValueError, match=r"`plan` must be a plan, or None for everything; got"):
            require_plan(value)


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"free": "speed"}, "name some of shutter"),
    ],
)
def test_what_cannot_be_planned_is_refused(arguments, text):
    """Each mistake in the call is one line that names the argument."""
    with pytest.raises(ValueError, match=text):
        plan(SCENE, MOTION, PROFILE, **arguments)


def test_a_stroke_that_is_hardly_one_has_sizes():
    """A kernel whose length is past all numbers has the taps of any other that is too long."""
    sized = [
        sizes(SCENE, ParabolicMotion(acceleration=stroke / 1e-4, half_exposure=0.01))
        for stroke in (1e-320, 1e-9)
    ]
    assert sized[0].num_taps == sized[1].num_taps


@pytest.mark.parametrize(
    ("cutoff", "text"),
    [
        (0.0, "be above 0 and at most 0.5 cycles/px; got 0.0"),
        (0.7, "be above 0 and at most 0.5 cycles/px; got 0.7"),
        (np.nan, "be finite; got nan"),
        ([0.1, 0.2], "be a scalar"),
    ],
)
def test_optics_that_cannot_be_are_refused(cutoff, text):
    """The cut-off lies between no light and what pixels record."""
    with pytest.raises(ValueError, match=text):
        Scene([0.0], photon_rate=1e5, read_noise=1.0, cutoff_frequency=np.asarray(cutoff))


def test_a_plan_is_hashable_and_its_table_is_no_part_of_it():
    """Plans of the same sizes share a program, whatever they say."""
    found = plan(SCENE, MOTION, PROFILE)
    assert hash(found) == hash(replace(found, items=()))
    assert found == replace(found, items=())
    lines = str(found).splitlines()
    assert lines[0].split()[:3] == ["item", "full", "kept"]
    assert len(lines) == 1 + len(found.items)
    assert Plan.from_dict(json.loads(json.dumps(found.to_dict()))) == found


@pytest.mark.slow
def test_a_design_records_its_plan(tmp_path):
    """The file holds the plan, and a file from before there were plans still loads."""
    design = optimise(
        SCENE, MOTION, PROFILE, loss=ExpectedErrorLoss(), free="shutter", num_starts=2, max_steps=2
    )
    assert item(design.plan, "a step of the search").kept == "one product"
    path = tmp_path / "design.json"
    design.save(path)
    read = Design.load(path)
    assert read.plan == design.plan
    assert str(read.plan) == str(design.plan)
    document = json.loads(path.read_text("utf-8"))
    del document["plan"], document["scene"]["cutoff_frequency"]
    path.write_text(json.dumps(document))
    assert Design.load(path).plan is None
    assert float(Design.load(path).scene.cutoff_frequency) == 0.5


def test_the_command_prints_the_plan(capsys):
    """Without a scene file `mishutter plan` shows the built-in scene's, as text or JSON."""
    assert cli.main(["plan", "--free", "shutter"]) == 0
    text = capsys.readouterr().out
    assert "4 mirrored" in text
    assert text.rstrip().endswith("Together these choices change nothing beyond rounding.")
    assert cli.main(["plan", "--json", "--fixed", "--loss", "design"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["skips"]
    assert {entry["name"] for entry in document["items"]} >= {"speeds", "taps", "frequencies"}


def test_a_camera_at_rest_is_planned(tmp_path, capsys):
    """Where nothing is named, what can move is free: a still camera's profile and exposure."""
    path = tmp_path / "still.toml"
    path.write_text(edited("stroke_px", "stroke_px = 0"))
    assert cli.main(["plan", str(path)]) == 0
    assert "acceleration not free" in capsys.readouterr().out


@pytest.mark.slow
def test_a_closed_shutter_is_planned():
    """Zero light gives infinities in both computations, which agree."""
    closed = ChippedShutter(np.zeros(4))
    assert plan_error(plan(SCENE, MOTION, closed), SCENE, MOTION, closed) == 0
    assert plan_error(plan(SCENE, MOTION, RectShutter()), SCENE, MOTION, RectShutter()) < 1e-12


def scene_of_numbers(seed):
    """A scene that differs in light, speeds and picture alone."""
    random = np.random.default_rng(seed)
    speeds = np.linspace(-1, 1, 5 + 2 * (seed % 2)) * random.uniform(700, 1900)
    return Scene(
        speeds,
        photon_rate=10 ** random.uniform(4, 7),
        read_noise=random.uniform(1, 9),
        power_spectrum=random.uniform(0.2, 1, 256),
        limits=LIMITS,
    )


@pytest.mark.slow
def test_a_second_scene_compiles_nothing(caplog):
    """Planning, searching and measuring run the programs of the first scene."""

    def design(seed):
        scene = scene_of_numbers(seed)
        options = {"loss": ExpectedErrorLoss(), "free": "shutter", "num_starts": 2, "max_steps": 3}
        found = plan(scene, MOTION, PROFILE, loss=options["loss"], free="shutter")
        design = optimise(scene, MOTION, PROFILE, plan=found, **options)
        return float(design.metrics.expected_psnr)

    levels = [design(0), design(1)]
    with compiled_programs(caplog) as programs:
        levels += [design(seed) for seed in range(2, 10)]
    assert not programs
    assert len(set(levels)) == len(levels)


@pytest.mark.slow
def test_a_verbose_search_shows_its_plan(capsys, monkeypatch):
    """The table is a message on standard error, and what is printed is what is searched by."""
    found = optimise(example_scene(), free="shutter", num_starts=1, max_steps=1)

    def search(*_, **__):
        raise ValueError("the search must be left out; got here")

    # The table is printed before the search, which would take the longer part of the test.
    monkeypatch.setattr("mishutter.search.optimise", search)
    assert cli.main(["optimise", "--verbose", "--free", "shutter"]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert " ".join(str(found.plan).split()) in " ".join(printed.err.split())


def test_a_range_that_mirrors_itself_is_folded_whole():
    """Ends of a range that differ from their mirror images by rounding are one speed."""
    for count in (9, 11, 12):
        speeds = np.linspace(-1, 1, count) * 3271.7
        scene = Scene(speeds, photon_rate=1e5, read_noise=4.0)
        folded, weights = distinct_speeds(scene, folds=True)
        assert folded.size == (count + 1) // 2
        assert np.isclose(weights.sum(), 1, rtol=1e-14)
        assert distinct_speeds(scene, folds=False)[0].size == count


SINGLE = Scene(
    np.array([-1400.0, -300.0, 0.0, 300.0, 650.0, 1400.0], np.float32),
    photon_rate=np.float32(2e5),
    read_noise=np.float32(6.0),
    limits=LIMITS,
)
SLOWER = ParabolicMotion(acceleration=np.float32(1.1e5), half_exposure=np.float32(0.01))


@pytest.mark.slow
@pytest.mark.parametrize("loss", [None, ExpectedErrorLoss(), DesignLoss()])
def test_plans_of_single_precision_are_judged_by_its_rounding(loss):
    """An exact plan passes the guard, and one that leaves taps and frequencies out is caught."""
    given = SINGLE, SLOWER, GaussianShutter(np.float32(0.3))
    exact = plan(*given, loss=loss)
    assert check_plan(exact, *given, loss=loss) < 1e-5
    assert item(exact, "precision").kept == "float32"
    with pytest.raises(WrongPlanError, match="must change no result by more than 1e-05"):
        check_plan(replace(exact, num_taps=16, num_kept=16), *given, loss=loss)


@pytest.mark.parametrize("loss", [ExpectedErrorLoss(), DesignLoss()])
def test_a_plan_of_a_search_holds_all_over_its_space(loss):
    """Taps and nodes that are enough at one motion are not enough for all of them."""
    scene = Scene([-1500.0, 1500.0], photon_rate=1e3, read_noise=9.0, limits=LIMITS)
    given = scene, MOTION, HannShutter()
    alone, found = plan(*given, loss=loss), plan(*given, loss=loss, free=FREE)
    assert found.num_taps > alone.num_taps
    assert found.num_nodes >= alone.num_nodes
