/* Stability verdicts from a jaxstab atlas, for a haptic control loop. C99 (or C++) and libhdf5.
 *
 *     const char *problem;
 *     jaxstab_atlas *atlas = jaxstab_open("atlas.h5", &problem);      once, before the loop
 *     if (!atlas) { fprintf(stderr, "atlas.h5 %s\n", problem); ... }
 *     int code = jaxstab_verdict(atlas, alpha, beta, gamma, delta, delay);
 *     jaxstab_close(atlas);
 *
 * With K, B stiffness and damping of the virtual wall, m, b, k mass, damping and stiffness of
 * device and hand, T sampling period and t_d delay:
 *
 *     alpha = K T^2/m    beta = B T/m    gamma = k T^2/m    delta = b T/m    delay = t_d/T
 *
 * jaxstab_open checks the whole file, its SHA-256 included, and keeps the limits of the stable
 * alpha in one block of memory. After that the atlas is constant: a query allocates nothing, locks
 * nothing and calls nothing, its time is bounded, and many threads may make queries at once.
 *
 * The answers are those of Python's Atlas.verdict and Atlas.alpha_limits, bit for bit where doubles
 * are IEEE 754 and products are not fused with sums (gcc and clang: -std=c99 or -ffp-contract=off).
 * data/README.md describes the file.
 */
#ifndef JAXSTAB_ATLAS_H
#define JAXSTAB_ATLAS_H

#ifdef __FAST_MATH__
#error "jaxstab_atlas.h compares with infinities and NaN: compile it without -ffast-math"
#endif

#include <hdf5.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "jaxstab_footer.h"

enum {
    JAXSTAB_OUTSIDE = -1,  /* NaN, outside of the atlas, or not one of its delays: not known */
    JAXSTAB_STABLE = 1,    /* proved */
    JAXSTAB_UNSTABLE = 2,  /* proved */
    JAXSTAB_UNDECIDED = 3, /* too close to the boundary for the atlas */
    JAXSTAB_OLDEST_SCHEMA = 2,
    JAXSTAB_NEWEST_SCHEMA = 3
};

/* Every alpha from lower + lower_error to upper - upper_error is stable, and every one below
 * lower - lower_error or above upper + upper_error in the atlas is unstable. Where none is stable
 * both limits are NaN with an error of 0; an infinite limit is beyond the atlas, and with an
 * infinite error nothing is known. */
typedef struct {
    double lower, lower_error, upper, upper_error;
} jaxstab_limits;

typedef struct {
    double lowest_alpha, highest_alpha, lowest_beta, highest_beta;
    double cells_per_beta;
} jaxstab_walls_; /* at one delay */

typedef struct {
    size_t delays, gammas, deltas; /* nodes */
    size_t beta_cells, gamma_cells, delta_cells;
    const jaxstab_walls_ *walls;          /* one for each delay */
    const double *delay, *gamma, *delta;  /* ascending nodes */
    const double *planes;                 /* [beta_cell][gamma_cell][delta_cell][delay][10] */
} jaxstab_atlas;

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
    return count > 2 ? jaxstab_rank_(nodes + 1, count - 2, number) : 0;
}

static inline int jaxstab_holds_(double lowest, double highest, double number)
{
    return lowest <= number && number <= highest;
}

static inline double jaxstab_plane_(const double *plane, double beta, double gamma, double delta)
{
    return plane[0] + plane[1] * beta + plane[2] * gamma + plane[3] * delta;
}

