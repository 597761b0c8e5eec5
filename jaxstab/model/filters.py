"""Velocity estimators and position filters, which real controllers put before the wall.

A filter is a chain of sections, each of them a chain of transfer functions. A section in SI units
(a window in s, a cut-off in Hz, a velocity in 1/s) becomes one in units of a sampling period by
``per_sample``. Its chain consists of the lowest possible orders: the loop's polynomial takes their
product, while the time domain runs one after the other, which loses no digits to poles close to
each other.

The numbers that a section computes from its parameters, such as exp(-2 pi f T), are rounded to
float64 first: proofs hold for the filter that software with these numbers runs.

A new kind of section is a class here, with its factors by one number, its text and its keys of
TOML, and a maker beside the others in ``Filter``. Files, pictures, proofs over ranges and
explorers take all kinds from the class.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache
from itertools import accumulate
from math import floor, inf, pi
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from jaxstab.arrays import (
    Array,
    Numbers,
    fixed,
    is_any_jax,
    is_any_traced,
    is_jax,
    is_traced,
    namespace,
    pytree,
    tree_map,
)
from jaxstab.model.device.parts import checked_sides, exact, flint
from jaxstab.model.double_double import DoubleDouble
from jaxstab.numbers import checked_count, checked_number, require_kind, require_x64
from jaxstab.shown import call_text

if TYPE_CHECKING:
    from flint import fmpq_poly

HIGHEST_ORDER = 40  # poles of a filter, but for those at z = 0
LONGEST_WINDOW = 200  # samples
HIGHEST_POLYNOMIAL = 10  # of a fit to samples

Stage = tuple[tuple[Any, ...], tuple[Any, ...]]
"""A filter of a low order: numerator and denominator in powers of 1/z, the latter 1 at first."""


class Section:
    """A kind of section: what all kinds have in common.

    maker: the method of ``Filter`` that makes one; None of a kind that only makes velocities.
    estimator: the method of ``Velocity``, where a difference that begins with this section has one.
    text: the section in words, with its parameters by name.
    powers: the parameters with units, each with the power of the sampling period that takes them.
    keys: those of TOML of the parameters that have another name there.
    remedy: where a sampling ``period`` leaves no filter, of kinds where one may.
    """

    maker: ClassVar[str | None] = None
    estimator: ClassVar[str | None] = None
    text: ClassVar[str] = ""
    powers: ClassVar[dict[str, int]] = {}
    keys: ClassVar[dict[str, str]] = {}
    remedy: ClassVar[str] = ""

    def __str__(self) -> str:
        return self.text.format(**{name: shown(value) for name, value in vars(self).items()})

    def per_sample(self, sample_time: Numbers) -> "Section":
        """Return the section in units of a sampling period in s."""
        if not self.powers:
            return self
        scaled = {name: getattr(self, name) * sample_time**n for name, n in self.powers.items()}
        section: Section = replace(self, **scaled)  # type: ignore[type-var]
        if self.remedy and not is_traced(section.number) and not section.is_filter:
            name = next(iter(self.powers))
            words = self.remedy.format(period=float(sample_time), rate=0.5 / float(sample_time))
            raise ValueError(f"{name} is {shown(getattr(self, name))}; {words}")
        return section

    @property
    def is_filter(self) -> bool:
        """True if a section in units of one sample filters, in float64."""
        return bool(0.0 < self.number < 1.0)

    @property
    def longest_sample_time(self) -> float:
        """The longest sampling period in s with which the section is a filter in float64."""
        return inf

    @property
    def length(self) -> int | None:
        """The number of samples that the section averages; None of other kinds."""
        return None

    @property
    def number(self) -> Array:
        """The number that a section in units of one sample computes from its parameters."""
        return 1.0

    @property
    def toml(self) -> dict[str, Any]:
        """The keys and values of TOML of a section in units of one sample."""
        given = {name: value for name, value in vars(self).items() if value is not None}
        values = ([*value] if isinstance(value, tuple) else value for value in given.values())
        return {self.keys.get(name, name): value for name, value in zip(given, values, strict=True)}

    def factors(self, number: Any) -> list[Stage]:
        """The factors of the transfer function, by that number: a pair or a fraction."""
        raise NotImplementedError

    def stages(self) -> list[Stage]:
        """The factors in units of one sample: in exact numbers, or in pairs if JAX has its number.

        They are those of the filter that runs: its number is a float64.
        """
        number = self.number
        if not is_jax(number):
            return _exact_stages(self)
        return self.factors(DoubleDouble.from_value(number))


_NOT_IN_FLOATS = "with a sampling period of {period:g} s it leaves no filter in float64: give "


@pytree
@dataclass(frozen=True)
class Average(Section):
    """The mean of the last samples of a window, given in samples or in seconds."""

    samples: int | None = fixed()
    window: float | None = fixed()

    maker: ClassVar[str] = "average"
    estimator: ClassVar[str] = "difference"
    keys: ClassVar[dict[str, str]] = {"samples": "window_samples"}

    def __str__(self) -> str:
        samples = f"{self.samples} sample{'' if self.samples == 1 else 's'}"
        window = f"{self.window:g} s" if self.samples is None else samples
        return f"a window of {window}"

    def per_sample(self, sample_time: Numbers) -> "Average":
        return Average(self.samples or _whole_samples(self.window, sample_time), None)

    @property
    def length(self) -> int:
        return self.samples or _whole_samples(self.window, 1.0)

    def factors(self, number: Any) -> list[Stage]:
        count = self.length
        return [_stage([Fraction(1, count)] * count, [1] + [0] * (count - 1))]


@pytree
@dataclass(frozen=True)
class LowPass(Section):
    """First-order low passes in a row, each with its pole at exp(-2 pi f T)."""

    cutoff: Numbers
    order: int = fixed()

    kind: ClassVar[str] = "low-pass"
    maker: ClassVar[str] = "low_pass"
    estimator: ClassVar[str] = "low_pass"
    text: ClassVar[str] = "a low pass at {cutoff} Hz of order {order}"
    powers: ClassVar[dict[str, int]] = {"cutoff": 1}
    remedy: ClassVar[str] = f"{_NOT_IN_FLOATS}one closer to 1 / period."
    most_turns: ClassVar[float] = 100.0  # a sample; of some more the pole is 0 in float64

    @property
    def number(self) -> Array:
        exponent = -2.0 * pi * self.cutoff  # of the pole
        return namespace(exponent).exp(exponent)

    @property
    def longest_sample_time(self) -> float:
        return self.most_turns / float(self.cutoff)

    def factors(self, number: Any) -> list[Stage]:
        return [_lag(1 - number)] * self.order


@pytree
@dataclass(frozen=True)
class Exponential(Section):
    """y_k = y_(k-1) + factor (x_k - y_(k-1))."""

    factor: Numbers

    maker: ClassVar[str] = "exponential"
    estimator: ClassVar[str] = "exponential"
    text: ClassVar[str] = "exponential smoothing by {factor}"

    @property
    def number(self) -> Array:
        return self.factor

    def factors(self, number: Any) -> list[Stage]:
        return [_lag(number)]


@pytree
@dataclass(frozen=True)
class Butterworth(LowPass):
    """The bilinear transform of Butterworth's low pass, with its cut-off prewarped."""

    kind: ClassVar[str] = "butterworth"
    maker: ClassVar[str] = "butterworth"
    estimator: ClassVar[str] = "butterworth"
    text: ClassVar[str] = "a Butterworth filter at {cutoff} Hz of order {order}"
    remedy: ClassVar[str] = "give one below half of the sampling rate, {rate:g} Hz."
    most_turns: ClassVar[float] = 0.499  # it ends at half of the sampling rate

    @property
    def number(self) -> Array:
        angle = pi * self.cutoff  # of the cut-off, whose tangent is that of the analogue filter
        return namespace(angle).tan(angle)

    @property
    def is_filter(self) -> bool:
        return bool(self.cutoff < 0.5)

    @property
    def toml(self) -> dict[str, Any]:
        return {**vars(self), "kind": self.kind}

    def factors(self, number: Any) -> list[Stage]:
        w, factors = number, []
        for k in range(self.order // 2):
            sine = float(np.sin(pi * (2 * k + 1) / (2 * self.order)))  # of the angle of two poles
            gain, turn = w * w, 2 * w * type(w)(sine)
            below = [gain + 1 + turn, 2 * (gain - 1), gain + 1 - turn]
            factors.append(_stage([gain, 2 * gain, gain], below))
        if self.order % 2:
            factors.append(_stage([w, w], [w + 1, w - 1]))
        return factors


@pytree
@dataclass(frozen=True)
class TransferSection(Section):
    """A transfer function in z by its coefficients, highest power first."""

    numerator: tuple[float, ...] = fixed()
    denominator: tuple[float, ...] = fixed()

    maker: ClassVar[str] = "transfer_function"

    def __str__(self) -> str:
        return f"a transfer function of order {len(self.denominator) - 1}"

    def factors(self, number: Any) -> list[Stage]:
        sides = self.numerator, self.denominator
        return [_stage(*(list(map(Fraction, side)) for side in sides))]


@pytree
@dataclass(frozen=True)
class Differentiator(TransferSection):
    """A transfer function V(z) with V(1) = 0, less one difference: period V(z) z / (z - 1)."""

    period: Numbers = 1.0

    estimator: ClassVar[str] = "transfer_function"
    powers: ClassVar[dict[str, int]] = {"period": 1}

    @property
    def number(self) -> Array:
        return self.period

    def factors(self, number: Any) -> list[Stage]:
        steps = accumulate(map(Fraction, self.numerator[:-1]))
        above = [number * step if step else 0 for step in steps]
        return [_stage([*above, 0], list(map(Fraction, self.denominator)))]

    @property
    def toml(self) -> dict[str, Any]:
        numerator = tuple(c * self.period for c in self.numerator)
        return TransferSection(numerator, self.denominator).toml


@pytree
@dataclass(frozen=True)
class Kalman(Section):
    """A Kalman filter of positions, at its steady gain; behind the difference it is a velocity.

    The device is taken for a free mass with an acceleration that is noise of variance q, constant
    within a sample; positions have noise of variance r. With the tracking index T^2 sqrt(q/r) the
    gain follows from one number s between 0 and 1, that of position 1 - (1 - s)^2, that of velocity
    2 s^2/T.
    """

    q: Numbers
    r: Numbers

    estimator: ClassVar[str] = "kalman"
    text: ClassVar[str] = "a Kalman filter with q = {q} and r = {r}"
    powers: ClassVar[dict[str, int]] = {"q": 4}
    keys: ClassVar[dict[str, str]] = {"q": "acceleration_variance", "r": "position_variance"}
    remedy: ClassVar[str] = f"{_NOT_IN_FLOATS}q/r closer to 1 / period^4."

    @property
    def number(self) -> Array:
        ratio = self.q / self.r
        xp = namespace(ratio)
        index = xp.sqrt(ratio)
        return 2.0 / (1.0 + xp.sqrt(1.0 + 8.0 / index))

    def factors(self, number: Any) -> list[Stage]:
        s = number
        return [_stage([2 * s * s, 0, 0], [1, s * s + 2 * s - 2, (1 - s) * (1 - s)])]


@pytree
@dataclass(frozen=True)
class SavitzkyGolay(Section):
    """The slope, at the newest of some samples, of the polynomial that fits them best.

    As a filter behind the difference: its weights are sums of those of the samples, rounded.
    """

    samples: int = fixed()
    order: int = fixed()

    estimator: ClassVar[str] = "savitzky_golay"
    text: ClassVar[str] = "the slope of a polynomial of order {order} through {samples} samples"
    keys: ClassVar[dict[str, str]] = {"samples": "window_samples", "order": "polynomial"}

    @property
    def weights(self) -> tuple[float, ...]:
        """The weights of differences, that of the newest first."""
        # A polynomial in t = 0, -1, ... whose coefficients solve the normal equations.
        powers = range(self.order + 1)
        rows = flint.fmpq_mat([[(-k) ** power for power in powers] for k in range(self.samples)])
        slope = flint.fmpq_mat([[int(power == 1)] for power in powers])
        solved = rows * (rows.transpose() * rows).solve(slope)
        sums = accumulate(solved.entries()[:-1])
        return tuple(int(weight.p) / int(weight.q) for weight in sums)

    def factors(self, number: Any) -> list[Stage]:
        return [_stage(list(map(Fraction, self.weights)), [1] + [0] * (self.samples - 2))]


@pytree
@dataclass(frozen=True)
class Measured(Section):
    """The device's own velocity in place of a difference of its positions."""

    estimator: ClassVar[str] = "measured"
    text: ClassVar[str] = "the device's own velocity"

    def factors(self, number: Any = None) -> Any:
        raise ValueError(
            "velocity is measured, an output of a device in z in a HapticLoop; what is asked for "
            "needs an estimator from positions, and a device in s."
        )

    toml = property(factors)


LOW_PASSES = (LowPass, Butterworth)  # by ``kind``, which a table gives beside the cut-off


def _lag(factor: Any) -> Stage:
    """y_k = y_(k-1) + factor (x_k - y_(k-1))."""
    return _stage([factor, 0], [1, factor - 1])


@lru_cache(maxsize=256)
def _exact_stages(section: Section) -> list[Stage]:
    return section.factors(Fraction(float(section.number)))


@lru_cache(maxsize=256)
def exact_chain(sections: tuple[Section, ...]) -> "tuple[fmpq_poly, fmpq_poly]":
    """Numerator and denominator of a chain in powers of 1/z; ValueError: beyond float64."""
    sides = [flint.fmpq_poly([1]), flint.fmpq_poly([1])]
    for section in sections:
        for stage in section.stages():
            for side, row in enumerate(stage):
                sides[side] *= flint.fmpq_poly(list(map(exact, row)))
    largest = 10**150  # products of such coefficients are float64 still
    if max(abs(c) for side in sides for c in side.coeffs()) > largest:
        raise ValueError(
            f"the filter ({Filter(sections)}) has coefficients beyond {float(largest):g} in "
            "powers of 1/z; give a numerator of the size of its denominator."
        )
    return sides[0], sides[1]


def rounded(polynomial: "fmpq_poly") -> np.ndarray:
    """Return the coefficients of a polynomial in float64, lowest power first."""
    return np.array([int(c.p) / int(c.q) for c in polynomial.coeffs()])


def _stage(above: list[Any], below: list[Any]) -> Stage:
    """A proper quotient by its coefficients, highest power of z first."""
    leading = below[0]
    sides = [0] * (len(below) - len(above)) + above, below
    for side in sides:
        while len(side) > 1 and side[-1] == 0:  # a pair is no number that is known to be 0
            side.pop()
    if leading != 1:
        sides = [c / leading for c in sides[0]], [c / leading for c in sides[1]]
    return tuple(sides[0]), (1, *sides[1][1:])


def _floats(coefficients: tuple[Any, ...]) -> tuple[Array, ...]:
    return tuple(c.rounded() if isinstance(c, DoubleDouble) else float(c) for c in coefficients)


def shown(value: Numbers) -> str:
    """Return a number as a person would write it."""
    return "a traced value" if is_traced(value) else f"{float(value):g}"


def sections_of(velocity: "Velocity | None", position: "Filter | None") -> tuple[Section, ...]:
    """The sections of both filters of a loop."""
    return ((velocity or Velocity()).filter * (position or Filter())).sections


def dividing_periods(sections: tuple[Section, ...]) -> list[float] | None:
    """The sampling periods, longest first, that divide all windows in s; None without one."""
    windows = [own for section in sections if (own := getattr(section, "window", None))]
    if not windows:
        return None

    def divides(period: float) -> bool:
        try:
            return all(_whole_samples(window, period) for window in windows)
        except ValueError:
            return False

    return [*filter(divides, (windows[0] / n for n in range(1, LONGEST_WINDOW + 1)))]


def _whole_samples(window: float | None, sample_time: Numbers) -> int:
    if is_traced(sample_time):
        raise TypeError("sample_time is traced beside a window in s; give the window in samples.")
    window = window or 0.0
    samples = window / float(sample_time)
    if samples > LONGEST_WINDOW + 0.5:  # or infinite
        raise ValueError(
            f"window is {window:g} s, {samples:g} sampling periods; give {LONGEST_WINDOW} of "
            "them at most."
        )
    nearest = round(samples)
    if abs(samples - nearest) > 1e-9 * samples:
        below, above = floor(samples), floor(samples) + 1
        choice = " or ".join(
            f"{k * sample_time:g} s ({k} sample{'s' if k > 1 else ''})" for k in (below, above) if k
        )
        raise ValueError(
            f"window is {window:g} s, {samples:g} sampling periods; give a whole number of them: "
            f"{choice}."
        )
    return checked_count("the window in samples", nearest, 1, LONGEST_WINDOW)


# Above the classes, for under ``python -OO`` a dataclass shows its defaults while it is made.


def _filter_call(section: Section) -> str:
    if section.maker is None:
        return f"{_call(f'Velocity.{section.estimator}', section)}.filter"
    return _call(f"Filter.{section.maker}", section)


def _call(maker: str, section: Section) -> str:
    given = {key: value for key, value in vars(section).items() if value is not None}
    period = given.pop("period", 1.0)
    call = call_text(maker, given)
    return f"{call}.per_sample({period!r})" if is_jax(period) or period != 1.0 else call


@pytree
@dataclass(frozen=True, repr=False)
class Filter:
    """A linear filter of the sampled position: a chain of sections, in the order of the product.

    Make one with ``average``, ``low_pass``, ``butterworth``, ``exponential`` or
    ``transfer_function``; ``*`` chains filters. All have gain 1 at z = 1, except a transfer
    function, whose gain follows from its coefficients.

    Raises, of all methods: see ``jaxstab.conventions``; they say what they refuse beside it.

    Example:
        >>> str(jaxstab.Filter.low_pass(100.0) * jaxstab.Filter.average(samples=4))
        'a low pass at 100 Hz of order 1, a window of 4 samples'
        >>> print(jaxstab.Filter.exponential(0.9) * jaxstab.Filter.low_pass(100.0).per_sample(1e-3))
        exponential smoothing by 0.9, a low pass at 0.1 Hz of order 1
        >>> print(jaxstab.Filter.butterworth(300.0, order=2))
        a Butterworth filter at 300 Hz of order 2
        >>> print(jaxstab.Filter.transfer_function([0.5, 0.5], [1.0, 0.0]))
        a transfer function of order 1
    """

    sections: tuple[Section, ...] = ()

    @classmethod
    def average(cls, samples: int | None = None, *, window: float | None = None) -> "Filter":
        """The mean of the last samples: (1 + 1/z + ... + z^(1-n)) / n.

        Args:
            samples: n, from 1 to 200.
            window: n times the sampling period, in s, in place of ``samples``.

        Raises: TypeError also if not exactly one is given. A window that is not a whole number of
        samples is refused where the sampling period is known.
        """
        if (samples is None) == (window is None):
            raise TypeError("give samples or window, and not both.")
        if samples is not None:
            samples = checked_count("samples", samples, 1, LONGEST_WINDOW)
        if window is not None:
            window = checked_number("window", window, 0.0, is_open=True, unit="s")
        return cls((Average(samples, window),))

    @classmethod
    def low_pass(cls, cutoff: Numbers, *, order: int = 1) -> "Filter":
        """First-order low passes in a row, each ((1 - q) z / (z - q)), q = exp(-2 pi f T).

        The cut-off f is in Hz; there are from 1 to 40 of them. q is rounded to float64, as it is in
        the software that runs the filter; proofs and error bounds are for this q.
        """
        order = checked_count("order", order, 1, HIGHEST_ORDER)
        return cls((LowPass(_positive("cutoff", cutoff), order),))

    @classmethod
    def butterworth(cls, cutoff: Numbers, *, order: int) -> "Filter":
        """Butterworth's low pass by the bilinear transform, its cut-off prewarped.

        The cut-off is in Hz, below half of the sampling rate, the order from 1 to 40.

        Raises: ValueError also for a cut-off above half of the sampling rate, where that is known.

        Source: Butterworth (1930); the transfer function is that of ``scipy.signal.butter``.
        """
        order = checked_count("order", order, 1, HIGHEST_ORDER)
        return cls((Butterworth(_positive("cutoff", cutoff), order),))

    @classmethod
    def exponential(cls, factor: Numbers) -> "Filter":
        """Exponential smoothing: y_k = y_(k-1) + factor (x_k - y_(k-1)).

        The factor is in [2^-53, 1], so that 1 - factor is below 1 in float64; 1 filters nothing.
        """
        return cls((Exponential(_positive("factor", factor, 2.0**-53, 1.0)),))

    @classmethod
    def transfer_function(
        cls, numerator: Sequence[float], denominator: Sequence[float]
    ) -> "Filter":
        """A filter by its transfer function in z.

        Args:
            numerator: coefficients, highest power of z first.
            denominator: the same; of a higher degree than the numerator or of the same.

        Raises: ValueError also if the filter is not proper, not stable, zero, or of an order above
        40.
        """
        return cls((TransferSection(*_checked_rational(numerator, denominator)),))

    def __mul__(self, other: "Filter") -> "Filter":
        if not isinstance(other, Filter):
            return NotImplemented
        return Filter(self.sections + other.sections)

    def __repr__(self) -> str:
        return " * ".join(map(_filter_call, self.sections)) or "Filter()"

    def __str__(self) -> str:
        return ", ".join(map(str, self.sections)) or "no filter"

    def per_sample(self, sample_time: Numbers) -> "Filter":
        """The filter in units of a sampling period in s, as five-number functions take it.

        Raises: ValueError if a section is incompatible with the sampling period; TypeError if the
        period is traced, and a window is given in s.
        """
        return Filter(tuple(section.per_sample(sample_time) for section in self.sections))

    def checked(self, sample_time: Numbers = 1.0) -> "Filter":
        """The filter in units of a sampling period, as ``per_sample``, if it is not too long.

        Raises: as ``per_sample``; see ``jaxstab.conventions``; ValueError also for too many poles
        or samples.

        Example:
            >>> print(jaxstab.Filter.average(window=0.004).checked(1e-3))
            a window of 4 samples
        """
        require_x64(*(value for section in self.sections for value in vars(section).values()))
        chain = self.per_sample(sample_time)
        stages = [stage for section in chain.sections for stage in section.stages()]
        above, below = (sum(len(stage[side]) - 1 for stage in stages) for side in (0, 1))
        if below > HIGHEST_ORDER or above - below > LONGEST_WINDOW:
            raise ValueError(
                f"the filter ({self}) is of order {max(above, below)}; give {HIGHEST_ORDER} poles "
                f"at most, and windows of {LONGEST_WINDOW} samples in all."
            )
        if not is_any_jax(chain):
            exact_chain(chain.sections)  # refuses coefficients beyond float64
        return chain

    def stages(self, sample_time: Numbers = 1.0) -> list[Stage]:
        """The filters of low orders, one after the other, in float64; errors as ``checked``."""
        stages = [stage for s in self.checked(sample_time).sections for stage in s.stages()]
        return [(_floats(above), _floats(below)) for above, below in stages]


@pytree
@dataclass(frozen=True, repr=False)
class Velocity:
    """A velocity estimator, from sampled positions: (1 - 1/z)/T, then a filter.

    Make one with ``difference``, ``low_pass``, ``butterworth``, ``exponential``, ``kalman``,
    ``savitzky_golay``, ``transfer_function`` or, without positions, ``measured``; multiply by a
    ``Filter`` to smooth it further.

    Raises, of all methods: see ``jaxstab.conventions``; they say what they refuse beside it.

    Example:
        >>> str(jaxstab.Velocity.difference(samples=20) * jaxstab.Filter.low_pass(100.0))
        'the difference over a window of 20 samples, a low pass at 100 Hz of order 1'
        >>> print(jaxstab.Velocity.difference(window=0.02).per_sample(1e-3))
        the difference over a window of 20 samples
        >>> print(jaxstab.Velocity.butterworth(100.0, order=2))
        the difference over one sample, a Butterworth filter at 100 Hz of order 2
        >>> print(jaxstab.Velocity.exponential(0.9))
        the difference over one sample, exponential smoothing by 0.9
        >>> print(jaxstab.Velocity.kalman(q=100.0, r=1e-10))
        a Kalman filter with q = 100 and r = 1e-10
        >>> print(jaxstab.Velocity.savitzky_golay(9, order=2))
        the slope of a polynomial of order 2 through 9 samples
        >>> print(jaxstab.Velocity.transfer_function([500.0, -500.0], [1.0, 0.0]))
        a transfer function of order 1
        >>> jaxstab.Velocity.measured() * jaxstab.Filter.low_pass(100.0)
        Velocity.measured() * Filter.low_pass(cutoff=100.0, order=1)
    """

    filter: Filter = Filter()

    @classmethod
    def difference(cls, samples: int | None = None, *, window: float | None = None) -> "Velocity":
        """The difference over a window: (x_k - x_(k-n)) / (n T).

        The window is n from 1 to 200 ``samples``, or n T in s; the wall of the paper has n = 1,
        CHAI3D 15 ms.

        Raises: as ``Filter.average``.
        """
        return cls(Filter.average(samples, window=window))

    @classmethod
    def low_pass(cls, cutoff: Numbers, *, order: int = 1) -> "Velocity":
        """The one-sample difference behind first-order low passes: ``Filter.low_pass``."""
        return cls(Filter.low_pass(cutoff, order=order))

    @classmethod
    def butterworth(cls, cutoff: Numbers, *, order: int) -> "Velocity":
        """The one-sample difference behind Butterworth's filter: ``Filter.butterworth``."""
        return cls(Filter.butterworth(cutoff, order=order))

    @classmethod
    def exponential(cls, factor: Numbers) -> "Velocity":
        """The one-sample difference, smoothed: ``Filter.exponential``."""
        return cls(Filter.exponential(factor))

    @classmethod
    def kalman(cls, q: Numbers, r: Numbers) -> "Velocity":
        """The velocity of a Kalman filter of positions, at its steady gain.

        The device is taken for a free mass whose acceleration is noise, constant within a sample.

        Args:
            q: the variance of the acceleration in (m/s^2)^2, > 0; rad in place of m for joints.
            r: the variance of a measured position in m^2, > 0.

        Raises: ValueError also where the sampling period is known and the gain is 0 or 1 in
        float64.

        Source: Kalata, The tracking index (IEEE Trans. AES, 1984).
        """
        return cls(Filter((Kalman(_positive("q", q), _positive("r", r)),)))

    @classmethod
    def savitzky_golay(cls, samples: int, *, order: int) -> "Velocity":
        """The slope of the polynomial that fits the last samples best, at the newest of them.

        The order is from 1 to one less than the samples, of which there are from 2 to 200; order 1
        is the slope of a straight line, 2 samples are the difference.

        Source: Savitzky and Golay, Analytical Chemistry (1964); the weights are those of
        ``scipy.signal.savgol_coeffs(samples, order, deriv=1, pos=samples - 1)``.
        """
        samples = checked_count("samples", samples, 2, LONGEST_WINDOW)
        order = checked_count("order", order, 1, min(samples - 1, HIGHEST_POLYNOMIAL))
        return cls(Filter((SavitzkyGolay(samples, order),)))

    @classmethod
    def transfer_function(
        cls, numerator: Sequence[float], denominator: Sequence[float]
    ) -> "Velocity":
        """An estimator by its transfer function V(z) in 1/s; as ``Filter.transfer_function``.

        The numerator's sum is 0 up to rounding, for a velocity is 0 at rest; its last coefficient
        counts as minus the sum of the others.

        Raises: as ``Filter.transfer_function``; ValueError also if V(1) is not 0.
        """
        above, below = _checked_rational(numerator, denominator)
        total, size = abs(float(sum(map(Fraction, above)))), sum(map(abs, above))
        if len(above) < 2 or total > 2.0**-51 * len(above) * size:  # two units per coefficient
            raise ValueError(
                f"numerator is {list(above)}: its sum, V(1) in z, is {total:.3g}, but a "
                "velocity is 0 at rest; give one whose coefficients sum to 0."
            )
        return cls(Filter((Differentiator(above, below),)))

    @classmethod
    def measured(cls) -> "Velocity":
        """The second output of ``Device.simulated``, or of a ``Device.discrete`` that has one."""
        return cls(Filter((Measured(),)))

    def per_sample(self, sample_time: Numbers) -> "Velocity":
        """Return the estimator in units of a sampling period: ``Filter.per_sample``."""
        return Velocity(self.filter.per_sample(sample_time))

    def stages(self, sample_time: Numbers = 1.0) -> tuple[int, list[Stage]]:
        """A number of samples n, and filters of low orders behind (1 - z^-n) / n, in float64."""
        section, *others = self.filter.per_sample(sample_time).sections or (Average(1, None),)
        if isinstance(section, Average):
            return section.length, Filter(tuple(others)).stages()
        return 1, self.filter.stages(sample_time)

    def __mul__(self, other: Filter) -> "Velocity":
        if not isinstance(other, Filter):
            return NotImplemented
        return Velocity(self.filter * other)

    def __repr__(self) -> str:
        call, sections = "Velocity()", self.filter.sections  # the difference over one sample
        if sections and sections[0].estimator:
            call, sections = _call(f"Velocity.{sections[0].estimator}", sections[0]), sections[1:]
        return " * ".join([call, *map(_filter_call, sections)])

    def __str__(self) -> str:
        section, *others = self.filter.sections or (Average(1, None),)
        if isinstance(section, Average):
            return ", ".join([f"the difference over {section}", *map(str, others)])
        if isinstance(section, Differentiator) or section.maker is None:
            return str(self.filter)
        return f"the difference over one sample, {self.filter}"


def with_number(velocity: Velocity, quantity: str, value: float) -> Velocity:
    """An estimator with another "cutoff" in Hz, or with another "window" in samples.

    Raises: ValueError unless one section has such a number.
    """
    sections: list[Any] = list(velocity.filter.sections)
    kinds: Any = LOW_PASSES if quantity == "cutoff" else Average
    places = [k for k, section in enumerate(sections) if isinstance(section, kinds)]
    if not places and quantity == "window" and all(section.maker for section in sections):
        sections, places = [Average(1, None), *sections], [0]  # the difference over one sample
    if len(places) != 1:
        one = {"cutoff": "low_pass(100.0) (--cutoff 100)"}
        call = one.get(quantity, "difference(5) (--window-samples 5)")
        raise ValueError(
            f"quantity is {quantity!r}, but the velocity ({velocity}) has {len(places)} of it; "
            f"give an estimator with one, such as jaxstab.Velocity.{call}."
        )
    (place,) = places
    is_cutoff = quantity == "cutoff"
    other = replace(sections[place], cutoff=value) if is_cutoff else Average(int(value), None)
    sections[place] = other
    return Velocity(Filter(tuple(sections)))


def behind_measured(velocity: Velocity) -> Filter | None:
    """The filter of the device's own velocity; None for one from positions."""
    sections = velocity.filter.sections
    return Filter(sections[1:]) if sections[:1] == (Measured(),) else None


def filter_on(velocity: Velocity, *mechanisms: Any) -> Filter:
    """The filter of positions, or of the velocities that all devices must have: ValueError."""
    behind = behind_measured(velocity)
    if behind is not None and not all(getattr(x, "has_velocity", False) for x in mechanisms):
        raise ValueError(
            "velocity is measured, but the device has no velocity output, as Device.simulated "
            "and Device.discrete with two outputs have; give another estimator."
        )
    return velocity.filter if behind is None else behind


Filters = tuple[Velocity, Filter]

NO_FILTERS: Filters = Velocity(), Filter()

"""The difference over one sample, and no position filter: the wall of the paper."""


def given_filters(velocity: Any, position: Any) -> Filters | None:
    """The estimator and the filter of a loop, checked; None for the one-sample difference alone."""
    if velocity is None and position is None:
        return None
    for name, value, kind in (("velocity", velocity, Velocity), ("position", position, Filter)):
        if value is not None:
            require_kind(name, value, kind)
    velocity, position = velocity or Velocity(), position or Filter()
    is_plain = velocity in (Velocity(), Velocity.difference(samples=1)) and position == Filter()
    return None if is_plain else (velocity, position)


def known_filters(velocity: Any, position: Any) -> Filters | None:
    """The same as ``given_filters``, in plain numbers; TypeError if JAX traces them."""
    filters = given_filters(velocity, position)
    if is_any_traced(filters):
        raise TypeError(
            f"velocity is {filters[0]} and position {filters[1]}, with parameters that JAX "  # type: ignore[index]
            "traces; give numbers."
        )
    return tree_map(lambda value: float(value) if is_jax(value) else value, filters)


def as_keywords(filters: Filters | None) -> dict[str, Any]:
    """Return filters as keywords of the five-number functions."""
    return dict(zip(("velocity", "position"), filters or (None, None), strict=True))


# --------------------------------------------------------------------------------------- checks
def _positive(name: str, value: Numbers, low: float = 0.0, high: float = inf) -> Numbers:
    if is_jax(value):
        return value
    return checked_number(name, value, low, high, is_open=low == 0.0)


def _checked_rational(
    numerator: Sequence[float], denominator: Sequence[float]
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    remedy = "a realisable filter is proper: give a denominator of at least the same degree"
    above, below = checked_sides(numerator, denominator, "z", 0, remedy)
    if not has_roots_inside(list(map(Fraction, below))):
        raise ValueError(
            f"denominator is {list(below)}: not all of its roots in z are inside the unit circle; "
            "give a stable filter, in powers of z, not of s or 1/z."
        )
    return above, below


def has_roots_inside(falling: Sequence[Any]) -> bool:
    """True if all roots are inside the unit circle, of exact numbers.

    The first |k| >= 1 says that the roots of what is left have a product of 1 or more.
    """
    return all(abs(k) < 1 for k in reflections(falling[::-1]))


def reflections(rising: Sequence[Any]) -> Iterator[Any]:
    """The k of a polynomial in exact numbers or balls, one a degree (Schur 1917, Cohn 1922)."""
    while len(rising) > 1:
        k = rising[0] / rising[-1]
        yield k
        rising = [a - k * b for a, b in zip(rising[1:], rising[-2::-1], strict=True)]
