"""The types of what jaxstab returns: regions, limits, margins, answers, and their statuses.

They are read, not made, by a program; their names serve annotations and comparisons such as
``answer.status == jaxstab.results.SettlingStatus.SETTLED``.
"""

from jaxstab.lazy import attach_siblings

__getattr__, __dir__, __all__ = attach_siblings(__name__, __file__)
