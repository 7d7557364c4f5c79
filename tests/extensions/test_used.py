"""Extensions that a scene uses: its text lists them, its runs depend on their code, and no two give the same name."""

import pytest
from test_extensions import OWN, TOP

import atlas
from atlas import BadInput, sources
from atlas.extension import Extension, extensions
from atlas.label.plan import Plan
from atlas.runs import plan
from atlas.runs.plan import ScenePlan
from atlas.runs.run import RunFolder


def test_a_scene_lists_the_extensions_that_it_needs(scene_text):
    plain = atlas.load_scene(scene_text({}))
    assert plain.extensions == []
    assert "extensions" not in plain.toml()
    listed = scene_text({"outputs.variables": ["label", "plane_trace", "frequency_1"]})
    on_family = scene_text({"family": {"name": "plane_rotation", "solve": ["theta0"]}, "axes.theta0": None,
                            "ties": None, "axes.sigma": None, "axes.B": {"values": [1.1, 1.3]}, "fixed": {"m": 2.0}})  # fmt: skip
    for text in (listed, on_family):
        scene = atlas.load_scene(text)
        assert scene.extensions == ["plane"]
        assert 'extensions = [\n    "plane",\n]' in scene.toml()
        assert atlas.load_scene(scene.toml()).toml() == scene.toml()
    top = atlas.load_scene(TOP + '[outputs]\nvariables = ["label", "periodic_trace", "first_order_error"]\n')
    assert top.extensions == ["amer2013"]
    for value, message in ((3, "must be a string or a list"), (["plain"], "'plain' is not installed")):
        with pytest.raises(BadInput, match=f"^extensions.*{message}"):
            atlas.load_scene(scene_text({"extensions": value}))


def test_a_name_of_two_extensions_is_refused_by_both_names(installed_extensions, scene_text):
    second = Extension("second", "second", "a name again", variables={"plane_trace": "theory:variables"})
    installed_extensions({**extensions(), "second": second})
    message = "^plane_trace is among the variables of two extensions, plane and second: remove one$"
    with pytest.raises(BadInput, match=message):
        atlas.load_scene(scene_text({}))


def test_a_run_depends_on_the_code_of_the_extensions_that_it_uses(scene_text, tmp_path, monkeypatch):
    """Families may have any start, so that each run of a system with families of an extension depends on it and on what it needs."""
    scenes = {
        "satellite": atlas.load_scene(scene_text({})),
        "fixed_point": atlas.load_scene(TOP),
        "with a variable": atlas.load_scene(TOP + '[outputs]\nvariables = ["label", "first_order_error"]\n'),
    }
    used = {"satellite": {"plane"}, "fixed_point": set(), "with a variable": {"amer2013"}}
    before = {name: plan.identity(Plan.of(scene)) for name, scene in scenes.items()}
    for name, identity in before.items():
        assert {key for key in identity if key.startswith("extension_")} == {
            f"extension_{e}" for e in used[name]
        }
    folder = RunFolder.prepare(ScenePlan.of(scenes["satellite"]), tmp_path / "run")
    for edited in OWN:
        path = extensions()[edited].folder
        other = {**sources.of_folder(path), "more.py": (0, "another file")}
        with monkeypatch.context() as patched:
            patched.setitem(sources.OF_FOLDERS, path, other)
            patched.setattr(sources, "read", lambda folder=None, path=path, read=sources.read, other=other: (
                other if folder == path else read(folder)
            ))  # fmt: skip
            for name, scene in scenes.items():
                identity = plan.identity(Plan.of(scene))
                changes = {key for key in identity if identity[key] != before[name][key]}
                assert changes == {
                    f"extension_{e}" for e in used[name] if edited in (e, *extensions()[e].needs)
                }
            if edited == "plane":
                with pytest.raises(
                    BadInput, match=r"It differs in extension_plane \([0-9a-f]{16} in the folder, "
                ):
                    folder.check_same(ScenePlan.of(scenes["satellite"]))
            else:
                folder.check_same(ScenePlan.of(scenes["satellite"]))
