/* Stability verdicts from a jaxstab atlas, for a haptic control loop. C99 or C++, no library.
 *
 *     const char *problem;
 *     jaxstab_atlas *atlas = jaxstab_open("atlas.h5", &problem);      once, before the loop
 *     if (!atlas) { fprintf(stderr, "atlas.h5 %s\n", problem); ... }
 *     int code = jaxstab_verdict(atlas, alpha, beta, gamma, delta, delay);
 *     jaxstab_close(atlas);
 *
 * The answers are for walls that take the velocity and the position as atlas->filters says, in
 * words: show it, or compare it with what your software does.
 *
 * With K, B stiffness and damping of the virtual wall, m, b, k mass, damping and stiffness of
 * device and hand, T sampling period and t_d delay:
 *
 *     alpha = K T^2/m    beta = B T/m    gamma = k T^2/m    delta = b T/m    delay = t_d/T
 *
 * jaxstab_open checks the whole file, its SHA-256s included, and keeps the limits of the stable
 * alpha in one block of memory. It takes less than three times the file's size until then. After that the atlas is constant: a query allocates nothing, locks
 * nothing and calls nothing, its time is bounded, and many threads may make queries at once.
 *
 * The answers are those of Python's Atlas.verdict and Atlas.alpha_limits, bit for bit where doubles are IEEE 754 and products are not fused with sums (gcc and clang: -std=c99 or -ffp-contract=off).
 * data/README.md describes the file.
 */
#ifndef JAXSTAB_ATLAS_H
#define JAXSTAB_ATLAS_H

#ifdef __FAST_MATH__
#error "jaxstab_atlas.h compares with infinities and NaN: compile it without -ffast-math"
#endif

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "jaxstab_table.h"

enum {
    /* NaN, between the delays of the atlas, or outside of it: not known; beyond axes that hold all
     * stable walls the code is JAXSTAB_UNSTABLE */
    JAXSTAB_OUTSIDE = -1,
    JAXSTAB_STABLE = 1,    /* proved */
    JAXSTAB_UNSTABLE = 2,  /* proved */
    JAXSTAB_UNDECIDED = 3  /* too close to the boundary for the atlas */
};

/* Of the alphas of the atlas every one from lower + lower_error to upper - upper_error is stable, and
 * every one below lower - lower_error or above upper + upper_error unstable. Where none is stable
 * both limits are NaN with an error of 0; an infinite limit is beyond the atlas, and with an
 * infinite error nothing is known. */
typedef struct {
    double lower, lower_error, upper, upper_error;
} jaxstab_limits;

typedef struct {
    double lowest_delay, highest_delay, lowest_alpha, highest_alpha, lowest_beta, highest_beta;
    double cells_per_beta;
    double whole; /* 1: beyond these alphas every wall is unstable; 2: beyond these betas, too */
} jaxstab_walls_; /* in one cell of delays */

typedef struct {
    size_t gammas, deltas; /* nodes */
    size_t beta_cells, gamma_cells, delta_cells, delay_cells;
    const jaxstab_walls_ *walls;  /* one for each cell of delays, ascending */
    const double *gamma, *delta;  /* ascending nodes */
    const float *limits;          /* [beta_cell][gamma_cell][delta_cell][delay_cell][20] */
    const char *filters;          /* velocity estimator and position filter, in words */
} jaxstab_atlas;

enum { JAXSTAB_TERMS_ = 10, JAXSTAB_ROW_ = 20 }; /* of a limit, and of two; in two lines of the cache */

/* ---- queries ---- */

