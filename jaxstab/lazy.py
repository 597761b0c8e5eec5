"""The names that a package exports: those in the stub beside it, each loaded at its first use."""

import re
import sys
from importlib import import_module
from typing import Any

from lazy_loader import attach

_IMPORT = re.compile(r"^from \.([\w.]*) import (\w+) as \2$", re.MULTILINE)


def attach_stub(package: str, file: str) -> Any:
    """Return ``__getattr__``, ``__dir__`` and ``__all__`` of a package, by its ``__init__.pyi``."""
    exported = _exported(package, file)
    return attach(package, submodules=exported.pop("", []), submod_attrs=exported)


def attach_siblings(module: str, file: str) -> Any:
    """The same as ``attach_stub`` for a module that exports names of packages beside it."""
    package = module.rpartition(".")[0]
    sources = {name: room for room, names in _exported(module, file).items() for name in names}

    def get(name: str) -> Any:
        if name not in sources:
            raise AttributeError(f"No {module} attribute {name}")
        return getattr(import_module(f"{package}.{sources[name]}"), name)

    return get, lambda: sorted(sources), sorted(sources)


def _exported(module: str, file: str) -> dict[str, list[str]]:
    """Return the names in a stub by the module that each comes from."""
    # The stub is read by the loader of the module, which may be that of a zip file.
    loader: Any = sys.modules[module].__loader__
    exported: dict[str, list[str]] = {}
    for source, name in _IMPORT.findall(loader.get_data(f"{file}i").decode()):
        exported.setdefault(source, []).append(name)
    return exported
