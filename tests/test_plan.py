"""Plans: what is left out changes nothing, is said, and a wrong plan is found out.

Each scene is measured as planned and in full by the same function that guards plans with a
tolerance, `check_plan`; the tests that break a plan on purpose go through it too.
"""

import json
import sys
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from bad_scenes import edited

from mishutter import (
    AbstractLoss,
    ChippedShutter,
    Design,
    DesignLoss,
    ExpectedErrorLoss,
    GaussianShutter,
    HannShutter,
    Limits,
    ParabolicMotion,
    Plan,
    RectShutter,
    Scene,
    SplineShutter,
    StillCamera,
    TukeyShutter,
    WrongPlanError,
    check_plan,
    cli,
    evaluate,
    optimise,
    plan,
    plan_error,
)
from mishutter.plan import reduced, require_plan, sizes
from mishutter.speeds import distinct_speeds
from mishutter.waves import frequencies

LIMITS = Limits(max_stroke=30.0, max_top_speed=2e4, min_half_exposure=5e-4, max_half_exposure=0.03)
MOTION = ParabolicMotion(acceleration=11.0 / 1e-4, half_exposure=1e-2)
PROFILE = SplineShutter.fit(TukeyShutter(0.45), 10, symmetric=True)
LOSSES = {
    "metrics": None,
    "expected_error": ExpectedErrorLoss(),
    "design": DesignLoss(),
    "no_invariance": DesignLoss(invariance=0.0),
    "sum": 0.7 * ExpectedErrorLoss() + 0.0 * DesignLoss(),
}
FREE = ("acceleration", "half_exposure")
SHUTTERS = (GaussianShutter(0.3), PROFILE, ChippedShutter([0.2, 0.9, 1.0, 0.4]))


def random_scene(seed):
    """A scene, a motion and a shutter; speeds that repeat, mirror, never occur or stand still.

    Twelve kinds, so that two hundred scenes share some dozens of compiled programs.
    """
    random = np.random.default_rng(seed)
    moving = random.uniform(-1500, 1500, 2)
    kind = seed % 4
    speeds = {
        0: [*moving, *-moving, 0.0],
        1: [moving[0], moving[0], moving[1], 0.0, 700.0],
        2: [0.0, 0.0, 900.0, -900.0, 0.0],
        3: [*moving, 400.0, -400.0, 300.0],
    }[kind]
    weights = random.uniform(0.2, 1, 5)
    if kind == 2:
        weights[2:4] = 0
    if kind == 3:
        weights[1] = 0
    cutoff = (0.5, 0.27, 0.11)[seed % 3]
    scene = Scene(
        speeds,
        weights / weights.sum(),
        photon_rate=10 ** random.uniform(3, 7),
        read_noise=random.uniform(0, 12) * random.integers(2),
        cutoff_frequency=cutoff,
        power_spectrum=random.uniform(0, 1, 256) if seed % 2 else None,
        limits=LIMITS,
    )
    half = 0.01 * random.uniform(0.8, 1.1)
    motion = ParabolicMotion(acceleration=random.uniform(9, 14) / half**2, half_exposure=half)
    still = StillCamera(half_exposure=half)
    return scene, still if seed % 12 in (3, 4) else motion, SHUTTERS[seed % 3]


def check_scene(seed):
    """Every loss and all metrics of a random scene, as planned and in full."""
    scene, motion, shutter = random_scene(seed)
    for loss in LOSSES.values():
        check_plan(plan(scene, motion, shutter, loss=loss), scene, motion, shutter, loss=loss)


@pytest.mark.parametrize("seed", range(6))
def test_exact_skips_change_nothing(seed):
    """Losses and metrics agree to 1e-12 with a computation of everything."""
    check_scene(seed)


