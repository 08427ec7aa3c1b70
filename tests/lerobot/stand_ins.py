"""Stand for the large packages that modules of LeRobot import, and that a plug-in's interface does not use."""

import sys
from contextlib import contextmanager
from importlib import metadata
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType

PACKAGES = {
    "accelerate", "av", "datasets", "deepdiff", "einops", "gymnasium", "huggingface_hub", "pandas", "pyarrow",
    "safetensors", "torch", "torchvision", "tqdm",
}  # fmt: skip


class Attributes(type):
    def __getattr__(cls, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return cls


class StandIn(metaclass=Attributes):
    """A class to inherit from, and a decorator."""

    def __init__(self, *_, **__):
        pass

    def __call__(self, function):
        return function


class Module(ModuleType):
    HF_HOME = "/nonexistent"  # huggingface_hub's, a path

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return type(name, (StandIn,), {})


class Finder(MetaPathFinder, Loader):
    def find_spec(self, name, *_):
        return ModuleSpec(name, self, is_package=True) if name.partition(".")[0] in PACKAGES else None

    def create_module(self, spec):
        return Module(spec.name)

    def exec_module(self, module):
        pass


@contextmanager
def stand_ins():
    """What is imported meanwhile gets stand-ins for these packages, and nothing else ever does."""
    finder = Finder()
    before = {name: each for name, each in sys.modules.items() if name.partition(".")[0] in PACKAGES}
    for name in before:
        del sys.modules[name]
    sys.meta_path.insert(0, finder)
    version = metadata.version  # LeRobot 0.6 asks for it
    metadata.version = lambda name: "0" if name in PACKAGES else version(name)
    try:
        yield
    finally:
        metadata.version = version
        sys.meta_path.remove(finder)
        for name in [each for each in sys.modules if each.partition(".")[0] in PACKAGES]:
            del sys.modules[name]
        sys.modules.update(before)
