/* Calls of a guard, for tests. "calls COUNT SEED" writes what went in and came out. "judge COUNT SEED
 * PERIOD DAMPING WINDOW" and six ends, of a hand's mass, stiffness and damping, judges what came out
 * with a hand at random, and writes the calls that are not clearly stable; "raw ..." judges walls as
 * they go in, and writes them all. "time COUNT SEED" says how
 * long a call takes, in ns. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include "test_guard.h"

static uint64_t state;

static double uniform(void)
{
    state ^= state << 13;
    state ^= state >> 7;
    state ^= state << 17;
    return (double)(state >> 11) / 9007199254740992.0;
}

static double between(double low, double high)
{
    return low + (high - low) * uniform();
}

static void draw(double row[4])
{
    row[0] = between(0.0, 1.5 * TEST_GUARD_LARGEST_STIFFNESS);
    row[1] = between(0.0, 1.2 * TEST_GUARD_LARGEST_DAMPING);
    row[2] = between(TEST_GUARD_LOWEST_MASS, TEST_GUARD_HIGHEST_MASS);
    row[3] = between(TEST_GUARD_SHORTEST_DELAY, TEST_GUARD_LONGEST_DELAY);
    if (uniform() < 0.1)
        row[0] *= 1e-6;
}

static void calls(long count)
{
    for (long i = 0; i < count; ++i) {
        double row[8];
        draw(row);
        row[4] = row[0];
        row[5] = row[1];
        row[6] = test_guard_clamp(row + 4, row + 5, row[2], row[3]);
        row[7] = test_guard_largest_stiffness(row[5], row[2], row[3]);
        fwrite(row, sizeof row, 1, stdout);
    }
}

static long nanoseconds(void)
{
    struct timespec now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * 1000000000L + now.tv_nsec;
}

typedef struct {
    long double alpha, beta, gamma, delta, delay; /* numbers without a unit, as the paper has them */
} loop_numbers;

enum { TERMS = 12 };

static long double reciprocal[TERMS]; /* of whole numbers: a division takes long */

/* The position at some time, pushed by 1 from rest: x" = 1 - delta x' - gamma x tells the terms of its
 * series. For slow devices: where gamma is 4e-4 and delta 6e-3 what is left out is 2e-21. */
static long double pushed(const loop_numbers *loop, long double time, long double *speed)
{
    long double before = 0.0L, here = 1.0L, power = time, sum = 0.0L;
    *speed = 0.0L;
    for (int k = 2; k < TERMS; ++k) {
        const long double next = -loop->delta * here - loop->gamma * before;
        *speed += here * power;
        power *= time * reciprocal[k];
        sum += here * power;
        before = here;
        here = next;
    }
    return sum;
}

enum { MOST = 64 };

/* Whether all poles are in the unit circle, and no step of Schur and Cohn is close to its end. */
static int is_clearly_stable(const loop_numbers *loop, int window)
{
    const int whole = (int)loop->delay, degree = whole + 3 + window;
    const long double lag = loop->delay - whole, push = loop->beta / window;
    long double p[MOST] = {0.0L}, speed, full = pushed(loop, 1.0L, &speed), other;
    if (degree >= MOST)
        return 0;
    const long double d1 = -(2.0L - 2.0L * loop->gamma * full - loop->delta * speed);
    const long double d0 = expl(-loop->delta);
    long double x1 = pushed(loop, 1.0L - lag, &other), x2 = pushed(loop, 2.0L - lag, &other);
    long double x3 = pushed(loop, 3.0L - lag, &other), y2 = x2 - x1, y3 = x3 - x2;
    const long double n[3] = {x1, y2 + d1 * x1, y3 + d1 * y2 + d0 * x1};
    p[0] = 1.0L;
    p[1] = d1;
    p[2] = d0;
    for (int i = 0; i < 3; ++i) {
        p[whole + 1 + i] += n[i] * (loop->alpha + push);
        p[whole + 1 + window + i] -= n[i] * push;
    }
    for (int m = degree; m > 0; --m) {
        const long double ratio = p[m] / p[0];
        if (!(fabsl(ratio) < 1.0L - 1e-12L))
            return 0;
        for (int low = 0, high = m; low <= high; ++low, --high) {
            const long double first = p[low], last = p[high];
            p[low] = first - ratio * last;
            p[high] = last - ratio * first;
        }
    }
    return 1;
}

