"""Bounds of rounding errors that proofs rest on, each with its derivation.

A proof computes a number and a bound of its error. Three kinds of constants enter such bounds:

- *Units*: what one operation may be wrong by, relative to its result. float64 rounds to nearest,
  so an operation is right to ``UNIT``; ``EPS`` = 2 UNIT is the distance of 1 from the next number.
  Pairs of float64 (``model.double_double``) are right to ``PAIR_UNIT``.
- *Models*: what a computed plant or filter may be wrong by. Lemmas V7 and V8 of docs/proofs.md
  derive them; ``python -m benchmarks.rounding`` derives those of V7 from balls over boxes.
- *Raised sums*: a bound is computed in float64 as well, so it may come out below its exact value.
  A sum or product of n numbers of one sign is right to n UNIT, so multiplied by 1 + 2^-k it is no
  less than the exact one for n up to 2^(52-k). ``RAISED_FEW``, ``RAISED`` and ``RAISED_MANY`` are
  three such factors, for at most 4, 2^12 and 2^32 operations.

The rooms ``proofs``, ``ranges``, ``guard`` and ``atlas`` have constants of their arithmetic beside
it.
"""

UNIT = 2.0**-53
EPS = 2.0**-52

# A sum of pairs is right to 3 UNIT^2, a product to 33 UNIT^2, a quotient to 37 UNIT^2 (lemma V7).
PAIR_UNIT = 2.0**-99
PAIR_PRODUCT = 2.0**-100

# Coefficients of D, and of N relative to its size, for the plant of one mass (lemma V7): of soft
# hands (gamma and delta to SOFT_GAMMA, SOFT_DELTA), of stiffer ones, and of more damped ones.
SOFT_GAMMA, SOFT_DELTA = 40.0, 10.0
SOFT_PLANT, STIFF_PLANT, DAMPED_PLANT = 2.0**-89, 2.0**-66, 2.0**-56

# D and N of the quick plant of one mass on the circle: at most 61 + 211 gamma^(1/2) and 822
# roundings of 1, which is QUICK_D (1 + 4 gamma^(1/2)) and QUICK_N (lemma B23).
QUICK_D, QUICK_N = 32 * EPS, 416 * EPS

# Coefficients of filters, relative to the product of their stages' sizes, and of the products of
# filters with each other and with plants (lemma V8).
FILTERS = 2.0**-90
RAISED_FEW = 1.0 + 2.0**-50
RAISED = 1.0 + 2.0**-40
RAISED_MANY = 1.0 + 2.0**-20
