"""Designs through a device that loses light, and for pixels that hold some and no more."""

from functools import cache

import jax.numpy as jnp
import numpy as np
import pytest
from support.designs import LIMITS, MOTION, SCENE

from mishutter import (
    BurstMode,
    ChippedShutter,
    Design,
    DesignLoss,
    ExpectedErrorLoss,
    FirstOrderDevice,
    HannShutter,
    IdealDevice,
    RectShutter,
    Scene,
    Sensor,
    SplineShutter,
    StillCamera,
    SwitchedDevice,
    compare,
    evaluate,
    optimise,
    sweep,
)
from mishutter.evaluation.needs import automatic
from mishutter.model.slots import diffused, runs_are_long_enough, slot_means
from mishutter.search.objective import objective_of
from mishutter.search.space import beyond_limits, design_space
from mishutter.sweeps.trade_offs import best_snapshots

LEAKY = IdealDevice(transmission=0.8, leakage=0.2)


def _scene(**others):
    given = {"photon_rate": 1e5, "read_noise": 10.0, "limits": LIMITS}
    return Scene(SCENE.speeds, **(given | others))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("loss", "free"),
    [
        (ExpectedErrorLoss(), ("shutter", "half_exposure", "acceleration")),
        (DesignLoss(), "shutter"),
    ],
)
def test_a_design_knows_what_its_device_does(loss, free):
    """The loss that the search reports is that of the light, however it was computed."""
    scene = _scene(device=LEAKY)
    found = optimise(scene, MOTION, loss=loss, free=free, num_starts=4, max_steps=40)
    assert float(loss(scene, found.motion, found.shutter)) == pytest.approx(found.loss, rel=1e-5)
    assert float(loss(scene, found.motion, found.command)) == pytest.approx(found.loss, rel=1e-5)
    least = 0.8 * 0.2
    light = np.asarray(found.shutter.transmittance(np.linspace(-1, 1, 101)))
    assert np.all((light >= least - 1e-6) & (light <= 0.8 + 1e-6))
    again = optimise(scene, found.motion, found.shutter, loss=loss, free=free, num_starts=2)
    assert again.loss <= found.loss * (1 + 1e-5)


def test_a_search_has_no_step_where_a_profile_comes_to_stay_open():
    """It compares profiles behind the device; the design that ends open is measured without it."""
    scene, loss = _scene(device=LEAKY), DesignLoss(condition=0, invariance=0, efficiency=1)
    start = ChippedShutter(np.full(3, 0.4))
    space = design_space(scene, MOTION, start, ("shutter",))
    plan, both = automatic(scene, MOTION, start), (loss, ExpectedErrorLoss())
    objectives = [objective_of(each, scene, space, plan) for each in both]
    free = ("shutter", "half_exposure")  # which no sum of responses stands for
    wider = design_space(scene, MOTION, start, free)
    objectives.append(objective_of(ExpectedErrorLoss(), scene, wider, plan))
    for objective in objectives:
        size = wider.size if objective is objectives[-1] else 3
        boxes = [jnp.full(size, 0.4).at[:3].set(share) for share in (1.0, 1 - 1e-6)]
        ends = [float(objective(point)) for point in boxes]
        assert ends[0] == pytest.approx(ends[1], rel=1e-5)
    assert float(objectives[0](jnp.ones(3))) == pytest.approx(0.2, rel=1e-6)
    found = optimise(scene, MOTION, start, loss=loss, free="shutter", num_starts=2, max_steps=20)
    assert found.shutter is found.command
    assert float(found.metrics.efficiency) == pytest.approx(1, rel=1e-6)
    assert found.loss == pytest.approx(float(loss(scene, MOTION, found.command)), abs=1e-6)
    assert found.loss == pytest.approx(0, abs=1e-6)


@pytest.mark.slow
def test_a_sweep_measures_an_open_profile_without_the_device():
    """As `evaluate` does, in every metric; one that is not open pays for it."""
    scene, loss = _scene(device=LEAKY), DesignLoss(condition=0, invariance=0, efficiency=1)
    axes = {"accelerations": [1.5e5], "half_exposures": [9e-3]}
    metrics = ["expected_psnr", "worst_speed_psnr", "efficiency", "condition_number"]
    found = sweep(
        scene, **axes, shutters={"Hann": HannShutter()}, optimise=True, loss=loss, metrics=metrics
    )
    point = found.sel(acceleration=1.5e5, half_exposure=9e-3, shutter="optimised")
    motion = type(MOTION)(acceleration=1.5e5, half_exposure=9e-3)
    opened = evaluate(scene, motion, RectShutter())
    for name in metrics:
        assert point[name].item() == pytest.approx(float(getattr(opened, name)), rel=1e-5)
    assert point.loss.item() == pytest.approx(0, abs=1e-6)


SHUTTERS = {"free": None, "Hann": HannShutter(), "rect": RectShutter()}


