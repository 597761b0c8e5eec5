/* Calls of a guard, for tests: "calls COUNT SEED" writes what went in and came out; "time COUNT SEED"
 * the quantiles of the time of a call in ns. */
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

/* Counts of calls by their time, the clock's own included; and of no calls, by the same clock. */
static void times(long count)
{
    static long taken[2][100001];
    double sum = 0.0;
    for (long i = 0; i < count; ++i) {
        double row[4];
        long begin, end, empty;
        draw(row);
        begin = nanoseconds();
        sum += test_guard_clamp(row, row + 1, row[2], row[3]);
        end = nanoseconds();
        empty = nanoseconds() - end;
        ++taken[0][end - begin < 100000 ? end - begin : 100000];
        ++taken[1][empty < 100000 ? empty : 100000];
        sum += row[0] + row[1];
    }
    for (int kind = 0; kind < 2; ++kind) {
        long below = 0, median = -1, above = 0;
        for (int t = 0; t <= 100000; ++t) {
            below += taken[kind][t];
            if (median < 0 && 2 * below >= count)
                median = t;
            above += t > 1000 ? taken[kind][t] : 0;
        }
        printf("%s: median %ld ns, above 1000 ns: %ld of %ld\n", kind ? "clock" : "clamp", median,
               above, count);
    }
    printf("%g\n", sum);
}

int main(int count, char **words)
{
    if (count < 4)
        return 2;
    state = strtoull(words[3], NULL, 10) * 0x9e3779b97f4a7c15u + 1u;
    (words[1][0] == 'c' ? calls : times)(strtol(words[2], NULL, 10));
    return 0;
}
