"""The table of shutter kinds serves files and names, and takes a shutter of one's own."""

from typing import final

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from support.cases import SHUTTERS

import mishutter
from mishutter import (
    AbstractShutter,
    Design,
    ParabolicMotion,
    Scene,
    SplineShutter,
    baselines,
    register_shutter,
)
from mishutter.design.design import given_design

# The registry itself, which each test leaves as it was.
from mishutter.model.shutters import kinds
from mishutter.model.shutters.kinds import named_shutter, shutter_from_dict, shutter_to_dict

TAU = np.linspace(-1, 1, 41)


@pytest.fixture
def table():
    """The table, put back afterwards."""
    before = list(kinds.KINDS)
    yield kinds.KINDS
    kinds.KINDS[:] = before


def test_every_final_shutter_has_a_line():
    """A class that a user can import is one that a file can hold."""
    public = (getattr(mishutter, name) for name in dir(mishutter))
    classes = {v for v in public if isinstance(v, type) and issubclass(v, AbstractShutter)}
    final_classes = {c for c in classes if not c.__name__.startswith("Abstract")}
    assert {kind.shutter for kind in kinds.KINDS} == final_classes


@pytest.mark.parametrize("slug", SHUTTERS)
def test_a_shutter_is_read_back_as_it_was(slug):
    """Kind and parameters, to the bit."""
    shutter = SHUTTERS[slug].shutter()
    read = shutter_from_dict(shutter_to_dict(shutter))
    assert type(read) is type(shutter)
    assert np.array_equal(read.transmittance(TAU), shutter.transmittance(TAU))


@pytest.mark.parametrize("kind", [k for k in kinds.KINDS if k.make], ids=lambda k: k.name)
def test_a_name_stands_for_a_shutter(kind):
    """Whatever its case; with a number where the kind has a parameter."""
    assert type(named_shutter(kind.name.upper())) is kind.shutter
    if kind.parameter:
        changed = named_shutter(f"{kind.name}:0.37")
        assert float(getattr(changed, kind.parameter)) == pytest.approx(0.37)
    else:
        with pytest.raises(ValueError, match=f"give {kind.name.lower()} no parameter"):
            named_shutter(f"{kind.name}:0.37")


def test_baselines_are_lines_of_the_table():
    """In its order, by its names."""
    assert list(baselines()) == ["rect", "Hann", "triangle", "Gaussian"]


@final
class Ramp(AbstractShutter):
    """Opens slowly, closes at once."""

    rise: jax.Array

    def transmittance(self, tau):
        tau = jnp.asarray(tau)
        opening = 1 - jnp.exp(-(1 + tau) / self.rise.astype(tau.dtype))
        return jnp.where(jnp.abs(tau) <= 1, opening, jnp.zeros_like(tau))


@pytest.mark.slow
def test_a_registered_shutter_is_saved_and_loaded(table, tmp_path):
    """A design with it is one file; without the call the file is refused by name."""
    motion = ParabolicMotion(acceleration=3e5, half_exposure=0.01)
    scene = Scene([0.0, 300.0], photon_rate=1e5, read_noise=3.0, motion=motion)
    design = given_design(scene, motion, Ramp(jnp.asarray(0.31)), "Given.")
    path = tmp_path / "design.json"
    with pytest.raises(ValueError, match=r"own or a registered one; got 'Ramp'"):
        design.save(path)
    assert register_shutter(Ramp) is Ramp
    design.save(path)
    read = Design.load(path).shutter
    assert isinstance(read, Ramp)
    assert float(read.rise) == 0.31
    table[:] = [kind for kind in table if kind.shutter is not Ramp]
    with pytest.raises(ValueError, match=r"`shutter.kind` must be one of .*; got 'Ramp'"):
        Design.load(path)


def test_a_class_that_is_defined_again_takes_its_place(table):
    """As that of a notebook's cell that runs twice."""
    count = len(table)
    first, second = (type("Own", (AbstractShutter,), dict(Ramp.__dict__)) for _ in range(2))
    for shutter in (first, first, second):
        assert register_shutter(shutter) is shutter
    assert len(table) == count + 1
    assert table[-1].shutter is second


def test_what_cannot_be_registered_is_refused(table):
    """A second class of one name."""
    stranger = type("SplineShutter", (AbstractShutter,), {"transmittance": Ramp.transmittance})
    with pytest.raises(ValueError, match="must have a name of its own; got 'SplineShutter'"):
        register_shutter(stranger)
    assert SplineShutter in {kind.shutter for kind in table}
