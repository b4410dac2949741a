"""Tables of files are the arguments of classes: what is written builds an equal object."""

import equinox as eqx
import pytest

from mishutter._core.validation import validated
from mishutter.model.arguments import arguments_of
from mishutter.model.devices import AbstractDevice, FirstOrderDevice, IdealDevice, SwitchedDevice
from mishutter.model.limits import Limits
from mishutter.model.occlusion import Occlusion
from mishutter.model.scene import Scene
from mishutter.model.sensor import BurstMode
from mishutter.model.servos import SecondOrderStage
from mishutter.model.tolerances import Tolerances

PARTS = {
    "limits": Limits(
        max_stroke=37.3, max_pan=250.5, max_travel=91.7, max_jerk=4.1e9, pans="camera"
    ),
    "ideal": IdealDevice(transmission=0.43, levels=5),
    "gradual": FirstOrderDevice(rise_time=7e-4, fall_time=1.3e-3, delay=2e-4, num_slots=24),
    "switched": SwitchedDevice(num_slots=24, min_open=2, min_closed=3),
    "burst": BurstMode(frames_per_s=430.0, max_frames=7, window=0.013, dead_time=2e-4),
    "stage": SecondOrderStage(bandwidth=130.0, damping=0.6),
    "tolerances": Tolerances(acceleration=0.03, transmittance=0.02, drive_step=3e-4),
    "occlusion": Occlusion(front_share=0.37, object_width=41.0, background="moving"),
}


@pytest.mark.parametrize("part", PARTS.values(), ids=PARTS)
def test_a_table_of_arguments_builds_an_equal_object(part):
    """Every number, and the kind, comes back to the last bit."""
    schema = arguments_of(type(part))
    table = schema.model_validate(part, from_attributes=True).model_dump()
    assert eqx.tree_equal(schema.model_validate(table).built(), part)


@pytest.mark.parametrize("name", ["ideal", "gradual", "switched"])
def test_the_arguments_of_a_device_tell_its_class(name):
    """A scene's table says no kind of device: its keys do."""
    scene = Scene([-310.0, 420.0], photon_rate=2e5, read_noise=3.0, device=PARTS[name])
    schema = arguments_of(Scene, "motion")
    table = schema.model_validate(scene, from_attributes=True).model_dump()
    device = validated(schema, table, "a file").built().device
    assert isinstance(device, AbstractDevice)
    assert eqx.tree_equal(device, PARTS[name])


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"max_strok": 3.0}, "a file: the file must hold known keys only, perhaps `max_stroke`"),
        ({"max_stroke": "x"}, "a file: `max_stroke` must be a number; got 'x'"),
    ],
)
def test_a_table_of_other_keys_is_refused(table, message):
    """One line names the key and the nearest known one."""
    with pytest.raises(ValueError, match=message):
        validated(arguments_of(Limits), table, "a file")


def test_the_class_refuses_what_its_type_allows():
    """A number out of range is told in the words of the class."""
    table = validated(arguments_of(Limits), {"max_stroke": -3.0}, "a file")
    with pytest.raises(ValueError, match=r"Limits\(max_stroke=...\)` must be above 0; got -3"):
        table.built()
