"""What a package exports: the names in the stub beside it, each loaded when it is first used."""

import re
import sys
from typing import Any

from lazy_loader import attach

_IMPORT = re.compile(r"^from \.([\w.]+) import (\w+) as \2$", re.MULTILINE)


def attach_stub(package: str, file: str) -> Any:
    """Return ``__getattr__``, ``__dir__`` and ``__all__`` of a package, by its ``__init__.pyi``.

    The stub is read by the loader of the package, which may be that of a zip file.

    Args:
        package: its ``__name__``.
        file: its ``__file__``.
    """
    loader: Any = sys.modules[package].__loader__
    exported: dict[str, list[str]] = {}
    for module, name in _IMPORT.findall(loader.get_data(f"{file}i").decode()):
        exported.setdefault(module, []).append(name)
    return attach(package, submod_attrs=exported)
