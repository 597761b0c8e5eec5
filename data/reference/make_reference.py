"""Write the 50-digit reference tables beside this file: `python data/reference/make_reference.py`.

The formulas are those of tests/truth. The tables come out the same, byte for byte, every time.
"""

import sys
from collections.abc import Callable, Iterable
from itertools import product
from math import nextafter, pi
from pathlib import Path
from typing import NamedTuple

from mpmath import mp, mpf

FOLDER = Path(__file__).resolve().parent
sys.path.insert(0, str(FOLDER.parents[1]))

from tests.truth import loop as truth  # noqa: E402

Row = tuple[object, ...]


class Table(NamedTuple):
    """A file: what it says of itself, its columns, its points, and the rows of one point."""

    about: str
    columns: str
    points: list[Row]
    rows: Callable[..., Iterable[Row]]

    def lines(self, point: Row) -> list[str]:
        """The lines of one point."""
        return ["\t".join(cell(value) for value in row) + "\n" for row in self.rows(*point)]

    def text(self) -> str:
        """The whole file."""
        about = [f"# {line.strip()}\n" for line in self.about.strip().splitlines()]
        body = [line for point in self.points for line in self.lines(point)]
        return "".join([*about, "\t".join(self.columns.split()) + "\n", *body])


def cell(value: object) -> str:
    """An exact input as Python's repr, a result to 50 digits."""
    if isinstance(value, mpf):
        return mp.nstr(value, truth.DIGITS, min_fixed=1, max_fixed=0) if value else "0.0"
    return value if isinstance(value, str) else repr(value)


# ------------------------------------------------------------------------------------- coefficients

GAMMAS = [0.0, 1e-300, 1e-100, 1e-30, 1e-16, 1e-12, 1e-8, 1e-6, 1e-3, 0.1, 1.0]
GAMMAS += [pi**2 / 16, pi**2 / 4, pi**2, pi**2 + 0.25, (2 * pi) ** 2, 40.0]
DELTAS = [0.0, 1e-300, 1e-100, 1e-16, 1e-12, 1e-8, 1e-3, 0.015, 0.1, 1.0, 2.0, 10.0]
FRACTIONS = [1e-12, 0.25, 0.5, 0.9, 1 - 1e-12]
DELAYED_PLANTS = [(0.0, 0.0), (1e-300, 1e-8), (1e-3, 0.015), (1.0, 2.0), (pi**2, 0.0), (40.0, 10.0)]
CRITICAL_DELTAS = [2.0**-40, 2.0**-10, 0.125, 0.5, 1.0, 2.0, 3.0, 10.0]  # delta^2/4 is a float64


def coefficient_points() -> list[Row]:
    """A checkered grid with both edges whole, critical damping, fractional delays."""
    grid = [
        (gamma, delta, 0.0)
        for (i, gamma), (j, delta) in product(enumerate(GAMMAS), enumerate(DELTAS))
        if i == 0 or j == 0 or (i + j) % 2 == 0
    ]
    critical = [
        (gamma, delta, 0.0)
        for delta in CRITICAL_DELTAS
        for gamma in (nextafter(delta**2 / 4, 0), delta**2 / 4, nextafter(delta**2 / 4, 99))
    ]
    delayed = [(*plant, fraction) for plant, fraction in product(DELAYED_PLANTS, FRACTIONS)]
    return grid + critical + delayed


def coefficient_rows(gamma: float, delta: float, fraction: float) -> Iterable[Row]:
    """One row."""
    yield gamma, delta, fraction, *truth.plant(gamma, delta, fraction)


COEFFICIENTS = Table(
    """Sampled plant of the haptic loop, normalised (T = m = 1); all columns dimensionless.
    Inputs gamma, delta, fraction (of the delay) are float64 numbers; results have 50 digits.
    D(z) = z^2 + d1 z + d0; numerator n2 z^2 + n1 z + n0; sum and difference: its values at z = 1
    and z = -1.""",
    "gamma delta fraction d1 d0 n2 n1 n0 sum difference",
    coefficient_points(),
    coefficient_rows,
)

# -------------------------------------------------------------------------------------------- roots

