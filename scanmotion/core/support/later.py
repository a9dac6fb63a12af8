"""Modules that libraries import for functions nobody here calls: loaded when one of them is first used.

Open3D imports dash, and with it IPython and requests, for one way of drawing; toppra imports matplotlib's
pyplot to draw its results. Together they are a second of processor time before anything is planned. What the
user calls of them works as ever.
"""

import importlib
import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager
from types import ModuleType
from typing import Any


def defer_functions(name: str, functions: tuple[str, ...]) -> None:
    """Puts a module in the place of `name` whose functions load the true one when they are called.

    The true functions then stand in the package above too, where it has taken them over by name. Nothing is
    done where the module or its package has been imported already.

    Args:
        name: dotted name of a module inside of a package.
        functions: what its package imports from it.
    """
    package = name.rpartition(".")[0]
    if name in sys.modules or package in sys.modules:
        return
    stand_in = ModuleType(name)

    def true_module() -> ModuleType:
        if sys.modules.get(name) is stand_in:
            del sys.modules[name]
        module = importlib.import_module(name)
        for function in functions:
            setattr(sys.modules[package], function, getattr(module, function))
        return module

    def caller(function: str) -> Callable[..., Any]:
        def call(*args: Any, **extra: Any) -> Any:
            return getattr(true_module(), function)(*args, **extra)

        call.__name__ = call.__qualname__ = function
        call.__module__ = name
        return call

    for function in functions:
        setattr(stand_in, function, caller(function))
    sys.modules[name] = stand_in


@contextmanager
def deferred(name: str) -> Generator[None]:
    """What is imported inside of the block gets a stand-in for the module `name`, loaded at its first use.

    Behind the block the name is as it was: whoever imports it gets the true module.
    """
    if name in sys.modules:
        yield
        return
    stand_in = ModuleType(name)

    def attribute(wanted: str) -> Any:
        if wanted.startswith("__"):
            raise AttributeError(wanted)
        return getattr(importlib.import_module(name), wanted)

    # A module asks its dictionary for __getattr__ (PEP 562).
    stand_in.__dict__["__getattr__"] = attribute
    sys.modules[name] = stand_in
    try:
        yield
    finally:
        if sys.modules.get(name) is stand_in:
            del sys.modules[name]


def defer_classes(name: str, classes: tuple[str, ...]) -> None:
    """Puts a module in the place of `name` whose classes are made by the true module when they are called.

    Anything else that is asked of it loads the true module, which then stands in its place. Nothing is done
    where it has been imported already.

    Args:
        name: dotted name of a module.
        classes: what is imported from it, and only called.
    """
    if name in sys.modules:
        return
    stand_in = ModuleType(name)

    def true_module() -> ModuleType:
        if sys.modules.get(name) is stand_in:
            del sys.modules[name]
        return importlib.import_module(name)

    def made(wanted: str) -> Callable[..., Any]:
        def new(cls: type, *args: Any, **extra: Any) -> Any:
            return getattr(true_module(), wanted)(*args, **extra)

        return new

    def attribute(wanted: str) -> Any:
        if wanted.startswith("__"):
            raise AttributeError(wanted)
        return getattr(true_module(), wanted)

    for wanted in classes:
        setattr(stand_in, wanted, type(wanted, (), {"__new__": made(wanted), "__module__": name}))
    stand_in.__dict__["__getattr__"] = attribute
    sys.modules[name] = stand_in
