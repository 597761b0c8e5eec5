"""Published numbers compared with jaxstab: the paper's claims, and those of others as far as seen.

`python docs/reproduced/claims.py` prints the table of docs/reproduced/index.md.
"""

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from math import exp, pi, sqrt

import numpy as np

import jaxstab
from jaxstab import minimize_settling
from jaxstab.conventions import Verdict
from jaxstab.lab.contact.runs import ContactKind
from jaxstab.loop import HapticLoop
from jaxstab.model import Device
from jaxstab.paper import linear_validity, passive_region, plant_coefficients
from jaxstab.point import closed_loop_poles, verdict
from jaxstab.region import boundary_curve, stable_region

_PAPER = "Hulin et al. 2008"
_DELTAS = 0.0, 0.005, 0.01, 0.015  # of Fig. 7
_DELAYS = 0.0, 1.0
_TINY = 1e-12  # what rounding leaves
_HANDS = 201  # samples of gamma up to the Nyquist frequency
_INSIDE = 1.0 - 1e-6  # towards the middle: the edge itself is not asymptotically stable
_WALLS = 60  # of a device with friction
_SAMPLES = 0.0, 1.0, 2.0, 3.0  # delays for which the best settling is asked


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
        """The fate of the claim in a word or two."""
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


def _left_edge() -> Finding:
    points = stable_region(gamma=0.001, delta=0.015, delay=0.0).points
    return number(float(points[:, 0].min()), -0.001, _TINY)


def _largest(delta: float, delay: float) -> float:
    return float(stable_region(gamma=0.0, delta=delta, delay=delay).max_alpha[0])


def _damping_helps() -> Finding:
    free, damped = _largest(0.0, 0.0), _largest(0.015, 0.0)
    return Finding(f"{free:.6f} to {damped:.6f}", f"+{damped / free - 1.0:.2%}", damped > free)


def _delay_hurts() -> Finding:
    largest = [_largest(0.0, delay) for delay in (0.0, 1.0, 2.0)]
    words = ", ".join(f"{alpha:.5f}" for alpha in largest)
    return Finding(words, "each less", largest == sorted(largest, reverse=True))


def _stiffness_of_the_hand() -> Finding:
    moved = [
        abs(float(with_hand.alpha) / float(without.alpha) - 1.0)
        for level in (0.02, 0.05)
        for delta in _DELTAS
        for delay in _DELAYS
        for without, with_hand in [
            (
                linear_validity(level, gamma=0.0, delta=delta, delay=delay),
                linear_validity(level, gamma=0.001, delta=delta, delay=delay),
            )
        ]
    ]
    return bound(100.0 * max(moved), 0.2, " %")


def _tangent(delay: float) -> Finding:
    alpha, beta = boundary_curve(1e-5, gamma=0.0, delta=0.0, delay=delay)
    return number(float(beta) / float(alpha), 0.5 + delay, 1e-9)


def _moves_left(gamma: float, delay: float) -> Finding:
    return number(
        round(float(stable_region(gamma=gamma, delta=0.0, delay=delay).max_alpha[0]), 15),
        0.0,
        0.0,
        3,
    )


def _triangle() -> Finding:
    corners = len(stable_region(gamma=pi**2 + 0.25, delta=1.0, delay=0.0).corners)
    return Finding(f"{corners} corners", str(corners - 3), corners == 3)


def _pole_at_minus_one() -> Finding:
    distances = [
        float(abs(closed_loop_poles(-5.0, -1.0, gamma=pi**2, delta=0.0, delay=delay) + 1.0).min())
        for delay in _SAMPLES
    ]
    return Finding("z = -1", f"{max(distances):.0e}", max(distances) < 1e-7)


def _passive(delay: float) -> Finding:
    largest = passive_region(delta=1.0, delay=delay, tolerance=1e-8).outline
    on_axis = largest[np.abs(largest[:, 1]) < 1e-9, 0]
    return number(float(on_axis.max()), 1.0 / (0.5 + delay), 1e-6, 8)


