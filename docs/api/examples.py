"""Examples of docstrings, shown as code: griffe knows their section by its plural alone."""

import re
from typing import Any

import griffe


class Examples(griffe.Extension):
    """Rename the sections ``Example:`` before they are parsed."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rename the section of one docstring."""
        if obj.docstring is not None:
            obj.docstring.value = re.sub(r"(?m)^Example:$", "Examples:", obj.docstring.value)