ROOT_DELAYS = [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 0.25, 1.5, 2.75, 4.0 - 1e-12]
ROOT_PLANTS = [(0.0, 0.0), (1e-3, 0.015), (pi**2 / 4, 0.1)]
ROOT_GAINS = [(0.01, 0.08), (0.3, 0.9)]
ROOT_SPECIALS = [
    (0.0, 0.0, 0.0, 0.0, 0.0),  # two roots at z = 1
    (0.0, 0.0, 1.0, 2.0, 2.0),  # critical damping without a controller: a double root
    (0.3, 0.0, 1e-3, 0.015, 1.5),  # without virtual damping: a root at zero
    (-1e-3, 0.1, 1e-3, 0.015, 1.0),  # alpha = -gamma: a root at z = 1
    (0.0702399751200837, 0.4053537130707187, 0.0, 0.0, 0.0),  # close to a triple root
    (1e-300, 1e-300, 1e-3, 0.015, 3.0),  # tiny gains
    (2.0, -0.5, pi**2, 0.0, 1.0),  # a root at z = -1, almost
    (-3.0, 0.2, 40.0, 10.0, 2.5),
]


def root_points() -> list[Row]:
    """Two pairs of gains for each plant and delay, and the special cases."""
    scenes = product(ROOT_DELAYS, ROOT_PLANTS, ROOT_GAINS)
    return [(*gains, *plant, delay) for delay, plant, gains in scenes] + ROOT_SPECIALS


def root_rows(alpha: float, beta: float, gamma: float, delta: float, delay: float) -> Iterable[Row]:
    """One row per root, the largest modulus first."""
    for number, root in enumerate(truth.roots(alpha, beta, gamma, delta, delay)):
        yield alpha, beta, gamma, delta, delay, number, root.real, root.imag, abs(root)


ROOTS = Table(
    """Roots of the characteristic polynomial, one per line, the largest modulus first.
    Dimensionless; inputs are float64 numbers (delay in samples); results have 50 digits of the
    modulus.
    A multiple root is repeated.""",
    "alpha beta gamma delta delay number real imag modulus",
    root_points(),
    root_rows,
)

# ----------------------------------------------------------------------------------------- boundary

THETAS = [1e-8, 1e-3, 0.1, 1.0, 2.0, 3.0, pi - 1e-8]
BOUNDARY_PLANTS = [(0.0, 0.0), (1e-3, 0.015), (pi**2 / 4, 0.1), (pi**2, 0.0), (pi**2 + 0.25, 1.0)]
CURVES = [(0.0, 1.0), (1.0, 1.0), (2.5, 0.9)]  # delay, radius


def boundary_rows(
    theta: float, gamma: float, delta: float, delay: float, radius: float
) -> Iterable[Row]:
    """One row."""
    point = truth.boundary_point(theta, gamma, delta, delay, radius)
    yield theta, gamma, delta, delay, radius, *point


BOUNDARY = Table(
    """The gains (alpha, beta) that put a pair of roots at radius exp(+-i theta); dimensionless.
    Inputs are float64 numbers (delay in samples, theta in radians); results have 50 digits.""",
    "theta gamma delta delay radius alpha beta",
    [(theta, *plant, *curve) for plant, curve, theta in product(BOUNDARY_PLANTS, CURVES, THETAS)],
    boundary_rows,
)

# ------------------------------------------------------------------------------------------ anchors

LARGEST_ALPHA_GUESSES = {0.0: 1.15, 1.0: 0.55, 2.0: 0.36, 3.0: 0.27}  # theta
SMALLEST_RADIUS_GUESSES = {  # radius, alpha, beta
    0.0: (0.59, 0.070, 0.41),
    1.0: (0.75, 0.019, 0.22),
    2.0: (0.82, 0.0087, 0.15),
    3.0: (0.86, 0.0049, 0.11),
    4.0: (0.89, 0.0031, 0.090),
    5.0: (0.907, 0.0022, 0.076),
}
LINEAR_LEVELS = {"linear_error_2_percent": mpf(2) / 100, "linear_error_5_percent": mpf(5) / 100}
FIG_7 = list(product([0.0, 1.0], [0.0, 1e-3], [0.0, 0.005, 0.01, 0.015]))  # delay, gamma, delta


