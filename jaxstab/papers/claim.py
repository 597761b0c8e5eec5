"""A published claim, and how jaxstab's answer compares."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """What jaxstab answers to a claim.

    Attributes:
        answer: a number or a remark in words.
        difference: by how much it differs from what is printed, in words.
        agrees: whether it is what is printed, to the printed digits.
    """

    answer: str
    difference: str
    agrees: bool


@dataclass(frozen=True)
class Claim:
    """A number or a remark that was published.

    Attributes:
        source: paper and place.
        says: what is claimed.
        printed: the number or the words, as they are printed.
        find: computes the Finding.
        is_misprint: whether a misprint is shown: then the answer does not agree.
    """

    source: str
    says: str
    printed: str
    find: Callable[[], Finding]
    is_misprint: bool = False

    def words(self, finding: Finding) -> str:
        """Return what becomes of the claim in a word or two."""
        if self.is_misprint:
            return "misprint" if not finding.agrees else "no misprint"
        return "agrees" if finding.agrees else "differs"


def number(value: float, printed: float, tolerance: float, digits: int = 10) -> Finding:
    """Return the finding on a printed number, which is right to a tolerance."""
    value, difference = value + 0.0, value - printed + 0.0  # no -0
    return Finding(f"{value:.{digits}g}", f"{difference:.1e}", abs(difference) <= tolerance)


def bound(value: float, most: float, unit: str = "") -> Finding:
    """Return the finding on a quantity that is said to be at most a number."""
    room = f"{most - value:.2g}{unit} below the bound"
    return Finding(f"{value:.4g}{unit}", room, value <= most)


def markdown(claims: Sequence[Claim]) -> str:
    """Return a table of claims and findings."""
    rows = [("source", "claim", "printed", "jaxstab", "difference", ""), ("---",) * 6]
    for claim in claims:
        found = claim.find()
        said = claim.words(found)
        rows.append((claim.source, claim.says, claim.printed, found.answer, found.difference, said))
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)