/* Find the walls of a delay and the limits at a point; 0 where the atlas says nothing. */
static inline int jaxstab_find_(const jaxstab_atlas *atlas, double beta, double gamma, double delta,
                                double delay, const jaxstab_walls_ **walls, jaxstab_limits *limits)
{
    const size_t rank = jaxstab_rank_(atlas->delay, atlas->delays, delay);
    if (rank == 0 || atlas->delay[rank - 1] != delay)
        return 0;
    *walls = &atlas->walls[rank - 1];
    if (!jaxstab_holds_((*walls)->lowest_beta, (*walls)->highest_beta, beta) ||
        !jaxstab_holds_(atlas->gamma[0], atlas->gamma[atlas->gammas - 1], gamma) ||
        !jaxstab_holds_(atlas->delta[0], atlas->delta[atlas->deltas - 1], delta))
        return 0;

    const double place = (beta - (*walls)->lowest_beta) * (*walls)->cells_per_beta;
    size_t cell = place < (double)atlas->beta_cells ? (size_t)place : atlas->beta_cells - 1;
    cell = cell * atlas->gamma_cells + jaxstab_cell_(atlas->gamma, atlas->gammas, gamma);
    cell = cell * atlas->delta_cells + jaxstab_cell_(atlas->delta, atlas->deltas, delta);

    const double *column = atlas->planes + 10 * (cell * atlas->delays + rank - 1);
    limits->lower = jaxstab_plane_(column, beta, gamma, delta);
    limits->lower_error = column[4];
    limits->upper = jaxstab_plane_(column + 5, beta, gamma, delta);
    limits->upper_error = column[9];
    return 1;
}

/* Return one of the four codes above. */
static inline int jaxstab_verdict(const jaxstab_atlas *atlas, double alpha, double beta,
                                  double gamma, double delta, double delay)
{
    const jaxstab_walls_ *walls;
    jaxstab_limits at;
    if (!jaxstab_find_(atlas, beta, gamma, delta, delay, &walls, &at) ||
        !jaxstab_holds_(walls->lowest_alpha, walls->highest_alpha, alpha))
        return JAXSTAB_OUTSIDE;
    if (alpha < at.lower - at.lower_error || alpha > at.upper + at.upper_error)
        return JAXSTAB_UNSTABLE;
    if (alpha > at.lower + at.lower_error && alpha < at.upper - at.upper_error)
        return JAXSTAB_STABLE;
    return JAXSTAB_UNDECIDED;
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
    if (limits->lower == INFINITY)
        limits->lower = limits->upper = NAN;
    return 1;
}

/* ---- the HDF5 image ---- */

#define JAXSTAB_LARGEST_ARRAY_ ((hsize_t)1 << 28)

static const char jaxstab_damaged_[] =
    "is damaged, or no jaxstab atlas; build it again or copy it anew.";

/* Open an image in memory: what is read is what was checked, whatever happens to the file. */
static inline hid_t jaxstab_open_image_(unsigned char *image, size_t length)
{
    const hid_t access = H5Pcreate(H5P_FILE_ACCESS);
    hid_t file = -1;
    if (H5Pset_fapl_core(access, 1 << 16, 0) >= 0 && H5Pset_file_image(access, image, length) >= 0)
        file = H5Fopen("jaxstab atlas in memory", H5F_ACC_RDONLY, access);
    H5Pclose(access);
    return file;
}

static inline int jaxstab_is_format_(hid_t file)
{
    char text[16] = "";
    const hid_t attribute = H5Aopen(file, "format", H5P_DEFAULT), type = H5Tcopy(H5T_C_S1);
    const int is_read =
        H5Tset_size(type, sizeof text - 1) >= 0 && H5Aread(attribute, type, text) >= 0;
    H5Tclose(type);
    H5Aclose(attribute);
    return is_read && strcmp(text, "jaxstab atlas") == 0;
}

static inline int jaxstab_version_(hid_t file)
{
    int version = -1;
    const hid_t attribute = H5Aopen(file, "schema_version", H5P_DEFAULT);
    const hid_t space = H5Aget_space(attribute);
    if (H5Sget_simple_extent_npoints(space) == 1)
        H5Aread(attribute, H5T_NATIVE_INT, &version);
    H5Sclose(space);
    H5Aclose(attribute);
    return version;
}

