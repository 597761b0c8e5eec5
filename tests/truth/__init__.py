"""What is true of a loop, by routes that share no code with jaxstab; tests and benchmarks ask it.

- ``loop``: 50 digits of the plant, the polynomial, its roots and its boundary, for any loop;
- ``devices``: loops with any linear device and hand, ``plain``: in mpmath and exact fractions;
- ``balls``: plants and verdicts in balls of python-flint, for many points of one plant;
- ``filtered``: loops with an estimator and a filter, from difference equations;
- ``boundary``: walls of any loop that have roots on the circle, by eigenvalues;
- ``random_loops``: such loops at random, and walls next to their boundary;
- ``moving``: loops whose delay moves;
- ``judge``: what each method says of many loops, against the truth.
"""
