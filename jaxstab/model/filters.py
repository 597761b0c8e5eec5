"""Velocity estimators and position filters, which real controllers put before the wall."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from fractions import Fraction
from functools import reduce
from math import inf
from typing import Any, ClassVar

from jaxstab.arrays import Numbers, is_any_traced, is_jax, pytree, tree_map
from jaxstab.model.sections import (
    HIGHEST_ORDER,
    LONGEST_WINDOW,
    LOW_PASSES,
    MOST_STAGES,
    UNIT,
    Average,
    Butterworth,
    Differentiator,
    Exponential,
    LowPass,
    Rational,
    Section,
    Transfer,
)
from jaxstab.numbers import checked_count, checked_number, require_x64
from jaxstab.shown import call_text
from jaxstab.tables import Table, coefficients, key, one_of, quantity, share, whole

_LEAST_FACTOR = 2.0**-53  # of exponential smoothing
_ZERO_SUM = 4.0 * 2.0**-53  # of the numerator's size, per coefficient: V(1) as good as zero


@pytree
@dataclass(frozen=True, repr=False)
class Filter:
    """A linear filter of the sampled position: a chain of sections, in the order of the product.

    Make one with ``average``, ``low_pass``, ``butterworth``, ``exponential`` or
    ``transfer_function``; ``*`` chains filters. All have gain 1 at z = 1, except a transfer
    function, whose gain follows from its coefficients.

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

        Raises: see ``jaxstab.conventions``; TypeError also if not exactly one is given. A window
        that is not a whole number of samples is refused where the sampling period is known.
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

        The cut-off f is in Hz; there are from 1 to 40 of them.

        Raises: see ``jaxstab.conventions``.
        """
        return cls((LowPass(_positive("cutoff", cutoff), _checked_order(order)),))

    @classmethod
    def butterworth(cls, cutoff: Numbers, *, order: int) -> "Filter":
        """Butterworth's low pass by the bilinear transform, its cut-off prewarped.

        The cut-off is in Hz, below half of the sampling rate, the order from 1 to 40.

        Raises: see ``jaxstab.conventions``; ValueError also for a cut-off above half of the
        sampling rate, where that is known.

        Source: Butterworth (1930); the transfer function is that of ``scipy.signal.butter``.
        """
        return cls((Butterworth(_positive("cutoff", cutoff), _checked_order(order)),))

    @classmethod
    def exponential(cls, factor: Numbers) -> "Filter":
        """Exponential smoothing: y_k = y_(k-1) + factor (x_k - y_(k-1)).

        The factor is in [2^-53, 1], so that 1 - factor is below 1 in float64; 1 filters nothing.

        Raises: see ``jaxstab.conventions``.
        """
        return cls((Exponential(_positive("factor", factor, _LEAST_FACTOR, 1.0)),))

    @classmethod
    def transfer_function(
        cls, numerator: Sequence[float], denominator: Sequence[float]
    ) -> "Filter":
        """A filter by its transfer function in z.

        Args:
            numerator: coefficients, highest power of z first.
            denominator: the same; of a higher degree than the numerator or of the same.

        Raises: see ``jaxstab.conventions``; ValueError also if the filter is not proper, not
        stable, zero, or of an order above 40.
        """
        return cls((Rational(*_checked_rational(numerator, denominator)),))

    def __mul__(self, other: "Filter") -> "Filter":
        if not isinstance(other, Filter):
            return NotImplemented
        return Filter(self.sections + other.sections)

    def __repr__(self) -> str:
        return " * ".join(_filter_calls(self.sections)) or "Filter()"

    def __str__(self) -> str:
        return ", ".join(map(str, self.sections)) or "no filter"

    def per_sample(self, sample_time: Numbers) -> "Filter":
        """The filter in units of a sampling period in s, as five-number functions take it.

        Raises: ValueError if a section is incompatible with the sampling period; TypeError if the
        period is traced, and a window is given in s.
        """
        return Filter(tuple(section.per_sample(sample_time) for section in self.sections))

    def transfer(self, sample_time: Numbers = 1.0) -> Transfer:
        """The transfer function for a sampling period in s.

        Raises: see ``jaxstab.conventions``; ValueError also if a section is incompatible with the
        sampling period, or there are too many poles, samples or stages.
        """
        stages = self.stages(sample_time)
        if len(stages) > MOST_STAGES:
            raise ValueError(f"the filter has {len(stages)} stages; give {MOST_STAGES} at most.")
        whole = reduce(Transfer.times, stages, UNIT)
        if len(whole.denominator) - 1 > HIGHEST_ORDER or whole.lag > LONGEST_WINDOW:
            raise ValueError(
                f"the filter ({self}) is of order {whole.order}; give {HIGHEST_ORDER} poles at "
                f"most, and windows of {LONGEST_WINDOW} samples in all."
            )
        return whole

    def stages(self, sample_time: Numbers = 1.0) -> list[Transfer]:
        """The transfer functions of low orders whose product ``transfer`` is; errors as there."""
        require_x64(*(value for section in self.sections for value in vars(section).values()))
        sections = self.per_sample(sample_time).sections
        return [stage for section in sections for stage in section.stages()]


@pytree
@dataclass(frozen=True, repr=False)
class Velocity:
    """A velocity estimator, from sampled positions: (1 - 1/z)/T, then a filter.

    Make one with ``difference``, ``low_pass``, ``butterworth``, ``exponential`` or
    ``transfer_function``; multiply by a ``Filter`` to smooth it further.

    Example:
        >>> str(jaxstab.Velocity.difference(samples=20) * jaxstab.Filter.low_pass(100.0))
        'the difference over a window of 20 samples, a low pass at 100 Hz of order 1'
        >>> print(jaxstab.Velocity.difference(window=0.02).per_sample(1e-3))
        the difference over a window of 20 samples
        >>> print(jaxstab.Velocity.butterworth(100.0, order=2))
        the difference over one sample, a Butterworth filter at 100 Hz of order 2
        >>> print(jaxstab.Velocity.exponential(0.9))
        the difference over one sample, exponential smoothing by 0.9
        >>> print(jaxstab.Velocity.transfer_function([500.0, -500.0], [1.0, 0.0]))
        a transfer function of order 1
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
    def transfer_function(
        cls, numerator: Sequence[float], denominator: Sequence[float]
    ) -> "Velocity":
        """An estimator by its transfer function V(z) in 1/s; as ``Filter.transfer_function``.

        The numerator's sum is 0 up to rounding, for a velocity is 0 at rest; its last coefficient
        counts as minus the sum of the others.

        Raises: as ``Filter.transfer_function``; ValueError also if V(1) is not 0.
        """
        above, below = _checked_rational(numerator, denominator)
        total = abs(float(sum(map(Fraction, above))))
        if len(above) < 2 or total > _ZERO_SUM * len(above) * sum(map(abs, above)):
            raise ValueError(
                f"numerator is {list(above)}: its sum, V(1) in z, is {total:.3g}, but a "
                "velocity is 0 at rest; give one whose coefficients sum to 0."
            )
        return cls(Filter((Differentiator(above, below),)))

    def per_sample(self, sample_time: Numbers) -> "Velocity":
        """Return the estimator in units of a sampling period: ``Filter.per_sample``."""
        return Velocity(self.filter.per_sample(sample_time))

    def stages(self, sample_time: Numbers = 1.0) -> tuple[int, list[Transfer]]:
        """A number of samples n, and transfer functions behind (1 - z^-n) / n."""
        section, *others = self.filter.per_sample(sample_time).sections or (Average(1, None),)
        if isinstance(section, Average):
            return section.length, Filter(tuple(others)).stages()
        return 1, self.filter.stages(sample_time)

    def __mul__(self, other: Filter) -> "Velocity":
        if not isinstance(other, Filter):
            return NotImplemented
        return Velocity(self.filter * other)

    def __repr__(self) -> str:
        sections = self.filter.sections
        maker = sections[0].estimator if sections else None
        if maker is None:  # the difference over one sample
            return " * ".join(["Velocity()", *_filter_calls(sections)])
        call = _call(f"Velocity.{maker}", sections[0])
        return " * ".join([call, *_filter_calls(sections[1:])])

    def __str__(self) -> str:
        section, *others = self.filter.sections or (Average(1, None),)
        if isinstance(section, Average):
            return ", ".join([f"the difference over {section}", *map(str, others)])
        if isinstance(section, Differentiator):
            return str(self.filter)
        return f"the difference over one sample, {self.filter}"


