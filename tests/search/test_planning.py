"""Plans: what is left out changes nothing, and a wrong plan is found out.

Each scene is measured as planned and in full by `plan_error`; the tests that break a plan on
purpose go through it too.
"""

import inspect
import json
from dataclasses import replace

import numpy as np
import pytest
from support.bad_scenes import edited
from support.plan_check import plan_error, plan_for
from support.programs import compiled_programs
from support.random_scenes import LIMITS, PROFILE, random_scene

import mishutter
from mishutter import (
    AbstractLoss,
    ChippedShutter,
    DesignLoss,
    ExpectedErrorLoss,
    GaussianShutter,
    HannShutter,
    Occlusion,
    Optics,
    ParabolicMotion,
    RectShutter,
    Scene,
    StillCamera,
    Texture,
    TukeyShutter,
    cli,
    evaluate,
    optimise,
)
from mishutter.evaluation.needs import distinct_speeds, reduced, sizes
from mishutter.model.optics import frequencies
from mishutter.search.planning import plan

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
def test_exact_skips_change_nothing(seeds):
    """Losses and metrics of the twelve kinds of random scenes agree to 1e-12 with all computed."""
    for seed in seeds:
        scene, motion, shutter = random_scene(seed)
        for loss in LOSSES.values():
            right = plan_for(scene, motion, shutter, loss)
            assert plan_error(right, scene, motion, shutter, loss=loss) <= 1e-12


def test_speeds_are_dropped_merged_and_folded():
    """A speed that never occurs, one that occurs twice and a mirrored one are left out."""
    speeds, weights = [0.0, 600.0, 600.0, -600.0, 1300.0], [0.25, 0.125, 0.125, 0.5, 0.0]
    scene = Scene(speeds, weights, photon_rate=1e5, read_noise=3.0, limits=LIMITS)
    found = plan(scene, MOTION, HannShutter(), loss=ExpectedErrorLoss())
    assert found.skips[0] == (
        "2 of 5 speeds are computed: 1 never occur, 1 occur twice, 1 mirror others, to which a "
        "symmetric shutter does the same."
    )
    kept = reduced(scene, found.sizes)
    assert np.array_equal(kept.speeds, [0.0, 600.0])
    assert np.allclose(kept.weights, [0.25, 0.75])
    one_sided = plan(scene, MOTION, ChippedShutter([1.0, 0.4]), loss=ExpectedErrorLoss())
    assert one_sided.skips[0].startswith("3 of 5 speeds are computed: 1 never occur, 1 occur twice")


def test_effective_speeds_are_for_edges_alone():
    """There are some where objects have edges, and more of them for a longer exposure."""
    layers = {"edges": Occlusion(front_share=0.4, object_width=70.0), "none": None}
    layers["without edges"] = Occlusion(front_share=0.4)
    counts = {}
    for name, occlusion in layers.items():
        scene = Scene([-4600.0, 1300.0], photon_rate=1e5, read_noise=3.0, occlusion=occlusion)
        for half in (0.002, 0.019):
            found = plan_for(scene, StillCamera(half_exposure=half), HannShutter())
            assert (found.num_effective_speeds > 0) == (name == "edges")
            counts[name, half] = found.num_effective_speeds
    assert counts["edges", 0.019] > counts["edges", 0.002]


@pytest.mark.slow
def test_a_still_scene_needs_one_kernel():
    """Where nothing moves no invariance is computed, and none is reported."""
    scene = Scene([0.0, 0.0], photon_rate=1e5, read_noise=3.0, limits=LIMITS)
    found = plan_for(scene, MOTION, HannShutter())
    assert found.still
    one = "One kernel is computed: nothing moves."
    assert one in plan(scene, MOTION, HannShutter(), loss=DesignLoss()).skips
    assert plan_error(found, scene, MOTION, HannShutter()) <= 1e-12
    assert float(evaluate(scene, MOTION, HannShutter()).kernel_difference) == 0


def test_frequencies_stop_where_the_optics_do():
    """Only frequencies with power are computed, for a loss that sees no others."""
    scene = Scene(
        [0.0, 900.0], photon_rate=1e5, read_noise=3.0, optics=Optics(cutoff_frequency=0.1)
    )
    found = plan(scene, MOTION, HannShutter(), loss=ExpectedErrorLoss())
    assert found.sizes.num_kept == found.sizes.num_frequencies // 4 == 384
    above = "384 of 1,536 frequencies are computed: the picture on the sensor holds no power above."
    assert above in found.skips
    of_metrics = plan_for(scene, MOTION, HannShutter())
    assert found.sizes.num_nodes < of_metrics.num_nodes
    assert of_metrics.num_kept is None


@pytest.mark.slow
@pytest.mark.parametrize("share", [16, 4])
def test_the_last_frequency_with_power_is_kept(share):
    """One more than fill a size, at the cutoff itself; and the nodes of a path that is long."""
    speeds, light = [-80000.0, 50000.0], {"photon_rate": 1e9, "read_noise": 0.0}
    motion = ParabolicMotion(acceleration=190.0 / 1e-4, half_exposure=1e-2)
    count = sizes(Scene(speeds, **light), motion).num_frequencies
    full_size = count // share
    scene = Scene(speeds, **light, optics=Optics(cutoff_frequency=frequencies(count)[full_size]))
    for shutter in (RectShutter(), TukeyShutter(0.3)):
        found = plan_for(scene, motion, shutter, ExpectedErrorLoss())
        assert full_size < found.num_kept < count
        assert plan_error(found, scene, motion, shutter, loss=ExpectedErrorLoss()) <= 1e-12


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
    right = plan_for(scene, MOTION, shutter, loss)
    assert plan_error(right, scene, MOTION, shutter, loss=loss) <= 1e-12
    assert plan_error(replace(right, **wrong), scene, MOTION, shutter, loss=loss) > 1e-12


