/* Ask a jaxstab atlas from the command line: an example for jaxstab_atlas.h.
 *
 *     cc -std=c99 -O2 jaxstab_query.c -lhdf5 -o jaxstab_query
 *
 *     jaxstab_query ATLAS            lines of alpha beta gamma delta delay in, a code for each out
 *     jaxstab_query ATLAS --limits   lines of beta gamma delta delay in; for each out the lower and
 *                                    the upper limit of the stable alpha, and their errors
 *     jaxstab_query ATLAS --bench    time of a query, a look-up and a computed verdict
 *
 * Codes: 1 stable, 2 unstable, 3 undecided.
 */
#define _POSIX_C_SOURCE 199309L
#include "jaxstab_atlas.h"

#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <time.h>

enum { POINTS = 1 << 20, ROUNDS = 5 };

typedef int (*jaxstab_answer)(const jaxstab_atlas *, double, double, double, double, double);

/* Read so many numbers; 0 at the end of the input, -1 for what is no such line. */
static int read_numbers(double *numbers, int count)
{
    for (int i = 0; i < count; i++)
        if (scanf("%lf", &numbers[i]) != 1)
            return i == 0 && feof(stdin) ? 0 : -1;
    return 1;
}

static int answer(const jaxstab_atlas *atlas, int want_limits)
{
    double p[5];
    int state;
    while ((state = read_numbers(p, want_limits ? 4 : 5)) == 1) {
        double limits[2], errors[2];
        if (!want_limits)
            printf("%d\n", jaxstab_query(atlas, p[0], p[1], p[2], p[3], p[4]));
        else if (jaxstab_alpha_limits(atlas, p[0], p[1], p[2], p[3], limits, errors))
            printf("%.17g %.17g %.17g %.17g\n", limits[0], limits[1], errors[0], errors[1]);
        else
            printf("nan nan inf inf\n");
    }
    if (state < 0)
        fprintf(stderr, "the input holds something else than points of %d numbers.\n",
                want_limits ? 4 : 5);
    return state < 0 ? 2 : 0;
}

/* Return a number between two others, from a linear congruential generator. */
static double between(double low, double high, uint64_t *state)
{
    *state = *state * 6364136223846793005u + 1442695040888963407u;
    return low + (high - low) * (double)(*state >> 11) / 9007199254740992.0;
}

static double now(void)
{
    struct timespec time;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &time);
    return (double)time.tv_sec * 1e9 + (double)time.tv_nsec;
}

static int computed(const jaxstab_atlas *atlas, double alpha, double beta, double gamma, double delta,
                    double delay)
{
    (void)atlas;
    return jaxstab_verdict(alpha, beta, gamma, delta, delay);
}

static int bench(const jaxstab_atlas *atlas)
{
    static const char *const names[3] = {"query", "table alone", "computed"};
    const jaxstab_answer answers[3] = {jaxstab_query, jaxstab_table_verdict, computed};
    double (*p)[5] = malloc(POINTS * sizeof *p);
    uint64_t state = 20120412;
    if (!p)
        return 1;
    for (size_t i = 0; i < POINTS; i++) {
        jaxstab_place at;
        for (int axis = 0; axis < 3; axis++)
            p[i][2 + axis] = between(atlas->axis[axis][0],
                                     atlas->axis[axis][atlas->nodes[axis] - 1], &state);
        jaxstab_find(atlas, p[i] + 2, &at);
        const double width = at.ends[1] - at.ends[0];
        p[i][1] = between(at.ends[0] - 0.08 * width, at.ends[1] + 0.1 * width, &state);
        p[i][0] = between(-0.01 * width * width, 0.25 * width * width, &state);
    }
    for (int kind = 0; kind < 3; kind++) {
        double best = INFINITY;
        long codes[4] = {0};
        for (int round = 0; round < ROUNDS; round++) {
            const double start = now();
            for (size_t i = 0; i < POINTS; i++)
                codes[answers[kind](atlas, p[i][0], p[i][1], p[i][2], p[i][3], p[i][4]) & 3]++;
            const double spent = (now() - start) / POINTS;
            best = spent < best ? spent : best;
        }
        printf("%s: %.1f ns a point, best of %d rounds of %d; %.4f %% undecided\n", names[kind], best,
               ROUNDS, POINTS, 100.0 * codes[3] / POINTS / ROUNDS);
    }
    free(p);
    return 0;
}

int main(int count, char **arguments)
{
    const char *mode = count == 3 ? arguments[2] : "", *problem;
    const int want_limits = strcmp(mode, "--limits") == 0;
    const int want_bench = strcmp(mode, "--bench") == 0;
    if (count < 2 || count > 3 || (count == 3 && !want_limits && !want_bench)) {
        fprintf(stderr, "usage: %s ATLAS [--limits | --bench]\n"
                "Lines of stdin: alpha beta gamma delta delay, with --limits beta gamma delta "
                "delay.\n", arguments[0]);
        return 2;
    }
    jaxstab_atlas *atlas = jaxstab_open(arguments[1], &problem);
    if (!atlas) {
        fprintf(stderr, "%s %s\n", arguments[1], problem);
        return 1;
    }
    const int code = want_bench ? bench(atlas) : answer(atlas, want_limits);
    jaxstab_close(atlas);
    return code;
}
