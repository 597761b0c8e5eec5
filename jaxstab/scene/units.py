"""The units of a scene: those of motion along a line, or those of rotation."""

import re
from enum import Enum


class Units(Enum):
    """The units of mass, stiffness, damping, length, force, and the word for what is moved."""

    LINE = "kg", "N/m", "N s/m", "m", "N", "mass"
    ROTATION = "kg m^2", "N m/rad", "N m s/rad", "rad", "N m", "inertia"

    def __init__(
        self, kilogram: str, stiffness: str, damping: str, length: str, force: str, moved: str
    ) -> None:
        self.kilogram = kilogram
        self.stiffness = stiffness
        self.damping = damping
        self.length = length
        self.force = force
        self.moved = moved

    def unit(self, of_line: str) -> str:
        """Return the unit that stands for one of motion along a line."""
        line = Units.LINE
        pairs = {
            line.kilogram: self.kilogram,
            line.stiffness: self.stiffness,
            line.damping: self.damping,
            line.length: self.length,
            line.force: self.force,
        }
        return pairs.get(of_line, of_line)

    def translated(self, sentence: str) -> str:
        """Return a sentence with the units of motion along a line in these units."""
        return re.sub(r"N/m\b|N s/m\b", lambda match: self.unit(match[0]), sentence)
