"""Docstrings as griffe reads them: ``Examples:``, and shared arguments and errors in full."""

import re
from typing import Any

import griffe

from jaxstab import conventions

_DOC = conventions.__doc__ or ""
_SEE = r"see ``jaxstab\.conventions``"
_SHARED = re.compile(rf"(?m)^( +)([\w, ]+): {_SEE}\.$")
_BOTH = re.compile(rf"(?m)^Args and Raises: {_SEE}")
_RAISES = re.compile(rf"(?m)^Raises: {_SEE}((?:.|\n(?!\s*\n))*)")
_ALSO = re.compile(r"; (\w+) also (?:for |if )?((?:.|\n)*)")
_ARGUMENTS = dict(re.findall(r"(?m)^    (\w+): (.+)$", _DOC))
_ERRORS = re.findall(r"(\w+Error) for ([^;]+?)(?:;|\.$)", " ".join(_DOC.split("raise:")[1].split()))


class Examples(griffe.Extension):
    """Rename the sections ``Example:``, and write out the arguments and errors that are shared."""

    def on_package(self, *, pkg: griffe.Module, **_: Any) -> None:
        """Take a function for its name, not the module of the same name (``margins``)."""
        for package in pkg.modules.values():
            for name, module in package.modules.items():
                listed = pkg.members.get(name)
                if listed is not None and listed.is_alias and listed.target_path == module.path:
                    pkg.members[name] = griffe.Alias(name, module.members[name], parent=pkg)

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Change one docstring."""
        if obj.docstring is None:
            return
        text = re.sub(r"(?m)^Example:$", "Examples:", obj.docstring.value)
        names = [one.name for one in getattr(obj, "parameters", ()) if one.name in _ARGUMENTS]
        shared = "Args:\n" + _lines("    ", [(name, _ARGUMENTS[name]) for name in names])
        text = _BOTH.sub(f"{shared}\n\nRaises: see ``jaxstab.conventions``", text)
        obj.docstring.value = _SHARED.sub(_arguments, _RAISES.sub(_errors, text))


def _lines(indent: str, pairs: list[tuple[str, str]]) -> str:
    return "\n".join(f"{indent}{name}: {words}" for name, words in pairs)


def _arguments(line: re.Match[str]) -> str:
    indent, names = line.groups()
    return _lines(indent, [(name, _ARGUMENTS[name]) for name in names.split(", ")])


def _errors(section: re.Match[str]) -> str:
    rest = " ".join(section[1].split())
    also = _ALSO.match(rest)
    more = [(also[1], also[2])] if also else []
    after = "" if also else rest.strip("; .")
    listed = "Raises:\n" + _lines("    ", [*_ERRORS, *more])
    return f"{listed}\n\n{after[:1].upper()}{after[1:]}." if after else listed
