"""The sections of filters, each as a chain of transfer functions.

A section in SI units (a window in s, a cut-off in Hz, a velocity in 1/s) becomes one in units of a
sampling period by ``per_sample``. Its chain consists of the lowest possible orders: the loop's
polynomial takes their product, while the time domain runs one after the other, which loses no
digits to poles close to each other.

The numbers that a section computes from its parameters, such as exp(-2 pi f T), are rounded to
float64 first: proofs hold for the filter that software with these numbers runs.

A new kind of section is a class here, with its transfer functions, its text and its keys of TOML,
and a maker beside the others in ``filters.py``. Files, pictures, proofs between two loops and
explorers take all kinds from the class.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import reduce
from itertools import accumulate
from math import floor, inf, pi
from typing import Any, ClassVar, NamedTuple

import numpy as np

from jaxstab.arrays import Array, Numbers, fixed, is_jax, is_traced, namespace, pytree
from jaxstab.model.double_double import DoubleDouble
from jaxstab.numbers import checked_count

# Transfer functions in z as quotients of polynomials, in pairs of float64.

Polynomial = tuple[DoubleDouble, ...]  # highest power of z first


class Transfer(NamedTuple):
    """z^-lag numerator(z) / denominator(z), the denominator monic.

    ``sizes`` bound the sums of the moduli of the coefficients of numerator and denominator. The
    coefficients' errors are below 2^-91 of them (lemma V8).
    """

    numerator: Polynomial
    denominator: Polynomial
    lag: int
    sizes: tuple[Array, Array]

    @classmethod
    def with_sizes(cls, numerator: Polynomial, denominator: Polynomial, lag: int) -> "Transfer":
        """Return a transfer function with its sizes."""
        return cls(numerator, denominator, lag, (size_of(numerator), size_of(denominator)))

    def times(self, other: "Transfer") -> "Transfer":
        """Return the product of two transfer functions."""
        return Transfer(
            product(self.numerator, other.numerator),
            product(self.denominator, other.denominator),
            self.lag + other.lag,
            (self.sizes[0] * other.sizes[0], self.sizes[1] * other.sizes[1]),
        )

    def scaled(self, factor: DoubleDouble) -> "Transfer":
        """Return a multiple."""
        numerator = tuple(coefficient * factor for coefficient in self.numerator)
        return self._replace(
            numerator=numerator, sizes=(self.sizes[0] * abs(factor.hi), self.sizes[1])
        )

    def values_at(self, z: float) -> tuple[DoubleDouble, DoubleDouble]:
        """Return numerator and denominator at z."""
        above, below = (reduce(lambda value, c: value * z + c, falling) for falling in self[:2])
        return above, below

    @property
    def order(self) -> int:
        """The number of its poles, those at z = 0 included."""
        return len(self.denominator) - 1 + max(self.lag, 0)


def product(a: Polynomial, b: Polynomial) -> Polynomial:
    """Return the product of two polynomials; those of windows have few terms that are not 0."""
    terms: list[list[DoubleDouble]] = [[] for _ in range(len(a) + len(b) - 1)]
    others = [(j, other) for j, other in enumerate(b) if not _is_zero(other)]
    for i, value in enumerate(a):
        for j, other in [] if _is_zero(value) else others:
            terms[i + j].append(value * other)
    if not all(terms):
        nothing = (a[0] * b[0]).scaled(0.0)  # of the shape of all
        terms = [column or [nothing] for column in terms]
    return tuple(reduce(DoubleDouble.__add__, column) for column in terms)


def _is_zero(value: DoubleDouble) -> bool:
    return type(value.hi) is float and value.hi == 0.0


def size_of(polynomial: Polynomial) -> Array:
    """Return the sum of the moduli of the coefficients."""
    return sum((abs(coefficient.hi) for coefficient in polynomial), 0.0)


ONE: Polynomial = (DoubleDouble(1.0, 0.0),)
UNIT = Transfer.with_sizes(ONE, ONE, 0)
HIGHEST_ORDER = 40  # poles of a filter, but for those at z = 0
LONGEST_WINDOW = 200  # samples
MOST_STAGES = 80  # factors of a filter's transfer function: lemma V8 counts them
_NYQUIST = 0.499  # of the sampling rate: a Butterworth filter ends at 0.5
_FASTEST = 100.0  # of the sampling rate: a pole that is 0 in float64 is refused
_WHOLE = 1e-9  # of a sample: windows closer to a whole number of samples are that number

Factor = tuple[list[Any], list[Any], int]

"""Numerator and denominator, lowest power of z first, and how often they are multiplied."""


class Section:
    """A kind of section: what all kinds have in common."""

    maker: ClassVar[str]
    """The method of ``Filter`` that makes one."""

    estimator: ClassVar[str | None] = None
    """The method of ``Velocity``, where a difference that begins with this section has one."""

    varies: ClassVar[bool] = True
    """Whether a number of it may run over an interval, as between two loops."""

    def per_sample(self, sample_time: Numbers) -> "Section":
        """Return the section in units of a sampling period in s; here one without units."""
        del sample_time
        return self

    def stages(self) -> list[Transfer]:
        """Return the transfer functions, in units of one sample, whose product this is."""
        raise NotImplementedError

    @property
    def longest_sample_time(self) -> float:
        """The longest sampling period in s with which the section is a filter in float64."""
        return inf

    @property
    def toml(self) -> dict[str, Any]:
        """The keys and values of TOML of a section in units of one sample."""
        return dict(vars(self))

    def ball_factors(self, ball: Callable[[Any], Any], period: Any, pi: Any) -> list[Factor]:
        """The factors of the transfer function in balls; ``ball`` returns that of a parameter."""
        raise NotImplementedError


@pytree
@dataclass(frozen=True)
class Average(Section):
    """The mean of the last samples of a window, given in samples or in seconds."""

    samples: int | None = fixed()
    window: float | None = fixed()

    maker: ClassVar[str] = "average"
    estimator: ClassVar[str] = "difference"
    varies: ClassVar[bool] = False

    def __str__(self) -> str:
        samples = f"{self.samples} sample{'' if self.samples == 1 else 's'}"
        window = f"{self.window:g} s" if self.samples is None else samples
        return f"a window of {window}"

    def per_sample(self, sample_time: Numbers) -> "Average":
        return Average(self.samples or _whole_samples(self.window, sample_time), None)

    @property
    def length(self) -> int:
        """The window of a section in units of one sample."""
        return self.samples or _whole_samples(self.window, 1.0)

    @property
    def toml(self) -> dict[str, Any]:
        return {"window_samples": self.length}

    def stages(self) -> list[Transfer]:
        count = self.length
        weight = DoubleDouble.of(1.0) / float(count)
        return [Transfer.with_sizes((weight,) * count, ONE, count - 1)]


@pytree
@dataclass(frozen=True)
class LowPass(Section):
    """First-order low passes in a row, each with its pole at exp(-2 pi f T)."""

    cutoff: Numbers
    order: int = fixed()

    kind: ClassVar[str] = "low-pass"
    maker: ClassVar[str] = "low_pass"
    estimator: ClassVar[str] = "low_pass"

    def __str__(self) -> str:
        return f"a low pass at {shown(self.cutoff)} Hz of order {self.order}"

    def per_sample(self, sample_time: Numbers) -> "LowPass":
        section = LowPass(self.cutoff * sample_time, self.order)
        pole = section.pole
        if not is_traced(pole) and not 0.0 < pole < 1.0:
            raise ValueError(
                f"cutoff is {shown(self.cutoff)}; with a sampling period of {shown(sample_time)} s "
                "it leaves no filter in float64: give one closer to 1 / period."
            )
        return section

    @property
    def pole(self) -> Array:
        """The pole of a section in units of one sample."""
        exponent = -2.0 * pi * self.cutoff
        return _float(namespace(exponent).exp(exponent))

    def stages(self) -> list[Transfer]:
        pole = self.pole
        gain = DoubleDouble.of(1.0) - pole
        stage = Transfer.with_sizes((gain,), (DoubleDouble.of(1.0), -DoubleDouble.of(pole)), -1)
        return [stage] * self.order

    @property
    def longest_sample_time(self) -> float:
        return _FASTEST / float(self.cutoff)

    def ball_factors(self, ball: Callable[[Any], Any], period: Any, pi: Any) -> list[Factor]:
        factor = 1 - (-2 * pi * (ball(self.cutoff) * period)).exp()
        return [(*_lag(factor), self.order)]


@pytree
@dataclass(frozen=True)
class Exponential(Section):
    """y_k = y_(k-1) + factor (x_k - y_(k-1))."""

    factor: Numbers

    maker: ClassVar[str] = "exponential"
    estimator: ClassVar[str] = "exponential"

    def __str__(self) -> str:
        return f"exponential smoothing by {shown(self.factor)}"

    def stages(self) -> list[Transfer]:
        factor = DoubleDouble.of(_float(self.factor))
        pole = DoubleDouble.of(1.0) - factor
        return [Transfer.with_sizes((factor,), (DoubleDouble.of(1.0), -pole), -1)]

    def ball_factors(self, ball: Callable[[Any], Any], period: Any, pi: Any) -> list[Factor]:
        del period, pi
        return [(*_lag(ball(self.factor)), 1)]


@pytree
@dataclass(frozen=True)
class Butterworth(Section):
    """The bilinear transform of Butterworth's low pass, with its cut-off prewarped."""

    cutoff: Numbers
    order: int = fixed()

    kind: ClassVar[str] = "butterworth"
    maker: ClassVar[str] = "butterworth"
    estimator: ClassVar[str] = "butterworth"

    def __str__(self) -> str:
        return f"a Butterworth filter at {shown(self.cutoff)} Hz of order {self.order}"

    def per_sample(self, sample_time: Numbers) -> "Butterworth":
        section = Butterworth(self.cutoff * sample_time, self.order)
        if not is_traced(section.cutoff) and section.cutoff >= 0.5:
            raise ValueError(
                f"cutoff is {shown(self.cutoff)}; give one below half of the sampling rate, "
                f"{0.5 / sample_time:g} Hz."
            )
        return section

    def stages(self) -> list[Transfer]:
        angle = pi * self.cutoff
        warped = _float(namespace(angle).tan(angle))
        sections = [
            _quadratic(warped, butterworth_sine(k, self.order)) for k in range(self.order // 2)
        ]
        if self.order % 2:
            sections.append(_bilinear_lag(warped))
        return sections

    @property
    def toml(self) -> dict[str, Any]:
        return {**vars(self), "kind": self.kind}

    @property
    def longest_sample_time(self) -> float:
        return _NYQUIST / float(self.cutoff)

    def ball_factors(self, ball: Callable[[Any], Any], period: Any, pi: Any) -> list[Factor]:
        w = (pi * (ball(self.cutoff) * period)).tan()
        factors: list[Factor] = []
        for k in range(self.order // 2):
            gain, turn = w * w, 2 * w * butterworth_sine(k, self.order)
            below = [gain + 1 - turn, 2 * (gain - 1), gain + 1 + turn]
            factors.append(([gain, 2 * gain, gain], below, 1))
        if self.order % 2:
            factors.append(([w, w], [w - 1, w + 1], 1))
        return factors


@pytree
@dataclass(frozen=True)
class Rational(Section):
    """A transfer function in z by its coefficients, highest power first."""

    numerator: tuple[float, ...] = fixed()
    denominator: tuple[float, ...] = fixed()

    maker: ClassVar[str] = "transfer_function"
    varies: ClassVar[bool] = False

    def __str__(self) -> str:
        return f"a transfer function of order {len(self.denominator) - 1}"

    def stages(self) -> list[Transfer]:
        return [_monic(tuple(map(DoubleDouble.of, self.numerator)), self.denominator)]

    @property
    def toml(self) -> dict[str, Any]:
        return {"numerator": list(self.numerator), "denominator": list(self.denominator)}


@pytree
@dataclass(frozen=True)
class Differentiator(Rational):
    """A transfer function V(z) with V(1) = 0, less one difference: period V(z) z / (z - 1)."""

    period: Numbers = 1.0

    estimator: ClassVar[str] = "transfer_function"

    def per_sample(self, sample_time: Numbers) -> "Differentiator":
        return replace(self, period=self.period * sample_time)

    def stages(self) -> list[Transfer]:
        steps = accumulate(map(DoubleDouble.of, self.numerator[:-1]), DoubleDouble.__add__)
        numerator = tuple(step * _float(self.period) for step in steps)
        transfer = _monic(numerator, self.denominator)
        return [transfer._replace(lag=transfer.lag - 1)]

    @property
    def toml(self) -> dict[str, Any]:
        numerator = [c * self.period for c in self.numerator]
        return {"numerator": numerator, "denominator": list(self.denominator)}


LOW_PASSES = (LowPass, Butterworth)  # by ``kind``, which a table gives beside the cut-off


def _lag(factor: Any) -> tuple[list[Any], list[Any]]:
    """Return y_k = y_(k-1) + factor (x_k - y_(k-1)) in powers of z, the lowest first."""
    return [0, factor], [factor - 1, 1]


def _quadratic(warped: Array, sine: float) -> Transfer:
    """Return w^2 / (s^2 + 2 w sine s + w^2) at s = (z - 1) / (z + 1)."""
    square = DoubleDouble.of(warped) * warped
    damping = (DoubleDouble.of(warped) * sine).scaled(2.0)
    leading = square + 1.0 + damping
    gain = square / leading
    middle = (square - 1.0).scaled(2.0) / leading
    return Transfer.with_sizes(
        (gain, gain.scaled(2.0), gain),
        (DoubleDouble.of(1.0), middle, (square + 1.0 - damping) / leading),
        0,
    )


def butterworth_sine(k: int, order: int) -> float:
    """Return the sine of the angle of a pair of poles of Butterworth's filter, rounded."""
    return float(np.sin(pi * (2 * k + 1) / (2 * order)))


def _bilinear_lag(warped: Array) -> Transfer:
    """Return w / (s + w) at s = (z - 1) / (z + 1)."""
    width = DoubleDouble.of(warped)
    gain, last = width / (width + 1.0), (width - 1.0) / (width + 1.0)
    return Transfer.with_sizes((gain, gain), (DoubleDouble.of(1.0), last), 0)


def _monic(numerator: Polynomial, denominator: tuple[float, ...]) -> Transfer:
    """Return a quotient of polynomials, powers of z taken out of both."""
    zeros = next(k for k, c in enumerate(reversed(numerator)) if c.hi != 0.0)
    poles = next(k for k, c in enumerate(reversed(denominator)) if c != 0.0)
    leading = denominator[0]
    above = tuple(c / leading for c in numerator[: len(numerator) - zeros])
    below = tuple(DoubleDouble.of(c) / leading for c in denominator[: len(denominator) - poles])
    return Transfer.with_sizes(above, below, poles - zeros)


def _float(value: Numbers) -> Array:
    """Return a JAX value as it is, and any other number as a Python float."""
    return value if is_jax(value) else float(value)


def shown(value: Numbers) -> str:
    """Return a number as a person would write it."""
    return "a traced value" if is_traced(value) else f"{float(value):g}"


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
    if abs(samples - nearest) > _WHOLE * samples:
        below, above = floor(samples), floor(samples) + 1
        choice = " or ".join(
            f"{k * sample_time:g} s ({k} sample{'s' if k > 1 else ''})" for k in (below, above) if k
        )
        raise ValueError(
            f"window is {window:g} s, {samples:g} sampling periods; give a whole number of them: "
            f"{choice}."
        )
    return checked_count("the window in samples", nearest, 1, LONGEST_WINDOW)