Filters = tuple[Velocity, Filter]


def given_filters(velocity: Any, position: Any) -> Filters | None:
    """The estimator and the filter of a loop, checked; None for the one-sample difference alone."""
    if velocity is None and position is None:
        return None
    for name, value, kind in (("velocity", velocity, Velocity), ("position", position, Filter)):
        if value is not None and not isinstance(value, kind):
            raise TypeError(f"{name} is {value!r}; give a jaxstab.{kind.__name__}.")
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
    velocity, position = filters or (None, None)
    return {"velocity": velocity, "position": position}


# --------------------------------------------------------------------------------------- checks
def _filter_calls(sections: Sequence[Section]) -> list[str]:
    return [_call(f"Filter.{section.maker}", section) for section in sections]


def _call(maker: str, section: Section) -> str:
    """Return the call that makes a filter, or an estimator, of one section."""
    given = {key: value for key, value in vars(section).items() if value is not None}
    period = given.pop("period", 1.0)
    call = call_text(maker, given)
    return f"{call}.per_sample({period!r})" if is_jax(period) or period != 1.0 else call


def _positive(name: str, value: Numbers, low: float = 0.0, high: float = inf) -> Numbers:
    if is_jax(value):
        return value
    return checked_number(name, value, low, high, is_open=low == 0.0)


