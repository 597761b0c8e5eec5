"""The linear systems that describe devices and hands, each as an exact rational function of s.

Numbers that users give are float64 and therefore rational; a frequency in Hz brings a factor pi.
As pi is no root of a polynomial with rational coefficients, it is a second variable of the
polynomials, and common factors are found exactly: a state that cancels is removed, and refused if
it does not decay. ``balls_of`` evaluates the coefficients of such a polynomial in s in balls of any
precision. python-flint is imported only where such polynomials are needed.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache, lru_cache, wraps
from threading import RLock
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, TypeVar, cast

import numpy as np

from jaxstab.numbers import checked, checked_number
from jaxstab.shown import call_text

if TYPE_CHECKING:
    import flint as flint  # offered to the other files of balls
    from flint import arb, fmpq, fmpq_mpoly, fmpq_mpoly_ctx
else:

    class _Flint:
        """python-flint, imported by the first who asks something of it: few questions need it."""

        def __getattr__(self, name: str) -> Any:
            import flint

            setattr(self, name, getattr(flint, name))
            return getattr(self, name)

    flint = _Flint()

_PRECISION = RLock()
FIRST_BITS, MOST_BITS = 192, 192 << 4  # of the balls in which questions are asked
Answer = TypeVar("Answer")
Function = TypeVar("Function", bound=Callable[..., Any])


@contextmanager
def working_precision(bits: int) -> Iterator[None]:
    """Compute with balls of this precision, one thread at a time, and restore it afterwards.

    Power series have as many terms as they are made with.
    """
    # The precision of python-flint is one number of the whole process. Balls hold the true value at
    # any precision: threads of a program that set it meanwhile can cost an answer its digits, or
    # end it in an error, but cannot make it wrong.
    most_terms = 1 << 30
    with _PRECISION, flint.ctx.workprec(bits):
        before, flint.ctx.cap = flint.ctx.cap, most_terms
        try:
            yield
        finally:
            flint.ctx.cap = before


def decided(
    question: Callable[[], Answer],
    most: int = MOST_BITS,
    first: int = FIRST_BITS,
    is_answered: Callable[[Answer], bool] = lambda answer: answer is not None,
) -> Answer:
    """Ask with twice the bits again and again until it is answered, with the most bits at last.

    A ball is a midpoint and a radius; every operation returns a ball that holds all results for all
    numbers of its arguments (F. Johansson, Arb, 2017). So what is true of balls is true of the
    numbers, at any precision, and no rounding errors are estimated by hand.
    """
    bits = first
    while True:
        with working_precision(bits):
            answer = question()
        if bits >= most or is_answered(answer):
            return answer
        bits *= 2


def tiny(divisor: int) -> "arb":
    """2 to the power of minus the bits of balls over a divisor."""
    return flint.arb(2) ** -(flint.ctx.prec // divisor)


def remembered(count: int = 64) -> Callable[[Function], Function]:
    """Keep so many answers of a function in balls, each for the precision that was set."""

    def decorate(function: Function) -> Function:
        @lru_cache(maxsize=count)
        def of_bits(bits: int, *given: Any) -> Any:
            return function(*given)

        @wraps(function)
        def call(*given: Any) -> Any:
            return of_bits(flint.ctx.prec, *given)

        return cast(Function, call)

    return decorate


class Rational(NamedTuple):
    """A quotient of two polynomials in s and pi; the denominator is not 0."""

    numerator: "fmpq_mpoly"
    denominator: "fmpq_mpoly"

    def times(self, other: "Rational") -> "Rational":
        """Return the product."""
        return Rational(self.numerator * other.numerator, self.denominator * other.denominator)

    def minus(self, other: "Rational") -> "Rational":
        """Return the difference."""
        (a, b), (c, d) = self, other
        return Rational(a * d - c * b, b * d)

    def in_series(self, other: "Rational") -> "Rational":
        """Return 1 / (1/a + 1/b): two dynamic stiffnesses under the same force."""
        (a, b), (c, d) = self, other
        return Rational(a * c, a * d + c * b)

    def at_rest(self) -> tuple["fmpq_mpoly", "fmpq_mpoly"]:
        """Numerator and denominator at s = 0."""
        return self.numerator.subs({"s": 0}), self.denominator.subs({"s": 0})

    def reduced(self) -> tuple["Rational", "fmpq_mpoly"]:
        """Return the function without its common factor, and that factor; equals are equal then."""
        common = self.numerator.gcd(self.denominator)
        above, below = self.numerator / common, self.denominator / common
        leading = below.leading_coefficient()
        return Rational(above / leading, below / leading), common


Polynomial = Any
"""In s and pi, or its values: numbers, arrays or models over boxes."""


class Ports(NamedTuple):
    """The responses of encoder and handle to forces at the motor and at the handle.

    Each is a numerator over the same denominator ``below``: the encoder and the handle by the
    motor's force, both by the hand's, and the determinant of these four over ``below``, a
    polynomial, too. ``excess`` is None where motor, encoder and handle are one point: it is 0 then,
    and the four are one.
    """

    below: Polynomial
    encoder: Polynomial
    handle: Polynomial
    encoder_by_hand: Polynomial
    handle_by_hand: Polynomial
    excess: Polynomial | None = None

    @classmethod
    def at_one_point(cls, above: Polynomial, below: Polynomial) -> "Ports":
        """A device of which motor, encoder and handle are one point."""
        return cls(below, above, above, above, above)

    def beside(self, body: "tuple[Polynomial, Polynomial]", shapes: "Shapes") -> "Ports":
        """The device with another body or mode, whose displacement, above/below, adds up."""
        (above, below), (motor, encoder, handle) = body, shapes
        one = above * self.below
        excess = above * (
            self.encoder * (handle * handle)
            + self.handle_by_hand * (encoder * motor)
            - self.encoder_by_hand * (handle * motor)
            - self.handle * (encoder * handle)
        )
        return Ports(
            self.below * below,
            self.encoder * below + one * (encoder * motor),
            self.handle * below + one * (handle * motor),
            self.encoder_by_hand * below + one * (encoder * handle),
            self.handle_by_hand * below + one * (handle * handle),
            excess if self.excess is None else excess + self.excess * below,
        )

    def held_by(self, above: Polynomial, below: Polynomial) -> "Ports":
        """The device whose handle a dynamic stiffness above/below holds."""
        closed = self.below * below + self.handle_by_hand * above
        if self.excess is None:
            return Ports.at_one_point(self.encoder * below, closed)
        return Ports(
            closed,
            self.encoder * below + self.excess * above,
            self.handle * below,
            self.encoder_by_hand * below,
            self.handle_by_hand * below,
            self.excess * below,
        )

    def reduced(self) -> "Ports":
        """The same without the common factor of all, of polynomials.

        Two modes that are alike but for their shapes have one in all but the excess: it stays.
        """
        shared = self.below.gcd(self.encoder)
        if self.excess is None:
            return Ports.at_one_point(self.encoder / shared, self.below / shared)
        for above in self[2:]:
            shared = shared.gcd(above)
        return Ports(*(side / shared for side in self))


class Shapes(NamedTuple):
    """By how much a mode moves motor, encoder and handle for 1 of its coordinate."""

    motor: Any = 1.0
    encoder: Any = 1.0
    handle: Any = 1.0


def degree_of(polynomial: "fmpq_mpoly") -> int:
    """Return the degree in s, -1 for 0."""
    return int(polynomial.degrees()[0])


def rational(numerator: Sequence[float], denominator: Sequence[float]) -> Rational:
    """Return a function by the coefficients of its polynomials, highest power of s first."""
    return Rational(polynomial(numerator), polynomial(denominator))


def polynomial(falling: Sequence["float | fmpq"]) -> "fmpq_mpoly":
    """Return the polynomial with these coefficients, highest power of s first."""
    powers = range(len(falling) - 1, -1, -1)
    terms: dict[tuple[int, ...], Any] = {
        (power, 0): exact(value) for power, value in zip(powers, falling, strict=True)
    }
    return _ring().from_dict(terms)


def turn(hertz: float) -> "fmpq_mpoly":
    """Return 2 pi f for a frequency in Hz."""
    return 2 * exact(hertz) * _ring().gen(1)


def exact(value: Any) -> Any:
    """Return the rational number that a float64, or another exact number, is."""
    return value if isinstance(value, flint.fmpq) else flint.fmpq(*value.as_integer_ratio())


def balls_of(polynomial: "fmpq_mpoly") -> list["arb"]:
    """Return the coefficients of the powers of s, lowest first, in balls of the precision set."""
    coefficients = [flint.arb(0)] * (degree_of(polynomial) + 1)
    for (power, power_of_pi), factor in polynomial.to_dict().items():
        own = flint.arb(factor)
        coefficients[power] += own * flint.arb.pi() ** power_of_pi if power_of_pi else own
    return coefficients


@cache
def _ring() -> "fmpq_mpoly_ctx":
    return flint.fmpq_mpoly_ctx.get(("s", "pi"), "lex")


HIGHEST_ORDER = 40

Coefficients = Sequence[float] | Sequence[int] | np.ndarray[Any, np.dtype[Any]]


@dataclass(frozen=True, kw_only=True, repr=False)
class Mode:
    """A vibration mode as a modal analysis gives it.

    A force F at the motor moves the encoder by motor encoder F / (m s^2 + 2 zeta m w s + m w^2);
    the hand's force and its displacement are at the handle. Where all three are the same place, the
    shapes are 1; a mode of two bodies moves one of them by 1, the other one by -1 if they are
    alike.

    Args:
        frequency: w / (2 pi) in Hz, > 0.
        damping_ratio: zeta, >= 0; 0.01 is 1 % of critical damping.
        modal_mass: m in kg, of shapes as they are given. A negative one, of a mode that moves
            motor and encoder against each other, does not say where the hand is: none may be there.
        motor: the mode's shape at the motor.
        encoder: at the encoder.
        handle: where the hand is.

    Raises: see ``jaxstab.conventions``.

    Example:
        >>> jaxstab.Mode(frequency=80.0, damping_ratio=0.01, modal_mass=0.5)
        Mode(frequency=80.0, damping_ratio=0.01, modal_mass=0.5)
        >>> link = jaxstab.Mode(
        ...     frequency=35.0, damping_ratio=0.05, modal_mass=8e-4, encoder=-1.0, handle=-1.0
        ... )
        >>> device = jaxstab.Device.modes([link], mass=8e-4, damping=2e-3)
        >>> hand = jaxstab.Hand.mass_spring_damper(damping=0.005)
        >>> round(device.held_by(hand).static_stiffness(), 6)
        0.0
    """

    frequency: float
    damping_ratio: float
    modal_mass: float
    motor: float = 1.0
    encoder: float = 1.0
    handle: float = 1.0

    def __post_init__(self) -> None:
        numbers = {
            "frequency": checked_number("frequency", self.frequency, 0.0, is_open=True, unit="Hz"),
            "damping_ratio": checked_number("damping_ratio", self.damping_ratio, 0.0),
            "modal_mass": checked_number("modal_mass", self.modal_mass),
        }
        numbers |= {name: checked_number(name, getattr(self, name)) for name in Shapes._fields}
        for name, value in numbers.items():
            object.__setattr__(self, name, value)
        if self.modal_mass == 0.0:
            raise ValueError("modal_mass is 0.0; give the mass in kg that the mode moves.")

    @property
    def shapes(self) -> Shapes:
        """The shapes at motor, encoder and handle."""
        return Shapes(self.motor, self.encoder, self.handle)

    def response(self) -> Rational:
        """Return its coordinate over a force of shape 1."""
        mass, damping = exact(self.modal_mass), 2 * exact(self.damping_ratio)
        s, w = polynomial([1.0, 0.0]), turn(self.frequency)
        return Rational(polynomial([1.0]), mass * (s * s + damping * w * s + w * w))

    def __repr__(self) -> str:
        given = {name: v for name, v in vars(self).items() if name not in Shapes._fields or v != 1}
        return call_text("Mode", given)


class Part:
    """A linear system that ``Device`` or ``Hand`` has a maker for."""

    maker: ClassVar[str]

    def call(self, kind: str) -> str:
        """The call that makes a device or hand of it, without values of 0 or None."""
        given = {key: value for key, value in vars(self).items() if value not in (0.0, None)}
        return call_text(f"{kind}.{self.maker}", given)


@dataclass(frozen=True)
class MassSpringDamper(Part):
    """A mass in kg on a damper in N s/m and a spring in N/m, of a device or of arrays of loops."""

    maker = "mass_spring_damper"

    mass: Any
    damping: Any
    stiffness: Any

    def __str__(self) -> str:
        return _description(self.mass, self.damping, self.stiffness)

    def dynamic_stiffness(self) -> Rational:
        """Return force over displacement."""
        return rational([self.mass, self.damping, self.stiffness], [1.0])

    def ports(self) -> Ports:
        """Return displacement over force."""
        own = [self.mass, self.damping, self.stiffness]
        return Ports.at_one_point(polynomial([1.0]), polynomial(own))


@dataclass(frozen=True)
class Modes(Part):
    """The sum of a rigid body, where there is one, and of vibration modes."""

    maker = "modes"

    mass: float | None
    damping: float
    modes: tuple[Mode, ...]

    def __str__(self) -> str:
        body = [] if self.mass is None else [_description(self.mass, self.damping, 0.0)]
        return " with ".join(
            [*body, f"modes at {', '.join(f'{m.frequency:g}' for m in self.modes)} Hz"]
        )

    @property
    def has_shapes(self) -> bool:
        """True if motor, encoder and handle are not all one point."""
        return any(len({*mode.shapes}) > 1 for mode in self.modes)

    def ports(self) -> Ports:
        """The responses of the sum of body and modes to forces."""
        one, nothing = polynomial([1.0]), polynomial([0.0])
        parts = [(mode.response(), Shapes(*map(exact, mode.shapes))) for mode in self.modes]
        if self.mass is not None:
            parts.insert(0, (rational([1.0], [self.mass, self.damping, 0.0]), Shapes(1, 1, 1)))
        ports = Ports(one, nothing, nothing, nothing, nothing)
        for body, shapes in parts:
            ports = ports.beside(body, shapes)
        return ports if self.has_shapes else ports._replace(excess=None)


@dataclass(frozen=True)
class TransferFunction(Part):
    """A quotient of polynomials in s, highest power first."""

    maker = "transfer_function"

    numerator: tuple[float, ...]
    denominator: tuple[float, ...]

    def __str__(self) -> str:
        return f"a transfer function in s of order {len(self.denominator) - 1}"

    def dynamic_stiffness(self) -> Rational:
        """Return the function itself, of a hand."""
        return rational(self.numerator, self.denominator)

    def ports(self) -> Ports:
        """Return the function itself, of a device."""
        return Ports.at_one_point(*rational(self.numerator, self.denominator))


@dataclass(frozen=True)
class StateSpace(Part):
    """x' = A x + B u, the forces u at the motor and, if given, at the handle, and C x there."""

    maker = "state_space"

    a: tuple[tuple[float, ...], ...]
    b: tuple[tuple[float, ...], ...]
    c: tuple[tuple[float, ...], ...]

    def call(self, kind: str) -> str:
        """Return the call that makes a device of it."""
        return call_text(f"{kind}.{self.maker}", {"A": self.a, "B": self.b, "C": self.c})

    def __str__(self) -> str:
        return f"a state space of order {len(self.b)}"

    def ports(self) -> Ports:
        """Return C (s - A)^-1 B."""
        (encoder, *handle), (motor, *hand) = self.c, zip(*self.b, strict=True)
        below = self._characteristic()
        if not handle:
            return Ports.at_one_point(self._above(encoder, motor), below)
        pairs = [(c, b) for b in (motor, hand[0]) for c in (encoder, handle[0])]
        seen, moved, pushed, held = (self._above(c, b) for c, b in pairs)
        return Ports(below, seen, moved, pushed, held, (seen * held - moved * pushed) / below)

    def _above(self, c: tuple[float, ...], b: tuple[float, ...]) -> "fmpq_mpoly":
        """The numerator of c (s - A)^-1 b: det(s - A + b c), less det(s - A)."""
        return self._characteristic([[x * y for y in map(exact, c)] for x in map(exact, b)])

    def _characteristic(self, fed_back: "list[list[fmpq]] | None" = None) -> "fmpq_mpoly":
        """det(s - A), or what a feedback adds to it."""
        a = flint.fmpq_mat([[exact(value) for value in row] for row in self.a])
        plain = polynomial(a.charpoly().coeffs()[::-1])
        if fed_back is None:
            return plain
        return polynomial((a - flint.fmpq_mat(fed_back)).charpoly().coeffs()[::-1]) - plain