@pytest.mark.slow
def test_a_plan_of_another_scene_is_found_out():
    """Also where the kernels of this one are longer than its transform."""
    shutter = HannShutter()
    other = plan_for(SCENE, MOTION, shutter)
    fast = Scene([40 * 1500.0], photon_rate=1e6, read_noise=4.0, limits=LIMITS)
    assert sizes(fast, MOTION).num_taps > other.dft_length
    assert plan_error(other, fast, MOTION, shutter) > 1e-12


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        ({"free": "speed"}, "name some of shutter"),
    ],
)
def test_what_cannot_be_planned_is_refused(arguments, text):
    """Each mistake in the call is one line that names the argument."""
    with pytest.raises(ValueError, match=text):
        plan(SCENE, MOTION, PROFILE, loss=ExpectedErrorLoss(), **arguments)


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
        Scene(
            [0.0],
            photon_rate=1e5,
            read_noise=1.0,
            optics=Optics(cutoff_frequency=np.asarray(cutoff)),
        )


def test_the_command_prints_the_plan(capsys):
    """Without a scene file `mishutter plan` shows the built-in scene's, as text or JSON."""
    assert cli.main(["plan", "--free", "shutter"]) == 0
    text = capsys.readouterr().out
    assert "4 mirror others" in text
    assert "A step of the search is one matrix product" in text
    assert text.rstrip().endswith("Together these skips change nothing beyond rounding.")
    assert len(text.splitlines()) <= 25
    assert cli.main(["plan", "--json", "--fixed", "--loss", "design"]) == 0
    document = json.loads(capsys.readouterr().out)
    none = "No transfer function is computed: the loss is made from kernels."
    assert document["skipped"][-1] == none
    assert document["num_taps"] > 16


def test_a_camera_at_rest_is_planned(tmp_path, capsys):
    """Where nothing is named, what can move is free: a still camera's profile and exposure."""
    path = tmp_path / "still.toml"
    path.write_text(edited("stroke_px", "stroke_px = 0"))
    assert cli.main(["plan", str(path)]) == 0
    assert "These parts are fixed: velocity, acceleration." in capsys.readouterr().out


@pytest.mark.slow
def test_a_closed_shutter_is_planned():
    """Zero light gives infinities in both computations, which agree."""
    closed = ChippedShutter(np.zeros(4))
    for shutter, most in ((closed, 0.0), (RectShutter(), 1e-12)):
        found = plan_for(SCENE, MOTION, shutter)
        assert plan_error(found, SCENE, MOTION, shutter) <= most


def scene_of_numbers(seed):
    """A scene that differs in light, speeds and picture alone."""
    random = np.random.default_rng(seed)
    speeds = np.linspace(-1, 1, 5 + 2 * (seed % 2)) * random.uniform(700, 1900)
    return Scene(
        speeds,
        photon_rate=10 ** random.uniform(4, 7),
        read_noise=random.uniform(1, 9),
        picture=Texture(power_spectrum=random.uniform(0.2, 1, 256)),
        limits=LIMITS,
    )


@pytest.mark.slow
def test_a_second_scene_compiles_nothing(caplog):
    """Planning, searching and measuring run the programs of the first scene."""

    def design(seed):
        scene = scene_of_numbers(seed)
        options = {"loss": ExpectedErrorLoss(), "free": "shutter", "num_starts": 2, "max_steps": 3}
        design = optimise(scene, MOTION, PROFILE, **options)
        return float(design.metrics.expected_psnr)

    levels = [design(0), design(1)]
    with compiled_programs(caplog) as programs:
        levels += [design(seed) for seed in range(2, 10)]
    assert not programs
    assert len(set(levels)) == len(levels)


def test_a_range_that_mirrors_itself_is_folded_whole():
    """Ends of a range that differ from their mirror images by rounding are one speed."""
    for count in (9, 11, 12):
        speeds = np.linspace(-1, 1, count) * 3271.7
        scene = Scene(speeds, photon_rate=1e5, read_noise=4.0)
        folded, weights = distinct_speeds(scene, folds=True)
        assert folded.size == (count + 1) // 2
        assert np.isclose(weights.sum(), 1, rtol=1e-14)
        assert distinct_speeds(scene, folds=False)[0].size == count


def test_nobody_is_asked_for_a_plan():
    """Public functions, losses and decoders plan by themselves."""
    public = [getattr(mishutter, name) for name in dir(mishutter)]
    losses = [x.__call__ for x in public if isinstance(x, type) and issubclass(x, AbstractLoss)]
    calls = [*losses, *(x for x in public if callable(x) and not isinstance(x, type))]
    asking = [each for each in calls if "plan" in inspect.signature(each).parameters]
    assert len(calls) > 40
    assert not asking


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
    exact = plan_for(*given, loss)
    assert plan_error(exact, *given, loss=loss) < 1e-5
    assert plan_error(replace(exact, num_taps=16, num_kept=16), *given, loss=loss) > 1e-5


@pytest.mark.parametrize("loss", [ExpectedErrorLoss(), DesignLoss()])
def test_a_plan_of_a_search_holds_all_over_its_space(loss):
    """Taps and nodes that are enough at one motion are not enough for all of them."""
    scene = Scene([-1500.0, 1500.0], photon_rate=1e3, read_noise=9.0, limits=LIMITS)
    given = scene, MOTION, HannShutter()
    alone, found = plan_for(*given, loss), plan(*given, loss=loss, free=FREE).sizes
    assert found.num_taps > alone.num_taps
    assert found.num_nodes >= alone.num_nodes
