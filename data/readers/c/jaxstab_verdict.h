/* Is a haptic loop stable?  C99 or C++, without libraries; proved, or called undecided.
 *
 *     #include "jaxstab_verdict.h"
 *     if (jaxstab_verdict(alpha, beta, gamma, delta, delay) == JAXSTAB_STABLE) ...
 *
 * The loop is that of Hulin, Preusche, Hirzinger (2008): alpha = K T^2/m and beta = B T/m of the wall,
 * gamma = k T^2/m and delta = b T/m of device and hand, delay = t_d/T = n + f, 0 <= f < 1; velocity is
 * the difference over one sample. Its characteristic polynomial of degree n + 4 is
 *
 *     p(z) = z^(n+2) (z^2 - S z + E) + (b2 z^2 + b1 z + b0) ((alpha + beta) z - beta).
 *
 * The plant: let x be its unit-step response and s = x', and m = s^2 + x (delta s + gamma x). Then
 * S = 2 - 2 gamma x - delta s and E = exp(-delta) = S - 1 + gamma m at time 1, b2 = x(1 - f),
 * b0 = exp(-delta (1 - f)) (m(f) - x(f)), and b2 + b1 + b0 = m(1). A series gives x and s at t/2^h,
 * and x(2t) = 2x - gamma x^2 + s^2, s(2t) = s (2 - delta s - 2 gamma x).
 *
 * The verdict: the recursion of Schur and Cohn, with a bound of the error of each coefficient. With
 * k = p[n]/p[0], all roots of p are inside of the unit circle if |k| < 1 and those of the polynomial
 * p[i] - k p[n-i] of degree n - 1 are; if |k| > 1, not all are. Two facts need no rounding: for alpha
 * <= -gamma p(1) <= 0, so a root is at 1 or beyond; else p(1) > 0, which every step keeps, so that at
 * degree 1 only k < 1 is to be shown.
 *
 * What is assumed, and measured against 50 digits (tests/atlas/test_readers.py): that the plant's numbers
 * are wrong by at most PLANT 2^h units of 2^-52. Beyond about 25 samples of delay bounds grow until
 * hardly anything is decided. Do not compile with -ffast-math, nor with parts of it.
 */
#ifndef JAXSTAB_VERDICT_H
#define JAXSTAB_VERDICT_H

#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "jaxstab_verdict.h compares with NaN and infinity: no -ffast-math, no -ffinite-math-only"
#endif

enum { JAXSTAB_STABLE = 1, JAXSTAB_UNSTABLE = 2, JAXSTAB_UNDECIDED = 3 };
enum { JAXSTAB_LONGEST_DELAY = 60, JAXSTAB_DEGREE = JAXSTAB_LONGEST_DELAY + 4 };

static const double jaxstab_unit = 2.220446049250313e-16;  /* 2^-52, twice the rounding unit */
static const double jaxstab_plant_units = 10.0;            /* PLANT */

static inline double jaxstab_abs(double x)
{
    return x < 0.0 ? -x : x;
}

/* The verdict on a polynomial of degree n, the highest power first, each coefficient known to an
 * error; both arrays are overwritten. is_positive says that p(1) > 0 is known. */
static inline int jaxstab_recursion(double *p, double *error, int n, int is_positive)
{
    const double u = jaxstab_unit, up = 1.0 + 16.0 * jaxstab_unit;  /* roundings of the bounds */
    for (; n > 0; n--) {
        const double k = p[n] / p[0], size = jaxstab_abs(k);
        const double dk = up * ((error[n] + size * error[0]) / (p[0] - error[0]) + u * size);
        if (!(p[0] > 2.0 * error[0]))
            return JAXSTAB_UNDECIDED;
        if (n == 1 && is_positive && k + dk < 1.0)
            return JAXSTAB_STABLE;
        if (!(size + dk < 1.0))
            return size - dk > 1.0 ? JAXSTAB_UNSTABLE : JAXSTAB_UNDECIDED;
        for (int i = 0, j = n; i <= j; i++, j--) {
            const double a = p[i], b = p[j], da = error[i], db = error[j];
            const double ra = u * (jaxstab_abs(a) + size * jaxstab_abs(b));
            const double rb = u * (jaxstab_abs(b) + size * jaxstab_abs(a));
            p[i] = a - k * b;
            p[j] = b - k * a;
            error[i] = up * (da + size * db + dk * (jaxstab_abs(b) + db) + ra);
            error[j] = up * (db + size * da + dk * (jaxstab_abs(a) + da) + rb);
        }
    }
    return JAXSTAB_STABLE;
}

/* The verdict on a polynomial of degree n <= JAXSTAB_DEGREE with real coefficients taken as exact, the
 * highest power first: of any other loop, of which you know p. The first one is not below 1e-150: what
 * underflows, 2^-1074 at a time, then counts less than the bounds are rounded up. */