def anchor_rows(fact: str, gamma: float, delta: float, delay: float) -> Iterable[Row]:
    """One row."""
    if fact == "largest_alpha":
        theta, radius, alpha, beta = largest_alpha(gamma, delta, delay)
    elif fact == "smallest_radius":
        theta, radius, alpha, beta = smallest_radius(gamma, delta, delay)
    else:
        theta, radius, alpha, beta = linear_error(LINEAR_LEVELS[fact], gamma, delta, delay)
    yield fact, gamma, delta, delay, theta, radius, alpha, beta


def largest_alpha(gamma: float, delta: float, delay: float) -> tuple[mpf, ...]:
    """The top of the boundary curve's first arch, where alpha is stationary."""

    def slope(theta: mpf) -> mpf:
        return mp.diff(lambda t: truth.boundary_point(t, gamma, delta, delay)[0], theta)

    theta = mp.findroot(slope, LARGEST_ALPHA_GUESSES[delay])
    return theta, mpf(1), *truth.boundary_point(theta, gamma, delta, delay)


def smallest_radius(gamma: float, delta: float, delay: float) -> tuple[mpf, ...]:
    """The triple root that no pair of gains betters (a finding of search, not a theorem)."""

    def triple_root(radius: mpf, alpha: mpf, beta: mpf) -> list[mpf]:
        p = truth.polynomial(alpha, beta, gamma, delta, delay)
        first = derivative(p)
        return [truth.evaluate(q, radius) for q in (p, first, derivative(first))]

    radius, alpha, beta = mp.findroot(triple_root, SMALLEST_RADIUS_GUESSES[delay])
    return mpf(0), radius, alpha, beta


def derivative(p: list[mpf]) -> list[mpf]:
    """Of a polynomial, highest power first."""
    degree = len(p) - 1
    return [(degree - i) * c for i, c in enumerate(p[:-1])]


def linear_error(level: mpf, gamma: float, delta: float, delay: float) -> tuple[mpf, ...]:
    """Where the linear condition (23) promises `level` more stiffness than there is, eq. (24)."""

    def excess(theta: mpf) -> mpf:
        alpha, beta = truth.boundary_point(theta, gamma, delta, delay)
        linear = (beta + delta) / (mpf(delay) + mpf(1) / 2)
        return (linear - alpha) / (alpha + gamma) - level

    start = mpf(1) / 16
    while excess(start * 17 / 16) < 0:
        start *= mpf(17) / 16
    theta = mp.findroot(excess, (start, start * 17 / 16), solver="anderson", tol=mpf(10) ** -110)
    return theta, mpf(1), *truth.boundary_point(theta, gamma, delta, delay)


ANCHORS = Table(
    """Distinguished gains; dimensionless. Inputs gamma, delta, delay (samples) are float64 numbers;
    results have 50 digits. A root of p lies at radius exp(i theta).
    largest_alpha: the largest stable alpha. smallest_radius: the smallest spectral radius over
    all gains, at a triple root. linear_error_X_percent: where the linear condition (23) exceeds
    the exact boundary by X % of alpha + gamma, eq. (24) (the crossing with a positive error).""",
    "fact gamma delta delay theta radius alpha beta",
    [("largest_alpha", 0.0, 0.0, delay) for delay in LARGEST_ALPHA_GUESSES]
    + [("smallest_radius", 0.0, 0.0, delay) for delay in SMALLEST_RADIUS_GUESSES]
    + [(level, g, d, delay) for level, (delay, g, d) in product(LINEAR_LEVELS, FIG_7)],
    anchor_rows,
)

TABLES = {
    "coefficients.tsv": COEFFICIENTS,
    "roots.tsv": ROOTS,
    "boundary.tsv": BOUNDARY,
    "anchors.tsv": ANCHORS,
}

if __name__ == "__main__":
    for name, table in TABLES.items():
        (FOLDER / name).write_text(table.text(), encoding="utf-8", newline="\n")
        print(f"{name}: {len(table.points)} points")
