import types

import pytest

from clothrf_core.errors import BrokenPlugin, MissingDependency, UnknownPlugin
from clothrf_core.hookspecs import hookimpl
from clothrf_core.provider import Provider
from clothrf_core.registry import Registry


def nothing():
    return []


def plugin(name="p", build=lambda config, context: "built", **more):
    def clothrf_policies():
        return [Provider(name, "a policy", build, **more)]

    module = types.ModuleType(f"plugin_{name}")
    module.clothrf_policies = hookimpl(clothrf_policies)
    return module


def test_what_a_plugin_offers_is_found_and_built():
    registry = Registry.of(plugin("mine"))
    assert registry.names("policy") == ["mine"]
    assert registry.build("policy", "mine") == "built"


def test_an_unknown_name_gets_the_nearest():
    with pytest.raises(UnknownPlugin) as error:
        Registry.of(plugin("forest")).find("policy", "forrest")
    assert str(error.value) == (
        "no policy called 'forrest' is installed. Did you mean 'forest'? Known: forest"
    )


def test_a_misspelt_hook_is_a_listed_failure():
    module = types.ModuleType("bad")
    module.clothrf_polices = hookimpl(nothing)
    registry = Registry.of(module, plugin("good"))
    assert registry.names("policy") == ["good"]
    assert "unknown hook 'clothrf_polices'" in registry.failures[0].reason


def test_a_plugin_that_raises_is_a_listed_failure_and_the_rest_works():
    def clothrf_policies():
        raise RuntimeError("boom")

    module = types.ModuleType("bad")
    module.clothrf_policies = hookimpl(clothrf_policies)
    registry = Registry.of(module, plugin("good"))
    assert registry.build("policy", "good") == "built"
    assert registry.failures[0].reason == "RuntimeError: boom"


def test_a_failure_is_named_when_something_is_missing():
    module = types.ModuleType("bad")
    module.clothrf_polices = hookimpl(nothing)
    with pytest.raises(UnknownPlugin, match="failed to load: bad"):
        Registry.of(module).find("policy", "x")


def test_two_plugins_with_one_name_are_a_failure():
    first, second = plugin("same"), plugin("same")
    second.__name__ = "other"
    registry = Registry.of(first, second)
    assert "policy 'same' is offered by both" in registry.failures[0].reason


def test_a_missing_package_names_the_pip_command():
    def build(config, context):
        raise ImportError("No module named 'torch'", name="torch")

    with pytest.raises(MissingDependency) as error:
        Registry.of(plugin("cnn", build, extra="torch")).build("policy", "cnn")
    assert str(error.value) == (
        "policy 'cnn' needs 'torch', which cannot be imported (No module named 'torch'). "
        "Install it with: pip install 'clothrf[torch]'"
    )


def test_a_builder_that_fails_says_whose_fault_it_is():
    def build(config, context):
        raise KeyError("x")

    with pytest.raises(BrokenPlugin, match="policy 'p' failed to build: KeyError: 'x'"):
        Registry.of(plugin("p", build)).build("policy", "p")


def test_everything_shipped_loads():
    assert Registry.installed().failures == ()