def _checked_order(order: int) -> int:
    return checked_count("order", order, 1, HIGHEST_ORDER)


def _checked_rational(
    numerator: Sequence[float], denominator: Sequence[float]
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    above, below = _coefficients("numerator", numerator), _coefficients("denominator", denominator)
    if len(above) > len(below):
        raise ValueError(
            f"numerator has degree {len(above) - 1} in z and denominator {len(below) - 1}; a "
            "realisable filter is proper: give a denominator of at least the same degree."
        )
    if len(below) - 1 > HIGHEST_ORDER:
        raise ValueError(f"denominator has degree {len(below) - 1}; give {HIGHEST_ORDER} at most.")
    if not _has_roots_inside(below):
        raise ValueError(
            f"denominator is {list(below)}: not all of its roots in z are inside the unit circle; "
            "give a stable filter, in powers of z, not of s or 1/z."
        )
    return above, below


def _coefficients(name: str, values: Sequence[float]) -> tuple[float, ...]:
    numbers = [checked_number(name, value) for value in values]
    while numbers and numbers[0] == 0.0:
        numbers.pop(0)
    if not numbers:
        raise ValueError(f"{name} is {list(values)}; give at least one coefficient that is not 0.")
    return tuple(numbers)


def _has_roots_inside(denominator: tuple[float, ...]) -> bool:
    """Tell exactly whether all roots are inside the unit circle (Schur 1917, Cohn 1922)."""
    falling = list(map(Fraction, denominator))
    while len(falling) > 1:
        ratio = falling[-1] / falling[0]
        if abs(ratio) >= 1:
            return False
        falling = [a - ratio * b for a, b in zip(falling[:-1], falling[:0:-1], strict=True)]
    return True


# A velocity estimator or a position filter as a table of a file. No JAX.
#
# Scenes and atlases have the same keys; they differ in the unit of the cut-off, and a scene may
# give its window in s as well:
#
#     window_samples = 20         the difference (of a position filter: the mean) over 20 samples
#     cutoff = 100.0              then a low pass at 100 Hz (an atlas: at a share of the rate)

_LOW_PASSES: Mapping[str, Callable[..., Filter]] = {
    section.kind: getattr(Filter, section.maker) for section in LOW_PASSES
}

NO_FILTER: Mapping[str, Any] = {
    "cutoff": 0.0,
    "order": 1,
    "kind": LowPass.kind,
    "factor": 1.0,
    "numerator": None,
    "denominator": None,
}
"""The keys of a table but for the window, with values that filter nothing."""

_BESIDE = ("order", "kind")  # keys of a low pass that need its cut-off
_FRACTION = ("numerator", "denominator")


@dataclass(frozen=True, kw_only=True)
class FilterTable(Table):
    """A window, a low pass and exponential smoothing in a row, or coefficients alone."""

    window_samples: int | None = key(whole(1, LONGEST_WINDOW), None)
    cutoff: float | None = key(quantity("Hz", is_positive=True), None)
    order: int | None = key(whole(1, HIGHEST_ORDER), None)
    kind: str | None = key(one_of(_LOW_PASSES), None)
    factor: float | None = key(share, None)
    numerator: tuple[float, ...] | None = key(coefficients, None)
    denominator: tuple[float, ...] | None = key(coefficients, None)

    names_besides: ClassVar[tuple[str, ...]] = ()
    """Keys that make no filter."""

    def __post_init__(self) -> None:
        super().__post_init__()
        given = [name for name in self._names() if getattr(self, name) is not None]
        for name in _BESIDE:
            if name in given and self.cutoff is None:
                raise ValueError(
                    f"{name} is {getattr(self, name)} without cutoff; give cutoff, too."
                )
        fraction = [name for name in given if name in _FRACTION]
        others = [name for name in given if name not in _FRACTION]
        if len(fraction) == 1:
            raise ValueError(f"{fraction[0]} is given alone; give numerator and denominator.")
        if fraction and others:
            raise ValueError(f"{others[0]} is given beside numerator; give one of them.")
        if not given:
            needed, *more = (name for name in self._names() if name not in (*_BESIDE, *_FRACTION))
            raise ValueError(
                f"{needed} is missing; give it, or {', '.join(more)}, or numerator and denominator."
            )

    def as_filter(self) -> Filter:
        """Return the filter of a position."""
        if self.numerator is not None and self.denominator is not None:
            return Filter.transfer_function(self.numerator, self.denominator)
        return (Filter.average(**self._length) if self._length else Filter()) * self._smoothing

    def as_velocity(self) -> Velocity:
        """Return the estimator of a velocity."""
        if self.numerator is not None and self.denominator is not None:
            return Velocity.transfer_function(self.numerator, self.denominator)
        start = Velocity.difference(**self._length) if self._length else Velocity()
        return start * self._smoothing

    @property
    def _length(self) -> dict[str, Any]:
        """The length of the window, in samples or in s; empty without one."""
        return {} if self.window_samples is None else {"samples": self.window_samples}

    @property
    def _smoothing(self) -> Filter:
        """What follows after the window."""
        chain = Filter()
        if self.cutoff is not None:
            chain *= _LOW_PASSES[self.kind or LowPass.kind](self.cutoff, order=self.order or 1)
        return chain if self.factor is None else chain * Filter.exponential(self.factor)

    @classmethod
    def _names(cls) -> list[str]:
        return [entry.name for entry in fields(cls) if entry.name not in cls.names_besides]


def below_one(value: Any) -> float:
    """Return a cut-off as a share of the sampling rate."""
    ratio: float = quantity("1", is_positive=True)(value)
    if ratio >= 1.0:
        raise ValueError("give it as a share of the sampling rate, below 1")
    return ratio


@dataclass(frozen=True, kw_only=True)
class SampledTable(FilterTable):
    """The same in units of one sample: the cut-off is a share of the sampling rate."""

    cutoff: float | None = key(below_one, None)