@cache
def _design_of_pixels(name, full_well):
    """A design of a shutter for pixels that hold so many electrons, or any number."""
    scene = _scene(sensor=Sensor(full_well=full_well), photon_rate=5e4)
    return optimise(scene, MOTION, SHUTTERS[name], num_starts=4, max_steps=60)


@pytest.mark.slow
@pytest.mark.parametrize("full_well", [60.0, 600.0])
@pytest.mark.parametrize("name", SHUTTERS)
def test_no_design_fills_a_pixel(full_well, name):
    """The exposure ends where white fills it, and is no shorter than it need be."""
    found, unlimited = _design_of_pixels(name, full_well), _design_of_pixels(name, None)
    white = 5e4 * float(found.motion.exposure) * float(found.metrics.efficiency)
    assert white <= full_well * (1 + 1e-5)
    wanted = 5e4 * float(unlimited.motion.exposure) * float(unlimited.metrics.efficiency)
    assert found.loss >= unlimited.loss * (1 - 1e-4)
    if wanted <= full_well:
        assert found.loss == pytest.approx(unlimited.loss, rel=1e-4)


@pytest.mark.parametrize("share", [0.97, 1.03, 1.9])
def test_a_full_pixel_is_told_from_one_that_is_nearly_full(share):
    """White brings so much of what a pixel holds: through Hann, half of the light."""
    white = 1e5 * float(MOTION.exposure) / 2
    scene = _scene(sensor=Sensor(full_well=white / share))
    said = beyond_limits(scene, MOTION, HannShutter())
    assert said == (("full_well",) if share > 1 else ())


@pytest.mark.slow
def test_a_held_motion_that_fills_pixels_is_said():
    """In its notes, as one outside other limits is."""
    scene = _scene(sensor=Sensor(full_well=500.0))
    found = optimise(scene, MOTION, HannShutter(), free="acceleration")
    assert "outside the scene's limits" in found.ending


def test_a_pixel_that_any_exposure_fills():
    """Is refused, with the electrons of the shortest."""
    with pytest.raises(ValueError, match=r"`Sensor\(full_well=...\)` must hold .* 100 e-; got 99"):
        optimise(_scene(sensor=Sensor(full_well=99.0)), MOTION)


@pytest.mark.slow
def test_the_best_snapshot_of_a_sweep_fills_no_pixel():
    """The same as a search finds."""
    scene = _scene(sensor=Sensor(full_well=130.0))
    found = optimise(scene, StillCamera(half_exposure=1e-3), RectShutter())
    known = best_snapshots(scene)
    assert float(found.metrics.expected_psnr) == pytest.approx(known.expected_psnr.item(), abs=1e-4)
    assert 1e5 * 2 * known.half_exposure.item() <= 130.0 * (1 + 1e-9)


def test_a_sweep_over_scenes_of_different_devices():
    """Is refused: shutters are sent to one."""
    scenes = {"plain": _scene(), "leaky": _scene(device=LEAKY)}
    with pytest.raises(ValueError, match="share one device and full well"):
        sweep(scenes, accelerations=[0.0], half_exposures=[1e-3])


@pytest.mark.slow
def test_a_shutter_that_loses_light_is_not_built():
    """The verdict names the camera without one, the notes what device and burst do."""
    scene = _scene(
        device=IdealDevice(transmission=0.3),
        burst=BurstMode(frames_per_s=200, max_frames=4),
        limits=LIMITS,
    )
    found = compare(scene, optimise(scene, MOTION, num_starts=4))
    assert "shaped shutter" not in found.choice.needs
    assert "A shaped shutter adds nothing here" in found.verdict
    (light,) = found.notes
    assert light == "The shutter passes 30.0% of the light when open, 0.00% when closed."
    burst = found.row("best still burst")
    assert all(note in found.text() and note in found.to_dict()["notes"] for note in found.notes)
    assert max(map(len, found.notes)) <= 80
    assert burst not in found.rivals.values()
    assert found.row("best snapshot").metrics.efficiency == 1
    assert found.row("rect").metrics.efficiency == 1
    assert float(found.row("Hann").metrics.efficiency) == pytest.approx(0.15)
    assert burst.num_frames >= 2


SLOW = FirstOrderDevice(rise_time=4e-3, fall_time=7e-3, transmission=0.9, num_slots=24)
FEW = {"num_starts": 2, "max_steps": 30}