def _passive_inside() -> Finding:
    corners = passive_region(delta=1.0, delay=0.0).outline
    vertices = corners.mean(axis=0) + _INSIDE * (corners - corners.mean(axis=0))
    gamma = np.linspace(0.0, pi**2 + 0.25, _HANDS)
    codes = verdict(vertices[:, :1], vertices[:, 1:], gamma=gamma, delta=1.0, delay=0.0)
    unstable = int(np.sum(codes != Verdict.STABLE))
    return Finding(f"{codes.size - unstable} of {codes.size} stable", str(unstable), unstable == 0)


def _nyquist_stiffness() -> Finding:
    mass, period, damping = 0.1, 0.001, 1.5
    stiffness = (pi**2 * mass / period**2 + damping**2 / (4.0 * mass)) / 1e3
    return number(stiffness, 987.0, 0.05, 6)


def _frequency() -> Finding:
    """Eq. (25) as printed, beside the poles of the device."""
    mass, damping, stiffness = 0.1, 1.5, 100.0
    printed = sqrt(stiffness / mass - damping**2 / (4.0 * mass))
    device = Device.mass_spring_damper(mass, damping=damping, stiffness=stiffness)
    pole = device.poles().imag.max().item()
    words = f"{pole:.4f} rad/s; printed: {printed:.4f}"
    return Finding(words, f"{printed - pole:.1e}", abs(printed - pole) < _TINY)


def _plant_as_printed() -> Finding:
    """Eq. (2) at z = 2, beside the sampled plant: b c1 lacks the factor m/T."""
    m, b, k, T, z = 0.1, 1.5, 100.0, 0.01, 2.0
    delta, gamma = b * T / m, k * T**2 / m
    c1 = sqrt(abs(delta**2 - 4.0 * gamma)) * (1.0 if delta**2 > 4.0 * gamma else 1.0j)
    c2, c3 = np.exp(-(delta + c1) / 2.0), np.exp(-(delta - c1) / 2.0)
    E = exp(-delta)
    above = ((c2 + c3 - 2.0) * z + c2 + c3 - 2.0 * E) * (b**2 - 4.0 * k * m)
    below = 2.0 * k * (z**2 - (c2 + c3) * z + E) * (4.0 * k * m - b**2)
    printed, mended = (
        complex((above + factor * b * c1 * (c3 - c2) * (z - 1.0)) / below).real
        for factor in (1.0, m / T)
    )
    plant = plant_coefficients(gamma=gamma, delta=delta)
    numerator = float(plant.n2) * z + float(plant.n1)
    exact = T**2 / m * numerator / (z**2 + float(plant.d1) * z + float(plant.d0))
    words = f"{exact:.6e} m/N; printed: {printed:.6e}; with m/T: {mended:.6e}"
    return Finding(words, f"{printed / exact - 1.0:.1%}", abs(printed - exact) < 1e-9 * exact)


def _undamped_mass() -> Finding:
    return number(_largest(0.0, 0.0), 12.0 - 8.0 * sqrt(2.0), _TINY, 12)


def _settling_grows() -> Finding:
    counts = [int(minimize_settling(gamma=0.0, delta=0.0, delay=delay).value) for delay in _SAMPLES]
    growth = (counts[-1] - counts[0]) / (_SAMPLES[-1] - _SAMPLES[0])
    words = f"{growth:.2f} ({', '.join(map(str, counts))} samples)"
    return Finding(words, f"{growth - 5.0:+.2f}", round(growth) == 5)


def _half_of_the_stiffness() -> Finding:
    shares = [
        float(minimize_settling(gamma=0.0, delta=0.0, delay=delay).alpha) / _largest(0.0, delay)
        for delay in _SAMPLES
    ]
    return bound(max(shares), 0.5)


def _quantised_walls() -> Finding:
    """Springs of up to the stiffness of the rule, on devices with friction and an encoder."""
    random, period, grown = np.random.default_rng(2005), 1e-3, 0
    masses = 0.05, 0.2, 1.0
    for mass in masses:
        damping = 10.0 ** random.uniform(-0.5, 0.5)
        loop = HapticLoop(device_mass=mass, device_damping=damping, sample_time=period)
        friction = 10.0 ** random.uniform(-2.0, 0.0, _WALLS)
        encoder = 10.0 ** random.uniform(-6.0, -4.0, _WALLS)
        contact = jaxstab.contact(
            loop,
            np.minimum(2.0 * damping / period, 2.0 * friction / encoder),
            0.0,
            friction=friction,
            encoder=encoder,
            phase=random.uniform(size=_WALLS),
            speed=10.0 ** random.uniform(-3.0, -1.0, _WALLS),
            one_sided=False,
            path=False,
        )
        grown += int(np.sum(contact.kind == ContactKind.GROWS))
    return Finding(f"{grown} of {len(masses) * _WALLS} grow", str(grown), grown == 0)


