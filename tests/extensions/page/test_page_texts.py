"""Pages of atlases with the texts of strangers: clean texts, or one line that refuses."""

import json

import pytest
from test_texts import HOSTILE, changed

import atlas
from atlas import BadInput, load_scene
from atlas.extensions.page import content, page

pytestmark = pytest.mark.usefixtures("whole_kernels")


@pytest.fixture(scope="module")
def ds(small_scene):
    return atlas.run(load_scene(small_scene), progress=False)


def test_pages_hold_clean_texts(ds, monkeypatch):
    monkeypatch.setattr(content, "MAX_SLICES", 0)  # no lines of theory
    monkeypatch.setattr(page, "_fallback", lambda shown: "data:,")
    monkeypatch.setattr(page, "_file_text", lambda table, *_: table)
    hostile = changed(ds, [HOSTILE]).assign({HOSTILE[:40]: ds.theta_dot_rms})
    text = json.dumps(hostile.atlas.page().html, ensure_ascii=False)
    assert not {"\u202e", "\udcff"} & set(text)
    assert not any(f"\\u{i:04x}" in text for i in range(32))
    assert "\\\\x1b[2J\\\\ndone\\\\u202e\\\\udcff<b>" in text


def test_attributes_and_variables_of_a_wrong_type_are_refused(ds):
    damaged = ds.assign_attrs(atlas_scene="", atlas_method="\x1b")
    with pytest.raises(BadInput, match=r"attribute atlas_method = '\\\\x1b'"):
        damaged.atlas.page()
    with pytest.raises(BadInput, match="label: values of type <U"):
        ds.assign(label=ds.label.astype(str)).atlas.page()