/* How many of some ascending values are not above a number; 0 for NaN. */
static inline size_t jaxstab_rank_(const double *values, size_t count, double number)
{
    size_t low = 0, high = count;
    while (low < high) {
        const size_t middle = low + (high - low) / 2;
        if (values[middle] <= number)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

/* The cell between nodes: an inner node belongs to the cell above it, the last to that below. */
static inline size_t jaxstab_cell_(const double *nodes, size_t count, double number)
{
    size_t cell = 0;
    if (count > 32)
        return jaxstab_rank_(nodes + 1, count - 2, number);
    for (size_t i = 1; i + 1 < count; i++) /* without branches that depend on the number */
        cell += nodes[i] <= number;
    return cell;
}

static inline int jaxstab_holds_(double lowest, double highest, double number)
{
    return lowest <= number && number <= highest;
}

static inline double jaxstab_limit_(const float *terms, double beta, double gamma, double delta,
                                    double delay)
{
    const double rate = (double)terms[4] + (double)terms[5] * delay + (double)terms[6] * beta +
                        (double)terms[7] * gamma + (double)terms[8] * delta;
    return (double)terms[0] + (double)terms[1] * beta + (double)terms[2] * gamma +
           (double)terms[3] * delta + rate * delay;
}

/* The last cell of delays that begins at a delay or before, and one more; 0 for none and NaN. */
static inline size_t jaxstab_delay_rank_(const jaxstab_atlas *atlas, double delay)
{
    const jaxstab_walls_ *walls = atlas->walls;
    size_t cell = 0, count = atlas->delay_cells;
    while (count > 1) { /* without branches that depend on the delay */
        const size_t half = count / 2;
        cell += walls[cell + half].lowest_delay <= delay ? half : 0;
        count -= half;
    }
    return walls[cell].lowest_delay <= delay ? cell + 1 : 0;
}

/* The walls of the cell of delays for a plant; NULL where the atlas says nothing of it. */
static inline const jaxstab_walls_ *jaxstab_walls_of_(const jaxstab_atlas *atlas, double gamma,
                                                      double delta, double delay)
{
    const size_t rank = jaxstab_delay_rank_(atlas, delay);
    if (rank == 0 || !(delay <= atlas->walls[rank - 1].highest_delay) ||
        !jaxstab_holds_(atlas->gamma[0], atlas->gamma[atlas->gammas - 1], gamma) ||
        !jaxstab_holds_(atlas->delta[0], atlas->delta[atlas->deltas - 1], delta))
        return NULL;
    return &atlas->walls[rank - 1];
}

/* Find the walls of a cell of delays and the limits at a point; 0 where the atlas says nothing. */
static inline int jaxstab_find_(const jaxstab_atlas *atlas, double beta, double gamma, double delta,
                                double delay, const jaxstab_walls_ **walls, jaxstab_limits *limits)
{
    *walls = jaxstab_walls_of_(atlas, gamma, delta, delay);
    if (!*walls || !jaxstab_holds_((*walls)->lowest_beta, (*walls)->highest_beta, beta))
        return 0;

    const size_t delay_cell = (size_t)(*walls - atlas->walls);
    const double place = (beta - (*walls)->lowest_beta) * (*walls)->cells_per_beta;
    size_t cell = place < (double)atlas->beta_cells ? (size_t)place : atlas->beta_cells - 1;
    cell = cell * atlas->gamma_cells + jaxstab_cell_(atlas->gamma, atlas->gammas, gamma);
    cell = cell * atlas->delta_cells + jaxstab_cell_(atlas->delta, atlas->deltas, delta);

    const float *column = atlas->limits + JAXSTAB_ROW_ * (cell * atlas->delay_cells + delay_cell);
    limits->lower = jaxstab_limit_(column, beta, gamma, delta, delay);
    limits->lower_error = column[9];
    limits->upper = jaxstab_limit_(column + JAXSTAB_TERMS_, beta, gamma, delta, delay);
    limits->upper_error = column[19];
    return 1;
}

/* The code of a wall outside of the walls of a plant, which may be NULL. */
static inline int jaxstab_beyond_(const jaxstab_walls_ *walls, double alpha, double beta)
{
    if (!walls || !isfinite(alpha) || !isfinite(beta))
        return JAXSTAB_OUTSIDE;
    const int is_inside = jaxstab_holds_(walls->lowest_beta, walls->highest_beta, beta);
    return walls->whole >= (is_inside ? 1.0 : 2.0) ? JAXSTAB_UNSTABLE : JAXSTAB_OUTSIDE;
}

/* Return one of the four codes above. */
static inline int jaxstab_verdict(const jaxstab_atlas *atlas, double alpha, double beta,
                                  double gamma, double delta, double delay)
{
    const jaxstab_walls_ *walls;
    jaxstab_limits at;
    if (!jaxstab_find_(atlas, beta, gamma, delta, delay, &walls, &at) ||
        !jaxstab_holds_(walls->lowest_alpha, walls->highest_alpha, alpha))
        return jaxstab_beyond_(walls, alpha, beta);
    /* Without branches: a wrong guess would wait for the limits, which come from memory. */
    const int is_unstable =
        (alpha < at.lower - at.lower_error) | (alpha > at.upper + at.upper_error);
    const int is_stable =
        (alpha > at.lower + at.lower_error) & (alpha < at.upper - at.upper_error);
    return JAXSTAB_UNDECIDED - is_unstable * (JAXSTAB_UNDECIDED - JAXSTAB_UNSTABLE) -
           is_stable * (JAXSTAB_UNDECIDED - JAXSTAB_STABLE);
}

/* Fill in the limits of the stable alpha and return 1; or return 0, where the atlas says nothing,
 * with limits of NaN and errors of infinity. */
static inline int jaxstab_alpha_limits(const jaxstab_atlas *atlas, double beta, double gamma,
                                       double delta, double delay, jaxstab_limits *limits)
{
    const jaxstab_walls_ *walls;
    if (!jaxstab_find_(atlas, beta, gamma, delta, delay, &walls, limits)) {
        limits->lower = limits->upper = NAN;
        limits->lower_error = limits->upper_error = INFINITY;
        return 0;
    }
    /* The surfaces hold for the alphas of the atlas alone: beyond them they say nothing. */
    if (limits->lower + limits->lower_error <= walls->lowest_alpha) {
        limits->lower = -INFINITY;
        limits->lower_error = 0.0;
    }
    if (limits->upper - limits->upper_error >= walls->highest_alpha) {
        limits->upper = INFINITY;
        limits->upper_error = 0.0;
    }
    if (limits->lower == INFINITY)
        limits->lower = limits->upper = NAN;
    return 1;
}

/* ---- what a file may hold ---- */

/* Whether nodes are finite, ascending and not negative. */
static inline int jaxstab_ascends_(const double *nodes, size_t count)
{
    for (size_t i = 0; i < count; i++)
        if (!isfinite(nodes[i]) || nodes[i] < 0.0 || (i && !(nodes[i - 1] < nodes[i])))
            return 0;
    return 1;
}

enum {
    JAXSTAB_GAMMA_,
    JAXSTAB_DELTA_,
    JAXSTAB_RANGE_,
    JAXSTAB_WHOLE_,
    JAXSTAB_LIMITS_,
    JAXSTAB_ARRAYS_ /* so many */
};

/* Whether cells between two ends have a width that rounding does not swallow: 2^-24 of an end. */
static inline int jaxstab_spans_(const double *ends)
{
    const double span = ends[1] - ends[0], share = 5.9604644775390625e-08;
    return isfinite(ends[0]) && isfinite(ends[1]) && isfinite(span) && span >= 1e-300 &&
           span >= share * fabs(ends[0]) && span >= share * fabs(ends[1]);
}

/* Whether cells of delays follow each other, in rows of the ends of delay, alpha and beta. */
static inline int jaxstab_follow_(const double *ends, size_t count)
{
    for (size_t i = 0; i < count; i++) {
        const double *row = ends + 6 * i;
        if (!isfinite(row[0]) || row[0] < 0.0 || !(row[0] <= row[1]) || !(row[1] <= 100.0) ||
            !jaxstab_spans_(row + 2) || !jaxstab_spans_(row + 4) ||
            (i && (!(row[-6] < row[0]) || !(row[-5] <= row[0]))))
            return 0;
    }
    return 1;
}

/* Whether constants are numbers or infinite, slopes finite, and errors not negative. */
static inline int jaxstab_are_limits_(const float *terms, size_t count)
{
    int are = 1;
    for (size_t i = 0; are && i < count; i += JAXSTAB_TERMS_) {
        are = !isnan(terms[i]) && terms[i + 9] >= 0.0f;
        for (size_t k = 1; are && k < 9; k++)
            are = isfinite(terms[i + k]);
    }
    return are;
}

/* Whether codes of axes that hold all stable walls may be. */
static inline int jaxstab_are_codes_(const int32_t *codes, size_t count)
{
    int are = 1;
    for (size_t i = 0; are && i < count; i++)
        are = codes[i] >= 0 && codes[i] <= 2;
    return are;
}

/* Whether shapes and axes fit together, and all numbers may be. */
static inline int jaxstab_fits_(void *const values[], const size_t shape[][5])
{
    const size_t *limits = shape[JAXSTAB_LIMITS_], delays = shape[JAXSTAB_RANGE_][0];
    int fits = limits[1] == (shape[JAXSTAB_GAMMA_][0] > 1 ? shape[JAXSTAB_GAMMA_][0] - 1 : 1) &&
               limits[2] == (shape[JAXSTAB_DELTA_][0] > 1 ? shape[JAXSTAB_DELTA_][0] - 1 : 1) &&
               shape[JAXSTAB_WHOLE_][0] == delays && limits[3] == delays && limits[4] == JAXSTAB_ROW_ && shape[JAXSTAB_RANGE_][1] == 6;
    for (int i = JAXSTAB_GAMMA_; i <= JAXSTAB_DELTA_; i++)
        fits = fits && jaxstab_ascends_((const double *)values[i], shape[i][0]);
    return fits && jaxstab_are_codes_((const int32_t *)values[JAXSTAB_WHOLE_], delays) &&
           jaxstab_follow_((const double *)values[JAXSTAB_RANGE_], delays) &&
           jaxstab_are_limits_((const float *)values[JAXSTAB_LIMITS_],
                               limits[0] * limits[1] * limits[2] * limits[3] * limits[4]);
}

static inline double *jaxstab_copied_(const void *values, size_t count, double **free_space)
{
    double *copy = *free_space;
    memcpy(copy, values, count * sizeof *copy);
    *free_space += count;
    return copy;
}

/* Return an atlas in one block: itself, walls of each cell of delays, nodes, limits, and words up to
 * a newline. */
static inline jaxstab_atlas *jaxstab_assembled_(void *const values[], const size_t shape[][5],
                                                const char *filters)
{
    const size_t letters = strcspn(filters, "\n");
    const size_t *limits = shape[JAXSTAB_LIMITS_];
    const size_t delays = limits[3], gammas = shape[JAXSTAB_GAMMA_][0];
    const size_t deltas = shape[JAXSTAB_DELTA_][0];
    const size_t rows = limits[0] * limits[1] * limits[2] * delays;
    const size_t head = (sizeof(jaxstab_atlas) + sizeof(double) - 1) / sizeof(double);
    const size_t walls_size = delays * (sizeof(jaxstab_walls_) / sizeof(double));
    const size_t line = 64 / sizeof(double), row = JAXSTAB_ROW_ / 2; /* two floats in a double */
    const size_t count = head + walls_size + gammas + deltas + line + rows * row +
                         letters / sizeof(double) + 1;
    double *block = (double *)malloc(count * sizeof *block);
    if (!block)
        return NULL;
    jaxstab_atlas *atlas = (jaxstab_atlas *)(void *)block;
    jaxstab_walls_ *walls = (jaxstab_walls_ *)(void *)(block + head);
    double *free_space = block + head + walls_size;
    atlas->gammas = gammas;
    atlas->deltas = deltas;
    atlas->beta_cells = limits[0];
    atlas->gamma_cells = limits[1];
    atlas->delta_cells = limits[2];
    atlas->delay_cells = delays;
    atlas->walls = walls;
    atlas->gamma = jaxstab_copied_(values[JAXSTAB_GAMMA_], gammas, &free_space);
    atlas->delta = jaxstab_copied_(values[JAXSTAB_DELTA_], deltas, &free_space);
    while ((uintptr_t)free_space % 64)
        free_space++;
    atlas->limits = (const float *)(void *)free_space;
    memcpy(free_space, values[JAXSTAB_LIMITS_], rows * row * sizeof *free_space);
    free_space += rows * row;
    memcpy(free_space, filters, letters);
    ((char *)free_space)[letters] = 0;
    atlas->filters = (const char *)free_space;
    for (size_t k = 0; k < delays; k++) {
        memcpy(&walls[k], (const double *)values[JAXSTAB_RANGE_] + 6 * k, 6 * sizeof(double));
        walls[k].cells_per_beta =
            (double)atlas->beta_cells / (walls[k].highest_beta - walls[k].lowest_beta);
        walls[k].whole = ((const int32_t *)values[JAXSTAB_WHOLE_])[k];
    }
    return atlas;
}

/* Return the atlas of an image and the table after it; or NULL and what is wrong, in words. */
static inline jaxstab_atlas *jaxstab_loaded_(const unsigned char *bytes, size_t image, char *text,
                                             size_t length, const char **problem)
{
    static const char *const names[] = {"gamma", "delta", "limit_range", "limit_whole",
                                        "alpha_limits"};
    static const char *const types[] = {" <f8", " <f8", " <f8", " <i4", " <f4"};
    static const int ranks[] = {1, 1, 2, 1, 5};
    jaxstab_file_ file = {bytes, image, {NULL}};
    void *values[JAXSTAB_ARRAYS_] = {NULL};
    size_t shape[JAXSTAB_ARRAYS_][5] = {{0}};
    jaxstab_atlas *atlas = NULL;
    *problem = jaxstab_parse_(text, length, file.blocks);
    int is_read = !*problem;
    for (int i = 0; is_read && i < JAXSTAB_ARRAYS_; i++) {
        values[i] = jaxstab_read_(&file, image, names[i], types[i], ranks[i], shape[i]);
        is_read = values[i] != NULL;
    }
    if (is_read && jaxstab_fits_(values, (const size_t (*)[5])shape)) {
        *problem = "does not fit into memory.";
        atlas = jaxstab_assembled_(values, (const size_t (*)[5])shape,
                                   strstr(file.blocks[0], JAXSTAB_FILTERS_) +
                                       strlen(JAXSTAB_FILTERS_));
    } else if (!*problem) {
        *problem = jaxstab_damaged_;
    }
    for (int i = 0; i < JAXSTAB_ARRAYS_; i++)
        free(values[i]);
    return atlas;
}

/* Return an atlas, to be closed; or NULL, and in *problem what is wrong with the file, in words. */
static inline jaxstab_atlas *jaxstab_open(const char *path, const char **problem)
{
    jaxstab_atlas *atlas = NULL;
    size_t length, image, end;
    unsigned char *bytes = jaxstab_bytes_of_(path, &length);
    *problem = bytes ? jaxstab_damaged_ : "cannot be read.";
    if (bytes && jaxstab_is_whole_(bytes, length, &image, &end)) {
        char *text = (char *)malloc(end - image + 1);
        *problem = "does not fit into memory.";
        if (text) {
            memcpy(text, bytes + image, end - image);
            text[end - image] = 0;
            atlas = jaxstab_loaded_(bytes, image, text, end - image, problem);
        }
        free(text);
    }
    free(bytes);
    if (atlas)
        *problem = NULL;
    return atlas;
}

static inline void jaxstab_close(jaxstab_atlas *atlas)
{
    free(atlas);
}

#endif
