"""Every key of a TOML text is found on the line where a reader sees it."""

import tomllib

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from millcal.io.toml_places import locate

TEXT = '''# a comment with [a] = "header"
title = "a # no comment"   # but this is
nested.dotted."quoted key" = 1

[cutter]
diameter_mm = 25.0
pitch_deg = [
  170,  # first
  190,
]

[[cuts]]
recording = 'C:\\data\\x.csv'
[[cuts]]
steady_s = [0.1, 0.9]
note = """
[fake]
key = "inside"
"""
[cuts.map]
fx = "+Fy"

[[structure.modes]]
axis = "x"
[[structure.modes]]
axis = "y"
[impact]
channels = { hammer = { unit = "N" }, "acc x" = { unit = "g" } }
[expect]
"coefficients.Ktc" = [1, 2]
'''

PLACES = {
    ("title",): 2,
    ("nested", "dotted", "quoted key"): 3,
    ("cutter",): 5,
    ("cutter", "diameter_mm"): 6,
    ("cutter", "pitch_deg"): 7,
    ("cutter", "pitch_deg", 0): 8,
    ("cutter", "pitch_deg", 1): 9,
    ("cuts",): 12,
    ("cuts", 0): 12,
    ("cuts", 0, "recording"): 13,
    ("cuts", 1): 14,
    ("cuts", 1, "steady_s", 1): 15,
    ("cuts", 1, "note"): 16,
    ("cuts", 1, "map"): 20,
    ("cuts", 1, "map", "fx"): 21,
    ("structure", "modes", 1, "axis"): 26,
    ("impact", "channels", "acc x", "unit"): 28,
    ("expect", "coefficients.Ktc"): 30,
}


@pytest.mark.parametrize("path", PLACES, ids=str)
def test_a_key_is_found_on_its_line(path):
    assert locate(TEXT)[path] == PLACES[path]


def test_nothing_inside_strings_and_comments_is_taken_for_a_key():
    assert not {("fake",), ("key",), ("a",)} & set(locate(TEXT))
    assert ("cuts", 1, "key") not in locate(TEXT)


def test_line_ends_of_another_system_do_not_move_a_line():
    assert locate(TEXT.replace("\n", "\r\n")) == locate(TEXT)


def paths_of(data, path=()):
    """All paths of parsed data."""
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in items:
        yield (*path, key)
        yield from paths_of(value, (*path, key))


keys = st.text(alphabet="ab_.-# é'\"]", min_size=1, max_size=4)
scalars = (
    st.integers(-9, 9) | st.booleans() | st.text(alphabet="ab#[]{},='\"\\\n", max_size=6).map(lambda s: s) | st.floats()
)
values = st.recursive(
    scalars, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(keys, inner, max_size=3), max_leaves=8
)


def as_toml(value):
    """One line of TOML for a value."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        escaped = value.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
        return f'"{escaped}"'
    if isinstance(value, list):
        return "[" + ", ".join(as_toml(item) for item in value) + "]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{as_toml(k)} = {as_toml(v)}" for k, v in value.items()) + "}"
    return repr(value)


@settings(deadline=None, max_examples=150)
@given(st.dictionaries(keys, values, max_size=4), st.dictionaries(keys, values, max_size=4))
def test_every_path_of_the_parsed_data_has_a_line(top, table):
    text = "".join(f"{as_toml(k)} = {as_toml(v)} # x\n" for k, v in top.items())
    if "t" not in top:
        text += "[t]\n" + "".join(f"{as_toml(k)} = {as_toml(v)}\n" for k, v in table.items())
    data = tomllib.loads(text)
    assert set(paths_of(data)) <= set(locate(text))
