import tomllib

import pytest

from clothrf_core import config
from clothrf_core.errors import ConfigError
from clothrf_core.locations import shipped
from clothrf_core.registry import Registry


def problems(path, registry, text):
    path.write_text(path.read_text() + text)
    with pytest.raises(ConfigError) as error:
        config.load(path, registry)
    return str(error.value).splitlines()


def test_a_sound_file_resolves(toy, toy_experiment):
    resolved = config.load(toy_experiment, toy)
    assert resolved.components["policy"].plugin == "toy_mean"
    assert resolved.task_names == ("ahead",)


def test_a_resolved_file_resolves_to_itself(toy, toy_experiment, tmp_path):
    text = config.load(toy_experiment, toy).text
    again = tmp_path / "again.toml"
    again.write_text(text)
    assert config.load(again, toy).text == text


def test_the_resolved_text_holds_every_default(toy, toy_experiment):
    tree = tomllib.loads(config.load(toy_experiment, toy).text)
    assert tree["training"]["beta"] == 0.8
    assert tree["policy"] == {"plugin": "toy_mean", "shrink": 0.0}


def test_an_unknown_plugin_is_named_with_the_nearest(toy, toy_experiment):
    toy_experiment.write_text(toy_experiment.read_text().replace("toy_sheet", "toy_sheeet"))
    lines = problems(toy_experiment, toy, "")
    assert lines == [
        f"{toy_experiment}: 1 problem",
        "  simulator.plugin: no simulator called 'toy_sheeet' is installed. "
        "Did you mean 'toy_sheet'? Known: toy_sheet",
    ]


def test_an_unknown_key_of_a_plugin_is_named_with_the_nearest(toy, toy_experiment):
    text = toy_experiment.read_text()
    toy_experiment.write_text(text.replace('"toy_mean"', '"toy_mean"\nshrinc = 0.5'))
    assert problems(toy_experiment, toy, "")[1] == (
        "  policy.shrinc: unknown key. Did you mean 'shrink'? Known: shrink"
    )


def test_an_unknown_section_is_named_with_the_nearest(toy, toy_experiment):
    assert problems(toy_experiment, toy, "\n[trainning]\nx = 1\n")[1].startswith(
        "  trainning: unknown key. Did you mean 'training'? Known: "
    )


def test_a_bad_value_is_shown(toy, toy_experiment):
    text = toy_experiment.read_text().replace("iterations = 3", "iterations = 0")
    toy_experiment.write_text(text)
    assert problems(toy_experiment, toy, "")[1] == (
        "  training.iterations: Input should be greater than or equal to 1 (got 0)"
    )


def test_all_problems_are_reported_at_once(toy, toy_experiment):
    text = toy_experiment.read_text()
    text = text.replace("iterations = 3", "iterations = 0").replace("toy_splat", "splat")
    toy_experiment.write_text(text)
    lines = problems(toy_experiment, toy, "\n[zzz]\n")
    assert lines[0] == f"{toy_experiment}: 3 problems"
    assert [line.split(":")[0].strip() for line in lines[1:]] == [
        "training.iterations",
        "zzz",
        "camera.plugin",
    ]


def test_a_task_without_an_expert_asks_for_one(toy, toy_experiment):
    text = toy_experiment.read_text().replace(
        '[tasks.ahead]\nplugin = "toy_offset"', "[tasks.ahead]"
    )
    toy_experiment.write_text(text)
    assert problems(toy_experiment, toy, "")[1] == (
        '  tasks.ahead.plugin: missing; write plugin = "...". Installed: toy_offset'
    )


def test_options_alone_go_to_the_usual_plugin(tmp_path):
    path = tmp_path / "x.toml"
    path.write_text('[rig]\nfile = "rigs/yumi_sr300.toml"\n[policy]\ntrees = 7\n')
    (tmp_path / "rigs").mkdir()
    (tmp_path / "rigs" / "yumi_sr300.toml").write_text(shipped("rigs/yumi_sr300.toml").read_text())
    resolved = config.load(path, Registry.installed())
    assert resolved.components["policy"].plugin == "forest"
    assert resolved.components["policy"].options.trees == 7


def test_broken_toml_says_where(toy, tmp_path):
    path = tmp_path / "x.toml"
    path.write_text("[run]\nseed = = 3\n")
    with pytest.raises(ConfigError, match=r"x\.toml: expected TOML, .*line 2"):
        config.load(path, toy)


def test_a_missing_file_is_said(toy, tmp_path):
    with pytest.raises(ConfigError, match="nothing.toml: no such file"):
        config.load(tmp_path / "nothing.toml", toy)


def test_a_rig_file_is_found_beside_the_experiment(toy, toy_experiment, tmp_path):
    tree = tomllib.loads(toy_experiment.read_text())
    (tmp_path / "rig.toml").write_text(config.tomli_w.dumps(tree.pop("rig")))
    toy_experiment.write_text(config.tomli_w.dumps({"rig": {"file": "rig.toml"}, **tree}))
    assert config.load(toy_experiment, toy).rig.name == "small"


def test_a_problem_in_a_rig_file_names_the_file(toy, toy_experiment, tmp_path):
    (tmp_path / "rig.toml").write_text("name = 'x'\n")
    tree = tomllib.loads(toy_experiment.read_text())
    tree["rig"] = {"file": "rig.toml"}
    toy_experiment.write_text(config.tomli_w.dumps(tree))
    assert f"rig ({tmp_path / 'rig.toml'}).camera: Field required" in "\n".join(
        problems(toy_experiment, toy, "")
    )


def test_a_key_can_be_overridden(toy, toy_experiment):
    resolved = config.load(toy_experiment, toy, {"training.iterations": 7})
    assert resolved.experiment.training.iterations == 7


def test_a_rig_can_name_a_camera_file(toy, toy_experiment, tmp_path):
    tree = tomllib.loads(toy_experiment.read_text())
    camera = {**tree["rig"]["camera"], "width": 160}
    (tmp_path / "c.camera.toml").write_text(config.tomli_w.dumps({"camera": camera}))
    tree["rig"]["camera"] = {"file": "c.camera.toml"}
    toy_experiment.write_text(config.tomli_w.dumps(tree))
    assert config.load(toy_experiment, toy).rig.camera.width == 160