/* Return the numbers of a dataset of float64 in this file, to be freed, and its shape; or NULL. */
static inline double *jaxstab_read_(hid_t file, const char *name, int rank, hsize_t *shape)
{
    H5L_info_t link;
    if (H5Lget_info(file, name, &link, H5P_DEFAULT) < 0 || link.type != H5L_TYPE_HARD)
        return NULL;
    const hid_t dataset = H5Dopen2(file, name, H5P_DEFAULT);
    const hid_t space = H5Dget_space(dataset), type = H5Dget_type(dataset);
    const hid_t layout = H5Dget_create_plist(dataset);
    double *values = NULL;
    if (H5Sget_simple_extent_ndims(space) == rank && H5Pget_layout(layout) == H5D_CHUNKED &&
        H5Tget_class(type) == H5T_FLOAT && H5Tget_size(type) == sizeof *values) {
        hsize_t count = 1;
        H5Sget_simple_extent_dims(space, shape, NULL);
        for (int i = 0; i < rank; i++)
            count = shape[i] && count <= JAXSTAB_LARGEST_ARRAY_ / shape[i] ? count * shape[i] : 0;
        if (count)
            values = (double *)malloc((size_t)count * sizeof *values);
        if (values &&
            H5Dread(dataset, H5T_NATIVE_DOUBLE, H5S_ALL, H5S_ALL, H5P_DEFAULT, values) < 0) {
            free(values);
            values = NULL;
        }
    }
    H5Pclose(layout);
    H5Tclose(type);
    H5Sclose(space);
    H5Dclose(dataset);
    return values;
}

/* Whether the nodes in one column of a table are finite and ascending. */
static inline int jaxstab_ascends_(const double *nodes, size_t count, size_t columns, size_t column)
{
    for (size_t i = 0; i < count; i++)
        if (!isfinite(nodes[i * columns + column]) ||
            (i && !(nodes[(i - 1) * columns + column] < nodes[i * columns + column])))
            return 0;
    return 1;
}

enum {
    JAXSTAB_ALPHA_,
    JAXSTAB_BETA_,
    JAXSTAB_GAMMA_,
    JAXSTAB_DELTA_,
    JAXSTAB_DELAY_,
    JAXSTAB_PLANES_,
    JAXSTAB_ARRAYS_ /* so many */
};

/* Whether shapes and axes fit together. */
static inline int jaxstab_fits_(double *const values[], const hsize_t shape[][5])
{
    const hsize_t *planes = shape[JAXSTAB_PLANES_], delays = shape[JAXSTAB_DELAY_][0];
    int fits = planes[1] == (shape[JAXSTAB_GAMMA_][0] > 1 ? shape[JAXSTAB_GAMMA_][0] - 1 : 1) &&
               planes[2] == (shape[JAXSTAB_DELTA_][0] > 1 ? shape[JAXSTAB_DELTA_][0] - 1 : 1) &&
               planes[3] == delays && planes[4] == 10;
    for (int i = JAXSTAB_ALPHA_; i <= JAXSTAB_BETA_; i++) {
        fits = fits && shape[i][1] == delays && shape[i][0] > 1;
        for (size_t k = 0; fits && k < delays; k++)
            fits = jaxstab_ascends_(values[i], (size_t)shape[i][0], (size_t)delays, k);
    }
    for (int i = JAXSTAB_GAMMA_; i <= JAXSTAB_DELAY_; i++)
        fits = fits && jaxstab_ascends_(values[i], (size_t)shape[i][0], 1, 0);
    return fits;
}

static inline double *jaxstab_copied_(const double *values, size_t count, double **free_space)
{
    double *copy = *free_space;
    memcpy(copy, values, count * sizeof *values);
    *free_space += count;
    return copy;
}

