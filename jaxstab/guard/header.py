"""A guard as one header of C, with the table in it."""

import re
from importlib.resources import files

import numpy as np

from jaxstab.guard.guard import Guard
from jaxstab.shown import printable, shortened

LARGEST = 1_000_000

"""Bytes of a header at most."""

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,39}")

_WIDTH = 96

_LINE = ("kg", "N/m", "N s/m")


def checked_name(name: str) -> str:
    """Return a name that is valid in C, or raise ValueError."""
    if not _NAME.fullmatch(name):
        raise ValueError(
            f"name is {shortened(name)}; give at most 40 letters, digits and underscores, a letter "
            "first."
        )
    return name


def _checked_comment(name: str, text: str) -> str:
    """Return a text that stays within a comment of C, or raise ValueError."""
    if "*/" in text or printable(text, "\n") != text:
        raise ValueError(f"{name} is {shortened(text)}; give printable lines without '*/'.")
    return text


def guard_header(
    guard: Guard, name: str, about: str = "", units: tuple[str, str, str] = _LINE
) -> str:
    """Return a C99 header with NAME_clamp and NAME_largest_stiffness.

    Args:
        guard: what is proved.
        name: the beginning of all names in the header.
        about: lines that say for which loop the guard is made, printable and without "*/".
        units: of mass, stiffness and damping.

    Raises:
        ValueError: the name is not valid in C, ``about`` or a unit would not stay in a comment, or
            the header would be larger than 1 MB.

    Example:
        >>> loop = jaxstab.HapticLoop(device_mass=0.25, device_damping=0.1, sample_time=1e-3)
        >>> hands, mass, delay = jaxstab.HandRange(), (0.24, 0.26), (1e-3, 1.1e-3)
        >>> guard = jaxstab.build_guard(loop, hands, mass=mass, delay=delay, cells=(1, 1, 4))
        >>> header = jaxstab.guard_header(guard, "omega_guard")
        >>> "double omega_guard_largest_stiffness(double damping" in header
        True
    """
    checked_name(name)
    for kind, text in (("about", about), *(("units", unit) for unit in units)):
        _checked_comment(kind, text)
    grid, (stiffness_step, damping_step) = guard.grid, guard.units
    masses, delays, rows = grid.limit.shape
    values = {
        "NAME": name,
        "MACRO": name.upper(),
        "VERSION": _version(),
        "ABOUT": "\n".join(f" * {line}".rstrip() for line in about.splitlines()),
        "KG": units[0],
        "STIFFNESS_UNIT": units[1],
        "DAMPING_UNIT": units[2],
        "MASS_LOW": repr(float(guard.mass[0])),
        "MASS_HIGH": repr(float(guard.mass[1])),
        "DELAY_LOW": repr(float(guard.delay[0])),
        "DELAY_HIGH": repr(float(guard.delay[1])),
        "PER_MASS": repr((masses - 1) / (guard.mass[1] - guard.mass[0])),
        "PER_DELAY": repr((delays - 1) / (guard.delay[1] - guard.delay[0])),
        "STIFFNESS": repr(float(grid.limit.max())),
        "DAMPING": repr(float(grid.top.max())),
        "TOP_STEP": repr(damping_step),
        "LIMIT_STEP": repr(stiffness_step),
        "M": str(masses),
        "D": str(delays),
        "B": str(rows),
        "M_CELLS": str(masses - 1),
        "D_CELLS": str(delays - 1),
        "M_LAST": str(masses - 2),
        "D_LAST": str(delays - 2),
        "B_LAST": str(rows - 2),
        "ROWS": str(rows - 1),
        "TOP": _table(grid.top / damping_step),
        "GRANTED": _table(guard.rows),
        "LIMIT": _table(grid.limit / stiffness_step),
    }
    template = files("jaxstab.guard").joinpath("guard.h.in").read_text(encoding="utf-8")
    text = re.sub(r"@([A-Z_]+)@", lambda match: values[match[1]], template)
    if len(text.encode()) > LARGEST:
        raise ValueError(f"the header would have {len(text)} bytes; give fewer cells.")
    return text


def _version() -> str:
    import jaxstab

    return jaxstab.__version__


def _table(values: np.ndarray) -> str:
    """Return whole numbers as an initialiser, a row of the last axis on lines of its own."""
    if values.ndim > 1:
        return ",\n".join("{" + _table(row) + "}" for row in values)
    lines, line = [], ""
    for number in values:
        word = f"{int(number)},"
        if len(line) + len(word) > _WIDTH:
            lines.append(line)
            line = ""
        line += word
    return "\n".join([*lines, line]).rstrip(",")