static inline int jaxstab_polynomial_verdict(const double *p, int n)
{
    double q[JAXSTAB_DEGREE + 1], error[JAXSTAB_DEGREE + 1];
    if (n < 0 || n > JAXSTAB_DEGREE || !(jaxstab_abs(p[0]) > 1e-150))
        return JAXSTAB_UNDECIDED;
    for (int i = 0; i <= n; i++) {
        q[i] = p[0] < 0.0 ? -p[i] : p[i];
        error[i] = 0.0;
        if (!(jaxstab_abs(q[i]) < 1e150))
            return JAXSTAB_UNDECIDED;
    }
    return jaxstab_recursion(q, error, n, 0);
}

typedef struct { double x, s; int doublings; } jaxstab_response;

/* Step and impulse response of the plant at a time in [0, 1]. */
static inline jaxstab_response jaxstab_response_at(double time, double gamma, double delta)
{
    jaxstab_response at = {0.0, time, 0};
    while (delta * time > 0.5 || gamma * time * time > 0.25) {
        time *= 0.5;
        at.doublings++;
    }
    /* s = sum of terms v_k t^k/k!, v_1 = 1, v_(k+2) = -delta v_(k+1) - gamma v_k; x is its integral */
    double before = 0.0, term = time;
    at.s = time;
    at.x = 0.5 * time * time;
    for (int k = 0; k < 16; k++) {
        const double next = -(delta * time * term + gamma * time * time * before / (k + 1)) / (k + 2);
        before = term;
        term = next;
        at.s += term;
        at.x += term * time / (k + 3);
    }
    for (int i = 0; i < at.doublings; i++) {
        const double x = at.x, s = at.s;
        at.x = x * (2.0 - gamma * x) + s * s;
        at.s = s * (2.0 - delta * s - 2.0 * gamma * x);
    }
    return at;
}

/* Fill in p(z), the highest power first, with bounds of its errors; return its degree. */
static inline int jaxstab_loop(double alpha, double beta, double gamma, double delta, double delay,
                               double p[JAXSTAB_DEGREE + 1], double error[JAXSTAB_DEGREE + 1])
{
    const int whole = (int)delay, n = whole + 4;
    const double fraction = delay - whole, k = alpha + beta;
    const jaxstab_response a = jaxstab_response_at(1.0 - fraction, gamma, delta);
    const jaxstab_response b = jaxstab_response_at(fraction, gamma, delta);
    const double ma = a.s * a.s + a.x * (delta * a.s + gamma * a.x);
    const double mb = b.s * b.s + b.x * (delta * b.s + gamma * b.x);
    const double decay = 1.0 - delta * a.s - gamma * (2.0 * a.x - ma);
    const double rest = 1.0 - gamma * b.x;
    const double x = b.x + a.x * rest + a.s * b.s;
    const double s = b.s - gamma * a.x * b.s + a.s * (rest - delta * b.s);
    const double m = s * s + x * (delta * s + gamma * x);
    const double trace = 2.0 - 2.0 * gamma * x - delta * s;
    const double b2 = a.x, b0 = decay * (mb - b.x), b1 = m - b2 - b0;
    const double wall[4] = {b2 * k, b1 * k - b2 * beta, b0 * k - b1 * beta, -b0 * beta};
    const double gains = jaxstab_abs(k) + jaxstab_abs(beta);
    double plant = jaxstab_plant_units * jaxstab_unit;
    for (int i = a.doublings > b.doublings ? a.doublings : b.doublings; i > 0; i--)
        plant *= 2.0;
    for (int i = 0; i <= n; i++)
        p[i] = error[i] = 0.0;
    p[0] = 1.0;
    p[1] = -trace;
    p[2] = trace - 1.0 + gamma * m;
    error[1] = error[2] = plant;
    for (int i = 0; i < 4; i++) {  /* 4 units: of k and of products with b2, b1 and b0, which are <= 1 */
        p[n - 3 + i] += wall[i];
        error[n - 3 + i] += (plant + 4.0 * jaxstab_unit) * gains +
                            jaxstab_unit * jaxstab_abs(p[n - 3 + i]);
    }
    return n;
}

/* JAXSTAB_STABLE or JAXSTAB_UNSTABLE, both proved, or JAXSTAB_UNDECIDED: too close to the limit to
 * tell, NaN, gamma beyond 0 to 1e4, delta beyond 0 to 1e3, delay beyond 0 to 60, gains beyond 1e100. */
static inline int jaxstab_verdict(double alpha, double beta, double gamma, double delta, double delay)
{
    double p[JAXSTAB_DEGREE + 1], error[JAXSTAB_DEGREE + 1];
    if (!(gamma >= 0.0 && gamma <= 1e4 && delta >= 0.0 && delta <= 1e3 && delay >= 0.0 &&
          delay <= JAXSTAB_LONGEST_DELAY && jaxstab_abs(alpha) < 1e100 && jaxstab_abs(beta) < 1e100))
        return JAXSTAB_UNDECIDED;
    if (alpha <= -gamma)
        return JAXSTAB_UNSTABLE;
    return jaxstab_recursion(p, error, jaxstab_loop(alpha, beta, gamma, delta, delay, p, error), 1);
}

#endif
