"""Fields of the page come from the schema of the scene file, and give scene files back."""

import tomllib

import pytest
from support.command_line import SMALL_SCENE

from mishutter._core.validation import in_section, validated

# The face starts a server; the fields are checked without one.
from mishutter.explore.fields import _begin, label_and_unit, page_fields, scene_text
from mishutter.model.scene_file import example_scene_text
from mishutter.model.scene_schema import SceneFile

SECTIONS = {section["key"]: section for section in page_fields()}


def places(table, *before):
    """Every key of a table, and of the tables in it."""
    for field in table["fields"]:
        yield (*before, field["key"]), field
        if field["kind"] == "table":
            yield from places(field, *before, field["key"])


FIELDS = {
    place: field for name, section in SECTIONS.items() for place, field in places(section, name)
}


def schema_places(model, *before):
    for name, field in model.model_fields.items():
        yield (*before, name)
        options = [field.annotation, *getattr(field.annotation, "__args__", ())]
        for option in options:
            if hasattr(option, "model_fields"):
                yield from schema_places(option, *before, name)


def test_every_key_of_the_schema_is_a_field():
    """A key that is added to the schema appears by itself, at its place."""
    assert {(name,) for name in SECTIONS} | set(FIELDS) == set(schema_places(SceneFile))


UNITS = {
    "photon_rate_per_s": ("photon rate", "1/s"),
    "max_top_speed_px_per_s": ("max top speed", "px/s"),
    "acceleration_px_per_s2": ("acceleration", "px/s²"),
    "cutoff_cycles_per_px": ("cutoff", "cycles/px"),
    "read_noise_e": ("read noise", "e⁻"),
    "rise_ms": ("rise", "ms"),
    "count": ("count", ""),
    "e": ("e", ""),
}


def test_a_key_ends_in_its_unit():
    """The unit is read off the key's name, and is no part of the label."""
    assert {key: label_and_unit(key) for key in UNITS} == UNITS


def begins_within(field) -> bool:
    """Whether the value that a box begins with is one that the schema takes."""
    if field["kind"] not in ("number", "integer"):
        return True
    low, high, begin = field["minimum"], field["maximum"], field["begin"]
    is_above = low < begin if field["above"] else low <= begin
    is_below = begin < high if field["below"] else begin <= high
    return is_above and is_below and (field["kind"] == "number" or isinstance(begin, int))


def test_a_key_that_is_put_in_begins_with_a_value_that_the_schema_takes():
    """No tick of a box leads to a value that is out of the range shown beside it."""
    assert len(FIELDS) > 100
    assert not [".".join(place) for place, field in FIELDS.items() if not begins_within(field)]


def test_a_key_has_the_bounds_of_the_schema():
    """Numbers by themselves and of lists; a bound that itself is out of range says so."""
    bounds = {
        place: [FIELDS[place][each] for each in ("minimum", "maximum", "above", "below", "kind")]
        for place in (
            ("speeds", "uniform", "min_px_per_s"),
            ("speeds", "normal", "deviation_px_per_s"),
            ("speeds", "normal", "count"),
            ("speeds", "any_direction", "weights"),
        )
    }
    assert [*bounds.values()] == [
        [-1e7, 1e7, False, False, "number"],
        [0, 1e7, True, False, "number"],
        [1, 1000, False, False, "integer"],
        [0, 1e9, False, False, "list"],
    ]
    optional = [place for place, field in FIELDS.items() if field.get("optional")]
    assert ("speeds", "normal", "count") not in optional
    assert ("speeds", "normal", "deviation_px_per_s") in optional


def test_a_value_to_begin_with_is_in_range():
    """The middle of a range up to 1, else 1 or the least; of whole numbers 2 or the least."""
    place = ("no", "such", "key")
    for kind, bounds, begin in (
        ("number", {"minimum": 0.2, "maximum": 0.8}, 0.5),
        ("number", {"exclusiveMinimum": 0.4, "exclusiveMaximum": 1}, 0.7),
        ("number", {"minimum": 0, "maximum": 90}, 1.0),
        ("number", {"minimum": 7, "maximum": 90}, 7),
        ("integer", {"minimum": 1, "maximum": 90}, 2),
        ("integer", {"minimum": 5, "maximum": 90}, 5),
        ("choice", {"enum": ["b", "a"]}, "b"),
        ("boolean", {}, True),
        ("list", {}, []),
        ("text", {}, ""),
    ):
        assert _begin(place, kind, None, bounds) == begin
        assert _begin(place, kind, "own", bounds) == "own"


def test_a_section_that_is_put_in_is_a_section_of_a_scene_file():
    """Ticking a section gives one that a scene may have."""
    ticked = {name: each["begin"] for name, each in SECTIONS.items() if each["optional"]}
    assert len(ticked) > 3
    for name, begin in ticked.items():
        tables = tomllib.loads(example_scene_text()) | {name: begin}
        validated(SceneFile, tables, f"a scene with [{name}]", in_section)


def test_objects_before_a_background_are_put_in_by_a_tick():
    """The section is off at first, and begins with edges before a still background."""
    assert SECTIONS["occlusion"]["optional"]
    begin = {"front_share": 0.5, "object_width_px": 100, "background": "still"}
    assert SECTIONS["occlusion"]["begin"] == begin
    assert FIELDS["occlusion", "background"]["choices"] == ["still", "moving"]
    assert "occlusion" not in tomllib.loads(example_scene_text())


def test_what_the_example_leaves_out_begins_with_what_it_says_in_comments():
    """Values of devices stand in the example alone."""
    assert FIELDS["sensor", "full_well_e"]["begin"] == 5900
    assert SECTIONS["shutter"]["begin"] == {"transmission": 0.85, "leakage": 0.001}
    assert FIELDS["speeds", "normal"]["begin"]["deviation_px_per_s"] == 2000


@pytest.mark.parametrize("text", [SMALL_SCENE, example_scene_text()], ids=["small", "example"])
def test_a_scene_file_is_written_as_it_was_read(text):
    """Saving a scene changes none of its numbers."""
    tables = tomllib.loads(text)
    assert tomllib.loads(scene_text(tables)) == tables


def test_names_in_any_letters_are_written():
    """The path of a photograph may hold quotes, backslashes, controls and letters of any kind."""
    tables = {"picture": {"path": 'a "b" \\ \n \x7f é 😀.png'}, "light": {"x": 1e22, "y": -3e-7}}
    assert tomllib.loads(scene_text(tables)) == tables