def _description(mass: float, damping: float, stiffness: float) -> str:
    terms = [f"{mass:g} kg", f"{damping:g} N s/m", f"{stiffness:g} N/m"]
    return ", ".join(term for term in terms if not term.startswith("0 ")) or "nothing"


# --------------------------------------------------------------------------------------- checks
def checked_sides(
    numerator: Coefficients, denominator: Coefficients, variable: str, excess: int, remedy: str
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Coefficients in s or z, the numerator's degree above the other by ``excess`` at most."""
    above = _coefficients("numerator", numerator, variable)
    below = _coefficients("denominator", denominator, variable)
    if len(above) - len(below) > excess:
        raise ValueError(
            f"numerator has degree {len(above) - 1} in {variable} and denominator "
            f"{len(below) - 1}; {remedy}."
        )
    if len(below) - 1 > HIGHEST_ORDER:
        raise ValueError(
            f"denominator has degree {len(below) - 1} in {variable}; give {HIGHEST_ORDER} at most."
        )
    return above, below


def checked_transfer_function(
    numerator: Coefficients, denominator: Coefficients, excess: int, what: str
) -> TransferFunction:
    """A transfer function whose numerator's degree exceeds the other by ``excess`` at most."""
    remedy = f"{what}: give coefficients in s, highest power first, not in z"
    return TransferFunction(*checked_sides(numerator, denominator, "s", excess, remedy))


def _coefficients(name: str, values: Coefficients, variable: str) -> tuple[float, ...]:
    """The coefficients of a polynomial, in s or z, without leading ones of 0."""
    try:
        row = list(np.atleast_1d(values))
    except ValueError:  # rows of unlike lengths
        row = []
    numbers = [checked_number(name, value) for value in row]
    while numbers and numbers[0] == 0.0:
        numbers.pop(0)
    if not numbers:
        raise ValueError(
            f"{name} is {values!r}; give coefficients in {variable}, highest power first, not "
            "all of them 0."
        )
    return tuple(numbers)


def checked_state_space(a: Any, b: Any, c: Any) -> StateSpace:
    """A state space of one force and one position, or of two, the hand's second."""
    given = [np.asarray(checked(name, m)) for name, m in zip("ABC", (a, b, c), strict=True)]
    order = len(np.atleast_1d(given[0]))
    sides = given[0], given[1][:, None] if given[1].ndim == 1 else given[1], np.atleast_2d(given[2])
    shapes = [[(order, order), (order, ports), (ports, order)] for ports in (1, 2)]
    if [side.shape for side in sides] not in shapes or not 1 <= order <= HIGHEST_ORDER:
        raise ValueError(
            f"A, B and C have shapes {', '.join(str(side.shape) for side in given)}; a state space "
            "in s of one force and one position has A of (n, n), B of (n, 1) and C of (1, n), n "
            f"from 1 to {HIGHEST_ORDER}; with the force and the position of the hand B is of "
            "(n, 2) and C of (2, n)."
        )
    return StateSpace(*(tuple(map(tuple, side.tolist())) for side in sides))


def checked_compliance(function: Rational, device: Any) -> Rational:
    """A strictly proper function of s without its common factor, which must not be unstable."""
    if degree_of(function.denominator) < 0 or degree_of(function.numerator) < 0:
        raise ValueError(
            f"the device ({device}) has the transfer function 0 or no finite one in s; give a "
            "device that a force moves."
        )
    reduced, common = function.reduced()
    above, below = map(degree_of, reduced)
    if above >= below:
        raise ValueError(
            f"the device ({device}) has degree {above} over {below} in s; position over force is "
            "strictly proper: a force moves a device, in time."
        )
    if below > HIGHEST_ORDER:
        raise ValueError(
            f"the device ({device}) is of order {below} in s; give {HIGHEST_ORDER} at most."
        )
    if any(not (root.real < 0 or root.contains(0)) for root, _ in roots_of(common)):
        raise ValueError(
            f"the device ({device}) has a part that does not decay by itself and that no wall "
            "damps, as the motor does not move it or the encoder does not show it (a common factor "
            "of its transfer function in s): give it damping, or leave it out."
        )
    return reduced


def roots_of(polynomial: "fmpq_mpoly") -> list[tuple[Any, int]]:
    """Its roots in balls of 60 digits, each with its multiplicity."""
    _, factors = polynomial.factor_squarefree()
    with working_precision(1024):
        return [
            (root, count)
            for factor, count in factors
            for root in flint.acb_poly(balls_of(factor)).roots(tol=flint.arb(2) ** -200)
        ]