/* Return an atlas in one block: itself, the walls of each delay, the nodes and the planes. */
static inline jaxstab_atlas *jaxstab_assembled_(double *const values[], const hsize_t shape[][5])
{
    const hsize_t *planes = shape[JAXSTAB_PLANES_];
    const size_t delays = (size_t)shape[JAXSTAB_DELAY_][0];
    const size_t gammas = (size_t)shape[JAXSTAB_GAMMA_][0];
    const size_t deltas = (size_t)shape[JAXSTAB_DELTA_][0];
    const size_t numbers = (size_t)(planes[0] * planes[1] * planes[2] * planes[3] * planes[4]);
    const size_t head = (sizeof(jaxstab_atlas) + sizeof(double) - 1) / sizeof(double);
    const size_t walls_size = delays * (sizeof(jaxstab_walls_) / sizeof(double));
    const size_t count = head + walls_size + gammas + deltas + delays + numbers;
    double *block = (double *)malloc(count * sizeof *block);
    if (!block)
        return NULL;
    jaxstab_atlas *atlas = (jaxstab_atlas *)(void *)block;
    jaxstab_walls_ *walls = (jaxstab_walls_ *)(void *)(block + head);
    double *free_space = block + head + walls_size;
    atlas->delays = delays;
    atlas->gammas = gammas;
    atlas->deltas = deltas;
    atlas->beta_cells = (size_t)planes[0];
    atlas->gamma_cells = (size_t)planes[1];
    atlas->delta_cells = (size_t)planes[2];
    atlas->walls = walls;
    atlas->delay = jaxstab_copied_(values[JAXSTAB_DELAY_], delays, &free_space);
    atlas->gamma = jaxstab_copied_(values[JAXSTAB_GAMMA_], gammas, &free_space);
    atlas->delta = jaxstab_copied_(values[JAXSTAB_DELTA_], deltas, &free_space);
    atlas->planes = jaxstab_copied_(values[JAXSTAB_PLANES_], numbers, &free_space);
    const double *lowest[] = {values[JAXSTAB_ALPHA_], values[JAXSTAB_BETA_]}, *highest[2];
    for (int i = JAXSTAB_ALPHA_; i <= JAXSTAB_BETA_; i++)
        highest[i] = values[i] + ((size_t)shape[i][0] - 1) * delays;
    for (size_t k = 0; k < delays; k++) {
        walls[k].lowest_alpha = lowest[JAXSTAB_ALPHA_][k];
        walls[k].highest_alpha = highest[JAXSTAB_ALPHA_][k];
        walls[k].lowest_beta = lowest[JAXSTAB_BETA_][k];
        walls[k].highest_beta = highest[JAXSTAB_BETA_][k];
        walls[k].cells_per_beta =
            (double)atlas->beta_cells / (walls[k].highest_beta - walls[k].lowest_beta);
    }
    return atlas;
}

/* Return the atlas of an open HDF5 file; or NULL and what is wrong with it. */
static inline jaxstab_atlas *jaxstab_loaded_(hid_t file, const char **problem)
{
    static const char *const names[] = {"alpha", "beta", "gamma", "delta", "delay", "alpha_limits"};
    static const int ranks[] = {2, 2, 1, 1, 1, 5};
    double *values[JAXSTAB_ARRAYS_] = {NULL};
    hsize_t shape[JAXSTAB_ARRAYS_][5] = {{0}};
    jaxstab_atlas *atlas = NULL;
    int is_read = 1;
    *problem = jaxstab_damaged_;
    if (!jaxstab_is_format_(file))
        return NULL;
    const int version = jaxstab_version_(file);
    if (version < JAXSTAB_OLDEST_SCHEMA || version > JAXSTAB_NEWEST_SCHEMA) {
        *problem = "has a schema version other than 2 and 3; use another reader, or build it again.";
        return NULL;
    }
    if (H5Lexists(file, "alpha_limits", H5P_DEFAULT) == 0) {
        *problem = "holds no limits of alpha; build one with the product 'alpha_limits'.";
        return NULL;
    }
    for (int i = 0; is_read && i < JAXSTAB_ARRAYS_; i++)
        is_read = (values[i] = jaxstab_read_(file, names[i], ranks[i], shape[i])) != NULL;
    if (is_read && jaxstab_fits_(values, (const hsize_t (*)[5])shape)) {
        *problem = "does not fit into memory.";
        atlas = jaxstab_assembled_(values, (const hsize_t (*)[5])shape);
    }
    for (int i = 0; i < JAXSTAB_ARRAYS_; i++)
        free(values[i]);
    return atlas;
}

/* Return an atlas, to be closed; or NULL, and in *problem what is wrong with the file, in words.
 * Not for two threads at once, unless libhdf5 was built for threads. */
static inline jaxstab_atlas *jaxstab_open(const char *path, const char **problem)
{
    jaxstab_atlas *atlas = NULL;
    size_t length;
    unsigned char *bytes = jaxstab_bytes_of_(path, &length);
    *problem = bytes ? jaxstab_damaged_ : "cannot be read.";
    length = jaxstab_image_length_(bytes, length);
    if (length) {
        H5E_BEGIN_TRY {
            const hid_t file = jaxstab_open_image_(bytes, length);
            if (file >= 0) {
                atlas = jaxstab_loaded_(file, problem);
                H5Fclose(file);
            }
        }
        H5E_END_TRY;
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
