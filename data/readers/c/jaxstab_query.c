/* Ask a jaxstab atlas from the command line: an example for jaxstab_atlas.h.
 *
 *     cc -std=c99 -O2 jaxstab_query.c -o jaxstab_query
 *
 *     jaxstab_query ATLAS            lines of alpha beta gamma delta delay in, a code for each out
 *     jaxstab_query ATLAS --limits   lines of beta gamma delta delay in; for each out the lower
 *                                    limit of the stable alpha, its error, the upper and its error
 *     jaxstab_query ATLAS --bench    time of a verdict at random points of the atlas
 *
 * Codes: 1 stable, 2 unstable, 3 undecided, -1 outside of the atlas, where it says nothing.
 */
#define _POSIX_C_SOURCE 199309L
#include "jaxstab_atlas.h"

#include <time.h>

enum { POINTS = 1 << 20, ROUNDS = 9 };

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
        if (want_limits) {
            jaxstab_limits at;
            jaxstab_alpha_limits(atlas, p[0], p[1], p[2], p[3], &at);
            printf("%.17g %.17g %.17g %.17g\n", at.lower, at.lower_error, at.upper, at.upper_error);
        } else {
            printf("%d\n", jaxstab_verdict(atlas, p[0], p[1], p[2], p[3], p[4]));
        }
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

static int bench(const jaxstab_atlas *atlas)
{
    double (*p)[5] = malloc(POINTS * sizeof *p);
    uint64_t state = 20120412;
    double best = INFINITY;
    long codes[4] = {0};
    if (!p)
        return 1;
    for (size_t i = 0; i < POINTS; i++) {
        const size_t k = (size_t)between(0.0, (double)atlas->delay_cells, &state);
        p[i][0] = between(atlas->walls[k].lowest_alpha, atlas->walls[k].highest_alpha, &state);
        p[i][1] = between(atlas->walls[k].lowest_beta, atlas->walls[k].highest_beta, &state);
        p[i][2] = between(atlas->gamma[0], atlas->gamma[atlas->gammas - 1], &state);
        p[i][3] = between(atlas->delta[0], atlas->delta[atlas->deltas - 1], &state);
        p[i][4] = between(atlas->walls[k].lowest_delay, atlas->walls[k].highest_delay, &state);
    }
    for (int round = 0; round < ROUNDS; round++) {
        const double start = now();
        for (size_t i = 0; i < POINTS; i++)
            codes[jaxstab_verdict(atlas, p[i][0], p[i][1], p[i][2], p[i][3], p[i][4]) & 3]++;
        const double spent = (now() - start) / POINTS;
        best = spent < best ? spent : best;
    }
    const double decided = (double)(codes[JAXSTAB_STABLE] + codes[JAXSTAB_UNSTABLE]);
    printf("%s\n", atlas->filters);
    printf("%.1f ns a query, best of %d rounds of %d random points; %.3f %% decided\n", best,
           ROUNDS, POINTS, 100.0 * decided / POINTS / ROUNDS);
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