def check_toleranced(seed):
    """Bound over change of a plan with a tolerance; None where it skips nothing more."""
    scene, motion, shutter = random_scene(seed)
    loss = (None, ExpectedErrorLoss(), DesignLoss())[seed // 12 % 3]
    found = plan(scene, motion, shutter, loss=loss, tolerance=1e-3)
    change = check_plan(found, scene, motion, shutter, loss=loss)
    assert found.bound <= 1e-3
    assert all((item.bound or 0) <= 1e-3 / 4 for item in found.items)
    return None if found.bound == 0 else found.bound / max(change, 1e-15)


@pytest.mark.parametrize("seed", [0, 12, 25, 3])
def test_skips_with_a_tolerance_keep_their_bound(seed):
    """The change is within the bound, and the bound of each of four skips within its share."""
    check_toleranced(seed)


@pytest.mark.parametrize("loss", [ExpectedErrorLoss(), DesignLoss()])
def test_a_plan_of_a_search_holds_all_over_its_space(loss):
    """Taps, nodes and precision that are enough at one motion are left as they are."""
    scene = Scene([-1500.0, 1500.0], photon_rate=1e3, read_noise=9.0, limits=LIMITS)
    given = scene, MOTION, HannShutter()
    alone = plan(*given, loss=loss, tolerance=0.1)
    exact, found = (plan(*given, loss=loss, free=FREE, tolerance=size) for size in (0.0, 0.1))
    assert alone.single
    assert not found.single
    assert found.num_taps == exact.num_taps > alone.num_taps
    assert found.num_nodes == exact.num_nodes > alone.num_nodes


def test_a_tolerance_that_was_not_kept_is_given_up(monkeypatch):
    """A plan is checked as a whole at the design, and the exact one stands in for it."""
    given = SCENE, MOTION, TukeyShutter(0.45)
    exact = plan(*given, loss=ExpectedErrorLoss())

    def too_small(found, *args, **options):
        return replace(found, num_nodes=16)

    monkeypatch.setattr("mishutter.planning.toleranced", too_small)
    assert plan(*given, loss=ExpectedErrorLoss(), tolerance=1e-3) == exact


@pytest.mark.slow
def test_skips_with_a_tolerance_keep_their_bound_on_many_scenes():
    """On two hundred scenes; the median bound is less than a hundred times the change."""
    ratios = [check_toleranced(seed) for seed in range(200)]
    known = [ratio for ratio in ratios if ratio is not None]
    assert len(known) > 100
    assert np.median(known) < 100


@pytest.mark.slow
def test_exact_skips_change_nothing_on_many_scenes():
    """The same on two hundred scenes more."""
    for seed in range(6, 206):
        check_scene(seed)


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


@pytest.mark.parametrize(
    ("wrong", "loss"),
    [
        ({"num_speeds": 2}, None),
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
    speeds = [-1500.0, -200.0, 0.0, 700.0, 1500.0]
    scene = Scene(speeds, photon_rate=1e6, read_noise=4.0, limits=LIMITS)
    shutter = ChippedShutter([0.2, 0.9, 1.0, 0.4])
    right = plan(scene, MOTION, shutter, loss=loss)
    assert check_plan(right, scene, MOTION, shutter, loss=loss) <= 1e-12
    with pytest.raises(WrongPlanError, match="must change no result by more than 1e-12"):
        check_plan(replace(right, **wrong), scene, MOTION, shutter, loss=loss)


def test_a_plan_may_change_what_its_bound_says():
    """And no more: a change just above the bound is refused, one just below is returned."""
    given = SCENE, MOTION, RectShutter()
    right = plan(*given)
    short = replace(right, num_taps=16)
    change = plan_error(short, *given)
    assert change > 1e-3
    for share, kept in ((0.9, False), (1.1, True)):
        told = replace(short, items=(replace(right.items[0], bound=share * change),))
        if kept:
            assert check_plan(told, *given) == change
        else:
            with pytest.raises(WrongPlanError, match="must change no result by more than"):
                check_plan(told, *given)


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
        ({"tolerance": -0.1}, "be a finite number of at least 0; got -0.1"),
        ({"tolerance": float("inf")}, "be a finite number of at least 0; got inf"),
        ({"free": "speed"}, "name some of shutter"),
    ],
)
def test_what_cannot_be_planned_is_refused(arguments, text):
    """Each mistake in the call is one line that names the argument."""
    with pytest.raises(ValueError, match=text):
        plan(SCENE, MOTION, PROFILE, **arguments)


def test_a_stroke_that_is_hardly_one_has_sizes():
    """A kernel whose length is past all numbers has those of any other that is too long."""
    sized = [
        sizes(SCENE, ParabolicMotion(acceleration=stroke / 1e-4, half_exposure=0.01))
        for stroke in (1e-320, 1e-9)
    ]
    assert sized[0] == sized[1]


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
    assert hash(found) == hash(replace(found, items=(), tolerance=0.5))
    assert found == replace(found, items=())
    lines = str(found).splitlines()
    assert lines[0].split()[:3] == ["item", "full", "kept"]
    assert len(lines) == 1 + len(found.items)
    assert Plan.from_dict(json.loads(json.dumps(found.to_dict()))) == found


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
    document = json.loads(path.read_text())
    del document["plan"], document["scene"]["cutoff_frequency"]
    path.write_text(json.dumps(document))
    assert Design.load(path).plan is None
    assert float(Design.load(path).scene.cutoff_frequency) == 0.5


def test_the_command_prints_the_plan(capsys):
    """Without a scene file `mishutter plan` shows the built-in scene's, as text or JSON."""
    assert cli.main(["plan", "--free", "shutter"]) == 0
    text = capsys.readouterr().out
    assert "4 mirrored" in text
    assert text.rstrip().endswith("All together change nothing beyond rounding.")
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


def test_a_tolerance_out_of_range_is_one_line(capsys):
    """The command refuses it with exit code 2."""
    assert cli.main(["plan", "--tolerance", "-1"]) == 2
    assert "`--tolerance` must be greater than or equal to 0; got '-1'" in capsys.readouterr().err


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


def test_a_second_scene_compiles_nothing(caplog):
    """Planning, searching and measuring run the programs of the first scene."""

    def design(seed):
        scene = scene_of_numbers(seed)
        options = {"loss": ExpectedErrorLoss(), "free": "shutter", "num_starts": 2, "max_steps": 3}
        found = plan(scene, MOTION, PROFILE, loss=options["loss"], free="shutter")
        design = optimise(scene, MOTION, PROFILE, plan=found, **options)
        return float(design.metrics.expected_psnr)

    levels = [design(0), design(1)]
    with jax.log_compiles():
        levels += [design(seed) for seed in range(2, 10)]
    assert not [r.message for r in caplog.records if r.message.startswith("Compiling")]
    assert len(set(levels)) == len(levels)


class _FitsHere(AbstractLoss):
    """Right about the design at hand, and far off at any other under a small plan."""

    def __call__(self, scene, motion, shutter, *, plan=None):
        whole = ExpectedErrorLoss()(scene, motion, shutter, plan=None)
        light = shutter.efficiency()
        off = plan is not None and getattr(plan, "num_speeds", None) is not None
        return whole + 3 * jnp.square(light - PROFILE.efficiency()) if off else whole


def test_a_search_whose_end_is_off_goes_on_exactly():
    """A plan that held at the start only is given up, and the exact loss is reported."""
    loose = plan(SCENE, MOTION, PROFILE, loss=_FitsHere(), free="shutter", tolerance=0.02)
    assert loose.num_speeds is not None
    options = {"loss": _FitsHere(), "free": "shutter", "num_starts": 2, "max_steps": 12}
    design = optimise(SCENE, MOTION, PROFILE, plan=loose, **options)
    assert design.plan.num_speeds is None
    value = float(ExpectedErrorLoss()(SCENE, MOTION, design.shutter, plan=None))
    assert design.loss == pytest.approx(value, rel=1e-12)


def test_a_search_with_a_tolerance_reports_the_exact_loss():
    """Where the plan holds at the end, only the loss is measured anew."""
    loss = ExpectedErrorLoss()
    many = np.linspace(-1500, 1500, 15)
    scene = Scene(many, photon_rate=1e6, read_noise=4.0, limits=LIMITS)
    loose = plan(scene, MOTION, PROFILE, loss=loss, free="shutter", tolerance=0.05)
    assert 0 < loose.bound <= 0.05
    options = {"loss": loss, "free": "shutter", "num_starts": 2, "max_steps": 12}
    design = optimise(scene, MOTION, PROFILE, plan=loose, **options)
    assert design.plan == loose
    value = float(loss(scene, MOTION, design.shutter, plan=None))
    assert design.loss == pytest.approx(value, rel=1e-12)


def test_a_search_with_a_tolerance_is_never_worse_than_its_start():
    """A start that the exact loss holds best is not left for what looks better by a tolerance."""
    loss = ExpectedErrorLoss()
    scene = Scene.uniform(
        max_speed=2000.0, num_speeds=9, photon_rate=1e5, read_noise=10.0, limits=LIMITS
    )
    options = {"loss": loss, "free": "shutter"}
    best = optimise(scene, MOTION, PROFILE, num_starts=6, **options)
    given = scene, MOTION, best.shutter
    loose = plan(*given, tolerance=0.05, **options)
    assert loose.bound > 0
    again = optimise(*given, num_starts=1, plan=loose, **options)
    start = float(loss(*given, plan=None))
    assert again.loss <= again.best_start_loss * (1 + 1e-12)
    assert again.best_start_loss == pytest.approx(start, rel=1e-12)
    assert again.loss <= start * (1 + 1e-12)
    from_afar = optimise(scene, MOTION, PROFILE, num_starts=6, plan=loose, **options)
    assert np.all(np.diff(from_afar.history) <= 0)
    assert from_afar.history[-1] == from_afar.loss


def test_a_verbose_search_shows_its_plan(capsys, monkeypatch):
    """The table is a message on standard error, and what is printed is what is searched by."""
    seen = []

    def search(*_, plan, **__):
        seen.append(plan)
        raise ValueError("the search must be left out; got here")

    monkeypatch.setattr(sys.modules["mishutter.optimise"], "optimise", search)
    assert cli.main(["optimise", "--verbose", "--free", "shutter"]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert str(seen[0]) in printed.err


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


@pytest.mark.parametrize("loss", [None, ExpectedErrorLoss(), DesignLoss()])
def test_plans_of_single_precision_are_judged_by_its_rounding(loss):
    """An exact plan passes the guard, one with a tolerance skips as much, a wrong one is caught."""
    shutter = GaussianShutter(np.float32(0.3))
    given = SINGLE, SLOWER, shutter
    exact, loose = (plan(*given, loss=loss, tolerance=t) for t in (0.0, 0.02))
    assert check_plan(exact, *given, loss=loss) < 1e-5
    assert check_plan(loose, *given, loss=loss) < 0.02
    assert 1e-5 < loose.bound <= 0.02
    assert not loose.single
    assert item(loose, "precision").kept == "float32"
    wide = tuple(jax.tree.map(lambda leaf: leaf.astype(np.float64), part) for part in given)
    double = plan(*wide, loss=loss, tolerance=0.02)
    sizes_of = ("num_taps", "num_kept", "num_speeds")
    assert all(getattr(loose, name) == getattr(double, name) for name in sizes_of)
    with pytest.raises(WrongPlanError, match="must change no result by more than 1e-05"):
        check_plan(replace(exact, num_speeds=1), *given, loss=loss)
