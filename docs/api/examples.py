"""Docstrings as griffe reads them: ``Examples:`` in the plural, shared arguments written out."""

import re
from typing import Any

import griffe

from jaxstab import conventions

_SHARED = re.compile(r"(?m)^( *)([\w, ]+): see ``jaxstab\.conventions``\.$")
_ARGUMENTS = dict(re.findall(r"(?m)^    (\w+): (.+)$", conventions.__doc__ or ""))


class Examples(griffe.Extension):
    """Rename the sections ``Example:``, and give each shared argument its text."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rename the section of one docstring and fill in its arguments."""
        if obj.docstring is not None:
            text = re.sub(r"(?m)^Example:$", "Examples:", obj.docstring.value)
            obj.docstring.value = _SHARED.sub(_written_out, text)


def _written_out(line: re.Match[str]) -> str:
    indent, names = line.groups()
    return "\n".join(f"{indent}{name}: {_ARGUMENTS[name]}" for name in names.split(", "))