@pytest.mark.slow
@pytest.mark.parametrize("loss", [ExpectedErrorLoss(), DesignLoss()])
def test_a_design_through_a_lag_beats_one_that_is_sent_blindly(loss, tmp_path):
    """By the loss of its light, at the same motion, and it comes back from its file."""
    scene = _scene(device=SLOW)
    found = optimise(scene, MOTION, free="shutter", loss=loss, **FEW)
    ideal = optimise(_scene(device=SLOW.without_lag), MOTION, free="shutter", loss=loss, **FEW)
    blind = float(loss(scene, MOTION, ideal.command))
    assert found.loss < blind
    assert float(loss(scene, found.motion, found.command)) == pytest.approx(found.loss, rel=1e-5)
    level = float(evaluate(scene, MOTION, ideal.command).expected_psnr)
    assert found.psnr_ignoring_lag == pytest.approx(level, abs=1e-4)
    assert isinstance(found.command, SplineShutter)
    assert not found.command.symmetric
    if isinstance(loss, ExpectedErrorLoss):
        found.save(tmp_path / "design.json")
        read = Design.load(tmp_path / "design.json")
        assert str(read.metrics) == str(found.metrics)
        assert read.psnr_ignoring_lag == found.psnr_ignoring_lag
        assert read.scene.device.num_slots == 24


@pytest.mark.slow
def test_a_free_exposure_knows_how_much_a_device_can_follow():
    """The loss that the search reports is that of the light at the exposure that it found."""
    scene = _scene(device=SLOW, sensor=Sensor(full_well=900.0))
    found = optimise(scene, MOTION, HannShutter(), free=("half_exposure", "acceleration"))
    light = scene.light(HannShutter(), found.motion)
    level = float(ExpectedErrorLoss()(scene, found.motion, light))
    assert level == pytest.approx(found.loss, rel=1e-5)
    electrons = 1e5 * float(found.motion.exposure) * float(light.efficiency())
    assert electrons <= 900.0 * (1 + 1e-5)


DISCRETE = {
    "switched": SwitchedDevice(num_slots=40, min_open=2, min_closed=3),
    "levels": IdealDevice(levels=4, num_slots=24, transmission=0.9),
    "lagging levels": FirstOrderDevice(rise_time=1e-3, fall_time=1e-3, num_slots=24, levels=3),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", DISCRETE)
def test_levels_are_part_of_the_search(name, tmp_path):
    """Only those of the device, better than rounding blindly, and no change of one slot helps."""
    device = DISCRETE[name]
    scene = _scene(device=device)
    found = optimise(scene, MOTION, free="shutter", **FEW)
    slots = np.asarray(found.command.transmittances)
    steps = device.levels - 1
    whole = np.rint(slots * steps).astype(int)
    np.testing.assert_allclose(slots * steps, whole, atol=1e-5)
    assert runs_are_long_enough(whole[None], device.min_open, device.min_closed).all()
    ideal = optimise(_scene(device=device.without_lag), MOTION, free="shutter", **FEW)
    means = slot_means(ideal.command, device.num_slots, np.dtype(float))
    rounded = diffused(means, device.levels, device.min_open, device.min_closed)
    loss = ExpectedErrorLoss()
    blind = float(loss(scene, MOTION, ChippedShutter(rounded)))
    assert found.loss < blind
    assert float(loss(scene, MOTION, found.command)) == pytest.approx(found.loss, rel=1e-5)
    for place in (3, 11, 17):
        changed = whole.copy()
        changed[place] += 1 if changed[place] < steps else -1
        if runs_are_long_enough(changed[None], device.min_open, device.min_closed).all():
            near = ChippedShutter(changed / steps)
            assert float(loss(scene, MOTION, near)) >= found.loss * (1 - 1e-6)
    found.save(tmp_path / "design.json")
    device_read = Design.load(tmp_path / "design.json").scene.device
    assert str(vars(device_read)) == str(vars(device))


def test_a_sweep_searches_no_levels():
    """Nor through a device whose light is not linear in what is sent."""
    axes = {"accelerations": [0.0], "half_exposures": [1e-3]}
    for device in (SwitchedDevice(), FirstOrderDevice(rise_time=1e-3, fall_time=2e-3)):
        with pytest.raises(ValueError, match="be False where a device has levels, or falls"):
            sweep(_scene(device=device), optimise=True, **axes)


@pytest.mark.slow
def test_a_comparison_is_of_light_and_names_the_blind_drive():
    """Windows go through the device, the open shutter does not, and the notes say what it does."""
    scene = _scene(device=SLOW, limits=LIMITS)
    found = optimise(scene, MOTION, num_starts=4)
    table = compare(scene, found)
    losses, times, slots, blind = table.notes
    assert losses.startswith("The shutter passes 90.0% of the light when open")
    assert times.startswith("It rises from 10 to 90 % in 4 ms and falls in 7 ms")
    assert slots == "It holds any level over each of 24 slots."
    assert f"{found.psnr_ignoring_lag:.2f} dB" in blind
    assert max(map(len, table.notes)) <= 80
    assert table.row("rect").metrics.efficiency == 1
    hann = table.row("Hann")
    light = scene.light(HannShutter(), hann.motion)
    assert float(hann.metrics.efficiency) == pytest.approx(float(light.efficiency()), abs=1e-6)
    assert float(table.row("optimised").metrics.expected_psnr) >= found.psnr_ignoring_lag