static void judge(long count, char **words, int is_raw)
{
    const long double period = strtold(words[0], NULL), own = strtold(words[1], NULL);
    const int window = (int)strtol(words[2], NULL, 10);
    double ends[6];
    for (int k = 2; k < TERMS; ++k)
        reciprocal[k] = 1.0L / k;
    for (int i = 0; i < 6; ++i)
        ends[i] = strtod(words[3 + i], NULL);
    for (long i = 0; i < count; ++i) {
        double row[9];
        draw(row);
        const double stiffness = row[0], damping = row[1];
        const int code = is_raw ? 0 : test_guard_clamp(row, row + 1, row[2], row[3]);
        const double most = test_guard_largest_stiffness(row[1], row[2], row[3]);
        const int corner = uniform() < 0.5;
        for (int k = 0; k < 3; ++k) {
            const double share = uniform();
            row[4 + k] = corner ? ends[2 * k + (share < 0.5)]
                                : between(ends[2 * k], ends[2 * k + 1]);
        }
        const long double mass = (long double)row[2] + row[4];
        /* a free device without stiffness drifts */
        const long double stiff = row[0] > 1e-6 ? row[0] : 1e-6L;
        const loop_numbers loop = {stiff * period * period / mass, row[1] * period / mass,
                                   row[5] * period * period / mass,
                                   (own + row[6]) * period / mass, row[3] / period};
        const int is_lowered = is_raw ||
            (row[0] <= stiffness && row[1] <= damping && row[0] <= most * (1.0 + 1e-12));
        row[7] = is_lowered && code != TEST_GUARD_REFUSED;
        row[8] = is_raw ? is_clearly_stable(&loop, window) : code;
        if (is_raw || row[7] < 1.0 || !is_clearly_stable(&loop, window))
            fwrite(row, sizeof row, 1, stdout);
    }
}

/* The least of some times of one call, so that what else the machine does is left out. */
static long least_time(const double given[4], int repeats, double *sum)
{
    long least = 1000000000L;
    for (int i = 0; i < repeats; ++i) {
        double row[4];
        memcpy(row, given, sizeof row);
        const long begin = nanoseconds();
        *sum += test_guard_clamp(row, row + 1, row[2], row[3]);
        const long taken = nanoseconds() - begin;
        *sum += row[0] + row[1];
        least = taken < least ? taken : least;
    }
    return least;
}

enum { REPEATS = 100, LONGEST = 100000 };

/* The median of the times of calls, and their worst: calls that are slower than twice the median of
 * those before are repeated, and their least time counts. The clock's own time is within. */
static void times(long count)
{
    static long taken[LONGEST + 1];
    double sum = 0.0;
    long worst = 0, repeated = 0, slow = 0, median = 100, clock = 1000000;
    for (long i = 0; i < count; ++i) {
        double row[4];
        draw(row);
        long time = least_time(row, 1, &sum);
        ++taken[time < LONGEST ? time : LONGEST];
        slow += time > 1000;
        if (time > 2 * median) {
            time = least_time(row, REPEATS, &sum);
            ++repeated;
        }
        worst = time > worst ? time : worst;
        if (i == 10000 || i + 1 == count)
            for (long below = 0, t = 0; t <= LONGEST; ++t) {
                below += taken[t];
                if (2 * below > i) {
                    median = t;
                    break;
                }
            }
        if (i < 1000) {
            const long begin = nanoseconds(), empty = nanoseconds() - begin;
            clock = empty < clock ? empty : clock;
        }
    }
    printf("%ld calls: median %ld ns, worst of the least times %ld ns; %ld took more than 1000 ns "
           "once, %ld were repeated; the clock takes %ld ns (%g)\n",
           count, median, worst, slow, repeated, clock, sum);
}

int main(int count, char **words)
{
    if (count < 4)
        return 2;
    state = strtoull(words[3], NULL, 10) * 0x9e3779b97f4a7c15u + 1u;
    if (count == 13)
        judge(strtol(words[2], NULL, 10), words + 4, words[1][0] == 'r');
    else
        (words[1][0] == 'c' ? calls : times)(strtol(words[2], NULL, 10));
    return 0;
}
