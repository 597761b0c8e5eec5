"""Bounds of rounding errors that proofs rest on, each with its derivation.

A proof computes a number and a bound of its error. Three kinds of constants enter such bounds:

- *Units*: what one operation may be wrong by, relative to its result. float64 rounds to nearest,
  so an operation is right to ``UNIT``; ``EPS`` = 2 UNIT is the distance of 1 from the next number.
  Pairs of float64 (``model.double_double``) are right to ``PAIR_UNIT``.
- *Models*: what a computed plant or filter may be wrong by. Lemmas V7 and V10 of docs/proofs.md
  derive them; ``python docs/rounding.py`` derives those of V7 from balls over boxes.
- *Raised sums*: a bound is computed in float64 as well, so it may come out below its exact value.
  A sum or product of n numbers of one sign is right to n UNIT, so multiplied by 1 + 2^-k it is no
  less than the exact one for n up to 2^(52-k). ``RAISED`` and ``RAISED_MANY`` are two such
  factors, for at most 2^12 and 2^32 operations.

Constants of a search (where it starts or ends, what it calls close) bound nothing and stay where
they are used.
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

# Coefficients of products of filters, for each stage and four more, relative to the product of
# the stages' sizes (lemma V7).
FILTERS = 2.0**-96
RAISED = 1.0 + 2.0**-40
RAISED_MANY = 1.0 + 2.0**-20
RAISED_MUCH = 1.0 + 1e-9  # for powers and exponentials of bounds, too
SAFETY = 1.001  # for bounds of recursions, which lose less than 2^-10 of them (lemmas R1 and V3)

# A parameter of a loop over a box, converted to samples or to units of the device: fewer than 45
# operations, each of them EPS.
PARAMETER = 1e-14

# NumPy's sine, cosine and exponential are right to 4 units in the last place.
ELEMENTARY = 4 * EPS

# One operation on linear models, of the size |c| + sum |s_k| + rest of its result (lemma B13). A
# slope of a product is a sum of two products: 4 UNIT of A_k + B_k, A_k = |c s'_k| and B_k =
# |c' s_k|. They may cancel, but A + B = |A - B| + 2 min(A, B), and the sum of min(A_k, B_k) is at
# most ((sum A_k)(sum B_k))^(1/2) <= (|c c'| + sum |s_k| sum |s'_k|)/2, which the centre and the
# rest hold; inverses: 12 UNIT. 64 count.
LINEAR_MODEL = 32 * EPS

# The derivative of sin(x/2)/(x/2): -x/12 is right to x^3/480 below x = 1e-3; above, a difference of
# two numbers near 1, each right to ELEMENTARY, over x.
SINC_SLOPE = 1e-11

# More than any sum of numbers that are flushed to zero.
UNDERFLOW = 1e-290