def _of(place: str) -> str:
    return f"{_PAPER}, {place}"


_Find = Callable[[], Finding]
_MOVED: list[tuple[str, str, float, _Find]] = [
    ("sec. VIII.A", "pi^2/4", 0.0, partial(_moves_left, pi**2 / 4.0, 0.0)),
    ("sec. VIII.B", "(pi/4)^2", 1.0, partial(_moves_left, (pi / 4.0) ** 2, 1.0)),
]

CLAIMS: tuple[Claim, ...] = (
    Claim(_of("Fig. 5"), "left edge for gamma = 0.001", "-gamma", _left_edge),
    Claim(_of("sec. V"), "damping makes the region larger", "larger", _damping_helps),
    Claim(_of("sec. V"), "delay makes the region smaller", "smaller", _delay_hurts),
    Claim(
        _of("sec. VII"),
        "the 2 and 5 % points move by less, from gamma = 0 to 0.001",
        "0.2 %",
        _stiffness_of_the_hand,
    ),
    *(
        Claim(_of(place), f"gamma = {gamma}, d = {delay:g}: largest alpha", "0", find)
        for place, gamma, delay, find in _MOVED
    ),
    Claim(_of("Fig. 9"), "gamma = pi^2 + 1/4, delta = 1: the region", "a triangle", _triangle),
    Claim(
        _of("sec. VIII.B"),
        "gamma = pi^2, delta = 0: a pole for d = 0 to 3",
        "-1",
        _pole_at_minus_one,
    ),
    Claim(
        _of("Fig. 9"),
        "passive walls are stable for all hands up to Nyquist's frequency (sampled)",
        "all",
        _passive_inside,
    ),
    Claim(_of("Remark 4"), "stiffness for Nyquist's frequency (kN/m)", "987.0", _nyquist_stiffness),
    Claim(
        _of("Remark 3"), "gamma = delta = d = 0: largest alpha", "12 - 8 sqrt 2 *", _undamped_mass
    ),
    Claim(_of("eq. (25)"), "m = 0.1, b = 1.5, k = 100: frequency", "b^2/4m", _frequency, True),
    Claim(_of("eq. (2)"), "the plant at z = 2, T = 0.01", "b c1", _plant_as_printed, True),
    *(
        Claim(
            "Gil et al., in eqs. (22), (23)",
            f"d = {delay:g}: slope beta/alpha of the boundary at 0",
            f"1/2 + {delay:g}",
            partial(_tangent, delay),
        )
        for delay in _DELAYS
    ),
    *(
        Claim(
            "Colgate and Schenkel, in eq. (28)" + " for a delay" * bool(delay),
            f"delta = 1, beta = 0, d = {delay:g}: largest passive alpha",
            f"1/(1/2 + {delay:g})",
            partial(_passive, delay),
        )
        for delay in (0.0, 1.0, 2.0)
    ),
    Claim(
        "Abbott and Okamura 2005, as quoted",
        "K = min(2 b/T, 2 f_c/q), B = 0, d = 0: simulated contacts that grow",
        "none *",
        _quantised_walls,
    ),
    Claim(
        "later papers of Hulin et al.",
        "samples by which the best 2 % settling time grows, per sample of delay",
        "about 5",
        _settling_grows,
    ),
    Claim(
        "later papers of Hulin et al.",
        "stiffness of the best pair, as a share of the largest",
        "less than half",
        _half_of_the_stiffness,
    ),
)
"""Published claims; * marks what follows from a stated formula and is not printed itself."""


if __name__ == "__main__":
    sys.stdout.write(markdown(CLAIMS) + "\n")
