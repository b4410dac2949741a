"""The table of metrics is the one that everybody reads: its rows are the fields of `Metrics`."""

import numpy as np
import pytest

from mishutter import HannShutter, Metrics, Scene, TukeyShutter, best_points, sweep
from mishutter.evaluation import speed_knowledge
from mishutter.evaluation.metrics import METRICS, Metric
from mishutter.evaluation.needs import ONLY_SPECTRA
from mishutter.evaluation.speed_knowledge import SPEED_KNOWLEDGE, knowledge_of, metrics_of

SCENE = Scene([0.0, 410.0, -730.0], [0.3, 0.5, 0.2], photon_rate=2e5, read_noise=6.0)
OF_THE_COMPUTATION = {"phase", "dft_length", "num_taps"}
"""Fields of `Metrics` that say how a condition number was taken."""


def test_rows_are_the_fields_of_metrics():
    """Every metric that is evaluated has a row, and every row is evaluated, in one order."""
    fields = [name for name in Metrics.__dataclass_fields__ if name not in OF_THE_COMPUTATION]
    assert list(METRICS) == fields
    assert all(metric.name == name for name, metric in METRICS.items())


def test_a_formula_reads_kernels_or_transfer_functions():
    """Sweeps compute these in two programs; a level sees light, and is in decibels."""
    for metric in METRICS.values():
        assert not (metric.parts.kernels and metric.parts.spectra), metric.name
        assert metric.sees_light == (metric.unit == "dB"), metric.name
        assert metric.meaning
        assert metric.heading
        assert format(1.234, metric.form)


def test_every_decoder_is_judged_by_a_metric():
    """Its level, that at the worst speed and that within tolerances are rows, each its own."""
    for knowledge in SPEED_KNOWLEDGE.values():
        own = knowledge.levels(with_tolerances=True)
        assert set(own) <= set(METRICS)
        others = metrics_of([knowledge], with_tolerances=True)
        assert set(own) <= set(others)
        assert not [
            name
            for other in SPEED_KNOWLEDGE.values()
            if other is not knowledge
            for name in other.levels(with_tolerances=True)
            if name in others
        ]


def test_one_more_row_is_swept(monkeypatch):
    """A row alone makes a metric of a sweep: computed, labelled, and with its sense."""
    trial = Metric(
        "signal_kept",
        "share of the signal's light that is left of the noise",
        "kept",
        ".3f",
        ONLY_SPECTRA,
        lambda e: 3.0 * e.response.efficiency - e.errors.unknown,
        is_higher_better=False,
    )
    monkeypatch.setitem(METRICS, trial.name, trial)
    shutters = {"Hann": HannShutter(), "Tukey": TukeyShutter(0.3)}
    axes = {"accelerations": [7e4], "half_exposures": [3e-3, 5e-3], "shutters": shutters}
    found = sweep(SCENE, **axes, metrics=["efficiency", "expected_psnr", trial.name])
    error = 10 ** (-found.expected_psnr / 10)
    np.testing.assert_allclose(found.signal_kept, 3.0 * found.efficiency - error, rtol=1e-9)
    assert found.signal_kept.attrs["long_name"] == trial.meaning
    least = float(best_points(found)["signal_kept"].signal_kept)
    assert least == float(found.signal_kept.min())


@pytest.mark.parametrize("name", SPEED_KNOWLEDGE)
def test_a_loss_names_the_decoder_before_the_scene(name):
    """The decoder of an expected error is its own, that of any other loss the scene's."""
    knowledge = SPEED_KNOWLEDGE[name]
    scene = Scene(SCENE.speeds, photon_rate=2e5, read_noise=6.0, decoder_speed=name)
    assert knowledge_of(SCENE, knowledge.loss()) is knowledge
    assert knowledge_of(scene) is knowledge
    assert knowledge_of(scene, SPEED_KNOWLEDGE["unknown"].loss()).name == "unknown"


@pytest.mark.parametrize("knowledge", SPEED_KNOWLEDGE.values(), ids=lambda each: each.name)
def test_the_losses_of_a_knowledge_of_the_speed_stand_beside_its_row(knowledge):
    """A decoder's formula, loss, filter and words are one place to add or to read."""
    losses = [loss for loss in (knowledge.loss, knowledge.worst_loss) if loss is not None]
    assert {loss.__module__ for loss in losses} == {speed_knowledge.__name__}
    assert {loss.decoder_speed for loss in losses} == {knowledge.name}
